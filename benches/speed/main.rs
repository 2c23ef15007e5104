//! What the parts cost, and how fast the whole runs: `cargo bench` (under a minute), figures in docs/benchmarks.md.
//!
//! Each figure is one tick of what its doc names, on one core. Compare minima: they are what the code costs, and medians what it
//! costs beside whatever else the machine was doing.

mod agent;
mod planner;
mod simulator;
#[path = "../../tests/support/tracking.rs"]
mod tracking;
mod wire;

fn main() {
    divan::main();
    // `cargo bench` as it is, without a filter: nothing but its own flag.
    if std::env::args().skip(1).eq(["--bench"]) {
        agent::print_quantiles();
    }
}
