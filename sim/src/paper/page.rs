//! `report.html`: every figure and table on one page that needs nothing else, light or dark as the reader's system is.

use core::fmt::Write;

use super::experiment::{Controller, Experiment, environment_name};
use super::figures::drawn;
use super::indicator::Indicator;
use super::table::Cell;
use super::terminal::{drifts, entry, number, shown};
use super::{ENVIRONMENTS_SHOWN, Results, SEED_SHOWN, verdict};
use crate::plot::PlotError;

/// The page.
///
/// # Errors
/// If a figure cannot be drawn.
pub fn html(results: &Results) -> Result<String, PlotError> {
    let mut body = String::new();
    introduction(&mut body, results);
    for experiment in &results.experiments {
        section(&mut body, results, *experiment)?;
    }
    dead_reckoning(&mut body, results);
    definitions(&mut body);
    Ok(format!(
        "<!doctype html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n\
         <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n\
         <meta name=\"color-scheme\" content=\"light dark\">\n<title>The paper's experiments</title>\n\
         <style>\n{STYLE}{}</style>\n</head>\n<body>\n{}<main>\n{body}</main>\n</body>\n</html>\n",
        choice_style(),
        choice(),
    ))
}

fn introduction(body: &mut String, results: &Results) {
    let names: Vec<_> = results.experiments.iter().map(|e| e.name()).collect();
    let runs: usize = results.table.cells.iter().map(|cell| cell.runs).sum();
    let seeds = match results.seeds {
        1 => "seed 1".to_owned(),
        last => format!("the seeds 1 to {last}"),
    };
    push(
        body,
        format_args!(
            "<h1>The paper's experiments</h1>\n\
             <p>Experiments of Liu et al., <i>Direction and Trajectory Tracking Control for Nonholonomic Spherical Robot by Combining Sliding Mode \
             Controller and Model Prediction Controller</i>, in simulation: {}. Sphere Fleet {}; {runs} runs, each case with {seeds}, in the environments \
             real and calibrated, and with seed 1 in ideal, where nothing is random. The deployed agent, estimator and station are in the loop, on a three-dimensional plant in virtual time, without delay on the network.</p>\n\
             <p>None of this ran on hardware. The robot's parameters are estimates, for the paper prints none; its own numbers, of its hardware, stand beside for comparison. \
             <i>Ideal</i>: exact sensors, motors without lag and friction. <i>Real</i>: noisy sensors, motors with lag, delay and friction, a shell out of balance by 0.2 N·m. \
             <i>Calibrated</i>: 2.3 N·m and 0.5 N·m of joint friction, chosen so that the paper's plain law shows the steady errors that the paper reports.</p>\n",
            names.join(", "),
            env!("CARGO_PKG_VERSION"),
        ),
    );
    body.push_str("<h2>Who wins where</h2>\n<ul class=\"verdict\">\n");
    for sentence in verdict::sentences(results) {
        push(body, format_args!("<li>{}</li>\n", escaped(&sentence)));
    }
    body.push_str("</ul>\n<p class=\"small\">Made from the medians below. Indicators whose sign or size says nothing of quality (e_m) are not compared; medians within 1 % count as equal.</p>\n");
}

fn section(body: &mut String, results: &Results, experiment: Experiment) -> Result<(), PlotError> {
    push(
        body,
        format_args!(
            "<section id=\"{}\">\n<h2>{} <small>{}</small></h2>\n",
            experiment.name(),
            experiment.title(),
            experiment.source()
        ),
    );
    for environment in ENVIRONMENTS_SHOWN {
        let name = environment_name(environment);
        push(body, format_args!("<div class=\"world {name}\">\n"));
        for figure in drawn(results, experiment, environment)? {
            push(
                body,
                format_args!(
                    "<figure>\n{}\n<figcaption>{} Seed {SEED_SHOWN}, {name}.</figcaption>\n</figure>\n",
                    figure.svg,
                    escaped(&figure.caption)
                ),
            );
        }
        body.push_str("</div>\n");
    }
    let of = |group: &&[Cell]| group[0].case.experiment == experiment;
    for group in results.table.groups().filter(of) {
        table(body, group);
    }
    body.push_str("</section>\n");
    Ok(())
}

/// One group of cases: a controller a line, an indicator a column.
fn table(body: &mut String, group: &[Cell]) {
    let case = group[0].case;
    push(
        body,
        format_args!(
            "<div class=\"wide\"><table>\n<caption>{}</caption>\n<tr><th></th>",
            case.heading()
        ),
    );
    for indicator in shown(case.experiment) {
        let (label, unit) = indicator
            .label()
            .rsplit_once(' ')
            .unwrap_or((indicator.label(), ""));
        push(
            body,
            format_args!("<th>{label}<br><small>{unit}</small></th>"),
        );
    }
    body.push_str("<th>fell</th></tr>\n");
    for cell in group {
        let title = cell.case.controller.title();
        push(body, format_args!("<tr><th>{}</th>", escaped(title)));
        for indicator in shown(case.experiment) {
            let entry = entry(cell, indicator);
            let (median, spread) = entry.split_once(' ').unwrap_or((&entry, ""));
            push(
                body,
                format_args!("<td><b>{median}</b><br><small>{spread}</small></td>"),
            );
        }
        push(
            body,
            format_args!("<td>{}/{}</td></tr>\n", cell.fell, cell.runs),
        );
    }
    let printed = [
        ("the paper's HTSMC", Controller::Htsmc),
        ("the paper's fuzzy-PID", Controller::FuzzyPid),
    ];
    for (name, controller) in printed {
        let Some(cell) = group.iter().find(|cell| cell.case.controller == controller) else {
            continue;
        };
        push(body, format_args!("<tr class=\"paper\"><th>{name}</th>"));
        for indicator in shown(case.experiment) {
            let text = indicator
                .printed(&cell.case)
                .map_or_else(String::new, number);
            push(body, format_args!("<td>{text}</td>"));
        }
        body.push_str("<td></td></tr>\n");
    }
    body.push_str("</table></div>\n");
}

fn dead_reckoning(body: &mut String, results: &Results) {
    if results.table.drifts.is_empty() {
        return;
    }
    body.push_str(
        "<section id=\"drift\">\n<h2>Without position fixes</h2>\n<p>The trajectories above are tracked with a position fix every 0.1 s (2 cm of noise in real and \
         calibrated, none in ideal). Without them, as in the paper, the robot follows its own dead reckoning. Distance of the estimated from the true centre at the end of the run, over the path driven, \
         MHH, median and 10 and 90 % quantiles:</p>\n<ul>\n",
    );
    for line in drifts(results) {
        push(body, format_args!("<li>{}</li>\n", escaped(&line)));
    }
    body.push_str("</ul>\n</section>\n");
}

fn definitions(body: &mut String) {
    body.push_str(
        "<section id=\"definitions\">\n<h2>Definitions</h2>\n<p>Tables give the median over the seeds and, small, the 10 and 90 % quantiles (nearest rank). A run in which the robot falls \
         over or latches a fault counts as worse than any other in every indicator; one that never rises, settles or comes near counts so in that one. <i>never</i>: that rank is such a run. \
         Errors are true minus typed: never from the estimate, and never against a filtered reference. Where the paper's tables head angles with m/s they are degrees.</p>\n<dl>\n",
    );
    for indicator in Indicator::ALL {
        push(
            body,
            format_args!(
                "<dt>{} <code>{}</code></dt><dd>{}</dd>\n",
                indicator.label(),
                indicator.name(),
                indicator.definition()
            ),
        );
    }
    body.push_str("</dl>\n</section>\n");
}

/// The choice of the environment, ahead of all so that styles reach what follows it.
fn choice() -> String {
    let mut text = String::new();
    for (index, environment) in ENVIRONMENTS_SHOWN.into_iter().enumerate() {
        let name = environment_name(environment);
        let checked = if index == 0 { " checked" } else { "" };
        push(
            &mut text,
            format_args!("<input type=\"radio\" name=\"world\" id=\"world-{name}\"{checked}>"),
        );
    }
    text.push_str("\n<nav>Figures in");
    for environment in ENVIRONMENTS_SHOWN {
        let name = environment_name(environment);
        push(
            &mut text,
            format_args!(" <label for=\"world-{name}\">{name}</label>"),
        );
    }
    text.push_str("</nav>\n");
    text
}

fn choice_style() -> String {
    let mut text = String::new();
    for environment in ENVIRONMENTS_SHOWN {
        let name = environment_name(environment);
        push(
            &mut text,
            format_args!(
                "#world-{name}:checked ~ main .world:not(.{name}) {{ display: none }}\n\
                 #world-{name}:checked ~ nav label[for=world-{name}] {{ background: var(--ink); color: var(--paper) }}\n\
                 #world-{name}:focus-visible ~ nav label[for=world-{name}] {{ outline: 2px solid var(--blue) }}\n"
            ),
        );
    }
    text
}

fn escaped(text: &str) -> String {
    text.replace('&', "&amp;")
        .replace('<', "&lt;")
        .replace('>', "&gt;")
}

fn push(text: &mut String, what: core::fmt::Arguments<'_>) {
    text.write_fmt(what).expect("text grows");
}

/// Figures are drawn in the colours of a light page; in the dark each of these becomes its counterpart.
const STYLE: &str = include_str!("page.css");
