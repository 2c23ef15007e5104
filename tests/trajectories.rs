//! Section IV-B of the paper: the reference trajectories, made drivable. Eq (1), errata E15 and E16.

use std::f64::consts::{FRAC_PI_4, PI, TAU};

use sphere_ground::trajectory::{Along, Mission, Pose, Reference, ReferencePoint, Trajectory};
use sphere_protocol::robot::Robot;

fn liu() -> Robot {
    Robot::embedded("liu").expect("embedded")
}

fn trajectory(mission: &Mission) -> Trajectory {
    Trajectory::new(mission, &liu(), Pose::default()).expect("drivable")
}

fn waypoints(points_m: &[[f64; 2]], speed_mps: f64) -> Mission {
    Mission::Waypoints {
        points_m: points_m.to_vec(),
        speed_mps,
    }
}

/// A fillet, a corner too near for one, a turn back, a point inside the turning circle.
fn crooked() -> Mission {
    waypoints(
        &[
            [0.0, 0.0],
            [5.0, 0.0],
            [9.0, 4.0],
            [9.0, 5.0],
            [8.2, 5.0],
            [3.0, 5.5],
            [8.0, 5.4],
        ],
        0.5,
    )
}

/// Every mission with the time over which to look at it [s].
fn missions() -> Vec<(&'static str, Mission, f64)> {
    let circle = Mission::Circle {
        radius_m: 2.0,
        speed_mps: 0.6,
    };
    vec![
        ("line", Mission::Line, 20.0),
        ("sine", Mission::Sine, 20.0 * PI),
        ("lemniscate", Mission::Lemniscate, 64.0 * PI),
        ("circle", circle, 60.0),
        ("waypoints", crooked(), 120.0),
        ("hold", Mission::Hold, 10.0),
    ]
}

/// (Ẋ, Ẏ, φ̇) of eq (1).
fn eq1(p: &ReferencePoint, heading: f64, r: f64) -> [f64; 3] {
    let (s, c) = heading.sin_cos();
    [
        p.v * c - r * p.q_r_rate * s,
        p.v * s + r * p.q_r_rate * c,
        p.v * p.q_r.tan() / r,
    ]
}

/// Eq (1) driven by the reference's own v, q_r, q̇_r from the reference's start ends where the reference is: 1e-9 is the integrator's
/// error (RK4 over up to 200 s) and rounding.
#[test]
fn references_obey_eq_1() {
    let r = liu().params.r;
    for (name, mission, until) in missions() {
        let trajectory = trajectory(&mission);
        let start = trajectory.reference(0.0);
        let mut pose = [start.x, start.y, start.heading];
        // The curvature of a way through points has kinks in its slope, where the integrator's error is only of order h².
        let h = if name == "waypoints" { 1e-4 } else { 1e-3 };
        let mut worst = 0.0_f64;
        for k in 0..(until / h).round() as usize {
            let t = k as f64 * h;
            let points = [0.0, 0.5 * h, h].map(|dt| trajectory.reference(t + dt));
            let k1 = eq1(&points[0], pose[2], r);
            let k2 = eq1(&points[1], pose[2] + 0.5 * h * k1[2], r);
            let k3 = eq1(&points[1], pose[2] + 0.5 * h * k2[2], r);
            let k4 = eq1(&points[2], pose[2] + h * k3[2], r);
            for j in 0..3 {
                pose[j] += h / 6.0 * (k1[j] + 2.0 * (k2[j] + k3[j]) + k4[j]);
            }
            let p = &points[2];
            let miss = (pose[0] - p.x)
                .hypot(pose[1] - p.y)
                .max((pose[2] - p.heading).abs());
            worst = worst.max(miss);
        }
        println!("{name}: {worst:.1e} m or rad after {until:.0} s");
        assert!(worst < 1e-9, "{name}: off by {worst:e}");
    }
}

/// The stated rates are the derivatives: central differences over 2 mm of time, error of order h² and rounding.
#[test]
fn rates_are_the_derivatives() {
    let h = 1e-3;
    for (name, mission, until) in missions() {
        let trajectory = trajectory(&mission);
        let mut worst = 0.0_f64;
        for k in 1..2000 {
            let t = until * f64::from(k) / 2000.0;
            let (a, p, b) = (
                trajectory.reference(t - h),
                trajectory.reference(t),
                trajectory.reference(t + h),
            );
            worst = worst
                .max((p.v_rate - (b.v - a.v) / (2.0 * h)).abs())
                .max((p.q_r_rate - (b.q_r - a.q_r) / (2.0 * h)).abs());
        }
        println!("{name}: {worst:.1e}");
        // The ramps of waypoints have steps in the jerk: h · 1.2 m/s³ there.
        let tolerance = if name == "waypoints" { 2e-3 } else { 1e-6 };
        assert!(worst < tolerance, "{name}: {worst:e}");
    }
}

/// What drivability costs: the reference's centre is beside the paper's curve by millimetres. The exact inverse of eq (1) is an
/// undamped oscillator at v/R, near the seventh harmonic of the sine: no reference that rolls gently follows that curve exactly.
#[test]
fn references_stay_on_the_papers_curves() {
    for (name, mission, until, bound) in [
        ("line", Mission::Line, 20.0, 1e-12),
        ("sine", Mission::Sine, 12.0 * PI, 5.1e-3),
        ("lemniscate", Mission::Lemniscate, 32.0 * PI, 7.1e-3),
    ] {
        let trajectory = trajectory(&mission);
        let (mut worst, mut square, mut tangent) = (0.0_f64, 0.0, 0.0_f64);
        let n = 20_000;
        for k in 0..n {
            let t = until * f64::from(k) / f64::from(n);
            let p = trajectory.reference(t);
            let s = t / 16.0;
            let (curve, slope) = match name {
                "line" => ([0.5 * t, 2.0], 0.0),
                "sine" => ([0.5 * t, 2.0 * (0.25 * t).sin()], (0.25 * t).cos().atan()),
                _ => (
                    [8.0 * s.sin(), 8.0 * s.sin() * s.cos()],
                    (2.0 * s).cos().atan2(s.cos()),
                ),
            };
            let miss = (p.x - curve[0]).hypot(p.y - curve[1]);
            worst = worst.max(miss);
            square += miss * miss / f64::from(n);
            let turn = p.heading - slope;
            tangent = tangent.max((turn - TAU * (turn / TAU).round()).abs());
            assert!((trajectory.nominal(t)[0] - curve[0]).abs() < 1e-12);
            assert!((trajectory.nominal(t)[1] - curve[1]).abs() < 1e-12);
        }
        println!(
            "{name}: rms {:.3} mm, max {:.3} mm, heading off the tangent {:.2} deg",
            square.sqrt() * 1e3,
            worst * 1e3,
            tangent.to_degrees()
        );
        assert!(worst < bound, "{name}: {worst} m");
        assert!(square.sqrt() < 2e-3, "{name}: {} m", square.sqrt());
        assert!(tangent < 0.1, "{name}: {tangent} rad");
    }
}

/// E16: the paper's heading wraps at 12π and 20π and is 0/0 at cos(t/16) = 0. Ours is finite and moves by less than 1 rad/s everywhere.
#[test]
fn heading_is_continuous_and_finite() {
    for mission in [Mission::Sine, Mission::Lemniscate] {
        let trajectory = trajectory(&mission);
        let (h, until) = (1e-3, 40.0 * PI);
        let mut before = trajectory.reference(0.0).heading;
        assert!((before - FRAC_PI_4).abs() < 0.1, "starts at 45°: {before}");
        for k in 1..(until / h) as usize {
            let p = trajectory.reference(k as f64 * h);
            let all = [p.x, p.y, p.heading, p.v, p.q_r, p.v_rate, p.q_r_rate];
            assert!(all.iter().all(|v| v.is_finite()), "{mission:?}: {p:?}");
            assert!(
                (p.heading - before).abs() < h,
                "{mission:?}: jump at {}",
                k as f64 * h
            );
            before = p.heading;
        }
        for t in [8.0 * PI, 12.0 * PI, 20.0 * PI, 24.0 * PI] {
            let (a, b) = (
                trajectory.reference(t - 1e-9),
                trajectory.reference(t + 1e-9),
            );
            assert!((a.heading - b.heading).abs() < 1e-8, "{mission:?} at {t}");
        }
    }
}

/// What a plan asks for alone, states without rates and commands without poses, is the reference to the last bit; before the start, over all
/// of it and after its end.
#[test]
fn parts_of_a_reference_are_the_reference() {
    let bits = |values: &[f64]| values.iter().map(|v| v.to_bits()).collect::<Vec<_>>();
    for (name, mission, until) in missions() {
        let trajectory = trajectory(&mission);
        let along = Along {
            trajectory: &trajectory,
            from: 1.7,
        };
        for k in -50..2000 {
            let t = until * f64::from(k) / 1900.0;
            let p = trajectory.reference(1.7 + t);
            let state = [p.x, p.y, p.heading, p.v, p.q_r];
            assert_eq!(along.point(t), p, "{name} at {t}");
            assert_eq!(bits(&along.state(t)), bits(&state), "{name} at {t}");
            let motion = along.motion(t);
            assert_eq!(
                bits(&[motion.v, motion.q_r, motion.v_rate, motion.q_r_rate]),
                bits(&[p.v, p.q_r, p.v_rate, p.q_r_rate]),
                "{name} at {t}"
            );
        }
    }
}

/// Mirror symmetry: half a period on, the sine is its own mirror image; a quarter on, the lemniscate is.
#[test]
fn mirrored_curves_have_mirrored_references() {
    let sine = trajectory(&Mission::Sine);
    for k in 0..100 {
        let t = f64::from(k) * 0.37;
        let (a, b) = (sine.reference(t), sine.reference(t + 4.0 * PI));
        for (x, y) in [
            (a.y, -b.y),
            (a.heading, -b.heading),
            (a.q_r, -b.q_r),
            (a.v, b.v),
            (a.q_r_rate, -b.q_r_rate),
        ] {
            assert!((x - y).abs() < 1e-12, "{t}: {a:?} {b:?}");
        }
    }
    // x → −x, t → −t … the lemniscate's second lobe is the first one mirrored and run from the crossing on: y(t + 16π) = y(t), x = −x.
    let lemniscate = trajectory(&Mission::Lemniscate);
    for k in 0..100 {
        let t = f64::from(k) * 0.5;
        let (a, b) = (lemniscate.reference(t), lemniscate.reference(t + 16.0 * PI));
        for (x, y) in [
            (a.x, -b.x),
            (a.y, b.y),
            (a.q_r, -b.q_r),
            (a.v, b.v),
            (a.v_rate, b.v_rate),
        ] {
            assert!((x - y).abs() < 1e-12, "{t}: {a:?} {b:?}");
        }
    }
}

/// The sine goes on for ever and the lemniscate repeats.
#[test]
fn sine_and_lemniscate_repeat() {
    for (mission, period, advance) in [
        (Mission::Sine, 8.0 * PI, 4.0 * PI),
        (Mission::Lemniscate, 32.0 * PI, 0.0),
    ] {
        let trajectory = trajectory(&mission);
        for k in 0..50 {
            let t = f64::from(k) * 0.9;
            let (a, b) = (trajectory.reference(t), trajectory.reference(t + period));
            assert!((a.x + advance - b.x).abs() < 1e-12 && (a.y - b.y).abs() < 1e-12);
            assert!((a.heading - b.heading).abs() < 1e-12);
        }
        assert_eq!(trajectory.duration(), None);
    }
}

/// Waypoints at several speeds and corners: roll, its command and the turn limit hold, the points are met, the end is at rest.
#[test]
fn waypoints_are_drivable_and_end_at_rest() {
    let robot = liu();
    let limits = robot.limits;
    let turn_limit = limits.turn_limit(&robot.params);
    let square = [[0.0, 0.0], [6.0, 0.0], [6.0, 6.0], [0.0, 6.0], [0.0, 0.0]];
    let small = [[0.0, 0.0], [2.0, 0.0], [2.0, 2.0], [0.0, 2.0], [0.0, 0.0]];
    let back = [[0.0, 0.0], [3.0, 0.0], [0.0, 0.0]];
    let short = [[0.0, 0.0], [0.1, 0.05]];
    let mut cases = vec![("crooked", crooked())];
    for speed in [0.2, 0.5, 1.0] {
        cases.push(("square", waypoints(&square, speed)));
        cases.push(("small", waypoints(&small, speed)));
        cases.push(("back", waypoints(&back, speed)));
        cases.push(("short", waypoints(&short, speed)));
    }
    for (name, mission) in cases {
        let Mission::Waypoints {
            points_m,
            speed_mps,
        } = &mission
        else {
            unreachable!("built as waypoints")
        };
        let trajectory = trajectory(&mission);
        let duration = trajectory.duration().expect("ends");
        let mut nearest = vec![f64::INFINITY; points_m.len()];
        let (mut roll, mut command, mut turn, mut accel, mut away) =
            (0.0_f64, 0.0_f64, 0.0_f64, 0.0_f64, 0.0_f64);
        let steps = (duration * 100.0).ceil() as usize + 200;
        let mut heading = trajectory.reference(-1.0).heading;
        for k in 0..=steps {
            let p = trajectory.reference(k as f64 * 0.01);
            roll = roll.max(p.q_r.abs());
            command = command.max(p.command(limits.reference_lag)[1].abs());
            turn = turn.max(p.q_r.abs().tan() * p.v * p.v);
            accel = accel.max(p.v_rate.abs());
            assert!(
                p.v <= speed_mps + 1e-12 && p.v >= 0.0,
                "{name}: v = {}",
                p.v
            );
            assert!(
                (p.heading - heading).abs() < 0.02,
                "{name}: heading jumps at {}",
                k as f64 * 0.01
            );
            heading = p.heading;
            let mut off = f64::INFINITY;
            for (near, q) in nearest.iter_mut().zip(points_m) {
                let d = (p.x - q[0]).hypot(p.y - q[1]);
                *near = near.min(d);
                off = off.min(d);
            }
            away = away.max(off);
        }
        let worst = nearest.iter().copied().fold(0.0, f64::max);
        println!(
            "{name} at {speed_mps} m/s: {duration:.1} s, roll {:.1} deg, command {:.1} deg, passes points within {worst:.2} m, strays {away:.1} m",
            roll.to_degrees(),
            command.to_degrees()
        );
        assert!(roll <= 0.86 * limits.q_r_max, "{name}: roll {roll}");
        assert!(command <= limits.q_r_max, "{name}: command {command}");
        assert!(turn <= turn_limit, "{name}: turn {turn}");
        assert!(accel <= 0.3 * 1.2, "{name}: accelerates at {accel}");
        assert!(worst < 0.8, "{name}: misses a point by {worst} m");
        let (end, last) = (
            trajectory.reference(duration + 5.0),
            points_m[points_m.len() - 1],
        );
        assert!(
            (end.x - last[0]).hypot(end.y - last[1]) < 1e-9,
            "{name}: ends at {end:?}"
        );
        assert!(
            end.v.abs() < 1e-12 && end.q_r.abs() < 1e-9 && end.v_rate == 0.0,
            "{name}: {end:?}"
        );
    }
}

/// A circle has the roll of its curvature; one too tight or too fast is refused with the remedy.
#[test]
fn circles_are_steady_and_within_limits() {
    let robot = liu();
    let circle = |radius_m, speed_mps| {
        Trajectory::new(
            &Mission::Circle {
                radius_m,
                speed_mps,
            },
            &robot,
            Pose::default(),
        )
    };
    let p = circle(2.0, 0.6).expect("drivable").reference(3.0);
    assert!((p.q_r.tan() - 0.35 / 2.0).abs() < 1e-15 && p.v_rate == 0.0 && p.q_r_rate == 0.0);
    assert!((p.x.hypot(p.y) - 2.0).abs() < 1e-12);
    let tight = circle(0.5, 0.3)
        .expect_err("20° of roll turn on 0.96 m")
        .to_string();
    assert!(tight.contains("0.96 m"), "{tight}");
    let fast = circle(5.0, 1.5).expect_err("1 m/s at most").to_string();
    assert!(fast.contains("v_max = 1"), "{fast}");
}

/// A mission that was built by hand and never read is refused, not laid out.
#[test]
fn impossible_waypoints_are_refused() {
    let robot = liu();
    for (points, speed) in [
        (&[][..], 0.5),
        (&[[0.0, 0.0]][..], 0.5),
        (&[[0.0, 0.0], [f64::NAN, 1.0]][..], 0.5),
        (&[[0.0, 0.0], [1.0, 1.0]][..], f64::NAN),
        (&[[0.0, 0.0], [1.0, 1.0]][..], 2.0),
    ] {
        let mission = waypoints(points, speed);
        assert!(
            Trajectory::new(&mission, &robot, Pose::default()).is_err(),
            "{mission:?}"
        );
    }
}

/// Built by hand a mission may hold anything: what no robot can do is named. Files are read in tests/config_files.rs.
#[test]
fn impossible_missions_are_named() {
    let circle = |radius_m, speed_mps| Mission::Circle {
        radius_m,
        speed_mps,
    };
    let roll = |speed_mps, angles: &[f64], hold_s| Mission::Roll {
        speed_mps,
        angles_deg: angles.to_vec(),
        hold_s,
    };
    let sine = |speed_mps, amplitude_deg| Mission::RollSine {
        speed_mps,
        amplitude_deg,
        rate_radps: 0.15,
        phase_rad: 0.0,
    };
    for (mission, names) in [
        (circle(-2.0, 0.5), "radius_m = -2"),
        (circle(2.0, 0.0), "speed_mps = 0"),
        (circle(f64::NAN, 0.5), "radius_m"),
        (waypoints(&[[0.0, 0.0]], 0.5), "at least 2"),
        (waypoints(&[[0.0, 0.0], [0.0, 0.0]], 0.5), "points_m[1]"),
        (
            waypoints(&[[0.0, 0.0], [f64::INFINITY, 0.0]], 0.5),
            "points_m[1]",
        ),
        (roll(0.5, &[], 5.0), "angles_deg"),
        (roll(0.5, &[f64::NAN], 5.0), "angles_deg"),
        (roll(0.5, &[10.0], 0.0), "hold_s"),
        (sine(f64::NAN, 10.0), "speed_mps"),
    ] {
        let error = mission.validated().expect_err(names).to_string();
        assert!(error.contains(names), "{names}: {error}");
    }
    for (mission, names) in [
        (roll(2.0, &[10.0], 5.0), "above the robot's v_max = 1 m/s"),
        (
            roll(0.5, &[0.0, -21.0], 5.0),
            "a roll of 21.0° is above the 20.0°",
        ),
        (sine(1.0, 30.0), "a roll of 30.0° is above the 20.0°"),
    ] {
        let error = Trajectory::new(&mission, &liu(), Pose::default()).expect_err(names);
        assert!(error.to_string().contains(names), "{names}: {error}");
    }
}

/// Direction experiments: what was typed, when it was typed.
#[test]
fn a_program_says_what_was_typed() {
    let mission = Mission::Roll {
        speed_mps: 0.5,
        angles_deg: vec![0.0, 10.0, -5.0],
        hold_s: 5.0,
    };
    let here = Pose {
        x: 3.0,
        ..Pose::default()
    };
    let steps = Trajectory::new(&mission, &liu(), here).expect("within limits");
    let program = steps.program().expect("typed");
    for (t, v, degrees) in [
        (-0.1, 0.0, 0.0_f64),
        (0.0, 0.5, 0.0),
        (4.999, 0.5, 0.0),
        (5.0, 0.5, 10.0),
        (10.0, 0.5, -5.0),
        (15.0, 0.0, 0.0),
    ] {
        assert_eq!(program.command(t), [v, degrees.to_radians()], "at {t} s");
        assert_eq!(steps.reference(t).x, 3.0);
    }
    assert_eq!(steps.duration(), Some(15.0));
    let first = program.first_step().expect("it has one");
    assert_eq!((first.at, first.until), (5.0, 10.0));
    assert_eq!((first.from, first.to), (0.0, 10_f64.to_radians()));

    let sine = Mission::RollSine {
        speed_mps: 0.5,
        amplitude_deg: 10.0,
        rate_radps: 0.15,
        phase_rad: -0.015,
    };
    let sine = Trajectory::new(&sine, &liu(), here).expect("within limits");
    let [v, q_r] = sine.program().expect("typed").command(10.0);
    // Eq (21).
    assert_eq!(v, 0.5);
    assert!((q_r.to_degrees() - 10.0 * (0.15 * 10.0 - 0.015_f64).sin()).abs() < 1e-12);
    assert_eq!(sine.duration(), None);
}
