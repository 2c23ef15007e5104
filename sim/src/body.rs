//! One robot's hardware: the plant, its motor board, actuators and sensors, speaking MAVLink bytes with whatever agent is attached.
//!
//! The virtual world and the live plants drive this same code.

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use sphere_protocol::mavlink::{
    AGENT, BOARD, Event, Frame, FrameReader, FrameWriter, Framing, Heartbeat, TorqueCommand,
};
use sphere_protocol::robot::RobotParams;
use sphere_protocol::state::{BoardStatus, RobotState, Torque};
use sphere_protocol::time::{BoardClock, Instant, Span};

use crate::actuator::{Actuator, MotorBoard};
use crate::clock::SimClock;
use crate::disturbance::{Disturbance, Surroundings};
use crate::plant::{Accelerations, Plant, PlantState};
use crate::sensor::{PositionSource, Sensors};

/// Step of everything that drives a body: board, motors, and what disturbs it.
pub const STEP: Span = Span::from_millis(1);
/// Longest step of the plant's integration, in steps of what drives it: from one sensor frame to the next. Under torques that jump by
/// 4 N·m it moves no angle by half an encoder's step and no rate by a tenth of the gyro's noise (`tests/plant.rs`).
const STRIDE: f64 = 5.0;
/// Roll from which a robot lies on its side [rad]: 80°.
const LIES: f64 = 1.4;
/// Time between two of the board's signs of life.
pub const BOARD_HEARTBEAT: Span = Span::from_millis(1000);

/// What a body is made of.
#[derive(Clone, Debug)]
pub struct BodySetup {
    /// The true parameters.
    pub params: RobotParams,
    /// Where it stands at first: x, y [m], heading [rad].
    pub start: [f64; 3],
    /// What disturbs it.
    pub disturbance: Disturbance,
    /// Factor on every sensor's errors; 0 = ideal.
    pub noise: f64,
    /// Standard deviation of each axis of a position fix, noise factor included [m].
    pub fix_sigma: f64,
    /// The board's clock.
    pub clock: SimClock,
}

/// One robot's hardware at one instant.
#[derive(Clone, Debug)]
pub struct Body {
    plant: Plant,
    state: PlantState,
    /// Steps since the start.
    steps: i64,
    /// What acts on the plant in those of them that it has yet to take.
    ahead: Driven,
    board: MotorBoard,
    actuator: Actuator,
    sensors: Sensors,
    positions: PositionSource,
    disturbance: Disturbance,
    disturbances: ChaCha8Rng,
    /// The random torque now, on the roll and on the rolling motion [N·m].
    random_torque: [f64; 2],
    clock: SimClock,
    reader: FrameReader,
    writer: FrameWriter,
    samples: u32,
    newest_command: Option<u32>,
    refused_commands: u64,
    /// Held in a cradle until its motors move it for the first time.
    held: bool,
    /// It lies on its side for good.
    has_fallen: bool,
}

/// What acts on the plant over some steps, added up.
#[derive(Clone, Copy, Debug, Default)]
struct Driven {
    steps: f64,
    /// At the joints [N·m].
    torque: Torque,
    /// From outside, on the roll and on the rolling motion [N·m].
    outside: [f64; 2],
}

/// The random streams of a body, one for each purpose.
#[derive(Clone, Debug)]
pub struct BodyRandom {
    /// IMU and encoders.
    pub sensors: ChaCha8Rng,
    /// Position fixes.
    pub positions: ChaCha8Rng,
    /// Random torques.
    pub disturbances: ChaCha8Rng,
}

impl BodyRandom {
    /// Streams of robot number `robot` under `seed`.
    pub fn new(seed: u64, robot: usize) -> Self {
        Self {
            sensors: stream(seed, robot, Purpose::Sensors),
            positions: stream(seed, robot, Purpose::Positions),
            disturbances: stream(seed, robot, Purpose::Disturbances),
        }
    }
}

/// What a random stream is for. Values are part of every seed's meaning: never renumber.
#[derive(Clone, Copy, Debug)]
#[repr(u64)]
pub enum Purpose {
    /// IMU and encoder noise.
    Sensors = 0,
    /// Noise of position fixes.
    Positions = 1,
    /// Delay and loss from robot to station.
    LinkUp = 2,
    /// Delay and loss from station to robot.
    LinkDown = 3,
    /// Clock origins and boot ids.
    Clocks = 4,
    /// Random torques.
    Disturbances = 5,
    /// Bursts of loss from robot to station.
    WeatherUp = 6,
    /// Bursts of loss from station to robot.
    WeatherDown = 7,
    /// Duplicates and fates in bursts from robot to station.
    TwinsUp = 8,
    /// Duplicates and fates in bursts from station to robot.
    TwinsDown = 9,
    /// Which packets are replayed.
    Replay = 10,
}

/// The random stream of robot number `robot` for one purpose: ChaCha8, the same on every machine.
pub fn stream(seed: u64, robot: usize, purpose: Purpose) -> ChaCha8Rng {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    random.set_stream(robot as u64 * 16 + purpose as u64);
    random
}

impl Body {
    /// A robot at rest, its pendulum hanging, in a cradle that holds it until the first torque: an unbalanced shell would otherwise
    /// roll away while the estimator settles, and nobody starts a robot so.
    pub fn new(setup: BodySetup, random: BodyRandom) -> Self {
        let [x, y, heading] = setup.start;
        let robot = RobotState {
            x,
            y,
            heading,
            ..RobotState::default()
        };
        Self {
            actuator: Actuator::new(&setup.params, STEP),
            plant: Plant::new(setup.params),
            state: PlantState { robot, phi_s: 0.0 },
            steps: 0,
            ahead: Driven::default(),
            board: MotorBoard::new(),
            sensors: Sensors::new(setup.noise, random.sensors),
            positions: PositionSource::new(setup.fix_sigma, random.positions),
            disturbance: setup.disturbance,
            disturbances: random.disturbances,
            random_torque: [0.0; 2],
            clock: setup.clock,
            reader: FrameReader::new(Framing::Datagrams, BOARD, Some(AGENT.system)),
            writer: FrameWriter::new(BOARD),
            samples: 0,
            newest_command: None,
            refused_commands: 0,
            held: true,
            has_fallen: false,
        }
    }

    /// Lets time pass in whole steps, as far as `elapsed` since the start.
    ///
    /// The plant moves in strides of several steps under the mean of their torques: what reaches a speed is their sum.
    pub fn advance(&mut self, elapsed: Span) {
        self.elapse(elapsed);
        self.stride();
    }

    /// As [`Body::advance`], for someone who will only hand over a command: the plant may be up to 5 ms behind.
    pub fn elapse(&mut self, elapsed: Span) {
        while (self.steps + 1) * STEP.as_nanos() <= elapsed.as_nanos() {
            self.drive();
            if self.ahead.steps >= STRIDE {
                self.stride();
            }
        }
    }

    /// A datagram from the agent: whole frames. Torque commands are obeyed from the next step on; everything else is counted.
    pub fn receive(&mut self, mut bytes: &[u8]) {
        let now = self.board_now();
        while let Some(received) = self.reader.pull(&mut bytes) {
            let Event::Torque(command) = received.event else {
                continue;
            };
            if !self.is_newer(now, &command)
                || self
                    .board
                    .receive(now, command.torque, command.validity)
                    .is_err()
            {
                self.refused_commands += 1;
                continue;
            }
            self.newest_command = Some(command.sequence);
        }
    }

    /// One sensor frame, sampled now; `None` if the plant's state is beyond what a frame can carry.
    pub fn sense(&mut self) -> Option<Frame> {
        let around = self.surroundings(self.outside());
        let accelerations = if self.held || self.has_fallen {
            Accelerations::default()
        } else {
            self.plant
                .accelerations(&self.state, self.actuator.torque(), &around)
        };
        let imu = self.plant.imu(&self.state, &accelerations, &around);
        let now = self.board_now();
        let status = self.board.status(now);
        let radius = self.plant.params().r;
        let measurement = self.sensors.sample(now, &self.state, radius, &imu, status);
        self.samples = self.samples.wrapping_add(1);
        self.writer.sensors(&measurement, self.samples).ok()
    }

    /// Takes a position fix now; it arrives later, by [`Body::arrived_fix`].
    pub fn take_fix(&mut self) {
        self.positions.sample(self.board_now(), &self.state);
    }

    /// The next position fix that has arrived.
    pub fn arrived_fix(&mut self) -> Option<Frame> {
        let fix = self.positions.poll(self.board_now())?;
        self.writer.fix(&fix).ok()
    }

    /// When the next position fix arrives, since the start.
    pub fn next_fix_arrival(&self) -> Option<Span> {
        let arrival = self.positions.next_arrival()?;
        Some(self.clock.when(Span::from_nanos(arrival.as_nanos())))
    }

    /// The board's sign of life.
    pub fn heartbeat(&mut self) -> Frame {
        let on = self.board.status(self.board_now()).torque_on;
        self.writer.heartbeat(&Heartbeat::board(on))
    }

    /// The truth.
    pub fn state(&self) -> &PlantState {
        &self.state
    }

    /// The true parameters.
    pub fn params(&self) -> &RobotParams {
        self.plant.params()
    }

    /// The torque at the joints.
    pub fn torque(&self) -> Torque {
        self.actuator.torque()
    }

    /// What the motor board says of itself: whether the motors are on, and a command in force.
    pub fn board_status(&self) -> BoardStatus {
        self.board.status(self.board_now())
    }

    /// Torque commands that were well formed and not obeyed.
    pub fn refused_commands(&self) -> u64 {
        self.refused_commands
    }

    /// One step of board, motors and disturbances, ahead of the plant.
    fn drive(&mut self) {
        let torque = self.actuator.step(self.board.torque(self.board_now()));
        self.held &= torque == Torque::default();
        if !self.held && !self.has_fallen {
            self.wander();
            let outside = self.outside();
            let ahead = &mut self.ahead;
            ahead.steps += 1.0;
            ahead.torque.pitch += torque.pitch;
            ahead.torque.roll += torque.roll;
            ahead.outside[0] += outside[0];
            ahead.outside[1] += outside[1];
        }
        self.steps += 1;
    }

    /// The plant catches up, under the mean of what acted on it.
    fn stride(&mut self) {
        let ahead = core::mem::take(&mut self.ahead);
        if ahead.steps == 0.0 {
            return;
        }
        let share = 1.0 / ahead.steps;
        let torque = Torque {
            pitch: share * ahead.torque.pitch,
            roll: share * ahead.torque.roll,
        };
        let around = self.surroundings(ahead.outside.map(|torque| share * torque));
        let dt = ahead.steps * STEP.as_secs_f64();
        let next = self.plant.step(&self.state, torque, &around, dt);
        // Near a roll of 90° the equations have no solution. What has leaned so far lies down.
        if next.robot.q_r.abs() > LIES {
            self.lie_down();
        } else {
            self.state = next;
        }
    }

    /// Torque of pushes and of what wanders now, on the roll and on the rolling motion [N·m].
    fn outside(&self) -> [f64; 2] {
        let [roll, pitch] = self.disturbance.pushes_at(self.elapsed().as_secs_f64());
        [roll + self.random_torque[0], pitch + self.random_torque[1]]
    }

    /// What acts on the plant here, with these torques from outside on the roll and on the rolling motion [N·m].
    fn surroundings(&self, [roll, pitch]: [f64; 2]) -> Surroundings {
        let (params, s) = (self.plant.params(), &self.state.robot);
        let at = self.elapsed().as_secs_f64();
        Surroundings {
            roll,
            pitch,
            ..self.disturbance.surroundings(params, at, s.x, s.y)
        }
    }

    /// Moves the random torque on by one step.
    fn wander(&mut self) {
        let random = self.disturbance.random;
        if random.sigma == 0.0 {
            return;
        }
        let dt = STEP.as_secs_f64();
        for torque in &mut self.random_torque {
            *torque = random.step(*torque, dt, StandardNormal.sample(&mut self.disturbances));
        }
    }

    fn elapsed(&self) -> Span {
        Span::from_nanos(self.steps * STEP.as_nanos())
    }

    /// A repeated or overtaken command is not obeyed (modulo 2³²). Once the last one's validity has run out any number is new:
    /// an agent that has restarted counts from the beginning.
    fn is_newer(&self, now: Instant<BoardClock>, command: &TorqueCommand) -> bool {
        if !self.board.status(now).command_valid {
            return true;
        }
        self.newest_command.is_none_or(|newest| {
            let ahead = command.sequence.wrapping_sub(newest);
            ahead != 0 && ahead < u32::MAX / 2
        })
    }

    /// It stays as it is, without motion.
    fn lie_down(&mut self) {
        self.has_fallen = true;
        let robot = &mut self.state.robot;
        (robot.v, robot.q_r_rate) = (0.0, 0.0);
        (robot.alpha_rate, robot.beta_rate) = (0.0, 0.0);
    }

    fn board_now(&self) -> Instant<BoardClock> {
        Instant::from_nanos(self.clock.shows(self.elapsed()).as_nanos())
    }
}
