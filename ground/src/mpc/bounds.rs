//! Bounds of every knot's input at the current point, and the start that respects them.
//!
//! The turn limit bounds the roll by the speed of the last iterate. Where the change of the input is bounded as well, bounds
//! are narrowed backwards to the inputs from which the later ones can be reached, so that a forward pass never gets stuck.

use nalgebra::Vector2;

use super::problem::Problem;
use super::subproblem::Point;

/// No input satisfies bounds and rate together.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Infeasible;

/// Lower and upper bounds of the inputs, N rows each.
#[derive(Clone, Debug)]
pub(super) struct Bounds {
    pub(super) lower: Vec<Vector2<f64>>,
    pub(super) upper: Vec<Vector2<f64>>,
}

impl Bounds {
    pub(super) fn new(horizon: usize) -> Self {
        Self {
            lower: vec![Vector2::zeros(); horizon],
            upper: vec![Vector2::zeros(); horizon],
        }
    }

    /// Sets the bounds for the speeds of `point`; only narrows the last ones if `narrow`.
    pub(super) fn refresh<const NX: usize>(
        &mut self,
        problem: &Problem<NX>,
        point: &Point<NX>,
        narrow: bool,
    ) {
        for i in 0..self.lower.len() {
            let (mut min, mut max) = roll_bounds(problem, point, i);
            if narrow {
                min = min.max(self.lower[i][1]);
                max = max.min(self.upper[i][1]);
            }
            self.lower[i] = Vector2::new(problem.u_min[i][0], min);
            self.upper[i] = Vector2::new(problem.u_max[i][0], max);
        }
    }

    /// Moves the inputs of `point` into the bounds, and within `du_max` of their predecessor.
    pub(super) fn restrict<const NX: usize>(
        &mut self,
        problem: &Problem<NX>,
        point: &mut Point<NX>,
    ) -> Result<(), Infeasible> {
        let Some(du_max) = problem.du_max else {
            for ((u, lower), upper) in point.u.iter_mut().zip(&self.lower).zip(&self.upper) {
                *u = u.zip_zip_map(lower, upper, |u, lower, upper| u.clamp(lower, upper));
            }
            return Ok(());
        };
        for i in (1..self.lower.len()).rev() {
            self.lower[i - 1] = self.lower[i - 1].sup(&(self.lower[i] - du_max));
            self.upper[i - 1] = self.upper[i - 1].inf(&(self.upper[i] + du_max));
        }
        let mut before = problem.u_prev;
        for (i, u) in point.u.iter_mut().enumerate() {
            let lower = self.lower[i].sup(&(before - du_max));
            let upper = self.upper[i].inf(&(before + du_max));
            for j in 0..2 {
                // A gap of rounding alone is no contradiction.
                if lower[j] > upper[j] + 1e-12 {
                    return Err(Infeasible);
                }
                u[j] = u[j].min(upper[j]).max(lower[j].min(upper[j]));
            }
            before = *u;
        }
        Ok(())
    }
}

/// Bounds of q_c at knot `i` for the speeds of `point`.
///
/// The roll must be bearable at the speed that is commanded and at the one that the knot begins with.
pub(super) fn roll_bounds<const NX: usize>(
    problem: &Problem<NX>,
    point: &Point<NX>,
    i: usize,
) -> (f64, f64) {
    let commanded = point.u[i][0].abs();
    let v = if NX == 5 {
        commanded.max(point.x[i][3].abs())
    } else {
        commanded
    };
    problem.roll_bounds(i, v)
}
