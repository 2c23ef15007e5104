//! Writing the [log](super::log) from what passes on the motor link.

use std::fmt::Write as _;

use sphere_protocol::mavlink::{AGENT, BOARD, Event, FrameReader, Framing};
use sphere_protocol::state::{Measurement, PositionFix, Torque};
use sphere_protocol::time::{AgentClock, BoardClock, Instant};

use super::log::COLUMNS;
use crate::board_clock::BoardClockMap;

/// Makes rows of datagrams, both ways. Pure: time and bytes in, text out.
#[derive(Debug)]
pub struct Recording {
    from_board: FrameReader,
    to_board: FrameReader,
    clock: BoardClockMap,
    newest: Option<Instant<BoardClock>>,
    torque: Option<(Instant<BoardClock>, Torque)>,
    fix: Option<PositionFix>,
}

impl Recording {
    /// A recording that has seen nothing yet.
    pub fn new() -> Self {
        Self {
            from_board: FrameReader::new(Framing::Datagrams, AGENT, Some(BOARD.system)),
            to_board: FrameReader::new(Framing::Datagrams, BOARD, Some(AGENT.system)),
            clock: BoardClockMap::default(),
            newest: None,
            torque: None,
            fix: None,
        }
    }

    /// The line that names the columns.
    pub fn head() -> String {
        COLUMNS.join(",") + "\n"
    }

    /// A datagram of the board that arrived at `now`; appends a row for each sensor frame in it.
    pub fn on_board(&mut self, now: Instant<AgentClock>, mut bytes: &[u8], rows: &mut String) {
        while let Some(received) = self.from_board.pull(&mut bytes) {
            match received.event {
                Event::Sensors { measurement, .. } => {
                    // A frame that was overtaken has no place in a log whose stamps grow; that of a board that restarted stays.
                    let late = self.newest.is_some_and(|newest| {
                        let behind = newest.since(measurement.stamp).as_secs_f64();
                        (0.0..0.5).contains(&behind)
                    });
                    self.clock.observe(now, measurement.stamp);
                    if !late {
                        self.newest = Some(measurement.stamp);
                        self.row(&measurement, rows);
                    }
                }
                Event::Fix(fix) => self.fix = Some(fix),
                _ => {}
            }
        }
    }

    /// A datagram of the agent that was sent at `now`.
    pub fn on_agent(&mut self, now: Instant<AgentClock>, mut bytes: &[u8]) {
        while let Some(received) = self.to_board.pull(&mut bytes) {
            if let (Event::Torque(command), Some(newest)) = (received.event, self.newest) {
                let sent = newest + self.clock.age(now, newest);
                self.torque = Some((sent, command.torque));
            }
        }
    }

    fn row(&mut self, m: &Measurement, rows: &mut String) {
        let seconds = |stamp: Instant<BoardClock>| stamp.as_nanos() as f64 * 1e-9;
        // What travels as f32 is whole as f32. Writing to a String cannot fail.
        let _ = write!(rows, "{:.6}", seconds(m.stamp));
        for value in m.gyro.iter().chain(&m.accel) {
            let _ = write!(rows, ",{}", *value as f32);
        }
        let _ = write!(rows, ",{:.9},{:.9}", m.theta_r, m.theta_p);
        let _ = match self.torque {
            Some((sent, Torque { pitch, roll })) => {
                let (pitch, roll) = (pitch as f32, roll as f32);
                write!(rows, ",{pitch},{roll},{:.6}", seconds(sent))
            }
            None => write!(rows, ",,,"),
        };
        let _ = match self.fix.take() {
            Some(fix) => {
                let stamp = seconds(fix.stamp);
                writeln!(rows, ",{stamp:.6},{},{},{}", fix.x, fix.y, fix.sigma as f32)
            }
            None => writeln!(rows, ",,,,"),
        };
    }
}

impl Default for Recording {
    fn default() -> Self {
        Self::new()
    }
}
