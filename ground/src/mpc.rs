//! The planner's kernel: one tick's optimal control problem (eq 20 and its extensions) and its solution.
//!
//! Reading order: [`problem`] says what is solved, [`Mpc`] solves it: [`Mpc::solve`] is the one function that the command line,
//! the station and the simulator call. `sqp` iterates, each subproblem (`subproblem`) by the sweeps of `riccati` or by
//! `clarabel`; [`kkt_residual`] checks a solution from nothing but the point itself.

mod bounds;
mod clarabel;
pub mod dare;
mod kkt;
pub mod problem;
mod riccati;
mod solution;
mod sqp;
mod subproblem;

use self::clarabel::ClarabelQp;
pub use self::dare::terminal_weight;
pub use self::kkt::kkt_residual;
pub use self::problem::{FirstInput, HALF_PLANES_MAX, HalfPlane, Problem, ProblemError};
pub use self::solution::{Method, Refusal, Solution, Solver, Status, UnknownSolver};
use self::sqp::{Outcome, Quadratic, Sqp};

/// How to solve.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Options {
    /// Which solver. Default: [`Solver::Auto`].
    pub solver: Solver,
    /// Most SQP iterations from the rolled-out references. Default 100: the first tick converges.
    pub iterations_cold: u32,
    /// Most SQP iterations from the last solution, before the tick is solved from the references instead. Default 20.
    pub iterations_warm: u32,
    /// Most SQP iterations by Clarabel. Default 200: Gauss-Newton steps alone converge slowly far from the reference.
    pub iterations_clarabel: u32,
}

/// Solves one robot's problems, tick after tick, each from the last solution.
///
/// Allocates when it is built and at the first use of Clarabel, not in a solve by Riccati sweeps.
pub struct Mpc<const NX: usize> {
    options: Options,
    sqp: Sqp<NX>,
    clarabel: ClarabelQp<NX>,
    /// Whether `sqp` holds a solution to start from.
    warm: bool,
    solution: Solution<NX>,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            solver: Solver::Auto,
            iterations_cold: 100,
            iterations_warm: 20,
            iterations_clarabel: 200,
        }
    }
}

impl<const NX: usize> Mpc<NX> {
    /// Room for problems of `horizon` knots.
    pub fn new(horizon: usize, options: Options) -> Self {
        Self {
            options,
            sqp: Sqp::new(horizon),
            clarabel: ClarabelQp::new(),
            warm: false,
            solution: Solution::new(horizon),
        }
    }

    /// Forgets the last solution: the next solve starts from the references.
    pub fn reset(&mut self) {
        self.warm = false;
    }

    /// Moves the last solution on by `knots`, for a problem that begins as much later. Nothing to do after a failure.
    pub fn shift(&mut self, knots: usize) {
        if self.warm {
            self.sqp.shift(knots);
        }
    }

    /// Solves `problem`. Never panics: what cannot be solved is a [`Status`].
    ///
    /// A problem of another horizon than before makes new room. The solution stays readable until the next call.
    pub fn solve(&mut self, problem: &Problem<NX>) -> &Solution<NX> {
        if problem.horizon() != self.sqp.point.u.len() {
            self.sqp = Sqp::new(problem.horizon());
            self.warm = false;
        }
        self.solution.clear();
        if let Err(error) = problem.validate() {
            return self.refuse(error.into());
        }
        if self.options.solver == Solver::Riccati && problem.couples_inputs() {
            return self.refuse(Refusal::NeedsClarabel);
        }
        let outcome = self.attempt(problem);
        self.warm = outcome == Outcome::Converged;
        self.solution.status = match outcome {
            Outcome::Converged => Status::Solved,
            Outcome::Stalled => Status::MaxIterations,
            Outcome::Infeasible => Status::Infeasible,
        };
        if outcome != Outcome::Infeasible {
            if outcome == Outcome::Stalled {
                self.sqp.make_drivable(problem);
            }
            self.write_solution(problem);
        }
        &self.solution
    }

    /// The last solution.
    pub fn solution(&self) -> &Solution<NX> {
        &self.solution
    }

    /// From the last solution, then from the references, then by Clarabel: until one converges.
    fn attempt(&mut self, problem: &Problem<NX>) -> Outcome {
        let options = self.options;
        if options.solver != Solver::Clarabel && !problem.couples_inputs() {
            self.solution.method = Method::Riccati;
            if self.warm {
                self.sqp.start_warm(problem);
                if self.run_riccati(problem, options.iterations_warm) == Outcome::Converged {
                    return Outcome::Converged;
                }
            }
            self.sqp.start_cold(problem);
            let outcome = self.run_riccati(problem, options.iterations_cold);
            if outcome == Outcome::Converged || options.solver == Solver::Riccati {
                return outcome;
            }
            self.warm = false;
        }
        self.solution.method = Method::Clarabel;
        if self.warm {
            self.sqp.start_warm(problem);
            if self.run_clarabel(problem) == Outcome::Converged {
                return Outcome::Converged;
            }
        }
        self.sqp.start_cold(problem);
        self.run_clarabel(problem)
    }

    fn run_riccati(&mut self, problem: &Problem<NX>, iterations_max: u32) -> Outcome {
        let run = self.sqp.run(problem, Quadratic::Riccati, iterations_max);
        self.solution.iterations += run.iterations;
        run.outcome
    }

    fn run_clarabel(&mut self, problem: &Problem<NX>) -> Outcome {
        let quadratic = Quadratic::Clarabel(&mut self.clarabel);
        let run = self
            .sqp
            .run(problem, quadratic, self.options.iterations_clarabel);
        self.solution.iterations += run.iterations;
        if run.outcome == Outcome::Converged {
            self.sqp.close_gains(problem);
        }
        run.outcome
    }

    fn refuse(&mut self, refusal: Refusal) -> &Solution<NX> {
        self.warm = false;
        self.solution.status = Status::Refused;
        self.solution.refusal = Some(refusal);
        &self.solution
    }

    fn write_solution(&mut self, problem: &Problem<NX>) {
        let point = &self.sqp.point;
        let horizon = problem.horizon();
        let solution = &mut self.solution;
        solution.cost = subproblem::cost(problem, point);
        solution.u.extend_from_slice(&point.u);
        match problem.first_input {
            FirstInput::Decided => solution.x.extend_from_slice(&point.x),
            FirstInput::Measured => {
                solution.x.push(problem.x0);
                solution.x.extend_from_slice(&point.x[..horizon]);
            }
        }
        for k in 0..horizon {
            solution.gains.push(*self.sqp.gain(k));
        }
    }
}
