//! From a torque command to the torque at the joints: the motor board, which holds the command while it is valid, and the motors.

use std::collections::VecDeque;

use thiserror::Error;

use sphere_protocol::robot::RobotParams;
use sphere_protocol::state::{BoardStatus, Torque};
use sphere_protocol::time::{BoardClock, Instant, Span};

/// The part of a motor board that receives torque commands and holds the newest.
///
/// A command carries its validity as a length of time from its receipt, so that no clock is shared with the sender. When it has run out the
/// command is zero: whatever happens to agent or link, the motors do not go on.
#[derive(Clone, Debug, Default)]
pub struct MotorBoard {
    powered_off: bool,
    command: Option<Held>,
}

#[derive(Clone, Copy, Debug)]
struct Held {
    torque: Torque,
    received: Instant<BoardClock>,
    valid_for: Span,
}

/// Why the board refused a command. The one before stays in force until its own validity runs out.
#[derive(Clone, Copy, Debug, Error, PartialEq, Eq)]
pub enum CommandError {
    /// A torque that is NaN or infinite.
    #[error("a torque command must be finite")]
    NotFinite,
    /// A validity of zero or less.
    #[error("a torque command must be valid for a time greater than 0")]
    NotValid,
    /// The motors are not powered.
    #[error("the motors are switched off")]
    PowerOff,
}

/// Both motors of one robot, stepped with the plant: torque limit, transport delay, then a first-order lag.
///
/// The two motors share these figures. Friction of the joints is the plant's ([`crate::friction`]).
#[derive(Clone, Debug)]
pub struct Actuator {
    torque_max: f64,
    /// 1 − e^(−dt/lag): share of the way to the command that one step covers [1].
    step_share: f64,
    /// Transport delay [steps].
    delay: usize,
    /// Commands under way, oldest first.
    under_way: VecDeque<Torque>,
    torque: Torque,
}

impl MotorBoard {
    /// A board that holds no command; its motors are powered.
    pub fn new() -> Self {
        Self::default()
    }

    /// Takes a command received at `now`, in place of the one before.
    ///
    /// # Errors
    /// A command that cannot be carried out; the one before stays.
    pub fn receive(
        &mut self,
        now: Instant<BoardClock>,
        torque: Torque,
        valid_for: Span,
    ) -> Result<(), CommandError> {
        if !(torque.pitch.is_finite() && torque.roll.is_finite()) {
            return Err(CommandError::NotFinite);
        }
        if valid_for <= Span::ZERO {
            return Err(CommandError::NotValid);
        }
        if self.powered_off {
            return Err(CommandError::PowerOff);
        }
        self.command = Some(Held {
            torque,
            received: now,
            valid_for,
        });
        Ok(())
    }

    /// Switches the motors. Off forgets the command, and on does not bring it back.
    pub fn switch(&mut self, on: bool) {
        self.powered_off = !on;
        self.command = None;
    }

    /// The torque commanded at `now`: zero without a valid command.
    pub fn torque(&self, now: Instant<BoardClock>) -> Torque {
        self.valid(now)
            .map_or(Torque::default(), |held| held.torque)
    }

    /// What the board reports of itself at `now`, its sensors in order.
    pub fn status(&self, now: Instant<BoardClock>) -> BoardStatus {
        BoardStatus {
            torque_on: !self.powered_off,
            command_valid: self.valid(now).is_some(),
            imu_ok: true,
            encoders_ok: true,
        }
    }

    fn valid(&self, now: Instant<BoardClock>) -> Option<Held> {
        self.command
            .filter(|held| now.since(held.received) < held.valid_for)
    }
}

impl Actuator {
    /// Motors at zero torque, to be stepped every `dt`. The transport delay is rounded to whole steps.
    ///
    /// # Panics
    /// If `dt` is not greater than 0.
    pub fn new(params: &RobotParams, dt: Span) -> Self {
        assert!(dt > Span::ZERO, "a step must take time");
        let dt = dt.as_secs_f64();
        // Without lag the quotient is infinite and the whole way is covered at once.
        let step_share = 1.0 - (-dt / params.motor_lag).exp();
        Self {
            torque_max: params.torque_max,
            step_share,
            delay: (params.motor_delay / dt).round() as usize,
            under_way: VecDeque::new(),
            torque: Torque::default(),
        }
    }

    /// One step under the board's command; returns the torque at the joints, to be held over the plant's step.
    pub fn step(&mut self, command: Torque) -> Torque {
        self.under_way.push_back(command);
        let arrived = if self.under_way.len() > self.delay {
            self.under_way.pop_front()
        } else {
            None
        };
        let target = arrived.unwrap_or_default();
        self.torque.pitch += self.step_share * (self.limited(target.pitch) - self.torque.pitch);
        self.torque.roll += self.step_share * (self.limited(target.roll) - self.torque.roll);
        self.torque
    }

    /// The torque at the joints now.
    pub fn torque(&self) -> Torque {
        self.torque
    }

    fn limited(&self, torque: f64) -> f64 {
        torque.clamp(-self.torque_max, self.torque_max)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use sphere_protocol::robot::Robot;

    const STEP: Span = Span::from_millis(1);

    fn motors(change: impl FnOnce(&mut RobotParams)) -> Actuator {
        let mut params = Robot::embedded("liu")
            .expect("comes with the project")
            .params;
        change(&mut params);
        Actuator::new(&params, STEP)
    }

    #[test]
    fn command_reaches_the_joint_after_delay_and_lag() {
        let mut motors = motors(|_| {});
        let command = Torque {
            pitch: 10.0,
            roll: -4.0,
        };
        for step in 0..20 {
            assert_eq!(motors.step(command), Torque::default(), "step {step}");
        }
        for _ in 0..5 {
            motors.step(command);
        }
        // One time constant of 5 ms after the delay of 20 ms: 1 − 1/e of the way, exactly.
        let share = 1.0 - (-1.0_f64).exp();
        assert!((motors.torque().pitch - 10.0 * share).abs() < 1e-12);
        assert!((motors.torque().roll + 4.0 * share).abs() < 1e-12);
    }

    #[test]
    fn torque_never_exceeds_the_limit() {
        let mut motors = motors(|_| {});
        for _ in 0..1000 {
            let torque = motors.step(Torque {
                pitch: 1e6,
                roll: -21.0,
            });
            assert!(torque.pitch <= 20.0 && torque.roll >= -20.0);
        }
        assert!((motors.torque().pitch - 20.0).abs() < 1e-9);
        assert!((motors.torque().roll + 20.0).abs() < 1e-9);
    }

    #[test]
    fn motors_without_lag_and_delay_follow_at_once() {
        let mut motors = motors(|p| (p.motor_lag, p.motor_delay) = (0.0, 0.0));
        let command = Torque {
            pitch: 3.0,
            roll: -7.0,
        };
        assert_eq!(motors.step(command), command);
        assert_eq!(motors.step(Torque::default()), Torque::default());
    }
}
