//! The messages between robots and the station: what they hold. How they look as bytes is `wire.rs`, where they travel `key.rs`.

use arrayvec::{ArrayString, ArrayVec};

use crate::robot::RobotId;
use crate::state::RobotState;
use crate::time::{AgentClock, Instant, Span};

/// Largest number of knots in a plan.
pub const KNOTS_MAX: usize = 64;

/// Version of the messages' schema. A receiver refuses another major version and ignores unknown fields of a newer minor one.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SchemaVersion {
    /// Incompatible change.
    pub major: u16,
    /// Compatible addition.
    pub minor: u16,
}

/// How a message is published.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Qos {
    /// Periodic data: the newest counts, dropped when the link is congested.
    Latest,
    /// A single message that matters: ahead of periodic data.
    Urgent,
}

/// The direction in which a topic travels, and so its key (`key.rs`).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Direction {
    /// Robot to station.
    Up,
    /// Station to robot, periodic.
    Down,
    /// Station to robot, single commands.
    Command,
    /// Robot to everybody.
    Beacon,
}

/// What every message type says of itself.
pub trait Message: Sized {
    /// Last chunk of its key.
    const TOPIC: &'static str;
    /// Where it travels.
    const DIRECTION: Direction;
    /// How it is published.
    const QOS: Qos;
    /// Version of its schema.
    const VERSION: SchemaVersion;
}

/// State of an agent's mode machine. All values exist on the wire from the start.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[repr(u8)]
pub enum Mode {
    /// Starting: sensors and estimator settle. Zero torque.
    Boot = 0,
    /// At rest and not allowed to move; the reason why it cannot be armed is in [`Status`]. Zero torque.
    Disarmed = 1,
    /// Disarmed, and every pre-arm check passes. Zero torque.
    Ready = 2,
    /// Armed, balancing at rest, waiting for a plan.
    Idle = 3,
    /// Playing a plan.
    Tracking = 4,
    /// Braking to rest and holding: no valid plan, or ordered to.
    Holding = 5,
    /// Braking to rest and holding after a loss on board; latched until disarmed.
    Failsafe = 6,
    /// Zero torque after a fault that makes control impossible; latched until disarmed.
    Fault = 7,
}

/// Names one plan: later plans compare greater within a boot.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Default)]
pub struct PlanId {
    /// The lease under which it was made.
    pub epoch: u32,
    /// Its number within the lease, from 1.
    pub seq: u32,
}

/// Robot to station, periodic: where the robot is, what it plays and what it has received.
#[derive(Clone, Debug, PartialEq)]
pub struct Telemetry {
    /// Who speaks.
    pub robot: RobotId,
    /// Drawn anew at each start of the agent.
    pub boot_id: u64,
    /// When `state` was true, t_a.
    pub stamp: Instant<AgentClock>,
    /// Mode of the agent.
    pub mode: Mode,
    /// Estimated state.
    pub state: RobotState,
    /// Speed reference that the velocity controller follows, v_d [m/s].
    pub v_d: f64,
    /// Roll reference that the direction controller follows, q_rd [rad].
    pub q_rd: f64,
    /// Standard deviation of the estimated position, the larger axis [m].
    pub position_sigma: f64,
    /// The plan in play; `None` unless tracking.
    pub playing: Option<PlanId>,
    /// The newest plan received (adopted or waiting for its start).
    pub newest: Option<PlanId>,
    /// Bit i is set if plan `newest.seq - 1 - i` of the same epoch was received too.
    pub received: u32,
    /// Arrival minus `based_on` of the newest plan: the whole loop's delay, in one clock.
    pub loop_delay: Option<Span>,
    /// The lease in force, 0 = none.
    pub epoch: u32,
    /// Number of the newest command carried out (or refused), 0 = none.
    pub command: u32,
    /// Torque commanded last: pitch, roll [N·m].
    pub torque: [f64; 2],
}

/// Station to robot: a whole horizon, stamped in the clock of the robot that will execute it.
///
/// Knot i holds command `u[i]` from `start + i period` on; `x[i]` is the predicted state (x, y, heading, v_d, q_rd) at its
/// beginning, and `k[i]` the feedback gain around it: command = u[i] + k[i] (state − predicted). `x` has one row more than `u`.
#[derive(Clone, Debug, PartialEq)]
pub struct SetpointPlan {
    /// Who is to execute it.
    pub robot: RobotId,
    /// The life of the agent for which it was made.
    pub boot_id: u64,
    /// Its name.
    pub id: PlanId,
    /// Stamp of the telemetry it was computed from.
    pub based_on: Instant<AgentClock>,
    /// When its first knot begins.
    pub start: Instant<AgentClock>,
    /// Length of a knot.
    pub period: Span,
    /// End of validity, counted from `based_on`: beyond it the plan must not be played.
    pub valid_for: Span,
    /// What made it.
    pub source: PlanSource,
    /// Commands (v_c [m/s], q_c [rad]), N rows.
    pub u: ArrayVec<[f32; 2], KNOTS_MAX>,
    /// Predicted states (x, y [m], heading [rad], v_d [m/s], q_rd [rad]), N + 1 rows.
    pub x: ArrayVec<[f32; 5], { KNOTS_MAX + 1 }>,
    /// Feedback gains ∂u/∂x, row major 2 × 5, N rows; empty = no feedback.
    pub k: ArrayVec<[f32; 10], KNOTS_MAX>,
}

/// What made a plan.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum PlanSource {
    /// The Riccati sweep.
    Riccati = 0,
    /// Clarabel.
    Clarabel = 1,
    /// The solver failed: the last plan again, with its own `based_on`, knots and end of validity.
    Shifted = 2,
    /// Typed commands, each held over its knot: the agent makes smooth references of their steps with filters of its own, in place
    /// of the reference lag. No feedback.
    Steps = 3,
    /// Typed commands of a smooth course: the roll goes straight from each knot's to the next one's and is followed as it is, the
    /// speed as for `Steps`. No feedback.
    Course = 4,
}

impl PlanSource {
    /// Whether commands were typed rather than planned.
    pub fn is_typed(self) -> bool {
        matches!(self, Self::Steps | Self::Course)
    }
}

/// Station to robot: one order to the mode machine. Repeated by the station until telemetry names its number.
#[derive(Clone, Debug, PartialEq)]
pub struct Command {
    /// Who is to execute it.
    pub robot: RobotId,
    /// The life of the agent for which it was made.
    pub boot_id: u64,
    /// Number within the boot, growing: a repeated or older one is ignored.
    pub number: u32,
    /// Identity of the station.
    pub station: u64,
    /// What to do.
    pub order: CommandOrder,
}

/// What a [`Command`] orders.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum CommandOrder {
    /// Take the lease: from the next epoch on, plans of this station are played.
    Claim = 0,
    /// Give the lease back.
    Release = 1,
    /// Power the motors and balance.
    Arm = 2,
    /// Zero torque. Always honoured, whoever asks.
    Disarm = 3,
    /// Brake to rest and hold, whatever plans say.
    Hold = 4,
    /// Play plans again after `Hold`.
    Resume = 5,
}

/// Robot to station, on change and at a low rate: mode, reasons, counters.
#[derive(Clone, Debug, PartialEq)]
pub struct Status {
    /// Who speaks.
    pub robot: RobotId,
    /// Drawn anew at each start of the agent.
    pub boot_id: u64,
    /// When this was true.
    pub stamp: Instant<AgentClock>,
    /// Mode of the agent.
    pub mode: Mode,
    /// Why it is in this mode, a sentence.
    pub reason: ArrayString<96>,
    /// Messages dropped since the start, by [`DropReason`] reason.
    pub dropped: [u32; DropReason::COUNT],
    /// Times the sliding-mode gain guard was active (E2).
    pub gain_guard: u32,
    /// Version of the agent's software.
    pub software: ArrayString<32>,
    /// The lease in force, 0 = none.
    pub epoch: u32,
    /// Identity of the station that holds the lease, 0 = none.
    pub station: u64,
}

/// Why an incoming message or frame was dropped.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
#[repr(u8)]
pub enum DropReason {
    /// Not decodable.
    Malformed = 0,
    /// Another major version of the schema.
    Version = 1,
    /// For another robot.
    WrongRobot = 2,
    /// For an earlier life of this agent.
    WrongBoot = 3,
    /// Under another lease.
    WrongEpoch = 4,
    /// Not newer than what was received before.
    Old = 5,
    /// Past its validity.
    Expired = 6,
    /// Stamped later than now, or starting implausibly far ahead.
    Future = 7,
    /// A value that is not finite or outside its limits.
    OutOfRange = 8,
    /// Well formed, but nothing this receiver handles.
    Unexpected = 9,
}

/// Robot to everybody: where it is, so that others keep clear.
#[derive(Clone, Debug, PartialEq)]
pub struct Beacon {
    /// Who speaks.
    pub robot: RobotId,
    /// Drawn anew at each start of the agent.
    pub boot_id: u64,
    /// When this was true.
    pub stamp: Instant<AgentClock>,
    /// Position of the centre, world [m].
    pub position: [f64; 2],
    /// Velocity of the centre, world [m/s].
    pub velocity: [f64; 2],
    /// Radius of the sphere [m].
    pub radius: f64,
}

impl DropReason {
    /// How many reasons there are.
    pub const COUNT: usize = 10;
    /// All of them, in the order of their numbers.
    pub const ALL: [Self; Self::COUNT] = [
        Self::Malformed,
        Self::Version,
        Self::WrongRobot,
        Self::WrongBoot,
        Self::WrongEpoch,
        Self::Old,
        Self::Expired,
        Self::Future,
        Self::OutOfRange,
        Self::Unexpected,
    ];
}

impl core::fmt::Display for DropReason {
    /// As an adjective of what was dropped.
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str(match self {
            Self::Malformed => "not decodable",
            Self::Version => "of another schema version",
            Self::WrongRobot => "for another robot",
            Self::WrongBoot => "for an earlier life",
            Self::WrongEpoch => "under another lease",
            Self::Old => "old",
            Self::Expired => "expired",
            Self::Future => "from the future",
            Self::OutOfRange => "out of range",
            Self::Unexpected => "unexpected",
        })
    }
}

impl Message for Telemetry {
    const TOPIC: &'static str = "telemetry";
    const DIRECTION: Direction = Direction::Up;
    const QOS: Qos = Qos::Latest;
    const VERSION: SchemaVersion = SchemaVersion { major: 1, minor: 0 };
}

impl Message for Status {
    const TOPIC: &'static str = "status";
    const DIRECTION: Direction = Direction::Up;
    const QOS: Qos = Qos::Urgent;
    const VERSION: SchemaVersion = SchemaVersion { major: 1, minor: 0 };
}

impl Message for SetpointPlan {
    const TOPIC: &'static str = "plan";
    const DIRECTION: Direction = Direction::Down;
    const QOS: Qos = Qos::Latest;
    const VERSION: SchemaVersion = SchemaVersion { major: 1, minor: 0 };
}

impl Message for Command {
    const TOPIC: &'static str = "command";
    const DIRECTION: Direction = Direction::Command;
    const QOS: Qos = Qos::Urgent;
    const VERSION: SchemaVersion = SchemaVersion { major: 1, minor: 0 };
}

impl Message for Beacon {
    const TOPIC: &'static str = "beacon";
    const DIRECTION: Direction = Direction::Beacon;
    const QOS: Qos = Qos::Latest;
    const VERSION: SchemaVersion = SchemaVersion { major: 1, minor: 0 };
}
