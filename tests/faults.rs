//! Faults of a scenario, each measured where it bites: on the wire, on board, in the modes. Virtual time, the deployed cores.

use sphere_protocol::message::Mode;
use sphere_protocol::robot::RobotId;
use sphere_sim::run::{Run, run};
use sphere_sim::scenario::Scenario;
use sphere_sim::trace::Row;

const TWO: &str = r#"
duration_s = 50.0
[network]
delay_ms = 60.0
jitter_ms = 10.0
[[robots]]
id = "r1"
mission = { kind = "sine" }
[[robots]]
id = "r2"
start = { y_m = -6.0 }
mission = { kind = "lemniscate" }
"#;

fn drive(sets: &[&str]) -> Run {
    let sets: Vec<String> = sets.iter().map(|set| (*set).to_owned()).collect();
    let scenario = Scenario::parse("two.toml", TWO, &sets, |path| Err(format!("no {path}")))
        .expect("a valid scenario");
    let run = run(&scenario, "", || 0.0).expect("the gains are stable");
    assert_eq!(run.metrics.violations, [], "{sets:?}");
    run
}

fn id(name: &str) -> RobotId {
    name.parse().expect("a robot id")
}

fn rows<'a>(run: &'a Run, name: &str) -> Vec<&'a Row> {
    run.trace.rows_of(id(name))
}

/// Times at which the robot goes from tracking to something else, and back [s].
fn interruptions(run: &Run, name: &str) -> Vec<(f64, f64)> {
    let rows = rows(run, name);
    let begin = rows
        .iter()
        .position(|row| row.mode == Mode::Tracking)
        .expect("it tracks");
    let mut found = Vec::new();
    let mut left = None;
    for row in &rows[begin..] {
        let t = row.t.as_secs_f64();
        match (row.mode == Mode::Tracking, left) {
            (false, None) => left = Some(t),
            (true, Some(since)) => {
                found.push((since, t));
                left = None;
            }
            _ => {}
        }
    }
    found.extend(left.map(|since| (since, f64::INFINITY)));
    found
}

/// Root mean square distance from the reference from `from` to `to` [s] in metres.
fn rmse(run: &Run, name: &str, from: f64, to: f64) -> f64 {
    let squares: Vec<f64> = rows(run, name)
        .iter()
        .filter(|row| (from..to).contains(&row.t.as_secs_f64()))
        .filter_map(|row| sphere_sim::metrics::position_error(row))
        .map(|error| error * error)
        .collect();
    (squares.iter().sum::<f64>() / squares.len() as f64).sqrt()
}

/// Every kind, with how long its robot may be out of tracking: from the fault's beginning, and after its end [s].
#[test]
fn each_fault_interrupts_what_it_must_and_tracking_resumes() {
    // A plan lasts 2 s; a station hears of a robot's new life with its next telemetry, and arms it once it is ready.
    for (fault, since_begin, after_end) in [
        (
            "network.partition=[{from_s=25,to_s=29,robots=['r1']}]",
            1.5,
            1.0,
        ),
        (
            "faults=[{kind='stale',at_s=25,for_s=4,robots=['r1']}]",
            1.5,
            1.0,
        ),
        (
            "faults=[{kind='agent-crash',at_s=25,for_s=4,robots=['r1']}]",
            0.0,
            6.0,
        ),
    ] {
        let run = drive(&[fault]);
        let interruptions = interruptions(&run, "r1");
        println!("{fault}: {interruptions:?}");
        // While its agent is gone the trace repeats its last word.
        let (left, back) = match fault.contains("agent-crash") {
            true => (29.0, interruptions.last().expect("it booted anew").1),
            false => {
                assert_eq!(interruptions.len(), 1, "{fault}");
                interruptions[0]
            }
        };
        assert!(left >= 25.0 + since_begin, "{fault}: left at {left}");
        assert!(left <= 29.0, "{fault}: left at {left}");
        assert!(back <= 29.0 + after_end, "{fault}: back at {back}");
        assert!(rmse(&run, "r1", 44.0, 50.0) < 0.02, "{fault}");
    }
}

#[test]
fn station_faults_stop_the_fleet_and_the_missions_go_on() {
    for fault in [
        "faults=[{kind='station-crash',at_s=25,for_s=4}]",
        "faults=[{kind='station-freeze',at_s=25,for_s=4}]",
    ] {
        let run = drive(&[fault]);
        for robot in ["r1", "r2"] {
            let interruptions = interruptions(&run, robot);
            println!("{fault}: {robot} {interruptions:?}");
            assert_eq!(interruptions.len(), 1, "{fault}");
            let (left, back) = interruptions[0];
            assert!((26.5..27.5).contains(&left), "{fault}: left at {left}");
            assert!(back <= 29.0 + 2.0, "{fault}: back at {back}");
            assert!(rmse(&run, robot, 42.0, 50.0) < 0.02, "{fault}");
        }
    }
}

/// A program that stands still for less than the torque's validity and the sensors' patience goes on; for longer, it faults and says so.
#[test]
fn a_frozen_agent_goes_on_or_faults() {
    let short = drive(&["faults=[{kind='freeze',at_s=25,for_s=0.1,robots=['r1']}]"]);
    assert_eq!(interruptions(&short, "r1"), []);
    let long = drive(&["faults=[{kind='freeze',at_s=25,for_s=3,robots=['r1']}]"]);
    let last = rows(&long, "r1").last().copied().expect("rows");
    assert_eq!(last.mode, Mode::Fault);
    assert!(last.torque_applied.roll.abs() < 1e-6);
    // The board takes the torque away by itself, 60 ms after the last command.
    for row in rows(&long, "r1") {
        if (25.2..50.0).contains(&row.t.as_secs_f64()) {
            // What is left of the motors' lag.
            let torque = row.torque_applied.pitch.abs();
            assert!(torque < 1e-6, "at {} s", row.t.as_secs_f64());
        }
    }
}

#[test]
fn nuisances_do_not_interrupt() {
    let free = drive(&[]);
    for fault in [
        "network.duplicate=0.5",
        "network.distribution='log-normal'",
        "network.bandwidth_kbps=200",
        "network.burst={mean_bad_s=0.5,mean_good_s=5.0}",
        "faults=[{kind='replay',at_s=5,for_s=45}]",
        "faults=[{kind='slow-planner',at_s=20,for_s=20}]",
    ] {
        let run = drive(&[fault]);
        assert_ne!(
            run.metrics.digest, free.metrics.digest,
            "{fault} does nothing"
        );
        for robot in ["r1", "r2"] {
            // r2 begins 6 m beside its path.
            let rmse = rmse(&run, robot, 20.0, 50.0);
            println!("{fault}: {robot} {:.1} mm", 1e3 * rmse);
            assert_eq!(interruptions(&run, robot), [], "{fault}");
            assert!(rmse < 0.02, "{fault}: {rmse}");
        }
    }
}

/// No clock is synchronised, and none needs to be exact.
#[test]
fn drifting_clocks_change_the_error_by_less_than_2_percent() {
    // Another clock samples at other instants: a single run differs by 3 % from its twin, the mean of several by less.
    let settled = |sets: &[&str]| -> f64 {
        let seeds = ["seed=1", "seed=2", "seed=3", "seed=4", "seed=5", "seed=6"];
        let runs = seeds.map(|seed| drive(&[sets, &[seed]].concat()));
        runs.iter().map(|run| rmse(run, "r1", 15.0, 50.0)).sum()
    };
    let exact = settled(&[]);
    for ppm in ["200", "-200"] {
        let set = format!("robots.0.clock_drift_ppm={ppm}");
        let change = settled(&[&set, "robots.0.clock_offset_s=-1000"]) / exact - 1.0;
        println!("{ppm} ppm: {:+.2} %", 100.0 * change);
        assert!(change.abs() < 0.02, "{ppm} ppm: {change}");
    }
}

/// The links, agents and bodies of two robots share nothing but the station, whose planner keeps them apart.
#[test]
fn a_fault_confined_to_one_robot_leaves_the_other_bit_identical() {
    let free = drive(&[]);
    for fault in [
        "network.partition=[{from_s=20,to_s=24,robots=['r1']}]",
        "faults=[{kind='agent-crash',at_s=20,for_s=2,robots=['r1']}]",
        "faults=[{kind='freeze',at_s=20,for_s=2,robots=['r1']}]",
        "faults=[{kind='replay',at_s=20,for_s=5,robots=['r1']}]",
        "faults=[{kind='stale',at_s=20,for_s=5,robots=['r1']}]",
        "faults=[{kind='slow-planner',at_s=20,for_s=5,robots=['r1']}]",
        "robots.0.disturbance.random_nm=0.5",
        "robots.0.plant.scale.m=1.1",
    ] {
        let run = drive(&[fault]);
        assert_ne!(
            run.metrics.digest, free.metrics.digest,
            "{fault} does nothing"
        );
        assert!(rows(&run, "r2") == rows(&free, "r2"), "{fault} reaches r2");
    }
}
