//! The onboard estimator keeps the promises of MODEL §9: attitude free of the kinematic acceleration, dead reckoning by eq (1)
//! within 2 % of the path, late fixes fused where they belong, honest covariance, bad input counted.

#[path = "estimator/closed_loop.rs"]
mod closed_loop;
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
    dq: f64,
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

#[test]
fn look_plant() {
    let kicks = std::env::var("KICK").is_ok();
    let robot = Robot::embedded("liu").expect("liu is embedded");
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
                let mut config = EstimatorConfig::default();
                if let Ok(a) = std::env::var("ALPHA") {
                    config.alpha_accel = a.parse().unwrap();
                }
                if let Ok(a) = std::env::var("JERK") {
                    config.theta_r_jerk = a.parse().unwrap();
                }
                if let Ok(a) = std::env::var("PIV") {
                    config.pivot_rate = a.parse().unwrap();
                }
                if let Ok(a) = std::env::var("ACC") {
                    config.accel_noise = a.parse().unwrap();
                }
                let mut est = estimator(config);
                let mut errors = Errors::default();
                let disturbance = sphere_sim::disturbance::Disturbance {
                    imbalance: 0.2,
                    pushes: if kicks {
                        (1..20)
                            .flat_map(|k| {
                                [
                                    sphere_sim::disturbance::Push {
                                        roll_nm: 8.0,
                                        pitch_nm: 0.0,
                                        at_s: 5.0 * k as f64,
                                        for_s: 0.2,
                                    },
                                    sphere_sim::disturbance::Push {
                                        roll_nm: 0.0,
                                        pitch_nm: 15.0,
                                        at_s: 5.0 * k as f64 + 2.0,
                                        for_s: 0.2,
                                    },
                                ]
                            })
                            .collect()
                    } else {
                        vec![]
                    },
                    ..Default::default()
                };
                let mut qmax: f64 = 0.0;
                let mut tracking = 0.0;
                closed_loop::drive(
                    &mut est,
                    &robot.params,
                    &disturbance,
                    motion,
                    &sensing,
                    100.0,
                    |e, t| {
                        errors.add(e, t);
                        qmax = qmax.max(t.state.q_r.abs());
                        tracking += (t.state.q_r - motion(t.t).q_r.f).powi(2);
                    },
                );
                errors.rms().print(&format!(
                    "plant {name} noise {noise} fixes {fixes} seed {seed}, q_max {:.1} track {:.2}",
                    qmax / DEGREE,
                    (tracking / 20000.0).sqrt() / DEGREE
                ));
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

#[test]
fn speed() {
    let sensing = Sensing {
        noise: 1.0,
        fixes: true,
        fix_delay: 0.05,
        seed: 3,
    };
    let ev = events(motion::lemniscate, &sensing, 60.0);
    for pass in 0..5 {
        let mut est = estimator(EstimatorConfig::default());
        let (mut frame, mut fixes) = (0.0, 0.0);
        let mut nf = 0;
        let t0 = std::time::Instant::now();
        for e in &ev {
            if let Event::Frame(m, _) = e {
                est.on_measurement(m);
            }
        }
        frame += t0.elapsed().as_secs_f64();
        let mut est = estimator(EstimatorConfig::default());
        let t0 = std::time::Instant::now();
        for e in &ev {
            match e {
                Event::Frame(m, _) => est.on_measurement(m),
                Event::Fix(f) => {
                    nf += 1;
                    est.on_fix(f);
                }
            }
        }
        fixes += t0.elapsed().as_secs_f64();
        println!(
            "pass {pass}: {:.3} us a frame, {:.2} us a fix",
            frame / 12001.0 * 1e6,
            (fixes - frame) / nf as f64 * 1e6
        );
    }
}
