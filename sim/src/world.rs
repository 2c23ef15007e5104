//! The world in virtual time: bodies, agents, network and station in one deterministic event loop.
//!
//! The agents and the station are the deployed cores, fed with the same bytes that they exchange in the field: MAVLink frames
//! between board and agent, CBOR messages between agent and station. Events are ordered by time and, at the same time, by the
//! order in which they were caused; every random number comes from a stream named after its robot and purpose.

use std::cmp::Reverse;
use std::collections::BinaryHeap;

use rand_distr::{Distribution, StandardUniform};
use sphere_agent::agent::{Agent, Event as AgentEvent, Input as AgentInput, Output as AgentOutput};
use sphere_agent::config::{AgentConfig, Timing};
use sphere_agent::control::DirectionChoice;
use sphere_agent::estimator::{EstimatorConfig, StartPose};
use sphere_agent::gains::GainsError;
use sphere_ground::station::{
    Event as StationEvent, Input as StationInput, Output as StationOutput, RobotConfig, Station,
    StationConfig,
};
use sphere_ground::tasking::StartCondition;
use sphere_ground::trajectory::{ReferencePoint, Trajectory};
use sphere_protocol::key::Key;
use sphere_protocol::message::PlanId;
use sphere_protocol::robot::RobotId;
use sphere_protocol::time::{AgentClock, GroundClock, Instant, Span};

use crate::body::{BOARD_HEARTBEAT, Body, BodyRandom, BodySetup, Purpose, stream};
use crate::disturbance::{Disturbance, Push};
use crate::metrics::{RobotRecord, RollStep, SolverCounts};
use crate::network::{Link, LinkModel};
use crate::scenario::{self, Loss, RobotSetup, RollController, Scenario};
use crate::sensor::Sensors;
use crate::trace::{Command, ROW_PERIOD, Reference, Row, Trace};

/// Virtual time since the world began.
type WorldTime = Span;

/// One run of a scenario.
pub struct World {
    robots: Vec<SimRobot>,
    station: Station,
    station_clock: Span,
    /// The station's timeout that is in the queue.
    station_due: WorldTime,
    queue: BinaryHeap<Reverse<Entry>>,
    caused: u64,
    trace: Trace,
    reports: Vec<Report>,
    tamper: Option<Tamper>,
}

/// Alters the frames of motor links in a test, or suppresses them by leaving nothing: whose, which way, the bytes.
pub type Tamper = Box<dyn FnMut(Span, usize, MotorWay, &mut Vec<u8>)>;

/// A direction on a motor link.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum MotorWay {
    /// From the board.
    ToAgent,
    /// From the agent.
    ToBoard,
}

/// Something an agent or the station reported.
#[derive(Clone, Debug)]
pub struct Report {
    /// When [s].
    pub t_s: f64,
    /// Which robot it concerns.
    pub robot: RobotId,
    /// What.
    pub what: Reported,
}

/// Who reported what.
#[derive(Clone, Debug)]
pub enum Reported {
    /// An agent.
    Agent(AgentEvent),
    /// The station.
    Station(StationEvent),
}

struct SimRobot {
    id: RobotId,
    body: Body,
    agent: Agent,
    /// What the agent's clock shows at time zero.
    clock: Span,
    agent_due: WorldTime,
    up: Link,
    down: Link,
    fix_period: Option<Span>,
    mission_started: Option<WorldTime>,
    roll_step: Option<RollStep>,
    newest_plan: Option<PlanId>,
    loop_delays: Vec<Span>,
}

struct Entry {
    at: WorldTime,
    order: u64,
    what: Happening,
}

enum Happening {
    Sense {
        robot: usize,
    },
    TakeFix {
        robot: usize,
    },
    FixArrives {
        robot: usize,
    },
    BoardHeartbeat {
        robot: usize,
    },
    FrameToAgent {
        robot: usize,
        bytes: Vec<u8>,
    },
    FrameToBoard {
        robot: usize,
        bytes: Vec<u8>,
    },
    AgentTimeout {
        robot: usize,
    },
    StationTimeout,
    ToAgent {
        robot: usize,
        key: Vec<u8>,
        bytes: Vec<u8>,
    },
    ToStation {
        key: Vec<u8>,
        bytes: Vec<u8>,
    },
    Sample,
}

/// A frame of 80 bytes on a serial line of 921 600 baud takes 0.9 ms; the same each way.
const MOTOR_LINK: Span = Span::from_millis(1);
/// A control step takes some 20 µs on a small computer; this leaves room for its being scheduled late.
const CONTROL_TIME: Span = Span::from_nanos(500_000);
/// A plan takes some 20 µs; this leaves room for a station that plans for many.
const PLANNING_TIME: Span = Span::from_millis(2);
/// Origins of the clocks that nobody asked for are drawn up to this far apart [s].
const CLOCK_SPREAD: f64 = 1000.0;

impl World {
    /// The world of `scenario` at time zero.
    ///
    /// # Errors
    /// A robot whose gains cannot be stable.
    pub fn new(scenario: &Scenario) -> Result<Self, GainsError> {
        let mut random = stream(scenario.seed, STATION, Purpose::Clocks);
        let mut draw = || -> f64 { StandardUniform.sample(&mut random) };
        let station_clock = Span::from_secs_f64(draw() * CLOCK_SPREAD);
        let station_id = 1 + (draw() * 1e15) as u64;
        let robots = scenario
            .robots
            .iter()
            .enumerate()
            .map(|(index, setup)| SimRobot::new(scenario, index, setup))
            .collect::<Result<Vec<_>, _>>()?;
        let config = station_config(scenario, station_id);
        let station = Station::new(config, Instant::from_nanos(0) + station_clock);
        let mut world = Self {
            robots,
            station,
            station_clock,
            station_due: Span::ZERO,
            queue: BinaryHeap::new(),
            caused: 0,
            trace: Trace::new(),
            reports: Vec::new(),
            tamper: None,
        };
        for robot in 0..world.robots.len() {
            world.schedule(Span::ZERO, Happening::Sense { robot });
            world.schedule(Span::ZERO, Happening::BoardHeartbeat { robot });
            world.schedule(Span::ZERO, Happening::AgentTimeout { robot });
            if world.robots[robot].fix_period.is_some() {
                world.schedule(Span::ZERO, Happening::TakeFix { robot });
            }
        }
        world.schedule(Span::ZERO, Happening::StationTimeout);
        world.schedule(Span::ZERO, Happening::Sample);
        Ok(world)
    }

    /// Lets time pass until `end` since the beginning.
    pub fn run_until(&mut self, end: Span) {
        while let Some(Reverse(next)) = self.queue.peek()
            && next.at <= end
        {
            let Some(Reverse(Entry { at, what, .. })) = self.queue.pop() else {
                break;
            };
            self.happen(at, what);
        }
    }

    /// What was recorded so far.
    pub fn trace(&self) -> &Trace {
        &self.trace
    }

    /// What agents and station reported so far.
    pub fn reports(&self) -> &[Report] {
        &self.reports
    }

    /// What is left of the world when its time is over.
    pub fn into_parts(self) -> (Trace, Vec<Report>) {
        (self.trace, self.reports)
    }

    /// Hands the station or an agent bytes that no one sent, as an attacker or a broken link would.
    pub fn inject(&mut self, at: Span, to: Inject, key: &str, bytes: &[u8]) {
        let (key, bytes) = (key.as_bytes().to_vec(), bytes.to_vec());
        self.schedule(
            at,
            match to {
                Inject::Station => Happening::ToStation { key, bytes },
                Inject::Agent(robot) => Happening::ToAgent { robot, key, bytes },
                Inject::MotorLink(robot) => Happening::FrameToAgent { robot, bytes },
                Inject::Board(robot) => Happening::FrameToBoard { robot, bytes },
            },
        );
    }

    /// From now on every frame of a motor link passes through `tamper` first: what a broken link does, or a wrong unit on a board.
    pub fn tamper_with_motor_links(&mut self, tamper: Tamper) {
        self.tamper = Some(tamper);
    }

    /// A robot's agent, by its place in the scenario.
    pub fn agent(&self, robot: usize) -> &Agent {
        &self.robots[robot].agent
    }

    /// The station.
    pub fn station(&self) -> &Station {
        &self.station
    }

    fn happen(&mut self, now: WorldTime, what: Happening) {
        match what {
            Happening::Sense { robot } => {
                let cell = &mut self.robots[robot];
                cell.body.advance(now);
                if let Some(frame) = cell.body.sense() {
                    self.frame_to_agent(now, robot, &frame);
                }
                self.schedule(now + Sensors::INTERVAL, Happening::Sense { robot });
            }
            Happening::BoardHeartbeat { robot } => {
                let frame = self.robots[robot].body.heartbeat();
                self.frame_to_agent(now, robot, &frame);
                self.schedule(now + BOARD_HEARTBEAT, Happening::BoardHeartbeat { robot });
            }
            Happening::TakeFix { robot } => {
                let cell = &mut self.robots[robot];
                cell.body.advance(now);
                cell.body.take_fix();
                let arrival = cell.body.next_fix_arrival();
                let period = cell.fix_period;
                if let Some(arrival) = arrival {
                    self.schedule(arrival.max(now), Happening::FixArrives { robot });
                }
                if let Some(period) = period {
                    self.schedule(now + period, Happening::TakeFix { robot });
                }
            }
            Happening::FixArrives { robot } => {
                let cell = &mut self.robots[robot];
                cell.body.advance(now);
                while let Some(frame) = self.robots[robot].body.arrived_fix() {
                    self.frame_to_agent(now, robot, &frame);
                }
            }
            Happening::FrameToAgent { robot, bytes } => {
                self.agent_input(now, robot, AgentInput::Motor(&bytes));
            }
            Happening::FrameToBoard { robot, bytes } => {
                let cell = &mut self.robots[robot];
                cell.body.advance(now);
                cell.body.receive(&bytes);
            }
            Happening::AgentTimeout { robot } => {
                if self.robots[robot].agent_due == now {
                    self.agent_input(now, robot, AgentInput::Timeout);
                }
            }
            Happening::ToAgent { robot, key, bytes } => {
                let key = String::from_utf8_lossy(&key);
                self.agent_input(
                    now,
                    robot,
                    AgentInput::Message {
                        key: &key,
                        bytes: &bytes,
                    },
                );
            }
            Happening::ToStation { key, bytes } => {
                let key = String::from_utf8_lossy(&key);
                self.station_input(
                    now,
                    StationInput::Message {
                        key: &key,
                        bytes: &bytes,
                    },
                );
            }
            Happening::StationTimeout => {
                if self.station_due == now {
                    self.station_input(now, StationInput::Timeout);
                }
            }
            Happening::Sample => {
                self.sample(now);
                self.schedule(now + ROW_PERIOD, Happening::Sample);
            }
        }
    }

    fn frame_to_agent(&mut self, now: WorldTime, robot: usize, frame: &[u8]) {
        let bytes = self.tampered(now, robot, MotorWay::ToAgent, frame);
        self.trace.absorb("motor", &bytes);
        self.schedule(now + MOTOR_LINK, Happening::FrameToAgent { robot, bytes });
    }

    fn tampered(&mut self, now: WorldTime, robot: usize, way: MotorWay, frame: &[u8]) -> Vec<u8> {
        let mut bytes = frame.to_vec();
        if let Some(tamper) = &mut self.tamper {
            tamper(now, robot, way, &mut bytes);
        }
        bytes
    }

    fn agent_input(&mut self, now: WorldTime, robot: usize, input: AgentInput<'_>) {
        let cell = &mut self.robots[robot];
        let agent_now = Instant::<AgentClock>::from_nanos(now.as_nanos()) + cell.clock;
        cell.agent.handle_input(agent_now, input);
        while let Some(output) = self.robots[robot].agent.poll_output() {
            match output {
                AgentOutput::Motor(frame) => {
                    let bytes = self.tampered(now, robot, MotorWay::ToBoard, &frame);
                    self.trace.absorb("motor", &bytes);
                    let arrival = now + CONTROL_TIME + MOTOR_LINK;
                    self.schedule(arrival, Happening::FrameToBoard { robot, bytes });
                }
                AgentOutput::Publish {
                    direction,
                    topic,
                    bytes,
                    ..
                } => {
                    self.trace.absorb(topic, &bytes);
                    let cell = &mut self.robots[robot];
                    let Ok(key) = Key::new(&cell.id, direction, topic) else {
                        continue;
                    };
                    let key = key.text().as_bytes().to_vec();
                    if let Some(delay) = cell.up.transmit(bytes.len()) {
                        let bytes = bytes.to_vec();
                        self.schedule(
                            now + CONTROL_TIME + delay,
                            Happening::ToStation { key, bytes },
                        );
                    }
                }
                AgentOutput::Event(event) => {
                    let robot = self.robots[robot].id;
                    self.report(now, robot, Reported::Agent(event));
                }
            }
        }
        let cell = &mut self.robots[robot];
        let due = Span::from_nanos(cell.agent.poll_timeout().as_nanos()) - cell.clock;
        if due != cell.agent_due || due <= now {
            cell.agent_due = due.max(now);
            let at = cell.agent_due;
            self.schedule(at, Happening::AgentTimeout { robot });
        }
    }

    fn station_input(&mut self, now: WorldTime, input: StationInput<'_>) {
        let station_now = Instant::<GroundClock>::from_nanos(now.as_nanos()) + self.station_clock;
        self.station.handle_input(station_now, input);
        while let Some(output) = self.station.poll_output() {
            match output {
                StationOutput::Publish {
                    robot: id,
                    key,
                    bytes,
                    ..
                } => {
                    self.trace.absorb(&key, &bytes);
                    let Some(robot) = self.robots.iter().position(|cell| cell.id == id) else {
                        continue;
                    };
                    let key = key.as_bytes().to_vec();
                    if let Some(delay) = self.robots[robot].down.transmit(bytes.len()) {
                        let bytes = bytes.to_vec();
                        self.schedule(
                            now + PLANNING_TIME + delay,
                            Happening::ToAgent { robot, key, bytes },
                        );
                    }
                }
                StationOutput::Event { robot, event } => {
                    self.report(now, robot, Reported::Station(event))
                }
            }
        }
        let due = Span::from_nanos(self.station.poll_timeout().as_nanos()) - self.station_clock;
        if due != self.station_due || due <= now {
            self.station_due = due.max(now);
            self.schedule(self.station_due, Happening::StationTimeout);
        }
    }

    /// One row for each robot.
    fn sample(&mut self, now: WorldTime) {
        for cell in &mut self.robots {
            cell.body.advance(now);
            let agent_now = Instant::<AgentClock>::from_nanos(now.as_nanos()) + cell.clock;
            let mission = self
                .station
                .session(&cell.id)
                .and_then(|session| session.task().running());
            let reference = mission.map(|(trajectory, anchor)| {
                cell.mission_started
                    .get_or_insert_with(|| Span::from_nanos(anchor.as_nanos()) - cell.clock);
                let t = (agent_now - anchor).as_secs_f64();
                if let Some(program) = trajectory.program()
                    && let Some(step) = program.first_step()
                {
                    let begin = Span::from_nanos(anchor.as_nanos()) - cell.clock;
                    cell.roll_step.get_or_insert(RollStep {
                        at: begin + Span::from_secs_f64(step.at),
                        from: step.from,
                        to: step.to,
                        until: Some(begin + Span::from_secs_f64(step.until)),
                    });
                }
                reference(trajectory, t)
            });
            let playback = cell.agent.playback();
            if playback.newest() != cell.newest_plan {
                cell.newest_plan = playback.newest();
                cell.loop_delays.extend(playback.loop_delay());
            }
            let signals = cell.agent.signals();
            self.trace.push(Row {
                t: now,
                robot: cell.id,
                truth: cell.body.state().robot,
                reference,
                estimate: signals.state,
                setpoint: signals.setpoint,
                command: signals.command.map(|[v, q_r]| Command { v, q_r }),
                torque_commanded: signals.torque,
                torque_applied: cell.body.torque(),
                mode: cell.agent.mode(),
                plan_age: signals.plan_age,
                playing: signals.playing,
            });
        }
    }

    /// What each robot's run amounts to, beside the trace.
    pub fn records(&self) -> Vec<RobotRecord> {
        self.robots
            .iter()
            .map(|cell| {
                let counters = self
                    .station
                    .session(&cell.id)
                    .map(|session| *session.counters())
                    .unwrap_or_default();
                RobotRecord {
                    robot: cell.id,
                    mission_start: cell.mission_started,
                    roll_step: cell.roll_step,
                    plans_sent: counters.plans_sent,
                    plans_adopted: cell.agent.playback().begun(),
                    loop_delays: cell.loop_delays.clone(),
                    bytes_up: cell.up.bytes,
                    bytes_down: cell.down.bytes,
                    solver: SolverCounts {
                        riccati: counters.riccati,
                        clarabel: counters.clarabel,
                        shifted: counters.shifted,
                    },
                }
            })
            .collect()
    }

    fn report(&mut self, now: WorldTime, robot: RobotId, what: Reported) {
        self.reports.push(Report {
            t_s: now.as_secs_f64(),
            robot,
            what,
        });
    }

    fn schedule(&mut self, at: WorldTime, what: Happening) {
        self.caused += 1;
        self.queue.push(Reverse(Entry {
            at,
            order: self.caused,
            what,
        }));
    }
}

impl SimRobot {
    fn new(scenario: &Scenario, index: usize, setup: &RobotSetup) -> Result<Self, GainsError> {
        let (boot_id, board_clock) = drawn_clocks(scenario.seed, index);
        let body = Body::new(
            body_setup(scenario, setup, board_clock),
            BodyRandom::new(scenario.seed, index),
        );
        let clock = Span::from_secs_f64(setup.clock_offset_s);
        let config = agent_config(setup, boot_id);
        let link = |model: &scenario::Link, purpose| {
            let loss = match model.loss {
                Loss::Independent(loss) => loss,
                Loss::Burst { .. } => 0.0,
            };
            let model = LinkModel {
                delay: model.delay().as_secs_f64(),
                jitter: model.jitter().as_secs_f64(),
                loss,
            };
            Link::new(model, stream(scenario.seed, index, purpose))
        };
        Ok(Self {
            id: setup.id,
            body,
            agent: Agent::new(Instant::from_nanos(0) + clock, config)?,
            clock,
            agent_due: Span::ZERO,
            up: link(&scenario.network.up, Purpose::LinkUp),
            down: link(&scenario.network.down, Purpose::LinkDown),
            fix_period: scenario.sensing.fix_period(),
            mission_started: None,
            roll_step: None,
            newest_plan: None,
            loop_delays: Vec::new(),
        })
    }
}

/// What `trajectory` asks for `t` seconds after its start, for the trace.
pub(crate) fn reference(trajectory: &Trajectory, t: f64) -> Reference {
    let point = trajectory.reference(t);
    if trajectory.program().is_some() {
        return Reference {
            pose: None,
            v: point.v,
            q_r: point.q_r,
        };
    }
    // Errors count from the path as the mission states it, not from the planner's drivable form of it.
    let [x, y] = trajectory.nominal(t);
    Reference::from(ReferencePoint { x, y, ..point })
}

/// The station of `scenario`, under the identity `station`.
pub(crate) fn station_config(scenario: &Scenario, station: u64) -> StationConfig {
    StationConfig {
        station,
        planner: scenario.planner,
        robots: scenario
            .robots
            .iter()
            .map(|setup| RobotConfig {
                id: setup.id,
                robot: setup.model.robot.clone(),
                mission: setup.mission.clone(),
                start: StartCondition::Ready,
            })
            .collect(),
    }
}

/// The agent of one robot of a scenario, in its life `boot_id`.
pub(crate) fn agent_config(setup: &RobotSetup, boot_id: u64) -> AgentConfig {
    AgentConfig {
        id: setup.id,
        robot: setup.model.robot.clone(),
        boot_id,
        estimator: EstimatorConfig {
            start: StartPose {
                x: setup.start.x_m,
                y: setup.start.y_m,
                heading: setup.start.heading(),
                ..StartPose::default()
            },
            ..Default::default()
        },
        direction: match setup.roll_controller {
            RollController::Htsmc => DirectionChoice::Htsmc,
            RollController::HtsmcPaper => DirectionChoice::HtsmcPaper,
            RollController::FuzzyPid => DirectionChoice::FuzzyPid,
            RollController::FuzzyPidSingle => DirectionChoice::FuzzyPidSingle,
        },
        timing: Timing::default(),
    }
}

/// The body of one robot of `scenario`, whose board's clock shows `clock_offset` at time zero.
pub(crate) fn body_setup(scenario: &Scenario, setup: &RobotSetup, clock_offset: Span) -> BodySetup {
    let sensing = &scenario.sensing;
    BodySetup {
        params: setup.plant,
        start: [setup.start.x_m, setup.start.y_m, setup.start.heading()],
        disturbance: disturbance(&setup.disturbance),
        noise: sensing.noise,
        fix_sigma: sensing.position_fix_sigma(),
        clock_offset,
    }
}

/// Boot id of the agent and origin of the board's clock of robot number `robot` under `seed`.
pub(crate) fn drawn_clocks(seed: u64, robot: usize) -> (u64, Span) {
    let mut random = stream(seed, robot, Purpose::Clocks);
    let mut draw = || -> f64 { StandardUniform.sample(&mut random) };
    let boot_id = 1 + (draw() * 9e15) as u64;
    (boot_id, Span::from_secs_f64(draw() * CLOCK_SPREAD))
}

fn disturbance(setup: &scenario::Disturbance) -> Disturbance {
    Disturbance {
        imbalance: setup.imbalance_nm,
        pushes: setup
            .pushes
            .iter()
            .map(|push| Push {
                roll_nm: push.roll_nm,
                pitch_nm: 0.0,
                at_s: push.at_s,
                for_s: push.for_s,
            })
            .collect(),
        ..Disturbance::default()
    }
}

/// Where outside bytes enter.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Inject {
    /// The station's subscription.
    Station,
    /// A robot's subscription, by its place in the scenario.
    Agent(usize),
    /// A robot's motor link, towards the agent.
    MotorLink(usize),
    /// A robot's motor link, towards the board.
    Board(usize),
}

const STATION: usize = usize::MAX / 32;

impl PartialEq for Entry {
    fn eq(&self, other: &Self) -> bool {
        self.cmp(other).is_eq()
    }
}
impl Eq for Entry {}
impl PartialOrd for Entry {
    fn partial_cmp(&self, other: &Self) -> Option<std::cmp::Ordering> {
        Some(self.cmp(other))
    }
}
impl Ord for Entry {
    fn cmp(&self, other: &Self) -> std::cmp::Ordering {
        (self.at, self.order).cmp(&(other.at, other.order))
    }
}
