use super::{Preconditioner, Stiffness};
use crate::comm::{EXTREMES, FusedSums, Totals};
use crate::engine::System;
use crate::geometry::{Vec2, dot};
use crate::model::Model;
use crate::threads;

/// When a solution is good enough.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Goal {
    /// Largest residual relative to the right-hand side, both in the norm of the preconditioner.
    pub tolerance: f64,
    /// A residual whose square in that norm, an energy, is below this is rounding: it counts as none.
    pub negligible: f64,
    pub max_products: u64,
}

/// An approximate solution u of H u = b.
#[derive(Clone, Debug, PartialEq)]
pub struct Solution {
    pub u: Vec<Vec2>,
    /// b·u
    pub work: f64,
    /// Products with H that it took.
    pub products: u64,
    /// Residual reached, relative to b, in the norm of the preconditioner.
    pub residual: f64,
    /// A direction p with p·H p < 0 was met: the state is no minimum, and u is where that happened.
    pub is_unstable: bool,
}

impl Solution {
    pub fn is_converged(&self, goal: &Goal) -> bool {
        !self.is_unstable && self.residual <= goal.tolerance
    }
}

/// An order-independent sum over all own points of all ranks. Collective.
pub fn sum<M: Model>(system: &System<M>, fused: &mut FusedSums<1>, term: impl Fn(usize) -> f64 + Sync) -> f64 {
    loop {
        let grids = fused.grids;
        let partial = threads::map(system.chunks(), |chunk| {
            let mut totals = Totals::default();
            chunk.points.clone().for_each(|i| totals.add(&grids, [term(i)], [0.0; EXTREMES]));
            totals
        });
        let mut totals = partial.into_iter().fold(Totals::default(), Totals::merged);
        system.comm.combine(&mut totals);
        if let Some(settled) = fused.settle(&totals) {
            return settled.sum[0];
        }
    }
}

/// Solves H u = b for the own points by preconditioned conjugate gradients. Collective.
///
/// H has zero modes: shifts of the whole system, and rattlers. Where b is the answer to a strain it has no part in
/// them, and neither has u beyond rounding.
pub fn solve<M: Model>(
    system: &mut System<M>,
    stiffness: &Stiffness,
    preconditioner: &Preconditioner,
    b: &[Vec2],
    goal: &Goal,
) -> Solution {
    let n = b.len();
    let mut u = vec![[0.0; 2]; n];
    let mut r = b.to_vec();
    let (mut z, mut q) = (vec![[0.0; 2]; n], vec![[0.0; 2]; n]);
    preconditioner.apply(system, &r, &mut z);
    let mut p = z.clone();
    let (mut of_curvature, mut of_residual) = (FusedSums::default(), FusedSums::default());
    let mut rz = sum(system, &mut of_residual, |i| dot(r[i], z[i]));
    let scale = rz;
    let mut products = 0;
    let mut is_unstable = false;
    while products < goal.max_products && rz > goal.negligible.max(goal.tolerance * goal.tolerance * scale) {
        stiffness.product(system, &mut p, &mut q);
        products += 1;
        let pq = sum(system, &mut of_curvature, |i| dot(p[i], q[i]));
        if pq <= 0.0 {
            is_unstable = true;
            break;
        }
        let step = rz / pq;
        for i in 0..n {
            u[i] = [u[i][0] + step * p[i][0], u[i][1] + step * p[i][1]];
            r[i] = [r[i][0] - step * q[i][0], r[i][1] - step * q[i][1]];
        }
        preconditioner.apply(system, &r, &mut z);
        let next = sum(system, &mut of_residual, |i| dot(r[i], z[i]));
        let keep = next / rz;
        for i in 0..n {
            p[i] = [z[i][0] + keep * p[i][0], z[i][1] + keep * p[i][1]];
        }
        rz = next;
    }
    let work = sum(system, &mut FusedSums::default(), |i| dot(b[i], u[i]));
    let residual = if rz > goal.negligible { (rz / scale).sqrt() } else { 0.0 };
    Solution { u, work, products, residual, is_unstable }
}
