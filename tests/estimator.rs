//! The onboard estimator keeps the promises of MODEL §9: attitude free of the kinematic acceleration, dead reckoning by eq (1)
//! within 2 % of the path, late fixes fused where they belong, honest covariance, bad input counted.

#[path = "estimator/motion.rs"]
mod motion;

use motion::{DEGREE, Event, Motion, Sensing, events};
use sphere_agent::estimator::{Estimator, EstimatorConfig};
use sphere_protocol::robot::Robot;

fn estimator(config: EstimatorConfig) -> Estimator {
    let robot = Robot::embedded("liu").expect("liu is embedded");
    Estimator::new(&robot.params, config)
}

/// Root mean squares of the estimate's errors after `SETTLED`.
#[derive(Clone, Copy, Debug, Default)]
struct Errors {
    n: f64,
    q_r: f64,
    alpha: f64,
    q_r_rate: f64,
    alpha_rate: f64,
    beta: f64,
    beta_rate: f64,
    v: f64,
    heading: f64,
    position: f64,
    nees: f64,
    position_max: f64,
    drift: f64,
}

const SETTLED: f64 = 5.0;

impl Errors {
    fn add(&mut self, estimator: &Estimator, truth: &motion::Truth) {
        let (e, t) = (estimator.state(), truth.state);
        let position = (e.x - t.x).hypot(e.y - t.y);
        self.drift = position / truth.path.max(1.0);
        if truth.t < SETTLED {
            return;
        }
        self.n += 1.0;
        self.q_r += (e.q_r - t.q_r).powi(2);
        self.alpha += (e.alpha - t.alpha).powi(2);
        self.q_r_rate += (e.q_r_rate - t.q_r_rate).powi(2);
        self.alpha_rate += (e.alpha_rate - t.alpha_rate).powi(2);
        self.beta += (e.beta - t.beta).powi(2);
        self.beta_rate += (e.beta_rate - t.beta_rate).powi(2);
        self.v += (e.v - t.v).powi(2);
        self.heading += (e.heading - t.heading).powi(2);
        self.position += position.powi(2);
        self.position_max = self.position_max.max(position);
        let error = nalgebra::Vector6::new(
            e.q_r - t.q_r,
            e.alpha - t.alpha,
            e.heading - t.heading,
            e.v - t.v,
            e.x - t.x,
            e.y - t.y,
        );
        let p = estimator
            .covariance()
            .cholesky()
            .expect("positive definite");
        self.nees += error.dot(&p.solve(&error));
    }

    fn rms(mut self) -> Self {
        let n = self.n;
        for sum in [
            &mut self.q_r,
            &mut self.alpha,
            &mut self.q_r_rate,
            &mut self.alpha_rate,
            &mut self.beta,
            &mut self.beta_rate,
            &mut self.v,
            &mut self.heading,
            &mut self.position,
        ] {
            *sum = (*sum / n).sqrt();
        }
        self.nees /= n;
        self
    }

    fn print(&self, what: &str) {
        println!(
            "{what}: q_r {:.4}° α {:.4}° β {:.4}° | rates q_r {:.3} α {:.3} β {:.3} °/s | v {:.2} mm/s, heading {:.3}°, position {:.2} mm (max {:.2}), \
             end {:.3} % of path, NEES {:.2}",
            self.q_r / DEGREE,
            self.alpha / DEGREE,
            self.beta / DEGREE,
            self.q_r_rate / DEGREE,
            self.alpha_rate / DEGREE,
            self.beta_rate / DEGREE,
            self.v * 1e3,
            self.heading / DEGREE,
            self.position * 1e3,
            self.position_max * 1e3,
            self.drift * 100.0,
            self.nees
        );
    }
}

fn follow(motion: Motion, sensing: &Sensing, duration: f64) -> (Estimator, Errors) {
    let mut estimator = estimator(EstimatorConfig::default());
    let mut errors = Errors::default();
    for event in events(motion, sensing, duration) {
        match event {
            Event::Frame(measurement, truth) => {
                estimator.on_measurement(&measurement);
                errors.add(&estimator, &truth);
            }
            Event::Fix(fix) => {
                estimator.on_fix(&fix);
            }
        }
    }
    (estimator, errors.rms())
}

#[test]
fn look() {
    for (name, motion) in [
        ("lemniscate", motion::lemniscate as Motion),
        ("steps", motion::speed_steps),
    ] {
        for (noise, fixes, seeds) in [(0.0, false, 1), (1.0, true, 5), (1.0, false, 5)] {
            for seed in 0..seeds {
                let sensing = Sensing {
                    noise,
                    fixes,
                    fix_delay: 0.05,
                    seed,
                };
                let (est, errors) = follow(motion, &sensing, 100.0);
                errors.print(&format!("{name} noise {noise} fixes {fixes} seed {seed}"));
                if seed == 0 {
                    println!(
                        "{:?} {:?} {:?}",
                        est.counters(),
                        est.sigma(),
                        est.gyro_bias()
                    );
                }
            }
        }
    }
}
