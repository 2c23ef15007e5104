//! What is left of a disturbance when all models of it are taken off: a value with a rate, from the momentum.
//!
//! A third-order observer with all poles at e^(−λ dt) (a fading-memory polynomial filter; Morrison, *Introduction to Sequential
//! Smoothing and Prediction*, 1969). Against the raw estimate's first-order lag its error on a ramp is zero, for any step length
//! it is stable, and its gains need no tuning beside λ.

use super::Disturbance;

/// The observer's memory; the default has seen nothing.
#[derive(Clone, Copy, Debug, PartialEq, Default)]
pub struct Remainder {
    last: Option<Last>,
    torque: f64, // r [N·m]
    rate: f64,   // ṙ [N·m/s]
}

#[derive(Clone, Copy, Debug, PartialEq)]
struct Last {
    momentum: f64, // its estimate [kg·m²/s]
    known: f64,    // [N·m]
    modelled: f64, // mean of the step that follows [N·m]
}

impl Remainder {
    /// Remainder torque [N·m] and its rate [N·m/s], one step ahead.
    ///
    /// Takes the momentum [kg·m²/s], its known rate [N·m] and `modelled`, the disturbance that is explained, one step ahead; the
    /// bandwidth λ [1/s], the clamp of the torque [N·m] (the rate's is λ times it), and `dt` [s].
    ///
    /// With θ = e^(−λ dt), p̂ and r predicted by ½ (known₋ + known) + w_modelled + r + ½ ṙ dt, and e = p − p̂:
    /// p̂ += (1 − θ³) e; r += 3/2 (1 − θ)² (1 + θ) e/dt; ṙ += (1 − θ)³ e/dt². One step ahead is 1/λ at most.
    pub fn step(
        &mut self,
        momentum: f64,
        known: f64,
        modelled: &Disturbance,
        bandwidth: f64,
        torque_max: f64,
        dt: f64,
    ) -> [f64; 2] {
        let theta = (-bandwidth * dt).exp();
        let predicted = self.last.map_or(momentum, |last| {
            last.momentum
                + dt * (0.5 * (last.known + known)
                    + last.modelled
                    + self.torque
                    + 0.5 * dt * self.rate)
        });
        let error = momentum - predicted;
        let left = 1.0 - theta;
        let rate_max = bandwidth * torque_max;
        self.torque += dt * self.rate + 1.5 * left * left * (1.0 + theta) * error / dt;
        self.torque = self.torque.clamp(-torque_max, torque_max);
        self.rate = (self.rate + left * left * left * error / (dt * dt)).clamp(-rate_max, rate_max);
        self.last = Some(Last {
            momentum: predicted + (1.0 - theta * theta * theta) * error,
            known,
            modelled: modelled.torque - 0.5 * dt * modelled.rate,
        });
        [self.torque + dt.min(1.0 / bandwidth) * self.rate, self.rate]
    }
}
