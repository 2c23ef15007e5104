//! Torque controllers: what they have in common, and which one steers.
//!
//! Velocity is always [`hsmc`], with its observer or without. Direction is a choice ([`DirectionChoice`], in a configuration `roll_controller = "htsmc"`):
//! a new law is one file here and one variant there. Every controller gives a finite torque within ± τ_max, whatever it is fed:
//! where it cannot compute one it gives 0 and counts it ([`Counters::not_finite`]). None allocates in `step`.

pub mod fuzzy;
pub mod fuzzy_pid;
pub mod fuzzy_pid_single;
pub mod hsmc;
pub mod htsmc;
pub mod htsmc_paper;
pub mod observer;
pub mod reference_filter;
pub mod sliding;

use serde::Deserialize;
use sphere_protocol::robot::Robot;
use sphere_protocol::state::{RobotState, Setpoint};

use self::hsmc::Hsmc;
use crate::gains::GainsError;

/// A law that makes the frame lean as told, and with it the robot turn.
pub trait DirectionController {
    /// Torque τ_r of the short-axis motor [N·m], finite and within ± τ_max, `dt` [s] after the last step.
    ///
    /// A state, setpoint or `dt` that is not finite, or a `dt` ≤ 0, gives 0, leaves the memory untouched and is counted.
    fn step(&mut self, state: &RobotState, setpoint: &Setpoint, dt: f64) -> f64;

    /// Forgets integrals and observers: before the motors are powered. Counters stay.
    fn reset(&mut self);

    /// What happened since the controller was built.
    fn counters(&self) -> Counters;

    /// Bandwidth of the filter through which typed roll steps must reach it [rad/s]; `None`: it wants them as they are.
    fn step_filter(&self) -> Option<f64>;
}

/// Rare events of a controller since it was built, in steps.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub struct Counters {
    /// The input gain was below its guard (E2).
    pub gain_guard: u32,
    /// The torque was at its limit.
    pub saturated: u32,
    /// No finite torque could be computed: 0 was given.
    pub not_finite: u32,
}

/// The direction controllers there are, by the name that configurations use.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum DirectionChoice {
    /// Hierarchical terminal sliding mode as corrected, with disturbance observer ([`htsmc`]).
    #[default]
    Htsmc,
    /// The paper's law as printed, for the whole agent: no observer in either controller ([`htsmc_paper`]).
    HtsmcPaper,
    /// Fuzzy-PID as a cascade, the rival ([`fuzzy_pid`]).
    FuzzyPid,
    /// The paper's single-loop fuzzy-PID ([`fuzzy_pid_single`]).
    FuzzyPidSingle,
}

impl DirectionChoice {
    /// Builds the controller for a robot with the gains of its file.
    ///
    /// # Errors
    /// Gains that cannot be read, or that violate a condition of stability, with the numbers.
    pub fn build(self, robot: &Robot) -> Result<Box<dyn DirectionController + Send>, GainsError> {
        match self {
            Self::Htsmc => Ok(Box::new(htsmc::Htsmc::from_robot(robot)?)),
            Self::HtsmcPaper => Ok(Box::new(htsmc_paper::HtsmcPaper::from_robot(robot)?)),
            Self::FuzzyPid => Ok(Box::new(fuzzy_pid::FuzzyPid::from_robot(robot)?)),
            Self::FuzzyPidSingle => Ok(Box::new(fuzzy_pid_single::FuzzyPidSingle::from_robot(
                robot,
            )?)),
        }
    }

    /// Builds the velocity controller that goes with it: [`hsmc`], without its observer beside [`htsmc_paper`].
    ///
    /// # Errors
    /// Gains that cannot be read, or that violate a condition of stability, with the numbers.
    pub fn build_velocity(self, robot: &Robot) -> Result<Hsmc, GainsError> {
        match self {
            Self::HtsmcPaper => Hsmc::without_observer(robot),
            Self::Htsmc | Self::FuzzyPid | Self::FuzzyPidSingle => Hsmc::from_robot(robot),
        }
    }
}

impl Counters {
    /// Clamps `torque` to ± `torque_max` [N·m] and counts it if it was beyond.
    fn saturate(&mut self, torque: f64, torque_max: f64) -> f64 {
        if torque.abs() >= torque_max {
            self.saturated = self.saturated.saturating_add(1);
        }
        torque.clamp(-torque_max, torque_max)
    }
}

/// Whether a controller can compute with these; the pose is not asked, no law uses it.
fn is_usable(state: &RobotState, setpoint: &Setpoint, dt: f64) -> bool {
    let values = [
        state.v,
        state.q_r,
        state.q_r_rate,
        state.beta,
        state.beta_rate,
        state.alpha,
        state.alpha_rate,
        setpoint.v,
        setpoint.v_rate,
        setpoint.q_r,
        setpoint.q_r_rate,
        setpoint.q_r_accel,
    ];
    values.iter().all(|value| value.is_finite()) && dt.is_finite() && dt > 0.0
}

/// Share of τ_max to which an observer's raw estimate is clamped: 6 N·m for 20 N·m.
const OBSERVER_SHARE_MAX: f64 = 0.3;
