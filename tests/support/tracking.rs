//! Problems of a robot that tracks the paper's trajectories, for the planner's tests.

#![allow(
    dead_code,
    unreachable_pub,
    reason = "each test binary uses its own part"
)]

use nalgebra::{SVector, Vector2};
use sphere_ground::kinematics::Discretisation;
use sphere_ground::mpc::{FirstInput, Problem, terminal_weight};

/// The trajectories of section IV-B.
#[derive(Clone, Copy, Debug)]
pub enum Trajectory {
    Line,
    Sine,
    Lemniscate,
}

pub const ALL: [Trajectory; 3] = [Trajectory::Line, Trajectory::Sine, Trajectory::Lemniscate];

const PERIOD: f64 = 0.1;
const RADIUS: f64 = 0.3;

impl Trajectory {
    /// Pose (X, Y, φ) and inputs (v, q_r) that follow the trajectory at time `t`, eq (2) inverted.
    pub fn at(self, t: f64) -> ([f64; 3], Vector2<f64>) {
        let ([x, y], [dx, dy], [ddx, ddy]) = match self {
            Self::Line => ([0.5 * t, 2.0], [0.5, 0.0], [0.0, 0.0]),
            Self::Sine => {
                let (sin, cos) = (0.25 * t).sin_cos();
                ([0.5 * t, 2.0 * sin], [0.5, 0.5 * cos], [0.0, -0.125 * sin])
            }
            Self::Lemniscate => {
                let s = t / 16.0;
                (
                    [8.0 * s.sin(), 4.0 * (2.0 * s).sin()],
                    [0.5 * s.cos(), 0.5 * (2.0 * s).cos()],
                    [-s.sin() / 32.0, -(2.0 * s).sin() / 16.0],
                )
            }
        };
        let v = f64::hypot(dx, dy);
        let turn = (dx * ddy - dy * ddx) / (v * v);
        (
            [x, y, dy.atan2(dx)],
            Vector2::new(v, (RADIUS * turn / v).atan()),
        )
    }
}

/// Eq (20) of a robot at `x0` at time `t`, N = 10.
pub fn paper(trajectory: Trajectory, t: f64, x0: [f64; 3], measured: Vector2<f64>) -> Problem<3> {
    let mut problem = Problem::new(Discretisation::arc(PERIOD, RADIUS), 10);
    problem.first_input = FirstInput::Measured;
    let roll = 20.0_f64.to_radians();
    problem.set_bounds(Vector2::new(-1.5, -roll), Vector2::new(1.5, roll));
    problem.x0 = SVector::from(x0);
    problem.u_prev = measured;
    let mut near = x0[2];
    for i in 0..10 {
        let (pose, u) = trajectory.at(t + PERIOD * (i + 1) as f64);
        near = unwrap(pose[2], near);
        problem.x_ref[i] = SVector::from([pose[0], pose[1], near]);
        problem.u_ref[i] = u;
    }
    problem
}

/// The formulation that ships, model `centre`, N = 20, of a robot at `x0`.
pub fn centre(trajectory: Trajectory, t: f64, x0: [f64; 5]) -> Problem<5> {
    let mut problem = Problem::new(Discretisation::centre(PERIOD, RADIUS, 0.4), 20);
    problem.x0 = SVector::from(x0);
    problem.u_prev = Vector2::new(x0[3], x0[4]);
    let mut near = x0[2];
    for i in 0..20 {
        let (pose, u) = trajectory.at(t + PERIOD * (i + 1) as f64);
        near = unwrap(pose[2], near);
        problem.x_ref[i] = SVector::from([pose[0], pose[1], near, u[0], u[1]]);
        problem.u_ref[i] = trajectory.at(t + PERIOD * i as f64).1;
    }
    problem.p_terminal = terminal_weight(
        &problem.model,
        &problem.x_ref[19],
        &problem.u_ref[19],
        &problem.q,
        &problem.r,
    );
    problem
}

fn unwrap(angle: f64, near: f64) -> f64 {
    let turn = core::f64::consts::TAU;
    angle - turn * ((angle - near) / turn).round()
}
