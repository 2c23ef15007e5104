//! The Rust side of the comparison with other solvers; `benches/peers/run` calls it.
//!
//! ```text
//! peers record FOLDER                    writes the instances: FOLDER/<set>-<trajectory>.json
//! peers rows SET TRAJECTORY              one pass of every row over the instances, as JSON
//! peers judge SET TRAJECTORY < points    residuals of somebody's inputs, as JSON
//! ```
//!
//! SET is `paper` (eq (20), N = 10) or `lag-N` (the formulation that ships, N knots).

#[path = "../../instances.rs"]
mod instances;
mod record;
mod rows;

use std::io::{Read, stdin};
use std::path::Path;

use anyhow::{Context, bail};
use instances::Trajectory;
use nalgebra::{SVector, Vector2};
use sphere_ground::mpc::{FirstInput, Problem, kkt_residual};

fn main() -> anyhow::Result<()> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let words: Vec<&str> = arguments.iter().map(String::as_str).collect();
    match words[..] {
        ["record", folder] => record::write_all(Path::new(folder)),
        ["rows", set, trajectory] => with_set(set, trajectory, print_rows, print_rows),
        ["judge", set, trajectory] => with_set(set, trajectory, judge, judge),
        _ => bail!("usage: peers record FOLDER | rows SET TRAJECTORY | judge SET TRAJECTORY"),
    }
}

/// Calls one of two functions with the instances of `set`.
fn with_set(
    set: &str,
    trajectory: &str,
    three: impl FnOnce(&[Problem<3>]) -> anyhow::Result<()>,
    five: impl FnOnce(&[Problem<5>]) -> anyhow::Result<()>,
) -> anyhow::Result<()> {
    let trajectory = Trajectory::ALL
        .into_iter()
        .find(|known| known.name() == trajectory)
        .with_context(|| format!("no trajectory `{trajectory}`: line, sine or lemniscate"))?;
    match set.strip_prefix("lag-") {
        None if set == "paper" => three(&instances::paper(trajectory)),
        Some(horizon) => {
            let horizon = horizon
                .parse()
                .with_context(|| format!("`{set}`: a number of knots belongs after lag-"))?;
            five(&instances::lag(trajectory, horizon))
        }
        None => bail!("no set `{set}`: paper or lag-N"),
    }
}

fn print_rows<const NX: usize>(problems: &[Problem<NX>]) -> anyhow::Result<()> {
    let passes: Vec<_> = rows::all::<NX>()
        .into_iter()
        .map(|(name, solve)| solve(problems).named(name))
        .collect();
    println!("{}", serde_json::to_string(&passes)?);
    Ok(())
}

/// Reads the decided inputs of every instance, and prints the KKT residual of each with the states that follow from them.
fn judge<const NX: usize>(problems: &[Problem<NX>]) -> anyhow::Result<()> {
    let mut text = String::new();
    stdin().read_to_string(&mut text)?;
    let points: Vec<Vec<[f64; 2]>> = serde_json::from_str(&text)?;
    if points.len() != problems.len() {
        bail!("{} points for {} problems", points.len(), problems.len());
    }
    let residuals: Vec<Option<f64>> = problems
        .iter()
        .zip(&points)
        .map(|(problem, inputs)| {
            let u: Vec<Vector2<f64>> = inputs.iter().map(|u| (*u).into()).collect();
            // JSON has no infinity: none.
            Some(kkt_residual(problem, &states(problem, &u), &u)).filter(|value| value.is_finite())
        })
        .collect();
    println!("{}", serde_json::to_string(&residuals)?);
    Ok(())
}

/// x₀ … x_N under the decided inputs `u`.
fn states<const NX: usize>(problem: &Problem<NX>, u: &[Vector2<f64>]) -> Vec<SVector<f64, NX>> {
    let mut x = vec![problem.x0];
    if problem.first_input == FirstInput::Measured {
        x.push(problem.model.step(&problem.x0, &problem.u_prev));
    }
    for u in u {
        let last = x[x.len() - 1];
        x.push(problem.model.step(&last, u));
    }
    x.truncate(problem.horizon() + 1);
    x
}
