//! Which vector instructions a batch is computed with. They change its speed and not a bit of its results.

#![allow(
    unsafe_code,
    reason = "calling functions that are compiled for instructions which this machine was asked for"
)]

use core::any::Any;

use super::batch::Tick;
use super::drive;
use super::lanes::Lanes;
use super::sweep::{Outcome, Sweep};
#[cfg(target_arch = "x86_64")]
use super::x86::{Avx2, Avx512};

/// Vector instructions that this machine has.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct InstructionSet(Set);

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Set {
    Baseline,
    #[cfg(target_arch = "x86_64")]
    Avx2,
    #[cfg(target_arch = "x86_64")]
    Avx512,
}

impl InstructionSet {
    /// What every machine of the target has: one robot at a time.
    pub const BASELINE: Self = Self(Set::Baseline);

    /// All that this machine has, the widest last.
    pub fn available() -> impl Iterator<Item = Self> {
        [
            Some(Self::BASELINE),
            #[cfg(target_arch = "x86_64")]
            is_x86_feature_detected!("avx2").then_some(Self(Set::Avx2)),
            #[cfg(target_arch = "x86_64")]
            (is_x86_feature_detected!("avx512f")
                && is_x86_feature_detected!("avx512dq")
                && is_x86_feature_detected!("avx2"))
            .then_some(Self(Set::Avx512)),
        ]
        .into_iter()
        .flatten()
    }

    /// The widest that this machine has.
    pub fn widest() -> Self {
        Self::available().last().unwrap_or(Self::BASELINE)
    }
}

/// Scratch space for as many robots as an instruction set takes at a time.
#[expect(clippy::large_enum_variant, reason = "one for each planning thread")]
pub(super) enum Wide<const NX: usize> {
    Baseline(Sweep<f64, NX>),
    #[cfg(target_arch = "x86_64")]
    Avx2(Sweep<Avx2, NX>),
    /// Four of a tail take half the time of eight.
    #[cfg(target_arch = "x86_64")]
    Avx512(Sweep<Avx512, NX>, Sweep<Avx2, NX>),
}

impl<const NX: usize> Wide<NX> {
    pub(super) fn new(instructions: InstructionSet) -> Self {
        match instructions.0 {
            Set::Baseline => Self::Baseline(Sweep::new()),
            #[cfg(target_arch = "x86_64")]
            Set::Avx2 => Self::Avx2(Sweep::new()),
            #[cfg(target_arch = "x86_64")]
            Set::Avx512 => Self::Avx512(Sweep::new(), Sweep::new()),
        }
    }

    /// Robots at a time.
    pub(super) fn width(&self) -> usize {
        match self {
            Self::Baseline(_) => 1,
            #[cfg(target_arch = "x86_64")]
            Self::Avx2(_) => Avx2::WIDTH,
            #[cfg(target_arch = "x86_64")]
            Self::Avx512(..) => Avx512::WIDTH,
        }
    }

    /// Solves up to [`Self::width`] ticks of one shape.
    pub(super) fn drive(&mut self, ticks: &mut [Tick<'_, NX>]) {
        match self {
            Self::Baseline(sweep) => drive(Scalar, sweep, ticks),
            #[cfg(target_arch = "x86_64")]
            Self::Avx2(sweep) => drive(WithAvx2, sweep, ticks),
            #[cfg(target_arch = "x86_64")]
            Self::Avx512(_, narrow) if ticks.len() <= Avx2::WIDTH => {
                drive(WithAvx2, narrow, ticks);
            }
            #[cfg(target_arch = "x86_64")]
            Self::Avx512(sweep, _) => drive(WithAvx512, sweep, ticks),
        }
    }
}

/// Asks for `rows` to be brought into the cache, where the target knows how.
#[inline(always)]
pub(super) fn prefetch<T>(rows: &[T]) {
    #[cfg(target_arch = "x86_64")]
    super::x86::prefetch(rows);
    #[cfg(not(target_arch = "x86_64"))]
    let _ = rows;
}

/// Solves one tick alone, with instructions of three operands where the machine has them.
pub(super) fn drive_alone<const NX: usize>(sweep: &mut Sweep<f64, NX>, tick: Tick<'_, NX>) {
    #[cfg(target_arch = "x86_64")]
    if is_x86_feature_detected!("avx2") {
        return drive(ScalarWithAvx2, sweep, &mut [tick]);
    }
    drive(Scalar, sweep, &mut [tick]);
}

/// Who computes a sweep.
pub(super) trait Engine: Copy {
    /// How many robots at a time.
    type Lanes: Lanes;

    /// One iteration.
    fn iterate<const NX: usize>(self, sweep: &mut Sweep<Self::Lanes, NX>) -> Outcome<Self::Lanes>;

    /// The first iterate, and where what was loaded makes sense.
    fn start<const NX: usize>(
        self,
        sweep: &mut Sweep<Self::Lanes, NX>,
    ) -> <Self::Lanes as Lanes>::Mask;

    /// Makes open lanes drivable.
    fn settle<const NX: usize>(
        self,
        sweep: &mut Sweep<Self::Lanes, NX>,
    ) -> <Self::Lanes as Lanes>::Mask;

    /// Costs of the iterates.
    fn cost<const NX: usize>(self, sweep: &mut Sweep<Self::Lanes, NX>) -> Self::Lanes;
}

/// An [`Engine`] whose code is compiled here, for three and for five states, and not again by every user of a generic function.
macro_rules! engine {
    ($(#[$doc:meta])* $name:ident, $lanes:ty, $(#[$features:meta])?) => {
        $(#[$doc])*
        #[derive(Clone, Copy, Debug)]
        pub(super) struct $name;

        impl Engine for $name {
            type Lanes = $lanes;

            fn iterate<const NX: usize>(self, sweep: &mut Sweep<$lanes, NX>) -> Outcome<$lanes> {
                engine!(call iterate sweep $lanes, $(#[$features])?)
            }

            fn start<const NX: usize>(
                self,
                sweep: &mut Sweep<$lanes, NX>,
            ) -> <$lanes as Lanes>::Mask {
                engine!(call start sweep $lanes, $(#[$features])?)
            }

            fn settle<const NX: usize>(
                self,
                sweep: &mut Sweep<$lanes, NX>,
            ) -> <$lanes as Lanes>::Mask {
                engine!(call settle sweep $lanes, $(#[$features])?)
            }

            fn cost<const NX: usize>(self, sweep: &mut Sweep<$lanes, NX>) -> $lanes {
                engine!(call cost sweep $lanes, $(#[$features])?)
            }
        }
    };
    (call $method:ident $sweep:ident $lanes:ty, $(#[$features:meta])?) => {{
        $(#[$features])?
        fn three(sweep: &mut Sweep<$lanes, 3>, result: &mut engine!(result $method $lanes)) {
            *result = sweep.$method();
        }
        $(#[$features])?
        fn five(sweep: &mut Sweep<$lanes, 5>, result: &mut engine!(result $method $lanes)) {
            *result = sweep.$method();
        }
        let mut result = engine!(initial $method $lanes);
        let sweep: &mut dyn Any = $sweep;
        if let Some(sweep) = sweep.downcast_mut::<Sweep<$lanes, 3>>() {
            // SAFETY: the engine belongs to a `Wide` made for an `InstructionSet`, which exists only where the machine has it.
            #[allow(unused_unsafe, reason = "the baseline needs no instructions")]
            unsafe { three(sweep, &mut result) };
        } else if let Some(sweep) = sweep.downcast_mut::<Sweep<$lanes, 5>>() {
            // SAFETY: as above.
            #[allow(unused_unsafe, reason = "the baseline needs no instructions")]
            unsafe { five(sweep, &mut result) };
        }
        result
    }};
    (result iterate $lanes:ty) => { Outcome<$lanes> };
    (result start $lanes:ty) => { <$lanes as Lanes>::Mask };
    (result settle $lanes:ty) => { <$lanes as Lanes>::Mask };
    (result cost $lanes:ty) => { $lanes };
    (initial iterate $lanes:ty) => { Outcome::nothing() };
    (initial start $lanes:ty) => { <$lanes>::mask(false) };
    (initial settle $lanes:ty) => { <$lanes>::mask(false) };
    (initial cost $lanes:ty) => { <$lanes>::splat(f64::NAN) };
}

engine!(
    /// One robot alone, with the instructions that every machine has.
    Scalar, f64,
);
#[cfg(target_arch = "x86_64")]
engine!(
    /// The same with AVX2's encoding.
    ScalarWithAvx2, f64, #[target_feature(enable = "avx2")]
);
#[cfg(target_arch = "x86_64")]
engine!(
    /// Four robots. No `fma` among the features, here and below: nothing may be fused.
    WithAvx2, Avx2, #[target_feature(enable = "avx2")]
);
#[cfg(target_arch = "x86_64")]
engine!(
    /// Eight robots.
    WithAvx512, Avx512, #[target_feature(enable = "avx512f,avx512dq")]
);
