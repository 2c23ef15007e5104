//! What is run: the paper's experiments, the worlds they are run in and the controllers that are compared.

use sphere_protocol::document::table::Named;

use crate::scenario::{Environment, Scenario, ScenarioError};

/// An experiment of the paper's section IV.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Experiment {
    /// One roll angle, at two speeds: Table II, Fig. 4.
    RollStep,
    /// A staircase of roll angles: Table III, Fig. 5.
    RollDiscrete,
    /// The roll as a sine, eq (21): Table III, Fig. 6.
    RollSine,
    /// Eq (22), Fig. 7.
    Line,
    /// Eq (23), Fig. 8.
    Sine,
    /// Eq (24), Fig. 9.
    Lemniscate,
}

/// Who drives.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Controller {
    /// HTSMC with the disturbance observer, as it ships.
    Htsmc,
    /// HTSMC without observer.
    HtsmcPaper,
    /// Fuzzy-PID as a cascade: the strong one.
    FuzzyPid,
    /// The paper's single-loop fuzzy-PID.
    FuzzyPidSingle,
    /// MPC, HSMC and HTSMC, as they ship.
    Mhh,
    /// The same planner and HSMC with the fuzzy-PID cascade.
    Mhf,
    /// The planner as the paper prints it, HSMC, and HTSMC without observer.
    MhhPaper,
}

/// One way to run an experiment; a seed makes it a run.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Case {
    /// Which experiment.
    pub experiment: Experiment,
    /// In which world.
    pub environment: Environment,
    /// Who drives.
    pub controller: Controller,
    /// Typed speed [m/s]; `None` where a path sets it.
    pub velocity: Option<f64>,
}

impl Experiment {
    /// In the order of the paper.
    pub const ALL: [Self; 6] = [
        Self::RollStep,
        Self::RollDiscrete,
        Self::RollSine,
        Self::Line,
        Self::Sine,
        Self::Lemniscate,
    ];

    /// Its name on the command line and in `tables.json`.
    pub const fn name(self) -> &'static str {
        match self {
            Self::RollStep => "roll-step",
            Self::RollDiscrete => "roll-discrete",
            Self::RollSine => "roll-sine",
            Self::Line => "line",
            Self::Sine => "sine",
            Self::Lemniscate => "lemniscate",
        }
    }

    /// Its name in a heading.
    pub const fn title(self) -> &'static str {
        match self {
            Self::RollStep => "Single roll angle",
            Self::RollDiscrete => "Discrete roll angles",
            Self::RollSine => "Roll as a sine",
            Self::Line => "Line",
            Self::Sine => "Sine wave",
            Self::Lemniscate => "Lemniscate of Gerono",
        }
    }

    /// Where the paper has it.
    pub const fn source(self) -> &'static str {
        match self {
            Self::RollStep => "Table II and Fig. 4",
            Self::RollDiscrete => "Table III and Fig. 5",
            Self::RollSine => "Table III and Fig. 6",
            Self::Line => "Fig. 7",
            Self::Sine => "Fig. 8",
            Self::Lemniscate => "Fig. 9",
        }
    }

    /// Whether roll angles are typed; otherwise a path is tracked.
    pub const fn is_direction(self) -> bool {
        matches!(self, Self::RollStep | Self::RollDiscrete | Self::RollSine)
    }

    /// Who is compared.
    pub const fn controllers(self) -> &'static [Controller] {
        if self.is_direction() {
            &[
                Controller::Htsmc,
                Controller::HtsmcPaper,
                Controller::FuzzyPid,
                Controller::FuzzyPidSingle,
            ]
        } else {
            &[Controller::Mhh, Controller::MhhPaper, Controller::Mhf]
        }
    }

    /// The speeds it is run at [m/s].
    pub const fn velocities(self) -> &'static [Option<f64>] {
        match self {
            Self::RollStep => &[Some(0.5), Some(1.0)],
            Self::RollDiscrete | Self::RollSine => &[Some(0.5)],
            Self::Line | Self::Sine | Self::Lemniscate => &[None],
        }
    }

    /// Every way to run it: by speed, then environment, then controller.
    pub fn cases(self) -> impl Iterator<Item = Case> {
        let worlds = |velocity| ENVIRONMENTS.map(|environment| (velocity, environment));
        let drivers = move |(velocity, environment)| {
            self.controllers().iter().map(move |controller| Case {
                experiment: self,
                environment,
                controller: *controller,
                velocity,
            })
        };
        self.velocities()
            .iter()
            .copied()
            .flat_map(worlds)
            .flat_map(drivers)
    }

    /// The scenario file.
    const fn file(self) -> &'static str {
        match self {
            Self::RollStep => include_str!("../../scenarios/roll-step.toml"),
            Self::RollDiscrete => include_str!("../../scenarios/roll-discrete.toml"),
            Self::RollSine => include_str!("../../scenarios/roll-sine.toml"),
            Self::Line => include_str!("../../scenarios/line.toml"),
            Self::Sine => include_str!("../../scenarios/sine.toml"),
            Self::Lemniscate => include_str!("../../scenarios/lemniscate.toml"),
        }
    }
}

impl Controller {
    /// Its name in `tables.json`.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Htsmc => "htsmc",
            Self::HtsmcPaper => "htsmc-paper",
            Self::FuzzyPid => "fuzzy-pid",
            Self::FuzzyPidSingle => "fuzzy-pid-single",
            Self::Mhh => "mhh",
            Self::Mhf => "mhf",
            Self::MhhPaper => "mhh-paper",
        }
    }

    /// Its name for people.
    pub const fn title(self) -> &'static str {
        match self {
            Self::Htsmc => "HTSMC",
            Self::HtsmcPaper => "HTSMC, no observer",
            Self::FuzzyPid => "fuzzy-PID cascade",
            Self::FuzzyPidSingle => "fuzzy-PID, one loop",
            Self::Mhh => "MHH",
            Self::Mhf => "MHF",
            Self::MhhPaper => "MHH, paper's planner",
        }
    }

    /// What it changes in a scenario.
    const fn sets(self) -> &'static [&'static str] {
        match self {
            Self::Htsmc | Self::Mhh => &["robots.0.roll_controller=htsmc"],
            Self::HtsmcPaper => &["robots.0.roll_controller=htsmc-paper"],
            Self::FuzzyPid | Self::Mhf => &["robots.0.roll_controller=fuzzy-pid"],
            Self::FuzzyPidSingle => &["robots.0.roll_controller=fuzzy-pid-single"],
            Self::MhhPaper => &[
                "robots.0.roll_controller=htsmc-paper",
                "planner.preset=paper",
            ],
        }
    }
}

impl Case {
    /// What `--set` makes this case, under `seed`, of the experiment's scenario file. Without `fixes` the robot dead-reckons.
    pub fn sets(&self, seed: u64, fixes: bool) -> Vec<String> {
        let mut sets = vec![
            format!("seed={seed}"),
            format!("environment={}", environment_name(self.environment)),
        ];
        if self.environment == Environment::Ideal {
            // Scenario files state their noise, which an environment does not override.
            sets.push("sensing.noise=0".to_owned());
        }
        if let Some(velocity) = self.velocity {
            sets.push(format!("robots.0.mission.speed_mps={velocity:.1}"));
        }
        if !fixes {
            sets.push("sensing.position_fix_hz=0".to_owned());
        }
        sets.extend(self.controller.sets().iter().map(|set| (*set).to_owned()));
        sets
    }

    /// The command that runs it alone.
    pub fn command(&self, seed: u64, fixes: bool) -> String {
        let sets: String = self
            .sets(seed, fixes)
            .iter()
            .map(|set| format!(" --set {set}"))
            .collect();
        format!(
            "sphere-sim run sim/scenarios/{}.toml{sets}",
            self.experiment.name()
        )
    }

    /// Its scenario under `seed`.
    ///
    /// # Errors
    /// What the simulator refuses.
    pub fn scenario(&self, seed: u64, fixes: bool) -> Result<Scenario, ScenarioError> {
        let file = format!("{}.toml", self.experiment.name());
        let no_files = |path: &str| Err(format!("{path} is not embedded"));
        Scenario::parse(
            &file,
            self.experiment.file(),
            &self.sets(seed, fixes),
            no_files,
        )
    }

    /// Experiment, speed and environment in words.
    pub fn heading(&self) -> String {
        let speed = self
            .velocity
            .map_or_else(String::new, |v| format!(" at {v:.1} m/s"));
        let environment = environment_name(self.environment);
        format!("{}{speed}, {environment}", self.experiment.name())
    }

    /// Whether `other` is the same but for the controller.
    pub fn is_rival(&self, other: &Self) -> bool {
        (self.experiment, self.environment, self.velocity)
            == (other.experiment, other.environment, other.velocity)
    }
}

/// The worlds, kindest first.
pub const ENVIRONMENTS: [Environment; 3] = [
    Environment::Ideal,
    Environment::Real,
    Environment::Calibrated,
];

/// The name of an environment in a scenario file.
pub fn environment_name(environment: Environment) -> &'static str {
    let named = Environment::NAMES
        .iter()
        .find(|(_, value)| *value == environment);
    named.map_or("", |(name, _)| name)
}
