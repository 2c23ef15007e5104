//! The indicators on signals whose figures are known beforehand.

use core::f64::consts::{PI, TAU};

use sphere_protocol::time::Span;
use sphere_sim::indicators::{
    FOUND, SETTLING_BAND, Sample, Step, between, bounds, largest, mean, mean_absolute, quantile,
    rise_time, root_mean_square, settling_time, time_below, values, variation_rate, wrapped,
};

/// `seconds` of a signal, every 20 ms.
fn signal(seconds: f64, value: impl Fn(f64) -> f64) -> Vec<Sample> {
    (0..(seconds * 50.0) as i64)
        .map(|index| {
            let t = Span::from_millis(20 * index);
            let value = value(t.as_secs_f64());
            Sample { t, value }
        })
        .collect()
}

fn degrees(degrees: f64) -> f64 {
    degrees.to_radians()
}

/// 0 → 10° at 5 s, until 20 s.
fn step() -> Step {
    Step {
        at: Span::from_millis(5000),
        from: 0.0,
        to: degrees(10.0),
        until: Some(Span::from_millis(20_000)),
    }
}

/// Fails unless both differ by less than `tolerance`.
fn close(what: &str, actual: Option<f64>, expected: f64, tolerance: f64) {
    let actual = actual.unwrap_or_else(|| panic!("{what} is none"));
    assert!(
        (actual - expected).abs() <= tolerance,
        "{what}: {actual} instead of {expected}"
    );
}

/// One sample: an event between two counts at the later.
const LATE: f64 = 0.02;

#[test]
fn a_damped_oscillation_rises_and_settles_when_its_formula_says() {
    // 10° (1 − e^(−t) cos 4t): first at 10° where cos 4t = 0; the last extremum of e^(−t) cos 4t beyond 0.1 decides when it settles.
    let response = |t: f64| 10.0 * (1.0 - (-t).exp() * (4.0 * t).cos());
    let roll = signal(20.0, |t| {
        if t < 5.0 {
            0.0
        } else {
            degrees(response(t - 5.0))
        }
    });
    close("t_r", rise_time(&roll, &step()), PI / 8.0, LATE);
    // Scanned ten thousand times as finely, from the end.
    let outside = |t: &f64| (response(*t) - 10.0).abs() > 1.0;
    let last = (0..15_000_000)
        .rev()
        .map(|i| f64::from(i) * 1e-6)
        .find(outside);
    let settled = settling_time(&roll, &step(), SETTLING_BAND);
    close("t_s", settled, last.expect("it starts outside"), LATE);
}

#[test]
fn rise_time_is_none_for_what_creeps_up_from_below_while_settling_time_is_not() {
    // 10° (1 − e^(−t)) reaches 9° at ln 10 and 10° never.
    let roll = signal(20.0, |t| {
        degrees(10.0 * (1.0 - (-(t - 5.0).max(0.0)).exp())) - 1e-9
    });
    assert_eq!(rise_time(&roll, &step()), None);
    close(
        "t_s",
        settling_time(&roll, &step(), SETTLING_BAND),
        10f64.ln(),
        LATE,
    );
}

#[test]
fn a_step_down_counts_as_a_step_up_does() {
    let down = Step {
        from: degrees(10.0),
        to: degrees(-10.0),
        ..step()
    };
    let roll = signal(20.0, |t| degrees(10.0 - 20.0 * (t - 5.0).clamp(0.0, 1.0)));
    close("t_r", rise_time(&roll, &down), 1.0, LATE);
    close(
        "t_s",
        settling_time(&roll, &down, SETTLING_BAND),
        0.95,
        LATE,
    );
}

#[test]
fn nothing_before_the_step_and_nothing_after_the_next_change_counts() {
    let roll = signal(30.0, |t| match t {
        t if t < 5.0 => degrees(10.0),
        t if t < 7.0 => 0.0,
        t if t < 20.0 => degrees(10.0),
        _ => degrees(-45.0),
    });
    close("t_r", rise_time(&roll, &step()), 2.0, 1e-12);
    close(
        "t_s",
        settling_time(&roll, &step(), SETTLING_BAND),
        2.0,
        1e-12,
    );
    let endless = Step {
        until: None,
        ..step()
    };
    assert_eq!(settling_time(&roll, &endless, SETTLING_BAND), None);
}

#[test]
fn steady_state_begins_five_seconds_after_the_step() {
    // Error −4° for 5 s, then +1° and −0.5° in turns of 1 s: ten seconds, five of each.
    let error = signal(20.0, |t| match t {
        t if t < 10.0 => -4.0,
        t if t.rem_euclid(2.0) < 1.0 => 1.0,
        _ => -0.5,
    });
    let steady = values(step().steady(&error));
    assert_eq!(steady.len(), 500);
    close("e_rmse", root_mean_square(&steady), 0.625f64.sqrt(), 1e-12);
    assert_eq!(bounds(&steady), Some([-0.5, 1.0]));
    // From the step on: five seconds of −4, ten of +0.25 on average.
    let turning = values(step().of(&error));
    close("e_m", mean(&turning), (-20.0 + 2.5) / 15.0, 1e-12);
    close("e_mae", mean_absolute(&turning), (20.0 + 7.5) / 15.0, 1e-12);
}

#[test]
fn a_sine_has_its_amplitude_over_root_two_and_two_over_pi_of_it() {
    // Ten whole periods of 1000 samples: sums over whole periods are exact but for rounding; |sin| is not smooth, hence 1e-5.
    let errors = values(&signal(200.0, |t| 3.0 * (TAU * t / 20.0).sin()));
    close(
        "e_rmse",
        root_mean_square(&errors),
        3.0 / 2f64.sqrt(),
        1e-12,
    );
    close("e_mae", mean_absolute(&errors), 6.0 / PI, 1e-5);
    close("e_m", mean(&errors), 0.0, 1e-12);
    let [low, high] = bounds(&errors).expect("there are some");
    assert_eq!((low, high), (-3.0, 3.0));
}

#[test]
fn time_to_the_reference_is_from_when_the_distance_stays_below() {
    // 2 e^(−t/2) m from the mission's start at 1 s, with one bump at 9 s.
    let distance = |bump: f64| {
        signal(20.0, move |t| {
            let bump = if (9.0..9.5).contains(&t) { bump } else { 0.0 };
            2.0 * (-(t - 1.0) / 2.0).exp() + bump
        })
    };
    let begin = Span::from_millis(1000);
    let near = 2.0 * 20f64.ln();
    close(
        "smooth",
        time_below(&distance(0.0), begin, FOUND),
        near,
        LATE,
    );
    close("bump", time_below(&distance(0.2), begin, FOUND), 8.5, 1e-12);
    assert_eq!(time_below(&distance(0.0), begin, 1e-9), None);
    assert_eq!(time_below(&[], begin, FOUND), None);
}

#[test]
fn variation_of_a_triangle_is_its_slope() {
    // ±1 at 1 Hz: up 2 and down 2 each second.
    let triangle = signal(20.0, |t| {
        let phase = t.rem_euclid(1.0);
        if phase < 0.5 {
            4.0 * phase - 1.0
        } else {
            3.0 - 4.0 * phase
        }
    });
    close("triangle", variation_rate(&triangle), 4.0, 1e-9);
    close("constant", variation_rate(&signal(5.0, |_| 7.0)), 0.0, 0.0);
    // Alternating every 20 ms: 2 at each of 50 samples a second.
    let chatter = signal(5.0, |t| {
        if (50.0 * t).round() as i64 % 2 == 0 {
            1.0
        } else {
            -1.0
        }
    });
    close("chatter", variation_rate(&chatter), 100.0, 1e-9);
    assert_eq!(variation_rate(&triangle[..1]), None);
}

#[test]
fn windows_hold_their_beginning_and_not_their_end() {
    let samples = signal(2.0, |t| t);
    let ms = Span::from_millis;
    assert_eq!(between(&samples, ms(100), Some(ms(200))).len(), 5);
    assert_eq!(between(&samples, ms(100), Some(ms(200)))[0].t, ms(100));
    assert_eq!(between(&samples, ms(1900), None).len(), 5);
    assert!(between(&samples, ms(300), Some(ms(200))).is_empty());
    assert!(between(&samples, ms(3000), None).is_empty());
}

#[test]
fn of_nothing_there_is_no_figure() {
    assert_eq!(mean(&[]), None);
    assert_eq!(mean_absolute(&[]), None);
    assert_eq!(root_mean_square(&[]), None);
    assert_eq!(bounds(&[]), None);
    assert_eq!(largest(&[]), None);
    assert_eq!(quantile(&[], 0.5), None);
    assert_eq!(rise_time(&[], &step()), None);
    assert_eq!(settling_time(&[], &step(), SETTLING_BAND), None);
    assert_eq!(variation_rate(&[]), None);
}

#[test]
fn angles_wrap_into_half_a_turn_either_way() {
    for turns in [-6.0, -1.0, 0.0, 1.0, 10.0] {
        for angle in [-3.0, -0.1, 0.0, 0.1, 3.0] {
            close("wrapped", Some(wrapped(angle + turns * TAU)), angle, 1e-12);
        }
    }
}
