//! The closed-loop instances that speed is measured on: what `benches/instances.rs` says of them is true.

#[path = "../benches/instances.rs"]
mod instances;

use instances::Trajectory;
use sphere_ground::mpc::{Mpc, Options, Problem, kkt_residual};

/// Problems of each trajectory, one a tick.
const COUNTS: [usize; 3] = [391, 491, 1091];

#[test]
fn the_papers_instances_solve_warm_and_meet_bounds_as_often_as_stated() {
    for (trajectory, count) in Trajectory::ALL.into_iter().zip(COUNTS) {
        check(instances::paper(trajectory), count);
    }
}

#[test]
fn the_lag_instances_solve_warm_and_meet_bounds_as_often_as_stated() {
    for horizon in [10, 20] {
        for (trajectory, count) in Trajectory::ALL.into_iter().zip(COUNTS) {
            check(instances::lag(trajectory, horizon), count);
        }
    }
}

#[test]
fn a_recording_is_the_same_each_time() {
    let trajectory = Trajectory::Line;
    assert_eq!(instances::paper(trajectory), instances::paper(trajectory));
    assert_eq!(
        instances::lag(trajectory, 20),
        instances::lag(trajectory, 20)
    );
}

/// Solves `problems` in turn, each from the solution before; there must be `count`, and 20 to 50 of them have an input on a bound.
fn check<const NX: usize>(problems: Vec<Problem<NX>>, count: usize) {
    let mut mpc = Mpc::new(problems[0].horizon(), Options::default());
    let mut active = 0;
    for (tick, problem) in problems.iter().enumerate() {
        mpc.shift(1);
        let solution = mpc.solve(problem);
        assert!(solution.is_solved(), "tick {tick}: {}", solution.status);
        // What the solver promises; it reaches 1e-13.
        let residual = kkt_residual(problem, &solution.x, &solution.u);
        assert!(residual < 1e-9, "tick {tick}: residual {residual:e}");
        // Inputs that are held lie on their bound exactly.
        let is_held = |k: usize| {
            (0..2).any(|j| {
                let u = solution.u[k][j];
                u <= problem.u_min[k][j] || u >= problem.u_max[k][j]
            })
        };
        active += usize::from((0..problem.horizon()).any(is_held));
    }
    assert_eq!(problems.len(), count);
    assert!((20..=50).contains(&active), "{active}");
}
