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
        let (sin_r, cos_r) = q_r.sin_cos();
        let (sin_a, cos_a) = alpha.sin_cos();
        Self {
            sin_r,
            cos_r,
            tan_r: sin_r / cos_r,
            sin_a,
            cos_a,
        }
    }
}

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
