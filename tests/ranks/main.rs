//! Everything that must not depend on the number of ranks and threads, run over MPI.
//!
//! A case is a function that all ranks call; what it returns on rank 0 is compared, line by line, with what it returns
//! on one rank with one thread. `cargo test --test ranks -- fire` runs the cases whose name contains "fire".

mod ensemble;
mod failure;
mod fixed_point;
mod hard_cases;
mod harness;
mod invariance;
mod lists;
mod moduli;
mod ownership;
mod shear;
mod systems;

use harness::{Case, Start};

/// Every grid from one rank to two by four.
const RANKS: &[Start] =
    &[Start::new(1, 1), Start::new(2, 1), Start::new(3, 1), Start::new(4, 1), Start::new(6, 1), Start::new(8, 1)];
/// The same, and threads inside the ranks.
const RANKS_AND_THREADS: &[Start] = &[
    Start::new(1, 1),
    Start::new(2, 1),
    Start::new(3, 1),
    Start::new(4, 1),
    Start::new(6, 1),
    Start::new(8, 1),
    Start::new(1, 2),
    Start::new(1, 4),
    Start::new(2, 2),
];
/// For cases whose work is mostly steps of a minimiser, which other cases try on every grid.
const FEW: &[Start] = &[Start::new(1, 1), Start::new(2, 1), Start::new(4, 1), Start::new(2, 2)];
/// One rank to four.
const TO_FOUR: &[Start] = &[Start::new(1, 1), Start::new(2, 1), Start::new(3, 1), Start::new(4, 1)];
const ONE_AND_FOUR: &[Start] = &[Start::new(1, 1), Start::new(4, 1)];

fn main() -> std::process::ExitCode {
    harness::run(vec![
        Case::new("one_particle_per_subdomain", ownership::one_particle_per_subdomain, RANKS),
        Case::new("far_migration", ownership::far_migration, RANKS),
        Case::new("four_around_the_corner", ownership::four_around_the_corner, RANKS),
        Case::new("halo_sp", ownership::halo_sp, RANKS),
        Case::new("halo_dp", ownership::halo_dp, RANKS),
        Case::new("too_many_ranks", ownership::too_many_ranks, &[Start::new(4, 1), Start::new(6, 1), Start::new(8, 1)]),
        Case::new("lists_sp", lists::sp, RANKS),
        Case::new("lists_dp", lists::dp, RANKS),
        Case::new("changing_box_sp", lists::changing_box_sp, RANKS),
        Case::new("shrinking_box", lists::shrinking_box, RANKS),
        Case::new("changing_box_dp", lists::changing_box_dp, RANKS),
        Case::new("rebuilds_when_needed", lists::rebuilds_when_needed, ONE_AND_FOUR),
        Case::new("travel_is_measured_in_the_present_box", lists::travel_in_the_present_box, ONE_AND_FOUR),
        Case::new("forces_sp", invariance::forces_sp, RANKS_AND_THREADS),
        Case::new("forces_dp", invariance::forces_dp, RANKS_AND_THREADS),
        Case::new("forces_dp_edge_edge", invariance::forces_dp_edge_edge, RANKS_AND_THREADS),
        Case::new("fire_sp", invariance::fire_sp, RANKS_AND_THREADS),
        Case::new("fire_dp", invariance::fire_dp, RANKS_AND_THREADS),
        Case::new("spread_start", invariance::spread_start, FEW),
        Case::new("cg_sp", invariance::cg_sp, RANKS_AND_THREADS),
        Case::new("newton_sp", invariance::newton_sp, ONE_AND_FOUR),
        Case::new("newton_dp", invariance::newton_dp, FEW),
        Case::new("cg_dp", invariance::cg_dp, ONE_AND_FOUR),
        Case::new("turns_fire", invariance::turns_fire, TO_FOUR),
        Case::new("turns_heavy_ball", invariance::turns_heavy_ball, TO_FOUR),
        Case::new("turns_newton", invariance::turns_newton, TO_FOUR),
        Case::new("turns_cg", invariance::turns_cg, TO_FOUR),
        Case::new("onset_sp", invariance::onset_sp, RANKS_AND_THREADS),
        Case::new("onset_dp", invariance::onset_dp, RANKS_AND_THREADS),
        Case::new("moduli_sp", moduli::sp, RANKS_AND_THREADS),
        Case::new("moduli_dp", moduli::dp, FEW),
        Case::new("shear_sp", shear::sp, RANKS),
        Case::new("shear_dp", shear::dp, FEW),
        Case::new("box_flip", shear::flip, ONE_AND_FOUR),
        Case::new("voids_sp", invariance::voids_sp, TO_FOUR),
        Case::new("voids_dp", invariance::voids_dp, TO_FOUR),
        Case::new("hard_cases", hard_cases::all, ONE_AND_FOUR),
        Case::new("known_energies", hard_cases::known_energies, ONE_AND_FOUR),
        Case::new("relaxed_pair_of_48", hard_cases::relaxed_pair_of_48, ONE_AND_FOUR),
        Case::new("deep_compression", hard_cases::deep_compression, ONE_AND_FOUR),
        Case::new("onset_itself", hard_cases::onset_itself, ONE_AND_FOUR),
        Case::new("rattlers", hard_cases::rattlers, ONE_AND_FOUR),
        Case::new("crossed_outlines", hard_cases::crossed_outlines, ONE_AND_FOUR),
        Case::new("area_ratio_80", hard_cases::area_ratio_80, ONE_AND_FOUR),
        Case::new("compression_without_crossing", hard_cases::compression_without_crossing, ONE_AND_FOUR),
        Case::new("empty_subdomains", hard_cases::empty_subdomains, RANKS),
        Case::new("force_noise_sp", fixed_point::force_noise_sp, &[Start::new(1, 1)]),
        Case::new("force_noise_dp", fixed_point::force_noise_dp, &[Start::new(1, 1)]),
        Case::new("ensemble_sp", ensemble::soft_disks, &[Start::new(2, 1)]),
        Case::new("panic_on_one_rank", failure::panic_on_one_rank, &[Start::new(2, 1), Start::new(4, 1)]).must_abort(),
    ])
}
