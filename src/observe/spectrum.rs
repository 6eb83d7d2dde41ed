use crate::engine::{EngineError, System};
use crate::model::{Model, Prestress};
use crate::stiffness::Stiffness;
use nalgebra::DMatrix;
use std::collections::BTreeMap;

/// The whole spectrum of the Hessian ∂²U/∂x∂x of a small system.
#[derive(Clone, Debug, Default, PartialEq, serde::Serialize)]
pub struct Spectrum {
    /// Ascending, in units of energy over length squared. On rank 0; empty elsewhere.
    pub eigenvalues: Vec<f64>,
    /// Those that are zero to rounding: the two shifts of the system, and the free motions of rattlers.
    pub n_zero: usize,
    /// Those below: directions in which the state is no minimum.
    pub n_negative: usize,
}

/// Relative to the largest eigenvalue, what counts as zero.
const ZERO: f64 = 1e-12;

/// Coordinates up to which all eigenvalues are found: a dense matrix, 32 MB and some seconds at this size.
pub const MAX_COORDINATES: u64 = 2000;

impl Spectrum {
    /// Of the present state; none of a system of more than [`MAX_COORDINATES`]. Collective.
    pub fn of<M: Model>(system: &mut System<M>) -> Result<Option<Spectrum>, EngineError> {
        if 2 * system.n_points() > MAX_COORDINATES {
            return Ok(None);
        }
        let stiffness = Stiffness::of(system, Prestress::ALL)?;
        // row, column and block of each entry, by global names
        let mut words = Vec::new();
        stiffness.for_each_block(system, |row, column, block| {
            words.extend([row, column]);
            words.extend(block.map(f64::to_bits));
        });
        let entries = system.comm.gather(words).concat();
        if !system.comm.is_root() {
            return Ok(Some(Spectrum::default()));
        }
        let names: BTreeMap<u64, usize> = {
            let mut rows: Vec<u64> = entries.chunks_exact(6).map(|entry| entry[0]).collect();
            rows.sort_unstable();
            rows.dedup();
            rows.into_iter().zip(0..).collect()
        };
        let mut matrix: DMatrix<f64> = DMatrix::zeros(2 * names.len(), 2 * names.len());
        for entry in entries.chunks_exact(6) {
            let (Some(&i), Some(&j)) = (names.get(&entry[0]), names.get(&entry[1])) else { continue };
            for k in 0..4 {
                matrix[(2 * i + k / 2, 2 * j + k % 2)] += f64::from_bits(entry[2 + k]);
            }
        }
        let mut eigenvalues: Vec<f64> = matrix.symmetric_eigenvalues().iter().copied().collect();
        eigenvalues.sort_unstable_by(f64::total_cmp);
        let limit = ZERO * eigenvalues.iter().fold(0.0, |m: f64, e| m.max(e.abs()));
        Ok(Some(Spectrum {
            n_zero: eigenvalues.iter().filter(|e| e.abs() <= limit).count(),
            n_negative: eigenvalues.iter().filter(|&&e| e < -limit).count(),
            eigenvalues,
        }))
    }
}
