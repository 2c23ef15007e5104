//! Plants in real time: the bodies of the virtual world behind MAVLink over UDP, for agents as they are deployed.
//!
//! One thread serves any number of bodies. It steps them by 1 ms at absolute deadlines, so that their time does not drift from the
//! machine's; a thread that was kept from running makes up for the steps it missed and counts them. Each body speaks with one
//! pinned agent: torque commands are read before every step, a sensor frame leaves every 5 ms, position fixes 50 ms after they
//! were true, a heartbeat every second.

use std::collections::VecDeque;
use std::io;
use std::net::{IpAddr, Ipv4Addr, Ipv6Addr, SocketAddr, UdpSocket};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use sphere_protocol::io::link::{DATAGRAM_MAX, LinkError, UdpLink};
use sphere_protocol::io::real_time;
use sphere_protocol::robot::RobotId;
use sphere_protocol::state::{RobotState, Torque};
use sphere_protocol::time::Span;
use thiserror::Error;
use tracing::warn;

use crate::body::{BOARD_HEARTBEAT, Body, BodyRandom, BodySetup, STEP};
use crate::scenario::Scenario;
use crate::sensor::Sensors;
use crate::world::{body_setup, drawn_clocks};

/// One live robot's hardware.
pub struct PlantSetup {
    /// Whose it is.
    pub id: RobotId,
    /// What it is made of.
    pub body: BodySetup,
    /// Its random streams.
    pub random: BodyRandom,
    /// Time between two position fixes; `None` without any.
    pub fix_period: Option<Span>,
    /// Its end of the motor link, a [`UdpLink`] to its agent.
    pub link: UdpLink,
    /// Where copies of what passes on the motor link go, if anywhere.
    pub mirror: Option<Mirror>,
}

/// Sends a copy of every datagram of one motor link, both ways, to an address that anybody may listen on: the link itself joins two
/// pinned addresses and cannot be overheard.
#[derive(Debug)]
pub struct Mirror {
    socket: UdpSocket,
    to: SocketAddr,
}

/// Plants that run, until they are stopped or dropped.
pub struct Plants {
    origin: Instant,
    shared: Arc<Shared>,
    truths: Vec<Truths>,
    thread: Option<JoinHandle<io::Result<()>>>,
}

/// The truth of one body in its last [`TRUTHS_KEPT`] steps, shared with whoever displays or records it.
#[derive(Clone)]
pub struct Truths(Arc<Mutex<VecDeque<Truth>>>);

/// What is true of one body after one step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Truth {
    /// The instant for which it is true: the deadline of the step.
    pub at: Instant,
    /// Time since the plants were started.
    pub elapsed: Span,
    /// The plant's state.
    pub state: RobotState,
    /// The torque at the joints.
    pub torque: Torque,
    /// Torque commands that were well formed and not obeyed.
    pub refused_commands: u64,
}

/// How well the plants keep to real time.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub struct Pace {
    /// Steps made, each of 1 ms.
    pub steps: u64,
    /// Of these: steps that began more than one step late and were made up for.
    pub late: u64,
    /// The latest beginning of a step.
    pub lateness_max: Duration,
}

/// Why plants could not be started, or ended by themselves.
#[derive(Debug, Error)]
pub enum PlantsError {
    /// A motor link could not be opened.
    #[error(transparent)]
    Link(#[from] LinkError),
    /// The thread could not be started.
    #[error("cannot start the thread of the plants: {0}")]
    Thread(io::Error),
    /// A motor link's socket broke.
    #[error("motor link of the plants: {0}")]
    Broken(io::Error),
    /// The thread panicked: a defect.
    #[error("the thread of the plants has died")]
    Died,
}

/// Addresses of the motor links of a fleet: robot number i has the ports `agent + 2 i` and `board + 2 i` of the loopback interface.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Ports {
    /// Where the first robot's agent listens.
    pub agent: u16,
    /// Where the first robot's board listens.
    pub board: u16,
}

#[derive(Default)]
struct Shared {
    stop: AtomicBool,
    late: AtomicU64,
    steps: AtomicU64,
    lateness_max_ns: AtomicU64,
}

struct Live {
    body: Body,
    /// What is periodic happens this much earlier than at whole periods.
    phase: Span,
    fix_period: Option<Span>,
    link: UdpLink,
    mirror: Option<Mirror>,
    truths: Truths,
}

impl Plants {
    /// Starts the bodies of `setups`, all at the same instant.
    ///
    /// # Errors
    /// The thread cannot be started.
    #[allow(
        clippy::disallowed_methods,
        reason = "live plants follow the machine's clock"
    )]
    pub fn start(setups: Vec<PlantSetup>) -> Result<Self, PlantsError> {
        let origin = Instant::now();
        let shared = Arc::new(Shared::default());
        let bodies: Vec<_> = setups
            .into_iter()
            .enumerate()
            .map(|(index, setup)| {
                let body = Body::new(setup.body, setup.random);
                // Boards are not in step with each other: their frames leave in different steps, not all agents are woken at once.
                let steps = Sensors::INTERVAL.as_nanos() / STEP.as_nanos();
                Live {
                    phase: Span::from_nanos(STEP.as_nanos() * (index as i64 % steps)),
                    truths: Truths::starting(truth(&body, origin, Span::ZERO)),
                    body,
                    fix_period: setup.fix_period,
                    link: setup.link,
                    mirror: setup.mirror,
                }
            })
            .collect();
        let truths = bodies.iter().map(|live| live.truths.clone()).collect();
        let thread = {
            let shared = shared.clone();
            thread::Builder::new()
                .name("plants".to_owned())
                .spawn(move || {
                    // Refused, they are late at times, and say so.
                    let _ = real_time::begin(real_time::PLANTS);
                    step_all(bodies, origin, &shared)
                })
                .map_err(PlantsError::Thread)?
        };
        Ok(Self {
            origin,
            shared,
            truths,
            thread: Some(thread),
        })
    }

    /// When they were started: the beginning of their time.
    pub fn origin(&self) -> Instant {
        self.origin
    }

    /// The truth of each body, in the order in which they were set up.
    pub fn truths(&self) -> &[Truths] {
        &self.truths
    }

    /// How well they keep to real time, so far.
    pub fn pace(&self) -> Pace {
        let read = |count: &AtomicU64| count.load(Ordering::Relaxed);
        Pace {
            steps: read(&self.shared.steps),
            late: read(&self.shared.late),
            lateness_max: Duration::from_nanos(read(&self.shared.lateness_max_ns)),
        }
    }

    /// Whether they still run; if not, [`Plants::stop`] tells why.
    pub fn is_running(&self) -> bool {
        self.thread
            .as_ref()
            .is_some_and(|thread| !thread.is_finished())
    }

    /// Ends them.
    ///
    /// # Errors
    /// They had ended before: a broken socket, or a defect.
    pub fn stop(mut self) -> Result<Pace, PlantsError> {
        self.end()?;
        Ok(self.pace())
    }

    fn end(&mut self) -> Result<(), PlantsError> {
        self.shared.stop.store(true, Ordering::Relaxed);
        match self.thread.take().map(JoinHandle::join) {
            None | Some(Ok(Ok(()))) => Ok(()),
            Some(Ok(Err(error))) => Err(PlantsError::Broken(error)),
            Some(Err(_)) => Err(PlantsError::Died),
        }
    }
}

impl Drop for Plants {
    fn drop(&mut self) {
        if let Err(error) = self.end() {
            warn!(%error, "plants");
        }
    }
}

impl Truths {
    fn starting(first: Truth) -> Self {
        let mut kept = VecDeque::with_capacity(TRUTHS_KEPT);
        kept.push_back(first);
        Self(Arc::new(Mutex::new(kept)))
    }

    /// The newest.
    pub fn newest(&self) -> Truth {
        *self
            .lock()
            .back()
            .expect("the first truth is there from the start, and one goes only when another comes")
    }

    /// What was true at `instant`; `None` if that is longer ago than is kept, or yet to come.
    pub fn at(&self, instant: Instant) -> Option<Truth> {
        let kept = self.lock();
        let later = kept.partition_point(|truth| truth.at <= instant);
        let truth = *kept.get(later.checked_sub(1)?)?;
        (instant - truth.at < 2 * LATE).then_some(truth)
    }

    /// Readers copy at once. While one holds the lock the plants pass over a truth, they never wait.
    fn lock(&self) -> MutexGuard<'_, VecDeque<Truth>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn push(&self, truth: Truth) {
        if let Ok(mut kept) = self.0.try_lock() {
            if kept.len() >= TRUTHS_KEPT {
                kept.pop_front();
            }
            kept.push_back(truth);
        }
    }
}

impl Ports {
    /// The proposed ones.
    pub const DEFAULT: Self = Self {
        agent: 24_600,
        board: 24_601,
    };

    /// Where the agent of robot number `robot` listens; `None` beyond the last port.
    pub fn agent(&self, robot: usize) -> Option<SocketAddr> {
        loopback(self.agent, robot)
    }

    /// Where its board listens.
    pub fn board(&self, robot: usize) -> Option<SocketAddr> {
        loopback(self.board, robot)
    }
}

/// Both ends of a motor link on free ports of the loopback interface: the agent's and the board's.
///
/// # Errors
/// No port is free, or the sockets break.
pub fn link_pair() -> Result<(UdpLink, UdpLink), PlantsError> {
    let any = SocketAddr::from((Ipv4Addr::LOCALHOST, 0));
    let broken = PlantsError::Broken;
    let agent = UdpSocket::bind(any).map_err(broken)?;
    let board = UdpSocket::bind(any).map_err(broken)?;
    let (to_agent, to_board) = (
        agent.local_addr().map_err(broken)?,
        board.local_addr().map_err(broken)?,
    );
    Ok((
        UdpLink::pinned(agent, to_board)?,
        UdpLink::pinned(board, to_agent)?,
    ))
}

/// The hardware of robot number `robot` of `scenario`, as the virtual world would build it, without a mirror.
pub fn plant_setup(scenario: &Scenario, robot: usize, link: UdpLink) -> PlantSetup {
    let setup = &scenario.robots[robot];
    let (_, clock) = drawn_clocks(scenario.seed, robot);
    PlantSetup {
        id: setup.id,
        body: body_setup(scenario, setup, clock),
        random: BodyRandom::new(scenario.seed, robot),
        fix_period: scenario.sensing.fix_period(),
        link,
        mirror: None,
    }
}

#[allow(
    clippy::disallowed_methods,
    reason = "live plants follow the machine's clock"
)]
fn step_all(mut bodies: Vec<Live>, origin: Instant, shared: &Shared) -> io::Result<()> {
    let mut elapsed = Span::ZERO;
    loop {
        for live in &mut bodies {
            live.step(elapsed, origin)?;
        }
        if shared.stop.load(Ordering::Relaxed) {
            return Ok(());
        }
        elapsed = elapsed + STEP;
        let deadline = instant(origin, elapsed);
        let wait = deadline.saturating_duration_since(Instant::now());
        if !wait.is_zero() {
            thread::sleep(wait);
        }
        let lateness = Instant::now().saturating_duration_since(deadline);
        shared.steps.fetch_add(1, Ordering::Relaxed);
        if lateness > LATE {
            shared.late.fetch_add(1, Ordering::Relaxed);
        }
        let nanos = u64::try_from(lateness.as_nanos()).unwrap_or(u64::MAX);
        shared.lateness_max_ns.fetch_max(nanos, Ordering::Relaxed);
    }
}

impl Live {
    /// Everything that happens to one body at `elapsed`: commands first, then time, then what leaves.
    fn step(&mut self, elapsed: Span, origin: Instant) -> io::Result<()> {
        let mut buffer = [0; DATAGRAM_MAX];
        while let Some(bytes) = self.link.receive(&mut buffer, Duration::ZERO)? {
            if let Some(mirror) = &self.mirror {
                mirror.copy(bytes);
            }
            self.body.receive(bytes);
        }
        self.body.advance(elapsed);
        let phased = (elapsed + self.phase).as_nanos();
        let is_due = |period: Span| phased % period.as_nanos() < STEP.as_nanos();
        if is_due(BOARD_HEARTBEAT) {
            let frame = self.body.heartbeat();
            self.send(&frame)?;
        }
        if is_due(Sensors::INTERVAL)
            && let Some(frame) = self.body.sense()
        {
            self.send(&frame)?;
        }
        if self.fix_period.is_some_and(is_due) {
            self.body.take_fix();
        }
        while let Some(frame) = self.body.arrived_fix() {
            self.send(&frame)?;
        }
        self.truths
            .push(truth(&self.body, instant(origin, elapsed), elapsed));
        Ok(())
    }

    fn send(&self, frame: &[u8]) -> io::Result<()> {
        if let Some(mirror) = &self.mirror {
            mirror.copy(frame);
        }
        self.link.send(frame)
    }
}

impl Mirror {
    /// To `first`'s port plus `robot`, so that the links of a fleet arrive apart: every one of them is system 1.
    ///
    /// # Errors
    /// No socket, or no such port.
    pub fn new(first: SocketAddr, robot: usize) -> io::Result<Self> {
        let port = u16::try_from(usize::from(first.port()) + robot)
            .map_err(|_| io::Error::other(format!("mirror: robot {robot} has no port")))?;
        let any: IpAddr = match first {
            SocketAddr::V4(_) => Ipv4Addr::UNSPECIFIED.into(),
            SocketAddr::V6(_) => Ipv6Addr::UNSPECIFIED.into(),
        };
        let socket = UdpSocket::bind((any, 0))?;
        socket.set_nonblocking(true)?;
        Ok(Self {
            socket,
            to: SocketAddr::new(first.ip(), port),
        })
    }

    fn copy(&self, bytes: &[u8]) {
        // Whether anybody listens is nothing to the robot.
        let _ = self.socket.send_to(bytes, self.to);
    }
}

fn truth(body: &Body, at: Instant, elapsed: Span) -> Truth {
    Truth {
        at,
        elapsed,
        state: body.state().robot,
        torque: body.torque(),
        refused_commands: body.refused_commands(),
    }
}

fn instant(origin: Instant, elapsed: Span) -> Instant {
    origin + Duration::from_nanos(elapsed.as_nanos().unsigned_abs())
}

fn loopback(first: u16, robot: usize) -> Option<SocketAddr> {
    let port = usize::from(first) + 2 * robot;
    let port = u16::try_from(port).ok()?;
    Some(SocketAddr::from((Ipv4Addr::LOCALHOST, port)))
}

/// How many steps back the truth is known: three control periods.
pub const TRUTHS_KEPT: usize = 64;
/// A step that begins later than this was made up for.
const LATE: Duration = Duration::from_millis(1);
