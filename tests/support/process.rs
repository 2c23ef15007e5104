//! The programs as child processes: started, signalled, and their log lines read with the time of each.

#![allow(dead_code, reason = "each test binary uses its own part")]

use std::fs;
use std::io::{BufRead, BufReader};
use std::net::{SocketAddr, TcpListener, UdpSocket};
use std::path::PathBuf;
use std::process::{Child, Command, ExitStatus, Stdio};
use std::sync::{Arc, Mutex};
use std::thread;
use std::time::{Duration, Instant};

/// A running program. Dropping it kills it.
pub struct Program {
    pub child: Child,
    name: String,
    lines: Arc<Mutex<Vec<(Instant, String)>>>,
}

impl Program {
    /// Starts a program with the configuration `config`.
    pub fn start(program: &str, command: &str, name: &str, config: &str) -> Self {
        let file = scratch(&format!("{name}.toml"));
        fs::write(&file, config).expect("a folder for test files");
        let file = file.to_str().expect("a path in UTF-8");
        Self::spawn(program, name, &[command, "--config", file])
    }

    /// Starts a program.
    fn spawn(program: &str, name: &str, args: &[&str]) -> Self {
        let mut child = Command::new(program)
            .args(args)
            .env_remove("RUST_LOG")
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(Stdio::piped())
            .spawn()
            .expect("the program was built with the test");
        let lines: Arc<Mutex<Vec<_>>> = Arc::default();
        let stderr = BufReader::new(child.stderr.take().expect("piped"));
        let (shown, label) = (lines.clone(), name.to_owned());
        thread::spawn(move || {
            for line in stderr.lines().map_while(Result::ok) {
                println!("{label}: {line}");
                shown.lock().unwrap().push((Instant::now(), line));
            }
        });
        Self {
            child,
            name: name.to_owned(),
            lines,
        }
    }

    /// An agent of r1 at `board`, client of the router on `port`.
    pub fn agent(name: &str, bind: SocketAddr, board: SocketAddr, port: u16) -> Self {
        let config = format!(
            "id = 'r1'\nrobot = 'liu'\n[motors]\nbind = '{bind}'\nboard = '{board}'\n[network]\nconnect = ['tcp/127.0.0.1:{port}']\n"
        );
        Self::start(env!("CARGO_BIN_EXE_sphere-agent"), "run", name, &config)
    }

    /// A station for r1 that is the router on `port`. `id` = none: drawn by itself.
    pub fn station(name: &str, id: Option<u64>, port: u16) -> Self {
        Self::station_with(
            name,
            id,
            &format!("listen = ['tcp/127.0.0.1:{port}']"),
            "r1",
        )
    }

    /// A station for `robot` with the line `network` in its table.
    pub fn station_with(name: &str, id: Option<u64>, network: &str, robot: &str) -> Self {
        let id = id.map_or(String::new(), |id| format!("station = {id}\n"));
        let config = format!(
            "{id}[network]\n{network}\n[[robots]]\nid = '{robot}'\nrobot = 'liu'\nmission = {{ kind = 'line' }}\n"
        );
        Self::start(env!("CARGO_BIN_EXE_sphere-ground"), "serve", name, &config)
    }

    /// Plants: one robot whose board is at `board`, for an agent at `agent`.
    pub fn plants(name: &str, agent: u16, board: u16) -> Self {
        let [agent, board] = [agent.to_string(), board.to_string()];
        let args = ["plants", "--agent-port", &agent, "--board-port", &board];
        Self::spawn(env!("CARGO_BIN_EXE_sphere-sim"), name, &args)
    }

    /// Sends it a signal: INT, TERM, KILL, STOP, CONT.
    pub fn signal(&self, signal: &str) -> Instant {
        // Of the shell itself: small images of Linux have no program `kill`.
        let status = Command::new("sh")
            .args(["-c", &format!("kill -{signal} {}", self.child.id())])
            .status()
            .expect("every Unix has a shell");
        assert!(status.success(), "{}: SIG{signal}", self.name);
        Instant::now()
    }

    /// When it first said a line with `text` from `begin` on; waited for until `limit` after `begin`.
    pub fn says(&self, begin: Instant, limit: Duration, text: &str) -> Duration {
        loop {
            let found = self
                .lines
                .lock()
                .unwrap()
                .iter()
                .find(|(at, line)| *at >= begin && line.contains(text))
                .map(|(at, _)| *at - begin);
            if let Some(after) = found {
                return after;
            }
            assert!(
                begin.elapsed() < limit,
                "{} did not say `{text}` within {limit:?}:\n{}",
                self.name,
                self.text()
            );
            thread::sleep(Duration::from_millis(2));
        }
    }

    /// All it said.
    pub fn text(&self) -> String {
        let lines = self.lines.lock().unwrap();
        lines.iter().map(|(_, line)| format!("{line}\n")).collect()
    }

    /// Waits for its end, until `limit` from now.
    pub fn ends(&mut self, limit: Duration) -> (ExitStatus, Duration) {
        let begin = Instant::now();
        loop {
            if let Some(status) = self.child.try_wait().expect("our child") {
                // Its last lines may still be under way.
                thread::sleep(Duration::from_millis(50));
                return (status, begin.elapsed());
            }
            assert!(
                begin.elapsed() < limit,
                "{} runs on:\n{}",
                self.name,
                self.text()
            );
            thread::sleep(Duration::from_millis(2));
        }
    }
}

impl Drop for Program {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// A file name in a folder for test files that this run of the test has for itself.
pub fn scratch(name: &str) -> PathBuf {
    let folder = PathBuf::from(env!("CARGO_TARGET_TMPDIR")).join(std::process::id().to_string());
    fs::create_dir_all(&folder).expect("a folder for test files");
    folder.join(name)
}

/// A UDP port of this machine that is free now.
pub fn free_udp_port() -> u16 {
    let socket = UdpSocket::bind("127.0.0.1:0").expect("a free port");
    socket.local_addr().expect("bound").port()
}

/// A TCP port that is free now.
pub fn free_port() -> u16 {
    let listener = TcpListener::bind("127.0.0.1:0").expect("a free port");
    listener.local_addr().expect("bound").port()
}
