//! Asking a program to end: SIGINT (Ctrl-C) and SIGTERM, each time they come.

use std::io;

use tokio::signal::unix::{SignalKind, signal};
use tokio::sync::mpsc;

/// One message for each SIGINT or SIGTERM from now on.
///
/// # Errors
/// The system refuses the handlers. Needs a tokio runtime.
pub fn on_signals() -> io::Result<mpsc::Receiver<()>> {
    let (mut interrupt, mut terminate) = (
        signal(SignalKind::interrupt())?,
        signal(SignalKind::terminate())?,
    );
    let (asked, stop) = mpsc::channel(8);
    tokio::spawn(async move {
        loop {
            tokio::select! {
                _ = interrupt.recv() => {}
                _ = terminate.recv() => {}
            }
            // Nobody listens any more: the program is ending.
            if asked.send(()).await.is_err() {
                return;
            }
        }
    });
    Ok(stop)
}
