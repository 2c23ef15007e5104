//! The `[planner]` table.

use sphere_protocol::document::error::Read;
use sphere_protocol::document::table::{Named, Range, Table, empty, section};
use sphere_protocol::message::KNOTS_MAX;
use sphere_protocol::time::Span;

use crate::mpc::Solver;
use crate::settings::{Compensation, PlannerMode, PlannerSettings, Preset};

/// The settings in the table `planner` of `top`, as far as it has them.
///
/// # Errors
/// An unknown key or name, or a number outside its range.
pub fn planner(top: &Table<'_>) -> Read<PlannerSettings> {
    let empty = empty();
    let keys = [
        "preset",
        "mode",
        "horizon",
        "max_age_s",
        "compensation",
        "solver",
    ];
    let table = section(top, "planner", &keys, &empty)?;
    let preset = PlannerSettings::of(table.named_or("preset", Preset::Ours)?);
    let longest = i64::try_from(KNOTS_MAX).expect("a plan has few knots");
    let horizon = table.integer("horizon", 1, longest)?;
    let max_age = table.number("max_age_s", Range::positive(3600.0))?;
    Ok(PlannerSettings {
        preset: preset.preset,
        mode: table.named_or("mode", preset.mode)?,
        horizon: horizon.map_or(preset.horizon, |knots| {
            usize::try_from(knots).expect("checked to lie in 1..=KNOTS_MAX")
        }),
        max_age: max_age.map_or(preset.max_age, Span::from_secs_f64),
        compensation: table.named_or("compensation", preset.compensation)?,
        solver: table.named_or("solver", preset.solver)?,
    })
}

impl Named for Preset {
    const WHAT: &'static str = "planner preset";
    const NAMES: &'static [(&'static str, Self)] = &[("ours", Self::Ours), ("paper", Self::Paper)];
}

impl Named for PlannerMode {
    const WHAT: &'static str = "planner mode";
    const NAMES: &'static [(&'static str, Self)] = &[("lag", Self::Lag), ("paper", Self::Paper)];
}

impl Named for Compensation {
    const WHAT: &'static str = "compensation";
    const NAMES: &'static [(&'static str, Self)] = &[
        ("full", Self::Full),
        ("no-gains", Self::NoGains),
        ("naive", Self::Naive),
    ];
}

impl Named for Solver {
    const WHAT: &'static str = "solver";
    const NAMES: &'static [(&'static str, Self)] = &[
        ("auto", Self::Auto),
        ("riccati", Self::Riccati),
        ("clarabel", Self::Clarabel),
    ];
}
