//! A station of one manoeuvre: claims the lease, arms, sends typed plans, and disarms at the end.
//!
//! It has no other way to the motors than any station has: messages to the agent's core, whose checks, limits and braking apply.
//! It owns no clock either: each telemetry drives it, in the agent's own time. A driver that stops is a plan that ends.

use sphere_protocol::key::Key;
use sphere_protocol::message::{
    Command, CommandOrder, Message, Mode, PlanId, PlanSource, SetpointPlan, Telemetry,
};
use sphere_protocol::robot::{Robot, RobotId};
use sphere_protocol::time::{AgentClock, Instant, Span};
use sphere_protocol::wire::{self, Buffer, Wire};

use super::manoeuvre::Manoeuvre;

/// What it wants done.
#[derive(Clone, Debug, PartialEq)]
pub struct Outgoing {
    /// Key of the message.
    pub key: String,
    /// Its bytes.
    pub bytes: Vec<u8>,
}

/// How far it is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stage {
    /// Waiting until the robot may be armed.
    Preparing,
    /// Playing the manoeuvre.
    Driving,
    /// Braking to rest, then zero torque.
    Ending,
    /// Done: the motors are off.
    Done,
    /// The robot left the manoeuvre by itself in this mode; its motors are off or it holds.
    Stopped(Mode),
}

/// Plays one manoeuvre on one agent.
#[derive(Clone, Debug)]
pub struct Driver {
    robot: Robot,
    manoeuvre: Manoeuvre,
    station: u64,
    stage: Stage,
    began: Option<Instant<AgentClock>>,
    plan_due: Option<Instant<AgentClock>>,
    seq: u32,
    number: u32,
    /// The command under way, since when.
    asked: Option<(CommandOrder, Instant<AgentClock>)>,
    still_since: Option<Instant<AgentClock>>,
}

const KNOT: Span = Span::from_millis(100);
const KNOTS: usize = 10;
/// A silent driver's last plan ends after this.
const VALID_FOR: Span = Span::from_millis(1000);
/// A command that shows no effect is given again after this.
const REPEAT: Span = Span::from_millis(500);
const REST_SPEED: f64 = 0.02;
const REST_TIME: Span = Span::from_millis(1000);
/// Not even braking has brought it to rest.
const ENDING_MAX: Span = Span::from_millis(6000);

impl Driver {
    /// A driver of `robot` that calls itself `station` (not 0).
    pub fn new(robot: Robot, manoeuvre: Manoeuvre, station: u64) -> Self {
        Self {
            robot,
            manoeuvre,
            station: station.max(1),
            stage: Stage::Preparing,
            began: None,
            plan_due: None,
            seq: 0,
            number: 0,
            asked: None,
            still_since: None,
        }
    }

    /// How far it is.
    pub fn stage(&self) -> Stage {
        self.stage
    }

    /// The part that is being played at `telemetry`'s time, and the time since the manoeuvre began [s].
    pub fn progress(&self, now: Instant<AgentClock>) -> Option<(&'static str, f64)> {
        let t = now.since(self.began?).as_secs_f64();
        let (part, _) = self.manoeuvre.at(t)?;
        Some((part.name, t))
    }

    /// What to tell the agent that has sent `telemetry`.
    pub fn on_telemetry(&mut self, telemetry: &Telemetry) -> Vec<Outgoing> {
        let now = telemetry.stamp;
        let mut out = Vec::new();
        match self.stage {
            Stage::Preparing => self.prepare(telemetry, &mut out),
            Stage::Driving => {
                let over = self
                    .began
                    .is_none_or(|began| (now - began).as_secs_f64() >= self.manoeuvre.duration());
                if !matches!(telemetry.mode, Mode::Idle | Mode::Tracking) {
                    self.stage = Stage::Stopped(telemetry.mode);
                } else if over {
                    self.stage = Stage::Ending;
                    self.asked = None;
                    self.plan_due = Some(now);
                    self.order(CommandOrder::Hold, telemetry, &mut out);
                } else if self.plan_due.is_none_or(|due| due <= now) {
                    self.plan_due = Some(now + KNOT);
                    self.seq += 1;
                    send(&telemetry.robot, &self.plan(telemetry), &mut out);
                }
            }
            Stage::Ending => self.end(telemetry, &mut out),
            Stage::Done | Stage::Stopped(_) => {}
        }
        out
    }

    fn prepare(&mut self, telemetry: &Telemetry, out: &mut Vec<Outgoing>) {
        match telemetry.mode {
            _ if telemetry.epoch == 0 => self.order(CommandOrder::Claim, telemetry, out),
            Mode::Ready => self.order(CommandOrder::Arm, telemetry, out),
            Mode::Idle => {
                self.stage = Stage::Driving;
                self.began = Some(telemetry.stamp);
            }
            Mode::Fault | Mode::Failsafe => self.stage = Stage::Stopped(telemetry.mode),
            Mode::Boot | Mode::Disarmed | Mode::Holding | Mode::Tracking => {}
        }
    }

    fn end(&mut self, telemetry: &Telemetry, out: &mut Vec<Outgoing>) {
        let now = telemetry.stamp;
        if !matches!(
            telemetry.mode,
            Mode::Idle | Mode::Tracking | Mode::Holding | Mode::Failsafe
        ) {
            self.stage = Stage::Done;
            return;
        }
        if telemetry.state.v.abs() > REST_SPEED {
            self.still_since = None;
        }
        let still_since = *self.still_since.get_or_insert(now);
        let since_end = self.plan_due.map_or(Span::ZERO, |end| now - end);
        if now - still_since >= REST_TIME || since_end >= ENDING_MAX {
            self.order(CommandOrder::Disarm, telemetry, out);
        } else if telemetry.mode == Mode::Tracking {
            self.order(CommandOrder::Hold, telemetry, out);
        }
    }

    /// Gives an order, and again only if it has shown no effect for a while.
    fn order(&mut self, order: CommandOrder, telemetry: &Telemetry, out: &mut Vec<Outgoing>) {
        let now = telemetry.stamp;
        if self
            .asked
            .is_some_and(|(asked, at)| asked == order && now - at < REPEAT)
        {
            return;
        }
        self.asked = Some((order, now));
        self.number += 1;
        let command = Command {
            robot: telemetry.robot,
            boot_id: telemetry.boot_id,
            number: self.number,
            station: self.station,
            order,
        };
        send(&telemetry.robot, &command, out);
    }

    /// Typed knots on the manoeuvre's own grid, so that every plan says the same of a knot.
    fn plan(&self, telemetry: &Telemetry) -> SetpointPlan {
        let now = telemetry.stamp;
        let began = self.began.unwrap_or(now);
        let first = (now - began).as_nanos().max(0) / KNOT.as_nanos();
        let state = [
            telemetry.state.x,
            telemetry.state.y,
            telemetry.state.heading,
            telemetry.v_d,
            telemetry.q_rd,
        ]
        .map(|value| value as f32);
        let knot = |index: usize| {
            let t = (first + index as i64) as f64 * KNOT.as_secs_f64();
            self.manoeuvre
                .command(t, &self.robot.params, &self.robot.limits)
                .map(|value| value as f32)
        };
        SetpointPlan {
            robot: telemetry.robot,
            boot_id: telemetry.boot_id,
            id: PlanId {
                epoch: telemetry.epoch,
                seq: self.seq,
            },
            based_on: now,
            start: began + Span::from_nanos(first * KNOT.as_nanos()),
            period: KNOT,
            valid_for: VALID_FOR,
            source: PlanSource::Steps,
            u: (0..KNOTS).map(knot).collect(),
            // Typed plans have no feedback: where the robot is expected does not enter.
            x: (0..=KNOTS).map(|_| state).collect(),
            k: Default::default(),
        }
    }
}

fn send<M: Message + Wire>(robot: &RobotId, message: &M, out: &mut Vec<Outgoing>) {
    let mut buffer = Buffer::new();
    // Everything here is finite and within range; what is not would not be sent.
    if wire::encode(message, &mut buffer).is_ok() {
        out.push(Outgoing {
            key: Key::of::<M>(robot).text().to_string(),
            bytes: buffer.to_vec(),
        });
    }
}
