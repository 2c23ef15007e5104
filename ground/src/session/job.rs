//! The part of a planning tick that takes time: prediction, references, the solver. Robots' jobs touch nothing of one another and can
//! run on any thread.

use arrayvec::ArrayVec;
use sphere_protocol::message::SetpointPlan;
use sphere_protocol::time::{AgentClock, Instant};

use super::Session;
use crate::mpc;
use crate::planner::{Beginning, Job as Tick, Knots, PlanBatch, Planner};
use crate::predictor::{Ends, ReferenceState};
use crate::settings::{Compensation, KNOT, PlannerMode};
use crate::trajectory::Along;
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

    /// Plans each of `jobs`, several robots at once in the lanes of `batch`.
    pub fn run_all(jobs: &mut [Job<'_>], batch: &mut PlanBatch) {
        for jobs in jobs.chunks_mut(WINDOW) {
            let mut parts: ArrayVec<_, WINDOW> = jobs.iter_mut().filter_map(Job::part).collect();
            let mut outcomes = ArrayVec::<_, WINDOW>::new();
            let mut ticks: ArrayVec<_, WINDOW> = ArrayVec::new();
            for (planner, beginning, reference, knots) in &mut parts {
                ticks.push(Tick {
                    planner,
                    beginning: *beginning,
                    reference,
                });
                outcomes.push(knots);
            }
            batch.plan(&mut ticks, |i, outcome| **outcomes[i] = outcome.ok());
        }
    }

    /// What a batch needs of it; nothing if nothing is to be solved: typed commands are written at once.
    fn part(&mut self) -> Option<(&mut Planner, Beginning, Along<'_>, &mut Option<Knots>)> {
        let effort = match self.effort {
            Effort::Shift => return None,
            Effort::RealTime => mpc::Effort::RealTime,
            Effort::Converge => mpc::Effort::Converge,
        };
        let beginning = self.beginning();
        let Session { planner, task, .. } = &mut *self.session;
        let (trajectory, anchor) = task.running()?;
        let mission_time = self.start.since(anchor).as_secs_f64();
        if let Some(program) = trajectory.program() {
            self.knots = Some(planner.typed(&beginning, program, mission_time));
            return None;
        }
        planner.set_effort(effort);
        let along = Along {
            trajectory,
            from: mission_time,
        };
        Some((planner, beginning, along, &mut self.knots))
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
/// Jobs prepared before they are solved: their problems still lie in the cache then.
const WINDOW: usize = 32;
