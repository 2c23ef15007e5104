//! Messages to frames.

use arrayvec::ArrayVec;
use mavlink_core::{MAV_STX_V2, MavlinkVersion, Message};

use super::checksum::checksum;
use super::{
    Address, CHECKSUM, FRAME_MAX, HEADER, Heartbeat, MavMessage, TorqueCommand, ValueError, convert,
};
use crate::state::{Measurement, PositionFix};

/// One frame's bytes.
pub type Frame = ArrayVec<u8, FRAME_MAX>;

/// Writes the frames of one sender and numbers them. Allocates nothing.
#[derive(Clone, Debug)]
pub struct FrameWriter {
    own: Address,
    sequence: u8,
}

impl FrameWriter {
    /// Frames will come from `own`.
    pub const fn new(own: Address) -> Self {
        Self { own, sequence: 0 }
    }

    /// A torque command.
    ///
    /// # Errors
    /// A torque beyond [`TORQUE_SANE`](super::TORQUE_SANE) or not finite, a validity outside 1 ms to 1 s, a broadcast.
    pub fn torque(&mut self, command: &TorqueCommand) -> Result<Frame, ValueError> {
        convert::from_torque(command).map(|message| self.message(&message))
    }

    /// A sample of the sensors, the `sequence`th.
    ///
    /// # Errors
    /// A value that is not finite as f32, or a stamp before the clock's origin.
    pub fn sensors(&mut self, sample: &Measurement, sequence: u32) -> Result<Frame, ValueError> {
        convert::from_sensors(sample, sequence).map(|message| self.message(&message))
    }

    /// A position fix.
    ///
    /// # Errors
    /// A value that is not finite as f32, a sigma that is not positive, or a stamp before the clock's origin.
    pub fn fix(&mut self, fix: &PositionFix) -> Result<Frame, ValueError> {
        convert::from_fix(fix).map(|message| self.message(&message))
    }

    /// A sign of life.
    pub fn heartbeat(&mut self, heartbeat: &Heartbeat) -> Frame {
        self.message(&convert::from_heartbeat(heartbeat))
    }

    /// Any message of the dialect, unchecked.
    pub fn message(&mut self, message: &MavMessage) -> Frame {
        let mut bytes = [0; FRAME_MAX];
        let payload = &mut bytes[HEADER..HEADER + PAYLOAD_MAX];
        let length = message.ser(MavlinkVersion::V2, payload);
        let end = HEADER + length;
        let id = message.message_id();
        let [id_low, id_middle, id_high, _] = id.to_le_bytes();
        let header = [
            MAV_STX_V2,
            length as u8,
            // No flags that a reader must understand, none that it may ignore.
            0,
            0,
            self.sequence,
            self.own.system,
            self.own.component,
            id_low,
            id_middle,
            id_high,
        ];
        bytes[..HEADER].copy_from_slice(&header);
        let sum = checksum(&bytes[1..end], MavMessage::extra_crc(id));
        bytes[end..end + CHECKSUM].copy_from_slice(&sum.to_le_bytes());
        self.sequence = self.sequence.wrapping_add(1);
        let mut frame = Frame::from(bytes);
        frame.truncate(end + CHECKSUM);
        frame
    }
}

/// Longest payload [bytes].
const PAYLOAD_MAX: usize = 255;
