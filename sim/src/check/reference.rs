//! The reference that the torque controllers follow: within the limits of commands, and without a plan the braking one.

use sphere_agent::agent::Agent;
use sphere_protocol::message::Mode;
use sphere_protocol::robot::Limits;
use sphere_protocol::state::Setpoint;

use super::Bounds;

/// The reference at the last control steps.
#[derive(Default)]
pub(super) struct Reference {
    /// Speed and roll of the last step, if the robot was armed [m/s, rad].
    before: Option<[f64; 2]>,
    /// Control steps since a plan was played last.
    steps: u32,
}

impl Reference {
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
            let falls = self.before.is_none_or(|[before, _]| {
                let most = (before.abs() - ramp).max(0.0) + ROUNDING;
                setpoint.v.abs() <= most && setpoint.v * before >= 0.0
            });
            // Once the command is at zero, the lag's decay.
            let since = (f64::from(self.steps) * PERIOD - COMMAND_TIME).max(0.0);
            let decay = (-since / limits.reference_lag).exp();
            let most = ROLL_FIRST * limits.q_r_max * decay + ROUNDING;
            let decays = setpoint.q_r.abs() <= most;
            if !falls || !decays || signals.command.is_some() {
                broken("braking-reference");
            }
        } else {
            self.steps = 0;
        }
        if agent.mode() == Mode::Tracking && !self.is_within(setpoint, &bounds.limits) {
            broken("command-limit");
        }
        self.before = is_armed.then_some([setpoint.v, setpoint.q_r]);
    }

    /// Whether `setpoint` is within the limits, or nearer to them than before: control begins at whatever the robot does then.
    fn is_within(&self, setpoint: &Setpoint, limits: &Limits) -> bool {
        let [v, q_r] = self.before.unwrap_or([setpoint.v, setpoint.q_r]);
        let roll_max = limits.q_r_max * (1.0 + FILTER_OVERSHOOT);
        setpoint.v >= limits.v_min.min(v) - COMMAND_ROUNDING
            && setpoint.v <= limits.v_max.max(v) + COMMAND_ROUNDING
            && setpoint.q_r.abs() <= roll_max.max(q_r.abs()) + COMMAND_ROUNDING
    }
}

/// Time of a control step [s].
const PERIOD: f64 = 0.02;
/// Of the roll reference, in units of the largest commanded roll: a robot is armed at up to 0.5 rad, 1.43 times 20°, and the quick lag
/// adds a seventh.
const ROLL_FIRST: f64 = 1.7;
/// A command takes this long from the largest roll to zero [s].
const COMMAND_TIME: f64 = 0.6;
const ROUNDING: f64 = 1e-9;
/// Plans travel as f32.
const COMMAND_ROUNDING: f64 = 1e-4;
/// A reference may overshoot its command where a filter of second order shapes it [1].
const FILTER_OVERSHOOT: f64 = 0.05;
