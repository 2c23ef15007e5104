//! What the simulated robot promises: mechanics that conserve, balance and mirror; motors that stop; sensors that tell the truth.

use nalgebra::{Matrix3, Matrix4, Rotation3, SMatrix, Vector3};
use proptest::prelude::*;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use sphere_protocol::mavlink::{AGENT, BOARD, FrameWriter, TorqueCommand};
use sphere_protocol::robot::{Robot, RobotParams};
use sphere_protocol::state::{BoardStatus, RobotState, Torque};
use sphere_protocol::time::{BoardClock, Instant, Span};
use sphere_sim::actuator::{Actuator, CommandError, MotorBoard};
use sphere_sim::body::{Body, BodyRandom, BodySetup};
use sphere_sim::clock::SimClock;
use sphere_sim::disturbance::{Disturbance, Surroundings};
use sphere_sim::plant::{Accelerations, Plant, PlantState};
use sphere_sim::sensor::Sensors;

fn liu() -> RobotParams {
    Robot::embedded("liu")
        .expect("comes with the project")
        .params
}

fn frictionless(params: RobotParams) -> RobotParams {
    RobotParams {
        zeta: 0.0,
        c_rr: 0.0,
        coulomb: 0.0,
        ..params
    }
}

/// Robots that differ from the nominal one in every mechanical parameter by up to 30 %.
fn robots() -> impl Strategy<Value = RobotParams> {
    const KEYS: [&str; 14] = [
        "m", "m_f", "m_s", "r", "l", "i_s", "j_mr", "j_mp", "j_mu", "i_fr", "i_fp", "i_fu", "zeta",
        "c_rr",
    ];
    prop::array::uniform14(0.7..1.3).prop_map(|factors: [f64; 14]| {
        let mut params = liu();
        for (key, factor) in KEYS.into_iter().zip(factors) {
            params.scale(key, factor).expect("a known key");
        }
        params
            .validated()
            .expect("l stays below r: 0.17 * 1.3 < 0.35 * 0.7")
    })
}

/// States beyond what the controllers reach, but on the robot's feet.
fn states() -> impl Strategy<Value = PlantState> {
    let angles = (-0.5..0.5, -0.7..0.7, -0.45..0.45, -3.0..3.0, -6.0..6.0);
    let rates = (-2.0..2.0, -0.5..1.5, -3.0..3.0, -1.5..1.5);
    (angles, rates).prop_map(|(angles, rates)| {
        let (alpha, beta, q_r, heading, phi_s) = angles;
        let (alpha_rate, v, beta_rate, q_r_rate) = rates;
        let robot = RobotState {
            x: 1.0,
            y: -2.0,
            heading,
            v,
            q_r,
            q_r_rate,
            beta,
            beta_rate,
            alpha,
            alpha_rate,
        };
        PlantState { robot, phi_s }
    })
}

fn torques() -> impl Strategy<Value = Torque> {
    (-20.0..20.0, -20.0..20.0).prop_map(|(pitch, roll)| Torque { pitch, roll })
}

/// Floors up to 10 % steep.
fn floors() -> impl Strategy<Value = [f64; 2]> {
    [-0.1..0.1, -0.1..0.1]
}

fn sloped(params: &RobotParams, slope: [f64; 2]) -> Surroundings {
    let up = Vector3::new(slope[0], slope[1], 1.0).normalize();
    Surroundings {
        up: up.into(),
        ..Surroundings::level(params)
    }
}

fn rates(s: &RobotState) -> [f64; 4] {
    [s.alpha_rate, s.v, s.beta_rate, s.q_r_rate]
}

/// The state moved along a straight line in its own coordinates for `h` seconds; eq (1) for the pose.
fn moved(state: &PlantState, r: f64, u: &Accelerations, h: f64) -> PlantState {
    let mut next = *state;
    let (s, to) = (&state.robot, &mut next.robot);
    to.x += h * (s.v * s.heading.cos() - r * s.q_r_rate * s.heading.sin());
    to.y += h * (s.v * s.heading.sin() + r * s.q_r_rate * s.heading.cos());
    to.heading += h * s.v * s.q_r.tan() / r;
    to.alpha += h * s.alpha_rate;
    to.beta += h * s.beta_rate;
    to.q_r += h * s.q_r_rate;
    to.alpha_rate += h * u.alpha;
    to.v += h * u.v;
    to.beta_rate += h * u.beta;
    to.q_r_rate += h * u.q_r;
    next
}

/// f′(0) by the five-point formula: error h⁴ f⁽⁵⁾/30 and rounding of f over h.
fn slope_at_zero<const R: usize, const C: usize>(
    h: f64,
    f: impl Fn(f64) -> SMatrix<f64, R, C>,
) -> SMatrix<f64, R, C> {
    ((f(h) - f(-h)) * 8.0 - (f(2.0 * h) - f(-2.0 * h))) / (12.0 * h)
}

/// Attitude of the frame against the floor, columns forward, left, up.
fn frame_attitude(s: &RobotState) -> Matrix3<f64> {
    let turn = |axis, angle| Rotation3::from_axis_angle(&axis, angle).into_inner();
    turn(Vector3::z_axis(), s.heading)
        * turn(Vector3::x_axis(), -s.q_r)
        * turn(Vector3::y_axis(), -s.alpha)
}

fn pendulum_attitude(s: &RobotState) -> Matrix3<f64> {
    frame_attitude(s) * Rotation3::from_axis_angle(&Vector3::x_axis(), s.beta + s.q_r).into_inner()
}

/// ω in the axes of a body with this attitude, from Ω = Rᵀ Ṙ.
fn body_rates(attitude: Matrix3<f64>, attitude_rate: Matrix3<f64>) -> Vector3<f64> {
    let skew = attitude.transpose() * attitude_rate;
    Vector3::new(skew[(2, 1)], skew[(0, 2)], skew[(1, 0)])
}

fn centre_velocity(s: &RobotState, r: f64) -> Vector3<f64> {
    let (sin, cos) = s.heading.sin_cos();
    Vector3::new(
        s.v * cos - r * s.q_r_rate * sin,
        s.v * sin + r * s.q_r_rate * cos,
        0.0,
    )
}

/// Energy gained [J] in 2 s of frictionless motion, or until the robot tips over: towards |q_r| = 90° the coordinates themselves fail.
fn energy_drift(start: PlantState, slope: [f64; 2], dt: f64) -> f64 {
    let plant = Plant::new(frictionless(liu()));
    let floor = sloped(plant.params(), slope);
    let energy = |s: &PlantState| plant.kinetic_energy(s) + plant.potential_energy(s, &floor);
    let (mut state, mut steps) = (start, 0);
    while f64::from(steps) * dt < 2.0 && state.robot.q_r.abs() < 1.0 {
        state = plant.step(&state, Torque::default(), &floor, dt);
        steps += 1;
    }
    energy(&state) - energy(&start)
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::default() })]

    /// Without friction and torque nothing is gained or lost in 2 s at the simulator's step.
    #[test]
    fn energy_is_conserved(state in states()) {
        // The golden trajectory drifts by 2e-10 J, the worst of 3000 of these states by 1.4e-9 J.
        let drift = energy_drift(state, [0.0; 2], 1e-3);
        prop_assert!(drift.abs() < 1e-8, "drift {drift:e} J");
    }

    /// Nor on a slope, where the height of the whole robot counts.
    #[test]
    fn energy_is_conserved_on_a_slope(state in states(), slope in floors()) {
        // The robot gathers speed, so the step is halved: the worst of 3000 drifts by 1.4e-9 J, sixteen times less than at 1 ms.
        let drift = energy_drift(state, slope, 0.5e-3);
        prop_assert!(drift.abs() < 1e-8, "drift {drift:e} J");
    }

    /// dE/dt = τ_p (α̇ + v/(R cos q_r)) + τ_r (β̇ + q̇_r) − dissipation, for any robot, state, torque and floor.
    #[test]
    fn motors_and_friction_account_for_all_power(
        params in robots(), state in states(), torque in torques(), slope in floors()
    ) {
        let plant = Plant::new(params);
        let floor = sloped(&params, slope);
        let u = plant.accelerations(&state, torque, &floor);
        // The energy depends on the state alone: along a straight line through it dE/dt is that of the motion.
        let gained = slope_at_zero(1e-5, |h| {
            let s = moved(&state, params.r, &u, h);
            SMatrix::<f64, 1, 1>::new(plant.kinetic_energy(&s) + plant.potential_energy(&s, &floor))
        }).x;
        let s = &state.robot;
        let supplied = torque.pitch * (s.alpha_rate + s.v / (params.r * s.q_r.cos()))
            + torque.roll * (s.beta_rate + s.q_r_rate);
        let dissipated = plant.dissipation(&state, &floor);
        prop_assert!(dissipated >= 0.0);
        // Rounding of 50 J over 1e-5 s is 1e-9 W; the five-point formula's own error is below.
        prop_assert!((gained - supplied + dissipated).abs() < 1e-7 * supplied.abs().max(1.0),
            "gained {gained} W of {supplied} W less {dissipated} W");
    }

    /// A world seen in a mirror along X moves as the mirrored world: left and right are equal.
    #[test]
    fn left_mirrors_right(params in robots(), state in states(), torque in torques()) {
        let plant = Plant::new(params);
        let level = Surroundings::level(&params);
        let mut mirrored = state;
        let m = &mut mirrored.robot;
        for odd in [&mut m.y, &mut m.heading, &mut m.q_r, &mut m.q_r_rate, &mut m.beta, &mut m.beta_rate] {
            *odd = -*odd;
        }
        let u = plant.accelerations(&state, torque, &level);
        let w = plant.accelerations(&mirrored, Torque { roll: -torque.roll, ..torque }, &level);
        // sin and tanh are odd and cos is even to the last bit, so the mirror image is exact.
        prop_assert_eq!([u.alpha, u.v, u.beta, u.q_r], [w.alpha, w.v, -w.beta, -w.q_r]);
    }

    /// M is symmetric and positive definite, and solving with it loses nothing.
    #[test]
    fn mass_matrix_is_positive_definite(params in robots(), state in states(), torque in torques()) {
        let plant = Plant::new(params);
        let level = Surroundings::level(&params);
        let equations = plant.equations(&state, &level);
        let m = Matrix4::from_fn(|i, j| equations.mass_matrix()[i][j]);
        prop_assert_eq!(m, m.transpose());
        prop_assert!(m.cholesky().is_some(), "not positive definite: {}", m);
        let forces = [torque.pitch, torque.roll, 3.0, -2.0];
        let u = equations.solve(forces);
        let back = m * nalgebra::Vector4::new(u.alpha, u.v, u.beta, u.q_r) + nalgebra::Vector4::from(equations.h);
        // M's condition number is below 1e3 and the terms below 1e3.
        prop_assert!((back - nalgebra::Vector4::from(forces)).amax() < 1e-9, "{}", back);
    }

    /// ½ uᵀMu is the kinetic energy of three bodies whose attitudes and positions are differentiated numerically.
    #[test]
    fn kinetic_energy_is_that_of_the_moving_bodies(params in robots(), state in states()) {
        let plant = Plant::new(params);
        let (p, s) = (&params, &state.robot);
        let at = |h| moved(&state, p.r, &Accelerations::default(), h).robot;
        let rate = |attitude: fn(&RobotState) -> Matrix3<f64>| {
            body_rates(attitude(s), slope_at_zero(1e-4, |h| attitude(&at(h))))
        };
        let (frame, pendulum) = (rate(frame_attitude), rate(pendulum_attitude));
        let bob = centre_velocity(s, p.r)
            + slope_at_zero(1e-4, |h| pendulum_attitude(&at(h)) * Vector3::new(0.0, 0.0, -p.l));
        let spin = |i: [f64; 3], w: Vector3<f64>| i[0] * w.x * w.x + i[1] * w.y * w.y + i[2] * w.z * w.z;
        // Rolling: the shell turns with v/R and q̇_r about the two horizontal axes.
        let rolling = (s.v / p.r).powi(2) + s.q_r_rate.powi(2);
        let twice = (p.m_s + p.m_f) * centre_velocity(s, p.r).norm_squared()
            + p.m * bob.norm_squared()
            + p.i_s * rolling
            + spin([p.i_fr, p.i_fp, p.i_fu], frame)
            + spin([p.j_mr, p.j_mp, p.j_mu], pendulum);
        let energy = plant.kinetic_energy(&state);
        // Differences of unit vectors over 1e-4 s: 1e-12 each.
        prop_assert!((energy - 0.5 * twice).abs() < 1e-9 * energy.max(1.0), "{energy} J, bodies {} J", 0.5 * twice);
    }

    /// The IMU reads what differentiating the motion gives, in the frame's own axes.
    #[test]
    fn imu_agrees_with_the_differentiated_motion(
        params in robots(), state in states(), torque in torques(), slope in floors()
    ) {
        // Smooth friction, so that differences over 0.1 ms are accurate.
        let plant = Plant::new(RobotParams { coulomb: 0.0, c_rr: 0.0, ..params });
        let floor = sloped(plant.params(), slope);
        let at = |h| plant.step(&state, torque, &floor, h).robot;
        let attitude = frame_attitude(&state.robot);
        let gyro = body_rates(attitude, slope_at_zero(1e-4, |h| frame_attitude(&at(h))));
        let acceleration = slope_at_zero(1e-4, |h| centre_velocity(&at(h), params.r));
        let force = attitude.transpose() * (acceleration + Vector3::from(floor.up) * params.g);
        let imu = plant.imu(&state, &plant.accelerations(&state, torque, &floor), &floor);
        prop_assert!((gyro - Vector3::from(imu.gyro)).amax() < 1e-7, "{:?} instead of {}", imu, gyro);
        prop_assert!((force - Vector3::from(imu.specific_force)).amax() < 1e-6, "{:?} instead of {}", imu, force);
    }

    /// Imbalance and pushes are torques: on the rolling motion (row v, over R) and on the roll (row q_r), and nowhere else.
    #[test]
    fn imbalance_turns_with_the_shell(state in states(), imbalance in -3.0..3.0, roll in -5.0..5.0, pitch in -5.0..5.0) {
        let params = liu();
        let plant = Plant::new(params);
        let level = Surroundings::level(&params);
        let pushed = Surroundings { imbalance, roll, pitch, ..level };
        let with = plant.accelerations(&state, Torque::default(), &pushed);
        let without = plant.accelerations(&state, Torque::default(), &level);
        let m = Matrix4::from_fn(|i, j| plant.equations(&state, &level).mass_matrix()[i][j]);
        let change = m * nalgebra::Vector4::new(
            with.alpha - without.alpha, with.v - without.v, with.beta - without.beta, with.q_r - without.q_r,
        );
        let expected = nalgebra::Vector4::new(
            0.0,
            (pitch + imbalance * state.phi_s.cos()) / params.r,
            0.0,
            roll + imbalance * state.phi_s.sin(),
        );
        // Differences of accelerations up to 100, times a mass up to 34.
        prop_assert!((change - expected).amax() < 1e-10, "{} instead of {}", change, expected);
    }

    /// The motors' angles belong to the same motion as everything else.
    #[test]
    fn motor_angles_follow_their_rates(state in states(), torque in torques()) {
        let plant = Plant::new(RobotParams { coulomb: 0.0, c_rr: 0.0, ..liu() });
        let level = Surroundings::level(plant.params());
        let rate = slope_at_zero(1e-4, |h| {
            let s = plant.step(&state, torque, &level, h);
            nalgebra::Vector2::new(s.theta_r(), s.theta_p())
        });
        prop_assert!((rate.x - state.theta_r_rate()).abs() < 1e-8);
        prop_assert!((rate.y - state.theta_p_rate(liu().r)).abs() < 1e-8);
    }

    /// Whatever a command says and whenever it comes, nothing is commanded once its validity has run out.
    #[test]
    fn torque_is_zero_after_the_validity_of_a_command(
        torque in torques(), at in 0_i64..1_000_000_000, valid_ms in 1_i64..200
    ) {
        let start = Instant::<BoardClock>::from_nanos(at);
        let end = start + Span::from_millis(valid_ms);
        let mut board = MotorBoard::new();
        board.receive(start, torque, Span::from_millis(valid_ms)).expect("a good command");
        prop_assert_eq!(board.torque(end - Span::from_nanos(1)), torque);
        prop_assert_eq!(board.torque(end), Torque::default());
        prop_assert!(!board.status(end).command_valid);

        let dt = Span::from_millis(1);
        let params = liu();
        let mut motors = Actuator::new(&params, dt);
        let mut now = start;
        while now < end {
            motors.step(board.torque(now));
            now += dt;
        }
        // Transport delay, then 20 time constants of the lag: e^-20 · 20 N·m = 4e-8 N·m.
        let settle = now + Span::from_secs_f64(params.motor_delay + 20.0 * params.motor_lag);
        while now < settle {
            motors.step(board.torque(now));
            now += dt;
        }
        prop_assert!(motors.torque().pitch.abs() < 1e-7 && motors.torque().roll.abs() < 1e-7);
    }
}

#[test]
fn commands_that_cannot_be_carried_out_are_refused_and_change_nothing() {
    let now = Instant::from_nanos(0);
    let long = Span::from_millis(100);
    let good = Torque {
        pitch: 1.0,
        roll: -2.0,
    };
    let mut board = MotorBoard::new();
    board.receive(now, good, long).expect("a good command");
    for bad in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
        for torque in [
            Torque {
                pitch: bad,
                roll: 0.0,
            },
            Torque {
                pitch: 0.0,
                roll: bad,
            },
        ] {
            assert_eq!(
                board.receive(now, torque, long),
                Err(CommandError::NotFinite)
            );
        }
    }
    for validity in [Span::ZERO, -long] {
        assert_eq!(
            board.receive(now, Torque::default(), validity),
            Err(CommandError::NotValid)
        );
    }
    assert_eq!(board.torque(now), good);
    board.switch(false);
    assert_eq!(board.receive(now, good, long), Err(CommandError::PowerOff));
    assert_eq!(board.torque(now), Torque::default());
    board.switch(true);
    assert_eq!(
        board.torque(now),
        Torque::default(),
        "switching on must not bring a command back"
    );
}

#[test]
fn robot_at_rest_stays_at_rest_and_its_ideal_imu_reads_gravity() {
    let plant = Plant::new(liu());
    let level = Surroundings::level(plant.params());
    let rest = PlantState::default();
    let later = plant.step(&rest, Torque::default(), &level, 1e-3);
    assert_eq!(later, rest);

    let accelerations = plant.accelerations(&rest, Torque::default(), &level);
    let imu = plant.imu(&rest, &accelerations, &level);
    let mut sensors = Sensors::new(0.0, ChaCha8Rng::seed_from_u64(1));
    let status = BoardStatus::default();
    let measured = sensors.sample(
        Instant::from_nanos(0),
        &rest,
        plant.params().r,
        &imu,
        status,
    );
    assert_eq!(measured.accel, [0.0, 0.0, 9.81]);
    assert_eq!(measured.gyro, [0.0; 3]);
    assert_eq!(
        [
            measured.theta_r,
            measured.theta_r_rate,
            measured.theta_p,
            measured.theta_p_rate
        ],
        [0.0; 4]
    );
}

#[test]
fn robot_on_a_slope_rolls_down_and_its_imu_feels_the_slope() {
    let params = frictionless(liu());
    let plant = Plant::new(params);
    let uphill = sloped(&params, [0.05, 0.0]);
    let rest = PlantState::default();
    let still = plant
        .imu(&rest, &Accelerations::default(), &uphill)
        .specific_force;
    // sin(atan 0.05) and cos of 9.81 m/s²
    assert!(
        (still[0] - 9.81 * 0.049_937_616).abs() < 1e-7 && still[1] == 0.0,
        "{still:?}"
    );
    assert!((Vector3::from(still).norm() - 9.81).abs() < 1e-12);
    let mut s = rest;
    for _ in 0..1000 {
        s = plant.step(&s, Torque::default(), &uphill, 1e-3);
    }
    assert!(s.robot.x < -0.1 && s.robot.v < -0.2, "{s:?}");
    assert_eq!(
        [s.robot.y, s.robot.heading, s.robot.q_r, s.robot.beta],
        [0.0; 4]
    );
}

#[test]
fn friction_brings_the_robot_to_rest() {
    let plant = Plant::new(liu());
    let level = Surroundings::level(plant.params());
    let mut s = PlantState {
        robot: RobotState {
            v: 0.5,
            q_r: 0.1,
            beta: 0.2,
            ..RobotState::default()
        },
        phi_s: 0.0,
    };
    for _ in 0..60_000 {
        s = plant.step(&s, Torque::default(), &level, 1e-3);
    }
    assert!(
        rates(&s.robot).into_iter().all(|rate| rate.abs() < 0.02),
        "after a minute: {s:?}"
    );
}

/// Bits of a hundred sensor frames of a moving robot.
fn sensor_bytes(seed: u64) -> Vec<u64> {
    let plant = Plant::new(liu());
    let level = Surroundings::level(plant.params());
    let mut state = PlantState {
        robot: RobotState {
            v: 0.7,
            q_r: 0.1,
            ..RobotState::default()
        },
        phi_s: 0.0,
    };
    let mut sensors = Sensors::new(1.0, ChaCha8Rng::seed_from_u64(seed));
    let mut stamp = Instant::from_nanos(0);
    let mut bytes = Vec::new();
    for _ in 0..100 {
        let imu = plant.imu(
            &state,
            &plant.accelerations(&state, Torque::default(), &level),
            &level,
        );
        let m = sensors.sample(
            stamp,
            &state,
            plant.params().r,
            &imu,
            BoardStatus::default(),
        );
        let encoders = [m.theta_r, m.theta_r_rate, m.theta_p, m.theta_p_rate];
        bytes.extend(
            m.gyro
                .iter()
                .chain(&m.accel)
                .chain(&encoders)
                .map(|x| x.to_bits()),
        );
        for _ in 0..5 {
            state = plant.step(&state, Torque::default(), &level, 1e-3);
        }
        stamp += Sensors::INTERVAL;
    }
    bytes
}

#[test]
fn same_seed_gives_the_same_sensor_bytes() {
    assert_eq!(sensor_bytes(7), sensor_bytes(7));
    let (seven, eight) = (sensor_bytes(7), sensor_bytes(8));
    // Encoders err without chance; every value of the IMU differs.
    let same = seven
        .chunks(10)
        .zip(eight.chunks(10))
        .flat_map(|(a, b)| a[..6].iter().zip(&b[..6]))
        .filter(|(a, b)| a == b)
        .count();
    assert_eq!(same, 0);
}

/// Largest difference of any angle [rad] and of any rate [rad/s, m/s] between one body that is asked every millisecond, whose plant
/// takes steps of 1 ms, and its twin that is asked every 20 ms, whose plant takes strides of 5 ms: half a second under the same
/// commands, which jump every 20 ms by as much as 4 N·m.
fn cost_of_strides(seed: u64, stiction: f64) -> (f64, f64) {
    let disturbance = Disturbance {
        imbalance: 0.2,
        stiction,
        ..Disturbance::default()
    };
    let setup = BodySetup {
        params: liu(),
        start: [0.0; 3],
        disturbance,
        noise: 1.0,
        fix_sigma: 0.02,
        clock: SimClock::default(),
    };
    let mut often = Body::new(setup, BodyRandom::new(seed, 0));
    let mut seldom = often.clone();
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let mut writer = FrameWriter::new(AGENT);
    let (mut angles, mut rates) = (0.0_f64, 0.0_f64);
    for period in 0..25 {
        let mut draw = || 2.0 * random.random_range(-1.0..=1.0);
        let command = TorqueCommand {
            target: BOARD,
            sequence: period,
            torque: Torque {
                pitch: draw(),
                roll: draw(),
            },
            validity: Span::from_millis(60),
        };
        let frame = writer.torque(&command).expect("within range");
        often.receive(&frame);
        seldom.receive(&frame);
        let begin = 20 * i64::from(period);
        for ms in 1..=20 {
            often.advance(Span::from_millis(begin + ms));
        }
        seldom.advance(Span::from_millis(begin + 20));
        let (a, b) = (often.state().robot, seldom.state().robot);
        for (a, b) in [
            (a.q_r, b.q_r),
            (a.beta, b.beta),
            (a.alpha, b.alpha),
            (a.heading, b.heading),
        ] {
            angles = angles.max((a - b).abs());
        }
        for (a, b) in crate::rates(&a).into_iter().zip(crate::rates(&b)) {
            rates = rates.max((a - b).abs());
        }
    }
    assert!(often.state().robot.v != 0.0, "it has moved");
    (angles, rates)
}

#[test]
fn strides_of_5_ms_change_less_than_any_sensor_sees() {
    let worst = |stiction: f64| {
        let one = |seed| cost_of_strides(seed, stiction);
        (0..100).map(one).fold((0.0_f64, 0.0_f64), |worst, cost| {
            (worst.0.max(cost.0), worst.1.max(cost.1))
        })
    };
    for stiction in [0.0, 0.5, 2.0] {
        let (angles, rates) = worst(stiction);
        println!("stiction {stiction} N·m: {angles:.1e} rad, {rates:.1e} rad/s");
        // Half of the encoder's step of 9.6e-5 rad, a tenth of the gyro's white noise of 5.2e-3 rad/s.
        assert!(angles < 4.8e-5 && rates < 5.2e-4);
    }
}
