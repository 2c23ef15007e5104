//! `sphere-agent`: the program on one robot's computer.

use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::Duration;

use anyhow::{Context, Result, anyhow};
use clap::{Args, Parser, Subcommand};
use sphere_agent::config_file::AgentFile;
use sphere_agent::gains_table::GainsTable;
use sphere_agent::run::{Report, RunError, Setup, run};
use sphere_protocol::document::shared::LogFormat;
use sphere_protocol::io::link::UdpLink;
use sphere_protocol::io::{log, stop};
use sphere_protocol::message::DropReason;
use sphere_protocol::robot::Robot;
use tracing::info;

/// Agent of one spherical robot: follows the station's plans, drives the motor board.
#[derive(Parser)]
#[command(name = "sphere-agent", version)]
struct Cli {
    #[command(subcommand)]
    command: Option<Command>,
    #[command(flatten)]
    run: RunArgs,
}

#[derive(Subcommand)]
enum Command {
    /// Run the agent (what is done without a command)
    ///
    /// Ctrl-C or SIGTERM: brake to rest, then zero torque, within 5 s; a second one: zero torque now.
    /// Exit code 0: ended as asked; 1: ended by a fault; 2: the configuration is not usable.
    Run(RunArgs),
    /// Show each condition of stability that a robot's gains must meet, with its margin
    ///
    /// Exit code 0: all hold; 1: one does not; 2: the file is not usable.
    Gains(GainsArgs),
}

#[derive(Args)]
struct GainsArgs {
    /// A robot file, or the name of a robot that comes with the project (liu)
    robot: String,
    /// Print the conditions as JSON, and nothing else, on standard output
    #[arg(long)]
    json: bool,
}

#[derive(Args)]
struct RunArgs {
    /// The configuration; ./agent.toml if not given. A commented example: examples/agent.toml
    #[arg(long)]
    config: Option<PathBuf>,
}

fn main() -> ExitCode {
    let cli = Cli::parse();
    let RunArgs { config } = match cli.command {
        Some(Command::Run(args)) => args,
        Some(Command::Gains(args)) => return gains(&args),
        None => cli.run,
    };
    let (setup, format) = match prepare(config.as_deref()) {
        Ok(prepared) => prepared,
        Err(error) => {
            eprintln!("sphere-agent: {error:#}");
            return ExitCode::from(2);
        }
    };
    match serve(setup) {
        Ok(report) => {
            print_report(&report, format);
            ExitCode::SUCCESS
        }
        Err(error) => {
            eprintln!("sphere-agent: {error:#}");
            let gains = error.downcast_ref::<RunError>();
            ExitCode::from(if matches!(gains, Some(RunError::Gains(_))) {
                2
            } else {
                1
            })
        }
    }
}

fn gains(args: &GainsArgs) -> ExitCode {
    let table = match load_robot(&args.robot).and_then(|robot| Ok(GainsTable::new(&robot)?)) {
        Ok(table) => table,
        Err(error) => {
            eprintln!("sphere-agent: {error:#}");
            return ExitCode::from(2);
        }
    };
    if args.json {
        println!(
            "{}",
            serde_json::to_string_pretty(&table).expect("plain figures are always JSON")
        );
    } else {
        print!("{}", table.text());
    }
    ExitCode::from(u8::from(!table.holds()))
}

/// The robot of a file, or one that comes with the project.
fn load_robot(reference: &str) -> Result<Robot> {
    if let Some(robot) = Robot::embedded(reference) {
        return Ok(robot);
    }
    let text = std::fs::read_to_string(reference).with_context(|| {
        let known: Vec<_> = Robot::embedded_names().collect();
        format!(
            "cannot read the robot file {reference}; robots that come with the project: {}",
            known.join(", ")
        )
    })?;
    Ok(Robot::parse(reference, &text)?)
}

fn prepare(config: Option<&Path>) -> Result<(Setup, LogFormat)> {
    let path = config.unwrap_or(Path::new("agent.toml"));
    let file = path.display().to_string();
    let text = match std::fs::read_to_string(path) {
        Err(error) if config.is_none() && error.kind() == std::io::ErrorKind::NotFound => {
            return Err(anyhow!(
                "there is no agent.toml here, and no --config names another file: copy examples/agent.toml of the sources, whose comments explain every key"
            ));
        }
        read => read.with_context(|| format!("cannot read {file}"))?,
    };
    let folder = path.parent().unwrap_or(Path::new(""));
    let agent = AgentFile::parse(&file, &text, |robot| {
        let path = folder.join(robot);
        std::fs::read_to_string(&path).map_err(|error| format!("{}: {error}", path.display()))
    })?;
    log::to_stderr(agent.log)?;
    let boot_id = getrandom::u64().context("the system gives no random boot id")?;
    let link = UdpLink::open(agent.motors.bind, agent.motors.board)?;
    info!(
        robot = %agent.id, model = agent.robot.name, boot_id,
        bind = %agent.motors.bind, board = %agent.motors.board, "agent starts"
    );
    let format = agent.log;
    let setup = Setup {
        agent: agent.config(boot_id),
        link,
        network: agent.network.into(),
        watch: None,
    };
    Ok((setup, format))
}

fn serve(setup: Setup) -> Result<Report> {
    // The control loop has a thread of its own; what is left for tokio fits into one.
    let runtime = tokio::runtime::Builder::new_multi_thread()
        .worker_threads(1)
        .enable_all()
        .build()
        .context("cannot start the runtime")?;
    let report = runtime.block_on(async {
        let stop = stop::on_signals().context("cannot listen for signals")?;
        Ok::<_, anyhow::Error>(run(setup, stop).await?)
    })?;
    // An attempt to reach the router may still be under way: nobody waits for it.
    runtime.shutdown_background();
    Ok(report)
}

/// One line on standard error: for people whatever the log filter, for programs a line of the log.
fn print_report(report: &Report, format: LogFormat) {
    let late = &report.lateness;
    let ms = |duration: Option<Duration>| {
        duration.map_or("-".to_owned(), |d| format!("{:.3}", d.as_secs_f64() * 1e3))
    };
    let drops: Vec<String> = DropReason::ALL
        .iter()
        .map(|reason| (reason, report.dropped[*reason as usize]))
        .filter(|(_, count)| *count > 0)
        .map(|(reason, count)| format!("{count} {reason}"))
        .collect();
    let drops = if drops.is_empty() {
        "none".to_owned()
    } else {
        drops.join(", ")
    };
    let frames = &report.frames;
    let refused = frames.bad_checksum + frames.unknown + frames.invalid + frames.foreign;
    let [p50, p99, max] = [
        late.quantile(0.5),
        late.quantile(0.99),
        (late.steps() > 0).then_some(late.max()),
    ];
    if format == LogFormat::Json {
        let ms = |duration: Option<Duration>| duration.map(|d| d.as_secs_f64() * 1e3);
        info!(
            control_steps = late.steps(),
            late_p50_ms = ms(p50),
            late_p99_ms = ms(p99),
            late_max_ms = ms(max),
            dropped = drops,
            frames = frames.frames,
            frames_refused = refused,
            frames_cut_off = frames.cut_off,
            "ended"
        );
        return;
    }
    eprintln!(
        "sphere-agent: {} control steps, late by p50 {} ms, p99 {} ms, max {} ms; messages dropped: {drops}; {} frames of the board, {} refused, {} cut off",
        late.steps(),
        ms(p50),
        ms(p99),
        ms(max),
        frames.frames,
        refused,
        frames.cut_off,
    );
}
