//! The trace of a run: one [`Row`] for each robot every 20 ms of virtual time, its CSV, and the digest that tells runs apart.

use std::fmt::Write as _;
use std::io::{self, Write};

use sha2::{Digest, Sha256};
pub use sphere_ground::trajectory::Pose;
use sphere_ground::trajectory::ReferencePoint;
use sphere_protocol::message::{Mode, PlanId};
use sphere_protocol::robot::RobotId;
use sphere_protocol::state::{RobotState, Setpoint, Torque};
use sphere_protocol::time::Span;

/// Time between two rows of one robot: the period of the torque controllers.
pub const ROW_PERIOD: Span = Span::from_millis(20);

/// What one robot did at one instant.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Row {
    /// Virtual time since the start of the run.
    pub t: Span,
    /// Which robot.
    pub robot: RobotId,
    /// True state of the plant.
    pub truth: RobotState,
    /// What its mission asks for now; `None` without a mission.
    pub reference: Option<Reference>,
    /// State as its agent estimates it.
    pub estimate: RobotState,
    /// What its torque controllers track.
    pub setpoint: Setpoint,
    /// What its plan commands; `None` unless a plan is in play.
    pub command: Option<Command>,
    /// Torque the agent asked for last.
    pub torque_commanded: Torque,
    /// Torque the motors give, behind limit, delay and lag.
    pub torque_applied: Torque,
    /// Mode of its agent.
    pub mode: Mode,
    /// Age of the plan in play, counted from the telemetry it was computed from.
    pub plan_age: Option<Span>,
    /// The plan in play.
    pub playing: Option<PlanId>,
    /// How often its agent has started again.
    pub life: u32,
}

/// What a mission asks for at one instant.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Reference {
    /// Where to be; `None` where the mission is about speed and roll alone.
    pub pose: Option<Pose>,
    /// Speed [m/s].
    pub v: f64,
    /// Roll q_r [rad].
    pub q_r: f64,
}

/// What a plan commands at one instant, its feedback included.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Command {
    /// Speed command v_c [m/s].
    pub v: f64,
    /// Roll command q_c [rad].
    pub q_r: f64,
}

impl From<ReferencePoint> for Reference {
    fn from(point: ReferencePoint) -> Self {
        let ReferencePoint {
            x,
            y,
            heading,
            v,
            q_r,
            ..
        } = point;
        Self {
            pose: Some(Pose { x, y, heading }),
            v,
            q_r,
        }
    }
}

/// The rows of a run in the order of time, and the digest over them and every byte handed in.
#[derive(Clone, Debug, Default)]
pub struct Trace {
    rows: Vec<Row>,
    digest: Digester,
}

/// SHA-256 of what comes in pieces of a few bytes: they are gathered first, because each call of the hash costs as much as a block.
#[derive(Clone, Debug, Default)]
struct Digester {
    hash: Sha256,
    waiting: Vec<u8>,
}

/// Bytes gathered before they are hashed.
const GATHERED: usize = 4096;

impl Digester {
    fn update(&mut self, bytes: impl AsRef<[u8]>) {
        if self.waiting.len() >= GATHERED {
            self.hash.update(&self.waiting);
            self.waiting.clear();
        }
        self.waiting.extend_from_slice(bytes.as_ref());
    }

    /// The hash of everything so far, in hexadecimal.
    fn hexadecimal(&self) -> String {
        let hash = self.hash.clone().chain_update(&self.waiting).finalize();
        hash.iter()
            .fold(String::with_capacity(64), |mut hex, byte| {
                write!(hex, "{byte:02x}").expect("text grows");
                hex
            })
    }
}

impl Trace {
    /// A trace without rows.
    pub fn new() -> Self {
        Self::default()
    }

    /// Adds the next row, to the digest too. Rows come in the order of time, those of one instant side by side.
    pub fn push(&mut self, row: Row) {
        self.digest.update(b"row");
        row.hash(&mut self.digest);
        self.rows.push(row);
    }

    /// Adds bytes to the digest alone: a packet as it travelled. `label` says what they are, so that equal bytes sent
    /// elsewhere differ.
    pub fn absorb(&mut self, label: &str, bytes: &[u8]) {
        for part in [label.as_bytes(), bytes] {
            self.digest.update((part.len() as u64).to_le_bytes());
            self.digest.update(part);
        }
    }

    /// Every row.
    pub fn rows(&self) -> &[Row] {
        &self.rows
    }

    /// The rows of one robot.
    pub fn rows_of(&self, robot: RobotId) -> Vec<&Row> {
        self.rows.iter().filter(|row| row.robot == robot).collect()
    }

    /// SHA-256 over everything so far, in hexadecimal: two runs are the same if, and only if, it is the same.
    pub fn digest(&self) -> String {
        self.digest.hexadecimal()
    }

    /// Writes the rows as CSV with the columns of [`COLUMNS`]; what does not apply is empty.
    ///
    /// # Errors
    /// Those of `out`.
    pub fn write_csv(&self, out: &mut impl Write) -> io::Result<()> {
        for (index, column) in COLUMNS.iter().enumerate() {
            write!(out, "{}{}", if index == 0 { "" } else { "," }, column.name)?;
        }
        writeln!(out)?;
        for row in &self.rows {
            for (index, column) in COLUMNS.iter().enumerate() {
                if index > 0 {
                    out.write_all(b",")?;
                }
                match (column.value)(row) {
                    Cell::Number(number) => write!(out, "{number:.6}")?,
                    Cell::Count(count) => write!(out, "{count}")?,
                    Cell::Robot(robot) => write!(out, "{robot}")?,
                    Cell::Word(word) => out.write_all(word.as_bytes())?,
                    Cell::Empty => {}
                }
            }
            writeln!(out)?;
        }
        Ok(())
    }
}

impl Row {
    /// Whether every bit of it is `other`'s.
    pub fn is_identical(&self, other: &Self) -> bool {
        // Equal numbers have equal bits, but for a zero's sign and what is not a number at all: the digest then decides.
        let digest = |row: &Self| {
            let mut digest = Digester::default();
            row.hash(&mut digest);
            digest.waiting
        };
        digest(self) == digest(other)
    }

    /// Every bit of the row, so that a difference in the last place shows.
    fn hash(&self, digest: &mut Digester) {
        let robot = self.robot.as_str();
        digest.update([robot.len() as u8]);
        digest.update(robot);
        digest.update(self.t.as_nanos().to_le_bytes());
        digest.update([self.mode as u8]);
        digest.update(self.life.to_le_bytes());
        let mut numbers = |values: &[f64]| {
            digest.update([values.len() as u8]);
            for value in values {
                digest.update(value.to_bits().to_le_bytes());
            }
        };
        for state in [&self.truth, &self.estimate] {
            numbers(&[
                state.x,
                state.y,
                state.heading,
                state.v,
                state.q_r,
                state.q_r_rate,
                state.beta,
                state.beta_rate,
                state.alpha,
                state.alpha_rate,
            ]);
        }
        match self.reference {
            None => numbers(&[]),
            Some(Reference { pose: None, v, q_r }) => numbers(&[v, q_r]),
            Some(Reference {
                pose: Some(pose),
                v,
                q_r,
            }) => numbers(&[v, q_r, pose.x, pose.y, pose.heading]),
        }
        let Setpoint {
            v,
            v_rate,
            q_r,
            q_r_rate,
            q_r_accel,
        } = self.setpoint;
        numbers(&[v, v_rate, q_r, q_r_rate, q_r_accel]);
        match self.command {
            None => numbers(&[]),
            Some(command) => numbers(&[command.v, command.q_r]),
        }
        for torque in [self.torque_commanded, self.torque_applied] {
            numbers(&[torque.pitch, torque.roll]);
        }
        let playing = self
            .playing
            .map(|id| (u64::from(id.epoch) << 32) | u64::from(id.seq));
        for value in [
            self.plan_age.map(Span::as_nanos),
            playing.map(|id| id.cast_signed()),
        ] {
            digest.update([u8::from(value.is_some())]);
            digest.update(value.unwrap_or(0).to_le_bytes());
        }
    }
}

/// The mode's name in results: lower case.
pub const fn mode_name(mode: Mode) -> &'static str {
    match mode {
        Mode::Boot => "boot",
        Mode::Disarmed => "disarmed",
        Mode::Ready => "ready",
        Mode::Idle => "idle",
        Mode::Tracking => "tracking",
        Mode::Holding => "holding",
        Mode::Failsafe => "failsafe",
        Mode::Fault => "fault",
    }
}

/// Every mode, in the order of the wire.
pub const MODES: [Mode; 8] = [
    Mode::Boot,
    Mode::Disarmed,
    Mode::Ready,
    Mode::Idle,
    Mode::Tracking,
    Mode::Holding,
    Mode::Failsafe,
    Mode::Fault,
];

/// A column of `trace.csv`.
pub struct Column {
    /// Its header: the quantity and, last, its unit.
    pub name: &'static str,
    /// What it holds.
    pub meaning: &'static str,
    value: fn(&Row) -> Cell,
}

enum Cell {
    Number(f64),
    Count(u32),
    Robot(RobotId),
    Word(&'static str),
    Empty,
}

impl From<f64> for Cell {
    fn from(number: f64) -> Self {
        Self::Number(number)
    }
}

impl<T: Into<Cell>> From<Option<T>> for Cell {
    fn from(value: Option<T>) -> Self {
        value.map_or(Self::Empty, Into::into)
    }
}

const fn column(name: &'static str, meaning: &'static str, value: fn(&Row) -> Cell) -> Column {
    Column {
        name,
        meaning,
        value,
    }
}

fn pose(row: &Row) -> Option<Pose> {
    row.reference.and_then(|reference| reference.pose)
}

/// The columns of `trace.csv`, in their order.
pub const COLUMNS: &[Column] = &[
    column("t_s", "virtual time since the start of the run", |r| {
        r.t.as_secs_f64().into()
    }),
    column("robot", "id of the robot", |r| Cell::Robot(r.robot)),
    column("mode", "mode of the agent", |r| {
        Cell::Word(mode_name(r.mode))
    }),
    column("true_x_m", "true position of the centre, world X", |r| {
        r.truth.x.into()
    }),
    column("true_y_m", "true position of the centre, world Y", |r| {
        r.truth.y.into()
    }),
    column(
        "true_heading_rad",
        "true heading, positive to the left, unwrapped",
        |r| r.truth.heading.into(),
    ),
    column("true_v_mps", "true forward speed of the centre", |r| {
        r.truth.v.into()
    }),
    column(
        "true_roll_rad",
        "true roll of the frame, positive leans left",
        |r| r.truth.q_r.into(),
    ),
    column("true_roll_rate_radps", "rate of the true roll", |r| {
        r.truth.q_r_rate.into()
    }),
    column(
        "true_beta_rad",
        "true swing of the pendulum in roll, from the vertical",
        |r| r.truth.beta.into(),
    ),
    column("true_beta_rate_radps", "its rate", |r| {
        r.truth.beta_rate.into()
    }),
    column(
        "true_alpha_rad",
        "true swing of the pendulum in pitch, from the vertical",
        |r| r.truth.alpha.into(),
    ),
    column("true_alpha_rate_radps", "its rate", |r| {
        r.truth.alpha_rate.into()
    }),
    column(
        "reference_x_m",
        "where the mission wants the centre, world X",
        |r| pose(r).map(|p| p.x).into(),
    ),
    column(
        "reference_y_m",
        "where the mission wants the centre, world Y",
        |r| pose(r).map(|p| p.y).into(),
    ),
    column("reference_heading_rad", "the mission's heading", |r| {
        pose(r).map(|p| p.heading).into()
    }),
    column("reference_v_mps", "the mission's speed", |r| {
        r.reference.map(|p| p.v).into()
    }),
    column("reference_roll_rad", "the mission's roll", |r| {
        r.reference.map(|p| p.q_r).into()
    }),
    column(
        "estimate_x_m",
        "estimated position of the centre, world X",
        |r| r.estimate.x.into(),
    ),
    column(
        "estimate_y_m",
        "estimated position of the centre, world Y",
        |r| r.estimate.y.into(),
    ),
    column("estimate_heading_rad", "estimated heading", |r| {
        r.estimate.heading.into()
    }),
    column("estimate_v_mps", "estimated forward speed", |r| {
        r.estimate.v.into()
    }),
    column("estimate_roll_rad", "estimated roll", |r| {
        r.estimate.q_r.into()
    }),
    column("estimate_beta_rad", "estimated swing in roll", |r| {
        r.estimate.beta.into()
    }),
    column("estimate_alpha_rad", "estimated swing in pitch", |r| {
        r.estimate.alpha.into()
    }),
    column(
        "setpoint_v_mps",
        "speed the velocity controller follows, v_d",
        |r| r.setpoint.v.into(),
    ),
    column(
        "setpoint_roll_rad",
        "roll the direction controller follows, q_rd",
        |r| r.setpoint.q_r.into(),
    ),
    column(
        "command_v_mps",
        "speed command of the plan in play, v_c",
        |r| r.command.map(|c| c.v).into(),
    ),
    column(
        "command_roll_rad",
        "roll command of the plan in play, q_c",
        |r| r.command.map(|c| c.q_r).into(),
    ),
    column("torque_pitch_nm", "pitch torque the agent asked for", |r| {
        r.torque_commanded.pitch.into()
    }),
    column("torque_roll_nm", "roll torque the agent asked for", |r| {
        r.torque_commanded.roll.into()
    }),
    column("applied_pitch_nm", "pitch torque the motor gives", |r| {
        r.torque_applied.pitch.into()
    }),
    column("applied_roll_nm", "roll torque the motor gives", |r| {
        r.torque_applied.roll.into()
    }),
    column(
        "plan_age_s",
        "age of the plan in play, from its telemetry on",
        |r| r.plan_age.map(Span::as_secs_f64).into(),
    ),
    column("plan_epoch", "lease of the plan in play", |r| {
        r.playing.map_or(Cell::Empty, |id| Cell::Count(id.epoch))
    }),
    column("plan_seq", "number of the plan in play", |r| {
        r.playing.map_or(Cell::Empty, |id| Cell::Count(id.seq))
    }),
];
