//! Where the robot is and how it moves, from raw sensor frames and late position fixes.
//!
//! An extended Kalman filter runs at the rate of the sensor frames (rubber rolling, eq (1)); a position fix is fused at
//! the frame of its stamp, and the frames since then run again, so that its delay costs 1 µs a frame and no accuracy.
//!
//! Differs from a complementary attitude filter with differenced encoders:
//! - the specific force predicts v̇ and q̈_r exactly, with R q̇_r φ̇ and v φ̇ taken off: at 1 m/s and 10° they would pass for 2.9° of roll;
//! - rubber rolling, φ̇ = v tan q_r/R, ties heading, roll and the upward gyro bias together; a pivot is a state that is mostly zero;
//! - encoder *angles* are used, whose errors do not add up, not their rates.
//!
//! The state is that of the newest frame's stamp. Nothing is allocated after the frame that starts it.

mod alignment;
mod config;
mod filter;
mod history;
mod intake;
mod report;
mod rest;
mod start;
mod tracker;

use nalgebra::{Matrix2, Matrix6, Vector2};
use sphere_protocol::robot::RobotParams;
use sphere_protocol::state::{Measurement, PositionFix, RobotState};
use sphere_protocol::time::{BoardClock, Instant};

use crate::model::NominalModel;
use alignment::Alignment;
use filter::{
    ALPHA, ALPHA_RATE, Body, Channel, Filter, FixAt, GYRO_BIAS, HEADING, Q_R, Q_R_RATE, Step, V, X,
    Y,
};
use history::{History, Slot};
use intake::{Intake, Usable};
use rest::RestDetector;
use start::{FirstFrame, MOVING_SIGMA, MOVING_SIGMA_V, first_filter};
use tracker::JointTracker;

pub use config::{EstimatorConfig, StartPose};
pub use intake::SensorHealth;
pub use report::{EstimatorCounters, FixOutcome, StateSigma};

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
    /// An estimator for a robot with these parameters (radius, gravity and how fast its frame can swing are used) that starts as `config` says.
    pub fn new(params: &RobotParams, config: EstimatorConfig) -> Self {
        Self {
            body: Body {
                radius: params.r,
                gravity: params.g,
                swing_accel_max: SWING_ACCEL_MARGIN * NominalModel::new(params).pitch_accel_max(),
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
        let sound = running.history.newest().filter.is_sound();
        self.count_unusable(&usable);
        let counters = &mut self.counters;
        for channel in [Channel::GyroForward, Channel::GyroLeft, Channel::GyroUp] {
            counters.gyro_rejected += u64::from(rejected(channel));
        }
        counters.encoder_rejected += u64::from(rejected(Channel::Encoder));
        counters.pivots += u64::from(reopened(Channel::GyroUp));

        // Finite numbers in give finite numbers out, unless the attitude ran through ±90°: then only the pose is worth keeping.
        if !sound {
            self.restart_from_frame_before(m);
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
    pub fn covariance(&self) -> Matrix6<f64> {
        let places = [Q_R, ALPHA, HEADING, V, X, Y];
        match &self.running {
            Some(running) => {
                let p = &running.history.newest().filter.p;
                Matrix6::from_fn(|i, j| p[(places[i], places[j])])
            }
            None => {
                let s = self.sigma();
                let sigma = [s.q_r, s.alpha, s.heading, s.v, s.position, s.position];
                Matrix6::from_fn(|i, j| if i == j { sigma[i] * sigma[i] } else { 0.0 })
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

    fn count_unusable(&mut self, usable: &Usable) {
        self.counters.gyro_unusable += u64::from(usable.gyro.is_none());
        self.counters.accel_unusable += u64::from(usable.accel.is_none());
        self.counters.encoders_unusable += u64::from(usable.theta.is_none());
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
            .as_ref()
            .map(|running| running.history.newest().filter);
        let started = self.start(m, last.map(|filter| (filter, away)));
        if started {
            self.counters.restarts += 1;
            self.elsewhere = None;
        } else {
            self.elsewhere = Some((m.stamp, count));
        }
    }

    /// Gives up the newest frame's attitude.
    fn restart_from_frame_before(&mut self, m: &Measurement) {
        let Some(running) = &self.running else { return };
        let last = running.history.slot(1).filter;
        self.counters.restarts += 1;
        if !self.start(m, Some((last, 1.0)))
            && let Some(running) = &mut self.running
        {
            running.history.slot_mut(0).filter = last;
        }
    }

    /// Starts from one frame, if all its sensors answer: attitude from gravity, pose from the configuration or, after an outage of
    /// so many seconds, from the filter before it.
    fn start(&mut self, m: &Measurement, before: Option<(Filter, f64)>) -> bool {
        let mut intake = Intake::new();
        let usable = intake.check(m, 0.0);
        let (Some(gyro), Some(accel), Some(theta)) = (usable.gyro, usable.accel, usable.theta)
        else {
            self.count_unusable(&usable);
            return false;
        };
        self.counters.frames += 1;
        let config = &self.config;
        let first = FirstFrame {
            gyro,
            accel,
            theta,
            theta_p_rate: m.theta_p_rate,
        };
        let filter = first_filter(&first, before.as_ref(), &self.body, config);
        let heading_unknown = filter.sigma(HEADING) > config.heading_known;
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
                filter,
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
            alignment: heading_unknown.then(Alignment::default),
            fix_streak: 0,
            fixes_since_reopened: FIXES_SETTLED,
        });
        true
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

/// Of the largest acceleration of the swing, for what the robot's parameters are off and both motors do together [1].
const SWING_ACCEL_MARGIN: f64 = 1.5;
/// Longest gap between frames that the prediction crosses [s].
const OUTAGE: f64 = 0.5;
/// Frames in a row after which another stretch of time is believed.
const ELSEWHERE_FRAMES: u32 = 10;
/// Roll and pitch standard deviation of a converged estimate [rad]: 0.5°.
const CONVERGED_ANGLE: f64 = 8.7e-3;
/// Gyro bias standard deviation of a converged estimate [rad/s]: 0.03 °/s, the mean of half a second.
const CONVERGED_BIAS: f64 = 5.5e-4;
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
