//! When what went wrong is over, tracking resumes: within 2 s and the time that messages take, later where a program starts anew.

use sphere_protocol::message::Mode;
use sphere_protocol::robot::RobotId;
use sphere_protocol::time::Span;

use super::Circumstances;
use crate::scenario::{FaultKind, Link, RobotSetup, Scenario};
use crate::trace::Row;

/// What keeps one robot from tracking, and since when nothing does.
pub(super) struct Resume {
    /// Times with a fault or a cut, from, to and what its end allows beyond [`ALLOWED`].
    troubles: Vec<(Span, Span, Span)>,
    /// What every recovery is allowed.
    allowed: Span,
    /// By when it must track.
    due: Span,
    /// Once a fault is latched only an operator arms the robot again, whatever starts anew.
    is_latched: bool,
    /// Whether a robot that has lost its position finds it again.
    has_fixes: bool,
    packets: [(u64, u64); 2],
    /// Since when nothing has come through, in packets sent: up, down.
    lost_in_a_row: [u64; 2],
}

impl Resume {
    pub(super) fn new(scenario: &Scenario, setup: &RobotSetup) -> Self {
        let concerns = |robots: &[RobotId]| robots.is_empty() || robots.contains(&setup.id);
        let network = &scenario.network;
        let loop_time = longest(&network.up) + longest(&network.down);
        let span = |s: f64| Span::from_secs_f64(s);
        let faults = scenario
            .faults
            .iter()
            .filter(|fault| concerns(&fault.robots));
        let faults = faults.map(|fault| {
            let rounds = match fault.kind {
                FaultKind::AgentCrash => span(AGENT_START + 3.0 * loop_time),
                FaultKind::StationCrash => span(STATION_START + 2.0 * loop_time),
                _ => Span::ZERO,
            };
            (span(fault.at_s), span(fault.at_s + fault.for_s), rounds)
        });
        let cuts = network.partition.iter().filter(|cut| concerns(&cut.robots));
        let cuts = cuts.map(|cut| (span(cut.from_s), span(cut.to_s), Span::ZERO));
        Self {
            troubles: faults.chain(cuts).collect(),
            allowed: ALLOWED + span(loop_time),
            due: Span::ZERO,
            is_latched: false,
            has_fixes: scenario.sensing.position_fix_hz > 0.0,
            packets: [(0, 0); 2],
            lost_in_a_row: [0; 2],
        }
    }

    pub(super) fn on_row(
        &mut self,
        row: &Row,
        around: &Circumstances,
        broken: &mut impl FnMut(&'static str),
    ) {
        self.is_latched |= matches!(row.mode, Mode::Failsafe | Mode::Fault);
        let is_lost = row.life > 0 && !self.has_fixes;
        let is_well = row.mode == Mode::Tracking
            || self.is_latched
            || is_lost
            || !around.on_mission
            || !may_be_armed(row);
        let runs = around.agent_runs && around.station_runs;
        let is_cut_off = self.is_cut_off(&around.packets);
        let in_force = |(from, to, _): &&(Span, Span, Span)| row.t >= *from && row.t <= *to;
        let is_troubled = self.troubles.iter().any(|trouble| in_force(&trouble));
        if is_well || !runs || is_cut_off || is_troubled {
            // What starts anew takes its time from its own start, whatever is going on besides.
            let begun = self.troubles.iter().filter(|(from, ..)| *from <= row.t);
            let ready = begun.map(|(_, to, start)| *to + *start).max();
            self.due = ready.unwrap_or(row.t).max(row.t) + self.allowed;
        } else if row.t > self.due {
            broken("tracking-resumes");
        }
    }

    /// Whether packets of one direction have been lost one after the other.
    fn is_cut_off(&mut self, packets: &[(u64, u64); 2]) -> bool {
        for (way, (sent, lost)) in packets.iter().enumerate() {
            let (sent_before, lost_before) = self.packets[way];
            let through = (sent - lost) > (sent_before - lost_before);
            if through {
                self.lost_in_a_row[way] = 0;
            } else {
                self.lost_in_a_row[way] += lost - lost_before;
            }
        }
        self.packets = *packets;
        self.lost_in_a_row.iter().any(|lost| *lost >= LOST_IN_A_ROW)
    }
}

/// Whether a robot that is not armed can be: its estimator settles at rest, and it must be upright.
fn may_be_armed(row: &Row) -> bool {
    let s = &row.truth;
    let is_quiet =
        s.v.abs() < QUIET_SPEED && s.q_r.abs().max(s.alpha.abs()).max(s.beta.abs()) < QUIET_ANGLE;
    !matches!(row.mode, Mode::Boot | Mode::Disarmed) || is_quiet
}

/// Nearly the longest time that a packet takes [s].
fn longest(link: &Link) -> f64 {
    let queue = if link.bandwidth_kbps > 0.0 {
        link.queue_ms
    } else {
        0.0
    };
    1e-3 * (link.delay_ms + 3.0 * link.jitter_ms + queue)
}

/// What every recovery takes beside one round of messages.
const ALLOWED: Span = Span::from_millis(2000);
/// From the start of an agent: its estimator settles, it is localised, claimed and armed [s].
const AGENT_START: f64 = 4.0;
/// From the start of a station: the lease of the one before ends, and it claims [s].
const STATION_START: f64 = 1.5;
/// So many packets lost one after the other are no chance: the link is gone.
const LOST_IN_A_ROW: u64 = 3;
/// An agent that starts anew on a robot that still rolls [m/s] or swings [rad] must wait until it does not.
const QUIET_SPEED: f64 = 0.1;
const QUIET_ANGLE: f64 = 0.2;
