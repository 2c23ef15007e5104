//! Who wins where, in sentences made from the medians.

use core::cmp::Ordering;

use super::Results;
use super::experiment::{Case, Controller, ENVIRONMENTS, Experiment, environment_name};
use super::indicator::Indicator;
use super::table::Cell;

/// One comparison: an indicator of the cases that differ in the controller alone.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Match {
    /// One of the cases.
    pub case: Case,
    /// What was compared.
    pub indicator: Indicator,
    /// Who won; `None` if two were equal, or all lost.
    pub winner: Option<Controller>,
}

/// Every comparison between `rivals`, or between all if there are none.
pub fn matches(results: &Results, rivals: &[Controller]) -> Vec<Match> {
    let mut matches = Vec::new();
    for group in results.table.groups() {
        let takes_part = |cell: &&Cell| rivals.is_empty() || rivals.contains(&cell.case.controller);
        let cells: Vec<_> = group.iter().filter(takes_part).collect();
        if cells.len() < 2 {
            continue;
        }
        let case = cells[0].case;
        let compared =
            |indicator: &Indicator| indicator.is_quality() && indicator.applies(case.experiment);
        for indicator in Indicator::ALL.into_iter().filter(compared) {
            matches.push(Match {
                case,
                indicator,
                winner: winner(&cells, indicator),
            });
        }
    }
    matches
}

/// Who has the smallest median in magnitude; `None` if the next one is within [`EQUAL`] of it.
fn winner(cells: &[&Cell], indicator: Indicator) -> Option<Controller> {
    let magnitude = |cell: &&Cell| {
        let median = cell.median(indicator);
        median.map_or(f64::INFINITY, f64::abs)
    };
    let mut ranked: Vec<_> = cells
        .iter()
        .map(|cell| (magnitude(cell), cell.case.controller))
        .collect();
    ranked.sort_by(|a, b| a.0.total_cmp(&b.0));
    let [(best, controller), (second, _), ..] = ranked[..] else {
        return None;
    };
    (best.is_finite() && second - best > EQUAL * second).then_some(controller)
}

/// The sentences, one a line.
pub fn sentences(results: &Results) -> Vec<String> {
    let mut sentences = Vec::new();
    for experiment in &results.experiments {
        sentences.extend(best_of(results, *experiment));
    }
    for (name, ours, other) in [
        ("Direction", Controller::Htsmc, Controller::FuzzyPid),
        ("Direction", Controller::Htsmc, Controller::HtsmcPaper),
        ("Trajectories", Controller::Mhh, Controller::Mhf),
        ("Trajectories", Controller::Mhh, Controller::MhhPaper),
    ] {
        sentences.extend(duel(results, name, ours, other));
    }
    sentences.push(falls(results));
    sentences.extend(in_short(results));
    sentences
}

/// Of each environment: who wins more often, of the two pairs that the paper compares.
fn in_short(results: &Results) -> Option<String> {
    let pairs = [
        (Controller::Htsmc, Controller::FuzzyPid),
        (Controller::Mhh, Controller::Mhf),
    ];
    let outcome = |environment, (ours, other): (Controller, Controller)| {
        let all = matches(results, &[ours, other]);
        let wins = |controller| {
            let won = won_by(&all, controller);
            let here = |one: &&Match| one.case.environment == environment;
            won.iter().filter(here).count()
        };
        let (a, b) = (wins(ours), wins(other));
        let (ours, other) = (ours.name(), other.name());
        (!all.is_empty()).then(|| match a.cmp(&b) {
            Ordering::Greater => format!("{ours} beats {other} {a} to {b}"),
            Ordering::Less => format!("{other} beats {ours} {b} to {a}"),
            Ordering::Equal => format!("{ours} and {other} are equal, {a} to {b}"),
        })
    };
    let places: Vec<_> = ENVIRONMENTS
        .into_iter()
        .filter_map(|environment| {
            let outcomes: Vec<_> = pairs
                .into_iter()
                .filter_map(|pair| outcome(environment, pair))
                .collect();
            let name = environment_name(environment);
            (!outcomes.is_empty()).then(|| format!("{name}: {}", outcomes.join(", ")))
        })
        .collect();
    (!places.is_empty()).then(|| format!("In short: {}.", places.join("; ")))
}

/// Of one experiment: how often each controller has the best median, and where the others have it.
fn best_of(results: &Results, experiment: Experiment) -> Option<String> {
    let all = matches(results, &[]);
    let all: Vec<_> = all
        .into_iter()
        .filter(|one| one.case.experiment == experiment)
        .collect();
    if all.is_empty() {
        return None;
    }
    let mut wins: Vec<(usize, Controller)> = experiment
        .controllers()
        .iter()
        .map(|controller| (won_by(&all, *controller).len(), *controller))
        .filter(|(count, _)| *count > 0)
        .collect();
    wins.sort_by_key(|(count, _)| core::cmp::Reverse(*count));
    let won: usize = wins.iter().map(|(count, _)| count).sum();
    let mut parts: Vec<_> = wins
        .iter()
        .map(|(count, controller)| format!("{} {count}", controller.name()))
        .collect();
    if won < all.len() {
        parts.push(format!("nobody {}", all.len() - won));
    }
    Some(format!(
        "{}: best of {} medians: {}.",
        experiment.name(),
        all.len(),
        parts.join(", ")
    ))
}

/// Of two controllers: how often each is better, and where the second is.
fn duel(results: &Results, name: &str, ours: Controller, other: Controller) -> Option<String> {
    let all = matches(results, &[ours, other]);
    if all.is_empty() {
        return None;
    }
    let (better, worse) = (won_by(&all, ours), won_by(&all, other));
    let equal: Vec<_> = all
        .iter()
        .filter(|one| one.winner.is_none())
        .copied()
        .collect();
    let by_environment: Vec<_> = ENVIRONMENTS
        .iter()
        .map(|environment| {
            let of = |matches: &[Match]| {
                let here = |one: &&Match| one.case.environment == *environment;
                matches.iter().filter(here).count()
            };
            let name = environment_name(*environment);
            format!("{name} {} of {}", of(&better), of(&all))
        })
        .collect();
    let mut text = format!(
        "{name}: {} has the better median than {} in {} of {} comparisons ({})",
        ours.name(),
        other.name(),
        better.len(),
        all.len(),
        by_environment.join(", ")
    );
    if !equal.is_empty() {
        text.push_str(&format!(", an equal one in {}", equal.len()));
    }
    if worse.is_empty() {
        text.push_str(", a worse one in none.");
    } else {
        let places = places(&worse);
        let count = worse.len();
        text.push_str(&format!(
            "; {} is the better one in {count}: {places}.",
            other.name()
        ));
    }
    Some(text)
}

fn won_by(matches: &[Match], controller: Controller) -> Vec<Match> {
    let won = |one: &&Match| one.winner == Some(controller);
    matches.iter().filter(won).copied().collect()
}

/// Where comparisons stand: by experiment and environment, the indicators.
fn places(matches: &[Match]) -> String {
    let together = |a: &Match, b: &Match| a.case.is_rival(&b.case);
    let place = |group: &[Match]| {
        let case = group[0].case;
        let indicators: Vec<_> = group.iter().map(|one| one.indicator.words()).collect();
        format!("{} ({})", indicators.join(", "), case.heading())
    };
    let places: Vec<_> = matches.chunk_by(together).map(place).collect();
    places.join("; ")
}

/// Who fell, and whether anything else broke.
fn falls(results: &Results) -> String {
    let runs: usize = results.table.cells.iter().map(|cell| cell.runs).sum();
    let fell: usize = results.table.cells.iter().map(|cell| cell.fell).sum();
    let mut text = if fell == 0 {
        format!("No robot fell in the {runs} runs of the tables.")
    } else {
        let fallen = results.table.cells.iter().filter(|cell| cell.fell > 0);
        let each: Vec<_> = fallen
            .map(|cell| {
                format!(
                    "{} {} of {} ({})",
                    cell.case.controller.name(),
                    cell.fell,
                    cell.runs,
                    cell.case.heading()
                )
            })
            .collect();
        format!(
            "The robot fell in {fell} of the {runs} runs of the tables: {}.",
            each.join("; ")
        )
    };
    for cell in &results.table.cells {
        for (rule, runs) in &cell.broken {
            let (name, place) = (cell.case.controller.name(), cell.case.heading());
            text.push_str(&format!(
                " {name} broke the invariant {rule} in {runs} of {} runs ({place}).",
                cell.runs
            ));
        }
    }
    text
}

/// Medians closer than this share of the larger one count as equal.
const EQUAL: f64 = 0.01;
