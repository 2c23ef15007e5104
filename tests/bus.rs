//! The traps of Zenoh and of MAVLink over UDP, on real sockets: what each would do to a fleet, and that it does not.

#[path = "support/process.rs"]
mod process;

use std::net::{SocketAddr, TcpListener, UdpSocket};
use std::sync::{Arc, Mutex};
use std::thread::sleep;
use std::time::{Duration, Instant};

use process::{Program, free_port};
use sphere_agent::agent::{Agent, Input, Output};
use sphere_agent::config::{AgentConfig, Timing};
use sphere_agent::control::DirectionChoice;
use sphere_agent::estimator::EstimatorConfig;
use sphere_protocol::io::bus::{Bus, BusError, Inbox, Received, Role};
use sphere_protocol::io::link::UdpLink;
use sphere_protocol::mavlink::{AGENT, BOARD, Event, FrameReader, FrameWriter, Framing};
use sphere_protocol::message::{Mode, Qos};
use sphere_protocol::robot::Robot;
use sphere_protocol::state::{BoardStatus, Measurement};
use sphere_protocol::time::{AgentClock, Instant as Stamp, Span};

/// Tests of what happens in real time do not share the machine with each other.
static ALONE: tokio::sync::Mutex<()> = tokio::sync::Mutex::const_new(());

const SECOND: Duration = Duration::from_secs(1);
const START: Stamp<AgentClock> = Stamp::from_nanos(0);

fn endpoint(port: u16) -> Vec<String> {
    vec![format!("tcp/127.0.0.1:{port}")]
}

fn router(port: u16) -> Bus {
    let listen = endpoint(port);
    Bus::open(&Role::Router { listen }, 5 * SECOND).expect("a free port")
}

fn client(port: u16) -> Bus {
    let connect = endpoint(port);
    Bus::open(&Role::Client { connect }, 5 * SECOND).expect("the router is there")
}

/// Waits until `is_true`, for at most `limit`; returns how long it took.
fn wait(limit: Duration, what: &str, mut is_true: impl FnMut() -> bool) -> Duration {
    let begin = Instant::now();
    while !is_true() {
        assert!(begin.elapsed() < limit, "not within {limit:?}: {what}");
        sleep(Duration::from_millis(2));
    }
    begin.elapsed()
}

/// LIBRARIES, subscribers: one whose consumer sleeps is flooded; other traffic of its session and the signs of life go on.
#[test]
fn flooded_subscriber_does_not_block_its_session() {
    let _alone = ALONE.blocking_lock();
    let port = free_port();
    let _router = router(port);
    let (flooder, hearer) = (client(port), client(port));
    let inbox = Inbox::new(32);
    let _flooded = {
        let inbox = inbox.clone();
        hearer
            .subscribe("flood", move |message| inbox.push(message))
            .expect("a key")
    };
    let others: Arc<Mutex<Vec<Received>>> = Arc::default();
    let push = |others: &Arc<Mutex<Vec<Received>>>| {
        let others = others.clone();
        move |message: Received| others.lock().unwrap().push(message)
    };
    let _other = hearer.subscribe("other", push(&others)).expect("a key");
    let _life = hearer.watch_life("life/*", push(&others)).expect("a key");
    sleep(Duration::from_millis(300));
    // Far beyond the 256 messages after which Zenoh's own queue would block; nobody takes one out.
    for i in 0..5000_u32 {
        flooder
            .publish("flood", Qos::Latest, &i.to_le_bytes())
            .expect("open");
        if i % 50 == 0 {
            sleep(Duration::from_millis(1));
        }
    }
    let life = flooder.show_life("life/flooder").expect("a key");
    let took = wait(SECOND, "the sign of life comes", || {
        others
            .lock()
            .unwrap()
            .iter()
            .any(|m| m.key == "life/flooder" && !m.gone)
    });
    flooder.publish("other", Qos::Latest, b"x").expect("open");
    wait(SECOND, "another message comes", || {
        others.lock().unwrap().iter().any(|m| m.key == "other")
    });
    drop(life);
    wait(SECOND, "the sign of life goes", || {
        others.lock().unwrap().iter().any(|m| m.gone)
    });
    assert!(
        inbox.dropped() > 256,
        "only {} dropped: no flood",
        inbox.dropped()
    );
    let mut newest = None;
    while let Some(message) = inbox.pop() {
        newest = Some(message.bytes);
    }
    println!(
        "measured: sign of life through the flood {took:?}, {} dropped",
        inbox.dropped()
    );
    assert_eq!(
        newest,
        Some(4999_u32.to_le_bytes().to_vec()),
        "the newest is kept"
    );
}

/// LIBRARIES, subscribers: a session does not hear itself, and others do.
#[test]
fn own_messages_are_not_heard() {
    let _alone = ALONE.blocking_lock();
    let port = free_port();
    let (_router, speaker, other) = (router(port), client(port), client(port));
    let (own, others) = (Inbox::new(8), Inbox::new(8));
    let (a, b) = (own.clone(), others.clone());
    let _own = speaker
        .subscribe("said", move |m| a.push(m))
        .expect("a key");
    let _others = other.subscribe("said", move |m| b.push(m)).expect("a key");
    wait(2 * SECOND, "the other hears", || {
        speaker.publish("said", Qos::Urgent, b"x").expect("open");
        sleep(Duration::from_millis(20));
        others.pop().is_some()
    });
    sleep(Duration::from_millis(200));
    assert!(own.pop().is_none(), "it heard itself");
}

/// LIBRARIES, delivery: a frozen peer costs whoever publishes to it no time. Waiting for it would be 5 s, and then the end of the link.
#[test]
fn publishing_to_a_frozen_peer_does_not_wait() {
    let _alone = ALONE.blocking_lock();
    let port = free_port();
    let station = Program::station("frozen-peer", Some(1), port);
    station.says(Instant::now() - SECOND, 5 * SECOND, "station ready");
    let speaker = client(port);
    // What the station subscribes to, so that it is sent; more than the sockets between them hold.
    let telemetry = [0; 4000];
    let publish = || {
        let begin = Instant::now();
        for qos in [Qos::Latest, Qos::Urgent] {
            let key = "fleet/v1/r1/up/telemetry";
            speaker.publish(key, qos, &telemetry).expect("open");
        }
        begin.elapsed()
    };
    publish();
    sleep(Duration::from_millis(300));
    station.signal("STOP");
    let begin = Instant::now();
    let (mut longest, mut count) = (Duration::ZERO, 0);
    // Beyond the lease, after which the link is gone.
    while begin.elapsed() < 2 * SECOND {
        longest = longest.max(publish());
        count += 1;
        sleep(Duration::from_micros(500));
    }
    println!("measured: {count} pairs published to a frozen peer, the longest took {longest:?}");
    assert!(count > 1000, "{count}: too few to fill the sockets");
    assert!(longest < Duration::from_millis(200), "{longest:?}");
}

/// LIBRARIES, await: opening a session towards a host that accepts and never answers ends in time.
#[test]
fn opening_a_session_into_a_black_hole_times_out() {
    let _alone = ALONE.blocking_lock();
    let hole = TcpListener::bind("127.0.0.1:0").expect("a free port");
    let connect = endpoint(hole.local_addr().expect("bound").port());
    let begin = Instant::now();
    let opened = Bus::open(&Role::Client { connect }, Duration::from_millis(700));
    let took = begin.elapsed();
    let error = opened.map(drop).expect_err("nobody answers");
    assert!(matches!(error, BusError::Timeout { .. }), "{error}");
    assert!(took < Duration::from_millis(1200), "{took:?}");
    println!("measured: 0.7 s timeout returned after {took:?}: {error}");
}

/// A port that is taken, and a router that is not there, are errors at once that say so.
#[test]
fn taken_ports_and_absent_routers_are_errors() {
    let _alone = ALONE.blocking_lock();
    let port = free_port();
    let _first = router(port);
    let listen = endpoint(port);
    let error = Bus::open(&Role::Router { listen }, 5 * SECOND)
        .map(drop)
        .expect_err("the port is taken");
    println!("taken: {error}");
    assert!(error.to_string().contains(&port.to_string()), "{error}");
    let connect = endpoint(free_port());
    let begin = Instant::now();
    let error = Bus::open(&Role::Client { connect }, SECOND)
        .map(drop)
        .expect_err("nobody listens");
    println!("absent after {:?}: {error}", begin.elapsed());
    assert!(begin.elapsed() < Duration::from_millis(1500));
}

/// LIBRARIES, reconnect: a client hears again within 1 s of its router's return, without declaring anything anew.
#[test]
fn client_hears_again_within_a_second_of_its_routers_return() {
    let _alone = ALONE.blocking_lock();
    let port = free_port();
    let first = router(port);
    let hearer = client(port);
    let inbox = Inbox::new(8);
    let _heard = {
        let inbox = inbox.clone();
        hearer
            .subscribe("said", move |m| inbox.push(m))
            .expect("a key")
    };
    let said = |bus: &Bus| {
        bus.publish("said", Qos::Latest, b"x").expect("open");
        sleep(Duration::from_millis(10));
        inbox.pop().is_some()
    };
    wait(2 * SECOND, "heard before", || said(&first));
    for round in 0..3 {
        first.close();
        sleep(Duration::from_millis(1300 + 250 * round));
        while inbox.pop().is_some() {}
        let again = router(port);
        let took = wait(SECOND, "heard again", || said(&again));
        println!("measured: heard {took:?} after the router's return");
        again.close();
        drop(again);
    }
}

fn link_pair() -> (UdpLink, UdpSocket, SocketAddr) {
    let board = UdpSocket::bind("127.0.0.1:0").expect("a free port");
    let board_address = board.local_addr().expect("bound");
    let any = "127.0.0.1:0".parse().expect("an address");
    let link = UdpLink::open(any, board_address).expect("loopback");
    let agent = link.local_addr().expect("bound");
    (link, board, agent)
}

/// LIBRARIES, MAVLink: a stranger's datagram neither reaches the reader nor redirects the answers.
#[test]
fn strangers_datagram_has_no_effect() {
    let _alone = ALONE.blocking_lock();
    let (link, board, agent) = link_pair();
    let stranger = UdpSocket::bind("127.0.0.1:0").expect("a free port");
    stranger.send_to(b"stranger", agent).expect("loopback");
    let mut buffer = [0; 64];
    let heard = link.receive(&mut buffer, Duration::from_millis(200));
    assert_eq!(heard.expect("open"), None);
    board.send_to(b"board", agent).expect("loopback");
    let heard = link.receive(&mut buffer, SECOND).expect("open");
    assert_eq!(heard, Some(&b"board"[..]));
    stranger.send_to(b"stranger", agent).expect("loopback");
    link.send(b"answer").expect("open");
    board.set_read_timeout(Some(SECOND)).expect("a timeout");
    let length = board.recv(&mut buffer).expect("the answer");
    assert_eq!(&buffer[..length], b"answer");
    stranger
        .set_read_timeout(Some(Duration::from_millis(100)))
        .expect("a timeout");
    assert!(stranger.recv(&mut buffer).is_err(), "answered a stranger");
}

fn agent() -> Agent {
    let config = AgentConfig {
        id: "r1".parse().expect("an id"),
        robot: Robot::embedded("liu").expect("embedded"),
        boot_id: 1,
        estimator: EstimatorConfig::default(),
        direction: DirectionChoice::Htsmc,
        timing: Timing::default(),
    };
    Agent::new(START, config).expect("stable gains")
}

/// A robot at rest at `ms` of the board's clock.
fn at_rest(ms: i64) -> Measurement {
    Measurement {
        stamp: Stamp::from_nanos(ms * 1_000_000),
        gyro: [0.0; 3],
        accel: [0.0, 0.0, 9.81],
        theta_p: 0.0,
        theta_p_rate: 0.0,
        theta_r: 0.0,
        theta_r_rate: 0.0,
        status: BoardStatus {
            torque_on: false,
            command_valid: false,
            imu_ok: true,
            encoders_ok: true,
        },
    }
}

/// LIBRARIES, MAVLink: a datagram is a unit. Seven stray bytes that look like the beginning of a frame cost no frame behind them.
#[test]
fn stray_bytes_stall_no_frame() {
    let _alone = ALONE.blocking_lock();
    let (link, board, address) = link_pair();
    let (mut agent, mut writer) = (agent(), FrameWriter::new(BOARD));
    let mut buffer = [0; 2048];
    for i in 0..10_u32 {
        // A start byte, a payload of 200 bytes announced, and then nothing.
        board
            .send_to(&[0xFD, 200, 0, 0, 1, 1, 1], address)
            .expect("loopback");
        let frame = writer
            .sensors(&at_rest(5 * i64::from(i)), i)
            .expect("finite");
        board.send_to(&frame, address).expect("loopback");
        for _ in 0..2 {
            let bytes = link
                .receive(&mut buffer, SECOND)
                .expect("open")
                .expect("sent");
            agent.handle_input(
                START + Span::from_millis(5 * i64::from(i)),
                Input::Motor(bytes),
            );
        }
        assert_eq!(
            agent.frames().frames,
            u64::from(i) + 1,
            "a frame was stalled"
        );
        assert_eq!(agent.frames().cut_off, u64::from(i) + 1);
    }
}

/// LIBRARIES, MAVLink: what a disarmed agent says of itself says not armed, in its very bytes.
#[test]
fn disarmed_agents_heartbeat_says_not_armed() {
    let _alone = ALONE.blocking_lock();
    let mut agent = agent();
    agent.handle_input(START, Input::Timeout);
    let mut reader = FrameReader::new(Framing::Datagrams, BOARD, Some(AGENT.system));
    let mut heartbeats = 0;
    while let Some(output) = agent.poll_output() {
        let Output::Motor(frame) = output else {
            continue;
        };
        // base_mode is byte 6 of the payload, which begins at byte 10; its flag 128 is SAFETY_ARMED.
        let bytes = frame.to_vec();
        let mut rest = &bytes[..];
        while let Some(received) = reader.pull(&mut rest) {
            if let Event::Heartbeat(heartbeat) = received.event {
                heartbeats += 1;
                assert!(!heartbeat.armed);
                assert_eq!(bytes[16] & 128, 0, "SAFETY_ARMED in {bytes:?}");
            }
        }
    }
    assert_eq!(heartbeats, 1);
}

/// LIBRARIES, MAVLink: NaN passes the parser. A sensor frame with one is counted, and no torque follows from it.
#[test]
fn sensor_frame_that_is_not_finite_is_counted_and_moves_nothing() {
    let _alone = ALONE.blocking_lock();
    let (mut agent, mut writer) = (agent(), FrameWriter::new(BOARD));
    let good = writer.sensors(&at_rest(0), 0).expect("finite").to_vec();
    let mut poisoned = 0;
    let mut reader = FrameReader::new(Framing::Datagrams, BOARD, Some(AGENT.system));
    for step in 1..=200_i64 {
        let now = START + Span::from_millis(5 * step);
        // The frame of a measurement, one of its eight floats (behind a u64 and two doubles) overwritten by NaN, and its checksum made right again.
        let mut frame = good.clone();
        let at = 10 + 24 + 4 * (step as usize % 8);
        frame[at..at + 4].copy_from_slice(&f32::NAN.to_le_bytes());
        repair(&mut frame);
        poisoned += 1;
        agent.handle_input(now, Input::Motor(&frame));
        if step % 4 == 0 {
            agent.handle_input(now, Input::Timeout);
        }
        while let Some(output) = agent.poll_output() {
            let Output::Motor(frame) = output else {
                continue;
            };
            let mut rest = &frame[..];
            while let Some(received) = reader.pull(&mut rest) {
                if let Event::Torque(command) = received.event {
                    assert_eq!((command.torque.pitch, command.torque.roll), (0.0, 0.0));
                }
            }
        }
    }
    assert_eq!(agent.frames().invalid, poisoned);
    assert_eq!(agent.frames().frames, 0);
    assert_eq!(agent.mode(), Mode::Boot);
}

/// Writes the right checksum into a MAVLink 2 frame of the sensors message.
fn repair(frame: &mut [u8]) {
    use mavlink::{Message as _, calculate_crc};
    let id = u32::from_le_bytes([frame[7], frame[8], frame[9], 0]);
    let end = 10 + usize::from(frame[1]);
    let extra = sphere_protocol::mavlink::MavMessage::extra_crc(id);
    let checksum = calculate_crc(&frame[1..end], extra).to_le_bytes();
    frame[end..end + 2].copy_from_slice(&checksum);
}
