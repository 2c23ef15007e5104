//! Programs that stop, stand still and start again: what becomes of what is sent to them meanwhile.

use std::collections::VecDeque;

/// Whether a simulated program runs.
#[derive(Debug, Default)]
pub(super) enum Process {
    /// It runs.
    #[default]
    Running,
    /// It stands still; what arrives waits for it.
    Frozen(Waiting),
    /// It is gone; what arrives is lost.
    Down,
}

/// What waits for a frozen program.
#[derive(Debug, Default)]
pub(super) struct Waiting {
    /// Datagrams of the motor link.
    pub(super) frames: VecDeque<Vec<u8>>,
    /// Messages, each with its key.
    pub(super) messages: VecDeque<(Vec<u8>, Vec<u8>)>,
}

impl Process {
    pub(super) fn is_running(&self) -> bool {
        matches!(self, Self::Running)
    }

    /// Keeps a frame of the motor link for later, or loses it.
    pub(super) fn store_frame(&mut self, bytes: &[u8]) {
        if let Self::Frozen(waiting) = self
            && waiting.frames.len() < FRAMES_MAX
        {
            waiting.frames.push_back(bytes.to_vec());
        }
    }

    /// Keeps a message for later, or loses it: the oldest gives way.
    pub(super) fn store_message(&mut self, key: &[u8], bytes: &[u8]) {
        if let Self::Frozen(waiting) = self {
            if waiting.messages.len() == MESSAGES_MAX {
                waiting.messages.pop_front();
            }
            waiting.messages.push_back((key.to_vec(), bytes.to_vec()));
        }
    }

    /// It goes on: what has waited for it, oldest first.
    pub(super) fn resume(&mut self) -> Waiting {
        match std::mem::take(self) {
            Self::Frozen(waiting) => waiting,
            Self::Running | Self::Down => Waiting::default(),
        }
    }
}

/// Datagrams that fit into a socket's usual buffer of 208 KiB; the newest are lost when it is full.
const FRAMES_MAX: usize = 256;
/// Messages that a session keeps for a subscriber that does not read.
const MESSAGES_MAX: usize = 64;
