//! Direction controller as the paper prints it, eqs (8)-(17), to compare with: no observer, no integral, no boundary layer.
//!
//! Only what it cannot run without is corrected:
//! - E1: the mass matrix is symmetric. With the printed 0 in its lower left and A/B = 5.2 (which
//!   the printed condition A > B > 0 allows) a step of 10°, filtered at 10 rad/s, overshoots by 8°, rings for 14 s at 0.5 m/s and
//!   ends in a limit cycle of ±8.7° at 1.0 m/s. With A/B = 4 it stands, after 7° of overshoot and up to 10 s.
//! - E5, E6: signed powers, regular at zero ([`sig`]): the printed ones are NaN for every e ≤ 0, the first step included.
//! - E9: (12) with q_rd, as its text has it: with the q_r that is printed there, β̈_d would need the q̈_r that the torque is to bring about.
//!   Clamped to ±0.8, for arcsin has no more than ±1.
//! - E12: q̇_rd, q̈_rd come with the setpoint, β̇_d and β̈_d by the chain rule: (17) uses them and nothing in the paper supplies them.
//!
//! As printed remain, each with what it costs on the whole robot (steps of 10° at 0.5 and 1.0 m/s):
//! - E2, E3, E4: no guard of the input gain; the *gains* are those of `[htsmc]`, which meet all three, or it would fall over.
//! - E8, E13: forces of (6), (10), (11) without the shell's gyroscopic part and the pendulum's share; (12) with M alone. It stands, 0.06°
//!   and 0.12° off where nothing disturbs it.
//! - E10: no integral, no observer: that bias stays, and a shell imbalance of 2.3 N·m makes a wobble of 1.9° and 1.7° rms, as much as the
//!   paper's robot shows (1.7° and 1.5°).
//! - E11: sgn(S). It stands; at 0.5 m/s its torque moves by 29 N·m/s instead of 18, by 15 instead of 0 without noise: chatter.
//!
//! The rest is not this law's: E7 is physics, E14 names, E15 and E16 kinematics and missions.

use sphere_protocol::robot::{Robot, RobotParams};
use sphere_protocol::state::{RobotState, Setpoint};

use super::htsmc::{HtsmcTerms, PendulumTarget, SIN_BETA_MAX};
use super::sliding::sig;
use super::{Counters, DirectionController, is_usable};
use crate::gains::{GainsError, HtsmcGains, Refused};
use crate::model::{NominalModel, SubModel};

/// The direction controller of one robot, as printed.
#[derive(Clone, Debug)]
pub struct HtsmcPaper {
    model: NominalModel,
    gains: HtsmcGains,
    counters: Counters,
    last: HtsmcTerms,
}

impl HtsmcPaper {
    /// The controller with the gains of the robot's section `[htsmc]`; Φ, k_i and the observer's are not used.
    ///
    /// # Errors
    /// Gains that cannot be read, or that violate a condition, with the numbers.
    pub fn from_robot(robot: &Robot) -> Result<Self, GainsError> {
        Self::new(&robot.params, HtsmcGains::read(robot)?)
            .map_err(|error| GainsError::refused(robot, error))
    }

    /// The controller with `gains`.
    ///
    /// # Errors
    /// Every condition that the gains violate for this robot.
    pub fn new(params: &RobotParams, gains: HtsmcGains) -> Result<Self, Refused> {
        let model = NominalModel::new(params);
        let gains = gains.checked(&model)?;
        Ok(Self {
            model,
            gains,
            counters: Counters::default(),
            last: HtsmcTerms::default(),
        })
    }

    /// What the last step that gave a torque computed: for telemetry and tests.
    pub fn terms(&self) -> HtsmcTerms {
        self.last
    }
}

impl DirectionController for HtsmcPaper {
    fn step(&mut self, state: &RobotState, setpoint: &Setpoint, dt: f64) -> f64 {
        if !is_usable(state, setpoint, dt) {
            self.counters.not_finite = self.counters.not_finite.saturating_add(1);
            return 0.0;
        }
        let submodel = self
            .model
            .roll_inertia(state.beta)
            .submodel(self.model.printed_roll_forces(state));
        let terms = law(&self.model, &self.gains, submodel, state, setpoint);
        if !terms.torque.is_finite() {
            self.counters.not_finite = self.counters.not_finite.saturating_add(1);
            return 0.0;
        }
        self.last = terms;
        self.counters
            .saturate(terms.torque, self.model.params.torque_max)
    }

    fn reset(&mut self) {
        self.last = HtsmcTerms::default();
    }

    fn counters(&self) -> Counters {
        self.counters
    }

    fn step_filter(&self) -> Option<f64> {
        Some(self.gains.w_ref)
    }
}

/// The law, eqs (8)-(17), a pure function of state, setpoint and the sub-model `f` of eq (7).
///
/// Not finite where the input is not, or overflows.
pub fn law(
    model: &NominalModel,
    gains: &HtsmcGains,
    f: SubModel,
    state: &RobotState,
    setpoint: &Setpoint,
) -> HtsmcTerms {
    let g = gains;
    let beta_d = printed_target(model, state, setpoint);

    let e = state.q_r - setpoint.q_r;
    let e_rate = state.q_r_rate - setpoint.q_r_rate;
    let e_beta = state.beta - beta_d.angle;
    let e_beta_rate = state.beta_rate - beta_d.rate;
    let terminal1 = sig(e, g.gamma, g.mu);
    let terminal2 = sig(e_beta, g.gamma, g.mu);

    // (8) S₁ = ė + a₁ e + c₁ e^(p/q)        (13) S₂ = ė_β + a₂ e_β + c₂ e_β^(p/q)        (14) S = A S₁ + B S₂
    let s1 = e_rate + g.a1 * e + g.c1 * terminal1.value;
    let s2 = e_beta_rate + g.a2 * e_beta + g.c2 * terminal2.value;
    let s = g.a * s1 + g.b * s2;

    // (15) Ṡ without its torque
    let s1_drift = f.f2 - setpoint.q_r_accel + (g.a1 + g.c1 * terminal1.slope) * e_rate;
    let s2_drift = f.f1 - beta_d.accel + (g.a2 + g.c2 * terminal2.slope) * e_beta_rate;
    let drift = g.a * s1_drift + g.b * s2_drift;

    // (16), (17) τ = −[drift + k S + ε sgn(S)] / (A b₂ + B b₁)
    let gain = g.a * f.b2 + g.b * f.b1;
    HtsmcTerms {
        beta_d,
        s1,
        s2,
        s,
        gain,
        guarded: false,
        torque: -(drift + g.k * s + g.epsilon * sgn(s)) / gain,
    }
}

/// (12) sin β_d = M v² tan q_rd/(m g l cos α), clamped to ±0.8 (there the derivatives are zero), and its derivatives with v, α held.
fn printed_target(model: &NominalModel, state: &RobotState, setpoint: &Setpoint) -> PendulumTarget {
    let kappa =
        model.params.total_mass() * state.v * state.v / (model.righting * state.alpha.cos());
    let tan = setpoint.q_r.tan();
    let sec2 = 1.0 + tan * tan;
    let sin_beta = kappa * tan;
    if sin_beta.abs() >= SIN_BETA_MAX {
        return PendulumTarget {
            angle: SIN_BETA_MAX.copysign(sin_beta).asin(),
            rate: 0.0,
            accel: 0.0,
        };
    }
    let angle = sin_beta.asin();
    let cos_beta = angle.cos();
    let rate = kappa * sec2 * setpoint.q_r_rate / cos_beta;
    let bend = sec2 * setpoint.q_r_accel + 2.0 * sec2 * tan * setpoint.q_r_rate * setpoint.q_r_rate;
    PendulumTarget {
        angle,
        rate,
        accel: (kappa * bend + sin_beta * rate * rate) / cos_beta,
    }
}

/// sgn(x), 0 at 0.
fn sgn(x: f64) -> f64 {
    if x == 0.0 { 0.0 } else { x.signum() }
}
