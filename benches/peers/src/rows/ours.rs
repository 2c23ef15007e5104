//! The project's own solver, and the same SQP with Clarabel under it.

use sphere_ground::mpc::{Mpc, Options, Problem, Solver};

use super::{Pass, Solved};

/// As the planner calls it: warm from the shifted last solution, converged.
pub fn converged<const NX: usize>(problems: &[Problem<NX>]) -> Pass {
    pass(problems, Solver::Auto)
}

/// Clarabel on the sparse subproblem of each Gauss-Newton step, with the line search and the warm start of our SQP.
pub fn clarabel<const NX: usize>(problems: &[Problem<NX>]) -> Pass {
    pass(problems, Solver::Clarabel)
}

fn pass<const NX: usize>(problems: &[Problem<NX>], solver: Solver) -> Pass {
    let options = Options {
        solver,
        ..Options::default()
    };
    let mut mpc = Mpc::new(problems[0].horizon(), options);
    Pass::one_by_one(problems, |problem, u| {
        mpc.shift(1);
        let solution = mpc.solve(problem);
        u.clone_from(&solution.u);
        Solved {
            iterations: solution.iterations,
            is_solved: solution.is_solved(),
        }
    })
}
