//! Rules that one row of the trace, beside the one before it, shows broken: what a live run is held to as well.

use sphere_protocol::message::{Mode, PlanId};
use sphere_protocol::state::RobotState;

use super::Bounds;
use crate::trace::Row;

/// A rule: its name, and whether a row breaks it. `before` is the robot's row before it.
type Rule = (
    &'static str,
    fn(row: &Row, before: Option<&Row>, bounds: &Bounds) -> bool,
);

/// The names of the rules that `row` breaks.
pub(super) fn broken<'a>(
    row: &'a Row,
    before: Option<&'a Row>,
    bounds: &'a Bounds,
) -> impl Iterator<Item = &'static str> + 'a {
    let breaks = move |rule: &&Rule| rule.1(row, before, bounds);
    RULES.iter().filter(breaks).map(|(name, _)| *name)
}

/// The rules, each with what breaking it means.
const RULES: &[Rule] = &[
    ("finite", |row, _, _| !is_finite(row)),
    ("torque-limit", |row, _, bounds| {
        let limit = bounds.torque_max * (1.0 + 1e-9);
        [row.torque_commanded, row.torque_applied]
            .iter()
            .any(|t| t.pitch.abs() > limit || t.roll.abs() > limit)
    }),
    ("no-torque-unless-armed", |row, _, _| {
        let unarmed = matches!(
            row.mode,
            Mode::Boot | Mode::Disarmed | Mode::Ready | Mode::Fault
        );
        unarmed && (row.torque_commanded.pitch != 0.0 || row.torque_commanded.roll != 0.0)
    }),
    ("upright", |row, _, _| {
        row.truth.q_r.abs() > UPRIGHT_ROLL
            || row.truth.alpha.abs().max(row.truth.beta.abs()) > UPRIGHT_SWING
    }),
    ("speed-limit", |row, _, bounds| {
        row.truth.v.abs() > bounds.speed_max() * (1.0 + SPEED_MARGIN)
    }),
    ("tracking-has-a-plan", |row, _, _| {
        (row.mode == Mode::Tracking) != row.playing.is_some()
    }),
    ("plan-is-valid", |row, _, bounds| {
        row.plan_age.is_some_and(|age| age > bounds.plan_age_max)
    }),
    ("plans-never-go-back", |row, before, _| {
        // An agent that has started anew counts from the beginning.
        let same_life = before.filter(|before| before.life == row.life);
        let last: Option<PlanId> = same_life.and_then(|before| before.playing);
        matches!((last, row.playing), (Some(last), Some(now)) if now < last)
    }),
];

/// Rules that bind whoever controls the robot.
pub(super) const NEED_CONTROL: [&str; 2] = ["upright", "speed-limit"];

/// Beyond these the robot has fallen over [rad]: where its agent gives it up (`Reason::OverTilt`).
const UPRIGHT_ROLL: f64 = 1.0;
const UPRIGHT_SWING: f64 = 1.4;
/// Overshoot of the speed over the highest command that the controllers are allowed [1].
const SPEED_MARGIN: f64 = 0.25;

fn is_finite(row: &Row) -> bool {
    let state = |s: &RobotState| {
        [
            s.x,
            s.y,
            s.heading,
            s.v,
            s.q_r,
            s.q_r_rate,
            s.beta,
            s.beta_rate,
            s.alpha,
            s.alpha_rate,
        ]
        .iter()
        .all(|value| value.is_finite())
    };
    let torques = [row.torque_commanded, row.torque_applied];
    state(&row.truth)
        && state(&row.estimate)
        && torques
            .iter()
            .all(|torque| torque.pitch.is_finite() && torque.roll.is_finite())
}
