//! The summary of a run for a terminal.

use core::fmt::Write;

use crate::metrics::{RobotMetrics, RunMetrics};

/// A table of the robots, where the plots are, and one sentence.
///
/// `plots` names the folder they were written to. `colour` may be true only if a terminal reads.
pub fn summary(metrics: &RunMetrics, plots: Option<&str>, colour: bool) -> String {
    let mut text = String::new();
    let mut rows = vec![HEADER.map(str::to_owned)];
    rows.extend(metrics.robots.iter().map(line));
    text.push_str(&table(&rows, colour));
    writeln!(text).expect("text grows");
    if let Some(folder) = plots {
        writeln!(text, "Plots, trace and metrics: {folder}").expect("text grows");
    }
    for violation in metrics.violations.iter().take(SHOWN) {
        let robot = violation.robot.as_deref().unwrap_or("fleet");
        let rule = &violation.rule;
        writeln!(
            text,
            "At {:.2} s {robot} broke `{rule}`. Replay: {}",
            violation.t_s, violation.replay
        )
        .expect("text grows");
    }
    if metrics.violations.len() > SHOWN {
        writeln!(
            text,
            "... and {} more in metrics.json.",
            metrics.violations.len() - SHOWN
        )
        .expect("text grows");
    }
    let sentence = sentence(metrics);
    match (colour, metrics.invariant_violations) {
        (false, _) => writeln!(text, "{sentence}"),
        (true, 0) => writeln!(text, "{GREEN}{sentence}{RESET}"),
        (true, _) => writeln!(text, "{RED}{sentence}{RESET}"),
    }
    .expect("text grows");
    text
}

/// Lines of cells, the first line a header, as a table.
pub(crate) fn table<const N: usize>(rows: &[[String; N]], colour: bool) -> String {
    let mut text = String::new();
    let width = |column: usize| {
        rows.iter()
            .map(|row| row[column].chars().count())
            .max()
            .unwrap_or(0)
    };
    let widths: Vec<_> = (0..N).map(width).collect();
    for (index, row) in rows.iter().enumerate() {
        let last = N - 1;
        let cells: Vec<_> = row
            .iter()
            .enumerate()
            .map(|(column, cell)| match column {
                // Names and words to the left, figures to the right.
                0 => format!("{cell:<width$}", width = widths[column]),
                _ if column == last => cell.clone(),
                _ => format!("{cell:>width$}", width = widths[column]),
            })
            .collect();
        let line = cells.join("  ");
        if index == 0 && colour {
            writeln!(text, "{BOLD}{line}{RESET}").expect("text grows");
        } else {
            writeln!(text, "{line}").expect("text grows");
        }
    }
    text
}

/// One sentence: how long, how fast, how well.
fn sentence(metrics: &RunMetrics) -> String {
    let RunMetrics {
        seed,
        duration_s,
        wall_s,
        ..
    } = metrics;
    let run = format!("{duration_s:.0} s in {wall_s:.1} s with seed {seed}");
    let robots = count(metrics.robots.len(), "robot", "robots");
    let worst = metrics
        .robots
        .iter()
        .filter_map(|robot| Some((robot.position_rmse_m?, &robot.id)))
        .max_by(|a, b| a.0.total_cmp(&b.0));
    let tracking = match worst {
        None => match worst_roll(metrics) {
            Some((rmse, id)) => {
                format!("{robots}, roll within {rmse:.2}° of what was typed (RMS, {id})")
            }
            None => format!("{robots}, none of which followed a path long enough to be scored"),
        },
        Some((rmse, _)) if metrics.robots.len() == 1 => {
            format!("{robots}, {} mm from the path (RMS)", millimetres(rmse))
        }
        Some((rmse, id)) => format!(
            "{robots}, at worst {} mm from the path (RMS, {id})",
            millimetres(rmse)
        ),
    };
    match metrics.invariant_violations {
        0 => format!("Simulated {run}: {tracking}; every invariant held."),
        broken => format!(
            "Simulated {run}: {tracking}; {} BROKE.",
            count(broken, "INVARIANT", "INVARIANTS")
        ),
    }
}

/// Largest roll error of the robots, and whose.
fn worst_roll(metrics: &RunMetrics) -> Option<(f64, &str)> {
    let errors = metrics.robots.iter();
    errors
        .filter_map(|robot| Some((robot.roll_rmse_deg?, robot.id.as_str())))
        .max_by(|a, b| a.0.total_cmp(&b.0))
}

fn line(robot: &RobotMetrics) -> [String; HEADER.len()] {
    [
        robot.id.clone(),
        figure(robot.position_rmse_m, millimetres),
        figure(robot.position_max_m, millimetres),
        figure(robot.position_all_max_m, millimetres),
        figure(robot.heading_rmse_rad, |heading| {
            format!("{:.2}", heading.to_degrees())
        }),
        figure(robot.plan_age_p50_s, milliseconds),
        figure(robot.plan_age_p99_s, milliseconds),
        figure(robot.min_separation_m, |metres| format!("{metres:.2}")),
        figure(robot.roll_rmse_deg, |degrees| format!("{degrees:.2}")),
        modes(robot),
    ]
}

/// The modes in which it spent time, longest first.
fn modes(robot: &RobotMetrics) -> String {
    let mut modes: Vec<_> = robot
        .time_in_mode_s
        .iter()
        .filter(|(_, time)| **time > 0.0)
        .collect();
    modes.sort_by(|a, b| b.1.total_cmp(a.1));
    let modes: Vec<_> = modes
        .iter()
        .map(|(mode, time)| format!("{mode} {time:.1} s"))
        .collect();
    modes.join(", ")
}

pub(crate) fn figure(value: Option<f64>, text: impl Fn(f64) -> String) -> String {
    value.map_or_else(|| "-".to_owned(), text)
}

/// Metres as millimetres with as many digits as mean something.
pub(crate) fn millimetres(metres: f64) -> String {
    let mm = metres * 1e3;
    if mm < 100.0 {
        format!("{mm:.1}")
    } else {
        format!("{mm:.0}")
    }
}

pub(crate) fn milliseconds(seconds: f64) -> String {
    format!("{:.0}", seconds * 1e3)
}

fn count(number: usize, one: &str, many: &str) -> String {
    format!("{number} {}", if number == 1 { one } else { many })
}

const HEADER: [&str; 10] = [
    "robot",
    "RMSE mm",
    "max mm",
    "max all mm",
    "heading °",
    "age p50 ms",
    "p99 ms",
    "nearest m",
    "roll °",
    "modes",
];
/// Violations shown one by one.
const SHOWN: usize = 5;
pub(crate) const BOLD: &str = "\x1b[1m";
pub(crate) const GREEN: &str = "\x1b[32m";
pub(crate) const RED: &str = "\x1b[31m";
pub(crate) const RESET: &str = "\x1b[0m";
