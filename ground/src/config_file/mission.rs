//! The `mission` of a robot.

use sphere_protocol::document::error::Read;
use sphere_protocol::document::node::{Value, quoted};
use sphere_protocol::document::table::{Range, Table, list_of, number_of, refused, unknown_name};
use sphere_protocol::robot::Robot;

use crate::trajectory::{Mission, Pose, Trajectory};

/// A kind of mission and the keys that it takes.
pub type Kind = (&'static str, &'static [&'static str]);

/// What `robot` is to do: the table `mission` of `table`, to hold where it has none. `None` for a kind that the file's format has
/// besides, in `others`; only its keys were looked at.
///
/// # Errors
/// An unknown kind or key, a number outside its range, or a path that this robot cannot drive.
pub fn mission(table: &Table<'_>, robot: &Robot, others: &[Kind]) -> Read<Option<Mission>> {
    let Some((node, path)) = table.node("mission") else {
        return Ok(Some(Mission::Hold));
    };
    if let Value::Text(kind) = &node.value {
        let why = format!("it must be a table: write {{ kind = {} }}", quoted(kind));
        return Err(refused(node, &path, why));
    }
    let kinds: Vec<Kind> = MISSIONS.iter().chain(others).copied().collect();
    let all: Vec<_> = kinds
        .iter()
        .flat_map(|(_, keys)| *keys)
        .chain(&["kind"])
        .copied()
        .collect();
    let any = Table::open(node, &path, &all)?;
    let kind = any
        .text("kind")?
        .ok_or_else(|| any.missing("kind", "kind = \"lemniscate\""))?;
    let Some((_, keys)) = kinds.iter().find(|(name, _)| *name == kind) else {
        let (node, path) = any.node("kind").expect("it was read");
        let known = kinds.iter().map(|(name, _)| *name);
        return Err(unknown_name(node, &path, "mission", known));
    };
    for key in all
        .iter()
        .filter(|key| **key != "kind" && !keys.contains(key))
    {
        if let Some((node, path)) = any.node(key) {
            let takes = if keys.is_empty() {
                "nothing else".to_owned()
            } else {
                keys.join(", ")
            };
            let why = format!("a mission of kind {} takes {takes}", quoted(kind));
            return Err(refused(node, &path, why));
        }
    }
    if others.iter().any(|(name, _)| *name == kind) {
        return Ok(None);
    }
    let v_max = robot.limits.v_max;
    let speed = || any.required_number("speed_mps", Range::positive(v_max), SPEED_EXAMPLE);
    let mission = match kind {
        "line" => Mission::Line,
        "sine" => Mission::Sine,
        "lemniscate" => Mission::Lemniscate,
        "circle" => Mission::Circle {
            radius_m: any.required_number("radius_m", Range::positive(1e6), "radius_m = 3.0")?,
            speed_mps: speed()?,
        },
        "waypoints" => Mission::Waypoints {
            points_m: points(&any)?,
            speed_mps: speed()?,
        },
        _ => Mission::Hold,
    };
    // What only the whole path shows: too tight a turn, points too close to each other.
    mission
        .validated()
        .and_then(|mission| Trajectory::new(&mission, robot, Pose::default()).map(|_| mission))
        .map(Some)
        .map_err(|error| refused(node, &path, error.to_string()))
}

fn points(mission: &Table<'_>) -> Read<Vec<[f64; 2]>> {
    let mut points = Vec::new();
    for (node, path) in mission.list("points_m")? {
        let [(x, x_path), (y, y_path)] = list_of(node, &path)?
            .try_into()
            .map_err(|_| refused(node, &path, "a point is [x, y] in metres".to_owned()))?;
        points.push([
            number_of(x, &x_path, POSITION)?,
            number_of(y, &y_path, POSITION)?,
        ]);
    }
    if points.is_empty() {
        return Err(mission.missing("points_m", "points_m = [[2.0, 0.0], [2.0, 3.0]]"));
    }
    Ok(points)
}

/// Every kind of mission with the keys it takes.
const MISSIONS: &[Kind] = &[
    ("hold", &[]),
    ("line", &[]),
    ("sine", &[]),
    ("lemniscate", &[]),
    ("circle", &["radius_m", "speed_mps"]),
    ("waypoints", &["points_m", "speed_mps"]),
];

/// World coordinates [m]: farther out a nanometre no longer fits an f64.
const POSITION: Range = Range::within(-1e6, 1e6);
const SPEED_EXAMPLE: &str = "speed_mps = 0.5";
