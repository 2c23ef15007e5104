//! How old a stamp of the motor board's clock is on the agent's clock.

use sphere_protocol::time::{AgentClock, BoardClock, Instant, Span};

/// The board's clock seen from the agent's: the smallest (arrival − stamp) seen, which is their offset plus the shortest delay of
/// the link. It leaks upwards so that a slow drift between the two crystals is followed.
#[derive(Clone, Copy, Debug, Default)]
pub struct BoardClockMap {
    newest: Option<Sample>,
}

#[derive(Clone, Copy, Debug)]
struct Sample {
    offset: i64,
    at: Instant<AgentClock>,
    stamp: Instant<BoardClock>,
}

/// Twice the worst drift between two ordinary crystals.
const LEAK_PPM: i64 = 200;
/// A stamp this much older than the one before comes from a board that has restarted. One that is merely late has a newer stamp.
const RESTART: Span = Span::from_millis(500);

impl BoardClockMap {
    /// Learns from a frame stamped `stamp` that arrived at `arrival`.
    pub fn observe(&mut self, arrival: Instant<AgentClock>, stamp: Instant<BoardClock>) {
        let offset = arrival.as_nanos().saturating_sub(stamp.as_nanos());
        let offset = match self.newest {
            Some(known) if known.stamp.since(stamp) < RESTART => {
                let elapsed = (arrival - known.at).as_nanos().max(0);
                offset.min(known.offset.saturating_add(elapsed / 1_000_000 * LEAK_PPM))
            }
            _ => offset,
        };
        self.newest = Some(Sample {
            offset,
            at: arrival,
            stamp,
        });
    }

    /// Age of `stamp` at `now`, less the link's shortest delay; zero before the first frame.
    pub fn age(&self, now: Instant<AgentClock>, stamp: Instant<BoardClock>) -> Span {
        self.newest.map_or(Span::ZERO, |known| {
            Span::from_nanos(
                now.as_nanos()
                    .saturating_sub(stamp.as_nanos())
                    .saturating_sub(known.offset),
            )
        })
    }
}
