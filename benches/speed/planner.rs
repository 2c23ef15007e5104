//! The planner: a tick of each formulation by each solver, and what surrounds it.

use std::cell::RefCell;
use std::hint::black_box;

use divan::Bencher;
use nalgebra::Vector2;
use sphere_ground::mpc::{Mpc, Options, Problem, Solver, terminal_weight};
use sphere_ground::trajectory::{Mission, Pose, Trajectory};
use sphere_protocol::robot::Robot;

use crate::tracking::{self, centre, paper};

const SOLVERS: [Solver; 2] = [Solver::Riccati, Solver::Clarabel];

/// A tick of what ships (model `centre`, N = 20, turn limit) along the lemniscate, warm from the tick before.
#[divan::bench(args = SOLVERS, sample_count = 400, sample_size = 1)]
fn centre_20_knots(bencher: Bencher, solver: Solver) {
    let mut x = [0.3, -0.2, 0.6, 0.4, 0.0];
    ticks(bencher, solver, 20, move |tick, last: &Mpc<5>| {
        if tick > 0 {
            x = last.solution().x[1].into();
        }
        let mut problem = centre(tracking::Trajectory::Lemniscate, 0.1 * tick as f64, x);
        problem.turn_limit = Some(0.3);
        problem
    });
}

/// A tick of the paper's eq (20), N = 10, along the lemniscate, warm from the tick before.
#[divan::bench(args = SOLVERS, sample_count = 400, sample_size = 1)]
fn paper_10_knots(bencher: Bencher, solver: Solver) {
    let (mut x, mut u) = ([0.3, -0.2, 0.6], Vector2::new(0.4, 0.0));
    ticks(bencher, solver, 10, move |tick, last: &Mpc<3>| {
        if tick > 0 {
            (x, u) = (last.solution().x[1].into(), last.solution().u[1]);
        }
        paper(tracking::Trajectory::Lemniscate, 0.1 * tick as f64, x, u)
    });
}

/// Solves tick after tick, each problem made from the solution before; only the solving is timed.
fn ticks<const NX: usize>(
    bencher: Bencher,
    solver: Solver,
    horizon: usize,
    mut next: impl FnMut(usize, &Mpc<NX>) -> Problem<NX>,
) {
    let options = Options {
        solver,
        ..Options::default()
    };
    let mpc = RefCell::new(Mpc::new(horizon, options));
    let mut tick = 0;
    bencher
        .with_inputs(|| {
            let problem = next(tick, &mpc.borrow());
            tick += 1;
            problem
        })
        .bench_local_refs(|problem| {
            let mut mpc = mpc.borrow_mut();
            mpc.shift(1);
            assert!(mpc.solve(problem).is_solved());
        });
}

/// The infinite-horizon cost of the last reference, once a plan.
#[divan::bench]
fn terminal_weight_centre(bencher: Bencher) {
    let problem = centre(tracking::Trajectory::Lemniscate, 3.0, [0.0; 5]);
    bencher.bench_local(|| {
        terminal_weight(
            black_box(&problem.model),
            &problem.x_ref[19],
            &problem.u_ref[19],
            &problem.q,
            &problem.r,
        )
    });
}

/// One point of a reference; a plan of 20 knots takes 41.
#[divan::bench(args = ["line", "sine", "lemniscate"])]
fn reference_point(bencher: Bencher, name: &str) {
    let mission = match name {
        "line" => Mission::Line,
        "sine" => Mission::Sine,
        _ => Mission::Lemniscate,
    };
    let robot = Robot::embedded("liu").expect("comes with the project");
    let trajectory = Trajectory::new(&mission, &robot, Pose::default()).expect("drivable");
    let mut t = 0.0;
    bencher.bench_local(|| {
        t += 0.05;
        trajectory.reference(black_box(t))
    });
}
