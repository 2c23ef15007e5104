//! Disturbance observer of one sub-model: a momentum observer, and an oscillator that knows how the shell turns. Not in the paper.
//!
//! The shell row minus the pendulum row of a sub-model contains neither the motor torque nor the joint's damping and friction
//! ([`crate::model::NominalModel::roll_momentum`]): ṗ = known + w. A first-order observer of bandwidth L makes w from the momentum p.
//! What is left in a rolling sphere is a constant (slope, offset of the centre of mass) plus a torque that turns with the shell
//! (its imbalance). An oscillator rotated by the shell's own angle, rather than by a frequency of its own, learns
//! both and says what they are, free of the observer's lag 1/L, and how fast they change: the law needs both. It says so for
//! one step *ahead*, when the torque that is computed now acts: motors are about a control period late.

/// Settings of a [`DisturbanceObserver`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ObserverGains {
    /// Bandwidth L of the momentum observer [1/s]; 0 switches the whole observer off.
    pub bandwidth: f64,
    /// Bandwidth of the parts that it splits into [1/s]; 0 switches the whole observer off.
    pub oscillator: f64,
    /// Raw estimates are clamped to ± this [N·m].
    pub torque_max: f64,
}

/// A disturbance torque on the shell, estimated.
#[derive(Clone, Copy, Debug, PartialEq, Default)]
pub struct Disturbance {
    /// ŵ, one step after the state from which it was made [N·m].
    pub torque: f64,
    /// Its rate ŵ̇ [N·m/s].
    pub rate: f64,
    /// Its second derivative ŵ̈ [N·m/s²].
    pub accel: f64,
}

/// Momentum observer with a constant and a shell-frequency part. One class serves roll and pitch.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DisturbanceObserver {
    gains: ObserverGains,
    momentum: Option<f64>, // z; None until the first step
    raw: f64,
    constant: f64,     // w₀
    turning: [f64; 2], // w₁, w₂: in phase and in quadrature, turning with the shell
}

impl DisturbanceObserver {
    /// An observer that has seen nothing.
    pub fn new(gains: ObserverGains) -> Self {
        Self {
            gains,
            momentum: None,
            raw: 0.0,
            constant: 0.0,
            turning: [0.0; 2],
        }
    }

    /// Forgets everything.
    pub fn reset(&mut self) {
        *self = Self::new(self.gains);
    }

    /// Takes the momentum p [kg·m²/s], its known rate [N·m] and the shell's rolling rate v/R [rad/s], `dt` [s] after the last.
    ///
    /// ŵ_raw = L (p − z), ż = known + ŵ_raw; with ϑ = (v/R) dt and r = ŵ_raw − w₀ − w₁:
    /// w₀ += ½ o dt r; (w₁, w₂) ← turned by ϑ, w₁ += 2 o dt r. Steps longer than 1/L count as 1/L: z is then p itself.
    pub fn step(&mut self, momentum: f64, known: f64, shell_rate: f64, dt: f64) -> Disturbance {
        let ObserverGains {
            bandwidth,
            oscillator,
            torque_max,
        } = self.gains;
        if !(bandwidth > 0.0 && oscillator > 0.0) {
            return Disturbance::default();
        }
        let z = self.momentum.unwrap_or(momentum);
        let raw = bandwidth * (momentum - z);
        let dt_held = dt.min(1.0 / bandwidth);
        self.momentum = Some(z + dt_held * (known + raw));
        self.raw = raw.clamp(-torque_max, torque_max);

        let residual = self.raw - (self.constant + self.turning[0]);
        let learn = (oscillator * dt).min(STEP_MAX) * residual;
        let (sin, cos) = (shell_rate * dt).sin_cos();
        let [w1, w2] = self.turning;
        self.turning = [w1 * cos + w2 * sin + 2.0 * learn, w2 * cos - w1 * sin];
        self.constant += 0.5 * learn;
        self.estimate(shell_rate)
    }

    /// The momentum observer's own, lagging estimate, clamped [N·m].
    pub fn raw(&self) -> f64 {
        self.raw
    }

    /// w₀ plus the turning part led by what a first-order lag 1/L takes away at this rate: gain √(1 + (ω/L)²), phase ω/L.
    fn estimate(&self, shell_rate: f64) -> Disturbance {
        let lag = shell_rate / self.gains.bandwidth;
        let scale = (1.0 + lag * lag).sqrt();
        let (sin, cos) = lag.sin_cos();
        let [w1, w2] = self.turning;
        let turning = scale * (w1 * cos + w2 * sin);
        Disturbance {
            torque: self.constant + turning,
            rate: scale * shell_rate * (w2 * cos - w1 * sin),
            accel: -shell_rate * shell_rate * turning,
        }
    }
}

/// Largest o dt of one step: with the weights 2 and ½ beside it the residual still shrinks.
const STEP_MAX: f64 = 0.4;
