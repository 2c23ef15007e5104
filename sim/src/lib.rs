//! The world in virtual time: the robots' true bodies, their sensors and the network, around the very agents and station that are
//! deployed.
//!
//! Modules in reading order:

pub mod actuator;
pub mod body;
pub mod check;
#[cfg(feature = "io")]
pub mod demo;
pub mod disturbance;
pub mod friction;
pub mod integrator;
#[cfg(feature = "io")]
pub mod live;
pub mod metrics;
pub mod network;
pub mod output;
pub mod plant;
#[cfg(feature = "io")]
pub mod plants_command;
pub mod plot;
#[cfg(feature = "io")]
pub mod relay;
pub mod report;
pub mod run;
pub mod scenario;
pub mod sensor;
pub mod trace;
pub mod world;
