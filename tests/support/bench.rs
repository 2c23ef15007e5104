//! One robot on a bench: its simulated body and its agent, joined by the motor link's bytes alone, without a station.

#![allow(
    dead_code,
    unreachable_pub,
    reason = "each test binary uses its own part"
)]

use sphere_agent::agent::{Agent, Event, Input, Output};
use sphere_agent::config::{AgentConfig, Timing};
use sphere_agent::control::DirectionChoice;
use sphere_agent::estimator::EstimatorConfig;
use sphere_agent::mode::Reason;
use sphere_agent::plan::{advance_reference, reference_state};
use sphere_protocol::key::Key;
use sphere_protocol::mavlink::sphere::{SPHERE_SENSORS_DATA, SphereBoardStatus};
use sphere_protocol::mavlink::{
    AGENT, BOARD, Event as BoardEvent, FrameReader, FrameWriter, Framing, MavMessage, TorqueCommand,
};
use sphere_protocol::message::{
    Command, CommandOrder, DropReason, Message, Mode, PlanId, PlanSource, SetpointPlan, Status,
    Telemetry,
};
use sphere_protocol::robot::{Robot, RobotId};
use sphere_protocol::state::Torque;
use sphere_protocol::time::{AgentClock, Instant, Span};
use sphere_protocol::wire::{self, Buffer, Wire};
use sphere_sim::body::{Body, BodyRandom, BodySetup};
use sphere_sim::disturbance::Disturbance;
use sphere_sim::sensor::Sensors;

/// Identity of the station whose part the test plays.
pub const STATION: u64 = 7;
/// What the agent's clock shows when the bench is switched on.
const CLOCK: Span = Span::from_millis(500_000);
const BOOT_ID: u64 = 0x5eed;
const FIX_PERIOD_MS: i64 = 100;

/// What becomes of a sensor frame on its way.
pub type Alter = Box<dyn FnMut(f64, &mut SPHERE_SENSORS_DATA) -> Pass>;

/// Whether a frame gets through.
#[derive(Clone, Copy, PartialEq, Eq)]
pub enum Pass {
    Yes,
    No,
}

pub struct Bench {
    pub agent: Agent,
    pub body: Body,
    pub robot: Robot,
    /// Alters sensor frames; gets the time since the bench was switched on [s].
    pub alter: Alter,
    pub fixes: bool,
    /// What the agent reported, and when [s].
    pub events: Vec<(f64, Event)>,
    /// Torque commands sent, and when [s].
    pub torques: Vec<(f64, TorqueCommand)>,
    pub telemetry: Option<Telemetry>,
    pub status: Option<Status>,
    pub beacons: u64,
    /// Everything handed to the agent.
    pub inputs: Vec<(Instant<AgentClock>, Recorded)>,
    elapsed: Span,
    number: u32,
    seq: u32,
    to_agent: FrameWriter,
}

/// An input with its own bytes.
pub enum Recorded {
    Motor(Vec<u8>),
    Message(String, Vec<u8>),
    Timeout,
}

impl Bench {
    pub fn new() -> Self {
        Self::with(EstimatorConfig::default())
    }

    pub fn with(estimator: EstimatorConfig) -> Self {
        let robot = Robot::embedded("liu").expect("it comes with the project");
        let body = Body::new(
            BodySetup {
                params: robot.params,
                start: [0.0; 3],
                disturbance: Disturbance::default(),
                noise: 1.0,
                fix_sigma: 0.02,
                clock: sphere_sim::clock::SimClock::new(Span::from_millis(30_000), 0.0),
            },
            BodyRandom::new(1, 0),
        );
        Self {
            agent: Self::agent(estimator),
            body,
            robot,
            alter: Box::new(|_, _| Pass::Yes),
            fixes: true,
            events: Vec::new(),
            torques: Vec::new(),
            telemetry: None,
            status: None,
            beacons: 0,
            inputs: Vec::new(),
            elapsed: Span::ZERO,
            number: 0,
            seq: 0,
            to_agent: FrameWriter::new(BOARD),
        }
    }

    /// The agent as every bench starts it.
    pub fn agent(estimator: EstimatorConfig) -> Agent {
        let config = AgentConfig {
            id: id(),
            robot: Robot::embedded("liu").expect("it comes with the project"),
            boot_id: BOOT_ID,
            estimator,
            direction: DirectionChoice::Htsmc,
            timing: Timing::default(),
        };
        Agent::new(Instant::from_nanos(0) + CLOCK, config).expect("the gains are stable")
    }

    /// Settled, leased and armed.
    pub fn armed() -> Self {
        let mut bench = Self::new();
        bench.run(2.0);
        assert_eq!(bench.mode(), Mode::Ready, "after 2 s at rest");
        bench.command(CommandOrder::Claim);
        bench.command(CommandOrder::Arm);
        bench.run(0.1);
        assert_eq!(bench.mode(), Mode::Idle);
        bench
    }

    /// Tracking at `v` [m/s] for `s` seconds, by a new plan every 100 ms.
    pub fn tracking(v: f64, s: f64) -> Self {
        let mut bench = Self::armed();
        bench.track(v, s);
        assert_eq!(bench.mode(), Mode::Tracking);
        bench
    }

    pub fn track(&mut self, v: f64, s: f64) {
        for _ in 0..(10.0 * s).round() as usize {
            let plan = self.plan(v);
            self.send_plan(&plan);
            self.run(0.1);
        }
    }

    pub fn run(&mut self, s: f64) {
        for _ in 0..(1e3 * s).round() as i64 {
            self.millisecond();
        }
    }

    /// Lets the world go on while the agent sleeps; frames arrive, late, when it wakes up.
    pub fn sleep(&mut self, s: f64) {
        let mut buffered = Vec::new();
        for _ in 0..(1e3 * s).round() as i64 {
            self.elapsed = self.elapsed + Span::from_millis(1);
            self.body.advance(self.elapsed);
            if self.elapsed.as_nanos() % Sensors::INTERVAL.as_nanos() == 0 {
                buffered.extend(self.sensor_frame());
            }
        }
        for frame in buffered {
            self.motor(&frame);
        }
    }

    fn millisecond(&mut self) {
        self.elapsed = self.elapsed + Span::from_millis(1);
        self.body.advance(self.elapsed);
        if self.elapsed.as_nanos() % Sensors::INTERVAL.as_nanos() == 0
            && let Some(frame) = self.sensor_frame()
        {
            self.motor(&frame);
        }
        if self.fixes && self.elapsed.as_nanos() % (FIX_PERIOD_MS * 1_000_000) == 0 {
            self.body.take_fix();
        }
        while let Some(fix) = self.body.arrived_fix() {
            self.motor(&fix);
        }
        if self.agent.poll_timeout() <= self.now() {
            self.hand_over(Recorded::Timeout);
        }
    }

    fn sensor_frame(&mut self) -> Option<Vec<u8>> {
        let frame = self.body.sense().expect("the plant is sound");
        let mut data = sensor_data(&frame);
        if (self.alter)(self.elapsed.as_secs_f64(), &mut data) == Pass::No {
            return None;
        }
        let message = MavMessage::SPHERE_SENSORS(data);
        Some(self.to_agent.message(&message).to_vec())
    }

    pub fn motor(&mut self, bytes: &[u8]) {
        self.hand_over(Recorded::Motor(bytes.to_vec()));
    }

    pub fn send(&mut self, key: &str, bytes: &[u8]) {
        self.hand_over(Recorded::Message(key.to_owned(), bytes.to_vec()));
    }

    pub fn send_message<M: Wire>(&mut self, message: &M) {
        let mut buffer = Buffer::new();
        wire::encode(message, &mut buffer).expect("a valid message");
        let key = Key::of::<M>(&id()).text();
        self.send(&key, &buffer);
    }

    pub fn send_plan(&mut self, plan: &SetpointPlan) {
        self.send_message(plan);
    }

    /// Sends an order of the test's own station under a new number.
    pub fn command(&mut self, order: CommandOrder) {
        self.command_from(STATION, order);
    }

    pub fn command_from(&mut self, station: u64, order: CommandOrder) {
        self.number += 1;
        self.send_message(&Command {
            robot: id(),
            boot_id: BOOT_ID,
            number: self.number,
            station,
            order,
        });
    }

    /// The next plan: straight ahead at `v` [m/s] for 2 s, from now on.
    pub fn plan(&mut self, v: f64) -> SetpointPlan {
        self.seq += 1;
        let telemetry = self.telemetry.as_ref().expect("the agent has spoken");
        let limits = &self.robot.limits;
        let mut x = reference_state(&telemetry.state, telemetry.v_d, telemetry.q_rd);
        let mut rows = vec![x];
        for _ in 0..20 {
            x = advance_reference(&x, [v, 0.0], 0.1, limits.reference_lag, self.robot.params.r);
            rows.push(x);
        }
        SetpointPlan {
            robot: id(),
            boot_id: BOOT_ID,
            id: PlanId {
                epoch: telemetry.epoch.max(1),
                seq: self.seq,
            },
            based_on: telemetry.stamp,
            start: self.now(),
            period: Span::from_millis(100),
            valid_for: Span::from_millis(5000),
            source: PlanSource::Riccati,
            u: [[v as f32, 0.0]; 20].into_iter().collect(),
            x: rows
                .iter()
                .map(|x| core::array::from_fn(|i| x[i] as f32))
                .collect(),
            // Half of each error in place and speed is taken off.
            k: [[-0.5, 0.0, 0.0, -0.5, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]; 20]
                .into_iter()
                .collect(),
        }
    }

    pub fn mode(&self) -> Mode {
        self.agent.mode()
    }

    /// Time since the bench was switched on [s].
    pub fn t(&self) -> f64 {
        self.elapsed.as_secs_f64()
    }

    /// The time on the agent's clock.
    pub fn now(&self) -> Instant<AgentClock> {
        Instant::from_nanos(0) + CLOCK + self.elapsed
    }

    pub fn transitions(&self) -> Vec<(Mode, Mode, Reason)> {
        self.events
            .iter()
            .filter_map(|(_, event)| match event {
                Event::Mode(transition) => {
                    Some((transition.from, transition.to, transition.reason))
                }
                _ => None,
            })
            .collect()
    }

    /// When the mode became `to` last [s].
    pub fn entered(&self, to: Mode) -> f64 {
        self.events
            .iter()
            .rev()
            .find_map(|(t, event)| match event {
                Event::Mode(transition) if transition.to == to => Some(*t),
                _ => None,
            })
            .unwrap_or_else(|| panic!("never {to:?}: {:?}", self.events))
    }

    /// When the torque commanded was not zero last [s]; `None` if it always was.
    pub fn last_torque(&self) -> Option<f64> {
        self.torques
            .iter()
            .rev()
            .find(|(_, command)| command.torque != Torque::default())
            .map(|(t, _)| *t)
    }

    pub fn dropped(&self, reason: DropReason) -> u32 {
        self.agent.dropped()[reason as usize]
    }

    /// True speed [m/s].
    pub fn v(&self) -> f64 {
        self.body.state().robot.v
    }

    pub fn hand_over(&mut self, input: Recorded) {
        let now = self.now();
        self.agent.handle_input(now, input.as_input());
        self.inputs.push((now, input));
        self.drain();
    }

    pub fn shut_down(&mut self) {
        self.agent.handle_input(self.now(), Input::Shutdown);
        self.drain();
    }

    pub fn abort(&mut self) {
        self.agent.handle_input(self.now(), Input::Abort);
        self.drain();
    }

    fn drain(&mut self) {
        let t = self.t();
        while let Some(output) = self.agent.poll_output() {
            match output {
                Output::Motor(frame) => {
                    let mut reader = FrameReader::new(Framing::Datagrams, BOARD, None);
                    if let Some(BoardEvent::Torque(command)) =
                        reader.pull(&mut &frame[..]).map(|received| received.event)
                    {
                        self.torques.push((t, command));
                    }
                    self.body.receive(&frame);
                }
                Output::Publish { topic, bytes, .. } => match topic {
                    Telemetry::TOPIC => {
                        self.telemetry = Some(wire::decode(&bytes).expect("sound"));
                    }
                    Status::TOPIC => self.status = Some(wire::decode(&bytes).expect("sound")),
                    _ => self.beacons += 1,
                },
                Output::Event(event) => self.events.push((t, event)),
            }
        }
    }
}

impl Recorded {
    pub fn as_input(&self) -> Input<'_> {
        match self {
            Self::Motor(bytes) => Input::Motor(bytes),
            Self::Message(key, bytes) => Input::Message { key, bytes },
            Self::Timeout => Input::Timeout,
        }
    }
}

/// The name of the robot on the bench.
pub fn id() -> RobotId {
    "r1".parse().expect("valid")
}

/// The fields of a sensor frame, as they travelled.
pub fn sensor_data(frame: &[u8]) -> SPHERE_SENSORS_DATA {
    let mut reader = FrameReader::new(Framing::Datagrams, AGENT, None);
    let received = reader.pull(&mut &frame[..]).expect("a whole frame");
    let BoardEvent::Sensors {
        measurement: m,
        sequence,
    } = received.event
    else {
        panic!("no sensor frame: {received:?}");
    };
    let mut status = SphereBoardStatus::empty();
    for (set, bit) in [
        (
            m.status.torque_on,
            SphereBoardStatus::SPHERE_BOARD_STATUS_TORQUE_ON,
        ),
        (
            m.status.command_valid,
            SphereBoardStatus::SPHERE_BOARD_STATUS_COMMAND_VALID,
        ),
        (
            m.status.imu_ok,
            SphereBoardStatus::SPHERE_BOARD_STATUS_IMU_OK,
        ),
        (
            m.status.encoders_ok,
            SphereBoardStatus::SPHERE_BOARD_STATUS_ENCODERS_OK,
        ),
    ] {
        status.set(bit, set);
    }
    SPHERE_SENSORS_DATA {
        time_usec: (m.stamp.as_nanos() / 1000).unsigned_abs(),
        theta_r: m.theta_r,
        theta_p: m.theta_p,
        theta_r_rate: m.theta_r_rate as f32,
        theta_p_rate: m.theta_p_rate as f32,
        gyro: m.gyro.map(|value| value as f32),
        accel: m.accel.map(|value| value as f32),
        sequence,
        status,
    }
}
