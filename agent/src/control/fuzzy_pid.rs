//! Direction controller to compare with: a fuzzy-PID of the lean in cascade with a loop of the pendulum, built to be strong.
//!
//! The paper's rival is a fuzzy-PID that acts on the lean's error alone, from earlier work; neither its tables nor its gains are
//! printed, and such a loop cannot be good on this plant ([`super::fuzzy_pid_single`]). From the paper is the idea alone, gains scheduled by
//! fuzzy rules over e and ė. Ours, so that the comparison means something:
//! - the cascade: the PID asks for a swing β_cmd of the pendulum, which leans the frame the right way at once, and an inner loop
//!   makes the pendulum swing there. The motor torque itself begins with the wrong way (E7);
//! - part of the pendulum's weight is carried in advance (`gravity_share`), so that the inner loop need not wait for an error;
//! - ∫ Ki e dt rather than Ki ∫ e dt: a scheduled gain does not make the torque jump;
//! - anti-windup: the integral stays within ±`swing_max`, and waits while swing or torque is at its limit and the error would push it farther.

use sphere_protocol::robot::{Robot, RobotParams};
use sphere_protocol::state::{RobotState, Setpoint};

use super::fuzzy::{PidGains, schedule};
use super::{Counters, DirectionController, is_usable};
use crate::gains::{FuzzyPidGains, GainsError, Refused};
use crate::model::NominalModel;

/// The cascaded fuzzy-PID of one robot.
#[derive(Clone, Debug)]
pub struct FuzzyPid {
    gains: FuzzyPidGains,
    righting: f64, // m g l [N·m]
    torque_max: f64,
    integral: f64, // ∫ Ki e dt [rad]
    counters: Counters,
    last: FuzzyPidTerms,
}

/// What the law computes on its way to the torque.
#[derive(Clone, Copy, Debug, PartialEq, Default)]
pub struct FuzzyPidTerms {
    /// Scheduled gains: Kp [1], Ki [1/s], Kd [s].
    pub pid: PidGains,
    /// Swing asked of the pendulum, before its limit [rad].
    pub swing: f64,
    /// Swing asked of the pendulum, β_cmd [rad].
    pub swing_limited: f64,
    /// τ_r before saturation [N·m].
    pub torque: f64,
}

impl FuzzyPid {
    /// The controller with the gains of the robot's file.
    ///
    /// # Errors
    /// A missing section, gains that cannot be read, or that violate a condition, with the numbers.
    pub fn from_robot(robot: &Robot) -> Result<Self, GainsError> {
        Self::new(&robot.params, FuzzyPidGains::read(robot)?)
            .map_err(|error| GainsError::refused(robot, error))
    }

    /// The controller with `gains`.
    ///
    /// # Errors
    /// Every condition that the gains violate.
    pub fn new(params: &RobotParams, gains: FuzzyPidGains) -> Result<Self, Refused> {
        Ok(Self {
            gains: gains.checked()?,
            righting: NominalModel::new(params).righting,
            torque_max: params.torque_max,
            integral: 0.0,
            counters: Counters::default(),
            last: FuzzyPidTerms::default(),
        })
    }

    /// What the last step that gave a torque computed: for telemetry and tests.
    pub fn terms(&self) -> FuzzyPidTerms {
        self.last
    }

    /// The integral ∫ Ki e dt [rad].
    pub fn integral(&self) -> f64 {
        self.integral
    }
}

impl DirectionController for FuzzyPid {
    fn step(&mut self, state: &RobotState, setpoint: &Setpoint, dt: f64) -> f64 {
        if !is_usable(state, setpoint, dt) {
            self.counters.not_finite = self.counters.not_finite.saturating_add(1);
            return 0.0;
        }
        let terms = law(&self.gains, self.righting, state, setpoint, self.integral);
        if !terms.torque.is_finite() {
            self.counters.not_finite = self.counters.not_finite.saturating_add(1);
            return 0.0;
        }
        let growth = terms.pid.ki * (setpoint.q_r - state.q_r) * dt;
        let swing_excess = terms.swing - terms.swing_limited;
        let torque_excess = terms.torque - terms.torque.clamp(-self.torque_max, self.torque_max);
        if swing_excess * growth <= 0.0 && torque_excess * growth <= 0.0 {
            let swing_max = self.gains.swing_max;
            self.integral = (self.integral + growth).clamp(-swing_max, swing_max);
        }
        self.last = terms;
        self.counters.saturate(terms.torque, self.torque_max)
    }

    fn reset(&mut self) {
        self.integral = 0.0;
        self.last = FuzzyPidTerms::default();
    }

    fn counters(&self) -> Counters {
        self.counters
    }

    /// A PID is the better on the bare step.
    fn step_filter(&self) -> Option<f64> {
        None
    }
}

/// The law, a pure function; `righting` is m g l [N·m], `integral` ∫ Ki e dt [rad]. With e = q_rd − q_r:
///
/// β_cmd = Kp e + ∫ Ki e dt + Kd ė, within ±`swing_max`;
/// τ_r = `swing_stiffness` (β_cmd − β) − `swing_damping` β̇ + `gravity_share` m g l sin β.
///
/// Not finite where the input is not, or overflows.
pub fn law(
    gains: &FuzzyPidGains,
    righting: f64,
    state: &RobotState,
    setpoint: &Setpoint,
    integral: f64,
) -> FuzzyPidTerms {
    let g = gains;
    let e = setpoint.q_r - state.q_r;
    let e_rate = setpoint.q_r_rate - state.q_r_rate;
    let pid = schedule(&g.schedule, e, e_rate);
    let swing = pid.kp * e + integral + pid.kd * e_rate;
    let swing_limited = swing.clamp(-g.swing_max, g.swing_max);
    FuzzyPidTerms {
        pid,
        swing,
        swing_limited,
        torque: g.swing_stiffness * (swing_limited - state.beta)
            - g.swing_damping * state.beta_rate
            + g.gravity_share * righting * state.beta.sin(),
    }
}
