//! Registers of AVX2 and AVX-512 as [`Lanes`].
//!
//! Unsafe because an intrinsic may be executed only where the machine has it. Nothing but `isa` names these types, and it does
//! so behind an `InstructionSet` that the machine was asked for. Multiplications and additions are never fused: a fused one has
//! other bits.

#![allow(
    unsafe_code,
    reason = "vector instructions, used where the machine was asked for them"
)]

use core::arch::x86_64::*;
use core::ops::{Add, Div, Mul, Neg, Sub};

use super::lanes::Lanes;

/// Asks for `rows` to be brought into the cache; changes nothing.
#[inline(always)]
pub(super) fn prefetch<T>(rows: &[T]) {
    let bytes = core::mem::size_of_val(rows);
    for offset in (0..bytes).step_by(LINE) {
        // SAFETY: within `rows`, and every machine of the target has the instruction.
        unsafe {
            let line = rows.as_ptr().cast::<i8>().add(offset);
            _mm_prefetch::<_MM_HINT_T0>(line);
        }
    }
}

/// Of the cache [bytes].
const LINE: usize = 64;

/// Four lanes, a register of AVX2.
#[derive(Clone, Copy, Debug)]
pub(super) struct Avx2(__m256d);

/// Eight lanes, a register of AVX-512.
#[derive(Clone, Copy, Debug)]
pub(super) struct Avx512(__m512d);

macro_rules! operators {
    ($register:ident: $($trait:ident $method:ident $intrinsic:ident),*) => {$(
        impl $trait for $register {
            type Output = Self;
            #[inline(always)]
            fn $method(self, other: Self) -> Self {
                // SAFETY: see the module.
                Self(unsafe { $intrinsic(self.0, other.0) })
            }
        }
    )*};
}

operators!(Avx2: Add add _mm256_add_pd, Sub sub _mm256_sub_pd, Mul mul _mm256_mul_pd, Div div _mm256_div_pd);
operators!(Avx512: Add add _mm512_add_pd, Sub sub _mm512_sub_pd, Mul mul _mm512_mul_pd, Div div _mm512_div_pd);

impl Neg for Avx2 {
    type Output = Self;
    #[inline(always)]
    fn neg(self) -> Self {
        // SAFETY: see the module.
        Self(unsafe { _mm256_xor_pd(self.0, Self::splat(-0.0).0) })
    }
}

impl Neg for Avx512 {
    type Output = Self;
    #[inline(always)]
    fn neg(self) -> Self {
        // SAFETY: see the module.
        Self(unsafe { _mm512_xor_pd(self.0, Self::splat(-0.0).0) })
    }
}

impl Lanes for Avx2 {
    const WIDTH: usize = 4;
    type Mask = __m256d;

    #[inline(always)]
    fn splat(value: f64) -> Self {
        // SAFETY: a register is four numbers.
        Self(unsafe { core::mem::transmute::<[f64; 4], __m256d>([value; 4]) })
    }

    #[inline(always)]
    fn lane(&self, lane: usize) -> f64 {
        // SAFETY: a register is four numbers.
        let lanes = unsafe { &*core::ptr::from_ref(&self.0).cast::<[f64; 4]>() };
        lanes[lane]
    }

    #[inline(always)]
    fn set_lane(&mut self, lane: usize, value: f64) {
        // SAFETY: a register is four numbers.
        let lanes = unsafe { &mut *core::ptr::from_mut(&mut self.0).cast::<[f64; 4]>() };
        lanes[lane] = value;
    }

    #[inline(always)]
    fn less(self, other: Self) -> __m256d {
        // SAFETY: see the module.
        unsafe { _mm256_cmp_pd::<_CMP_LT_OQ>(self.0, other.0) }
    }

    #[inline(always)]
    fn or(self, mask: __m256d, other: Self) -> Self {
        // SAFETY: see the module.
        Self(unsafe { _mm256_blendv_pd(other.0, self.0, mask) })
    }

    #[inline(always)]
    fn and(a: __m256d, b: __m256d) -> __m256d {
        // SAFETY: see the module.
        unsafe { _mm256_and_pd(a, b) }
    }

    #[inline(always)]
    fn either(a: __m256d, b: __m256d) -> __m256d {
        // SAFETY: see the module.
        unsafe { _mm256_or_pd(a, b) }
    }

    #[inline(always)]
    fn not(mask: __m256d) -> __m256d {
        // SAFETY: see the module.
        unsafe { _mm256_xor_pd(mask, Self::mask(true)) }
    }

    #[inline(always)]
    fn mask(value: bool) -> __m256d {
        let bits = if value { u64::MAX } else { 0 };
        // SAFETY: a register is four numbers.
        unsafe { core::mem::transmute::<[u64; 4], __m256d>([bits; 4]) }
    }

    #[inline(always)]
    fn holds(mask: &__m256d, lane: usize) -> bool {
        // SAFETY: a register is four numbers.
        let lanes = unsafe { &*core::ptr::from_ref(mask).cast::<[u64; 4]>() };
        lanes[lane] != 0
    }

    #[inline(always)]
    fn any(mask: __m256d) -> bool {
        // SAFETY: see the module.
        unsafe { _mm256_movemask_pd(mask) != 0 }
    }
}

impl Lanes for Avx512 {
    const WIDTH: usize = 8;
    type Mask = u8;

    #[inline(always)]
    fn splat(value: f64) -> Self {
        // SAFETY: a register is eight numbers.
        Self(unsafe { core::mem::transmute::<[f64; 8], __m512d>([value; 8]) })
    }

    #[inline(always)]
    fn lane(&self, lane: usize) -> f64 {
        // SAFETY: a register is eight numbers.
        let lanes = unsafe { &*core::ptr::from_ref(&self.0).cast::<[f64; 8]>() };
        lanes[lane]
    }

    #[inline(always)]
    fn set_lane(&mut self, lane: usize, value: f64) {
        // SAFETY: a register is eight numbers.
        let lanes = unsafe { &mut *core::ptr::from_mut(&mut self.0).cast::<[f64; 8]>() };
        lanes[lane] = value;
    }

    #[inline(always)]
    fn less(self, other: Self) -> u8 {
        // SAFETY: see the module.
        unsafe { _mm512_cmp_pd_mask::<_CMP_LT_OQ>(self.0, other.0) }
    }

    #[inline(always)]
    fn or(self, mask: u8, other: Self) -> Self {
        // SAFETY: see the module.
        Self(unsafe { _mm512_mask_blend_pd(mask, other.0, self.0) })
    }

    #[inline(always)]
    fn and(a: u8, b: u8) -> u8 {
        a & b
    }

    #[inline(always)]
    fn either(a: u8, b: u8) -> u8 {
        a | b
    }

    #[inline(always)]
    fn not(mask: u8) -> u8 {
        !mask
    }

    #[inline(always)]
    fn mask(value: bool) -> u8 {
        if value { u8::MAX } else { 0 }
    }

    #[inline(always)]
    fn holds(mask: &u8, lane: usize) -> bool {
        mask & (1 << lane) != 0
    }

    #[inline(always)]
    fn any(mask: u8) -> bool {
        mask != 0
    }
}
