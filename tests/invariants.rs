//! Every invariant fires on the defect that it is there for, in a whole world of deployed cores, and on no sound run. ARCHITECTURE,
//! "Invariants"; `sim/src/check.rs` lists the rules.

use std::collections::BTreeSet;

use sphere_protocol::key::Key;
use sphere_protocol::mavlink::{
    AGENT, BOARD, Event, FrameReader, FrameWriter, Framing, TorqueCommand,
};
use sphere_protocol::message::{Command, CommandOrder, Mode, SetpointPlan};
use sphere_protocol::robot::RobotId;
use sphere_protocol::time::Span;
use sphere_protocol::wire::{self, Buffer, Wire};
use sphere_sim::check;
use sphere_sim::scenario::{Push, Scenario};
use sphere_sim::world::{Inject, MotorWay, Tamper, World};

const TWO: &str = r#"
duration_s = 30.0
[network]
delay_ms = 60.0
jitter_ms = 10.0
[[robots]]
id = "r1"
mission = { kind = "sine" }
[[robots]]
id = "r2"
start = { y_m = -6.0 }
mission = { kind = "lemniscate" }
"#;

fn scenario(sets: &[&str]) -> Scenario {
    let sets: Vec<String> = sets.iter().map(|set| (*set).to_owned()).collect();
    Scenario::parse("two.toml", TWO, &sets, |path| Err(format!("no {path}")))
        .expect("a valid scenario")
}

fn world(sets: &[&str]) -> World {
    World::new(&scenario(sets)).expect("the gains are stable")
}

fn at(s: f64) -> Span {
    Span::from_secs_f64(s)
}

fn r1() -> RobotId {
    "r1".parse().expect("a robot id")
}

/// Runs `world` to 30 s. What r1 broke; r2 must be sound.
fn broken(mut world: World) -> BTreeSet<String> {
    world.run_until(at(30.0));
    let violations = world.violations("again");
    println!("{violations:?}");
    violations
        .into_iter()
        .map(|violation| {
            assert_eq!(violation.robot.as_deref(), Some("r1"), "{violation:?}");
            assert_eq!(violation.replay, "again");
            violation.rule
        })
        .collect()
}

fn set(rules: &[&str]) -> BTreeSet<String> {
    rules.iter().map(|rule| (*rule).to_owned()).collect()
}

/// Alters the torques of r1's agent from `from` to `to` [s], as a defective one would send them.
fn altered(from: f64, to: f64, mut alter: impl FnMut(&mut TorqueCommand) + 'static) -> Tamper {
    let mut reader = FrameReader::new(Framing::Datagrams, BOARD, Some(AGENT.system));
    let mut writer = FrameWriter::new(AGENT);
    Box::new(move |t, robot, way, bytes| {
        if robot != 0 || way != MotorWay::ToBoard || t < at(from) || t > at(to) {
            return;
        }
        let mut rest = bytes.as_slice();
        let mut command = None;
        while let Some(received) = reader.pull(&mut rest) {
            if let Event::Torque(torque) = received.event {
                command = Some(torque);
            }
        }
        if let Some(mut command) = command {
            alter(&mut command);
            *bytes = writer.torque(&command).expect("it can be sent").to_vec();
        }
    })
}

fn bytes_of<M: Wire>(message: &M) -> Vec<u8> {
    let mut buffer = Buffer::new();
    wire::encode(message, &mut buffer).expect("a valid message");
    buffer.to_vec()
}

/// Gives r1's agent a plan in the station's name at `t` [s].
fn forge(world: &mut World, t: f64, alter: impl FnOnce(&mut SetpointPlan)) {
    let session = world.station().session(&r1()).expect("it is known");
    let mut plan = session.last_plan().expect("it has a plan").clone();
    alter(&mut plan);
    let key = Key::of::<SetpointPlan>(&r1()).text();
    world.inject(at(t), Inject::Agent(0), &key, &bytes_of(&plan));
}

#[test]
fn a_sound_run_breaks_nothing() {
    assert_eq!(broken(world(&[])), set(&[]));
    let cut = "network.partition=[{from_s=12,to_s=17,robots=['r1']}]";
    assert_eq!(broken(world(&[cut])), set(&[]));
}

#[test]
fn torques_beyond_the_limit_are_seen_where_they_arrive() {
    let mut world = world(&[]);
    world.tamper_with_motor_links(altered(15.0, 15.1, |command| command.torque.roll = 20.5));
    assert_eq!(broken(world), set(&["torque-limit", "torque-has-a-source"]));
}

#[test]
fn torques_that_outlast_60_ms_are_seen() {
    let mut world = world(&[]);
    world
        .replace_agent(at(0.0), 0, |config| {
            config.timing.torque_validity = Span::from_millis(200);
        })
        .expect("the gains are stable");
    assert_eq!(broken(world), set(&["torque-validity"]));
}

#[test]
fn torque_before_arming_is_seen() {
    let mut world = world(&[]);
    world.tamper_with_motor_links(altered(0.1, 0.2, |command| command.torque.pitch = 0.1));
    let rules = broken(world);
    assert!(rules.contains("no-torque-unless-armed"), "{rules:?}");
}

#[test]
fn torque_that_no_control_step_computed_is_seen() {
    let mut world = world(&[]);
    world.tamper_with_motor_links(altered(15.0, 15.1, |command| command.torque.roll += 0.01));
    assert_eq!(broken(world), set(&["torque-has-a-source"]));
}

/// An agent whose limits are wrong, and a plan that makes use of them.
#[test]
fn commands_beyond_the_limits_are_seen() {
    let mut world = world(&[]);
    world
        .replace_agent(at(0.0), 0, |config| config.robot.limits.v_max = 3.0)
        .expect("the gains are stable");
    world.run_until(at(15.0));
    forge(&mut world, 15.0, |plan| {
        plan.id.seq += 1000;
        plan.k.clear();
        plan.u.iter_mut().for_each(|u| *u = [1.6, 0.0]);
    });
    let rules = broken(world);
    for rule in ["command-limit", "speed-limit", "plan-from-station"] {
        assert!(rules.contains(rule), "{rule}: {rules:?}");
    }
}

#[test]
fn a_plan_that_the_station_did_not_make_is_seen() {
    let mut world = world(&[]);
    world.run_until(at(15.0));
    forge(&mut world, 15.0, |plan| {
        plan.id.seq += 2;
        plan.u[3][0] += 1e-3;
    });
    assert_eq!(broken(world), set(&["plan-from-station"]));
}

/// The robot is cut off, and what reaches it is a plan that was made to last longer on its way.
#[test]
fn a_plan_that_is_played_past_its_end_is_seen() {
    let mut world = world(&["network.partition=[{from_s=15,to_s=29,robots=['r1']}]"]);
    world.run_until(at(15.5));
    forge(&mut world, 15.5, |plan| {
        plan.period = Span::from_millis(500);
        plan.valid_for = Span::from_millis(4500);
    });
    assert_eq!(broken(world), set(&["plan-is-valid", "plan-from-station"]));
}

/// The same, by more than any plan may last.
#[test]
fn a_plan_older_than_any_may_be_is_seen() {
    let mut world = world(&["network.partition=[{from_s=15,to_s=29,robots=['r1']}]"]);
    world.run_until(at(15.5));
    forge(&mut world, 15.5, |plan| {
        plan.id.seq += 1000;
        plan.period = Span::from_millis(1000);
        plan.valid_for = Span::from_millis(10_000);
    });
    let rules = broken(world);
    assert!(rules.contains("plan-is-valid"), "{rules:?}");
}

/// An agent that has forgotten its life but not its boot id: lease and plans count from one again.
#[test]
fn plans_that_go_back_are_seen() {
    let mut world = world(&[]);
    world.run_until(at(12.0));
    world
        .replace_agent(at(12.0), 0, |_| {})
        .expect("the gains are stable");
    let rules = broken(world);
    assert!(rules.contains("plans-never-go-back"), "{rules:?}");
}

#[test]
fn plans_of_another_life_are_seen() {
    let mut world = world(&[]);
    world.run_until(at(12.0));
    world
        .replace_agent(at(12.0), 0, |config| config.boot_id += 1)
        .expect("the gains are stable");
    let rules = broken(world);
    assert!(rules.contains("plan-of-this-life"), "{rules:?}");
}

/// An agent that brakes at 0.05 instead of 0.5 m/s².
#[test]
fn braking_by_another_ramp_and_holding_that_does_not_rest_are_seen() {
    let mut world = world(&["network.partition=[{from_s=15,to_s=29,robots=['r1']}]"]);
    world
        .replace_agent(at(0.0), 0, |config| config.robot.limits.brake = 0.05)
        .expect("the gains are stable");
    assert_eq!(broken(world), set(&["braking-reference", "holding-rests"]));
}

/// Somebody orders the robot to hold, and nobody to go on.
#[test]
fn tracking_that_does_not_resume_is_seen() {
    let mut world = world(&[]);
    world.run_until(at(15.0));
    let session = world.station().session(&r1()).expect("it is known");
    let hold = Command {
        robot: r1(),
        boot_id: session.telemetry().expect("it spoke").boot_id,
        number: 1,
        station: 99,
        order: CommandOrder::Hold,
    };
    let key = Key::of::<Command>(&r1()).text();
    world.inject(at(15.0), Inject::Agent(0), &key, &bytes_of(&hold));
    assert_eq!(broken(world), set(&["tracking-resumes"]));
}

#[test]
fn a_robot_that_falls_and_one_that_is_thrown_are_seen() {
    for (push, rule) in [
        ("roll_nm=300.0", "upright"),
        ("pitch_nm=120.0", "speed-limit"),
    ] {
        let push = format!("robots.0.disturbance.pushes=[{{at_s=15.0,for_s=1.0,{push}}}]");
        let rules = broken(world(&[&push]));
        assert!(rules.contains(rule), "{rule}: {rules:?}");
    }
}

/// Frames of a motor board that do not arrive, though no fault of the scenario says so; and a robot that is pushed over.
#[test]
fn a_fault_without_a_cause_is_seen() {
    let mut silent = world(&[]);
    silent.tamper_with_motor_links(Box::new(|t, robot, way, bytes| {
        if robot == 0 && way == MotorWay::ToAgent && t > at(15.0) && t < at(15.3) {
            bytes.clear();
        }
    }));
    assert_eq!(broken(silent), set(&["fault-has-a-cause"]));
    let push = "robots.0.disturbance.pushes=[{at_s=15.0,for_s=1.0,roll_nm=300.0}]";
    let rules = broken(world(&[push]));
    assert!(rules.contains("fault-has-a-cause"), "{rules:?}");
}

/// Frames that wait for an agent that stands still are too old when it wakes: that is a cause.
#[test]
fn a_fault_after_a_freeze_has_a_cause() {
    let freeze = "faults=[{kind='freeze',at_s=15.0,for_s=3.0,robots=['r1']}]";
    let mut world = world(&[freeze]);
    world.run_until(at(30.0));
    assert_eq!(world.agent(0).mode(), Mode::Fault);
    assert_eq!(world.violations("again"), []);
}

#[test]
fn a_state_that_is_no_number_is_seen() {
    let mut scenario = scenario(&[]);
    scenario.robots[0].disturbance.pushes.push(Push {
        at_s: 15.0,
        for_s: 0.1,
        roll_nm: f64::NAN,
        pitch_nm: 0.0,
    });
    let rules = broken(World::new(&scenario).expect("the gains are stable"));
    assert!(rules.contains("finite"), "{rules:?}");
}

/// Two runs that must differ in r1 alone, and a second one in which r2's motors hear something else for a while.
#[test]
fn a_fault_that_reaches_another_robot_is_seen() {
    let run = |sets: &[&str], is_leaky: bool| {
        let mut world = world(sets);
        if is_leaky {
            world.tamper_with_motor_links(Box::new(|t, robot, way, bytes| {
                if robot == 1 && way == MotorWay::ToBoard && t > at(20.0) && t < at(20.2) {
                    bytes.clear();
                }
            }));
        }
        world.run_until(at(25.0));
        world
    };
    let fault = ["network.partition=[{from_s=20,to_s=24,robots=['r1']}]"];
    let free = run(&[], false);
    let sound = run(&fault, false);
    let leaky = run(&fault, true);
    assert_eq!(check::strayed(sound.trace(), free.trace(), r1()), []);
    let strayed = check::strayed(leaky.trace(), free.trace(), r1());
    assert_eq!(strayed.len(), 1, "{strayed:?}");
    assert_eq!(strayed[0].rule, "faults-stay-confined");
    assert_eq!(strayed[0].robot.as_str(), "r2");
    assert!((20.0..20.3).contains(&strayed[0].at.as_secs_f64()));
}

/// What a person needs to look into it: which rule, when, whose, and the command that shows it again.
#[test]
fn a_violation_names_rule_time_robot_and_command() {
    let mut world = world(&[]);
    world.tamper_with_motor_links(altered(15.0, 15.1, |command| command.torque.roll += 0.01));
    world.run_until(at(16.0));
    let [violation] = &world.violations("sphere-sim run x.toml --seed 3")[..] else {
        panic!("one rule of one robot breaks")
    };
    assert_eq!(violation.rule, "torque-has-a-source");
    assert!((15.0..15.03).contains(&violation.t_s));
    assert_eq!(violation.robot.as_deref(), Some("r1"));
    assert_eq!(violation.replay, "sphere-sim run x.toml --seed 3");
}
