//! What a soak found: as JSON, and as text for people.

use std::fmt::Write as _;

use serde::Serialize;

use super::{FEATURES, Outcome};
use crate::metrics::Violation;

/// A whole soak.
#[derive(Clone, Debug, Serialize)]
pub struct Soak {
    /// The first seed.
    pub first_seed: u64,
    /// How many seeds were run.
    pub seeds: usize,
    /// Virtual hours times robots.
    pub robot_hours: f64,
    /// The longest that holding took to come to rest, beyond the time of braking [s], and the seed of it.
    pub rest_s: (f64, u64),
    /// Seeds that broke a rule.
    pub failed_seeds: Vec<u64>,
    /// What broke, at most the first of each rule and seed.
    pub violations: Vec<Violation>,
    /// How often each feature was there.
    pub coverage: Vec<Share>,
}

/// One feature's share.
#[derive(Clone, Debug, Serialize)]
pub struct Share {
    /// The feature.
    pub feature: &'static str,
    /// In this many seeds.
    pub seeds: usize,
    /// Of all, 0 to 1.
    pub share: f64,
}

impl Soak {
    /// Adds up `outcomes`.
    pub fn new(outcomes: &[Outcome]) -> Self {
        let coverage = FEATURES.iter().enumerate().map(|(place, (feature, _))| {
            let seeds = outcomes.iter().filter(|o| o.features[place]).count();
            Share {
                feature,
                seeds,
                share: seeds as f64 / outcomes.len().max(1) as f64,
            }
        });
        let failed = outcomes.iter().filter(|o| !o.violations.is_empty());
        let rest = outcomes.iter().map(|o| (o.rest_s, o.seed));
        Self {
            first_seed: outcomes.first().map_or(0, |outcome| outcome.seed),
            seeds: outcomes.len(),
            robot_hours: outcomes.iter().map(|o| o.robot_seconds).sum::<f64>() / 3600.0,
            rest_s: rest.max_by(|a, b| a.0.total_cmp(&b.0)).unwrap_or_default(),
            failed_seeds: failed.clone().map(|outcome| outcome.seed).collect(),
            violations: failed.flat_map(|o| o.violations.iter().cloned()).collect(),
            coverage: coverage.collect(),
        }
    }

    /// As pretty JSON.
    pub fn json(&self) -> String {
        let mut text = serde_json::to_string_pretty(self).expect("plain data");
        text.push('\n');
        text
    }

    /// As text: coverage, then what broke.
    pub fn terminal(&self) -> String {
        let mut text = String::new();
        for share in &self.coverage {
            let percent = 100.0 * share.share;
            let _ = writeln!(
                text,
                "{:30} {:6} {percent:6.1} %",
                share.feature, share.seeds
            );
        }
        let _ = writeln!(
            text,
            "\n{} seeds from {}, {:.1} robot hours: {} broke an invariant",
            self.seeds,
            self.first_seed,
            self.robot_hours,
            self.failed_seeds.len()
        );
        let (rest, seed) = self.rest_s;
        let _ = writeln!(
            text,
            "holding rests {rest:.2} s after braking's own time at most (seed {seed})"
        );
        for violation in &self.violations {
            let robot = violation.robot.as_deref().unwrap_or("the fleet");
            let _ = writeln!(
                text,
                "  {} at {:.2} s by {robot}: {}",
                violation.rule, violation.t_s, violation.replay
            );
        }
        text
    }
}
