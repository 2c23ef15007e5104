//! Clarabel, an interior-point solver: every QP from the beginning, symbolic work once.

use clarabel::algebra::CscMatrix;
use clarabel::solver::{DefaultSettings, DefaultSolver, IPSolver, SolverStatus, SupportedConeT};

use super::{Boxed, Qp};

#[derive(Default)]
pub(super) struct Clarabel {
    solver: Option<DefaultSolver<f64>>,
    upper_triangle: Vec<f64>,
    limits: Vec<f64>,
}

impl Boxed for Clarabel {
    fn solve(&mut self, qp: &mut Qp) -> bool {
        let size = qp.step.len();
        self.upper_triangle.clear();
        for j in 0..size {
            self.upper_triangle
                .extend((0..=j).map(|i| qp.hessian[(i, j)]));
        }
        self.limits.clear();
        self.limits.extend(qp.upper.iter());
        self.limits.extend(qp.lower.iter().map(|lower| -lower));
        let gradient = qp.gradient.as_slice();
        let solver = match &mut self.solver {
            Some(solver) => {
                let updated = solver
                    .update_P(&self.upper_triangle)
                    .and_then(|()| solver.update_q(&gradient.to_vec()))
                    .and_then(|()| solver.update_b(&self.limits));
                if updated.is_err() {
                    return false;
                }
                solver
            }
            None => match build(size, &self.upper_triangle, gradient, &self.limits) {
                Some(solver) => self.solver.insert(solver),
                None => return false,
            },
        };
        solver.solve();
        qp.step.copy_from_slice(&solver.solution.x);
        matches!(
            solver.solution.status,
            SolverStatus::Solved | SolverStatus::AlmostSolved
        )
    }
}

fn build(
    size: usize,
    upper_triangle: &[f64],
    gradient: &[f64],
    limits: &[f64],
) -> Option<DefaultSolver<f64>> {
    let starts: Vec<usize> = (0..=size).map(|j| j * (j + 1) / 2).collect();
    let rows: Vec<usize> = (0..size).flat_map(|j| 0..=j).collect();
    let hessian = CscMatrix::new(size, size, starts, rows, upper_triangle.to_vec());
    let bounds = CscMatrix::new(
        2 * size,
        size,
        (0..=size).map(|j| 2 * j).collect(),
        (0..size).flat_map(|j| [j, size + j]).collect(),
        (0..size).flat_map(|_| [1.0, -1.0]).collect(),
    );
    // Tolerances below the SQP's step, and what data updates need.
    let settings = DefaultSettings {
        verbose: false,
        max_iter: 100,
        presolve_enable: false,
        input_sparse_dropzeros: false,
        equilibrate_enable: false,
        tol_gap_abs: 1e-8,
        tol_gap_rel: 1e-8,
        tol_feas: 1e-8,
        ..DefaultSettings::default()
    };
    let cones = [SupportedConeT::NonnegativeConeT(2 * size)];
    DefaultSolver::new(&hessian, gradient, &bounds, limits, &cones, settings).ok()
}
