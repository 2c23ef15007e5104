//! Disturbance observer of one sub-model: what of a torque on the shell returns is learnt, the rest is followed. Not in the paper.
//!
//! The shell row minus the pendulum row of a sub-model contains neither the motor torque nor the joint's damping and friction
//! ([`crate::model::NominalModel::roll_momentum`]): ṗ = known + w. A first-order observer of bandwidth L makes w from the momentum p.
//! Three models share what it finds, for one residual:
//! - a constant (slope, offset of the centre of mass), and a torque that turns with the shell (its imbalance): an oscillator rotated
//!   by the shell's own angle;
//! - a second oscillator at h times that angle. h is searched as well (slowly: near the shell's own rate the two oscillators share a torque);
//! - the [`remainder`], which has no form: a value with a rate that follows what the others do not explain.
//!
//! The oscillators are free of the observer's lag 1/L and know how fast they change: the law needs both. All is said for one step
//! *ahead*, when the torque that is computed now acts: motors are about a control period late.

pub mod remainder;

use self::remainder::Remainder;

/// Settings of a [`DisturbanceObserver`].
#[derive(Clone, Copy, Debug, PartialEq, Default)]
pub struct ObserverGains {
    /// Bandwidth L of the momentum observer [1/s]; 0 switches the whole observer off.
    pub bandwidth: f64,
    /// Bandwidth o of the constant and the shell-locked part [1/s]; 0 switches the whole observer off.
    pub oscillator: f64,
    /// Bandwidth o_h of the oscillator at h times the shell's angle [1/s]; 0 switches it off.
    pub harmonic: f64,
    /// How fast h is found, γ [1/s]; 0 leaves it where it starts.
    pub harmonic_search: f64,
    /// Bandwidth λ of the remainder [1/s]; 0 switches it off.
    pub remainder: f64,
    /// Share ρ of the remainder that is reported, 0 to 1 [1].
    pub remainder_share: f64,
    /// Square of the zero of the sub-model, G/(c − a) [1/s²]: beyond it a swing turns the shell rather by its inertia than by its
    /// weight. 0: taken as infinite, [`Disturbance::inertial`] is then 0.
    pub zero_squared: f64,
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
    /// What of the three the swinging pendulum's inertia bears, so that its weight need not:
    /// Σ wₖ ωₖ²/(G/(c − a) + ωₖ²) of the oscillating parts [N·m, N·m/s, N·m/s²].
    pub inertial: [f64; 3],
}

/// Momentum observer with a constant, two oscillators and a remainder. One class serves roll and pitch.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DisturbanceObserver {
    gains: ObserverGains,
    momentum: Option<f64>, // z; None until the first step
    raw: f64,
    constant: f64,      // w₀
    turning: [f64; 2],  // w₁, w₂: in phase and in quadrature, turning with the shell
    harmonic: [f64; 2], // u₁, u₂: the same, at h times its angle
    order: f64,         // h
    remainder: Remainder,
}

impl Disturbance {
    /// ŵ, ŵ̇, ŵ̈ less what the pendulum's inertia bears: what its weight must hold [N·m, N·m/s, N·m/s²].
    pub fn held(&self) -> [f64; 3] {
        let [torque, rate, accel] = self.inertial;
        [self.torque - torque, self.rate - rate, self.accel - accel]
    }

    /// Adds an oscillation at `omega` [rad/s] that is `pair` after a first-order lag of `bandwidth`.
    ///
    /// The pair is led by what that lag takes away at this rate: gain √(1 + (ω/L)²), phase ω/L.
    fn add(&mut self, pair: [f64; 2], omega: f64, bandwidth: f64, zero_squared: f64) {
        let lag = omega / bandwidth;
        let scale = (1.0 + lag * lag).sqrt();
        let (sin, cos) = lag.sin_cos();
        let [w1, w2] = pair;
        let torque = scale * (w1 * cos + w2 * sin);
        let rate = scale * omega * (w2 * cos - w1 * sin);
        let accel = -omega * omega * torque;
        self.torque += torque;
        self.rate += rate;
        self.accel += accel;
        if zero_squared > 0.0 {
            let share = omega * omega / (zero_squared + omega * omega);
            for (sum, part) in self.inertial.iter_mut().zip([torque, rate, accel]) {
                *sum += share * part;
            }
        }
    }
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
            harmonic: [0.0; 2],
            order: ORDER_START,
            remainder: Remainder::default(),
        }
    }

    /// Forgets everything.
    pub fn reset(&mut self) {
        *self = Self::new(self.gains);
    }

    /// Takes the momentum p [kg·m²/s], its known rate [N·m] and the shell's rolling rate v/R [rad/s], `dt` [s] after the last.
    ///
    /// ŵ_raw = L (p − z), ż = known + ŵ_raw; with ϑ = (v/R) dt and r = ŵ_raw − w₀ − w₁ − u₁:
    /// w₀ += ½ o dt r; (w₁, w₂) ← turned by ϑ, w₁ += 2 o dt r; (u₁, u₂) ← turned by h ϑ, u₁ += 2 o_h dt r;
    /// h += γ dt r u₂/(u₁² + u₂² + u_min²) sat(v/R): a phase that runs away says that h is wrong.
    /// Steps longer than 1/L count as 1/L: z is then p itself.
    pub fn step(&mut self, momentum: f64, known: f64, shell_rate: f64, dt: f64) -> Disturbance {
        let g = self.gains;
        if !(g.bandwidth > 0.0 && g.oscillator > 0.0) {
            return Disturbance::default();
        }
        let z = self.momentum.unwrap_or(momentum);
        let raw = g.bandwidth * (momentum - z);
        let dt_held = dt.min(1.0 / g.bandwidth);
        self.momentum = Some(z + dt_held * (known + raw));
        self.raw = raw.clamp(-g.torque_max, g.torque_max);

        let residual = self.raw - (self.constant + self.turning[0] + self.harmonic[0]);
        let learn = (g.oscillator * dt).min(STEP_MAX) * residual;
        self.turning = turned(self.turning, shell_rate * dt, 2.0 * learn);
        self.constant += 0.5 * learn;
        if g.harmonic > 0.0 {
            self.learn_harmonic(residual, shell_rate, dt);
        }

        let mut modelled = Disturbance {
            torque: self.constant,
            ..Disturbance::default()
        };
        modelled.add(self.turning, shell_rate, g.bandwidth, g.zero_squared);
        let rate = self.order * shell_rate;
        modelled.add(self.harmonic, rate, g.bandwidth, g.zero_squared);
        if g.remainder > 0.0 {
            let [torque, rate] =
                self.remainder
                    .step(momentum, known, &modelled, g.remainder, g.torque_max, dt);
            modelled.torque += g.remainder_share * torque;
            modelled.rate += g.remainder_share * rate;
        }
        modelled
    }

    /// The momentum observer's own, lagging estimate, clamped [N·m].
    pub fn raw(&self) -> f64 {
        self.raw
    }

    /// h, turns of the second oscillator for each turn of the shell [1]; means something where that oscillator carries something.
    pub fn order(&self) -> f64 {
        self.order
    }

    fn learn_harmonic(&mut self, residual: f64, shell_rate: f64, dt: f64) {
        let g = self.gains;
        let [u1, u2] = self.harmonic;
        let size = u1 * u1 + u2 * u2 + AMPLITUDE_MIN * AMPLITUDE_MIN;
        // A shell that stands says nothing about h.
        let search = g.harmonic_search * dt * residual * u2 / size * shell_rate.clamp(-1.0, 1.0);
        let turn = self.order * shell_rate * dt;
        let learn = (g.harmonic * dt).min(STEP_MAX_HARMONIC) * residual;
        self.harmonic = turned(self.harmonic, turn, 2.0 * learn);
        self.order =
            (self.order + search.clamp(-SEARCH_MAX, SEARCH_MAX)).clamp(ORDER_MIN, ORDER_MAX);
    }
}

/// An oscillator's pair, turned by `angle` [rad], with `learnt` added in phase.
fn turned([w1, w2]: [f64; 2], angle: f64, learnt: f64) -> [f64; 2] {
    let (sin, cos) = angle.sin_cos();
    [w1 * cos + w2 * sin + learnt, w2 * cos - w1 * sin]
}

/// Largest o dt of one step: with the weights 2 and ½ beside it the residual still shrinks.
const STEP_MAX: f64 = 0.4;

/// Largest o_h dt of one step, with which it still shrinks beside the largest o dt: 2.5 · 0.4 + 2 · 0.4 < 2.
const STEP_MAX_HARMONIC: f64 = 0.4;

/// h before anything was learnt, and its limits [1].
const ORDER_START: f64 = 1.75;
const ORDER_MIN: f64 = 0.4;
const ORDER_MAX: f64 = 4.0;

/// Largest change of h in one step [1].
const SEARCH_MAX: f64 = 0.02;

/// u_min, amplitude that the search takes for noise [N·m].
const AMPLITUDE_MIN: f64 = 0.3;
