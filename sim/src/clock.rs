//! The clocks of simulated machines: none shows the world's time, and some run fast or slow.

use sphere_protocol::time::Span;

/// A clock with an offset and a constant drift.
#[derive(Clone, Copy, Debug, PartialEq, Default)]
pub struct SimClock {
    offset: Span,
    /// By how much it runs fast [1].
    drift: f64,
}

impl SimClock {
    /// A clock that shows `offset` when the world begins and runs fast by `drift_ppm` [1e-6].
    pub fn new(offset: Span, drift_ppm: f64) -> Self {
        Self {
            offset,
            drift: drift_ppm * 1e-6,
        }
    }

    /// What it shows at the world's time `at`.
    pub fn shows(&self, at: Span) -> Span {
        at + self.offset + Span::from_nanos((at.as_nanos() as f64 * self.drift).floor() as i64)
    }

    /// The first instant of the world at which it shows `shown` or later.
    pub fn when(&self, shown: Span) -> Span {
        let since = shown - self.offset;
        if self.drift == 0.0 {
            return since;
        }
        let mut at = Span::from_nanos((since.as_nanos() as f64 / (1.0 + self.drift)) as i64);
        let step = Span::from_nanos(1);
        while self.shows(at) < shown {
            at = at + step;
        }
        while self.shows(at - step) >= shown {
            at = at - step;
        }
        at
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_offset_alone_is_exact() {
        let clock = SimClock::new(Span::from_millis(7000), 0.0);
        let at = Span::from_nanos(123_456_789);
        assert_eq!(clock.shows(at), Span::from_nanos(7_123_456_789));
        assert_eq!(clock.when(clock.shows(at)), at);
    }

    #[test]
    fn a_drifting_clock_gains_what_it_says_and_can_be_read_backwards() {
        for ppm in [200.0, -200.0, 50.0, 1e4] {
            let clock = SimClock::new(Span::from_millis(-1000), ppm);
            let at = Span::from_millis(100_000);
            let gained = (clock.shows(at) - at).as_secs_f64() + 1.0;
            assert!(
                (gained - 100.0 * ppm * 1e-6).abs() < 2e-9,
                "{ppm}: {gained}"
            );
            for nanos in [0, 1, 19_999_999, 20_000_000, 77_123_456_789] {
                let shown = Span::from_nanos(nanos);
                let at = clock.when(shown);
                assert!(clock.shows(at) >= shown, "{ppm} at {nanos}");
                assert!(
                    clock.shows(at - Span::from_nanos(1)) < shown,
                    "{ppm} at {nanos}"
                );
            }
        }
    }
}
