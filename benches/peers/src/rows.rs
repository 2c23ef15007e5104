//! The solvers that take turns: to add one, write a function from instances to a [`Pass`] and name it in [`all`].

mod condensed;
mod ours;

use std::time::Instant;

use nalgebra::Vector2;
use serde::Serialize;
use sphere_ground::mpc::Problem;

/// One pass of a solver over the instances of a trajectory, each solved from the solution before.
#[derive(Default, Serialize)]
pub struct Pass {
    name: &'static str,
    /// Of each instance [µs].
    times: Vec<f64>,
    /// SQP iterations of each instance.
    iterations: Vec<u32>,
    /// Whether the solver says so of itself.
    solved: Vec<bool>,
    /// Decided inputs of each instance, N rows [m/s, rad].
    u: Vec<Vec<[f64; 2]>>,
}

/// What one solve came to.
pub struct Solved {
    pub iterations: u32,
    pub is_solved: bool,
}

/// Every row, in the order of the table. Names that begin with `ours` are set apart there.
pub fn all<const NX: usize>() -> Vec<(&'static str, fn(&[Problem<NX>]) -> Pass)> {
    vec![
        ("ours", ours::converged::<NX>),
        ("ours, real-time iteration", ours::real_time::<NX>),
        ("ours, batch of 8", ours::batch::<NX>),
        (
            "ours, batch of 8, real-time iteration",
            ours::batch_real_time::<NX>,
        ),
        ("Clarabel, sparse, Gauss-Newton", ours::clarabel::<NX>),
        (
            "Clarabel, condensed, Gauss-Newton",
            condensed::clarabel::<NX>,
        ),
        ("OSQP, condensed, Gauss-Newton", condensed::osqp::<NX>),
    ]
}

impl Pass {
    /// Solves one instance after the other by `solve`, which leaves the decided inputs in its second argument.
    pub fn one_by_one<const NX: usize>(
        problems: &[Problem<NX>],
        mut solve: impl FnMut(&Problem<NX>, &mut Vec<Vector2<f64>>) -> Solved,
    ) -> Self {
        let mut pass = Self::default();
        let mut u = Vec::new();
        for problem in problems {
            let start = Instant::now();
            let solved = solve(problem, &mut u);
            let time = 1e6 * start.elapsed().as_secs_f64();
            pass.push(time, solved, &u);
        }
        pass
    }

    /// One more instance: its time [µs], what it came to, its inputs.
    pub fn push(&mut self, time: f64, solved: Solved, u: &[Vector2<f64>]) {
        self.times.push(time);
        self.iterations.push(solved.iterations);
        self.solved.push(solved.is_solved);
        self.u.push(u.iter().map(|u| (*u).into()).collect());
    }

    /// The same under its row's name.
    pub fn named(mut self, name: &'static str) -> Self {
        self.name = name;
        self
    }
}
