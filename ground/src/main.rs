//! `sphere-ground`: the ground station's commands.

use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::Duration;

use anyhow::{Context, Result, anyhow};
use clap::{Parser, Subcommand};
use sphere_ground::config_file::StationFile;
use sphere_ground::mpc::{Solver, Status};
use sphere_ground::plan_command;
use sphere_ground::run::{self, RunError, Setup};
use sphere_ground::station::StationConfig;
use sphere_protocol::io::{log, stop};
use tracing::{info, warn};

/// Ground station of a fleet of spherical robots.
#[derive(Parser)]
#[command(name = "sphere-ground", version)]
struct Arguments {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    /// Run the station: plan for every robot of the configuration.
    ///
    /// Ctrl-C or SIGTERM ends it; the robots then play their last plan to its end, brake and hold.
    /// Exit code 0: ended as asked; 1: the network refused it, or a fault; 2: the configuration is not usable.
    Serve {
        /// The configuration; ./station.toml if not given. A commented example: examples/station.toml
        #[arg(long)]
        config: Option<PathBuf>,
    },
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
    let result = match Arguments::parse().command {
        Command::Plan {
            problem,
            json,
            solver,
        } => plan(&problem, json, solver),
        Command::Serve { config } => serve(config.as_deref()),
    };
    match result {
        Ok(code) => code,
        Err(error) => {
            eprintln!("sphere-ground: {error:#}");
            // What happens after the configuration was accepted is no mistake in it.
            ExitCode::from(if error.is::<RunError>() { 1 } else { 2 })
        }
    }
}

fn serve(config: Option<&Path>) -> Result<ExitCode> {
    let setup = prepare(config)?;
    let runtime = tokio::runtime::Builder::new_multi_thread()
        .worker_threads(1)
        .enable_all()
        .build()
        .context("cannot start the runtime")?;
    runtime.block_on(async {
        let mut signals = stop::on_signals().context("cannot listen for signals")?;
        let (first, stop) = tokio::sync::mpsc::channel(1);
        let serving = run::serve(setup, stop);
        tokio::pin!(serving);
        loop {
            tokio::select! {
                ended = &mut serving => return ended.map(|()| ExitCode::SUCCESS).map_err(Into::into),
                Some(()) = signals.recv() => {
                    if first.try_send(()).is_err() {
                        warn!("asked again: ending without closing the network");
                        return Ok(ExitCode::SUCCESS);
                    }
                    info!("ending: robots play their last plans to the end, brake and hold");
                }
            }
        }
    })
    .inspect(|_| runtime.shutdown_timeout(Duration::from_millis(100)))
}

fn prepare(config: Option<&Path>) -> Result<Setup> {
    let path = config.unwrap_or(Path::new("station.toml"));
    let file = path.display().to_string();
    let text = match std::fs::read_to_string(path) {
        Err(error) if config.is_none() && error.kind() == io::ErrorKind::NotFound => {
            return Err(anyhow!(
                "there is no station.toml here, and no --config names another file: copy examples/station.toml of the sources, whose comments explain every key"
            ));
        }
        read => read.with_context(|| format!("cannot read {file}"))?,
    };
    let folder = path.parent().unwrap_or(Path::new(""));
    let station = StationFile::parse(&file, &text, |robot| {
        let path = folder.join(robot);
        std::fs::read_to_string(&path).map_err(|error| format!("{}: {error}", path.display()))
    })?;
    log::to_stderr(station.log)?;
    let id = match station.station {
        Some(id) => id,
        // 0 means nobody.
        None => getrandom::u64()
            .context("the system gives no random station id")?
            .max(1),
    };
    info!(
        station = id,
        robots = station.robots.len(),
        "station starts"
    );
    Ok(Setup {
        station: StationConfig {
            station: id,
            planner: station.planner,
            robots: station.robots,
        },
        network: station.network.into(),
        threads: station.threads,
        watch: None,
    })
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
