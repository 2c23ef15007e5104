//! What the parent of a swarm and its parts say to each other: one JSON object a line, on a part's standard input and output.
//!
//! A part lives for as long as its standard input is open: whatever ends the parent closes it.

use std::net::SocketAddr;

use serde::{Deserialize, Serialize};
use sphere_protocol::io::histogram::Sparse;
use sphere_protocol::message::DropReason;

/// The first line that a part is told.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct PartSetup {
    pub(super) part: Part,
    /// Robots of the whole swarm.
    pub(super) robots: usize,
    /// Those of this part: from the first to before the last, by number.
    pub(super) first: usize,
    pub(super) last: usize,
    pub(super) seed: u64,
    pub(super) delay_ms: f64,
    pub(super) jitter_ms: f64,
    pub(super) telemetry_ms: u32,
}

/// What a process is there for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub(super) enum Part {
    Station,
    Agents,
    Plants,
    Relay,
}

/// What a part is asked.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub(super) enum Ask {
    /// The other ends of its motor links, and where it connects to.
    Begin {
        peers: Vec<SocketAddr>,
        connect: Option<SocketAddr>,
    },
    /// Who tracks?
    Look,
    /// All counters. Plants keep the robots' positions from the first mark on, and give them with the second.
    Mark,
    /// End in order.
    Stop,
}

/// What it answers.
#[derive(Debug, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub(super) enum Answer {
    /// Its ends of the motor links.
    Bound(Vec<SocketAddr>),
    /// Where it listens.
    Listening(SocketAddr),
    /// It has begun.
    Begun,
    /// How many of its robots track, and of some that do not: who, in which mode, why.
    Seen {
        tracking: usize,
        others: Vec<String>,
    },
    /// Its counters.
    Marked(Box<Mark>),
    /// It has ended in order.
    Ended,
    /// It cannot go on.
    Failed(String),
}

/// The counters of a part since its start.
#[derive(Debug, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub(super) enum Mark {
    Agents(Vec<AgentMark>),
    Station(StationMark),
    Plants(PlantsMark),
    Relay([WayMark; 2]),
}

#[derive(Debug, Serialize, Deserialize)]
pub(super) struct AgentMark {
    /// Its clock's zero, by the machine's calendar clock [ns].
    pub(super) zero_ns: i64,
    pub(super) lateness: Sparse,
    pub(super) arrival_age: Sparse,
    pub(super) beginning_age: Sparse,
    pub(super) modes: Vec<u32>,
    /// Messages and bytes.
    pub(super) sent: [u64; 2],
    pub(super) received: [u64; 2],
    pub(super) dropped: [u32; DropReason::COUNT],
    pub(super) outbox_full: u32,
    pub(super) inbox_full: u64,
    /// Frames of the motor board that were dropped, for whatever reason.
    pub(super) frames_dropped: u64,
}

#[derive(Debug, Serialize, Deserialize)]
pub(super) struct StationMark {
    /// The beginning of each robot's mission in its own clock [ns].
    pub(super) anchors: Vec<Option<i64>>,
    pub(super) plans: u64,
    pub(super) shifted: u64,
    pub(super) failed: u64,
    pub(super) stale: u64,
    pub(super) dropped: [u32; DropReason::COUNT],
    pub(super) lateness: Sparse,
    pub(super) received: [u64; 2],
    pub(super) sent: [u64; 2],
    pub(super) overtaken: u64,
    pub(super) refused: u64,
}

#[derive(Debug, Serialize, Deserialize)]
pub(super) struct PlantsMark {
    pub(super) steps: u64,
    pub(super) late: u64,
    pub(super) lateness_max_ns: u64,
    /// True positions of each robot since the first mark.
    pub(super) truths: Vec<Vec<TruthMark>>,
}

/// When [ns, calendar clock], x and y [m].
pub(super) type TruthMark = (i64, f64, f64);

#[derive(Debug, Serialize, Deserialize)]
pub(super) struct WayMark {
    pub(super) segments: u64,
    pub(super) bytes: u64,
    pub(super) meant: Sparse,
    pub(super) measured: Sparse,
}
