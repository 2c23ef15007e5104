//! What is measured, estimated and commanded on one robot.
//!
//! X forward, Y left, Z up; SI units and radians. Names are those of NOTATION.md.

use crate::time::{BoardClock, Instant};

/// Pose, angles and rates of one robot, as estimated on board or as true in the simulator.
///
/// `alpha` and `beta` are *absolute* swing angles of the pendulum from the vertical.
#[derive(Clone, Copy, Debug, PartialEq, Default)]
pub struct RobotState {
    /// Position of the sphere's centre, world X [m].
    pub x: f64,
    /// Position of the sphere's centre, world Y [m].
    pub y: f64,
    /// Yaw φ, positive to the left, unwrapped (it does not jump at ±π) [rad].
    pub heading: f64,
    /// Forward speed of the centre over the floor [m/s].
    pub v: f64,
    /// Roll of the frame, q_r > 0 leans left [rad].
    pub q_r: f64,
    /// Rate of `q_r` [rad/s].
    pub q_r_rate: f64,
    /// Swing of the pendulum in roll, β > 0 bob to the left [rad].
    pub beta: f64,
    /// Rate of `beta` [rad/s].
    pub beta_rate: f64,
    /// Swing of the pendulum in pitch, α > 0 bob ahead [rad].
    pub alpha: f64,
    /// Rate of `alpha` [rad/s].
    pub alpha_rate: f64,
}

/// One sensor frame of the motor board.
///
/// The IMU sits on the frame at the sphere's centre, axes forward, left, up (FLU) of the frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Measurement {
    /// When the board sampled, in its own clock.
    pub stamp: Instant<BoardClock>,
    /// Angular velocity of the frame, FLU [rad/s].
    pub gyro: [f64; 3],
    /// Specific force at the IMU, FLU [m/s²]; +9.81 on the up axis at rest.
    pub accel: [f64; 3],
    /// Angle of the roll motor, θ_r = β + q_r [rad], unwrapped by the board.
    pub theta_r: f64,
    /// Rate of `theta_r`: mean over the board's sample interval [rad/s].
    pub theta_r_rate: f64,
    /// Angle of the pitch motor, θ_p = φ_s + α [rad], unwrapped by the board.
    pub theta_p: f64,
    /// Rate of `theta_p`: mean over the board's sample interval [rad/s].
    pub theta_p_rate: f64,
    /// What the board says of itself.
    pub status: BoardStatus,
}

/// What the motor board reports of itself in each sensor frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub struct BoardStatus {
    /// The motors are powered and follow torque commands.
    pub torque_on: bool,
    /// A torque command is in force whose validity has not run out.
    pub command_valid: bool,
    /// The IMU answers and is inside its range.
    pub imu_ok: bool,
    /// Both encoders answer.
    pub encoders_ok: bool,
}

/// A position of the sphere's centre from outside (motion capture, UWB, GNSS).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PositionFix {
    /// When it was true, in the board's clock.
    pub stamp: Instant<BoardClock>,
    /// World X [m].
    pub x: f64,
    /// World Y [m].
    pub y: f64,
    /// Standard deviation of each axis [m].
    pub sigma: f64,
}

/// Motor torques.
#[derive(Clone, Copy, Debug, PartialEq, Default)]
pub struct Torque {
    /// τ_p of the long-axis motor: > 0 swings the bob forward and drives the shell forward [N·m].
    pub pitch: f64,
    /// τ_r of the short-axis motor: > 0 swings the bob left and rolls the shell left [N·m].
    pub roll: f64,
}

/// What the torque controllers track at one instant: the reference and its derivatives.
#[derive(Clone, Copy, Debug, PartialEq, Default)]
pub struct Setpoint {
    /// Speed v_d [m/s].
    pub v: f64,
    /// Its derivative [m/s²].
    pub v_rate: f64,
    /// Roll q_rd [rad].
    pub q_r: f64,
    /// Its derivative [rad/s].
    pub q_r_rate: f64,
    /// Its second derivative [rad/s²].
    pub q_r_accel: f64,
}
