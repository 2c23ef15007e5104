//! An agent's configuration as a TOML file.
//!
//! `examples/agent.toml` is one with every key and its default.

use std::net::SocketAddr;

use sphere_protocol::document::error::{DocumentError, Read};
use sphere_protocol::document::node::Node;
use sphere_protocol::document::shared::{Endpoints, LogFormat, endpoints, robot, robot_id};
use sphere_protocol::document::table::{Named, Range, Table, empty, refused, section};
use sphere_protocol::robot::{Robot, RobotId};
use sphere_protocol::time::Span;

use crate::config::{AgentConfig, Timing};
use crate::control::DirectionChoice;
use crate::estimator::{EstimatorConfig, StartPose};

/// An agent's file.
#[derive(Clone, Debug)]
pub struct AgentFile {
    /// Its name in the fleet.
    pub id: RobotId,
    /// The robot it controls.
    pub robot: Robot,
    /// Which direction controller.
    pub direction: DirectionChoice,
    /// How log lines look.
    pub log: LogFormat,
    /// Where the robot stands at its start.
    pub start: StartPose,
    /// The link to the motor board.
    pub motors: MotorLink,
    /// The router whose client it is.
    pub network: Endpoints,
    /// Rates and time limits.
    pub timing: Timing,
}

/// Both ends of the link to the motor board.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MotorLink {
    /// Where the agent listens.
    pub bind: SocketAddr,
    /// The board, which alone is listened to.
    pub board: SocketAddr,
}

impl AgentFile {
    /// Reads `text`; messages name the file as `file`. `load` gives the text of a robot file named in it, or a sentence why not.
    ///
    /// # Errors
    /// The first key that is unknown, missing, of a wrong type or impossible, with its line and the remedy.
    pub fn parse(
        file: &str,
        text: &str,
        mut load: impl FnMut(&str) -> Result<String, String>,
    ) -> Result<Self, DocumentError> {
        agent(text, &mut load).map_err(|refusal| refusal.in_file(file))
    }

    /// The core's configuration for the life `boot_id`.
    pub fn config(&self, boot_id: u64) -> AgentConfig {
        AgentConfig {
            id: self.id,
            robot: self.robot.clone(),
            boot_id,
            estimator: EstimatorConfig {
                start: self.start,
                ..EstimatorConfig::default()
            },
            direction: self.direction,
            timing: self.timing,
        }
    }
}

impl Named for DirectionChoice {
    const WHAT: &'static str = "roll controller";
    const NAMES: &'static [(&'static str, Self)] = &[
        ("htsmc", Self::Htsmc),
        ("htsmc-paper", Self::HtsmcPaper),
        ("fuzzy-pid", Self::FuzzyPid),
        ("fuzzy-pid-single", Self::FuzzyPidSingle),
    ];
}

fn agent(text: &str, load: &mut dyn FnMut(&str) -> Result<String, String>) -> Read<AgentFile> {
    let document = Node::document(text)?;
    let keys = [
        "id",
        "robot",
        "roll_controller",
        "log",
        "start",
        "motors",
        "network",
        "timing",
    ];
    let top = Table::open(&document, "", &keys)?;
    Ok(AgentFile {
        id: robot_id(&top)?,
        robot: robot(&top, load)?,
        direction: top.named_or("roll_controller", DirectionChoice::default())?,
        log: top.named_or("log", LogFormat::Human)?,
        start: start(&top)?,
        motors: motors(&top)?,
        network: network(&top)?,
        timing: timing(&top)?,
    })
}

fn start(top: &Table<'_>) -> Read<StartPose> {
    let empty = empty();
    let keys = [
        "x_m",
        "y_m",
        "heading_deg",
        "position_sigma_m",
        "heading_sigma_deg",
    ];
    let table = section(top, "start", &keys, &empty)?;
    let default = StartPose::default();
    let radians = |degrees: f64| degrees.to_radians();
    let heading = table.number("heading_deg", Range::within(-36e3, 36e3))?;
    let heading_sigma = table.number("heading_sigma_deg", Range::positive(1e3))?;
    Ok(StartPose {
        x: table.number_or("x_m", POSITION, default.x)?,
        y: table.number_or("y_m", POSITION, default.y)?,
        heading: heading.map_or(default.heading, radians),
        position_sigma: table.number_or(
            "position_sigma_m",
            Range::positive(1e6),
            default.position_sigma,
        )?,
        heading_sigma: heading_sigma.map_or(default.heading_sigma, radians),
    })
}

fn motors(top: &Table<'_>) -> Read<MotorLink> {
    let Some((node, path)) = top.node("motors") else {
        return Err(top.missing("motors", "[motors] with bind and board"));
    };
    let table = Table::open(node, &path, &["bind", "board"])?;
    let bind = address(&table, "bind", "bind = \"127.0.0.1:24600\"")?;
    let board = address(&table, "board", "board = \"127.0.0.1:24601\"")?;
    let (node, path) = table.node("board").expect("it was read");
    if board.port() == 0 {
        let why = "a board has a port of its own: not 0".to_owned();
        return Err(refused(node, &path, why));
    }
    if bind == board {
        let why = "the agent listens there itself: give the board's address".to_owned();
        return Err(refused(node, &path, why));
    }
    Ok(MotorLink { bind, board })
}

fn address(table: &Table<'_>, key: &'static str, example: &'static str) -> Read<SocketAddr> {
    let (node, text, path) = table.required_text(key, example)?;
    text.parse().map_err(|_| {
        let why = format!("it must be an address and a port: {example}");
        refused(node, &path, why)
    })
}

fn network(top: &Table<'_>) -> Read<Endpoints> {
    let empty = empty();
    let table = section(top, "network", &["connect"], &empty)?;
    let connect = endpoints(&table, "connect")?;
    Ok(Endpoints::Connect(
        connect.unwrap_or_else(|| vec![ROUTER.to_owned()]),
    ))
}

fn timing(top: &Table<'_>) -> Read<Timing> {
    let empty = empty();
    let keys = [
        "control_ms",
        "telemetry_ms",
        "status_ms",
        "beacon_ms",
        "torque_validity_ms",
        "sensor_timeout_ms",
        "lease_timeout_ms",
    ];
    let table = section(top, "timing", &keys, &empty)?;
    let default = Timing::default();
    let span = |key, low, high, default: Span| -> Read<Span> {
        let ms = table.number(key, Range::within(low, high))?;
        Ok(ms.map_or(default, |ms| Span::from_secs_f64(ms * 1e-3)))
    };
    let timing = Timing {
        // The board's frames come every 5 ms; slower than 10 Hz neither law is stable.
        control: span("control_ms", 5.0, 100.0, default.control)?,
        telemetry: span("telemetry_ms", 5.0, 1000.0, default.telemetry)?,
        status: span("status_ms", 20.0, 60e3, default.status)?,
        beacon: span("beacon_ms", 20.0, 60e3, default.beacon)?,
        torque_validity: span("torque_validity_ms", 5.0, 500.0, default.torque_validity)?,
        sensor_timeout: span("sensor_timeout_ms", 10.0, 1000.0, default.sensor_timeout)?,
        lease_timeout: span("lease_timeout_ms", 100.0, 60e3, default.lease_timeout)?,
    };
    let refuse = |key: &str, why: String| {
        // Where the file has only the other of two keys that do not fit together, that one is to blame.
        let (node, path) = table
            .node(key)
            .or_else(|| table.node("control_ms"))
            .expect("the defaults fit together");
        Err(refused(node, &path, why))
    };
    let control = timing.control.as_nanos();
    if timing.telemetry.as_nanos() % control != 0 {
        let why = "telemetry_ms must be a multiple of control_ms".to_owned();
        return refuse("telemetry_ms", why);
    }
    if timing.torque_validity.as_nanos() < 2 * control {
        let why = "torque_validity_ms must be at least twice control_ms, or one late control step would cut the torque";
        return refuse("torque_validity_ms", why.to_owned());
    }
    Ok(timing)
}

/// The router if nothing is said: this machine's.
const ROUTER: &str = "tcp/127.0.0.1:7447";
/// World coordinates [m]: farther out a nanometre no longer fits an f64.
const POSITION: Range = Range::within(-1e6, 1e6);
