//! stub
pub mod estimator;
