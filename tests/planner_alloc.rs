//! A solve by Riccati sweeps allocates nothing: the planning thread's time does not depend on the allocator.

#![allow(
    unsafe_code,
    reason = "a global allocator that counts can be written no other way"
)]

#[path = "support/tracking.rs"]
mod tracking;

use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;

use nalgebra::{Vector2, Vector5};
use sphere_ground::mpc::{Batch, HalfPlane, Mpc, Options, Path, Status, Tick, terminal_weight};
use tracking::{ALL, Trajectory, centre, paper};

/// The system's allocator, counting the calls of each thread.
struct Counting;

thread_local! {
    static ALLOCATIONS: Cell<usize> = const { Cell::new(0) };
}

// SAFETY: every call is passed on unchanged.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        ALLOCATIONS.set(ALLOCATIONS.get() + 1);
        // SAFETY: as promised by the caller.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        // SAFETY: as promised by the caller.
        unsafe { System.dealloc(pointer, layout) }
    }

    unsafe fn realloc(&self, pointer: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        ALLOCATIONS.set(ALLOCATIONS.get() + 1);
        // SAFETY: as promised by the caller.
        unsafe { System.realloc(pointer, layout, size) }
    }
}

#[global_allocator]
static COUNTING: Counting = Counting;

fn allocations_in(work: impl FnOnce()) -> usize {
    let before = ALLOCATIONS.get();
    work();
    ALLOCATIONS.get() - before
}

#[test]
fn counter_counts() {
    assert!(allocations_in(|| drop(std::hint::black_box(vec![1_u8; 100]))) > 0);
}

/// First tick, warm ticks, far starts, half-planes, turn limit, refused and reset: not one allocation after the first search.
#[test]
fn solve_allocates_nothing() {
    let mut mpc = Mpc::new(20, Options::default());
    let mut x = Vector5::new(1.4, -1.3, -0.4, 0.0, 0.0);
    for tick in 0..100 {
        let mut problem = centre(ALL[tick % 3], 0.1 * tick as f64, x.into());
        problem.turn_limit = Some(0.3);
        for i in 0..20 {
            let plane = HalfPlane {
                normal: [0.0, 1.0],
                offset: -0.5,
                weight: 500.0,
            };
            assert!(problem.add_half_plane(i, plane));
        }
        let count = allocations_in(|| {
            mpc.shift(1);
            assert_eq!(mpc.solve(&problem).status, Status::Solved);
        });
        // The first search makes room for all later ones.
        assert_eq!(count > 0, tick == 0, "tick {tick}: {count}");
        x = problem.model.step(&x, &mpc.solution().u[0]);
    }
    let mut problem = centre(Trajectory::Sine, 0.0, x.into());
    problem.x0[0] = f64::NAN;
    let count = allocations_in(|| {
        assert_eq!(mpc.solve(&problem).status, Status::Refused);
        mpc.reset();
    });
    assert_eq!(count, 0, "refused");
}

#[test]
fn solve_of_the_papers_problem_allocates_nothing() {
    let mut mpc = Mpc::new(10, Options::default());
    for tick in 0..50 {
        let problem = paper(
            Trajectory::Lemniscate,
            0.1 * f64::from(tick),
            [0.5, -0.4, 0.2],
            Vector2::new(0.3, 0.0),
        );
        let count = allocations_in(|| {
            mpc.shift(1);
            assert_eq!(mpc.solve(&problem).status, Status::Solved);
        });
        // The first search makes room for all later ones.
        assert_eq!(count > 0, tick == 0, "tick {tick}: {count}");
    }
}

/// A batch, once it has room for its horizon.
#[test]
fn batch_allocates_nothing() {
    let mut mpcs: Vec<_> = (0..13).map(|_| Mpc::new(20, Options::default())).collect();
    let mut batch = Batch::new();
    for tick in 0..5 {
        let problems: Vec<_> = (0..mpcs.len())
            .map(|i| {
                let time = f64::from(tick) * 0.1 + i as f64;
                let (pose, u) = ALL[i % 3].at(time);
                centre(ALL[i % 3], time, [pose[0], pose[1], pose[2], u[0], u[1]])
            })
            .collect();
        for mpc in &mut mpcs {
            mpc.shift(1);
        }
        let mut ticks: Vec<_> = mpcs
            .iter_mut()
            .zip(&problems)
            .map(|(mpc, problem)| Tick::new(mpc, problem))
            .collect();
        let count = allocations_in(|| batch.solve(&mut ticks));
        drop(ticks);
        if tick > 1 {
            assert!(mpcs.iter().all(|mpc| mpc.solution().path == Path::Fast));
            assert_eq!(count, 0, "tick {tick}");
        }
    }
}

#[test]
fn terminal_weight_allocates_nothing() {
    let problem = centre(Trajectory::Sine, 0.0, [0.0; 5]);
    let count = allocations_in(|| {
        std::hint::black_box(terminal_weight(
            &problem.model,
            &problem.x_ref[19],
            &problem.u_ref[19],
            &problem.q,
            &problem.r,
        ));
    });
    assert_eq!(count, 0);
}
