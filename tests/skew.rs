//! Fleets whose programs are of different schema versions (docs/protocol.md, Versions): station and agent as processes, on routers of
//! their own, and between these a bridge that rewrites the version of what really passes.

#[path = "support/board.rs"]
mod board;
#[path = "support/process.rs"]
mod process;

use std::sync::{Arc, Mutex};
use std::thread::sleep;
use std::time::{Duration, Instant};

use board::Board;
use process::{Program, free_port};
use sphere_protocol::io::bus::{Bus, Declared, Received, Role};
use sphere_protocol::key::{EVERY_UP, Key};
use sphere_protocol::message::{Direction, DropReason, Mode, Qos, Status};
use sphere_protocol::wire;

const SECOND: Duration = Duration::from_secs(1);

/// What is done to the version of a message on its way.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Doctored {
    No,
    /// Another major version, the fields as they are.
    Major,
    /// A later minor version, with a field that nobody here knows.
    Minor,
}

/// Which messages of the agent or the station are doctored, by topic.
type Doctor = fn(topic: &str) -> Doctored;

/// An agent on a router of its own, a station on another, and the bridge: all that each hears of the other passes `doctor`.
struct Skewed {
    board: Board,
    agent: Program,
    station: Program,
    doctor: Arc<Mutex<Doctor>>,
    passed: Arc<Mutex<Vec<(Instant, Received)>>>,
    _bridge: [(Arc<Bus>, Declared); 2],
}

impl Skewed {
    fn start(name: &str, doctor: Doctor) -> Self {
        let [ground, air] = [free_port(), free_port()];
        let station = Program::station(&format!("{name}-station"), Some(1), ground);
        station.says(Instant::now() - SECOND, 5 * SECOND, "station ready");
        let endpoint = |port| vec![format!("tcp/127.0.0.1:{port}")];
        let open = |role| Arc::new(Bus::open(&role, 5 * SECOND).expect("loopback"));
        let below = open(Role::Client {
            connect: endpoint(ground),
        });
        let above = open(Role::Router {
            listen: endpoint(air),
        });
        let doctor = Arc::new(Mutex::new(doctor));
        let passed = Arc::default();
        let up = pass(&above, &below, EVERY_UP, &doctor, &passed);
        // One selector for `down` and `cmd`: none of it is what the agent publishes.
        let down = pass(&below, &above, "fleet/v1/*/*/*", &doctor, &passed);
        let board = Board::start(1);
        let agent = Program::agent(&format!("{name}-agent"), board.agent, board.address, air);
        Self {
            board,
            agent,
            station,
            doctor,
            passed,
            _bridge: [up, down],
        }
    }

    fn doctor(&self, doctor: Doctor) -> Instant {
        *self.doctor.lock().unwrap() = doctor;
        Instant::now()
    }

    /// Messages on `topic` that have passed the bridge from `begin` on, as they left it.
    fn passed(&self, begin: Instant, topic: &str) -> Vec<Received> {
        let passed = self.passed.lock().unwrap();
        let of_topic = |m: &Received| m.key.ends_with(&format!("/{topic}"));
        passed
            .iter()
            .filter(|(at, m)| *at >= begin && of_topic(m))
            .map(|(_, m)| m.clone())
            .collect()
    }

    /// The robot's newest status, read as the version that its agent really sent.
    fn status(&self) -> Status {
        let mut newest = self
            .passed(Instant::now() - 3 * SECOND, "status")
            .pop()
            .expect("one a second");
        newest.bytes[1] = 1;
        wire::decode(&newest.bytes).expect("a status")
    }

    fn drives(&self, begin: Instant) -> Duration {
        let v = |t: &board::Truth| t.v > 0.3;
        self.board.first(begin, 30 * SECOND, "the robot drives", v)
    }

    /// Fastest from `begin` on [m/s], and the largest torque [N·m].
    fn moved(&self, begin: Instant) -> [f64; 2] {
        let truths = self.board.since(begin);
        let most = |of: fn(&board::Truth) -> f64| truths.iter().map(of).fold(0.0, f64::max);
        [most(|t| t.v.abs()), most(|t| t.torque)]
    }
}

/// Publishes on `to` what comes from `from`, doctored.
fn pass(
    from: &Arc<Bus>,
    to: &Arc<Bus>,
    selector: &str,
    doctor: &Arc<Mutex<Doctor>>,
    passed: &Arc<Mutex<Vec<(Instant, Received)>>>,
) -> (Arc<Bus>, Declared) {
    let (to, doctor, passed) = (to.clone(), doctor.clone(), passed.clone());
    let is_up = selector == EVERY_UP;
    let declared = from.subscribe(selector, move |mut message| {
        let key = Key::parse(&message.key).expect("only the fleet is on these routers");
        let (is_ours, qos) = match key.direction() {
            Direction::Up => (is_up, Qos::Latest),
            Direction::Down => (!is_up, Qos::Latest),
            Direction::Command => (!is_up, Qos::Urgent),
            Direction::Beacon => (false, Qos::Latest),
        };
        if !is_ours {
            return;
        }
        let doctor = *doctor.lock().unwrap();
        rewrite(&mut message.bytes, doctor(key.topic()));
        to.publish(&message.key, qos, &message.bytes)
            .expect("an open session");
        passed.lock().unwrap().push((Instant::now(), message));
    });
    (from.clone(), declared.expect("a selector"))
}

/// Rewrites `[major, minor, {…}]` in place: the three bytes before the fields, and one field more behind them.
fn rewrite(bytes: &mut Vec<u8>, how: Doctored) {
    assert_eq!(bytes[..3], [0x83, 1, 0], "a message of 1.0");
    match how {
        Doctored::No => {}
        Doctored::Major => bytes[1] = 2,
        Doctored::Minor => {
            bytes[2] = 7;
            assert!((0xa0..0xb7).contains(&bytes[3]), "a map of up to 22 fields");
            bytes[3] += 1;
            // 99: {"since": [1.7, true]}
            bytes.extend(*b"\x18\x63\xa1\x65since\x82\xf9\x3e\xcd\xf5");
        }
    }
}

/// A robot whose software is a major version ahead is refused with a line that names it, the message and both versions; it is neither
/// claimed nor planned for. Brought to our version it is taken at once.
#[test]
fn a_robot_of_another_major_version_is_refused_and_gets_no_plans() {
    let mut fleet = Skewed::start("newer-robot", |topic| match topic {
        "telemetry" | "status" => Doctored::Major,
        _ => Doctored::No,
    });
    let begin = Instant::now();
    for topic in ["telemetry", "status"] {
        let line = format!("a {topic} message has schema 2.0, this software reads 1.x");
        fleet.station.says(begin - SECOND, 5 * SECOND, &line);
    }
    sleep(4 * SECOND);
    let text = fleet.station.text();
    println!("measured: the station says\n{text}");
    let told: Vec<_> = text.lines().filter(|l| l.contains("schema 2.0")).collect();
    assert_eq!(told.len(), 2, "once for each topic: {told:#?}");
    assert!(told.iter().all(|line| line.contains("robot=r1")));
    assert!(told.iter().all(|line| line.contains("WARN")));
    assert!(!text.contains("found"), "{text}");
    // 25 a second were offered to it.
    let heard = fleet.passed(begin, "telemetry").len();
    assert!(heard > 50, "{heard} telemetries passed");
    assert_eq!(fleet.passed(begin, "plan").len(), 0);
    assert_eq!(fleet.passed(begin, "command").len(), 0);
    assert_eq!(fleet.status().mode, Mode::Ready, "ready, and nobody's");
    assert_eq!(fleet.moved(begin)[1], 0.0, "torque");

    // Its status alone is beyond us: the station drives it, and says what it misses.
    let updated = fleet.doctor(|topic| match topic {
        "status" => Doctored::Major,
        _ => Doctored::No,
    });
    let leased = fleet.station.says(updated, 5 * SECOND, "lease granted");
    println!(
        "measured: updated to lease {leased:?}, to driving {:?}",
        fleet.drives(updated)
    );
    fleet.station.signal("TERM");
    assert!(fleet.station.ends(2 * SECOND).0.success());
}

/// A station a major version ahead is refused by the agent, which says so in its log and counts it in its status; the station in turn
/// says what the robot reports. No torque follows from its commands, and no motion from its plans.
#[test]
fn a_station_of_another_major_version_moves_nothing() {
    let fleet = Skewed::start("newer-station", |topic| match topic {
        "command" | "plan" => Doctored::Major,
        _ => Doctored::No,
    });
    let begin = Instant::now();
    let line = "a command message has schema 2.0, this software reads 1.x";
    fleet.agent.says(begin - SECOND, 8 * SECOND, line);
    let answered = fleet.station.says(
        begin - SECOND,
        10 * SECOND,
        "the robot drops our messages for their schema version",
    );
    println!("measured: the station knows after {answered:?}");
    sleep(4 * SECOND);
    let status = fleet.status();
    let refused = status.dropped[DropReason::Version as usize];
    // A claim every 200 ms.
    assert!(refused >= 10, "{:?}", status.dropped);
    assert_eq!((status.mode, status.station), (Mode::Ready, 0));
    assert_eq!(fleet.moved(begin)[1], 0.0, "torque");
    let text = fleet.agent.text();
    let told: Vec<_> = text.lines().filter(|l| l.contains("schema 2.0")).collect();
    println!("measured: {refused} refused, of which the agent says\n{told:#?}");
    assert_eq!(told.len(), 1, "once: {told:#?}");
    assert!(told[0].contains("robot=r1") && told[0].contains("WARN"));
    assert!(fleet.station.text().contains("robot=r1"));

    // Its commands are of ours now, its plans are not: the robot is armed and stays where it is.
    let begin = fleet.doctor(|topic| match topic {
        "plan" => Doctored::Major,
        _ => Doctored::No,
    });
    let line = "a plan message has schema 2.0, this software reads 1.x";
    let told = fleet.agent.says(begin, 8 * SECOND, line);
    sleep(3 * SECOND);
    let status = fleet.status();
    let newly = status.dropped[DropReason::Version as usize] - refused;
    let [fastest, _] = fleet.moved(begin);
    println!("measured: plans refused after {told:?}: {newly}; fastest {fastest:.4} m/s");
    // Ten a second.
    assert!(newly >= 20, "{:?}", status.dropped);
    assert_eq!(status.mode, Mode::Idle);
    // It balances against sensor noise, no more.
    assert!(fastest < 0.05, "{fastest} m/s");

    let begin = fleet.doctor(|_| Doctored::No);
    println!("measured: updated to driving {:?}", fleet.drives(begin));
}

/// A later minor version with a field that nobody here knows is taken both ways as if it were ours.
#[test]
fn another_minor_version_with_an_unknown_field_is_taken() {
    let fleet = Skewed::start("minor", |_| Doctored::Minor);
    fleet.drives(Instant::now());
    sleep(2 * SECOND);
    let status = fleet.passed(Instant::now() - 3 * SECOND, "status");
    let newest = status.last().expect("one a second");
    assert_eq!(newest.bytes[..3], [0x83, 1, 7]);
    let status: Status = wire::decode(&newest.bytes).expect("1.7 is read");
    assert_eq!(status.mode, Mode::Tracking);
    for reason in [
        DropReason::Malformed,
        DropReason::Version,
        DropReason::OutOfRange,
        DropReason::Unexpected,
    ] {
        assert_eq!(status.dropped[reason as usize], 0, "{reason}");
    }
    for text in [fleet.station.text(), fleet.agent.text()] {
        assert!(!text.contains("incompatible"), "{text}");
    }
}
