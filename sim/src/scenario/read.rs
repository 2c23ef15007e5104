//! From a document to a [`Scenario`]: every table with its keys, defaults and ranges.

use sphere_ground::config_file::planner;
use sphere_protocol::robot::RobotId;

use super::{
    Environment, Fault, FaultKind, Link, Loss, MetricsSetup, Network, Partition, Scenario, Sensing,
    StationComputer, robots,
};
use sphere_protocol::document::error::Read;
use sphere_protocol::document::node::Node;
use sphere_protocol::document::table::{
    Range, Table, empty, refused, section, text_of, unknown_name,
};

/// Longest time in a scenario [s]: ten years of nanoseconds still leave room in an instant.
pub(super) const LONGEST_S: f64 = 3e8;
/// Times from 0 on [s].
pub(super) const TIME: Range = Range::within(0.0, LONGEST_S);
/// Lengths of time [s].
pub(super) const LENGTH_OF_TIME: Range = Range::positive(LONGEST_S);
const MILLISECONDS: Range = Range::within(0.0, LONGEST_S);
const PROBABILITY: Range = Range::within(0.0, 1.0);

/// Reads a whole scenario.
pub(super) fn scenario(
    text: &str,
    sets: &[String],
    load: impl FnMut(&str) -> Result<String, String>,
) -> Read<Scenario> {
    let document = document(text, sets)?;
    let top = Table::open(
        &document,
        "",
        &[
            "seed",
            "duration_s",
            "environment",
            "network",
            "faults",
            "sensing",
            "metrics",
            "planner",
            "station",
            "robots",
        ],
    )?;
    let environment = top.named_or("environment", Environment::Real)?;
    let robots = robots::all(&top, environment, load)?;
    let ids: Vec<_> = robots.iter().map(|robot| robot.id).collect();
    let scenario = Scenario {
        seed: top
            .integer("seed", 0, i64::MAX)?
            .map_or(1, i64::unsigned_abs),
        duration_s: top.number_or("duration_s", LENGTH_OF_TIME, 60.0)?,
        environment,
        network: network(&top, &ids)?,
        faults: faults(&top, &ids)?,
        sensing: sensing(&top, environment)?,
        metrics: metrics(&top)?,
        planner: planner(&top)?,
        station: station(&top)?,
        robots,
    };
    Ok(scenario)
}

fn document(text: &str, sets: &[String]) -> Read<Node> {
    let mut document = Node::document(text)?;
    for argument in sets {
        document.set(argument)?;
    }
    Ok(document)
}

fn network(top: &Table<'_>, ids: &[RobotId]) -> Read<Network> {
    let Some((node, path)) = top.node("network") else {
        return Ok(Network {
            up: Link::default(),
            down: Link::default(),
            partition: Vec::new(),
        });
    };
    let both: Vec<_> = LINK_KEYS
        .iter()
        .copied()
        .chain(["up", "down", "partition"])
        .collect();
    let table = Table::open(node, &path, &both)?;
    let both = link(&table, Link::default())?;
    let one = |direction| match table.node(direction) {
        Some((node, path)) => link(&Table::open(node, &path, LINK_KEYS)?, both),
        None => Ok(both),
    };
    let mut partition = Vec::new();
    for (node, path) in table.list("partition")? {
        let table = Table::open(node, &path, &["from_s", "to_s", "robots"])?;
        let from_s = table.required_number("from_s", TIME, "from_s = 40.0")?;
        let to_s = table.required_number("to_s", TIME, "to_s = 43.0")?;
        if to_s <= from_s {
            let why = format!("it ends at {to_s} s, before it begins at {from_s} s: exchange them");
            return Err(refused(node, &path, why));
        }
        partition.push(Partition {
            from_s,
            to_s,
            robots: known_robots(&table, ids)?,
        });
    }
    Ok(Network {
        up: one("up")?,
        down: one("down")?,
        partition,
    })
}

/// One direction of the network; what `table` leaves out is as in `base`.
fn link(table: &Table<'_>, base: Link) -> Read<Link> {
    let independent = table.number("loss", PROBABILITY)?;
    let loss = match (table.node("burst"), independent) {
        (None, None) => base.loss,
        (None, Some(loss)) => Loss::Independent(loss),
        (Some((node, path)), None) => burst(&Table::open(
            node,
            &path,
            &["mean_bad_s", "mean_good_s", "loss_bad"],
        )?)?,
        (Some((node, path)), Some(_)) => {
            let why = "loss is either independent or in bursts: give `loss` or `burst`, not both";
            return Err(refused(node, &path, why.to_owned()));
        }
    };
    Ok(Link {
        delay_ms: table.number_or("delay_ms", MILLISECONDS, base.delay_ms)?,
        jitter_ms: table.number_or("jitter_ms", MILLISECONDS, base.jitter_ms)?,
        distribution: table.named_or("distribution", base.distribution)?,
        loss,
        duplicate: table.number_or("duplicate", PROBABILITY, base.duplicate)?,
        bandwidth_kbps: table.number_or(
            "bandwidth_kbps",
            Range::within(0.0, 1e9),
            base.bandwidth_kbps,
        )?,
        queue_ms: table.number_or("queue_ms", MILLISECONDS, base.queue_ms)?,
    })
}

fn burst(table: &Table<'_>) -> Read<Loss> {
    Ok(Loss::Burst {
        mean_bad_s: table.required_number("mean_bad_s", LENGTH_OF_TIME, "mean_bad_s = 1.0")?,
        mean_good_s: table.required_number("mean_good_s", LENGTH_OF_TIME, "mean_good_s = 20.0")?,
        loss_bad: table.number_or("loss_bad", PROBABILITY, 1.0)?,
    })
}

fn faults(top: &Table<'_>, ids: &[RobotId]) -> Read<Vec<Fault>> {
    let mut faults = Vec::new();
    for (node, path) in top.list("faults")? {
        let table = Table::open(node, &path, &["kind", "at_s", "for_s", "robots"])?;
        if table.node("kind").is_none() {
            return Err(table.missing("kind", "kind = \"station-crash\""));
        }
        faults.push(Fault {
            kind: table.named_or("kind", FaultKind::StationCrash)?,
            at_s: table.required_number("at_s", TIME, "at_s = 50.0")?,
            for_s: table.required_number("for_s", LENGTH_OF_TIME, "for_s = 3.0")?,
            robots: known_robots(&table, ids)?,
        });
    }
    Ok(faults)
}

fn known_robots(table: &Table<'_>, ids: &[RobotId]) -> Read<Vec<RobotId>> {
    let mut named = Vec::new();
    for (node, path) in table.list("robots")? {
        let text = text_of(node, &path)?;
        let id = ids.iter().find(|id| id.as_str() == text);
        named.push(
            *id.ok_or_else(|| unknown_name(node, &path, "robot", ids.iter().map(RobotId::as_str)))?,
        );
    }
    Ok(named)
}

fn sensing(top: &Table<'_>, environment: Environment) -> Read<Sensing> {
    let noise = match environment {
        Environment::Ideal => 0.0,
        Environment::Real | Environment::Calibrated => 1.0,
    };
    let empty = empty();
    let keys = ["noise", "position_fix_hz", "position_fix_noise_m"];
    let table = section(top, "sensing", &keys, &empty)?;
    Ok(Sensing {
        noise: table.number_or("noise", Range::within(0.0, 1e3), noise)?,
        // The motor board samples at 200 Hz and passes on at most one fix with each sample.
        position_fix_hz: table.number_or("position_fix_hz", Range::within(0.0, 200.0), 10.0)?,
        position_fix_noise_m: table.number_or(
            "position_fix_noise_m",
            Range::within(0.0, 1e3),
            0.02,
        )?,
    })
}

fn station(top: &Table<'_>) -> Read<StationComputer> {
    let empty = empty();
    let table = section(top, "station", &["plan_time_us"], &empty)?;
    Ok(StationComputer {
        plan_time_us: table.number_or("plan_time_us", Range::within(0.0, 1e6), 0.0)?,
    })
}

fn metrics(top: &Table<'_>) -> Read<MetricsSetup> {
    let empty = empty();
    let table = section(top, "metrics", &["settle_s"], &empty)?;
    Ok(MetricsSetup {
        settle_s: table.number_or("settle_s", TIME, 10.0)?,
    })
}

const LINK_KEYS: &[&str] = &[
    "delay_ms",
    "jitter_ms",
    "distribution",
    "loss",
    "burst",
    "duplicate",
    "bandwidth_kbps",
    "queue_ms",
];
