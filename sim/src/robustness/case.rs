//! The cases: what differs, as keys of the scenario.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// One way in which robot or world differ.
#[derive(Clone, Copy, Debug)]
pub struct Case {
    /// Its name.
    pub name: &'static str,
    /// What kind of difference.
    pub group: &'static str,
    change: Change,
}

#[derive(Clone, Copy, Debug)]
enum Change {
    /// These keys are set.
    Keys(&'static [(&'static str, &'static str)]),
    /// These parameters of the true robot have this factor.
    Scale(&'static [&'static str], f64),
    /// Every parameter of the true robot has a factor of its own, drawn from 1 ± 0.2.
    Drawn,
}

impl Case {
    /// Seeds that it is run with: ten times as many where the robot itself is drawn.
    pub fn seeds(&self, seeds: u64) -> u64 {
        match self.change {
            Change::Drawn => 10 * seeds,
            _ => seeds,
        }
    }

    /// The arguments of `--set` under `seed`.
    pub(super) fn sets(&self, seed: u64) -> Vec<String> {
        let scale = |key: &str, factor: f64| format!("robots.0.plant.scale.{key}={factor}");
        match self.change {
            Change::Keys(keys) => keys
                .iter()
                .map(|(key, value)| format!("{key}={value}"))
                .collect(),
            Change::Scale(keys, factor) => keys.iter().map(|key| scale(key, factor)).collect(),
            Change::Drawn => {
                let mut random = ChaCha8Rng::seed_from_u64(seed);
                random.set_stream(STREAM);
                let mut factor = || 0.8 + 0.4 * random.random::<f64>();
                EVERYTHING.iter().map(|key| scale(key, factor())).collect()
            }
        }
    }
}

/// Every case.
pub fn all() -> Vec<Case> {
    let case = |group, name, change| Case {
        name,
        group,
        change,
    };
    let scale = |name, keys, factor| case("robot", name, Change::Scale(keys, factor));
    let motors = |name, key, factor| case("motors", name, Change::Scale(key, factor));
    let keys = |group, name, keys| case(group, name, Change::Keys(keys));
    vec![
        keys("nominal", "as believed", &[]),
        scale("mass +20 %", MASS, 1.2),
        scale("mass −20 %", MASS, 0.8),
        scale("inertias +20 %", INERTIAS, 1.2),
        scale("inertias −20 %", INERTIAS, 0.8),
        scale("pendulum length +20 %", &["l"], 1.2),
        scale("pendulum length −20 %", &["l"], 0.8),
        scale("damping +20 %", &["zeta"], 1.2),
        scale("damping −20 %", &["zeta"], 0.8),
        scale("rolling resistance +20 %", &["c_rr"], 1.2),
        scale("rolling resistance −20 %", &["c_rr"], 0.8),
        scale("all +20 %", EVERYTHING, 1.2),
        scale("all −20 %", EVERYTHING, 0.8),
        case("robot", "all, each ±20 % drawn", Change::Drawn),
        motors("delay 0 ms", &["motor_delay"], 0.0),
        motors("delay 40 ms", &["motor_delay"], 2.0),
        motors("delay 60 ms", &["motor_delay"], 3.0),
        motors("torque limit 10 N·m", &["torque_max"], 0.5),
        motors("torque limit 6 N·m", &["torque_max"], 0.3),
        keys(
            "motors",
            "sticking joints 0.5 N·m",
            &[("robots.0.disturbance.stiction_nm", "0.5")],
        ),
        keys(
            "motors",
            "sticking joints 1.5 N·m",
            &[("robots.0.disturbance.stiction_nm", "1.5")],
        ),
        keys("sensors", "noise × 2", &[("sensing.noise", "2")]),
        keys("sensors", "noise × 4", &[("sensing.noise", "4")]),
        keys(
            "floor",
            "slope 2° ahead",
            &[("robots.0.disturbance.slope_deg", "[2.0, 0.0]")],
        ),
        keys(
            "floor",
            "slope 2° aside",
            &[("robots.0.disturbance.slope_deg", "[0.0, 2.0]")],
        ),
        keys(
            "floor",
            "patch of 4 × resistance",
            &[(
                "robots.0.disturbance.patches",
                "[{ min_m = [2.0, -9.0], max_m = [9.0, 9.0], c_rr = 0.04 }]",
            )],
        ),
        keys(
            "disturbance",
            "imbalance 2.3 N·m, once a turn",
            &[("robots.0.disturbance.imbalance_nm", "2.3")],
        ),
        keys(
            "disturbance",
            "the same, 1.5 times a turn",
            &[
                ("robots.0.disturbance.imbalance_nm", "2.3"),
                ("robots.0.disturbance.imbalance_harmonic", "1.5"),
            ],
        ),
        keys(
            "disturbance",
            "the same, twice a turn",
            &[
                ("robots.0.disturbance.imbalance_nm", "2.3"),
                ("robots.0.disturbance.imbalance_harmonic", "2.0"),
            ],
        ),
        keys(
            "disturbance",
            "random torque 0.5 N·m",
            &[("robots.0.disturbance.random_nm", "0.5")],
        ),
        keys(
            "disturbance",
            "random torque 1 N·m",
            &[("robots.0.disturbance.random_nm", "1.0")],
        ),
        keys(
            "disturbance",
            "after a push of 10 N·m for 0.2 s",
            &[(
                "robots.0.disturbance.pushes",
                "[{ at_s = 8.0, roll_nm = 10.0, for_s = 0.2 }]",
            )],
        ),
        keys(
            "environment",
            "calibrated",
            &[("environment", "calibrated")],
        ),
    ]
}

const MASS: &[&str] = &["m", "m_f", "m_s"];
const INERTIAS: &[&str] = &["i_s", "j_mr", "j_mp", "j_mu", "i_fr", "i_fp", "i_fu"];
/// What identification or a scale would have to find out.
const EVERYTHING: &[&str] = &[
    "m", "m_f", "m_s", "l", "i_s", "j_mr", "j_mp", "j_mu", "i_fr", "i_fp", "i_fu", "zeta", "c_rr",
];
/// Of the factors; a robot's own streams are below.
const STREAM: u64 = 1 << 32;
