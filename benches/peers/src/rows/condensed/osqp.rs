//! OSQP, an operator-splitting solver: warm from the last QP's solution, factorised anew for each Hessian.

use osqp::{CscMatrix, Problem, Settings, Status};

use super::{Boxed, Qp};

#[derive(Default)]
pub(super) struct Osqp {
    problem: Option<Problem>,
}

impl Boxed for Osqp {
    fn solve(&mut self, qp: &mut Qp) -> bool {
        let size = qp.step.len();
        let triangle = (0..size).flat_map(|j| (0..=j).map(move |i| (i, j)));
        let hessian = CscMatrix {
            nrows: size,
            ncols: size,
            indptr: (0..=size).map(|j| j * (j + 1) / 2).collect(),
            indices: triangle.clone().map(|(i, _)| i).collect(),
            data: triangle.map(|ij| qp.hessian[ij]).collect(),
        };
        let (gradient, lower, upper) = (
            qp.gradient.as_slice(),
            qp.lower.as_slice(),
            qp.upper.as_slice(),
        );
        let problem = match &mut self.problem {
            Some(problem) => {
                problem.update_P(hessian);
                problem.update_lin_cost(gradient);
                problem.update_bounds(lower, upper);
                problem
            }
            None => {
                let identity = CscMatrix {
                    nrows: size,
                    ncols: size,
                    indptr: (0..=size).collect(),
                    indices: (0..size).collect(),
                    data: vec![1.0; size].into(),
                };
                let settings = Settings::default()
                    .verbose(false)
                    .eps_abs(1e-7)
                    .eps_rel(1e-7)
                    // Refines by the active set that it has found: far cheaper than a tighter tolerance.
                    .polish(true)
                    .max_iter(20_000);
                match Problem::new(hessian, gradient, identity, lower, upper, &settings) {
                    Ok(problem) => self.problem.insert(problem),
                    Err(_) => return false,
                }
            }
        };
        // The QP is in the step from the present point: its best guess is none. The multipliers stay.
        problem.warm_start_x(&vec![0.0; size]);
        match problem.solve() {
            Status::Solved(solution) => {
                qp.step.copy_from_slice(solution.x());
                true
            }
            _ => false,
        }
    }
}
