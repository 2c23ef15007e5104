//! Fuses scalar measurements one after the other, behind gates.

use arrayvec::ArrayVec;

use super::{
    ALPHA, ALPHA_RATE, Column, Covariance, Filter, PIVOT, PIVOT_LINGERS, Q_R_RATE, SHELL, STATES, V,
};

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
///
/// P is changed once, at the end: until then it stands as P − Σ w wᵀ, with w = P hᵀ/√s of each measurement fused so far.
pub(super) struct Correction<'a> {
    filter: &'a mut Filter,
    /// Sum of the corrections so far; the state moves once, at the end, because all derivatives belong to the same point.
    dx: Column,
    fused: ArrayVec<Column, FUSED_MAX>,
    gates: Gates,
}

impl<'a> Correction<'a> {
    pub(super) fn of(filter: &'a mut Filter) -> Self {
        Self {
            filter,
            dx: [0.0; STATES],
            fused: ArrayVec::new(),
            gates: Gates::default(),
        }
    }

    /// Fuses one measurement: K = P hᵀ/s, P −= K s Kᵀ.
    #[inline(always)]
    pub(super) fn plain<const N: usize>(
        &mut self,
        h: &[(usize, f64); N],
        residual: f64,
        variance: f64,
    ) {
        let p_h = self.times(h);
        let s = dot(h, &p_h) + variance;
        self.fuse(&p_h, residual - dot(h, &self.dx), s);
    }

    /// Fuses one measurement unless its innovation is beyond the gate. A channel that stays beyond it for three frames is believed:
    /// the state it measures most directly is opened to it (a pivot, a push, an encoder that restarted).
    #[inline(always)]
    pub(super) fn gated<const N: usize>(
        &mut self,
        channel: Channel,
        h: &[(usize, f64); N],
        residual: f64,
        variance: f64,
    ) {
        let mut p_h = self.times(h);
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
            self.open(channel, innovation);
            p_h = self.times(h);
            s = dot(h, &p_h) + variance;
        }
        self.fuse(&p_h, innovation, s);
    }

    /// Admits that the swing was accelerated by more than its noise allows, where an innovation of the gyro's left axis (`h`, `residual`)
    /// shows so and stays within `reach`, what motor and weight can do in `dt` [s].
    ///
    /// The white acceleration of that one interval is raised to what is seen, α and α̇ together: the state follows at once. Without it
    /// both lag behind full torque for as long as it lasts, and gyro and encoder are taken for sensors that contradict themselves.
    #[inline(always)]
    pub(super) fn admit_swing<const N: usize>(
        &mut self,
        h: &[(usize, f64); N],
        residual: f64,
        variance: f64,
        dt: f64,
        reach: f64,
    ) {
        let innovation = residual - dot(h, &self.dx);
        let square = innovation * innovation;
        // The cheap question first: it settles nearly every frame.
        if square <= SWING_GATE * variance || innovation.abs() > reach {
            return;
        }
        let p_h = self.times(h);
        if square <= SWING_GATE * (dot(h, &p_h) + variance) {
            return;
        }
        let p = &mut self.filter.p;
        p[(ALPHA, ALPHA)] += square * dt * dt / 3.0;
        p[(ALPHA, ALPHA_RATE)] += square * dt / 2.0;
        p[(ALPHA_RATE, ALPHA)] += square * dt / 2.0;
        p[(ALPHA_RATE, ALPHA_RATE)] += square;
    }

    pub(super) fn finish(mut self) -> Gates {
        self.change_covariance();
        for (x, dx) in self.filter.x.data.0[0].iter_mut().zip(&self.dx) {
            *x += dx;
        }
        self.gates
    }

    /// Opens what a channel measures to an innovation that its gate has refused for too long.
    #[cold]
    fn open(&mut self, channel: Channel, innovation: f64) {
        self.gates.reopened[channel as usize] = true;
        if channel == Channel::GyroUp {
            self.filter.pivoting = PIVOT_LINGERS;
        }
        let opened = channel.opened_state();
        self.filter.p[(opened, opened)] += innovation * innovation;
        let streak = &mut self.filter.streaks[channel as usize];
        *streak = streak.saturating_add(1);
        if channel == Channel::Encoder && *streak >= SPEED_DOUBTED {
            self.filter.p[(V, V)] += SPEED_DOUBT * SPEED_DOUBT;
            *streak = STREAK_MAX;
        }
    }

    /// P hᵀ for the few entries of h, with P as it stands.
    #[inline(always)]
    fn times<const N: usize>(&self, h: &[(usize, f64); N]) -> Column {
        let mut sum = times(&self.filter.p, h);
        for w in &self.fused {
            let share = dot(h, w);
            for (sum, w) in sum.iter_mut().zip(w) {
                *sum -= share * w;
            }
        }
        sum
    }

    fn fuse(&mut self, p_h: &Column, innovation: f64, s: f64) {
        if self.fused.is_full() {
            self.change_covariance();
        }
        let per_root = 1.0 / s.sqrt();
        let w = p_h.map(|p_h| p_h * per_root);
        let pull = innovation * per_root;
        for (dx, w) in self.dx.iter_mut().zip(&w) {
            *dx += pull * w;
        }
        self.fused.push(w);
    }

    /// P −= Σ w wᵀ: symmetric to the last bit, because products commute. Half of it would cost more: its loops do not fill the
    /// processor's registers evenly.
    fn change_covariance(&mut self) {
        for (j, column) in self.filter.p.data.0.iter_mut().enumerate() {
            for w in &self.fused {
                let weight = w[j];
                for (entry, w) in column.iter_mut().zip(w) {
                    *entry -= weight * w;
                }
            }
        }
        self.fused.clear();
    }
}

impl Channel {
    /// Gate on the squared innovation over its variance.
    ///
    /// Six standard deviations are beyond any white noise. The swing's acceleration is no white noise, and shows in the gyro's left axis
    /// and in the encoder: what [`Correction::admit_swing`] does not admit, because frames are missing, has more room here.
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
#[inline(always)]
pub(super) fn times<const N: usize>(p: &Covariance, h: &[(usize, f64); N]) -> Column {
    let p = &p.data.0;
    core::array::from_fn(|j| h.iter().map(|&(state, weight)| weight * p[state][j]).sum())
}

/// h x.
#[inline(always)]
pub(super) fn dot<const N: usize>(h: &[(usize, f64); N], x: &Column) -> f64 {
    h.iter().map(|&(state, weight)| weight * x[state]).sum()
}

/// The most measurements that one frame gives: gyro, encoder, floor, and three rates at rest.
const FUSED_MAX: usize = 8;
/// Squared innovation over its variance beyond which the swing was accelerated: of white noise one frame in 16 000 is.
const SWING_GATE: f64 = 16.0;
/// Frames that a gate refuses in a row before the channel is believed.
const STREAK_MAX: u8 = 3;
/// Frames in a row in which the encoder contradicts the speed before the speed is doubted: half a second. By then a dead encoder
/// has long been reported as unhealthy; what is left is a speed that went wrong while frames were missing.
const SPEED_DOUBTED: u8 = 100;
/// How much it is doubted then [m/s].
const SPEED_DOUBT: f64 = 2.0;
