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

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;
    use sphere_protocol::state::RobotState;

    const RADIUS: f64 = 0.35;
    const REST: TrueImu = TrueImu {
        gyro: [0.0; 3],
        specific_force: [0.0, 0.0, 9.81],
    };

    /// Frames of a robot whose roll motor turns at 0.7 rad/s and whose pitch motor at −1.3 rad/s.
    fn frames(noise: f64, seed: u64, count: usize) -> Vec<(Measurement, PlantState)> {
        let mut sensors = Sensors::new(noise, ChaCha8Rng::seed_from_u64(seed));
        let mut stamp = Instant::from_nanos(0);
        let mut frames = Vec::new();
        for i in 0..count {
            let t = 0.005 * i as f64;
            let robot = RobotState {
                beta: 0.7 * t,
                beta_rate: 0.7,
                alpha: -1.3 * t,
                alpha_rate: -1.3,
                ..RobotState::default()
            };
            let state = PlantState { robot, phi_s: 0.0 };
            let status = BoardStatus::default();
            frames.push((sensors.sample(stamp, &state, RADIUS, &REST, status), state));
            stamp += Sensors::INTERVAL;
        }
        frames
    }

    fn deviation(values: &[f64]) -> f64 {
        (values.iter().map(|x| x * x).sum::<f64>() / values.len() as f64).sqrt()
    }

    #[test]
    fn gyro_and_accelerometer_err_as_much_as_documented() {
        // First frames of 4000 robots: bias and white noise. 3 axes each: 0.65 % standard error of a deviation.
        let first: Vec<_> = (0..4000).map(|seed| frames(1.0, seed, 1)[0].0).collect();
        let gyro: Vec<_> = first.iter().flat_map(|m| m.gyro).collect();
        let expected = (0.3_f64.hypot(0.2)).to_radians();
        assert!((deviation(&gyro) / expected - 1.0).abs() < 0.03);
        let accel: Vec<_> = first
            .iter()
            .flat_map(|m| [m.accel[0], m.accel[1], m.accel[2] - 9.81])
            .collect();
        assert!((deviation(&accel) / 0.05_f64.hypot(0.03) - 1.0).abs() < 0.03);
    }

    #[test]
    fn gyro_bias_walks() {
        // Means of the first and last 1000 of 20 000 frames are 95 s apart: the walk and what averaging leaves of the white noise.
        let mut drift = Vec::new();
        for seed in 0..60 {
            let frames = frames(1.0, seed, 20_000);
            for axis in 0..3 {
                let mean = |part: &[(Measurement, PlantState)]| {
                    part.iter().map(|(m, _)| m.gyro[axis]).sum::<f64>() / part.len() as f64
                };
                drift.push(mean(&frames[19_000..]) - mean(&frames[..1000]));
            }
        }
        let (walk, white) = (0.003 * 95.0_f64.sqrt(), 0.3 * (2.0_f64 / 1000.0).sqrt());
        let expected = walk.hypot(white).to_radians();
        // 180 values: 5 % standard error, so ± 20 % is four of them; without a walk the ratio would be 0.42.
        let ratio = deviation(&drift) / expected;
        assert!((0.8..1.2).contains(&ratio), "{ratio}");
    }

    #[test]
    fn noise_factor_scales_every_error() {
        let status = BoardStatus::default();
        let still = PlantState::default();
        let at_rest = TrueImu {
            specific_force: [0.0; 3],
            ..REST
        };
        let mut sensors = [1.0, 2.0].map(|n| Sensors::new(n, ChaCha8Rng::seed_from_u64(3)));
        for i in 0..100 {
            let stamp = Instant::from_nanos(i * 5_000_000);
            let [one, two] = sensors
                .each_mut()
                .map(|s| s.sample(stamp, &still, RADIUS, &at_rest, status));
            // Twice is exact in binary.
            assert_eq!(one.gyro.map(|x| 2.0 * x), two.gyro);
            assert_eq!(one.accel.map(|x| 2.0 * x), two.accel);
        }
    }

    #[test]
    fn encoders_are_quantised_and_their_rates_are_difference_quotients() {
        for (m, state) in frames(1.0, 5, 1000) {
            for (angle, truth) in [(m.theta_r, state.theta_r()), (m.theta_p, state.theta_p())] {
                let steps = angle / ENCODER_STEP;
                assert!((steps - steps.round()).abs() < 1e-9, "{steps} steps");
                assert!((angle - truth).abs() <= 0.5 * ENCODER_STEP * (1.0 + 1e-9));
            }
            for (rate, truth) in [(m.theta_r_rate, 0.7), (m.theta_p_rate, -1.3)] {
                let steps = rate * 0.005 / ENCODER_STEP;
                assert!(
                    (steps - steps.round()).abs() < 1e-6,
                    "{steps} steps in 5 ms"
                );
                assert!((rate - truth).abs() <= ENCODER_STEP / 0.005);
            }
        }
    }

    #[test]
    fn ideal_encoders_are_exact() {
        for (m, state) in frames(0.0, 5, 100) {
            assert_eq!((m.theta_r, m.theta_p), (state.theta_r(), state.theta_p()));
            // Differences of angles below 1 over 5 ms.
            assert!((m.theta_r_rate - 0.7).abs() < 1e-12 && (m.theta_p_rate + 1.3).abs() < 1e-12);
            assert_eq!((m.gyro, m.accel), (REST.gyro, REST.specific_force));
        }
    }

    #[test]
    fn position_fix_arrives_late_and_says_when_it_was_true() {
        let mut source = PositionSource::new(0.02, ChaCha8Rng::seed_from_u64(1));
        let (mut state, mut errors) = (PlantState::default(), Vec::new());
        for i in 0..5000_i64 {
            state.robot.x = i as f64;
            let stamp = Instant::from_nanos(i * 100_000_000);
            source.sample(stamp, &state);
            let arrival = stamp + Span::from_millis(50);
            assert_eq!(source.next_arrival(), Some(arrival));
            assert_eq!(source.poll(arrival - Span::from_nanos(1)), None);
            let fix = source.poll(arrival).expect("it has arrived");
            assert_eq!((fix.stamp, fix.sigma), (stamp, 0.02));
            errors.extend([fix.x - state.robot.x, fix.y]);
            assert_eq!(source.poll(arrival), None);
        }
        // 10 000 draws: 0.7 % standard error.
        assert!((deviation(&errors) / 0.02 - 1.0).abs() < 0.03);
    }
}
