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
        let before = self.newest;
        self.newest = (before + 1) % FRAMES;
        self.len = (self.len + 1).min(FRAMES);
        let (slot, before) = self.neighbours(self.newest, before);
        (slot.stamp, slot.step, slot.fix) = (stamp, step, None);
        slot.filter = before.filter;
        slot
    }

    /// Changes the filters of all frames alike.
    pub(super) fn for_each_filter(&mut self, mut change: impl FnMut(&mut Filter)) {
        for age in 0..self.len {
            change(&mut self.slot_mut(age).filter);
        }
    }

    /// The slot `age` frames before the newest one.
    pub(super) fn slot(&self, age: usize) -> &Slot {
        &self.slots[self.place(age)]
    }

    pub(super) fn slot_mut(&mut self, age: usize) -> &mut Slot {
        &mut self.slots[self.place(age)]
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
            let (slot, before) = self.neighbours(self.place(age), self.place(age + 1));
            slot.filter = before.filter;
            slot.filter.step(&slot.step, body, config);
            if let Some(fix) = &slot.fix {
                slot.filter.fuse_fix(fix, body.radius);
            }
        }
    }

    /// Two slots at once, by their different places.
    fn neighbours(&mut self, one: usize, other: usize) -> (&mut Slot, &Slot) {
        let slots = self.slots.get_disjoint_mut([one, other]);
        let [one, other] = slots.expect("the ring has more than one place");
        (one, other)
    }

    /// Where the slot `age` frames before the newest one is.
    fn place(&self, age: usize) -> usize {
        debug_assert!(age < self.len);
        (self.newest + FRAMES - age) % FRAMES
    }
}

/// Frames kept: 0.32 s at 200 Hz, the age up to which a fix is of use.
pub(super) const FRAMES: usize = 64;
