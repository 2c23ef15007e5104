//! What the ends of the fleet agree on: robots, time, messages and their bytes. It computes nothing.
//!
//! Conventions: SI units and radians; X forward, Y left, Z up; angles by the right-hand rule except the roll `q_r`, positive when
//! the frame leans *left*, and the swing `alpha`, positive when the bob is *ahead* (NOTATION.md). Every position means the sphere's centre.

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
