//! Agents as they are deployed, some or all of a swarm in one process: each its control thread, its motor link and its Zenoh session.

use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use anyhow::{Context, bail};
use sphere_agent::run::statistics::{Statistics, Traffic};
use sphere_agent::run::{Report, RunError, Setup, Snapshot};
use sphere_protocol::io::bus::Role;
use sphere_protocol::io::link::UdpLink;
use sphere_protocol::message::Mode;
use sphere_protocol::robot::RobotId;
use sphere_protocol::time::Instant;
use tokio::sync::mpsc;
use tokio::task::JoinHandle;

use super::{Asks, begin, bind, calendar, next, say};
use crate::demo::fresh_id;
use crate::swarm::message::{AgentMark, Answer, Ask, Mark, PartSetup};
use crate::swarm::scenario;
use crate::trace::mode_name;
use crate::world::agent_config;

struct LiveAgent {
    id: RobotId,
    shown: Arc<Mutex<Snapshot>>,
    stop: mpsc::Sender<()>,
    task: JoinHandle<Result<Report, RunError>>,
}

pub(super) async fn run(setup: &PartSetup, mut asks: Asks) -> anyhow::Result<()> {
    let scenario = scenario(setup.robots, setup.seed, setup.telemetry_ms)?;
    let (sockets, addresses) = bind(setup.last - setup.first)?;
    say(&Answer::Bound(addresses))?;
    let Some((boards, Some(router))) = begin(&mut asks).await else {
        return Ok(());
    };
    let mut agents = Vec::new();
    let mine = scenario.robots[setup.first..setup.last].iter();
    for ((robot, socket), board) in mine.zip(sockets).zip(boards) {
        let shown = Arc::new(Mutex::new(Snapshot {
            statistics: Some(Box::new(Statistics::new())),
            ..Snapshot::default()
        }));
        let (stop, stopped) = mpsc::channel(2);
        let agent = Setup {
            agent: agent_config(robot, fresh_id()),
            link: UdpLink::pinned(socket, board)?,
            network: Role::Client {
                connect: vec![format!("tcp/{router}")],
            },
            watch: Some(shown.clone()),
            recorder: None,
        };
        agents.push(LiveAgent {
            id: robot.id,
            shown,
            stop,
            task: tokio::spawn(sphere_agent::run::run(agent, stopped)),
        });
        tokio::time::sleep(APART).await;
    }
    say(&Answer::Begun)?;
    let mut check = tokio::time::interval(Duration::from_millis(500));
    loop {
        let ask = tokio::select! {
            ask = next(&mut asks) => ask,
            _ = check.tick() => {
                if let Some(agent) = agents.iter_mut().find(|agent| agent.task.is_finished()) {
                    let report = (&mut agent.task).await.context("a defect")?;
                    report.with_context(|| format!("the agent of {}", agent.id))?;
                    bail!("the agent of {} ended by itself", agent.id);
                }
                continue;
            }
        };
        match ask {
            Some(Ask::Look) => say(&seen(&agents))?,
            Some(Ask::Mark) => {
                let marks = agents.iter().map(mark).collect::<Option<Vec<_>>>();
                let marks = marks.context("an agent has not begun to control")?;
                say(&Answer::Marked(Box::new(Mark::Agents(marks))))?;
            }
            Some(Ask::Begin { .. } | Ask::Stop) => {}
            None => break,
        }
    }
    for agent in &agents {
        // One that has ended has nothing to be told.
        let _ = agent.stop.try_send(());
    }
    for agent in agents {
        let report = agent.task.await.context("a defect")?;
        report.with_context(|| format!("the agent of {}", agent.id))?;
    }
    Ok(())
}

fn shown(agent: &LiveAgent) -> Snapshot {
    agent
        .shown
        .lock()
        .unwrap_or_else(PoisonError::into_inner)
        .clone()
}

fn seen(agents: &[LiveAgent]) -> Answer {
    let mut tracking = 0;
    let mut others = Vec::new();
    for agent in agents {
        let shown = shown(agent);
        if shown.mode == Some(Mode::Tracking) {
            tracking += 1;
        } else if others.len() < OTHERS_MAX {
            let mode = shown.mode.map_or("not begun", mode_name);
            let reason = shown.reason.map(|reason| format!(" ({reason})"));
            others.push(format!(
                "{}: {mode}{}",
                agent.id,
                reason.unwrap_or_default()
            ));
        }
    }
    Answer::Seen { tracking, others }
}

/// `None` before its first control step.
fn mark(agent: &LiveAgent) -> Option<AgentMark> {
    let shown = shown(agent);
    let clock = shown.clock?;
    let statistics = shown.statistics?;
    let pair = |traffic: Traffic| [traffic.messages, traffic.bytes];
    Some(AgentMark {
        zero_ns: calendar(clock.deadline(Instant::from_nanos(0))),
        lateness: statistics.lateness.sparse(),
        arrival_age: statistics.arrival_age.sparse(),
        beginning_age: statistics.beginning_age.sparse(),
        modes: statistics.modes.to_vec(),
        sent: pair(statistics.sent),
        received: pair(statistics.received),
        dropped: statistics.dropped,
        outbox_full: statistics.outbox_full,
        inbox_full: statistics.inbox_full,
        frames_dropped: statistics.frames_dropped,
    })
}

/// Between the starts of two agents: control periods of 20 ms at the golden ratio, so that the phases of any number are spread evenly.
const APART: Duration = Duration::from_micros(12_361);
/// Robots that do not track, told of one by one.
const OTHERS_MAX: usize = 5;
