//! A drivable way through points: straights joined by turns of bounded curvature, ramps of speed at both ends.
//!
//! The way is laid out for the point P of the module `flat`, whose heading and curvature are chosen freely; the centre follows exactly,
//! up to R q_r inside the turn. A turn is an arc between two ramps of curvature, κ = κ₀ + (κ₁ − κ₀)(1 − cos πσ/L)/2, whose ends have zero
//! slope, so that roll and roll rate are continuous. A corner is rounded (the turn is symmetric about it) where the
//! straights beside it are long enough; otherwise the robot drives to the point and turns behind it towards the next one.

use core::f64::consts::{PI, TAU};

use sphere_protocol::robot::Robot;

use super::flat::{curvature_of_roll, roll_of_turn};
use super::mission::MissionError;
use super::{Motion, Pose, ReferencePoint};
use crate::jet::Jet;

/// A way through points, ready for one robot.
#[derive(Clone, Debug)]
pub struct Waypoints {
    pieces: Vec<Piece>,
    length: f64,    // of the whole way [m]
    speed: f64,     // between the ramps [m/s]
    ramp_time: f64, // of each ramp [s]
    r: f64,         // radius of the sphere [m]
}

/// A stretch on which the curvature goes smoothly from one value to another: a straight, an arc, or a ramp between them.
#[derive(Clone, Debug)]
struct Piece {
    from: f64,            // way before it [m]
    length: f64,          // [m]
    heading: f64,         // at its beginning [rad]
    curvature: [f64; 2],  // at its ends [1/m]
    knots: Vec<[f64; 2]>, // positions at the beginning of equal panels [m]
}

/// How tightly a robot may turn at its mission's speed.
#[derive(Clone, Copy)]
struct Tightness {
    curvature: f64,      // largest κ [1/m]
    curvature_rate: f64, // largest dκ/ds [1/m²]
}

impl Waypoints {
    /// The way through `points` [m] at `speed` [m/s].
    ///
    /// # Errors
    /// A speed above the robot's limit; a point so close behind a sharp corner that no turn of the robot reaches it.
    pub(super) fn new(
        points: &[[f64; 2]],
        speed: f64,
        robot: &Robot,
    ) -> Result<Self, MissionError> {
        let (r, limits) = (robot.params.r, &robot.limits);
        if speed > limits.v_max {
            return Err(MissionError::TooFast {
                speed_mps: speed,
                v_max: limits.v_max,
            });
        }
        let turn_limit = limits.turn_limit(&robot.params);
        let q_r = ROLL_SHARE * limits.q_r_max.min((turn_limit / (speed * speed)).atan());
        let tightness = Tightness {
            curvature: curvature_of_roll(q_r, r),
            curvature_rate: ROLL_RATE / (r * speed.max(0.1)),
        };
        let pieces = lay_out(points, tightness)?;
        let length = pieces.last().map_or(0.0, |last| last.from + last.length);
        // Both ramps together take 1.5 v²/a of way: a short way has a lower top speed.
        let speed = speed.min((length * ACCELERATION / 1.5).sqrt());
        Ok(Self {
            pieces,
            length,
            speed,
            ramp_time: 1.5 * speed / ACCELERATION,
            r,
        })
    }

    /// From the first point to rest at the last [s].
    pub fn duration(&self) -> f64 {
        self.length / self.speed + self.ramp_time
    }

    /// The reference `t` seconds after the start; at rest before and after.
    pub fn reference(&self, t: f64) -> ReferencePoint {
        let [x, y, heading, ..] = self.state(t);
        let there = ReferencePoint {
            x,
            y,
            heading,
            ..ReferencePoint::default()
        };
        there.moving(self.motion(t))
    }

    /// Its pose, speed and roll alone: x, y [m], heading [rad], v [m/s], q_r [rad].
    pub fn state(&self, t: f64) -> [f64; 5] {
        let (s, w, _) = self.progress(t);
        let (piece, sigma) = self.piece(s);
        let pose = piece.pose(sigma);
        let (q_r, d) = roll_of_turn(Jet::<1>::constant(self.r * piece.curvature(sigma).0));
        // C = P + R q_r n.
        let (side, (sin, cos)) = (self.r * q_r.value(), pose.heading.sin_cos());
        [
            pose.x - side * sin,
            pose.y + side * cos,
            pose.heading,
            w * d.value(),
            q_r.value(),
        ]
    }

    /// Its speed and roll with their rates alone.
    pub fn motion(&self, t: f64) -> Motion {
        let (s, w, w_rate) = self.progress(t);
        let (piece, sigma) = self.piece(s);
        let (curvature, slope) = piece.curvature(sigma);
        let turn = Jet::<2>::line(self.r * curvature, self.r * slope * w);
        let (q_r, d) = roll_of_turn(turn);
        Motion::of(Jet::line(w, w_rate) * d, q_r)
    }

    /// The piece on which the way is `s` [m], and how far on it [m].
    fn piece(&self, s: f64) -> (&Piece, f64) {
        let i = self.pieces.partition_point(|piece| piece.from <= s);
        let piece = &self.pieces[i.saturating_sub(1)];
        (piece, (s - piece.from).clamp(0.0, piece.length))
    }

    /// Way done [m], speed [m/s] and acceleration [m/s²] at `t`: smooth ramps w = v (3u² − 2u³), u = t / ramp time, at both ends.
    fn progress(&self, t: f64) -> (f64, f64, f64) {
        let (speed, ramp) = (self.speed, self.ramp_time);
        let ramped = |u: f64| {
            let u = u.clamp(0.0, 1.0);
            (
                speed * ramp * u * u * u * (1.0 - 0.5 * u),
                speed * u * u * (3.0 - 2.0 * u),
                speed / ramp * 6.0 * u * (1.0 - u),
            )
        };
        let left = self.duration() - t;
        if t < ramp {
            ramped(t / ramp)
        } else if left < ramp {
            let (s, w, w_rate) = ramped(left / ramp);
            (self.length - s, w, -w_rate)
        } else {
            (speed * (t - 0.5 * ramp), speed, 0.0)
        }
    }
}

impl Piece {
    fn new(from: f64, start: Pose, length: f64, curvature: [f64; 2]) -> Self {
        let turn = 0.5 * (curvature[0] + curvature[1]) * length;
        let panels = ((turn.abs() / PANEL_TURN).ceil() as usize).max(1);
        let mut piece = Self {
            from,
            length,
            heading: start.heading,
            curvature,
            knots: vec![[start.x, start.y]],
        };
        let panel = length / panels as f64;
        for i in 1..panels {
            let end = piece.advance(piece.knots[i - 1], panel * (i - 1) as f64, panel);
            piece.knots.push(end);
        }
        piece
    }

    fn heading(&self, sigma: f64) -> f64 {
        let [begin, end] = self.curvature;
        if begin == end {
            return self.heading + begin * sigma;
        }
        let wave = self.length / PI;
        self.heading + begin * sigma + 0.5 * (end - begin) * (sigma - wave * (sigma / wave).sin())
    }

    /// κ [1/m] and dκ/dσ [1/m²].
    fn curvature(&self, sigma: f64) -> (f64, f64) {
        let [begin, end] = self.curvature;
        if begin == end {
            return (begin, 0.0);
        }
        let rate = PI / self.length;
        let (sin, cos) = (rate * sigma).sin_cos();
        let half = 0.5 * (end - begin);
        (begin + half * (1.0 - cos), half * rate * sin)
    }

    fn pose(&self, sigma: f64) -> Pose {
        let panel = self.length / self.knots.len() as f64;
        let i = ((sigma / panel) as usize).min(self.knots.len() - 1);
        let begin = panel * i as f64;
        let [x, y] = self.advance(self.knots[i], begin, sigma - begin);
        Pose {
            x,
            y,
            heading: self.heading(sigma),
        }
    }

    fn end(&self) -> Pose {
        self.pose(self.length)
    }

    /// The position `length` after `sigma`, where it is `at`: ∫ (cos, sin) of the heading.
    fn advance(&self, at: [f64; 2], sigma: f64, length: f64) -> [f64; 2] {
        if self.curvature == [0.0; 2] {
            let (sin, cos) = self.heading.sin_cos();
            return [at[0] + length * cos, at[1] + length * sin];
        }
        if self.curvature[0] == self.curvature[1] {
            // The chord of the arc: twice the radius by the sine of half the turn.
            let half = 0.5 * self.curvature[0] * length;
            let chord = 2.0 * half.sin() / self.curvature[0];
            let (sin, cos) = self.heading(sigma + 0.5 * length).sin_cos();
            return [at[0] + chord * cos, at[1] + chord * sin];
        }
        let (middle, half) = (sigma + 0.5 * length, 0.5 * length);
        let mut sum = [0.0; 2];
        for (node, weight) in GAUSS {
            for side in [-node, node] {
                let (sin, cos) = self.heading(middle + side * half).sin_cos();
                sum[0] += weight * cos;
                sum[1] += weight * sin;
            }
        }
        [at[0] + half * sum[0], at[1] + half * sum[1]]
    }
}

impl Tightness {
    /// The three stretches of a turn by `turn` [rad]: length [m] and curvature at both ends [1/m] of each.
    ///
    /// Ramps of length ℓ to the curvature κ have the slope πκ/2ℓ and turn by κℓ together; a small turn stays below the largest curvature and has no arc.
    fn turn(self, turn: f64) -> [(f64, [f64; 2]); 3] {
        let angle = turn.abs();
        let peak = (2.0 * self.curvature_rate * angle / PI)
            .sqrt()
            .min(self.curvature);
        let ramp = 0.5 * PI * peak / self.curvature_rate;
        let arc = (angle / peak - ramp).max(0.0);
        let curvature = peak.copysign(turn);
        [
            (ramp, [0.0, curvature]),
            (arc, [curvature; 2]),
            (ramp, [curvature, 0.0]),
        ]
    }

    /// Where `pen` is after a turn by `turn` [rad].
    fn after(self, pen: Pose, turn: f64) -> Pose {
        self.turn(turn)
            .into_iter()
            .fold(pen, |at, (length, curvature)| {
                if length > 0.0 {
                    Piece::new(0.0, at, length, curvature).end()
                } else {
                    at
                }
            })
    }
}

/// Straights and turns through all points.
fn lay_out(points: &[[f64; 2]], tightness: Tightness) -> Result<Vec<Piece>, MissionError> {
    let direction = |from: [f64; 2], to: [f64; 2]| (to[1] - from[1]).atan2(to[0] - from[0]);
    let distance = |from: [f64; 2], to: [f64; 2]| (to[0] - from[0]).hypot(to[1] - from[1]);
    let mut pen = Pose {
        x: points[0][0],
        y: points[0][1],
        heading: direction(points[0], points[1]),
    };
    let mut pieces: Vec<Piece> = Vec::new();
    let mut draw = |pen: &mut Pose, stretches: &[(f64, [f64; 2])]| {
        for &(length, curvature) in stretches.iter().filter(|(length, _)| *length > 0.0) {
            let from = pieces.last().map_or(0.0, |last| last.from + last.length);
            let piece = Piece::new(from, *pen, length, curvature);
            *pen = piece.end();
            pieces.push(piece);
        }
    };
    let straight = |length| [(length, [0.0; 2])];
    // Before each pass of the loop the pen's heading points at points[i].
    for i in 1..points.len() {
        let here = points[i];
        let incoming = distance([pen.x, pen.y], here);
        let Some(&next) = points.get(i + 1) else {
            draw(&mut pen, &straight(incoming));
            break;
        };
        let turn = nearest_turn(direction(here, next) - pen.heading);
        if turn.abs() < STRAIGHT_ON {
            draw(&mut pen, &straight(incoming));
            continue;
        }
        // Half of a straight belongs to each of its corners, but nobody else claims the last one's end.
        let is_last = i + 2 == points.len();
        let outgoing = distance(here, next) * if is_last { 1.0 } else { 0.5 };
        // The turn begins where its chord, half the turn off the heading, is symmetric about the corner.
        let end = tightness.after(Pose::default(), turn);
        let tangent = end.x.hypot(end.y) / (2.0 * (0.5 * turn).cos());
        if turn.abs() < ROUNDED_MAX && tangent <= incoming.min(outgoing) {
            draw(&mut pen, &straight(incoming - tangent));
            draw(&mut pen, &tightness.turn(turn));
        } else {
            draw(&mut pen, &straight(incoming));
            let turn = turn_towards(pen, next, tightness).ok_or(MissionError::TooClose(i + 1))?;
            draw(&mut pen, &tightness.turn(turn));
        }
    }
    Ok(pieces)
}

/// The smallest turn, to either side, after which `pen` points at `target`.
fn turn_towards(pen: Pose, target: [f64; 2], tightness: Tightness) -> Option<f64> {
    // How far the target is left of the heading after the turn, and whether it is ahead.
    let miss = |turn: f64| {
        let end = tightness.after(pen, turn);
        let (sin, cos) = end.heading.sin_cos();
        let (dx, dy) = (target[0] - end.x, target[1] - end.y);
        (cos * dy - sin * dx, cos * dx + sin * dy >= 0.0)
    };
    let one_side = |side: f64| {
        let step = TURN_MAX / TURNS_TRIED as f64;
        let mut before = miss(side * 1e-6);
        for k in 1..=TURNS_TRIED {
            let turn = side * step * k as f64;
            let after = miss(turn);
            if after.1 && before.0.signum() != after.0.signum() {
                let (mut low, mut high) = (turn - side * step, turn);
                for _ in 0..60 {
                    let middle = 0.5 * (low + high);
                    if miss(middle).0.signum() == before.0.signum() {
                        low = middle;
                    } else {
                        high = middle;
                    }
                }
                if miss(high).1 {
                    return Some(high);
                }
            }
            before = after;
        }
        None
    };
    [one_side(1.0), one_side(-1.0)]
        .into_iter()
        .flatten()
        .min_by(|a, b| a.abs().total_cmp(&b.abs()))
}

/// `angle` brought into (−π, π].
fn nearest_turn(angle: f64) -> f64 {
    let turn = angle - TAU * (angle / TAU).round();
    if turn <= -PI { turn + TAU } else { turn }
}

/// Share of the roll limit that a turn's peak takes: the rest is for corrections, and for the lead τ q̇_r of the commands.
const ROLL_SHARE: f64 = 0.85;
/// Largest roll rate of a turn, roughly [rad/s].
const ROLL_RATE: f64 = 0.25;
/// Peak acceleration of the ramps, below the 0.5 m/s² slew on board [m/s²].
const ACCELERATION: f64 = 0.3;
/// Corners sharper than this are not rounded: the tangents would be very long [rad].
const ROUNDED_MAX: f64 = 2.4;
/// Mean turn of one quadrature panel [rad]: 8 nodes are exact to rounding there.
const PANEL_TURN: f64 = 0.3;
/// Corners flatter than this are none [rad].
const STRAIGHT_ON: f64 = 1e-9;
/// Turns tried on each side.
const TURNS_TRIED: usize = 500;
/// The largest of them [rad]: a full circle, and what its ramps add.
const TURN_MAX: f64 = 1.5 * TAU;
/// Gauss-Legendre, 8 nodes on (−1, 1): the positive nodes and their weights.
const GAUSS: [(f64, f64); 4] = [
    (0.183_434_642_495_649_8, 0.362_683_783_378_362),
    (0.525_532_409_916_329, 0.313_706_645_877_887_3),
    (0.796_666_477_413_626_7, 0.222_381_034_453_374_47),
    (0.960_289_856_497_536_3, 0.101_228_536_290_376_26),
];
