//! The promises of the wire: every message survives it, its bytes never drift, and no bytes at all harm a receiver.

use arrayvec::{ArrayString, ArrayVec};
use proptest::prelude::*;
use sphere_protocol::message::{
    Beacon, Command, CommandOrder, DropReason, KNOTS_MAX, Mode, PlanId, PlanSource, SetpointPlan,
    Status, Telemetry,
};
use sphere_protocol::robot::RobotId;
use sphere_protocol::state::RobotState;
use sphere_protocol::time::{Instant, Span};
use sphere_protocol::wire::{self, Buffer, EncodeError, Wire, WireError, decode};

/// One datagram on any link of the fleet [bytes].
const DATAGRAM: usize = 1450;

#[test]
fn telemetry_has_these_bytes() {
    assert_golden(&telemetry(), "telemetry");
}

#[test]
fn telemetry_without_a_plan_has_these_bytes() {
    let idle = Telemetry {
        playing: None,
        newest: None,
        loop_delay: None,
        ..telemetry()
    };
    assert_golden(&idle, "telemetry_idle");
}

#[test]
fn plan_has_these_bytes() {
    assert_golden(&plan(2), "plan");
}

#[test]
fn plan_without_gains_has_these_bytes() {
    let open = SetpointPlan {
        k: ArrayVec::new(),
        ..plan(1)
    };
    assert_golden(&open, "plan_open");
}

#[test]
fn command_has_these_bytes() {
    assert_golden(&command(), "command");
}

#[test]
fn status_has_these_bytes() {
    assert_golden(&status(), "status");
}

#[test]
fn beacon_has_these_bytes() {
    assert_golden(&beacon(), "beacon");
}

/// The design's promise, at the dearest values: the longest names, stamps and gains that N = 20 and eight characters allow.
#[test]
fn plan_of_twenty_knots_with_gains_fits_one_datagram() {
    let mut plan = plan(20);
    plan.robot = id("robot-08");
    plan.boot_id = u64::MAX;
    plan.id = PlanId {
        epoch: u32::MAX,
        seq: u32::MAX,
    };
    for based_on in [i64::MIN, -1, 0, i64::MAX / 2] {
        plan.based_on = Instant::from_nanos(based_on);
        plan.start = plan.based_on + Span::from_millis(4_000);
        plan.period = Span::from_nanos(3_999_999_999);
        plan.valid_for = Span::from_millis(59_999);
        let size = bytes(&plan).len();
        println!("based_on {based_on}: {size} bytes");
        assert!(size <= DATAGRAM, "{size} bytes at based_on {based_on}");
    }
}

#[test]
fn largest_plan_round_trips() {
    let mut plan = plan(KNOTS_MAX);
    plan.robot = id(&"r".repeat(32));
    println!("{} bytes", bytes(&plan).len());
    assert_round_trip(&plan);
}

#[test]
fn every_mode_order_and_source_round_trips() {
    let modes = [
        Mode::Boot,
        Mode::Disarmed,
        Mode::Ready,
        Mode::Idle,
        Mode::Tracking,
        Mode::Holding,
        Mode::Failsafe,
        Mode::Fault,
    ];
    for (number, mode) in modes.into_iter().enumerate() {
        assert_eq!(mode as usize, number);
        assert_round_trip(&Telemetry {
            mode,
            ..telemetry()
        });
        assert_round_trip(&Status { mode, ..status() });
    }
    let orders = [
        CommandOrder::Claim,
        CommandOrder::Release,
        CommandOrder::Arm,
        CommandOrder::Disarm,
        CommandOrder::Hold,
        CommandOrder::Resume,
    ];
    for (number, order) in orders.into_iter().enumerate() {
        assert_eq!(order as usize, number);
        assert_round_trip(&Command { order, ..command() });
    }
    let sources = [
        PlanSource::Riccati,
        PlanSource::Clarabel,
        PlanSource::Shifted,
        PlanSource::Steps,
        PlanSource::Course,
    ];
    for (number, source) in sources.into_iter().enumerate() {
        assert_eq!(source as usize, number);
        assert_round_trip(&SetpointPlan { source, ..plan(3) });
    }
}

/// Positions travel as f64; what is measured in m/s, rad and N·m as f32.
#[test]
fn positions_are_exact_and_the_rest_is_rounded_to_f32() {
    let mut sent = telemetry();
    sent.state.x = 1_234.567_890_123_4;
    sent.state.heading = -987.654_321_098_7;
    sent.state.v = 0.1;
    let got: Telemetry = decode(&bytes(&sent)).expect("valid");
    assert_eq!(got.state.x, sent.state.x);
    assert_eq!(got.state.heading, sent.state.heading);
    assert_eq!(got.state.v, f64::from(0.1_f32));
}

#[test]
fn validity_is_rounded_down_to_milliseconds() {
    let mut sent = plan(2);
    sent.valid_for = Span::from_nanos(1_499_999_999);
    let got: SetpointPlan = decode(&bytes(&sent)).expect("valid");
    assert_eq!(got.valid_for, Span::from_millis(1_499));
}

#[test]
fn another_major_version_is_refused_by_name() {
    fn check<M: Wire + std::fmt::Debug>(message: &M) {
        let mut doctored = bytes(message);
        doctored[1] = 9;
        doctored[2] = 4;
        let error = decode::<M>(&doctored).expect_err("another major version");
        assert_eq!(error.reason(), DropReason::Version);
        let text = error.to_string();
        for part in ["9.4", "1.x", M::TOPIC] {
            assert!(text.contains(part), "`{text}` does not name {part}");
        }
    }
    check(&telemetry());
    check(&plan(2));
    check(&command());
    check(&status());
    check(&beacon());
}

/// Even where the body is nothing this version could read.
#[test]
fn another_major_version_is_refused_whatever_follows() {
    let error = decode::<Beacon>(&[0x83, 2, 0, 0xf6]).expect_err("version 2");
    assert_eq!(error.reason(), DropReason::Version);
}

#[test]
fn newer_minor_version_and_unknown_keys_are_ignored() {
    fn check<M: Wire + PartialEq + std::fmt::Debug>(message: &M) {
        let mut doctored = bytes(message);
        doctored[2] = 7;
        assert_eq!(doctored[3] & 0xe0, 0xa0, "a map of fewer than 24 fields");
        doctored[3] += 5;
        // 23: [1, "a"], 200: {0: h'00'}, -1: 2.5 (f16), 2^40: tag 85 h'', "later": null
        doctored.extend([
            0x17, 0x82, 0x01, 0x61, b'a', 0x18, 200, 0xa1, 0x00, 0x41, 0x00,
        ]);
        doctored.extend([0x20, 0xf9, 0x41, 0x00]);
        doctored.extend([0x1b, 0, 0, 1, 0, 0, 0, 0, 0, 0xd8, 85, 0x40]);
        doctored.extend([0x65, b'l', b'a', b't', b'e', b'r', 0xf6]);
        assert_eq!(&decode::<M>(&doctored).expect("unknown keys"), message);
    }
    check(&telemetry());
    check(&plan(2));
    check(&command());
    check(&status());
    check(&beacon());
}

#[test]
fn truncated_at_every_length_is_malformed() {
    fn check<M: Wire + std::fmt::Debug>(message: &M) {
        let whole = bytes(message);
        for length in 0..whole.len() {
            let error = decode::<M>(&whole[..length]).expect_err("cut off");
            assert_eq!(
                error.reason(),
                DropReason::Malformed,
                "{length} bytes: {error}"
            );
        }
    }
    check(&telemetry());
    check(&plan(3));
    check(&command());
    check(&status());
    check(&beacon());
}

#[test]
fn trailing_bytes_are_malformed() {
    fn check<M: Wire + std::fmt::Debug>(message: &M) {
        let mut longer = bytes(message);
        longer.push(0);
        let error = decode::<M>(&longer).expect_err("trailing byte");
        assert_eq!(error.reason(), DropReason::Malformed);
    }
    check(&telemetry());
    check(&plan(2));
    check(&command());
    check(&status());
    check(&beacon());
}

#[test]
fn every_missing_required_key_is_malformed() {
    // Keys 12, 13 and 14 of telemetry and 4 of a plan are optional.
    fn check<M: Wire + std::fmt::Debug>(message: &M, required: u8) {
        for key in 0..required {
            let mut doctored = bytes(message);
            let at = position_of_key(&doctored, key);
            // Key 23 means nothing: the field is there no more.
            doctored[at] = 23;
            let error = decode::<M>(&doctored).expect_err("a missing field");
            assert_eq!(error.reason(), DropReason::Malformed, "key {key}");
            assert!(
                error.to_string().contains("is missing"),
                "key {key}: {error}"
            );
        }
    }
    check(&telemetry(), 12);
    check(&plan(2), 4);
    check(&command(), 5);
    check(&status(), 10);
    check(&beacon(), 6);
}

#[test]
fn key_named_twice_is_malformed() {
    let mut doctored = bytes(&command());
    let at = position_of_key(&doctored, 3);
    doctored[at] = 2;
    let error = decode::<Command>(&doctored).expect_err("twice");
    assert!(error.to_string().contains("twice"), "{error}");
}

/// What a writer in another language may do: keys in any order, every float as f64, integers longer than needed.
#[test]
fn another_writers_habits_are_read() {
    let mut other = vec![0x83, 1, 0, 0xa6];
    other.extend([0x05, 0xfb]);
    other.extend(f64::to_be_bytes(0.35_f32.into()));
    other.extend([0x04, 0xd8, 85, 0x48]);
    other.extend([-0.25_f32, 0.5].map(f32::to_le_bytes).as_flattened());
    other.extend([0x03, 0xd8, 86, 0x50]);
    other.extend([1.5_f64, -2.25].map(f64::to_le_bytes).as_flattened());
    other.extend([0x02, 0x1b, 0, 0, 0, 0, 0, 0, 0, 7]);
    other.extend([0x18, 0x01, 0x18, 9, 0x00, 0x62, b'r', b'1']);
    let beacon: Beacon = decode(&other).expect("valid CBOR");
    assert_eq!(beacon.robot, id("r1"));
    assert_eq!(beacon.boot_id, 9);
    assert_eq!(beacon.stamp, Instant::from_nanos(7));
    assert_eq!(beacon.position, [1.5, -2.25]);
    assert_eq!(beacon.velocity, [-0.25, 0.5]);
    assert_eq!(beacon.radius, f64::from(0.35_f32));
}

#[test]
fn values_that_cannot_be_meant_are_not_sent() {
    let nan = f64::NAN;
    let refused = |result: Result<(), EncodeError>, field: &str| {
        let Err(EncodeError::OutOfRange(error)) = result else {
            panic!("{field}: {result:?}");
        };
        assert_eq!(error.field, field);
    };
    let mut buffer = Buffer::new();
    let mut send = |change: &dyn Fn(&mut Telemetry)| {
        let mut message = telemetry();
        change(&mut message);
        wire::encode(&message, &mut buffer)
    };
    for bad in [nan, f64::INFINITY, f64::NEG_INFINITY, 1e300] {
        refused(send(&|m| m.state.x = bad), "pose");
        refused(send(&|m| m.state.y = bad), "pose");
        refused(send(&|m| m.state.heading = bad), "pose");
        refused(send(&|m| m.state.v = bad), "motion");
        refused(send(&|m| m.state.q_r = bad), "motion");
        refused(send(&|m| m.state.q_r_rate = bad), "motion");
        refused(send(&|m| m.state.beta = bad), "motion");
        refused(send(&|m| m.state.beta_rate = bad), "motion");
        refused(send(&|m| m.state.alpha = bad), "motion");
        refused(send(&|m| m.state.alpha_rate = bad), "motion");
        refused(send(&|m| m.v_d = bad), "reference");
        refused(send(&|m| m.q_rd = bad), "reference");
        refused(send(&|m| m.position_sigma = bad), "position_sigma");
        refused(send(&|m| m.torque[0] = bad), "torque");
        refused(send(&|m| m.torque[1] = bad), "torque");
    }
    refused(send(&|m| m.position_sigma = -0.01), "position_sigma");

    let mut send = |change: &dyn Fn(&mut SetpointPlan)| {
        let mut message = plan(3);
        change(&mut message);
        wire::encode(&message, &mut buffer)
    };
    refused(send(&|m| m.u[1][0] = f32::NAN), "u");
    refused(send(&|m| m.x[3][4] = f32::INFINITY), "x");
    refused(send(&|m| m.k[2][9] = f32::NAN), "k");
    refused(send(&|m| m.u.truncate(2)), "x");
    refused(send(&|m| m.x.truncate(3)), "x");
    refused(send(&|m| m.k.truncate(2)), "k");
    refused(send(&|m| m.u.clear()), "u");
    refused(send(&|m| m.period = Span::ZERO), "period");
    refused(send(&|m| m.period = Span::from_millis(10_001)), "period");
    refused(
        send(&|m| m.valid_for = Span::from_nanos(999_999)),
        "valid_for",
    );
    refused(send(&|m| m.valid_for = Span::from_millis(-1)), "valid_for");
    refused(
        send(&|m| m.start = m.based_on + Span::from_millis(3_600_001)),
        "start",
    );
    refused(
        send(&|m| m.based_on = Instant::from_nanos(i64::MIN)),
        "start",
    );
    refused(send(&|m| m.id.seq = 0), "id");
}

#[test]
fn values_that_cannot_be_meant_are_refused_on_arrival() {
    let whole = bytes(&plan(2));
    let knots = position_of_key(&whole, 3) + 5;
    let gains = position_of_key(&whole, 4) + 5;
    for at in [knots, knots + 4 * 18, gains, gains + 4 * 19] {
        for bad in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
            let mut doctored = whole.clone();
            doctored[at..at + 4].copy_from_slice(&bad.to_le_bytes());
            let error = decode::<SetpointPlan>(&doctored).expect_err("not finite");
            assert_eq!(error.reason(), DropReason::OutOfRange, "byte {at}: {error}");
        }
    }
    let mut doctored = bytes(&command());
    let order = position_of_key(&doctored, 4) + 1;
    doctored[order] = 6;
    let error = decode::<Command>(&doctored).expect_err("no such order");
    assert_eq!(error.reason(), DropReason::OutOfRange);
    assert!(error.to_string().contains("order"), "{error}");

    let mut doctored = bytes(&status());
    let mode = position_of_key(&doctored, 3) + 1;
    doctored[mode] = 8;
    let error = decode::<Status>(&doctored).expect_err("no such mode");
    assert_eq!(error.reason(), DropReason::OutOfRange);

    let mut doctored = bytes(&command());
    doctored[6] = b'*';
    let error = decode::<Command>(&doctored).expect_err("a wild robot id");
    assert_eq!(error.reason(), DropReason::OutOfRange);
    assert!(error.to_string().contains("robot"), "{error}");
}

/// 60 000 nested arrays, a map of 2^64 fields, an array of 2^63 nothings: refused at once, without recursion or memory.
#[test]
fn hostile_shapes_are_refused() {
    let malformed = |bytes: &[u8]| {
        let error = decode::<Telemetry>(bytes).expect_err("hostile");
        assert_eq!(error.reason(), DropReason::Malformed, "{error}");
    };
    malformed(&[0x81; 60_000]);
    let mut nested = vec![0x83, 1, 0, 0xa1, 0x17];
    nested.extend([0x81; 8_000]);
    malformed(&nested);
    malformed(&[0x83, 1, 0, 0xbb, 255, 255, 255, 255, 255, 255, 255, 255]);
    malformed(&[
        0x83, 1, 0, 0xa1, 0x17, 0x9b, 127, 255, 255, 255, 255, 255, 255, 255,
    ]);
    malformed(&[
        0x83, 1, 0, 0xa1, 0x17, 0x5b, 255, 255, 255, 255, 255, 255, 255, 255,
    ]);
    // Indefinite lengths and stray breaks.
    malformed(&[0x9f, 1, 0, 0xa0, 0xff]);
    malformed(&[0x83, 1, 0, 0xbf, 0xff]);
    malformed(&[0x83, 1, 0, 0xa1, 0x17, 0xff]);
    malformed(&[0x83, 1, 0, 0xa1, 0x17, 0x9f, 0xff]);
}

#[test]
fn buffer_that_is_too_small_is_left_empty() {
    let mut small = ArrayVec::<u8, 100>::new();
    assert_eq!(
        wire::encode(&plan(20), &mut small),
        Err(EncodeError::Full { capacity: 100 })
    );
    assert!(small.is_empty());
}

#[test]
fn errors_say_what_and_where() {
    let error = decode::<Beacon>(&[0x83, 1, 0, 0xa0]).expect_err("no fields");
    assert!(matches!(
        error,
        WireError::Malformed {
            what: "robot",
            at: 4,
            ..
        }
    ));
    assert_eq!(
        error.to_string(),
        "not a message: robot is missing (byte 4)"
    );
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(2_000))]

    #[test]
    fn any_telemetry_round_trips(message in any_telemetry()) {
        assert_round_trip(&message);
    }

    #[test]
    fn any_plan_round_trips(message in any_plan()) {
        assert_round_trip(&message);
    }

    #[test]
    fn any_status_round_trips(message in any_status()) {
        assert_round_trip(&message);
    }

    #[test]
    fn any_command_round_trips(message in any_command()) {
        assert_round_trip(&message);
    }

    #[test]
    fn any_beacon_round_trips(message in any_beacon()) {
        assert_round_trip(&message);
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(10_000))]

    #[test]
    fn arbitrary_bytes_never_panic(bytes in proptest::collection::vec(any::<u8>(), 0..300)) {
        decode_as_everything(&bytes);
    }

    /// Arbitrary bytes hardly get past the envelope: doctored messages do.
    #[test]
    fn doctored_messages_never_panic_and_are_valid_if_accepted(
        which in 0..5_usize,
        changes in proptest::collection::vec((any::<proptest::sample::Index>(), any::<u8>()), 1..6),
        cut in proptest::option::of(any::<proptest::sample::Index>()),
    ) {
        let mut bytes = match which {
            0 => bytes(&telemetry()),
            1 => bytes(&plan(2)),
            2 => bytes(&command()),
            3 => bytes(&status()),
            _ => bytes(&beacon()),
        };
        for (at, value) in changes {
            let at = at.index(bytes.len());
            bytes[at] = value;
        }
        if let Some(cut) = cut {
            bytes.truncate(cut.index(bytes.len()));
        }
        decode_as_everything(&bytes);
    }
}

fn decode_as_everything(bytes: &[u8]) {
    fn check<M: Wire>(bytes: &[u8]) {
        if let Ok(message) = decode::<M>(bytes) {
            wire::encode(&message, &mut Buffer::new()).expect("what is accepted can be sent on");
        }
    }
    check::<Telemetry>(bytes);
    check::<SetpointPlan>(bytes);
    check::<Command>(bytes);
    check::<Status>(bytes);
    check::<Beacon>(bytes);
}

fn assert_round_trip<M: Wire + PartialEq + std::fmt::Debug>(message: &M) {
    let once = bytes(message);
    let again: M = decode(&once).unwrap_or_else(|error| panic!("{message:?}: {error}"));
    assert_eq!(&again, message);
    assert_eq!(bytes(&again), once, "the same message gives the same bytes");
}

/// The bytes of `message` are those that another library wrote from the same tables (tests/golden/wire_generate.py), and back.
fn assert_golden<M: Wire + PartialEq + std::fmt::Debug>(message: &M, name: &str) {
    let golden: serde_json::Value =
        serde_json::from_str(include_str!("golden/wire.json")).expect("JSON");
    let golden = golden["wire"][name].as_str().expect("hex");
    let hex: String = bytes(message)
        .iter()
        .map(|byte| format!("{byte:02x}"))
        .collect();
    assert_eq!(
        hex, golden,
        "the bytes of {name} changed, and robots in the field speak the old ones: a change that they can ignore raises the \
         minor version, any other the major one"
    );
    assert_round_trip(message);
}

fn bytes<M: Wire>(message: &M) -> Vec<u8> {
    let mut buffer = Buffer::new();
    wire::encode(message, &mut buffer).expect("a valid message");
    buffer.to_vec()
}

/// Where key `key` of the map of fields stands.
fn position_of_key(message: &[u8], key: u8) -> usize {
    let mut decoder = minicbor::Decoder::new(message);
    decoder.array().expect("envelope");
    decoder.u16().expect("major");
    decoder.u16().expect("minor");
    let fields = decoder.map().expect("map").expect("definite");
    for _ in 0..fields {
        let at = decoder.position();
        if decoder.u8().expect("small key") == key {
            return at;
        }
        decoder.skip().expect("value");
    }
    panic!("no key {key}");
}

fn id(text: &str) -> RobotId {
    text.parse().expect("a valid id")
}

/// Every value differs from every other, so that two exchanged fields show.
fn telemetry() -> Telemetry {
    Telemetry {
        robot: id("r1"),
        boot_id: 0x0102_0304_0506_0708,
        stamp: Instant::from_nanos(12_345_678_901),
        mode: Mode::Tracking,
        state: RobotState {
            x: 1.1,
            y: -2.2,
            heading: 33.3,
            v: 0.5,
            q_r: -0.25,
            q_r_rate: 0.125,
            beta: 0.0625,
            beta_rate: -0.75,
            alpha: 0.03125,
            alpha_rate: 1.5,
        },
        v_d: 0.625,
        q_rd: -0.1875,
        position_sigma: 0.015625,
        playing: Some(PlanId { epoch: 3, seq: 41 }),
        newest: Some(PlanId { epoch: 3, seq: 42 }),
        received: 0xffff_0fff,
        loop_delay: Some(Span::from_nanos(123_456_789)),
        epoch: 5,
        command: 17,
        torque: [2.5, -3.5],
    }
}

/// A plan of `knots` knots whose values all differ.
fn plan(knots: usize) -> SetpointPlan {
    let mut next = 0.0;
    let mut value = || {
        next += 0.25;
        next
    };
    SetpointPlan {
        robot: id("r2"),
        boot_id: 0x1112_1314_1516_1718,
        id: PlanId { epoch: 2, seq: 77 },
        based_on: Instant::from_nanos(9_876_543_210),
        start: Instant::from_nanos(10_000_000_123),
        period: Span::from_millis(100),
        valid_for: Span::from_millis(1_500),
        source: PlanSource::Clarabel,
        u: (0..knots)
            .map(|_| std::array::from_fn(|_| value()))
            .collect(),
        x: (0..=knots)
            .map(|_| std::array::from_fn(|_| -value()))
            .collect(),
        k: (0..knots)
            .map(|_| std::array::from_fn(|_| value()))
            .collect(),
    }
}

fn command() -> Command {
    Command {
        robot: id("r3"),
        boot_id: 0x2122_2324_2526_2728,
        number: 300,
        station: 0x3132_3334_3536_3738,
        order: CommandOrder::Hold,
    }
}

fn status() -> Status {
    Status {
        robot: id("r4"),
        boot_id: 0x4142_4344_4546_4748,
        stamp: Instant::from_nanos(-5),
        mode: Mode::Failsafe,
        reason: ArrayString::from("no sensor frame for 100 ms → zero torque").expect("short"),
        dropped: [1, 20, 300, 4_000, 50_000, 600_000, 7, 8, 9, 10],
        gain_guard: 11,
        software: ArrayString::from("0.1.0").expect("short"),
        epoch: 12,
        station: 13,
    }
}

fn beacon() -> Beacon {
    Beacon {
        robot: id("r5"),
        boot_id: 0x5152_5354_5556_5758,
        stamp: Instant::from_nanos(77),
        position: [7.7, -8.8],
        velocity: [0.5, -0.75],
        radius: 0.375,
    }
}

prop_compose! {
    fn any_id()(text in "[A-Za-z0-9._-]{1,32}") -> RobotId {
        id(&text)
    }
}

/// A finite f32, as what travels as one.
fn any_f32() -> impl Strategy<Value = f32> {
    use proptest::num::f32::{NEGATIVE, NORMAL, POSITIVE, SUBNORMAL, ZERO};
    POSITIVE | NEGATIVE | NORMAL | SUBNORMAL | ZERO
}

fn any_rounded() -> impl Strategy<Value = f64> {
    any_f32().prop_map(f64::from)
}

fn any_position() -> impl Strategy<Value = f64> {
    -1e30..1e30_f64
}

fn any_plan_id() -> impl Strategy<Value = PlanId> {
    (any::<u32>(), 1..=u32::MAX).prop_map(|(epoch, seq)| PlanId { epoch, seq })
}

fn any_mode() -> impl Strategy<Value = Mode> {
    proptest::sample::select(vec![
        Mode::Boot,
        Mode::Disarmed,
        Mode::Ready,
        Mode::Idle,
        Mode::Tracking,
        Mode::Holding,
        Mode::Failsafe,
        Mode::Fault,
    ])
}

prop_compose! {
    fn any_telemetry()(
        robot in any_id(),
        (boot_id, stamp, mode, received, epoch, command) in
            (any::<u64>(), any::<i64>(), any_mode(), any::<u32>(), any::<u32>(), any::<u32>()),
        pose in [any_position(), any_position(), any_position()],
        rest in proptest::array::uniform11(any_rounded()),
        sigma in 0.0..1e6_f32,
        playing in proptest::option::of(any_plan_id()),
        newest in proptest::option::of(any_plan_id()),
        delay in proptest::option::of(any::<i64>()),
    ) -> Telemetry {
        let [x, y, heading] = pose;
        let [v, q_r, q_r_rate, beta, beta_rate, alpha, alpha_rate, v_d, q_rd, pitch, roll] = rest;
        Telemetry {
            robot,
            boot_id,
            stamp: Instant::from_nanos(stamp),
            mode,
            state: RobotState { x, y, heading, v, q_r, q_r_rate, beta, beta_rate, alpha, alpha_rate },
            v_d,
            q_rd,
            position_sigma: sigma.into(),
            playing,
            newest,
            received,
            loop_delay: delay.map(Span::from_nanos),
            epoch,
            command,
            torque: [pitch, roll],
        }
    }
}

prop_compose! {
    fn any_plan()(
        robot in any_id(),
        boot_id in any::<u64>(),
        plan_id in any_plan_id(),
        based_on in -(1_i64 << 62)..(1 << 62),
        lead in -3_600_000_000_000..=3_600_000_000_000_i64,
        period in 1_000_000..=10_000_000_000_i64,
        valid_for in 1..=3_600_000_i64,
        source in proptest::sample::select(vec![PlanSource::Riccati, PlanSource::Clarabel, PlanSource::Shifted, PlanSource::Steps, PlanSource::Course]),
        gains in any::<bool>(),
        knots in 1..=KNOTS_MAX,
        values in proptest::collection::vec(any_f32(), 17),
    ) -> SetpointPlan {
        let mut values = values.into_iter().cycle();
        let mut value = || values.next().expect("endless");
        SetpointPlan {
            robot,
            boot_id,
            id: plan_id,
            based_on: Instant::from_nanos(based_on),
            start: Instant::from_nanos(based_on + lead),
            period: Span::from_nanos(period),
            valid_for: Span::from_millis(valid_for),
            source,
            u: (0..knots).map(|_| std::array::from_fn(|_| value())).collect(),
            x: (0..=knots).map(|_| std::array::from_fn(|_| value())).collect(),
            k: (0..if gains { knots } else { 0 }).map(|_| std::array::from_fn(|_| value())).collect(),
        }
    }
}

prop_compose! {
    fn any_status()(
        robot in any_id(),
        (boot_id, stamp, mode, gain_guard, epoch, station) in
            (any::<u64>(), any::<i64>(), any_mode(), any::<u32>(), any::<u32>(), any::<u64>()),
        reason in ".{0,24}",
        software in "[ -~]{0,32}",
        dropped in any::<[u32; DropReason::COUNT]>(),
    ) -> Status {
        Status {
            robot,
            boot_id,
            stamp: Instant::from_nanos(stamp),
            mode,
            reason: ArrayString::from(&reason).expect("24 characters of at most 4 bytes"),
            dropped,
            gain_guard,
            software: ArrayString::from(&software).expect("at most 32 bytes"),
            epoch,
            station,
        }
    }
}

prop_compose! {
    fn any_command()(
        robot in any_id(),
        boot_id in any::<u64>(),
        number in 1..=u32::MAX,
        station in 1..=u64::MAX,
        order in proptest::sample::select(vec![
            CommandOrder::Claim,
            CommandOrder::Release,
            CommandOrder::Arm,
            CommandOrder::Disarm,
            CommandOrder::Hold,
            CommandOrder::Resume,
        ]),
    ) -> Command {
        Command { robot, boot_id, number, station, order }
    }
}

prop_compose! {
    fn any_beacon()(
        robot in any_id(),
        boot_id in any::<u64>(),
        stamp in any::<i64>(),
        position in [any_position(), any_position()],
        velocity in [any_rounded(), any_rounded()],
        radius in 0.001..10.0_f32,
    ) -> Beacon {
        Beacon { robot, boot_id, stamp: Instant::from_nanos(stamp), position, velocity, radius: radius.into() }
    }
}
