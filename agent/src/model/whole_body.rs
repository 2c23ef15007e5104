//! The whole-body model of eq (4), M(q) q̈ + N(q, q̇) = E τ, as corrected: rows and coordinates (α, x, β, q_r).
//!
//! The controllers use the sub-models of [`super`]; this assembles them, for the tests that hold them against the plant
//! and for energy budgets. Row x is in newtons (virtual work per metre; the paper mixes in a row in N·m, E1), the others in N·m.

use nalgebra::{Matrix4, Vector4};
use sphere_protocol::state::{RobotState, Torque};

use super::NominalModel;

impl NominalModel {
    /// M(q), 4 × 4, symmetric and positive definite [kg·m², kg·m, kg].
    pub fn inertia(&self, state: &RobotState) -> Matrix4<f64> {
        let r = self.params.r;
        let (pitch, roll) = (
            self.pitch_inertia(state.alpha),
            self.roll_inertia(state.beta),
        );
        Matrix4::new(
            pitch.a,
            pitch.c / r,
            0.0,
            0.0, //
            pitch.c / r,
            self.turning_mass,
            0.0,
            0.0, //
            0.0,
            0.0,
            roll.a,
            roll.c, //
            0.0,
            0.0,
            roll.c,
            roll.d,
        )
    }

    /// N(q, q̇) with gravity, damping, rolling resistance and the turning terms [N·m, N, N·m, N·m].
    pub fn forces(&self, state: &RobotState) -> Vector4<f64> {
        let [n_a, n_p] = self.pitch_forces(state);
        let [n3, n4] = self.roll_forces(state);
        Vector4::new(
            n_a,
            (n_p - self.turning_drive(state)) / self.params.r,
            n3,
            n4,
        )
    }

    /// q̈ = M⁻¹ (E τ − N) of (α, x, β, q_r) [rad/s², m/s²], one sub-model at a time.
    pub fn accelerations(&self, state: &RobotState, torque: &Torque) -> Vector4<f64> {
        let pitch = self.pitch_submodel(state, self.turning_drive(state));
        let roll = self.roll_submodel(state, 0.0);
        let [alpha, rolling] = pitch.accelerations(torque.pitch);
        let [beta, q_r] = roll.accelerations(torque.roll);
        Vector4::new(alpha, self.params.r * rolling, beta, q_r)
    }

    /// ½ q̇ᵀ M q̇ − m g l cos α cos β [J]: constant without torque, damping and rolling resistance.
    pub fn energy(&self, state: &RobotState) -> f64 {
        let rates = Vector4::new(state.alpha_rate, state.v, state.beta_rate, state.q_r_rate);
        0.5 * rates.dot(&(self.inertia(state) * rates))
            - self.righting * state.alpha.cos() * state.beta.cos()
    }
}
