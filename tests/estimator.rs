//! How accurate the onboard estimator is: its promises, on made-up motions whose truth is known exactly and on the plant.
//!
//! Bounds are the promises (position 8 mm RMS with fixes, dead reckoning 2 % of the path at any moment and 0.5 % on average); where
//! nothing is promised, the worst seed's figure and a fifth to a third above it. `--nocapture` prints the figures of every seed.

#[path = "estimator/closed_loop.rs"]
mod closed_loop;
#[path = "estimator/errors.rs"]
mod errors;
#[path = "estimator/motion.rs"]
mod motion;

use errors::Errors;
use motion::{DEGREE, Event, Motion, Sensing, events};
use sphere_agent::estimator::{Estimator, EstimatorConfig};
use sphere_protocol::robot::Robot;
use sphere_sim::disturbance::{Disturbance, Push};

const SEEDS: u64 = 10;
const DURATION: f64 = 100.0;
const MOTIONS: [(&str, Motion); 2] = [
    ("figures of eight", motion::lemniscate),
    ("speed steps", motion::speed_steps),
];

/// Runs an estimator with the default configuration along a made-up motion.
fn follow(motion: Motion, sensing: &Sensing) -> (Estimator, Errors) {
    let mut estimator = errors::estimator(EstimatorConfig::default());
    let mut errors = Errors::default();
    for event in events(motion, sensing, DURATION) {
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
    (estimator, errors.finish())
}

/// Runs the estimator in the loop with the plant, its shell unbalanced by 0.2 N·m.
fn follow_plant(motion: Motion, sensing: &Sensing, pushes: Vec<Push>) -> (Estimator, Errors) {
    let robot = Robot::embedded("liu").expect("liu is embedded");
    let mut estimator = errors::estimator(EstimatorConfig::default());
    let mut errors = Errors::default();
    let disturbance = Disturbance {
        imbalance: 0.2,
        pushes,
        ..Disturbance::default()
    };
    closed_loop::drive(
        &mut estimator,
        &robot.params,
        &disturbance,
        motion,
        sensing,
        DURATION,
        |estimator, truth| errors.add(estimator, truth),
    );
    (estimator, errors.finish())
}

/// Sensor readings that a gate refused or gave way to. With Gaussian noise there is none: the gates stand at six sigmas.
fn sensor_refusals(estimator: &Estimator) -> u64 {
    let c = estimator.counters();
    c.gyro_rejected + c.encoder_rejected + c.pivots
}

/// Good fixes are beyond their gate, 16, with probability e⁻⁸: 0.34 of a thousand. Poisson, five sigmas above that mean.
fn assert_fix_refusals(refused: u64, runs: u64) {
    let mean = (-8.0f64).exp() * 10.0 * DURATION * runs as f64;
    println!("{refused} good fixes refused, {mean:.1} expected");
    assert!(refused as f64 <= mean + 5.0 * mean.sqrt() + 1.0);
}

#[test]
fn motion_without_noise_is_followed() {
    // The equations are exact. What is left is the midpoint rule over 5 ms, and the lag of α̇ behind an α̈ that no
    // sensor feels: 108 °/s² RMS in both motions, so that a lag of 1 ms is 0.11 °/s.
    for (name, motion) in MOTIONS {
        let (estimator, e) = follow(motion, &Sensing::ideal());
        e.print(name);
        assert!(
            e.q_r < 0.001 * DEGREE && e.alpha < 0.01 * DEGREE,
            "attitude"
        );
        assert!(e.q_r_rate < 0.01 * DEGREE, "rate of q_r");
        assert!(e.alpha_rate < 0.11 * DEGREE, "rate of α");
        assert!(e.heading < 0.01 * DEGREE && e.v < 1e-4, "heading, speed");
        // 1.5 mm over some 50 m.
        assert!(e.position < 1.5e-3, "position");
        assert_eq!(sensor_refusals(&estimator), 0, "{:?}", estimator.counters());
    }
}

#[test]
fn position_stays_within_8_mm_under_full_noise_with_fixes() {
    let mut worst = Errors::default();
    let mut refused = 0;
    for (name, motion) in MOTIONS {
        for seed in 0..SEEDS {
            let (estimator, e) = follow(motion, &Sensing::usual(seed));
            refused += estimator.counters().fixes_rejected;
            e.print(&format!("{name}, seed {seed}"));
            assert_eq!(
                sensor_refusals(&estimator),
                0,
                "{name}, seed {seed}: {:?}",
                estimator.counters()
            );
            worst.take_worse(&e);
        }
    }
    worst.print("worst");
    assert_fix_refusals(refused, 2 * SEEDS);
    assert_attitude(&worst);
    assert!(worst.position < 8e-3, "position");
    assert!(worst.heading < 0.15 * DEGREE, "heading");
}

#[test]
fn dead_reckoning_stays_within_2_percent_of_the_path() {
    let mut worst = Errors::default();
    let (mut sum, mut runs) = (0.0, 0.0);
    for (name, motion) in MOTIONS {
        for seed in 0..SEEDS {
            let sensing = Sensing {
                fixes: false,
                ..Sensing::usual(seed)
            };
            let (_, e) = follow(motion, &sensing);
            e.print(&format!("{name}, no fixes, seed {seed}"));
            worst.take_worse(&e);
            sum += e.drift_max;
            runs += 1.0;
        }
    }
    worst.print("worst");
    println!(
        "mean of the largest drift on the way: {:.3} % of the path",
        100.0 * sum / runs
    );
    assert_attitude(&worst);
    // At every moment after the first 10 m, not at the end alone: the figures of eight come back.
    assert!(worst.drift_max < 0.02, "drift");
    assert!(sum / runs < 0.005, "mean drift");
}

#[test]
fn the_plant_in_the_loop_is_followed_as_well() {
    let mut worst = [Errors::default(); 2];
    for (name, motion) in MOTIONS {
        for seed in 0..5 {
            for fixes in [true, false] {
                let sensing = Sensing {
                    fixes,
                    ..Sensing::usual(seed)
                };
                let (estimator, e) = follow_plant(motion, &sensing, Vec::new());
                e.print(&format!("plant, {name}, fixes {fixes}, seed {seed}"));
                assert_eq!(sensor_refusals(&estimator), 0, "{:?}", estimator.counters());
                worst[usize::from(fixes)].take_worse(&e);
            }
        }
    }
    let [reckoned, fixed] = worst;
    reckoned.print("worst without fixes");
    fixed.print("worst with fixes");
    assert_attitude(&reckoned);
    assert_attitude(&fixed);
    assert!(fixed.position < 8e-3, "position");
    assert!(reckoned.drift_max < 0.02, "drift");
}

#[test]
fn pushes_trip_no_gate() {
    // 8 N·m on the roll or 15 N·m on the rolling motion for 0.2 s: the sensors are right, and must be believed.
    let pushes = (1..20).flat_map(|k| {
        let at = 5.0 * f64::from(k);
        let push = |roll_nm, pitch_nm, at_s| Push {
            roll_nm,
            pitch_nm,
            at_s,
            for_s: 0.2,
        };
        [push(8.0, 0.0, at), push(0.0, 15.0, at + 2.0)]
    });
    let (estimator, e) = follow_plant(motion::lemniscate, &Sensing::usual(1), pushes.collect());
    e.print("pushed");
    assert_eq!(sensor_refusals(&estimator), 0, "{:?}", estimator.counters());
    assert_attitude(&e);
    assert!(e.position < 8e-3, "position");
}

#[test]
fn the_covariance_is_honest() {
    // NEES of (q_r, α, φ, v, X, Y): 6 on average if the covariance is the error's. Errors of biases last for a whole run, so one
    // run is about one draw for each slow state: the mean over 20 runs is known to about ±0.5. Below 6 is the price of the margins
    // for pivoting, slip and gyro bias that the made-up sensors do not use up; without fixes nothing else bounds those.
    for (fixes, low, high) in [(true, 4.0, 7.0), (false, 2.0, 7.0)] {
        let mut sum = 0.0;
        for (_, motion) in MOTIONS {
            for seed in 0..SEEDS {
                let sensing = Sensing {
                    fixes,
                    ..Sensing::usual(seed)
                };
                sum += follow(motion, &sensing).1.nees;
            }
        }
        let nees = sum / (2 * SEEDS) as f64;
        println!("fixes {fixes}: NEES {nees:.2} of 6");
        assert!((low..high).contains(&nees), "fixes {fixes}: {nees}");
    }
}

#[test]
fn one_second_at_rest_finds_the_gyro_bias() {
    for seed in 0..SEEDS {
        let mut estimator = errors::estimator(EstimatorConfig::default());
        assert!(!estimator.converged());
        let mut converged_at = None;
        let mut last_truth = None;
        for event in events(motion::lemniscate, &Sensing::usual(seed), 1.45) {
            let Event::Frame(measurement, truth) = event else {
                continue;
            };
            estimator.on_measurement(&measurement);
            if estimator.converged() {
                converged_at.get_or_insert(truth.t);
            }
            last_truth = Some(truth);
        }
        let truth = last_truth.expect("frames");
        let (bias, sigma) = estimator.gyro_bias();
        let error = (0..3)
            .map(|i| (bias[i] - truth.gyro_bias[i]).abs())
            .fold(0.0, f64::max);
        println!(
            "seed {seed}: converged at {converged_at:?} s, bias off by {:.4} °/s, sigma {:.4} °/s",
            error / DEGREE,
            sigma / DEGREE
        );
        assert!(estimator.at_rest(), "seed {seed}");
        assert!(
            converged_at.is_some_and(|t| (0.25..1.2).contains(&t)),
            "seed {seed}"
        );
        // The mean of 240 samples at 0.3 °/s is good to 0.02 °/s.
        assert!(sigma < 0.03 * DEGREE && error < 4.0 * sigma, "seed {seed}");
    }
}

#[test]
fn rest_ends_before_motion_spoils_the_biases() {
    // Two encoder steps are 0.2 mrad: at 1 mm/s they take 67 ms, so rest must end within 100 ms of that speed.
    for seed in 0..SEEDS {
        let mut estimator = errors::estimator(EstimatorConfig::default());
        let mut moved_at_rest = 0;
        for event in events(motion::lemniscate, &Sensing::usual(seed), 2.5) {
            let Event::Frame(measurement, truth) = event else {
                continue;
            };
            estimator.on_measurement(&measurement);
            let still = truth.state.v.abs() < 1e-3 && truth.state.q_r_rate.abs() < 2e-3;
            moved_at_rest += u32::from(estimator.at_rest() && !still);
            if truth.t > 2.4 {
                let (bias, sigma) = estimator.gyro_bias();
                for (bias, truth) in bias.iter().zip(truth.gyro_bias) {
                    assert!((bias - truth).abs() < 4.0 * sigma, "seed {seed}");
                }
            }
        }
        println!("seed {seed}: {} ms", 5 * moved_at_rest);
        assert!(moved_at_rest <= 20, "seed {seed}: {moved_at_rest} frames");
        assert!(!estimator.at_rest());
    }
}

/// Figures that position fixes hardly change.
fn assert_attitude(worst: &Errors) {
    assert!(worst.q_r < 0.03 * DEGREE, "q_r");
    assert!(worst.beta < 0.03 * DEGREE, "β");
    // Straight on, little tells α from the accelerometer's bias, which alone is 0.17° at one standard deviation.
    assert!(worst.alpha < 0.15 * DEGREE, "α");
    assert!(worst.q_r_rate < 0.14 * DEGREE, "rate of q_r");
    assert!(worst.alpha_rate < 0.32 * DEGREE, "rate of α");
    assert!(worst.beta_rate < 0.7 * DEGREE, "rate of β");
    assert!(worst.v < 1e-3, "v");
}
