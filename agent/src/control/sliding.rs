//! What the sliding-mode laws share: saturation, the signed power, the reaching law and the guard of the input gain.

/// sat(x): x clamped to ±1. In place of sgn(S), which chatters by 0.5-4.4 N·m at 50 Hz (E11).
pub fn sat(x: f64) -> f64 {
    x.clamp(-1.0, 1.0)
}

/// A function value with its slope.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Signed {
    /// sig(e)^γ.
    pub value: f64,
    /// Its derivative with respect to e.
    pub slope: f64,
}

/// The terminal term sig(e)^γ = |e|^γ sgn e and its slope γ |e|^(γ−1), 0 < γ < 1, made regular for |e| < `mu`.
///
/// Differs from eqs (8), (13), (15), (17): the printed powers of e are NaN at e ≤ 0 and their exponent 1 − q/p is not the
/// derivative's (E5); the slope is infinite at e = 0 (E6). For |e| < μ: k₁ e + k₂ e |e|, k₁ = (2 − γ) μ^(γ−1),
/// k₂ = (γ − 1) μ^(γ−2), which joins at ±μ with equal slope.
pub fn sig(e: f64, gamma: f64, mu: f64) -> Signed {
    let size = e.abs();
    if size >= mu {
        let power = size.powf(gamma - 1.0);
        return Signed {
            value: power * e,
            slope: gamma * power,
        };
    }
    let k1 = sig_slope_max(gamma, mu);
    let k2 = (gamma - 1.0) * mu.powf(gamma - 2.0);
    Signed {
        value: k1 * e + k2 * e * size,
        slope: k1 + 2.0 * k2 * size,
    }
}

/// k₁ = (2 − γ) μ^(γ−1), the largest slope of [`sig`], at e = 0; it is also the largest sig(e)/e.
pub fn sig_slope_max(gamma: f64, mu: f64) -> f64 {
    (2.0 - gamma) * mu.powf(gamma - 1.0)
}

/// The reaching law, eq (16): Ṡ = −k S − ε sat(S/Φ).
///
/// The text swaps the names (E11): k is the exponential, ε the constant-rate parameter.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ReachingLaw {
    /// k, exponential approach [1/s].
    pub k: f64,
    /// ε, constant-rate approach [rad/s²].
    pub epsilon: f64,
    /// Φ, boundary layer within which ε acts in proportion [rad/s].
    pub phi: f64,
}

impl ReachingLaw {
    /// −Ṡ = k S + ε sat(S/Φ) [rad/s²] at the surface value `s` [rad/s].
    pub fn approach(&self, s: f64) -> f64 {
        self.k * s + self.epsilon * sat(s / self.phi)
    }
}

/// The gain from torque to Ṡ, A b₂ + B b₁ [1/(kg·m²)], held away from zero.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct InputGain {
    /// As the model gives it.
    pub raw: f64,
    /// As it divides: `raw`, or 0.15 B b₁ if that is larger.
    pub used: f64,
}

impl InputGain {
    /// Guards A b₂ + B b₁ at 0.15 B b₁ (E2). Written so that a NaN stays visible.
    pub fn guarded(a: f64, b2: f64, b: f64, b1: f64) -> Self {
        let raw = a * b2 + b * b1;
        let floor = GAIN_SHARE_MIN * b * b1;
        Self {
            raw,
            used: if raw < floor { floor } else { raw },
        }
    }

    /// Whether the guard acts.
    pub fn is_guarded(&self) -> bool {
        self.used > self.raw
    }
}

/// Least share of B b₁ that A b₂ must leave of the input gain: tried, smaller ones let the torque run into its limit.
const GAIN_SHARE_MIN: f64 = 0.15;
