//! A robot without dynamics behind a bad link: eq (1) with the reference lag, and the agent's side of plans, lease and echoes, written
//! anew from the message documentation. What a station's core can be tried on without agent and plant.

use std::collections::BTreeMap;

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use sphere_ground::station::{Event, Input, Order, Output, Station, StationConfig};
use sphere_ground::trajectory::ReferencePoint;
use sphere_protocol::key::Key;
use sphere_protocol::message::{
    Command, CommandOrder, Message, Mode, PlanId, SetpointPlan, Telemetry,
};
use sphere_protocol::robot::{Robot, RobotId};
use sphere_protocol::state::RobotState;
use sphere_protocol::time::{AgentClock, GroundClock, Instant, Span};
use sphere_protocol::wire::{self, Buffer, Wire};

/// The agent's control period [ns].
pub(crate) const PERIOD: i64 = 20_000_000;

/// One robot.
pub(crate) struct Rover {
    pub(crate) id: RobotId,
    pub(crate) robot: Robot,
    pub(crate) boot_id: u64,
    /// What its clock shows at world time 0 [ns].
    pub(crate) clock_offset: i64,
    /// Rate of its clock against the world's [1].
    pub(crate) clock_rate: f64,
    /// x, y [m], heading [rad], v_d [m/s], q_rd [rad].
    pub(crate) x: [f64; 5],
    /// Commands in force (v_c [m/s], q_c [rad]) and the slew of v_d [m/s²].
    pub(crate) u: [f64; 2],
    pub(crate) rate_max: f64,
    pub(crate) mode: Mode,
    pub(crate) epoch: u32,
    pub(crate) command: u32,
    pub(crate) playing: Option<PlanId>,
    pub(crate) loop_delay: Option<Span>,
    pub(crate) plans: Vec<SetpointPlan>,
    pub(crate) newest: Option<PlanId>,
    pub(crate) received: u32,
    /// Whether it refuses to be claimed.
    pub(crate) refuses: bool,
    /// Plans that came after their start.
    pub(crate) late: u32,
    /// Plans that came in time.
    pub(crate) in_time: u32,
}

impl Rover {
    pub(crate) fn new(id: &str) -> Self {
        Self {
            id: id.parse().expect("valid id"),
            robot: Robot::embedded("liu").expect("embedded"),
            boot_id: 77,
            clock_offset: 0,
            clock_rate: 1.0,
            x: [0.0; 5],
            u: [0.0; 2],
            rate_max: 0.0,
            mode: Mode::Ready,
            epoch: 0,
            command: 0,
            playing: None,
            loop_delay: None,
            plans: Vec::new(),
            newest: None,
            received: 0,
            refuses: false,
            late: 0,
            in_time: 0,
        }
    }

    pub(crate) fn now(&self, world: i64) -> Instant<AgentClock> {
        Instant::from_nanos(self.clock_offset + (world as f64 * self.clock_rate) as i64)
    }

    pub(crate) fn reboot(&mut self, boot_id: u64, clock_offset: i64) {
        let (id, robot, x) = (self.id, self.robot.clone(), self.x);
        *self = Self {
            robot,
            boot_id,
            clock_offset,
            // At rest when it comes up, where it was, its heading counted anew.
            x: [x[0], x[1], sphere_heading(x[2]), 0.0, 0.0],
            ..Self::new(id.as_str())
        };
    }

    pub(crate) fn telemetry(&self, world: i64) -> Telemetry {
        let [x, y, heading, v, q_r] = self.x;
        Telemetry {
            robot: self.id,
            boot_id: self.boot_id,
            stamp: self.now(world),
            mode: self.mode,
            state: RobotState {
                x,
                y,
                heading,
                v,
                q_r,
                ..RobotState::default()
            },
            v_d: v,
            q_rd: q_r,
            position_sigma: 0.01,
            playing: self.playing,
            newest: self.newest,
            received: self.received,
            loop_delay: self.loop_delay,
            epoch: self.epoch,
            command: self.command,
            torque: [0.0; 2],
        }
    }

    fn on_bytes(&mut self, world: i64, topic: &str, bytes: &[u8]) {
        if topic == Command::TOPIC {
            let command: Command = wire::decode(bytes).expect("the station writes valid commands");
            if command.boot_id == self.boot_id && command.number > self.command {
                self.command = command.number;
                match command.order {
                    CommandOrder::Claim if !self.refuses => self.epoch += 1,
                    CommandOrder::Arm if self.mode == Mode::Ready => self.mode = Mode::Idle,
                    CommandOrder::Disarm => self.mode = Mode::Ready,
                    _ => {}
                }
            }
            return;
        }
        let plan: SetpointPlan = wire::decode(bytes).expect("the station writes valid plans");
        let now = self.now(world);
        if plan.boot_id != self.boot_id
            || plan.id.epoch != self.epoch
            || self.newest.is_some_and(|newest| plan.id <= newest)
            || now >= plan.based_on + plan.valid_for
        {
            return;
        }
        let behind = match self.newest {
            Some(newest) if newest.epoch == plan.id.epoch => plan.id.seq - newest.seq,
            _ => 0,
        };
        self.received = match behind {
            0 => 0,
            1..32 => (self.received << behind) | (1 << (behind - 1)),
            _ => 0,
        };
        self.newest = Some(plan.id);
        self.loop_delay = Some(now.since(plan.based_on));
        if plan.start < now {
            self.late += 1;
        } else {
            self.in_time += 1;
        }
        self.plans.push(plan);
    }

    /// The end of one control period: what was commanded takes effect up to now, and the newest plan that has begun commands anew.
    fn control(&mut self, world: i64) {
        self.roll();
        let now = self.now(world);
        if !matches!(self.mode, Mode::Idle | Mode::Tracking | Mode::Holding) {
            (self.x[3], self.x[4]) = (0.0, 0.0);
            (self.u, self.rate_max) = ([0.0; 2], 0.0);
            return;
        }
        if let Some(i) = self.plans.iter().rposition(|plan| plan.start <= now) {
            self.plans.drain(..i);
        }
        let limits = self.robot.limits;
        let begun = self.plans.first().filter(|plan| plan.start <= now);
        let valid = begun.filter(|plan| {
            let knot = now.since(plan.start).as_nanos() / plan.period.as_nanos();
            knot < plan.u.len() as i64 && now < plan.based_on + plan.valid_for
        });
        let (mut u, mut rate_max) = ([0.0, 0.0], limits.brake);
        match valid {
            None => {
                self.playing = None;
                if self.mode == Mode::Tracking {
                    self.mode = Mode::Holding;
                }
            }
            Some(plan) => {
                self.mode = Mode::Tracking;
                self.playing = Some(plan.id);
                rate_max = limits.slew;
                let z = now.since(plan.start).as_secs_f64() / plan.period.as_secs_f64();
                let i = (z as usize).min(plan.u.len() - 1);
                u = plan.u[i].map(f64::from);
                if let Some(k) = plan.k.get(i) {
                    let f = z - i as f64;
                    for (j, command) in u.iter_mut().enumerate() {
                        for (s, x) in self.x.iter().enumerate() {
                            let (a, b) = (f64::from(plan.x[i][s]), f64::from(plan.x[i + 1][s]));
                            let mut e = x - (a + (b - a) * f);
                            if s == 2 {
                                e = sphere_heading(e);
                            }
                            *command += f64::from(k[5 * j + s]) * e;
                        }
                    }
                }
                let turn = limits.turn_limit(&self.robot.params);
                let q_max = limits
                    .q_r_max
                    .min((turn / (self.x[3] * self.x[3]).max(1e-9)).atan());
                u[0] = u[0].clamp(limits.v_min, limits.v_max);
                u[1] = u[1].clamp(-q_max, q_max);
            }
        }
        (self.u, self.rate_max) = (u, rate_max);
    }

    /// Eq (1) with the lag over one control period, mid-point rule at 1 ms.
    fn roll(&mut self) {
        let (u, rate_max) = (self.u, self.rate_max);
        let (h, tau, r) = (1e-3, self.robot.limits.reference_lag, self.robot.params.r);
        for _ in 0..PERIOD / 1_000_000 {
            let rates = |x: &[f64; 5]| {
                let v_rate = ((u[0] - x[3]) / tau).clamp(-rate_max, rate_max);
                let q_rate = (u[1] - x[4]) / tau;
                let (s, c) = x[2].sin_cos();
                [
                    x[3] * c - r * q_rate * s,
                    x[3] * s + r * q_rate * c,
                    x[3] * x[4].tan() / r,
                    v_rate,
                    q_rate,
                ]
            };
            let first = rates(&self.x);
            let middle: [f64; 5] = std::array::from_fn(|s| self.x[s] + 0.5 * h * first[s]);
            let second = rates(&middle);
            for (x, rate) in self.x.iter_mut().zip(second) {
                *x += h * rate;
            }
        }
    }
}

/// How bad the link is, each way.
#[derive(Clone, Copy)]
pub(crate) struct Way {
    /// Mean one-way delay [s].
    pub(crate) delay: f64,
    /// Uniform within this share of the delay [1].
    pub(crate) jitter: f64,
    /// Probability of loss [1].
    pub(crate) loss: f64,
}

enum Packet {
    Up {
        key: String,
        bytes: Vec<u8>,
    },
    Down {
        robot: RobotId,
        topic: String,
        bytes: Vec<u8>,
    },
}

/// Robots, station and link in virtual time.
pub(crate) struct World {
    /// World time [ns].
    pub(crate) now: i64,
    /// What the station's clock shows at world time 0 [ns].
    pub(crate) ground_offset: i64,
    pub(crate) rovers: Vec<Rover>,
    pub(crate) station: Station,
    pub(crate) up: Way,
    pub(crate) down: Way,
    /// World times [ns] between which nothing passes.
    pub(crate) blackout: (i64, i64),
    pub(crate) events: Vec<(f64, RobotId, Event)>,
    /// Plans as sent.
    pub(crate) plans: Vec<SetpointPlan>,
    /// Commands as sent, with the time [s].
    pub(crate) commands: Vec<(f64, Command)>,
    next_control: i64,
    packets: BTreeMap<(i64, u64), Packet>,
    count: u64,
    random: ChaCha8Rng,
}

impl World {
    pub(crate) fn new(config: StationConfig, rovers: Vec<Rover>, way: Way, seed: u64) -> Self {
        let ground_offset = 5_000_000_000;
        Self {
            now: 0,
            ground_offset,
            rovers,
            station: Station::new(config, Instant::from_nanos(ground_offset)),
            up: way,
            down: way,
            blackout: (0, 0),
            events: Vec::new(),
            plans: Vec::new(),
            commands: Vec::new(),
            next_control: PERIOD,
            packets: BTreeMap::new(),
            count: 0,
            random: ChaCha8Rng::seed_from_u64(seed),
        }
    }

    pub(crate) fn ground_now(&self) -> Instant<GroundClock> {
        Instant::from_nanos(self.now + self.ground_offset)
    }

    pub(crate) fn order(&mut self, robot: RobotId, order: Order) {
        let now = self.ground_now();
        self.station
            .handle_input(now, Input::Order { robot, order });
        self.drain();
    }

    pub(crate) fn message(&mut self, key: &str, bytes: &[u8]) {
        let now = self.ground_now();
        self.station
            .handle_input(now, Input::Message { key, bytes });
        self.drain();
    }

    /// Runs until `until` [s]; `watch` sees the world after each control period.
    pub(crate) fn run(&mut self, until: f64, mut watch: impl FnMut(&mut World)) {
        let until = (until * 1e9).round() as i64;
        while self.now < until {
            let tick = self.next_control;
            let packet = self
                .packets
                .first_key_value()
                .map_or(i64::MAX, |(key, _)| key.0);
            let timeout = self.station.poll_timeout().as_nanos() - self.ground_offset;
            self.now = tick.min(packet).min(timeout.max(self.now));
            if tick == self.now {
                self.next_control += PERIOD;
                for i in 0..self.rovers.len() {
                    let world = self.now;
                    self.rovers[i].control(world);
                    let telemetry = self.rovers[i].telemetry(world);
                    self.send_up(&telemetry, telemetry.robot);
                }
                watch(self);
            } else if packet == self.now {
                let (_, packet) = self.packets.pop_first().expect("just seen");
                self.deliver(packet);
            } else {
                let now = self.ground_now();
                self.station.handle_input(now, Input::Timeout);
                self.drain();
            }
        }
    }

    /// The reference of rover `i` now, once its mission has begun, and the mission time [s].
    pub(crate) fn reference(&self, i: usize) -> Option<(f64, ReferencePoint)> {
        let rover = &self.rovers[i];
        let session = self.station.session(&rover.id)?;
        let (boot_id, anchor) = self.station.mission_anchor(&rover.id)?;
        (boot_id == rover.boot_id).then_some(())?;
        let now = rover.now(self.now);
        Some((
            now.since(anchor).as_secs_f64(),
            session.task().reference(now)?,
        ))
    }

    fn send_up<M: Wire>(&mut self, message: &M, robot: RobotId) {
        let mut buffer = Buffer::new();
        wire::encode(message, &mut buffer).expect("valid");
        let key = Key::of::<M>(&robot).text().to_string();
        let bytes = buffer.to_vec();
        self.transmit(self.up, Packet::Up { key, bytes });
    }

    fn transmit(&mut self, way: Way, packet: Packet) {
        // Both numbers are always drawn, so that a lost packet does not change the fate of the next ones.
        let lost = self.random.random::<f64>() < way.loss;
        let spread = 1.0 + way.jitter * (2.0 * self.random.random::<f64>() - 1.0);
        let dark = self.blackout.0 <= self.now && self.now < self.blackout.1;
        if !lost && !dark {
            let at = self.now + (way.delay * spread * 1e9) as i64;
            self.count += 1;
            self.packets.insert((at, self.count), packet);
        }
    }

    fn deliver(&mut self, packet: Packet) {
        match packet {
            Packet::Up { key, bytes } => self.message(&key, &bytes),
            Packet::Down {
                robot,
                topic,
                bytes,
            } => {
                let world = self.now;
                if let Some(rover) = self.rovers.iter_mut().find(|rover| rover.id == robot) {
                    rover.on_bytes(world, &topic, &bytes);
                }
            }
        }
    }

    fn drain(&mut self) {
        let now = self.now as f64 * 1e-9;
        while let Some(output) = self.station.poll_output() {
            match output {
                Output::Overload { .. } => {}
                Output::Event { robot, event } => self.events.push((now, robot, event)),
                Output::Publish {
                    robot, key, bytes, ..
                } => {
                    let topic = Key::parse(&key).expect("valid key").topic().to_owned();
                    if topic == SetpointPlan::TOPIC {
                        self.plans.push(wire::decode(&bytes).expect("valid plan"));
                    } else {
                        self.commands
                            .push((now, wire::decode(&bytes).expect("valid command")));
                    }
                    self.transmit(
                        self.down,
                        Packet::Down {
                            robot,
                            topic,
                            bytes,
                        },
                    );
                }
            }
        }
    }
}

fn sphere_heading(angle: f64) -> f64 {
    angle - std::f64::consts::TAU * (angle / std::f64::consts::TAU).round()
}
