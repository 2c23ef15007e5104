//! The agent's core: one robot's estimator, controllers, plans and modes, driven by bytes and time.
//!
//! A state machine without clock, sockets or threads: feed [`Agent::handle_input`], drain [`Agent::poll_output`], call again at
//! [`Agent::poll_timeout`]. The simulator and the deployed program drive this same code with the same bytes.

use std::collections::VecDeque;
use std::fmt::Write as _;

use arrayvec::{ArrayString, ArrayVec};
use sphere_protocol::key::Key;
use sphere_protocol::mavlink::{
    AGENT, BOARD, Event as BoardEvent, Frame, FrameCounters, FrameReader, FrameWriter, Framing,
    Heartbeat, TorqueCommand,
};
use sphere_protocol::message::{
    Beacon, Command, CommandOrder, Direction, DropReason, Message, Mode, PlanId, Qos, SetpointPlan,
    Status, Telemetry,
};
use sphere_protocol::state::{BoardStatus, RobotState, Setpoint, Torque};
use sphere_protocol::time::{AgentClock, BoardClock, Instant, Span};
use sphere_protocol::wire::{self, Wire, WireError};

use crate::board_clock::BoardClockMap;
use crate::config::AgentConfig;
use crate::control::DirectionController;
use crate::control::hsmc::{Hsmc, SpeedShape};
use crate::estimator::Estimator;
use crate::gains::GainsError;
use crate::mode::{Check, ModeMachine, Reason, Transition};
use crate::plan::{NoPlan, PlannedCommand, Playback, Shape, reference_state};
use crate::reference::{Reference, roll_bound};

/// What reaches an agent.
#[derive(Clone, Copy, Debug)]
pub enum Input<'a> {
    /// A datagram from the motor board: any number of whole MAVLink frames. What is cut off at its end is dropped and counted: it
    /// must not swallow the beginning of the next.
    Motor(&'a [u8]),
    /// A message of the fleet with its key.
    Message {
        /// The full key expression it was published on.
        key: &'a str,
        /// Its bytes.
        bytes: &'a [u8],
    },
    /// The time that [`Agent::poll_timeout`] named has come.
    Timeout,
    /// The program is to end: brake, rest, then zero torque and [`Event::Ended`].
    Shutdown,
    /// The program is to end now: zero torque and [`Event::Ended`] with the next control step.
    Abort,
}

/// A message of an agent as bytes; its longest, the status, takes under 400.
pub type Payload = ArrayVec<u8, 512>;

/// What an agent wants done.
#[derive(Clone, Debug)]
#[expect(
    clippy::large_enum_variant,
    reason = "drained at once; a box would allocate in the control step"
)]
pub enum Output {
    /// Write these bytes to the motor board.
    Motor(Frame),
    /// Publish a message.
    Publish {
        /// Which way it travels.
        direction: Direction,
        /// Its topic.
        topic: &'static str,
        /// How.
        qos: Qos,
        /// Its bytes.
        bytes: Payload,
    },
    /// Something to report.
    Event(Event),
}

/// Something worth reporting.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Event {
    /// The mode has changed.
    Mode(Transition),
    /// An order was refused in this mode.
    Refused {
        /// The order.
        order: CommandOrder,
        /// The mode that refused it.
        mode: Mode,
        /// Why it is in that mode.
        reason: Reason,
    },
    /// A station has the lease.
    Leased {
        /// Its identity.
        station: u64,
        /// The lease's epoch.
        epoch: u32,
    },
    /// Another station asked for a lease that is held.
    LeaseRefused {
        /// Who asked.
        station: u64,
        /// Who holds it.
        holder: u64,
    },
    /// An incoming message was dropped.
    Dropped(DropReason),
    /// Somebody sends messages of another schema version, which are dropped; told once for each topic and version.
    Incompatible(WireError),
    /// Shut down: at rest, torque zero.
    Ended,
}

/// Signals of the last control step, for logs and traces.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Signals {
    /// The state that the controllers used.
    pub state: RobotState,
    /// The setpoint that they followed.
    pub setpoint: Setpoint,
    /// The plan's command (v_c, q_c), if one was in force.
    pub command: Option<[f64; 2]>,
    /// The torque that was sent.
    pub torque: Torque,
    /// The plan in force.
    pub playing: Option<PlanId>,
    /// Age of the plan in force: now − `based_on`.
    pub plan_age: Option<Span>,
}

/// One robot's agent.
pub struct Agent {
    config: AgentConfig,
    estimator: Estimator,
    velocity: Hsmc,
    direction: Box<dyn DirectionController + Send>,
    mode: ModeMachine,
    playback: Playback,
    reference: Reference,
    reader: FrameReader,
    writer: FrameWriter,
    board: Board,
    lease: Lease,
    dropped: [u32; DropReason::COUNT],
    /// Schema versions that were refused and told of.
    incompatible: ArrayVec<WireError, 8>,
    signals: Signals,
    still_since: Option<Instant<AgentClock>>,
    ending: Option<Ending>,
    torque_sequence: u32,
    due: Deadlines,
    overruns: u64,
    outputs: VecDeque<Output>,
}

/// What is known of the motor board.
#[derive(Debug, Default)]
struct Board {
    clock: BoardClockMap,
    last_frame: Option<Instant<AgentClock>>,
    last_stamp: Option<Instant<BoardClock>>,
    status: BoardStatus,
    /// Restarts of the estimator that were answered.
    restarts: u64,
}

/// The program is to end.
#[derive(Clone, Copy, Debug)]
struct Ending {
    asked: Instant<AgentClock>,
    told: bool,
}

/// Who may send plans.
#[derive(Debug, Default)]
struct Lease {
    epoch: u32,
    station: u64,
    heard: Option<Instant<AgentClock>>,
    /// Newest command number of each station heard, so that a repeated order is carried out once.
    commands: ArrayVec<(u64, u32), 8>,
    newest_command: u32,
}

#[derive(Debug)]
struct Deadlines {
    control: Instant<AgentClock>,
    telemetry: Instant<AgentClock>,
    status: Instant<AgentClock>,
    beacon: Instant<AgentClock>,
    heartbeat: Instant<AgentClock>,
}

const OUTPUTS_MAX: usize = 64;
const HEARTBEAT_PERIOD: Span = Span::from_millis(1000);
/// At rest: |v| below this [m/s] for `REST_TIME`.
const REST_SPEED: f64 = 0.02;
const REST_TIME: Span = Span::from_millis(1000);
/// A robot asked to end has its torque taken away after this long, at rest or not.
const SHUTDOWN_MAX: Span = Span::from_millis(5000);
/// Beyond these the small-angle regime of both laws is left [rad].
const ROLL_FAULT: f64 = 1.0;
const SWING_FAULT: f64 = 1.4;
/// Position uncertainty with which a robot may be armed [m].
const LOCALISED_SIGMA: f64 = 0.3;

impl Agent {
    /// An agent that starts at `now`, in [`Mode::Boot`].
    ///
    /// # Errors
    /// Gains that cannot be stable (E2-E4), with the numbers.
    pub fn new(now: Instant<AgentClock>, config: AgentConfig) -> Result<Self, GainsError> {
        let robot = &config.robot;
        let estimator = Estimator::new(&robot.params, config.estimator);
        let velocity = config.direction.build_velocity(robot)?;
        let direction = config.direction.build(robot)?;
        let due = Deadlines {
            control: now,
            telemetry: now,
            status: now,
            beacon: now,
            heartbeat: now,
        };
        Ok(Self {
            config,
            estimator,
            velocity,
            direction,
            mode: ModeMachine::new(),
            playback: Playback::new(),
            reference: Reference::default(),
            reader: FrameReader::new(Framing::Datagrams, AGENT, Some(BOARD.system)),
            writer: FrameWriter::new(AGENT),
            board: Board::default(),
            lease: Lease::default(),
            dropped: [0; DropReason::COUNT],
            incompatible: ArrayVec::new(),
            signals: Signals::default(),
            still_since: None,
            ending: None,
            torque_sequence: 0,
            due,
            overruns: 0,
            outputs: VecDeque::with_capacity(OUTPUTS_MAX),
        })
    }

    /// Takes in what has happened by `now`. Never fails: what cannot be used is dropped and counted.
    pub fn handle_input(&mut self, now: Instant<AgentClock>, input: Input<'_>) {
        match input {
            Input::Motor(bytes) => self.on_motor(now, bytes),
            Input::Message { key, bytes } => {
                if let Err(reason) = self.on_message(now, key, bytes) {
                    self.drop_message(reason);
                }
            }
            Input::Timeout => self.on_timeout(now),
            Input::Shutdown => self.on_shutdown(now),
            Input::Abort => {
                self.begin_ending(now);
                let transition = self.mode.disarm(Reason::Shutdown);
                self.report(transition);
            }
        }
    }

    /// The next thing to do, until `None`.
    pub fn poll_output(&mut self) -> Option<Output> {
        self.outputs.pop_front()
    }

    /// When [`Input::Timeout`] is due.
    pub fn poll_timeout(&self) -> Instant<AgentClock> {
        self.due.control
    }

    /// The mode.
    pub fn mode(&self) -> Mode {
        self.mode.mode()
    }

    /// Why it is in this mode.
    pub fn reason(&self) -> Reason {
        self.mode.reason()
    }

    /// Signals of the last control step.
    pub fn signals(&self) -> &Signals {
        &self.signals
    }

    /// The plans at hand.
    pub fn playback(&self) -> &Playback {
        &self.playback
    }

    /// Messages and frames dropped, by reason.
    pub fn dropped(&self) -> &[u32; DropReason::COUNT] {
        &self.dropped
    }

    /// Control periods that passed without a step, because the deadline was noticed too late.
    pub fn overruns(&self) -> u64 {
        self.overruns
    }

    /// Frames of the motor board: those taken, and those dropped, by reason.
    pub fn frames(&self) -> &FrameCounters {
        self.reader.counters()
    }

    fn on_motor(&mut self, now: Instant<AgentClock>, mut bytes: &[u8]) {
        let before = *self.reader.counters();
        while let Some(received) = self.reader.pull(&mut bytes) {
            match received.event {
                BoardEvent::Sensors { measurement, .. } => {
                    let stamp = measurement.stamp;
                    self.board.clock.observe(now, stamp);
                    self.board.status = measurement.status;
                    self.estimator.on_measurement(&measurement);
                    // A frame that the estimator refuses leaves its stamp where it was, and the silence counts on. One that was
                    // held up on its way, in a full buffer or while the agent slept, is as old as it is.
                    if self.estimator.stamp() != self.board.last_stamp {
                        let sampled = now - self.board.clock.age(now, stamp);
                        let newest = self.board.last_frame.unwrap_or(sampled);
                        self.board.last_frame = Some(newest.max(sampled));
                        self.board.last_stamp = self.estimator.stamp();
                    }
                }
                BoardEvent::Fix(fix) => {
                    // Refused fixes are in the estimator's counters.
                    self.estimator.on_fix(&fix);
                }
                BoardEvent::Heartbeat(_) | BoardEvent::Torque(_) | BoardEvent::Other(_) => {}
            }
        }
        // Counted without an event each: a link gone mad must not crowd out what else there is to do.
        let after = *self.reader.counters();
        for (reason, before, after) in [
            (
                DropReason::Malformed,
                before.bad_checksum,
                after.bad_checksum,
            ),
            (DropReason::OutOfRange, before.invalid, after.invalid),
            (DropReason::WrongRobot, before.foreign, after.foreign),
            (DropReason::Unexpected, before.unknown, after.unknown),
        ] {
            let count = &mut self.dropped[reason as usize];
            *count = count.saturating_add(u32::try_from(after - before).unwrap_or(u32::MAX));
        }
    }

    fn on_message(
        &mut self,
        now: Instant<AgentClock>,
        key: &str,
        bytes: &[u8],
    ) -> Result<(), DropReason> {
        let key = Key::parse(key).map_err(|_| DropReason::Malformed)?;
        if key.robot() != self.config.id {
            return Err(DropReason::WrongRobot);
        }
        match (key.direction(), key.topic()) {
            (Direction::Down, SetpointPlan::TOPIC) => {
                let plan = self.decode(bytes)?;
                self.on_plan(now, plan)
            }
            (Direction::Command, Command::TOPIC) => {
                let command = self.decode(bytes)?;
                self.on_command(now, &command)
            }
            _ => Err(DropReason::Unexpected),
        }
    }

    fn decode<M: Wire>(&mut self, bytes: &[u8]) -> Result<M, DropReason> {
        wire::decode(bytes).map_err(|error| {
            let is_version = matches!(error, WireError::Version { .. });
            // Beyond the list's room it is only counted: nobody has so many versions.
            if is_version
                && !self.incompatible.contains(&error)
                && self.incompatible.try_push(error).is_ok()
            {
                self.due.status = self.due.control;
                self.emit(Output::Event(Event::Incompatible(error)));
            }
            error.reason()
        })
    }

    fn on_plan(&mut self, now: Instant<AgentClock>, plan: SetpointPlan) -> Result<(), DropReason> {
        if plan.robot != self.config.id {
            return Err(DropReason::WrongRobot);
        }
        if plan.boot_id != self.config.boot_id {
            return Err(DropReason::WrongBoot);
        }
        if self.lease.station == 0 || plan.id.epoch != self.lease.epoch {
            return Err(DropReason::WrongEpoch);
        }
        self.playback
            .receive(plan, now, &self.config.robot.limits)?;
        // Only what is new shows that the station lives: a replayed plan keeps no lease.
        self.lease.heard = Some(now);
        Ok(())
    }

    fn on_command(
        &mut self,
        now: Instant<AgentClock>,
        command: &Command,
    ) -> Result<(), DropReason> {
        if command.robot != self.config.id {
            return Err(DropReason::WrongRobot);
        }
        if command.boot_id != self.config.boot_id {
            return Err(DropReason::WrongBoot);
        }
        if !self.lease.is_new(command.station, command.number) {
            return Err(DropReason::Old);
        }
        let owner = self.lease.station == command.station;
        if owner {
            self.lease.heard = Some(now);
        }
        let refused = match command.order {
            CommandOrder::Claim => {
                self.claim(now, command.station);
                None
            }
            CommandOrder::Disarm => {
                let transition = self.mode.disarm(Reason::Ordered);
                self.report(transition);
                None
            }
            // Whoever sees a reason to stop may stop it; only its owner may set it in motion.
            CommandOrder::Hold => self
                .mode
                .hold(Reason::Ordered)
                .map(|transition| self.report(transition))
                .err(),
            _ if !owner => return Err(DropReason::WrongEpoch),
            CommandOrder::Release => {
                self.end_lease();
                None
            }
            // What ends is not set in motion again.
            CommandOrder::Arm | CommandOrder::Resume if self.ending.is_some() => {
                Some(self.mode.mode())
            }
            CommandOrder::Arm => match self.mode.arm() {
                Ok(transition) => {
                    if transition.is_some() {
                        self.begin_control();
                    }
                    self.report(transition);
                    None
                }
                Err(mode) => Some(mode),
            },
            CommandOrder::Resume => self.mode.resume().err(),
        };
        if let Some(mode) = refused {
            self.emit(Output::Event(Event::Refused {
                order: command.order,
                mode,
                reason: self.mode.reason(),
            }));
        }
        Ok(())
    }

    fn claim(&mut self, now: Instant<AgentClock>, station: u64) {
        let silent = self
            .lease
            .heard
            .is_none_or(|heard| now - heard > self.config.timing.lease_timeout);
        let holder = self.lease.station;
        if holder != 0 && holder != station && !silent {
            self.emit(Output::Event(Event::LeaseRefused { station, holder }));
            return;
        }
        // A plan in play ends by its own validity: a station that restarts picks the robot up without a jump.
        self.lease.epoch = self.lease.epoch.saturating_add(1);
        self.lease.station = station;
        self.lease.heard = Some(now);
        self.due.status = now;
        self.emit(Output::Event(Event::Leased {
            station,
            epoch: self.lease.epoch,
        }));
    }

    fn end_lease(&mut self) {
        self.lease.station = 0;
        self.playback.stop();
        let transition = self.mode.on_no_plan(Reason::LeaseChanged);
        self.report(transition);
    }

    fn on_shutdown(&mut self, now: Instant<AgentClock>) {
        if self.begin_ending(now)
            && let Ok(transition) = self.mode.hold(Reason::Shutdown)
        {
            self.report(transition);
        }
    }

    /// Whether it had not begun before.
    fn begin_ending(&mut self, now: Instant<AgentClock>) -> bool {
        let begins = self.ending.is_none();
        self.ending.get_or_insert(Ending {
            asked: now,
            told: false,
        });
        begins
    }

    fn on_timeout(&mut self, now: Instant<AgentClock>) {
        if self.due.control <= now {
            self.control_step(now);
            self.overruns += advance(&mut self.due.control, self.config.timing.control, now);
        }
        if self.due.heartbeat <= now {
            let frame = self.writer.heartbeat(&Heartbeat::agent(self.mode.mode()));
            self.emit(Output::Motor(frame));
            advance(&mut self.due.heartbeat, HEARTBEAT_PERIOD, now);
        }
        if self.due.status <= now {
            self.publish_status(now);
            self.due.status = now + self.config.timing.status;
        }
        if self.due.beacon <= now {
            self.publish_beacon(now);
            advance(&mut self.due.beacon, self.config.timing.beacon, now);
        }
    }

    /// Checks, plan, setpoint, torque: once a control period.
    fn control_step(&mut self, now: Instant<AgentClock>) {
        let state = self.state_at(now);
        let transition = self.mode.on_checks(self.first_failing_check(now));
        self.report(transition);
        if let Some(reason) = self.first_fault(now, &state) {
            let transition = self.mode.fault(reason);
            self.report(transition);
        }
        if let Some(reason) = self.first_loss() {
            let transition = self.mode.failsafe(reason);
            self.report(transition);
        }
        self.watch_rest(now, &state);

        self.playback.advance(now);
        let planned = self.planned_command(now, &state);
        if self.due.telemetry <= now {
            self.publish_telemetry(now, &state);
            advance(&mut self.due.telemetry, self.config.timing.telemetry, now);
        }

        let dt = self.config.timing.control.as_secs_f64();
        let limits = &self.config.robot.limits;
        let (setpoint, torque) = if self.mode.is_armed() {
            let (setpoint, shape) = match planned {
                Some(mut command) => {
                    let bound = roll_bound(self.reference.v(), &self.config.robot.params, limits);
                    command.q_r = command.q_r.clamp(-bound, bound);
                    if command.shape == Shape::Lag {
                        let PlannedCommand { v, q_r, .. } = command;
                        let setpoint = self.reference.follow(v, q_r, dt, limits);
                        (setpoint, SpeedShape::default())
                    } else {
                        let filter = self.direction.step_filter();
                        self.reference.follow_typed(&command, filter, dt)
                    }
                }
                None => (self.reference.brake(dt, limits), SpeedShape::default()),
            };
            let torque = Torque {
                pitch: self.velocity.step(&state, &setpoint, shape, dt),
                roll: self.direction.step(&state, &setpoint, dt),
            };
            (setpoint, torque)
        } else {
            (Setpoint::default(), Torque::default())
        };
        let torque = if torque.pitch.is_finite() && torque.roll.is_finite() {
            torque
        } else {
            let transition = self.mode.fault(Reason::ControllerFailed);
            self.report(transition);
            Torque::default()
        };
        self.send_torque(torque);
        let playing = self.playing();
        self.signals = Signals {
            state,
            setpoint,
            command: planned.map(|command| [command.v, command.q_r]),
            torque,
            playing: playing.map(|plan| plan.id),
            plan_age: playing.map(|plan| now - plan.based_on),
        };
    }

    /// The command of the plan in force, and the mode that follows from there being one or not.
    fn planned_command(
        &mut self,
        now: Instant<AgentClock>,
        state: &RobotState,
    ) -> Option<PlannedCommand> {
        if !self.mode.accepts_plans() {
            return None;
        }
        let x = reference_state(state, self.reference.v(), self.reference.q_r());
        let robot = &self.config.robot;
        match self.playback.command(now, &x, &robot.params, &robot.limits) {
            Ok(command) => {
                let transition = self.mode.on_plan();
                self.report(transition);
                Some(command)
            }
            Err(why) => {
                let transition = self.mode.on_no_plan(Reason::PlanEnded(why));
                self.report(transition);
                if why != NoPlan::None && !self.playback.has_waiting() {
                    self.playback.stop();
                }
                None
            }
        }
    }

    fn playing(&self) -> Option<&SetpointPlan> {
        if self.mode.mode() == Mode::Tracking {
            self.playback.playing()
        } else {
            None
        }
    }

    /// The estimate moved from the last frame's stamp to `now` by its own rates.
    fn state_at(&self, now: Instant<AgentClock>) -> RobotState {
        let mut state = self.estimator.state();
        let Some(stamp) = self.board.last_stamp else {
            return state;
        };
        let age = self.board.clock.age(now, stamp);
        if age < Span::ZERO || age > self.config.timing.sensor_timeout {
            return state;
        }
        let dt = age.as_secs_f64();
        let heading_rate = state.v * state.q_r.tan() / self.config.robot.params.r;
        let sideways = self.config.robot.params.r * state.q_r_rate;
        let (sin, cos) = (state.heading + 0.5 * dt * heading_rate).sin_cos();
        state.x += dt * (state.v * cos - sideways * sin);
        state.y += dt * (state.v * sin + sideways * cos);
        state.heading += dt * heading_rate;
        state.q_r += dt * state.q_r_rate;
        state.beta += dt * state.beta_rate;
        state.alpha += dt * state.alpha_rate;
        state
    }

    fn first_failing_check(&self, now: Instant<AgentClock>) -> Option<Check> {
        let state = self.estimator.state();
        if self.sensors_stale(now) {
            Some(Check::SensorsFresh)
        } else if !self.estimator.converged() {
            Some(Check::EstimatorConverged)
        } else if !self.sensors_healthy() || !self.estimator.sensor_health().accel {
            Some(Check::BoardHealthy)
        } else if self.estimator.position_sigma() > LOCALISED_SIGMA {
            Some(Check::Localised)
        } else if state.q_r.abs() > 0.5 * ROLL_FAULT
            || state.alpha.abs().max(state.beta.abs()) > 0.5 * SWING_FAULT
        {
            Some(Check::Upright)
        } else {
            None
        }
    }

    /// What makes control impossible now.
    fn first_fault(&self, now: Instant<AgentClock>, state: &RobotState) -> Option<Reason> {
        let finite = [
            state.x,
            state.y,
            state.heading,
            state.v,
            state.q_r,
            state.q_r_rate,
            state.beta,
            state.beta_rate,
            state.alpha,
            state.alpha_rate,
        ];
        if self.sensors_stale(now) {
            Some(Reason::SensorsLost)
        } else if !self.sensors_healthy() {
            Some(Reason::SensorFailed)
        } else if !finite.iter().all(|value| value.is_finite()) {
            Some(Reason::EstimatorFailed)
        } else if state.q_r.abs() > ROLL_FAULT
            || state.alpha.abs().max(state.beta.abs()) > SWING_FAULT
        {
            Some(Reason::OverTilt)
        } else {
            None
        }
    }

    /// What is lost and leaves the robot able to brake and hold.
    fn first_loss(&mut self) -> Option<Reason> {
        let restarts = self.estimator.counters().restarts;
        if restarts != self.board.restarts {
            self.board.restarts = restarts;
            Some(Reason::EstimatorRestarted)
        } else if !self.estimator.sensor_health().accel {
            Some(Reason::AccelerometerFailed)
        } else {
            None
        }
    }

    /// By the board's own word and by what its values look like. The accelerometer corrects slowly: without it the robot can
    /// still brake.
    fn sensors_healthy(&self) -> bool {
        let seen = self.estimator.sensor_health();
        let said = self.board.status;
        said.imu_ok && said.encoders_ok && seen.gyro && seen.encoders
    }

    fn sensors_stale(&self, now: Instant<AgentClock>) -> bool {
        self.board
            .last_frame
            .is_none_or(|last| now - last > self.config.timing.sensor_timeout)
    }

    fn watch_rest(&mut self, now: Instant<AgentClock>, state: &RobotState) {
        if state.v.abs() > REST_SPEED {
            self.still_since = None;
        } else if self.still_since.is_none() {
            self.still_since = Some(now);
        }
        let Some(Ending { asked, told: false }) = self.ending else {
            return;
        };
        let at_rest = self
            .still_since
            .is_some_and(|since| now - since >= REST_TIME);
        if !self.mode.is_armed() || at_rest || now - asked >= SHUTDOWN_MAX {
            let transition = self.mode.disarm(Reason::Shutdown);
            self.report(transition);
            self.ending = Some(Ending { asked, told: true });
            self.emit(Output::Event(Event::Ended));
        }
    }

    /// Controllers and reference start from what the robot does now.
    fn begin_control(&mut self) {
        let state = self.estimator.state();
        self.reference = Reference::starting_at(state.v, state.q_r);
        self.velocity.reset();
        self.direction.reset();
        self.playback.stop();
    }

    fn send_torque(&mut self, torque: Torque) {
        self.torque_sequence = self.torque_sequence.wrapping_add(1);
        let command = TorqueCommand {
            target: BOARD,
            sequence: self.torque_sequence,
            torque,
            validity: self.config.timing.torque_validity,
        };
        match self.writer.torque(&command) {
            Ok(frame) => self.emit(Output::Motor(frame)),
            // Out of the link's range: the board's validity turns silence into zero torque.
            Err(_) => self.drop_message(DropReason::OutOfRange),
        }
    }

    fn publish_telemetry(&mut self, now: Instant<AgentClock>, state: &RobotState) {
        let torque = self.signals.torque;
        self.publish(&Telemetry {
            robot: self.config.id,
            boot_id: self.config.boot_id,
            stamp: now,
            mode: self.mode.mode(),
            state: *state,
            v_d: self.reference.v(),
            q_rd: self.reference.q_r(),
            position_sigma: self.estimator.position_sigma(),
            playing: self.playing().map(|plan| plan.id),
            newest: self.playback.newest(),
            received: self.playback.received(),
            loop_delay: self.playback.loop_delay(),
            epoch: if self.lease.station == 0 {
                0
            } else {
                self.lease.epoch
            },
            command: self.lease.newest_command,
            torque: [torque.pitch, torque.roll],
        });
    }

    fn publish_status(&mut self, now: Instant<AgentClock>) {
        let mut reason = ArrayString::new();
        // A sentence longer than the field is cut short, not lost.
        let _ = write!(reason, "{}", self.mode.reason());
        let software = ArrayString::from(env!("CARGO_PKG_VERSION")).unwrap_or_default();
        self.publish(&Status {
            robot: self.config.id,
            boot_id: self.config.boot_id,
            stamp: now,
            mode: self.mode.mode(),
            reason,
            dropped: self.dropped,
            gain_guard: self.direction.counters().gain_guard,
            software,
            epoch: if self.lease.station == 0 {
                0
            } else {
                self.lease.epoch
            },
            station: self.lease.station,
        });
    }

    fn publish_beacon(&mut self, now: Instant<AgentClock>) {
        let state = self.state_at(now);
        let sideways = self.config.robot.params.r * state.q_r_rate;
        let (sin, cos) = state.heading.sin_cos();
        self.publish(&Beacon {
            robot: self.config.id,
            boot_id: self.config.boot_id,
            stamp: now,
            position: [state.x, state.y],
            velocity: [
                state.v * cos - sideways * sin,
                state.v * sin + sideways * cos,
            ],
            radius: self.config.robot.params.r,
        });
    }

    fn publish<M: Wire>(&mut self, message: &M) {
        let mut bytes = Payload::new();
        match wire::encode(message, &mut bytes) {
            Ok(()) => self.emit(Output::Publish {
                direction: M::DIRECTION,
                topic: M::TOPIC,
                qos: M::QOS,
                bytes,
            }),
            Err(_) => self.drop_message(DropReason::OutOfRange),
        }
    }

    fn report(&mut self, transition: Option<Transition>) {
        if let Some(transition) = transition {
            // Tell the station with the next timeout, not with the next status period.
            self.due.status = self.due.control;
            self.emit(Output::Event(Event::Mode(transition)));
        }
    }

    fn drop_message(&mut self, reason: DropReason) {
        let count = &mut self.dropped[reason as usize];
        *count = count.saturating_add(1);
        self.emit(Output::Event(Event::Dropped(reason)));
    }

    fn emit(&mut self, output: Output) {
        // A shell that does not drain loses the oldest, never memory.
        if self.outputs.len() == OUTPUTS_MAX {
            self.outputs.pop_front();
        }
        self.outputs.push_back(output);
    }
}

/// Moves `due` by whole periods to the first that is later than `now`; returns how many were skipped. A paused program does not
/// make up for what it missed.
fn advance(due: &mut Instant<AgentClock>, period: Span, now: Instant<AgentClock>) -> u64 {
    let period = period.as_nanos().max(1);
    let missed = now.since(*due).as_nanos().max(0) / period;
    *due += Span::from_nanos(period.saturating_mul(missed.saturating_add(1)));
    missed.unsigned_abs()
}

impl Lease {
    /// Whether a command with this number is new from this station; remembers it.
    fn is_new(&mut self, station: u64, number: u32) -> bool {
        let known = self
            .commands
            .iter_mut()
            .find(|(known, _)| *known == station);
        let new = match known {
            Some((_, last)) if number <= *last => false,
            Some((_, last)) => {
                *last = number;
                true
            }
            None => {
                if self.commands.is_full() {
                    self.commands.remove(0);
                }
                self.commands.push((station, number));
                true
            }
        };
        if new {
            self.newest_command = number;
        }
        new
    }
}
