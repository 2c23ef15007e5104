//! The promises of the MAVLink edge: frames as another implementation writes them, every field in its place, nothing hidden by
//! garbage, nothing harmful let through.

use proptest::prelude::*;
use sphere_protocol::mavlink::sphere::{
    PARAM_REQUEST_LIST_DATA, SPHERE_SENSORS_DATA, SPHERE_TORQUE_DATA, SphereBoardStatus,
    VISION_POSITION_ESTIMATE_DATA,
};
use sphere_protocol::mavlink::{
    Address, Event, FrameCounters, FrameReader, FrameWriter, Framing, Heartbeat, MavMessage,
    MavState, Received, TORQUE_SANE, TorqueCommand, VALIDITY_MAX,
};
use sphere_protocol::message::Mode;
use sphere_protocol::state::{BoardStatus, Measurement, PositionFix, Torque};
use sphere_protocol::time::{Instant, Span};

const AGENT: Address = Address {
    system: 1,
    component: 191,
};
const BOARD: Address = Address {
    system: 1,
    component: 1,
};

#[test]
fn sensor_frame_is_the_one_that_pymavlink_writes() {
    let mut board = numbered_from(BOARD, 250);
    let frame = board.sensors(&measurement(), 4_000_000_001).expect("valid");
    assert_golden("sensors", &frame);
    let event = Event::Sensors {
        measurement: measurement(),
        sequence: 4_000_000_001,
    };
    assert_eq!(
        read(AGENT, &frame),
        [Received {
            from: BOARD,
            sequence: 250,
            event
        }]
    );
}

#[test]
fn torque_frame_is_the_one_that_pymavlink_writes() {
    let frame = FrameWriter::new(AGENT).torque(&command()).expect("valid");
    assert_golden("torque", &frame);
    let event = Event::Torque(command());
    assert_eq!(
        read(BOARD, &frame),
        [Received {
            from: AGENT,
            sequence: 0,
            event
        }]
    );
}

/// World X (ours) is MAVLink's y, east; world Y its x, north.
#[test]
fn position_fix_is_the_one_that_pymavlink_writes() {
    let frame = numbered_from(BOARD, 7).fix(&fix()).expect("valid");
    assert_golden("fix", &frame);
    assert_eq!(events(AGENT, &frame), [Event::Fix(fix())]);
}

#[test]
fn heartbeat_is_the_one_that_pymavlink_writes() {
    let frame = numbered_from(AGENT, 255).heartbeat(&Heartbeat::agent(Mode::Tracking));
    assert_golden("heartbeat", &frame);
    assert_eq!(
        events(BOARD, &frame),
        [Event::Heartbeat(Heartbeat::agent(Mode::Tracking))]
    );
}

#[test]
fn message_without_a_type_of_ours_comes_out_as_it_is() {
    let frame = golden("param_request_list");
    let list = PARAM_REQUEST_LIST_DATA {
        target_system: 1,
        target_component: 0,
    };
    let mut reader = FrameReader::new(Framing::Datagrams, AGENT, None);
    let received = reader.pull(&mut &frame[..]).expect("a frame");
    assert_eq!(
        received.from,
        Address {
            system: 255,
            component: 190
        }
    );
    assert_eq!(
        received.event,
        Event::Other(MavMessage::PARAM_REQUEST_LIST(list))
    );
}

/// One changed field changes that field of what arrives and no other: two exchanged ones would show.
#[test]
fn every_sensor_field_arrives_in_its_place() {
    type Change = fn(&mut Measurement);
    let changes: [Change; 15] = [
        |m| m.stamp += Span::from_millis(5),
        |m| m.gyro[0] += 1.0,
        |m| m.gyro[1] += 1.0,
        |m| m.gyro[2] += 1.0,
        |m| m.accel[0] += 1.0,
        |m| m.accel[1] += 1.0,
        |m| m.accel[2] += 1.0,
        |m| m.theta_r = -m.theta_r,
        |m| m.theta_r_rate = -m.theta_r_rate,
        |m| m.theta_p = -m.theta_p,
        |m| m.theta_p_rate = -m.theta_p_rate,
        |m| m.status.torque_on ^= true,
        |m| m.status.command_valid ^= true,
        |m| m.status.imu_ok ^= true,
        |m| m.status.encoders_ok ^= true,
    ];
    for (number, change) in changes.into_iter().enumerate() {
        let mut sent = measurement();
        change(&mut sent);
        assert_ne!(sent, measurement(), "change {number} changes something");
        let frame = FrameWriter::new(BOARD).sensors(&sent, 1).expect("valid");
        let event = Event::Sensors {
            measurement: sent,
            sequence: 1,
        };
        assert_eq!(events(AGENT, &frame), [event], "change {number}");
    }
}

#[test]
fn every_torque_field_arrives_in_its_place() {
    type Change = fn(&mut TorqueCommand);
    let changes: [Change; 4] = [
        |c| c.sequence += 1,
        |c| c.torque.pitch = -c.torque.pitch,
        |c| c.torque.roll = -c.torque.roll,
        |c| c.validity = Span::from_millis(1),
    ];
    for (number, change) in changes.into_iter().enumerate() {
        let mut sent = command();
        change(&mut sent);
        let frame = FrameWriter::new(AGENT).torque(&sent).expect("valid");
        assert_eq!(
            events(BOARD, &frame),
            [Event::Torque(sent)],
            "change {number}"
        );
    }
}

/// A position encoder's count after 10 000 km: a float would have lost it after 360 m.
#[test]
fn encoder_angle_keeps_its_count_however_far_the_robot_has_rolled() {
    let count = core::f64::consts::TAU / 65_536.0;
    let far = 10_000e3 / 0.35;
    for theta in [far, far + count] {
        let sent = Measurement {
            theta_p: theta,
            ..measurement()
        };
        let frame = FrameWriter::new(BOARD).sensors(&sent, 0).expect("valid");
        let event = Event::Sensors {
            measurement: sent,
            sequence: 0,
        };
        assert_eq!(events(AGENT, &frame), [event]);
    }
}

#[test]
fn armed_is_said_in_the_modes_that_turn_motors_and_no_other() {
    let modes = [
        (Mode::Boot, false, MavState::MAV_STATE_BOOT),
        (Mode::Disarmed, false, MavState::MAV_STATE_STANDBY),
        (Mode::Ready, false, MavState::MAV_STATE_STANDBY),
        (Mode::Idle, true, MavState::MAV_STATE_ACTIVE),
        (Mode::Tracking, true, MavState::MAV_STATE_ACTIVE),
        (Mode::Holding, true, MavState::MAV_STATE_ACTIVE),
        (Mode::Failsafe, true, MavState::MAV_STATE_CRITICAL),
        (Mode::Fault, false, MavState::MAV_STATE_EMERGENCY),
    ];
    for (mode, armed, state) in modes {
        let frame = FrameWriter::new(AGENT).heartbeat(&Heartbeat::agent(mode));
        let [Event::Heartbeat(heartbeat)] = &events(BOARD, &frame)[..] else {
            panic!("{mode:?} says no heartbeat");
        };
        assert_eq!(
            (heartbeat.armed, heartbeat.state),
            (armed, state),
            "{mode:?}"
        );
        assert_eq!(heartbeat.custom_mode, mode as u32);
    }
}

#[test]
fn torque_that_cannot_be_meant_is_not_sent() {
    let refused = |change: &dyn Fn(&mut TorqueCommand), field: &str| {
        let mut command = command();
        change(&mut command);
        let error = FrameWriter::new(AGENT).torque(&command).expect_err(field);
        assert_eq!(error.field, field, "{error}");
    };
    for bad in [
        f64::NAN,
        f64::INFINITY,
        f64::NEG_INFINITY,
        1e300,
        TORQUE_SANE * 1.001,
        -TORQUE_SANE * 1.001,
    ] {
        refused(&|c| c.torque.pitch = bad, "torque_pitch");
        refused(&|c| c.torque.roll = bad, "torque_roll");
    }
    let ns = Span::from_nanos;
    for bad in [
        Span::ZERO,
        -VALIDITY_MAX,
        ns(999_999),
        VALIDITY_MAX + ns(1),
        ns(i64::MAX),
        ns(i64::MIN),
    ] {
        refused(&|c| c.validity = bad, "validity_ms");
    }
    refused(&|c| c.target.system = 0, "target_system");
}

#[test]
fn validity_is_rounded_down_to_milliseconds() {
    let sent = TorqueCommand {
        validity: Span::from_nanos(99_999_999),
        ..command()
    };
    let frame = FrameWriter::new(AGENT).torque(&sent).expect("valid");
    let got = TorqueCommand {
        validity: Span::from_millis(99),
        ..command()
    };
    assert_eq!(events(BOARD, &frame), [Event::Torque(got)]);
}

/// NaN passes MAVLink's own parser, and a peer need not be ours.
#[test]
fn torque_that_cannot_be_meant_is_refused_on_arrival() {
    let good = SPHERE_TORQUE_DATA {
        target_system: BOARD.system,
        target_component: BOARD.component,
        sequence: 1,
        torque_pitch: 1.0,
        torque_roll: 1.0,
        validity_ms: 100,
    };
    let bad = [
        SPHERE_TORQUE_DATA {
            torque_pitch: f32::NAN,
            ..good.clone()
        },
        SPHERE_TORQUE_DATA {
            torque_roll: f32::NAN,
            ..good.clone()
        },
        SPHERE_TORQUE_DATA {
            torque_roll: f32::INFINITY,
            ..good.clone()
        },
        SPHERE_TORQUE_DATA {
            torque_pitch: -201.0,
            ..good.clone()
        },
        SPHERE_TORQUE_DATA {
            validity_ms: 0,
            ..good.clone()
        },
        SPHERE_TORQUE_DATA {
            validity_ms: 1001,
            ..good.clone()
        },
        SPHERE_TORQUE_DATA {
            target_system: 0,
            ..good.clone()
        },
    ];
    let mut reader = FrameReader::new(Framing::Datagrams, BOARD, None);
    let frame = FrameWriter::new(AGENT).message(&MavMessage::SPHERE_TORQUE(good));
    assert!(reader.pull(&mut &frame[..]).is_some());
    for (number, data) in bad.into_iter().enumerate() {
        let frame = FrameWriter::new(AGENT).message(&MavMessage::SPHERE_TORQUE(data));
        assert_eq!(reader.pull(&mut &frame[..]), None, "torque {number}");
        assert_eq!(reader.counters().invalid, number as u64 + 1);
    }
}

#[test]
fn sensors_that_are_not_finite_are_refused_both_ways() {
    type Change = fn(&mut Measurement, f64);
    let changes: [Change; 10] = [
        |m, bad| m.gyro[0] = bad,
        |m, bad| m.gyro[1] = bad,
        |m, bad| m.gyro[2] = bad,
        |m, bad| m.accel[0] = bad,
        |m, bad| m.accel[1] = bad,
        |m, bad| m.accel[2] = bad,
        |m, bad| m.theta_r = bad,
        |m, bad| m.theta_r_rate = bad,
        |m, bad| m.theta_p = bad,
        |m, bad| m.theta_p_rate = bad,
    ];
    for bad in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
        for (number, change) in changes.iter().enumerate() {
            let mut sample = measurement();
            change(&mut sample, bad);
            FrameWriter::new(BOARD)
                .sensors(&sample, 0)
                .expect_err("not finite");
            let data = SPHERE_SENSORS_DATA {
                time_usec: 1,
                theta_r: sample.theta_r,
                theta_p: sample.theta_p,
                theta_r_rate: sample.theta_r_rate as f32,
                theta_p_rate: sample.theta_p_rate as f32,
                gyro: sample.gyro.map(|value| value as f32),
                accel: sample.accel.map(|value| value as f32),
                sequence: 0,
                status: SphereBoardStatus::empty(),
            };
            let frame = FrameWriter::new(BOARD).message(&MavMessage::SPHERE_SENSORS(data));
            let mut reader = FrameReader::new(Framing::Datagrams, AGENT, None);
            assert_eq!(
                reader.pull(&mut &frame[..]),
                None,
                "change {number} to {bad}"
            );
            assert_eq!(reader.counters().invalid, 1);
        }
    }
}

#[test]
fn stamps_outside_the_boards_clock_are_refused_both_ways() {
    let early = Measurement {
        stamp: Instant::from_nanos(-1),
        ..measurement()
    };
    FrameWriter::new(BOARD)
        .sensors(&early, 0)
        .expect_err("before the origin");
    let late = VISION_POSITION_ESTIMATE_DATA {
        usec: u64::MAX,
        ..vision()
    };
    assert_refused(late);
}

#[test]
fn fix_that_cannot_be_weighed_is_refused() {
    FrameWriter::new(BOARD)
        .fix(&PositionFix {
            sigma: 0.0,
            ..fix()
        })
        .expect_err("no sigma");
    FrameWriter::new(BOARD)
        .fix(&PositionFix {
            x: f64::NAN,
            ..fix()
        })
        .expect_err("no position");
    assert_refused(VISION_POSITION_ESTIMATE_DATA {
        covariance: [f32::NAN; 21],
        ..vision()
    });
    assert_refused(VISION_POSITION_ESTIMATE_DATA {
        covariance: [0.0; 21],
        ..vision()
    });
    assert_refused(VISION_POSITION_ESTIMATE_DATA {
        x: f32::NAN,
        ..vision()
    });
    assert_refused(VISION_POSITION_ESTIMATE_DATA {
        y: f32::INFINITY,
        ..vision()
    });
}

#[test]
fn worse_axis_of_a_fix_counts_for_both() {
    let mut data = vision();
    data.covariance[6] = 0.25;
    let frame = FrameWriter::new(BOARD).message(&MavMessage::VISION_POSITION_ESTIMATE(data));
    let worse = PositionFix {
        x: 2.0,
        y: 1.0,
        sigma: 0.5,
        stamp: Instant::from_nanos(1_000),
    };
    assert_eq!(events(AGENT, &frame), [Event::Fix(worse)]);
}

/// Bits 4 to 7 of the status mean nothing yet.
#[test]
fn flags_that_a_newer_board_adds_are_ignored() {
    let frame = FrameWriter::new(BOARD)
        .sensors(&measurement(), 3)
        .expect("valid");
    let mut payload = frame[10..frame.len() - 2].to_vec();
    *payload.last_mut().expect("the status is the last byte") |= 0xf0;
    let event = Event::Sensors {
        measurement: measurement(),
        sequence: 3,
    };
    assert_eq!(events(AGENT, &frame_of(53_000, &payload)), [event]);
}

#[test]
fn frames_fed_byte_by_byte_arrive() {
    let frames = three_frames();
    let mut reader = FrameReader::new(Framing::Stream, AGENT, Some(BOARD.system));
    let mut got = Vec::new();
    for byte in frames.concat() {
        got.extend(reader.pull(&mut &[byte][..]));
    }
    assert_eq!(sequences(&got), [0, 1, 2]);
    assert_eq!(
        reader.counters(),
        &FrameCounters {
            frames: 3,
            ..FrameCounters::default()
        }
    );
}

#[test]
fn garbage_between_frames_hides_none() {
    let frames = three_frames();
    // Starts of frames that never end: of a known message, of an unknown one, with unknown flags, of MAVLink 1.
    let known = [0xfd, 255, 0, 0, 0, 1, 1, 0x08, 0xcf, 0x00, 1, 2, 3];
    let unknown = [0xfd, 255, 0, 0, 0, 1, 1, 0xff, 0xff, 0xff];
    let flags = [0xfd, 9, 0x80, 0, 0, 1, 1, 0, 0, 0];
    let version_1 = [0xfe, 9, 0, 1, 1, 0];
    let garbage: [&[u8]; 7] = [
        b"hello",
        &[0xfd; 40],
        &known,
        &unknown,
        &flags,
        &version_1,
        &[0; 300],
    ];
    for noise in garbage {
        for framing in [Framing::Stream, Framing::Datagrams] {
            let mut bytes = noise.to_vec();
            for frame in &frames {
                bytes.extend(frame);
                bytes.extend(noise);
            }
            // What a stream holds back for a frame that seems long comes out once enough has followed.
            bytes.extend([0; 300]);
            let mut reader = FrameReader::new(framing, AGENT, Some(BOARD.system));
            let got = pull_all(&mut reader, &bytes);
            assert_eq!(sequences(&got), [0, 1, 2], "{framing:?} with {noise:02x?}");
        }
    }
}

/// Seven stray bytes that promise a long frame: as a stream they would stall what follows, datagrams are whole.
#[test]
fn stray_datagram_delays_nothing() {
    let stray = [0xfd, 255, 0, 0, 0, 1, 1];
    let mut reader = FrameReader::new(Framing::Datagrams, AGENT, Some(BOARD.system));
    for frame in three_frames() {
        assert_eq!(pull_all(&mut reader, &stray), []);
        assert_eq!(pull_all(&mut reader, &frame).len(), 1);
    }
    let expected = FrameCounters {
        frames: 3,
        cut_off: 3,
        garbage_bytes: 21,
        ..FrameCounters::default()
    };
    assert_eq!(reader.counters(), &expected);
}

#[test]
fn frame_cut_off_by_its_datagram_is_counted_and_gone() {
    let [first, second, _] = three_frames();
    let mut reader = FrameReader::new(Framing::Datagrams, AGENT, Some(BOARD.system));
    for cut in 1..first.len() {
        assert_eq!(pull_all(&mut reader, &first[..cut]), [], "cut at {cut}");
    }
    assert_eq!(reader.counters().cut_off, first.len() as u64 - 1);
    assert_eq!(sequences(&pull_all(&mut reader, &second)), [1]);
}

/// A CRC of 16 bits notices each of them.
#[test]
fn every_flipped_bit_is_noticed() {
    let frame = FrameWriter::new(BOARD)
        .sensors(&measurement(), 9)
        .expect("valid");
    for bit in 0..8 * frame.len() {
        let mut flipped = frame.clone();
        flipped[bit / 8] ^= 1 << (bit % 8);
        let mut reader = FrameReader::new(Framing::Datagrams, AGENT, Some(BOARD.system));
        assert_eq!(pull_all(&mut reader, &flipped), [], "bit {bit}");
        assert_eq!(reader.counters().frames, 0);
    }
}

#[test]
fn foreign_senders_and_foreign_targets_are_counted() {
    let stranger = Address {
        system: 2,
        component: 1,
    };
    let mut reader = FrameReader::new(Framing::Datagrams, AGENT, Some(BOARD.system));
    let frame = FrameWriter::new(stranger)
        .sensors(&measurement(), 0)
        .expect("valid");
    assert_eq!(pull_all(&mut reader, &frame), []);
    assert_eq!(
        reader.counters(),
        &FrameCounters {
            foreign: 1,
            ..FrameCounters::default()
        }
    );

    let mut reader = FrameReader::new(Framing::Datagrams, BOARD, None);
    for target in [
        stranger,
        Address {
            component: 2,
            ..BOARD
        },
    ] {
        let other = TorqueCommand {
            target,
            ..command()
        };
        let frame = FrameWriter::new(AGENT).torque(&other).expect("valid");
        assert_eq!(pull_all(&mut reader, &frame), [], "{target:?}");
    }
    assert_eq!(
        reader.counters(),
        &FrameCounters {
            foreign: 2,
            ..FrameCounters::default()
        }
    );

    let all = TorqueCommand {
        target: Address {
            component: 0,
            ..BOARD
        },
        ..command()
    };
    let frame = FrameWriter::new(AGENT).torque(&all).expect("valid");
    assert_eq!(pull_all(&mut reader, &frame).len(), 1);
}

/// GPS_RAW_INT (24) is no message of the dialect, and its content is no evidence: one unknown frame, nothing else.
#[test]
fn unknown_message_is_counted_once() {
    let mut frame = vec![0xfd, 30, 0, 0, 0, 1, 1, 24, 0, 0];
    frame.extend([0xfd; 30]);
    frame.extend([0x12, 0x34]);
    let [first, ..] = three_frames();
    for framing in [Framing::Stream, Framing::Datagrams] {
        let mut reader = FrameReader::new(framing, AGENT, None);
        assert_eq!(
            pull_all(&mut reader, &[&frame[..], &first[..]].concat()).len(),
            1
        );
        let expected = FrameCounters {
            frames: 1,
            unknown: 1,
            ..FrameCounters::default()
        };
        assert_eq!(reader.counters(), &expected, "{framing:?}");
    }
}

#[test]
fn unknown_member_of_an_enum_is_invalid() {
    let mut frame = golden("heartbeat");
    frame[10 + 4] = 250;
    let end = frame.len() - 2;
    let crc = mavlink::calculate_crc(&frame[1..end], 50).to_le_bytes();
    frame[end..].copy_from_slice(&crc);
    let mut reader = FrameReader::new(Framing::Datagrams, BOARD, None);
    assert_eq!(pull_all(&mut reader, &frame), []);
    assert_eq!(
        reader.counters(),
        &FrameCounters {
            invalid: 1,
            ..FrameCounters::default()
        }
    );
}

#[test]
fn signed_frame_is_read_and_its_signature_stepped_over() {
    let mut frame = golden("heartbeat");
    frame[2] = 1;
    let end = frame.len() - 2;
    let crc = mavlink::calculate_crc(&frame[1..end], 50).to_le_bytes();
    frame[end..].copy_from_slice(&crc);
    frame.extend([0xfd; 13]);
    frame.extend(golden("torque"));
    let mut reader = FrameReader::new(Framing::Datagrams, BOARD, None);
    assert_eq!(pull_all(&mut reader, &frame).len(), 2);
    assert_eq!(
        reader.counters(),
        &FrameCounters {
            frames: 2,
            ..FrameCounters::default()
        }
    );
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(10_000))]

    #[test]
    fn arbitrary_bytes_never_panic(
        bytes in proptest::collection::vec(any::<u8>(), 0..600),
        framing in any_framing(),
    ) {
        let mut reader = FrameReader::new(framing, AGENT, None);
        pull_all(&mut reader, &bytes);
    }

    /// Well-formed frames of every message with arbitrary payloads: what comes out is finite.
    #[test]
    fn arbitrary_payloads_never_panic(
        id in proptest::sample::select(MavMessage::all_ids()),
        payload in proptest::collection::vec(any::<u8>(), 0..255),
    ) {
        let frame = frame_of(id, &payload);
        let mut reader = FrameReader::new(Framing::Datagrams, AGENT, None);
        for received in pull_all(&mut reader, &frame) {
            match received.event {
                Event::Sensors { measurement: m, .. } => {
                    let angles = [m.theta_r, m.theta_r_rate, m.theta_p, m.theta_p_rate];
                    let mut all = m.gyro.into_iter().chain(m.accel).chain(angles);
                    prop_assert!(all.all(f64::is_finite));
                }
                Event::Fix(fix) => prop_assert!(fix.x.is_finite() && fix.y.is_finite() && fix.sigma > 0.0),
                Event::Torque(c) => {
                    prop_assert!(c.torque.pitch.abs() <= TORQUE_SANE && c.torque.roll.abs() <= TORQUE_SANE);
                    prop_assert!(c.validity > Span::ZERO && c.validity <= VALIDITY_MAX);
                }
                Event::Heartbeat(_) | Event::Other(_) => {}
            }
        }
    }

    /// However a stream is cut into pieces and whatever noise is around, the frames come out in order.
    #[test]
    fn stream_is_read_alike_in_any_pieces(
        noise in proptest::collection::vec(any::<u8>(), 0..80),
        piece in 1..50_usize,
    ) {
        let mut bytes = Vec::new();
        for frame in three_frames() {
            bytes.extend(&noise);
            bytes.extend(frame);
        }
        bytes.extend([0; 300]);
        let mut whole = FrameReader::new(Framing::Stream, AGENT, Some(BOARD.system));
        let expected = pull_all(&mut whole, &bytes);
        prop_assert_eq!(sequences(&expected), [0, 1, 2]);
        let mut pieces = FrameReader::new(Framing::Stream, AGENT, Some(BOARD.system));
        let got: Vec<_> = bytes.chunks(piece).flat_map(|piece| pull_all(&mut pieces, piece)).collect();
        prop_assert_eq!(got, expected);
        prop_assert_eq!(pieces.counters(), whole.counters());
    }

    #[test]
    fn any_torque_round_trips(
        pitch in -200.0..200.0_f32,
        roll in -200.0..200.0_f32,
        ms in 1..=1000_i64,
        sequence in any::<u32>(),
        target in (1..=255_u8, any::<u8>()),
    ) {
        let sent = TorqueCommand {
            target: Address { system: target.0, component: target.1 },
            sequence,
            torque: Torque { pitch: pitch.into(), roll: roll.into() },
            validity: Span::from_millis(ms),
        };
        let frame = FrameWriter::new(AGENT).torque(&sent).expect("valid");
        prop_assert_eq!(events(sent.target, &frame), [Event::Torque(sent)]);
    }

    #[test]
    fn any_fix_round_trips(x in -1e6..1e6_f32, y in -1e6..1e6_f32, sigma in 1e-4..1e3_f64, us in 0..1_i64 << 50) {
        let sent = PositionFix { stamp: Instant::from_nanos(1000 * us), x: x.into(), y: y.into(), sigma };
        let frame = FrameWriter::new(BOARD).fix(&sent).expect("valid");
        let got = events(AGENT, &frame);
        let [Event::Fix(got)] = &got[..] else { panic!("{got:?}") };
        prop_assert_eq!((got.stamp, got.x, got.y), (sent.stamp, sent.x, sent.y));
        // The variance is an f32: half of its relative rounding remains in the root.
        prop_assert!((got.sigma / sigma - 1.0).abs() < 4e-8, "{} for {sigma}", got.sigma);
    }
}

fn any_framing() -> impl Strategy<Value = Framing> {
    prop_oneof![Just(Framing::Stream), Just(Framing::Datagrams)]
}

fn pull_all(reader: &mut FrameReader, mut bytes: &[u8]) -> Vec<Received> {
    std::iter::from_fn(|| reader.pull(&mut bytes)).collect()
}

fn read(own: Address, bytes: &[u8]) -> Vec<Received> {
    pull_all(&mut FrameReader::new(Framing::Datagrams, own, None), bytes)
}

fn events(own: Address, bytes: &[u8]) -> Vec<Event> {
    read(own, bytes)
        .into_iter()
        .map(|received| received.event)
        .collect()
}

fn sequences(received: &[Received]) -> Vec<u32> {
    let sequence = |received: &Received| match &received.event {
        Event::Sensors { sequence, .. } => *sequence,
        other => panic!("{other:?}"),
    };
    received.iter().map(sequence).collect()
}

fn assert_refused(data: VISION_POSITION_ESTIMATE_DATA) {
    let frame =
        FrameWriter::new(BOARD).message(&MavMessage::VISION_POSITION_ESTIMATE(data.clone()));
    let mut reader = FrameReader::new(Framing::Datagrams, AGENT, None);
    assert_eq!(pull_all(&mut reader, &frame), [], "{data:?}");
    assert_eq!(
        reader.counters(),
        &FrameCounters {
            invalid: 1,
            ..FrameCounters::default()
        }
    );
}

/// The bytes of `frame` are those that pymavlink wrote from the same definitions (tests/golden/mavlink_generate.py).
fn assert_golden(name: &str, frame: &[u8]) {
    assert_eq!(
        frame,
        golden(name),
        "the frame of {name} changed: boards in the field speak the old one"
    );
}

fn golden(name: &str) -> Vec<u8> {
    let golden: serde_json::Value =
        serde_json::from_str(include_str!("golden/mavlink.json")).expect("JSON");
    let hex = golden["mavlink"][name].as_str().expect("hex");
    let byte = |at| u8::from_str_radix(&hex[at..at + 2], 16).expect("hex");
    (0..hex.len()).step_by(2).map(byte).collect()
}

/// A writer whose next frame has number `sequence`.
fn numbered_from(own: Address, sequence: u8) -> FrameWriter {
    let mut writer = FrameWriter::new(own);
    for _ in 0..sequence {
        writer.heartbeat(&Heartbeat::board(false));
    }
    writer
}

/// A well-formed frame from the board with `payload` for message `id`.
fn frame_of(id: u32, payload: &[u8]) -> Vec<u8> {
    use mavlink::Message;
    let [low, middle, high, _] = id.to_le_bytes();
    let mut frame = vec![
        0xfd,
        payload.len() as u8,
        0,
        0,
        0,
        BOARD.system,
        BOARD.component,
        low,
        middle,
        high,
    ];
    frame.extend(payload);
    let crc = mavlink::calculate_crc(&frame[1..], MavMessage::extra_crc(id));
    frame.extend(crc.to_le_bytes());
    frame
}

fn three_frames() -> [Vec<u8>; 3] {
    let mut board = FrameWriter::new(BOARD);
    [0, 1, 2].map(|sequence| {
        board
            .sensors(&measurement(), sequence)
            .expect("valid")
            .to_vec()
    })
}

/// Every value differs from every other, and is exact as f32 where it travels as one.
fn measurement() -> Measurement {
    Measurement {
        stamp: Instant::from_nanos(12_345_678_901_000),
        gyro: [0.125, -0.375, 0.625],
        accel: [1.5, -2.5, 9.75],
        theta_r: 1234.56789,
        theta_r_rate: 0.5,
        theta_p: -98765.4321,
        theta_p_rate: -0.25,
        status: BoardStatus {
            torque_on: true,
            command_valid: false,
            imu_ok: true,
            encoders_ok: false,
        },
    }
}

fn command() -> TorqueCommand {
    TorqueCommand {
        target: BOARD,
        sequence: 70_000,
        torque: Torque {
            pitch: 2.5,
            roll: -3.75,
        },
        validity: Span::from_millis(250),
    }
}

fn fix() -> PositionFix {
    PositionFix {
        stamp: Instant::from_nanos(5_000_000_000),
        x: 1.5,
        y: -2.5,
        sigma: 0.25,
    }
}

fn vision() -> VISION_POSITION_ESTIMATE_DATA {
    let mut covariance = [f32::NAN; 21];
    (covariance[0], covariance[1], covariance[6]) = (0.01, 0.0, 0.01);
    VISION_POSITION_ESTIMATE_DATA {
        usec: 1,
        x: 1.0,
        y: 2.0,
        z: 0.0,
        roll: f32::NAN,
        pitch: f32::NAN,
        yaw: f32::NAN,
        covariance,
        reset_counter: 0,
    }
}
