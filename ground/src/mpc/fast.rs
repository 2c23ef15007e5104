//! The fast path: from a tick's last solution to the next one, by full exact-Hessian steps and nothing else.
//!
//! In ordinary tracking the last solution is so near that Newton's method needs no search: two or three iterations of `sweep` and the
//! problem is solved to rounding. Everything that is not ordinary leaves the path with the last solution untouched, and `sqp` solves
//! it in the same tick: no last solution, half-planes, costs or bounds on the change of the input, angles beyond the series, an
//! indefinite Q_uu, a step that grows, no end after [`ITERATIONS_MAX`].
//!
//! One source serves one robot, four and eight at a time (`lanes`); [`Batch`] forms the groups. A plan is the same bit for bit either way.

mod batch;
mod isa;
mod knot;
mod lanes;
mod sweep;
mod trig;
#[cfg(target_arch = "x86_64")]
mod x86;

use nalgebra::{SMatrix, SVector, Vector2};

pub use self::batch::{Batch, Tick};
pub use self::isa::InstructionSet;
use self::isa::{Engine, Scalar};
use self::knot::Model;
use self::lanes::{LANES_MAX, Lanes};
use self::sweep::{Sweep, roll_bounds};
use super::problem::{FirstInput, Problem};
use super::solution::{Method, Path, Status};
use super::{Effort, Mpc, Solver, subproblem};

/// Scratch space of one robot alone.
pub(super) struct Alone<const NX: usize>(Sweep<f64, NX>);

/// What one lane is doing.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Lane {
    /// Iterating; the square of its last step.
    Running(f64),
    /// Handed over.
    Done,
    /// For `sqp` to solve, after so many iterations.
    Left(u32),
}

/// One lane while its problem is being loaded.
struct Head<const NX: usize> {
    /// Whether all so far makes sense.
    is_good: bool,
    /// State where the next stage begins.
    x: [f64; NX],
    /// Turns by which the last solution's heading differs [rad].
    turns: f64,
    /// Stages at whose end the last solution has a state.
    known: usize,
    /// Row of the references that belongs to the first stage's end.
    first_row: usize,
    model: Model<f64>,
}

/// Solves up to [`Lanes::WIDTH`] ticks of one shape, all of which [`Mpc::may_be_fast`]; by `sqp` what leaves the path.
fn drive<E: Engine, const NX: usize>(
    engine: E,
    sweep: &mut Sweep<E::Lanes, NX>,
    ticks: &mut [Tick<'_, NX>],
) {
    let Some(first) = ticks.first() else {
        return;
    };
    sweep.resize(stages_of(first.problem));
    let mut lanes = [Lane::Left(0); LANES_MAX];
    // Idle lanes compute the first robot's plan once more.
    let mut heads: [Head<NX>; LANES_MAX] = core::array::from_fn(|lane| {
        let tick = ticks.get(lane).unwrap_or(&ticks[0]);
        if lane < E::Lanes::WIDTH {
            tick.mpc.load_head(sweep, lane, tick.problem)
        } else {
            Head::nothing()
        }
    });
    // Stage by stage, so that each line of the scratch space is written at once.
    for k in 0..sweep.stages.len() {
        for (lane, head) in heads.iter_mut().enumerate().take(E::Lanes::WIDTH) {
            let tick = ticks.get(lane).unwrap_or(&ticks[0]);
            tick.mpc.load_stage(sweep, lane, tick.problem, head, k);
        }
    }
    for lane in 0..ticks.len() {
        if heads[lane].is_good {
            lanes[lane] = Lane::Running(f64::INFINITY);
        }
    }
    let is_convex = engine.check(sweep);
    for (lane, state) in lanes.iter_mut().enumerate().take(ticks.len()) {
        if !E::Lanes::holds(&is_convex, lane) {
            *state = Lane::Left(0);
        }
    }
    for iteration in 1..=ITERATIONS_MAX {
        if !lanes.iter().any(|lane| matches!(lane, Lane::Running(_))) {
            break;
        }
        let outcome = engine.iterate(sweep);
        let mut costs = None;
        for (lane, tick) in ticks.iter_mut().enumerate() {
            let Lane::Running(before) = lanes[lane] else {
                continue;
            };
            let size2 = outcome.size2.lane(lane);
            let tolerance = if E::Lanes::holds(&outcome.is_limited, lane) {
                STEP_LIMITED
            } else {
                STEP
            };
            // Two steps tell the rate e⁺ = C e² and so the error that the second one leaves.
            let is_near = iteration > 1
                && !E::Lanes::holds(&outcome.is_limited, lane)
                && size2 * size2 * size2 <= before * before * (ERROR * ERROR);
            let is_converged = size2 <= tolerance * tolerance || is_near;
            // Written so that NaN leaves too.
            let is_good = E::Lanes::holds(&outcome.is_sound, lane)
                && size2 <= STEP_MAX * STEP_MAX
                && size2 <= GROWTH_MAX * GROWTH_MAX * before;
            lanes[lane] = if !is_good {
                Lane::Left(iteration)
            } else if is_converged || tick.mpc.options.effort == Effort::RealTime {
                let costs = costs.get_or_insert_with(|| engine.cost(sweep));
                let cost = costs.lane(lane);
                if tick
                    .mpc
                    .take_over(sweep, lane, tick.problem, cost, is_converged, iteration)
                {
                    Lane::Done
                } else {
                    Lane::Left(iteration)
                }
            } else if iteration == ITERATIONS_MAX {
                Lane::Left(iteration)
            } else {
                Lane::Running(size2)
            };
        }
    }
    for (tick, lane) in ticks.iter_mut().zip(lanes) {
        if let Lane::Left(iterations) = lane {
            tick.mpc.search(tick.problem, iterations);
        }
    }
}

/// Stages whose input moves a state that counts: a measured first input leaves the last one without effect.
fn stages_of<const NX: usize>(problem: &Problem<NX>) -> usize {
    match problem.first_input {
        FirstInput::Decided => problem.horizon(),
        FirstInput::Measured => problem.horizon().saturating_sub(1),
    }
}

impl<const NX: usize> Alone<NX> {
    pub(super) fn new(horizon: usize) -> Self {
        let mut sweep = Sweep::new();
        sweep.resize(horizon);
        Self(sweep)
    }
}

impl<const NX: usize> Mpc<NX> {
    /// Solves `problem` alone if [`Self::may_be_fast`].
    pub(super) fn solve_alone(&mut self, problem: &Problem<NX>) {
        let mut sweep = core::mem::replace(&mut self.alone.0, Sweep::new());
        drive(Scalar, &mut sweep, &mut [Tick::new(self, problem)]);
        self.alone.0 = sweep;
    }

    /// Whether the fast path may try `problem`: a solution to start from, and nothing in the problem that only `sqp` knows.
    ///
    /// Together with what [`Self::load`] and the sweep ask it refuses all that [`Problem::validate`] refuses.
    pub(super) fn may_be_fast(&self, problem: &Problem<NX>) -> bool {
        let horizon = problem.horizon();
        let rows = [
            problem.u_ref.len(),
            problem.u_min.len(),
            problem.u_max.len(),
            problem.half_planes.len(),
        ];
        let is_measured = problem.first_input == FirstInput::Measured;
        self.is_warm
            && self.options.solver != Solver::Clarabel
            && self.sqp.point.u.len() == horizon
            && stages_of(problem) > 0
            && rows == [horizon; 4]
            && !problem.couples_inputs()
            && problem.half_planes.iter().all(|planes| planes.is_empty())
            && problem.model.is_valid()
            && problem.q.iter().all(|weight| *weight >= 0.0)
            && problem.r.iter().all(|weight| *weight > 0.0)
            && problem.u_prev.iter().all(|value| value.is_finite())
            // A NaN for a limit ends here too.
            && problem
                .turn_limit
                .is_none_or(|limit| limit >= 0.0 && limit < f64::INFINITY && !is_measured)
    }

    /// Puts what all stages of `problem` share into `lane` of `sweep`, and the first state.
    fn load_head<L: Lanes>(
        &self,
        sweep: &mut Sweep<L, NX>,
        lane: usize,
        problem: &Problem<NX>,
    ) -> Head<NX> {
        let stages = stages_of(problem);
        let mut model = Model::zero();
        model.set_lane(0, &problem.model);
        sweep.model.set_lane(lane, &problem.model);
        for j in 0..NX {
            sweep.weight[j].set_lane(lane, 2.0 * problem.q[j]);
        }
        for j in 0..2 {
            sweep.input_weight[j].set_lane(lane, 2.0 * problem.r[j]);
        }
        let mut is_good = sweep.set_terminal(lane, &problem.p_terminal);
        let limit = problem.turn_limit.unwrap_or(f64::INFINITY);
        sweep.turn_limit.set_lane(lane, limit);

        let given: [f64; NX] = problem.x0.into();
        let (x, first_row) = match problem.first_input {
            FirstInput::Decided => (given, 0),
            FirstInput::Measured => {
                let u: [f64; 2] = problem.u_prev.into();
                is_good &= model.is_near(&given, &u);
                // The input without effect is no part of the sweep.
                is_good &= are_bounds(&problem.u_min[stages], &problem.u_max[stages]);
                (model.step(&given, &u), 1)
            }
        };
        for (j, value) in x.iter().enumerate() {
            sweep.x[0][j].set_lane(lane, *value);
        }
        // A heading is the same after a turn, the plan must be near the one given.
        let turn = core::f64::consts::TAU;
        Head {
            is_good,
            x,
            turns: ((x[2] - self.sqp.point.x[0][2]) / turn).round() * turn,
            known: stages.saturating_sub(self.shifted),
            first_row,
            model,
        }
    }

    /// Puts stage `k` of `problem` and of the last solution into `lane` of `sweep`.
    #[inline(always)]
    fn load_stage<L: Lanes>(
        &self,
        sweep: &mut Sweep<L, NX>,
        lane: usize,
        problem: &Problem<NX>,
        head: &mut Head<NX>,
        k: usize,
    ) {
        let point = &self.sqp.point;
        let stage = &mut sweep.stages[k];
        let u: [f64; 2] = point.u[k].into();
        let (x_ref, u_ref) = (&problem.x_ref[k + head.first_row], &problem.u_ref[k]);
        let (lower, upper) = (&problem.u_min[k], &problem.u_max[k]);
        head.is_good &= are_bounds(lower, upper);
        for j in 0..2 {
            stage.u_ref[j].set_lane(lane, u_ref[j]);
            stage.lower[j].set_lane(lane, lower[j]);
            stage.upper[j].set_lane(lane, upper[j]);
            stage.u[j].set_lane(lane, u[j]);
        }
        head.x = if k < head.known {
            let mut next: [f64; NX] = point.x[k + 1].into();
            next[2] += head.turns;
            next
        } else {
            // Where the last solution ends its last input is held.
            head.model.step(&head.x, &u)
        };
        for j in 0..NX {
            stage.x_ref[j].set_lane(lane, x_ref[j]);
            sweep.x[k + 1][j].set_lane(lane, head.x[j]);
        }
    }

    /// Makes `lane` of `sweep` the solution. Whether it is one, of numbers.
    fn take_over<L: Lanes>(
        &mut self,
        sweep: &Sweep<L, NX>,
        lane: usize,
        problem: &Problem<NX>,
        cost: f64,
        is_converged: bool,
        iteration: u32,
    ) -> bool {
        let stages = stages_of(problem);
        let is_measured = problem.first_input == FirstInput::Measured;
        let mut cost = cost;
        let mut last = Vector2::zeros();
        if is_measured {
            let error = SVector::from(sweep.x[0].map(|x| x.lane(lane))) - problem.x_ref[0];
            cost += error.component_mul(&error).dot(&problem.q);
            last = problem.u_ref[stages].zip_zip_map(
                &problem.u_min[stages],
                &problem.u_max[stages],
                |u, min, max| u.max(min).min(max),
            );
            let error = last - problem.u_ref[stages];
            cost += error.component_mul(&error).dot(&problem.r);
        }
        // The cost has every number of the references and weights in it.
        if !cost.is_finite() {
            return false;
        }
        let point = &mut self.sqp.point;
        for (x, lanes) in point.x.iter_mut().zip(&sweep.x) {
            *x = SVector::from(lanes.map(|x| x.lane(lane)));
        }
        self.solution.clear();
        for (u, stage) in point.u.iter_mut().zip(&sweep.stages) {
            *u = Vector2::new(stage.u[0].lane(lane), stage.u[1].lane(lane));
            let gain = SMatrix::from_fn(|i, j| stage.gain[i][j].lane(lane));
            self.solution.gains.push(gain);
        }
        let mut model = Model::zero();
        model.set_lane(0, &problem.model);
        if !is_converged {
            let limit = problem.turn_limit.unwrap_or(f64::INFINITY);
            for k in 0..stages {
                let x: [f64; NX] = point.x[k].into();
                let mut u: [f64; 2] = point.u[k].into();
                let (min, max) = (problem.u_min[k][1], problem.u_max[k][1]);
                let (least, most, _) = roll_bounds(limit, min, max, &x, &u);
                u[1] = u[1].max(least).min(most);
                point.u[k] = u.into();
                point.x[k + 1] = model.step(&x, &u).into();
            }
        }
        if is_measured {
            point.u[stages] = last;
            self.solution.gains.push(SMatrix::zeros());
            let (x, u) = (point.x[stages].into(), last.into());
            point.x[stages + 1] = model.step::<NX>(&x, &u).into();
        }
        if !is_converged {
            cost = subproblem::cost(problem, point);
        }
        self.solution.status = if is_converged {
            Status::Solved
        } else {
            Status::MaxIterations
        };
        self.solution.method = Method::Riccati;
        self.solution.path = Path::Fast;
        self.solution.iterations = iteration;
        self.solution.cost = cost;
        self.write_point(problem);
        self.shifted = 0;
        self.is_adopted = false;
        true
    }
}

impl<const NX: usize> Head<NX> {
    /// Of no robot.
    fn nothing() -> Self {
        Self {
            is_good: false,
            x: [0.0; NX],
            turns: 0.0,
            known: 0,
            first_row: 0,
            model: Model::zero(),
        }
    }
}

/// Whether bounds [m/s, rad] are numbers in the right order, and rolls.
fn are_bounds(min: &Vector2<f64>, max: &Vector2<f64>) -> bool {
    let width = max - min;
    let end = core::f64::consts::FRAC_PI_2;
    width
        .iter()
        .all(|width| (0.0..f64::INFINITY).contains(width))
        && min[1] > -end
        && max[1] < end
}

/// Iterations before the fast path gives up: ordinary ticks take two or three.
const ITERATIONS_MAX: u32 = 8;
/// A converged step, 2-norm over all states and inputs [m, rad, m/s]: the error that it leaves is of the order of its square.
const STEP: f64 = 1e-6;
/// The same where a bound follows the last iterate's speed or stopped a step: the error left is of the step's own order.
const STEP_LIMITED: f64 = 1e-9;
/// Error, extrapolated from the last two steps, that also counts as converged.
const ERROR: f64 = 1e-12;
/// Largest step, 2-norm: beyond it the last solution tells little about the next.
const STEP_MAX: f64 = 10.0;
/// A step may be so many times the one before.
const GROWTH_MAX: f64 = 2.0;
