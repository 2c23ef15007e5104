//! Position fixes, and the pose that they may overturn.

use nalgebra::{Rotation2, Vector2};

use super::correction::{Correction, dot, times};
use super::{Filter, HEADING, Q_R_RATE, V, X, Y, square};

/// A position fix brought to the stamp of a frame.
#[derive(Clone, Copy, Debug)]
pub(in crate::estimator) struct FixAt {
    /// World X and Y [m].
    pub(in crate::estimator) position: [f64; 2],
    /// Standard deviation of each axis [m].
    pub(in crate::estimator) sigma: f64,
    /// Time from the frame to the fix, mostly ≤ 0 [s].
    pub(in crate::estimator) ahead: f64,
}

impl Filter {
    /// Squared innovation of a fix over its variance: chi-square with two degrees of freedom if all is well.
    pub(in crate::estimator) fn fix_distance(&self, fix: &FixAt, radius: f64) -> f64 {
        let (residual, [h_x, h_y]) = self.fix_model(fix, radius);
        let (p_x, p_y) = (times(&self.p, &h_x), times(&self.p, &h_y));
        let noise = square(fix.sigma);
        let s_xx = dot(&h_x, &p_x) + noise;
        let s_xy = dot(&h_y, &p_x);
        let s_yy = dot(&h_y, &p_y) + noise;
        let [r_x, r_y] = residual;
        (s_yy * r_x * r_x - 2.0 * s_xy * r_x * r_y + s_xx * r_y * r_y) / (s_xx * s_yy - s_xy * s_xy)
    }

    /// Fuses a position fix, without a gate.
    pub(in crate::estimator) fn fuse_fix(&mut self, fix: &FixAt, radius: f64) {
        let (residual, h) = self.fix_model(fix, radius);
        let mut correction = Correction::of(self);
        for (h, residual) in h.iter().zip(residual) {
            correction.plain(h, residual, square(fix.sigma));
        }
        correction.finish();
    }

    /// Forgets where the robot is, so far as the fix says: its innovation counts as one standard deviation.
    pub(in crate::estimator) fn reopen_position(
        &mut self,
        fix: &FixAt,
        radius: f64,
        heading_sigma: f64,
    ) {
        let (residual, _) = self.fix_model(fix, radius);
        self.p[(X, X)] += square(residual[0]);
        self.p[(Y, Y)] += square(residual[1]);
        self.p[(HEADING, HEADING)] += square(heading_sigma);
    }

    /// Where the centre was `ahead` [s] from the frame, the speed held.
    pub(in crate::estimator) fn position_at(&self, ahead: f64, radius: f64) -> Vector2<f64> {
        let x = &self.x;
        let (sin_h, cos_h) = x[HEADING].sin_cos();
        let (forward, left) = (ahead * x[V], ahead * radius * x[Q_R_RATE]);
        Vector2::new(
            x[X] + forward * cos_h - left * sin_h,
            x[Y] + forward * sin_h + left * cos_h,
        )
    }

    /// Turns the pose about `from` and shifts that point to `to`.
    pub(in crate::estimator) fn turn_pose(
        &mut self,
        turn: &Rotation2<f64>,
        from: Vector2<f64>,
        to: Vector2<f64>,
    ) {
        let position = turn * (Vector2::new(self.x[X], self.x[Y]) - from) + to;
        (self.x[X], self.x[Y]) = (position.x, position.y);
        self.x[HEADING] += turn.angle();
    }

    /// Gives the pose new standard deviations that owe nothing to the other states.
    pub(in crate::estimator) fn restart_pose(&mut self, position_sigma: f64, heading_sigma: f64) {
        for (place, sigma) in [
            (X, position_sigma),
            (Y, position_sigma),
            (HEADING, heading_sigma),
        ] {
            self.p.fill_row(place, 0.0);
            self.p.fill_column(place, 0.0);
            self.p[(place, place)] = square(sigma);
        }
    }

    /// Innovation of a fix and its derivatives, by eq (1) from the frame to the fix.
    fn fix_model(&self, fix: &FixAt, radius: f64) -> ([f64; 2], [[(usize, f64); 4]; 2]) {
        let x = &self.x;
        let (sin_h, cos_h) = x[HEADING].sin_cos();
        let x_rate = x[V] * cos_h - radius * x[Q_R_RATE] * sin_h;
        let y_rate = x[V] * sin_h + radius * x[Q_R_RATE] * cos_h;
        let ahead = fix.ahead;
        let residual = [
            fix.position[0] - x[X] - ahead * x_rate,
            fix.position[1] - x[Y] - ahead * y_rate,
        ];
        let h_x = [
            (X, 1.0),
            (V, ahead * cos_h),
            (Q_R_RATE, -ahead * radius * sin_h),
            (HEADING, -ahead * y_rate),
        ];
        let h_y = [
            (Y, 1.0),
            (V, ahead * sin_h),
            (Q_R_RATE, ahead * radius * cos_h),
            (HEADING, ahead * x_rate),
        ];
        (residual, [h_x, h_y])
    }
}
