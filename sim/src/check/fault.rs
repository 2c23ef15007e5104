//! A latched fault has a cause: nothing but an operator ends it, so that no sound robot may latch one.

use sphere_agent::mode::Reason;
use sphere_protocol::message::Mode;
use sphere_protocol::time::Span;

use super::Circumstances;
use crate::trace::Row;

/// When the agent did not run last: what it missed meanwhile is a cause.
#[derive(Default)]
pub(super) struct Fault {
    stood_at: Option<Span>,
    was_latched: bool,
}

impl Fault {
    /// `was_controlled`: whether the robot was its agent's doing until `row`.
    pub(super) fn on_row(
        &mut self,
        row: &Row,
        around: &Circumstances,
        was_controlled: bool,
        broken: &mut impl FnMut(&'static str),
    ) {
        if !around.agent_runs {
            self.stood_at = Some(row.t);
        }
        let is_latched = matches!(row.mode, Mode::Fault | Mode::Failsafe);
        let is_new = is_latched && !self.was_latched;
        self.was_latched = is_latched;
        let has_woken = self.stood_at.is_some_and(|at| row.t - at <= WAKING);
        let has_cause = match around.reason {
            // Whoever takes over a robot that rolls and leans as it will may lose it.
            Reason::OverTilt => !was_controlled,
            // Ordered, though to another end.
            Reason::Shutdown => true,
            // No fault of a scenario touches sensors, estimator or controllers: what is left is frames that waited for the agent.
            _ => has_woken,
        };
        if is_new && !has_cause {
            broken("fault-has-a-cause");
        }
    }
}

/// By so much later an agent that has stood still has worked off what waited for it.
const WAKING: Span = Span::from_millis(200);
