//! The fleet's messages on Zenoh.
//!
//! What every user of Zenoh runs into is decided here, once:
//! - subscribers are callbacks: the default queue blocks the session's receive task when it is full;
//! - a session never hears its own messages;
//! - periodic data is dropped when a link is congested, never waited for; single orders go ahead of it;
//! - both ends announce a lease of 1 s: the *other* side's announcement decides how soon a frozen end is noticed;
//! - opening a session has a timeout that times out: Zenoh resolves synchronously, so it runs in a thread of its own;
//! - no discovery, and no listening but where told.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, PoisonError, mpsc};
use std::thread;
use std::time::Duration;

use thiserror::Error;
use zenoh::Wait;
use zenoh::liveliness::LivelinessToken;
use zenoh::pubsub::{Publisher, Subscriber};
use zenoh::qos::{CongestionControl, Priority};
use zenoh::sample::{Locality, SampleKind};

use crate::document::shared::Endpoints;
use crate::message::Qos;

/// How a session takes part in the network.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Role {
    /// A router in this process that listens on these endpoints (`tcp/127.0.0.1:7447`).
    Router {
        /// Where to listen.
        listen: Vec<String>,
    },
    /// A client of the router at one of these endpoints.
    Client {
        /// Where to connect.
        connect: Vec<String>,
    },
}

/// One session. Dropping it closes it.
pub struct Bus {
    session: zenoh::Session,
    publishers: Mutex<BTreeMap<String, Publisher<'static>>>,
}

/// A message that arrived, or a sign of life that came or went.
#[derive(Clone, Debug)]
pub struct Received {
    /// The key it was published on.
    pub key: String,
    /// Its bytes; empty for a sign of life.
    pub bytes: Vec<u8>,
    /// For a sign of life: whether it went. Messages are never deletions.
    pub gone: bool,
}

/// What keeps a subscription, or a sign of life, alive: dropping it ends it.
pub enum Declared {
    /// A subscription.
    Subscriber(Subscriber<()>),
    /// A sign of life.
    Alive(LivelinessToken),
}

/// Why the bus could not be used.
#[derive(Debug, Error)]
pub enum BusError {
    /// The configuration of the session was refused.
    #[error("Zenoh refuses the setting {key} = {value}: {why}")]
    Config {
        /// Zenoh's key.
        key: &'static str,
        /// The value.
        value: String,
        /// What Zenoh says.
        why: String,
    },
    /// No session came up in time.
    #[error("no Zenoh session within {} s ({role})", .timeout.as_secs_f64())]
    Timeout {
        /// How long it was tried.
        timeout: Duration,
        /// What was tried.
        role: String,
    },
    /// The session could not be opened.
    #[error("Zenoh session ({role}): {why}")]
    Open {
        /// What was tried.
        role: String,
        /// What Zenoh says.
        why: String,
    },
    /// A declaration or a publication was refused.
    #[error("Zenoh, key {key}: {why}")]
    Key {
        /// The key.
        key: String,
        /// What Zenoh says.
        why: String,
    },
}

/// A frozen end is noticed this long after its last sign of life.
const LEASE_MS: u32 = 1000;

impl Bus {
    /// Opens a session, for at most `timeout`.
    ///
    /// A client needs its router: call again until it is there.
    ///
    /// # Errors
    /// A refused configuration, a port that is taken, no router, or no answer in time.
    pub fn open(role: &Role, timeout: Duration) -> Result<Self, BusError> {
        let config = role.config()?;
        let (opened, result) = mpsc::sync_channel(1);
        thread::spawn(move || {
            // If nobody waits any more the session is dropped, and with that closed.
            let _ = opened.send(zenoh::open(config).wait());
        });
        match result.recv_timeout(timeout) {
            Ok(Ok(session)) => Ok(Self {
                session,
                publishers: Mutex::default(),
            }),
            Ok(Err(error)) => Err(BusError::Open {
                role: role.to_string(),
                why: first_line(&error.to_string()),
            }),
            Err(_) => Err(BusError::Timeout {
                timeout,
                role: role.to_string(),
            }),
        }
    }

    /// Publishes `bytes` on `key`. Never waits: on a congested link the message is dropped.
    ///
    /// # Errors
    /// The key is none, or the session is closed. A refusal by access control looks like success.
    pub fn publish(&self, key: &str, qos: Qos, bytes: &[u8]) -> Result<(), BusError> {
        let refused = |error: zenoh::Error| BusError::Key {
            key: key.to_owned(),
            why: first_line(&error.to_string()),
        };
        let mut publishers = self
            .publishers
            .lock()
            .unwrap_or_else(PoisonError::into_inner);
        if !publishers.contains_key(key) {
            let urgent = qos == Qos::Urgent;
            let publisher = self
                .session
                .declare_publisher(key.to_owned())
                .congestion_control(CongestionControl::Drop)
                .priority(if urgent {
                    Priority::InteractiveHigh
                } else {
                    Priority::Data
                })
                .express(urgent)
                .allowed_destination(Locality::Remote)
                .wait()
                .map_err(refused)?;
            publishers.insert(key.to_owned(), publisher);
        }
        match publishers.get(key) {
            Some(publisher) => publisher.put(bytes).wait().map_err(refused),
            None => Ok(()),
        }
    }

    /// Calls `on_message` for every message on keys that `selector` matches, on a thread of Zenoh's: it must not wait.
    ///
    /// # Errors
    /// The selector is no key expression, or the session is closed.
    pub fn subscribe(
        &self,
        selector: &str,
        on_message: impl Fn(Received) + Send + Sync + 'static,
    ) -> Result<Declared, BusError> {
        self.session
            .declare_subscriber(selector.to_owned())
            .allowed_origin(Locality::Remote)
            .callback(move |sample| {
                if sample.kind() == SampleKind::Put {
                    on_message(Received {
                        key: sample.key_expr().as_str().to_owned(),
                        bytes: sample.payload().to_bytes().into_owned(),
                        gone: false,
                    });
                }
            })
            .wait()
            .map(Declared::Subscriber)
            .map_err(|error| BusError::Key {
                key: selector.to_owned(),
                why: first_line(&error.to_string()),
            })
    }

    /// Shows a sign of life on `key` for as long as what it returns lives. A hint: it may outlive a crash.
    ///
    /// # Errors
    /// The key is none, or the session is closed.
    pub fn show_life(&self, key: &str) -> Result<Declared, BusError> {
        self.session
            .liveliness()
            .declare_token(key.to_owned())
            .wait()
            .map(Declared::Alive)
            .map_err(|error| BusError::Key {
                key: key.to_owned(),
                why: first_line(&error.to_string()),
            })
    }

    /// Calls `on_change` for every sign of life on keys that `selector` matches: those that are there, and each that comes or goes.
    ///
    /// # Errors
    /// The selector is no key expression, or the session is closed.
    pub fn watch_life(
        &self,
        selector: &str,
        on_change: impl Fn(Received) + Send + Sync + 'static,
    ) -> Result<Declared, BusError> {
        self.session
            .liveliness()
            .declare_subscriber(selector.to_owned())
            .history(true)
            .callback(move |sample| {
                on_change(Received {
                    key: sample.key_expr().as_str().to_owned(),
                    bytes: Vec::new(),
                    gone: sample.kind() == SampleKind::Delete,
                });
            })
            .wait()
            .map(Declared::Subscriber)
            .map_err(|error| BusError::Key {
                key: selector.to_owned(),
                why: first_line(&error.to_string()),
            })
    }

    /// Closes the session now.
    pub fn close(&self) {
        let _ = self.session.close().wait();
    }
}

impl Role {
    fn config(&self) -> Result<zenoh::Config, BusError> {
        let quoted = |list: &[String]| serde_json::to_string(list).unwrap_or_default();
        let mut settings: Vec<(&'static str, String)> = vec![
            ("scouting/multicast/enabled", "false".to_owned()),
            ("scouting/gossip/enabled", "false".to_owned()),
            ("transport/link/tx/lease", LEASE_MS.to_string()),
            // Reconnection within a second of a router's return.
            (
                "connect/retry",
                r#"{ "period_init_ms": 100, "period_max_ms": 500, "period_increase_factor": 1.5 }"#
                    .to_owned(),
            ),
        ];
        match self {
            Self::Router { listen } => {
                settings.push(("mode", r#""router""#.to_owned()));
                settings.push(("listen/endpoints", quoted(listen)));
            }
            Self::Client { connect } => {
                settings.push(("mode", r#""client""#.to_owned()));
                settings.push(("listen/endpoints", "[]".to_owned()));
                settings.push(("connect/endpoints", quoted(connect)));
            }
        }
        let mut config = zenoh::Config::default();
        for (key, value) in settings {
            config
                .insert_json5(key, &value)
                .map_err(|error| BusError::Config {
                    key,
                    value: value.clone(),
                    why: first_line(&error.to_string()),
                })?;
        }
        Ok(config)
    }
}

impl From<Endpoints> for Role {
    fn from(endpoints: Endpoints) -> Self {
        match endpoints {
            Endpoints::Listen(listen) => Self::Router { listen },
            Endpoints::Connect(connect) => Self::Client { connect },
        }
    }
}

impl std::fmt::Display for Role {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Router { listen } => write!(f, "router listening on {}", listen.join(", ")),
            Self::Client { connect } => write!(f, "client of {}", connect.join(", ")),
        }
    }
}

/// Messages from bus threads to a loop that may be late: the newest `capacity` are kept, the oldest dropped and counted.
#[derive(Clone)]
pub struct Inbox {
    shared: Arc<Mutex<InboxState>>,
    capacity: usize,
}

#[derive(Default)]
struct InboxState {
    messages: std::collections::VecDeque<Received>,
    dropped: u64,
}

impl Inbox {
    /// An inbox for `capacity` messages.
    pub fn new(capacity: usize) -> Self {
        Self {
            shared: Arc::default(),
            capacity,
        }
    }

    /// Adds a message; drops the oldest if it is full.
    pub fn push(&self, message: Received) {
        let mut state = self.shared.lock().unwrap_or_else(PoisonError::into_inner);
        if state.messages.len() >= self.capacity {
            state.messages.pop_front();
            state.dropped += 1;
        }
        state.messages.push_back(message);
    }

    /// Takes the oldest message.
    pub fn pop(&self) -> Option<Received> {
        self.shared
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .messages
            .pop_front()
    }

    /// How many were dropped since the start.
    pub fn dropped(&self) -> u64 {
        self.shared
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .dropped
    }
}

/// What Zenoh says, less where in its sources it says so.
fn first_line(text: &str) -> String {
    let line = text.lines().next().unwrap_or_default();
    let told = match line.rsplit_once(" at ") {
        Some((told, place)) if place.contains(".rs:") => told,
        _ => line,
    };
    told.trim_end().to_owned()
}
