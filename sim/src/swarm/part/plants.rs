//! The plants of a swarm, all on one thread, and where they truly are ten times a second.

use std::time::Duration;

use anyhow::Context;
use sphere_protocol::io::link::UdpLink;
use tokio::time::MissedTickBehavior;

use super::{Asks, begin, bind, calendar, next, say};
use crate::live::{Plants, plant_setup};
use crate::swarm::message::{Answer, Ask, Mark, PartSetup, PlantsMark, TruthMark};
use crate::swarm::scenario;

pub(super) async fn run(setup: &PartSetup, mut asks: Asks) -> anyhow::Result<()> {
    let scenario = scenario(setup.robots, setup.seed, setup.telemetry_ms)?;
    let (sockets, addresses) = bind(setup.robots)?;
    say(&Answer::Bound(addresses))?;
    let Some((agents, _)) = begin(&mut asks).await else {
        return Ok(());
    };
    let mut setups = Vec::new();
    for (index, (socket, agent)) in sockets.into_iter().zip(agents).enumerate() {
        let link = UdpLink::pinned(socket, agent)?;
        setups.push(plant_setup(&scenario, index, link));
    }
    let plants = Plants::start(setups)?;
    say(&Answer::Begun)?;
    let mut truths: Option<Vec<Vec<TruthMark>>> = None;
    let mut look = tokio::time::interval(PERIOD);
    look.set_missed_tick_behavior(MissedTickBehavior::Skip);
    loop {
        let ask = tokio::select! {
            ask = next(&mut asks) => ask,
            _ = look.tick() => {
                if !plants.is_running() {
                    plants.stop().context("the plants")?;
                    return Ok(());
                }
                for (kept, now) in truths.iter_mut().flatten().zip(plants.truths()) {
                    let truth = now.newest();
                    kept.push((calendar(truth.at), truth.state.x, truth.state.y));
                }
                continue;
            }
        };
        match ask {
            Some(Ask::Mark) => {
                let pace = plants.pace();
                let kept = truths.replace(vec![Vec::new(); setup.robots]);
                say(&Answer::Marked(Box::new(Mark::Plants(PlantsMark {
                    steps: pace.steps,
                    late: pace.late,
                    lateness_max_ns: u64::try_from(pace.lateness_max.as_nanos())
                        .unwrap_or(u64::MAX),
                    truths: kept.unwrap_or_default(),
                }))))?;
            }
            Some(Ask::Look | Ask::Begin { .. } | Ask::Stop) => {}
            None => break,
        }
    }
    plants.stop().context("the plants")?;
    Ok(())
}

/// Between two looks at the true positions.
const PERIOD: Duration = Duration::from_millis(100);
