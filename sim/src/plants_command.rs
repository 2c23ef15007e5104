//! `sphere-sim plants`: plants in real time behind MAVLink, for agents that run elsewhere on this machine.

use std::fmt::Write as _;
use std::net::SocketAddr;
use std::time::Duration;

use sphere_protocol::io::link::UdpLink;
use sphere_protocol::robot::RobotId;
use thiserror::Error;

use crate::live::{Mirror, Pace, PlantSetup, Plants, PlantsError, Ports, plant_setup};
use crate::scenario::{Scenario, ScenarioError};

/// Plants, and where their agents reach them.
pub struct Served {
    /// The plants.
    pub plants: Plants,
    /// One a robot.
    pub addresses: Vec<Addresses>,
}

/// Both ends of one motor link, and where the robot stands at first: what its agent has to be told.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Addresses {
    /// Which robot.
    pub robot: RobotId,
    /// Where its agent has to listen.
    pub agent: SocketAddr,
    /// Where its board listens.
    pub board: SocketAddr,
    /// x, y [m], heading [°].
    pub start: [f64; 3],
}

/// Why plants could not be served.
#[derive(Debug, Error)]
pub enum ServeError {
    /// More robots than ports.
    #[error(
        "{robots} robots need {robots} ports each from {} and {} on: choose lower --agent-port and --board-port", .ports.agent, .ports.board
    )]
    Ports {
        /// How many robots.
        robots: usize,
        /// The first ports.
        ports: Ports,
    },
    /// The mirror's socket.
    #[error("cannot mirror the motor links: {0}")]
    Mirror(std::io::Error),
    /// A motor link, or the thread.
    #[error(transparent)]
    Plants(#[from] PlantsError),
}

/// Robots r1, r2, ... in the real environment, 3 m apart along Y and looking along X.
///
/// # Errors
/// No robot at all.
pub fn row_of_robots(count: usize, seed: u64) -> Result<Scenario, ScenarioError> {
    let mut text = format!("seed = {seed}\n");
    for robot in 0..count {
        let y = ROW_SPACING_M * robot as f64;
        // Writing to a String cannot fail.
        let _ = write!(
            text,
            "[[robots]]\nid = \"r{}\"\nstart = {{ y_m = {y:.1} }}\n",
            robot + 1
        );
    }
    let no_files = |file: &str| Err(format!("no file {file}"));
    Scenario::parse("plants", &text, &[], no_files)
}

/// Starts the plants of `scenario` behind the sockets of `ports`; copies of their motor links go to `mirror` and the ports after it.
///
/// # Errors
/// A port that is taken; too many robots for the ports.
pub fn serve(
    scenario: &Scenario,
    ports: Ports,
    mirror: Option<SocketAddr>,
) -> Result<Served, ServeError> {
    let robots = scenario.robots.len();
    let mut addresses = Vec::new();
    let mut setups = Vec::new();
    for (index, setup) in scenario.robots.iter().enumerate() {
        let (Some(agent), Some(board)) = (ports.agent(index), ports.board(index)) else {
            return Err(ServeError::Ports { robots, ports });
        };
        let link = UdpLink::open(board, agent).map_err(PlantsError::Link)?;
        let mirror = mirror
            .map(|first| Mirror::new(first, index))
            .transpose()
            .map_err(ServeError::Mirror)?;
        setups.push(PlantSetup {
            mirror,
            ..plant_setup(scenario, index, link)
        });
        addresses.push(Addresses {
            robot: setup.id,
            agent,
            board,
            start: [setup.start.x_m, setup.start.y_m, setup.start.heading_deg],
        });
    }
    Ok(Served {
        plants: Plants::start(setups)?,
        addresses,
    })
}

impl Served {
    /// What a user has to know to connect agents: a table of the addresses.
    pub fn table(&self) -> String {
        let mut text = String::from(
            "robot  agent listens on  board listens on  start x m    y m  heading °\n",
        );
        for at in &self.addresses {
            let [x, y, heading] = at.start;
            // Writing to a String cannot fail.
            let _ = writeln!(
                text,
                "{:<5}  {:<16}  {:<16}  {x:>9.2}  {y:>5.2}  {heading:>9.1}",
                at.robot.as_str(),
                at.agent.to_string(),
                at.board.to_string(),
            );
        }
        text
    }
}

/// One sentence about how well the plants kept to real time.
pub fn pace_sentence(pace: Pace) -> String {
    let Pace {
        steps,
        late,
        lateness_max,
    } = pace;
    let time = Duration::from_millis(steps).as_secs_f64();
    format!(
        "{time:.1} s of plant time in steps of 1 ms: {late} began more than 1 ms late and were made up for, the latest {:.1} ms.",
        lateness_max.as_secs_f64() * 1e3
    )
}

const ROW_SPACING_M: f64 = 3.0;
