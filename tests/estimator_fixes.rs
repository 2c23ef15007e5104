//! What the onboard estimator makes of position fixes that are late, out of order, between frames, wild or wrong, and of a start
//! that is not known.

#[path = "estimator/errors.rs"]
mod errors;
#[path = "estimator/motion.rs"]
mod motion;

use errors::{Errors, estimator, feed, position_error};
use motion::{DEGREE, Event, FRAME, Sensing, Truth, events, stamp, usual};
use sphere_agent::estimator::{EstimatorConfig, FixOutcome, StartPose};
use sphere_protocol::state::PositionFix;
use sphere_protocol::time::Instant;

#[test]
fn a_late_fix_is_worth_as_much_as_a_prompt_one() {
    // A fix is fused at its stamp and the frames since run again: the same sums in the same order, so the same bits.
    let run = |fix_delay| {
        let mut estimator = estimator(EstimatorConfig::default());
        let sensing = Sensing {
            fix_delay,
            ..Sensing::usual(2)
        };
        // The last fix is of 30.335 s: at the end each run has had them all.
        feed(&mut estimator, &events(motion::lemniscate, &sensing, 30.43));
        estimator
    };
    let prompt = run(0.0);
    for delay in [0.005, 0.05, 0.095] {
        let late = run(delay);
        assert_eq!(late.counters().fixes, prompt.counters().fixes);
        assert_eq!(late.state(), prompt.state(), "{delay} s late");
        assert_eq!(late.covariance(), prompt.covariance(), "{delay} s late");
    }
}

#[test]
fn fixes_out_of_order_are_all_used() {
    // Each pair of fixes swapped: the first of a pair comes 150 ms late, still inside the frames that are kept.
    let mut shuffled = Vec::new();
    let mut held = None;
    for event in usual(3, 30.45) {
        match (event, held.take()) {
            (Event::Fix(first), None) => held = Some(first),
            (Event::Fix(second), Some(first)) => {
                shuffled.extend([Event::Fix(second), Event::Fix(first)]);
            }
            (frame, waiting) => {
                held = waiting;
                shuffled.push(frame);
            }
        }
    }
    let mut ordered = estimator(EstimatorConfig::default());
    feed(&mut ordered, &usual(3, 30.45));
    let mut estimator = estimator(EstimatorConfig::default());
    let truth = feed(&mut estimator, &shuffled);
    assert_eq!(estimator.counters().fixes, ordered.counters().fixes);
    assert_eq!(estimator.state(), ordered.state());
    assert!(position_error(&estimator, &truth) < 0.02);
}

#[test]
fn a_fix_between_frames_counts_at_its_own_time() {
    // At 0.5 m/s half a frame is 1.2 mm. Perfect fixes, stamped anywhere between frames, must leave no such error.
    let mut estimator = estimator(EstimatorConfig::default());
    let mut before: Option<Truth> = None;
    for event in events(motion::lemniscate, &Sensing::ideal(), 40.0) {
        let Event::Frame(measurement, truth) = event else {
            continue;
        };
        estimator.on_measurement(&measurement);
        if let Some(before) =
            before.filter(|_| ((truth.t / FRAME).round() as u64).is_multiple_of(20))
        {
            let fix = PositionFix {
                stamp: stamp(0.5 * (before.t + truth.t)),
                x: 0.5 * (before.state.x + truth.state.x),
                y: 0.5 * (before.state.y + truth.state.y),
                sigma: 0.001,
            };
            assert_eq!(estimator.on_fix(&fix), FixOutcome::Fused);
        }
        before = Some(truth);
        assert!(
            position_error(&estimator, &truth) < 2e-4,
            "at {} s",
            truth.t
        );
    }
}

#[test]
fn fixes_that_cannot_be_used_are_counted_and_change_nothing() {
    let mut estimator = estimator(EstimatorConfig::default());
    let good = PositionFix {
        stamp: stamp(9.9),
        x: 0.0,
        y: 0.0,
        sigma: 0.02,
    };
    assert_eq!(
        estimator.on_fix(&good),
        FixOutcome::Invalid,
        "before the first frame"
    );
    let truth = feed(&mut estimator, &usual(5, 10.0));
    let before = (estimator.state(), estimator.covariance());
    let at = |t: f64| PositionFix {
        stamp: stamp(t),
        ..good
    };
    let cases = [
        (
            PositionFix {
                x: f64::NAN,
                ..good
            },
            FixOutcome::Invalid,
        ),
        (
            PositionFix {
                y: f64::INFINITY,
                ..good
            },
            FixOutcome::Invalid,
        ),
        (PositionFix { x: 1e300, ..good }, FixOutcome::Invalid),
        (
            PositionFix {
                sigma: f64::NAN,
                ..good
            },
            FixOutcome::Invalid,
        ),
        (PositionFix { sigma: 0.0, ..good }, FixOutcome::Invalid),
        (
            PositionFix {
                sigma: -1.0,
                ..good
            },
            FixOutcome::Invalid,
        ),
        (at(truth.t + 0.1), FixOutcome::Future),
        (
            PositionFix {
                stamp: Instant::from_nanos(i64::MAX),
                ..good
            },
            FixOutcome::Future,
        ),
        (
            PositionFix {
                stamp: Instant::from_nanos(i64::MIN),
                ..good
            },
            FixOutcome::Late,
        ),
        (at(truth.t - 1.0), FixOutcome::Late),
        // The fixes of 9.835 s and 9.935 s were fused when they came.
        (at(9.935), FixOutcome::Duplicate),
        (
            PositionFix {
                x: truth.state.x + 0.3,
                ..at(9.9)
            },
            FixOutcome::Rejected,
        ),
    ];
    for (fix, expected) in cases {
        assert_eq!(estimator.on_fix(&fix), expected, "{fix:?}");
        assert_eq!(
            (estimator.state(), estimator.covariance()),
            before,
            "{fix:?}"
        );
    }
    let c = estimator.counters();
    assert_eq!((c.fixes_invalid, c.fixes_future, c.fixes_late), (7, 2, 2));
    assert_eq!((c.fixes_duplicate, c.fixes_rejected), (1, 1));
}

#[test]
fn wild_fixes_are_refused() {
    // One fix in five is off by 1 m: all of those are refused, and the rest are enough.
    let mut estimator = estimator(EstimatorConfig::default());
    let mut errors = Errors::default();
    let (mut count, mut wild) = (0, 0);
    for event in usual(6, 60.0) {
        match event {
            Event::Frame(measurement, truth) => {
                estimator.on_measurement(&measurement);
                errors.add(&estimator, &truth);
            }
            Event::Fix(mut fix) => {
                count += 1;
                if count % 5 == 0 {
                    fix.x += 1.0;
                    wild += 1;
                    assert_eq!(estimator.on_fix(&fix), FixOutcome::Rejected);
                } else {
                    estimator.on_fix(&fix);
                }
            }
        }
    }
    let errors = errors.finish();
    errors.print("one fix in five wild");
    assert!(
        estimator.counters().fixes_rejected <= wild + 3,
        "good fixes pass"
    );
    assert_eq!(estimator.counters().fixes_reopened, 0);
    assert!(errors.position < 8e-3);
}

#[test]
fn a_robot_that_was_carried_away_is_found_again() {
    // From 20 s on every fix is 5 m off, as if the robot had been lifted and set down: refused for a second, then believed.
    let mut estimator = estimator(EstimatorConfig::default());
    let mut last = None;
    for event in usual(7, 60.0) {
        match event {
            Event::Frame(measurement, truth) => {
                estimator.on_measurement(&measurement);
                last = Some(truth);
            }
            Event::Fix(mut fix) => {
                if fix.stamp >= stamp(20.0) {
                    fix.y += 5.0;
                }
                estimator.on_fix(&fix);
            }
        }
    }
    let truth = last.expect("frames");
    let state = estimator.state();
    let error = (state.x - truth.state.x).hypot(state.y - truth.state.y - 5.0);
    println!("off by {:.1} mm, {:?}", error * 1e3, estimator.counters());
    assert_eq!(estimator.counters().fixes_reopened, 1);
    assert!(error < 0.03);
    assert!((state.heading - truth.state.heading).abs() < 1.0 * DEGREE);
}

#[test]
fn an_unknown_heading_is_found_by_driving() {
    for (k, wrong) in [-3.0, -1.5, 0.7, 2.0, 3.1].into_iter().enumerate() {
        let mut estimator = estimator(EstimatorConfig {
            start: StartPose {
                heading: wrong,
                heading_sigma: 10.0,
                position_sigma: 100.0,
                x: 30.0,
                y: -40.0,
            },
            ..EstimatorConfig::default()
        });
        let mut known_at = None;
        let mut last = None;
        for event in usual(k as u64, 25.0) {
            match event {
                Event::Frame(measurement, truth) => {
                    estimator.on_measurement(&measurement);
                    if estimator.heading_known() {
                        known_at.get_or_insert(truth.path);
                    }
                    last = Some(truth);
                }
                Event::Fix(fix) => {
                    estimator.on_fix(&fix);
                }
            }
        }
        let truth = last.expect("frames");
        let turn =
            (estimator.state().heading - truth.state.heading).rem_euclid(std::f64::consts::TAU);
        let turn = turn.min(std::f64::consts::TAU - turn);
        let error = position_error(&estimator, &truth);
        println!(
            "{wrong}: known after {known_at:?} m; heading off by {:.2}°, position {:.1} mm",
            turn / DEGREE,
            error * 1e3
        );
        assert!(known_at.is_some_and(|path| (0.4..1.5).contains(&path)));
        assert!(turn < 0.7 * DEGREE && error < 0.03);
    }
}
