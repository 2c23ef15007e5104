//! What the control thread counts about itself, for whoever measures a fleet.

use std::time::Duration;

use sphere_protocol::io::histogram::Histogram;
use sphere_protocol::message::{DropReason, Mode, PlanId};
use sphere_protocol::time::{AgentClock, Instant, Span};

use crate::agent::Agent;

/// Counters of one agent since its start. Nothing here grows.
#[derive(Clone, Debug)]
pub struct Statistics {
    /// How late control steps begin, to 25 µs.
    pub lateness: Histogram,
    /// Age at arrival of each plan received: its arrival minus the stamp of the telemetry it was computed from, to 0.5 ms.
    pub arrival_age: Histogram,
    /// Age at its beginning of each plan that was played: the first control step under it minus the same stamp, to 0.5 ms.
    pub beginning_age: Histogram,
    /// Control steps in each mode, by the mode's number.
    pub modes: [u32; MODES],
    /// Messages handed to the network, of every topic.
    pub sent: Traffic,
    /// Messages that arrived from it.
    pub received: Traffic,
    /// Messages and frames dropped, by [`DropReason`].
    pub dropped: [u32; DropReason::COUNT],
    /// Frames of the motor board that were dropped, whole or in pieces, for whatever reason.
    pub frames_dropped: u64,
    /// Messages not handed to the network because it did not take them fast enough.
    pub outbox_full: u32,
    /// Messages overwritten by newer ones before the control thread took them.
    pub inbox_full: u64,
    newest: Option<PlanId>,
    begun: u64,
}

/// Messages, and the bytes in them without any framing.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Traffic {
    /// How many.
    pub messages: u64,
    /// Their bytes.
    pub bytes: u64,
}

impl Statistics {
    /// Nothing counted yet.
    pub fn new() -> Self {
        let ages = || Histogram::new(AGE_BUCKET, AGE_BUCKETS);
        Self {
            lateness: Histogram::new(LATENESS_BUCKET, LATENESS_BUCKETS),
            arrival_age: ages(),
            beginning_age: ages(),
            modes: [0; MODES],
            sent: Traffic::default(),
            received: Traffic::default(),
            dropped: [0; DropReason::COUNT],
            frames_dropped: 0,
            outbox_full: 0,
            inbox_full: 0,
            newest: None,
            begun: 0,
        }
    }

    /// After each message that `agent` was given.
    pub(super) fn on_message(&mut self, agent: &Agent, bytes: usize) {
        self.received.count(bytes);
        let playback = agent.playback();
        if playback.newest() != self.newest {
            self.newest = playback.newest();
            if let Some(delay) = playback.loop_delay() {
                self.arrival_age.count(length(delay));
            }
        }
    }

    /// After each control step at `now` that was due at `due`.
    pub(super) fn on_step(
        &mut self,
        agent: &Agent,
        due: Instant<AgentClock>,
        now: Instant<AgentClock>,
    ) {
        self.lateness.count(length(now - due));
        let mode = &mut self.modes[agent.mode() as usize];
        *mode = mode.saturating_add(1);
        self.dropped = *agent.dropped();
        let frames = agent.frames();
        self.frames_dropped =
            frames.bad_checksum + frames.unknown + frames.invalid + frames.foreign + frames.cut_off;
        let playback = agent.playback();
        if playback.begun() != self.begun {
            self.begun = playback.begun();
            if let Some(plan) = playback.playing() {
                self.beginning_age.count(length(now - plan.based_on));
            }
        }
    }

    /// Control steps so far.
    pub fn steps(&self) -> u64 {
        self.lateness.total()
    }

    /// Takes over all that `other` holds, without asking for memory.
    pub(super) fn copy_from(&mut self, other: &Self) {
        self.lateness.copy_from(&other.lateness);
        self.arrival_age.copy_from(&other.arrival_age);
        self.beginning_age.copy_from(&other.beginning_age);
        let Self {
            lateness: _,
            arrival_age: _,
            beginning_age: _,
            modes,
            sent,
            received,
            dropped,
            frames_dropped,
            outbox_full,
            inbox_full,
            newest,
            begun,
        } = self;
        *modes = other.modes;
        *sent = other.sent;
        *received = other.received;
        *dropped = other.dropped;
        *frames_dropped = other.frames_dropped;
        *outbox_full = other.outbox_full;
        *inbox_full = other.inbox_full;
        *newest = other.newest;
        *begun = other.begun;
    }
}

impl Default for Statistics {
    fn default() -> Self {
        Self::new()
    }
}

impl Traffic {
    pub(super) fn count(&mut self, bytes: usize) {
        self.messages += 1;
        self.bytes += bytes as u64;
    }
}

/// `span`, none if it is negative.
fn length(span: Span) -> Duration {
    Duration::from_nanos(u64::try_from(span.as_nanos()).unwrap_or(0))
}

/// How many modes there are.
pub const MODES: usize = Mode::Fault as usize + 1;
/// Lateness: 25 ms in all.
const LATENESS_BUCKET: Duration = Duration::from_micros(25);
const LATENESS_BUCKETS: usize = 1000;
/// Ages: 1.25 s in all.
const AGE_BUCKET: Duration = Duration::from_micros(500);
const AGE_BUCKETS: usize = 2500;
