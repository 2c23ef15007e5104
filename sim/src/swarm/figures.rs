//! From the counters of two moments to the figures of the time between them.

use std::collections::BTreeMap;
use std::time::Duration;

use sphere_ground::trajectory::{Pose, Trajectory};
use sphere_protocol::io::histogram::{Histogram, Sparse};
use sphere_protocol::message::{DropReason, Mode};

use super::Options;
use super::message::{AgentMark, Mark, Part, PlantsMark, StationMark, WayMark};
use super::process::{self, Cost};
use super::report::{PartFigures, Plans, RobotFigures, Spread, SwarmReport, Traffic, Ways};
use crate::demo::RMSE_MAX;
use crate::scenario::Scenario;

/// All counters of one moment.
#[derive(Default)]
pub(super) struct Marks {
    machine: Option<[u64; 2]>,
    pub(super) costs: Vec<(Part, Cost)>,
    /// Of the process that measures.
    own: Cost,
    agents: Vec<AgentMark>,
    station: Option<StationMark>,
    plants: Option<PlantsMark>,
    relay: Option<[WayMark; 2]>,
}

impl Marks {
    /// Of this process and the machine; those of the parts are to be taken.
    pub(super) fn now() -> Self {
        Self {
            machine: process::machine(),
            own: Cost::of(std::process::id()).unwrap_or_default(),
            ..Self::default()
        }
    }

    /// Agents come process by process, in the order of their numbers.
    pub(super) fn take(&mut self, mark: Mark) {
        match mark {
            Mark::Agents(agents) => self.agents.extend(agents),
            Mark::Station(station) => self.station = Some(station),
            Mark::Plants(plants) => self.plants = Some(plants),
            Mark::Relay(ways) => self.relay = Some(ways),
        }
    }
}

/// What was measured, and how.
pub(super) struct Measured<'a> {
    pub(super) options: &'a Options,
    pub(super) scenario: &'a Scenario,
    pub(super) start_s: f64,
    pub(super) duration_s: f64,
    pub(super) is_interrupted: bool,
    pub(super) is_real_time: bool,
    pub(super) idle_before: Histogram,
    pub(super) idle_during: Histogram,
    pub(super) first: Marks,
    pub(super) last: Marks,
}

impl Measured<'_> {
    pub(super) fn report(&self) -> SwarmReport {
        let options = self.options;
        let arrival = self.of_agents(|agent| &agent.arrival_age);
        let beginning = self.of_agents(|agent| &agent.beginning_age);
        let control = self.of_agents(|agent| &agent.lateness);
        let (station, plans) = self.station();
        let delays = self.delays();
        let mut report = SwarmReport {
            robots: options.robots,
            agent_processes: options.processes.clamp(1, options.robots),
            duration_s: self.duration_s,
            is_interrupted: self.is_interrupted,
            start_s: self.start_s,
            delay_ms: options.delay_ms,
            jitter_ms: options.jitter_ms,
            telemetry_ms: options.telemetry_ms,
            bound_ms: options.bound_ms,
            version: env!("CARGO_PKG_VERSION").to_owned(),
            processor: process::processor(),
            cores: std::thread::available_parallelism().map_or(1, usize::from),
            is_real_time: self.is_real_time,
            injected_ms: delays.as_ref().map(|[meant, _]| *meant),
            injected_measured_ms: delays.map(|[_, measured]| measured),
            plan_age_arrival_ms: Spread::of(&arrival),
            plan_age_beginning_ms: Spread::of(&beginning),
            control_late_ms: Spread::of(&control),
            idle_late_before_ms: Spread::of(&self.idle_before),
            idle_late_during_ms: Spread::of(&self.idle_during),
            station_late_ms: station,
            plans,
            plant_steps: self.plants(|plants| plants.steps),
            plant_steps_late: self.plants(|plants| plants.late),
            plant_late_max_ms: (self.last.plants.as_ref())
                .map_or(0.0, |plants| plants.lateness_max_ns as f64 * 1e-6),
            payload: self.payload(),
            socket: self.socket(),
            parts: self.parts(),
            machine_cpu_percent: self.machine(),
            drops: self.drops(),
            each: self.each(),
            failures: Vec::new(),
        };
        report.failures = failures(&report);
        report
    }

    /// What the histograms of all agents have counted in the time.
    fn of_agents(&self, which: fn(&AgentMark) -> &Sparse) -> Histogram {
        let agents = self.first.agents.iter().zip(&self.last.agents);
        agents
            .map(|(first, last)| since(which(first), which(last)))
            .reduce(|mut sum, one| {
                sum.add(&one);
                sum
            })
            .unwrap_or_else(|| Histogram::new(Duration::from_millis(1), 1))
    }

    /// Both ways together: what was meant, what was measured.
    fn delays(&self) -> Option<[Spread; 2]> {
        let (first, last) = (self.first.relay.as_ref()?, self.last.relay.as_ref()?);
        let both = |which: fn(&WayMark) -> &Sparse| {
            let [up, down] = [0, 1].map(|way| since(which(&first[way]), which(&last[way])));
            Spread::of_sum(&up, &down)
        };
        Some([both(|way| &way.meant), both(|way| &way.measured)])
    }

    fn station(&self) -> (Spread, Plans) {
        let (Some(first), Some(last)) = (&self.first.station, &self.last.station) else {
            return (Spread::default(), Plans::default());
        };
        let plans = Plans {
            sent: last.plans - first.plans,
            shifted: last.shifted - first.shifted,
            failed: last.failed - first.failed,
            stale: last.stale - first.stale,
        };
        (Spread::of(&since(&first.lateness, &last.lateness)), plans)
    }

    fn plants(&self, which: fn(&PlantsMark) -> u64) -> u64 {
        let of = |marks: &Marks| marks.plants.as_ref().map_or(0, which);
        of(&self.last).saturating_sub(of(&self.first))
    }

    /// Of one robot on average.
    fn per_robot(&self, sum: u64) -> f64 {
        sum as f64 / self.duration_s / self.options.robots as f64
    }

    fn payload(&self) -> Traffic {
        let sum = |marks: &Marks, which: fn(&AgentMark) -> u64| -> u64 {
            marks.agents.iter().map(which).sum()
        };
        let rate = |which| self.per_robot(sum(&self.last, which) - sum(&self.first, which));
        Traffic {
            up_messages: rate(|agent| agent.sent[0]),
            up_bytes: rate(|agent| agent.sent[1]),
            down_messages: rate(|agent| agent.received[0]),
            down_bytes: rate(|agent| agent.received[1]),
        }
    }

    fn socket(&self) -> Option<Ways> {
        let (first, last) = (self.first.relay.as_ref()?, self.last.relay.as_ref()?);
        let rate = |way: usize, which: fn(&WayMark) -> u64| {
            self.per_robot(which(&last[way]) - which(&first[way]))
        };
        Some(Ways {
            up_bytes: rate(0, |way| way.bytes),
            down_bytes: rate(1, |way| way.bytes),
            up_segments: rate(0, |way| way.segments),
            down_segments: rate(1, |way| way.segments),
        })
    }

    fn parts(&self) -> Vec<PartFigures> {
        let mut parts: BTreeMap<Part, PartFigures> = BTreeMap::new();
        let percent = |ns: u64| 1e2 * ns as f64 * 1e-9 / self.duration_s;
        let add = |figures: &mut PartFigures, first: &Cost, last: &Cost| {
            figures.processes += 1;
            figures.threads += last.threads;
            figures.memory_bytes += last.resident;
            for (group, ns) in last.threads_since(first) {
                figures.cpu_percent += percent(ns);
                *figures.cpu_percent_by_thread.entry(group).or_default() += percent(ns);
            }
        };
        for ((part, first), (_, last)) in self.first.costs.iter().zip(&self.last.costs) {
            let figures = parts.entry(*part).or_default();
            part.name().clone_into(&mut figures.name);
            add(figures, first, last);
        }
        let mut meter = PartFigures {
            name: "meter".to_owned(),
            ..PartFigures::default()
        };
        add(&mut meter, &self.first.own, &self.last.own);
        parts.into_values().chain([meter]).collect()
    }

    fn machine(&self) -> Option<f64> {
        let ([busy_first, first], [busy, whole]) = (self.first.machine?, self.last.machine?);
        let cores = std::thread::available_parallelism().map_or(1, usize::from);
        let share = (busy - busy_first) as f64 / (whole - first).max(1) as f64;
        Some(1e2 * cores as f64 * share)
    }

    /// What was dropped, where and why: only what there was.
    fn drops(&self) -> BTreeMap<String, u64> {
        let mut drops = BTreeMap::new();
        let mut add = |what: String, count: u64| {
            if count > 0 {
                *drops.entry(what).or_default() += count;
            }
        };
        for (first, last) in self.first.agents.iter().zip(&self.last.agents) {
            for reason in DropReason::ALL {
                let i = reason as usize;
                let count = u64::from(last.dropped[i] - first.dropped[i]);
                add(format!("agents: {reason}"), count);
            }
            let frames = last.frames_dropped - first.frames_dropped;
            add("agents: motor frames".to_owned(), frames);
            let full = u64::from(last.outbox_full - first.outbox_full);
            add("agents: outbox full".to_owned(), full);
            let full = last.inbox_full - first.inbox_full;
            add("agents: inbox full".to_owned(), full);
        }
        if let (Some(first), Some(last)) = (&self.first.station, &self.last.station) {
            for reason in DropReason::ALL {
                let i = reason as usize;
                let count = u64::from(last.dropped[i] - first.dropped[i]);
                add(format!("station: {reason}"), count);
            }
            let overtaken = last.overtaken - first.overtaken;
            add("station: telemetry overtaken".to_owned(), overtaken);
            let refused = last.refused - first.refused;
            add("station: inbox full".to_owned(), refused);
        }
        // Handed to the network at one end, and not there at the other: what Zenoh dropped, and what is under way.
        let sum = |marks: &Marks, which: fn(&AgentMark) -> u64| -> u64 {
            marks.agents.iter().map(which).sum()
        };
        if let (Some(first), Some(last)) = (&self.first.station, &self.last.station) {
            let sent = last.sent[0] - first.sent[0];
            let which = |agent: &AgentMark| agent.received[0];
            let received = sum(&self.last, which) - sum(&self.first, which);
            // A second of what may be under way, or waits, is no loss.
            let under_way = (sent as f64 / self.duration_s.max(1.0)).ceil() as u64;
            let lost = sent.saturating_sub(received);
            if lost > under_way {
                add("network: plans and commands not arrived".to_owned(), lost);
            }
        }
        drops
    }

    fn each(&self) -> Vec<RobotFigures> {
        let agents = self.first.agents.iter().zip(&self.last.agents);
        let robots = self.scenario.robots.iter().zip(agents).enumerate();
        let here = Pose {
            x: 0.0,
            y: 0.0,
            heading: 0.0,
        };
        robots
            .map(|(index, (setup, (first, last)))| {
                let steps = |mode: usize| {
                    let of = |mark: &AgentMark| mark.modes.get(mode).copied().unwrap_or(0);
                    u64::from(of(last).saturating_sub(of(first)))
                };
                let all: u64 = (0..last.modes.len()).map(steps).sum();
                let trajectory = Trajectory::new(&setup.mission, &setup.model.robot, here).ok();
                let anchor = (self.last.station.as_ref())
                    .and_then(|station| *station.anchors.get(index)?)
                    .map(|anchor| last.zero_ns + anchor);
                let truths = self.last.plants.as_ref();
                let truths = truths.and_then(|plants| plants.truths.get(index));
                let errors = trajectory.zip(anchor).zip(truths);
                let squares: Vec<f64> = errors.map_or_else(Vec::new, |((path, anchor), truths)| {
                    let error = |(at, x, y): &(i64, f64, f64)| {
                        let [x_d, y_d] = path.nominal((at - anchor) as f64 * 1e-9);
                        (x - x_d).powi(2) + (y - y_d).powi(2)
                    };
                    truths.iter().map(error).collect()
                });
                let mean = squares.iter().sum::<f64>() / squares.len() as f64;
                RobotFigures {
                    id: setup.id.to_string(),
                    tracking: steps(Mode::Tracking as usize) as f64 / all.max(1) as f64,
                    position_rmse_m: (!squares.is_empty()).then(|| mean.sqrt()),
                }
            })
            .collect()
    }
}

fn since(first: &Sparse, last: &Sparse) -> Histogram {
    Histogram::from(last).since(&Histogram::from(first))
}

/// What a swarm must do and this one did not.
fn failures(report: &SwarmReport) -> Vec<String> {
    let mut failures = Vec::new();
    for robot in &report.each {
        if robot.tracking < TRACKING_MIN {
            let share = 1e2 * robot.tracking;
            failures.push(format!("{} tracked for {share:.1} % of the time", robot.id));
        } else {
            match robot.position_rmse_m {
                Some(rmse) if rmse <= RMSE_MAX => {}
                Some(rmse) => failures.push(format!(
                    "{} was {:.0} mm from its path (RMS), more than {:.0}",
                    robot.id,
                    1e3 * rmse,
                    1e3 * RMSE_MAX
                )),
                None => failures.push(format!("{} has no path", robot.id)),
            }
        }
    }
    match report.overhead_p99_ms() {
        Some(overhead) if overhead <= report.bound_ms => {}
        Some(overhead) => failures.push(format!(
            "plans were {overhead:.1} ms older at arrival than the injected delay makes them (p99), more than {:.0}",
            report.bound_ms
        )),
        None => failures.push("no plan arrived".to_owned()),
    }
    failures
}

/// Least share of the time in which a robot tracks.
const TRACKING_MIN: f64 = 0.99;
