//! Rubbish on every input of agents and station in the middle of a run: nothing panics, nothing moves that must not, and what is
//! driving goes on driving.

use proptest::prelude::*;
use rand::{Rng, RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use sphere_protocol::key::Key;
use sphere_protocol::message::{
    Command, CommandOrder, DropReason, Mode, PlanId, PlanSource, SetpointPlan, Status, Telemetry,
};
use sphere_protocol::robot::RobotId;
use sphere_protocol::state::RobotState;
use sphere_protocol::state::Torque;
use sphere_protocol::time::{AgentClock, Instant, Span};
use sphere_protocol::wire::{self, Buffer, Wire};
use sphere_sim::metrics::{RunMetrics, RunRecord};
use sphere_sim::scenario::Scenario;
use sphere_sim::world::{Inject, MotorWay, World};

const LEMNISCATE: &str = include_str!("../sim/scenarios/lemniscate.toml");
const BOUND: f64 = 0.020;

fn scenario(sets: &[&str]) -> Scenario {
    let sets: Vec<_> = sets.iter().map(|set| (*set).to_owned()).collect();
    Scenario::parse("lemniscate.toml", LEMNISCATE, &sets, |path| {
        Err(format!("no file {path}"))
    })
    .expect("a valid scenario")
}

fn world(sets: &[&str]) -> World {
    World::new(&scenario(sets)).expect("the gains are stable")
}

fn at(s: f64) -> Span {
    Span::from_secs_f64(s)
}

fn rmse(world: &World, duration: Span) -> f64 {
    let record = RunRecord {
        seed: 1,
        duration,
        wall_s: 0.0,
        settle: at(10.0),
        violations: Vec::new(),
    };
    let metrics = RunMetrics::new(world.trace(), record, &world.records());
    metrics.robots[0].position_rmse_m.expect("it drove")
}

fn bytes_of<M: Wire>(message: &M) -> Vec<u8> {
    let mut buffer = Buffer::new();
    wire::encode(message, &mut buffer).expect("a valid message");
    buffer.to_vec()
}

fn robot() -> RobotId {
    "r1".parse().expect("valid")
}

/// Good messages and frames of a run, to be cut and bent.
fn samples(world: &World) -> Vec<Vec<u8>> {
    let session = world.station().session(&robot()).expect("configured");
    let telemetry = session.telemetry().expect("it spoke").clone();
    let plan = session.last_plan().expect("it drives").clone();
    let command = Command {
        robot: robot(),
        boot_id: telemetry.boot_id,
        number: 900,
        station: 99,
        order: CommandOrder::Arm,
    };
    vec![bytes_of(&telemetry), bytes_of(&plan), bytes_of(&command)]
}

/// Rubbish of every kind: noise, truncations, single bits, repeats.
fn rubbish(random: &mut ChaCha8Rng, samples: &[Vec<u8>]) -> Vec<u8> {
    let mut bytes = samples[random.random_range(0..samples.len())].clone();
    match random.random_range(0..4) {
        0 => {
            bytes.truncate(random.random_range(0..400));
            random.fill_bytes(&mut bytes);
        }
        1 => bytes.truncate(random.random_range(0..bytes.len())),
        2 => {
            // In the header, where a bit makes another message of it; a bit in a number is a number still.
            let bit = random.random_range(0..8 * bytes.len().min(12));
            bytes[bit / 8] ^= 1 << (bit % 8);
        }
        _ => {
            let again = bytes.clone();
            bytes.extend(again);
        }
    }
    bytes
}

#[test]
fn rubbish_on_every_input_leaves_tracking_within_its_bound() {
    // Promise: "truncated and garbage frames ...: a counted drop, never a panic, never a torque".
    let duration = at(60.0);
    let mut world = world(&["duration_s=60"]);
    let mut frames = Vec::new();
    world.run_until(at(15.0));
    assert_eq!(world.agent(0).mode(), Mode::Tracking);
    let samples = samples(&world);
    // Frames of the motor link are recorded from a board of the same kind.
    {
        let mut writer =
            sphere_protocol::mavlink::FrameWriter::new(sphere_protocol::mavlink::BOARD);
        frames.push(
            writer
                .heartbeat(&sphere_protocol::mavlink::Heartbeat::board(true))
                .to_vec(),
        );
    }
    let seed = 2;
    println!("seed {seed}");
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let keys = [
        "fleet/v1/r1/down/plan",
        "fleet/v1/r1/cmd/command",
        "fleet/v1/r1/up/telemetry",
        "fleet/v1/r1/up/status",
        "fleet/v1/r2/down/plan",
        "fleet/v1/r1/beacon",
        "fleet/v2/r1/down/plan",
        "fleet/v1/*/down/plan",
        "",
        "\u{0}\u{ffff}",
    ];
    for i in 0..4000 {
        let t = at(15.0 + 0.01 * f64::from(i));
        let to = match random.random_range(0..4) {
            0 => Inject::Agent(0),
            1 => Inject::Station,
            2 => Inject::MotorLink(0),
            _ => Inject::Board(0),
        };
        let bytes = match to {
            Inject::MotorLink(_) | Inject::Board(_) => rubbish(&mut random, &frames),
            // One bit turns telemetry into that of another life of the robot, which only access control can keep out.
            Inject::Station => {
                let mut bytes = rubbish(&mut random, &samples);
                bytes.truncate(60);
                bytes
            }
            Inject::Agent(_) => rubbish(&mut random, &samples),
        };
        world.inject(t, to, keys[random.random_range(0..keys.len())], &bytes);
    }
    world.run_until(duration);
    let reports = world.reports();
    assert_eq!(
        world.agent(0).mode(),
        Mode::Tracking,
        "{:?}",
        &reports[reports.len() - 8..]
    );
    let error = rmse(&world, duration);
    let dropped: u32 = world.agent(0).dropped().iter().sum();
    let session = world.station().session(&robot()).expect("configured");
    let at_station: u32 = session.counters().dropped.iter().sum::<u32>()
        + world.station().dropped().iter().sum::<u32>();
    println!("position_rmse_m {error:.4}; dropped {dropped} on board, {at_station} at the station");
    assert!(error <= BOUND, "{error}");
    assert!(dropped > 500 && at_station > 500);
}

#[test]
fn a_disarmed_robot_gets_no_torque_out_of_rubbish() {
    // Whatever arrives: without an order of its owner to arm, nothing moves.
    let mut world = world(&["duration_s=20"]);
    world.run_until(at(15.0));
    let samples = samples(&world);
    let telemetry = world
        .station()
        .session(&robot())
        .and_then(|session| session.telemetry())
        .expect("it spoke")
        .clone();
    // A stranger disarms it; the station takes that for a reason to arm again, so its commands are cut off.
    let disarm = Command {
        robot: robot(),
        boot_id: telemetry.boot_id,
        number: 4_000_000,
        station: 99,
        order: CommandOrder::Disarm,
    };
    let key = Key::of::<Command>(&robot()).text();
    world.inject(at(15.0), Inject::Agent(0), &key, &bytes_of(&disarm));
    world.run_until(at(15.1));
    assert!(!matches!(world.agent(0).mode(), Mode::Tracking));
    let mut random = ChaCha8Rng::seed_from_u64(3);
    for i in 0..2000 {
        let t = at(15.1 + 0.002 * f64::from(i));
        let key = ["fleet/v1/r1/down/plan", "fleet/v1/r1/cmd/command"][i as usize % 2];
        world.inject(
            t,
            Inject::Agent(0),
            key,
            &rubbish(&mut random, &samples[1..]),
        );
    }
    world.run_until(at(20.0));
    for row in world.trace().rows().iter().filter(|row| row.t > at(15.2)) {
        let armed = matches!(row.mode, Mode::Idle | Mode::Tracking | Mode::Holding);
        assert!(
            armed || row.torque_commanded == Torque::default(),
            "{:?} in {:?}",
            row.torque_commanded,
            row.mode
        );
    }
}

/// A plan that would drive the robot backwards, under any name.
fn hostile(boot_id: u64, id: PlanId, now: Instant<AgentClock>) -> SetpointPlan {
    SetpointPlan {
        robot: robot(),
        boot_id,
        id,
        based_on: now,
        start: now,
        period: Span::from_millis(100),
        valid_for: Span::from_millis(5000),
        source: PlanSource::Riccati,
        u: [[-0.5, 0.3]; 20].into_iter().collect(),
        x: [[0.0; 5]; 21].into_iter().collect(),
        k: Default::default(),
    }
}

#[test]
fn strangers_plans_and_orders_change_nothing() {
    // DESIGN 5: the lease's epoch fences off any other station; a foreign robot's messages are dropped.
    let duration = at(40.0);
    let mut world = world(&["duration_s=40"]);
    world.run_until(at(15.0));
    let telemetry = world
        .station()
        .session(&robot())
        .and_then(|session| session.telemetry())
        .expect("it spoke")
        .clone();
    let plan_key = Key::of::<SetpointPlan>(&robot()).text();
    let command_key = Key::of::<Command>(&robot()).text();
    for i in 0..200_u32 {
        let t = 15.0 + 0.1 * f64::from(i);
        let now = telemetry.stamp + at(t - 15.0);
        let seq = 1_000_000 + i;
        for (boot_id, epoch) in [
            (telemetry.boot_id, telemetry.epoch + 1),
            (telemetry.boot_id, 0),
            (telemetry.boot_id ^ 1, telemetry.epoch),
        ] {
            let plan = hostile(boot_id, PlanId { epoch, seq }, now);
            world.inject(at(t), Inject::Agent(0), &plan_key, &bytes_of(&plan));
        }
        let foreign = SetpointPlan {
            robot: "r2".parse().expect("valid"),
            ..hostile(
                telemetry.boot_id,
                PlanId {
                    epoch: telemetry.epoch,
                    seq,
                },
                now,
            )
        };
        world.inject(at(t), Inject::Agent(0), &plan_key, &bytes_of(&foreign));
        for order in [
            CommandOrder::Claim,
            CommandOrder::Release,
            CommandOrder::Resume,
        ] {
            let command = Command {
                robot: robot(),
                boot_id: telemetry.boot_id,
                number: telemetry.command + 1 + i * 3 + order as u32,
                station: 99,
                order,
            };
            world.inject(at(t), Inject::Agent(0), &command_key, &bytes_of(&command));
        }
        // Somebody else's telemetry under this robot's key, and a robot nobody configured.
        let liar = Telemetry {
            robot: "r2".parse().expect("valid"),
            state: RobotState {
                x: 1e3,
                ..RobotState::default()
            },
            ..telemetry.clone()
        };
        world.inject(
            at(t),
            Inject::Station,
            "fleet/v1/r1/up/telemetry",
            &bytes_of(&liar),
        );
        world.inject(
            at(t),
            Inject::Station,
            "fleet/v1/r2/up/telemetry",
            &bytes_of(&liar),
        );
    }
    world.run_until(duration);
    assert_eq!(world.agent(0).mode(), Mode::Tracking);
    let error = rmse(&world, duration);
    println!(
        "position_rmse_m {error:.4}, dropped on board {:?}",
        world.agent(0).dropped()
    );
    assert!(error <= BOUND, "{error}");
    let dropped = |reason: DropReason| world.agent(0).dropped()[reason as usize];
    assert_eq!(dropped(DropReason::WrongRobot), 200);
    assert_eq!(dropped(DropReason::WrongBoot), 200);
    assert!(
        dropped(DropReason::WrongEpoch) >= 400,
        "{}",
        dropped(DropReason::WrongEpoch)
    );
    let counters = world
        .station()
        .session(&robot())
        .expect("configured")
        .counters();
    assert_eq!(counters.dropped[DropReason::WrongRobot as usize], 200);
    assert_eq!(
        world.station().dropped()[DropReason::WrongRobot as usize],
        200
    );
}

#[test]
fn nan_from_a_sensor_ends_the_torque_and_is_counted() {
    // Promise: "NaN from a sensor: ... a counted drop, never a torque".
    let mut world = world(&["duration_s=16"]);
    world.tamper_with_motor_links(Box::new(|t, _, way, bytes| {
        if way == MotorWay::ToAgent && t >= Span::from_millis(14_000) && bytes.len() > 60 {
            // Gyro and accelerometer lie behind stamp, angles and rates; whatever is hit, the checksum is made right again.
            let reader = &mut sphere_protocol::mavlink::FrameReader::new(
                sphere_protocol::mavlink::Framing::Datagrams,
                sphere_protocol::mavlink::AGENT,
                None,
            );
            let mut data = match reader.pull(&mut &bytes[..]).map(|received| received.event) {
                Some(sphere_protocol::mavlink::Event::Sensors { .. }) => bench::sensor_data(bytes),
                _ => return,
            };
            data.gyro[0] = f32::NAN;
            *bytes = sphere_protocol::mavlink::FrameWriter::new(sphere_protocol::mavlink::BOARD)
                .message(&sphere_protocol::mavlink::MavMessage::SPHERE_SENSORS(data))
                .to_vec();
        }
    }));
    world.run_until(at(16.0));
    assert_eq!(world.agent(0).mode(), Mode::Fault);
    for row in world
        .trace()
        .rows()
        .iter()
        .filter(|row| row.t > at(14.0) + Span::from_millis(160))
    {
        assert_eq!(row.torque_commanded, Torque::default(), "at {:?}", row.t);
    }
    assert!(world.agent(0).dropped()[DropReason::OutOfRange as usize] >= 390);
}

#[path = "support/bench.rs"]
mod bench;

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn any_bytes_on_any_input_of_an_idle_agent_move_nothing(
        inputs in prop::collection::vec(
            (prop::bool::ANY, "[ -~]{0,40}", prop::collection::vec(any::<u8>(), 0..300)), 1..40,
        ),
    ) {
        // Arbitrary bytes never panic an agent; a robot that nobody armed stays without torque.
        let mut bench = bench::Bench::new();
        for (is_frame, key, bytes) in &inputs {
            if *is_frame {
                bench.motor(bytes);
            } else {
                bench.send(key, bytes);
                bench.send("fleet/v1/r1/down/plan", bytes);
                bench.send("fleet/v1/r1/cmd/command", bytes);
            }
            bench.run(0.005);
        }
        prop_assert_eq!(bench.last_torque(), None);
    }
}

#[test]
fn status_of_a_stranger_does_not_take_the_lease_away() {
    // A status for another life of the robot is dropped: the lease stays with the station.
    let mut world = world(&["duration_s=20"]);
    world.run_until(at(15.0));
    let status = Status {
        robot: robot(),
        boot_id: 4711,
        stamp: Instant::from_nanos(0),
        mode: Mode::Idle,
        reason: Default::default(),
        dropped: [0; DropReason::COUNT],
        gain_guard: 0,
        software: Default::default(),
        epoch: 1,
        station: 99,
    };
    let key = Key::of::<Status>(&robot()).text();
    world.inject(at(15.0), Inject::Station, &key, &bytes_of(&status));
    world.run_until(at(20.0));
    assert_eq!(world.agent(0).mode(), Mode::Tracking);
    let session = world.station().session(&robot()).expect("configured");
    assert!(session.epoch().is_some());
}
