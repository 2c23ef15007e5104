//! Many runs on every core. Each is deterministic by itself, and results come in the order of the jobs: whoever adds them up gets the
//! same bytes from one core as from sixty-four.

use std::num::NonZero;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::mpsc;
use std::thread;

/// As many threads as this machine runs at once.
pub fn every_core() -> NonZero<usize> {
    thread::available_parallelism().unwrap_or(NonZero::<usize>::MIN)
}

/// `work` of every job, in the order of `jobs`, on `threads` threads that take the next job when they are done with one.
///
/// `done` is called on the caller's thread after each job, in whatever order they end, with how many have ended. A panic in `work` is
/// passed on when the other threads have stopped.
pub fn map<J: Sync, R: Send>(
    jobs: &[J],
    threads: NonZero<usize>,
    work: impl Fn(&J) -> R + Sync,
    mut done: impl FnMut(usize),
) -> Vec<R> {
    let next = AtomicUsize::new(0);
    let mut results: Vec<Option<R>> = jobs.iter().map(|_| None).collect();
    thread::scope(|scope| {
        let (sender, finished) = mpsc::channel();
        for _ in 0..threads.get().min(jobs.len()) {
            let (sender, next, work) = (sender.clone(), &next, &work);
            scope.spawn(move || {
                loop {
                    let index = next.fetch_add(1, Ordering::Relaxed);
                    let Some(job) = jobs.get(index) else { return };
                    if sender.send((index, work(job))).is_err() {
                        return;
                    }
                }
            });
        }
        drop(sender);
        for (count, (index, result)) in finished.iter().enumerate() {
            results[index] = Some(result);
            done(count + 1);
        }
    });
    let every = "a scope ends when every thread has, and passes their panics on";
    results
        .into_iter()
        .map(|result| result.expect(every))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn threads(count: usize) -> NonZero<usize> {
        NonZero::new(count).expect("more than none")
    }

    #[test]
    fn results_come_in_the_order_of_the_jobs_on_any_number_of_threads() {
        let jobs: Vec<u64> = (0..200).collect();
        // The first jobs take longest: they end last.
        let work = |job: &u64| (0..(200 - job) * 1000).fold(*job, |sum, i| sum ^ i.rotate_left(7));
        let alone: Vec<u64> = jobs.iter().map(work).collect();
        for count in [1, 2, 3, 16, 500] {
            assert_eq!(map(&jobs, threads(count), work, |_| {}), alone, "{count}");
        }
    }

    #[test]
    fn every_job_is_reported_once() {
        let mut counts = Vec::new();
        map(&[(); 7], threads(3), |()| {}, |count| counts.push(count));
        assert_eq!(counts, [1, 2, 3, 4, 5, 6, 7]);
        let nothing: Vec<()> = map(&[] as &[()], threads(3), |()| {}, |_| panic!("no job"));
        assert!(nothing.is_empty());
    }

    #[test]
    fn a_panic_of_one_job_is_passed_on() {
        let result = std::panic::catch_unwind(|| {
            map(
                &[1, 2, 3],
                threads(2),
                |job| assert!(*job != 2, "the second"),
                |_| {},
            )
        });
        assert!(result.is_err());
    }
}
