//! The deployed agent: the core on a thread of its own, its motor link and its Zenoh session.
//!
//! ```text
//!  motor board ⇄ UDP ⇄ control thread: the core, deadlines, nothing that waits ──► outbox ──► one select! loop ──► Zenoh
//!                            ▲                                                                      │
//!                            └──────────────── inbox (newest kept) ◄────────────────────────────────┘
//! ```
//!
//! The control thread never calls Zenoh, never waits for a lock, and keeps going whatever the network does.

pub mod drive;
pub mod record;
pub mod statistics;

use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::{Arc, Mutex};
use std::thread;
use std::time::Duration;

use sphere_protocol::io::bus::{Bus, Declared, Inbox, Role};
use sphere_protocol::io::clock::Clock;
use sphere_protocol::io::histogram::Histogram;
use sphere_protocol::io::link::{DATAGRAM_MAX, UdpLink};
use sphere_protocol::io::real_time;
use sphere_protocol::key::{Key, every};
use sphere_protocol::mavlink::FrameCounters;
use sphere_protocol::message::{Direction, DropReason, Mode, PlanId, Qos};
use sphere_protocol::time::{AgentClock, Instant, Span};
use thiserror::Error;
use tokio::sync::{mpsc, oneshot};
use tracing::{debug, info, warn};

use crate::agent::{Agent, Event, Input, Output, Payload, Signals};
use crate::config::AgentConfig;
use crate::gains::GainsError;
use crate::mode::Reason;
use record::Recorder;
use statistics::Statistics;

/// What an agent is run with.
pub struct Setup {
    /// The core's configuration.
    pub agent: AgentConfig,
    /// The link to the motor board.
    pub link: UdpLink,
    /// How it takes part in the fleet's network.
    pub network: Role,
    /// Where to show what it does, for a display in the same process.
    pub watch: Option<Arc<Mutex<Snapshot>>>,
    /// Where to leave what passes on the motor link.
    pub recorder: Option<Recorder>,
}

/// What an agent does, now.
#[derive(Clone, Debug)]
pub struct Snapshot {
    /// Its mode; `None` before its first control step.
    pub mode: Option<Mode>,
    /// Why it is in that mode.
    pub reason: Option<Reason>,
    /// Signals of its last control step.
    pub signals: Signals,
    /// When that was.
    pub stepped: Instant<AgentClock>,
    /// Its clock, by which a reader in the same process can tell the time as it does; `None` before its first control step.
    pub clock: Option<Clock<AgentClock>>,
    /// What it has counted, renewed five times a second; `None`, as at first, if the reader has no use for it.
    pub statistics: Option<Box<Statistics>>,
    /// The newest plan that it received.
    pub newest_plan: Option<PlanId>,
    /// Arrival of that plan minus the stamp of the telemetry it was computed from.
    pub loop_delay: Option<Span>,
    /// Plans that have begun since the start.
    pub plans_begun: u64,
}

impl Default for Snapshot {
    /// Before the first control step.
    fn default() -> Self {
        Self {
            mode: None,
            reason: None,
            signals: Signals::default(),
            stepped: Instant::from_nanos(0),
            clock: None,
            statistics: None,
            newest_plan: None,
            loop_delay: None,
            plans_begun: 0,
        }
    }
}

/// What a run amounted to.
#[derive(Clone, Debug)]
pub struct Report {
    /// How late control steps began.
    pub lateness: Histogram,
    /// Messages and frames dropped, by [`DropReason`].
    pub dropped: [u32; DropReason::COUNT],
    /// Frames of the motor board: those taken, and those dropped, by reason.
    pub frames: FrameCounters,
}

/// Why an agent could not be run, or ended by itself.
#[derive(Debug, Error)]
pub enum RunError {
    /// Gains that cannot be stable.
    #[error(transparent)]
    Gains(#[from] GainsError),
    /// The control thread could not be started.
    #[error("cannot start the control thread: {0}")]
    Thread(std::io::Error),
    /// The motor link's socket broke.
    #[error("motor link: {0}")]
    Link(std::io::Error),
    /// The control thread panicked: a defect.
    #[error("the control thread has died; the motor board's own time limit stops the motors")]
    Died,
}

/// What the control thread asks the shell to do.
#[expect(
    clippy::large_enum_variant,
    reason = "a box would allocate in the control thread"
)]
enum Outgoing {
    Publish {
        direction: Direction,
        topic: &'static str,
        qos: Qos,
        bytes: Payload,
    },
    Event(Event),
}

/// What the shell asks of the control thread: how often it was told to stop.
type Stops = Arc<AtomicU32>;

/// Messages that wait for the control thread: a second of plans and commands.
const INBOX: usize = 32;
/// Datagrams taken at once: more than a socket's buffer holds of ours by default, and no flood keeps a step waiting for long.
const DATAGRAMS_MAX: usize = 512;
/// Messages that wait for Zenoh.
const OUTBOX: usize = 256;
/// Control steps between two renewals of the statistics that are shown: 0.2 s.
const STATISTICS_STEPS: u64 = 10;
/// How long one attempt to reach the router may take.
const OPEN_TIMEOUT: Duration = Duration::from_secs(5);
/// Pause between attempts.
const OPEN_PAUSE: Duration = Duration::from_millis(500);

/// Runs an agent until it has come to rest after the first `stop`, or at once after the second.
///
/// # Errors
/// Gains that cannot be stable, or a broken motor link. A missing network is no error: it is tried for again and again.
pub async fn run(setup: Setup, mut stop: mpsc::Receiver<()>) -> Result<Report, RunError> {
    let Setup {
        agent: config,
        link,
        network,
        watch,
        recorder,
    } = setup;
    let id = config.id;
    let inbox = Inbox::new(INBOX);
    let stops = Stops::default();
    let (outgoing, mut outbox) = mpsc::channel(OUTBOX);

    let control = ControlThread {
        inbox: inbox.clone(),
        outgoing,
        stops: stops.clone(),
        watch,
        recorder,
    }
    .start(config, link)?;
    tokio::pin!(control);

    let (found, mut opened) = mpsc::channel(1);
    // Zenoh resolves synchronously: it gets a thread of its own, which ends with the channel.
    thread::Builder::new()
        .name(format!("bus-{id}"))
        .spawn(move || keep_opening(&network, &found))
        .map_err(RunError::Thread)?;

    let mut bus: Option<(Bus, Vec<Declared>)> = None;
    loop {
        tokio::select! {
            // In this order: what the control thread said before it ended is passed on before its end is.
            biased;
            Some(asked) = stop.recv() => {
                let () = asked;
                let count = stops.fetch_add(1, Ordering::Relaxed);
                info!(robot = %id, "{}", if count == 0 { "stopping: braking to rest" } else { "stopping: zero torque now" });
            }
            Some(session) = opened.recv(), if bus.is_none() => {
                let declared = declare(&session, &id, &inbox);
                info!(robot = %id, "connected");
                bus = Some((session, declared));
            }
            Some(out) = outbox.recv() => match out {
                Outgoing::Publish { direction, topic, qos, bytes } => {
                    if let (Some((bus, _)), Ok(key)) = (&bus, Key::new(&id, direction, topic))
                        && let Err(error) = bus.publish(&key.text(), qos, &bytes)
                    {
                        debug!(robot = %id, %error, "not published");
                    }
                }
                Outgoing::Event(event) => log(&id, &event),
            },
            result = &mut control => {
                if let Some((bus, declared)) = bus.take() {
                    drop(declared);
                    let _ = tokio::task::spawn_blocking(move || bus.close()).await;
                }
                return result.map_err(|_| RunError::Died)?;
            }
        }
    }
}

/// What the control thread is joined to.
struct ControlThread {
    inbox: Inbox,
    outgoing: mpsc::Sender<Outgoing>,
    stops: Stops,
    watch: Option<Arc<Mutex<Snapshot>>>,
    recorder: Option<Recorder>,
}

impl ControlThread {
    /// Starts it; what it comes to is sent once.
    fn start(
        self,
        config: AgentConfig,
        link: UdpLink,
    ) -> Result<oneshot::Receiver<Result<Report, RunError>>, RunError> {
        let id = config.id;
        let clock = Clock::<AgentClock>::start();
        let agent = Agent::new(clock.now(), config)?;
        let (ended, result) = oneshot::channel();
        thread::Builder::new()
            .name(format!("control-{id}"))
            .spawn(move || {
                if let Err(refused) = real_time::begin(real_time::CONTROL) {
                    info!("{refused}");
                }
                let report = control_loop(agent, clock, &link, &self);
                // Whoever waits for the recording waits for its last sender.
                drop(self);
                // If nobody waits any more there is nobody to tell.
                let _ = ended.send(report);
            })
            .map_err(RunError::Thread)?;
        Ok(result)
    }
}

/// The control thread: sensor frames as they come, messages, deadlines.
fn control_loop(
    mut agent: Agent,
    clock: Clock<AgentClock>,
    link: &UdpLink,
    joined: &ControlThread,
) -> Result<Report, RunError> {
    let ControlThread {
        inbox,
        outgoing,
        stops,
        watch,
        recorder,
    } = joined;
    let mut buffer = [0; DATAGRAM_MAX];
    let mut statistics = Statistics::new();
    let mut stops_seen = 0;
    loop {
        let due = agent.poll_timeout();
        // All that has come, before a step that may be late: what this thread slept through waits in the socket, the oldest first, and a
        // step after the oldest alone would take the board for silent.
        let mut patience = clock.until(due);
        for _ in 0..DATAGRAMS_MAX {
            let received = link.receive(&mut buffer, patience);
            let Some(bytes) = received.map_err(RunError::Link)? else {
                break;
            };
            let now = clock.now();
            agent.handle_input(now, Input::Motor(bytes));
            if let Some(recorder) = recorder {
                recorder.board_said(now, bytes);
            }
            patience = Duration::ZERO;
        }
        while let Some(message) = inbox.pop() {
            agent.handle_input(
                clock.now(),
                Input::Message {
                    key: &message.key,
                    bytes: &message.bytes,
                },
            );
            statistics.on_message(&agent, message.bytes.len());
        }
        let asked = stops.load(Ordering::Relaxed);
        if asked > stops_seen {
            stops_seen = asked;
            agent.handle_input(
                clock.now(),
                if asked == 1 {
                    Input::Shutdown
                } else {
                    Input::Abort
                },
            );
        }
        let now = clock.now();
        let stepped = now >= due;
        if stepped {
            agent.handle_input(now, Input::Timeout);
            statistics.on_step(&agent, due, now);
        }
        let mut ended = false;
        while let Some(output) = agent.poll_output() {
            match output {
                Output::Motor(frame) => {
                    link.send(&frame).map_err(RunError::Link)?;
                    if let Some(recorder) = recorder {
                        recorder.agent_said(now, &frame);
                    }
                }
                Output::Publish {
                    direction,
                    topic,
                    qos,
                    bytes,
                } => {
                    statistics.sent.count(bytes.len());
                    let publish = Outgoing::Publish {
                        direction,
                        topic,
                        qos,
                        bytes,
                    };
                    // A full outbox means a stuck network: the newest state will come again.
                    if outgoing.try_send(publish).is_err() {
                        statistics.outbox_full = statistics.outbox_full.saturating_add(1);
                    }
                }
                Output::Event(event) => {
                    ended |= event == Event::Ended;
                    let _ = outgoing.try_send(Outgoing::Event(event));
                }
            }
        }
        // A display that holds the lock costs it a frame, never this thread a wait.
        if stepped && let Some(Ok(mut shown)) = watch.as_deref().map(Mutex::try_lock) {
            shown.mode = Some(agent.mode());
            shown.reason = Some(agent.reason());
            shown.signals = *agent.signals();
            shown.stepped = now;
            shown.clock = Some(clock);
            if let Some(shown) = &mut shown.statistics
                && statistics.steps().is_multiple_of(STATISTICS_STEPS)
            {
                statistics.inbox_full = inbox.dropped();
                shown.copy_from(&statistics);
            }
            let playback = agent.playback();
            shown.newest_plan = playback.newest();
            shown.loop_delay = playback.loop_delay();
            shown.plans_begun = playback.begun();
        }
        if ended {
            return Ok(Report {
                lateness: statistics.lateness,
                dropped: *agent.dropped(),
                frames: *agent.frames(),
            });
        }
    }
}

/// Tries to open a session until it comes up, or nobody wants it any more.
fn keep_opening(network: &Role, found: &mpsc::Sender<Bus>) {
    let mut told = false;
    while !found.is_closed() {
        match Bus::open(network, OPEN_TIMEOUT) {
            Ok(bus) => {
                let _ = found.blocking_send(bus);
                return;
            }
            Err(error) if !told => {
                warn!(%error, "no network yet; trying on");
                told = true;
            }
            Err(error) => debug!(%error, "no network yet"),
        }
        #[allow(clippy::disallowed_methods, reason = "a thread that does nothing else")]
        thread::sleep(OPEN_PAUSE);
    }
}

fn declare(bus: &Bus, id: &sphere_protocol::robot::RobotId, inbox: &Inbox) -> Vec<Declared> {
    let mut declared = Vec::new();
    for direction in [Direction::Down, Direction::Command] {
        let inbox = inbox.clone();
        match bus.subscribe(&every(id, direction), move |message| inbox.push(message)) {
            Ok(subscription) => declared.push(subscription),
            Err(error) => warn!(robot = %id, %error, "not subscribed"),
        }
    }
    match bus.show_life(&format!("fleet/v1/{id}/up/alive")) {
        Ok(life) => declared.push(life),
        Err(error) => warn!(robot = %id, %error, "no sign of life"),
    }
    declared
}

fn log(id: &sphere_protocol::robot::RobotId, event: &Event) {
    match event {
        Event::Mode(transition) => info!(
            robot = %id, from = ?transition.from, to = ?transition.to, reason = %transition.reason, "mode"
        ),
        Event::Refused {
            order,
            mode,
            reason,
        } => warn!(robot = %id, ?order, ?mode, %reason, "order refused"),
        Event::Leased { station, epoch } => info!(robot = %id, station, epoch, "leased"),
        Event::LeaseRefused { station, holder } => {
            warn!(robot = %id, station, holder, "lease refused")
        }
        Event::Incompatible(error) => warn!(robot = %id, %error, "incompatible: messages dropped"),
        Event::Dropped(reason) => debug!(robot = %id, ?reason, "dropped"),
        Event::Ended => info!(robot = %id, "at rest, torque zero"),
    }
}
