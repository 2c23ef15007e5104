//! A station with more robots than it has time for: what it leaves out, for whom, and what that costs the robots.

use sphere_sim::metrics::{RobotMetrics, RunMetrics};
use sphere_sim::run::run;
use sphere_sim::scenario::Scenario;

const ROBOTS: usize = 20;

/// Twenty robots planned for on a computer on which each plan takes `plan_time_us`: with 5000, all of its time.
fn driven(plan_time_us: f64) -> RunMetrics {
    let mut text = format!(
        "duration_s = 40.0\n[network]\ndelay_ms = 50.0\njitter_ms = 10.0\n[station]\nplan_time_us = {plan_time_us:?}\n"
    );
    for i in 0..ROBOTS {
        let mission = ["line", "sine", "lemniscate"][i % 3];
        text += &format!("[[robots]]\nid = \"r{i}\"\nmission = {{ kind = \"{mission}\" }}\n");
    }
    let scenario = Scenario::parse("overload.toml", &text, &[], |path| {
        Err(format!("no file {path}"))
    })
    .expect("a valid scenario");
    run(&scenario, "", || 0.0).expect("stable gains").metrics
}

fn total(metrics: &RunMetrics, count: impl Fn(&RobotMetrics) -> u64) -> u64 {
    metrics.robots.iter().map(count).sum()
}

fn worst(metrics: &RunMetrics, of: impl Fn(&RobotMetrics) -> Option<f64>) -> f64 {
    let values = metrics
        .robots
        .iter()
        .map(|robot| of(robot).unwrap_or(f64::NAN));
    values.fold(0.0, |a: f64, b| if b.is_nan() { b } else { a.max(b) })
}

/// Every robot tracks from its start on, within `rmse` [m].
fn all_track(metrics: &RunMetrics, rmse: f64) {
    assert_eq!(metrics.violations, []);
    let found = worst(metrics, |robot| robot.position_rmse_m);
    assert!(found < rmse, "{found} m");
    for robot in &metrics.robots {
        let tracking = robot.time_in_mode_s["tracking"];
        assert!(
            tracking > metrics.duration_s - 4.0,
            "{}: {tracking} s",
            robot.id
        );
    }
}

#[test]
fn a_station_with_time_leaves_nothing_out() {
    let metrics = driven(4000.0);
    assert_eq!(total(&metrics, |robot| robot.solver.real_time), 0);
    assert_eq!(total(&metrics, |robot| robot.solver.shed), 0);
}

/// With half of the time that it takes, plans get one iteration each, and hardly any is left out.
#[test]
fn a_station_with_half_of_the_time_plans_by_one_iteration() {
    let metrics = driven(10_000.0);
    let sent = total(&metrics, |robot| robot.plans_sent);
    assert!(total(&metrics, |robot| robot.solver.real_time) > sent * 9 / 10);
    assert!(total(&metrics, |robot| robot.solver.shed) < sent / 100);
    all_track(&metrics, 0.010);
    let age = worst(&metrics, |robot| robot.plan_age_p99_s);
    assert!(age < 0.35, "{age}");
}

/// With a sixth, most ticks send the last plan again, within its validity; those who need a plan most get it, and every robot goes on.
#[test]
fn a_station_with_a_sixth_of_the_time_serves_those_in_danger() {
    let metrics = driven(30_000.0);
    let sent = total(&metrics, |robot| robot.plans_sent);
    assert!(total(&metrics, |robot| robot.solver.shed) > sent / 2);
    all_track(&metrics, 0.012);
    let age = worst(&metrics, |robot| robot.plan_age_p99_s);
    assert!(age < 1.5, "{age}");
}
