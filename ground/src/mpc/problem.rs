//! The optimal control problem of one tick, eq (20), as typed data.
//!
//! ```text
//! min  Σᵢ₌₁ᴺ |xᵢ − x_ref,ᵢ|²_Q   (|·|²_P at i = N)
//!    + Σᵢ |uᵢ − u_ref,ᵢ|²_R + Σᵢ |uᵢ − uᵢ₋₁|²_Rd
//!    + Σᵢ₌₁ᴺ Σ_h w_h max(0, b_h − n_hᵀ(X, Y)ᵢ)²
//! s.t. xᵢ₊₁ = F(xᵢ, uᵢ),  x₀ given
//!      u_min,ᵢ ≤ uᵢ ≤ u_max,ᵢ,  |uᵢ − uᵢ₋₁| ≤ du_max,  tan|q_c,ᵢ| vᵢ² ≤ turn_limit
//! ```
//!
//! Costs have no factor ½. Which inputs are decided is [`FirstInput`].

use arrayvec::ArrayVec;
use nalgebra::{SMatrix, SVector, Vector2};
use thiserror::Error;

use crate::kinematics::Discretisation;

/// One tick's problem over N knots. Build it once with [`Problem::new`], then refill the fields: nothing allocates.
///
/// NX = 3 has states (X, Y, φ) and inputs (v, q_r); NX = 5 has states (X, Y, φ, v, q_r) and the commands (v_c, q_c) as inputs.
#[derive(Clone, Debug, PartialEq)]
pub struct Problem<const NX: usize> {
    /// How the state moves over a knot.
    pub model: Discretisation<NX>,
    /// Whether the input of the first knot is decided or measured.
    pub first_input: FirstInput,
    /// State at the beginning [m, m, rad, m/s, rad].
    pub x0: SVector<f64, NX>,
    /// Input before the first decided one, u₋₁ ([`FirstInput::Decided`]) or U(0) ([`FirstInput::Measured`]) [m/s, rad].
    pub u_prev: Vector2<f64>,
    /// Reference states, N rows: row i is that of xᵢ₊₁. Headings must be unwrapped, near that of `x0` [m, m, rad, m/s, rad].
    pub x_ref: Vec<SVector<f64, NX>>,
    /// Reference inputs, N rows: row i is that of the i-th decided input [m/s, rad].
    pub u_ref: Vec<Vector2<f64>>,
    /// Diagonal of Q [1/m², 1/m², 1/rad², s²/m², 1/rad²], ≥ 0.
    pub q: SVector<f64, NX>,
    /// Weight P of the last state, NX × NX, symmetric and positive semidefinite.
    pub p_terminal: SMatrix<f64, NX, NX>,
    /// Diagonal of R [s²/m², 1/rad²], ≥ 0.
    pub r: Vector2<f64>,
    /// Diagonal of Rd, the weight of uᵢ − uᵢ₋₁ [s²/m², 1/rad²], ≥ 0. Not zero: Clarabel solves.
    pub r_rate: Vector2<f64>,
    /// Least inputs, N rows, one for each decided input [m/s, rad].
    pub u_min: Vec<Vector2<f64>>,
    /// Greatest inputs, N rows [m/s, rad].
    pub u_max: Vec<Vector2<f64>>,
    /// Greatest change of the input from knot to knot, hard [m/s, rad]. Given: Clarabel solves.
    pub du_max: Option<Vector2<f64>>,
    /// Soft half-planes: none at all, or N rows, of which row i holds those for the position of xᵢ₊₁ ([`Problem::add_half_plane`]).
    pub half_planes: Vec<ArrayVec<HalfPlane, HALF_PLANES_MAX>>,
    /// Greatest tan|q_c| v² [m²/s²]. Bounds q_c of each knot by the speed of the same plan: a bound on the roll, which never
    /// trades speed for roll. The bound follows the iterates; where plan and bound chase each other, far from the reference,
    /// it ends narrower than the speed asks for.
    pub turn_limit: Option<f64>,
}

/// Which inputs are decided.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FirstInput {
    /// u₀ … u_N₋₁ are decided, `u_prev` is what precedes them.
    Decided,
    /// The paper's eq (20b): U(0) = `u_prev` is fixed and moves x₀ to x₁; U(1) … U(N) are decided and U(1) is the one to apply.
    Measured,
}

/// Keep to the side nᵀ(X, Y) ≥ b, softly: costs w max(0, b − nᵀ(X, Y))².
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HalfPlane {
    /// Normal n, pointing to the allowed side, of length 1 [1].
    pub normal: [f64; 2],
    /// Offset b [m].
    pub offset: f64,
    /// Weight w [1/m²], ≥ 0.
    pub weight: f64,
}

/// Why a problem is refused before it is solved.
#[derive(Clone, Copy, Debug, Error, PartialEq, Eq)]
pub enum ProblemError {
    /// No knots at all.
    #[error("the horizon has no knots")]
    Empty,
    /// A row too many or too few.
    #[error("{field} has {rows} rows instead of {horizon}")]
    Rows {
        /// The field.
        field: &'static str,
        /// Its number of rows.
        rows: usize,
        /// The number of knots.
        horizon: usize,
    },
    /// NaN or infinite.
    #[error("{field} is not finite")]
    NotFinite {
        /// The field.
        field: &'static str,
    },
    /// A weight below zero, or a matrix that is not positive semidefinite.
    #[error("{field} is negative: a weight must be at least 0")]
    Negative {
        /// The field.
        field: &'static str,
    },
    /// A value that must be above zero is not.
    #[error("{field} must be greater than 0")]
    NotPositive {
        /// The field.
        field: &'static str,
    },
    /// P is not symmetric.
    #[error("p_terminal is not symmetric")]
    NotSymmetric,
    /// A lower bound above its upper bound.
    #[error("u_min is above u_max at knot {knot}")]
    Bounds {
        /// The knot.
        knot: usize,
    },
    /// A roll of 90° or more: the kinematics have no meaning there.
    #[error("{field} holds a roll of 90° or more")]
    Roll {
        /// The field.
        field: &'static str,
    },
}

impl<const NX: usize> Problem<NX> {
    /// A problem of `horizon` knots with zero references, the weights of the formulation that ships (Q = 2, 2, 1, 1e-3, 1e-3,
    /// P = Q, R = 1, 1), −0.5 ≤ v ≤ 1.0 m/s, |q_r| ≤ 20°, and nothing else.
    pub fn new(model: Discretisation<NX>, horizon: usize) -> Self {
        let q = SVector::from_fn(|i, _| [2.0, 2.0, 1.0, 1e-3, 1e-3][i.min(4)]);
        let roll = 20.0_f64.to_radians();
        Self {
            model,
            first_input: FirstInput::Decided,
            x0: SVector::zeros(),
            u_prev: Vector2::zeros(),
            x_ref: vec![SVector::zeros(); horizon],
            u_ref: vec![Vector2::zeros(); horizon],
            q,
            p_terminal: SMatrix::from_diagonal(&q),
            r: Vector2::new(1.0, 1.0),
            r_rate: Vector2::zeros(),
            u_min: vec![Vector2::new(-0.5, -roll); horizon],
            u_max: vec![Vector2::new(1.0, roll); horizon],
            du_max: None,
            half_planes: Vec::new(),
            turn_limit: None,
        }
    }

    /// Number of knots N.
    pub fn horizon(&self) -> usize {
        self.x_ref.len()
    }

    /// Sets the same bounds for every knot [m/s, rad].
    pub fn set_bounds(&mut self, min: Vector2<f64>, max: Vector2<f64>) {
        self.u_min.fill(min);
        self.u_max.fill(max);
    }

    /// Adds a half-plane for the position of xᵢ₊₁; the first one makes room. Whether there is such a knot with room for it.
    pub fn add_half_plane(&mut self, i: usize, plane: HalfPlane) -> bool {
        if self.half_planes.is_empty() {
            self.half_planes.resize(self.horizon(), ArrayVec::new());
        }
        self.half_planes
            .get_mut(i)
            .is_some_and(|row| row.try_push(plane).is_ok())
    }

    /// Half-planes for the position of xᵢ₊₁.
    pub(super) fn half_planes_at(&self, i: usize) -> &[HalfPlane] {
        self.half_planes.get(i).map_or(&[], |row| row)
    }

    /// Whether consecutive inputs are coupled, by a cost or by a bound on their difference.
    pub fn couples_inputs(&self) -> bool {
        self.du_max.is_some() || self.r_rate != Vector2::zeros()
    }

    /// Bounds of q_c at knot `i` for the speed `v` [m/s] of that knot: |q_c| ≤ atan(turn_limit/v²) inside `u_min`, `u_max` [rad].
    ///
    /// Where the turn limit lies outside the bounds altogether the nearest bound holds.
    pub fn roll_bounds(&self, i: usize, v: f64) -> (f64, f64) {
        let (min, max) = (self.u_min[i][1], self.u_max[i][1]);
        match self.turn_limit {
            None => (min, max),
            Some(limit) => {
                // atan2: v = 0 is 90°.
                let roll = limit.atan2(v * v);
                ((-roll).clamp(min, max), roll.clamp(min, max))
            }
        }
    }

    /// Whether the problem makes sense at all.
    ///
    /// # Errors
    /// The first field with a wrong number of rows, a value that is not finite, a negative weight or crossed bounds.
    pub fn validate(&self) -> Result<(), ProblemError> {
        let horizon = self.horizon();
        if horizon == 0 {
            return Err(ProblemError::Empty);
        }
        let none = if self.half_planes.is_empty() {
            horizon
        } else {
            0
        };
        for (field, rows) in [
            ("u_ref", self.u_ref.len()),
            ("u_min", self.u_min.len()),
            ("u_max", self.u_max.len()),
            // None is as good as N empty rows.
            ("half_planes", self.half_planes.len().max(none)),
        ] {
            if rows != horizon {
                return Err(ProblemError::Rows {
                    field,
                    rows,
                    horizon,
                });
            }
        }
        if !self.model.is_valid() {
            return Err(ProblemError::NotPositive {
                field: "period, radius or lag of the model",
            });
        }
        finite("x0", self.x0.iter())?;
        finite("u_prev", self.u_prev.iter())?;
        finite("x_ref", self.x_ref.iter().flat_map(|x| x.iter()))?;
        finite("u_ref", self.u_ref.iter().flat_map(|u| u.iter()))?;
        finite("u_min", self.u_min.iter().flat_map(|u| u.iter()))?;
        finite("u_max", self.u_max.iter().flat_map(|u| u.iter()))?;
        weight("q", self.q.iter())?;
        weight("r", self.r.iter())?;
        weight("r_rate", self.r_rate.iter())?;
        self.validate_terminal()?;
        if let Some(du) = &self.du_max {
            weight("du_max", du.iter())?;
        }
        if let Some(limit) = self.turn_limit {
            weight("turn_limit", [limit].iter())?;
        }
        for plane in self.half_planes.iter().flatten() {
            finite("half_planes", plane.normal.iter().chain([&plane.offset]))?;
            weight("half_planes", [plane.weight].iter())?;
        }
        self.validate_inputs()
    }

    /// P finite, symmetric to rounding, and positive semidefinite to rounding.
    fn validate_terminal(&self) -> Result<(), ProblemError> {
        let p = &self.p_terminal;
        finite("p_terminal", p.iter())?;
        let size = p.amax();
        if (p - p.transpose()).amax() > 1e-9 * size {
            return Err(ProblemError::NotSymmetric);
        }
        // A semidefinite matrix has a Cholesky factor once it is shifted by more than its rounding.
        let shifted = p + SMatrix::identity() * (1e-9 * size + f64::MIN_POSITIVE);
        match shifted.cholesky() {
            Some(_) => Ok(()),
            None => Err(ProblemError::Negative {
                field: "p_terminal",
            }),
        }
    }

    fn validate_inputs(&self) -> Result<(), ProblemError> {
        for (knot, (min, max)) in self.u_min.iter().zip(&self.u_max).enumerate() {
            if min[0] > max[0] || min[1] > max[1] {
                return Err(ProblemError::Bounds { knot });
            }
            if min[1] <= -ROLL_END || max[1] >= ROLL_END {
                return Err(ProblemError::Roll {
                    field: "u_min, u_max",
                });
            }
        }
        if self.first_input == FirstInput::Measured && self.u_prev[1].abs() >= ROLL_END {
            return Err(ProblemError::Roll { field: "u_prev" });
        }
        if NX == 5 && self.x0[4].abs() >= ROLL_END {
            return Err(ProblemError::Roll { field: "x0" });
        }
        Ok(())
    }
}

impl HalfPlane {
    /// nᵀ(X, Y) − b [m]: below 0 on the forbidden side.
    pub fn gap(&self, x: f64, y: f64) -> f64 {
        self.normal[0] * x + self.normal[1] * y - self.offset
    }
}

/// Most half-planes of one knot: six robots and two walls.
pub const HALF_PLANES_MAX: usize = 8;

/// A roll that the kinematics cannot have [rad].
const ROLL_END: f64 = core::f64::consts::FRAC_PI_2;

fn finite<'a>(
    field: &'static str,
    mut values: impl Iterator<Item = &'a f64>,
) -> Result<(), ProblemError> {
    if values.all(|value| value.is_finite()) {
        Ok(())
    } else {
        Err(ProblemError::NotFinite { field })
    }
}

fn weight<'a>(
    field: &'static str,
    values: impl Iterator<Item = &'a f64> + Clone,
) -> Result<(), ProblemError> {
    finite(field, values.clone())?;
    if values.into_iter().all(|value| *value >= 0.0) {
        Ok(())
    } else {
        Err(ProblemError::Negative { field })
    }
}
