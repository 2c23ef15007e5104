//! Endings of the deployed programs, as separate processes under real signals: who knows what after how long (docs/endings.md).

#[path = "support/board.rs"]
mod board;
#[path = "support/process.rs"]
mod process;

use std::net::SocketAddr;
use std::sync::{Arc, Mutex};
use std::thread::sleep;
use std::time::{Duration, Instant};

use board::Board;
use process::{Program, free_port, free_udp_port};
use sphere_protocol::io::bus::{Bus, Declared, Received, Role};
use sphere_protocol::message::{DropReason, Mode, Status, Telemetry};
use sphere_protocol::wire;

const SECOND: Duration = Duration::from_secs(1);

/// A station, an agent and a board whose robot drives the line; and a client of the network that listens.
struct Fleet {
    port: u16,
    board: Board,
    agent: Program,
    station: Program,
}

impl Fleet {
    fn rolling(name: &str, station: Option<u64>) -> Self {
        let port = free_port();
        let board = Board::start(1);
        let station = Program::station(&format!("{name}-station"), station, port);
        let agent = Program::agent(&format!("{name}-agent"), board.agent, board.address, port);
        let fleet = Self {
            port,
            board,
            agent,
            station,
        };
        fleet.rolls(Instant::now());
        fleet
    }

    /// Waits until the robot drives at its mission's speed.
    fn rolls(&self, begin: Instant) {
        self.board
            .first(begin, 30 * SECOND, "the robot drives", |t| t.v > 0.3);
        // Once it is steady.
        sleep(SECOND);
    }
}

/// Hears everything that robots and stations publish, with the time of arrival.
struct Listener {
    bus: Bus,
    heard: Arc<Mutex<Vec<(Instant, Received)>>>,
    _declared: Vec<Declared>,
}

impl Listener {
    fn on(port: u16) -> Self {
        let role = Role::Client {
            connect: vec![format!("tcp/127.0.0.1:{port}")],
        };
        let bus = Bus::open(&role, 5 * SECOND).expect("the station is a router");
        let heard: Arc<Mutex<Vec<_>>> = Arc::default();
        let push = |heard: &Arc<Mutex<Vec<_>>>| {
            let heard = heard.clone();
            move |message: Received| heard.lock().unwrap().push((Instant::now(), message))
        };
        let declared = vec![
            bus.subscribe("fleet/v1/**", push(&heard))
                .expect("a selector"),
            bus.watch_life("fleet/v1/*/up/alive", push(&heard))
                .expect("a selector"),
        ];
        Self {
            bus,
            heard,
            _declared: declared,
        }
    }

    fn since(&self, begin: Instant) -> Vec<(Instant, Received)> {
        let heard = self.heard.lock().unwrap();
        heard
            .iter()
            .filter(|(at, _)| *at >= begin)
            .cloned()
            .collect()
    }

    /// When a message of which `is_it` came first from `begin` on.
    fn first(
        &self,
        begin: Instant,
        limit: Duration,
        what: &str,
        is_it: impl Fn(&Received) -> bool,
    ) -> (Duration, Received) {
        loop {
            if let Some((at, message)) = self.since(begin).into_iter().find(|(_, m)| is_it(m)) {
                return (at - begin, message);
            }
            assert!(begin.elapsed() < limit, "not within {limit:?}: {what}");
            sleep(Duration::from_millis(5));
        }
    }

    fn gone(&self, begin: Instant, limit: Duration) -> Duration {
        self.first(begin, limit, "the sign of life goes", |m| m.gone)
            .0
    }
}

fn status(message: &Received) -> Option<Status> {
    message
        .key
        .ends_with("/up/status")
        .then(|| wire::decode(&message.bytes).ok())?
}

fn telemetry(message: &Received) -> Option<Telemetry> {
    message
        .key
        .ends_with("/up/telemetry")
        .then(|| wire::decode(&message.bytes).ok())?
}

/// Largest change of speed between two truths 20 ms apart [m/s]: what an observer would call a jump.
fn jump(board: &Board, begin: Instant) -> f64 {
    let truths = board.since(begin);
    truths
        .windows(5)
        .map(|pair| {
            (pair[4].v - pair[0].v).abs() / (pair[4].at - pair[0].at).as_secs_f64().max(0.02) * 0.02
        })
        .fold(0.0, f64::max)
}

/// Promise: Ctrl-C on an agent brakes, rests, then zero torque, ≤ 5 s.
#[test]
fn ctrl_c_brakes_to_rest_and_then_ends() {
    let mut fleet = Fleet::rolling("ctrl-c", Some(1));
    let asked = fleet.agent.signal("INT");
    let (status, took) = fleet.agent.ends(6 * SECOND);
    assert!(status.success(), "{status}");
    assert!(took <= 5 * SECOND, "{took:?}");
    // It braked under torque and was at rest before the torque went.
    let last = fleet
        .board
        .since(asked)
        .into_iter()
        .take_while(|t| t.at < asked + took)
        .filter(|t| t.commanded)
        .last()
        .expect("it braked under torque");
    assert!(
        last.v.abs() < 0.05,
        "still {} m/s when the torque went",
        last.v
    );
    let zero = fleet.board.first(asked, 6 * SECOND, "no torque", |t| {
        t.at > asked + took && !t.commanded && t.torque < 0.01
    });
    println!("measured: Ctrl-C to end {took:?}, to zero torque {zero:?}");
    let text = fleet.agent.text();
    assert!(text.contains("control steps, late by p50"), "{text}");
    // The station's robot is silent now: the station has ended nothing by itself.
    fleet.station.signal("TERM");
    let (status, took) = fleet.station.ends(2 * SECOND);
    assert!(status.success(), "{status}");
    println!("measured: station ended after {took:?}");
}

/// Promise: a second Ctrl-C is zero torque now.
#[test]
fn second_ctrl_c_is_zero_torque_now() {
    let mut fleet = Fleet::rolling("twice", Some(1));
    fleet.agent.signal("INT");
    sleep(Duration::from_millis(300));
    let asked = fleet.agent.signal("TERM");
    let zero = fleet.board.first(asked, SECOND, "no torque", |t| {
        t.torque < 0.05 && !t.commanded
    });
    let (status, took) = fleet.agent.ends(SECOND);
    assert!(status.success(), "{status}");
    println!("measured: second Ctrl-C to zero torque {zero:?}, to end {took:?}");
    // One control step, the validity of the last command (60 ms), the motors' lag, and a busy machine.
    assert!(zero < Duration::from_millis(300), "{zero:?}");
    assert!(
        fleet.board.newest().v > 0.1,
        "it was to roll on without torque"
    );
}

/// Promise: a killed station leaves the robot braking to rest and holding; another one picks it up without a jump.
#[test]
fn killed_station_leaves_the_robot_at_rest_and_the_next_one_picks_it_up() {
    let mut fleet = Fleet::rolling("killed", None);
    let killed = fleet.station.signal("KILL");
    let holding = fleet.agent.says(killed, 5 * SECOND, "to=Holding");
    let rest = fleet
        .board
        .first(killed, 8 * SECOND, "rest", |t| t.v.abs() < 0.02);
    println!("measured: station killed to holding {holding:?}, to rest {rest:?}");
    // The horizon of 2 s, and what the last plan lay ahead.
    assert!(holding < Duration::from_millis(2600), "{holding:?}");
    assert!(rest < 5 * SECOND, "{rest:?}");
    sleep(SECOND);
    let held = fleet.board.newest();
    assert!(held.v.abs() < 0.05 && held.commanded, "not held: {held:?}");

    let again = Instant::now();
    fleet.station = Program::station("killed-station-2", None, fleet.port);
    let leased = fleet.station.says(again, 5 * SECOND, "lease granted");
    let tracking = fleet.agent.says(again, 5 * SECOND, "to=Tracking");
    println!("measured: new station to lease {leased:?}, to tracking {tracking:?}");
    assert!(tracking < 3 * SECOND, "{tracking:?}");
    fleet.rolls(again);
    let jump = jump(&fleet.board, again);
    println!("measured: largest change of speed in 20 ms while picked up: {jump:.3} m/s");
    assert!(jump < 0.05, "{jump} m/s in 20 ms");
}

/// A station that is started anew at once, under another identity, has the robot before its last plan has been played: it never
/// has to hold. Its mission begins anew, for which this robot turns round.
#[test]
fn station_restarted_at_once_takes_over_before_the_last_plan_ends() {
    let mut fleet = Fleet::rolling("restart", None);
    let killed = fleet.station.signal("KILL");
    fleet.station.ends(SECOND);
    fleet.station = Program::station("restart-station-2", None, fleet.port);
    let leased = fleet.station.says(killed, 5 * SECOND, "lease granted");
    let started = fleet.station.says(killed, 5 * SECOND, "mission started");
    println!("measured: restarted at once, to lease {leased:?}, to plans {started:?}");
    sleep(2 * SECOND);
    let slowest = fleet
        .board
        .since(killed)
        .iter()
        .map(|t| t.v)
        .fold(f64::INFINITY, f64::min);
    println!(
        "measured: slowest {slowest:.3} m/s, jump {:.3} m/s",
        jump(&fleet.board, killed)
    );
    assert!(
        !fleet.agent.text().contains("to=Holding"),
        "{}",
        fleet.agent.text()
    );
    // To turn round at once it brakes and swings as hard as its limits let it: 0.05 m/s in 20 ms, measured. A jump would be its whole speed.
    assert!(jump(&fleet.board, killed) < 0.1);
}

/// Promise: a killed agent leaves zero torque by the motor link's validity; its next life is not driven by plans for this one.
#[test]
fn killed_agent_leaves_zero_torque_and_its_next_life_ignores_old_plans() {
    let mut fleet = Fleet::rolling("agent", Some(1));
    let listener = Listener::on(fleet.port);
    let (_, old_plan) = listener.first(Instant::now(), 2 * SECOND, "a plan", |m| {
        m.key.ends_with("/down/plan")
    });
    let killed = fleet.agent.signal("KILL");
    fleet.agent.ends(SECOND);
    let silent = fleet
        .board
        .first(killed, SECOND, "no command in force", |t| !t.commanded);
    let zero = fleet
        .board
        .first(killed, SECOND, "no torque", |t| t.torque < 0.05);
    let known = listener.gone(killed, 2 * SECOND);
    println!(
        "measured: agent killed to no command {silent:?}, to zero torque {zero:?}, to others knowing {known:?}"
    );
    assert!(silent < Duration::from_millis(120), "{silent:?}");
    assert!(zero < Duration::from_millis(300), "{zero:?}");
    assert!(known < SECOND, "{known:?}");

    // The station is frozen, so that old plans are all that reach the new life.
    fleet.station.signal("STOP");
    fleet.station.signal("CONT");
    let again = Instant::now();
    fleet.agent = Program::agent(
        "agent-2",
        fleet.board.agent,
        fleet.board.address,
        fleet.port,
    );
    let before = listener.first(again, 5 * SECOND, "status of the new life", |m| {
        status(m).is_some()
    });
    let dropped = |m: &Received| status(m).map_or(0, |s| s.dropped[DropReason::WrongBoot as usize]);
    let before = dropped(&before.1);
    for _ in 0..20 {
        listener
            .bus
            .publish(
                &old_plan.key,
                sphere_protocol::message::Qos::Latest,
                &old_plan.bytes,
            )
            .expect("a plain key");
        sleep(Duration::from_millis(10));
    }
    let (after, _) = listener.first(again, 5 * SECOND, "old plans are counted", |m| {
        dropped(m) >= before + 20
    });
    println!("measured: 20 plans for the earlier life dropped, known {after:?} after the restart");
    fleet.station.says(again, 5 * SECOND, "rebooted");
}

/// Promise: SIGSTOP. A frozen agent: zero torque by the validity, and known to the others within 1 s or so.
#[test]
fn frozen_agent_is_known_within_a_second() {
    let fleet = Fleet::rolling("frozen-agent", Some(1));
    let listener = Listener::on(fleet.port);
    sleep(Duration::from_millis(300));
    let stopped = fleet.agent.signal("STOP");
    let silent = fleet
        .board
        .first(stopped, SECOND, "no command in force", |t| !t.commanded);
    let known = listener.gone(stopped, 3 * SECOND);
    println!("measured: agent frozen to no command {silent:?}, to others knowing {known:?}");
    assert!(silent < Duration::from_millis(120), "{silent:?}");
    assert!(known < Duration::from_millis(1300), "{known:?}");
    // It wakes up in a world that has gone on: from the newest frame that waits for it, or in fault if that is too old.
    let woken = fleet.agent.signal("CONT");
    let back = listener.first(woken, 5 * SECOND, "telemetry again", |m| {
        telemetry(m).is_some()
    });
    println!("measured: woken to telemetry {:?}", back.0);
    let mode = telemetry(&back.1).expect("just decoded").mode;
    println!("measured: mode after waking {mode:?}");
    assert!(
        matches!(
            mode,
            Mode::Fault | Mode::Holding | Mode::Tracking | Mode::Disarmed
        ),
        "{mode:?}"
    );
}

/// Promise: SIGSTOP of the station, which is the router too: the robot plays its plan, brakes and holds; woken, it goes on.
#[test]
fn frozen_station_is_outlived_and_goes_on_when_woken() {
    let fleet = Fleet::rolling("frozen-station", Some(1));
    let stopped = fleet.station.signal("STOP");
    let holding = fleet.agent.says(stopped, 5 * SECOND, "to=Holding");
    let rest = fleet
        .board
        .first(stopped, 8 * SECOND, "rest", |t| t.v.abs() < 0.02);
    println!("measured: station frozen to holding {holding:?}, to rest {rest:?}");
    assert!(holding < Duration::from_millis(2600), "{holding:?}");
    let woken = fleet.station.signal("CONT");
    let tracking = fleet.agent.says(woken, 5 * SECOND, "to=Tracking");
    println!("measured: station woken to tracking {tracking:?}");
    fleet.rolls(woken);
    assert!(jump(&fleet.board, woken) < 0.05);
}

/// Promise: a router apart from station and agent dies and comes back: the robot holds, and both are connected again within 1 s.
#[test]
fn router_that_dies_and_returns_costs_a_second_at_most() {
    let port = free_port();
    let listen = format!("listen = ['tcp/127.0.0.1:{port}']");
    let connect = format!("connect = ['tcp/127.0.0.1:{port}']");
    let mut router = Program::station_with("router", Some(9), &listen, "nobody");
    router.says(Instant::now() - SECOND, 5 * SECOND, "station ready");
    let station = Program::station_with("router-station", Some(1), &connect, "r1");
    let board = Board::start(1);
    let agent = Program::agent("router-agent", board.agent, board.address, port);
    let begin = Instant::now();
    board.first(begin, 30 * SECOND, "the robot drives", |t| t.v > 0.3);
    sleep(SECOND);

    let stopped = router.signal("STOP");
    let holding = agent.says(stopped, 5 * SECOND, "to=Holding");
    println!("measured: router frozen to holding {holding:?}");
    let woken = router.signal("CONT");
    let tracking = agent.says(woken, 5 * SECOND, "to=Tracking");
    println!("measured: router woken to tracking {tracking:?}");
    sleep(2 * SECOND);

    let killed = router.signal("KILL");
    router.ends(SECOND);
    let holding = agent.says(killed, 5 * SECOND, "to=Holding");
    println!("measured: router killed to holding {holding:?}");
    // Counted from its start: the robot may be back before the router's own log says that it is ready.
    let started = Instant::now();
    let router = Program::station_with("router-2", Some(9), &listen, "nobody");
    router.says(started, 5 * SECOND, "station ready");
    let tracking = agent.says(started, 5 * SECOND, "to=Tracking");
    println!("measured: router back to tracking {tracking:?}");
    assert!(tracking < Duration::from_millis(1500), "{tracking:?}");
    drop(station);
}

/// An agent that sleeps for less than its board's frames are kept goes on from the newest of them: nothing was lost.
#[test]
fn agent_that_slept_briefly_goes_on() {
    let fleet = Fleet::rolling("nap", Some(1));
    for nap in [120, 200, 400] {
        let stopped = fleet.agent.signal("STOP");
        sleep(Duration::from_millis(nap));
        let woken = fleet.agent.signal("CONT");
        let torque = fleet
            .board
            .first(woken, SECOND, "torque again", |t| t.commanded);
        sleep(SECOND);
        let slowest = fleet.board.since(stopped).into_iter().map(|t| t.v);
        let slowest = slowest.fold(f64::INFINITY, f64::min);
        println!(
            "measured: {nap} ms asleep, torque {torque:?} after waking, slowest {slowest:.3} m/s"
        );
        assert!(torque < Duration::from_millis(150), "{torque:?}");
        fleet.rolls(woken);
    }
    let text = fleet.agent.text();
    assert!(!text.contains("to=Fault"), "{text}");
}

/// The deployed four, each a process: plants, agent, station, and whatever the router is.
struct Deployed {
    plants: Program,
    agent: Program,
    /// Of the motor link: the agent's, the board's.
    ports: [u16; 2],
    listener: Listener,
}

impl Deployed {
    /// Plants and an agent that is a client of the router on `port`.
    fn start(name: &str, port: u16) -> Self {
        let [agent, board] = [free_udp_port(), free_udp_port()];
        let local = |port| SocketAddr::from(([127, 0, 0, 1], port));
        Self {
            plants: Program::plants(&format!("{name}-plants"), agent, board),
            agent: Program::agent(&format!("{name}-agent"), local(agent), local(board), port),
            ports: [agent, board],
            listener: Listener::on(port),
        }
    }

    /// When its telemetry first said so from `begin` on.
    fn reports(
        &self,
        begin: Instant,
        limit: Duration,
        what: &str,
        is_it: impl Fn(&Telemetry) -> bool,
    ) -> Duration {
        let said = |m: &Received| telemetry(m).is_some_and(|t| is_it(&t));
        self.listener.first(begin, limit, what, said).0
    }

    fn rolls(&self, begin: Instant) -> Duration {
        let took = self.reports(begin, 30 * SECOND, "it drives", |t| {
            t.mode == Mode::Tracking && t.state.v > 0.3
        });
        sleep(SECOND);
        took
    }
}

/// Promise: a board that dies or hangs is a fault with zero torque within 100 ms and a control step. It is latched, whether the board comes
/// back or not, and the station does not arm again by itself.
#[test]
fn dead_or_frozen_plants_are_a_fault_with_zero_torque() {
    for (signal, what) in [("STOP", "frozen"), ("KILL", "killed")] {
        let port = free_port();
        let station = Program::station(&format!("board-{what}-station"), Some(1), port);
        station.says(Instant::now() - SECOND, 5 * SECOND, "station ready");
        let mut fleet = Deployed::start(&format!("board-{what}"), port);
        fleet.rolls(Instant::now());

        let ended = fleet.plants.signal(signal);
        let fault = fleet.agent.says(
            ended,
            2 * SECOND,
            "to=Fault reason=no valid sensor frame for 100 ms",
        );
        let known = fleet.reports(ended, 2 * SECOND, "zero torque", |t| {
            t.mode == Mode::Fault && t.torque == [0.0; 2]
        });
        println!(
            "measured: plants {what} to fault {fault:?}, to others knowing of zero torque {known:?}"
        );
        // 100 ms from the last frame, the next control step, the log line's way here; the next telemetry.
        assert!(fault < Duration::from_millis(200), "{fault:?}");
        assert!(known < Duration::from_millis(300), "{known:?}");

        let latched = Instant::now();
        if signal == "STOP" {
            fleet.plants.signal("CONT");
        } else {
            let [agent, board] = fleet.ports;
            fleet.plants.ends(SECOND);
            fleet.plants = Program::plants("board-again", agent, board);
        }
        sleep(3 * SECOND);
        let heard = fleet.listener.since(latched);
        let telemetry: Vec<_> = heard.iter().filter_map(|(_, m)| telemetry(m)).collect();
        assert!(telemetry.len() > 50, "{} heard", telemetry.len());
        for telemetry in telemetry {
            let Telemetry { mode, torque, .. } = telemetry;
            assert_eq!((mode, torque), (Mode::Fault, [0.0; 2]));
        }
    }
}

/// Neither station nor agent is the router, by configuration alone: examples/station.toml with its other line. The router is a plain
/// Zenoh session; it closes, and a new one takes its place.
#[test]
fn station_of_an_outside_router_drives_its_fleet_through_the_routers_return() {
    let port = free_port();
    let role = Role::Router {
        listen: vec![format!("tcp/127.0.0.1:{port}")],
    };
    let open = || Bus::open(&role, 5 * SECOND).expect("a free port");
    let mut router = open();
    let example = include_str!("../examples/station.toml");
    let [listen, connect] = [
        "listen = [\"tcp/127.0.0.1:7447\"]",
        "# connect = [\"tcp/127.0.0.1:7447\"]",
    ];
    assert!(example.contains(listen) && example.contains(connect));
    let config = example
        .replace(listen, "")
        .replace(connect, &connect[2..])
        .replace("7447", &port.to_string());
    let ground = env!("CARGO_BIN_EXE_sphere-ground");
    let mut station = Program::start(ground, "serve", "outside-station", &config);
    let fleet = Deployed::start("outside", port);
    let begin = Instant::now();
    station.says(begin - SECOND, 5 * SECOND, "client of tcp/127.0.0.1");
    println!("measured: from nothing to driving {:?}", fleet.rolls(begin));

    for away in [Duration::from_millis(900), 3 * SECOND] {
        router.close();
        sleep(away);
        // From the call on: the fleet may be back before it returns.
        let begin = Instant::now();
        router = open();
        let opening = begin.elapsed();
        let heard = fleet.reports(begin, 3 * SECOND, "telemetry", |_| true);
        let (planned, _) = fleet.listener.first(begin, 3 * SECOND, "a plan", |m| {
            m.key.ends_with("/down/plan")
        });
        let tracking = fleet.reports(begin, 3 * SECOND, "it tracks", |t| t.mode == Mode::Tracking);
        println!(
            "measured: router away for {away:?}, opened in {opening:?}: to telemetry {heard:?}, plans {planned:?}, tracking {tracking:?}"
        );
        assert!(planned < opening + SECOND, "{planned:?}");
        assert!(tracking < opening + SECOND, "{tracking:?}");
        fleet.rolls(begin);
    }
    station.signal("TERM");
    assert!(station.ends(2 * SECOND).0.success());
}
