//! The model exactly as the paper prints it: M, N, E of eq (4) and the sub-model of eqs (6), (7) that follows from them.
//!
//! Known to be wrong (E1, E8, E13; [`super`] has the reasons). It is here so that what the paper's controller would compute
//! can be computed, and compared.

use nalgebra::{Matrix4, Vector4};
use sphere_protocol::state::{RobotState, Torque};

use super::{NominalModel, SubModel};

/// The floor's forces in the printed N [N].
#[derive(Clone, Copy, Debug, PartialEq, Default)]
pub struct FloorForces {
    /// F_fp, along X'.
    pub fp: f64,
    /// F_fr, along Y'.
    pub fr: f64,
}

impl NominalModel {
    /// M(q) as printed, 4 × 4: the roll block has 0 in its lower left, row x is in N·m while its variable is ẍ.
    pub fn printed_inertia(&self, state: &RobotState) -> Matrix4<f64> {
        let p = &self.params;
        let (c_pitch, c_roll) = (
            self.coupling * state.alpha.cos(),
            self.coupling * state.beta.cos(),
        );
        Matrix4::new(
            p.i_mp() + p.i_fp,
            c_pitch / p.r,
            0.0,
            0.0, //
            c_pitch,
            p.total_mass() * p.r + p.i_s / p.r,
            0.0,
            0.0, //
            0.0,
            0.0,
            p.i_mr(),
            c_roll, //
            0.0,
            0.0,
            0.0,
            p.i_s + p.i_fr + p.total_mass() * p.r * p.r,
        )
    }

    /// N(q, q̇) as printed [N·m].
    pub fn printed_forces(&self, state: &RobotState, floor: FloorForces) -> Vector4<f64> {
        let p = &self.params;
        let (sin_alpha, cos_alpha) = state.alpha.sin_cos();
        let (sin_beta, cos_beta) = state.beta.sin_cos();
        let rolling = state.v / p.r;
        Vector4::new(
            self.righting * sin_alpha * cos_beta
                + p.zeta * (state.alpha_rate + rolling * cos_alpha),
            -self.coupling * state.alpha_rate * state.alpha_rate * sin_alpha
                + p.zeta * (state.alpha_rate * cos_alpha + rolling)
                + floor.fp * p.r,
            self.righting * cos_alpha * sin_beta
                + p.zeta * (state.beta_rate + state.q_r_rate * cos_beta),
            -self.coupling * state.beta_rate * state.beta_rate * sin_beta
                + p.zeta * (state.q_r_rate + state.beta_rate * cos_beta)
                + floor.fr * p.r,
        )
    }

    /// q̈ = M⁻¹ (E τ − N) as printed, of (α, x, β, q_r) [rad/s², m/s²]; E = [1 1 0 0; 0 0 1 1]ᵀ.
    pub fn printed_accelerations(
        &self,
        state: &RobotState,
        floor: FloorForces,
        torque: &Torque,
    ) -> Vector4<f64> {
        let m = self.printed_inertia(state);
        let n = self.printed_forces(state, floor);
        let block = |i: usize| {
            SubModel::from_rows(
                [
                    [m[(i, i)], m[(i, i + 1)]],
                    [m[(i + 1, i)], m[(i + 1, i + 1)]],
                ],
                [n[i], n[i + 1]],
            )
        };
        let [alpha, x] = block(0).accelerations(torque.pitch);
        let [beta, q_r] = block(2).accelerations(torque.roll);
        Vector4::new(alpha, x, beta, q_r)
    }

    /// Roll sub-model of eq (7) as printed, with F_fr R = M v² tan q_r of eqs (10), (11).
    pub fn printed_roll_submodel(&self, state: &RobotState) -> SubModel {
        let m = self.printed_inertia(state);
        SubModel::from_rows(
            [[m[(2, 2)], m[(2, 3)]], [m[(3, 2)], m[(3, 3)]]],
            self.printed_roll_forces(state),
        )
    }

    /// Rows (β, q_r) of N as printed, with F_fr R = M v² tan q_r of eqs (10), (11) [N·m].
    pub fn printed_roll_forces(&self, state: &RobotState) -> [f64; 2] {
        let p = &self.params;
        let floor = FloorForces {
            fp: 0.0,
            fr: p.total_mass() * state.v * state.v * state.q_r.tan() / p.r,
        };
        let n = self.printed_forces(state, floor);
        [n[2], n[3]]
    }
}
