//! The world in virtual time: the robots' true bodies, their sensors and the network, around the very agents and station that are
//! deployed.
//!
//! It decides nothing for a robot: bodies and cores meet in bytes alone, and the plant shares no equation with those who control it.
//!
//! ```text
//!  scenario ─► world::World, one queue of events ──────────────────────────────────► trace ─► metrics ─► report, plots, folder
//!                 body::Body ◄─ MAVLink ─► Agent ◄─ network::Link ─► Station
//!                 sensors ◄ plant ◄ actuators ◄ board
//! ```
//!
//! Three seconds of one robot:
//!
//! ```
//! use sphere_protocol::message::Mode;
//! use sphere_sim::run::run;
//! use sphere_sim::scenario::Scenario;
//!
//! let text = "duration_s = 3.0\n[[robots]]\nid = 'r1'\nmission = { kind = 'line' }";
//! let scenario = Scenario::parse("line.toml", text, &[], |path| Err(format!("no file {path}")))?;
//! let first = run(&scenario, "", || 0.0)?;
//!
//! // It boots, is armed by the station, and has begun to drive.
//! let last = first.trace.rows().last().expect("a row every 20 ms");
//! assert_eq!(last.mode, Mode::Tracking);
//! // The same seed gives the same bytes.
//! assert_eq!(run(&scenario, "", || 0.0)?.metrics.digest, first.metrics.digest);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! In reading order: [`scenario`], [`world`], [`run`](mod@run); [`body`] with [`plant`], [`actuator`], [`sensor`], [`friction`], [`disturbance`],
//! [`integrator`]; [`network`]; [`trace`], [`check`], [`indicators`], [`metrics`], [`report`], [`plot`], [`output`]. In real time: [`live`], [`plants_command`],
//! [`relay`], [`demo`], [`swarm`]. Many runs: [`ensemble`], [`paper`], [`soak`].

pub mod actuator;
pub mod body;
pub mod check;
pub mod clock;
#[cfg(feature = "io")]
pub mod demo;
pub mod disturbance;
#[cfg(feature = "io")]
pub mod ensemble;
pub mod friction;
pub mod indicators;
pub mod integrator;
#[cfg(feature = "io")]
pub mod live;
pub mod metrics;
pub mod network;
pub mod output;
#[cfg(feature = "io")]
pub mod paper;
pub mod plant;
#[cfg(feature = "io")]
pub mod plants_command;
pub mod plot;
#[cfg(feature = "io")]
pub mod relay;
pub mod report;
#[cfg(feature = "io")]
pub mod robustness;
pub mod run;
pub mod scenario;
pub mod sensor;
#[cfg(feature = "io")]
pub mod soak;
#[cfg(feature = "io")]
pub mod swarm;
pub mod trace;
pub mod world;
