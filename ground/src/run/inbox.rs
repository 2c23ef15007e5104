//! What waits for the planning thread: of each robot's telemetry the newest alone, everything else in order.
//!
//! A station that falls behind for a moment must not plan from the past until it has caught up: telemetry that was not taken yet is
//! replaced where it waits. So what waits is bounded by the number of robots, and is never older than the last message.

use std::collections::{BTreeMap, VecDeque};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use sphere_protocol::io::bus::Received;
use sphere_protocol::message::{Message, Telemetry};

/// Shared by those who put in and the one who takes out.
pub(super) struct Inbox<T> {
    shared: Arc<Shared<T>>,
}

struct Shared<T> {
    state: Mutex<State<T>>,
    filled: Condvar,
    capacity: usize,
}

struct State<T> {
    order: VecDeque<Waiting<T>>,
    /// Telemetry that waits, by its key.
    newest: BTreeMap<String, Vec<u8>>,
    overtaken: u64,
    refused: u64,
}

enum Waiting<T> {
    /// The telemetry under this key.
    Telemetry(String),
    Other(Taken<T>),
}

/// What is taken out.
#[derive(Debug, PartialEq, Eq)]
pub(super) enum Taken<T> {
    /// From the network: key and bytes.
    Message(String, Vec<u8>),
    /// From within this process.
    Own(T),
}

impl<T> Inbox<T> {
    /// For `capacity` messages that are no telemetry.
    pub(super) fn new(capacity: usize) -> Self {
        let state = State {
            order: VecDeque::new(),
            newest: BTreeMap::new(),
            overtaken: 0,
            refused: 0,
        };
        Self {
            shared: Arc::new(Shared {
                state: Mutex::new(state),
                filled: Condvar::new(),
                capacity,
            }),
        }
    }

    /// Puts in a message of the network. Never waits for longer than a lock is held.
    pub(super) fn put(&self, message: Received) {
        let Received { key, bytes, .. } = message;
        let mut state = self.lock();
        if is_telemetry(&key) {
            if let Some(waiting) = state.newest.get_mut(&key) {
                *waiting = bytes;
                state.overtaken += 1;
                return;
            }
            // A stranger who invents robots fills the space of messages, not the memory.
            if state.newest.len() >= self.shared.capacity {
                state.refused += 1;
                return;
            }
            state.newest.insert(key.clone(), bytes);
            state.order.push_back(Waiting::Telemetry(key));
        } else if state.order.len() >= self.shared.capacity {
            state.refused += 1;
            return;
        } else {
            let message = Taken::Message(key, bytes);
            state.order.push_back(Waiting::Other(message));
        }
        drop(state);
        self.shared.filled.notify_one();
    }

    /// Puts in what comes from within; `false` if it is full.
    pub(super) fn tell(&self, own: T) -> bool {
        let mut state = self.lock();
        if state.order.len() >= self.shared.capacity {
            return false;
        }
        state.order.push_back(Waiting::Other(Taken::Own(own)));
        drop(state);
        self.shared.filled.notify_one();
        true
    }

    /// What came first, waited for until `timeout` from now.
    pub(super) fn take(&self, timeout: Duration) -> Option<Taken<T>> {
        let mut state = self.lock();
        if state.order.is_empty() && !timeout.is_zero() {
            // Woken for nothing it is a mere loop of the caller's more.
            let waited = self.shared.filled.wait_timeout(state, timeout);
            (state, _) = waited.unwrap_or_else(PoisonError::into_inner);
        }
        match state.order.pop_front()? {
            Waiting::Other(other) => Some(other),
            Waiting::Telemetry(key) => {
                let bytes = state.newest.remove(&key)?;
                Some(Taken::Message(key, bytes))
            }
        }
    }

    /// Telemetry messages that were replaced by newer ones before they were taken.
    pub(super) fn overtaken(&self) -> u64 {
        self.lock().overtaken
    }

    /// Messages lost because too many waited.
    pub(super) fn refused(&self) -> u64 {
        self.lock().refused
    }

    fn lock(&self) -> MutexGuard<'_, State<T>> {
        self.shared
            .state
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
    }
}

impl<T> Clone for Inbox<T> {
    fn clone(&self) -> Self {
        Self {
            shared: self.shared.clone(),
        }
    }
}

fn is_telemetry(key: &str) -> bool {
    key.rsplit_once('/')
        .is_some_and(|(_, topic)| topic == Telemetry::TOPIC)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn message(key: &str, byte: u8) -> Received {
        Received {
            key: key.to_owned(),
            bytes: vec![byte],
            gone: false,
        }
    }

    fn taken(inbox: &Inbox<u8>) -> Vec<Taken<u8>> {
        core::iter::from_fn(|| inbox.take(Duration::ZERO)).collect()
    }

    /// Robot by robot only the newest telemetry is there, in the place of the one it replaced; status and orders are all there.
    #[test]
    fn telemetry_that_waits_is_replaced_by_newer() {
        let inbox = Inbox::new(4);
        let (r1, r2) = ("fleet/v1/r1/up/telemetry", "fleet/v1/r2/up/telemetry");
        inbox.put(message(r1, 1));
        inbox.put(message("fleet/v1/r1/up/status", 2));
        inbox.put(message(r2, 3));
        for byte in 4..100 {
            inbox.put(message(r1, byte));
        }
        assert!(inbox.tell(7));
        assert_eq!(
            taken(&inbox),
            [
                Taken::Message(r1.to_owned(), vec![99]),
                Taken::Message("fleet/v1/r1/up/status".to_owned(), vec![2]),
                Taken::Message(r2.to_owned(), vec![3]),
                Taken::Own(7),
            ]
        );
        assert_eq!(inbox.overtaken(), 96);
        assert_eq!(inbox.refused(), 0);
        // Taken, it waits no more: the next one is a new one.
        inbox.put(message(r1, 100));
        assert_eq!(taken(&inbox), [Taken::Message(r1.to_owned(), vec![100])]);
    }

    #[test]
    fn a_flood_is_refused_and_counted() {
        let inbox = Inbox::<u8>::new(3);
        for robot in 0..10 {
            inbox.put(message(&format!("fleet/v1/r{robot}/up/telemetry"), 0));
            inbox.put(message(&format!("fleet/v1/r{robot}/up/status"), 0));
        }
        assert!(!inbox.tell(1));
        assert_eq!(taken(&inbox).len() as u64 + inbox.refused(), 20);
        assert!(inbox.refused() >= 14);
    }

    #[test]
    fn who_takes_waits_until_there_is_something() {
        let inbox = Inbox::<u8>::new(3);
        assert_eq!(inbox.take(Duration::from_millis(1)), None);
        let putting = inbox.clone();
        let thread = std::thread::spawn(move || putting.tell(1));
        assert_eq!(inbox.take(Duration::from_secs(60)), Some(Taken::Own(1)));
        assert!(thread.join().expect("no panic"));
    }
}
