use super::{Contacts, Rattlers};
use crate::engine::{EngineError, System};
use crate::geometry::Vec2;
use crate::model::{Model, Prestress};
use crate::stiffness::{Goal, Preconditioner, Stiffness, elastic, solve};

/// A modulus: the answer of the stress to a strain, in units of the stress.
#[derive(Clone, Copy, Debug, Default, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Modulus {
    /// All points relaxed: what an experiment measures. May be negative where the box alone is what holds a packing.
    pub linear_response: f64,
    /// All points taken along affinely; the difference is what non-affine motion relaxes.
    pub affine: f64,
}

/// Whether the moduli mean something.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Stability {
    /// No strain has met with a negative mode of the Hessian. Whether forces are balanced it does not say.
    #[default]
    Stable,
    /// The Hessian has a negative mode: the state is not relaxed, or a saddle point.
    Unstable,
    /// The linear systems were not solved to the tolerance within the limit of products.
    Unsolved,
}

/// Elastic moduli of the present state by linear response, (U_EE − X·H⁺·X)/A with H = ∂²U/∂x∂x and X = ∂²U/∂x∂E.
#[derive(Clone, Copy, Debug, Default, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Moduli {
    /// G = dΣ_xy/dγ of simple shear, x displaced by γ y, at fixed area.
    pub shear_modulus: Modulus,
    /// G of pure shear, x stretched by e^(γ/2) and y compressed by as much.
    pub pure_shear_modulus: Modulus,
    /// Mean of G over all directions of pure shear.
    pub mean_shear_modulus: f64,
    /// K = −A dp/dA.
    pub bulk_modulus: Modulus,
    pub stability: Stability,
    /// Products of the Hessian with a vector that the three strains took.
    pub products: u64,
    /// Largest relative residual of the three linear systems; the relative error of a non-affine part is its square.
    pub residual: f64,
}

/// Well below the rounding of forces; errors of the moduli are its square.
const TOLERANCE: f64 = 1e-8;
/// In a crystal the forces that a strain brings about cancel. What rounding leaves of them has this energy at most,
/// relative to that of the strain, and no meaning.
const ROUNDING: f64 = 1e-24;
/// Enough for 10⁵ disks a hair above their onset.
const MAX_PRODUCTS: u64 = 200_000;

/// Simple shear, pure shear and dilation in the components xx, xy, yx, yy.
const STRAINS: [[f64; 4]; 3] = [[0.0, 1.0, 0.0, 0.0], [0.5, 0.0, 0.0, -0.5], [1.0, 0.0, 0.0, 1.0]];

impl Moduli {
    /// Of the present state, which should be force-balanced. Collective.
    ///
    /// Disks that are rattlers are left out: forces on them that are merely below a tolerance would make them buckle
    /// springs between their neighbours. (A deformable particle may be held by two contacts.)
    pub fn of<M: Model>(system: &mut System<M>) -> Result<Moduli, EngineError> {
        if !M::BODIES {
            let contacts = Contacts::of(system, Rattlers::default())?;
            if contacts.n_backbone() == 0 {
                return Ok(Moduli::default());
            }
            if contacts.n_rattlers > 0 {
                let mut backbone = system.with_some(|p| !contacts.is_rattler[p])?;
                return Moduli::of_all(&mut backbone);
            }
        }
        Moduli::of_all(system)
    }

    /// With all particles. Collective.
    fn of_all<M: Model>(system: &mut System<M>) -> Result<Moduli, EngineError> {
        let energies = system.energies()?;
        let affine = elastic(system)?;
        let stiffness = Stiffness::of(system, Prestress::ALL)?;
        let preconditioner = Preconditioner::of(system, &stiffness);
        let b: Vec<[Vec2; 3]> = {
            let forces = stiffness.affine_forces(system);
            let force = |strain: [f64; 4], i: usize| -> Vec2 {
                let part = |axis: usize| (0..4).map(|k| strain[k] * forces[k][i][axis]).sum();
                [part(0), part(1)]
            };
            (0..forces[0].len()).map(|i| STRAINS.map(|strain| force(strain, i))).collect()
        };
        let whole = STRAINS.map(|strain| bilinear(&affine, &strain));
        let goals = whole.map(|whole| Goal {
            tolerance: TOLERANCE,
            negligible: ROUNDING * whole.abs(),
            max_products: MAX_PRODUCTS,
        });
        let mut moduli = Moduli::default();
        let mut curvature = [Modulus::default(); 3];
        let solutions = solve(system, &stiffness, &preconditioner, &b, &goals);
        for (k, (solution, goal)) in solutions.iter().zip(&goals).enumerate() {
            moduli.products += solution.products;
            moduli.residual = moduli.residual.max(solution.residual);
            if solution.is_unstable {
                moduli.stability = Stability::Unstable;
            } else if !solution.is_converged(goal) && moduli.stability == Stability::Stable {
                moduli.stability = Stability::Unsolved;
            }
            curvature[k] = Modulus { linear_response: whole[k] - solution.work, affine: whole[k] };
        }
        // what the curvature of the path of strain adds: exp(γE) is not straight
        let area = system.pbox().area();
        let [xx, _, _, yy] = energies.virial;
        let pressure = 0.5 * (xx + yy);
        let modulus = |c: Modulus, scale: f64, shift: f64| Modulus {
            linear_response: c.linear_response * scale / area + shift,
            affine: c.affine * scale / area + shift,
        };
        moduli.shear_modulus = modulus(curvature[0], 1.0, 0.0);
        moduli.pure_shear_modulus = modulus(curvature[1], 1.0, -0.5 * pressure);
        moduli.bulk_modulus = modulus(curvature[2], 0.25, 0.5 * pressure);
        // simple shear ends rotated: pure shear at 45° differs from it by the difference of normal stresses
        let diagonal = moduli.shear_modulus.linear_response - 0.5 * (xx - yy);
        moduli.mean_shear_modulus = 0.5 * (diagonal + moduli.pure_shear_modulus.linear_response);
        Ok(moduli)
    }
}

/// The second derivative along a strain.
fn bilinear(elastic: &[f64; 10], strain: &[f64; 4]) -> f64 {
    let mut sum = 0.0;
    let mut entry = elastic.iter();
    for a in 0..4 {
        for b in a..4 {
            let twice = if a == b { 1.0 } else { 2.0 };
            sum += entry.next().map_or(0.0, |e| twice * e * strain[a] * strain[b]);
        }
    }
    sum
}
