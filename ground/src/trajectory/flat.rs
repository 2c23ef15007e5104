//! The flat output of eq (1): from a path to a heading, speed and roll that drive it exactly.
//!
//! The sphere's centre C moves by eq (1), Ċ = v (cos φ, sin φ) + R q̇_r n with n = (−sin φ, cos φ). The point P = C − R q_r n moves
//! along the heading alone: Ṗ = (v + R q_r φ̇)(cos φ, sin φ). So any smooth path of P with speed w = |Ṗ| and curvature φ̇/w fixes the rest
//! without integration,
//!
//!   φ = ∠Ṗ,   tan q_r / (1 + q_r tan q_r) = R φ̇ / w,   v = w / (1 + q_r tan q_r),   C = P + R q_r n,
//!
//! and the result obeys eq (1) identically. For a path that is given for C the point P follows from P = C − R q_r(P) n(P), iterated
//! twice from P = C: two passes of φ = tangent − atan(R q̇_r/v). The remainder is how far the reference's centre is
//! from the given path, not an error in eq (1). More passes do not help: the exact inverse is an oscillator at v/R.

use super::{Motion, ReferencePoint};
use crate::jet::Jet;

/// Orders that a path given for the centre must have for a [`ReferencePoint`]: each of the two passes takes two derivatives, roll and its
/// rate three.
pub(super) const ORDERS: usize = 8;
/// The same without the rates.
pub(super) const ORDERS_OF_STATE: usize = 7;

/// Largest R φ̇ / w for which a roll exists is 2/π; a path that turns tighter gets the roll of this value.
const TURN_MAX: f64 = 0.6;

/// The reference that drives the centre along (x, y) [m], a sphere of radius `r` [m]. The tangent lies within π of `branch` [rad], and so does the heading.
///
/// The path must move: |(ẋ, ẏ)| > 0.
pub(super) fn along_centre(x: Jet<ORDERS>, y: Jet<ORDERS>, r: f64, branch: f64) -> ReferencePoint {
    let last = Turn::last(x, y, r);
    let [px, py] = last.centre();
    ReferencePoint {
        x: px,
        y: py,
        heading: last.heading(branch),
        ..ReferencePoint::default().moving(last.motion())
    }
}

/// Its speed and roll with their rates alone.
pub(super) fn motion_along_centre(x: Jet<ORDERS>, y: Jet<ORDERS>, r: f64) -> Motion {
    Turn::last(x, y, r).motion()
}

/// Its pose, speed and roll alone: x, y [m], heading [rad], v [m/s], q_r [rad].
pub(super) fn state_along_centre(
    x: Jet<ORDERS_OF_STATE>,
    y: Jet<ORDERS_OF_STATE>,
    r: f64,
    branch: f64,
) -> [f64; 5] {
    // Two orders of the path less at each pass, as in `Turn::last`.
    let (px, py) = Turn::<7, 6, 5>::of(x, y, r).point_beside(&x, &y);
    let (px, py) = Turn::<5, 4, 3>::of(px, py, r).point_beside(&x, &y);
    let last = Turn::<3, 2, 1>::of(px, py, r);
    let [x, y] = last.centre();
    let (q_r, v) = (last.q_r.value(), (last.w() * last.d).value());
    [x, y, last.heading(branch), v, q_r]
}

/// Roll and v/w = 1 − q_r f of a steady turn of P by f = `turn` = R φ̇ / w: the solution of tan q / (1 + q tan q) = f [rad, 1].
pub(super) fn roll_of_turn<const N: usize>(turn: Jet<N>) -> (Jet<N>, Jet<N>) {
    let bounded = turn.value().clamp(-TURN_MAX, TURN_MAX);
    let turn = if bounded == turn.value() {
        turn
    } else {
        Jet::constant(bounded)
    };
    turn.turn_angle(roll_of(bounded))
}

/// The roll q of a turn f, |f| ≤ [`TURN_MAX`], to rounding [rad].
fn roll_of(f: f64) -> f64 {
    if f.abs() <= SERIES_MAX {
        let z = f * f;
        return f * ROLL.iter().rev().fold(0.0, |sum, c| sum * z + c);
    }
    // g(q) = sin q − f (cos q + q sin q) grows with q wherever |f| < 2/π; g′ = cos q (1 − f q).
    let mut q = f.atan();
    for _ in 0..20 {
        let (s, c) = q.sin_cos();
        let step = (s - f * (c + q * s)) / (c * (1.0 - f * q));
        q -= step;
        // Newton's method squares its error: the next step would be nothing.
        if step.abs() < 1e-9 {
            break;
        }
    }
    q
}

/// Curvature of P's path at which the roll is `q_r`, tan q / (1 + q tan q) / R [1/m].
pub(super) fn curvature_of_roll(q_r: f64, r: f64) -> f64 {
    q_r.tan() / (1.0 + q_r * q_r.tan()) / r
}

/// What a path of P with N orders implies, to E = N − 2 of them (D = N − 1).
struct Turn<const N: usize, const D: usize, const E: usize> {
    p: [f64; 2],       // P [m]
    rate: [Jet<E>; 2], // Ṗ [m/s]
    square: Jet<E>,    // w² = |Ṗ|² [m²/s²]
    inverse: Jet<E>,   // 1/w [s/m]
    q_r: Jet<E>,       // [rad]
    d: Jet<E>,         // v/w [1]
    r: f64,            // radius of the sphere [m]
}

impl Turn<4, 3, 2> {
    /// After both passes, with the rates of speed and roll.
    fn last(x: Jet<ORDERS>, y: Jet<ORDERS>, r: f64) -> Self {
        let (px, py) = Turn::<8, 7, 6>::of(x, y, r).point_beside(&x, &y);
        let (px, py) = Turn::<6, 5, 4>::of(px, py, r).point_beside(&x, &y);
        Self::of(px, py, r)
    }

    fn motion(&self) -> Motion {
        Motion::of(self.w() * self.d, self.q_r)
    }
}

impl<const N: usize, const D: usize, const E: usize> Turn<N, D, E> {
    fn of(x: Jet<N>, y: Jet<N>, r: f64) -> Self {
        let (dx, dy): (Jet<D>, Jet<D>) = (x.derivative(), y.derivative());
        let rate: [Jet<E>; 2] = [dx.truncated(), dy.truncated()];
        let square = rate[0].square() + rate[1].square();
        // f = R (ẋ ÿ − ẏ ẍ) / w³.
        let cross = rate[0] * dy.derivative() - rate[1] * dx.derivative();
        let inverse = 1.0 / square.value().sqrt();
        let cube = square.power(-1.5, inverse * inverse * inverse);
        let (q_r, d) = roll_of_turn(cross * cube * r);
        Self {
            p: [x.value(), y.value()],
            rate,
            square,
            inverse: cube * square,
            q_r,
            d,
            r,
        }
    }

    /// P = C − R q_r n for the centre (x, y) [m], with this roll and normal.
    fn point_beside<const M: usize>(&self, x: &Jet<M>, y: &Jet<M>) -> (Jet<E>, Jet<E>) {
        let side = self.q_r * self.inverse * self.r;
        (
            x.truncated() + side * self.rate[1],
            y.truncated() - side * self.rate[0],
        )
    }

    /// C = P + R q_r n [m].
    fn centre(&self) -> [f64; 2] {
        let side = self.q_r.value() * self.inverse.value() * self.r;
        [
            self.p[0] - side * self.rate[1].value(),
            self.p[1] + side * self.rate[0].value(),
        ]
    }

    fn w(&self) -> Jet<E> {
        self.square * self.inverse
    }

    /// Relative to the branch, so that the cut of atan2 lies opposite to it [rad].
    fn heading(&self, branch: f64) -> f64 {
        let [dx, dy] = [self.rate[0].value(), self.rate[1].value()];
        if branch == 0.0 {
            return dy.atan2(dx);
        }
        let (s, c) = branch.sin_cos();
        branch + (c * dy - s * dx).atan2(c * dx + s * dy)
    }
}

/// Turns up to which [`ROLL`] holds; a robot rolled by 20° turns by 0.32 [1].
const SERIES_MAX: f64 = 0.34;
/// q/f in powers of f²: interpolated at Chebyshev's points of |f| ≤ [`SERIES_MAX`] in 40 digits, 2e-18 off.
const ROLL: [f64; 15] = [
    1.0,
    0.6666666666666607,
    0.8666666666704517,
    1.3904761895166333,
    2.479365206389539,
    4.712255419956468,
    9.348228342870312,
    19.103053252229472,
    40.48356422501934,
    77.32961398923385,
    284.67547087043715,
    -475.78900786439345,
    6107.276514795339,
    -17239.1511477899,
    40332.605504081286,
];

#[cfg(test)]
mod tests {
    use super::*;

    /// The interpolated and the iterated roll solve the same equation, on both sides of where they meet.
    #[test]
    fn rolls_solve_their_equation() {
        for i in -6000..=6000 {
            let f = f64::from(i) * 1e-4;
            let q = roll_of(f);
            let (s, c) = q.sin_cos();
            let error = (s - f * (c + q * s)) / (c * (1.0 - f * q));
            assert!(error.abs() < 1e-15, "{f}: off by {error:e}");
        }
    }
}
