//! Plots of a run, as SVG with a background of their own: they read the same on a light and on a dark page.
//!
//! Colours keep their meaning: blue is true, orange commanded, broad grey what should be followed. The palette is Okabe and
//! Ito's, told apart by every common kind of colour vision.

pub(crate) mod figure;
pub(crate) mod path;

use sphere_protocol::message::Mode;
use sphere_protocol::robot::RobotId;
use sphere_protocol::time::Span;
use thiserror::Error;

use crate::metrics::{heading_error, position_error, roll_error};
use crate::trace::{MODES, ROW_PERIOD, Row, Trace, mode_name};
use figure::{
    AMBER, BLUE, Band, Figure, GREEN, GREY, INK, Key, Line, ORANGE, PINK, Panel, SKY, tidy,
};
use plotters::style::RGBColor;

/// What the plots of one robot need beside its rows.
#[derive(Clone, Copy, Debug)]
pub struct Subject<'a> {
    /// Which robot.
    pub robot: RobotId,
    /// What was run, for the titles: the scenario's name.
    pub run: &'a str,
    /// Limit of each motor [N·m].
    pub torque_max: f64,
    /// When the plain metrics begin, in virtual time since the start of the run; `None` if never.
    pub settled: Option<Span>,
}

/// A plot: the name of its file and its SVG.
pub type Plot = (String, String);

/// A plot could not be drawn.
#[derive(Debug, Error)]
#[error("cannot draw the plot: {0}")]
pub struct PlotError(String);

impl PlotError {
    pub(crate) fn new(error: impl core::fmt::Display) -> Self {
        Self(error.to_string())
    }
}

/// Every plot of a run: five for each robot, and with several robots the paths of all.
///
/// # Errors
/// If a plot cannot be drawn.
pub fn plots(trace: &Trace, subjects: &[Subject<'_>]) -> Result<Vec<Plot>, PlotError> {
    let mut plots = Vec::new();
    for subject in subjects {
        plots.extend(robot_plots(&trace.rows_of(subject.robot), *subject)?);
    }
    if let [first, _, ..] = subjects {
        let robots: Vec<_> = subjects.iter().map(|subject| subject.robot).collect();
        plots.push((
            "paths.svg".to_owned(),
            path::fleet(trace, &robots, first.run)?,
        ));
    }
    Ok(plots)
}

/// The plots of one robot from its rows: path, errors, motion, torques, modes.
///
/// # Errors
/// If a plot cannot be drawn.
pub fn robot_plots(rows: &[&Row], subject: Subject<'_>) -> Result<Vec<Plot>, PlotError> {
    let name = |plot: &str| format!("{}-{plot}.svg", subject.robot);
    Ok(vec![
        (name("path"), path::robot(rows, subject)?),
        (name("errors"), errors(rows, subject)?),
        (name("motion"), motion(rows, subject)?),
        (name("torque"), torques(rows, subject)?),
        (name("modes"), modes(rows, subject)?),
    ])
}

/// Distance from the reference over six decades, then its parts and the heading error as they are once settled.
fn errors(rows: &[&Row], subject: Subject<'_>) -> Result<String, PlotError> {
    let settled = subject.settled.map_or(f64::INFINITY, Span::as_secs_f64);
    if !rows.iter().any(|row| position_error(row).is_some()) {
        return roll_errors(rows, subject, settled);
    }
    let logarithm = |row: &Row| position_error(row).map(|error| error.max(1e-4).log10());
    let distance = series(rows, logarithm);
    let top = distance
        .iter()
        .map(|point| point.1)
        .fold(-1.0, f64::max)
        .ceil();
    let parts = |row: &Row| {
        let pose = row.reference?.pose?;
        let (dx, dy) = (row.truth.x - pose.x, row.truth.y - pose.y);
        let (sin, cos) = pose.heading.sin_cos();
        Some((1e3 * (dx * cos + dy * sin), 1e3 * (dy * cos - dx * sin)))
    };
    let along = series(rows, |row| parts(row).map(|(along, _)| along));
    let across = series(rows, |row| parts(row).map(|(_, across)| across));
    let heading = series(rows, |row| heading_error(row).map(f64::to_degrees));
    // The approach is far larger than what follows: the range is that of the settled part.
    let from_settled = |points: &[(f64, f64)]| -> Vec<(f64, f64)> {
        let late: Vec<_> = points
            .iter()
            .filter(|point| point.0 >= settled)
            .copied()
            .collect();
        if late.is_empty() {
            points.to_vec()
        } else {
            late
        }
    };
    let (late_along, late_across) = (from_settled(&along), from_settled(&across));
    let approach = || approach(rows, settled);
    Figure {
        title: title(subject, "tracking errors"),
        time: time(rows),
        panels: vec![
            Panel {
                label: Some(|value| decade(*value)),
                range: (-4.0, top.min(4.0)),
                bands: approach(),
                lines: vec![line("true position", BLUE, distance)],
                keys: settling_key(settled),
                ..panel("Distance from the reference", 150)
            },
            Panel {
                range: symmetric(&[&late_along, &late_across], 5.0),
                bands: approach(),
                lines: vec![
                    line("along (ahead > 0)", ORANGE, along),
                    line("across (left > 0)", BLUE, across),
                ],
                ..panel("Position error [mm]", 190)
            },
            Panel {
                range: symmetric(&[&from_settled(&heading)], 0.5),
                bands: approach(),
                lines: vec![line("heading", GREEN, heading)],
                ..panel("Heading error [°]", 150)
            },
        ],
    }
    .svg()
}

/// What there is without a path: the roll's error.
fn roll_errors(rows: &[&Row], subject: Subject<'_>, settled: f64) -> Result<String, PlotError> {
    let roll = series(rows, |row| roll_error(row).map(f64::to_degrees));
    Figure {
        title: title(subject, "roll error"),
        time: time(rows),
        panels: vec![Panel {
            range: symmetric(&[&roll], 1.0),
            bands: approach(rows, settled),
            lines: vec![line("true − typed", BLUE, roll)],
            keys: settling_key(settled),
            ..panel("Roll error [°]", 260)
        }],
    }
    .svg()
}

/// Speed and roll with what they should follow.
fn motion(rows: &[&Row], subject: Subject<'_>) -> Result<String, PlotError> {
    let degrees = |radians: f64| radians.to_degrees();
    let speed = vec![
        broad(
            "mission",
            series(rows, |row| row.reference.map(|reference| reference.v)),
        ),
        line(
            "plan's command",
            PINK,
            series(rows, |row| row.command.map(|command| command.v)),
        ),
        line("setpoint", ORANGE, series(rows, |row| Some(row.setpoint.v))),
        line("true", BLUE, series(rows, |row| Some(row.truth.v))),
    ];
    let roll = vec![
        broad(
            "mission",
            series(rows, |row| {
                row.reference.map(|reference| degrees(reference.q_r))
            }),
        ),
        line(
            "plan's command",
            PINK,
            series(rows, |row| row.command.map(|command| degrees(command.q_r))),
        ),
        line(
            "setpoint",
            ORANGE,
            series(rows, |row| Some(degrees(row.setpoint.q_r))),
        ),
        line(
            "true",
            BLUE,
            series(rows, |row| Some(degrees(row.truth.q_r))),
        ),
    ];
    let swing = vec![
        line(
            "sideways β",
            GREEN,
            series(rows, |row| Some(degrees(row.truth.beta))),
        ),
        line(
            "fore and aft α",
            AMBER,
            series(rows, |row| Some(degrees(row.truth.alpha))),
        ),
    ];
    Figure {
        title: title(subject, "speed and roll"),
        time: time(rows),
        panels: vec![
            Panel {
                range: fitting(&speed, 0.1),
                lines: speed,
                ..panel("Speed [m/s]", 200)
            },
            Panel {
                range: fitting(&roll, 1.0),
                lines: roll,
                ..panel("Roll [°], left > 0", 200)
            },
            Panel {
                range: fitting(&swing, 1.0),
                lines: swing,
                ..panel("Swing of the pendulum from the vertical [°]", 150)
            },
        ],
    }
    .svg()
}

/// Both motors: asked for, given, and the limit.
fn torques(rows: &[&Row], subject: Subject<'_>) -> Result<String, PlotError> {
    let limit = subject.torque_max;
    let motor = |title, commanded: fn(&Row) -> f64, applied: fn(&Row) -> f64| Panel {
        range: (-1.15 * limit, 1.15 * limit),
        lines: vec![
            line(
                "commanded",
                ORANGE,
                series(rows, |row| Some(commanded(row))),
            ),
            line("applied", BLUE, series(rows, |row| Some(applied(row)))),
        ],
        levels: vec![(limit, "limit"), (-limit, "")],
        ..panel(title, 220)
    };
    Figure {
        title: title(subject, "motor torques"),
        time: time(rows),
        panels: vec![
            motor(
                "Pitch motor [N·m], forward > 0",
                |row| row.torque_commanded.pitch,
                |row| row.torque_applied.pitch,
            ),
            motor(
                "Roll motor [N·m], left > 0",
                |row| row.torque_commanded.roll,
                |row| row.torque_applied.roll,
            ),
        ],
    }
    .svg()
}

/// The agent's modes as a band, and the age of the plan it plays.
fn modes(rows: &[&Row], subject: Subject<'_>) -> Result<String, PlotError> {
    let ages = vec![line(
        "plan in play",
        BLUE,
        series(rows, |row| row.plan_age.map(|age| age.as_secs_f64() * 1e3)),
    )];
    let period = ROW_PERIOD.as_secs_f64();
    let bands = rows.chunk_by(|a, b| a.mode == b.mode).map(|same| Band {
        from: same[0].t.as_secs_f64(),
        to: same[same.len() - 1].t.as_secs_f64() + period,
        colour: mode_colour(same[0].mode),
    });
    let seen = MODES
        .into_iter()
        .filter(|mode| rows.iter().any(|row| row.mode == *mode));
    let keys = seen.map(|mode| Key {
        name: mode_name(mode),
        colour: mode_colour(mode),
        width: 12.0,
    });
    Figure {
        title: title(subject, "modes and plan age"),
        time: time(rows),
        panels: vec![
            Panel {
                bands: bands.collect(),
                keys: keys.collect(),
                label: None,
                ..panel("Mode", 40)
            },
            Panel {
                range: (0.0, fitting(&ages, 10.0).1),
                lines: ages,
                ..panel("Age of the plan [ms], since its telemetry", 200)
            },
        ],
    }
    .svg()
}

pub(crate) fn panel(title: &str, height: u32) -> Panel<'_> {
    Panel {
        title,
        height,
        range: (0.0, 1.0),
        lines: Vec::new(),
        levels: Vec::new(),
        bands: Vec::new(),
        label: Some(|value| tidy(*value)),
        keys: Vec::new(),
    }
}

fn line<'a>(name: &'a str, colour: RGBColor, points: Vec<(f64, f64)>) -> Line<'a> {
    Line {
        name,
        colour,
        width: 1.5,
        points,
    }
}

fn broad<'a>(name: &'a str, points: Vec<(f64, f64)>) -> Line<'a> {
    Line {
        name,
        colour: GREY,
        width: 4.5,
        points,
    }
}

/// Value over time; where there is none, a gap.
fn series(rows: &[&Row], value: impl Fn(&Row) -> Option<f64>) -> Vec<(f64, f64)> {
    let point = |row: &&Row| (row.t.as_secs_f64(), value(row).unwrap_or(f64::NAN));
    thinned(rows.iter().map(point).collect(), BUCKETS)
}

/// At most three points of each of `buckets` stretches: the first, the smallest and the largest, so that no spike is lost.
pub(crate) fn thinned(points: Vec<(f64, f64)>, buckets: usize) -> Vec<(f64, f64)> {
    if points.len() <= 3 * buckets {
        return points;
    }
    let bucket = points.len().div_ceil(buckets);
    let mut kept = Vec::with_capacity(3 * buckets);
    for chunk in points.chunks(bucket) {
        let by_value = |a: &&(f64, f64), b: &&(f64, f64)| a.1.total_cmp(&b.1);
        let extremes = [chunk.iter().min_by(by_value), chunk.iter().max_by(by_value)];
        let mut chosen: Vec<_> = extremes
            .into_iter()
            .flatten()
            .chain(chunk.first())
            .copied()
            .collect();
        chosen.sort_by(|a, b| a.0.total_cmp(&b.0));
        chosen.dedup_by(|a, b| a.0 == b.0);
        kept.extend(chosen);
    }
    kept
}

/// The approach, greyed.
fn approach(rows: &[&Row], settled: f64) -> Vec<Band> {
    let (from, to) = time(rows);
    let to = settled.min(to);
    let colour = APPROACH;
    if to > from {
        vec![Band { from, to, colour }]
    } else {
        Vec::new()
    }
}

fn settling_key(settled: f64) -> Vec<Key<'static>> {
    if settled.is_finite() && settled > 0.0 {
        vec![Key {
            name: "settling",
            colour: APPROACH,
            width: 12.0,
        }]
    } else {
        Vec::new()
    }
}

/// From the first row to the end of the last, never empty.
fn time(rows: &[&Row]) -> (f64, f64) {
    let at = |row: Option<&&Row>| row.map_or(Span::ZERO, |row| row.t);
    let (from, to) = (at(rows.first()), at(rows.last()) + ROW_PERIOD);
    (from.as_secs_f64(), to.as_secs_f64())
}

/// A range around zero that holds every point, at least ±`least`.
fn symmetric(lines: &[&[(f64, f64)]], least: f64) -> (f64, f64) {
    let points = lines.iter().flat_map(|points| points.iter());
    let largest = points
        .map(|point| point.1.abs())
        .filter(|value| value.is_finite())
        .fold(least, f64::max);
    (-1.1 * largest, 1.1 * largest)
}

/// A range that holds every point and zero, with some room, at least `least` wide.
fn fitting(lines: &[Line<'_>], least: f64) -> (f64, f64) {
    let values = || {
        lines
            .iter()
            .flat_map(|line| &line.points)
            .map(|point| point.1)
            .filter(|value| value.is_finite())
    };
    let (low, high) = (values().fold(0.0, f64::min), values().fold(0.0, f64::max));
    let room = 0.08 * (high - low).max(least);
    let low = if low < 0.0 { low - room } else { 0.0 };
    (low, high.max(low + least) + room)
}

/// 10^`value` metres in words, at whole decades.
pub(crate) fn decade(value: f64) -> String {
    let whole = value.round();
    if (value - whole).abs() > 1e-6 {
        return String::new();
    }
    match whole as i32 {
        -4 => "0.1 mm".to_owned(),
        -3 => "1 mm".to_owned(),
        -2 => "1 cm".to_owned(),
        -1 => "10 cm".to_owned(),
        exponent => format!("{} m", tidy(10f64.powi(exponent))),
    }
}

fn title(subject: Subject<'_>, what: &str) -> String {
    format!("{}: {what} ({})", subject.robot, subject.run)
}

const fn mode_colour(mode: Mode) -> RGBColor {
    match mode {
        Mode::Boot => RGBColor(225, 225, 225),
        Mode::Disarmed => GREY,
        Mode::Ready => SKY,
        Mode::Idle => BLUE,
        Mode::Tracking => GREEN,
        Mode::Holding => AMBER,
        Mode::Failsafe => ORANGE,
        Mode::Fault => INK,
    }
}

/// Stretches of a line in the plots of one run, which are looked at closely.
const BUCKETS: usize = 2000;
const APPROACH: RGBColor = RGBColor(242, 242, 242);
