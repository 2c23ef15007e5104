//! What the onboard estimator makes of sensor frames that are wrong, missing or from another time, of dead sensors, and of a robot
//! that pivots: it counts them, carries on, and never panics or hands on a number that is none.

#[path = "estimator/errors.rs"]
mod errors;
#[path = "estimator/motion.rs"]
mod motion;

use errors::{Errors, estimator, feed, position_error};
use motion::{DEGREE, Event, Jet, Sensing, changed, events, usual};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use sphere_agent::estimator::{Estimator, EstimatorConfig};
use sphere_protocol::state::{BoardStatus, Measurement, PositionFix};
use sphere_protocol::time::{Instant, Span};

fn is_finite(estimator: &Estimator) -> bool {
    let s = estimator.state();
    let state = [
        s.x,
        s.y,
        s.heading,
        s.v,
        s.q_r,
        s.q_r_rate,
        s.beta,
        s.beta_rate,
        s.alpha,
        s.alpha_rate,
    ];
    state
        .iter()
        .chain(estimator.covariance().iter())
        .all(|value| value.is_finite())
}

#[test]
fn garbage_values_are_counted_and_do_not_spread() {
    // Every seventh frame of a run carries one value that cannot be, in turn in each place.
    let garbage = [f64::NAN, f64::INFINITY, f64::NEG_INFINITY, 1e300, -1e9];
    let mut k = 0;
    let events = changed(usual(1, 60.0), |t, mut m| {
        let frame = (t * 200.0).round() as usize;
        if frame > 0 && frame.is_multiple_of(7) {
            let value = garbage[k % garbage.len()];
            match k % 10 {
                i @ 0..3 => m.gyro[i] = value,
                i @ 3..6 => m.accel[i - 3] = value,
                6 => m.theta_r = value,
                7 => m.theta_p = value,
                8 => m.theta_r_rate = value,
                _ => m.theta_p_rate = value,
            }
            k += 1;
        }
        Some(m)
    });
    let mut estimator = estimator(EstimatorConfig::default());
    let mut errors = Errors::default();
    for event in events {
        match event {
            Event::Frame(measurement, truth) => {
                estimator.on_measurement(&measurement);
                assert!(is_finite(&estimator), "at {} s", truth.t);
                errors.add(&estimator, &truth);
            }
            Event::Fix(fix) => {
                estimator.on_fix(&fix);
            }
        }
    }
    let errors = errors.finish();
    errors.print("one frame in seven broken");
    let c = estimator.counters();
    assert_eq!(
        c.gyro_unusable + c.accel_unusable + c.encoders_unusable,
        k as u64,
        "{c:?}"
    );
    assert!(errors.position < 8e-3 && errors.q_r < 0.05 * DEGREE);
    let health = estimator.sensor_health();
    assert!(
        health.gyro && health.accel && health.encoders,
        "one in seven is no dead sensor"
    );
}

#[test]
fn plausible_spikes_are_refused_by_the_gates() {
    // Inside every range, but impossible: 10 rad/s for one sample would turn the heading by 3°.
    let mut spikes = 0;
    let events = changed(usual(2, 60.0), |t, mut m| {
        let frame = (t * 200.0).round() as usize;
        if frame > 1000 && frame.is_multiple_of(100) {
            spikes += 1;
            match spikes % 4 {
                i @ 0..3 => m.gyro[i] += 10.0,
                _ => m.theta_p += 0.3,
            }
        }
        Some(m)
    });
    let mut estimator = estimator(EstimatorConfig::default());
    let mut errors = Errors::default();
    for event in events {
        match event {
            Event::Frame(measurement, truth) => {
                estimator.on_measurement(&measurement);
                errors.add(&estimator, &truth);
            }
            Event::Fix(fix) => {
                estimator.on_fix(&fix);
            }
        }
    }
    let errors = errors.finish();
    errors.print("two spikes a second");
    let c = estimator.counters();
    assert_eq!(c.gyro_rejected + c.encoder_rejected, spikes as u64, "{c:?}");
    assert!(errors.heading < 0.2 * DEGREE && errors.position < 8e-3);
}

#[test]
fn random_bits_never_panic_nor_spread() {
    for seed in 0..20 {
        println!("seed {seed}");
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let mut estimator = estimator(EstimatorConfig::default());
        let any = |random: &mut ChaCha8Rng, usual: f64| match random.random_range(0..4) {
            0 => f64::from_bits(random.random()),
            1 => random.random_range(-40.0..40.0),
            _ => usual + random.random_range(-1.0..1.0),
        };
        let mut ns = 0i64;
        for _ in 0..5000 {
            ns = match random.random_range(0..50) {
                0 => random.random(),
                1 => ns.saturating_sub(5_000_000),
                _ => ns.saturating_add(random.random_range(1..20_000_000)),
            };
            let r = &mut random;
            let measurement = Measurement {
                stamp: Instant::from_nanos(ns),
                gyro: [any(r, 0.0), any(r, 0.0), any(r, 0.0)],
                accel: [any(r, 0.0), any(r, 0.0), any(r, 9.81)],
                theta_r: any(r, 0.0),
                theta_r_rate: any(r, 0.0),
                theta_p: any(r, 0.0),
                theta_p_rate: any(r, 0.0),
                status: BoardStatus {
                    torque_on: r.random(),
                    command_valid: r.random(),
                    imu_ok: r.random_bool(0.9),
                    encoders_ok: r.random_bool(0.9),
                },
            };
            estimator.on_measurement(&measurement);
            if r.random_bool(0.1) {
                estimator.on_fix(&PositionFix {
                    stamp: Instant::from_nanos(ns) - Span::from_millis(r.random_range(-50..400)),
                    x: any(r, 0.0),
                    y: any(r, 0.0),
                    sigma: any(r, 1.0),
                });
            }
            assert!(
                is_finite(&estimator),
                "seed {seed}: {:?}",
                estimator.state()
            );
        }
        let c = estimator.counters();
        assert!(
            c.frames > 0 && c.frames_out_of_time > 0 && c.fixes_invalid > 0,
            "{c:?}"
        );
    }
}

#[test]
fn repeated_and_old_frames_are_dropped() {
    let events = usual(3, 20.0);
    let mut clean = estimator(EstimatorConfig::default());
    feed(&mut clean, &events);
    // Every tenth frame again, and every fifteenth once more half a second later.
    let mut doubled = Vec::new();
    let mut old = Vec::new();
    let mut extra = 0;
    for (k, event) in events.iter().enumerate() {
        doubled.push(*event);
        if let Event::Frame(..) = event {
            if k % 10 == 0 {
                doubled.push(*event);
                extra += 1;
            }
            if k % 15 == 0 {
                old.push(*event);
            }
            if old.len() > 7 {
                doubled.push(old.remove(0));
                extra += 1;
            }
        }
    }
    let mut estimator = estimator(EstimatorConfig::default());
    feed(&mut estimator, &doubled);
    assert_eq!(estimator.counters().frames_out_of_time, extra);
    assert_eq!(estimator.counters().restarts, 0);
    assert_eq!(estimator.state(), clean.state());
}

#[test]
fn lost_frames_are_bridged() {
    // A fifth of the frames lost, and every 5 s a hole of 0.3 s.
    let mut random = ChaCha8Rng::seed_from_u64(4);
    let events = changed(usual(4, 60.0), |t, m| {
        let lost = t > 1.0 && random.random_bool(0.2);
        let hole = t > 5.0 && t % 5.0 < 0.3;
        (!lost && !hole).then_some(m)
    });
    let mut estimator = estimator(EstimatorConfig::default());
    let mut errors = Errors::default();
    for event in events {
        match event {
            Event::Frame(measurement, truth) => {
                estimator.on_measurement(&measurement);
                errors.add(&estimator, &truth);
            }
            Event::Fix(fix) => {
                estimator.on_fix(&fix);
            }
        }
    }
    let errors = errors.finish();
    errors.print("lost frames");
    println!("{:?}", estimator.counters());
    assert!(estimator.counters().gaps >= 11 && estimator.counters().restarts == 0);
    assert!(
        errors.position < 0.012 && errors.q_r < 0.1 * DEGREE,
        "four seconds of sixty are missing"
    );
}

#[test]
fn an_outage_of_two_seconds_restarts_the_estimate_in_motion() {
    let events = changed(usual(5, 60.0), |t, m| {
        (!(20.0..22.0).contains(&t)).then_some(m)
    });
    let mut estimator = estimator(EstimatorConfig::default());
    let truth = feed(&mut estimator, &events);
    println!(
        "{:?}, off by {:.1} mm",
        estimator.counters(),
        1e3 * position_error(&estimator, &truth)
    );
    assert_eq!(estimator.counters().restarts, 1);
    assert!(estimator.converged());
    assert!(position_error(&estimator, &truth) < 0.03);
    assert!((estimator.state().q_r - truth.state.q_r).abs() < 0.2 * DEGREE);
}

#[test]
fn a_board_that_restarts_its_clock_is_followed() {
    // At 20 s the board's clock jumps back to nearly zero, and fixes come in its new time.
    let back = Span::from_millis(-22_000);
    let events: Vec<Event> = usual(6, 60.0)
        .into_iter()
        .map(|event| match event {
            Event::Frame(mut m, truth) if truth.t >= 20.0 => {
                m.stamp += back;
                Event::Frame(m, truth)
            }
            Event::Fix(mut fix) if fix.stamp >= motion::stamp(20.0) => {
                fix.stamp += back;
                Event::Fix(fix)
            }
            other => other,
        })
        .collect();
    let mut estimator = estimator(EstimatorConfig::default());
    let truth = feed(&mut estimator, &events);
    let c = estimator.counters();
    println!(
        "{c:?}, off by {:.1} mm",
        1e3 * position_error(&estimator, &truth)
    );
    assert_eq!((c.restarts, c.frames_out_of_time), (1, 10));
    assert!(position_error(&estimator, &truth) < 0.03);
}

#[test]
fn dead_sensors_show() {
    // From 20 s on one sensor at a time: stuck at its last value, or reported dead by the board.
    type Fault = fn(&mut Measurement, &Measurement);
    let faults: [(&str, Fault, [bool; 3]); 5] = [
        (
            "gyro stuck",
            |m, held| m.gyro = held.gyro,
            [false, true, true],
        ),
        (
            "accelerometer stuck",
            |m, held| m.accel = held.accel,
            [true, false, true],
        ),
        (
            "IMU stuck",
            |m, held| (m.gyro, m.accel) = (held.gyro, held.accel),
            [false, false, true],
        ),
        (
            "IMU dead",
            |m, _| m.status.imu_ok = false,
            [false, false, true],
        ),
        (
            "encoders dead",
            |m, _| m.status.encoders_ok = false,
            [true, true, false],
        ),
    ];
    for (name, fault, expected) in faults {
        let mut held = None;
        let events = changed(usual(7, 23.0), |t, mut m| {
            if t >= 20.0 {
                let held = *held.get_or_insert(m);
                fault(&mut m, &held);
            }
            Some(m)
        });
        let mut estimator = estimator(EstimatorConfig::default());
        for event in &events {
            feed_any(&mut estimator, event);
            if let Event::Frame(_, truth) = event
                && (1.0..20.0).contains(&truth.t)
            {
                let health = estimator.sensor_health();
                assert!(
                    health.gyro && health.accel && health.encoders,
                    "{name}, {} s",
                    truth.t
                );
            }
            assert!(is_finite(&estimator), "{name}");
        }
        let health = estimator.sensor_health();
        assert_eq!(
            [health.gyro, health.accel, health.encoders],
            expected,
            "{name}"
        );
    }
}

#[test]
fn steady_motion_without_noise_is_no_stuck_sensor() {
    // Every value repeats exactly at constant speed: nothing contradicts that, so nothing is stuck.
    let mut estimator = estimator(EstimatorConfig::default());
    for event in events(motion::steady, &Sensing::ideal(), 5.0) {
        feed_any(&mut estimator, &event);
        if let Event::Frame(_, truth) = event {
            let health = estimator.sensor_health();
            assert!(
                health.gyro && health.accel && health.encoders,
                "{} s",
                truth.t
            );
        }
    }
    let c = estimator.counters();
    assert_eq!((c.gyro_unusable, c.accel_unusable), (0, 0));
    assert!(!estimator.at_rest());
}

/// The pitch motor at its limit, to and fro: the frame swings with up to 55 rad/s², and no sensor is to blame for it. Found by the soak: a
/// robot whose speed command jumped, upright and sound, took its gyro for broken and gave up.
#[test]
fn full_torque_is_no_broken_sensor() {
    let jerked = |t: f64| {
        let mut angles = motion::lemniscate(t);
        for k in 0..4 {
            let from = 10.0 + f64::from(k);
            let size = [0.55, -0.6, 0.5, -0.45][k as usize];
            angles.alpha = angles.alpha.plus(Jet::rise(t, from, 0.25).scaled(size));
        }
        angles
    };
    for seed in 0..5 {
        let mut estimator = estimator(EstimatorConfig::default());
        let mut error_max = 0.0_f64;
        for event in events(jerked, &Sensing::usual(seed), 20.0) {
            feed_any(&mut estimator, &event);
            if let Event::Frame(_, truth) = event
                && truth.t > 5.0
            {
                let health = estimator.sensor_health();
                assert!(
                    health.gyro && health.accel && health.encoders,
                    "seed {seed}: {} s, {health:?}",
                    truth.t
                );
                error_max = error_max.max((estimator.state().alpha - truth.state.alpha).abs());
            }
        }
        let c = estimator.counters();
        println!("seed {seed}: α off by {:.3}°, {c:?}", error_max / DEGREE);
        assert_eq!((c.gyro_rejected, c.encoder_rejected), (0, 0), "seed {seed}");
        // The gyro's noise and the lean's share of the accelerometer's bias.
        assert!(error_max < 0.5 * DEGREE, "seed {seed}");
    }
}

#[test]
fn a_pivot_is_believed_to_the_gyro() {
    // Somebody turns the robot on the spot by 60°, which rubber rolling forbids; the heading must follow without any fix.
    for seed in 0..5 {
        let sensing = Sensing {
            fixes: false,
            ..Sensing::usual(seed)
        };
        let mut estimator = estimator(EstimatorConfig::default());
        let truth = feed(&mut estimator, &events(motion::pivoting, &sensing, 30.0));
        let error = estimator.state().heading - truth.state.heading;
        println!(
            "seed {seed}: heading off by {:.2}°, {:?}",
            error / DEGREE,
            estimator.counters()
        );
        assert!(estimator.counters().pivots > 0);
        assert!(error.abs() < 2.0 * DEGREE, "seed {seed}");
    }
}

#[test]
fn a_restart_waits_for_all_sensors_and_keeps_the_pose() {
    // After an outage the IMU stays silent for another second; the pose must not fall back to where the robot was switched on.
    let events = changed(usual(8, 40.0), |t, mut m| {
        m.status.imu_ok = !(22.0..23.0).contains(&t);
        (!(20.0..22.0).contains(&t)).then_some(m)
    });
    let mut estimator = estimator(EstimatorConfig::default());
    for event in &events {
        feed_any(&mut estimator, event);
        if let Event::Frame(_, truth) = event {
            // 3 s at up to 0.7 m/s without a usable frame.
            assert!(position_error(&estimator, truth) < 2.5, "at {} s", truth.t);
        }
    }
    assert_eq!(estimator.counters().restarts, 1);
    let Some(Event::Frame(_, truth)) = events.iter().rfind(|e| matches!(e, Event::Frame(..)))
    else {
        panic!("no frames");
    };
    assert!(position_error(&estimator, truth) < 0.03);
}

#[test]
fn a_robot_on_its_side_restarts_and_keeps_a_finite_pose() {
    // Rolled over at 5 rad/s for two seconds, which the equations cannot follow.
    let events = changed(usual(9, 40.0), |t, mut m| {
        if (20.0..22.0).contains(&t) {
            m.gyro[0] = -5.0;
            m.accel = [0.0, -9.81, 0.0];
        }
        Some(m)
    });
    let mut estimator = estimator(EstimatorConfig::default());
    for event in &events {
        feed_any(&mut estimator, event);
        assert!(is_finite(&estimator));
    }
    println!("{:?}", estimator.counters());
    let Some(Event::Frame(_, truth)) = events.iter().rfind(|e| matches!(e, Event::Frame(..)))
    else {
        panic!("no frames");
    };
    assert!((estimator.state().q_r - truth.state.q_r).abs() < 1.0 * DEGREE);
    assert!(position_error(&estimator, truth) < 0.05);
}

fn feed_any(estimator: &mut Estimator, event: &Event) {
    match event {
        Event::Frame(measurement, _) => estimator.on_measurement(measurement),
        Event::Fix(fix) => {
            estimator.on_fix(fix);
        }
    }
}
