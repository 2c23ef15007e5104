//! A station's configuration as a TOML file, and the parts of it that scenarios share.
//!
//! `examples/station.toml` is one with every key and its default.

mod mission;
mod planner;

use std::num::NonZero;

use sphere_protocol::document::error::{DocumentError, Read};
use sphere_protocol::document::node::Node;
use sphere_protocol::document::shared::{Endpoints, LogFormat, endpoints, robot, robot_id};
use sphere_protocol::document::table::{Range, Table, empty, refused, section};
use sphere_protocol::time::{Instant, Span};

pub use mission::mission;
pub use planner::planner;

use crate::settings::PlannerSettings;
use crate::station::RobotConfig;
use crate::tasking::StartCondition;

/// A station's file.
#[derive(Clone, Debug)]
pub struct StationFile {
    /// Identity of the station; `None`: to be drawn at each start.
    pub station: Option<u64>,
    /// How log lines look.
    pub log: LogFormat,
    /// The station's place in the network.
    pub network: Endpoints,
    /// Settings of the planner.
    pub planner: PlannerSettings,
    /// Threads that plan; `None`: one for every core but one.
    pub threads: Option<NonZero<usize>>,
    /// The robots, at least one, each with an id of its own.
    pub robots: Vec<RobotConfig>,
}

impl StationFile {
    /// Reads `text`; messages name the file as `file`. `load` gives the text of a robot file named in it, or a sentence why not.
    ///
    /// # Errors
    /// The first key that is unknown, missing, of a wrong type or impossible, with its line and the remedy.
    pub fn parse(
        file: &str,
        text: &str,
        mut load: impl FnMut(&str) -> Result<String, String>,
    ) -> Result<Self, DocumentError> {
        station(text, &mut load).map_err(|refusal| refusal.in_file(file))
    }
}

fn station(text: &str, load: &mut dyn FnMut(&str) -> Result<String, String>) -> Read<StationFile> {
    let document = Node::document(text)?;
    let keys = ["station", "log", "threads", "network", "planner", "robots"];
    let top = Table::open(&document, "", &keys)?;
    let mut robots: Vec<RobotConfig> = Vec::new();
    for (node, path) in top.list("robots")? {
        let table = Table::open(node, &path, &["id", "robot", "mission", "start_at_s"])?;
        let id = robot_id(&table)?;
        if let Some(index) = robots.iter().position(|other| other.id == id) {
            let why = format!("robots.{index} has the id {id} already: every robot needs its own");
            return Err(refused(node, &path, why));
        }
        let robot = robot(&table, load)?;
        let at = table.number("start_at_s", Range::within(0.0, LONGEST_S))?;
        robots.push(RobotConfig {
            id,
            mission: mission(&table, &robot)?,
            start: at.map_or(StartCondition::Ready, |s| {
                // The station's clock begins with it.
                StartCondition::At(Instant::from_nanos(Span::from_secs_f64(s).as_nanos()))
            }),
            robot,
        });
    }
    if robots.is_empty() {
        return Err(top.missing("robots", "[[robots]] id = \"r1\", robot = \"liu\""));
    }
    Ok(StationFile {
        station: top.integer("station", 1, i64::MAX)?.map(i64::unsigned_abs),
        log: top.named_or("log", LogFormat::Human)?,
        threads: top
            .integer("threads", 1, THREADS_MAX)?
            .and_then(|count| NonZero::new(usize::try_from(count).unwrap_or(0))),
        network: network(&top)?,
        planner: planner(&top)?,
        robots,
    })
}

fn network(top: &Table<'_>) -> Read<Endpoints> {
    let empty = empty();
    let table = section(top, "network", &["listen", "connect"], &empty)?;
    match (endpoints(&table, "listen")?, endpoints(&table, "connect")?) {
        (Some(listen), None) => Ok(Endpoints::Listen(listen)),
        (None, Some(connect)) => Ok(Endpoints::Connect(connect)),
        (None, None) => Ok(Endpoints::Listen(vec![LISTEN.to_owned()])),
        (Some(_), Some(_)) => {
            let (node, path) = table.node("connect").expect("it was read");
            let why = "a station either is the router (`listen`) or a client of another (`connect`): give one of them";
            Err(refused(node, &path, why.to_owned()))
        }
    }
}

/// Where a station listens if nothing is said: this machine alone.
pub const LISTEN: &str = "tcp/127.0.0.1:7447";
/// Most planning threads: nobody has more cores.
const THREADS_MAX: i64 = 1024;
/// Longest time in a file [s].
const LONGEST_S: f64 = 3e8;
