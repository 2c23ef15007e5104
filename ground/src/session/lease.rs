//! The lease on one robot, and the commands that bring it about: claim, arm, and what an operator orders.
//!
//! One command is under way at a time. It is repeated until telemetry names its number: carried out or refused, which the robot's
//! state then tells. The *agent* grants the lease; a lease that another station took is not fought over.

use std::collections::VecDeque;

use sphere_protocol::message::{CommandOrder, Mode, Status, Telemetry};
use sphere_protocol::time::{GroundClock, Instant, Span};

use super::Request;
use crate::station::Event;

/// Who holds the lease, and the command under way.
pub(super) struct Lease {
    station: u64,
    holder: Holder,
    under_way: Option<UnderWay>,
    /// What the operator ordered, in order.
    orders: VecDeque<CommandOrder>,
    /// Whether the motors are to be on; the operator's disarm ends it, and a latched fault.
    wants_armed: bool,
    /// Not before this: the last claim or arm was refused.
    retry_at: Option<Instant<GroundClock>>,
    newest_number: u32,
    /// Whether claims have been refused since the lease was last held.
    is_refused: bool,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Holder {
    /// Nobody, or nobody knows: to be claimed.
    Open,
    /// This station.
    Us { epoch: u32 },
    /// Another station took it, or the operator gave it back: not claimed again by itself.
    Yielded,
}

#[derive(Clone, Copy, Debug)]
struct UnderWay {
    number: u32,
    order: CommandOrder,
    epoch_before: u32,
    send_at: Instant<GroundClock>,
    /// When it was sent, if it was sent once: the answer to a repeated one may be to any of them.
    sent_once: Option<Instant<GroundClock>>,
    is_sent: bool,
}

impl Lease {
    pub(super) fn new(station: u64) -> Self {
        Self {
            station,
            holder: Holder::Open,
            under_way: None,
            orders: VecDeque::new(),
            wants_armed: true,
            retry_at: None,
            newest_number: 0,
            is_refused: false,
        }
    }

    /// Another life of the agent: it granted nothing yet and knows no numbers.
    pub(super) fn restart(&mut self) {
        if self.holder != Holder::Yielded {
            self.holder = Holder::Open;
        }
        self.under_way = None;
        self.retry_at = None;
        self.newest_number = 0;
    }

    /// The lease held by this station.
    pub(super) fn epoch(&self) -> Option<u32> {
        match self.holder {
            Holder::Us { epoch } => Some(epoch),
            _ => None,
        }
    }

    pub(super) fn order(&mut self, order: CommandOrder) {
        match order {
            CommandOrder::Arm => self.wants_armed = true,
            CommandOrder::Disarm => {
                // Nothing ordered earlier may be waited for.
                self.wants_armed = false;
                self.orders.clear();
                self.under_way = None;
            }
            CommandOrder::Claim => self.holder = Holder::Open,
            _ => {}
        }
        // Claim and Arm are wishes that `wanted` turns into commands when they are possible.
        if !matches!(order, CommandOrder::Claim | CommandOrder::Arm)
            && self.orders.len() < ORDERS_MAX
        {
            self.orders.push_back(order);
        }
        self.retry_at = None;
    }

    /// Returns when the command that this telemetry acknowledges was sent, if that is certain.
    pub(super) fn on_telemetry(
        &mut self,
        now: Instant<GroundClock>,
        telemetry: &Telemetry,
        out: &mut Vec<Request>,
    ) -> Option<Instant<GroundClock>> {
        let mut sent_once = None;
        self.newest_number = self.newest_number.max(telemetry.command);
        if matches!(telemetry.mode, Mode::Failsafe | Mode::Fault) {
            self.wants_armed = false;
        }
        if let Some(command) = self.under_way
            && telemetry.command >= command.number
        {
            self.under_way = None;
            sent_once = command.sent_once;
            self.on_acknowledged(now, command, telemetry, out);
        }
        if let Holder::Us { epoch } = self.holder
            && telemetry.epoch != epoch
        {
            // Nobody holds it: it ran out, and may be claimed. Somebody else does: not fought over.
            self.holder = match telemetry.epoch {
                0 => Holder::Open,
                _ => Holder::Yielded,
            };
            out.push(Request::Event(Event::LeaseLost { station: None }));
        }
        sent_once
    }

    pub(super) fn on_status(&mut self, status: &Status, out: &mut Vec<Request>) {
        if let Holder::Us { epoch } = self.holder
            && status.epoch == epoch
            && status.station != self.station
        {
            self.holder = Holder::Yielded;
            out.push(Request::Event(Event::LeaseLost {
                station: Some(status.station),
            }));
        }
    }

    /// The command to send now, if any.
    pub(super) fn poll(
        &mut self,
        now: Instant<GroundClock>,
        telemetry: &Telemetry,
    ) -> Option<(u32, CommandOrder)> {
        if self.under_way.is_none() {
            let order = self.wanted(now, telemetry)?;
            self.newest_number = self.newest_number.saturating_add(1);
            self.under_way = Some(UnderWay {
                number: self.newest_number,
                order,
                epoch_before: telemetry.epoch,
                send_at: now,
                sent_once: None,
                is_sent: false,
            });
        }
        let command = self.under_way.as_mut()?;
        if command.send_at > now {
            return None;
        }
        command.send_at = now + REPEAT;
        command.sent_once = (!command.is_sent).then_some(now);
        command.is_sent = true;
        Some((command.number, command.order))
    }

    /// When [`Lease::poll`] has something to do by time alone.
    pub(super) fn timeout(&self) -> Option<Instant<GroundClock>> {
        self.under_way
            .map(|command| command.send_at)
            .or(self.retry_at)
    }

    fn wanted(&mut self, now: Instant<GroundClock>, telemetry: &Telemetry) -> Option<CommandOrder> {
        if let Some(order) = self.orders.pop_front() {
            return Some(order);
        }
        if self.retry_at.is_some_and(|at| at > now) {
            return None;
        }
        self.retry_at = None;
        match self.holder {
            Holder::Open => Some(CommandOrder::Claim),
            Holder::Us { .. } if self.wants_armed && telemetry.mode == Mode::Ready => {
                Some(CommandOrder::Arm)
            }
            _ => None,
        }
    }

    fn on_acknowledged(
        &mut self,
        now: Instant<GroundClock>,
        command: UnderWay,
        telemetry: &Telemetry,
        out: &mut Vec<Request>,
    ) {
        match command.order {
            CommandOrder::Claim if telemetry.epoch > command.epoch_before => {
                self.holder = Holder::Us {
                    epoch: telemetry.epoch,
                };
                self.is_refused = false;
                out.push(Request::Event(Event::LeaseGranted {
                    epoch: telemetry.epoch,
                }));
            }
            CommandOrder::Claim => {
                self.retry_at = Some(now + CLAIM_RETRY);
                // Told once, not with every attempt.
                if !core::mem::replace(&mut self.is_refused, true) {
                    out.push(Request::Event(Event::Refused(command.order)));
                }
            }
            CommandOrder::Arm if telemetry.mode == Mode::Ready => {
                self.retry_at = Some(now + RETRY);
                out.push(Request::Event(Event::Refused(command.order)));
            }
            CommandOrder::Release => self.holder = Holder::Yielded,
            _ => {}
        }
    }
}

/// A command without an answer is sent again after this: longer than most loops, and a repeated one is ignored anyway.
const REPEAT: Span = Span::from_millis(200);
/// A refused claim is tried again after this: the lease of a station that has died runs out soon, and its last plan soon after.
const CLAIM_RETRY: Span = Span::from_millis(200);
/// A refused arm is tried again after this.
const RETRY: Span = Span::from_millis(1000);
/// Operator's orders that wait.
const ORDERS_MAX: usize = 8;
