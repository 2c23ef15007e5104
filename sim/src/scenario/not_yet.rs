//! What the format can say and the simulator cannot do yet. It is refused by name, never ignored: whoever builds one of these
//! removes its row.

use super::QUEUE_MS;
use sphere_protocol::document::error::{Problem, Read, Refusal};
use sphere_protocol::document::node::{Node, Value, join};

/// A key, by its path with `*` for every index, and the only value of it that the simulator can do.
struct Row {
    path: &'static str,
    only: Only,
    what: &'static str,
    instead: &'static str,
}

/// The values of a key that need nothing of the simulator.
enum Only {
    /// None: the key must not be there.
    Absent,
    /// An empty list.
    Empty,
    /// This number.
    Number(f64),
}

const fn row(path: &'static str, only: Only, what: &'static str, instead: &'static str) -> Row {
    Row {
        path,
        only,
        what,
        instead,
    }
}

const ROWS: &[Row] = &[
    row(
        "network.burst",
        Only::Absent,
        "loss in bursts",
        "use `loss`",
    ),
    row(
        "network.up.burst",
        Only::Absent,
        "loss in bursts",
        "use `loss`",
    ),
    row(
        "network.down.burst",
        Only::Absent,
        "loss in bursts",
        "use `loss`",
    ),
    row(
        "network.duplicate",
        Only::Number(0.0),
        "duplicated packets",
        "use 0",
    ),
    row(
        "network.up.duplicate",
        Only::Number(0.0),
        "duplicated packets",
        "use 0",
    ),
    row(
        "network.down.duplicate",
        Only::Number(0.0),
        "duplicated packets",
        "use 0",
    ),
    row(
        "network.bandwidth_kbps",
        Only::Number(0.0),
        "limited bandwidth",
        "use 0",
    ),
    row(
        "network.up.bandwidth_kbps",
        Only::Number(0.0),
        "limited bandwidth",
        "use 0",
    ),
    row(
        "network.down.bandwidth_kbps",
        Only::Number(0.0),
        "limited bandwidth",
        "use 0",
    ),
    row(
        "network.queue_ms",
        Only::Number(QUEUE_MS),
        "queues",
        "leave it out",
    ),
    row(
        "network.up.queue_ms",
        Only::Number(QUEUE_MS),
        "queues",
        "leave it out",
    ),
    row(
        "network.down.queue_ms",
        Only::Number(QUEUE_MS),
        "queues",
        "leave it out",
    ),
    row(
        "network.partition",
        Only::Empty,
        "partitions",
        "leave it out",
    ),
    row("faults", Only::Empty, "faults", "leave it out"),
    row(
        "robots.*.clock_drift_ppm",
        Only::Number(0.0),
        "drifting clocks",
        "use 0",
    ),
];

/// Refuses the first value of `document` that asks for what the simulator cannot do.
pub(super) fn check(document: &Node) -> Read<()> {
    ROWS.iter()
        .try_for_each(|row| walk(document, "", row.path, row))
}

fn walk(node: &Node, path: &str, rest: &str, row: &Row) -> Read<()> {
    if rest.is_empty() {
        return if row.only.allows(&node.value) {
            Ok(())
        } else {
            Err(refusal(node, path, row))
        };
    }
    let (part, rest) = rest.split_once('.').unwrap_or((rest, ""));
    match &node.value {
        Value::Table(entries) => entries
            .get(part)
            .map_or(Ok(()), |entry| walk(entry, &join(path, part), rest, row)),
        Value::List(items) if part == "*" => items
            .iter()
            .enumerate()
            .try_for_each(|(index, item)| walk(item, &join(path, &index.to_string()), rest, row)),
        _ => Ok(()),
    }
}

fn refusal(node: &Node, path: &str, row: &Row) -> Refusal {
    let problem = Problem::NotYet {
        value: node.value.to_string(),
        what: row.what,
        instead: row.instead,
    };
    Refusal::new(&node.place, path, problem)
}

impl Only {
    fn allows(&self, value: &Value) -> bool {
        match (self, value) {
            (Self::Empty, Value::List(items)) => items.is_empty(),
            (Self::Number(only), Value::Float(number)) => number == only,
            (Self::Number(only), Value::Integer(number)) => *number as f64 == *only,
            _ => false,
        }
    }
}
