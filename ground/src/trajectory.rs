//! Reference trajectories: where a robot is to be at each time of its mission, with the speed and roll that take it there.
//!
//! Every reference obeys eq (1) *exactly* (the module `flat` says how), with derivatives from Taylor series: a planner fed
//! inconsistent references fights them for ever, and differenced ones shake the robot.
//!
//! A new trajectory is one variant of [`Mission`], one of [`Trajectory`], and its path.

mod flat;
mod mission;
mod program;
mod waypoints;

use sphere_protocol::robot::Robot;

use crate::jet::Jet;
use flat::{along_centre, motion_along_centre, state_along_centre};
pub use mission::{Mission, MissionError};
pub use program::{Program, Step};
pub use waypoints::Waypoints;

/// A pose of the sphere's centre in the world.
#[derive(Clone, Copy, Debug, PartialEq, Default)]
pub struct Pose {
    /// World X [m].
    pub x: f64,
    /// World Y [m].
    pub y: f64,
    /// Yaw φ, positive to the left [rad].
    pub heading: f64,
}

/// The reference at one time: the pose of the centre and what the robot does there.
#[derive(Clone, Copy, Debug, PartialEq, Default)]
pub struct ReferencePoint {
    /// World X of the centre [m].
    pub x: f64,
    /// World Y of the centre [m].
    pub y: f64,
    /// Yaw φ, continuous along the trajectory [rad].
    pub heading: f64,
    /// Speed v [m/s].
    pub v: f64,
    /// Roll q_r [rad].
    pub q_r: f64,
    /// v̇ [m/s²].
    pub v_rate: f64,
    /// q̇_r [rad/s].
    pub q_r_rate: f64,
}

/// What the robot does at one time of a reference, wherever it is.
#[derive(Clone, Copy, Debug, PartialEq, Default)]
pub struct Motion {
    /// Speed v [m/s].
    pub v: f64,
    /// Roll q_r [rad].
    pub q_r: f64,
    /// v̇ [m/s²].
    pub v_rate: f64,
    /// q̇_r [rad/s].
    pub q_r_rate: f64,
}

/// What a plan follows, a function of the time since the plan's start [s]. A closure is one.
pub trait Reference {
    /// All of it at `t` [s].
    fn point(&self, t: f64) -> ReferencePoint;

    /// Pose, speed and roll: x, y [m], heading [rad], v [m/s], q_r [rad]; those of [`Reference::point`].
    fn state(&self, t: f64) -> [f64; 5] {
        self.point(t).state()
    }

    /// Speed, roll and their rates; those of [`Reference::point`].
    fn motion(&self, t: f64) -> Motion {
        self.point(t).motion()
    }
}

impl<F: Fn(f64) -> ReferencePoint> Reference for F {
    fn point(&self, t: f64) -> ReferencePoint {
        self(t)
    }
}

/// A trajectory from some time of its mission on.
#[derive(Clone, Copy, Debug)]
pub struct Along<'a> {
    /// The mission's.
    pub trajectory: &'a Trajectory,
    /// Time of the mission when the plan begins [s].
    pub from: f64,
}

impl Reference for Along<'_> {
    fn point(&self, t: f64) -> ReferencePoint {
        self.trajectory.reference(self.from + t)
    }

    fn state(&self, t: f64) -> [f64; 5] {
        self.trajectory.state(self.from + t)
    }

    fn motion(&self, t: f64) -> Motion {
        self.trajectory.motion(self.from + t)
    }
}

/// A mission made ready for one robot: a function of time.
#[derive(Clone, Debug)]
pub enum Trajectory {
    /// X = 0.5 t, Y = 2; never ends.
    Line,
    /// X = 0.5 t, Y = 2 sin(0.25 t); never ends.
    Sine {
        /// Radius of the sphere [m].
        r: f64,
    },
    /// X = 8 sin(t/16), Y = 4 sin(t/8); repeats after 32π s.
    Lemniscate {
        /// Radius of the sphere [m].
        r: f64,
    },
    /// About the world's origin, counter-clockwise from (radius, 0); repeats.
    Circle {
        /// Radius of the circle [m].
        radius: f64,
        /// Speed of the centre [m/s].
        speed: f64,
        /// Roll of the steady turn [rad].
        q_r: f64,
    },
    /// From point to point and then at rest.
    Waypoints(Waypoints),
    /// Typed commands; where they lead is where they lead.
    Program {
        /// Speed and roll by the clock.
        program: Program,
        /// Where the robot was when they began.
        begin: Pose,
    },
    /// At rest at one pose.
    Hold(Pose),
}

impl Trajectory {
    /// The trajectory of `mission` for `robot`, which stands at `here` when it begins (only [`Mission::Hold`] asks).
    ///
    /// # Errors
    /// A circle or a waypoint speed that is beyond the robot's limits; waypoints that are no way.
    pub fn new(mission: &Mission, robot: &Robot, here: Pose) -> Result<Self, MissionError> {
        let (r, limits) = (robot.params.r, &robot.limits);
        Ok(match mission {
            Mission::Line => Self::Line,
            Mission::Sine => Self::Sine { r },
            Mission::Lemniscate => Self::Lemniscate { r },
            Mission::Circle {
                radius_m,
                speed_mps,
            } => {
                let q_r = (r / radius_m).atan();
                if *speed_mps > limits.v_max {
                    return Err(MissionError::TooFast {
                        speed_mps: *speed_mps,
                        v_max: limits.v_max,
                    });
                }
                let tan_max = limits
                    .q_r_max
                    .tan()
                    .min(limits.turn_limit(&robot.params) / (speed_mps * speed_mps));
                if q_r.tan() > tan_max {
                    return Err(MissionError::TooTight {
                        radius_m: *radius_m,
                        radius_min: r / tan_max,
                    });
                }
                Self::Circle {
                    radius: *radius_m,
                    speed: *speed_mps,
                    q_r,
                }
            }
            Mission::Waypoints {
                points_m,
                speed_mps,
            } => {
                // Built by hand rather than read, it may hold anything, and no way leads through that.
                mission.clone().validated()?;
                Self::Waypoints(Waypoints::new(points_m, *speed_mps, robot)?)
            }
            Mission::Roll {
                speed_mps,
                angles_deg,
                hold_s,
            } => {
                mission.clone().validated()?;
                let program = Program::Steps {
                    speed: *speed_mps,
                    angles: angles_deg.iter().map(|angle| angle.to_radians()).collect(),
                    hold: *hold_s,
                };
                Self::Program {
                    program: program.within_limits(robot)?,
                    begin: here,
                }
            }
            Mission::RollSine {
                speed_mps,
                amplitude_deg,
                rate_radps,
                phase_rad,
            } => {
                mission.clone().validated()?;
                let program = Program::Sine {
                    speed: *speed_mps,
                    amplitude: amplitude_deg.to_radians(),
                    rate: *rate_radps,
                    phase: *phase_rad,
                };
                Self::Program {
                    program: program.within_limits(robot)?,
                    begin: here,
                }
            }
            Mission::Hold => Self::Hold(here),
        })
    }

    /// The reference `t` seconds after the mission's start. Before the start it is the start's pose at rest for waypoints, and the
    /// path extended backwards for the others.
    pub fn reference(&self, t: f64) -> ReferencePoint {
        match self {
            Self::Line => ReferencePoint {
                x: 0.5 * t,
                y: 2.0,
                heading: 0.0,
                v: 0.5,
                q_r: 0.0,
                v_rate: 0.0,
                q_r_rate: 0.0,
            },
            Self::Sine { r } => {
                let (x, y) = self.path(t);
                along_centre(x, y, *r, 0.0)
            }
            // The tangent swings between 45° and −225°: the paper's formula for it is 0/0 at cos(t/16) = 0 and jumps (E16).
            Self::Lemniscate { r } => {
                let (x, y) = self.path(t);
                along_centre(x, y, *r, LEMNISCATE_BRANCH)
            }
            Self::Circle { radius, speed, q_r } => {
                let angle = speed / radius * t;
                let (sin, cos) = angle.sin_cos();
                ReferencePoint {
                    x: radius * cos,
                    y: radius * sin,
                    heading: angle + core::f64::consts::FRAC_PI_2,
                    v: *speed,
                    q_r: *q_r,
                    v_rate: 0.0,
                    q_r_rate: 0.0,
                }
            }
            Self::Waypoints(waypoints) => waypoints.reference(t),
            Self::Program { program, begin } => {
                let [v, q_r] = program.command(t);
                ReferencePoint {
                    v,
                    q_r,
                    ..ReferencePoint::at_rest(*begin)
                }
            }
            Self::Hold(pose) => ReferencePoint::at_rest(*pose),
        }
    }

    /// Pose, speed and roll of [`Self::reference`], the same bits: x, y [m], heading [rad], v [m/s], q_r [rad].
    ///
    /// A series without the orders that the rates need costs less.
    pub fn state(&self, t: f64) -> [f64; 5] {
        match self {
            Self::Sine { r } => {
                let (x, y) = self.path(t);
                state_along_centre(x, y, *r, 0.0)
            }
            Self::Lemniscate { r } => {
                let (x, y) = self.path(t);
                state_along_centre(x, y, *r, LEMNISCATE_BRANCH)
            }
            Self::Waypoints(waypoints) => waypoints.state(t),
            _ => self.reference(t).state(),
        }
    }

    /// Speed, roll and their rates of [`Self::reference`], the same bits: what commands are made of.
    pub fn motion(&self, t: f64) -> Motion {
        match self {
            Self::Sine { r } | Self::Lemniscate { r } => {
                let (x, y) = self.path(t);
                motion_along_centre(x, y, *r)
            }
            Self::Circle { speed, q_r, .. } => Motion {
                v: *speed,
                q_r: *q_r,
                ..Motion::default()
            },
            Self::Waypoints(waypoints) => waypoints.motion(t),
            _ => self.reference(t).motion(),
        }
    }

    /// The typed commands, if that is what it is: then the pose of its reference means nothing.
    pub fn program(&self) -> Option<&Program> {
        match self {
            Self::Program { program, .. } => Some(program),
            _ => None,
        }
    }

    /// The path as the mission states it [m]. [`Self::reference`] is its drivable form, the same point except for the sine (1.6 mm rms
    /// and 5 mm at most beside it, with R = 0.35 m) and the lemniscate (1.8 and 7 mm).
    pub fn nominal(&self, t: f64) -> [f64; 2] {
        match self {
            Self::Sine { .. } | Self::Lemniscate { .. } => {
                let (x, y) = self.path::<2>(t);
                [x.value(), y.value()]
            }
            _ => {
                let point = self.reference(t);
                [point.x, point.y]
            }
        }
    }

    /// When the mission is over: at rest from then on; `None` = never [s].
    pub fn duration(&self) -> Option<f64> {
        match self {
            Self::Waypoints(waypoints) => Some(waypoints.duration()),
            Self::Program { program, .. } => program.duration(),
            Self::Hold(_) => Some(0.0),
            _ => None,
        }
    }

    /// The centre's path with its derivatives (sine and lemniscate) [m].
    fn path<const N: usize>(&self, t: f64) -> (Jet<N>, Jet<N>) {
        let sine = |amplitude: f64, rate: f64| Jet::sine(rate * t, rate) * amplitude;
        match self {
            Self::Lemniscate { .. } => (sine(8.0, 1.0 / 16.0), sine(4.0, 1.0 / 8.0)),
            _ => (Jet::line(0.5 * t, 0.5), sine(2.0, 0.25)),
        }
    }
}

impl ReferencePoint {
    /// At rest at `pose`.
    pub fn at_rest(pose: Pose) -> Self {
        Self {
            x: pose.x,
            y: pose.y,
            heading: pose.heading,
            v: 0.0,
            q_r: 0.0,
            v_rate: 0.0,
            q_r_rate: 0.0,
        }
    }

    /// The commands (v_c [m/s], q_c [rad]) that make a robot with reference lag `tau` [s] follow: see [`Motion::command`].
    pub fn command(&self, tau: f64) -> [f64; 2] {
        self.motion().command(tau)
    }

    /// x, y [m], heading [rad], v [m/s], q_r [rad].
    pub fn state(&self) -> [f64; 5] {
        [self.x, self.y, self.heading, self.v, self.q_r]
    }

    /// What the robot does there.
    pub fn motion(&self) -> Motion {
        Motion {
            v: self.v,
            q_r: self.q_r,
            v_rate: self.v_rate,
            q_r_rate: self.q_r_rate,
        }
    }

    /// At the same pose with another motion.
    fn moving(self, motion: Motion) -> Self {
        let Motion {
            v,
            q_r,
            v_rate,
            q_r_rate,
        } = motion;
        Self {
            v,
            q_r,
            v_rate,
            q_r_rate,
            ..self
        }
    }
}

impl Motion {
    /// The commands (v_c [m/s], q_c [rad]) that make a robot with reference lag `tau` [s] follow: u = ref + τ · derivative.
    pub fn command(&self, tau: f64) -> [f64; 2] {
        [self.v + tau * self.v_rate, self.q_r + tau * self.q_r_rate]
    }

    fn of(v: Jet<2>, q_r: Jet<2>) -> Self {
        Self {
            v: v.value(),
            q_r: q_r.value(),
            v_rate: v.rate(),
            q_r_rate: q_r.rate(),
        }
    }
}

/// Within π of it the lemniscate's tangent swings [rad].
const LEMNISCATE_BRANCH: f64 = -core::f64::consts::FRAC_PI_2;
