//! The files around a run: the scenario that it is read from, and the folder that it leaves.

use std::fs;
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};

use thiserror::Error;

use crate::metrics::RunMetrics;
use crate::plot::Plot;
use crate::scenario::{Scenario, ScenarioError};
use crate::trace::Trace;

/// Why a scenario could not be read or a run not be written. Each displays as one line with the file and the remedy.
#[derive(Debug, Error)]
pub enum FileError {
    /// The scenario file cannot be read.
    #[error("cannot read the scenario {}: {error}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// What the system says.
        error: io::Error,
    },
    /// The scenario was refused.
    #[error(transparent)]
    Scenario(#[from] ScenarioError),
    /// A result cannot be written.
    #[error("cannot write {}: {error}; choose another folder with --out", path.display())]
    Write {
        /// The file or folder.
        path: PathBuf,
        /// What the system says.
        error: io::Error,
    },
}

/// Reads the scenario at `path` with the arguments of `--set`; robot files are looked for beside it.
///
/// # Errors
/// The file that cannot be read, or the key that was refused.
pub fn read_scenario(path: &Path, sets: &[String]) -> Result<Scenario, FileError> {
    let text = fs::read_to_string(path).map_err(|error| FileError::Read {
        path: path.to_owned(),
        error,
    })?;
    let folder = path.parent().unwrap_or(Path::new(""));
    let load = |robot: &str| {
        let file = folder.join(robot);
        fs::read_to_string(&file)
            .map_err(|error| format!("cannot read {}: {error}", file.display()))
    };
    Ok(Scenario::parse(
        &path.display().to_string(),
        &text,
        sets,
        load,
    )?)
}

/// Writes a run into `folder`, which is made if need be: `scenario.toml` with its robot files, `metrics.json`, `trace.csv` and the
/// plots. Files of the same names are replaced.
///
/// # Errors
/// The file that cannot be written.
pub fn write_run(
    folder: &Path,
    scenario: &Scenario,
    metrics: &RunMetrics,
    trace: &Trace,
    plots: &[Plot],
) -> Result<(), FileError> {
    let failed = |path: &Path| {
        let path = path.to_owned();
        |error| FileError::Write { path, error }
    };
    fs::create_dir_all(folder).map_err(failed(folder))?;
    let write = |name: &str, text: &str| {
        let path = folder.join(name);
        fs::write(&path, text).map_err(failed(&path))
    };
    write("scenario.toml", &scenario.drawn())?;
    for (name, text) in scenario.robot_files() {
        write(name, text)?;
    }
    write("metrics.json", &metrics.json())?;
    for (name, svg) in plots {
        write(name, svg)?;
    }
    let path = folder.join("trace.csv");
    write_trace(&path, trace).map_err(failed(&path))
}

fn write_trace(path: &Path, trace: &Trace) -> io::Result<()> {
    let mut file = BufWriter::new(fs::File::create(path)?);
    trace.write_csv(&mut file)?;
    file.flush()
}
