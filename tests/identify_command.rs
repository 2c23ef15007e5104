//! `sphere-agent identify` as a program: its exit codes, and the whole path over UDP.

mod support {
    pub mod process;
}

use std::fs;
use std::io::{BufRead, BufReader};
use std::net::UdpSocket;
use std::path::Path;
use std::process::{Child, Command, Output, Stdio};
use std::sync::mpsc::{Receiver, channel};
use std::thread;
use std::time::{Duration, Instant};

use sphere_agent::identify::log::Log;
use sphere_protocol::robot::Robot;
use support::process::scratch;

const AGENT: &str = env!("CARGO_BIN_EXE_sphere-agent");
const SIM: &str = env!("CARGO_BIN_EXE_sphere-sim");

/// A child whose lines of standard error are read as they come. Dropping it kills it.
struct Running {
    child: Child,
    lines: Receiver<String>,
}

impl Running {
    fn start(command: &mut Command) -> Self {
        let mut child = command
            .env_remove("RUST_LOG")
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(Stdio::piped())
            .spawn()
            .expect("the program was built with the test");
        let stderr = BufReader::new(child.stderr.take().expect("piped"));
        let (said, lines) = channel();
        thread::spawn(move || {
            for line in stderr.lines().map_while(Result::ok) {
                println!("{line}");
                if said.send(line).is_err() {
                    return;
                }
            }
        });
        Self { child, lines }
    }

    fn says(&self, text: &str, limit: Duration) {
        let begin = Instant::now();
        loop {
            let left = limit.saturating_sub(begin.elapsed());
            let line = self.lines.recv_timeout(left);
            let line = line.unwrap_or_else(|_| panic!("did not say `{text}` within {limit:?}"));
            if line.contains(text) {
                return;
            }
        }
    }

    fn ends(&mut self, limit: Duration) -> i32 {
        let begin = Instant::now();
        loop {
            if let Some(status) = self.child.try_wait().expect("our child") {
                return status.code().expect("ended by itself");
            }
            assert!(begin.elapsed() < limit, "runs on");
            thread::sleep(Duration::from_millis(5));
        }
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// Two ports of UDP that are free now.
fn free_ports() -> [u16; 2] {
    let sockets = [(); 2].map(|()| UdpSocket::bind("127.0.0.1:0").expect("a free port"));
    sockets.map(|socket| socket.local_addr().expect("bound").port())
}

/// A simulated robot, and an agent that drives the manoeuvre on it and records to `log`.
fn driving(name: &str, log: &Path, more: &[&str]) -> (Running, Running) {
    let [agent, board] = free_ports();
    let plants = Running::start(Command::new(SIM).args([
        "plants",
        "--agent-port",
        &agent.to_string(),
        "--board-port",
        &board.to_string(),
    ]));
    let config = scratch(&format!("{name}.toml"));
    let text = format!(
        "id = 'r1'\nrobot = 'liu'\n[motors]\nbind = '127.0.0.1:{agent}'\nboard = '127.0.0.1:{board}'\n"
    );
    fs::write(&config, text).expect("a folder for test files");
    let agent = Running::start(
        Command::new(AGENT)
            .args(["identify", "--drive", "--config"])
            .arg(&config)
            .arg("--record")
            .arg(log)
            .args(more),
    );
    (plants, agent)
}

/// The driver claims, arms and drives; Ctrl-C ends it braking, with the log whole and no fit.
#[test]
fn interrupted_drive_brakes_and_keeps_its_log() {
    let log = scratch("interrupted.csv");
    let (_plants, mut agent) = driving("interrupted", &log, &[]);
    let limit = Duration::from_secs(15);
    agent.says("leased", limit);
    agent.says("to=Tracking", limit);
    agent.says("roll steps at rest", limit);
    // A log shorter than 5 s is refused; 2 s pass before.
    thread::sleep(Duration::from_secs(4));
    let killed = Command::new("kill")
        .args(["-INT", &agent.child.id().to_string()])
        .status();
    assert!(killed.expect("kill is part of every Unix").success());
    agent.says("to=Holding", limit);
    agent.says("at rest, torque zero", limit);
    agent.says("broken off before the manoeuvre's end", limit);
    assert_eq!(agent.ends(limit), 1);
    let text = fs::read_to_string(&log).expect("it was recorded");
    let log = Log::parse(&text).expect("a sound log");
    assert!(log.duration() > 4.0, "{} s", log.duration());
}

/// The whole path, as docs/identify.md has it: drive, record, fit, write; within 3 % of the simulated robot.
#[test]
#[ignore = "slow tier: a drive of 70 s in real time"]
fn driven_robot_is_identified() {
    let (log, out) = (scratch("driven.csv"), scratch("driven-robot.toml"));
    let (_plants, mut agent) = driving("driven", &log, &["--out", &out.display().to_string()]);
    assert_eq!(agent.ends(Duration::from_secs(120)), 0);
    let text = fs::read_to_string(&out).expect("it was written");
    let (robot, truth) = (
        Robot::parse("driven", &text).expect("sound"),
        Robot::embedded("liu").expect("embedded"),
    );
    let (p, t) = (robot.params, truth.params);
    for (name, fitted, truth) in [
        ("m l", p.m * p.l, t.m * t.l),
        ("I_mr", p.i_mr(), t.i_mr()),
        ("I_mp", p.i_mp(), t.i_mp()),
        ("zeta", p.zeta, t.zeta),
        ("c_rr", p.c_rr, t.c_rr),
        ("coulomb", p.coulomb, t.coulomb),
    ] {
        println!("{name}: {fitted:.5}, true {truth:.5}");
        assert!(
            (fitted / truth - 1.0).abs() < 0.03,
            "{name}: {fitted} instead of {truth}"
        );
    }
}

fn identify(args: &[&str]) -> Output {
    Command::new(AGENT)
        .arg("identify")
        .args(args)
        .output()
        .expect("the program was built with the test")
}

/// Exit code 2 with file, line, column and remedy; 1 with what is missing, and no robot file.
#[test]
fn bad_input_and_useless_logs_have_their_exit_codes() {
    let said = |output: &Output| String::from_utf8_lossy(&output.stderr).into_owned();
    let head = "stamp_s,gyro_x_rad_s,gyro_y_rad_s,gyro_z_rad_s,accel_x_m_s2,accel_y_m_s2,accel_z_m_s2,theta_r_rad,theta_p_rad,torque_pitch_nm,torque_roll_nm\n";
    let log = scratch("command.csv");
    let path = log.display().to_string();

    fs::write(&log, format!("{head}0,0,0,x,0,0,9.81,0,0,0,0\n")).expect("written");
    let output = identify(&[&path, "--robot", "liu"]);
    assert_eq!(output.status.code(), Some(2));
    let expected = format!(
        "sphere-agent: {path}: line 2, column 4 (gyro_z_rad_s): `x` must be a finite number\n"
    );
    assert_eq!(said(&output), expected);

    for (args, why) in [
        (vec!["no-such.csv", "--robot", "liu"], "no-such.csv"),
        (
            vec![&path, "--robot", "luu"],
            "neither a path ending in .toml",
        ),
        (vec![&path], "--robot"),
        (vec!["--drive"], "--record"),
    ] {
        let output = identify(&args);
        assert_eq!(output.status.code(), Some(2), "{args:?}");
        assert!(said(&output).contains(why), "{}", said(&output));
    }

    let rows: Vec<_> = (0..2000)
        .map(|i| {
            format!(
                "{},0.001,0,0,0,0,9.81,0.01,{},0.1,-0.1",
                0.005 * f64::from(i),
                1e-4 * f64::from(i % 3)
            )
        })
        .collect();
    fs::write(&log, format!("{head}{}\n", rows.join("\n"))).expect("written");
    let out = scratch("never.toml");
    let output = identify(&[
        &path,
        "--robot",
        "liu",
        "--json",
        "--out",
        &out.display().to_string(),
    ]);
    assert_eq!(output.status.code(), Some(1), "{}", said(&output));
    assert!(
        said(&output).contains("the log lacks speed reversals"),
        "{}",
        said(&output)
    );
    assert!(!out.exists());
    let json: serde_json::Value = serde_json::from_slice(&output.stdout).expect("JSON alone");
    assert_eq!(json["trustworthy"], false);
    assert_eq!(json["parameters"][0]["name"], "m l");
}
