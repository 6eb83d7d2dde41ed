//! The Hessian of a system's energy as rows of small blocks, its products with vectors, and linear systems with it.
//!
//! Like forces, the rows of a point live on its owner and are summed in the order of global ids, so that products and
//! solutions are the same bits on any number of ranks and threads.

mod cholesky;
mod preconditioner;
mod solve;

pub use cholesky::Cholesky;
pub use preconditioner::Preconditioner;
pub use solve::{Goal, Solution, solve, sums};

use crate::engine::{EngineError, System};
use crate::geometry::{Polygon, Vec2, add, dot, scale, sub};
use crate::model::{Ahead, Block, Elastic, Model, Prestress, strained, times};
use crate::particles::Particles;
use crate::threads;

/// H = ∂²U/∂x∂x in the present state of a system, for its present lists.
#[derive(PartialEq)]
pub struct Stiffness {
    /// Where the entries of each own point's row begin.
    start: Vec<usize>,
    /// Column (a point, own or foreign) and block.
    entries: Vec<(u32, Block)>,
    /// ∇a of the particle by each own point, and k: the part k ∇a ∇aᵀ of H. Empty for disks.
    area_gradient: Vec<Vec2>,
    area_stiffness: f64,
}

impl Stiffness {
    /// Assembles H, the part that the present contact forces contribute by turning as far as `prestress` says. Collective.
    pub fn of<M: Model>(system: &mut System<M>, prestress: Prestress) -> Result<Self, EngineError> {
        system.prepare()?;
        let (view, model) = (system.view(), &system.model);
        Ok(Self::assemble(system, |p, rows, _| {
            model.stiffness(&view, p, prestress, |point, column, block| rows[point].push((column, block)));
        })
        .0)
    }

    /// The same with the contacts that are left when own points move by `displacement`
    /// ([`Model::stiffness_ahead`]), and by how much the forces on the own points then differ. Call
    /// [`System::prepare_for_reach`] first. Collective.
    pub fn ahead<M: Model>(system: &mut System<M>, prestress: Prestress, displacement: &[Vec2]) -> (Self, Vec<Vec2>) {
        let displacement = system.share(displacement.to_vec());
        let (view, model) = (system.view(), &system.model);
        let ahead = Ahead { displacement: &displacement, reach: system.reach() };
        Self::assemble(system, |p, rows, changes| {
            let add = |point: usize, column, block| rows[point].push((column, block));
            let push = |point: usize, force: Vec2| changes[point] = self::add(changes[point], force);
            model.stiffness_ahead(&view, p, prestress, &ahead, add, push);
        })
    }

    /// `visit(particle, rows, changes)` adds the blocks of a particle's rows and the changes of the forces on its points.
    fn assemble<M: Model>(
        system: &System<M>,
        visit: impl Fn(usize, &mut [Vec<(u32, Block)>], &mut [Vec2]) + Sync,
    ) -> (Self, Vec<Vec2>) {
        let (view, particles, model) = (system.view(), system.particles(), &system.model);
        let name = names(particles); // the order of sums

        let parts = threads::map(system.chunks(), |chunk| {
            let (mut lengths, mut entries) = (Vec::new(), Vec::<(u32, Block)>::new());
            let mut gradient = vec![[0.0; 2]; if M::BODIES { chunk.points.len() } else { 0 }];
            let mut weight = 0.0;
            let mut rows: Vec<Vec<(u32, Block)>> = Vec::new();
            let mut changes = vec![[0.0; 2]; chunk.points.len()];
            for p in chunk.particles.clone() {
                let points = particles.bodies.points(p);
                rows.resize(rows.len().max(points.len()), Vec::new());
                let mine = points.start - chunk.points.start..points.end - chunk.points.start;
                visit(p, &mut rows, &mut changes[mine.clone()]);
                for row in &mut rows[..points.len()] {
                    row.sort_by_key(|&(column, _)| name[column as usize]); // stable: a sum keeps its order
                    let before = entries.len();
                    for (column, block) in row.drain(..) {
                        match entries[before..].last_mut() {
                            Some((last, sum)) if *last == column => *sum = std::array::from_fn(|k| sum[k] + block[k]),
                            _ => entries.push((column, block)),
                        }
                    }
                    lengths.push(entries.len() - before);
                }
                if M::BODIES {
                    weight = model.area_stiffness(&view, p, &mut gradient[mine]);
                }
            }
            (lengths, entries, gradient, weight, changes)
        });
        let mut whole =
            Stiffness { start: vec![0], entries: Vec::new(), area_gradient: Vec::new(), area_stiffness: 0.0 };
        whole.entries.reserve_exact(parts.iter().map(|part| part.1.len()).sum());
        let mut changes = Vec::new();
        for (lengths, entries, gradient, weight, chunk_changes) in parts {
            for length in lengths {
                whole.start.push(whole.start.last().map_or(0, |s| s + length));
            }
            whole.entries.extend(entries);
            whole.area_gradient.extend(gradient);
            whole.area_stiffness = weight;
            changes.extend(chunk_changes);
        }
        (whole, changes)
    }

    /// Visits all blocks in the rows of own points, a diagonal one of each point among them, by the global names of
    /// the points of row and column. Blocks of one row and column add up.
    pub fn for_each_block<M: Model>(&self, system: &System<M>, mut visit: impl FnMut(u64, u64, Block)) {
        let particles = system.particles();
        let name = names(particles);
        for p in 0..particles.len() {
            let points = particles.bodies.points(p);
            for point in points.clone() {
                visit(name[point], name[point], [0.0; 4]);
                self.row(point).iter().for_each(|&(column, block)| visit(name[point], name[column as usize], block));
                for other in points.clone().filter(|_| M::BODIES) {
                    let (g, h) = (self.area_gradient[point], self.area_gradient[other]);
                    let product = [g[0] * h[0], g[0] * h[1], g[1] * h[0], g[1] * h[1]];
                    visit(name[point], name[other], product.map(|x| self.area_stiffness * x));
                }
            }
        }
    }

    fn row(&self, point: usize) -> &[(u32, Block)] {
        &self.entries[self.start[point]..self.start[point + 1]]
    }

    /// H u of `K` vectors u for the own points. `u` holds them for each own point, then for each foreign point; the
    /// foreign ones are refreshed from their owners. Several at a time cost little more than one: what takes time is
    /// to fetch the blocks. Collective.
    pub fn product<M: Model, const K: usize>(
        &self,
        system: &mut System<M>,
        u: &mut Vec<[Vec2; K]>,
        product: &mut [[Vec2; K]],
    ) where
        [Vec2; K]: bytemuck::Pod + Default,
    {
        system.refresh(u);
        let particles = system.particles();
        let nothing = &mut vec![(); product.len()]; // zero-sized: no memory behind it
        threads::fold(
            system.chunks(),
            product,
            nothing,
            &|chunk, product, _| {
                for (slot, point) in product.iter_mut().zip(chunk.points.clone()) {
                    *slot = [[0.0; 2]; K];
                    for (column, block) in self.row(point) {
                        for (sum, &u) in slot.iter_mut().zip(&u[*column as usize]) {
                            *sum = add(*sum, times(block, u));
                        }
                    }
                }
                if !M::BODIES {
                    return;
                }
                for p in chunk.particles.clone() {
                    let points = particles.bodies.points(p);
                    let gradient = &self.area_gradient[points.clone()];
                    let mine = points.start - chunk.points.start..points.end - chunk.points.start;
                    let product = &mut product[mine];
                    for k in 0..K {
                        let change: f64 = gradient.iter().zip(&u[points.clone()]).map(|(&g, u)| dot(g, u[k])).sum();
                        let push = self.area_stiffness * change;
                        for (slot, &g) in product.iter_mut().zip(gradient) {
                            slot[k] = add(slot[k], scale(push, g));
                        }
                    }
                }
            },
            &|(), ()| (),
        );
    }

    /// Change of the forces on the own points with the strain, −∂²U/∂x∂E, all points taken along affinely; for each of
    /// the components xx, xy, yx, yy.
    pub fn affine_forces<M: Model>(&self, system: &System<M>) -> [Vec<Vec2>; 4] {
        let (view, particles) = (system.view(), system.particles());
        let rows = threads::map(system.chunks(), |chunk| {
            let mut rows = Vec::with_capacity(chunk.points.len());
            for p in chunk.particles.clone() {
                let area =
                    if M::BODIES { Polygon::from_vertices(view.pbox, particles.points_of(p)).area() } else { 0.0 };
                for point in particles.bodies.points(p) {
                    // rows sum to zero, so only distances count
                    let mut sum = [[0.0; 2]; 4];
                    for (column, block) in self.row(point) {
                        let r = view.displacement(*column, point as u32);
                        for (k, sum) in sum.iter_mut().enumerate() {
                            *sum = sub(*sum, times(block, strained(k, r)));
                        }
                    }
                    if M::BODIES {
                        // the area changes by a tr E
                        let push = scale(self.area_stiffness * area, self.area_gradient[point]);
                        for k in [0, 3] {
                            sum[k] = sub(sum[k], push);
                        }
                    }
                    rows.push(sum);
                }
            }
            rows
        })
        .concat();
        std::array::from_fn(|k| rows.iter().map(|row| row[k]).collect())
    }
}

/// Global name of every own and foreign point: id of its particle, and its place there.
fn names(particles: &Particles) -> Vec<u64> {
    let mut names = Vec::with_capacity(particles.position.len());
    for p in 0..particles.len() {
        let id = (particles.id[p] as u64) << 32;
        names.extend((0..particles.bodies.points(p).len() as u64).map(|k| id | k));
    }
    names.extend(particles.foreign.iter().map(|f| (f.id as u64) << 32 | f.index as u64));
    names
}

/// Second derivatives of the energy of the whole system by the strain, points taken along affinely. Collective.
pub fn elastic<M: Model>(system: &mut System<M>) -> Result<Elastic, EngineError> {
    system.prepare()?;
    let view = system.view();
    let parts = threads::map(system.chunks(), |chunk| {
        chunk.particles.clone().map(|p| system.model.elastic(&view, p)).collect::<Vec<_>>()
    });
    let rows = parts.concat();
    Ok(system.comm.sum_terms(rows.len(), |p| rows[p]))
}
