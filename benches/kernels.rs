//! Parts of a step by themselves, one thread of one rank: `cargo bench --bench kernels`, or with a name after `--`.

mod systems;

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use jamhpc::comm::{Comm, FusedSums, Totals};
use jamhpc::engine::System;
use jamhpc::model::Model;
use jamhpc::output::{Frame, Header, ResultsFile};
use std::hint::black_box;
use systems::{RELAXING, deformable, run, soft_disks};

/// Polygons and disks of about as many points.
const POLYGONS: u32 = 1024;
const DISKS: u32 = 15_000;

fn forces<M: Model>(c: &mut Criterion, name: &str, system: &mut System<M>) {
    let mut group = c.benchmark_group("forces");
    group.throughput(Throughput::Elements(system.n_points()));
    group.bench_function(name, |b| b.iter(|| system.evaluate(|_, _, _, _| (), |(), ()| ()).expect("finite forces")));
}

fn lists<M: Model>(c: &mut Criterion, name: &str, system: &mut System<M>) {
    let mut group = c.benchmark_group("list build");
    group.throughput(Throughput::Elements(system.n_points()));
    let pbox = *system.pbox();
    group.bench_function(name, |b| {
        b.iter(|| {
            // the same particles in the same box, which the system cannot know
            let own = system.own_particles();
            system.restore(pbox, own);
            system.prepare().expect("a box that fits")
        })
    });
}

/// What a rank sends of its particles when lists are built.
fn packing<M: Model>(c: &mut Criterion, name: &str, system: &mut System<M>) {
    let particles = system.own_particles();
    let mut group = c.benchmark_group("pack");
    group.throughput(Throughput::Elements(system.n_points()));
    let mut message = Vec::new();
    group.bench_function(name, |b| {
        b.iter(|| {
            message.clear();
            (0..particles.len()).for_each(|p| particles.pack(p, false, &mut message));
            black_box(&message);
        })
    });
}

fn steps<M: Model>(c: &mut Criterion, name: &str, system: &mut System<M>) {
    const STEPS: u64 = 20;
    let mut group = c.benchmark_group("steps of FIRE");
    group.throughput(Throughput::Elements(STEPS * system.n_points()));
    group.bench_function(name, |b| b.iter(|| run(system, STEPS)));
}

fn output<M: Model>(c: &mut Criterion, name: &str, system: &mut System<M>) {
    let comm = Comm::alone();
    let folder = tempfile::tempdir().expect("a folder");
    let particles = system.own_particles();
    let mut group = c.benchmark_group("output");
    group.throughput(Throughput::Elements(system.n_points()));
    group.bench_function(name, |b| {
        b.iter(|| {
            let path = folder.path().join("results.h5");
            let mut file = ResultsFile::create(&comm, &path, &Header::default(), &particles).expect("a new file");
            let frame =
                Frame { step: 0, pbox: system.pbox(), particles: &particles, scalars: &[], tensors: &[], columns: &[] };
            file.append(&comm, &frame).expect("space");
            file.finish(&comm, None).expect("space");
            std::fs::remove_file(&path).expect("the file");
        })
    });
}

/// The sums of a step, three of products of vectors: exact, and as they come.
fn sums(c: &mut Criterion) {
    const N: usize = 512; // a chunk
    let number = |k: usize| ((k * 7919 + 13) % 1009) as f64 / 1009.0 - 0.5;
    let numbers: Vec<[f64; 4]> = (0..N).map(|k| [number(k), number(k + 1), number(k + 5), number(k + 77)]).collect();
    let grids = FusedSums::<2>::default().grids;
    let mut group = c.benchmark_group("sums");
    group.throughput(Throughput::Elements(N as u64));
    let terms = |[a, b, c, d]: [f64; 4]| ([a * c + b * d, a * a + b * b], [c * c + d * d, a * a, b * b]);
    group.bench_function("exact", |b| {
        b.iter(|| {
            let mut totals = Totals::<2>::default();
            for &row in black_box(&numbers) {
                let (sums, others) = terms(row);
                totals.add(&grids, sums, others);
            }
            totals
        })
    });
    group.bench_function("plain", |b| {
        b.iter(|| {
            let (mut sums, mut most) = ([0.0; 2], [0.0f64; 5]);
            for &row in black_box(&numbers) {
                let (terms, others) = terms(row);
                (0..2).for_each(|k| sums[k] += terms[k]);
                let all = [terms[0].abs(), terms[1].abs(), others[0], others[1], others[2]];
                (0..5).for_each(|k| most[k] = most[k].max(all[k]));
            }
            (sums, most)
        })
    });
}

fn all(c: &mut Criterion) {
    let mut polygons = deformable(Comm::alone(), POLYGONS);
    run(&mut polygons, RELAXING);
    let mut disks = soft_disks(Comm::alone(), DISKS);
    run(&mut disks, RELAXING);
    forces(c, "dp", &mut polygons);
    forces(c, "sp", &mut disks);
    steps(c, "dp", &mut polygons);
    steps(c, "sp", &mut disks);
    lists(c, "dp", &mut polygons);
    lists(c, "sp", &mut disks);
    packing(c, "dp", &mut polygons);
    packing(c, "sp", &mut disks);
    output(c, "dp", &mut polygons);
    output(c, "sp", &mut disks);
    sums(c);
}

criterion_group!(benches, all);
criterion_main!(benches);
