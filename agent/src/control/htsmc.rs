//! Direction controller: hierarchical terminal sliding mode, eqs (7)-(17) of Liu et al.
//!
//! Differs from the paper:
//! - E1, E8, E13: the sub-model is the corrected one ([`crate::model`]).
//! - E2: the input gain is guarded at 0.15 B b₁; [`crate::gains`] has the conditions that replace A > B > 0.
//! - E5, E6: terminal terms as signed powers, regular at zero ([`sliding::sig`](super::sliding::sig)).
//! - E9: β_d uses q_rd, the turning mass with the shell's gyroscopic share, and a clamp; R_turn is never formed.
//! - E10: an integral in S₁, and the disturbance observer's ŵ in row q_r and in β_d.
//! - E11: sat(S/Φ) in place of sgn(S).
//! - E12: q̇_rd, q̈_rd come with the setpoint; β̇_d, β̈_d follow by the chain rule (v, α taken as constant).

use sphere_protocol::robot::{Robot, RobotParams};
use sphere_protocol::state::{RobotState, Setpoint};

use super::observer::{Disturbance, DisturbanceObserver, ObserverGains};
use super::sliding::{InputGain, ReachingLaw, sig};
use super::{Counters, DirectionController, OBSERVER_SHARE_MAX, is_usable};
use crate::gains::{GainsError, HtsmcGains, Refused};
use crate::model::NominalModel;

/// The direction controller of one robot.
#[derive(Clone, Debug)]
pub struct Htsmc {
    model: NominalModel,
    gains: HtsmcGains,
    memory: Memory,
    counters: Counters,
    last: HtsmcTerms,
}

/// What the law computes on its way to the torque.
#[derive(Clone, Copy, Debug, PartialEq, Default)]
pub struct HtsmcTerms {
    /// Swing that the turn needs.
    pub beta_d: PendulumTarget,
    /// S₁, control surface, eq (8) [rad/s].
    pub s1: f64,
    /// S₂, stability surface, eq (13) [rad/s].
    pub s2: f64,
    /// S = A S₁ + B S₂, eq (14) [rad/s].
    pub s: f64,
    /// A b₂ + B b₁, before the guard [1/(kg·m²)].
    pub gain: f64,
    /// Whether the guard of the gain acts.
    pub guarded: bool,
    /// τ_r, eq (17), before saturation [N·m].
    pub torque: f64,
}

/// A desired swing of the pendulum with its derivatives.
#[derive(Clone, Copy, Debug, PartialEq, Default)]
pub struct PendulumTarget {
    /// β_d [rad].
    pub angle: f64,
    /// β̇_d [rad/s].
    pub rate: f64,
    /// β̈_d [rad/s²].
    pub accel: f64,
}

/// What changes from step to step.
#[derive(Clone, Copy, Debug)]
struct Memory {
    integral: f64, // ∫ e_r dt [rad·s]
    observer: DisturbanceObserver,
    disturbance: Disturbance,
}

impl Htsmc {
    /// The controller with the gains of the robot's file.
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
        let observer = DisturbanceObserver::new(ObserverGains {
            bandwidth: gains.observer,
            oscillator: gains.oscillator,
            harmonic: gains.harmonic,
            harmonic_search: gains.harmonic_search,
            remainder: gains.remainder,
            remainder_share: gains.remainder_share,
            zero_squared: model.roll_inertia(0.0).zero_squared(model.righting),
            torque_max: OBSERVER_SHARE_MAX * params.torque_max,
        });
        Ok(Self {
            model,
            gains,
            memory: Memory {
                integral: 0.0,
                observer,
                disturbance: Disturbance::default(),
            },
            counters: Counters::default(),
            last: HtsmcTerms::default(),
        })
    }

    /// The disturbance ŵ that the last step used.
    pub fn disturbance(&self) -> Disturbance {
        self.memory.disturbance
    }

    /// What the last step that gave a torque computed: for telemetry and tests.
    pub fn terms(&self) -> HtsmcTerms {
        self.last
    }
}

impl DirectionController for Htsmc {
    fn step(&mut self, state: &RobotState, setpoint: &Setpoint, dt: f64) -> f64 {
        if !is_usable(state, setpoint, dt) {
            self.counters.not_finite = self.counters.not_finite.saturating_add(1);
            return 0.0;
        }
        // On a copy: finite input may still overflow, and what is not finite must not be remembered.
        let mut memory = self.memory;
        memory.disturbance = observe(&mut memory.observer, &self.model, state, dt);
        let terms = law(
            &self.model,
            &self.gains,
            state,
            setpoint,
            memory.integral,
            memory.disturbance,
        );
        if !terms.torque.is_finite() {
            self.counters.not_finite = self.counters.not_finite.saturating_add(1);
            return 0.0;
        }
        let error = state.q_r - setpoint.q_r;
        if terms.torque.abs() < self.model.params.torque_max && error.abs() < INTEGRATE_BELOW {
            memory.integral += error * dt;
        }
        self.memory = memory;
        self.last = terms;
        if terms.guarded {
            self.counters.gain_guard = self.counters.gain_guard.saturating_add(1);
        }
        self.counters
            .saturate(terms.torque, self.model.params.torque_max)
    }

    fn reset(&mut self) {
        self.memory.integral = 0.0;
        self.memory.observer.reset();
        self.memory.disturbance = Disturbance::default();
        self.last = HtsmcTerms::default();
    }

    fn counters(&self) -> Counters {
        self.counters
    }

    fn step_filter(&self) -> Option<f64> {
        Some(self.gains.w_ref)
    }
}

/// Steps the roll observer: the momentum that no torque changes, and the shell's rolling rate v/R.
pub fn observe(
    observer: &mut DisturbanceObserver,
    model: &NominalModel,
    state: &RobotState,
    dt: f64,
) -> Disturbance {
    let momentum = model.roll_momentum(state);
    observer.step(momentum.value, momentum.known, state.v / model.params.r, dt)
}

/// The law, eqs (8)-(17) as corrected, a pure function. `integral` is ∫ e_r dt [rad·s], `w` the disturbance on row q_r.
///
/// Uses of `state` v, α, β, q_r and the rates of the latter two; of `setpoint` the roll. Not finite where the input is not, or overflows.
pub fn law(
    model: &NominalModel,
    gains: &HtsmcGains,
    state: &RobotState,
    setpoint: &Setpoint,
    integral: f64,
    w: Disturbance,
) -> HtsmcTerms {
    let g = gains;
    let f = model.roll_submodel(state, w.torque);
    let beta_d = pendulum_target(model, state, setpoint, w);

    let e = state.q_r - setpoint.q_r;
    let e_rate = state.q_r_rate - setpoint.q_r_rate;
    let e_beta = state.beta - beta_d.angle;
    let e_beta_rate = state.beta_rate - beta_d.rate;
    let terminal1 = sig(e, g.gamma, g.mu);
    let terminal2 = sig(e_beta, g.gamma, g.mu);

    // (8) S₁ = ė + a₁ e + c₁ sig(e)^γ + k_i ∫e        (13) S₂ = ė_β + a₂ e_β + c₂ sig(e_β)^γ        (14) S = A S₁ + B S₂
    let s1 = e_rate + g.a1 * e + g.c1 * terminal1.value + g.k_i * integral;
    let s2 = e_beta_rate + g.a2 * e_beta + g.c2 * terminal2.value;
    let s = g.a * s1 + g.b * s2;

    // (15) Ṡ without its torque; sig′ in place of the printed (p/q) e^(1 − q/p) (E5)
    let s1_drift = f.f2 - setpoint.q_r_accel + (g.a1 + g.c1 * terminal1.slope) * e_rate + g.k_i * e;
    let s2_drift = f.f1 - beta_d.accel + (g.a2 + g.c2 * terminal2.slope) * e_beta_rate;
    let drift = g.a * s1_drift + g.b * s2_drift;

    // (16), (17) τ = −[drift + k S + ε sat(S/Φ)] / (A b₂ + B b₁)
    let reaching = ReachingLaw {
        k: g.k,
        epsilon: g.epsilon,
        phi: g.phi,
    };
    let gain = InputGain::guarded(g.a, f.b2, g.b, f.b1);
    HtsmcTerms {
        beta_d,
        s1,
        s2,
        s,
        gain: gain.raw,
        guarded: gain.is_guarded(),
        torque: -(drift + reaching.approach(s)) / gain.used,
    }
}

/// The swing that holds the turn, eq (12) as corrected (E9), against what the pendulum's weight must hold of the disturbance `w` ([`Disturbance::held`]):
///
/// sin β_d = κ tan q_rd − ŵ/G, κ = (M + I_s/R² − m l/R) v²/G, G = m g l cos α, clamped to ±0.8 (there the derivatives are zero);
/// β̇_d = (κ sec² q_rd q̇_rd − ŵ̇/G)/cos β_d;
/// β̈_d = [κ (sec² q_rd q̈_rd + 2 sec² q_rd tan q_rd q̇_rd²) − ŵ̈/G + sin β_d β̇_d²]/cos β_d.
pub fn pendulum_target(
    model: &NominalModel,
    state: &RobotState,
    setpoint: &Setpoint,
    w: Disturbance,
) -> PendulumTarget {
    let righting = model.righting * state.alpha.cos();
    let [held, held_rate, held_accel] = w.held();
    let kappa = (model.turning_mass - model.turning_mass_pendulum) * state.v * state.v / righting;
    let tan = setpoint.q_r.tan();
    let sec2 = 1.0 + tan * tan;
    let sin_beta = kappa * tan - held / righting;
    if sin_beta.abs() >= SIN_BETA_MAX {
        return PendulumTarget {
            angle: SIN_BETA_MAX.copysign(sin_beta).asin(),
            rate: 0.0,
            accel: 0.0,
        };
    }
    let angle = sin_beta.asin();
    let cos_beta = angle.cos();
    let rate = (kappa * sec2 * setpoint.q_r_rate - held_rate / righting) / cos_beta;
    let bend = sec2 * setpoint.q_r_accel + 2.0 * sec2 * tan * setpoint.q_r_rate * setpoint.q_r_rate;
    PendulumTarget {
        angle,
        rate,
        accel: (kappa * bend - held_accel / righting + sin_beta * rate * rate) / cos_beta,
    }
}

/// Clamp of sin β_d (E9): 53°.
pub(super) const SIN_BETA_MAX: f64 = 0.8;

/// Error below which the integral runs, 5° [rad]: it corrects a bias and leaves steps alone.
const INTEGRATE_BELOW: f64 = 5.0 * core::f64::consts::PI / 180.0;
