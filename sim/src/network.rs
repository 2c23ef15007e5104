//! The simulated network: what becomes of each packet between a robot and the station.
//!
//! One [`Link`] is one direction of one robot's link, with a random stream of its own: what happens on one link changes nothing
//! on another.

use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal, StandardUniform};
use sphere_protocol::time::Span;

/// Faults of one direction of a link. A new fault is one field here.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LinkModel {
    /// Mean delay [s].
    pub delay: f64,
    /// Standard deviation of the delay, truncated at zero delay; packets may overtake each other [s].
    pub jitter: f64,
    /// Probability that a packet is lost, each on its own.
    pub loss: f64,
}

/// One direction of one robot's link.
#[derive(Clone, Debug)]
pub struct Link {
    model: LinkModel,
    random: ChaCha8Rng,
    /// Packets handed to the link.
    pub sent: u64,
    /// Packets that never arrive.
    pub lost: u64,
    /// Bytes handed to the link, payload only.
    pub bytes: u64,
}

impl Link {
    /// A link with its own random stream.
    pub fn new(model: LinkModel, random: ChaCha8Rng) -> Self {
        Self {
            model,
            random,
            sent: 0,
            lost: 0,
            bytes: 0,
        }
    }

    /// Hands over a packet of `bytes` bytes: its delay, or `None` if it is lost.
    ///
    /// Each packet draws its delay and its fate, used or not, so that changing one fault leaves the others' draws alone.
    pub fn transmit(&mut self, bytes: usize) -> Option<Span> {
        let normal: f64 = StandardNormal.sample(&mut self.random);
        let fate: f64 = StandardUniform.sample(&mut self.random);
        self.sent += 1;
        self.bytes += bytes as u64;
        if fate < self.model.loss {
            self.lost += 1;
            return None;
        }
        Some(Span::from_secs_f64(
            (self.model.delay + self.model.jitter * normal).max(0.0),
        ))
    }
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;

    use super::*;

    #[test]
    fn a_link_delays_and_loses_as_its_model_says() {
        let model = LinkModel {
            delay: 0.1,
            jitter: 0.02,
            loss: 0.1,
        };
        let mut link = Link::new(model, ChaCha8Rng::seed_from_u64(1));
        let delays: Vec<f64> = (0..20_000)
            .filter_map(|_| link.transmit(100))
            .map(Span::as_secs_f64)
            .collect();
        let n = delays.len() as f64;
        let mean = delays.iter().sum::<f64>() / n;
        let deviation = (delays.iter().map(|d| (d - mean).powi(2)).sum::<f64>() / n).sqrt();
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
            let model = LinkModel {
                delay: 0.1,
                jitter: 0.02,
                loss,
            };
            let mut link = Link::new(model, ChaCha8Rng::seed_from_u64(7));
            (0..1000).map(|_| link.transmit(1)).collect::<Vec<_>>()
        };
        for (sure, lossy) in run(0.0).iter().zip(run(0.3)) {
            assert!(lossy.is_none() || lossy == *sure);
        }
    }
}
