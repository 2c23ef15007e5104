//! The control step allocates nothing: what it writes and reads on every tick is counted here.

#![allow(unsafe_code, reason = "only a global allocator can count")]

use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;
use std::hint::black_box;

use sphere_protocol::key::Key;
use sphere_protocol::mavlink::{
    Address, FrameReader, FrameWriter, Framing, Heartbeat, TorqueCommand,
};
use sphere_protocol::message::{Mode, PlanId, PlanSource, SetpointPlan, Telemetry};
use sphere_protocol::state::{Measurement, RobotState, Torque};
use sphere_protocol::time::{Instant, Span};
use sphere_protocol::wire::{self, Buffer};

struct Counting;

thread_local! {
    static ALLOCATIONS: Cell<usize> = const { Cell::new(0) };
}

// SAFETY: every call goes on to the system's allocator unchanged.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        ALLOCATIONS.set(ALLOCATIONS.get() + 1);
        // SAFETY: the caller keeps the contract.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        // SAFETY: the caller keeps the contract.
        unsafe { System.dealloc(pointer, layout) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

fn allocations(step: impl FnOnce()) -> usize {
    let before = ALLOCATIONS.get();
    step();
    ALLOCATIONS.get() - before
}

#[test]
fn counter_counts() {
    assert_eq!(allocations(|| drop(black_box(Box::new(1)))), 1);
}

#[test]
fn telemetry_and_plans_are_written_and_read_without_allocation() {
    let telemetry = Telemetry {
        robot: "r1".parse().expect("valid"),
        boot_id: 1,
        stamp: Instant::from_nanos(2),
        mode: Mode::Tracking,
        state: RobotState::default(),
        v_d: 0.0,
        q_rd: 0.0,
        position_sigma: 0.0,
        playing: Some(PlanId { epoch: 1, seq: 1 }),
        newest: None,
        received: 0,
        loop_delay: Some(Span::from_millis(1)),
        epoch: 1,
        command: 0,
        torque: [0.0; 2],
    };
    let plan = SetpointPlan {
        robot: telemetry.robot,
        boot_id: 1,
        id: PlanId { epoch: 1, seq: 1 },
        based_on: Instant::from_nanos(2),
        start: Instant::from_nanos(3),
        period: Span::from_millis(100),
        valid_for: Span::from_millis(1_000),
        source: PlanSource::Riccati,
        u: [[0.0; 2]; 20].into_iter().collect(),
        x: [[0.0; 5]; 21].into_iter().collect(),
        k: [[0.0; 10]; 20].into_iter().collect(),
    };
    let mut buffer = Buffer::new();
    let counted = allocations(|| {
        wire::encode(&telemetry, &mut buffer).expect("valid");
        assert_eq!(wire::decode::<Telemetry>(&buffer).as_ref(), Ok(&telemetry));
        wire::encode(&plan, &mut buffer).expect("valid");
        assert_eq!(wire::decode::<SetpointPlan>(&buffer).as_ref(), Ok(&plan));
        let key = Key::of::<Telemetry>(&telemetry.robot).text();
        Key::parse(&key).expect("valid");
    });
    assert_eq!(counted, 0);
}

#[test]
fn frames_are_written_and_read_without_allocation() {
    let (agent, board) = (
        Address {
            system: 1,
            component: 191,
        },
        Address {
            system: 1,
            component: 1,
        },
    );
    let command = TorqueCommand {
        target: board,
        sequence: 1,
        torque: Torque::default(),
        validity: Span::from_millis(100),
    };
    let sample = Measurement {
        stamp: Instant::from_nanos(0),
        gyro: [0.0; 3],
        accel: [0.0; 3],
        theta_r: 0.0,
        theta_r_rate: 0.0,
        theta_p: 0.0,
        theta_p_rate: 0.0,
        status: Default::default(),
    };
    let counted = allocations(|| {
        let (mut to_board, mut to_agent) = (FrameWriter::new(agent), FrameWriter::new(board));
        let mut at_board = FrameReader::new(Framing::Datagrams, board, None);
        let mut at_agent = FrameReader::new(Framing::Stream, agent, None);
        let torque = to_board.torque(&command).expect("valid");
        assert!(at_board.pull(&mut &torque[..]).is_some());
        let sensors = to_agent.sensors(&sample, 1).expect("valid");
        assert!(at_agent.pull(&mut &sensors[..]).is_some());
        let heartbeat = to_agent.heartbeat(&Heartbeat::board(true));
        assert!(at_agent.pull(&mut &heartbeat[..]).is_some());
        assert!(at_agent.pull(&mut &[0xfd; 1000][..]).is_none());
    });
    assert_eq!(counted, 0);
}
