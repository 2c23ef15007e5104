//! The link between an agent and its motor board: MAVLink datagrams over UDP.
//!
//! The peer is pinned: the kernel passes on nothing that comes from another address, so that a stranger's datagram neither reaches
//! the reader nor redirects the answers. One receive is one datagram.

use std::io;
use std::net::{SocketAddr, UdpSocket};
use std::time::Duration;

use thiserror::Error;

/// Longest datagram that is read [bytes]; a board sends far shorter ones.
pub const DATAGRAM_MAX: usize = 2048;

/// A UDP link with one pinned peer.
#[derive(Debug)]
pub struct UdpLink {
    socket: UdpSocket,
}

/// Why a link could not be opened.
#[derive(Debug, Error)]
pub enum LinkError {
    /// The local address is taken or not ours.
    #[error(
        "motor link: cannot listen on {local}: {error}; choose another address or end the program that has it"
    )]
    Bind {
        /// The local address.
        local: SocketAddr,
        /// What the system says.
        error: io::Error,
    },
    /// The peer cannot be pinned.
    #[error("motor link: cannot reach {peer}: {error}")]
    Peer {
        /// The peer's address.
        peer: SocketAddr,
        /// What the system says.
        error: io::Error,
    },
}

impl UdpLink {
    /// Listens on `local` and speaks with `peer` alone.
    ///
    /// # Errors
    /// The local address is taken, or the peer's is impossible.
    pub fn open(local: SocketAddr, peer: SocketAddr) -> Result<Self, LinkError> {
        let socket = UdpSocket::bind(local).map_err(|error| LinkError::Bind { local, error })?;
        Self::pinned(socket, peer)
    }

    /// Speaks with `peer` alone on a socket that is already bound.
    ///
    /// # Errors
    /// The peer's address is impossible.
    pub fn pinned(socket: UdpSocket, peer: SocketAddr) -> Result<Self, LinkError> {
        let failed = |error| LinkError::Peer { peer, error };
        socket.connect(peer).map_err(failed)?;
        // Waiting is `wait`'s: a socket's own time limit is rounded up to the kernel's tick, 4 ms on many.
        socket.set_nonblocking(true).map_err(failed)?;
        Ok(Self { socket })
    }

    /// The next datagram, waiting for it for at most `timeout`; `None` if none came.
    ///
    /// # Errors
    /// The socket is broken. A peer that does not listen is no error: it may come back.
    pub fn receive<'b>(
        &self,
        buffer: &'b mut [u8],
        timeout: Duration,
    ) -> io::Result<Option<&'b [u8]>> {
        match self.socket.recv(buffer) {
            Ok(length) => return Ok(Some(&buffer[..length])),
            Err(error) if !is_passing(&error) => return Err(error),
            Err(_) if timeout.is_zero() => return Ok(None),
            Err(_) => {}
        }
        wait(&self.socket, timeout)?;
        match self.socket.recv(buffer) {
            Ok(length) => Ok(Some(&buffer[..length])),
            Err(error) if is_passing(&error) => Ok(None),
            Err(error) => Err(error),
        }
    }

    /// Sends one datagram. Whether the peer is there is not known.
    ///
    /// # Errors
    /// The socket is broken.
    pub fn send(&self, bytes: &[u8]) -> io::Result<()> {
        match self.socket.send(bytes) {
            Ok(_) => Ok(()),
            Err(error) if is_passing(&error) => Ok(()),
            Err(error) => Err(error),
        }
    }

    /// Our address.
    ///
    /// # Errors
    /// The socket is broken.
    pub fn local_addr(&self) -> io::Result<SocketAddr> {
        self.socket.local_addr()
    }
}

/// Waits until there is a datagram, for at most `timeout`, to the precision of the kernel's timers; a signal may end it early.
#[cfg(unix)]
fn wait(socket: &UdpSocket, timeout: Duration) -> io::Result<()> {
    use rustix::event::{PollFd, PollFlags, Timespec, poll};
    use rustix::io::Errno;
    // What is too long for the kernel is a mere loop of the caller's more.
    let limit = Timespec::try_from(timeout.min(WAIT_MAX)).ok();
    match poll(&mut [PollFd::new(socket, PollFlags::IN)], limit.as_ref()) {
        Ok(_) | Err(Errno::INTR) => Ok(()),
        Err(error) => Err(error.into()),
    }
}

/// Looks again and again: precise to half a millisecond.
#[cfg(not(unix))]
fn wait(socket: &UdpSocket, timeout: Duration) -> io::Result<()> {
    const LOOK: Duration = Duration::from_micros(500);
    let mut left = timeout.min(WAIT_MAX);
    while !left.is_zero() {
        match socket.peek(&mut [0]) {
            Err(error) if error.kind() == io::ErrorKind::WouldBlock => {}
            _ => return Ok(()),
        }
        let pause = left.min(LOOK);
        #[allow(clippy::disallowed_methods, reason = "a shell's thread waits here")]
        std::thread::sleep(pause);
        left -= pause;
    }
    Ok(())
}

const WAIT_MAX: Duration = Duration::from_secs(3600);

/// Nothing there now: no datagram in time, a full queue, or a peer whose port is closed (the ICMP answer to an earlier datagram).
fn is_passing(error: &io::Error) -> bool {
    use io::ErrorKind::{ConnectionRefused, Interrupted, TimedOut, WouldBlock};
    matches!(
        error.kind(),
        WouldBlock | TimedOut | Interrupted | ConnectionRefused
    )
}
