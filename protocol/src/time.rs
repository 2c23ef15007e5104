//! Time: instants that name their clock, and signed spans between them.
//!
//! An agent, the ground station and a motor board each count nanoseconds from an origin of their own. An instant of one clock
//! cannot be compared with, or subtracted from, an instant of another: that does not compile. No two clocks of the fleet are
//! ever synchronised.

use core::fmt;
use core::marker::PhantomData;
use core::ops::{Add, AddAssign, Neg, Sub};

/// A point in time of clock `C`, in nanoseconds since that clock's own origin.
///
/// Instants of two clocks do not mix:
///
/// ```compile_fail
/// use sphere_protocol::time::{AgentClock, GroundClock, Instant};
/// let on_board = Instant::<AgentClock>::from_nanos(1);
/// let at_the_station = Instant::<GroundClock>::from_nanos(2);
/// let nonsense = at_the_station - on_board;
/// ```
///
/// Those of one clock do:
///
/// ```
/// use sphere_protocol::time::{AgentClock, Instant, Span};
/// let start = Instant::<AgentClock>::from_nanos(0);
/// assert_eq!((start + Span::from_millis(20)) - start, Span::from_secs_f64(0.02));
/// ```
pub struct Instant<C> {
    ns: i64,
    clock: PhantomData<fn() -> C>,
}

/// The clock of one robot's onboard agent. Plans are stamped in it.
pub enum AgentClock {}
/// The clock of the ground station.
pub enum GroundClock {}
/// The clock of one robot's motor board. Sensor frames and position fixes are stamped in it.
pub enum BoardClock {}

/// A signed length of time [ns inside, seconds outside].
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Default, Hash)]
pub struct Span {
    ns: i64,
}

impl<C> Instant<C> {
    /// The instant `ns` nanoseconds after the clock's origin.
    pub const fn from_nanos(ns: i64) -> Self {
        Self {
            ns,
            clock: PhantomData,
        }
    }

    /// Nanoseconds since the clock's origin, as they travel on the wire.
    pub const fn as_nanos(self) -> i64 {
        self.ns
    }

    /// `self - earlier`, saturating: a hostile stamp may be anywhere.
    pub const fn since(self, earlier: Self) -> Span {
        Span {
            ns: self.ns.saturating_sub(earlier.ns),
        }
    }
}

impl Span {
    /// No time at all.
    pub const ZERO: Self = Self { ns: 0 };

    /// A span of `ns` nanoseconds.
    pub const fn from_nanos(ns: i64) -> Self {
        Self { ns }
    }

    /// A span of `ms` milliseconds.
    pub const fn from_millis(ms: i64) -> Self {
        Self {
            ns: ms.saturating_mul(1_000_000),
        }
    }

    /// A span of `s` seconds, rounded to the nearest nanosecond; NaN gives zero, the infinities saturate.
    pub fn from_secs_f64(s: f64) -> Self {
        Self {
            ns: (s * 1e9).round() as i64,
        }
    }

    /// This span in nanoseconds.
    pub const fn as_nanos(self) -> i64 {
        self.ns
    }

    /// This span in seconds.
    pub fn as_secs_f64(self) -> f64 {
        self.ns as f64 * 1e-9
    }
}

impl<C> Add<Span> for Instant<C> {
    type Output = Self;
    fn add(self, span: Span) -> Self {
        Self::from_nanos(self.ns.saturating_add(span.ns))
    }
}

impl<C> AddAssign<Span> for Instant<C> {
    fn add_assign(&mut self, span: Span) {
        *self = *self + span;
    }
}

impl<C> Sub<Span> for Instant<C> {
    type Output = Self;
    fn sub(self, span: Span) -> Self {
        Self::from_nanos(self.ns.saturating_sub(span.ns))
    }
}

impl<C> Sub for Instant<C> {
    type Output = Span;
    fn sub(self, earlier: Self) -> Span {
        self.since(earlier)
    }
}

impl Add for Span {
    type Output = Self;
    fn add(self, other: Self) -> Self {
        Self {
            ns: self.ns.saturating_add(other.ns),
        }
    }
}

impl Sub for Span {
    type Output = Self;
    fn sub(self, other: Self) -> Self {
        Self {
            ns: self.ns.saturating_sub(other.ns),
        }
    }
}

impl Neg for Span {
    type Output = Self;
    fn neg(self) -> Self {
        Self {
            ns: self.ns.saturating_neg(),
        }
    }
}

// Written by hand: a derive would ask the same of the clock, which has no values.
impl<C> Clone for Instant<C> {
    fn clone(&self) -> Self {
        *self
    }
}
impl<C> Copy for Instant<C> {}
impl<C> PartialEq for Instant<C> {
    fn eq(&self, other: &Self) -> bool {
        self.ns == other.ns
    }
}
impl<C> Eq for Instant<C> {}
impl<C> PartialOrd for Instant<C> {
    fn partial_cmp(&self, other: &Self) -> Option<core::cmp::Ordering> {
        Some(self.cmp(other))
    }
}
impl<C> Ord for Instant<C> {
    fn cmp(&self, other: &Self) -> core::cmp::Ordering {
        self.ns.cmp(&other.ns)
    }
}
impl<C> fmt::Debug for Instant<C> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "t={:.6}s", self.ns as f64 * 1e-9)
    }
}
impl fmt::Debug for Span {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:.6}s", self.as_secs_f64())
    }
}
