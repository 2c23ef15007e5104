//! An agent at work allocates nothing: sensor frames, fixes, plans, control steps, telemetry, beacons and status are counted here.

#![allow(unsafe_code, reason = "only a global allocator can count")]

#[path = "support/bench.rs"]
mod bench;

use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;

use bench::{Bench, Recorded};
use sphere_agent::control::DirectionChoice;
use sphere_agent::estimator::EstimatorConfig;
use sphere_protocol::message::{CommandOrder, Mode};
use sphere_protocol::robot::Robot;
use sphere_protocol::state::{RobotState, Setpoint};

struct Counting;

thread_local! {
    static ALLOCATIONS: Cell<usize> = const { Cell::new(0) };
}

// SAFETY: every call goes on to the system's allocator unchanged. `realloc` and `alloc_zeroed` come here by their defaults.
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

/// Hands the recorded inputs of a run to a new agent; returns how many allocations there were from input `warm` on, and outputs.
fn replay(bench: &Bench, warm: usize) -> (usize, usize, Mode) {
    let mut agent = Bench::agent(EstimatorConfig::default());
    let mut outputs = 0;
    let mut before = ALLOCATIONS.get();
    for (i, (now, input)) in bench.inputs.iter().enumerate() {
        if i == warm {
            before = ALLOCATIONS.get();
        }
        agent.handle_input(*now, input.as_input());
        while agent.poll_output().is_some() {
            outputs += 1;
        }
    }
    (ALLOCATIONS.get() - before, outputs, agent.mode())
}

#[test]
fn counter_counts() {
    let before = ALLOCATIONS.get();
    drop(std::hint::black_box(vec![1_u8; 100]));
    assert_eq!(ALLOCATIONS.get() - before, 1);
}

#[test]
fn a_tracking_agent_allocates_nothing() {
    // DESIGN: no allocation in a control step. 30 s of tracking: 1500 steps, 6000 sensor frames, 300 plans, 30 statuses.
    let mut bench = Bench::armed();
    let warm = bench.inputs.len();
    bench.track(0.5, 30.0);
    let steps = bench.inputs[warm..]
        .iter()
        .filter(|(_, input)| matches!(input, Recorded::Timeout))
        .count();
    assert!(steps >= 1000, "{steps} control steps");
    let (allocations, outputs, mode) = replay(&bench, warm);
    assert_eq!(mode, Mode::Tracking);
    println!(
        "{allocations} allocations in {steps} control steps, {} inputs, {outputs} outputs",
        bench.inputs.len() - warm
    );
    assert_eq!(allocations, 0);
}

#[test]
fn no_direction_controller_allocates_in_a_step() {
    let robot = Robot::embedded("liu").expect("embedded");
    let state = RobotState {
        v: 0.5,
        q_r: 0.05,
        beta: -0.1,
        ..RobotState::default()
    };
    for choice in [
        DirectionChoice::Htsmc,
        DirectionChoice::HtsmcPaper,
        DirectionChoice::FuzzyPid,
        DirectionChoice::FuzzyPidSingle,
    ] {
        let mut controller = choice.build(&robot).expect("valid");
        let before = ALLOCATIONS.get();
        for i in 0..100 {
            let setpoint = Setpoint {
                v: 0.5,
                q_r: f64::from(i) * 1e-3,
                ..Setpoint::default()
            };
            std::hint::black_box(controller.step(&state, &setpoint, 0.02));
        }
        controller.reset();
        assert_eq!(ALLOCATIONS.get() - before, 0, "{choice:?}");
    }
}

#[test]
fn orders_drops_and_faults_allocate_nothing_either() {
    // What a bad day can cause must not depend on an allocator. Malformed keys and messages alone cost an error's text.
    let mut bench = Bench::armed();
    let warm = bench.inputs.len();
    bench.track(0.5, 1.0);
    for seq in 0..5_u64 {
        let plan = bench.plan(0.5);
        bench.send_plan(&plan);
        bench.send_plan(&plan);
        bench.send("fleet/v1/r2/down/plan", &[0xff; 100]);
        bench.send("fleet/v1/r1/down/nothing", &[0; 3]);
        bench.motor(&[0xfd; 400]);
        bench.command_from(100 + seq, CommandOrder::Claim);
        bench.command(CommandOrder::Hold);
        bench.run(0.2);
        bench.command(CommandOrder::Resume);
        bench.track(0.5, 0.3);
    }
    bench.alter = Box::new(|_, _| bench::Pass::No);
    bench.run(0.3);
    bench.command(CommandOrder::Disarm);
    bench.run(0.3);
    let (allocations, _, _) = replay(&bench, warm);
    assert_eq!(allocations, 0);
}
