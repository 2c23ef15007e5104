//! The planner's kinematics: eqs (1) and (2), and their exact discretisations over one knot.
//!
//! A sphere that rolls without slip or pivoting moves its centre along an arc while speed and roll are held, so the
//! discretisation is a closed form and not an integration:
//!
//! ```text
//! d = v̄ Δ              way forward over the knot [m]
//! e = R Δq             way to the left, from the change of the roll [m]: eq (1)'s term R q̇_r, absent in eq (2)
//! g = v̄ Δ tan q̄ / R    change of the heading [rad]
//! (X, Y)⁺ = (X, Y) + (d + i e) exp(iφ) M(g),   φ⁺ = φ + g
//! M(g) = (exp(ig) − 1)/(ig) = sinc(g/2) exp(ig/2)
//! ```
//!
//! with v̄ and q̄ the means over the knot. `arc` holds both (3 states); `lag` and `centre` let v and q follow their commands
//! with a first-order lag (5 states) and use the exact means; `centre` alone keeps e, so that the *centre* is planned.

use nalgebra::{SMatrix, SVector, Vector2};

/// Rate of the pose (X, Y, φ) [m/s, m/s, rad/s], eq (1): rolling without slip or pivoting.
///
/// `heading` φ [rad], `v` speed of the centre along the heading [m/s], `q_r` roll [rad], `q_r_dot` its rate [rad/s], `radius` R [m].
pub fn pose_rate(heading: f64, v: f64, q_r: f64, q_r_dot: f64, radius: f64) -> [f64; 3] {
    let (sin, cos) = heading.sin_cos();
    let sideways = radius * q_r_dot;
    [
        v * cos - sideways * sin,
        v * sin + sideways * cos,
        v * q_r.tan() / radius,
    ]
}

/// Rate of the pose (X, Y, φ) [m/s, m/s, rad/s], eq (2): eq (1) without its sideways term R q̇_r.
///
/// Differs from the robot by a jump of R Δq_r sideways with every change of the roll (E15), 6 cm for 10°.
pub fn pose_rate_simplified(heading: f64, v: f64, q_r: f64, radius: f64) -> [f64; 3] {
    pose_rate(heading, v, q_r, 0.0, radius)
}

/// How the state of the planner's model moves over one knot.
///
/// Built by [`Discretisation::arc`] (states X, Y, φ; inputs v, q_r) or by [`Discretisation::lag`] and
/// [`Discretisation::centre`] (states X, Y, φ, v, q_r; inputs the commands v_c, q_c): there is none with another NX.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Discretisation<const NX: usize> {
    /// Length of a knot, Δ [s].
    period: f64,
    /// Radius of the sphere, R [m].
    radius: f64,
    /// Share of v − v_c that is left after a knot, exp(−Δ/τ) [1].
    left: f64,
    /// Mean share of v − v_c over a knot, τ (1 − exp(−Δ/τ))/Δ [1].
    mean: f64,
    /// Whether the centre moves sideways with the roll, eq (1).
    sideways: bool,
}

/// First-order expansion of one knot.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Linearised<const NX: usize> {
    /// State at the end of the knot, F(x, u).
    pub next: SVector<f64, NX>,
    /// ∂F/∂x, NX × NX.
    pub a: SMatrix<f64, NX, NX>,
    /// ∂F/∂u, NX × 2.
    pub b: SMatrix<f64, NX, 2>,
}

/// Second derivatives of λᵀF(x, u), the part of the Lagrangian's Hessian that a Gauss-Newton step leaves out.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Curvature<const NX: usize> {
    /// ∂²(λᵀF)/∂x², NX × NX.
    pub xx: SMatrix<f64, NX, NX>,
    /// ∂²(λᵀF)/∂u∂x, 2 × NX.
    pub ux: SMatrix<f64, 2, NX>,
    /// ∂²(λᵀF)/∂u², 2 × 2.
    pub uu: SMatrix<f64, 2, 2>,
}

impl<const NX: usize> Curvature<NX> {
    /// No curvature: what a Gauss-Newton step assumes.
    pub fn zeros() -> Self {
        Self {
            xx: SMatrix::zeros(),
            ux: SMatrix::zeros(),
            uu: SMatrix::zeros(),
        }
    }
}

impl Discretisation<3> {
    /// Eq (2) with speed and roll held over a knot of `period` [s], for a sphere of `radius` [m]: exact.
    pub fn arc(period: f64, radius: f64) -> Self {
        Self {
            period,
            radius,
            left: 0.0,
            mean: 0.0,
            sideways: false,
        }
    }
}

impl Discretisation<5> {
    /// Eq (2) with v and q_r following their commands with the lag `tau` [s]; on the arc of their means.
    pub fn lag(period: f64, radius: f64, tau: f64) -> Self {
        // −expm1 instead of 1 − exp: no cancellation for a lag much longer than the knot.
        let gone = -(-period / tau).exp_m1();
        Self {
            period,
            radius,
            left: 1.0 - gone,
            mean: tau * gone / period,
            sideways: false,
        }
    }

    /// As `self`, over a knot that is longer by that of `more`, which has the same lag: without another exponential.
    pub(crate) fn longer(&self, more: &Self) -> Self {
        // 1 − exp(−(a + b)/τ) = (1 − exp(−a/τ)) + exp(−a/τ) (1 − exp(−b/τ)): nothing cancels.
        let gone = |part: &Self| part.mean * part.period;
        let lag_gone = gone(self) + self.left * gone(more);
        let period = self.period + more.period;
        Self {
            period,
            left: self.left * more.left,
            mean: lag_gone / period,
            ..*self
        }
    }

    /// As [`Discretisation::lag`], with eq (1)'s sideways term: the state is the pose of the sphere's centre.
    pub fn centre(period: f64, radius: f64, tau: f64) -> Self {
        Self {
            sideways: true,
            ..Self::lag(period, radius, tau)
        }
    }
}

impl<const NX: usize> Discretisation<NX> {
    /// Length of a knot, Δ [s].
    pub fn period(&self) -> f64 {
        self.period
    }

    /// Radius of the sphere, R [m].
    pub fn radius(&self) -> f64 {
        self.radius
    }

    /// Δ, R, and the shares `left`, `mean` and `slide`, for the planner's fast path.
    pub(crate) fn numbers(&self) -> [f64; 5] {
        [self.period, self.radius, self.left, self.mean, self.slide()]
    }

    /// Share of v − v_c that is gone after a knot, 1 − exp(−Δ/τ), for the lag `tau` it was made with [s]; exact for a short one, too [1].
    pub(crate) fn gone(&self, tau: f64) -> f64 {
        self.mean * self.period / tau
    }

    /// Whether every number of the model is finite and makes sense: period and radius positive, lag positive.
    pub fn is_valid(&self) -> bool {
        let lag = NX == 3 || (self.left >= 0.0 && self.left < 1.0 && self.mean > 0.0);
        self.period.is_finite()
            && self.period > 0.0
            && self.radius.is_finite()
            && self.radius > 0.0
            && lag
    }

    /// State at the end of a knot that begins at `x` and holds `u`, F(x, u).
    pub fn step(&self, x: &SVector<f64, NX>, u: &Vector2<f64>) -> SVector<f64, NX> {
        let (v, q, plan) = self.means(x, u);
        let g = v * self.period * q.tan() / self.radius;
        let way = plan.times(Complex::polar(x[2])).times(chord(g));
        let mut next = *x;
        next[0] += way.re;
        next[1] += way.im;
        next[2] += g;
        self.follow(&mut next, x, u);
        next
    }

    /// [`Discretisation::step`] with its Jacobians.
    pub fn linearise(&self, x: &SVector<f64, NX>, u: &Vector2<f64>) -> Linearised<NX> {
        self.linearised(x, u, &self.knot(x, u))
    }

    /// Second derivatives of λᵀF(x, u) for the costate `lambda` of the next state.
    pub fn curvature(
        &self,
        x: &SVector<f64, NX>,
        u: &Vector2<f64>,
        lambda: &SVector<f64, NX>,
    ) -> Curvature<NX> {
        self.curved(&self.knot(x, u), lambda)
    }

    /// [`Discretisation::linearise`] and [`Discretisation::curvature`] in one.
    pub fn expand(
        &self,
        x: &SVector<f64, NX>,
        u: &Vector2<f64>,
        lambda: &SVector<f64, NX>,
    ) -> (Linearised<NX>, Curvature<NX>) {
        let knot = self.knot(x, u);
        (self.linearised(x, u, &knot), self.curved(&knot, lambda))
    }

    fn linearised(&self, x: &SVector<f64, NX>, u: &Vector2<f64>, knot: &Knot) -> Linearised<NX> {
        let Knot {
            way,
            by_v,
            by_q,
            by_slide,
            g,
            g_v,
            g_q,
            ..
        } = *knot;
        let mut next = *x;
        next[0] += way.re;
        next[1] += way.im;
        next[2] += g;
        self.follow(&mut next, x, u);

        let mut a = SMatrix::identity();
        let mut b = SMatrix::zeros();
        // Turning the heading turns the way: ∂/∂φ = i · way.
        a[(0, 2)] = -way.im;
        a[(1, 2)] = way.re;
        if NX == 3 {
            (b[(0, 0)], b[(1, 0)], b[(2, 0)]) = (by_v.re, by_v.im, g_v);
            (b[(0, 1)], b[(1, 1)], b[(2, 1)]) = (by_q.re, by_q.im, g_q);
        } else {
            let (m, n, c) = (self.mean, 1.0 - self.mean, self.slide());
            (a[(0, 3)], a[(1, 3)], a[(2, 3)]) = (m * by_v.re, m * by_v.im, m * g_v);
            (b[(0, 0)], b[(1, 0)], b[(2, 0)]) = (n * by_v.re, n * by_v.im, n * g_v);
            a[(0, 4)] = m * by_q.re - c * by_slide.re;
            a[(1, 4)] = m * by_q.im - c * by_slide.im;
            a[(2, 4)] = m * g_q;
            b[(0, 1)] = n * by_q.re + c * by_slide.re;
            b[(1, 1)] = n * by_q.im + c * by_slide.im;
            b[(2, 1)] = n * g_q;
            (a[(3, 3)], a[(4, 4)]) = (self.left, self.left);
            (b[(3, 0)], b[(4, 1)]) = (1.0 - self.left, 1.0 - self.left);
        }
        Linearised { next, a, b }
    }

    fn curved(&self, knot: &Knot, lambda: &SVector<f64, NX>) -> Curvature<NX> {
        let Knot {
            g_v,
            g_q,
            g_vq,
            g_qq,
            ..
        } = *knot;
        let dot = |z: Complex| lambda[0] * z.re + lambda[1] * z.im;
        // exp(iφ) M′ along v (times Δ), along the way, and along the slide (times iR); exp(iφ) M″ along the way.
        let turned_first = knot.heading.times(chord_first(knot.g));
        let forward_first = dot(turned_first) * self.period;
        let way_first = dot(knot.plan.times(turned_first)) + lambda[2];
        let slide_first = dot(turned_first.turned()) * self.radius;
        let way_second = dot(knot.plan.times(knot.heading).times(chord_second(knot.g)));

        let phi_phi = -dot(knot.way);
        let phi_v = dot(knot.by_v.turned());
        let phi_q = dot(knot.by_q.turned());
        let phi_slide = dot(knot.by_slide.turned());
        let v_v = 2.0 * forward_first * g_v + way_second * g_v * g_v;
        let v_q = forward_first * g_q + way_second * g_v * g_q + way_first * g_vq;
        let q_q = way_second * g_q * g_q + way_first * g_qq;
        let v_slide = slide_first * g_v;
        let q_slide = slide_first * g_q;

        let mut xx = SMatrix::zeros();
        let mut ux = SMatrix::zeros();
        let mut uu = SMatrix::zeros();
        xx[(2, 2)] = phi_phi;
        if NX == 3 {
            (ux[(0, 2)], ux[(1, 2)]) = (phi_v, phi_q);
            (uu[(0, 0)], uu[(1, 1)]) = (v_v, q_q);
            (uu[(0, 1)], uu[(1, 0)]) = (v_q, v_q);
        } else {
            // v̄ = m v + n v_c, q̄ = m q + n q_c, Δq = c (q_c − q): linear, so the chain rule has no further terms.
            let (m, n, c) = (self.mean, 1.0 - self.mean, self.slide());
            let mut symmetric = |i: usize, j: usize, value: f64| {
                xx[(i, j)] = value;
                xx[(j, i)] = value;
            };
            symmetric(2, 3, m * phi_v);
            symmetric(2, 4, m * phi_q - c * phi_slide);
            symmetric(3, 3, m * m * v_v);
            symmetric(3, 4, m * (m * v_q - c * v_slide));
            symmetric(4, 4, m * (m * q_q - 2.0 * c * q_slide));
            ux[(0, 2)] = n * phi_v;
            ux[(1, 2)] = n * phi_q + c * phi_slide;
            ux[(0, 3)] = n * m * v_v;
            ux[(0, 4)] = n * (m * v_q - c * v_slide);
            ux[(1, 3)] = m * (n * v_q + c * v_slide);
            ux[(1, 4)] = m * n * q_q + c * (m - n) * q_slide;
            uu[(0, 0)] = n * n * v_v;
            uu[(0, 1)] = n * (n * v_q + c * v_slide);
            uu[(1, 0)] = uu[(0, 1)];
            uu[(1, 1)] = n * (n * q_q + 2.0 * c * q_slide);
        }
        Curvature { xx, ux, uu }
    }

    /// Share of q_c − q by which the roll changes over a knot, as far as the centre feels it.
    fn slide(&self) -> f64 {
        if self.sideways { 1.0 - self.left } else { 0.0 }
    }

    /// Means of speed and roll over a knot [m/s, rad], and the way in the frame of the heading, d + i e [m].
    fn means(&self, x: &SVector<f64, NX>, u: &Vector2<f64>) -> (f64, f64, Complex) {
        let (v, q, slide) = if NX == 3 {
            (u[0], u[1], 0.0)
        } else {
            (
                u[0] + (x[3] - u[0]) * self.mean,
                u[1] + (x[4] - u[1]) * self.mean,
                (u[1] - x[4]) * self.slide(),
            )
        };
        (v, q, Complex::new(v * self.period, self.radius * slide))
    }

    fn knot(&self, x: &SVector<f64, NX>, u: &Vector2<f64>) -> Knot {
        let (v, q, plan) = self.means(x, u);
        let k = self.period / self.radius;
        let tan = q.tan();
        let sec2 = 1.0 + tan * tan;
        let (g, g_v, g_q) = (v * k * tan, k * tan, v * k * sec2);
        let heading = Complex::polar(x[2]);
        let m = heading.times(chord(g));
        let along = plan.times(heading).times(chord_first(g));
        Knot {
            heading,
            plan,
            way: plan.times(m),
            by_v: Complex::new(
                self.period * m.re + along.re * g_v,
                self.period * m.im + along.im * g_v,
            ),
            by_q: Complex::new(along.re * g_q, along.im * g_q),
            by_slide: Complex::new(-self.radius * m.im, self.radius * m.re),
            g,
            g_v,
            g_q,
            g_vq: k * sec2,
            g_qq: 2.0 * v * k * tan * sec2,
        }
    }

    /// v⁺ = v_c + (v − v_c) exp(−Δ/τ), q alike.
    fn follow(&self, next: &mut SVector<f64, NX>, x: &SVector<f64, NX>, u: &Vector2<f64>) {
        if NX == 5 {
            next[3] = u[0] + (x[3] - u[0]) * self.left;
            next[4] = u[1] + (x[4] - u[1]) * self.left;
        }
    }
}

/// What one knot does to the pose, with derivatives by v̄, q̄ and Δq.
struct Knot {
    /// exp(iφ).
    heading: Complex,
    /// Way in the frame of the heading, d + i e [m].
    plan: Complex,
    /// Way in the world, (d + i e) exp(iφ) M(g) [m].
    way: Complex,
    /// ∂way/∂v̄.
    by_v: Complex,
    /// ∂way/∂q̄.
    by_q: Complex,
    /// ∂way/∂Δq.
    by_slide: Complex,
    /// Change of the heading g(v̄, q̄) [rad], and its derivatives.
    g: f64,
    g_v: f64,
    g_q: f64,
    g_vq: f64,
    g_qq: f64,
}

/// A vector of the plane as a complex number: turning is multiplication.
#[derive(Clone, Copy)]
struct Complex {
    re: f64,
    im: f64,
}

impl Complex {
    fn new(re: f64, im: f64) -> Self {
        Self { re, im }
    }

    fn polar(angle: f64) -> Self {
        let (im, re) = angle.sin_cos();
        Self { re, im }
    }

    fn times(self, z: Self) -> Self {
        Self {
            re: self.re * z.re - self.im * z.im,
            im: self.re * z.im + self.im * z.re,
        }
    }

    /// A quarter turn to the left, i z.
    fn turned(self) -> Self {
        Self {
            re: -self.im,
            im: self.re,
        }
    }
}

/// M(g) = (exp(ig) − 1)/(ig) = sin g/g + i (1 − cos g)/g, without 0/0.
fn chord(g: f64) -> Complex {
    if g.abs() > SERIES_MAX {
        let (sin, cos) = g.sin_cos();
        return Complex::new(sin / g, (1.0 - cos) / g);
    }
    let z = g * g;
    Complex::new(horner(&SERIES[0], z), g * horner(&SERIES[1], z))
}

/// M′(g).
fn chord_first(g: f64) -> Complex {
    if g.abs() > SERIES_MAX {
        let (sin, cos) = g.sin_cos();
        let m = chord(g);
        return Complex::new((cos - m.re) / g, (sin - m.im) / g);
    }
    let z = g * g;
    Complex::new(g * horner(&SERIES[2], z), horner(&SERIES[3], z))
}

/// M″(g).
fn chord_second(g: f64) -> Complex {
    if g.abs() > SERIES_MAX {
        let (sin, cos) = g.sin_cos();
        let m = chord_first(g);
        return Complex::new((-sin - 2.0 * m.re) / g, (cos - 2.0 * m.im) / g);
    }
    let z = g * g;
    Complex::new(horner(&SERIES[4], z), g * horner(&SERIES[5], z))
}

fn horner(coefficients: &[f64; TERMS], z: f64) -> f64 {
    coefficients.iter().rev().fold(0.0, |sum, c| sum * z + c)
}

/// Largest |g| [rad] for which the series is used: a robot turns by less than 0.3 rad a knot. Beyond it the closed forms
/// divide by g² at most, and lose less than two digits.
const SERIES_MAX: f64 = 0.6;
/// At |g| = 0.6 the first term left out is below 1e-17.
const TERMS: usize = 8;

/// Coefficients in z = g² of Re M, Im M/g, Re M′/g, Im M′, Re M″, Im M″/g, where M = Σ (ig)ⁿ/(n + 1)!.
const SERIES: [[f64; TERMS]; 6] = [
    chord_series(0),
    chord_series(1),
    chord_series(2),
    chord_series(3),
    chord_series(4),
    chord_series(5),
];

/// The first N coefficients of one row of [`SERIES`].
pub(crate) const fn chord_series<const N: usize>(row: usize) -> [f64; N] {
    let mut coefficients = [0.0; N];
    let mut k = 0;
    while k < N {
        let n = (2 * k) as f64; // even power of g in Re M, odd n + 1 in Im M
        let sign = if k % 2 == 0 { 1.0 } else { -1.0 };
        coefficients[k] = match row {
            0 => sign / factorial(2 * k + 1),
            1 => sign / factorial(2 * k + 2),
            // d/dg of gⁿ⁺² in Re M is (n + 2) gⁿ⁺¹, whose coefficient has the next sign.
            2 => -sign * (n + 2.0) / factorial(2 * k + 3),
            3 => sign * (n + 1.0) / factorial(2 * k + 2),
            4 => -sign * (n + 2.0) * (n + 1.0) / factorial(2 * k + 3),
            _ => -sign * (n + 3.0) * (n + 2.0) / factorial(2 * k + 4),
        };
        k += 1;
    }
    coefficients
}

const fn factorial(n: usize) -> f64 {
    let mut product = 1.0;
    let mut i = 2;
    while i <= n {
        product *= i as f64;
        i += 1;
    }
    product
}
