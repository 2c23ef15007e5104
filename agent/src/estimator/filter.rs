//! The extended Kalman filter: sixteen states, one sensor frame at a time.
//!
//! The accelerometer drives the speeds of the centre, so that gravity enters through them: a wrong lean would let the predicted
//! R q̇_r run away from the gyro's, a wrong pitch the predicted v from the encoder's. No acceleration is ever formed by differencing
//! a rate, whose noise would telescope over a window; the filter weighs every window by itself. Gyro and encoder are
//! measurements, never inputs: their noise enters once.

use nalgebra::{Rotation2, SMatrix, SVector, Vector2};

use super::config::EstimatorConfig;

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

/// Scalar measurements whose innovation is gated.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Channel {
    GyroForward,
    GyroLeft,
    GyroUp,
    Encoder,
}

/// Which channels a frame's gates refused, and which the filter was opened for.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Gates {
    pub(super) rejected: [bool; 4],
    pub(super) reopened: [bool; 4],
}

/// What the filter knows of the robot.
#[derive(Clone, Copy, Debug)]
pub(super) struct Body {
    /// Radius of the sphere, R [m].
    pub(super) radius: f64,
    /// Gravity, g [m/s²].
    pub(super) gravity: f64,
}

/// State and covariance at the stamp of one frame.
#[derive(Clone, Debug)]
pub(super) struct Filter {
    pub(super) x: State,
    pub(super) p: Covariance,
    /// Consecutive refusals of each channel.
    streaks: [u8; 4],
    /// Time for which pivoting still counts as possible: more than 0 from a pivot until it has been small for a while [s].
    pivoting: f64,
}

/// A position fix brought to the stamp of a frame.
#[derive(Clone, Copy, Debug)]
pub(super) struct FixAt {
    /// World X and Y [m].
    pub(super) position: [f64; 2],
    /// Standard deviation of each axis [m].
    pub(super) sigma: f64,
    /// Time from the frame to the fix, mostly ≤ 0 [s].
    pub(super) ahead: f64,
}

/// Angles' sines and cosines.
#[derive(Clone, Copy)]
struct Trig {
    sin_r: f64,
    cos_r: f64,
    tan_r: f64,
    sin_a: f64,
    cos_a: f64,
}

/// The motion of the centre that a specific force means at an attitude; all zero accelerations without an accelerometer.
#[derive(Clone, Copy)]
struct Motion {
    /// Horizontal acceleration forward, v̇ − R q̇_r φ̇ [m/s²].
    forward: f64,
    /// Horizontal acceleration to the left, R q̈_r + v φ̇ [m/s²].
    left: f64,
    /// Specific force across the lateral axis, upward in its plane [m/s²].
    up: f64,
    /// Vertical specific force: g on a flat floor [m/s²].
    vertical: f64,
    /// φ̇ [rad/s].
    yaw_rate: f64,
    /// v̇ [m/s²].
    v_rate: f64,
    /// q̈_r [rad/s²].
    q_r_accel: f64,
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
        for _ in 0..strides as u32 {
            self.predict(step.dt / strides, step.accel, unknown_force, radius, config);
        }
        self.correct(step, body, config)
    }

    /// Prediction over `dt` [s] by the midpoint rule, and P = F P Fᵀ + Q.
    ///
    /// q̈_r = (a_left − v φ̇)/R,  v̇ = a_forward + R q̇_r φ̇,  φ̇ = v tan q_r/R + pivot,  φ̇_s = v/(R cos q_r),  eq (1) for the position.
    fn predict(
        &mut self,
        dt: f64,
        accel: Option<[f64; 3]>,
        unknown_force: bool,
        radius: f64,
        config: &EstimatorConfig,
    ) {
        let x = &mut self.x;
        let half = 0.5 * dt;

        let start = Trig::of(x[Q_R], x[ALPHA]);
        let (q_r_rate, v, pivot) = (x[Q_R_RATE], x[V], x[PIVOT]);
        let m = Motion::of(x, &start, q_r_rate, v, accel, radius);
        let q_r_rate_mid = q_r_rate + half * m.q_r_accel;
        let v_mid = v + half * m.v_rate;
        let heading_mid = x[HEADING] + half * m.yaw_rate;

        let t = Trig::of(x[Q_R] + half * q_r_rate, x[ALPHA] + half * x[ALPHA_RATE]);
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

        // F − I at the midpoint, (row, column, entry). Without an accelerometer its bias drives nothing.
        let known = if accel.is_some() { dt } else { 0.0 };
        let yaw_by_q_r = v_mid * (1.0 + t.tan_r * t.tan_r) / radius;
        let yaw_by_v = t.tan_r / radius;
        let sway = dt * radius * q_r_rate_mid;
        let by_r = dt / radius;
        let transition = [
            (Q_R, Q_R_RATE, dt),
            (Q_R_RATE, Q_R, by_r * (m.vertical - v_mid * yaw_by_q_r)),
            (Q_R_RATE, ALPHA, by_r * m.forward * t.sin_r),
            (Q_R_RATE, V, -by_r * (m.yaw_rate + v_mid * yaw_by_v)),
            (Q_R_RATE, PIVOT, -by_r * v_mid),
            (Q_R_RATE, ACCEL_BIAS, -known / radius * t.sin_a * t.sin_r),
            (Q_R_RATE, ACCEL_BIAS + 1, -known / radius * t.cos_r),
            (
                Q_R_RATE,
                ACCEL_BIAS + 2,
                -known / radius * t.cos_a * t.sin_r,
            ),
            (ALPHA, ALPHA_RATE, dt),
            (HEADING, V, dt * yaw_by_v),
            (HEADING, Q_R, dt * yaw_by_q_r),
            (HEADING, PIVOT, dt),
            (PIVOT, PIVOT, pivot_kept - 1.0),
            (SHELL, V, by_r / t.cos_r),
            (SHELL, Q_R, by_r * v_mid * t.tan_r / t.cos_r),
            (V, ALPHA, -dt * m.up),
            (V, Q_R_RATE, dt * radius * m.yaw_rate),
            (V, Q_R, sway * yaw_by_q_r),
            (V, V, sway * yaw_by_v),
            (V, PIVOT, sway),
            (V, ACCEL_BIAS, -known * t.cos_a),
            (V, ACCEL_BIAS + 2, known * t.sin_a),
            (X, V, dt * cos_h),
            (X, Q_R_RATE, -dt * radius * sin_h),
            (X, HEADING, -dt * y_rate),
            (Y, V, dt * sin_h),
            (Y, Q_R_RATE, dt * radius * cos_h),
            (Y, HEADING, dt * x_rate),
        ];
        // P is symmetric: (P Fᵀ)ᵀ = F P, and (F P) Fᵀ is symmetric again.
        let f_p = times_transition(&self.p, &transition).transpose();
        self.p = times_transition(&f_p, &transition);
        make_symmetric(&mut self.p);
        self.add_process_noise(dt, unknown_force, radius, config);
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
    fn correct(&mut self, step: &Step, body: &Body, config: &EstimatorConfig) -> Gates {
        let radius = body.radius;
        let x = self.x;
        let t = Trig::of(x[Q_R], x[ALPHA]);
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
            correction.gated(Channel::GyroLeft, &h, gyro[1] - left, noise);

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
            let m = Motion::of(&x, &t, q_r_rate, v, step.accel, radius);
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

    /// Squared innovation of a fix over its variance: chi-square with two degrees of freedom if all is well.
    pub(super) fn fix_distance(&self, fix: &FixAt, radius: f64) -> f64 {
        let (residual, [h_x, h_y]) = self.fix_model(fix, radius);
        let (p_x, p_y) = (times(&self.p, &h_x), times(&self.p, &h_y));
        let noise = square(fix.sigma);
        let s_xx = dot(&h_x, &p_x) + noise;
        let s_xy = dot(&h_y, &p_x);
        let s_yy = dot(&h_y, &p_y) + noise;
        let [r_x, r_y] = residual;
        (s_yy * r_x * r_x - 2.0 * s_xy * r_x * r_y + s_xx * r_y * r_y) / (s_xx * s_yy - s_xy * s_xy)
    }

    /// Fuses a position fix, without a gate.
    pub(super) fn fuse_fix(&mut self, fix: &FixAt, radius: f64) {
        let (residual, h) = self.fix_model(fix, radius);
        let mut correction = Correction::of(self);
        for (h, residual) in h.iter().zip(residual) {
            correction.plain(h, residual, square(fix.sigma));
        }
        correction.finish();
    }

    /// Forgets where the robot is, so far as the fix says: its innovation counts as one standard deviation.
    pub(super) fn reopen_position(&mut self, fix: &FixAt, radius: f64, heading_sigma: f64) {
        let (residual, _) = self.fix_model(fix, radius);
        self.p[(X, X)] += square(residual[0]);
        self.p[(Y, Y)] += square(residual[1]);
        self.p[(HEADING, HEADING)] += square(heading_sigma);
    }

    /// Where the centre was `ahead` [s] from the frame, the speed held.
    pub(super) fn position_at(&self, ahead: f64, radius: f64) -> Vector2<f64> {
        let x = &self.x;
        let (sin_h, cos_h) = x[HEADING].sin_cos();
        let (forward, left) = (ahead * x[V], ahead * radius * x[Q_R_RATE]);
        Vector2::new(
            x[X] + forward * cos_h - left * sin_h,
            x[Y] + forward * sin_h + left * cos_h,
        )
    }

    /// Turns the pose about `from` and shifts that point to `to`.
    pub(super) fn turn_pose(
        &mut self,
        turn: &Rotation2<f64>,
        from: Vector2<f64>,
        to: Vector2<f64>,
    ) {
        let position = turn * (Vector2::new(self.x[X], self.x[Y]) - from) + to;
        (self.x[X], self.x[Y]) = (position.x, position.y);
        self.x[HEADING] += turn.angle();
    }

    /// Gives the pose new standard deviations that owe nothing to the other states.
    pub(super) fn restart_pose(&mut self, position_sigma: f64, heading_sigma: f64) {
        for (place, sigma) in [
            (X, position_sigma),
            (Y, position_sigma),
            (HEADING, heading_sigma),
        ] {
            self.p.fill_row(place, 0.0);
            self.p.fill_column(place, 0.0);
            self.p[(place, place)] = square(sigma);
        }
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

    /// Innovation of a fix and its derivatives, by eq (1) from the frame to the fix.
    fn fix_model(&self, fix: &FixAt, radius: f64) -> ([f64; 2], [[(usize, f64); 4]; 2]) {
        let x = &self.x;
        let (sin_h, cos_h) = x[HEADING].sin_cos();
        let x_rate = x[V] * cos_h - radius * x[Q_R_RATE] * sin_h;
        let y_rate = x[V] * sin_h + radius * x[Q_R_RATE] * cos_h;
        let ahead = fix.ahead;
        let residual = [
            fix.position[0] - x[X] - ahead * x_rate,
            fix.position[1] - x[Y] - ahead * y_rate,
        ];
        let h_x = [
            (X, 1.0),
            (V, ahead * cos_h),
            (Q_R_RATE, -ahead * radius * sin_h),
            (HEADING, -ahead * y_rate),
        ];
        let h_y = [
            (Y, 1.0),
            (V, ahead * sin_h),
            (Q_R_RATE, ahead * radius * cos_h),
            (HEADING, ahead * x_rate),
        ];
        (residual, [h_x, h_y])
    }
}

impl Trig {
    fn of(q_r: f64, alpha: f64) -> Self {
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
    fn of(
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

/// One batch of scalar measurements with independent noise, fused one after the other.
struct Correction<'a> {
    filter: &'a mut Filter,
    /// Sum of the corrections so far; the state moves once, at the end, because all derivatives belong to the same point.
    dx: State,
    gates: Gates,
}

impl<'a> Correction<'a> {
    fn of(filter: &'a mut Filter) -> Self {
        Self {
            filter,
            dx: State::zeros(),
            gates: Gates::default(),
        }
    }

    /// Fuses one measurement: K = P hᵀ/s, P −= K s Kᵀ.
    fn plain(&mut self, h: &[(usize, f64)], residual: f64, variance: f64) {
        let p_h = times(&self.filter.p, h);
        let s = dot(h, &p_h) + variance;
        self.fuse(&p_h, residual - dot(h, &self.dx), s);
    }

    /// Fuses one measurement unless its innovation is beyond the gate. A channel that stays beyond it for three frames is believed:
    /// the state it measures most directly is opened to it (a pivot, a push, an encoder that restarted).
    fn gated(&mut self, channel: Channel, h: &[(usize, f64)], residual: f64, variance: f64) {
        let mut p_h = times(&self.filter.p, h);
        let mut s = dot(h, &p_h) + variance;
        let innovation = residual - dot(h, &self.dx);
        let streak = &mut self.filter.streaks[channel as usize];
        if innovation * innovation <= channel.gate() * s {
            *streak = 0;
        } else if *streak < STREAK_MAX {
            *streak += 1;
            self.gates.rejected[channel as usize] = true;
            return;
        } else {
            self.gates.reopened[channel as usize] = true;
            if channel == Channel::GyroUp {
                self.filter.pivoting = PIVOT_LINGERS;
            }
            let opened = channel.opened_state();
            self.filter.p[(opened, opened)] += innovation * innovation;
            p_h = times(&self.filter.p, h);
            s = dot(h, &p_h) + variance;
        }
        self.fuse(&p_h, innovation, s);
    }

    fn fuse(&mut self, p_h: &State, innovation: f64, s: f64) {
        let gain = p_h / s;
        self.dx += gain * innovation;
        let (gain, p_h) = (&gain.data.0[0], &p_h.data.0[0]);
        for (column, weight) in self.filter.p.data.0.iter_mut().zip(gain) {
            for (entry, other) in column.iter_mut().zip(p_h) {
                *entry -= weight * other;
            }
        }
    }

    fn finish(self) -> Gates {
        self.filter.x += self.dx;
        self.gates
    }
}

impl Channel {
    /// Gate on the squared innovation over its variance.
    ///
    /// Six standard deviations are beyond any white noise. The swing's acceleration is no white noise: full torque, 40 rad/s²,
    /// must pass at once, and shows in the gyro's left axis and in the encoder.
    fn gate(self) -> f64 {
        match self {
            Self::GyroForward | Self::GyroUp => 36.0,
            Self::GyroLeft | Self::Encoder => 144.0,
        }
    }

    fn opened_state(self) -> usize {
        match self {
            Self::GyroForward => Q_R_RATE,
            Self::GyroLeft => ALPHA_RATE,
            Self::GyroUp => PIVOT,
            Self::Encoder => SHELL,
        }
    }
}

/// A (I + D)ᵀ for the few entries of D: each adds a multiple of one column to another.
fn times_transition(a: &Covariance, transition: &[(usize, usize, f64)]) -> Covariance {
    let mut product = *a;
    let (columns, source) = (&mut product.data.0, &a.data.0);
    for &(row, column, entry) in transition {
        for (sum, value) in columns[row].iter_mut().zip(&source[column]) {
            *sum += entry * value;
        }
    }
    product
}

/// (A + Aᵀ)/2: rounding must not make a covariance lopsided.
fn make_symmetric(a: &mut Covariance) {
    for i in 0..STATES {
        for j in 0..i {
            let mean = 0.5 * (a[(i, j)] + a[(j, i)]);
            a[(i, j)] = mean;
            a[(j, i)] = mean;
        }
    }
}

fn times(p: &Covariance, h: &[(usize, f64)]) -> State {
    let mut sum = State::zeros();
    for &(state, weight) in h {
        for (entry, value) in sum.data.0[0].iter_mut().zip(&p.data.0[state]) {
            *entry += weight * value;
        }
    }
    sum
}

fn dot(h: &[(usize, f64)], x: &State) -> f64 {
    h.iter().map(|&(state, weight)| weight * x[state]).sum()
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
/// Frames that a gate refuses in a row before the channel is believed.
const STREAK_MAX: u8 = 3;
/// Density of the force that nobody measured in a gap, per mass [m/s²/√Hz].
const UNKNOWN_FORCE: f64 = 1.0;
