//! What the ends of the fleet agree on: robots, time, messages and their bytes.
//!
//! It computes nothing: no control, no planning, no physics. It opens no sockets either, but for [`io`], which is a feature.
//!
//! ```text
//!                 wire: CBOR under the keys of `key`                     mavlink: frames
//!  station  ◄──── Telemetry, Status, Beacon ──────────  agent  ◄──── Measurement, PositionFix ────  motor board
//!           ───── SetpointPlan, Command ─────────────►         ───── Torque, with a validity ────►
//!  GroundClock                                        AgentClock                                   BoardClock
//! ```
//!
//! Conventions: SI units and radians; X forward, Y left, Z up; angles by the right-hand rule except the roll `q_r`, positive when
//! the frame leans *left*, and the swing `alpha`, positive when the bob is *ahead* (NOTATION.md). Every position means the sphere's centre.
//!
//! A message becomes bytes and a message again:
//!
//! ```
//! use sphere_protocol::key::Key;
//! use sphere_protocol::message::{Command, CommandOrder};
//! use sphere_protocol::wire::{self, Buffer};
//!
//! let hold = Command {
//!     robot: "r3".parse()?,
//!     boot_id: 0x2122_2324_2526_2728,
//!     number: 300,
//!     station: 0x3132_3334_3536_3738,
//!     order: CommandOrder::Hold,
//! };
//! let mut bytes = Buffer::new();
//! wire::encode(&hold, &mut bytes)?;
//! assert_eq!(bytes.len(), 34);
//! assert_eq!(wire::decode::<Command>(&bytes)?, hold);
//! assert_eq!(Key::of::<Command>(&hold.robot).text().as_str(), "fleet/v1/r3/cmd/command");
//!
//! // What is not a message is refused with its place, never a panic.
//! assert!(wire::decode::<Command>(&bytes[..20]).is_err());
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! In reading order: [`time`], [`robot`] (values with their units by [`quantity`]), [`state`], [`message`], [`key`], [`wire`],
//! [`mavlink`], [`io`].

// The generated MAVLink types say `mavlink_core`, which `mavlink` re-exports whole.
extern crate mavlink as mavlink_core;

pub mod document;
#[cfg(feature = "io")]
pub mod io;
pub mod key;
pub mod mavlink;
pub mod message;
pub mod quantity;
pub mod robot;
pub mod state;
pub mod time;
pub mod wire;
