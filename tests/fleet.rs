//! The whole loop in virtual time: the deployed station and agents, wire bytes, sensors, network and plant, against the bounds of
//! the project.

use sphere_protocol::message::Mode;
use sphere_protocol::time::Span;
use sphere_sim::metrics::RobotMetrics;
use sphere_sim::run::{Run, run};
use sphere_sim::scenario::Scenario;
use sphere_sim::trace::Row;
use sphere_sim::world::{MotorWay, World};

const SCENARIOS: [(&str, &str); 3] = [
    ("line", include_str!("../sim/scenarios/line.toml")),
    ("sine", include_str!("../sim/scenarios/sine.toml")),
    (
        "lemniscate",
        include_str!("../sim/scenarios/lemniscate.toml"),
    ),
];

/// What the project promises on an ideal network [m].
const IDEAL: f64 = 0.020;
/// And at 100 ± 20 ms with 10 % loss each way [m].
const DELAYED: f64 = 0.025;
const DELAY: [&str; 3] = [
    "network.delay_ms=100",
    "network.jitter_ms=20",
    "network.loss=0.1",
];

fn scenario(text: &str, sets: &[&str]) -> Scenario {
    let sets: Vec<_> = sets.iter().map(|set| (*set).to_owned()).collect();
    Scenario::parse("test.toml", text, &sets, |path| {
        Err(format!("no file {path}"))
    })
    .expect("a valid scenario")
}

fn drive(text: &str, sets: &[&str]) -> Run {
    run(&scenario(text, sets), "", || 0.0).expect("the gains are stable")
}

fn rmse(robot: &RobotMetrics) -> f64 {
    robot
        .position_rmse_m
        .expect("the mission lasted longer than it takes to settle")
}

fn print(name: &str, robot: &RobotMetrics) {
    let all = robot.position_all_rmse_m.expect("the mission began");
    let estimate = robot.estimate_rmse_m.expect("the mission began");
    println!(
        "{name}: position_rmse_m {:.4}, position_all_rmse_m {all:.4}, estimate_rmse_m {estimate:.4}",
        rmse(robot)
    );
}

#[test]
fn ideal_network_tracks_each_trajectory_within_20_mm() {
    // Promise: position_rmse_m ≤ 0.020 on an ideal network.
    for (name, text) in SCENARIOS {
        let run = drive(text, &[]);
        let robot = &run.metrics.robots[0];
        print(name, robot);
        assert!(rmse(robot) <= IDEAL, "{name}: {}", rmse(robot));
    }
}

#[test]
fn delay_and_loss_leave_each_trajectory_within_25_mm() {
    // The same: ≤ 0.025 at 100 ± 20 ms with 10 % loss each way.
    for (name, text) in SCENARIOS {
        let run = drive(text, &DELAY);
        let robot = &run.metrics.robots[0];
        print(name, robot);
        assert!(rmse(robot) <= DELAYED, "{name}: {}", rmse(robot));
        // Not for want of delay: commands are as old as the loop is long.
        assert!(
            robot.loop_delay_p50_s.expect("plans arrived") > 0.19,
            "{robot:?}"
        );
    }
}

/// Length of the true path [m].
fn path_length(rows: &[Row]) -> f64 {
    rows.windows(2)
        .map(|pair| (pair[1].truth.x - pair[0].truth.x).hypot(pair[1].truth.y - pair[0].truth.y))
        .sum()
}

/// Largest distance of the estimated from the true centre [m].
fn worst_estimate(rows: &[Row]) -> f64 {
    rows.iter()
        .map(|row| (row.estimate.x - row.truth.x).hypot(row.estimate.y - row.truth.y))
        .fold(0.0, f64::max)
}

#[test]
fn without_position_fixes_the_estimate_drifts_by_at_most_2_percent_of_the_path() {
    // Promise: "with position_fix_hz = 0 the estimate drifts (the truth does not leak) by ≤ 2 % of the path".
    for (name, text) in SCENARIOS {
        let blind = drive(text, &["sensing.position_fix_hz=0"]);
        let rows = blind.trace.rows();
        let (path, worst) = (path_length(rows), worst_estimate(rows));
        println!(
            "{name}: drifts by {worst:.3} m on {path:.1} m, {:.2} %",
            100.0 * worst / path
        );
        assert!(worst <= 0.02 * path, "{name}: {worst} m on {path} m");
    }
    // Dead reckoning starts without any error: it takes a way for its drift to pass the fixes' noise.
    let long = |fixes| {
        let run = drive(SCENARIOS[2].1, &["duration_s=300", fixes]);
        run.metrics.robots[0].estimate_rmse_m.expect("it drove")
    };
    let (blind, fixed) = (
        long("sensing.position_fix_hz=0"),
        long("sensing.position_fix_hz=10"),
    );
    println!("300 s: estimate_rmse_m {blind:.4} without, {fixed:.4} with fixes");
    assert!(blind > 2.0 * fixed, "{blind} without, {fixed} with fixes");
}

#[test]
fn a_radius_that_nobody_told_the_robot_shows_without_fixes_alone() {
    // A shell 1 % larger than believed: dead reckoning must be off by 1 % of the way, or it is no dead reckoning.
    let larger = "robots.0.plant={ scale = { r = 1.01 } }";
    let blind = drive(SCENARIOS[0].1, &["sensing.position_fix_hz=0", larger]);
    let rows = blind.trace.rows();
    let share = worst_estimate(rows) / path_length(rows);
    let fixed = drive(SCENARIOS[0].1, &[larger]);
    let rows = fixed.trace.rows();
    let corrected = worst_estimate(rows) / path_length(rows);
    println!(
        "off by {:.2} % of the path, with fixes by {:.2} %",
        100.0 * share,
        100.0 * corrected
    );
    assert!((0.008..=0.012).contains(&share), "{share}");
    // The filter believes its radius firmly: fixes hold the error where it is, they do not remove it.
    assert!(corrected < 0.7 * share, "{corrected}");
}

#[test]
fn clarabel_alone_drives_the_loop_within_the_same_bounds() {
    // `planner.solver = "clarabel"`: the whole loop within the same tracking bounds. Clarabel is slow: short runs.
    for (name, text) in SCENARIOS {
        for (network, bound) in [(&[][..], IDEAL), (&DELAY[..], DELAYED)] {
            let mut sets = vec!["planner.solver=\"clarabel\"", "duration_s=20"];
            sets.extend(network);
            let run = drive(text, &sets);
            let robot = &run.metrics.robots[0];
            print(name, robot);
            assert!(rmse(robot) <= bound, "{name}: {}", rmse(robot));
            assert_eq!(robot.solver.riccati, 0);
            assert!(robot.solver.clarabel > 100, "{:?}", robot.solver);
        }
    }
}

const THREE: &str = r#"
seed = 3
duration_s = 30.0
environment = "real"
[network]
delay_ms = 100.0
jitter_ms = 20.0
loss = 0.1
[[robots]]
id = "r1"
mission = { kind = "line" }
clock_offset_s = 50.0
[[robots]]
id = "r2"
start = { x_m = 12.0, heading_deg = 90.0 }
mission = { kind = "circle", radius_m = 12.0, speed_mps = 0.5 }
[[robots]]
id = "r3"
start = { x_m = 6.0, heading_deg = 90.0 }
mission = { kind = "circle", radius_m = 6.0, speed_mps = 0.4 }
clock_offset_s = -20.0
"#;

#[test]
fn three_robots_track_at_once() {
    // One station, three robots, delay and loss: each within the bound of one.
    let run = drive(THREE, &[]);
    assert_eq!(run.metrics.robots.len(), 3);
    for robot in &run.metrics.robots {
        print(&robot.id, robot);
        assert!(rmse(robot) <= DELAYED, "{}: {}", robot.id, rmse(robot));
    }
}

/// The rows of robot number `robot` after a run in which robot 0's motor link is cut for a second, or not.
fn rows_of(robot: usize, cut: bool, sets: &[&str]) -> Vec<Row> {
    let scenario = scenario(THREE, sets);
    let mut world = World::new(&scenario).expect("the gains are stable");
    if cut {
        world.tamper_with_motor_links(Box::new(|t, robot, way, bytes| {
            let t = t.as_secs_f64();
            if robot == 0 && way == MotorWay::ToAgent && (12.0..13.0).contains(&t) {
                bytes.clear();
            }
        }));
    }
    world.run_until(scenario.duration());
    let id = scenario.robots[robot].id;
    world
        .trace()
        .rows()
        .iter()
        .filter(|row| row.robot == id)
        .copied()
        .collect()
}

#[test]
fn what_happens_to_one_robot_leaves_the_others_rows_bit_identical() {
    // Random streams, links and planning phases are each robot's own.
    let undisturbed = rows_of(1, false, &[]);
    assert_eq!(undisturbed, rows_of(1, true, &[]), "robot 0 lost its board");
    let modes: Vec<_> = rows_of(0, true, &[]).iter().map(|row| row.mode).collect();
    assert!(modes.contains(&Mode::Fault), "it did");
    for set in [
        "robots.0.clock_offset_s=77",
        "robots.0.mission={ kind = \"hold\" }",
        "robots.0.disturbance={ pushes = [ { at_s = 15.0, roll_nm = 8.0, for_s = 0.5 } ] }",
        "robots.0.start={ y_m = 1.0 }",
    ] {
        assert_eq!(undisturbed, rows_of(1, false, &[set]), "{set}");
    }
}

#[test]
fn a_robot_pushed_hard_comes_back_to_its_path() {
    // Feedback, not playback: 8 N·m on the roll for half a second throw the robot off, and it returns.
    let push = "robots.0.disturbance={ pushes = [ { at_s = 20.0, roll_nm = 8.0, for_s = 0.5 } ] }";
    let run = drive(SCENARIOS[0].1, &[push]);
    let error = |from: i64, to: i64| {
        run.trace
            .rows()
            .iter()
            .filter(|row| row.t >= Span::from_millis(from) && row.t < Span::from_millis(to))
            .filter_map(|row| Some((row.truth, row.reference?.pose?)))
            .map(|(truth, pose)| (truth.x - pose.x).hypot(truth.y - pose.y))
            .fold(0.0, f64::max)
    };
    let (thrown, back) = (error(20_000, 24_000), error(35_000, 40_000));
    println!("thrown off by {thrown:.3} m, {back:.3} m after 15 s");
    assert!(thrown > 0.03, "the push did nothing: {thrown}");
    assert!(back <= IDEAL, "{back}");
}

/// Twenty seeds, three trajectories, three environments, three delays: half an hour of robot time each cell.
#[test]
#[ignore = "an ensemble for .ci/full: 540 runs"]
fn ensemble_over_seeds_keeps_the_bounds() {
    // The bounds are no property of seed 1: in `real`, every seed keeps them.
    let mut missed = Vec::new();
    println!(
        "environment, trajectory, delay: median, worst position_rmse_m; worst position_all_rmse_m"
    );
    for environment in ["ideal", "real", "calibrated"] {
        for (name, text) in SCENARIOS {
            for delay in [0, 100, 200] {
                let mut rows: Vec<(f64, f64, u64)> = (1..=20)
                    .map(|seed| {
                        let mut sets = vec![
                            format!("seed={seed}"),
                            format!("environment=\"{environment}\""),
                            format!("network.delay_ms={delay}"),
                        ];
                        if delay > 0 {
                            sets.push("network.jitter_ms=20".to_owned());
                            sets.push("network.loss=0.1".to_owned());
                        }
                        let sets: Vec<_> = sets.iter().map(String::as_str).collect();
                        let run = drive(text, &sets);
                        let robot = &run.metrics.robots[0];
                        // A mission that never began is the worst of all.
                        let figure = |figure: Option<f64>| figure.unwrap_or(f64::INFINITY);
                        (
                            figure(robot.position_rmse_m),
                            figure(robot.position_all_rmse_m),
                            seed,
                        )
                    })
                    .collect();
                rows.sort_by(|a, b| a.0.total_cmp(&b.0));
                let (worst, seed) = (rows[19].0, rows[19].2);
                let all = rows.iter().map(|row| row.1).fold(0.0, f64::max);
                println!(
                    "{environment:10} {name:10} {delay:3} ms: {:.4} {worst:.4} (seed {seed}); {all:.4}",
                    0.5 * (rows[9].0 + rows[10].0)
                );
                let bound = if delay == 0 { IDEAL } else { DELAYED };
                // 200 ms and the calibrated friction are beyond the promise, and reported.
                if environment != "calibrated" && delay <= 100 && worst > bound {
                    missed.push(format!(
                        "sphere-sim run sim/scenarios/{name}.toml --seed {seed} --set environment={environment} --set network.delay_ms={delay}: {worst}"
                    ));
                }
            }
        }
    }
    assert!(missed.is_empty(), "{missed:#?}");
}
