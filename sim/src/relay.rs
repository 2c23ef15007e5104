//! A TCP relay that makes a loopback connection behave like a long and lossy one.
//!
//! Each direction is its own [`LinkModel`]. A segment (what one read brings, at most [`SEGMENT_MAX`] bytes) arrives `delay ± jitter`
//! after it was sent, and never before the one ahead of it: TCP keeps the order.
//!
//! *Loss on TCP is lateness.* A lost segment is sent again, and all behind it waits (head-of-line blocking). When the sender notices:
//! after three later segments were acknowledged, or at the retransmission timeout. The streams of the fleet are thin, a segment
//! every 40 to 100 ms: three later ones, and their acknowledgements on the way back, take longer than the timeout, so that each loss
//! is taken to cost one timeout,
//!
//!   RTO = max(200 ms, RTT + 4 RTTVAR),   RTT = 2 delay,   RTTVAR = √(2/π) √2 jitter
//!
//! (RFC 6298, eq. 2.3, with the lower bound of Linux, `TCP_RTO_MIN`, in place of 1 s; RTTVAR is the mean deviation of the sum of both
//! ways' normal delays). A copy may be lost as well: it is missed like the first one while others behind it are acknowledged (RACK,
//! RFC 8985), so that n losses cost n timeouts, without backing off. Real TCP over real IP with 50 ± 10 ms, 10 % loss and 50
//! messages a second had a p99 latency of 343 to 648 ms; the model has some 500. Congestion windows are not modelled: the streams
//! never fill one.
//!
//! A cut holds everything back, as a network without a route does; after it, what TCP would send again goes on at once. Real
//! senders, having backed off, may need some seconds more.

use std::io;
use std::net::SocketAddr;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal, StandardUniform};
use sphere_protocol::io::histogram::Histogram;
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::tcp::{OwnedReadHalf, OwnedWriteHalf};
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::{mpsc, watch};
use tokio::task::{AbortHandle, JoinSet};
use tokio::time::{Instant, sleep_until};
use tracing::debug;

use crate::network::LinkModel;

/// Payload of a segment on an Ethernet path: 1500 bytes less the headers of IP and TCP with time stamps.
pub const SEGMENT_MAX: usize = 1448;

/// A relay that runs until it is dropped.
pub struct Relay {
    address: SocketAddr,
    shared: Arc<Shared>,
    accepting: AbortHandle,
}

/// The model and the random stream of one direction.
#[derive(Clone, Debug)]
pub struct Direction {
    /// Delay, jitter and loss.
    pub model: LinkModel,
    /// Where its chances come from.
    pub random: ChaCha8Rng,
}

/// What has passed in one direction.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub struct Counters {
    /// Segments taken in.
    pub segments: u64,
    /// Bytes delivered.
    pub bytes: u64,
    /// Segments that were lost at least once.
    pub stalls: u64,
    /// How long the newest segment that was delivered had been under way, stalls and cuts included.
    pub latency: Duration,
}

/// How long segments of one direction took, to 0.25 ms.
#[derive(Clone, Debug)]
pub struct Delays {
    /// What they were meant to take: the model's delay, and the wait for those ahead.
    pub meant: Histogram,
    /// What they took, from being read to being written.
    pub measured: Histogram,
}

struct Shared {
    onward: SocketAddr,
    cut: watch::Sender<bool>,
    up: Way,
    down: Way,
}

/// One direction of all connections.
struct Way {
    chances: Mutex<Direction>,
    segments: AtomicU64,
    bytes: AtomicU64,
    stalls: AtomicU64,
    latency_ns: AtomicU64,
    delays: Mutex<Delays>,
}

struct Segment {
    sent: Instant,
    due: Instant,
    bytes: Vec<u8>,
}

impl Relay {
    /// Listens on `local` (port 0: any that is free) and connects whoever comes to `onward`: `up` is their way there, `down` the
    /// way back. Within a tokio runtime.
    ///
    /// # Errors
    /// The address is taken.
    pub async fn start(
        local: SocketAddr,
        onward: SocketAddr,
        up: Direction,
        down: Direction,
    ) -> io::Result<Self> {
        let listener = TcpListener::bind(local).await?;
        let address = listener.local_addr()?;
        let shared = Arc::new(Shared {
            onward,
            cut: watch::Sender::new(false),
            up: Way::new(up),
            down: Way::new(down),
        });
        let accepting = tokio::spawn(accept(listener, shared.clone())).abort_handle();
        Ok(Self {
            address,
            shared,
            accepting,
        })
    }

    /// Where it listens.
    pub fn address(&self) -> SocketAddr {
        self.address
    }

    /// Lets nothing through any more; connections stay open and new ones get no answer.
    pub fn cut(&self) {
        self.shared.cut.send_replace(true);
    }

    /// Lets everything through again, what was held back first.
    pub fn heal(&self) {
        self.shared.cut.send_replace(false);
    }

    /// Whether it is cut.
    pub fn is_cut(&self) -> bool {
        *self.shared.cut.borrow()
    }

    /// What has passed from those who connected.
    pub fn up(&self) -> Counters {
        self.shared.up.counters()
    }

    /// How long segments took: from those who connected, and back to them.
    pub fn delays(&self) -> [Delays; 2] {
        [&self.shared.up, &self.shared.down].map(|way| {
            let delays = way.delays.lock().unwrap_or_else(PoisonError::into_inner);
            delays.clone()
        })
    }

    /// What has passed back to them.
    pub fn down(&self) -> Counters {
        self.shared.down.counters()
    }
}

impl Drop for Relay {
    fn drop(&mut self) {
        self.accepting.abort();
    }
}

/// The retransmission timeout of a connection both ways of which are like `model`.
pub fn retransmission_timeout(model: &LinkModel) -> Duration {
    let mean_deviation = (2.0 / core::f64::consts::PI).sqrt() * core::f64::consts::SQRT_2;
    let seconds = 2.0 * model.delay + 4.0 * mean_deviation * model.jitter;
    duration(seconds).max(RTO_MIN)
}

async fn accept(listener: TcpListener, shared: Arc<Shared>) {
    // Dropped with this task, and with it every connection.
    let mut connections = JoinSet::new();
    loop {
        while connections.try_join_next().is_some() {}
        match listener.accept().await {
            Ok((client, _)) => {
                let shared = shared.clone();
                connections.spawn(async move {
                    if let Err(error) = connect(client, &shared).await {
                        debug!(%error, "relayed connection");
                    }
                });
            }
            // Out of file descriptors, or a client that was gone at once: the next one may fare better.
            Err(error) => {
                debug!(%error, "relay");
                tokio::time::sleep(ACCEPT_PAUSE).await;
            }
        }
    }
}

async fn connect(client: TcpStream, shared: &Shared) -> io::Result<()> {
    // Without a route there is no handshake either.
    let mut cut = shared.cut.subscribe();
    let _ = cut.wait_for(|cut| !cut).await;
    let server = TcpStream::connect(shared.onward).await?;
    for stream in [&client, &server] {
        stream.set_nodelay(true)?;
    }
    let (client_reads, client_writes) = client.into_split();
    let (server_reads, server_writes) = server.into_split();
    // A connection that breaks in one direction is of no use in the other.
    tokio::select! {
        ended = pump(client_reads, server_writes, &shared.up, &shared.cut) => ended,
        ended = pump(server_reads, client_writes, &shared.down, &shared.cut) => ended,
    }
}

/// Moves one direction of one connection until its end has arrived.
async fn pump(
    from: OwnedReadHalf,
    to: OwnedWriteHalf,
    way: &Way,
    cut: &watch::Sender<bool>,
) -> io::Result<()> {
    let (under_way, arriving) = mpsc::channel(UNDER_WAY_MAX);
    let (_, delivered) = tokio::join!(
        take(from, way, under_way),
        deliver(to, way, arriving, cut.subscribe())
    );
    delivered
}

async fn take(mut from: OwnedReadHalf, way: &Way, under_way: mpsc::Sender<Segment>) {
    let mut last_due = Instant::now();
    let mut buffer = [0; SEGMENT_MAX];
    loop {
        // An end, orderly or not, travels like a segment: as the closing of the queue.
        let Ok(length @ 1..) = from.read(&mut buffer).await else {
            return;
        };
        let sent = Instant::now();
        let due = (sent + way.draw()).max(last_due);
        last_due = due;
        let segment = Segment {
            sent,
            due,
            bytes: buffer[..length].to_vec(),
        };
        if under_way.send(segment).await.is_err() {
            return;
        }
    }
}

async fn deliver(
    mut to: OwnedWriteHalf,
    way: &Way,
    mut arriving: mpsc::Receiver<Segment>,
    mut cut: watch::Receiver<bool>,
) -> io::Result<()> {
    while let Some(segment) = arriving.recv().await {
        sleep_until(segment.due).await;
        let _ = cut.wait_for(|cut| !cut).await;
        to.write_all(&segment.bytes).await?;
        way.count_delivery(&segment);
    }
    to.shutdown().await
}

impl Way {
    fn new(chances: Direction) -> Self {
        Self {
            chances: Mutex::new(chances),
            segments: AtomicU64::new(0),
            bytes: AtomicU64::new(0),
            stalls: AtomicU64::new(0),
            latency_ns: AtomicU64::new(0),
            delays: Mutex::new(Delays {
                meant: Histogram::new(DELAY_BUCKET, DELAY_BUCKETS),
                measured: Histogram::new(DELAY_BUCKET, DELAY_BUCKETS),
            }),
        }
    }

    /// How long the next segment takes, by itself.
    fn draw(&self) -> Duration {
        let mut chances = self.chances.lock().unwrap_or_else(PoisonError::into_inner);
        let Direction { model, random } = &mut *chances;
        let normal: f64 = StandardNormal.sample(random);
        let mut losses = 0;
        while losses < LOSSES_MAX && uniform(random) < model.loss {
            losses += 1;
        }
        self.segments.fetch_add(1, Ordering::Relaxed);
        if losses > 0 {
            self.stalls.fetch_add(1, Ordering::Relaxed);
        }
        let delay = duration(model.delay + model.jitter * normal);
        delay + retransmission_timeout(model) * losses
    }

    fn count_delivery(&self, segment: &Segment) {
        let latency = segment.sent.elapsed();
        {
            let mut delays = self.delays.lock().unwrap_or_else(PoisonError::into_inner);
            delays.meant.count(segment.due - segment.sent);
            delays.measured.count(latency);
        }
        let latency = latency.as_nanos();
        self.bytes
            .fetch_add(segment.bytes.len() as u64, Ordering::Relaxed);
        self.latency_ns.store(
            u64::try_from(latency).unwrap_or(u64::MAX),
            Ordering::Relaxed,
        );
    }

    fn counters(&self) -> Counters {
        let read = |count: &AtomicU64| count.load(Ordering::Relaxed);
        Counters {
            segments: read(&self.segments),
            bytes: read(&self.bytes),
            stalls: read(&self.stalls),
            latency: Duration::from_nanos(read(&self.latency_ns)),
        }
    }
}

fn uniform(random: &mut ChaCha8Rng) -> f64 {
    StandardUniform.sample(random)
}

/// `seconds`, at least none; what is no duration is none.
fn duration(seconds: f64) -> Duration {
    Duration::try_from_secs_f64(seconds).unwrap_or_default()
}

const RTO_MIN: Duration = Duration::from_millis(200);
/// Copies that are lost in a row at most: one in a million at 10 % loss, and at any loss the next one gets through.
const LOSSES_MAX: u32 = 6;
/// Segments between the two ends, a second of a busy robot's; then the sender has to wait.
const UNDER_WAY_MAX: usize = 1024;
/// Delays: 2 s in all.
const DELAY_BUCKET: Duration = Duration::from_micros(250);
const DELAY_BUCKETS: usize = 8000;
const ACCEPT_PAUSE: Duration = Duration::from_millis(100);

#[cfg(test)]
mod tests {
    use rand::SeedableRng;

    use super::*;

    fn way(delay: f64, jitter: f64, loss: f64) -> Way {
        Way::new(Direction {
            model: LinkModel {
                delay,
                jitter,
                loss,
            },
            random: ChaCha8Rng::seed_from_u64(1),
        })
    }

    /// RFC 6298, eq. 2.3, by hand: 0.2 + 4 · √(4/π) · 0.02 = 0.290; and the lower bound.
    #[test]
    fn the_timeout_follows_the_round_trip() {
        let rto = |delay, jitter| {
            retransmission_timeout(&LinkModel {
                delay,
                jitter,
                loss: 0.0,
            })
        };
        assert_eq!(rto(0.1, 0.02).as_millis(), 290);
        assert_eq!(rto(0.01, 0.0), RTO_MIN);
    }

    /// The p99 latency of real TCP at 50 ± 10 ms, 10 % loss and 50 Hz was measured as 343 to 648 ms.
    #[test]
    fn messages_are_as_late_as_on_real_tcp() {
        let way = way(0.05, 0.01, 0.1);
        let mut arrived = 0.0_f64;
        let mut latencies: Vec<f64> = (0..100_000)
            .map(|i| {
                let sent = f64::from(i) * 0.02;
                arrived = arrived.max(sent + way.draw().as_secs_f64());
                arrived - sent
            })
            .collect();
        latencies.sort_by(f64::total_cmp);
        let p99 = latencies[99_000];
        assert!((0.343..0.648).contains(&p99), "p99 {p99}");
    }
}
