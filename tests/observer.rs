//! The disturbance observer beyond the shell-locked part: what it learns of torques that were made up, and what that is worth in the whole agent.

use sphere_agent::control::observer::{DisturbanceObserver, ObserverGains};
use sphere_agent::gains::HtsmcGains;
use sphere_protocol::robot::Robot;
use sphere_sim::run::run;
use sphere_sim::scenario::Scenario;

/// One control period [s].
const PERIOD: f64 = 0.02;
/// v/R at 0.5 m/s [rad/s].
const SHELL_RATE: f64 = 0.5 / 0.35;

/// A torque of each of these forms is known for one step ahead, to a share of its amplitude, after some seconds. Measured: 2.2, 1.6, 5.9 and 5.5 %.
/// Not promised: at 0.6 and 1.5 times the shell's rate 44 and 59 % are left after 30 s, the search for h does not get there.
#[test]
fn observer_learns_a_constant_the_shell_locked_torque_and_faster_ones() {
    let mut broken = Vec::new();
    for (order, settled, share) in [
        (0.0, 25.0, 0.03),
        (1.0, 15.0, 0.05),
        (2.0, 20.0, 0.08),
        (2.6, 30.0, 0.08),
    ] {
        let omega = order * SHELL_RATE;
        let error = largest_error(gains(), settled, |t| 2.0 * (omega * t).cos()) / 2.0;
        println!("{order} times the shell's rate: {:.1} %", 100.0 * error);
        if error >= share {
            broken.push(order);
        }
    }
    assert!(broken.is_empty(), "not learnt: {broken:?} times the rate");
}

/// What fits none of its models is followed: a torque that comes and goes at once, better than without the remainder.
#[test]
fn remainder_follows_a_push() {
    let push = |t: f64| if t % 4.0 < 2.0 { 0.0 } else { 1.5 };
    let squares = |gains| {
        let mut sum = 0.0;
        observe(gains, 20.0, push, |_, error| sum += error * error);
        sum
    };
    let with = squares(gains());
    let without = squares(ObserverGains {
        remainder: 0.0,
        ..gains()
    });
    println!("squared error of ŵ {with:.1} with the remainder, {without:.1} without");
    assert!(with < 0.95 * without, "{with} against {without}");
}

/// Whatever it is fed, ŵ stays within what its clamps add up to, and it comes back.
#[test]
fn observer_is_bounded_and_recovers() {
    let mut observer = DisturbanceObserver::new(gains());
    let mut wild = 1.0_f64;
    for i in 0..20_000 {
        // A deterministic mess: rates of all sizes and signs, gaps from 1 ms to 1000 s.
        wild = (wild * 7919.0 + 0.37).rem_euclid(1.0);
        let size = 10f64.powf(12.0 * wild - 6.0);
        let sign = if i % 3 == 0 { -1.0 } else { 1.0 };
        let dt = if i % 17 == 0 {
            size.clamp(1e-3, 1e3)
        } else {
            PERIOD
        };
        let w = observer.step(sign * size, size, sign * 10.0 * wild, dt);
        assert!(
            w.torque.abs() < 100.0 && w.rate.abs() < 1e4 && w.accel.abs() < 1e5,
            "step {i}: {w:?}"
        );
        assert!((0.4..=4.0).contains(&observer.order()), "step {i}");
    }
    let mut last = 0.0;
    for _ in 0..3000 {
        last = observer.step(0.0, 0.0, SHELL_RATE, PERIOD).torque;
    }
    assert!(last.abs() < 0.01, "{last} N·m are left a minute later");
}

/// A roll step to 10° with the whole agent, estimator in the loop, in the environment `calibrated`: steady error, medians of 5 seeds.
/// With the constant and the shell-locked part alone: 0.21, 2.2, 2.6, 2.7, 0.42, 0.61° at 0.5 m/s and 0.23, 2.3, 2.6, 2.2° at 1.0.
/// At 1.5 times the shell's rate the torque is learnt in part only, and what the integral gives on slopes it takes under sticking joints and
/// random torque (0.36 and 0.63° with k_i 0.3): hence the wider bounds.
#[test]
fn steady_roll_holds_under_disturbances_of_other_forms() {
    let mut broken = Vec::new();
    for (speed, set, bound) in [
        ("0.5", "imbalance_harmonic=1", BOUND),
        ("0.5", "imbalance_harmonic=1.5", 0.6),
        ("0.5", "imbalance_harmonic=2", BOUND),
        ("0.5", "imbalance_harmonic=2.6", 0.4),
        ("0.5", "stiction_nm=1.0", 0.5),
        ("0.5", "random_nm=0.5", 0.75),
        ("1.0", "imbalance_harmonic=1", BOUND),
        ("1.0", "imbalance_harmonic=1.5", 0.5),
        ("1.0", "imbalance_harmonic=2", 0.4),
        ("1.0", "imbalance_harmonic=2.6", 0.5),
    ] {
        let mut errors: Vec<_> = (1..=5).map(|seed| steady(seed, speed, set)).collect();
        errors.sort_by(f64::total_cmp);
        println!(
            "{speed} m/s, {set}: {:.3}° (worst {:.3}°)",
            errors[2], errors[4]
        );
        if errors[2] >= bound {
            broken.push((speed, set, errors[2]));
        }
    }
    assert!(broken.is_empty(), "{broken:?}");
}

/// What the project asks of a steady roll [°].
const BOUND: f64 = 0.35;

/// The roll observer's, as shipped.
fn gains() -> ObserverGains {
    let g = HtsmcGains::read(&Robot::embedded("liu").expect("embedded")).expect("valid");
    ObserverGains {
        bandwidth: g.observer,
        oscillator: g.oscillator,
        harmonic: g.harmonic,
        harmonic_search: g.harmonic_search,
        remainder: g.remainder,
        remainder_share: g.remainder_share,
        zero_squared: 0.0,
        torque_max: 6.0,
    }
}

/// Largest |ŵ − w| of the 10 s after `settled` [s].
fn largest_error(gains: ObserverGains, settled: f64, torque: impl Fn(f64) -> f64) -> f64 {
    let mut largest = 0.0_f64;
    observe(gains, settled + 10.0, torque, |t, error| {
        if t >= settled {
            largest = largest.max(error.abs());
        }
    });
    largest
}

/// Feeds the momentum that `torque(t)` makes of nothing, integrated at 1 ms, and tells of each step's time and ŵ − w one step ahead.
fn observe(
    gains: ObserverGains,
    until: f64,
    torque: impl Fn(f64) -> f64,
    mut tell: impl FnMut(f64, f64),
) {
    let mut observer = DisturbanceObserver::new(gains);
    let mut momentum = 0.0;
    for i in 0..(until / PERIOD) as usize {
        let t = i as f64 * PERIOD;
        let w = observer.step(momentum, 0.0, SHELL_RATE, PERIOD);
        tell(t, w.torque - torque(t + PERIOD));
        for ms in 0..20 {
            momentum += 1e-3 * torque(t + (f64::from(ms) + 0.5) * 1e-3);
        }
    }
}

/// Steady roll error of one run [°].
fn steady(seed: u64, speed: &str, disturbance: &str) -> f64 {
    let sets = [
        format!("seed={seed}"),
        "environment=calibrated".to_owned(),
        format!("robots.0.mission.speed_mps={speed}"),
        format!("robots.0.disturbance.{disturbance}"),
    ];
    let text = include_str!("../sim/scenarios/roll-step.toml");
    let scenario = Scenario::parse("roll-step.toml", text, &sets, |path| {
        Err(format!("no file {path}"))
    })
    .expect("a valid scenario");
    let run = run(&scenario, "", || 0.0).expect("the gains are stable");
    run.metrics.robots[0].roll_rmse_deg.expect("it rolled")
}
