//! Products of observations with support vectors that are kept while both change.

use std::collections::{BTreeMap, HashMap};
use std::sync::Arc;

use faer::linalg::matmul::matmul;
use faer::{Accum, Mat, Par};

use super::matrix::squared_norms;

/// Observations of whole numbers whose squared norms are below this have exact products in single precision; see [`Kernel::matrix`](super::Kernel::matrix).
pub const EXACT: f64 = 16_777_216.0;

/// Products of observations with support vectors, both of whole numbers, as long as they are exact: they are then the same bits whenever they were computed,
/// and with [`Kernel::matrix_of_products`](super::Kernel::matrix_of_products) they give the kernel values of
/// [`Kernel::matrix`](super::Kernel::matrix), under any kernel.
///
/// # Cost
/// `2d` operations for each pair that is new, and `4` bytes for each that is kept, as long as there is room.
///
/// ```
/// use std::sync::Arc;
/// use adagio::kernel::KeptProducts;
/// use faer::{Mat, Par};
///
/// let x = Mat::<f32>::from_fn(2, 3, |i, j| (i + j) as f32);
/// let mut kept = KeptProducts::new(1000);
/// kept.begin(&Arc::new(x.clone()));
/// let (products, norms) = kept.of(&[7, 8, 9], |places| Mat::from_fn(2, places.len(), |i, j| x[(i, places[j])]), Par::Seq).unwrap();
/// assert_eq!((products[(0, 2)], norms), (3.0, vec![1.0, 5.0, 13.0]));
/// ```
#[derive(Debug, Clone)]
pub struct KeptProducts {
    /// Products that there is room for.
    room: usize,
    /// Products that room is taken for.
    taken: usize,
    /// The support vectors, `d × m`; none where their products are not exact.
    members: Option<Arc<Mat<f32>>>,
    /// By the number of the observation.
    kept: HashMap<u64, Kept>,
}

#[derive(Debug, Clone)]
struct Kept {
    norm: f64,
    /// With the first support vectors, in their order.
    products: Vec<f32>,
    /// Whether it was asked for since [`KeptProducts::begin`].
    is_used: bool,
}

impl KeptProducts {
    /// None yet, and room for so many products, of 4 bytes each: others are computed whenever they are asked for.
    pub fn new(room: usize) -> Self {
        KeptProducts { room, taken: 0, members: None, kept: HashMap::new() }
    }

    /// Go on with these support vectors, `d × m`. Products with those that are first in both sets are kept, of observations that were
    /// asked for since the last call.
    pub fn begin(&mut self, members: &Arc<Mat<f32>>) {
        let (before, m) = (self.members.take(), members.ncols());
        let alike = |before: &Arc<Mat<f32>>| {
            let same = |j: &usize| {
                *j < before.ncols() && before.nrows() == members.nrows() && before.col(*j) == members.col(*j)
            };
            (0..m).find(|j| !same(j)).unwrap_or(m)
        };
        let alike = before.as_ref().map_or(0, alike);
        self.kept.retain(|_, kept| std::mem::take(&mut kept.is_used) && alike > 0);
        self.kept.values_mut().for_each(|kept| kept.products.truncate(alike));
        if squared_norms(members.as_ref().as_ref()).iter().all(|&norm| norm < EXACT) {
            self.members = Some(members.clone());
        } else {
            self.kept.clear();
        }
        self.taken = self.kept.values().map(|kept| kept.products.capacity()).sum();
    }

    /// Products of observations with all support vectors, `m × n`, and the squared norms of the observations, `n`; `None` where they
    /// would not be exact, or observations have another length than support vectors.
    ///
    /// `numbers` tell observations apart, from call to call. `columns` gives some of them, by their places in `numbers`, as a matrix
    /// with a column of whole numbers for each.
    pub fn of(
        &mut self,
        numbers: &[u64],
        columns: impl Fn(&[usize]) -> Mat<f32>,
        par: Par,
    ) -> Option<(Mat<f32>, Vec<f64>)> {
        let members = self.members.clone()?;
        let m = members.ncols();
        let mut by_count: BTreeMap<usize, Vec<usize>> = BTreeMap::new();
        for (place, number) in numbers.iter().enumerate() {
            let count = self.kept.get(number).map_or(0, |kept| kept.products.len());
            by_count.entry(count).or_default().push(place);
        }
        let (mut products, mut norms) = (Mat::zeros(m, numbers.len()), vec![0.0; numbers.len()]);
        // Those that are new, and may not be exact, come first.
        for (count, places) in by_count {
            let mut new = Mat::<f32>::zeros(m - count, places.len());
            if count < m {
                let x = columns(&places);
                if x.nrows() != members.nrows() {
                    return None;
                }
                if count == 0 {
                    for (norm, &place) in squared_norms(x.as_ref()).into_iter().zip(&places) {
                        norms[place] = norm;
                    }
                    if norms.iter().any(|&norm| norm >= EXACT) {
                        return None;
                    }
                }
                let others = members.as_ref().as_ref().subcols(count, m - count);
                matmul(new.as_mut(), Accum::Replace, others.transpose(), x.as_ref(), 1.0, par);
            }
            for (j, &place) in places.iter().enumerate() {
                let of = products.col_as_slice_mut(place);
                of[count..].copy_from_slice(new.col_as_slice(j));
                if let Some(kept) = self.kept.get_mut(&numbers[place]).filter(|_| count > 0) {
                    of[..count].copy_from_slice(&kept.products[..count]);
                    norms[place] = kept.norm;
                    kept.is_used = true;
                }
                self.keep(numbers[place], of, norms[place]);
            }
        }
        Some((products, norms))
    }

    /// Keep the products of an observation, those that are not kept yet, if there is room for them.
    fn keep(&mut self, number: u64, products: &[f32], norm: f64) {
        let before = self.kept.get(&number).map_or(0, |kept| kept.products.capacity());
        let more = products.len().saturating_sub(before);
        if self.taken + more > self.room {
            return;
        }
        self.taken += more;
        let kept = self.kept.entry(number).or_insert(Kept { norm, products: Vec::new(), is_used: true });
        let new = &products[kept.products.len()..];
        kept.products.reserve_exact(new.len());
        kept.products.extend_from_slice(new);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kernel::Kernel;

    fn pixels(i: usize, j: usize) -> f32 {
        ((i * 37 + j * 101 + i * j) % 181) as f32 - 90.0
    }

    #[test]
    fn kept_products_give_the_kernel_values_bit_for_bit_while_support_vectors_come_and_go() {
        let (d, kernel) = (300, Kernel::gaussian(900.0).unwrap());
        let x = Mat::<f32>::from_fn(d, 60, pixels);
        // Which support vectors and which observations there are: more, other ones first, fewer, and none that were before.
        let turns = [
            (vec![3, 5], 0..20),
            (vec![3, 5, 9, 40], 5..60),
            (vec![5, 9, 40], 5..60),
            (vec![5], 0..60),
            (vec![8, 9], 1..3),
        ];
        // There is room for all, for some, and for none.
        for room in [1000, 90, 0] {
            let mut kept = KeptProducts::new(room);
            for (members, window) in &turns {
                let s = Mat::from_fn(d, members.len(), |i, j| x[(i, members[j])]);
                kept.begin(&Arc::new(s.clone()));
                for part in window.clone().collect::<Vec<usize>>().chunks(7) {
                    let numbers: Vec<u64> = part.iter().map(|&t| t as u64).collect();
                    let columns = |places: &[usize]| Mat::from_fn(d, places.len(), |i, j| x[(i, part[places[j]])]);
                    let (products, norms) = kept.of(&numbers, columns, Par::Seq).unwrap();
                    let of_members = squared_norms(s.as_ref());
                    let found = kernel.matrix_of_products(products.as_ref(), &of_members, &norms, Par::Seq).unwrap();
                    let all = columns(&(0..part.len()).collect::<Vec<usize>>());
                    let right = kernel.matrix(s.as_ref(), &of_members, all.as_ref(), &norms, Par::Seq).unwrap();
                    assert_eq!(found, right);
                }
                let held: usize = kept.kept.values().map(|kept| kept.products.capacity()).sum();
                assert!(held == kept.taken && held <= room, "{held} of {room}");
                assert!(window.end != 60 || room == 1000 || held + members.len() > room, "{held} of {room}");
            }
        }
    }

    #[test]
    fn what_was_not_asked_for_is_gone_and_nothing_else_is_computed_again() {
        let (d, mut kept) = (300, KeptProducts::new(1000));
        let x = Mat::<f32>::from_fn(d, 60, pixels);
        let again = Arc::new(Mat::from_fn(d, 2, |i, j| x[(i, [8, 9][j])]));
        kept.begin(&again);
        let columns = |places: &[usize]| Mat::from_fn(d, places.len(), |i, _| x[(i, 1)]);
        assert!(kept.of(&[1], columns, Par::Seq).is_some());
        let known = |_: &[usize]| -> Mat<f32> { panic!("these are kept") };
        for _ in 0..2 {
            kept.begin(&again);
            assert!(kept.of(&[1, 1], known, Par::Seq).is_some());
        }
        let columns = |places: &[usize]| Mat::from_fn(d, places.len(), |i, _| x[(i, 2)]);
        let (products, _) = kept.of(&[2, 2, 1], columns, Par::Seq).unwrap();
        assert_eq!((products.col(0), kept.kept[&2].products.len()), (products.col(1), 2));
        kept.begin(&again);
        assert!(kept.of(&[2], known, Par::Seq).is_some());
        kept.begin(&again);
        assert_eq!(kept.kept.keys().collect::<Vec<_>>(), [&2]);
    }

    #[test]
    fn what_is_not_exact_or_does_not_fit_is_refused_and_not_kept() {
        let bright = |value: f32| Mat::<f32>::from_fn(1024, 1, |_, _| value);
        let mut kept = KeptProducts::new(1000);
        kept.begin(&Arc::new(bright(127.0)));
        assert!(kept.of(&[0], |_| bright(128.0), Par::Seq).is_none());
        assert!(kept.of(&[0], |_| Mat::zeros(3, 1), Par::Seq).is_none());
        assert!(kept.of(&[0], |_| bright(127.0), Par::Seq).is_some());
        kept.begin(&Arc::new(bright(128.0)));
        assert!(kept.of(&[0], |_| bright(127.0), Par::Seq).is_none());
    }
}
