//! The project's own solver, alone and in a batch, and the same SQP with Clarabel under it.

use std::time::Instant;

use sphere_ground::mpc::{Batch, Effort, Mpc, Options, Problem, Solution, Solver, Tick};

use super::{Pass, Solved};

/// As the planner calls it: warm from the shifted last solution, converged.
pub fn converged<const NX: usize>(problems: &[Problem<NX>]) -> Pass {
    pass(problems, Options::default())
}

/// One iteration a tick, as a station does that is over its time.
pub fn real_time<const NX: usize>(problems: &[Problem<NX>]) -> Pass {
    pass(problems, one_iteration())
}

/// Eight robots at once, converged.
pub fn batch<const NX: usize>(problems: &[Problem<NX>]) -> Pass {
    together(problems, Options::default())
}

/// Eight robots at once, one iteration a tick.
pub fn batch_real_time<const NX: usize>(problems: &[Problem<NX>]) -> Pass {
    together(problems, one_iteration())
}

/// Clarabel on the sparse subproblem of each Gauss-Newton step, with the line search and the warm start of our SQP.
pub fn clarabel<const NX: usize>(problems: &[Problem<NX>]) -> Pass {
    let solver = Solver::Clarabel;
    pass(
        problems,
        Options {
            solver,
            ..Options::default()
        },
    )
}

fn one_iteration() -> Options {
    Options {
        effort: Effort::RealTime,
        ..Options::default()
    }
}

fn pass<const NX: usize>(problems: &[Problem<NX>], options: Options) -> Pass {
    let mut mpc = Mpc::new(problems[0].horizon(), options);
    Pass::one_by_one(problems, |problem, u| {
        mpc.shift(1);
        let solution = mpc.solve(problem);
        u.clone_from(&solution.u);
        solved(solution, options.effort)
    })
}

/// The recording in eight runs, one a robot, so that each instance is solved once; of a batch's time each robot has an eighth.
fn together<const NX: usize>(problems: &[Problem<NX>], options: Options) -> Pass {
    let run = problems.len().div_ceil(ROBOTS);
    let runs: Vec<&[Problem<NX>]> = problems.chunks(run).collect();
    let mut robots: Vec<Mpc<NX>> = (0..runs.len())
        .map(|robot| {
            let mut mpc = Mpc::new(problems[0].horizon(), options);
            // Warm from the instance before its run, as every other instance is.
            if let Some(before) = (robot * run).checked_sub(1) {
                mpc.solve(&problems[before]);
            }
            mpc
        })
        .collect();
    let mut batch = Batch::new();
    let mut found: Vec<Option<(f64, Solved, Vec<_>)>> = problems.iter().map(|_| None).collect();
    for tick in 0..run {
        let start = Instant::now();
        let mut ticks: Vec<Tick<'_, NX>> = robots
            .iter_mut()
            .zip(&runs)
            .filter_map(|(mpc, run)| {
                let problem = run.get(tick)?;
                mpc.shift(1);
                Some(Tick::new(mpc, problem))
            })
            .collect();
        let count = ticks.len();
        batch.solve(&mut ticks);
        drop(ticks);
        let time = 1e6 * start.elapsed().as_secs_f64() / count as f64;
        for (robot, mpc) in robots.iter().enumerate() {
            if runs[robot].get(tick).is_some() {
                let solution = mpc.solution();
                let outcome = solved(solution, options.effort);
                found[robot * run + tick] = Some((time, outcome, solution.u.clone()));
            }
        }
    }
    let mut pass = Pass::default();
    for (time, outcome, u) in found.into_iter().flatten() {
        pass.push(time, outcome, &u);
    }
    pass
}

/// One iteration is not to be optimal: it counts if there is a plan.
fn solved<const NX: usize>(solution: &Solution<NX>, effort: Effort) -> Solved {
    Solved {
        iterations: solution.iterations,
        is_solved: match effort {
            Effort::Converge => solution.is_solved(),
            Effort::RealTime => !solution.u.is_empty(),
        },
    }
}

const ROBOTS: usize = 8;
