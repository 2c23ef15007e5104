//! The planner's kernel: one tick's optimal control problem (eq 20 and its extensions) and its solution.
//!
//! Reading order: [`problem`] says what is solved, `sqp` solves it, by the Riccati sweep of `riccati` or by Clarabel,
//! `kkt` checks a solution from nothing but the point itself.

pub mod problem;

pub use problem::{FirstInput, HALF_PLANES_MAX, HalfPlane, Problem, ProblemError};
