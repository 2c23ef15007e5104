//! `sphere-sim soak`: scenarios drawn from seeds, each held to every invariant; what fails is made small.

mod draw;
mod feature;
mod report;
mod shrink;

use std::num::NonZero;
use std::ops::Range;

use sphere_protocol::robot::RobotId;
use sphere_protocol::time::Span;

use crate::check;
use crate::ensemble;
use crate::metrics::Violation;
use crate::scenario::Scenario;
use crate::world::World;

pub use draw::draw;
pub use feature::{FEATURES, Feature};
pub use report::{Share, Soak};
pub use shrink::shrink;

/// What came of one seed.
#[derive(Clone, Debug, PartialEq)]
pub struct Outcome {
    /// The seed.
    pub seed: u64,
    /// Which of [`FEATURES`] its scenario has.
    pub features: Vec<bool>,
    /// Virtual time [s] times robots.
    pub robot_seconds: f64,
    /// The longest that holding took to come to rest, beyond the time of braking [s].
    pub rest_s: f64,
    /// What broke.
    pub violations: Vec<Violation>,
}

/// Runs every seed on `threads` threads; `done` is called after each with how many have ended.
pub fn run(seeds: Range<u64>, threads: NonZero<usize>, done: impl FnMut(usize)) -> Vec<Outcome> {
    let seeds: Vec<u64> = seeds.collect();
    ensemble::map(&seeds, threads, |seed| examine(*seed), done)
}

/// Draws the scenario of `seed`, runs it and says what broke.
pub fn examine(seed: u64) -> Outcome {
    let scenario = draw(seed);
    let (violations, rest) = watch(&scenario, seed.is_multiple_of(TWINS_EVERY));
    Outcome {
        seed,
        features: FEATURES.iter().map(|(_, has)| has(&scenario)).collect(),
        robot_seconds: scenario.duration_s * scenario.robots.len() as f64,
        rest_s: rest.as_secs_f64(),
        violations: violations
            .into_iter()
            .map(|violation| Violation {
                replay: format!("sphere-sim soak --seeds 1 --seed {seed}"),
                ..violation
            })
            .collect(),
    }
}

/// What breaks in a run of `scenario`; `with_twin` runs it a second time without the faults that are one robot's alone, if there
/// are any, and compares the others.
pub fn broken(scenario: &Scenario, with_twin: bool) -> Vec<Violation> {
    watch(scenario, with_twin).0
}

/// The same, and the longest rest.
fn watch(scenario: &Scenario, with_twin: bool) -> (Vec<Violation>, Span) {
    let stable = "the gains of the embedded robot are stable";
    let world = |scenario: &Scenario| {
        let mut world = World::new(scenario).expect(stable);
        world.run_until(scenario.duration());
        world
    };
    let run = world(scenario);
    let mut violations = run.violations("");
    if with_twin && let Some((faulty, without)) = without_faults_of_one(scenario) {
        let twin = world(&without);
        let strayed = check::strayed(run.trace(), twin.trace(), faulty);
        violations.extend(strayed.iter().map(|breach| breach.violation("")));
    }
    (violations, run.longest_rest())
}

/// The first robot that has faults of its own alone, and `scenario` without these.
fn without_faults_of_one(scenario: &Scenario) -> Option<(RobotId, Scenario)> {
    let alone = |robots: &[RobotId]| match robots {
        [robot] => Some(*robot),
        _ => None,
    };
    let faults = scenario.faults.iter().map(|fault| &fault.robots);
    let cuts = scenario.network.partition.iter().map(|cut| &cut.robots);
    let robot = faults.chain(cuts).find_map(|robots| alone(robots))?;
    let mut without = scenario.clone();
    (without.faults).retain(|fault| alone(&fault.robots) != Some(robot));
    let cuts = &mut without.network.partition;
    cuts.retain(|cut| alone(&cut.robots) != Some(robot));
    (scenario.robots.len() > 1).then_some((robot, without))
}

/// Every so many seeds are run twice where a fault is one robot's alone.
const TWINS_EVERY: u64 = 4;
