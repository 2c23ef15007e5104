//! Fuses scalar measurements one after the other, behind gates.

use super::{ALPHA_RATE, Covariance, Filter, PIVOT, PIVOT_LINGERS, Q_R_RATE, SHELL, State, V};

/// Scalar measurements whose innovation is gated.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::estimator) enum Channel {
    GyroForward,
    GyroLeft,
    GyroUp,
    Encoder,
}

/// Which channels a frame's gates refused, and which the filter was opened for.
#[derive(Clone, Copy, Debug, Default)]
pub(in crate::estimator) struct Gates {
    pub(in crate::estimator) rejected: [bool; 4],
    pub(in crate::estimator) reopened: [bool; 4],
}

/// One batch of scalar measurements with independent noise, fused one after the other.
pub(super) struct Correction<'a> {
    filter: &'a mut Filter,
    /// Sum of the corrections so far; the state moves once, at the end, because all derivatives belong to the same point.
    dx: State,
    gates: Gates,
}

impl<'a> Correction<'a> {
    pub(super) fn of(filter: &'a mut Filter) -> Self {
        Self {
            filter,
            dx: State::zeros(),
            gates: Gates::default(),
        }
    }

    /// Fuses one measurement: K = P hᵀ/s, P −= K s Kᵀ.
    pub(super) fn plain(&mut self, h: &[(usize, f64)], residual: f64, variance: f64) {
        let p_h = times(&self.filter.p, h);
        let s = dot(h, &p_h) + variance;
        self.fuse(&p_h, residual - dot(h, &self.dx), s);
    }

    /// Fuses one measurement unless its innovation is beyond the gate. A channel that stays beyond it for three frames is believed:
    /// the state it measures most directly is opened to it (a pivot, a push, an encoder that restarted).
    pub(super) fn gated(
        &mut self,
        channel: Channel,
        h: &[(usize, f64)],
        residual: f64,
        variance: f64,
    ) {
        let mut p_h = times(&self.filter.p, h);
        let mut s = dot(h, &p_h) + variance;
        let innovation = residual - dot(h, &self.dx);
        let streak = &mut self.filter.streaks[channel as usize];
        if innovation * innovation <= channel.gate() * s {
            *streak = 0;
        } else if *streak < STREAK_MAX {
            *streak += 1;
            self.gates.rejected[channel as usize] = true;
            return;
        } else {
            self.gates.reopened[channel as usize] = true;
            if channel == Channel::GyroUp {
                self.filter.pivoting = PIVOT_LINGERS;
            }
            let opened = channel.opened_state();
            self.filter.p[(opened, opened)] += innovation * innovation;
            *streak = streak.saturating_add(1);
            if channel == Channel::Encoder && *streak >= SPEED_DOUBTED {
                self.filter.p[(V, V)] += SPEED_DOUBT * SPEED_DOUBT;
                *streak = STREAK_MAX;
            }
            p_h = times(&self.filter.p, h);
            s = dot(h, &p_h) + variance;
        }
        self.fuse(&p_h, innovation, s);
    }

    fn fuse(&mut self, p_h: &State, innovation: f64, s: f64) {
        let gain = p_h / s;
        self.dx += gain * innovation;
        let (gain, p_h) = (&gain.data.0[0], &p_h.data.0[0]);
        for (column, weight) in self.filter.p.data.0.iter_mut().zip(gain) {
            for (entry, other) in column.iter_mut().zip(p_h) {
                *entry -= weight * other;
            }
        }
    }

    pub(super) fn finish(self) -> Gates {
        self.filter.x += self.dx;
        self.gates
    }
}

impl Channel {
    /// Gate on the squared innovation over its variance.
    ///
    /// Six standard deviations are beyond any white noise. The swing's acceleration is no white noise: full torque, 40 rad/s²,
    /// must pass at once, and shows in the gyro's left axis and in the encoder.
    fn gate(self) -> f64 {
        match self {
            Self::GyroForward | Self::GyroUp => 36.0,
            Self::GyroLeft | Self::Encoder => 144.0,
        }
    }

    fn opened_state(self) -> usize {
        match self {
            Self::GyroForward => Q_R_RATE,
            Self::GyroLeft => ALPHA_RATE,
            Self::GyroUp => PIVOT,
            Self::Encoder => SHELL,
        }
    }
}

/// P hᵀ for the few entries of h.
pub(super) fn times(p: &Covariance, h: &[(usize, f64)]) -> State {
    let mut sum = State::zeros();
    for &(state, weight) in h {
        for (entry, value) in sum.data.0[0].iter_mut().zip(&p.data.0[state]) {
            *entry += weight * value;
        }
    }
    sum
}

/// h x.
pub(super) fn dot(h: &[(usize, f64)], x: &State) -> f64 {
    h.iter().map(|&(state, weight)| weight * x[state]).sum()
}

/// Frames that a gate refuses in a row before the channel is believed.
const STREAK_MAX: u8 = 3;
/// Frames in a row in which the encoder contradicts the speed before the speed is doubted: half a second. By then a dead encoder
/// has long been reported as unhealthy; what is left is a speed that went wrong while frames were missing.
const SPEED_DOUBTED: u8 = 100;
/// How much it is doubted then [m/s].
const SPEED_DOUBT: f64 = 2.0;
