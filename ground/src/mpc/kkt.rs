//! First-order optimality of a point, recomputed from the point alone.
//!
//! Multipliers of the dynamics come from the backward adjoint recursion, those of the bounds from which bounds the point lies
//! on: nothing of the solver's own state is trusted.

use nalgebra::{SVector, Vector2};

use super::bounds::roll_bounds;
use super::problem::{FirstInput, Problem};
use super::subproblem::{Point, first_state, state_gradient, state_row};

/// Largest violation of the first-order conditions of `problem` at states `x` (N + 1 rows) and decided inputs `u` (N rows), ∞-norm.
///
/// The largest of: what the dynamics miss; the excess over a bound; and, for each input, the part of the Lagrangian's gradient
/// that no multiplier of the right sign on a bound within 1e-6 can cancel, or the distance to that bound where it is less.
/// Bounds from a turn limit count as constants. Infinite for wrong numbers of rows and for values that are not finite.
pub fn kkt_residual<const NX: usize>(
    problem: &Problem<NX>,
    x: &[SVector<f64, NX>],
    u: &[Vector2<f64>],
) -> f64 {
    let horizon = problem.horizon();
    if problem.validate().is_err() || x.len() != horizon + 1 || u.len() != horizon {
        return f64::INFINITY;
    }
    let point = shooting_point(problem, x, u);
    let gradients = input_gradients(problem, &point);
    let mut residual = Residual(0.0);
    residual.add((x[0] - problem.x0).amax());
    residual.add((point.x[0] - first_state(problem)).amax());
    for k in 0..horizon {
        residual.add((problem.model.step(&point.x[k], &point.u[k]) - point.x[k + 1]).amax());
    }
    for j in 0..2 {
        stationarity(problem, &point, &gradients, j, &mut residual);
    }
    residual.0
}

/// The largest so far; NaN counts as infinite.
struct Residual(f64);

impl Residual {
    fn add(&mut self, value: f64) {
        self.0 = if value.is_nan() {
            f64::INFINITY
        } else {
            self.0.max(value)
        };
    }
}

/// Values from `low` to `high`: what multipliers may be.
#[derive(Clone, Copy)]
struct Interval {
    low: f64,
    high: f64,
}

/// Multiplier of a pair of bounds with `below` room to the lower and `above` to the upper one: positive at the upper one,
/// negative at the lower, 0 between.
fn multiplier(below: f64, above: f64) -> Interval {
    Interval {
        low: if below <= ACTIVE {
            f64::NEG_INFINITY
        } else {
            0.0
        },
        high: if above <= ACTIVE { f64::INFINITY } else { 0.0 },
    }
}

/// Conditions of input component `j` of all knots.
///
/// With ν of the bounds on uₖ and ρₖ of that on uₖ − uₖ₋₁: gₖ + νₖ + ρₖ − ρₖ₊₁ = 0. Backwards, each knot leaves an interval for
/// its ρ; where that misses the values ρ may have, the miss is the residual.
fn stationarity<const NX: usize>(
    problem: &Problem<NX>,
    point: &Point<NX>,
    gradients: &[Vector2<f64>],
    j: usize,
    residual: &mut Residual,
) {
    let horizon = problem.horizon();
    let mut rho_next = Interval {
        low: 0.0,
        high: 0.0,
    };
    for k in (0..horizon).rev() {
        let value = point.u[k][j];
        let (min, max) = if j == 1 {
            roll_bounds(problem, point, k)
        } else {
            (problem.u_min[k][0], problem.u_max[k][0])
        };
        let nu = multiplier(value - min, max - value);
        residual.add((min - value).max(value - max));
        let rho = match problem.du_max {
            None => Interval {
                low: 0.0,
                high: 0.0,
            },
            Some(du_max) => {
                let before = if k == 0 {
                    problem.u_prev[j]
                } else {
                    point.u[k - 1][j]
                };
                let change = value - before;
                residual.add(change.abs() - du_max[j]);
                multiplier(change + du_max[j], du_max[j] - change)
            }
        };
        // ρₖ = ρₖ₊₁ − gₖ − νₖ
        let needed = Interval {
            low: rho_next.low - gradients[k][j] - nu.high,
            high: rho_next.high - gradients[k][j] - nu.low,
        };
        let met = Interval {
            low: needed.low.max(rho.low),
            high: needed.high.min(rho.high),
        };
        if met.low <= met.high {
            rho_next = met;
        } else {
            residual.add(met.low - met.high);
            // Go on from the nearest value that ρₖ may have.
            let nearest = if needed.low > rho.high {
                rho.high
            } else {
                rho.low
            };
            rho_next = Interval {
                low: nearest,
                high: nearest,
            };
        }
        // Complementarity: a multiplier on a bound that the point lies beside, not on.
        if problem.du_max.is_none() {
            let room = if gradients[k][j] > 0.0 {
                value - min
            } else {
                max - value
            };
            if room <= ACTIVE {
                residual.add(room.abs().min(gradients[k][j].abs()));
            }
        }
    }
}

/// The point in the shooting problem's counting; the state that weighs nothing is appended.
fn shooting_point<const NX: usize>(
    problem: &Problem<NX>,
    x: &[SVector<f64, NX>],
    u: &[Vector2<f64>],
) -> Point<NX> {
    let mut states = x.to_vec();
    if problem.first_input == FirstInput::Measured {
        states.remove(0);
        let last = x[x.len() - 1];
        states.push(problem.model.step(&last, &u[u.len() - 1]));
    }
    Point {
        x: states,
        u: u.to_vec(),
    }
}

/// Gradient of the cost by each input through the dynamics: λₖ = ∂l/∂xₖ + Aᵀλₖ₊₁, gₖ = ∂l/∂uₖ + Bᵀλₖ₊₁.
fn input_gradients<const NX: usize>(problem: &Problem<NX>, point: &Point<NX>) -> Vec<Vector2<f64>> {
    let horizon = problem.horizon();
    let mut gradients = vec![Vector2::zeros(); horizon];
    let mut lambda = SVector::zeros();
    for k in (0..horizon).rev() {
        // Here λ = Aᵀλₖ₊₂, of the later stages.
        lambda += state_gradient(problem, k + 1, &point.x[k + 1])
            + plane_gradient(problem, k + 1, &point.x[k + 1]);
        let linearised = problem.model.linearise(&point.x[k], &point.u[k]);
        let u = point.u[k];
        let mut gradient = (u - problem.u_ref[k]).component_mul(&problem.r) * 2.0;
        let before = if k == 0 {
            problem.u_prev
        } else {
            point.u[k - 1]
        };
        gradient += (u - before).component_mul(&problem.r_rate) * 2.0;
        if let Some(next) = point.u.get(k + 1) {
            gradient -= (next - u).component_mul(&problem.r_rate) * 2.0;
        }
        gradients[k] = gradient + linearised.b.tr_mul(&lambda);
        lambda = linearised.a.tr_mul(&lambda);
    }
    gradients
}

fn plane_gradient<const NX: usize>(
    problem: &Problem<NX>,
    k: usize,
    x: &SVector<f64, NX>,
) -> SVector<f64, NX> {
    let mut gradient = SVector::zeros();
    if let Some(row) = state_row(problem, k) {
        for plane in problem.half_planes_at(row) {
            let gap = plane.gap(x[0], x[1]).min(0.0);
            for i in 0..2 {
                gradient[i] += 2.0 * plane.weight * gap * plane.normal[i];
            }
        }
    }
    gradient
}

/// Room to a bound that counts as none [m/s, rad].
const ACTIVE: f64 = 1e-6;
