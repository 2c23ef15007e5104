//! The extended Kalman filter: sixteen states, one sensor frame at a time.
//!
//! The accelerometer drives the speeds of the centre, so that gravity enters through them: a wrong lean would let the predicted
//! R q̇_r run away from the gyro's, a wrong pitch the predicted v from the encoder's. No acceleration is ever formed by differencing
//! a rate, whose noise would telescope over a window; the filter weighs every window by itself. Gyro and encoder are
//! measurements, never inputs: their noise enters once.

mod correction;
mod geometry;
mod position;
mod transition;

use nalgebra::{SMatrix, SVector};

use super::config::EstimatorConfig;
use correction::Correction;
use geometry::{Motion, Trig};
use transition::Transition;

pub(super) use correction::{Channel, Gates};
pub(super) use position::FixAt;

/// Number of states.
pub(super) const STATES: usize = 16;

// Places of the states in the vector.
/// Roll q_r [rad].
pub(super) const Q_R: usize = 0;
/// Its rate [rad/s].
pub(super) const Q_R_RATE: usize = 1;
/// Swing α of the frame in pitch [rad].
pub(super) const ALPHA: usize = 2;
/// Its rate [rad/s].
pub(super) const ALPHA_RATE: usize = 3;
/// Heading φ, unwrapped [rad].
pub(super) const HEADING: usize = 4;
/// Pivoting of the shell about the vertical, φ̇ − v tan q_r/R [rad/s].
pub(super) const PIVOT: usize = 5;
/// Rolling angle φ_s of the shell, as the encoder counts it [rad].
pub(super) const SHELL: usize = 6;
/// Forward speed [m/s].
pub(super) const V: usize = 7;
/// World X [m].
pub(super) const X: usize = 8;
/// World Y [m].
pub(super) const Y: usize = 9;
/// Gyro biases, forward, left, up [rad/s].
pub(super) const GYRO_BIAS: usize = 10;
/// Accelerometer biases, forward, left, up [m/s²]. The upward one would pass for a roll that grows with the lean.
pub(super) const ACCEL_BIAS: usize = 13;

pub(super) type State = SVector<f64, STATES>;
pub(super) type Covariance = SMatrix<f64, STATES, STATES>;
/// A column of a covariance, or a row: it is symmetric.
type Column = [f64; STATES];
/// A covariance as nalgebra stores it: where both loops have fixed bounds, plain arrays need no checks.
type Columns = [Column; STATES];

/// What one sensor frame gives the filter; a sensor that is not to be trusted gives `None`.
#[derive(Clone, Copy, Debug)]
pub(super) struct Step {
    /// Time since the frame before [s].
    pub(super) dt: f64,
    /// Specific force, mean of this frame's and the one before [m/s²].
    pub(super) accel: Option<[f64; 3]>,
    /// Angular velocity [rad/s].
    pub(super) gyro: Option<[f64; 3]>,
    /// Angle of the pitch motor [rad].
    pub(super) theta_p: Option<f64>,
    /// The robot stands still.
    pub(super) at_rest: bool,
}

/// What the filter knows of the robot.
#[derive(Clone, Copy, Debug)]
pub(super) struct Body {
    /// Radius of the sphere, R [m].
    pub(super) radius: f64,
    /// Gravity, g [m/s²].
    pub(super) gravity: f64,
    /// Largest acceleration of the swing α that the motor and the pendulum's weight can give [rad/s²].
    pub(super) swing_accel_max: f64,
}

/// State and covariance at the stamp of one frame.
#[derive(Clone, Copy, Debug)]
pub(super) struct Filter {
    pub(super) x: State,
    pub(super) p: Covariance,
    /// Consecutive refusals of each channel.
    streaks: [u8; 4],
    /// Time for which pivoting still counts as possible: more than 0 from a pivot until it has been small for a while [s].
    pivoting: f64,
}

impl Filter {
    pub(super) fn new(x: State, p: Covariance) -> Self {
        Self {
            x,
            p,
            streaks: [0; 4],
            pivoting: 0.0,
        }
    }

    /// Carries the filter over one frame: prediction to its stamp, then its measurements.
    pub(super) fn step(&mut self, step: &Step, body: &Body, config: &EstimatorConfig) -> Gates {
        let radius = body.radius;
        // A gap is crossed in short strides, so that the midpoint rule holds.
        let strides = (step.dt / STRIDE_MAX).ceil().max(1.0);
        let unknown_force = step.accel.is_none() || step.dt > 2.5 * config.sample_interval;
        let mut t = Trig::of(self.x[Q_R], self.x[ALPHA]);
        for _ in 0..strides as u32 {
            let dt = step.dt / strides;
            t = self.predict(&t, dt, step.accel, unknown_force, radius, config);
        }
        self.correct(&t, step, body, config)
    }

    /// Prediction over `dt` [s] by the midpoint rule, and P = F P Fᵀ + Q; from the attitude `start` to the one returned.
    ///
    /// q̈_r = (a_left − v φ̇)/R,  v̇ = a_forward + R q̇_r φ̇,  φ̇ = v tan q_r/R + pivot,  φ̇_s = v/(R cos q_r),  eq (1) for the position.
    fn predict(
        &mut self,
        start: &Trig,
        dt: f64,
        accel: Option<[f64; 3]>,
        unknown_force: bool,
        radius: f64,
        config: &EstimatorConfig,
    ) -> Trig {
        let x = &mut self.x;
        let half = 0.5 * dt;

        let (q_r_rate, v, pivot) = (x[Q_R_RATE], x[V], x[PIVOT]);
        let m = Motion::of(x, start, q_r_rate, v, accel, radius);
        let q_r_rate_mid = q_r_rate + half * m.q_r_accel;
        let v_mid = v + half * m.v_rate;
        let heading_mid = x[HEADING] + half * m.yaw_rate;

        let t = start.turned(half * q_r_rate, half * x[ALPHA_RATE]);
        let end = start.turned(dt * q_r_rate_mid, dt * x[ALPHA_RATE]);
        let m = Motion::of(x, &t, q_r_rate_mid, v_mid, accel, radius);
        let (sin_h, cos_h) = heading_mid.sin_cos();
        let x_rate = v_mid * cos_h - radius * q_r_rate_mid * sin_h;
        let y_rate = v_mid * sin_h + radius * q_r_rate_mid * cos_h;
        let pivot_kept = config.pivot_time / (config.pivot_time + dt);

        x[Q_R] += dt * q_r_rate_mid;
        x[Q_R_RATE] += dt * m.q_r_accel;
        x[ALPHA] += dt * x[ALPHA_RATE];
        x[HEADING] += dt * m.yaw_rate;
        x[PIVOT] = pivot * pivot_kept;
        x[SHELL] += dt * v_mid / (radius * t.cos_r);
        x[V] += dt * m.v_rate;
        x[X] += dt * x_rate;
        x[Y] += dt * y_rate;

        // F − I at the midpoint. Without an accelerometer its bias drives nothing.
        let known = if accel.is_some() { dt } else { 0.0 };
        let yaw_by_q_r = v_mid * (1.0 + t.tan_r * t.tan_r) / radius;
        let yaw_by_v = t.tan_r / radius;
        let sway = dt * radius * q_r_rate_mid;
        let by_r = dt / radius;
        let transition = Transition {
            q_r: [(Q_R_RATE, dt)],
            q_r_rate: [
                (Q_R, by_r * (m.vertical - v_mid * yaw_by_q_r)),
                (ALPHA, by_r * m.forward * t.sin_r),
                (V, -by_r * (m.yaw_rate + v_mid * yaw_by_v)),
                (PIVOT, -by_r * v_mid),
                (ACCEL_BIAS, -known / radius * t.sin_a * t.sin_r),
                (ACCEL_BIAS + 1, -known / radius * t.cos_r),
                (ACCEL_BIAS + 2, -known / radius * t.cos_a * t.sin_r),
            ],
            alpha: [(ALPHA_RATE, dt)],
            heading: [(V, dt * yaw_by_v), (Q_R, dt * yaw_by_q_r), (PIVOT, dt)],
            pivot: [(PIVOT, pivot_kept - 1.0)],
            shell: [(V, by_r / t.cos_r), (Q_R, by_r * v_mid * t.tan_r / t.cos_r)],
            v: [
                (ALPHA, -dt * m.up),
                (Q_R_RATE, dt * radius * m.yaw_rate),
                (Q_R, sway * yaw_by_q_r),
                (V, sway * yaw_by_v),
                (PIVOT, sway),
                (ACCEL_BIAS, -known * t.cos_a),
                (ACCEL_BIAS + 2, known * t.sin_a),
            ],
            x: [
                (V, dt * cos_h),
                (Q_R_RATE, -dt * radius * sin_h),
                (HEADING, -dt * y_rate),
            ],
            y: [
                (V, dt * sin_h),
                (Q_R_RATE, dt * radius * cos_h),
                (HEADING, dt * x_rate),
            ],
        };
        transition.carry(&mut self.p.data.0);
        self.add_process_noise(dt, unknown_force, radius, config);
        end
    }

    fn add_process_noise(
        &mut self,
        dt: f64,
        unknown_force: bool,
        radius: f64,
        config: &EstimatorConfig,
    ) {
        // The mean of two neighbouring samples has half a sample's variance, and its neighbour shares one of them: over many
        // frames that is again one sample's noise for each interval.
        let mut force = config.accel_noise * config.accel_noise * config.sample_interval;
        if unknown_force {
            force += UNKNOWN_FORCE * UNKNOWN_FORCE;
        }
        let roll = force / (radius * radius);
        let swing = config.alpha_accel * config.alpha_accel;
        let mut pivot = 2.0 * config.pivot_rate * config.pivot_rate / config.pivot_time;
        if self.pivoting > 0.0 {
            pivot += PIVOT_ACCEL * PIVOT_ACCEL;
            let turning = self.x[PIVOT].abs() > PIVOT_OVER;
            self.pivoting = if turning {
                PIVOT_LINGERS
            } else {
                self.pivoting - dt
            };
        }
        let p = &mut self.p;
        for (angle, rate, density) in [(Q_R, Q_R_RATE, roll), (ALPHA, ALPHA_RATE, swing)] {
            // White acceleration through a double integrator.
            p[(angle, angle)] += density * dt * dt * dt / 3.0;
            p[(angle, rate)] += density * dt * dt / 2.0;
            p[(rate, angle)] += density * dt * dt / 2.0;
            p[(rate, rate)] += density * dt;
        }
        p[(V, V)] += force * dt;
        p[(PIVOT, PIVOT)] += pivot * dt;
        for (first, count, walk) in [
            (X, 2, config.slip),
            (GYRO_BIAS, 3, config.gyro_bias_walk),
            (ACCEL_BIAS, 3, config.accel_bias_walk),
        ] {
            for i in first..first + count {
                p[(i, i)] += walk * walk * dt;
            }
        }
    }

    /// The measurements of one frame, all linearised at the prediction.
    ///
    /// Gyro, from W = −α̇ n − q̇_r e_f + φ̇ e_z with n the long axis:
    /// ω_x = −q̇_r cos α + φ̇ cos q_r sin α,  ω_y = −α̇ − φ̇ sin q_r,  ω_z = q̇_r sin α + φ̇ cos q_r cos α.
    /// Encoder: θ_p = φ_s + α.
    fn correct(&mut self, t: &Trig, step: &Step, body: &Body, config: &EstimatorConfig) -> Gates {
        let radius = body.radius;
        let x = self.x;
        let (q_r_rate, v) = (x[Q_R_RATE], x[V]);
        let mut correction = Correction::of(self);

        if let Some(gyro) = step.gyro {
            let noise = square(config.gyro_noise);
            // φ̇ cos q_r = v sin q_r/R + pivot cos q_r, and its derivative with respect to q_r.
            let yaw_up = v * t.sin_r / radius + x[PIVOT] * t.cos_r;
            let yaw_up_by_q_r = v * t.cos_r / radius - x[PIVOT] * t.sin_r;
            let up_by_v = t.sin_r / radius;

            let forward = -q_r_rate * t.cos_a + yaw_up * t.sin_a + x[GYRO_BIAS];
            let h = [
                (Q_R_RATE, -t.cos_a),
                (ALPHA, q_r_rate * t.sin_a + yaw_up * t.cos_a),
                (Q_R, yaw_up_by_q_r * t.sin_a),
                (V, up_by_v * t.sin_a),
                (PIVOT, t.cos_r * t.sin_a),
                (GYRO_BIAS, 1.0),
            ];
            correction.gated(Channel::GyroForward, &h, gyro[0] - forward, noise);

            let left = -x[ALPHA_RATE] - yaw_up * t.tan_r + x[GYRO_BIAS + 1];
            let h = [
                (ALPHA_RATE, -1.0),
                (
                    Q_R,
                    -yaw_up_by_q_r * t.tan_r - yaw_up * (1.0 + t.tan_r * t.tan_r),
                ),
                (V, -up_by_v * t.tan_r),
                (PIVOT, -t.sin_r),
                (GYRO_BIAS + 1, 1.0),
            ];
            let residual = gyro[1] - left;
            let reach = body.swing_accel_max * step.dt;
            correction.admit_swing(&h, residual, noise, step.dt, reach);
            correction.gated(Channel::GyroLeft, &h, residual, noise);

            let up = q_r_rate * t.sin_a + yaw_up * t.cos_a + x[GYRO_BIAS + 2];
            let h = [
                (Q_R_RATE, t.sin_a),
                (ALPHA, q_r_rate * t.cos_a - yaw_up * t.sin_a),
                (Q_R, yaw_up_by_q_r * t.cos_a),
                (V, up_by_v * t.cos_a),
                (PIVOT, t.cos_r * t.cos_a),
                (GYRO_BIAS + 2, 1.0),
            ];
            correction.gated(Channel::GyroUp, &h, gyro[2] - up, noise);
        }
        if let Some(theta_p) = step.theta_p {
            let residual = theta_p - x[SHELL] - x[ALPHA];
            let h = [(SHELL, 1.0), (ALPHA, 1.0)];
            correction.gated(Channel::Encoder, &h, residual, square(config.encoder_noise));
        }
        if step.accel.is_some() {
            // The floor is flat: the vertical specific force is g, and what is left over is the upward bias.
            let m = Motion::of(&x, t, q_r_rate, v, step.accel, radius);
            let h = [
                (Q_R, -m.left),
                (ALPHA, m.forward * t.cos_r),
                (ACCEL_BIAS, -t.sin_a * t.cos_r),
                (ACCEL_BIAS + 1, t.sin_r),
                (ACCEL_BIAS + 2, -t.cos_a * t.cos_r),
            ];
            let residual = body.gravity - m.vertical;
            let noise = square(config.floor_bumps) + square(config.accel_noise);
            if residual.abs() < BUMP {
                correction.plain(&h, residual, noise);
            }
        }
        if step.at_rest {
            // Zero rates: what the gyro still shows is its bias.
            for rate in [Q_R_RATE, ALPHA_RATE, PIVOT] {
                correction.plain(&[(rate, 1.0)], -x[rate], square(config.rest_rate));
            }
        }
        correction.finish()
    }

    /// Standard deviation of one state.
    pub(super) fn sigma(&self, place: usize) -> f64 {
        self.p[(place, place)].max(0.0).sqrt()
    }

    /// All numbers are finite and the robot stands on its shell, not on its head.
    pub(super) fn is_sound(&self) -> bool {
        self.x.iter().all(|value| value.is_finite())
            && (0..STATES).all(|i| self.p[(i, i)].is_finite())
            && self.x[Q_R].abs() < ANGLE_MAX
            && self.x[ALPHA].abs() < ANGLE_MAX
    }
}

fn square(x: f64) -> f64 {
    x * x
}

/// Angle beyond which tan q_r means nothing [rad]: 83°.
const ANGLE_MAX: f64 = 1.45;
/// Density of the pivot's acceleration while the shell pivots: the gyro alone tells the heading [rad/s²/√Hz].
const PIVOT_ACCEL: f64 = 2.0;
/// Pivoting slower than this is over [rad/s].
const PIVOT_OVER: f64 = 0.03;
/// For so long it may come back [s].
const PIVOT_LINGERS: f64 = 0.5;
/// Longest stride of the prediction [s].
const STRIDE_MAX: f64 = 0.01;
/// Vertical acceleration beyond which the floor is not flat [m/s²].
const BUMP: f64 = 1.0;
/// Density of the force that nobody measured in a gap, per mass [m/s²/√Hz].
const UNKNOWN_FORCE: f64 = 1.0;
