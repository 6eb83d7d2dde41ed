use super::{Candidates, CellList, PointList, Rows};
use crate::geometry::dot;
use crate::threads;

/// For each own disk all disks within the sum of their radii plus a skin, in the order of global ids.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct DiskList {
    pub neighbors: Rows<u32>,
}

impl DiskList {
    pub fn new(candidates: &Candidates, skin: f64) -> Self {
        let Candidates { pbox, particles, region, chunks, .. } = candidates;
        let largest = particles.size.iter().copied().fold(0.0, f64::max);
        let cells = CellList::new(pbox, region, &particles.position, largest + skin);
        let parts = threads::map(chunks, |chunk| {
            let (mut rows, mut found) = (Rows::default(), Vec::new());
            for i in chunk.particles.clone() {
                found.clear();
                cells.for_each_near(particles.position[i], |j| {
                    let reach = 0.5 * (particles.size[i] + particles.size[j as usize]) + skin;
                    let d = pbox.displacement(particles.position[j as usize], particles.position[i]);
                    if j as usize != i && dot(d, d) < reach * reach {
                        found.push((particles.id[j as usize], j));
                    }
                });
                found.sort_unstable();
                rows.push_row(found.iter().map(|&(_, j)| j));
            }
            rows
        });
        DiskList { neighbors: Rows::concatenated(parts) }
    }
}

impl PointList for DiskList {
    fn for_each_point(&mut self, visit: impl FnMut(&mut u32)) {
        self.neighbors.items.iter_mut().for_each(visit);
    }
}
