//! One robot as its file describes it: identity, physical parameters (Table I of the paper) and limits.

use core::fmt;
use core::str::FromStr;

use arrayvec::ArrayString;
use serde::Deserialize;
use thiserror::Error;

use crate::quantity::{
    ANGLE, Field, LENGTH, ONE, QuantityError, Range, Section, TIME, read_section,
};

/// The name of one robot: 1 to 32 of `A-Z a-z 0-9 - _ .`.
///
/// It is a chunk of a Zenoh key, where `$ * # ? /` are wild or forbidden: such a name cannot be built.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct RobotId(ArrayString<32>);

/// Why a text is no [`RobotId`].
#[derive(Debug, Error, PartialEq, Eq)]
pub enum RobotIdError {
    /// Nothing there.
    #[error("a robot id must not be empty")]
    Empty,
    /// Longer than 32 bytes.
    #[error("robot id `{0}` is longer than 32 characters")]
    TooLong(String),
    /// A character that could be wild in a key.
    #[error("robot id `{id}` contains `{character}`: use letters, digits, `-`, `_` and `.` only")]
    Character {
        /// The refused text.
        id: String,
        /// Its first refused character.
        character: char,
    },
}

/// Physical parameters of one robot [SI]. Valid by construction: see [`Robot::parse`] and [`RobotParams::validated`].
///
/// Inertias of the pendulum (`j_*`) are about its *own* centre of mass, so that each field can be changed on its own; the
/// paper's I_mr and I_mp about the sphere's centre follow by the parallel-axis theorem ([`RobotParams::i_mr`]).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RobotParams {
    /// Mass of the pendulum, m [kg].
    pub m: f64,
    /// Mass of the frame, m_f [kg].
    pub m_f: f64,
    /// Mass of the shell, m_s [kg].
    pub m_s: f64,
    /// Radius of the sphere, R [m].
    pub r: f64,
    /// Distance from the sphere's centre to the pendulum's centre of mass, l [m].
    pub l: f64,
    /// Inertia of the shell about any axis through its centre, I_s = I_sp = I_sr [kg·m²].
    pub i_s: f64,
    /// Inertia of the pendulum about its fore-aft axis, through its own centre of mass [kg·m²].
    pub j_mr: f64,
    /// Inertia of the pendulum about its lateral axis, through its own centre of mass [kg·m²].
    pub j_mp: f64,
    /// Inertia of the pendulum about its long axis, through its own centre of mass [kg·m²].
    pub j_mu: f64,
    /// Inertia of the frame in roll, I_fr [kg·m²].
    pub i_fr: f64,
    /// Inertia of the frame in pitch, I_fp [kg·m²].
    pub i_fp: f64,
    /// Inertia of the frame in yaw, I_fu [kg·m²].
    pub i_fu: f64,
    /// Viscous damping of each joint, ζ [N·m·s/rad].
    pub zeta: f64,
    /// Rolling resistance coefficient, c_rr [1].
    pub c_rr: f64,
    /// Speed over which rolling resistance reaches tanh(1) of its value [m/s].
    pub v_rr: f64,
    /// Gravity, g [m/s²].
    pub g: f64,
    /// Largest torque of each motor, τ_max [N·m].
    pub torque_max: f64,
    /// Time constant of the first-order lag of each motor [s].
    pub motor_lag: f64,
    /// Transport delay from a command's arrival at the board to the motor [s].
    pub motor_delay: f64,
    /// Coulomb friction of each joint [N·m].
    pub coulomb: f64,
}

/// What the robot is allowed to do [SI].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Limits {
    /// Lowest commanded speed (< 0: reverse) [m/s].
    pub v_min: f64,
    /// Highest commanded speed [m/s].
    pub v_max: f64,
    /// Largest commanded roll [rad].
    pub q_r_max: f64,
    /// Largest share of the pendulum's righting moment that a steady turn may take [1]; see [`Limits::turn_limit`].
    pub turn_share: f64,
    /// Slew of the speed reference on board [m/s²].
    pub slew: f64,
    /// Deceleration while braking to rest [m/s²].
    pub brake: f64,
    /// Lag τ_v = τ_q by which the reference on board follows the commands [s]. Chosen, not identified: planner and agent share it.
    pub reference_lag: f64,
}

/// A robot file: parameters, limits, and the sections that other members read (gains: the agent).
#[derive(Clone, Debug)]
pub struct Robot {
    /// Name of the file without its ending, for messages.
    pub name: String,
    /// Physical parameters.
    pub params: RobotParams,
    /// Limits.
    pub limits: Limits,
    /// Gains of the direction controller, as the file states them.
    pub htsmc: Section,
    /// Gains of the velocity controller, as the file states them.
    pub hsmc: Section,
    /// Gains of the direction controller `fuzzy-pid`, as the file states them; empty if it does not.
    pub fuzzy_pid: Section,
    /// Gains of the direction controller `fuzzy-pid-single`, as the file states them; empty if it does not.
    pub fuzzy_pid_single: Section,
    /// The file's text, for messages about these sections.
    pub text: String,
}

/// Why a robot file was refused.
#[derive(Debug, Error)]
pub enum RobotError {
    /// Not TOML, an unknown section, a value of the wrong type.
    #[error("{name}: {error}")]
    Syntax {
        /// The file.
        name: String,
        /// What the TOML reader says, with line and column.
        error: Box<toml::de::Error>,
    },
    /// A value that is missing, unknown, impossible, or in a wrong unit.
    #[error("{name}: {error}")]
    Quantity {
        /// The file.
        name: String,
        /// Which, and the remedy.
        error: QuantityError,
    },
    /// Values that do not fit together.
    #[error("{name}: {why}")]
    Inconsistent {
        /// The file.
        name: String,
        /// Which, and the remedy.
        why: String,
    },
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RobotFile {
    params: Section,
    limits: Section,
    #[serde(default)]
    htsmc: Section,
    #[serde(default)]
    hsmc: Section,
    #[serde(default, rename = "fuzzy-pid")]
    fuzzy_pid: Section,
    #[serde(default, rename = "fuzzy-pid-single")]
    fuzzy_pid_single: Section,
}

impl RobotId {
    /// The id as text.
    pub fn as_str(&self) -> &str {
        &self.0
    }
}

impl FromStr for RobotId {
    type Err = RobotIdError;
    fn from_str(id: &str) -> Result<Self, RobotIdError> {
        if id.is_empty() {
            return Err(RobotIdError::Empty);
        }
        if let Some(character) = id
            .chars()
            .find(|c| !(c.is_ascii_alphanumeric() || matches!(c, '-' | '_' | '.')))
        {
            return Err(RobotIdError::Character {
                id: id.to_owned(),
                character,
            });
        }
        ArrayString::from(id)
            .map(Self)
            .map_err(|_| RobotIdError::TooLong(id.to_owned()))
    }
}

impl fmt::Display for RobotId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(&self.0)
    }
}

impl fmt::Debug for RobotId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        fmt::Display::fmt(self, f)
    }
}

impl Robot {
    /// The robots that come with the project, by name: `liu`.
    pub fn embedded(name: &str) -> Option<Self> {
        let text = EMBEDDED.iter().find(|(known, _)| *known == name)?.1;
        Some(
            Self::parse(name, text).expect("embedded robot files are valid: a test reads each one"),
        )
    }

    /// Names of the robots that come with the project.
    pub fn embedded_names() -> impl Iterator<Item = &'static str> {
        EMBEDDED.iter().map(|(name, _)| *name)
    }

    /// Reads a robot file. `name` appears in messages.
    ///
    /// # Errors
    /// The first value that is missing, unknown, impossible or in a wrong unit, with its line and the remedy.
    pub fn parse(name: &str, text: &str) -> Result<Self, RobotError> {
        let file: RobotFile = toml::from_str(text).map_err(|error| RobotError::Syntax {
            name: name.to_owned(),
            error: Box::new(error),
        })?;
        let quantity = |error| RobotError::Quantity {
            name: name.to_owned(),
            error,
        };
        let (mut params, mut limits) = (RobotParams::BLANK, Limits::BLANK);
        read_section(&mut params, "params", &file.params, PARAMS, text).map_err(quantity)?;
        read_section(&mut limits, "limits", &file.limits, LIMITS, text).map_err(quantity)?;
        let inconsistent = |why| RobotError::Inconsistent {
            name: name.to_owned(),
            why,
        };
        let params = params.validated().map_err(inconsistent)?;
        if limits.v_min > 0.0 || limits.v_min >= limits.v_max {
            return Err(inconsistent(format!(
                "v_min = {} must be ≤ 0 and below v_max = {}",
                limits.v_min, limits.v_max
            )));
        }
        if limits.q_r_max >= 0.6 || limits.turn_share >= 1.0 {
            return Err(inconsistent(format!(
                "q_r_max = {:.3} rad must be below 0.6 rad, turn_share = {} below 1",
                limits.q_r_max, limits.turn_share
            )));
        }
        Ok(Self {
            name: name.to_owned(),
            params,
            limits,
            htsmc: file.htsmc,
            hsmc: file.hsmc,
            fuzzy_pid: file.fuzzy_pid,
            fuzzy_pid_single: file.fuzzy_pid_single,
            text: text.to_owned(),
        })
    }
}

impl RobotParams {
    const BLANK: Self = Self {
        m: 0.0,
        m_f: 0.0,
        m_s: 0.0,
        r: 0.0,
        l: 0.0,
        i_s: 0.0,
        j_mr: 0.0,
        j_mp: 0.0,
        j_mu: 0.0,
        i_fr: 0.0,
        i_fp: 0.0,
        i_fu: 0.0,
        zeta: 0.0,
        c_rr: 0.0,
        v_rr: 0.0,
        g: 0.0,
        torque_max: 0.0,
        motor_lag: 0.0,
        motor_delay: 0.0,
        coulomb: 0.0,
    };

    /// These parameters if a robot can have them.
    ///
    /// # Errors
    /// A sentence naming the values that do not fit together.
    pub fn validated(mut self) -> Result<Self, String> {
        for field in PARAMS {
            let value = *(field.at)(&mut self);
            if !field.range.contains(value) {
                return Err(format!(
                    "{} = {value} {} is impossible",
                    field.key, field.units[0].0
                ));
            }
        }
        if self.l >= self.r {
            return Err(format!(
                "l = {} m: the pendulum must hang inside the sphere, r = {} m",
                self.l, self.r
            ));
        }
        Ok(self)
    }

    /// Multiplies the parameter `key` by `factor`: the one a scenario names in `plant = { scale = { key = factor } }`.
    ///
    /// # Errors
    /// A sentence naming the nearest known key.
    pub fn scale(&mut self, key: &str, factor: f64) -> Result<(), String> {
        let field = PARAMS
            .iter()
            .find(|field| field.key == key)
            .ok_or_else(|| {
                format!(
                    "no robot parameter `{key}`{}",
                    crate::quantity::nearest(key, PARAMS.iter().map(|f| f.key))
                )
            })?;
        *(field.at)(self) *= factor;
        Ok(())
    }

    /// Total mass M [kg].
    pub fn total_mass(&self) -> f64 {
        self.m + self.m_f + self.m_s
    }

    /// Inertia of the pendulum in roll about the sphere's centre, I_mr [kg·m²].
    pub fn i_mr(&self) -> f64 {
        self.m * self.l * self.l + self.j_mr
    }

    /// Inertia of the pendulum in pitch about the sphere's centre, I_mp [kg·m²].
    pub fn i_mp(&self) -> f64 {
        self.m * self.l * self.l + self.j_mp
    }
}

impl Limits {
    const BLANK: Self = Self {
        v_min: 0.0,
        v_max: 0.0,
        q_r_max: 0.0,
        turn_share: 0.0,
        slew: 0.0,
        brake: 0.0,
        reference_lag: 0.0,
    };

    /// Largest tan|q_r| v² of a setpoint: `turn_share` · m g l / (M + I_s/R² − m l/R) [m²/s²]; beyond 1 no pendulum angle holds the turn.
    pub fn turn_limit(&self, p: &RobotParams) -> f64 {
        self.turn_share * p.m * p.g * p.l / (p.total_mass() + p.i_s / (p.r * p.r) - p.m * p.l / p.r)
    }
}

const EMBEDDED: &[(&str, &str)] = &[("liu", include_str!("../robots/liu.toml"))];

const MASS: &[(&str, f64)] = &[("kg", 1.0), ("g", 1e-3)];
const INERTIA: &[(&str, f64)] = &[("kg*m^2", 1.0)];
const TORQUE: &[(&str, f64)] = &[("N*m", 1.0)];
const SPEED: &[(&str, f64)] = &[("m/s", 1.0)];
const ACCEL: &[(&str, f64)] = &[("m/s^2", 1.0)];

const fn field<T>(
    key: &'static str,
    units: &'static [(&'static str, f64)],
    range: Range,
    at: fn(&mut T) -> &mut f64,
) -> Field<T> {
    Field {
        key,
        units,
        at,
        range,
        default: None,
    }
}

const PARAMS: &[Field<RobotParams>] = &[
    field("m", MASS, Range::Positive, |p| &mut p.m),
    field("m_f", MASS, Range::Positive, |p| &mut p.m_f),
    field("m_s", MASS, Range::Positive, |p| &mut p.m_s),
    field("r", LENGTH, Range::Positive, |p| &mut p.r),
    field("l", LENGTH, Range::Positive, |p| &mut p.l),
    field("i_s", INERTIA, Range::Positive, |p| &mut p.i_s),
    field("j_mr", INERTIA, Range::Positive, |p| &mut p.j_mr),
    field("j_mp", INERTIA, Range::Positive, |p| &mut p.j_mp),
    field("j_mu", INERTIA, Range::Positive, |p| &mut p.j_mu),
    field("i_fr", INERTIA, Range::Positive, |p| &mut p.i_fr),
    field("i_fp", INERTIA, Range::Positive, |p| &mut p.i_fp),
    field("i_fu", INERTIA, Range::Positive, |p| &mut p.i_fu),
    field("zeta", &[("N*m*s/rad", 1.0)], Range::NonNegative, |p| {
        &mut p.zeta
    }),
    field("c_rr", ONE, Range::NonNegative, |p| &mut p.c_rr),
    field("v_rr", SPEED, Range::Positive, |p| &mut p.v_rr),
    field("g", ACCEL, Range::Positive, |p| &mut p.g),
    field("torque_max", TORQUE, Range::Positive, |p| &mut p.torque_max),
    field("motor_lag", TIME, Range::NonNegative, |p| &mut p.motor_lag),
    field("motor_delay", TIME, Range::NonNegative, |p| {
        &mut p.motor_delay
    }),
    field("coulomb", TORQUE, Range::NonNegative, |p| &mut p.coulomb),
];

const LIMITS: &[Field<Limits>] = &[
    field("v_min", SPEED, Range::Finite, |l| &mut l.v_min),
    field("v_max", SPEED, Range::Positive, |l| &mut l.v_max),
    field("q_r_max", ANGLE, Range::Positive, |l| &mut l.q_r_max),
    field("turn_share", ONE, Range::Positive, |l| &mut l.turn_share),
    field("slew", ACCEL, Range::Positive, |l| &mut l.slew),
    field("brake", ACCEL, Range::Positive, |l| &mut l.brake),
    field("reference_lag", TIME, Range::Positive, |l| {
        &mut l.reference_lag
    }),
];
