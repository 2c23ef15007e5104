//! The map of fields of one message: where each field is, and readers and writers of the field types that messages share.

use arrayvec::{ArrayString, ArrayVec};
use minicbor::data::{Tag, Type};
use minicbor::encode::Write;
use minicbor::{Decoder, Encoder};

use super::{Full, MESSAGE_MAX, OutOfRange, WireError};
use crate::message::{Mode, PlanId, SchemaVersion};
use crate::robot::RobotId;
use crate::time::{Instant, Span};

/// Key of the robot's id, in every message.
pub(super) const ROBOT: u8 = 0;
/// Key of the boot id, in every message.
pub(super) const BOOT_ID: u8 = 1;

/// One message's fields, found but not yet read.
pub struct Body<'b> {
    bytes: &'b [u8],
    // Where the value of each key begins; 0 = absent: the envelope comes first.
    at: [usize; KEYS],
}

/// One field of a [`Body`], at its value.
pub(super) struct Field<'b> {
    name: &'static str,
    decoder: Decoder<'b>,
}

impl<'b> Body<'b> {
    /// Reads the envelope of `bytes` and finds the fields.
    ///
    /// # Errors
    /// Not a message, or one of another major version than `ours`.
    pub(super) fn open(
        bytes: &'b [u8],
        topic: &'static str,
        ours: SchemaVersion,
    ) -> Result<Self, WireError> {
        let malformed = |why, at| WireError::Malformed {
            what: topic,
            why,
            at,
        };
        if bytes.len() > MESSAGE_MAX {
            return Err(malformed("is too long", MESSAGE_MAX));
        }
        let mut decoder = Decoder::new(bytes);
        if !matches!(decoder.array(), Ok(Some(3))) {
            return Err(malformed("must be [major, minor, fields]", 0));
        }
        let version = |decoder: &mut Decoder<'_>| {
            let at = decoder.position();
            decoder.u16().map_err(|_| malformed("has no version", at))
        };
        let theirs = SchemaVersion {
            major: version(&mut decoder)?,
            minor: version(&mut decoder)?,
        };
        if theirs.major != ours.major {
            return Err(WireError::Version {
                topic,
                theirs,
                ours,
            });
        }

        let fields = decoder.position();
        let Ok(Some(count)) = decoder.map() else {
            return Err(malformed("must hold a map of definite length", fields));
        };
        let mut at = [0; KEYS];
        for _ in 0..count {
            let key_at = decoder.position();
            let key = match decoder.datatype() {
                Ok(Type::U8 | Type::U16 | Type::U32 | Type::U64) => decoder
                    .u64()
                    .ok()
                    .map(|key| usize::try_from(key).unwrap_or(KEYS)),
                _ => skip(&mut decoder, DEPTH_MAX).map(|()| KEYS),
            };
            let key = key.ok_or_else(|| malformed("has a broken key", key_at))?;
            let value_at = decoder.position();
            skip(&mut decoder, DEPTH_MAX)
                .ok_or_else(|| malformed("has a broken field", value_at))?;
            if let Some(slot) = at.get_mut(key) {
                if *slot != 0 {
                    return Err(malformed("names a field twice", key_at));
                }
                *slot = value_at;
            }
        }
        if decoder.position() != bytes.len() {
            return Err(malformed("is followed by something", decoder.position()));
        }
        Ok(Self { bytes, at })
    }

    /// The field at `key`, which must be there. `name` appears in messages.
    pub(super) fn field(&self, key: u8, name: &'static str) -> Result<Field<'b>, WireError> {
        self.optional(key, name).ok_or(WireError::Malformed {
            what: name,
            why: "is missing",
            at: self.bytes.len(),
        })
    }

    /// The field at `key`, if it is there. `name` appears in messages.
    pub(super) fn optional(&self, key: u8, name: &'static str) -> Option<Field<'b>> {
        let at = self.at[usize::from(key)];
        (at != 0).then(|| {
            let mut decoder = Decoder::new(self.bytes);
            decoder.set_position(at);
            Field { name, decoder }
        })
    }

    /// The robot's id.
    pub(super) fn robot(&self) -> Result<RobotId, WireError> {
        let mut field = self.field(ROBOT, "robot")?;
        let id = field.text()?;
        id.parse()
            .map_err(|_| field.out_of_range("1 to 32 of A-Z a-z 0-9 - _ ."))
    }

    /// The boot id.
    pub(super) fn boot_id(&self) -> Result<u64, WireError> {
        self.field(BOOT_ID, "boot_id")?.u64()
    }
}

impl<'b> Field<'b> {
    pub(super) fn array(&mut self, length: u64) -> Result<(), WireError> {
        match self.decoder.array() {
            Ok(Some(found)) if found == length => Ok(()),
            _ => Err(self.malformed("is not an array of the right length")),
        }
    }

    /// Length of the array that begins here.
    pub(super) fn array_of_any_length(&mut self) -> Result<u64, WireError> {
        match self.decoder.array() {
            Ok(Some(length)) => Ok(length),
            _ => Err(self.malformed("is no array of definite length")),
        }
    }

    pub(super) fn u32(&mut self) -> Result<u32, WireError> {
        self.read("is no integer of 32 bits", |d| d.u32())
    }

    pub(super) fn u64(&mut self) -> Result<u64, WireError> {
        self.read("is no integer of 64 bits", |d| d.u64())
    }

    pub(super) fn instant<C>(&mut self) -> Result<Instant<C>, WireError> {
        Ok(Instant::from_nanos(self.span()?.as_nanos()))
    }

    pub(super) fn span(&mut self) -> Result<Span, WireError> {
        let ns = self.read("is no time in nanoseconds", |d| d.i64())?;
        Ok(Span::from_nanos(ns))
    }

    pub(super) fn plan_id(&mut self) -> Result<PlanId, WireError> {
        let id = self.u64()?;
        Ok(PlanId {
            epoch: (id >> 32) as u32,
            seq: id as u32,
        })
    }

    /// One of `values`, by its place.
    pub(super) fn one_of<T: Copy>(&mut self, values: &[T]) -> Result<T, WireError> {
        let place = self.u64()?;
        let value = usize::try_from(place)
            .ok()
            .and_then(|place| values.get(place));
        value.copied().ok_or(self.out_of_range("a known value"))
    }

    pub(super) fn mode(&mut self) -> Result<Mode, WireError> {
        self.one_of(&MODES)
    }

    pub(super) fn text(&mut self) -> Result<&'b str, WireError> {
        self.read("is no text", |d| d.str())
    }

    pub(super) fn text_up_to<const CAP: usize>(&mut self) -> Result<ArrayString<CAP>, WireError> {
        let text = self.text()?;
        ArrayString::from(text).map_err(|_| self.malformed("is too long"))
    }

    /// One float, f32 or f64.
    pub(super) fn float(&mut self) -> Result<f64, WireError> {
        match self.decoder.datatype() {
            Ok(Type::F32) => self.read("is no float", |d| d.f32()).map(f64::from),
            _ => self.read("is no float", |d| d.f64()),
        }
    }

    /// A typed array of exactly `N` f64.
    pub(super) fn f64s<const N: usize>(&mut self) -> Result<[f64; N], WireError> {
        let bytes = self.typed_array(TAG_F64)?;
        let mut values = [0.0; N];
        if bytes.len() != 8 * N {
            return Err(self.malformed("has a wrong number of values"));
        }
        for (value, bytes) in values.iter_mut().zip(bytes.as_chunks().0) {
            *value = f64::from_le_bytes(*bytes);
        }
        Ok(values)
    }

    /// A typed array of exactly `N` f32.
    pub(super) fn f32s<const N: usize>(&mut self) -> Result<[f64; N], WireError> {
        let bytes = self.f32_bytes()?;
        if bytes.len() != N {
            return Err(self.malformed("has a wrong number of values"));
        }
        let mut values = [0.0; N];
        for (value, bytes) in values.iter_mut().zip(bytes) {
            *value = f64::from(f32::from_le_bytes(*bytes));
        }
        Ok(values)
    }

    /// A typed array of rows of `N` f32, at most `CAP` of them.
    pub(super) fn f32_rows<const N: usize, const CAP: usize>(
        &mut self,
    ) -> Result<ArrayVec<[f32; N], CAP>, WireError> {
        let (rows, rest) = self.f32_bytes()?.as_chunks::<N>();
        if !rest.is_empty() || rows.len() > CAP {
            return Err(self.malformed("has a wrong number of values"));
        }
        Ok(rows.iter().map(|row| row.map(f32::from_le_bytes)).collect())
    }

    /// The four bytes of each value of a typed array of f32.
    pub(super) fn f32_bytes(&mut self) -> Result<&'b [[u8; 4]], WireError> {
        let (values, rest) = self.typed_array(TAG_F32)?.as_chunks();
        if rest.is_empty() {
            Ok(values)
        } else {
            Err(self.malformed("ends within a value"))
        }
    }

    pub(super) fn malformed(&self, why: &'static str) -> WireError {
        WireError::Malformed {
            what: self.name,
            why,
            at: self.decoder.position(),
        }
    }

    fn typed_array(&mut self, tag: Tag) -> Result<&'b [u8], WireError> {
        let found = self.read("is no typed array", |d| d.tag())?;
        if found != tag {
            return Err(self.malformed("is a typed array of another type"));
        }
        self.read("is no typed array", |d| d.bytes())
    }

    fn out_of_range(&self, must: &'static str) -> WireError {
        WireError::OutOfRange(OutOfRange {
            field: self.name,
            must,
        })
    }

    fn read<T>(
        &mut self,
        why: &'static str,
        read: impl FnOnce(&mut Decoder<'b>) -> Result<T, minicbor::decode::Error>,
    ) -> Result<T, WireError> {
        read(&mut self.decoder).map_err(|_| self.malformed(why))
    }
}

/// Begins the map of a message with `count` fields: its robot and boot id are the first two.
pub(super) fn open<W: Write>(
    fields: &mut Encoder<W>,
    count: u64,
    robot: &RobotId,
    boot_id: u64,
) -> Result<(), Full<W>> {
    fields.map(count)?.u8(ROBOT)?.str(robot.as_str())?;
    fields.u8(BOOT_ID)?.u64(boot_id)?;
    Ok(())
}

/// A plan's name as one integer.
pub(super) fn plan_id(id: PlanId) -> u64 {
    u64::from(id.epoch) << 32 | u64::from(id.seq)
}

/// Begins a typed array of `count` f32, which must follow as `write_f32`.
pub(super) fn open_f32s<W: Write>(fields: &mut Encoder<W>, count: usize) -> Result<(), Full<W>> {
    fields.tag(TAG_F32)?.bytes_len(4 * count as u64)?;
    Ok(())
}

/// Values of a typed array that [`open_f32s`] began.
pub(super) fn write_f32s<W: Write>(fields: &mut Encoder<W>, values: &[f32]) -> Result<(), Full<W>> {
    for value in values {
        let bytes = value.to_le_bytes();
        fields
            .writer_mut()
            .write_all(&bytes)
            .map_err(Full::<W>::write)?;
    }
    Ok(())
}

/// A typed array of f32, rounded from f64.
pub(super) fn f32s<W: Write>(fields: &mut Encoder<W>, values: &[f64]) -> Result<(), Full<W>> {
    open_f32s(fields, values.len())?;
    values
        .iter()
        .try_for_each(|value| write_f32s(fields, &[*value as f32]))
}

/// A typed array of f64.
pub(super) fn f64s<W: Write, const N: usize>(
    fields: &mut Encoder<W>,
    values: [f64; N],
) -> Result<(), Full<W>> {
    fields.tag(TAG_F64)?.bytes_len(8 * N as u64)?;
    for value in values {
        let bytes = value.to_le_bytes();
        fields
            .writer_mut()
            .write_all(&bytes)
            .map_err(Full::<W>::write)?;
    }
    Ok(())
}

/// Refuses what would not be finite on the wire as f32.
pub(super) fn finite(field: &'static str, values: &[f64]) -> Result<(), OutOfRange> {
    check(
        field,
        "finite",
        values.iter().all(|value| (*value as f32).is_finite()),
    )
}

/// `OutOfRange` unless `holds`.
pub(super) fn check(
    field: &'static str,
    must: &'static str,
    holds: bool,
) -> Result<(), OutOfRange> {
    if holds {
        Ok(())
    } else {
        Err(OutOfRange { field, must })
    }
}

/// Steps over one value of at most `depth` levels; `None` if it is broken or has indefinite length.
///
/// minicbor's own `skip` keeps a stack on the heap and takes a stray break for a value.
fn skip(decoder: &mut Decoder<'_>, depth: u32) -> Option<()> {
    let inner = depth.checked_sub(1)?;
    match decoder.datatype().ok()? {
        Type::Bool
        | Type::Null
        | Type::Undefined
        | Type::Simple
        | Type::F16
        | Type::F32
        | Type::F64 => skip_head(decoder),
        Type::U8
        | Type::U16
        | Type::U32
        | Type::U64
        | Type::I8
        | Type::I16
        | Type::I32
        | Type::I64
        | Type::Int => decoder.int().ok().map(drop),
        Type::Bytes => decoder.bytes().ok().map(drop),
        Type::String => decoder.str().ok().map(drop),
        Type::Tag => {
            decoder.tag().ok()?;
            skip(decoder, inner)
        }
        Type::Array => {
            for _ in 0..decoder.array().ok()?? {
                skip(decoder, inner)?;
            }
            Some(())
        }
        Type::Map => {
            for _ in 0..decoder.map().ok()?? {
                skip(decoder, inner)?;
                skip(decoder, inner)?;
            }
            Some(())
        }
        _ => None,
    }
}

/// Steps over a simple value or a float: one byte, and as many as its low bits announce.
fn skip_head(decoder: &mut Decoder<'_>) -> Option<()> {
    let at = decoder.position();
    let announced = match decoder.input().get(at)? & 0x1f {
        24 => 1,
        25 => 2,
        26 => 4,
        27 => 8,
        _ => 0,
    };
    let end = at + 1 + announced;
    if end > decoder.input().len() {
        return None;
    }
    decoder.set_position(end);
    Some(())
}

/// Keys from here on are unknown to every message.
const KEYS: usize = 24;
/// Levels of an unknown field that are worth stepping over.
const DEPTH_MAX: u32 = 8;

// RFC 8746, table 1: little endian.
const TAG_F32: Tag = Tag::new(85);
const TAG_F64: Tag = Tag::new(86);

const MODES: [Mode; 8] = [
    Mode::Boot,
    Mode::Disarmed,
    Mode::Ready,
    Mode::Idle,
    Mode::Tracking,
    Mode::Holding,
    Mode::Failsafe,
    Mode::Fault,
];
