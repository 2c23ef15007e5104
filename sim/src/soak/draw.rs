//! A scenario from a seed: everything that the format can say, in ranges in which a sound fleet keeps the invariants.
//!
//! The ranges, each with its reason where it is narrower than the format's, are in docs/soak.md.

use std::fmt::Write as _;

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::scenario::Scenario;

/// The scenario of `seed`. The seed is the run's own too.
pub fn draw(seed: u64) -> Scenario {
    let text = Draw::new(seed).scenario(seed);
    let no_files = |path: &str| Err(format!("no file {path}"));
    match Scenario::parse("drawn", &text, &[], no_files) {
        Ok(scenario) => scenario,
        Err(error) => unreachable!("what is drawn is within the format's ranges: {error}\n{text}"),
    }
}

struct Draw {
    random: ChaCha8Rng,
}

impl Draw {
    fn new(seed: u64) -> Self {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        random.set_stream(STREAM);
        Self { random }
    }

    fn scenario(&mut self, seed: u64) -> String {
        // Few robots more often than many: time goes with their number, and what they share is the station alone.
        let robots = 1 + (10.0 * self.range(0.0, 0.999).powi(3)) as usize;
        let duration = self.range(30.0, 45.0);
        let environment = self.pick(&["ideal", "real", "real", "calibrated"]);
        let mut text = format!(
            "seed = {seed}\nduration_s = {duration}\nenvironment = \"{environment}\"\n[network]\n"
        );
        self.network(&mut text, duration, robots);
        self.faults(&mut text, duration, robots);
        self.sensing(&mut text, environment);
        self.planner(&mut text, robots);
        for robot in 0..robots {
            self.robot(&mut text, robot, duration);
        }
        text
    }

    fn network(&mut self, text: &mut String, duration: f64, robots: usize) {
        let cuts = if self.chance(0.35) {
            1 + self.below(2)
        } else {
            0
        };
        let cuts: Vec<String> = (0..cuts)
            .map(|_| {
                let from = self.range(3.0, duration - 8.0);
                let to = from + self.range(0.3, 6.0);
                let who = self.somebody(robots);
                format!("{{ from_s = {from}, to_s = {to}, robots = [{who}] }}")
            })
            .collect();
        let _ = writeln!(text, "partition = [{}]", cuts.join(", "));
        if self.chance(0.4) {
            for way in ["up", "down"] {
                let _ = writeln!(text, "[network.{way}]");
                self.link(text);
            }
        } else {
            self.link(text);
        }
    }

    fn link(&mut self, text: &mut String) {
        let delay = match self.below(4) {
            0 => 0.0,
            1 => self.range(0.0, 50.0),
            2 => self.range(50.0, 200.0),
            _ => self.range(200.0, 500.0),
        };
        let jitter = if self.chance(0.7) {
            self.range(0.0, 5.0 + 0.2 * delay)
        } else {
            0.0
        };
        let distribution = self.pick(&["normal", "normal", "normal", "log-normal"]);
        let _ = writeln!(
            text,
            "delay_ms = {delay}\njitter_ms = {jitter}\ndistribution = \"{distribution}\""
        );
        match self.below(10) {
            0..4 => {}
            4..7 => {
                let loss = self.range(0.0, 0.3);
                let _ = writeln!(text, "loss = {loss}");
            }
            _ => {
                let (bad, good) = (self.range(0.1, 2.0), self.range(5.0, 30.0));
                let loss = self.range(0.7, 1.0);
                let _ = writeln!(
                    text,
                    "burst = {{ mean_bad_s = {bad}, mean_good_s = {good}, loss_bad = {loss} }}"
                );
            }
        }
        if self.chance(0.3) {
            let duplicate = self.range(0.0, 0.5);
            let _ = writeln!(text, "duplicate = {duplicate}");
        }
        if self.chance(0.3) {
            let (rate, queue) = (self.range(150.0, 1000.0), self.range(50.0, 500.0));
            let _ = writeln!(text, "bandwidth_kbps = {rate}\nqueue_ms = {queue}");
        }
    }

    fn faults(&mut self, text: &mut String, duration: f64, robots: usize) {
        for _ in 0..self.below(5) {
            let kind = self.pick(&[
                "station-crash",
                "agent-crash",
                "freeze",
                "station-freeze",
                "replay",
                "stale",
                "slow-planner",
            ]);
            let at = self.range(1.0, duration - 5.0);
            let length = match kind {
                "freeze" => self.range(0.02, 1.0),
                _ => self.range(0.2, 6.0),
            };
            let who = match kind {
                "station-crash" | "station-freeze" => String::new(),
                _ => self.somebody(robots),
            };
            let _ = writeln!(
                text,
                "[[faults]]\nkind = \"{kind}\"\nat_s = {at}\nfor_s = {length}\nrobots = [{who}]"
            );
        }
    }

    fn sensing(&mut self, text: &mut String, environment: &str) {
        let noise = match environment {
            "ideal" => 0.0,
            _ => self.range(0.5, 1.5),
        };
        let rate = match self.below(8) {
            0 => 0.0,
            1..4 => 10.0,
            _ => self.range(2.0, 30.0),
        };
        let sigma = self.range(0.005, 0.05);
        let _ = writeln!(
            text,
            "[sensing]\nnoise = {noise}\nposition_fix_hz = {rate}\nposition_fix_noise_m = {sigma}"
        );
    }

    fn planner(&mut self, text: &mut String, robots: usize) {
        let _ = writeln!(text, "[planner]");
        if self.chance(0.2) {
            let age = self.range(2.5, 5.0);
            let _ = writeln!(text, "max_age_s = {age}");
        }
        if self.chance(0.2) {
            let _ = writeln!(text, "horizon = {}", 20 + self.below(11));
        }
        if self.chance(0.15) {
            let _ = writeln!(text, "compensation = \"no-gains\"");
        }
        // It solves the same problems, and would take most of a soak's time if fleets planned with it.
        if self.chance(0.15) && robots == 1 {
            let _ = writeln!(text, "solver = \"clarabel\"");
        }
    }

    fn robot(&mut self, text: &mut String, index: usize, duration: f64) {
        // A square of the floor each: what keeps them apart on their way is not theirs yet.
        let (row, column) = (index / 4, index % 4);
        let x = 2.5 * column as f64 - 3.75 + self.range(-0.5, 0.5);
        let y = 2.5 * row as f64 - 2.5 + self.range(-0.5, 0.5);
        let heading = self.range(-180.0, 180.0);
        let controller = match self.below(20) {
            0..3 => "htsmc-paper",
            3..6 => "fuzzy-pid",
            _ => "htsmc",
        };
        let _ = writeln!(
            text,
            "[[robots]]\nid = \"r{}\"\nstart = {{ x_m = {x}, y_m = {y}, heading_deg = {heading} }}\nroll_controller = \"{controller}\"",
            index + 1
        );
        if self.chance(0.5) {
            let offset = self.range(-1000.0, 1000.0);
            let _ = writeln!(text, "clock_offset_s = {offset}");
        }
        if self.chance(0.3) {
            let drift = self.range(-200.0, 200.0);
            let _ = writeln!(text, "clock_drift_ppm = {drift}");
        }
        if self.chance(0.4) {
            let mut scale: Vec<f64> = PARAMETERS.iter().map(|_| self.range(0.8, 1.2)).collect();
            // The mass moment m l too: at 0.73 and 0.68 of what is believed HTSMC swings up (docs/soak.md).
            let (mass, length) = (place("m"), place("l"));
            scale[length] = scale[length].clamp(0.8 / scale[mass], 1.2 / scale[mass]);
            let scale = PARAMETERS.iter().zip(&scale);
            let scale: Vec<String> = scale.map(|(key, by)| format!("{key} = {by:.3}")).collect();
            let _ = writeln!(text, "plant = {{ scale = {{ {} }} }}", scale.join(", "));
        }
        let disturbance = self.disturbance(duration);
        let mission = self.mission();
        let _ = writeln!(
            text,
            "disturbance = {{ {disturbance} }}\nmission = {{ {mission} }}"
        );
    }

    fn disturbance(&mut self, duration: f64) -> String {
        let mut keys = Vec::new();
        if self.chance(0.2) {
            let (imbalance, harmonic) = (self.range(0.0, 2.3), self.range(0.5, 2.0));
            keys.push(format!("imbalance_nm = {imbalance}"));
            keys.push(format!("imbalance_harmonic = {harmonic}"));
        }
        if self.chance(0.2) {
            let (sigma, correlation) = (self.range(0.0, 0.5), self.range(0.1, 1.0));
            keys.push(format!("random_nm = {sigma}"));
            keys.push(format!("random_correlation_s = {correlation}"));
        }
        if self.chance(0.2) {
            keys.push(format!("stiction_nm = {}", self.range(0.0, 0.2)));
        }
        if self.chance(0.2) {
            let (x, y) = (self.range(-1.0, 1.0), self.range(-1.0, 1.0));
            keys.push(format!("slope_deg = [{x}, {y}]"));
        }
        if self.chance(0.2) {
            let (x, y) = (self.range(-4.0, 2.0), self.range(-4.0, 2.0));
            let (x_end, y_end) = (x + self.range(0.5, 3.0), y + self.range(0.5, 3.0));
            let c_rr = self.range(0.0, 0.04);
            keys.push(format!(
                "patches = [{{ min_m = [{x}, {y}], max_m = [{x_end}, {y_end}], c_rr = {c_rr} }}]"
            ));
        }
        if self.chance(0.3) {
            let (at, length) = (self.range(3.0, duration), self.range(0.05, 0.3));
            let (roll, pitch) = (self.range(-5.0, 5.0), self.range(-5.0, 5.0));
            keys.push(format!(
                "pushes = [{{ at_s = {at}, for_s = {length}, roll_nm = {roll}, pitch_nm = {pitch} }}]"
            ));
        }
        keys.join(", ")
    }

    fn mission(&mut self) -> String {
        match self.below(9) {
            0 => "kind = \"line\"".to_owned(),
            1 => "kind = \"sine\"".to_owned(),
            2 | 3 => "kind = \"lemniscate\"".to_owned(),
            4 => {
                let (radius, speed) = (self.range(2.0, 6.0), self.range(0.2, 0.8));
                format!("kind = \"circle\", radius_m = {radius}, speed_mps = {speed}")
            }
            5 => {
                let mut points = Vec::new();
                let (mut x, mut y) = (self.range(-2.0, 2.0), self.range(-2.0, 2.0));
                for _ in 0..3 + self.below(3) {
                    points.push(format!("[{x:.3}, {y:.3}]"));
                    // Far enough for the turn behind a sharp corner.
                    let (way, bearing) = (self.range(5.0, 9.0), self.range(0.0, TURN));
                    (x, y) = (x + way * f64::cos(bearing), y + way * f64::sin(bearing));
                }
                let speed = self.range(0.2, 0.7);
                format!(
                    "kind = \"waypoints\", points_m = [{}], speed_mps = {speed}",
                    points.join(", ")
                )
            }
            6 => {
                let angles: Vec<String> = (0..1 + self.below(4))
                    .map(|_| self.range(-10.0, 10.0).to_string())
                    .collect();
                let (speed, hold) = (self.range(0.0, 1.0), self.range(2.0, 8.0));
                format!(
                    "kind = \"roll\", speed_mps = {speed}, angles_deg = [{}], hold_s = {hold}",
                    angles.join(", ")
                )
            }
            7 => {
                let (speed, angle) = (self.range(0.0, 1.0), self.range(1.0, 10.0));
                let (rate, phase) = (self.range(0.1, 0.6), self.range(0.0, TURN));
                format!(
                    "kind = \"roll-sine\", speed_mps = {speed}, amplitude_deg = {angle}, rate_radps = {rate}, phase_rad = {phase}"
                )
            }
            _ => "kind = \"hold\"".to_owned(),
        }
    }

    /// Nobody named, which is everybody, or one robot.
    fn somebody(&mut self, robots: usize) -> String {
        if self.chance(0.4) {
            String::new()
        } else {
            format!("\"r{}\"", 1 + self.below(robots))
        }
    }

    fn chance(&mut self, probability: f64) -> bool {
        self.random.random::<f64>() < probability
    }

    fn range(&mut self, low: f64, high: f64) -> f64 {
        let drawn = low + (high - low) * self.random.random::<f64>();
        // As a person would write it: what fails is read by people.
        (drawn * 1e3).round() / 1e3
    }

    fn below(&mut self, count: usize) -> usize {
        self.random.random_range(0..count)
    }

    fn pick<'a>(&mut self, choices: &[&'a str]) -> &'a str {
        choices[self.below(choices.len())]
    }
}

/// Where a parameter stands among those that are drawn.
fn place(key: &str) -> usize {
    let place = PARAMETERS.iter().position(|other| *other == key);
    place.expect("it is drawn")
}

/// A turn, as short as what is drawn [rad].
#[expect(clippy::approx_constant, reason = "drawn values have three decimals")]
const TURN: f64 = 6.28;
/// The random stream of scenarios: robots' own count from zero, 16 each.
const STREAM: u64 = u64::MAX;
/// What the robot may differ in from what agent and station believe.
const PARAMETERS: &[&str] = &[
    "m",
    "m_f",
    "m_s",
    "l",
    "i_s",
    "j_mr",
    "j_mp",
    "j_mu",
    "i_fr",
    "i_fp",
    "i_fu",
    "zeta",
    "c_rr",
    "coulomb",
    "motor_lag",
    "motor_delay",
];
