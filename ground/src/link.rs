//! What the station knows of a robot's link and clock: only what echoes tell, nothing configured.
//!
//! Two differences between the clocks can be measured without knowing either delay or offset:
//!
//!   down = a plan's arrival (agent) − its sending (station),   up = telemetry's arrival (station) − its stamp (agent).
//!
//! The robot reports a plan's arrival as `loop_delay`, counted from `based_on`, all in its own clock. A quantile of `down` added to the
//! time of sending is the agent's time of arrival: the one number that a plan's start needs, whatever the offset. Adding the two
//! cancels the offset; halving their least sum, the one assumption of symmetry here, gives the offset itself, which serves to
//! tell an operator times and to carry a mission over a reboot, never to time a plan.

use std::collections::VecDeque;

use sphere_protocol::time::{AgentClock, GroundClock, Instant, Span};

/// Echo statistics of one robot's link in one life of its agent.
#[derive(Clone, Debug, Default)]
pub struct Link {
    /// Arrival (agent) minus sending (station) of the last acknowledged plans [ns].
    down: VecDeque<i64>,
    /// The same, ascending.
    ranked: Vec<i64>,
    /// Least arrival (station) minus stamp (agent) of telemetry in each of the last [`BUCKETS`] seconds: (second, ns).
    up: VecDeque<(i64, i64)>,
    /// The least that a command's acknowledgement gives for `down` before any plan was echoed [ns]: too long by up to the time between
    /// two telemetries.
    command_down: Option<i64>,
    /// Half the least loop, from this or an earlier life.
    half_loop: Span,
}

impl Link {
    /// Telemetry stamped `stamp` arrived.
    pub fn on_telemetry(&mut self, stamp: Instant<AgentClock>, arrived: Instant<GroundClock>) {
        let gap = arrived.as_nanos().saturating_sub(stamp.as_nanos());
        let second = arrived.as_nanos().div_euclid(1_000_000_000);
        match self.up.back_mut() {
            Some((bucket, least)) if *bucket == second => *least = gap.min(*least),
            _ => self.up.push_back((second, gap)),
        }
        if self.up.len() > BUCKETS {
            self.up.pop_front();
        }
    }

    /// The plan sent at `sent` arrived at `arrived`.
    pub fn on_echo(&mut self, sent: Instant<GroundClock>, arrived: Instant<AgentClock>) {
        if self.down.len() == ECHOES
            && let Some(oldest) = self.down.pop_front()
        {
            let rank = self.ranked.partition_point(|gap| *gap < oldest);
            self.ranked.remove(rank);
        }
        let gap = arrived.as_nanos().saturating_sub(sent.as_nanos());
        self.down.push_back(gap);
        let rank = self.ranked.partition_point(|other| *other < gap);
        self.ranked.insert(rank, gap);
        self.halve_loop();
    }

    /// The first telemetry that acknowledges the command sent at `sent` has this `stamp`.
    pub fn on_command_echo(&mut self, sent: Instant<GroundClock>, stamp: Instant<AgentClock>) {
        let gap = stamp.as_nanos().saturating_sub(sent.as_nanos());
        self.command_down = Some(self.command_down.map_or(gap, |least| least.min(gap)));
        if self.down.is_empty() {
            self.halve_loop();
        }
    }

    /// The agent was started anew: its clock may be another one, the network is still the same.
    pub fn restart(&mut self) {
        self.down.clear();
        self.ranked.clear();
        self.up.clear();
        self.command_down = None;
    }

    /// By when a plan sent at `sent` will have arrived, nearly always: the 95 % quantile of the last 64. `None` before the
    /// first echo, of a plan or a command.
    ///
    /// Early costs a little of the feedback's freshness, because the plan waits on board for its start; late costs a jump from the plan before it.
    pub fn arrival(&self, sent: Instant<GroundClock>) -> Option<Instant<AgentClock>> {
        let rank = (self.ranked.len() * QUANTILE_PERCENT).div_ceil(100);
        let gap = match rank.checked_sub(1) {
            Some(i) => self.ranked[i],
            None => self.command_down?,
        };
        Some(Instant::from_nanos(sent.as_nanos().saturating_add(gap)))
    }

    /// What the agent's clock shows at `ground`, as far as that can be known. `None` before the first telemetry.
    pub fn agent_time(&self, ground: Instant<GroundClock>) -> Option<Instant<AgentClock>> {
        let gap = self.up_least()?;
        Some(Instant::from_nanos(ground.as_nanos().saturating_sub(gap)) + self.half_loop)
    }

    /// What the station's clock shows at `agent`; the inverse of [`Link::agent_time`].
    pub fn ground_time(&self, agent: Instant<AgentClock>) -> Option<Instant<GroundClock>> {
        let gap = self.up_least()?;
        Some(Instant::from_nanos(agent.as_nanos().saturating_add(gap)) - self.half_loop)
    }

    /// Least delay there and back; zero before the first echo.
    pub fn loop_least(&self) -> Span {
        self.half_loop + self.half_loop
    }

    fn halve_loop(&mut self) {
        let down = self.ranked.first().copied().or(self.command_down);
        if let (Some(up), Some(down)) = (self.up_least(), down) {
            // A clock that drifts can make the sum of minima of different times negative; a delay cannot be.
            self.half_loop = Span::from_nanos((up.saturating_add(down) / 2).max(0));
        }
    }

    fn up_least(&self) -> Option<i64> {
        self.up.iter().map(|(_, gap)| *gap).min()
    }
}

/// Echoes remembered: 6 s at 10 Hz, so that a changed delay is followed after four of them and a drift of 100 ppm costs under 1 ms.
const ECHOES: usize = 64;
/// Share of plans that arrive by their start.
const QUANTILE_PERCENT: usize = 95;
/// Seconds over which the least delay upwards is taken.
const BUCKETS: usize = 32;

#[cfg(test)]
mod tests {
    use super::*;

    fn ground(ms: i64) -> Instant<GroundClock> {
        Instant::from_nanos(ms * 1_000_000)
    }
    fn agent(ms: i64) -> Instant<AgentClock> {
        Instant::from_nanos(ms * 1_000_000)
    }

    /// 70 ms up, 70 to 170 ms down, the agent's clock 1000 s ahead.
    #[test]
    fn echoes_give_arrival_and_offset() {
        let mut link = Link::default();
        assert_eq!(link.arrival(ground(0)), None);
        assert_eq!(link.agent_time(ground(0)), None);
        for i in 0..100 {
            let sent = 100 * i;
            link.on_telemetry(agent(1_000_000 + sent), ground(sent + 70 + i % 3));
            link.on_echo(ground(sent), agent(1_000_000 + sent + 70 + (i * 37) % 101));
        }
        let arrival = link.arrival(ground(20_000)).expect("echoes").as_nanos() / 1_000_000;
        assert!((1_020_160..=1_020_170).contains(&arrival), "{arrival}");
        let now = link.agent_time(ground(20_000)).expect("telemetry");
        assert!(
            (now.since(agent(1_020_000))).as_secs_f64().abs() < 0.002,
            "{now:?}"
        );
        assert_eq!(link.ground_time(now), Some(ground(20_000)));
    }

    /// A longer way is followed within four echoes, a shorter one within the window.
    #[test]
    fn a_changed_delay_is_followed() {
        let mut link = Link::default();
        for i in 0..200 {
            link.on_echo(ground(100 * i), agent(100 * i + 50));
        }
        assert_eq!(link.ranked.len(), ECHOES);
        for i in 200..204 {
            link.on_echo(ground(100 * i), agent(100 * i + 500));
        }
        assert_eq!(link.arrival(ground(0)), Some(agent(500)));
        for i in 204..204 + 64 {
            link.on_echo(ground(100 * i), agent(100 * i + 20));
        }
        assert_eq!(link.arrival(ground(0)), Some(agent(20)));
    }

    /// Stamps at the ends of time saturate.
    #[test]
    fn hostile_stamps_do_not_overflow() {
        let mut link = Link::default();
        link.on_telemetry(Instant::from_nanos(i64::MIN), Instant::from_nanos(i64::MAX));
        link.on_echo(Instant::from_nanos(i64::MIN), Instant::from_nanos(i64::MAX));
        let _ = link.arrival(Instant::from_nanos(i64::MAX));
        let _ = link.agent_time(Instant::from_nanos(i64::MIN));
        let _ = link.ground_time(Instant::from_nanos(i64::MAX));
    }
}
