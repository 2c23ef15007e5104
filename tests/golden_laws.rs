//! Equations (4)-(17) as corrected, and as printed where the paper's own numbers are wanted, against `tests/golden`.
//!
//! The vectors come from an independent implementation in another language; parameters and gains are read from the same file.
//! Tolerance 1e-9 relative to max(1, |expected|): both sides compute in f64, in another order of operations.

mod support;

use nalgebra::{Matrix4, Vector4};
use serde_json::Value;
use sphere_agent::control::observer::{Disturbance, DisturbanceObserver, ObserverGains};
use sphere_agent::control::{hsmc, htsmc, sliding};
use sphere_agent::gains::{HsmcGains, HtsmcGains};
use sphere_agent::model::printed::FloorForces;
use sphere_agent::model::{NominalModel, SubModel};
use sphere_protocol::robot::{Robot, RobotParams};
use sphere_protocol::state::{RobotState, Setpoint, Torque};

const TOL: f64 = 1e-9;

#[test]
fn golden_corrected_whole_body() {
    for_each_case(|model, name, case| {
        let expected = &case["corrected"];
        let (state, torque) = (state(&case["state"]), torque(&case["input"]));
        close_matrix(
            &name("M"),
            &model.inertia(&state),
            &expected["M_sym_alpha_x_beta_qr"],
        );
        close_vector(&name("N"), &model.forces(&state), &expected["N_Nm_N_Nm_Nm"]);
        close_vector(
            &name("acceleration"),
            &model.accelerations(&state, &torque),
            &expected["acc_alpha_x_beta_qr_rad_m_per_s2"],
        );
        close(&name("energy"), model.energy(&state), &expected["energy_J"]);
    });
}

#[test]
fn golden_corrected_forces_without_dissipation_and_turn() {
    for_each_case(|model, name, case| {
        let frictionless = frictionless(model);
        // The turning terms are all proportional to tan q_r, and nothing else depends on q_r.
        let upright = RobotState {
            q_r: 0.0,
            ..state(&case["state"])
        };
        close_vector(
            &name("N"),
            &frictionless.forces(&upright),
            &case["corrected"]["N_conservative_no_turn"],
        );
    });
}

#[test]
fn golden_paper_whole_body() {
    for_each_case(|model, name, case| {
        let expected = &case["paper"];
        let (state, torque) = (state(&case["state"]), torque(&case["input"]));
        let floor = FloorForces {
            fp: number(expected, "F_fp_N"),
            fr: number(expected, "F_fr_N"),
        };
        close_matrix(
            &name("M"),
            &model.printed_inertia(&state),
            &expected["M_rows_alpha_phi_beta_qr"],
        );
        close_vector(
            &name("N"),
            &model.printed_forces(&state, floor),
            &expected["N_N_m"],
        );
        close_vector(
            &name("acceleration"),
            &model.printed_accelerations(&state, floor, &torque),
            &expected["acc_alpha_x_beta_qr_rad_m_per_s2"],
        );
    });
}

#[test]
fn golden_roll_submodel() {
    for_each_case(|model, name, case| {
        let state = state(&case["state"]);
        close_submodel(
            &name,
            &model.roll_submodel(&state, 0.0),
            &case["roll_submodel"],
        );
    });
}

#[test]
fn golden_roll_submodel_printed() {
    for_each_case(|model, name, case| {
        let state = state(&case["state"]);
        close_submodel(
            &name,
            &model.printed_roll_submodel(&state),
            &case["roll_submodel_printed"],
        );
    });
}

#[test]
fn golden_htsmc() {
    htsmc_cases("htsmc", |reference| Disturbance {
        torque: number(reference, "w_hat_N_m"),
        rate: number(reference, "w_hat_dot_N_m_per_s"),
        // The vectors were made without ŵ̈ and without the pendulum's inertia.
        ..Disturbance::default()
    });
}

#[test]
fn golden_htsmc_no_dob() {
    htsmc_cases("htsmc_no_dob", |_| Disturbance::default());
}

#[test]
fn golden_hsmc() {
    for (_, file) in support::golden_files("cases") {
        let model = model(&file);
        let gains = hsmc_gains(&file["gains_hsmc"]);
        for (i, case) in rows(&file, "cases").iter().enumerate() {
            let reference = &case["reference"];
            let terms = hsmc::law(
                &model,
                &gains,
                &state(&case["state"]),
                &setpoint(reference),
                hsmc::SpeedShape::default(),
                number(reference, "int_e_v_over_R_rad"),
                Disturbance::default(),
            );
            assert!(!terms.guarded, "case {i}: the golden law has no guard");
            let expected = &case["hsmc"];
            for (key, actual) in [
                ("alpha_d_rad", terms.alpha_d),
                ("S1_rad_per_s", terms.s1),
                ("S2_rad_per_s", terms.s2),
                ("S_rad_per_s", terms.s),
                ("input_gain_per_kg_m2", terms.gain),
                ("tau_p_unsaturated_N_m", terms.torque),
            ] {
                close(&format!("case {i} {key}"), actual, &expected[key]);
            }
        }
    }
}

#[test]
fn golden_sig_cases() {
    for (_, file) in support::golden_files("sig_cases") {
        for (i, case) in rows(&file, "sig_cases").iter().enumerate() {
            let sig = sliding::sig(number(case, "e"), number(case, "gamma"), number(case, "mu"));
            close(&format!("sig {i}"), sig.value, &case["sig"]);
            close(&format!("sig {i} slope"), sig.slope, &case["dsig"]);
        }
    }
}

#[test]
fn golden_dob_sequence() {
    const KEY: &str = "dob_sequence_Ts_0p02_s";
    for (_, file) in support::golden_files(KEY) {
        let model = model(&file);
        let gains = htsmc_gains(&file["gains_htsmc"]);
        let mut observer = DisturbanceObserver::new(ObserverGains {
            bandwidth: gains.observer,
            oscillator: gains.oscillator,
            torque_max: 6.0,
            // The vectors know a constant and the shell-locked part alone: with the rest at 0 they must come out unchanged.
            ..ObserverGains::default()
        });
        for (i, row) in rows(&file, KEY).iter().enumerate() {
            let w = htsmc::observe(&mut observer, &model, &state(row), 0.02);
            close(&format!("step {i} raw"), observer.raw(), &row["w_raw_N_m"]);
            close(&format!("step {i} w"), w.torque, &row["w_hat_N_m"]);
            close(
                &format!("step {i} w rate"),
                w.rate,
                &row["w_hat_dot_N_m_per_s"],
            );
        }
    }
}

/// The corrected model without dissipation, integrated by RK4 at 1 ms as the vectors were: same trajectory, same energy.
#[test]
fn golden_energy_trajectory_of_the_corrected_model() {
    const KEY: &str = "energy_traj_L1_state_alpha_x_beta_qr_and_rates";
    for (_, file) in support::golden_files(KEY) {
        let model = frictionless(&model(&file));
        let trajectory = rows(&file, KEY);
        let mut s = [0.0; 8];
        for (slot, value) in s.iter_mut().zip(rows(&trajectory[0], "s")) {
            *slot = value.as_f64().expect("number");
        }
        let first = model.energy(&from_array(&s));
        let mut ms = 0;
        for point in trajectory {
            let until = (number(point, "t_s") * 1e3).round() as u32;
            while ms < until {
                s = rk4(&model, &s, 1e-3);
                ms += 1;
            }
            for (i, expected) in rows(point, "s").iter().enumerate() {
                close(&format!("t = {ms} ms, s[{i}]"), s[i], expected);
            }
            let energy = model.energy(&from_array(&s));
            close(&format!("t = {ms} ms, energy"), energy, &point["energy_J"]);
            // RK4's own drift; the generator promises the same bound.
            assert!(
                (energy - first).abs() < 1e-7,
                "energy drifts: {first} to {energy}"
            );
        }
        assert_eq!(ms, 2000);
    }
}

/// The embedded robot is the robot of the golden file: what holds for one holds for the other.
#[test]
fn golden_gains_and_parameters_are_those_of_liu() {
    let liu = Robot::embedded("liu").expect("embedded");
    for (path, file) in support::golden_files("cases") {
        if !path.ends_with("model.json") {
            continue;
        }
        // Four have been tuned since, and the observer has parts that the vectors do not know.
        assert_eq!(
            HtsmcGains {
                a: 5.2,
                a2: 6.5,
                k_i: 0.3,
                w_ref: 10.0,
                ..HtsmcGains::read(&liu).expect("valid")
            },
            htsmc_gains(&file["gains_htsmc"])
        );
        assert_eq!(
            HsmcGains::read(&liu).expect("valid"),
            hsmc_gains(&file["gains_hsmc"])
        );
        let golden = model(&file).params;
        for (ours, theirs) in [
            (liu.params.i_mr(), golden.i_mr()),
            (liu.params.i_mp(), golden.i_mp()),
            (liu.params.total_mass(), golden.total_mass()),
            (liu.params.i_s, golden.i_s),
            (liu.params.i_fr, golden.i_fr),
        ] {
            support::assert_close("parameter of liu", ours, theirs, 1e-15);
        }
    }
}

fn htsmc_cases(key: &str, disturbance: impl Fn(&Value) -> Disturbance) {
    for (_, file) in support::golden_files("cases") {
        let model = model(&file);
        let gains = htsmc_gains(&file["gains_htsmc"]);
        for (i, case) in rows(&file, "cases").iter().enumerate() {
            let reference = &case["reference"];
            let terms = htsmc::law(
                &model,
                &gains,
                &state(&case["state"]),
                &setpoint(reference),
                number(reference, "int_e_r_rad_s"),
                disturbance(reference),
            );
            assert!(!terms.guarded, "case {i}: the golden law has no guard");
            let expected = &case[key];
            for (key, actual) in [
                ("beta_d_rad", terms.beta_d.angle),
                ("beta_d_dot_rad_per_s", terms.beta_d.rate),
                ("beta_d_ddot_rad_per_s2", terms.beta_d.accel),
                ("S1_rad_per_s", terms.s1),
                ("S2_rad_per_s", terms.s2),
                ("S_rad_per_s", terms.s),
                ("input_gain_per_kg_m2", terms.gain),
                ("tau_r_unsaturated_N_m", terms.torque),
            ] {
                close(&format!("case {i} {key}"), actual, &expected[key]);
            }
        }
    }
}

fn for_each_case(check: impl Fn(&NominalModel, &dyn Fn(&str) -> String, &Value)) {
    for (_, file) in support::golden_files("cases") {
        let model = model(&file);
        for (i, case) in rows(&file, "cases").iter().enumerate() {
            check(&model, &|what| format!("case {i} {what}"), case);
        }
    }
}

fn rk4(model: &NominalModel, s: &[f64; 8], dt: f64) -> [f64; 8] {
    let rate = |s: &[f64; 8]| {
        let a = model.accelerations(&from_array(s), &Torque::default());
        [s[4], s[5], s[6], s[7], a[0], a[1], a[2], a[3]]
    };
    let ahead = |k: &[f64; 8], h: f64| core::array::from_fn(|i| s[i] + h * k[i]);
    let k1 = rate(s);
    let k2 = rate(&ahead(&k1, dt / 2.0));
    let k3 = rate(&ahead(&k2, dt / 2.0));
    let k4 = rate(&ahead(&k3, dt));
    core::array::from_fn(|i| s[i] + dt / 6.0 * (k1[i] + 2.0 * k2[i] + 2.0 * k3[i] + k4[i]))
}

/// Order of the file: α, x, β, q_r and their rates.
fn from_array(s: &[f64; 8]) -> RobotState {
    RobotState {
        alpha: s[0],
        x: s[1],
        beta: s[2],
        q_r: s[3],
        alpha_rate: s[4],
        v: s[5],
        beta_rate: s[6],
        q_r_rate: s[7],
        ..RobotState::default()
    }
}

fn frictionless(model: &NominalModel) -> NominalModel {
    NominalModel::new(&RobotParams {
        zeta: 0.0,
        c_rr: 0.0,
        ..model.params
    })
}

fn model(file: &Value) -> NominalModel {
    let p = &file["params_SI"];
    let params = RobotParams {
        m: number(p, "m"),
        m_f: number(p, "mf"),
        m_s: number(p, "ms"),
        r: number(p, "R"),
        l: number(p, "l"),
        i_s: number(p, "I_s"),
        j_mr: number(p, "J_ms"),
        j_mp: number(p, "J_mt"),
        j_mu: number(p, "J_mb"),
        i_fr: number(p, "I_fr"),
        i_fp: number(p, "I_fp"),
        i_fu: number(p, "J_fu"),
        zeta: number(p, "zeta"),
        c_rr: number(p, "c_rr"),
        v_rr: number(p, "v_rr"),
        g: number(p, "g"),
        // Of the actuator: no law uses it.
        ..Robot::embedded("liu").expect("embedded").params
    };
    NominalModel::new(&params.validated().expect("possible robot"))
}

fn htsmc_gains(g: &Value) -> HtsmcGains {
    assert_eq!(
        g["p1_over_q1"], g["p2_over_q2"],
        "one γ serves both surfaces"
    );
    assert_eq!(number(g, "k_dyn"), 0.0, "the law has no such term");
    HtsmcGains {
        a: number(g, "A"),
        b: number(g, "B"),
        a1: number(g, "a1_per_s"),
        c1: number(g, "c1"),
        a2: number(g, "a2_per_s"),
        c2: number(g, "c2"),
        gamma: number(g, "p1_over_q1"),
        k: number(g, "k_per_s"),
        epsilon: number(g, "eps_rad_per_s2"),
        phi: number(g, "Phi_rad_per_s"),
        mu: number(g, "mu_rad"),
        k_i: number(g, "k_i_per_s2"),
        w_ref: number(g, "w_ref_rad_per_s"),
        observer: number(g, "dob_L_per_s"),
        oscillator: number(g, "dob_osc_per_s"),
        ..HtsmcGains::read(&Robot::embedded("liu").expect("embedded")).expect("valid")
    }
}

fn hsmc_gains(g: &Value) -> HsmcGains {
    let liu = HsmcGains::read(&Robot::embedded("liu").expect("embedded")).expect("valid");
    HsmcGains {
        a: number(g, "A"),
        b: number(g, "B"),
        a1: number(g, "a1_per_s"),
        a2: number(g, "a2_per_s"),
        k: number(g, "k_per_s"),
        epsilon: number(g, "eps_rad_per_s2"),
        phi: number(g, "Phi_rad_per_s"),
        // The file has no pitch observer: the law is fed ŵ = 0.
        ..liu
    }
}

/// Reads the keys that are there: the observer's sequence has no pitch rate and no pose.
fn state(s: &Value) -> RobotState {
    let or_zero = |key: &str| s.get(key).map_or(0.0, |v| v.as_f64().expect("number"));
    RobotState {
        x: or_zero("x_m"),
        y: 0.0,
        heading: or_zero("phi_yaw_rad"),
        v: number(s, "v_m_per_s"),
        q_r: number(s, "q_r_rad"),
        q_r_rate: number(s, "q_r_dot_rad_per_s"),
        beta: number(s, "beta_rad"),
        beta_rate: number(s, "beta_dot_rad_per_s"),
        alpha: number(s, "alpha_rad"),
        alpha_rate: or_zero("alpha_dot_rad_per_s"),
    }
}

fn torque(input: &Value) -> Torque {
    Torque {
        pitch: number(input, "tau_p_N_m"),
        roll: number(input, "tau_r_N_m"),
    }
}

fn setpoint(reference: &Value) -> Setpoint {
    Setpoint {
        v: number(reference, "v_d_m_per_s"),
        v_rate: number(reference, "v_d_dot_m_per_s2"),
        q_r: number(reference, "q_rd_rad"),
        q_r_rate: number(reference, "q_rd_dot_rad_per_s"),
        q_r_accel: number(reference, "q_rd_ddot_rad_per_s2"),
    }
}

fn rows<'a>(value: &'a Value, key: &str) -> &'a Vec<Value> {
    value[key]
        .as_array()
        .unwrap_or_else(|| panic!("no array `{key}`"))
}

fn number(value: &Value, key: &str) -> f64 {
    value[key]
        .as_f64()
        .unwrap_or_else(|| panic!("no number `{key}`"))
}

fn close(what: &str, actual: f64, expected: &Value) {
    let expected = expected
        .as_f64()
        .unwrap_or_else(|| panic!("{what}: no number"));
    support::assert_close(what, actual, expected, TOL);
}

fn close_vector(what: &str, actual: &Vector4<f64>, expected: &Value) {
    for i in 0..4 {
        close(&format!("{what}[{i}]"), actual[i], &expected[i]);
    }
}

fn close_matrix(what: &str, actual: &Matrix4<f64>, expected: &Value) {
    for i in 0..4 {
        for j in 0..4 {
            close(
                &format!("{what}[{i}][{j}]"),
                actual[(i, j)],
                &expected[i][j],
            );
        }
    }
}

fn close_submodel(name: &dyn Fn(&str) -> String, actual: &SubModel, expected: &Value) {
    for (key, actual) in [
        ("f1_rad_per_s2", actual.f1),
        ("f2_rad_per_s2", actual.f2),
        ("b1_per_kg_m2", actual.b1),
        ("b2_per_kg_m2", actual.b2),
    ] {
        close(&name(key), actual, &expected[key]);
    }
}
