//! Messages to frames.

use arrayvec::ArrayVec;
use mavlink_core::{MAVLinkV2MessageRaw, MavHeader};

use super::{Address, FRAME_MAX, Heartbeat, MavMessage, TorqueCommand, ValueError, convert};
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
        let header = MavHeader {
            system_id: u32::from(self.own.system),
            component_id: self.own.component,
            sequence: self.sequence,
        };
        self.sequence = self.sequence.wrapping_add(1);
        let mut raw = MAVLinkV2MessageRaw::new();
        raw.serialize_message(header, message);
        Frame::try_from(raw.raw_bytes()).expect("an 8 bit system id keeps frames within FRAME_MAX")
    }
}
