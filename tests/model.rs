//! Where the models meet: each member has its own, and they say the same where they must.

use std::f64::consts::PI;

use nalgebra::{SVector, Vector2};
use proptest::prelude::*;
use sphere_agent::model::NominalModel;
use sphere_agent::plan::{Playback, ReferenceState, advance_reference};
use sphere_agent::reference::{Reference, roll_bound};
use sphere_ground::kinematics::{Discretisation, pose_rate};
use sphere_ground::link::Link;
use sphere_ground::predictor::Predictor;
use sphere_protocol::message::{Mode, PlanId, PlanSource, SetpointPlan, Telemetry};
use sphere_protocol::robot::{Robot, RobotParams};
use sphere_protocol::state::{RobotState, Torque};
use sphere_protocol::time::{AgentClock, GroundClock, Instant, Span};
use sphere_sim::disturbance::Surroundings;
use sphere_sim::plant::{Plant, PlantState};

fn liu() -> Robot {
    Robot::embedded("liu").expect("it comes with the project")
}

/// What the nominal model leaves out on purpose is left out here: dry friction of the joints, and rolling resistance, which the
/// plant has in roll as well and which is steep at small speeds.
fn without_dry_friction() -> RobotParams {
    RobotParams {
        coulomb: 0.0,
        c_rr: 0.0,
        ..liu().params
    }
}

#[test]
fn nominal_model_and_plant_agree_to_second_order_in_small_angles() {
    // MODEL: the controllers' planar models are the plant's linearisation; what they neglect is of second order.
    let params = without_dry_friction();
    let (plant, model) = (Plant::new(params), NominalModel::new(&params));
    let around = Surroundings::level(&params);
    let difference = |scale: f64, sign: [f64; 8]| {
        let robot = RobotState {
            v: 0.4 * scale * sign[0],
            q_r: 0.3 * scale * sign[1],
            q_r_rate: 0.5 * scale * sign[2],
            beta: 0.4 * scale * sign[3],
            beta_rate: 0.6 * scale * sign[4],
            alpha: 0.4 * scale * sign[5],
            alpha_rate: 0.7 * scale * sign[6],
            heading: 1.0,
            ..RobotState::default()
        };
        let torque = Torque {
            pitch: 2.0 * scale * sign[7],
            roll: -1.5 * scale * sign[7],
        };
        let truth = plant.accelerations(&PlantState { robot, phi_s: 0.3 }, torque, &around);
        let nominal = model.accelerations(&robot, &torque);
        let truth = [truth.alpha, truth.v, truth.beta, truth.q_r];
        let size = truth.iter().fold(0.0_f64, |size, a| size.max(a.abs()));
        let error = (0..4).fold(0.0_f64, |error, i| error.max((truth[i] - nominal[i]).abs()));
        (error, size)
    };
    for signs in 0..256_u32 {
        let sign = core::array::from_fn(|i| if signs & (1 << i) == 0 { 1.0 } else { -1.0 });
        let ((coarse, _), (fine, size)) = (difference(0.1, sign), difference(0.01, sign));
        assert!(size > 0.01, "something moves: {size}");
        // Ten times smaller angles: a hundred times smaller difference, with room for the third order.
        assert!(
            fine <= coarse / 70.0 || fine < 1e-9,
            "signs {signs:08b}: {coarse:e} at a tenth, {fine:e} at a hundredth"
        );
        assert!(fine <= 2e-3 * size, "{fine} of {size}");
    }
}

prop_compose! {
    fn reference_states()(
        x in -50.0..50.0, y in -50.0..50.0, heading in -7.0..7.0, v in -1.5..1.5, q_r in -0.35..0.35,
    ) -> ReferenceState {
        ReferenceState::from([x, y, heading, v, q_r])
    }
}

proptest! {
    #[test]
    fn planner_and_agent_advance_the_reference_alike(
        x in reference_states(), v_c in -0.5..1.0, q_c in -0.35..0.35, h in 1e-4..0.2, tau in 0.05..2.0,
    ) {
        // DESIGN: states between knots are "interpolated by the planner's own discretisation": two implementations, one model.
        let r = liu().params.r;
        let planner = Discretisation::centre(h, r, tau).step(&x, &Vector2::new(v_c, q_c));
        let agent = advance_reference(&x, [v_c, q_c], h, tau, r);
        for i in 0..5 {
            let off = (planner[i] - agent[i]).abs();
            prop_assert!(off <= 1e-12 * x[i].abs().max(1.0), "state {i}: {planner:?} and {agent:?}");
        }
    }

    #[test]
    fn agent_reference_follows_commands_as_the_planner_expects(
        v in -0.5..1.0, q_r in -0.35..0.35, v_c in -0.5..1.0, q_c in -0.35..0.35,
    ) {
        // MPC: first-order lag on board; the slew alone may hold the speed back. The roll begins each command softly: behind the planner's by
        // T/(τ − T) (e^(−t/τ) − e^(−t/T)) of the change at most, 0.11 at its largest, and by nothing in the end.
        let robot = liu();
        let mut reference = Reference::starting_at(v, q_r);
        let tau = robot.limits.reference_lag;
        reference.follow(v_c, q_c, 0.02, &robot.limits);
        let x = SVector::from([0.0, 0.0, 0.0, v, q_r]);
        let next = Discretisation::centre(0.02, robot.params.r, tau).step(&x, &Vector2::new(v_c, q_c));
        let slew = robot.limits.slew * 0.02;
        let v_next = next[3].clamp(v - slew, v + slew);
        prop_assert!((reference.v() - v_next).abs() <= 1e-12);
        let behind = (next[4] - reference.q_r()) / (q_c - q_r);
        prop_assert!((q_c - q_r).abs() < 1e-9 || (0.0..0.12).contains(&behind), "{behind}");
        for _ in 0..500 {
            reference.follow(v_c, q_c, 0.02, &robot.limits);
        }
        prop_assert!((reference.q_r() - q_c).abs() <= 1e-9);
    }
}

#[test]
fn pose_of_the_plant_moves_as_eq_1_says() {
    // Eq (1), held by the planner and by the plant on their own: integrated alongside, the poses agree.
    let params = without_dry_friction();
    let plant = Plant::new(params);
    let around = Surroundings::level(&params);
    let mut state = PlantState {
        robot: RobotState {
            v: 0.5,
            beta: -0.2,
            heading: 0.4,
            ..RobotState::default()
        },
        phi_s: 0.0,
    };
    let mut pose = [0.0, 0.0, 0.4];
    let dt = 1e-3;
    for step in 0..5000 {
        let t = dt * f64::from(step);
        let torque = Torque {
            pitch: 1.5 * (2.0 * t).sin(),
            roll: 2.0 * (1.3 * t).cos(),
        };
        let before = state.robot;
        state = plant.step(&state, torque, &around, dt);
        let after = state.robot;
        let rate = |s: &RobotState| pose_rate(s.heading, s.v, s.q_r, s.q_r_rate, params.r);
        // Simpson's rule; the middle from Hermite's cubic would be better, the mean is enough at 1 ms.
        let (a, b) = (rate(&before), rate(&after));
        for i in 0..3 {
            pose[i] += 0.5 * dt * (a[i] + b[i]);
        }
    }
    let truth = [state.robot.x, state.robot.y, state.robot.heading];
    assert!(
        truth[0].hypot(truth[1]) > 1.0,
        "it went somewhere: {truth:?}"
    );
    for i in 0..3 {
        // The trapezoid's error: dt²/12 · T · |third derivative|, ~ 1e-7/12 · 5 · 10.
        assert!((pose[i] - truth[i]).abs() < 1e-5, "{pose:?} and {truth:?}");
    }
}

/// A plan that turns, speeds up and has gains.
fn plan(seq: u32, start_ms: i64, from: [f64; 5]) -> SetpointPlan {
    let robot = liu();
    let mut x = ReferenceState::from(from);
    let mut plan = SetpointPlan {
        robot: "r1".parse().expect("valid"),
        boot_id: 1,
        id: PlanId { epoch: 1, seq },
        based_on: Instant::from_nanos(0),
        start: Instant::from_nanos(start_ms * 1_000_000),
        period: Span::from_millis(100),
        valid_for: Span::from_millis(5000),
        source: PlanSource::Riccati,
        u: Default::default(),
        x: Default::default(),
        k: Default::default(),
    };
    plan.x.push(from.map(|value| value as f32));
    for i in 0..20 {
        let phase = 0.3 * f64::from(i) + f64::from(seq);
        let u = [0.5 + 0.2 * phase.sin(), 0.15 * (0.7 * phase).cos()];
        x = advance_reference(&x, u, 0.1, robot.limits.reference_lag, robot.params.r);
        plan.u.push(u.map(|value| value as f32));
        plan.x.push(core::array::from_fn(|i| x[i] as f32));
        plan.k
            .push([-0.8, 0.1, 0.0, -0.2, 0.0, 0.0, -0.3, -0.4, 0.0, -0.1]);
    }
    plan
}

#[test]
fn station_predicts_a_plan_as_the_agent_plays_it() {
    // DESIGN 3: the station predicts "through the plan that telemetry names as playing": as the agent plays it, step by step.
    let robot = liu();
    let (params, limits) = (robot.params, robot.limits);
    let ms = |ms: i64| Instant::<AgentClock>::from_nanos(ms * 1_000_000);
    for heading in [0.0, PI, -40.0] {
        let begin = [0.3, -0.2, heading, 0.35, 0.05];
        let first = plan(1, 0, [0.33, -0.17, heading + 0.02, 0.4, 0.04]);
        let second = plan(2, 300, [0.5, -0.1, heading + 0.1, 0.5, 0.02]);
        let telemetry = Telemetry {
            robot: first.robot,
            boot_id: 1,
            stamp: ms(20),
            mode: Mode::Tracking,
            state: RobotState {
                x: begin[0],
                y: begin[1],
                heading,
                v: 0.37,
                q_r: 0.03,
                ..RobotState::default()
            },
            v_d: begin[3],
            q_rd: begin[4],
            position_sigma: 0.01,
            playing: Some(first.id),
            newest: Some(second.id),
            received: 1,
            loop_delay: Some(Span::from_millis(20)),
            epoch: 1,
            command: 2,
            torque: [0.0; 2],
        };
        let mut predictor = Predictor::new(&robot);
        predictor.on_sent(
            first.clone(),
            Instant::<GroundClock>::from_nanos(0),
            Some(ms(10)),
        );
        predictor.on_sent(
            second.clone(),
            Instant::<GroundClock>::from_nanos(10),
            Some(ms(15)),
        );
        predictor.on_telemetry(&telemetry, &mut Link::default());

        // The agent: the same plans, its own playback and reference, the pose by the model of its reference.
        let mut playback = Playback::new();
        for plan in [first, second] {
            playback
                .receive(plan, ms(20), &limits)
                .expect("a plan for now");
        }
        let mut x = ReferenceState::from(begin);
        let mut reference = Reference::starting_at(x[3], x[4]);
        for step in 0..60 {
            let now = ms(20 + 20 * step);
            let predicted = predictor.predict(&telemetry, now);
            let off = (predicted - x).amax();
            // Plans travel as f32, the same for both: nothing but rounding is left.
            assert!(off < 1e-9, "{off:e} after {step} periods");
            playback.advance(now);
            let command = playback
                .command(now, &x, &params, &limits)
                .expect("a plan in force");
            let bound = roll_bound(x[3], &params, &limits);
            let q_c = command.q_r.clamp(-bound, bound);
            let before = reference.v();
            reference.follow(command.v, q_c, 0.02, &limits);
            // The command that the slew left over.
            let share = -(-0.02 / limits.reference_lag).exp_m1();
            let v_c = before + (reference.v() - before) / share;
            x = advance_reference(&x, [v_c, q_c], 0.02, limits.reference_lag, params.r);
        }
    }
}
