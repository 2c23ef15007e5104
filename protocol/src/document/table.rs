//! One table of the document, read key by key into typed values.

use std::collections::BTreeMap;

use crate::quantity::nearest;

use super::error::{Place, Problem, Read, Refusal};
use super::node::{Node, Value, join};

/// A table whose keys are all known.
pub struct Table<'a> {
    path: String,
    place: &'a Place,
    entries: &'a BTreeMap<String, Node>,
}

/// A closed range of a number; `above` makes its lower end open.
#[derive(Clone, Copy)]
pub struct Range {
    low: f64,
    high: f64,
    above: bool,
}

/// A type whose values have names in the file.
pub trait Named: Copy + PartialEq + 'static {
    /// What the names name, for messages.
    const WHAT: &'static str;
    /// Every value with its name.
    const NAMES: &'static [(&'static str, Self)];

    /// Its name in the file.
    fn name(self) -> &'static str {
        let named = Self::NAMES.iter().find(|(_, value)| *value == self);
        named.expect("every value is listed").0
    }
}

impl Range {
    /// From `low` to `high`, both included.
    pub const fn within(low: f64, high: f64) -> Self {
        Self {
            low,
            high,
            above: false,
        }
    }

    /// Above 0, up to `high`.
    pub const fn positive(high: f64) -> Self {
        Self {
            low: 0.0,
            high,
            above: true,
        }
    }

    fn contains(self, value: f64) -> bool {
        value <= self.high
            && if self.above {
                value > self.low
            } else {
                value >= self.low
            }
    }

    /// What a number must be, in words, that the refused `value` is not.
    fn describe(self, value: f64) -> String {
        let Self { low, high, above } = self;
        let unbounded = high >= UNBOUNDED;
        if unbounded && value.is_finite() && value > high {
            return format!("at most {high:e}");
        }
        match (above, unbounded) {
            (true, true) => format!("greater than {low} and finite"),
            (true, false) => format!("greater than {low} and at most {high}"),
            (false, true) if low == 0.0 => "0 or more and finite".to_owned(),
            (false, true) => format!("finite and at least {low:e}"),
            (false, false) => format!("from {low} to {high}"),
        }
    }
}

impl<'a> Table<'a> {
    /// `node` as a table at `path` with none but the `known` keys.
    ///
    /// # Errors
    /// It is no table, or has another key.
    pub fn open(node: &'a Node, path: &str, known: &[&'static str]) -> Read<Self> {
        let Value::Table(entries) = &node.value else {
            return Err(kind(node, path, "a table", ""));
        };
        if let Some((key, unknown)) = entries
            .iter()
            .find(|(key, _)| !known.contains(&key.as_str()))
        {
            let hint = suggestion(key, known);
            return Err(Refusal::new(
                &unknown.place,
                &join(path, key),
                Problem::Unknown { hint },
            ));
        }
        Ok(Self {
            path: path.to_owned(),
            place: &node.place,
            entries,
        })
    }

    /// The path of `key` in this table.
    pub fn path_of(&self, key: &str) -> String {
        join(&self.path, key)
    }

    /// The value of `key` with its path.
    pub fn node(&self, key: &str) -> Option<(&'a Node, String)> {
        Some((self.entries.get(key)?, self.path_of(key)))
    }

    /// A number in `range`.
    ///
    /// # Errors
    /// It is no number, or outside the range.
    pub fn number(&self, key: &str, range: Range) -> Read<Option<f64>> {
        self.node(key)
            .map(|(node, path)| number_of(node, &path, range))
            .transpose()
    }

    /// A number in `range`, or `default` where the file has none.
    ///
    /// # Errors
    /// It is no number, or outside the range.
    pub fn number_or(&self, key: &str, range: Range, default: f64) -> Read<f64> {
        Ok(self.number(key, range)?.unwrap_or(default))
    }

    /// A number in `range` that must be there.
    ///
    /// # Errors
    /// It is missing, no number, or outside the range.
    pub fn required_number(
        &self,
        key: &'static str,
        range: Range,
        example: &'static str,
    ) -> Read<f64> {
        self.number(key, range)?
            .ok_or_else(|| self.missing(key, example))
    }

    /// A whole number from `low` to `high`.
    ///
    /// # Errors
    /// It is no whole number, or outside the range.
    pub fn integer(&self, key: &str, low: i64, high: i64) -> Read<Option<i64>> {
        let Some((node, path)) = self.node(key) else {
            return Ok(None);
        };
        match node.value {
            Value::Integer(value) if (low..=high).contains(&value) => Ok(Some(value)),
            Value::Integer(_) if high == i64::MAX => {
                Err(range_error(node, &path, format!("{low} or more")))
            }
            Value::Integer(_) => Err(range_error(node, &path, format!("from {low} to {high}"))),
            _ => Err(kind(
                node,
                &path,
                "a whole number",
                without_quotes(&node.value),
            )),
        }
    }

    /// A text that must be there.
    ///
    /// # Errors
    /// It is missing or no text.
    pub fn required_text(
        &self,
        key: &'static str,
        example: &'static str,
    ) -> Read<(&'a Node, &'a str, String)> {
        let (node, path) = self.node(key).ok_or_else(|| self.missing(key, example))?;
        Ok((node, text_of(node, &path)?, path))
    }

    /// A text.
    ///
    /// # Errors
    /// It is no text.
    pub fn text(&self, key: &str) -> Read<Option<&'a str>> {
        self.node(key)
            .map(|(node, path)| text_of(node, &path))
            .transpose()
    }

    /// A name of one of `T`'s values, or `default` where the file has none.
    ///
    /// # Errors
    /// It names none of them.
    pub fn named_or<T: Named>(&self, key: &str, default: T) -> Read<T> {
        let Some((node, path)) = self.node(key) else {
            return Ok(default);
        };
        let text = text_of(node, &path)?;
        match T::NAMES.iter().find(|(name, _)| *name == text) {
            Some((_, value)) => Ok(*value),
            None => Err(unknown_name(
                node,
                &path,
                T::WHAT,
                T::NAMES.iter().map(|(name, _)| *name),
            )),
        }
    }

    /// The entries of a list with their paths; none where the file has no such list.
    ///
    /// # Errors
    /// It is no list.
    pub fn list(&self, key: &str) -> Read<Vec<(&'a Node, String)>> {
        self.node(key)
            .map_or(Ok(Vec::new()), |(node, path)| list_of(node, &path))
    }

    /// The error that `key` is missing here.
    pub fn missing(&self, key: &'static str, example: &'static str) -> Refusal {
        Refusal::new(self.place, &self.path_of(key), Problem::Missing { example })
    }
}

/// The table `key` of `top`, or `empty` in its place.
///
/// # Errors
/// It is no table, or has a key that is not `known`.
pub fn section<'a>(
    top: &Table<'a>,
    key: &str,
    known: &[&'static str],
    empty: &'a Node,
) -> Read<Table<'a>> {
    let (node, path) = top.node(key).unwrap_or((empty, top.path_of(key)));
    Table::open(node, &path, known)
}

/// A table without entries, for a section that the file leaves out.
pub fn empty() -> Node {
    Node {
        value: Value::Table(BTreeMap::new()),
        place: Place::File,
    }
}

/// `node` as a number in `range`.
///
/// # Errors
/// It is no number, or outside the range.
pub fn number_of(node: &Node, path: &str, range: Range) -> Read<f64> {
    let value = match node.value {
        Value::Float(value) => value,
        Value::Integer(value) => value as f64,
        _ => return Err(kind(node, path, "a number", without_quotes(&node.value))),
    };
    if range.contains(value) {
        Ok(value)
    } else {
        Err(range_error(node, path, range.describe(value)))
    }
}

/// `node` as text.
///
/// # Errors
/// It is no text.
pub fn text_of<'a>(node: &'a Node, path: &str) -> Read<&'a str> {
    match &node.value {
        Value::Text(text) => Ok(text),
        _ => Err(kind(node, path, "text", ": put it in quotes")),
    }
}

/// The entries of the list `node` with their paths.
///
/// # Errors
/// It is no list.
pub fn list_of<'a>(node: &'a Node, path: &str) -> Read<Vec<(&'a Node, String)>> {
    match &node.value {
        Value::List(items) => Ok(items
            .iter()
            .enumerate()
            .map(|(index, item)| (item, join(path, &index.to_string())))
            .collect()),
        _ => Err(kind(node, path, "a list", ": put it in [ ]")),
    }
}

/// A refusal of `node` for the reason `why`.
pub fn refused(node: &Node, path: &str, why: String) -> Refusal {
    let value = node.value.to_string();
    Refusal::new(&node.place, path, Problem::Refused { value, why })
}

/// A refusal of the text `node`, which names none of `known`.
pub fn unknown_name<'a>(
    node: &Node,
    path: &str,
    what: &'static str,
    known: impl Iterator<Item = &'a str> + Clone,
) -> Refusal {
    let hint = match &node.value {
        Value::Text(text) => nearest(text, known),
        _ => String::new(),
    };
    let value = node.value.to_string();
    Refusal::new(&node.place, path, Problem::Name { value, what, hint })
}

fn range_error(node: &Node, path: &str, must: String) -> Refusal {
    let value = node.value.to_string();
    Refusal::new(&node.place, path, Problem::Range { value, must })
}

fn kind(node: &Node, path: &str, expected: &'static str, hint: &'static str) -> Refusal {
    let value = node.value.to_string();
    Refusal::new(
        &node.place,
        path,
        Problem::Kind {
            value,
            expected,
            hint,
        },
    )
}

fn without_quotes(value: &Value) -> &'static str {
    match value {
        Value::Text(text) if text.trim().parse::<f64>().is_ok() => ": leave out the quotes",
        Value::Text(_) => ": the unit is in the key's name, write the number alone",
        _ => "",
    }
}

/// ", did you mean `x`?" for the known key that `key` may stand for: with the unit forgotten, or misspelt.
fn suggestion(key: &str, known: &[&'static str]) -> String {
    let has_unit = |whole: &&&str| {
        whole
            .strip_prefix(key)
            .is_some_and(|unit| unit.starts_with('_'))
    };
    match known.iter().find(has_unit) {
        Some(whole) => format!(": did you mean `{whole}`?"),
        None => nearest(key, known.iter().copied()),
    }
}

/// Upper ends from here on only keep numbers computable: messages do not name them first.
const UNBOUNDED: f64 = 1e8;
