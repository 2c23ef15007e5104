//! The planner against golden vectors: problems solved by IPOPT and polished to a first-order residual of 5e-13, eqs (1), (2) and
//! the terminal weight, each computed elsewhere by other code.

#[allow(unreachable_pub, reason = "shared by several test binaries")]
mod support;

use serde_json::Value;
use sphere_ground::kinematics::{pose_rate, pose_rate_simplified};
use sphere_ground::mpc::{Solver, terminal_weight};
use sphere_ground::plan_command::{self, AnyProblem, Instance, Kind, Report};
use support::{assert_close, golden_files};

/// Both are converged, so that nothing but rounding and the conditioning of the problem lies between them.
const TOLERANCE: f64 = 1e-6;
/// Bounds on the change of the input leave some problems with nearly free directions.
const TOLERANCE_RATE: f64 = 1e-5;
/// Gauss-Newton steps on an interior-point solver: what its tolerance leaves.
const TOLERANCE_CLARABEL: f64 = 1e-4;

#[test]
fn golden_problems_are_solved_by_default() {
    for (instance, report, expected) in solve_all(Solver::Auto) {
        let tolerance = match instance.kind {
            Kind::Rate => TOLERANCE_RATE,
            _ => TOLERANCE,
        };
        check(&instance, &report, &expected, tolerance);
        let residual = match report.solver.as_str() {
            "riccati" => 1e-10,
            _ => 1e-6,
        };
        assert!(
            report.kkt_residual_inf <= residual,
            "instance {}: first-order residual {:e}",
            report.id,
            report.kkt_residual_inf
        );
    }
}

#[test]
fn golden_problems_are_solved_by_clarabel_too() {
    for (instance, report, expected) in solve_all(Solver::Clarabel) {
        assert_eq!(report.solver, "clarabel");
        check(&instance, &report, &expected, TOLERANCE_CLARABEL);
    }
}

/// E15: the planner plans with eq (1); eq (2) is what the paper plans with.
#[test]
fn golden_kinematics_of_both_equations() {
    for (path, file) in golden_files("cases") {
        let radius = number(&file["params_SI"]["R"]);
        for (i, case) in rows(&file["cases"]).iter().enumerate() {
            let state = &case["state"];
            let heading = number(&state["phi_yaw_rad"]);
            let (v, q_r) = (number(&state["v_m_per_s"]), number(&state["q_r_rad"]));
            let q_r_dot = number(&state["q_r_dot_rad_per_s"]);
            let golden = &case["kinematics"];
            for (key, actual) in [
                (
                    "eq1_Xdot_Ydot_m_per_s_phidot_rad_per_s",
                    pose_rate(heading, v, q_r, q_r_dot, radius),
                ),
                (
                    "eq2_Xdot_Ydot_m_per_s_phidot_rad_per_s",
                    pose_rate_simplified(heading, v, q_r, radius),
                ),
            ] {
                for (j, expected) in rows(&golden[key]).iter().enumerate() {
                    let what = format!("{} case {i} {key}[{j}]", path.display());
                    assert_close(&what, actual[j], number(expected), 1e-9);
                }
            }
        }
    }
}

/// Kinds `lag` and `centre` carry P from the plain Riccati recursion, 20 000 steps of it; doubling must find the same.
#[test]
fn golden_terminal_weight() {
    let mut checked = 0;
    for (_, file) in golden_files("instances") {
        for instance in plan_command::parse("golden", &file.to_string()).expect("golden file") {
            let AnyProblem::Five(problem) = &instance.problem else {
                continue;
            };
            let last = problem.horizon() - 1;
            let p = terminal_weight(
                &problem.model,
                &problem.x_ref[last],
                &problem.u_ref[last],
                &problem.q,
                &problem.r,
            );
            let size = problem.p_terminal.amax();
            let error = (p - problem.p_terminal).amax() / size;
            // The recursion stops when a step changes 1e-13 of P; what is left of its sum may be a hundred times that.
            assert!(error < 1e-10, "instance {}: off by {error:e}", instance.id);
            checked += 1;
        }
    }
    assert!(checked > 0, "no instance with five states");
}

fn solve_all(solver: Solver) -> Vec<(Instance, Report, Value)> {
    let mut solved = Vec::new();
    for (path, file) in golden_files("instances") {
        let name = path.display().to_string();
        let instances = plan_command::parse(&name, &file.to_string()).expect("golden file");
        for (instance, golden) in instances.into_iter().zip(rows(&file["instances"])) {
            let report = plan_command::solve(&instance, solver, &mut || 0.0);
            solved.push((instance, report, golden["expected"].clone()));
        }
    }
    solved
}

fn check(instance: &Instance, report: &Report, expected: &Value, tolerance: f64) {
    let what = format!("instance {} ({})", instance.id, instance.kind);
    assert_eq!(report.status, "solved", "{what}");
    let u: Vec<Vec<f64>> = report.u_opt_mps_rad.iter().map(|u| u.to_vec()).collect();
    check_rows(
        &format!("{what}: u"),
        &u,
        &expected["u_opt_mps_rad"],
        tolerance,
    );
    let x = &report.x_opt_m_m_rad_mps_rad;
    check_rows(
        &format!("{what}: x"),
        x,
        &expected["x_opt_m_m_rad_mps_rad"],
        tolerance,
    );
    let cost = number(&expected["cost_unitless"]);
    assert_close(
        &format!("{what}: cost"),
        report.cost_unitless,
        cost,
        tolerance,
    );
}

fn check_rows(what: &str, actual: &[Vec<f64>], expected: &Value, tolerance: f64) {
    let expected = rows(expected);
    assert_eq!(actual.len(), expected.len(), "{what}: rows");
    for (i, (actual, expected)) in actual.iter().zip(expected).enumerate() {
        let expected = rows(expected);
        assert_eq!(actual.len(), expected.len(), "{what}[{i}]: columns");
        for (j, (actual, expected)) in actual.iter().zip(expected).enumerate() {
            let error = (actual - number(expected)).abs();
            assert!(error <= tolerance, "{what}[{i}][{j}] is off by {error:e}");
        }
    }
}

fn rows(value: &Value) -> &Vec<Value> {
    value.as_array().expect("array")
}

fn number(value: &Value) -> f64 {
    value.as_f64().expect("number")
}
