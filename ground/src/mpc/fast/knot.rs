//! One knot of the kinematics in lanes: what [`Discretisation`] computes, in the terms that a sweep uses.
//!
//! ```text
//! F = (X, Y, φ) + W(φ, v̄, q̄, s) with v̄ = m v + n v_c, q̄ = m q + n q_c, s = c (q_c − q), m + n = 1; v⁺ = v_c + l (v − v_c), q⁺ alike
//! ```
//!
//! With three states v̄ = v, q̄ = q_r and s = 0. Way and derivatives by v̄, q̄ and s are the module `kinematics`'.

use super::lanes::Lanes;
use super::trig::{ANGLE_MAX, polynomial, sin_cos, tan_near};
use crate::kinematics::{Discretisation, chord_series};

/// The numbers of each lane's model.
#[derive(Clone, Copy, Debug)]
pub(super) struct Model<L> {
    /// Δ [s].
    pub(super) period: L,
    /// R [m].
    pub(super) radius: L,
    /// Δ/R [s/m].
    pub(super) k: L,
    /// Share of v − v_c left after a knot, l, and 1 − l [1].
    pub(super) left: L,
    pub(super) gone: L,
    /// Mean share of v − v_c over a knot, m, and n = 1 − m [1].
    pub(super) mean: L,
    pub(super) rest: L,
    /// Share of q_c − q that moves the centre sideways, c [1].
    pub(super) slide: L,
}

/// A knot expanded to second order. Rows X, Y, φ of the derivatives; v⁺ and q⁺ are linear.
#[derive(Clone, Copy, Debug)]
pub(super) struct Expansion<L> {
    /// Change of the pose.
    pub(super) way: [L; 3],
    /// ∂F/∂v̄.
    pub(super) by_v: [L; 3],
    /// ∂F/∂q, of five states.
    pub(super) by_state_q: [L; 3],
    /// ∂F/∂q_c.
    pub(super) by_q: [L; 3],
    /// ∂²(λᵀF): by φ twice; by φ with v̄, q, q_c; by v̄ twice; by v̄ with q, q_c; by q twice, with q_c; by q_c twice.
    pub(super) phi_phi: L,
    pub(super) phi_v: L,
    pub(super) phi_q: [L; 2],
    pub(super) v_v: L,
    pub(super) v_q: [L; 2],
    pub(super) q_q: [L; 3],
}

impl<L: Lanes> Model<L> {
    pub(super) fn zero() -> Self {
        let zero = L::splat(0.0);
        Self {
            period: zero,
            radius: zero,
            k: zero,
            left: zero,
            gone: zero,
            mean: zero,
            rest: zero,
            slide: zero,
        }
    }

    pub(super) fn set_lane<const NX: usize>(&mut self, lane: usize, model: &Discretisation<NX>) {
        let [period, radius, left, mean, slide] = model.numbers();
        self.period.set_lane(lane, period);
        self.radius.set_lane(lane, radius);
        self.k.set_lane(lane, period / radius);
        self.left.set_lane(lane, left);
        self.gone.set_lane(lane, 1.0 - left);
        self.mean.set_lane(lane, mean);
        self.rest.set_lane(lane, 1.0 - mean);
        self.slide.set_lane(lane, slide);
    }

    /// State at the end of a knot that begins at `x` and holds `u`.
    #[inline(always)]
    pub(super) fn step<const NX: usize>(&self, x: &[L; NX], u: &[L; 2]) -> [L; NX] {
        let (v, q, side) = self.means(x, u);
        let g = v * self.k * tan_near(q);
        let z = g * g;
        let m = [polynomial(z, &CHORD_RE), g * polynomial(z, &CHORD_IM)];
        let (sin, cos) = sin_cos(x[2]);
        let m = turned(m, cos, sin);
        let way = scaled(m, v * self.period, side);
        let mut next = *x;
        next[0] = x[0] + way[0];
        next[1] = x[1] + way[1];
        next[2] = x[2] + g;
        if NX == 5 {
            next[3] = u[0] + (x[3] - u[0]) * self.left;
            next[4] = u[1] + (x[4] - u[1]) * self.left;
        }
        next
    }

    /// Whether the series hold for the knot at `x` with `u`.
    #[inline(always)]
    pub(super) fn is_near<const NX: usize>(&self, x: &[L; NX], u: &[L; 2]) -> L::Mask {
        let (v, q, _) = self.means(x, u);
        near(v * self.k * tan_near(q), q, x[2])
    }

    /// v̄, q̄ and the way to the left, R s [m/s, rad, m].
    #[inline(always)]
    fn means<const NX: usize>(&self, x: &[L; NX], u: &[L; 2]) -> (L, L, L) {
        if NX == 3 {
            return (u[0], u[1], L::splat(0.0));
        }
        (
            u[0] + (x[3] - u[0]) * self.mean,
            u[1] + (x[4] - u[1]) * self.mean,
            self.radius * ((u[1] - x[4]) * self.slide),
        )
    }

    /// The knot at `x` and `u`, with the curvature of the costate `lambda` of the next state. Also where the series hold.
    #[inline(always)]
    pub(super) fn expand<const NX: usize>(
        &self,
        x: &[L; NX],
        u: &[L; 2],
        lambda: &[L; NX],
    ) -> (Expansion<L>, L::Mask) {
        let (v, q, side) = self.means(x, u);
        let t = tan_near(q);
        let sec2 = L::splat(1.0) + t * t;
        let g_v = self.k * t;
        let g_vq = self.k * sec2;
        let (g, g_q) = (v * g_v, v * g_vq);
        let tq = t * g_q;
        let g_qq = tq + tq;
        let is_near = near(g, q, x[2]);
        let z = g * g;
        let m = [polynomial(z, &CHORD_RE), g * polynomial(z, &CHORD_IM)];
        let m1 = [g * polynomial(z, &FIRST_RE), polynomial(z, &FIRST_IM)];
        let m2 = [polynomial(z, &SECOND_RE), g * polynomial(z, &SECOND_IM)];
        let (sin, cos) = sin_cos(x[2]);
        let forward = v * self.period;
        let m = turned(m, cos, sin);
        let f = turned(m1, cos, sin);
        let way = scaled_by::<L, NX>(m, forward, side);
        let along = scaled_by::<L, NX>(f, forward, side);
        let by_v = [
            self.period * m[0] + along[0] * g_v,
            self.period * m[1] + along[1] * g_v,
            g_v,
        ];
        let by_mean = [along[0] * g_q, along[1] * g_q, g_q];

        let forward_first = dot(lambda, f) * self.period;
        let way_first = dot(lambda, along) + lambda[2];
        // λ turned into the frame of the heading, instead of M″ out of it.
        let along_second = scaled_by::<L, NX>(m2, forward, side);
        let way_second = (lambda[0] * cos + lambda[1] * sin) * along_second[0]
            + (lambda[1] * cos - lambda[0] * sin) * along_second[1];
        let phi_phi = -dot(lambda, way);
        let phi_v = lambda[1] * by_v[0] - lambda[0] * by_v[1];
        let phi_mean = lambda[1] * by_mean[0] - lambda[0] * by_mean[1];
        let v_v = (forward_first + forward_first) * g_v + way_second * g_v * g_v;
        let v_mean = forward_first * g_q + way_second * g_v * g_q + way_first * g_vq;
        let mean_mean = way_second * g_q * g_q + way_first * g_qq;
        let zero = L::splat(0.0);
        if NX == 3 {
            return (
                Expansion {
                    way: [way[0], way[1], g],
                    by_v,
                    by_state_q: [zero; 3],
                    by_q: by_mean,
                    phi_phi,
                    phi_v,
                    phi_q: [zero, phi_mean],
                    v_v,
                    v_q: [zero, v_mean],
                    q_q: [zero, zero, mean_mean],
                },
                is_near,
            );
        }
        // q̄ = m q + n q_c and s = c (q_c − q), by the chain rule; R c once.
        let (mean, rest) = (self.mean, self.rest);
        let rc = self.radius * self.slide;
        let (slide_x, slide_y) = (rc * m[1], rc * m[0]);
        let phi_slide = -(lambda[1] * slide_x + lambda[0] * slide_y);
        let slide_first = rc * (lambda[1] * f[0] - lambda[0] * f[1]);
        let (v_slide, q_slide) = (slide_first * g_v, slide_first * g_q);
        let nq = rest * mean_mean;
        let mq = mean * mean_mean;
        (
            Expansion {
                way: [way[0], way[1], g],
                by_v,
                by_state_q: [
                    mean * by_mean[0] + slide_x,
                    mean * by_mean[1] - slide_y,
                    mean * g_q,
                ],
                by_q: [
                    rest * by_mean[0] - slide_x,
                    rest * by_mean[1] + slide_y,
                    rest * g_q,
                ],
                phi_phi,
                phi_v,
                phi_q: [mean * phi_mean - phi_slide, rest * phi_mean + phi_slide],
                v_v,
                v_q: [mean * v_mean - v_slide, rest * v_mean + v_slide],
                q_q: [
                    mean * (mq - (q_slide + q_slide)),
                    mean * nq + (mean - rest) * q_slide,
                    rest * (nq + (q_slide + q_slide)),
                ],
            },
            is_near,
        )
    }
}

/// Whether the series hold for a turn `g`, a mean roll `q` and a `heading` [rad].
#[inline(always)]
fn near<L: Lanes>(g: L, q: L, heading: L) -> L::Mask {
    let is_near = L::and(
        g.abs().less(L::splat(TURN_MAX)),
        q.abs().less(L::splat(ROLL_MAX)),
    );
    L::and(is_near, heading.abs().less(L::splat(ANGLE_MAX)))
}

/// λᵀz of the first two rows.
#[inline(always)]
fn dot<L: Lanes, const NX: usize>(lambda: &[L; NX], z: [L; 2]) -> L {
    lambda[0] * z[0] + lambda[1] * z[1]
}

/// z exp(iφ).
#[inline(always)]
fn turned<L: Lanes>(z: [L; 2], cos: L, sin: L) -> [L; 2] {
    [z[0] * cos - z[1] * sin, z[0] * sin + z[1] * cos]
}

/// (forward + i side) z.
#[inline(always)]
fn scaled<L: Lanes>(z: [L; 2], forward: L, side: L) -> [L; 2] {
    [forward * z[0] - side * z[1], forward * z[1] + side * z[0]]
}

/// [`scaled`]; with three states nothing goes sideways.
#[inline(always)]
fn scaled_by<L: Lanes, const NX: usize>(z: [L; 2], forward: L, side: L) -> [L; 2] {
    if NX == 3 {
        [forward * z[0], forward * z[1]]
    } else {
        scaled(z, forward, side)
    }
}

/// Largest turn over a knot [rad] for the series, three times what a robot does: there M is off by 1e-16, M′ by 2e-14, M″, which
/// only the speed of convergence feels, by 1e-7.
const TURN_MAX: f64 = 0.3;
/// Largest mean roll [rad].
const ROLL_MAX: f64 = core::f64::consts::FRAC_PI_4;

const CHORD_RE: [f64; 6] = chord_series(0);
const CHORD_IM: [f64; 6] = chord_series(1);
const FIRST_RE: [f64; 5] = chord_series(2);
const FIRST_IM: [f64; 5] = chord_series(3);
const SECOND_RE: [f64; 3] = chord_series(4);
const SECOND_IM: [f64; 3] = chord_series(5);
