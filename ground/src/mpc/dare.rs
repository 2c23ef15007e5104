//! The terminal weight: the infinite-horizon cost of tracking the last reference.

use nalgebra::{SMatrix, SVector, Vector2};

use crate::kinematics::Discretisation;

/// Weight P of the last state, NX × NX: solution of the discrete algebraic Riccati equation for `model` linearised at the last
/// reference `x_ref`, `u_ref`, with diagonal weights `q` and `r`; symmetric.
///
/// At a reference slower than 0.05 m/s nothing steers the robot sideways, and the equation has no solution: there, and wherever
/// it does not converge, P = Q.
pub fn terminal_weight<const NX: usize>(
    model: &Discretisation<NX>,
    x_ref: &SVector<f64, NX>,
    u_ref: &Vector2<f64>,
    q: &SVector<f64, NX>,
    r: &Vector2<f64>,
) -> SMatrix<f64, NX, NX> {
    let q = SMatrix::from_diagonal(q);
    let speed = if NX == 5 { x_ref[3] } else { u_ref[0] };
    // Not above, rather than below: NaN ends here too.
    if !(speed.abs() > SPEED_MIN && r.min() > 0.0) {
        return q;
    }
    let linearised = model.linearise(x_ref, u_ref);
    solve(&linearised.a, &linearised.b, &q, r).unwrap_or(q)
}

/// P = Q + AᵀPA − AᵀPB (R + BᵀPB)⁻¹ BᵀPA by structure-preserving doubling: iteration k holds the cost of 2ᵏ steps, so that some
/// ten suffice where the plain recursion takes hundreds.
///
/// `None` if it does not converge: (A, B) is not stabilisable, or a number is not finite.
pub fn solve<const NX: usize>(
    a: &SMatrix<f64, NX, NX>,
    b: &SMatrix<f64, NX, 2>,
    q: &SMatrix<f64, NX, NX>,
    r: &Vector2<f64>,
) -> Option<SMatrix<f64, NX, NX>> {
    let mut a = *a;
    let mut g =
        b.column(0) * b.column(0).transpose() / r[0] + b.column(1) * b.column(1).transpose() / r[1];
    let mut h = *q;
    for _ in 0..DOUBLINGS_MAX {
        // W = (I + GH)⁻¹: A⁺ = A W A, G⁺ = G + A W G Aᵀ, H⁺ = H + Aᵀ H W A
        let w = inverse(SMatrix::identity() + g * h)?;
        let wa = w * a;
        let rise = a.tr_mul(&(h * wa));
        let next_g = g + a * (w * g) * a.transpose();
        a *= wa;
        g = (next_g + next_g.transpose()) * 0.5;
        h += rise;
        h = (h + h.transpose()) * 0.5;
        let size = h.amax();
        if !size.is_finite() {
            return None;
        }
        if rise.amax() <= 1e-15 * size {
            return Some(h);
        }
    }
    None
}

/// By Gauss-Jordan elimination with row pivots. `None` if singular or not finite.
fn inverse<const NX: usize>(mut m: SMatrix<f64, NX, NX>) -> Option<SMatrix<f64, NX, NX>> {
    let mut inverse = SMatrix::<f64, NX, NX>::identity();
    for column in 0..NX {
        let pivot =
            (column..NX).max_by(|i, j| m[(*i, column)].abs().total_cmp(&m[(*j, column)].abs()))?;
        let value = m[(pivot, column)];
        if !value.is_finite() || value == 0.0 {
            return None;
        }
        m.swap_rows(column, pivot);
        inverse.swap_rows(column, pivot);
        m.row_mut(column).unscale_mut(value);
        inverse.row_mut(column).unscale_mut(value);
        for row in (0..NX).filter(|row| *row != column) {
            let factor = m[(row, column)];
            for j in 0..NX {
                m[(row, j)] -= factor * m[(column, j)];
                inverse[(row, j)] -= factor * inverse[(column, j)];
            }
        }
    }
    Some(inverse)
}

/// Below this speed of the reference steering counts as none [m/s].
const SPEED_MIN: f64 = 0.05;
/// 2⁴⁰ steps: a robot that needs more is not stabilisable.
const DOUBLINGS_MAX: usize = 40;
