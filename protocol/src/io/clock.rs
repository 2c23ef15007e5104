//! This process's clock as a typed one.

use std::marker::PhantomData;
use std::time::{Duration, Instant as Monotonic};

use crate::time::{Instant, Span};

/// A monotonic clock that counts from its creation, as clock `C`.
pub struct Clock<C> {
    origin: Monotonic,
    clock: PhantomData<fn() -> C>,
}

impl<C> Clock<C> {
    /// A clock that begins now.
    #[allow(
        clippy::disallowed_methods,
        reason = "this is where the cores' time comes from"
    )]
    pub fn start() -> Self {
        Self {
            origin: Monotonic::now(),
            clock: PhantomData,
        }
    }

    /// Now.
    #[allow(
        clippy::disallowed_methods,
        reason = "this is where the cores' time comes from"
    )]
    pub fn now(&self) -> Instant<C> {
        let elapsed = Monotonic::now() - self.origin;
        Instant::from_nanos(i64::try_from(elapsed.as_nanos()).unwrap_or(i64::MAX))
    }

    /// How long until `due`; zero if it has passed.
    pub fn until(&self, due: Instant<C>) -> Duration {
        let span: Span = due - self.now();
        Duration::from_nanos(u64::try_from(span.as_nanos()).unwrap_or(0))
    }

    /// `due` on the machine's own clock, to sleep until.
    pub fn deadline(&self, due: Instant<C>) -> Monotonic {
        self.origin + Duration::from_nanos(u64::try_from(due.as_nanos()).unwrap_or(0))
    }
}

// Written by hand: a derive would ask the same of the clock's name, which has no values.
impl<C> Clone for Clock<C> {
    fn clone(&self) -> Self {
        *self
    }
}
impl<C> Copy for Clock<C> {}
impl<C> std::fmt::Debug for Clock<C> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "Clock({:?})", self.now())
    }
}
