//! Finds an unknown heading from the first stretch driven under position fixes.
//!
//! The filter is linear in the heading only near the truth. Dead reckoning from an arbitrary heading gives the path's shape, the
//! fixes give its direction; when both are half a metre long, the path is turned and shifted onto the fixes.

use nalgebra::{Rotation2, Vector2};

use super::filter::FixAt;
use super::history::History;

/// The begin of the stretch, as the fix and as dead reckoning have it.
#[derive(Clone, Debug, Default)]
pub(super) struct Alignment {
    anchor: Option<(Vector2<f64>, Vector2<f64>)>,
}

impl Alignment {
    /// Takes a fix at the frame `age`; true when the heading is found. Until then the position follows the fixes alone.
    pub(super) fn on_fix(
        &mut self,
        history: &mut History,
        age: usize,
        fix: &FixAt,
        radius: f64,
    ) -> bool {
        let reckoned = history.slot(age).filter.position_at(fix.ahead, radius);
        let seen = Vector2::from(fix.position);
        let (anchor_seen, anchor_reckoned) = *self.anchor.get_or_insert((seen, reckoned));
        let (path_seen, path_reckoned) = (seen - anchor_seen, reckoned - anchor_reckoned);
        let (long, short) = (path_reckoned.norm(), STRETCH.max(20.0 * fix.sigma));

        if long >= short && (path_seen.norm() - long).abs() <= 0.2 * long {
            let turn = Rotation2::rotation_between(&path_reckoned, &path_seen);
            let heading_sigma = core::f64::consts::SQRT_2 * fix.sigma / long + DRIFT;
            history.for_each_filter(|filter| {
                filter.turn_pose(&turn, reckoned, seen);
                filter.restart_pose(fix.sigma, heading_sigma);
            });
            return true;
        }
        if long >= short {
            // The two do not have the same length: a wild fix, or slip. Begin again from here.
            self.anchor = None;
        }
        history.for_each_filter(|filter| {
            filter.turn_pose(&Rotation2::identity(), reckoned, seen);
            filter.restart_pose(fix.sigma, core::f64::consts::PI);
        });
        if let Some((_, anchor_reckoned)) = &mut self.anchor {
            *anchor_reckoned += seen - reckoned;
        }
        false
    }
}

/// Shortest stretch to take a direction from [m].
const STRETCH: f64 = 0.5;
/// Heading error that dead reckoning may gather over the stretch [rad].
const DRIFT: f64 = 0.02;
