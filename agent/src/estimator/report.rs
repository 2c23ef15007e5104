//! What the estimator says of itself.

/// Standard deviations of the estimate.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StateSigma {
    /// The larger axis of the position's ellipse [m].
    pub position: f64,
    /// Heading [rad].
    pub heading: f64,
    /// Forward speed [m/s].
    pub v: f64,
    /// Roll q_r [rad].
    pub q_r: f64,
    /// Its rate [rad/s].
    pub q_r_rate: f64,
    /// Swing α [rad].
    pub alpha: f64,
    /// Its rate [rad/s].
    pub alpha_rate: f64,
}

/// What became of a position fix.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FixOutcome {
    /// Fused at its stamp.
    Fused,
    /// Taken to find the heading, which is unknown.
    Aligning,
    /// Refused by the innovation gate.
    Rejected,
    /// Fused although the gate refused it: too many in a row had said so.
    Reopened,
    /// Older than the frames that are kept.
    Late,
    /// Newer than the newest frame by more than a frame may be.
    Future,
    /// Another fix was fused at that frame already.
    Duplicate,
    /// Not a number, no standard deviation, or no frame was seen yet.
    Invalid,
}

/// What the estimator refused or had to mend, counted since it was built.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub struct EstimatorCounters {
    /// Frames used.
    pub frames: u64,
    /// Frames dropped: their stamp repeats, goes back, or leaps.
    pub frames_out_of_time: u64,
    /// Frames used after a gap of more than 2.5 sample intervals.
    pub gaps: u64,
    /// Starts anew after an outage or a restart of the board's clock.
    pub restarts: u64,
    /// Frames whose gyro was unusable.
    pub gyro_unusable: u64,
    /// Frames whose accelerometer was unusable.
    pub accel_unusable: u64,
    /// Frames whose encoders were unusable.
    pub encoders_unusable: u64,
    /// Gyro axes refused by their innovation gate.
    pub gyro_rejected: u64,
    /// Pitch encoder readings refused by their innovation gate.
    pub encoder_rejected: u64,
    /// Frames that opened the pivot state: the shell turned about the vertical.
    pub pivots: u64,
    /// Fixes fused.
    pub fixes: u64,
    /// Fixes refused by the innovation gate.
    pub fixes_rejected: u64,
    /// Times that the gate gave way to fixes that kept disagreeing.
    pub fixes_reopened: u64,
    /// Fixes older than the frames that are kept.
    pub fixes_late: u64,
    /// Fixes from the future.
    pub fixes_future: u64,
    /// Fixes that repeat, or share their frame with another.
    pub fixes_duplicate: u64,
    /// Fixes that are not numbers, or came before the first frame.
    pub fixes_invalid: u64,
}
