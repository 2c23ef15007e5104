//! Sequential quadratic programming on the shooting problem.
//!
//! Each iteration linearises at the current point, solves the subproblem and steps as far as an L1 merit function allows. A
//! step uses the exact Hessian of the Lagrangian; where that leaves Q_uu indefinite, or the merit does not fall, it is a
//! Gauss-Newton step *in the same iteration*. Ends by iteration counts, never by wall time.

use nalgebra::{SVector, Vector2};

use super::bounds::{Bounds, Follow, roll_bounds};
use super::clarabel::{ClarabelError, ClarabelQp};
use super::fast;
use super::problem::{FirstInput, Problem};
use super::riccati::{Active, Riccati, RiccatiError};
use super::solution::Solution;
use super::subproblem::{Hessian, Point, Step, Subproblem, cost, first_state, state_gradient};

/// The iterate and the buffers of one problem size.
pub(super) struct Sqp<const NX: usize> {
    pub(super) point: Point<NX>,
    trial: Point<NX>,
    /// Costate of xₖ₊₁, N rows: whose curvature the exact Hessian has.
    lambda: Vec<SVector<f64, NX>>,
    bounds: Bounds,
    subproblem: Subproblem<NX>,
    step: Step<NX>,
    riccati: Riccati<NX>,
    /// Length of the last searched step.
    damping: f64,
}

/// How a run ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Run {
    pub(super) outcome: Outcome,
    pub(super) iterations: u32,
}

/// See [`Run`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Outcome {
    /// The last step was below the tolerance.
    Converged,
    /// It was not, or there was none.
    Stalled,
    /// Bounds contradict each other.
    Infeasible,
}

/// What solves the subproblems.
pub(super) enum Quadratic<'a, const NX: usize> {
    Riccati,
    Clarabel(&'a mut ClarabelQp<NX>),
}

enum StepError {
    None,
    Infeasible,
}

impl<const NX: usize> Sqp<NX> {
    pub(super) fn new(horizon: usize) -> Self {
        Self {
            point: Point::new(horizon),
            trial: Point::new(horizon),
            lambda: vec![SVector::zeros(); horizon],
            bounds: Bounds::new(horizon),
            subproblem: Subproblem::new(horizon),
            step: Step::new(horizon),
            riccati: Riccati::new(horizon),
            damping: 1.0,
        }
    }

    /// Starts from the reference inputs, rolled out.
    ///
    /// Never at rest: at v = 0 the roll steers nothing, its column of B vanishes, and rest beside the reference would pass for
    /// a solution. There the start creeps towards the last reference.
    pub(super) fn start_cold(&mut self, problem: &Problem<NX>) {
        let x0 = first_state(problem);
        let end = &problem.x_ref[problem.horizon() - 1];
        let (sin, cos) = x0[2].sin_cos();
        let ahead = (end[0] - x0[0]) * cos + (end[1] - x0[1]) * sin;
        let creep = if ahead < 0.0 { -CREEP } else { CREEP };
        for (k, u_ref) in problem.u_ref.iter().enumerate() {
            let v = if u_ref[0].abs() < CREEP {
                creep
            } else {
                u_ref[0]
            };
            self.point.u[k] = Vector2::new(
                v.clamp(problem.u_min[k][0], problem.u_max[k][0]),
                u_ref[1].clamp(problem.u_min[k][1], problem.u_max[k][1]),
            );
        }
        self.roll_out(problem);
        self.lambda.fill(SVector::zeros());
        self.riccati.active.fill([Active::Free; 2]);
        for planes in &mut self.subproblem.planes {
            planes.clear();
        }
    }

    /// Starts from the last solution as it stands.
    pub(super) fn start_warm(&mut self, problem: &Problem<NX>) {
        // A heading is the same after a turn, the plan must be near the one given.
        let turn = core::f64::consts::TAU;
        let x0 = first_state(problem);
        let turns = ((x0[2] - self.point.x[0][2]) / turn).round() * turn;
        if turns != 0.0 {
            for x in &mut self.point.x {
                x[2] += turns;
            }
        }
        self.point.x[0] = x0;
    }

    /// Moves the last point, its costates and active sets on by `knots`; its last input is held.
    pub(super) fn shift(&mut self, knots: usize) {
        shift_rows(&mut self.point.x, knots);
        shift_rows(&mut self.point.u, knots);
        let horizon = self.point.u.len();
        let knots = knots.min(horizon);
        shift_rows(&mut self.lambda, knots);
        shift_rows(&mut self.riccati.active, knots);
        let planes = &mut self.subproblem.planes;
        planes.rotate_left(knots);
        for row in &mut planes[horizon + 1 - knots..] {
            row.clear();
        }
    }

    /// Starts from a `solution` that was found elsewhere, moved on by `knots`: costates are the adjoint of the point, active the bounds
    /// that it lies on. As many rows as the problem's are asked for.
    pub(super) fn adopt_point(
        &mut self,
        problem: &Problem<NX>,
        solution: &Solution<NX>,
        knots: usize,
    ) {
        let (point, horizon) = (&mut self.point, problem.horizon());
        point.u.copy_from_slice(&solution.u);
        match problem.first_input {
            FirstInput::Decided => point.x.copy_from_slice(&solution.x),
            FirstInput::Measured => {
                point.x[..horizon].copy_from_slice(&solution.x[1..]);
                point.x[horizon] =
                    fast::step(problem, &point.x[horizon - 1], &point.u[horizon - 1]);
            }
        }
        shift_rows(&mut point.x, knots);
        shift_rows(&mut point.u, knots);
        let mut lambda = SVector::zeros();
        for k in (0..self.point.u.len()).rev() {
            lambda += state_gradient(problem, k + 1, &self.point.x[k + 1]);
            self.lambda[k] = lambda;
            let (x, u) = (&self.point.x[k], &self.point.u[k]);
            lambda = problem.model.linearise(x, u).a.tr_mul(&lambda);
            let (min, max) = roll_bounds(problem, &self.point, k);
            let bounds = [(problem.u_min[k][0], problem.u_max[k][0]), (min, max)];
            for (j, (min, max)) in bounds.into_iter().enumerate() {
                self.riccati.active[k][j] = if u[j] <= min {
                    Active::Lower
                } else if u[j] >= max {
                    Active::Upper
                } else {
                    Active::Free
                };
            }
        }
        for planes in &mut self.subproblem.planes {
            planes.clear();
        }
    }

    /// Iterates from the current point.
    pub(super) fn run(
        &mut self,
        problem: &Problem<NX>,
        mut quadratic: Quadratic<'_, NX>,
        iterations_max: u32,
    ) -> Run {
        self.damping = 1.0;
        for iteration in 1..=iterations_max {
            let run = |outcome| Run {
                outcome,
                iterations: iteration,
            };
            let missed = self
                .bounds
                .refresh(problem, &self.point, Follow::at(iteration));
            if self.bounds.restrict(problem, &mut self.point).is_err() {
                return run(Outcome::Infeasible);
            }
            self.subproblem.fill(
                problem,
                &self.point,
                &self.lambda,
                &self.bounds.lower,
                &self.bounds.upper,
            );
            let (size, tolerance) = match self.advance(problem, &mut quadratic) {
                Ok(done) => done,
                Err(StepError::Infeasible) => return run(Outcome::Infeasible),
                Err(StepError::None) => return run(Outcome::Stalled),
            };
            if size <= tolerance && missed <= BOUNDS_SETTLED {
                return run(Outcome::Converged);
            }
        }
        Run {
            outcome: Outcome::Stalled,
            iterations: iterations_max,
        }
    }

    /// Makes a point that did not converge drivable: inputs within bounds, states rolled out from them.
    pub(super) fn make_drivable(&mut self, problem: &Problem<NX>) {
        self.bounds.refresh(problem, &self.point, Follow::Fully);
        // Feasibility was settled when the run began; an input that is not finite falls back to its bound or reference.
        for (u, u_ref) in self.point.u.iter_mut().zip(&problem.u_ref) {
            for j in 0..2 {
                if !u[j].is_finite() {
                    u[j] = u_ref[j];
                }
            }
        }
        let _ = self.bounds.restrict(problem, &mut self.point);
        self.roll_out(problem);
    }

    /// Feedback gains around the point, with the active set of the point: for steps that Clarabel made.
    pub(super) fn close_gains(&mut self, problem: &Problem<NX>) {
        self.subproblem.fill(
            problem,
            &self.point,
            &self.lambda,
            &self.bounds.lower,
            &self.bounds.upper,
        );
        for (active, stage) in self.riccati.active.iter_mut().zip(&self.subproblem.stages) {
            for (j, active) in active.iter_mut().enumerate() {
                *active = if stage.du_min[j] > -AT_BOUND {
                    Active::Lower
                } else if stage.du_max[j] < AT_BOUND {
                    Active::Upper
                } else {
                    Active::Free
                };
            }
        }
        for plane in self.subproblem.planes.iter_mut().flatten() {
            plane.active = plane.gap < 0.0;
        }
        let _ = self
            .riccati
            .backward(&self.subproblem, Hessian::GaussNewton);
    }

    /// Feedback gain of knot `k` in the last subproblem.
    pub(super) fn gain(&self, k: usize) -> &nalgebra::SMatrix<f64, 2, NX> {
        self.riccati.gain(k)
    }

    fn roll_out(&mut self, problem: &Problem<NX>) {
        self.point.x[0] = first_state(problem);
        for k in 0..self.point.u.len() {
            self.point.x[k + 1] = problem.model.step(&self.point.x[k], &self.point.u[k]);
        }
    }

    /// Solves the subproblem and takes its step. Returns the step's size and the size that counts as converged.
    fn advance(
        &mut self,
        problem: &Problem<NX>,
        quadratic: &mut Quadratic<'_, NX>,
    ) -> Result<(f64, f64), StepError> {
        let hessians: &[Hessian] = match quadratic {
            Quadratic::Riccati => &[Hessian::Exact, Hessian::GaussNewton],
            Quadratic::Clarabel(_) => &[Hessian::GaussNewton],
        };
        for &hessian in hessians {
            let found = match quadratic {
                Quadratic::Riccati => self.solve_by_riccati(hessian),
                Quadratic::Clarabel(clarabel) => clarabel
                    .solve(problem, &self.point, &self.subproblem, &mut self.step)
                    .map_err(|error| match error {
                        ClarabelError::Infeasible => StepError::Infeasible,
                        ClarabelError::Failed => StepError::None,
                    }),
            };
            match found {
                Ok(()) => {}
                Err(StepError::None) => continue,
                Err(error) => return Err(error),
            }
            let size = self.step.size();
            if !self.take(problem, hessian, size) {
                continue;
            }
            let tolerance = match (hessian, quadratic) {
                (Hessian::Exact, _) => STEP_EXACT,
                (_, Quadratic::Riccati) => STEP_GAUSS_NEWTON,
                (_, Quadratic::Clarabel(_)) => STEP_CLARABEL,
            };
            return Ok((size, tolerance));
        }
        Err(StepError::None)
    }

    /// Goes along a step of `size` as far as is good; whether that is anywhere.
    fn take(&mut self, problem: &Problem<NX>, hessian: Hessian, size: f64) -> bool {
        let alpha = if size <= FULL_STEP {
            let alpha = if hessian == Hessian::Exact {
                1.0
            } else {
                self.damping
            };
            self.take_linear(alpha);
            alpha
        } else if size.is_finite() {
            let armijo = if hessian == Hessian::GaussNewton {
                ARMIJO
            } else {
                ARMIJO_EXACT
            };
            let Some(alpha) = self.search(problem, armijo) else {
                return false;
            };
            core::mem::swap(&mut self.point, &mut self.trial);
            self.damping = alpha;
            alpha
        } else {
            return false;
        };
        for (lambda, target) in self.lambda.iter_mut().zip(&self.step.lambda) {
            *lambda += (target - *lambda) * alpha;
        }
        true
    }

    fn solve_by_riccati(&mut self, hessian: Hessian) -> Result<(), StepError> {
        let mut solved = self
            .riccati
            .solve(&mut self.subproblem, hessian, &mut self.step);
        if solved == Err(RiccatiError::Cycling) {
            // From the empty set, once: a stale one may lie far from the solution's.
            self.riccati.active.fill([Active::Free; 2]);
            for plane in self.subproblem.planes.iter_mut().flatten() {
                plane.active = plane.gap < 0.0;
            }
            solved = self
                .riccati
                .solve(&mut self.subproblem, hessian, &mut self.step);
        }
        solved.map_err(|_| StepError::None)
    }

    /// Length of the step by backtracking on φ = cost + μ Σ|F(xₖ, uₖ) − xₖ₊₁|₁ with Armijo's condition; `trial` is then the
    /// point that met it.
    ///
    /// Trial states are rolled out from the trial inputs and so miss nothing. States on the linearised dynamics would miss by
    /// the square of the step, which at a saddle outweighs all that a step can gain (the Maratos effect): there no step of
    /// useful length is accepted.
    fn search(&mut self, problem: &Problem<NX>, armijo: f64) -> Option<f64> {
        // Exact penalty: μ above every multiplier of the dynamics.
        let mu = 1.1 * self.step.costate_size() + 1e-3;
        if !mu.is_finite() {
            return None;
        }
        let missed: f64 = self
            .subproblem
            .stages
            .iter()
            .map(|stage| stage.c.lp_norm(1))
            .sum();
        let start = cost(problem, &self.point) + mu * missed;
        let slope = self.slope(problem) - mu * missed;
        let mut alpha = 1.0;
        while alpha >= ALPHA_MIN {
            self.trial.x[0] = self.point.x[0];
            for k in 0..self.trial.u.len() {
                self.trial.u[k] = self.input_after(k, alpha);
                self.trial.x[k + 1] = problem.model.step(&self.trial.x[k], &self.trial.u[k]);
            }
            if cost(problem, &self.trial) <= start + armijo * alpha * slope + 1e-14 * start.abs() {
                return Some(alpha);
            }
            alpha *= 0.5;
        }
        None
    }

    /// Slope of the cost along the step.
    fn slope(&self, problem: &Problem<NX>) -> f64 {
        let mut slope = 0.0;
        for (k, stage) in self.subproblem.stages.iter().enumerate() {
            let dx = &self.step.dx[k + 1];
            slope +=
                stage.u_gradient.dot(&self.step.du[k]) + self.subproblem.x_gradient[k + 1].dot(dx);
            for plane in &self.subproblem.planes[k + 1] {
                let inwards = plane.normal[0] * dx[0] + plane.normal[1] * dx[1];
                slope += plane.weight * plane.gap.min(0.0) * inwards;
            }
        }
        let (mut before, mut du_before) = (problem.u_prev, Vector2::zeros());
        for (u, du) in self.point.u.iter().zip(&self.step.du) {
            let change = (u - before).component_mul(&problem.r_rate) * 2.0;
            slope += change.dot(&(du - du_before));
            (before, du_before) = (*u, *du);
        }
        slope
    }

    /// Input `k` after a share `alpha` of the step.
    fn input_after(&self, k: usize, alpha: f64) -> Vector2<f64> {
        let u = self.point.u[k] + self.step.du[k] * alpha;
        // A held input lies on its bound, not beside it by rounding.
        u.zip_zip_map(
            &self.bounds.lower[k],
            &self.bounds.upper[k],
            |u, lower, upper| u.min(upper).max(lower),
        )
    }

    fn take_linear(&mut self, alpha: f64) {
        for k in 0..self.point.u.len() {
            self.point.u[k] = self.input_after(k, alpha);
            self.point.x[k + 1] += self.step.dx[k + 1] * alpha;
        }
    }
}

/// Moves rows to the front by `knots` and repeats the last one.
fn shift_rows<T: Copy>(rows: &mut [T], knots: usize) {
    let knots = knots.min(rows.len());
    let Some(last) = rows.last().copied() else {
        return;
    };
    rows.copy_within(knots.., 0);
    let kept = rows.len() - knots;
    rows[kept..].fill(last);
}

/// Speed of the cold start where the reference rests [m/s].
const CREEP: f64 = 0.1;
/// How far bounds that follow the speed may be from them [rad].
const BOUNDS_SETTLED: f64 = 1e-9;
/// Steps up to this size [m, rad, m/s] are not searched, their effect on the cost drowns in rounding: an exact one is taken
/// whole, a Gauss-Newton step by the length of the last search.
const FULL_STEP: f64 = 1e-4;
/// A converged exact step: the error it leaves is of the order of its square [m, rad, m/s].
const STEP_EXACT: f64 = 1e-7;
/// A converged Gauss-Newton step, which leaves an error of its own order.
const STEP_GAUSS_NEWTON: f64 = 1e-10;
/// A converged step by Clarabel, whose own tolerance is 1e-10.
const STEP_CLARABEL: f64 = 1e-8;
/// Share of the predicted decrease that an exact step must reach.
const ARMIJO_EXACT: f64 = 1e-4;
/// The same for a Gauss-Newton step: enough to shorten one that overshoots, where the curvature left out is as large as the
/// weights. Such a step would else swing about the solution.
const ARMIJO: f64 = 0.25;
/// Shortest step tried.
const ALPHA_MIN: f64 = 1e-3;
/// Distance at which an input counts as held by its bound [m/s, rad]: what Clarabel leaves.
const AT_BOUND: f64 = 1e-6;
