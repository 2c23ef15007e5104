//! One robot as the station knows it: its life, lease, mode, link and plans.
//!
//! What it does at each planning tick is in `Session::tick`, top down; everything else keeps the facts for it.

mod job;
mod lease;

use std::collections::VecDeque;
use std::sync::Arc;

use sphere_protocol::message::{
    CommandOrder, DropReason, Mode, PlanId, PlanSource, SetpointPlan, Status, Telemetry,
};
use sphere_protocol::robot::{Robot, RobotId};
use sphere_protocol::time::{AgentClock, GroundClock, Instant, Span};
use sphere_protocol::wire::WireError;

use crate::link::Link;
use crate::planner::{Knots, Planner};
use crate::predictor::{Ends, Predictor};
use crate::settings::{Compensation, KNOT, PlannerSettings};
use crate::station::{Event, RobotConfig};
use crate::tasking::{StartCondition, Task};
use crate::trajectory::{Mission, Pose};
use crate::workload::Effort;
pub use job::Job;
pub(crate) use job::Planned;
use lease::Lease;

/// What a session asks the station to send or tell.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Request {
    /// A command.
    Command {
        boot_id: u64,
        number: u32,
        order: CommandOrder,
    },
    /// A plan.
    Plan(Arc<SetpointPlan>),
    /// Something to tell.
    Event(Event),
}

/// Counters of one robot since the station's start.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counters {
    /// Plans sent, of any source.
    pub plans_sent: u64,
    /// Of these: solved by Riccati sweeps.
    pub riccati: u64,
    /// Solved by Clarabel.
    pub clarabel: u64,
    /// The last plan again, because there was no new one.
    pub shifted: u64,
    /// Typed commands.
    pub typed: u64,
    /// Plans by one iteration, because the station was over its time.
    pub real_time: u64,
    /// Ticks at which the last plan went again, because the station was over its time; also counted as shifted.
    pub shed: u64,
    /// Ticks without any plan although one was due: solver failed and nothing was left to send again.
    pub failed: u64,
    /// Ticks without a plan because telemetry was too old.
    pub stale: u64,
    /// Messages dropped, by [`DropReason`].
    pub dropped: [u32; DropReason::COUNT],
}

/// One robot. Driven by [`crate::station::Station`].
pub struct Session {
    id: RobotId,
    robot: Robot,
    settings: PlannerSettings,
    task: Task,
    link: Link,
    planner: Planner,
    predictor: Predictor,
    lease: Lease,
    life: Option<Life>,
    past_boots: VecDeque<u64>,
    /// No plans until the operator resumes.
    is_held: bool,
    /// Whether plans could be made at the last tick that wanted one.
    is_stale: bool,
    /// Schema versions that were refused and told of.
    incompatible: Vec<WireError>,
    /// Our messages that the robot has refused for their schema version, in its present life.
    refused_versions: u32,
    counters: Counters,
}

/// One life of the agent.
struct Life {
    boot_id: u64,
    telemetry: Telemetry,
    received: Instant<GroundClock>,
    last_plan: Option<Arc<SetpointPlan>>,
}

impl Session {
    pub(crate) fn new(config: &RobotConfig, settings: &PlannerSettings, station: u64) -> Self {
        Self {
            id: config.id,
            robot: config.robot.clone(),
            settings: *settings,
            task: Task::new(config.mission.clone(), config.start),
            link: Link::default(),
            planner: Planner::new(&config.robot, settings),
            predictor: Predictor::new(&config.robot),
            lease: Lease::new(station),
            life: None,
            past_boots: VecDeque::new(),
            is_held: false,
            is_stale: false,
            incompatible: Vec::new(),
            refused_versions: 0,
            counters: Counters::default(),
        }
    }

    /// The newest telemetry.
    pub fn telemetry(&self) -> Option<&Telemetry> {
        self.life.as_ref().map(|life| &life.telemetry)
    }

    /// The newest plan sent in this life of the agent.
    pub fn last_plan(&self) -> Option<&SetpointPlan> {
        self.life.as_ref()?.last_plan.as_deref()
    }

    /// Mission and progress.
    pub fn task(&self) -> &Task {
        &self.task
    }

    /// Delay and clock.
    pub fn link(&self) -> &Link {
        &self.link
    }

    /// The planner, with the problem that it solved last.
    pub fn planner(&self) -> &Planner {
        &self.planner
    }

    /// Counters.
    pub fn counters(&self) -> &Counters {
        &self.counters
    }

    /// The lease under which this station plans, if it holds it.
    pub fn epoch(&self) -> Option<u32> {
        self.lease.epoch()
    }

    pub(crate) fn count_drop(&mut self, reason: DropReason) {
        let count = &mut self.counters.dropped[reason as usize];
        *count = count.saturating_add(1);
    }

    /// A message that could not be read. Another schema version is told of, once for each topic and version.
    pub(crate) fn on_unreadable(&mut self, error: WireError, out: &mut Vec<Request>) {
        self.count_drop(error.reason());
        if matches!(error, WireError::Version { .. })
            && self.incompatible.len() < INCOMPATIBLE_MAX
            && !self.incompatible.contains(&error)
        {
            self.incompatible.push(error);
            out.push(Request::Event(Event::Incompatible(error)));
        }
    }

    pub(crate) fn on_telemetry(
        &mut self,
        now: Instant<GroundClock>,
        telemetry: Telemetry,
        out: &mut Vec<Request>,
    ) {
        if telemetry.robot != self.id {
            return self.count_drop(DropReason::WrongRobot);
        }
        if !is_plausible(&telemetry) {
            return self.count_drop(DropReason::OutOfRange);
        }
        if self.past_boots.contains(&telemetry.boot_id) {
            return self.count_drop(DropReason::WrongBoot);
        }
        match &self.life {
            Some(life) if life.boot_id == telemetry.boot_id => {
                if telemetry.stamp <= life.telemetry.stamp {
                    return self.count_drop(DropReason::Old);
                }
                let ahead = telemetry.stamp.since(life.telemetry.stamp);
                if ahead > now.since(life.received) + AHEAD_MAX {
                    return self.count_drop(DropReason::Future);
                }
            }
            Some(life) => {
                let boot_id = life.boot_id;
                self.on_reboot(boot_id);
                out.push(Request::Event(Event::Rebooted {
                    boot_id: telemetry.boot_id,
                }));
            }
            None => out.push(Request::Event(Event::Found {
                boot_id: telemetry.boot_id,
            })),
        }
        self.link.on_telemetry(telemetry.stamp, now);
        self.predictor.on_telemetry(&telemetry, &mut self.link);
        let mode_before = self.telemetry().map(|before| before.mode);
        if mode_before != Some(telemetry.mode) {
            out.push(Request::Event(Event::Mode {
                from: mode_before,
                to: telemetry.mode,
            }));
        }
        let epoch_before = self.lease.epoch();
        let since_last = self
            .telemetry()
            .map(|before| telemetry.stamp.since(before.stamp));
        if let Some(sent) = self.lease.on_telemetry(now, &telemetry, out)
            && since_last.is_some_and(|since| since <= ECHO_WITHIN)
        {
            self.link.on_command_echo(sent, telemetry.stamp);
        }
        let last_plan = self.life.take().and_then(|life| life.last_plan);
        let keeps_lease = self.lease.epoch() == epoch_before;
        if !keeps_lease {
            self.predictor.clear();
        }
        self.life = Some(Life {
            boot_id: telemetry.boot_id,
            telemetry,
            received: now,
            last_plan: last_plan.filter(|_| keeps_lease),
        });
    }

    pub(crate) fn on_status(&mut self, status: &Status, out: &mut Vec<Request>) {
        if status.robot != self.id {
            return self.count_drop(DropReason::WrongRobot);
        }
        match &self.life {
            // Telemetry, which comes often, decides which life is the present one.
            Some(life) if life.boot_id == status.boot_id => {
                let refused = status.dropped[DropReason::Version as usize];
                if refused > 0 && self.refused_versions == 0 {
                    out.push(Request::Event(Event::RefusedByRobot { count: refused }));
                }
                self.refused_versions = refused;
                self.lease.on_status(status, out);
            }
            _ => self.count_drop(DropReason::WrongBoot),
        }
    }

    /// Sends what the lease wants now: claim, arm, what the operator ordered, again until it is acknowledged.
    pub(crate) fn poll_commands(&mut self, now: Instant<GroundClock>, out: &mut Vec<Request>) {
        if let Some(life) = &self.life
            && let Some((number, order)) = self.lease.poll(now, &life.telemetry)
        {
            out.push(Request::Command {
                boot_id: life.boot_id,
                number,
                order,
            });
        }
    }

    /// When [`Session::poll_commands`] wants to be asked next.
    pub(crate) fn command_timeout(&self) -> Option<Instant<GroundClock>> {
        self.life.as_ref().and_then(|_| self.lease.timeout())
    }

    /// An operator's order.
    pub(crate) fn order(&mut self, order: CommandOrder) {
        match order {
            CommandOrder::Hold => self.is_held = true,
            CommandOrder::Resume => self.is_held = false,
            _ => {}
        }
        self.lease.order(order);
    }

    /// Begins a mission that waits for an order.
    pub(crate) fn start(&mut self) {
        self.task.order_start();
    }

    /// Another mission, in place of the present one, to begin as `start` says.
    pub(crate) fn assign(&mut self, mission: Mission, start: StartCondition) {
        self.task = Task::new(mission, start);
        self.planner.reset();
    }

    /// One planning tick: something to plan if the robot is ours, up, fresh and has something to do. [`Session::conclude`] ends it.
    pub(crate) fn prepare(
        &mut self,
        now: Instant<GroundClock>,
        out: &mut Vec<Request>,
    ) -> Option<Job<'_>> {
        let (Some(life), Some(epoch)) = (&self.life, self.lease.epoch()) else {
            return None;
        };
        let telemetry = &life.telemetry;
        if self.is_held || !matches!(telemetry.mode, Mode::Idle | Mode::Tracking | Mode::Holding) {
            return None;
        }
        let is_localised = telemetry.position_sigma <= POSITION_SIGMA_MAX;
        if !self.task.is_under_way() && !is_localised {
            return None;
        }
        let (lead_max, earliest) = (self.lead_max(), self.link.agent_time(now)?);
        if earliest.since(telemetry.stamp) > lead_max {
            if self.task.is_under_way() {
                self.counters.stale += 1;
                if !core::mem::replace(&mut self.is_stale, true) {
                    out.push(Request::Event(Event::Stale));
                }
            }
            return None;
        }
        // A link that was slower than any plan is long must not silence the station for ever: only plans that arrive tell that it is
        // faster again.
        let start = self.plan_start(now, life)?.min(telemetry.stamp + lead_max);
        self.is_stale = false;
        let here = Pose {
            x: telemetry.state.x,
            y: telemetry.state.y,
            heading: telemetry.state.heading,
        };
        let was_under_way = self.task.is_under_way();
        match self.task.advance(now, start, here, &self.robot, &self.link) {
            Ok(true) => {}
            Ok(false) => {
                if was_under_way {
                    out.push(Request::Event(Event::MissionDone));
                }
                return None;
            }
            Err(error) => {
                out.push(Request::Event(Event::MissionRefused(error)));
                return None;
            }
        }
        if !was_under_way {
            out.push(Request::Event(Event::MissionStarted));
        }
        let start = self.on_grid(start);
        Some(Job::new(self, start, epoch))
    }

    /// Ends the tick that [`Session::prepare`] began: sends what there is to send.
    pub(crate) fn conclude(
        &mut self,
        now: Instant<GroundClock>,
        planned: Planned,
        out: &mut Vec<Request>,
    ) {
        let effort = planned.effort;
        let Some(plan) = self.plan_of(planned) else {
            self.counters.failed += 1;
            return;
        };
        let counters = &mut self.counters;
        counters.plans_sent += 1;
        match plan.source {
            PlanSource::Riccati => counters.riccati += 1,
            PlanSource::Clarabel => counters.clarabel += 1,
            PlanSource::Shifted => counters.shifted += 1,
            PlanSource::Steps | PlanSource::Course => counters.typed += 1,
        }
        match effort {
            Effort::Converge => {}
            Effort::RealTime => counters.real_time += 1,
            Effort::Shift => counters.shed += 1,
        }
        let arrival = self.link.arrival(now);
        let plan = Arc::new(plan);
        self.predictor.on_sent(Arc::clone(&plan), now, arrival);
        out.push(Request::Plan(Arc::clone(&plan)));
        if let Some(life) = &mut self.life {
            life.last_plan = Some(plan);
        }
    }

    /// When a plan made now can begin: when it will have arrived. Not before the plan before it, so that later plans start later.
    fn plan_start(&self, now: Instant<GroundClock>, life: &Life) -> Option<Instant<AgentClock>> {
        let stamp = life.telemetry.stamp;
        let earliest = self.link.agent_time(now)?.max(stamp);
        if self.settings.compensation == Compensation::Naive {
            return Some(earliest);
        }
        let arrival = self.link.arrival(now).unwrap_or(earliest).max(stamp);
        Some(match &life.last_plan {
            Some(last) => arrival.max(last.start),
            None => arrival,
        })
    }

    /// Knots of typed commands begin at whole knots of their mission: a step lies where it was typed, in every plan.
    fn on_grid(&self, start: Instant<AgentClock>) -> Instant<AgentClock> {
        match self.task.running() {
            Some((trajectory, anchor)) if trajectory.program().is_some() => {
                let knot = Span::from_secs_f64(KNOT).as_nanos();
                let since = start.since(anchor).as_nanos().div_euclid(knot);
                anchor + Span::from_nanos(since * knot)
            }
            _ => start,
        }
    }

    /// Longest way from telemetry to a plan's start: beyond a horizon more would be guessed than planned.
    fn lead_max(&self) -> Span {
        self.settings.horizon_length().min(self.settings.max_age)
    }

    /// The new plan, or the last one again if there is none and the last one still has something to play.
    fn plan_of(&self, planned: Planned) -> Option<SetpointPlan> {
        let Planned {
            start,
            epoch,
            effort,
            knots,
        } = planned;
        let last = self.life.as_ref()?.last_plan.as_ref();
        let id = PlanId {
            epoch,
            seq: last.map_or(1, |last| last.id.seq.saturating_add(1)),
        };
        let remaining = last.filter(|last| last.ends() > start);
        match (knots, remaining) {
            // One iteration a tick converges over the ticks: newer is better here, elsewhere optimal from a little earlier is.
            (Some(knots), _) if knots.is_optimal || effort == Effort::RealTime => {
                self.stamped(knots, start, id)
            }
            (_, Some(last)) => Some(SetpointPlan {
                id,
                source: PlanSource::Shifted,
                ..SetpointPlan::clone(last)
            }),
            (Some(knots), None) => self.stamped(knots, start, id),
            (None, None) => None,
        }
    }

    /// The knots as a plan in the robot's clock.
    fn stamped(
        &self,
        knots: Knots,
        start: Instant<AgentClock>,
        id: PlanId,
    ) -> Option<SetpointPlan> {
        let life = self.life.as_ref()?;
        let based_on = life.telemetry.stamp;
        let lead = start.since(based_on);
        // Played from its start to its last knot and no further; max_age may end it sooner.
        let valid_for = (lead + self.settings.horizon_length()).min(self.settings.max_age);
        let mut plan = SetpointPlan {
            robot: self.id,
            boot_id: life.boot_id,
            id,
            based_on,
            start,
            period: Span::from_secs_f64(KNOT),
            valid_for,
            source: knots.source,
            u: knots.u,
            x: knots.x,
            k: knots.k,
        };
        match self.settings.compensation {
            Compensation::Full => {}
            Compensation::NoGains => plan.k.clear(),
            Compensation::Naive => {
                // One command, in force from arrival on, whenever that is.
                plan.k.clear();
                plan.u.truncate(1);
                plan.x.truncate(2);
                plan.start = based_on;
                plan.period = valid_for;
            }
        }
        Some(plan)
    }

    fn on_reboot(&mut self, boot_id: u64) {
        if self.past_boots.len() == PAST_BOOTS {
            self.past_boots.pop_front();
        }
        self.past_boots.push_back(boot_id);
        self.task.interrupt(&self.link);
        self.link.restart();
        self.predictor.clear();
        self.planner.reset();
        self.lease.restart();
        self.refused_versions = 0;
        self.life = None;
    }
}

/// Whether a robot can be in this state at all: the planner's mathematics need it.
fn is_plausible(telemetry: &Telemetry) -> bool {
    let state = &telemetry.state;
    let within = |value: f64, limit: f64| value.abs() <= limit;
    within(state.x, 1e7)
        && within(state.y, 1e7)
        && within(state.heading, 1e6)
        && within(state.v, 100.0)
        && within(telemetry.v_d, 100.0)
        && within(state.q_r, ROLL_END)
        && within(telemetry.q_rd, ROLL_END)
}

/// Time between two telemetries from which a command's acknowledgement still tells when it arrived: longer after a pause of the
/// station, a cut, or losses, and the command may have waited for any part of it.
const ECHO_WITHIN: Span = Span::from_millis(300);
/// Largest standard deviation of the position with which a mission begins [m].
const POSITION_SIGMA_MAX: f64 = 0.2;
/// Telemetry whose stamp advances by this much more than the station's clock is from a broken clock.
const AHEAD_MAX: Span = Span::from_millis(60_000);
/// Earlier lives whose late packets are recognised.
const PAST_BOOTS: usize = 8;
/// Schema versions told of: nobody has so many.
const INCOMPATIBLE_MAX: usize = 8;
/// Roll beyond which the kinematics mean nothing [rad].
const ROLL_END: f64 = 1.4;
