//! The mode machine of the agent, driven by bytes on a bench: every transition with its reason, and no torque where none is allowed.

#[path = "support/bench.rs"]
mod bench;

use bench::{Bench, Pass, STATION, id};
use sphere_agent::agent::Event;
use sphere_agent::estimator::{EstimatorConfig, StartPose};
use sphere_agent::mode::{Check, Reason};
use sphere_agent::plan::NoPlan;
use sphere_protocol::key::Key;
use sphere_protocol::mavlink::sphere::{SPHERE_SENSORS_DATA, SphereBoardStatus};
use sphere_protocol::message::{
    Command, CommandOrder, DropReason, Mode, PlanId, SetpointPlan, Telemetry,
};
use sphere_protocol::state::Torque;
use sphere_protocol::time::Span;

/// A robot whose position nobody knows at first.
fn lost() -> Bench {
    let mut bench = Bench::with(EstimatorConfig {
        start: StartPose {
            position_sigma: 1.0,
            ..StartPose::default()
        },
        ..EstimatorConfig::default()
    });
    bench.fixes = false;
    bench
}

#[test]
fn every_mode_is_entered_for_a_reason_that_is_told() {
    // DESIGN: "the mode machine, every transition reported with its reason".
    let mut bench = lost();
    bench.run(2.0);
    bench.fixes = true;
    bench.run(2.0);
    bench.command(CommandOrder::Claim);
    bench.command(CommandOrder::Arm);
    bench.run(0.1);
    bench.track(0.3, 1.0);
    bench.run(4.0);
    bench.track(0.3, 1.0);
    bench.command(CommandOrder::Hold);
    bench.run(0.2);
    bench.command(CommandOrder::Resume);
    bench.run(0.1);
    bench.command(CommandOrder::Disarm);
    bench.run(0.1);
    bench.command(CommandOrder::Arm);
    bench.run(0.1);
    bench.alter = Box::new(|_, _| Pass::No);
    bench.run(0.2);
    bench.alter = Box::new(|_, _| Pass::Yes);
    bench.run(0.5);
    assert_eq!(bench.mode(), Mode::Fault, "a fault is latched");
    bench.command(CommandOrder::Disarm);
    bench.run(5.0);
    assert_eq!(
        bench.transitions(),
        [
            (Mode::Boot, Mode::Disarmed, Reason::Converged),
            (Mode::Disarmed, Mode::Ready, Reason::ChecksPass),
            (Mode::Ready, Mode::Idle, Reason::Ordered),
            (Mode::Idle, Mode::Tracking, Reason::PlanBegun),
            (
                Mode::Tracking,
                Mode::Holding,
                Reason::PlanEnded(NoPlan::Exhausted)
            ),
            (Mode::Holding, Mode::Tracking, Reason::PlanBegun),
            (Mode::Tracking, Mode::Holding, Reason::Ordered),
            (Mode::Holding, Mode::Tracking, Reason::PlanBegun),
            (Mode::Tracking, Mode::Disarmed, Reason::Ordered),
            (Mode::Disarmed, Mode::Ready, Reason::ChecksPass),
            (Mode::Ready, Mode::Idle, Reason::Ordered),
            (Mode::Idle, Mode::Fault, Reason::SensorsLost),
            (Mode::Fault, Mode::Disarmed, Reason::Ordered),
            (Mode::Disarmed, Mode::Ready, Reason::ChecksPass),
        ]
    );
}

#[test]
fn arming_is_refused_with_the_check_that_fails() {
    // Status: "at rest and not allowed to move; the reason why it cannot be armed is in Status".
    let mut bench = lost();
    bench.run(2.0);
    bench.command(CommandOrder::Claim);
    bench.command(CommandOrder::Arm);
    bench.run(1.1);
    assert_eq!(bench.mode(), Mode::Disarmed);
    let reason = Reason::CheckFails(Check::Localised);
    let refused = Event::Refused {
        order: CommandOrder::Arm,
        mode: Mode::Disarmed,
        reason,
    };
    assert!(bench.events.iter().any(|(_, event)| *event == refused));
    let status = bench.status.as_ref().expect("published every second");
    assert_eq!(status.reason.as_str(), reason.to_string());
    assert_eq!(bench.last_torque(), None);
}

#[test]
fn a_robot_that_is_not_armed_never_sends_torque_whatever_plans_say() {
    // DESIGN: zero torque is for Disarmed, Fault and a dead agent.
    let mut bench = Bench::new();
    bench.run(2.0);
    bench.command(CommandOrder::Claim);
    bench.track(0.5, 3.0);
    assert_eq!(bench.mode(), Mode::Ready);
    assert_eq!(bench.last_torque(), None);
    assert!(bench.v().abs() < 1e-3);
}

#[test]
fn disarming_is_honoured_from_every_armed_mode_whoever_asks() {
    // CommandOrder::Disarm: "always honoured, whoever asks".
    for (mode, station) in [
        (Mode::Idle, STATION),
        (Mode::Tracking, STATION),
        (Mode::Tracking, 666),
        (Mode::Holding, 666),
        (Mode::Failsafe, 666),
        (Mode::Fault, 666),
    ] {
        let mut bench = Bench::armed();
        match mode {
            Mode::Tracking => bench.track(0.3, 1.0),
            Mode::Holding => bench.command(CommandOrder::Hold),
            Mode::Failsafe => bench.alter = Box::new(without_accelerometer),
            Mode::Fault => bench.alter = Box::new(|_, _| Pass::No),
            _ => {}
        }
        bench.run(0.4);
        assert_eq!(bench.mode(), mode);
        let asked = bench.t();
        bench.command_from(station, CommandOrder::Disarm);
        bench.run(0.5);
        assert!(matches!(bench.mode(), Mode::Disarmed | Mode::Ready));
        let last = bench.last_torque().expect("it was armed");
        assert!(last <= asked, "torque {} s after disarming", last - asked);
    }
}

#[test]
fn plan_past_its_horizon_brings_the_robot_to_rest() {
    // DESIGN: past its horizon the agent brakes at 0.5 m/s² and holds; rest: |v| ≤ 0.02 m/s for 1 s.
    let mut bench = Bench::armed();
    bench.track(0.8, 4.0);
    let end = bench.t() - 0.1 + 2.0;
    bench.run(1.8);
    assert_eq!(bench.mode(), Mode::Tracking);
    let cruising = bench.v();
    assert!((cruising - 0.8).abs() < 0.05, "cruises at {cruising} m/s");
    bench.run(end + 0.02 - bench.t());
    assert_eq!(bench.mode(), Mode::Holding);
    // A reference that falls by 0.5 m/s² is 0.15 m/s lower after 0.3 s; the speed follows.
    bench.run(0.3);
    let setpoint = bench.agent.signals().setpoint;
    assert!((setpoint.v_rate + 0.5).abs() < 1e-12, "{setpoint:?}");
    assert!(setpoint.v < cruising - 0.1, "{setpoint:?}");
    bench.run(0.3);
    assert!(bench.v() < cruising - 0.1, "still {} m/s", bench.v());
    bench.run(4.0);
    let (x, mut fastest) = (bench.body.state().robot.x, 0.0_f64);
    for _ in 0..1000 {
        bench.run(0.001);
        fastest = fastest.max(bench.v().abs());
    }
    println!("at rest: |v| ≤ {fastest:.4} m/s for 1 s");
    assert!(fastest <= 0.02, "still moves at {fastest} m/s");
    bench.run(5.0);
    let moved = (bench.body.state().robot.x - x).abs();
    assert!(moved < 0.02, "holds no place: moved {moved} m in 6 s");
    assert_eq!(bench.mode(), Mode::Holding);
}

#[test]
fn plan_past_its_validity_is_never_tracked() {
    // DESIGN 4: "a plan carries its validity".
    let mut bench = Bench::tracking(0.3, 1.0);
    let plan = SetpointPlan {
        valid_for: Span::from_millis(700),
        ..bench.plan(0.3)
    };
    let ends = bench.t() + (plan.based_on + plan.valid_for - bench.now()).as_secs_f64();
    bench.send_plan(&plan);
    bench.run(1.5);
    let why = Reason::PlanEnded(NoPlan::Expired);
    let last = *bench.transitions().last().expect("it stopped");
    assert_eq!(last, (Mode::Tracking, Mode::Holding, why));
    let late = bench.entered(Mode::Holding) - ends;
    assert!((0.0..=0.02).contains(&late), "held {late} s after its end");

    let late = SetpointPlan {
        valid_for: Span::from_millis(100),
        ..bench.plan(0.3)
    };
    bench.run(0.2);
    bench.send_plan(&late);
    bench.run(0.1);
    assert_eq!(bench.dropped(DropReason::Expired), 1);
    assert_eq!(bench.mode(), Mode::Holding);
}

#[test]
fn plan_in_play_never_goes_back() {
    // DESIGN 2: the agent drops any plan older than the newest by (boot_id, epoch, seq).
    let mut bench = Bench::tracking(0.3, 0.5);
    let mut newest = PlanId::default();
    // Five plans a burst, shuffled as a network that lets packets overtake each other does.
    for order in [[4, 0, 2, 1, 3], [0, 1, 2, 3, 4], [1, 4, 3, 0, 2]] {
        let burst: Vec<_> = (0..5).map(|_| bench.plan(0.3)).collect();
        for i in order {
            bench.send_plan(&burst[i]);
            bench.run(0.02);
            let playing = bench.agent.signals().playing.expect("it is tracking");
            assert!(playing >= newest, "{playing:?} after {newest:?}");
            newest = playing;
        }
        // Whatever the order, the newest is in play in the end.
        assert_eq!(newest, burst[4].id);
    }
    // 4 + 0 + 3 of them came after a newer one.
    assert_eq!(bench.dropped(DropReason::Old), 7);
    // An earlier epoch stays behind, however high its number.
    bench.command(CommandOrder::Claim);
    let old = SetpointPlan {
        id: PlanId {
            epoch: 1,
            seq: 9999,
        },
        ..bench.plan(0.3)
    };
    bench.send_plan(&old);
    assert_eq!(bench.dropped(DropReason::WrongEpoch), 1);
}

#[test]
fn plans_that_are_not_for_this_robot_this_life_this_lease_this_time_are_dropped_and_counted() {
    // Each cause has its own counter in Status.
    let mut bench = Bench::tracking(0.3, 1.0);
    let good = bench.plan(0.3);
    let other: sphere_protocol::robot::RobotId = "r2".parse().expect("valid");
    let strange = SetpointPlan {
        robot: other,
        ..good.clone()
    };
    let ahead = |ms| Span::from_millis(ms);
    let mut fast = good.clone();
    fast.u[3][0] = 9.0;
    let mut steep = good.clone();
    steep.u[19][1] = -1.0;
    for (plan, reason) in [
        (strange, DropReason::WrongRobot),
        (
            SetpointPlan {
                boot_id: 1,
                ..good.clone()
            },
            DropReason::WrongBoot,
        ),
        (
            SetpointPlan {
                id: PlanId {
                    epoch: 99,
                    ..good.id
                },
                ..good.clone()
            },
            DropReason::WrongEpoch,
        ),
        (
            SetpointPlan {
                based_on: bench.now() + ahead(1),
                start: bench.now() + ahead(1),
                ..good.clone()
            },
            DropReason::Future,
        ),
        (
            SetpointPlan {
                start: bench.now() + ahead(60_000),
                valid_for: ahead(100_000),
                ..good.clone()
            },
            DropReason::Future,
        ),
        (fast, DropReason::OutOfRange),
        (steep, DropReason::OutOfRange),
        (
            SetpointPlan {
                start: bench.now() - ahead(2001),
                ..good.clone()
            },
            DropReason::Expired,
        ),
        (
            SetpointPlan {
                id: PlanId {
                    seq: good.id.seq - 1,
                    ..good.id
                },
                ..good.clone()
            },
            DropReason::Old,
        ),
    ] {
        let before = *bench.agent.dropped();
        let newest = bench.agent.playback().newest();
        bench.send_plan(&plan);
        let mut expected = before;
        expected[reason as usize] += 1;
        assert_eq!(*bench.agent.dropped(), expected, "{reason:?}");
        assert_eq!(bench.agent.playback().newest(), newest, "{reason:?}");
    }
    // Wrong keys and topics as well.
    let (key, before) = (Key::of::<Telemetry>(&id()).text(), *bench.agent.dropped());
    bench.send(&key, &[1, 2, 3]);
    bench.send("fleet/v1/r2/down/plan", &[]);
    bench.send("fleet/v1/r1/down/plan", &[0xff; 40]);
    bench.send("nonsense", &[]);
    let mut expected = before;
    expected[DropReason::Unexpected as usize] += 1;
    expected[DropReason::WrongRobot as usize] += 1;
    expected[DropReason::Malformed as usize] += 2;
    assert_eq!(*bench.agent.dropped(), expected);
    bench.send_plan(&good);
    bench.run(0.1);
    assert_eq!(bench.agent.signals().playing, Some(good.id));
}

#[test]
fn a_plan_plays_no_earlier_than_its_start() {
    // SetpointPlan: knot i holds from start + i period on.
    let mut bench = Bench::armed();
    let plan = SetpointPlan {
        start: bench.now() + Span::from_millis(500),
        ..bench.plan(0.3)
    };
    let begins = bench.t() + 0.5;
    bench.send_plan(&plan);
    bench.run(1.0);
    let late = bench.entered(Mode::Tracking) - begins;
    assert!((0.0..=0.02).contains(&late), "began {late} s late");
}

#[test]
fn a_hold_order_outlasts_every_plan_until_resumed() {
    // CommandOrder::Hold: "brake to rest and hold, whatever plans say".
    let mut bench = Bench::tracking(0.5, 2.0);
    bench.command_from(666, CommandOrder::Hold);
    bench.track(0.5, 5.0);
    assert_eq!(bench.mode(), Mode::Holding);
    assert!(bench.v().abs() <= 0.02, "moves at {} m/s", bench.v());
    let telemetry = bench.telemetry.as_ref().expect("published");
    assert_eq!(telemetry.playing, None, "held back is not in play");
    bench.command_from(666, CommandOrder::Resume);
    bench.track(0.5, 0.2);
    assert_eq!(
        bench.mode(),
        Mode::Holding,
        "only its owner sets it in motion"
    );
    bench.command(CommandOrder::Resume);
    bench.track(0.5, 3.0);
    assert_eq!(bench.mode(), Mode::Tracking);
    assert!((bench.v() - 0.5).abs() < 0.05);
}

#[test]
fn a_lease_is_granted_refused_and_passes_on_after_silence() {
    // DESIGN 5: one owner; the agent grants the lease, its epoch fences off any other.
    let mut bench = Bench::new();
    bench.run(2.0);
    bench.command(CommandOrder::Arm);
    assert_eq!(
        bench.dropped(DropReason::WrongEpoch),
        1,
        "nobody's order to arm"
    );
    bench.command(CommandOrder::Claim);
    bench.run(0.8);
    bench.command_from(8, CommandOrder::Claim);
    bench.run(0.3);
    bench.command_from(8, CommandOrder::Claim);
    let leases: Vec<_> = bench
        .events
        .iter()
        .map(|(_, event)| *event)
        .filter(|event| matches!(event, Event::Leased { .. } | Event::LeaseRefused { .. }))
        .collect();
    assert_eq!(
        leases,
        [
            Event::Leased {
                station: STATION,
                epoch: 1
            },
            Event::LeaseRefused {
                station: 8,
                holder: STATION
            },
            Event::Leased {
                station: 8,
                epoch: 2
            },
        ]
    );
    // The first owner lost its say, but for stopping.
    bench.command(CommandOrder::Arm);
    bench.run(0.1);
    assert_eq!(bench.mode(), Mode::Ready);
    bench.command_from(8, CommandOrder::Arm);
    bench.run(0.1);
    assert_eq!(bench.mode(), Mode::Idle);
    assert_eq!(bench.status.as_ref().expect("published").station, 8);
}

#[test]
fn replayed_plans_keep_no_lease() {
    // Only what is new shows that a station lives: a recording must not lock the robot to a dead one.
    let mut bench = Bench::tracking(0.3, 1.0);
    let plan = bench.plan(0.3);
    bench.send_plan(&plan);
    for _ in 0..32 {
        bench.run(0.1);
        bench.send_plan(&plan);
    }
    bench.command_from(8, CommandOrder::Claim);
    let granted = Event::Leased {
        station: 8,
        epoch: 2,
    };
    assert!(bench.events.iter().any(|(_, event)| *event == granted));
}

#[test]
fn a_released_robot_brakes_and_takes_no_more_plans() {
    // CommandOrder::Release gives the lease back: nobody drives any more.
    let mut bench = Bench::tracking(0.5, 2.0);
    bench.command(CommandOrder::Release);
    bench.track(0.5, 4.0);
    assert_eq!(bench.mode(), Mode::Holding);
    assert_eq!(
        bench.transitions().last(),
        Some(&(Mode::Tracking, Mode::Holding, Reason::LeaseChanged))
    );
    assert!(bench.v().abs() <= 0.02);
    assert_eq!(bench.dropped(DropReason::WrongEpoch), 40);
}

#[test]
fn a_repeated_command_is_carried_out_once() {
    // Command: "a repeated or older one is ignored"; the station repeats each until it is acknowledged.
    let mut bench = Bench::armed();
    let command = |number, order| Command {
        robot: id(),
        boot_id: 0x5eed,
        number,
        station: STATION,
        order,
    };
    bench.send_message(&command(50, CommandOrder::Disarm));
    bench.run(0.1);
    bench.send_message(&command(51, CommandOrder::Arm));
    bench.run(0.1);
    assert_eq!(bench.mode(), Mode::Idle);
    bench.send_message(&command(50, CommandOrder::Disarm));
    bench.send_message(&command(51, CommandOrder::Arm));
    bench.run(0.1);
    assert_eq!(bench.mode(), Mode::Idle);
    assert_eq!(bench.dropped(DropReason::Old), 2);
    assert_eq!(bench.telemetry.as_ref().expect("published").command, 51);
}

#[test]
fn shutting_down_brakes_rests_and_ends_without_torque_within_five_seconds() {
    // Input::Shutdown: "brake, rest, then zero torque and Event::Ended".
    for v in [0.0, 0.5, 1.0] {
        let mut bench = Bench::armed();
        bench.track(v, 4.0);
        assert!((bench.v() - v).abs() < 0.05);
        let asked = bench.t();
        bench.shut_down();
        // Nobody sets it in motion again.
        bench.command(CommandOrder::Resume);
        bench.track(v, 6.0);
        let ended = bench
            .events
            .iter()
            .find(|(_, event)| *event == Event::Ended)
            .expect("it ends")
            .0;
        let last = bench.last_torque().expect("it was armed");
        println!(
            "{v} m/s: ended after {:.2} s at {:.4} m/s",
            ended - asked,
            bench.v()
        );
        assert!(ended - asked <= 5.02 && last <= ended);
        assert!(matches!(bench.mode(), Mode::Disarmed | Mode::Ready));
        bench.command(CommandOrder::Arm);
        bench.run(1.0);
        assert!(!matches!(bench.mode(), Mode::Idle), "what ended stays off");
    }
}

#[test]
fn aborting_takes_the_torque_away_with_the_next_step() {
    // Input::Abort: "the program is to end now".
    let mut bench = Bench::tracking(0.5, 1.0);
    let asked = bench.t();
    bench.abort();
    bench.run(0.1);
    assert!(bench.last_torque().expect("it was armed") <= asked);
    assert!(bench.events.iter().any(|(_, event)| *event == Event::Ended));
}

/// What goes wrong with the frames from [s] on.
type Breakage = fn(&mut SPHERE_SENSORS_DATA) -> Pass;

#[test]
fn sensors_that_fail_take_the_torque_away_in_time() {
    // Zero torque within the sensors' time-out of 100 ms, two control periods on top; counted.
    let breakages: [(&str, Breakage, Reason); 6] = [
        ("silence", |_| Pass::No, Reason::SensorsLost),
        (
            "NaN from the gyro",
            |data| {
                data.gyro[1] = f32::NAN;
                Pass::Yes
            },
            Reason::SensorsLost,
        ),
        (
            "infinity from an encoder",
            |data| {
                data.theta_p = f64::INFINITY;
                Pass::Yes
            },
            Reason::SensorsLost,
        ),
        (
            "the board says its IMU failed",
            |data| {
                data.status
                    .remove(SphereBoardStatus::SPHERE_BOARD_STATUS_IMU_OK);
                Pass::Yes
            },
            Reason::SensorFailed,
        ),
        (
            "the board says an encoder failed",
            |data| {
                data.status
                    .remove(SphereBoardStatus::SPHERE_BOARD_STATUS_ENCODERS_OK);
                Pass::Yes
            },
            Reason::SensorFailed,
        ),
        (
            "a stuck clock",
            |data| {
                data.time_usec = 30_000_000;
                Pass::Yes
            },
            Reason::SensorsLost,
        ),
    ];
    for (what, breakage, reason) in breakages {
        let mut bench = Bench::tracking(0.5, 1.0);
        let broken = bench.t();
        bench.alter = Box::new(move |_, data| breakage(data));
        bench.track(0.5, 1.0);
        assert_eq!(bench.mode(), Mode::Fault, "{what}");
        assert_eq!(
            bench.transitions().last(),
            Some(&(Mode::Tracking, Mode::Fault, reason)),
            "{what}"
        );
        let last = bench.last_torque().expect("it was armed") - broken;
        println!("{what}: last torque after {:.0} ms", 1e3 * last);
        assert!(last <= 0.140, "{what}: torque for {last} s");
        // The motors' lag is 8 ms: after 800 ms nothing is left of it.
        let Torque { pitch, roll } = bench.body.torque();
        assert!(
            pitch.abs().max(roll.abs()) < 1e-9,
            "{what}: the motors obey"
        );
    }
    let mut bench = Bench::tracking(0.5, 1.0);
    bench.alter = Box::new(|_, data| {
        data.accel[0] = f32::NAN;
        Pass::Yes
    });
    bench.run(0.1);
    assert_eq!(
        bench.dropped(DropReason::OutOfRange),
        20,
        "each frame is counted"
    );
}

#[test]
fn a_lost_frame_now_and_then_changes_no_mode() {
    // A tenth of the frames missing is no silence of 100 ms.
    let mut bench = Bench::tracking(0.5, 1.0);
    let mut count = 0;
    bench.alter = Box::new(move |_, _| {
        count += 1;
        if count % 10 == 0 { Pass::No } else { Pass::Yes }
    });
    bench.track(0.5, 5.0);
    assert_eq!(bench.mode(), Mode::Tracking);
    assert!((bench.v() - 0.5).abs() < 0.05);
}

fn without_accelerometer(_: f64, data: &mut SPHERE_SENSORS_DATA) -> Pass {
    // Beyond any range: what an unplugged converter shows.
    data.accel = [1e4; 3];
    Pass::Yes
}

#[test]
fn a_failed_accelerometer_ends_in_a_failsafe_that_brakes_holds_and_is_latched() {
    // Mode::Failsafe: "braking to rest and holding after a loss on board; latched until disarmed".
    let mut bench = Bench::tracking(0.5, 2.0);
    let broken = bench.t();
    bench.alter = Box::new(without_accelerometer);
    bench.track(0.5, 4.0);
    assert_eq!(
        bench.transitions().last(),
        Some(&(Mode::Tracking, Mode::Failsafe, Reason::AccelerometerFailed))
    );
    assert!(bench.entered(Mode::Failsafe) - broken <= 0.14);
    assert!(bench.v().abs() <= 0.02, "moves at {} m/s", bench.v());
    bench.alter = Box::new(|_, _| Pass::Yes);
    bench.command(CommandOrder::Arm);
    bench.command(CommandOrder::Resume);
    bench.track(0.5, 1.0);
    assert_eq!(bench.mode(), Mode::Failsafe, "latched");
    bench.command(CommandOrder::Disarm);
    bench.run(2.0);
    bench.command(CommandOrder::Arm);
    bench.track(0.5, 1.0);
    assert_eq!(bench.mode(), Mode::Tracking);
}

#[test]
fn a_board_that_restarts_under_way_stops_the_robot() {
    // Its clock begins again: the estimator has to start anew, in motion, and the plan was made for another estimate.
    let mut bench = Bench::tracking(0.5, 2.0);
    let begin = bench.t();
    bench.alter = Box::new(move |t, data| {
        data.time_usec = (1e6 * (t - begin)).round() as u64;
        Pass::Yes
    });
    bench.track(0.5, 6.0);
    assert_eq!(
        bench.transitions().last(),
        Some(&(Mode::Tracking, Mode::Failsafe, Reason::EstimatorRestarted))
    );
    assert!(bench.v().abs() <= 0.02, "moves at {} m/s", bench.v());
}

#[test]
fn a_pause_of_the_agent_is_counted_and_not_made_up_for() {
    // Deadlines that were missed are skipped: hundreds of stale control steps at once would help nobody.
    let mut bench = Bench::tracking(0.3, 1.0);
    let (steps, beacons) = (bench.torques.len(), bench.beacons);
    bench.sleep(0.07);
    bench.run(0.001);
    assert_eq!(
        bench.torques.len() - steps,
        1,
        "one step for a pause of 70 ms"
    );
    assert!(matches!(bench.agent.overruns(), 2 | 3));
    assert_eq!(bench.mode(), Mode::Tracking);

    bench.sleep(10.0);
    let steps = bench.torques.len();
    bench.run(0.2);
    assert!(
        bench.torques.len() - steps <= 11,
        "{} steps",
        bench.torques.len() - steps
    );
    assert!(bench.agent.overruns() >= 500);
    assert!(bench.beacons - beacons <= 3, "no burst of beacons");
}

#[test]
fn frames_that_waited_while_the_agent_slept_are_no_fresh_ones() {
    // The socket's buffer holds the oldest frames: a robot must not be steered by where it was a second ago.
    let mut bench = Bench::tracking(0.5, 1.0);
    let mut waited = Vec::new();
    std::mem::swap(&mut waited, &mut bench.inputs);
    bench.sleep(0.0);
    let old = waited
        .iter()
        .rev()
        .find_map(|(_, input)| match input {
            bench::Recorded::Motor(bytes) => Some(bytes.clone()),
            _ => None,
        })
        .expect("it heard its board");
    // The world goes on for a second; the agent gets one old frame when it wakes, the rest later.
    let mut newer = bench::sensor_data(&old);
    newer.time_usec += 5000;
    newer.sequence += 1;
    let frame = sphere_protocol::mavlink::FrameWriter::new(sphere_protocol::mavlink::BOARD)
        .message(&sphere_protocol::mavlink::MavMessage::SPHERE_SENSORS(newer))
        .to_vec();
    bench.alter = Box::new(|_, _| Pass::No);
    bench.sleep(1.0);
    bench.motor(&frame);
    bench.run(0.02);
    assert_eq!(
        bench.transitions().last(),
        Some(&(Mode::Tracking, Mode::Fault, Reason::SensorsLost))
    );
}

#[test]
fn arming_again_starts_from_what_the_robot_does_now() {
    // A reference left over from before would jerk the robot, and an old plan would drive it.
    let mut bench = Bench::tracking(0.8, 3.0);
    let plan = bench.plan(0.8);
    bench.send_plan(&plan);
    bench.command(CommandOrder::Disarm);
    bench.run(0.1);
    bench.command(CommandOrder::Arm);
    bench.run(0.02);
    let first = *bench.agent.signals();
    assert_eq!(
        bench.mode(),
        Mode::Idle,
        "the plan from before is forgotten"
    );
    // It coasts at 0.8 m/s or so: braking begins there and not at zero.
    assert!(
        (first.setpoint.v - bench.v()).abs() < 0.1,
        "{first:?} at {} m/s",
        bench.v()
    );
    bench.run(5.0);
    assert!(bench.v().abs() <= 0.02);
}
