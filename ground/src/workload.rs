//! Who computes the plans of a tick, and what is left out when there is no time for all of it.
//!
//! A station makes the plans of all robots that are due at once, as a batch of [`Job`]s, on the [`Workers`] that its shell gives it. While
//! plans come too late the [`Governor`] saves time: first a plan gets one iteration in place of a converged solution, then none: the
//! robot's last plan goes again, within its own validity. Robots in danger come first (see [`Need`]). Both are counted for
//! each robot.
//!
//! No clock here: how late the batch is, the station knows from the time it is told; how long it took, the workers say.

use core::fmt;

use sphere_protocol::time::Span;

use crate::planner::PlanBatch;
use crate::session::Job;

/// Computes plans. How many at once and on what threads makes no difference to any plan.
pub trait Workers: Send {
    /// Does every job by [`Job::run_all`], in whatever groups. Returns how long that took: the station plans on less while
    /// this makes it late. In virtual time that is zero, or what a model says.
    fn run(&mut self, jobs: &mut [Job<'_>]) -> Span;
}

/// Plans on the caller's thread, and says that it took no time.
#[derive(Default)]
pub struct Inline(PlanBatch);

impl Workers for Inline {
    fn run(&mut self, jobs: &mut [Job<'_>]) -> Span {
        Job::run_all(jobs, &mut self.0);
        Span::ZERO
    }
}

/// How much is computed for a plan.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Effort {
    /// Nothing: the last plan goes again, within its own validity. A robot that has none left gets [`Effort::RealTime`].
    Shift,
    /// One iteration from the last solution: the real-time iteration.
    RealTime,
    /// Iterations until the plan is optimal.
    Converge,
}

/// How much one robot needs a plan.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Need {
    /// How long it can do without a new one [s]: what is left of the newest plan that it is known to have, less a second for every 10 cm
    /// that it is off its path. Negative in danger.
    pub slack: f64,
    /// Whether the last plan sent can go again.
    pub has_plan_left: bool,
}

/// Shares out the time that there is.
#[derive(Clone, Debug, Default)]
pub struct Governor {
    /// Time for a converged plan [s], by the batches so far; 0 before the first.
    cost: f64,
    /// Plans of which `cost` is a mean; at most [`LEARNT_FROM`].
    learnt: f64,
    load: Load,
}

/// How the station keeps up.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Load {
    /// How late the last batch began.
    pub late: Span,
    /// Time for a converged plan [s]: a mean over the last batches that took one; 0 where nobody measures.
    pub plan_s: f64,
    /// Robots of the last batch.
    pub jobs: usize,
    /// Of these: planned by one iteration.
    pub real_time: usize,
    /// Of these: not planned for, their last plan went again.
    pub shed: usize,
}

impl Load {
    /// Whether anything was left out of the last batch.
    pub fn has_cuts(&self) -> bool {
        self.real_time + self.shed > 0
    }
}

impl fmt::Display for Load {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "{:.0} ms late, {:.0} µs a plan: of {} robots {} planned by one iteration, {} not at all",
            self.late.as_secs_f64() * 1e3,
            self.plan_s * 1e6,
            self.jobs,
            self.real_time,
            self.shed
        )
    }
}

impl Governor {
    /// The effort for each robot of a batch that begins `late` after it was due.
    ///
    /// A batch may take what is left of [`LATENESS_MAX`], and [`BATCH_LEAST`] in any case: at a constant overload the station settles at half of it and plans for as many
    /// as it can. The robots with the least slack are served first, ties by their order.
    pub fn share_out(&mut self, late: Span, needs: &[Need]) -> Vec<Effort> {
        self.load = Load {
            late,
            plan_s: self.cost,
            jobs: needs.len(),
            real_time: 0,
            shed: 0,
        };
        let count = needs.len() as f64;
        let left = (LATENESS_MAX - late).max(BATCH_LEAST).as_secs_f64();
        let mut efforts = vec![Effort::Converge; needs.len()];
        if self.cost * count <= left {
            return efforts;
        }
        // In units of a converged plan: c + REAL_TIME r + SHIFT (n − c − r) ≤ units; none is shifted as long as one is converged.
        let units = left / self.cost;
        let converged = ((units - REAL_TIME * count) / (1.0 - REAL_TIME)).max(0.0);
        let planned = if converged > 0.0 {
            count
        } else {
            ((units - SHIFT * count) / (REAL_TIME - SHIFT)).clamp(0.0, count)
        };
        // However late it is, the robot in most danger gets a plan.
        let (converged, planned) = (converged as usize, (planned as usize).max(1));
        let mut order: Vec<usize> = (0..needs.len()).collect();
        order.sort_by(|a, b| needs[*a].slack.total_cmp(&needs[*b].slack));
        for (place, &robot) in order.iter().enumerate() {
            efforts[robot] = if place < converged {
                Effort::Converge
            } else if place < planned || !needs[robot].has_plan_left {
                self.load.real_time += 1;
                Effort::RealTime
            } else {
                self.load.shed += 1;
                Effort::Shift
            };
        }
        efforts
    }

    /// Learns from a batch that took `took`.
    pub fn learn(&mut self, took: Span) {
        let Load {
            jobs,
            real_time,
            shed,
            ..
        } = self.load;
        let converged = (jobs - real_time - shed) as f64;
        let units = converged + REAL_TIME * real_time as f64 + SHIFT * shed as f64;
        let took = took.as_secs_f64();
        if !(units > 0.0 && took >= 0.0) {
            return;
        }
        let is_first = self.learnt == 0.0;
        self.learnt = (self.learnt + jobs as f64).min(LEARNT_FROM);
        let weight = if is_first {
            1.0
        } else {
            (jobs as f64 / self.learnt).min(LEARN_MAX)
        };
        self.cost += (took / units - self.cost) * weight;
    }

    /// The last batch.
    pub fn load(&self) -> &Load {
        &self.load
    }
}

/// How late a plan may leave because others were made before it. A tenth of the shortest horizon's worth of feedback, and less than the
/// network's jitter.
pub const LATENESS_MAX: Span = Span::from_millis(20);
/// A thread that was woken late is not over its time: what takes no longer than this is never cut short.
const BATCH_LEAST: Span = Span::from_millis(1);
/// Cost of a plan by one iteration, as a share of a converged one's: references, prediction and one iteration of three.
const REAL_TIME: f64 = 0.5;
/// Cost of sending the last plan again.
const SHIFT: f64 = 0.1;
/// Plans over which the cost is a mean, about.
const LEARNT_FROM: f64 = 200.0;
/// One batch, however large, does not decide alone: the machine may have paused.
const LEARN_MAX: f64 = 0.3;

#[cfg(test)]
mod tests {
    use super::*;

    fn robots(slack: impl IntoIterator<Item = f64>) -> Vec<Need> {
        let need = |slack| Need {
            slack,
            has_plan_left: true,
        };
        slack.into_iter().map(need).collect()
    }

    /// One that has learnt that a plan takes 1 ms.
    fn governor() -> Governor {
        let mut governor = Governor::default();
        governor.share_out(Span::ZERO, &robots([1.0; 10]));
        governor.learn(Span::from_millis(10));
        governor
    }

    fn count(efforts: &[Effort], effort: Effort) -> usize {
        efforts.iter().filter(|other| **other == effort).count()
    }

    #[test]
    fn with_time_for_all_every_plan_is_converged() {
        let mut governor = governor();
        let efforts = governor.share_out(Span::ZERO, &robots([1.0; 20]));
        assert_eq!(count(&efforts, Effort::Converge), 20);
        assert!(!governor.load().has_cuts());
    }

    #[test]
    fn those_in_danger_are_served_first_and_the_time_is_kept() {
        let mut governor = governor();
        // 30 robots and 20 ms: 10 converge (10 ms), 20 get one iteration (10 ms).
        let slack = (0..30).map(|i| f64::from((i * 7) % 30));
        let needs = robots(slack);
        let efforts = governor.share_out(Span::ZERO, &needs);
        assert_eq!(count(&efforts, Effort::Converge), 10);
        assert_eq!(governor.load().real_time, 20);
        for (need, effort) in needs.iter().zip(&efforts) {
            assert_eq!(*effort == Effort::Converge, need.slack < 10.0, "{need:?}");
        }
        // 10 ms late, half of the time is gone: 10 = 0.5 r + 0.1 (30 − r).
        let efforts = governor.share_out(Span::from_millis(10), &needs);
        assert_eq!(count(&efforts, Effort::RealTime), 17);
        assert_eq!(governor.load().shed, 13);
    }

    /// Late by the system's doing, with a hundred robots of 5 µs.
    #[test]
    fn a_batch_that_takes_no_time_is_not_cut_short_however_late_it_is() {
        let mut governor = Governor::default();
        let needs = robots([1.0; 100]);
        governor.share_out(Span::ZERO, &needs);
        governor.learn(Span::from_secs_f64(500e-6));
        let efforts = governor.share_out(Span::from_millis(300), &needs);
        assert_eq!(count(&efforts, Effort::Converge), 100);
    }

    #[test]
    fn who_has_nothing_left_is_planned_for_however_late_it_is() {
        let mut governor = governor();
        let mut needs = robots([1.0, 0.5, 2.0, 3.0]);
        needs[3].has_plan_left = false;
        let efforts = governor.share_out(Span::from_millis(80), &needs);
        let (shift, one) = (Effort::Shift, Effort::RealTime);
        assert_eq!(efforts, [shift, one, shift, one]);
    }

    #[test]
    fn the_cost_is_learnt_from_what_was_done() {
        let mut governor = governor();
        for _ in 0..40 {
            let efforts = governor.share_out(Span::ZERO, &robots([1.0; 60]));
            let units = count(&efforts, Effort::Converge) as f64
                + REAL_TIME * count(&efforts, Effort::RealTime) as f64
                + SHIFT * count(&efforts, Effort::Shift) as f64;
            governor.learn(Span::from_secs_f64(units * 0.4e-3));
        }
        assert!((governor.load().plan_s - 0.4e-3).abs() < 1e-6);
        // Clocks that stand still or go back teach nothing that breaks it.
        governor.learn(Span::from_millis(-5));
        governor.share_out(Span::ZERO, &[]);
        governor.learn(Span::ZERO);
        assert!(governor.share_out(Span::ZERO, &robots([f64::NAN; 3])).len() == 3);
    }
}
