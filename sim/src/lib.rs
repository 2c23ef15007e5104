//! The world in virtual time: the robots' true bodies, their sensors and the network, around the very agents and station that are
//! deployed.
//!
//! Modules in reading order:

pub mod scenario;
pub mod run;
pub mod world;
pub mod body;
pub mod plant;
pub mod friction;
pub mod disturbance;
pub mod integrator;
pub mod actuator;
pub mod sensor;
pub mod network;
pub mod trace;
pub mod metrics;
pub mod plot;
pub mod report;
pub mod output;
