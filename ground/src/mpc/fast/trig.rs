//! Sine, cosine, tangent and arctangent in lanes, within an ulp or two: the system's differ from machine to machine.
//!
//! Polynomials and reduction are those of fdlibm (k_sin.c, k_cos.c, e_rem_pio2.c; Sun Microsystems, 1993), Cephes' for the arctangent.

use super::lanes::Lanes;

/// sin x and cos x for |x| ≤ [`ANGLE_MAX`] [rad]; beyond it the reduction loses digits.
#[inline(always)]
pub(super) fn sin_cos<L: Lanes>(x: L) -> (L, L) {
    let number = L::splat;
    // n = x in quarter turns, rounded; y = x − n π/2 with π/2 in two parts, the first one so short that n times it is exact.
    let n = rounded(x * number(core::f64::consts::FRAC_2_PI));
    let y = (x - n * number(QUARTER_HIGH)) - n * number(QUARTER_LOW);
    let z = y * y;
    let (s, c) = (sin_near(y, z), cos_near(z));
    // n modulo 4: 0 … 3. Rounding of a quarter less 3/8 is its floor.
    let quadrant = n - number(4.0) * rounded(n * number(0.25) - number(0.375));
    let is_upper = quadrant.less(number(1.5));
    let is_first = quadrant.less(number(0.5));
    let is_second = L::and(is_upper, L::not(is_first));
    let is_lower = L::not(is_upper);
    let is_third = L::and(is_lower, quadrant.less(number(2.5)));
    let is_odd = L::either(is_second, L::and(is_lower, L::not(is_third)));
    let (sin, cos) = (c.or(is_odd, s), s.or(is_odd, c));
    let is_left = L::either(is_second, is_third);
    (sin.or(is_upper, -sin), (-cos).or(is_left, cos))
}

/// tan x for |x| ≤ π/4 [rad].
#[inline(always)]
pub(super) fn tan_near<L: Lanes>(x: L) -> L {
    let z = x * x;
    sin_near(x, z) / cos_near(z)
}

/// atan x for x ≥ 0 [rad].
#[inline(always)]
pub(super) fn atan<L: Lanes>(x: L) -> L {
    let number = L::splat;
    // Beyond tan 3π/8 by 1/x, beyond 0.66 by (x − 1)/(x + 1).
    let is_steep = number(2.414_213_562_373_095).less(x);
    let is_middle = L::and(number(0.66).less(x), L::not(is_steep));
    let above = (x - number(1.0)).or(is_middle, x);
    let below = (x + number(1.0)).or(is_middle, number(1.0));
    let y = number(-1.0).or(is_steep, above) / x.or(is_steep, below);
    let z = y * y;
    let p = polynomial(z, &ATAN_ABOVE);
    let q = polynomial(z, &ATAN_BELOW);
    let base = number(core::f64::consts::FRAC_PI_2).or(
        is_steep,
        number(core::f64::consts::FRAC_PI_4).or(is_middle, number(0.0)),
    );
    base + (y + y * (z * p / q))
}

/// Σ cₖ zᵏ.
#[inline(always)]
pub(super) fn polynomial<L: Lanes, const N: usize>(z: L, coefficients: &[f64; N]) -> L {
    let mut sum = L::splat(coefficients[N - 1]);
    let mut k = N - 1;
    while k > 0 {
        k -= 1;
        sum = sum * z + L::splat(coefficients[k]);
    }
    sum
}

/// To the nearest integer, ties to even, for |x| < 2⁵¹: no instruction set is asked for its own.
#[inline(always)]
pub(super) fn rounded<L: Lanes>(x: L) -> L {
    const SHIFT: f64 = 6_755_399_441_055_744.0; // 1.5 · 2⁵²
    (x + L::splat(SHIFT)) - L::splat(SHIFT)
}

#[inline(always)]
fn sin_near<L: Lanes>(x: L, z: L) -> L {
    x + x * (z * polynomial(z, &SIN))
}

#[inline(always)]
fn cos_near<L: Lanes>(z: L) -> L {
    let half = z * L::splat(0.5);
    let w = L::splat(1.0) - half;
    // What 1 − z/2 lost by rounding comes back.
    w + (((L::splat(1.0) - w) - half) + z * z * polynomial(z, &COS))
}

/// Largest angle of [`sin_cos`] [rad]: headings of robots that have turned 150 000 times.
pub(super) const ANGLE_MAX: f64 = 1e6;

const QUARTER_HIGH: f64 = 1.570_796_326_734_125_6; // 33 bits of π/2
const QUARTER_LOW: f64 = 6.077_100_506_506_192e-11;

const SIN: [f64; 6] = [
    -1.666_666_666_666_663_2e-1,
    8.333_333_333_322_49e-3,
    -1.984_126_982_985_795e-4,
    2.755_731_370_707_006_8e-6,
    -2.505_076_025_340_686_3e-8,
    1.589_690_995_211_55e-10,
];

const COS: [f64; 6] = [
    4.166_666_666_666_66e-2,
    -1.388_888_888_887_411e-3,
    2.480_158_728_947_673e-5,
    -2.755_731_435_139_066_3e-7,
    2.087_572_321_298_175e-9,
    -1.135_964_755_778_819_5e-11,
];

const ATAN_ABOVE: [f64; 5] = [
    -6.485_021_904_942_025e1,
    -1.228_866_684_490_136_1e2,
    -7.500_855_792_314_705e1,
    -1.615_753_718_733_365_2e1,
    -8.750_608_600_031_904e-1,
];

const ATAN_BELOW: [f64; 6] = [
    1.945_506_571_482_614e2,
    4.853_903_996_359_137e2,
    4.328_810_604_912_903e2,
    1.650_270_098_316_988_5e2,
    2.485_846_490_142_306e1,
    1.0,
];

#[cfg(test)]
mod tests {
    use super::*;

    /// Against the system's, on angles from tiny to the largest.
    #[test]
    fn functions_agree_with_the_systems() {
        for i in 0..200_000 {
            let x = (f64::from(i) * 0.618_034).fract() * 2.0 - 1.0;
            for scale in [1e-9, 0.7, 7.0, 1e3, ANGLE_MAX] {
                let (sin, cos) = sin_cos(x * scale);
                let (s, c) = (x * scale).sin_cos();
                assert!(
                    (sin - s).abs() < 3e-16 && (cos - c).abs() < 3e-16,
                    "{x} {scale}"
                );
            }
            let tan = tan_near(x * 0.78);
            assert!((tan - (x * 0.78).tan()).abs() <= 4e-16, "{x}");
            for scale in [1.0, 4.0, 1e6] {
                let t = x.abs() * scale;
                assert!((atan(t) - t.atan()).abs() <= 4e-16, "{t}");
            }
        }
    }
}
