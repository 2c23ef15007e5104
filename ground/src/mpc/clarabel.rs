//! The subproblem by Clarabel, an interior-point solver: for bounds and costs on the change of the input, as the fallback of the
//! Riccati sweep, and as its independent check.
//!
//! Differs from the Riccati sweep: Gauss-Newton steps alone, because Clarabel refuses an indefinite Hessian.
//!
//! The sparsity pattern depends on the horizon and on which terms a problem has; while it stays the same the solver's data are
//! updated in place. That needs its presolve and its dropping of zeros off. Its time limit must stay unset: after an update
//! it counts all earlier solves (oxfordcontrol/Clarabel.rs#233), and wall time is no criterion here anyway.

use clarabel::algebra::CscMatrix;
use clarabel::solver::{DefaultSettings, DefaultSolver, IPSolver, SolverStatus, SupportedConeT};
use nalgebra::Vector2;

use super::problem::Problem;
use super::subproblem::{Point, Step, Subproblem};

/// Clarabel with the problem it was last built for.
pub(super) struct ClarabelQp<const NX: usize> {
    hessian: Columns,
    constraints: Columns,
    gradient: Vec<f64>,
    limits: Vec<f64>,
    built: Option<Built>,
}

/// Why there is no step.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum ClarabelError {
    /// The constraints contradict each other.
    Infeasible,
    /// No convergence.
    Failed,
}

/// A solver, and the patterns it was built for.
struct Built {
    solver: DefaultSolver<f64>,
    hessian: Columns,
    constraints: Columns,
}

/// A sparse matrix written column by column.
#[derive(Clone, Default)]
struct Columns {
    starts: Vec<usize>,
    rows: Vec<usize>,
    values: Vec<f64>,
}

impl<const NX: usize> ClarabelQp<NX> {
    pub(super) fn new() -> Self {
        Self {
            hessian: Columns::default(),
            constraints: Columns::default(),
            gradient: Vec::new(),
            limits: Vec::new(),
            built: None,
        }
    }

    /// Solves the Gauss-Newton `subproblem` of `problem` at `point`, and writes the step.
    pub(super) fn solve(
        &mut self,
        problem: &Problem<NX>,
        point: &Point<NX>,
        subproblem: &Subproblem<NX>,
        step: &mut Step<NX>,
    ) -> Result<(), ClarabelError> {
        let layout = Layout::new(problem, subproblem);
        self.write_hessian(problem, subproblem);
        self.write_constraints(subproblem, &layout);
        self.write_vectors(problem, point, subproblem, &layout);
        self.run(&layout)?;
        let Some(built) = &self.built else {
            return Err(ClarabelError::Failed);
        };
        let solution = &built.solver.solution;
        let mut column = 0;
        for (k, stage) in subproblem.stages.iter().enumerate() {
            step.du[k] = Vector2::new(solution.x[column], solution.x[column + 1]).zip_zip_map(
                &stage.du_min,
                &stage.du_max,
                |du, min, max| du.min(max).max(min),
            );
            for j in 0..NX {
                step.dx[k + 1][j] = solution.x[column + 2 + j];
                step.lambda[k][j] = -solution.z[NX * k + j];
            }
            column += 2 + NX + subproblem.planes[k + 1].len();
        }
        Ok(())
    }

    /// Upper triangle of the Hessian by (δuₖ, δxₖ₊₁, slacks of xₖ₊₁) for each stage.
    fn write_hessian(&mut self, problem: &Problem<NX>, subproblem: &Subproblem<NX>) {
        let horizon = subproblem.stages.len();
        let couples = problem.couples_inputs();
        let columns = &mut self.hessian;
        columns.clear();
        let mut before = None;
        for k in 0..horizon {
            let first = columns.count();
            for j in 0..2 {
                let rate = 2.0 * problem.r_rate[j];
                if let Some(before) = before
                    && couples
                {
                    columns.push(before + j, -rate);
                }
                // (uₖ − uₖ₋₁)² and (uₖ₊₁ − uₖ)²: the last input is in one of them alone.
                let terms = if k + 1 < horizon { 2.0 } else { 1.0 };
                columns.push(first + j, subproblem.input_weight[j] + terms * rate);
                columns.close();
            }
            for j in 0..NX {
                if k + 1 == subproblem.last {
                    for row in 0..j {
                        columns.push(first + 2 + row, subproblem.terminal[(row, j)]);
                    }
                    columns.push(first + 2 + j, subproblem.terminal[(j, j)]);
                } else {
                    let weighed = k + 1 < subproblem.last;
                    columns.push(
                        first + 2 + j,
                        if weighed { subproblem.weight[j] } else { 0.0 },
                    );
                }
                columns.close();
            }
            for plane in &subproblem.planes[k + 1] {
                // A plane without weight would leave its slack without a unique value.
                let here = columns.count();
                columns.push(here, plane.weight.max(1e-9));
                columns.close();
            }
            before = Some(first);
        }
    }

    fn write_constraints(&mut self, subproblem: &Subproblem<NX>, layout: &Layout) {
        let horizon = subproblem.stages.len();
        let columns = &mut self.constraints;
        columns.clear();
        let mut plane_row = layout.planes;
        for (k, stage) in subproblem.stages.iter().enumerate() {
            for j in 0..2 {
                for row in 0..NX {
                    columns.push(NX * k + row, -stage.b[(row, j)]);
                }
                columns.push(layout.bounds + 4 * k + j, 1.0);
                columns.push(layout.bounds + 4 * k + 2 + j, -1.0);
                if layout.rated {
                    columns.push(layout.rates + 4 * k + j, 1.0);
                    columns.push(layout.rates + 4 * k + 2 + j, -1.0);
                    if k + 1 < horizon {
                        columns.push(layout.rates + 4 * (k + 1) + j, -1.0);
                        columns.push(layout.rates + 4 * (k + 1) + 2 + j, 1.0);
                    }
                }
                columns.close();
            }
            let planes = &subproblem.planes[k + 1];
            for j in 0..NX {
                columns.push(NX * k + j, 1.0);
                if let Some(next) = subproblem.stages.get(k + 1) {
                    for row in 0..NX {
                        columns.push(NX * (k + 1) + row, -next.a[(row, j)]);
                    }
                }
                if j < 2 {
                    for (i, plane) in planes.iter().enumerate() {
                        columns.push(plane_row + i, -plane.normal[j]);
                    }
                }
                columns.close();
            }
            for i in 0..planes.len() {
                columns.push(plane_row + i, -1.0);
                columns.close();
            }
            plane_row += planes.len();
        }
    }

    fn write_vectors(
        &mut self,
        problem: &Problem<NX>,
        point: &Point<NX>,
        subproblem: &Subproblem<NX>,
        layout: &Layout,
    ) {
        self.gradient.clear();
        self.limits.clear();
        self.limits.resize(layout.rows, 0.0);
        let mut plane_row = layout.planes;
        let mut before = problem.u_prev;
        for (k, stage) in subproblem.stages.iter().enumerate() {
            let u = point.u[k];
            let mut gradient = stage.u_gradient + (u - before).component_mul(&problem.r_rate) * 2.0;
            if let Some(next) = point.u.get(k + 1) {
                gradient -= (next - u).component_mul(&problem.r_rate) * 2.0;
            }
            self.gradient.extend(gradient.iter());
            self.gradient.extend(subproblem.x_gradient[k + 1].iter());
            for j in 0..NX {
                self.limits[NX * k + j] = stage.c[j];
            }
            for j in 0..2 {
                self.limits[layout.bounds + 4 * k + j] = stage.du_max[j];
                self.limits[layout.bounds + 4 * k + 2 + j] = -stage.du_min[j];
            }
            if let Some(du_max) = problem.du_max {
                let change = u - before;
                for j in 0..2 {
                    self.limits[layout.rates + 4 * k + j] = du_max[j] - change[j];
                    self.limits[layout.rates + 4 * k + 2 + j] = du_max[j] + change[j];
                }
            }
            // gap + nᵀδ(X, Y) + slack ≥ 0
            for plane in &subproblem.planes[k + 1] {
                self.gradient.push(0.0);
                self.limits[plane_row] = plane.gap;
                plane_row += 1;
            }
            before = u;
        }
    }

    /// Updates the solver, or builds it anew for another pattern, and runs it.
    fn run(&mut self, layout: &Layout) -> Result<(), ClarabelError> {
        let known = self.built.as_mut().filter(|built| {
            built.hessian.same_pattern(&self.hessian)
                && built.constraints.same_pattern(&self.constraints)
        });
        match known {
            Some(built) => built
                .solver
                .update_data(
                    &self.hessian.values,
                    &self.gradient,
                    &self.constraints.values,
                    &self.limits,
                )
                .map_err(|_| ClarabelError::Failed)?,
            None => {
                let columns = self.gradient.len();
                let cones = [
                    SupportedConeT::ZeroConeT(layout.bounds),
                    SupportedConeT::NonnegativeConeT(layout.rows - layout.bounds),
                ];
                let solver = DefaultSolver::new(
                    &self.hessian.matrix(columns),
                    &self.gradient,
                    &self.constraints.matrix(layout.rows),
                    &self.limits,
                    &cones,
                    settings(),
                )
                .map_err(|_| ClarabelError::Failed)?;
                self.built = Some(Built {
                    solver,
                    hessian: self.hessian.clone(),
                    constraints: self.constraints.clone(),
                });
            }
        }
        let Some(built) = &mut self.built else {
            return Err(ClarabelError::Failed);
        };
        built.solver.solve();
        let solution = &built.solver.solution;
        match solution.status {
            SolverStatus::Solved | SolverStatus::AlmostSolved => Ok(()),
            SolverStatus::PrimalInfeasible | SolverStatus::AlmostPrimalInfeasible => {
                Err(ClarabelError::Infeasible)
            }
            // Clarabel gives up on some small problems at the very end (oxfordcontrol/Clarabel.rs#216): judge the point.
            SolverStatus::InsufficientProgress | SolverStatus::MaxIterations
                if solution.r_prim < 1e-7 && solution.r_dual < 1e-7 =>
            {
                Ok(())
            }
            _ => Err(ClarabelError::Failed),
        }
    }
}

/// Where each kind of constraint has its rows: dynamics first, then what must not be negative.
struct Layout {
    bounds: usize,
    rates: usize,
    rated: bool,
    planes: usize,
    rows: usize,
}

impl Layout {
    fn new<const NX: usize>(problem: &Problem<NX>, subproblem: &Subproblem<NX>) -> Self {
        let horizon = subproblem.stages.len();
        let rated = problem.du_max.is_some();
        let bounds = NX * horizon;
        let rates = bounds + 4 * horizon;
        let planes = rates + if rated { 4 * horizon } else { 0 };
        let count: usize = subproblem.planes[1..]
            .iter()
            .map(|planes| planes.len())
            .sum();
        Self {
            bounds,
            rates,
            rated,
            planes,
            rows: planes + count,
        }
    }
}

impl Columns {
    fn clear(&mut self) {
        self.starts.clear();
        self.starts.push(0);
        self.rows.clear();
        self.values.clear();
    }

    /// Columns closed so far.
    fn count(&self) -> usize {
        self.starts.len() - 1
    }

    fn push(&mut self, row: usize, value: f64) {
        self.rows.push(row);
        self.values.push(value);
    }

    fn close(&mut self) {
        self.starts.push(self.rows.len());
    }

    fn same_pattern(&self, other: &Self) -> bool {
        self.starts == other.starts && self.rows == other.rows
    }

    fn matrix(&self, rows: usize) -> CscMatrix<f64> {
        CscMatrix::new(
            rows,
            self.count(),
            self.starts.clone(),
            self.rows.clone(),
            self.values.clone(),
        )
    }
}

fn settings() -> DefaultSettings<f64> {
    DefaultSettings {
        verbose: false,
        max_iter: 100,
        presolve_enable: false,
        input_sparse_dropzeros: false,
        // An update keeps the scaling of the first problem: better none.
        equilibrate_enable: false,
        tol_gap_abs: 1e-10,
        tol_gap_rel: 1e-10,
        tol_feas: 1e-10,
        ..DefaultSettings::default()
    }
}
