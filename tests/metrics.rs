//! `metrics.json`, `trace.csv` and the digest, on signals whose figures are known beforehand.

use sphere_protocol::message::{Mode, PlanId};
use sphere_protocol::robot::RobotId;
use sphere_protocol::state::{RobotState, Setpoint, Torque};
use sphere_protocol::time::Span;
use sphere_sim::metrics::{
    RobotMetrics, RobotRecord, RollStep, RunMetrics, RunRecord, SolverCounts, Violation, quantile,
};
use sphere_sim::report;
use sphere_sim::trace::{COLUMNS, Pose, ROW_PERIOD, Reference, Row, Trace};

fn id(name: &str) -> RobotId {
    name.parse().expect("a valid id")
}

/// The row of `robot` at `index` periods: everything zero, reference at the origin, tracking.
fn row(robot: &str, index: i64) -> Row {
    Row {
        t: Span::from_nanos(index * ROW_PERIOD.as_nanos()),
        robot: id(robot),
        truth: RobotState::default(),
        reference: Some(Reference {
            pose: Some(Pose {
                x: 0.0,
                y: 0.0,
                heading: 0.0,
            }),
            v: 0.0,
            q_r: 0.0,
        }),
        estimate: RobotState::default(),
        setpoint: Setpoint::default(),
        command: None,
        torque_commanded: Torque::default(),
        torque_applied: Torque::default(),
        mode: Mode::Tracking,
        plan_age: None,
        playing: None,
        life: 0,
    }
}

/// A trace of one robot over `seconds`, each row edited at its time.
fn trace(seconds: i64, edit: impl Fn(f64, &mut Row)) -> Trace {
    let mut trace = Trace::new();
    for index in 0..seconds * 50 {
        let mut row = row("r1", index);
        edit(row.t.as_secs_f64(), &mut row);
        trace.push(row);
    }
    trace
}

fn record(robot: &str, mission_start_s: Option<f64>) -> RobotRecord {
    RobotRecord {
        robot: id(robot),
        mission_start: mission_start_s.map(Span::from_secs_f64),
        roll_step: None,
        plans_sent: 0,
        plans_adopted: 0,
        loop_delays: Vec::new(),
        bytes_up: 0,
        bytes_down: 0,
        solver: SolverCounts::default(),
    }
}

fn run(trace: &Trace, robots: &[RobotRecord]) -> RunMetrics {
    let run = RunRecord {
        seed: 7,
        duration: Span::from_millis(20_000),
        wall_s: 0.5,
        settle: Span::from_millis(10_000),
        violations: Vec::new(),
    };
    RunMetrics::new(trace, run, robots)
}

fn only(trace: &Trace, record: RobotRecord) -> RobotMetrics {
    run(trace, &[record]).robots.remove(0)
}

/// Fails unless both differ by less than `tolerance`: the means below run over a thousand rows in f64.
fn close(what: &str, actual: Option<f64>, expected: f64, tolerance: f64) {
    let actual = actual.unwrap_or_else(|| panic!("{what} is null"));
    assert!(
        (actual - expected).abs() <= tolerance,
        "{what}: {actual} instead of {expected}"
    );
}

#[test]
fn a_sine_of_position_error_has_its_amplitude_over_root_two() {
    // Five whole periods of 2 s in the 10 s after settling.
    let trace = trace(20, |t, row| {
        row.truth.y = 0.02 * (core::f64::consts::PI * t).sin();
    });
    let metrics = only(&trace, record("r1", Some(0.0)));
    close("rmse", metrics.position_rmse_m, 0.02 / 2f64.sqrt(), 1e-12);
    close("max", metrics.position_max_m, 0.02, 1e-12);
}

#[test]
fn settling_counts_from_the_missions_start_and_the_whole_metrics_from_there_too() {
    // 9 m off before the mission starts at 2 s, 1 m while it settles until 12 s, then 3 cm.
    let trace = trace(20, |t, row| {
        row.truth.x = match t {
            t if t < 2.0 => 9.0,
            t if t < 12.0 => 1.0,
            _ => 0.03,
        };
    });
    let metrics = only(&trace, record("r1", Some(2.0)));
    close("rmse", metrics.position_rmse_m, 0.03, 1e-15);
    close("max", metrics.position_max_m, 0.03, 0.0);
    close("all max", metrics.position_all_max_m, 1.0, 0.0);
    let all = ((500.0 + 400.0 * 0.03f64.powi(2)) / 900.0).sqrt();
    close("all rmse", metrics.position_all_rmse_m, all, 1e-12);
}

#[test]
fn heading_errors_wrap() {
    let trace = trace(20, |_, row| {
        row.truth.heading = 12.0 * core::f64::consts::PI + 0.1;
    });
    let metrics = only(&trace, record("r1", Some(0.0)));
    close("heading", metrics.heading_rmse_rad, 0.1, 1e-12);
}

#[test]
fn the_estimate_is_scored_against_the_truth() {
    let trace = trace(20, |t, row| {
        (row.truth.x, row.truth.y) = (t, 5.0);
        (row.estimate.x, row.estimate.y) = (t + 0.03, 5.04);
    });
    let metrics = only(&trace, record("r1", Some(0.0)));
    close("estimate", metrics.estimate_rmse_m, 0.05, 1e-12);
}

#[test]
fn roll_errors_are_in_degrees() {
    let trace = trace(20, |t, row| {
        // +3° and −1° in turns of 1 s.
        row.truth.q_r = if t.rem_euclid(2.0) < 1.0 { 3f64 } else { -1.0 }.to_radians();
    });
    let metrics = only(&trace, record("r1", Some(0.0)));
    close("mae", metrics.roll_mae_deg, 2.0, 1e-12);
    close("rmse", metrics.roll_rmse_deg, 5f64.sqrt(), 1e-12);
    assert_eq!((metrics.rise_time_s, metrics.settling_time_s), (None, None));
}

#[test]
fn a_ramp_to_ten_degrees_in_one_second_rises_in_one_and_settles_at_nine_tenths() {
    for sign in [1.0, -1.0] {
        let trace = trace(20, |t, row| {
            row.truth.q_r = sign * (10.0 * (t - 5.0).clamp(0.0, 1.0)).to_radians();
        });
        let mut record = record("r1", Some(0.0));
        record.roll_step = Some(RollStep {
            at: Span::from_millis(5000),
            from: 0.0,
            to: sign * 10f64.to_radians(),
            until: None,
        });
        let metrics = only(&trace, record);
        // One row is 20 ms: a threshold crossed between two rows counts at the later one.
        close("rise", metrics.rise_time_s, 1.0, 0.021);
        close("settling", metrics.settling_time_s, 0.9, 0.021);
    }
}

#[test]
fn a_roll_that_leaves_the_band_at_the_end_has_risen_and_not_settled() {
    let trace = trace(20, |t, row| {
        row.truth.q_r = if t < 19.98 { 10f64 } else { 12.0 }.to_radians();
    });
    let mut record = record("r1", Some(0.0));
    record.roll_step = Some(RollStep {
        at: Span::from_millis(5000),
        from: 0.0,
        to: 10f64.to_radians(),
        until: None,
    });
    let metrics = only(&trace, record.clone());
    close("rise", metrics.rise_time_s, 0.0, 0.0);
    assert_eq!(metrics.settling_time_s, None);
    // What comes after the next change is not of this step.
    record.roll_step.as_mut().expect("it was set").until = Some(Span::from_millis(19_980));
    close("settling", only(&trace, record).settling_time_s, 0.0, 0.0);
}

#[test]
fn what_does_not_apply_is_null() {
    // No reference, no plan, one robot, a mission that never began.
    let trace = trace(20, |_, row| row.reference = None);
    let json = run(&trace, &[record("r1", None)]).json();
    let json: serde_json::Value = serde_json::from_str(&json).expect("JSON");
    let robot = &json["robots"][0];
    for key in [
        "position_rmse_m",
        "position_max_m",
        "heading_rmse_rad",
        "position_all_rmse_m",
        "position_all_max_m",
        "estimate_rmse_m",
        "roll_rmse_deg",
        "roll_mae_deg",
        "rise_time_s",
        "settling_time_s",
        "plan_age_p50_s",
        "plan_age_p99_s",
        "loop_delay_p50_s",
        "min_separation_m",
    ] {
        assert_eq!(robot.get(key), Some(&serde_json::Value::Null), "{key}");
    }
    let too_short = only(&trace, record("r1", Some(15.0)));
    assert_eq!(too_short.estimate_rmse_m, None);
}

#[test]
fn the_json_has_the_documented_keys_and_no_others() {
    let trace = trace(20, |_, _| {});
    let json = run(&trace, &[record("r1", Some(0.0))]).json();
    let json: serde_json::Value = serde_json::from_str(&json).expect("JSON");
    let keys = |value: &serde_json::Value| {
        let mut keys: Vec<_> = value
            .as_object()
            .expect("an object")
            .keys()
            .cloned()
            .collect();
        keys.sort();
        keys
    };
    let mut expected = [
        "seed",
        "digest",
        "duration_s",
        "wall_s",
        "invariant_violations",
        "violations",
        "robots",
    ];
    expected.sort_unstable();
    assert_eq!(keys(&json), expected);
    let mut expected = [
        "id",
        "position_rmse_m",
        "position_max_m",
        "heading_rmse_rad",
        "position_all_rmse_m",
        "position_all_max_m",
        "estimate_rmse_m",
        "roll_rmse_deg",
        "roll_mae_deg",
        "rise_time_s",
        "settling_time_s",
        "time_in_mode_s",
        "plans_sent",
        "plans_adopted",
        "plan_age_p50_s",
        "plan_age_p99_s",
        "loop_delay_p50_s",
        "min_separation_m",
        "bytes_up",
        "bytes_down",
        "solver",
    ];
    expected.sort_unstable();
    assert_eq!(keys(&json["robots"][0]), expected);
    assert_eq!(
        keys(&json["robots"][0]["solver"]),
        ["clarabel", "real_time", "riccati", "shed", "shifted"]
    );
}

#[test]
fn modes_share_the_run_among_them() {
    let trace = trace(20, |t, row| {
        row.mode = if t < 3.0 { Mode::Idle } else { Mode::Tracking };
    });
    let metrics = only(&trace, record("r1", Some(3.0)));
    assert_eq!(metrics.time_in_mode_s["idle"], 3.0);
    assert_eq!(metrics.time_in_mode_s["tracking"], 17.0);
    assert_eq!(metrics.time_in_mode_s["fault"], 0.0);
    assert_eq!(metrics.time_in_mode_s.len(), 8);
}

#[test]
fn quantiles_are_samples_by_nearest_rank() {
    let hundred: Vec<f64> = (1..=100).rev().map(f64::from).collect();
    assert_eq!(quantile(&hundred, 0.5), Some(50.0));
    assert_eq!(quantile(&hundred, 0.99), Some(99.0));
    assert_eq!(quantile(&hundred, 1.0), Some(100.0));
    assert_eq!(quantile(&hundred, 0.0), Some(1.0));
    assert_eq!(quantile(&[3.0, 1.0], 0.5), Some(1.0));
    assert_eq!(quantile(&[], 0.5), None);
}

#[test]
fn plan_ages_and_loop_delays_are_quantiles_of_their_samples() {
    let trace = trace(20, |t, row| {
        // Before settling 9 s; then 100 ms, but 300 ms for the last 0.2 s of ten: 2 %.
        row.plan_age = Some(match t {
            t if t < 10.0 => Span::from_millis(9000),
            t if t < 19.79 => Span::from_millis(100),
            _ => Span::from_millis(300),
        });
    });
    let mut record = record("r1", Some(0.0));
    record.loop_delays = [30, 10, 20].map(Span::from_millis).to_vec();
    let metrics = only(&trace, record);
    close("age p50", metrics.plan_age_p50_s, 0.1, 1e-15);
    close("age p99", metrics.plan_age_p99_s, 0.3, 1e-15);
    close("loop", metrics.loop_delay_p50_s, 0.02, 1e-15);
}

#[test]
fn separation_is_the_closest_that_any_other_came() {
    let mut trace = Trace::new();
    for index in 0..100 {
        for (robot, x) in [("a", 0.0), ("b", 5.0 - 0.04 * index as f64), ("c", 20.0)] {
            let mut row = row(robot, index);
            row.truth.x = x;
            trace.push(row);
        }
    }
    let records = ["a", "b", "c"].map(|robot| record(robot, Some(0.0)));
    let metrics = run(&trace, &records);
    // b ends at 1.04 m: that far from a; c is 15 m from b at first.
    close("a", metrics.robots[0].min_separation_m, 1.04, 1e-12);
    close("b", metrics.robots[1].min_separation_m, 1.04, 1e-12);
    close("c", metrics.robots[2].min_separation_m, 15.0, 1e-12);
}

#[test]
fn the_digest_sees_the_last_bit_of_every_field_and_every_byte() {
    let one = |edit: &dyn Fn(&mut Row)| {
        let mut trace = Trace::new();
        let mut row = row("r1", 3);
        edit(&mut row);
        trace.push(row);
        trace
    };
    let plain = one(&|_| {});
    assert_eq!(plain.digest(), one(&|_| {}).digest());
    assert_eq!(plain.digest().len(), 64);
    let tiny = f64::MIN_POSITIVE;
    let edits: [&dyn Fn(&mut Row); 14] = [
        &|row| row.t = row.t + Span::from_nanos(1),
        &|row| row.robot = id("r2"),
        &|row| row.truth.alpha_rate = tiny,
        &|row| row.estimate.x = tiny,
        &|row| row.reference = None,
        &|row| row.reference.as_mut().expect("it has one").pose = None,
        &|row| row.setpoint.q_r_accel = tiny,
        &|row| row.command = Some(sphere_sim::trace::Command { v: 0.0, q_r: 0.0 }),
        &|row| row.torque_commanded.roll = tiny,
        &|row| row.torque_applied.pitch = tiny,
        &|row| row.mode = Mode::Holding,
        &|row| row.plan_age = Some(Span::ZERO),
        &|row| row.playing = Some(PlanId { epoch: 0, seq: 0 }),
        &|row| row.truth.x = -0.0,
    ];
    let mut digests: Vec<_> = edits.iter().map(|edit| one(edit).digest()).collect();
    digests.push(plain.digest());
    for (label, bytes) in [
        ("up", b"ab".as_slice()),
        ("up", b"a"),
        ("down", b"ab"),
        ("u", b"pab"),
    ] {
        let mut trace = plain.clone();
        trace.absorb(label, bytes);
        digests.push(trace.digest());
    }
    let count = digests.len();
    digests.sort();
    digests.dedup();
    assert_eq!(digests.len(), count, "two different traces share a digest");
}

#[test]
fn every_column_of_the_csv_has_a_header_and_a_cell() {
    let trace = trace(1, |t, row| {
        row.truth.x = t;
        row.reference = None;
    });
    let mut csv = Vec::new();
    trace.write_csv(&mut csv).expect("memory grows");
    let csv = String::from_utf8(csv).expect("text");
    let mut lines = csv.lines();
    let header: Vec<_> = lines.next().expect("a header").split(',').collect();
    assert_eq!(
        header,
        COLUMNS.iter().map(|column| column.name).collect::<Vec<_>>()
    );
    assert_eq!(lines.clone().count(), 50);
    let second: Vec<_> = lines.nth(1).expect("a row").split(',').collect();
    assert_eq!(second.len(), header.len());
    let cell = |name: &str| {
        second[header
            .iter()
            .position(|column| *column == name)
            .expect(name)]
    };
    assert_eq!(
        (cell("t_s"), cell("robot"), cell("mode")),
        ("0.020000", "r1", "tracking")
    );
    assert_eq!(
        (cell("true_x_m"), cell("reference_x_m"), cell("plan_seq")),
        ("0.020000", "", "")
    );
    for (index, column) in COLUMNS.iter().enumerate() {
        assert!(!column.meaning.is_empty(), "column {index}");
    }
}

#[test]
fn the_summary_is_aligned_plain_text_and_says_whether_invariants_held() {
    let trace = trace(20, |t, row| {
        row.truth.y = if t < 10.0 { 2.0 } else { 0.0123 }
    });
    let mut records = [record("r1", Some(0.0)), record("a-long-name", None)];
    records[0].plans_sent = 3;
    let mut metrics = run(&trace, &records);
    let text = report::summary(&metrics, Some("out"), false);
    println!("{text}");
    assert!(!text.contains('\x1b'));
    let lines: Vec<_> = text.lines().collect();
    let column = |needle: &str, line: &str| {
        line.find(needle)
            .map(|at| line[..at].chars().count() + needle.chars().count())
    };
    assert_eq!(column("RMSE mm", lines[0]), column("12.3", lines[1]));
    assert_eq!(
        column("RMSE mm", lines[0]),
        column("-", &lines[2].replace("a-long-name", "a long name"))
    );
    assert!(text.contains("out"));
    assert!(text.contains("every invariant held"));

    metrics.violations.push(Violation {
        rule: "finite".to_owned(),
        t_s: 3.0,
        robot: Some("r1".to_owned()),
        replay: "sphere-sim run out/scenario.toml".to_owned(),
    });
    metrics.invariant_violations = 1;
    let text = report::summary(&metrics, None, true);
    assert!(text.contains("1 INVARIANT BROKE"), "{text}");
    assert!(
        text.contains("r1 broke `finite`. Replay: sphere-sim run out/scenario.toml"),
        "{text}"
    );
    assert!(text.contains('\x1b'));
}
