//! stub

pub mod control;
pub mod gains;
pub mod model;
