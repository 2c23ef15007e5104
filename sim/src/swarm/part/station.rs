//! The station of a swarm with its router: as deployed, asked now and then what it knows.

use std::net::{Ipv4Addr, SocketAddr, TcpListener};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use anyhow::Context;
use sphere_ground::run::{Running, Setup, Watch};
use sphere_ground::station::Station;
use sphere_protocol::io::bus::Role;
use sphere_protocol::message::DropReason;

use super::{Asks, next, say};
use crate::demo::fresh_id;
use crate::swarm::message::{Answer, Ask, Mark, PartSetup, StationMark};
use crate::swarm::scenario;
use crate::world::station_config;

/// What is wanted of the station's core, and what it told.
#[derive(Default)]
enum Wish {
    #[default]
    None,
    Wanted,
    Told(Box<Told>),
}

struct Told {
    anchors: Vec<Option<i64>>,
    plans: u64,
    shifted: u64,
    failed: u64,
    stale: u64,
    dropped: [u32; DropReason::COUNT],
}

pub(super) async fn run(setup: &PartSetup, mut asks: Asks) -> anyhow::Result<()> {
    let scenario = scenario(setup.robots, setup.seed, setup.telemetry_ms)?;
    let ids: Vec<_> = scenario.robots.iter().map(|robot| robot.id).collect();
    let wish = Arc::<Mutex<Wish>>::default();
    let mut attempts = 0;
    let (station, at) = loop {
        attempts += 1;
        let port = TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).context("no free port")?;
        let at: SocketAddr = port.local_addr()?;
        drop(port);
        let (wish, ids) = (wish.clone(), ids.clone());
        let watch: Watch = Box::new(move |station, _| {
            // Called after every message: unless something is wanted it costs a lock that is free.
            let Ok(mut wish) = wish.try_lock() else {
                return;
            };
            if matches!(*wish, Wish::Wanted) {
                *wish = Wish::Told(Box::new(told(station, &ids)));
            }
        });
        let setup = Setup {
            station: station_config(&scenario, fresh_id()),
            network: Role::Router {
                listen: vec![format!("tcp/{at}")],
            },
            threads: None,
            watch: Some(watch),
        };
        match Running::start(setup).await {
            Ok(station) => break (station, at),
            // Somebody was faster: between the look at a port and its use others may take it.
            Err(error) if attempts == ATTEMPTS => return Err(error.into()),
            Err(_) => {}
        }
    };
    say(&Answer::Listening(at))?;
    while let Some(ask) = next(&mut asks).await {
        if let Ask::Mark = ask {
            let told = ask_for(&wish)
                .await
                .context("the planning thread does not answer")?;
            let statistics = station.statistics();
            say(&Answer::Marked(Box::new(Mark::Station(StationMark {
                anchors: told.anchors,
                plans: told.plans,
                shifted: told.shifted,
                failed: told.failed,
                stale: told.stale,
                dropped: told.dropped,
                lateness: statistics.lateness.sparse(),
                received: statistics.received,
                sent: statistics.sent,
                overtaken: statistics.overtaken,
                refused: statistics.refused,
            }))))?;
        }
    }
    station.stop().await?;
    Ok(())
}

/// `None` if the planning thread has not come by within two seconds.
async fn ask_for(wish: &Mutex<Wish>) -> Option<Box<Told>> {
    let lock = || wish.lock().unwrap_or_else(PoisonError::into_inner);
    *lock() = Wish::Wanted;
    for _ in 0..2000 {
        tokio::time::sleep(Duration::from_millis(1)).await;
        let mut wish = lock();
        if matches!(*wish, Wish::Told(_))
            && let Wish::Told(told) = core::mem::take(&mut *wish)
        {
            return Some(told);
        }
    }
    None
}

fn told(station: &Station, ids: &[sphere_protocol::robot::RobotId]) -> Told {
    let mut told = Told {
        anchors: Vec::with_capacity(ids.len()),
        plans: 0,
        shifted: 0,
        failed: 0,
        stale: 0,
        dropped: *station.dropped(),
    };
    for id in ids {
        let anchor = station.mission_anchor(id);
        told.anchors
            .push(anchor.map(|(_, anchor)| anchor.as_nanos()));
        if let Some(session) = station.session(id) {
            let counters = session.counters();
            told.plans += counters.plans_sent;
            told.shifted += counters.shifted;
            told.failed += counters.failed;
            told.stale += counters.stale;
            for (sum, count) in told.dropped.iter_mut().zip(counters.dropped) {
                *sum = sum.saturating_add(count);
            }
        }
    }
    told
}

/// Ports tried.
const ATTEMPTS: u32 = 4;
