//! The planner's kernel: one tick's optimal control problem (eq 20 and its extensions) and its solution.
//!
//! Reading order: [`problem`] says what is solved, [`Mpc`] solves it: [`Mpc::solve`] is the one function that the command line,
//! the station and the simulator call. `sqp` iterates, each subproblem (`subproblem`) by the sweeps of `riccati` or by
//! `clarabel`; [`kkt_residual`] checks a solution from nothing but the point itself.

mod bounds;
mod clarabel;
pub mod dare;
mod fast;
mod kkt;
pub mod problem;
mod riccati;
mod solution;
mod sqp;
mod subproblem;

use self::clarabel::ClarabelQp;
pub use self::dare::terminal_weight;
use self::fast::Alone;
pub use self::fast::{Batch, InstructionSet, Tick};
pub use self::kkt::kkt_residual;
pub use self::problem::{FirstInput, HALF_PLANES_MAX, HalfPlane, Problem, ProblemError};
pub use self::solution::{Method, Path, Refusal, Solution, Solver, Status, UnknownSolver};
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
    /// How far a warm tick is taken. Default [`Effort::Converge`].
    pub effort: Effort,
}

/// How far a warm tick is taken.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Effort {
    /// To the optimum.
    #[default]
    Converge,
    /// The real-time iteration: one exact step from the last solution. Its inputs are within their bounds and its states obey the
    /// dynamics; the status is [`Status::MaxIterations`] unless the step was so small that the point is optimal. In tracking
    /// the ticks converge together with the robot. A tick that the fast path cannot step from is solved as with `Converge`.
    RealTime,
}

/// Solves one robot's problems, tick after tick, each from the last solution.
///
/// Allocates when it is built, at the first search and at the first use of Clarabel; no other solve does.
pub struct Mpc<const NX: usize> {
    options: Options,
    horizon: usize,
    /// Whether `solution` is one to start from.
    is_warm: bool,
    /// Whether `robust.sqp` has that solution as its point, with costates and active sets: not after a tick on the fast path.
    is_adopted: bool,
    /// Knots by which the problem has moved on since the solution.
    shifted: usize,
    solution: Solution<NX>,
    /// Apart, for a thousand robots' solutions to lie close together.
    robust: Option<Box<Robust<NX>>>,
}

/// Scratch space and memory of the solvers that search, and scratch space of the fast path for this robot alone.
struct Robust<const NX: usize> {
    sqp: Sqp<NX>,
    clarabel: ClarabelQp<NX>,
    alone: Alone<NX>,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            solver: Solver::Auto,
            iterations_cold: 100,
            iterations_warm: 20,
            iterations_clarabel: 200,
            effort: Effort::Converge,
        }
    }
}

impl<const NX: usize> Mpc<NX> {
    /// Room for problems of `horizon` knots.
    pub fn new(horizon: usize, options: Options) -> Self {
        Self {
            options,
            horizon,
            is_warm: false,
            is_adopted: true,
            shifted: 0,
            solution: Solution::new(horizon),
            robust: None,
        }
    }

    /// How far later ticks are taken.
    pub fn set_effort(&mut self, effort: Effort) {
        self.options.effort = effort;
    }

    /// Forgets the last solution: the next solve starts from the references.
    pub fn reset(&mut self) {
        self.is_warm = false;
    }

    /// Moves the last solution on by `knots`, for a problem that begins as much later. Nothing to do after a failure.
    pub fn shift(&mut self, knots: usize) {
        if self.is_warm {
            if self.is_adopted
                && let Some(robust) = &mut self.robust
            {
                robust.sqp.shift(knots);
            }
            self.shifted = self.shifted.saturating_add(knots);
        }
    }

    /// Solves `problem`. Never panics: what cannot be solved is a [`Status`].
    ///
    /// A problem of another horizon than before makes new room. The solution stays readable until the next call.
    pub fn solve(&mut self, problem: &Problem<NX>) -> &Solution<NX> {
        self.prepare(problem);
        self.solve_prepared(problem);
        &self.solution
    }

    /// Room for `problem`.
    fn prepare(&mut self, problem: &Problem<NX>) {
        if problem.horizon() != self.horizon {
            self.horizon = problem.horizon();
            self.robust = None;
            self.is_warm = false;
        }
    }

    fn solve_prepared(&mut self, problem: &Problem<NX>) {
        if self.may_be_fast(problem) {
            self.solve_alone(problem);
        } else {
            self.search(problem, 0);
        }
    }

    /// Solves `problem` by the searching SQP, after `iterations` on the fast path.
    fn search(&mut self, problem: &Problem<NX>, iterations: u32) {
        let mut refusal = problem.validate().err().map(Refusal::from);
        if self.options.solver == Solver::Riccati && problem.couples_inputs() {
            refusal = refusal.or(Some(Refusal::NeedsClarabel));
        }
        if let Some(refusal) = refusal {
            self.begin_search(iterations);
            self.is_warm = false;
            self.solution.status = Status::Refused;
            self.solution.refusal = Some(refusal);
            return;
        }
        let mut robust = self
            .robust
            .take()
            .unwrap_or_else(|| Box::new(Robust::new(self.horizon)));
        if self.is_warm && !self.is_adopted {
            robust
                .sqp
                .adopt_point(problem, &self.solution, self.shifted);
        }
        self.begin_search(iterations);
        self.is_adopted = true;
        self.shifted = 0;
        let outcome = self.attempt(&mut robust, problem);
        self.is_warm = outcome == Outcome::Converged;
        self.solution.status = match outcome {
            Outcome::Converged => Status::Solved,
            Outcome::Stalled => Status::MaxIterations,
            Outcome::Infeasible => Status::Infeasible,
        };
        if self.solution.method == Method::Clarabel {
            self.solution.path = Path::Clarabel;
        }
        if outcome != Outcome::Infeasible {
            if outcome == Outcome::Stalled {
                robust.sqp.make_drivable(problem);
            }
            self.write_solution(&robust.sqp, problem);
        }
        self.robust = Some(robust);
    }

    /// No solution yet, after `iterations` on the fast path.
    fn begin_search(&mut self, iterations: u32) {
        self.solution.clear();
        self.solution.iterations = iterations;
        self.solution.path = Path::Searched;
    }

    /// The last solution.
    pub fn solution(&self) -> &Solution<NX> {
        &self.solution
    }

    /// From the last solution, then from the references, then by Clarabel: until one converges.
    fn attempt(&mut self, robust: &mut Robust<NX>, problem: &Problem<NX>) -> Outcome {
        let options = self.options;
        if options.solver != Solver::Clarabel && !problem.couples_inputs() {
            self.solution.method = Method::Riccati;
            if self.is_warm {
                robust.sqp.start_warm(problem);
                if self.run_riccati(robust, problem, options.iterations_warm) == Outcome::Converged
                {
                    return Outcome::Converged;
                }
            }
            robust.sqp.start_cold(problem);
            let outcome = self.run_riccati(robust, problem, options.iterations_cold);
            if outcome == Outcome::Converged || options.solver == Solver::Riccati {
                return outcome;
            }
            self.is_warm = false;
        }
        self.solution.method = Method::Clarabel;
        if self.is_warm {
            robust.sqp.start_warm(problem);
            if self.run_clarabel(robust, problem) == Outcome::Converged {
                return Outcome::Converged;
            }
        }
        robust.sqp.start_cold(problem);
        self.run_clarabel(robust, problem)
    }

    fn run_riccati(
        &mut self,
        robust: &mut Robust<NX>,
        problem: &Problem<NX>,
        iterations_max: u32,
    ) -> Outcome {
        let run = robust.sqp.run(problem, Quadratic::Riccati, iterations_max);
        self.solution.iterations += run.iterations;
        run.outcome
    }

    fn run_clarabel(&mut self, robust: &mut Robust<NX>, problem: &Problem<NX>) -> Outcome {
        let quadratic = Quadratic::Clarabel(&mut robust.clarabel);
        let run = robust
            .sqp
            .run(problem, quadratic, self.options.iterations_clarabel);
        self.solution.iterations += run.iterations;
        if run.outcome == Outcome::Converged {
            robust.sqp.close_gains(problem);
        }
        run.outcome
    }

    fn write_solution(&mut self, sqp: &Sqp<NX>, problem: &Problem<NX>) {
        let (point, solution) = (&sqp.point, &mut self.solution);
        solution.cost = subproblem::cost(problem, point);
        for k in 0..problem.horizon() {
            solution.gains.push(*sqp.gain(k));
        }
        solution.u.extend_from_slice(&point.u);
        match problem.first_input {
            FirstInput::Decided => solution.x.extend_from_slice(&point.x),
            FirstInput::Measured => {
                solution.x.push(problem.x0);
                solution.x.extend_from_slice(&point.x[..problem.horizon()]);
            }
        }
    }
}

impl<const NX: usize> Robust<NX> {
    fn new(horizon: usize) -> Self {
        Self {
            sqp: Sqp::new(horizon),
            clarabel: ClarabelQp::new(),
            alone: Alone::new(horizon),
        }
    }
}
