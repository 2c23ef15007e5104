//! The reference that the torque controllers follow: commands (v_c, q_c) through the lag that the planner counts on, or the
//! braking ramp to rest.

use sphere_protocol::robot::{Limits, RobotParams};
use sphere_protocol::state::Setpoint;

/// References v_d and q_rd with their derivatives.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Reference {
    v: f64,
    q_r: f64,
}

impl Reference {
    /// A reference that begins at speed `v` [m/s] and roll `q_r` [rad].
    pub fn starting_at(v: f64, q_r: f64) -> Self {
        Self { v, q_r }
    }

    /// Speed reference v_d [m/s].
    pub fn v(&self) -> f64 {
        self.v
    }

    /// Roll reference q_rd [rad].
    pub fn q_r(&self) -> f64 {
        self.q_r
    }

    /// Follows the commands `v_c` [m/s] and `q_c` [rad] for `dt` [s] with the lag τ = `limits.reference_lag`:
    /// v̇_d = (v_c − v_d)/τ within the slew, q̇_rd = (q_c − q_rd)/τ, q̈_rd = −q̇_rd/τ.
    ///
    /// The planner knows this lag: any other filter between its commands and the references ends in limit cycles.
    pub fn follow(&mut self, v_c: f64, q_c: f64, dt: f64, limits: &Limits) -> Setpoint {
        let tau = limits.reference_lag;
        let share = 1.0 - (-dt / tau).exp();
        self.v += ((v_c - self.v) * share).clamp(-limits.slew * dt, limits.slew * dt);
        self.q_r += (q_c - self.q_r) * share;
        let q_r_rate = (q_c - self.q_r) / tau;
        Setpoint {
            v: self.v,
            v_rate: ((v_c - self.v) / tau).clamp(-limits.slew, limits.slew),
            q_r: self.q_r,
            q_r_rate,
            q_r_accel: -q_r_rate / tau,
        }
    }

    /// Brakes for `dt` [s]: the speed by the ramp `limits.brake` to zero, the roll by the lag.
    pub fn brake(&mut self, dt: f64, limits: &Limits) -> Setpoint {
        let step = limits.brake * dt;
        let v_rate = if self.v.abs() > step {
            -limits.brake.copysign(self.v)
        } else {
            0.0
        };
        self.v = if self.v.abs() > step {
            self.v - step.copysign(self.v)
        } else {
            0.0
        };
        let roll = self.follow_roll(0.0, dt, limits.reference_lag);
        Setpoint {
            v: self.v,
            v_rate,
            ..roll
        }
    }

    fn follow_roll(&mut self, q_c: f64, dt: f64, tau: f64) -> Setpoint {
        self.q_r += (q_c - self.q_r) * (1.0 - (-dt / tau).exp());
        let q_r_rate = (q_c - self.q_r) / tau;
        Setpoint {
            v: self.v,
            v_rate: 0.0,
            q_r: self.q_r,
            q_r_rate,
            q_r_accel: -q_r_rate / tau,
        }
    }
}

/// Largest |q_c| [rad] at speed `v` [m/s]: tan|q_r| v² within the turn limit, and the roll limit.
///
/// Below 0.22 m/s the turn limit is no bound (it would only amplify the noise of v).
pub fn roll_bound(v: f64, params: &RobotParams, limits: &Limits) -> f64 {
    (limits.turn_limit(params) / (v * v).max(0.05))
        .atan()
        .min(limits.q_r_max)
}
