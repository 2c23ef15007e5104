//! `sphere-sim run` as a person or a script meets it: exit codes, messages, JSON alone on standard output, and the folder of a run.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use serde_json::Value;

/// A folder of this test alone, empty.
fn folder(name: &str) -> PathBuf {
    let folder = PathBuf::from(env!("CARGO_TARGET_TMPDIR"))
        .join("cli")
        .join(name);
    let _ = fs::remove_dir_all(&folder);
    fs::create_dir_all(&folder).expect("the test's own folder");
    folder
}

fn sim(args: &[&str], at: &Path) -> Output {
    Command::new(env!("CARGO_BIN_EXE_sphere-sim"))
        .args(args)
        .current_dir(at)
        .output()
        .expect("the program was built")
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8(bytes.to_vec()).expect("text")
}

const SCENARIO: &str = "\
seed = 4
duration_s = 15.0
[network]
delay_ms = 50.0
jitter_ms = 10.0
loss = 0.05
[[robots]]
id = \"r1\"
mission = { kind = \"lemniscate\" }
";

/// Runs a scenario with `text` in place of [`SCENARIO`]: exit code, standard error.
fn refused(name: &str, scenario: &str, args: &[&str]) -> String {
    let folder = folder(name);
    fs::write(folder.join("s.toml"), scenario).expect("a file");
    let output = sim(&[&["run", "s.toml"], args].concat(), &folder);
    let message = text(&output.stderr);
    assert_eq!(output.status.code(), Some(2), "{name}: {message}");
    assert_eq!(text(&output.stdout), "", "{name}: nothing but the message");
    assert!(!message.contains("panicked"), "{name}: {message}");
    message
}

#[test]
fn bad_input_exits_with_2_and_one_message_that_says_where_and_what() {
    // DESIGN: "bad input: one message with file, line, key, value and remedy"; exit 2.
    for (name, scenario, args, expected) in [
        (
            "unknown_key",
            SCENARIO.replace("jitter_ms", "jiter_ms"),
            &[][..],
            &["s.toml:5", "network.jiter_ms", "jitter_ms"][..],
        ),
        (
            "wrong_type",
            SCENARIO.replace("15.0", "\"long\""),
            &[],
            &["s.toml:2", "duration_s", "long"],
        ),
        (
            "negative_duration",
            SCENARIO.replace("15.0", "-1.0"),
            &[],
            &["s.toml:2", "duration_s", "-1"],
        ),
        (
            "not_toml",
            SCENARIO.replace("[network]", "[network"),
            &[],
            &["s.toml:3"],
        ),
        (
            "no_such_robot",
            SCENARIO.replace("id = \"r1\"", "id = \"r1\"\nrobot = \"lui\""),
            &[],
            &["s.toml:9", "robot", "liu"],
        ),
        (
            "wild_id",
            SCENARIO.replace("r1", "r*"),
            &[],
            &["s.toml:8", "r*"],
        ),
        (
            "bad_set",
            SCENARIO.to_owned(),
            &["--set", "network.loss=1.5"],
            &["network.loss", "1.5"],
        ),
        (
            "bad_controller",
            format!("{SCENARIO}[[faults]]\nkind = \"station-crash\"\nat_s = 5.0\nfor_s = 1.0\n"),
            &["--set", "robots.0.roll_controller=nonsense"],
            &["nonsense"],
        ),
    ] {
        let message = refused(name, &scenario, args);
        println!("{message}");
        for part in expected {
            assert!(message.contains(part), "{name}: no `{part}` in: {message}");
        }
        assert_eq!(
            message.trim_end().lines().count(),
            1,
            "{name}: one message: {message}"
        );
    }
}

#[test]
fn a_missing_file_is_named() {
    // DESIGN: exit 2 for usage and input.
    let output = sim(&["run", "nowhere.toml"], &folder("missing"));
    assert_eq!(output.status.code(), Some(2));
    assert!(text(&output.stderr).contains("nowhere.toml"));
    for args in [&["run"][..], &["fly"], &["run", "s.toml", "--sed", "1"]] {
        let output = sim(args, &folder("usage"));
        assert_eq!(output.status.code(), Some(2), "{args:?}");
        assert!(!output.stderr.is_empty());
    }
}

#[test]
fn gains_that_cannot_be_stable_are_refused_with_the_numbers() {
    // Promise: "a gain set that violates E2-E4 is refused with the numbers".
    let folder = folder("gains");
    let liu = include_str!("../protocol/robots/liu.toml");
    let line = liu
        .lines()
        .skip_while(|line| *line != "[htsmc]")
        .find(|line| line.starts_with("a1"))
        .expect("the section has it");
    let wrong = line.replacen("value = ", "value = -", 1);
    fs::write(folder.join("mine.toml"), liu.replace(line, &wrong)).expect("a file");
    fs::write(
        folder.join("s.toml"),
        SCENARIO.replace("id = \"r1\"", "id = \"r1\"\nrobot = \"mine.toml\""),
    )
    .expect("a file");
    let output = sim(&["run", "s.toml"], &folder);
    let message = text(&output.stderr);
    println!("{message}");
    assert_eq!(output.status.code(), Some(2), "{message}");
    assert!(message.contains("a1") && message.contains('-'), "{message}");
}

/// What every robot's figures hold: DESIGN's list, which people script against.
const FIGURES: [&str; 27] = [
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
    "solver.riccati",
    "solver.clarabel",
    "solver.shifted",
    "solver.real_time",
    "solver.shed",
    "time_in_mode_s.tracking",
];

#[test]
fn json_is_alone_on_standard_output_with_every_figure() {
    // DESIGN: "with --json stdout is that JSON alone"; the keys of metrics.json.
    let folder = folder("json");
    fs::write(folder.join("s.toml"), SCENARIO).expect("a file");
    let output = sim(&["run", "s.toml", "--json"], &folder);
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    let metrics: Value = serde_json::from_slice(&output.stdout).expect("JSON and nothing else");
    for key in [
        "seed",
        "digest",
        "duration_s",
        "wall_s",
        "invariant_violations",
        "violations",
        "robots",
    ] {
        assert!(metrics.get(key).is_some(), "no {key}");
    }
    assert_eq!(metrics["seed"], 4);
    assert_eq!(metrics["digest"].as_str().map(str::len), Some(64));
    let robot = &metrics["robots"][0];
    for path in FIGURES {
        let found = path.split('.').try_fold(robot, |value, key| value.get(key));
        assert!(found.is_some(), "no {path} in {robot}");
    }
    assert!(robot["plans_adopted"].as_u64() > Some(50), "{robot}");
    // A run without --json prints no JSON, and says something.
    let output = sim(&["run", "s.toml"], &folder);
    assert_eq!(output.status.code(), Some(0));
    assert!(serde_json::from_slice::<Value>(&output.stdout).is_err());
    assert!(text(&output.stdout).contains("r1"));
}

#[test]
fn the_folder_of_a_run_replays_it() {
    // DESIGN: `--out` writes scenario.toml (as drawn: it replays the run), metrics.json, trace.csv, *.svg.
    let folder = folder("out");
    fs::write(folder.join("s.toml"), SCENARIO).expect("a file");
    let args = [
        "run",
        "s.toml",
        "--seed",
        "77",
        "--set",
        "network.loss=0.2",
        "--out",
        "result",
        "--json",
    ];
    let output = sim(&args, &folder);
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    let printed: Value = serde_json::from_slice(&output.stdout).expect("JSON");
    let result = folder.join("result");
    let written: Value =
        serde_json::from_str(&fs::read_to_string(result.join("metrics.json")).expect("written"))
            .expect("JSON");
    assert_eq!(printed, written);
    assert_eq!(printed["seed"], 77);
    let csv = fs::read_to_string(result.join("trace.csv")).expect("written");
    let header = csv.lines().next().expect("a header");
    assert!(header.starts_with("t_s,"), "{header}");
    // A row every 20 ms, and the header.
    assert_eq!(csv.lines().count(), 752);
    let plots: Vec<_> = fs::read_dir(&result)
        .expect("written")
        .map(|entry| entry.expect("readable").path())
        .filter(|path| path.extension().is_some_and(|ext| ext == "svg"))
        .collect();
    assert!(!plots.is_empty());
    for plot in plots {
        let svg = fs::read_to_string(&plot).expect("written");
        assert!(svg.trim_start().starts_with("<svg") && svg.trim_end().ends_with("</svg>"));
    }
    let again = sim(&["run", "scenario.toml", "--json"], &result);
    let again: Value = serde_json::from_slice(&again.stdout).expect("JSON");
    assert_eq!(again["digest"], printed["digest"]);
}
