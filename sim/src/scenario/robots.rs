//! The `[[robots]]` of a scenario.

use std::collections::BTreeMap;
use std::path::Path;

use sphere_agent::config::Timing;
use sphere_ground::config_file;
use sphere_protocol::robot::{Robot, RobotId, RobotParams};
use sphere_protocol::time::Span;

use super::read::{LENGTH_OF_TIME, TIME};
use super::{Disturbance, Environment, Patch, Push, RobotModel, RobotSetup, RollController, Start};
use sphere_protocol::document::error::Read;
use sphere_protocol::document::node::{Node, Value, join};
use sphere_protocol::document::table::{
    Range, Table, empty, list_of, number_of, refused, section, text_of, unknown_name,
};

/// World coordinates [m]: farther out a nanometre no longer fits an f64.
const POSITION: Range = Range::within(-1e6, 1e6);
/// Torques from outside [N·m].
const TORQUE: Range = Range::within(-1e4, 1e4);

/// Reads every robot.
pub(super) fn all(
    top: &Table<'_>,
    environment: Environment,
    load: impl FnMut(&str) -> Result<String, String>,
) -> Read<Vec<RobotSetup>> {
    let mut models = Models {
        load,
        read: BTreeMap::new(),
    };
    let mut robots: Vec<RobotSetup> = Vec::new();
    for (node, path) in top.list("robots")? {
        let setup = one(node, &path, environment, &mut models)?;
        if let Some(index) = robots.iter().position(|other| other.id == setup.id) {
            let (node, path) = Table::open(node, &path, KEYS)?
                .node("id")
                .expect("it was read");
            let why = format!("robots.{index} has this id already: every robot needs its own");
            return Err(refused(node, &path, why));
        }
        robots.push(setup);
    }
    if robots.is_empty() {
        return Err(top.missing("robots", "[[robots]] id = \"r1\""));
    }
    Ok(robots)
}

/// Whether the robot reference names a file rather than an embedded robot.
pub(super) fn is_file(reference: &str) -> bool {
    reference.ends_with(".toml")
}

fn one<F: FnMut(&str) -> Result<String, String>>(
    node: &Node,
    path: &str,
    environment: Environment,
    models: &mut Models<F>,
) -> Read<RobotSetup> {
    let table = Table::open(node, path, KEYS)?;
    let id = match table.node("id") {
        None => return Err(table.missing("id", "id = \"r1\"")),
        Some((node, path)) => text_of(node, &path)?
            .parse::<RobotId>()
            .map_err(|error| refused(node, &path, error.to_string()))?,
    };
    let model = models.model(&table)?;
    let (plant_scale, plant) = plant(&table, environment, model.robot.params)?;
    Ok(RobotSetup {
        id,
        plant_scale,
        plant,
        start: start(&table)?,
        clock_offset_s: table.number_or("clock_offset_s", Range::within(-3e8, 3e8), 0.0)?,
        clock_drift_ppm: table.number_or("clock_drift_ppm", Range::within(-1e4, 1e4), 0.0)?,
        telemetry_ms: telemetry(&table)?,
        roll_controller: table.named_or("roll_controller", RollController::Htsmc)?,
        disturbance: disturbance(&table, environment)?,
        mission: config_file::mission(&table, &model.robot)?,
        model,
    })
}

fn telemetry(table: &Table<'_>) -> Read<i64> {
    let default = Timing::default();
    let milliseconds = |span: Span| span.as_nanos() / 1_000_000;
    let Some(ms) = table.integer("telemetry_ms", 20, 1000)? else {
        return Ok(milliseconds(default.telemetry));
    };
    let control = milliseconds(default.control);
    match table.node("telemetry_ms") {
        Some((node, path)) if ms % control != 0 => {
            let why = format!("it must be a multiple of the control period of {control} ms");
            Err(refused(node, &path, why))
        }
        _ => Ok(ms),
    }
}

/// The robot files read so far, by the path in the scenario.
struct Models<F> {
    load: F,
    read: BTreeMap<String, RobotModel>,
}

impl<F: FnMut(&str) -> Result<String, String>> Models<F> {
    fn model(&mut self, table: &Table<'_>) -> Read<RobotModel> {
        let known = || Robot::embedded_names().collect::<Vec<_>>();
        let Some((node, path)) = table.node("robot") else {
            let first = known()[0];
            let robot = Robot::embedded(first).expect("it was just listed");
            return Ok(RobotModel {
                reference: first.to_owned(),
                robot,
            });
        };
        let reference = text_of(node, &path)?;
        if let Some(model) = self.read.get(reference) {
            return Ok(model.clone());
        }
        let model = if let Some(robot) = Robot::embedded(reference) {
            RobotModel {
                reference: reference.to_owned(),
                robot,
            }
        } else if is_file(reference) {
            let text = (self.load)(reference).map_err(|why| refused(node, &path, why))?;
            let name = self.file_name(reference);
            let robot = Robot::parse(name.trim_end_matches(".toml"), &text)
                .map_err(|error| refused(node, &path, error.to_string()))?;
            RobotModel {
                reference: name,
                robot,
            }
        } else {
            let known = known().into_iter().chain(["a path ending in .toml"]);
            return Err(unknown_name(node, &path, "robot", known));
        };
        self.read.insert(reference.to_owned(), model.clone());
        Ok(model)
    }

    /// A name for the file at `path` beside the drawn scenario: `robot-` and its own name, numbered if another has it. A drawn
    /// scenario's files keep theirs.
    fn file_name(&self, path: &str) -> String {
        let own = Path::new(path)
            .file_stem()
            .map_or_else(String::new, |stem| stem.to_string_lossy().into_owned());
        let stem = own.strip_prefix("robot-").unwrap_or(&own);
        let taken = |name: &String| self.read.values().any(|model| model.reference == *name);
        core::iter::once(format!("robot-{stem}.toml"))
            .chain((2..).map(|number| format!("robot-{stem}-{number}.toml")))
            .find(|name| !taken(name))
            .expect("numbers do not run out")
    }
}

/// The scale factors and the true parameters.
fn plant(
    table: &Table<'_>,
    environment: Environment,
    mut params: RobotParams,
) -> Read<(BTreeMap<String, f64>, RobotParams)> {
    match environment {
        Environment::Ideal => {
            (params.motor_lag, params.motor_delay, params.coulomb) = (0.0, 0.0, 0.0)
        }
        Environment::Real => {}
        Environment::Calibrated => params.coulomb = 0.5,
    }
    let mut scale = BTreeMap::new();
    let Some((node, path)) = table.node("plant") else {
        return Ok((scale, params));
    };
    let plant = Table::open(node, &path, &["scale"])?;
    let Some((node, path)) = plant.node("scale") else {
        return Ok((scale, params));
    };
    let Value::Table(entries) = &node.value else {
        let why = "it must be a table of factors such as { m = 1.15 }".to_owned();
        return Err(refused(node, &path, why));
    };
    for (key, node) in entries {
        let path = join(&path, key);
        let factor = number_of(node, &path, Range::within(0.0, 1e3))?;
        params
            .scale(key, factor)
            .map_err(|why| refused(node, &path, why))?;
        params
            .validated()
            .map_err(|why| refused(node, &path, why))?;
        scale.insert(key.clone(), factor);
    }
    Ok((scale, params))
}

fn start(table: &Table<'_>) -> Read<Start> {
    let empty = empty();
    let table = section(table, "start", &["x_m", "y_m", "heading_deg"], &empty)?;
    Ok(Start {
        x_m: table.number_or("x_m", POSITION, 0.0)?,
        y_m: table.number_or("y_m", POSITION, 0.0)?,
        heading_deg: table.number_or("heading_deg", Range::within(-36e3, 36e3), 0.0)?,
    })
}

fn disturbance(table: &Table<'_>, environment: Environment) -> Read<Disturbance> {
    let imbalance_nm = match environment {
        Environment::Ideal => 0.0,
        Environment::Real => 0.2,
        Environment::Calibrated => 2.3,
    };
    let empty = empty();
    let table = section(table, "disturbance", DISTURBANCE, &empty)?;
    let mut pushes = Vec::new();
    for (node, path) in table.list("pushes")? {
        let push = Table::open(node, &path, &["at_s", "roll_nm", "pitch_nm", "for_s"])?;
        pushes.push(Push {
            at_s: push.required_number("at_s", TIME, "at_s = 20.0")?,
            roll_nm: push.number_or("roll_nm", TORQUE, 0.0)?,
            pitch_nm: push.number_or("pitch_nm", TORQUE, 0.0)?,
            for_s: push.required_number("for_s", LENGTH_OF_TIME, "for_s = 0.2")?,
        });
    }
    let mut patches = Vec::new();
    for (node, path) in table.list("patches")? {
        let patch = Table::open(node, &path, &["min_m", "max_m", "c_rr"])?;
        let read = Patch {
            min_m: pair(&patch, "min_m", POSITION, None)?,
            max_m: pair(&patch, "max_m", POSITION, None)?,
            c_rr: patch.required_number("c_rr", Range::within(0.0, 1.0), "c_rr = 0.03")?,
        };
        if (0..2).any(|axis| read.max_m[axis] <= read.min_m[axis]) {
            let why = "no robot is ever on it: max_m must be greater than min_m in x and in y";
            return Err(refused(node, &path, why.to_owned()));
        }
        patches.push(read);
    }
    let positive = Range::within(0.0, 1e4);
    Ok(Disturbance {
        imbalance_harmonic: table.number_or(
            "imbalance_harmonic",
            Range::within(0.0, 100.0),
            1.0,
        )?,
        random_nm: table.number_or("random_nm", positive, 0.0)?,
        random_correlation_s: table.number_or("random_correlation_s", LENGTH_OF_TIME, 0.3)?,
        stiction_nm: table.number_or("stiction_nm", positive, 0.0)?,
        slope_deg: pair(
            &table,
            "slope_deg",
            Range::within(-30.0, 30.0),
            Some([0.0; 2]),
        )?,
        patches,
        imbalance_nm: table.number_or("imbalance_nm", Range::within(0.0, 1e4), imbalance_nm)?,
        pushes,
    })
}

/// Two numbers under `key`; without a `default` they must be there.
fn pair(
    table: &Table<'_>,
    key: &'static str,
    range: Range,
    default: Option<[f64; 2]>,
) -> Read<[f64; 2]> {
    let Some((node, path)) = table.node(key) else {
        return default
            .ok_or_else(|| table.missing(key, "min_m = [1.0, -2.0], max_m = [3.0, 2.0]"));
    };
    let [(x, x_path), (y, y_path)] = list_of(node, &path)?
        .try_into()
        .map_err(|_| refused(node, &path, "it must be two numbers, [x, y]".to_owned()))?;
    Ok([number_of(x, &x_path, range)?, number_of(y, &y_path, range)?])
}

const DISTURBANCE: &[&str] = &[
    "imbalance_nm",
    "imbalance_harmonic",
    "random_nm",
    "random_correlation_s",
    "stiction_nm",
    "slope_deg",
    "patches",
    "pushes",
];

const KEYS: &[&str] = &[
    "id",
    "robot",
    "plant",
    "start",
    "clock_offset_s",
    "clock_drift_ppm",
    "telemetry_ms",
    "roll_controller",
    "disturbance",
    "mission",
];
