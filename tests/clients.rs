//! docs/protocol.md is enough to write a client from: two in Python, with libraries that share no code with us, against live programs.
//!
//! Needs Python, so that `cargo test` leaves it out; `.ci/run` runs it: `FLEET_PYTHON=$(.ci/python) cargo test --release --test clients -- --ignored`.

#![allow(
    clippy::disallowed_methods,
    reason = "stands in for programs in real time"
)]

use std::io::{BufRead, BufReader};
use std::net::UdpSocket;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::Duration;

use serde_json::Value;
use sphere_protocol::mavlink::{AGENT, BOARD, FrameWriter, Heartbeat, TorqueCommand};
use sphere_protocol::message::Mode;
use sphere_protocol::state::Torque;
use sphere_protocol::time::Span;

#[test]
#[ignore = "needs Python: .ci/run has it"]
fn cbor2_and_pymavlink_read_the_golden_bytes() {
    let output = client("check_golden.py", &[]);
    assert!(output.status.success(), "{}", said(&output));
}

/// A copy of the motor links of two plants, whose agent here is this test.
#[test]
#[ignore = "needs Python: .ci/run has it"]
fn motor_link_is_decoded_from_its_mirror() {
    let [agent, board, mirror] = [free_ports(4), free_ports(4), free_ports(2)];
    let mut plants = Command::new(env!("CARGO_BIN_EXE_sphere-sim"));
    plants
        .args(["plants", "--robots", "2"])
        .args(["--agent-port", &agent.to_string()])
        .args(["--board-port", &board.to_string()])
        .args(["--mirror", &format!("127.0.0.1:{mirror}")])
        .stdout(Stdio::piped());
    let mut plants = Running::start(plants);
    let table = BufReader::new(plants.0.stdout.take().expect("piped"));
    let ready = table.lines().map_while(Result::ok);
    assert!(
        ready.into_iter().any(|line| line.starts_with("Plants run")),
        "the plants did not start"
    );

    let ended = Arc::new(AtomicBool::new(false));
    let agents: Vec<_> = (0..2)
        .map(|robot| {
            let ended = ended.clone();
            let [from, to] = [agent + 2 * robot, board + 2 * robot];
            thread::spawn(move || command_torque(from, to, &ended))
        })
        .collect();
    let output = client(
        "motor_link.py",
        &[
            "--json",
            "--seconds",
            "3",
            "--robots",
            "2",
            "--port",
            &mirror.to_string(),
        ],
    );
    ended.store(true, Ordering::Relaxed);
    for agent in agents {
        agent.join().expect("no panic");
    }

    assert!(output.status.success(), "{}", said(&output));
    for (number, robot) in links(&output).iter().enumerate() {
        // 600 of either would be all of them; this machine may be busy.
        assert!(
            count(robot, "from_board", "SPHERE_SENSORS") > 150.0,
            "{robot}"
        );
        assert!(
            count(robot, "from_agent", "SPHERE_TORQUE") > 30.0,
            "{robot}"
        );
        assert!(
            count(robot, "from_board", "VISION_POSITION_ESTIMATE") > 5.0,
            "{robot}"
        );
        assert_eq!(robot["bad"], 0, "{robot}");
        let torque = &robot["newest"]["SPHERE_TORQUE"];
        assert_eq!(torque["torque_pitch"], 0.25);
        assert_eq!(torque["validity_ms"], 60);
        assert_eq!(
            robot["newest"]["HEARTBEAT"]["custom_mode"],
            Mode::Idle as u32
        );
        // The second robot stands 3 m along Y, which is north here.
        let north = robot["newest"]["VISION_POSITION_ESTIMATE"]["x"].as_f64();
        let north = north.expect("a number");
        assert!((north - 3.0 * number as f64).abs() < 0.2, "north {north} m");
    }
}

/// Both clients against the demo: every robot is seen, tracks and is planned for; every motor link speaks both ways.
#[test]
#[ignore = "needs Python: .ci/run has it"]
fn both_clients_see_every_robot_of_the_demo() {
    let mirror = free_ports(3);
    let out = Path::new(env!("CARGO_TARGET_TMPDIR")).join("clients-demo");
    let mut demo = Command::new(env!("CARGO_BIN_EXE_sphere-sim"));
    demo.args(["demo", "--duration", "60", "--out"])
        .arg(out)
        .args(["--mirror", &format!("127.0.0.1:{mirror}")])
        .stdout(Stdio::null())
        .stderr(Stdio::piped());
    let mut demo = Running::start(demo);
    let progress = BufReader::new(demo.0.stderr.take().expect("piped"));
    let mut lines = progress.lines().map_while(Result::ok);
    let endpoint = lines
        .find_map(|line| {
            let (_, rest) = line.split_once("Zenoh router at ")?;
            Some(rest.split_once(',')?.0.to_owned())
        })
        .expect("the demo says where its router listens");
    // Somebody must go on reading, or the demo waits for its pipe.
    let reader = thread::spawn(move || lines.for_each(drop));
    // Estimators settle for two seconds at rest; then the robots are armed and set out, 3 s after one another.
    thread::sleep(Duration::from_secs(13));

    let watch = client(
        "fleet_watch.py",
        &["--json", "--seconds", "4", "--connect", &endpoint],
    );
    let mirror = mirror.to_string();
    let links_of = client(
        "motor_link.py",
        &[
            "--json",
            "--seconds",
            "3",
            "--robots",
            "3",
            "--port",
            &mirror,
        ],
    );
    drop(demo);
    reader.join().expect("no panic");

    assert!(watch.status.success(), "{}", said(&watch));
    let fleet: Value = serde_json::from_slice(&watch.stdout).expect("JSON");
    assert_eq!(fleet["refused"], Value::Array(Vec::new()), "{fleet}");
    let robots = fleet["robots"].as_object().expect("robots by name");
    assert_eq!(robots.keys().collect::<Vec<_>>(), ["r1", "r2", "r3"]);
    for (id, robot) in robots {
        // On a busy machine a relay's stall may outlast a plan: then it holds, which is as it should be.
        let mode = robot["telemetry"]["mode"].as_str();
        assert!(
            matches!(mode, Some("tracking" | "holding")),
            "{id} is {mode:?}"
        );
        assert_eq!(
            robot["plan"]["u"].as_array().map(Vec::len),
            Some(20),
            "{id}"
        );
        assert_eq!(
            robot["plan"]["boot_id"], robot["telemetry"]["boot_id"],
            "{id}"
        );
        assert!(robot["beacon"]["radius"].as_f64() > Some(0.0), "{id}");
    }

    assert!(links_of.status.success(), "{}", said(&links_of));
    let links = links(&links_of);
    assert_eq!(links.len(), 3);
    for robot in &links {
        assert_eq!(robot["bad"], 0, "{robot}");
        assert_eq!(robot["newest"]["SPHERE_TORQUE"]["validity_ms"], 60);
    }
}

/// A program that ends with its owner.
struct Running(Child);

impl Running {
    fn start(mut command: Command) -> Self {
        Self(command.spawn().expect("cargo built it"))
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        // If it has ended by itself there is nothing to kill.
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// An agent that knows but one torque: 50 Hz on the motor link from port `from` to port `to`.
fn command_torque(from: u16, to: u16, ended: &AtomicBool) {
    let socket = UdpSocket::bind(("127.0.0.1", from)).expect("it was free");
    let mut writer = FrameWriter::new(AGENT);
    for sequence in 1.. {
        if ended.load(Ordering::Relaxed) {
            return;
        }
        let command = TorqueCommand {
            target: BOARD,
            sequence,
            torque: Torque {
                pitch: 0.25,
                roll: 0.0,
            },
            validity: Span::from_millis(60),
        };
        let frame = writer.torque(&command).expect("within range");
        socket.send_to(&frame, ("127.0.0.1", to)).expect("loopback");
        if sequence % 25 == 1 {
            let frame = writer.heartbeat(&Heartbeat::agent(Mode::Idle));
            socket.send_to(&frame, ("127.0.0.1", to)).expect("loopback");
        }
        thread::sleep(Duration::from_millis(20));
    }
}

/// Runs a script of examples/python to its end.
fn client(script: &str, arguments: &[&str]) -> Output {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let python = std::env::var_os("FLEET_PYTHON")
        .map_or_else(|| root.join("target/python/bin/python"), PathBuf::from);
    Command::new(&python)
        .arg(root.join("examples/python").join(script))
        .args(arguments)
        .output()
        .unwrap_or_else(|error| {
            panic!(
                "{}: {error}; run .ci/python, which makes this environment, or set FLEET_PYTHON to a Python that has \
                 examples/python/requirements.txt installed",
                python.display()
            )
        })
}

fn said(output: &Output) -> String {
    let [out, err] = [&output.stdout, &output.stderr].map(|text| String::from_utf8_lossy(text));
    format!("{}\n{out}\n{err}", output.status)
}

fn links(output: &Output) -> Vec<Value> {
    let seen: Value = serde_json::from_slice(&output.stdout).expect("JSON");
    seen["robots"].as_array().expect("one a link").clone()
}

fn count(robot: &Value, direction: &str, message: &str) -> f64 {
    robot[direction][message].as_f64().unwrap_or(0.0)
}

/// The first of `count` UDP ports in a row that are free now.
fn free_ports(count: u16) -> u16 {
    (0..100)
        .find_map(|_| {
            let first = UdpSocket::bind(("127.0.0.1", 0)).ok()?;
            let port = first.local_addr().ok()?.port();
            (1..count)
                .map(|i| UdpSocket::bind(("127.0.0.1", port.checked_add(i)?)).ok())
                .collect::<Option<Vec<_>>>()
                .map(|_| port)
        })
        .expect("free ports on loopback")
}
