//! What acts on a robot from outside: an unbalanced shell, pushes, a slope, patches of other floor.

use serde::Deserialize;

use sphere_protocol::robot::RobotParams;

/// Everything that disturbs one robot. The default disturbs nothing.
#[derive(Clone, Debug, PartialEq)]
pub struct Disturbance {
    /// Shell imbalance, A [N·m]: A cos φ_s on the rolling motion, A sin φ_s on the roll. Once a turn of the shell it pushes the robot
    /// ahead, and a quarter turn later to the left.
    pub imbalance: f64,
    /// Turns of that torque for each turn of the shell [1]: 1 for an unbalanced shell; what else shakes a robot has other rates.
    pub imbalance_harmonic: f64,
    /// A torque that wanders, on the roll and on the rolling motion.
    pub random: RandomTorque,
    /// By how much sticking joints exceed their Coulomb friction at rest [N·m].
    pub stiction: f64,
    /// Torques for a while; those that overlap add up.
    pub pushes: Vec<Push>,
    /// Rise of the floor along world X and Y, tangents [1].
    pub slope: [f64; 2],
    /// Floor of other rolling resistance; where patches overlap the last one counts.
    pub patches: Vec<Patch>,
}

/// A random torque: stationary, Gaussian, with an exponential correlation in time (Ornstein-Uhlenbeck).
#[derive(Clone, Copy, Debug, PartialEq, Default)]
pub struct RandomTorque {
    /// Standard deviation [N·m].
    pub sigma: f64,
    /// Correlation time [s].
    pub correlation: f64,
}

/// A torque from outside, for a while.
#[derive(Clone, Copy, Debug, PartialEq, Default, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Push {
    /// Torque on the roll, > 0 leans the robot left [N·m].
    pub roll_nm: f64,
    /// Torque on the rolling motion, > 0 drives the robot forward [N·m].
    pub pitch_nm: f64,
    /// When it begins, from the start of the simulation [s].
    pub at_s: f64,
    /// How long it lasts [s].
    pub for_s: f64,
}

/// A rectangle of floor with its own rolling resistance, edges along the world's axes.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Patch {
    /// Its corner of lowest X and Y [m].
    pub min_m: [f64; 2],
    /// Its corner of highest X and Y [m].
    pub max_m: [f64; 2],
    /// Rolling resistance coefficient on it [1].
    pub c_rr: f64,
}

/// What acts on the plant over one step of the integrator.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Surroundings {
    /// Torque on the roll, row q_r [N·m].
    pub roll: f64,
    /// Torque on the rolling motion, row v times R [N·m].
    pub pitch: f64,
    /// Shell imbalance, A [N·m].
    pub imbalance: f64,
    /// Turns of that torque for each turn of the shell [1].
    pub imbalance_harmonic: f64,
    /// By how much sticking joints exceed their Coulomb friction at rest [N·m].
    pub stiction: f64,
    /// The vertical, a unit vector on the floor's X, Y and normal.
    pub up: [f64; 3],
    /// Rolling resistance coefficient of the floor here [1].
    pub c_rr: f64,
}

impl Default for Disturbance {
    fn default() -> Self {
        Self {
            imbalance: 0.0,
            imbalance_harmonic: 1.0,
            random: RandomTorque::default(),
            stiction: 0.0,
            pushes: Vec::new(),
            slope: [0.0; 2],
            patches: Vec::new(),
        }
    }
}

impl RandomTorque {
    /// The torque `dt` [s] after `torque` [N·m], given a standard normal number.
    pub fn step(&self, torque: f64, dt: f64, normal: f64) -> f64 {
        if self.sigma == 0.0 {
            return 0.0;
        }
        let kept = (-dt / self.correlation).exp();
        kept * torque + self.sigma * (1.0 - kept * kept).sqrt() * normal
    }
}

impl Disturbance {
    /// Torque of the pushes `at` seconds after the start, on the roll and on the rolling motion [N·m].
    pub fn pushes_at(&self, at: f64) -> [f64; 2] {
        let now = |push: &&Push| at >= push.at_s && at < push.at_s + push.for_s;
        let add =
            |[roll, pitch]: [f64; 2], push: &Push| [roll + push.roll_nm, pitch + push.pitch_nm];
        self.pushes.iter().filter(now).fold([0.0; 2], add)
    }

    /// What acts `at` seconds after the start on a robot at world (`x`, `y`) [m]: asked every 5 ms, the edge of a patch is met to 5 mm.
    pub fn surroundings(&self, params: &RobotParams, at: f64, x: f64, y: f64) -> Surroundings {
        let mut around = Surroundings::level(params);
        around.imbalance = self.imbalance;
        around.imbalance_harmonic = self.imbalance_harmonic;
        around.stiction = self.stiction;
        [around.roll, around.pitch] = self.pushes_at(at);
        let [rise_x, rise_y] = self.slope;
        let length = (1.0 + rise_x * rise_x + rise_y * rise_y).sqrt();
        around.up = [rise_x / length, rise_y / length, 1.0 / length];
        if let Some(patch) = self.patches.iter().rev().find(|patch| patch.contains(x, y)) {
            around.c_rr = patch.c_rr;
        }
        around
    }
}

impl Patch {
    /// Whether world (`x`, `y`) [m] lies on it, its edges included.
    pub fn contains(&self, x: f64, y: f64) -> bool {
        (self.min_m[0]..=self.max_m[0]).contains(&x) && (self.min_m[1]..=self.max_m[1]).contains(&y)
    }
}

impl Surroundings {
    /// Level floor of the robot's own rolling resistance, and nothing else.
    pub fn level(params: &RobotParams) -> Self {
        Self {
            roll: 0.0,
            pitch: 0.0,
            imbalance: 0.0,
            imbalance_harmonic: 1.0,
            stiction: 0.0,
            up: [0.0, 0.0, 1.0],
            c_rr: params.c_rr,
        }
    }

    /// Torques on the roll and on the rolling motion [N·m], with the shell at angle `phi_s` [rad].
    pub fn torques(&self, phi_s: f64) -> (f64, f64) {
        let (sin, cos) = self.imbalance_angle(phi_s).unwrap_or_default().sin_cos();
        self.torques_turned(sin, cos)
    }

    /// Angle of the imbalance with the shell at `phi_s` [rad]; `None` for a shell that is balanced.
    pub(crate) fn imbalance_angle(&self, phi_s: f64) -> Option<f64> {
        (self.imbalance != 0.0).then_some(self.imbalance_harmonic * phi_s)
    }

    /// As [`Surroundings::torques`], by sine and cosine of the imbalance's angle.
    pub(crate) fn torques_turned(&self, sin: f64, cos: f64) -> (f64, f64) {
        (
            self.roll + self.imbalance * sin,
            self.pitch + self.imbalance * cos,
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use sphere_protocol::robot::Robot;

    fn liu() -> RobotParams {
        Robot::embedded("liu")
            .expect("comes with the project")
            .params
    }

    #[test]
    fn nothing_disturbs_by_default() {
        let undisturbed = Disturbance::default().surroundings(&liu(), 3.0, 1.0, 2.0);
        assert_eq!(undisturbed, Surroundings::level(&liu()));
    }

    #[test]
    fn pushes_last_as_long_as_they_say_and_add_up() {
        let push = |roll_nm, pitch_nm, at_s, for_s| Push {
            roll_nm,
            pitch_nm,
            at_s,
            for_s,
        };
        let disturbance = Disturbance {
            pushes: vec![push(5.0, 0.0, 1.0, 0.5), push(1.0, -2.0, 1.25, 0.5)],
            ..Disturbance::default()
        };
        for (at, expected) in [
            (0.999, (0.0, 0.0)),
            (1.0, (5.0, 0.0)),
            (1.25, (6.0, -2.0)),
            (1.5, (1.0, -2.0)),
            (1.75, (0.0, 0.0)),
        ] {
            let around = disturbance.surroundings(&liu(), at, 0.0, 0.0);
            assert_eq!(around.torques(0.3), expected, "at {at} s");
        }
    }

    #[test]
    fn last_patch_under_the_robot_sets_the_rolling_resistance() {
        let patch = |min_m, max_m, c_rr| Patch { min_m, max_m, c_rr };
        let disturbance = Disturbance {
            patches: vec![
                patch([0.0, 0.0], [2.0, 2.0], 0.03),
                patch([1.0, 1.0], [3.0, 3.0], 0.05),
            ],
            ..Disturbance::default()
        };
        let c_rr = |x, y| disturbance.surroundings(&liu(), 0.0, x, y).c_rr;
        assert_eq!(c_rr(-0.1, 1.0), liu().c_rr);
        assert_eq!(c_rr(0.5, 0.5), 0.03);
        assert_eq!(c_rr(1.5, 1.5), 0.05);
        assert_eq!(c_rr(f64::NAN, 1.5), liu().c_rr);
    }

    #[test]
    fn vertical_leans_uphill_by_the_slope() {
        let disturbance = Disturbance {
            slope: [0.03, -0.04],
            ..Disturbance::default()
        };
        let up = disturbance.surroundings(&liu(), 0.0, 0.0, 0.0).up;
        assert!((up.iter().map(|x| x * x).sum::<f64>() - 1.0).abs() < 1e-15);
        assert!((up[0] / up[2] - 0.03).abs() < 1e-15 && (up[1] / up[2] + 0.04).abs() < 1e-15);
    }
}
