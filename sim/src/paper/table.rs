//! Medians and deciles over seeds: `tables.json`.

use std::collections::BTreeMap;

use serde::Serialize;

use super::experiment::{Case, environment_name};
use super::indicator::Indicator;
use super::score::{Job, Score};
use crate::indicators::quantile;

/// Every case, scored over its seeds.
#[derive(Clone, Debug, Default)]
pub struct Table {
    /// In the order of the jobs.
    pub cells: Vec<Cell>,
    /// Of the runs without position fixes.
    pub drifts: Vec<Drift>,
}

/// One case over its seeds.
#[derive(Clone, Debug)]
pub struct Cell {
    /// Which.
    pub case: Case,
    /// Number of runs.
    pub runs: usize,
    /// Runs in which the robot fell over or latched a fault.
    pub fell: usize,
    /// In how many runs each other invariant broke.
    pub broken: BTreeMap<String, usize>,
    /// By [`Indicator`]; `None` is not applicable.
    pub spreads: [Option<Spread>; Indicator::ALL.len()],
}

/// Dead reckoning of one case over its seeds.
#[derive(Clone, Debug)]
pub struct Drift {
    /// Which.
    pub case: Case,
    /// Distance of estimated from true centre at the end, over the path driven [m/m].
    pub spread: Spread,
}

/// Median and deciles, nearest rank; `None` where that rank is a run that was lost.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Spread {
    /// The 10 % quantile.
    pub p10: Option<f64>,
    /// The median.
    pub median: Option<f64>,
    /// The 90 % quantile.
    pub p90: Option<f64>,
}

/// A row of `tables.json`.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct TableRow {
    /// The experiment's name.
    pub experiment: &'static str,
    /// The environment's name.
    pub environment: &'static str,
    /// The controller's name.
    pub controller: &'static str,
    /// Typed speed [m/s]; `null` where a path sets it.
    pub velocity_mps: Option<f64>,
    /// The indicator's name, which ends in its unit.
    pub indicator: &'static str,
    /// Median over the seeds; `null` if it does not apply, or if more than half of the runs were lost.
    pub median: Option<f64>,
    /// The 10 % quantile.
    pub p10: Option<f64>,
    /// The 90 % quantile.
    pub p90: Option<f64>,
    /// What the paper prints of its hardware; `null` where it prints nothing.
    pub paper: Option<f64>,
}

impl Table {
    /// Adds up runs, in the order of their cases.
    pub(super) fn new(scored: &[(Job, Score)]) -> Self {
        let mut table = Self::default();
        let same =
            |a: &(Job, Score), b: &(Job, Score)| a.0.case == b.0.case && a.0.fixes == b.0.fixes;
        for runs in scored.chunk_by(same) {
            let Job { case, fixes, .. } = runs[0].0;
            if fixes {
                table.cells.push(Cell::new(case, runs));
            } else {
                let drifts: Vec<_> = runs.iter().map(|(_, score)| score.drift).collect();
                let spread = Spread::of(&drifts, false);
                table.drifts.push(Drift { case, spread });
            }
        }
        table
    }

    /// The rows of `tables.json`: every indicator of every case.
    pub fn rows(&self) -> Vec<TableRow> {
        let rows_of = |cell: &Cell| Indicator::ALL.map(|indicator| cell.row(indicator));
        self.cells.iter().flat_map(rows_of).collect()
    }

    /// `tables.json`.
    pub fn json(&self) -> String {
        let mut text =
            serde_json::to_string_pretty(&self.rows()).expect("plain figures are always JSON");
        text.push('\n');
        text
    }

    /// A case's figures.
    pub fn cell(&self, case: &Case) -> Option<&Cell> {
        self.cells.iter().find(|cell| cell.case == *case)
    }

    /// The cases in groups that differ in the controller alone.
    pub fn groups(&self) -> impl Iterator<Item = &[Cell]> {
        self.cells.chunk_by(|a, b| a.case.is_rival(&b.case))
    }
}

impl Cell {
    fn new(case: Case, runs: &[(Job, Score)]) -> Self {
        let spread = |indicator: Indicator| {
            let of = |(_, score): &(Job, Score)| score.figures[indicator as usize];
            let figures: Vec<_> = runs.iter().map(of).collect();
            indicator
                .applies(case.experiment)
                .then(|| Spread::of(&figures, indicator.is_worst_low()))
        };
        let mut broken = BTreeMap::new();
        for rule in runs.iter().flat_map(|(_, score)| &score.broken) {
            *broken.entry(rule.clone()).or_insert(0) += 1;
        }
        Self {
            case,
            runs: runs.len(),
            fell: runs.iter().filter(|(_, score)| score.fell).count(),
            broken,
            spreads: Indicator::ALL.map(spread),
        }
    }

    /// The figures of one indicator; `None` if it does not apply.
    pub fn spread(&self, indicator: Indicator) -> Option<Spread> {
        self.spreads[indicator as usize]
    }

    /// The median of one indicator; `None` if it does not apply, or if more than half of the runs were lost.
    pub fn median(&self, indicator: Indicator) -> Option<f64> {
        self.spread(indicator)?.median
    }

    fn row(&self, indicator: Indicator) -> TableRow {
        let spread = self.spread(indicator);
        TableRow {
            experiment: self.case.experiment.name(),
            environment: environment_name(self.case.environment),
            controller: self.case.controller.name(),
            velocity_mps: self.case.velocity,
            indicator: indicator.name(),
            median: spread.and_then(|spread| spread.median),
            p10: spread.and_then(|spread| spread.p10),
            p90: spread.and_then(|spread| spread.p90),
            paper: indicator.printed(&self.case),
        }
    }
}

impl Spread {
    /// Of `figures`, where `None` is worse than any other: above them, or below if `is_worst_low`.
    pub fn of(figures: &[Option<f64>], is_worst_low: bool) -> Self {
        let sign = if is_worst_low { -1.0 } else { 1.0 };
        let ranked: Vec<_> = figures
            .iter()
            .map(|figure| figure.map_or(f64::INFINITY, |figure| sign * figure))
            .collect();
        let at = |p: f64| {
            quantile(&ranked, p)
                .filter(|figure| figure.is_finite())
                .map(|figure| sign * figure)
        };
        let (better, worse) = (at(0.1), at(0.9));
        let (p10, p90) = if is_worst_low {
            (worse, better)
        } else {
            (better, worse)
        };
        Self {
            p10,
            median: at(0.5),
            p90,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lost_runs_are_worse_than_any_and_a_median_of_mostly_lost_ones_is_null() {
        let some = |values: &[f64]| values.iter().copied().map(Some).collect::<Vec<_>>();
        let ten = some(&[1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0, 10.0]);
        let spread = Spread::of(&ten, false);
        assert_eq!(
            (spread.p10, spread.median, spread.p90),
            (Some(1.0), Some(5.0), Some(9.0))
        );
        let half = [&ten[..2], &[None, None]].concat();
        let spread = Spread::of(&half, false);
        assert_eq!(
            (spread.p10, spread.median, spread.p90),
            (Some(1.0), Some(2.0), None)
        );
        assert_eq!(
            Spread::of(&[&half[..], &[None]].concat(), false).median,
            None
        );
        // A lower bound is worse the lower it is.
        let low = Spread::of(&[Some(-1.0), Some(-2.0), Some(-3.0), None], true);
        assert_eq!(
            (low.p10, low.median, low.p90),
            (None, Some(-2.0), Some(-1.0))
        );
    }
}
