//! Where a robot will be when a plan begins: its telemetry carried forward through the plans that it has, or will have by then.
//!
//! The prediction plays plans as the agent does: at each control period the newest received plan that has begun, u = uᵢ + Kᵢ (x − xᵢ) on
//! the reference state (estimated pose, v_d, q_rd), within the same limits. What the robot has received it says itself; of plans
//! too young to be acknowledged it is assumed that they arrive when most do; of the rest, that they are lost.

use std::collections::VecDeque;
use std::sync::Arc;

use nalgebra::{SVector, Vector2};
use sphere_protocol::message::{PlanId, SetpointPlan, Telemetry};
use sphere_protocol::robot::{Limits, Robot};
use sphere_protocol::time::{AgentClock, GroundClock, Instant, Span};

use crate::kinematics::Discretisation;
use crate::link::Link;

/// State that is planned from: x, y [m], heading [rad], v_d [m/s], q_rd [rad].
pub type ReferenceState = SVector<f64, 5>;

/// Remembers the plans sent to one robot under one lease, and predicts through them.
#[derive(Clone, Debug)]
pub struct Predictor {
    radius: f64,     // of the sphere [m]
    turn_limit: f64, // largest tan|q_r| v² [m²/s²]
    limits: Limits,
    period: Discretisation<5>, // one control period of the agent
    sent: VecDeque<Sent>,      // by sequence number
}

/// A plan on its way or on board.
#[derive(Clone, Debug)]
struct Sent {
    plan: Arc<SetpointPlan>,
    at: Instant<GroundClock>,
    /// When it should have arrived; `None` if no echo was known when it was sent.
    arrival: Option<Instant<AgentClock>>,
    echoed: bool,
}

impl Predictor {
    /// For one robot, without plans.
    pub fn new(robot: &Robot) -> Self {
        let (radius, limits) = (robot.params.r, robot.limits);
        Self {
            radius,
            turn_limit: limits.turn_limit(&robot.params),
            limits,
            period: Discretisation::centre(CONTROL_PERIOD, radius, limits.reference_lag),
            sent: VecDeque::new(),
        }
    }

    /// Forgets every plan: another lease, or another life of the agent.
    pub fn clear(&mut self) {
        self.sent.clear();
    }

    /// Remembers a plan that is sent `at`, expected to arrive at `arrival`.
    pub fn on_sent(
        &mut self,
        plan: impl Into<Arc<SetpointPlan>>,
        at: Instant<GroundClock>,
        arrival: Option<Instant<AgentClock>>,
    ) {
        if self.sent.len() == PLANS_MAX {
            self.sent.pop_front();
        }
        self.sent.push_back(Sent {
            plan: plan.into(),
            at,
            arrival,
            echoed: false,
        });
    }

    /// Learns from telemetry when its newest plan arrived, and forgets the plans before the one in play.
    pub fn on_telemetry(&mut self, telemetry: &Telemetry, link: &mut Link) {
        if let (Some(newest), Some(delay)) = (telemetry.newest, telemetry.loop_delay)
            && let Some(sent) = self.sent.iter_mut().find(|sent| sent.plan.id == newest)
            && !sent.echoed
        {
            let arrived = sent.plan.based_on + delay;
            if delay >= Span::ZERO && arrived <= telemetry.stamp {
                sent.echoed = true;
                link.on_echo(sent.at, arrived);
            }
        }
        if let Some(playing) = telemetry.playing {
            self.sent
                .retain(|sent| sent.plan.id.epoch == playing.epoch && sent.plan.id >= playing);
        }
    }

    /// When the newest plan that the robot is known to have ends.
    pub fn covered_until(&self, telemetry: &Telemetry) -> Option<Instant<AgentClock>> {
        let newest = telemetry.newest?;
        let sent = self.sent.iter().rev().find(|sent| sent.plan.id == newest)?;
        Some(sent.plan.ends())
    }

    /// The reference state at `until`, from `telemetry`.
    pub fn predict(&self, telemetry: &Telemetry, until: Instant<AgentClock>) -> ReferenceState {
        let state = &telemetry.state;
        let mut x = ReferenceState::from([
            state.x,
            state.y,
            state.heading,
            telemetry.v_d,
            telemetry.q_rd,
        ]);
        let mut t = telemetry.stamp;
        let period = Span::from_secs_f64(CONTROL_PERIOD);
        let mut inside: Option<Inside> = None;
        while t < until {
            let left = until.since(t);
            let (step, model) = if left >= period {
                (period, self.period)
            } else {
                (left, self.model(left.as_secs_f64()))
            };
            let (u, rate_max) = match self.in_play(telemetry, t) {
                Some(plan) => {
                    let (i, within) = knot_of(plan, t);
                    // A period after the one before in the same knot of the same plan.
                    let length = match &inside {
                        Some(last) if last.is_followed_by(plan, i, within, period) => {
                            last.length.longer(&self.period)
                        }
                        _ => self.model(within.as_secs_f64()),
                    };
                    inside = Some(Inside {
                        id: plan.id,
                        knot: i,
                        within,
                        length,
                    });
                    (self.command(plan, i, within, &length, &x), self.limits.slew)
                }
                None => (Vector2::zeros(), self.limits.brake),
            };
            x = model.step(&x, &self.slewed(u, &x, &model, rate_max));
            t += step;
        }
        x
    }

    /// The plan that the agent plays at `t`, or nothing: it brakes.
    fn in_play(&self, telemetry: &Telemetry, t: Instant<AgentClock>) -> Option<&SetpointPlan> {
        let sent = self
            .sent
            .iter()
            .rev()
            .find(|sent| sent.plan.start <= t && sent.is_on_board(telemetry, t))?;
        (t < sent.plan.ends()).then_some(&sent.plan)
    }

    /// The command `within` knot `i`, where `length` is that of the knot so far: uᵢ + Kᵢ (x − xᵢ) within the limits (v_c [m/s], q_c [rad]).
    fn command(
        &self,
        plan: &SetpointPlan,
        i: usize,
        within: Span,
        length: &Discretisation<5>,
        x: &ReferenceState,
    ) -> Vector2<f64> {
        let mut u = Vector2::from(plan.u[i].map(f64::from));
        if let Some(k) = plan.k.get(i) {
            // The planned state inside the knot, by the planner's own discretisation.
            let mut planned = ReferenceState::from(plan.x[i].map(f64::from));
            if within > Span::ZERO {
                planned = length.step(&planned, &u);
            }
            let mut error = x - planned;
            error[2] = wrapped(error[2]);
            for (j, row) in k.chunks_exact(5).enumerate() {
                u[j] += row
                    .iter()
                    .zip(error.iter())
                    .map(|(gain, e)| f64::from(*gain) * e)
                    .sum::<f64>();
            }
        }
        let v = u[0].clamp(self.limits.v_min, self.limits.v_max);
        let q_max = self
            .limits
            .q_r_max
            .min((self.turn_limit / (x[3] * x[3]).max(1e-9)).atan());
        Vector2::new(v, u[1].clamp(-q_max, q_max))
    }

    /// The command with which the lag of `model` moves v_d by no more than `rate_max` [m/s²] over its period: the clamp on board.
    fn slewed(
        &self,
        u: Vector2<f64>,
        x: &ReferenceState,
        model: &Discretisation<5>,
        rate_max: f64,
    ) -> Vector2<f64> {
        let (h, share) = (model.period(), model.gone(self.limits.reference_lag));
        let step = ((u[0] - x[3]) * share).clamp(-rate_max * h, rate_max * h);
        Vector2::new(x[3] + step / share, u[1])
    }

    fn model(&self, h: f64) -> Discretisation<5> {
        Discretisation::centre(h, self.radius, self.limits.reference_lag)
    }
}

/// Where in a plan the last command was taken.
struct Inside {
    id: PlanId,
    knot: usize,
    within: Span,
    /// From the knot's beginning to there.
    length: Discretisation<5>,
}

impl Inside {
    /// Whether `within` knot `knot` of `plan` is one `period` later.
    fn is_followed_by(&self, plan: &SetpointPlan, knot: usize, within: Span, period: Span) -> bool {
        // Without a length there is nothing to make longer.
        self.within > Span::ZERO
            && self.id == plan.id
            && self.knot == knot
            && within.as_nanos() - self.within.as_nanos() == period.as_nanos()
    }
}

/// The knot of `plan` that is played at `t`, and the time since its beginning.
fn knot_of(plan: &SetpointPlan, t: Instant<AgentClock>) -> (usize, Span) {
    let period = plan.period.as_nanos().max(1);
    let since = t.since(plan.start).as_nanos().max(0);
    let i = usize::try_from(since / period)
        .unwrap_or(usize::MAX)
        .min(plan.u.len() - 1);
    (i, Span::from_nanos(since - i as i64 * period))
}

impl Sent {
    /// Whether the agent has it at `t`, judged from what it said in `telemetry`.
    fn is_on_board(&self, telemetry: &Telemetry, t: Instant<AgentClock>) -> bool {
        let id = self.plan.id;
        if telemetry.playing == Some(id) {
            return true;
        }
        match telemetry.newest {
            Some(newest) if newest.epoch == id.epoch && newest.seq >= id.seq => {
                // Bit i stands for newest.seq − 1 − i. What is older than the newest and missing is lost even if it still comes.
                let behind = newest.seq - id.seq;
                behind == 0 || (behind <= 32 && telemetry.received & (1 << (behind - 1)) != 0)
            }
            _ => {
                let arrival = self.arrival.unwrap_or(self.plan.based_on);
                let patience = match self.arrival {
                    Some(_) => ACKNOWLEDGED_WITHIN,
                    None => FIRST_PLAN_WITHIN,
                };
                telemetry.stamp < arrival + patience && arrival <= t
            }
        }
    }
}

/// Length of time for which a plan may be played.
pub(crate) trait Ends {
    /// The first instant at which it must not be played.
    fn ends(&self) -> Instant<AgentClock>;
}

impl Ends for SetpointPlan {
    fn ends(&self) -> Instant<AgentClock> {
        let knots = Span::from_nanos(self.period.as_nanos().saturating_mul(self.u.len() as i64));
        (self.start + knots).min(self.based_on + self.valid_for)
    }
}

/// `angle` brought into [−π, π].
pub(crate) fn wrapped(angle: f64) -> f64 {
    angle - core::f64::consts::TAU * (angle / core::f64::consts::TAU).round()
}

/// Control period of the agent [s]: 50 Hz, as in the paper.
const CONTROL_PERIOD: f64 = 0.02;
/// Plans remembered: more than fit in any loop that can still be planned over.
const PLANS_MAX: usize = 64;
/// A plan that telemetry does not name this long after it should have arrived is lost: a control period, and some jitter.
const ACKNOWLEDGED_WITHIN: Span = Span::from_millis(30);
/// The same, counted from `based_on`, before the loop's delay is known.
const FIRST_PLAN_WITHIN: Span = Span::from_millis(2000);
