//! The paper's figures again, from the motions under [`SEED_SHOWN`](super::SEED_SHOWN).

use plotters::style::RGBColor;

use super::experiment::{Case, Controller, Experiment};
use super::score::{Moment, Motion};
use super::{Results, environment_name};
use crate::plot::figure::{BLUE, Figure, GREEN, GREY, Line, ORANGE, PINK, Panel};
use crate::plot::{PlotError, decade, panel, path, thinned};
use crate::scenario::Environment;

/// A figure with its caption.
#[derive(Clone, Debug)]
pub struct Drawn {
    /// What it shows and which figure of the paper it remakes.
    pub caption: String,
    /// The figure.
    pub svg: String,
}

/// The figures of an experiment in one environment.
///
/// # Errors
/// If a figure cannot be drawn.
pub fn drawn(
    results: &Results,
    experiment: Experiment,
    environment: Environment,
) -> Result<Vec<Drawn>, PlotError> {
    let mut figures = Vec::new();
    for velocity in experiment.velocities() {
        let of = |case: &Case| case.environment == environment && case.velocity == *velocity;
        let motions: Vec<_> = experiment
            .cases()
            .filter(of)
            .filter_map(|case| Some((case.controller, results.motion(&case)?)))
            .collect();
        let Some((_, first)) = motions.first() else {
            continue;
        };
        let shown = Shown {
            experiment,
            environment,
            velocity: *velocity,
            reference: &first.moments,
            motions: &motions,
        };
        if experiment.is_direction() {
            figures.push(shown.roll()?);
        } else {
            figures.push(shown.path()?);
            figures.push(shown.tracking()?);
        }
    }
    Ok(figures)
}

/// What one figure shows.
struct Shown<'a> {
    experiment: Experiment,
    environment: Environment,
    velocity: Option<f64>,
    /// Whose reference is drawn: all have the same.
    reference: &'a [Moment],
    motions: &'a [(Controller, &'a Motion)],
}

type Points = Vec<(f64, f64)>;

impl Shown<'_> {
    fn title(&self, what: &str) -> String {
        let speed = self
            .velocity
            .map_or_else(String::new, |v| format!(" at {v:.1} m/s"));
        let environment = environment_name(self.environment);
        format!("{}{speed}: {what} ({environment})", self.experiment.title())
    }

    /// Fig. 4, 5 or 6: roll and its error.
    fn roll(&self) -> Result<Drawn, PlotError> {
        let typed = thinned(series(self.reference, |m| m.q_r_ref.to_degrees()), BUCKETS);
        let largest = typed.iter().map(|p| p.1.abs()).fold(1.0, f64::max);
        let lowest = typed.iter().map(|p| p.1).fold(0.0, f64::min);
        let mut roll = vec![reference("typed", typed)];
        roll.extend(self.lines(|m| m.q_r.to_degrees()));
        let errors: Vec<_> = self.lines(|m| (m.q_r - m.q_r_ref).to_degrees()).collect();
        let svg = Figure {
            title: self.title("roll"),
            time: self.time(),
            panels: vec![
                Panel {
                    range: (lowest - 5.0, largest + 5.0),
                    lines: roll,
                    ..panel("Roll [°]", 300)
                },
                Panel {
                    range: (-ERROR_SHOWN, ERROR_SHOWN),
                    lines: errors,
                    ..panel("Roll error [°], true − typed", 200)
                },
            ],
        }
        .svg()?;
        let part = match (self.experiment, self.velocity) {
            (Experiment::RollStep, Some(0.5)) => "Fig. 4 (a)",
            (Experiment::RollStep, _) => "Fig. 4 (b)",
            (Experiment::RollDiscrete, _) => "Fig. 5",
            _ => "Fig. 6",
        };
        let caption = format!(
            "Remakes {part}: the true roll, and below it its error, of which ±{ERROR_SHOWN:.0}° are shown."
        );
        Ok(Drawn { caption, svg })
    }

    /// Fig. 7, 8 or 9, (a) and (b).
    fn path(&self) -> Result<Drawn, PlotError> {
        let along = |moments: &[Moment], at: fn(&Moment) -> (f64, f64)| -> Points {
            moments.iter().map(at).collect()
        };
        let mission = along(self.reference, |m| (m.pose_ref.x, m.pose_ref.y));
        let driven: Vec<_> = self
            .motions
            .iter()
            .map(|(controller, motion)| {
                let points = along(&motion.moments, |m| (m.pose.x, m.pose.y));
                (controller.title(), colour(*controller), points)
            })
            .collect();
        let svg = path::compared(&self.title("path of the centre"), mission, &driven)?;
        let source = self.experiment.source();
        let caption = format!(
            "Remakes {source} (a) and (b), in one: the paths driven, all from the origin, over the mission's."
        );
        Ok(Drawn { caption, svg })
    }

    /// Fig. 7, 8 or 9, (c) to (f), and the roll.
    fn tracking(&self) -> Result<Drawn, PlotError> {
        let both = |own: fn(&Moment) -> f64, wanted: fn(&Moment) -> f64| {
            let wanted = thinned(series(self.reference, wanted), BUCKETS);
            let mut lines = vec![reference("reference", wanted)];
            lines.extend(self.lines(own));
            lines
        };
        let of = |title, room, lines: Vec<Line<'static>>| Panel {
            range: around(&lines, room),
            lines,
            ..panel(title, 150)
        };
        let distances: Vec<_> = self.lines(|m| m.distance.max(1e-4).log10()).collect();
        let top = distances
            .iter()
            .flat_map(|line| &line.points)
            .map(|point| point.1)
            .filter(|value| value.is_finite())
            .fold(-1.0, f64::max)
            .ceil();
        let svg = Figure {
            title: self.title("tracking"),
            time: self.time(),
            panels: vec![
                Panel {
                    label: Some(|value| decade(*value)),
                    range: (-4.0, top.min(2.0)),
                    lines: distances,
                    ..panel("Distance from the reference", 200)
                },
                of("X [m]", 1.0, both(|m| m.pose.x, |m| m.pose_ref.x)),
                of("Y [m]", 1.0, both(|m| m.pose.y, |m| m.pose_ref.y)),
                of(
                    "Heading φ [°]",
                    60.0,
                    both(
                        |m| m.pose.heading.to_degrees(),
                        |m| m.pose_ref.heading.to_degrees(),
                    ),
                ),
                of(
                    "Roll [°]",
                    20.0,
                    both(|m| m.q_r.to_degrees(), |m| m.q_r_ref.to_degrees()),
                ),
            ],
        }
        .svg()?;
        let source = self.experiment.source();
        let caption = format!(
            "Remakes {source} (c) to (f): distance from the reference, here over decades, then X, Y and φ; the roll, which the paper does not show, is where the controllers differ."
        );
        Ok(Drawn { caption, svg })
    }

    /// One line for each controller.
    fn lines(&self, value: fn(&Moment) -> f64) -> impl Iterator<Item = Line<'static>> {
        // The first is drawn last, on top.
        self.motions
            .iter()
            .rev()
            .map(move |(controller, motion)| Line {
                name: controller.title(),
                colour: colour(*controller),
                width: 1.5,
                points: thinned(series(&motion.moments, value), BUCKETS),
            })
    }

    fn time(&self) -> (f64, f64) {
        let end = self.reference.last().map_or(1.0, |moment| moment.t);
        (0.0, end.max(1.0))
    }
}

fn series(moments: &[Moment], value: fn(&Moment) -> f64) -> Points {
    moments.iter().map(|m| (m.t, value(m))).collect()
}

fn reference(name: &'static str, points: Points) -> Line<'static> {
    Line {
        name,
        colour: GREY,
        width: 4.5,
        points,
    }
}

/// A range that holds the first of `lines`, and of the others what is within `room` of it.
fn around(lines: &[Line<'_>], room: f64) -> (f64, f64) {
    let extent = |lines: &[Line<'_>]| {
        let points = lines.iter().flat_map(|line| &line.points);
        let values = points.map(|p| p.1).filter(|value| value.is_finite());
        values.fold((0.0_f64, 0.0_f64), |(low, high), value| {
            (low.min(value), high.max(value))
        })
    };
    let (first, all) = (extent(&lines[..1]), extent(lines));
    let (low, high) = (all.0.max(first.0 - room), all.1.min(first.1 + room));
    let rim = 0.08 * (high - low).max(1.0);
    (low - rim, high + rim)
}

/// Each family has its colour, in every figure.
const fn colour(controller: Controller) -> RGBColor {
    match controller {
        Controller::Htsmc | Controller::Mhh => BLUE,
        Controller::HtsmcPaper | Controller::MhhPaper => GREEN,
        Controller::FuzzyPid | Controller::Mhf => ORANGE,
        Controller::FuzzyPidSingle => PINK,
    }
}

/// Points of a line come from this many stretches of it, up to three of each: some 10 kB of page a line.
const BUCKETS: usize = 300;
/// Errors shown [°].
const ERROR_SHOWN: f64 = 6.0;
