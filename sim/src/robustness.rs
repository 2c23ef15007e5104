//! What the direction controllers bear: the paper's roll step on robots that are not what the controller believes and in worlds that it
//! was not tuned in. `sphere-sim robustness`.
//!
//! Each case is the scenario `roll-step` with keys set; the estimator is in the loop. A run *stands* if the robot neither falls nor latches
//! a fault and its steady error stays within ±[`STEADY_LIMIT`]. Errors are true minus typed roll, from 5 s after the step on.

mod case;
mod map;

use std::num::NonZero;

use serde::Serialize;
use sphere_protocol::message::Mode;
use sphere_protocol::robot::Robot;

use crate::ensemble;
use crate::indicators::{bounds, quantile, root_mean_square, values, variation_rate};
use crate::metrics::{roll_error, samples};
use crate::paper::CaseError;
use crate::run::run;
use crate::scenario::Scenario;
use crate::trace::Row;

pub use case::{Case, all as cases};
pub use map::{heat_map, markdown, terminal};

/// Who is asked to bear it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Law {
    /// HTSMC with its disturbance observer.
    Htsmc,
    /// The same without the observer.
    HtsmcNoObserver,
    /// The fuzzy-PID cascade.
    FuzzyPid,
    /// The paper's single-loop fuzzy-PID.
    FuzzyPidSingle,
}

/// One run.
struct Job<'a> {
    case: &'a Case,
    law: Law,
    speed: f64,
    seed: u64,
}

/// What came of a run.
struct Outcome {
    fell: bool,
    /// Steady error: RMS and largest magnitude [°], variation of the torque [N·m/s].
    steady: Option<[f64; 3]>,
}

/// What a law makes of a case at a speed.
#[derive(Clone, Debug, Serialize)]
pub struct Line {
    /// Name of the case.
    pub case: String,
    /// What kind of case.
    pub group: &'static str,
    /// Who drove.
    pub controller: Law,
    /// At which speed [m/s].
    pub velocity_mps: f64,
    /// Runs.
    pub runs: usize,
    /// Of these: neither fallen nor swinging beyond [`STEADY_LIMIT`].
    pub stood: usize,
    /// Of these: fallen, or latched a fault.
    pub fell: usize,
    /// Median of the steady RMS error of the runs that did not fall [°]; null if all did.
    pub rmse_steady_deg: Option<f64>,
    /// The worst steady RMS error [°].
    pub rmse_steady_worst_deg: Option<f64>,
    /// Median of the largest steady error [°].
    pub bound_deg: Option<f64>,
    /// Median of the commanded roll torque's variation in the steady state [N·m/s].
    pub torque_variation_nm_per_s: Option<f64>,
}

impl Law {
    /// In the order of the map.
    pub const ALL: [Self; 4] = [
        Self::Htsmc,
        Self::HtsmcNoObserver,
        Self::FuzzyPid,
        Self::FuzzyPidSingle,
    ];

    /// Its name in tables.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Htsmc => "HTSMC",
            Self::HtsmcNoObserver => "HTSMC, no observer",
            Self::FuzzyPid => "fuzzy-PID cascade",
            Self::FuzzyPidSingle => "fuzzy-PID single",
        }
    }

    fn sets(self) -> Vec<String> {
        let controller = match self {
            Self::Htsmc | Self::HtsmcNoObserver => "htsmc",
            Self::FuzzyPid => "fuzzy-pid",
            Self::FuzzyPidSingle => "fuzzy-pid-single",
        };
        let mut sets = vec![format!("robots.0.roll_controller={controller}")];
        if self == Self::HtsmcNoObserver {
            sets.push(format!("robots.0.robot={BLIND}"));
        }
        sets
    }
}

/// Number of runs of `cases` with `seeds` seeds each.
pub fn runs(cases: &[Case], seeds: u64) -> usize {
    cases
        .iter()
        .map(|case| case.seeds(seeds) as usize)
        .sum::<usize>()
        * Law::ALL.len()
        * SPEEDS.len()
}

/// Runs every case with every law at both speeds, over seeds 1 to `seeds`; `done` hears how many runs have ended.
///
/// # Errors
/// The first case that cannot be run.
pub fn run_all(
    cases: &[Case],
    seeds: u64,
    threads: NonZero<usize>,
    done: impl FnMut(usize),
) -> Result<Vec<Line>, CaseError> {
    let mut jobs = Vec::new();
    for case in cases {
        for law in Law::ALL {
            for speed in SPEEDS {
                jobs.extend((1..=case.seeds(seeds)).map(|seed| Job {
                    case,
                    law,
                    speed,
                    seed,
                }));
            }
        }
    }
    let outcomes = ensemble::map(&jobs, threads, Job::outcome, done);
    let outcomes = outcomes.into_iter().collect::<Result<Vec<_>, _>>()?;
    let mut lines = Vec::new();
    let mut rest = (&jobs[..], &outcomes[..]);
    while let Some(first) = rest.0.first() {
        let count = first.case.seeds(seeds) as usize;
        let (these, others) = rest.1.split_at(count);
        lines.push(Line::new(first, these));
        rest = (&rest.0[count..], others);
    }
    Ok(lines)
}

impl Job<'_> {
    fn outcome(&self) -> Result<Outcome, CaseError> {
        let mut sets = self.law.sets();
        sets.push(format!("robots.0.mission.speed_mps={}", self.speed));
        sets.push(format!("seed={}", self.seed));
        sets.extend(self.case.sets(self.seed));
        let scenario = Scenario::parse("roll-step.toml", ROLL_STEP, &sets, blind)?;
        let run = run(&scenario, "", || 0.0)?;
        let rows: Vec<&Row> = run.trace.rows().iter().collect();
        let begin = run.mission_starts.first().copied().flatten();
        let fell = begin.is_none() || rows.iter().any(|row| row.mode == Mode::Fault);
        let Some(begin) = begin.filter(|_| !fell) else {
            return Ok(Outcome { fell, steady: None });
        };
        let from = begin + sphere_protocol::time::Span::from_millis(STEADY_FROM_MS);
        let steady: Vec<&Row> = rows.into_iter().filter(|row| row.t >= from).collect();
        let errors = values(&samples(&steady, roll_error));
        let torque = samples(&steady, |row| Some(row.torque_commanded.roll));
        let figures = (
            root_mean_square(&errors),
            bounds(&errors),
            variation_rate(&torque),
        );
        let steady = match figures {
            (Some(rmse), Some([low, high]), Some(variation)) => Some([
                rmse.to_degrees(),
                low.abs().max(high.abs()).to_degrees(),
                variation,
            ]),
            _ => None,
        };
        Ok(Outcome { fell, steady })
    }
}

impl Line {
    fn new(job: &Job<'_>, outcomes: &[Outcome]) -> Self {
        let figure = |i: usize| -> Vec<f64> {
            let steady = outcomes.iter().filter_map(|outcome| outcome.steady);
            steady.map(|figures| figures[i]).collect()
        };
        let stands = |outcome: &&Outcome| {
            !outcome.fell
                && outcome
                    .steady
                    .is_some_and(|figures| figures[1] <= STEADY_LIMIT)
        };
        Self {
            case: job.case.name.to_owned(),
            group: job.case.group,
            controller: job.law,
            velocity_mps: job.speed,
            runs: outcomes.len(),
            stood: outcomes.iter().filter(stands).count(),
            fell: outcomes.iter().filter(|outcome| outcome.fell).count(),
            rmse_steady_deg: quantile(&figure(0), 0.5),
            rmse_steady_worst_deg: quantile(&figure(0), 1.0),
            bound_deg: quantile(&figure(1), 0.5),
            torque_variation_nm_per_s: quantile(&figure(2), 0.5),
        }
    }
}

/// The robot `liu` without its roll observer.
fn blind(name: &str) -> Result<String, String> {
    if name != BLIND {
        return Err(format!("there is no robot file {name}"));
    }
    let text = Robot::embedded("liu").ok_or("no robot liu")?.text;
    let mut section = "";
    let lines: Vec<String> = text
        .lines()
        .map(|line| {
            if line.starts_with('[') {
                section = line;
            }
            if section == "[htsmc]" && line.starts_with("observer = ") {
                "observer = { value = 0.0, unit = \"1/s\", source = \"switched off\" }".to_owned()
            } else {
                line.to_owned()
            }
        })
        .collect();
    Ok(lines.join("\n"))
}

const ROLL_STEP: &str = include_str!("../scenarios/roll-step.toml");
const BLIND: &str = "no-observer.toml";
/// Speeds of the paper's steps [m/s].
pub const SPEEDS: [f64; 2] = [0.5, 1.0];
/// A robot whose steady error leaves this band does not stand where it was told to [°].
pub const STEADY_LIMIT: f64 = 3.0;
/// The step is 5 s after the mission's start, the steady state 5 s after that [ms].
const STEADY_FROM_MS: i64 = 10_000;
