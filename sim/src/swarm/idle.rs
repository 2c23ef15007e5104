//! How late the machine itself is: a bare thread on absolute deadlines, scheduled as control threads are, that does nothing else.

use std::io;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use sphere_protocol::io::histogram::Histogram;
use sphere_protocol::io::real_time;

/// The thread, until it is dropped.
pub(super) struct Idle {
    shared: Arc<Shared>,
    thread: Option<JoinHandle<()>>,
}

struct Shared {
    stop: AtomicBool,
    lateness: Mutex<Histogram>,
    is_real_time: AtomicBool,
}

impl Idle {
    #[allow(
        clippy::disallowed_methods,
        reason = "it measures the machine's lateness"
    )]
    pub(super) fn start() -> io::Result<Self> {
        let shared = Arc::new(Shared {
            stop: AtomicBool::new(false),
            lateness: Mutex::new(Histogram::new(BUCKET, BUCKETS)),
            is_real_time: AtomicBool::new(false),
        });
        let ours = shared.clone();
        let thread = thread::Builder::new()
            .name("idle".to_owned())
            .spawn(move || {
                let granted = real_time::begin(real_time::CONTROL).is_ok();
                ours.is_real_time.store(granted, Ordering::Relaxed);
                let mut due = Instant::now();
                while !ours.stop.load(Ordering::Relaxed) {
                    due += PERIOD;
                    thread::sleep(due.saturating_duration_since(Instant::now()));
                    let late = Instant::now().saturating_duration_since(due);
                    ours.lock().count(late);
                }
            })?;
        Ok(Self {
            shared,
            thread: Some(thread),
        })
    }

    /// All it has counted.
    pub(super) fn lateness(&self) -> Histogram {
        self.shared.lock().clone()
    }

    /// Whether the system let it run under SCHED_FIFO.
    pub(super) fn is_real_time(&self) -> bool {
        self.shared.is_real_time.load(Ordering::Relaxed)
    }
}

impl Shared {
    fn lock(&self) -> std::sync::MutexGuard<'_, Histogram> {
        self.lateness.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Drop for Idle {
    fn drop(&mut self) {
        self.shared.stop.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

/// Often enough for a quantile of 99.9 % within seconds, and under a per cent of a core.
const PERIOD: Duration = Duration::from_millis(2);
/// As control steps are counted.
const BUCKET: Duration = Duration::from_micros(25);
const BUCKETS: usize = 1000;
