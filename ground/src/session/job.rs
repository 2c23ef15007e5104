//! The part of a planning tick that takes time: prediction, references, the solver. Robots' jobs touch nothing of one another and can
//! run on any thread.

use sphere_protocol::message::SetpointPlan;
use sphere_protocol::time::{AgentClock, Instant};

use super::Session;
use crate::planner::{Beginning, Knots};
use crate::predictor::{Ends, ReferenceState};
use crate::settings::{Compensation, KNOT, PlannerMode};
use crate::workload::{Effort, Need};

/// One robot's plan that is to be computed.
pub struct Job<'a> {
    session: &'a mut Session,
    start: Instant<AgentClock>,
    epoch: u32,
    effort: Effort,
    knots: Option<Knots>,
}

/// What came of a job.
pub(crate) struct Planned {
    pub(super) start: Instant<AgentClock>,
    pub(super) epoch: u32,
    pub(super) effort: Effort,
    /// Nothing if the solver failed, or was not asked.
    pub(super) knots: Option<Knots>,
}

impl<'a> Job<'a> {
    /// For a plan of `session` that begins at `start`, under the lease `epoch`.
    pub(super) fn new(session: &'a mut Session, start: Instant<AgentClock>, epoch: u32) -> Self {
        Self {
            session,
            start,
            epoch,
            effort: Effort::Converge,
            knots: None,
        }
    }

    /// How much is to be computed.
    pub fn set_effort(&mut self, effort: Effort) {
        self.effort = effort;
    }

    /// How much is computed.
    pub fn effort(&self) -> Effort {
        self.effort
    }

    /// How much the robot needs it.
    pub fn need(&self) -> Need {
        Need {
            slack: slack(self.session, self.start),
            has_plan_left: self
                .last_plan()
                .is_some_and(|last| last.ends() > self.start),
        }
    }

    /// Plans each of `jobs`; groups of eight or more are planned together, which is faster and gives the same plans.
    pub fn run_all(jobs: &mut [Job<'_>]) {
        jobs.iter_mut().for_each(Job::run);
    }

    /// Plans.
    pub fn run(&mut self) {
        if self.effort == Effort::Shift {
            return;
        }
        let beginning = self.beginning();
        let Some((trajectory, anchor)) = self.session.task.running() else {
            return;
        };
        let mission_time = self.start.since(anchor).as_secs_f64();
        self.knots = match trajectory.program() {
            Some(program) => Some(
                self.session
                    .planner
                    .typed(&beginning, program, mission_time),
            ),
            None => self
                .session
                .planner
                .plan(&beginning, |t| trajectory.reference(mission_time + t))
                .ok(),
        };
    }

    /// What came of it.
    pub(crate) fn into_planned(self) -> Planned {
        Planned {
            start: self.start,
            epoch: self.epoch,
            effort: self.effort,
            knots: self.knots,
        }
    }

    /// Where the plan begins: where the robot will be then.
    fn beginning(&self) -> Beginning {
        let session = &*self.session;
        let is_naive = session.settings.compensation == Compensation::Naive;
        let mut measured = [0.0; 2];
        let mut x = ReferenceState::zeros();
        if let Some(telemetry) = session.telemetry() {
            let until = if is_naive {
                telemetry.stamp
            } else {
                self.start
            };
            x = session.predictor.predict(telemetry, until);
            measured = match (session.settings.mode, is_naive) {
                (PlannerMode::Paper, true) => [telemetry.state.v, telemetry.state.q_r],
                _ => [x[3], x[4]],
            };
        }
        let since_last = self
            .last_plan()
            .map_or(0.0, |last| self.start.since(last.start).as_secs_f64());
        Beginning {
            x,
            measured,
            shift: (since_last / KNOT).round().max(0.0) as usize,
        }
    }

    fn last_plan(&self) -> Option<&SetpointPlan> {
        self.session.last_plan()
    }
}

/// See [`Need::slack`].
fn slack(session: &Session, start: Instant<AgentClock>) -> f64 {
    let Some(telemetry) = session.telemetry() else {
        return 0.0;
    };
    let covered = session.predictor.covered_until(telemetry);
    let left = covered.map_or(0.0, |until| until.since(start).as_secs_f64());
    let state = &telemetry.state;
    let off_path = session
        .task
        .reference(telemetry.stamp)
        .map_or(0.0, |there| (state.x - there.x).hypot(state.y - there.y));
    left - off_path / OFF_PATH
}

/// Distance from the path that counts like a second of plan less [m/s].
const OFF_PATH: f64 = 0.1;
