//! The onboard agent of one spherical robot: estimator, torque controllers, plan playback, modes.
//!
//! It plans nothing and simulates nothing: commands come as plans from the ground station, and without a valid one the robot brakes
//! and rests.
//!
//! ```text
//!  sensor frames ─► estimator ─► state ──┬─────────────► HSMC  ─► τ_p ─┐
//!  plans ─► playback ─► command ─► reference ─► setpoint ─► HTSMC ─► τ_r ─┴► torque frames
//!  commands ─► mode machine ─┘                      telemetry, status, beacon ─► station
//! ```
//!
//! It opens nothing itself: [`agent::Agent`] is fed bytes and time, and says what to send. A shell around it is [`run`].
//!
//! ```
//! use sphere_agent::agent::{Agent, Input, Output};
//! use sphere_agent::config::{AgentConfig, Timing};
//! use sphere_agent::control::DirectionChoice;
//! use sphere_agent::estimator::EstimatorConfig;
//! use sphere_protocol::message::Mode;
//! use sphere_protocol::robot::Robot;
//! use sphere_protocol::time::Instant;
//!
//! let config = AgentConfig {
//!     id: "r1".parse()?,
//!     robot: Robot::embedded("liu").expect("comes with the project"),
//!     boot_id: 1,
//!     estimator: EstimatorConfig::default(),
//!     direction: DirectionChoice::Htsmc,
//!     timing: Timing::default(),
//! };
//! let mut agent = Agent::new(Instant::from_nanos(0), config)?;
//!
//! // A tenth of a second without a motor board: it speaks, and asks for no torque.
//! let mut published = Vec::new();
//! for _ in 0..5 {
//!     let now = agent.poll_timeout();
//!     agent.handle_input(now, Input::Timeout);
//!     while let Some(output) = agent.poll_output() {
//!         if let Output::Publish { topic, .. } = output {
//!             published.push(topic);
//!         }
//!     }
//! }
//! assert_eq!(published, ["telemetry", "status", "beacon", "telemetry", "telemetry"]);
//! assert_eq!(agent.mode(), Mode::Boot);
//! assert_eq!(agent.signals().torque.roll, 0.0);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! In reading order: [`agent`], its [`config`] and [`mode`]; [`board_clock`] and [`estimator`]; [`plan`] and [`reference`](mod@reference);
//! [`control`] with its [`gains`] and [`model`]; [`identify`](mod@identify); [`run`].

pub mod agent;
pub mod board_clock;
pub mod config;
pub mod config_file;
pub mod control;
pub mod estimator;
pub mod gains;
pub mod gains_table;
pub mod identify;
pub mod mode;
pub mod model;
pub mod plan;
pub mod reference;
#[cfg(feature = "io")]
pub mod run;
