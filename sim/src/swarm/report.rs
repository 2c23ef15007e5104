//! What a swarm came to: figures for scripts, a table for people.

use core::fmt::Write as _;
use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};
use sphere_protocol::io::histogram::Histogram;

use crate::report::{GREEN, RED, RESET, table};

/// The figures of one run, all of the time measured alone; its JSON keeps these names.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SwarmReport {
    /// How many robots.
    pub robots: usize,
    /// Processes over which the agents were spread.
    pub agent_processes: usize,
    /// Length of the measurement [s].
    pub duration_s: f64,
    /// Whether somebody ended it early.
    pub is_interrupted: bool,
    /// From the first process to the last robot that tracked, or the end of patience [s].
    pub start_s: f64,
    /// Injected each way, as asked for [ms].
    pub delay_ms: f64,
    /// Its standard deviation [ms].
    pub jitter_ms: f64,
    /// Telemetry period [ms].
    pub telemetry_ms: u32,
    /// By how much a plan's age at arrival may exceed the injected delay at p99 [ms].
    pub bound_ms: f64,
    /// Version of this program.
    pub version: String,
    /// The machine's processor.
    pub processor: Option<String>,
    /// Its cores.
    pub cores: usize,
    /// Whether the system granted real-time scheduling.
    pub is_real_time: bool,
    /// Delay of both ways together that the relay was to add; without a relay `null`.
    pub injected_ms: Option<Spread>,
    /// The same as measured in the relay: above `injected_ms` by what the relay itself was late.
    pub injected_measured_ms: Option<Spread>,
    /// Age of plans at their arrival.
    pub plan_age_arrival_ms: Spread,
    /// Age of plans when they begin to be played.
    pub plan_age_beginning_ms: Spread,
    /// How late control steps begin.
    pub control_late_ms: Spread,
    /// How late a bare thread wakes, scheduled like a control thread, before the robots start.
    pub idle_late_before_ms: Spread,
    /// The same while they run.
    pub idle_late_during_ms: Spread,
    /// How late the station serves a robot.
    pub station_late_ms: Spread,
    /// Plans of the station.
    pub plans: Plans,
    /// Steps of the plants, of 1 ms each.
    pub plant_steps: u64,
    /// Those that began more than 1 ms late and were made up for.
    pub plant_steps_late: u64,
    /// The latest of them since the start [ms].
    pub plant_late_max_ms: f64,
    /// Messages of one robot, without framing.
    pub payload: Traffic,
    /// What passes on its TCP connection; without a relay `null`.
    pub socket: Option<Ways>,
    /// Processes by part.
    pub parts: Vec<PartFigures>,
    /// Processor time of everything on this machine, other programs and lost time included [% of a core].
    pub machine_cpu_percent: Option<f64>,
    /// What was dropped, by place and reason.
    pub drops: BTreeMap<String, u64>,
    /// Robot by robot.
    pub each: Vec<RobotFigures>,
    /// What was not as it must be; empty if it held.
    pub failures: Vec<String>,
}

/// A distribution of times [ms].
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Spread {
    /// How many times.
    pub count: u64,
    /// Mean.
    pub mean: Option<f64>,
    /// Median.
    pub p50: Option<f64>,
    /// 99 % are not longer.
    pub p99: Option<f64>,
    /// 99.9 % are not longer.
    pub p999: Option<f64>,
    /// The longest, of a difference of two moments to a bucket of its histogram.
    pub max: Option<f64>,
}

/// Plans of the station.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Plans {
    /// Sent, of any source.
    pub sent: u64,
    /// Of these: the one before, again.
    pub shifted: u64,
    /// Planning ticks without a plan although one was due.
    pub failed: u64,
    /// Planning ticks without a plan because telemetry was too old.
    pub stale: u64,
}

/// Messages and bytes a second of one robot, each way.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Traffic {
    /// To the network [1/s].
    pub up_messages: f64,
    /// To the network [B/s].
    pub up_bytes: f64,
    /// From the network [1/s].
    pub down_messages: f64,
    /// From the network [B/s].
    pub down_bytes: f64,
}

/// Bytes and segments a second of one robot's connection, each way.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Ways {
    /// To the station [B/s].
    pub up_bytes: f64,
    /// From it [B/s].
    pub down_bytes: f64,
    /// To the station [1/s].
    pub up_segments: f64,
    /// From it [1/s].
    pub down_segments: f64,
}

/// Costs of one part.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct PartFigures {
    /// Which: station (with the router), agents, plants, relay, meter.
    pub name: String,
    /// In how many processes.
    pub processes: usize,
    /// With how many threads.
    pub threads: usize,
    /// Processor time [% of a core].
    pub cpu_percent: f64,
    /// The same by the purpose of the threads, as their names say.
    pub cpu_percent_by_thread: BTreeMap<String, f64>,
    /// Resident memory [bytes].
    pub memory_bytes: u64,
}

/// How one robot fared.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RobotFigures {
    /// Which.
    pub id: String,
    /// Share of its control steps in which it tracked.
    pub tracking: f64,
    /// Root mean square of its true distance from the path [m].
    pub position_rmse_m: Option<f64>,
}

impl SwarmReport {
    /// Whether all was as it must be.
    pub fn held(&self) -> bool {
        self.failures.is_empty()
    }

    /// What a plan's age at arrival is above the injected delay, both at p99 [ms].
    pub fn overhead_p99_ms(&self) -> Option<f64> {
        let injected = match self.injected_ms {
            None => 0.0,
            Some(injected) => injected.p99?,
        };
        Some(self.plan_age_arrival_ms.p99? - injected)
    }

    /// Share of the time in which robots tracked, over all of them.
    pub fn tracking(&self) -> f64 {
        let sum: f64 = self.each.iter().map(|robot| robot.tracking).sum();
        sum / self.each.len().max(1) as f64
    }

    /// Root mean square position errors, ascending [m].
    pub fn rmse_m(&self) -> Vec<f64> {
        let each = self.each.iter();
        let mut errors: Vec<_> = each.filter_map(|robot| robot.position_rmse_m).collect();
        errors.sort_by(f64::total_cmp);
        errors
    }

    /// The part called `name`.
    pub fn part(&self, name: &str) -> Option<&PartFigures> {
        self.parts.iter().find(|part| part.name == name)
    }

    /// Everything as JSON.
    pub fn json(&self) -> String {
        let text = serde_json::to_string_pretty(self);
        text.expect("names are strings and figures finite or null") + "\n"
    }
}

impl Spread {
    pub(super) fn of(histogram: &Histogram) -> Self {
        let ms = |duration: std::time::Duration| duration.as_secs_f64() * 1e3;
        let quantile = |p| histogram.quantile(p).map(ms);
        Self {
            count: histogram.total(),
            mean: histogram.mean().map(ms),
            p50: quantile(0.5),
            p99: quantile(0.99),
            p999: quantile(0.999),
            max: (histogram.total() > 0).then(|| ms(histogram.max())),
        }
    }

    /// Of the sum of two independent times.
    pub(super) fn of_sum(a: &Histogram, b: &Histogram) -> Self {
        let ms = |duration: std::time::Duration| duration.as_secs_f64() * 1e3;
        let quantile = |p| a.quantile_of_sum(b, p).map(ms);
        Self {
            count: a.total().min(b.total()),
            mean: a.mean().zip(b.mean()).map(|(a, b)| ms(a + b)),
            p50: quantile(0.5),
            p99: quantile(0.99),
            p999: quantile(0.999),
            max: (a.total() > 0 && b.total() > 0).then(|| ms(a.max() + b.max())),
        }
    }
}

/// The tables of one run for a terminal, and what it comes to in a sentence.
pub fn summary(report: &SwarmReport, colour: bool) -> String {
    let mut text = String::new();
    let mut say = |line: &str| {
        text.push_str(line);
        text.push('\n');
    };
    say(&format!(
        "{} robots live, measured for {:.0} s: agents in {}, {:.0} ± {:.0} ms injected each way, telemetry every {} ms\n",
        report.robots,
        report.duration_s,
        processes(report.agent_processes),
        report.delay_ms,
        report.jitter_ms,
        report.telemetry_ms,
    ));
    say(table(&times(report), colour).trim_end());
    say("");
    say(table(&parts(report), colour).trim_end());
    say("(processor time in % of one core)\n");
    say(table(&traffic(report), colour).trim_end());
    say("");
    let rmse = report.rmse_m();
    let mm = |error: Option<&f64>| error.map_or("-".to_owned(), |m| format!("{:.1}", 1e3 * m));
    say(&format!(
        "Robots tracked {:.1} % of the time, {} mm from their paths (RMS, median) and {} at worst. All tracked {:.1} s after the start.",
        1e2 * report.tracking(),
        mm(rmse.get(rmse.len() / 2)),
        mm(rmse.last()),
        report.start_s,
    ));
    let Plans {
        sent,
        shifted,
        failed,
        stale,
    } = report.plans;
    say(&format!(
        "Plans: {sent} sent, {shifted} of them the one before again; ticks without one: {failed} unsolved, {stale} with telemetry too old."
    ));
    say(&format!(
        "Plants: {} of {} steps began more than 1 ms late and were made up for, the latest {:.1} ms.",
        report.plant_steps_late, report.plant_steps, report.plant_late_max_ms
    ));
    let drops: Vec<_> = report
        .drops
        .iter()
        .map(|(what, count)| format!("{what} {count}"))
        .collect();
    say(&if drops.is_empty() {
        "Dropped: nothing.".to_owned()
    } else {
        format!("Dropped: {}.", drops.join("; "))
    });
    if !report.is_real_time {
        say(
            "No real-time scheduling: control may be late on a busy machine (CAP_SYS_NICE, or an rtprio limit).",
        );
    }
    if let Some(busy) = report.machine_cpu_percent {
        let ours: f64 = report.parts.iter().map(|part| part.cpu_percent).sum();
        say(&format!(
            "The machine was busy for {busy:.0} % of a core of its {:.0}, {ours:.0} of them with this.",
            1e2 * report.cores as f64
        ));
    }
    let sentence = verdict(report);
    say(&match (colour, report.held()) {
        (false, _) => sentence,
        (true, true) => format!("{GREEN}{sentence}{RESET}"),
        (true, false) => format!("{RED}{sentence}{RESET}"),
    });
    text
}

fn verdict(report: &SwarmReport) -> String {
    if report.held() {
        return format!(
            "Held: every robot tracked, and plans were {:.1} ms older at arrival than the injected delay makes them (p99; bound {:.0}).",
            report.overhead_p99_ms().unwrap_or(f64::NAN),
            report.bound_ms
        );
    }
    let shown = report.failures.iter().take(FAILURES).cloned();
    let mut text = format!("DID NOT HOLD: {}", shown.collect::<Vec<_>>().join("; "));
    if report.failures.len() > FAILURES {
        let _ = write!(text, "; and {} more", report.failures.len() - FAILURES);
    }
    text.push('.');
    text
}

fn times(report: &SwarmReport) -> Vec<[String; 7]> {
    let mut rows = vec![["ms", "mean", "p50", "p99", "p99.9", "max", ""].map(str::to_owned)];
    let mut row = |name: &str, spread: &Spread, digits: usize| {
        let cell = |ms: Option<f64>| ms.map_or("-".to_owned(), |ms| format!("{ms:.digits$}"));
        rows.push([
            name.to_owned(),
            cell(spread.mean),
            cell(spread.p50),
            cell(spread.p99),
            cell(spread.p999),
            cell(spread.max),
            String::new(),
        ]);
    };
    row("plan age at arrival", &report.plan_age_arrival_ms, 1);
    if let (Some(meant), Some(measured)) = (&report.injected_ms, &report.injected_measured_ms) {
        row("  injected, both ways", meant, 1);
        row("  as the relay measures it", measured, 1);
    }
    row(
        "plan age at its beginning",
        &report.plan_age_beginning_ms,
        1,
    );
    row("station late", &report.station_late_ms, 2);
    row("control late", &report.control_late_ms, 2);
    row("  bare thread meanwhile", &report.idle_late_during_ms, 2);
    row("  bare thread before", &report.idle_late_before_ms, 2);
    rows
}

fn parts(report: &SwarmReport) -> Vec<[String; 7]> {
    let header = [
        "part",
        "processes",
        "threads",
        "CPU %",
        "% a robot",
        "memory MB",
        "busiest threads",
    ];
    let mut rows = vec![header.map(str::to_owned)];
    let robots = report.robots as f64;
    for part in &report.parts {
        let mut threads: Vec<_> = part.cpu_percent_by_thread.iter().collect();
        threads.sort_by(|a, b| b.1.total_cmp(a.1));
        let busiest: Vec<_> = threads
            .iter()
            .take(BUSIEST)
            .filter(|(_, percent)| **percent >= 0.1)
            .map(|(name, percent)| format!("{name} {percent:.1}"))
            .collect();
        rows.push([
            part.name.clone(),
            part.processes.to_string(),
            part.threads.to_string(),
            format!("{:.1}", part.cpu_percent),
            format!("{:.2}", part.cpu_percent / robots),
            format!("{:.1}", part.memory_bytes as f64 * 1e-6),
            busiest.join(", "),
        ]);
    }
    rows
}

fn traffic(report: &SwarmReport) -> Vec<[String; 6]> {
    let header = ["a robot and second", "up", "B up", "down", "B down", ""];
    let mut rows = vec![header.map(str::to_owned)];
    let mut row = |name: &str, figures: [f64; 4]| {
        let [up, up_bytes, down, down_bytes] = figures;
        rows.push([
            name.to_owned(),
            format!("{up:.1}"),
            format!("{up_bytes:.0}"),
            format!("{down:.1}"),
            format!("{down_bytes:.0}"),
            String::new(),
        ]);
    };
    let Traffic {
        up_messages,
        up_bytes,
        down_messages,
        down_bytes,
    } = report.payload;
    row(
        "messages, their payload",
        [up_messages, up_bytes, down_messages, down_bytes],
    );
    if let Some(ways) = report.socket {
        row(
            "segments on its connection",
            [
                ways.up_segments,
                ways.up_bytes,
                ways.down_segments,
                ways.down_bytes,
            ],
        );
    }
    rows
}

/// The runs, fewest robots first, as a table in Markdown, and beneath it their costs by part.
pub fn markdown(reports: &[SwarmReport]) -> String {
    let mut text = String::from(
        "| robots | held | age at arrival p50 / p99 / max [ms] | above the injected delay p99 [ms] | control late p99 / p99.9 [ms] | bare thread p99 / p99.9 [ms] | station late p99 [ms] | tracking [%] | RMSE median / worst [mm] | dropped |\n|---|---|---|---|---|---|---|---|---|---|\n",
    );
    let cell = |ms: Option<f64>| ms.map_or("-".to_owned(), |ms| format!("{ms:.1}"));
    let fine = |ms: Option<f64>| ms.map_or("-".to_owned(), |ms| format!("{ms:.2}"));
    for report in reports {
        let rmse = report.rmse_m();
        let mm = |error: Option<&f64>| cell(error.map(|m| 1e3 * m));
        let age = &report.plan_age_arrival_ms;
        // Writing to a String cannot fail.
        let _ = writeln!(
            text,
            "| {} | {} | {} / {} / {} | {} | {} / {} | {} / {} | {} | {:.1} | {} / {} | {} |",
            report.robots,
            if report.held() { "yes" } else { "no" },
            cell(age.p50),
            cell(age.p99),
            cell(age.max),
            cell(report.overhead_p99_ms()),
            fine(report.control_late_ms.p99),
            fine(report.control_late_ms.p999),
            fine(report.idle_late_during_ms.p99),
            fine(report.idle_late_during_ms.p999),
            fine(report.station_late_ms.p99),
            1e2 * report.tracking(),
            mm(rmse.get(rmse.len() / 2)),
            mm(rmse.last()),
            report.drops.values().sum::<u64>(),
        );
    }
    text.push_str("\n| robots | station | agents | plants | relay | meter | machine | memory: station | agents | a robot's payload up / down [B/s] | on its connection up / down [B/s] |\n|---|---|---|---|---|---|---|---|---|---|---|\n");
    for report in reports {
        let cpu = |name| {
            let part = report.part(name);
            part.map_or("-".to_owned(), |part| format!("{:.0} %", part.cpu_percent))
        };
        let memory = |name| {
            let part = report.part(name);
            part.map_or("-".to_owned(), |part| {
                format!("{:.0} MB", part.memory_bytes as f64 * 1e-6)
            })
        };
        let machine = report.machine_cpu_percent;
        let _ = writeln!(
            text,
            "| {} | {} | {} | {} | {} | {} | {} | {} | {} | {:.0} / {:.0} | {} |",
            report.robots,
            cpu("station"),
            cpu("agents"),
            cpu("plants"),
            cpu("relay"),
            cpu("meter"),
            machine.map_or("-".to_owned(), |percent| format!("{percent:.0} %")),
            memory("station"),
            memory("agents"),
            report.payload.up_bytes,
            report.payload.down_bytes,
            report.socket.map_or("-".to_owned(), |ways| {
                format!("{:.0} / {:.0}", ways.up_bytes, ways.down_bytes)
            }),
        );
    }
    text
}

fn processes(count: usize) -> String {
    match count {
        1 => "one process".to_owned(),
        _ => format!("{count} processes"),
    }
}

/// Groups of threads in the table.
const BUSIEST: usize = 4;
/// Failures told of one by one.
const FAILURES: usize = 4;
