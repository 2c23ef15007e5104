//! The files of agent and station: the examples are valid, together, and say the defaults; every mistake is named with its line.

use std::fs;
use std::path::Path;
use std::process::Command;

use sphere_agent::config::Timing;
use sphere_agent::config_file::AgentFile;
use sphere_agent::estimator::StartPose;
use sphere_ground::config_file::StationFile;
use sphere_ground::settings::PlannerSettings;
use sphere_ground::tasking::StartCondition;
use sphere_ground::trajectory::Mission;
use sphere_protocol::document::shared::{Endpoints, LogFormat};

fn example(name: &str) -> String {
    let path = Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("examples")
        .join(name);
    fs::read_to_string(&path).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
}

fn no_files(path: &str) -> Result<String, String> {
    Err(format!("no file {path}"))
}

fn agent(text: &str) -> Result<AgentFile, String> {
    AgentFile::parse("agent.toml", text, no_files).map_err(|error| error.to_string())
}

fn station(text: &str) -> Result<StationFile, String> {
    StationFile::parse("station.toml", text, no_files).map_err(|error| error.to_string())
}

/// The comments of examples/agent.toml promise the defaults.
#[test]
fn example_of_the_agent_states_the_defaults() {
    let file = agent(&example("agent.toml")).expect("the example is valid");
    assert_eq!(file.id.as_str(), "r1");
    assert_eq!(file.timing, Timing::default());
    let (said, default) = (file.start, StartPose::default());
    assert_eq!(
        (said.x, said.y, said.heading),
        (default.x, default.y, default.heading)
    );
    assert_eq!(said.position_sigma, default.position_sigma);
    assert!((said.heading_sigma - default.heading_sigma).abs() < 1e-12);
    assert_eq!(file.log, LogFormat::Human);
    let least = agent(
        "id = 'r1'\nrobot = 'liu'\n[motors]\nbind = '127.0.0.1:24600'\nboard = '127.0.0.1:24601'",
    )
    .expect("the required keys");
    assert_eq!(least.network, file.network);
    assert_eq!(least.motors, file.motors);
    assert_eq!(least.timing, file.timing);
}

/// The comments of examples/station.toml promise the defaults, and the two examples to work together.
#[test]
fn example_of_the_station_states_the_defaults_and_fits_the_agent() {
    let file = station(&example("station.toml")).expect("the example is valid");
    assert_eq!(file.planner, PlannerSettings::default());
    let least = station("[[robots]]\nid = 'r1'\nrobot = 'liu'").expect("the required keys");
    assert_eq!(least.network, file.network);
    assert_eq!(least.planner, file.planner);
    assert_eq!(least.station, None);
    assert_eq!(least.robots[0].mission, Mission::Hold);
    assert_eq!(least.robots[0].start, StartCondition::Ready);
    let agent = agent(&example("agent.toml")).expect("the example is valid");
    let (Endpoints::Connect(connect), Endpoints::Listen(listen)) = (agent.network, file.network)
    else {
        panic!("the agent connects, the station listens");
    };
    assert_eq!(connect, listen);
    assert_eq!(file.robots[0].id, agent.id);
    assert_eq!(file.robots[0].robot.name, agent.robot.name);
}

/// Promise: unknown keys refused with file, line, key and the nearest known one; wrong types, negative times, bad ids, unknown robots too.
#[test]
fn every_mistake_in_an_agents_file_is_named() {
    let good = example("agent.toml");
    let cases = [
        ("id = \"r1\"", "name = \"r1\"", ": name is an unknown key"),
        (
            "robot = \"liu\"",
            "robott = \"liu\"",
            "robott is an unknown key: did you mean `robot`?",
        ),
        (
            "robot = \"liu\"",
            "robot = \"lia\"",
            "robot = \"lia\": there is no such robot: did you mean `liu`?",
        ),
        (
            "robot = \"liu\"",
            "robot = \"mine.toml\"",
            "no file mine.toml",
        ),
        ("id = \"r1\"", "id = \"r/1\"", "contains `/`"),
        ("id = \"r1\"", "id = \"\"", "must not be empty"),
        ("id = \"r1\"", "id = 1", "id = 1: it must be text"),
        (
            "log = \"human\"",
            "log = \"jason\"",
            "there is no such log format: did you mean `json`?",
        ),
        (
            "control_ms = 20.0",
            "control_ms = -20.0",
            "timing.control_ms = -20.0: it must be from 5 to 100",
        ),
        (
            "control_ms = 20.0",
            "control_ms = \"20 ms\"",
            "it must be a number",
        ),
        (
            "control_ms = 20.0",
            "control_ms = nan",
            "it must be from 5 to 100",
        ),
        (
            "control_ms = 20.0",
            "control = 20.0",
            "timing.control is an unknown key: did you mean `control_ms`?",
        ),
        (
            "telemetry_ms = 40.0",
            "telemetry_ms = 50.0",
            "must be a multiple of control_ms",
        ),
        (
            "torque_validity_ms = 60.0",
            "torque_validity_ms = 30.0",
            "at least twice control_ms",
        ),
        (
            "board = \"127.0.0.1:24601\"",
            "board = \"here\"",
            "motors.board = \"here\": it must be an address and a port",
        ),
        (
            "board = \"127.0.0.1:24601\"",
            "board = \"127.0.0.1:24600\"",
            "the agent listens there itself",
        ),
        (
            "[\"tcp/127.0.0.1:7447\"]",
            "[\"127.0.0.1:7447\"]",
            "it has no protocol",
        ),
        (
            "[\"tcp/127.0.0.1:7447\"]",
            "[\"tcp/127.0.0.1\"]",
            "it has no host and port",
        ),
        ("[\"tcp/127.0.0.1:7447\"]", "[]", "at least one endpoint"),
        (
            "[\"tcp/127.0.0.1:7447\"]",
            "\"tcp/127.0.0.1:7447\"",
            "it must be a list",
        ),
        (
            "position_sigma_m = 0.02",
            "position_sigma_m = 0.0",
            "greater than 0",
        ),
        ("x_m = 0.0", "x_m = inf", "start.x_m"),
        ("[timing]", "[timing", "this is not TOML"),
    ];
    for (from, to, message) in cases {
        // The key of a case is at the beginning of a line, except where it stands for a value.
        let at = good
            .find(&format!("\n{from}"))
            .map_or_else(|| good.find(from).expect(from), |at| at + 1);
        let text = format!("{}{to}{}", &good[..at], &good[at + from.len()..]);
        let line = good[..at].matches('\n').count() + 1;
        let error = agent(&text).map(drop).expect_err(to);
        assert!(error.contains(message), "`{to}`: {error}");
        assert!(
            error.starts_with(&format!("agent.toml:{line}:")),
            "`{to}` is on line {line}: {error}"
        );
    }
    let missing = agent("robot = 'liu'").map(drop).expect_err("no id");
    assert!(
        missing.contains("id is missing: add `id = \"r1\"`"),
        "{missing}"
    );
}

#[test]
fn every_mistake_in_a_stations_file_is_named() {
    let robot = "[[robots]]\nid = 'r1'\nrobot = 'liu'\n";
    let cases = [
        (String::new(), "robots is missing"),
        (format!("{robot}{robot}"), "station.toml:4: robots.1"),
        (
            format!("station = 0\n{robot}"),
            "station = 0: it must be 1 or more",
        ),
        (
            format!("{robot}mission = 'line'"),
            "write { kind = \"line\" }",
        ),
        (
            format!("{robot}mission = {{ kind = 'lime' }}"),
            "did you mean `line`?",
        ),
        (
            format!("{robot}mission = {{ kind = 'roll', speed_mps = 0.5 }}"),
            "angles_deg",
        ),
        (
            format!("{robot}mission = {{ kind = 'roll', speed_mps = 0.5, angles_deg = [30] }}"),
            "a roll of 30.0° is above the 20.0° that this robot may have at this speed",
        ),
        (
            format!("{robot}mission = {{ kind = 'circle', radius_m = 0.01, speed_mps = 0.5 }}"),
            "tighter than this robot can turn",
        ),
        (
            format!("{robot}start_at_s = -1"),
            "robots.0.start_at_s = -1: it must be 0 or more",
        ),
        (
            format!("{robot}start = {{ x_m = 1 }}"),
            "robots.0.start is an unknown key",
        ),
        (
            format!("[planner]\nhorizont = 3\n{robot}"),
            "station.toml:2: planner.horizont is an unknown key: did you mean `horizon`?",
        ),
        (
            format!("[network]\nlisten = ['tcp/[::]:7447']\nconnect = ['tcp/a:1']\n{robot}"),
            "station.toml:3: network.connect",
        ),
    ];
    for (text, message) in cases {
        let error = station(&text).map(drop).expect_err(&text);
        assert!(error.contains(message), "{text}\n{error}");
    }
}

/// The programs say the same on standard error, and end with 2.
#[test]
fn programs_refuse_their_files_with_exit_code_2() {
    let folder =
        Path::new(env!("CARGO_TARGET_TMPDIR")).join(format!("config-{}", std::process::id()));
    fs::create_dir_all(&folder).expect("a folder for test files");
    let bad = folder.join("bad.toml");
    fs::write(&bad, "idd = 'r1'\n").expect("written");
    for (program, command, own) in [
        (env!("CARGO_BIN_EXE_sphere-agent"), "run", "agent.toml"),
        (env!("CARGO_BIN_EXE_sphere-ground"), "serve", "station.toml"),
    ] {
        let run = |arguments: &[&str]| {
            let output = Command::new(program)
                .args(arguments)
                .current_dir(&folder)
                .output()
                .expect("it was built with the test");
            (
                output.status.code(),
                String::from_utf8_lossy(&output.stderr).into_owned(),
            )
        };
        let (code, said) = run(&[command, "--config", "bad.toml"]);
        assert_eq!(code, Some(2), "{said}");
        assert!(said.contains("bad.toml:1: idd is an unknown key"), "{said}");
        let (code, said) = run(&[command]);
        assert_eq!(code, Some(2), "{said}");
        assert!(
            said.contains(own) && said.contains(&format!("examples/{own}")),
            "{said}"
        );
        let (code, said) = run(&[command, "--config", "absent.toml"]);
        assert_eq!(code, Some(2), "{said}");
        assert!(said.contains("absent.toml"), "{said}");
    }
    let (code, said) = {
        let output = Command::new(env!("CARGO_BIN_EXE_sphere-agent"))
            .current_dir(&folder)
            .output()
            .expect("it was built with the test");
        (
            output.status.code(),
            String::from_utf8_lossy(&output.stderr).into_owned(),
        )
    };
    assert_eq!(code, Some(2), "no argument is `run`: {said}");
    assert!(said.contains("agent.toml"), "{said}");
}
