//! `sphere-sim`: runs scenarios.

use std::io::{IsTerminal, Write};
use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::Instant;

use anyhow::Context;
use clap::{Args, Parser, Subcommand};
use sphere_sim::demo::{self, Cut};
use sphere_sim::ensemble;
use sphere_sim::live::Ports;
use sphere_sim::metrics::Violation;
use sphere_sim::paper::{self, Experiment};
use sphere_sim::run::{Run, run};
use sphere_sim::scenario::Scenario;
use sphere_sim::soak::{self, Soak};
use sphere_sim::swarm::{self, SwarmReport};
use sphere_sim::{output, plants_command, plot, report, robustness};

/// The fleet against simulated robots and a network that delays and loses: live, or in virtual time. Without a subcommand: the demo.
#[derive(Parser)]
#[command(name = "sphere-sim", version, args_conflicts_with_subcommands = true)]
struct Cli {
    #[command(subcommand)]
    command: Option<Command>,
    #[command(flatten)]
    demo: DemoArgs,
}

#[derive(Subcommand)]
enum Command {
    /// The demo: three robots live, over real Zenoh and MAVLink, with delay and loss (no subcommand does the same)
    Demo(DemoArgs),
    /// Run a scenario in virtual time
    Run(RunArgs),
    /// Run the paper's experiments in virtual time over many seeds: tables, figures, and who wins where
    Paper(PaperArgs),
    /// Run the roll step on robots and in worlds that differ from what the controllers were tuned on: who bears what, as a map
    Robustness(RobustnessArgs),
    /// Run random scenarios in virtual time, hold each to every invariant, and make what fails small
    Soak(SoakArgs),
    /// Run plants in real time behind MAVLink over UDP, until Ctrl-C
    Plants(PlantsArgs),
    /// Run many robots live on this machine, each part in processes of its own, and measure what they cost and how late they are
    Swarm(SwarmArgs),
    /// One process of a swarm
    #[command(hide = true)]
    SwarmPart,
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

#[derive(Args)]
struct PaperArgs {
    /// Where to write report.html and tables.json; files of the same names are replaced
    #[arg(long, default_value = "out/paper")]
    out: PathBuf,
    /// Run each case with the seeds 1 to this
    #[arg(long, value_name = "N", default_value_t = 20, value_parser = clap::value_parser!(u64).range(1..=10_000))]
    seeds: u64,
    /// Run this experiment alone; may be repeated
    #[arg(long, value_name = "NAME", value_parser = experiment)]
    only: Vec<Experiment>,
    /// Print tables.json, and nothing else, on standard output
    #[arg(long)]
    json: bool,
}

#[derive(Args)]
struct RobustnessArgs {
    /// Where to write robustness.json, robustness.md and robustness.svg; files of the same names are replaced
    #[arg(long, default_value = "out/robustness")]
    out: PathBuf,
    /// Seeds a case: 1 to this; ten times as many where the robot itself is drawn
    #[arg(long, default_value_t = 20, value_parser = clap::value_parser!(u64).range(1..=100_000))]
    seeds: u64,
    /// Run the cases whose name contains this alone; may be repeated
    #[arg(long, value_name = "PART")]
    only: Vec<String>,
    /// Print robustness.json, and nothing else, on standard output
    #[arg(long)]
    json: bool,
}

#[derive(Args)]
struct SoakArgs {
    /// How many seeds to run
    #[arg(long, value_name = "N", default_value_t = 200, value_parser = clap::value_parser!(u64).range(1..=100_000_000))]
    seeds: u64,
    /// The first seed
    #[arg(long = "seed", value_name = "FIRST", default_value_t = 1, value_parser = clap::value_parser!(u64).range(..=1 << 60))]
    first: u64,
    /// Where to write seed-N.toml of seeds that break an invariant, made small
    #[arg(long, default_value = "out/soak")]
    out: PathBuf,
    /// Leave what fails as it is: making it small takes many runs
    #[arg(long)]
    no_shrink: bool,
    /// Print the scenario of the first seed, and run nothing
    #[arg(long, conflicts_with_all = ["json", "seeds"])]
    draw: bool,
    /// Print what was found as JSON, and nothing else, on standard output
    #[arg(long)]
    json: bool,
}

#[derive(Args)]
struct PlantsArgs {
    /// A scenario whose robots to run; its network, faults and missions are of no account here
    #[arg(conflicts_with = "robots")]
    scenario: Option<PathBuf>,
    /// Without a scenario: how many robots, r1, r2, ..., 3 m apart along Y
    #[arg(long, default_value_t = 1)]
    robots: usize,
    /// Seed of sensor noise, in place of the scenario's
    #[arg(long)]
    seed: Option<u64>,
    /// Port of the first robot's board; the next one's is two higher
    #[arg(long, value_name = "BASE", default_value_t = Ports::DEFAULT.board)]
    board_port: u16,
    /// Port on which the first robot's agent is to listen; the next one's is two higher
    #[arg(long, value_name = "BASE", default_value_t = Ports::DEFAULT.agent)]
    agent_port: u16,
    /// Send copies of every motor link's datagrams, both ways, to this UDP address; those of robot number i to its port + i
    #[arg(long, value_name = "ADDRESS:PORT")]
    mirror: Option<SocketAddr>,
}

#[derive(Args)]
struct SwarmArgs {
    /// How many robots
    #[arg(long, value_name = "N", default_value_t = 10, value_parser = clap::value_parser!(u64).range(1..=5000))]
    robots: u64,
    /// Spread the agents over this many processes
    #[arg(long, value_name = "P", default_value_t = 1, value_parser = clap::value_parser!(u64).range(1..=1000))]
    processes: u64,
    /// How long to measure, from 10 s after all robots track [s]
    #[arg(long, value_name = "S", default_value_t = 60.0, value_parser = seconds)]
    duration: f64,
    /// Delay injected each way between station and agents [ms]; with neither delay nor jitter there is no relay
    #[arg(long, value_name = "MS", default_value_t = 100.0, value_parser = milliseconds)]
    delay_ms: f64,
    /// Standard deviation of that delay [ms]
    #[arg(long, value_name = "MS", default_value_t = 0.0, value_parser = milliseconds)]
    jitter_ms: f64,
    /// Time between two telemetry messages of a robot, a multiple of 20 [ms]
    #[arg(long, value_name = "MS", default_value_t = 40, value_parser = telemetry_period)]
    telemetry_ms: u32,
    /// By how much plans may be older at arrival than the injected delay makes them, at p99 [ms]
    #[arg(long, value_name = "MS", default_value_t = 30.0, value_parser = milliseconds)]
    bound_ms: f64,
    /// Seed of sensor noise and jitter
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Write swarm-N.json into this folder; with --plot, swarm.svg and swarm.md
    #[arg(long)]
    out: Option<PathBuf>,
    /// Print the figures as JSON, and nothing else, on standard output
    #[arg(long)]
    json: bool,
    /// Run nothing: draw the runs of these files as swarm.svg, with their tables and what follows for larger fleets as swarm.md
    #[arg(long, value_name = "SWARM-N.JSON", num_args = 1.., requires = "out", conflicts_with_all = ["robots", "processes", "duration", "json"])]
    plot: Vec<PathBuf>,
    /// Log what every part does to standard error; RUST_LOG chooses more finely
    #[arg(short, long)]
    verbose: bool,
}

#[derive(Args)]
struct DemoArgs {
    /// How long the robots roll [s]
    #[arg(long, value_name = "S", default_value_t = 60.0)]
    duration: f64,
    /// Seed of sensor noise, delays and losses
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Where to write scenario.toml, metrics.json, trace.csv and plots; files of the same names are replaced
    #[arg(long, default_value = "out/demo")]
    out: PathBuf,
    /// Cut a robot's link for a while, as in --cut r2@30+6 (at 30 s, for 6 s); may be repeated
    #[arg(long = "cut", value_name = "ROBOT@S+S")]
    cuts: Vec<Cut>,
    /// Send copies of every motor link's datagrams, both ways, to this UDP address; those of robot number i to its port + i
    #[arg(long, value_name = "ADDRESS:PORT")]
    mirror: Option<SocketAddr>,
    /// Print the metrics as JSON, and nothing else, on standard output
    #[arg(long)]
    json: bool,
    /// Log what every part does to standard error; RUST_LOG chooses more finely
    #[arg(short, long)]
    verbose: bool,
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
        Some(Command::Paper(args)) => run_paper(&args),
        Some(Command::Robustness(args)) => run_robustness(&args),
        Some(Command::Soak(args)) => run_soak(&args),
        Some(Command::Plants(args)) => run_plants(&args),
        Some(Command::Swarm(args)) if args.plot.is_empty() => run_swarm(&args),
        Some(Command::Swarm(args)) => plot_swarms(&args),
        Some(Command::SwarmPart) => {
            start_log(std::env::var_os(swarm::VERBOSE).is_some());
            swarm::run_part().map(|()| Outcome::Held)
        }
        Some(Command::Demo(args)) => run_demo(&args),
        None => run_demo(&cli.demo),
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

fn run_demo(args: &DemoArgs) -> anyhow::Result<Outcome> {
    start_log(args.verbose);
    let scenario = demo::scenario(args.seed, args.duration)?;
    // Rather now than after a minute.
    std::fs::create_dir_all(&args.out).with_context(|| {
        let folder = args.out.display();
        format!("cannot write {folder}; choose another folder with --out")
    })?;
    let options = demo::Options {
        scenario,
        cuts: args.cuts.clone(),
        mirror: args.mirror,
    };
    let performance = tokio::runtime::Builder::new_multi_thread()
        .enable_all()
        .build()?
        .block_on(async {
            let mut stop = terminations()?;
            let mut display = demo::Display::new();
            let performance =
                demo::perform(options, &mut stop, |scene| display.show(scene)).await?;
            anyhow::Ok(performance)
        })?;
    let demo::Performance { run, scenario, .. } = &performance;
    write(&args.out, scenario, run, "demo")?;
    let verdicts = demo::verdicts(&performance, &args.cuts);
    let mut stdout = std::io::stdout().lock();
    if args.json {
        write!(stdout, "{}", run.metrics.json())?;
    } else {
        let folder = args.out.display().to_string();
        let colour = stdout.is_terminal();
        writeln!(stdout)?;
        write!(
            stdout,
            "{}",
            demo::summary(&performance, &verdicts, &folder, colour)
        )?;
    }
    let all_good = verdicts.iter().all(|(id, verdict)| {
        let was_cut = args.cuts.iter().any(|cut| cut.robot == *id);
        verdict.is_good(performance.is_interrupted, was_cut)
    });
    let held = all_good && run.metrics.violations.is_empty();
    Ok(if held { Outcome::Held } else { Outcome::Broken })
}

fn run_paper(args: &PaperArgs) -> anyhow::Result<Outcome> {
    let cannot_write = || {
        let folder = args.out.display();
        format!("cannot write {folder}; choose another folder with --out")
    };
    // Rather now than after minutes.
    std::fs::create_dir_all(&args.out).with_context(cannot_write)?;
    let chosen = |experiment: &Experiment| args.only.is_empty() || args.only.contains(experiment);
    let experiments: Vec<_> = Experiment::ALL.into_iter().filter(chosen).collect();
    let runs = paper::jobs(&experiments, args.seeds).len();
    let bar = paper::progress(runs);
    let results = paper::run(&experiments, args.seeds, ensemble::every_core(), |done| {
        bar.set_position(done as u64);
    });
    bar.finish_and_clear();
    let results = results?;
    let tables = results.table.json();
    let page = paper::page::html(&results)?;
    for (name, text) in [("tables.json", &tables), ("report.html", &page)] {
        std::fs::write(args.out.join(name), text).with_context(cannot_write)?;
    }
    let mut stdout = std::io::stdout().lock();
    if args.json {
        write!(stdout, "{tables}")?;
    } else {
        let colour = stdout.is_terminal();
        write!(stdout, "{}", paper::terminal::summary(&results, colour))?;
        let page = args.out.join("report.html");
        writeln!(stdout, "Figures and tables: {}", page.display())?;
    }
    Ok(Outcome::Held)
}

/// The experiment of this name.
fn experiment(name: &str) -> Result<Experiment, String> {
    let named = Experiment::ALL.iter().find(|known| known.name() == name);
    named.copied().ok_or_else(|| {
        let known: Vec<_> = Experiment::ALL.iter().map(|known| known.name()).collect();
        format!("there is no such experiment: use {}", known.join(", "))
    })
}

fn run_robustness(args: &RobustnessArgs) -> anyhow::Result<Outcome> {
    let cannot_write = || {
        let folder = args.out.display();
        format!("cannot write {folder}; choose another folder with --out")
    };
    std::fs::create_dir_all(&args.out).with_context(cannot_write)?;
    let chosen = |case: &robustness::Case| {
        args.only.is_empty()
            || args
                .only
                .iter()
                .any(|part| case.name.contains(part.as_str()))
    };
    let cases: Vec<_> = robustness::cases().into_iter().filter(chosen).collect();
    if cases.is_empty() {
        let known: Vec<_> = robustness::cases().iter().map(|case| case.name).collect();
        anyhow::bail!(
            "--only: no case has such a name: there are {}",
            known.join("; ")
        );
    }
    let bar = paper::progress(robustness::runs(&cases, args.seeds));
    let lines = robustness::run_all(&cases, args.seeds, ensemble::every_core(), |done| {
        bar.set_position(done as u64);
    });
    bar.finish_and_clear();
    let lines = lines?;
    let mut json = serde_json::to_string_pretty(&lines)?;
    json.push('\n');
    let table = robustness::markdown(&lines);
    for (name, text) in [
        ("robustness.json", &json),
        ("robustness.md", &table),
        ("robustness.svg", &robustness::heat_map(&lines)),
    ] {
        std::fs::write(args.out.join(name), text).with_context(cannot_write)?;
    }
    let mut stdout = std::io::stdout().lock();
    if args.json {
        write!(stdout, "{json}")?;
    } else {
        write!(stdout, "{}", robustness::terminal(&lines))?;
        writeln!(
            stdout,
            "The map: {}",
            args.out.join("robustness.svg").display()
        )?;
    }
    Ok(Outcome::Held)
}

fn run_soak(args: &SoakArgs) -> anyhow::Result<Outcome> {
    if args.draw {
        print!("{}", soak::draw(args.first).drawn());
        return Ok(Outcome::Held);
    }
    let bar = paper::progress(args.seeds as usize);
    let seeds = args.first..args.first + args.seeds;
    let mut outcomes = soak::run(seeds, ensemble::every_core(), |done| {
        bar.set_position(done as u64);
    });
    bar.finish_and_clear();
    let failed = outcomes.iter_mut().filter(|o| !o.violations.is_empty());
    // The first ones suffice to find out why: shrinking takes many runs each.
    for outcome in failed.take(if args.no_shrink { 0 } else { SHRUNK_MAX }) {
        let found = &mut outcome.violations[0];
        eprintln!(
            "Seed {} breaks {}: making it small",
            outcome.seed, found.rule
        );
        let (scenario, violation) = soak::shrink(&soak::draw(outcome.seed), &found.rule, found);
        std::fs::create_dir_all(&args.out)?;
        let path = args.out.join(format!("seed-{}.toml", outcome.seed));
        std::fs::write(&path, scenario.drawn())
            .with_context(|| format!("cannot write {}", path.display()))?;
        let replay = format!("sphere-sim run {}", path.display());
        *found = Violation {
            replay,
            ..violation
        };
    }
    let report = Soak::new(&outcomes);
    let mut stdout = std::io::stdout().lock();
    if args.json {
        write!(stdout, "{}", report.json())?;
    } else {
        write!(stdout, "{}", report.terminal())?;
    }
    let held = report.failed_seeds.is_empty();
    Ok(if held { Outcome::Held } else { Outcome::Broken })
}

/// So many seeds that fail are made small.
const SHRUNK_MAX: usize = 10;

/// Logs to standard error: warnings alone are too much beside a table that is redrawn, so that errors only are shown unless asked.
fn start_log(verbose: bool) {
    use tracing_subscriber::EnvFilter;
    let usual = if verbose {
        "warn,sphere_agent=info,sphere_ground=info,sphere_sim=info"
    } else {
        "error"
    };
    let filter = EnvFilter::try_from_default_env().unwrap_or_else(|_| EnvFilter::new(usual));
    tracing_subscriber::fmt()
        .with_env_filter(filter)
        .with_writer(std::io::stderr)
        .with_ansi(std::io::stderr().is_terminal())
        .init();
}

fn run_plants(args: &PlantsArgs) -> anyhow::Result<Outcome> {
    let sets: Vec<_> = args
        .seed
        .iter()
        .map(|seed| format!("seed={seed}"))
        .collect();
    let scenario = match &args.scenario {
        Some(path) => output::read_scenario(path, &sets)?,
        None => plants_command::row_of_robots(args.robots, args.seed.unwrap_or(1))?,
    };
    let ports = Ports {
        agent: args.agent_port,
        board: args.board_port,
    };
    let served = plants_command::serve(&scenario, ports, args.mirror)?;
    // Whoever starts this as a process waits for the table: it comes when the sockets are open.
    print!("{}", served.table());
    println!("Plants run; Ctrl-C ends.");
    std::io::stdout().flush()?;
    tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .build()?
        .block_on(async {
            let mut check = tokio::time::interval(CHECK);
            let mut terminate = terminations()?;
            loop {
                tokio::select! {
                    _ = terminate.recv() => return Ok::<_, std::io::Error>(()),
                    _ = check.tick() => if !served.plants.is_running() {
                        return Ok(());
                    }
                }
            }
        })?;
    let pace = served.plants.stop()?;
    eprintln!("{}", plants_command::pace_sentence(pace));
    Ok(Outcome::Held)
}

fn run_swarm(args: &SwarmArgs) -> anyhow::Result<Outcome> {
    start_log(args.verbose);
    let cannot_write = |folder: &Path| {
        let folder = folder.display();
        format!("cannot write {folder}; choose another folder with --out")
    };
    if let Some(folder) = &args.out {
        // Rather now than after minutes.
        std::fs::create_dir_all(folder).with_context(|| cannot_write(folder))?;
    }
    let options = swarm::Options {
        robots: usize::try_from(args.robots)?,
        processes: usize::try_from(args.processes)?,
        duration_s: args.duration,
        delay_ms: args.delay_ms,
        jitter_ms: args.jitter_ms,
        telemetry_ms: args.telemetry_ms,
        seed: args.seed,
        bound_ms: args.bound_ms,
        is_verbose: args.verbose,
    };
    let runtime = tokio::runtime::Builder::new_multi_thread()
        .worker_threads(1)
        .enable_all()
        .build()?;
    let stops = Arc::<AtomicU32>::default();
    let counted = stops.clone();
    runtime.block_on(async {
        let mut asked = terminations()?;
        tokio::spawn(async move {
            while asked.recv().await.is_some() {
                counted.fetch_add(1, Ordering::Relaxed);
            }
        });
        Ok::<_, std::io::Error>(())
    })?;
    let report = match swarm::run(&options, &stops, |line| eprintln!("{line}")) {
        Ok(report) => report,
        Err(swarm::SwarmError::Interrupted) => {
            eprintln!("sphere-sim: {}", swarm::SwarmError::Interrupted);
            return Ok(Outcome::Broken);
        }
        Err(error) => return Err(error.into()),
    };
    if let Some(folder) = &args.out {
        let file = folder.join(format!("swarm-{}.json", report.robots));
        std::fs::write(file, report.json()).with_context(|| cannot_write(folder))?;
    }
    let mut stdout = std::io::stdout().lock();
    if args.json {
        write!(stdout, "{}", report.json())?;
    } else {
        let colour = stdout.is_terminal();
        write!(stdout, "\n{}", swarm::summary(&report, colour))?;
    }
    Ok(if report.held() {
        Outcome::Held
    } else {
        Outcome::Broken
    })
}

fn plot_swarms(args: &SwarmArgs) -> anyhow::Result<Outcome> {
    let mut reports = Vec::new();
    for path in &args.plot {
        let file = path.display();
        let text = std::fs::read_to_string(path).with_context(|| format!("--plot {file}"))?;
        let report: SwarmReport = serde_json::from_str(&text)
            .with_context(|| format!("--plot {file}: not what `sphere-sim swarm --out` writes"))?;
        reports.push(report);
    }
    reports.sort_by_key(|report| report.robots);
    let mut page = swarm::markdown(&reports);
    match swarm::computed(&reports) {
        Ok(computed) => page.push_str(&format!("\n{computed}")),
        Err(why) => eprintln!("Nothing is computed for larger fleets: {why}"),
    }
    let folder = args.out.as_deref().unwrap_or(Path::new("."));
    let write = |name: &str, text: &str| {
        std::fs::create_dir_all(folder)?;
        std::fs::write(folder.join(name), text)
    };
    for (name, text) in [("swarm.svg", &swarm::svg(&reports)?), ("swarm.md", &page)] {
        write(name, text).with_context(|| {
            let folder = folder.display();
            format!("cannot write {folder}; choose another folder with --out")
        })?;
    }
    print!("{page}");
    Ok(Outcome::Held)
}

fn seconds(text: &str) -> Result<f64, String> {
    match text.parse() {
        Ok(seconds) if (1.0..=1e6).contains(&seconds) => Ok(seconds),
        _ => Err("write seconds, 1 or more, as in 60".to_owned()),
    }
}

fn milliseconds(text: &str) -> Result<f64, String> {
    match text.parse() {
        Ok(milliseconds) if (0.0..=1e4).contains(&milliseconds) => Ok(milliseconds),
        _ => Err("write milliseconds from 0 to 10000, as in 100".to_owned()),
    }
}

fn telemetry_period(text: &str) -> Result<u32, String> {
    match text.parse() {
        Ok(ms @ 20..=1000) if ms % 20 == 0 => Ok(ms),
        _ => {
            Err("write a multiple of the control period of 20 ms, as in 40, up to 1000".to_owned())
        }
    }
}

/// Ctrl-C and the polite kill, each time they come.
fn terminations() -> std::io::Result<tokio::sync::mpsc::Receiver<()>> {
    let (asked, terminations) = tokio::sync::mpsc::channel(2);
    #[cfg(unix)]
    {
        use tokio::signal::unix::{SignalKind, signal};
        for kind in [SignalKind::interrupt(), SignalKind::terminate()] {
            let (mut signal, asked) = (signal(kind)?, asked.clone());
            tokio::spawn(async move {
                while signal.recv().await.is_some() && asked.send(()).await.is_ok() {}
            });
        }
    }
    #[cfg(not(unix))]
    tokio::spawn(async move {
        while tokio::signal::ctrl_c().await.is_ok() && asked.send(()).await.is_ok() {}
    });
    Ok(terminations)
}

/// How often to see whether the plants still run.
const CHECK: std::time::Duration = std::time::Duration::from_millis(500);

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
