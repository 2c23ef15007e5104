//! Messages as bytes: CBOR (RFC 8949) that any language reads, of a size that is known beforehand.
//!
//! A message is `[major, minor, {key: value, ...}]` with small integer keys, listed in each message's file:
//!
//! | what | as |
//! |---|---|
//! | keys 0, 1 of every message | robot id (text), boot id (integer) |
//! | an instant, a span | integer, nanoseconds; a plan's validity alone in whole milliseconds |
//! | a plan's name | one integer, epoch · 2³² + seq: as integers, later plans compare greater |
//! | a position, a heading | RFC 8746 typed array of f64, little endian (tag 86) |
//! | other vectors, knots, gains | RFC 8746 typed array of f32, little endian (tag 85): f64 fields are rounded to f32 |
//! | an optional field that is `None` | its key is absent |
//!
//! The same message always gives the same bytes: keys ascend, integers take their shortest form, floats keep their width, nothing
//! has indefinite length. A reader takes keys in any order, ignores those it does not know, and refuses everything else that
//! does not fit: neither side passes on a value that is not finite. Writing allocates nothing; reading
//! allocates nothing unless it refuses.

mod beacon;
mod body;
mod command;
mod plan;
mod status;
mod telemetry;

use arrayvec::ArrayVec;
use minicbor::Encoder;
use minicbor::encode::Write;
use thiserror::Error;

pub use self::body::Body;
use crate::message::{DropReason, Message, SchemaVersion};

/// Longest message that is read or written [bytes]; the longest that we write, a plan of 64 knots with gains, takes 4.5 kB.
pub const MESSAGE_MAX: usize = 8192;

/// Room for any message.
pub type Buffer = ArrayVec<u8, MESSAGE_MAX>;

/// A [`Message`] that has a form in bytes.
pub trait Wire: Message {
    /// Refuses values that no receiver would accept. [`encode`] and [`decode`] both ask it.
    ///
    /// # Errors
    /// The first such field.
    fn check(&self) -> Result<(), OutOfRange>;

    /// Writes the map of fields.
    ///
    /// # Errors
    /// `W` takes no more.
    fn write<W: Write>(&self, fields: &mut Encoder<W>) -> Result<(), Full<W>>;

    /// Reads the map of fields. [`Wire::check`] follows.
    ///
    /// # Errors
    /// A required field is missing or has another type or length than it must.
    fn read(body: &Body<'_>) -> Result<Self, WireError>;
}

/// What writing answers when there is no more room.
pub type Full<W> = minicbor::encode::Error<<W as Write>::Error>;

/// A field whose value cannot be meant.
#[derive(Clone, Copy, Debug, Error, PartialEq, Eq)]
#[error("`{field}` must be {must}")]
pub struct OutOfRange {
    /// The field.
    pub field: &'static str,
    /// What it must be.
    pub must: &'static str,
}

/// Why bytes were refused.
#[derive(Clone, Copy, Debug, Error, PartialEq, Eq)]
pub enum WireError {
    /// Not a message of this type.
    #[error("not a message: {what} {why} (byte {at})")]
    Malformed {
        /// The field or part.
        what: &'static str,
        /// What is wrong with it.
        why: &'static str,
        /// Where it was noticed, from 0.
        at: usize,
    },
    /// Another major version of the schema.
    #[error(
        "a {topic} message has schema {}.{}, this software reads {}.x: update the older side",
        theirs.major, theirs.minor, ours.major
    )]
    Version {
        /// Topic of the message.
        topic: &'static str,
        /// The version it states.
        theirs: SchemaVersion,
        /// The version read here.
        ours: SchemaVersion,
    },
    /// A value that is not finite or cannot be meant.
    #[error(transparent)]
    OutOfRange(#[from] OutOfRange),
}

/// Why a message was not written.
#[derive(Clone, Copy, Debug, Error, PartialEq, Eq)]
pub enum EncodeError {
    /// A receiver would refuse it.
    #[error("not sent: {0}")]
    OutOfRange(#[from] OutOfRange),
    /// It does not fit.
    #[error("not sent: the message is longer than the buffer's {capacity} bytes")]
    Full {
        /// Size of the buffer [bytes].
        capacity: usize,
    },
}

impl WireError {
    /// How a receiver counts it.
    pub const fn reason(&self) -> DropReason {
        match self {
            Self::Malformed { .. } => DropReason::Malformed,
            Self::Version { .. } => DropReason::Version,
            Self::OutOfRange(_) => DropReason::OutOfRange,
        }
    }
}

/// Writes `message` into `buffer`, replacing what is there.
///
/// # Errors
/// A value that [`decode`] would refuse, or a buffer that is too small; `buffer` is then empty.
pub fn encode<M: Wire, const CAP: usize>(
    message: &M,
    buffer: &mut ArrayVec<u8, CAP>,
) -> Result<(), EncodeError> {
    buffer.clear();
    message.check()?;
    let written = write(message, &mut Encoder::new(Sink(&mut *buffer)));
    written.map_err(|_| {
        buffer.clear();
        EncodeError::Full { capacity: CAP }
    })
}

/// Reads one message that fills `bytes`.
///
/// # Errors
/// Anything but one valid message of a known major version.
pub fn decode<M: Wire>(bytes: &[u8]) -> Result<M, WireError> {
    let body = Body::open(bytes, M::TOPIC, M::VERSION)?;
    let message = M::read(&body)?;
    message.check()?;
    Ok(message)
}

fn write<M: Wire, W: Write>(message: &M, encoder: &mut Encoder<W>) -> Result<(), Full<W>> {
    let SchemaVersion { major, minor } = M::VERSION;
    encoder.array(3)?.u16(major)?.u16(minor)?;
    message.write(encoder)
}

/// An [`ArrayVec`] to write to.
struct Sink<'a, const CAP: usize>(&'a mut ArrayVec<u8, CAP>);

impl<const CAP: usize> Write for Sink<'_, CAP> {
    type Error = arrayvec::CapacityError;
    fn write_all(&mut self, bytes: &[u8]) -> Result<(), Self::Error> {
        self.0.try_extend_from_slice(bytes)
    }
}
