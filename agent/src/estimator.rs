//! Where the robot is and how it moves, from raw sensor frames and late position fixes.
//!
//! An extended Kalman filter runs at the rate of the sensor frames (MODEL: rubber rolling, eq (1)); a position fix is fused at
//! the frame of its stamp, and the frames since then run again, so that its delay costs nothing but 1 µs a frame.
//!
//! Differs from a complementary attitude filter with differenced encoders:
//! - the specific force predicts v̇ and q̈_r exactly, with R q̇_r φ̇ and v φ̇ taken off: at 1 m/s and 10° they would pass for 2.9° of roll;
//! - rubber rolling, φ̇ = v tan q_r/R, ties heading, roll and the upward gyro bias together; a pivot is a state that is mostly zero;
//! - encoder *angles* are used, whose errors do not add up, not their rates.
//!
//! The state is that of the newest frame's stamp. Nothing is allocated after the first frame.

mod alignment;
mod config;
mod filter;
mod history;
mod intake;
mod rest;
mod tracker;

use nalgebra::{Matrix2, Vector2};
use sphere_protocol::robot::RobotParams;
use sphere_protocol::state::{Measurement, PositionFix, RobotState};
use sphere_protocol::time::{BoardClock, Instant};

use alignment::Alignment;
use filter::{
    ACCEL_BIAS, ALPHA, ALPHA_RATE, Body, Channel, Covariance, Filter, FixAt, GYRO_BIAS, HEADING,
    PIVOT, Q_R, Q_R_RATE, SHELL, State, Step, V, X, Y,
};
use history::{History, Slot};
use intake::{Intake, Usable};
use rest::RestDetector;
use tracker::JointTracker;

pub use config::{EstimatorConfig, StartPose};
pub use intake::SensorHealth;

/// The onboard estimator of one robot.
#[derive(Clone, Debug)]
pub struct Estimator {
    body: Body,
    config: EstimatorConfig,
    /// `None` until the first frame whose sensors all answer.
    running: Option<Running>,
    /// Frames in a row from another stretch of time, and the stamp of the newest.
    elsewhere: Option<(Instant<BoardClock>, u32)>,
    counters: EstimatorCounters,
}

/// Standard deviations of the estimate.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StateSigma {
    /// The larger axis of the position's ellipse [m].
    pub position: f64,
    /// Heading [rad].
    pub heading: f64,
    /// Forward speed [m/s].
    pub v: f64,
    /// Roll q_r [rad].
    pub q_r: f64,
    /// Its rate [rad/s].
    pub q_r_rate: f64,
    /// Swing α [rad].
    pub alpha: f64,
    /// Its rate [rad/s].
    pub alpha_rate: f64,
}

/// What became of a position fix.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FixOutcome {
    /// Fused at its stamp.
    Fused,
    /// Taken to find the heading, which is unknown.
    Aligning,
    /// Refused by the innovation gate.
    Rejected,
    /// Fused although the gate refused it: too many in a row had said so.
    Reopened,
    /// Older than the frames that are kept.
    Late,
    /// Newer than the newest frame by more than a frame may be.
    Future,
    /// Another fix was fused at that frame already.
    Duplicate,
    /// Not a number, no standard deviation, or no frame was seen yet.
    Invalid,
}

/// What the estimator refused or had to mend, counted since it was built.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub struct EstimatorCounters {
    /// Frames used.
    pub frames: u64,
    /// Frames dropped: their stamp repeats, goes back, or leaps.
    pub frames_out_of_time: u64,
    /// Frames used after a gap of more than 2.5 sample intervals.
    pub gaps: u64,
    /// Starts anew after an outage or a restart of the board's clock.
    pub restarts: u64,
    /// Frames whose gyro was unusable.
    pub gyro_unusable: u64,
    /// Frames whose accelerometer was unusable.
    pub accel_unusable: u64,
    /// Frames whose encoders were unusable.
    pub encoders_unusable: u64,
    /// Gyro axes refused by their innovation gate.
    pub gyro_rejected: u64,
    /// Pitch encoder readings refused by their innovation gate.
    pub encoder_rejected: u64,
    /// Frames that opened the pivot state: the shell turned about the vertical.
    pub pivots: u64,
    /// Fixes fused.
    pub fixes: u64,
    /// Fixes refused by the innovation gate.
    pub fixes_rejected: u64,
    /// Times that the gate gave way to fixes that kept disagreeing.
    pub fixes_reopened: u64,
    /// Fixes older than the frames that are kept.
    pub fixes_late: u64,
    /// Fixes from the future.
    pub fixes_future: u64,
    /// Fixes that repeat, or share their frame with another.
    pub fixes_duplicate: u64,
    /// Fixes that are not numbers, or came before the first frame.
    pub fixes_invalid: u64,
}

#[derive(Clone, Debug)]
struct Running {
    history: History,
    intake: Intake,
    rest: RestDetector,
    theta_r: JointTracker,
    /// Specific force of the frame before.
    accel: Option<[f64; 3]>,
    /// Running while the heading is unknown.
    alignment: Option<Alignment>,
    /// Fixes refused in a row.
    fix_streak: u32,
    /// Fixes fused since the gate last gave way.
    fixes_since_reopened: u32,
}

impl Estimator {
    /// An estimator for a robot with these parameters (radius and gravity are used) that starts as `config` says.
    pub fn new(params: &RobotParams, config: EstimatorConfig) -> Self {
        Self {
            body: Body {
                radius: params.r,
                gravity: params.g,
            },
            config,
            running: None,
            elsewhere: None,
            counters: EstimatorCounters::default(),
        }
    }

    /// Takes a sensor frame. Frames out of time and values that cannot be are dropped and counted.
    pub fn on_measurement(&mut self, m: &Measurement) {
        let Some(running) = &mut self.running else {
            self.start(m, None);
            return;
        };
        let stamp = running.history.newest().stamp;
        let dt = m.stamp.since(stamp).as_secs_f64();
        if !(dt > 0.0 && dt <= OUTAGE) {
            self.counters.frames_out_of_time += 1;
            self.on_frame_elsewhere(m, dt);
            return;
        }
        self.elsewhere = None;
        self.counters.frames += 1;
        if dt > 2.5 * self.config.sample_interval {
            self.counters.gaps += 1;
        }

        let usable = running.intake.check(m, dt);
        let filter = &running.history.newest().filter;
        let at_rest = match (usable.theta, usable.gyro) {
            (Some(theta), Some(gyro)) => {
                let bias = core::array::from_fn(|i| filter.x[GYRO_BIAS + i]);
                let bias_sigma = core::array::from_fn(|i| filter.sigma(GYRO_BIAS + i));
                let noise = self.config.gyro_noise;
                running.rest.step(dt, theta, gyro, noise, bias, bias_sigma)
            }
            _ => {
                running.rest.interrupt();
                false
            }
        };
        let step = Step {
            dt,
            accel: mean_force(running.accel, usable.accel),
            gyro: usable.gyro,
            theta_p: usable.theta.map(|[_, theta_p]| theta_p),
            at_rest,
        };
        running.accel = usable.accel;
        running
            .theta_r
            .step(dt, usable.theta.map(|[theta_r, _]| theta_r));
        let slot = running.history.push(m.stamp, step);
        let gates = slot.filter.step(&step, &self.body, &self.config);

        let rejected = |channel: Channel| gates.rejected[channel as usize];
        let reopened = |channel: Channel| gates.reopened[channel as usize];
        let contradicted = |channel| rejected(channel) || reopened(channel);
        let unusable = [
            usable.gyro.is_none(),
            usable.accel.is_none(),
            usable.theta.is_none(),
        ];
        let gyro_contradicted =
            contradicted(Channel::GyroForward) || contradicted(Channel::GyroLeft);
        let bad = [
            unusable[0] || gyro_contradicted,
            unusable[1],
            unusable[2] || contradicted(Channel::Encoder),
        ];
        running.intake.note(dt, bad);
        let counters = &mut self.counters;
        counters.gyro_unusable += u64::from(unusable[0]);
        counters.accel_unusable += u64::from(unusable[1]);
        counters.encoders_unusable += u64::from(unusable[2]);
        for channel in [Channel::GyroForward, Channel::GyroLeft, Channel::GyroUp] {
            counters.gyro_rejected += u64::from(rejected(channel));
        }
        counters.encoder_rejected += u64::from(rejected(Channel::Encoder));
        counters.pivots += u64::from(reopened(Channel::GyroUp));

        // Finite numbers in give finite numbers out unless the attitude ran through ±90°: then nothing is left to carry on from.
        if !running.history.newest().filter.is_sound() {
            self.running = None;
            self.counters.restarts += 1;
        }
    }

    /// Takes a position fix that was true at its stamp: 0.32 s ago at most, or up to 20 ms after the newest frame.
    pub fn on_fix(&mut self, fix: &PositionFix) -> FixOutcome {
        let outcome = self.judge_fix(fix);
        let counters = &mut self.counters;
        match outcome {
            FixOutcome::Fused | FixOutcome::Aligning => counters.fixes += 1,
            FixOutcome::Rejected => counters.fixes_rejected += 1,
            FixOutcome::Reopened => counters.fixes_reopened += 1,
            FixOutcome::Late => counters.fixes_late += 1,
            FixOutcome::Future => counters.fixes_future += 1,
            FixOutcome::Duplicate => counters.fixes_duplicate += 1,
            FixOutcome::Invalid => counters.fixes_invalid += 1,
        }
        outcome
    }

    /// The state at [`Estimator::stamp`]; the start pose at rest before the first frame.
    pub fn state(&self) -> RobotState {
        let Some(running) = &self.running else {
            let start = &self.config.start;
            return RobotState {
                x: start.x,
                y: start.y,
                heading: start.heading,
                ..RobotState::default()
            };
        };
        let x = &running.history.newest().filter.x;
        RobotState {
            x: x[X],
            y: x[Y],
            heading: x[HEADING],
            v: x[V],
            q_r: x[Q_R],
            q_r_rate: x[Q_R_RATE],
            beta: running.theta_r.angle() - x[Q_R],
            beta_rate: running.theta_r.rate() - x[Q_R_RATE],
            alpha: x[ALPHA],
            alpha_rate: x[ALPHA_RATE],
        }
    }

    /// Stamp of the newest frame used.
    pub fn stamp(&self) -> Option<Instant<BoardClock>> {
        self.running
            .as_ref()
            .map(|running| running.history.newest().stamp)
    }

    /// Standard deviations of [`Estimator::state`]; the start's before the first frame.
    pub fn sigma(&self) -> StateSigma {
        let Some(running) = &self.running else {
            return StateSigma {
                position: self.config.start.position_sigma,
                heading: self.config.start.heading_sigma,
                v: MOVING_SIGMA_V,
                q_r: MOVING_SIGMA,
                q_r_rate: MOVING_SIGMA,
                alpha: MOVING_SIGMA,
                alpha_rate: MOVING_SIGMA,
            };
        };
        let filter = &running.history.newest().filter;
        StateSigma {
            position: larger_axis(&self.position_covariance()),
            heading: filter.sigma(HEADING),
            v: filter.sigma(V),
            q_r: filter.sigma(Q_R),
            q_r_rate: filter.sigma(Q_R_RATE),
            alpha: filter.sigma(ALPHA),
            alpha_rate: filter.sigma(ALPHA_RATE),
        }
    }

    /// Standard deviation of the position, the larger axis [m]: what telemetry reports.
    pub fn position_sigma(&self) -> f64 {
        self.sigma().position
    }

    /// Covariance of the position, world X and Y [m²].
    pub fn position_covariance(&self) -> Matrix2<f64> {
        match &self.running {
            Some(running) => {
                let p = &running.history.newest().filter.p;
                Matrix2::new(p[(X, X)], p[(X, Y)], p[(Y, X)], p[(Y, Y)])
            }
            None => Matrix2::identity() * self.config.start.position_sigma.powi(2),
        }
    }

    /// Covariance of (q_r, α, φ, v, X, Y) [SI], 6 × 6.
    pub fn covariance(&self) -> nalgebra::Matrix6<f64> {
        let places = [Q_R, ALPHA, HEADING, V, X, Y];
        match &self.running {
            Some(running) => {
                let p = &running.history.newest().filter.p;
                nalgebra::Matrix6::from_fn(|i, j| p[(places[i], places[j])])
            }
            None => {
                let s = self.sigma();
                let sigma = [s.q_r, s.alpha, s.heading, s.v, s.position, s.position];
                nalgebra::Matrix6::from_fn(|i, j| if i == j { sigma[i] * sigma[i] } else { 0.0 })
            }
        }
    }

    /// Estimated gyro biases, forward, left, up, and the largest of their standard deviations [rad/s].
    pub fn gyro_bias(&self) -> ([f64; 3], f64) {
        match &self.running {
            Some(running) => {
                let filter = &running.history.newest().filter;
                let sigma = (0..3)
                    .map(|i| filter.sigma(GYRO_BIAS + i))
                    .fold(0.0, f64::max);
                (core::array::from_fn(|i| filter.x[GYRO_BIAS + i]), sigma)
            }
            None => ([0.0; 3], self.config.gyro_bias),
        }
    }

    /// Attitude and gyro biases are known well enough to drive: after about a second at rest.
    pub fn converged(&self) -> bool {
        let sigma = self.sigma();
        let (_, bias_sigma) = self.gyro_bias();
        self.running.is_some()
            && sigma.q_r <= CONVERGED_ANGLE
            && sigma.alpha <= CONVERGED_ANGLE
            && bias_sigma <= CONVERGED_BIAS
    }

    /// The heading is known well enough for position fixes to correct it; if not, the next half metre of driving will tell.
    pub fn heading_known(&self) -> bool {
        self.running
            .as_ref()
            .is_some_and(|running| running.alignment.is_none())
    }

    /// The robot stands still, by encoders and gyro.
    pub fn at_rest(&self) -> bool {
        self.running
            .as_ref()
            .is_some_and(|running| running.history.newest().step.at_rest)
    }

    /// Which sensors can be trusted; none before the first frame.
    pub fn sensor_health(&self) -> SensorHealth {
        self.running.as_ref().map_or(
            SensorHealth {
                gyro: false,
                accel: false,
                encoders: false,
            },
            |running| running.intake.health(),
        )
    }

    /// What was dropped or mended so far.
    pub fn counters(&self) -> &EstimatorCounters {
        &self.counters
    }

    /// A frame from before the newest one, or from long after it. Ten such in a row that follow each other are the board's new time.
    fn on_frame_elsewhere(&mut self, m: &Measurement, dt: f64) {
        let follows = self.elsewhere.is_some_and(|(stamp, _)| {
            let since = m.stamp.since(stamp).as_secs_f64();
            since > 0.0 && since <= OUTAGE
        });
        let count = if follows {
            self.elsewhere.map_or(1, |(_, n)| n + 1)
        } else {
            1
        };
        if count < ELSEWHERE_FRAMES {
            self.elsewhere = Some((m.stamp, count));
            return;
        }
        // Of a clock that went back nothing says how long it stood: a second.
        let away = if dt > 0.0 { dt } else { 1.0 };
        let last = self
            .running
            .take()
            .map(|running| running.history.newest().filter.clone());
        self.elsewhere = None;
        self.counters.restarts += 1;
        self.start(m, last.map(|filter| (filter, away)));
    }

    /// Starts from one frame: attitude from gravity, pose from the configuration or, after an outage of so many seconds, from
    /// the filter before it.
    fn start(&mut self, m: &Measurement, before: Option<(Filter, f64)>) {
        let mut intake = Intake::new();
        let Usable {
            gyro: Some(gyro),
            accel: Some(accel),
            theta: Some(theta),
        } = intake.check(m, 0.0)
        else {
            let usable = intake.check(m, 0.0);
            self.counters.gyro_unusable += u64::from(usable.gyro.is_none());
            self.counters.accel_unusable += u64::from(usable.accel.is_none());
            self.counters.encoders_unusable += u64::from(usable.theta.is_none());
            return;
        };
        self.counters.frames += 1;
        let config = &self.config;
        let start = &config.start;
        let mut x = State::zeros();
        let mut sigma = State::zeros();
        (x[X], x[Y], x[HEADING]) = (start.x, start.y, start.heading);
        sigma[X] = start.position_sigma;
        sigma[Y] = start.position_sigma;
        sigma[HEADING] = start.heading_sigma.min(core::f64::consts::PI);
        for i in 0..3 {
            sigma[GYRO_BIAS + i] = config.gyro_bias;
        }
        for i in 0..3 {
            sigma[ACCEL_BIAS + i] = config.accel_bias;
        }
        if let Some((filter, away)) = &before {
            for place in [X, Y, HEADING] {
                x[place] = filter.x[place];
            }
            let ran = (filter.x[V].abs() + 0.1) * away;
            let turned = 0.1 + 0.3 * away;
            sigma[X] = filter.sigma(X).hypot(ran);
            sigma[Y] = filter.sigma(Y).hypot(ran);
            sigma[HEADING] = filter
                .sigma(HEADING)
                .hypot(turned)
                .min(core::f64::consts::PI);
            for place in GYRO_BIAS..ACCEL_BIAS + 3 {
                x[place] = filter.x[place];
                sigma[place] = filter.sigma(place);
            }
        }

        let rates: [f64; 3] = core::array::from_fn(|i| gyro[i] - x[GYRO_BIAS + i]);
        x[Q_R_RATE] = -rates[0];
        x[ALPHA_RATE] = -rates[1];
        // v = R cos q_r (θ̇_p − α̇) and φ̇ from the gyro; accelerations unknown.
        x[V] = self.body.radius * (m.theta_p_rate - x[ALPHA_RATE]);
        let left = x[V] * rates[2] - (accel[1] - x[ACCEL_BIAS + 1]);
        x[Q_R] = (left / self.body.gravity).clamp(-1.0, 1.0).asin();
        x[ALPHA] = ((accel[0] - x[ACCEL_BIAS]) / self.body.gravity)
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
            MOVING_SIGMA * self.body.gravity
        };
        sigma[Q_R] = unknown.hypot(sigma[ACCEL_BIAS + 1]) / self.body.gravity;
        sigma[ALPHA] = unknown.hypot(sigma[ACCEL_BIAS]) / self.body.gravity;
        let mut p = Covariance::from_diagonal(&sigma.component_mul(&sigma));
        // Gravity tells lean and bias together: q_r is wrong by +b/g, α by −b/g.
        for (angle, bias, sign) in [(Q_R, ACCEL_BIAS + 1, 1.0), (ALPHA, ACCEL_BIAS, -1.0)] {
            let shared = sign * sigma[bias] * sigma[bias] / self.body.gravity;
            p[(angle, bias)] = shared;
            p[(bias, angle)] = shared;
        }

        let step = Step {
            dt: 0.0,
            accel: None,
            gyro: None,
            theta_p: None,
            at_rest: false,
        };
        self.running = Some(Running {
            history: History::new(Slot {
                stamp: m.stamp,
                step,
                filter: Filter::new(x, p),
                fix: None,
            }),
            intake,
            rest: RestDetector::new(theta, gyro),
            theta_r: JointTracker::new(
                theta[0],
                m.theta_r_rate,
                config.theta_r_jerk,
                config.encoder_noise,
            ),
            accel: Some(accel),
            alignment: (sigma[HEADING] > config.heading_known).then(Alignment::default),
            fix_streak: 0,
            fixes_since_reopened: FIXES_SETTLED,
        });
    }

    fn judge_fix(&mut self, fix: &PositionFix) -> FixOutcome {
        let Some(running) = &mut self.running else {
            return FixOutcome::Invalid;
        };
        let sound = fix.x.abs() <= POSITION_RANGE
            && fix.y.abs() <= POSITION_RANGE
            && fix.sigma > 0.0
            && fix.sigma <= POSITION_RANGE;
        if !sound {
            return FixOutcome::Invalid;
        }
        let Some(age) = running.history.nearest(fix.stamp) else {
            return FixOutcome::Late;
        };
        let slot = running.history.slot(age);
        let ahead = fix.stamp.since(slot.stamp).as_secs_f64();
        if age == 0 && ahead > FUTURE_MAX {
            return FixOutcome::Future;
        }
        if slot.fix.is_some() {
            return FixOutcome::Duplicate;
        }
        // Between frame and fix the speed is held: half an acceleration of 1 m/s² is left out.
        let held = 0.5 * ahead * ahead;
        let at = FixAt {
            position: [fix.x, fix.y],
            sigma: fix.sigma.max(FIX_SIGMA_MIN).hypot(held),
            ahead,
        };
        let radius = self.body.radius;

        if let Some(alignment) = &mut running.alignment {
            let found = alignment.on_fix(&mut running.history, age, &at, radius);
            if found {
                running.alignment = None;
            }
            return FixOutcome::Aligning;
        }

        let mut outcome = FixOutcome::Fused;
        if slot.filter.fix_distance(&at, radius) > FIX_GATE {
            running.fix_streak += 1;
            if running.fix_streak <= FIXES_REFUSED_MAX {
                return FixOutcome::Rejected;
            }
            outcome = FixOutcome::Reopened;
            running.fix_streak = 0;
            if running.fixes_since_reopened < FIXES_SETTLED {
                // A new position did not help: the heading is wrong as well.
                running.alignment = Some(Alignment::default());
                return outcome;
            }
            running.fixes_since_reopened = 0;
            let filter = &mut running.history.slot_mut(age).filter;
            filter.reopen_position(&at, radius, REOPENED_HEADING);
        } else {
            running.fix_streak = 0;
            running.fixes_since_reopened = running.fixes_since_reopened.saturating_add(1);
        }
        let slot = running.history.slot_mut(age);
        slot.filter.fuse_fix(&at, radius);
        slot.fix = Some(at);
        running.history.replay_after(age, &self.body, &self.config);
        outcome
    }
}

/// Trapezoid rule for the specific force over one interval; one end alone where the other is missing.
fn mean_force(before: Option<[f64; 3]>, now: Option<[f64; 3]>) -> Option<[f64; 3]> {
    match (before, now) {
        (Some(a), Some(b)) => Some(core::array::from_fn(|i| 0.5 * (a[i] + b[i]))),
        (one, other) => one.or(other),
    }
}

/// Standard deviation along the larger axis of an ellipse.
fn larger_axis(p: &Matrix2<f64>) -> f64 {
    let mean = 0.5 * (p[(0, 0)] + p[(1, 1)]);
    let spread = Vector2::new(0.5 * (p[(0, 0)] - p[(1, 1)]), p[(0, 1)]).norm();
    (mean + spread).max(0.0).sqrt()
}

/// Longest gap between frames that the prediction crosses [s].
const OUTAGE: f64 = 0.5;
/// Frames in a row after which another stretch of time is believed.
const ELSEWHERE_FRAMES: u32 = 10;
/// Roll and pitch standard deviation of a converged estimate [rad]: 0.5°.
const CONVERGED_ANGLE: f64 = 8.7e-3;
/// Gyro bias standard deviation of a converged estimate [rad/s]: 0.03 °/s, the mean of half a second.
const CONVERGED_BIAS: f64 = 5.5e-4;
/// Standard deviation of angles and rates when the estimator starts in motion [rad, rad/s].
const MOVING_SIGMA: f64 = 0.1;
/// Standard deviation of the speed at the start [m/s].
const MOVING_SIGMA_V: f64 = 0.03;
/// Speed below which the estimator starts as if at rest [m/s].
const STILL_V: f64 = 0.03;
/// Largest coordinate of a fix [m].
const POSITION_RANGE: f64 = 1e6;
/// No fix is better than this [m].
const FIX_SIGMA_MIN: f64 = 1e-3;
/// A fix may be newer than the newest frame by so much [s]: frames get lost.
const FUTURE_MAX: f64 = 0.02;
/// Gate on [`Filter::fix_distance`]: one good fix in 3000 is beyond.
const FIX_GATE: f64 = 16.0;
/// Fixes refused in a row: one second at 10 Hz.
const FIXES_REFUSED_MAX: u32 = 10;
/// Fixes after which a reopened position counts as settled.
const FIXES_SETTLED: u32 = 30;
/// Doubt about the heading when the position was wrong [rad].
const REOPENED_HEADING: f64 = 0.2;
