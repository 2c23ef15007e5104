//! The plant: shell, frame and pendulum of one robot in three dimensions, rolling without slip and without pivoting ("rubber").
//!
//! Derived on its own by Kane's method and shared with nobody: the agent's and the planner's models are simpler, and an error
//! there must not be cancelled by the same error here. Parameters are the plant's own copy, which a scenario may change.
//!
//! # Geometry
//! Four right-handed frames, each one turn away from the one before:
//!
//! ```text
//! floor     X, Y, z    z normal to the floor
//! yaw       f, l, z    φ about z:            f forward, l left
//! lean      f, n, μ    q_r about −f:         n = cos q_r l − sin q_r z    μ = sin q_r l + cos q_r z
//! frame     s, n, w    α about −n:           s = cos α f + sin α μ        w = −sin α f + cos α μ
//! pendulum  s, t, k    θ_r = β + q_r about s: t = cos θ_r n + sin θ_r w   k = −sin θ_r n + cos θ_r w
//! ```
//!
//! The shell turns against the frame about n (pitch motor, θ_p = φ_s + α), the pendulum about s (roll motor, θ_r); the bob is at
//! −l k from the sphere's centre. The IMU's forward, left, up are s, n, w. On a slope every angle counts from the floor's
//! normal, not from the vertical.
//!
//! # Rolling
//! No slip: the centre moves with V = v f + R q̇_r l. No pivoting: the shell turns with ω_shell = −q̇_r f + (v/R) l, nothing about z.
//! The frame turns with ω = −q̇_r f − α̇ n + φ̇ z, and ω_shell − ω is along n by construction. Its l and z components give
//!
//! ```text
//! φ̇_s = v / (R cos q_r)        φ̇ = v tan q_r / R  (eq 1)        Ẋ + iẎ = (v + i R q̇_r) e^(iφ)  (eq 1)
//! ```

mod attitude;
mod equations;

use sphere_protocol::robot::RobotParams;
use sphere_protocol::state::{RobotState, Torque};

use crate::disturbance::Surroundings;
use crate::friction;
use crate::integrator::rk4;
use attitude::{Attitude, Turn};
pub use equations::Equations;
use equations::Geometry;

/// One robot's body, with its true parameters.
#[derive(Clone, Debug)]
pub struct Plant {
    params: RobotParams,
}

/// True state of the plant. On a slope, angles count from the floor's normal.
#[derive(Clone, Copy, Debug, PartialEq, Default)]
pub struct PlantState {
    /// Pose, angles and rates: what the agent estimates.
    pub robot: RobotState,
    /// Angle by which the shell has rolled about its long axis, φ_s, from the start [rad].
    pub phi_s: f64,
}

/// Accelerations of the quasi-velocities (α̇, v, β̇, q̇_r).
#[derive(Clone, Copy, Debug, PartialEq, Default)]
pub struct Accelerations {
    /// α̈ [rad/s²].
    pub alpha: f64,
    /// v̇ [m/s²].
    pub v: f64,
    /// β̈ [rad/s²].
    pub beta: f64,
    /// q̈_r [rad/s²].
    pub q_r: f64,
}

/// What an IMU without any error reads; axes forward, left, up of the frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TrueImu {
    /// Angular velocity of the frame [rad/s].
    pub gyro: [f64; 3],
    /// Acceleration of the sphere's centre minus gravity [m/s²].
    pub specific_force: [f64; 3],
}

impl Plant {
    /// A body with these parameters.
    pub fn new(params: RobotParams) -> Self {
        Self { params }
    }

    /// The true parameters.
    pub fn params(&self) -> &RobotParams {
        &self.params
    }

    /// The state a step `dt` [s] later, torques at the joints and surroundings held (RK4).
    ///
    /// Beyond |q_r| = 90° the equations mean nothing; what comes out may be anything, NaN included.
    pub fn step(
        &self,
        state: &PlantState,
        torque: Torque,
        around: &Surroundings,
        dt: f64,
    ) -> PlantState {
        let start = Attitude::of(state, around);
        let next = rk4(state.to_array(), dt, |y| {
            let state = PlantState::from_array(y);
            self.derivative(&state, &start.to(&state, around), torque, around)
        });
        PlantState::from_array(&next)
    }

    /// Accelerations under the torques at the joints: u̇ = M⁻¹ (Q − h).
    pub fn accelerations(
        &self,
        state: &PlantState,
        torque: Torque,
        around: &Surroundings,
    ) -> Accelerations {
        let attitude = Attitude::of(state, around);
        let geometry = Geometry::of(&attitude, self.params.r);
        self.solve(state, &attitude, &geometry, torque, around)
    }

    /// M and h of M u̇ + h = Q at this state; h contains gravity.
    pub fn equations(&self, state: &PlantState, around: &Surroundings) -> Equations {
        let attitude = Attitude::of(state, around);
        let geometry = Geometry::of(&attitude, self.params.r);
        let g = gravity(&self.params, &attitude.heading, around);
        Equations::of(&self.params, &state.robot, &geometry, g)
    }

    /// Kinetic energy, ½ uᵀ M u [J].
    pub fn kinetic_energy(&self, state: &PlantState) -> f64 {
        let m = self
            .equations(state, &Surroundings::level(&self.params))
            .mass_matrix();
        let s = &state.robot;
        let u = [s.alpha_rate, s.v, s.beta_rate, s.q_r_rate];
        let twice: f64 = (0..4)
            .map(|i| (0..4).map(|j| u[i] * m[i][j] * u[j]).sum::<f64>())
            .sum();
        0.5 * twice
    }

    /// Potential energy, zero with the bob at the height of a centre at X = Y = 0 [J].
    pub fn potential_energy(&self, state: &PlantState, around: &Surroundings) -> f64 {
        let (p, s) = (&self.params, &state.robot);
        let attitude = Attitude::of(state, around);
        let k = Geometry::of(&attitude, p.r).k;
        let g = gravity(p, &attitude.heading, around);
        let climbed = around.up[0] * s.x + around.up[1] * s.y;
        p.total_mass() * p.g * climbed - p.m * p.l * (k[0] * g[0] + k[1] * g[1] + k[2] * g[2])
    }

    /// Power that bearings, gearboxes and the floor take out, ≥ 0 [W].
    pub fn dissipation(&self, state: &PlantState, around: &Surroundings) -> f64 {
        let (p, s) = (&self.params, &state.robot);
        let (pitch_rate, roll_rate) = (state.theta_p_rate(p.r), state.theta_r_rate());
        let (force, torque) = self.rolling_resistance(s, around);
        friction::joint(p.zeta, p.coulomb, around.stiction, pitch_rate) * pitch_rate
            + friction::joint(p.zeta, p.coulomb, around.stiction, roll_rate) * roll_rate
            + force * s.v
            + torque * s.q_r_rate
    }

    /// What an ideal IMU reads at this state with these accelerations.
    ///
    /// The centre accelerates by v̇ − R q̇_r φ̇ forward and R q̈_r + v φ̇ to the left.
    pub fn imu(
        &self,
        state: &PlantState,
        accelerations: &Accelerations,
        around: &Surroundings,
    ) -> TrueImu {
        let (r, s) = (self.params.r, &state.robot);
        let attitude = Attitude::of(state, around);
        let geometry = Geometry::of(&attitude, r);
        let g = gravity(&self.params, &attitude.heading, around);
        let yaw_rate = s.v * geometry.yaw_v;
        let a = [
            accelerations.v - r * s.q_r_rate * yaw_rate + g[0],
            r * accelerations.q_r + s.v * yaw_rate + g[1],
            g[2],
        ];
        TrueImu {
            gyro: geometry.frame_rates(s),
            specific_force: [geometry.s, geometry.n(), geometry.w()]
                .map(|axis| axis[0] * a[0] + axis[1] * a[1] + axis[2] * a[2]),
        }
    }

    /// d/dt of [`PlantState::to_array`].
    fn derivative(
        &self,
        state: &PlantState,
        attitude: &Attitude,
        torque: Torque,
        around: &Surroundings,
    ) -> [f64; 11] {
        let (r, s) = (self.params.r, &state.robot);
        let geometry = Geometry::of(attitude, r);
        let u = self.solve(state, attitude, &geometry, torque, around);
        let Turn { sin, cos, .. } = attitude.heading;
        let sideways = r * s.q_r_rate;
        [
            // Eq (1): Ẋ = v cos φ − R q̇_r sin φ, Ẏ = v sin φ + R q̇_r cos φ, φ̇ = v tan q_r / R
            s.v * cos - sideways * sin,
            s.v * sin + sideways * cos,
            s.v * geometry.yaw_v,
            s.v * geometry.shell_v,
            s.alpha_rate,
            s.beta_rate,
            s.q_r_rate,
            u.alpha,
            u.v,
            u.beta,
            u.q_r,
        ]
    }

    fn solve(
        &self,
        state: &PlantState,
        attitude: &Attitude,
        geometry: &Geometry,
        torque: Torque,
        around: &Surroundings,
    ) -> Accelerations {
        let push = around.torques_turned(attitude.imbalance.sin, attitude.imbalance.cos);
        let forces = self.generalised_forces(state, geometry.shell_v, torque, push, around);
        let g = gravity(&self.params, &attitude.heading, around);
        Equations::of(&self.params, &state.robot, geometry, g).solve(forces)
    }

    /// Q on the rows (α, v, β, q_r) [N·m, N, N·m, N·m].
    ///
    /// A motor works on the relative rate of what it joins, α̇ + v/(R cos q_r) and β̇ + q̇_r, so its torque less its friction enters
    /// two rows. A torque on the rolling motion is divided by R on row v.
    fn generalised_forces(
        &self,
        state: &PlantState,
        shell_v: f64,
        torque: Torque,
        (push_roll, push_pitch): (f64, f64),
        around: &Surroundings,
    ) -> [f64; 4] {
        let (p, s) = (&self.params, &state.robot);
        let pitch_rate = s.alpha_rate + s.v * shell_v;
        let pitch = torque.pitch - friction::joint(p.zeta, p.coulomb, around.stiction, pitch_rate);
        let roll_rate = s.beta_rate + s.q_r_rate;
        let roll = torque.roll - friction::joint(p.zeta, p.coulomb, around.stiction, roll_rate);
        let (resisting_force, resisting_torque) = self.rolling_resistance(s, around);
        [
            pitch,
            pitch * shell_v - resisting_force + push_pitch / p.r,
            roll,
            roll - resisting_torque + push_roll,
        ]
    }

    fn rolling_resistance(&self, s: &RobotState, around: &Surroundings) -> (f64, f64) {
        let p = &self.params;
        let normal = p.total_mass() * p.g * around.up[2];
        friction::rolling_resistance(around.c_rr, normal, p.r, p.v_rr, s.v, s.q_r_rate)
    }
}

impl PlantState {
    /// Angle of the roll motor, θ_r = β + q_r [rad].
    pub fn theta_r(&self) -> f64 {
        self.robot.beta + self.robot.q_r
    }

    /// Its rate [rad/s].
    pub fn theta_r_rate(&self) -> f64 {
        self.robot.beta_rate + self.robot.q_r_rate
    }

    /// Angle of the pitch motor, θ_p = φ_s + α [rad].
    pub fn theta_p(&self) -> f64 {
        self.phi_s + self.robot.alpha
    }

    /// Its rate, α̇ + v/(R cos q_r), for a sphere of this radius [m]; [rad/s].
    pub fn theta_p_rate(&self, radius: f64) -> f64 {
        self.robot.alpha_rate + self.robot.v / (radius * self.robot.q_r.cos())
    }

    fn to_array(self) -> [f64; 11] {
        let s = &self.robot;
        [
            s.x,
            s.y,
            s.heading,
            self.phi_s,
            s.alpha,
            s.beta,
            s.q_r,
            s.alpha_rate,
            s.v,
            s.beta_rate,
            s.q_r_rate,
        ]
    }

    fn from_array(y: &[f64; 11]) -> Self {
        let &[
            x,
            y,
            heading,
            phi_s,
            alpha,
            beta,
            q_r,
            alpha_rate,
            v,
            beta_rate,
            q_r_rate,
        ] = y;
        let robot = RobotState {
            x,
            y,
            heading,
            v,
            q_r,
            q_r_rate,
            beta,
            beta_rate,
            alpha,
            alpha_rate,
        };
        Self { robot, phi_s }
    }
}

/// Gravity as the upward acceleration of a floor that carries everything with it: g times the vertical, on f, l, z [m/s²].
fn gravity(p: &RobotParams, heading: &Turn, around: &Surroundings) -> [f64; 3] {
    let (up, &Turn { sin, cos, .. }) = (around.up, heading);
    [
        p.g * (up[0] * cos + up[1] * sin),
        p.g * (up[1] * cos - up[0] * sin),
        p.g * up[2],
    ]
}
