//! What the files of agents, stations and scenarios have in common: robots, their ids, and endpoints of the network.

use super::error::Read;
use super::node::Node;
use super::table::{Table, list_of, refused, text_of, unknown_name};
use crate::robot::{Robot, RobotId};

/// How a session takes part in the network, as a file states it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Endpoints {
    /// A router in this process listens there.
    Listen(Vec<String>),
    /// A client of the router there.
    Connect(Vec<String>),
}

/// How log lines look.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub enum LogFormat {
    /// For people.
    #[default]
    Human,
    /// One JSON object a line.
    Json,
}

impl super::table::Named for LogFormat {
    const WHAT: &'static str = "log format";
    const NAMES: &'static [(&'static str, Self)] = &[("human", Self::Human), ("json", Self::Json)];
}

/// The robot id under the key `id`.
///
/// # Errors
/// It is missing, or no robot id.
pub fn robot_id(table: &Table<'_>) -> Read<RobotId> {
    let (node, text, path) = table.required_text("id", "id = \"r1\"")?;
    text.parse()
        .map_err(|error: crate::robot::RobotIdError| refused(node, &path, error.to_string()))
}

/// The robot under the key `robot`: the name of one that comes with the project, or the path of a file that `load` gives the text of.
///
/// # Errors
/// It is missing, there is no such robot, or its file is refused.
pub fn robot(
    table: &Table<'_>,
    load: &mut dyn FnMut(&str) -> Result<String, String>,
) -> Read<Robot> {
    let (node, reference, path) = table.required_text("robot", "robot = \"liu\"")?;
    if let Some(robot) = Robot::embedded(reference) {
        return Ok(robot);
    }
    let Some(name) = reference.strip_suffix(".toml") else {
        let known = Robot::embedded_names().chain(["a path ending in .toml"]);
        let known: Vec<_> = known.collect();
        return Err(unknown_name(node, &path, "robot", known.iter().copied()));
    };
    let text = load(reference).map_err(|why| refused(node, &path, why))?;
    let name = name.rsplit(['/', '\\']).next().unwrap_or(name);
    Robot::parse(name, &text).map_err(|error| refused(node, &path, error.to_string()))
}

/// A list of at least one endpoint of Zenoh under `key`, such as `tcp/127.0.0.1:7447`; `None` where the file has no such key.
///
/// # Errors
/// No list, an empty one, or an entry that is no `protocol/host:port`.
pub fn endpoints(table: &Table<'_>, key: &str) -> Read<Option<Vec<String>>> {
    let Some((node, path)) = table.node(key) else {
        return Ok(None);
    };
    let entries: Vec<String> = list_of(node, &path)?
        .into_iter()
        .map(|(node, path)| endpoint(node, &path))
        .collect::<Read<_>>()?;
    if entries.is_empty() {
        let why = "it must name at least one endpoint, such as \"tcp/127.0.0.1:7447\"";
        return Err(refused(node, &path, why.to_owned()));
    }
    Ok(Some(entries))
}

fn endpoint(node: &Node, path: &str) -> Read<String> {
    let text = text_of(node, path)?;
    let example = "write it as \"tcp/127.0.0.1:7447\"";
    let Some((protocol, address)) = text.split_once('/') else {
        return Err(refused(
            node,
            path,
            format!("it has no protocol: {example}"),
        ));
    };
    if !PROTOCOLS.contains(&protocol) {
        let why = format!("the protocol must be one of {}", PROTOCOLS.join(", "));
        return Err(refused(node, path, why));
    }
    // Options of the endpoint follow after ? or #, which Zenoh checks itself.
    let address = address.split(['?', '#']).next().unwrap_or(address);
    let port = address
        .rsplit_once(':')
        .filter(|(host, _)| !host.is_empty());
    if port.is_none_or(|(_, port)| port.parse::<u16>().is_err()) {
        return Err(refused(
            node,
            path,
            format!("it has no host and port: {example}"),
        ));
    }
    Ok(text.to_owned())
}

/// Protocols that this build of Zenoh speaks.
const PROTOCOLS: &[&str] = &["tcp", "udp", "tls", "quic"];
