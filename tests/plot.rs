//! Plots: well-formed, complete, and the same bytes for the same trace. `PLOT_DIR=folder` keeps them for a look.

use std::f64::consts::PI;

use sphere_protocol::message::{Mode, PlanId};
use sphere_protocol::robot::RobotId;
use sphere_protocol::state::{RobotState, Setpoint, Torque};
use sphere_protocol::time::Span;
use sphere_sim::plot::{Subject, plots};
use sphere_sim::trace::{Command, Pose, ROW_PERIOD, Reference, Row, Trace};

fn id(name: &str) -> RobotId {
    name.parse().expect("a valid id")
}

/// A robot that comes to the paper's lemniscate from beside it and follows it with ripple, in `seconds`.
fn lemniscate(robot: &str, seconds: i64, offset_m: f64) -> Vec<Row> {
    let mut rows = Vec::new();
    let mut heading = PI / 4.0;
    for index in 0..seconds * 50 {
        let t = index as f64 * 0.02;
        let place = |t: f64| {
            (
                8.0 * (t / 16.0).sin() + offset_m,
                8.0 * (t / 16.0).sin() * (t / 16.0).cos(),
            )
        };
        let ((x, y), (later_x, later_y)) = (place(t), place(t + 1e-3));
        let tangent = (later_y - y).atan2(later_x - x);
        heading += (tangent - heading + PI).rem_euclid(2.0 * PI) - PI;
        let v = (later_x - x).hypot(later_y - y) / 1e-3;
        let decay = (-t / 2.0).exp();
        let ripple = 0.006 * (2.9 * t).sin() + 0.003 * (0.7 * t).cos();
        let q_r = 0.12 * (t / 8.0).sin();
        let playing = t > 2.0 && !(60.0..62.0).contains(&t);
        let truth = RobotState {
            x: x - ripple * heading.sin(),
            y: y - 2.0 * decay + ripple * heading.cos(),
            heading: heading + 0.004 * (2.9 * t).cos() - 0.78 * decay,
            v: v * (1.0 - decay) + 0.01 * (5.0 * t).sin(),
            q_r: q_r + 0.2 * decay * (5.0 * t).sin() + 0.003 * (2.9 * t).sin(),
            beta: -0.5 * q_r,
            alpha: 0.03 + 0.2 * decay,
            ..RobotState::default()
        };
        let torque = |scale: f64| Torque {
            pitch: 2.0 + (30.0 * decay * (4.0 * t).sin()).clamp(-22.0, 18.0) + 0.3 * scale,
            roll: 6.0 * (t / 8.0).sin() + scale * (13.0 * t).sin(),
        };
        rows.push(Row {
            t: Span::from_nanos(index * ROW_PERIOD.as_nanos()),
            robot: id(robot),
            truth,
            reference: Some(Reference {
                pose: Some(Pose { x, y, heading }),
                v,
                q_r,
            }),
            estimate: truth,
            setpoint: Setpoint {
                v: v * (1.0 - decay),
                q_r,
                ..Setpoint::default()
            },
            command: playing.then_some(Command {
                v: v + 0.02 * (3.0 * t).sin(),
                q_r: q_r + 0.01 * (3.0 * t).cos(),
            }),
            torque_commanded: torque(1.0),
            torque_applied: torque(0.7),
            mode: match t {
                t if t < 0.5 => Mode::Boot,
                t if t < 1.0 => Mode::Ready,
                t if t < 2.0 => Mode::Idle,
                t if !(60.0..62.0).contains(&t) => Mode::Tracking,
                _ => Mode::Holding,
            },
            plan_age: playing.then(|| {
                Span::from_secs_f64(
                    0.2 + 0.1 * (t * 10.0).fract()
                        + if (60.0..63.0).contains(&t) { 1.0 } else { 0.0 },
                )
            }),
            playing: playing.then_some(PlanId { epoch: 1, seq: 7 }),
            life: 0,
        });
    }
    rows
}

fn subject(robot: &str) -> Subject<'_> {
    Subject {
        robot: id(robot),
        run: "lemniscate, 100 ms, 10 % loss",
        torque_max: 20.0,
        settled: Some(Span::from_millis(12_000)),
    }
}

/// Rows of several robots, instant by instant.
fn trace_of(robots: &[Vec<Row>]) -> Trace {
    let mut rows: Vec<_> = robots.iter().flatten().copied().collect();
    rows.sort_by_key(|row| row.t);
    let mut trace = Trace::new();
    rows.into_iter().for_each(|row| trace.push(row));
    trace
}

#[test]
fn every_robot_gets_five_plots_and_a_fleet_one_of_all_paths() {
    let trace = trace_of(&[lemniscate("r1", 110, 0.0), lemniscate("r2", 60, 12.0)]);
    let subjects = [subject("r1"), subject("r2")];
    let drawn = plots(&trace, &subjects).expect("plots");
    let names: Vec<_> = drawn.iter().map(|(name, _)| name.as_str()).collect();
    let of = |robot: &str| {
        ["path", "errors", "motion", "torque", "modes"].map(|plot| format!("{robot}-{plot}.svg"))
    };
    let mut expected: Vec<_> = of("r1").into_iter().chain(of("r2")).collect();
    expected.push("paths.svg".to_owned());
    assert_eq!(names, expected);
    for (name, svg) in &drawn {
        assert!(
            svg.starts_with("<svg width=\"960\"") && svg.trim_end().ends_with("</svg>"),
            "{name}"
        );
        assert!(!svg.contains("NaN") && !svg.contains("inf"), "{name}");
        assert!(svg.len() < 1_000_000, "{name} has {} bytes", svg.len());
    }
    assert!(drawn[2].1.contains("Speed [m/s]") && drawn[3].1.contains("limit"));
    assert_eq!(plots(&trace, &subjects).expect("plots"), drawn);
    if let Some(folder) = std::env::var_os("PLOT_DIR") {
        for (name, svg) in &drawn {
            std::fs::write(std::path::Path::new(&folder).join(name), svg)
                .expect("PLOT_DIR is writable");
        }
    }
}

#[test]
fn a_run_without_rows_references_or_finite_numbers_is_plotted_all_the_same() {
    let empty = plots(&Trace::new(), &[subject("r1")]).expect("empty plots");
    assert_eq!(empty.len(), 5);

    let mut rows = lemniscate("r1", 20, 0.0);
    for row in &mut rows {
        row.reference = None;
    }
    for row in &mut rows[500..] {
        row.truth.x = f64::NAN;
        row.truth.v = f64::INFINITY;
        row.torque_applied.roll = 1e300;
    }
    rows[200].truth.v = -1e300;
    for (name, svg) in plots(&trace_of(&[rows]), &[subject("r1")]).expect("plots of garbage") {
        assert!(!svg.contains("NaN"), "{name}");
    }
}

#[test]
fn names_are_escaped() {
    let trace = trace_of(&[lemniscate("r1", 2, 0.0)]);
    let mut subject = subject("r1");
    subject.run = "a<b&c";
    for (name, svg) in plots(&trace, &[subject]).expect("plots") {
        assert!(
            svg.contains("a&lt;b&amp;c") && !svg.contains("a<b"),
            "{name}"
        );
    }
}
