//! Made-up motions with exact sensors: pose by eq (1), gyro, specific force and encoders from the geometry alone.
//!
//! No dynamics: q_r, α, v and β are chosen functions of time. The geometry is written with vectors in the yaw frame, not with
//! the estimator's component formulas.

#![allow(dead_code, reason = "each test binary uses its own part")]

use std::f64::consts::{PI, TAU};

use nalgebra::Vector3;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use sphere_protocol::state::{BoardStatus, Measurement, PositionFix, RobotState};
use sphere_protocol::time::{Instant, Span};

pub(crate) const RADIUS: f64 = 0.35;
pub(crate) const GRAVITY: f64 = 9.81;
pub(crate) const DEGREE: f64 = PI / 180.0;
pub(crate) const FRAME: f64 = 0.005;

/// A function of time with two derivatives.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Jet {
    pub(crate) f: f64,
    pub(crate) d: f64,
    pub(crate) dd: f64,
}

/// q_r, α, v, β at an instant, and pivoting of the shell about the vertical.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Angles {
    pub(crate) q_r: Jet,
    pub(crate) alpha: Jet,
    pub(crate) v: Jet,
    pub(crate) beta: Jet,
    pub(crate) pivot: Jet,
}

pub(crate) type Motion = fn(f64) -> Angles;

/// Sensor errors, as DESIGN's sensor defaults times `noise`, and how the fixes come.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Sensing {
    pub(crate) noise: f64,
    pub(crate) fixes: bool,
    pub(crate) fix_delay: f64,
    pub(crate) seed: u64,
}

/// What arrives at the estimator, in order of arrival.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Event {
    Frame(Measurement, Truth),
    Fix(PositionFix),
}

/// The truth at a frame.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Truth {
    pub(crate) t: f64,
    pub(crate) state: RobotState,
    /// Length of the path so far [m].
    pub(crate) path: f64,
    pub(crate) gyro_bias: [f64; 3],
}

impl Sensing {
    /// The default errors, with fixes 50 ms late.
    pub(crate) fn usual(seed: u64) -> Self {
        Self {
            noise: 1.0,
            fixes: true,
            fix_delay: 0.05,
            seed,
        }
    }

    /// No errors, no fixes.
    pub(crate) fn ideal() -> Self {
        Self {
            noise: 0.0,
            fixes: false,
            fix_delay: 0.0,
            seed: 0,
        }
    }
}

impl Jet {
    pub(crate) fn constant(f: f64) -> Self {
        Self { f, d: 0.0, dd: 0.0 }
    }

    /// amplitude · sin(ω t + phase).
    pub(crate) fn sine(t: f64, amplitude: f64, hertz: f64, phase: f64) -> Self {
        let w = TAU * hertz;
        let (s, c) = (w * t + phase).sin_cos();
        Self {
            f: amplitude * s,
            d: amplitude * w * c,
            dd: -amplitude * w * w * s,
        }
    }

    /// From 0 at `from` to 1 at `from + time`, twice differentiable.
    pub(crate) fn rise(t: f64, from: f64, time: f64) -> Self {
        let u = ((t - from) / time).clamp(0.0, 1.0);
        Self {
            f: u * u * u * (10.0 - 15.0 * u + 6.0 * u * u),
            d: 30.0 * u * u * (1.0 - u) * (1.0 - u) / time,
            dd: 60.0 * u * (1.0 - u) * (1.0 - 2.0 * u) / (time * time),
        }
    }

    pub(crate) fn plus(self, b: Self) -> Self {
        Self {
            f: self.f + b.f,
            d: self.d + b.d,
            dd: self.dd + b.dd,
        }
    }

    pub(crate) fn times(self, b: Self) -> Self {
        Self {
            f: self.f * b.f,
            d: self.d * b.f + self.f * b.d,
            dd: self.dd * b.f + 2.0 * self.d * b.d + self.f * b.dd,
        }
    }

    pub(crate) fn scaled(self, k: f64) -> Self {
        self.times(Self::constant(k))
    }
}

/// Small motion of pendulum and frame that a controller always leaves: 0.1° to 1° at 0.7 to 6 Hz.
fn unrest(t: f64) -> Angles {
    let sines = |parts: &[(f64, f64, f64)]| {
        parts
            .iter()
            .fold(Jet::default(), |sum, &(deg, hertz, phase)| {
                sum.plus(Jet::sine(t, deg * DEGREE, hertz, phase))
            })
    };
    Angles {
        q_r: sines(&[(0.3, 0.7, 0.3), (0.1, 2.3, 1.0), (0.03, 6.0, 2.0)]),
        alpha: sines(&[(1.0, 0.5, 0.0), (0.5, 1.7, 1.0), (0.1, 6.0, 0.4)]),
        v: Jet::sine(t, 0.01, 0.5, 0.7),
        beta: sines(&[(2.0, 0.6, 0.9), (0.5, 2.3, 0.2)]),
        pivot: Jet::default(),
    }
}

/// At rest for 1.5 s, then figures of eight at 0.3 to 0.7 m/s with roll within ±12°.
pub(crate) fn lemniscate(t: f64) -> Angles {
    let gate = Jet::rise(t, 1.5, 3.0);
    let u = unrest(t);
    let q_r = Jet::sine(t, 12.0 * DEGREE, 1.0 / 37.0, 0.4).plus(u.q_r);
    let v = Jet::constant(0.5)
        .plus(Jet::sine(t, 0.19, 1.0 / 18.5, 1.0))
        .plus(u.v);
    Angles {
        q_r: gate.times(q_r),
        alpha: gate.times(u.alpha.plus(Jet::constant(1.0 * DEGREE))),
        v: gate.times(v),
        beta: gate.times(u.beta.plus(q_r.scaled(-0.2))),
        pivot: Jet::default(),
    }
}

/// At rest for 1.5 s, then straight on with steps of the speed between 0.1 and 0.8 m/s.
pub(crate) fn speed_steps(t: f64) -> Angles {
    let gate = Jet::rise(t, 1.5, 1.0);
    let u = unrest(t);
    let mut v = Jet::rise(t, 1.5, 1.2).scaled(0.5);
    for (k, size) in [
        (1, 0.3),
        (2, -0.7),
        (3, 0.4),
        (4, 0.2),
        (5, -0.5),
        (6, 0.3),
        (7, 0.3),
        (8, -0.7),
    ] {
        v = v.plus(Jet::rise(t, 10.0 * f64::from(k), 1.2).scaled(size));
    }
    // The bob leads the acceleration; no sensor feels α̈.
    let lead = Jet {
        f: v.d,
        d: v.dd,
        dd: 0.0,
    };
    Angles {
        q_r: gate.times(u.q_r),
        alpha: gate.times(u.alpha.plus(lead.scaled(0.385))),
        v,
        beta: gate.times(u.beta),
        pivot: Jet::default(),
    }
}

/// The figures of eight, but from 20 s to 24 s somebody turns the shell on the spot by 60°.
pub(crate) fn pivoting(t: f64) -> Angles {
    let on = Jet::rise(t, 20.0, 0.5).plus(Jet::rise(t, 23.5, 0.5).scaled(-1.0));
    Angles {
        pivot: on.scaled(60.0 * DEGREE / 3.5),
        ..lemniscate(t)
    }
}

/// Straight on at 0.5 m/s for ever, with no unrest at all.
pub(crate) fn steady(_: f64) -> Angles {
    Angles {
        v: Jet::constant(0.5),
        ..Angles::default()
    }
}

/// The events of `duration` seconds of a motion.
pub(crate) fn events(motion: Motion, sensing: &Sensing, duration: f64) -> Vec<Event> {
    let mut noise = Noise::new(sensing);
    let frames = (duration / FRAME).round() as usize;
    let mut events = Vec::with_capacity(frames * 21 / 20);
    let mut waiting: Vec<(f64, PositionFix)> = Vec::new();
    let mut pose = Pose::default();
    for k in 0..=frames {
        let t = k as f64 * FRAME;
        let a = motion(t);
        let state = RobotState {
            x: pose.x,
            y: pose.y,
            heading: pose.heading,
            v: a.v.f,
            q_r: a.q_r.f,
            q_r_rate: a.q_r.d,
            beta: a.beta.f,
            beta_rate: a.beta.d,
            alpha: a.alpha.f,
            alpha_rate: a.alpha.d,
        };
        let measurement = noise.measure(t, &a, pose.shell);
        let truth = Truth {
            t,
            state,
            path: pose.path,
            gyro_bias: noise.gyro_bias.into(),
        };
        if sensing.fixes && k % 20 == 7 {
            waiting.push((t + sensing.fix_delay, noise.fix(t, &state)));
        }
        events.push(Event::Frame(measurement, truth));
        waiting.retain(|&(due, fix)| {
            let arrived = due <= t + 1e-9;
            if arrived {
                events.push(Event::Fix(fix));
            }
            !arrived
        });
        pose.advance(motion, t);
    }
    events
}

/// The events of the figures of eight with the usual noise and fixes.
pub(crate) fn usual(seed: u64, duration: f64) -> Vec<Event> {
    events(lemniscate, &Sensing::usual(seed), duration)
}

/// The same events with every frame changed by `change`, which may drop it.
pub(crate) fn changed(
    events: Vec<Event>,
    mut change: impl FnMut(f64, Measurement) -> Option<Measurement>,
) -> Vec<Event> {
    let frame = |event| match event {
        Event::Frame(m, truth) => change(truth.t, m).map(|m| Event::Frame(m, truth)),
        fix => Some(fix),
    };
    events.into_iter().filter_map(frame).collect()
}

/// Stamp of time `t` [s] in the board's clock, whose origin is its own.
pub(crate) fn stamp(t: f64) -> Instant<sphere_protocol::time::BoardClock> {
    Instant::from_nanos(3_000_000_000) + Span::from_secs_f64(t)
}

/// φ̇ [rad/s].
fn yaw_rate(a: &Angles) -> f64 {
    a.v.f * a.q_r.f.tan() / RADIUS + a.pivot.f
}

/// Gyro and specific force of the frame, FLU, without error.
pub(crate) fn inertial(a: &Angles) -> (Vector3<f64>, Vector3<f64>) {
    let (forward, left, up) = (Vector3::x(), Vector3::y(), Vector3::z());
    let (sin_r, cos_r) = a.q_r.f.sin_cos();
    let long_axis = cos_r * left - sin_r * up;
    let above = cos_r * up + sin_r * left;
    let (sin_a, cos_a) = a.alpha.f.sin_cos();
    let axes = [
        cos_a * forward + sin_a * above,
        long_axis,
        cos_a * above - sin_a * forward,
    ];
    let yaw_rate = yaw_rate(a);
    let turn = -a.alpha.d * long_axis - a.q_r.d * forward + yaw_rate * up;
    // d/dt of v e_f + R q̇_r e_l, the yaw frame turning with φ̇.
    let velocity = a.v.f * forward + RADIUS * a.q_r.d * left;
    let accel = a.v.d * forward
        + RADIUS * a.q_r.dd * left
        + (yaw_rate * up).cross(&velocity)
        + GRAVITY * up;
    let seen = |v: &Vector3<f64>| Vector3::from_iterator(axes.iter().map(|axis| axis.dot(v)));
    (seen(&turn), seen(&accel))
}

#[derive(Clone, Copy, Debug, Default)]
struct Pose {
    x: f64,
    y: f64,
    heading: f64,
    shell: f64,
    path: f64,
}

impl Pose {
    /// Eq (1) over one frame: every rate is a function of time, so Simpson's rule over 1 ms is exact to 1e-13.
    fn advance(&mut self, motion: Motion, t: f64) {
        const PARTS: usize = 5;
        let h = FRAME / PARTS as f64;
        let shell_rate = |a: &Angles| a.v.f / (RADIUS * a.q_r.f.cos());
        let simpson = |h: f64, a: f64, b: f64, c: f64| h / 6.0 * (a + 4.0 * b + c);
        for part in 0..PARTS {
            let t = t + part as f64 * h;
            let a: [Angles; 5] = std::array::from_fn(|i| motion(t + i as f64 * h / 4.0));
            let heading = [
                self.heading,
                self.heading + simpson(h / 2.0, yaw_rate(&a[0]), yaw_rate(&a[1]), yaw_rate(&a[2])),
                self.heading + simpson(h, yaw_rate(&a[0]), yaw_rate(&a[2]), yaw_rate(&a[4])),
            ];
            let velocity: [(f64, f64); 3] = std::array::from_fn(|i| {
                let (a, (sin, cos)) = (&a[2 * i], heading[i].sin_cos());
                let side = RADIUS * a.q_r.d;
                (a.v.f * cos - side * sin, a.v.f * sin + side * cos)
            });
            self.x += simpson(h, velocity[0].0, velocity[1].0, velocity[2].0);
            self.y += simpson(h, velocity[0].1, velocity[1].1, velocity[2].1);
            self.shell += simpson(h, shell_rate(&a[0]), shell_rate(&a[2]), shell_rate(&a[4]));
            self.path += h * velocity[1].0.hypot(velocity[1].1);
            self.heading = heading[2];
        }
    }
}

struct Noise {
    rng: ChaCha8Rng,
    scale: f64,
    gyro_bias: Vector3<f64>,
    accel_bias: Vector3<f64>,
    /// θ_r, θ_p of the frame before.
    theta: Option<[f64; 2]>,
}

impl Noise {
    fn new(sensing: &Sensing) -> Self {
        let mut noise = Self {
            rng: ChaCha8Rng::seed_from_u64(sensing.seed),
            scale: sensing.noise,
            gyro_bias: Vector3::zeros(),
            accel_bias: Vector3::zeros(),
            theta: None,
        };
        noise.gyro_bias = noise.vector(0.2 * DEGREE);
        noise.accel_bias = noise.vector(0.03);
        noise
    }

    fn normal(&mut self, sigma: f64) -> f64 {
        let z: f64 = StandardNormal.sample(&mut self.rng);
        z * sigma * self.scale
    }

    fn vector(&mut self, sigma: f64) -> Vector3<f64> {
        Vector3::from_fn(|_, _| self.normal(sigma))
    }

    fn measure(&mut self, t: f64, a: &Angles, shell: f64) -> Measurement {
        let (gyro, accel) = inertial(a);
        let walk = self.vector(0.003 * DEGREE * FRAME.sqrt());
        self.gyro_bias += walk;
        let gyro = gyro + self.gyro_bias + self.vector(0.3 * DEGREE);
        let accel = accel + self.accel_bias + self.vector(0.05);
        let lsb = TAU / 65536.0;
        // Without noise the encoders have no steps either.
        let read = |angle: f64| {
            if self.scale > 0.0 {
                (angle / lsb).floor() * lsb
            } else {
                angle
            }
        };
        let theta = [read(a.beta.f + a.q_r.f), read(shell + a.alpha.f)];
        // The first frame reports the rates that an earlier one would have given.
        let rates = [
            a.beta.d + a.q_r.d,
            a.alpha.d + a.v.f / (RADIUS * a.q_r.f.cos()),
        ];
        let earlier = [theta[0] - FRAME * rates[0], theta[1] - FRAME * rates[1]];
        let before = self.theta.replace(theta).unwrap_or(earlier);
        Measurement {
            stamp: stamp(t),
            gyro: gyro.into(),
            accel: accel.into(),
            theta_r: theta[0],
            theta_r_rate: (theta[0] - before[0]) / FRAME,
            theta_p: theta[1],
            theta_p_rate: (theta[1] - before[1]) / FRAME,
            status: BoardStatus {
                torque_on: true,
                command_valid: true,
                imu_ok: true,
                encoders_ok: true,
            },
        }
    }

    fn fix(&mut self, t: f64, state: &RobotState) -> PositionFix {
        PositionFix {
            stamp: stamp(t),
            x: state.x + self.normal(0.02),
            y: state.y + self.normal(0.02),
            sigma: 0.02,
        }
    }
}
