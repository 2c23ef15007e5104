//! What the motor board measures: IMU, encoders, and fixes of the position from outside.
//!
//! Every sensor owns its random stream, handed in by the caller. Draws are made in a fixed order and *whatever the noise factor is*, so
//! that a run depends on its seed alone, and two runs that differ in the factor meet the same noise, scaled:
//! - IMU, at the start: bias of the gyro (forward, left, up), then bias of the accelerometer;
//! - IMU, each frame: white noise of the gyro (forward, left, up), step of its bias, white noise of the accelerometer;
//! - position, each fix: X, then Y.
//!
//! Each is one draw of the standard normal distribution.

use std::collections::VecDeque;

use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

use sphere_protocol::state::{BoardStatus, Measurement, PositionFix};
use sphere_protocol::time::{BoardClock, Instant, Span};

use crate::plant::{PlantState, TrueImu};

/// White noise of the gyro, standard deviation of a sample [rad/s].
const GYRO_WHITE: f64 = 0.3 * DEG;
/// Bias of the gyro at the start, standard deviation of an axis [rad/s].
const GYRO_BIAS: f64 = 0.2 * DEG;
/// Random walk of the gyro's bias [rad/s/√s].
const GYRO_WALK: f64 = 0.003 * DEG;
/// White noise of the accelerometer, standard deviation of a sample [m/s²].
const ACCEL_WHITE: f64 = 0.05;
/// Bias of the accelerometer, standard deviation of an axis [m/s²].
const ACCEL_BIAS: f64 = 0.03;
/// Step of the encoders [rad].
const ENCODER_STEP: f64 = core::f64::consts::TAU / 65536.0;
/// Sample interval of the board.
const SAMPLE_INTERVAL: Span = Span::from_millis(5);
/// From when a position is true to when it arrives.
const FIX_DELAY: Span = Span::from_millis(50);
/// Smallest standard deviation that a fix reports [m]: a filter divides by its square.
const FIX_SIGMA_MIN: f64 = 1e-3;
const DEG: f64 = core::f64::consts::PI / 180.0;

/// IMU and encoders of one robot, sampled together.
#[derive(Clone, Debug)]
pub struct Sensors {
    /// Factor on every error; 0 = ideal.
    noise: f64,
    random: ChaCha8Rng,
    gyro_bias: [f64; 3],
    accel_bias: [f64; 3],
    last: Option<EncoderSample>,
}

#[derive(Clone, Copy, Debug)]
struct EncoderSample {
    stamp: Instant<BoardClock>,
    theta_r: f64,
    theta_p: f64,
    theta_r_rate: f64,
    theta_p_rate: f64,
}

/// A source of positions from outside (motion capture, UWB): white noise, and a constant delay.
#[derive(Clone, Debug)]
pub struct PositionSource {
    /// Standard deviation of the noise of each axis [m].
    sigma: f64,
    random: ChaCha8Rng,
    under_way: VecDeque<PositionFix>,
}

impl Sensors {
    /// Interval at which the board samples: 200 Hz. The walk of the gyro's bias is one of this interval a frame.
    pub const INTERVAL: Span = SAMPLE_INTERVAL;

    /// Sensors with `noise` times the usual errors, the encoders' step among them; 0 makes them ideal. Draws the biases.
    pub fn new(noise: f64, mut random: ChaCha8Rng) -> Self {
        let gyro_bias = normal(&mut random, noise * GYRO_BIAS);
        let accel_bias = normal(&mut random, noise * ACCEL_BIAS);
        Self {
            noise,
            random,
            gyro_bias,
            accel_bias,
            last: None,
        }
    }

    /// One sensor frame, of a sphere with this `radius` [m]; `stamp` is the board's.
    ///
    /// The rates of the encoders are difference quotients since the frame before; the first frame has none, and reports what the
    /// encoders would have seen had they been sampled one interval earlier at the present rates.
    pub fn sample(
        &mut self,
        stamp: Instant<BoardClock>,
        state: &PlantState,
        radius: f64,
        imu: &TrueImu,
        status: BoardStatus,
    ) -> Measurement {
        let gyro_white = normal(&mut self.random, self.noise * GYRO_WHITE);
        let interval = SAMPLE_INTERVAL.as_secs_f64();
        let walk: [f64; 3] = normal(&mut self.random, self.noise * GYRO_WALK * interval.sqrt());
        let accel_white = normal(&mut self.random, self.noise * ACCEL_WHITE);
        let measured = |truth: [f64; 3], bias: [f64; 3], white: [f64; 3]| {
            core::array::from_fn(|i| truth[i] + bias[i] + white[i])
        };
        let gyro = measured(imu.gyro, self.gyro_bias, gyro_white);
        let accel = measured(imu.specific_force, self.accel_bias, accel_white);
        for (bias, step) in self.gyro_bias.iter_mut().zip(walk) {
            *bias += step;
        }

        let encoders = self.encoders(stamp, state, radius);
        self.last = Some(encoders);
        Measurement {
            stamp,
            gyro,
            accel,
            theta_r: encoders.theta_r,
            theta_r_rate: encoders.theta_r_rate,
            theta_p: encoders.theta_p,
            theta_p_rate: encoders.theta_p_rate,
            status,
        }
    }

    fn encoders(
        &self,
        stamp: Instant<BoardClock>,
        state: &PlantState,
        radius: f64,
    ) -> EncoderSample {
        let (theta_r, theta_p) = (state.theta_r(), state.theta_p());
        let last = self.last.unwrap_or_else(|| {
            let interval = SAMPLE_INTERVAL.as_secs_f64();
            EncoderSample {
                stamp: stamp - SAMPLE_INTERVAL,
                theta_r: self.quantised(theta_r - interval * state.theta_r_rate()),
                theta_p: self.quantised(theta_p - interval * state.theta_p_rate(radius)),
                theta_r_rate: 0.0,
                theta_p_rate: 0.0,
            }
        });
        let (theta_r, theta_p) = (self.quantised(theta_r), self.quantised(theta_p));
        let elapsed = (stamp - last.stamp).as_secs_f64();
        if elapsed <= 0.0 {
            return EncoderSample {
                stamp,
                theta_r,
                theta_p,
                ..last
            };
        }
        EncoderSample {
            stamp,
            theta_r,
            theta_p,
            theta_r_rate: (theta_r - last.theta_r) / elapsed,
            theta_p_rate: (theta_p - last.theta_p) / elapsed,
        }
    }

    fn quantised(&self, angle: f64) -> f64 {
        let step = self.noise * ENCODER_STEP;
        if step == 0.0 {
            return angle;
        }
        (angle / step).round() * step
    }
}

impl PositionSource {
    /// A source whose positions err by `sigma` [m] on each axis, the noise factor included.
    pub fn new(sigma: f64, random: ChaCha8Rng) -> Self {
        Self {
            sigma,
            random,
            under_way: VecDeque::new(),
        }
    }

    /// Takes the true position at `stamp`: the fix arrives 50 ms later.
    pub fn sample(&mut self, stamp: Instant<BoardClock>, state: &PlantState) {
        let [error_x, error_y] = normal(&mut self.random, self.sigma);
        self.under_way.push_back(PositionFix {
            stamp,
            x: state.robot.x + error_x,
            y: state.robot.y + error_y,
            sigma: self.sigma.max(FIX_SIGMA_MIN),
        });
    }

    /// When the next fix arrives.
    pub fn next_arrival(&self) -> Option<Instant<BoardClock>> {
        self.under_way.front().map(|fix| fix.stamp + FIX_DELAY)
    }

    /// The oldest fix that has arrived by `now` and was not taken before; its stamp says when it was true.
    pub fn poll(&mut self, now: Instant<BoardClock>) -> Option<PositionFix> {
        if self.next_arrival()? > now {
            return None;
        }
        self.under_way.pop_front()
    }
}

fn normal<const N: usize>(random: &mut ChaCha8Rng, sigma: f64) -> [f64; N] {
    core::array::from_fn(|_| {
        let draw: f64 = StandardNormal.sample(random);
        sigma * draw
    })
}
