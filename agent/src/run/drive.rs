//! `sphere-agent identify --drive`: the agent's core on its control thread, with a driver in place of the network.

use std::sync::atomic::Ordering;

use sphere_protocol::io::bus::{Inbox, Received};
use sphere_protocol::message::{Message, Mode, Status, Telemetry};
use sphere_protocol::wire;
use tokio::sync::mpsc;
use tracing::info;

use super::{ControlThread, INBOX, OUTBOX, Outgoing, Report, RunError, Stops, log};
use crate::config::AgentConfig;
use crate::identify::driver::{Driver, Stage};
use crate::run::record::Recorder;
use sphere_protocol::io::link::UdpLink;

/// How a drive ended.
#[derive(Clone, Debug)]
pub struct Drive {
    /// What the run amounted to.
    pub report: Report,
    /// How far the manoeuvre came.
    pub stage: Stage,
    /// Why the robot is in the mode it was in last, a sentence.
    pub reason: String,
}

/// Runs an agent that hears `driver` alone, until the manoeuvre is over and the robot at rest. The first `stop` brakes, the second takes
/// the torque away at once.
///
/// # Errors
/// Gains that cannot be stable, or a broken motor link.
pub async fn drive(
    config: AgentConfig,
    link: UdpLink,
    recorder: Recorder,
    mut driver: Driver,
    mut stop: mpsc::Receiver<()>,
) -> Result<Drive, RunError> {
    let id = config.id;
    let inbox = Inbox::new(INBOX);
    let stops = Stops::default();
    let (outgoing, mut outbox) = mpsc::channel(OUTBOX);
    let control = ControlThread {
        inbox: inbox.clone(),
        outgoing,
        stops: stops.clone(),
        watch: None,
        recorder: Some(recorder),
    }
    .start(config, link)?;
    tokio::pin!(control);
    let mut reason = String::new();
    let mut part = "";
    let mut mode = None;
    loop {
        tokio::select! {
            // In this order: what the control thread said before it ended is passed on before its end is.
            biased;
            Some(()) = stop.recv() => {
                let count = stops.fetch_add(1, Ordering::Relaxed);
                info!(robot = %id, "{}", if count == 0 { "stopping: braking to rest" } else { "stopping: zero torque now" });
            }
            Some(out) = outbox.recv() => match out {
                Outgoing::Event(event) => log(&id, &event),
                Outgoing::Publish { topic: Status::TOPIC, bytes, .. } => {
                    if let Ok(status) = wire::decode::<Status>(&bytes) {
                        // Why it stopped, not that it then ends.
                        if !matches!(driver.stage(), Stage::Stopped(mode) if mode != status.mode) {
                            reason = status.reason.to_string();
                        }
                        let waits = driver.stage() == Stage::Preparing && status.mode < Mode::Ready;
                        if mode.replace(status.mode) != Some(status.mode) && waits {
                            info!(robot = %id, %reason, "waiting until the robot may be armed");
                        }
                    }
                }
                // Asked to stop: nothing is said any more, and the agent brakes.
                Outgoing::Publish { topic: Telemetry::TOPIC, bytes, .. }
                    if stops.load(Ordering::Relaxed) == 0 =>
                {
                    let Ok(telemetry) = wire::decode::<Telemetry>(&bytes) else { continue };
                    for message in driver.on_telemetry(&telemetry) {
                        inbox.push(Received { key: message.key, bytes: message.bytes, gone: false });
                    }
                    if let Some((name, t)) = driver.progress(telemetry.stamp)
                        && core::mem::replace(&mut part, name) != name
                    {
                        info!(robot = %id, at_s = t.round(), "{name}");
                    }
                    if matches!(driver.stage(), Stage::Done | Stage::Stopped(_)) {
                        stops.fetch_add(1, Ordering::Relaxed);
                    }
                }
                Outgoing::Publish { .. } => {}
            },
            result = &mut control => {
                let report = result.map_err(|_| RunError::Died)??;
                return Ok(Drive { report, stage: driver.stage(), reason });
            }
        }
    }
}
