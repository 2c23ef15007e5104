//! The planner's kernel: derivatives, robustness, symmetry, refusals.

#[path = "support/tracking.rs"]
mod tracking;

use nalgebra::{Matrix5, SMatrix, SVector, Vector2, Vector5};
use proptest::prelude::*;
use rand::{Rng, RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use sphere_ground::kinematics::{Discretisation, pose_rate, pose_rate_simplified};
use sphere_ground::mpc::{
    HalfPlane, Mpc, Options, Problem, ProblemError, Refusal, Solver, Status, kkt_residual,
    terminal_weight,
};
use tracking::{ALL, Trajectory, centre, paper};

proptest! {
    /// Jacobians of all three models against central differences, far beyond the angles that a robot reaches (|g| from 0 to 1.9).
    #[test]
    fn jacobians_agree_with_differences(
        pose in (-5.0..5.0_f64, -5.0..5.0_f64, -7.0..7.0_f64),
        (v, q) in (-3.0..3.0_f64, -1.0..1.0_f64),
        (v_c, q_c) in (-3.0..3.0_f64, -1.0..1.0_f64),
    ) {
        let u = Vector2::new(v_c, q_c);
        check_jacobian(&Discretisation::arc(0.1, 0.25), SVector::from([pose.0, pose.1, pose.2]), u)?;
        let x = Vector5::new(pose.0, pose.1, pose.2, v, q);
        check_jacobian(&Discretisation::lag(0.1, 0.25, 0.3), x, u)?;
        check_jacobian(&Discretisation::centre(0.1, 0.25, 0.4), x, u)?;
    }

    /// Second derivatives against central differences of the Jacobians.
    #[test]
    fn curvature_agrees_with_differences(
        pose in (-5.0..5.0_f64, -5.0..5.0_f64, -7.0..7.0_f64),
        (v, q) in (-3.0..3.0_f64, -1.0..1.0_f64),
        (v_c, q_c) in (-3.0..3.0_f64, -1.0..1.0_f64),
        lambda in prop::array::uniform5(-10.0..10.0_f64),
    ) {
        let u = Vector2::new(v_c, q_c);
        let x = Vector5::new(pose.0, pose.1, pose.2, v, q);
        let lambda = Vector5::from(lambda);
        check_curvature(
            &Discretisation::arc(0.1, 0.25),
            x.fixed_rows::<3>(0).into(),
            u,
            lambda.fixed_rows::<3>(0).into(),
        )?;
        check_curvature(&Discretisation::lag(0.1, 0.25, 0.3), x, u, lambda)?;
        check_curvature(&Discretisation::centre(0.1, 0.25, 0.4), x, u, lambda)?;
    }

    /// The arc is the exact solution of eq (2) with held inputs.
    #[test]
    fn arc_is_exact(heading in -4.0..4.0_f64, v in -2.0..2.0_f64, q in -0.6..0.6_f64) {
        let model = Discretisation::arc(0.1, 0.3);
        let x = SVector::from([0.3, -0.2, heading]);
        let actual = model.step(&x, &Vector2::new(v, q));
        let exact = integrate(x, |heading, _| pose_rate_simplified(heading, v, q, 0.3));
        prop_assert!((actual - exact).amax() < 1e-11, "{actual} instead of {exact}");
    }

    /// The model `centre` with a roll that changes at v = 0 moves the centre sideways by R Δq, as eq (1) does.
    #[test]
    fn centre_moves_sideways_as_eq_1(heading in -4.0..4.0_f64, q in -0.3..0.3_f64, q_c in -0.3..0.3_f64) {
        let model = Discretisation::centre(0.1, 0.3, 0.4);
        let x = Vector5::new(0.0, 0.0, heading, 0.0, q);
        let actual = model.step(&x, &Vector2::new(0.0, q_c));
        let start = SVector::from([0.0, 0.0, heading]);
        let exact = integrate(start, |heading, t: f64| {
            let q_now = q_c + (q - q_c) * (-t / 0.4).exp();
            pose_rate(heading, 0.0, q_now, (q_c - q_now) / 0.4, 0.3)
        });
        prop_assert!((actual.fixed_rows::<3>(0) - exact).amax() < 1e-9, "{actual} instead of {exact}");
    }
}

/// A robot that is put down anywhere near its trajectory gets a plan, optimal to rounding, without the fallback.
#[test]
fn random_starts_all_solve() {
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    for i in 0..450 {
        let trajectory = ALL[i % 3];
        let t = rng.random_range(0.0..100.0);
        let (pose, u) = trajectory.at(t);
        let x0 = far_from(&mut rng, pose);
        let problem = centre(trajectory, t, [x0[0], x0[1], x0[2], u[0], u[1]]);
        check_solved(&format!("start {i}, {trajectory:?}, centre"), &problem);
        let problem = paper(trajectory, t, x0, u);
        check_solved(&format!("start {i}, {trajectory:?}, paper"), &problem);
    }
}

/// The same from rest, where the roll steers nothing.
#[test]
fn random_starts_from_rest_all_solve() {
    let mut rng = ChaCha8Rng::seed_from_u64(2);
    for i in 0..150 {
        let trajectory = ALL[i % 3];
        let t = rng.random_range(0.0..100.0);
        let x0 = far_from(&mut rng, trajectory.at(t).0);
        let problem = centre(trajectory, t, [x0[0], x0[1], x0[2], 0.0, 0.0]);
        check_solved(&format!("start {i}, {trajectory:?}"), &problem);
    }
}

/// A reference that rests beside the robot is a stationary point of staying where it is; a plan must leave it.
#[test]
fn robot_beside_a_resting_reference_moves() {
    let mut problem = Problem::new(Discretisation::centre(0.1, 0.3, 0.4), 40);
    for x in &mut problem.x_ref {
        x[1] = 0.5;
    }
    problem.p_terminal *= 20.0;
    let mut mpc = Mpc::new(40, Options::default());
    let solution = mpc.solve(&problem);
    assert_eq!(solution.status, Status::Solved);
    let stay: f64 = 0.25 * (39.0 * problem.q[1] + problem.p_terminal[(1, 1)]);
    assert!(
        solution.cost < 0.99 * stay,
        "cost {} of {stay}",
        solution.cost
    );
}

/// Left and right are alike: the mirrored problem has the mirrored plan.
#[test]
fn mirrored_problem_has_the_mirrored_solution() {
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    let flip = Vector5::new(1.0, -1.0, -1.0, 1.0, -1.0);
    for i in 0..30 {
        let t = rng.random_range(0.0..50.0);
        let (pose, u) = ALL[i % 3].at(t);
        let x0 = far_from(&mut rng, pose);
        let mut problem = centre(ALL[i % 3], t, [x0[0], x0[1], x0[2], u[0], u[1]]);
        for i in 0..20 {
            let plane = HalfPlane {
                normal: [0.6, 0.8],
                offset: 0.6 * pose[0] + 0.8 * pose[1],
                weight: 500.0,
            };
            assert!(problem.add_half_plane(i, plane));
        }
        let mut mirrored = problem.clone();
        mirrored.x0.component_mul_assign(&flip);
        mirrored.u_prev[1] *= -1.0;
        for (x, u) in mirrored.x_ref.iter_mut().zip(&mut mirrored.u_ref) {
            x.component_mul_assign(&flip);
            u[1] *= -1.0;
        }
        let mirror = Matrix5::from_diagonal(&flip);
        mirrored.p_terminal = mirror * mirrored.p_terminal * mirror;
        for row in &mut mirrored.half_planes {
            row[0].normal[1] *= -1.0;
        }
        let (mut one, mut other) = (
            Mpc::new(20, Options::default()),
            Mpc::new(20, Options::default()),
        );
        let (one, other) = (one.solve(&problem), other.solve(&mirrored));
        assert_eq!((one.status, other.status), (Status::Solved, Status::Solved));
        for (u, mirrored) in one.u.iter().zip(&other.u) {
            // Rounding differs with the signs; what is left of it is far below a command's resolution.
            assert!(
                (u[0] - mirrored[0]).abs() < 1e-9 && (u[1] + mirrored[1]).abs() < 1e-9,
                "case {i}"
            );
        }
    }
}

/// A plan from the last plan is the plan from scratch: warm starts save time and change nothing.
#[test]
fn warm_start_finds_the_same_plan() {
    let mut warm = Mpc::new(20, Options::default());
    let mut x = Vector5::new(0.3, -0.2, 0.5, 0.4, 0.0);
    for tick in 0..200 {
        let problem = centre(Trajectory::Lemniscate, 0.1 * f64::from(tick), x.into());
        warm.shift(1);
        let solution = warm.solve(&problem);
        assert_eq!(solution.status, Status::Solved, "tick {tick}");
        let mut cold = Mpc::new(20, Options::default());
        let expected = cold.solve(&problem);
        let off = solution.u[0] - expected.u[0];
        assert!(off.amax() < 1e-8, "tick {tick}: {off}");
        x = problem.model.step(&x, &solution.u[0]);
    }
}

/// The feedback gain is the derivative of the optimal first input by the state.
#[test]
fn gain_is_the_derivative_of_the_plan() {
    let x0 = [0.1, 0.05, 0.8, 0.6, 0.02];
    let plan = |x0: [f64; 5]| {
        let mut problem = centre(Trajectory::Lemniscate, 0.0, [0.1, 0.05, 0.8, 0.6, 0.02]);
        problem.x0 = Vector5::from(x0);
        let mut mpc = Mpc::new(20, Options::default());
        let solution = mpc.solve(&problem);
        assert_eq!(solution.status, Status::Solved);
        (solution.u[0], solution.gains[0])
    };
    let (_, gain) = plan(x0);
    assert!(gain.amax() > 0.1, "no bound is active here: {gain}");
    for j in 0..5 {
        let (mut above, mut below) = (x0, x0);
        above[j] += 1e-4;
        below[j] -= 1e-4;
        let slope = (plan(above).0 - plan(below).0) / 2e-4;
        assert!(
            (gain.column(j) - slope).amax() < 1e-5,
            "by state {j}: {slope} against {gain}"
        );
    }
}

/// tan|q_c| v² ≤ limit holds along every plan, and binds where the way back asks for more. The plan is optimal for the bounds
/// of its own speeds, but for a few far starts (5 %) whose bounds end narrower than that: safe, and slower to turn.
#[test]
fn turn_limit_holds() {
    let (mut binding, mut optimal) = (0, 0);
    let mut rng = ChaCha8Rng::seed_from_u64(4);
    for i in 0..60 {
        let t = rng.random_range(0.0..50.0);
        let (pose, u) = ALL[i % 3].at(t);
        let x0 = far_from(&mut rng, pose);
        let mut problem = centre(ALL[i % 3], t, [x0[0], x0[1], x0[2], u[0], u[1]]);
        problem.set_bounds(Vector2::new(-0.5, -0.45), Vector2::new(1.5, 0.45));
        problem.turn_limit = Some(0.3);
        let mut mpc = Mpc::new(20, Options::default());
        let solution = mpc.solve(&problem);
        assert_eq!(solution.status, Status::Solved, "start {i}");
        optimal += usize::from(kkt_residual(&problem, &solution.x, &solution.u) <= 1e-6);
        for (u, x) in solution.u.iter().zip(&solution.x) {
            let v = u[0].abs().max(x[3].abs());
            let turn = u[1].abs().tan() * v * v;
            assert!(turn <= 0.3 + 1e-6, "start {i}: {turn}");
            binding += usize::from(turn > 0.3 - 1e-6);
        }
    }
    assert!(binding > 20, "the limit bound {binding} knots only");
    assert!(
        optimal >= 54,
        "only {optimal} of 60 plans are optimal for their own bounds"
    );
}

/// Bounds on the change of the input hold; ones that no input can meet are infeasible, not a panic.
#[test]
fn rate_bounds_hold_or_are_infeasible() {
    let mut problem = centre(Trajectory::Sine, 3.0, [1.0, 1.0, 0.3, 0.4, 0.0]);
    problem.du_max = Some(Vector2::new(0.05, 0.02));
    let mut mpc = Mpc::new(20, Options::default());
    let solution = mpc.solve(&problem);
    assert_eq!(solution.status, Status::Solved);
    let mut before = problem.u_prev;
    for u in &solution.u {
        let change = (u - before).abs();
        assert!(
            change[0] <= 0.05 + 1e-8 && change[1] <= 0.02 + 1e-8,
            "{change}"
        );
        before = *u;
    }
    assert!(kkt_residual(&problem, &solution.x, &solution.u) < 1e-6);

    problem.u_prev = Vector2::new(3.0, 0.0);
    assert_eq!(mpc.solve(&problem).status, Status::Infeasible);
    assert!(mpc.solution().u.is_empty());
}

/// Whatever is not a number is refused, field by field, and the next good problem is solved.
#[test]
fn problem_that_makes_no_sense_is_refused() {
    type Spoil = fn(&mut Problem<5>);
    let good = centre(Trajectory::Sine, 3.0, [1.0, 1.0, 0.3, 0.4, 0.0]);
    let mut mpc = Mpc::new(20, Options::default());
    let spoil: [(&str, Spoil); 15] = [
        ("x0", |p| p.x0[2] = f64::NAN),
        ("u_prev", |p| p.u_prev[0] = f64::INFINITY),
        ("x_ref", |p| p.x_ref[7][1] = f64::NAN),
        ("u_ref", |p| p.u_ref[19][1] = f64::NEG_INFINITY),
        ("q", |p| p.q[0] = f64::NAN),
        ("q", |p| p.q[0] = -1.0),
        ("r", |p| p.r[1] = -1e-9),
        ("r_rate", |p| p.r_rate[1] = f64::NAN),
        ("p_terminal", |p| p.p_terminal[(0, 0)] = f64::NAN),
        ("p_terminal", |p| p.p_terminal[(0, 0)] = -100.0),
        ("p_terminal", |p| p.p_terminal[(0, 1)] += 1.0),
        ("u_min", |p| p.u_min[3][0] = 2.0),
        ("u_max", |p| p.u_max[3][1] = 1.6),
        ("du_max", |p| p.du_max = Some(Vector2::new(f64::NAN, 1.0))),
        ("u_ref", |p| p.u_ref.truncate(5)),
    ];
    for (field, spoil) in spoil {
        let mut problem = good.clone();
        spoil(&mut problem);
        let solution = mpc.solve(&problem);
        assert_eq!(solution.status, Status::Refused, "{field}");
        assert!(solution.u.is_empty() && solution.x.is_empty(), "{field}");
        let refusal = solution.refusal.expect("a reason");
        assert!(
            matches!(refusal, Refusal::Problem(error) if error == ProblemError::Bounds { knot: 3 } || error.to_string().contains(field)),
            "{field}: {refusal}"
        );
        assert_eq!(mpc.solve(&good).status, Status::Solved, "after {field}");
    }
}

/// Finite numbers of any size end in a status.
#[test]
fn huge_numbers_end_in_a_status() {
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    for _ in 0..300 {
        let mut problem = centre(Trajectory::Line, 0.0, [0.0, 2.0, 0.0, 0.5, 0.0]);
        let mut huge = || {
            let exponent = rng.random_range(-300.0..300.0_f64);
            let sign = if rng.random::<bool>() { 1.0 } else { -1.0 };
            sign * 10.0_f64.powf(exponent)
        };
        problem.x0[0] = huge();
        problem.x0[3] = huge();
        problem.x_ref[4][1] = huge();
        problem.q[2] = huge().abs();
        problem.u_max[2][0] = huge().abs().max(0.0);
        for solver in [Solver::Riccati, Solver::Clarabel] {
            let options = Options {
                solver,
                iterations_clarabel: 3,
                ..Options::default()
            };
            let mut mpc = Mpc::new(20, options);
            let solution = mpc.solve(&problem);
            if solution.status == Status::Solved {
                assert!(
                    solution
                        .u
                        .iter()
                        .all(|u| u.iter().all(|value| value.is_finite()))
                );
            }
        }
    }
}

/// At a reference that rests the Riccati equation has no solution; P is Q there, and never anything that is not finite.
#[test]
fn terminal_weight_at_rest_is_q() {
    let model = Discretisation::centre(0.1, 0.35, 0.4);
    let (q, r) = (
        Vector5::new(2.0, 2.0, 1.0, 1e-3, 1e-3),
        Vector2::new(1.0, 1.0),
    );
    for v in [0.0, 1e-9, -0.02, f64::NAN] {
        let p = terminal_weight(
            &model,
            &Vector5::new(0.0, 0.0, 0.0, v, 0.0),
            &Vector2::new(v, 0.0),
            &q,
            &r,
        );
        assert_eq!(p, Matrix5::from_diagonal(&q), "v = {v}");
    }
    for v in [0.06, 0.5, -0.5, 1.5] {
        let p = terminal_weight(
            &model,
            &Vector5::new(0.0, 0.0, 0.7, v, 0.1),
            &Vector2::new(v, 0.1),
            &q,
            &r,
        );
        assert!(p.cholesky().is_some() && p == p.transpose(), "v = {v}: {p}");
    }
}

fn far_from(rng: &mut impl Rng, pose: [f64; 3]) -> [f64; 3] {
    [
        pose[0] + rng.random_range(-1.5..1.5),
        pose[1] + rng.random_range(-1.5..1.5),
        pose[2] + rng.random_range(-1.2..1.2),
    ]
}

fn check_solved<const NX: usize>(what: &str, problem: &Problem<NX>) {
    let options = Options {
        solver: Solver::Riccati,
        ..Options::default()
    };
    let mut mpc = Mpc::new(problem.horizon(), options);
    let solution = mpc.solve(problem);
    assert_eq!(solution.status, Status::Solved, "{what}");
    let residual = kkt_residual(problem, &solution.x, &solution.u);
    assert!(residual <= 1e-8, "{what}: {residual:e}");
}

/// RK4 over one knot of 0.1 s.
fn integrate(start: SVector<f64, 3>, rate: impl Fn(f64, f64) -> [f64; 3]) -> SVector<f64, 3> {
    let steps = 100;
    let h = 0.1 / f64::from(steps);
    let mut x = start;
    for i in 0..steps {
        let t = h * f64::from(i);
        let f = |x: SVector<f64, 3>, t: f64| SVector::from(rate(x[2], t));
        let k1 = f(x, t);
        let k2 = f(x + k1 * (h / 2.0), t + h / 2.0);
        let k3 = f(x + k2 * (h / 2.0), t + h / 2.0);
        let k4 = f(x + k3 * h, t + h);
        x += (k1 + k2 * 2.0 + k3 * 2.0 + k4) * (h / 6.0);
    }
    x
}

/// Step of the central differences; their error is about its square.
const STEP: f64 = 1e-5;

fn check_jacobian<const NX: usize>(
    model: &Discretisation<NX>,
    x: SVector<f64, NX>,
    u: Vector2<f64>,
) -> Result<(), TestCaseError> {
    let linearised = model.linearise(&x, &u);
    prop_assert!((linearised.next - model.step(&x, &u)).amax() < 1e-14);
    for j in 0..NX {
        let mut e = SVector::<f64, NX>::zeros();
        e[j] = STEP;
        let slope = (model.step(&(x + e), &u) - model.step(&(x - e), &u)) / (2.0 * STEP);
        prop_assert!((linearised.a.column(j) - slope).amax() < 1e-7, "by x[{j}]");
    }
    for j in 0..2 {
        let mut e = Vector2::zeros();
        e[j] = STEP;
        let slope = (model.step(&x, &(u + e)) - model.step(&x, &(u - e))) / (2.0 * STEP);
        prop_assert!((linearised.b.column(j) - slope).amax() < 1e-7, "by u[{j}]");
    }
    Ok(())
}

fn check_curvature<const NX: usize>(
    model: &Discretisation<NX>,
    x: SVector<f64, NX>,
    u: Vector2<f64>,
    lambda: SVector<f64, NX>,
) -> Result<(), TestCaseError> {
    let curvature = model.curvature(&x, &u, &lambda);
    let gradient = |x: SVector<f64, NX>, u: Vector2<f64>| {
        let linearised = model.linearise(&x, &u);
        (linearised.a.tr_mul(&lambda), linearised.b.tr_mul(&lambda))
    };
    for j in 0..NX {
        let mut e = SVector::<f64, NX>::zeros();
        e[j] = STEP;
        let (above, below) = (gradient(x + e, u), gradient(x - e, u));
        let xx = (above.0 - below.0) / (2.0 * STEP);
        let ux = (above.1 - below.1) / (2.0 * STEP);
        prop_assert!((curvature.xx.column(j) - xx).amax() < 1e-5, "xx by x[{j}]");
        prop_assert!((curvature.ux.column(j) - ux).amax() < 1e-5, "ux by x[{j}]");
    }
    let mut uu = SMatrix::<f64, 2, 2>::zeros();
    for j in 0..2 {
        let mut e = Vector2::zeros();
        e[j] = STEP;
        uu.set_column(
            j,
            &((gradient(x, u + e).1 - gradient(x, u - e).1) / (2.0 * STEP)),
        );
    }
    prop_assert!((curvature.uu - uu).amax() < 1e-5, "uu");
    Ok(())
}
