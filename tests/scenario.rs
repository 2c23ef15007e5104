//! Scenario files: DESIGN's format, its defaults, its refusals with place and remedy, and that a drawn scenario replays.

use proptest::prelude::*;
use sphere_ground::settings::{Compensation, PlannerMode};
use sphere_ground::trajectory::Mission;
use sphere_sim::scenario::{Environment, Loss, Scenario, ScenarioError};

const MINIMAL: &str = "[[robots]]\nid = \"r1\"\n";

fn no_files(path: &str) -> Result<String, String> {
    Err(format!("there is no file {path}"))
}

fn parse(text: &str, sets: &[&str]) -> Result<Scenario, ScenarioError> {
    let sets: Vec<_> = sets.iter().map(|set| (*set).to_owned()).collect();
    Scenario::parse("demo.toml", text, &sets, no_files)
}

fn read(text: &str, sets: &[&str]) -> Scenario {
    parse(text, sets).unwrap_or_else(|error| panic!("{error}"))
}

fn refusal(text: &str, sets: &[&str]) -> String {
    match parse(text, sets) {
        Ok(scenario) => panic!("accepted: {scenario:?}"),
        Err(error) => error.to_string(),
    }
}

fn robot(lines: &str) -> String {
    format!("{MINIMAL}{lines}\n")
}

#[test]
fn robots_alone_make_a_scenario_with_every_default() {
    let scenario = read(MINIMAL, &[]);
    assert_eq!((scenario.seed, scenario.duration_s), (1, 60.0));
    assert_eq!(scenario.environment, Environment::Real);
    assert_eq!(scenario.network.up.delay_ms, 0.0);
    assert_eq!(scenario.network.up, scenario.network.down);
    assert_eq!(
        (scenario.planner.horizon, scenario.metrics.settle_s),
        (20, 10.0)
    );
    let r1 = &scenario.robots[0];
    assert_eq!((r1.id.as_str(), r1.model.reference.as_str()), ("r1", "liu"));
    assert_eq!(r1.mission, Mission::Hold);
    assert_eq!(r1.plant, r1.model.robot.params);
}

#[test]
fn the_shipped_scenarios_are_the_papers_three_trajectories() {
    for (text, mission, duration_s) in [
        (
            include_str!("../sim/scenarios/line.toml"),
            Mission::Line,
            40.0,
        ),
        (
            include_str!("../sim/scenarios/sine.toml"),
            Mission::Sine,
            60.0,
        ),
        (
            include_str!("../sim/scenarios/lemniscate.toml"),
            Mission::Lemniscate,
            110.0,
        ),
    ] {
        let scenario = read(text, &[]);
        assert_eq!(
            (&scenario.robots[0].mission, scenario.duration_s),
            (&mission, duration_s)
        );
        assert_eq!(scenario.sensing.noise, 1.0);
        assert_eq!(scenario.metrics.settle_s, 10.0);
    }
}

#[test]
fn the_environment_sets_defaults_and_keys_override_them() {
    let of = |environment: &str, more: &str| {
        read(
            &format!("environment = \"{environment}\"\n{more}\n{MINIMAL}"),
            &[],
        )
    };
    for (environment, noise, imbalance, coulomb, delay, lag) in [
        ("ideal", 0.0, 0.0, 0.0, 0.0, 0.0),
        ("real", 1.0, 0.2, 0.2, 0.02, 0.005),
        ("calibrated", 1.0, 2.3, 0.5, 0.02, 0.005),
    ] {
        let scenario = of(environment, "");
        let r1 = &scenario.robots[0];
        assert_eq!(scenario.sensing.noise, noise, "{environment}");
        assert_eq!(r1.disturbance.imbalance_nm, imbalance, "{environment}");
        assert_eq!(
            (r1.plant.coulomb, r1.plant.motor_delay, r1.plant.motor_lag),
            (coulomb, delay, lag),
            "{environment}"
        );
    }
    let ideal = of("ideal", "");
    assert_eq!(ideal.sensing.position_fix_sigma(), 0.0);
    let noisy = of("ideal", "[sensing]\nnoise = 0.5");
    assert_eq!(noisy.sensing.position_fix_sigma(), 0.01);
    let heavy = read(
        &robot("disturbance = { imbalance_nm = 1.0 }"),
        &["environment=ideal"],
    );
    assert_eq!(heavy.robots[0].disturbance.imbalance_nm, 1.0);
}

#[test]
fn a_direction_overrides_only_the_keys_it_names() {
    let scenario = read(
        &format!("[network]\ndelay_ms = 100\nloss = 0.1\n[network.up]\nloss = 0.3\n{MINIMAL}"),
        &[],
    );
    let (up, down) = (scenario.network.up, scenario.network.down);
    assert_eq!((up.delay_ms, up.loss), (100.0, Loss::Independent(0.3)));
    assert_eq!((down.delay_ms, down.loss), (100.0, Loss::Independent(0.1)));
}

#[test]
fn the_plant_differs_from_the_model_by_its_factors() {
    let scenario = read(&robot("plant = { scale = { m = 1.15, l = 0.9 } }"), &[]);
    let r1 = &scenario.robots[0];
    assert_eq!(r1.plant.m, r1.model.robot.params.m * 1.15);
    assert_eq!(r1.plant.l, r1.model.robot.params.l * 0.9);
    assert_eq!(r1.plant.m_s, r1.model.robot.params.m_s);
}

#[test]
fn the_papers_preset_brings_its_own_mode_and_horizon() {
    let scenario = read(MINIMAL, &["planner.preset=paper"]);
    assert_eq!(
        (scenario.planner.mode, scenario.planner.horizon),
        (PlannerMode::Paper, 10)
    );
    assert_eq!(scenario.planner.compensation, Compensation::Naive);
    let scenario = read(
        MINIMAL,
        &[
            "planner.preset=paper",
            "planner.mode=lag",
            "planner.horizon=40",
        ],
    );
    assert_eq!(
        (scenario.planner.mode, scenario.planner.horizon),
        (PlannerMode::Lag, 40)
    );
}

#[test]
fn set_overrides_any_key_by_its_path() {
    let text = "[network]\ndelay_ms = 100.0\n[[robots]]\nid = \"r1\"\n[[robots]]\nid = \"r2\"\n";
    let scenario = read(
        text,
        &[
            "network.delay_ms=200",
            "network.down.loss = 0.5",
            "robots.1.clock_offset_s=9",
            "planner.compensation=no-gains",
            "robots.0.mission={ kind = \"circle\", radius_m = 3, speed_mps = 0.5 }",
        ],
    );
    assert_eq!(scenario.network.up.delay().as_secs_f64(), 0.2);
    assert_eq!(scenario.network.down.loss, Loss::Independent(0.5));
    assert_eq!(scenario.network.up.loss, Loss::Independent(0.0));
    assert_eq!(scenario.robots[1].clock_offset_s, 9.0);
    assert_eq!(scenario.planner.compensation, Compensation::NoGains);
    let circle = Mission::Circle {
        radius_m: 3.0,
        speed_mps: 0.5,
    };
    assert_eq!(scenario.robots[0].mission, circle);
}

#[test]
fn every_refusal_names_file_line_key_value_and_remedy() {
    for (text, expected) in [
        (
            "[network]\ndelay = 100.0".to_owned(),
            "demo.toml:2: network.delay is an unknown key: did you mean `delay_ms`?",
        ),
        (
            "sed = 3".to_owned(),
            "demo.toml:1: sed is an unknown key: did you mean `seed`?",
        ),
        (
            "[network]\n\ndelay_ms = \"100\"".to_owned(),
            "demo.toml:3: network.delay_ms = \"100\": it must be a number: leave out the quotes",
        ),
        (
            "[network]\ndelay_ms = \"100 ms\"".to_owned(),
            "demo.toml:2: network.delay_ms = \"100 ms\": it must be a number: the unit is in the key's name, write the number alone",
        ),
        (
            "[network]\ndelay_ms = -3".to_owned(),
            "demo.toml:2: network.delay_ms = -3: it must be 0 or more and finite",
        ),
        (
            "[network.up]\nloss = 1.5".to_owned(),
            "demo.toml:2: network.up.loss = 1.5: it must be from 0 to 1",
        ),
        (
            "[network]\nloss = nan".to_owned(),
            "demo.toml:2: network.loss = nan: it must be from 0 to 1",
        ),
        (
            "duration_s = inf".to_owned(),
            "demo.toml:1: duration_s = inf: it must be greater than 0 and finite",
        ),
        (
            "duration_s = 0".to_owned(),
            "demo.toml:1: duration_s = 0: it must be greater than 0 and finite",
        ),
        (
            robot("telemetry_ms = 50"),
            "demo.toml:3: robots.0.telemetry_ms = 50: it must be a multiple of the control period of 20 ms",
        ),
        (
            "[sensing]\nnoise = -1.0".to_owned(),
            "demo.toml:2: sensing.noise = -1.0: it must be from 0 to 1000",
        ),
        (
            "seed = -1".to_owned(),
            "demo.toml:1: seed = -1: it must be 0 or more",
        ),
        (
            "seed = 1.5".to_owned(),
            "demo.toml:1: seed = 1.5: it must be a whole number",
        ),
        (
            "environment = \"reel\"".to_owned(),
            "demo.toml:1: environment = \"reel\": there is no such environment: did you mean `real`?",
        ),
        (
            "network = 3".to_owned(),
            "demo.toml:1: network = 3: it must be a table",
        ),
        (
            "[planner]\nhorizon = 200".to_owned(),
            "demo.toml:2: planner.horizon = 200: it must be from 1 to 64",
        ),
        (
            "[planner]\nsolver = \"clarabell\"".to_owned(),
            "demo.toml:2: planner.solver = \"clarabell\": there is no such solver: did you mean `clarabel`?",
        ),
        (
            "[network]\nloss = 0.1\nburst = { mean_bad_s = 1.0, mean_good_s = 20.0 }".to_owned(),
            "demo.toml:3: network.burst = { mean_bad_s = 1.0, ... }: loss is either independent or in bursts: give `loss` or `burst`, not both",
        ),
    ] {
        assert_eq!(refusal(&format!("{text}\n{MINIMAL}"), &[]), expected);
    }
}

#[test]
fn every_refusal_of_a_robot_names_it_by_its_index() {
    for (lines, expected) in [
        (
            "start = { x_m = 1.0, heading = 3.0 }",
            "demo.toml:3: robots.0.start.heading is an unknown key: did you mean `heading_deg`?",
        ),
        (
            "robot = \"lui\"",
            "demo.toml:3: robots.0.robot = \"lui\": there is no such robot: did you mean `liu`?",
        ),
        (
            "robot = \"mine.toml\"",
            "demo.toml:3: robots.0.robot = \"mine.toml\": there is no file mine.toml",
        ),
        (
            "mission = { kind = \"lemniskate\" }",
            "demo.toml:3: robots.0.mission.kind = \"lemniskate\": there is no such mission: did you mean `lemniscate`?",
        ),
        (
            "mission = { kind = \"line\", speed_mps = 0.5 }",
            "demo.toml:3: robots.0.mission.speed_mps = 0.5: a mission of kind \"line\" takes nothing else",
        ),
        (
            "mission = { kind = \"circle\", radius_m = 3.0 }",
            "demo.toml:3: robots.0.mission.speed_mps is missing: add `speed_mps = 0.5`",
        ),
        (
            "mission = { kind = \"circle\", radius_m = 3.0, speed_mps = 7.0 }",
            "demo.toml:3: robots.0.mission.speed_mps = 7.0: it must be greater than 0 and at most 1",
        ),
        (
            "mission = { kind = \"waypoints\", points_m = [[1.0, 2.0], [3.0]], speed_mps = 0.5 }",
            "demo.toml:3: robots.0.mission.points_m.1 = [3.0]: a point is [x, y] in metres",
        ),
        (
            "mission = { kind = \"circle\", radius_m = 0.4, speed_mps = 1.0 }",
            "demo.toml:3: robots.0.mission = { kind = \"circle\", ... }: radius_m = 0.4 is tighter than this robot can turn at this speed: use 0.96 m or more, or go slower",
        ),
        (
            "mission = \"sine\"",
            "demo.toml:3: robots.0.mission = \"sine\": it must be a table: write { kind = \"sine\" }",
        ),
        (
            "plant = { scale = { mm = 1.1 } }",
            "demo.toml:3: robots.0.plant.scale.mm = 1.1: no robot parameter `mm`: did you mean `m`?",
        ),
        (
            "plant = { scale = { l = 3.0 } }",
            "demo.toml:3: robots.0.plant.scale.l = 3.0: l = 0.51 m: the pendulum must hang inside the sphere, r = 0.35 m",
        ),
        (
            "disturbance = { patches = [ { min_m = [3, 0], max_m = [1, 2], c_rr = 0.03 } ] }",
            "demo.toml:3: robots.0.disturbance.patches.0 = { c_rr = 0.03, ... }: no robot is ever on it: max_m must be greater than min_m in x and in y",
        ),
        (
            "disturbance = { pushes = [ { at_s = 20.0, roll_nm = 5.0, for_s = -0.2 } ] }",
            "demo.toml:3: robots.0.disturbance.pushes.0.for_s = -0.2: it must be greater than 0 and finite",
        ),
        (
            "roll_controller = \"htsmcc\"",
            "demo.toml:3: robots.0.roll_controller = \"htsmcc\": there is no such roll controller: did you mean `htsmc`?",
        ),
    ] {
        assert_eq!(refusal(&robot(lines), &[]), expected);
    }
}

#[test]
fn robots_must_be_there_and_differ() {
    assert_eq!(
        refusal("seed = 1", &[]),
        "demo.toml:1: robots is missing: add `[[robots]] id = \"r1\"`"
    );
    assert_eq!(
        refusal("[[robots]]\nrobot = \"liu\"", &[]),
        "demo.toml:1: robots.0.id is missing: add `id = \"r1\"`"
    );
    assert_eq!(
        refusal("[[robots]]\nid = \"r1\"\n\n[[robots]]\nid = \"r1\"", &[]),
        "demo.toml:5: robots.1.id = \"r1\": robots.0 has this id already: every robot needs its own"
    );
    let wild = refusal("[[robots]]\nid = \"r*\"", &[]);
    assert!(
        wild.starts_with("demo.toml:2: robots.0.id = \"r*\": robot id `r*` contains `*`"),
        "{wild}"
    );
}

#[test]
fn text_that_is_no_toml_is_refused_with_its_line() {
    let message = refusal("seed = 1\nduration_s = = 3\n", &[]);
    assert!(
        message.starts_with("demo.toml:2: this is not TOML"),
        "{message}"
    );
    assert_eq!(message.lines().count(), 1);
    let huge = refusal(&format!("seed = 99999999999999999999\n{MINIMAL}"), &[]);
    assert!(huge.starts_with("demo.toml:1:"), "{huge}");
}

#[test]
fn a_set_that_leads_nowhere_names_its_argument() {
    for (set, expected) in [
        (
            "network.delayms=3",
            "demo.toml with --set network.delayms=3: network.delayms is an unknown key: did you mean `delay_ms`?",
        ),
        (
            "netwrok.delay_ms=3",
            "demo.toml with --set netwrok.delay_ms=3: netwrok is an unknown key: did you mean `network`?",
        ),
        (
            "network.delay_ms=fast",
            "demo.toml with --set network.delay_ms=fast: network.delay_ms = \"fast\": it must be a number: the unit is in the key's name, write the number alone",
        ),
        (
            "robots.1.clock_offset_s=9",
            "demo.toml with --set robots.1.clock_offset_s=9: `robots` has one entry: say `robots.0`",
        ),
        ("seed", "demo.toml with --set seed: write it as key=value"),
        (
            "seed=",
            "demo.toml with --set seed=: give a value after the `=`",
        ),
        (
            "seed.x=3",
            "demo.toml with --set seed.x=3: `seed` is 1 and has no keys",
        ),
        (
            "network..x=3",
            "demo.toml with --set network..x=3: `network..x` has an empty part",
        ),
    ] {
        assert_eq!(refusal(&format!("seed = 1\n{MINIMAL}"), &[set]), expected);
    }
    let broken = refusal(MINIMAL, &["network.partition=[1, 2"]);
    assert!(
        broken.starts_with("demo.toml with --set network.partition=[1, 2: this is not TOML"),
        "{broken}"
    );
}

#[test]
fn a_drawn_scenario_reads_back_equal() {
    let text = r#"
        seed = 9007199254740993
        duration_s = 33.3
        environment = "calibrated"
        [network]
        delay_ms = 0.1
        jitter_ms = 1e-7
        [network.up]
        loss = 0.30000000000000004
        [sensing]
        position_fix_hz = 0
        [planner]
        preset = "paper"
        solver = "clarabel"
        [[robots]]
        id = "a.b-c_1"
        plant = { scale = { m = 1.15, coulomb = 0.1 } }
        start = { x_m = -1.1, heading_deg = 77.7 }
        clock_offset_s = -7.3
        disturbance = { pushes = [ { at_s = 20.0, roll_nm = -5.0, for_s = 0.2 } ] }
        mission = { kind = "waypoints", points_m = [[1.0, 2], [3.5, -1e3]], speed_mps = 0.7 }
        [[robots]]
        id = "r2"
        mission = { kind = "circle", radius_m = 2.5, speed_mps = 0.5 }
    "#;
    let scenario = read(text, &["network.down.delay_ms=250"]);
    let drawn = scenario.drawn();
    assert_eq!(read(&drawn, &[]), scenario, "{drawn}");
    assert_eq!(read(&drawn, &[]).drawn(), drawn);
}

#[test]
fn a_key_that_both_directions_share_can_be_set_in_a_drawn_scenario() {
    let scenario = read(&format!("[network.up]\nloss = 0.3\n{MINIMAL}"), &[]);
    let later = read(&scenario.drawn(), &["network.delay_ms=50"]);
    assert_eq!(
        (later.network.up.delay_ms, later.network.down.delay_ms),
        (50.0, 50.0)
    );
    assert_eq!(later.network.up.loss, Loss::Independent(0.3));
}

#[test]
fn a_drawn_scenario_brings_its_robot_files_along() {
    let liu = include_str!("../protocol/robots/liu.toml");
    let light = liu.replace("m = { value = 16.0", "m = { value = 12.0");
    let load = |path: &str| match path {
        "../shop/liu.toml" => Ok(liu.to_owned()),
        "light/liu.toml" => Ok(light.clone()),
        _ => Err(format!("there is no file {path}")),
    };
    let text = "[[robots]]\nid = \"r1\"\nrobot = \"../shop/liu.toml\"\n[[robots]]\nid = \"r2\"\nrobot = \"light/liu.toml\"\n[[robots]]\nid = \"r3\"\nrobot = \"../shop/liu.toml\"";
    let scenario = Scenario::parse("demo.toml", text, &[], load).expect("both files are valid");
    assert_eq!(scenario.robots[1].plant.m, 12.0);

    let files = scenario.robot_files();
    assert_eq!(
        files.keys().copied().collect::<Vec<_>>(),
        ["robot-liu-2.toml", "robot-liu.toml"]
    );
    let beside = |path: &str| {
        files
            .get(path)
            .map(|text| (*text).to_owned())
            .ok_or(format!("no {path}"))
    };
    let again =
        Scenario::parse("out/scenario.toml", &scenario.drawn(), &[], beside).expect("drawn");
    assert_eq!(again, scenario);

    let bad = |_: &str| Ok(liu.replace("16.0", "-16.0"));
    let error = Scenario::parse("demo.toml", text, &[], bad).expect_err("negative mass");
    assert!(
        error
            .to_string()
            .starts_with("demo.toml:3: robots.0.robot = \"../shop/liu.toml\": "),
        "{error}"
    );
    assert!(
        error.to_string().contains("m = -16 kg is impossible"),
        "{error}"
    );
}

proptest! {
    #[test]
    fn any_valid_scenario_survives_being_drawn(
        seed in 0..i64::MAX,
        duration_s in 1e-3..1e5f64,
        delay_ms in 0.0..1e4f64,
        up_loss in 0.0..=1.0f64,
        heading_deg in -360.0..360.0f64,
        offset in -1e6..1e6f64,
        scale in 0.5..1.5f64,
        environment in prop::sample::select(vec!["ideal", "real", "calibrated"]),
        mission in prop::sample::select(vec![
            "{kind='lemniscate'}",
            "{kind='roll',speed_mps=0.5,angles_deg=[0.0,10.0],hold_s=2.5}",
            "{kind='roll-sine',speed_mps=1.0,amplitude_deg=5.0,rate_radps=0.15,phase_rad=-0.015}",
        ]),
        slope in -5.0..5.0f64,
        harmonic in 0.5..3.0f64,
    ) {
        let text = format!("environment = \"{environment}\"\n{MINIMAL}");
        let scenario = read(&text, &[
            &format!("seed={seed}"),
            &format!("duration_s={duration_s:?}"),
            &format!("network.delay_ms={delay_ms:?}"),
            &format!("network.up.loss={up_loss:?}"),
            &format!("robots.0.start.heading_deg={heading_deg:?}"),
            &format!("robots.0.clock_offset_s={offset:?}"),
            &format!("robots.0.plant.scale.m={scale:?}"),
            &format!("robots.0.mission={mission}"),
            &format!("robots.0.disturbance.slope_deg=[{slope:?}, 0.5]"),
            &format!("robots.0.disturbance.imbalance_harmonic={harmonic:?}"),
            "robots.0.disturbance.patches=[{min_m=[1.0,-2.0],max_m=[3.0,2.0],c_rr=0.03}]",
            "network.down.distribution='log-normal'",
            "faults=[{kind='station-freeze',at_s=1.0,for_s=2.0}]",
        ]);
        prop_assert_eq!(read(&scenario.drawn(), &[]), scenario);
    }

    #[test]
    fn garbage_never_panics(text in "\\PC{0,80}", set in "[a-z0-9.=\\[\\]{}\"-]{0,30}") {
        let _ = parse(&text, &[]);
        let _ = parse(MINIMAL, &[&set]);
        let _ = parse(&format!("{MINIMAL}mission = {text}"), &[]);
    }
}
