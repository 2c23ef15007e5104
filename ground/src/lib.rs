//! The ground station.

pub mod jet;
pub mod trajectory;
