//! Messages to bytes and back.

use std::hint::black_box;

use divan::Bencher;
use sphere_protocol::message::{Mode, PlanId, PlanSource, SetpointPlan, Telemetry};
use sphere_protocol::state::RobotState;
use sphere_protocol::time::{Instant, Span};
use sphere_protocol::wire::{self, Buffer, Wire};

/// A plan of 20 knots with gains.
pub(crate) fn plan() -> SetpointPlan {
    SetpointPlan {
        robot: "r1".parse().expect("valid"),
        boot_id: 1,
        id: PlanId { epoch: 1, seq: 1 },
        based_on: Instant::from_nanos(0),
        start: Instant::from_nanos(0),
        period: Span::from_millis(100),
        valid_for: Span::from_millis(2_000),
        source: PlanSource::Riccati,
        u: [[0.5, 0.0]; 20].into_iter().collect(),
        x: [[0.0, 0.0, 0.0, 0.5, 0.0]; 21].into_iter().collect(),
        k: [[0.0; 10]; 20].into_iter().collect(),
    }
}

fn telemetry() -> Telemetry {
    Telemetry {
        robot: "r1".parse().expect("valid"),
        boot_id: 1,
        stamp: Instant::from_nanos(2),
        mode: Mode::Tracking,
        state: RobotState::default(),
        v_d: 0.5,
        q_rd: 0.0,
        position_sigma: 0.01,
        playing: Some(PlanId { epoch: 1, seq: 1 }),
        newest: Some(PlanId { epoch: 1, seq: 2 }),
        received: 1,
        loop_delay: Some(Span::from_millis(1)),
        epoch: 1,
        command: 0,
        torque: [0.0; 2],
    }
}

/// A plan written: checked and encoded.
#[divan::bench]
fn plan_written(bencher: Bencher) {
    written(bencher, &plan());
}

/// A plan read: decoded and checked.
#[divan::bench]
fn plan_read(bencher: Bencher) {
    read(bencher, &plan());
}

/// Telemetry written.
#[divan::bench]
fn telemetry_written(bencher: Bencher) {
    written(bencher, &telemetry());
}

/// Telemetry read.
#[divan::bench]
fn telemetry_read(bencher: Bencher) {
    read(bencher, &telemetry());
}

fn written(bencher: Bencher, message: &impl Wire) {
    let mut buffer = Buffer::new();
    bencher.bench_local(|| wire::encode(black_box(message), &mut buffer).expect("fits"));
}

fn read<M: Wire>(bencher: Bencher, message: &M) {
    let mut buffer = Buffer::new();
    wire::encode(message, &mut buffer).expect("fits");
    bencher.bench_local(|| wire::decode::<M>(black_box(&buffer)).expect("just written"));
}
