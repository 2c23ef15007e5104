//! A part of a swarm as its parent sees it: a process that answers, and that does not outlive its handle.

use std::io::{BufRead, BufReader, Write};
use std::process::{Child, ChildStdin, Command, Stdio};
use std::sync::mpsc::{Receiver, RecvTimeoutError, sync_channel};
use std::thread;
use std::time::{Duration, Instant};

use super::message::{Answer, Ask, Mark, Part, PartSetup};
use super::{SwarmError, VERBOSE};

/// A running part. Dropping it kills it.
pub(super) struct PartProcess {
    pub(super) part: Part,
    pub(super) first: usize,
    child: Child,
    stdin: Option<ChildStdin>,
    answers: Receiver<Answer>,
}

impl PartProcess {
    /// Starts it as a process of this very program.
    pub(super) fn start(setup: &PartSetup, is_verbose: bool) -> Result<Self, SwarmError> {
        let failed = |error: std::io::Error| SwarmError::Start {
            part: setup.part.name(),
            error,
        };
        let program = std::env::current_exe().map_err(failed)?;
        let mut command = Command::new(program);
        command
            .arg("swarm-part")
            .stdin(Stdio::piped())
            .stdout(Stdio::piped());
        if is_verbose {
            command.env(VERBOSE, "1");
        }
        // Ctrl-C is for the parent, which ends its parts in order.
        #[cfg(unix)]
        std::os::unix::process::CommandExt::process_group(&mut command, 0);
        let mut child = command.spawn().map_err(failed)?;
        let stdin = child.stdin.take();
        let (told, answers) = sync_channel(4);
        if let Some(stdout) = child.stdout.take() {
            thread::spawn(move || {
                for line in BufReader::new(stdout).lines().map_while(Result::ok) {
                    let answer = serde_json::from_str(&line)
                        .unwrap_or_else(|error| Answer::Failed(format!("{error}: {line}")));
                    if told.send(answer).is_err() {
                        return;
                    }
                }
            });
        }
        let mut process = Self {
            part: setup.part,
            first: setup.first,
            child,
            stdin,
            answers,
        };
        process.write(setup);
        Ok(process)
    }

    pub(super) fn id(&self) -> u32 {
        self.child.id()
    }

    /// Asks; the answer is taken with [`PartProcess::answer`].
    pub(super) fn ask(&mut self, ask: &Ask) {
        self.write(ask);
    }

    /// The next answer, waited for until `timeout` from now.
    #[allow(
        clippy::disallowed_methods,
        reason = "processes are waited for in real time"
    )]
    pub(super) fn answer(&mut self, timeout: Duration) -> Result<Answer, SwarmError> {
        match self.answers.recv_timeout(timeout) {
            Ok(Answer::Failed(why)) => Err(SwarmError::Part {
                part: self.part.name(),
                why,
            }),
            Ok(answer) => Ok(answer),
            Err(RecvTimeoutError::Timeout) => Err(SwarmError::Silent {
                part: self.part.name(),
                timeout,
            }),
            Err(RecvTimeoutError::Disconnected) => {
                let begin = Instant::now();
                let mut how = "its output closed".to_owned();
                while begin.elapsed() < Duration::from_secs(1) {
                    if let Ok(Some(status)) = self.child.try_wait() {
                        how = status.to_string();
                        break;
                    }
                    thread::sleep(Duration::from_millis(5));
                }
                Err(SwarmError::Part {
                    part: self.part.name(),
                    why: format!("it ended by itself: {how}"),
                })
            }
        }
    }

    /// Its counters, asked for before.
    pub(super) fn mark(&mut self) -> Result<Mark, SwarmError> {
        match self.answer(ANSWER)? {
            Answer::Marked(mark) => Ok(*mark),
            other => Err(self.unexpected(&other)),
        }
    }

    pub(super) fn unexpected(&self, answer: &Answer) -> SwarmError {
        SwarmError::Part {
            part: self.part.name(),
            why: format!("an answer out of turn: {answer:?}"),
        }
    }

    fn write(&mut self, what: &impl serde::Serialize) {
        let line = serde_json::to_string(what).unwrap_or_default() + "\n";
        // One that has ended is told of when its answer is waited for.
        if let Some(stdin) = &mut self.stdin {
            let _ = stdin.write_all(line.as_bytes());
            let _ = stdin.flush();
        }
    }
}

impl Drop for PartProcess {
    fn drop(&mut self) {
        drop(self.stdin.take());
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

impl Part {
    pub(super) fn name(self) -> &'static str {
        match self {
            Self::Station => "station",
            Self::Agents => "agents",
            Self::Plants => "plants",
            Self::Relay => "relay",
        }
    }
}

/// How long a part may take for an answer.
pub(super) const ANSWER: Duration = Duration::from_secs(30);
