//! Closed-loop instances: the problems that a planner solves while a robot drives, one a tick of 0.1 s, recorded from whole virtual runs.
//!
//! The robot, its sensors' noise, the estimator, the network and the station are those of `sim/scenarios` with seed 1 in the environment
//! `real`, so that every recording is the same. What a solver is timed on is thus what it meets: states as they are estimated,
//! references from where the robot stands, and the approach (2 m beside the line; 45° off the others) as well as the tracking.
//!
//! | trajectory | length | problems |
//! |---|---|---|
//! | line | 40 s | 391 |
//! | sine | 50 s | 491 |
//! | lemniscate | 110 s | 1091 |
//!
//! Of each, 20 to 50 have an input on a bound, in the approach.
//! The bounds are met by the first input, and by some after it. The turn limit never narrows the bound of the
//! roll: at 1 m/s, the robot's fastest, it allows more than 20°. `tests/instances.rs` holds this table to what is recorded.

#![allow(
    dead_code,
    unreachable_pub,
    reason = "each program that includes this file uses its own part"
)]

use std::path::Path;

use sphere_ground::mpc::Problem;
use sphere_ground::planner::Planner;
use sphere_protocol::time::Span;
use sphere_sim::output::read_scenario;
use sphere_sim::world::World;

/// The trajectories of section IV-B.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Trajectory {
    /// Eq (22).
    Line,
    /// Eq (23).
    Sine,
    /// Eq (24).
    Lemniscate,
}

impl Trajectory {
    /// All of them, in the paper's order.
    pub const ALL: [Self; 3] = [Self::Line, Self::Sine, Self::Lemniscate];

    /// Its name, and that of its scenario.
    pub fn name(self) -> &'static str {
        match self {
            Self::Line => "line",
            Self::Sine => "sine",
            Self::Lemniscate => "lemniscate",
        }
    }

    /// How long it is driven [s].
    fn length(self) -> f64 {
        match self {
            Self::Line => 40.0,
            Self::Sine => 50.0,
            Self::Lemniscate => 110.0,
        }
    }
}

/// The paper's eq (20), N = 10, as a robot driven by it (`[planner] preset = "paper"`) poses it.
pub fn paper(trajectory: Trajectory) -> Vec<Problem<3>> {
    record(
        trajectory,
        &["planner.preset=\"paper\"".to_owned()],
        Planner::paper_problem,
    )
}

/// The formulation that ships, with `horizon` knots.
pub fn lag(trajectory: Trajectory, horizon: usize) -> Vec<Problem<5>> {
    record(
        trajectory,
        &[format!("planner.horizon={horizon}")],
        Planner::lag_problem,
    )
}

fn record<const NX: usize>(
    trajectory: Trajectory,
    changes: &[String],
    problem: impl Fn(&Planner) -> Option<&Problem<NX>>,
) -> Vec<Problem<NX>> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR"))
        .ancestors()
        .find(|folder| folder.join("sim/scenarios").is_dir())
        .expect("the scenarios come with the project");
    let file = folder.join(format!("sim/scenarios/{}.toml", trajectory.name()));
    let mut changes = changes.to_vec();
    changes.push("seed=1".to_owned());
    changes.push(format!("duration_s={}", trajectory.length()));
    let scenario = read_scenario(&file, &changes).expect("it ships");
    let robot = scenario.robots[0].id;
    let mut world = World::new(&scenario).expect("its gains are stable");
    let mut problems = Vec::new();
    let mut ticks = 0;
    let mut now = Span::ZERO;
    while now < scenario.duration() {
        now = now + LOOK;
        world.run_until(now);
        let session = world.station().session(&robot).expect("it has one robot");
        let counters = session.counters();
        if counters.plans_sent + counters.failed > ticks {
            ticks = counters.plans_sent + counters.failed;
            problems.extend(problem(session.planner()).cloned());
        }
    }
    problems
}

/// How often the planner is looked at: several times between two ticks.
const LOOK: Span = Span::from_millis(20);
