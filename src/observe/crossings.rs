use crate::engine::{EngineError, System};
use crate::geometry::{PeriodicBox, Polygon, Vec2, add, cross, sub};
use crate::model::Model;
use crate::neighbor::{Candidates, CellList, EdgeEdgeList};
use crate::particles::Bodies;

/// The lowest pair of particles (global ids, ascending) whose outlines are not in order, the same on all ranks, or
/// `None` when all is well. Two different ids: outlines that cross, or one particle inside the other. Twice the same
/// id: a particle that crosses itself or runs clockwise. Outlines that merely touch are in order. Collective.
///
/// Crossed outlines never untangle, so a state that has any is not valid, however small its forces.
pub fn check_no_crossing<M: Model>(system: &mut System<M>) -> Result<Option<(u32, u32)>, EngineError> {
    if matches!(system.particles().bodies, Bodies::Disks) {
        return Ok(None);
    }
    let here = system.with_whole_neighbors(|candidates| {
        [tangled(candidates), crossing(candidates), nested(candidates)].into_iter().flatten().min()
    })?;
    Ok(lowest(system, here))
}

/// Fails if [`check_no_crossing`] finds something. Collective.
pub fn refuse_crossings<M: Model>(system: &mut System<M>) -> Result<(), EngineError> {
    match check_no_crossing(system)? {
        Some((a, b)) => Err(EngineError::Crossing(a, b)),
        None => Ok(()),
    }
}

/// The lowest pair of disks at one place: forces are zero there, at a maximum of the energy. Collective.
pub fn check_no_coincident<M: Model>(system: &mut System<M>) -> Result<Option<(u32, u32)>, EngineError> {
    if M::BODIES {
        return Ok(None);
    }
    let contacts = system.contacts()?;
    let ids = &system.particles().id;
    let touching =
        contacts.iter().zip(ids).flat_map(|(found, &id)| found.iter().map(move |&(other, f)| (id, other, f)));
    let here = touching.filter(|&(.., force)| force == [0.0; 2]).map(|(a, b, _)| ordered(a, b)).min();
    Ok(lowest(system, here))
}

/// Fails if [`check_no_coincident`] finds something. Collective.
pub fn refuse_coincident<M: Model>(system: &mut System<M>) -> Result<(), EngineError> {
    match check_no_coincident(system)? {
        Some((a, b)) => Err(EngineError::Coincident(a, b)),
        None => Ok(()),
    }
}

/// The lowest of the pairs of all ranks. Collective.
fn lowest<M: Model>(system: &System<M>, here: Option<(u32, u32)>) -> Option<(u32, u32)> {
    let word = here.map_or(u64::MAX, |(a, b)| (a as u64) << 32 | b as u64);
    let lowest = system.comm.all_gather(&[word]).concat().into_iter().min();
    lowest.filter(|&word| word != u64::MAX).map(|word| ((word >> 32) as u32, word as u32))
}

fn ordered(a: u32, b: u32) -> (u32, u32) {
    (a.min(b), a.max(b))
}

/// The lowest own particle that crosses itself or runs clockwise.
fn tangled(candidates: &Candidates) -> Option<(u32, u32)> {
    let particles = candidates.particles;
    let is_tangled = |p: &usize| {
        let polygon = Polygon::from_vertices(candidates.pbox, particles.points_of(*p));
        polygon.area() <= 0.0 || polygon.crosses_itself()
    };
    (0..candidates.owned).filter(is_tangled).map(|p| (particles.id[p], particles.id[p])).min()
}

/// The lowest pair of crossing outlines with an own particle in it.
fn crossing(candidates: &Candidates) -> Option<(u32, u32)> {
    let particles = candidates.particles;
    // at range zero the list holds the edges that cross and no others
    let list = EdgeEdgeList::new(candidates, 0.0);
    let mut id_of = Vec::with_capacity(particles.position.len());
    for p in 0..particles.len() {
        id_of.resize(particles.bodies.points(p).end, particles.id[p]);
    }
    let own_points = candidates.chunks.last().map_or(0, |chunk| chunk.points.end);
    let pairs = (0..own_points).flat_map(|point| {
        let id_of = &id_of;
        list.edges.row(point).iter().map(move |pair| ordered(id_of[point], id_of[pair.ends[0] as usize]))
    });
    pairs.min()
}

/// The lowest pair of an own particle and another one that holds its first vertex: outlines that do not cross are then
/// one inside the other.
fn nested(candidates: &Candidates) -> Option<(u32, u32)> {
    let Candidates { pbox, particles, owned, region, .. } = candidates;
    let first: Vec<_> = (0..particles.len()).map(|p| particles.points_of(p)[0]).collect();
    let polygons: Vec<Polygon> =
        (0..particles.len()).map(|p| Polygon::from_vertices(pbox, particles.points_of(p))).collect();
    // no vertex is farther from another of the same polygon than half of its outline
    let reach = polygons.iter().map(|polygon| 0.5 * polygon.perimeter()).fold(0.0, f64::max);
    let cells = CellList::new(pbox, region, &first, reach);
    let mut lowest: Option<(u32, u32)> = None;
    for p in 0..*owned {
        cells.for_each_near(first[p], |q| {
            let q = q as usize;
            let pair = ordered(particles.id[p], particles.id[q]);
            let is_new = p != q && lowest.is_none_or(|l| pair < l);
            if is_new && holds_an_image(pbox, &polygons[q], pbox.displacement(first[p], first[q])) {
                lowest = Some(pair);
            }
        });
    }
    lowest
}

/// Whether any image of a point, of which the nearest is given relative to the first vertex, lies inside a polygon, which
/// may be wider than half the box.
fn holds_an_image(pbox: &PeriodicBox, polygon: &Polygon, point: Vec2) -> bool {
    let others = pbox.images_within(0.5 * polygon.perimeter());
    holds(polygon, point) || others.iter().any(|&by| holds(polygon, add(point, by)))
}

/// Whether a point, given relative to the first vertex, lies inside a polygon: an odd number of edges lies to its right.
fn holds(polygon: &Polygon, point: Vec2) -> bool {
    // each edge ends where the next begins, to the bit: the edges of an outline need not add up to zero
    let ends = polygon.offsets().skip(1).chain([[0.0; 2]]);
    let to_the_right = polygon.offsets().zip(ends).filter(|&(a, end)| {
        let below = a[1] <= point[1];
        below != (end[1] <= point[1]) && (cross(sub(end, a), sub(point, a)) > 0.0) == below
    });
    to_the_right.count() % 2 == 1
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::comm::Comm;
    use crate::geometry::segments_cross;
    use crate::model::{Deformable, DeformableParameters, Harmonic, VertexEdge};
    use crate::particles::Particles;
    use rand::{Rng, SeedableRng};
    use rand_chacha::ChaCha8Rng;
    use std::f64::consts::TAU;

    fn check(pbox: PeriodicBox, polygons: &[Vec<Vec2>]) -> Option<(u32, u32)> {
        let mut particles = Particles::empty(&Bodies::Polygons { first: vec![0] });
        for (i, vertices) in polygons.iter().enumerate() {
            let points: Vec<_> = vertices.iter().map(|&v| pbox.frac(v)).collect();
            particles.push(i as u32, 1.0, &points);
        }
        let contact = Harmonic { epsilon: 1.0, delta: 0.1 };
        let parameters =
            DeformableParameters { line_tension: 1.0, k_area: 1.0, contact, largest_area_per_vertex: 0.25 };
        let model = Deformable::<VertexEdge>::new(parameters);
        let mut system = System::new(Comm::alone(), model, pbox, &pbox, particles, 0.1).unwrap();
        check_no_crossing(&mut system).unwrap()
    }

    fn square(x: f64, y: f64, edge: f64) -> Vec<Vec2> {
        vec![[x, y], [x + edge, y], [x + edge, y + edge], [x, y + edge]]
    }

    #[test]
    fn order_and_disorder() {
        let pbox = PeriodicBox::new(6.0, 6.0, 1.5);
        assert_eq!(check(pbox, &[square(0.0, 0.0, 1.0), square(1.05, 0.0, 1.0)]), None);
        // touching is allowed
        assert_eq!(check(pbox, &[square(0.0, 0.0, 1.0), square(1.0, 0.3, 1.0)]), None);
        // crossing through the periodic boundary
        assert_eq!(check(pbox, &[square(3.0, 3.0, 1.0), square(0.1, 0.1, 1.0), square(7.0, 5.4, 1.0)]), Some((1, 2)));
        // one inside the other, either way round
        assert_eq!(check(pbox, &[square(0.0, 0.0, 1.0), square(0.3, 0.3, 0.2)]), Some((0, 1)));
        assert_eq!(check(pbox, &[square(0.3, 0.3, 0.2), square(0.0, 0.0, 1.0)]), Some((0, 1)));
    }

    #[test]
    fn outlines_on_each_other() {
        let pbox = PeriodicBox::square(8.0);
        for first in 0..4 {
            // from whichever vertex they are given
            let mut other = square(1.5, 1.0, 1.0);
            other.rotate_left(first);
            assert_eq!(check(pbox, &[square(1.0, 1.0, 1.0), other]), Some((0, 1)));
            let mut same = square(1.0, 1.0, 1.0);
            same.rotate_left(first);
            assert_eq!(check(pbox, &[square(1.0, 1.0, 1.0), same]), Some((0, 1)));
        }
        let corner = |k: usize| [4.0 + (0.3 + k as f64 * TAU / 17.0).cos(), 4.0 + (0.3 + k as f64 * TAU / 17.0).sin()];
        let polygon: Vec<Vec2> = (0..17).map(corner).collect();
        assert_eq!(check(pbox, &[polygon.clone(), polygon]), Some((0, 1)));
        assert_eq!(check(pbox, &[square(1.0, 1.0, 1.0), square(1.5, 2.0, 1.0)]), None);
    }

    #[test]
    fn edges_that_are_long_for_their_box() {
        // rhombi of which no two edges that cross have their starts within half the box
        let a = [[1.9507, 0.1640], [3.2638, 0.0252], [4.4289, 0.6463], [3.1159, 0.7851]];
        let b = [[1.0663, 1.0214], [-0.1755, 1.4088], [-1.4100, 0.9984], [-0.1681, 0.6110]];
        assert_eq!(check(PeriodicBox::square(3.0), &[a.to_vec(), b.to_vec()]), Some((0, 1)));
        let pbox = PeriodicBox::new(3.0, 3.1, 0.4);
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let mut random = |low: f64, high: f64| low + (high - low) * (rng.next_u64() as f64 / 2f64.powi(64));
        let (mut crossed, mut apart) = (0, 0);
        for _ in 0..1000 {
            // a thin triangle, its edges between a third of the box and just below half
            let mut triangle = || {
                let (x, y, start, length) = (random(0.0, 3.0), random(0.0, 3.0), random(0.0, TAU), random(1.0, 1.35));
                let corner = |angle: f64, far: f64| [x + far * angle.cos(), y + far * angle.sin()];
                [[x, y], corner(start, length), corner(start + random(0.02, 0.3), length)]
            };
            let [a, b] = [triangle(), triangle()];
            let crosses = |by: Vec2| {
                let edge = |t: &[Vec2; 3], k: usize| (t[k], sub(t[(k + 1) % 3], t[k]));
                (0..9).any(|k| {
                    let ((p, u), (q, v)) = (edge(&a, k / 3), edge(&b, k % 3));
                    segments_cross(add(sub(q, p), by), u, v)
                })
            };
            let images = (-3..4).flat_map(|i| (-3..4).map(move |j| (i as f64, j as f64)));
            let is_crossed = { images }.any(|(i, j)| crosses([i * pbox.lx() + j * pbox.xy(), j * pbox.ly()]));
            assert_eq!(check(pbox, &[a.to_vec(), b.to_vec()]), is_crossed.then_some((0, 1)), "{a:?} {b:?}");
            *(if is_crossed { &mut crossed } else { &mut apart }) += 1;
        }
        assert!(crossed > 100 && apart > 100, "{crossed} {apart}");
    }

    #[test]
    fn corners_at_one_height() {
        // the edges of these squares add up to 10⁻¹⁷, not to zero
        let first = [
            [0.3535533905932738, 0.35355339059327373],
            [-0.35355339059327373, 0.3535533905932738],
            [-0.35355339059327384, -0.35355339059327373],
            [0.3535533905932737, -0.35355339059327384],
        ];
        let second = [
            [1.4535533905932738, 0.35355339059327373],
            [0.7464466094067264, 0.3535533905932738],
            [0.7464466094067262, -0.35355339059327373],
            [1.4535533905932738, -0.35355339059327384],
        ];
        assert_eq!(check(PeriodicBox::square(4.4), &[first.to_vec(), second.to_vec()]), None);
    }

    #[test]
    fn particles_by_themselves() {
        let pbox = PeriodicBox::square(8.0);
        let mut clockwise = square(3.0, 3.0, 1.0);
        clockwise.reverse();
        assert_eq!(check(pbox, &[square(0.0, 0.0, 1.0), clockwise]), Some((1, 1)));
        let crossed = vec![[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.2, -0.2], [0.0, 1.0]];
        assert_eq!(check(pbox, &[crossed]), Some((0, 0)));
    }
}
