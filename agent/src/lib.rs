//! The onboard agent of one spherical robot: estimator, torque controllers, plan playback, modes.
//!
//! It plans nothing: commands come as plans from the ground station, and without a valid one the robot brakes and rests.
//!
//! ```text
//!  sensor frames ─► estimator ─► state ──┬─────────────► HSMC  ─► τ_p ─┐
//!  plans ─► playback ─► command ─► reference ─► setpoint ─► HTSMC ─► τ_r ─┴► torque frames
//!  commands ─► mode machine ─┘                      telemetry, status, beacon ─► station
//! ```
//!
//! Modules in reading order:

pub mod agent;
pub mod board_clock;
pub mod config;
pub mod config_file;
pub mod control;
pub mod estimator;
pub mod gains;
pub mod mode;
pub mod model;
pub mod plan;
pub mod reference;
#[cfg(feature = "io")]
pub mod run;
