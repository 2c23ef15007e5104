//! What each robot is to do, and since when.
//!
//! Mission time runs in the *robot's* clock, from the start of the mission's first plan: reference and state are then compared in one
//! clock, and no estimate of an offset enters the tracking. Only where the robot's clock is lost with a reboot the start is carried
//! over by the station's clock.

use sphere_protocol::robot::Robot;
use sphere_protocol::time::{AgentClock, GroundClock, Instant};

use crate::link::Link;
use crate::trajectory::{Mission, MissionError, Pose, ReferencePoint, Trajectory};

/// When a mission begins.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum StartCondition {
    /// As soon as the robot is armed and localised.
    Ready,
    /// Then, but mission time counts from this instant: a fleet that starts together. A robot that is ready late joins in the middle.
    At(Instant<GroundClock>),
    /// When an operator says so.
    Ordered,
}

/// One robot's mission and its progress.
#[derive(Clone, Debug)]
pub struct Task {
    mission: Mission,
    start: StartCondition,
    phase: Phase,
}

#[derive(Clone, Debug)]
enum Phase {
    /// Not begun.
    Waiting,
    /// Mission time 0 is `anchor` in the robot's clock.
    Running {
        trajectory: Trajectory,
        anchor: Instant<AgentClock>,
    },
    /// Begun, but the clock in which it ran is gone.
    Interrupted {
        trajectory: Trajectory,
        began: Instant<GroundClock>,
    },
    /// Over.
    Done,
}

impl Task {
    /// `mission`, not begun.
    pub fn new(mission: Mission, start: StartCondition) -> Self {
        Self {
            mission,
            start,
            phase: Phase::Waiting,
        }
    }

    /// What is to be done.
    pub fn mission(&self) -> &Mission {
        &self.mission
    }

    /// The trajectory and the start in the robot's clock, while it runs.
    pub fn running(&self) -> Option<(&Trajectory, Instant<AgentClock>)> {
        match &self.phase {
            Phase::Running { trajectory, anchor } => Some((trajectory, *anchor)),
            _ => None,
        }
    }

    /// Whether the mission has been begun and is not over.
    pub fn is_under_way(&self) -> bool {
        matches!(
            self.phase,
            Phase::Running { .. } | Phase::Interrupted { .. }
        )
    }

    /// Whether it is over.
    pub fn is_done(&self) -> bool {
        matches!(self.phase, Phase::Done)
    }

    /// When it began, by the station's clock as far as `link` knows.
    pub fn began(&self, link: &Link) -> Option<Instant<GroundClock>> {
        match &self.phase {
            Phase::Running { anchor, .. } => link.ground_time(*anchor),
            Phase::Interrupted { began, .. } => Some(*began),
            Phase::Waiting | Phase::Done => None,
        }
    }

    /// An operator's start.
    pub fn order_start(&mut self) {
        if self.start == StartCondition::Ordered {
            self.start = StartCondition::Ready;
        }
    }

    /// Begins, or goes on after an interruption, if its time has come: the next plan starts at `plan_start`, the robot stands at `here`. Returns whether it is now running.
    ///
    /// # Errors
    /// A mission that this robot cannot drive. It is then over.
    pub fn advance(
        &mut self,
        now: Instant<GroundClock>,
        plan_start: Instant<AgentClock>,
        here: Pose,
        robot: &Robot,
        link: &Link,
    ) -> Result<bool, MissionError> {
        let anchor = match (&self.phase, self.start) {
            (Phase::Running { trajectory, anchor }, _) => {
                let over = trajectory
                    .duration()
                    .is_some_and(|s| plan_start.since(*anchor).as_secs_f64() > s + SETTLE);
                if over {
                    self.phase = Phase::Done;
                }
                return Ok(!over);
            }
            (Phase::Interrupted { began, .. }, _) => link.agent_time(*began),
            (Phase::Done, _) | (Phase::Waiting, StartCondition::Ordered) => None,
            // At rest the robot holds by itself: nothing to plan.
            (Phase::Waiting, _) if self.mission == Mission::Hold => None,
            (Phase::Waiting, StartCondition::Ready) => Some(plan_start),
            (Phase::Waiting, StartCondition::At(instant)) if now >= instant => {
                link.agent_time(instant)
            }
            (Phase::Waiting, StartCondition::At(_)) => None,
        };
        let Some(anchor) = anchor else {
            return Ok(false);
        };
        let trajectory = match core::mem::replace(&mut self.phase, Phase::Done) {
            Phase::Interrupted { trajectory, .. } => trajectory,
            _ => Trajectory::new(&self.mission, robot, here)?,
        };
        self.phase = Phase::Running { trajectory, anchor };
        Ok(true)
    }

    /// The robot was started anew: keeps the start in the station's clock, while `link` still knows the old one.
    pub fn interrupt(&mut self, link: &Link) {
        if let Phase::Running { trajectory, anchor } = &self.phase {
            self.phase = match link.ground_time(*anchor) {
                Some(began) => Phase::Interrupted {
                    trajectory: trajectory.clone(),
                    began,
                },
                None => Phase::Waiting,
            };
        }
    }

    /// The reference at `instant` of the robot's clock, while the mission runs.
    pub fn reference(&self, instant: Instant<AgentClock>) -> Option<ReferencePoint> {
        let (trajectory, anchor) = self.running()?;
        Some(trajectory.reference(instant.since(anchor).as_secs_f64()))
    }
}

/// Time after the end of a trajectory during which plans still bring the robot to its end [s].
const SETTLE: f64 = 3.0;
