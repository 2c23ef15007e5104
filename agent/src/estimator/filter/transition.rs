//! P = F P Fᵀ for a transition of few entries.

use super::{
    ALPHA, Column, Columns, GYRO_BIAS, HEADING, PIVOT, Q_R, Q_R_RATE, SHELL, STATES, V, X, Y,
};

/// The rows of F − I that are not zero, as (column, entry). The swing's rate and the biases stay as they are.
pub(super) struct Transition {
    pub(super) q_r: [(usize, f64); 1],
    pub(super) q_r_rate: [(usize, f64); 7],
    pub(super) alpha: [(usize, f64); 1],
    pub(super) heading: [(usize, f64); 3],
    pub(super) pivot: [(usize, f64); 1],
    pub(super) shell: [(usize, f64); 2],
    pub(super) v: [(usize, f64); 7],
    pub(super) x: [(usize, f64); 3],
    pub(super) y: [(usize, f64); 3],
}

/// States that a transition changes: the ones before the biases.
const MOVING: usize = GYRO_BIAS;

impl Transition {
    /// P = F P Fᵀ, of a P that is symmetric to the last bit; so is the result.
    #[inline(always)]
    pub(super) fn carry(&self, p: &mut Columns) {
        // F P: its rows for the states that move; the others are those of P.
        let mut rows = [[0.0; STATES]; MOVING];
        rows.copy_from_slice(&p[..MOVING]);
        add(&mut rows[Q_R], p, &self.q_r);
        add(&mut rows[Q_R_RATE], p, &self.q_r_rate);
        add(&mut rows[ALPHA], p, &self.alpha);
        add(&mut rows[HEADING], p, &self.heading);
        add(&mut rows[PIVOT], p, &self.pivot);
        add(&mut rows[SHELL], p, &self.shell);
        add(&mut rows[V], p, &self.v);
        add(&mut rows[X], p, &self.x);
        add(&mut rows[Y], p, &self.y);
        // (F P) Fᵀ is F on each row of F P. Of the moving states one half is kept, and mirrored.
        for (i, row) in rows.iter().enumerate() {
            let moved = self.times(row);
            p[i][MOVING..].copy_from_slice(&row[MOVING..]);
            for j in 0..MOVING {
                if j <= i {
                    p[i][j] = moved[j];
                    p[j][i] = moved[j];
                }
            }
            for j in MOVING..STATES {
                p[j][i] = row[j];
            }
        }
    }

    /// F x.
    #[inline(always)]
    fn times(&self, x: &Column) -> [f64; MOVING] {
        let mut moved = [0.0; MOVING];
        moved.copy_from_slice(&x[..MOVING]);
        moved[Q_R] += dot(&self.q_r, x);
        moved[Q_R_RATE] += dot(&self.q_r_rate, x);
        moved[ALPHA] += dot(&self.alpha, x);
        moved[HEADING] += dot(&self.heading, x);
        moved[PIVOT] += dot(&self.pivot, x);
        moved[SHELL] += dot(&self.shell, x);
        moved[V] += dot(&self.v, x);
        moved[X] += dot(&self.x, x);
        moved[Y] += dot(&self.y, x);
        moved
    }
}

/// Adds to a row the rows of P that `terms` name, each times its entry.
#[inline(always)]
fn add<const N: usize>(row: &mut Column, p: &Columns, terms: &[(usize, f64); N]) {
    for (j, sum) in row.iter_mut().enumerate() {
        for &(state, entry) in terms {
            *sum += entry * p[state][j];
        }
    }
}

#[inline(always)]
fn dot<const N: usize>(terms: &[(usize, f64); N], x: &Column) -> f64 {
    terms.iter().map(|&(state, entry)| entry * x[state]).sum()
}
