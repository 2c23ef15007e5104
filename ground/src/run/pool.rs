//! Planning threads.

use std::cell::RefCell;
use std::num::NonZero;
use std::thread;

use rayon::prelude::*;
use rayon::{ThreadPool, ThreadPoolBuildError, ThreadPoolBuilder};
use sphere_protocol::io::clock::Clock;
use sphere_protocol::time::{GroundClock, Span};

use crate::planner::PlanBatch;
use crate::session::Job;
use crate::workload::Workers;

/// Plans a batch on several threads, and says how long it took.
pub struct Pool {
    threads: ThreadPool,
    clock: Clock<GroundClock>,
}

impl Pool {
    /// With `threads` threads; without, one for every core but one, which is left to messages and to the network.
    ///
    /// # Errors
    /// The system refuses a thread.
    pub fn new(threads: Option<NonZero<usize>>) -> Result<Self, ThreadPoolBuildError> {
        let threads = threads.map_or_else(every_core_but_one, NonZero::get);
        let threads = ThreadPoolBuilder::new()
            .num_threads(threads)
            .thread_name(|i| format!("planning-{i}"))
            .build()?;
        Ok(Self {
            threads,
            clock: Clock::start(),
        })
    }
}

impl Workers for Pool {
    fn run(&mut self, jobs: &mut [Job<'_>]) -> Span {
        let begin = self.clock.now();
        let share = jobs.len().div_ceil(self.threads.current_num_threads());
        // Waking a thread costs more than a few plans.
        let share = share.next_multiple_of(TOGETHER);
        if jobs.len() <= share {
            plan(jobs);
        } else {
            self.threads
                .install(|| jobs.par_chunks_mut(share).for_each(plan));
        }
        self.clock.now() - begin
    }
}

thread_local! {
    static BATCH: RefCell<PlanBatch> = RefCell::new(PlanBatch::new());
}

fn plan(jobs: &mut [Job<'_>]) {
    BATCH.with_borrow_mut(|batch| Job::run_all(jobs, batch));
}

fn every_core_but_one() -> usize {
    let cores = thread::available_parallelism().map_or(1, NonZero::get);
    (cores - 1).max(1)
}

/// Robots that a thread plans for together: as many as the planner solves at once.
const TOGETHER: usize = 8;
