//! What the paper says: tables 1 and 2, and the numbers of its text.

use crate::scene::Model;

/// Amplitudes of x^0.5 and x^1 in Δz (table 1) and G (table 2).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Row {
    pub contacts: [f64; 2],
    pub modulus: [f64; 2],
    pub onset: f64,
}

pub const SP_PHI: Row = Row { contacts: [3.7, 0.0], modulus: [0.42, 0.0], onset: 0.84 };
pub const SP_RHO: Row = Row { contacts: [2.6, 4.0], modulus: [0.38, 0.35], onset: 0.84 };
/// Its moduli are in ε_r/l²; see docs/study.md.
pub const DP_RHO: Row = Row { contacts: [3.3, 7.1], modulus: [0.07, 1.7], onset: 0.835 };

/// z at onset, ± 0.005.
pub const Z_ONSET: f64 = 3.97;
/// Spread of φ_J ∝ N^−θ, and its limit.
pub const THETA: f64 = 0.55;
pub const ONSET_LIMIT: f64 = 0.842;
/// Of single power laws of Δz and G for deformable particles at Δρ > 10⁻².
pub const SINGLE_POWER: f64 = 0.8;
/// φ − ρ ∝ (U/N)^κ
pub const KAPPA: f64 = 0.75;
/// Δρ = C (Δφ − Δφ^1.5)
pub const C: f64 = 1.21;
/// 1 − ⟨a⟩/a_J ∝ Δρ^ζ, at small and at large Δρ.
pub const ZETA: [f64; 2] = [1.5, 2.5];
/// Δφ ∝ (𝒜 − 1)^λ
pub const LAMBDA: f64 = 0.67;
/// Crossover Δφ* ∝ N^−2
pub const CROSSOVER: f64 = 2.0;
/// Fractions of voids with 3, 4, 5 and 6 sides at onset.
pub const VOIDS: [f64; 4] = [0.4, 0.4, 0.18, 0.02];
/// 𝒜 of the void between three touching arcs: π/(4√3 − 2π).
pub const PLATEAU: f64 = 4.8706;

/// Δρ ∝ (𝒜 − 1)^ω, at small and at large 𝒜 − 1.
pub fn omega(model: Model) -> [f64; 2] {
    match model {
        Model::Sp => [0.66, 0.3],
        Model::Dp => [1.0, 0.3],
    }
}

impl Row {
    pub fn of(model: Model) -> Row {
        match model {
            Model::Sp => SP_RHO,
            Model::Dp => DP_RHO,
        }
    }
}
