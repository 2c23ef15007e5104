//! The link between an agent and its motor board: MAVLink 2 frames, as pure functions of bytes.
//!
//! Sensor frames and torque commands are messages of our own, [`sphere`] (`protocol/mavlink/sphere.xml`); heartbeats and position
//! fixes are MAVLink's. What else arrives comes out as [`Event::Other`].
//!
//! | ours | MAVLink | how |
//! |---|---|---|
//! | [`Measurement`] | SPHERE_SENSORS 53000 | SI, FLU; angles f64, the rest f32; stamp in whole µs of the board's clock |
//! | [`TorqueCommand`] | SPHERE_TORQUE 53001 | N·m as f32; validity in whole ms from receipt |
//! | [`PositionFix`] | VISION_POSITION_ESTIMATE 102 | local NED, `usec` in the board's clock |
//! | [`Heartbeat`] | HEARTBEAT 0 | rover, generic autopilot |
//!
//! Frames: ours is ENU-like (X, Y on the floor, Z up), MAVLink's local frame NED: (x, y, z) becomes (y, x, −z), both ways.
//! A fix has no attitude and no height: they travel as NaN and 0, with NaN as their covariances.
//!
//! The generated types' `Default` is unsafe, every set of flags starts with its first one (a default HEARTBEAT says
//! SAFETY_ARMED): each field is written out here.

mod checksum;
mod convert;
mod reader;
mod writer;

use thiserror::Error;

pub use self::generated::sphere;
pub use self::reader::{FrameCounters, FrameReader, Framing, Received};
pub use self::sphere::{MavAutopilot, MavMessage, MavState, MavType};
pub use self::writer::{Frame, FrameWriter};
use crate::message::Mode;
use crate::state::{Measurement, PositionFix, Torque};
use crate::time::Span;

mod generated {
    include!(concat!(env!("OUT_DIR"), "/dialect.rs"));
}

/// Longest MAVLink 2 frame with an 8 bit system id, signed [bytes].
pub const FRAME_MAX: usize = 280;
/// Bytes of a frame before its payload.
const HEADER: usize = 10;
/// Bytes of a frame's checksum.
const CHECKSUM: usize = 2;
/// Torques beyond this are no command but a mistake [N·m]; each robot's own limit is far below.
pub const TORQUE_SANE: f64 = 200.0;
/// Longest validity of a torque command: a board must never follow a dead agent for longer.
pub const VALIDITY_MAX: Span = Span::from_millis(1000);

/// Who speaks or is spoken to on a link.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Address {
    /// System, from 1.
    pub system: u8,
    /// Component, from 1.
    pub component: u8,
}

/// The agent on its motor link: system 1, component MAV_COMP_ID_ONBOARD_COMPUTER.
pub const AGENT: Address = Address {
    system: 1,
    component: 191,
};
/// The motor board on the same link: system 1, component MAV_COMP_ID_AUTOPILOT1.
pub const BOARD: Address = Address {
    system: 1,
    component: 1,
};

/// Torques for both motors and for how long they hold.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TorqueCommand {
    /// The board that is to obey.
    pub target: Address,
    /// Counts commands; the board ignores one that is not newer than the last (modulo 2³²).
    pub sequence: u32,
    /// The torques.
    pub torque: Torque,
    /// How long the board may follow them, counted from their receipt: 1 ms to 1 s, rounded down to milliseconds.
    pub validity: Span,
}

/// Sign of life, with what a ground control station shows of a system.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Heartbeat {
    /// What it is.
    pub kind: MavType,
    /// Whether it speaks as an autopilot, and which.
    pub autopilot: MavAutopilot,
    /// Motors may turn.
    pub armed: bool,
    /// Roughly how it is.
    pub state: MavState,
    /// Our [`Mode`] as a number, for an agent.
    pub custom_mode: u32,
}

/// What a frame said.
#[derive(Clone, Debug, PartialEq)]
pub enum Event {
    /// A sample of the board's sensors.
    Sensors {
        /// The sample.
        measurement: Measurement,
        /// The board's count of samples: a gap is a lost one; wraps.
        sequence: u32,
    },
    /// A position from outside.
    Fix(PositionFix),
    /// Torques to apply.
    Torque(TorqueCommand),
    /// A sign of life.
    Heartbeat(Heartbeat),
    /// Any other message of the dialect, as it came: its values may be NaN.
    Other(MavMessage),
}

/// A value that must not be sent, or was refused on arrival.
#[derive(Clone, Copy, Debug, Error, PartialEq, Eq)]
#[error("{message}: `{field}` must be {must}")]
pub struct ValueError {
    /// Name of the MAVLink message.
    pub message: &'static str,
    /// The field.
    pub field: &'static str,
    /// What it must be.
    pub must: &'static str,
}

impl Heartbeat {
    /// What an agent says in `mode`.
    pub const fn agent(mode: Mode) -> Self {
        let (armed, state) = match mode {
            Mode::Boot => (false, MavState::MAV_STATE_BOOT),
            Mode::Disarmed | Mode::Ready => (false, MavState::MAV_STATE_STANDBY),
            Mode::Idle | Mode::Tracking | Mode::Holding => (true, MavState::MAV_STATE_ACTIVE),
            Mode::Failsafe => (true, MavState::MAV_STATE_CRITICAL),
            Mode::Fault => (false, MavState::MAV_STATE_EMERGENCY),
        };
        Self {
            kind: MavType::MAV_TYPE_GROUND_ROVER,
            autopilot: MavAutopilot::MAV_AUTOPILOT_GENERIC,
            armed,
            state,
            custom_mode: mode as u32,
        }
    }

    /// What a motor board says.
    pub const fn board(torque_on: bool) -> Self {
        Self {
            kind: MavType::MAV_TYPE_ONBOARD_CONTROLLER,
            autopilot: MavAutopilot::MAV_AUTOPILOT_INVALID,
            armed: torque_on,
            state: if torque_on {
                MavState::MAV_STATE_ACTIVE
            } else {
                MavState::MAV_STATE_STANDBY
            },
            custom_mode: 0,
        }
    }
}
