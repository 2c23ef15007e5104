//! Is the robot standing still?

use nalgebra::Vector3;

/// Watches encoders and gyro for a stretch without motion.
#[derive(Clone, Debug)]
pub(super) struct RestDetector {
    /// Encoder angles at the begin of the stretch [rad].
    anchor: [f64; 2],
    /// Length of the stretch [s].
    still_for: f64,
    /// Low-passed gyro [rad/s].
    gyro: Vector3<f64>,
}

impl RestDetector {
    pub(super) fn new(theta: [f64; 2], gyro: [f64; 3]) -> Self {
        Self {
            anchor: theta,
            still_for: 0.0,
            gyro: Vector3::from(gyro),
        }
    }

    /// Takes one frame and says whether the robot stands still.
    ///
    /// Still means for [`REST_TIME`]: both joints within [`JOINT_STILL`] of where they were; the gyro near its own mean (`noise`
    /// [rad/s], one sample), and that mean no further from the bias estimate `bias` than its standard deviation `bias_sigma` allows:
    /// the whole robot could rock with stuck joints.
    pub(super) fn step(
        &mut self,
        dt: f64,
        theta: [f64; 2],
        gyro: [f64; 3],
        noise: f64,
        bias: [f64; 3],
        bias_sigma: [f64; 3],
    ) -> bool {
        let keep = MEAN_TIME / (MEAN_TIME + dt);
        let gyro = Vector3::from(gyro);
        let turned = (gyro - self.gyro).amax() > 6.0 * noise + GYRO_STILL;
        self.gyro = self.gyro * keep + gyro * (1.0 - keep);
        // Variance of an exponential mean over samples dt apart.
        let mean_variance = noise * noise * dt / (2.0 * MEAN_TIME);
        let turning = (0..3).any(|i| {
            let bound = 4.0 * (bias_sigma[i] * bias_sigma[i] + mean_variance).sqrt() + GYRO_STILL;
            (self.gyro[i] - bias[i]).abs() > bound
        });
        let moved = (0..2).any(|i| (theta[i] - self.anchor[i]).abs() > JOINT_STILL);
        if moved || turned || turning {
            self.anchor = theta;
            self.still_for = 0.0;
        } else {
            self.still_for += dt;
        }
        self.still_for >= REST_TIME
    }

    /// No frame to judge by: the stretch ends.
    pub(super) fn interrupt(&mut self) {
        self.still_for = 0.0;
    }
}

/// Stretch without motion that counts as rest [s].
const REST_TIME: f64 = 0.25;
/// Time constant of the gyro's mean [s].
const MEAN_TIME: f64 = 0.25;
/// Motion of a joint that is still rest [rad]: a 16-bit encoder may flicker by one step, 2π/65536, on an edge; two are motion.
const JOINT_STILL: f64 = 1.5e-4;
/// Rate that is still rest [rad/s].
const GYRO_STILL: f64 = 3.0e-4;
