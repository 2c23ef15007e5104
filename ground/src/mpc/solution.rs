//! What a solve returns.

use core::fmt;
use core::str::FromStr;

use nalgebra::{SMatrix, SVector, Vector2};
use thiserror::Error;

use super::problem::ProblemError;

/// The outcome of one solve, in buffers that the next solve overwrites.
#[derive(Clone, Debug, PartialEq)]
pub struct Solution<const NX: usize> {
    /// How it ended.
    pub status: Status,
    /// What solved it, or tried last.
    pub method: Method,
    /// Which way it took.
    pub path: Path,
    /// SQP iterations, those of failed attempts included.
    pub iterations: u32,
    /// Cost of the problem at this point [1].
    pub cost: f64,
    /// Decided inputs, N rows; the first one is to be applied. Empty if refused or infeasible [m/s, rad].
    pub u: Vec<Vector2<f64>>,
    /// States x₀ … x_N, N + 1 rows. Empty if refused or infeasible.
    pub x: Vec<SVector<f64, NX>>,
    /// Feedback gains ∂u/∂x around this point, N rows of 2 × NX: row i corrects `u[i]` by the state at the beginning of its
    /// knot. Zero where a bound holds the input; without the coupling of consecutive inputs.
    pub gains: Vec<SMatrix<f64, 2, NX>>,
    /// Why it was refused.
    pub refusal: Option<Refusal>,
}

/// How a solve ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Status {
    /// A point that satisfies the first-order conditions to rounding.
    Solved,
    /// The iterations ran out ([`Effort::RealTime`](super::Effort::RealTime) allows one), or no step made progress: the point obeys dynamics and bounds but is not optimal.
    MaxIterations,
    /// Bounds and rate bounds contradict each other.
    Infeasible,
    /// Not tried; see [`Solution::refusal`].
    Refused,
}

/// Which solver to use.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Solver {
    /// Riccati sweeps, and Clarabel for what they cannot solve.
    #[default]
    Auto,
    /// Riccati sweeps alone.
    Riccati,
    /// Clarabel alone, with Gauss-Newton steps.
    Clarabel,
}

/// What solved a problem.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Method {
    /// Riccati sweeps.
    Riccati,
    /// Clarabel.
    Clarabel,
}

/// Which way a solution was found.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Path {
    /// Full exact steps from the last solution: nearly all ticks of a robot that tracks.
    Fast,
    /// Steps searched along, from the last solution or the references: first ticks, jumps, half-planes.
    Searched,
    /// Steps by Clarabel.
    Clarabel,
}

/// Why a problem was not tried.
#[derive(Clone, Copy, Debug, Error, PartialEq, Eq)]
pub enum Refusal {
    /// It makes no sense.
    #[error(transparent)]
    Problem(#[from] ProblemError),
    /// It bounds or weighs the change of the input, and only Riccati sweeps are allowed.
    #[error(
        "the Riccati sweep knows no cost or bound on the change of the input: use auto or clarabel"
    )]
    NeedsClarabel,
}

/// A solver's name that is none.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
#[error("no solver `{0}`: use auto, riccati or clarabel")]
pub struct UnknownSolver(String);

impl<const NX: usize> Solution<NX> {
    pub(super) fn new(horizon: usize) -> Self {
        Self {
            status: Status::Refused,
            method: Method::Riccati,
            path: Path::Searched,
            iterations: 0,
            cost: f64::NAN,
            u: Vec::with_capacity(horizon),
            x: Vec::with_capacity(horizon + 1),
            gains: Vec::with_capacity(horizon),
            refusal: None,
        }
    }

    /// Whether the point is optimal.
    pub fn is_solved(&self) -> bool {
        self.status == Status::Solved
    }

    pub(super) fn clear(&mut self) {
        self.iterations = 0;
        self.cost = f64::NAN;
        self.u.clear();
        self.x.clear();
        self.gains.clear();
        self.refusal = None;
    }
}

impl fmt::Display for Status {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(match self {
            Self::Solved => "solved",
            Self::MaxIterations => "max-iterations",
            Self::Infeasible => "infeasible",
            Self::Refused => "refused",
        })
    }
}

impl fmt::Display for Method {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(match self {
            Self::Riccati => "riccati",
            Self::Clarabel => "clarabel",
        })
    }
}

impl FromStr for Solver {
    type Err = UnknownSolver;
    fn from_str(name: &str) -> Result<Self, UnknownSolver> {
        match name {
            "auto" => Ok(Self::Auto),
            "riccati" => Ok(Self::Riccati),
            "clarabel" => Ok(Self::Clarabel),
            other => Err(UnknownSolver(other.to_owned())),
        }
    }
}
