//! Gains of the torque controllers, as the robot file states them, and the conditions that they must meet.
//!
//! The paper asks for A > B > 0 and proves S → 0 only, eqs (18)-(19). Neither makes the robot stand: A/B has an upper bound that
//! depends on the robot (E2), and the motion *on* S = 0 is stable only if the pendulum's surface is the faster one (E3, E4).
//! With q = −(B/A) β (s + λ₂)/(s + λ₁) on the surface and the torque-free row (d − c) q̈ + (c − a) β̈ = G β − K q, Routh's table gives
//! exactly: P > Q and λ₂ > λ₁, where P = (B/A)(d − c), Q = c − a, λᵢ = aᵢ + cᵢ |eᵢ|^(γ−1). A set that violates a condition is refused
//! with the numbers; [`HtsmcGains::conditions`] and [`HsmcGains::conditions`] give the whole table.

mod condition;
mod fuzzy;

use sphere_protocol::quantity::{
    ANGLE, Field, ONE, QuantityError, Range, Section, TIME, read_section,
};
use sphere_protocol::robot::Robot;
use thiserror::Error;

pub use condition::{Condition, Relation};
pub use fuzzy::{FuzzyPidGains, FuzzyPidSingleGains, FuzzySchedule};

use condition::{integral_max, ratio_lower, ratio_upper};

use crate::control::sliding::sig_slope_max;
use crate::model::NominalModel;

/// Gains of the direction controller, section `[htsmc]`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HtsmcGains {
    /// A, weight of the control surface S₁ (lean) [1].
    pub a: f64,
    /// B, weight of the stability surface S₂ (pendulum) [1].
    pub b: f64,
    /// a₁, linear term of S₁ [1/s].
    pub a1: f64,
    /// c₁, terminal term of S₁ [rad^(1−γ)/s].
    pub c1: f64,
    /// a₂, linear term of S₂ [1/s].
    pub a2: f64,
    /// c₂, terminal term of S₂ [rad^(1−γ)/s].
    pub c2: f64,
    /// γ = p/q of both terminal terms [1].
    pub gamma: f64,
    /// k of the reaching law [1/s].
    pub k: f64,
    /// ε of the reaching law [rad/s²].
    pub epsilon: f64,
    /// Φ, boundary layer of the reaching law [rad/s].
    pub phi: f64,
    /// μ, error below which the terminal terms are regular [rad].
    pub mu: f64,
    /// k_i, integral in S₁ (E10) [1/s²].
    pub k_i: f64,
    /// w_ref, bandwidth of the filter for typed roll steps [rad/s].
    pub w_ref: f64,
    /// L, bandwidth of the disturbance observer [1/s]; 0 switches it off.
    pub observer: f64,
    /// o, bandwidth of its constant and shell-frequency parts [1/s]; 0 switches it off.
    pub oscillator: f64,
    /// o_h, bandwidth of its oscillator at h times the shell's frequency [1/s]. Default 0, which switches that one off.
    pub harmonic: f64,
    /// γ, how fast it finds h [1/s]. Default 0: it stays where it starts.
    pub harmonic_search: f64,
    /// λ, bandwidth of its remainder [1/s]. Default 0, which switches that one off.
    pub remainder: f64,
    /// ρ, share of the remainder that the law believes [1]. Default 0.
    pub remainder_share: f64,
}

/// Gains of the velocity controller, section `[hsmc]`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HsmcGains {
    /// A, weight of the speed surface [1].
    pub a: f64,
    /// B, weight of the pendulum surface [1].
    pub b: f64,
    /// a₁, integral term of the speed surface [1/s].
    pub a1: f64,
    /// a₂, linear term of the pendulum surface [1/s].
    pub a2: f64,
    /// k of the reaching law [1/s].
    pub k: f64,
    /// ε of the reaching law [rad/s²].
    pub epsilon: f64,
    /// Φ, boundary layer of the reaching law [rad/s].
    pub phi: f64,
    /// L, bandwidth of the disturbance observer [1/s]; 0 switches it off.
    pub observer: f64,
    /// o, bandwidth of its constant and shell-frequency parts [1/s]; 0 switches it off.
    pub oscillator: f64,
    /// o_h, bandwidth of its oscillator at h times the shell's frequency [1/s]. Default 0, which switches that one off.
    pub harmonic: f64,
    /// γ, how fast it finds h [1/s]. Default 0: it stays where it starts.
    pub harmonic_search: f64,
    /// λ, bandwidth of its remainder [1/s]. Default 0, which switches that one off.
    pub remainder: f64,
    /// ρ, share of the remainder that the law believes [1]. Default 0.
    pub remainder_share: f64,
}

/// Gains that this robot cannot be controlled with.
#[derive(Clone, Debug, Error, PartialEq)]
#[error("[{section}] is refused: {}", list(broken))]
pub struct Refused {
    /// Section of the robot file.
    pub section: &'static str,
    /// Every condition that does not hold, at least one.
    pub broken: Vec<Condition>,
}

/// Why a controller cannot be built from a robot file.
#[derive(Debug, Error, PartialEq)]
pub enum GainsError {
    /// The file lacks the section of the controller that is asked for.
    #[error(
        "{name}: there is no section [{section}], which the direction controller `{section}` needs: copy it from the robot `liu`, or choose another controller"
    )]
    NoSection {
        /// The robot file.
        name: String,
        /// The section, named like the controller.
        section: &'static str,
    },
    /// A gain is missing, unknown, impossible or in a wrong unit.
    #[error("{name}: {error}")]
    Quantity {
        /// The robot file.
        name: String,
        /// Which, and the remedy.
        error: QuantityError,
    },
    /// The gains violate a condition of stability.
    #[error("{name}: {error}")]
    Refused {
        /// The robot file.
        name: String,
        /// Which, with the numbers.
        error: Refused,
    },
}

impl HtsmcGains {
    /// Reads section `[htsmc]`. It is not checked here, so that a set that does not hold can be shown: `Htsmc::new` does.
    ///
    /// # Errors
    /// The first gain that is missing, unknown, impossible or in a wrong unit, with its line.
    pub fn read(robot: &Robot) -> Result<Self, GainsError> {
        let mut gains = Self::BLANK;
        read_section(&mut gains, "htsmc", &robot.htsmc, HTSMC, &robot.text)
            .map_err(|error| GainsError::quantity(robot, error))?;
        Ok(gains)
    }

    /// Every condition with the numbers of this robot, for β = 0, where c and with it E2 are worst.
    pub fn conditions(&self, model: &NominalModel) -> [Condition; 6] {
        let inertia = model.roll_inertia(0.0);
        let terminal_max = sig_slope_max(self.gamma, self.mu);
        let lambda1 = [self.a1 + self.c1, self.a1 + self.c1 * terminal_max];
        let lambda2 = [self.a2 + self.c2, self.a2 + self.c2 * terminal_max];
        // The terminal terms make λ₁, λ₂ anything between their values far from the surface and on it: all four corners count.
        let k_i_max = lambda1
            .iter()
            .flat_map(|l1| {
                lambda2.map(|l2| integral_max(self.a / self.b, *l1, l2, &inertia, model))
            })
            .fold(f64::INFINITY, f64::min);
        [
            ratio_lower(self.a / self.b),
            ratio_upper(self.a / self.b, &inertia),
            Condition::new(
                "E3",
                "on S = 0 the pendulum's surface must be the faster one, here at errors of 1 rad: otherwise the robot falls over",
                ("λ₂ = a₂ + c₂", lambda2[0]),
                Relation::Above,
                ("λ₁ = a₁ + c₁", lambda1[0]),
                "1/s",
            ),
            Condition::new(
                "E4",
                "and near e = 0, where the terminal term makes the lean's surface fastest",
                ("a₂", self.a2),
                Relation::AtLeast,
                ("a₁ + c₁ (2 − γ) μ^(γ−1)", lambda1[1]),
                "1/s",
            ),
            Condition::new(
                "E5",
                "the terminal terms need 0 < p < q",
                ("γ = p/q", self.gamma),
                Relation::Below,
                ("1", 1.0),
                "1",
            ),
            Condition::new(
                "E10",
                "the integral must leave the motion on S = 0 stable",
                ("k_i", self.k_i),
                Relation::Below,
                ("G λ₁ (λ₂ − λ₁)/(λ₂ (P λ₂ − Q λ₁))", k_i_max),
                "1/s^2",
            ),
        ]
    }

    /// These gains if every condition holds.
    ///
    /// # Errors
    /// All conditions that do not.
    pub fn checked(self, model: &NominalModel) -> Result<Self, Refused> {
        refuse_broken("htsmc", &self.conditions(model))?;
        Ok(self)
    }

    const BLANK: Self = Self {
        a: 0.0,
        b: 0.0,
        a1: 0.0,
        c1: 0.0,
        a2: 0.0,
        c2: 0.0,
        gamma: 0.0,
        k: 0.0,
        epsilon: 0.0,
        phi: 0.0,
        mu: 0.0,
        k_i: 0.0,
        w_ref: 0.0,
        observer: 0.0,
        oscillator: 0.0,
        harmonic: 0.0,
        harmonic_search: 0.0,
        remainder: 0.0,
        remainder_share: 0.0,
    };
}

impl HsmcGains {
    /// Reads section `[hsmc]`. It is not checked here, so that a set that does not hold can be shown: `Hsmc::new` does.
    ///
    /// # Errors
    /// The first gain that is missing, unknown, impossible or in a wrong unit, with its line.
    pub fn read(robot: &Robot) -> Result<Self, GainsError> {
        let mut gains = Self::BLANK;
        read_section(&mut gains, "hsmc", &robot.hsmc, HSMC, &robot.text)
            .map_err(|error| GainsError::quantity(robot, error))?;
        Ok(gains)
    }

    /// Every condition with the numbers of this robot, for α = 0, where c and with it E2 are worst.
    pub fn conditions(&self, model: &NominalModel) -> [Condition; 3] {
        [
            ratio_lower(self.a / self.b),
            ratio_upper(self.a / self.b, &model.pitch_inertia(0.0)),
            Condition::new(
                "E3",
                "on S = 0 the pendulum's surface must be the faster one: otherwise the robot runs away",
                ("a₂", self.a2),
                Relation::Above,
                ("a₁", self.a1),
                "1/s",
            ),
        ]
    }

    /// These gains if every condition holds.
    ///
    /// # Errors
    /// All conditions that do not.
    pub fn checked(self, model: &NominalModel) -> Result<Self, Refused> {
        refuse_broken("hsmc", &self.conditions(model))?;
        Ok(self)
    }

    const BLANK: Self = Self {
        a: 0.0,
        b: 0.0,
        a1: 0.0,
        a2: 0.0,
        k: 0.0,
        epsilon: 0.0,
        phi: 0.0,
        observer: 0.0,
        oscillator: 0.0,
        harmonic: 0.0,
        harmonic_search: 0.0,
        remainder: 0.0,
        remainder_share: 0.0,
    };
}

impl GainsError {
    fn quantity(robot: &Robot, error: QuantityError) -> Self {
        Self::Quantity {
            name: robot.name.clone(),
            error,
        }
    }

    /// `section` of the robot's file, which may be left out where its controller is not asked for.
    fn present<'a>(
        robot: &Robot,
        name: &'static str,
        section: &'a Section,
    ) -> Result<&'a Section, Self> {
        if section.is_empty() {
            return Err(Self::NoSection {
                name: robot.name.clone(),
                section: name,
            });
        }
        Ok(section)
    }

    pub(crate) fn refused(robot: &Robot, error: Refused) -> Self {
        Self::Refused {
            name: robot.name.clone(),
            error,
        }
    }
}

fn refuse_broken(section: &'static str, conditions: &[Condition]) -> Result<(), Refused> {
    let broken: Vec<_> = conditions.iter().filter(|c| !c.holds).copied().collect();
    if broken.is_empty() {
        Ok(())
    } else {
        Err(Refused { section, broken })
    }
}

fn list(conditions: &[Condition]) -> String {
    let lines: Vec<_> = conditions.iter().map(Condition::to_string).collect();
    lines.join("; ")
}

const RATE: &[(&str, f64)] = &[("1/s", 1.0)];
const RATE2: &[(&str, f64)] = &[("1/s^2", 1.0)];
const TURN: &[(&str, f64)] = &[("rad/s", 1.0), ("deg/s", core::f64::consts::PI / 180.0)];
const TURN2: &[(&str, f64)] = &[("rad/s^2", 1.0)];

const fn gain<T>(
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

/// A gain ≥ 0 that switches something off where the file does not have it.
const fn optional<T>(
    key: &'static str,
    units: &'static [(&'static str, f64)],
    at: fn(&mut T) -> &mut f64,
) -> Field<T> {
    Field {
        default: Some(0.0),
        ..gain(key, units, Range::NonNegative, at)
    }
}

const HTSMC: &[Field<HtsmcGains>] = &[
    gain("a", ONE, Range::Positive, |g| &mut g.a),
    gain("b", ONE, Range::Positive, |g| &mut g.b),
    gain("a1", RATE, Range::Positive, |g| &mut g.a1),
    gain("c1", ONE, Range::NonNegative, |g| &mut g.c1),
    gain("a2", RATE, Range::Positive, |g| &mut g.a2),
    gain("c2", ONE, Range::NonNegative, |g| &mut g.c2),
    gain("gamma", ONE, Range::Positive, |g| &mut g.gamma),
    gain("k", RATE, Range::Positive, |g| &mut g.k),
    gain("epsilon", TURN2, Range::NonNegative, |g| &mut g.epsilon),
    gain("phi", TURN, Range::Positive, |g| &mut g.phi),
    gain("mu", ANGLE, Range::Positive, |g| &mut g.mu),
    gain("k_i", RATE2, Range::NonNegative, |g| &mut g.k_i),
    gain("w_ref", TURN, Range::Positive, |g| &mut g.w_ref),
    gain("observer", RATE, Range::NonNegative, |g| &mut g.observer),
    gain("oscillator", RATE, Range::NonNegative, |g| {
        &mut g.oscillator
    }),
    optional("harmonic", RATE, |g| &mut g.harmonic),
    optional("harmonic_search", RATE, |g| &mut g.harmonic_search),
    optional("remainder", RATE, |g| &mut g.remainder),
    optional("remainder_share", ONE, |g| &mut g.remainder_share),
];

const HSMC: &[Field<HsmcGains>] = &[
    gain("a", ONE, Range::Positive, |g| &mut g.a),
    gain("b", ONE, Range::Positive, |g| &mut g.b),
    gain("a1", RATE, Range::NonNegative, |g| &mut g.a1),
    gain("a2", RATE, Range::Positive, |g| &mut g.a2),
    gain("k", RATE, Range::Positive, |g| &mut g.k),
    gain("epsilon", TURN2, Range::NonNegative, |g| &mut g.epsilon),
    gain("phi", TURN, Range::Positive, |g| &mut g.phi),
    gain("observer", RATE, Range::NonNegative, |g| &mut g.observer),
    gain("oscillator", RATE, Range::NonNegative, |g| {
        &mut g.oscillator
    }),
    optional("harmonic", RATE, |g| &mut g.harmonic),
    optional("harmonic_search", RATE, |g| &mut g.harmonic_search),
    optional("remainder", RATE, |g| &mut g.remainder),
    optional("remainder_share", ONE, |g| &mut g.remainder_share),
];
