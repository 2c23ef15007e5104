//! One run, scored.

use sphere_agent::gains::GainsError;
use sphere_ground::trajectory::{MissionError, Pose, Trajectory};
use sphere_protocol::message::Mode;
use sphere_protocol::time::Span;
use thiserror::Error;

use super::experiment::Case;
use super::indicator::Indicator;
use crate::indicators::{
    FOUND, SETTLING_BAND, Sample, Step, between, bounds, largest, mean, mean_absolute, rise_time,
    root_mean_square, settling_time, time_below, values, variation_rate,
};
use crate::metrics::{heading_error, position_error, roll_error, samples};
use crate::run::{Run, run};
use crate::scenario::{Scenario, ScenarioError};
use crate::trace::Row;

/// A run of a case.
#[derive(Clone, Copy, Debug)]
pub struct Job {
    /// Which.
    pub case: Case,
    /// Seed of every random stream.
    pub seed: u64,
    /// Whether the robot gets position fixes; without, it dead-reckons.
    pub fixes: bool,
    /// Whether to keep the motion, for figures.
    pub keep: bool,
}

/// What came of a run.
#[derive(Clone, Debug)]
pub struct Score {
    /// By [`Indicator`]; `None` is not applicable, or never.
    pub figures: [Option<f64>; Indicator::ALL.len()],
    /// Whether the robot fell over or latched a fault, or was lost before its mission began: then every figure is `None`.
    pub fell: bool,
    /// Other invariants that broke, by name.
    pub broken: Vec<String>,
    /// Distance of the estimated from the true centre at the end, over the path driven [m/m].
    pub drift: Option<f64>,
    /// The motion, if it was to be kept.
    pub motion: Option<Motion>,
}

/// A motion from its mission's start on, one entry a row.
#[derive(Clone, Debug, Default)]
pub struct Motion {
    /// Each moment.
    pub moments: Vec<Moment>,
}

/// One row of a motion. What the mission does not state is NaN.
#[derive(Clone, Copy, Debug)]
pub struct Moment {
    /// Time since the mission's start [s].
    pub t: f64,
    /// True pose.
    pub pose: Pose,
    /// True roll [rad].
    pub q_r: f64,
    /// Reference pose.
    pub pose_ref: Pose,
    /// Reference roll, as typed or as the path has it [rad].
    pub q_r_ref: f64,
    /// Distance from the reference [m].
    pub distance: f64,
}

/// Why a case could not be run.
#[derive(Debug, Error)]
pub enum CaseError {
    /// The simulator refuses the scenario.
    #[error(transparent)]
    Scenario(#[from] ScenarioError),
    /// Gains that cannot be stable.
    #[error(transparent)]
    Gains(#[from] GainsError),
    /// A mission that the robot cannot have.
    #[error(transparent)]
    Mission(#[from] MissionError),
}

impl Job {
    /// Runs and scores it.
    ///
    /// # Errors
    /// A case that cannot be run.
    pub fn score(&self) -> Result<Score, CaseError> {
        let scenario = self.case.scenario(self.seed, self.fixes)?;
        let replay = self.case.command(self.seed, self.fixes);
        let run = run(&scenario, &replay, || 0.0)?;
        Ok(score(&scenario, &run, self)?)
    }
}

fn score(scenario: &Scenario, run: &Run, job: &Job) -> Result<Score, MissionError> {
    let setup = &scenario.robots[0];
    let rows = run.trace.rows_of(setup.id);
    let begin = run.mission_starts[0];
    let rules = || {
        run.metrics
            .violations
            .iter()
            .map(|violation| &violation.rule)
    };
    let fell = begin.is_none()
        || rows.iter().any(|row| row.mode == Mode::Fault)
        || rules().any(|rule| rule == UPRIGHT);
    let mut score = Score {
        figures: [None; Indicator::ALL.len()],
        fell,
        broken: rules().filter(|rule| *rule != UPRIGHT).cloned().collect(),
        drift: None,
        motion: begin
            .filter(|_| job.keep)
            .map(|begin| Motion::new(&rows, begin)),
    };
    if let Some(begin) = begin.filter(|_| !fell) {
        let trajectory = Trajectory::new(&setup.mission, &setup.model.robot, Pose::default())?;
        let settle = Span::from_secs_f64(scenario.metrics.settle_s);
        let window = Window::new(&trajectory, begin, settle);
        score.figures = Indicator::ALL.map(|indicator| window.figure(indicator, job.case, &rows));
        score.drift = drift(&rows, begin);
    }
    Ok(score)
}

/// When things are counted.
struct Window {
    /// The mission's start.
    begin: Span,
    /// Its end, if it has one.
    end: Option<Span>,
    /// When a path's tracking counts as settled.
    settled: Span,
    /// Its first step, if it has steps [rad].
    step: Option<Step>,
}

impl Window {
    fn new(trajectory: &Trajectory, begin: Span, settle: Span) -> Self {
        let after = |s: f64| begin + Span::from_secs_f64(s);
        let program = trajectory.program();
        Self {
            begin,
            end: program.and_then(|program| program.duration()).map(after),
            settled: begin + settle,
            step: program
                .and_then(|program| program.first_step())
                .map(|step| Step {
                    at: after(step.at),
                    from: step.from,
                    to: step.to,
                    until: Some(after(step.until)),
                }),
        }
    }

    fn figure(&self, indicator: Indicator, case: Case, rows: &[&Row]) -> Option<f64> {
        if !indicator.applies(case.experiment) {
            return None;
        }
        let roll = || samples(rows, |row| Some(row.truth.q_r));
        let error = || samples(rows, |row| roll_error(row).map(f64::to_degrees));
        let whole = |samples: Vec<Sample>| values(between(&samples, self.begin, self.end));
        let settled = |samples: Vec<Sample>| values(between(&samples, self.settled, self.end));
        let steady = || Some(values(self.step?.steady(&error())));
        let distance = || samples(rows, position_error);
        match indicator {
            Indicator::RiseTime => rise_time(&roll(), &self.step?),
            Indicator::SettlingTime => settling_time(&roll(), &self.step?, SETTLING_BAND),
            Indicator::MeanError => mean(&values(self.step?.of(&error()))),
            Indicator::RmseSteady => root_mean_square(&steady()?),
            Indicator::BoundLow => bounds(&steady()?).map(|[low, _]| low),
            Indicator::BoundHigh => bounds(&steady()?).map(|[_, high]| high),
            Indicator::Mae => mean_absolute(&whole(error())),
            Indicator::Rmse => root_mean_square(&whole(error())),
            Indicator::PositionRmse => root_mean_square(&settled(distance())),
            Indicator::PositionAllRmse => root_mean_square(&whole(distance())),
            Indicator::PositionMax => largest(&settled(distance())),
            Indicator::HeadingRmse => {
                let heading = samples(rows, heading_error);
                root_mean_square(&settled(heading)).map(f64::to_degrees)
            }
            Indicator::LeanRmse => root_mean_square(&settled(error())),
            Indicator::TimeToFound => time_below(&distance(), self.begin, FOUND),
            Indicator::TorqueVariation => {
                let torque = samples(rows, |row| Some(row.torque_commanded.roll));
                let from = if case.experiment.is_direction() {
                    self.begin
                } else {
                    self.settled
                };
                variation_rate(between(&torque, from, self.end))
            }
        }
    }
}

/// How far the estimate is off at the end, for each metre driven since `begin`.
fn drift(rows: &[&Row], begin: Span) -> Option<f64> {
    let rows = &rows[rows.partition_point(|row| row.t < begin)..];
    let driven: f64 = rows
        .windows(2)
        .map(|pair| (pair[1].truth.x - pair[0].truth.x).hypot(pair[1].truth.y - pair[0].truth.y))
        .sum();
    let off = crate::metrics::estimate_error(rows.last()?)?;
    (driven > 0.0).then(|| off / driven)
}

impl Motion {
    fn new(rows: &[&Row], begin: Span) -> Self {
        let nowhere = Pose {
            x: f64::NAN,
            y: f64::NAN,
            heading: f64::NAN,
        };
        let moment = |row: &&Row| Moment {
            t: (row.t - begin).as_secs_f64(),
            pose: Pose {
                x: row.truth.x,
                y: row.truth.y,
                heading: row.truth.heading,
            },
            q_r: row.truth.q_r,
            pose_ref: row
                .reference
                .and_then(|reference| reference.pose)
                .unwrap_or(nowhere),
            q_r_ref: row.reference.map_or(f64::NAN, |reference| reference.q_r),
            distance: position_error(row).unwrap_or(f64::NAN),
        };
        let first = rows.partition_point(|row| row.t < begin);
        Self {
            moments: rows[first..].iter().map(moment).collect(),
        }
    }
}

/// The invariant that a robot which falls over breaks.
const UPRIGHT: &str = "upright";
