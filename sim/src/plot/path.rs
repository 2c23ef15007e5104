//! Paths on the floor, a metre as long in every direction.

use plotters::coord::types::RangedCoordf64;
use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};
use sphere_protocol::robot::RobotId;

use super::figure::{
    AMBER, Area, BLUE, FAINT, FOOT, GREEN, GREY, HEAD, INK, Key, LEFT, ORANGE, PAPER, PINK, RIGHT,
    SKY, WIDTH, canvas, legend, px, text, tidy,
};
use super::{PlotError, Subject, title};
use crate::trace::{Row, Trace};

type Floor<'a, 'b> = ChartContext<'a, SVGBackend<'b>, Cartesian2d<RangedCoordf64, RangedCoordf64>>;
type Points = Vec<(f64, f64)>;

const MISSION: Key<'static> = Key {
    name: "mission",
    colour: GREY,
    width: 6.0,
};
/// Width of the floor [px].
const FLOOR: u32 = WIDTH - LEFT - RIGHT;

/// The path of one robot over its reference.
pub(super) fn robot(rows: &[&Row], subject: Subject<'_>) -> Result<String, PlotError> {
    let (truth, reference) = (truth(rows), reference(rows));
    let keys = [
        MISSION,
        Key {
            name: "true",
            colour: BLUE,
            width: 1.8,
        },
    ];
    let view = View::of([&truth, &reference].into_iter().flatten());
    view.svg(&title(subject, "path of the centre"), "", &keys, |chart| {
        draw_line(chart, reference.clone(), GREY, 6)?;
        draw_line(chart, truth.clone(), BLUE, 2)?;
        // Beside each other where the path ends where it began.
        mark(chart, truth.first(), "start", GREEN, HPos::Right)?;
        mark(chart, truth.last(), "end", ORANGE, HPos::Left)
    })
}

/// The paths of all robots.
pub(super) fn fleet(trace: &Trace, robots: &[RobotId], run: &str) -> Result<String, PlotError> {
    const COLOURS: [RGBColor; 6] = [BLUE, ORANGE, GREEN, PINK, AMBER, SKY];
    /// More names than this cover each other.
    const NAMED: usize = 24;
    let paths: Vec<_> = robots
        .iter()
        .map(|robot| truth(&trace.rows_of(*robot)))
        .collect();
    let missions: Vec<_> = robots
        .iter()
        .map(|robot| reference(&trace.rows_of(*robot)))
        .collect();
    let view = View::of(paths.iter().chain(&missions).flatten());
    let title = format!("Paths of {} robots ({run})", robots.len());
    let keys = [MISSION];
    view.svg(&title, ", dots where they ended", &keys, |chart| {
        for mission in &missions {
            draw_line(chart, mission.clone(), GREY, 6)?;
        }
        for (path, colour) in paths.iter().zip(COLOURS.into_iter().cycle()) {
            draw_line(chart, path.clone(), colour, 2)?;
        }
        for ((path, colour), robot) in paths.iter().zip(COLOURS.into_iter().cycle()).zip(robots) {
            let name = if robots.len() <= NAMED {
                robot.as_str()
            } else {
                ""
            };
            mark(chart, path.last(), name, colour, HPos::Left)?;
        }
        Ok(())
    })
}

/// Several paths over the one that was to be driven. What is far from it is not shown.
#[cfg(feature = "io")]
pub(crate) fn compared(
    title: &str,
    mission: Points,
    driven: &[(&str, RGBColor, Points)],
) -> Result<String, PlotError> {
    /// Farther than this from the mission's extent nothing is shown [m].
    const AROUND: f64 = 1.0;
    /// Between two points [m].
    const SPACING: f64 = 0.02;
    let mission = spaced_by(mission.into_iter(), SPACING);
    let extent = |of: fn(&(f64, f64)) -> f64| {
        let values = mission.iter().map(of);
        values.fold((0.0_f64, 0.0_f64), |(low, high), value| {
            (low.min(value), high.max(value))
        })
    };
    let (x, y) = (extent(|p| p.0), extent(|p| p.1));
    let near = |p: &(f64, f64)| {
        let within = |value: f64, (low, high)| (low - AROUND..=high + AROUND).contains(&value);
        within(p.0, x) && within(p.1, y)
    };
    let driven: Vec<_> = driven
        .iter()
        .map(|(name, colour, points)| {
            let points = points.iter().copied().filter(|p| near(p));
            (*name, *colour, spaced_by(points, SPACING))
        })
        .collect();
    let mut keys = vec![Key {
        name: "mission",
        colour: GREY,
        width: 6.0,
    }];
    keys.extend(driven.iter().map(|(name, colour, _)| Key {
        name,
        colour: *colour,
        width: 1.8,
    }));
    let all = driven.iter().flat_map(|(_, _, points)| points);
    let view = View::of(mission.iter().chain(all));
    view.svg(title, "", &keys, |chart| {
        draw_line(chart, mission.clone(), GREY, 6)?;
        // The first on top.
        for (_, colour, points) in driven.iter().rev() {
            draw_line(chart, points.clone(), *colour, 2)?;
        }
        let start = driven.first().and_then(|(_, _, points)| points.first());
        mark(chart, start, "start", INK, HPos::Right)
    })
}

/// The part of the floor that is shown.
struct View {
    x: (f64, f64),
    y: (f64, f64),
    /// Height of the floor [px].
    height: u32,
}

impl View {
    /// A view of every point, with the same scale on both axes.
    fn of<'a>(points: impl Iterator<Item = &'a (f64, f64)>) -> Self {
        let none = (f64::INFINITY, f64::NEG_INFINITY);
        let (x, y) = points.fold((none, none), |(x, y), point| {
            (
                (x.0.min(point.0), x.1.max(point.0)),
                (y.0.min(point.1), y.1.max(point.1)),
            )
        });
        let middle = |(low, high): (f64, f64)| if low <= high { 0.5 * (low + high) } else { 0.0 };
        // Half a metre of room and what a name beside a path's end takes, and at least two metres of floor.
        let half = |(low, high): (f64, f64)| (0.56 * (high - low)).max(0.5) + 0.5;
        let (half_x, half_y) = (half(x), half(y));
        let wide = f64::from(FLOOR);
        let height = (wide * half_y / half_x).clamp(260.0, 700.0).round();
        let metres_per_px = (half_x / wide).max(half_y / height);
        let around =
            |middle: f64, px: f64| (middle - metres_per_px * px, middle + metres_per_px * px);
        Self {
            x: around(middle(x), wide),
            y: around(middle(y), height),
            height: height as u32,
        }
    }

    fn svg(
        &self,
        title: &str,
        subtitle: &str,
        keys: &[Key<'_>],
        draw: impl FnOnce(&mut Floor<'_, '_>) -> Result<(), PlotError>,
    ) -> Result<String, PlotError> {
        canvas(title, HEAD + self.height + FOOT, |area: Area<'_>| {
            let (head, body) = area.split_vertically(px(HEAD));
            legend(&head, &format!("Y [m]{subtitle}"), keys)?;
            let mut chart = ChartBuilder::on(&body)
                .margin_right(px(RIGHT))
                .set_label_area_size(LabelAreaPosition::Left, px(LEFT))
                .set_label_area_size(LabelAreaPosition::Bottom, px(FOOT))
                .build_cartesian_2d(self.x.0..self.x.1, self.y.0..self.y.1)
                .map_err(PlotError::new)?;
            chart
                .configure_mesh()
                .light_line_style(PAPER.mix(0.0))
                .bold_line_style(FAINT.stroke_width(px(1)))
                .axis_style(INK.stroke_width(px(1)))
                .label_style(text(12.0))
                .axis_desc_style(text(13.0))
                .set_all_tick_mark_size(px(4))
                .x_labels(12)
                .y_labels(usize::try_from(self.height / 36).unwrap_or(6).max(3))
                .x_label_formatter(&|x| tidy(*x))
                .y_label_formatter(&|y| tidy(*y))
                .x_desc("X [m]")
                .draw()
                .map_err(PlotError::new)?;
            draw(&mut chart)
        })
    }
}

fn draw_line(
    chart: &mut Floor<'_, '_>,
    points: Points,
    colour: RGBColor,
    width: u32,
) -> Result<(), PlotError> {
    chart
        .draw_series([PathElement::new(points, colour.stroke_width(px(width)))])
        .map(|_| ())
        .map_err(PlotError::new)
}

/// A dot with a name beside it, on a light ground so that it reads over lines.
fn mark(
    chart: &mut Floor<'_, '_>,
    place: Option<&(f64, f64)>,
    name: &str,
    colour: RGBColor,
    side: HPos,
) -> Result<(), PlotError> {
    let Some(place) = place else { return Ok(()) };
    let shift = match side {
        HPos::Right => -(px(10) as i32),
        _ => px(10) as i32,
    };
    let dot = EmptyElement::at(*place)
        + Circle::new((0, 0), px(6), PAPER.filled())
        + Circle::new((0, 0), px(5), colour.filled());
    chart.draw_series([dot]).map_err(PlotError::new)?;
    // A halo of the paper's colour, then the name.
    let halo = px(2) as i32;
    let around = [
        (-halo, 0),
        (halo, 0),
        (0, -halo),
        (0, halo),
        (-halo, -halo),
        (halo, halo),
        (halo, -halo),
        (-halo, halo),
    ];
    let copies = around
        .into_iter()
        .map(|offset| (offset, PAPER))
        .chain([((0, 0), INK)]);
    for ((dx, dy), colour) in copies {
        let at = (shift + dx, dy - px(11) as i32);
        let style = text(12.5).color(&colour).pos(Pos::new(side, VPos::Center));
        let name = EmptyElement::at(*place) + Text::new(name.to_owned(), at, style);
        chart.draw_series([name]).map_err(PlotError::new)?;
    }
    Ok(())
}

fn truth(rows: &[&Row]) -> Points {
    spaced(rows.iter().map(|row| (row.truth.x, row.truth.y)))
}

fn reference(rows: &[&Row]) -> Points {
    spaced(rows.iter().filter_map(|row| {
        let pose = row.reference?.pose?;
        Some((pose.x, pose.y))
    }))
}

/// The finite points, less those within 2 mm of the one before: standing still needs no thousand points.
fn spaced(points: impl Iterator<Item = (f64, f64)>) -> Points {
    spaced_by(points, 2e-3)
}

/// The finite points, less those within `spacing` of the one before [m].
fn spaced_by(points: impl Iterator<Item = (f64, f64)>, spacing: f64) -> Points {
    let mut kept: Points = Vec::new();
    for point in points.filter(|point| point.0.is_finite() && point.1.is_finite()) {
        let moved = |last: &(f64, f64)| (point.0 - last.0).hypot(point.1 - last.1) >= spacing;
        if kept.last().is_none_or(moved) {
            kept.push(point);
        }
    }
    kept
}
