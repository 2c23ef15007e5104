//! `sphere-agent gains`: every condition on a robot's gains with its margin, as a table or as JSON.

use core::fmt::Write as _;

use serde::Serialize;
use sphere_protocol::robot::Robot;

use crate::gains::{Condition, GainsError, HsmcGains, HtsmcGains};
use crate::model::NominalModel;

/// The conditions on one robot's gains. As JSON: `{robot, conditions: [{section, name, value_of, value, relation, bound_of, bound, unit,
/// margin, holds, says}]}`; what is not finite is null.
#[derive(Clone, Debug, Serialize)]
pub struct GainsTable {
    robot: String,
    conditions: Vec<Line>,
}

/// One condition.
#[derive(Clone, Debug, Serialize)]
struct Line {
    section: &'static str,
    name: &'static str,
    value_of: &'static str,
    value: f64,
    relation: String,
    bound_of: &'static str,
    bound: f64,
    unit: &'static str,
    margin: f64,
    holds: bool,
    says: &'static str,
}

impl GainsTable {
    /// Evaluates the conditions of both torque controllers for `robot`.
    ///
    /// # Errors
    /// A gain that is missing, impossible or in a wrong unit. Gains that are merely unstable are shown, not refused.
    pub fn new(robot: &Robot) -> Result<Self, GainsError> {
        let model = NominalModel::new(&robot.params);
        let direction = HtsmcGains::read(robot)?.conditions(&model);
        let velocity = HsmcGains::read(robot)?.conditions(&model);
        let line = |section| move |condition: Condition| Line::new(section, &condition);
        Ok(Self {
            robot: robot.name.clone(),
            conditions: direction
                .into_iter()
                .map(line("htsmc"))
                .chain(velocity.into_iter().map(line("hsmc")))
                .collect(),
        })
    }

    /// Whether every condition holds.
    pub fn holds(&self) -> bool {
        self.conditions.iter().all(|line| line.holds)
    }

    /// A table for a terminal, and a sentence.
    pub fn text(&self) -> String {
        let mut text = String::new();
        let width = |cell: fn(&Line) -> usize| self.conditions.iter().map(cell).max().unwrap_or(0);
        let value_width = width(|line| line.value_of.chars().count());
        let bound_width = width(|line| line.bound_of.chars().count());
        for section in ["htsmc", "hsmc"] {
            let title = match section {
                "htsmc" => "Direction controller [htsmc]",
                _ => "Velocity controller [hsmc]",
            };
            writeln!(text, "{title}").expect("text grows");
            for line in self.conditions.iter().filter(|l| l.section == section) {
                writeln!(
                    text,
                    "  {} {:<4} {:<value_width$} = {:>9.4}  {:<8}  {:<bound_width$} = {:>9.4}  margin {:>9.4}  [{}]",
                    if line.holds { "ok " } else { "BAD" },
                    line.name,
                    line.value_of,
                    line.value,
                    line.relation,
                    line.bound_of,
                    line.bound,
                    line.margin,
                    line.unit,
                )
                .expect("text grows");
                if !line.holds {
                    writeln!(text, "           {}", line.says).expect("text grows");
                }
            }
        }
        let broken = self.conditions.iter().filter(|line| !line.holds).count();
        let robot = &self.robot;
        match broken {
            0 => writeln!(text, "\n{robot}: every condition holds. docs/controllers.md derives them and says how to tune."),
            _ => writeln!(text, "\n{robot}: {broken} of {} conditions do not hold: an agent refuses these gains.", self.conditions.len()),
        }
        .expect("text grows");
        text
    }
}

impl Line {
    fn new(section: &'static str, condition: &Condition) -> Self {
        Self {
            section,
            name: condition.name,
            value_of: condition.value_of,
            value: condition.value,
            relation: condition.relation.to_string(),
            bound_of: condition.bound_of,
            bound: condition.bound,
            unit: condition.unit,
            margin: condition.margin,
            holds: condition.holds,
            says: condition.says,
        }
    }
}
