//! The relay of a swarm: one port for all agents; each connection is delayed by itself.

use std::net::{Ipv4Addr, SocketAddr};

use super::{Asks, begin, next, say};
use crate::body::{Purpose, stream};
use crate::network::LinkModel;
use crate::relay::{Direction, Relay};
use crate::swarm::message::{Answer, Ask, Mark, PartSetup, WayMark};

pub(super) async fn run(setup: &PartSetup, mut asks: Asks) -> anyhow::Result<()> {
    let Some((_, Some(router))) = begin(&mut asks).await else {
        return Ok(());
    };
    let direction = |purpose| Direction {
        model: LinkModel {
            delay: setup.delay_ms * 1e-3,
            jitter: setup.jitter_ms * 1e-3,
            loss: 0.0,
        },
        random: stream(setup.seed, 0, purpose),
    };
    let relay = Relay::start(
        SocketAddr::from((Ipv4Addr::LOCALHOST, 0)),
        router,
        direction(Purpose::LinkUp),
        direction(Purpose::LinkDown),
    )
    .await?;
    say(&Answer::Listening(relay.address()))?;
    while let Some(ask) = next(&mut asks).await {
        if let Ask::Mark = ask {
            let [up, down] = relay.delays();
            let ways = [(relay.up(), up), (relay.down(), down)];
            let ways = ways.map(|(counters, delays)| WayMark {
                segments: counters.segments,
                bytes: counters.bytes,
                meant: delays.meant.sparse(),
                measured: delays.measured.sparse(),
            });
            say(&Answer::Marked(Box::new(Mark::Relay(ways))))?;
        }
    }
    Ok(())
}
