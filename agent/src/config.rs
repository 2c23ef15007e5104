//! What an agent is told at its start.

use sphere_protocol::robot::{Robot, RobotId};
use sphere_protocol::time::Span;

use crate::control::DirectionChoice;
use crate::estimator::EstimatorConfig;

/// Configuration of one agent.
#[derive(Clone, Debug)]
pub struct AgentConfig {
    /// Its name in the fleet.
    pub id: RobotId,
    /// The robot it controls: what it believes of it.
    pub robot: Robot,
    /// Drawn anew at each start; plans for another life are refused.
    pub boot_id: u64,
    /// Where the robot stands at its start, and how good its sensors are.
    pub estimator: EstimatorConfig,
    /// Which direction controller.
    pub direction: DirectionChoice,
    /// Rates and time limits.
    pub timing: Timing,
}

/// Rates and time limits of an agent.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Timing {
    /// Control period; the paper's 50 Hz by default.
    pub control: Span,
    /// Telemetry period, a multiple of `control`.
    pub telemetry: Span,
    /// Status period (a change is reported at once).
    pub status: Span,
    /// Beacon period.
    pub beacon: Span,
    /// How long the motor board may act on a torque command, from receipt.
    pub torque_validity: Span,
    /// Sensor frames older than this make control impossible.
    pub sensor_timeout: Span,
    /// A lease whose station has been silent for this long may be claimed by another. Plans come at 10 Hz: after ten that are
    /// missing the station is taken for dead. Shorter than a horizon, so that a station that is started anew under another
    /// identity has its plans there before the last one of its predecessor has been played.
    pub lease_timeout: Span,
}

impl Default for Timing {
    fn default() -> Self {
        Self {
            control: Span::from_millis(20),
            telemetry: Span::from_millis(40),
            status: Span::from_millis(1000),
            beacon: Span::from_millis(200),
            torque_validity: Span::from_millis(60),
            sensor_timeout: Span::from_millis(100),
            lease_timeout: Span::from_millis(1000),
        }
    }
}
