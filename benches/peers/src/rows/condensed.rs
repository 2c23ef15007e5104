//! Gauss-Newton SQP on the inputs alone: the states are eliminated, what is left for a general QP solver has 2 N variables and
//! bounds.
//!
//! Full steps from the shifted last solution until one is below 1e-6 m/s and rad: the tolerance of the rows by CasADi.

mod clarabel;
mod osqp;

use nalgebra::{DMatrix, DVector, SMatrix, SVector, Vector2};
use sphere_ground::mpc::{FirstInput, Problem};

use super::{Pass, Solved};

/// Clarabel on the condensed QP, its data updated in place.
pub fn clarabel<const NX: usize>(problems: &[Problem<NX>]) -> Pass {
    sqp(problems, clarabel::Clarabel::default())
}

/// OSQP on the condensed QP, its data updated in place, warm from the last one.
pub fn osqp<const NX: usize>(problems: &[Problem<NX>]) -> Pass {
    sqp(problems, osqp::Osqp::default())
}

/// A solver of min ½ zᵀHz + gᵀz, lower ≤ z ≤ upper.
trait Boxed {
    /// Writes the solution to `qp.step`; whether there is one.
    fn solve(&mut self, qp: &mut Qp) -> bool;
}

/// The condensed QP at a point, and its solution.
struct Qp {
    hessian: DMatrix<f64>,
    gradient: DVector<f64>,
    lower: DVector<f64>,
    upper: DVector<f64>,
    step: DVector<f64>,
}

fn sqp<const NX: usize>(problems: &[Problem<NX>], mut solver: impl Boxed) -> Pass {
    let mut last: Option<Vec<Vector2<f64>>> = None;
    let mut condenser = Condenser::<NX>::new(problems[0].horizon());
    Pass::one_by_one(problems, |problem, u| {
        match &mut last {
            Some(last) => {
                last.rotate_left(1);
                let end = last.len() - 1;
                last[end] = last[end - 1];
                u.clone_from(last);
            }
            None => u.clone_from(&problem.u_ref),
        }
        for (k, u) in u.iter_mut().enumerate() {
            *u = u.sup(&problem.u_min[k]).inf(&problem.u_max[k]);
        }
        let mut iterations = 0;
        let mut is_solved = false;
        while iterations < ITERATIONS_MAX && !is_solved {
            iterations += 1;
            condenser.condense(problem, u);
            let qp = &mut condenser.qp;
            if !solver.solve(qp) {
                break;
            }
            for (k, u) in u.iter_mut().enumerate() {
                let step = Vector2::new(qp.step[2 * k], qp.step[2 * k + 1]);
                *u = (*u + step).sup(&problem.u_min[k]).inf(&problem.u_max[k]);
            }
            is_solved = qp.step.amax() <= STEP;
        }
        last = Some(u.clone());
        Solved {
            iterations,
            is_solved,
        }
    })
}

/// Eliminates the states.
struct Condenser<const NX: usize> {
    qp: Qp,
    /// ∂xₖ/∂u of the present state, NX × 2N, column blocks before it filled.
    by_inputs: Vec<SMatrix<f64, NX, 2>>,
    weighted: Vec<SMatrix<f64, NX, 2>>,
}

impl<const NX: usize> Condenser<NX> {
    fn new(horizon: usize) -> Self {
        let size = 2 * horizon;
        Self {
            qp: Qp {
                hessian: DMatrix::zeros(size, size),
                gradient: DVector::zeros(size),
                lower: DVector::zeros(size),
                upper: DVector::zeros(size),
                step: DVector::zeros(size),
            },
            by_inputs: Vec::with_capacity(horizon),
            weighted: Vec::with_capacity(horizon),
        }
    }

    /// H = 2 (R + Σ GₖᵀWₖGₖ), g = 2 (R (u − u_ref) + Σ GₖᵀWₖ(xₖ − x_ref,ₖ)) with Gₖ = ∂xₖ/∂u along the inputs `u`; upper triangle.
    fn condense(&mut self, problem: &Problem<NX>, u: &[Vector2<f64>]) {
        let horizon = problem.horizon();
        let qp = &mut self.qp;
        qp.hessian.fill(0.0);
        for (k, u) in u.iter().enumerate() {
            for j in 0..2 {
                let i = 2 * k + j;
                qp.hessian[(i, i)] = 2.0 * problem.r[j];
                qp.gradient[i] = 2.0 * problem.r[j] * (u[j] - problem.u_ref[k][j]);
                qp.lower[i] = problem.u_min[k][j] - u[j];
                qp.upper[i] = problem.u_max[k][j] - u[j];
            }
        }
        // With U(0) measured the inputs begin to act at x₁, and the last of them acts beyond the horizon.
        let (mut x, first) = match problem.first_input {
            FirstInput::Decided => (problem.x0, 0),
            FirstInput::Measured => (problem.model.step(&problem.x0, &problem.u_prev), 1),
        };
        self.by_inputs.clear();
        for (k, u) in u.iter().enumerate().take(horizon - first) {
            let knot = problem.model.linearise(&x, u);
            for block in &mut self.by_inputs {
                *block = knot.a * *block;
            }
            self.by_inputs.push(knot.b);
            x = knot.next;
            let row = k + first;
            let weight = if row + 1 == horizon {
                problem.p_terminal
            } else {
                SMatrix::from_diagonal(&problem.q)
            };
            self.add(&weight, &(x - problem.x_ref[row]));
        }
    }

    fn add(&mut self, weight: &SMatrix<f64, NX, NX>, error: &SVector<f64, NX>) {
        let qp = &mut self.qp;
        self.weighted.clear();
        self.weighted
            .extend(self.by_inputs.iter().map(|block| 2.0 * weight * block));
        for (j, right) in self.weighted.iter().enumerate() {
            let mut gradient = qp.gradient.fixed_rows_mut::<2>(2 * j);
            gradient += right.tr_mul(error);
            for (i, left) in self.by_inputs[..=j].iter().enumerate() {
                let mut hessian = qp.hessian.fixed_view_mut::<2, 2>(2 * i, 2 * j);
                hessian += left.tr_mul(right);
            }
        }
    }
}

/// A step that ends the iteration [m/s, rad].
const STEP: f64 = 1e-6;
const ITERATIONS_MAX: u32 = 100;
