//! What the torque controllers promise of themselves: eq (19), symmetry, finite torques, and refusal of gains that fall over.

mod support;

use std::sync::LazyLock;

use proptest::prelude::*;
use sphere_agent::control::hsmc::{self, Hsmc, SpeedShape};
use sphere_agent::control::htsmc::{self, Htsmc};
use sphere_agent::control::observer::Disturbance;
use sphere_agent::control::sliding::{sat, sig};
use sphere_agent::control::{Counters, DirectionChoice, DirectionController};
use sphere_agent::gains::{Condition, GainsError, HsmcGains, HtsmcGains};
use sphere_agent::model::NominalModel;
use sphere_protocol::robot::Robot;
use sphere_protocol::state::{RobotState, Setpoint};

/// One control period [s].
const PERIOD: f64 = 0.02;

// ---- eq (19) -------------------------------------------------------------------------------------------------------------

proptest! {
    // A failure prints its smallest input; nothing is kept between runs.
    #![proptest_config(ProptestConfig { cases: 2000, failure_persistence: None, ..ProptestConfig::default() })]

    /// Eq (19): Ṡ = −k S − ε sat(S/Φ), so L̇ = S Ṡ ≤ 0, with v, α, ŵ frozen and τ unsaturated. Ṡ comes from the accelerations of the
    /// whole-body model and eq (15); to rounding: 1e-12 of the terms that cancel.
    #[test]
    fn surface_decays_as_the_reaching_law_says(s in states(), r in setpoints(), integral in -0.05..0.05, w in -3.0..3.0) {
        let (model, g) = (model(), gains());
        let w = Disturbance { torque: w, ..Disturbance::default() };
        let t = htsmc::law(&model, &g, &s, &r, integral, w);
        prop_assume!(!t.guarded);
        let [beta_accel, q_r_accel] = model.roll_submodel(&s, w.torque).accelerations(t.torque);
        let (e, e_rate) = (s.q_r - r.q_r, s.q_r_rate - r.q_r_rate);
        let (e_beta, e_beta_rate) = (s.beta - t.beta_d.angle, s.beta_rate - t.beta_d.rate);
        let s1_rate = q_r_accel - r.q_r_accel + (g.a1 + g.c1 * sig(e, g.gamma, g.mu).slope) * e_rate + g.k_i * e;
        let s2_rate = beta_accel - t.beta_d.accel + (g.a2 + g.c2 * sig(e_beta, g.gamma, g.mu).slope) * e_beta_rate;
        let s_rate = g.a * s1_rate + g.b * s2_rate;
        let expected = -g.k * t.s - g.epsilon * sat(t.s / g.phi);
        let scale = 1.0 + g.a * (q_r_accel.abs() + s1_rate.abs()) + g.b * (beta_accel.abs() + s2_rate.abs());
        prop_assert!((s_rate - expected).abs() <= 1e-12 * scale, "{s_rate} instead of {expected}");
        prop_assert!(t.s * expected <= 0.0);
        prop_assert!(t.s * s_rate <= 1e-12 * scale * t.s.abs());
    }

    /// The same without eq (15): S itself, differenced along the motion that the torque brings about. Central differences over
    /// ±10 µs: S″′ h²/6 and rounding 1e-16 S/h both stay below 1e-5 of the accelerations.
    #[test]
    fn surface_differenced_along_the_motion_decays(s in states(), r in setpoints(), integral in -0.05..0.05, w in -3.0..3.0) {
        let (model, g) = (model(), gains());
        let w = Disturbance { torque: w, ..Disturbance::default() };
        let t = htsmc::law(&model, &g, &s, &r, integral, w);
        let [beta_accel, q_r_accel] = model.roll_submodel(&s, w.torque).accelerations(t.torque);
        let surface = |h: f64| {
            let moved = RobotState {
                beta: s.beta + h * s.beta_rate + h * h / 2.0 * beta_accel,
                beta_rate: s.beta_rate + h * beta_accel,
                q_r: s.q_r + h * s.q_r_rate + h * h / 2.0 * q_r_accel,
                q_r_rate: s.q_r_rate + h * q_r_accel,
                ..s
            };
            let reference = Setpoint {
                q_r: r.q_r + h * r.q_r_rate + h * h / 2.0 * r.q_r_accel,
                q_r_rate: r.q_r_rate + h * r.q_r_accel,
                ..r
            };
            htsmc::law(&model, &g, &moved, &reference, integral + h * (s.q_r - r.q_r), w)
        };
        let (before, after) = (surface(-1e-5), surface(1e-5));
        // At its clamp β_d has a corner, which no difference sees through.
        let clamped = |x: &htsmc::HtsmcTerms| x.beta_d.rate == 0.0 && x.beta_d.accel == 0.0;
        prop_assume!(!t.guarded && clamped(&before) == clamped(&t) && clamped(&after) == clamped(&t));
        let s_rate = (after.s - before.s) / 2e-5;
        let expected = -g.k * t.s - g.epsilon * sat(t.s / g.phi);
        let scale = 1.0 + g.a * q_r_accel.abs() + g.b * beta_accel.abs();
        prop_assert!((s_rate - expected).abs() <= 1e-5 * scale, "{s_rate} instead of {expected}");
    }

    /// Left and right are alike: mirrored state, reference and disturbance give exactly the mirrored roll torque and the same pitch torque.
    #[test]
    fn torque_is_mirror_antisymmetric(s in states(), r in setpoints(), integral in -0.05..0.05, w in -3.0..3.0, w_rate in -5.0..5.0, w_accel in -20.0..20.0, share in 0.0..0.5) {
        let (model, g) = (model(), gains());
        let (mirrored, w) = (mirror(&s), Disturbance { torque: w, rate: w_rate, accel: w_accel, inertial: [share * w, share * w_rate, share * w_accel] });
        let w_mirrored = Disturbance { torque: -w.torque, rate: -w.rate, accel: -w.accel, inertial: w.inertial.map(|part| -part) };
        let left = htsmc::law(&model, &g, &s, &r, integral, w).torque;
        let right = htsmc::law(&model, &g, &mirrored, &mirror_setpoint(&r), -integral, w_mirrored).torque;
        prop_assert_eq!(left, -right);
        let gains = hsmc_gains();
        let pitch = |s: &RobotState| hsmc::law(&model, &gains, s, &r, SpeedShape::default(), integral, w).torque;
        prop_assert_eq!(pitch(&s), pitch(&mirrored));
    }

    /// Whatever is in the state, the controllers give a finite torque within τ_max, and a good state after it is served as before.
    #[test]
    fn torque_is_finite_and_within_its_limit_for_any_input(bits in prop::array::uniform16(any::<u64>()), dt in any::<f64>()) {
        let x = bits.map(f64::from_bits);
        let state = RobotState {
            x: x[0], y: x[1], heading: x[2], v: x[3], q_r: x[4], q_r_rate: x[5], beta: x[6], beta_rate: x[7], alpha: x[8], alpha_rate: x[9],
        };
        let setpoint = Setpoint { v: x[10], v_rate: x[11], q_r: x[12], q_r_rate: x[13], q_r_accel: x[14] };
        let shape = SpeedShape { accel_rate: x[15], accel_rate_rate: x[0] };
        let limit = liu().params.torque_max;
        let (mut roll, mut pitch) = (direction(), velocity());
        for dt in [dt, PERIOD, PERIOD] {
            prop_assert!(roll.step(&state, &setpoint, dt).abs() <= limit);
            prop_assert!(pitch.step(&state, &setpoint, shape, dt).abs() <= limit);
        }
        let good = RobotState { v: 0.5, q_r: 0.01, ..RobotState::default() };
        prop_assert!(roll.step(&good, &Setpoint::default(), PERIOD).abs() <= limit);
        roll.reset();
        pitch.reset();
        let fresh = (direction().step(&good, &Setpoint::default(), PERIOD), velocity().step(&good, &Setpoint::default(), SpeedShape::default(), PERIOD));
        prop_assert_eq!(roll.step(&good, &Setpoint::default(), PERIOD), fresh.0);
        prop_assert_eq!(pitch.step(&good, &Setpoint::default(), SpeedShape::default(), PERIOD), fresh.1);
    }
}

#[test]
fn not_a_number_gives_no_torque_is_counted_and_forgotten() {
    let good = RobotState {
        v: 0.7,
        q_r: 0.02,
        alpha_rate: 0.1,
        ..RobotState::default()
    };
    let setpoint = Setpoint {
        v: 0.5,
        ..Setpoint::default()
    };
    let (mut roll, mut pitch) = (direction(), velocity());
    let (mut roll_alone, mut pitch_alone) = (direction(), velocity());
    for _ in 0..50 {
        for poison in [
            RobotState {
                q_r: f64::NAN,
                ..good
            },
            RobotState {
                alpha: f64::INFINITY,
                ..good
            },
        ] {
            assert_eq!(roll.step(&poison, &setpoint, PERIOD), 0.0);
            assert_eq!(
                pitch.step(&poison, &setpoint, SpeedShape::default(), PERIOD),
                0.0
            );
        }
        // The pose may be anything: no law uses it.
        let lost = RobotState {
            x: f64::NAN,
            heading: f64::NAN,
            ..good
        };
        let torque = (
            roll.step(&lost, &setpoint, PERIOD),
            pitch.step(&lost, &setpoint, SpeedShape::default(), PERIOD),
        );
        let alone = (
            roll_alone.step(&good, &setpoint, PERIOD),
            pitch_alone.step(&good, &setpoint, SpeedShape::default(), PERIOD),
        );
        assert_eq!(torque, alone);
        assert!(torque.0 != 0.0 && torque.1 != 0.0);
    }
    assert_eq!(roll.step(&good, &setpoint, 0.0), 0.0);
    assert_eq!(roll.counters().not_finite, 101);
    assert_eq!(pitch.counters().not_finite, 100);
}

#[test]
fn torque_at_the_all_zero_state_is_exactly_zero() {
    let (state, setpoint) = (RobotState::default(), Setpoint::default());
    let (mut roll, mut pitch) = (direction(), velocity());
    for _ in 0..100 {
        assert_eq!(roll.step(&state, &setpoint, PERIOD), 0.0);
        assert_eq!(
            pitch.step(&state, &setpoint, SpeedShape::default(), PERIOD),
            0.0
        );
    }
    assert_eq!(roll.counters(), Counters::default());
    assert_eq!(pitch.counters(), Counters::default());
}

// ---- gains that fall over are refused ------------------------------------------------------------------------------------

#[test]
fn gains_of_liu_meet_every_condition() {
    let (direction, velocity) = (
        gains().conditions(&model()),
        hsmc_gains().conditions(&model()),
    );
    for condition in direction.iter().chain(&velocity) {
        println!("{condition}");
        assert!(condition.holds && condition.margin > 0.0, "{condition}");
    }
    // The bounds of this robot, derived by hand: (d − c)/(c − a) = 3.5763/0.3801 in roll and 3.3763/0.3701 in pitch.
    support::assert_close("A/B in roll", bound(&direction, "below"), 9.4081, 1e-4);
    support::assert_close("A/B in pitch", bound(&velocity, "below"), 9.1219, 1e-4);
}

#[test]
fn ratio_beyond_e2_is_refused_with_the_numbers() {
    let good = gains();
    let refused =
        Htsmc::new(&liu().params, HtsmcGains { a: 9.5, ..good }).expect_err("A/B = 9.5 diverges");
    let text = refused.to_string();
    assert!(
        text.contains("E2") && text.contains("9.5000") && text.contains("9.4081"),
        "{text}"
    );
    assert_eq!(refused.broken.len(), 1);
    support::assert_close("margin", refused.broken[0].margin, 9.4081 - 9.5, 1e-3);
    Htsmc::new(&liu().params, HtsmcGains { a: 9.3, ..good }).expect("A/B = 9.3 is below 9.41");

    let refused = Hsmc::new(
        &liu().params,
        HsmcGains {
            a: 9.2,
            ..hsmc_gains()
        },
    )
    .expect_err("A/B = 9.2 is above 9.12");
    assert!(refused.to_string().contains("9.1219"), "{refused}");
    Hsmc::new(
        &liu().params,
        HsmcGains {
            a: 9.0,
            ..hsmc_gains()
        },
    )
    .expect("A/B = 9.0 is below 9.12");
}

#[test]
fn slower_pendulum_surface_is_refused() {
    let refused = Htsmc::new(
        &liu().params,
        HtsmcGains {
            a1: 6.5,
            a2: 2.5,
            ..gains()
        },
    )
    .expect_err("λ₂ < λ₁");
    let text = refused.to_string();
    assert!(
        text.contains("E3") && text.contains("3.0000") && text.contains("7.0000"),
        "{text}"
    );
    let refused = Hsmc::new(
        &liu().params,
        HsmcGains {
            a1: 4.1,
            ..hsmc_gains()
        },
    )
    .expect_err("a₂ < a₁");
    assert!(refused.to_string().contains("E3"), "{refused}");
}

#[test]
fn terminal_term_too_steep_for_the_pendulum_surface_is_refused() {
    // E3 holds far from the surface, 4.0 > 3.0, but a₁ + c₁ (2 − γ) μ^(γ−1) = 2.5 + 0.5 · 1.2222 · 2.1799 = 3.8321 near it.
    let refused = Htsmc::new(&liu().params, HtsmcGains { a2: 3.5, ..gains() }).expect_err("E4");
    let text = refused.to_string();
    assert!(
        text.contains("E4") && text.contains("3.5000") && text.contains("3.8321"),
        "{text}"
    );
    assert!(refused.broken.iter().all(|c| c.name != "E3"), "{text}");
    Htsmc::new(&liu().params, HtsmcGains { a2: 3.9, ..gains() }).expect("3.9 is above 3.8321");
}

#[test]
fn values_that_are_no_number_are_refused() {
    for gains in [
        HtsmcGains {
            a: f64::NAN,
            ..gains()
        },
        HtsmcGains {
            a2: f64::NAN,
            ..gains()
        },
        HtsmcGains {
            gamma: 1.0,
            ..gains()
        },
        HtsmcGains {
            k_i: 1e3,
            ..gains()
        },
    ] {
        let refused = Htsmc::new(&liu().params, gains).expect_err("impossible gains");
        println!("{refused}");
    }
}

#[test]
fn robot_file_with_gains_that_fall_over_is_refused_by_name() {
    let text = include_str!("../protocol/robots/liu.toml");
    let steep = text.replace("a = { value = 4.9,", "a = { value = 9.5,");
    let robot = Robot::parse("steep", &steep).expect("reads");
    let error = DirectionChoice::Htsmc.build(&robot).err().expect("refused");
    assert!(matches!(error, GainsError::Refused { .. }));
    assert!(
        error
            .to_string()
            .starts_with("steep: [htsmc] is refused: E2: A/B = 9.5"),
        "{error}"
    );

    let misspelt = text.replace(
        "epsilon = { value = 0.3, unit = \"rad/s^2\", source = \"tuned\" }\nphi = { value = 0.4",
        "epsilom = { value = 0.3, unit = \"rad/s^2\", source = \"tuned\" }\nphi = { value = 0.4",
    );
    assert_ne!(misspelt, text);
    let robot = Robot::parse("misspelt", &misspelt).expect("reads");
    let error = DirectionChoice::Htsmc
        .build(&robot)
        .err()
        .expect("refused")
        .to_string();
    assert!(
        error.starts_with("misspelt: line ") && error.contains("did you mean `epsilon`?"),
        "{error}"
    );
}

#[test]
fn gain_near_zero_is_guarded_and_counted() {
    let steep = HtsmcGains { a: 9.3, ..gains() };
    let mut controller = Htsmc::new(&liu().params, steep).expect("holds");
    let leaning = RobotState {
        q_r: 0.01,
        ..RobotState::default()
    };
    let torque = controller.step(&leaning, &Setpoint::default(), PERIOD);
    let t = controller.terms();
    let b1 = model().roll_submodel(&leaning, 0.0).b1;
    assert!(t.guarded && t.gain < 0.15 * b1 && torque.is_finite());
    assert_eq!(controller.counters().gain_guard, 1);
    // The guard divides by 0.15 B b₁: the torque is smaller than the bare law's by that share.
    let bare = htsmc::law(
        &model(),
        &steep,
        &leaning,
        &Setpoint::default(),
        0.0,
        Disturbance::default(),
    );
    assert_eq!(bare.torque, t.torque);
    assert_eq!(
        direction()
            .step(&leaning, &Setpoint::default(), PERIOD)
            .signum(),
        torque.signum()
    );
}

#[test]
fn choice_reads_as_configurations_write_it() {
    #[derive(serde::Deserialize)]
    struct Config {
        roll_controller: DirectionChoice,
    }
    let config: Config = toml::from_str("roll_controller = \"htsmc\"").expect("known");
    assert_eq!(config.roll_controller, DirectionChoice::Htsmc);
    assert!(toml::from_str::<Config>("roll_controller = \"htsmk\"").is_err());
}

prop_compose! {
    /// States of the golden file's ranges.
    fn states()(
        alpha in -0.5..0.5, beta in -0.7..0.7, q_r in -0.45..0.45, alpha_rate in -2.0..2.0, v in -0.5..1.5, beta_rate in -3.0..3.0, q_r_rate in -1.5..1.5,
    ) -> RobotState {
        RobotState { alpha, beta, q_r, alpha_rate, v, beta_rate, q_r_rate, ..RobotState::default() }
    }
}

prop_compose! {
    fn setpoints()(v in -0.5..1.5, v_rate in -0.5..0.5, q_r in -0.3..0.3, q_r_rate in -0.8..0.8, q_r_accel in -4.0..4.0) -> Setpoint {
        Setpoint { v, v_rate, q_r, q_r_rate, q_r_accel }
    }
}

fn mirror(s: &RobotState) -> RobotState {
    RobotState {
        q_r: -s.q_r,
        q_r_rate: -s.q_r_rate,
        beta: -s.beta,
        beta_rate: -s.beta_rate,
        ..*s
    }
}

fn mirror_setpoint(r: &Setpoint) -> Setpoint {
    Setpoint {
        q_r: -r.q_r,
        q_r_rate: -r.q_r_rate,
        q_r_accel: -r.q_r_accel,
        ..*r
    }
}

fn bound(conditions: &[Condition], relation: &str) -> f64 {
    let is = |c: &&Condition| c.name == "E2" && c.relation.to_string() == relation;
    conditions.iter().find(is).expect("listed").bound
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
