//! Truncated Taylor series in time: exact derivatives of references without differencing.
//!
//! Differencing a reference twice amplifies its rounding until the roll reference shakes the robot; a series carries every
//! derivative to machine precision. Recurrences: Griewank and Walther, *Evaluating Derivatives*, 2nd ed., table 13.1 and 13.2.

use core::array;
use core::ops::{Add, Mul, Sub};

/// f(t₀ + h) = Σ c[k] hᵏ, k < N: the value and N − 1 derivatives of one quantity at one instant.
///
/// [`Jet::derivative`] loses the highest order. Nothing here lets an order depend on a higher one: a shorter series has the same
/// coefficients, bit for bit, and costs less.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Jet<const N: usize> {
    c: [f64; N], // k-th derivative / k!
}

impl<const N: usize> Jet<N> {
    /// A quantity that does not change.
    pub fn constant(value: f64) -> Self {
        let mut c = [0.0; N];
        c[0] = value;
        Self { c }
    }

    /// A quantity that grows steadily: `value` now, `rate` per second.
    pub fn line(value: f64, rate: f64) -> Self {
        let mut jet = Self::constant(value);
        jet.c[1] = rate;
        jet
    }

    /// The value now.
    pub fn value(&self) -> f64 {
        self.c[0]
    }

    /// The first derivative now [1/s].
    pub fn rate(&self) -> f64 {
        self.c[1]
    }

    /// The first M coefficients of the derivative's series: one order less than here, at most.
    pub fn derivative<const M: usize>(&self) -> Jet<M> {
        const { assert!(M < N) };
        Jet {
            c: array::from_fn(|k| (k + 1) as f64 * self.c[k + 1]),
        }
    }

    /// The series whose derivative is `self` and whose value is `value`.
    pub fn integral(&self, value: f64) -> Self {
        Self {
            c: array::from_fn(|k| {
                if k == 0 {
                    value
                } else {
                    self.c[k - 1] / k as f64
                }
            }),
        }
    }

    /// The first M coefficients.
    pub fn truncated<const M: usize>(&self) -> Jet<M> {
        const { assert!(M <= N) };
        Jet {
            c: array::from_fn(|k| self.c[k]),
        }
    }

    /// The q with sin q = f (cos q + q sin q) whose value is `value`, a solution already, and d = 1 − f q.
    ///
    /// f = tan q / (1 + q tan q) has the derivative ḟ = q̇ / (1 + q tan q)², and 1 + q tan q = 1/d: so q̇ d² = ḟ, without a sine.
    pub fn turn_angle(&self, value: f64) -> (Self, Self) {
        let f = self;
        let (mut q, mut d) = (Self::constant(value), Self::constant(1.0 - f.c[0] * value));
        let mut square = Self::constant(d.c[0] * d.c[0]);
        let share = 1.0 / square.c[0];
        for k in 1..N {
            let mut lower = 0.0;
            for j in 1..k {
                lower += j as f64 * q.c[j] * square.c[k - j];
            }
            q.c[k] = (f.c[k] - lower / k as f64) * share;
            let (mut product, mut cross) = (0.0, 0.0);
            for j in 0..=k {
                product += f.c[j] * q.c[k - j];
            }
            d.c[k] = -product;
            for j in 1..k {
                cross += d.c[j] * d.c[k - j];
            }
            square.c[k] = cross + 2.0 * d.c[0] * d.c[k];
        }
        (q, d)
    }

    /// f².
    pub fn square(&self) -> Self {
        Self {
            c: array::from_fn(|k| {
                let mut half = 0.0;
                for j in 0..k.div_ceil(2) {
                    half += self.c[j] * self.c[k - j];
                }
                let middle = if k % 2 == 0 { self.c[k / 2] } else { 0.0 };
                2.0 * half + middle * middle
            }),
        }
    }

    /// f^`exponent` whose value is `value`, for f > 0.
    pub fn power(&self, exponent: f64, value: f64) -> Self {
        let mut p = Self::constant(value);
        let share = 1.0 / self.c[0];
        for k in 1..N {
            // k f₀ pₖ = Σ (α j − (k − j)) fⱼ pₖ₋ⱼ, from f ṗ = α ḟ p.
            let mut sum = 0.0;
            for j in 1..=k {
                sum += ((exponent + 1.0) * j as f64 / k as f64 - 1.0) * self.c[j] * p.c[k - j];
            }
            p.c[k] = sum * share;
        }
        p
    }

    /// sin f of a steadily growing f: `value` now, `rate` per second.
    pub fn sine(value: f64, rate: f64) -> Self {
        let (sin, cos) = value.sin_cos();
        let (mut s, mut c) = (Self::constant(sin), Self::constant(cos));
        for k in 1..N {
            let f = rate / k as f64;
            s.c[k] = f * c.c[k - 1];
            c.c[k] = 0.0 - f * s.c[k - 1];
        }
        s
    }

    /// (sin f, cos f).
    pub fn sin_cos(&self) -> (Self, Self) {
        let (sin, cos) = self.c[0].sin_cos();
        let (mut s, mut c) = (Self::constant(sin), Self::constant(cos));
        for k in 1..N {
            for j in 1..=k {
                let f = j as f64 * self.c[j] / k as f64;
                s.c[k] += f * c.c[k - j];
                c.c[k] -= f * s.c[k - j];
            }
        }
        (s, c)
    }
}

impl<const N: usize> Add for Jet<N> {
    type Output = Self;
    fn add(self, other: Self) -> Self {
        Self {
            c: array::from_fn(|k| self.c[k] + other.c[k]),
        }
    }
}

impl<const N: usize> Sub for Jet<N> {
    type Output = Self;
    fn sub(self, other: Self) -> Self {
        Self {
            c: array::from_fn(|k| self.c[k] - other.c[k]),
        }
    }
}

impl<const N: usize> Mul for Jet<N> {
    type Output = Self;
    fn mul(self, other: Self) -> Self {
        Self {
            c: array::from_fn(|k| {
                let mut sum = self.c[0] * other.c[k];
                for j in 1..=k {
                    sum += self.c[j] * other.c[k - j];
                }
                sum
            }),
        }
    }
}

impl<const N: usize> Mul<f64> for Jet<N> {
    type Output = Self;
    fn mul(self, factor: f64) -> Self {
        Self {
            c: self.c.map(|c| c * factor),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// sin² + cos², (√f)², f · 1/f and the derivative of an integral give back what they came from.
    #[test]
    fn identities_hold_to_the_last_order() {
        let f = Jet::<8> {
            c: [0.7, 0.3, -0.2, 0.11, 0.05, -0.02, 0.01, 0.004],
        };
        let g = Jet::<8> {
            c: [1.3, -0.4, 0.1, 0.2, -0.3, 0.06, 0.02, -0.01],
        };
        let (s, c) = f.sin_cos();
        let close = |a: Jet<8>, b: Jet<8>| (0..8).all(|k| (a.c[k] - b.c[k]).abs() < 1e-14);
        assert!(close(s * s + c * c, Jet::constant(1.0)));
        assert!(close(Jet::sine(0.7, 0.3), Jet::line(0.7, 0.3).sin_cos().0));
        let root = g.power(0.5, g.c[0].sqrt());
        assert!(close(root * root, g));
        assert!(close(g.power(-1.0, 1.0 / g.c[0]) * g * f, f));
        assert!(close(
            g.power(-1.5, g.c[0].powf(-1.5)) * root * g,
            Jet::constant(1.0)
        ));
        assert!((0..7).all(|k| f.derivative::<7>().integral(0.7).c[k] == f.c[k]));
        // sin q = f (cos q + q sin q) to every order.
        let f = f * 0.3;
        let mut q = f.c[0];
        for _ in 0..20 {
            q -= (q.sin() - f.c[0] * (q.cos() + q * q.sin())) / (q.cos() * (1.0 - f.c[0] * q));
        }
        let (q, d) = f.turn_angle(q);
        assert!(close(d, Jet::constant(1.0) - f * q));
        let (sin, cos) = q.sin_cos();
        assert!(close(sin, f * (cos + q * sin)));
        // (sin f)′ = cos f · f′, up to the order that the derivative loses.
        let (s, c) = f.sin_cos();
        let (left, right) = (s.derivative::<7>(), c.truncated::<7>() * f.derivative());
        assert!((0..7).all(|k| (left.c[k] - right.c[k]).abs() < 1e-14));
    }
}
