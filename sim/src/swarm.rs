//! `sphere-sim swarm`: many robots live on one machine, measured.
//!
//! ```text
//!   plants ⇄ MAVLink over UDP ⇄ agents, one Zenoh session each ⇄ TCP ⇄ relay (delay) ⇄ the station's router and planner
//!   one process                 P processes                            one process     one process
//! ```
//!
//! Each part is a process of its own, a child of this one, so that /proc tells what each costs; all of them are what is deployed, but for
//! plants and relay. Robots drive on circles about one point, [`SPACING_M`] apart, and so never meet.
//!
//! The age that counts is a plan's **at arrival**: its arrival on board minus the stamp of the telemetry that it was computed from, both
//! in the robot's clock, no clocks compared. It is the sum of the way up, the wait for the robot's planning tick (up to a telemetry
//! period), planning, the way down, and the wait for the control thread. What the network is known to add is injected and
//! measured; the rest is ours, and bounded.

mod child;
mod cost;
mod figures;
mod idle;
mod message;
mod part;
mod plot;
mod process;
mod report;

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::net::SocketAddr;
use std::sync::atomic::{AtomicU32, Ordering};
use std::thread;
use std::time::{Duration, Instant};

use thiserror::Error;

use crate::scenario::{Scenario, ScenarioError};
use child::{ANSWER, PartProcess};
pub use cost::{PLANNING_US, computed};
use figures::{Marks, Measured};
use idle::Idle;
use message::{Answer, Ask, Part, PartSetup};
pub use part::run_part;
pub use plot::svg;
use process::Cost;
pub use report::{Spread, SwarmReport, markdown, summary};

/// How a swarm is to be run.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Options {
    /// How many robots, at least one.
    pub robots: usize,
    /// Processes over which their agents are spread, at least one.
    pub processes: usize,
    /// Length of the measurement, which begins 10 s after all robots track [s].
    pub duration_s: f64,
    /// Injected each way [ms]; without delay and jitter there is no relay.
    pub delay_ms: f64,
    /// Its standard deviation [ms].
    pub jitter_ms: f64,
    /// Between two telemetry messages of a robot, a multiple of the control period of 20 ms [ms].
    pub telemetry_ms: u32,
    /// Of sensor noise and jitter.
    pub seed: u64,
    /// By how much a plan's age at arrival may exceed the injected delay, both at p99 [ms].
    pub bound_ms: f64,
    /// Whether its processes log what they do.
    pub is_verbose: bool,
}

/// Why nothing was measured.
#[derive(Debug, Error)]
pub enum SwarmError {
    /// The missions of so many robots cannot be written down.
    #[error(transparent)]
    Scenario(#[from] ScenarioError),
    /// A process could not be started.
    #[error("cannot start the process of the {part}: {error}")]
    Start {
        /// Which.
        part: &'static str,
        /// Why.
        error: std::io::Error,
    },
    /// A part has ended, or says that it cannot go on.
    #[error("{part}: {why}")]
    Part {
        /// Which.
        part: &'static str,
        /// Why.
        why: String,
    },
    /// A part does not answer.
    #[error("the process of the {part} has not answered for {} s: this machine is too busy for so many robots; take fewer (--robots)", .timeout.as_secs())]
    Silent {
        /// Which.
        part: &'static str,
        /// For how long.
        timeout: Duration,
    },
    /// The bare thread could not be started.
    #[error("cannot start a thread: {0}")]
    Thread(std::io::Error),
    /// It was stopped before anything was measured.
    #[error("stopped before anything was measured")]
    Interrupted,
}

/// Runs a swarm, and ends it when `duration_s` has been measured or `stops` is no longer 0; at 2 it ends at once.
///
/// `tell` gets a line now and then.
///
/// # Errors
/// See [`SwarmError`]. A swarm that does badly is no error: [`SwarmReport::failures`].
pub fn run(
    options: &Options,
    stops: &AtomicU32,
    mut tell: impl FnMut(&str),
) -> Result<SwarmReport, SwarmError> {
    let clock = Stoppable { stops };
    let scenario = scenario(options.robots, options.seed, options.telemetry_ms)?;
    let idle = Idle::start().map_err(SwarmError::Thread)?;
    tell("Measuring the idle machine.");
    clock.pause(IDLE)?;
    let before = idle.lateness();

    tell("Starting station, relay, plants and agents.");
    let begin = now();
    let mut swarm = Swarm::start(options)?;
    let mut tracking = 0;
    let patience = PATIENCE + PATIENCE_ROBOT * options.robots as u32;
    let mut told = begin;
    let mut waiting = Vec::new();
    while tracking < options.robots && begin.elapsed() < patience {
        clock.pause(LOOK)?;
        (tracking, waiting) = swarm.look()?;
        if told.elapsed() > TELL {
            told = now();
            tell(&format!("{tracking} of {} robots track.", options.robots));
        }
    }
    let start_s = begin.elapsed().as_secs_f64();
    if tracking == options.robots {
        tell(&format!("All track after {start_s:.1} s."));
    } else {
        tell(&format!(
            "{tracking} of {} robots track after {start_s:.0} s: {}",
            options.robots,
            waiting.join(", ")
        ));
    }
    clock.pause(SETTLE)?;

    tell(&format!("Measuring for {:.0} s.", options.duration_s));
    let first = swarm.mark()?;
    let idle_first = idle.lateness();
    let began = now();
    let length = Duration::try_from_secs_f64(options.duration_s).unwrap_or_default();
    let is_interrupted = clock.pause(length).is_err();
    clock.unless_aborted()?;
    let duration_s = began.elapsed().as_secs_f64();
    let last = swarm.mark()?;
    let during = idle.lateness().since(&idle_first);
    if duration_s < SHORTEST_S {
        swarm.stop(&clock)?;
        return Err(SwarmError::Interrupted);
    }
    tell("The robots brake to rest.");
    swarm.stop(&clock)?;
    let measured = Measured {
        options,
        scenario: &scenario,
        start_s,
        duration_s,
        is_interrupted,
        is_real_time: idle.is_real_time(),
        idle_before: before,
        idle_during: during,
        first,
        last,
    };
    Ok(measured.report())
}

/// Robots r1, r2, ... of the real environment, each at the beginning of its own circle about the origin.
///
/// # Errors
/// No robot at all; a telemetry period that cannot be.
pub fn scenario(robots: usize, seed: u64, telemetry_ms: u32) -> Result<Scenario, ScenarioError> {
    let mut text = format!("seed = {seed}\n");
    for robot in 0..robots {
        let radius = SMALLEST_M + SPACING_M * robot as f64;
        // Writing to a String cannot fail.
        let _ = write!(
            text,
            "[[robots]]\nid = \"r{}\"\nstart = {{ x_m = {radius:.1}, heading_deg = 90.0 }}\ntelemetry_ms = {telemetry_ms}\nmission = {{ kind = \"circle\", radius_m = {radius:.1}, speed_mps = {SPEED_MPS:.1} }}\n",
            robot + 1
        );
    }
    let no_files = |file: &str| Err(format!("no file {file}"));
    Scenario::parse("swarm", &text, &[], no_files)
}

/// In the environment of a part: log what it does.
pub const VERBOSE: &str = "SPHERE_SWARM_VERBOSE";
/// Between two circles [m]: robots have a radius of 0.35 m.
pub const SPACING_M: f64 = 1.5;
/// Radius of the first circle [m].
const SMALLEST_M: f64 = 2.0;
const SPEED_MPS: f64 = 0.5;

/// All parts.
struct Swarm {
    parts: Vec<PartProcess>,
}

impl Swarm {
    fn start(options: &Options) -> Result<Self, SwarmError> {
        let setup = |part, first, last| PartSetup {
            part,
            robots: options.robots,
            first,
            last,
            seed: options.seed,
            delay_ms: options.delay_ms,
            jitter_ms: options.jitter_ms,
            telemetry_ms: options.telemetry_ms,
        };
        let all = options.robots;
        let start = |setup: &PartSetup| PartProcess::start(setup, options.is_verbose);
        let begin = |peers, connect| Ask::Begin { peers, connect };
        let mut station = start(&setup(Part::Station, 0, all))?;
        let mut plants = start(&setup(Part::Plants, 0, all))?;
        let processes = options.processes.clamp(1, all);
        let mut agents = (0..processes)
            .map(|i| {
                let bound = |i| all * i / processes;
                start(&setup(Part::Agents, bound(i), bound(i + 1)))
            })
            .collect::<Result<Vec<_>, _>>()?;
        let mut onward = listening(&mut station)?;
        let mut relay = None;
        if options.delay_ms > 0.0 || options.jitter_ms > 0.0 {
            let mut process = start(&setup(Part::Relay, 0, all))?;
            process.ask(&begin(Vec::new(), Some(onward)));
            onward = listening(&mut process)?;
            relay = Some(process);
        }
        let boards = bound(&mut plants)?;
        let mut ends = Vec::new();
        for process in &mut agents {
            ends.extend(bound(process)?);
        }
        plants.ask(&begin(ends, None));
        begun(&mut plants)?;
        for process in &mut agents {
            let mine = boards.get(process.first..).unwrap_or_default();
            process.ask(&begin(mine.to_vec(), Some(onward)));
        }
        for process in &mut agents {
            begun(process)?;
        }
        let mut parts = vec![station];
        parts.append(&mut agents);
        parts.push(plants);
        parts.extend(relay);
        Ok(Self { parts })
    }

    /// How many robots track, and of some others what they do.
    fn look(&mut self) -> Result<(usize, Vec<String>), SwarmError> {
        let mut sum = 0;
        let mut who = Vec::new();
        for process in self.parts.iter_mut().filter(|p| p.part == Part::Agents) {
            process.ask(&Ask::Look);
            match process.answer(ANSWER)? {
                Answer::Seen { tracking, others } => {
                    sum += tracking;
                    who.extend(others);
                }
                other => return Err(process.unexpected(&other)),
            }
        }
        Ok((sum, who))
    }

    fn mark(&mut self) -> Result<Marks, SwarmError> {
        let mut marks = Marks::now();
        for process in &mut self.parts {
            process.ask(&Ask::Mark);
            let cost = Cost::of(process.id()).unwrap_or_default();
            marks.costs.push((process.part, cost));
        }
        for process in &mut self.parts {
            marks.take(process.mark()?);
        }
        Ok(marks)
    }

    /// Agents first, so that their robots come to rest and their sessions are closed; then who serves them.
    fn stop(mut self, clock: &Stoppable<'_>) -> Result<(), SwarmError> {
        let order = BTreeMap::from([
            (Part::Agents, 0),
            (Part::Station, 1),
            (Part::Relay, 2),
            (Part::Plants, 3),
        ]);
        self.parts
            .sort_by_key(|process| order.get(&process.part).copied());
        for stage in self.parts.chunk_by_mut(|a, b| a.part == b.part) {
            for process in stage.iter_mut() {
                process.ask(&Ask::Stop);
            }
            for process in stage {
                clock.unless_aborted()?;
                match process.answer(ANSWER)? {
                    Answer::Ended => {}
                    other => return Err(process.unexpected(&other)),
                }
            }
        }
        Ok(())
    }
}

fn listening(process: &mut PartProcess) -> Result<SocketAddr, SwarmError> {
    match process.answer(ANSWER)? {
        Answer::Listening(at) => Ok(at),
        other => Err(process.unexpected(&other)),
    }
}

fn bound(process: &mut PartProcess) -> Result<Vec<SocketAddr>, SwarmError> {
    match process.answer(ANSWER)? {
        Answer::Bound(at) => Ok(at),
        other => Err(process.unexpected(&other)),
    }
}

fn begun(process: &mut PartProcess) -> Result<(), SwarmError> {
    match process.answer(ANSWER)? {
        Answer::Begun => Ok(()),
        other => Err(process.unexpected(&other)),
    }
}

/// Pauses that end when somebody wants an end.
struct Stoppable<'a> {
    stops: &'a AtomicU32,
}

impl Stoppable<'_> {
    #[allow(clippy::disallowed_methods, reason = "processes run in real time")]
    fn pause(&self, length: Duration) -> Result<(), SwarmError> {
        let begin = now();
        loop {
            if self.stops.load(Ordering::Relaxed) > 0 {
                return Err(SwarmError::Interrupted);
            }
            let left = length.saturating_sub(begin.elapsed());
            if left.is_zero() {
                return Ok(());
            }
            thread::sleep(left.min(Duration::from_millis(50)));
        }
    }

    fn unless_aborted(&self) -> Result<(), SwarmError> {
        match self.stops.load(Ordering::Relaxed) {
            0 | 1 => Ok(()),
            _ => Err(SwarmError::Interrupted),
        }
    }
}

#[allow(clippy::disallowed_methods, reason = "processes run in real time")]
fn now() -> Instant {
    Instant::now()
}

/// The idle machine is measured for this long before the robots start.
const IDLE: Duration = Duration::from_secs(3);
/// Between two looks at who tracks.
const LOOK: Duration = Duration::from_millis(250);
const TELL: Duration = Duration::from_secs(2);
/// So long robots have to come to track, and so much more for each.
const PATIENCE: Duration = Duration::from_secs(20);
const PATIENCE_ROBOT: Duration = Duration::from_millis(200);
/// From then on figures count: what a start disturbs has settled.
const SETTLE: Duration = Duration::from_secs(10);
/// Of less than this nothing can be said [s].
const SHORTEST_S: f64 = 1.0;
