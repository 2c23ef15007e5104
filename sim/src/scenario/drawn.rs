//! A scenario as TOML with every default written out.

use core::fmt::Write;

use super::{Disturbance, Fault, Link, Loss, Partition, RobotSetup, Scenario};
use sphere_ground::trajectory::Mission;
use sphere_protocol::document::node::{number, quoted};
use sphere_protocol::document::table::Named;
use sphere_protocol::robot::RobotId;

/// Keys with their values, in the order in which they are written.
type Lines = Vec<(&'static str, String)>;

/// The whole file.
pub(super) fn scenario(scenario: &Scenario) -> String {
    let Scenario {
        seed,
        duration_s,
        environment,
        network,
        faults,
        sensing,
        metrics,
        planner,
        station,
        robots,
    } = scenario;
    let mut text = String::from(
        "# As drawn: every default is written out, and `sphere-sim run` replays the run byte for byte.\n",
    );
    write_lines(
        &mut text,
        &vec![
            ("seed", seed.to_string()),
            ("duration_s", number(*duration_s)),
            ("environment", quoted(environment.name())),
        ],
    );
    // What both directions share stays where one `--set network.KEY` reaches it.
    let (up, down) = (link(&network.up), link(&network.down));
    let (mut both, up): (Lines, Lines) = up.into_iter().partition(|line| down.contains(line));
    let down = down
        .into_iter()
        .filter(|line| !both.contains(line))
        .collect();
    both.push(("partition", list(&network.partition, partition)));
    write_table(&mut text, "[network]", &both);
    for (header, lines) in [("[network.up]", up), ("[network.down]", down)] {
        if !lines.is_empty() {
            write_table(&mut text, header, &lines);
        }
    }
    for fault in faults {
        write_table(&mut text, "[[faults]]", &fault_lines(fault));
    }
    write_table(
        &mut text,
        "[sensing]",
        &vec![
            ("noise", number(sensing.noise)),
            ("position_fix_hz", number(sensing.position_fix_hz)),
            ("position_fix_noise_m", number(sensing.position_fix_noise_m)),
        ],
    );
    write_table(
        &mut text,
        "[metrics]",
        &vec![("settle_s", number(metrics.settle_s))],
    );
    write_table(
        &mut text,
        "[planner]",
        &vec![
            ("preset", quoted(planner.preset.name())),
            ("mode", quoted(planner.mode.name())),
            ("horizon", planner.horizon.to_string()),
            ("max_age_s", number(planner.max_age.as_secs_f64())),
            ("compensation", quoted(planner.compensation.name())),
            ("solver", quoted(planner.solver.name())),
        ],
    );
    write_table(
        &mut text,
        "[station]",
        &vec![("plan_time_us", number(station.plan_time_us))],
    );
    for setup in robots {
        write_table(&mut text, "[[robots]]", &robot(setup));
    }
    text
}

fn link(link: &Link) -> Lines {
    let loss = match link.loss {
        Loss::Independent(loss) => ("loss", number(loss)),
        Loss::Burst {
            mean_bad_s,
            mean_good_s,
            loss_bad,
        } => (
            "burst",
            inline(&[
                ("mean_bad_s", number(mean_bad_s)),
                ("mean_good_s", number(mean_good_s)),
                ("loss_bad", number(loss_bad)),
            ]),
        ),
    };
    vec![
        ("delay_ms", number(link.delay_ms)),
        ("jitter_ms", number(link.jitter_ms)),
        ("distribution", quoted(link.distribution.name())),
        loss,
        ("duplicate", number(link.duplicate)),
        ("bandwidth_kbps", number(link.bandwidth_kbps)),
        ("queue_ms", number(link.queue_ms)),
    ]
}

fn partition(partition: &Partition) -> String {
    inline(&[
        ("from_s", number(partition.from_s)),
        ("to_s", number(partition.to_s)),
        ("robots", list(&partition.robots, id)),
    ])
}

fn fault_lines(fault: &Fault) -> Lines {
    vec![
        ("kind", quoted(fault.kind.name())),
        ("at_s", number(fault.at_s)),
        ("for_s", number(fault.for_s)),
        ("robots", list(&fault.robots, id)),
    ]
}

fn robot(setup: &RobotSetup) -> Lines {
    let scale: Vec<_> = setup
        .plant_scale
        .iter()
        .map(|(key, factor)| (key.as_str(), number(*factor)))
        .collect();
    vec![
        ("id", id(&setup.id)),
        ("robot", quoted(&setup.model.reference)),
        ("plant", inline(&[("scale", inline(&scale))])),
        (
            "start",
            inline(&[
                ("x_m", number(setup.start.x_m)),
                ("y_m", number(setup.start.y_m)),
                ("heading_deg", number(setup.start.heading_deg)),
            ]),
        ),
        ("clock_offset_s", number(setup.clock_offset_s)),
        ("clock_drift_ppm", number(setup.clock_drift_ppm)),
        ("telemetry_ms", setup.telemetry_ms.to_string()),
        ("roll_controller", quoted(setup.roll_controller.name())),
        ("disturbance", disturbance(&setup.disturbance)),
        ("mission", mission(&setup.mission)),
    ]
}

fn disturbance(disturbance: &Disturbance) -> String {
    inline(&[
        ("imbalance_nm", number(disturbance.imbalance_nm)),
        ("imbalance_harmonic", number(disturbance.imbalance_harmonic)),
        ("random_nm", number(disturbance.random_nm)),
        (
            "random_correlation_s",
            number(disturbance.random_correlation_s),
        ),
        ("stiction_nm", number(disturbance.stiction_nm)),
        ("slope_deg", pair(&disturbance.slope_deg)),
        (
            "patches",
            list(&disturbance.patches, |patch| {
                inline(&[
                    ("min_m", pair(&patch.min_m)),
                    ("max_m", pair(&patch.max_m)),
                    ("c_rr", number(patch.c_rr)),
                ])
            }),
        ),
        (
            "pushes",
            list(&disturbance.pushes, |push| {
                inline(&[
                    ("at_s", number(push.at_s)),
                    ("roll_nm", number(push.roll_nm)),
                    ("pitch_nm", number(push.pitch_nm)),
                    ("for_s", number(push.for_s)),
                ])
            }),
        ),
    ])
}

fn mission(mission: &Mission) -> String {
    let keys: Lines = match mission {
        Mission::Hold | Mission::Line | Mission::Sine | Mission::Lemniscate => vec![],
        Mission::Circle {
            radius_m,
            speed_mps,
        } => vec![
            ("radius_m", number(*radius_m)),
            ("speed_mps", number(*speed_mps)),
        ],
        Mission::Waypoints {
            points_m,
            speed_mps,
        } => vec![
            ("points_m", list(points_m, pair)),
            ("speed_mps", number(*speed_mps)),
        ],
        Mission::Roll {
            speed_mps,
            angles_deg,
            hold_s,
        } => vec![
            ("speed_mps", number(*speed_mps)),
            ("angles_deg", list(angles_deg, |angle| number(*angle))),
            ("hold_s", number(*hold_s)),
        ],
        Mission::RollSine {
            speed_mps,
            amplitude_deg,
            rate_radps,
            phase_rad,
        } => vec![
            ("speed_mps", number(*speed_mps)),
            ("amplitude_deg", number(*amplitude_deg)),
            ("rate_radps", number(*rate_radps)),
            ("phase_rad", number(*phase_rad)),
        ],
    };
    let kind = ("kind", quoted(mission.kind()));
    inline(&core::iter::once(kind).chain(keys).collect::<Vec<_>>())
}

fn id(id: &RobotId) -> String {
    quoted(id.as_str())
}

fn pair([x, y]: &[f64; 2]) -> String {
    format!("[{}, {}]", number(*x), number(*y))
}

fn list<T>(items: &[T], item: impl Fn(&T) -> String) -> String {
    format!(
        "[{}]",
        items.iter().map(item).collect::<Vec<_>>().join(", ")
    )
}

fn inline(entries: &[(&str, String)]) -> String {
    if entries.is_empty() {
        return "{}".to_owned();
    }
    let entries: Vec<_> = entries
        .iter()
        .map(|(key, value)| format!("{key} = {value}"))
        .collect();
    format!("{{ {} }}", entries.join(", "))
}

fn write_table(text: &mut String, header: &str, lines: &Lines) {
    writeln!(text, "\n{header}").expect("text grows");
    write_lines(text, lines);
}

fn write_lines(text: &mut String, lines: &Lines) {
    for (key, value) in lines {
        writeln!(text, "{key} = {value}").expect("text grows");
    }
}
