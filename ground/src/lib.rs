//! The ground station: plans for every robot with model predictive control, and everything around the plans.
//!
//! It knows robots only by their messages. It computes no torque and simulates nothing.

pub mod kinematics;
pub mod mpc;
pub mod plan_command;
