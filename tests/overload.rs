//! A station with more robots than it has time for: what it leaves out, for whom, and what that costs the robots.

use sphere_protocol::message::Mode;
use sphere_sim::metrics::{RobotMetrics, RunMetrics};
use sphere_sim::run::run;
use sphere_sim::scenario::Scenario;

const ROBOTS: usize = 20;

/// Twenty robots, far from one another, planned for on a computer on which each plan takes `plan_time_us`: with 5000, all of its time.
fn driven(plan_time_us: f64, more: &str) -> RunMetrics {
    let mut text = format!(
        "duration_s = 40.0\n[network]\ndelay_ms = 50.0\njitter_ms = 10.0\n[station]\nplan_time_us = {plan_time_us:?}\n"
    );
    for i in 0..ROBOTS {
        let (x, y) = (50 * (i % 5), 50 * (i / 5));
        let mission = ["line", "sine", "lemniscate"][i % 3];
        text += &format!(
            "[[robots]]\nid = \"r{i}\"\nstart = {{ x_m = {x}.0, y_m = {y}.0 }}\nmission = {{ kind = \"{mission}\" }}\n"
        );
        if i == PUSHED {
            text += more;
        }
    }
    let scenario = Scenario::parse("overload.toml", &text, &[], |path| {
        Err(format!("no file {path}"))
    })
    .expect("a valid scenario");
    run(&scenario, "", || 0.0).expect("stable gains").metrics
}

const PUSHED: usize = 3;

fn total(metrics: &RunMetrics, count: impl Fn(&RobotMetrics) -> u64) -> u64 {
    metrics.robots.iter().map(count).sum()
}

fn worst(metrics: &RunMetrics, of: impl Fn(&RobotMetrics) -> Option<f64>) -> f64 {
    let values = metrics.robots.iter().map(|robot| of(robot).expect("it rolled"));
    values.fold(0.0, f64::max)
}

/// Share of the time after the start for which every robot tracked.
fn tracking(metrics: &RunMetrics) -> f64 {
    let least = metrics
        .robots
        .iter()
        .map(|robot| robot.time_in_mode_s[&Mode::Tracking]);
    least.fold(f64::INFINITY, f64::min) / (metrics.duration_s - 4.0)
}

#[test]
fn a_station_with_time_leaves_nothing_out() {
    let metrics = driven(2000.0, "");
    assert_eq!(total(&metrics, |robot| robot.solver.real_time), 0);
    assert_eq!(total(&metrics, |robot| robot.solver.shed), 0);
    println!("{:.4}", worst(&metrics, |robot| robot.position_rmse_m));
}

#[test]
fn overload() {
    for us in [4000.0, 6000.0, 8000.0, 10_000.0, 15_000.0, 30_000.0, 60_000.0] {
        let metrics = driven(us, "");
        println!(
            "{us} µs: plans {} real-time {} shed {} failed; rmse {:.4} age p99 {:.2} tracking {:.3} violations {}",
            total(&metrics, |robot| robot.plans_sent),
            total(&metrics, |robot| robot.solver.real_time),
            total(&metrics, |robot| robot.solver.shed),
            worst(&metrics, |robot| robot.position_rmse_m),
            worst(&metrics, |robot| robot.plan_age_p99_s),
            tracking(&metrics),
            metrics.violations.len(),
        );
    }
}
