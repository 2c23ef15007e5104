//! Whether somebody controls a robot: without torque it rolls and leans as it will.

use sphere_protocol::message::Mode;
use sphere_protocol::time::Span;

use super::Circumstances;
use crate::trace::Row;

/// Since when a robot is under control, or not.
#[derive(Default)]
pub(super) struct Control {
    armed_rows: u32,
    lost_at: Option<Span>,
}

impl Control {
    /// Whether the last row showed a robot under control of an agent that has had the time to take it over.
    pub(super) fn is_sound(&self) -> bool {
        self.armed_rows > 0 && self.lost_at.is_none()
    }

    /// Whether what `row` shows is its agent's doing.
    pub(super) fn on_row(&mut self, row: &Row, around: &Circumstances) -> bool {
        let is_armed = matches!(
            row.mode,
            Mode::Idle | Mode::Tracking | Mode::Holding | Mode::Failsafe
        );
        if is_armed && around.agent_runs {
            // Who takes a robot over takes it as it rolls and leans.
            self.armed_rows += 1;
            if self.armed_rows > TAKING_OVER {
                self.lost_at = None;
            }
        } else {
            self.armed_rows = 0;
            if self.lost_at.is_none() {
                self.lost_at = Some(row.t);
            }
        }
        // Whoever lets go of a falling robot has let it fall.
        self.lost_at.is_none_or(|lost| row.t - lost <= AFTERMATH)
    }
}

const AFTERMATH: Span = Span::from_millis(200);
/// Rows until the robot is the doing of an agent that has begun to control it: 2 s.
const TAKING_OVER: u32 = 100;
