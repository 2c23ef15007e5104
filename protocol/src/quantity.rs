//! Physical values in TOML: every one with its unit and its source, read into SI.
//!
//! ```toml
//! [params]
//! m = { value = 16.0, unit = "kg", source = "weighed" }
//! ```
//!
//! A section is read against a table of [`Field`]s: a missing, unknown or repeated key, a unit that is not one of the field's,
//! and a value outside its range are errors that name the line and the remedy.

use std::collections::BTreeMap;

use serde::Deserialize;
use thiserror::Error;
use toml::Spanned;

/// A key of a section: its units, where its value goes, and what values make sense.
pub struct Field<T> {
    /// The key in the file.
    pub key: &'static str,
    /// Accepted units with the factor that leads to SI; the first is the one to recommend.
    pub units: &'static [(&'static str, f64)],
    /// Where the value lives in `T`.
    pub at: fn(&mut T) -> &mut f64,
    /// The values that are possible at all.
    pub range: Range,
    /// The value if the file does not give one; `None` makes the key required.
    pub default: Option<f64>,
}

/// Values that are possible at all [SI].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Range {
    /// Finite and > 0.
    Positive,
    /// Finite and ≥ 0.
    NonNegative,
    /// Finite.
    Finite,
}

/// One value as a file states it.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Quantity {
    /// The number, in `unit`.
    pub value: f64,
    /// Its unit.
    pub unit: String,
    /// Where the value comes from.
    pub source: String,
}

/// A section of a file: its keys and values with their places.
pub type Section = BTreeMap<String, Spanned<Quantity>>;

/// Why a section could not be read.
#[derive(Debug, Error, PartialEq)]
pub enum QuantityError {
    /// The section lacks a required key.
    #[error(
        "[{section}] has no `{key}`: add `{key} = {{ value = ..., unit = \"{unit}\", source = \"...\" }}`"
    )]
    Missing {
        /// Section name.
        section: &'static str,
        /// The missing key.
        key: &'static str,
        /// Its recommended unit.
        unit: &'static str,
    },
    /// The section has a key that means nothing here.
    #[error("line {line}: [{section}] has an unknown key `{key}`{hint}")]
    Unknown {
        /// Line of the value, from 1.
        line: usize,
        /// Section name.
        section: &'static str,
        /// The unknown key.
        key: String,
        /// The nearest known key, as a sentence.
        hint: String,
    },
    /// The unit is not one of the field's.
    #[error("line {line}: {key} is in `{unit}`, which is no unit of it: use {expected}")]
    Unit {
        /// Line of the value, from 1.
        line: usize,
        /// The key.
        key: &'static str,
        /// The unit in the file.
        unit: String,
        /// The accepted units.
        expected: String,
    },
    /// The value is impossible.
    #[error("line {line}: {key} = {value} {unit} is impossible: it must be {must}")]
    Impossible {
        /// Line of the value, from 1.
        line: usize,
        /// The key.
        key: &'static str,
        /// The value in the file.
        value: f64,
        /// The unit in the file.
        unit: String,
        /// What it must be.
        must: &'static str,
    },
    /// The value has no source.
    #[error("line {line}: {key} has an empty source: say where the value comes from")]
    NoSource {
        /// Line of the value, from 1.
        line: usize,
        /// The key.
        key: &'static str,
    },
}

/// Units of a dimensionless value.
pub const ONE: &[(&str, f64)] = &[("1", 1.0)];
/// Units of an angle.
pub const ANGLE: &[(&str, f64)] = &[("rad", 1.0), ("deg", core::f64::consts::PI / 180.0)];
/// Units of a time.
pub const TIME: &[(&str, f64)] = &[("s", 1.0), ("ms", 1e-3)];
/// Units of a length.
pub const LENGTH: &[(&str, f64)] = &[("m", 1.0), ("mm", 1e-3)];

impl Range {
    /// Whether `value` [SI] lies in this range.
    pub fn contains(self, value: f64) -> bool {
        value.is_finite()
            && match self {
                Self::Positive => value > 0.0,
                Self::NonNegative => value >= 0.0,
                Self::Finite => true,
            }
    }

    const fn describe(self) -> &'static str {
        match self {
            Self::Positive => "finite and greater than 0",
            Self::NonNegative => "finite and not negative",
            Self::Finite => "finite",
        }
    }
}

/// Reads `section` of `text` into `into`, key by key of `fields`.
///
/// # Errors
/// The first missing, unknown, impossible or unsourced value, with its line in `text`.
pub fn read_section<T>(
    into: &mut T,
    name: &'static str,
    section: &Section,
    fields: &[Field<T>],
    text: &str,
) -> Result<(), QuantityError> {
    if let Some((key, value)) = section
        .iter()
        .find(|(key, _)| !fields.iter().any(|field| field.key == **key))
    {
        return Err(QuantityError::Unknown {
            line: line_of(text, value.span().start),
            section: name,
            key: key.clone(),
            hint: nearest(key, fields.iter().map(|field| field.key)),
        });
    }
    for field in fields {
        let Some(spanned) = section.get(field.key) else {
            let value = field.default.ok_or(QuantityError::Missing {
                section: name,
                key: field.key,
                unit: field.units[0].0,
            })?;
            *(field.at)(into) = value;
            continue;
        };
        let line = line_of(text, spanned.span().start);
        let Quantity {
            value,
            unit,
            source,
        } = spanned.get_ref();
        let Some((_, factor)) = field.units.iter().find(|(accepted, _)| accepted == unit) else {
            let expected: Vec<_> = field
                .units
                .iter()
                .map(|(accepted, _)| format!("`{accepted}`"))
                .collect();
            return Err(QuantityError::Unit {
                line,
                key: field.key,
                unit: unit.clone(),
                expected: expected.join(" or "),
            });
        };
        if source.trim().is_empty() {
            return Err(QuantityError::NoSource {
                line,
                key: field.key,
            });
        }
        let si = value * factor;
        if !field.range.contains(si) {
            return Err(QuantityError::Impossible {
                line,
                key: field.key,
                value: *value,
                unit: unit.clone(),
                must: field.range.describe(),
            });
        }
        *(field.at)(into) = si;
    }
    Ok(())
}

/// ", did you mean `x`?" for the known key nearest to `key`, or the list of known keys if none is near.
pub fn nearest<'a>(key: &str, known: impl Iterator<Item = &'a str> + Clone) -> String {
    let best = known
        .clone()
        .map(|k| (strsim::damerau_levenshtein(key, k), k))
        .min();
    match best {
        Some((distance, k)) if distance <= 1 + key.len() / 3 => format!(": did you mean `{k}`?"),
        _ => format!(": it takes {}", known.collect::<Vec<_>>().join(", ")),
    }
}

/// Line of byte `at` in `text`, from 1.
pub fn line_of(text: &str, at: usize) -> usize {
    text.as_bytes()[..at.min(text.len())]
        .iter()
        .filter(|byte| **byte == b'\n')
        .count()
        + 1
}
