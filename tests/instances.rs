//! The closed-loop instances that speed is measured on: what `benches/instances.rs` says of them is true.

#[path = "../benches/instances.rs"]
mod instances;

use instances::Trajectory;
use sphere_ground::mpc::{Mpc, Options, Problem, kkt_residual};

#[test]
fn the_papers_instances_solve_warm_and_meet_bounds_as_often_as_stated() {
    let expected = [(391, 29), (491, 25), (1091, 26)];
    for (trajectory, expected) in Trajectory::ALL.into_iter().zip(expected) {
        check(instances::paper(trajectory), expected);
    }
}

#[test]
fn the_lag_instances_solve_warm_and_meet_bounds_as_often_as_stated() {
    let expected = [
        [(391, 30), (491, 22), (1091, 25)],
        [(391, 29), (491, 22), (1091, 25)],
    ];
    for (horizon, expected) in [10, 20].into_iter().zip(expected) {
        for (trajectory, expected) in Trajectory::ALL.into_iter().zip(expected) {
            check(instances::lag(trajectory, horizon), expected);
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

/// Solves `problems` in turn, each from the solution before; `expected` says how many there are, and how many have an input on a bound.
fn check<const NX: usize>(problems: Vec<Problem<NX>>, expected: (usize, usize)) {
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
    assert_eq!((problems.len(), active), expected);
}
