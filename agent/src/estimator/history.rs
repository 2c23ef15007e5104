//! The last frames with the filter after each of them, so that a late position fix is fused where it belongs.

use sphere_protocol::time::{BoardClock, Instant};

use super::config::EstimatorConfig;
use super::filter::{Body, Filter, FixAt, Step};

/// One frame and what the filter knew after it.
#[derive(Clone, Debug)]
pub(super) struct Slot {
    pub(super) stamp: Instant<BoardClock>,
    pub(super) step: Step,
    /// The filter after the frame and its fix.
    pub(super) filter: Filter,
    /// The fix that was fused at this frame.
    pub(super) fix: Option<FixAt>,
}

/// A ring of the newest [`FRAMES`] slots; never empty.
#[derive(Clone, Debug)]
pub(super) struct History {
    slots: Box<[Slot]>,
    /// Slots in use, from the oldest on.
    len: usize,
    newest: usize,
}

impl History {
    /// A history that begins with `slot`.
    pub(super) fn new(slot: Slot) -> Self {
        Self {
            slots: vec![slot; FRAMES].into_boxed_slice(),
            len: 1,
            newest: 0,
        }
    }

    pub(super) fn newest(&self) -> &Slot {
        &self.slots[self.newest]
    }

    /// Appends a frame whose filter is still the one of the frame before: the caller steps it.
    pub(super) fn push(&mut self, stamp: Instant<BoardClock>, step: Step) -> &mut Slot {
        let next = (self.newest + 1) % FRAMES;
        let filter = self.newest().filter.clone();
        self.slots[next] = Slot {
            stamp,
            step,
            filter,
            fix: None,
        };
        self.newest = next;
        self.len = (self.len + 1).min(FRAMES);
        &mut self.slots[next]
    }

    /// Changes the filters of all frames alike.
    pub(super) fn for_each_filter(&mut self, mut change: impl FnMut(&mut Filter)) {
        for age in 0..self.len {
            change(&mut self.slot_mut(age).filter);
        }
    }

    /// The slot `age` frames before the newest one.
    pub(super) fn slot(&self, age: usize) -> &Slot {
        debug_assert!(age < self.len);
        &self.slots[(self.newest + FRAMES - age) % FRAMES]
    }

    pub(super) fn slot_mut(&mut self, age: usize) -> &mut Slot {
        debug_assert!(age < self.len);
        &mut self.slots[(self.newest + FRAMES - age) % FRAMES]
    }

    /// Age of the frame nearest to `stamp`; `None` if that lies before the oldest frame.
    pub(super) fn nearest(&self, stamp: Instant<BoardClock>) -> Option<usize> {
        let older = (0..self.len).find(|&age| self.slot(age).stamp <= stamp)?;
        if older == 0 {
            return Some(0);
        }
        let after = self.slot(older - 1).stamp.since(stamp);
        let before = stamp.since(self.slot(older).stamp);
        Some(if after < before { older - 1 } else { older })
    }

    /// Runs the frames after the slot `age` again, with the fixes that were fused at them.
    ///
    /// A fix that was accepted once stays accepted: the gate had judged it when it came.
    pub(super) fn replay_after(&mut self, age: usize, body: &Body, config: &EstimatorConfig) {
        for age in (0..age).rev() {
            let mut filter = self.slot(age + 1).filter.clone();
            let slot = self.slot_mut(age);
            filter.step(&slot.step, body, config);
            if let Some(fix) = &slot.fix {
                filter.fuse_fix(fix, body.radius);
            }
            slot.filter = filter;
        }
    }
}

/// Frames kept: 0.32 s at 200 Hz, the age up to which a fix is of use.
pub(super) const FRAMES: usize = 64;
