//! What the ends of the fleet agree on: robots, time, messages and their bytes. It computes nothing.
//!
//! Conventions: SI units and radians; X forward, Y left, Z up; angles by the right-hand rule except the roll `q_r`, positive when
//! the frame leans *left* (NOTATION.md). Every position means the sphere's centre.

pub mod message;
pub mod quantity;
pub mod robot;
pub mod state;
pub mod time;
