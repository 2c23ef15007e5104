//! The station's computer: how long planning takes in virtual time.

use sphere_ground::planner::PlanBatch;
use sphere_ground::session::Job;
use sphere_ground::station::{Station, StationConfig};
use sphere_ground::workload::{Effort, Workers};
use sphere_protocol::time::{GroundClock, Instant, Span};

use crate::scenario::Scenario;

/// A station on the computer of `scenario`.
pub(super) fn station(
    scenario: &Scenario,
    config: StationConfig,
    now: Instant<GroundClock>,
) -> Station {
    let plan_s = scenario.station.plan_time_us * 1e-6;
    if plan_s > 0.0 {
        let batch = PlanBatch::new();
        Station::with_workers(config, now, Box::new(OneCore { plan_s, batch }))
    } else {
        Station::new(config, now)
    }
}

/// Plans for one robot after the other.
struct OneCore {
    /// Time for a converged plan [s].
    plan_s: f64,
    batch: PlanBatch,
}

impl Workers for OneCore {
    fn run(&mut self, jobs: &mut [Job<'_>]) -> Span {
        Job::run_all(jobs, &mut self.batch);
        let plans: f64 = jobs.iter().map(|job| share(job.effort())).sum();
        Span::from_secs_f64(plans * self.plan_s)
    }
}

/// Time for a plan, as a share of a converged one's.
fn share(effort: Effort) -> f64 {
    match effort {
        Effort::Converge => 1.0,
        // Assumed: one iteration of three, with prediction and references for all.
        Effort::RealTime => 0.5,
        Effort::Shift => 0.05,
    }
}
