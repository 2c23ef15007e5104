//! Bytes to events: finds MAVLink 2 frames among whatever else arrives.

use arrayvec::ArrayVec;
use mavlink_core::{MAV_STX_V2, MavlinkVersion, Message};

use super::checksum::checksum;
use super::{Address, CHECKSUM, Event, FRAME_MAX, HEADER, MavMessage, convert};

/// Finds frames in datagrams or in a byte stream, drops and counts everything else. Never more than one frame is held back.
///
/// After a broken frame the search goes on at its second byte, so garbage hides no frame behind it. A frame of a message that the
/// dialect lacks has a checksum nobody here can verify, and is searched too. Signatures are stepped over, not verified.
///
/// ```
/// use sphere_protocol::mavlink::{Address, Event, FrameReader, FrameWriter, Framing, Heartbeat};
///
/// let (agent, board) = (Address { system: 1, component: 191 }, Address { system: 1, component: 1 });
/// let frame = FrameWriter::new(board).heartbeat(&Heartbeat::board(false));
///
/// let mut reader = FrameReader::new(Framing::Datagrams, agent, Some(board.system));
/// let mut rest = &frame[..];
/// while let Some(received) = reader.pull(&mut rest) {
///     assert_eq!(received.from, board);
///     assert_eq!(received.event, Event::Heartbeat(Heartbeat::board(false)));
/// }
/// assert_eq!(reader.counters().frames, 1);
/// ```
#[derive(Clone, Debug)]
pub struct FrameReader {
    framing: Framing,
    own: Address,
    peer: Option<u8>,
    counters: FrameCounters,
    // Begins with a start byte, or is empty.
    held: ArrayVec<u8, FRAME_MAX>,
    // How much of `held` and of what follows belongs to a message of unknown id: searched, but not counted again.
    unknown_left: usize,
}

/// What separates frames.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Framing {
    /// Whole frames in each datagram: one that is cut off at its end is dropped.
    Datagrams,
    /// A stream, as from a serial port: frames may be cut anywhere and continue later.
    Stream,
}

/// One frame's content.
#[derive(Clone, Debug, PartialEq)]
pub struct Received {
    /// Its sender.
    pub from: Address,
    /// Its number among the sender's frames: a gap is a lost one; wraps.
    pub sequence: u8,
    /// What it says.
    pub event: Event,
}

/// What a reader met since its start.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub struct FrameCounters {
    /// Frames passed on.
    pub frames: u64,
    /// Bytes that belong to no frame.
    pub garbage_bytes: u64,
    /// Frames with a wrong checksum.
    pub bad_checksum: u64,
    /// Frames of a message that the dialect lacks, or with flags that demand what this reader cannot do.
    pub unknown: u64,
    /// Frames with a value that is not finite, out of range, or no member of its enum.
    pub invalid: u64,
    /// Frames from or for another system or component.
    pub foreign: u64,
    /// Frames cut off by the end of their datagram.
    pub cut_off: u64,
}

enum Candidate {
    /// So many bytes are missing.
    Needs(usize),
    /// So many bytes are one frame, its checksum is right.
    Frame(usize),
    /// The first byte begins no frame.
    None,
}

impl FrameReader {
    /// Reads frames from system `peer` (from any, if `None`) that are meant for `own` or for all.
    pub const fn new(framing: Framing, own: Address, peer: Option<u8>) -> Self {
        Self {
            framing,
            own,
            peer,
            counters: FrameCounters {
                frames: 0,
                garbage_bytes: 0,
                bad_checksum: 0,
                unknown: 0,
                invalid: 0,
                foreign: 0,
                cut_off: 0,
            },
            held: ArrayVec::new_const(),
            unknown_left: 0,
        }
    }

    /// Takes bytes from the front of `bytes` until a frame for us is complete; `None` when all are taken.
    ///
    /// With [`Framing::Datagrams`], `bytes` is one datagram: call until `None`.
    pub fn pull(&mut self, bytes: &mut &[u8]) -> Option<Received> {
        loop {
            match self.candidate() {
                Candidate::Needs(_) if bytes.is_empty() => {
                    if self.framing == Framing::Stream || self.held.is_empty() {
                        return None;
                    }
                    self.count(|counters| &mut counters.cut_off);
                    self.step();
                }
                Candidate::Needs(missing) => {
                    let (taken, rest) = bytes.split_at(missing.min(bytes.len()));
                    *bytes = rest;
                    let fits = self.held.try_extend_from_slice(taken);
                    fits.expect("no frame is longer than FRAME_MAX");
                }
                Candidate::Frame(length) => {
                    let received = self.accept(length);
                    self.held.drain(..length);
                    self.unknown_left = 0;
                    if received.is_some() {
                        self.counters.frames += 1;
                        return received;
                    }
                }
                Candidate::None => self.step(),
            }
        }
    }

    /// What was met so far.
    pub const fn counters(&self) -> &FrameCounters {
        &self.counters
    }

    /// What `held` begins with.
    fn candidate(&mut self) -> Candidate {
        let held = &self.held;
        let Some(header) = held.first_chunk::<HEADER>() else {
            return match held.first() {
                None => Candidate::Needs(1),
                Some(&MAV_STX_V2) => Candidate::Needs(HEADER - held.len()),
                Some(_) => Candidate::None,
            };
        };
        let [start, payload, flags, ..] = *header;
        if start != MAV_STX_V2 {
            return Candidate::None;
        }
        let signature = if flags & SIGNED == 0 { 0 } else { SIGNATURE };
        let length = HEADER + usize::from(payload) + CHECKSUM + signature;
        let id = message_id(header);
        if flags & !SIGNED != 0 || MavMessage::all_ids().binary_search(&id).is_err() {
            if self.unknown_left == 0 {
                self.counters.unknown += 1;
                self.unknown_left = length;
            }
            return Candidate::None;
        }
        if held.len() < length {
            return Candidate::Needs(length - held.len());
        }
        let end = HEADER + usize::from(payload);
        let sum = checksum(&held[1..end], MavMessage::extra_crc(id));
        if held[end..end + CHECKSUM] != sum.to_le_bytes() {
            self.count(|counters| &mut counters.bad_checksum);
            return Candidate::None;
        }
        Candidate::Frame(length)
    }

    /// The event in the frame that `held` begins with, if it is valid and for us.
    fn accept(&mut self, length: usize) -> Option<Received> {
        let (header, rest) = self.held[..length].split_first_chunk::<HEADER>()?;
        let [_, payload, _, _, sequence, system, component, ..] = *header;
        let from = Address { system, component };
        let payload = &rest[..usize::from(payload)];
        let Ok(message) = MavMessage::parse(MavlinkVersion::V2, message_id(header), payload) else {
            self.counters.invalid += 1;
            return None;
        };
        if self.peer.is_some_and(|peer| peer != system) || !self.is_for_us(&message) {
            self.counters.foreign += 1;
            return None;
        }
        let Ok(event) = convert::event(message) else {
            self.counters.invalid += 1;
            return None;
        };
        Some(Received {
            from,
            sequence,
            event,
        })
    }

    /// Whether `message` is addressed to us or, target 0, to all.
    fn is_for_us(&self, message: &MavMessage) -> bool {
        let meant =
            |target: Option<u8>, own| target.is_none_or(|target| target == 0 || target == own);
        meant(message.target_system_id(), self.own.system)
            && meant(message.target_component_id(), self.own.component)
    }

    /// Drops the first byte held, and all after it that begin no frame.
    fn step(&mut self) {
        let rest = self.held.iter().skip(1);
        let garbage = 1 + rest.take_while(|byte| **byte != MAV_STX_V2).count();
        let counted = garbage.saturating_sub(self.unknown_left);
        self.unknown_left = self.unknown_left.saturating_sub(garbage);
        self.counters.garbage_bytes += counted as u64;
        self.held.drain(..garbage);
    }

    /// Counts one, except within a message of unknown id, whose content is no evidence.
    fn count(&mut self, counter: fn(&mut FrameCounters) -> &mut u64) {
        if self.unknown_left == 0 {
            *counter(&mut self.counters) += 1;
        }
    }
}

fn message_id(header: &[u8; HEADER]) -> u32 {
    u32::from_le_bytes([header[7], header[8], header[9], 0])
}

const SIGNATURE: usize = 13;
/// The one incompatibility flag that changes only the length.
const SIGNED: u8 = 1;
