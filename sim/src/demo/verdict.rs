//! What the demo has shown: for each robot whether it did what it should, and the report.

use core::fmt::Write as _;

use sphere_protocol::message::Mode;
use sphere_protocol::robot::RobotId;
use sphere_protocol::time::Span;

use super::{Cut, Performance};
use crate::metrics::{LiveRobotMetrics, RobotMetrics};
use crate::report::{GREEN, RED, RESET, figure, millimetres, milliseconds, table};
use crate::trace::mode_name;

/// Whether one robot did what it should.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Verdict {
    /// It followed its path: root mean square error after settling [m].
    Tracked(f64),
    /// Its error is beyond [`RMSE_MAX`] [m].
    Lost(f64),
    /// It did not follow a path for long enough to be scored. In a demo that was ended early that is nobody's fault.
    Unscored,
    /// Its link was cut, and this long afterwards it held by itself.
    Held(Span),
    /// Its link was cut for longer than any plan is valid, and it did not hold.
    DidNotHold,
}

/// Largest root mean square position error that counts as tracking [m].
pub const RMSE_MAX: f64 = 0.04;
/// A control step that begins later than this finds the motors without torque [s]: the validity of the command before it, less a period.
const LATE: f64 = 0.04;
/// A plan that runs out is noticed with the next control step; a row of the trace is one more.
const NOTICE: Span = Span::from_millis(60);

/// Judges every robot.
pub fn verdicts(performance: &Performance, cuts: &[Cut]) -> Vec<(RobotId, Verdict)> {
    let Performance { run, scenario, .. } = performance;
    let validity = scenario.planner.max_age + NOTICE;
    scenario
        .robots
        .iter()
        .zip(&run.metrics.robots)
        .map(|(setup, figures)| {
            let cut = cuts.iter().find(|cut| {
                cut.robot == setup.id
                    && cut.length > validity
                    && cut.at + validity < scenario.duration()
            });
            let was_cut = cuts.iter().any(|cut| cut.robot == setup.id);
            let verdict = match (cut, figures.position_rmse_m) {
                (Some(cut), _) => {
                    let held = run.trace.rows_of(setup.id).into_iter().find(|row| {
                        row.mode == Mode::Holding && row.t >= cut.at && row.t <= cut.at + validity
                    });
                    held.map_or(Verdict::DidNotHold, |row| Verdict::Held(row.t - cut.at))
                }
                (None, None) => Verdict::Unscored,
                // A robot that stood for a while is behind its reference, which went on.
                (None, Some(_)) if was_cut => Verdict::Unscored,
                (None, Some(rmse)) if rmse <= RMSE_MAX => Verdict::Tracked(rmse),
                (None, Some(rmse)) => Verdict::Lost(rmse),
            };
            (setup.id, verdict)
        })
        .collect()
}

impl Verdict {
    /// Whether it did what it should; `is_interrupted` excuses who had no time to.
    pub fn is_good(self, is_interrupted: bool, was_cut: bool) -> bool {
        match self {
            Self::Tracked(_) | Self::Held(_) => true,
            Self::Unscored => is_interrupted || was_cut,
            Self::Lost(_) | Self::DidNotHold => false,
        }
    }
}

/// The table, where the plots are, and one sentence on what was just shown.
pub fn summary(
    performance: &Performance,
    verdicts: &[(RobotId, Verdict)],
    folder: &str,
    colour: bool,
) -> String {
    let metrics = &performance.run.metrics;
    let live = metrics.live.as_ref();
    let mut rows = vec![HEADER.map(str::to_owned)];
    for robot in &metrics.robots {
        let live = live.and_then(|live| live.robots.iter().find(|live| live.id == robot.id));
        rows.push(cells(robot, live));
    }
    let mut text = table(&rows, colour);
    text.push_str(
        "(errors from 10 s after setting out; plan age p50 / p99; control lateness p50 / p99 / max)\n",
    );
    // Writing to a String cannot fail.
    let _ = writeln!(text, "\nPlots, trace and metrics: {folder}");
    if let Some(live) = live {
        let _ = writeln!(
            text,
            "Plants: {} of {} steps began more than 1 ms late and were made up for, the latest {:.1} ms.",
            live.plant_steps_late,
            (metrics.wall_s * 1e3).round(),
            live.plant_lateness_max_s * 1e3
        );
    }
    let latest = live.into_iter().flat_map(|live| &live.robots);
    let latest = latest
        .map(|robot| robot.control_lateness_max_s)
        .fold(0.0, f64::max);
    if latest > LATE {
        let _ = writeln!(
            text,
            "A control step began {:.0} ms late, and the motors were without torque until then: this machine was too busy for real time.",
            latest * 1e3
        );
    }
    for violation in metrics.violations.iter().take(SHOWN) {
        let robot = violation.robot.as_deref().unwrap_or("fleet");
        let _ = writeln!(
            text,
            "At {:.2} s {robot} broke `{}`.",
            violation.t_s, violation.rule
        );
    }
    let is_good = metrics.violations.is_empty()
        && verdicts
            .iter()
            .all(|(_, verdict)| !matches!(verdict, Verdict::Lost(_) | Verdict::DidNotHold));
    let sentence = sentence(performance, verdicts);
    let _ = match (colour, is_good) {
        (false, _) => writeln!(text, "{sentence}"),
        (true, true) => writeln!(text, "{GREEN}{sentence}{RESET}"),
        (true, false) => writeln!(text, "{RED}{sentence}{RESET}"),
    };
    text
}

fn sentence(performance: &Performance, verdicts: &[(RobotId, Verdict)]) -> String {
    let Performance { run, scenario, .. } = performance;
    let up = &scenario.network.up;
    let loss = match up.loss {
        crate::scenario::Loss::Independent(loss) => loss,
        crate::scenario::Loss::Burst { loss_bad, .. } => loss_bad,
    };
    let mut text = format!(
        "Just shown: {} robots for {:.0} s over real Zenoh and MAVLink, links of {:.0} ± {:.0} ms each way\nwith the stalls of {:.0} % loss: ",
        scenario.robots.len(),
        run.metrics.duration_s,
        up.delay_ms,
        up.jitter_ms,
        1e2 * loss,
    );
    let worst = verdicts
        .iter()
        .filter_map(|(id, verdict)| match verdict {
            Verdict::Tracked(rmse) | Verdict::Lost(rmse) => Some((*rmse, *id)),
            _ => None,
        })
        .max_by(|a, b| a.0.total_cmp(&b.0));
    let mut parts = Vec::new();
    if let Some((rmse, id)) = worst {
        let limit = if rmse > RMSE_MAX {
            format!(
                ", MORE THAN the {} that count as tracking",
                millimetres(RMSE_MAX)
            )
        } else {
            String::new()
        };
        parts.push(format!(
            "at worst {} mm from the path (RMS, {id}){limit}",
            millimetres(rmse)
        ));
    }
    for (id, verdict) in verdicts {
        match verdict {
            Verdict::Held(after) => parts.push(format!(
                "{id} held by itself {:.1} s after its link was cut",
                after.as_secs_f64()
            )),
            Verdict::DidNotHold => parts.push(format!("{id} DID NOT HOLD after its link was cut")),
            Verdict::Unscored | Verdict::Tracked(_) | Verdict::Lost(_) => {}
        }
    }
    let unscored: Vec<_> = verdicts
        .iter()
        .filter(|(_, verdict)| *verdict == Verdict::Unscored)
        .map(|(id, _)| id.to_string())
        .collect();
    if !unscored.is_empty() {
        let robots = unscored.join(", ");
        parts.push(format!("{robots} too short under way to be scored"));
    }
    text.push_str(&parts.join("; "));
    text.push('.');
    text
}

fn cells(robot: &RobotMetrics, live: Option<&LiveRobotMetrics>) -> [String; HEADER.len()] {
    let late = |value: Option<f64>| figure(value, |seconds| format!("{:.2}", seconds * 1e3));
    [
        robot.id.clone(),
        figure(robot.position_rmse_m, millimetres),
        figure(robot.position_max_m, millimetres),
        figure(robot.heading_rmse_rad, |heading| {
            format!("{:.2}", heading.to_degrees())
        }),
        format!(
            "{} / {}",
            figure(robot.plan_age_p50_s, milliseconds),
            figure(robot.plan_age_p99_s, milliseconds)
        ),
        live.map_or_else(String::new, |live| {
            format!(
                "{} / {} / {}",
                late(live.control_lateness_p50_s),
                late(live.control_lateness_p99_s),
                late(Some(live.control_lateness_max_s))
            )
        }),
        live.map_or_else(String::new, |live| live.link_stalls.to_string()),
        modes(robot),
    ]
}

/// The modes in which it spent a second or more after its boot, longest first.
fn modes(robot: &RobotMetrics) -> String {
    let mut modes: Vec<_> = robot
        .time_in_mode_s
        .iter()
        .filter(|(mode, time)| **time >= 1.0 && **mode != mode_name(Mode::Boot))
        .collect();
    modes.sort_by(|a, b| b.1.total_cmp(a.1));
    let modes: Vec<_> = modes
        .iter()
        .map(|(mode, time)| format!("{mode} {time:.0} s"))
        .collect();
    modes.join(", ")
}

/// Two quantiles of the plan's age, p50 / p99; of the control step's lateness p50 / p99 / the latest.
const HEADER: [&str; 8] = [
    "robot",
    "RMSE mm",
    "max mm",
    "heading °",
    "plan age ms",
    "control late ms",
    "stalls",
    "modes",
];
/// Violations shown one by one.
const SHOWN: usize = 5;
