//! What of a sensor frame can be used: values that are numbers, inside the sensors' ranges, and not stuck.

use sphere_protocol::state::Measurement;

/// Whether each sensor is to be trusted, judged over the last tenth of a second.
///
/// A sensor is not if most of its values are missing, refused by the board, out of range, stuck, or contradicted by the others.
/// An encoder that died while the robot stood still looks like a robot standing still: only the board can tell.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SensorHealth {
    /// The gyro.
    pub gyro: bool,
    /// The accelerometer.
    pub accel: bool,
    /// The two joint encoders.
    pub encoders: bool,
}

/// The usable part of one frame.
#[derive(Clone, Copy, Debug)]
pub(super) struct Usable {
    pub(super) gyro: Option<[f64; 3]>,
    pub(super) accel: Option<[f64; 3]>,
    /// θ_r, θ_p [rad].
    pub(super) theta: Option<[f64; 2]>,
}

/// Checks the values of frame after frame.
#[derive(Clone, Debug)]
pub(super) struct Intake {
    gyro: Repeats,
    accel: Repeats,
    /// Joint angles [rad] and rates [rad/s] when the gyro's or the accelerometer's value began to repeat, and the time since [s].
    uniform: Option<([f64; 2], [f64; 2], f64)>,
    /// Low-passed share of bad frames: gyro, accelerometer, encoders.
    bad: [f64; 3],
}

/// How long a sensor has said exactly the same.
#[derive(Clone, Debug, Default)]
struct Repeats {
    value: [f64; 3],
    frames: u32,
    /// Of these, frames in which the other inertial sensor said something new.
    contradicted: u32,
}

impl Intake {
    pub(super) fn new() -> Self {
        Self {
            gyro: Repeats::default(),
            accel: Repeats::default(),
            uniform: None,
            bad: [0.0; 3],
        }
    }

    /// The usable part of `m`, `dt` [s] after the frame before.
    pub(super) fn check(&mut self, m: &Measurement, dt: f64) -> Usable {
        let imu = m.status.imu_ok;
        let mut gyro = (imu && inside(&m.gyro, GYRO_RANGE)).then_some(m.gyro);
        let mut accel = (imu && inside(&m.accel, ACCEL_RANGE)).then_some(m.accel);
        let rates = [m.theta_r_rate, m.theta_p_rate];
        let theta = [m.theta_r, m.theta_p];
        let theta_known =
            m.status.encoders_ok && inside(&theta, ANGLE_RANGE) && inside(&rates, RATE_RANGE);
        let theta = theta_known.then_some(theta);

        self.gyro.note(m.gyro);
        self.accel.note(m.accel);
        let (gyro_repeats, accel_repeats) = (self.gyro.frames > 0, self.accel.frames > 0);
        let both = self.gyro.is_long() && self.accel.is_long();
        let uneven = self.uneven_motion(theta, rates, dt, both);
        // Without noise a robot in steady motion repeats its values too: another sensor must show that something changes.
        if self.gyro.is_stuck(!accel_repeats) || uneven {
            gyro = None;
        }
        if self.accel.is_stuck(!gyro_repeats) || uneven {
            accel = None;
        }
        Usable { gyro, accel, theta }
    }

    /// Notes which sensors were unusable or contradicted in a frame.
    pub(super) fn note(&mut self, dt: f64, bad: [bool; 3]) {
        let keep = HEALTH_TIME / (HEALTH_TIME + dt);
        for (share, bad) in self.bad.iter_mut().zip(bad) {
            *share = *share * keep + if bad { 1.0 - keep } else { 0.0 };
        }
    }

    pub(super) fn health(&self) -> SensorHealth {
        let [gyro, accel, encoders] = self.bad.map(|share| share < 0.5);
        SensorHealth {
            gyro,
            accel,
            encoders,
        }
    }

    /// While both inertial sensors repeat themselves: have the joints left the uniform motion they had when that was first noticed?
    fn uneven_motion(
        &mut self,
        theta: Option<[f64; 2]>,
        rates: [f64; 2],
        dt: f64,
        repeating: bool,
    ) -> bool {
        let (true, Some(theta)) = (repeating, theta) else {
            if !repeating {
                self.uniform = None;
            }
            return false;
        };
        let (angles, rates, since) = self.uniform.get_or_insert((theta, rates, 0.0));
        let uneven = (0..2).any(|i| {
            let even = angles[i] + rates[i] * *since;
            (theta[i] - even).abs() > UNEVEN + COARSE_RATE * *since
        });
        *since += dt;
        uneven
    }
}

impl Repeats {
    fn note(&mut self, value: [f64; 3]) {
        if self.value == value {
            self.frames = self.frames.saturating_add(1);
        } else {
            *self = Self {
                value,
                ..Self::default()
            };
        }
    }

    fn is_long(&self) -> bool {
        self.frames >= STUCK_FRAMES
    }

    /// Repeats although the other sensor keeps changing.
    fn is_stuck(&mut self, other_changed: bool) -> bool {
        if self.frames > 0 && other_changed {
            self.contradicted = self.contradicted.saturating_add(1);
        }
        self.is_long() && self.contradicted >= STUCK_FRAMES / 2
    }
}

/// All finite and no larger than `range`.
fn inside<const N: usize>(values: &[f64; N], range: f64) -> bool {
    values.iter().all(|value| value.abs() <= range)
}

/// A gyro of 2000 °/s [rad/s].
const GYRO_RANGE: f64 = 35.0;
/// An accelerometer of 16 g [m/s²].
const ACCEL_RANGE: f64 = 160.0;
/// Joint angles beyond this are garbage: a sphere that rolled a thousand kilometres [rad].
const ANGLE_RANGE: f64 = 1e7;
/// Joint rates beyond this are garbage [rad/s].
const RATE_RANGE: f64 = 1e3;
/// Exact repeats that make a sensor stuck: noise of a few bits never repeats three axes for 0.25 s.
const STUCK_FRAMES: u32 = 50;
/// Departure from uniform motion that no steady motion shows [rad].
const UNEVEN: f64 = 0.03;
/// Quantisation of a difference quotient [rad/s].
const COARSE_RATE: f64 = 0.02;
/// Memory of the health flags [s].
const HEALTH_TIME: f64 = 0.1;
