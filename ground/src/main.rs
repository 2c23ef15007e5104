//! `sphere-ground`: the ground station's commands.

use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use anyhow::{Context, Result};
use clap::{Parser, Subcommand};
use sphere_ground::mpc::{Solver, Status};
use sphere_ground::plan_command;

/// Ground station of a fleet of spherical robots.
#[derive(Parser)]
#[command(name = "sphere-ground", version)]
struct Arguments {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    /// Solve the planning problems of a file, exactly as given.
    ///
    /// Exit code 0: all solved; 1: one was not; 2: the file is not as the format has it.
    Plan {
        /// JSON: {"instances": [...]}, an array of problems, or one problem.
        problem: PathBuf,
        /// Print inputs, states and figures as JSON instead of a table.
        #[arg(long)]
        json: bool,
        /// auto, riccati or clarabel.
        #[arg(long, default_value = "auto")]
        solver: Solver,
    },
}

fn main() -> ExitCode {
    let Command::Plan {
        problem,
        json,
        solver,
    } = Arguments::parse().command;
    match plan(&problem, json, solver) {
        Ok(code) => code,
        Err(error) => {
            eprintln!("sphere-ground: {error:#}");
            ExitCode::from(2)
        }
    }
}

fn plan(path: &Path, json: bool, solver: Solver) -> Result<ExitCode> {
    let name = path.display().to_string();
    let bytes = std::fs::read(path).with_context(|| format!("cannot read {name}"))?;
    let text = String::from_utf8(bytes).with_context(|| format!("{name} is no UTF-8 text"))?;
    let instances = plan_command::parse(&name, &text)?;
    let mut clock = stopwatch();
    let reports: Vec<_> = instances
        .iter()
        .map(|instance| plan_command::solve(instance, solver, &mut clock))
        .collect();
    let output = if json {
        plan_command::to_json(&reports)? + "\n"
    } else {
        plan_command::to_table(&reports)
    };
    match io::stdout().write_all(output.as_bytes()) {
        // Whoever reads has seen enough.
        Err(error) if error.kind() == io::ErrorKind::BrokenPipe => {}
        written => written.context("cannot write to standard output")?,
    }
    let mut code = ExitCode::SUCCESS;
    for report in reports
        .iter()
        .filter(|report| report.summary.status != Status::Solved)
    {
        let reason = report
            .summary
            .refusal
            .as_deref()
            .unwrap_or("no solution found");
        eprintln!(
            "sphere-ground: instance {}: {}: {reason}",
            report.id, report.status
        );
        code = ExitCode::from(1);
    }
    Ok(code)
}

/// Seconds since the call, for the printed solve times.
fn stopwatch() -> impl FnMut() -> f64 {
    #[allow(
        clippy::disallowed_methods,
        reason = "a program measures its own solve times; no result depends on them"
    )]
    let start = std::time::Instant::now();
    move || start.elapsed().as_secs_f64()
}
