//! From a scenario that breaks a rule to a small one that breaks the same.

use sphere_ground::settings::PlannerSettings;
use sphere_protocol::robot::RobotId;

use super::broken;
use crate::metrics::Violation;
use crate::scenario::{Distributed, Link, Loss, RobotSetup, Scenario};

/// A smaller scenario.
type Step = Box<dyn Fn(&Scenario) -> Option<Scenario>>;

/// `scenario` without what `rule` does not need to break, and how it breaks it then.
///
/// Greedy: each thing is left out in turn and stays out if the rule still breaks, until nothing more can go.
pub fn shrink(scenario: &Scenario, rule: &str, found: &Violation) -> (Scenario, Violation) {
    let mut smallest = (scenario.clone(), found.clone());
    loop {
        let mut is_smaller = false;
        for step in steps(&smallest.0) {
            let Some(candidate) = step(&smallest.0).and_then(|s| settled(&s)) else {
                continue;
            };
            let breaks = broken(&candidate, rule == TWIN_RULE);
            if let Some(violation) = breaks.into_iter().find(|v| v.rule == rule) {
                smallest = (candidate, violation);
                is_smaller = true;
            }
        }
        if !is_smaller {
            return smallest;
        }
    }
}

/// Every way in which `scenario` may become smaller, the most at once first. A step that has nothing to do gives nothing.
fn steps(scenario: &Scenario) -> Vec<Step> {
    let mut steps: Vec<Step> = Vec::new();
    for setup in &scenario.robots {
        let id = setup.id;
        steps.push(Box::new(move |s| without_robot(s, id)));
    }
    // From the last one on: places before it stay what they are.
    for place in (0..scenario.faults.len()).rev() {
        steps.push(changed(move |s| {
            drop_at(&mut s.faults, place);
        }));
    }
    for place in (0..scenario.network.partition.len()).rev() {
        steps.push(changed(move |s| {
            drop_at(&mut s.network.partition, place);
        }));
    }
    steps.push(changed(|s| {
        s.network.up = Link::default();
        s.network.down = Link::default();
    }));
    let plain: [fn(&mut Link); 6] = [
        |l| l.loss = Loss::Independent(0.0),
        |l| l.duplicate = 0.0,
        |l| l.bandwidth_kbps = 0.0,
        |l| l.distribution = Distributed::Normal,
        |l| l.jitter_ms = 0.0,
        |l| l.delay_ms = 0.0,
    ];
    for plain in plain {
        steps.push(changed(move |s| plain(&mut s.network.up)));
        steps.push(changed(move |s| plain(&mut s.network.down)));
    }
    steps.push(changed(|s| s.planner = PlannerSettings::default()));
    steps.push(changed(|s| s.sensing.noise = 0.0));
    let plain: [fn(&mut RobotSetup); 9] = [
        |r| r.plant_scale.clear(),
        |r| r.clock_offset_s = 0.0,
        |r| r.clock_drift_ppm = 0.0,
        |r| r.disturbance.pushes.clear(),
        |r| r.disturbance.patches.clear(),
        |r| r.disturbance.slope_deg = [0.0; 2],
        |r| r.disturbance.random_nm = 0.0,
        |r| r.disturbance.stiction_nm = 0.0,
        |r| r.disturbance.imbalance_nm = 0.0,
    ];
    for plain in plain {
        for place in 0..scenario.robots.len() {
            // Robots that went before leave fewer places.
            steps.push(changed(move |s| {
                if let Some(setup) = s.robots.get_mut(place) {
                    plain(setup);
                }
            }));
        }
    }
    for share in [0.5, 0.75, 0.9] {
        steps.push(changed(move |s| {
            s.duration_s = (share * s.duration_s).ceil();
        }));
    }
    steps
}

/// Robots that went before may have taken what was at `place` with them.
fn drop_at<T>(items: &mut Vec<T>, place: usize) {
    if place < items.len() {
        items.remove(place);
    }
}

/// A step that does `change`, if it changes anything and what it names is still there.
fn changed(change: impl Fn(&mut Scenario) + 'static) -> Step {
    Box::new(move |scenario| {
        let mut smaller = scenario.clone();
        change(&mut smaller);
        (smaller != *scenario).then_some(smaller)
    })
}

fn without_robot(scenario: &Scenario, id: RobotId) -> Option<Scenario> {
    let mut smaller = scenario.clone();
    smaller.robots.retain(|setup| setup.id != id);
    if smaller.robots.is_empty() {
        return None;
    }
    // A fault of this robot alone goes with it: without names it would be everybody's.
    smaller
        .faults
        .retain_mut(|fault| left(&mut fault.robots, id));
    let cuts = &mut smaller.network.partition;
    cuts.retain_mut(|cut| left(&mut cut.robots, id));
    Some(smaller)
}

/// Whether somebody is concerned still.
fn left(robots: &mut Vec<RobotId>, id: RobotId) -> bool {
    let were_named = !robots.is_empty();
    robots.retain(|robot| *robot != id);
    !were_named || !robots.is_empty()
}

/// As its own file reads back: with the true parameters that follow from what was changed.
fn settled(scenario: &Scenario) -> Option<Scenario> {
    let no_files = |path: &str| Err(format!("no file {path}"));
    Scenario::parse("smaller", &scenario.drawn(), &[], no_files).ok()
}

/// The rule that a second run decides.
const TWIN_RULE: &str = "faults-stay-confined";
