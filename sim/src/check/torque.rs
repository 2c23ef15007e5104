//! Torque frames: as they leave an agent and as they reach a board.

use sphere_agent::agent::Agent;
use sphere_protocol::mavlink::{AGENT, BOARD, Event, FrameReader, Framing, TorqueCommand};
use sphere_protocol::message::Mode;
use sphere_protocol::time::Span;

use super::Bounds;

/// Reads the torque commands of one motor link at both of its ends.
pub(super) struct TorqueFrames {
    sent: FrameReader,
    arrived: FrameReader,
}

impl TorqueFrames {
    pub(super) fn new() -> Self {
        let reader = || FrameReader::new(Framing::Datagrams, BOARD, Some(AGENT.system));
        Self {
            sent: reader(),
            arrived: reader(),
        }
    }

    /// The torque commands of a datagram as it leaves the agent, to `each`.
    pub(super) fn sent(&mut self, bytes: &[u8], each: impl FnMut(&TorqueCommand)) {
        read(&mut self.sent, bytes, each);
    }

    /// The torque commands of a datagram as it reaches the board, to `each`.
    pub(super) fn arrived(&mut self, bytes: &[u8], each: impl FnMut(&TorqueCommand)) {
        read(&mut self.arrived, bytes, each);
    }
}

fn read(reader: &mut FrameReader, mut bytes: &[u8], mut each: impl FnMut(&TorqueCommand)) {
    while let Some(received) = reader.pull(&mut bytes) {
        if let Event::Torque(command) = received.event {
            each(&command);
        }
    }
}

/// A torque that leaves `agent` at the end of a control step.
pub(super) fn check_sent(
    command: &TorqueCommand,
    agent: &Agent,
    broken: &mut impl FnMut(&'static str),
) {
    let torque = command.torque;
    let is_zero = torque.pitch == 0.0 && torque.roll == 0.0;
    let is_armed = matches!(
        agent.mode(),
        Mode::Idle | Mode::Tracking | Mode::Holding | Mode::Failsafe
    );
    if !is_armed && !is_zero {
        broken("no-torque-unless-armed");
    }
    let signals = agent.signals();
    // It travels as f32.
    let is_same = |sent: f64, computed: f64| sent == f64::from(computed as f32);
    if !is_same(torque.pitch, signals.torque.pitch) || !is_same(torque.roll, signals.torque.roll) {
        broken("torque-has-a-source");
    }
}

/// A torque that reaches a board.
pub(super) fn check_arrived(
    command: &TorqueCommand,
    bounds: &Bounds,
    mut broken: impl FnMut(&'static str),
) {
    let limit = bounds.torque_max * (1.0 + 1e-6);
    if command.torque.pitch.abs() > limit || command.torque.roll.abs() > limit {
        broken("torque-limit");
    }
    if command.validity > VALIDITY_MAX {
        broken("torque-validity");
    }
}

/// Longest validity of a torque.
const VALIDITY_MAX: Span = Span::from_millis(60);
