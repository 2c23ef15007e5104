//! Invariants: what must hold in every run, whatever the network, the plant and the mission are.
//!
//! In virtual time a [`Monitor`] watches events as they happen: every torque frame as it leaves an agent and as it reaches a board,
//! every plan that the station makes and an agent plays, every row. A run in real time is held to the rules that its rows show
//! ([`violations`]). A violation names the rule, the time, the robot, and the command that replays the run.
//!
//! | rule | what it says | file |
//! |---|---|---|
//! | `finite`, `torque-limit`, `no-torque-unless-armed`, `upright`, `speed-limit`, `tracking-has-a-plan`, `plan-is-valid`, `plans-never-go-back` | of each row; `upright` and `speed-limit` only while the agent has the motors: a robot that lost its agent rolls and leans as it will | `row.rs`, `control.rs` |
//! | `torque-limit`, `torque-validity` | of each torque that a board obeys: within the motors' limit, for 60 ms at most | `torque.rs` |
//! | `no-torque-unless-armed`, `torque-has-a-source` | of each torque frame of an agent: zero unless armed, and then what its control step computed | `torque.rs` |
//! | `braking-reference` | armed and without a plan the speed reference only falls, by the brake's ramp, and the roll's decays | `reference.rs` |
//! | `command-limit` | what is tracked is within the limits of commands | `reference.rs` |
//! | `tracking-has-a-plan`, `plan-is-valid` | a control step in tracking plays a plan between its start and its end | `plan.rs` |
//! | `plan-from-station` | a plan in play is, number by number, one that the station made | `plan.rs` |
//! | `plan-of-this-life`, `plans-never-go-back` | a plan in play was made for this boot and from this life's telemetry, and is newer than the ones before | `plan.rs` |
//! | `fault-has-a-cause` | an agent that has not stood still latches no fault, and none for its roll or swing where it has had control for 2 s | `fault.rs` |
//! | `holding-rests` | holding comes to rest in time | `rest.rs` |
//! | `tracking-resumes` | when what went wrong is over, tracking is back in time | `resume.rs` |
//! | `faults-stay-confined` | a fault of one robot changes no bit of another's rows | `confined.rs` |

mod confined;
mod control;
mod fault;
mod plan;
mod reference;
mod rest;
mod resume;
mod row;
mod torque;

use std::collections::{BTreeMap, BTreeSet};

use sphere_agent::agent::Agent;
use sphere_agent::mode::Reason;
use sphere_protocol::message::SetpointPlan;
use sphere_protocol::robot::{Limits, RobotId};
use sphere_protocol::time::{AgentClock, Instant, Span};

use crate::metrics::Violation;
use crate::scenario::{RobotSetup, Scenario};
use crate::trace::{Row, Trace};
pub use confined::strayed;
use control::Control;
use fault::Fault;
use plan::Plans;
use reference::Reference;
use rest::Rest;
use resume::Resume;
use torque::TorqueFrames;

/// What is allowed to one robot.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bounds {
    /// Limit of each motor [N·m].
    pub torque_max: f64,
    /// What its commands keep to.
    pub limits: Limits,
    /// Longest age of a plan in play, counted from its telemetry.
    pub plan_age_max: Span,
}

impl Bounds {
    /// What `setup` must keep to under plans of at most `plan_age_max`.
    pub fn new(setup: &RobotSetup, plan_age_max: Span) -> Self {
        let believed = &setup.model.robot;
        Self {
            // The agent believes in its own limit, the motors have theirs.
            torque_max: setup.plant.torque_max.max(believed.params.torque_max),
            limits: believed.limits,
            plan_age_max,
        }
    }

    /// Highest speed of a command, whichever direction [m/s].
    fn speed_max(&self) -> f64 {
        self.limits.v_max.max(-self.limits.v_min)
    }
}

/// A rule that broke.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Breach {
    /// Name of the rule.
    pub rule: &'static str,
    /// When, in virtual time.
    pub at: Span,
    /// Whose.
    pub robot: RobotId,
}

/// Watches one world. It only looks: nothing in the world depends on it.
pub struct Monitor {
    robots: Vec<Watch>,
    breaches: Breaches,
}

/// What surrounds a row without being part of it.
#[derive(Clone, Copy, Debug)]
pub struct Circumstances {
    /// Whether the robot's agent runs.
    pub agent_runs: bool,
    /// Why the agent is in its mode.
    pub reason: Reason,
    /// Whether the station runs.
    pub station_runs: bool,
    /// Whether the station has a mission under way for it.
    pub on_mission: bool,
    /// Packets handed to the link so far and lost of them, up and down.
    pub packets: [(u64, u64); 2],
}

struct Watch {
    id: RobotId,
    bounds: Bounds,
    before: Option<Row>,
    control: Control,
    fault: Fault,
    torque: TorqueFrames,
    reference: Reference,
    plans: Plans,
    rest: Rest,
    resume: Resume,
}

/// The first breach of each rule by each robot, in the order of time.
#[derive(Default)]
struct Breaches {
    known: BTreeSet<(usize, &'static str)>,
    found: Vec<Breach>,
}

impl Monitor {
    /// Of the world of `scenario`, whose agents begin with these boot ids.
    pub fn new(scenario: &Scenario, boot_ids: impl IntoIterator<Item = u64>) -> Self {
        let watch = |(setup, boot_id): (&RobotSetup, u64)| Watch {
            id: setup.id,
            bounds: Bounds::new(setup, scenario.planner.max_age),
            before: None,
            control: Control::default(),
            fault: Fault::default(),
            torque: TorqueFrames::new(),
            reference: Reference::default(),
            plans: Plans::new(boot_id),
            rest: Rest::new(setup),
            resume: Resume::new(scenario, setup),
        };
        Self {
            robots: scenario.robots.iter().zip(boot_ids).map(watch).collect(),
            breaches: Breaches::default(),
        }
    }

    /// Robot number `robot`'s agent starts anew, as `boot_id`, while its clock shows `agent_now`.
    pub fn on_agent_start(&mut self, robot: usize, boot_id: u64, agent_now: Instant<AgentClock>) {
        let watch = &mut self.robots[robot];
        watch.plans.on_agent_start(boot_id, agent_now);
        watch.reference = Reference::default();
    }

    /// The station sends `plan` to robot number `robot`.
    pub fn on_plan_made(&mut self, robot: usize, plan: &SetpointPlan) {
        self.robots[robot].plans.on_made(plan);
    }

    /// A datagram leaves `agent` for its motor board, as it is on the wire.
    pub fn on_motor_output(
        &mut self,
        now: Span,
        robot: usize,
        agent_now: Instant<AgentClock>,
        agent: &Agent,
        bytes: &[u8],
    ) {
        let watch = &mut self.robots[robot];
        let mut broken = |rule| self.breaches.add(now, robot, watch.id, rule);
        // Only a control step sends a torque, and each does.
        watch.torque.sent(bytes, |command| {
            torque::check_sent(command, agent, &mut broken);
            watch.reference.on_step(agent, &watch.bounds, &mut broken);
            watch.plans.on_step(agent_now, agent, &mut broken);
        });
    }

    /// A datagram reaches the motor board of robot number `robot`.
    pub fn on_board_input(&mut self, now: Span, robot: usize, bytes: &[u8]) {
        let watch = &mut self.robots[robot];
        watch.torque.arrived(bytes, |command| {
            torque::check_arrived(command, &watch.bounds, |rule| {
                self.breaches.add(now, robot, watch.id, rule);
            });
        });
    }

    /// The next row of robot number `robot`.
    pub fn on_row(&mut self, robot: usize, row: &Row, around: &Circumstances) {
        let watch = &mut self.robots[robot];
        let mut broken = |rule| self.breaches.add(row.t, robot, watch.id, rule);
        let was_controlled = watch.control.is_sound();
        watch.fault.on_row(row, around, was_controlled, &mut broken);
        let is_controlled = watch.control.on_row(row, around);
        row::broken(row, watch.before.as_ref(), &watch.bounds)
            .filter(|rule| is_controlled || !row::NEED_CONTROL.contains(rule))
            .for_each(&mut broken);
        watch.rest.on_row(row, around, &watch.bounds, &mut broken);
        watch.resume.on_row(row, around, &mut broken);
        watch.before = Some(*row);
    }

    /// The longest that holding has taken to come to rest, beyond the time of braking.
    pub fn longest_rest(&self) -> Span {
        let each = self.robots.iter().map(|watch| watch.rest.longest());
        each.max().unwrap_or(Span::ZERO)
    }

    /// The first breach of each rule by each robot, in the order of time.
    pub fn breaches(&self) -> &[Breach] {
        &self.breaches.found
    }
}

impl Breaches {
    fn add(&mut self, at: Span, robot: usize, id: RobotId, rule: &'static str) {
        if self.known.insert((robot, rule)) {
            self.found.push(Breach {
                rule,
                at,
                robot: id,
            });
        }
    }
}

impl Breach {
    /// As results show it, with the command that replays it.
    pub fn violation(&self, replay: &str) -> Violation {
        Violation {
            rule: self.rule.to_owned(),
            t_s: self.at.as_secs_f64(),
            robot: Some(self.robot.to_string()),
            replay: replay.to_owned(),
        }
    }
}

/// What the rows of a run in real time show: the first violation of each rule by each robot, in the order of time. Robots without
/// bounds are not checked.
pub fn violations(
    trace: &Trace,
    bounds: &BTreeMap<RobotId, Bounds>,
    replay: &str,
) -> Vec<Violation> {
    let places: BTreeMap<RobotId, usize> = bounds.keys().copied().zip(0..).collect();
    let mut last: BTreeMap<RobotId, &Row> = BTreeMap::new();
    let mut breaches = Breaches::default();
    for row in trace.rows() {
        let before = last.insert(row.robot, row);
        if let Some(bounds) = bounds.get(&row.robot) {
            for rule in row::broken(row, before, bounds) {
                breaches.add(row.t, places[&row.robot], row.robot, rule);
            }
        }
    }
    let shown = breaches.found.iter();
    shown.map(|breach| breach.violation(replay)).collect()
}

#[cfg(test)]
mod tests {
    use sphere_protocol::message::{Mode, PlanId};
    use sphere_protocol::robot::Robot;
    use sphere_protocol::state::{RobotState, Setpoint, Torque};

    use super::*;

    fn bounds() -> Bounds {
        Bounds {
            torque_max: 20.0,
            limits: Robot::embedded("liu").expect("it is embedded").limits,
            plan_age_max: Span::from_millis(5000),
        }
    }

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
        let bounds = BTreeMap::from([("r1".parse().expect("a robot id"), bounds())]);
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
        let bounds = BTreeMap::from([("r1".parse().expect("a robot id"), bounds())]);
        let found = violations(&trace, &bounds, "sphere-sim run x.toml --seed 3");
        assert_eq!(found.len(), 1);
        assert_eq!(found[0].t_s, 0.02);
        assert_eq!(found[0].replay, "sphere-sim run x.toml --seed 3");
    }
}
