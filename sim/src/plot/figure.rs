//! A figure: a title and panels over one time axis, as SVG with a background of its own.
//!
//! plotters rounds to whole pixels and puts legends over the data. So a figure is drawn [`FINE`] times as large as it is shown,
//! and each panel's legend stands in the line of its title.

use plotters::coord::Shift;
use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};

use super::PlotError;

/// A place to draw: the whole figure or part of it.
pub(crate) type Area<'a> = DrawingArea<SVGBackend<'a>, Shift>;

/// Lengths inside a figure are this many times those shown: coordinates are rounded to whole numbers.
const FINE: u32 = 8;
/// Width of every figure [px].
pub(crate) const WIDTH: u32 = 960;
/// Room beside a panel for its vertical axis [px].
pub(crate) const LEFT: u32 = 64;
/// Room to the right of a panel [px].
pub(crate) const RIGHT: u32 = 24;
/// Height of the figure's title [px].
const TITLE: u32 = 44;
/// Height of a panel's title and legend [px].
pub(crate) const HEAD: u32 = 30;
/// Height of the time axis's labels [px].
pub(crate) const FOOT: u32 = 50;

// Okabe and Ito's palette: told apart by every common kind of colour vision.
/// What is true.
pub(crate) const BLUE: RGBColor = RGBColor(0, 114, 178);
/// What is commanded.
pub(crate) const ORANGE: RGBColor = RGBColor(213, 94, 0);
/// A third line.
pub(crate) const GREEN: RGBColor = RGBColor(0, 158, 115);
/// A fourth.
pub(crate) const PINK: RGBColor = RGBColor(204, 121, 167);
/// A fifth.
pub(crate) const SKY: RGBColor = RGBColor(86, 180, 233);
/// A sixth.
pub(crate) const AMBER: RGBColor = RGBColor(230, 159, 0);
/// References, drawn broad beneath what should follow them.
pub(crate) const GREY: RGBColor = RGBColor(190, 190, 190);
/// Titles, and lines that are no data.
pub(crate) const INK: RGBColor = RGBColor(40, 40, 40);
/// Grid.
pub(crate) const FAINT: RGBColor = RGBColor(232, 232, 232);
/// Background.
pub(crate) const PAPER: RGBColor = RGBColor(255, 255, 255);

/// Panels one above the other that share the time axis.
pub(crate) struct Figure<'a> {
    pub(crate) title: String,
    /// Beginning and end of the time axis [s].
    pub(crate) time: (f64, f64),
    pub(crate) panels: Vec<Panel<'a>>,
}

/// One panel: lines over time.
pub(crate) struct Panel<'a> {
    /// Quantity and unit: plotters would cut a text that stands along the axis.
    pub(crate) title: &'a str,
    /// Height of the data's part [px].
    pub(crate) height: u32,
    pub(crate) range: (f64, f64),
    pub(crate) lines: Vec<Line<'a>>,
    /// Dashed levels with a name.
    pub(crate) levels: Vec<(f64, &'a str)>,
    /// Coloured stretches of time over the whole height.
    pub(crate) bands: Vec<Band>,
    /// How a value on the vertical axis reads; `None` draws no such axis.
    pub(crate) label: Option<fn(&f64) -> String>,
    /// Names of bands for the legend.
    pub(crate) keys: Vec<Key<'a>>,
}

/// One line of a panel; a point that is not finite, or outside the panel, interrupts it.
pub(crate) struct Line<'a> {
    pub(crate) name: &'a str,
    pub(crate) colour: RGBColor,
    /// Width [px].
    pub(crate) width: f64,
    pub(crate) points: Vec<(f64, f64)>,
}

/// A stretch of time in a colour.
pub(crate) struct Band {
    pub(crate) from: f64,
    pub(crate) to: f64,
    pub(crate) colour: RGBColor,
}

/// An entry of a legend.
pub(crate) struct Key<'a> {
    pub(crate) name: &'a str,
    pub(crate) colour: RGBColor,
    /// Width of the line [px].
    pub(crate) width: f64,
}

impl Figure<'_> {
    /// The figure as SVG.
    pub(crate) fn svg(&self) -> Result<String, PlotError> {
        let last = self.panels.len().saturating_sub(1);
        let foot = |index| if index == last { FOOT } else { 12 };
        let heights: Vec<_> = self
            .panels
            .iter()
            .enumerate()
            .map(|(index, panel)| HEAD + panel.height + foot(index))
            .collect();
        canvas(&self.title, heights.iter().sum(), |mut rest| {
            for ((index, panel), height) in self.panels.iter().enumerate().zip(&heights) {
                let (area, below) = rest.split_vertically(px(*height));
                rest = below;
                let (head, body) = area.split_vertically(px(HEAD));
                legend(&head, panel.title, &panel.keys())?;
                self.panel(&body, panel, foot(index), index == last)?;
            }
            Ok(())
        })
    }

    fn panel(
        &self,
        area: &Area<'_>,
        panel: &Panel<'_>,
        foot: u32,
        last: bool,
    ) -> Result<(), PlotError> {
        let (from, to) = self.time;
        let (low, high) = panel.range;
        let mut chart = ChartBuilder::on(area)
            .margin_right(px(RIGHT))
            .set_label_area_size(LabelAreaPosition::Left, px(LEFT))
            .set_label_area_size(LabelAreaPosition::Bottom, px(foot))
            .build_cartesian_2d(from..to, low..high)
            .map_err(PlotError::new)?;
        for band in &panel.bands {
            chart
                .draw_series([Rectangle::new(
                    [(band.from, low), (band.to, high)],
                    band.colour.filled(),
                )])
                .map_err(PlotError::new)?;
        }
        let plain = |value: &f64| tidy(*value);
        let mut mesh = chart.configure_mesh();
        mesh.light_line_style(PAPER.mix(0.0))
            .bold_line_style(FAINT.stroke_width(px(1)))
            .axis_style(INK.stroke_width(px(1)))
            .label_style(text(12.0))
            .axis_desc_style(text(13.0))
            .x_labels(12)
            .y_labels(usize::try_from(panel.height / 20).unwrap_or(6))
            .x_label_formatter(&plain)
            .set_all_tick_mark_size(px(4));
        if last {
            mesh.x_desc("time [s]");
        } else {
            mesh.x_label_formatter(&|_| String::new());
        }
        match &panel.label {
            Some(label) => mesh.y_label_formatter(label),
            None => mesh.disable_y_mesh().disable_y_axis(),
        };
        mesh.draw().map_err(PlotError::new)?;
        for (level, _) in &panel.levels {
            let dashes = DashedLineSeries::new(
                [(from, *level), (to, *level)],
                px(6),
                px(4),
                INK.stroke_width(px(1)),
            );
            chart.draw_series(dashes).map_err(PlotError::new)?;
        }
        for line in &panel.lines {
            let style = line.colour.stroke_width(fine(line.width));
            for stretch in stretches(&line.points, panel.range) {
                chart
                    .draw_series([PathElement::new(stretch, style)])
                    .map_err(PlotError::new)?;
            }
        }
        Ok(())
    }
}

impl Panel<'_> {
    /// The whole legend: lines, bands, then levels.
    fn keys(&self) -> Vec<Key<'_>> {
        let lines = self.lines.iter().map(|line| Key {
            name: line.name,
            colour: line.colour,
            width: line.width,
        });
        let bands = self.keys.iter().map(|key| Key { ..*key });
        let levels = self.levels.iter().filter(|(_, name)| !name.is_empty());
        let levels = levels.map(|(_, name)| Key {
            name,
            colour: INK,
            width: 1.0,
        });
        lines.chain(bands).chain(levels).collect()
    }
}

/// An SVG of `height` pixels below its title, drawn by `draw`.
pub(crate) fn canvas(
    title: &str,
    height: u32,
    draw: impl FnOnce(Area<'_>) -> Result<(), PlotError>,
) -> Result<String, PlotError> {
    let height = height + TITLE;
    let mut svg = String::new();
    {
        let root =
            SVGBackend::with_string(&mut svg, (WIDTH * FINE, height * FINE)).into_drawing_area();
        root.fill(&PAPER).map_err(PlotError::new)?;
        let (head, body) = root.split_vertically(px(TITLE));
        let style = text(18.0).transform_bold();
        head.draw(&Text::new(title.to_owned(), at(16, 14), style))
            .map_err(PlotError::new)?;
        draw(body)?;
        root.present().map_err(PlotError::new)?;
    }
    let size = |fine: u32| format!("width=\"{}\" height=\"{}\"", WIDTH * fine, height * fine);
    Ok(svg.replacen(&size(FINE), &size(1), 1))
}

/// A panel's title with its legend in the same line.
pub(crate) fn legend(area: &Area<'_>, title: &str, keys: &[Key<'_>]) -> Result<(), PlotError> {
    const SWATCH: f64 = 22.0;
    let middle = Pos::new(HPos::Left, VPos::Center);
    let bold = text(13.5).transform_bold().pos(middle);
    area.draw(&Text::new(title.to_owned(), at(LEFT, 15), bold))
        .map_err(PlotError::new)?;
    let wide: f64 = keys
        .iter()
        .map(|key| SWATCH + 6.0 + width(key.name, 12.5) + 18.0)
        .sum();
    let mut x = f64::from(WIDTH - RIGHT) - wide + 18.0;
    for key in keys {
        let from = (fine_i(x), fine_i(15.0));
        let to = (fine_i(x + SWATCH), fine_i(15.0));
        let style = key.colour.stroke_width(fine(key.width.max(2.0)));
        area.draw(&PathElement::new([from, to], style))
            .map_err(PlotError::new)?;
        let at = (fine_i(x + SWATCH + 6.0), fine_i(15.0));
        area.draw(&Text::new(key.name.to_owned(), at, text(12.5).pos(middle)))
            .map_err(PlotError::new)?;
        x += SWATCH + 6.0 + width(key.name, 12.5) + 18.0;
    }
    Ok(())
}

/// The parts of `points` that are finite and inside `range`, each continued to the edge at which it leaves.
fn stretches(points: &[(f64, f64)], (low, high): (f64, f64)) -> Vec<Vec<(f64, f64)>> {
    let inside = |point: &(f64, f64)| (low..=high).contains(&point.1);
    // Where the line from `a`, inside, to `b`, outside, meets the edge.
    let edge = |a: (f64, f64), b: (f64, f64)| {
        let y = if b.1 > high { high } else { low };
        let x = a.0 + (b.0 - a.0) * (y - a.1) / (b.1 - a.1);
        (b.1.is_finite() && x.is_finite()).then_some((x, y))
    };
    let mut stretches = Vec::new();
    let mut begin = 0;
    for chunk in points.chunk_by(|a, b| inside(a) == inside(b)) {
        let end = begin + chunk.len();
        if inside(&chunk[0]) {
            let before = begin.checked_sub(1).map(|i| points[i]);
            let first = before.and_then(|before| edge(chunk[0], before));
            let after = points.get(end).copied();
            let last = after.and_then(|after| edge(chunk[chunk.len() - 1], after));
            let stretch = first.into_iter().chain(chunk.iter().copied()).chain(last);
            stretches.push(stretch.collect());
        }
        begin = end;
    }
    stretches
}

/// Black text of `size` pixels.
pub(crate) fn text(size: f64) -> TextStyle<'static> {
    // The SVG backend divides by 1.24.
    ("sans-serif", size * 1.24 * f64::from(FINE))
        .into_font()
        .color(&INK)
}

/// Roughly how wide `text` is [px], by the widths of a common wide font: no font is at hand.
fn width(text: &str, size: f64) -> f64 {
    let em = |letter: char| match letter {
        'i' | 'l' | 'j' | 't' | 'f' | 'r' | ' ' | '.' | ',' | '\'' | '(' | ')' => 0.36,
        'm' | 'w' | 'M' | 'W' => 0.93,
        _ => 0.61,
    };
    size * text.chars().map(em).sum::<f64>()
}

/// `value` without needless digits.
pub(crate) fn tidy(value: f64) -> String {
    let rounded = (value * 1e4).round() / 1e4;
    // Not "-0".
    format!("{}", rounded + 0.0)
}

/// `length` shown pixels.
pub(crate) const fn px(length: u32) -> u32 {
    length * FINE
}

fn fine(width: f64) -> u32 {
    (width * f64::from(FINE)).round() as u32
}

fn fine_i(length: f64) -> i32 {
    (length * f64::from(FINE)).round() as i32
}

/// The place `x`, `y` shown pixels from the corner.
pub(crate) fn at(x: u32, y: u32) -> (i32, i32) {
    (fine_i(f64::from(x)), fine_i(f64::from(y)))
}

trait Bold {
    fn transform_bold(self) -> Self;
}

impl Bold for TextStyle<'_> {
    fn transform_bold(mut self) -> Self {
        self.font = self.font.style(FontStyle::Bold);
        self
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_that_leaves_the_panel_is_drawn_to_its_edge_and_a_gap_is_not() {
        let points = [
            (0.0, 0.0),
            (1.0, 4.0),
            (2.0, 0.0),
            (3.0, -4.0),
            (4.0, f64::NAN),
            (5.0, 1.0),
        ];
        let expected = [
            vec![(0.0, 0.0), (0.5, 2.0)],
            vec![(1.5, 2.0), (2.0, 0.0), (2.5, -2.0)],
            vec![(5.0, 1.0)],
        ];
        assert_eq!(stretches(&points, (-2.0, 2.0)), expected);
        assert!(stretches(&[], (0.0, 1.0)).is_empty());
    }
}
