//! Same seed, same run, byte for byte; and clocks that show something else change nothing that counts.

use sphere_sim::run::{Run, run};
use sphere_sim::scenario::Scenario;

const TWO: &str = r#"
seed = 11
duration_s = 25.0
environment = "real"
[network]
delay_ms = 80.0
jitter_ms = 20.0
loss = 0.1
[[robots]]
id = "r1"
mission = { kind = "lemniscate" }
[[robots]]
id = "r2"
start = { x_m = 4.0, y_m = 9.0, heading_deg = 30.0 }
plant = { scale = { m = 1.05 } }
disturbance = { pushes = [ { at_s = 15.0, roll_nm = 3.0, for_s = 0.2 } ] }
mission = { kind = "circle", radius_m = 2.0, speed_mps = 0.6 }
"#;

fn read(text: &str, sets: &[&str]) -> Scenario {
    let sets: Vec<_> = sets.iter().map(|set| (*set).to_owned()).collect();
    Scenario::parse("two.toml", text, &sets, |path| {
        Err(format!("no file {path}"))
    })
    .expect("a valid scenario")
}

fn drive(sets: &[&str]) -> Run {
    run(&read(TWO, sets), "", || 0.0).expect("the gains are stable")
}

#[test]
fn same_seed_gives_the_same_digest() {
    // DESIGN: "same seed, same commit, same target: same trace, byte for byte". The digest covers every wire byte.
    let (one, two) = (drive(&[]), drive(&[]));
    assert_eq!(one.metrics.digest, two.metrics.digest);
    assert_eq!(one.trace.rows(), two.trace.rows());
}

#[test]
fn another_seed_gives_another_digest() {
    // And so does every other change, down to one that touches a clock alone.
    let base = drive(&[]).metrics.digest;
    for set in ["seed=12", "network.loss=0.11", "robots.1.clock_offset_s=1"] {
        assert_ne!(base, drive(&[set]).metrics.digest, "{set}");
    }
}

#[test]
fn a_scenario_as_drawn_replays_the_same_digest() {
    // `run --out` writes scenario.toml "as drawn: it replays the run".
    let sets = ["seed=5", "network.up.delay_ms=120", "sensing.noise=0.7"];
    let scenario = read(TWO, &sets);
    let first = run(&scenario, "", || 0.0).expect("the gains are stable");
    let again = run(&read(&scenario.drawn(), &[]), "", || 0.0).expect("the gains are stable");
    assert_eq!(first.metrics.digest, again.metrics.digest);
}

#[test]
fn a_clock_that_shows_a_thousand_seconds_more_changes_no_position_error() {
    // Promise: "a clock offset of 1000 s leaves the position errors equal to 1e-9". No clock is synchronised.
    let base = drive(&[]);
    for sets in [
        ["robots.0.clock_offset_s=1000", "robots.1.clock_offset_s=0"],
        [
            "robots.0.clock_offset_s=-1000",
            "robots.1.clock_offset_s=1000",
        ],
    ] {
        let moved = drive(&sets);
        for (a, b) in base.metrics.robots.iter().zip(&moved.metrics.robots) {
            for (a, b) in [
                (a.position_rmse_m, b.position_rmse_m),
                (a.position_max_m, b.position_max_m),
                (a.position_all_rmse_m, b.position_all_rmse_m),
                (a.position_all_max_m, b.position_all_max_m),
                (a.estimate_rmse_m, b.estimate_rmse_m),
            ] {
                let (a, b) = (a.expect("it drove"), b.expect("it drove"));
                assert!((a - b).abs() <= 1e-9, "{a} and {b}");
            }
        }
    }
}

#[test]
fn running_in_pieces_is_running_at_once() {
    // `run_until` stops between events and never inside one.
    let scenario = read(TWO, &["duration_s=8"]);
    let whole = run(&scenario, "", || 0.0).expect("the gains are stable");
    let mut world = sphere_sim::world::World::new(&scenario).expect("the gains are stable");
    for ms in (0..8000).step_by(7) {
        world.run_until(sphere_protocol::time::Span::from_millis(ms));
    }
    world.run_until(scenario.duration());
    assert_eq!(world.trace().digest(), whole.metrics.digest);
}
