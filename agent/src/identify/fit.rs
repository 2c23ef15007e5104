//! Weighted least squares on the filtered momentum equations.
//!
//! Between two samples, p(t₂) − p(t₁) = ∫ (c + Q) dt holds for any motion; averaged under a bell of half-width [`BELL`] on both sides
//! it needs no derivative of a noisy signal, and the same filter on both sides biases nothing. What is not linear is solved by
//! Gauss-Newton: the delay of the torques, and the constant errors of the three angles that a bias of the accelerometer and the
//! encoder's zero make.

use nalgebra::{Matrix4, SMatrix, SVector};
use sphere_protocol::robot::RobotParams;

use super::log::{Log, Sample};
use super::momentum::{Row, Terms, place, terms};
use super::motion::{Motion, smooth};
use super::torque::mean_torques;

/// Unknowns: those of [`place`], then delay and lag of the motors [s], and the errors of α, q_r, θ_r [rad].
pub(super) const UNKNOWNS: usize = place::COUNT + 5;
/// Where the delay stands.
pub(super) const DELAY: usize = place::COUNT;
/// Where the lag stands.
pub(super) const LAG: usize = place::COUNT + 1;
/// Where the error of α stands; those of q_r and θ_r follow.
pub(super) const ANGLES: usize = place::COUNT + 2;

pub(super) type Unknowns = SVector<f64, UNKNOWNS>;
pub(super) type Covariance = SMatrix<f64, UNKNOWNS, UNKNOWNS>;

/// Half-width of the averaging bell [s].
const BELL: f64 = 0.1;
/// Time from one averaged equation to the next [s].
const STRIDE: f64 = 0.05;
/// Over this time residuals may be alike [s]: the smoother's averaging to both sides, and a turn of the shell.
const CORRELATION: f64 = 3.0;
const ITERATIONS: usize = 6;

/// What a fit came to.
#[derive(Clone, Debug)]
pub(super) struct Fit {
    pub(super) x: Unknowns,
    /// Honest to correlation between residuals.
    pub(super) covariance: Covariance,
    /// As if residuals were independent, of the size that was found.
    pub(super) independent: Covariance,
    /// Root mean square of each row's residuals and of its torque [N·m].
    pub(super) residual_rms: [f64; 4],
    pub(super) torque_rms: [f64; 4],
    /// How many averaged equations of each row.
    pub(super) equations: usize,
    pub(super) excitation: Excitation,
}

/// How much the robot moved, averaged as the equations are.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Excitation {
    /// Root mean square of β̇ [rad/s].
    pub(super) beta_rate: f64,
    /// Root mean square of α̇ [rad/s].
    pub(super) alpha_rate: f64,
    /// Lowest and highest speed [m/s].
    pub(super) speeds: [f64; 2],
}

/// Coefficients of one averaged equation, rows (α, φ, β, q_r).
type Equation = [Row; 4];

/// Fits the unknowns to a log; `prior` and `sigma` say what is known of them beforehand.
pub(super) fn fit(log: &Log, params: &RobotParams, prior: &Unknowns, sigma: &Unknowns) -> Fit {
    let samples = &log.samples;
    let motion = smooth(samples, params.r, params.g);
    let bells = Bells::over(samples, log);
    let mut x = *prior;
    let mut weight = Matrix4::identity();
    let mut information = Covariance::zeros();
    let mut residuals = Vec::new();
    let mut jacobian: Vec<[Unknowns; 4]> = Vec::new();
    for iteration in 0..ITERATIONS {
        let setup = Setup {
            log,
            params,
            motion: &motion,
            bells: &bells,
        };
        (residuals, jacobian) = setup.linearise(&x);
        if iteration > 0 {
            weight = weights(&residuals);
        }
        information = prior_information(sigma);
        let mut gradient = information * (prior - x);
        for (r, rows) in residuals.iter().zip(&jacobian) {
            for i in 0..4 {
                for j in 0..4 {
                    let w = weight[(i, j)];
                    if w != 0.0 {
                        information += w * rows[i] * rows[j].transpose();
                        gradient += w * r[j] * rows[i];
                    }
                }
            }
        }
        let Some(solved) = information.cholesky() else {
            break;
        };
        x += solved.solve(&gradient);
    }
    let independent = information
        .cholesky()
        .map_or_else(Covariance::zeros, |c| c.inverse());
    let covariance = sandwich(
        &residuals,
        &jacobian,
        &weight,
        &independent,
        sigma,
        bells.stride(),
    );
    let torque = Setup {
        log,
        params,
        motion: &motion,
        bells: &bells,
    }
    .torques(&x);
    Fit {
        x,
        covariance,
        independent,
        residual_rms: rms(&residuals),
        torque_rms: rms(&torque),
        equations: residuals.len(),
        excitation: bells.excitation(&motion),
    }
}

fn prior_information(sigma: &Unknowns) -> Covariance {
    Covariance::from_diagonal(&sigma.map(|s| 1.0 / (s * s)))
}

fn rms(rows: &[[f64; 4]]) -> [f64; 4] {
    core::array::from_fn(|i| {
        (rows.iter().map(|row| row[i] * row[i]).sum::<f64>() / rows.len().max(1) as f64).sqrt()
    })
}

/// Inverse of the residuals' variances.
fn weights(residuals: &[[f64; 4]]) -> Matrix4<f64> {
    Matrix4::from_diagonal(&rms(residuals).map(|s| 1.0 / (s * s + 1e-6)).into())
}

/// H⁻¹ (Σ_l w_l Γ_l) H⁻¹ with Bartlett's weights over [`CORRELATION`].
fn sandwich(
    residuals: &[[f64; 4]],
    jacobian: &[[Unknowns; 4]],
    weight: &Matrix4<f64>,
    inverse: &Covariance,
    sigma: &Unknowns,
    stride: f64,
) -> Covariance {
    let scores: Vec<Unknowns> = residuals
        .iter()
        .zip(jacobian)
        .map(|(r, rows)| {
            let mut score = Unknowns::zeros();
            for i in 0..4 {
                for j in 0..4 {
                    score += weight[(i, j)] * r[j] * rows[i];
                }
            }
            inverse * score
        })
        .collect();
    let lags = (CORRELATION / stride).ceil() as usize;
    let mut covariance = Covariance::zeros();
    for lag in 0..=lags.min(scores.len().saturating_sub(1)) {
        let share = 1.0 - lag as f64 / (lags + 1) as f64;
        let mut sum = Covariance::zeros();
        for (early, late) in scores.iter().zip(&scores[lag..]) {
            sum += late * early.transpose();
        }
        covariance += if lag == 0 {
            sum
        } else {
            share * (sum + sum.transpose())
        };
    }
    covariance + inverse * prior_information(sigma) * inverse
}

struct Setup<'a> {
    log: &'a Log,
    params: &'a RobotParams,
    motion: &'a [Motion],
    bells: &'a Bells,
}

impl Setup<'_> {
    /// Residuals and their negative derivatives at `x`: right − left, ∂left/∂x.
    fn linearise(&self, x: &Unknowns) -> (Vec<[f64; 4]>, Vec<[Unknowns; 4]>) {
        const ANGLE_STEP: f64 = 1e-4;
        const DELAY_STEP: f64 = 5e-4;
        let theta = x.fixed_rows::<{ place::COUNT }>(0).into_owned();
        let angles = [x[ANGLES], x[ANGLES + 1], x[ANGLES + 2]];
        let equations = self.equations(angles);
        let torques = self.torques(x);
        let left = |equations: &[Equation]| -> Vec<[f64; 4]> {
            equations
                .iter()
                .map(|e| core::array::from_fn(|i| e[i].dot(&theta)))
                .collect()
        };
        let here = left(&equations);
        let residuals = here
            .iter()
            .zip(&torques)
            .map(|(left, torque)| core::array::from_fn(|i| torque[i] - left[i]))
            .collect();
        let mut jacobian: Vec<[Unknowns; 4]> = equations
            .iter()
            .map(|e| {
                core::array::from_fn(|i| {
                    let mut row = Unknowns::zeros();
                    row.fixed_rows_mut::<{ place::COUNT }>(0).copy_from(&e[i]);
                    row
                })
            })
            .collect();
        for (unknown, step) in [(DELAY, DELAY_STEP), (LAG, DELAY_STEP)] {
            let mut later = *x;
            later[unknown] += step;
            for ((rows, later), now) in jacobian.iter_mut().zip(self.torques(&later)).zip(&torques)
            {
                for i in 0..4 {
                    rows[i][unknown] = (now[i] - later[i]) / step;
                }
            }
        }
        for angle in 0..3 {
            let mut moved = angles;
            moved[angle] += ANGLE_STEP;
            let there = left(&self.equations(moved));
            for ((rows, there), here) in jacobian.iter_mut().zip(there).zip(&here) {
                for i in 0..4 {
                    rows[i][ANGLES + angle] = (there[i] - here[i]) / ANGLE_STEP;
                }
            }
        }
        (residuals, jacobian)
    }

    /// Averaged coefficients, with constant `errors` of α, q_r and θ_r taken off.
    fn equations(&self, errors: [f64; 3]) -> Vec<Equation> {
        let at_samples: Vec<Terms> = self
            .motion
            .iter()
            .map(|m| {
                let corrected = Motion {
                    alpha: m.alpha - errors[0],
                    q_r: m.q_r - errors[1],
                    theta_r: m.theta_r - errors[2],
                    ..*m
                };
                terms(self.params, &corrected)
            })
            .collect();
        let intervals: Vec<Equation> = at_samples
            .windows(2)
            .zip(self.motion.windows(2))
            .map(|(t, m)| {
                let dt = m[1].at - m[0].at;
                core::array::from_fn(|i| {
                    t[1].momentum[i] - t[0].momentum[i] - 0.5 * dt * (t[0].force[i] + t[1].force[i])
                })
            })
            .collect();
        self.bells.map(|weights, first| {
            let mut sum = [Row::zeros(); 4];
            for (w, e) in weights.iter().zip(&intervals[first..]) {
                for i in 0..4 {
                    sum[i] += *w * e[i];
                }
            }
            sum
        })
    }

    /// Averaged torques on the four rows [N·m].
    fn torques(&self, x: &Unknowns) -> Vec<[f64; 4]> {
        let mean = mean_torques(&self.log.samples, &self.log.torques, x[DELAY], x[LAG]);
        self.bells.map(|weights, first| {
            let mut sum = [0.0; 4];
            for (k, w) in weights.iter().enumerate() {
                let [pitch, roll] = mean[first + k];
                let [from, to] = [&self.motion[first + k], &self.motion[first + k + 1]];
                let impulse = w * (to.at - from.at);
                sum[0] += impulse * pitch;
                sum[1] += impulse * pitch * 0.5 * (1.0 / from.q_r.cos() + 1.0 / to.q_r.cos());
                sum[2] += impulse * roll;
                sum[3] += impulse * roll;
            }
            sum
        })
    }
}

/// Where the averaging bells stand, and their weights [1/s]; each sums to 1 over its time.
struct Bells {
    /// First interval and weights.
    bells: Vec<(usize, Vec<f64>)>,
}

impl Bells {
    /// Bells at equal distances while the motors work.
    fn over(samples: &[Sample], log: &Log) -> Self {
        let works = |t: &&super::log::TorqueAt| t.torque != Default::default();
        let begin = log.torques.iter().find(works).map_or(0.0, |t| t.at);
        let rest = log.torques.iter().rev().find(works).map_or(0.0, |t| t.at);
        let end = log
            .torques
            .iter()
            .map(|t| t.at)
            .find(|at| *at > rest)
            .unwrap_or(log.duration());
        let mut bells = Vec::new();
        // The first torque may come from robots in a cradle; smoothing has one side only at the ends.
        let mut centre = begin.max(0.0) + 0.5 + BELL;
        while centre + BELL < end {
            let first = samples.partition_point(|s| s.at < centre - BELL);
            let last = samples.partition_point(|s| s.at <= centre + BELL);
            let mut weights: Vec<f64> = (first..last.saturating_sub(1))
                .map(|i| {
                    let at = 0.5 * (samples[i].at + samples[i + 1].at);
                    0.5 * (1.0 + (core::f64::consts::PI * (at - centre) / BELL).cos())
                })
                .collect();
            let area: f64 = weights
                .iter()
                .zip(first..)
                .map(|(w, i)| w * (samples[i + 1].at - samples[i].at))
                .sum();
            if area > 0.0 {
                weights.iter_mut().for_each(|w| *w /= area);
                bells.push((first, weights));
            }
            centre += STRIDE;
        }
        Self { bells }
    }

    fn map<T>(&self, mut f: impl FnMut(&[f64], usize) -> T) -> Vec<T> {
        self.bells
            .iter()
            .map(|(first, weights)| f(weights, *first))
            .collect()
    }

    fn excitation(&self, motion: &[Motion]) -> Excitation {
        let mut excitation = Excitation::default();
        let means = self.map(|weights, first| {
            let (mut sum, mut total) = ([0.0; 3], 0.0);
            for (w, m) in weights.iter().zip(&motion[first..]) {
                let values = [m.theta_r_rate - m.q_r_rate, m.alpha_rate, m.v];
                (0..3).for_each(|i| sum[i] += w * values[i]);
                total += w;
            }
            sum.map(|sum| sum / total)
        });
        for [beta_rate, alpha_rate, v] in &means {
            excitation.beta_rate += beta_rate * beta_rate;
            excitation.alpha_rate += alpha_rate * alpha_rate;
            excitation.speeds = [excitation.speeds[0].min(*v), excitation.speeds[1].max(*v)];
        }
        let count = means.len().max(1) as f64;
        excitation.beta_rate = (excitation.beta_rate / count).sqrt();
        excitation.alpha_rate = (excitation.alpha_rate / count).sqrt();
        excitation
    }

    fn stride(&self) -> f64 {
        STRIDE
    }
}
