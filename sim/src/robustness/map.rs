//! The map: a table in Markdown, and the same as a picture.

use core::fmt::Write as _;

use super::{Law, Line, SPEEDS, STEADY_LIMIT};
use crate::report::table;

/// One row a case, two columns a law: `runs that stood / runs, median steady RMS error`.
pub fn markdown(lines: &[Line]) -> String {
    let mut text = String::from("| case |");
    for law in Law::ALL {
        for speed in SPEEDS {
            write!(text, " {}, {speed} m/s |", law.name()).expect("text grows");
        }
    }
    text.push_str("\n|---|");
    text.push_str(&"---|".repeat(Law::ALL.len() * SPEEDS.len()));
    text.push('\n');
    for row in lines.chunks(Law::ALL.len() * SPEEDS.len()) {
        write!(text, "| {} |", row[0].case).expect("text grows");
        for line in row {
            write!(text, " {} |", cell(line)).expect("text grows");
        }
        text.push('\n');
    }
    text
}

/// The table for a terminal: a line a case, a column a law, the worse of the two speeds.
pub fn terminal(lines: &[Line]) -> String {
    let mut rows = vec![["case", "", "", "", ""].map(str::to_owned)];
    for (i, law) in Law::ALL.iter().enumerate() {
        rows[0][i + 1] = law.name().to_owned();
    }
    for row in lines.chunks(Law::ALL.len() * SPEEDS.len()) {
        let mut cells = vec![row[0].case.clone()];
        cells.extend(row.chunks(SPEEDS.len()).map(|speeds| {
            let stood: usize = speeds.iter().map(|line| line.stood).sum();
            let runs: usize = speeds.iter().map(|line| line.runs).sum();
            let worst = speeds
                .iter()
                .filter_map(|line| line.rmse_steady_deg)
                .fold(f64::NAN, f64::max);
            match (stood == runs, worst.is_nan()) {
                (true, _) => format!("{worst:.2}°"),
                (false, false) => format!("{worst:.2}° ({stood}/{runs} stand)"),
                (false, true) => "falls".to_owned(),
            }
        }));
        if let Ok(cells) = <[String; 5]>::try_from(cells) {
            rows.push(cells);
        }
    }
    let mut text = table(&rows, false);
    writeln!(
        text,
        "\nMedian steady RMS roll error after a step of 10°, the worse of 0.5 and 1.0 m/s. A run stands if it neither falls nor leaves ±{STEADY_LIMIT}°."
    )
    .expect("text grows");
    text
}

/// `20/20 0.21°`.
fn cell(line: &Line) -> String {
    let share = format!("{}/{}", line.stood, line.runs);
    match line.rmse_steady_deg {
        Some(rmse) => format!("{share} {rmse:.2}°"),
        None => format!("{share} fell"),
    }
}

/// The map as SVG: green where every run stands, by the error; red where some do not.
pub fn heat_map(lines: &[Line]) -> String {
    let columns = Law::ALL.len() * SPEEDS.len();
    let rows = lines.len() / columns;
    let width = LABEL + columns as f64 * CELL_WIDTH + MARGIN;
    let height = HEAD + rows as f64 * CELL_HEIGHT + FOOT;
    let mut svg = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {width} {height}\" width=\"{width}\" height=\"{height}\" font-family=\"DejaVu Sans, Verdana, sans-serif\" font-size=\"12\" fill=\"#222\">\n<rect width=\"{width}\" height=\"{height}\" fill=\"#fff\"/>\n"
    );
    let mut text = |x: f64, y: f64, anchor: &str, weight: &str, size: f64, text: &str| {
        writeln!(
            svg,
            "<text x=\"{x}\" y=\"{y}\" text-anchor=\"{anchor}\" font-weight=\"{weight}\" font-size=\"{size}\">{text}</text>"
        )
        .expect("text grows");
    };
    text(
        MARGIN,
        26.0,
        "start",
        "bold",
        16.0,
        "Roll step of 10°: what the direction controllers bear",
    );
    for (i, law) in Law::ALL.iter().enumerate() {
        let x = LABEL + (i as f64 * SPEEDS.len() as f64 + 1.0) * CELL_WIDTH;
        text(x, HEAD - 28.0, "middle", "bold", 12.0, law.name());
        for (j, speed) in SPEEDS.iter().enumerate() {
            let x = LABEL + ((i * SPEEDS.len() + j) as f64 + 0.5) * CELL_WIDTH;
            text(
                x,
                HEAD - 10.0,
                "middle",
                "normal",
                11.0,
                &format!("{speed:.1} m/s"),
            );
        }
    }
    for (row, lines) in lines.chunks(columns).enumerate() {
        let y = HEAD + row as f64 * CELL_HEIGHT;
        text(LABEL - 8.0, y + 17.0, "end", "normal", 12.0, &lines[0].case);
    }
    let note = format!(
        "Median steady RMS error [°], from 5 s after the step on; below it, where not every run stood: the share that did. A run stands if it neither falls nor leaves ±{STEADY_LIMIT}°."
    );
    text(MARGIN, height - 14.0, "start", "normal", 11.0, &note);
    for (row, lines) in lines.chunks(columns).enumerate() {
        for (column, line) in lines.iter().enumerate() {
            let x = LABEL + column as f64 * CELL_WIDTH;
            let y = HEAD + row as f64 * CELL_HEIGHT;
            write_cell(&mut svg, x, y, line);
        }
    }
    svg.push_str("</svg>\n");
    svg
}

fn write_cell(svg: &mut String, x: f64, y: f64, line: &Line) {
    let share = line.stood as f64 / line.runs.max(1) as f64;
    let colour = match line.rmse_steady_deg {
        Some(rmse) if line.stood == line.runs => shade(rmse),
        // From orange to red with the share that does not stand.
        _ => format!("rgb({}, {}, 70)", 235, (60.0 + 110.0 * share) as u8),
    };
    let words = match (line.rmse_steady_deg, line.stood == line.runs) {
        (Some(rmse), true) => format!("{rmse:.2}"),
        (Some(rmse), false) => format!("{rmse:.1} · {:.0} %", (100.0 * share).floor()),
        (None, _) => "fell".to_owned(),
    };
    writeln!(
        svg,
        "<rect x=\"{}\" y=\"{}\" width=\"{}\" height=\"{}\" fill=\"{colour}\"/>\n<text x=\"{}\" y=\"{}\" text-anchor=\"middle\">{words}</text>",
        x + 1.0,
        y + 1.0,
        CELL_WIDTH - 2.0,
        CELL_HEIGHT - 2.0,
        x + 0.5 * CELL_WIDTH,
        y + 17.0,
    )
    .expect("text grows");
}

/// Green at no error, yellow from 2° on.
fn shade(rmse: f64) -> String {
    let share = (rmse / 2.0).clamp(0.0, 1.0).sqrt();
    let mix = |from: f64, to: f64| (from + (to - from) * share) as u8;
    format!(
        "rgb({}, {}, {})",
        mix(120.0, 250.0),
        mix(198.0, 228.0),
        mix(121.0, 120.0)
    )
}

const MARGIN: f64 = 16.0;
const LABEL: f64 = 240.0;
const HEAD: f64 = 84.0;
const FOOT: f64 = 40.0;
const CELL_WIDTH: f64 = 84.0;
const CELL_HEIGHT: f64 = 25.0;
