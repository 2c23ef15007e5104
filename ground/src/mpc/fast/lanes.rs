//! One number for each of several robots: the arithmetic that the fast path is written in.
//!
//! Every operation acts on each lane alone and is an IEEE operation on f64, correctly rounded: sum, product, quotient, comparison. Nothing is
//! fused and nothing is summed across lanes. So a lane's bits depend on that lane's inputs alone: not on the width, on the
//! neighbours or on the instruction set. `f64` is the width 1; the module `x86` has registers of 4 and 8.

use core::ops::{Add, Div, Mul, Neg, Sub};

/// [`Lanes::WIDTH`] numbers, each of another robot.
pub(super) trait Lanes:
    Copy
    + 'static
    + Add<Output = Self>
    + Sub<Output = Self>
    + Mul<Output = Self>
    + Div<Output = Self>
    + Neg<Output = Self>
{
    /// Number of lanes.
    const WIDTH: usize;

    /// One truth value for each lane.
    type Mask: Copy + 'static;

    /// The same number in every lane.
    fn splat(value: f64) -> Self;

    /// The number in `lane`.
    fn lane(&self, lane: usize) -> f64;

    /// Puts a number into `lane`.
    fn set_lane(&mut self, lane: usize, value: f64);

    /// Where `self` < `other`; not where either is NaN.
    fn less(self, other: Self) -> Self::Mask;

    /// `self` where `mask` holds, `other` elsewhere.
    fn or(self, mask: Self::Mask, other: Self) -> Self;

    /// Where both hold.
    fn and(a: Self::Mask, b: Self::Mask) -> Self::Mask;

    /// Where either holds.
    fn either(a: Self::Mask, b: Self::Mask) -> Self::Mask;

    /// Where `mask` does not hold.
    fn not(mask: Self::Mask) -> Self::Mask;

    /// Every lane alike.
    fn mask(value: bool) -> Self::Mask;

    /// Whether `mask` holds in `lane`.
    fn holds(mask: &Self::Mask, lane: usize) -> bool;

    /// Whether `mask` holds in any lane.
    fn any(mask: Self::Mask) -> bool;

    /// Magnitude.
    #[inline(always)]
    fn abs(self) -> Self {
        self.or(Self::splat(0.0).less(self), -self)
    }

    /// The greater one; `other` if they are equal or not comparable.
    #[inline(always)]
    fn greater(self, other: Self) -> Self {
        self.or(other.less(self), other)
    }

    /// The lesser one; `other` if they are equal or not comparable.
    #[inline(always)]
    fn lesser(self, other: Self) -> Self {
        self.or(self.less(other), other)
    }
}

impl Lanes for f64 {
    const WIDTH: usize = 1;
    type Mask = bool;

    #[inline(always)]
    fn splat(value: f64) -> Self {
        value
    }

    #[inline(always)]
    fn lane(&self, _lane: usize) -> f64 {
        *self
    }

    #[inline(always)]
    fn set_lane(&mut self, _lane: usize, value: f64) {
        *self = value;
    }

    #[inline(always)]
    fn less(self, other: Self) -> bool {
        self < other
    }

    #[inline(always)]
    fn or(self, mask: bool, other: Self) -> Self {
        if mask { self } else { other }
    }

    #[inline(always)]
    fn and(a: bool, b: bool) -> bool {
        a & b
    }

    #[inline(always)]
    fn either(a: bool, b: bool) -> bool {
        a | b
    }

    #[inline(always)]
    fn not(mask: bool) -> bool {
        !mask
    }

    #[inline(always)]
    fn mask(value: bool) -> bool {
        value
    }

    #[inline(always)]
    fn holds(mask: &bool, _lane: usize) -> bool {
        *mask
    }

    #[inline(always)]
    fn any(mask: bool) -> bool {
        mask
    }
}

/// Most lanes of any register.
pub(super) const LANES_MAX: usize = 8;
