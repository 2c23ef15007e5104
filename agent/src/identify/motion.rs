//! How the robot moved, from its raw sensors: an offline smoother, without delay and without any parameter but R and g.
//!
//! The gyro, integrated, gives each angle but for a slow error (its bias and the random walk of its noise); the specific force, with
//! the acceleration of the centre taken off, gives the angle at every sample but for white noise. Their difference is that slow
//! error: a straight line in time, and what is left of it averaged over [`SMOOTHING`] to *both* sides. So nothing lags, and the
//! rates are the gyro's own, which the momenta want unfiltered.

use super::log::Sample;

/// Motion at one sample. Names and signs are those of `RobotState`.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Motion {
    pub(super) at: f64,
    pub(super) alpha: f64,
    pub(super) alpha_rate: f64,
    pub(super) q_r: f64,
    pub(super) q_r_rate: f64,
    pub(super) v: f64,
    pub(super) theta_r: f64,
    pub(super) theta_r_rate: f64,
    pub(super) theta_p_rate: f64,
    /// Smooth signs of θ̇_p and θ̇_r, for Coulomb friction [1].
    pub(super) pitch_sign: f64,
    pub(super) roll_sign: f64,
    /// Angle of the shell, φ_s [rad].
    pub(super) phi_s: f64,
    /// Yaw since the first sample [rad].
    pub(super) heading: f64,
}

/// Time to each side over which the slow error is averaged [s]: where the random walk of 0.3 °/s at 200 Hz and the noise of
/// 0.05 m/s² weigh alike; 0.02° are left.
const SMOOTHING: f64 = 1.0;
/// Rate over which Coulomb friction changes its sign [rad/s].
const COULOMB_RATE: f64 = 0.05;
/// The angles enter their own corrections: so often these are made.
const ROUNDS: usize = 6;

/// The motion at each sample, for a sphere of `radius` [m] under gravity `g` [m/s²].
pub(super) fn smooth(samples: &[Sample], radius: f64, g: f64) -> Vec<Motion> {
    let at: Vec<f64> = samples.iter().map(|sample| sample.at).collect();
    let theta_r_rate = rates(&at, samples.iter().map(|sample| sample.theta_r).collect());
    let theta_p_rate = rates(&at, samples.iter().map(|sample| sample.theta_p).collect());
    let (pitch_sign, roll_sign) = (signs(&theta_p_rate), signs(&theta_r_rate));
    let mut motion: Vec<Motion> = (0..samples.len())
        .map(|i| Motion {
            at: at[i],
            theta_r: samples[i].theta_r,
            theta_r_rate: theta_r_rate[i],
            theta_p_rate: theta_p_rate[i],
            pitch_sign: pitch_sign[i],
            roll_sign: roll_sign[i],
            ..Motion::default()
        })
        .collect();
    for _ in 0..ROUNDS {
        correct(samples, &at, &mut motion, radius, g);
    }
    let mut heading = 0.0;
    for i in 0..motion.len() {
        let yaw_rate = |m: &Motion| m.v * m.q_r.tan() / radius;
        if i > 0 {
            let mean = 0.5 * (yaw_rate(&motion[i - 1]) + yaw_rate(&motion[i]));
            heading += mean * (at[i] - at[i - 1]);
        }
        motion[i].heading = heading;
        motion[i].phi_s = samples[i].theta_p - motion[i].alpha;
    }
    motion
}

/// One round: angles and rates from the gyro, then what the specific force says of their error.
fn correct(samples: &[Sample], at: &[f64], motion: &mut [Motion], radius: f64, g: f64) {
    for (sample, m) in samples.iter().zip(motion.iter_mut()) {
        let [forward, left, up] = sample.gyro;
        let (sin, cos) = m.alpha.sin_cos();
        m.q_r_rate = up * sin - forward * cos;
        // v is linear in α̇, and φ̇ in v: α̇ = −ω_y − φ̇ sin q_r solved for it.
        let (sin_q, tan_q) = (m.q_r.sin(), m.q_r.tan());
        let share = m.q_r.cos() * sin_q * tan_q;
        m.alpha_rate = (-left - share * m.theta_p_rate) / (1.0 - share);
        m.v = radius * m.q_r.cos() * (m.theta_p_rate - m.alpha_rate);
    }
    let alpha_rate: Vec<f64> = motion.iter().map(|m| m.alpha_rate).collect();
    let q_r_rate: Vec<f64> = motion.iter().map(|m| m.q_r_rate).collect();
    let (alpha, q_r) = (integral(at, &alpha_rate), integral(at, &q_r_rate));
    let v_rate = rates(at, motion.iter().map(|m| m.v).collect());
    let q_r_accel = rates(at, q_r_rate);
    let (mut alpha_error, mut q_r_error) = (Vec::new(), Vec::new());
    for (i, (sample, m)) in samples.iter().zip(motion.iter()).enumerate() {
        let ((sa, ca), (sq, cq)) = (m.alpha.sin_cos(), m.q_r.sin_cos());
        let yaw_rate = m.v * sq / cq / radius;
        // The centre accelerates by v̇ − R q̇_r φ̇ forward and R q̈_r + v φ̇ to the left.
        let ahead = v_rate[i] - radius * m.q_r_rate * yaw_rate;
        let aside = radius * q_r_accel[i] + m.v * yaw_rate;
        let level = sq * aside + cq * g;
        let missing = sample.accel[0] - ca * ahead - sa * level;
        alpha_error.push(m.alpha - alpha[i] + missing / (ca * level - sa * ahead));
        // Along the left axis; v φ̇ grows with the roll itself.
        let missing = sample.accel[1] - cq * aside + sq * g;
        let per_roll = m.v * m.v / (radius * cq) - sq * aside - cq * g;
        q_r_error.push(m.q_r - q_r[i] + missing / per_roll);
    }
    let (alpha_error, alpha_drift) = slow(at, &alpha_error);
    let (q_r_error, q_r_drift) = slow(at, &q_r_error);
    for (i, m) in motion.iter_mut().enumerate() {
        m.alpha = alpha[i] + alpha_error[i];
        m.alpha_rate += alpha_drift;
        m.q_r = q_r[i] + q_r_error[i];
        m.q_r_rate += q_r_drift;
        m.v = radius * m.q_r.cos() * (m.theta_p_rate - m.alpha_rate);
    }
}

/// Derivatives of the polynomials through five samples in a row: central differences would take 1 % off a motion of 6 Hz at 200 Hz
/// and make inertias too large by it.
fn rates(at: &[f64], values: Vec<f64>) -> Vec<f64> {
    let count = values.len();
    (0..count)
        .map(|i| {
            let first = i.saturating_sub(2).min(count.saturating_sub(5));
            let nodes = first..(first + 5).min(count);
            let others = |j: usize| nodes.clone().filter(move |k| *k != j);
            nodes
                .clone()
                .filter(|j| *j != i)
                .map(|j| {
                    let above: f64 = others(j)
                        .filter(|k| *k != i)
                        .map(|k| at[i] - at[k])
                        .product();
                    let below: f64 = others(j).map(|k| at[j] - at[k]).product();
                    // The weights sum to zero: differences keep the digits of large angles.
                    above / below * (values[j] - values[i])
                })
                .sum()
        })
        .collect()
}

/// tanh(rate/[`COULOMB_RATE`]) of rates averaged with binomial weights: the tanh would make a bias of the encoder's noise.
fn signs(rates: &[f64]) -> Vec<f64> {
    const WEIGHTS: [f64; 7] = [1.0, 6.0, 15.0, 20.0, 15.0, 6.0, 1.0];
    let last = rates.len().saturating_sub(1);
    (0..rates.len())
        .map(|i| {
            let near = |k: usize| rates[(i + k).saturating_sub(3).min(last)];
            let sum: f64 = WEIGHTS.iter().enumerate().map(|(k, w)| w * near(k)).sum();
            (sum / 64.0 / COULOMB_RATE).tanh()
        })
        .collect()
}

/// By the trapezoidal rule, from 0.
fn integral(at: &[f64], rate: &[f64]) -> Vec<f64> {
    let mut sum = 0.0;
    (0..at.len())
        .map(|i| {
            if i > 0 {
                sum += 0.5 * (rate[i - 1] + rate[i]) * (at[i] - at[i - 1]);
            }
            sum
        })
        .collect()
}

/// The slow part of `values`, and the slope of the straight line in it: the line, and the rest averaged with e^(−|Δt|/τ).
fn slow(at: &[f64], values: &[f64]) -> (Vec<f64>, f64) {
    let n = values.len() as f64;
    let (mean_t, mean) = (at.iter().sum::<f64>() / n, values.iter().sum::<f64>() / n);
    let (mut cross, mut square) = (0.0, 0.0);
    for (t, value) in at.iter().zip(values) {
        cross += (t - mean_t) * (value - mean);
        square += (t - mean_t) * (t - mean_t);
    }
    let slope = cross / square;
    let line = |t: f64| mean + slope * (t - mean_t);
    let rest: Vec<f64> = at.iter().zip(values).map(|(t, x)| x - line(*t)).collect();
    let (mut sums, mut weights) = (vec![0.0; rest.len()], vec![0.0; rest.len()]);
    let mut pass = |order: &mut dyn Iterator<Item = usize>| {
        let (mut sum, mut weight, mut before) = (0.0, 0.0, None);
        for i in order {
            let kept = before.map_or(0.0, |t: f64| (-(t - at[i]).abs() / SMOOTHING).exp());
            (sum, weight) = (kept * sum, kept * weight);
            // The sample itself counts half each way.
            sums[i] += sum + 0.5 * rest[i];
            weights[i] += weight + 0.5;
            (sum, weight, before) = (sum + rest[i], weight + 1.0, Some(at[i]));
        }
    };
    pass(&mut (0..rest.len()));
    pass(&mut (0..rest.len()).rev());
    let smoothed = (0..rest.len())
        .map(|i| line(at[i]) + sums[i] / weights[i])
        .collect();
    (smoothed, slope)
}
