//! The manoeuvre that identification asks for: commands (v_c, q_c) as data.
//!
//! Chosen by the intervals that the fit states for it: without any one of its parts none of them grows by more than a third, without
//! roll or without speed half of the parameters have none. It needs 5 m ahead, 1 m behind and 1.5 m to each side.

use core::f64::consts::TAU;

use sphere_protocol::robot::{Limits, RobotParams};

use crate::reference::roll_bound;

/// A sequence of parts, each some seconds long.
#[derive(Clone, Debug, PartialEq)]
pub struct Manoeuvre {
    /// Played one after the other.
    pub parts: Vec<Part>,
}

/// One part of a manoeuvre.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Part {
    /// What it is, as messages call it.
    pub name: &'static str,
    /// How long it lasts [s].
    pub duration: f64,
    /// Speed command [m/s].
    pub v: Shape,
    /// Roll command [rad].
    pub q_r: Shape,
}

/// A command over a part's time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Shape {
    /// The same throughout.
    Hold(f64),
    /// `mean` + `amplitude` for half a `period` [s], `mean` − `amplitude` for the other half, and so on.
    Steps {
        /// In the middle.
        mean: f64,
        /// To either side.
        amplitude: f64,
        /// Of both steps together [s].
        period: f64,
    },
    /// `amplitude` sin(2π t / `period`).
    Sine {
        /// Its largest value.
        amplitude: f64,
        /// [s].
        period: f64,
    },
}

impl Manoeuvre {
    /// The prescribed one.
    pub fn prescribed() -> Self {
        let hold = Shape::Hold;
        let steps = |mean: f64, amplitude: f64, period: f64| Shape::Steps {
            mean,
            amplitude,
            period,
        };
        let sine = |degrees: f64, period: f64| Shape::Sine {
            amplitude: degrees.to_radians(),
            period,
        };
        let roll = |degrees: f64, period: f64| steps(0.0, degrees.to_radians(), period);
        let part = |name, duration, v, q_r| Part {
            name,
            duration,
            v,
            q_r,
        };
        Self {
            parts: vec![
                part("rest", 1.0, hold(0.0), hold(0.0)),
                part("roll steps at rest", 7.2, hold(0.0), roll(8.0, 2.4)),
                part("roll sine at rest", 4.0, hold(0.0), sine(6.0, 1.0)),
                part("speed reversals", 9.6, steps(0.0, 0.3, 2.4), hold(0.0)),
                part("slow ahead", 4.0, hold(0.2), hold(0.0)),
                part("slow back", 4.0, hold(-0.2), hold(0.0)),
                part("fast ahead, roll sine", 6.0, hold(0.8), sine(7.0, 1.6)),
                part("fast back, roll steps", 7.2, hold(-0.5), roll(6.0, 2.4)),
                part("ahead, roll sine", 6.0, hold(0.4), sine(8.0, 1.2)),
                part("back", 5.0, hold(-0.4), hold(0.0)),
                part(
                    "reversals, leaning",
                    9.6,
                    steps(0.0, 0.3, 1.6),
                    sine(5.0, 3.2),
                ),
                part("rest", 2.0, hold(0.0), hold(0.0)),
            ],
        }
    }

    /// How long it lasts [s].
    pub fn duration(&self) -> f64 {
        self.parts.iter().map(|part| part.duration).sum()
    }

    /// The commands (v_c [m/s], q_c [rad]) `t` seconds after the beginning, within the robot's limits; zero after the end.
    pub fn command(&self, t: f64, params: &RobotParams, limits: &Limits) -> [f64; 2] {
        let Some((part, into)) = self.at(t) else {
            return [0.0; 2];
        };
        let v = part.v.at(into).clamp(limits.v_min, limits.v_max);
        let bound = roll_bound(v, params, limits);
        [v, part.q_r.at(into).clamp(-bound, bound)]
    }

    /// The part that is played at `t`, and the time since it began [s].
    pub fn at(&self, t: f64) -> Option<(&Part, f64)> {
        let mut into = t.max(0.0);
        for part in &self.parts {
            if into < part.duration {
                return Some((part, into));
            }
            into -= part.duration;
        }
        None
    }
}

impl Shape {
    /// The command `t` seconds into the part.
    pub fn at(&self, t: f64) -> f64 {
        match *self {
            Self::Hold(value) => value,
            Self::Steps {
                mean,
                amplitude,
                period,
            } => {
                let first_half = (t / period).fract() < 0.5;
                mean + if first_half { amplitude } else { -amplitude }
            }
            Self::Sine { amplitude, period } => amplitude * (TAU * t / period).sin(),
        }
    }
}
