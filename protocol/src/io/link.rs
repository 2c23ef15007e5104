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
        socket
            .connect(peer)
            .map_err(|error| LinkError::Peer { peer, error })?;
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
        // A zero timeout would mean "for ever".
        self.socket
            .set_read_timeout(Some(timeout.max(Duration::from_micros(1))))?;
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

/// Nothing there now: no datagram in time, a full queue, or a peer whose port is closed (the ICMP answer to an earlier datagram).
fn is_passing(error: &io::Error) -> bool {
    use io::ErrorKind::{ConnectionRefused, Interrupted, TimedOut, WouldBlock};
    matches!(
        error.kind(),
        WouldBlock | TimedOut | Interrupted | ConnectionRefused
    )
}
