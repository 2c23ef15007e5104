//! [`Telemetry`] as bytes: 2 stamp, 3 mode, 4 pose (x, y, heading; f64), 5 motion (v, q_r, q_r_rate, beta, beta_rate, alpha,
//! alpha_rate), 6 reference (v_d, q_rd), 7 position_sigma, 8 torque (pitch, roll), 9 epoch, 10 command, 11 received,
//! 12 playing, 13 newest, 14 loop_delay; the last three are optional.

use minicbor::Encoder;
use minicbor::encode::Write;

use super::body::{self, Body};
use super::{Full, OutOfRange, Wire, WireError};
use crate::message::Telemetry;
use crate::state::RobotState;

const STAMP: u8 = 2;
const MODE: u8 = 3;
const POSE: u8 = 4;
const MOTION: u8 = 5;
const REFERENCE: u8 = 6;
const POSITION_SIGMA: u8 = 7;
const TORQUE: u8 = 8;
const EPOCH: u8 = 9;
const COMMAND: u8 = 10;
const RECEIVED: u8 = 11;
const PLAYING: u8 = 12;
const NEWEST: u8 = 13;
const LOOP_DELAY: u8 = 14;

impl Wire for Telemetry {
    fn check(&self) -> Result<(), OutOfRange> {
        body::finite("pose", &pose(&self.state))?;
        body::finite("motion", &motion(&self.state))?;
        body::finite("reference", &[self.v_d, self.q_rd])?;
        body::finite("torque", &self.torque)?;
        let sigma = self.position_sigma as f32;
        body::check(
            "position_sigma",
            "finite and ≥ 0",
            sigma.is_finite() && sigma >= 0.0,
        )
    }

    fn write<W: Write>(&self, fields: &mut Encoder<W>) -> Result<(), Full<W>> {
        let optional = [
            self.playing.is_some(),
            self.newest.is_some(),
            self.loop_delay.is_some(),
        ];
        let count = 12 + optional.into_iter().map(u64::from).sum::<u64>();
        body::open(fields, count, &self.robot, self.boot_id)?;
        fields.u8(STAMP)?.i64(self.stamp.as_nanos())?;
        fields.u8(MODE)?.u8(self.mode as u8)?;
        body::f64s(fields.u8(POSE)?, pose(&self.state))?;
        body::f32s(fields.u8(MOTION)?, &motion(&self.state))?;
        body::f32s(fields.u8(REFERENCE)?, &[self.v_d, self.q_rd])?;
        fields.u8(POSITION_SIGMA)?.f32(self.position_sigma as f32)?;
        body::f32s(fields.u8(TORQUE)?, &self.torque)?;
        fields.u8(EPOCH)?.u32(self.epoch)?;
        fields.u8(COMMAND)?.u32(self.command)?;
        fields.u8(RECEIVED)?.u32(self.received)?;
        if let Some(id) = self.playing {
            fields.u8(PLAYING)?.u64(body::plan_id(id))?;
        }
        if let Some(id) = self.newest {
            fields.u8(NEWEST)?.u64(body::plan_id(id))?;
        }
        if let Some(delay) = self.loop_delay {
            fields.u8(LOOP_DELAY)?.i64(delay.as_nanos())?;
        }
        Ok(())
    }

    fn read(body: &Body<'_>) -> Result<Self, WireError> {
        let [x, y, heading] = body.field(POSE, "pose")?.f64s()?;
        let [v, q_r, q_r_rate, beta, beta_rate, alpha, alpha_rate] =
            body.field(MOTION, "motion")?.f32s()?;
        let [v_d, q_rd] = body.field(REFERENCE, "reference")?.f32s()?;
        let plan_id = |key, name| {
            body.optional(key, name)
                .map(|mut id| id.plan_id())
                .transpose()
        };
        Ok(Self {
            robot: body.robot()?,
            boot_id: body.boot_id()?,
            stamp: body.field(STAMP, "stamp")?.instant()?,
            mode: body.field(MODE, "mode")?.mode()?,
            state: RobotState {
                x,
                y,
                heading,
                v,
                q_r,
                q_r_rate,
                beta,
                beta_rate,
                alpha,
                alpha_rate,
            },
            v_d,
            q_rd,
            position_sigma: body.field(POSITION_SIGMA, "position_sigma")?.float()?,
            playing: plan_id(PLAYING, "playing")?,
            newest: plan_id(NEWEST, "newest")?,
            received: body.field(RECEIVED, "received")?.u32()?,
            loop_delay: body
                .optional(LOOP_DELAY, "loop_delay")
                .map(|mut delay| delay.span())
                .transpose()?,
            epoch: body.field(EPOCH, "epoch")?.u32()?,
            command: body.field(COMMAND, "command")?.u32()?,
            torque: body.field(TORQUE, "torque")?.f32s()?,
        })
    }
}

fn pose(state: &RobotState) -> [f64; 3] {
    [state.x, state.y, state.heading]
}

fn motion(state: &RobotState) -> [f64; 7] {
    [
        state.v,
        state.q_r,
        state.q_r_rate,
        state.beta,
        state.beta_rate,
        state.alpha,
        state.alpha_rate,
    ]
}
