//! The world in virtual time: plants, boards, agents, network and station in one deterministic event loop.
//!
//! The agents and the station are the deployed cores, fed with the same bytes that they exchange in the field: MAVLink frames
//! between board and agent, CBOR messages between agent and station. Events are ordered by time and, at the same time, by the
//! order in which they were caused; every random number comes from a stream named after its robot and purpose.

use std::cmp::Reverse;
use std::collections::{BTreeMap, BinaryHeap};

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use sha2::{Digest, Sha256};
use sphere_agent::agent::{Agent, Event as AgentEvent, Input as AgentInput, Output as AgentOutput};
use sphere_agent::config::{AgentConfig, Timing};
use sphere_agent::gains::GainError;
use sphere_ground::station::{Event as StationEvent, Input as StationInput, Output as StationOutput, Station};
use sphere_protocol::key::Key;
use sphere_protocol::robot::RobotId;
use sphere_protocol::time::{AgentClock, BoardClock, GroundClock, Instant, Span};

/// Nanoseconds of virtual time since the world began.
pub type WorldTime = i64;

enum Happening {
    Sense { robot: usize },
    Fix { robot: usize },
    FrameToAgent { robot: usize, bytes: Vec<u8> },
    FrameToBoard { robot: usize, bytes: Vec<u8> },
    AgentTimeout { robot: usize },
    StationTimeout,
    ToAgent { robot: usize, key: String, bytes: Vec<u8> },
    ToStation { key: String, bytes: Vec<u8> },
    Sample,
}
