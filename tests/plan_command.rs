//! `sphere-ground plan` as people script it: what it prints, its exit codes, its messages.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use serde_json::{Value, json};

#[test]
fn golden_file_in_json_out() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/golden/mpc.json");
    let golden: Value =
        serde_json::from_slice(&fs::read(&path).expect("golden file")).expect("JSON");
    let output = plan(&[path.to_str().expect("UTF-8"), "--json"]);
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
    let printed: Value = serde_json::from_slice(&output.stdout).expect("stdout is JSON alone");
    let (printed, golden) = (&printed["instances"], &golden["instances"]);
    assert_eq!(
        printed.as_array().map(Vec::len),
        golden.as_array().map(Vec::len)
    );
    for (i, golden) in golden.as_array().expect("array").iter().enumerate() {
        let printed = &printed[i];
        assert_eq!(printed["id"], golden["id"]);
        assert_eq!(printed["status"], "solved");
        assert!(printed["solver"] == "riccati" || printed["solver"] == "clarabel");
        assert!(
            printed["solve_time_us"]
                .as_f64()
                .is_some_and(|time| time > 0.0)
        );
        assert!(
            printed["iterations"]
                .as_u64()
                .is_some_and(|count| count > 0)
        );
        assert!(
            printed["kkt_residual_inf"]
                .as_f64()
                .is_some_and(|residual| residual < 1e-6)
        );
        for key in ["u_opt_mps_rad", "x_opt_m_m_rad_mps_rad"] {
            let (actual, expected) = (&printed[key], &golden["expected"][key]);
            assert_eq!(
                actual.as_array().map(Vec::len),
                expected.as_array().map(Vec::len),
                "{key}"
            );
            let (a, e) = (actual[1][0].as_f64(), expected[1][0].as_f64());
            assert!(
                (a.expect("number") - e.expect("number")).abs() < 1e-5,
                "{key}"
            );
        }
    }
}

#[test]
fn bare_instance_and_bare_array_are_taken_and_the_table_is_readable() {
    let scratch = Scratch::new("bare");
    let one = scratch.write("one.json", &instance().to_string());
    let output = plan(&[&one]);
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
    let table = String::from_utf8(output.stdout).expect("UTF-8");
    let lines: Vec<_> = table.lines().collect();
    assert_eq!(lines.len(), 2, "{table}");
    assert!(
        lines[0].starts_with("id") && lines[1].contains("solved") && lines[1].contains("riccati")
    );

    let two = scratch.write("two.json", &json!([instance(), instance()]).to_string());
    let output = plan(&[&two, "--json", "--solver", "clarabel"]);
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
    let printed: Value = serde_json::from_slice(&output.stdout).expect("JSON");
    assert_eq!(printed["instances"][1]["solver"], "clarabel");
}

#[test]
fn problem_that_is_not_solved_exits_with_1() {
    let scratch = Scratch::new("unsolved");
    let mut problem = instance();
    problem["u_prev_mps_rad"] = json!([9.0, 0.0]);
    problem["du_max_per_step_mps_rad"] = json!([0.1, 0.1]);
    let path = scratch.write("far.json", &problem.to_string());
    let output = plan(&[&path, "--json"]);
    assert_eq!(output.status.code(), Some(1), "{}", stderr(&output));
    let printed: Value = serde_json::from_slice(&output.stdout).expect("JSON");
    assert_eq!(printed["instances"][0]["status"], "infeasible");
    assert_eq!(printed["instances"][0]["cost_unitless"], Value::Null);
}

#[test]
fn wrong_input_exits_with_2_and_says_what_and_where() {
    let scratch = Scratch::new("wrong");
    let with = |key: &str, value: Value| {
        let mut problem = instance();
        problem[key] = value;
        json!({ "instances": [problem] }).to_string()
    };
    let without = |key: &str| {
        let mut problem = instance();
        problem.as_object_mut().expect("object").remove(key);
        problem.to_string()
    };
    let cases: Vec<(String, &[&str])> = vec![
        (
            "{\n  \"instances\": [\n    oops".to_owned(),
            &["line 3", "column"],
        ),
        (
            instance().to_string().replace("0.1,", "NaN,"),
            &["line 1", "column"],
        ),
        (
            instance().to_string().replace("[1.0,1.0]", "[1e999,1.0]"),
            &["line 1", "out of range"],
        ),
        ("[]".to_owned(), &["no problem"]),
        ("3".to_owned(), &["must hold a problem"]),
        (
            with("uref_mps_ra", json!([])),
            &[":1", "instance 7", "`uref_mps_ra`", "`uref_mps_rad`"],
        ),
        (
            json!({ "instances": [instance()], "nota": "" }).to_string(),
            &["`nota`", "`note`"],
        ),
        (
            with("kind", json!("center")),
            &["instance 7", "`center`", "`centre`"],
        ),
        (without("dt_s"), &["instance 7", "`dt_s` is missing"]),
        (
            with("x0_m_m_rad_mps_rad", json!([1, 2])),
            &["`x0_m_m_rad_mps_rad` must be 3 numbers, not 2"],
        ),
        (
            with("uref_mps_rad", json!([[0.5, 0.0]])),
            &["`uref_mps_rad` must be 5 rows of 2 numbers, not 1 rows"],
        ),
        (
            with("p_terminal_matrix", json!([[2, 0, 0], [0, 2], [0, 0, 1]])),
            &["`p_terminal_matrix` must be 3 rows of 3 numbers: row 1"],
        ),
        (
            with("r_diag_per_mps2_rad2", json!([1, -1])),
            &["`r_diag_per_mps2_rad2`", "-1", "negative"],
        ),
        (
            with("u_min_mps_rad", json!([2, -0.3])),
            &["`u_min_mps_rad`[0] = 2", "`u_max_mps_rad`[0] = 1.5"],
        ),
        (
            with("dt_s", json!(0)),
            &["`dt_s` = 0 must be greater than 0"],
        ),
        (
            with("horizon_n", json!(0)),
            &["`horizon_n`", "from 1 to 1000"],
        ),
        (with("lag_tau_s", json!(0.4)), &["`lag_tau_s` must be null"]),
        (with("n_x", json!(5)), &["`n_x` must be 3 for kind `std`"]),
        (
            with("soft_halfplane", json!({ "normal_unitles": [1, 0] })),
            &["`normal_unitles`", "`normal_unitless`"],
        ),
        (with("dt_s", json!(null)), &["`dt_s` is missing"]),
        (
            with("q_diag_per_m2_m2_rad2_mps2_rad2", json!([2, "2", 1])),
            &["3 numbers", "\"2\""],
        ),
    ];
    for (text, expected) in cases {
        let path = scratch.write("problem.json", &text);
        let output = plan(&[&path, "--json"]);
        let message = stderr(&output);
        assert_eq!(output.status.code(), Some(2), "{text}: {message}");
        assert!(output.stdout.is_empty(), "{text}");
        assert_eq!(
            message.trim_end().lines().count(),
            1,
            "one message: {message}"
        );
        assert!(message.contains("problem.json"), "{message}");
        for part in expected {
            assert!(message.contains(part), "`{part}` is not in: {message}");
        }
    }
}

#[test]
fn missing_file_and_wrong_usage_exit_with_2() {
    let output = plan(&["no/such/file.json"]);
    assert_eq!(output.status.code(), Some(2));
    assert!(
        stderr(&output).contains("cannot read no/such/file.json"),
        "{}",
        stderr(&output)
    );
    for arguments in [
        &["--json"][..],
        &["a.json", "--solver", "simplex"],
        &["a.json", "--quick"],
    ] {
        let output = plan(arguments);
        assert_eq!(output.status.code(), Some(2), "{arguments:?}");
        assert!(output.stdout.is_empty());
    }
}

/// A small problem in the file's format.
fn instance() -> Value {
    let x_ref: Vec<_> = (1..=5)
        .map(|i| json!([0.05 * f64::from(i), 0.0, 0.0]))
        .collect();
    json!({
        "id": 7,
        "kind": "std",
        "trajectory": "line",
        "t0_s": 0.0,
        "n_x": 3,
        "horizon_n": 5,
        "dt_s": 0.1,
        "sphere_radius_m": 0.35,
        "lag_tau_s": null,
        "x0_m_m_rad_mps_rad": [0.0, 0.1, 0.2],
        "u_prev_mps_rad": [0.5, 0.0],
        "xref_1_to_n_m_m_rad_mps_rad": x_ref,
        "uref_mps_rad": [[0.5, 0.0], [0.5, 0.0], [0.5, 0.0], [0.5, 0.0], [0.5, 0.0]],
        "q_diag_per_m2_m2_rad2_mps2_rad2": [2.0, 2.0, 1.0],
        "p_terminal_matrix": [[2.0, 0.0, 0.0], [0.0, 2.0, 0.0], [0.0, 0.0, 1.0]],
        "r_diag_per_mps2_rad2": [1.0, 1.0],
        "r_rate_diag_per_mps2_rad2": [0.0, 0.0],
        "u_min_mps_rad": [-0.5, -0.3],
        "u_max_mps_rad": [1.5, 0.3],
        "du_max_per_step_mps_rad": null,
        "soft_halfplane": null,
    })
}

fn plan(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_sphere-ground"))
        .arg("plan")
        .args(arguments)
        .output()
        .expect("the program runs")
}

fn stderr(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

/// A folder of its own, gone after the test.
struct Scratch(PathBuf);

impl Scratch {
    fn new(name: &str) -> Self {
        let path = std::env::temp_dir().join(format!("sphere-plan-{name}-{}", std::process::id()));
        fs::create_dir_all(&path).expect("a temporary folder");
        Self(path)
    }

    fn write(&self, name: &str, text: &str) -> String {
        let path = self.0.join(name);
        fs::write(&path, text).expect("written");
        path.to_str().expect("UTF-8").to_owned()
    }
}

impl Drop for Scratch {
    fn drop(&mut self) {
        let _ = fs::remove_dir_all(&self.0);
    }
}
