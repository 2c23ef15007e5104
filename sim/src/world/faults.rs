//! What goes wrong by the scenario: programs that stop, stand still and start again, links that hold packets back and repeat them.

use std::collections::VecDeque;

use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use sphere_agent::agent::{Agent, Input as AgentInput};
use sphere_agent::estimator::StartPose;
use sphere_ground::station::Input as StationInput;
use sphere_ground::tasking::StartCondition;
use sphere_protocol::robot::RobotId;
use sphere_protocol::time::{Instant, Span};

use super::process::{Process, Waiting};
use super::{Happening, Inject, World, WorldTime, planning, setup, sum};
use crate::scenario::{Fault, FaultKind, Scenario};

/// Faults of one robot's link.
pub(super) struct LinkFaults {
    /// Packets handed over before this arrive no sooner.
    stale_until: WorldTime,
    /// Plans made before this leave the station late.
    slow_until: WorldTime,
    /// Packets to send again, with where they went; empty unless the scenario replays some.
    recorded: VecDeque<(Inject, Vec<u8>, Vec<u8>)>,
    records: bool,
    random: ChaCha8Rng,
}

impl World {
    pub(super) fn fault_begins(&mut self, now: WorldTime, index: usize) {
        let fault = &self.scenario.faults[index];
        let end = Span::from_secs_f64(fault.at_s) + Span::from_secs_f64(fault.for_s);
        let kind = fault.kind;
        match kind {
            FaultKind::StationCrash if self.station_process.is_running() => {
                self.station_process = Process::Down;
                for (id, session) in self.station.sessions() {
                    let earlier = self.earlier_plans.entry(*id).or_default();
                    *earlier = sum(*earlier, *session.counters());
                }
            }
            FaultKind::StationFreeze if self.station_process.is_running() => {
                self.station_process = Process::Frozen(Waiting::default());
            }
            FaultKind::StationCrash | FaultKind::StationFreeze => {}
            FaultKind::Replay => self.schedule(now, Happening::Replay { fault: index }),
            FaultKind::AgentCrash
            | FaultKind::Freeze
            | FaultKind::Stale
            | FaultKind::SlowPlanner => {
                for cell in &mut self.robots {
                    if !concerns(fault, &cell.id) {
                        continue;
                    }
                    match kind {
                        FaultKind::AgentCrash => cell.process = Process::Down,
                        FaultKind::Freeze if cell.process.is_running() => {
                            cell.process = Process::Frozen(Waiting::default());
                        }
                        FaultKind::Stale => {
                            let until = &mut cell.link_faults.stale_until;
                            *until = end.max(*until);
                        }
                        FaultKind::SlowPlanner => {
                            let until = &mut cell.link_faults.slow_until;
                            *until = end.max(*until);
                        }
                        _ => {}
                    }
                }
            }
        }
    }

    pub(super) fn fault_ends(&mut self, now: WorldTime, index: usize) {
        let fault = self.scenario.faults[index].clone();
        match fault.kind {
            FaultKind::StationCrash if matches!(self.station_process, Process::Down) => {
                self.restart_station(now);
            }
            FaultKind::StationFreeze if matches!(self.station_process, Process::Frozen(_)) => {
                for (key, bytes) in self.station_process.resume().messages {
                    let key = String::from_utf8_lossy(&key);
                    let (key, bytes) = (&*key, &*bytes);
                    self.station_input(now, StationInput::Message { key, bytes });
                }
                self.station_due = now;
                self.station_input(now, StationInput::Timeout);
            }
            FaultKind::StationCrash | FaultKind::StationFreeze | FaultKind::Replay => {}
            kind => {
                for robot in 0..self.robots.len() {
                    let cell = &mut self.robots[robot];
                    if !concerns(&fault, &cell.id) {
                        continue;
                    }
                    match kind {
                        FaultKind::AgentCrash if matches!(cell.process, Process::Down) => {
                            self.restart_agent(now, robot);
                        }
                        FaultKind::Freeze if matches!(cell.process, Process::Frozen(_)) => {
                            self.wake_agent(now, robot);
                        }
                        _ => {}
                    }
                }
            }
        }
    }

    /// Another station takes the place of the one that is gone. As one that keeps a journal it knows when each mission began.
    fn restart_station(&mut self, now: WorldTime) {
        self.station_lives += 1;
        let mut config = setup::station_config(&self.scenario, self.station_id);
        config.station += self.station_lives;
        for robot in &mut config.robots {
            let cell = self.robots.iter().find(|cell| cell.id == robot.id);
            if let Some((_, begin)) = cell.and_then(|cell| cell.mission.as_ref()) {
                let began = Instant::from_nanos(begin.as_nanos()) + self.station_clock;
                robot.start = StartCondition::At(began);
            }
        }
        let station_now = Instant::from_nanos(now.as_nanos()) + self.station_clock;
        self.station = planning::station(&self.scenario, config, station_now);
        self.station_free = now;
        self.station_process = Process::Running;
        self.station_due = now;
        self.schedule(now, Happening::StationTimeout);
    }

    /// The agent starts anew: another boot, and where it is it does not know.
    fn restart_agent(&mut self, now: WorldTime, robot: usize) {
        let cell = &mut self.robots[robot];
        cell.lives += 1;
        cell.earlier_adopted += cell.agent.playback().begun();
        let (boot_id, _) = setup::drawn_clocks(self.scenario.seed, robot);
        let mut config = setup::agent_config(
            &self.scenario.robots[robot],
            boot_id + u64::from(cell.lives),
        );
        config.estimator.start = StartPose {
            position_sigma: LOST_POSITION,
            heading_sigma: core::f64::consts::PI,
            ..config.estimator.start
        };
        let boot_id = config.boot_id;
        // The gains are those of the life before: they were accepted.
        if let Ok(agent) = Agent::new(cell.agent_now(now), config) {
            cell.agent = agent;
            cell.process = Process::Running;
            cell.newest_plan = None;
            cell.agent_due = now;
            let agent_now = cell.agent_now(now);
            self.monitor.on_agent_start(robot, boot_id, agent_now);
            self.schedule(now, Happening::AgentTimeout { robot });
        }
    }

    fn wake_agent(&mut self, now: WorldTime, robot: usize) {
        let Waiting { frames, messages } = self.robots[robot].process.resume();
        for frame in frames {
            self.agent_input(now, robot, AgentInput::Motor(&frame));
        }
        for (key, bytes) in messages {
            let key = String::from_utf8_lossy(&key);
            let (key, bytes) = (&*key, &*bytes);
            self.agent_input(now, robot, AgentInput::Message { key, bytes });
        }
        self.robots[robot].agent_due = now;
        self.schedule(now, Happening::AgentTimeout { robot });
    }

    /// Sends one packet again for each robot concerned, drawn from what it sent or was sent.
    pub(super) fn replay(&mut self, now: WorldTime, index: usize) {
        let fault = self.scenario.faults[index].clone();
        for robot in 0..self.robots.len() {
            let cell = &mut self.robots[robot];
            let faults = &mut cell.link_faults;
            if !concerns(&fault, &cell.id) || faults.recorded.is_empty() {
                continue;
            }
            let drawn = faults.random.random_range(0..faults.recorded.len());
            let (to, key, bytes) = faults.recorded[drawn].clone();
            let happening = match to {
                Inject::Station => Happening::ToStation { key, bytes },
                _ => Happening::ToAgent { robot, key, bytes },
            };
            self.schedule(now, happening);
        }
        let next = now + REPLAY_PERIOD;
        if next.as_secs_f64() < fault.at_s + fault.for_s {
            self.schedule(next, Happening::Replay { fault: index });
        }
    }
}

impl LinkFaults {
    /// None yet. `random` draws what is replayed.
    pub(super) fn new(scenario: &Scenario, robot: &RobotId, random: ChaCha8Rng) -> Self {
        let replays = |fault: &Fault| fault.kind == FaultKind::Replay && concerns(fault, robot);
        Self {
            stale_until: Span::ZERO,
            slow_until: Span::ZERO,
            recorded: VecDeque::new(),
            records: scenario.faults.iter().any(replays),
            random,
        }
    }

    pub(super) fn record(&mut self, to: Inject, key: &[u8], bytes: &[u8]) {
        if self.records {
            if self.recorded.len() == RECORDED_MAX {
                self.recorded.pop_front();
            }
            self.recorded.push_back((to, key.to_vec(), bytes.to_vec()));
        }
    }

    /// When what is handed over at `now` and would arrive at `arrival` does.
    pub(super) fn held(&self, now: WorldTime, arrival: WorldTime) -> WorldTime {
        if now < self.stale_until {
            arrival.max(self.stale_until)
        } else {
            arrival
        }
    }

    /// How much longer a plan takes that is made at `now`.
    pub(super) fn planning_delay(&self, now: WorldTime) -> Span {
        if now < self.slow_until {
            SLOW_PLANNING
        } else {
            Span::ZERO
        }
    }
}

/// Whether `fault` befalls `robot`: an empty list is everybody.
fn concerns(fault: &Fault, robot: &RobotId) -> bool {
    fault.robots.is_empty() || fault.robots.contains(robot)
}

/// How much longer it takes while a scenario slows the planner: six of its periods.
const SLOW_PLANNING: Span = Span::from_millis(600);
/// Time between two packets that are sent again while a scenario replays them.
const REPLAY_PERIOD: Span = Span::from_millis(50);
/// Packets kept to be sent again: some 10 s of a robot's.
const RECORDED_MAX: usize = 512;
/// Standard deviation of a position of which an agent that has started anew knows nothing [m].
const LOST_POSITION: f64 = 100.0;
