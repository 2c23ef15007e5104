//! The bytes on the wire are what the loop runs on: one field turned around, and the robot no longer tracks.

#[path = "support/bench.rs"]
mod bench;

use sphere_protocol::mavlink::sphere::SPHERE_SENSORS_DATA;
use sphere_protocol::mavlink::{
    AGENT, BOARD, Event, FrameReader, FrameWriter, Framing, MavMessage, TorqueCommand,
};
use sphere_protocol::message::Mode;
use sphere_protocol::state::Torque;
use sphere_sim::metrics::{RunMetrics, RunRecord};
use sphere_sim::scenario::Scenario;
use sphere_sim::world::{MotorWay, World};

const SINE: &str = include_str!("../sim/scenarios/sine.toml");

/// What the bound of an ideal network is [m].
const BOUND: f64 = 0.020;

enum Flip {
    Sensors(fn(&mut SPHERE_SENSORS_DATA)),
    Torque(fn(Torque) -> Torque),
    Fixes(fn([f64; 2]) -> [f64; 2]),
}

/// Drives the sine with every frame altered: the RMSE if the robot tracked to the end, or the mode in which it gave up.
fn drive(flip: Flip) -> Result<f64, Mode> {
    let sets = ["duration_s=40".to_owned()];
    let scenario = Scenario::parse("sine.toml", SINE, &sets, |path| {
        Err(format!("no file {path}"))
    })
    .expect("a valid scenario");
    let mut world = World::new(&scenario).expect("the gains are stable");
    let (mut from_board, mut from_agent) = (FrameWriter::new(BOARD), FrameWriter::new(AGENT));
    world.tamper_with_motor_links(Box::new(move |_, _, way, bytes| {
        let own = match way {
            MotorWay::ToAgent => AGENT,
            MotorWay::ToBoard => BOARD,
        };
        let event = FrameReader::new(Framing::Datagrams, own, None)
            .pull(&mut &bytes[..])
            .map(|received| received.event);
        match (&flip, event) {
            (Flip::Sensors(alter), Some(Event::Sensors { .. })) => {
                let mut data = bench::sensor_data(bytes);
                alter(&mut data);
                *bytes = from_board
                    .message(&MavMessage::SPHERE_SENSORS(data))
                    .to_vec();
            }
            (Flip::Torque(alter), Some(Event::Torque(command))) => {
                let torque = alter(command.torque);
                *bytes = from_agent
                    .torque(&TorqueCommand { torque, ..command })
                    .expect("still sane")
                    .to_vec();
            }
            (Flip::Fixes(alter), Some(Event::Fix(mut fix))) => {
                [fix.x, fix.y] = alter([fix.x, fix.y]);
                *bytes = from_board.fix(&fix).expect("still sane").to_vec();
            }
            _ => {}
        }
    }));
    world.run_until(scenario.duration());
    let mode = world.agent(0).mode();
    if mode != Mode::Tracking {
        return Err(mode);
    }
    let record = RunRecord {
        seed: scenario.seed,
        duration: scenario.duration(),
        wall_s: 0.0,
        settle: sphere_protocol::time::Span::from_secs_f64(scenario.metrics.settle_s),
        violations: Vec::new(),
    };
    let metrics = RunMetrics::new(world.trace(), record, &world.records());
    Ok(metrics.robots[0].position_rmse_m.unwrap_or(f64::INFINITY))
}

#[test]
fn frames_written_anew_unchanged_still_track() {
    // The control of the tests below: reading and writing a frame alone breaks nothing.
    for flip in [
        Flip::Sensors(|_| {}),
        Flip::Torque(|torque| torque),
        Flip::Fixes(|position| position),
    ] {
        let rmse = drive(flip).expect("it tracks");
        assert!(rmse <= BOUND, "{rmse}");
    }
}

#[test]
fn one_flipped_field_breaks_a_run() {
    // Promise: "the same wire bytes (...; one flipped encoder field breaks a run)".
    let flips: [(&str, Flip); 12] = [
        ("theta_r", Flip::Sensors(|data| data.theta_r *= -1.0)),
        ("theta_p", Flip::Sensors(|data| data.theta_p *= -1.0)),
        (
            "theta_r and theta_p swapped",
            Flip::Sensors(|data| core::mem::swap(&mut data.theta_r, &mut data.theta_p)),
        ),
        (
            "theta_p in degrees",
            Flip::Sensors(|data| data.theta_p = data.theta_p.to_degrees()),
        ),
        ("gyro forward", Flip::Sensors(|data| data.gyro[0] *= -1.0)),
        ("gyro left", Flip::Sensors(|data| data.gyro[1] *= -1.0)),
        ("gyro up", Flip::Sensors(|data| data.gyro[2] *= -1.0)),
        ("accel left", Flip::Sensors(|data| data.accel[1] *= -1.0)),
        (
            "torques swapped",
            Flip::Torque(|torque| Torque {
                pitch: torque.roll,
                roll: torque.pitch,
            }),
        ),
        (
            "torque pitch",
            Flip::Torque(|torque| Torque {
                pitch: -torque.pitch,
                ..torque
            }),
        ),
        (
            "torque roll",
            Flip::Torque(|torque| Torque {
                roll: -torque.roll,
                ..torque
            }),
        ),
        ("fix x and y swapped", Flip::Fixes(|[x, y]| [y, x])),
    ];
    let mut unnoticed = Vec::new();
    for (what, flip) in flips {
        let outcome = drive(flip);
        println!("{what}: {outcome:?}");
        if outcome.is_ok_and(|rmse| rmse <= BOUND) {
            unnoticed.push(what);
        }
    }
    assert!(unnoticed.is_empty(), "tracks all the same: {unnoticed:?}");
}
