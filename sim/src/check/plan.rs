//! Plans in play: where they come from, for whom they were made, and until when.

use std::collections::VecDeque;

use sphere_agent::agent::Agent;
use sphere_protocol::message::{Mode, PlanId, SetpointPlan};
use sphere_protocol::time::{AgentClock, Instant, Span};

/// The plans that the station made for one robot, and the one that its agent plays.
pub(super) struct Plans {
    boot_id: u64,
    /// When this life of the agent began; `None`: with the world.
    born: Option<Instant<AgentClock>>,
    /// Newest last.
    made: VecDeque<Made>,
    playing: Option<PlanId>,
    /// End of the one that is played, as its maker set it.
    end: Option<Instant<AgentClock>>,
}

/// What is remembered of a plan.
#[derive(Clone, Copy, PartialEq)]
struct Made {
    boot_id: u64,
    id: PlanId,
    based_on: Instant<AgentClock>,
    start: Instant<AgentClock>,
    period: Span,
    valid_for: Span,
    /// Of its commands, states and gains.
    fingerprint: u64,
    knots: usize,
}

impl Plans {
    pub(super) fn new(boot_id: u64) -> Self {
        Self {
            boot_id,
            born: None,
            made: VecDeque::new(),
            playing: None,
            end: None,
        }
    }

    pub(super) fn on_agent_start(&mut self, boot_id: u64, now: Instant<AgentClock>) {
        self.boot_id = boot_id;
        self.born = Some(now);
        self.playing = None;
        self.end = None;
    }

    pub(super) fn on_made(&mut self, plan: &SetpointPlan) {
        if self.made.len() == MADE_MAX {
            self.made.pop_front();
        }
        self.made.push_back(Made::new(plan));
    }

    /// A control step of `agent` is over.
    pub(super) fn on_step(
        &mut self,
        now: Instant<AgentClock>,
        agent: &Agent,
        broken: &mut impl FnMut(&'static str),
    ) {
        if agent.mode() != Mode::Tracking {
            return;
        }
        let Some(plan) = agent.playback().playing() else {
            return broken("tracking-has-a-plan");
        };
        if self.playing != Some(plan.id) {
            self.begin(plan, broken);
        }
        if now < plan.start || self.end.is_none_or(|end| now >= end) {
            broken("plan-is-valid");
        }
    }

    /// Another plan is in play.
    fn begin(&mut self, plan: &SetpointPlan, broken: &mut impl FnMut(&'static str)) {
        let is_ours =
            plan.boot_id == self.boot_id && self.born.is_none_or(|born| plan.based_on >= born);
        if !is_ours {
            broken("plan-of-this-life");
        }
        if self.playing.is_some_and(|last| plan.id < last) {
            broken("plans-never-go-back");
        }
        let played = Made::new(plan);
        let named = |made: &&Made| made.id == plan.id && made.boot_id == plan.boot_id;
        let made = self.made.iter().rev().find(named);
        if made.is_none_or(|made| !made.is_same(&played)) {
            broken("plan-from-station");
        }
        self.playing = Some(plan.id);
        self.end = Some(made.unwrap_or(&played).end());
    }
}

impl Made {
    fn new(plan: &SetpointPlan) -> Self {
        let numbers = (plan.u.iter().flatten())
            .chain(plan.x.iter().flatten())
            .chain(plan.k.iter().flatten());
        // FNV-1a, word by word.
        let fingerprint = numbers.fold(0xcbf2_9ce4_8422_2325_u64, |hash, number| {
            (hash ^ u64::from(number.to_bits())).wrapping_mul(0x0100_0000_01b3)
        });
        Self {
            boot_id: plan.boot_id,
            id: plan.id,
            based_on: plan.based_on,
            start: plan.start,
            period: plan.period,
            valid_for: plan.valid_for,
            fingerprint,
            knots: plan.u.len(),
        }
    }

    /// Whether `played` is this plan as it comes out of the wire, where validity is in whole milliseconds.
    fn is_same(&self, played: &Self) -> bool {
        let cut = self.valid_for - played.valid_for;
        let valid_for = self.valid_for;
        cut >= Span::ZERO
            && cut < Span::from_millis(1)
            && *self
                == Self {
                    valid_for,
                    ..*played
                }
    }

    /// Its last knot or the end of its validity, whichever comes first.
    fn end(&self) -> Instant<AgentClock> {
        let length = self.period.as_nanos().saturating_mul(self.knots as i64);
        (self.start + Span::from_nanos(length)).min(self.based_on + self.valid_for)
    }
}

/// Plans remembered: at 10 Hz those of 12.8 s, and none may be played for longer than 5 s by default.
const MADE_MAX: usize = 128;
