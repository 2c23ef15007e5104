//! [`SetpointPlan`] as bytes: 2 head, 3 knots, 4 gains (absent = no feedback).
//!
//! The head is `[id, based_on, start − based_on, period, valid_for in ms, source]`; knots are N rows (v_c, q_c, x, y, heading,
//! v_d, q_rd) and the end state (x, y, heading, v_d, q_rd); gains are N rows of 2 × 5. So packed, and with the plan's name and
//! validity in short, N = 20 with gains and a robot id of 8 characters takes at most 1450 bytes: one datagram. That holds for
//! every name, stamp and period, a start within 4 s of `based_on` and a validity below a minute.

use arrayvec::ArrayVec;
use minicbor::Encoder;
use minicbor::encode::Write;

use super::body::{self, Body};
use super::{Full, OutOfRange, Wire, WireError};
use crate::message::{KNOTS_MAX, PlanSource, SetpointPlan};
use crate::time::Span;

const HEAD: u8 = 2;
const KNOTS: u8 = 3;
const GAINS: u8 = 4;

const COMMAND_WIDTH: usize = 2;
const STATE_WIDTH: usize = 5;
const KNOT_WIDTH: usize = COMMAND_WIDTH + STATE_WIDTH;
const GAIN_WIDTH: usize = COMMAND_WIDTH * STATE_WIDTH;

/// Knots last at least this long.
const PERIOD_MIN: Span = Span::from_millis(1);
/// Knots last at most this long.
const PERIOD_MAX: Span = Span::from_millis(10_000);
/// Neither validity nor the way from `based_on` to `start` is longer.
const REACH_MAX: Span = Span::from_millis(3_600_000);

impl Wire for SetpointPlan {
    /// Whether a start lies plausibly near its `based_on` is the receiver's judgement; here it must be representable.
    fn check(&self) -> Result<(), OutOfRange> {
        let knots = self.u.len();
        body::check("u", "1 to 64 rows", knots >= 1)?;
        body::check("x", "one row longer than u", self.x.len() == knots + 1)?;
        body::check(
            "k",
            "as long as u, or empty",
            self.k.is_empty() || self.k.len() == knots,
        )?;
        body::check(
            "u",
            "finite",
            self.u.as_flattened().iter().all(|value| value.is_finite()),
        )?;
        body::check(
            "x",
            "finite",
            self.x.as_flattened().iter().all(|value| value.is_finite()),
        )?;
        body::check(
            "k",
            "finite",
            self.k.as_flattened().iter().all(|value| value.is_finite()),
        )?;
        body::check(
            "period",
            "1 ms to 10 s",
            (PERIOD_MIN..=PERIOD_MAX).contains(&self.period),
        )?;
        let validity = Span::from_millis(1)..=REACH_MAX;
        body::check(
            "valid_for",
            "1 ms to 1 h",
            validity.contains(&self.valid_for),
        )?;
        let lead = self.start.since(self.based_on);
        body::check(
            "start",
            "within 1 h of based_on",
            (-REACH_MAX..=REACH_MAX).contains(&lead),
        )?;
        body::check("id", "numbered from 1 on", self.id.seq > 0)
    }

    fn write<W: Write>(&self, fields: &mut Encoder<W>) -> Result<(), Full<W>> {
        body::open(
            fields,
            if self.k.is_empty() { 4 } else { 5 },
            &self.robot,
            self.boot_id,
        )?;
        fields.u8(HEAD)?.array(6)?;
        fields.u64(body::plan_id(self.id))?;
        fields.i64(self.based_on.as_nanos())?;
        fields.i64(self.start.since(self.based_on).as_nanos())?;
        fields.i64(self.period.as_nanos())?;
        // Rounded down: never valid for longer than was meant.
        fields.i64(self.valid_for.as_nanos() / NS_PER_MS)?;
        fields.u8(self.source as u8)?;

        body::open_f32s(fields.u8(KNOTS)?, KNOT_WIDTH * self.u.len() + STATE_WIDTH)?;
        for (u, x) in self.u.iter().zip(&self.x) {
            body::write_f32s(fields, u)?;
            body::write_f32s(fields, x)?;
        }
        body::write_f32s(fields, &self.x[self.u.len()])?;

        if !self.k.is_empty() {
            body::open_f32s(fields.u8(GAINS)?, GAIN_WIDTH * self.k.len())?;
            body::write_f32s(fields, self.k.as_flattened())?;
        }
        Ok(())
    }

    fn read(body: &Body<'_>) -> Result<Self, WireError> {
        let mut head = body.field(HEAD, "head")?;
        head.array(6)?;
        let id = head.plan_id()?;
        let based_on = head.instant()?;
        let start = based_on + head.span()?;
        let period = head.span()?;
        let valid_for = Span::from_millis(i64::from(head.u32()?));
        let source = head.one_of(&SOURCES)?;

        let mut field = body.field(KNOTS, "knots")?;
        let (knots, end) = field.f32_bytes()?.as_chunks::<KNOT_WIDTH>();
        let (Ok(end), true) = (<[_; STATE_WIDTH]>::try_from(end), knots.len() <= KNOTS_MAX) else {
            return Err(field.malformed("is not 1 to 64 rows of 7 and one of 5"));
        };
        let (mut u, mut x) = (ArrayVec::new(), ArrayVec::new());
        for [v_c, q_c, state @ ..] in knots {
            u.push([*v_c, *q_c].map(f32::from_le_bytes));
            x.push(state.map(f32::from_le_bytes));
        }
        x.push(end.map(f32::from_le_bytes));
        let k = match body.optional(GAINS, "gains") {
            Some(mut gains) => gains.f32_rows()?,
            None => ArrayVec::new(),
        };
        Ok(Self {
            robot: body.robot()?,
            boot_id: body.boot_id()?,
            id,
            based_on,
            start,
            period,
            valid_for,
            source,
            u,
            x,
            k,
        })
    }
}

const NS_PER_MS: i64 = 1_000_000;

const SOURCES: [PlanSource; 5] = [
    PlanSource::Riccati,
    PlanSource::Clarabel,
    PlanSource::Shifted,
    PlanSource::Steps,
    PlanSource::Course,
];
