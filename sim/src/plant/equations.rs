//! Kane's equations of the plant, M u̇ + h = Q with u = (α̇, v, β̇, q̇_r), written out in components.
//!
//! # Rates
//! Every angular velocity is linear in u. Of the frame, on s, n, w (with φ̇ cos q_r = (v/R) sin q_r, φ̇ sin q_r = (v/R) sin q_r tan q_r):
//!
//! ```text
//! ω_s = −q̇_r cos α + (v/R) sin q_r sin α
//! ω_n = −α̇ − (v/R) sin q_r tan q_r
//! ω_w = q̇_r sin α + (v/R) sin q_r cos α
//! ```
//!
//! Of the pendulum, on s, t, k: p_s = ω_s + θ̇_r, p_t = cos θ_r ω_n + sin θ_r ω_w, p_k = cos θ_r ω_w − sin θ_r ω_n.
//! The coefficients of u in these are the partial angular velocities; those of V = v f + R q̇_r l the partial velocities.
//!
//! # Equations
//! All masses are referred to the sphere's centre, with the pendulum's inertia J = (I_mr, I_mp, J_mu) taken there. Let c be the
//! centre's acceleration plus gravity's upward g, and a dash mean "at u̇ = 0":
//!
//! ```text
//! c′ = (−R q̇_r φ̇) f + (v φ̇) l + g                                   the yaw frame turns with φ̇
//! N  = I ω̇′ + ω × I ω                                              frame, about its centre of mass = sphere's centre
//! L  = J ṗ′ + p × J p + m l (c′_t s − c′_s t)                      pendulum about the sphere's centre: r × m c′ with r = −l k
//! F  = M c′ + m l [ −(ṗ′_t + p_s p_k) s + (ṗ′_s − p_t p_k) t + (p_s² + p_t²) k ]     the bob's: ω̇ × r + ω × (ω × r)
//! h_i = F · ∂V/∂u_i + N · ∂ω/∂u_i + L · ∂p/∂u_i + (shell)
//! ```
//!
//! The shell is isotropic: ½ I_s (q̇_r² + v²/R²), and its momentum I_s (−q̇_r f + (v/R) l) turns with φ̇, hence −I_s φ̇ q̇_r/R on row v and
//! +I_s φ̇ v/R on row q_r. With ∂ṙ/∂u_i = l (∂p_s t − ∂p_t s) for the bob's velocity against the centre,
//!
//! ```text
//! M_ij = M V_i·V_j + (shell) + ω_i·I ω_j + p_i·J p_j + m (V_i·ṙ_j + V_j·ṙ_i)         V_i = ∂V/∂u_i, and so on
//! ```
//!
//! β̇ turns the pendulum about s alone and α̇ about n alone, so M_αβ = 0: with both eliminated, two equations for v̇, q̈_r remain.

use sphere_protocol::robot::RobotParams;
use sphere_protocol::state::RobotState;

use super::Accelerations;
use super::attitude::Attitude;

/// M (symmetric) and h of M u̇ + h = Q, rows and columns (α̇, v, β̇, q̇_r); SI.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Equations {
    /// Bias: Coriolis, centripetal and gyroscopic terms and gravity, but no friction [N·m, N, N·m, N·m].
    pub h: [f64; 4],
    // Upper triangle of M; a, v, b, q for α, v, β, q_r. M_ab = 0.
    aa: f64,
    av: f64,
    aq: f64,
    vv: f64,
    vb: f64,
    vq: f64,
    bb: f64,
    bq: f64,
    qq: f64,
}

/// Directions and partial angular velocities: all that depends on the angles alone.
#[derive(Clone, Copy, Debug)]
pub(super) struct Geometry {
    /// ∂φ̇/∂v = tan q_r / R [rad/m].
    pub(super) yaw_v: f64,
    /// ∂φ̇_s/∂v = 1 / (R cos q_r) [rad/m].
    pub(super) shell_v: f64,
    sq: f64,
    cq: f64,
    ca: f64,
    sa: f64,
    ct: f64,
    st: f64,
    /// Axes of the pendulum on f, l, z.
    pub(super) s: [f64; 3],
    t: [f64; 3],
    pub(super) k: [f64; 3],
    /// ∂ω/∂v on s, n, w [rad/m]. The others: ∂ω/∂α̇ = (0, −1, 0), ∂ω/∂q̇_r = (−cos α, 0, sin α).
    frame_v: [f64; 3],
    /// ∂p/∂v on s, t, k [rad/m]. The others: ∂p/∂α̇ = (0, −cos θ_r, sin θ_r), ∂p/∂β̇ = (1, 0, 0).
    pendulum_v: [f64; 3],
    /// ∂p/∂q̇_r on s, t, k [1].
    pendulum_q: [f64; 3],
}

impl Geometry {
    pub(super) fn of(attitude: &Attitude, radius: f64) -> Self {
        let (sq, cq) = (attitude.q_r.sin, attitude.q_r.cos);
        let (sa, ca) = (attitude.alpha.sin, attitude.alpha.cos);
        let (st, ct) = (attitude.theta_r.sin, attitude.theta_r.cos);
        let shell_v = 1.0 / (radius * cq);
        let yaw_v = sq * shell_v;
        let per_radius = cq * yaw_v;
        let frame_v = [per_radius * sa, -sq * yaw_v, per_radius * ca];
        Self {
            yaw_v,
            shell_v,
            sq,
            cq,
            ca,
            sa,
            ct,
            st,
            s: [ca, sa * sq, sa * cq],
            t: [-st * sa, ct * cq + st * ca * sq, st * ca * cq - ct * sq],
            k: [-ct * sa, ct * ca * sq - st * cq, ct * ca * cq + st * sq],
            frame_v,
            pendulum_v: [
                frame_v[0],
                ct * frame_v[1] + st * frame_v[2],
                ct * frame_v[2] - st * frame_v[1],
            ],
            pendulum_q: [1.0 - ca, st * sa, ct * sa],
        }
    }

    /// Left axis of the frame on f, l, z.
    pub(super) fn n(&self) -> [f64; 3] {
        [0.0, self.cq, -self.sq]
    }

    /// Up axis of the frame on f, l, z.
    pub(super) fn w(&self) -> [f64; 3] {
        [-self.sa, self.ca * self.sq, self.ca * self.cq]
    }

    /// Angular velocity of the frame on s, n, w [rad/s].
    pub(super) fn frame_rates(&self, state: &RobotState) -> [f64; 3] {
        [
            self.frame_v[0] * state.v - self.ca * state.q_r_rate,
            self.frame_v[1] * state.v - state.alpha_rate,
            self.frame_v[2] * state.v + self.sa * state.q_r_rate,
        ]
    }
}

impl Equations {
    /// The equations at a state; `g` is gravity's upward acceleration on f, l, z [m/s²].
    pub(super) fn of(p: &RobotParams, state: &RobotState, geo: &Geometry, g: [f64; 3]) -> Self {
        let h = bias(p, state, geo, g);
        let &Geometry {
            ca,
            sa,
            ct,
            st,
            s,
            t,
            frame_v: fv,
            pendulum_v: pv,
            pendulum_q: pq,
            ..
        } = geo;
        let (r, mass, ml) = (p.r, p.total_mass(), p.m * p.l);
        let inertia = [p.i_mr(), p.i_mp(), p.j_mu];
        // m ∂ṙ/∂u_i on f or l (index 0 or 1 of the axes), from the partial rates about s and t.
        let bob =
            |about_s: f64, about_t: f64, axis: usize| ml * (about_s * t[axis] - about_t * s[axis]);
        Self {
            h,
            aa: p.i_fp + inertia[1] * ct * ct + inertia[2] * st * st,
            av: -p.i_fp * fv[1] - inertia[1] * ct * pv[1]
                + inertia[2] * st * pv[2]
                + bob(0.0, -ct, 0),
            aq: -inertia[1] * ct * pq[1] + inertia[2] * st * pq[2] + r * bob(0.0, -ct, 1),
            vv: mass
                + p.i_s / (r * r)
                + p.i_fr * fv[0] * fv[0]
                + p.i_fp * fv[1] * fv[1]
                + p.i_fu * fv[2] * fv[2]
                + weighted(inertia, pv, pv)
                + 2.0 * bob(pv[0], pv[1], 0),
            vb: inertia[0] * pv[0] + bob(1.0, 0.0, 0),
            vq: p.i_fu * fv[2] * sa - p.i_fr * fv[0] * ca
                + weighted(inertia, pv, pq)
                + bob(pq[0], pq[1], 0)
                + r * bob(pv[0], pv[1], 1),
            bb: inertia[0],
            bq: inertia[0] * pq[0] + r * bob(1.0, 0.0, 1),
            qq: mass * r * r
                + p.i_s
                + p.i_fr * ca * ca
                + p.i_fu * sa * sa
                + weighted(inertia, pq, pq)
                + 2.0 * r * bob(pq[0], pq[1], 1),
        }
    }

    /// M, rows and columns (α̇, v, β̇, q̇_r); symmetric and positive definite while |q_r| < 90°.
    pub fn mass_matrix(&self) -> [[f64; 4]; 4] {
        let Self {
            aa,
            av,
            aq,
            vv,
            vb,
            vq,
            bb,
            bq,
            qq,
            ..
        } = *self;
        [
            [aa, av, 0.0, aq],
            [av, vv, vb, vq],
            [0.0, vb, bb, bq],
            [aq, vq, bq, qq],
        ]
    }

    /// u̇ = M⁻¹ (Q − h).
    pub fn solve(&self, forces: [f64; 4]) -> Accelerations {
        let Self {
            aa,
            av,
            aq,
            vv,
            vb,
            vq,
            bb,
            bq,
            qq,
            h,
        } = *self;
        let [fa, fv, fb, fq] = [
            forces[0] - h[0],
            forces[1] - h[1],
            forces[2] - h[2],
            forces[3] - h[3],
        ];
        // α and β eliminated: the Schur complement of their (diagonal) block, and its right side.
        let (per_aa, per_bb) = (1.0 / aa, 1.0 / bb);
        let (v_per_a, q_per_a) = (av * per_aa, aq * per_aa);
        let (v_per_b, q_per_b) = (vb * per_bb, bq * per_bb);
        let svv = vv - v_per_a * av - v_per_b * vb;
        let svq = vq - v_per_a * aq - v_per_b * bq;
        let sqq = qq - q_per_a * aq - q_per_b * bq;
        let rv = fv - v_per_a * fa - v_per_b * fb;
        let rq = fq - q_per_a * fa - q_per_b * fb;
        let per_det = 1.0 / (svv * sqq - svq * svq);
        let v = (sqq * rv - svq * rq) * per_det;
        let q_r = (svv * rq - svq * rv) * per_det;
        Accelerations {
            alpha: (fa - av * v - aq * q_r) * per_aa,
            v,
            beta: (fb - vb * v - bq * q_r) * per_bb,
            q_r,
        }
    }
}

/// h on the rows (α, v, β, q_r).
fn bias(p: &RobotParams, state: &RobotState, geo: &Geometry, g: [f64; 3]) -> [f64; 4] {
    let &Geometry {
        sq,
        cq,
        ca,
        sa,
        ct,
        st,
        s,
        t,
        k,
        ..
    } = geo;
    let &Geometry {
        frame_v: fv,
        pendulum_v: pv,
        pendulum_q: pq,
        ..
    } = geo;
    let &RobotState {
        v,
        q_r_rate: qd,
        alpha_rate: ad,
        beta_rate: bd,
        ..
    } = state;
    let (r, mass, ml) = (p.r, p.total_mass(), p.m * p.l);
    let inertia = [p.i_mr(), p.i_mp(), p.j_mu];
    let (roll_rate, theta_rate) = (v / r, bd + qd);
    let yaw_rate = v * geo.yaw_v;

    let omega = geo.frame_rates(state);
    let pend = [
        omega[0] + theta_rate,
        ct * omega[1] + st * omega[2],
        ct * omega[2] - st * omega[1],
    ];

    // ω̇′ and ṗ′: the rates above differentiated at constant u; d(sin q tan q)/dq = sin q + tan q / cos q.
    let omega_dot = [
        qd * ad * sa + roll_rate * (cq * qd * sa + sq * ca * ad),
        -qd * (roll_rate * sq + yaw_rate / cq),
        qd * ad * ca + roll_rate * (cq * qd * ca - sq * sa * ad),
    ];
    let pend_dot = [
        omega_dot[0],
        ct * omega_dot[1] + st * omega_dot[2] + theta_rate * pend[2],
        ct * omega_dot[2] - st * omega_dot[1] - theta_rate * pend[1],
    ];

    // c′ on f, l, z, then on s and t.
    let c = [g[0] - r * qd * yaw_rate, g[1] + v * yaw_rate, g[2]];
    let c_s = c[0] * s[0] + c[1] * s[1] + c[2] * s[2];
    let c_t = c[0] * t[0] + c[1] * t[1] + c[2] * t[2];

    let n = euler([p.i_fr, p.i_fp, p.i_fu], omega_dot, omega);
    let mut l = euler(inertia, pend_dot, pend);
    l[0] += ml * c_t;
    l[1] -= ml * c_s;

    let bob = [
        -ml * (pend_dot[1] + pend[0] * pend[2]),
        ml * (pend_dot[0] - pend[1] * pend[2]),
        ml * (pend[0] * pend[0] + pend[1] * pend[1]),
    ];
    let force_f = mass * c[0] + bob[0] * s[0] + bob[1] * t[0] + bob[2] * k[0];
    let force_l = mass * c[1] + bob[0] * s[1] + bob[1] * t[1] + bob[2] * k[1];

    [
        -n[1] - ct * l[1] + st * l[2],
        force_f + dot(fv, n) + dot(pv, l) - p.i_s * yaw_rate * qd / r,
        l[0],
        r * force_l - ca * n[0] + sa * n[2] + dot(pq, l) + p.i_s * yaw_rate * roll_rate,
    ]
}

/// Euler's equations on principal axes, I ω̇ + ω × I ω [N·m].
fn euler(inertia: [f64; 3], rate_dot: [f64; 3], rate: [f64; 3]) -> [f64; 3] {
    [
        inertia[0] * rate_dot[0] + (inertia[2] - inertia[1]) * rate[1] * rate[2],
        inertia[1] * rate_dot[1] + (inertia[0] - inertia[2]) * rate[2] * rate[0],
        inertia[2] * rate_dot[2] + (inertia[1] - inertia[0]) * rate[0] * rate[1],
    ]
}

fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

fn weighted(weight: [f64; 3], a: [f64; 3], b: [f64; 3]) -> f64 {
    weight[0] * a[0] * b[0] + weight[1] * a[1] * b[1] + weight[2] * a[2] * b[2]
}
