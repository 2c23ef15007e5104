//! The reference that the torque controllers follow: commands (v_c, q_c) through the lag that the planner counts on, typed ones
//! through filters, or the braking ramp to rest.

use sphere_protocol::robot::{Limits, RobotParams};
use sphere_protocol::state::Setpoint;

use crate::control::hsmc::SpeedShape;
use crate::control::reference_filter::{RollFilter, SpeedFilter};
use crate::plan::{PlannedCommand, Shape};

/// References v_d and q_rd with their derivatives.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Reference {
    v: f64,
    q_r: f64,
    /// The roll command without its jumps from knot to knot [rad].
    q_c: f64,
    /// While commands are typed.
    filters: Option<Filters>,
}

#[derive(Clone, Copy, Debug, PartialEq)]
struct Filters {
    speed: SpeedFilter,
    roll: Option<RollFilter>,
}

impl Reference {
    /// A reference that begins at speed `v` [m/s] and roll `q_r` [rad].
    pub fn starting_at(v: f64, q_r: f64) -> Self {
        Self {
            v,
            q_r,
            q_c: q_r,
            filters: None,
        }
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
    /// v̇_d = (v_c − v_d)/τ within the slew, q̇_rd = (q_s − q_rd)/τ, where q̇_s = (q_c − q_s)/T takes the edge off commands that jump at
    /// every knot: the direction controller differentiates q_rd twice. T = 50 ms; on the sine wave it cuts the heading error from
    /// 0.25° to 0.20° and the lean's from 0.23° to 0.19°, and the position's stays.
    ///
    /// The planner knows τ and not T: 100 ms gain nothing any more, and what is slower than τ ends in limit cycles.
    pub fn follow(&mut self, v_c: f64, q_c: f64, dt: f64, limits: &Limits) -> Setpoint {
        self.filters = None;
        let tau = limits.reference_lag;
        let share = 1.0 - (-dt / tau).exp();
        self.v += ((v_c - self.v) * share).clamp(-limits.slew * dt, limits.slew * dt);
        Setpoint {
            v: self.v,
            v_rate: ((v_c - self.v) / tau).clamp(-limits.slew, limits.slew),
            ..self.follow_roll(q_c, dt, tau)
        }
    }

    /// Follows a typed `command` for `dt` [s]: the speed by the ramp and filter of [`SpeedFilter`], the roll by a [`RollFilter`] of
    /// bandwidth `step_filter` [rad/s] or as it is. The second value is what the velocity controller may know beyond the setpoint.
    pub fn follow_typed(
        &mut self,
        command: &PlannedCommand,
        step_filter: Option<f64>,
        dt: f64,
    ) -> (Setpoint, SpeedShape) {
        let (v, q_r) = (self.v, self.q_r);
        let filters = self.filters.get_or_insert_with(|| Filters {
            speed: SpeedFilter::new(v),
            roll: step_filter.map(|w_ref| RollFilter::new(w_ref, q_r)),
        });
        let speed = filters.speed.step(command.v, dt);
        let mut setpoint = Setpoint {
            v: speed.v,
            v_rate: speed.v_rate,
            q_r: command.q_r,
            ..Setpoint::default()
        };
        match (&mut filters.roll, command.shape) {
            (_, Shape::Course { q_r_rate }) => setpoint.q_r_rate = q_r_rate,
            (Some(filter), _) => {
                let roll = filter.step(command.q_r, dt);
                setpoint.q_r = roll.q_r;
                setpoint.q_r_rate = roll.q_r_rate;
                setpoint.q_r_accel = roll.q_r_accel;
            }
            (None, _) => {}
        }
        (self.v, self.q_r, self.q_c) = (setpoint.v, setpoint.q_r, setpoint.q_r);
        (setpoint, speed.shape)
    }

    /// Brakes for `dt` [s]: the speed by the ramp `limits.brake` to zero, the roll by the lag.
    pub fn brake(&mut self, dt: f64, limits: &Limits) -> Setpoint {
        self.filters = None;
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

    /// Both lags under the held command `q_c`, exactly, as far as q_s may follow it with [`ROLL_RATE_MAX`]: q = u + A e^(−t/T) + B e^(−t/τ), A = (q_s − u) T/(T − τ), B = q_rd − u − A.
    fn follow_roll(&mut self, q_c: f64, dt: f64, tau: f64) -> Setpoint {
        let edge = COMMAND_LAG;
        let reach = ROLL_RATE_MAX * edge;
        let q_c = q_c.clamp(self.q_c - reach, self.q_c + reach);
        let quick = (self.q_c - q_c) * edge / (edge - tau);
        let slow = self.q_r - q_c - quick;
        let (quick_decay, slow_decay) = ((-dt / edge).exp(), (-dt / tau).exp());
        self.q_r = q_c + quick * quick_decay + slow * slow_decay;
        self.q_c = q_c + (self.q_c - q_c) * quick_decay;
        let q_r_rate = (self.q_c - self.q_r) / tau;
        Setpoint {
            v: self.v,
            v_rate: 0.0,
            q_r: self.q_r,
            q_r_rate,
            q_r_accel: ((q_c - self.q_c) / edge - q_r_rate) / tau,
        }
    }
}

/// T, lag that takes the edge off roll commands [s]. Half of a knot.
const COMMAND_LAG: f64 = 0.05;
/// Largest rate of q_s [rad/s]. With τ = 0.4 s the roll reference then never asks for more than 2.5 rad/s². Commands that go from one
/// end of the roll's range to the other, as after a silence far from the path, would ask for 35 rad/s², swing the pendulum beyond
/// what the controllers bear and throw the robot over. Missions' own commands stay below a fifth of it.
const ROLL_RATE_MAX: f64 = 1.0;

/// Largest |q_c| [rad] at speed `v` [m/s]: tan|q_r| v² within the turn limit, and the roll limit.
///
/// Below 0.22 m/s the turn limit is no bound (it would only amplify the noise of v).
pub fn roll_bound(v: f64, params: &RobotParams, limits: &Limits) -> f64 {
    (limits.turn_limit(params) / (v * v).max(0.05))
        .atan()
        .min(limits.q_r_max)
}
