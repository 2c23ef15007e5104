//! Torque without a plan: armed, an agent follows the braking reference and nothing else.

use sphere_agent::agent::Agent;
use sphere_protocol::message::Mode;

use super::Bounds;

/// The reference at the last control steps.
#[derive(Default)]
pub(super) struct Braking {
    /// Speed reference of the last step, if the robot was armed [m/s].
    v: Option<f64>,
    /// Control steps since a plan was played last.
    steps: u32,
}

impl Braking {
    /// A control step of `agent` is over.
    pub(super) fn on_step(
        &mut self,
        agent: &Agent,
        bounds: &Bounds,
        broken: &mut impl FnMut(&'static str),
    ) {
        let is_braking = matches!(agent.mode(), Mode::Idle | Mode::Holding | Mode::Failsafe);
        let is_armed = is_braking || agent.mode() == Mode::Tracking;
        let signals = agent.signals();
        let setpoint = &signals.setpoint;
        if is_braking {
            self.steps += 1;
            let limits = &bounds.limits;
            let ramp = limits.brake * PERIOD;
            let falls = self.v.is_none_or(|before| {
                let most = (before.abs() - ramp).max(0.0) + ROUNDING;
                setpoint.v.abs() <= most && setpoint.v * before >= 0.0
            });
            // Two lags in a row, the quick one from at most the same roll: 8/7 of it at first, then the slow one's decay.
            let decay = (-f64::from(self.steps) * PERIOD / limits.reference_lag).exp();
            let most = ROLL_FIRST * limits.q_r_max * decay + ROUNDING;
            let decays = setpoint.q_r.abs() <= most;
            if !falls || !decays || signals.command.is_some() {
                broken("braking-reference");
            }
        } else {
            self.steps = 0;
        }
        self.v = is_armed.then_some(setpoint.v);
    }
}

/// Time of a control step [s].
const PERIOD: f64 = 0.02;
/// Of the roll reference, in units of the largest commanded roll: a robot is armed at up to 0.5 rad, 1.43 times 20°, and the quick lag
/// adds a seventh.
const ROLL_FIRST: f64 = 1.7;
const ROUNDING: f64 = 1e-9;
