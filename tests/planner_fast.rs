//! The planner's fast path and its batches: the same plans as the searching solver's, the same bits in any company and on any
//! instruction set.

#[allow(unreachable_pub, reason = "shared by several test binaries")]
mod support;
#[path = "support/tracking.rs"]
mod tracking;

use nalgebra::{Vector2, Vector3, Vector5};
use proptest::prelude::*;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use sphere_ground::mpc::{
    Batch, Effort, HalfPlane, InstructionSet, Mpc, Options, Path, Problem, Solution, Status, Tick,
    kkt_residual,
};
use sphere_ground::plan_command::{self, AnyProblem, Kind};
use sphere_ground::planner::{Beginning, Job, PlanBatch, Planner};
use sphere_ground::settings::{PlannerSettings, Preset};
use sphere_ground::trajectory::{Mission, Pose, ReferencePoint, Trajectory as Course};
use sphere_protocol::robot::Robot;
use support::golden_files;
use tracking::{ALL, Trajectory, centre, paper};

/// Each golden problem again from its own solution moved by a tick's worth of noise: what stays on the fast path lies where the search ends.
#[test]
fn golden_problems_stay_on_the_fast_path() {
    let (mut fast, mut all) = (0, 0);
    for (path, file) in golden_files("instances") {
        let name = path.display().to_string();
        for instance in plan_command::parse(&name, &file.to_string()).expect("golden file") {
            let what = instance.id.to_string();
            let is_fast = match &instance.problem {
                AnyProblem::Three(problem) => again(&what, problem),
                AnyProblem::Five(problem) => again(&what, problem),
            };
            // The others have half-planes, or costs or bounds on the change of the input.
            let may_be = !matches!(instance.kind, Kind::Rate | Kind::Soft);
            assert_eq!(is_fast, may_be, "{what} ({})", instance.kind);
            all += 1;
            fast += usize::from(is_fast);
        }
    }
    assert_eq!((fast, all), (58, 72));
}

/// Solves `problem` from the solution of one that begins 5 mm and 0.3° beside it. Whether that took the fast path.
fn again<const NX: usize>(what: &str, problem: &Problem<NX>) -> bool {
    let mut cold = Mpc::new(problem.horizon(), Options::default());
    let expected = cold.solve(problem).clone();
    let mut warm = Mpc::new(problem.horizon(), Options::default());
    let mut beside = problem.clone();
    beside.x0[0] += 0.005;
    beside.x0[1] -= 0.005;
    beside.x0[2] += 0.005;
    warm.solve(&beside);
    let solution = warm.solve(problem);
    if solution.path != Path::Fast {
        return false;
    }
    assert_eq!(solution.status, Status::Solved, "{what}");
    assert!(solution.iterations <= 8, "{what}: {}", solution.iterations);
    let residual = kkt_residual(problem, &solution.x, &solution.u);
    assert!(residual <= 1e-10, "{what}: residual {residual:e}");
    for (u, expected) in solution.u.iter().zip(&expected.u) {
        assert!(
            (u - expected).amax() <= 1e-9,
            "{what}: {u} is not {expected}"
        );
    }
    assert!(
        (solution.cost - expected.cost).abs() <= 1e-9 * (1.0 + expected.cost),
        "{what}"
    );
    for (gain, expected) in solution.gains.iter().zip(&expected.gains) {
        let size = 1.0 + expected.amax();
        assert!(
            (gain - expected).amax() <= 1e-3 * size,
            "{what}: {gain} is not {expected}"
        );
    }
    true
}

/// Ticks with noise stay on the path but for the first one, within a few iterations, at the searching solver's optimum.
#[test]
fn tracking_with_noise_stays_on_the_fast_path() {
    let mut rng = ChaCha8Rng::seed_from_u64(11);
    for trajectory in ALL {
        let mut mpc = Mpc::new(20, Options::default());
        let (pose, u) = trajectory.at(0.0);
        let mut x = Vector5::new(pose[0], pose[1], pose[2], u[0], u[1]);
        for tick in 0..200 {
            let mut problem = centre(trajectory, 0.1 * f64::from(tick), x.into());
            problem.turn_limit = Some(0.484);
            mpc.shift(1);
            let solution = mpc.solve(&problem);
            assert_eq!(
                solution.path == Path::Fast,
                tick > 0,
                "{trajectory:?} {tick}"
            );
            let residual = kkt_residual(&problem, &solution.x, &solution.u);
            assert!(residual < 1e-10, "{trajectory:?} {tick}: {residual:e}");
            x = problem.model.step(&x, &solution.u[0]);
            for j in 0..3 {
                x[j] += rng.random_range(-0.005..0.005);
            }
        }
    }
}

/// A tick as a test makes it: a robot somewhere near its course, sometimes far off, with garbage, or with a wall.
#[derive(Clone, Copy, Debug)]
struct Case {
    trajectory: usize,
    time: f64,
    offset: [f64; 3],
    spoilt: usize,
}

fn case() -> impl Strategy<Value = Case> {
    (
        0..3_usize,
        0.0..100.0_f64,
        [-0.05..0.05_f64, -0.05..0.05_f64, -0.05..0.05_f64],
        0..12_usize,
    )
        .prop_map(|(trajectory, time, offset, spoilt)| Case {
            trajectory,
            time,
            offset,
            spoilt,
        })
}

impl Case {
    fn centre(&self, tick: usize) -> Problem<5> {
        let time = self.time + 0.1 * tick as f64;
        let trajectory: Trajectory = ALL[self.trajectory];
        let (pose, u) = trajectory.at(time);
        let share = [1.0, 0.8, 0.6, 0.5][tick];
        let x: [f64; 3] = core::array::from_fn(|i| pose[i] + share * self.offset[i]);
        let mut problem = centre(trajectory, time, [x[0], x[1], x[2], u[0], u[1]]);
        problem.turn_limit = Some(if self.spoilt == 5 { 0.03 } else { 0.484 });
        if tick > 0 {
            match self.spoilt {
                0 => problem.x0[tick % 5] = f64::NAN,
                1 => problem.x_ref[7][1] = f64::INFINITY,
                2 => problem.x0[0] += 1.0,
                3 => {
                    let plane = HalfPlane {
                        normal: [0.0, 1.0],
                        offset: x[1] - 0.02,
                        weight: 500.0,
                    };
                    assert!(problem.add_half_plane(4, plane));
                }
                4 => problem.u_ref[19][1] = f64::NAN,
                6 => problem.p_terminal[(1, 1)] = -5.0,
                7 => problem.u_max[3][0] = -1.0,
                _ => {}
            }
        }
        problem
    }

    fn paper(&self, tick: usize) -> Problem<3> {
        let time = self.time + 0.1 * tick as f64;
        let trajectory: Trajectory = ALL[self.trajectory];
        let (pose, u) = trajectory.at(time);
        let x: [f64; 3] = core::array::from_fn(|i| pose[i] + self.offset[i]);
        let mut problem = paper(trajectory, time, x, u);
        match self.spoilt {
            0 if tick > 0 => problem.u_prev[1] = f64::NAN,
            1 if tick > 0 => problem.u_ref[9][0] = f64::NAN,
            2 if tick > 0 => problem.x0[2] += 1.0,
            3 if tick > 0 => problem.u_prev[1] = 1.2,
            _ => {}
        }
        problem
    }
}

/// Ticks of all `cases` in batches of `set`, against each alone.
fn check_batches<const NX: usize>(
    cases: &[Case],
    effort: Effort,
    set: InstructionSet,
    problem: impl Fn(&Case, usize) -> Problem<NX>,
) -> Result<(), TestCaseError> {
    let options = Options {
        effort,
        ..Options::default()
    };
    let horizon = problem(&cases[0], 0).horizon();
    let fresh = || -> Vec<Mpc<NX>> { cases.iter().map(|_| Mpc::new(horizon, options)).collect() };
    let (mut alone, mut together) = (fresh(), fresh());
    let mut batch = Batch::with_instructions(set);
    for tick in 0..4 {
        let problems: Vec<_> = cases.iter().map(|case| problem(case, tick)).collect();
        for ((one, other), problem) in alone.iter_mut().zip(&mut together).zip(&problems) {
            one.shift(usize::from(tick > 0));
            other.shift(usize::from(tick > 0));
            one.solve(problem);
        }
        let mut ticks: Vec<_> = together
            .iter_mut()
            .zip(&problems)
            .map(|(mpc, problem)| Tick::new(mpc, problem))
            .collect();
        batch.solve(&mut ticks);
        for (i, (one, other)) in alone.iter().zip(&together).enumerate() {
            prop_assert_eq!(
                bits(one.solution()),
                bits(other.solution()),
                "tick {} of {:?} in {:?}",
                tick,
                cases[i],
                set
            );
        }
    }
    Ok(())
}

/// Every number of a solution, bit for bit; NaN of any kind is NaN.
fn bits<const NX: usize>(solution: &Solution<NX>) -> (Status, Path, u32, Vec<u64>) {
    let numbers = core::iter::once(&solution.cost)
        .chain(solution.u.iter().flat_map(|u| u.iter()))
        .chain(solution.x.iter().flat_map(|x| x.iter()))
        .chain(solution.gains.iter().flat_map(|k| k.iter()));
    let bits = numbers.map(|number| if number.is_nan() { 0 } else { number.to_bits() });
    (
        solution.status,
        solution.path,
        solution.iterations,
        bits.collect(),
    )
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(40))]

    /// A plan has the same bits alone, in any batch, lane and company, with every instruction set that there is; robots whose
    /// problem is garbage, far away or walled in leave the path and spoil nobody's plan.
    #[test]
    fn company_and_instructions_change_no_bit(
        cases in prop::collection::vec(case(), 1..20),
        is_real_time in any::<bool>(),
    ) {
        let effort = if is_real_time { Effort::RealTime } else { Effort::Converge };
        for set in InstructionSet::available() {
            check_batches(&cases, effort, set, Case::centre)?;
            check_batches(&cases, effort, set, Case::paper)?;
        }
    }
}

/// One iteration a tick: the plan obeys bounds, turn limit and dynamics, says whether it is optimal, and tracks as well.
#[test]
fn real_time_iteration_is_drivable_and_tracks() {
    let options = Options {
        effort: Effort::RealTime,
        ..Options::default()
    };
    let mut mpc = Mpc::new(20, options);
    let mut x = Vector5::new(0.0, 1.7, 0.1, 0.4, 0.0);
    let mut optimal = 0;
    for tick in 0..150 {
        let mut problem = centre(Trajectory::Line, 0.1 * f64::from(tick), x.into());
        problem.turn_limit = Some(0.1);
        mpc.shift(1);
        let solution = mpc.solve(&problem);
        if solution.path == Path::Fast {
            assert_eq!(solution.iterations, 1);
        }
        let is_optimal = kkt_residual(&problem, &solution.x, &solution.u) < 1e-8;
        assert!(is_optimal || !solution.is_solved(), "tick {tick}");
        optimal += usize::from(solution.is_solved());
        for k in 0..20 {
            let (x, u) = (&solution.x[k], &solution.u[k]);
            let v = u[0].abs().max(x[3].abs());
            assert!((-0.5..=1.0).contains(&u[0]) && u[1].abs() <= 20.0_f64.to_radians());
            assert!(u[1].tan().abs() * v * v <= 0.1 + 1e-9, "tick {tick}");
            assert!((problem.model.step(x, u) - solution.x[k + 1]).amax() < 1e-12);
        }
        x = problem.model.step(&x, &solution.u[0]);
    }
    assert!((x[1] - 2.0).abs() < 0.01, "ended at {x}");
    assert!(optimal > 50, "{optimal}");
}

/// A batch of planners has the plans of each planner, and hands them out in the order of its jobs.
#[test]
fn batch_of_planners_plans_as_each_alone() {
    let robot = Robot::embedded("liu").expect("comes with the project");
    let missions = [Mission::Line, Mission::Sine, Mission::Lemniscate];
    let courses: Vec<Course> = missions
        .iter()
        .map(|mission| Course::new(mission, &robot, Pose::default()).expect("drivable"))
        .collect();
    let settings = |i: usize| PlannerSettings {
        horizon: [20, 20, 10][i % 3],
        ..PlannerSettings::of(if i.is_multiple_of(5) {
            Preset::Paper
        } else {
            Preset::Ours
        })
    };
    let count = 77;
    let planners = || -> Vec<Planner> {
        (0..count)
            .map(|i| Planner::new(&robot, &settings(i)))
            .collect()
    };
    let (mut alone, mut together) = (planners(), planners());
    let mut batch = PlanBatch::new();
    for tick in 0..3 {
        let time = |i: usize| 0.1 * tick as f64 + 0.7 * i as f64;
        let references: Vec<_> = (0..count)
            .map(|i| {
                let course = &courses[i % 3];
                move |t: f64| -> ReferencePoint { course.reference(time(i) + t) }
            })
            .collect();
        let beginnings: Vec<_> = (0..count)
            .map(|i| {
                let at = courses[i % 3].reference(time(i));
                Beginning {
                    x: [at.x + 0.01, at.y - 0.02, at.heading, at.v, at.q_r].into(),
                    measured: [at.v, at.q_r],
                    shift: 1,
                }
            })
            .collect();
        let mut jobs: Vec<_> = together
            .iter_mut()
            .enumerate()
            .map(|(i, planner)| Job {
                planner,
                beginning: beginnings[i],
                reference: &references[i],
            })
            .collect();
        let mut next = 0;
        batch.plan(&mut jobs, |i, knots| {
            assert_eq!(i, next);
            next += 1;
            assert_eq!(
                knots,
                alone[i].plan(&beginnings[i], references[i]),
                "robot {i}"
            );
        });
        assert_eq!(next, count);
        for planner in &together {
            assert_eq!(planner.path() == Path::Fast, tick > 0);
        }
    }
}

/// From which the fast path must not be taken: an input moved by 90° is not one of the paper's.
#[test]
fn measured_input_beyond_the_series_is_searched_or_refused() {
    let mut mpc = Mpc::new(10, Options::default());
    let problem = paper(
        Trajectory::Line,
        0.0,
        [0.0, 2.0, 0.0],
        Vector2::new(0.5, 0.0),
    );
    mpc.solve(&problem);
    let mut far = problem.clone();
    far.u_prev[1] = 1.2;
    mpc.shift(1);
    assert_ne!(mpc.solve(&far).path, Path::Fast);
    let mut off = problem.clone();
    off.x0 = Vector3::new(0.0, 2.0, 2e6);
    assert_ne!(mpc.solve(&off).path, Path::Fast);
}
