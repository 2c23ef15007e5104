//! Conditions of stability on gains, each with the numbers of one robot.

use core::fmt;

use crate::model::{NominalModel, PlanarInertia};

/// How the value of a [`Condition`] must compare with its bound.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Relation {
    /// value < bound.
    Below,
    /// value > bound.
    Above,
    /// value ≥ bound.
    AtLeast,
}

/// One condition on a set of gains, with the numbers of this robot.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Condition {
    /// Its short name, `E2`.
    pub name: &'static str,
    /// What it says and what happens otherwise, a sentence.
    pub says: &'static str,
    /// The left side as a formula.
    pub value_of: &'static str,
    /// Its value, in `unit`.
    pub value: f64,
    /// How they must compare.
    pub relation: Relation,
    /// The right side as a formula.
    pub bound_of: &'static str,
    /// Its value, in `unit`; may be infinite.
    pub bound: f64,
    /// Unit of value, bound and margin.
    pub unit: &'static str,
    /// Distance to the bound, ≥ 0 on the good side.
    pub margin: f64,
    /// Whether it holds; NaN does not.
    pub holds: bool,
}

impl Condition {
    /// Compares `value` with `bound`, each with the formula that gave it.
    pub fn new(
        name: &'static str,
        says: &'static str,
        (value_of, value): (&'static str, f64),
        relation: Relation,
        (bound_of, bound): (&'static str, f64),
        unit: &'static str,
    ) -> Self {
        let margin = match relation {
            Relation::Below => bound - value,
            Relation::Above | Relation::AtLeast => value - bound,
        };
        let holds = match relation {
            Relation::Below => value < bound,
            Relation::Above => value > bound,
            Relation::AtLeast => value >= bound,
        };
        Self {
            name,
            says,
            value_of,
            value,
            relation,
            bound_of,
            bound,
            unit,
            margin,
            holds,
        }
    }
}

impl fmt::Display for Relation {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(match self {
            Self::Below => "below",
            Self::Above => "above",
            Self::AtLeast => "at least",
        })
    }
}

impl fmt::Display for Condition {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "{}: {} = {:.4} {} {} {} = {:.4} [{}] ({})",
            self.name,
            self.value_of,
            self.value,
            if self.holds { "is" } else { "must be" },
            self.relation,
            self.bound_of,
            self.bound,
            self.unit,
            self.says
        )
    }
}

/// E2, the half that the paper has right: both surfaces count.
pub(super) fn ratio_lower(ratio: f64) -> Condition {
    Condition::new(
        "E2",
        "both surfaces must count, A, B > 0",
        ("A/B", ratio),
        Relation::Above,
        ("0", 0.0),
        "1",
    )
}

/// E2: the input gain A b₂ + B b₁ must be positive.
pub(super) fn ratio_upper(ratio: f64, inertia: &PlanarInertia) -> Condition {
    Condition::new(
        "E2",
        "the torque must push S the way the law believes: beyond it the robot diverges",
        ("A/B", ratio),
        Relation::Below,
        ("(d − c)/(c − a)", inertia.ratio_max()),
        "1",
    )
}

/// Largest k_i for which (P − Q) s⁴ + (P λ₂ − Q λ₁) s³ + (G − Q k_i) s² + G λ₁ s + G k_i is stable (Routh), given P > Q, λ₂ > λ₁, at rest [1/s²].
pub(super) fn integral_max(
    ratio: f64,
    lambda1: f64,
    lambda2: f64,
    inertia: &PlanarInertia,
    model: &NominalModel,
) -> f64 {
    let p = (inertia.d - inertia.c) / ratio;
    let q = inertia.c - inertia.a;
    model.righting * lambda1 * (lambda2 - lambda1) / (lambda2 * (p * lambda2 - q * lambda1))
}

#[cfg(test)]
mod tests {
    use nalgebra::Matrix4;
    use sphere_protocol::robot::Robot;

    use super::*;

    /// The bound against the roots of the polynomial themselves: 2 % below it all decay, 2 % above it a pair grows.
    #[test]
    fn integral_bound_is_where_the_roots_cross() {
        let robot = Robot::embedded("liu").expect("embedded");
        let model = NominalModel::new(&robot.params);
        let inertia = model.roll_inertia(0.0);
        let (ratio, lambda1, lambda2) = (5.2, 2.5, 6.5);
        let bound = integral_max(ratio, lambda1, lambda2, &inertia, &model);
        let growth = |k_i: f64| {
            let p = (inertia.d - inertia.c) / ratio;
            let q = inertia.c - inertia.a;
            let lead = p - q;
            let [a3, a2, a1, a0] = [
                p * lambda2 - q * lambda1,
                model.righting - q * k_i,
                model.righting * lambda1,
                model.righting * k_i,
            ]
            .map(|coefficient| -coefficient / lead);
            #[rustfmt::skip]
            let companion = Matrix4::new(
                a3, a2, a1, a0,
                1.0, 0.0, 0.0, 0.0,
                0.0, 1.0, 0.0, 0.0,
                0.0, 0.0, 1.0, 0.0,
            );
            let roots = companion.complex_eigenvalues();
            roots
                .iter()
                .map(|root| root.re)
                .fold(f64::NEG_INFINITY, f64::max)
        };
        assert!(growth(0.98 * bound) < 0.0, "{}", growth(0.98 * bound));
        assert!(growth(1.02 * bound) > 0.0, "{}", growth(1.02 * bound));
    }
}
