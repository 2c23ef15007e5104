//! The indicators of `tables.json`: names, units, what they are of, and the numbers that the paper prints.

use super::experiment::{Case, Controller, Experiment};

/// An indicator of `tables.json`, in its order there.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
#[allow(missing_docs, reason = "`Indicator::definition` says each")]
pub enum Indicator {
    RiseTime,
    SettlingTime,
    MeanError,
    RmseSteady,
    BoundLow,
    BoundHigh,
    Mae,
    Rmse,
    PositionRmse,
    PositionAllRmse,
    PositionMax,
    HeadingRmse,
    LeanRmse,
    TimeToFound,
    TorqueVariation,
}

/// What is known of an indicator.
struct About {
    name: &'static str,
    label: &'static str,
    words: &'static str,
    definition: &'static str,
}

impl Indicator {
    /// In the order of `tables.json`.
    pub const ALL: [Self; 15] = [
        Self::RiseTime,
        Self::SettlingTime,
        Self::MeanError,
        Self::RmseSteady,
        Self::BoundLow,
        Self::BoundHigh,
        Self::Mae,
        Self::Rmse,
        Self::PositionRmse,
        Self::PositionAllRmse,
        Self::PositionMax,
        Self::HeadingRmse,
        Self::LeanRmse,
        Self::TimeToFound,
        Self::TorqueVariation,
    ];

    /// Its name in `tables.json`, which ends in its unit.
    pub const fn name(self) -> &'static str {
        self.about().name
    }

    /// Its name in a narrow table, with its unit.
    pub const fn label(self) -> &'static str {
        self.about().label
    }

    /// Its name in a sentence.
    pub const fn words(self) -> &'static str {
        self.about().words
    }

    /// What it is.
    pub const fn definition(self) -> &'static str {
        self.about().definition
    }

    /// Whether it is of this experiment.
    pub const fn applies(self, experiment: Experiment) -> bool {
        match self {
            Self::RiseTime
            | Self::SettlingTime
            | Self::MeanError
            | Self::RmseSteady
            | Self::BoundLow
            | Self::BoundHigh => matches!(experiment, Experiment::RollStep),
            Self::Mae | Self::Rmse => experiment.is_direction(),
            Self::PositionRmse
            | Self::PositionAllRmse
            | Self::PositionMax
            | Self::HeadingRmse
            | Self::LeanRmse
            | Self::TimeToFound => !experiment.is_direction(),
            Self::TorqueVariation => true,
        }
    }

    /// Whether less of it, in magnitude, is better: the signed mean says nothing of that.
    pub const fn is_quality(self) -> bool {
        !matches!(self, Self::MeanError)
    }

    /// Whether a lost run counts as the lowest instead of the highest.
    pub(super) const fn is_worst_low(self) -> bool {
        matches!(self, Self::BoundLow)
    }

    /// The factor from its unit to the one of [`Indicator::label`].
    pub(super) const fn shown(self) -> f64 {
        match self {
            Self::PositionRmse | Self::PositionAllRmse | Self::PositionMax => 1e3,
            _ => 1.0,
        }
    }

    /// What the paper prints for it, of hardware, in its unit: by the kind of controller, whichever variant of it `case` has. Angles
    /// whose header says m/s are degrees (E14).
    #[allow(clippy::approx_constant, reason = "6.28° is no 2π")]
    pub fn printed(self, case: &Case) -> Option<f64> {
        let kind = match case.controller {
            Controller::Htsmc | Controller::HtsmcPaper => 0,
            Controller::FuzzyPid | Controller::FuzzyPidSingle => 1,
            Controller::Mhh | Controller::Mhf | Controller::MhhPaper => return None,
        };
        // Of HTSMC, then of fuzzy-PID.
        let both = match (case.experiment, case.velocity) {
            // Table II.
            (Experiment::RollStep, Some(0.5)) => match self {
                Self::RiseTime => [0.54, 8.51],
                Self::SettlingTime => [1.61, 6.86],
                Self::MeanError => [-0.358, -0.351],
                Self::RmseSteady => [1.727, 2.097],
                Self::BoundLow => [-3.59, -6.28],
                Self::BoundHigh => [3.38, 4.61],
                _ => return None,
            },
            (Experiment::RollStep, Some(1.0)) => match self {
                Self::RiseTime => [0.54, 3.41],
                Self::SettlingTime => [2.68, 3.66],
                Self::MeanError => [-0.097, -0.172],
                Self::RmseSteady => [1.509, 2.5373],
                Self::BoundLow => [-3.88, -5.968],
                Self::BoundHigh => [3.39, 5.32],
                _ => return None,
            },
            // Table III.
            (Experiment::RollDiscrete, _) => match self {
                Self::Mae => [1.852, 3.191],
                Self::Rmse => [2.511, 4.128],
                _ => return None,
            },
            (Experiment::RollSine, _) => match self {
                Self::Mae => [1.631, 2.115],
                Self::Rmse => [2.082, 2.600],
                _ => return None,
            },
            _ => return None,
        };
        Some(both[kind])
    }

    const fn about(self) -> About {
        let (name, label, words, definition) = match self {
            Self::RiseTime => (
                "rise_time_s",
                "t_r s",
                "rise time",
                "from the step to the first time that the true roll reaches its new value, as the paper counts; a response that creeps up to it from below may never have one",
            ),
            Self::SettlingTime => (
                "settling_time_s",
                "t_s s",
                "settling time",
                "from the step to the time from which the true roll stays within ±1° of its new value until that changes",
            ),
            Self::MeanError => (
                "mean_error_deg",
                "e_m °",
                "mean error",
                "mean of the roll error with its sign, from the step to the end; no measure of quality",
            ),
            Self::RmseSteady => (
                "rmse_steady_deg",
                "e_rmse st °",
                "steady RMSE",
                "root mean square of the roll error from 5 s after the step to the end",
            ),
            Self::BoundLow => (
                "bound_low_deg",
                "Δh low °",
                "Δh below",
                "lowest roll error from 5 s after the step to the end",
            ),
            Self::BoundHigh => (
                "bound_high_deg",
                "Δh high °",
                "Δh above",
                "highest roll error from 5 s after the step to the end",
            ),
            Self::Mae => (
                "mae_deg",
                "e_mae °",
                "mean absolute error",
                "mean absolute roll error from the mission's start to its end",
            ),
            Self::Rmse => (
                "rmse_deg",
                "e_rmse °",
                "RMSE of the whole",
                "root mean square of the roll error from the mission's start to its end",
            ),
            Self::PositionRmse => (
                "position_rmse_m",
                "RMSE mm",
                "position RMSE",
                "root mean square distance of the true centre from the reference, from 10 s after the mission's start",
            ),
            Self::PositionAllRmse => (
                "position_all_rmse_m",
                "RMSE all mm",
                "position RMSE with the approach",
                "the same from the mission's start, the approach included",
            ),
            Self::PositionMax => (
                "position_max_m",
                "max mm",
                "largest distance",
                "largest distance from the reference, from 10 s after the mission's start",
            ),
            Self::HeadingRmse => (
                "heading_rmse_deg",
                "heading °",
                "heading",
                "root mean square of true minus reference heading, from 10 s after the mission's start",
            ),
            Self::LeanRmse => (
                "lean_rmse_deg",
                "lean °",
                "lean",
                "root mean square of the true roll minus the one that belongs to the reference path at that time, from 10 s after the mission's start",
            ),
            Self::TimeToFound => (
                "time_to_0p1_m_s",
                "to 0.1 m s",
                "time to 0.1 m",
                "from the mission's start to the time from which the distance stays below 0.1 m",
            ),
            Self::TorqueVariation => (
                "torque_variation_nm_per_s",
                "Σ|Δτ| N·m/s",
                "torque variation",
                "total variation of the commanded roll torque for each second: of direction experiments from the mission's start to its end, of trajectories from 10 s after the mission's start",
            ),
        };
        About {
            name,
            label,
            words,
            definition,
        }
    }
}
