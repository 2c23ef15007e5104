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
use crate::disturbance::Disturbance;
use crate::plant::{Accelerations, Plant, PlantState};
use crate::sensor::{PositionSource, Sensors};

/// Step of the plant's integration.
pub const STEP: Span = Span::from_millis(1);
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
    pub fn advance(&mut self, elapsed: Span) {
        let dt = STEP.as_secs_f64();
        while (self.steps + 1) * STEP.as_nanos() <= elapsed.as_nanos() {
            let command = self.board.torque(self.board_now());
            let torque = self.actuator.step(command);
            self.held &= torque == Torque::default();
            if !self.held && !self.has_fallen {
                self.wander(dt);
                let around = self.surroundings();
                let next = self.plant.step(&self.state, torque, &around, dt);
                // Near a roll of 90° the equations have no solution. What has leaned so far lies down.
                if next.robot.q_r.abs() > LIES {
                    self.lie_down();
                } else {
                    self.state = next;
                }
            }
            self.steps += 1;
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
        let around = self.surroundings();
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

    fn surroundings(&self) -> crate::disturbance::Surroundings {
        let elapsed = Span::from_nanos(self.steps * STEP.as_nanos()).as_secs_f64();
        let s = &self.state.robot;
        let mut around = self
            .disturbance
            .surroundings(self.plant.params(), elapsed, s.x, s.y);
        around.roll += self.random_torque[0];
        around.pitch += self.random_torque[1];
        around
    }

    /// Moves the random torque on by one step.
    fn wander(&mut self, dt: f64) {
        let random = self.disturbance.random;
        if random.sigma == 0.0 {
            return;
        }
        for torque in &mut self.random_torque {
            *torque = random.step(*torque, dt, StandardNormal.sample(&mut self.disturbances));
        }
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
        let elapsed = Span::from_nanos(self.steps * STEP.as_nanos());
        Instant::from_nanos(self.clock.shows(elapsed).as_nanos())
    }
}
