//! `sphere-sim swarm`: real processes, real Zenoh, MAVLink over UDP; its figures are there and plausible, and nothing outlives it.
#![cfg(target_os = "linux")]

use std::fs;
use std::io::{BufRead, BufReader, Read};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::{Mutex, PoisonError};
use std::thread;
use std::time::{Duration, Instant};

use serde_json::Value;
use sphere_sim::swarm::{PLANNING_US, SwarmReport, computed};

/// What happens in real time does not share the machine with other tests of this file.
static ALONE: Mutex<()> = Mutex::new(());

/// Promise: four robots in two processes track over an injected delay, and the report says at what cost.
#[test]
fn a_small_swarm_tracks_and_its_costs_are_told_by_part() {
    let _alone = ALONE.lock().unwrap_or_else(PoisonError::into_inner);
    let folder = PathBuf::from(env!("CARGO_TARGET_TMPDIR")).join("swarm");
    let mut swarm = start(&[
        "--robots=4",
        "--processes=2",
        "--duration=6",
        "--delay-ms=20",
        "--telemetry-ms=20",
        // A machine that compiles other things meanwhile is not what this is about.
        "--bound-ms=100",
        "--json",
        "--out",
        folder.to_str().expect("UTF-8"),
    ]);
    let told = said(&mut swarm, "Measuring for");
    let parts = children(swarm.id());
    assert_eq!(
        parts.len(),
        5,
        "station, relay, plants, twice agents: {told}"
    );
    let mut text = String::new();
    let mut stdout = swarm.stdout.take().expect("piped");
    stdout.read_to_string(&mut text).expect("UTF-8");
    let status = swarm.wait().expect("a child");
    assert_eq!(alive(&parts), [] as [u32; 0], "nobody is left");
    let file = fs::read_to_string(folder.join("swarm-4.json")).expect("written");
    assert_eq!(file, text);

    let report: Value = serde_json::from_str(&text).expect("JSON alone");
    // Sensors that are silent for 100 ms are a fault, on a machine that stands still for as long too: a bare thread tells.
    let bare = report["idle_late_during_ms"]["max"].as_f64();
    if status.code() != Some(0) && bare.is_some_and(|ms| ms > 30.0) {
        println!(
            "SKIPPED: needs a machine that wakes threads in time; a bare one was {bare:?} ms late"
        );
        return;
    }
    assert_eq!(status.code(), Some(0), "{text}");
    let number = |path: &str| -> f64 {
        let value = report.pointer(path).unwrap_or(&Value::Null);
        value.as_f64().unwrap_or_else(|| panic!("{path}: {value}"))
    };
    // 20 ms each way, twice, to a bucket of each; the relay cannot be early.
    assert!((39.5..=40.5).contains(&number("/injected_ms/p50")));
    assert!(number("/injected_measured_ms/p50") >= 40.0);
    // 10 plans a second and robot; none is there before both delays are over.
    let plans = number("/plan_age_arrival_ms/count");
    assert!((210.0..=270.0).contains(&plans), "{plans}");
    assert!((40.0..100.0).contains(&number("/plan_age_arrival_ms/p50")));
    assert!(number("/plan_age_beginning_ms/p50") >= number("/plan_age_arrival_ms/p50"));
    // 50 steps a second, 4 robots, 6 s; statistics are renewed every 0.2 s, and a thread that was kept from running makes fewer.
    let steps = number("/control_late_ms/count");
    assert!((1050.0..=1300.0).contains(&steps), "{steps}");
    assert!(number("/idle_late_before_ms/count") > 1000.0);
    assert!(number("/idle_late_during_ms/p99") > 0.0);
    // 50 telemetries, 5 beacons and a status up, 10 plans down; a plan has over 1 kB.
    assert!((50.0..60.0).contains(&number("/payload/up_messages")));
    assert!((8.5..11.5).contains(&number("/payload/down_messages")));
    assert!((1e4..2e4).contains(&number("/payload/down_bytes")));
    // Framing adds to what is sent, and beacons, which nobody wants, are not.
    let ratio = number("/socket/down_bytes") / number("/payload/down_bytes");
    assert!((1.0..1.3).contains(&ratio), "{ratio}");
    for (index, (name, processes)) in [("station", 1), ("agents", 2), ("plants", 1), ("relay", 1)]
        .into_iter()
        .enumerate()
    {
        let part = &report["parts"][index];
        assert_eq!(part["name"], name);
        assert_eq!(part["processes"], processes);
        let cpu = part["cpu_percent"].as_f64().expect("a figure");
        assert!((0.1..200.0).contains(&cpu), "{part}");
        let memory = part["memory_bytes"].as_f64().expect("a figure");
        assert!((2e6..5e8).contains(&memory), "{part}");
    }
    let agents = &report["parts"][1]["cpu_percent_by_thread"];
    assert!(agents["control"].as_f64().expect("control threads") > 0.1);
    let each = report["each"].as_array().expect("robots");
    assert_eq!(each.len(), 4);
    for robot in each {
        assert!(
            robot["tracking"].as_f64().expect("a share") >= 0.99,
            "{robot}"
        );
        let rmse = robot["position_rmse_m"].as_f64().expect("a figure");
        assert!((1e-4..=0.04).contains(&rmse), "{robot}");
    }
    assert_eq!(report["failures"], serde_json::json!([]));

    // The file can be drawn; of one size of fleet nothing is computed for others.
    let output = Command::new(env!("CARGO_BIN_EXE_sphere-sim"))
        .args(["swarm", "--plot"])
        .arg(folder.join("swarm-4.json"))
        .arg("--out")
        .arg(&folder)
        .output()
        .expect("the program");
    let errors = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(0), "{errors}");
    assert!(errors.contains("another size"), "{errors}");
    let svg = fs::read_to_string(folder.join("swarm.svg")).expect("a plot");
    assert!(svg.starts_with("<svg") && svg.contains("agents"));
    let page = fs::read_to_string(folder.join("swarm.md")).expect("tables");
    assert!(page.contains("| 4 | yes |"), "{page}");
}

/// Ctrl-C while it measures: robots brake, parts end in order, and what was measured is told.
#[test]
fn an_interrupted_swarm_reports_and_leaves_nobody() {
    let _alone = ALONE.lock().unwrap_or_else(PoisonError::into_inner);
    let mut swarm = start(&[
        "--robots=2",
        "--duration=600",
        "--delay-ms=0",
        "--bound-ms=200",
        "--json",
    ]);
    said(&mut swarm, "Measuring for");
    let parts = children(swarm.id());
    assert_eq!(parts.len(), 3, "without a delay there is no relay");
    thread::sleep(Duration::from_secs(2));
    let asked = Instant::now();
    signal(swarm.id(), "INT");
    let mut text = String::new();
    let mut stdout = swarm.stdout.take().expect("piped");
    stdout.read_to_string(&mut text).expect("UTF-8");
    assert_eq!(swarm.wait().expect("a child").code(), Some(0), "{text}");
    // 5 s to rest at most, then sessions close.
    assert!(asked.elapsed() < Duration::from_secs(12), "{asked:?}");
    assert_eq!(alive(&parts), [] as [u32; 0]);
    let report: Value = serde_json::from_str(&text).expect("JSON alone");
    assert_eq!(report["is_interrupted"], true);
    assert_eq!(report["socket"], Value::Null);
    assert!((1.5..10.0).contains(&report["duration_s"].as_f64().expect("seconds")));
}

/// However the parent ends, its parts do not go on without it.
#[test]
fn parts_end_with_their_parent() {
    let _alone = ALONE.lock().unwrap_or_else(PoisonError::into_inner);
    let mut swarm = start(&["--robots=2", "--duration=600"]);
    said(&mut swarm, "All track");
    let parts = children(swarm.id());
    assert_eq!(parts.len(), 4);
    signal(swarm.id(), "KILL");
    swarm.wait().expect("a child");
    let begin = Instant::now();
    while !alive(&parts).is_empty() {
        assert!(
            begin.elapsed() < Duration::from_secs(5),
            "{:?}",
            alive(&parts)
        );
        thread::sleep(Duration::from_millis(20));
    }
}

/// A swarm of `robots` whose planning thread takes 1 % and 0.1 % a robot, its Zenoh 2 % and 0.2 %; made up.
fn made_up(robots: usize, age_p99: f64) -> SwarmReport {
    let n = robots as f64;
    let spread = |p99: f64| serde_json::json!({"count": 1000, "mean": p99, "p50": p99, "p99": p99, "p999": p99, "max": p99});
    let station = serde_json::json!({
        "name": "station", "processes": 1, "threads": 11, "cpu_percent": 3.0 + 0.3 * n,
        "cpu_percent_by_thread": {"planning": 1.0 + 0.1 * n, "rx": 2.0 + 0.2 * n}, "memory_bytes": 20_000_000 + 500_000 * robots,
    });
    let ways = serde_json::json!({"up_bytes": 4000.0, "down_bytes": 15_000.0, "up_segments": 25.0, "down_segments": 20.0});
    let payload = serde_json::json!({"up_messages": 26.0, "up_bytes": 4100.0, "down_messages": 10.0, "down_bytes": 14_500.0});
    let mut report = serde_json::json!({
        "robots": robots, "agent_processes": 1, "duration_s": 60.0, "is_interrupted": false, "start_s": 3.0,
        "delay_ms": 100.0, "jitter_ms": 0.0, "telemetry_ms": 20, "bound_ms": 30.0, "version": "0.1.0", "processor": null,
        "cores": 2, "is_real_time": true, "payload": payload, "socket": ways, "parts": [station],
    });
    let rest = serde_json::json!({
        "plans": {"sent": 600 * robots, "shifted": 0, "failed": 0, "stale": 0}, "plant_steps": 60_000, "plant_steps_late": 0,
        "plant_late_max_ms": 0.4, "machine_cpu_percent": 90.0, "drops": {}, "each": [],
        "failures": if age_p99 > 230.0 { vec!["too old"] } else { vec![] },
    });
    let spreads = [
        ("injected_ms", 200.0),
        ("injected_measured_ms", 202.0),
        ("plan_age_arrival_ms", age_p99),
        ("plan_age_beginning_ms", age_p99),
        ("control_late_ms", 0.1),
        ("idle_late_before_ms", 0.1),
        ("idle_late_during_ms", 0.1),
        ("station_late_ms", 0.5),
    ];
    let fields = report.as_object_mut().expect("an object");
    fields.extend(rest.as_object().expect("an object").clone());
    fields.extend(spreads.map(|(name, p99)| (name.to_owned(), spread(p99))));
    serde_json::from_value(report).expect("every figure of a report")
}

/// What is computed for larger fleets is the line through the smallest and the largest run that held; others do not count.
#[test]
fn larger_fleets_are_computed_from_runs_that_held() {
    let runs = [made_up(10, 220.0), made_up(100, 225.0), made_up(400, 900.0)];
    assert_eq!(runs[0].overhead_p99_ms(), Some(20.0));
    let text = computed(&runs).expect("two sizes held");
    assert!(text.contains("runs of 10 and 100 robots"), "{text}");
    let row = text
        .lines()
        .find(|line| line.starts_with("| 1000 |"))
        .expect("a thousand robots");
    let cells: Vec<_> = row.split('|').map(str::trim).collect();
    // 1000 · 0.1 %; 1000 · 10 Hz · 20 µs; 1000 · 0.2 %; 60 % of a core at most; 1000 sessions a router; 19 kB/s, 36 messages/s, 500 kB.
    let solver = format!("{:.2}", 1e-2 * PLANNING_US);
    let expected = [
        "1.00",
        &solver,
        "2.00",
        "2",
        "4",
        "19.0 MB/s",
        "36000",
        "500.0 MB",
    ];
    assert_eq!(cells[2..10], expected, "{row}");
    assert!(
        computed(&runs[1..]).is_err(),
        "one size that held is no line"
    );
}

#[test]
fn what_cannot_be_is_refused_with_a_remedy() {
    for (arguments, expected) in [
        (&["--telemetry-ms=30"][..], "multiple of the control period"),
        (&["--robots=0"], "1..=5000"),
        (&["--duration=nan"], "write seconds"),
        (&["--delay-ms=-1"], "milliseconds from 0"),
        (&["--plot", "Cargo.toml"], "--out"),
        (
            &["--plot", "Cargo.toml", "--out", "out"],
            "--plot Cargo.toml: not what",
        ),
    ] {
        let output = Command::new(env!("CARGO_BIN_EXE_sphere-sim"))
            .arg("swarm")
            .args(arguments)
            .output()
            .expect("the program");
        let errors = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{arguments:?}: {errors}");
        assert!(errors.contains(expected), "{arguments:?}: {errors}");
    }
}

fn start(arguments: &[&str]) -> Child {
    Command::new(env!("CARGO_BIN_EXE_sphere-sim"))
        .arg("swarm")
        .args(arguments)
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .expect("the program was built with the test")
}

/// Waits until it says `text` on standard error; all it said until then. What it says later is read and left.
fn said(swarm: &mut Child, text: &str) -> String {
    let mut lines = BufReader::new(swarm.stderr.take().expect("piped")).lines();
    let mut told = String::new();
    loop {
        let line = lines
            .next()
            .unwrap_or_else(|| panic!("it did not say `{text}`:\n{told}"))
            .expect("UTF-8");
        println!("{line}");
        told = told + &line + "\n";
        if line.contains(text) {
            thread::spawn(move || {
                lines
                    .map_while(Result::ok)
                    .for_each(|line| println!("{line}"))
            });
            return told;
        }
    }
}

/// Processes whose parent is `parent`.
fn children(parent: u32) -> Vec<u32> {
    let processes = fs::read_dir("/proc").expect("Linux").flatten();
    let ids = processes.filter_map(|entry| entry.file_name().to_str()?.parse::<u32>().ok());
    let is_child = |id: &u32| {
        let stat = fs::read_to_string(format!("/proc/{id}/stat")).unwrap_or_default();
        // The name before it may contain anything but ends with the last parenthesis.
        let after = stat.rsplit_once(')').map_or("", |(_, after)| after);
        after.split_whitespace().nth(1) == Some(&parent.to_string())
    };
    ids.filter(is_child).collect()
}

/// Those of `ids` that still are parts of a swarm.
fn alive(ids: &[u32]) -> Vec<u32> {
    let is_part = |id: &&u32| {
        let line = fs::read(Path::new("/proc").join(id.to_string()).join("cmdline"));
        String::from_utf8_lossy(&line.unwrap_or_default()).contains("swarm-part")
    };
    ids.iter().filter(is_part).copied().collect()
}

fn signal(id: u32, signal: &str) {
    let kill = format!("kill -{signal} {id}");
    let status = Command::new("sh").args(["-c", &kill]).status();
    assert!(status.expect("a shell").success());
}
