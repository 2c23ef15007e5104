//! The equations of motion in momentum form: exact in three dimensions, linear in the parameters, and without any acceleration.
//!
//! The sub-models of eqs (5)-(7) leave out how roll and pitch act on each other through the mass matrix, so the fit uses the
//! whole rolling body. For quasi-velocity u_i with the partial
//! velocities V_i of the centre and ω_i of each body, d'Alembert's principle for all mass elements with velocity V + ω × ρ says
//!
//! ```text
//! d/dt p_i = c_i + Q_i          p_i = ∫ (V + ω×ρ)·(V_i + ω_i×ρ) dm          c_i = ∫ (V + ω×ρ)·d/dt(V_i + ω_i×ρ) dm
//!
//! inertia J about the centre:   p_i = ω_i·J ω                      c_i = ω̇_i·J ω
//! mass M:                       p_i = M V·V_i                      c_i = M V·V̇_i
//! first moment m l at −k:       p_i = m l (V·(ω_i×r) + V_i·(ω×r))  c_i = m l (V·(ω̇_i×r + ω_i×(ω×r)) + V̇_i·(ω×r)),  r = −k
//! ```
//!
//! with ω̇_i, V̇_i the derivatives of the *directions*: rates alone. Integrated over an interval, p_i(t₂) − p_i(t₁) = ∫ (c_i + Q_i) dt.
//! Frames, axes f, l, z; f, n, μ; s, n, w; s, t, k, and quasi-velocities α̇, v/R, β̇, q̇_r are those that
//! `sim/src/plant.rs` describes; the equations are derived apart from it. The shell turns with −q̇_r f + (v/R) l.

use nalgebra::{SVector, Vector3};
use sphere_protocol::robot::RobotParams;

use super::motion::Motion;

/// Physical parameters that the equations are linear in, by their place in a [`Terms`] row.
pub(super) mod place {
    /// m l [kg·m].
    pub(in super::super) const ML: usize = 0;
    /// I_mr, pendulum in roll about the sphere's centre [kg·m²].
    pub(in super::super) const A: usize = 1;
    /// a_p = I_mp + I_fp [kg·m²].
    pub(in super::super) const A_P: usize = 2;
    /// d = I_s + I_fr + M R² [kg·m²].
    pub(in super::super) const D: usize = 3;
    /// d_p = I_s + M R² [kg·m²].
    pub(in super::super) const D_P: usize = 4;
    /// ζ [N·m·s/rad].
    pub(in super::super) const ZETA: usize = 5;
    /// T_rr = c_rr M g R, torque of the rolling resistance [N·m].
    pub(in super::super) const T_RR: usize = 6;
    /// τ_c, Coulomb friction of each joint [N·m].
    pub(in super::super) const COULOMB: usize = 7;
    /// Shell imbalance on the rolling motion, cos φ_s and sin φ_s [N·m].
    pub(in super::super) const IMBALANCE_PITCH: usize = 8;
    /// Shell imbalance on the roll, cos φ_s and sin φ_s [N·m].
    pub(in super::super) const IMBALANCE_ROLL: usize = 10;
    /// Slope of the floor along the first heading and to its left, M g R times its tangent [N·m].
    pub(in super::super) const SLOPE: usize = 12;
    /// I_fp [kg·m²].
    pub(in super::super) const I_FP: usize = 14;
    /// I_fu [kg·m²].
    pub(in super::super) const I_FU: usize = 15;
    /// Inertia of the pendulum about its long axis [kg·m²].
    pub(in super::super) const J_MU: usize = 16;
    /// How many.
    pub(in super::super) const COUNT: usize = 17;
}

use place::*;

/// Coefficients of the parameters, one row.
pub(super) type Row = SVector<f64, COUNT>;

/// The equations at one instant, rows (α, φ = x/R, β, q_r) [N·m]: p = Σ θ_j momentum_j, ṗ = Σ θ_j force_j + τ.
#[derive(Clone, Copy, Debug)]
pub(super) struct Terms {
    pub(super) momentum: [Row; 4],
    pub(super) force: [Row; 4],
    /// Shares of τ_p and τ_r.
    pub(super) torque: [[f64; 2]; 4],
}

/// Keeps the direction of rolling defined at rest, where the resistance is zero [m/s].
const REST: f64 = 1e-9;

type Vector = Vector3<f64>;

/// A body's angular velocity, and the partial ones of the four quasi-velocities with the derivatives of their directions.
struct Turning {
    rate: Vector,
    partial: [Vector; 4],
    partial_rate: [Vector; 4],
}

impl Turning {
    /// p_i and c_i of an inertia of 1 kg·m² about the body's `axis`, given its own derivative is not asked for: J turns with the body.
    fn inertia(&self, axis: &Vector) -> [[f64; 2]; 4] {
        let rate = axis.dot(&self.rate);
        core::array::from_fn(|i| {
            [
                rate * axis.dot(&self.partial[i]),
                rate * axis.dot(&self.partial_rate[i]),
            ]
        })
    }
}

/// The equations for `motion`; of `p` only R, g and v_rr are used.
pub(super) fn terms(p: &RobotParams, motion: &Motion) -> Terms {
    let m = motion;
    let ((sq, cq), (sa, ca)) = (m.q_r.sin_cos(), m.alpha.sin_cos());
    let (st, ct) = m.theta_r.sin_cos();
    let (r, rolling) = (p.r, m.v / p.r);
    let yaw_rate = rolling * sq / cq;

    let (f, l, z) = (Vector::x(), Vector::y(), Vector::z());
    let n = cq * l - sq * z;
    let mu = sq * l + cq * z;
    let (s, w) = (ca * f + sa * mu, ca * mu - sa * f);
    let (t, k) = (ct * n + st * w, ct * w - st * n);

    let lean = yaw_rate * z - m.q_r_rate * f;
    let frame_rate = lean - m.alpha_rate * n;
    let n_rate = lean.cross(&n);
    let s_rate = frame_rate.cross(&s);
    let f_rate = yaw_rate * l;
    let yaw = (sq / cq) * z;
    let yaw_direction_rate = (m.q_r_rate / (cq * cq)) * z;

    let frame = Turning {
        rate: frame_rate,
        partial: [-n, yaw, Vector::zeros(), -f],
        partial_rate: [-n_rate, yaw_direction_rate, Vector::zeros(), -f_rate],
    };
    let pendulum = Turning {
        rate: frame_rate + m.theta_r_rate * s,
        partial: [-n, yaw, s, s - f],
        partial_rate: [-n_rate, yaw_direction_rate, s_rate, s_rate - f_rate],
    };
    let shell = Turning {
        rate: rolling * l - m.q_r_rate * f,
        partial: [Vector::zeros(), l, Vector::zeros(), -f],
        partial_rate: [Vector::zeros(), -yaw_rate * f, Vector::zeros(), -f_rate],
    };
    let velocity = m.v * f + r * m.q_r_rate * l;
    let velocity_partial = [Vector::zeros(), r * f, Vector::zeros(), r * l];
    let velocity_partial_rate = [
        Vector::zeros(),
        r * yaw_rate * l,
        Vector::zeros(),
        -r * yaw_rate * f,
    ];

    let i_mr = pendulum.inertia(&s);
    let i_mp = pendulum.inertia(&t);
    let j_mu = pendulum.inertia(&k);
    let [i_fr, i_fp, i_fu] = [s, n, w].map(|axis| frame.inertia(&axis));
    // M and I_s only occur as M R² + I_s: the shell's momentum is that of the mass, turned by 90° and divided by R.
    let rolling_inertia = [l, f].map(|axis| shell.inertia(&axis));

    let mut terms = Terms {
        momentum: [Row::zeros(); 4],
        force: [Row::zeros(); 4],
        torque: [[1.0, 0.0], [1.0 / cq, 0.0], [0.0, 1.0], [0.0, 1.0]],
    };
    let bob = -k;
    let bob_rate = pendulum.rate.cross(&bob);
    for i in 0..4 {
        let (momentum, force) = (&mut terms.momentum[i], &mut terms.force[i]);
        let (partial, partial_rate) = (&pendulum.partial[i], &pendulum.partial_rate[i]);
        let (v_i, v_i_rate) = (&velocity_partial[i], &velocity_partial_rate[i]);
        momentum[ML] = velocity.dot(&partial.cross(&bob)) + v_i.dot(&bob_rate);
        force[ML] = velocity.dot(&(partial_rate.cross(&bob) + partial.cross(&bob_rate)))
            + v_i_rate.dot(&bob_rate)
            - p.g * z.dot(&partial.cross(&bob));
        momentum[A] = i_mr[i][0];
        force[A] = i_mr[i][1];
        // I_mp = a_p − I_fp.
        momentum[A_P] = i_mp[i][0];
        force[A_P] = i_mp[i][1];
        // I_fr = d − d_p.
        momentum[D] = i_fr[i][0];
        force[D] = i_fr[i][1];
        momentum[D_P] = rolling_inertia[0][i][0] + rolling_inertia[1][i][0] - i_fr[i][0];
        force[D_P] = rolling_inertia[0][i][1] + rolling_inertia[1][i][1] - i_fr[i][1];
        momentum[I_FP] = i_fp[i][0] - i_mp[i][0];
        force[I_FP] = i_fp[i][1] - i_mp[i][1];
        (momentum[I_FU], force[I_FU]) = (i_fu[i][0], i_fu[i][1]);
        (momentum[J_MU], force[J_MU]) = (j_mu[i][0], j_mu[i][1]);
    }

    // E13: joints resist their own rates, which enter where the motors do.
    let joints = [
        (m.theta_p_rate, m.pitch_sign),
        (m.theta_r_rate, m.roll_sign),
    ];
    for i in 0..4 {
        let (rate, sign) = joints[i / 2];
        let share = terms.torque[i][i / 2];
        terms.force[i][ZETA] = -share * rate;
        terms.force[i][COULOMB] = -share * sign;
    }
    // The floor resists along the direction of rolling.
    let sideways = r * m.q_r_rate;
    let speed = m.v.hypot(sideways);
    let resisting = (speed / p.v_rr).tanh() / (speed + REST);
    terms.force[1][T_RR] = -resisting * m.v;
    terms.force[3][T_RR] = -resisting * sideways;

    let (sin, cos) = m.phi_s.sin_cos();
    for (row, first) in [(1, IMBALANCE_PITCH), (3, IMBALANCE_ROLL)] {
        terms.force[row][first] = cos;
        terms.force[row][first + 1] = sin;
    }
    let (sin, cos) = m.heading.sin_cos();
    (terms.force[1][SLOPE], terms.force[1][SLOPE + 1]) = (-cos, -sin);
    (terms.force[3][SLOPE], terms.force[3][SLOPE + 1]) = (sin, -cos);
    terms
}
