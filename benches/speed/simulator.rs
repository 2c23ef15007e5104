//! The simulator: a step of the plant, and robot-seconds with everything in the loop.

use std::num::NonZero;
use std::path::Path;

use divan::Bencher;
use divan::counter::ItemsCount;
use sphere_protocol::robot::Robot;
use sphere_protocol::state::Torque;
use sphere_sim::disturbance::Surroundings;
use sphere_sim::ensemble;
use sphere_sim::output::read_scenario;
use sphere_sim::plant::{Plant, PlantState};
use sphere_sim::run::run;
use sphere_sim::scenario::Scenario;

/// One step of the plant, 1 ms by Runge-Kutta: four evaluations of its equations. A robot-second has 1000.
#[divan::bench]
fn plant_step(bencher: Bencher) {
    let robot = Robot::embedded("liu").expect("comes with the project");
    let plant = Plant::new(robot.params);
    let mut around = Surroundings::level(&robot.params);
    around.imbalance = 0.2;
    let mut first = PlantState::default();
    (first.robot.v, first.robot.q_r, first.robot.beta) = (0.5, 0.1, -0.1);
    let (mut state, mut steps) = (first, 0);
    bencher.bench_local(|| {
        // A second at a time, so that the robot stays on its shell.
        steps += 1;
        if steps % 1000 == 0 {
            state = first;
        }
        state = plant.step(&state, Torque::default(), &around, 1e-3);
        state
    });
}

/// Eight lines of 20 s with seeds of their own, on one thread and on two.
#[divan::bench(args = [1, 2], sample_count = 10, sample_size = 1)]
fn robot_seconds_in_parallel(bencher: Bencher, threads: usize) {
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("sim/scenarios/line.toml");
    let scenarios: Vec<_> = (1..=8)
        .map(|seed| {
            let sets = ["duration_s=20".to_owned(), format!("seed={seed}")];
            read_scenario(&file, &sets).expect("it ships")
        })
        .collect();
    let threads = NonZero::new(threads).expect("one or two");
    let metrics = |scenario: &Scenario| {
        let run = run(scenario, "", || 0.0).expect("stable gains");
        run.metrics
    };
    bencher
        .counter(ItemsCount::new(8 * 20_usize))
        .bench_local(|| ensemble::map(&scenarios, threads, metrics, |_| {}));
}

/// Whole runs of 20 s of the scenarios that ship, network ideal: items per second are robot-seconds per second.
#[divan::bench(args = ["line", "sine", "lemniscate"], sample_count = 20, sample_size = 1)]
fn robot_seconds(bencher: Bencher, name: &str) {
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("sim/scenarios/{name}.toml"));
    let scenario = read_scenario(&file, &["duration_s=20".to_owned()]).expect("it ships");
    bencher
        .counter(ItemsCount::new(20_usize))
        .bench_local(|| run(&scenario, "", || 0.0).expect("stable gains"));
}
