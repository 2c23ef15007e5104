//! The ground station's core: a state machine without clock, sockets or threads.
//!
//! ```text
//!   messages, orders ──► handle_input(now, …) ──► sessions, one a robot ──► poll_output() ──► publish, events
//!                        poll_timeout() says when handle_input(now, Timeout) is due
//! ```
//!
//! Every robot is planned for at 10 Hz, in one of fifty phases so that a fleet's plans do not leave in one burst; those that are due
//! together are planned together, on [`Workers`] ([`crate::workload`]). A robot it is not configured for is none of its business.

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

use crate::session::{Job, Request, Session};
use crate::settings::PlannerSettings;
use crate::tasking::StartCondition;
use crate::trajectory::{Mission, MissionError};
use crate::workload::{Governor, Inline, Load, Need, Workers};

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
    /// The time of [`Station::poll_timeout`] has come: commands and plans that are due.
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
    /// Planning takes more time than there is, and some plans are cut short or left out; or that is over.
    Overload {
        /// Whether it has begun or is over.
        is_over: bool,
        /// The batch that showed it.
        load: Load,
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
    /// By name.
    slots: Vec<Slot>,
    places: BTreeMap<RobotId, usize>,
    /// `Slot::due` of every robot, with its place.
    due: BTreeSet<(Instant<GroundClock>, usize)>,
    workers: Box<dyn Workers>,
    governor: Governor,
    /// When a plan was last cut short or left out, while the station is over its time.
    overload: Option<Instant<GroundClock>>,
    planning_time: Span,
    outbox: Outbox,
}

struct Slot {
    id: RobotId,
    session: Session,
    next_tick: Instant<GroundClock>,
    due: Instant<GroundClock>,
}

/// What is to be sent and told.
struct Outbox {
    station: u64,
    outputs: VecDeque<Output>,
    /// What a session has just asked for; empty between two steps.
    requests: Vec<Request>,
    buffer: Box<Buffer>,
    dropped: [u32; DropReason::COUNT],
}

impl Station {
    /// A station that is started at `now` and plans on its caller's thread.
    pub fn new(config: StationConfig, now: Instant<GroundClock>) -> Self {
        Self::with_workers(config, now, Box::new(Inline::default()))
    }

    /// A station that is started at `now` and plans on `workers`.
    pub fn with_workers(
        config: StationConfig,
        now: Instant<GroundClock>,
        workers: Box<dyn Workers>,
    ) -> Self {
        let robots: BTreeMap<_, _> = config
            .robots
            .iter()
            .map(|robot| (robot.id, robot))
            .collect();
        let count = robots.len() as i64;
        // Each robot in a phase of its own as long as there are few; of many, some together, to be planned at once.
        let phases = count.clamp(1, PHASES_MAX);
        let slots: Vec<Slot> = robots
            .into_iter()
            .enumerate()
            .map(|(i, (id, robot))| {
                let phase = i as i64 * phases / count;
                let due = now + Span::from_nanos(TICK.as_nanos() * phase / phases);
                Slot {
                    id,
                    session: Session::new(robot, &config.planner, config.station),
                    next_tick: due,
                    due,
                }
            })
            .collect();
        let numbered = || slots.iter().enumerate();
        Self {
            places: numbered().map(|(place, slot)| (slot.id, place)).collect(),
            due: numbered().map(|(place, slot)| (slot.due, place)).collect(),
            slots,
            workers,
            governor: Governor::default(),
            overload: None,
            planning_time: Span::ZERO,
            outbox: Outbox {
                station: config.station,
                outputs: VecDeque::new(),
                requests: Vec::new(),
                buffer: Box::new(ArrayVec::new()),
                dropped: [0; DropReason::COUNT],
            },
        }
    }

    /// Takes note of `input`; what takes time, [`Input::Timeout`] alone does. Give it every message that waits before that, so that plans
    /// are made from what is known. Call [`Station::poll_output`] until it is empty afterwards.
    pub fn handle_input(&mut self, now: Instant<GroundClock>, input: Input<'_>) {
        match input {
            Input::Message { key, bytes } => self.on_message(now, key, bytes),
            Input::Timeout => self.serve_due(now),
            Input::Order { robot, order } => {
                if let Some(&place) = self.places.get(&robot) {
                    let session = &mut self.slots[place].session;
                    match order {
                        Order::Command(command) => session.order(command),
                        Order::Start => session.start(),
                        Order::Assign { mission, start } => session.assign(mission, start),
                    }
                    self.attend(now, place);
                }
            }
        }
    }

    /// What to do next, until `None`.
    pub fn poll_output(&mut self) -> Option<Output> {
        self.outbox.outputs.pop_front()
    }

    /// When [`Input::Timeout`] is due. Without robots: never.
    pub fn poll_timeout(&self) -> Instant<GroundClock> {
        self.due
            .first()
            .map_or(Instant::from_nanos(i64::MAX), |(due, _)| *due)
    }

    /// What is known of one robot.
    pub fn session(&self, robot: &RobotId) -> Option<&Session> {
        Some(&self.slots[*self.places.get(robot)?].session)
    }

    /// What is known of every robot, by name.
    pub fn sessions(&self) -> impl Iterator<Item = (&RobotId, &Session)> {
        self.slots.iter().map(|slot| (&slot.id, &slot.session))
    }

    /// How long planning has taken since this was last asked, by its workers' word. A shell whose clock goes on by itself need not ask.
    pub fn take_planning_time(&mut self) -> Span {
        core::mem::replace(&mut self.planning_time, Span::ZERO)
    }

    /// How it keeps up with planning.
    pub fn load(&self) -> &Load {
        self.governor.load()
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
        &self.outbox.dropped
    }

    fn on_message(&mut self, now: Instant<GroundClock>, key: &str, bytes: &[u8]) {
        let Ok(key) = Key::parse(key) else {
            return self.outbox.count_drop(DropReason::Malformed);
        };
        let Some(&place) = self.places.get(&key.robot()) else {
            return self.outbox.count_drop(DropReason::WrongRobot);
        };
        let (session, requests) = (&mut self.slots[place].session, &mut self.outbox.requests);
        match (key.direction(), key.topic()) {
            (Direction::Up, Telemetry::TOPIC) => match wire::decode::<Telemetry>(bytes) {
                Ok(telemetry) => session.on_telemetry(now, telemetry, requests),
                Err(error) => session.on_unreadable(error, requests),
            },
            (Direction::Up, Status::TOPIC) => match wire::decode::<Status>(bytes) {
                Ok(status) => session.on_status(&status, requests),
                Err(error) => session.on_unreadable(error, requests),
            },
            _ => session.count_drop(DropReason::Unexpected),
        }
        self.attend(now, place);
    }

    /// Sends the commands that are due to one robot, and notes when it is to be served next.
    fn attend(&mut self, now: Instant<GroundClock>, place: usize) {
        let slot = &mut self.slots[place];
        slot.session.poll_commands(now, &mut self.outbox.requests);
        self.outbox.send(slot.id);
        let next = match slot.session.command_timeout() {
            // What was sent just now is due again later: strictly later than now, or serving would never end.
            Some(command) => command.max(now + Span::from_millis(1)).min(slot.next_tick),
            None => slot.next_tick,
        };
        self.due.remove(&(slot.due, place));
        slot.due = next;
        self.due.insert((next, place));
    }

    /// Does all that is due, commands before plans.
    fn serve_due(&mut self, now: Instant<GroundClock>) {
        let mut to_plan = Vec::new();
        let mut late = Span::ZERO;
        while let Some((due, place)) = self.due.first().copied()
            && due <= now
        {
            let slot = &mut self.slots[place];
            let is_tick = slot.next_tick <= now;
            if is_tick {
                late = late.max(now.since(slot.next_tick));
                // After a pause ticks that were missed are not made up for, and the phase stays.
                let missed = now.since(slot.next_tick).as_nanos() / TICK.as_nanos();
                slot.next_tick += Span::from_nanos(TICK.as_nanos().saturating_mul(missed + 1));
                to_plan.push(place);
            }
            self.attend(now, place);
        }
        if !to_plan.is_empty() {
            self.plan(now, late, &mut to_plan);
        }
    }

    /// Plans for the robots at `places` at once, `late` after the first of them was due.
    fn plan(&mut self, now: Instant<GroundClock>, late: Span, places: &mut [usize]) {
        places.sort_unstable();
        let outbox = &mut self.outbox;
        let mut planned = Vec::with_capacity(places.len());
        {
            let mut jobs = Vec::with_capacity(places.len());
            let mut prepared = Vec::with_capacity(places.len());
            for (place, slot) in select(&mut self.slots, places) {
                let job = slot.session.prepare(now, &mut outbox.requests);
                outbox.send(slot.id);
                if let Some(job) = job {
                    jobs.push(job);
                    prepared.push(place);
                }
            }
            let needs: Vec<Need> = jobs.iter().map(Job::need).collect();
            for (job, effort) in jobs.iter_mut().zip(self.governor.share_out(late, &needs)) {
                job.set_effort(effort);
            }
            let took = self.workers.run(&mut jobs);
            self.governor.learn(took);
            self.planning_time = self.planning_time + took;
            for (place, job) in prepared.into_iter().zip(jobs) {
                planned.push((place, job.into_planned()));
            }
        }
        for (place, planned) in planned {
            let slot = &mut self.slots[place];
            slot.session.conclude(now, planned, &mut outbox.requests);
            outbox.send(slot.id);
        }
        self.tell_overload(now);
    }

    /// Once when it begins, once when it has been over for a second.
    fn tell_overload(&mut self, now: Instant<GroundClock>) {
        let load = *self.governor.load();
        let before = self.overload;
        match before {
            _ if load.has_cuts() => self.overload = Some(now),
            Some(last) if now.since(last) > OVERLOAD_OVER => self.overload = None,
            _ => {}
        }
        if before.is_some() != self.overload.is_some() {
            let is_over = self.overload.is_none();
            self.outbox
                .outputs
                .push_back(Output::Overload { is_over, load });
        }
    }
}

/// The items of `slots` at `places`, which ascend.
fn select<'a>(
    slots: &'a mut [Slot],
    places: &[usize],
) -> impl Iterator<Item = (usize, &'a mut Slot)> {
    let (mut rest, mut passed) = (slots, 0);
    places.iter().map(move |&place| {
        let (slot, after) = core::mem::take(&mut rest)[place - passed..]
            .split_first_mut()
            .expect("a place of a slot");
        (rest, passed) = (after, place + 1);
        (place, slot)
    })
}

impl Outbox {
    /// Puts into the outputs what the session of `robot` has asked for.
    fn send(&mut self, robot: RobotId) {
        let mut requests = core::mem::take(&mut self.requests);
        for request in requests.drain(..) {
            match request {
                Request::Event(event) => self.outputs.push_back(Output::Event { robot, event }),
                Request::Plan(plan) => self.publish::<SetpointPlan>(robot, &plan),
                Request::Command {
                    boot_id,
                    number,
                    order,
                } => self.publish(
                    robot,
                    &Command {
                        robot,
                        boot_id,
                        number,
                        station: self.station,
                        order,
                    },
                ),
            }
        }
        self.requests = requests;
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
/// Time without a plan cut short after which an overload is over.
const OVERLOAD_OVER: Span = Span::from_millis(1000);
/// Most phases into which a tick is divided: 2 ms apart, so that few plans leave at once and enough are due together to be planned at once.
const PHASES_MAX: i64 = 50;
