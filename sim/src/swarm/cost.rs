//! From measured costs to fleets that fit on no machine here: straight lines through the runs that held.

use core::fmt::Write as _;

use super::SwarmReport;

/// Processor time of one planning tick of one robot in the solver [µs]: an assumed ceiling, the one number here that is not
/// taken from the runs.
pub const PLANNING_US: f64 = 20.0;
/// Planning ticks of a robot [1/s].
const PLANNING_HZ: f64 = 10.0;
/// Sessions that one Zenoh router takes by default (`transport/unicast/max_sessions`).
const SESSIONS: f64 = 1000.0;
/// A core is planned to be busy for no more than this.
const BUSY: f64 = 0.6;
/// Fleets computed.
const FLEETS: [u64; 4] = [100, 1_000, 10_000, 1_000_000];

/// What one robot costs the ground: by a line through the runs.
struct Costs {
    /// The station's planning thread [cores].
    planning: f64,
    /// The station's process without it: Zenoh, router and session [cores].
    network: f64,
    /// Memory of the station's process [bytes].
    memory: f64,
    /// On its connection, both ways [bytes/s].
    wire: f64,
    /// Messages, both ways [1/s].
    messages: f64,
}

/// Needs of fleets of 100 to 1 000 000 robots in Markdown; an error if the runs that held are of fewer than two sizes.
///
/// # Errors
/// A sentence that says what is missing.
pub fn computed(reports: &[SwarmReport]) -> Result<String, String> {
    let held: Vec<_> = reports
        .iter()
        .filter(|report| report.held() && report.socket.is_some())
        .collect();
    let few = held.iter().min_by_key(|report| report.robots);
    let many = held.iter().max_by_key(|report| report.robots);
    let (Some(few), Some(many)) = (few, many) else {
        return Err("no run with a delay held: nothing to compute from".to_owned());
    };
    if few.robots == many.robots {
        return Err(format!(
            "runs that held have {} robots only: add one of another size",
            few.robots
        ));
    }
    let costs = Costs::between(few, many);
    let mut text = format!(
        "Of one robot, by the line through the runs of {} and {} robots:\n\n",
        few.robots, many.robots
    );
    // Writing to a String cannot fail.
    let _ = writeln!(
        text,
        "| | |\n|---|---|\n| c_p, the station's planning thread | {:.3} % of a core, of which the solver {:.3} % ({PLANNING_US:.0} µs, {PLANNING_HZ:.0} times a second) |\n| c_z, its Zenoh: router and session | {:.3} % of a core |\n| m, its memory | {:.0} kB |\n| b, bytes on its connection, both ways | {:.1} kB/s |\n| n, messages, both ways | {:.0} /s |\n",
        1e2 * costs.planning,
        1e2 * PLANNING_HZ * PLANNING_US * 1e-6,
        1e2 * costs.network,
        costs.memory * 1e-3,
        costs.wire * 1e-3,
        costs.messages,
    );
    let _ = writeln!(
        text,
        "| N robots | planning N c_p [cores] | of it the solver [cores] | Zenoh N c_z [cores] | stations | routers | bytes N b | messages N n [1/s] | memory N m |\n|---|---|---|---|---|---|---|---|---|"
    );
    for fleet in FLEETS {
        let n = fleet as f64;
        // One planning thread a station.
        let stations = (n * costs.planning / BUSY).ceil().max(1.0);
        let routers = (n / SESSIONS).ceil().max((n * costs.network / BUSY).ceil());
        let _ = writeln!(
            text,
            "| {} | {} | {} | {} | {stations:.0} | {routers:.0} | {} | {:.0} | {} |",
            fleet,
            figure(n * costs.planning),
            figure(n * PLANNING_HZ * PLANNING_US * 1e-6),
            figure(n * costs.network),
            bytes(n * costs.wire) + "/s",
            n * costs.messages,
            bytes(n * costs.memory),
        );
    }
    Ok(text)
}

impl Costs {
    fn between(few: &SwarmReport, many: &SwarmReport) -> Self {
        let slope = |of: &dyn Fn(&SwarmReport) -> f64| {
            let robots = many.robots as f64 - few.robots as f64;
            ((of(many) - of(few)) / robots).max(0.0)
        };
        let planning = |report: &SwarmReport| {
            let station = report.part("station");
            let threads = station.map(|station| &station.cpu_percent_by_thread);
            let thread = threads.and_then(|threads| threads.get("planning"));
            1e-2 * thread.copied().unwrap_or(0.0)
        };
        let station = |report: &SwarmReport| {
            1e-2 * report.part("station").map_or(0.0, |part| part.cpu_percent)
        };
        let memory = |report: &SwarmReport| {
            let station = report.part("station");
            station.map_or(0.0, |part| part.memory_bytes as f64)
        };
        Self {
            planning: slope(&planning),
            network: slope(&|report| station(report) - planning(report)),
            memory: slope(&memory),
            wire: many
                .socket
                .map_or(0.0, |ways| ways.up_bytes + ways.down_bytes),
            messages: many.payload.up_messages + many.payload.down_messages,
        }
    }
}

fn figure(value: f64) -> String {
    match value {
        value if value < 10.0 => format!("{value:.2}"),
        value => format!("{value:.0}"),
    }
}

fn bytes(value: f64) -> String {
    match value {
        value if value >= 1e9 => format!("{:.1} GB", value * 1e-9),
        value if value >= 1e6 => format!("{:.1} MB", value * 1e-6),
        value => format!("{:.0} kB", value * 1e-3),
    }
}
