//! Sockets and clocks: the only part of this crate that touches the machine. Behind the feature `io`, so that the cores build
//! without tokio and Zenoh.

pub mod bus;
pub mod clock;
pub mod histogram;
pub mod link;
pub mod log;
pub mod real_time;
pub mod stop;
