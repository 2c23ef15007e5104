//! What takes energy out of the plant: bearings, gearboxes and the floor.

/// Rate over which Coulomb friction reaches tanh(1) of its value [rad/s]: a smooth sign, so that a fixed step can integrate it.
const COULOMB_RATE: f64 = 0.05;

/// Rate by which the excess of a sticking joint has gone [rad/s].
const STRIBECK_RATE: f64 = 0.2;

/// Keeps the division by the shell's rate defined at rest, where the resistance itself is zero [rad/s].
const REST_RATE: f64 = 1e-9;

/// Torque of a joint against its own rate [N·m]: ζ ω + (τ_c + τ_s e^(−(ω/ω_s)²)) tanh(ω / 0.05 rad/s), of the sign of `rate`; τ_s is
/// the Stribeck excess of a joint that sticks, ω_s = 0.2 rad/s.
///
/// Bearing damping acts on the *relative* rate of the two bodies that the motor joins (E13), not on ẋ cos α as the paper prints.
/// `zeta` [N·m·s/rad], `coulomb` and `stiction` [N·m], `rate` [rad/s].
pub fn joint(zeta: f64, coulomb: f64, stiction: f64, rate: f64) -> f64 {
    let viscous = zeta * rate;
    let mut dry = coulomb;
    if stiction != 0.0 {
        let share = rate / STRIBECK_RATE;
        dry += stiction * (-share * share).exp();
    }
    if dry == 0.0 {
        return viscous;
    }
    viscous + dry * tanh(rate / COULOMB_RATE)
}

/// Rolling resistance: the force against `v` [N] and the torque against `q_r_rate` [N·m], each of the sign of its rate.
///
/// The contact resists the shell's rolling rate ω = √(v² + R² q̇_r²)/R with the torque T = c_rr N R tanh(ω R/v_rr), along the
/// direction of rolling: T v/(R² ω) on row v, T q̇_r/ω on row q_r.
/// `c_rr` [1], `normal` force N [N], `radius` R [m], `v_rr` [m/s], `v` [m/s], `q_r_rate` [rad/s].
pub fn rolling_resistance(
    c_rr: f64,
    normal: f64,
    radius: f64,
    v_rr: f64,
    v: f64,
    q_r_rate: f64,
) -> (f64, f64) {
    let sideways = radius * q_r_rate;
    let speed = (v * v + sideways * sideways).sqrt();
    let omega = speed / radius;
    let per_rate = c_rr * normal * radius * tanh(speed / v_rr) / (omega + REST_RATE);
    (per_rate * v / (radius * radius), per_rate * q_r_rate)
}

/// tanh to within 2e-16 absolute, exactly odd; at half the cost of the library's, which is exact in the last digits near zero, where
/// friction vanishes anyway.
fn tanh(x: f64) -> f64 {
    (1.0 - 2.0 / ((2.0 * x.abs()).exp() + 1.0)).copysign(x)
}
