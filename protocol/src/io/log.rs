//! Log lines of the programs: on standard error, for people or as JSON, as much as `RUST_LOG` says.

use std::io::{self, IsTerminal};

use thiserror::Error;
use tracing_subscriber::EnvFilter;
use tracing_subscriber::fmt;

use crate::document::shared::LogFormat;

/// Why there are no log lines.
#[derive(Debug, Error)]
pub enum LogError {
    /// `RUST_LOG` means nothing.
    #[error(
        "RUST_LOG = {value:?}: {why}; write it as RUST_LOG=debug or RUST_LOG=sphere_agent=debug,zenoh=info"
    )]
    Filter {
        /// What it says.
        value: String,
        /// What is wrong with it.
        why: String,
    },
}

/// Sends log lines to standard error from now on. Where it was done before, the first time stands.
///
/// # Errors
/// `RUST_LOG` is set and means nothing.
pub fn to_stderr(format: LogFormat) -> Result<(), LogError> {
    let value = std::env::var("RUST_LOG").unwrap_or_default();
    let directives = if value.is_empty() { DEFAULT } else { &value };
    let filter = EnvFilter::try_new(directives).map_err(|error| LogError::Filter {
        value: value.clone(),
        why: error.to_string(),
    })?;
    let lines = fmt().with_env_filter(filter).with_writer(io::stderr);
    // Fails if there is a subscriber already, which then stays.
    let _ = match format {
        LogFormat::Human => lines
            .with_ansi(io::stderr().is_terminal())
            .with_target(false)
            .try_init(),
        LogFormat::Json => lines.json().flatten_event(true).try_init(),
    };
    Ok(())
}

/// Our own reports; of the libraries what needs attention. Zenoh reports every connection that ends as an error.
const DEFAULT: &str = "info,zenoh=error,zenoh_transport=error,zenoh_link=error";
