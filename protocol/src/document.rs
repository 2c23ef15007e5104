//! Configuration files: TOML read key by key, so that whatever is wrong is named by file, line and key, with the remedy.
//!
//! Scenarios, agents and stations are all described by such files. Nothing in one is ignored: an unknown key is refused with the
//! nearest known one, a number outside its range with the range.
//!
//! ```
//! use sphere_protocol::document::node::Node;
//! use sphere_protocol::document::table::{Range, Table};
//!
//! let document = Node::document("[timing]\ncontrol_m = 20.0")?;
//! let top = Table::open(&document, "", &["timing"])?;
//! let (node, path) = top.node("timing").expect("it is there");
//! let refusal = Table::open(node, &path, &["control_ms"]).map(drop).expect_err("a slip of the pen");
//! assert_eq!(
//!     refusal.in_file("agent.toml").to_string(),
//!     "agent.toml:2: timing.control_m is an unknown key: did you mean `control_ms`?"
//! );
//! # Ok::<(), sphere_protocol::document::error::Refusal>(())
//! ```

pub mod error;
pub mod node;
pub mod shared;
pub mod table;
