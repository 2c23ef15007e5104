//! The `mission` of a robot.

use sphere_protocol::document::error::Read;
use sphere_protocol::document::node::{Value, quoted};
use sphere_protocol::document::table::{Range, Table, list_of, number_of, refused, unknown_name};
use sphere_protocol::robot::Robot;

use crate::trajectory::{Mission, Pose, Trajectory};

/// A kind of mission and the keys that it takes.
type Kind = (&'static str, &'static [&'static str]);

/// What `robot` is to do: the table `mission` of `table`, to hold where it has none.
///
/// # Errors
/// An unknown kind or key, a number outside its range, or a path that this robot cannot drive.
pub fn mission(table: &Table<'_>, robot: &Robot) -> Read<Mission> {
    let Some((node, path)) = table.node("mission") else {
        return Ok(Mission::Hold);
    };
    if let Value::Text(kind) = &node.value {
        let why = format!("it must be a table: write {{ kind = {} }}", quoted(kind));
        return Err(refused(node, &path, why));
    }
    let all: Vec<_> = MISSIONS
        .iter()
        .flat_map(|(_, keys)| *keys)
        .chain(&["kind"])
        .copied()
        .collect();
    let any = Table::open(node, &path, &all)?;
    let kind = any
        .text("kind")?
        .ok_or_else(|| any.missing("kind", "kind = \"lemniscate\""))?;
    let Some((_, keys)) = MISSIONS.iter().find(|(name, _)| *name == kind) else {
        let (node, path) = any.node("kind").expect("it was read");
        let known = MISSIONS.iter().map(|(name, _)| *name);
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
        "roll" => Mission::Roll {
            speed_mps: any.required_number(
                "speed_mps",
                Range::within(0.0, v_max),
                SPEED_EXAMPLE,
            )?,
            angles_deg: angles(&any)?,
            hold_s: any.number_or("hold_s", HOLD, 5.0)?,
        },
        "roll-sine" => Mission::RollSine {
            speed_mps: any.required_number(
                "speed_mps",
                Range::within(0.0, v_max),
                SPEED_EXAMPLE,
            )?,
            amplitude_deg: any.required_number("amplitude_deg", ANGLE, "amplitude_deg = 10.0")?,
            rate_radps: any.required_number("rate_radps", RATE, "rate_radps = 0.15")?,
            phase_rad: any.number_or("phase_rad", Range::within(-1e3, 1e3), 0.0)?,
        },
        _ => Mission::Hold,
    };
    // What only the whole path shows: too tight a turn, points too close to each other.
    mission
        .validated()
        .and_then(|mission| Trajectory::new(&mission, robot, Pose::default()).map(|_| mission))
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

fn angles(mission: &Table<'_>) -> Read<Vec<f64>> {
    let angles: Vec<f64> = mission
        .list("angles_deg")?
        .into_iter()
        .map(|(node, path)| number_of(node, &path, ANGLE))
        .collect::<Read<_>>()?;
    if angles.is_empty() {
        return Err(mission.missing("angles_deg", "angles_deg = [0.0, 10.0]"));
    }
    Ok(angles)
}

/// Every kind of mission with the keys it takes.
const MISSIONS: &[Kind] = &[
    ("hold", &[]),
    ("line", &[]),
    ("sine", &[]),
    ("lemniscate", &[]),
    ("circle", &["radius_m", "speed_mps"]),
    ("waypoints", &["points_m", "speed_mps"]),
    ("roll", &["speed_mps", "angles_deg", "hold_s"]),
    (
        "roll-sine",
        &["speed_mps", "amplitude_deg", "rate_radps", "phase_rad"],
    ),
];

/// World coordinates [m]: farther out a nanometre no longer fits an f64.
const POSITION: Range = Range::within(-1e6, 1e6);
/// Typed roll angles [°]; the robot's own limits are asked once all is read.
const ANGLE: Range = Range::within(-90.0, 90.0);
/// How long one is held [s].
const HOLD: Range = Range::within(0.1, 1e6);
/// Angular frequency of a typed sine [rad/s]: above it the robot cannot follow.
const RATE: Range = Range::positive(10.0);
const SPEED_EXAMPLE: &str = "speed_mps = 0.5";
