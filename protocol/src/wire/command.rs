//! [`Command`] as bytes: 2 number, 3 station, 4 order.

use minicbor::Encoder;
use minicbor::encode::Write;

use super::body::{self, Body};
use super::{Full, OutOfRange, Wire, WireError};
use crate::message::{Command, CommandOrder};

const NUMBER: u8 = 2;
const STATION: u8 = 3;
const ORDER: u8 = 4;

impl Wire for Command {
    fn check(&self) -> Result<(), OutOfRange> {
        // 0 stands for "no command" and "no station" in what the robot answers.
        body::check("number", "from 1 on", self.number > 0)?;
        body::check("station", "other than 0", self.station != 0)
    }

    fn write<W: Write>(&self, fields: &mut Encoder<W>) -> Result<(), Full<W>> {
        body::open(fields, 5, &self.robot, self.boot_id)?;
        fields.u8(NUMBER)?.u32(self.number)?;
        fields.u8(STATION)?.u64(self.station)?;
        fields.u8(ORDER)?.u8(self.order as u8)?;
        Ok(())
    }

    fn read(body: &Body<'_>) -> Result<Self, WireError> {
        Ok(Self {
            robot: body.robot()?,
            boot_id: body.boot_id()?,
            number: body.field(NUMBER, "number")?.u32()?,
            station: body.field(STATION, "station")?.u64()?,
            order: body.field(ORDER, "order")?.one_of(&ORDERS)?,
        })
    }
}

const ORDERS: [CommandOrder; 6] = [
    CommandOrder::Claim,
    CommandOrder::Release,
    CommandOrder::Arm,
    CommandOrder::Disarm,
    CommandOrder::Hold,
    CommandOrder::Resume,
];
