//! The live side: plants in real time, the relay, and the demo, over real UDP, TCP and Zenoh on the loopback interface.

use std::io::{Read, Write};
use std::net::{Ipv4Addr, SocketAddr, TcpListener, TcpStream};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use serde_json::Value;
use sphere_protocol::message::Mode;
use sphere_sim::demo::{self, Cut, Options};
use sphere_sim::live::{Plants, link_pair, plant_setup};
use sphere_sim::network::LinkModel;
use sphere_sim::plants_command::row_of_robots;
use sphere_sim::relay::{Direction, Relay};

/// Tests of what happens in real time do not share the machine with each other.
static ALONE: tokio::sync::Mutex<()> = tokio::sync::Mutex::const_new(());

const LOOPBACK: SocketAddr = SocketAddr::new(std::net::IpAddr::V4(Ipv4Addr::LOCALHOST), 0);

// --- plants -------------------------------------------------------------------------------------------------------------------

/// Time of the plants is that of the machine, sensor frames come at 200 Hz, and nobody but the pinned agent is heard.
#[test]
fn plants_keep_real_time_and_send_200_frames_a_second() {
    let _alone = ALONE.blocking_lock();
    let scenario = row_of_robots(3, 1).expect("three robots");
    let (agent, board) = link_pair().expect("free ports");
    let mut setups = vec![plant_setup(&scenario, 0, board)];
    for robot in 1..3 {
        let (_, board) = link_pair().expect("free ports");
        setups.push(plant_setup(&scenario, robot, board));
    }
    let plants = Plants::start(setups).expect("a thread");
    let mut buffer = [0; 2048];
    let mut datagrams = 0;
    while plants.origin().elapsed() < Duration::from_secs(3) {
        let got = agent.receive(&mut buffer, Duration::from_millis(20));
        datagrams += u32::from(got.expect("a socket").is_some());
    }
    let truth = plants.truths()[0].newest();
    let behind = plants.origin().elapsed().as_secs_f64() - truth.elapsed.as_secs_f64();
    let pace = plants.stop().expect("plants that ran");
    // 601 sensor frames, 29 fixes, 4 heartbeats; the last milliseconds may be under way.
    assert!((620..=640).contains(&datagrams), "{datagrams} datagrams");
    assert!((-0.001..0.1).contains(&behind), "{behind} s behind");
    assert!((2990..=3110).contains(&pace.steps), "{pace:?}");
}

/// A link that waits for a time waits for that time: a socket's own time limit would be rounded up to the kernel's tick.
#[test]
fn the_motor_link_waits_no_longer_than_it_is_told() {
    let _alone = ALONE.blocking_lock();
    let (agent, _board) = link_pair().expect("free ports");
    let mut buffer = [0; 16];
    let mut waits: Vec<Duration> = (0..200)
        .map(|_| {
            let begin = Instant::now();
            let got = agent.receive(&mut buffer, Duration::from_micros(500));
            assert_eq!(got.expect("a socket"), None);
            begin.elapsed()
        })
        .collect();
    waits.sort();
    // The shortest of many: a busy machine makes single ones late, a coarse timer makes all of them.
    assert!(waits[0] >= Duration::from_micros(500));
    assert!(waits[20] < Duration::from_micros(1000), "{:?}", waits[20]);
}

// --- relay --------------------------------------------------------------------------------------------------------------------

/// A relay before a server that sends back what comes; the connection through it.
async fn echoed(model: LinkModel) -> (Relay, TcpStream) {
    let server = TcpListener::bind(LOOPBACK).expect("a port");
    let onward = server.local_addr().expect("bound");
    std::thread::spawn(move || {
        while let Ok((mut stream, _)) = server.accept() {
            let mut buffer = [0; 4096];
            while let Ok(length @ 1..) = stream.read(&mut buffer) {
                if stream.write_all(&buffer[..length]).is_err() {
                    break;
                }
            }
        }
    });
    let ideal = LinkModel {
        delay: 0.0,
        jitter: 0.0,
        loss: 0.0,
    };
    let direction = |model, seed| Direction {
        model,
        random: ChaCha8Rng::seed_from_u64(seed),
    };
    let relay = Relay::start(LOOPBACK, onward, direction(model, 1), direction(ideal, 2))
        .await
        .expect("a port");
    let stream = TcpStream::connect(relay.address()).expect("the relay listens");
    stream.set_nodelay(true).expect("a socket");
    (relay, stream)
}

/// Sends `count` numbered messages, one each `every`, and returns the time that each took to come back.
fn round_trips(stream: &TcpStream, count: u32, every: Duration) -> Vec<f64> {
    let begin = Instant::now();
    let mut writes = stream.try_clone().expect("a socket");
    let writer = std::thread::spawn(move || {
        for number in 0..count {
            let due = begin + every * number;
            std::thread::sleep(due.saturating_duration_since(Instant::now()));
            let mut message = number.to_le_bytes().to_vec();
            let sent = u64::try_from(begin.elapsed().as_nanos()).expect("seconds");
            message.extend(sent.to_le_bytes());
            writes.write_all(&message).expect("a connection");
        }
    });
    let mut reads = stream;
    let latencies = (0..count)
        .map(|number| {
            let mut message = [0; 12];
            reads.read_exact(&mut message).expect("what was sent");
            let (head, tail) = message.split_at(4);
            assert_eq!(head, number.to_le_bytes(), "TCP keeps the order");
            let sent = u64::from_le_bytes(tail.try_into().expect("8 bytes"));
            begin.elapsed().as_secs_f64() - Duration::from_nanos(sent).as_secs_f64()
        })
        .collect();
    writer.join().expect("all sent");
    latencies
}

fn mean_and_deviation(samples: &[f64]) -> (f64, f64) {
    let n = samples.len() as f64;
    let mean = samples.iter().sum::<f64>() / n;
    let variance = samples.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / n;
    (mean, variance.sqrt())
}

/// On the wire: 50 ± 5 ms, far enough apart that none waits for the one ahead.
#[tokio::test(flavor = "multi_thread")]
async fn the_relay_delays_as_its_model_says() {
    let _alone = ALONE.lock().await;
    let model = LinkModel {
        delay: 0.05,
        jitter: 0.005,
        loss: 0.0,
    };
    let (relay, stream) = echoed(model).await;
    let every = Duration::from_millis(40);
    let latencies = tokio::task::spawn_blocking(move || round_trips(&stream, 100, every))
        .await
        .expect("messages");
    let (mean, deviation) = mean_and_deviation(&latencies);
    // Three standard errors (1.5 and 1.1 ms), and timers of 1 ms that are late on a busy machine.
    assert!((0.0485..0.056).contains(&mean), "mean {mean}");
    assert!((0.0035..0.009).contains(&deviation), "jitter {deviation}");
    assert_eq!(relay.up().bytes, 1200);
    assert_eq!(relay.down().bytes, 1200);
    assert_eq!(relay.up().stalls, 0);
}

/// 10 % of the segments are late by a retransmission timeout, order is kept, and nothing is lost.
#[tokio::test(flavor = "multi_thread")]
async fn loss_on_tcp_is_lateness() {
    let _alone = ALONE.lock().await;
    let model = LinkModel {
        delay: 0.01,
        jitter: 0.0,
        loss: 0.1,
    };
    let (relay, stream) = echoed(model).await;
    let every = Duration::from_millis(10);
    let latencies = tokio::task::spawn_blocking(move || round_trips(&stream, 400, every))
        .await
        .expect("messages");
    let up = relay.up();
    let share = up.stalls as f64 / up.segments as f64;
    // Three standard errors of 400 draws; messages that were joined in one segment make it fewer.
    assert!(
        (0.05..0.15).contains(&share),
        "{share} of {} stalled",
        up.segments
    );
    // Behind a lost segment all wait for up to 200 ms.
    let stalled = latencies.iter().filter(|latency| **latency > 0.1).count();
    assert!(stalled > 100, "{stalled} of 400 late");
    assert!(latencies.iter().any(|latency| *latency > 0.2));
    assert!(latencies.iter().any(|latency| *latency < 0.03));
}

/// Cut, nothing comes; healed, everything does, in order.
#[tokio::test(flavor = "multi_thread")]
async fn a_cut_holds_everything_back_and_loses_nothing() {
    let _alone = ALONE.lock().await;
    let model = LinkModel {
        delay: 0.01,
        jitter: 0.0,
        loss: 0.0,
    };
    let (relay, mut stream) = echoed(model).await;
    stream.write_all(b"before").expect("a connection");
    let mut buffer = [0; 6];
    stream.read_exact(&mut buffer).expect("an echo");
    relay.cut();
    assert!(relay.is_cut());
    stream.write_all(b"during").expect("a connection");
    let timeout = Duration::from_millis(300);
    stream.set_read_timeout(Some(timeout)).expect("a socket");
    assert!(stream.read(&mut buffer).is_err(), "nothing passes a cut");
    relay.heal();
    stream.write_all(b"behind").expect("a connection");
    for expected in [b"during", b"behind"] {
        stream.read_exact(&mut buffer).expect("an echo");
        assert_eq!(&buffer, expected);
    }
}

// --- the whole ----------------------------------------------------------------------------------------------------------------

/// Promise: cutting one link puts that robot into holding within its plan's validity, and leaves the others alone.
#[tokio::test(flavor = "multi_thread")]
async fn a_cut_link_stops_its_robot_alone() {
    let _alone = ALONE.lock().await;
    let cut: Cut = "r1@12+7".parse().expect("a cut");
    let mut scenario = demo::scenario(3, 24.0).expect("the demo's scenario");
    // Stalls of a lossy link can stop a robot as well: here the cut alone may.
    for link in [&mut scenario.network.up, &mut scenario.network.down] {
        link.loss = sphere_sim::scenario::Loss::Independent(0.0);
    }
    let (_keep, mut stop) = tokio::sync::mpsc::channel(1);
    let options = Options {
        scenario,
        cuts: vec![cut],
        mirror: None,
    };
    let performance = demo::perform(options, &mut stop, |_| ())
        .await
        .expect("a demo");
    let trace = &performance.run.trace;
    let modes = |robot: &str, from: f64, to: f64| -> Vec<Mode> {
        let rows = trace.rows_of(robot.parse().expect("an id"));
        let mut modes: Vec<_> = rows
            .iter()
            .filter(|row| (from..to).contains(&row.t.as_secs_f64()))
            .map(|row| row.mode)
            .collect();
        modes.dedup();
        modes
    };
    let verdicts = demo::verdicts(&performance, &[cut]);
    assert!(
        matches!(verdicts[0].1, demo::Verdict::Held(_)),
        "{verdicts:?}"
    );
    assert_eq!(modes("r1", 11.0, 18.9), [Mode::Tracking, Mode::Holding]);
    assert_eq!(
        modes("r1", 23.0, 24.0),
        [Mode::Tracking],
        "back on its path"
    );
    for robot in ["r2", "r3"] {
        assert_eq!(modes(robot, 11.5, 24.0), [Mode::Tracking], "{robot}");
    }
    assert_eq!(performance.run.metrics.violations, []);
}

/// The first thing that a stranger runs, twice at the same time: both succeed, the second on another port.
#[test]
fn two_demos_run_side_by_side() {
    let _alone = ALONE.blocking_lock();
    let folders = [out("demo-first"), out("demo-second")];
    let mut demos = Vec::new();
    for folder in &folders {
        demos.push(start_demo(folder, "28"));
        std::thread::sleep(Duration::from_secs(3));
    }
    let mut endpoints = Vec::new();
    let mut said = Vec::new();
    for (demo, folder) in demos.into_iter().zip(&folders) {
        let output = demo.wait_with_output().expect("a demo");
        let errors = String::from_utf8_lossy(&output.stderr).into_owned();
        let text = String::from_utf8_lossy(&output.stdout).into_owned();
        assert_eq!(output.status.code(), Some(0), "{errors}\n{text}");
        assert!(
            text.contains("RMSE mm") && text.contains("Just shown: 3 robots"),
            "{text}"
        );
        for file in [
            "paths.svg",
            "r1-path.svg",
            "r2-errors.svg",
            "r3-modes.svg",
            "trace.csv",
        ] {
            assert!(folder.join(file).is_file(), "{file}");
        }
        let metrics = metrics(folder);
        for robot in metrics["robots"].as_array().expect("robots") {
            let number = |key: &str| robot[key].as_f64().expect("a figure");
            assert!(number("position_rmse_m") <= 0.04, "{robot}");
            assert!(number("plan_age_p50_s") >= 0.1, "{robot}");
        }
        for robot in metrics["live"]["robots"].as_array().expect("robots") {
            assert!(robot["control_lateness_p50_s"].as_f64().expect("steps") < 0.005);
            assert!(
                robot["link_stalls"].as_u64().expect("a count") > 10,
                "{robot}"
            );
        }
        endpoints.push(metrics["live"]["endpoint"].to_string());
        said.push(errors);
    }
    assert_ne!(endpoints[0], endpoints[1]);
    assert!(
        said[1].contains("the router took another port"),
        "{}",
        said[1]
    );
}

/// Ctrl-C: the robots brake, and the report is written.
#[cfg(unix)]
#[test]
fn an_interrupted_demo_ends_cleanly() {
    let _alone = ALONE.blocking_lock();
    let folder = out("demo-interrupted");
    let demo = start_demo(&folder, "60");
    std::thread::sleep(Duration::from_secs(8));
    let asked = Instant::now();
    let kill = format!("kill -INT {}", demo.id());
    let killed = Command::new("sh").args(["-c", &kill]).status();
    assert!(killed.expect("a shell").success());
    let output = demo.wait_with_output().expect("a demo");
    // 5 s to rest at most, then sessions close and plots are drawn.
    assert!(
        asked.elapsed() < Duration::from_secs(12),
        "{:?}",
        asked.elapsed()
    );
    let errors = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(0), "{errors}");
    let duration = metrics(&folder)["duration_s"].as_f64().expect("a figure");
    assert!((5.0..10.0).contains(&duration), "{duration}");
    assert!(folder.join("paths.svg").is_file());
}

/// A cut that is none, and one for nobody, are refused with a remedy.
#[test]
fn cuts_are_checked() {
    let _alone = ALONE.blocking_lock();
    for (cut, expected) in [("r1@3", "r2@30+5"), ("r9@3+1", "there are r1, r2, r3")] {
        let output = Command::new(env!("CARGO_BIN_EXE_sphere-sim"))
            .args(["demo", "--cut", cut, "--out"])
            .arg(out("demo-refused"))
            .output()
            .expect("the program");
        assert_eq!(output.status.code(), Some(2), "{cut}");
        let errors = String::from_utf8_lossy(&output.stderr);
        assert!(errors.contains(expected), "{errors}");
    }
}

fn start_demo(folder: &Path, duration: &str) -> std::process::Child {
    Command::new(env!("CARGO_BIN_EXE_sphere-sim"))
        .args(["demo", "--duration", duration, "--out"])
        .arg(folder)
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .expect("the program")
}

fn metrics(folder: &Path) -> Value {
    let text = std::fs::read_to_string(folder.join("metrics.json")).expect("metrics.json");
    serde_json::from_str(&text).expect("JSON")
}

fn out(name: &str) -> PathBuf {
    Path::new(env!("CARGO_TARGET_TMPDIR")).join(name)
}
