//! The choices that a scenario makes by name.

use sphere_protocol::document::table::Named;

use crate::network::Distributed;

impl Named for Distributed {
    const WHAT: &'static str = "delay distribution";
    const NAMES: &'static [(&'static str, Self)] =
        &[("normal", Self::Normal), ("log-normal", Self::LogNormal)];
}

/// Declares an enum together with the name of each value in the file.
macro_rules! named {
    ($(#[$doc:meta])* $name:ident, $what:literal { $($(#[$value_doc:meta])* $value:ident = $text:literal,)+ }) => {
        $(#[$doc])*
        #[derive(Clone, Copy, Debug, PartialEq, Eq)]
        pub enum $name { $($(#[$value_doc])* $value,)+ }

        impl Named for $name {
            const WHAT: &'static str = $what;
            const NAMES: &'static [(&'static str, Self)] = &[$(($text, Self::$value),)+];
        }
    };
}

named! {
    /// How kind the world is: it sets defaults that explicit keys override.
    Environment, "environment" {
        /// Exact sensors, no imbalance, motors without lag, delay and friction.
        Ideal = "ideal",
        /// Noise, the motors of the robot file, 0.2 N·m shell imbalance.
        Real = "real",
        /// As `Real` with 2.3 N·m imbalance and 0.5 N·m joint friction: there the paper's plain law shows the paper's steady-state errors.
        Calibrated = "calibrated",
    }
}

named! {
    /// Law of the direction controller.
    RollController, "roll controller" {
        /// Hierarchical terminal sliding mode, with the disturbance observer.
        Htsmc = "htsmc",
        /// The paper's law without observer.
        HtsmcPaper = "htsmc-paper",
        /// Fuzzy-PID as a cascade.
        FuzzyPid = "fuzzy-pid",
        /// The paper's single-loop fuzzy-PID.
        FuzzyPidSingle = "fuzzy-pid-single",
    }
}

named! {
    /// What can go wrong.
    FaultKind, "fault" {
        /// The station stops and starts afresh.
        StationCrash = "station-crash",
        /// An agent stops and starts afresh.
        AgentCrash = "agent-crash",
        /// An agent stands still, then goes on as if nothing had happened.
        Freeze = "freeze",
        /// The station stands still, then goes on as if nothing had happened.
        StationFreeze = "station-freeze",
        /// Old packets are delivered again.
        Replay = "replay",
        /// Packets are held back and delivered late.
        Stale = "stale",
        /// Planning takes far longer than its period.
        SlowPlanner = "slow-planner",
    }
}
