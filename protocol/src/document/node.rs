//! A TOML document whose every value knows where it was written, so that a message can say so; `--set` edits it before it is read.

use std::collections::BTreeMap;

use crate::quantity::line_of;
use toml::de::{DeTable, DeValue};

use super::error::{Place, Problem, Read, Refusal};

/// A value and where it was written.
#[derive(Clone, Debug)]
pub struct Node {
    /// The value.
    pub value: Value,
    /// Where it was written.
    pub place: Place,
}

/// A TOML value.
#[derive(Clone, Debug)]
pub enum Value {
    /// A string.
    Text(String),
    /// A whole number.
    Integer(i64),
    /// A number with a point; may be infinite or no number.
    Float(f64),
    /// true or false.
    Boolean(bool),
    /// A date or time, which no format of ours has.
    Date(String),
    /// A list.
    List(Vec<Node>),
    /// A table.
    Table(BTreeMap<String, Node>),
}

impl Node {
    /// Reads a whole document.
    ///
    /// # Errors
    /// It is not TOML.
    pub fn document(text: &str) -> Read<Self> {
        let table = DeTable::parse(text).map_err(|error| {
            let line = error.span().map_or(1, |span| line_of(text, span.start));
            Refusal::new(&Place::Line(line), "", syntax(&error))
        })?;
        Self::from_toml(DeValue::Table(table.into_inner()), Place::Line(1), &|at| {
            Place::Line(line_of(text, at))
        })
    }

    /// Carries out `--set ARGUMENT`, where ARGUMENT is `path.to.key=value`: the value in TOML, or a bare word, which is text.
    ///
    /// # Errors
    /// The argument is no `key=value`, or leads nowhere.
    pub fn set(&mut self, argument: &str) -> Read<()> {
        let place = Place::Set(argument.to_owned());
        let refuse =
            |why: String| Refusal::new(&Place::Set(argument.to_owned()), "", Problem::Path(why));
        let Some((path, value)) = argument.split_once('=') else {
            return Err(refuse("write it as key=value".to_owned()));
        };
        let (path, value) = (path.trim(), value.trim());
        if value.is_empty() {
            return Err(refuse("give a value after the `=`".to_owned()));
        }
        let value = Self::typed_in(value, &place)?;
        let mut node = self;
        let mut walked = String::new();
        for part in path.split('.') {
            if part.is_empty() {
                return Err(refuse(format!("`{path}` has an empty part")));
            }
            let parent = match node.value {
                Value::Table(_) | Value::List(_) => core::mem::take(&mut walked),
                _ => {
                    return Err(refuse(format!(
                        "`{walked}` is {} and has no keys",
                        node.value
                    )));
                }
            };
            walked = join(&parent, part);
            node = match &mut node.value {
                Value::Table(entries) => entries.entry(part.to_owned()).or_insert_with(|| Self {
                    value: Value::Table(BTreeMap::new()),
                    place: place.clone(),
                }),
                Value::List(items) => {
                    let count = items.len();
                    let index = part.parse::<usize>().ok().filter(|index| *index < count);
                    let last = count.checked_sub(1);
                    &mut items[index.ok_or_else(|| {
                        refuse(match last {
                            Some(0) => format!("`{parent}` has one entry: say `{parent}.0`"),
                            Some(last) => {
                                format!("`{parent}` has entries 0 to {last}, no `{part}`")
                            }
                            None => format!("`{parent}` has no entries: set the whole list"),
                        })
                    })?]
                }
                _ => unreachable!("only tables and lists were let through above"),
            };
        }
        *node = value;
        Ok(())
    }

    /// A value as typed on the command line.
    fn typed_in(text: &str, place: &Place) -> Read<Self> {
        match DeValue::parse(text) {
            Ok(value) => Self::from_toml(value.into_inner(), place.clone(), &|_| place.clone()),
            // Shells eat quotes: `planner.preset=paper` and `robots.0.robot=../mine.toml` mean text.
            Err(_) if !text.contains(['[', ']', '{', '}', '"', '\'', '\n']) => Ok(Self {
                value: Value::Text(text.to_owned()),
                place: place.clone(),
            }),
            Err(error) => Err(Refusal::new(place, "", syntax(&error))),
        }
    }

    fn from_toml(
        value: DeValue<'_>,
        place: Place,
        place_of: &dyn Fn(usize) -> Place,
    ) -> Read<Self> {
        let refuse = |why: String| Refusal::new(&place, "", Problem::Syntax(why));
        let value = match value {
            DeValue::String(text) => Value::Text(text.into_owned()),
            DeValue::Integer(integer) => Value::Integer(
                i64::from_str_radix(integer.as_str(), integer.radix())
                    .map_err(|_| refuse(format!("{integer} does not fit into 64 bits")))?,
            ),
            DeValue::Float(float) => Value::Float(
                float
                    .as_str()
                    .parse()
                    .map_err(|_| refuse(format!("{float} is no number")))?,
            ),
            DeValue::Boolean(boolean) => Value::Boolean(boolean),
            DeValue::Datetime(date) => Value::Date(date.to_string()),
            DeValue::Array(items) => Value::List(
                items
                    .into_iter()
                    .map(|item| {
                        let place = place_of(item.span().start);
                        Self::from_toml(item.into_inner(), place, place_of)
                    })
                    .collect::<Result<_, _>>()?,
            ),
            DeValue::Table(entries) => Value::Table(
                entries
                    .into_iter()
                    .map(|(key, item)| {
                        let place = place_of(key.span().start);
                        let item = Self::from_toml(item.into_inner(), place, place_of)?;
                        Ok((key.into_inner().into_owned(), item))
                    })
                    .collect::<Result<_, _>>()?,
            ),
        };
        Ok(Self { value, place })
    }
}

impl core::fmt::Display for Value {
    /// The value as TOML on one line, cut short where it is long.
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::Text(text) => f.write_str(&quoted(text)),
            Self::Integer(integer) => write!(f, "{integer}"),
            Self::Float(float) => f.write_str(&number(*float)),
            Self::Boolean(boolean) => write!(f, "{boolean}"),
            Self::Date(date) => f.write_str(date),
            Self::List(items) => match items.as_slice() {
                [] => f.write_str("[]"),
                [first] => write!(f, "[{}]", first.value),
                [first, ..] => write!(f, "[{}, ...]", first.value),
            },
            Self::Table(entries) => match entries.first_key_value() {
                None => f.write_str("{}"),
                Some((key, item)) if entries.len() == 1 => {
                    write!(f, "{{ {key} = {} }}", item.value)
                }
                Some((key, item)) => write!(f, "{{ {key} = {}, ... }}", item.value),
            },
        }
    }
}

/// `text` as a TOML string.
pub fn quoted(text: &str) -> String {
    toml::Value::String(text.to_owned()).to_string()
}

/// `value` as a TOML float: the shortest text that reads back as the same number.
pub fn number(value: f64) -> String {
    if value.is_finite() {
        format!("{value:?}")
    } else {
        toml::Value::Float(value).to_string()
    }
}

/// `parent.key`, or `key` at the top.
pub fn join(parent: &str, key: &str) -> String {
    if parent.is_empty() {
        key.to_owned()
    } else {
        format!("{parent}.{key}")
    }
}

fn syntax(error: &toml::de::Error) -> Problem {
    Problem::Syntax(error.message().replace('\n', ", "))
}
