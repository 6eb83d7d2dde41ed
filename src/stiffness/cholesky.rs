use super::Stiffness;
use crate::comm::Comm;
use crate::engine::System;
use crate::geometry::Vec2;
use crate::model::{Block, Model};
use faer::dyn_stack::{MemBuffer, MemStack};
use faer::linalg::cholesky::llt::factor::LltRegularization;
use faer::perm::PermRef;
use faer::sparse::linalg::cholesky::{
    CholeskySymbolicParams, LltRef, SymbolicCholesky, SymmetricOrdering, factorize_symbolic_cholesky,
};
use faer::sparse::linalg::{SupernodalThreshold, amd};
use faer::sparse::{SparseColMat, SymbolicSparseColMat, SymbolicSparseColMatRef};
use faer::{Col, Conj, Par, Side, Spec};

/// Direct solutions of (H + shift) u = b by a sparse Cholesky factor, which exists where that matrix is positive
/// definite.
///
/// Rank 0 gathers the matrix, in the order of global ids, factors it on one thread and sends each rank its part of a
/// solution: the same bits on any number of ranks. In two dimensions the work grows little faster than the number of
/// points. The analysis of the pattern is kept while it stays the same.
#[derive(Default)]
pub struct Cholesky {
    matrix: Option<SparseColMat<usize, f64>>,
    pattern: Option<SymbolicCholesky<usize>>,
    /// Values of the factor, empty where there is none.
    factor: Vec<f64>,
    /// Place of each particle's first point in the order of global ids. Rank 0 only, as the above.
    first: Vec<usize>,
}

impl Cholesky {
    /// Takes H. Collective.
    pub fn load<M: Model>(&mut self, system: &System<M>, stiffness: &Stiffness) {
        let rows = system.comm.gather(stiffness.lower_rows(system));
        if system.comm.is_root() {
            self.assemble(&rows);
        }
    }

    /// Factors H + `shift`; false where that is not positive definite. Collective.
    pub fn factorize(&mut self, comm: &Comm, shift: f64) -> bool {
        let done = comm.is_root() && self.factorize_here(shift);
        comm.broadcast(vec![done as u8])[0] == 1
    }

    fn factorize_here(&mut self, shift: f64) -> bool {
        let (Some(matrix), Some(pattern)) = (&self.matrix, &self.pattern) else { return false };
        let mut shifted = matrix.clone();
        let ends: Vec<usize> = shifted.col_ptr()[1..].to_vec();
        // the diagonal closes each column of the upper triangle
        ends.iter().for_each(|&end| shifted.val_mut()[end - 1] += shift);
        self.factor.resize(pattern.len_val(), 0.0);
        let mut scratch = MemBuffer::new(pattern.factorize_numeric_llt_scratch::<f64>(Par::Seq, Spec::default()));
        let done = pattern.factorize_numeric_llt(
            &mut self.factor,
            shifted.as_ref(),
            Side::Upper,
            LltRegularization::default(),
            Par::Seq,
            MemStack::new(&mut scratch),
            Spec::default(),
        );
        if done.is_err() {
            self.factor.clear();
        }
        !self.factor.is_empty()
    }

    /// u for the own points, given b there. Collective; call [`Cholesky::factorize`] first.
    pub fn solve<M: Model>(&self, system: &System<M>, b: &[Vec2]) -> Vec<Vec2> {
        let comm = &system.comm;
        let name = super::names(system.particles());
        let named = |(&name, v): (&u64, &Vec2)| [name, v[0].to_bits(), v[1].to_bits()];
        let gathered = comm.gather(name.iter().zip(b).flat_map(named).collect::<Vec<u64>>());
        let mut parts = vec![Vec::new(); comm.size()];
        if let (Some(pattern), false) = (&self.pattern, self.factor.is_empty()) {
            let factor = LltRef::new(pattern, &self.factor);
            let mut x = Col::<f64>::zeros(gathered.iter().map(|part| part.len() / 3 * 2).sum());
            for named in gathered.iter().flat_map(|part| part.chunks_exact(3)) {
                let place = place(&self.first, named[0]);
                [0, 1].into_iter().for_each(|k| x[2 * place + k] = f64::from_bits(named[1 + k]));
            }
            let mut scratch = MemBuffer::new(pattern.solve_in_place_scratch::<f64>(1, Par::Seq));
            factor.solve_in_place_with_conj(Conj::No, x.as_mat_mut(), Par::Seq, MemStack::new(&mut scratch));
            for (named, part) in gathered.iter().zip(&mut parts) {
                let places = named.chunks_exact(3).map(|named| place(&self.first, named[0]));
                part.extend(places.flat_map(|place| [0, 1].map(|k| x[2 * place + k].to_bits())));
            }
        }
        let mine = comm.all_to_all(parts).swap_remove(0);
        mine.chunks_exact(2).map(|v| [f64::from_bits(v[0]), f64::from_bits(v[1])]).collect()
    }

    /// The upper triangle by columns, from rows of the lower one in any order.
    fn assemble(&mut self, rows_of_ranks: &[Vec<u64>]) {
        let mut rows: Vec<(u64, &[u64])> = Vec::new();
        for mut words in rows_of_ranks.iter().map(|w| &w[..]) {
            while let [name, length, rest @ ..] = words {
                let (row, others) = rest.split_at(*length as usize);
                rows.push((*name, row));
                words = others;
            }
        }
        rows.sort_unstable_by_key(|&(name, _)| name);
        // names are (id, place in the particle), so that a particle's points stand together
        let particles = rows.last().map_or(0, |&(name, _)| (name >> 32) as usize + 1);
        self.first = vec![usize::MAX; particles];
        for (place, &(name, _)) in rows.iter().enumerate() {
            let slot = &mut self.first[(name >> 32) as usize];
            *slot = place.min(*slot);
        }

        let n = 2 * rows.len();
        let (mut start, mut index, mut values) = (vec![0], Vec::new(), Vec::new());
        for (i, &(_, row)) in rows.iter().enumerate() {
            for c in 0..2 {
                for entry in row.chunks_exact(5) {
                    let j = place(&self.first, entry[0]);
                    for r in (0..2).filter(|&r| j < i || r <= c) {
                        index.push(2 * j + r);
                        values.push(f64::from_bits(entry[1 + 2 * c + r]));
                    }
                }
                start.push(index.len());
            }
        }
        let same = |m: &SparseColMat<usize, f64>| m.col_ptr() == start && m.row_idx() == index;
        let is_known = self.matrix.as_ref().is_some_and(same);
        let matrix = SparseColMat::new(SymbolicSparseColMat::new_checked(n, n, start, None, index), values);
        if !is_known {
            self.pattern = analysis(matrix.symbolic());
        }
        self.matrix = Some(matrix);
        self.factor.clear();
    }
}

/// Place of a point in the order of global ids, from its name and the places of each particle's first point.
fn place(first: &[usize], name: u64) -> usize {
    first[(name >> 32) as usize] + name as u32 as usize
}

/// Order of elimination and pattern of the factor. Both degrees of freedom of a point have the same pattern, so points
/// are put in order of least degree; the small dense blocks of particles make supernodes.
fn analysis(matrix: SymbolicSparseColMatRef<'_, usize>) -> Option<SymbolicCholesky<usize>> {
    let points = matrix.ncols() / 2;
    let (mut start, mut index) = (vec![0], Vec::new());
    for point in 0..points {
        index.extend(matrix.row_idx_of_col(2 * point).filter(|row| row % 2 == 0).map(|row| row / 2));
        start.push(index.len());
    }
    let blocks = SymbolicSparseColMatRef::new_checked(points, points, &start, None, &index);
    let (mut order, mut places) = (vec![0; points], vec![0; points]);
    let mut scratch = MemBuffer::new(amd::order_maybe_unsorted_scratch::<usize>(points, index.len()));
    let stack = MemStack::new(&mut scratch);
    amd::order_maybe_unsorted(&mut order, &mut places, blocks, amd::Control::default(), stack).ok()?;
    let both = |points: &[usize]| points.iter().flat_map(|&p| [2 * p, 2 * p + 1]).collect::<Vec<usize>>();
    let (order, places) = (both(&order), both(&places));
    let how = CholeskySymbolicParams {
        supernodal_flop_ratio_threshold: SupernodalThreshold::FORCE_SUPERNODAL,
        ..Default::default()
    };
    let order = SymmetricOrdering::Custom(PermRef::new_checked(&order, &places, 2 * points));
    factorize_symbolic_cholesky(matrix, Side::Upper, order, how).ok()
}

impl Stiffness {
    /// The own rows of the lower triangle of H, area term included, in words: the global name of the row's point, the
    /// number of words that follow for it, then name and block of each column, ascending.
    fn lower_rows<M: Model>(&self, system: &System<M>) -> Vec<u64> {
        let particles = system.particles();
        let name = super::names(particles);
        let mut words = Vec::new();
        let mut row: Vec<(u64, Block)> = Vec::new();
        for p in 0..particles.len() {
            let points = particles.bodies.points(p);
            for i in points.clone() {
                row.clear();
                row.extend(self.row(i).iter().map(|&(j, block)| (name[j as usize], block)));
                row.retain(|&(other, _)| other <= name[i]);
                if row.last().is_none_or(|&(other, _)| other < name[i]) {
                    row.push((name[i], [0.0; 4]));
                }
                if M::BODIES {
                    // the area couples all points of the particle: they stand at the end of the row
                    let own = row.partition_point(|&(other, _)| other < name[points.start]);
                    let mut listed = row.split_off(own).into_iter().peekable();
                    let g = self.area_gradient[i];
                    for (&other, &h) in name[points.start..=i].iter().zip(&self.area_gradient[points.start..=i]) {
                        let area =
                            [g[0] * h[0], g[0] * h[1], g[1] * h[0], g[1] * h[1]].map(|x| self.area_stiffness * x);
                        let block = listed.next_if(|&(column, _)| column == other).map_or([0.0; 4], |(_, block)| block);
                        row.push((other, std::array::from_fn(|k| area[k] + block[k])));
                    }
                }
                words.extend([name[i], 5 * row.len() as u64]);
                words.extend(
                    row.iter().flat_map(|(other, b)| {
                        [*other, b[0].to_bits(), b[1].to_bits(), b[2].to_bits(), b[3].to_bits()]
                    }),
                );
            }
        }
        words
    }
}
