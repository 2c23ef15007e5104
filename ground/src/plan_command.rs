//! `sphere-ground plan`: solves the problems of a file exactly as given, each on its own from its references.
//!
//! No limit, saturation, shift or new reference is added to what the file says. Takes text and gives text: files and the clock
//! belong to the caller.

pub mod problem_file;

use serde::Serialize;
use serde_json::Value;

pub use self::problem_file::{AnyProblem, Instance, Kind, ProblemFileError, parse};
use crate::mpc::{FirstInput, Method, Mpc, Options, Problem, Solver, Status, kkt_residual};

/// The solution of one instance, as it is printed.
#[derive(Clone, Debug, Serialize)]
pub struct Report {
    /// The instance's id.
    pub id: Value,
    /// Inputs [m/s, rad], N rows; for kind `paper` N + 1 rows, the first one measured.
    pub u_opt_mps_rad: Vec<[f64; 2]>,
    /// States, N + 1 rows.
    pub x_opt_m_m_rad_mps_rad: Vec<Vec<f64>>,
    /// Cost; null if there is no point.
    pub cost_unitless: f64,
    /// First-order residual, recomputed from the point; null if there is none.
    pub kkt_residual_inf: f64,
    /// SQP iterations.
    pub iterations: u32,
    /// `riccati` or `clarabel`.
    pub solver: String,
    /// `solved`, `max-iterations`, `infeasible` or `refused`.
    pub status: String,
    /// Time of the solve [µs].
    pub solve_time_us: f64,
    /// What the table shows besides.
    #[serde(skip)]
    pub summary: Summary,
}

/// What the table shows besides the printed fields.
#[derive(Clone, Debug)]
pub struct Summary {
    /// Kind of the instance.
    pub kind: Kind,
    /// Number of knots.
    pub horizon: usize,
    /// The input to apply [m/s, rad].
    pub applied: Option<[f64; 2]>,
    /// How it ended.
    pub status: Status,
    /// What solved it.
    pub method: Method,
    /// Why it was refused.
    pub refusal: Option<String>,
}

/// Solves one instance with `solver`. `clock` tells the time [s].
pub fn solve(instance: &Instance, solver: Solver, clock: &mut impl FnMut() -> f64) -> Report {
    match &instance.problem {
        AnyProblem::Three(problem) => report(instance, problem, solver, clock),
        AnyProblem::Five(problem) => report(instance, problem, solver, clock),
    }
}

/// The reports as the JSON that `--json` prints.
///
/// # Errors
/// None in practice: reports hold numbers and texts only.
pub fn to_json(reports: &[Report]) -> Result<String, serde_json::Error> {
    #[derive(Serialize)]
    struct Output<'a> {
        instances: &'a [Report],
    }
    serde_json::to_string_pretty(&Output { instances: reports })
}

/// The reports as a table for people.
pub fn to_table(reports: &[Report]) -> String {
    let mut rows = vec![HEADER.map(str::to_owned)];
    for report in reports {
        let summary = &report.summary;
        let [v, q] = summary
            .applied
            .map_or(["-".to_owned(), "-".to_owned()], |[v, q]| {
                [format!("{v:.4}"), format!("{:.3}", q.to_degrees())]
            });
        rows.push([
            match &report.id {
                Value::String(id) => id.clone(),
                id => id.to_string(),
            },
            summary.kind.to_string(),
            summary.horizon.to_string(),
            report.status.clone(),
            report.solver.clone(),
            report.iterations.to_string(),
            format!("{:.6}", report.cost_unitless),
            format!("{:.1e}", report.kkt_residual_inf),
            format!("{:.1}", report.solve_time_us),
            v,
            q,
        ]);
    }
    let width = |column: usize| {
        rows.iter()
            .map(|row| row[column].chars().count())
            .max()
            .unwrap_or(0)
    };
    let widths: Vec<usize> = (0..HEADER.len()).map(width).collect();
    let mut table = String::new();
    for row in &rows {
        for (column, (cell, width)) in row.iter().zip(&widths).enumerate() {
            // Texts to the left, numbers to the right.
            let cell = if TEXT_COLUMNS.contains(&column) {
                format!("{cell:<width$}  ")
            } else {
                format!("{cell:>width$}  ")
            };
            table.push_str(&cell);
        }
        table.truncate(table.trim_end().len());
        table.push('\n');
    }
    table
}

const HEADER: [&str; 11] = [
    "id",
    "kind",
    "N",
    "status",
    "solver",
    "iterations",
    "cost",
    "KKT",
    "time [µs]",
    "v [m/s]",
    "q_r [°]",
];
const TEXT_COLUMNS: [usize; 3] = [1, 3, 4];

fn report<const NX: usize>(
    instance: &Instance,
    problem: &Problem<NX>,
    solver: Solver,
    clock: &mut impl FnMut() -> f64,
) -> Report {
    let options = Options {
        solver,
        ..Options::default()
    };
    let mut mpc = Mpc::new(problem.horizon(), options);
    let start = clock();
    let solution = mpc.solve(problem);
    let solve_time_us = (clock() - start) * 1e6;
    let residual = if solution.u.is_empty() {
        f64::NAN
    } else {
        kkt_residual(problem, &solution.x, &solution.u)
    };
    let measured = (problem.first_input == FirstInput::Measured && !solution.u.is_empty())
        .then_some(&problem.u_prev);
    Report {
        id: instance.id.clone(),
        u_opt_mps_rad: measured
            .into_iter()
            .chain(&solution.u)
            .map(|u| [u[0], u[1]])
            .collect(),
        x_opt_m_m_rad_mps_rad: solution
            .x
            .iter()
            .map(|x| x.iter().copied().collect())
            .collect(),
        cost_unitless: solution.cost,
        kkt_residual_inf: residual,
        iterations: solution.iterations,
        solver: solution.method.to_string(),
        status: solution.status.to_string(),
        solve_time_us,
        summary: Summary {
            kind: instance.kind,
            horizon: problem.horizon(),
            applied: solution.u.first().map(|u| [u[0], u[1]]),
            status: solution.status,
            method: solution.method,
            refusal: solution.refusal.map(|refusal| refusal.to_string()),
        },
    }
}
