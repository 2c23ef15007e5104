//! What the demo shows while it runs: on a terminal a table that is redrawn, elsewhere a line every few seconds and every event.

use std::fmt::Write as _;

use console::{Color, Style, Term, truncate_str};
use sphere_protocol::message::Mode;
use sphere_protocol::time::Span;

use super::{Scene, SceneEvent, SceneRobot};
use crate::report::{millimetres, milliseconds};
use crate::trace::mode_name;

/// Shows scenes on standard error.
pub struct Display {
    term: Term,
    /// Lines of the table on the terminal.
    drawn: usize,
    is_introduced: bool,
    events_shown: usize,
    next_line: Span,
}

impl Display {
    /// A display of this process's standard error.
    pub fn new() -> Self {
        Self {
            term: Term::buffered_stderr(),
            drawn: 0,
            is_introduced: false,
            events_shown: 0,
            next_line: Span::ZERO,
        }
    }

    /// Shows `scene`. A terminal that went away is no reason to stop robots: what cannot be shown is not.
    pub fn show(&mut self, scene: &Scene<'_>) {
        let is_terminal = self.term.is_term();
        if !self.is_introduced {
            self.is_introduced = true;
            for line in introduction(scene) {
                let _ = self.term.write_line(&line);
            }
        }
        if is_terminal {
            self.draw(scene);
        } else {
            self.log(scene);
        }
        let _ = self.term.flush();
    }

    fn draw(&mut self, scene: &Scene<'_>) {
        let width = usize::from(self.term.size().1).max(20) - 1;
        let _ = self.term.clear_last_lines(self.drawn);
        let lines = picture(scene, width);
        self.drawn = lines.len();
        for line in lines {
            // A line that wraps could not be found again.
            let _ = self.term.write_line(&truncate_str(&line, width, "…"));
        }
    }

    fn log(&mut self, scene: &Scene<'_>) {
        for event in &scene.events[self.events_shown..] {
            let _ = self.term.write_line(&event_line(event));
        }
        self.events_shown = scene.events.len();
        if scene.t >= self.next_line && !scene.is_ending {
            self.next_line = scene.t + LINE_PERIOD;
            let _ = self.term.write_line(&line(scene));
        }
    }
}

impl Default for Display {
    fn default() -> Self {
        Self::new()
    }
}

/// What the demo is, and how to look into it from outside.
fn introduction(scene: &Scene<'_>) -> Vec<String> {
    let mut lines = vec![
        "Sphere Fleet: for each robot a simulated body, MAVLink, an agent and a Zenoh session;"
            .to_owned(),
        "one station plans for all, over links of 100 ± 20 ms each way that stall as TCP does"
            .to_owned(),
        "at 10 % loss. Robots set out one after the other.".to_owned(),
    ];
    if let Some(why) = scene.moved {
        lines.push(format!(
            "Zenoh's usual {why}: the router took another port."
        ));
    }
    lines.push(format!(
        "Join in: Zenoh router at {}, keys fleet/v1/** (docs/protocol.md).",
        scene.endpoint
    ));
    lines.push("Ctrl-C ends it early; the report is still written.".to_owned());
    lines.push(String::new());
    lines
}

fn picture(scene: &Scene<'_>, width: usize) -> Vec<String> {
    let strong = Style::new().for_stderr().bold();
    let faint = Style::new().for_stderr().dim();
    let mut lines = vec![
        strong
            .apply_to(format!(
                "{:<6} {:<10} {:<8} {:>8} {:>6} {:>6} {:>7}  {:>11} {:>6}",
                "robot",
                "mission",
                "mode",
                "error mm",
                "m/s",
                "roll °",
                "plan ms",
                "link ms",
                "stalls"
            ))
            .to_string(),
    ];
    lines.extend(scene.robots.iter().map(robot_line));
    lines.extend(LEGEND.map(|line| faint.apply_to(line).to_string()));
    lines.push(String::new());
    lines.push(bar(scene, width));
    for event in scene.events.iter().rev().take(EVENTS).rev() {
        lines.push(faint.apply_to(event_line(event)).to_string());
    }
    lines
}

fn robot_line(robot: &SceneRobot) -> String {
    let row = &robot.row;
    let mode = Style::new().for_stderr().fg(match row.mode {
        Mode::Tracking => Color::Green,
        Mode::Holding | Mode::Failsafe => Color::Yellow,
        Mode::Fault => Color::Red,
        Mode::Boot | Mode::Disarmed | Mode::Ready | Mode::Idle => Color::Cyan,
    });
    let link = if robot.is_cut {
        let cut = Style::new().for_stderr().fg(Color::Red).bold();
        cut.apply_to(format!("{:>11}", "cut")).to_string()
    } else {
        let ms = |duration: std::time::Duration| duration.as_millis();
        let text = format!("{} / {:>4}", ms(robot.up.latency), ms(robot.down.latency));
        format!("{text:>11}")
    };
    let or_dash = |value: Option<String>| value.unwrap_or_else(|| "-".to_owned());
    format!(
        "{:<6} {:<10} {} {:>8} {:>6.2} {:>6.1} {:>7}  {link} {:>6}",
        row.robot.as_str(),
        robot.mission,
        mode.apply_to(format!("{:<8}", mode_name(row.mode))),
        or_dash(robot.error().map(millimetres)),
        row.truth.v,
        row.truth.q_r.to_degrees(),
        or_dash(row.plan_age.map(|age| milliseconds(age.as_secs_f64()))),
        robot.up.stalls + robot.down.stalls,
    )
}

fn bar(scene: &Scene<'_>, width: usize) -> String {
    let (t, duration) = (scene.t.as_secs_f64(), scene.duration.as_secs_f64());
    let text = if scene.is_ending {
        " braking to rest".to_owned()
    } else {
        format!(" {t:.0} / {duration:.0} s")
    };
    let length = width.saturating_sub(text.len()).min(BAR);
    let share = if duration > 0.0 {
        (t / duration).clamp(0.0, 1.0)
    } else {
        1.0
    };
    let full = (share * length as f64).round() as usize;
    let done = Style::new().for_stderr().fg(Color::Cyan);
    format!(
        "{}{}{text}",
        done.apply_to("█".repeat(full)),
        "░".repeat(length - full)
    )
}

/// One line for all robots, for logs.
fn line(scene: &Scene<'_>) -> String {
    let mut text = format!("{:>4.0} s", scene.t.as_secs_f64());
    for robot in scene.robots {
        let row = &robot.row;
        // Writing to a String cannot fail.
        let _ = write!(text, "  | {} {}", row.robot, mode_name(row.mode));
        if let Some(error) = robot.error() {
            let _ = write!(text, " {} mm", millimetres(error));
        }
        if let Some(age) = row.plan_age {
            let _ = write!(text, ", plan {} ms old", milliseconds(age.as_secs_f64()));
        }
        if robot.is_cut {
            text.push_str(", link cut");
        }
    }
    text
}

fn event_line(event: &SceneEvent) -> String {
    format!("{:>6.1} s  {}", event.t.as_secs_f64(), event.text)
}

/// What the columns mean.
const LEGEND: [&str; 2] = [
    "error: distance from the path; plan: age of the plan in play; link: delay of the",
    "newest packet, up / down; stalls: packets held back by a loss, so far",
];
/// Events on the terminal.
const EVENTS: usize = 5;
/// Length of the time bar [columns].
const BAR: usize = 60;
const LINE_PERIOD: Span = Span::from_millis(5000);
