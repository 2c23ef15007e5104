//! The mode machine: what the robot is allowed to do, and why it is in the mode it is in.
//!
//! ```text
//!            converged      checks pass      arm             plan
//!   Boot ───────────► Disarmed ⇄ Ready ─────────► Idle ─────────► Tracking
//!                        ▲                          │ hold          │ no valid plan, hold
//!                        │ disarm (from anywhere)   ▼               ▼
//!                        └─────────────────────── Holding ◄─────────┘
//!                        ├── Failsafe (brakes, holds; latched): a loss on board that leaves control possible
//!                        └── Fault (zero torque; latched): control is impossible
//! ```

use core::fmt;

use sphere_protocol::message::Mode;

use crate::plan::NoPlan;

/// Why the mode machine went where it is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Reason {
    /// The agent has started.
    Started,
    /// The estimator has settled.
    Converged,
    /// Every pre-arm check passes.
    ChecksPass,
    /// A pre-arm check fails.
    CheckFails(Check),
    /// The station, or an operator through it, ordered so.
    Ordered,
    /// A valid plan has begun.
    PlanBegun,
    /// The plan in force ended and none followed.
    PlanEnded(NoPlan),
    /// The lease was released or taken by another station.
    LeaseChanged,
    /// No valid sensor frame for too long.
    SensorsLost,
    /// The IMU or an encoder has failed, by the board's own word or by what it sends.
    SensorFailed,
    /// The accelerometer has failed: attitude holds for a while without it.
    AccelerometerFailed,
    /// The estimator had to start anew, as after a restart of the motor board.
    EstimatorRestarted,
    /// The estimator's state is not finite or its filter diverged.
    EstimatorFailed,
    /// Roll or swing beyond what can be controlled.
    OverTilt,
    /// A torque controller returned no finite torque.
    ControllerFailed,
    /// The program was asked to end.
    Shutdown,
}

/// What must hold before the motors may be powered.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Check {
    /// Sensor frames arrive and are valid.
    SensorsFresh,
    /// IMU and encoders are healthy, by the board's own word and by what they say.
    BoardHealthy,
    /// The estimator has settled.
    EstimatorConverged,
    /// The position is known.
    Localised,
    /// The robot is upright.
    Upright,
}

/// A change of mode, to be reported.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Transition {
    /// Mode left.
    pub from: Mode,
    /// Mode entered.
    pub to: Mode,
    /// Why.
    pub reason: Reason,
}

/// The mode and the reason for it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ModeMachine {
    mode: Mode,
    reason: Reason,
    /// First pre-arm check that failed when they were run last.
    failing: Option<Check>,
    hold_ordered: bool,
}

impl ModeMachine {
    /// Boot.
    pub fn new() -> Self {
        Self {
            mode: Mode::Boot,
            reason: Reason::Started,
            failing: None,
            hold_ordered: false,
        }
    }

    /// The mode.
    pub fn mode(&self) -> Mode {
        self.mode
    }

    /// Why it is in this mode; as long as a check keeps it from being ready, that check.
    pub fn reason(&self) -> Reason {
        match (self.mode, self.failing) {
            (Mode::Boot | Mode::Disarmed, Some(check)) => Reason::CheckFails(check),
            _ => self.reason,
        }
    }

    /// Whether torque may flow at all.
    pub fn is_armed(&self) -> bool {
        matches!(
            self.mode,
            Mode::Idle | Mode::Tracking | Mode::Holding | Mode::Failsafe
        )
    }

    /// Whether plans may be played.
    pub fn accepts_plans(&self) -> bool {
        matches!(self.mode, Mode::Idle | Mode::Tracking)
            || self.mode == Mode::Holding && !self.hold_ordered
    }

    /// The pre-arm checks, run before each control step: `failing` is the first that fails.
    pub fn on_checks(&mut self, failing: Option<Check>) -> Option<Transition> {
        self.failing = failing;
        match (self.mode, failing) {
            (Mode::Boot, Some(Check::EstimatorConverged | Check::SensorsFresh)) => None,
            (Mode::Boot, Some(_)) => self.enter(Mode::Disarmed, Reason::Converged),
            (Mode::Boot | Mode::Disarmed, None) => self.enter(Mode::Ready, Reason::ChecksPass),
            (Mode::Ready, Some(check)) => self.enter(Mode::Disarmed, Reason::CheckFails(check)),
            _ => None,
        }
    }

    /// Order to arm.
    ///
    /// # Errors
    /// The mode that refuses it, unchanged.
    pub fn arm(&mut self) -> Result<Option<Transition>, Mode> {
        match self.mode {
            Mode::Ready => {
                self.hold_ordered = false;
                Ok(self.enter(Mode::Idle, Reason::Ordered))
            }
            Mode::Idle | Mode::Tracking | Mode::Holding => Ok(None),
            refusing => Err(refusing),
        }
    }

    /// Order to disarm: always honoured; also clears a latched failsafe or fault.
    pub fn disarm(&mut self, reason: Reason) -> Option<Transition> {
        self.hold_ordered = false;
        match self.mode {
            Mode::Boot | Mode::Disarmed | Mode::Ready => None,
            _ => self.enter(Mode::Disarmed, reason),
        }
    }

    /// Order to brake and hold until [`ModeMachine::resume`].
    ///
    /// # Errors
    /// The mode that refuses it, unchanged: a robot that is not armed has nothing to hold.
    pub fn hold(&mut self, reason: Reason) -> Result<Option<Transition>, Mode> {
        match self.mode {
            Mode::Idle | Mode::Tracking | Mode::Holding => {
                self.hold_ordered = true;
                Ok(self.enter(Mode::Holding, reason))
            }
            Mode::Failsafe => Ok(None),
            refusing => Err(refusing),
        }
    }

    /// Order to play plans again.
    ///
    /// # Errors
    /// The mode that refuses it, unchanged.
    pub fn resume(&mut self) -> Result<(), Mode> {
        match self.mode {
            Mode::Idle | Mode::Tracking | Mode::Holding => {
                self.hold_ordered = false;
                Ok(())
            }
            refusing => Err(refusing),
        }
    }

    /// A plan commands the robot.
    pub fn on_plan(&mut self) -> Option<Transition> {
        if self.accepts_plans() {
            self.enter(Mode::Tracking, Reason::PlanBegun)
        } else {
            None
        }
    }

    /// No plan commands the robot (any more).
    pub fn on_no_plan(&mut self, reason: Reason) -> Option<Transition> {
        if self.mode == Mode::Tracking {
            self.enter(Mode::Holding, reason)
        } else {
            None
        }
    }

    /// Something on board is lost, control is still possible: brake, hold, latched.
    pub fn failsafe(&mut self, reason: Reason) -> Option<Transition> {
        if self.is_armed() {
            self.enter(Mode::Failsafe, reason)
        } else {
            None
        }
    }

    /// Control is impossible: zero torque, latched.
    pub fn fault(&mut self, reason: Reason) -> Option<Transition> {
        if self.is_armed() {
            self.enter(Mode::Fault, reason)
        } else {
            None
        }
    }

    fn enter(&mut self, to: Mode, reason: Reason) -> Option<Transition> {
        if self.mode == to {
            return None;
        }
        let transition = Transition {
            from: self.mode,
            to,
            reason,
        };
        (self.mode, self.reason) = (to, reason);
        Some(transition)
    }
}

impl Default for ModeMachine {
    fn default() -> Self {
        Self::new()
    }
}

impl fmt::Display for Reason {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Started => "the agent has started",
            Self::Converged => "the estimator has settled",
            Self::ChecksPass => "every pre-arm check passes",
            Self::CheckFails(check) => return write!(f, "pre-arm check: {check}"),
            Self::Ordered => "ordered",
            Self::PlanBegun => "a plan has begun",
            Self::PlanEnded(NoPlan::None) => "no plan",
            Self::PlanEnded(NoPlan::Exhausted) => "the plan's last knot has been played",
            Self::PlanEnded(NoPlan::Expired) => "the plan's validity has ended",
            Self::LeaseChanged => "the lease has changed",
            Self::SensorsLost => "no valid sensor frame for 100 ms",
            Self::SensorFailed => "the IMU or an encoder has failed",
            Self::AccelerometerFailed => "the accelerometer has failed",
            Self::EstimatorRestarted => "the estimator had to start anew",
            Self::EstimatorFailed => "the estimator has no finite state",
            Self::OverTilt => "roll or swing beyond what can be controlled",
            Self::ControllerFailed => "a torque controller returned no finite torque",
            Self::Shutdown => "the program ends",
        })
    }
}

impl fmt::Display for Check {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::SensorsFresh => "no fresh sensor frames",
            Self::BoardHealthy => "the IMU or an encoder has failed",
            Self::EstimatorConverged => "the estimator has not settled (keep the robot still)",
            Self::Localised => "the position is not known",
            Self::Upright => "the robot is not upright",
        })
    }
}
