//! The robot file with identified values in it: nothing else changes, comments stay.

use std::collections::BTreeMap;

use serde::Deserialize;
use sphere_protocol::quantity::Section;
use sphere_protocol::robot::{Robot, RobotError};

use super::FieldValue;

#[derive(Deserialize)]
struct Sections {
    params: Section,
    #[serde(flatten)]
    _others: BTreeMap<String, toml::Value>,
}

/// The text of `robot`'s file with `fields` in place of its own values; their source says that they come from `log`.
///
/// # Errors
/// What comes out is no robot file: values that do not fit together.
pub fn rewritten(robot: &Robot, fields: &[FieldValue], log: &str) -> Result<String, RobotError> {
    let syntax = |error| RobotError::Syntax {
        name: robot.name.clone(),
        error: Box::new(error),
    };
    let sections: Sections = toml::from_str(&robot.text).map_err(syntax)?;
    let mut places: Vec<_> = fields
        .iter()
        .filter_map(|field| Some((sections.params.get(field.key)?.span(), field)))
        .collect();
    // From the last one on, so that the earlier ones stay where they are.
    places.sort_by_key(|(span, _)| core::cmp::Reverse(span.start));
    let mut text = robot.text.clone();
    for (span, field) in places {
        let FieldValue {
            unit,
            value,
            half_width,
            ..
        } = field;
        let source = format!(
            "identified from {log}, ± {}",
            rounded(*half_width, *half_width)
        );
        let source = toml::Value::String(source);
        let value = rounded(*value, *half_width);
        text.replace_range(
            span,
            &format!("{{ value = {value}, unit = \"{unit}\", source = {source} }}"),
        );
    }
    Robot::parse(&robot.name, &text)?;
    Ok(text)
}

/// To two significant digits of `half_width`, at least four decimals.
pub fn rounded(value: f64, half_width: f64) -> String {
    let digits = if half_width > 0.0 {
        (1.0 - half_width.log10().floor()).clamp(4.0, 9.0)
    } else {
        9.0
    };
    format!("{value:.*}", digits as usize)
}
