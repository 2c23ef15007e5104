//! From a scenario to the configurations of station, agents, bodies and links.

use rand_distr::{Distribution, StandardUniform};
use sphere_agent::config::{AgentConfig, Timing};
use sphere_agent::control::DirectionChoice;
use sphere_agent::estimator::{EstimatorConfig, StartPose};
use sphere_ground::station::{RobotConfig, StationConfig};
use sphere_ground::tasking::StartCondition;
use sphere_ground::trajectory::{ReferencePoint, Trajectory};
use sphere_protocol::robot::RobotId;
use sphere_protocol::time::Span;

use super::CLOCK_SPREAD;
use crate::body::{BodySetup, Purpose, stream};
use crate::clock::SimClock;
use crate::disturbance::{Disturbance, Push, RandomTorque};
use crate::network::{Bottleneck, Burst, Impairments, LinkModel};
use crate::scenario::{self, Loss, RobotSetup, RollController, Scenario};
use crate::trace::Reference;

/// Delay and independent loss of one direction.
pub(crate) fn link_model(link: &scenario::Link) -> LinkModel {
    LinkModel {
        delay: link.delay().as_secs_f64(),
        jitter: link.jitter().as_secs_f64(),
        loss: match link.loss {
            Loss::Independent(loss) => loss,
            Loss::Burst { .. } => 0.0,
        },
    }
}

/// What else befalls the packets of `robot` in one direction.
pub(super) fn impairments(
    link: &scenario::Link,
    partitions: &[scenario::Partition],
    robot: RobotId,
) -> Impairments {
    let cuts = partitions
        .iter()
        .filter(|cut| cut.robots.is_empty() || cut.robots.contains(&robot))
        .map(|cut| {
            (
                Span::from_secs_f64(cut.from_s),
                Span::from_secs_f64(cut.to_s),
            )
        })
        .collect();
    Impairments {
        distribution: link.distribution,
        burst: match link.loss {
            Loss::Independent(_) => None,
            Loss::Burst {
                mean_bad_s,
                mean_good_s,
                loss_bad,
            } => Some(Burst {
                mean_bad: mean_bad_s,
                mean_good: mean_good_s,
                loss_bad,
            }),
        },
        duplicate: link.duplicate,
        bottleneck: (link.bandwidth_kbps > 0.0).then_some(Bottleneck {
            rate: 1e3 * link.bandwidth_kbps,
            queue: 1e-3 * link.queue_ms,
        }),
        cuts,
    }
}

/// What `trajectory` asks for `t` seconds after its start, for the trace.
pub(crate) fn reference(trajectory: &Trajectory, t: f64) -> Reference {
    let point = trajectory.reference(t);
    if trajectory.program().is_some() {
        return Reference {
            pose: None,
            v: point.v,
            q_r: point.q_r,
        };
    }
    // Errors count from the path as the mission states it, not from the planner's drivable form of it.
    let [x, y] = trajectory.nominal(t);
    Reference::from(ReferencePoint { x, y, ..point })
}

/// The station of `scenario`, under the identity `station`.
pub(crate) fn station_config(scenario: &Scenario, station: u64) -> StationConfig {
    StationConfig {
        station,
        planner: scenario.planner,
        robots: scenario
            .robots
            .iter()
            .map(|setup| RobotConfig {
                id: setup.id,
                robot: setup.model.robot.clone(),
                mission: setup.mission.clone(),
                start: StartCondition::Ready,
            })
            .collect(),
    }
}

/// The agent of one robot of a scenario, in its life `boot_id`.
pub(crate) fn agent_config(setup: &RobotSetup, boot_id: u64) -> AgentConfig {
    AgentConfig {
        id: setup.id,
        robot: setup.model.robot.clone(),
        boot_id,
        estimator: EstimatorConfig {
            start: StartPose {
                x: setup.start.x_m,
                y: setup.start.y_m,
                heading: setup.start.heading(),
                ..StartPose::default()
            },
            ..Default::default()
        },
        direction: match setup.roll_controller {
            RollController::Htsmc => DirectionChoice::Htsmc,
            RollController::HtsmcPaper => DirectionChoice::HtsmcPaper,
            RollController::FuzzyPid => DirectionChoice::FuzzyPid,
            RollController::FuzzyPidSingle => DirectionChoice::FuzzyPidSingle,
        },
        timing: Timing {
            telemetry: Span::from_millis(setup.telemetry_ms),
            ..Timing::default()
        },
    }
}

/// The body of one robot of `scenario`, whose board's clock shows `clock_offset` at time zero.
pub(crate) fn body_setup(scenario: &Scenario, setup: &RobotSetup, clock_offset: Span) -> BodySetup {
    let sensing = &scenario.sensing;
    BodySetup {
        params: setup.plant,
        start: [setup.start.x_m, setup.start.y_m, setup.start.heading()],
        disturbance: disturbance(&setup.disturbance),
        noise: sensing.noise,
        fix_sigma: sensing.position_fix_sigma(),
        clock: SimClock::new(clock_offset, setup.clock_drift_ppm),
    }
}

/// Boot id of the agent and origin of the board's clock of robot number `robot` under `seed`.
pub(crate) fn drawn_clocks(seed: u64, robot: usize) -> (u64, Span) {
    let mut random = stream(seed, robot, Purpose::Clocks);
    let mut draw = || -> f64 { StandardUniform.sample(&mut random) };
    let boot_id = 1 + (draw() * 9e15) as u64;
    (boot_id, Span::from_secs_f64(draw() * CLOCK_SPREAD))
}

fn disturbance(setup: &scenario::Disturbance) -> Disturbance {
    Disturbance {
        imbalance: setup.imbalance_nm,
        imbalance_harmonic: setup.imbalance_harmonic,
        random: RandomTorque {
            sigma: setup.random_nm,
            correlation: setup.random_correlation_s,
        },
        stiction: setup.stiction_nm,
        slope: setup.slope_deg.map(|degrees| degrees.to_radians().tan()),
        patches: setup.patches.clone(),
        pushes: setup
            .pushes
            .iter()
            .map(|push| Push {
                roll_nm: push.roll_nm,
                pitch_nm: push.pitch_nm,
                at_s: push.at_s,
                for_s: push.for_s,
            })
            .collect(),
    }
}
