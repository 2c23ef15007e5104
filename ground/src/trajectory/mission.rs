//! What a robot is asked to do, as scenario files and the command line state it.

use thiserror::Error;

/// One robot's mission: `{ kind = "lemniscate" }`, `{ kind = "circle", radius_m = 3.0, speed_mps = 0.5 }`, ...
///
/// Valid by construction when it comes from a file: speeds and radii are positive and finite, waypoints at least two, each distinct from the one before.
#[derive(Clone, Debug, PartialEq)]
pub enum Mission {
    /// The paper's line.
    Line,
    /// The paper's sine wave.
    Sine,
    /// The paper's lemniscate of Gerono.
    Lemniscate,
    /// A circle about the world's origin, counter-clockwise.
    Circle {
        /// Radius [m].
        radius_m: f64,
        /// Speed [m/s].
        speed_mps: f64,
    },
    /// Straight from point to point, corners rounded, at rest at both ends.
    Waypoints {
        /// The points (x, y) [m].
        points_m: Vec<[f64; 2]>,
        /// Speed between the ramps at both ends [m/s].
        speed_mps: f64,
    },
    /// A direction experiment: typed roll angles one after the other, without a path.
    Roll {
        /// Speed [m/s].
        speed_mps: f64,
        /// The angles, at least one [°].
        angles_deg: Vec<f64>,
        /// How long each is held [s].
        hold_s: f64,
    },
    /// A direction experiment: the roll as a sine of time, without a path, eq (21).
    RollSine {
        /// Speed [m/s].
        speed_mps: f64,
        /// Amplitude [°].
        amplitude_deg: f64,
        /// Angular frequency [rad/s].
        rate_radps: f64,
        /// Phase at the start [rad].
        phase_rad: f64,
    },
    /// Stay at rest where the robot is.
    Hold,
}

/// Why a mission cannot be.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum MissionError {
    /// A value that must be positive and finite.
    #[error("mission `{kind}`: {key} = {value} must be positive")]
    NotPositive {
        /// The mission's kind.
        kind: &'static str,
        /// Which value.
        key: &'static str,
        /// The value.
        value: f64,
    },
    /// A value that must be a number.
    #[error("mission `{kind}`: {key} is not a finite number of the kind it must be: correct it")]
    NotPossible {
        /// The mission's kind.
        kind: &'static str,
        /// Which value.
        key: &'static str,
    },
    /// More roll than the robot may have at this speed.
    #[error(
        "a roll of {angle_deg:.1}° is above the {angle_max_deg:.1}° that this robot may have at this speed: lower it, or the speed"
    )]
    TooFarOver {
        /// The mission's largest angle [°].
        angle_deg: f64,
        /// The largest possible one [°].
        angle_max_deg: f64,
    },
    /// Too few waypoints.
    #[error("mission `waypoints` has {0} points: it needs at least 2")]
    TooFewPoints(usize),
    /// A waypoint that is not a finite number.
    #[error("mission `waypoints`: points_m[{0}] is not finite")]
    NotFinite(usize),
    /// Two waypoints in the same place.
    #[error("mission `waypoints`: points_m[{0}] repeats the point before it: remove one")]
    Repeated(usize),
    /// A point that no turn of the robot reaches from the corner before it.
    #[error(
        "mission `waypoints`: points_m[{0}] is too close behind a sharp corner: move or remove it"
    )]
    TooClose(usize),
    /// Faster than the robot may go.
    #[error("speed_mps = {speed_mps} is above the robot's v_max = {v_max} m/s: lower it")]
    TooFast {
        /// The mission's speed [m/s].
        speed_mps: f64,
        /// The robot's limit [m/s].
        v_max: f64,
    },
    /// A tighter turn than the robot may make.
    #[error(
        "radius_m = {radius_m} is tighter than this robot can turn at this speed: use {radius_min:.2} m or more, or go slower"
    )]
    TooTight {
        /// The mission's radius [m].
        radius_m: f64,
        /// The smallest possible radius [m].
        radius_min: f64,
    },
}

impl Mission {
    /// This mission if a robot can have it.
    ///
    /// # Errors
    /// The first value that is impossible.
    pub fn validated(self) -> Result<Self, MissionError> {
        let positive = |kind, key, value: f64| {
            if value.is_finite() && value > 0.0 {
                Ok(())
            } else {
                Err(MissionError::NotPositive { kind, key, value })
            }
        };
        let finite = |kind, key, is_possible: bool| {
            if is_possible {
                Ok(())
            } else {
                Err(MissionError::NotPossible { kind, key })
            }
        };
        match &self {
            Self::Line | Self::Sine | Self::Lemniscate | Self::Hold => {}
            Self::Circle {
                radius_m,
                speed_mps,
            } => {
                positive("circle", "radius_m", *radius_m)?;
                positive("circle", "speed_mps", *speed_mps)?;
            }
            Self::Roll {
                speed_mps,
                angles_deg,
                hold_s,
            } => {
                finite(
                    "roll",
                    "speed_mps",
                    *speed_mps >= 0.0 && speed_mps.is_finite(),
                )?;
                positive("roll", "hold_s", *hold_s)?;
                let is_list = !angles_deg.is_empty() && angles_deg.iter().all(|a| a.is_finite());
                finite("roll", "angles_deg", is_list)?;
            }
            Self::RollSine {
                speed_mps,
                amplitude_deg,
                rate_radps,
                phase_rad,
            } => {
                finite(
                    "roll-sine",
                    "speed_mps",
                    *speed_mps >= 0.0 && speed_mps.is_finite(),
                )?;
                positive("roll-sine", "rate_radps", *rate_radps)?;
                finite("roll-sine", "amplitude_deg", amplitude_deg.is_finite())?;
                finite("roll-sine", "phase_rad", phase_rad.is_finite())?;
            }
            Self::Waypoints {
                points_m,
                speed_mps,
            } => {
                positive("waypoints", "speed_mps", *speed_mps)?;
                if points_m.len() < 2 {
                    return Err(MissionError::TooFewPoints(points_m.len()));
                }
                if let Some(i) = points_m
                    .iter()
                    .position(|p| !p.iter().all(|c| c.is_finite()))
                {
                    return Err(MissionError::NotFinite(i));
                }
                if let Some(i) = points_m.windows(2).position(|pair| {
                    (pair[1][0] - pair[0][0]).hypot(pair[1][1] - pair[0][1]) < POINTS_APART
                }) {
                    return Err(MissionError::Repeated(i + 1));
                }
            }
        }
        Ok(self)
    }

    /// What files and tables call it.
    pub fn kind(&self) -> &'static str {
        match self {
            Self::Line => "line",
            Self::Sine => "sine",
            Self::Lemniscate => "lemniscate",
            Self::Circle { .. } => "circle",
            Self::Waypoints { .. } => "waypoints",
            Self::Roll { .. } => "roll",
            Self::RollSine { .. } => "roll-sine",
            Self::Hold => "hold",
        }
    }
}

/// Waypoints nearer to each other than this are the same [m].
const POINTS_APART: f64 = 1e-3;
