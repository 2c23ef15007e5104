//! The deployed station: the core on a planning thread of its own, and its Zenoh session.
//!
//! Messages arrive on Zenoh's threads and wait in one bounded inbox, which keeps of each robot's telemetry the newest; the planning
//! thread takes them, plans when a robot is due and publishes. Nothing here waits for a robot.

mod inbox;
mod pool;

use std::num::NonZero;
use std::sync::{Arc, Mutex, PoisonError};
use std::thread;
use std::time::Duration;

use sphere_protocol::io::bus::{Bus, BusError, Role};
use sphere_protocol::io::clock::Clock;
use sphere_protocol::io::histogram::Histogram;
use sphere_protocol::key::EVERY_UP;
use sphere_protocol::robot::RobotId;
use sphere_protocol::time::GroundClock;
use thiserror::Error;
use tokio::sync::mpsc;
use tracing::{debug, info, warn};

pub use self::pool::Pool;
use crate::station::{Event, Input, Order, Output, Station, StationConfig};
use inbox::{Inbox, Taken};

/// What a station is run with.
pub struct Setup {
    /// The core's configuration.
    pub station: StationConfig,
    /// How it takes part in the fleet's network: as its router, or as client of another.
    pub network: Role,
    /// Threads that plan; without, one for every core but one.
    pub threads: Option<NonZero<usize>>,
    /// Where to show what it knows, for a display in the same process.
    pub watch: Option<Watch>,
}

/// Calls back after each step of the station with its core and its clock. Must be quick.
pub type Watch = Box<dyn FnMut(&Station, Clock<GroundClock>) + Send>;

/// What the planning thread has counted since its start.
#[derive(Clone, Debug)]
pub struct Statistics {
    /// How late robots are served: a planning tick's beginning minus when it was due, to 50 µs.
    pub lateness: Histogram,
    /// Messages taken from the network, and their bytes.
    pub received: [u64; 2],
    /// Messages handed to it, and their bytes.
    pub sent: [u64; 2],
    /// Telemetry messages that were replaced by newer ones before the planning thread took them.
    pub overtaken: u64,
    /// Messages lost because too many waited for the planning thread.
    pub refused: u64,
}

/// Why a station could not be run, or ended by itself.
#[derive(Debug, Error)]
pub enum RunError {
    /// The network refused it: most often a port that is taken.
    #[error(transparent)]
    Bus(#[from] BusError),
    /// The planning thread could not be started.
    #[error("cannot start the planning thread: {0}")]
    Thread(std::io::Error),
    /// Nor could those that it shares the work with.
    #[error("cannot start the planning threads: {0}")]
    Pool(#[from] rayon::ThreadPoolBuildError),
    /// The planning thread panicked: a defect.
    #[error("the planning thread has died; the robots brake to rest by themselves")]
    Died,
}

/// What the planning thread is told from within.
enum Told {
    Order(RobotId, Order),
    Stop,
}

/// Hands orders to a running station.
#[derive(Clone)]
pub struct Orders(Inbox<Told>);

/// Robots with telemetry, and other messages, that may wait for the planning thread.
const WAITING: usize = 16_384;
const OPEN_TIMEOUT: Duration = Duration::from_secs(10);

/// A station that runs, until it is stopped.
pub struct Running {
    orders: Orders,
    statistics: Arc<Mutex<Statistics>>,
    done: tokio::sync::oneshot::Receiver<()>,
}

impl Running {
    /// Opens the network and starts planning.
    ///
    /// # Errors
    /// A port that is taken, no router, a refused configuration.
    pub async fn start(setup: Setup) -> Result<Self, RunError> {
        let Setup {
            station,
            network,
            threads,
            mut watch,
        } = setup;
        let role = network.clone();
        let bus = tokio::task::spawn_blocking(move || Bus::open(&role, OPEN_TIMEOUT))
            .await
            .map_err(|_| RunError::Died)??;
        let clock = Clock::<GroundClock>::start();
        let pool = Pool::new(threads)?;
        let core = Station::with_workers(station, clock.now(), Box::new(pool));
        let inbox = Inbox::new(WAITING);
        let (ended, done) = tokio::sync::oneshot::channel();
        let statistics = Arc::new(Mutex::new(Statistics::new()));
        let subscriber = {
            let inbox = inbox.clone();
            // Called on Zenoh's threads, which must not wait: what does not fit is lost, and the next telemetry brings it again.
            bus.subscribe(EVERY_UP, move |message| inbox.put(message))?
        };
        info!(network = %network, "station ready");
        let (counted, incoming) = (statistics.clone(), inbox.clone());
        thread::Builder::new()
            .name("planning".to_owned())
            .spawn(move || {
                planning_loop(core, clock, &bus, &incoming, &mut watch, &counted);
                drop(subscriber);
                bus.close();
                let _ = ended.send(());
            })
            .map_err(RunError::Thread)?;
        Ok(Self {
            orders: Orders(inbox),
            statistics,
            done,
        })
    }

    /// Hands orders to the station.
    pub fn orders(&self) -> Orders {
        self.orders.clone()
    }

    /// What the planning thread has counted so far.
    pub fn statistics(&self) -> Statistics {
        Statistics {
            overtaken: self.orders.0.overtaken(),
            refused: self.orders.0.refused(),
            ..shown(&self.statistics)
        }
    }

    /// Stops planning. Robots play their last plan to its end, brake and hold.
    ///
    /// # Errors
    /// The planning thread has died before.
    pub async fn stop(self) -> Result<(), RunError> {
        // If the thread is gone the wait below tells.
        let _ = self.orders.0.tell(Told::Stop);
        self.done.await.map_err(|_| RunError::Died)
    }
}

impl Orders {
    /// Gives `order` to `robot`. `false` if the station has ended or is hopelessly behind.
    pub fn give(&self, robot: RobotId, order: Order) -> bool {
        self.0.tell(Told::Order(robot, order))
    }
}

/// Runs a station until `stop`.
///
/// # Errors
/// As [`Running::start`] and [`Running::stop`].
pub async fn serve(setup: Setup, mut stop: mpsc::Receiver<()>) -> Result<(), RunError> {
    let mut running = Running::start(setup).await?;
    tokio::select! {
        _ = stop.recv() => running.stop().await,
        ended = &mut running.done => ended.map_err(|_| RunError::Died),
    }
}

fn planning_loop(
    mut station: Station,
    clock: Clock<GroundClock>,
    bus: &Bus,
    incoming: &Inbox<Told>,
    watch: &mut Option<Watch>,
    counted: &Shared<Statistics>,
) {
    loop {
        let due = station.poll_timeout();
        let mut taken = incoming.take(clock.until(due).min(IDLE));
        let mut statistics = counted.lock().unwrap_or_else(PoisonError::into_inner);
        // All that waits first: plans are made from the newest that is known.
        for _ in 0..WAITING {
            match taken {
                Some(Taken::Message(key, bytes)) => {
                    count(&mut statistics.received, bytes.len());
                    let (key, bytes) = (&*key, &*bytes);
                    station.handle_input(clock.now(), Input::Message { key, bytes });
                }
                Some(Taken::Own(Told::Order(robot, order))) => {
                    station.handle_input(clock.now(), Input::Order { robot, order });
                }
                Some(Taken::Own(Told::Stop)) => return,
                None => break,
            }
            taken = incoming.take(Duration::ZERO);
        }
        let now = clock.now();
        if station.poll_timeout() <= now {
            let late = now - station.poll_timeout();
            if let Ok(late) = u64::try_from(late.as_nanos()) {
                statistics.lateness.count(Duration::from_nanos(late));
            }
            station.handle_input(now, Input::Timeout);
        }
        while let Some(output) = station.poll_output() {
            match output {
                Output::Publish {
                    key, qos, bytes, ..
                } => {
                    count(&mut statistics.sent, bytes.len());
                    if let Err(error) = bus.publish(&key, qos, &bytes) {
                        debug!(%error, "not published");
                    }
                }
                Output::Event { robot, event } => log(robot, &event),
                Output::Overload {
                    is_over: false,
                    load,
                } => warn!(%load, "planning takes longer than there is time"),
                Output::Overload { .. } => info!("planning is in time again"),
            }
        }
        drop(statistics);
        if let Some(watch) = watch {
            watch(&station, clock);
        }
    }
}

fn count([messages, bytes]: &mut [u64; 2], length: usize) {
    *messages += 1;
    *bytes += length as u64;
}

impl Statistics {
    fn new() -> Self {
        Self {
            lateness: Histogram::new(LATENESS_BUCKET, LATENESS_BUCKETS),
            received: [0; 2],
            sent: [0; 2],
            overtaken: 0,
            refused: 0,
        }
    }
}

/// Lateness: 100 ms in all, a planning period.
const LATENESS_BUCKET: Duration = Duration::from_micros(50);
const LATENESS_BUCKETS: usize = 2000;

/// A station without robots still hears that it is to stop.
const IDLE: Duration = Duration::from_secs(1);

fn log(robot: RobotId, event: &Event) {
    match event {
        Event::Found { boot_id } => info!(%robot, boot_id, "found"),
        Event::Rebooted { boot_id } => warn!(%robot, boot_id, "rebooted"),
        Event::Mode { from, to } => info!(%robot, ?from, ?to, "mode"),
        Event::LeaseGranted { epoch } => info!(%robot, epoch, "lease granted"),
        Event::LeaseLost { station } => warn!(%robot, ?station, "lease lost"),
        Event::Refused(order) => warn!(%robot, ?order, "order refused"),
        Event::MissionStarted => info!(%robot, "mission started"),
        Event::MissionDone => info!(%robot, "mission done"),
        Event::MissionRefused(error) => warn!(%robot, %error, "mission refused"),
        Event::Incompatible(error) => warn!(%robot, %error, "incompatible: messages dropped"),
        Event::RefusedByRobot { count } => warn!(
            %robot, count, "incompatible: the robot drops our messages for their schema version; update the older side"
        ),
        Event::Stale => warn!(%robot, "telemetry is too old to plan from"),
    }
}

/// A value that one thread writes and another shows.
pub type Shared<T> = Arc<Mutex<T>>;

/// The value, whoever panicked while holding it.
pub fn shown<T: Clone>(shared: &Shared<T>) -> T {
    shared
        .lock()
        .unwrap_or_else(PoisonError::into_inner)
        .clone()
}
