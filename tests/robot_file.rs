//! Robot files: what cannot be a robot is refused with line, key, value and remedy.

use sphere_agent::gains::{HsmcGains, HtsmcGains};
use sphere_agent::model::NominalModel;
use sphere_protocol::robot::{Robot, RobotId, RobotParams};

fn liu() -> Robot {
    Robot::embedded("liu").expect("liu is embedded")
}

/// The embedded file with `from` replaced by `to`.
fn edited(from: &str, to: &str) -> Result<Robot, String> {
    let text = liu().text;
    assert!(text.contains(from), "liu.toml has no `{from}`");
    Robot::parse("test.toml", &text.replacen(from, to, 1)).map_err(|error| error.to_string())
}

fn refusal(from: &str, to: &str) -> String {
    match edited(from, to) {
        Ok(_) => panic!("`{to}` was accepted"),
        Err(message) => message,
    }
}

#[test]
fn every_embedded_robot_is_valid_and_its_gains_are_stable() {
    for name in Robot::embedded_names() {
        let robot = Robot::embedded(name).expect("a listed robot exists");
        let model = NominalModel::new(&robot.params);
        let htsmc = HtsmcGains::read(&robot).expect("gains are there");
        let hsmc = HsmcGains::read(&robot).expect("gains are there");
        htsmc.checked(&model).expect("HTSMC meets its conditions");
        hsmc.checked(&model).expect("HSMC meets its conditions");
    }
    assert!(Robot::embedded("nobody").is_none());
}

// MODEL of the paper's robot: the limit of tan|q_r| v² is half of what the pendulum can hold.
#[test]
fn derived_figures_of_the_papers_robot() {
    let Robot { params, limits, .. } = liu();
    assert!((params.total_mass() - 30.0).abs() < 1e-12);
    assert!((params.i_mr() - 0.571_866_666_666_666_7).abs() < 1e-12);
    assert!((params.i_mp() - 0.541_866_666_666_666_7).abs() < 1e-12);
    assert!(
        (limits.turn_limit(&params) - 0.484).abs() < 5e-4,
        "{}",
        limits.turn_limit(&params)
    );
}

#[test]
fn units_are_converted_once_at_the_edge() {
    let robot = edited(
        r#"r = { value = 0.35, unit = "m""#,
        r#"r = { value = 350.0, unit = "mm""#,
    )
    .expect("mm is a unit of r");
    assert!((robot.params.r - 0.35).abs() < 1e-12);
    assert!(
        (robot.params.motor_delay - 0.020).abs() < 1e-12,
        "written in ms"
    );
    assert!(
        (robot.limits.q_r_max - 20_f64.to_radians()).abs() < 1e-12,
        "written in degrees"
    );
}

#[test]
fn a_wrong_unit_is_refused_with_the_right_ones() {
    let message = refusal(
        r#"m = { value = 16.0, unit = "kg""#,
        r#"m = { value = 16.0, unit = "lb""#,
    );
    assert!(
        message.contains("test.toml") && message.contains("line 6"),
        "{message}"
    );
    assert!(
        message.contains("`lb`") && message.contains("`kg` or `g`"),
        "{message}"
    );
}

#[test]
fn an_unknown_key_is_refused_with_the_nearest_known_one() {
    let message = refusal("torque_max =", "torqe_max =");
    assert!(
        message.contains("torqe_max") && message.contains("did you mean `torque_max`?"),
        "{message}"
    );
}

#[test]
fn a_missing_value_is_refused_with_what_to_write() {
    let line = r#"zeta = { value = 0.4, unit = "N*m*s/rad", source = "estimate: geared joint" }"#;
    let message = refusal(line, "");
    assert!(
        message.contains("no `zeta`") && message.contains("unit = \"N*m*s/rad\""),
        "{message}"
    );
}

#[test]
fn a_value_without_source_or_unit_is_refused() {
    assert!(
        refusal("source = \"estimate: geared joint\"", "source = \" \"").contains("empty source")
    );
    assert!(refusal(", source = \"estimate: geared joint\"", "").contains("source"));
    assert!(refusal("unit = \"N*m*s/rad\", ", "").contains("unit"));
}

#[test]
fn wrong_types_and_broken_toml_are_refused_with_their_line() {
    assert!(refusal("value = 16.0", "value = \"16\"").contains("line 6"));
    assert!(refusal("[params]", "[params").contains("test.toml"));
    assert!(refusal("[limits]", "[limit]").contains("limit"));
}

#[test]
fn impossible_values_are_refused() {
    assert!(refusal("value = 16.0", "value = -16.0").contains("greater than 0"));
    assert!(refusal("value = 16.0", "value = nan").contains("finite"));
    assert!(refusal("value = 16.0", "value = inf").contains("finite"));
    let message = refusal("l = { value = 0.17", "l = { value = 0.36");
    assert!(message.contains("inside the sphere"), "{message}");
    assert!(refusal("v_min = { value = -0.5", "v_min = { value = 1.5").contains("v_min"));
    assert!(refusal("q_r_max = { value = 20.0", "q_r_max = { value = 40.0").contains("q_r_max"));
}

// E2: with A/B = 9.5 the loop diverges; the bound for this robot is 9.41.
#[test]
fn gains_that_diverge_are_refused_with_the_numbers() {
    let robot =
        edited("a = { value = 4.9", "a = { value = 9.5").expect("the file itself is well formed");
    let model = NominalModel::new(&robot.params);
    let refused = HtsmcGains::read(&robot)
        .expect("gains are there")
        .checked(&model)
        .expect_err("A/B = 9.5 is unstable");
    let message = refused.to_string();
    assert!(
        message.contains("9.5") && message.contains("9.408"),
        "{message}"
    );
}

#[test]
fn scaling_names_a_parameter_or_the_nearest() {
    let mut params: RobotParams = liu().params;
    params.scale("m", 1.15).expect("m is a parameter");
    assert!((params.m - 18.4).abs() < 1e-12);
    let error = params.scale("mass", 1.15).expect_err("no such parameter");
    assert!(error.contains("mass"), "{error}");
    params.scale("l", -1.0).expect("checked together, not here");
    assert!(params.validated().is_err());
}

// What Zenoh takes for wild or forbidden cannot be a robot's name.
#[test]
fn robot_ids_refuse_what_a_key_cannot_carry() {
    for wild in [
        "", "r$1", "r*", "r#", "r?", "a/b", "r 1", "rö", "r1\n", "$*", "**",
    ] {
        assert!(wild.parse::<RobotId>().is_err(), "{wild:?}");
    }
    assert!("r".repeat(33).parse::<RobotId>().is_err());
    for plain in ["r1", "R-2_b.c", "0"] {
        assert_eq!(
            plain.parse::<RobotId>().expect("a plain name").as_str(),
            plain
        );
    }
}
