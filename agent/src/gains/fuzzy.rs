//! Gains of the two fuzzy-PID controllers: `[fuzzy-pid]` and `[fuzzy-pid-single]`.

use sphere_protocol::quantity::{ANGLE, Field, ONE, Range, read_section};
use sphere_protocol::robot::Robot;

use super::{Condition, GainsError, RATE, Refused, Relation, TIME, gain, refuse_broken};

/// How a fuzzy-PID schedules its gains over the error e = q_rd − q_r and its rate: K = K₀ + K_span f, f from −1 to 1.
///
/// The gains' units are those of the loop: from rad to rad of swing in the cascade, to N·m in the single loop.
#[derive(Clone, Copy, Debug, PartialEq, Default)]
pub struct FuzzySchedule {
    /// Sets of the error per radian [1/rad]: 3 of them are a side.
    pub error_scale: f64,
    /// Sets of the error's rate per radian per second [s/rad].
    pub rate_scale: f64,
    /// Kp₀ [1 or N·m/rad].
    pub kp: f64,
    /// Span of Kp [as Kp].
    pub kp_span: f64,
    /// Ki₀ [1/s or N·m/(rad·s)].
    pub ki: f64,
    /// Span of Ki [as Ki]; where it reaches below zero the gain is zero.
    pub ki_span: f64,
    /// Kd₀ [s or N·m·s/rad].
    pub kd: f64,
    /// Span of Kd [as Kd].
    pub kd_span: f64,
}

/// Gains of the cascaded fuzzy-PID, section `[fuzzy-pid]`.
#[derive(Clone, Copy, Debug, PartialEq, Default)]
pub struct FuzzyPidGains {
    /// From the lean's error to the swing asked of the pendulum.
    pub schedule: FuzzySchedule,
    /// Largest swing asked [rad].
    pub swing_max: f64,
    /// Inner loop, on the swing's error [N·m/rad].
    pub swing_stiffness: f64,
    /// Inner loop, on the swing's rate [N·m·s/rad].
    pub swing_damping: f64,
    /// Share of the pendulum's weight that is carried in advance [1].
    pub gravity_share: f64,
}

/// Gains of the single-loop fuzzy-PID, section `[fuzzy-pid-single]`.
#[derive(Clone, Copy, Debug, PartialEq, Default)]
pub struct FuzzyPidSingleGains {
    /// From the lean's error to the torque.
    pub schedule: FuzzySchedule,
}

impl FuzzyPidGains {
    /// Reads section `[fuzzy-pid]`.
    ///
    /// # Errors
    /// A file without the section; the first gain that is missing, unknown, impossible or in a wrong unit, with its line.
    pub fn read(robot: &Robot) -> Result<Self, GainsError> {
        let mut gains = Self::default();
        let section = GainsError::present(robot, SECTION, &robot.fuzzy_pid)?;
        read_section(&mut gains, SECTION, section, CASCADE, &robot.text)
            .map_err(|error| GainsError::quantity(robot, error))?;
        Ok(gains)
    }

    /// Every condition with its numbers.
    pub fn conditions(&self) -> [Condition; 4] {
        let [kp, kd] = self.schedule.conditions();
        let below = |says, value_of, value, bound_of, bound, unit| {
            Condition::new(
                "range",
                says,
                (value_of, value),
                Relation::Below,
                (bound_of, bound),
                unit,
            )
        };
        [
            kp,
            kd,
            below(
                "the pendulum must not be asked to stand on its head",
                "swing_max",
                self.swing_max,
                "π/2",
                core::f64::consts::FRAC_PI_2,
                "rad",
            ),
            below(
                "a pendulum that is carried whole no longer rights the robot",
                "gravity_share",
                self.gravity_share,
                "1",
                1.0,
                "1",
            ),
        ]
    }

    /// These gains if every condition holds.
    ///
    /// # Errors
    /// All conditions that do not.
    pub fn checked(self) -> Result<Self, Refused> {
        refuse_broken(SECTION, &self.conditions())?;
        Ok(self)
    }
}

impl FuzzyPidSingleGains {
    /// Reads section `[fuzzy-pid-single]`.
    ///
    /// # Errors
    /// A file without the section; the first gain that is missing, unknown, impossible or in a wrong unit, with its line.
    pub fn read(robot: &Robot) -> Result<Self, GainsError> {
        let mut gains = Self::default();
        let section = GainsError::present(robot, SECTION_SINGLE, &robot.fuzzy_pid_single)?;
        read_section(&mut gains, SECTION_SINGLE, section, SINGLE, &robot.text)
            .map_err(|error| GainsError::quantity(robot, error))?;
        Ok(gains)
    }

    /// Every condition with its numbers.
    pub fn conditions(&self) -> [Condition; 2] {
        self.schedule.conditions()
    }

    /// These gains if every condition holds.
    ///
    /// # Errors
    /// All conditions that do not.
    pub fn checked(self) -> Result<Self, Refused> {
        refuse_broken(SECTION_SINGLE, &self.conditions())?;
        Ok(self)
    }
}

impl FuzzySchedule {
    fn conditions(&self) -> [Condition; 2] {
        let spans = |value_of, value, bound_of, bound| {
            Condition::new(
                "range",
                "no rule may turn this gain around",
                (value_of, value),
                Relation::AtLeast,
                (bound_of, bound),
                "its own",
            )
        };
        [
            spans("kp", self.kp, "kp_span", self.kp_span),
            spans("kd", self.kd, "kd_span", self.kd_span),
        ]
    }
}

const SECTION: &str = "fuzzy-pid";
const SECTION_SINGLE: &str = "fuzzy-pid-single";

type Units = &'static [(&'static str, f64)];
const PER_ANGLE: Units = &[("1/rad", 1.0)];
const PER_TURN: Units = &[("s/rad", 1.0)];
const STIFFNESS: Units = &[("N*m/rad", 1.0)];
const STIFFNESS_RATE: Units = &[("N*m/(rad*s)", 1.0)];
const DAMPING: Units = &[("N*m*s/rad", 1.0)];

const CASCADE: &[Field<FuzzyPidGains>] = &[
    gain("error_scale", PER_ANGLE, Range::Positive, |g| {
        &mut g.schedule.error_scale
    }),
    gain("rate_scale", PER_TURN, Range::Positive, |g| {
        &mut g.schedule.rate_scale
    }),
    gain("kp", ONE, Range::Positive, |g| &mut g.schedule.kp),
    gain("kp_span", ONE, Range::NonNegative, |g| {
        &mut g.schedule.kp_span
    }),
    gain("ki", RATE, Range::NonNegative, |g| &mut g.schedule.ki),
    gain("ki_span", RATE, Range::NonNegative, |g| {
        &mut g.schedule.ki_span
    }),
    gain("kd", TIME, Range::NonNegative, |g| &mut g.schedule.kd),
    gain("kd_span", TIME, Range::NonNegative, |g| {
        &mut g.schedule.kd_span
    }),
    gain("swing_max", ANGLE, Range::Positive, |g| &mut g.swing_max),
    gain("swing_stiffness", STIFFNESS, Range::Positive, |g| {
        &mut g.swing_stiffness
    }),
    gain("swing_damping", DAMPING, Range::NonNegative, |g| {
        &mut g.swing_damping
    }),
    gain("gravity_share", ONE, Range::NonNegative, |g| {
        &mut g.gravity_share
    }),
];

const SINGLE: &[Field<FuzzyPidSingleGains>] = &[
    gain("error_scale", PER_ANGLE, Range::Positive, |g| {
        &mut g.schedule.error_scale
    }),
    gain("rate_scale", PER_TURN, Range::Positive, |g| {
        &mut g.schedule.rate_scale
    }),
    gain("kp", STIFFNESS, Range::NonNegative, |g| &mut g.schedule.kp),
    gain("kp_span", STIFFNESS, Range::NonNegative, |g| {
        &mut g.schedule.kp_span
    }),
    gain("ki", STIFFNESS_RATE, Range::NonNegative, |g| {
        &mut g.schedule.ki
    }),
    gain("ki_span", STIFFNESS_RATE, Range::NonNegative, |g| {
        &mut g.schedule.ki_span
    }),
    gain("kd", DAMPING, Range::NonNegative, |g| &mut g.schedule.kd),
    gain("kd_span", DAMPING, Range::NonNegative, |g| {
        &mut g.schedule.kd_span
    }),
];
