//! The ground station's core: a state machine without clock, sockets or threads.
//!
//! ```text
//!   messages, orders ──► handle_input(now, …) ──► sessions, one a robot ──► poll_output() ──► publish, events
//!                        poll_timeout() says when handle_input(now, Timeout) is due
//! ```
//!
//! Every robot is planned for at 10 Hz, in a phase of its own so that a fleet's plans do not leave in one burst. A robot it is not
//! configured for is none of its business.

use std::collections::{BTreeMap, BTreeSet, VecDeque};

use arrayvec::ArrayVec;
use sphere_protocol::key::{Key, KeyText};
use sphere_protocol::message::{
    Command, CommandOrder, Direction, DropReason, Message, Mode, Qos, SetpointPlan, Status,
    Telemetry,
};
use sphere_protocol::robot::{Robot, RobotId};
use sphere_protocol::time::{AgentClock, GroundClock, Instant, Span};
use sphere_protocol::wire::{self, Buffer, Wire, WireError};

use crate::session::{Request, Session};
use crate::settings::PlannerSettings;
use crate::tasking::StartCondition;
use crate::trajectory::{Mission, MissionError};

/// What a station knows from the start.
#[derive(Clone, Debug)]
pub struct StationConfig {
    /// Identity of this station, not 0. Two stations of a fleet must differ.
    pub station: u64,
    /// How plans are made.
    pub planner: PlannerSettings,
    /// The robots; of two with the same id the later one counts.
    pub robots: Vec<RobotConfig>,
}

/// One robot of a station.
#[derive(Clone, Debug)]
pub struct RobotConfig {
    /// Its name.
    pub id: RobotId,
    /// What it is believed to be.
    pub robot: Robot,
    /// What it is to do.
    pub mission: Mission,
    /// When it begins.
    pub start: StartCondition,
}

/// What happens to a station.
#[derive(Clone, Debug, PartialEq)]
pub enum Input<'a> {
    /// Bytes arrived under a key.
    Message {
        /// The key.
        key: &'a str,
        /// The bytes.
        bytes: &'a [u8],
    },
    /// The time of [`Station::poll_timeout`] has come.
    Timeout,
    /// An operator orders. Unknown robots are ignored.
    Order {
        /// For whom.
        robot: RobotId,
        /// What.
        order: Order,
    },
}

/// What an operator can order.
#[derive(Clone, Debug, PartialEq)]
pub enum Order {
    /// Sends this command, repeated until it is acknowledged. After [`CommandOrder::Disarm`] the station does not arm again by itself.
    Command(CommandOrder),
    /// Begins a mission that waits for an order.
    Start,
    /// Another mission instead of the present one.
    Assign {
        /// What to do.
        mission: Mission,
        /// When to begin.
        start: StartCondition,
    },
}

/// What a station wants done.
#[derive(Clone, Debug, PartialEq)]
pub enum Output {
    /// Publish these bytes.
    Publish {
        /// For whom.
        robot: RobotId,
        /// Where.
        key: KeyText,
        /// How.
        qos: Qos,
        /// The message.
        bytes: Vec<u8>,
    },
    /// Something worth telling.
    Event {
        /// Of which robot.
        robot: RobotId,
        /// What.
        event: Event,
    },
}

/// Something worth telling.
#[derive(Clone, Debug, PartialEq)]
pub enum Event {
    /// First telemetry of a robot.
    Found {
        /// Its life.
        boot_id: u64,
    },
    /// The agent was started anew: its plans are forgotten, lease and arming begin again.
    Rebooted {
        /// Its new life.
        boot_id: u64,
    },
    /// Another mode.
    Mode {
        /// Before; `None` at first.
        from: Option<Mode>,
        /// Now.
        to: Mode,
    },
    /// The robot takes plans from this station.
    LeaseGranted {
        /// The lease.
        epoch: u32,
    },
    /// It takes them from somebody else now, or from nobody.
    LeaseLost {
        /// The other station, if the robot said.
        station: Option<u64>,
    },
    /// The robot refused a command; it will be tried again.
    Refused(CommandOrder),
    /// The first plan of the mission.
    MissionStarted,
    /// The mission is over: no more plans.
    MissionDone,
    /// The robot cannot drive this mission.
    MissionRefused(MissionError),
    /// Telemetry is too old to plan from.
    Stale,
    /// It sends messages of another schema version, which are dropped; told once for each topic and version.
    Incompatible(WireError),
    /// It drops our messages for their schema version; told once in each of its lives.
    RefusedByRobot {
        /// How many it had dropped by then.
        count: u32,
    },
}

/// The station.
pub struct Station {
    station: u64,
    sessions: BTreeMap<RobotId, Slot>,
    /// `Slot::due` of every robot.
    due: BTreeSet<(Instant<GroundClock>, RobotId)>,
    outputs: VecDeque<Output>,
    requests: Vec<Request>,
    buffer: Box<Buffer>,
    dropped: [u32; DropReason::COUNT],
}

struct Slot {
    session: Session,
    next_tick: Instant<GroundClock>,
    due: Instant<GroundClock>,
}

impl Station {
    /// A station that is started at `now`.
    pub fn new(config: StationConfig, now: Instant<GroundClock>) -> Self {
        let robots: BTreeMap<_, _> = config
            .robots
            .iter()
            .map(|robot| (robot.id, robot))
            .collect();
        let count = robots.len().max(1) as i64;
        let sessions: BTreeMap<_, _> = robots
            .into_iter()
            .enumerate()
            .map(|(i, (id, robot))| {
                let phase = Span::from_nanos(TICK.as_nanos() * i as i64 / count);
                let slot = Slot {
                    session: Session::new(robot, &config.planner, config.station),
                    next_tick: now + phase,
                    due: now + phase,
                };
                (id, slot)
            })
            .collect();
        Self {
            station: config.station,
            due: sessions.iter().map(|(id, slot)| (slot.due, *id)).collect(),
            sessions,
            outputs: VecDeque::new(),
            requests: Vec::new(),
            buffer: Box::new(ArrayVec::new()),
            dropped: [0; DropReason::COUNT],
        }
    }

    /// Takes note of `input`, and does what is due. Call [`Station::poll_output`] until it is empty afterwards.
    pub fn handle_input(&mut self, now: Instant<GroundClock>, input: Input<'_>) {
        match input {
            Input::Message { key, bytes } => self.on_message(now, key, bytes),
            Input::Timeout => {}
            Input::Order { robot, order } => {
                if let Some(slot) = self.sessions.get_mut(&robot) {
                    match order {
                        Order::Command(command) => slot.session.order(command),
                        Order::Start => slot.session.start(),
                        Order::Assign { mission, start } => slot.session.assign(mission, start),
                    }
                    self.serve(now, robot);
                }
            }
        }
        while let Some((due, robot)) = self.due.first().copied()
            && due <= now
        {
            self.serve(now, robot);
        }
    }

    /// What to do next, until `None`.
    pub fn poll_output(&mut self) -> Option<Output> {
        self.outputs.pop_front()
    }

    /// When [`Input::Timeout`] is due. Without robots: never.
    pub fn poll_timeout(&self) -> Instant<GroundClock> {
        self.due
            .first()
            .map_or(Instant::from_nanos(i64::MAX), |(due, _)| *due)
    }

    /// What is known of one robot.
    pub fn session(&self, robot: &RobotId) -> Option<&Session> {
        Some(&self.sessions.get(robot)?.session)
    }

    /// What is known of every robot, by name.
    pub fn sessions(&self) -> impl Iterator<Item = (&RobotId, &Session)> {
        self.sessions.iter().map(|(id, slot)| (id, &slot.session))
    }

    /// When the robot's present mission began, by the station's clock: an estimate that gets better with every echo.
    pub fn mission_started(&self, robot: &RobotId) -> Option<Instant<GroundClock>> {
        let session = self.session(robot)?;
        session.task().began(session.link())
    }

    /// Exactly when the robot's mission time is 0, in its own clock and life: what its reference is counted from.
    pub fn mission_anchor(&self, robot: &RobotId) -> Option<(u64, Instant<AgentClock>)> {
        let session = self.session(robot)?;
        let (_, anchor) = session.task().running()?;
        Some((session.telemetry()?.boot_id, anchor))
    }

    /// Messages dropped that could not be laid to a configured robot, by [`DropReason`].
    pub fn dropped(&self) -> &[u32; DropReason::COUNT] {
        &self.dropped
    }

    fn on_message(&mut self, now: Instant<GroundClock>, key: &str, bytes: &[u8]) {
        let Ok(key) = Key::parse(key) else {
            return self.count_drop(DropReason::Malformed);
        };
        let robot = key.robot();
        let Some(slot) = self.sessions.get_mut(&robot) else {
            return self.count_drop(DropReason::WrongRobot);
        };
        let session = &mut slot.session;
        match (key.direction(), key.topic()) {
            (Direction::Up, Telemetry::TOPIC) => match wire::decode::<Telemetry>(bytes) {
                Ok(telemetry) => session.on_telemetry(now, telemetry, &mut self.requests),
                Err(error) => session.on_unreadable(error, &mut self.requests),
            },
            (Direction::Up, Status::TOPIC) => match wire::decode::<Status>(bytes) {
                Ok(status) => session.on_status(&status, &mut self.requests),
                Err(error) => session.on_unreadable(error, &mut self.requests),
            },
            _ => session.count_drop(DropReason::Unexpected),
        }
        self.serve(now, robot);
    }

    /// Does what is due for one robot, commands before plans, and notes when it is to be served next.
    fn serve(&mut self, now: Instant<GroundClock>, robot: RobotId) {
        let Some(slot) = self.sessions.get_mut(&robot) else {
            return;
        };
        slot.session.poll_commands(now, &mut self.requests);
        if slot.next_tick <= now {
            // After a pause ticks that were missed are not made up for, and the phase stays.
            let missed = now.since(slot.next_tick).as_nanos() / TICK.as_nanos();
            slot.next_tick += Span::from_nanos(TICK.as_nanos().saturating_mul(missed + 1));
            slot.session.tick(now, &mut self.requests);
        }
        let next = match slot.session.command_timeout() {
            // What was sent just now is due again later: strictly later than now, or serving would never end.
            Some(command) => command.max(now + Span::from_millis(1)).min(slot.next_tick),
            None => slot.next_tick,
        };
        self.due.remove(&(slot.due, robot));
        slot.due = next;
        self.due.insert((next, robot));
        self.send_requests(robot);
    }

    fn send_requests(&mut self, robot: RobotId) {
        let requests = core::mem::take(&mut self.requests);
        for request in &requests {
            match request {
                Request::Event(event) => self.outputs.push_back(Output::Event {
                    robot,
                    event: event.clone(),
                }),
                Request::Plan(plan) => self.publish::<SetpointPlan>(robot, plan),
                Request::Command {
                    boot_id,
                    number,
                    order,
                } => self.publish(
                    robot,
                    &Command {
                        robot,
                        boot_id: *boot_id,
                        number: *number,
                        station: self.station,
                        order: *order,
                    },
                ),
            }
        }
        self.requests = requests;
        self.requests.clear();
    }

    fn publish<M: Wire>(&mut self, robot: RobotId, message: &M) {
        // Only finite values within limits get here; what could not be written is not sent, and counted as dropped.
        match wire::encode(message, &mut self.buffer) {
            Ok(()) => self.outputs.push_back(Output::Publish {
                robot,
                key: Key::of::<M>(&robot).text(),
                qos: M::QOS,
                bytes: self.buffer.to_vec(),
            }),
            Err(_) => self.count_drop(DropReason::OutOfRange),
        }
    }

    fn count_drop(&mut self, reason: DropReason) {
        let count = &mut self.dropped[reason as usize];
        *count = count.saturating_add(1);
    }
}

/// Planning period of each robot.
const TICK: Span = Span::from_millis(100);
