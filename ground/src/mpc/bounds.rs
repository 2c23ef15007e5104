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

/// How bounds from the turn limit follow the speeds of a new iterate.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Follow {
    Fully,
    Partly(f64),
    Inwards,
}

impl Follow {
    /// For iteration `iteration`, from 1.
    pub(super) fn at(iteration: u32) -> Self {
        match iteration {
            ..=6 => Self::Fully,
            7..=20 => Self::Partly(0.5),
            21..=60 => Self::Partly(0.2),
            _ => Self::Inwards,
        }
    }
}

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

    /// Sets the bounds for the speeds of `point`. Returns by how much they miss those that the speeds ask for [rad].
    ///
    /// A slower plan may roll more and one that rolls more be slower: the two can chase each other, so later iterations follow
    /// partly, and the last ones only narrow (where narrower is no miss).
    pub(super) fn refresh<const NX: usize>(
        &mut self,
        problem: &Problem<NX>,
        point: &Point<NX>,
        follow: Follow,
    ) -> f64 {
        let mut missed: f64 = 0.0;
        for i in 0..self.lower.len() {
            let (min, max) = roll_bounds(problem, point, i);
            let (last_min, last_max) = (self.lower[i][1], self.upper[i][1]);
            let (lower, upper) = match follow {
                Follow::Fully => (min, max),
                Follow::Partly(share) => {
                    let lower = last_min + share * (min - last_min);
                    let upper = last_max + share * (max - last_max);
                    missed = missed.max((lower - min).abs()).max((upper - max).abs());
                    (lower, upper)
                }
                Follow::Inwards => (min.max(last_min), max.min(last_max)),
            };
            self.lower[i] = Vector2::new(problem.u_min[i][0], lower);
            self.upper[i] = Vector2::new(problem.u_max[i][0], upper);
        }
        missed
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
