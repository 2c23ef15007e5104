//! Fuzzy scheduling of PID gains: seven sets a side, 7 × 7 rules, product-sum inference. Shared by both fuzzy-PID controllers.
//!
//! The paper compares with a fuzzy-PID of its authors' earlier work and prints nothing of it: seven sets, product-sum inference and a
//! table each for Kp, Ki, Kd are what such a controller commonly is; these tables, scalings and spans are ours, tuned on this robot.

use crate::gains::FuzzySchedule;

/// Number of sets a side: NB, NM, NS, ZO, PS, PM, PB.
pub const SETS: usize = 7;

/// Centre of PB, and the clamp of a scaled input; the sets' centres are −3, −2, …, 3.
pub const UNIVERSE: f64 = 3.0;

/// Consequents of 7 × 7 rules in thirds: −3 is NB, 3 is PB. Rows are the error's sets, columns its rate's, both NB to PB.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RuleTable([[i8; SETS]; SETS]);

/// The two sets that an input belongs to, and how much: triangles that overlap by half, so that the two degrees add up to 1.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Membership {
    /// The lower of the two neighbouring sets, 0 (NB) to 5 (PM).
    pub lower: usize,
    /// Degree of membership in the set above it [1], 0 to 1; in `lower` it is 1 minus this.
    pub upper_degree: f64,
}

/// Gains that a schedule gives, in the units of the loop that uses it.
#[derive(Clone, Copy, Debug, PartialEq, Default)]
pub struct PidGains {
    /// Kp, on the error.
    pub kp: f64,
    /// Ki, on its integral.
    pub ki: f64,
    /// Kd, on its rate.
    pub kd: f64,
}

impl Membership {
    /// Of `x`, scaled to sets a unit apart and clamped to ±[`UNIVERSE`]. NaN belongs nowhere: its degree is NaN.
    pub fn of(x: f64) -> Self {
        let place = x.clamp(-UNIVERSE, UNIVERSE) + UNIVERSE;
        // A float becomes the nearest integer that there is; NaN becomes 0.
        let lower = (place as usize).min(SETS - 2);
        Self {
            lower,
            upper_degree: place - lower as f64,
        }
    }

    /// Degree of membership in every set, NB to PB [1].
    pub fn degrees(&self) -> [f64; SETS] {
        let mut degrees = [0.0; SETS];
        degrees[self.lower] = 1.0 - self.upper_degree;
        degrees[self.lower + 1] = self.upper_degree;
        degrees
    }
}

impl RuleTable {
    /// The table whose rows NB to ZO are `upper`; PS, PM and PB are NS, NM and NB reversed, because left and right are alike.
    const fn symmetric(upper: [[i8; SETS]; 4]) -> Self {
        let mut rows = [[0; SETS]; SETS];
        let mut row = 0;
        while row < SETS {
            let mut column = 0;
            while column < SETS {
                rows[row][column] = if row < 4 {
                    upper[row][column]
                } else {
                    upper[SETS - 1 - row][SETS - 1 - column]
                };
                column += 1;
            }
            row += 1;
        }
        Self(rows)
    }

    /// What a rule says, −1 (NB) to 1 (PB), for the sets `error` and `rate`, each 0 (NB) to 6 (PB).
    pub fn consequent(&self, error: usize, rate: usize) -> f64 {
        f64::from(self.0[error][rate]) / UNIVERSE
    }

    /// Product-sum inference with singletons: the rules' consequents weighted by the products of degrees, −1 to 1.
    ///
    /// The degrees of each input add up to 1, and with them the products: there is nothing to divide by. Four rules fire at most.
    pub fn infer(&self, error: Membership, rate: Membership) -> f64 {
        let along = |row: usize| {
            let (lower, upper) = (
                self.consequent(row, rate.lower),
                self.consequent(row, rate.lower + 1),
            );
            (1.0 - rate.upper_degree) * lower + rate.upper_degree * upper
        };
        (1.0 - error.upper_degree) * along(error.lower)
            + error.upper_degree * along(error.lower + 1)
    }
}

/// The gains for the error `e` [rad] and its rate `e_rate` [rad/s]: K = K₀ + K_span f(e, ė), f the table's inference, at least 0.
pub fn schedule(s: &FuzzySchedule, e: f64, e_rate: f64) -> PidGains {
    let error = Membership::of(s.error_scale * e);
    let rate = Membership::of(s.rate_scale * e_rate);
    // max(0, ·): a span may reach below zero, where a gain would push the wrong way. Written so that a NaN stays visible.
    let gain = |base: f64, span: f64, table: &RuleTable| {
        let gain = base + span * table.infer(error, rate);
        if gain < 0.0 { 0.0 } else { gain }
    };
    PidGains {
        kp: gain(s.kp, s.kp_span, &KP),
        ki: gain(s.ki, s.ki_span, &KI),
        kd: gain(s.kd, s.kd_span, &KD),
    }
}

const NB: i8 = -3;
const NM: i8 = -2;
const NS: i8 = -1;
const ZO: i8 = 0;
const PS: i8 = 1;
const PM: i8 = 2;
const PB: i8 = 3;

/// Kp: more, the farther off and the faster it goes away; near the target, a little less where it moves.
pub const KP: RuleTable = RuleTable::symmetric([
    [PB, PB, PB, PB, PM, PM, PS],
    [PM, PM, PM, PM, PS, ZO, ZO],
    [PS, PS, PS, PS, ZO, NS, NS],
    [ZO, ZO, ZO, NS, ZO, ZO, ZO],
]);

/// Ki: none far off, where it would wind up; most at rest near the target.
pub const KI: RuleTable = RuleTable::symmetric([
    [NB, NB, NB, NB, NB, NB, NB],
    [NM, NM, NM, NM, NM, NM, NM],
    [NS, NS, ZO, PS, PS, ZO, NS],
    [ZO, PS, PM, PB, PM, PS, ZO],
]);

/// Kd: more, the faster it comes home, so that it does not overshoot; less while it goes away.
pub const KD: RuleTable = RuleTable::symmetric([
    [NM, NM, NS, NS, ZO, PM, PB],
    [NS, NS, NS, ZO, PS, PM, PB],
    [ZO, ZO, ZO, PS, PM, PM, PB],
    [PM, PS, PS, PS, PS, PS, PM],
]);
