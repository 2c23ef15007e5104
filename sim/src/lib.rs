//! The world in virtual time: the robots' true bodies, and what measures, moves and disturbs them.

pub mod actuator;
pub mod disturbance;
pub mod friction;
pub mod integrator;
pub mod plant;
pub mod sensor;
