//! From the specific force at an attitude to the motion of the sphere's centre.

use super::{ACCEL_BIAS, PIVOT, State};

/// Angles' sines and cosines.
#[derive(Clone, Copy)]
pub(super) struct Trig {
    pub(super) sin_r: f64,
    pub(super) cos_r: f64,
    pub(super) tan_r: f64,
    pub(super) sin_a: f64,
    pub(super) cos_a: f64,
}

/// The motion of the centre that a specific force means at an attitude; all zero accelerations without an accelerometer.
#[derive(Clone, Copy)]
pub(super) struct Motion {
    /// Horizontal acceleration forward, v̇ − R q̇_r φ̇ [m/s²].
    pub(super) forward: f64,
    /// Horizontal acceleration to the left, R q̈_r + v φ̇ [m/s²].
    pub(super) left: f64,
    /// Specific force across the lateral axis, upward in its plane [m/s²].
    pub(super) up: f64,
    /// Vertical specific force: g on a flat floor [m/s²].
    pub(super) vertical: f64,
    /// φ̇ [rad/s].
    pub(super) yaw_rate: f64,
    /// v̇ [m/s²].
    pub(super) v_rate: f64,
    /// q̈_r [rad/s²].
    pub(super) q_r_accel: f64,
}

impl Trig {
    pub(super) fn of(q_r: f64, alpha: f64) -> Self {
        Self::new(q_r.sin_cos(), alpha.sin_cos())
    }

    /// Those of angles that differ by `roll` and `pitch` [rad], which are small within a frame.
    pub(super) fn turned(&self, roll: f64, pitch: f64) -> Self {
        Self::new(
            sum((self.sin_r, self.cos_r), roll),
            sum((self.sin_a, self.cos_a), pitch),
        )
    }

    fn new((sin_r, cos_r): (f64, f64), (sin_a, cos_a): (f64, f64)) -> Self {
        Self {
            sin_r,
            cos_r,
            tan_r: sin_r / cos_r,
            sin_a,
            cos_a,
        }
    }
}

/// Sine and cosine of an angle and `by` [rad] more, by the addition theorems. Of a small `by` they come from their series, a quarter of
/// the library's cost: up to 0.1 rad what is left out is below 3e-17.
fn sum((sin, cos): (f64, f64), by: f64) -> (f64, f64) {
    let (sin_by, cos_by) = if by.abs() <= 0.1 {
        let q = by * by;
        let odd = SIN[0] + q * (SIN[1] + q * (SIN[2] + q * SIN[3]));
        let even = COS[0] + q * (COS[1] + q * (COS[2] + q * COS[3]));
        (by + by * q * odd, 1.0 + q * even)
    } else {
        by.sin_cos()
    };
    (sin * cos_by + cos * sin_by, cos * cos_by - sin * sin_by)
}

/// −1/3!, 1/5!, −1/7!, 1/9!
const SIN: [f64; 4] = [-1.0 / 6.0, 1.0 / 120.0, -1.0 / 5040.0, 1.0 / 362_880.0];
/// −1/2!, 1/4!, −1/6!, 1/8!
const COS: [f64; 4] = [-0.5, 1.0 / 24.0, -1.0 / 720.0, 1.0 / 40_320.0];

impl Motion {
    /// The acceleration of the centre is v̇ − R q̇_r φ̇ forward and R q̈_r + v φ̇ left; the specific force adds g upward.
    /// The frame's axes are s = cos α e_f + sin α μ, n = cos q_r e_l − sin q_r e_z and cos α μ − sin α e_f, μ = cos q_r e_z + sin q_r e_l.
    pub(super) fn of(
        x: &State,
        t: &Trig,
        q_r_rate: f64,
        v: f64,
        accel: Option<[f64; 3]>,
        radius: f64,
    ) -> Self {
        let yaw_rate = v * t.tan_r / radius + x[PIVOT];
        let Some([f_x, f_y, f_z]) = accel else {
            return Self {
                forward: 0.0,
                left: 0.0,
                up: 0.0,
                vertical: 0.0,
                yaw_rate,
                v_rate: 0.0,
                q_r_accel: 0.0,
            };
        };
        let (f_x, f_y) = (f_x - x[ACCEL_BIAS], f_y - x[ACCEL_BIAS + 1]);
        let f_z = f_z - x[ACCEL_BIAS + 2];
        let forward = f_x * t.cos_a - f_z * t.sin_a;
        let up = f_x * t.sin_a + f_z * t.cos_a;
        let left = up * t.sin_r + f_y * t.cos_r;
        Self {
            forward,
            left,
            up,
            vertical: up * t.cos_r - f_y * t.sin_r,
            yaw_rate,
            v_rate: forward + radius * q_r_rate * yaw_rate,
            q_r_accel: (left - v * yaw_rate) / radius,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn turned_angles_are_as_good_as_computed_ones() {
        for angle in [-1.4, -0.2, 0.0, 0.35, 1.2] {
            for by in [-0.5, -0.1, -0.03, 0.0, 1e-6, 0.02, 0.1] {
                let turned = Trig::of(angle, angle).turned(by, by);
                let (sin, cos) = (angle + by).sin_cos();
                let errors = [turned.sin_r - sin, turned.cos_r - cos, turned.sin_a - sin];
                // Four roundings of numbers up to 1, and that of the sum of the angles.
                let worst = errors.into_iter().map(f64::abs).fold(0.0, f64::max);
                assert!(worst <= 4.0 * f64::EPSILON, "{angle} + {by}: {worst:e}");
            }
        }
    }
}
