//! `sphere-agent identify`: an identification as a table and as JSON. Text in, text out.

use core::fmt::Write as _;

use serde::Serialize;

use super::robot_file::rounded;
use super::{Estimate, Identification};

/// What `--json` prints.
#[derive(Clone, Debug, Serialize)]
pub struct Report {
    /// The log.
    pub log: String,
    /// The robot it was fitted to.
    pub robot: String,
    /// Whether the result may be used.
    pub trustworthy: bool,
    /// Why not, a sentence each.
    pub problems: Vec<String>,
    /// Combinations that can be told apart.
    pub parameters: Vec<Row>,
    /// Fields of the robot file that follow from them, given its masses and R.
    pub fields: Vec<Row>,
    /// Length of the log [s].
    pub duration_s: f64,
    /// Averaged equations used, of each row.
    pub equations: usize,
    /// Left over on the rows α, φ, β, q_r.
    pub residual_rms_nm: [f64; 4],
    /// Torque on the same rows.
    pub torque_rms_nm: [f64; 4],
    /// Amplitude of the shell's imbalance on the rolling motion and on the roll.
    pub imbalance_nm: [f64; 2],
    /// Conditions of stability that the file's gains break, a sentence each.
    pub broken_conditions: Vec<String>,
}

/// One value.
#[derive(Clone, Debug, Serialize)]
pub struct Row {
    /// Its name.
    pub name: &'static str,
    /// Its value by the robot file.
    pub prior: f64,
    /// Its value by the log; null if there is none.
    pub fitted: f64,
    /// Half of the 95 % interval.
    pub half_width_95: f64,
    /// Unit of the three.
    pub unit: &'static str,
    /// From prior to fitted; null if the prior is 0.
    pub change_percent: f64,
}

impl Report {
    /// What there is to say of `identification`, fitted to the log named `log`.
    pub fn new(identification: &Identification, log: &str, robot: &str) -> Self {
        let quality = &identification.quality;
        Self {
            log: log.to_owned(),
            robot: robot.to_owned(),
            trustworthy: identification.is_trustworthy(),
            problems: identification.problems.clone(),
            parameters: identification.estimates.iter().map(estimate).collect(),
            fields: identification
                .fields
                .iter()
                .map(|field| {
                    row(
                        field.key,
                        field.prior,
                        field.value,
                        field.half_width,
                        field.unit,
                    )
                })
                .collect(),
            duration_s: quality.duration,
            equations: quality.equations,
            residual_rms_nm: quality.residual_rms,
            torque_rms_nm: quality.torque_rms,
            imbalance_nm: quality.imbalance,
            broken_conditions: identification
                .broken
                .iter()
                .map(ToString::to_string)
                .collect(),
        }
    }

    /// For people.
    pub fn to_table(&self) -> String {
        let mut text = String::new();
        // Writing to a String cannot fail.
        let _ = writeln!(
            text,
            "{:<11}  {:>9}  {:>9}  {:>8}  {:<10}  {:>8}",
            "parameter", "prior", "fitted", "± 95 %", "unit", "change %"
        );
        for row in &self.parameters {
            line(&mut text, row);
        }
        let _ = writeln!(text, "\nof these, with the file's masses and R:");
        for row in &self.fields {
            line(&mut text, row);
        }
        let rows = ["pitch", "rolling ahead", "pendulum roll", "roll"];
        let left: Vec<_> = rows
            .iter()
            .zip(self.residual_rms_nm.iter().zip(&self.torque_rms_nm))
            .map(|(name, (left, torque))| format!("{name} {left:.3} of {torque:.3}"))
            .collect();
        let [pitch, roll] = self.imbalance_nm;
        let _ = writeln!(
            text,
            "\nLeft over of the torques, N·m: {}; {} equations each from {:.1} s. Shell imbalance {pitch:.3} and {roll:.3} N·m.",
            left.join(", "),
            self.equations,
            self.duration_s
        );
        text
    }
}

fn estimate(e: &Estimate) -> Row {
    row(e.name, e.prior, e.value, e.half_width, e.unit)
}

fn row(name: &'static str, prior: f64, fitted: f64, half_width: f64, unit: &'static str) -> Row {
    Row {
        name,
        prior,
        fitted,
        half_width_95: half_width,
        unit,
        change_percent: 100.0 * (fitted / prior - 1.0),
    }
}

fn line(text: &mut String, row: &Row) {
    let change = if row.change_percent.is_finite() {
        format!("{:+.1}", row.change_percent)
    } else {
        "-".to_owned()
    };
    let number = |value| rounded(value, row.half_width_95);
    let _ = writeln!(
        text,
        "{:<11}  {:>9}  {:>9}  {:>8}  {:<10}  {:>8}",
        row.name,
        number(row.prior),
        number(row.fitted),
        number(row.half_width_95),
        row.unit,
        change
    );
}
