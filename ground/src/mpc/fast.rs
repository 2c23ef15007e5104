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

use arrayvec::ArrayVec;
use nalgebra::{SMatrix, SVector, Vector2};

pub use self::batch::{Batch, Tick};
pub use self::isa::InstructionSet;
use self::isa::{Engine, drive_alone};
use self::knot::Model;
use self::lanes::{LANES_MAX, Lanes};
use self::sweep::{Outcome, Sweep};
use super::problem::{FirstInput, Problem};
use super::solution::{Method, Path, Status};
use super::{Effort, Mpc, Solver};

/// Scratch space of one robot alone.
pub(super) struct Alone<const NX: usize>(Sweep<f64, NX>);

/// What one lane is doing.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Lane {
    /// Iterating; the square of its last step.
    Running(f64),
    /// At its end; whether it converged.
    Ending(bool),
    /// Handed over.
    Done,
    /// For `sqp` to solve, after so many iterations.
    Left(u32),
}

/// What the stages of one lane are loaded from.
struct Source<'a, const NX: usize> {
    x_ref: &'a [SVector<f64, NX>],
    u_ref: &'a [Vector2<f64>],
    lower: &'a [Vector2<f64>],
    upper: &'a [Vector2<f64>],
    /// The last solution from where the problem begins: states at the stages' ends, inputs. At least one each; the last one stands
    /// for those after it.
    x: &'a [SVector<f64, NX>],
    u: &'a [Vector2<f64>],
}

/// Where the stages of one lane go.
struct Place<'a, const NX: usize> {
    lane: usize,
    x: &'a mut [SVector<f64, NX>],
    u: &'a mut [Vector2<f64>],
    gains: &'a mut [SMatrix<f64, 2, NX>],
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
    sweep.is_measured = first.problem.first_input == FirstInput::Measured;
    load(sweep, ticks);
    let is_good = engine.start(sweep);
    let mut lanes = [Lane::Done; LANES_MAX];
    for (lane, state) in lanes.iter_mut().enumerate().take(ticks.len()) {
        *state = if E::Lanes::holds(&is_good, lane) {
            Lane::Running(f64::INFINITY)
        } else {
            Lane::Left(0)
        };
    }
    for iteration in 1..=ITERATIONS_MAX {
        if !lanes.iter().any(|lane| matches!(lane, Lane::Running(_))) {
            break;
        }
        let outcome = engine.iterate(sweep);
        let (mut is_end, mut is_settled) = (false, true);
        for (lane, tick) in ticks.iter().enumerate() {
            if let Lane::Running(before) = lanes[lane] {
                let is_last = tick.mpc.options.effort == Effort::RealTime;
                lanes[lane] = after(&outcome, lane, before, iteration, is_last);
            }
            is_end |= matches!(lanes[lane], Lane::Ending(_));
            is_settled &= lanes[lane] != Lane::Ending(false);
        }
        if !is_end {
            continue;
        }
        if !is_settled {
            for (lane, state) in lanes.iter().enumerate().take(E::Lanes::WIDTH) {
                let is_open = f64::from(u8::from(*state == Lane::Ending(false)));
                sweep.is_open.set_lane(lane, is_open);
            }
            engine.settle(sweep);
        }
        let costs = engine.cost(sweep);
        hand_over(sweep, ticks, &mut lanes, &costs, iteration);
    }
    for (tick, lane) in ticks.iter_mut().zip(lanes) {
        if let Lane::Left(iterations) = lane {
            tick.mpc.search(tick.problem, iterations);
        }
    }
}

/// What a lane does after `iteration`, the square of whose last step was `before`.
fn after<L: Lanes>(
    outcome: &Outcome<L>,
    lane: usize,
    before: f64,
    iteration: u32,
    is_last: bool,
) -> Lane {
    let size2 = outcome.size2.lane(lane);
    let is_limited = L::holds(&outcome.is_limited, lane);
    let tolerance = if is_limited { STEP_LIMITED } else { STEP };
    // Two steps tell the rate e⁺ = C e² and so the error that the second one leaves.
    let is_near =
        iteration > 1 && !is_limited && size2 * size2 * size2 <= before * before * (ERROR * ERROR);
    let is_converged = size2 <= tolerance * tolerance || is_near;
    // Written so that NaN leaves too.
    let is_good = L::holds(&outcome.is_sound, lane)
        && size2 <= STEP_MAX * STEP_MAX
        && size2 <= GROWTH_MAX * GROWTH_MAX * before;
    if !is_good {
        Lane::Left(iteration)
    } else if is_converged || is_last {
        Lane::Ending(is_converged)
    } else if iteration == ITERATIONS_MAX {
        Lane::Left(iteration)
    } else {
        Lane::Running(size2)
    }
}

/// Puts the problems and last solutions of `ticks` into `sweep`.
fn load<L: Lanes, const NX: usize>(sweep: &mut Sweep<L, NX>, ticks: &[Tick<'_, NX>]) {
    let mut sources = ArrayVec::<Source<'_, NX>, LANES_MAX>::new();
    for lane in 0..L::WIDTH {
        // Idle lanes compute the first robot's plan once more.
        let tick = ticks.get(lane).unwrap_or(&ticks[0]);
        sources.push(tick.mpc.load_head(sweep, lane, tick.problem));
    }
    // Stage by stage, so that each line of the scratch space is written at once.
    let ends = &mut sweep.x[1..];
    for (k, (stage, end)) in sweep.stages.iter_mut().zip(ends).enumerate() {
        for (lane, from) in sources.iter().enumerate().take(L::WIDTH) {
            let u = &from.u[k.min(from.u.len() - 1)];
            let x = &from.x[k.min(from.x.len() - 1)];
            let (x_ref, u_ref) = (&from.x_ref[k], &from.u_ref[k]);
            let (lower, upper) = (&from.lower[k], &from.upper[k]);
            for j in 0..2 {
                stage.u[j].set_lane(lane, u[j]);
                stage.u_ref[j].set_lane(lane, u_ref[j]);
                stage.lower[j].set_lane(lane, lower[j]);
                stage.upper[j].set_lane(lane, upper[j]);
            }
            for j in 0..NX {
                stage.x_ref[j].set_lane(lane, x_ref[j]);
                end[j].set_lane(lane, x[j]);
            }
        }
    }
}

/// Makes the lanes that are at their end the solutions of their robots. One whose cost is not finite leaves the path.
fn hand_over<L: Lanes, const NX: usize>(
    sweep: &Sweep<L, NX>,
    ticks: &mut [Tick<'_, NX>],
    lanes: &mut [Lane; LANES_MAX],
    costs: &L,
    iteration: u32,
) {
    let mut places = ArrayVec::<Place<'_, NX>, LANES_MAX>::new();
    for (lane, tick) in ticks.iter_mut().enumerate() {
        let Lane::Ending(is_converged) = lanes[lane] else {
            continue;
        };
        let cost = costs.lane(lane) + tick.mpc.cost_before(sweep, lane, tick.problem);
        // The cost has every number of the references and weights in it.
        if !cost.is_finite() {
            lanes[lane] = Lane::Left(iteration);
            continue;
        }
        lanes[lane] = Lane::Done;
        let solution = &mut tick.mpc.solution;
        solution.status = if is_converged {
            Status::Solved
        } else {
            Status::MaxIterations
        };
        solution.iterations = iteration;
        solution.cost = cost;
        places.push(tick.mpc.place(sweep, lane, tick.problem));
    }
    for (k, stage) in sweep.stages.iter().enumerate() {
        for place in &mut places {
            let lane = place.lane;
            place.x[k] = SVector::from(sweep.x[k + 1].map(|x| x.lane(lane)));
            place.u[k] = Vector2::new(stage.u[0].lane(lane), stage.u[1].lane(lane));
            place.gains[k] = SMatrix::from_fn(|i, j| stage.gain[i][j].lane(lane));
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
    /// Solves `problem` alone, which [`Self::may_be_fast`].
    pub(super) fn solve_alone(&mut self, problem: &Problem<NX>) {
        let Some(robust) = &mut self.robust else {
            return self.search(problem, 0);
        };
        let mut sweep = core::mem::replace(&mut robust.alone.0, Sweep::new());
        drive_alone(&mut sweep, Tick::of_fast(self, problem));
        if let Some(robust) = &mut self.robust {
            robust.alone.0 = sweep;
        }
    }

    /// Whether the fast path may try `problem`: a solution to start from, and nothing in the problem that only `sqp` knows.
    ///
    /// Together with what [`load`] and the sweep ask it refuses all that [`Problem::validate`] refuses.
    pub(super) fn may_be_fast(&self, problem: &Problem<NX>) -> bool {
        let horizon = problem.horizon();
        let rows = [
            problem.u_ref.len(),
            problem.u_min.len(),
            problem.u_max.len(),
        ];
        let is_measured = problem.first_input == FirstInput::Measured;
        self.is_warm
            && self.options.solver != Solver::Clarabel
            && self.solution.u.len() == horizon
            && self.solution.x.len() == horizon + 1
            && stages_of(problem) > 0
            && rows == [horizon; 3]
            && !problem.couples_inputs()
            && problem.half_planes.is_empty()
            && problem.model.is_valid()
            && problem.q.iter().all(|weight| *weight >= 0.0)
            && problem.r.iter().all(|weight| *weight > 0.0)
            && problem.u_prev.iter().all(|value| value.is_finite())
            // A NaN for a limit ends here too.
            && problem
                .turn_limit
                .is_none_or(|limit| (0.0..f64::INFINITY).contains(&limit) && !is_measured)
            // The input without effect is no part of the sweep.
            && (!is_measured
                || are_bounds(&problem.u_min[horizon - 1], &problem.u_max[horizon - 1]))
    }

    /// Puts what all stages of `problem` share into `lane` of `sweep`. Returns where the rest stands.
    #[inline(always)]
    fn load_head<'a, L: Lanes>(
        &'a self,
        sweep: &mut Sweep<L, NX>,
        lane: usize,
        problem: &'a Problem<NX>,
    ) -> Source<'a, NX> {
        let (horizon, stages) = (problem.horizon(), stages_of(problem));
        let first_row = horizon - stages;
        sweep.model.set_lane(lane, &problem.model);
        for j in 0..NX {
            sweep.given[j].set_lane(lane, problem.x0[j]);
            sweep.weight[j].set_lane(lane, 2.0 * problem.q[j]);
            for i in 0..NX {
                sweep.p[i][j].set_lane(lane, problem.p_terminal[(i, j)]);
            }
        }
        for j in 0..2 {
            sweep.u_prev[j].set_lane(lane, problem.u_prev[j]);
            sweep.input_weight[j].set_lane(lane, 2.0 * problem.r[j]);
        }
        let limit = problem.turn_limit.unwrap_or(f64::INFINITY);
        sweep.turn_limit.set_lane(lane, limit);
        let shifted = self.shifted.min(stages);
        sweep.known.set_lane(lane, (stages - shifted) as f64);
        let (x, u) = (&self.solution.x, &self.solution.u);
        let begin = first_row + shifted;
        sweep.heading.set_lane(lane, x[begin][2]);
        Source {
            x_ref: &problem.x_ref[first_row..],
            u_ref: &problem.u_ref,
            lower: &problem.u_min,
            upper: &problem.u_max,
            x: &x[(begin + 1).min(horizon)..],
            u: &u[self.shifted.min(horizon - 1)..],
        }
    }

    /// Cost of what a measured first input leaves outside the sweep: the first state, the input without effect.
    fn cost_before<L: Lanes>(
        &self,
        sweep: &Sweep<L, NX>,
        lane: usize,
        problem: &Problem<NX>,
    ) -> f64 {
        if problem.first_input == FirstInput::Decided {
            return 0.0;
        }
        let error = SVector::from(sweep.x[0].map(|x| x.lane(lane))) - problem.x_ref[0];
        let miss = last_input(problem) - problem.u_ref[problem.horizon() - 1];
        error.component_mul(&error).dot(&problem.q) + miss.component_mul(&miss).dot(&problem.r)
    }

    /// Makes room for a solution from the fast path and writes what the sweep has not. Returns where its stages go.
    fn place<L: Lanes>(
        &mut self,
        sweep: &Sweep<L, NX>,
        lane: usize,
        problem: &Problem<NX>,
    ) -> Place<'_, NX> {
        let (horizon, stages) = (problem.horizon(), stages_of(problem));
        self.shifted = 0;
        self.is_adopted = false;
        let solution = &mut self.solution;
        solution.method = Method::Riccati;
        solution.path = Path::Fast;
        solution.refusal = None;
        solution.gains.resize(horizon, SMatrix::zeros());
        solution.x[0] = problem.x0;
        let first_row = horizon - stages;
        solution.x[first_row] = SVector::from(sweep.x[0].map(|x| x.lane(lane)));
        if first_row > 0 {
            solution.u[stages] = last_input(problem);
            solution.gains[stages] = SMatrix::zeros();
        }
        Place {
            lane,
            x: &mut solution.x[first_row + 1..],
            u: &mut solution.u,
            gains: &mut solution.gains,
        }
    }
}

/// The last decided input of a problem with a measured first one: it moves no state that counts.
fn last_input<const NX: usize>(problem: &Problem<NX>) -> Vector2<f64> {
    let last = problem.horizon() - 1;
    problem.u_ref[last].zip_zip_map(&problem.u_min[last], &problem.u_max[last], |u, min, max| {
        u.max(min).min(max)
    })
}

/// State at the end of a knot that begins at `x` and holds `u`, as the fast path computes it.
pub(super) fn step<const NX: usize>(
    problem: &Problem<NX>,
    x: &SVector<f64, NX>,
    u: &Vector2<f64>,
) -> SVector<f64, NX> {
    let mut model = Model::zero();
    model.set_lane(0, &problem.model);
    model.step::<NX>(&(*x).into(), &(*u).into()).into()
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
