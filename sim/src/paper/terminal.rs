//! The tables for a terminal of 100 columns.

use core::fmt::Write;

use super::Results;
use super::experiment::{Case, Experiment};
use super::indicator::Indicator;
use super::table::{Cell, Spread};
use super::verdict;
use crate::report::{BOLD, RESET};

/// Every table, then who wins where. `colour` may be true only if a terminal reads.
pub fn summary(results: &Results, colour: bool) -> String {
    let (bold, plain) = if colour { (BOLD, RESET) } else { ("", "") };
    let mut text = String::new();
    for group in results.table.groups() {
        let case = group[0].case;
        let heading = format!("{} · {}", case.heading(), case.experiment.source());
        writeln!(text, "{bold}{heading}{plain}\n{}", table(group)).expect("text grows");
    }
    if !results.table.drifts.is_empty() {
        writeln!(text, "{bold}without position fixes{plain}").expect("text grows");
        for line in drifts(results) {
            writeln!(text, "{line}").expect("text grows");
        }
        text.push('\n');
    }
    let seeds = results.seeds;
    writeln!(
        text,
        "Medians over {seeds} {} (ideal: 1), 10 and 90 % quantiles behind them.\n\
         paper H/F: what it prints of its hardware for HTSMC and fuzzy-PID.",
        if seeds == 1 { "seed" } else { "seeds" }
    )
    .expect("text grows");
    for sentence in verdict::sentences(results) {
        writeln!(text, "{}", wrapped(&sentence)).expect("text grows");
    }
    text
}

/// One group of cases: an indicator a line, a controller a column.
fn table(group: &[Cell]) -> String {
    let experiment = group[0].case.experiment;
    let mut lines = vec![header(group)];
    for indicator in shown(experiment) {
        let mut line = vec![indicator.label().to_owned()];
        line.extend(group.iter().map(|cell| entry(cell, indicator)));
        if experiment.is_direction() {
            line.push(printed(group, indicator));
        }
        lines.push(line);
    }
    let mut fell = vec!["fell".to_owned()];
    let count = |cell: &Cell| format!("{} of {}", cell.fell, cell.runs);
    fell.extend(group.iter().map(count));
    lines.push(fell);
    aligned(&lines)
}

fn header(group: &[Cell]) -> Vec<String> {
    let mut header = vec![String::new()];
    header.extend(
        group
            .iter()
            .map(|cell| cell.case.controller.name().to_owned()),
    );
    if group[0].case.experiment.is_direction() {
        header.push("paper H/F".to_owned());
    }
    header
}

/// The indicators of an experiment.
pub(super) fn shown(experiment: Experiment) -> impl Iterator<Item = Indicator> {
    Indicator::ALL
        .into_iter()
        .filter(move |indicator| indicator.applies(experiment))
}

/// Median and deciles of one indicator of one case.
pub(super) fn entry(cell: &Cell, indicator: Indicator) -> String {
    cell.spread(indicator).map_or_else(String::new, |spread| {
        spread_text(&spread, indicator.shown())
    })
}

fn spread_text(spread: &Spread, factor: f64) -> String {
    let text = |figure: Option<f64>| {
        figure.map_or_else(|| "never".to_owned(), |figure| number(factor * figure))
    };
    match spread {
        Spread {
            p10: None,
            median: None,
            p90: None,
        } => "never".to_owned(),
        Spread { p10, median, p90 } => {
            format!("{} {}…{}", text(*median), text(*p10), text(*p90))
        }
    }
}

/// The paper's numbers of HTSMC and fuzzy-PID.
fn printed(group: &[Cell], indicator: Indicator) -> String {
    let numbers: Vec<_> = [0, 2]
        .iter()
        .filter_map(|index| {
            let case: &Case = &group.get(*index)?.case;
            indicator.printed(case).map(number)
        })
        .collect();
    numbers.join("/")
}

/// Three digits that mean something, at most two behind the point.
pub(super) fn number(value: f64) -> String {
    let digits = match value.abs() {
        size if size < 9.995 => 2,
        size if size < 99.95 => 1,
        _ => 0,
    };
    let text = format!("{value:.digits$}");
    // Not "-0.00".
    if text.trim_start_matches(['-', '0', '.']).is_empty() {
        text.trim_start_matches('-').to_owned()
    } else {
        text
    }
}

/// Dead reckoning, a case a line.
pub(super) fn drifts(results: &Results) -> Vec<String> {
    let line = |drift: &super::Drift| {
        let spread = spread_text(&drift.spread, 1e3);
        format!(
            "{}: estimate off by {spread} mm for each metre driven",
            drift.case.heading()
        )
    };
    results.table.drifts.iter().map(line).collect()
}

/// Cells in columns, the first to the left, the others to the right.
fn aligned(lines: &[Vec<String>]) -> String {
    let columns = lines.iter().map(Vec::len).max().unwrap_or(0);
    let width = |column: usize| {
        let widths = lines.iter().filter_map(|line| line.get(column));
        widths.map(|cell| cell.chars().count()).max().unwrap_or(0)
    };
    let widths: Vec<_> = (0..columns).map(width).collect();
    let mut text = String::new();
    for line in lines {
        let mut written = String::new();
        for (column, (cell, width)) in line.iter().zip(&widths).enumerate() {
            if column == 0 {
                write!(written, "{cell:<width$}").expect("text grows");
            } else {
                write!(written, "  {cell:>width$}").expect("text grows");
            }
        }
        writeln!(text, "{}", written.trim_end()).expect("text grows");
    }
    text
}

/// Lines of at most [`COLUMNS`], all but the first indented.
fn wrapped(sentence: &str) -> String {
    let mut lines = vec![String::new()];
    for word in sentence.split(' ') {
        let last = lines.last_mut().expect("one is there from the start");
        if last.chars().count() + 1 + word.chars().count() > COLUMNS {
            lines.push(format!("  {word}"));
        } else {
            if !last.is_empty() {
                last.push(' ');
            }
            last.push_str(word);
        }
    }
    lines.join("\n")
}

/// Width of a terminal.
const COLUMNS: usize = 100;
