//! A typed roll step on the whole plant, as the paper's Table II has it: motors, disturbance, and noise on the fused state.
//!
//! The robot rolls straight at speed for 5 s, then 10° are typed. Plant and motors run at 1 ms, control at 50 Hz, the speed held by the
//! velocity controller. The state that controllers see has the errors of an attitude filter: white and slow noise on the two
//! attitudes, white noise on the rates, which through the encoders reaches β, β̇ and v with the opposite sign. Figures are of the *true* roll:
//! - t_r: from the step until the new value is first reached;
//! - t_s: from the step until it stays within ±1° for good;
//! - e_rmse: root mean square error from 5 s after the step to the end, 20 s after it;
//! - Δh: half of the distance between the largest and the smallest error of that window;
//! - torque: total variation of the commanded τ_r in that window per second [N·m/s].

#![allow(dead_code, reason = "each test binary uses its own part")]

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal, StandardUniform};
use sphere_agent::control::DirectionController;
use sphere_agent::control::hsmc::{Hsmc, SpeedShape};
use sphere_agent::control::reference_filter::RollReference;
use sphere_protocol::robot::{Robot, RobotParams};
use sphere_protocol::state::{RobotState, Setpoint, Torque};
use sphere_protocol::time::Span;
use sphere_sim::actuator::Actuator;
use sphere_sim::disturbance::Disturbance;
use sphere_sim::plant::{Plant, PlantState};

pub const DEG: f64 = core::f64::consts::PI / 180.0;
/// One control period [s].
pub const PERIOD: f64 = 0.02;

/// How hard the world is.
#[derive(Clone, Copy, Debug)]
pub struct World {
    /// Shell imbalance [N·m].
    pub imbalance: f64,
    /// Coulomb friction of the joints [N·m].
    pub coulomb: f64,
    /// Factor on all noise [1].
    pub noise: f64,
}

/// Noise, the motors of the robot file, a little imbalance.
pub const REAL: World = World {
    imbalance: 0.2,
    coulomb: 0.2,
    noise: 1.0,
};

/// As hard as it takes for the paper's plain law to show the paper's steady-state errors.
pub const CALIBRATED: World = World {
    imbalance: 2.3,
    coulomb: 0.5,
    noise: 1.0,
};

/// Figures of one step, of the true roll.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Figures {
    /// t_r [s]; infinite if the new value is never reached.
    pub rise: f64,
    /// t_s [s]; infinite if the error leaves ±1° in the last second.
    pub settle: f64,
    /// e_rmse [°].
    pub rmse: f64,
    /// Δh [°].
    pub band: f64,
    /// Largest lean to the wrong side [°].
    pub wrong_way: f64,
    /// Largest lean beyond the new value, within 3 s [°].
    pub overshoot: f64,
    /// Total variation of τ_r [N·m/s].
    pub torque: f64,
    /// Whether it fell over: lean or swing beyond 1 rad.
    pub fell: bool,
}

/// A step of `to` [°] at `v` [m/s] in `world`. `reference` makes the reference of what is typed: one call a period.
pub fn roll_step(
    robot: &Robot,
    controller: &mut dyn DirectionController,
    velocity: &mut Hsmc,
    reference: &mut dyn FnMut(f64) -> RollReference,
    world: World,
    v: f64,
    to: f64,
    seed: u64,
) -> Figures {
    let params = RobotParams {
        coulomb: world.coulomb,
        ..robot.params
    };
    let plant = Plant::new(params);
    let step = Span::from_millis(1);
    let mut motors = Actuator::new(&params, step);
    let disturbance = Disturbance {
        imbalance: world.imbalance,
        ..Disturbance::default()
    };
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let turned: f64 = StandardUniform.sample(&mut random);
    let mut state = PlantState {
        robot: RobotState {
            v,
            ..RobotState::default()
        },
        phi_s: turned * core::f64::consts::TAU,
    };
    let mut sensing = Sensing::new(world.noise, random);
    let mut errors = Vec::new();
    let (mut torque, mut variation) = (Torque::default(), 0.0);
    for i in 0..STEPS {
        let command = if i >= TYPED { to * DEG } else { 0.0 };
        let r = reference(command);
        let setpoint = Setpoint {
            v,
            v_rate: 0.0,
            q_r: r.q_r,
            q_r_rate: r.q_r_rate,
            q_r_accel: r.q_r_accel,
        };
        let seen = sensing.see(&state, params.r);
        let next = Torque {
            pitch: velocity.step(&seen, &setpoint, SpeedShape::default(), PERIOD),
            roll: controller.step(&seen, &setpoint, PERIOD),
        };
        if i >= STEADY {
            variation += (next.roll - torque.roll).abs();
        }
        torque = next;
        for ms in 0..20 {
            let at = (i * 20 + ms) as f64 * 1e-3;
            let around = disturbance.surroundings(&params, at, state.robot.x, state.robot.y);
            state = plant.step(&state, motors.step(torque), &around, 1e-3);
            if i >= TYPED {
                errors.push((state.robot.q_r - command) / DEG);
            }
        }
        let s = &state.robot;
        if !(s.q_r.abs() < 1.0 && s.beta.abs() < 1.0) {
            return Figures {
                rise: f64::INFINITY,
                settle: f64::INFINITY,
                rmse: f64::INFINITY,
                band: f64::INFINITY,
                wrong_way: f64::INFINITY,
                overshoot: f64::INFINITY,
                torque: f64::INFINITY,
                fell: true,
            };
        }
    }
    figures(&errors, to, variation)
}

/// Medians over `seeds` of every figure; `fell` if any did.
pub fn medians(seeds: u64, mut run: impl FnMut(u64) -> Figures) -> Figures {
    let runs: Vec<Figures> = (1..=seeds).map(&mut run).collect();
    let median = |of: fn(&Figures) -> f64| {
        let mut values: Vec<f64> = runs.iter().map(of).collect();
        values.sort_by(f64::total_cmp);
        let middle = values.len() / 2;
        if values.len() % 2 == 1 {
            values[middle]
        } else {
            0.5 * (values[middle - 1] + values[middle])
        }
    };
    Figures {
        rise: median(|f| f.rise),
        settle: median(|f| f.settle),
        rmse: median(|f| f.rmse),
        band: median(|f| f.band),
        wrong_way: median(|f| f.wrong_way),
        overshoot: median(|f| f.overshoot),
        torque: median(|f| f.torque),
        fell: runs.iter().any(|f| f.fell),
    }
}

/// `errors` [°] every millisecond from the step on.
fn figures(errors: &[f64], to: f64, variation: f64) -> Figures {
    let seconds = |i: usize| (i + 1) as f64 * 1e-3;
    let side = to.signum();
    let rise = errors.iter().position(|e| e * side >= 0.0);
    let left = errors.iter().rposition(|e| e.abs() > 1.0);
    let steady = &errors[(STEADY - TYPED) * 20..];
    let extremes = steady
        .iter()
        .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), e| {
            (low.min(*e), high.max(*e))
        });
    let squares: f64 = steady.iter().map(|e| e * e).sum();
    let largest = |values: &mut dyn Iterator<Item = f64>| values.fold(0.0, f64::max);
    Figures {
        rise: rise.map_or(f64::INFINITY, seconds),
        settle: match left {
            Some(i) if i + 1000 >= errors.len() => f64::INFINITY,
            Some(i) => seconds(i),
            None => 0.0,
        },
        rmse: (squares / steady.len() as f64).sqrt(),
        band: 0.5 * (extremes.1 - extremes.0),
        wrong_way: largest(&mut errors[..3000].iter().map(|e| -side * (e + to))),
        overshoot: largest(&mut errors[..3000].iter().map(|e| e * side)),
        torque: variation / (steady.len() as f64 * 1e-3),
        fell: false,
    }
}

/// What an attitude filter, gyro and encoders make of the true state.
struct Sensing {
    scale: f64,
    random: ChaCha8Rng,
    slow: [f64; 2], // of q_r and α [rad]
}

impl Sensing {
    fn new(scale: f64, mut random: ChaCha8Rng) -> Self {
        let slow = [0.0; 2].map(|_: f64| normal(&mut random) * ATTITUDE_SLOW);
        Self {
            scale,
            random,
            slow,
        }
    }

    fn see(&mut self, state: &PlantState, radius: f64) -> RobotState {
        let keep = (-PERIOD / SLOW_TIME).exp();
        let drive = ATTITUDE_SLOW * (1.0 - keep * keep).sqrt();
        let random = &mut self.random;
        let [roll, pitch] = self.slow.each_mut().map(|slow| {
            *slow = keep * *slow + drive * normal(random);
            *slow + ATTITUDE_WHITE * normal(random)
        });
        let [roll_rate, pitch_rate] = [0.0; 2].map(|_: f64| RATE_WHITE * normal(random));
        let [roll, pitch, roll_rate, pitch_rate] =
            [roll, pitch, roll_rate, pitch_rate].map(|noise| noise * self.scale);
        let s = &state.robot;
        // θ_r = β + q_r and θ_p = φ_s + α are encoders: exact beside these.
        RobotState {
            q_r: s.q_r + roll,
            q_r_rate: s.q_r_rate + roll_rate,
            beta: s.beta - roll,
            beta_rate: s.beta_rate - roll_rate,
            alpha: s.alpha + pitch,
            alpha_rate: s.alpha_rate + pitch_rate,
            v: s.v - radius * pitch_rate,
            ..*s
        }
    }
}

fn normal(random: &mut ChaCha8Rng) -> f64 {
    StandardNormal.sample(random)
}

/// Control steps of a run: 25 s; the first under the typed step, 5 s; the first that counts as steady, 10 s.
const STEPS: usize = 1250;
const TYPED: usize = 250;
const STEADY: usize = 500;
const ATTITUDE_WHITE: f64 = 0.1 * DEG;
const ATTITUDE_SLOW: f64 = 0.2 * DEG;
const SLOW_TIME: f64 = 10.0;
const RATE_WHITE: f64 = 0.3 * DEG;
