use super::Stiffness;
use crate::comm::Comm;
use crate::engine::System;
use crate::geometry::Vec2;
use crate::model::{Block, Model};
use faer::dyn_stack::{MemBuffer, MemStack};
use faer::linalg::cholesky::ldlt::factor::LdltRegularization;
use faer::sparse::linalg::cholesky::{
    CholeskySymbolicParams, LdltRef, SymbolicCholesky, SymbolicCholeskyRaw, SymmetricOrdering,
    factorize_symbolic_cholesky,
};
use faer::sparse::linalg::{SupernodalThreshold, amd};
use faer::sparse::{SparseColMatRef, SymbolicSparseColMat, SymbolicSparseColMatRef};
use faer::{Col, Conj, Par, Side, Spec};

/// Direct solutions of (H + shift) u = b by a sparse factor L D Lᵀ (Cholesky's without roots), for positive definite
/// matrices.
///
/// The area of a polygon couples each of its points to all others. As an unknown α of its own, which stands after the
/// points, it is coupled to each of them, and points to their neighbours only; this leaves a nearly planar network,
/// whose factor has few new entries:
///
/// ```text
/// (H₀ + shift) u + √k ∇a α = b,   √k ∇aᵀ u − α = 0:   without α, (H₀ + k ∇a ∇aᵀ + shift) u = b
/// ```
///
/// That matrix is positive definite if the larger one has as many negative eigenvalues as areas, and D as many negative
/// entries (Sylvester's law of inertia).
///
/// Rank 0 gathers the matrix, factors it on one thread and sends each rank its part of a solution: the same bits on any
/// number of ranks. In two dimensions the work grows little faster than the number of points. The analysis of the layout
/// is kept while it stays the same; then a matrix costs little more than to write its blocks where they belong.
#[derive(Default)]
pub struct Cholesky {
    /// Which blocks the ranks send, see [`Rows`].
    layout: Vec<Vec<u64>>,
    analysis: Option<Analysis>,
    /// Entries of the matrix in the places of the analysis, and its diagonal without shift.
    values: Vec<f64>,
    diagonal: Vec<f64>,
    factor: Vec<f64>,
    /// The shift with which there is a factor, on the root.
    shift: Option<f64>,
}

impl Cholesky {
    /// Takes H. Collective.
    pub fn load<M: Model>(&mut self, system: &System<M>, stiffness: &Stiffness) {
        let Rows { layout, values } = stiffness.lower_rows(system);
        let (layout, values) = (system.comm.gather(layout), system.comm.gather(values));
        self.shift = None;
        if !system.comm.is_root() {
            return;
        }
        if self.layout != layout {
            self.analysis = Analysis::of(&layout);
            self.layout = layout;
        }
        let Some(Analysis { slots, lower, .. }) = &self.analysis else { return };
        self.values.resize(lower.row_idx().len(), 0.0);
        for (block, slots) in values.iter().flat_map(|part| part.chunks_exact(4)).zip(slots) {
            for (&value, &slot) in block.iter().zip(slots) {
                self.values[slot] = f64::from_bits(value);
            }
        }
        self.diagonal.clear();
        self.diagonal.extend(lower.col_ptr()[..lower.ncols()].iter().map(|&place| self.values[place]));
    }

    /// Factors H + `shift`; false where that is not positive definite. Collective.
    pub fn factorize(&mut self, comm: &Comm, shift: f64) -> bool {
        if self.shift != Some(shift) {
            self.shift = (comm.is_root() && self.factorize_here(shift)).then_some(shift);
        }
        comm.broadcast(vec![self.shift.is_some() as u8])[0] == 1
    }

    fn factorize_here(&mut self, shift: f64) -> bool {
        let Some(Analysis { lower, pattern, is_area, .. }) = &self.analysis else { return false };
        for ((&place, &diagonal), &is_area) in lower.col_ptr().iter().zip(&self.diagonal).zip(is_area) {
            self.values[place] = if is_area { diagonal } else { diagonal + shift };
        }
        self.factor.resize(pattern.len_val(), 0.0);
        let mut scratch = MemBuffer::new(pattern.factorize_numeric_ldlt_scratch::<f64>(Par::Seq, Spec::default()));
        let done = pattern.factorize_numeric_ldlt(
            &mut self.factor,
            SparseColMatRef::new(lower.as_ref(), &self.values),
            Side::Lower,
            LdltRegularization::default(),
            Par::Seq,
            MemStack::new(&mut scratch),
            Spec::default(),
        );
        let areas = is_area.iter().filter(|&&is_area| is_area).count();
        done.is_ok() && not_positive(pattern, &self.factor) == areas
    }

    /// u for the own points, given b there. Collective; call [`Cholesky::factorize`] first.
    pub fn solve<M: Model>(&self, system: &System<M>, b: &[Vec2]) -> Vec<Vec2> {
        let comm = &system.comm;
        let name = super::names(system.particles());
        let named = |(&name, v): (&u64, &Vec2)| [name, v[0].to_bits(), v[1].to_bits()];
        let gathered = comm.gather(name.iter().zip(b).flat_map(named).collect::<Vec<u64>>());
        let mut parts = vec![Vec::new(); comm.size()];
        if let (Some(analysis), true) = (&self.analysis, self.shift.is_some()) {
            let mut x = Col::<f64>::zeros(analysis.lower.ncols());
            for named in gathered.iter().flat_map(|part| part.chunks_exact(3)) {
                let place = analysis.place(named[0]);
                [0, 1].into_iter().for_each(|k| x[2 * place + k] = f64::from_bits(named[1 + k]));
            }
            let mut rest = x.clone();
            analysis.solve(&self.factor, &mut x);
            // the matrix is not definite, and rows are not exchanged: a second time for what rounding has left
            analysis.subtract_product(&self.values, &x, &mut rest);
            analysis.solve(&self.factor, &mut rest);
            x += &rest;
            for (named, part) in gathered.iter().zip(&mut parts) {
                let places = named.chunks_exact(3).map(|named| analysis.place(named[0]));
                part.extend(places.flat_map(|place| [0, 1].map(|k| x[2 * place + k].to_bits())));
            }
        }
        let mine = comm.all_to_all(parts).swap_remove(0);
        mine.chunks_exact(2).map(|v| [f64::from_bits(v[0]), f64::from_bits(v[1])]).collect()
    }
}

/// How many entries of D are negative or no numbers. A supernode's columns are stored as a dense matrix, D on its
/// diagonal.
fn not_positive(pattern: &SymbolicCholesky<usize>, factor: &[f64]) -> usize {
    let SymbolicCholeskyRaw::Supernodal(nodes) = pattern.raw() else { panic!("supernodes were asked for") };
    let columns = nodes.supernode_begin().iter().zip(nodes.supernode_end()).map(|(begin, end)| end - begin);
    let values = nodes.col_ptr_for_val().windows(2).map(|bounds| &factor[bounds[0]..bounds[1]]);
    let of_node = |(columns, values): (usize, &[f64])| {
        let rows = values.len() / columns;
        values.iter().step_by(rows + 1).take(columns).filter(|pivot| pivot.is_nan() || **pivot < 0.0).count()
    };
    columns.zip(values).map(of_node).sum()
}

/// Where everything stands, for one layout of the matrix.
struct Analysis {
    /// Place of each particle's first point in the order of global ids.
    first: Vec<usize>,
    /// Places of the points in the order of elimination.
    places: Vec<usize>,
    /// Places of the four entries of each block, as they are sent, among the values of the matrix.
    slots: Vec<[usize; 4]>,
    /// The lower triangle in the order of elimination, by columns, each of which begins with the diagonal.
    lower: SymbolicSparseColMat<usize>,
    /// Of the factor.
    pattern: SymbolicCholesky<usize>,
    /// Whether a column is one of an area.
    is_area: Vec<bool>,
}

impl Analysis {
    fn of(layout: &[Vec<u64>]) -> Option<Self> {
        let mut rows: Vec<(u64, &[u64])> = Vec::new();
        for mut words in layout.iter().map(|part| &part[..]) {
            while let [name, length, rest @ ..] = words {
                let (columns, others) = rest.split_at(*length as usize);
                rows.push((*name, columns));
                words = others;
            }
        }
        let mut names: Vec<u64> = rows.iter().map(|&(name, _)| name).collect();
        names.sort_unstable();
        // names are (id, place in the particle), so that a particle's points stand together
        let particles = names.last().map_or(0, |&name| (name >> 32) as usize + 1);
        let mut first = vec![usize::MAX; particles];
        for (place, &name) in names.iter().enumerate().rev() {
            first[(name >> 32) as usize] = place;
        }
        let by_id = |name: u64| by_id(&first, name);

        let mut rows_by_id = vec![Vec::new(); rows.len()];
        for &(name, columns) in &rows {
            rows_by_id[by_id(name)] = columns.iter().map(|&column| by_id(column)).collect();
        }
        let places = order_of_elimination(&rows_by_id)?;

        // a block of the points i and j, and whether it is sent as that of j and i
        let blocks = || {
            let places = &places;
            rows.iter().flat_map(move |&(name, columns)| {
                let i = places[by_id(name)];
                columns.iter().map(move |&column| {
                    let j = places[by_id(column)];
                    (i.max(j), i.min(j), i < j)
                })
            })
        };
        // both columns of a point list the same others, the first both of its own, the second one
        let mut listed = vec![Vec::new(); rows.len()];
        blocks().filter(|&(i, j, _)| i > j).for_each(|(i, j, _)| listed[j].push(i));
        let (mut start, mut index) = (vec![0], Vec::new());
        for (j, points) in listed.iter_mut().enumerate() {
            points.sort_unstable();
            for own in [&[2 * j, 2 * j + 1][..], &[2 * j + 1]] {
                index.extend(own);
                index.extend(points.iter().flat_map(|&i| [2 * i, 2 * i + 1]));
                start.push(index.len());
            }
        }
        let slots = blocks().map(|(i, j, is_turned)| {
            let [left, right] = [start[2 * j], start[2 * j + 1]];
            if i == j {
                // symmetric but for rounding: what stands left of the diagonal counts
                return [left, left + 1, left + 1, right];
            }
            let at = 2 * listed[j].partition_point(|&other| other < i);
            let [left, right] = [left + 2 + at, right + 1 + at];
            if is_turned { [left, left + 1, right, right + 1] } else { [left, right, left + 1, right + 1] }
        });
        let slots = slots.collect();
        let mut is_area = vec![false; 2 * rows.len()];
        for &(name, _) in &rows {
            let place = 2 * places[by_id(name)];
            is_area[place..place + 2].fill(name & AREA != 0);
        }
        let size = 2 * rows.len();
        let lower = SymbolicSparseColMat::new_checked(size, size, start, None, index);
        let how = CholeskySymbolicParams {
            // column by column, large factors take several times as long
            supernodal_flop_ratio_threshold: SupernodalThreshold::FORCE_SUPERNODAL,
            ..Default::default()
        };
        // a pattern that is in order is asked for by its upper triangle
        let upper = lower.transpose().to_col_major().ok()?;
        let pattern =
            factorize_symbolic_cholesky(upper.as_ref(), Side::Upper, SymmetricOrdering::Identity, how).ok()?;
        Some(Analysis { first, places, slots, lower, pattern, is_area })
    }

    /// Solves with a factor.
    fn solve(&self, factor: &[f64], x: &mut Col<f64>) {
        let mut scratch = MemBuffer::new(self.pattern.solve_in_place_scratch::<f64>(1, Par::Seq));
        let factor = LdltRef::new(&self.pattern, factor);
        factor.solve_in_place_with_conj(Conj::No, x.as_mat_mut(), Par::Seq, MemStack::new(&mut scratch));
    }

    /// Takes the product of the matrix with these values and x from b.
    fn subtract_product(&self, values: &[f64], x: &Col<f64>, b: &mut Col<f64>) {
        let (start, rows) = (self.lower.col_ptr(), self.lower.row_idx());
        for (column, bounds) in start.windows(2).enumerate() {
            // the diagonal comes first
            b[column] -= values[bounds[0]] * x[column];
            for (&row, value) in rows[bounds[0]..bounds[1]].iter().zip(&values[bounds[0]..bounds[1]]).skip(1) {
                b[row] -= value * x[column];
                b[column] -= value * x[row];
            }
        }
    }

    /// Place of a point in the order of elimination.
    fn place(&self, name: u64) -> usize {
        self.places[by_id(&self.first, name)]
    }
}

/// Place of a point or area in the order of global ids, from its name and the places of each particle's first point.
fn by_id(first: &[usize], name: u64) -> usize {
    first[(name >> 32) as usize] + (name & !AREA) as u32 as usize
}

/// Places of the points in an order of least degree, which makes few new entries, from the columns in each row of the
/// lower triangle. Both degrees of freedom of a point have the same pattern, so points are put in order and not these.
fn order_of_elimination(rows: &[Vec<usize>]) -> Option<Vec<usize>> {
    let points = rows.len();
    let (mut start, mut index) = (vec![0], Vec::new());
    for columns in rows {
        index.extend(columns);
        start.push(index.len());
    }
    let blocks = SymbolicSparseColMatRef::new_checked(points, points, &start, None, &index);
    let (mut order, mut places) = (vec![0; points], vec![0; points]);
    let mut scratch = MemBuffer::new(amd::order_maybe_unsorted_scratch::<usize>(points, index.len()));
    let stack = MemStack::new(&mut scratch);
    amd::order_maybe_unsorted(&mut order, &mut places, blocks, amd::Control::default(), stack).ok()?;
    Some(places)
}

/// Part of the names of areas: (id, place after the points of the particle).
const AREA: u64 = 1 << 31;

/// The own rows of the lower triangle of H, and those of the areas, which look like points whose second component is
/// coupled to nothing.
struct Rows {
    /// For each row the global name of its point or area, the number of its blocks and the names of their columns,
    /// ascending, the row's own last.
    layout: Vec<u64>,
    /// The blocks, four words each.
    values: Vec<u64>,
}

impl Stiffness {
    fn lower_rows<M: Model>(&self, system: &System<M>) -> Rows {
        let particles = system.particles();
        let name = super::names(particles);
        let mut rows = Rows { layout: Vec::new(), values: Vec::new() };
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
                rows.layout.extend([name[i], row.len() as u64]);
                rows.layout.extend(row.iter().map(|&(other, _)| other));
                rows.values.extend(row.iter().flat_map(|(_, block)| block.map(f64::to_bits)));
            }
            if M::BODIES {
                let (root, n) = (self.area_stiffness.sqrt(), points.len() as u64);
                let area = (name[points.start] + n) | AREA;
                rows.layout.extend([area, n + 1]);
                rows.layout.extend(name[points.clone()].iter().chain([&area]));
                let blocks = self.area_gradient[points].iter().map(|g| [root * g[0], root * g[1], 0.0, 0.0]);
                rows.values.extend(blocks.chain([[-1.0, 0.0, 0.0, -1.0]]).flatten().map(f64::to_bits));
            }
        }
        rows
    }
}
