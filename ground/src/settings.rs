//! Settings of the planner, as the `[planner]` table of a scenario or station file states them.

use serde::{Deserialize, Serialize};
use sphere_protocol::message::KNOTS_MAX;
use sphere_protocol::time::Span;
use thiserror::Error;

use crate::mpc::Solver;

/// Length of a knot and of a planning tick, Δ [s].
pub const KNOT: f64 = 0.1;

/// How plans are made. In a file every key may be absent; `preset` decides what the others are then.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "SettingsFile", into = "SettingsFile")]
pub struct PlannerSettings {
    /// Where the other settings come from. Default ours.
    pub preset: Preset,
    /// The optimal control problem. Default lag; paper with the preset paper.
    pub mode: PlannerMode,
    /// Knots of 0.1 s, 1 to 64. Default 20; 10 with the preset paper. A longer horizon rides out longer losses of the link.
    pub horizon: usize,
    /// Longest validity of a plan, counted from the telemetry it is based on. A plan never outlives its last knot, so the default of
    /// 5 s leaves the horizon alone to decide; lower it to stop a cut-off robot sooner.
    pub max_age: Span,
    /// What is done about delay. Default full; naive with the preset paper.
    pub compensation: Compensation,
    /// What solves. Default auto.
    pub solver: Solver,
}

/// A set of defaults.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Preset {
    /// This project's planner.
    #[default]
    Ours,
    /// The planner as the paper prints it.
    Paper,
}

/// Which optimal control problem is solved.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum PlannerMode {
    /// The centre by eq (1), with the reference lag that the agent shares.
    Lag,
    /// Eq (20) with eq (2): U(0) is measured, U(1) is applied.
    Paper,
}

/// What is done about the delay between a robot's telemetry and the plan's arrival.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Compensation {
    /// The state is predicted to the plan's start, and the plan carries feedback gains.
    Full,
    /// As full, without the gains.
    NoGains,
    /// None: one command, from the state as telemetry has it, to be held from arrival on. The paper's way.
    Naive,
}

/// Why planner settings were refused.
#[derive(Clone, Copy, Debug, Error, PartialEq)]
pub enum SettingsError {
    /// No or too many knots.
    #[error("horizon = {0}: use 1 to {KNOTS_MAX} knots of 0.1 s")]
    Horizon(usize),
    /// Not a time that a plan can last.
    #[error("max_age_s = {0}: use more than 0 and at most 3600 s")]
    MaxAge(f64),
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct SettingsFile {
    #[serde(default)]
    preset: Preset,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    mode: Option<PlannerMode>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    horizon: Option<usize>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    max_age_s: Option<f64>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    compensation: Option<Compensation>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    solver: Option<SolverName>,
}

#[derive(Clone, Copy, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
enum SolverName {
    Auto,
    Riccati,
    Clarabel,
}

impl PlannerSettings {
    /// The settings of a preset.
    pub fn of(preset: Preset) -> Self {
        let (mode, horizon, compensation) = match preset {
            Preset::Ours => (PlannerMode::Lag, 20, Compensation::Full),
            Preset::Paper => (PlannerMode::Paper, 10, Compensation::Naive),
        };
        Self {
            preset,
            mode,
            horizon,
            max_age: Span::from_millis(5000),
            compensation,
            solver: Solver::Auto,
        }
    }

    /// From the first knot to the end of the last.
    pub fn horizon_length(&self) -> Span {
        Span::from_secs_f64(KNOT * self.horizon as f64)
    }
}

impl Default for PlannerSettings {
    fn default() -> Self {
        Self::of(Preset::Ours)
    }
}

impl TryFrom<SettingsFile> for PlannerSettings {
    type Error = SettingsError;
    fn try_from(file: SettingsFile) -> Result<Self, SettingsError> {
        let preset = Self::of(file.preset);
        let horizon = file.horizon.unwrap_or(preset.horizon);
        if !(1..=KNOTS_MAX).contains(&horizon) {
            return Err(SettingsError::Horizon(horizon));
        }
        let max_age = match file.max_age_s {
            None => preset.max_age,
            Some(s) if s > 0.0 && s <= 3600.0 => Span::from_secs_f64(s),
            Some(s) => return Err(SettingsError::MaxAge(s)),
        };
        Ok(Self {
            mode: file.mode.unwrap_or(preset.mode),
            horizon,
            max_age,
            compensation: file.compensation.unwrap_or(preset.compensation),
            solver: match file.solver {
                None | Some(SolverName::Auto) => Solver::Auto,
                Some(SolverName::Riccati) => Solver::Riccati,
                Some(SolverName::Clarabel) => Solver::Clarabel,
            },
            ..preset
        })
    }
}

impl From<PlannerSettings> for SettingsFile {
    fn from(settings: PlannerSettings) -> Self {
        Self {
            preset: settings.preset,
            mode: Some(settings.mode),
            horizon: Some(settings.horizon),
            max_age_s: Some(settings.max_age.as_secs_f64()),
            compensation: Some(settings.compensation),
            solver: Some(match settings.solver {
                Solver::Auto => SolverName::Auto,
                Solver::Riccati => SolverName::Riccati,
                Solver::Clarabel => SolverName::Clarabel,
            }),
        }
    }
}
