//! What a robot is asked to do, as scenario files and the command line state it.

use serde::{Deserialize, Serialize};
use thiserror::Error;

/// One robot's mission: `{ kind = "lemniscate" }`, `{ kind = "circle", radius_m = 3.0, speed_mps = 0.5 }`, ...
///
/// Valid by construction when it comes from a file: speeds and radii are positive and finite, waypoints at least two, each distinct from the one before.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "MissionFile", into = "MissionFile")]
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
    /// Stay at rest where the robot is.
    Hold,
}

/// Why a mission cannot be.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum MissionError {
    /// A key that this kind of mission needs.
    #[error("mission `{kind}` needs `{key}`")]
    Missing {
        /// The mission's kind.
        kind: &'static str,
        /// The missing key.
        key: &'static str,
    },
    /// A key that means nothing for this kind of mission.
    #[error("mission `{kind}` has no `{key}`: remove it")]
    Surplus {
        /// The mission's kind.
        kind: &'static str,
        /// The surplus key.
        key: &'static str,
    },
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

/// A mission as a file has it, before validation.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct MissionFile {
    kind: Kind,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    radius_m: Option<f64>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    speed_mps: Option<f64>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    points_m: Option<Vec<[f64; 2]>>,
}

#[derive(Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
enum Kind {
    Line,
    Sine,
    Lemniscate,
    Circle,
    Waypoints,
    Hold,
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
        match &self {
            Self::Line | Self::Sine | Self::Lemniscate | Self::Hold => {}
            Self::Circle {
                radius_m,
                speed_mps,
            } => {
                positive("circle", "radius_m", *radius_m)?;
                positive("circle", "speed_mps", *speed_mps)?;
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
}

impl TryFrom<MissionFile> for Mission {
    type Error = MissionError;
    fn try_from(file: MissionFile) -> Result<Self, MissionError> {
        let kind = file.kind.name();
        let surplus = |key, present| {
            if present {
                Err(MissionError::Surplus { kind, key })
            } else {
                Ok(())
            }
        };
        let need = |key, value: Option<f64>| value.ok_or(MissionError::Missing { kind, key });
        if file.kind != Kind::Circle {
            surplus("radius_m", file.radius_m.is_some())?;
        }
        if file.kind != Kind::Waypoints {
            surplus("points_m", file.points_m.is_some())?;
        }
        if !matches!(file.kind, Kind::Circle | Kind::Waypoints) {
            surplus("speed_mps", file.speed_mps.is_some())?;
        }
        match file.kind {
            Kind::Line => Self::Line,
            Kind::Sine => Self::Sine,
            Kind::Lemniscate => Self::Lemniscate,
            Kind::Hold => Self::Hold,
            Kind::Circle => Self::Circle {
                radius_m: need("radius_m", file.radius_m)?,
                speed_mps: need("speed_mps", file.speed_mps)?,
            },
            Kind::Waypoints => Self::Waypoints {
                points_m: file.points_m.ok_or(MissionError::Missing {
                    kind,
                    key: "points_m",
                })?,
                speed_mps: need("speed_mps", file.speed_mps)?,
            },
        }
        .validated()
    }
}

impl From<Mission> for MissionFile {
    fn from(mission: Mission) -> Self {
        let bare = |kind| Self {
            kind,
            radius_m: None,
            speed_mps: None,
            points_m: None,
        };
        match mission {
            Mission::Line => bare(Kind::Line),
            Mission::Sine => bare(Kind::Sine),
            Mission::Lemniscate => bare(Kind::Lemniscate),
            Mission::Hold => bare(Kind::Hold),
            Mission::Circle {
                radius_m,
                speed_mps,
            } => Self {
                radius_m: Some(radius_m),
                speed_mps: Some(speed_mps),
                ..bare(Kind::Circle)
            },
            Mission::Waypoints {
                points_m,
                speed_mps,
            } => Self {
                points_m: Some(points_m),
                speed_mps: Some(speed_mps),
                ..bare(Kind::Waypoints)
            },
        }
    }
}

impl Kind {
    fn name(self) -> &'static str {
        match self {
            Self::Line => "line",
            Self::Sine => "sine",
            Self::Lemniscate => "lemniscate",
            Self::Circle => "circle",
            Self::Waypoints => "waypoints",
            Self::Hold => "hold",
        }
    }
}

/// Waypoints nearer to each other than this are the same [m].
const POINTS_APART: f64 = 1e-3;
