//! The terminal weight: the infinite-horizon cost of tracking the last reference.

use core::array;

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
/// nine suffice where the plain recursion takes hundreds.
///
/// `None` if it does not converge: (A, B) is not stabilisable, or a number is not finite.
pub fn solve<const NX: usize>(
    a: &SMatrix<f64, NX, NX>,
    b: &SMatrix<f64, NX, 2>,
    q: &SMatrix<f64, NX, NX>,
    r: &Vector2<f64>,
) -> Option<SMatrix<f64, NX, NX>> {
    let mut a: Rows<NX> = array::from_fn(|i| array::from_fn(|j| a[(i, j)]));
    let mut g: Rows<NX> = array::from_fn(|i| {
        array::from_fn(|j| b[(i, 0)] * b[(j, 0)] / r[0] + b[(i, 1)] * b[(j, 1)] / r[1])
    });
    let mut h: Rows<NX> = array::from_fn(|i| array::from_fn(|j| q[(i, j)]));
    for _ in 0..DOUBLINGS_MAX {
        // W = (I + GH)⁻¹: A⁺ = A W A, G⁺ = G + A W G Aᵀ, H⁺ = H + Aᵀ H W A
        let mut to_invert = product(&g, &h);
        for (i, row) in to_invert.iter_mut().enumerate() {
            row[i] += 1.0;
        }
        let (mut wa, mut wg) = (a, g);
        divide(&mut to_invert, &mut wa, &mut wg)?;
        let rise = lower(&transposed(&a), &transposed(&product(&h, &wa)));
        let gained = lower(&product(&a, &wg), &a);
        a = product(&a, &wa);
        let (mut size, mut change) = (0.0_f64, 0.0_f64);
        for i in 0..NX {
            for j in 0..=i {
                h[i][j] += rise[i][j];
                h[j][i] = h[i][j];
                g[i][j] += gained[i][j];
                g[j][i] = g[i][j];
                size = size.max(h[i][j].abs());
                change = change.max(rise[i][j].abs());
            }
        }
        // `max` passes over NaN, the sum does not.
        if !h.iter().flatten().sum::<f64>().is_finite() {
            return None;
        }
        if change <= RISE_MIN * size {
            return Some(SMatrix::from_fn(|i, j| h[i][j]));
        }
    }
    None
}

/// A square matrix, row by row.
type Rows<const NX: usize> = [[f64; NX]; NX];

/// A B.
fn product<const NX: usize>(a: &Rows<NX>, b: &Rows<NX>) -> Rows<NX> {
    let mut c = [[0.0; NX]; NX];
    for i in 0..NX {
        for k in 0..NX {
            for j in 0..NX {
                c[i][j] += a[i][k] * b[k][j];
            }
        }
    }
    c
}

/// A Bᵀ, its lower half alone: the product is symmetric.
fn lower<const NX: usize>(a: &Rows<NX>, b: &Rows<NX>) -> Rows<NX> {
    let mut c = [[0.0; NX]; NX];
    for i in 0..NX {
        for j in 0..=i {
            for k in 0..NX {
                c[i][j] += a[i][k] * b[j][k];
            }
        }
    }
    c
}

fn transposed<const NX: usize>(a: &Rows<NX>) -> Rows<NX> {
    array::from_fn(|i| array::from_fn(|j| a[j][i]))
}

/// M⁻¹ from the left to `left` and `right`, by Gauss elimination with row pivots; M is used up. `None` if singular or not finite.
#[expect(
    clippy::needless_range_loop,
    reason = "indices stand as in the formulas"
)]
fn divide<const NX: usize>(
    m: &mut Rows<NX>,
    left: &mut Rows<NX>,
    right: &mut Rows<NX>,
) -> Option<()> {
    for k in 0..NX {
        let mut pivot = k;
        for i in k + 1..NX {
            if m[i][k].abs() > m[pivot][k].abs() {
                pivot = i;
            }
        }
        let value = m[pivot][k];
        if !value.is_finite() || value == 0.0 {
            return None;
        }
        if pivot != k {
            m.swap(k, pivot);
            left.swap(k, pivot);
            right.swap(k, pivot);
        }
        let share = 1.0 / value;
        for j in k + 1..NX {
            m[k][j] *= share;
        }
        for j in 0..NX {
            left[k][j] *= share;
            right[k][j] *= share;
        }
        let (row, row_left, row_right) = (m[k], left[k], right[k]);
        for i in k + 1..NX {
            let factor = m[i][k];
            for j in k + 1..NX {
                m[i][j] -= factor * row[j];
            }
            for j in 0..NX {
                left[i][j] -= factor * row_left[j];
                right[i][j] -= factor * row_right[j];
            }
        }
    }
    for k in (1..NX).rev() {
        let (row_left, row_right) = (left[k], right[k]);
        for i in 0..k {
            let factor = m[i][k];
            for j in 0..NX {
                left[i][j] -= factor * row_left[j];
                right[i][j] -= factor * row_right[j];
            }
        }
    }
    Some(())
}

/// Below this speed of the reference steering counts as none [m/s].
const SPEED_MIN: f64 = 0.05;
/// 2⁴⁰ steps: a robot that needs more is not stabilisable.
const DOUBLINGS_MAX: usize = 40;
/// A rise of H by this share is the last: what the cost still lacks is the square of it, as 2ᵏ⁺¹ steps are twice 2ᵏ.
const RISE_MIN: f64 = 1e-9;

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    /// One step of the plain recursion.
    fn step<const NX: usize>(
        p: &SMatrix<f64, NX, NX>,
        a: &SMatrix<f64, NX, NX>,
        b: &SMatrix<f64, NX, 2>,
        q: &SMatrix<f64, NX, NX>,
        r: &Vector2<f64>,
    ) -> SMatrix<f64, NX, NX> {
        let (pa, pb) = (p * a, p * b);
        let s = nalgebra::Matrix2::from_diagonal(r) + b.tr_mul(&pb);
        let gain = s.try_inverse().expect("R > 0") * b.tr_mul(&pa);
        let next = q + a.tr_mul(&pa) - pb.tr_mul(a).transpose() * gain;
        (next + next.transpose()) * 0.5
    }

    proptest! {
        /// Over all speeds and rolls that steer: the plain recursion, gone on with until it stands, is nowhere farther than 1e-12 of P.
        #[test]
        fn doubling_finds_what_the_recursion_finds(
            speed in 0.06..1.0_f64, is_back in any::<bool>(), roll in -0.35..0.35_f64, ahead in -0.1..0.1_f64,
            heading in -4.0..4.0_f64, log_r in 0.0..1.3_f64,
        ) {
            let v = if is_back { -0.5 * speed } else { speed };
            prop_assume!(v.abs() > SPEED_MIN);
            let model = Discretisation::centre(0.1, 0.35, 0.2);
            let x = SVector::from([0.0, 0.0, heading, v, roll]);
            let (q, r) = (SVector::from([2.0, 2.0, 1.0, 1e-3, 1e-3]), Vector2::new(1.0, log_r.exp()));
            let u = Vector2::new(v, roll + ahead);
            let linearised = model.linearise(&x, &u);
            let p = terminal_weight(&model, &x, &u, &q, &r);
            let q = SMatrix::from_diagonal(&q);
            let mut by_recursion = q;
            for _ in 0..6000 {
                by_recursion = step(&by_recursion, &linearised.a, &linearised.b, &q, &r);
            }
            let error = (p - by_recursion).amax() / p.amax();
            prop_assert!(error < 1e-12, "off by {:e} at v = {}", error, v);
            prop_assert_eq!(p, p.transpose());
        }
    }

    /// What nobody can steer, and what is no number, has no weight.
    #[test]
    fn what_has_no_solution_is_none() {
        let q = SMatrix::<f64, 3, 3>::identity();
        let r = Vector2::new(1.0, 1.0);
        assert_eq!(solve(&(q * 1.1), &SMatrix::zeros(), &q, &r), None);
        assert_eq!(solve(&(q * f64::NAN), &SMatrix::zeros(), &q, &r), None);
    }
}
