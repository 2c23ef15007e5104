//! Cost and age against the number of robots, as SVG.

use plotters::prelude::*;

use super::SwarmReport;
use crate::plot::PlotError;
use crate::plot::figure::{
    Area, BLUE, FAINT, FOOT, GREEN, HEAD, INK, Key, LEFT, ORANGE, PAPER, PINK, RIGHT, SKY, canvas,
    legend, px, text, tidy,
};

/// One quantity of the runs.
struct Line<'a> {
    name: &'a str,
    colour: RGBColor,
    points: Vec<(f64, f64)>,
}

struct Panel<'a> {
    title: &'a str,
    lines: Vec<Line<'a>>,
    /// Dashed, with a name.
    level: Option<(f64, &'a str)>,
}

/// Processor time and memory by part, and what is added to the age of plans, over the number of robots.
///
/// # Errors
/// The plot cannot be drawn.
pub fn svg(reports: &[SwarmReport]) -> Result<String, PlotError> {
    let mut reports: Vec<_> = reports.iter().collect();
    reports.sort_by_key(|report| report.robots);
    let line = |name, colour, of: &dyn Fn(&SwarmReport) -> Option<f64>| Line {
        name,
        colour,
        points: reports
            .iter()
            .filter_map(|report| Some((report.robots as f64, of(report)?)))
            .collect(),
    };
    let cpu = |name: &'static str| {
        move |report: &SwarmReport| report.part(name).map(|part| part.cpu_percent)
    };
    let memory = |name: &'static str| {
        move |report: &SwarmReport| {
            report
                .part(name)
                .map(|part| part.memory_bytes as f64 * 1e-6)
        }
    };
    let cores = reports.iter().map(|report| report.cores).max().unwrap_or(1);
    let bound = reports.first().map(|report| report.bound_ms);
    let panels = [
        Panel {
            title: "Processor time [% of a core]",
            lines: vec![
                line("agents", BLUE, &cpu("agents")),
                line("station", ORANGE, &cpu("station")),
                line("plants", GREEN, &cpu("plants")),
                line("relay", PINK, &cpu("relay")),
                line("whole machine", SKY, &|report| report.machine_cpu_percent),
            ],
            level: Some((1e2 * cores as f64, "all cores")),
        },
        Panel {
            title: "Above the injected delay, p99, up to three bounds [ms]",
            lines: vec![line("age of plans at arrival", BLUE, &|report| {
                // What does not hold may be a hundred times worse: the rest would not be seen beside it.
                Some(report.overhead_p99_ms()?.min(3.0 * report.bound_ms))
            })],
            level: bound.map(|bound| (bound, "bound")),
        },
        Panel {
            title: "Late, p99, up to 10 [ms]",
            lines: vec![
                line("station", ORANGE, &|report| {
                    Some(report.station_late_ms.p99?.min(LATE_SHOWN))
                }),
                line("control", BLUE, &|report| report.control_late_ms.p99),
                line("bare thread", SKY, &|report| report.idle_late_during_ms.p99),
            ],
            level: None,
        },
        Panel {
            title: "Memory [MB]",
            lines: vec![
                line("agents", BLUE, &memory("agents")),
                line("station", ORANGE, &memory("station")),
                line("plants", GREEN, &memory("plants")),
                line("relay", PINK, &memory("relay")),
            ],
            level: None,
        },
    ];
    let most = reports
        .last()
        .map_or(1.0, |report| report.robots as f64 * 1.03);
    let last = panels.len() - 1;
    let foot = |index| if index == last { FOOT } else { BETWEEN };
    let height: u32 = (0..panels.len())
        .map(|index| HEAD + HEIGHT + foot(index))
        .sum();
    canvas("What a swarm costs", height, |mut rest| {
        for (index, panel) in panels.iter().enumerate() {
            let (area, below) = rest.split_vertically(px(HEAD + HEIGHT + foot(index)));
            rest = below;
            let (head, body) = area.split_vertically(px(HEAD));
            legend(&head, panel.title, &keys(panel))?;
            draw(&body, panel, most, foot(index), index == last)?;
        }
        Ok(())
    })
}

fn keys<'a>(panel: &'a Panel<'a>) -> Vec<Key<'a>> {
    let lines = panel.lines.iter().map(|line| Key {
        name: line.name,
        colour: line.colour,
        width: 2.0,
    });
    let level = panel.level.map(|(_, name)| Key {
        name,
        colour: INK,
        width: 1.0,
    });
    lines.chain(level).collect()
}

fn draw(
    area: &Area<'_>,
    panel: &Panel<'_>,
    most: f64,
    foot: u32,
    last: bool,
) -> Result<(), PlotError> {
    let failed = PlotError::new;
    let points = panel.lines.iter().flat_map(|line| &line.points);
    let top = points
        .map(|point| point.1)
        .chain(panel.level.map(|(level, _)| level))
        .fold(0.0, f64::max)
        .max(1e-3);
    let mut chart = ChartBuilder::on(area)
        .margin_right(px(RIGHT))
        .set_label_area_size(LabelAreaPosition::Left, px(LEFT))
        .set_label_area_size(LabelAreaPosition::Bottom, px(foot))
        .build_cartesian_2d(0.0..most, 0.0..1.08 * top)
        .map_err(failed)?;
    let plain = |value: &f64| tidy(*value);
    let none = |_: &f64| String::new();
    let mut mesh = chart.configure_mesh();
    mesh.light_line_style(PAPER.mix(0.0))
        .bold_line_style(FAINT.stroke_width(px(1)))
        .axis_style(INK.stroke_width(px(1)))
        .label_style(text(12.0))
        .axis_desc_style(text(13.0))
        .x_labels(12)
        .y_labels(6)
        .y_label_formatter(&plain)
        .set_all_tick_mark_size(px(4));
    if last {
        mesh.x_desc("robots").x_label_formatter(&plain);
    } else {
        mesh.x_label_formatter(&none);
    }
    mesh.draw().map_err(failed)?;
    if let Some((level, _)) = panel.level {
        let style = INK.stroke_width(px(1));
        let ends = [(0.0, level), (most, level)];
        chart
            .draw_series(DashedLineSeries::new(ends, px(6), px(4), style))
            .map_err(failed)?;
    }
    for line in &panel.lines {
        let style = line.colour.stroke_width(px(2));
        chart
            .draw_series([PathElement::new(line.points.clone(), style)])
            .map_err(failed)?;
        let dots = line.points.iter();
        chart
            .draw_series(dots.map(|point| Circle::new(*point, px(4), line.colour.filled())))
            .map_err(failed)?;
    }
    Ok(())
}

/// Lateness of the station that is shown [ms].
const LATE_SHOWN: f64 = 10.0;
/// Height of a panel's data [px].
const HEIGHT: u32 = 150;
/// Room beneath a panel that is not the last [px].
const BETWEEN: u32 = 12;
