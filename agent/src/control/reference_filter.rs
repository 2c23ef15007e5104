//! Filters that make a smooth reference of what an operator types: a roll step, a speed step (E12).
//!
//! For typed steps only. In tracking the reference is shaped by the planner's own lag, and an analytic reference bypasses any
//! filter: one that the planner does not know brings limit cycles and falls.

use super::hsmc::SpeedShape;

/// Second-order critically damped filter of a roll command: q̈ = w² (command − q) − 2 w q̇, solved exactly over a step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RollFilter {
    command: f64,
    filter: CriticallyDamped,
}

/// Ramp of a speed command at [`SPEED_RAMP`], then a filter like [`RollFilter`], so that the pendulum's target has its derivatives.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SpeedFilter {
    command: f64,
    ramped: f64,
    filter: CriticallyDamped,
}

/// A filtered roll: fields of the same meaning as in `Setpoint`.
#[derive(Clone, Copy, Debug, PartialEq, Default)]
pub struct RollReference {
    /// q_rd [rad].
    pub q_r: f64,
    /// q̇_rd [rad/s].
    pub q_r_rate: f64,
    /// q̈_rd [rad/s²].
    pub q_r_accel: f64,
}

/// A filtered speed, with the derivatives that the pendulum's target needs.
#[derive(Clone, Copy, Debug, PartialEq, Default)]
pub struct SpeedReference {
    /// v_d [m/s].
    pub v: f64,
    /// v̇_d [m/s²].
    pub v_rate: f64,
    /// v̈_d and its derivative.
    pub shape: SpeedShape,
}

/// ÿ = w² (u − y) − 2 w ẏ.
#[derive(Clone, Copy, Debug, PartialEq)]
struct CriticallyDamped {
    w: f64, // [rad/s]
    y: f64,
    y_rate: f64,
}

impl RollFilter {
    /// A filter of bandwidth `w_ref` [rad/s] (> 0), at rest at `q_r` [rad].
    pub fn new(w_ref: f64, q_r: f64) -> Self {
        Self {
            command: q_r,
            filter: CriticallyDamped::at_rest(w_ref, q_r),
        }
    }

    /// The reference `dt` [s] later, `command` [rad] held meanwhile. A command that is not finite leaves the last one in force.
    pub fn step(&mut self, command: f64, dt: f64) -> RollReference {
        if command.is_finite() {
            self.command = command;
        }
        if is_step(dt) {
            self.filter.advance(self.command, 0.0, dt);
        }
        RollReference {
            q_r: self.filter.y,
            q_r_rate: self.filter.y_rate,
            q_r_accel: self.filter.accel(self.command),
        }
    }
}

impl SpeedFilter {
    /// A filter at the constant speed `v` [m/s].
    pub fn new(v: f64) -> Self {
        Self {
            command: v,
            ramped: v,
            filter: CriticallyDamped::at_rest(SPEED_BANDWIDTH, v),
        }
    }

    /// The reference `dt` [s] later, `command` [m/s] held meanwhile. A command that is not finite leaves the last one in force.
    pub fn step(&mut self, command: f64, dt: f64) -> SpeedReference {
        if command.is_finite() {
            self.command = command;
        }
        let mut slope = 0.0;
        if is_step(dt) {
            // The ramp may arrive within the step: two pieces, each exact.
            let way = self.command - self.ramped;
            let ramping = (way.abs() / SPEED_RAMP).min(dt);
            slope = SPEED_RAMP.copysign(way);
            self.filter.advance(self.ramped, slope, ramping);
            if ramping < dt {
                self.ramped = self.command;
                slope = 0.0;
                self.filter.advance(self.ramped, slope, dt - ramping);
            } else {
                self.ramped += slope * ramping;
            }
        }
        let w = self.filter.w;
        let accel_rate = self.filter.accel(self.ramped);
        SpeedReference {
            v: self.filter.y,
            v_rate: self.filter.y_rate,
            shape: SpeedShape {
                accel_rate,
                accel_rate_rate: w * w * (slope - self.filter.y_rate) - 2.0 * w * accel_rate,
            },
        }
    }
}

impl CriticallyDamped {
    fn at_rest(w: f64, y: f64) -> Self {
        Self { w, y, y_rate: 0.0 }
    }

    /// `dt` further under the input u = `u0` + `slope` t: y = u₀ + s t − 2 s/w + (x₀ + k t) e^(−w t), k = ẋ₀ + w x₀.
    fn advance(&mut self, u0: f64, slope: f64, dt: f64) {
        let w = self.w;
        let lag = 2.0 * slope / w;
        let x0 = self.y - u0 + lag;
        let x0_rate = self.y_rate - slope;
        let k = x0_rate + w * x0;
        let decay = (-w * dt).exp();
        self.y = u0 + slope * dt - lag + (x0 + k * dt) * decay;
        self.y_rate = slope + (x0_rate - w * k * dt) * decay;
    }

    fn accel(&self, u: f64) -> f64 {
        self.w * self.w * (u - self.y) - 2.0 * self.w * self.y_rate
    }
}

/// Slope of a typed speed step [m/s²]: the pendulum stays below 0.3 rad.
pub const SPEED_RAMP: f64 = 0.3;

/// Bandwidth of the filter behind the ramp [rad/s]: it adds 0.2 s, and 0 to 0.5 m/s overshoots by 5 mm/s instead of 44.
const SPEED_BANDWIDTH: f64 = 10.0;

fn is_step(dt: f64) -> bool {
    dt.is_finite() && dt > 0.0
}
