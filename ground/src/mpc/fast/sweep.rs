//! The semismooth Newton iteration in lanes.
//!
//! An iterate is states and inputs, nothing else. Backwards, one pass expands each knot at the iterate, carries the costate λ of the
//! iterate (whose curvature is the exact Hessian's) and the value function ½ δxᵀPδx + pᵀδx, and closes the inputs: one that lies on
//! a bound against which the gradient 2R(u − u_ref) + Bᵀλ presses is held, the others are free. Forwards, the whole step is taken,
//! inputs stopped at their bounds. P is symmetric by construction: its upper triangle is all there is.
//!
//! Differs from `sqp` on `riccati`: the active set follows from each iterate instead of being iterated on each subproblem, λ is the iterate's
//! adjoint instead of the subproblem's multiplier, nothing is searched. Where both converge they end at the same point.

#![expect(
    clippy::needless_range_loop,
    reason = "indices stand as in the formulas, often for several matrices at once"
)]

use super::knot::{Expansion, Model};
use super::lanes::Lanes;
use super::trig::{atan, rounded};

/// Problems of up to [`Lanes::WIDTH`] robots with M stages each, and their iterate.
#[derive(Debug)]
pub(super) struct Sweep<L: Lanes, const NX: usize> {
    pub(super) model: Model<L>,
    /// M stages.
    pub(super) stages: Vec<Stage<L, NX>>,
    /// States x₀ … x_M of the iterate.
    pub(super) x: Vec<[L; NX]>,
    /// 2Q, 2R, diagonals.
    pub(super) weight: [L; NX],
    pub(super) input_weight: [L; 2],
    /// 2P.
    pub(super) terminal: [[L; NX]; NX],
    /// Greatest tan|q_c| v² [m²/s²]; infinite: none.
    pub(super) turn_limit: L,
    /// As given: the state at the beginning, the input before, P with both triangles; and whether that input moves the state.
    pub(super) given: [L; NX],
    pub(super) u_prev: [L; 2],
    pub(super) p: [[L; NX]; NX],
    pub(super) is_measured: bool,
    /// Stages at whose end the last solution has a state, and its heading where the first one begins [rad].
    pub(super) known: L,
    pub(super) heading: L,
    /// Above 0 for lanes that [`Self::settle`] is about.
    pub(super) is_open: L,
}

/// One stage: what is given, the iterate's input, and what the way back leaves for the way forth.
#[derive(Clone, Copy, Debug)]
pub(super) struct Stage<L: Lanes, const NX: usize> {
    /// Reference of the state at the stage's end.
    pub(super) x_ref: [L; NX],
    pub(super) u_ref: [L; 2],
    pub(super) lower: [L; 2],
    pub(super) upper: [L; 2],
    pub(super) u: [L; 2],
    /// Feedback δu = K δx + k; a row of K is zero where a bound holds the input.
    pub(super) gain: [[L; NX]; 2],
    k: [L; 2],
    /// Bounds of q_c with the turn limit.
    roll: [L; 2],
    /// Columns of A and B: by φ (X, Y), v̄, q, q_c.
    by_phi: [L; 2],
    by_v: [L; 3],
    by_state_q: [L; 3],
    by_q: [L; 3],
    /// What the dynamics miss, F(xₖ, uₖ) − xₖ₊₁.
    c: [L; NX],
}

/// What an iteration did, in each lane.
#[derive(Clone, Copy, Debug)]
pub(super) struct Outcome<L: Lanes> {
    /// Square of the step's 2-norm [m², rad², m²/s²]. NaN and infinity stay what they are.
    pub(super) size2: L,
    /// Q_uu was positive definite, and every knot within the series.
    pub(super) is_sound: L::Mask,
    /// The turn limit narrowed a bound, or a bound stopped an input that was free: what is left is of the step's order, not its square's.
    pub(super) is_limited: L::Mask,
}

impl<L: Lanes> Outcome<L> {
    /// Of no iteration: no lane is sound.
    pub(super) fn nothing() -> Self {
        Self {
            size2: L::splat(f64::NAN),
            is_sound: L::mask(false),
            is_limited: L::mask(false),
        }
    }
}

impl<L: Lanes, const NX: usize> Sweep<L, NX> {
    pub(super) fn new() -> Self {
        let zero = L::splat(0.0);
        Self {
            model: Model::zero(),
            stages: Vec::new(),
            x: Vec::new(),
            weight: [zero; NX],
            input_weight: [zero; 2],
            terminal: [[zero; NX]; NX],
            turn_limit: zero,
            given: [zero; NX],
            u_prev: [zero; 2],
            p: [[zero; NX]; NX],
            is_measured: false,
            known: zero,
            heading: zero,
            is_open: zero,
        }
    }

    /// Makes room for `stages`. Allocates only for more than ever before.
    pub(super) fn resize(&mut self, stages: usize) {
        let zero = L::splat(0.0);
        let stage = Stage {
            x_ref: [zero; NX],
            u_ref: [zero; 2],
            lower: [zero; 2],
            upper: [zero; 2],
            u: [zero; 2],
            gain: [[zero; NX]; 2],
            k: [zero; 2],
            roll: [zero; 2],
            by_phi: [zero; 2],
            by_v: [zero; 3],
            by_state_q: [zero; 3],
            by_q: [zero; 3],
            c: [zero; NX],
        };
        self.stages.resize(stages, stage);
        self.x.resize(stages + 1, [zero; NX]);
    }

    /// Makes an iterate of what was loaded: the last solution, rolled out where it ends. Where all that was loaded makes sense but the
    /// references and weights, which the cost tells.
    #[inline(always)]
    pub(super) fn start(&mut self) -> L::Mask {
        let number = L::splat;
        let model = self.model;
        let mut is_good = self.start_terminal();
        self.x[0] = if self.is_measured {
            is_good = L::and(is_good, model.is_near(&self.given, &self.u_prev));
            model.step(&self.given, &self.u_prev)
        } else {
            self.given
        };
        // A heading is the same after a turn, the plan must be near the one given.
        let turn = number(core::f64::consts::TAU);
        let turns = rounded((self.x[0][2] - self.heading) / turn) * turn;
        let end = number(core::f64::consts::FRAC_PI_2);
        for (k, stage) in self.stages.iter().enumerate() {
            for j in 0..2 {
                // Not where either is NaN.
                let width = stage.upper[j] - stage.lower[j];
                let is_width = L::and(
                    L::not(width.less(number(0.0))),
                    width.less(number(f64::INFINITY)),
                );
                is_good = L::and(is_good, is_width);
            }
            let is_roll = L::and((-end).less(stage.lower[1]), stage.upper[1].less(end));
            is_good = L::and(is_good, is_roll);
            self.x[k + 1][2] = self.x[k + 1][2] + turns;
            let is_known = number(k as f64).less(self.known);
            if L::any(L::not(is_known)) {
                // Where the last solution ends its last input is held.
                let next = model.step(&self.x[k], &stage.u);
                for j in 0..NX {
                    self.x[k + 1][j] = self.x[k + 1][j].or(is_known, next[j]);
                }
            }
        }
        is_good
    }

    /// Makes the lanes of `is_open` drivable: rolls within the turn limit at the plan's own speed, states rolled out.
    #[inline(always)]
    pub(super) fn settle(&mut self) -> L::Mask {
        let is_open = L::splat(0.0).less(self.is_open);
        for (k, stage) in self.stages.iter_mut().enumerate() {
            let x = self.x[k];
            let (lower, upper) = (stage.lower[1], stage.upper[1]);
            let (least, most, _) = roll_bounds(self.turn_limit, lower, upper, &x, &stage.u);
            let roll = stage.u[1].greater(least).lesser(most);
            stage.u[1] = roll.or(is_open, stage.u[1]);
            let next = self.model.step(&x, &stage.u);
            for j in 0..NX {
                self.x[k + 1][j] = next[j].or(is_open, self.x[k + 1][j]);
            }
        }
        is_open
    }

    /// One iteration in every lane.
    #[inline(always)]
    pub(super) fn iterate(&mut self) -> Outcome<L> {
        let (is_sound, is_limited) = self.backward();
        let (size2, is_cut) = self.forward();
        Outcome {
            size2,
            is_sound,
            is_limited: L::either(is_limited, is_cut),
        }
    }

    #[inline(always)]
    fn backward(&mut self) -> (L::Mask, L::Mask) {
        let number = L::splat;
        let model = self.model;
        let last = self.stages.len();
        let Some(end) = self.stages.last() else {
            return (L::mask(false), L::mask(false));
        };
        let mut is_sound = L::mask(true);
        let mut is_limited = L::mask(false);
        // Value function and costate of the state at the stage's end.
        let mut p = self.terminal;
        let mut lambda = [number(0.0); NX];
        for i in 0..NX {
            for j in 0..NX {
                let weight = if i <= j { p[i][j] } else { p[j][i] };
                lambda[i] = lambda[i] + weight * (self.x[last][j] - end.x_ref[j]);
            }
        }
        let mut slope = lambda;
        for i in (0..last).rev() {
            // The reference of this stage's state belongs to the stage before.
            let x_ref = if i > 0 {
                self.stages[i - 1].x_ref
            } else {
                [number(0.0); NX]
            };
            let x = self.x[i];
            let stage = &mut self.stages[i];
            let u = stage.u;
            let (at, is_near) = model.expand(&x, &u, &lambda);
            is_sound = L::and(is_sound, is_near);
            let next = self.x[i + 1];
            let mut c = [number(0.0); NX];
            for j in 0..3 {
                c[j] = x[j] + at.way[j] - next[j];
            }
            if NX == 5 {
                c[3] = u[0] + (x[3] - u[0]) * model.left - next[3];
                c[4] = u[1] + (x[4] - u[1]) * model.left - next[4];
            }
            let (lower, upper, is_narrow) =
                roll_bounds(self.turn_limit, stage.lower[1], stage.upper[1], &x, &u);
            is_limited = L::either(is_limited, is_narrow);
            let lower = [stage.lower[0], lower];
            let upper = [stage.upper[0], upper];

            // Columns of P A and P B: those of X, Y are P's own.
            let mut pc = slope;
            for j in 0..NX {
                for k in 0..NX {
                    pc[j] = pc[j] + entry(&p, j, k) * c[k];
                }
            }
            let way = [-at.way[1], at.way[0]];
            let mut pa_phi = [number(0.0); NX];
            let mut pa_v = [number(0.0); NX];
            let mut pa_q = [number(0.0); NX];
            let mut pb_v = [number(0.0); NX];
            let mut pb_q = [number(0.0); NX];
            for j in 0..NX {
                let row = [entry(&p, j, 0), entry(&p, j, 1), entry(&p, j, 2)];
                pa_phi[j] = row[2] + row[0] * way[0] + row[1] * way[1];
                pb_v[j] = dot(&row, &at.by_v);
                pb_q[j] = dot(&row, &at.by_q);
                if NX == 5 {
                    let (p_v, p_q) = (entry(&p, j, 3), entry(&p, j, 4));
                    let by_mean = pb_v[j];
                    pa_v[j] = model.mean * by_mean + model.left * p_v;
                    pb_v[j] = (by_mean + p_v) - pa_v[j];
                    pa_q[j] = dot(&row, &at.by_state_q) + model.left * p_q;
                    pb_q[j] = pb_q[j] + model.gone * p_q;
                }
            }

            // Huu, Hux = Bᵀ P A and the gradient.
            let rows = Rows { model, at };
            let rest = if NX == 5 { model.rest } else { number(1.0) };
            let h00 = self.input_weight[0] + rows.by_v(&pb_v) + rest * (rest * at.v_v);
            let h01 = rows.by_v(&pb_q) + rest * at.v_q[1];
            let h11 = self.input_weight[1] + rows.by_q(&pb_q) + at.q_q[2];
            let mut hux = [[number(0.0); NX]; 2];
            for j in 0..2 {
                let mut column = [number(0.0); NX];
                for (k, value) in column.iter_mut().enumerate() {
                    *value = entry(&p, k, j);
                }
                hux[0][j] = rows.by_v(&column);
                hux[1][j] = rows.by_q(&column);
            }
            hux[0][2] = rows.by_v(&pa_phi) + rest * at.phi_v;
            hux[1][2] = rows.by_q(&pa_phi) + at.phi_q[1];
            if NX == 5 {
                hux[0][3] = rows.by_v(&pa_v) + rest * (model.mean * at.v_v);
                hux[1][3] = rows.by_q(&pa_v) + model.mean * at.v_q[1];
                hux[0][4] = rows.by_v(&pa_q) + rest * at.v_q[0];
                hux[1][4] = rows.by_q(&pa_q) + at.q_q[1];
            }
            let own = [
                self.input_weight[0] * (u[0] - stage.u_ref[0]),
                self.input_weight[1] * (u[1] - stage.u_ref[1]),
            ];
            let h = [own[0] + rows.by_v(&pc), own[1] + rows.by_q(&pc)];
            let gradient = [own[0] + rows.by_v(&lambda), own[1] + rows.by_q(&lambda)];

            // Held inputs go to their bound, free ones to the minimum.
            let mut is_free = [L::mask(true); 2];
            let mut fixed = [number(0.0); 2];
            for j in 0..2 {
                let is_low = L::and(L::not(lower[j].less(u[j])), number(0.0).less(gradient[j]));
                let is_high = L::and(L::not(u[j].less(upper[j])), gradient[j].less(number(0.0)));
                fixed[j] = (lower[j] - u[j]).or(is_low, (upper[j] - u[j]).or(is_high, number(0.0)));
                is_free[j] = L::not(L::either(is_low, is_high));
            }
            let one = number(1.0);
            let zero = number(0.0);
            let a = h00.or(is_free[0], one);
            let b = h11.or(is_free[1], one);
            let off = h01.or(L::and(is_free[0], is_free[1]), zero);
            let det = a * b - off * off;
            let pivot = number(PIVOT_MIN);
            let is_positive = L::and(pivot.less(a), (pivot * a).less(det));
            is_sound = L::and(is_sound, is_positive);
            let inverse = one / det;
            let i00 = (b * inverse).or(is_free[0], zero);
            let i11 = (a * inverse).or(is_free[1], zero);
            let i01 = off * inverse;
            let r = [h[0] + h01 * fixed[1], h[1] + h01 * fixed[0]];
            stage.k = [
                fixed[0] + (i01 * r[1] - i00 * r[0]),
                fixed[1] + (i01 * r[0] - i11 * r[1]),
            ];
            for j in 0..NX {
                stage.gain[0][j] = i01 * hux[1][j] - i00 * hux[0][j];
                stage.gain[1][j] = i01 * hux[0][j] - i11 * hux[1][j];
            }
            stage.by_phi = way;
            stage.by_v = at.by_v;
            stage.by_state_q = at.by_state_q;
            stage.by_q = at.by_q;
            stage.c = c;
            stage.roll = [lower[1], upper[1]];
            if i == 0 {
                break; // δx₀ = 0: its value function is of no use.
            }

            // P = W + AᵀPA + KᵀHux, p = w + Aᵀ(p + Pc) + Huxᵀk, λ = w + Aᵀλ; rows of Aᵀ.
            let gain = stage.gain;
            let k = stage.k;
            let mut next_p = p;
            next_p[0][2] = pa_phi[0];
            next_p[1][2] = pa_phi[1];
            next_p[2][2] = rows.by_phi(&pa_phi) + at.phi_phi;
            if NX == 5 {
                for j in 0..2 {
                    next_p[j][3] = pa_v[j];
                    next_p[j][4] = pa_q[j];
                }
                next_p[2][3] = rows.by_phi(&pa_v) + model.mean * at.phi_v;
                next_p[2][4] = rows.by_phi(&pa_q) + at.phi_q[0];
                next_p[3][3] = rows.by_state_v(&pa_v) + model.mean * (model.mean * at.v_v);
                next_p[3][4] = rows.by_state_v(&pa_q) + model.mean * at.v_q[0];
                next_p[4][4] = rows.by_state_q(&pa_q) + at.q_q[0];
            }
            for j in 0..NX {
                for l in j..NX {
                    next_p[j][l] = next_p[j][l] + (gain[0][j] * hux[0][l] + gain[1][j] * hux[1][l]);
                }
                next_p[j][j] = next_p[j][j] + self.weight[j];
            }
            p = next_p;
            slope = rows.back(&pc);
            lambda = rows.back(&lambda);
            for j in 0..NX {
                let w = self.weight[j] * (x[j] - x_ref[j]);
                slope[j] = slope[j] + w + (hux[0][j] * k[0] + hux[1][j] * k[1]);
                lambda[j] = lambda[j] + w;
            }
        }
        (is_sound, is_limited)
    }

    /// Takes the step. Returns the square of its 2-norm, and where a bound stopped an input.
    #[inline(always)]
    fn forward(&mut self) -> (L, L::Mask) {
        let number = L::splat;
        let model = self.model;
        let mut size2 = number(0.0);
        let mut cut = number(0.0);
        let mut dx = [number(0.0); NX];
        for (i, stage) in self.stages.iter_mut().enumerate() {
            let mut du = stage.k;
            for j in 0..2 {
                for l in 0..NX {
                    du[j] = du[j] + stage.gain[j][l] * dx[l];
                }
            }
            let whole = [stage.u[0] + du[0], stage.u[1] + du[1]];
            let v = whole[0].greater(stage.lower[0]).lesser(stage.upper[0]);
            let q = whole[1].greater(stage.roll[0]).lesser(stage.roll[1]);
            cut = cut.greater((whole[0] - v).abs());
            cut = cut.greater((whole[1] - q).abs());
            du = [v - stage.u[0], q - stage.u[1]];
            stage.u = [v, q];
            let (mean_v, q_c) = if NX == 5 {
                (model.mean * dx[3] + model.rest * du[0], du[1])
            } else {
                (du[0], du[1])
            };
            let mut next = dx;
            for j in 0..3 {
                next[j] = dx[j] + stage.c[j] + (stage.by_v[j] * mean_v + stage.by_q[j] * q_c);
                if NX == 5 {
                    next[j] = next[j] + stage.by_state_q[j] * dx[4];
                }
            }
            next[0] = next[0] + stage.by_phi[0] * dx[2];
            next[1] = next[1] + stage.by_phi[1] * dx[2];
            if NX == 5 {
                next[3] = model.left * dx[3] + model.gone * du[0] + stage.c[3];
                next[4] = model.left * dx[4] + model.gone * du[1] + stage.c[4];
            }
            dx = next;
            let mut sum = du[0] * du[0] + du[1] * du[1];
            for j in 0..NX {
                sum = sum + dx[j] * dx[j];
                self.x[i + 1][j] = self.x[i + 1][j] + dx[j];
            }
            size2 = size2 + sum;
        }
        (size2, number(ROUNDING).less(cut))
    }

    /// Cost of the iterate without that of its first state. Not finite if any number of the problem is not.
    #[inline(always)]
    pub(super) fn cost(&self) -> L {
        let half = L::splat(0.5);
        let mut doubled = L::splat(0.0);
        let last = self.stages.len();
        for (i, stage) in self.stages.iter().enumerate() {
            let mut error = [L::splat(0.0); NX];
            let mut sum = L::splat(0.0);
            for j in 0..NX {
                error[j] = self.x[i + 1][j] - stage.x_ref[j];
            }
            for j in 0..2 {
                let miss = stage.u[j] - stage.u_ref[j];
                sum = sum + self.input_weight[j] * (miss * miss);
            }
            if i + 1 == last {
                for j in 0..NX {
                    let mut row = self.terminal[j][j] * error[j];
                    for l in j + 1..NX {
                        let entry = self.terminal[j][l] * error[l];
                        row = row + (entry + entry);
                    }
                    sum = sum + row * error[j];
                }
            } else {
                for j in 0..NX {
                    sum = sum + self.weight[j] * (error[j] * error[j]);
                }
            }
            doubled = doubled + sum;
        }
        doubled * half
    }

    /// Where P is positive semidefinite to rounding, as `Problem::validate` asks: pivots of 2P, shifted by more than its rounding.
    #[inline(always)]
    fn terminal_is_semidefinite(&self) -> L::Mask {
        let zero = L::splat(0.0);
        let mut p = self.terminal;
        let mut size = zero;
        for (i, row) in p.iter().enumerate() {
            for value in &row[i..] {
                size = value.abs().greater(size);
            }
        }
        let shift = size * L::splat(1e-9) + L::splat(f64::MIN_POSITIVE);
        let mut holds = L::mask(true);
        for i in 0..NX {
            let pivot = p[i][i] + shift;
            holds = L::and(holds, zero.less(pivot));
            for j in i + 1..NX {
                let share = p[i][j] / pivot;
                for k in j..NX {
                    p[j][k] = p[j][k] - share * p[i][k];
                }
            }
        }
        holds
    }

    /// Sets 2P from P. Where P is finite, symmetric to rounding and positive semidefinite to rounding.
    #[inline(always)]
    fn start_terminal(&mut self) -> L::Mask {
        let zero = L::splat(0.0);
        let (mut size, mut skew, mut sum) = (zero, zero, zero);
        for i in 0..NX {
            for j in 0..NX {
                sum = sum + self.p[j][i];
            }
            for j in i..NX {
                let above = self.p[i][j];
                size = above.abs().greater(size);
                skew = (above - self.p[j][i]).abs().greater(skew);
                self.terminal[i][j] = L::splat(2.0) * above;
            }
        }
        // A NaN is dropped by `greater`; it makes the sum NaN.
        let is_finite = sum.abs().less(L::splat(f64::INFINITY));
        let is_symmetric = L::not((L::splat(1e-9) * size).less(skew));
        L::and(
            L::and(is_finite, is_symmetric),
            self.terminal_is_semidefinite(),
        )
    }
}

/// Rows of Aᵀ and Bᵀ.
struct Rows<L> {
    model: Model<L>,
    at: Expansion<L>,
}

impl<L: Lanes> Rows<L> {
    /// Row of Bᵀ by v_c, times `y`.
    #[inline(always)]
    fn by_v<const NX: usize>(&self, y: &[L; NX]) -> L {
        let mean = dot(&[y[0], y[1], y[2]], &self.at.by_v);
        if NX == 5 {
            self.model.rest * mean + self.model.gone * y[3]
        } else {
            mean
        }
    }

    /// Row of Bᵀ by q_c, times `y`.
    #[inline(always)]
    fn by_q<const NX: usize>(&self, y: &[L; NX]) -> L {
        let top = dot(&[y[0], y[1], y[2]], &self.at.by_q);
        if NX == 5 {
            top + self.model.gone * y[4]
        } else {
            top
        }
    }

    /// Row of Aᵀ by φ, times `y`.
    #[inline(always)]
    fn by_phi<const NX: usize>(&self, y: &[L; NX]) -> L {
        y[2] + (self.at.way[0] * y[1] - self.at.way[1] * y[0])
    }

    /// Row of Aᵀ by v, times `y`.
    #[inline(always)]
    fn by_state_v<const NX: usize>(&self, y: &[L; NX]) -> L {
        self.model.mean * dot(&[y[0], y[1], y[2]], &self.at.by_v) + self.model.left * y[3]
    }

    /// Row of Aᵀ by q, times `y`.
    #[inline(always)]
    fn by_state_q<const NX: usize>(&self, y: &[L; NX]) -> L {
        dot(&[y[0], y[1], y[2]], &self.at.by_state_q) + self.model.left * y[4]
    }

    /// Aᵀ `y`.
    #[inline(always)]
    fn back<const NX: usize>(&self, y: &[L; NX]) -> [L; NX] {
        let mut result = *y;
        result[2] = self.by_phi(y);
        if NX == 5 {
            result[3] = self.by_state_v(y);
            result[4] = self.by_state_q(y);
        }
        result
    }
}

/// Bounds of q_c with the turn limit, and where it narrows them: as `Problem::roll_bounds`.
#[inline(always)]
fn roll_bounds<L: Lanes, const NX: usize>(
    limit: L,
    lower: L,
    upper: L,
    x: &[L; NX],
    u: &[L; 2],
) -> (L, L, L::Mask) {
    let mut v = u[0].abs();
    if NX == 5 {
        v = v.greater(x[3].abs());
    }
    let v2 = v * v;
    // tan q ≤ 1.36 q for q ≤ π/4 (and tan q ≥ q, so that this asks too often rather than too seldom).
    let widest = upper.greater(-lower);
    let may_bind = limit.less(v2 * (widest * L::splat(1.36)));
    if !L::any(may_bind) {
        return (lower, upper, L::mask(false));
    }
    let roll = atan(limit / v2);
    let is_narrow = L::and(may_bind, roll.less(widest));
    let least = (-roll).greater(lower).lesser(upper);
    let most = roll.lesser(upper).greater(lower);
    (
        least.or(is_narrow, lower),
        most.or(is_narrow, upper),
        is_narrow,
    )
}

/// Element (i, j) of a symmetric matrix of which the upper triangle is kept.
#[inline(always)]
fn entry<L: Lanes, const NX: usize>(p: &[[L; NX]; NX], i: usize, j: usize) -> L {
    if i <= j { p[i][j] } else { p[j][i] }
}

#[inline(always)]
fn dot<L: Lanes>(a: &[L; 3], b: &[L; 3]) -> L {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// Least pivot of Q_uu, that of `riccati`.
const PIVOT_MIN: f64 = 1e-9;
/// What rounding leaves beside a bound [m/s, rad].
const ROUNDING: f64 = 1e-12;
