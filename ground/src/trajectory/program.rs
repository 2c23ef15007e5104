//! Typed commands: a speed and roll angles by the clock, for direction experiments and for trying a robot out.
//!
//! A robot under a program has no path to be on; nothing is optimised and nothing fed back but by its own torque controllers.

use sphere_protocol::robot::Robot;

use super::MissionError;

/// Speed and roll as functions of the time since the mission's start.
#[derive(Clone, Debug, PartialEq)]
pub enum Program {
    /// Roll angles one after the other; at rest after the last.
    Steps {
        /// Speed [m/s].
        speed: f64,
        /// Roll angles, at least one [rad].
        angles: Vec<f64>,
        /// How long each is held [s].
        hold: f64,
    },
    /// A sine, for ever.
    Sine {
        /// Speed [m/s].
        speed: f64,
        /// Amplitude of the roll [rad].
        amplitude: f64,
        /// Its angular frequency [rad/s].
        rate: f64,
        /// Its phase at the start [rad].
        phase: f64,
    },
}

/// One change of the roll.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Step {
    /// When [s].
    pub at: f64,
    /// Until when the new angle stays [s].
    pub until: f64,
    /// Angle before [rad].
    pub from: f64,
    /// Angle after [rad].
    pub to: f64,
}

impl Program {
    /// This program if `robot` can do it.
    ///
    /// # Errors
    /// A speed or an angle beyond its limits, or a turn too tight for the speed.
    pub(super) fn within_limits(self, robot: &Robot) -> Result<Self, MissionError> {
        let limits = &robot.limits;
        let (speed, angle) = match &self {
            Self::Steps { speed, angles, .. } => {
                (*speed, angles.iter().fold(0.0, |m: f64, a| m.max(a.abs())))
            }
            Self::Sine {
                speed, amplitude, ..
            } => (*speed, amplitude.abs()),
        };
        if speed > limits.v_max {
            return Err(MissionError::TooFast {
                speed_mps: speed,
                v_max: limits.v_max,
            });
        }
        let turn = limits.turn_limit(&robot.params) / (speed * speed).max(f64::MIN_POSITIVE);
        let angle_max = turn.atan().min(limits.q_r_max);
        if angle > angle_max {
            return Err(MissionError::TooFarOver {
                angle_deg: angle.to_degrees(),
                angle_max_deg: angle_max.to_degrees(),
            });
        }
        Ok(self)
    }

    /// What is typed at `t` seconds after the start: speed [m/s] and roll [rad]. Before the start and after the end: rest.
    pub fn command(&self, t: f64) -> [f64; 2] {
        match self {
            Self::Steps {
                speed,
                angles,
                hold,
            } => {
                let step = (t / hold).floor();
                if !(step >= 0.0 && step < angles.len() as f64) {
                    return [0.0, 0.0];
                }
                [*speed, angles[step as usize]]
            }
            Self::Sine {
                speed,
                amplitude,
                rate,
                phase,
            } => [*speed, amplitude * (rate * t + phase).sin()],
        }
    }

    /// Whether it is smooth: played as straight lines between knots, where steps are held over each.
    pub fn is_smooth(&self) -> bool {
        matches!(self, Self::Sine { .. })
    }

    /// When it is over; `None` = never [s].
    pub fn duration(&self) -> Option<f64> {
        match self {
            Self::Steps { angles, hold, .. } => Some(hold * angles.len() as f64),
            Self::Sine { .. } => None,
        }
    }

    /// Its first change of the roll.
    pub fn first_step(&self) -> Option<Step> {
        let Self::Steps { angles, hold, .. } = self else {
            return None;
        };
        let before = |i: usize| if i == 0 { 0.0 } else { angles[i - 1] };
        let i = (0..angles.len()).find(|i| angles[*i] != before(*i))?;
        let lasts = angles[i..].iter().take_while(|angle| **angle == angles[i]);
        Some(Step {
            at: hold * i as f64,
            until: hold * (i + lasts.count()) as f64,
            from: before(i),
            to: angles[i],
        })
    }
}
