//! One process of a swarm: the station, agents, the plants or the relay, as its parent tells it.

mod agents;
mod plants;
mod relay;
mod station;

use std::io::Write;
use std::net::{Ipv4Addr, SocketAddr, UdpSocket};
use std::process;
use std::time::{Instant, SystemTime, UNIX_EPOCH};

use anyhow::Context;
use tokio::sync::mpsc;

use super::message::{Answer, Ask, Part, PartSetup};

/// Questions of the parent.
type Asks = mpsc::Receiver<Ask>;

/// Runs the part that standard input describes, until it is told to stop. When standard input closes before that, nobody is left who
/// wanted it, and the process ends at once.
///
/// # Errors
/// Standard input says something else; the part could not be started, or broke.
pub fn run_part() -> anyhow::Result<()> {
    let mut first = String::new();
    std::io::stdin()
        .read_line(&mut first)
        .context("standard input")?;
    let setup: PartSetup = serde_json::from_str(&first)
        .context("swarm-part is what `sphere-sim swarm` starts, and of no use by itself")?;
    let runtime = tokio::runtime::Builder::new_multi_thread()
        .enable_all()
        .build()?;
    let (questions, asks) = mpsc::channel(4);
    std::thread::Builder::new()
        .name("parent".to_owned())
        .spawn(move || listen(&questions))?;
    let result = runtime.block_on(async {
        match setup.part {
            Part::Station => station::run(&setup, asks).await,
            Part::Agents => agents::run(&setup, asks).await,
            Part::Plants => plants::run(&setup, asks).await,
            Part::Relay => relay::run(&setup, asks).await,
        }
    });
    // An attempt to reach the router may still be under way: nobody waits for it.
    runtime.shutdown_background();
    match result {
        Ok(()) => say(&Answer::Ended),
        // The parent tells the user.
        Err(error) => say(&Answer::Failed(format!("{error:#}"))),
    }
}

fn listen(questions: &mpsc::Sender<Ask>) {
    let lines = std::io::stdin().lines();
    for ask in lines.map_while(Result::ok) {
        let Ok(ask) = serde_json::from_str(&ask) else {
            break;
        };
        if questions.blocking_send(ask).is_err() {
            return;
        }
    }
    // The parent is gone, and the other parts with it: nothing that could be ended in order is left.
    process::exit(ORPHANED);
}

fn say(answer: &Answer) -> anyhow::Result<()> {
    let mut line = serde_json::to_string(answer)?;
    line.push('\n');
    let mut stdout = std::io::stdout().lock();
    stdout.write_all(line.as_bytes())?;
    Ok(stdout.flush()?)
}

/// The next question; `None` once told to stop.
async fn next(asks: &mut Asks) -> Option<Ask> {
    match asks.recv().await {
        Some(Ask::Stop) | None => None,
        Some(ask) => Some(ask),
    }
}

/// What [`Ask::Begin`] says; `None` if told to stop instead.
async fn begin(asks: &mut Asks) -> Option<(Vec<SocketAddr>, Option<SocketAddr>)> {
    loop {
        if let Ask::Begin { peers, connect } = next(asks).await? {
            return Some((peers, connect));
        }
    }
}

/// Sockets for the motor links of `count` robots, on ports that the system chooses.
fn bind(count: usize) -> anyhow::Result<(Vec<UdpSocket>, Vec<SocketAddr>)> {
    let mut sockets = Vec::new();
    let mut addresses = Vec::new();
    for _ in 0..count {
        let socket = UdpSocket::bind((Ipv4Addr::LOCALHOST, 0)).with_context(|| {
            format!(
                "no socket for the motor link number {}: raise the limit of open files (ulimit -n)",
                sockets.len() + 1
            )
        })?;
        addresses.push(socket.local_addr()?);
        sockets.push(socket);
    }
    Ok((sockets, addresses))
}

/// `instant` by the calendar clock [ns]: what the parts of a swarm, on one machine, have in common. Asked for soon after, so that a
/// clock that is being set right does not count.
#[allow(
    clippy::disallowed_methods,
    reason = "processes of one machine compare times"
)]
fn calendar(instant: Instant) -> i64 {
    let nanos = |duration: std::time::Duration| i64::try_from(duration.as_nanos()).unwrap_or(0);
    let (now, calendar) = (Instant::now(), SystemTime::now());
    let since = calendar.duration_since(UNIX_EPOCH).unwrap_or_default();
    match now.checked_duration_since(instant) {
        Some(ago) => nanos(since) - nanos(ago),
        None => nanos(since) + nanos(instant - now),
    }
}

/// Exit code of a part whose parent has gone.
const ORPHANED: i32 = 3;
