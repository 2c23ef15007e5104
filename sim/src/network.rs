//! The simulated network: what becomes of each packet between a robot and the station.
//!
//! One [`Link`] is one direction of one robot's link, with random streams of its own: what happens on one link changes nothing
//! on another. A packet waits for the packets before it where the bandwidth is limited, then takes its delay; packets may overtake
//! each other by their delays, never in the queue.

use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, Exp1, StandardNormal, StandardUniform};
use sphere_protocol::time::Span;

/// Delay and independent loss of one direction of a link: what a relay on real sockets has too.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LinkModel {
    /// Mean delay [s].
    pub delay: f64,
    /// Standard deviation of the delay, truncated at zero delay; packets may overtake each other [s].
    pub jitter: f64,
    /// Probability that a packet is lost, each on its own.
    pub loss: f64,
}

/// What else befalls the packets of one direction. The default is nothing.
#[derive(Clone, Debug, PartialEq, Default)]
pub struct Impairments {
    /// How delays are distributed about their mean.
    pub distribution: Distributed,
    /// Loss that comes in bursts, on top of the model's own.
    pub burst: Option<Burst>,
    /// Probability that a packet arrives twice, the second time with a delay of its own [1].
    pub duplicate: f64,
    /// The bottleneck, if there is one.
    pub bottleneck: Option<Bottleneck>,
    /// Times in which nothing gets onto the link, from and to.
    pub cuts: Vec<(Span, Span)>,
}

/// How delays are distributed about their mean, with the jitter as standard deviation.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub enum Distributed {
    /// Normal, truncated at zero delay.
    #[default]
    Normal,
    /// Log-normal: a long tail, never below zero.
    LogNormal,
}

/// A link that is good and bad in turn, for times of exponential length: a process in time that all its packets share.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Burst {
    /// Mean length of the bad state [s].
    pub mean_bad: f64,
    /// Mean length of the good state [s].
    pub mean_good: f64,
    /// Probability that a packet is lost in the bad state [1].
    pub loss_bad: f64,
}

/// A bottleneck with a queue before it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bottleneck {
    /// Capacity, of payload and [`HEADERS`] [bit/s].
    pub rate: f64,
    /// A packet that would wait longer than this is lost [s].
    pub queue: f64,
}

/// Bytes that each packet has on the wire beside its payload: IPv4, UDP and Zenoh's own, about.
pub const HEADERS: usize = 60;

/// One direction of one robot's link.
#[derive(Clone, Debug)]
pub struct Link {
    model: LinkModel,
    impairments: Impairments,
    random: ChaCha8Rng,
    twins: ChaCha8Rng,
    /// When the bottleneck has sent all it was given.
    free_at: f64,
    weather: Weather,
    /// Packets handed to the link.
    pub sent: u64,
    /// Packets that never arrive.
    pub lost: u64,
    /// Bytes handed to the link, payload only.
    pub bytes: u64,
}

/// The random streams of one direction of one robot's link.
#[derive(Clone, Debug)]
pub struct LinkRandom {
    /// Each packet's delay and fate.
    pub packets: ChaCha8Rng,
    /// Each packet's fate in a burst, and its duplicate.
    pub twins: ChaCha8Rng,
    /// When bursts begin and end.
    pub weather: ChaCha8Rng,
}

/// The state of a [`Burst`] and when it ends.
#[derive(Clone, Debug)]
struct Weather {
    random: ChaCha8Rng,
    is_bad: bool,
    until: f64,
}

/// When a packet arrives, as delays from its sending: not at all, once, or twice.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub struct Arrivals {
    /// The first copy's.
    pub first: Option<Span>,
    /// The second copy's.
    pub second: Option<Span>,
}

impl IntoIterator for Arrivals {
    type Item = Span;
    type IntoIter = core::iter::Chain<std::option::IntoIter<Span>, std::option::IntoIter<Span>>;

    fn into_iter(self) -> Self::IntoIter {
        self.first.into_iter().chain(self.second)
    }
}

impl Link {
    /// A link with its own random streams.
    pub fn new(model: LinkModel, impairments: Impairments, random: LinkRandom) -> Self {
        Self {
            model,
            impairments,
            random: random.packets,
            twins: random.twins,
            free_at: 0.0,
            weather: Weather {
                random: random.weather,
                // A good state of no length: the first packet draws one.
                is_bad: true,
                until: 0.0,
            },
            sent: 0,
            lost: 0,
            bytes: 0,
        }
    }

    /// Hands over a packet of `bytes` bytes at `now`.
    ///
    /// Each packet draws both delays and its fates, used or not, so that changing one fault leaves the others' draws alone.
    pub fn transmit(&mut self, now: Span, bytes: usize) -> Arrivals {
        let normal: f64 = StandardNormal.sample(&mut self.random);
        let fate: f64 = StandardUniform.sample(&mut self.random);
        let twin_normal: f64 = StandardNormal.sample(&mut self.twins);
        let twin_fate: f64 = StandardUniform.sample(&mut self.twins);
        let burst_fate: f64 = StandardUniform.sample(&mut self.twins);
        self.sent += 1;
        self.bytes += bytes as u64;
        let at = now.as_secs_f64();
        let is_cut = self
            .impairments
            .cuts
            .iter()
            .any(|(from, to)| (*from..*to).contains(&now));
        let burst = self.impairments.burst;
        let is_burst = burst
            .is_some_and(|burst| self.weather.is_bad_at(at, &burst) && burst_fate < burst.loss_bad);
        let queued = if is_cut { None } else { self.queue(at, bytes) };
        let lost = fate < self.model.loss || is_burst;
        let (Some(queued), false) = (queued, lost) else {
            self.lost += 1;
            return Arrivals::default();
        };
        let arrival = |normal| Some(Span::from_secs_f64(queued + self.delay(normal)));
        let is_twin = twin_fate < self.impairments.duplicate;
        Arrivals {
            first: arrival(normal),
            second: if is_twin { arrival(twin_normal) } else { None },
        }
    }

    /// Time in the queue and on the bottleneck's wire [s]; `None` if the queue is full.
    fn queue(&mut self, at: f64, bytes: usize) -> Option<f64> {
        let Some(Bottleneck { rate, queue }) = self.impairments.bottleneck else {
            return Some(0.0);
        };
        let wait = (self.free_at - at).max(0.0);
        if wait > queue {
            return None;
        }
        let sent = wait + 8.0 * (bytes + HEADERS) as f64 / rate;
        self.free_at = at + sent;
        Some(sent)
    }

    /// The delay that a standard normal number stands for [s].
    fn delay(&self, normal: f64) -> f64 {
        let LinkModel { delay, jitter, .. } = self.model;
        match self.impairments.distribution {
            Distributed::LogNormal if delay > 0.0 && jitter > 0.0 => {
                // Of mean `delay` and standard deviation `jitter`.
                let variance = (1.0 + (jitter / delay).powi(2)).ln();
                (delay.ln() - 0.5 * variance + variance.sqrt() * normal).exp()
            }
            _ => (delay + jitter * normal).max(0.0),
        }
    }
}

impl Weather {
    /// Whether it is bad at `at` [s]; asked in the order of time.
    fn is_bad_at(&mut self, at: f64, burst: &Burst) -> bool {
        while self.until <= at {
            self.is_bad = !self.is_bad;
            let mean = if self.is_bad {
                burst.mean_bad
            } else {
                burst.mean_good
            };
            let length: f64 = Exp1.sample(&mut self.random);
            // A length of zero would stand still.
            self.until += (mean * length).max(1e-9);
        }
        self.is_bad
    }
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;

    use super::*;

    const MODEL: LinkModel = LinkModel {
        delay: 0.1,
        jitter: 0.02,
        loss: 0.1,
    };
    const SURE: LinkModel = LinkModel { loss: 0.0, ..MODEL };

    fn link(model: LinkModel, impairments: Impairments) -> Link {
        let random = ChaCha8Rng::seed_from_u64;
        let random = LinkRandom {
            packets: random(1),
            twins: random(2),
            weather: random(3),
        };
        Link::new(model, impairments, random)
    }

    /// Sends `count` packets of `bytes` bytes, one every `every` ms; their arrivals.
    fn send(link: &mut Link, count: i64, every: i64, bytes: usize) -> Vec<Arrivals> {
        (0..count)
            .map(|i| link.transmit(Span::from_millis(i * every), bytes))
            .collect()
    }

    fn delays(arrivals: &[Arrivals]) -> Vec<f64> {
        arrivals
            .iter()
            .filter_map(|arrivals| arrivals.first)
            .map(Span::as_secs_f64)
            .collect()
    }

    fn mean_and_deviation(values: &[f64]) -> (f64, f64) {
        let n = values.len() as f64;
        let mean = values.iter().sum::<f64>() / n;
        let variance = values.iter().map(|d| (d - mean).powi(2)).sum::<f64>() / n;
        (mean, variance.sqrt())
    }

    #[test]
    fn a_link_delays_and_loses_as_its_model_says() {
        let mut link = link(MODEL, Impairments::default());
        let arrived = delays(&send(&mut link, 20_000, 10, 100));
        let n = arrived.len() as f64;
        let (mean, deviation) = mean_and_deviation(&arrived);
        // Three standard errors of each estimate.
        assert!((n / 20_000.0 - 0.9).abs() < 0.0064, "{n} of 20000 arrived");
        assert!((mean - 0.1).abs() < 0.0005, "mean delay {mean}");
        assert!((deviation - 0.02).abs() < 0.0004, "jitter {deviation}");
        assert_eq!(link.lost, 20_000 - n as u64);
        assert_eq!(link.bytes, 2_000_000);
    }

    #[test]
    fn loss_leaves_the_delays_of_the_packets_that_arrive_alone() {
        let run = |loss| {
            let model = LinkModel { loss, ..MODEL };
            send(&mut link(model, Impairments::default()), 1000, 10, 1)
        };
        for (sure, lossy) in run(0.0).iter().zip(run(0.3)) {
            assert!(lossy.first.is_none() || lossy == *sure);
        }
    }

    #[test]
    fn log_normal_delays_have_the_same_mean_and_deviation_and_a_longer_tail() {
        let impairments = Impairments {
            distribution: Distributed::LogNormal,
            ..Impairments::default()
        };
        let model = LinkModel {
            jitter: 0.1,
            ..SURE
        };
        let arrived = delays(&send(&mut link(model, impairments), 100_000, 10, 1));
        let (mean, deviation) = mean_and_deviation(&arrived);
        assert!((mean - 0.1).abs() < 0.001, "mean {mean}");
        assert!((deviation - 0.1).abs() < 0.004, "deviation {deviation}");
        let beyond = arrived.iter().filter(|d| **d > 0.4).count();
        // A normal delay lies 3 deviations up in 0.13 % of all cases, this one in 1.8 %.
        assert!((1500..2100).contains(&beyond), "{beyond} beyond 0.4 s");
    }

    #[test]
    fn bursts_last_as_long_as_they_say_and_are_shared_by_all_packets() {
        let impairments = Impairments {
            burst: Some(Burst {
                mean_bad: 1.0,
                mean_good: 20.0,
                loss_bad: 1.0,
            }),
            ..Impairments::default()
        };
        // 2000 s at 100 Hz; twice as dense a traffic meets the same weather.
        let sparse = send(&mut link(SURE, impairments.clone()), 2_000_000, 10, 1);
        let dense = send(&mut link(SURE, impairments), 4_000_000, 5, 1);
        let lost = |arrivals: &[Arrivals]| {
            arrivals.iter().filter(|a| a.first.is_none()).count() as f64 / arrivals.len() as f64
        };
        // 952 cycles: the share of bad time is 1/21, to 3 standard errors.
        assert!(
            (lost(&sparse) - 1.0 / 21.0).abs() < 0.007,
            "{}",
            lost(&sparse)
        );
        assert!((lost(&sparse) - lost(&dense)).abs() < 1e-4);
        let begins = sparse
            .windows(2)
            .filter(|pair| pair[0].first.is_some() && pair[1].first.is_none())
            .count() as f64;
        let mean_bad = lost(&sparse) * 20_000.0 / begins;
        assert!(
            (mean_bad - 1.0).abs() < 0.11,
            "bad for {mean_bad} s on average"
        );
    }

    #[test]
    fn duplicates_arrive_twice_each_in_its_own_time() {
        let impairments = Impairments {
            duplicate: 0.25,
            ..Impairments::default()
        };
        let arrivals = send(&mut link(SURE, impairments), 20_000, 10, 1);
        let twins: Vec<_> = arrivals.iter().filter(|a| a.second.is_some()).collect();
        let share = twins.len() as f64 / 20_000.0;
        assert!((share - 0.25).abs() < 0.0092, "{share}");
        assert!(twins.iter().all(|twin| twin.first != twin.second));
    }

    #[test]
    fn a_bottleneck_queues_and_drops_what_would_wait_too_long() {
        // 1000 bytes with headers every 10 ms over 400 kbit/s: 20 ms each, half of them too many.
        let impairments = Impairments {
            bottleneck: Some(Bottleneck {
                rate: 400e3,
                queue: 0.5,
            }),
            ..Impairments::default()
        };
        let model = LinkModel {
            delay: 0.0,
            jitter: 0.0,
            loss: 0.0,
        };
        let mut link = link(model, impairments);
        let arrivals = send(&mut link, 10_000, 10, 1000 - HEADERS);
        let arrived = delays(&arrivals);
        assert_eq!(arrived[0], 0.02);
        assert!((arrived.len() as f64 / 10_000.0 - 0.5).abs() < 0.01);
        let longest = arrived.iter().copied().fold(0.0, f64::max);
        assert!((0.50..=0.52).contains(&longest), "{longest}");
        // First in, first out.
        let times: Vec<f64> = arrivals
            .iter()
            .enumerate()
            .filter_map(|(i, a)| Some(0.01 * i as f64 + a.first?.as_secs_f64()))
            .collect();
        assert!(times.is_sorted());
    }

    #[test]
    fn a_cut_lets_nothing_through_for_its_time() {
        let cut = (Span::from_millis(4000), Span::from_millis(7000));
        let impairments = Impairments {
            cuts: vec![cut],
            ..Impairments::default()
        };
        for (i, arrivals) in send(&mut link(SURE, impairments), 1000, 10, 1)
            .iter()
            .enumerate()
        {
            assert_eq!(
                arrivals.first.is_none(),
                (400..700).contains(&i),
                "packet {i}"
            );
        }
    }
}
