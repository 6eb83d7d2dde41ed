use super::stiffness::{
    Block, Elastic, Prestress, TouchStiffness, add_elastic, along_and_across, scaled, strained, times,
};
use super::{Ahead, Harmonic, Model, Outline, Terms, View, add_outer, masses};
use crate::geometry::{PeriodicBox, Polygon, Vec2, add, cross, dot, norm, scale, sub};
use crate::neighbor::{Candidates, PointList};
use crate::particles::{Bodies, Particles};
use std::f64::consts::PI;
use std::ops::Range;

/// Constants of the deformable particle model (paper, Eq. 7).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DeformableParameters {
    /// γ, energy per length of outline.
    pub line_tension: f64,
    /// k_a, stiffness of the particle areas.
    pub k_area: f64,
    /// Contact energy scale ε and width δ of the circulo-lines.
    pub contact: Harmonic,
    /// Largest a₀/N_v of any particle: it sets the stiffest area mode.
    pub largest_area_per_vertex: f64,
}

impl DeformableParameters {
    /// The stiffest contact, area and line modes for unit masses (l = 1, m = 1): 4ε/δ², 4π k_a a₀/N_v and 16γ.
    fn stiffest_modes(&self) -> [f64; 3] {
        let DeformableParameters { line_tension, k_area, contact, largest_area_per_vertex } = *self;
        let contact = 4.0 * contact.epsilon / (contact.delta * contact.delta);
        [contact, 4.0 * PI * k_area * largest_area_per_vertex, 16.0 * line_tension]
    }

    /// The part of the forces on the growth of a particle that its mass takes away. Areas are a single stiff mode for each
    /// particle: it is slowed down to the stiffest contacts, or [`GROWTH`] times the line modes if those are softer yet.
    pub(super) fn held_growth(&self) -> f64 {
        let [contact, area, line] = self.stiffest_modes();
        (1.0 - contact.max(GROWTH * line) / area).clamp(0.0, MOST_HELD)
    }
}

/// See [`DeformableParameters::held_growth`]. With 2, 8 and 12 packings with soft contacts take 1.5, 1.8 and 1.3 times the
/// iterations (1000 particles, three seeds).
const GROWTH: f64 = 4.0;
/// Something of a force is always left, so that areas relax without any line tension, too.
const MOST_HELD: f64 = 1.0 - 1e-6;

/// How the outlines of two particles repel each other.
pub trait Contact: Copy + Send + Sync {
    type List: PointList + Default;

    /// See [`Model::EDGES_AND_SKINS_BETWEEN`].
    const EDGES_AND_SKINS_BETWEEN: [f64; 2];

    /// All pairs of outline parts closer than `range`.
    fn list(candidates: &Candidates, range: f64) -> Self::List;

    /// Visits every touch between own particle `particle` and another, from this particle's side.
    fn for_each_touch(law: Harmonic, view: &View<Self::List>, particle: usize, visit: impl FnMut(Touch));

    /// Readies the lists for [`Contact::forces_and_accelerations`], see [`Model::narrow`].
    fn narrow(_law: Harmonic, _pbox: &PeriodicBox, _particles: &Particles, _list: &mut Self::List, _travel: f64) {}

    /// All forces on a chunk of own particles, and what they accelerate.
    fn forces_and_accelerations(
        model: &Deformable<Self>,
        view: &View<Self::List>,
        particles: Range<usize>,
        forces: &mut [Vec2],
        accelerations: &mut [Vec2],
    ) where
        Self: Sized,
    {
        model.forces(view, particles.clone(), forces);
        model.accelerate(view, particles, forces, accelerations);
    }
}

/// One contribution of a contact as felt by one of the two particles.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Touch {
    /// Our points that share the force, counted from the particle's first point, with their weights (sum 1).
    pub ours: [(usize, f64); 2],
    /// Points of the other particle that share the opposite force, with their weights (sum 1).
    pub theirs: [(u32, f64); 2],
    /// Whether the place of the contact moves along an edge when the outlines shift.
    pub slide: Slide,
    /// Force on us.
    pub force: Vec2,
    /// Vector from the point of the other outline to that of ours.
    pub separation: Vec2,
    /// Energy of the whole contribution (both particles together); negative where it corrects a corner counted twice.
    pub energy: f64,
}

/// An edge on whose inside a contact lies: the vector from its first to its second point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Slide {
    /// Two corners touch.
    None,
    /// Along the edge between our two points.
    Ours(Vec2),
    /// Along the edge between theirs.
    Theirs(Vec2),
}

/// Deformable particles (DP model, paper Eq. 7): U = γ Σ p + k_a/2 Σ (a − a₀)² + contacts.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Deformable<C> {
    pub parameters: DeformableParameters,
    contact: std::marker::PhantomData<C>,
}

impl<C: Contact> Deformable<C> {
    pub fn new(parameters: DeformableParameters) -> Self {
        Deformable { parameters, contact: std::marker::PhantomData }
    }

    /// Line tension and area forces of one particle, written to `forces`.
    ///
    /// With edge vectors e_i from vertex i to i + 1: −∂(γp)/∂x_i = γ(ê_i − ê_{i−1}), and ∂a/∂x_i is half the chord
    /// e_{i−1} + e_i turned by −90°. The array first holds the edges, so that no scratch space is needed.
    fn shape_forces(&self, view: &View<C::List>, particle: usize, forces: &mut [Vec2]) {
        let points = view.particles.points_of(particle);
        let n = points.len();
        let mut corner = [0.0; 2];
        let mut area2 = 0.0;
        for i in 0..n {
            let next = if i + 1 < n { i + 1 } else { 0 };
            let edge = view.pbox.displacement(points[next], points[i]);
            area2 += cross(corner, edge);
            corner = [corner[0] + edge[0], corner[1] + edge[1]];
            forces[i] = edge;
        }
        let half_pressure = 0.5 * self.parameters.k_area * (view.particles.size[particle] - 0.5 * area2);
        let last = forces[n - 1];
        let tension = |e: Vec2| {
            let length = norm(e);
            if length > 0.0 { self.parameters.line_tension / length } else { 0.0 }
        };
        let last_pull = tension(last);
        let (mut after, mut after_pull) = (last, last_pull);
        for i in (0..n).rev() {
            let (before, before_pull) = if i > 0 { (forces[i - 1], tension(forces[i - 1])) } else { (last, last_pull) };
            forces[i] = [
                after_pull * after[0] - before_pull * before[0] + half_pressure * (after[1] + before[1]),
                after_pull * after[1] - before_pull * before[1] - half_pressure * (after[0] + before[0]),
            ];
            (after, after_pull) = (before, before_pull);
        }
    }

    /// Line and area terms of [`Model::stiffness`].
    fn shape_stiffness(&self, view: &View<C::List>, p: usize, add: &mut impl FnMut(usize, u32, Block)) {
        let DeformableParameters { line_tension, k_area, .. } = self.parameters;
        let first = view.particles.bodies.points(p).start;
        let polygon = Polygon::from_vertices(view.pbox, view.particles.points_of(p));
        let n = polygon.edges.len();
        // ∂²a/∂x_i∂x_{i+1} is half a turn by 90°
        let half = 0.5 * k_area * (polygon.area() - view.particles.size[p]);
        for (i, &edge) in polygon.edges.iter().enumerate() {
            let j = if i + 1 < n { i + 1 } else { 0 };
            let (here, next) = ((first + i) as u32, (first + j) as u32);
            let length = norm(edge);
            if length > 0.0 {
                let block = along_and_across(scale(1.0 / length, edge), 0.0, line_tension / length);
                add(i, here, block);
                add(j, next, block);
                add(i, next, scaled(-1.0, block));
                add(j, here, scaled(-1.0, block));
            }
            add(i, next, [0.0, half, -half, 0.0]);
            add(j, here, [0.0, -half, half, 0.0]);
        }
    }

    /// What one touch of a particle adds to [`Model::stiffness`].
    fn touch_stiffness(
        &self,
        view: &View<C::List>,
        p: usize,
        touch: &Touch,
        prestress: Prestress,
        add: &mut impl FnMut(usize, u32, Block),
    ) {
        let first = view.particles.bodies.points(p).start;
        let who = [touch.ours[0].0, touch.ours[1].0].map(|k| (first + k) as u32);
        let columns = [who[0], who[1], touch.theirs[0].0, touch.theirs[1].0];
        TouchStiffness::of(self.parameters.contact, touch, prestress)
            .rows(touch, |k, column, block| add(touch.ours[k].0, columns[column], block));
    }
}

impl<C: Contact> Model for Deformable<C> {
    type List = C::List;

    const BODIES: bool = true;

    const EDGES_AND_SKINS_BETWEEN: [f64; 2] = C::EDGES_AND_SKINS_BETWEEN;

    fn bodies(&self) -> Bodies {
        Bodies::Polygons { first: vec![0] }
    }

    fn range(&self, _largest_size: f64) -> f64 {
        self.parameters.contact.delta
    }

    fn list(&self, candidates: &Candidates, skin: f64) -> C::List {
        C::list(candidates, self.parameters.contact.delta + skin)
    }

    fn forces(&self, view: &View<C::List>, particles: Range<usize>, forces: &mut [Vec2]) {
        let origin = view.particles.bodies.points(particles.start).start;
        for p in particles {
            let points = view.particles.bodies.points(p);
            let mine = &mut forces[points.start - origin..points.end - origin];
            self.shape_forces(view, p, mine);
            C::for_each_touch(self.parameters.contact, view, p, |touch| {
                for (point, weight) in touch.ours {
                    mine[point][0] += weight * touch.force[0];
                    mine[point][1] += weight * touch.force[1];
                }
            });
        }
    }

    fn accelerate(&self, view: &View<C::List>, particles: Range<usize>, forces: &[Vec2], accelerations: &mut [Vec2]) {
        let origin = view.particles.bodies.points(particles.start).start;
        for p in particles {
            let range = view.particles.bodies.points(p);
            let mine = range.start - origin..range.end - origin;
            let points = &view.particles.position[range];
            // about the first vertex as the outline leads there: a particle may be wider than half the box
            let mut here = [0.0; 2];
            for (k, arm) in accelerations[mine.clone()].iter_mut().enumerate() {
                here = add(here, view.pbox.displacement(points[k], points[k.saturating_sub(1)]));
                (*arm, _) = view.pbox.image_near(points[k], points[0], here);
            }
            masses::accelerate(&forces[mine.clone()], &mut accelerations[mine], self.parameters.held_growth());
        }
    }

    fn forces_and_accelerations(
        &self,
        view: &View<C::List>,
        particles: Range<usize>,
        forces: &mut [Vec2],
        accelerations: &mut [Vec2],
    ) {
        C::forces_and_accelerations(self, view, particles, forces, accelerations);
    }

    fn narrow(&self, pbox: &PeriodicBox, particles: &Particles, list: &mut C::List, travel: f64) {
        C::narrow(self.parameters.contact, pbox, particles, list, travel);
    }

    fn terms(&self, view: &View<C::List>, p: usize) -> Terms {
        let DeformableParameters { line_tension, k_area, contact, .. } = self.parameters;
        let polygon = Polygon::from_vertices(view.pbox, view.particles.points_of(p));
        let area = polygon.area();
        let excess = area - view.particles.size[p];
        let mut terms = Terms {
            line: line_tension * polygon.perimeter(),
            area: 0.5 * k_area * excess * excess,
            ..Terms::default()
        };
        for &edge in polygon.edges.iter().filter(|&&e| dot(e, e) > 0.0) {
            add_outer(&mut terms.virial, -line_tension / norm(edge), edge, edge);
        }
        // ∂a/∂strain = a times the identity
        terms.virial[0] -= k_area * excess * area;
        terms.virial[3] -= k_area * excess * area;
        let center = polygon.centroid();
        let offsets: Vec<Vec2> = polygon.offsets().collect();
        C::for_each_touch(contact, view, p, |touch| {
            terms.contact += 0.5 * touch.energy;
            add_outer(&mut terms.virial, 0.5, touch.force, touch.separation);
            add_outer(&mut terms.centroid, 0.5, touch.force, touch.separation);
            // r_m − r_n = (r_m − x) + (x − y) + (y − r_n): each particle adds its own leg, the middle one is shared
            for (point, weight) in touch.ours {
                add_outer(&mut terms.centroid, weight, touch.force, sub(center, offsets[point]));
            }
        });
        terms
    }

    fn for_each_contact(&self, view: &View<C::List>, p: usize, mut visit: impl FnMut(u32, Vec2)) {
        C::for_each_touch(self.parameters.contact, view, p, |touch| visit(touch.theirs[0].0, touch.force));
    }

    fn own_area(&self, view: &View<C::List>, p: usize) -> f64 {
        Polygon::from_vertices(view.pbox, view.particles.points_of(p)).rounded_area(self.parameters.contact.delta)
    }

    fn outline(&self, view: &View<C::List>, p: usize) -> Outline {
        Outline::Polygon {
            polygon: Polygon::from_vertices(view.pbox, view.particles.points_of(p)),
            rest_area: view.particles.size[p],
            delta: self.parameters.contact.delta,
        }
    }

    fn softened(&self, factor: f64) -> Option<Self> {
        let DeformableParameters { contact: Harmonic { epsilon, delta }, .. } = self.parameters;
        let contact = Harmonic { epsilon: factor * epsilon, delta };
        Some(Deformable::new(DeformableParameters { contact, ..self.parameters }))
    }

    fn force_unit(&self) -> f64 {
        self.parameters.line_tension
    }

    fn stiffness(&self, view: &View<C::List>, p: usize, prestress: Prestress, mut add: impl FnMut(usize, u32, Block)) {
        self.shape_stiffness(view, p, &mut add);
        C::for_each_touch(self.parameters.contact, view, p, |touch| {
            self.touch_stiffness(view, p, &touch, prestress, &mut add);
        });
    }

    fn stiffness_ahead(
        &self,
        view: &View<C::List>,
        p: usize,
        prestress: Prestress,
        ahead: &Ahead,
        mut add: impl FnMut(usize, u32, Block),
        mut push: impl FnMut(usize, Vec2),
    ) {
        self.shape_stiffness(view, p, &mut add);
        let law = self.parameters.contact;
        let first = view.particles.bodies.points(p).start;
        let moved = |point: usize, weight: f64| scale(weight, ahead.displacement[point]);
        C::for_each_touch(Harmonic { delta: law.delta + ahead.reach, ..law }, view, p, |mut touch| {
            let d = norm(touch.separation);
            if d == 0.0 {
                return;
            }
            let n = scale(1.0 / d, touch.separation);
            let ours = touch.ours.map(|(k, weight)| moved(first + k, weight));
            let theirs = touch.theirs.map(|(point, weight)| moved(point as usize, weight));
            // the same bits, with the other sign, as seen from the other particle
            let parting = [0, 1].map(|k| (ours[0][k] + ours[1][k]) - (theirs[0][k] + theirs[1][k]));
            let overlap = law.delta - d;
            let stays = overlap - dot(n, parting) > 0.0;
            let sign = if touch.energy < 0.0 { -1.0 } else { 1.0 };
            // to the same bits as in `touch`: who looks ahead sees whether anything changes
            let force = scale(sign * law.force_over_distance(d), touch.separation);
            let touches = overlap > 0.0;
            if stays != touches {
                let change = if stays { force } else { scale(-1.0, force) };
                for (point, weight) in touch.ours {
                    push(point, scale(weight, change));
                }
            }
            if stays {
                touch.force = if touches { force } else { [0.0; 2] };
                self.touch_stiffness(view, p, &touch, if touches { prestress } else { Prestress::NONE }, &mut add);
            }
        });
    }

    fn area_stiffness(&self, view: &View<C::List>, p: usize, gradient: &mut [Vec2]) -> f64 {
        let polygon = Polygon::from_vertices(view.pbox, view.particles.points_of(p));
        let n = polygon.edges.len();
        for (i, slot) in gradient.iter_mut().enumerate() {
            let chord = add(polygon.edges[(i + n - 1) % n], polygon.edges[i]);
            *slot = [0.5 * chord[1], -0.5 * chord[0]];
        }
        self.parameters.k_area
    }

    fn elastic(&self, view: &View<C::List>, p: usize) -> Elastic {
        let DeformableParameters { line_tension, k_area, contact, .. } = self.parameters;
        let polygon = Polygon::from_vertices(view.pbox, view.particles.points_of(p));
        let mut elastic = [0.0; 10];
        for &edge in polygon.edges.iter().filter(|&&e| dot(e, e) > 0.0) {
            let length = norm(edge);
            let block = along_and_across(scale(1.0 / length, edge), 0.0, line_tension / length);
            add_elastic(&mut elastic, |a, b| dot(strained(a, edge), times(&block, strained(b, edge))));
        }
        // a → a det(1 + E)
        let area = polygon.area();
        let (square, excess) = (k_area * area * area, k_area * area * (area - view.particles.size[p]));
        let trace = |a: usize| if a == 0 || a == 3 { 1.0 } else { 0.0 };
        let determinant = |a: usize, b: usize| match (a, b) {
            (0, 3) => 1.0,
            (1, 2) => -1.0,
            _ => 0.0,
        };
        add_elastic(&mut elastic, |a, b| square * trace(a) * trace(b) + excess * determinant(a, b));
        C::for_each_touch(contact, view, p, |touch| {
            TouchStiffness::of(contact, &touch, Prestress::ALL).add_elastic(&touch, 0.5, &mut elastic);
        });
        elastic
    }

    fn stiffest(&self) -> f64 {
        self.parameters.stiffest_modes().iter().sum()
    }

    fn time_step(&self) -> f64 {
        let [contact, area, line] = self.parameters.stiffest_modes();
        // about 1/ω_max: edges shorter than 1/4, stretched particles and lighter rigid motions are stiffer, which the sum of
        // modes that are not one covers; larger steps fail
        1.0 / (contact + area * (1.0 - self.parameters.held_growth()) + line).sqrt()
    }

    fn step_cap(&self) -> f64 {
        0.1 * self.parameters.contact.delta
    }
}

/// Whether a position along an edge is none of its ends.
#[inline(always)]
pub(super) fn is_inside(t: f64) -> bool {
    t > 0.0 && t < 1.0
}

/// The touch of two outlines at vector `separation` (from theirs to ours) of length `d`.
#[inline(always)]
pub(super) fn touch(
    law: Harmonic,
    sign: f64,
    ours: [(usize, f64); 2],
    theirs: [(u32, f64); 2],
    slide: Slide,
    separation: Vec2,
    d: f64,
) -> Touch {
    let strength = if d > 0.0 { sign * law.force_over_distance(d) } else { 0.0 };
    Touch { ours, theirs, slide, force: scale(strength, separation), separation, energy: sign * law.energy(d) }
}
