//! The plant against an independent derivation of the same equations (numeric Kane's method), vector by vector.

mod support;

use serde_json::Value;
use sphere_protocol::robot::{Robot, RobotParams};
use sphere_protocol::state::{RobotState, Torque};
use sphere_sim::disturbance::Surroundings;
use sphere_sim::plant::{Plant, PlantState};
use support::{assert_close, golden_files};

/// Both sides are the same formulas in double precision: only rounding separates them.
const TOL: f64 = 1e-9;

fn number(value: &Value, key: &str) -> f64 {
    value[key]
        .as_f64()
        .unwrap_or_else(|| panic!("no number `{key}` in {value}"))
}

fn row<const N: usize>(value: &Value) -> [f64; N] {
    let row = value.as_array().expect("an array");
    assert_eq!(row.len(), N);
    core::array::from_fn(|i| row[i].as_f64().expect("a number"))
}

/// The file's robot. It knows nothing of motors, so its joints have no Coulomb friction.
fn params(file: &Value) -> RobotParams {
    let p = &file["params_SI"];
    RobotParams {
        m: number(p, "m"),
        m_f: number(p, "mf"),
        m_s: number(p, "ms"),
        r: number(p, "R"),
        l: number(p, "l"),
        i_s: number(p, "I_s"),
        j_mr: number(p, "J_ms"),
        j_mp: number(p, "J_mt"),
        j_mu: number(p, "J_mb"),
        i_fr: number(p, "J_fs"),
        i_fp: number(p, "J_fn"),
        i_fu: number(p, "J_fu"),
        zeta: number(p, "zeta"),
        c_rr: number(p, "c_rr"),
        v_rr: number(p, "v_rr"),
        g: number(p, "g"),
        coulomb: 0.0,
        ..Robot::embedded("liu")
            .expect("comes with the project")
            .params
    }
    .validated()
    .expect("a possible robot")
}

fn state(case: &Value) -> PlantState {
    let s = &case["state"];
    let robot = RobotState {
        x: number(s, "x_m"),
        y: 0.0,
        heading: number(s, "phi_yaw_rad"),
        v: number(s, "v_m_per_s"),
        q_r: number(s, "q_r_rad"),
        q_r_rate: number(s, "q_r_dot_rad_per_s"),
        beta: number(s, "beta_rad"),
        beta_rate: number(s, "beta_dot_rad_per_s"),
        alpha: number(s, "alpha_rad"),
        alpha_rate: number(s, "alpha_dot_rad_per_s"),
    };
    PlantState { robot, phi_s: 0.0 }
}

#[test]
fn golden_mass_matrix_bias_and_energies() {
    for (_, file) in golden_files("cases") {
        let plant = Plant::new(params(&file));
        let level = Surroundings::level(plant.params());
        for (i, case) in file["cases"].as_array().expect("cases").iter().enumerate() {
            let (state, expected) = (state(case), &case["full3d"]);
            let equations = plant.equations(&state, &level);
            let m = equations.mass_matrix();
            for (j, expected) in row_of_rows(&expected["M_sym_alpha_v_beta_qr"])
                .iter()
                .enumerate()
            {
                for k in 0..4 {
                    assert_close(&format!("case {i}: M[{j}][{k}]"), m[j][k], expected[k], TOL);
                }
            }
            for (j, expected) in row::<4>(&expected["h_incl_gravity"])
                .into_iter()
                .enumerate()
            {
                assert_close(&format!("case {i}: h[{j}]"), equations.h[j], expected, TOL);
            }
            let kinetic = plant.kinetic_energy(&state);
            assert_close(
                &format!("case {i}: T"),
                kinetic,
                number(expected, "kinetic_J"),
                TOL,
            );
            // On level ground the height of the bob is all there is, wherever the robot stands.
            let potential = plant.potential_energy(&state, &level);
            assert_close(
                &format!("case {i}: V"),
                potential,
                number(expected, "potential_J"),
                TOL,
            );
        }
    }
}

#[test]
fn golden_accelerations() {
    for (_, file) in golden_files("cases") {
        let plant = Plant::new(params(&file));
        let level = Surroundings::level(plant.params());
        for (i, case) in file["cases"].as_array().expect("cases").iter().enumerate() {
            let torque = Torque {
                pitch: number(&case["input"], "tau_p_N_m"),
                roll: number(&case["input"], "tau_r_N_m"),
            };
            let u = plant.accelerations(&state(case), torque, &level);
            let expected: [f64; 4] = row(&case["full3d"]["acc_alpha_v_beta_qr_rad_m_per_s2"]);
            for (j, actual) in [u.alpha, u.v, u.beta, u.q_r].into_iter().enumerate() {
                assert_close(&format!("case {i}: u'[{j}]"), actual, expected[j], TOL);
            }
        }
    }
}

#[test]
fn golden_frictionless_trajectory() {
    const KEY: &str = "energy_traj_L2_state_alpha_x_beta_qr_and_rates";
    for (_, file) in golden_files(KEY) {
        let plant = Plant::new(RobotParams {
            zeta: 0.0,
            c_rr: 0.0,
            ..params(&file)
        });
        let level = Surroundings::level(plant.params());
        let samples = file[KEY].as_array().expect("samples");
        let [alpha, _, beta, q_r, alpha_rate, v, beta_rate, q_r_rate] = row(&samples[0]["s"]);
        let robot = RobotState {
            alpha,
            beta,
            q_r,
            alpha_rate,
            v,
            beta_rate,
            q_r_rate,
            ..RobotState::default()
        };
        let (mut state, mut steps) = (PlantState { robot, phi_s: 0.0 }, 0);
        for sample in samples {
            let t = number(sample, "t_s");
            while f64::from(steps) * 1e-3 < t - 0.5e-3 {
                state = plant.step(&state, Torque::default(), &level, 1e-3);
                steps += 1;
            }
            let energy = plant.kinetic_energy(&state) + plant.potential_energy(&state, &level);
            assert_close(
                &format!("E at {t} s"),
                energy,
                number(sample, "energy_J"),
                TOL,
            );
            let s = &state.robot;
            let [alpha, _, beta, q_r, alpha_rate, v, beta_rate, q_r_rate] = row(&sample["s"]);
            for (what, actual, expected) in [
                ("alpha", s.alpha, alpha),
                ("beta", s.beta, beta),
                ("q_r", s.q_r, q_r),
                ("alpha_rate", s.alpha_rate, alpha_rate),
                ("v", s.v, v),
                ("beta_rate", s.beta_rate, beta_rate),
                ("q_r_rate", s.q_r_rate, q_r_rate),
            ] {
                assert_close(&format!("{what} at {t} s"), actual, expected, TOL);
            }
        }
        assert!(
            steps >= 1000,
            "only {steps} steps: the trajectory is too short to show a drift"
        );
    }
}

fn row_of_rows(value: &Value) -> [[f64; 4]; 4] {
    let rows = value.as_array().expect("rows");
    assert_eq!(rows.len(), 4);
    core::array::from_fn(|i| row(&rows[i]))
}
