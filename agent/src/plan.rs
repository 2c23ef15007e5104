//! Playing plans: which one is in force on the agent's own clock, and what it commands now.
//!
//! Nothing here makes or lengthens a plan. A plan waits for its start, replaces the one in play, and ends at its last knot or
//! at the end of its validity, whichever comes first.

use arrayvec::ArrayVec;
use nalgebra::SVector;
use sphere_protocol::message::{DropReason, PlanId, PlanSource, SetpointPlan};
use sphere_protocol::robot::{Limits, RobotParams};
use sphere_protocol::state::RobotState;
use sphere_protocol::time::{AgentClock, Instant, Span};

/// State of the reference model: x, y [m], heading [rad], v_d [m/s], q_rd [rad].
pub type ReferenceState = SVector<f64, 5>;

/// The plans that an agent has received and may play.
#[derive(Debug)]
pub struct Playback {
    current: Option<SetpointPlan>,
    /// Received, not begun; ascending ids.
    waiting: ArrayVec<SetpointPlan, WAITING_MAX>,
    newest: Option<PlanId>,
    /// Bit i: plan `newest.seq - 1 - i` of the same epoch was received.
    received: u32,
    loop_delay: Option<Span>,
    begun: u64,
}

/// What the plan in force commands at one instant.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PlannedCommand {
    /// Speed command v_c, feedback included, within the limits [m/s].
    pub v: f64,
    /// Roll command q_c, feedback included, within the limits [rad].
    pub q_r: f64,
    /// What the reference makes of it.
    pub shape: Shape,
}

/// How commands become references.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Shape {
    /// Through the reference lag that the planner counts on.
    Lag,
    /// Typed steps, through the agent's own filters.
    Steps,
    /// A typed course: the roll is its own reference and moves at this rate [rad/s]; the speed as for `Steps`.
    Course {
        /// q̇_c [rad/s].
        q_r_rate: f64,
    },
}

/// Why no plan commands anything.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum NoPlan {
    /// None was received, or none has begun yet.
    None,
    /// The last knot has been played.
    Exhausted,
    /// The end of its validity has come before its last knot.
    Expired,
}

/// How many plans may wait for their start. At 10 Hz this covers 0.8 s of prediction ahead of arrival.
const WAITING_MAX: usize = 8;
/// A plan that starts later than this is a mistake of its maker [s].
const LEAD_MAX: Span = Span::from_millis(3000);
/// Commands may exceed the limits by rounding to f32 only.
const ROUNDING: f64 = 1e-4;

impl Playback {
    /// No plan.
    pub fn new() -> Self {
        Self {
            current: None,
            waiting: ArrayVec::new(),
            newest: None,
            received: 0,
            loop_delay: None,
            begun: 0,
        }
    }

    /// Takes in a plan that was decoded and is meant for this robot, boot and lease.
    ///
    /// # Errors
    /// Why it was dropped; the plans at hand are then untouched.
    pub fn receive(
        &mut self,
        plan: SetpointPlan,
        now: Instant<AgentClock>,
        limits: &Limits,
    ) -> Result<(), DropReason> {
        if let Some(newest) = self.newest
            && plan.id <= newest
        {
            return Err(DropReason::Old);
        }
        if plan.based_on > now || plan.start - now > LEAD_MAX {
            return Err(DropReason::Future);
        }
        if now >= end(&plan) {
            return Err(DropReason::Expired);
        }
        let within = |value: f32, low: f64, high: f64| {
            let value = f64::from(value);
            value >= low - ROUNDING && value <= high + ROUNDING
        };
        let q = limits.q_r_max;
        if !plan
            .u
            .iter()
            .all(|u| within(u[0], limits.v_min, limits.v_max) && within(u[1], -q, q))
        {
            return Err(DropReason::OutOfRange);
        }
        self.acknowledge(plan.id);
        self.loop_delay = Some(now - plan.based_on);
        if self.waiting.is_full() {
            self.waiting.remove(0);
        }
        self.waiting.push(plan);
        Ok(())
    }

    /// Begins the plan whose time has come: the newest that has started replaces the one in play.
    pub fn advance(&mut self, now: Instant<AgentClock>) {
        if let Some(begun) = self.waiting.iter().rposition(|plan| plan.start <= now) {
            let mut plans = self.waiting.drain(..=begun);
            self.current = plans.next_back();
            self.begun += 1;
        }
    }

    /// The command in force at `now` for a robot whose reference state is `state`.
    ///
    /// Eq. u = u_i + K_i (x − x_i(t)), where x_i(t) is the predicted state advanced from knot i by the planner's discretisation.
    ///
    /// # Errors
    /// Why no plan commands anything.
    pub fn command(
        &self,
        now: Instant<AgentClock>,
        state: &ReferenceState,
        params: &RobotParams,
        limits: &Limits,
    ) -> Result<PlannedCommand, NoPlan> {
        let plan = self.current.as_ref().ok_or(NoPlan::None)?;
        let elapsed = (now - plan.start).as_nanos().max(0);
        let period = plan.period.as_nanos();
        let knot = usize::try_from(elapsed / period).unwrap_or(usize::MAX);
        if knot >= plan.u.len() {
            return Err(NoPlan::Exhausted);
        }
        if now >= plan.based_on + plan.valid_for {
            return Err(NoPlan::Expired);
        }
        let mut u = plan.u[knot].map(f64::from);
        let shape = match plan.source {
            PlanSource::Riccati | PlanSource::Clarabel | PlanSource::Shifted => Shape::Lag,
            PlanSource::Steps => Shape::Steps,
            PlanSource::Course => {
                // Straight to the next knot's roll; on from the last one as before it.
                let (from, to) = match plan.u.get(knot + 1) {
                    Some(next) => (plan.u[knot], *next),
                    None => (plan.u[knot.saturating_sub(1)], plan.u[knot]),
                };
                let rise = f64::from(to[1]) - f64::from(from[1]);
                let q_r_rate = rise / plan.period.as_secs_f64();
                u[1] += q_r_rate * Span::from_nanos(elapsed % period).as_secs_f64();
                Shape::Course { q_r_rate }
            }
        };
        if let Some(gain) = plan.k.get(knot) {
            let into_knot = Span::from_nanos(elapsed % period).as_secs_f64();
            let x = SVector::from(plan.x[knot].map(f64::from));
            let predicted = advance_reference(&x, u, into_knot, limits.reference_lag, params.r);
            let mut deviation = state - predicted;
            deviation[2] = wrap(deviation[2]);
            for (row, u) in u.iter_mut().enumerate() {
                *u += (0..5)
                    .map(|column| f64::from(gain[5 * row + column]) * deviation[column])
                    .sum::<f64>();
            }
        }
        Ok(PlannedCommand {
            v: u[0].clamp(limits.v_min, limits.v_max),
            q_r: u[1].clamp(-limits.q_r_max, limits.q_r_max),
            shape,
        })
    }

    /// Forgets every plan, as after a new lease. What was received stays known: an old plan stays old.
    pub fn stop(&mut self) {
        self.current = None;
        self.waiting.clear();
    }

    /// The plan in play.
    pub fn playing(&self) -> Option<&SetpointPlan> {
        self.current.as_ref()
    }

    /// Whether a plan waits for its start.
    pub fn has_waiting(&self) -> bool {
        !self.waiting.is_empty()
    }

    /// How many plans have begun since the start.
    pub fn begun(&self) -> u64 {
        self.begun
    }

    /// The newest plan received.
    pub fn newest(&self) -> Option<PlanId> {
        self.newest
    }

    /// Which of the 32 plans before the newest were received: bit i for `newest.seq - 1 - i`.
    pub fn received(&self) -> u32 {
        self.received
    }

    /// Arrival minus `based_on` of the newest plan.
    pub fn loop_delay(&self) -> Option<Span> {
        self.loop_delay
    }

    fn acknowledge(&mut self, id: PlanId) {
        self.received = match self.newest {
            Some(newest) if newest.epoch == id.epoch => {
                let ahead = id.seq - newest.seq;
                let shifted = self.received.checked_shl(ahead).unwrap_or(0);
                shifted | 1_u32.checked_shl(ahead - 1).unwrap_or(0)
            }
            _ => 0,
        };
        self.newest = Some(id);
    }
}

impl Default for Playback {
    fn default() -> Self {
        Self::new()
    }
}

/// When `plan` ends: its last knot or its validity, whichever comes first.
fn end(plan: &SetpointPlan) -> Instant<AgentClock> {
    let knots = plan.u.len() as i64;
    let last = plan.start + Span::from_nanos(plan.period.as_nanos().saturating_mul(knots));
    last.min(plan.based_on + plan.valid_for)
}

/// The reference state of a robot: its estimated pose, and the references that its torque controllers follow.
pub fn reference_state(state: &RobotState, v_d: f64, q_rd: f64) -> ReferenceState {
    ReferenceState::from([state.x, state.y, state.heading, v_d, q_rd])
}

/// The reference model over `dt` [s] under held commands `u` = (v_c, q_c): first-order lag `tau` of speed and roll, and eq (1) on
/// the arc of their means, with the sideways term R q̇_r that makes it the path of the *centre*.
pub fn advance_reference(
    x: &ReferenceState,
    u: [f64; 2],
    dt: f64,
    tau: f64,
    r: f64,
) -> ReferenceState {
    if dt <= 0.0 {
        return *x;
    }
    let decay = (-dt / tau).exp();
    // Mean of e^(−t/τ) over the interval.
    let mean = tau * (1.0 - decay) / dt;
    let (v_mean, q_mean) = (u[0] + (x[3] - u[0]) * mean, u[1] + (x[4] - u[1]) * mean);
    let (v_end, q_end) = (u[0] + (x[3] - u[0]) * decay, u[1] + (x[4] - u[1]) * decay);
    let half_turn = 0.5 * v_mean * dt * q_mean.tan() / r;
    let chord = if half_turn.abs() < 1e-4 {
        1.0 - half_turn * half_turn / 6.0
    } else {
        half_turn.sin() / half_turn
    };
    let (ahead, left) = (chord * v_mean * dt, chord * r * (q_end - x[4]));
    let (sin, cos) = (x[2] + half_turn).sin_cos();
    ReferenceState::from([
        x[0] + ahead * cos - left * sin,
        x[1] + ahead * sin + left * cos,
        x[2] + 2.0 * half_turn,
        v_end,
        q_end,
    ])
}

/// `angle` in (−π, π].
fn wrap(angle: f64) -> f64 {
    angle - core::f64::consts::TAU * (angle / core::f64::consts::TAU).round()
}
