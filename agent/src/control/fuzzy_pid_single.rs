//! Direction controller of the paper's comparison: one fuzzy-PID from the lean's error to the torque.
//!
//! It cannot be good on this plant, and that is a finding: the paper's rival is weak by its structure. Torque starts the lean the wrong
//! way (E7, a zero at +8.4 rad/s), the pendulum swings at 5.5 rad/s with nothing but its bearing to damp it, and one error cannot serve both. Of all
//! PID gains, behind the motors' 25 ms, none has a slowest pole beyond −0.11 1/s at 0.5 and 1.0 m/s, none beyond −0.08 1/s at both.
//!
//! The gains of the robot `liu` are the best of a search on the whole plant among sets whose loop is stable at every speed from 0 to 1 m/s
//! without the spans and with which the robot stands through the missions line, sine and lemniscate; a faster set, Kp 18 with Ki 6, falls over there. A step of
//! 10° at 0.5 m/s: t_r 0.9 s, ±1° after 8 s; at 1.0 m/s it comes within ±1° after 18 s. Missions are driven 0.2 m beside the path, where the other laws
//! are at 5 mm, and the lean swings by 15 to 30°. The paper states 8.5 and 3.4 s for t_r, 6.9 and 3.7 s for t_s.
//!
//! From the paper: the structure, a fuzzy-PID. Ours: tables, scalings, gains ([`super::fuzzy`]); ∫ Ki e dt rather than Ki ∫ e dt, so that a scheduled gain does
//! not make the torque jump; the integral within ± τ_max, waiting while the torque is at its limit and the error would push it farther.

use sphere_protocol::robot::{Robot, RobotParams};
use sphere_protocol::state::{RobotState, Setpoint};

use super::fuzzy::{PidGains, schedule};
use super::{Counters, DirectionController, is_usable};
use crate::gains::{FuzzyPidSingleGains, GainsError, Refused};

/// The single-loop fuzzy-PID of one robot.
#[derive(Clone, Debug)]
pub struct FuzzyPidSingle {
    gains: FuzzyPidSingleGains,
    torque_max: f64,
    integral: f64, // ∫ Ki e dt [N·m]
    counters: Counters,
    last: FuzzyPidSingleTerms,
}

/// What the law computes on its way to the torque.
#[derive(Clone, Copy, Debug, PartialEq, Default)]
pub struct FuzzyPidSingleTerms {
    /// Scheduled gains: Kp [N·m/rad], Ki [N·m/(rad·s)], Kd [N·m·s/rad].
    pub pid: PidGains,
    /// τ_r before saturation [N·m].
    pub torque: f64,
}

impl FuzzyPidSingle {
    /// The controller with the gains of the robot's file.
    ///
    /// # Errors
    /// A missing section, gains that cannot be read, or that violate a condition, with the numbers.
    pub fn from_robot(robot: &Robot) -> Result<Self, GainsError> {
        Self::new(&robot.params, FuzzyPidSingleGains::read(robot)?)
            .map_err(|error| GainsError::refused(robot, error))
    }

    /// The controller with `gains`.
    ///
    /// # Errors
    /// Every condition that the gains violate.
    pub fn new(params: &RobotParams, gains: FuzzyPidSingleGains) -> Result<Self, Refused> {
        Ok(Self {
            gains: gains.checked()?,
            torque_max: params.torque_max,
            integral: 0.0,
            counters: Counters::default(),
            last: FuzzyPidSingleTerms::default(),
        })
    }

    /// What the last step that gave a torque computed: for telemetry and tests.
    pub fn terms(&self) -> FuzzyPidSingleTerms {
        self.last
    }

    /// The integral ∫ Ki e dt [N·m].
    pub fn integral(&self) -> f64 {
        self.integral
    }
}

impl DirectionController for FuzzyPidSingle {
    fn step(&mut self, state: &RobotState, setpoint: &Setpoint, dt: f64) -> f64 {
        if !is_usable(state, setpoint, dt) {
            self.counters.not_finite = self.counters.not_finite.saturating_add(1);
            return 0.0;
        }
        let terms = law(&self.gains, state, setpoint, self.integral);
        if !terms.torque.is_finite() {
            self.counters.not_finite = self.counters.not_finite.saturating_add(1);
            return 0.0;
        }
        let growth = terms.pid.ki * (setpoint.q_r - state.q_r) * dt;
        let excess = terms.torque - terms.torque.clamp(-self.torque_max, self.torque_max);
        if excess * growth <= 0.0 {
            self.integral = (self.integral + growth).clamp(-self.torque_max, self.torque_max);
        }
        self.last = terms;
        self.counters.saturate(terms.torque, self.torque_max)
    }

    fn reset(&mut self) {
        self.integral = 0.0;
        self.last = FuzzyPidSingleTerms::default();
    }

    fn counters(&self) -> Counters {
        self.counters
    }

    /// A PID is the better on the bare step.
    fn step_filter(&self) -> Option<f64> {
        None
    }
}

/// The law, a pure function; `integral` is ∫ Ki e dt [N·m]. τ_r = Kp e + ∫ Ki e dt + Kd ė with e = q_rd − q_r.
///
/// Not finite where the input is not, or overflows.
pub fn law(
    gains: &FuzzyPidSingleGains,
    state: &RobotState,
    setpoint: &Setpoint,
    integral: f64,
) -> FuzzyPidSingleTerms {
    let e = setpoint.q_r - state.q_r;
    let e_rate = setpoint.q_r_rate - state.q_r_rate;
    let pid = schedule(&gains.schedule, e, e_rate);
    FuzzyPidSingleTerms {
        pid,
        torque: pid.kp * e + integral + pid.kd * e_rate,
    }
}
