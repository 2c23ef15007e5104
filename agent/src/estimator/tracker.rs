//! Angle and rate of one joint from its quantised encoder.

use nalgebra::{Matrix3, Vector3};

/// Kalman filter of angle, rate and acceleration under white jerk.
///
/// A difference quotient over one sample is coarse (2π/65536 over 5 ms is 0.019 rad/s) and half a sample old; a mean over more
/// samples is older still. With the acceleration as a state the rate is smooth and belongs to the newest sample.
#[derive(Clone, Debug)]
pub(super) struct JointTracker {
    /// Angle [rad], rate [rad/s], acceleration [rad/s²].
    x: Vector3<f64>,
    p: Matrix3<f64>,
    /// Density of the jerk, squared [rad²/s⁵].
    jerk: f64,
    /// Variance of one reading [rad²].
    noise: f64,
}

impl JointTracker {
    /// A joint first seen at `angle` [rad], turning at about `rate` [rad/s].
    pub(super) fn new(angle: f64, rate: f64, jerk: f64, noise: f64) -> Self {
        Self {
            x: Vector3::new(angle, rate, 0.0),
            p: Matrix3::from_diagonal(&Vector3::new(noise * noise, 1e-3, 1e2)),
            jerk: jerk * jerk,
            noise: noise * noise,
        }
    }

    /// Moves on by `dt` [s] and takes the reading, if there is one.
    pub(super) fn step(&mut self, dt: f64, angle: Option<f64>) {
        let (dt2, dt3) = (dt * dt, dt * dt * dt);
        let f = Matrix3::new(1.0, dt, 0.5 * dt2, 0.0, 1.0, dt, 0.0, 0.0, 1.0);
        // White jerk through three integrators.
        let q = Matrix3::new(
            dt3 * dt2 / 20.0,
            dt2 * dt2 / 8.0,
            dt3 / 6.0,
            dt2 * dt2 / 8.0,
            dt3 / 3.0,
            dt2 / 2.0,
            dt3 / 6.0,
            dt2 / 2.0,
            dt,
        );
        self.x = f * self.x;
        self.p = f * self.p * f.transpose() + q * self.jerk;
        let Some(angle) = angle else { return };
        let p_h = self.p.column(0).into_owned();
        let s = p_h[0] + self.noise;
        let innovation = angle - self.x[0];
        if innovation.abs() > JUMP {
            // The board lost count: keep the motion, take the new angle.
            self.x[0] = angle;
            return;
        }
        self.x += p_h * (innovation / s);
        self.p -= p_h * p_h.transpose() / s;
    }

    /// Angle [rad].
    pub(super) fn angle(&self) -> f64 {
        self.x[0]
    }

    /// Rate [rad/s].
    pub(super) fn rate(&self) -> f64 {
        self.x[1]
    }
}

/// Innovation that no joint can turn within a sample [rad].
const JUMP: f64 = 0.5;
