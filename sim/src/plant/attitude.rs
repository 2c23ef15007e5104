//! The angles of a state with their sines and cosines, computed once for a step and turned on from there for its stages.

use super::PlantState;
use crate::disturbance::Surroundings;

/// An angle [rad] with its sine and cosine.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Turn {
    angle: f64,
    pub(super) sin: f64,
    pub(super) cos: f64,
}

/// All the angles that the equations see through sines and cosines.
#[derive(Clone, Copy, Debug)]
pub(super) struct Attitude {
    pub(super) heading: Turn,
    pub(super) q_r: Turn,
    pub(super) alpha: Turn,
    /// β + q_r.
    pub(super) theta_r: Turn,
    /// Of the shell's imbalance; meaningless without one.
    pub(super) imbalance: Turn,
}

impl Turn {
    pub(super) fn of(angle: f64) -> Self {
        let (sin, cos) = angle.sin_cos();
        Self { angle, sin, cos }
    }

    /// The same of an angle that is mostly close: by the addition theorems and the series of what lies between, at a
    /// fraction of the cost.
    fn to(&self, angle: f64) -> Self {
        let by = angle - self.angle;
        if by.abs() <= NEAR {
            let (sin, cos) = near_zero(by);
            return Self {
                angle,
                sin: self.sin * cos + self.cos * sin,
                cos: self.cos * cos - self.sin * sin,
            };
        }
        Self::of(angle)
    }
}

impl Attitude {
    pub(super) fn of(state: &PlantState, around: &Surroundings) -> Self {
        let s = &state.robot;
        Self {
            heading: Turn::of(s.heading),
            q_r: Turn::of(s.q_r),
            alpha: Turn::of(s.alpha),
            theta_r: Turn::of(state.theta_r()),
            imbalance: around
                .imbalance_angle(state.phi_s)
                .map_or(Turn::default(), Turn::of),
        }
    }

    /// That of another state.
    pub(super) fn to(&self, state: &PlantState, around: &Surroundings) -> Self {
        let s = &state.robot;
        let imbalance = around.imbalance_angle(state.phi_s);
        Self {
            heading: self.heading.to(s.heading),
            q_r: self.q_r.to(s.q_r),
            alpha: self.alpha.to(s.alpha),
            theta_r: self.theta_r.to(state.theta_r()),
            imbalance: imbalance.map_or(Turn::default(), |angle| self.imbalance.to(angle)),
        }
    }
}

/// Sine and cosine of an angle up to [`NEAR`], by their series: what is left out is below 3e-19 and 3e-17.
fn near_zero(x: f64) -> (f64, f64) {
    let q = x * x;
    let sin = SIN[0] + q * (SIN[1] + q * (SIN[2] + q * SIN[3]));
    let cos = COS[0] + q * (COS[1] + q * (COS[2] + q * COS[3]));
    (x + x * q * sin, 1.0 + q * cos)
}

/// −1/3!, 1/5!, −1/7!, 1/9!
const SIN: [f64; 4] = [-1.0 / 6.0, 1.0 / 120.0, -1.0 / 5040.0, 1.0 / 362_880.0];
/// −1/2!, 1/4!, −1/6!, 1/8!
const COS: [f64; 4] = [-0.5, 1.0 / 24.0, -1.0 / 720.0, 1.0 / 40_320.0];
/// Beyond this the library computes them [rad]: twice what a stage turns at 10 rad/s.
const NEAR: f64 = 0.1;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn turning_on_is_as_good_as_computing_anew() {
        for start in [0.0, 0.3, -1.2, 3.1, 250.0] {
            let turn = Turn::of(start);
            for by in [-0.3, -0.1, -0.03, -1e-9, 0.0, 1e-5, 0.02, 0.099, 0.1, 2.0] {
                let turned = turn.to(start + by);
                let (sin, cos) = (start + by).sin_cos();
                // Four roundings of numbers up to 1.
                let error = (turned.sin - sin).abs().max((turned.cos - cos).abs());
                assert!(error <= 4.0 * f64::EPSILON, "{start} + {by}: {error:e}");
            }
        }
    }

    #[test]
    fn not_a_number_stays_one() {
        assert!(Turn::of(1.0).to(f64::NAN).sin.is_nan());
    }
}
