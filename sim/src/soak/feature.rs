//! What a scenario has in it, to see that the soak leaves nothing out.

use sphere_ground::settings::Compensation;
use sphere_ground::trajectory::Mission;

use crate::network::Distributed;
use crate::scenario::{Environment, FaultKind, Link, Loss, RobotSetup, RollController, Scenario};

/// A feature: its name, and whether a scenario has it.
pub type Feature = (&'static str, fn(&Scenario) -> bool);

/// Every feature whose share of the seeds is counted.
pub const FEATURES: &[Feature] = &[
    ("fault: station-crash", |s| {
        fault(s, FaultKind::StationCrash)
    }),
    ("fault: agent-crash", |s| fault(s, FaultKind::AgentCrash)),
    ("fault: freeze", |s| fault(s, FaultKind::Freeze)),
    ("fault: station-freeze", |s| {
        fault(s, FaultKind::StationFreeze)
    }),
    ("fault: replay", |s| fault(s, FaultKind::Replay)),
    ("fault: stale", |s| fault(s, FaultKind::Stale)),
    ("fault: slow-planner", |s| fault(s, FaultKind::SlowPlanner)),
    ("fault: one robot's alone", |s| {
        s.faults.iter().any(|fault| !fault.robots.is_empty())
            || s.network.partition.iter().any(|cut| !cut.robots.is_empty())
    }),
    ("fault: none", |s| s.faults.is_empty()),
    ("network: partition", |s| !s.network.partition.is_empty()),
    ("network: delay over 200 ms", |s| {
        link(s, |l| l.delay_ms > 200.0)
    }),
    ("network: jitter", |s| link(s, |l| l.jitter_ms > 0.0)),
    ("network: log-normal", |s| {
        link(s, |l| {
            l.distribution == Distributed::LogNormal && l.jitter_ms > 0.0
        })
    }),
    ("network: loss", |s| {
        link(
            s,
            |l| matches!(l.loss, Loss::Independent(loss) if loss > 0.0),
        )
    }),
    ("network: bursts", |s| {
        link(s, |l| matches!(l.loss, Loss::Burst { .. }))
    }),
    ("network: duplicates", |s| link(s, |l| l.duplicate > 0.0)),
    ("network: bandwidth", |s| {
        link(s, |l| l.bandwidth_kbps > 0.0)
    }),
    ("network: up and down differ", |s| {
        s.network.up != s.network.down
    }),
    ("environment: ideal", |s| {
        s.environment == Environment::Ideal
    }),
    ("environment: real", |s| s.environment == Environment::Real),
    ("environment: calibrated", |s| {
        s.environment == Environment::Calibrated
    }),
    ("sensing: dead reckoning", |s| {
        s.sensing.position_fix_hz == 0.0
    }),
    ("planner: no gains", |s| {
        s.planner.compensation == Compensation::NoGains
    }),
    ("mission: line", |s| mission(s, |m| *m == Mission::Line)),
    ("mission: sine", |s| mission(s, |m| *m == Mission::Sine)),
    ("mission: lemniscate", |s| {
        mission(s, |m| *m == Mission::Lemniscate)
    }),
    ("mission: circle", |s| {
        mission(s, |m| matches!(m, Mission::Circle { .. }))
    }),
    ("mission: waypoints", |s| {
        mission(s, |m| matches!(m, Mission::Waypoints { .. }))
    }),
    ("mission: roll", |s| {
        mission(s, |m| matches!(m, Mission::Roll { .. }))
    }),
    ("mission: roll-sine", |s| {
        mission(s, |m| matches!(m, Mission::RollSine { .. }))
    }),
    ("mission: hold", |s| mission(s, |m| *m == Mission::Hold)),
    ("controller: htsmc", |s| {
        controller(s, RollController::Htsmc)
    }),
    ("controller: htsmc-paper", |s| {
        controller(s, RollController::HtsmcPaper)
    }),
    ("controller: fuzzy-pid", |s| {
        controller(s, RollController::FuzzyPid)
    }),
    ("robot: parameters 20 % off", |s| {
        robot(s, |r| !r.plant_scale.is_empty())
    }),
    ("robot: clock offset", |s| {
        robot(s, |r| r.clock_offset_s != 0.0)
    }),
    ("robot: clock drift", |s| {
        robot(s, |r| r.clock_drift_ppm != 0.0)
    }),
    ("robot: random torque", |s| {
        robot(s, |r| r.disturbance.random_nm > 0.0)
    }),
    ("robot: stiction", |s| {
        robot(s, |r| r.disturbance.stiction_nm > 0.0)
    }),
    ("robot: slope", |s| {
        robot(s, |r| r.disturbance.slope_deg != [0.0; 2])
    }),
    ("robot: patch", |s| {
        robot(s, |r| !r.disturbance.patches.is_empty())
    }),
    ("robot: push", |s| {
        robot(s, |r| !r.disturbance.pushes.is_empty())
    }),
    ("fleet: more than four", |s| s.robots.len() > 4),
];

fn fault(scenario: &Scenario, kind: FaultKind) -> bool {
    scenario.faults.iter().any(|fault| fault.kind == kind)
}

fn link(scenario: &Scenario, has: fn(&Link) -> bool) -> bool {
    has(&scenario.network.up) || has(&scenario.network.down)
}

fn robot(scenario: &Scenario, has: fn(&RobotSetup) -> bool) -> bool {
    scenario.robots.iter().any(has)
}

fn mission(scenario: &Scenario, is: fn(&Mission) -> bool) -> bool {
    scenario.robots.iter().any(|setup| is(&setup.mission))
}

fn controller(scenario: &Scenario, kind: RollController) -> bool {
    (scenario.robots.iter()).any(|setup| setup.roll_controller == kind)
}
