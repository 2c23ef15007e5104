//! Closed loops on the controllers' own model: law, observer, filters and conditions belong together.
//!
//! How the controllers do against the plant, its sensors and other parameters is another test's business. Planar: v and α held in
//! roll, β held in pitch; RK4 at 1 ms, control at 50 Hz.

mod support;

use std::sync::LazyLock;

use sphere_agent::control::DirectionController;
use sphere_agent::control::hsmc::{Hsmc, SpeedShape};
use sphere_agent::control::htsmc::{self, Htsmc};
use sphere_agent::control::observer::Disturbance;
use sphere_agent::control::reference_filter::{RollFilter, SPEED_RAMP, SpeedFilter};
use sphere_agent::gains::{HsmcGains, HtsmcGains};
use sphere_agent::model::NominalModel;
use sphere_protocol::robot::Robot;
use sphere_protocol::state::{RobotState, Setpoint};

const DEG: f64 = core::f64::consts::PI / 180.0;
/// One control period [s].
const PERIOD: f64 = 0.02;
/// The torque acts at once.
const PROMPT: bool = false;
/// The torque acts a period later, as this robot's motors do.
const LATE: bool = true;

/// A typed step of 10°, filtered at w_ref = 5.0 rad/s. Measured: overshoot 2.3° at 0.5 m/s, of which the integral makes half. At 10 rad/s it overshoots by 2.8° and 3.0°; an independent implementation gives the same to 1e-13°.
#[test]
fn roll_step_settles_at_both_speeds() {
    for v in [0.5, 1.0] {
        let run = roll_step(&mut direction(), v, gains().w_ref, PROMPT, |_| 0.0);
        println!("v = {v}: {run:?}");
        assert!(run.settled < 1.3, "settles in {} s", run.settled);
        assert!(run.overshoot < 2.5, "overshoots by {}°", run.overshoot);
        assert!(run.rest < 0.01, "rests {}° off", run.rest);
        // E7: the wrong-way start is physics, and bounded.
        assert!(
            run.wrong_way > 0.3 && run.wrong_way < 1.8,
            "starts the wrong way by {}°",
            run.wrong_way
        );
    }
}

/// E7: a reference slower than the zero at √(G/(c − a)) = 8.4 rad/s asks for no more than the plant can follow.
#[test]
fn reference_slower_than_the_zero_cuts_the_wrong_way_start_and_the_overshoot() {
    for v in [0.5, 1.0] {
        let fast = roll_step(&mut direction(), v, 10.0, PROMPT, |_| 0.0);
        let slow = roll_step(&mut direction(), v, 4.0, PROMPT, |_| 0.0);
        println!("v = {v}: {slow:?}");
        assert!(
            slow.settled < fast.settled && slow.overshoot < 0.5 * fast.overshoot,
            "{slow:?}"
        );
        assert!(
            slow.wrong_way < 0.65 * fast.wrong_way,
            "{} against {}",
            slow.wrong_way,
            fast.wrong_way
        );
    }
}

/// The integral takes up a constant before the observer has learnt it, and gives it back: on this bench, without noise and imbalance, the
/// integral alone is the quicker (0.04° rms), and the observer costs 0.14° while it learns. What it must do is learn it and leave nothing.
#[test]
fn observer_finds_a_constant_disturbance() {
    let mut controller = direction();
    let run = roll_step(&mut controller, 0.5, 10.0, PROMPT, |_| 1.0);
    let without = roll_step(&mut blind(), 0.5, 10.0, PROMPT, |_| 1.0);
    println!("1 N·m: with the observer {run:?}, without {without:?}");
    support::assert_close("ŵ", controller.disturbance().torque, 1.0, 1e-3);
    assert!(run.rest < 0.02, "rests {}° off", run.rest);
    assert!(run.rms < 0.2, "{} rms, without {}", run.rms, without.rms);
}

/// 2.3 N·m, with which the law alone wobbles like the paper's robot. The estimate is for the period to come, so the motors are a period late here, as they are.
/// Measured: 0.08° and 0.22° instead of 2.84° and 2.21°; ŵ within 5 and 25 mN·m.
#[test]
fn observer_finds_an_imbalance_that_turns_with_the_shell() {
    for v in [0.5, 1.0] {
        let imbalance = |shell: f64| 2.3 * shell.sin();
        let mut controller = direction();
        let run = roll_step(&mut controller, v, 10.0, LATE, imbalance);
        let without = roll_step(&mut blind(), v, 10.0, LATE, imbalance);
        println!("2.3 N·m at v = {v}: with the observer {run:?}, without {without:?}");
        assert!(run.w_error < 0.05, "ŵ is off by {} N·m", run.w_error);
        assert!(
            run.rest < 0.3 && without.rest > 8.0 * run.rest,
            "{} against {}",
            without.rest,
            run.rest
        );
        // Its derivatives are those of 2.3 sin(ω t), to the same 2 %.
        let (w, omega) = (controller.disturbance(), v / liu().params.r);
        let near = |what: &str, actual: f64, expected: f64| {
            assert!(
                (actual - expected).abs() < 0.05,
                "{what}: {actual} instead of {expected} N·m"
            );
        };
        near("amplitude", w.torque.hypot(w.rate / omega), 2.3);
        near("−ŵ̈/ω²", -w.accel / (omega * omega), w.torque);
    }
}

/// The condition E3 is no formality: with λ₂ < λ₁ the very same law falls over on the model that it was derived from.
#[test]
fn slower_pendulum_surface_falls_over() {
    let falls = |gains: &HtsmcGains| {
        let mut s = RobotState {
            q_r: 0.02,
            ..RobotState::default()
        };
        for _ in 0..20_000 {
            let t = htsmc::law(
                &model(),
                gains,
                &s,
                &Setpoint::default(),
                0.0,
                Disturbance::default(),
            );
            s = rolled(&s, t.torque.clamp(-20.0, 20.0), 0.0);
            if s.q_r.abs() > 0.5 || s.beta.abs() > 1.0 {
                return true;
            }
        }
        false
    };
    assert!(!falls(&gains()));
    assert!(falls(&HtsmcGains {
        a1: 6.5,
        a2: 2.5,
        ..gains()
    }));
    // The border itself, without the terminal terms that blur it.
    let linear = HtsmcGains {
        c1: 0.0,
        c2: 0.0,
        k_i: 0.0,
        a1: 3.0,
        ..gains()
    };
    assert!(!falls(&HtsmcGains { a2: 3.3, ..linear }));
    assert!(falls(&HtsmcGains { a2: 2.7, ..linear }));
}

/// A typed speed step, ramped; α̇_d and α̈_d of a smooth reference cut the overshoot.
#[test]
fn speed_step_settles_and_a_smooth_reference_cuts_the_overshoot() {
    let smooth = speed_step(&mut velocity(), true, |_| 0.0);
    let rough = speed_step(&mut velocity(), false, |_| 0.0);
    println!(
        "0 to 0.5 m/s: overshoot {:.4} m/s with α̇_d, α̈_d, {:.4} without; rests {:.5} m/s off",
        smooth.overshoot, rough.overshoot, smooth.rest
    );
    assert!(
        smooth.overshoot < 0.02 && rough.overshoot > 3.0 * smooth.overshoot,
        "{} against {}",
        smooth.overshoot,
        rough.overshoot
    );
    assert!(smooth.rest < 1e-3, "rests {} m/s off", smooth.rest);
}

#[test]
fn pitch_observer_takes_the_ripple_out_of_the_speed() {
    let imbalance = |shell: f64| 2.3 * shell.cos();
    let with = speed_step(&mut velocity(), true, imbalance);
    let mut blind = Hsmc::new(
        &liu().params,
        HsmcGains {
            observer: 0.0,
            ..hsmc_gains()
        },
    )
    .expect("holds");
    let without = speed_step(&mut blind, true, imbalance);
    println!(
        "2.3 N·m: speed ripples by {:.4} m/s with the observer, {:.4} without; ŵ off by {:.3} N·m",
        with.rest, without.rest, with.w_error
    );
    assert!(with.w_error < 0.1, "ŵ is off by {} N·m", with.w_error);
    assert!(
        without.rest > 5.0 * with.rest,
        "{} against {}",
        without.rest,
        with.rest
    );
}

// ---- filters for typed steps ---------------------------------------------------------------------------------------------

/// The filters' derivatives are derivatives of what they give: differenced over 1 ms, error O(h) of the next derivative.
#[test]
fn filters_are_consistent_and_arrive() {
    let h = 1e-3;
    let mut roll = RollFilter::new(10.0, 0.0);
    let mut speed = SpeedFilter::new(0.2);
    let (mut r, mut s) = (roll.step(0.17, h), speed.step(0.8, h));
    for _ in 0..4000 {
        let (r_next, s_next) = (roll.step(0.17, h), speed.step(0.8, h));
        let differs = |a: f64, b: f64, slope0: f64, slope1: f64, what: &str| {
            // The mean of two slopes is off by h²/12 of the fourth derivative, below 0.17 w⁴ · 5.
            support::assert_close(what, (b - a) / h, 0.5 * (slope0 + slope1), 1e-3);
        };
        differs(r.q_r, r_next.q_r, r.q_r_rate, r_next.q_r_rate, "q_r");
        differs(
            r.q_r_rate,
            r_next.q_r_rate,
            r.q_r_accel,
            r_next.q_r_accel,
            "q_r rate",
        );
        differs(s.v, s_next.v, s.v_rate, s_next.v_rate, "v");
        // The ramp's end makes v̈ bend within one step: half a step of its 30 m/s⁴.
        support::assert_close(
            "v rate",
            (s_next.v_rate - s.v_rate) / h,
            0.5 * (s.shape.accel_rate + s_next.shape.accel_rate),
            0.02,
        );
        assert!(
            s_next.v_rate <= SPEED_RAMP * (1.0 + 1e-12)
                && s_next.v <= 0.8 + 1e-12
                && r_next.q_r <= 0.17 + 1e-12
        );
        (r, s) = (r_next, s_next);
    }
    support::assert_close("roll", r.q_r, 0.17, 1e-12);
    support::assert_close("speed", s.v, 0.8, 1e-6);
}

/// Exact in the step: 50 Hz and 1 kHz give the same curve.
#[test]
fn filters_do_not_depend_on_the_period() {
    let (mut coarse, mut fine) = (
        (RollFilter::new(10.0, 0.1), SpeedFilter::new(0.0)),
        (RollFilter::new(10.0, 0.1), SpeedFilter::new(0.0)),
    );
    for i in 0..200 {
        let (q_r, v) = if i < 60 { (-0.1, 0.33) } else { (0.05, -0.2) };
        let a = (coarse.0.step(q_r, PERIOD), coarse.1.step(v, PERIOD));
        let mut b = a;
        for _ in 0..20 {
            b = (
                fine.0.step(q_r, PERIOD / 20.0),
                fine.1.step(v, PERIOD / 20.0),
            );
        }
        support::assert_close("q_r", a.0.q_r, b.0.q_r, 1e-12);
        support::assert_close("q_r accel", a.0.q_r_accel, b.0.q_r_accel, 1e-11);
        support::assert_close("v", a.1.v, b.1.v, 1e-12);
        support::assert_close(
            "v accel rate",
            a.1.shape.accel_rate,
            b.1.shape.accel_rate,
            1e-11,
        );
    }
}

#[test]
fn filter_holds_its_last_command_through_garbage() {
    let (mut filter, mut clean) = (RollFilter::new(10.0, 0.0), RollFilter::new(10.0, 0.0));
    filter.step(0.1, PERIOD);
    clean.step(0.1, PERIOD);
    assert_eq!(filter.step(f64::NAN, PERIOD), clean.step(0.1, PERIOD));
    let held = filter.step(0.1, f64::NAN);
    assert!(held.q_r.is_finite() && held.q_r_accel.is_finite());
}

// ---- the loops -----------------------------------------------------------------------------------------------------------

#[derive(Debug, Default)]
struct RollRun {
    /// Time of the last error above 1° [s].
    settled: f64,
    /// Largest lean to the wrong side [°].
    wrong_way: f64,
    /// Largest lean beyond the command [°].
    overshoot: f64,
    /// Root mean square error from 5 to 30 s [°].
    rms: f64,
    /// Largest error of the last 5 s [°].
    rest: f64,
    /// Largest |ŵ − w| of the last 5 s, w one period later [N·m].
    w_error: f64,
}

/// A typed step of 10° on the planar roll sub-model at speed `v`, with `disturbance(shell angle)` on row q_r; the torque acts a period `late` or at once: 60 s.
fn roll_step(
    controller: &mut Htsmc,
    v: f64,
    w_ref: f64,
    late: bool,
    disturbance: impl Fn(f64) -> f64,
) -> RollRun {
    let command = 10.0 * DEG;
    let (mut s, mut shell) = (
        RobotState {
            v,
            ..RobotState::default()
        },
        0.0f64,
    );
    let mut filter = RollFilter::new(w_ref, 0.0);
    let mut run = RollRun::default();
    let (mut squares, mut waiting) = (0.0, 0.0);
    for i in 0..3000 {
        let t = f64::from(i) * PERIOD;
        let r = filter.step(command, PERIOD);
        let setpoint = Setpoint {
            q_r: r.q_r,
            q_r_rate: r.q_r_rate,
            q_r_accel: r.q_r_accel,
            v,
            v_rate: 0.0,
        };
        let commanded = controller.step(&s, &setpoint, PERIOD);
        let torque = if late {
            core::mem::replace(&mut waiting, commanded)
        } else {
            commanded
        };
        let error = (s.q_r - command) / DEG;
        if error.abs() > 1.0 {
            run.settled = t;
        }
        run.wrong_way = run.wrong_way.max(-s.q_r / DEG);
        run.overshoot = run.overshoot.max(error);
        if (250..1500).contains(&i) {
            squares += error * error / 1250.0;
        }
        if i >= 2750 {
            run.rest = run.rest.max(error.abs());
            let next = shell + v / liu().params.r * PERIOD;
            run.w_error = run
                .w_error
                .max((controller.disturbance().torque - disturbance(next)).abs());
        }
        for _ in 0..20 {
            s = rolled(&s, torque, disturbance(shell));
            shell += v / liu().params.r * 1e-3;
        }
        assert!(s.beta.abs() < 1.0, "the pendulum swings out at {t} s");
    }
    run.rms = squares.sqrt();
    run
}

struct SpeedRun {
    /// Largest speed beyond the command [m/s].
    overshoot: f64,
    /// Largest error of the last 5 s [m/s].
    rest: f64,
    /// Largest |ŵ − w| of the last 5 s, w one period later [N·m].
    w_error: f64,
}

/// A typed step from rest to 0.5 m/s on the planar pitch sub-model, with `disturbance(shell angle)` on row φ: 30 s.
fn speed_step(controller: &mut Hsmc, smooth: bool, disturbance: impl Fn(f64) -> f64) -> SpeedRun {
    let (mut s, mut shell) = (RobotState::default(), 0.0f64);
    let mut filter = SpeedFilter::new(0.0);
    let mut run = SpeedRun {
        overshoot: 0.0,
        rest: 0.0,
        w_error: 0.0,
    };
    for i in 0..1500 {
        let r = filter.step(0.5, PERIOD);
        let setpoint = Setpoint {
            v: r.v,
            v_rate: r.v_rate,
            ..Setpoint::default()
        };
        let shape = if smooth {
            r.shape
        } else {
            SpeedShape::default()
        };
        let torque = controller.step(&s, &setpoint, shape, PERIOD);
        run.overshoot = run.overshoot.max(s.v - 0.5);
        if i > 1250 {
            run.rest = run.rest.max((s.v - 0.5).abs());
            let next = shell + s.v / liu().params.r * PERIOD;
            run.w_error = run
                .w_error
                .max((controller.disturbance().torque - disturbance(next)).abs());
        }
        for _ in 0..20 {
            let w = disturbance(shell);
            let r = liu().params.r;
            let rate = |s: &RobotState| model().pitch_submodel(s, w).accelerations(torque);
            let y = rk4([s.alpha, s.alpha_rate, s.v], |y| {
                let at = RobotState {
                    alpha: y[0],
                    alpha_rate: y[1],
                    v: y[2],
                    ..s
                };
                let [alpha_accel, rolling_accel] = rate(&at);
                [y[1], alpha_accel, r * rolling_accel]
            });
            [s.alpha, s.alpha_rate, s.v] = y;
            shell += s.v / r * 1e-3;
        }
        assert!(s.alpha.abs() < 1.0, "the pendulum swings out");
    }
    run
}

/// 1 ms of the planar roll sub-model, v and α held.
fn rolled(s: &RobotState, torque: f64, w: f64) -> RobotState {
    let model = model();
    let [beta, beta_rate, q_r, q_r_rate] = rk4([s.beta, s.beta_rate, s.q_r, s.q_r_rate], |y| {
        let at = RobotState {
            beta: y[0],
            beta_rate: y[1],
            q_r: y[2],
            q_r_rate: y[3],
            ..*s
        };
        let [beta_accel, q_r_accel] = model.roll_submodel(&at, w).accelerations(torque);
        [y[1], beta_accel, y[3], q_r_accel]
    });
    RobotState {
        beta,
        beta_rate,
        q_r,
        q_r_rate,
        ..*s
    }
}

fn rk4<const N: usize>(y: [f64; N], rate: impl Fn(&[f64; N]) -> [f64; N]) -> [f64; N] {
    let h = 1e-3;
    let ahead = |k: &[f64; N], h: f64| core::array::from_fn(|i| y[i] + h * k[i]);
    let k1 = rate(&y);
    let k2 = rate(&ahead(&k1, h / 2.0));
    let k3 = rate(&ahead(&k2, h / 2.0));
    let k4 = rate(&ahead(&k3, h));
    core::array::from_fn(|i| y[i] + h / 6.0 * (k1[i] + 2.0 * k2[i] + 2.0 * k3[i] + k4[i]))
}

fn liu() -> &'static Robot {
    &LIU
}

fn model() -> NominalModel {
    NominalModel::new(&LIU.params)
}

fn gains() -> HtsmcGains {
    HtsmcGains::read(&LIU).expect("valid")
}

fn hsmc_gains() -> HsmcGains {
    HsmcGains::read(&LIU).expect("valid")
}

fn direction() -> Htsmc {
    Htsmc::from_robot(liu()).expect("valid")
}

fn velocity() -> Hsmc {
    Hsmc::from_robot(liu()).expect("valid")
}

static LIU: LazyLock<Robot> = LazyLock::new(|| Robot::embedded("liu").expect("embedded"));

/// The direction controller without its observer.
fn blind() -> Htsmc {
    let gains = HtsmcGains {
        observer: 0.0,
        ..gains()
    };
    Htsmc::new(&liu().params, gains).expect("holds")
}
