//! What the estimator is told before it starts: where the robot stands and how good its sensors are.

use core::f64::consts::TAU;

/// Where the robot stands when the estimator starts, and how well that is known.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StartPose {
    /// World X of the sphere's centre [m].
    pub x: f64,
    /// World Y of the sphere's centre [m].
    pub y: f64,
    /// Yaw φ [rad].
    pub heading: f64,
    /// Standard deviation of `x` and of `y` [m].
    pub position_sigma: f64,
    /// Standard deviation of `heading` [rad]. Above [`EstimatorConfig::heading_known`] the heading counts as unknown: it is then
    /// taken from the first stretch that the robot drives under position fixes.
    pub heading_sigma: f64,
}

/// Noise and thresholds of the estimator. The defaults match the simulator's sensors at `noise = 1`, with a margin where a real
/// sensor is worse than its white noise.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EstimatorConfig {
    /// Where the robot stands.
    pub start: StartPose,
    /// Time from one sensor frame to the next [s]: 5 ms, 200 Hz.
    pub sample_interval: f64,
    /// White noise of each gyro axis, one sample [rad/s]: 0.3 °/s.
    pub gyro_noise: f64,
    /// Standard deviation of each gyro bias at the start [rad/s]: 0.3 °/s, the sensor's 0.2 °/s with a margin.
    pub gyro_bias: f64,
    /// Random walk of each gyro bias [rad/s/√s]: 0.003 °/s/√s.
    pub gyro_bias_walk: f64,
    /// White noise of each accelerometer axis, one sample [m/s²]: 0.05 m/s².
    pub accel_noise: f64,
    /// Standard deviation of each accelerometer bias [m/s²]: 0.03 m/s².
    pub accel_bias: f64,
    /// Random walk of each accelerometer bias [m/s²/√s]: 1e-4, slow enough to average over minutes.
    pub accel_bias_walk: f64,
    /// Vertical acceleration on the floor's unevenness, one sample [m/s²]: 0.1.
    pub floor_bumps: f64,
    /// Error of one encoder reading [rad]: the quantisation 2π/65536/√12.
    pub encoder_noise: f64,
    /// Density of the unknown acceleration of the swing α [rad/s²/√Hz]. The accelerometer at the sphere's centre does not feel it.
    /// 0.2 suits torques that change by some tenths of a N·m from one control period to the next; more follows kicks sooner and
    /// lets more gyro noise into α̇ (0.6: 0.29 °/s instead of 0.25).
    pub alpha_accel: f64,
    /// Density of the unknown jerk of the joint angle θ_r [rad/s³/√Hz]; it sets the bandwidth of the rate of β.
    pub theta_r_jerk: f64,
    /// Standard deviation of the shell's pivoting about the vertical, φ̇ − v tan q_r/R [rad/s]. Rubber rolling has none.
    pub pivot_rate: f64,
    /// Time over which pivoting is correlated [s].
    pub pivot_time: f64,
    /// How still a robot at rest is: standard deviation of each rate of the frame, one sample [rad/s].
    pub rest_rate: f64,
    /// Random walk of the position by slip on the floor [m/√s].
    pub slip: f64,
    /// Heading standard deviation up to which position fixes correct the heading linearly [rad].
    pub heading_known: f64,
}

impl Default for StartPose {
    /// At the origin, heading along X, set down by hand: 2 cm, 2°.
    fn default() -> Self {
        Self {
            x: 0.0,
            y: 0.0,
            heading: 0.0,
            position_sigma: 0.02,
            heading_sigma: 2.0 * DEGREE,
        }
    }
}

impl Default for EstimatorConfig {
    fn default() -> Self {
        Self {
            start: StartPose::default(),
            sample_interval: 0.005,
            gyro_noise: 0.3 * DEGREE,
            gyro_bias: 0.3 * DEGREE,
            gyro_bias_walk: 0.003 * DEGREE,
            accel_noise: 0.05,
            accel_bias: 0.03,
            accel_bias_walk: 1e-4,
            floor_bumps: 0.1,
            encoder_noise: TAU / 65536.0 * 0.288_675,
            alpha_accel: 0.2,
            theta_r_jerk: 50.0,
            pivot_rate: 3e-4,
            pivot_time: 0.5,
            rest_rate: 1e-3,
            slip: 3e-4,
            heading_known: 0.5,
        }
    }
}

const DEGREE: f64 = TAU / 360.0;
