//! Many robots' ticks at once.

use super::isa::{InstructionSet, Wide, prefetch};
use crate::mpc::{FirstInput, Mpc, Problem};

/// One robot's tick in a [`Batch`].
pub struct Tick<'a, const NX: usize> {
    pub(super) mpc: &'a mut Mpc<NX>,
    pub(super) problem: &'a Problem<NX>,
    shape: Shape,
}

/// Solves many robots' problems, as many at a time as the machine's registers have lanes (eight with AVX-512, four with AVX2).
///
/// Every solution is the one that [`Mpc::solve`] would have found, bit for bit, whatever the company, the order and the machine's
/// instruction set. Robots whose problem leaves the fast path are solved one by one. Keep one for each thread: it is scratch space,
/// allocated for the longest horizon so far, and remembers nothing.
pub struct Batch<const NX: usize> {
    wide: Wide<NX>,
}

impl<const NX: usize> Batch<NX> {
    /// With the widest instructions of this machine.
    pub fn new() -> Self {
        Self::with_instructions(InstructionSet::widest())
    }

    /// With chosen instructions: for tests that they do not matter.
    pub fn with_instructions(instructions: InstructionSet) -> Self {
        Self {
            wide: Wide::new(instructions),
        }
    }

    /// Solves `ticks`. Their order becomes another.
    ///
    /// Allocates nothing but room for a horizon that is longer than any before, and what [`Mpc::solve`] does.
    pub fn solve(&mut self, ticks: &mut [Tick<'_, NX>]) {
        ticks.sort_unstable_by_key(|tick| tick.shape);
        let mut rest = ticks;
        while let Some(first) = rest.first() {
            let shape = first.shape;
            let alike = rest.iter().take_while(|tick| tick.shape == shape).count();
            let (group, others) = core::mem::take(&mut rest).split_at_mut(alike);
            rest = others;
            let mut ahead = &mut *group;
            while !ahead.is_empty() {
                let width = self.wide.width().min(ahead.len());
                let (chunk, later) = ahead.split_at_mut(width);
                // What the next ones read and write is on its way while these are computed.
                for tick in later.iter().take(self.wide.width()) {
                    tick.prefetch();
                }
                ahead = later;
                if shape.is_fast && chunk.len() >= LANES_MIN {
                    self.wide.drive(chunk);
                } else {
                    for tick in chunk {
                        tick.mpc.solve_prepared(tick.problem);
                    }
                }
            }
        }
    }
}

impl<const NX: usize> Default for Batch<NX> {
    fn default() -> Self {
        Self::new()
    }
}

/// What ticks must have in common to share lanes.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
struct Shape {
    is_fast: bool,
    is_measured: bool,
    horizon: usize,
}

impl<'a, const NX: usize> Tick<'a, NX> {
    /// Brings what the fast path reads and writes into the cache.
    fn prefetch(&self) {
        let (problem, solution) = (self.problem, &self.mpc.solution);
        prefetch(&solution.x);
        prefetch(&solution.u);
        prefetch(&solution.gains);
        prefetch(&problem.x_ref);
        prefetch(&problem.u_ref);
        prefetch(&problem.u_min);
        prefetch(&problem.u_max);
    }

    /// Of a solver and problem that may be fast.
    pub(super) fn of_fast(mpc: &'a mut Mpc<NX>, problem: &'a Problem<NX>) -> Self {
        let shape = Shape {
            is_fast: true,
            is_measured: problem.first_input == FirstInput::Measured,
            horizon: problem.horizon(),
        };
        Self {
            mpc,
            problem,
            shape,
        }
    }

    /// Of a solver that is shifted already, with its last solution; the new one is [`Mpc::solution`].
    pub fn new(mpc: &'a mut Mpc<NX>, problem: &'a Problem<NX>) -> Self {
        mpc.prepare(problem);
        let shape = Shape {
            is_fast: mpc.may_be_fast(problem),
            is_measured: problem.first_input == FirstInput::Measured,
            horizon: problem.horizon(),
        };
        Self {
            mpc,
            problem,
            shape,
        }
    }
}

/// Fewer robots than this are faster one by one.
const LANES_MIN: usize = 2;
