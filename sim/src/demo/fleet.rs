//! The parts of the demo: a station with its router, and for each robot a plant, an agent and a relay.

use std::collections::BTreeMap;
use std::hash::{BuildHasher, RandomState};
use std::io;
use std::net::{Ipv4Addr, SocketAddr, TcpListener};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use sphere_agent::run::{Report, RunError, Setup as AgentSetup, Snapshot};
use sphere_ground::run::{Running, Setup as StationSetup, Watch};
use sphere_ground::session::Counters as StationCounters;
use sphere_ground::station::Order;
use sphere_ground::tasking::StartCondition;
use sphere_ground::trajectory::Trajectory;
use sphere_protocol::io::bus::Role;
use sphere_protocol::message::{Mode, PlanId};
use sphere_protocol::robot::RobotId;
use sphere_protocol::time::{AgentClock, Instant, Span};
use tokio::sync::mpsc;
use tokio::task::JoinHandle;

use super::{Cut, DemoError, SceneRobot};
use crate::body::{Purpose, stream};
use crate::live::{Mirror, Pace, PlantSetup, Plants, Truth, Truths, link_pair, plant_setup};
use crate::metrics::{RobotRecord, SolverCounts};
use crate::relay::{Direction, Relay};
use crate::scenario::{Link, Scenario};
use crate::trace::{Command, Reference, Row};
use crate::world::{agent_config, station_config};

/// Everything that runs.
pub(super) struct Fleet {
    endpoint: String,
    moved: Option<String>,
    station: Running,
    known: Arc<Mutex<BTreeMap<RobotId, Known>>>,
    plants: Plants,
    robots: Vec<LiveRobot>,
    /// The robot to set out next, and when the one before it was told to.
    next: usize,
    told: Span,
}

/// What the station knows of one robot.
#[derive(Clone, Default)]
struct Known {
    /// The mission and its beginning, while it runs.
    mission: Option<(Trajectory, Instant<AgentClock>)>,
    is_idle: bool,
    counters: StationCounters,
}

struct LiveRobot {
    id: RobotId,
    mission: &'static str,
    truths: Truths,
    watch: Arc<Mutex<Snapshot>>,
    relay: Relay,
    stop: mpsc::Sender<()>,
    agent: JoinHandle<Result<Report, RunError>>,
    /// Since the start of the plants.
    mission_start: Option<Span>,
    newest_plan: Option<PlanId>,
    loop_delays: Vec<Span>,
    plans_begun: u64,
}

impl Fleet {
    pub(super) async fn start(
        scenario: &Scenario,
        mirror: Option<SocketAddr>,
    ) -> Result<Self, DemoError> {
        let known = Arc::new(Mutex::new(BTreeMap::<RobotId, Known>::new()));
        let (station, router, moved) = start_station(scenario, &known).await?;
        let mut robots = Vec::new();
        let mut setups: Vec<PlantSetup> = Vec::new();
        let mut links = Vec::new();
        for index in 0..scenario.robots.len() {
            let (agent_link, board_link) = link_pair()?;
            let mirror = mirror
                .map(|first| Mirror::new(first, index))
                .transpose()
                .map_err(DemoError::Port)?;
            setups.push(PlantSetup {
                mirror,
                ..plant_setup(scenario, index, board_link)
            });
            links.push(agent_link);
        }
        let plants = Plants::start(setups)?;
        for (index, (setup, link)) in scenario.robots.iter().zip(links).enumerate() {
            let direction = |model: &Link, purpose| Direction {
                model: crate::world::link_model(model),
                random: stream(scenario.seed, index, purpose),
            };
            let relay = Relay::start(
                SocketAddr::from((Ipv4Addr::LOCALHOST, 0)),
                router,
                direction(&scenario.network.up, Purpose::LinkUp),
                direction(&scenario.network.down, Purpose::LinkDown),
            )
            .await
            .map_err(DemoError::Port)?;
            let watch = Arc::new(Mutex::new(Snapshot::default()));
            let (stop, stopped) = mpsc::channel(2);
            let agent = tokio::spawn(sphere_agent::run::run(
                AgentSetup {
                    agent: agent_config(setup, fresh_id()),
                    link,
                    network: Role::Client {
                        connect: vec![format!("tcp/{}", relay.address())],
                    },
                    watch: Some(watch.clone()),
                    recorder: None,
                },
                stopped,
            ));
            robots.push(LiveRobot {
                id: setup.id,
                mission: setup.mission.kind(),
                truths: plants.truths()[index].clone(),
                watch,
                relay,
                stop,
                agent,
                mission_start: None,
                newest_plan: None,
                loop_delays: Vec::new(),
                plans_begun: 0,
            });
        }
        Ok(Self {
            endpoint: format!("tcp/{router}"),
            moved,
            station,
            known,
            plants,
            robots,
            next: 0,
            told: Span::ZERO,
        })
    }

    /// Where the station's router listens.
    pub(super) fn endpoint(&self) -> &str {
        &self.endpoint
    }

    /// Why it does not listen in the usual place.
    pub(super) fn moved(&self) -> Option<&str> {
        self.moved.as_deref()
    }

    /// The machine's time of `t` since the start of the plants.
    pub(super) fn instant(&self, t: Span) -> tokio::time::Instant {
        let since = Duration::from_nanos(t.as_nanos().unsigned_abs());
        tokio::time::Instant::from_std(self.plants.origin() + since)
    }

    /// An agent that has ended is an error: it should run until it is told to stop.
    pub(super) async fn check_on_agents(&mut self) -> Result<(), DemoError> {
        for robot in &mut self.robots {
            if robot.agent.is_finished() {
                return Err(match (&mut robot.agent).await {
                    Ok(Err(error)) => DemoError::Agent(robot.id, error),
                    Ok(Ok(_)) | Err(_) => DemoError::AgentEnded(robot.id),
                });
            }
        }
        Ok(())
    }

    /// Cuts or heals at the time of `cut`; says so if that changed anything.
    pub(super) fn apply(&self, cut: &Cut, t: Span) -> Option<String> {
        let robot = self.robots.iter().find(|robot| robot.id == cut.robot)?;
        let end = cut.at + cut.length;
        let is_due = |at: Span| t >= at && t < at + crate::trace::ROW_PERIOD;
        if is_due(cut.at) {
            robot.relay.cut();
            return Some(format!("{}: link cut", robot.id));
        }
        if is_due(end) {
            robot.relay.heal();
            return Some(format!("{}: link back", robot.id));
        }
        None
    }

    /// Sets the next robot out on its mission, once it is armed and the one before it is well on its way.
    pub(super) fn set_out(&mut self, t: Span) -> Option<String> {
        let robot = self.robots.get(self.next)?;
        let is_ready = self.known_of(robot.id).is_idle;
        let before = self.next.checked_sub(1).map(|before| &self.robots[before]);
        let is_clear = before.is_none_or(|before| {
            before
                .mission_start
                .is_some_and(|start| t >= start + SPACING)
                || t >= self.told + PATIENCE
        });
        if !(is_ready && is_clear) {
            return None;
        }
        let id = robot.id;
        if !self.station.orders().give(id, Order::Start) {
            return None;
        }
        let text = format!("{id}: sets out on its {}", robot.mission);
        self.told = t;
        self.next += 1;
        Some(text)
    }

    /// Each robot at `t` since the start of the plants.
    pub(super) fn scene(&mut self, t: Span) -> Vec<SceneRobot> {
        let known = self
            .known
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .clone();
        self.robots
            .iter_mut()
            .map(|robot| robot.scene(t, known.get(&robot.id).and_then(|k| k.mission.as_ref())))
            .collect()
    }

    /// What each robot's run amounts to, beside the trace.
    pub(super) fn records(&self) -> Vec<RobotRecord> {
        let record = |robot: &LiveRobot| {
            let counters = self.known_of(robot.id).counters;
            RobotRecord {
                robot: robot.id,
                mission_start: robot.mission_start,
                roll_step: None,
                plans_sent: counters.plans_sent,
                plans_adopted: robot.plans_begun,
                loop_delays: robot.loop_delays.clone(),
                bytes_up: robot.relay.up().bytes,
                bytes_down: robot.relay.down().bytes,
                solver: SolverCounts {
                    riccati: counters.riccati,
                    clarabel: counters.clarabel,
                    shifted: counters.shifted,
                    real_time: counters.real_time,
                    shed: counters.shed,
                },
            }
        };
        self.robots.iter().map(record).collect()
    }

    /// Tells every agent to stop.
    pub(super) fn brake(self) -> Braking {
        for robot in &self.robots {
            // Otherwise its session could not be closed.
            robot.relay.heal();
            // An agent that has ended has nothing to be told.
            let _ = robot.stop.try_send(());
        }
        Braking {
            fleet: self,
            reports: Vec::new(),
        }
    }

    fn known_of(&self, robot: RobotId) -> Known {
        let known = self.known.lock().unwrap_or_else(PoisonError::into_inner);
        known.get(&robot).cloned().unwrap_or_default()
    }
}

/// A fleet on its way to rest.
pub(super) struct Braking {
    fleet: Fleet,
    reports: Vec<(RobotId, Report)>,
}

impl Braking {
    /// Waits until every agent has ended. May be dropped and called again.
    pub(super) async fn at_rest(&mut self) -> Result<(), DemoError> {
        while let Some(robot) = self.fleet.robots.get_mut(self.reports.len()) {
            let report = match (&mut robot.agent).await {
                Ok(report) => report.map_err(|error| DemoError::Agent(robot.id, error))?,
                Err(_) => return Err(DemoError::AgentEnded(robot.id)),
            };
            self.reports.push((robot.id, report));
        }
        Ok(())
    }

    /// Ends the rest: what each agent reported, and how well the plants kept to time.
    pub(super) async fn end(self) -> Result<(Vec<(RobotId, Report)>, Pace), DemoError> {
        self.fleet.station.stop().await?;
        Ok((self.reports, self.fleet.plants.stop()?))
    }

    /// Zero torque now.
    pub(super) fn abort(&self) {
        for robot in &self.fleet.robots {
            let _ = robot.stop.try_send(());
        }
    }

    /// What the robots do now, `t` after the start.
    pub(super) fn scene(&mut self, t: Span) -> Vec<SceneRobot> {
        let mut robots = self.fleet.scene(t);
        for robot in &mut robots {
            // The station's path goes on, the robot does not.
            robot.row.reference = None;
        }
        robots
    }
}

impl LiveRobot {
    fn scene(
        &mut self,
        t: Span,
        mission: Option<&(Trajectory, Instant<AgentClock>)>,
    ) -> SceneRobot {
        let shown = self
            .watch
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .clone();
        // A row is one instant: that of the agent's last control step. An agent that has not stepped for long hides nothing.
        let truth = shown
            .clock
            .and_then(|clock| self.truths.at(clock.deadline(shown.stepped)))
            .unwrap_or_else(|| self.truths.newest());
        if shown.newest_plan != self.newest_plan {
            self.newest_plan = shown.newest_plan;
            self.loop_delays.extend(shown.loop_delay);
        }
        self.plans_begun = shown.plans_begun;
        let reference = mission
            .zip(shown.clock)
            .map(|((trajectory, anchor), clock)| {
                // The instant for which the truth is true, by the agent's clock: the error is exact whenever this is read.
                let zero = clock.deadline(Instant::from_nanos(0));
                let agent_now = Instant::from_nanos(nanos_since(truth.at, zero));
                let into = agent_now.since(*anchor);
                self.mission_start.get_or_insert(truth.elapsed - into);
                crate::world::reference(trajectory, into.as_secs_f64())
            });
        SceneRobot {
            row: row(t, self.id, &truth, &shown, reference),
            reason: shown.reason,
            mission: self.mission,
            up: self.relay.up(),
            down: self.relay.down(),
            is_cut: self.relay.is_cut(),
        }
    }
}

fn row(
    t: Span,
    robot: RobotId,
    truth: &Truth,
    shown: &Snapshot,
    reference: Option<Reference>,
) -> Row {
    let signals = &shown.signals;
    Row {
        t,
        robot,
        truth: truth.state,
        reference,
        estimate: signals.state,
        setpoint: signals.setpoint,
        command: signals.command.map(|[v, q_r]| Command { v, q_r }),
        torque_commanded: signals.torque,
        torque_applied: truth.torque,
        mode: shown.mode.unwrap_or(Mode::Boot),
        plan_age: signals.plan_age,
        playing: signals.playing,
        life: 0,
    }
}

/// Starts the station with its router in the usual place, or, if that is taken, in one that is free.
async fn start_station(
    scenario: &Scenario,
    known: &Arc<Mutex<BTreeMap<RobotId, Known>>>,
) -> Result<(Running, SocketAddr, Option<String>), DemoError> {
    let usual = SocketAddr::from((Ipv4Addr::LOCALHOST, ROUTER_PORT));
    let mut moved = None;
    let mut at = usual;
    if let Err(error) = TcpListener::bind(usual) {
        moved = Some(format!("port {ROUTER_PORT} is taken ({})", reason(&error)));
        at = free_port().map_err(DemoError::Port)?;
    }
    let mut attempts = 0;
    loop {
        attempts += 1;
        match Running::start(station_setup(scenario, at, watch(known))).await {
            Ok(station) => return Ok((station, at, moved)),
            // Somebody was faster: between the look at a port and its use others may take it.
            Err(error) if attempts < ATTEMPTS => {
                moved = Some(format!("{at} could not be used ({error})"));
                at = free_port().map_err(DemoError::Port)?;
            }
            Err(error) => return Err(error.into()),
        }
    }
}

fn station_setup(scenario: &Scenario, at: SocketAddr, watch: Watch) -> StationSetup {
    let mut station = station_config(scenario, fresh_id());
    for robot in &mut station.robots {
        robot.start = StartCondition::Ordered;
    }
    StationSetup {
        station,
        network: Role::Router {
            listen: vec![format!("tcp/{at}")],
        },
        threads: None,
        watch: Some(watch),
    }
}

fn watch(known: &Arc<Mutex<BTreeMap<RobotId, Known>>>) -> Watch {
    let known = known.clone();
    Box::new(move |station, _| {
        let mut known = known.lock().unwrap_or_else(PoisonError::into_inner);
        for (id, session) in station.sessions() {
            let known = known.entry(*id).or_default();
            let anchor = session.task().running().map(|(_, anchor)| anchor);
            if anchor != known.mission.as_ref().map(|(_, anchor)| *anchor) {
                known.mission = session
                    .task()
                    .running()
                    .map(|(trajectory, anchor)| (trajectory.clone(), anchor));
            }
            known.is_idle = session
                .telemetry()
                .is_some_and(|telemetry| telemetry.mode == Mode::Idle);
            known.counters = *session.counters();
        }
    })
}

fn free_port() -> io::Result<SocketAddr> {
    TcpListener::bind((Ipv4Addr::LOCALHOST, 0))?.local_addr()
}

fn reason(error: &io::Error) -> &'static str {
    match error.kind() {
        io::ErrorKind::AddrInUse => "another program listens there",
        io::ErrorKind::PermissionDenied => "not permitted",
        _ => "it cannot be opened",
    }
}

/// A number that no other life of an agent or station has: drawn from the system, below 2⁵³, not 0.
pub(crate) fn fresh_id() -> u64 {
    1 + (RandomState::new().hash_one("id") >> 12)
}

fn nanos_since(later: std::time::Instant, earlier: std::time::Instant) -> i64 {
    let nanos = |duration: Duration| i64::try_from(duration.as_nanos()).unwrap_or(i64::MAX);
    match later.checked_duration_since(earlier) {
        Some(ahead) => nanos(ahead),
        None => -nanos(earlier.saturating_duration_since(later)),
    }
}

/// Zenoh's own.
const ROUTER_PORT: u16 = 7447;
const ATTEMPTS: u32 = 4;
/// The paths of the paper meet: who follows 3 s behind on them stays 1.5 m away.
const SPACING: Span = Span::from_millis(3000);
/// Nobody waits longer than this for one that does not get ready.
const PATIENCE: Span = Span::from_millis(8000);
