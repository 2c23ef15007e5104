//! Errors of an estimator against the truth.

#![allow(dead_code, reason = "each test binary uses its own part")]

use nalgebra::Vector6;
use sphere_agent::estimator::{Estimator, EstimatorConfig};
use sphere_protocol::robot::Robot;

use crate::motion::{DEGREE, Event, Truth};

/// The begin of a run, which does not count [s].
const SETTLED: f64 = 5.0;
/// Path after which drift is a share of it [m].
const PATH: f64 = 10.0;

pub(crate) fn estimator(config: EstimatorConfig) -> Estimator {
    let robot = Robot::embedded("liu").expect("liu is embedded");
    Estimator::new(&robot.params, config)
}

/// Feeds events; the truth of the last frame comes back.
pub(crate) fn feed(estimator: &mut Estimator, events: &[Event]) -> Truth {
    let mut last = None;
    for event in events {
        match event {
            Event::Frame(measurement, truth) => {
                estimator.on_measurement(measurement);
                last = Some(*truth);
            }
            Event::Fix(fix) => {
                estimator.on_fix(fix);
            }
        }
    }
    last.expect("there were frames")
}

pub(crate) fn position_error(estimator: &Estimator, truth: &Truth) -> f64 {
    let (e, t) = (estimator.state(), truth.state);
    (e.x - t.x).hypot(e.y - t.y)
}

/// Root mean squares of the errors [SI], mean NEES of (q_r, α, φ, v, X, Y), largest position error and drift.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Errors {
    frames: f64,
    pub(crate) q_r: f64,
    pub(crate) alpha: f64,
    pub(crate) beta: f64,
    pub(crate) q_r_rate: f64,
    pub(crate) alpha_rate: f64,
    pub(crate) beta_rate: f64,
    pub(crate) v: f64,
    pub(crate) heading: f64,
    pub(crate) position: f64,
    pub(crate) nees: f64,
    pub(crate) position_max: f64,
    /// Largest position error over the path behind it [1].
    pub(crate) drift_max: f64,
}

impl Errors {
    pub(crate) fn add(&mut self, estimator: &Estimator, truth: &Truth) {
        if truth.t < SETTLED {
            return;
        }
        let (e, t) = (estimator.state(), truth.state);
        let position = (e.x - t.x).hypot(e.y - t.y);
        let errors = [
            e.q_r - t.q_r,
            e.alpha - t.alpha,
            e.beta - t.beta,
            e.q_r_rate - t.q_r_rate,
            e.alpha_rate - t.alpha_rate,
            e.beta_rate - t.beta_rate,
            e.v - t.v,
            e.heading - t.heading,
            position,
        ];
        for (sum, error) in self.roots().into_iter().zip(errors) {
            *sum += error * error;
        }
        self.frames += 1.0;
        self.position_max = self.position_max.max(position);
        if truth.path > PATH {
            self.drift_max = self.drift_max.max(position / truth.path);
        }
        let error = Vector6::new(
            e.q_r - t.q_r,
            e.alpha - t.alpha,
            e.heading - t.heading,
            e.v - t.v,
            e.x - t.x,
            e.y - t.y,
        );
        let covariance = estimator
            .covariance()
            .cholesky()
            .expect("positive definite");
        self.nees += error.dot(&covariance.solve(&error));
    }

    /// Sums to root means.
    pub(crate) fn finish(mut self) -> Self {
        let frames = self.frames;
        assert!(frames > 0.0, "nothing was compared");
        for sum in self.roots() {
            *sum = (*sum / frames).sqrt();
        }
        self.nees /= frames;
        self
    }

    pub(crate) fn take_worse(&mut self, other: &Self) {
        let mut other = *other;
        for (worst, value) in self.roots().into_iter().zip(other.roots()) {
            *worst = worst.max(*value);
        }
        self.nees = self.nees.max(other.nees);
        self.position_max = self.position_max.max(other.position_max);
        self.drift_max = self.drift_max.max(other.drift_max);
    }

    pub(crate) fn print(&self, what: &str) {
        println!(
            "{what}: q_r {:.4} α {:.4} β {:.4} heading {:.3} °, rates q_r {:.3} α {:.3} β {:.3} °/s, v {:.2} mm/s, \
             position {:.2} mm (largest {:.2}), drift ≤ {:.3} % of the path, NEES {:.2} of 6",
            self.q_r / DEGREE,
            self.alpha / DEGREE,
            self.beta / DEGREE,
            self.heading / DEGREE,
            self.q_r_rate / DEGREE,
            self.alpha_rate / DEGREE,
            self.beta_rate / DEGREE,
            self.v * 1e3,
            self.position * 1e3,
            self.position_max * 1e3,
            self.drift_max * 100.0,
            self.nees
        );
    }

    fn roots(&mut self) -> [&mut f64; 9] {
        [
            &mut self.q_r,
            &mut self.alpha,
            &mut self.beta,
            &mut self.q_r_rate,
            &mut self.alpha_rate,
            &mut self.beta_rate,
            &mut self.v,
            &mut self.heading,
            &mut self.position,
        ]
    }
}
