//! The paper's experiments again, in virtual time: `sphere-sim paper`.
//!
//! Every experiment of the paper's section IV runs on the full plant with the deployed agent, estimator and station in the loop, in three
//! environments, with each controller, over many seeds. What comes of it is medians and deciles of the paper's indicators
//! ([`Table`], `tables.json`), beside the numbers that the paper prints of its hardware, sentences that say who wins where, and one page
//! with every figure ([`page`](mod@page)).
//!
//! A run in which the robot falls over or latches a fault counts as worse than every other in each indicator, one that never rises or
//! settles as worse than every other in that one. A median over runs of which more than half are lost is therefore `null`.

mod experiment;
pub mod figures;
mod indicator;
pub mod page;
mod score;
mod table;
pub mod terminal;
pub mod verdict;

use std::num::NonZero;

use indicatif::{ProgressBar, ProgressStyle};

pub use experiment::{Case, Controller, ENVIRONMENTS, Experiment, environment_name};
pub use indicator::Indicator;
pub use score::{CaseError, Job, Moment, Motion, Score};
pub use table::{Cell, Drift, Spread, Table, TableRow};

use crate::ensemble;
use crate::scenario::Environment;

/// The motion of a case under [`SEED_SHOWN`].
#[derive(Clone, Debug)]
pub struct Shown {
    /// Which case.
    pub case: Case,
    /// Its motion; empty if the mission never began.
    pub motion: Motion,
}

/// Everything that came of the experiments.
#[derive(Clone, Debug)]
pub struct Results {
    /// Seeds were 1 to this.
    pub seeds: u64,
    /// The experiments that ran.
    pub experiments: Vec<Experiment>,
    /// Indicators of every case.
    pub table: Table,
    /// What figures show.
    pub shown: Vec<Shown>,
}

/// Every run of `experiments` over seeds 1 to `seeds`; in the ideal world over seed 1 alone.
pub fn jobs(experiments: &[Experiment], seeds: u64) -> Vec<Job> {
    let mut jobs = Vec::new();
    for case in experiments.iter().flat_map(|experiment| experiment.cases()) {
        let is_shown = ENVIRONMENTS_SHOWN.contains(&case.environment);
        // Nothing is drawn in the ideal world: every seed gives the same figures to the last bit.
        let seeds = match case.environment {
            Environment::Ideal => 1,
            Environment::Real | Environment::Calibrated => seeds,
        };
        let mut run = |fixes| {
            jobs.extend((1..=seeds).map(|seed| Job {
                case,
                seed,
                fixes,
                keep: is_shown && fixes && seed == SEED_SHOWN,
            }));
        };
        run(true);
        // Dead reckoning is the estimator's: one controller shows it.
        if case.controller == Controller::Mhh {
            run(false);
        }
    }
    jobs
}

/// Runs `experiments` over seeds 1 to `seeds` on `threads` threads; `done` hears how many runs have ended.
///
/// # Errors
/// The first case that cannot be run.
pub fn run(
    experiments: &[Experiment],
    seeds: u64,
    threads: NonZero<usize>,
    done: impl FnMut(usize),
) -> Result<Results, CaseError> {
    let jobs = jobs(experiments, seeds);
    let scores = ensemble::map(&jobs, threads, Job::score, done);
    let scores = scores.into_iter().collect::<Result<Vec<_>, _>>()?;
    let mut shown = Vec::new();
    let mut scored = Vec::with_capacity(jobs.len());
    for (job, mut score) in jobs.into_iter().zip(scores) {
        if job.keep {
            shown.push(Shown {
                case: job.case,
                motion: score.motion.take().unwrap_or_default(),
            });
        }
        scored.push((job, score));
    }
    Ok(Results {
        seeds,
        experiments: experiments.to_vec(),
        table: Table::new(&scored),
        shown,
    })
}

/// A bar on standard error that shows how many of `runs` are done and how long the rest will take; nothing unless a terminal reads.
pub fn progress(runs: usize) -> ProgressBar {
    let style = ProgressStyle::with_template("{bar:40} {pos}/{len} runs, {eta} left");
    let bar = ProgressBar::new(runs as u64);
    bar.set_style(style.expect("the template is a constant"));
    bar
}

impl Results {
    /// The motion that figures show of a case.
    pub fn motion(&self, case: &Case) -> Option<&Motion> {
        let shown = self.shown.iter().find(|shown| shown.case == *case)?;
        Some(&shown.motion)
    }
}

/// The seed whose motions are drawn.
pub const SEED_SHOWN: u64 = 1;
/// The environments whose motions are drawn, nearest to the paper's hardware first.
pub const ENVIRONMENTS_SHOWN: [Environment; 2] = [Environment::Calibrated, Environment::Real];
