//! The figures of a run: `metrics.json`.
//!
//! The figures are those of [`crate::indicators`]. *Position error*: distance of the true centre from the reference. *Heading error*: true minus
//! reference, wrapped to ±π. *Roll error*: true minus reference. *After settling*: rows at least `settle_s` after the robot's
//! mission began; the plain names are taken there, the `*_all_*` ones from the mission's beginning on. Modes, separations and
//! counts are those of the whole run. A figure that does not apply, or has no rows to stand on, is `null`. Quantiles are
//! nearest-rank: the smallest value that at least the given share of the samples does not exceed.

use std::collections::BTreeMap;

use serde::Serialize;
use sphere_protocol::robot::RobotId;
use sphere_protocol::time::Span;

use crate::indicators::{
    SETTLING_BAND, Sample, largest, mean_absolute, rise_time, root_mean_square, settling_time,
    wrapped,
};
pub use crate::indicators::{Step as RollStep, quantile};
use crate::trace::{MODES, ROW_PERIOD, Row, Trace, mode_name};

/// What the world knows of a robot beside its trace.
#[derive(Clone, Debug)]
pub struct RobotRecord {
    /// Which robot.
    pub robot: RobotId,
    /// When its mission began, in virtual time since the start of the run; `None` if it never did.
    pub mission_start: Option<Span>,
    /// The step of a direction experiment [rad].
    pub roll_step: Option<RollStep>,
    /// Plans the station sent to it.
    pub plans_sent: u64,
    /// Plans its agent adopted.
    pub plans_adopted: u64,
    /// For each plan that arrived: arrival minus the stamp of the telemetry it was computed from.
    pub loop_delays: Vec<Span>,
    /// Bytes it sent, of all packets, lost ones too.
    pub bytes_up: u64,
    /// Bytes the station sent to it, lost ones too.
    pub bytes_down: u64,
    /// What made the plans sent.
    pub solver: SolverCounts,
}

/// How often each source made a plan.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default, Serialize)]
pub struct SolverCounts {
    /// The Riccati sweep.
    pub riccati: u64,
    /// Clarabel.
    pub clarabel: u64,
    /// Neither: the last plan, shifted.
    pub shifted: u64,
    /// One iteration only, because the station was over its time.
    pub real_time: u64,
    /// Of `shifted`: because the station was over its time.
    pub shed: u64,
}

/// `metrics.json`.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct RunMetrics {
    /// Seed of the run.
    pub seed: u64,
    /// SHA-256 over the trace and every wire byte, hexadecimal.
    pub digest: String,
    /// Virtual length of the run [s].
    pub duration_s: f64,
    /// Real time it took [s]; the one figure that differs from replay to replay.
    pub wall_s: f64,
    /// Number of `violations`.
    pub invariant_violations: usize,
    /// Invariants that broke.
    pub violations: Vec<Violation>,
    /// Figures of each robot.
    pub robots: Vec<RobotMetrics>,
    /// What only a run in real time has.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub live: Option<LiveMetrics>,
}

/// Figures of a run in real time: whether threads ran when they should, and what the links did.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct LiveMetrics {
    /// Where the station's router listened.
    pub endpoint: String,
    /// Steps of the plants that began more than 1 ms late and were made up for.
    pub plant_steps_late: u64,
    /// The latest beginning of a step of the plants [s].
    pub plant_lateness_max_s: f64,
    /// Figures of each robot.
    pub robots: Vec<LiveRobotMetrics>,
}

/// Figures of one robot in real time.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct LiveRobotMetrics {
    /// Its id.
    pub id: String,
    /// Control steps.
    pub control_steps: u64,
    /// Median lateness of a control step [s].
    pub control_lateness_p50_s: Option<f64>,
    /// 99 % quantile of that lateness [s].
    pub control_lateness_p99_s: Option<f64>,
    /// The latest control step [s].
    pub control_lateness_max_s: f64,
    /// Segments that its link carried, both ways.
    pub link_segments: u64,
    /// Of these: lost at least once, and with that late.
    pub link_stalls: u64,
}

/// An invariant that broke.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Violation {
    /// Name of the invariant.
    pub rule: String,
    /// When, in virtual time since the start of the run [s].
    pub t_s: f64,
    /// Whose; `null` if the fleet's.
    pub robot: Option<String>,
    /// The command that shows it again.
    pub replay: String,
}

/// Figures of one robot; see the module for the definitions.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct RobotMetrics {
    /// Its id.
    pub id: String,
    /// Root mean square position error after settling [m].
    pub position_rmse_m: Option<f64>,
    /// Largest position error after settling [m].
    pub position_max_m: Option<f64>,
    /// Root mean square heading error after settling [rad].
    pub heading_rmse_rad: Option<f64>,
    /// Root mean square position error of the whole mission [m].
    pub position_all_rmse_m: Option<f64>,
    /// Largest position error of the whole mission [m].
    pub position_all_max_m: Option<f64>,
    /// Root mean square distance of the estimated from the true centre after settling [m].
    pub estimate_rmse_m: Option<f64>,
    /// Root mean square roll error after settling [°].
    pub roll_rmse_deg: Option<f64>,
    /// Mean absolute roll error after settling [°].
    pub roll_mae_deg: Option<f64>,
    /// From a roll step to the first time the roll reaches its new value, as the paper counts it [s].
    pub rise_time_s: Option<f64>,
    /// From a roll step to the time from which the roll stays within ±1° of its new value [s].
    pub settling_time_s: Option<f64>,
    /// Time in each mode [s].
    pub time_in_mode_s: BTreeMap<&'static str, f64>,
    /// Plans the station sent.
    pub plans_sent: u64,
    /// Plans the agent adopted.
    pub plans_adopted: u64,
    /// Median age of the plan in play after settling [s].
    pub plan_age_p50_s: Option<f64>,
    /// 99 % quantile of that age [s].
    pub plan_age_p99_s: Option<f64>,
    /// Median of the whole loop's delay [s].
    pub loop_delay_p50_s: Option<f64>,
    /// Smallest distance of its centre from another robot's [m].
    pub min_separation_m: Option<f64>,
    /// Bytes it sent.
    pub bytes_up: u64,
    /// Bytes sent to it.
    pub bytes_down: u64,
    /// What made its plans.
    pub solver: SolverCounts,
}

/// What a run was, beside its robots.
#[derive(Clone, Debug)]
pub struct RunRecord {
    /// Seed of the run.
    pub seed: u64,
    /// Virtual length.
    pub duration: Span,
    /// Real time it took [s].
    pub wall_s: f64,
    /// Time from a mission's start after which the plain figures begin.
    pub settle: Span,
    /// Invariants that broke.
    pub violations: Vec<Violation>,
}

impl RunMetrics {
    /// The figures of the run that left `trace`.
    pub fn new(trace: &Trace, run: RunRecord, robots: &[RobotRecord]) -> Self {
        let separations = separations(trace.rows());
        Self {
            seed: run.seed,
            digest: trace.digest(),
            duration_s: run.duration.as_secs_f64(),
            wall_s: run.wall_s,
            invariant_violations: run.violations.len(),
            violations: run.violations,
            robots: robots
                .iter()
                .map(|record| {
                    let separation = separations.get(&record.robot).copied();
                    RobotMetrics::new(&trace.rows_of(record.robot), record, run.settle, separation)
                })
                .collect(),
            live: None,
        }
    }

    /// `metrics.json`.
    pub fn json(&self) -> String {
        let mut text = serde_json::to_string_pretty(self).expect("plain figures are always JSON");
        text.push('\n');
        text
    }
}

impl RobotMetrics {
    fn new(
        rows: &[&Row],
        record: &RobotRecord,
        settle: Span,
        min_separation_m: Option<f64>,
    ) -> Self {
        let since = |start: Option<Span>| {
            let first = start.map_or(rows.len(), |start| {
                rows.partition_point(|row| row.t < start)
            });
            &rows[first..]
        };
        let all = since(record.mission_start);
        let settled = since(record.mission_start.map(|start| start + settle));

        let positions = errors(settled, position_error);
        let positions_all = errors(all, position_error);
        let rolls = errors(settled, roll_error);
        let ages = errors(settled, |row| row.plan_age.map(Span::as_secs_f64));
        let delays: Vec<_> = record
            .loop_delays
            .iter()
            .map(|delay| delay.as_secs_f64())
            .collect();
        let roll = samples(rows, |row| Some(row.truth.q_r));
        let step = record.roll_step;

        Self {
            id: record.robot.to_string(),
            position_rmse_m: root_mean_square(&positions),
            position_max_m: largest(&positions),
            heading_rmse_rad: root_mean_square(&errors(settled, heading_error)),
            position_all_rmse_m: root_mean_square(&positions_all),
            position_all_max_m: largest(&positions_all),
            estimate_rmse_m: root_mean_square(&errors(settled, estimate_error)),
            roll_rmse_deg: root_mean_square(&rolls).map(f64::to_degrees),
            roll_mae_deg: mean_absolute(&rolls).map(f64::to_degrees),
            rise_time_s: step.and_then(|step| rise_time(&roll, &step)),
            settling_time_s: step.and_then(|step| settling_time(&roll, &step, SETTLING_BAND)),
            time_in_mode_s: time_in_mode(rows),
            plans_sent: record.plans_sent,
            plans_adopted: record.plans_adopted,
            plan_age_p50_s: quantile(&ages, 0.5),
            plan_age_p99_s: quantile(&ages, 0.99),
            loop_delay_p50_s: quantile(&delays, 0.5),
            min_separation_m,
            bytes_up: record.bytes_up,
            bytes_down: record.bytes_down,
            solver: record.solver,
        }
    }
}

/// Distance of the true centre from the reference [m].
pub fn position_error(row: &Row) -> Option<f64> {
    let pose = row.reference?.pose?;
    Some((row.truth.x - pose.x).hypot(row.truth.y - pose.y))
}

/// True minus reference heading, in −π..π [rad].
pub fn heading_error(row: &Row) -> Option<f64> {
    let pose = row.reference?.pose?;
    Some(wrapped(row.truth.heading - pose.heading))
}

/// True minus reference roll [rad].
pub fn roll_error(row: &Row) -> Option<f64> {
    Some(row.truth.q_r - row.reference?.q_r)
}

/// Distance of the estimated from the true centre [m].
pub fn estimate_error(row: &Row) -> Option<f64> {
    Some((row.truth.x - row.estimate.x).hypot(row.truth.y - row.estimate.y))
}

/// What `value` gives of each row that has it, with the row's time.
pub fn samples(rows: &[&Row], value: impl Fn(&Row) -> Option<f64>) -> Vec<Sample> {
    let sample = |row: &&Row| value(row).map(|value| Sample { t: row.t, value });
    rows.iter().filter_map(sample).collect()
}

fn errors(rows: &[&Row], error: impl Fn(&Row) -> Option<f64>) -> Vec<f64> {
    rows.iter().filter_map(|row| error(row)).collect()
}

fn time_in_mode(rows: &[&Row]) -> BTreeMap<&'static str, f64> {
    let count = |mode| rows.iter().filter(|row| row.mode == mode).count();
    MODES
        .iter()
        .map(|mode| {
            let rows = i64::try_from(count(*mode)).expect("rows fit into memory");
            (
                mode_name(*mode),
                Span::from_nanos(rows * ROW_PERIOD.as_nanos()).as_secs_f64(),
            )
        })
        .collect()
}

/// Smallest distance of each robot's centre from any other's at one instant [m].
fn separations(rows: &[Row]) -> BTreeMap<RobotId, f64> {
    let mut smallest = BTreeMap::new();
    for instant in rows.chunk_by(|a, b| a.t == b.t) {
        for (index, one) in instant.iter().enumerate() {
            for other in &instant[index + 1..] {
                let distance = (one.truth.x - other.truth.x).hypot(one.truth.y - other.truth.y);
                for robot in [one.robot, other.robot] {
                    let smallest = smallest.entry(robot).or_insert(distance);
                    *smallest = smallest.min(distance);
                }
            }
        }
    }
    smallest
}
