//! One run from a scenario to its results.

use std::collections::BTreeMap;

use sphere_agent::gains::GainsError;
use sphere_protocol::robot::RobotId;
use sphere_protocol::time::Span;

use crate::check::Bounds;
use crate::metrics::{RunMetrics, RunRecord};
use crate::plot::Subject;
use crate::scenario::Scenario;
use crate::trace::Trace;
use crate::world::{Report, World};

/// What came of a run.
pub struct Run {
    /// Every 20 ms of it.
    pub trace: Trace,
    /// Its figures.
    pub metrics: RunMetrics,
    /// What agents and station reported.
    pub reports: Vec<Report>,
    /// When each robot's mission began, in the order of the scenario.
    pub mission_starts: Vec<Option<Span>>,
}

/// Runs `scenario` to its end in virtual time and checks its invariants. `replay` is the command that runs it again, for messages;
/// `elapsed` tells the wall time since the call, for the figure `wall_s` alone.
///
/// # Errors
/// A robot whose gains cannot be stable.
pub fn run(
    scenario: &Scenario,
    replay: &str,
    elapsed: impl FnOnce() -> f64,
) -> Result<Run, GainsError> {
    let mut world = World::new(scenario)?;
    world.run_until(scenario.duration());
    let records = world.records();
    let record = RunRecord {
        seed: scenario.seed,
        duration: scenario.duration(),
        wall_s: elapsed(),
        settle: Span::from_secs_f64(scenario.metrics.settle_s),
        violations: world.violations(replay),
    };
    let metrics = RunMetrics::new(world.trace(), record, &records);
    let mission_starts = records.iter().map(|record| record.mission_start).collect();
    let (trace, reports) = world.into_parts();
    Ok(Run {
        trace,
        metrics,
        reports,
        mission_starts,
    })
}

impl Run {
    /// What to plot of each robot, under the name `name`.
    pub fn subjects<'a>(&self, scenario: &Scenario, name: &'a str) -> Vec<Subject<'a>> {
        let settle = Span::from_secs_f64(scenario.metrics.settle_s);
        scenario
            .robots
            .iter()
            .zip(&self.mission_starts)
            .map(|(setup, start)| Subject {
                robot: setup.id,
                run: name,
                torque_max: setup.plant.torque_max,
                settled: start.map(|start| start + settle),
            })
            .collect()
    }
}

/// What each robot of `scenario` must keep to.
pub(crate) fn bounds(scenario: &Scenario) -> BTreeMap<RobotId, Bounds> {
    let age = scenario.planner.max_age;
    let setups = scenario.robots.iter();
    setups
        .map(|setup| (setup.id, Bounds::new(setup, age)))
        .collect()
}
