//! The log of a manoeuvre: what the board measured and what it was told, and nothing that a real robot does not know.
//!
//! CSV, one row a sensor frame, oldest first. The first line that is neither empty nor a comment (`#`) names the columns, in any
//! order; columns that are not known are passed over.
//!
//! | column | unit | |
//! |---|---|---|
//! | `stamp_s` | s | board's clock at sampling, any origin, growing |
//! | `gyro_x_rad_s`, `gyro_y_rad_s`, `gyro_z_rad_s` | rad/s | angular velocity of the frame; forward, left, up |
//! | `accel_x_m_s2`, `accel_y_m_s2`, `accel_z_m_s2` | m/s² | specific force; forward, left, up: +9.81 on z at rest |
//! | `theta_r_rad` | rad | angle of the roll motor, β + q_r, unwrapped |
//! | `theta_p_rad` | rad | angle of the pitch motor, φ_s + α, unwrapped |
//! | `torque_pitch_nm`, `torque_roll_nm` | N·m | the torques commanded last; empty = none yet |
//! | `torque_stamp_s` | s | when they were sent, in the board's clock; without it: at the row's stamp |
//! | `fix_stamp_s`, `fix_x_m`, `fix_y_m`, `fix_sigma_m` | s, m | a position fix that arrived since the row before; mostly empty |
//!
//! The last two lines may be missing altogether.

use sphere_protocol::quantity::nearest;
use sphere_protocol::state::Torque;
use thiserror::Error;

/// Names of the columns, in the order in which they are written.
pub const COLUMNS: [&str; 16] = [
    "stamp_s",
    "gyro_x_rad_s",
    "gyro_y_rad_s",
    "gyro_z_rad_s",
    "accel_x_m_s2",
    "accel_y_m_s2",
    "accel_z_m_s2",
    "theta_r_rad",
    "theta_p_rad",
    "torque_pitch_nm",
    "torque_roll_nm",
    "torque_stamp_s",
    "fix_stamp_s",
    "fix_x_m",
    "fix_y_m",
    "fix_sigma_m",
];

/// A log as it was read. Sound: every number finite, stamps growing, no gap longer than [`GAP_MAX`].
#[derive(Clone, Debug, PartialEq)]
pub struct Log {
    /// Sensor frames, oldest first; at least [`SAMPLES_MIN`].
    pub samples: Vec<Sample>,
    /// Torque commands, oldest first.
    pub torques: Vec<TorqueAt>,
}

/// One sensor frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sample {
    /// Since the first one [s].
    pub at: f64,
    /// Angular velocity of the frame, forward, left, up [rad/s].
    pub gyro: [f64; 3],
    /// Specific force, forward, left, up [m/s²].
    pub accel: [f64; 3],
    /// Angle of the roll motor, θ_r = β + q_r [rad].
    pub theta_r: f64,
    /// Angle of the pitch motor, θ_p = φ_s + α [rad].
    pub theta_p: f64,
}

/// Torques, and since when they were commanded.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TorqueAt {
    /// Since the first sensor frame, in the board's clock [s]; may be < 0.
    pub at: f64,
    /// The torques [N·m].
    pub torque: Torque,
}

/// Why a log cannot be used. Lines and columns count from 1.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum LogError {
    /// No line names the columns.
    #[error("it is empty: the first line must name the columns, {}", COLUMNS.join(","))]
    Empty,
    /// The first line lacks a column.
    #[error("line {line}: no column `{column}`{hint}")]
    Column {
        /// The line that names the columns.
        line: usize,
        /// The missing one.
        column: &'static str,
        /// The nearest that is there, as a sentence.
        hint: String,
    },
    /// A column is named twice.
    #[error("line {line}: column `{column}` is there twice")]
    Twice {
        /// The line that names the columns.
        line: usize,
        /// Which.
        column: &'static str,
    },
    /// A row of another length.
    #[error(
        "line {line}: {found} values instead of {expected}{}", if *.last { ": the log ends in the middle of it; delete this line" } else { "" }
    )]
    Width {
        /// The row.
        line: usize,
        /// How many values it has.
        found: usize,
        /// How many columns there are.
        expected: usize,
        /// It is the last line.
        last: bool,
    },
    /// A value that is no number, or is not finite.
    #[error("line {line}, column {column} ({name}): `{text}` must be a finite number")]
    Number {
        /// The row.
        line: usize,
        /// Which value of the row.
        column: usize,
        /// Name of the column.
        name: &'static str,
        /// What is there.
        text: String,
    },
    /// A value that no robot has.
    #[error("line {line}, column {column} ({name}): {value} is beyond ± {limit}: check the unit")]
    Beyond {
        /// The row.
        line: usize,
        /// Which value of the row.
        column: usize,
        /// Name of the column.
        name: &'static str,
        /// The value.
        value: f64,
        /// What is possible.
        limit: f64,
    },
    /// A stamp that is not later than the one before.
    #[error(
        "line {line}: stamp_s = {stamp} s is not later than {before} s in the row before: sort the rows, and cut the log where the board restarted"
    )]
    Order {
        /// The row.
        line: usize,
        /// Its stamp [s].
        stamp: f64,
        /// The stamp of the row before [s].
        before: f64,
    },
    /// Frames are missing.
    #[error(
        "line {line}: {gap:.3} s without a sensor frame, more than {GAP_MAX} s: keep the part before or after it, or record again"
    )]
    Gap {
        /// The row after the gap.
        line: usize,
        /// How long it is [s].
        gap: f64,
    },
    /// Too little of it.
    #[error(
        "{samples} sensor frames in {duration:.1} s: at least {SAMPLES_MIN} are needed, at {RATE_MIN} Hz or faster"
    )]
    Short {
        /// How many there are.
        samples: usize,
        /// From the first to the last [s].
        duration: f64,
    },
    /// The motors did nothing.
    #[error(
        "torque_pitch_nm and torque_roll_nm are zero or empty throughout: record while the motors drive the robot"
    )]
    NoTorque,
}

/// Longest time between two sensor frames [s]: over a longer one the motion between them is not known.
pub const GAP_MAX: f64 = 0.05;
/// Least number of sensor frames.
pub const SAMPLES_MIN: usize = 1000;
/// Least rate of sensor frames [Hz].
pub const RATE_MIN: f64 = 90.0;

/// Where the first optional column stands in [`COLUMNS`].
const OPTIONAL: usize = 11;
const TORQUE_PITCH: usize = 9;
const TORQUE_ROLL: usize = 10;
const TORQUE_STAMP: usize = 11;
/// What a value of each required column can be at most, in its unit: degrees for radians, or g for m/s², are noticed.
const LIMITS: [f64; 16] = [
    1e12, 35.0, 35.0, 35.0, 200.0, 200.0, 200.0, 1e6, 1e6, 200.0, 200.0, 1e12, 1e12, 1e7, 1e7, 1e7,
];

impl Log {
    /// Reads a log.
    ///
    /// # Errors
    /// The first thing that is wrong with it, with its line, and what to do.
    pub fn parse(text: &str) -> Result<Self, LogError> {
        let mut lines = text
            .lines()
            .enumerate()
            .map(|(index, line)| (index + 1, line.trim()))
            .filter(|(_, line)| !line.is_empty() && !line.starts_with('#'))
            .peekable();
        let (head_line, head) = lines.next().ok_or(LogError::Empty)?;
        let columns = Columns::parse(head_line, head)?;
        let mut rows = Rows::default();
        while let Some((line, row)) = lines.next() {
            let last = lines.peek().is_none();
            rows.push(line, &columns.values(line, row, last)?)?;
        }
        rows.finish()
    }

    /// From the first sensor frame to the last [s].
    pub fn duration(&self) -> f64 {
        self.samples.last().map_or(0.0, |last| last.at)
    }
}

/// Where each known column stands in a row.
struct Columns {
    places: [Option<usize>; COLUMNS.len()],
    width: usize,
}

/// One row's values, by known column.
type Values = [Option<f64>; COLUMNS.len()];

impl Columns {
    fn parse(line: usize, head: &str) -> Result<Self, LogError> {
        let names: Vec<&str> = head.split(',').map(str::trim).collect();
        let mut places = [None; COLUMNS.len()];
        for (index, column) in COLUMNS.into_iter().enumerate() {
            let mut found = names
                .iter()
                .enumerate()
                .filter(|(_, name)| **name == column);
            places[index] = found.next().map(|(place, _)| place);
            if found.next().is_some() {
                return Err(LogError::Twice { line, column });
            }
            if places[index].is_none() && index < OPTIONAL {
                let hint = nearest(column, names.iter().copied());
                return Err(LogError::Column { line, column, hint });
            }
        }
        Ok(Self {
            places,
            width: names.len(),
        })
    }

    fn values(&self, line: usize, row: &str, last: bool) -> Result<Values, LogError> {
        let texts: Vec<&str> = row.split(',').map(str::trim).collect();
        if texts.len() != self.width {
            return Err(LogError::Width {
                line,
                found: texts.len(),
                expected: self.width,
                last,
            });
        }
        let mut values = [None; COLUMNS.len()];
        for (index, value) in values.iter_mut().enumerate() {
            let Some(place) = self.places[index] else {
                continue;
            };
            let (text, name, column) = (texts[place], COLUMNS[index], place + 1);
            // What may be missing may be empty.
            if text.is_empty() && index >= TORQUE_PITCH {
                continue;
            }
            let number = text.parse().ok().filter(|number: &f64| number.is_finite());
            let number = number.ok_or_else(|| LogError::Number {
                line,
                column,
                name,
                text: text.to_owned(),
            })?;
            let limit = LIMITS[index];
            if number.abs() > limit {
                return Err(LogError::Beyond {
                    line,
                    column,
                    name,
                    value: number,
                    limit,
                });
            }
            *value = Some(number);
        }
        Ok(values)
    }
}

#[derive(Default)]
struct Rows {
    first: Option<f64>,
    samples: Vec<Sample>,
    torques: Vec<TorqueAt>,
}

impl Rows {
    fn push(&mut self, line: usize, values: &Values) -> Result<(), LogError> {
        // Required columns always have a value.
        let value = |index: usize| values[index].unwrap_or_default();
        let stamp = value(0);
        let first = *self.first.get_or_insert(stamp);
        let at = stamp - first;
        if let Some(before) = self.samples.last() {
            let gap = at - before.at;
            if gap <= 0.0 {
                return Err(LogError::Order {
                    line,
                    stamp,
                    before: before.at + first,
                });
            }
            if gap > GAP_MAX {
                return Err(LogError::Gap { line, gap });
            }
        }
        self.samples.push(Sample {
            at,
            gyro: [value(1), value(2), value(3)],
            accel: [value(4), value(5), value(6)],
            theta_r: value(7),
            theta_p: value(8),
        });
        if let (Some(pitch), Some(roll)) = (values[TORQUE_PITCH], values[TORQUE_ROLL]) {
            let torque = TorqueAt {
                at: values[TORQUE_STAMP].map_or(at, |stamp| stamp - first),
                torque: Torque { pitch, roll },
            };
            match self.torques.last() {
                // The same command again, seen from a later frame.
                Some(known) if known.at >= torque.at || known.torque == torque.torque => {}
                _ => self.torques.push(torque),
            }
        }
        Ok(())
    }

    fn finish(self) -> Result<Log, LogError> {
        let log = Log {
            samples: self.samples,
            torques: self.torques,
        };
        let (samples, duration) = (log.samples.len(), log.duration());
        if samples < SAMPLES_MIN || ((samples - 1) as f64) < RATE_MIN * duration {
            return Err(LogError::Short { samples, duration });
        }
        if log.torques.iter().all(|t| t.torque == Torque::default()) {
            return Err(LogError::NoTorque);
        }
        Ok(log)
    }
}
