use super::{Preconditioner, Stiffness};
use crate::comm::{EXTREMES, FusedSums, Totals};
use crate::engine::System;
use crate::geometry::{Vec2, add, dot, scale};
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

/// What is known of an approximate solution u of H u = b.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Solution {
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

/// Order-independent sums over all own points of all ranks. Collective.
pub fn sums<M: Model, const K: usize>(
    system: &System<M>,
    fused: &mut FusedSums<K>,
    terms: impl Fn(usize) -> [f64; K] + Sync,
) -> [f64; K] {
    loop {
        let grids = fused.grids;
        let partial = threads::map(system.chunks(), |chunk| {
            let mut totals = Totals::default();
            chunk.points.clone().for_each(|i| totals.add(&grids, terms(i), [0.0; EXTREMES]));
            totals
        });
        let mut totals = partial.into_iter().fold(Totals::default(), Totals::merged);
        system.comm.combine(&mut totals);
        if let Some(settled) = fused.settle(&totals) {
            return settled.sum;
        }
    }
}

/// x + s y, each of the `K` vectors of a point with its own factor.
fn added<const K: usize>(x: [Vec2; K], s: [f64; K], y: [Vec2; K]) -> [Vec2; K] {
    std::array::from_fn(|k| add(x[k], scale(s[k], y[k])))
}

/// Solves H u = b for `K` right-hand sides at the own points, side by side, each by preconditioned conjugate gradients
/// of its own. Collective.
///
/// H has zero modes: shifts of the whole system, and rattlers. Where b is the answer to a strain it has no part in
/// them, and neither has u beyond rounding.
pub fn solve<M: Model, const K: usize>(
    system: &mut System<M>,
    stiffness: &Stiffness,
    preconditioner: &Preconditioner,
    b: &[[Vec2; K]],
    goals: &[Goal; K],
) -> [Solution; K]
where
    [Vec2; K]: bytemuck::Pod + Default,
{
    let n = b.len();
    let zero = || vec![[[0.0; 2]; K]; n];
    let (mut u, mut z, mut q) = (zero(), zero(), zero());
    let mut r = b.to_vec();
    preconditioner.apply(system, &r, &mut z);
    let mut p = z.clone();
    let (mut of_curvature, mut of_residual) = (FusedSums::default(), FusedSums::default());
    let dots = |a: &[Vec2; K], b: &[Vec2; K]| std::array::from_fn(|k| dot(a[k], b[k]));
    let mut rz = sums(system, &mut of_residual, |i| dots(&r[i], &z[i]));
    let scale = rz;
    let mut solutions = [Solution::default(); K];
    loop {
        let runs: [bool; K] = std::array::from_fn(|k| {
            let Goal { tolerance, negligible, max_products } = goals[k];
            let Solution { products, is_unstable, .. } = solutions[k];
            !is_unstable && products < max_products && rz[k] > negligible.max(tolerance * tolerance * scale[k])
        });
        if !runs.contains(&true) {
            break;
        }
        stiffness.product(system, &mut p, &mut q);
        let pq: [f64; K] = sums(system, &mut of_curvature, |i| dots(&p[i], &q[i]));
        // one that has ended stays where it is
        let mut step = [0.0; K];
        for k in (0..K).filter(|&k| runs[k]) {
            solutions[k].products += 1;
            solutions[k].is_unstable = pq[k] <= 0.0;
            step[k] = if pq[k] > 0.0 { rz[k] / pq[k] } else { 0.0 };
        }
        let back = step.map(|s| -s);
        for i in 0..n {
            u[i] = added(u[i], step, p[i]);
            r[i] = added(r[i], back, q[i]);
        }
        preconditioner.apply(system, &r, &mut z);
        let next = sums(system, &mut of_residual, |i| dots(&r[i], &z[i]));
        let keep = std::array::from_fn(|k| if runs[k] { next[k] / rz[k] } else { 0.0 });
        for i in 0..n {
            p[i] = added(z[i], keep, p[i]);
        }
        rz = next;
    }
    let work: [f64; K] = sums(system, &mut FusedSums::default(), |i| dots(&b[i], &u[i]));
    for (k, solution) in solutions.iter_mut().enumerate() {
        solution.work = work[k];
        solution.residual = if rz[k] > goals[k].negligible { (rz[k] / scale[k]).sqrt() } else { 0.0 };
    }
    solutions
}
