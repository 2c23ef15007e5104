//! `--record FILE`: the log for identification, written by a thread of its own.
//!
//! The control thread hands datagrams over through a bounded queue and never waits: what does not fit is left out and counted.

use std::fs::File;
use std::io::{self, BufWriter, Write};
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::thread::{self, JoinHandle};

use arrayvec::ArrayVec;
use sphere_protocol::time::{AgentClock, Instant};

use crate::identify::record::Recording;

/// Where the control thread leaves what passes on the motor link.
#[derive(Clone, Debug)]
pub struct Recorder {
    notes: SyncSender<Note>,
    left_out: Arc<AtomicU64>,
}

/// The thread that writes; it ends when every [`Recorder`] is gone.
#[derive(Debug)]
pub struct RecordWriter {
    thread: JoinHandle<io::Result<u64>>,
    left_out: Arc<AtomicU64>,
}

/// What was recorded.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Recorded {
    /// Sensor frames written.
    pub rows: u64,
    /// Datagrams left out, because the disk was too slow.
    pub left_out: u64,
}

#[derive(Clone, Copy, Debug)]
enum Way {
    FromBoard,
    ToBoard,
}

#[derive(Debug)]
struct Note {
    now: Instant<AgentClock>,
    way: Way,
    bytes: ArrayVec<u8, NOTE_MAX>,
}

/// A datagram of one frame has at most 280 bytes; some boards put a few into one.
const NOTE_MAX: usize = 1024;
/// Four seconds of sensor frames and torques.
const NOTES: usize = 1024;

impl Recorder {
    /// Begins a log in a new file at `path`.
    ///
    /// # Errors
    /// The file cannot be created (one that is there already is kept), or the thread not started.
    pub fn create(path: &Path) -> io::Result<(Self, RecordWriter)> {
        let file = BufWriter::new(File::create_new(path)?);
        let (notes, received) = sync_channel(NOTES);
        let left_out = Arc::<AtomicU64>::default();
        let thread = thread::Builder::new()
            .name("record".to_owned())
            .spawn(move || write(file, &received))?;
        let writer = RecordWriter {
            thread,
            left_out: Arc::clone(&left_out),
        };
        Ok((Self { notes, left_out }, writer))
    }

    /// A datagram of the board, at its arrival.
    pub(super) fn board_said(&self, now: Instant<AgentClock>, bytes: &[u8]) {
        self.note(now, Way::FromBoard, bytes);
    }

    /// A datagram of the agent, at its sending.
    pub(super) fn agent_said(&self, now: Instant<AgentClock>, bytes: &[u8]) {
        self.note(now, Way::ToBoard, bytes);
    }

    fn note(&self, now: Instant<AgentClock>, way: Way, bytes: &[u8]) {
        let kept = ArrayVec::try_from(bytes)
            .is_ok_and(|bytes| self.notes.try_send(Note { now, way, bytes }).is_ok());
        if !kept {
            self.left_out.fetch_add(1, Ordering::Relaxed);
        }
    }
}

impl RecordWriter {
    /// Waits for the last row. Every [`Recorder`] must be gone.
    ///
    /// # Errors
    /// The file could not be written to its end.
    pub fn finish(self) -> io::Result<Recorded> {
        let rows = self
            .thread
            .join()
            .map_err(|_| io::Error::other("the recording thread has died"))??;
        Ok(Recorded {
            rows,
            left_out: self.left_out.load(Ordering::Relaxed),
        })
    }
}

fn write(mut file: BufWriter<File>, notes: &Receiver<Note>) -> io::Result<u64> {
    let mut recording = Recording::new();
    let mut text = Recording::head();
    let mut lines = 0;
    loop {
        file.write_all(text.as_bytes())?;
        lines += text.lines().count() as u64;
        text.clear();
        let Ok(Note { now, way, bytes }) = notes.recv() else {
            break;
        };
        match way {
            Way::FromBoard => recording.on_board(now, &bytes, &mut text),
            Way::ToBoard => recording.on_agent(now, &bytes),
        }
    }
    file.flush()?;
    Ok(lines - 1)
}
