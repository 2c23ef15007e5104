//! The estimator in the loop: the plant with its sensors, driven by a plain cascade controller on the *estimated* state.

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use sphere_agent::estimator::Estimator;
use sphere_protocol::robot::RobotParams;
use sphere_protocol::state::{BoardStatus, RobotState, Torque};
use sphere_protocol::time::Span;
use sphere_sim::actuator::Actuator;
use sphere_sim::disturbance::Disturbance;
use sphere_sim::plant::{Plant, PlantState};
use sphere_sim::sensor::{PositionSource, Sensors};

use crate::motion::{Motion, Sensing, Truth, stamp};

/// Drives the plant along a motion's v and q_r for `duration` [s]; `on_frame` sees every frame after the estimator took it.
pub(crate) fn drive(
    estimator: &mut Estimator,
    params: &RobotParams,
    disturbance: &Disturbance,
    reference: Motion,
    sensing: &Sensing,
    duration: f64,
    mut on_frame: impl FnMut(&Estimator, &Truth),
) {
    let plant = Plant::new(*params);
    let random = |stream| {
        let mut random = ChaCha8Rng::seed_from_u64(sensing.seed);
        random.set_stream(stream);
        random
    };
    let mut sensors = Sensors::new(sensing.noise, random(0));
    let mut positions = PositionSource::new(0.02 * sensing.noise, random(1));
    let mut actuator = Actuator::new(params, Span::from_millis(1));
    let mut controller = Controller::default();
    let mut state = PlantState::default();
    let mut command = Torque::default();
    let mut path = 0.0;
    let status = BoardStatus {
        torque_on: true,
        command_valid: true,
        imu_ok: true,
        encoders_ok: true,
    };
    for ms in 0..=(duration * 1e3) as u64 {
        let t = ms as f64 * 1e-3;
        let around = disturbance.surroundings(params, t, state.robot.x, state.robot.y);
        if ms % 5 == 0 {
            let accelerations = plant.accelerations(&state, actuator.torque(), &around);
            let imu = plant.imu(&state, &accelerations, &around);
            let measurement = sensors.sample(stamp(t), &state, params.r, &imu, status);
            estimator.on_measurement(&measurement);
            let truth = Truth {
                t,
                state: state.robot,
                path,
                gyro_bias: [f64::NAN; 3],
            };
            if sensing.fixes && ms % 100 == 35 {
                positions.sample(stamp(t), &state);
            }
            while let Some(fix) = positions.poll(stamp(t)) {
                estimator.on_fix(&fix);
            }
            on_frame(estimator, &truth);
        }
        if ms % 20 == 0 && t > 1.2 {
            command = controller.step(params, &estimator.state(), reference, t);
        }
        let torque = actuator.step(command);
        state = plant.step(&state, torque, &around, 1e-3);
        path += 1e-3 * state.robot.v.hypot(params.r * state.robot.q_r_rate);
    }
}

/// Lean and speed by one cascade each: the error asks for a swing, the swing for a torque.
#[derive(Default)]
struct Controller {
    q_r_error: f64,
    v_error: f64,
}

impl Controller {
    fn step(&mut self, p: &RobotParams, s: &RobotState, reference: Motion, t: f64) -> Torque {
        let wanted = reference(t);
        let weight = p.m * p.g * p.l;
        let e = wanted.q_r.f - s.q_r;
        self.q_r_error += 0.02 * e;
        let beta = 2.57 * e + 2.86 * self.q_r_error + 0.67 * (wanted.q_r.d - s.q_r_rate);
        let beta = beta.clamp(-0.6, 0.6);
        let roll = 134.0 * (beta - s.beta) - 20.0 * s.beta_rate + 0.46 * weight * s.beta.sin();

        let e = wanted.v.f - s.v;
        self.v_error += 0.02 * e;
        let inertia = p.total_mass() * p.r + p.i_s / p.r - p.m * p.l;
        let alpha = inertia * wanted.v.d / weight + 0.4 * e + 0.1 * self.v_error;
        let alpha = alpha.clamp(-0.5, 0.5);
        let pitch = 60.0 * (alpha - s.alpha) - 8.0 * s.alpha_rate + weight * s.alpha.sin();
        Torque { pitch, roll }
    }
}
