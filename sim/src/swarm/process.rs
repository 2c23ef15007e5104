//! What processes cost, from Linux's /proc: processor time of each thread, and memory.

use std::collections::BTreeMap;
use std::fs;

/// Costs of one process so far.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Cost {
    /// Processor time of each group of threads [ns]. Threads that have ended since are missing.
    pub(super) threads_ns: BTreeMap<String, u64>,
    /// Threads now.
    pub(super) threads: usize,
    /// Resident memory [bytes].
    pub(super) resident: u64,
}

impl Cost {
    /// Of the process `id`; `None` where the system has no /proc, or the process is gone.
    pub(super) fn of(id: u32) -> Option<Self> {
        let mut cost = Self {
            resident: resident(&fs::read_to_string(format!("/proc/{id}/status")).ok()?)?,
            ..Self::default()
        };
        for task in fs::read_dir(format!("/proc/{id}/task")).ok()?.flatten() {
            let read = |file| fs::read_to_string(task.path().join(file));
            // A thread may end while it is looked at.
            if let (Ok(name), Ok(times)) = (read("comm"), read("schedstat"))
                && let Some(Ok(ns)) = times.split_whitespace().next().map(str::parse::<u64>)
            {
                *cost.threads_ns.entry(group(name.trim())).or_default() += ns;
                cost.threads += 1;
            }
        }
        Some(cost)
    }

    /// By how much each group of threads went on since `earlier` [ns].
    pub(super) fn threads_since(&self, earlier: &Self) -> BTreeMap<String, u64> {
        let since = self.threads_ns.iter().map(|(group, now)| {
            let before = earlier.threads_ns.get(group).copied().unwrap_or(0);
            (group.clone(), now.saturating_sub(before))
        });
        since.collect()
    }
}

/// What the whole machine has done: [busy, whole] in ticks of all cores. Time that a hypervisor took away counts as busy.
pub(super) fn machine() -> Option<[u64; 2]> {
    let text = fs::read_to_string("/proc/stat").ok()?;
    let ticks: Vec<u64> = text
        .lines()
        .next()?
        .split_whitespace()
        .skip(1)
        .take(8)
        .map_while(|tick| tick.parse().ok())
        .collect();
    let whole: u64 = ticks.iter().sum();
    // user nice system idle iowait irq softirq steal
    let idle = ticks.get(3)? + ticks.get(4)?;
    Some([whole.saturating_sub(idle), whole])
}

/// The processor's name, as in "Intel(R) Xeon(R) Processor @ 2.00GHz".
pub(super) fn processor() -> Option<String> {
    let text = fs::read_to_string("/proc/cpuinfo").ok()?;
    let line = text.lines().find(|line| line.starts_with("model name"))?;
    Some(line.split_once(':')?.1.trim().to_owned())
}

/// Threads of one purpose have names that begin alike: `control-r7`, `rx-0`.
fn group(name: &str) -> String {
    match name.rsplit_once('-') {
        Some((purpose, number)) if number.chars().any(|digit| digit.is_ascii_digit()) => {
            purpose.to_owned()
        }
        _ => name.to_owned(),
    }
}

fn resident(status: &str) -> Option<u64> {
    let line = status.lines().find(|line| line.starts_with("VmRSS:"))?;
    let kilobytes: u64 = line.split_whitespace().nth(1)?.parse().ok()?;
    Some(1024 * kilobytes)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn threads_of_one_purpose_are_one_group() {
        for (name, purpose) in [
            ("control-r12", "control"),
            ("rx-0", "rx"),
            ("tokio-rt-worker", "tokio-rt-worker"),
            ("planning", "planning"),
        ] {
            assert_eq!(group(name), purpose);
        }
    }

    /// A thread that works for a while shows under its own name, and memory that is used is resident.
    #[cfg(target_os = "linux")]
    #[test]
    fn work_and_memory_of_this_process_are_seen() {
        let before = Cost::of(std::process::id()).expect("/proc");
        let memory = vec![1_u8; 64 << 20];
        let worked = std::thread::Builder::new()
            .name("worker-1".to_owned())
            .spawn(move || {
                let mut sum = 0_u64;
                for round in 0..20_u64 {
                    for byte in &memory {
                        sum = sum.wrapping_mul(31).wrapping_add(u64::from(*byte) + round);
                    }
                }
                let after = Cost::of(std::process::id()).expect("/proc");
                assert_ne!(sum, 0);
                assert_eq!(memory.len(), 64 << 20);
                after
            })
            .expect("a thread");
        let after = worked.join().expect("it worked");
        let since = after.threads_since(&before);
        assert!(since["worker"] > 1_000_000, "{since:?}");
        assert!(after.resident >= before.resident + (60 << 20));
    }
}
