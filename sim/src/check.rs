//! Invariants: what must hold in every row of every run, whatever the network, the plant and the mission are.
//!
//! A violation names the rule, the time, the robot, and the command that replays the run.

use std::collections::BTreeMap;

use sphere_protocol::message::{Mode, PlanId};
use sphere_protocol::robot::RobotId;
use sphere_protocol::time::Span;

use crate::metrics::Violation;
use crate::trace::{Row, Trace};

/// What is allowed to one robot.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bounds {
    /// Limit of each motor [N·m].
    pub torque_max: f64,
    /// Highest speed of a command, whichever direction [m/s].
    pub v_max: f64,
    /// Longest age of a plan in play, counted from its telemetry.
    pub plan_age_max: Span,
}

/// A rule: its name, and whether a row breaks it. `before` is the robot's row before it.
type Rule = (
    &'static str,
    fn(row: &Row, before: Option<&Row>, bounds: &Bounds) -> bool,
);

/// The rules, each with what breaking it means.
const RULES: &[Rule] = &[
    ("finite", |row, _, _| !is_finite(row)),
    ("torque-limit", |row, _, bounds| {
        let limit = bounds.torque_max * (1.0 + 1e-9);
        [row.torque_commanded, row.torque_applied]
            .iter()
            .any(|t| t.pitch.abs() > limit || t.roll.abs() > limit)
    }),
    ("no-torque-unless-armed", |row, _, _| {
        let unarmed = matches!(
            row.mode,
            Mode::Boot | Mode::Disarmed | Mode::Ready | Mode::Fault
        );
        unarmed && (row.torque_commanded.pitch != 0.0 || row.torque_commanded.roll != 0.0)
    }),
    ("upright", |row, _, _| {
        row.truth.q_r.abs() > UPRIGHT_ROLL
            || row.truth.alpha.abs().max(row.truth.beta.abs()) > UPRIGHT_SWING
    }),
    ("speed-limit", |row, _, bounds| {
        row.truth.v.abs() > bounds.v_max * (1.0 + SPEED_MARGIN)
    }),
    ("tracking-has-a-plan", |row, _, _| {
        (row.mode == Mode::Tracking) != row.playing.is_some()
    }),
    ("plan-is-valid", |row, _, bounds| {
        row.plan_age.is_some_and(|age| age > bounds.plan_age_max)
    }),
    ("plans-never-go-back", |row, before, _| {
        // An agent that has started anew counts from the beginning.
        let same_life = before.filter(|before| before.life == row.life);
        let last: Option<PlanId> = same_life.and_then(|before| before.playing);
        matches!((last, row.playing), (Some(last), Some(now)) if now < last)
    }),
];

/// Beyond these the robot has fallen over [rad].
const UPRIGHT_ROLL: f64 = 1.0;
const UPRIGHT_SWING: f64 = 1.5;
/// Overshoot of the speed over the highest command that the controllers are allowed [1].
const SPEED_MARGIN: f64 = 0.25;

/// The first violation of each rule by each robot, in the order of time. Robots without bounds are not checked.
pub fn violations(
    trace: &Trace,
    bounds: &BTreeMap<RobotId, Bounds>,
    replay: &str,
) -> Vec<Violation> {
    let mut last: BTreeMap<RobotId, &Row> = BTreeMap::new();
    let mut found: BTreeMap<(RobotId, &str), ()> = BTreeMap::new();
    let mut violations = Vec::new();
    for row in trace.rows() {
        let before = last.insert(row.robot, row);
        let Some(bounds) = bounds.get(&row.robot) else {
            continue;
        };
        for (rule, breaks) in RULES {
            if breaks(row, before, bounds) && found.insert((row.robot, rule), ()).is_none() {
                violations.push(Violation {
                    rule: (*rule).to_owned(),
                    t_s: row.t.as_secs_f64(),
                    robot: Some(row.robot.to_string()),
                    replay: replay.to_owned(),
                });
            }
        }
    }
    violations
}

fn is_finite(row: &Row) -> bool {
    let state = |s: &sphere_protocol::state::RobotState| {
        [
            s.x,
            s.y,
            s.heading,
            s.v,
            s.q_r,
            s.q_r_rate,
            s.beta,
            s.beta_rate,
            s.alpha,
            s.alpha_rate,
        ]
        .iter()
        .all(|value| value.is_finite())
    };
    let torques = [row.torque_commanded, row.torque_applied];
    state(&row.truth)
        && state(&row.estimate)
        && torques
            .iter()
            .all(|torque| torque.pitch.is_finite() && torque.roll.is_finite())
}

#[cfg(test)]
mod tests {
    use sphere_protocol::state::{RobotState, Setpoint, Torque};

    use super::*;

    const BOUNDS: Bounds = Bounds {
        torque_max: 20.0,
        v_max: 1.0,
        plan_age_max: Span::from_millis(5000),
    };

    fn row() -> Row {
        Row {
            t: Span::from_millis(20),
            robot: "r1".parse().expect("a robot id"),
            truth: RobotState::default(),
            reference: None,
            estimate: RobotState::default(),
            setpoint: Setpoint::default(),
            command: None,
            torque_commanded: Torque {
                pitch: 1.0,
                roll: -1.0,
            },
            torque_applied: Torque::default(),
            mode: Mode::Tracking,
            plan_age: Some(Span::from_millis(300)),
            playing: Some(PlanId { epoch: 1, seq: 7 }),
            life: 0,
        }
    }

    fn broken(rows: &[Row]) -> Vec<String> {
        let mut trace = Trace::new();
        for row in rows {
            trace.push(*row);
        }
        let bounds = BTreeMap::from([("r1".parse().expect("a robot id"), BOUNDS)]);
        violations(&trace, &bounds, "again")
            .into_iter()
            .map(|violation| violation.rule)
            .collect()
    }

    #[test]
    fn a_sound_row_breaks_nothing() {
        assert_eq!(broken(&[row(), row()]), Vec::<String>::new());
    }

    #[test]
    fn every_rule_fires_on_its_defect_and_on_no_other() {
        type Defect = (&'static str, fn(&mut Row));
        let defects: [Defect; 7] = [
            ("finite", |row| row.truth.x = f64::NAN),
            ("torque-limit", |row| row.torque_commanded.roll = 20.1),
            ("no-torque-unless-armed", |row| {
                row.mode = Mode::Disarmed;
                row.playing = None;
            }),
            ("upright", |row| row.truth.q_r = -1.1),
            ("speed-limit", |row| row.truth.v = -1.3),
            ("tracking-has-a-plan", |row| row.playing = None),
            ("plan-is-valid", |row| {
                row.plan_age = Some(Span::from_millis(5001))
            }),
        ];
        for (rule, defect) in defects {
            let mut defective = row();
            defect(&mut defective);
            assert_eq!(broken(&[defective]), [rule], "{rule}");
        }
        let mut back = row();
        back.playing = Some(PlanId { epoch: 1, seq: 6 });
        assert_eq!(broken(&[row(), back]), ["plans-never-go-back"]);
        back.life = 1;
        assert_eq!(broken(&[row(), back]), Vec::<String>::new());
    }

    #[test]
    fn a_rule_is_reported_once_a_robot_with_its_first_time() {
        let mut late = row();
        late.t = Span::from_millis(40);
        let mut fallen = [row(), late];
        for row in &mut fallen {
            row.truth.beta = 2.0;
        }
        let mut trace = Trace::new();
        fallen.iter().for_each(|row| trace.push(*row));
        let bounds = BTreeMap::from([("r1".parse().expect("a robot id"), BOUNDS)]);
        let found = violations(&trace, &bounds, "sphere-sim run x.toml --seed 3");
        assert_eq!(found.len(), 1);
        assert_eq!(found[0].t_s, 0.02);
        assert_eq!(found[0].replay, "sphere-sim run x.toml --seed 3");
    }
}
