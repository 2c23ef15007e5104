//! `sphere-agent`: the program on one robot's computer.

use std::io::{self, Write as _};
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::Duration;

use anyhow::{Context, Result, anyhow};
use clap::{Args, Parser, Subcommand};
use sphere_agent::config_file::AgentFile;
use sphere_agent::gains_table::GainsTable;
use sphere_agent::identify;
use sphere_agent::identify::driver::{Driver, Stage};
use sphere_agent::identify::log::Log;
use sphere_agent::identify::manoeuvre::Manoeuvre;
use sphere_agent::run::drive::drive;
use sphere_agent::run::record::{RecordWriter, Recorder};
use sphere_agent::run::{Report, RunError, Setup, run};
use sphere_protocol::document::shared::LogFormat;
use sphere_protocol::io::link::UdpLink;
use sphere_protocol::io::{log, stop};
use sphere_protocol::message::DropReason;
use sphere_protocol::robot::Robot;
use tokio::sync::mpsc;
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
    /// Fit the robot's parameters to a recorded manoeuvre
    ///
    /// A log comes from `sphere-agent run --record` or from here, with `--drive`: the agent then plays the prescribed manoeuvre of
    /// 60 s on a free floor (docs/identify.md), and its log is fitted at once. Ctrl-C: brake to rest, then zero torque.
    /// Exit code 0: fitted; 1: not to be trusted, and what is missing, or the drive was broken off; 2: bad log, robot or configuration.
    Identify(IdentifyArgs),
}

#[derive(Args)]
struct GainsArgs {
    /// The robot: a .toml file, or the name of one that comes with the project
    robot: String,
    /// Print the conditions as JSON, and nothing else, on standard output
    #[arg(long)]
    json: bool,
}

#[derive(Args)]
struct IdentifyArgs {
    /// The log, CSV (docs/identify.md)
    #[arg(required_unless_present = "drive", conflicts_with = "drive")]
    log: Option<PathBuf>,
    /// The robot: a .toml file, or the name of one that comes with the project
    #[arg(long, required_unless_present = "drive", conflicts_with = "drive")]
    robot: Option<String>,
    /// Write the robot file with the fitted values here
    #[arg(long)]
    out: Option<PathBuf>,
    /// Print JSON
    #[arg(long)]
    json: bool,
    /// Drive the manoeuvre first, with the agent of --config, and record it
    #[arg(long, requires = "record")]
    drive: bool,
    /// With --drive: the agent's configuration; ./agent.toml if not given. Its network is not used
    #[arg(long, requires = "drive")]
    config: Option<PathBuf>,
    /// With --drive: a new file for the log
    #[arg(long, requires = "drive")]
    record: Option<PathBuf>,
}

#[derive(Args)]
struct RunArgs {
    /// The configuration; ./agent.toml if not given. A commented example: examples/agent.toml
    #[arg(long)]
    config: Option<PathBuf>,
    /// Record the motor link into this new file, for `sphere-agent identify`: some 40 kB a second
    #[arg(long)]
    record: Option<PathBuf>,
}

fn main() -> ExitCode {
    let cli = Cli::parse();
    let result = match cli.command {
        Some(Command::Run(args)) => command_run(&args),
        None => command_run(&cli.run),
        Some(Command::Gains(args)) => command_gains(&args),
        Some(Command::Identify(args)) => command_identify(&args),
    };
    result.unwrap_or_else(|error| {
        eprintln!("sphere-agent: {error:#}");
        // What happens after the configuration was accepted is no mistake in it.
        let at_fault = match error.downcast_ref::<RunError>() {
            Some(RunError::Gains(_)) | None => !error.is::<Afterwards>(),
            Some(_) => false,
        };
        ExitCode::from(if at_fault { 2 } else { 1 })
    })
}

/// Something failed that no input is to blame for.
#[derive(Debug)]
struct Afterwards;

impl core::fmt::Display for Afterwards {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str("broken off")
    }
}

fn command_run(args: &RunArgs) -> Result<ExitCode> {
    let (mut setup, format) = prepare(args.config.as_deref())?;
    let writer = args.record.as_deref().map(record).transpose()?;
    let writer = writer.map(|(recorder, writer)| {
        setup.recorder = Some(recorder);
        writer
    });
    let report = block_on(async |stop| Ok(run(setup, stop).await?))?;
    print_report(&report, format);
    writer.map(finish).transpose()?;
    Ok(ExitCode::SUCCESS)
}

fn command_gains(args: &GainsArgs) -> Result<ExitCode> {
    let table = GainsTable::new(&robot(&args.robot)?)?;
    let printed = if args.json {
        serde_json::to_string_pretty(&table)? + "\n"
    } else {
        table.text()
    };
    print!("{printed}");
    Ok(ExitCode::from(u8::from(!table.holds())))
}

fn command_identify(args: &IdentifyArgs) -> Result<ExitCode> {
    let (robot, path) = match (&args.log, &args.record) {
        (Some(log), _) => (robot(args.robot.as_deref().unwrap_or_default())?, log),
        (None, Some(record)) => {
            let (setup, format) = prepare(args.config.as_deref())?;
            let robot = setup.agent.robot.clone();
            if !drive_manoeuvre(setup, record, format)? {
                return Ok(ExitCode::from(1));
            }
            (robot, record)
        }
        (None, None) => unreachable!("clap asks for one of them"),
    };
    let file = path.display().to_string();
    let text = std::fs::read(path).with_context(|| format!("cannot read {file}"))?;
    let text = String::from_utf8(text).with_context(|| format!("{file} is no UTF-8 text"))?;
    let log = Log::parse(&text).with_context(|| file.clone())?;
    let result = identify::identify(&log, &robot);
    let report = identify::report::Report::new(&result, &file, &robot.name);
    let printed = if args.json {
        serde_json::to_string_pretty(&report)? + "\n"
    } else {
        report.to_table()
    };
    match io::stdout().write_all(printed.as_bytes()) {
        // Whoever reads has seen enough.
        Err(error) if error.kind() == io::ErrorKind::BrokenPipe => {}
        written => written
            .context("cannot write to standard output")
            .context(Afterwards)?,
    }
    for problem in &result.problems {
        eprintln!("sphere-agent: {problem}");
    }
    if !result.is_trustworthy() {
        eprintln!("sphere-agent: not to be trusted: no robot file is written");
        return Ok(ExitCode::from(1));
    }
    if let Some(out) = &args.out {
        let name = path
            .file_name()
            .map_or_else(|| file.clone(), |n| n.to_string_lossy().into_owned());
        let text = identify::robot_file::rewritten(&robot, &result.fields, &name)?;
        std::fs::write(out, text).with_context(|| format!("cannot write {}", out.display()))?;
        eprintln!("sphere-agent: written to {}", out.display());
    }
    for condition in &result.broken {
        eprintln!(
            "sphere-agent: with these parameters the gains are not stable, choose others: {condition}"
        );
    }
    Ok(ExitCode::from(u8::from(!result.broken.is_empty())))
}

/// Whether the manoeuvre was driven to its end.
fn drive_manoeuvre(setup: Setup, path: &Path, format: LogFormat) -> Result<bool> {
    let (recorder, writer) = record(path)?;
    let station = getrandom::u64().context("the system gives no random station id")?;
    let manoeuvre = Manoeuvre::prescribed();
    info!(
        seconds = manoeuvre.duration().round(),
        "driving the manoeuvre; it needs the free floor that docs/identify.md names. Ctrl-C brakes"
    );
    let driver = Driver::new(setup.agent.robot.clone(), manoeuvre, station);
    let Setup { agent, link, .. } = setup;
    let driven = block_on(async |stop| Ok(drive(agent, link, recorder, driver, stop).await?))?;
    print_report(&driven.report, format);
    finish(writer)?;
    match driven.stage {
        Stage::Done => return Ok(true),
        Stage::Stopped(mode) => {
            eprintln!(
                "sphere-agent: the robot stopped by itself ({mode:?}): {}",
                driven.reason
            );
        }
        _ => eprintln!(
            "sphere-agent: broken off before the manoeuvre's end; {} is not fitted",
            path.display()
        ),
    }
    Ok(false)
}

/// A robot file, or a robot that comes with the project.
fn robot(reference: &str) -> Result<Robot> {
    if let Some(robot) = Robot::embedded(reference) {
        return Ok(robot);
    }
    let path = Path::new(reference);
    if path.extension().is_none_or(|ext| ext != "toml") {
        let known: Vec<_> = Robot::embedded_names().collect();
        return Err(anyhow!(
            "{reference}: neither a path ending in .toml nor a robot that comes with the project ({})",
            known.join(", ")
        ));
    }
    let text = std::fs::read_to_string(path).with_context(|| format!("cannot read {reference}"))?;
    Ok(Robot::parse(reference, &text)?)
}

fn record(path: &Path) -> Result<(Recorder, RecordWriter)> {
    Recorder::create(path).with_context(|| format!("--record: cannot create {}", path.display()))
}

fn finish(writer: RecordWriter) -> Result<()> {
    let recorded = writer
        .finish()
        .context("the log could not be written")
        .context(Afterwards)?;
    eprintln!(
        "sphere-agent: {} sensor frames recorded, {} datagrams left out",
        recorded.rows, recorded.left_out
    );
    Ok(())
}

fn prepare(config: Option<&Path>) -> Result<(Setup, LogFormat)> {
    let path = config.unwrap_or(Path::new("agent.toml"));
    let file = path.display().to_string();
    let text = match std::fs::read_to_string(path) {
        Err(error) if config.is_none() && error.kind() == io::ErrorKind::NotFound => {
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
        recorder: None,
    };
    Ok((setup, format))
}

/// Runs a shell that is told of signals.
fn block_on<T>(shell: impl AsyncFnOnce(mpsc::Receiver<()>) -> Result<T>) -> Result<T> {
    // The control loop has a thread of its own; what is left for tokio fits into one.
    let runtime = tokio::runtime::Builder::new_multi_thread()
        .worker_threads(1)
        .enable_all()
        .build()
        .context("cannot start the runtime")
        .context(Afterwards)?;
    let result = runtime.block_on(async {
        let stop = stop::on_signals()
            .context("cannot listen for signals")
            .context(Afterwards)?;
        shell(stop).await
    });
    // An attempt to reach the router may still be under way: nobody waits for it.
    runtime.shutdown_background();
    result
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
        (late.total() > 0).then_some(late.max()),
    ];
    if format == LogFormat::Json {
        let ms = |duration: Option<Duration>| duration.map(|d| d.as_secs_f64() * 1e3);
        info!(
            control_steps = late.total(),
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
        late.total(),
        ms(p50),
        ms(p99),
        ms(max),
        frames.frames,
        refused,
        frames.cut_off,
    );
}
