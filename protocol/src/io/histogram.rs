//! Durations counted in buckets of equal width: what a thread in real time can afford to keep of many.

use std::time::Duration;

use serde::{Deserialize, Serialize};

/// A histogram of fixed size. What is longer than its last bucket counts there, its true length is kept as the largest alone.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Histogram {
    width: Duration,
    counts: Box<[u32]>,
    total: u64,
    max: Duration,
}

/// A histogram as it passes from process to process: the buckets that hold something.
#[derive(Clone, Debug, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct Sparse {
    /// Width of a bucket [ns].
    pub width_ns: u64,
    /// How many buckets there are.
    pub buckets: u32,
    /// (bucket, count), ascending.
    pub counts: Vec<(u32, u32)>,
    /// The largest [ns].
    pub max_ns: u64,
}

impl Histogram {
    /// `buckets` buckets, each `width` wide; at least one, and not of width zero.
    pub fn new(width: Duration, buckets: usize) -> Self {
        Self {
            width: width.max(Duration::from_nanos(1)),
            counts: vec![0; buckets.max(1)].into_boxed_slice(),
            total: 0,
            max: Duration::ZERO,
        }
    }

    /// Counts one.
    pub fn count(&mut self, length: Duration) {
        let bucket = length.as_nanos() / self.width.as_nanos();
        let last = self.counts.len() - 1;
        let bucket = usize::try_from(bucket).map_or(last, |bucket| bucket.min(last));
        self.counts[bucket] = self.counts[bucket].saturating_add(1);
        self.total += 1;
        self.max = self.max.max(length);
    }

    /// Takes over what `other`, of the same buckets, has counted; buckets that it has beyond ours count in our last.
    pub fn add(&mut self, other: &Self) {
        let last = self.counts.len() - 1;
        for (bucket, count) in other.counts.iter().enumerate() {
            let sum = &mut self.counts[bucket.min(last)];
            *sum = sum.saturating_add(*count);
        }
        self.total += other.total;
        self.max = self.max.max(other.max);
    }

    /// Takes over all that `other` holds; of the same buckets, without asking for memory.
    pub fn copy_from(&mut self, other: &Self) {
        if self.counts.len() == other.counts.len() {
            self.counts.copy_from_slice(&other.counts);
        } else {
            self.counts = other.counts.clone();
        }
        (self.width, self.total, self.max) = (other.width, other.total, other.max);
    }

    /// What was counted since `earlier`, an earlier state of the same histogram. Its largest is known to a bucket, unless it is in the last.
    pub fn since(&self, earlier: &Self) -> Self {
        let mut counts = self.counts.clone();
        for (count, before) in counts.iter_mut().zip(&earlier.counts) {
            *count = count.saturating_sub(*before);
        }
        let top = counts.iter().rposition(|count| *count > 0);
        let max = match top {
            None => Duration::ZERO,
            Some(top) if top + 1 == counts.len() => self.max,
            Some(top) => self.max.min(self.edge(top)),
        };
        Self {
            width: self.width,
            total: counts.iter().map(|count| u64::from(*count)).sum(),
            counts,
            max,
        }
    }

    /// The length that a share `p` did not exceed, to a bucket; `None` if nothing was counted.
    pub fn quantile(&self, p: f64) -> Option<Duration> {
        let rank = ((p * self.total as f64).ceil() as u64).max(1);
        let mut seen = 0;
        let bucket = self.counts.iter().position(|count| {
            seen += u64::from(*count);
            seen >= rank
        })?;
        Some(if bucket + 1 == self.counts.len() {
            self.max
        } else {
            self.edge(bucket).min(self.max)
        })
    }

    /// The quantile `p` of the sum of one length of `self` and one of `other`, drawn independently; `None` if one of them is empty.
    pub fn quantile_of_sum(&self, other: &Self, p: f64) -> Option<Duration> {
        let mut sum = Self::new(self.width, self.counts.len() + other.counts.len());
        let share = |count: u32, total: u64| f64::from(count) / total.max(1) as f64;
        // Shares as counts out of a billion: they fit, and what is rounded away is far from any quantile asked for.
        let mut shares = vec![0.0; sum.counts.len()];
        for (i, mine) in self.counts.iter().enumerate().filter(|(_, n)| **n > 0) {
            for (j, theirs) in other.counts.iter().enumerate().filter(|(_, n)| **n > 0) {
                shares[i + j] += share(*mine, self.total) * share(*theirs, other.total);
            }
        }
        for (count, share) in sum.counts.iter_mut().zip(shares) {
            *count = (share * 1e9).round() as u32;
            sum.total += u64::from(*count);
        }
        sum.max = self.max + other.max;
        // Each of the two is somewhere within its bucket: their middles add up.
        sum.quantile(p)
    }

    /// The mean, to half a bucket; `None` if nothing was counted.
    pub fn mean(&self) -> Option<Duration> {
        let half = self.width.as_secs_f64() / 2.0;
        let sum: f64 = (self.counts.iter().enumerate())
            .map(|(bucket, count)| {
                f64::from(*count) * (bucket as f64 * self.width.as_secs_f64() + half)
            })
            .sum();
        (self.total > 0).then(|| Duration::from_secs_f64(sum / self.total as f64))
    }

    /// The largest.
    pub fn max(&self) -> Duration {
        self.max
    }

    /// How many were counted.
    pub fn total(&self) -> u64 {
        self.total
    }

    /// As it travels.
    pub fn sparse(&self) -> Sparse {
        let filled = self.counts.iter().enumerate().filter(|(_, n)| **n > 0);
        Sparse {
            width_ns: u64::try_from(self.width.as_nanos()).unwrap_or(u64::MAX),
            buckets: u32::try_from(self.counts.len()).unwrap_or(u32::MAX),
            counts: filled.map(|(i, n)| (i as u32, *n)).collect(),
            max_ns: u64::try_from(self.max.as_nanos()).unwrap_or(u64::MAX),
        }
    }

    /// Upper edge of a bucket.
    fn edge(&self, bucket: usize) -> Duration {
        self.width * (bucket as u32 + 1)
    }
}

impl From<&Sparse> for Histogram {
    fn from(sparse: &Sparse) -> Self {
        let buckets = (sparse.buckets as usize).min(BUCKETS_MAX);
        let mut whole = Self::new(Duration::from_nanos(sparse.width_ns), buckets);
        for (bucket, count) in &sparse.counts {
            if let Some(into) = whole.counts.get_mut(*bucket as usize) {
                *into = into.saturating_add(*count);
                whole.total += u64::from(*count);
            }
        }
        whole.max = Duration::from_nanos(sparse.max_ns);
        whole
    }
}

/// What travels may not make its reader allocate more [buckets].
const BUCKETS_MAX: usize = 1 << 20;

#[cfg(test)]
mod tests {
    use super::*;

    fn ms(ms: u64) -> Duration {
        Duration::from_millis(ms)
    }

    fn filled(lengths: impl IntoIterator<Item = u64>) -> Histogram {
        let mut histogram = Histogram::new(ms(1), 300);
        lengths
            .into_iter()
            .for_each(|length| histogram.count(ms(length)));
        histogram
    }

    #[test]
    fn quantiles_are_right_to_a_bucket() {
        let histogram = filled(0..100);
        assert_eq!(histogram.total(), 100);
        assert_eq!(histogram.quantile(0.5), Some(ms(50)));
        assert_eq!(histogram.quantile(0.99), Some(ms(99)));
        assert_eq!(
            histogram.quantile(1.0),
            Some(ms(99)),
            "not beyond the largest"
        );
        assert_eq!(histogram.mean(), Some(ms(50)));
        assert_eq!(Histogram::new(ms(1), 4).quantile(0.5), None);
        // Beyond the last bucket the largest is what is known.
        assert_eq!(filled([1000, 2000]).quantile(0.5), Some(ms(2000)));
    }

    #[test]
    fn what_came_since_is_told_apart_from_what_was_there() {
        let before = filled([250, 3]);
        let mut after = before.clone();
        for length in [5, 7, 9] {
            after.count(ms(length));
        }
        let since = after.since(&before);
        assert_eq!(since.total(), 3);
        assert_eq!(since.quantile(0.5), Some(ms(8)));
        assert_eq!(since.max(), ms(10), "the 250 ms were before");
        let mut both = before.clone();
        both.add(&since);
        assert_eq!(both.total(), after.total());
        assert_eq!(both.quantile(0.5), after.quantile(0.5));
        assert_eq!(Histogram::from(&after.sparse()), after);
    }

    /// Two uniform lengths of 0 to 99 ms: the sum's upper per cent begins where (200 − x)² / 2 · 10⁻⁴ = 0.01, at 185.9 ms.
    #[test]
    fn the_quantile_of_a_sum_is_that_of_independent_parts() {
        let uniform = filled(0..100);
        let sum = uniform.quantile_of_sum(&uniform, 0.99).expect("counts");
        assert!((ms(184)..=ms(187)).contains(&sum), "{sum:?}");
        assert_eq!(uniform.quantile_of_sum(&filled([]), 0.99), None);
    }
}
