//! Second derivatives of the energies: what a small displacement of points, or a small strain, does to the forces.

use super::{Harmonic, deformable::Slide, deformable::Touch};
use crate::geometry::{Vec2, dot, norm, scale};

/// A 2×2 block of the Hessian ∂²U/∂x∂x, rows first: xx, xy, yx, yy.
pub type Block = [f64; 4];

/// Second derivatives of U by the strain, the box deforming as 1 + Σ E_a e_a along a straight path with all points
/// taken along affinely, for the components xx, xy, yx, yy (xy displaces x by y): the upper triangle in rows. Energy
/// units.
pub type Elastic = [f64; 10];

/// E·r for the strain component k of [`Elastic`].
#[inline(always)]
pub fn strained(k: usize, r: Vec2) -> Vec2 {
    let mut moved = [0.0; 2];
    moved[k / 2] = r[k % 2];
    moved
}

/// Adds a symmetric bilinear form of two strain components.
#[inline(always)]
pub(super) fn add_elastic(elastic: &mut Elastic, form: impl Fn(usize, usize) -> f64) {
    let mut slot = elastic.iter_mut();
    for a in 0..4 {
        for b in a..4 {
            if let Some(sum) = slot.next() {
                *sum += form(a, b);
            }
        }
    }
}

/// Parts of what the present contact forces contribute to the Hessian by turning (pre-stress).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Prestress {
    /// Of disks on disks and vertices on vertices, which buckle: their forces push across what they are along, and make
    /// the Hessian negative where nothing else holds.
    pub buckling: f64,
    /// Of vertices on edges.
    pub sliding: f64,
}

impl Prestress {
    /// The Hessian as it is.
    pub const ALL: Self = Self::part(1.0);
    /// That of the same contacts if they did not push yet.
    pub const NONE: Self = Self::part(0.0);

    /// The Hessian if all contact forces were this part of what they are.
    pub const fn part(part: f64) -> Self {
        Prestress { buckling: part, sliding: part }
    }

    /// The same without the part that buckles.
    pub fn braced(self) -> Self {
        Prestress { buckling: 0.0, ..self }
    }
}

/// Block times vector.
#[inline(always)]
pub fn times(b: &Block, u: Vec2) -> Vec2 {
    [b[0] * u[0] + b[1] * u[1], b[2] * u[0] + b[3] * u[1]]
}

#[inline(always)]
fn outer(weight: f64, a: Vec2, b: Vec2) -> Block {
    [weight * a[0] * b[0], weight * a[0] * b[1], weight * a[1] * b[0], weight * a[1] * b[1]]
}

#[inline(always)]
fn added(a: Block, b: Block) -> Block {
    std::array::from_fn(|k| a[k] + b[k])
}

#[inline(always)]
pub(super) fn scaled(s: f64, a: Block) -> Block {
    a.map(|x| s * x)
}

/// a n nᵀ + b (1 − n nᵀ) for a unit vector n.
#[inline(always)]
pub(super) fn along_and_across(n: Vec2, along: f64, across: f64) -> Block {
    added(outer(along - across, n, n), [across, 0.0, 0.0, across])
}

/// Second derivative of a central law by the separation vector r of length d > 0, the part of its force times
/// `prestress.buckling`.
#[inline(always)]
pub(super) fn of_separation(law: Harmonic, r: Vec2, d: f64, prestress: Prestress) -> Block {
    // φ″ = ε/δ² along, φ′/d across, which is negative: pushing contacts buckle
    along_and_across(
        scale(1.0 / d, r),
        law.epsilon / (law.delta * law.delta),
        -prestress.buckling * law.force_over_distance(d),
    )
}

/// How the force of a touch answers to motion of its points: with w the motion of the touching places against each
/// other (ours less theirs, the places kept in the edges) and g the motion of the edge vector,
/// δf = −(A w + B g), and the place on the edge moves by δt = (w·`place` + g·`turn`), counted along the edge.
pub(super) struct TouchStiffness {
    a: Block,
    b: Block,
    place: Vec2,
    turn: Vec2,
    /// +1 when the edge on which the place slides is theirs, −1 when it is ours, 0 when it does not slide.
    side: f64,
    along: Vec2,
}

impl TouchStiffness {
    pub fn of(law: Harmonic, touch: &Touch, prestress: Prestress) -> Self {
        let (s, d) = (touch.separation, norm(touch.separation));
        let sign = if touch.energy < 0.0 { -1.0 } else { 1.0 };
        if d == 0.0 {
            return TouchStiffness::nothing(); // no direction, no force
        }
        let (side, along) = match touch.slide {
            Slide::None => {
                return TouchStiffness {
                    a: scaled(sign, of_separation(law, s, d, prestress)),
                    ..TouchStiffness::nothing()
                };
            }
            Slide::Ours(along) => (-1.0, along),
            Slide::Theirs(along) => (1.0, along),
        };
        // s is perpendicular to the edge and stays so: relative motion along the edge only moves the place, and the
        // force turns with the edge
        let n = scale(1.0 / d, s);
        let length2 = dot(along, along);
        let strength = prestress.sliding * sign * law.force_over_distance(d) * d;
        TouchStiffness {
            a: outer(sign * law.epsilon / (law.delta * law.delta), n, n),
            b: outer(strength / length2, along, n),
            place: scale(side / length2, along),
            turn: scale(side / length2, s),
            side: side * prestress.sliding,
            along,
        }
    }

    fn nothing() -> Self {
        TouchStiffness { a: [0.0; 4], b: [0.0; 4], place: [0.0; 2], turn: [0.0; 2], side: 0.0, along: [0.0; 2] }
    }

    /// The rows of our points: `add(k, who, block)` for point k of `touch.ours` and each of the four points involved,
    /// ours 0 and 1, theirs 2 and 3.
    pub fn rows(&self, touch: &Touch, mut add: impl FnMut(usize, usize, Block)) {
        let [(_, w0), (_, w1)] = touch.ours;
        let [(_, w2), (_, w3)] = touch.theirs;
        // shares of each point in w and in g
        let in_w = [w0, w1, -w2, -w3];
        let in_g = match touch.slide {
            Slide::None => [0.0; 4],
            Slide::Ours(_) => [-1.0, 1.0, 0.0, 0.0],
            Slide::Theirs(_) => [0.0, 0.0, -1.0, 1.0],
        };
        // the share of the force on our points changes as the place moves along our edge
        let shift = if self.side < 0.0 { [self.side, -self.side] } else { [0.0; 2] };
        for who in 0..4 {
            if in_w[who] == 0.0 && in_g[who] == 0.0 {
                continue;
            }
            let answer = added(scaled(in_w[who], self.a), scaled(in_g[who], self.b));
            let place = [
                in_w[who] * self.place[0] + in_g[who] * self.turn[0],
                in_w[who] * self.place[1] + in_g[who] * self.turn[1],
            ];
            for (k, &(_, weight)) in touch.ours.iter().enumerate() {
                if weight != 0.0 || shift[k] != 0.0 {
                    add(k, who, added(scaled(weight, answer), outer(-shift[k], touch.force, place)));
                }
            }
        }
    }

    /// Second derivatives of the touch's energy by the strain.
    pub fn add_elastic(&self, touch: &Touch, weight: f64, elastic: &mut Elastic) {
        let s = touch.separation;
        add_elastic(elastic, |i, j| {
            let (w, g) = (strained(j, s), strained(j, self.along));
            let [p, q] = [times(&self.a, w), times(&self.b, g)];
            let moved = dot(w, self.place) + dot(g, self.turn);
            weight
                * (dot([p[0] + q[0], p[1] + q[1]], strained(i, s))
                    + self.side * moved * dot(touch.force, strained(i, self.along)))
        });
    }
}
