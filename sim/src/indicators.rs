//! The figures by which a motion is judged, as pure functions of its samples. Each is defined here, once: `metrics.json`, the paper's
//! tables and whatever else counts one of them calls it.
//!
//! *Error* is true minus typed: the true roll minus the reference as the mission states it, never as a filter passes it on; the true
//! centre's distance from where the mission wants it at that time. Samples come every 20 ms. An event between two samples counts at
//! the later one. A figure without samples to stand on, or whose event never comes, is `None`.
//!
//! | paper | here | over |
//! |---|---|---|
//! | t_r | [`rise_time`] | from the step to the next change of the angle |
//! | t_s | [`settling_time`], band ±1° | the same |
//! | e_m | [`mean`] | the same: "from 5 s to the end", which are the step and the end of the turn |
//! | e_rmse, steady | [`root_mean_square`] | from 5 s after the step ([`STEADY_AFTER`]) to the next change |
//! | Δh | [`bounds`] | the same |
//! | e_mae, e_rmse | [`mean_absolute`], [`root_mean_square`] | from the mission's start to its end |
//!
//! The paper starts its steady state where "the envelope starts to remain basically horizontal", which two people read differently; a
//! fixed time they read alike. Its signed mean says whether an error has a side, not how large it is (E14).

use sphere_protocol::time::Span;

/// Half width of the band in which a step has settled [rad]: 1°.
pub const SETTLING_BAND: f64 = core::f64::consts::PI / 180.0;
/// From a step to its steady state. Every law that settles at all has done so.
pub const STEADY_AFTER: Span = Span::from_millis(5000);
/// A robot nearer than this to its reference has found it [m].
pub const FOUND: f64 = 0.1;

/// A value at a time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sample {
    /// When, since the start of the run.
    pub t: Span,
    /// The value, in the unit of the signal.
    pub value: f64,
}

/// A change of what is typed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Step {
    /// When, since the start of the run.
    pub at: Span,
    /// Value before.
    pub from: f64,
    /// Value after.
    pub to: f64,
    /// When it next changes, or the experiment ends; `None` = not.
    pub until: Option<Span>,
}

impl Step {
    /// The samples from the step to the next change.
    pub fn of<'a>(&self, samples: &'a [Sample]) -> &'a [Sample] {
        between(samples, self.at, self.until)
    }

    /// The samples of its steady state: from [`STEADY_AFTER`] to the next change.
    pub fn steady<'a>(&self, samples: &'a [Sample]) -> &'a [Sample] {
        between(samples, self.at + STEADY_AFTER, self.until)
    }
}

/// The samples with `from` ≤ t < `until`; without `until` to the last. Samples are in the order of time.
pub fn between(samples: &[Sample], from: Span, until: Option<Span>) -> &[Sample] {
    let before = |t: Span| samples.partition_point(|sample| sample.t < t);
    let last = until.map_or(samples.len(), before);
    &samples[before(from).min(last)..last]
}

/// The values of `samples`.
pub fn values(samples: &[Sample]) -> Vec<f64> {
    samples.iter().map(|sample| sample.value).collect()
}

/// t_r: from `step` to the first time that the signal reaches its new value, whatever comes then [s].
pub fn rise_time(signal: &[Sample], step: &Step) -> Option<f64> {
    let side = (step.to - step.from).signum();
    let reached = |sample: &&Sample| (sample.value - step.to) * side >= 0.0;
    let first = step.of(signal).iter().find(reached)?;
    Some((first.t - step.at).as_secs_f64())
}

/// t_s: from `step` to the time from which the signal stays within ±`band` of its new value until that changes [s].
pub fn settling_time(signal: &[Sample], step: &Step, band: f64) -> Option<f64> {
    let inside = |sample: &Sample| (sample.value - step.to).abs() <= band;
    stays_from(step.of(signal), inside).map(|t| (t - step.at).as_secs_f64())
}

/// From `begin` to the time from which the signal stays below `limit` to its end [s].
pub fn time_below(signal: &[Sample], begin: Span, limit: f64) -> Option<f64> {
    let inside = |sample: &Sample| sample.value < limit;
    stays_from(between(signal, begin, None), inside).map(|t| (t - begin).as_secs_f64())
}

/// e_m: the mean, with its sign. Of a signed error it is no measure of quality.
pub fn mean(errors: &[f64]) -> Option<f64> {
    (!errors.is_empty()).then(|| errors.iter().sum::<f64>() / errors.len() as f64)
}

/// e_mae: the mean of the absolute values.
pub fn mean_absolute(errors: &[f64]) -> Option<f64> {
    let sum: f64 = errors.iter().map(|error| error.abs()).sum();
    (!errors.is_empty()).then(|| sum / errors.len() as f64)
}

/// e_rmse: the root of the mean square.
pub fn root_mean_square(errors: &[f64]) -> Option<f64> {
    let squares: f64 = errors.iter().map(|error| error * error).sum();
    (!errors.is_empty()).then(|| (squares / errors.len() as f64).sqrt())
}

/// Δh: the lowest and the highest.
pub fn bounds(errors: &[f64]) -> Option<[f64; 2]> {
    let lowest = errors.iter().copied().min_by(f64::total_cmp)?;
    Some([lowest, largest(errors)?])
}

/// The highest.
pub fn largest(errors: &[f64]) -> Option<f64> {
    errors.iter().copied().max_by(f64::total_cmp)
}

/// Σ |x(k+1) − x(k)| over the time between the first and the last sample [unit of the signal / s].
///
/// Of a torque: how much a controller shakes its motor. A steady ±1 N·m at 1 Hz has 4 N·m/s.
pub fn variation_rate(signal: &[Sample]) -> Option<f64> {
    let [first, .., last] = signal else {
        return None;
    };
    let total: f64 = signal
        .windows(2)
        .map(|pair| (pair[1].value - pair[0].value).abs())
        .sum();
    let time = (last.t - first.t).as_secs_f64();
    (time > 0.0).then(|| total / time)
}

/// `angle` less whole turns, in −π..π [rad].
pub fn wrapped(angle: f64) -> f64 {
    use core::f64::consts::{PI, TAU};
    (angle + PI).rem_euclid(TAU) - PI
}

/// The smallest sample that at least the share `p` of `samples` does not exceed (nearest rank); `None` of none.
pub fn quantile(samples: &[f64], p: f64) -> Option<f64> {
    let mut sorted = samples.to_vec();
    sorted.sort_by(f64::total_cmp);
    let rank = (p * sorted.len() as f64).ceil().max(1.0) as usize;
    sorted.get(rank - 1).copied()
}

/// The time of the first sample from which on every one is `inside`.
fn stays_from(samples: &[Sample], inside: impl Fn(&Sample) -> bool) -> Option<Span> {
    let first = match samples.iter().rposition(|sample| !inside(sample)) {
        Some(last) => samples.get(last + 1),
        None => samples.first(),
    };
    first.map(|sample| sample.t)
}
