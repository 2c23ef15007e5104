//! The ground station: plans for every robot with model predictive control, and everything around the plans.
//!
//! It knows robots only by their messages. It computes no torque and simulates nothing.

pub mod config_file;
pub mod jet;
pub mod kinematics;
pub mod link;
pub mod mpc;
pub mod plan_command;
pub mod planner;
pub mod predictor;
#[cfg(feature = "io")]
pub mod run;
pub mod session;
pub mod settings;
pub mod station;
pub mod tasking;
pub mod trajectory;
