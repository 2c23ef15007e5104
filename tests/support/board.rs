//! A motor board with a robot's body behind it, in real time on a UDP socket, and what was true of it at each moment.

#![allow(dead_code, reason = "each test binary uses its own part")]

use std::net::{SocketAddr, UdpSocket};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use sphere_protocol::robot::Robot;
use sphere_protocol::time::Span;
use sphere_sim::body::{Body, BodyRandom, BodySetup};
use sphere_sim::disturbance::Disturbance;

/// What was true of the robot at one moment, every 5 ms.
#[derive(Clone, Copy, Debug)]
pub struct Truth {
    pub at: Instant,
    /// Speed [m/s].
    pub v: f64,
    /// Roll [rad].
    pub q_r: f64,
    /// Largest torque at the joints [N·m].
    pub torque: f64,
    /// Whether a torque command is in force at the board.
    pub commanded: bool,
    /// When the last datagram had come.
    pub heard: Option<Instant>,
}

pub struct Board {
    pub address: SocketAddr,
    pub agent: SocketAddr,
    /// Every datagram from the agent, in order.
    pub received: Arc<Mutex<Vec<(Instant, Vec<u8>)>>>,
    truths: Arc<Mutex<Vec<Truth>>>,
    stop: Arc<AtomicBool>,
    frozen: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl Board {
    /// A liu robot at rest at the origin; a free port is reserved for its agent.
    pub fn start(seed: u64) -> Self {
        let agent = UdpSocket::bind("127.0.0.1:0")
            .and_then(|socket| socket.local_addr())
            .expect("a free port");
        let socket = UdpSocket::bind("127.0.0.1:0").expect("a free port");
        let address = socket.local_addr().expect("bound");
        socket.connect(agent).expect("loopback");
        socket.set_nonblocking(true).expect("a UDP socket can");
        let body = Body::new(
            BodySetup {
                params: Robot::embedded("liu").expect("embedded").params,
                start: [0.0; 3],
                disturbance: Disturbance::default(),
                noise: 1.0,
                fix_sigma: 0.02,
                clock: sphere_sim::clock::SimClock::new(Span::from_millis(12_345), 0.0),
            },
            BodyRandom::new(seed, 0),
        );
        let mut board = Self {
            address,
            agent,
            received: Arc::default(),
            truths: Arc::default(),
            stop: Arc::default(),
            frozen: Arc::default(),
            thread: None,
        };
        let shared = (
            board.received.clone(),
            board.truths.clone(),
            board.stop.clone(),
            board.frozen.clone(),
        );
        board.thread = Some(thread::spawn(move || run(body, &socket, shared)));
        board
    }

    pub fn newest(&self) -> Truth {
        *self.truths.lock().unwrap().last().expect("it runs")
    }

    pub fn since(&self, begin: Instant) -> Vec<Truth> {
        let truths = self.truths.lock().unwrap();
        truths.iter().filter(|t| t.at >= begin).copied().collect()
    }

    /// Stops or restarts its time, as a board does that hangs.
    pub fn freeze(&self, frozen: bool) {
        self.frozen.store(frozen, Ordering::Relaxed);
    }

    /// The first moment from `begin` on of which `is_true`, waited for until `limit` after `begin`.
    pub fn first(
        &self,
        begin: Instant,
        limit: Duration,
        what: &str,
        is_true: impl Fn(&Truth) -> bool,
    ) -> Duration {
        loop {
            if let Some(found) = self.since(begin).iter().find(|truth| is_true(truth)) {
                return found.at - begin;
            }
            assert!(
                begin.elapsed() < limit,
                "not within {limit:?}: {what}; now {:?}",
                self.newest()
            );
            thread::sleep(Duration::from_millis(5));
        }
    }
}

impl Drop for Board {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

type Shared = (
    Arc<Mutex<Vec<(Instant, Vec<u8>)>>>,
    Arc<Mutex<Vec<Truth>>>,
    Arc<AtomicBool>,
    Arc<AtomicBool>,
);

fn run(mut body: Body, socket: &UdpSocket, (received, truths, stop, frozen): Shared) {
    let (mut begin, mut elapsed) = (Instant::now(), Duration::ZERO);
    let (mut ticks, mut heard) = (0_u32, None);
    let mut buffer = [0; 2048];
    while !stop.load(Ordering::Relaxed) {
        thread::sleep(Duration::from_micros(500));
        if frozen.load(Ordering::Relaxed) {
            begin = Instant::now().checked_sub(elapsed).expect("after boot");
            continue;
        }
        while let Ok(length) = socket.recv(&mut buffer) {
            heard = Some(Instant::now());
            body.receive(&buffer[..length]);
            received
                .lock()
                .unwrap()
                .push((Instant::now(), buffer[..length].to_vec()));
        }
        elapsed = begin.elapsed();
        body.advance(Span::from_nanos(elapsed.as_nanos() as i64));
        // Frames that were missed are not made up for: a board sends what is true now.
        while elapsed > Duration::from_millis(5) * (ticks + 1) {
            ticks += 1;
        }
        if elapsed >= Duration::from_millis(5) * ticks {
            ticks += 1;
            if ticks % 20 == 0 {
                body.take_fix();
            }
            let mut frames: Vec<_> = body.sense().into_iter().collect();
            while let Some(fix) = body.arrived_fix() {
                frames.push(fix);
            }
            if ticks % 200 == 0 {
                frames.push(body.heartbeat());
            }
            for frame in frames {
                let _ = socket.send(&frame);
            }
            let (state, torque) = (body.state().robot, body.torque());
            truths.lock().unwrap().push(Truth {
                at: Instant::now(),
                v: state.v,
                q_r: state.q_r,
                torque: torque.pitch.abs().max(torque.roll.abs()),
                commanded: body.board_status().command_valid,
                heard,
            });
        }
    }
}
