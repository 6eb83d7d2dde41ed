use super::Stiffness;
use crate::engine::System;
use crate::geometry::{Vec2, add, scale};
use crate::model::Model;
use crate::threads;
use nalgebra::{Cholesky, DMatrix};

/// The inverse of each particle's own block of the Hessian, the other particles held in place.
pub struct Preconditioner {
    /// One dense symmetric matrix after another, over the coordinates of each particle's points.
    inverse: Vec<f64>,
    start: Vec<usize>,
}

/// Blocks of particles that nothing holds (rattlers) are singular: this much of their largest diagonal element is
/// added to all diagonals, far below what matters for the others.
const SHIFT: f64 = 1e-8;

impl Preconditioner {
    pub fn of<M: Model>(system: &System<M>, stiffness: &Stiffness) -> Self {
        let particles = system.particles();
        let parts = threads::map(system.chunks(), |chunk| {
            let mut inverses = Vec::new();
            for p in chunk.particles.clone() {
                let points = particles.bodies.points(p);
                let n = 2 * points.len();
                let mut block = DMatrix::zeros(n, n);
                for (i, point) in points.clone().enumerate() {
                    for (column, b) in stiffness.row(point) {
                        let Some(j) = (*column as usize).checked_sub(points.start).filter(|&j| 2 * j < n) else {
                            continue;
                        };
                        for k in 0..4 {
                            block[(2 * i + k / 2, 2 * j + k % 2)] += b[k];
                        }
                    }
                }
                if M::BODIES {
                    let g: Vec<f64> = stiffness.area_gradient[points].iter().flatten().copied().collect();
                    for i in 0..n {
                        for j in 0..n {
                            block[(i, j)] += stiffness.area_stiffness * g[i] * g[j];
                        }
                    }
                }
                inverses.extend(inverted(block).iter());
            }
            inverses
        });
        let mut start = vec![0];
        for p in 0..particles.len() {
            let n = 2 * particles.bodies.points(p).len();
            start.push(start[p] + n * n);
        }
        Preconditioner { inverse: parts.concat(), start }
    }

    /// Multiplies `K` residuals of each own point.
    pub fn apply<M: Model, const K: usize>(
        &self,
        system: &System<M>,
        residual: &[[Vec2; K]],
        result: &mut [[Vec2; K]],
    ) {
        let particles = system.particles();
        let nothing = &mut vec![(); result.len()]; // zero-sized: no memory behind it
        threads::fold(
            system.chunks(),
            result,
            nothing,
            &|chunk, result, _| {
                for p in chunk.particles.clone() {
                    let points = particles.bodies.points(p);
                    let matrix = &self.inverse[self.start[p]..self.start[p + 1]];
                    let mine = points.start - chunk.points.start..points.end - chunk.points.start;
                    let (residual, result) = (&residual[points.clone()], &mut result[mine]);
                    result.fill([[0.0; 2]; K]);
                    // symmetric: columns are rows
                    for (j, row) in matrix.chunks_exact(2 * points.len()).enumerate() {
                        for (sums, m) in result.iter_mut().zip(row.as_chunks::<2>().0) {
                            for (sum, r) in sums.iter_mut().zip(&residual[j / 2]) {
                                *sum = add(*sum, scale(r[j % 2], *m));
                            }
                        }
                    }
                }
            },
            &|(), ()| (),
        );
    }
}

/// The inverse of a symmetric block, shifted until it is positive definite.
fn inverted(block: DMatrix<f64>) -> DMatrix<f64> {
    let n = block.nrows();
    let largest = block.diagonal().iter().fold(0.0, |m: f64, d| m.max(d.abs()));
    if largest == 0.0 {
        return DMatrix::identity(n, n);
    }
    let mut shift = SHIFT * largest;
    loop {
        let shifted = &block + DMatrix::identity(n, n) * shift;
        if let Some(factor) = Cholesky::new(shifted) {
            let inverse = factor.inverse();
            return 0.5 * (&inverse + inverse.transpose());
        }
        shift *= 10.0;
        if !shift.is_finite() {
            return DMatrix::identity(n, n);
        }
    }
}
