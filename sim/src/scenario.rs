//! Scenarios: what happens in one run, as a TOML file states it.
//!
//! A [`Scenario`] holds exactly what the file says, every default filled in, in the file's own units, which end each name (`_ms`,
//! `_deg`); methods give SI. So [`Scenario::drawn`] writes a file that reads back equal and replays the run. Reading touches
//! no files: the caller passes the texts.
//!
//! ```
//! use sphere_ground::trajectory::Mission;
//! use sphere_sim::scenario::Scenario;
//!
//! let text = "environment = 'calibrated'\n[[robots]]\nid = 'r1'\nmission = { kind = 'sine' }";
//! let no_files = |path: &str| Err(format!("no file {path}"));
//! let scenario = Scenario::parse("demo.toml", text, &["network.delay_ms=200".to_owned()], no_files)?;
//! assert_eq!(scenario.network.up.delay().as_secs_f64(), 0.2);
//! assert_eq!(scenario.robots[0].plant.coulomb, 0.5);
//! assert_eq!(scenario.robots[0].mission, Mission::Sine);
//! # Ok::<(), sphere_sim::scenario::ScenarioError>(())
//! ```

mod drawn;
mod names;
mod read;
mod robots;

use std::collections::BTreeMap;

use sphere_ground::settings::PlannerSettings;
use sphere_ground::trajectory::Mission;
use sphere_protocol::robot::{Robot, RobotId, RobotParams};
use sphere_protocol::time::Span;

pub use crate::disturbance::Patch;
pub use crate::network::Distributed;
pub use names::{Environment, FaultKind, RollController};
pub use sphere_protocol::document::error::{DocumentError as ScenarioError, Place, Problem};

/// One run: the world, the network, the station's settings and the robots with their missions.
#[derive(Clone, Debug, PartialEq)]
pub struct Scenario {
    /// Seed of every random stream of the run. Default 1.
    pub seed: u64,
    /// Length of the run [s]. Default 60.
    pub duration_s: f64,
    /// How kind the world is; sets defaults of sensing, disturbance and actuators. Default real.
    pub environment: Environment,
    /// The links between robots and station.
    pub network: Network,
    /// What goes wrong, and when.
    pub faults: Vec<Fault>,
    /// Quality of the sensors.
    pub sensing: Sensing,
    /// How the run is measured.
    pub metrics: MetricsSetup,
    /// Settings of the station's planner.
    pub planner: PlannerSettings,
    /// The computer that the station runs on.
    pub station: StationComputer,
    /// The robots, at least one, in the order of the file.
    pub robots: Vec<RobotSetup>,
}

/// Both directions of every robot's link, and when they are cut.
#[derive(Clone, Debug, PartialEq)]
pub struct Network {
    /// Robot to station.
    pub up: Link,
    /// Station to robot.
    pub down: Link,
    /// Times without any link.
    pub partition: Vec<Partition>,
}

/// One direction of a link.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Link {
    /// Mean one-way delay [ms]. Default 0.
    pub delay_ms: f64,
    /// Standard deviation of the delay, truncated at 0 [ms]; packets may overtake each other. Default 0.
    pub jitter_ms: f64,
    /// How delays are distributed about their mean. Default normal.
    pub distribution: Distributed,
    /// How packets are lost.
    pub loss: Loss,
    /// Probability that a packet arrives twice [1]. Default 0.
    pub duplicate: f64,
    /// Capacity [kbit/s]; 0 = unlimited. Default 0.
    pub bandwidth_kbps: f64,
    /// Longest wait in the queue before the bottleneck; what would wait longer is lost [ms]. Default 500.
    pub queue_ms: f64,
}

/// How packets of one direction are lost.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Loss {
    /// Each by itself with this probability [1]. Default 0.
    Independent(f64),
    /// A process in time that all packets of the direction share: good and bad states of exponential length.
    Burst {
        /// Mean length of the bad state [s].
        mean_bad_s: f64,
        /// Mean length of the good state, in which nothing is lost [s].
        mean_good_s: f64,
        /// Probability of loss in the bad state [1].
        loss_bad: f64,
    },
}

/// A time without link in either direction.
#[derive(Clone, Debug, PartialEq)]
pub struct Partition {
    /// Beginning [s].
    pub from_s: f64,
    /// End [s].
    pub to_s: f64,
    /// Whose link is cut; empty = everybody's.
    pub robots: Vec<RobotId>,
}

/// Something that goes wrong for a time.
#[derive(Clone, Debug, PartialEq)]
pub struct Fault {
    /// What.
    pub kind: FaultKind,
    /// Beginning [s].
    pub at_s: f64,
    /// Length [s].
    pub for_s: f64,
    /// Whose agent or link is concerned; empty = everybody's.
    pub robots: Vec<RobotId>,
}

/// The computer that the station runs on.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct StationComputer {
    /// Time for a converged plan [µs]; the station then plans for its robots one after the other, and on less where that takes too long.
    /// Default 0: it is always in time.
    pub plan_time_us: f64,
}

/// Quality of the sensors.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sensing {
    /// Factor on every sensor's noise [1]. Default 1, in `ideal` 0.
    pub noise: f64,
    /// Rate of position fixes from outside [Hz]; 0 = dead reckoning alone. Default 10.
    pub position_fix_hz: f64,
    /// Standard deviation of each axis of a fix at `noise = 1` [m]. Default 0.02.
    pub position_fix_noise_m: f64,
}

/// How the run is measured.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MetricsSetup {
    /// Time from the start of a mission after which the plain metrics begin [s]. Default 10.
    pub settle_s: f64,
}

/// One robot of a scenario.
#[derive(Clone, Debug, PartialEq)]
pub struct RobotSetup {
    /// Its name.
    pub id: RobotId,
    /// What agent and station believe it to be. Default liu.
    pub model: RobotModel,
    /// Factors by which the truth differs from `model`, by parameter. Default none.
    pub plant_scale: BTreeMap<String, f64>,
    /// The true parameters: those of `model`, with the actuators of the environment, scaled.
    pub plant: RobotParams,
    /// Where it stands at first.
    pub start: Start,
    /// What its clocks show at the start of the run [s]. Default 0.
    pub clock_offset_s: f64,
    /// By how much its clocks run fast [1e-6]. Default 0.
    pub clock_drift_ppm: f64,
    /// Time between two of its telemetry messages, a multiple of its control period of 20 ms [ms]. Default 40.
    pub telemetry_ms: i64,
    /// Law of its direction controller. Default htsmc.
    pub roll_controller: RollController,
    /// What pushes it about.
    pub disturbance: Disturbance,
    /// What it is to do. Default hold.
    pub mission: Mission,
}

/// A robot file together with the name under which the scenario refers to it.
#[derive(Clone, Debug)]
pub struct RobotModel {
    /// `robot = ...` as [`Scenario::drawn`] writes it: an embedded robot's name, or a file beside the scenario.
    pub reference: String,
    /// The file's contents.
    pub robot: Robot,
}

/// Where a robot stands at first, at rest.
#[derive(Clone, Copy, Debug, PartialEq, Default)]
pub struct Start {
    /// World X of its centre [m]. Default 0.
    pub x_m: f64,
    /// World Y of its centre [m]. Default 0.
    pub y_m: f64,
    /// Heading φ, positive to the left [°]. Default 0.
    pub heading_deg: f64,
}

/// What pushes a robot about.
#[derive(Clone, Debug, PartialEq)]
pub struct Disturbance {
    /// Amplitude of the shell's imbalance, a torque at its rolling frequency [N·m]. Default by environment: 0, 0.2, 2.3.
    pub imbalance_nm: f64,
    /// Turns of that torque for each turn of the shell [1]. Default 1.
    pub imbalance_harmonic: f64,
    /// Standard deviation of a random torque on the roll and on the rolling motion [N·m]. Default 0.
    pub random_nm: f64,
    /// Its correlation time [s]. Default 0.3.
    pub random_correlation_s: f64,
    /// By how much sticking joints exceed their Coulomb friction at rest [N·m]. Default 0.
    pub stiction_nm: f64,
    /// Rise of the floor along world X and Y [°]. Default level.
    pub slope_deg: [f64; 2],
    /// Floor of other rolling resistance; where patches overlap the last one counts.
    pub patches: Vec<Patch>,
    /// Pushes, each a constant torque for a time.
    pub pushes: Vec<Push>,
}

/// A constant torque for a time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Push {
    /// Beginning [s].
    pub at_s: f64,
    /// Torque on the sphere about its rolling axis to the left, > 0 rolls it left [N·m].
    pub roll_nm: f64,
    /// Torque on the rolling motion, > 0 drives it forward [N·m]. Default 0.
    pub pitch_nm: f64,
    /// Length [s].
    pub for_s: f64,
}

impl Scenario {
    /// Reads the scenario `text`, with the `--set` arguments `sets` (`path.to.key=value`) in force.
    ///
    /// `file` is how messages name it. `load` gives the text of a robot file named in it, or a sentence why not.
    ///
    /// # Errors
    /// The first key that is unknown, missing, of a wrong type, out of its range, or not possible yet, with its place and remedy.
    pub fn parse(
        file: &str,
        text: &str,
        sets: &[String],
        load: impl FnMut(&str) -> Result<String, String>,
    ) -> Result<Self, ScenarioError> {
        read::scenario(text, sets, load).map_err(|refusal| refusal.in_file(file))
    }

    /// This scenario as TOML, every default written out: [`Scenario::parse`] reads it back equal, given [`Scenario::robot_files`].
    pub fn drawn(&self) -> String {
        drawn::scenario(self)
    }

    /// Name and text of each robot file that [`Scenario::drawn`] refers to; they belong beside it.
    pub fn robot_files(&self) -> BTreeMap<&str, &str> {
        let models = self.robots.iter().map(|setup| &setup.model);
        models
            .filter(|model| robots::is_file(&model.reference))
            .map(|model| (model.reference.as_str(), model.robot.text.as_str()))
            .collect()
    }

    /// Length of the run.
    pub fn duration(&self) -> Span {
        Span::from_secs_f64(self.duration_s)
    }
}

impl Link {
    /// Mean one-way delay.
    pub fn delay(&self) -> Span {
        Span::from_secs_f64(self.delay_ms * 1e-3)
    }

    /// Standard deviation of the delay.
    pub fn jitter(&self) -> Span {
        Span::from_secs_f64(self.jitter_ms * 1e-3)
    }
}

impl Default for Link {
    fn default() -> Self {
        Self {
            delay_ms: 0.0,
            jitter_ms: 0.0,
            distribution: Distributed::Normal,
            loss: Loss::Independent(0.0),
            duplicate: 0.0,
            bandwidth_kbps: 0.0,
            queue_ms: QUEUE_MS,
        }
    }
}

impl Sensing {
    /// Time between two position fixes; `None` without any.
    pub fn fix_period(&self) -> Option<Span> {
        (self.position_fix_hz > 0.0).then(|| Span::from_secs_f64(1.0 / self.position_fix_hz))
    }

    /// Standard deviation of each axis of a position fix, with `noise` applied [m].
    pub fn position_fix_sigma(&self) -> f64 {
        self.noise * self.position_fix_noise_m
    }
}

impl Start {
    /// Heading φ [rad].
    pub fn heading(&self) -> f64 {
        self.heading_deg.to_radians()
    }
}

impl PartialEq for RobotModel {
    /// The same file under the same name: what is read from it follows.
    fn eq(&self, other: &Self) -> bool {
        self.reference == other.reference && self.robot.text == other.robot.text
    }
}

/// A queue of this length [ms] is what common routers keep; without a bandwidth it never fills.
const QUEUE_MS: f64 = 500.0;
