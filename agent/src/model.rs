//! The agent's nominal model: the two planar sub-models of eqs (5)-(7), as corrected, and what the observers need of them.
//!
//! Both sub-models are a pendulum hung in a rolling body: rows (pendulum, shell), coordinates (β, q_r) in roll and
//! (α, φ = x/R) in pitch, one motor torque that acts on both rows:
//!
//! ```text
//!     | a  c | | pendulum'' |   | N₁ |   | 1 |       | 0 |
//!     | c  d | | shell''    | + | N₂ | = | 1 | τ  +  | w |      c = m R l cos(pendulum)
//! ```
//!
//! w is whatever else turns the shell; the observers estimate it. Differs from the paper:
//! - E1: the printed mass matrix has 0 instead of c in its lower left, so that b₂ has the wrong sign everywhere; it is symmetric here.
//! - E8: the "friction" forces F_fp, F_fr are rolling resistance in pitch, and in roll the inertial turning term
//!   (M + I_s/R²) v² tan q_r, with the gyroscopic I_s that the paper leaves out and its share (m l/R) v² tan q_r cos β on the pendulum.
//! - E13: a bearing is damped by its relative rate: ζ(α̇ + v/R), ζ(β̇ + q̇_r), in both rows.

pub mod printed;
pub mod whole_body;

use sphere_protocol::robot::RobotParams;
use sphere_protocol::state::RobotState;

/// Constants of one robot's nominal model. Masses and inertias of [`RobotParams`] enter here and nowhere else in the agent.
#[derive(Clone, Copy, Debug)]
pub struct NominalModel {
    /// The parameters from which it was made.
    pub params: RobotParams,
    /// M + I_s/R²: what the turning force carries, with the shell's gyroscopic share [kg].
    pub turning_mass: f64,
    /// m l/R: the share of it that the pendulum takes off [kg].
    pub turning_mass_pendulum: f64,
    /// m g l: righting moment of the pendulum at 90° [N·m].
    pub righting: f64,
    /// m R l: coupling of pendulum and shell at rest [kg·m²].
    pub coupling: f64,
}

/// Inertia of one planar sub-model, M = [[a, c], [c, d]] [kg·m²].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PlanarInertia {
    /// Pendulum, about the sphere's centre (in pitch with the frame, which swings along).
    pub a: f64,
    /// Coupling, m R l cos of the swing angle.
    pub c: f64,
    /// Shell and everything that rolls with it, about the contact point.
    pub d: f64,
}

/// State-space form of eq (7): pendulum'' = f₁ + b₁ τ, shell'' = f₂ + b₂ τ.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SubModel {
    /// Free acceleration of the pendulum [rad/s²].
    pub f1: f64,
    /// Free acceleration of the shell (in roll: of the lean q_r) [rad/s²].
    pub f2: f64,
    /// Input gain of the pendulum [1/(kg·m²)].
    pub b1: f64,
    /// Input gain of the shell [1/(kg·m²)]: < 0 near the vertical, the wrong-way start (E7).
    pub b2: f64,
}

impl NominalModel {
    /// The nominal model of a robot.
    pub fn new(params: &RobotParams) -> Self {
        let p = *params;
        Self {
            params: p,
            turning_mass: p.total_mass() + p.i_s / (p.r * p.r),
            turning_mass_pendulum: p.m * p.l / p.r,
            righting: p.m * p.g * p.l,
            coupling: p.m * p.r * p.l,
        }
    }

    /// Inertia of the roll sub-model at swing `beta` [rad]; d = I_s + I_fr + M R².
    pub fn roll_inertia(&self, beta: f64) -> PlanarInertia {
        let p = &self.params;
        PlanarInertia {
            a: p.i_mr(),
            c: self.coupling * beta.cos(),
            d: p.i_s + p.i_fr + p.total_mass() * p.r * p.r,
        }
    }

    /// Inertia of the pitch sub-model at swing `alpha` [rad]; a_p = I_mp + I_fp, d_p = I_s + M R².
    pub fn pitch_inertia(&self, alpha: f64) -> PlanarInertia {
        let p = &self.params;
        PlanarInertia {
            a: p.i_mp() + p.i_fp,
            c: self.coupling * alpha.cos(),
            d: p.i_s + p.total_mass() * p.r * p.r,
        }
    }

    /// Largest |α̈| that full torque and the whole weight give together, from the vertical and at rest: b₁ τ_max + d_p m g l/(a_p d_p − c²) [rad/s²].
    pub fn pitch_accel_max(&self) -> f64 {
        let free = self.pitch_inertia(0.0).submodel([-self.righting, 0.0]);
        free.accelerations(self.params.torque_max)[0]
    }

    /// Rows (β, q_r) of N, eq (6) as corrected [N·m]:
    ///
    /// N₃ = m g l cos α sin β + ζ(β̇ + q̇_r) + (m l/R) v² tan q_r cos β
    /// N₄ = −m R l β̇² sin β + ζ(β̇ + q̇_r) + (M + I_s/R²) v² tan q_r
    pub fn roll_forces(&self, state: &RobotState) -> [f64; 2] {
        let (sin_beta, cos_beta) = state.beta.sin_cos();
        let damping = self.params.zeta * (state.beta_rate + state.q_r_rate); // E13
        let turning = state.v * state.v * state.q_r.tan(); // E8
        [
            self.righting * state.alpha.cos() * sin_beta
                + damping
                + self.turning_mass_pendulum * turning * cos_beta,
            -self.coupling * state.beta_rate * state.beta_rate * sin_beta
                + damping
                + self.turning_mass * turning,
        ]
    }

    /// Rows (α, φ) of N, eq (5) as corrected, without the [`NominalModel::turning_drive`] [N·m]:
    ///
    /// N_a = m g l sin α cos β + ζ(α̇ + v/R)
    /// N_p = −m R l α̇² sin α + ζ(α̇ + v/R) + F_r
    pub fn pitch_forces(&self, state: &RobotState) -> [f64; 2] {
        let sin_alpha = state.alpha.sin();
        let damping = self.params.zeta * (state.alpha_rate + state.v / self.params.r); // E13
        [
            self.righting * sin_alpha * state.beta.cos() + damping,
            -self.coupling * state.alpha_rate * state.alpha_rate * sin_alpha
                + damping
                + self.rolling_resistance(state.v),
        ]
    }

    /// F_r = c_rr M g R tanh(v/v_rr), rolling resistance on the pitch row [N·m] (E8; smooth through v = 0).
    pub fn rolling_resistance(&self, v: f64) -> f64 {
        let p = &self.params;
        p.c_rr * p.total_mass() * p.g * p.r * (v / p.v_rr).tanh()
    }

    /// Torque with which turning drives the shell forward, R [(M + I_s/R²) q̇_r + (m l/R) β̇ cos β] v tan q_r [N·m].
    ///
    /// The reciprocal of the turning terms in roll (E8): without it, leaning into a turn would create energy.
    pub fn turning_drive(&self, state: &RobotState) -> f64 {
        let rate = self.turning_mass * state.q_r_rate
            + self.turning_mass_pendulum * state.beta_rate * state.beta.cos();
        self.params.r * rate * state.v * state.q_r.tan()
    }

    /// Roll sub-model at `state` under a torque `w` [N·m] on the row q_r.
    pub fn roll_submodel(&self, state: &RobotState, w: f64) -> SubModel {
        let [n3, n4] = self.roll_forces(state);
        self.roll_inertia(state.beta).submodel([n3, n4 - w])
    }

    /// Pitch sub-model at `state` under a torque `w` [N·m] on the row φ.
    pub fn pitch_submodel(&self, state: &RobotState, w: f64) -> SubModel {
        let [n_a, n_p] = self.pitch_forces(state);
        self.pitch_inertia(state.alpha).submodel([n_a, n_p - w])
    }

    /// Shell row minus pendulum row of the roll sub-model, integrated: the motor torque and the damping cancel.
    ///
    /// p = (d − c) q̇_r + (c − a) β̇ [kg·m²/s], ṗ = known + w,
    /// known = m g l cos α sin β + ((m l/R) cos β − (M + I_s/R²)) v² tan q_r + m R l sin β β̇ q̇_r [N·m].
    pub fn roll_momentum(&self, state: &RobotState) -> Momentum {
        let inertia = self.roll_inertia(state.beta);
        let (sin_beta, cos_beta) = state.beta.sin_cos();
        let turning = state.v * state.v * state.q_r.tan();
        Momentum {
            value: inertia.momentum(state.beta_rate, state.q_r_rate),
            known: self.righting * state.alpha.cos() * sin_beta
                + (self.turning_mass_pendulum * cos_beta - self.turning_mass) * turning
                + self.coupling * sin_beta * state.beta_rate * state.q_r_rate,
        }
    }

    /// The same of the pitch sub-model.
    ///
    /// p = (d_p − c) v/R + (c − a_p) α̇ [kg·m²/s],
    /// known = m g l sin α cos β − F_r + m l sin α α̇ v + [`NominalModel::turning_drive`] [N·m].
    pub fn pitch_momentum(&self, state: &RobotState) -> Momentum {
        let inertia = self.pitch_inertia(state.alpha);
        let sin_alpha = state.alpha.sin();
        let rolling = state.v / self.params.r;
        Momentum {
            value: inertia.momentum(state.alpha_rate, rolling),
            known: self.righting * sin_alpha * state.beta.cos() - self.rolling_resistance(state.v)
                + self.coupling * sin_alpha * state.alpha_rate * rolling
                + self.turning_drive(state),
        }
    }
}

/// What a momentum observer is fed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Momentum {
    /// The momentum p that no motor torque changes [kg·m²/s].
    pub value: f64,
    /// Its modelled rate [N·m]; the rest of ṗ is the disturbance.
    pub known: f64,
}

impl PlanarInertia {
    /// f = −M⁻¹ N and b = M⁻¹ [1 1]ᵀ of eq (7), for the rows `n` [N·m].
    pub fn submodel(&self, n: [f64; 2]) -> SubModel {
        SubModel::from_rows([[self.a, self.c], [self.c, self.d]], n)
    }

    /// Largest A/B for which A b₂ + B b₁ > 0: (d − c)/(c − a); infinite where b₂ ≥ 0 (E2).
    pub fn ratio_max(&self) -> f64 {
        if self.c > self.a {
            (self.d - self.c) / (self.c - self.a)
        } else {
            f64::INFINITY
        }
    }

    /// Square of the zero from torque to shell, G/(c − a) for the righting moment `righting` G [N·m], [1/s²] (E7); 0 if there is none.
    pub fn zero_squared(&self, righting: f64) -> f64 {
        if self.c > self.a {
            righting / (self.c - self.a)
        } else {
            0.0
        }
    }

    fn momentum(&self, pendulum_rate: f64, shell_rate: f64) -> f64 {
        (self.d - self.c) * shell_rate + (self.c - self.a) * pendulum_rate
    }
}

impl SubModel {
    /// f = −M⁻¹ N and b = M⁻¹ [1 1]ᵀ by Cramer's rule; `m` row major, its rows in the units of `n`.
    pub(crate) fn from_rows(m: [[f64; 2]; 2], n: [f64; 2]) -> Self {
        let [[m11, m12], [m21, m22]] = m;
        let [n1, n2] = n;
        let det = m11 * m22 - m12 * m21;
        Self {
            f1: (-m22 * n1 + m12 * n2) / det,
            f2: (m21 * n1 - m11 * n2) / det,
            b1: (m22 - m12) / det,
            b2: (m11 - m21) / det,
        }
    }

    /// Accelerations (pendulum'', shell'') under `torque` [N·m].
    pub fn accelerations(&self, torque: f64) -> [f64; 2] {
        [self.f1 + self.b1 * torque, self.f2 + self.b2 * torque]
    }
}
