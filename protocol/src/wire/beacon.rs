//! [`Beacon`] as bytes: 2 stamp, 3 position (f64), 4 velocity, 5 radius.

use minicbor::Encoder;
use minicbor::encode::Write;

use super::body::{self, Body};
use super::{Full, OutOfRange, Wire, WireError};
use crate::message::Beacon;

const STAMP: u8 = 2;
const POSITION: u8 = 3;
const VELOCITY: u8 = 4;
const RADIUS: u8 = 5;

impl Wire for Beacon {
    fn check(&self) -> Result<(), OutOfRange> {
        body::finite("position", &self.position)?;
        body::finite("velocity", &self.velocity)?;
        let radius = self.radius as f32;
        body::check(
            "radius",
            "finite and > 0",
            radius.is_finite() && radius > 0.0,
        )
    }

    fn write<W: Write>(&self, fields: &mut Encoder<W>) -> Result<(), Full<W>> {
        body::open(fields, 6, &self.robot, self.boot_id)?;
        fields.u8(STAMP)?.i64(self.stamp.as_nanos())?;
        body::f64s(fields.u8(POSITION)?, self.position)?;
        body::f32s(fields.u8(VELOCITY)?, &self.velocity)?;
        fields.u8(RADIUS)?.f32(self.radius as f32)?;
        Ok(())
    }

    fn read(body: &Body<'_>) -> Result<Self, WireError> {
        Ok(Self {
            robot: body.robot()?,
            boot_id: body.boot_id()?,
            stamp: body.field(STAMP, "stamp")?.instant()?,
            position: body.field(POSITION, "position")?.f64s()?,
            velocity: body.field(VELOCITY, "velocity")?.f32s()?,
            radius: body.field(RADIUS, "radius")?.float()?,
        })
    }
}
