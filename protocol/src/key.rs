//! Where messages travel: the key expressions of the fleet on Zenoh.
//!
//! | key | who publishes | what |
//! |---|---|---|
//! | `fleet/v1/<robot>/up/<topic>` | the robot | telemetry, status |
//! | `fleet/v1/<robot>/down/<topic>` | the station | plans |
//! | `fleet/v1/<robot>/cmd/<topic>` | the station | commands |
//! | `fleet/v1/<robot>/beacon` | the robot | the one key that every robot may read |
//!
//! One rule of access control for each direction and robot follows from this. Keys are built without allocation.
//!
//! ```
//! use sphere_protocol::key::Key;
//! use sphere_protocol::message::{Direction, Telemetry};
//!
//! let robot = "r1".parse()?;
//! let key = Key::of::<Telemetry>(&robot);
//! assert_eq!(key.text().as_str(), "fleet/v1/r1/up/telemetry");
//! assert_eq!(Key::parse("fleet/v1/r1/up/telemetry")?, key);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

use core::fmt::{self, Write};

use arrayvec::ArrayString;
use thiserror::Error;

use crate::message::{Direction, Message};
use crate::robot::{RobotId, RobotIdError};

/// Longest topic [bytes].
pub const TOPIC_MAX: usize = 32;

/// A key as text.
pub type KeyText = ArrayString<KEY_MAX>;

/// What a station subscribes to: everything that robots publish for it.
pub const EVERY_UP: &str = "fleet/v1/*/up/**";
/// What a robot or a station subscribes to: the beacons of all robots.
pub const EVERY_BEACON: &str = "fleet/v1/*/beacon";

/// A key, taken apart.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Key<'t> {
    robot: RobotId,
    direction: Direction,
    topic: &'t str,
}

/// Why a text is no [`Key`].
#[derive(Debug, Error, PartialEq, Eq)]
pub enum KeyError {
    /// Not below `fleet/v1`.
    #[error("key `{0}` does not begin with `fleet/v1/`")]
    Foreign(String),
    /// Not the shape of any direction.
    #[error(
        "key `{0}` is none of fleet/v1/<robot>/{{up,down,cmd}}/<topic>, fleet/v1/<robot>/beacon"
    )]
    Shape(String),
    /// The robot's chunk is no robot id.
    #[error("key `{key}`: {error}")]
    Robot {
        /// The key.
        key: String,
        /// What is wrong with its robot.
        error: RobotIdError,
    },
    /// The topic is empty, too long, or has a character that could be wild or a separator.
    #[error("topic `{0}` must be 1 to 32 of A-Z a-z 0-9 - _ .")]
    Topic(String),
}

impl<'t> Key<'t> {
    /// The key of messages `M` of, or for, `robot`.
    pub const fn of<M: Message>(robot: &RobotId) -> Self {
        const { assert!(is_topic(M::TOPIC)) };
        Self {
            robot: *robot,
            direction: M::DIRECTION,
            topic: M::TOPIC,
        }
    }

    /// The key of `topic`; beacons have the topic `beacon` and no other.
    ///
    /// # Errors
    /// The topic is none.
    pub fn new(robot: &RobotId, direction: Direction, topic: &'t str) -> Result<Self, KeyError> {
        let fits = direction != Direction::Beacon || topic == BEACON;
        if !is_topic(topic) || !fits {
            return Err(KeyError::Topic(topic.to_owned()));
        }
        Ok(Self {
            robot: *robot,
            direction,
            topic,
        })
    }

    /// Takes `key` apart.
    ///
    /// # Errors
    /// It is not a key of the fleet, or has wild chunks.
    pub fn parse(key: &'t str) -> Result<Self, KeyError> {
        let Some(rest) = key.strip_prefix(PREFIX) else {
            return Err(KeyError::Foreign(key.to_owned()));
        };
        let mut chunks = rest.split('/');
        let (robot, direction, topic) =
            match [chunks.next(), chunks.next(), chunks.next(), chunks.next()] {
                [Some(robot), Some(BEACON), None, None] => (robot, Direction::Beacon, BEACON),
                [Some(robot), Some(UP), Some(topic), None] => (robot, Direction::Up, topic),
                [Some(robot), Some(DOWN), Some(topic), None] => (robot, Direction::Down, topic),
                [Some(robot), Some(COMMAND), Some(topic), None] => {
                    (robot, Direction::Command, topic)
                }
                _ => return Err(KeyError::Shape(key.to_owned())),
            };
        let robot = robot.parse().map_err(|error| KeyError::Robot {
            key: key.to_owned(),
            error,
        })?;
        Self::new(&robot, direction, topic)
    }

    /// Whose key it is.
    pub const fn robot(&self) -> RobotId {
        self.robot
    }

    /// Where it leads.
    pub const fn direction(&self) -> Direction {
        self.direction
    }

    /// Its last chunk.
    pub const fn topic(&self) -> &'t str {
        self.topic
    }

    /// The key as text.
    pub fn text(&self) -> KeyText {
        text(format_args!("{self}"))
    }
}

impl fmt::Display for Key<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { robot, topic, .. } = self;
        match self.direction {
            Direction::Up => write!(f, "{PREFIX}{robot}/{UP}/{topic}"),
            Direction::Down => write!(f, "{PREFIX}{robot}/{DOWN}/{topic}"),
            Direction::Command => write!(f, "{PREFIX}{robot}/{COMMAND}/{topic}"),
            Direction::Beacon => write!(f, "{PREFIX}{robot}/{BEACON}"),
        }
    }
}

/// The selector of every key of `robot` in `direction`: what it subscribes to, or what access control allows it.
pub fn every(robot: &RobotId, direction: Direction) -> KeyText {
    match direction {
        Direction::Up => text(format_args!("{PREFIX}{robot}/{UP}/**")),
        Direction::Down => text(format_args!("{PREFIX}{robot}/{DOWN}/**")),
        Direction::Command => text(format_args!("{PREFIX}{robot}/{COMMAND}/**")),
        Direction::Beacon => text(format_args!("{PREFIX}{robot}/{BEACON}")),
    }
}

fn text(key: fmt::Arguments<'_>) -> KeyText {
    let mut text = KeyText::new();
    text.write_fmt(key)
        .expect("robot id and topic are bounded, and KEY_MAX is their sum");
    text
}

/// Whether `topic` is one plain chunk of a key.
const fn is_topic(topic: &str) -> bool {
    let bytes = topic.as_bytes();
    let mut i = 0;
    while i < bytes.len() {
        if !(bytes[i].is_ascii_alphanumeric() || matches!(bytes[i], b'-' | b'_' | b'.')) {
            return false;
        }
        i += 1;
    }
    !bytes.is_empty() && bytes.len() <= TOPIC_MAX
}

const PREFIX: &str = "fleet/v1/";
const UP: &str = "up";
const DOWN: &str = "down";
const COMMAND: &str = "cmd";
const BEACON: &str = "beacon";

/// Prefix, robot id, the longest direction with its two slashes, topic.
const KEY_MAX: usize = PREFIX.len() + 32 + "/down/".len() + TOPIC_MAX;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::message::{Beacon, Command, SetpointPlan, Status, Telemetry};

    fn robot(id: &str) -> RobotId {
        id.parse().expect("a valid id")
    }

    #[test]
    fn every_message_has_its_key_and_back() {
        let r1 = robot("r1");
        let keys = [
            (Key::of::<Telemetry>(&r1), "fleet/v1/r1/up/telemetry"),
            (Key::of::<Status>(&r1), "fleet/v1/r1/up/status"),
            (Key::of::<SetpointPlan>(&r1), "fleet/v1/r1/down/plan"),
            (Key::of::<Command>(&r1), "fleet/v1/r1/cmd/command"),
            (Key::of::<Beacon>(&r1), "fleet/v1/r1/beacon"),
        ];
        for (key, text) in keys {
            assert_eq!(key.text().as_str(), text);
            assert_eq!(Key::parse(text), Ok(key));
        }
    }

    #[test]
    fn longest_key_fits() {
        let (id, topic) = ("r".repeat(32), "t".repeat(TOPIC_MAX));
        let key = Key::new(&robot(&id), Direction::Down, &topic).expect("32 characters each");
        assert_eq!(key.text().len(), KEY_MAX);
        assert_eq!(
            Key::parse(&key.text()).map(|key| key.text()),
            Ok(key.text())
        );
    }

    #[test]
    fn robots_named_like_chunks_are_no_trouble() {
        for name in ["beacon", "up", "down", "cmd", "fleet", "v1", "."] {
            let key = Key::of::<Beacon>(&robot(name));
            assert_eq!(
                Key::parse(&key.text()).map(|key| key.robot()),
                Ok(robot(name))
            );
        }
    }

    #[test]
    fn other_texts_are_refused_by_name() {
        let refused = [
            ("", "does not begin with"),
            ("fleet/v2/r1/up/telemetry", "does not begin with"),
            ("/fleet/v1/r1/beacon", "does not begin with"),
            ("fleet/v1/", "is none of"),
            ("fleet/v1/r1", "is none of"),
            ("fleet/v1/r1/up", "is none of"),
            ("fleet/v1/r1/sideways/telemetry", "is none of"),
            ("fleet/v1/r1/up/telemetry/more", "is none of"),
            ("fleet/v1/r1/beacon/more", "is none of"),
            ("fleet/v1//beacon", "must not be empty"),
            ("fleet/v1/*/beacon", "`*`"),
            ("fleet/v1/r$*/up/telemetry", "`$`"),
            ("fleet/v1/r1/up/**", "topic `**`"),
            ("fleet/v1/r1/up/", "topic ``"),
        ];
        for (key, part) in refused {
            let error = Key::parse(key).expect_err(key).to_string();
            assert!(error.contains(part), "`{key}`: {error}");
        }
        let other = Key::new(&robot("r1"), Direction::Beacon, "position");
        assert_eq!(other, Err(KeyError::Topic("position".to_owned())));
    }

    #[test]
    fn selectors_name_one_robot_and_one_direction() {
        let r1 = robot("r1");
        assert_eq!(every(&r1, Direction::Up).as_str(), "fleet/v1/r1/up/**");
        assert_eq!(every(&r1, Direction::Down).as_str(), "fleet/v1/r1/down/**");
        assert_eq!(
            every(&r1, Direction::Command).as_str(),
            "fleet/v1/r1/cmd/**"
        );
        assert_eq!(every(&r1, Direction::Beacon).as_str(), "fleet/v1/r1/beacon");
    }
}
