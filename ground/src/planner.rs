//! One robot's planner: from the state at a plan's start and the reference to knots and gains.
//!
//! Formulation `lag` plans the centre by eq (1) with the reference lag that the agent shares, weights Q = (2, 2, 1, 1e-3, 1e-3), R_v = 1,
//! R_q growing with the fourth power of the speed, the infinite-horizon cost of the last reference as terminal weight.
//! Formulation `paper` is eq (20) as printed: eq (2), N = 10, Q = (2, 2, 1), R = (1, 1), U(0) measured, U(1) applied.

use arrayvec::ArrayVec;
use nalgebra::{Vector2, Vector3};
use sphere_protocol::message::{KNOTS_MAX, PlanSource};
use sphere_protocol::robot::Robot;

use crate::kinematics::Discretisation;
use crate::mpc::{
    Batch, Effort, FirstInput, Method, Mpc, Options, Path, Problem, Solution, Status, Tick,
    terminal_weight,
};
use crate::predictor::{ReferenceState, wrapped};
use crate::settings::{KNOT, PlannerMode, PlannerSettings};
use crate::trajectory::{Program, Reference, ReferencePoint};

/// Plans for one robot, each time from the last solution.
pub struct Planner {
    formulation: Formulation,
    centre: Discretisation<5>,
    radius: f64, // of the sphere [m]
    tau: f64,    // reference lag [s]
    horizon: usize,
}

/// Buffers of the problem that is solved.
enum Formulation {
    Lag(Box<(Problem<5>, Mpc<5>)>),
    Paper(Box<(Problem<3>, Mpc<3>)>),
}

/// Scratch space for many robots' plans at once, remembering nothing: one for each planning thread.
#[derive(Default)]
pub struct PlanBatch {
    lag: Batch<5>,
    paper: Batch<3>,
}

/// One robot's plan in a [`PlanBatch`].
pub struct Job<'a> {
    /// Its planner.
    pub planner: &'a mut Planner,
    /// Where the plan begins.
    pub beginning: Beginning,
    /// The reference.
    pub reference: &'a dyn Reference,
}

/// Commands, predicted states and gains of one plan, as they travel.
#[derive(Clone, Debug, PartialEq)]
pub struct Knots {
    /// What solved it.
    pub source: PlanSource,
    /// Whether it is optimal; otherwise it merely obeys dynamics and limits.
    pub is_optimal: bool,
    /// Commands (v_c [m/s], q_c [rad]), N rows.
    pub u: ArrayVec<[f32; 2], KNOTS_MAX>,
    /// Predicted states (x, y [m], heading [rad], v_d [m/s], q_rd [rad]), N + 1 rows.
    pub x: ArrayVec<[f32; 5], { KNOTS_MAX + 1 }>,
    /// Gains, N rows of 2 × 5; empty in the formulation `paper`.
    pub k: ArrayVec<[f32; 10], KNOTS_MAX>,
}

/// Where a plan begins.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Beginning {
    /// Reference state: x, y [m], heading [rad], v_d [m/s], q_rd [rad].
    pub x: ReferenceState,
    /// Measured speed [m/s] and roll [rad]: U(0) of the formulation `paper`.
    pub measured: [f64; 2],
    /// Knots by which it begins after the plan before it, for the warm start.
    pub shift: usize,
}

impl Planner {
    /// For one robot. The horizon is clamped to 1 … 64 knots.
    pub fn new(robot: &Robot, settings: &PlannerSettings) -> Self {
        let (radius, limits) = (robot.params.r, &robot.limits);
        let tau = limits.reference_lag;
        let horizon = settings.horizon.clamp(1, KNOTS_MAX);
        let options = Options {
            solver: settings.solver,
            ..Options::default()
        };
        let least = Vector2::new(limits.v_min, -limits.q_r_max);
        let greatest = Vector2::new(limits.v_max, limits.q_r_max);
        let centre = Discretisation::centre(KNOT, radius, tau);
        let formulation = match settings.mode {
            PlannerMode::Lag => {
                let mut problem = Problem::new(centre, horizon);
                problem.set_bounds(least, greatest);
                problem.turn_limit = Some(limits.turn_limit(&robot.params));
                Formulation::Lag(Box::new((problem, Mpc::new(horizon, options))))
            }
            PlannerMode::Paper => {
                let mut problem = Problem::new(Discretisation::arc(KNOT, radius), horizon);
                problem.first_input = FirstInput::Measured;
                problem.set_bounds(least, greatest);
                Formulation::Paper(Box::new((problem, Mpc::new(horizon, options))))
            }
        };
        Self {
            formulation,
            centre,
            radius,
            tau,
            horizon,
        }
    }

    /// How far later plans are taken: [`Effort::RealTime`] sheds load.
    pub fn set_effort(&mut self, effort: Effort) {
        match &mut self.formulation {
            Formulation::Lag(lag) => lag.1.set_effort(effort),
            Formulation::Paper(paper) => paper.1.set_effort(effort),
        }
    }

    /// Which way the last plan was found.
    pub fn path(&self) -> Path {
        match &self.formulation {
            Formulation::Lag(lag) => lag.1.solution().path,
            Formulation::Paper(paper) => paper.1.solution().path,
        }
    }

    /// Forgets the last solution.
    pub fn reset(&mut self) {
        match &mut self.formulation {
            Formulation::Lag(lag) => lag.1.reset(),
            Formulation::Paper(paper) => paper.1.reset(),
        }
    }

    /// The problem of the last [`Planner::plan`], in the formulation `lag`.
    pub fn lag_problem(&self) -> Option<&Problem<5>> {
        match &self.formulation {
            Formulation::Lag(lag) => Some(&lag.0),
            Formulation::Paper(_) => None,
        }
    }

    /// The problem of the last [`Planner::plan`], in the formulation `paper`.
    pub fn paper_problem(&self) -> Option<&Problem<3>> {
        match &self.formulation {
            Formulation::Lag(_) => None,
            Formulation::Paper(paper) => Some(&paper.0),
        }
    }

    /// The commands of `program`, `t` seconds after its start, as a plan: nothing is optimised and nothing fed back.
    pub fn typed(&self, beginning: &Beginning, program: &Program, t: f64) -> Knots {
        let mut x = beginning.x;
        let mut knots = Knots {
            source: if program.is_smooth() {
                PlanSource::Course
            } else {
                PlanSource::Steps
            },
            is_optimal: true,
            u: ArrayVec::new(),
            x: ArrayVec::new(),
            k: ArrayVec::new(),
        };
        knots.x.push(x.map(|c| c as f32).into());
        for i in 0..self.horizon {
            // A step falls between knots; its own instant belongs to what follows it.
            let into = if program.is_smooth() { 0.0 } else { 0.5 };
            let u = program.command(t + KNOT * (i as f64 + into));
            x = self.centre.step(&x, &u.into());
            knots.u.push(u.map(|c| c as f32));
            knots.x.push(x.map(|c| c as f32).into());
        }
        knots
    }

    /// Plans from `beginning` along `reference`, a function of the time since the plan's start [s].
    ///
    /// # Errors
    /// How the solver failed. There is no plan then.
    pub fn plan(
        &mut self,
        beginning: &Beginning,
        reference: impl Fn(f64) -> ReferencePoint,
    ) -> Result<Knots, Status> {
        self.follow(beginning, &reference)
    }

    /// [`Planner::plan`] along a reference of any kind: a [`crate::trajectory::Along`] computes no more of each point than a plan needs.
    ///
    /// # Errors
    /// As [`Planner::plan`].
    pub fn follow(
        &mut self,
        beginning: &Beginning,
        reference: &dyn Reference,
    ) -> Result<Knots, Status> {
        self.pose(beginning, reference);
        match &mut self.formulation {
            Formulation::Lag(lag) => {
                lag.1.solve(&lag.0);
            }
            Formulation::Paper(paper) => {
                paper.1.solve(&paper.0);
            }
        }
        self.knots(beginning)
    }

    /// Writes the problem, and moves the last solution on to its beginning.
    fn pose(&mut self, beginning: &Beginning, reference: &dyn Reference) {
        let shift = pull_in(&beginning.x, &reference.state(0.0));
        let mut heading = beginning.x[2];
        let states = (1..=self.horizon).map(|i| {
            let mut state = reference.state(KNOT * i as f64);
            state[0] -= shift[0];
            state[1] -= shift[1];
            // Near the heading before it: a reference may be turns away from the robot's.
            heading += wrapped(state[2] - heading);
            state[2] = heading;
            state
        });
        // A command is held over its knot: the reference in its middle.
        let commands = |first: f64| move |i: usize| KNOT * (i as f64 + first);
        match &mut self.formulation {
            Formulation::Lag(lag) => {
                let (problem, mpc) = &mut **lag;
                problem.x0 = beginning.x;
                let mut v_max = beginning.x[3].abs();
                for (row, state) in problem.x_ref.iter_mut().zip(states) {
                    *row = state.into();
                    v_max = v_max.max(state[3].abs());
                }
                for (i, row) in problem.u_ref.iter_mut().enumerate() {
                    *row = reference.motion(commands(0.5)(i)).command(self.tau).into();
                }
                problem.r = Vector2::new(1.0, roll_weight(problem.q[1], v_max, self.radius));
                let last = self.horizon - 1;
                problem.p_terminal = terminal_weight(
                    &problem.model,
                    &problem.x_ref[last],
                    &problem.u_ref[last],
                    &problem.q,
                    &problem.r,
                );
                mpc.shift(beginning.shift);
            }
            Formulation::Paper(paper) => {
                let (problem, mpc) = &mut **paper;
                problem.x0 = Vector3::new(beginning.x[0], beginning.x[1], beginning.x[2]);
                problem.u_prev = beginning.measured.into();
                for (row, [x, y, heading, ..]) in problem.x_ref.iter_mut().zip(states) {
                    *row = Vector3::new(x, y, heading);
                }
                // Row i is U(i + 1), held from the end of knot i + 1 on.
                for (i, row) in problem.u_ref.iter_mut().enumerate() {
                    let motion = reference.motion(commands(1.5)(i));
                    *row = Vector2::new(motion.v, motion.q_r);
                }
                mpc.shift(beginning.shift);
            }
        }
    }

    /// The solution as it travels.
    fn knots(&self, beginning: &Beginning) -> Result<Knots, Status> {
        match &self.formulation {
            Formulation::Lag(lag) => {
                let solution = lag.1.solution();
                let (source, is_optimal) = outcome(solution)?;
                Ok(Knots {
                    source,
                    is_optimal,
                    u: solution
                        .u
                        .iter()
                        .map(|u| u.map(|c| c as f32).into())
                        .collect(),
                    x: solution
                        .x
                        .iter()
                        .map(|x| x.map(|c| c as f32).into())
                        .collect(),
                    k: solution
                        .gains
                        .iter()
                        .map(|gain| core::array::from_fn(|i| gain[(i / 5, i % 5)] as f32))
                        .collect(),
                })
            }
            Formulation::Paper(paper) => {
                let solution = paper.1.solution();
                let (source, is_optimal) = outcome(solution)?;
                // What the robot makes of the commands: they are applied at once, and its reference follows with the lag.
                let mut x = beginning.x;
                let mut knots = Knots {
                    source,
                    is_optimal,
                    u: ArrayVec::new(),
                    x: ArrayVec::new(),
                    k: ArrayVec::new(),
                };
                knots.x.push(x.map(|c| c as f32).into());
                for u in &solution.u {
                    x = self.centre.step(&x, u);
                    knots.u.push(u.map(|c| c as f32).into());
                    knots.x.push(x.map(|c| c as f32).into());
                }
                Ok(knots)
            }
        }
    }
}

impl PlanBatch {
    /// With room to be made at the first use.
    pub fn new() -> Self {
        Self::default()
    }

    /// Plans every job, and hands each outcome with the job's index to `each`, in the order of the jobs.
    ///
    /// Every outcome is the one that [`Planner::plan`] would have had, bit for bit, whatever the company. Jobs of one formulation and
    /// horizon that stand together share lanes.
    pub fn plan(
        &mut self,
        jobs: &mut [Job<'_>],
        mut each: impl FnMut(usize, Result<Knots, Status>),
    ) {
        for (window, jobs) in jobs.chunks_mut(WINDOW).enumerate() {
            let mut lag = ArrayVec::<Tick<'_, 5>, WINDOW>::new();
            let mut paper = ArrayVec::<Tick<'_, 3>, WINDOW>::new();
            for job in &mut *jobs {
                job.planner.pose(&job.beginning, job.reference);
                match &mut job.planner.formulation {
                    Formulation::Lag(parts) => {
                        let (problem, mpc) = &mut **parts;
                        lag.push(Tick::new(mpc, problem));
                    }
                    Formulation::Paper(parts) => {
                        let (problem, mpc) = &mut **parts;
                        paper.push(Tick::new(mpc, problem));
                    }
                }
            }
            self.lag.solve(&mut lag);
            self.paper.solve(&mut paper);
            drop((lag, paper));
            for (i, job) in jobs.iter().enumerate() {
                each(WINDOW * window + i, job.planner.knots(&job.beginning));
            }
        }
    }
}

/// By how much the whole reference is moved so that it begins no farther than [`ERROR_MAX`] from the robot [m, m].
fn pull_in(x: &ReferenceState, reference: &[f64; 5]) -> [f64; 2] {
    let (dx, dy) = (reference[0] - x[0], reference[1] - x[1]);
    let distance = dx.hypot(dy);
    let share = if distance > ERROR_MAX {
        1.0 - ERROR_MAX / distance
    } else {
        0.0
    };
    [dx * share, dy * share]
}

/// R_q = max(1, Q_y (v²/(R ω²))²): an outer loop faster than ω drives the non-minimum-phase lean into a limit cycle.
fn roll_weight(q_y: f64, v: f64, radius: f64) -> f64 {
    let share = v * v / (radius * OUTER_LOOP * OUTER_LOOP);
    (q_y * share * share).max(1.0)
}

fn outcome<const NX: usize>(solution: &Solution<NX>) -> Result<(PlanSource, bool), Status> {
    let is_optimal = match solution.status {
        Status::Solved => true,
        Status::MaxIterations => false,
        failed => return Err(failed),
    };
    let finite = solution.u.iter().all(|u| u.iter().all(|c| c.is_finite()))
        && solution.x.iter().all(|x| x.iter().all(|c| c.is_finite()))
        && solution
            .gains
            .iter()
            .all(|k| k.iter().all(|c| c.is_finite()));
    if !finite {
        return Err(Status::MaxIterations);
    }
    let source = match solution.method {
        Method::Riccati => PlanSource::Riccati,
        Method::Clarabel => PlanSource::Clarabel,
    };
    Ok((source, is_optimal))
}

/// Farthest reference [m]: beyond it the robot is led by a point on the way there, and the problem stays well scaled.
const ERROR_MAX: f64 = 1.5;
/// Jobs solved between posing and handing out: their problems still lie in the cache then.
const WINDOW: usize = 32;
/// Bandwidth of the outer loop that the lean bears [rad/s].
const OUTER_LOOP: f64 = 1.4;
