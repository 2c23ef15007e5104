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
    /// Whether what `row` shows is its agent's doing.
    pub(super) fn on_row(&mut self, row: &Row, around: &Circumstances) -> bool {
        let is_armed = matches!(
            row.mode,
            Mode::Idle | Mode::Tracking | Mode::Holding | Mode::Failsafe
        );
        if is_armed && around.agent_runs {
            // One that has stood still is armed by name until its next control step.
            self.armed_rows += 1;
            if self.armed_rows > 1 {
                self.lost_at = None;
            }
        } else {
            self.armed_rows = 0;
            self.lost_at.get_or_insert(row.t);
        }
        // Whoever lets go of a falling robot has let it fall.
        self.lost_at.is_none_or(|lost| row.t - lost <= AFTERMATH)
    }
}

const AFTERMATH: Span = Span::from_millis(200);
