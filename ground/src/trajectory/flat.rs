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

use super::ReferencePoint;
use crate::jet::Jet;

/// Orders that a path given for the centre must have: each of the two passes takes two derivatives, roll and its rate three.
pub(super) const ORDERS: usize = 8;

/// Largest R φ̇ / w for which a roll exists is 2/π; a path that turns tighter gets the roll of this value.
const TURN_MAX: f64 = 0.6;

/// The reference that drives the centre along (x, y) [m], a sphere of radius `r` [m]. The tangent lies within π of `branch` [rad], and so does the heading.
///
/// The path must move: |(ẋ, ẏ)| > 0.
pub(super) fn along_centre(x: Jet<ORDERS>, y: Jet<ORDERS>, r: f64, branch: f64) -> ReferencePoint {
    // Speed and tangent take one order, curvature and roll a second: the series get shorter.
    let motion: Motion<7, 6> = Motion::of(&x, &y, r);
    let (px, py) = motion.point(x.truncated(), y.truncated(), r);
    let motion: Motion<5, 4> = Motion::of(&px, &py, r);
    let (px, py) = motion.point(x.truncated(), y.truncated(), r);
    let motion: Motion<3, 2> = Motion::of(&px, &py, r);
    // The tangent relative to the branch, so that the cut of atan2 lies opposite to it.
    let (s, c) = branch.sin_cos();
    let (cos, sin) = (motion.cos.value(), motion.sin.value());
    let heading = branch + (c * sin - s * cos).atan2(c * cos + s * sin);
    at(
        px.value(),
        py.value(),
        heading,
        motion.w.truncated(),
        motion.q_r,
        r,
    )
}

/// The reference while P is at (x, y) [m] with `heading` [rad], moving at `w` [m/s] and turning at `turn` = R φ̇ / w [1].
pub(super) fn at_point(
    x: f64,
    y: f64,
    heading: f64,
    w: Jet<2>,
    turn: Jet<2>,
    r: f64,
) -> ReferencePoint {
    at(x, y, heading, w, roll_of_turn(turn), r)
}

/// Roll of a steady turn of P, the solution of tan q / (1 + q tan q) = `turn` [rad].
pub(super) fn roll_of_turn<const N: usize>(turn: Jet<N>) -> Jet<N> {
    let bounded = turn.value().clamp(-TURN_MAX, TURN_MAX);
    let turn = if bounded == turn.value() {
        turn
    } else {
        Jet::constant(bounded)
    };
    // g(q) = sin q − turn (cos q + q sin q) grows with q wherever |turn| < 2/π; g′ = cos q (1 − turn q).
    let mut q = bounded.atan();
    for _ in 0..20 {
        let (s, c) = q.sin_cos();
        let step = (s - bounded * (c + q * s)) / (c * (1.0 - bounded * q));
        q -= step;
        // Newton's method squares its error: the next step would be nothing.
        if step.abs() < 1e-9 {
            break;
        }
    }
    turn.turn_angle(q)
}

/// Curvature of P's path at which the roll is `q_r`, tan q / (1 + q tan q) / R [1/m].
pub(super) fn curvature_of_roll(q_r: f64, r: f64) -> f64 {
    q_r.tan() / (1.0 + q_r * q_r.tan()) / r
}

/// What a path of P implies, to D orders, and to E = D − 1 where the curvature enters.
struct Motion<const D: usize, const E: usize> {
    cos: Jet<D>,
    sin: Jet<D>,
    w: Jet<D>,
    q_r: Jet<E>,
}

impl<const D: usize, const E: usize> Motion<D, E> {
    fn of<const N: usize>(px: &Jet<N>, py: &Jet<N>, r: f64) -> Self {
        let (dx, dy): (Jet<D>, Jet<D>) = (px.derivative(), py.derivative());
        let w = (dx * dx + dy * dy).sqrt();
        let (cos, sin) = (dx / w, dy / w);
        let heading_rate: Jet<E> =
            cos.truncated() * sin.derivative() - sin.truncated() * cos.derivative();
        Self {
            cos,
            sin,
            w,
            q_r: roll_of_turn(heading_rate * r / w.truncated()),
        }
    }

    /// P = C − R q_r n for the centre (x, y) [m], with this roll and normal.
    fn point(&self, x: Jet<E>, y: Jet<E>, r: f64) -> (Jet<E>, Jet<E>) {
        let side = self.q_r * r;
        (
            x + side * self.sin.truncated(),
            y - side * self.cos.truncated(),
        )
    }
}

fn at(px: f64, py: f64, heading: f64, w: Jet<2>, q_r: Jet<2>, r: f64) -> ReferencePoint {
    let (s, c) = q_r.sin_cos();
    let v = w / (Jet::constant(1.0) + q_r * s / c);
    let side = r * q_r.value();
    ReferencePoint {
        x: px - side * heading.sin(),
        y: py + side * heading.cos(),
        heading,
        v: v.value(),
        q_r: q_r.value(),
        v_rate: v.rate(),
        q_r_rate: q_r.rate(),
    }
}
