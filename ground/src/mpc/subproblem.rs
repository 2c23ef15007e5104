//! The linear-quadratic subproblem of one SQP iteration, in steps (δx, δu) from the current point.
//!
//! ```text
//! min Σₖ ½ δxₖᵀ(Wₖ + [Cxx]) δxₖ + δuₖᵀ[Cux] δxₖ + ½ δuₖᵀ(2R + [Cuu]) δuₖ + wₖᵀδxₖ + rₖᵀδuₖ + ½ Σ_h 2w_h min(0, gap + nᵀδ(X, Y))²
//! s.t. δxₖ₊₁ = A δxₖ + B δuₖ + c,  δx₀ = 0,  lower − u ≤ δu ≤ upper − u
//! ```
//!
//! W is 2Q, 2P or 0. The curvature C in brackets is used by an exact step and left out by a Gauss-Newton step.
//!
//! Both kinds of [`FirstInput`] become this one problem of N stages: with a measured first input it begins at x₁ = F(x₀, u_prev),
//! and its last state, x_N₊₁, weighs nothing.

use arrayvec::ArrayVec;
use nalgebra::{SMatrix, SVector, Vector2};

use super::problem::{FirstInput, HALF_PLANES_MAX, Problem};
use crate::kinematics::Curvature;

/// A point of the shooting problem: N + 1 states, the first one fixed, and N inputs.
#[derive(Clone, Debug)]
pub(super) struct Point<const NX: usize> {
    pub(super) x: Vec<SVector<f64, NX>>,
    pub(super) u: Vec<Vector2<f64>>,
}

/// One stage, linearised.
#[derive(Clone, Debug)]
pub(super) struct Stage<const NX: usize> {
    pub(super) a: SMatrix<f64, NX, NX>,
    pub(super) b: SMatrix<f64, NX, 2>,
    /// What the dynamics miss at the point, F(xₖ, uₖ) − xₖ₊₁.
    pub(super) c: SVector<f64, NX>,
    pub(super) curvature: Curvature<NX>,
    /// Gradient of the cost by uₖ, without coupling to other inputs.
    pub(super) u_gradient: Vector2<f64>,
    /// Bounds of δuₖ.
    pub(super) du_min: Vector2<f64>,
    pub(super) du_max: Vector2<f64>,
}

/// A soft half-plane seen from the point.
#[derive(Clone, Copy, Debug)]
pub(super) struct Plane {
    pub(super) normal: [f64; 2],
    /// nᵀ(X, Y) − b at the point [m], < 0 inside the forbidden side.
    pub(super) gap: f64,
    /// 2w.
    pub(super) weight: f64,
    /// Whether the active set counts it as violated at the end of the step.
    pub(super) active: bool,
}

/// The whole subproblem. Filled in place for every iteration.
#[derive(Clone, Debug)]
pub(super) struct Subproblem<const NX: usize> {
    pub(super) stages: Vec<Stage<NX>>,
    /// Gradient of the cost by xₖ without half-planes, N + 1 rows, the first unused.
    pub(super) x_gradient: Vec<SVector<f64, NX>>,
    /// Half-planes of xₖ, N + 1 rows, the first unused.
    pub(super) planes: Vec<ArrayVec<Plane, HALF_PLANES_MAX>>,
    /// 2Q, diagonal.
    pub(super) weight: SVector<f64, NX>,
    /// 2P.
    pub(super) terminal: SMatrix<f64, NX, NX>,
    /// The state that P weighs: N, or N − 1 if the first input is measured. Later states weigh nothing.
    pub(super) last: usize,
    /// 2R, diagonal.
    pub(super) input_weight: Vector2<f64>,
}

/// Which Hessian of the Lagrangian a step uses.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Hessian {
    /// With the curvature of the dynamics.
    Exact,
    /// Without the curvature: never indefinite.
    GaussNewton,
}

/// The solution of a subproblem, from whichever solver.
#[derive(Clone, Debug)]
pub(super) struct Step<const NX: usize> {
    /// N + 1 rows, the first one zero.
    pub(super) dx: Vec<SVector<f64, NX>>,
    /// N rows.
    pub(super) du: Vec<Vector2<f64>>,
    /// Costate of xₖ₊₁, N rows.
    pub(super) lambda: Vec<SVector<f64, NX>>,
}

impl<const NX: usize> Stage<NX> {
    /// M A. A is the identity but for column φ above the diagonal, and for the columns of v and q: half of a product's work.
    pub(super) fn times_a(&self, m: &SMatrix<f64, NX, NX>) -> SMatrix<f64, NX, NX> {
        let mut product = *m;
        for i in 0..NX {
            product[(i, 2)] += self.a[(0, 2)] * m[(i, 0)] + self.a[(1, 2)] * m[(i, 1)];
            for j in 3..NX {
                product[(i, j)] = self.a[(0, j)] * m[(i, 0)]
                    + self.a[(1, j)] * m[(i, 1)]
                    + self.a[(2, j)] * m[(i, 2)]
                    + self.a[(j, j)] * m[(i, j)];
            }
        }
        product
    }

    /// Aᵀ M, alike.
    pub(super) fn a_transposed_times(&self, m: &SMatrix<f64, NX, NX>) -> SMatrix<f64, NX, NX> {
        let mut product = *m;
        for i in 0..NX {
            product[(2, i)] += self.a[(0, 2)] * m[(0, i)] + self.a[(1, 2)] * m[(1, i)];
            for j in 3..NX {
                product[(j, i)] = self.a[(0, j)] * m[(0, i)]
                    + self.a[(1, j)] * m[(1, i)]
                    + self.a[(2, j)] * m[(2, i)]
                    + self.a[(j, j)] * m[(j, i)];
            }
        }
        product
    }
}

impl<const NX: usize> Point<NX> {
    pub(super) fn new(horizon: usize) -> Self {
        Self {
            x: vec![SVector::zeros(); horizon + 1],
            u: vec![Vector2::zeros(); horizon],
        }
    }
}

impl<const NX: usize> Step<NX> {
    pub(super) fn new(horizon: usize) -> Self {
        Self {
            dx: vec![SVector::zeros(); horizon + 1],
            du: vec![Vector2::zeros(); horizon],
            lambda: vec![SVector::zeros(); horizon],
        }
    }

    /// Largest element of the step; infinite if any is not finite.
    pub(super) fn size(&self) -> f64 {
        let mut size = 0.0;
        for dx in &self.dx {
            size = dx.iter().fold(size, larger);
        }
        for du in &self.du {
            size = du.iter().fold(size, larger);
        }
        size
    }

    /// Largest costate; infinite if any is not finite.
    pub(super) fn costate_size(&self) -> f64 {
        self.lambda
            .iter()
            .fold(0.0, |size, lambda| lambda.iter().fold(size, larger))
    }
}

impl<const NX: usize> Subproblem<NX> {
    pub(super) fn new(horizon: usize) -> Self {
        let stage = Stage {
            a: SMatrix::zeros(),
            b: SMatrix::zeros(),
            c: SVector::zeros(),
            curvature: Curvature::zeros(),
            u_gradient: Vector2::zeros(),
            du_min: Vector2::zeros(),
            du_max: Vector2::zeros(),
        };
        Self {
            stages: vec![stage; horizon],
            x_gradient: vec![SVector::zeros(); horizon + 1],
            planes: vec![ArrayVec::new(); horizon + 1],
            weight: SVector::zeros(),
            terminal: SMatrix::zeros(),
            last: horizon,
            input_weight: Vector2::zeros(),
        }
    }

    /// Linearises `problem` at `point`; the curvature is that of the costates `lambda`. Keeps the half-planes' active set.
    pub(super) fn fill(
        &mut self,
        problem: &Problem<NX>,
        point: &Point<NX>,
        lambda: &[SVector<f64, NX>],
        lower: &[Vector2<f64>],
        upper: &[Vector2<f64>],
    ) {
        self.weight = problem.q * 2.0;
        self.terminal = problem.p_terminal * 2.0;
        self.last = last_weighed(problem);
        self.input_weight = problem.r * 2.0;
        for (k, stage) in self.stages.iter_mut().enumerate() {
            let (x, u) = (&point.x[k], &point.u[k]);
            let (linearised, curvature) = problem.model.expand(x, u, &lambda[k]);
            stage.a = linearised.a;
            stage.b = linearised.b;
            stage.c = linearised.next - point.x[k + 1];
            stage.curvature = curvature;
            stage.u_gradient = (u - problem.u_ref[k]).component_mul(&self.input_weight);
            stage.du_min = lower[k] - u;
            stage.du_max = upper[k] - u;
        }
        for k in 1..point.x.len() {
            self.x_gradient[k] = state_gradient(problem, k, &point.x[k]);
            self.fill_planes(problem, k, &point.x[k]);
        }
    }

    fn fill_planes(&mut self, problem: &Problem<NX>, k: usize, x: &SVector<f64, NX>) {
        let Some(row) = state_row(problem, k) else {
            self.planes[k].clear();
            return;
        };
        let given = problem.half_planes_at(row);
        let planes = &mut self.planes[k];
        planes.truncate(given.len());
        for (i, half_plane) in given.iter().enumerate() {
            let gap = half_plane.gap(x[0], x[1]);
            // One that is new begins as the point has it; a known one as the last active set has it.
            let active = planes.get(i).map_or(gap < 0.0, |plane| plane.active);
            let plane = Plane {
                normal: half_plane.normal,
                gap,
                weight: 2.0 * half_plane.weight,
                active,
            };
            match planes.get_mut(i) {
                Some(place) => *place = plane,
                None => planes.push(plane),
            }
        }
    }
}

/// The row of references that belongs to state `k` of the shooting problem, if it has one.
pub(super) fn state_row<const NX: usize>(problem: &Problem<NX>, k: usize) -> Option<usize> {
    match problem.first_input {
        FirstInput::Decided => k.checked_sub(1),
        FirstInput::Measured => (k < problem.horizon()).then_some(k),
    }
}

/// The state of the shooting problem that P weighs.
pub(super) fn last_weighed<const NX: usize>(problem: &Problem<NX>) -> usize {
    match problem.first_input {
        FirstInput::Decided => problem.horizon(),
        FirstInput::Measured => problem.horizon() - 1,
    }
}

/// The first state of the shooting problem: x₀, or x₁ = F(x₀, u_prev) if the first input is measured.
pub(super) fn first_state<const NX: usize>(problem: &Problem<NX>) -> SVector<f64, NX> {
    match problem.first_input {
        FirstInput::Decided => problem.x0,
        FirstInput::Measured => problem.model.step(&problem.x0, &problem.u_prev),
    }
}

/// Gradient of the cost by state `k` of the shooting problem, without half-planes.
pub(super) fn state_gradient<const NX: usize>(
    problem: &Problem<NX>,
    k: usize,
    x: &SVector<f64, NX>,
) -> SVector<f64, NX> {
    let Some(row) = state_row(problem, k) else {
        return SVector::zeros();
    };
    let error = x - problem.x_ref[row];
    if k == last_weighed(problem) {
        problem.p_terminal * error * 2.0
    } else {
        problem.q.component_mul(&error) * 2.0
    }
}

/// Cost of a point, with all terms of the problem (that of a fixed first state too).
pub(super) fn cost<const NX: usize>(problem: &Problem<NX>, point: &Point<NX>) -> f64 {
    let last = last_weighed(problem);
    let mut cost = 0.0;
    for (k, x) in point.x.iter().enumerate() {
        let Some(row) = state_row(problem, k) else {
            continue;
        };
        let error = x - problem.x_ref[row];
        cost += if k == last {
            error.dot(&(problem.p_terminal * error))
        } else {
            error.component_mul(&error).dot(&problem.q)
        };
        for half_plane in problem.half_planes_at(row) {
            let gap = half_plane.gap(x[0], x[1]).min(0.0);
            cost += half_plane.weight * gap * gap;
        }
    }
    for (u, u_ref) in point.u.iter().zip(&problem.u_ref) {
        let error = u - u_ref;
        cost += error.component_mul(&error).dot(&problem.r);
    }
    if problem.r_rate != Vector2::zeros() {
        let mut before = &problem.u_prev;
        for u in &point.u {
            let change = u - before;
            cost += change.component_mul(&change).dot(&problem.r_rate);
            before = u;
        }
    }
    cost
}

/// max(size, |value|), infinite if `value` is not finite: `f64::max` would drop a NaN.
fn larger(size: f64, value: &f64) -> f64 {
    if value.is_finite() {
        size.max(value.abs())
    } else {
        f64::INFINITY
    }
}
