//! Velocity controller: hierarchical sliding mode on the pitch sub-model, eq (5).
//!
//! The paper takes it from earlier work and prints neither law nor gains. This one has the structure of the direction controller
//! and the reaching law that the two share, eq (16): S₁ on the speed with its integral, S₂ on the pendulum, S = A S₁ + B S₂.
//! Beyond it: a disturbance observer of its own (a shell's imbalance otherwise ripples the speed), and α̇_d, α̈_d in S₂.

use sphere_protocol::robot::{Robot, RobotParams};
use sphere_protocol::state::{RobotState, Setpoint};

use super::observer::{Disturbance, DisturbanceObserver, ObserverGains};
use super::sliding::{InputGain, ReachingLaw};
use super::{Counters, OBSERVER_SHARE_MAX, is_usable};
use crate::gains::{GainsError, HsmcGains, Refused};
use crate::model::NominalModel;

/// The velocity controller of one robot.
#[derive(Clone, Debug)]
pub struct Hsmc {
    model: NominalModel,
    gains: HsmcGains,
    memory: Memory,
    counters: Counters,
    last: HsmcTerms,
}

/// Higher derivatives of a speed reference.
///
/// Give them only where v̇_d is continuous (a smooth filter, an analytic reference): between the jumps of a v̇_d that jumps they
/// promise a motion that never comes. Zero means "not known".
#[derive(Clone, Copy, Debug, PartialEq, Default)]
pub struct SpeedShape {
    /// v̈_d [m/s³].
    pub accel_rate: f64,
    /// Its derivative [m/s⁴].
    pub accel_rate_rate: f64,
}

/// What the law computes on its way to the torque.
#[derive(Clone, Copy, Debug, PartialEq, Default)]
pub struct HsmcTerms {
    /// α_d, swing that the acceleration needs [rad].
    pub alpha_d: f64,
    /// Its rate α̇_d [rad/s].
    pub alpha_d_rate: f64,
    /// Its second derivative α̈_d [rad/s²].
    pub alpha_d_accel: f64,
    /// S₁, speed surface [rad/s].
    pub s1: f64,
    /// S₂, pendulum surface [rad/s].
    pub s2: f64,
    /// S = A S₁ + B S₂ [rad/s].
    pub s: f64,
    /// A b_φ + B b_α, before the guard [1/(kg·m²)].
    pub gain: f64,
    /// Whether the guard of the gain acts.
    pub guarded: bool,
    /// τ_p before saturation [N·m].
    pub torque: f64,
}

/// What changes from step to step.
#[derive(Clone, Copy, Debug)]
struct Memory {
    integral: f64, // ∫ e_v dt [rad]
    observer: DisturbanceObserver,
    disturbance: Disturbance,
}

impl Hsmc {
    /// The controller with the gains of the robot's file.
    ///
    /// # Errors
    /// Gains that cannot be read, or that violate a condition, with the numbers.
    pub fn from_robot(robot: &Robot) -> Result<Self, GainsError> {
        Self::new(&robot.params, HsmcGains::read(robot)?)
            .map_err(|error| GainsError::refused(robot, error))
    }

    /// The same without its disturbance observer, as the paper's robot had it.
    ///
    /// # Errors
    /// As [`Hsmc::from_robot`].
    pub fn without_observer(robot: &Robot) -> Result<Self, GainsError> {
        let gains = HsmcGains {
            observer: 0.0,
            ..HsmcGains::read(robot)?
        };
        Self::new(&robot.params, gains).map_err(|error| GainsError::refused(robot, error))
    }

    /// The controller with `gains`.
    ///
    /// # Errors
    /// Every condition that the gains violate for this robot.
    pub fn new(params: &RobotParams, gains: HsmcGains) -> Result<Self, Refused> {
        let model = NominalModel::new(params);
        let gains = gains.checked(&model)?;
        let observer = DisturbanceObserver::new(ObserverGains {
            bandwidth: gains.observer,
            oscillator: gains.oscillator,
            harmonic: gains.harmonic,
            harmonic_search: gains.harmonic_search,
            remainder: gains.remainder,
            remainder_share: gains.remainder_share,
            zero_squared: model.pitch_inertia(0.0).zero_squared(model.righting),
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
            last: HsmcTerms::default(),
        })
    }

    /// Torque τ_p of the long-axis motor [N·m], finite and within ± τ_max, `dt` [s] after the last step.
    ///
    /// Input that is not finite, or a `dt` ≤ 0, gives 0, leaves the memory untouched and is counted.
    pub fn step(
        &mut self,
        state: &RobotState,
        setpoint: &Setpoint,
        shape: SpeedShape,
        dt: f64,
    ) -> f64 {
        if !is_usable(state, setpoint, dt) {
            self.counters.not_finite = self.counters.not_finite.saturating_add(1);
            return 0.0;
        }
        // On a copy: finite input may still overflow, and what is not finite must not be remembered.
        let mut memory = self.memory;
        let momentum = self.model.pitch_momentum(state);
        let rolling = state.v / self.model.params.r;
        memory.disturbance = memory
            .observer
            .step(momentum.value, momentum.known, rolling, dt);
        let terms = law(
            &self.model,
            &self.gains,
            state,
            setpoint,
            shape,
            memory.integral,
            memory.disturbance,
        );
        if !terms.torque.is_finite() {
            self.counters.not_finite = self.counters.not_finite.saturating_add(1);
            return 0.0;
        }
        if terms.torque.abs() < self.model.params.torque_max {
            let error = (state.v - setpoint.v) / self.model.params.r;
            memory.integral = (memory.integral + error * dt).clamp(-INTEGRAL_MAX, INTEGRAL_MAX);
        }
        self.memory = memory;
        self.last = terms;
        if terms.guarded {
            self.counters.gain_guard = self.counters.gain_guard.saturating_add(1);
        }
        self.counters
            .saturate(terms.torque, self.model.params.torque_max)
    }

    /// Forgets integral and observer: before the motors are powered. Counters stay.
    pub fn reset(&mut self) {
        self.memory.integral = 0.0;
        self.memory.observer.reset();
        self.memory.disturbance = Disturbance::default();
        self.last = HsmcTerms::default();
    }

    /// What happened since the controller was built.
    pub fn counters(&self) -> Counters {
        self.counters
    }

    /// The disturbance ŵ that the last step used.
    pub fn disturbance(&self) -> Disturbance {
        self.memory.disturbance
    }

    /// What the last step that gave a torque computed: for telemetry and tests.
    pub fn terms(&self) -> HsmcTerms {
        self.last
    }
}

/// The law, a pure function. `integral` is ∫ e_v dt [rad], `w` the disturbance on row φ.
///
/// With e_v = (v − v_d)/R, r = m g l cos β, and of ŵ in α_d what the pendulum's weight must hold ([`Disturbance::held`]):
/// sin α_d = (F_r − ŵ + (d_p − c) v̇_d/R)/r, clamped to sin ±0.7 (there the derivatives are zero);
/// α̇_d = ((d_p − c) v̈_d/R − ŵ̇)/(r cos α_d); α̈_d = (((d_p − c) v⃛_d/R − ŵ̈)/r + sin α_d α̇_d²)/cos α_d;
/// S₁ = e_v + a₁ ∫e_v; S₂ = α̇ − α̇_d + a₂ (α − α_d); S = A S₁ + B S₂;
/// τ_p = −[A (f_φ − v̇_d/R + a₁ e_v) + B (f_α − α̈_d + a₂ (α̇ − α̇_d)) + k S + ε sat(S/Φ)]/(A b_φ + B b_α).
/// Not finite where the input is not, or overflows.
pub fn law(
    model: &NominalModel,
    gains: &HsmcGains,
    state: &RobotState,
    setpoint: &Setpoint,
    shape: SpeedShape,
    integral: f64,
    w: Disturbance,
) -> HsmcTerms {
    let g = gains;
    let r = model.params.r;
    let f = model.pitch_submodel(state, w.torque);
    let (f_alpha, f_phi) = (f.f1, f.f2);

    let inertia = model.pitch_inertia(state.alpha);
    let carried = (inertia.d - inertia.c) / r;
    let righting = model.righting * state.beta.cos();
    let [held, held_rate, held_accel] = w.held();
    let needed = (model.rolling_resistance(state.v) - held + carried * setpoint.v_rate) / righting;
    let alpha_d = needed.clamp(-SIN_ALPHA_MAX, SIN_ALPHA_MAX).asin();
    let (mut alpha_d_rate, mut alpha_d_accel) = (0.0, 0.0);
    if needed.abs() < SIN_ALPHA_MAX {
        let cos = alpha_d.cos();
        alpha_d_rate = (carried * shape.accel_rate - held_rate) / (righting * cos);
        alpha_d_accel = ((carried * shape.accel_rate_rate - held_accel) / righting
            + needed * alpha_d_rate * alpha_d_rate)
            / cos;
    }

    let e_v = (state.v - setpoint.v) / r;
    let e_alpha = state.alpha - alpha_d;
    let e_alpha_rate = state.alpha_rate - alpha_d_rate;
    let s1 = e_v + g.a1 * integral;
    let s2 = e_alpha_rate + g.a2 * e_alpha;
    let s = g.a * s1 + g.b * s2;

    let s1_drift = f_phi - setpoint.v_rate / r + g.a1 * e_v;
    let s2_drift = f_alpha - alpha_d_accel + g.a2 * e_alpha_rate;
    let reaching = ReachingLaw {
        k: g.k,
        epsilon: g.epsilon,
        phi: g.phi,
    };
    let gain = InputGain::guarded(g.a, f.b2, g.b, f.b1);
    HsmcTerms {
        alpha_d,
        alpha_d_rate,
        alpha_d_accel,
        s1,
        s2,
        s,
        gain: gain.raw,
        guarded: gain.is_guarded(),
        torque: -(g.a * s1_drift + g.b * s2_drift + reaching.approach(s)) / gain.used,
    }
}

/// Clamp of sin α_d: 44°.
const SIN_ALPHA_MAX: f64 = 0.7;

/// Clamp of ∫ e_v dt [rad].
const INTEGRAL_MAX: f64 = 2.0;
