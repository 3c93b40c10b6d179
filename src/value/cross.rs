//! The part of the system that depends on the policy: `M_ab = Σ_{i: a_i = a} ω_i π(b | x′_i) φ_i φ′_iᵀ`.

use faer::{Mat, MatMut, MatRef};

use super::blocks::Blocks;
use crate::kernel::products::add_product;

/// Samples whose features are gathered side by side for one product. Two buffers of this many columns stay in a core's
/// cache for hundreds of features, so that each feature vector is read from memory once.
const GATHER: usize = 512;

/// A sample: its column in `ω_i φ_i` of its action, and its column in `Φ′`.
type Place = (usize, usize);

/// `M` of a policy, `π(b | x′_i)` at `(b, i)`: the blocks `M_ab` as one `fA × fA` matrix.
///
/// Samples of an action that go on alike share one product for all that may follow: a policy that knows only what is
/// allowed costs one product per sample, like a greedy one. Policies that differ from sample to sample cost `A`.
pub(super) fn of_policy(blocks: &Blocks, next: MatRef<'_, f64>, policy: MatRef<'_, f64>) -> Mat<f64> {
    let (f, actions) = (blocks.features(), blocks.actions());
    let mut cross = Mat::zeros(f * actions, f * actions);
    let mut products = Products::new(blocks, next);
    for a in 0..actions {
        if let Some(classes) = alike(blocks.members(a), policy) {
            for (sample, places) in classes {
                let sum = products.sum(a, &places, None);
                for b in (0..actions).filter(|&b| policy[(b, sample)] != 0.0) {
                    add(cross.as_mut().submatrix_mut(a * f, b * f, f, f), policy[(b, sample)], sum);
                }
            }
        } else {
            let places: Vec<Place> = blocks.members(a).iter().copied().enumerate().collect();
            for b in 0..actions {
                let shares: Vec<f64> = places.iter().map(|&(_, sample)| policy[(b, sample)]).collect();
                let sum = products.sum(a, &places, Some(&shares));
                add(cross.as_mut().submatrix_mut(a * f, b * f, f, f), 1.0, sum);
            }
        }
    }
    cross
}

/// Samples by what follows them: one of each class, and the places of all; `None` if there are more classes than actions.
fn alike(members: &[usize], policy: MatRef<'_, f64>) -> Option<Vec<(usize, Vec<Place>)>> {
    let mut classes: Vec<(usize, Vec<Place>)> = Vec::new();
    for (place, &sample) in members.iter().enumerate() {
        match classes.iter().position(|(first, _)| policy.col(*first) == policy.col(sample)) {
            Some(class) => classes[class].1.push((place, sample)),
            None if classes.len() < policy.nrows() => classes.push((sample, vec![(place, sample)])),
            None => return None,
        }
    }
    Some(classes)
}

/// `M` of the newest greedy policy.
///
/// From one policy to the next few greedy actions change: what such a sample gave to the block of its old action moves to
/// that of its new one. Once as many samples have moved as there are, the sum is made from nothing, so that its rounding
/// stays that of two or three sums.
#[derive(Debug)]
pub(super) struct GreedyCross {
    cross: Mat<f64>,
    /// The greedy action at each `x′_i`.
    chosen: Vec<usize>,
    /// Samples that have moved since `cross` was made from nothing.
    moved: usize,
}

impl GreedyCross {
    /// `M` of the policy that goes on with action `chosen[i]` after sample `i`.
    pub fn new(blocks: &Blocks, next: MatRef<'_, f64>, chosen: &[usize]) -> Self {
        let (f, actions) = (blocks.features(), blocks.actions());
        let mut cross = Mat::zeros(f * actions, f * actions);
        let mut products = Products::new(blocks, next);
        for a in 0..actions {
            let mut places = vec![Vec::new(); actions];
            for (place, &sample) in blocks.members(a).iter().enumerate() {
                places[chosen[sample]].push((place, sample));
            }
            for (b, places) in places.iter().enumerate() {
                add(cross.as_mut().submatrix_mut(a * f, b * f, f, f), 1.0, products.sum(a, places, None));
            }
        }
        GreedyCross { cross, chosen: chosen.to_vec(), moved: 0 }
    }

    /// `M` of the policy that goes on with action `chosen[i]` after sample `i` from now on.
    pub fn update(&mut self, blocks: &Blocks, next: MatRef<'_, f64>, chosen: &[usize]) {
        let (f, actions) = (blocks.features(), blocks.actions());
        let moved = self.chosen.iter().zip(chosen).filter(|(old, new)| old != new).count();
        if self.moved + moved > chosen.len() {
            *self = GreedyCross::new(blocks, next, chosen);
            return;
        }
        let mut products = Products::new(blocks, next);
        for a in 0..actions {
            let mut places = vec![Vec::new(); actions * actions];
            for (place, &sample) in blocks.members(a).iter().enumerate() {
                let (old, new) = (self.chosen[sample], chosen[sample]);
                if old != new {
                    places[old * actions + new].push((place, sample));
                }
            }
            for (pair, places) in places.iter().enumerate().filter(|(_, places)| !places.is_empty()) {
                let (old, new) = (pair / actions, pair % actions);
                let sum = products.sum(a, places, None);
                add(self.cross.as_mut().submatrix_mut(a * f, old * f, f, f), -1.0, sum);
                add(self.cross.as_mut().submatrix_mut(a * f, new * f, f, f), 1.0, sum);
            }
        }
        self.chosen.copy_from_slice(chosen);
        self.moved += moved;
    }

    /// `M`, `fA × fA`.
    pub fn matrix(&self) -> &Mat<f64> {
        &self.cross
    }
}

/// Sums of `ω_i φ_i φ′_iᵀ` over some samples of one action.
struct Products<'b> {
    blocks: &'b Blocks,
    next: MatRef<'b, f64>,
    before: Mat<f64>,
    after: Mat<f64>,
    sum: Mat<f64>,
}

impl<'b> Products<'b> {
    fn new(blocks: &'b Blocks, next: MatRef<'b, f64>) -> Self {
        Products { blocks, next, before: Mat::new(), after: Mat::new(), sum: Mat::new() }
    }

    /// The sum over `places` of action `a`, `f × f`; with `shares`, each sample times its own.
    fn sum(&mut self, a: usize, places: &[Place], shares: Option<&[f64]>) -> MatRef<'_, f64> {
        let f = self.blocks.features();
        let widest = GATHER.min(places.len());
        if self.before.ncols() < widest || self.sum.nrows() < f {
            (self.before, self.after, self.sum) = (Mat::zeros(f, widest), Mat::zeros(f, widest), Mat::zeros(f, f));
        }
        self.sum.fill(0.0);
        for (number, part) in places.chunks(GATHER).enumerate() {
            for (column, &(place, sample)) in part.iter().enumerate() {
                self.before.col_mut(column).copy_from(self.blocks.weighted(a).col(place));
                self.after.col_mut(column).copy_from(self.next.col(sample));
                if let Some(shares) = shares {
                    self.after.col_mut(column).iter_mut().for_each(|x| *x *= shares[number * GATHER + column]);
                }
            }
            let (before, after) = (self.before.subcols(0, part.len()), self.after.subcols(0, part.len()));
            add_product(self.sum.as_mut(), before, after, 1.0, self.blocks.par());
        }
        self.sum.as_ref()
    }
}

/// `target ← target + factor · sum`.
fn add(target: MatMut<'_, f64>, factor: f64, sum: MatRef<'_, f64>) {
    faer::zip!(target, sum).for_each(|faer::unzip!(target, sum)| *target += factor * sum);
}

#[cfg(test)]
mod tests {
    use faer::Par;
    use rand::RngExt;

    use super::*;
    use crate::random::stream;
    use crate::value::Samples;

    /// Hundreds of policies, each with a few other actions than the one before: rounding does not add up.
    #[test]
    fn samples_that_move_leave_no_rounding_behind() {
        let (f, n, actions, steps) = (7, 400, 3, 1000);
        let mut rng = stream(1, "cross");
        let phi = Mat::from_fn(f, n, |_, _| rng.random_range(-1.0..1.0));
        let next = Mat::from_fn(f, n, |_, _| rng.random_range(-1.0..1.0));
        let taken: Vec<usize> = (0..n).map(|_| rng.random_range(0..actions)).collect();
        let data = Samples { phi: phi.as_ref(), actions: &taken, weights: &vec![1.0; n] };
        let blocks = Blocks::new(data, actions, Par::Seq).unwrap();
        let mut chosen: Vec<usize> = (0..n).map(|_| rng.random_range(0..actions)).collect();
        let mut kept = GreedyCross::new(&blocks, next.as_ref(), &chosen);
        let (mut worst, mut anew) = (0.0f64, 0);
        for _ in 0..steps {
            for _ in 0..10 {
                chosen[rng.random_range(0..n)] = rng.random_range(0..actions);
            }
            kept.update(&blocks, next.as_ref(), &chosen);
            anew += usize::from(kept.moved == 0);
            let exact = GreedyCross::new(&blocks, next.as_ref(), &chosen);
            worst = worst.max((kept.matrix() - exact.matrix()).norm_max() / exact.matrix().norm_max());
        }
        println!("largest difference {worst:.1e} in {steps} steps, {anew} of them anew");
        assert!(worst < 1e-14 && anew < steps / 40, "{worst:.1e}, {anew}");
    }
}
