//! The ground station: plans for every robot with model predictive control, and everything around the plans.
//!
//! It knows robots only by their messages. It computes no torque and simulates nothing.
//!
//! ```text
//!               ┌──────────────────────── station::Station ────────────────────────┐
//!  telemetry ──►│ session::Session, one a robot, every 100 ms:                      │
//!               │   link ─► when a plan will have arrived, in the robot's clock     │
//!               │   predictor ─► where the robot will be then                       │
//!               │   tasking, trajectory ─► where it should be from then on          │──► plans
//!               │   planner, mpc ─► twenty knots with feedback gains                │
//!  orders ─────►│   lease ─► claim, arm, hold, disarm                               │──► commands
//!               └───────────────────────────────────────────────────────────────────┘
//! ```
//!
//! One tick of the planner, for a robot at rest half a metre from a line that it is to follow at 0.5 m/s:
//!
//! ```
//! use sphere_ground::planner::{Beginning, Planner};
//! use sphere_ground::settings::PlannerSettings;
//! use sphere_ground::trajectory::{Mission, Pose, Trajectory};
//! use sphere_protocol::robot::Robot;
//!
//! let robot = Robot::embedded("liu").expect("comes with the project");
//! let line = Trajectory::new(&Mission::Line, &robot, Pose::default())?;
//! let mut planner = Planner::new(&robot, &PlannerSettings::default());
//! let beginning = Beginning { x: [0.0, 1.5, 0.0, 0.0, 0.0].into(), measured: [0.0, 0.0], shift: 0 };
//!
//! let knots = planner.plan(&beginning, |t| line.reference(t)).expect("it is feasible");
//! assert!(knots.is_optimal);
//! assert_eq!((knots.u.len(), knots.x.len(), knots.k.len()), (20, 21, 20));
//! let [v_c, q_c] = knots.u[0];
//! assert!(v_c > 0.0 && q_c > 0.0, "forward, and leaning left towards the line");
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! In reading order: [`station`], [`session`], [`tasking`], [`workload`]; [`link`] and [`predictor`]; [`trajectory`] on [`jet`]; [`planner`] and its
//! [`settings`]; [`kinematics`] and [`mpc`]; [`plan_command`], [`run`].

pub mod config_file;
pub mod jet;
pub mod kinematics;
pub mod link;
pub mod mpc;
pub mod plan_command;
pub mod planner;
pub mod predictor;
#[cfg(feature = "io")]
pub mod run;
pub mod session;
pub mod settings;
pub mod station;
pub mod tasking;
pub mod trajectory;
pub mod workload;
