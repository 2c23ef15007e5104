//! The demo: a fleet live, in one process and on the loopback interface alone.
//!
//! ```text
//!   plants ⇄ MAVLink over UDP ⇄ agents ⇄ Zenoh over TCP ⇄ relays (delay, jitter, loss) ⇄ the station's router and planner
//! ```
//!
//! Everything between the plants and the station is what is deployed. The demo only sets the robots out one after the other, reads
//! along 50 times a second, and scores what it read with the figures of every other run.

mod display;
mod fleet;
mod verdict;

use std::fmt::Write as _;
use std::net::SocketAddr;
use std::str::FromStr;
use std::time::Duration;

use sphere_agent::mode::Reason;
use sphere_protocol::message::Mode;
use sphere_protocol::robot::RobotId;
use sphere_protocol::time::Span;
use thiserror::Error;
use tokio::sync::mpsc;
use tokio::time::{Instant, sleep_until};

use crate::check;
use crate::metrics::{LiveMetrics, LiveRobotMetrics, RunMetrics, RunRecord, position_error};
use crate::relay::Counters;
use crate::run::{Run, bounds};
use crate::scenario::{Scenario, ScenarioError};
use crate::trace::{ROW_PERIOD, Row, Trace, mode_name};
pub use display::Display;
use fleet::Fleet;
pub(crate) use fleet::fresh_id;
pub use verdict::{RMSE_MAX, Verdict, summary, verdicts};

/// How the demo is to go.
#[derive(Clone, Debug, PartialEq)]
pub struct Options {
    /// Robots, links and length.
    pub scenario: Scenario,
    /// When links are cut.
    pub cuts: Vec<Cut>,
    /// Where copies of the motor links go, if anywhere: robot number i to its port + i.
    pub mirror: Option<SocketAddr>,
}

/// A time without link for one robot: `r2@30+5` cuts the link of r2 at 30 s for 5 s.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cut {
    /// Whose.
    pub robot: RobotId,
    /// Since the start of the demo.
    pub at: Span,
    /// How long.
    pub length: Span,
}

/// A text that is no [`Cut`].
#[derive(Debug, Error, PartialEq, Eq)]
#[error("`{0}` is no cut: write ROBOT@SECONDS+SECONDS, as in r2@30+5 (at 30 s, for 5 s)")]
pub struct CutError(String);

/// What there is to see at one instant.
#[derive(Clone, Debug)]
pub struct Scene<'a> {
    /// Where the station's router listens.
    pub endpoint: &'a str,
    /// Why that is not the usual place, if it is not.
    pub moved: Option<&'a str>,
    /// Since the start.
    pub t: Span,
    /// How long it will last.
    pub duration: Span,
    /// Whether it is over, and the robots brake.
    pub is_ending: bool,
    /// The robots.
    pub robots: &'a [SceneRobot],
    /// What happened, oldest first.
    pub events: &'a [SceneEvent],
}

/// One robot of a scene.
#[derive(Clone, Debug)]
pub struct SceneRobot {
    /// What it does.
    pub row: Row,
    /// Why it is in its mode, a sentence; `None` before its first control step.
    pub reason: Option<Reason>,
    /// The kind of its mission.
    pub mission: &'static str,
    /// Its link to the station.
    pub up: Counters,
    /// The way back.
    pub down: Counters,
    /// Whether its link is cut.
    pub is_cut: bool,
}

/// Something that happened.
#[derive(Clone, Debug, PartialEq)]
pub struct SceneEvent {
    /// When.
    pub t: Span,
    /// What.
    pub text: String,
}

/// What came of a demo.
pub struct Performance {
    /// As of a run in virtual time.
    pub run: Run,
    /// The scenario, its duration the time that it really took.
    pub scenario: Scenario,
    /// Whether it was ended before its time.
    pub is_interrupted: bool,
}

/// Why there is no demo.
#[derive(Debug, Error)]
pub enum DemoError {
    /// A cut for a robot that is not there.
    #[error("--cut {0}: no such robot; there are {1}")]
    UnknownRobot(RobotId, String),
    /// The station did not come up.
    #[error(transparent)]
    Station(#[from] sphere_ground::run::RunError),
    /// An agent did not come up, or ended before its time.
    #[error("the agent of {0}: {1}")]
    Agent(RobotId, sphere_agent::run::RunError),
    /// An agent ended before its time, without saying why.
    #[error("the agent of {0} ended by itself")]
    AgentEnded(RobotId),
    /// The plants.
    #[error(transparent)]
    Plants(#[from] crate::live::PlantsError),
    /// A relay could not listen, or no port is free for the router.
    #[error("no free port on the loopback interface: {0}")]
    Port(std::io::Error),
}

/// The demo's scenario, under `seed`, for `duration_s` seconds.
///
/// # Errors
/// A duration that is none.
pub fn scenario(seed: u64, duration_s: f64) -> Result<Scenario, ScenarioError> {
    let sets = [format!("seed={seed}"), format!("duration_s={duration_s:?}")];
    let no_files = |file: &str| Err(format!("no file {file}"));
    Scenario::parse(
        "demo",
        include_str!("../scenarios/demo.toml"),
        &sets,
        no_files,
    )
}

/// Runs the demo to its end, or until the first `stop`; the robots then brake to rest, or get zero torque at once with the second.
///
/// `show` is called ten times a second.
///
/// # Errors
/// See [`DemoError`].
pub async fn perform(
    options: Options,
    stop: &mut mpsc::Receiver<()>,
    mut show: impl FnMut(&Scene<'_>),
) -> Result<Performance, DemoError> {
    let Options {
        mut scenario,
        cuts,
        mirror,
    } = options;
    for cut in &cuts {
        if !scenario.robots.iter().any(|robot| robot.id == cut.robot) {
            let ids: Vec<_> = scenario
                .robots
                .iter()
                .map(|robot| robot.id.to_string())
                .collect();
            return Err(DemoError::UnknownRobot(cut.robot, ids.join(", ")));
        }
    }
    let duration = scenario.duration();
    let mut fleet = Fleet::start(&scenario, mirror).await?;
    let mut trace = Trace::new();
    let mut events: Vec<SceneEvent> = Vec::new();
    let mut robots: Vec<SceneRobot> = Vec::new();
    let mut t = Span::ZERO;
    let mut is_interrupted = false;
    while t < duration {
        let now = sleep_until(fleet.instant(t));
        tokio::select! {
            () = now => {}
            _ = stop.recv() => {
                is_interrupted = true;
                break;
            }
        }
        fleet.check_on_agents().await?;
        for cut in &cuts {
            if let Some(text) = fleet.apply(cut, t) {
                events.push(SceneEvent { t, text });
            }
        }
        let scene = fleet.scene(t);
        for (index, robot) in scene.iter().enumerate() {
            let mode = robot.row.mode;
            match robots.get(index).map(|before| before.row.mode) {
                Some(before) if before != mode => events.push(SceneEvent {
                    t,
                    text: mode_change(robot, before),
                }),
                _ => {}
            }
            trace.push(robot.row);
        }
        robots = scene;
        if let Some(text) = fleet.set_out(t) {
            events.push(SceneEvent { t, text });
        }
        if t.as_nanos() % SHOW_PERIOD.as_nanos() == 0 {
            show(&Scene {
                endpoint: fleet.endpoint(),
                moved: fleet.moved(),
                t,
                duration,
                is_ending: false,
                robots: &robots,
                events: &events,
            });
        }
        t = t + ROW_PERIOD;
    }
    scenario.duration_s = t.as_secs_f64();

    let records = fleet.records();
    let endpoint = fleet.endpoint().to_owned();
    let moved = fleet.moved().map(str::to_owned);
    let links: Vec<_> = robots.iter().map(|robot| (robot.up, robot.down)).collect();
    let mut braking = fleet.brake();
    let mut tick = tokio::time::interval(Duration::from_millis(100));
    let begin = Instant::now();
    loop {
        tokio::select! {
            at_rest = braking.at_rest() => break at_rest?,
            _ = stop.recv() => braking.abort(),
            _ = tick.tick() => {
                let t = t + Span::from_secs_f64(begin.elapsed().as_secs_f64());
                let robots = braking.scene(t);
                show(&Scene {
                    endpoint: &endpoint,
                    moved: moved.as_deref(),
                    t,
                    duration,
                    is_ending: true,
                    robots: &robots,
                    events: &events,
                });
            }
        }
    }
    let (reports, pace) = braking.end().await?;

    let record = RunRecord {
        seed: scenario.seed,
        duration: t,
        wall_s: t.as_secs_f64() + begin.elapsed().as_secs_f64(),
        settle: Span::from_secs_f64(scenario.metrics.settle_s),
        violations: check::violations(&trace, &bounds(&scenario), "sphere-sim demo"),
    };
    let mut metrics = RunMetrics::new(&trace, record, &records);
    metrics.live = Some(LiveMetrics {
        endpoint,
        plant_steps_late: pace.late,
        plant_lateness_max_s: pace.lateness_max.as_secs_f64(),
        robots: reports
            .iter()
            .zip(links)
            .map(|((id, report), (up, down))| LiveRobotMetrics {
                id: id.to_string(),
                control_steps: report.lateness.total(),
                control_lateness_p50_s: report.lateness.quantile(0.5).map(|d| d.as_secs_f64()),
                control_lateness_p99_s: report.lateness.quantile(0.99).map(|d| d.as_secs_f64()),
                control_lateness_max_s: report.lateness.max().as_secs_f64(),
                link_segments: up.segments + down.segments,
                link_stalls: up.stalls + down.stalls,
            })
            .collect(),
    });
    Ok(Performance {
        run: Run {
            trace,
            metrics,
            reports: Vec::new(),
            mission_starts: records.iter().map(|record| record.mission_start).collect(),
        },
        scenario,
        is_interrupted,
    })
}

/// As in "r1: tracking → fault (no valid sensor frame for 100 ms)".
fn mode_change(robot: &SceneRobot, before: Mode) -> String {
    let mut text = format!(
        "{}: {} → {}",
        robot.row.robot,
        mode_name(before),
        mode_name(robot.row.mode)
    );
    if let Some(reason) = robot.reason {
        // Writing to a String cannot fail.
        let _ = write!(text, " ({reason})");
    }
    text
}

impl SceneRobot {
    /// Distance from where its mission wants it now [m].
    pub fn error(&self) -> Option<f64> {
        position_error(&self.row)
    }
}

impl FromStr for Cut {
    type Err = CutError;

    fn from_str(text: &str) -> Result<Self, CutError> {
        let refused = || CutError(text.to_owned());
        let (robot, times) = text.split_once('@').ok_or_else(refused)?;
        let (at, length) = times.split_once('+').ok_or_else(refused)?;
        let seconds = |text: &str| match text.parse::<f64>() {
            Ok(seconds) if (0.0..1e6).contains(&seconds) => Ok(Span::from_secs_f64(seconds)),
            _ => Err(refused()),
        };
        Ok(Self {
            robot: robot.parse().map_err(|_| refused())?,
            at: seconds(at)?,
            length: seconds(length)?,
        })
    }
}

const SHOW_PERIOD: Span = Span::from_millis(100);
