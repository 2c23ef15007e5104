//! [`Status`] as bytes: 2 stamp, 3 mode, 4 reason, 5 dropped, 6 gain guard, 7 software, 8 epoch, 9 station.

use minicbor::Encoder;
use minicbor::encode::Write;

use super::body::{self, Body, Field};
use super::{Full, OutOfRange, Wire, WireError};
use crate::message::{DropReason, Status};

const STAMP: u8 = 2;
const MODE: u8 = 3;
const REASON: u8 = 4;
const DROPPED: u8 = 5;
const GAIN_GUARD: u8 = 6;
const SOFTWARE: u8 = 7;
const EPOCH: u8 = 8;
const STATION: u8 = 9;

impl Wire for Status {
    fn check(&self) -> Result<(), OutOfRange> {
        Ok(())
    }

    fn write<W: Write>(&self, fields: &mut Encoder<W>) -> Result<(), Full<W>> {
        body::open(fields, 10, &self.robot, self.boot_id)?;
        fields.u8(STAMP)?.i64(self.stamp.as_nanos())?;
        fields.u8(MODE)?.u8(self.mode as u8)?;
        fields.u8(REASON)?.str(&self.reason)?;
        fields.u8(DROPPED)?.array(DropReason::COUNT as u64)?;
        for count in self.dropped {
            fields.u32(count)?;
        }
        fields.u8(GAIN_GUARD)?.u32(self.gain_guard)?;
        fields.u8(SOFTWARE)?.str(&self.software)?;
        fields.u8(EPOCH)?.u32(self.epoch)?;
        fields.u8(STATION)?.u64(self.station)?;
        Ok(())
    }

    fn read(body: &Body<'_>) -> Result<Self, WireError> {
        Ok(Self {
            robot: body.robot()?,
            boot_id: body.boot_id()?,
            stamp: body.field(STAMP, "stamp")?.instant()?,
            mode: body.field(MODE, "mode")?.mode()?,
            reason: body.field(REASON, "reason")?.text_up_to()?,
            dropped: dropped(body.field(DROPPED, "dropped")?)?,
            gain_guard: body.field(GAIN_GUARD, "gain_guard")?.u32()?,
            software: body.field(SOFTWARE, "software")?.text_up_to()?,
            epoch: body.field(EPOCH, "epoch")?.u32()?,
            station: body.field(STATION, "station")?.u64()?,
        })
    }
}

/// The counters that both sides know: another minor version may count fewer or more reasons.
fn dropped(mut field: Field<'_>) -> Result<[u32; DropReason::COUNT], WireError> {
    let length = field.array_of_any_length()?;
    let mut dropped = [0; DropReason::COUNT];
    for (count, _) in dropped.iter_mut().zip(0..length) {
        *count = field.u32()?;
    }
    Ok(dropped)
}
