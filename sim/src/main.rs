//! `sphere-sim`: runs scenarios.

use std::io::{IsTerminal, Write};
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::Instant;

use anyhow::Context;
use clap::{Args, Parser, Subcommand};
use sphere_sim::run::{Run, run};
use sphere_sim::scenario::Scenario;
use sphere_sim::{output, plot, report};

/// Spherical robots in virtual time: the deployed agents and station against simulated robots and a network that delays and loses.
#[derive(Parser)]
#[command(name = "sphere-sim", version)]
struct Cli {
    #[command(subcommand)]
    command: Option<Command>,
}

#[derive(Subcommand)]
enum Command {
    /// Run a scenario in virtual time
    Run(RunArgs),
}

#[derive(Args)]
struct RunArgs {
    /// The scenario file
    scenario: PathBuf,
    /// Seed of every random stream, in place of the scenario's
    #[arg(long)]
    seed: Option<u64>,
    /// Set a key of the scenario, as in --set network.delay_ms=200; may be repeated
    #[arg(long = "set", value_name = "KEY=VALUE")]
    sets: Vec<String>,
    /// Write scenario.toml, metrics.json, trace.csv and plots into this folder
    #[arg(long)]
    out: Option<PathBuf>,
    /// Print the metrics as JSON, and nothing else, on standard output
    #[arg(long)]
    json: bool,
}

/// The run is over: did everything hold that must?
enum Outcome {
    Held,
    Broken,
}

fn main() -> ExitCode {
    let cli = Cli::parse();
    let result = match cli.command {
        Some(Command::Run(args)) => run_scenario(&args),
        None => Ok(Outcome::Held),
    };
    match result {
        Ok(Outcome::Held) => ExitCode::SUCCESS,
        Ok(Outcome::Broken) => ExitCode::from(1),
        Err(error) => {
            eprintln!("sphere-sim: {error:#}");
            ExitCode::from(2)
        }
    }
}

fn run_scenario(args: &RunArgs) -> anyhow::Result<Outcome> {
    let mut sets = args.sets.clone();
    sets.extend(args.seed.map(|seed| format!("seed={seed}")));
    let scenario = output::read_scenario(&args.scenario, &sets)?;
    let sets: String = args
        .sets
        .iter()
        .map(|set| format!(" --set {set}"))
        .collect();
    let replay = format!(
        "sphere-sim run {}{sets} --seed {}",
        args.scenario.display(),
        scenario.seed
    );
    let run = timed(&scenario, &replay)?;
    let name = args
        .scenario
        .file_stem()
        .map_or_else(|| "run".into(), |stem| stem.to_string_lossy().into_owned());
    if let Some(folder) = &args.out {
        write(folder, &scenario, &run, &name)?;
    }
    let mut stdout = std::io::stdout().lock();
    if args.json {
        writeln!(stdout, "{}", run.metrics.json())?;
    } else {
        let folder = args.out.as_ref().map(|folder| folder.display().to_string());
        write!(
            stdout,
            "{}",
            report::summary(&run.metrics, folder.as_deref(), stdout.is_terminal())
        )?;
    }
    let held = run.metrics.violations.is_empty();
    Ok(if held { Outcome::Held } else { Outcome::Broken })
}

#[allow(
    clippy::disallowed_methods,
    reason = "wall_s reports how long the run took; nothing depends on it"
)]
fn timed(scenario: &Scenario, replay: &str) -> anyhow::Result<Run> {
    let begin = Instant::now();
    Ok(run(scenario, replay, || begin.elapsed().as_secs_f64())?)
}

fn write(folder: &Path, scenario: &Scenario, run: &Run, name: &str) -> anyhow::Result<()> {
    let plots = plot::plots(&run.trace, &run.subjects(scenario, name))?;
    output::write_run(folder, scenario, &run.metrics, &run.trace, &plots)
        .with_context(|| format!("cannot write {}", folder.display()))
}
