//! Reads problem files: `{"note": ..., "instances": [...]}`, a bare array of instances, or one bare instance.
//!
//! | key | shape | meaning |
//! |---|---|---|
//! | `id` | any | named in the output; its place if absent |
//! | `kind` | text | `paper`: arc, first input measured; `std`, `rate`, `soft`: arc; `lag`, `centre`: five states |
//! | `n_x`, `horizon_n` | number | states (3 or 5, as the kind has), knots N |
//! | `dt_s`, `sphere_radius_m`, `lag_tau_s` | number | the model; the lag is `null` for three states |
//! | `x0_m_m_rad_mps_rad` | n_x | state at the beginning |
//! | `u_prev_mps_rad` | 2 | input before the first decided one |
//! | `xref_1_to_n_m_m_rad_mps_rad` | N × n_x | reference of x₁ … x_N |
//! | `uref_mps_rad` | N × 2 | reference of the decided inputs |
//! | `q_diag_per_m2_m2_rad2_mps2_rad2` | n_x | Q |
//! | `p_terminal_matrix` | n_x × n_x | P |
//! | `r_diag_per_mps2_rad2` | 2 | R |
//! | `r_rate_diag_per_mps2_rad2` | 2 | weight of the input's change; absent = 0 |
//! | `u_min_mps_rad`, `u_max_mps_rad` | 2 | bounds |
//! | `du_max_per_step_mps_rad` | 2 or null | bound on the input's change |
//! | `soft_halfplane` | object or null | `normal_unitless` (2), `offset_m`, `weight_per_m2`: for every knot |
//!
//! `expected`, `trajectory`, `t0_s` and `note` are ignored; any other key is an error.

use core::fmt;

use nalgebra::{SMatrix, SVector, Vector2};
use serde_json::{Map, Value};
use sphere_protocol::quantity::{line_of, nearest};

use crate::kinematics::Discretisation;
use crate::mpc::{FirstInput, HalfPlane, Problem};

/// One problem of a file.
#[derive(Clone, Debug, PartialEq)]
pub struct Instance {
    /// Its `id` as the file has it, or its place from 0.
    pub id: Value,
    /// Its `kind`.
    pub kind: Kind,
    /// The problem.
    pub problem: AnyProblem,
}

/// A problem of either size.
#[derive(Clone, Debug, PartialEq)]
pub enum AnyProblem {
    /// States X, Y, φ.
    Three(Problem<3>),
    /// States X, Y, φ, v, q_r.
    Five(Problem<5>),
}

/// What kind of problem an instance is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// Eq (20) literally.
    Paper,
    /// All inputs decided.
    Std,
    /// With bounds or costs on the change of the input.
    Rate,
    /// Five states.
    Lag,
    /// With a soft half-plane.
    Soft,
    /// Five states, the sphere's centre.
    Centre,
}

/// Why a file is refused: one sentence with file, place, key and remedy.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ProblemFileError {
    file: String,
    line: Option<usize>,
    instance: Option<String>,
    why: String,
}

/// Reads the instances of `text`; `file` appears in messages.
///
/// # Errors
/// The first thing that is not as the format has it.
pub fn parse(file: &str, text: &str) -> Result<Vec<Instance>, ProblemFileError> {
    let error = |why: String| ProblemFileError {
        file: file.to_owned(),
        line: None,
        instance: None,
        why,
    };
    let value: Value =
        serde_json::from_str(text).map_err(|e| error(format!("no valid JSON: {e}")))?;
    let instances = match &value {
        Value::Array(instances) => instances.as_slice(),
        Value::Object(object) if object.contains_key("instances") => {
            let known = ["instances", "note"];
            if let Some(key) = object.keys().find(|key| !known.contains(&key.as_str())) {
                return Err(unknown_key(file, text, None, key, &known));
            }
            object["instances"]
                .as_array()
                .ok_or_else(|| error("`instances` must be an array of problems".to_owned()))?
        }
        Value::Object(_) => core::slice::from_ref(&value),
        _ => {
            return Err(error(
                "it must hold a problem, an array of problems, or {\"instances\": [...]}"
                    .to_owned(),
            ));
        }
    };
    if instances.is_empty() {
        return Err(error("it holds no problem".to_owned()));
    }
    instances
        .iter()
        .enumerate()
        .map(|(place, value)| parse_instance(file, text, place, value))
        .collect()
}

fn parse_instance(
    file: &str,
    text: &str,
    place: usize,
    value: &Value,
) -> Result<Instance, ProblemFileError> {
    let id = value.get("id").cloned().unwrap_or_else(|| place.into());
    let label = match &id {
        Value::String(id) => id.clone(),
        id => id.to_string(),
    };
    let object = value.as_object().ok_or_else(|| ProblemFileError {
        file: file.to_owned(),
        line: None,
        instance: Some(label.clone()),
        why: "a problem must be an object".to_owned(),
    })?;
    let reader = Reader {
        file,
        text,
        label: &label,
        object,
    };
    reader.check_keys(object, &KEYS)?;
    let kind = reader.kind()?;
    let (period, radius) = (
        reader.positive("dt_s")?,
        reader.positive("sphere_radius_m")?,
    );
    let problem = match kind {
        Kind::Lag | Kind::Centre => {
            let tau = reader.positive("lag_tau_s")?;
            let model = match kind {
                Kind::Lag => Discretisation::lag(period, radius, tau),
                _ => Discretisation::centre(period, radius, tau),
            };
            AnyProblem::Five(reader.problem(kind, model)?)
        }
        _ => {
            if reader.given("lag_tau_s").is_some() {
                return Err(
                    reader.error("`lag_tau_s` must be null: three states have no lag".to_owned())
                );
            }
            AnyProblem::Three(reader.problem(kind, Discretisation::arc(period, radius))?)
        }
    };
    Ok(Instance { id, kind, problem })
}

/// One instance being read.
struct Reader<'a> {
    file: &'a str,
    text: &'a str,
    label: &'a str,
    object: &'a Map<String, Value>,
}

impl Reader<'_> {
    fn problem<const NX: usize>(
        &self,
        kind: Kind,
        model: Discretisation<NX>,
    ) -> Result<Problem<NX>, ProblemFileError> {
        let horizon = self.count("horizon_n", HORIZON_MAX)?;
        if self.given("n_x").is_some() && self.count("n_x", usize::MAX)? != NX {
            return Err(self.error(format!("`n_x` must be {NX} for kind `{kind}`")));
        }
        let mut problem = Problem::new(model, horizon);
        problem.first_input = match kind {
            Kind::Paper => FirstInput::Measured,
            _ => FirstInput::Decided,
        };
        problem.x0 = SVector::from(self.vector("x0_m_m_rad_mps_rad")?);
        problem.u_prev = Vector2::from(self.vector("u_prev_mps_rad")?);
        problem.x_ref = to_vectors(self.matrix("xref_1_to_n_m_m_rad_mps_rad", horizon)?);
        problem.u_ref = to_vectors(self.matrix("uref_mps_rad", horizon)?);
        problem.q = SVector::from(self.weights("q_diag_per_m2_m2_rad2_mps2_rad2")?);
        let terminal = self.matrix::<NX>("p_terminal_matrix", NX)?;
        problem.p_terminal = SMatrix::from_fn(|row, column| terminal[row][column]);
        problem.r = Vector2::from(self.weights("r_diag_per_mps2_rad2")?);
        if self.given("r_rate_diag_per_mps2_rad2").is_some() {
            problem.r_rate = Vector2::from(self.weights("r_rate_diag_per_mps2_rad2")?);
        }
        let (min, max) = (self.vector("u_min_mps_rad")?, self.vector("u_max_mps_rad")?);
        if let Some(j) = (0..2).find(|j| min[*j] > max[*j]) {
            return Err(self.error(format!(
                "`u_min_mps_rad`[{j}] = {} is above `u_max_mps_rad`[{j}] = {}",
                min[j], max[j]
            )));
        }
        problem.set_bounds(Vector2::from(min), Vector2::from(max));
        if self.given("du_max_per_step_mps_rad").is_some() {
            problem.du_max = Some(Vector2::from(self.weights("du_max_per_step_mps_rad")?));
        }
        if let Some(half_plane) = self.half_plane()? {
            for i in 0..horizon {
                problem.add_half_plane(i, half_plane);
            }
        }
        problem
            .validate()
            .map_err(|error| self.error(error.to_string()))?;
        Ok(problem)
    }

    fn kind(&self) -> Result<Kind, ProblemFileError> {
        let name = self
            .required("kind")?
            .as_str()
            .ok_or_else(|| self.error("`kind` must be a text".to_owned()))?;
        KINDS
            .iter()
            .find(|(known, _)| *known == name)
            .map(|(_, kind)| *kind)
            .ok_or_else(|| {
                let hint = nearest(name, KINDS.iter().map(|(known, _)| *known));
                self.error(format!("no `kind` is called `{name}`{hint}"))
            })
    }

    fn half_plane(&self) -> Result<Option<HalfPlane>, ProblemFileError> {
        let key = "soft_halfplane";
        let Some(value) = self.given(key) else {
            return Ok(None);
        };
        let object = value
            .as_object()
            .ok_or_else(|| self.error(format!("`{key}` must be an object or null")))?;
        self.check_keys(object, &HALF_PLANE_KEYS)?;
        let inner = Reader { object, ..*self };
        let weight = inner.number("weight_per_m2")?;
        if weight < 0.0 {
            return Err(inner.negative("weight_per_m2", weight));
        }
        Ok(Some(HalfPlane {
            normal: inner.vector("normal_unitless")?,
            offset: inner.number("offset_m")?,
            weight,
        }))
    }

    fn check_keys(
        &self,
        object: &Map<String, Value>,
        known: &[&str],
    ) -> Result<(), ProblemFileError> {
        match object.keys().find(|key| !known.contains(&key.as_str())) {
            None => Ok(()),
            Some(key) => Err(unknown_key(
                self.file,
                self.text,
                Some(self.label),
                key,
                known,
            )),
        }
    }

    /// The value of a key that is there and not null.
    fn given(&self, key: &str) -> Option<&Value> {
        self.object.get(key).filter(|value| !value.is_null())
    }

    fn required(&self, key: &str) -> Result<&Value, ProblemFileError> {
        self.given(key)
            .ok_or_else(|| self.error(format!("`{key}` is missing")))
    }

    fn number(&self, key: &str) -> Result<f64, ProblemFileError> {
        let value = self.required(key)?;
        value
            .as_f64()
            .ok_or_else(|| self.error(format!("`{key}` must be a number, not {}", brief(value))))
    }

    fn positive(&self, key: &str) -> Result<f64, ProblemFileError> {
        let value = self.number(key)?;
        if value > 0.0 {
            Ok(value)
        } else {
            Err(self.error(format!("`{key}` = {value} must be greater than 0")))
        }
    }

    fn count(&self, key: &str, max: usize) -> Result<usize, ProblemFileError> {
        let value = self.required(key)?;
        value
            .as_u64()
            .and_then(|count| usize::try_from(count).ok())
            .filter(|count| (1..=max).contains(count))
            .ok_or_else(|| {
                let limit = if max == usize::MAX {
                    String::new()
                } else {
                    format!(" from 1 to {max}")
                };
                self.error(format!(
                    "`{key}` must be a whole number{limit}, not {}",
                    brief(value)
                ))
            })
    }

    fn vector<const LEN: usize>(&self, key: &str) -> Result<[f64; LEN], ProblemFileError> {
        let value = self.required(key)?;
        numbers(value)
            .map_err(|found| self.error(format!("`{key}` must be {LEN} numbers, not {found}")))
    }

    fn weights<const LEN: usize>(&self, key: &str) -> Result<[f64; LEN], ProblemFileError> {
        let weights = self.vector(key)?;
        match weights.iter().find(|weight| **weight < 0.0) {
            None => Ok(weights),
            Some(weight) => Err(self.negative(key, *weight)),
        }
    }

    fn matrix<const COLUMNS: usize>(
        &self,
        key: &str,
        rows: usize,
    ) -> Result<Vec<[f64; COLUMNS]>, ProblemFileError> {
        let value = self.required(key)?;
        let shape = format!("`{key}` must be {rows} rows of {COLUMNS} numbers");
        let array = value
            .as_array()
            .ok_or_else(|| self.error(format!("{shape}, not {}", brief(value))))?;
        if array.len() != rows {
            return Err(self.error(format!("{shape}, not {} rows", array.len())));
        }
        array
            .iter()
            .enumerate()
            .map(|(i, row)| {
                numbers(row).map_err(|found| self.error(format!("{shape}: row {i} is {found}")))
            })
            .collect()
    }

    fn negative(&self, key: &str, value: f64) -> ProblemFileError {
        self.error(format!("`{key}` holds {value}: it must not be negative"))
    }

    fn error(&self, why: String) -> ProblemFileError {
        ProblemFileError {
            file: self.file.to_owned(),
            line: None,
            instance: Some(self.label.to_owned()),
            why,
        }
    }
}

impl fmt::Display for ProblemFileError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.file)?;
        if let Some(line) = self.line {
            write!(f, ":{line}")?;
        }
        if let Some(instance) = &self.instance {
            write!(f, ": instance {instance}")?;
        }
        write!(f, ": {}", self.why)
    }
}

impl core::error::Error for ProblemFileError {}

impl fmt::Display for Kind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let name = KINDS
            .iter()
            .find(|(_, kind)| kind == self)
            .map_or("", |(name, _)| *name);
        f.pad(name)
    }
}

/// Longest horizon of a file.
const HORIZON_MAX: usize = 1000;

const KINDS: [(&str, Kind); 6] = [
    ("paper", Kind::Paper),
    ("std", Kind::Std),
    ("rate", Kind::Rate),
    ("lag", Kind::Lag),
    ("soft", Kind::Soft),
    ("centre", Kind::Centre),
];

const KEYS: [&str; 23] = [
    "id",
    "kind",
    "n_x",
    "horizon_n",
    "dt_s",
    "sphere_radius_m",
    "lag_tau_s",
    "x0_m_m_rad_mps_rad",
    "u_prev_mps_rad",
    "xref_1_to_n_m_m_rad_mps_rad",
    "uref_mps_rad",
    "q_diag_per_m2_m2_rad2_mps2_rad2",
    "p_terminal_matrix",
    "r_diag_per_mps2_rad2",
    "r_rate_diag_per_mps2_rad2",
    "u_min_mps_rad",
    "u_max_mps_rad",
    "du_max_per_step_mps_rad",
    "soft_halfplane",
    "expected",
    "trajectory",
    "t0_s",
    "note",
];

const HALF_PLANE_KEYS: [&str; 3] = ["normal_unitless", "offset_m", "weight_per_m2"];

fn unknown_key(
    file: &str,
    text: &str,
    instance: Option<&str>,
    key: &str,
    known: &[&str],
) -> ProblemFileError {
    // Nothing else is called so: its first appearance is the one meant.
    let quoted = Value::from(key).to_string();
    ProblemFileError {
        file: file.to_owned(),
        line: text.find(&quoted).map(|at| line_of(text, at)),
        instance: instance.map(str::to_owned),
        why: format!("unknown key `{key}`{}", nearest(key, known.iter().copied())),
    }
}

/// `LEN` finite numbers, or what is there instead.
fn numbers<const LEN: usize>(value: &Value) -> Result<[f64; LEN], String> {
    let array = value.as_array().ok_or_else(|| brief(value))?;
    if array.len() != LEN {
        return Err(format!("{} of them", array.len()));
    }
    let mut numbers = [0.0; LEN];
    for (number, value) in numbers.iter_mut().zip(array) {
        *number = value
            .as_f64()
            .ok_or_else(|| format!("one with {}", brief(value)))?;
    }
    Ok(numbers)
}

fn to_vectors<const LEN: usize>(rows: Vec<[f64; LEN]>) -> Vec<SVector<f64, LEN>> {
    rows.into_iter().map(SVector::from).collect()
}

/// A value in a message: its beginning.
fn brief(value: &Value) -> String {
    match value {
        Value::Array(rows) => format!("an array of {}", rows.len()),
        Value::Object(_) => "an object".to_owned(),
        other => other.to_string().chars().take(40).collect(),
    }
}
