//! The world in virtual time: bodies, agents, network and station in one deterministic event loop.
//!
//! The agents and the station are the deployed cores, fed with the same bytes that they exchange in the field: MAVLink frames
//! between board and agent, CBOR messages between agent and station. Events are ordered by time and, at the same time, by the
//! order in which they were caused; every random number comes from a stream named after its robot and purpose.

mod faults;
mod planning;
mod process;
mod setup;

use std::cmp::Reverse;
use std::collections::{BTreeMap, BinaryHeap};

use rand_distr::{Distribution, StandardUniform};
use sphere_agent::agent::{Agent, Event as AgentEvent, Input as AgentInput, Output as AgentOutput};
use sphere_agent::config::AgentConfig;
use sphere_agent::gains::GainsError;
use sphere_ground::session::{Counters, Session};
use sphere_ground::station::{
    Event as StationEvent, Input as StationInput, Output as StationOutput, Station,
};
use sphere_ground::trajectory::Trajectory;
use sphere_protocol::key::Key;
use sphere_protocol::message::{Message, PlanId, SetpointPlan};
use sphere_protocol::robot::RobotId;
use sphere_protocol::time::{AgentClock, GroundClock, Instant, Span};

use crate::body::{BOARD_HEARTBEAT, Body, BodyRandom, Purpose, stream};
use crate::check::{Circumstances, Monitor};
use crate::clock::SimClock;
use crate::metrics::{RobotRecord, RollStep, SolverCounts, Violation};
use crate::network::{Link, LinkRandom};
use crate::scenario::{self, RobotSetup, Scenario};
use crate::sensor::Sensors;
use crate::trace::{Command, ROW_PERIOD, Row, Trace};
use faults::LinkFaults;
use process::Process;
#[cfg(feature = "io")]
pub(crate) use setup::{
    agent_config, body_setup, drawn_clocks, link_model, reference, station_config,
};

/// Virtual time since the world began.
type WorldTime = Span;

/// One run of a scenario.
pub struct World {
    robots: Vec<SimRobot>,
    station: Station,
    station_clock: Span,
    /// Identity of the first station; each later one's is one higher.
    station_id: u64,
    /// The station's timeout that is in the queue.
    station_due: WorldTime,
    /// Until when it is busy planning.
    station_free: WorldTime,
    queue: BinaryHeap<Reverse<Entry>>,
    caused: u64,
    scenario: Scenario,
    station_process: Process,
    /// Stations before this one.
    station_lives: u64,
    /// What they sent.
    earlier_plans: BTreeMap<RobotId, Counters>,
    trace: Trace,
    reports: Vec<Report>,
    tamper: Option<Tamper>,
    monitor: Monitor,
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
    /// The agent's clock.
    clock: SimClock,
    process: Process,
    /// How often its agent has started again.
    lives: u32,
    /// Plans that its agents' earlier lives adopted.
    earlier_adopted: u64,
    agent_due: WorldTime,
    /// What goes wrong on its link now.
    link_faults: LinkFaults,
    up: Link,
    down: Link,
    fix_period: Option<Span>,
    mission_started: Option<WorldTime>,
    /// The mission that runs, and since when, also while its station is gone.
    mission: Option<(Trajectory, WorldTime)>,
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
    FaultBegins {
        fault: usize,
    },
    FaultEnds {
        fault: usize,
    },
    Replay {
        fault: usize,
    },
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
        let config = setup::station_config(scenario, station_id);
        let station = planning::station(scenario, config, Instant::from_nanos(0) + station_clock);
        let mut world = Self {
            robots,
            station,
            station_clock,
            station_id,
            station_due: Span::ZERO,
            station_free: Span::ZERO,
            queue: BinaryHeap::new(),
            caused: 0,
            scenario: scenario.clone(),
            station_process: Process::default(),
            station_lives: 0,
            earlier_plans: BTreeMap::new(),
            trace: Trace::new(),
            reports: Vec::new(),
            tamper: None,
            monitor: Monitor::new(
                scenario,
                (0..).map(|robot| setup::drawn_clocks(scenario.seed, robot).0),
            ),
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
        for (fault, set) in scenario.faults.iter().enumerate() {
            let begin = Span::from_secs_f64(set.at_s);
            world.schedule(begin, Happening::FaultBegins { fault });
            let end = begin + Span::from_secs_f64(set.for_s);
            world.schedule(end, Happening::FaultEnds { fault });
        }
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

    /// The invariants that have broken so far, each with `replay`, the command that runs this again.
    pub fn violations(&self, replay: &str) -> Vec<Violation> {
        let breaches = self.monitor.breaches().iter();
        breaches.map(|breach| breach.violation(replay)).collect()
    }

    /// The longest that a holding robot has taken to come to rest, beyond the time of braking.
    pub fn longest_rest(&self) -> Span {
        self.monitor.longest_rest()
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

    /// From `now` on another agent is in the place of robot number `robot`'s, its configuration altered by `alter`, and nobody is told:
    /// how a test shows what a defective one does.
    ///
    /// # Errors
    /// Gains that cannot be stable.
    pub fn replace_agent(
        &mut self,
        now: Span,
        robot: usize,
        alter: impl FnOnce(&mut AgentConfig),
    ) -> Result<(), GainsError> {
        let cell = &mut self.robots[robot];
        let (boot_id, _) = setup::drawn_clocks(self.scenario.seed, robot);
        let boot_id = boot_id + u64::from(cell.lives);
        let mut config = setup::agent_config(&self.scenario.robots[robot], boot_id);
        alter(&mut config);
        cell.agent = Agent::new(cell.agent_now(now), config)?;
        cell.agent_due = now;
        self.schedule(now, Happening::AgentTimeout { robot });
        Ok(())
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
                self.monitor.on_board_input(now, robot, &bytes);
                let cell = &mut self.robots[robot];
                cell.body.elapse(now);
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
            // A station that plans takes nothing in meanwhile.
            Happening::ToStation { .. } if now < self.station_free => {
                self.schedule(self.station_free, what);
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
            Happening::FaultBegins { fault } => self.fault_begins(now, fault),
            Happening::FaultEnds { fault } => self.fault_ends(now, fault),
            Happening::Replay { fault } => self.replay(now, fault),
            Happening::StationTimeout => {
                if self.station_due == now && now < self.station_free {
                    // After the messages that wait.
                    self.station_due = self.station_free + Span::from_nanos(1);
                    self.schedule(self.station_due, Happening::StationTimeout);
                } else if self.station_due == now {
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
        if !cell.process.is_running() {
            return match input {
                AgentInput::Motor(bytes) => cell.process.store_frame(bytes),
                AgentInput::Message { key, bytes } => {
                    cell.process.store_message(key.as_bytes(), bytes);
                }
                _ => {}
            };
        }
        let agent_now = cell.agent_now(now);
        cell.agent.handle_input(agent_now, input);
        while let Some(output) = self.robots[robot].agent.poll_output() {
            match output {
                AgentOutput::Motor(frame) => {
                    let bytes = self.tampered(now, robot, MotorWay::ToBoard, &frame);
                    let cell = &self.robots[robot];
                    let agent_now = cell.agent_now(now);
                    (self.monitor).on_motor_output(now, robot, agent_now, &cell.agent, &bytes);
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
                    cell.link_faults.record(Inject::Station, &key, &bytes);
                    for delay in cell.up.transmit(now, bytes.len()) {
                        let (key, bytes) = (key.clone(), bytes.to_vec());
                        let arrival = now + CONTROL_TIME + delay;
                        let arrival = self.robots[robot].link_faults.held(now, arrival);
                        self.schedule(arrival, Happening::ToStation { key, bytes });
                    }
                }
                AgentOutput::Event(event) => {
                    let robot = self.robots[robot].id;
                    self.report(now, robot, Reported::Agent(event));
                }
            }
        }
        let cell = &mut self.robots[robot];
        let due = cell.world_time(cell.agent.poll_timeout());
        if due != cell.agent_due || due <= now {
            cell.agent_due = due.max(now);
            let at = cell.agent_due;
            self.schedule(at, Happening::AgentTimeout { robot });
        }
    }

    fn station_input(&mut self, now: WorldTime, input: StationInput<'_>) {
        if !self.station_process.is_running() {
            if let StationInput::Message { key, bytes } = input {
                self.station_process.store_message(key.as_bytes(), bytes);
            }
            return;
        }
        let station_now = Instant::<GroundClock>::from_nanos(now.as_nanos()) + self.station_clock;
        self.station.handle_input(station_now, input);
        let planning = self.station.take_planning_time();
        self.station_free = now + planning;
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
                    let cell = &mut self.robots[robot];
                    let mut leaves = now + planning + PLANNING_TIME;
                    if key.ends_with(SetpointPlan::TOPIC) {
                        leaves = leaves + cell.link_faults.planning_delay(now);
                        let session = self.station.session(&id);
                        if let Some(plan) = session.and_then(Session::last_plan) {
                            self.monitor.on_plan_made(robot, plan);
                        }
                    }
                    let key = key.as_bytes().to_vec();
                    cell.link_faults.record(Inject::Agent(robot), &key, &bytes);
                    for delay in cell.down.transmit(now, bytes.len()) {
                        let (key, bytes) = (key.clone(), bytes.to_vec());
                        let arrival = self.robots[robot].link_faults.held(now, leaves + delay);
                        self.schedule(arrival, Happening::ToAgent { robot, key, bytes });
                    }
                }
                // In virtual time planning takes as long as the scenario says.
                StationOutput::Overload { .. } => {}
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
        for (robot, cell) in self.robots.iter_mut().enumerate() {
            cell.body.advance(now);
            let session = self.station.session(&cell.id);
            if let Some(task) = session.map(|session| session.task())
                && self.station_process.is_running()
            {
                if let Some((trajectory, anchor)) = task.running() {
                    cell.mission = Some((trajectory.clone(), cell.world_time(anchor)));
                } else if task.is_done() {
                    cell.mission = None;
                }
            }
            let reference = cell.mission.as_ref().map(|(trajectory, begin)| {
                let begin = *begin;
                cell.mission_started.get_or_insert(begin);
                // Mission time runs in the robot's clock.
                let t = (cell.clock.shows(now) - cell.clock.shows(begin)).as_secs_f64();
                if let Some(program) = trajectory.program()
                    && let Some(step) = program.first_step()
                {
                    cell.roll_step.get_or_insert(RollStep {
                        at: begin + Span::from_secs_f64(step.at),
                        from: step.from,
                        to: step.to,
                        until: Some(begin + Span::from_secs_f64(step.until)),
                    });
                }
                setup::reference(trajectory, t)
            });
            let playback = cell.agent.playback();
            if playback.newest() != cell.newest_plan {
                cell.newest_plan = playback.newest();
                cell.loop_delays.extend(playback.loop_delay());
            }
            let signals = cell.agent.signals();
            let row = Row {
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
                life: cell.lives,
            };
            let around = Circumstances {
                agent_runs: cell.process.is_running(),
                reason: cell.agent.reason(),
                station_runs: self.station_process.is_running(),
                on_mission: session.is_some_and(|session| session.task().is_under_way()),
                packets: [&cell.up, &cell.down].map(|link| (link.sent, link.lost)),
            };
            self.monitor.on_row(robot, &row, &around);
            self.trace.push(row);
        }
    }

    /// What each robot's run amounts to, beside the trace.
    pub fn records(&self) -> Vec<RobotRecord> {
        self.robots
            .iter()
            .map(|cell| {
                let now = self.station.session(&cell.id).map(|s| *s.counters());
                let earlier = self.earlier_plans.get(&cell.id).copied();
                let counters = sum(now.unwrap_or_default(), earlier.unwrap_or_default());
                RobotRecord {
                    robot: cell.id,
                    mission_start: cell.mission_started,
                    roll_step: cell.roll_step,
                    plans_sent: counters.plans_sent,
                    plans_adopted: cell.earlier_adopted + cell.agent.playback().begun(),
                    loop_delays: cell.loop_delays.clone(),
                    bytes_up: cell.up.bytes,
                    bytes_down: cell.down.bytes,
                    solver: SolverCounts {
                        riccati: counters.riccati,
                        clarabel: counters.clarabel,
                        shifted: counters.shifted,
                        real_time: counters.real_time,
                        shed: counters.shed,
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
        let (boot_id, board_clock) = setup::drawn_clocks(scenario.seed, index);
        let body = Body::new(
            setup::body_setup(scenario, setup, board_clock),
            BodyRandom::new(scenario.seed, index),
        );
        let clock = SimClock::new(
            Span::from_secs_f64(setup.clock_offset_s),
            setup.clock_drift_ppm,
        );
        let config = setup::agent_config(setup, boot_id);
        let random = |purpose| stream(scenario.seed, index, purpose);
        let link = |model: &scenario::Link, packets, twins, weather| {
            let random = LinkRandom {
                packets: random(packets),
                twins: random(twins),
                weather: random(weather),
            };
            let cuts = &scenario.network.partition;
            Link::new(
                setup::link_model(model),
                setup::impairments(model, cuts, setup.id),
                random,
            )
        };
        let network = &scenario.network;
        Ok(Self {
            id: setup.id,
            body,
            agent: Agent::new(
                Instant::from_nanos(clock.shows(Span::ZERO).as_nanos()),
                config,
            )?,
            clock,
            process: Process::default(),
            lives: 0,
            earlier_adopted: 0,
            agent_due: Span::ZERO,
            link_faults: LinkFaults::new(scenario, &setup.id, random(Purpose::Replay)),
            up: link(
                &network.up,
                Purpose::LinkUp,
                Purpose::TwinsUp,
                Purpose::WeatherUp,
            ),
            down: link(
                &network.down,
                Purpose::LinkDown,
                Purpose::TwinsDown,
                Purpose::WeatherDown,
            ),
            fix_period: scenario.sensing.fix_period(),
            mission_started: None,
            mission: None,
            roll_step: None,
            newest_plan: None,
            loop_delays: Vec::new(),
        })
    }

    /// What its agent's clock shows.
    fn agent_now(&self, now: WorldTime) -> Instant<AgentClock> {
        Instant::from_nanos(self.clock.shows(now).as_nanos())
    }

    /// When its agent's clock shows `instant`.
    fn world_time(&self, instant: Instant<AgentClock>) -> WorldTime {
        self.clock.when(Span::from_nanos(instant.as_nanos()))
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

/// Plans of two stations, one after the other.
fn sum(a: Counters, b: Counters) -> Counters {
    Counters {
        plans_sent: a.plans_sent + b.plans_sent,
        riccati: a.riccati + b.riccati,
        clarabel: a.clarabel + b.clarabel,
        shifted: a.shifted + b.shifted,
        real_time: a.real_time + b.real_time,
        shed: a.shed + b.shed,
        typed: a.typed + b.typed,
        failed: a.failed + b.failed,
        stale: a.stale + b.stale,
        dropped: core::array::from_fn(|i| a.dropped[i] + b.dropped[i]),
    }
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
