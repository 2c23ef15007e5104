//! On board: a control period of the agent with everything in it, and a frame of the estimator.

use std::cell::RefCell;
use std::hint::black_box;

use divan::Bencher;
use sphere_agent::agent::{Agent, Input, Output};
use sphere_agent::config::{AgentConfig, Timing};
use sphere_agent::control::DirectionChoice;
use sphere_agent::control::hsmc::SpeedShape;
use sphere_agent::estimator::{Estimator, EstimatorConfig};
use sphere_agent::plan::{Playback, reference_state};
use sphere_protocol::key::{Key, KeyText};
use sphere_protocol::mavlink::{
    AGENT, BOARD, Event, Frame, FrameReader, FrameWriter, Framing, TorqueCommand,
};
use sphere_protocol::message::{Command, CommandOrder, Mode};
use sphere_protocol::robot::{Robot, RobotId};
use sphere_protocol::state::{Measurement, RobotState, Setpoint, Torque};
use sphere_protocol::time::{AgentClock, Instant, Span};
use sphere_protocol::wire::{self, Buffer, Wire};
use sphere_sim::body::{Body, BodyRandom, BodySetup};
use sphere_sim::disturbance::Disturbance;

use crate::wire::plan;

/// 20 ms on board while a plan is played: four sensor frames read and fused, a control step with playback and both laws, the torque
/// command written; telemetry and one plan received, as often as they come.
#[divan::bench(sample_count = 2000, sample_size = 1)]
fn control_period(bencher: Bencher) {
    let rig = RefCell::new(Rig::tracking());
    bencher
        .with_inputs(|| rig.borrow_mut().next_period())
        .bench_local_refs(|inputs| rig.borrow_mut().feed(inputs));
    assert_eq!(rig.into_inner().agent.mode(), Mode::Tracking);
}

/// One sensor frame in the estimator: prediction and six measurements.
#[divan::bench(sample_count = 4000, sample_size = 1)]
fn estimator_frame(bencher: Bencher) {
    let robot = Robot::embedded("liu").expect("comes with the project");
    let mut estimator = Estimator::new(&robot.params, EstimatorConfig::default());
    let (mut body, mut elapsed) = (body(&robot), Span::ZERO);
    bencher
        .with_inputs(|| sensed(&mut body, &mut elapsed))
        .bench_local_refs(|measurement| estimator.on_measurement(measurement));
}

/// The command of a plan in force, its feedback included.
#[divan::bench]
fn playback_command(bencher: Bencher) {
    let robot = Robot::embedded("liu").expect("comes with the project");
    let mut playback = Playback::new();
    let now = Instant::from_nanos(0);
    let received = playback.receive(plan(), now, &robot.limits);
    received.expect("a plan that begins now");
    let state = reference_state(&moving(), 0.5, 0.0);
    bencher.bench_local(|| {
        playback.advance(black_box(now));
        playback.command(now, black_box(&state), &robot.params, &robot.limits)
    });
}

/// The direction law that ships, HTSMC with its observer.
#[divan::bench]
fn direction_law(bencher: Bencher) {
    let robot = Robot::embedded("liu").expect("comes with the project");
    let mut law = DirectionChoice::Htsmc.build(&robot).expect("stable gains");
    let setpoint = setpoint();
    bencher.bench_local(|| law.step(black_box(&moving()), black_box(&setpoint), 0.02));
}

/// The velocity law, HSMC with its observer.
#[divan::bench]
fn velocity_law(bencher: Bencher) {
    let robot = Robot::embedded("liu").expect("comes with the project");
    let law = DirectionChoice::Htsmc.build_velocity(&robot);
    let mut law = law.expect("stable gains");
    let (setpoint, shape) = (setpoint(), SpeedShape::default());
    bencher.bench_local(|| law.step(black_box(&moving()), black_box(&setpoint), shape, 0.02));
}

/// A torque command checked and written as a MAVLink frame.
#[divan::bench]
fn torque_frame_written(bencher: Bencher) {
    let mut writer = FrameWriter::new(AGENT);
    let command = TorqueCommand {
        target: BOARD,
        sequence: 1,
        torque: Torque {
            pitch: 1.0,
            roll: -2.0,
        },
        validity: Span::from_millis(60),
    };
    bencher.bench_local(|| writer.torque(black_box(&command)).expect("within range"));
}

/// A sensor frame found, verified, read and checked.
#[divan::bench]
fn sensor_frame_read(bencher: Bencher) {
    let robot = Robot::embedded("liu").expect("comes with the project");
    let frame = body(&robot).sense().expect("a state within range");
    let mut reader = FrameReader::new(Framing::Datagrams, AGENT, Some(BOARD.system));
    bencher.bench_local(|| reader.pull(&mut black_box(&frame[..])));
}

/// What divan does not show: how long the slowest of many control periods take. Those in which the system took the processor away are
/// left out, where it tells.
pub(crate) fn print_quantiles() {
    const PERIODS: usize = 20_000;
    let mut rig = Rig::tracking();
    let mut times = Vec::with_capacity(PERIODS);
    for _ in 0..PERIODS {
        let mut inputs = rig.next_period();
        let before = timeslices();
        let begin = std::time::Instant::now();
        rig.feed(&mut inputs);
        let time = begin.elapsed();
        if timeslices() == before {
            times.push(time);
        }
    }
    assert_eq!(rig.agent.mode(), Mode::Tracking);
    times.sort_unstable();
    let interrupted = PERIODS - times.len();
    println!("\ncontrol_period, {PERIODS} of them, {interrupted} interrupted:");
    for (name, rank) in [("p50", 500), ("p90", 900), ("p99", 990), ("p99.9", 999)] {
        let time = times[times.len() * rank / 1000].as_secs_f64();
        println!("{name:>8} {:6.2} µs", 1e6 * time);
    }
}

/// How often this thread was given the processor; `None` where the system does not tell.
fn timeslices() -> Option<u64> {
    let statistics = std::fs::read_to_string("/proc/thread-self/schedstat").ok()?;
    statistics.split_whitespace().nth(2)?.parse().ok()
}

/// A robot that drives and leans.
fn moving() -> RobotState {
    RobotState {
        v: 0.5,
        q_r: 0.05,
        beta: -0.1,
        ..RobotState::default()
    }
}

fn setpoint() -> Setpoint {
    Setpoint {
        v: 0.5,
        q_r: 0.06,
        ..Setpoint::default()
    }
}

/// A robot and its agent in one time, without network.
struct Rig {
    body: Body,
    agent: Agent,
    elapsed: Span,
    plans: u32,
    /// What the agent wrote to the board.
    written: Vec<Frame>,
}

/// What reaches the agent in one control period, with the time since the period began.
struct Inputs {
    frames: Vec<(Span, Frame)>,
    message: Option<(KeyText, Buffer)>,
}

impl Rig {
    /// A robot that has been tracking for a while.
    fn tracking() -> Self {
        let robot = Robot::embedded("liu").expect("comes with the project");
        let config = AgentConfig {
            id: id(),
            robot: robot.clone(),
            boot_id: 1,
            estimator: EstimatorConfig::default(),
            direction: DirectionChoice::Htsmc,
            timing: Timing::default(),
        };
        let mut rig = Self {
            body: body(&robot),
            agent: Agent::new(Instant::from_nanos(0), config).expect("stable gains"),
            elapsed: Span::ZERO,
            plans: 0,
            written: Vec::new(),
        };
        rig.run(150);
        rig.order(1, CommandOrder::Claim);
        rig.order(2, CommandOrder::Arm);
        rig.run(150);
        assert_eq!(rig.agent.mode(), Mode::Tracking);
        rig
    }

    fn run(&mut self, periods: usize) {
        for _ in 0..periods {
            let mut inputs = self.next_period();
            self.feed(&mut inputs);
        }
    }

    /// The robot's next 20 ms under the torques written before, and a plan every fifth time.
    fn next_period(&mut self) -> Inputs {
        for frame in self.written.drain(..) {
            self.body.receive(&frame);
        }
        let mut frames = Vec::with_capacity(4);
        for i in 0..4 {
            let since = Span::from_millis(5 * i);
            self.body.advance(self.elapsed + since);
            frames.push((since, self.body.sense().expect("a state within range")));
        }
        let is_planned = self.elapsed.as_nanos() % 100_000_000 == 0;
        let message = is_planned.then(|| {
            self.plans += 1;
            let mut plan = plan();
            plan.id.seq = self.plans;
            (plan.based_on, plan.start) = (self.now(), self.now());
            message(&plan)
        });
        Inputs { frames, message }
    }

    fn feed(&mut self, inputs: &mut Inputs) {
        if let Some((key, bytes)) = &inputs.message {
            self.agent
                .handle_input(self.now(), Input::Message { key, bytes });
        }
        for (since, frame) in &inputs.frames {
            self.agent
                .handle_input(self.now() + *since, Input::Motor(frame));
        }
        self.elapsed = self.elapsed + Span::from_millis(20);
        self.agent.handle_input(self.now(), Input::Timeout);
        while let Some(output) = self.agent.poll_output() {
            if let Output::Motor(frame) = output {
                self.written.push(frame);
            }
        }
    }

    fn order(&mut self, number: u32, order: CommandOrder) {
        let (key, bytes) = message(&Command {
            robot: id(),
            boot_id: 1,
            number,
            station: 7,
            order,
        });
        let (key, bytes) = (&*key, &*bytes);
        self.agent
            .handle_input(self.now(), Input::Message { key, bytes });
    }

    fn now(&self) -> Instant<AgentClock> {
        Instant::from_nanos(self.elapsed.as_nanos())
    }
}

/// The robot of the paper with the usual noise, standing at the origin.
fn body(robot: &Robot) -> Body {
    let setup = BodySetup {
        params: robot.params,
        start: [0.0; 3],
        disturbance: Disturbance::default(),
        noise: 1.0,
        fix_sigma: 0.02,
        clock: sphere_sim::clock::SimClock::default(),
    };
    Body::new(setup, BodyRandom::new(1, 0))
}

/// The body's next sensor frame, 5 ms on.
fn sensed(body: &mut Body, elapsed: &mut Span) -> Measurement {
    *elapsed = *elapsed + Span::from_millis(5);
    body.advance(*elapsed);
    let frame = body.sense().expect("a state within range");
    let mut reader = FrameReader::new(Framing::Datagrams, AGENT, Some(BOARD.system));
    match reader.pull(&mut &frame[..]).map(|received| received.event) {
        Some(Event::Sensors { measurement, .. }) => measurement,
        other => panic!("no sensor frame: {other:?}"),
    }
}

fn message<M: Wire>(message: &M) -> (KeyText, Buffer) {
    let mut bytes = Buffer::new();
    wire::encode(message, &mut bytes).expect("fits");
    let key = Key::new(&id(), M::DIRECTION, M::TOPIC).expect("a valid key");
    (key.text(), bytes)
}

fn id() -> RobotId {
    "r1".parse().expect("valid")
}
