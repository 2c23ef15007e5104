//! The world in virtual time: plants, sensors and network around the very agents and station that are deployed.

pub mod metrics;
pub mod output;
pub mod plot;
pub mod report;
pub mod scenario;
pub mod trace;
