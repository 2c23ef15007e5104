//! Truncated Taylor series in time: exact derivatives of references without differencing.
//!
//! Differencing a reference twice amplifies its rounding until the roll reference shakes the robot; a series carries every
//! derivative to machine precision. Recurrences: Griewank and Walther, *Evaluating Derivatives*, 2nd ed., table 13.1 and 13.2.

use core::array;
use core::ops::{Add, Div, Mul, Neg, Sub};

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

    /// The q with sin q = f (cos q + q sin q) whose value is `value`, a solution already.
    ///
    /// Each coefficient enters its own order of the equation linearly, with the same factor cos q (1 − f q).
    pub fn turn_angle(&self, value: f64) -> Self {
        let f = self;
        let (mut q, (sin, cos)) = (Self::constant(value), value.sin_cos());
        let (mut s, mut c) = (Self::constant(sin), Self::constant(cos));
        // m = cos q + q sin q, whose derivative is q cos q · q̇.
        let mut m = Self::constant(cos + value * sin);
        let mut q_cos = Self::constant(value * cos);
        let slope = cos * (1.0 - f.c[0] * value);
        for k in 1..N {
            // What the lower orders contribute to order k of sin q, cos q, q cos q · q̇ and f m.
            let (mut s_k, mut c_k, mut m_k) = (0.0, 0.0, 0.0);
            for j in 1..k {
                let rate = j as f64 * q.c[j] / k as f64;
                s_k += rate * c.c[k - j];
                c_k -= rate * s.c[k - j];
                m_k += rate * q_cos.c[k - j];
            }
            let f_m: f64 = (1..=k).map(|j| f.c[j] * m.c[k - j]).sum();
            q.c[k] = (f_m + f.c[0] * m_k - s_k) / slope;
            s.c[k] = s_k + cos * q.c[k];
            c.c[k] = c_k - sin * q.c[k];
            m.c[k] = m_k + value * cos * q.c[k];
            q_cos.c[k] = (0..=k).map(|i| q.c[i] * c.c[k - i]).sum();
        }
        q
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

    /// √f, for f > 0.
    pub fn sqrt(&self) -> Self {
        let mut r = Self::constant(self.c[0].sqrt());
        for k in 1..N {
            let cross: f64 = (1..k).map(|j| r.c[j] * r.c[k - j]).sum();
            r.c[k] = (self.c[k] - cross) / (2.0 * r.c[0]);
        }
        r
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

impl<const N: usize> Neg for Jet<N> {
    type Output = Self;
    fn neg(self) -> Self {
        Self {
            c: self.c.map(|c| -c),
        }
    }
}

impl<const N: usize> Mul for Jet<N> {
    type Output = Self;
    fn mul(self, other: Self) -> Self {
        Self {
            c: array::from_fn(|k| (0..=k).map(|j| self.c[j] * other.c[k - j]).sum()),
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

impl<const N: usize> Div for Jet<N> {
    type Output = Self;
    fn div(self, divisor: Self) -> Self {
        let mut q = Self::constant(self.c[0] / divisor.c[0]);
        for k in 1..N {
            let cross: f64 = (1..=k).map(|j| divisor.c[j] * q.c[k - j]).sum();
            q.c[k] = (self.c[k] - cross) / divisor.c[0];
        }
        q
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// sin² + cos², (√f)², (f / g) g and the derivative of an integral give back what they came from.
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
        assert!(close(g.sqrt() * g.sqrt(), g));
        assert!(close((f / g) * g, f));
        assert!((0..7).all(|k| f.derivative::<7>().integral(0.7).c[k] == f.c[k]));
        // sin q = f (cos q + q sin q) to every order.
        let f = f * 0.3;
        let mut q = f.c[0];
        for _ in 0..20 {
            q -= (q.sin() - f.c[0] * (q.cos() + q * q.sin())) / (q.cos() * (1.0 - f.c[0] * q));
        }
        let q = f.turn_angle(q);
        let (sin, cos) = q.sin_cos();
        assert!(close(sin, f * (cos + q * sin)));
        // (sin f)′ = cos f · f′, up to the order that the derivative loses.
        let (s, c) = f.sin_cos();
        let (left, right) = (s.derivative::<7>(), c.truncated::<7>() * f.derivative());
        assert!((0..7).all(|k| (left.c[k] - right.c[k]).abs() < 1e-14));
    }
}
