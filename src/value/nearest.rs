//! The search of the points that are nearest to others: by products in single precision, or on a grid over their widest coordinates.

use std::array::from_fn;
use std::ops::Range;

use faer::linalg::matmul::matmul;
use faer::{Accum, ColRef, Mat, MatRef, Par};
use pulp::NullaryFnOnce;

/// Points whose products with others are made at a time: they are compared while they are in the cache.
const TILE: usize = 1024;
/// Numbers that are compared at once, on vectors.
const BLOCK: usize = 32;
/// Points whose mean is at most this many times as far from the origin, squared, as they are from their mean are searched as they
/// are: single precision then keeps at least five of its seven digits of their distances.
const UNMOVED_OFFSET: f64 = 100.0;
/// Mean squared distances from the mean whose points are searched in their own units: squares of products stay in range.
const UNMOVED_SQUARES: Range<f64> = 1e-12..1e12;
/// Points in a square of a grid, about.
const GRID_POINTS: f64 = 4.0;
/// Squares out of which nothing is told apart.
const GRID_FAR: f64 = 1e12;
/// Coordinates, of those that vary most, that tell of most points that they are too far away.
const WIDE: usize = 4;
/// Coordinates whose differences are squared side by side.
const LANES: usize = 8;

/// The `kept` ≥ 1 least of some numbers and their places, gathered as they come.
struct Least {
    kept: usize,
    /// Larger numbers are none of them.
    limit: f32,
    /// They, and others that came in before the limit was lowered; fewer than twice as many.
    found: Vec<(f32, u32)>,
}

impl Least {
    fn new(kept: usize) -> Self {
        Least { kept, limit: f32::INFINITY, found: Vec::with_capacity(2 * kept) }
    }

    #[inline]
    fn take(&mut self, number: f32, place: u32) {
        if number <= self.limit {
            self.found.push((number, place));
            if self.found.len() == 2 * self.kept {
                self.lower();
            }
        }
    }

    /// Leave the least ones, of equal ones those with the first places.
    fn lower(&mut self) {
        if self.found.len() >= self.kept {
            let order = |a: &(f32, u32), b: &(f32, u32)| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1));
            self.limit = self.found.select_nth_unstable_by(self.kept - 1, order).1.0;
            self.found.truncate(self.kept);
        }
    }

    /// The largest of them; infinite where there are not enough yet.
    fn most(&mut self) -> f32 {
        self.lower();
        self.limit
    }

    /// Their places, in no order.
    fn places(mut self) -> Vec<u32> {
        self.lower();
        self.found.into_iter().map(|of| of.1).collect()
    }
}

/// Distances of a tile of points from another one, up to the norm of that, which is the same for all.
struct Compare<'a> {
    least: &'a mut Least,
    norms: &'a [f32],
    products: &'a [f32],
    /// Place of the first point of the tile.
    first: usize,
}

impl NullaryFnOnce for Compare<'_> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        let Compare { least, norms, products, first } = self;
        let distance = |norm: f32, product: f32| norm - 2.0 * product;
        let ((norms, last_norms), (products, last)) = (norms.as_chunks::<BLOCK>(), products.as_chunks::<BLOCK>());
        for (start, (norms, products)) in (first..).step_by(BLOCK).zip(norms.iter().zip(products)) {
            // Few of all come in, so that this takes less than the products.
            let (mut distances, mut any) = ([0.0; BLOCK], false);
            for i in 0..BLOCK {
                distances[i] = distance(norms[i], products[i]);
                any |= distances[i] <= least.limit;
            }
            if any {
                (start..).zip(distances).for_each(|(place, distance)| least.take(distance, place as u32));
            }
        }
        let rest = (first + norms.as_flattened().len()..).zip(last_norms.iter().zip(last));
        rest.for_each(|(place, (&norm, &product))| least.take(distance(norm, product), place as u32));
    }
}

/// For each of some other points the places of the `kept` nearest ones, in no order, as far as single precision tells; `kept` is less than the
/// number of points. With numbers out of its range there may be fewer.
///
/// # Shapes
/// `points: p × N`, `norms`: their squared norms, `N`, `at: p × n`.
pub(super) fn nearest(points: MatRef<'_, f32>, norms: &[f32], at: MatRef<'_, f32>, kept: usize) -> Vec<Vec<u32>> {
    let mut least: Vec<Least> = (0..at.ncols()).map(|_| Least::new(kept)).collect();
    let mut products = Mat::zeros(TILE.min(points.ncols()), at.ncols());
    for (tile, norms) in norms.chunks(TILE).enumerate() {
        let (first, count) = (tile * TILE, norms.len());
        let of_tile = points.subcols(first, count).transpose();
        matmul(products.as_mut().subrows_mut(0, count), Accum::Replace, of_tile, at, 1.0, Par::Seq);
        for (j, least) in least.iter_mut().enumerate() {
            let products = &products.col_as_slice(j)[..count];
            pulp::Arch::new().dispatch(Compare { least, norms, products, first });
        }
    }
    least.into_iter().map(Least::places).collect()
}

/// By how much `‖x‖² − 2xᵀy` in single precision may miss, for `p` coordinates and squared norms up to these; infinite where it
/// may overflow.
pub(super) fn rounding(p: usize, x: f64, y: f64) -> f64 {
    let size = x + 2.0 * (x * y).sqrt();
    let underflow = p as f64 * f64::from(f32::MIN_POSITIVE);
    if size < f64::from(f32::MAX) {
        (p + 4) as f64 * 0.5 * f64::from(f32::EPSILON) * size + underflow
    } else {
        f64::INFINITY
    }
}

/// Distances come from `‖x‖² − 2xᵀy` in single precision, which loses them where points are far from the origin compared with
/// their spread, or where squares leave the range of numbers. Such points are searched around their mean, in other units.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Move {
    /// Mean of each coordinate.
    shift: Vec<f64>,
    /// A power of two.
    pub scale: f64,
}

impl Move {
    /// What points need, if they need it.
    pub fn of(points: MatRef<'_, f32>) -> Option<Self> {
        let n = points.ncols() as f64;
        let mean = |i: usize| (0..points.ncols()).map(|j| f64::from(points[(i, j)])).sum::<f64>() / n;
        let shift: Vec<f64> = (0..points.nrows()).map(mean).collect();
        let square = |i: usize, j: usize| (f64::from(points[(i, j)]) - shift[i]).powi(2);
        let spread =
            (0..points.ncols()).map(|j| (0..points.nrows()).map(|i| square(i, j)).sum::<f64>()).sum::<f64>() / n;
        let offset = shift.iter().map(|mean| mean * mean).sum::<f64>();
        let moderate = UNMOVED_SQUARES.contains(&spread) || spread == 0.0;
        if offset <= UNMOVED_OFFSET * spread && moderate {
            return None;
        }
        let scale = if spread > 0.0 { (-0.5 * spread.log2()).round().exp2() } else { 1.0 };
        Some(Move { shift, scale })
    }

    /// Points around the mean, in these units, `p × n`.
    pub fn apply(&self, points: MatRef<'_, f32>) -> Mat<f32> {
        let moved = |i: usize, j: usize| ((f64::from(points[(i, j)]) - self.shift[i]) * self.scale) as f32;
        Mat::from_fn(points.nrows(), points.ncols(), moved)
    }
}

/// Points of an action by the squares that they lie in, over two coordinates: far apart in these is far apart. Where places are among
/// the coordinates, next to all points lie too far away to be looked at.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Grid {
    /// The coordinates that vary most, of the squares first.
    axes: Vec<usize>,
    corner: [f64; 2],
    side: f64,
    /// Squares along each axis.
    squares: [i64; 2],
    /// Where the points of each square begin in `points`; one more than squares.
    begins: Vec<u32>,
    points: Vec<(u32, [f32; WIDE])>,
}

impl Grid {
    /// `None` where the points lie on a line or in one place.
    pub fn new(points: MatRef<'_, f32>, axes: &[usize], of: Range<usize>) -> Option<Self> {
        let at = |j: usize| [0, 1].map(|axis| f64::from(points[(axes[axis], j)]));
        let axes = axes.to_vec();
        let (mut corner, mut end) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
        for point in of.clone().map(at) {
            for axis in 0..2 {
                (corner[axis], end[axis]) = (corner[axis].min(point[axis]), end[axis].max(point[axis]));
            }
        }
        let n = of.len();
        if n == 0 {
            return Some(Grid {
                axes,
                corner: [0.0; 2],
                side: 1.0,
                squares: [0; 2],
                begins: vec![0],
                points: Vec::new(),
            });
        }
        let side = ((end[0] - corner[0]) * (end[1] - corner[1]) * GRID_POINTS / n as f64).sqrt();
        let mut grid = Grid { axes, corner, side, squares: [0; 2], begins: Vec::new(), points: Vec::new() };
        grid.squares = grid.square(end).map(|last| last + 1);
        let count =
            grid.squares[0].checked_mul(grid.squares[1]).filter(|&count| side > 0.0 && count <= (2 * n) as i64)?;
        let square = |j: usize| {
            let [x, y] = grid.square(at(j));
            (x * grid.squares[1] + y) as usize
        };
        let mut sorted: Vec<(usize, u32)> = of.map(|j| (square(j), j as u32)).collect();
        sorted.sort_unstable();
        grid.begins = (0..=count as usize).map(|k| sorted.partition_point(|of| of.0 < k) as u32).collect();
        let wide = |j: u32| grid.wide(points.col(j as usize));
        grid.points = sorted.into_iter().map(|of| (of.1, wide(of.1))).collect();
        Some(grid)
    }

    /// The coordinates of a point that vary most; 0 where there are fewer.
    fn wide(&self, point: ColRef<'_, f32>) -> [f32; WIDE] {
        from_fn(|i| self.axes.get(i).map_or(0.0, |&axis| point[axis]))
    }

    fn square(&self, at: [f64; 2]) -> [i64; 2] {
        // From so far away all points are equally far.
        [0, 1].map(|axis| ((at[axis] - self.corner[axis]) / self.side).floor().clamp(-GRID_FAR, GRID_FAR) as i64)
    }

    /// The `kept` nearest points, in no order, and how many were looked at. Squares around the point are searched ring by ring, until
    /// none farther out can hold a nearer one.
    pub fn nearest(&self, points: MatRef<'_, f32>, at: ColRef<'_, f32>, kept: usize) -> (Vec<u32>, usize) {
        let wide = self.wide(at);
        let middle = self.square([0, 1].map(|axis| f64::from(wide[axis])));
        let at: Vec<f32> = at.iter().copied().collect();
        // A sum of squares in single precision may be less than another of some of them by this share.
        let slack = 1.0 + (at.len() + WIDE) as f32 * f32::EPSILON;
        let (mut nearest, mut looked_at) = (Least::new(kept), 0);
        // How far out the grid begins, and where it ends.
        let outside = |axis: usize| (-middle[axis]).max(middle[axis] - (self.squares[axis] - 1)).max(0);
        let farthest = |axis: usize| middle[axis].abs().max((self.squares[axis] - 1 - middle[axis]).abs());
        for ring in outside(0).max(outside(1))..=farthest(0).max(farthest(1)) {
            if f64::from(nearest.most()) <= ((ring - 1).max(0) as f64 * self.side).powi(2) {
                break;
            }
            let [ends_x, ends_y] = middle.map(|at| [at - ring, at + ring]);
            let within = |axis: usize, [first, end]: [i64; 2]| first.max(0)..=end.min(self.squares[axis] - 1);
            for x in within(0, ends_x) {
                let mut look = |y: i64| {
                    let square = (x * self.squares[1] + y) as usize;
                    let of = &self.points[self.begins[square] as usize..self.begins[square + 1] as usize];
                    looked_at += of.len();
                    for (point, coordinates) in of {
                        let part = coordinates.iter().zip(wide).map(|(a, b)| (a - b) * (a - b)).sum::<f32>();
                        if part <= slack * nearest.limit {
                            nearest.take(apart(points, *point, &at), *point);
                        }
                    }
                };
                if ends_x.contains(&x) {
                    within(1, ends_y).for_each(&mut look);
                } else {
                    ends_y.into_iter().filter(|y| (0..self.squares[1]).contains(y)).for_each(&mut look);
                }
            }
        }
        (nearest.places(), looked_at)
    }
}

/// Squared distance of two points, in single precision: of differences, so that nothing is lost.
#[inline]
pub(super) fn apart(points: MatRef<'_, f32>, point: u32, at: &[f32]) -> f32 {
    let Some(of) = points.col(point as usize).try_as_col_major() else { return f32::INFINITY };
    let (of, rest) = of.as_slice().as_chunks::<LANES>();
    let (at, rest_at) = at.as_chunks::<LANES>();
    let mut sums = [0.0; LANES];
    for (a, b) in of.iter().zip(at) {
        for lane in 0..LANES {
            sums[lane] += (a[lane] - b[lane]) * (a[lane] - b[lane]);
        }
    }
    sums.iter().sum::<f32>() + rest.iter().zip(rest_at).map(|(a, b)| (a - b) * (a - b)).sum::<f32>()
}

/// The coordinates that vary most, of two or more.
pub(super) fn widest(points: MatRef<'_, f32>) -> Option<Vec<usize>> {
    let n = points.ncols() as f64;
    let variance = |i: usize| {
        let row = || points.row(i).iter().map(|&x| f64::from(x));
        let mean = row().sum::<f64>() / n;
        row().map(|x| (x - mean).powi(2)).sum::<f64>()
    };
    let mut axes: Vec<(f64, usize)> = (0..points.nrows()).map(|i| (variance(i), i)).collect();
    axes.sort_by(|a, b| b.0.total_cmp(&a.0));
    (axes.len() > 1).then(|| axes.into_iter().take(WIDE).map(|of| of.1).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_nearest_are_found_among_several_tiles_and_of_equally_near_ones_the_first() {
        // Small whole numbers: products are exact, and many points are equally near.
        let coordinate = |i: usize, j: usize| ((j * (7 + 4 * i) + j / 11) % 9) as f32;
        let n = 2 * TILE + 77;
        let points = Mat::from_fn(3, n, coordinate);
        let at = Mat::from_fn(3, 5, |i, j| coordinate(i, 400 * j) + if j == 4 { 20.0 } else { 0.0 });
        let norms: Vec<f32> = points.col_iter().map(|point| point.squared_norm_l2()).collect();
        for kept in [1, 2, 17, n - 1] {
            let found = nearest(points.as_ref(), &norms, at.as_ref(), kept);
            for (j, mut found) in found.into_iter().enumerate() {
                let squared =
                    |place: u32| (0..3).map(|i| (points[(i, place as usize)] - at[(i, j)]).powi(2)).sum::<f32>();
                let mut expected: Vec<u32> = (0..n as u32).collect();
                expected.sort_by(|&a, &b| squared(a).total_cmp(&squared(b)));
                expected.truncate(kept);
                expected.sort_unstable();
                found.sort_unstable();
                assert_eq!(found, expected, "{kept} nearest of point {j}");
            }
        }
    }
}
