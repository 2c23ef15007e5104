//! Holding comes to rest: |v| ≤ 0.02 m/s for 1 s, in the time that braking takes and a margin.

use sphere_protocol::message::Mode;
use sphere_protocol::time::Span;

use super::{Bounds, Circumstances};
use crate::scenario::{Push, RobotSetup};
use crate::trace::Row;

/// One robot on its way to rest.
pub(super) struct Rest {
    pushes: Vec<Push>,
    /// Whether it can rest at all.
    can_rest: bool,
    /// By when it must have come to rest, while it holds and has not.
    due: Option<Span>,
    still_since: Option<Span>,
    was_holding: bool,
    longest: Span,
}

impl Rest {
    pub(super) fn new(setup: &RobotSetup) -> Self {
        let around = &setup.disturbance;
        Self {
            pushes: around.pushes.clone(),
            can_rest: around
                .slope_deg
                .iter()
                .all(|slope| slope.abs() <= SLOPE_MAX)
                && around.random_nm <= RANDOM_MAX,
            due: None,
            still_since: None,
            was_holding: false,
            longest: Span::ZERO,
        }
    }

    pub(super) fn on_row(
        &mut self,
        row: &Row,
        around: &Circumstances,
        bounds: &Bounds,
        broken: &mut impl FnMut(&'static str),
    ) {
        let speed = row.truth.v.abs();
        let holds = matches!(row.mode, Mode::Holding | Mode::Failsafe)
            && around.agent_runs
            && self.can_rest;
        if speed > REST_SPEED {
            self.still_since = None;
        } else {
            self.still_since.get_or_insert(row.t);
        }
        if !holds {
            self.due = None;
        } else if !self.was_holding || self.is_pushed(row.t) {
            let braking = Span::from_secs_f64(speed / bounds.limits.brake);
            self.due = Some(row.t + braking + MARGIN);
        }
        self.was_holding = holds;
        let Some(due) = self.due else { return };
        let is_still = |since| row.t - since >= REST_TIME;
        if self.still_since.is_some_and(is_still) {
            self.due = None;
            self.longest = self.longest.max(row.t - due + MARGIN);
        } else if row.t > due {
            self.due = None;
            self.longest = self.longest.max(MARGIN);
            broken("holding-rests");
        }
    }

    /// The longest that it has taken beyond the time of braking.
    pub(super) fn longest(&self) -> Span {
        self.longest
    }

    fn is_pushed(&self, now: Span) -> bool {
        let now = now.as_secs_f64();
        let acts = |push: &Push| now >= push.at_s && now <= push.at_s + push.for_s;
        self.pushes.iter().any(acts)
    }
}

/// At rest: |v| at most this [m/s] for `REST_TIME`.
const REST_SPEED: f64 = 0.02;
const REST_TIME: Span = Span::from_millis(1000);
/// Time beyond braking's own, `REST_TIME` included.
const MARGIN: Span = Span::from_millis(4000);
/// Beyond these a robot has no rest: it rocks about where it holds.
const SLOPE_MAX: f64 = 3.0;
const RANDOM_MAX: f64 = 0.3;
