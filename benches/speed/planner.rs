//! The planner: a tick of each formulation by each solver, and what surrounds it.

use std::cell::RefCell;
use std::hint::black_box;

use divan::Bencher;
use nalgebra::Vector2;
use sphere_ground::mpc::{Batch, Effort, Mpc, Options, Problem, Solver, Tick, terminal_weight};
use sphere_ground::planner::{Beginning, Job, PlanBatch, Planner};
use sphere_ground::settings::PlannerSettings;
use sphere_ground::trajectory::{Along, Mission, Pose, Reference, Trajectory};
use sphere_protocol::robot::Robot;

use crate::tracking::{self, centre, paper};

const SOLVERS: [Solver; 2] = [Solver::Riccati, Solver::Clarabel];

/// A tick of what ships (model `centre`, N = 20, turn limit) along the lemniscate, warm from the tick before.
#[divan::bench(args = SOLVERS, sample_count = 400, sample_size = 1)]
fn centre_20_knots(bencher: Bencher, solver: Solver) {
    let mut x = [0.3, -0.2, 0.6, 0.4, 0.0];
    ticks(bencher, solver, 20, move |tick, last: &Mpc<5>| {
        if tick > 0 {
            x = last.solution().x[1].into();
        }
        let mut problem = centre(tracking::Trajectory::Lemniscate, 0.1 * tick as f64, x);
        problem.turn_limit = Some(0.3);
        problem
    });
}

/// A tick of the paper's eq (20), N = 10, along the lemniscate, warm from the tick before.
#[divan::bench(args = SOLVERS, sample_count = 400, sample_size = 1)]
fn paper_10_knots(bencher: Bencher, solver: Solver) {
    let (mut x, mut u) = ([0.3, -0.2, 0.6], Vector2::new(0.4, 0.0));
    ticks(bencher, solver, 10, move |tick, last: &Mpc<3>| {
        if tick > 0 {
            (x, u) = (last.solution().x[1].into(), last.solution().u[1]);
        }
        paper(tracking::Trajectory::Lemniscate, 0.1 * tick as f64, x, u)
    });
}

/// Solves tick after tick, each problem made from the solution before; only the solving is timed.
fn ticks<const NX: usize>(
    bencher: Bencher,
    solver: Solver,
    horizon: usize,
    mut next: impl FnMut(usize, &Mpc<NX>) -> Problem<NX>,
) {
    let options = Options {
        solver,
        ..Options::default()
    };
    let mpc = RefCell::new(Mpc::new(horizon, options));
    let mut tick = 0;
    bencher
        .with_inputs(|| {
            let problem = next(tick, &mpc.borrow());
            tick += 1;
            problem
        })
        .bench_local_refs(|problem| {
            let mut mpc = mpc.borrow_mut();
            mpc.shift(1);
            assert!(mpc.solve(problem).is_solved());
        });
}

/// Closed-loop problems of `count` robots spread along the lemniscate, tick by tick, each robot with 3 mm of noise: `period` ticks.
struct Fleet<const NX: usize> {
    solvers: Vec<Mpc<NX>>,
    problems: Vec<Vec<Problem<NX>>>,
    tick: usize,
}

impl<const NX: usize> Fleet<NX> {
    fn new(count: usize, effort: Effort, problem: impl Fn(f64, [f64; 3]) -> Problem<NX>) -> Self {
        let problems: Vec<Vec<_>> = (0..TICKS)
            .map(|tick| {
                (0..count.min(COURSES))
                    .map(|i| {
                        let noise = |k: usize| {
                            let phase = (tick * 7 + i * 13 + k * 29) as f64 * 0.618_034;
                            0.006 * (phase.fract() - 0.5)
                        };
                        problem(
                            0.1 * tick as f64 + 1.3 * i as f64,
                            [noise(0), noise(1), noise(2)],
                        )
                    })
                    .collect()
            })
            .collect();
        let options = Options {
            effort,
            ..Options::default()
        };
        let horizon = problems[0][0].horizon();
        let mut fleet = Self {
            solvers: (0..count).map(|_| Mpc::new(horizon, options)).collect(),
            problems,
            tick: 0,
        };
        fleet.solve(&mut Batch::new());
        fleet
    }

    /// One tick of every robot.
    fn solve(&mut self, batch: &mut Batch<NX>) {
        let problems = &self.problems[self.tick % TICKS];
        let is_back = self.tick.is_multiple_of(TICKS);
        self.tick += 1;
        for (robots, solvers) in self.solvers.chunks_mut(WINDOW).enumerate() {
            let mut ticks = arrayvec::ArrayVec::<_, WINDOW>::new();
            for (i, mpc) in solvers.iter_mut().enumerate() {
                if is_back {
                    mpc.reset();
                }
                mpc.shift(1);
                ticks.push(Tick::new(
                    mpc,
                    &problems[(robots * WINDOW + i) % problems.len()],
                ));
            }
            batch.solve(&mut ticks);
        }
    }
}

const TICKS: usize = 50;
const COURSES: usize = 64;
const WINDOW: usize = 32;

fn fleet_of_paper(count: usize, effort: Effort) -> Fleet<3> {
    Fleet::new(count, effort, |t, noise| {
        let (pose, u) = tracking::Trajectory::Lemniscate.at(t);
        let x = core::array::from_fn(|i| pose[i] + noise[i]);
        paper(tracking::Trajectory::Lemniscate, t, x, u)
    })
}

fn fleet_of_lag(count: usize, horizon: usize, effort: Effort) -> Fleet<5> {
    Fleet::new(count, effort, move |t, noise| {
        let (pose, u) = tracking::Trajectory::Lemniscate.at(t);
        let x = [
            pose[0] + noise[0],
            pose[1] + noise[1],
            pose[2] + noise[2],
            u[0],
            u[1],
        ];
        let mut problem = centre(tracking::Trajectory::Lemniscate, t, x);
        problem.turn_limit = Some(0.484);
        problem.x_ref.truncate(horizon);
        problem.u_ref.truncate(horizon);
        problem.u_min.truncate(horizon);
        problem.u_max.truncate(horizon);
        problem.p_terminal = terminal_weight(
            &problem.model,
            &problem.x_ref[horizon - 1],
            &problem.u_ref[horizon - 1],
            &problem.q,
            &problem.r,
        );
        problem
    })
}

const COUNTS: [usize; 6] = [1, 8, 10, 100, 1000, 10_000];

/// A tick of the paper's problem for so many robots, N = 10, converged. The least time is divided by the robots.
#[divan::bench(args = COUNTS)]
fn batch_paper_10_knots(bencher: Bencher, count: usize) {
    let (mut fleet, mut batch) = (fleet_of_paper(count, Effort::Converge), Batch::new());
    bencher
        .counter(divan::counter::ItemsCount::new(count))
        .bench_local(|| fleet.solve(&mut batch));
}

/// The same by real-time iterations.
#[divan::bench(args = COUNTS)]
fn batch_paper_10_knots_real_time(bencher: Bencher, count: usize) {
    let (mut fleet, mut batch) = (fleet_of_paper(count, Effort::RealTime), Batch::new());
    bencher
        .counter(divan::counter::ItemsCount::new(count))
        .bench_local(|| fleet.solve(&mut batch));
}

/// A tick of what ships, N = 10, converged.
#[divan::bench(args = COUNTS)]
fn batch_lag_10_knots(bencher: Bencher, count: usize) {
    let (mut fleet, mut batch) = (fleet_of_lag(count, 10, Effort::Converge), Batch::new());
    bencher
        .counter(divan::counter::ItemsCount::new(count))
        .bench_local(|| fleet.solve(&mut batch));
}

/// A tick of what ships, N = 20, converged.
#[divan::bench(args = COUNTS)]
fn batch_lag_20_knots(bencher: Bencher, count: usize) {
    let (mut fleet, mut batch) = (fleet_of_lag(count, 20, Effort::Converge), Batch::new());
    bencher
        .counter(divan::counter::ItemsCount::new(count))
        .bench_local(|| fleet.solve(&mut batch));
}

/// The same by real-time iterations.
#[divan::bench(args = COUNTS)]
fn batch_lag_20_knots_real_time(bencher: Bencher, count: usize) {
    let (mut fleet, mut batch) = (fleet_of_lag(count, 20, Effort::RealTime), Batch::new());
    bencher
        .counter(divan::counter::ItemsCount::new(count))
        .bench_local(|| fleet.solve(&mut batch));
}

/// Whole ticks: references, terminal weight, solution, knots as they travel; the lemniscate, N = 20.
#[divan::bench(args = [1, 8, 1000], sample_size = 1)]
fn whole_ticks(bencher: Bencher, count: usize) {
    let robot = Robot::embedded("liu").expect("comes with the project");
    let course = Trajectory::new(&Mission::Lemniscate, &robot, Pose::default()).expect("drivable");
    let settings = PlannerSettings::default();
    let mut planners: Vec<_> = (0..count)
        .map(|_| Planner::new(&robot, &settings))
        .collect();
    let mut batch = PlanBatch::new();
    let mut tick = 0;
    bencher
        .counter(divan::counter::ItemsCount::new(count))
        .bench_local(|| {
            let references: Vec<_> = (0..count)
                .map(|i| Along {
                    trajectory: &course,
                    from: 0.1 * f64::from(tick) + 0.1 * i as f64,
                })
                .collect();
            let mut jobs: Vec<_> = planners
                .iter_mut()
                .zip(&references)
                .map(|(planner, reference)| {
                    let at = reference.point(0.0);
                    Job {
                        planner,
                        beginning: Beginning {
                            x: [at.x + 0.002, at.y - 0.003, at.heading, at.v, at.q_r].into(),
                            measured: [at.v, at.q_r],
                            shift: 1,
                        },
                        reference,
                    }
                })
                .collect();
            tick += 1;
            batch.plan(&mut jobs, |_, knots| {
                black_box(knots).expect("tracks");
            });
        });
}

/// The infinite-horizon cost of the last reference, once a plan.
#[divan::bench]
fn terminal_weight_centre(bencher: Bencher) {
    let problem = centre(tracking::Trajectory::Lemniscate, 3.0, [0.0; 5]);
    bencher.bench_local(|| {
        terminal_weight(
            black_box(&problem.model),
            &problem.x_ref[19],
            &problem.u_ref[19],
            &problem.q,
            &problem.r,
        )
    });
}

/// One point of a reference; a plan of 20 knots takes 41.
#[divan::bench(args = ["line", "sine", "lemniscate"])]
fn reference_point(bencher: Bencher, name: &str) {
    let mission = match name {
        "line" => Mission::Line,
        "sine" => Mission::Sine,
        _ => Mission::Lemniscate,
    };
    let robot = Robot::embedded("liu").expect("comes with the project");
    let trajectory = Trajectory::new(&mission, &robot, Pose::default()).expect("drivable");
    let mut t = 0.0;
    bencher.bench_local(|| {
        t += 0.05;
        trajectory.reference(black_box(t))
    });
}
