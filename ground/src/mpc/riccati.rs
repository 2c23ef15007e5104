//! The subproblem by Riccati sweeps with a primal-dual active set.
//!
//! One sweep takes the active set as equalities: backwards the value function ½ δxᵀPδx + pᵀδx of each stage, forwards the step
//! and the multipliers. An input beyond a bound enters the set, one whose multiplier has the wrong sign leaves it, all at
//! once; the same with half-planes that the step enters or leaves. No change: solved. The set of the last solve is the first
//! guess of the next, so that most solves take one sweep.
//!
//! P is symmetrised at every stage: rounding alone, left to grow, ends in NaN and a robot that stands still.

use nalgebra::{SMatrix, SVector, Vector2};

use super::subproblem::{Hessian, Step, Subproblem};

/// Which bound holds an input.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Active {
    /// None.
    Free,
    /// Its lower bound.
    Lower,
    /// Its upper bound.
    Upper,
}

/// Why the sweeps gave no step.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum RiccatiError {
    /// Q_uu is not positive definite (or not finite): without the curvature it would be.
    NotPositive,
    /// The active set still changes after [`SWEEPS_MAX`].
    Cycling,
}

/// Buffers of the sweeps; the active set and the gains outlive a solve.
#[derive(Clone, Debug)]
pub(super) struct Riccati<const NX: usize> {
    /// Active set of the inputs, N rows.
    pub(super) active: Vec<[Active; 2]>,
    /// Feedback δu = K δx + k, N rows; a row of K is zero where a bound holds the input.
    stages: Vec<Feedback<NX>>,
}

#[derive(Clone, Debug)]
struct Feedback<const NX: usize> {
    k: Vector2<f64>,
    gain: SMatrix<f64, 2, NX>,
    /// Gradient of the cost-to-go by δu: h + Hux δx + Huu δu.
    h: Vector2<f64>,
    hux: SMatrix<f64, 2, NX>,
    huu: SMatrix<f64, 2, 2>,
    /// Value function of xₖ₊₁.
    p: SVector<f64, NX>,
    pp: SMatrix<f64, NX, NX>,
}

impl<const NX: usize> Riccati<NX> {
    pub(super) fn new(horizon: usize) -> Self {
        let feedback = Feedback {
            k: Vector2::zeros(),
            gain: SMatrix::zeros(),
            h: Vector2::zeros(),
            hux: SMatrix::zeros(),
            huu: SMatrix::zeros(),
            p: SVector::zeros(),
            pp: SMatrix::zeros(),
        };
        Self {
            active: vec![[Active::Free; 2]; horizon],
            stages: vec![feedback; horizon],
        }
    }

    /// Feedback gain of stage `k`, 2 × NX.
    pub(super) fn gain(&self, k: usize) -> &SMatrix<f64, 2, NX> {
        &self.stages[k].gain
    }

    /// Solves `subproblem`, with `hessian`, and writes the step.
    pub(super) fn solve(
        &mut self,
        subproblem: &mut Subproblem<NX>,
        hessian: Hessian,
        step: &mut Step<NX>,
    ) -> Result<(), RiccatiError> {
        for _ in 0..SWEEPS_MAX {
            self.backward(subproblem, hessian)?;
            if !self.forward(subproblem, step) {
                return Ok(());
            }
        }
        Err(RiccatiError::Cycling)
    }

    /// Value functions and feedback for the active set as it stands.
    pub(super) fn backward(
        &mut self,
        subproblem: &Subproblem<NX>,
        hessian: Hessian,
    ) -> Result<(), RiccatiError> {
        let horizon = self.stages.len();
        let exact = hessian == Hessian::Exact;
        let mut pp = SMatrix::zeros();
        let mut p = SVector::zeros();
        add_state_cost(subproblem, horizon, &mut pp, &mut p);
        for i in (0..horizon).rev() {
            let stage = &subproblem.stages[i];
            let feedback = &mut self.stages[i];
            feedback.pp = pp;
            feedback.p = p;
            let pa = stage.times_a(&pp);
            let pb = pp * stage.b;
            let pc = p + pp * stage.c;
            let mut huu = stage.b.tr_mul(&pb);
            let mut hux = stage.b.tr_mul(&pa);
            let h = stage.u_gradient + stage.b.tr_mul(&pc);
            huu[(0, 0)] += subproblem.input_weight[0];
            huu[(1, 1)] += subproblem.input_weight[1];
            if exact {
                huu += stage.curvature.uu;
                hux += stage.curvature.ux;
            }
            (feedback.h, feedback.hux, feedback.huu) = (h, hux, huu);
            let mut fixed = Vector2::zeros();
            for j in 0..2 {
                match self.active[i][j] {
                    Active::Free => {}
                    Active::Lower => fixed[j] = stage.du_min[j],
                    Active::Upper => fixed[j] = stage.du_max[j],
                }
            }
            feedback.close(self.active[i], fixed)?;
            if i == 0 {
                break; // δx₀ = 0: its value function is of no use.
            }
            // P = W + AᵀPA + KᵀHux, p = w + Aᵀ(p + Pc) + Huxᵀk: with K and k of a fixed input this holds as well.
            let mut next = stage.a_transposed_times(&pa) + feedback.gain.tr_mul(&hux);
            if exact {
                next += stage.curvature.xx;
            }
            pp = (next + next.transpose()) * 0.5;
            p = stage.a.tr_mul(&pc) + hux.tr_mul(&feedback.k);
            add_state_cost(subproblem, i, &mut pp, &mut p);
        }
        Ok(())
    }

    /// The step from the feedback, and the next active set; whether it changed.
    fn forward(&mut self, subproblem: &mut Subproblem<NX>, step: &mut Step<NX>) -> bool {
        let mut changed = false;
        let mut dx = SVector::zeros();
        for (i, feedback) in self.stages.iter().enumerate() {
            let stage = &subproblem.stages[i];
            let du = feedback.gain * dx + feedback.k;
            for j in 0..2 {
                // Gradient of the cost-to-go: of interest where a bound holds the input.
                let gradient = || {
                    feedback.h[j]
                        + feedback.hux.row(j).tr_dot(&dx)
                        + feedback.huu.row(j).tr_dot(&du)
                };
                let next = match self.active[i][j] {
                    Active::Free if du[j] < stage.du_min[j] - SLACK => Active::Lower,
                    Active::Free if du[j] > stage.du_max[j] + SLACK => Active::Upper,
                    // Minimum at the lower bound: the cost rises inwards.
                    Active::Lower if gradient() < -SLACK => Active::Free,
                    Active::Upper if gradient() > SLACK => Active::Free,
                    same => same,
                };
                changed |= next != self.active[i][j];
                self.active[i][j] = next;
            }
            dx = stage.a * dx + stage.b * du + stage.c;
            step.du[i] = du;
            step.dx[i + 1] = dx;
            step.lambda[i] = feedback.pp * dx + feedback.p;
            for plane in &mut subproblem.planes[i + 1] {
                let gap = plane.gap + plane.normal[0] * dx[0] + plane.normal[1] * dx[1];
                let active = if plane.active {
                    gap < SLACK
                } else {
                    gap < -SLACK
                };
                changed |= active != plane.active;
                plane.active = active;
            }
        }
        changed
    }
}

impl<const NX: usize> Feedback<NX> {
    /// Minimises the stage over the free inputs: K and k, with `fixed` for the others.
    fn close(&mut self, active: [Active; 2], fixed: Vector2<f64>) -> Result<(), RiccatiError> {
        let free = active.map(|active| active == Active::Free);
        self.k = fixed;
        self.gain = SMatrix::zeros();
        let huu = &self.huu;
        if free == [true, true] {
            let det = huu[(0, 0)] * huu[(1, 1)] - huu[(0, 1)] * huu[(1, 0)];
            // Written so that NaN fails too.
            if !(huu[(0, 0)] > PIVOT_MIN && det > PIVOT_MIN * huu[(0, 0)]) {
                return Err(RiccatiError::NotPositive);
            }
            let inverse =
                SMatrix::<f64, 2, 2>::new(huu[(1, 1)], -huu[(0, 1)], -huu[(1, 0)], huu[(0, 0)])
                    / det;
            self.k = -(inverse * self.h);
            self.gain = -(inverse * self.hux);
        } else {
            for j in 0..2 {
                if free[j] {
                    if huu[(j, j)].is_nan() || huu[(j, j)] <= PIVOT_MIN {
                        return Err(RiccatiError::NotPositive);
                    }
                    self.k[j] = -(self.h[j] + huu[(j, 1 - j)] * fixed[1 - j]) / huu[(j, j)];
                    self.gain.set_row(j, &(-self.hux.row(j) / huu[(j, j)]));
                }
            }
        }
        Ok(())
    }
}

/// Adds the cost of state `k` and of its active half-planes to a value function.
fn add_state_cost<const NX: usize>(
    subproblem: &Subproblem<NX>,
    k: usize,
    pp: &mut SMatrix<f64, NX, NX>,
    p: &mut SVector<f64, NX>,
) {
    if k > subproblem.last {
        return;
    }
    if k == subproblem.last {
        *pp += subproblem.terminal;
    } else {
        for j in 0..NX {
            pp[(j, j)] += subproblem.weight[j];
        }
    }
    *p += subproblem.x_gradient[k];
    for plane in subproblem.planes[k].iter().filter(|plane| plane.active) {
        for row in 0..2 {
            p[row] += plane.weight * plane.gap * plane.normal[row];
            for column in 0..2 {
                pp[(row, column)] += plane.weight * plane.normal[row] * plane.normal[column];
            }
        }
    }
}

/// Sweeps before the active set counts as cycling.
const SWEEPS_MAX: usize = 16;
/// Least pivot of Q_uu; weights are of the order 1.
const PIVOT_MIN: f64 = 1e-9;
/// Rounding allowed to a bound [m/s, rad, m] and to a multiplier before the active set changes.
const SLACK: f64 = 1e-12;
