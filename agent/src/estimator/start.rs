//! The filter of the first frame.

use core::f64::consts::PI;

use super::config::EstimatorConfig;
use super::filter::{
    ACCEL_BIAS, ALPHA, ALPHA_RATE, Body, Covariance, Filter, GYRO_BIAS, HEADING, PIVOT, Q_R,
    Q_R_RATE, SHELL, State, V, X, Y,
};

/// The first frame with all sensors.
pub(super) struct FirstFrame {
    /// Angular velocity [rad/s].
    pub(super) gyro: [f64; 3],
    /// Specific force [m/s²].
    pub(super) accel: [f64; 3],
    /// θ_r, θ_p [rad].
    pub(super) theta: [f64; 2],
    /// Rate of θ_p [rad/s].
    pub(super) theta_p_rate: f64,
}

/// Attitude from gravity; pose and biases as configured or, after an outage of so many seconds, as the filter `before` had them.
pub(super) fn first_filter(
    first: &FirstFrame,
    before: Option<&(Filter, f64)>,
    body: &Body,
    config: &EstimatorConfig,
) -> Filter {
    let start = &config.start;
    let mut x = State::zeros();
    let mut sigma = State::zeros();
    (x[X], x[Y], x[HEADING]) = (start.x, start.y, start.heading);
    sigma[X] = start.position_sigma;
    sigma[Y] = start.position_sigma;
    sigma[HEADING] = start.heading_sigma.min(PI);
    for i in 0..3 {
        sigma[GYRO_BIAS + i] = config.gyro_bias;
    }
    for i in 0..3 {
        sigma[ACCEL_BIAS + i] = config.accel_bias;
    }
    if let Some((filter, away)) = before {
        for place in [X, Y, HEADING] {
            x[place] = filter.x[place];
        }
        let ran = (filter.x[V].abs() + 0.1) * away;
        let turned = 0.1 + 0.3 * away;
        sigma[X] = filter.sigma(X).hypot(ran);
        sigma[Y] = filter.sigma(Y).hypot(ran);
        sigma[HEADING] = filter.sigma(HEADING).hypot(turned).min(PI);
        for place in GYRO_BIAS..ACCEL_BIAS + 3 {
            x[place] = filter.x[place];
            sigma[place] = filter.sigma(place);
        }
    }

    let FirstFrame {
        gyro, accel, theta, ..
    } = *first;
    let rates: [f64; 3] = core::array::from_fn(|i| gyro[i] - x[GYRO_BIAS + i]);
    x[Q_R_RATE] = -rates[0];
    x[ALPHA_RATE] = -rates[1];
    // v = R cos q_r (θ̇_p − α̇) and φ̇ from the gyro; accelerations unknown.
    x[V] = body.radius * (first.theta_p_rate - x[ALPHA_RATE]);
    let left = x[V] * rates[2] - (accel[1] - x[ACCEL_BIAS + 1]);
    x[Q_R] = (left / body.gravity).clamp(-1.0, 1.0).asin();
    x[ALPHA] = ((accel[0] - x[ACCEL_BIAS]) / body.gravity)
        .clamp(-1.0, 1.0)
        .asin();
    x[SHELL] = theta[1] - x[ALPHA];
    let rate_limit = 4.0 * (config.gyro_noise + config.gyro_bias);
    let still = rates.iter().all(|rate| rate.abs() < rate_limit) && x[V].abs() < STILL_V;
    sigma[Q_R_RATE] = config.gyro_noise.hypot(sigma[GYRO_BIAS]);
    sigma[ALPHA_RATE] = config.gyro_noise.hypot(sigma[GYRO_BIAS + 1]);
    sigma[PIVOT] = config.pivot_rate;
    sigma[SHELL] = 1.0;
    sigma[V] = MOVING_SIGMA_V;
    let unknown = if still {
        config.accel_noise
    } else {
        MOVING_SIGMA * body.gravity
    };
    sigma[Q_R] = unknown.hypot(sigma[ACCEL_BIAS + 1]) / body.gravity;
    sigma[ALPHA] = unknown.hypot(sigma[ACCEL_BIAS]) / body.gravity;
    let mut p = Covariance::from_diagonal(&sigma.component_mul(&sigma));
    // Gravity tells lean and bias together: q_r is wrong by +b/g, α by −b/g.
    for (angle, bias, sign) in [(Q_R, ACCEL_BIAS + 1, 1.0), (ALPHA, ACCEL_BIAS, -1.0)] {
        let shared = sign * sigma[bias] * sigma[bias] / body.gravity;
        p[(angle, bias)] = shared;
        p[(bias, angle)] = shared;
    }
    Filter::new(x, p)
}

/// Standard deviation of angles and rates when the estimator starts in motion [rad, rad/s].
pub(super) const MOVING_SIGMA: f64 = 0.1;
/// Standard deviation of the speed at the start [m/s].
pub(super) const MOVING_SIGMA_V: f64 = 0.03;
/// Speed below which the estimator starts as if at rest [m/s].
const STILL_V: f64 = 0.03;
