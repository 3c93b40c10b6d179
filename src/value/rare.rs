//! States that were rarely visited, for exploration to go to.

use faer::linalg::matmul::matmul;
use faer::{Accum, Mat, MatRef, Par};
use rand::{Rng, RngExt};

use super::ValueError;
use super::local::finite_points;
use crate::kernel::products::map_all;
use crate::kernel::{Kernel, squared_norms};

/// States, evenly spaced, that tell how often others like them were met, and of those how many tell the width.
const ASKED: usize = 2048;
const TELL: usize = 256;
/// The width is as far as the so many nearest of these mostly are.
const NEAR: usize = 4;
/// A place is a state and so many that are nearest to it.
const AROUND: usize = 16;
/// States whose distances are found in one product.
const AT_ONCE: usize = 128;

/// `count` places in which few states lie, each as the numbers of some states next to each other. A state is the middle of one the more
/// probably the fewer others are near: by (1 + how many)^−`power`. None where no two states differ, or distances are beyond what `f32` holds.
/// Coordinates should have their mean near 0: distances are found from products, in single precision.
///
/// # Shapes
/// `points: p × n`: the nearer the more alike.
///
/// # Errors
/// Values that are not finite.
///
/// # Reference
/// Rarity by the number of states that are alike: Tang et al. 2017. Powers of it are of our own.
pub fn rare_places(
    points: MatRef<'_, f32>,
    power: i32,
    count: usize,
    rng: &mut impl Rng,
) -> Result<Vec<Vec<usize>>, ValueError> {
    finite_points("points", points)?;
    let n = points.ncols();
    let asked: Vec<usize> = (0..ASKED.min(n)).map(|k| k * n / ASKED.min(n)).collect();
    let of_asked = Mat::from_fn(points.nrows(), asked.len(), |i, j| points[(i, asked[j])]);
    let tell: Vec<usize> = (0..TELL.min(asked.len())).map(|k| k * asked.len() / TELL.min(asked.len())).collect();
    let nearest = |k: &usize| {
        let mut squared = squared_distances(of_asked.as_ref(), of_asked.as_ref().subcols(*k, 1)).remove(0);
        let near = NEAR.min(squared.len() - 1);
        *squared.select_nth_unstable_by(near, f32::total_cmp).1
    };
    let mut squares: Vec<f32> = tell.iter().map(nearest).filter(|squared| *squared > 0.0).collect();
    if squares.is_empty() || count == 0 {
        return Ok(Vec::new());
    }
    let middle = squares.len() / 2;
    let width = f64::from(*squares.select_nth_unstable_by(middle, f32::total_cmp).1);
    // Squares of distances that `f32` cannot hold tell nothing.
    let Ok(kernel) = Kernel::gaussian(width.sqrt()) else { return Ok(Vec::new()) };
    let norms = [of_asked.as_ref(), points].map(squared_norms);
    let of_block = |block: usize| {
        let (start, count) = (block * AT_ONCE, AT_ONCE.min(n - block * AT_ONCE));
        let (block, of_block) = (points.subcols(start, count), &norms[1][start..start + count]);
        let alike = kernel.matrix(of_asked.as_ref(), &norms[0], block, of_block, Par::Seq);
        let sums = |alike: Mat<f64>| alike.col_iter().map(|alike| alike.iter().sum()).collect::<Vec<f64>>();
        // Shapes fit each other: there is no error.
        alike.map_or_else(|_| vec![f64::NAN; count], sums)
    };
    let density = map_all(n.div_ceil(AT_ONCE), of_block).into_iter().flatten();
    let weights: Vec<f64> = density.map(|density| (1.0 + density).powi(-power)).collect();
    let sum = weights.iter().sum::<f64>();
    if sum.is_nan() || sum <= 0.0 {
        return Ok(Vec::new());
    }
    let place = |_| {
        let mut left = rng.random_range(0.0..sum);
        let chosen = weights.iter().position(|weight| {
            left -= weight;
            left < 0.0
        });
        let middle = points.subcols(chosen.unwrap_or(n - 1), 1);
        let squared = squared_distances(points, middle).remove(0);
        let mut states: Vec<usize> = (0..n).collect();
        states.select_nth_unstable_by(AROUND.min(n) - 1, |&a, &b| squared[a].total_cmp(&squared[b]));
        states.truncate(AROUND);
        states.sort_unstable();
        states
    };
    Ok((0..count).map(place).collect())
}

/// Of each of some points, squared distances to others.
fn squared_distances(others: MatRef<'_, f32>, of: MatRef<'_, f32>) -> Vec<Vec<f32>> {
    let mut products = Mat::zeros(others.ncols(), of.ncols());
    matmul(&mut products, Accum::Replace, others.transpose(), of, 1.0, Par::Seq);
    let norms = |points: MatRef<'_, f32>| points.col_iter().map(|point| point.squared_norm_l2()).collect::<Vec<f32>>();
    let (of_others, norms) = (norms(others), norms(of));
    let squared =
        |j: usize| (0..others.ncols()).map(|i| (of_others[i] + norms[j] - 2.0 * products[(i, j)]).max(0.0)).collect();
    (0..of.ncols()).map(squared).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::stream;

    #[test]
    fn places_where_few_states_lie_are_found() {
        let mut rng = stream(1, "states");
        // One in a hundred lies in a corner of its own.
        let point = |j: usize, rng: &mut rand_chacha::ChaCha8Rng| {
            let far = if j.is_multiple_of(100) { 3.0 } else { 0.0 };
            [0, 1].map(|_| far + rng.random_range(0.0f32..1.0))
        };
        let of: Vec<[f32; 2]> = (0..5000).map(|j| point(j, &mut rng)).collect();
        let points = Mat::from_fn(2, of.len(), |i, j| of[j][i]);
        let corners = [2, 4].map(|power| {
            let places = rare_places(points.as_ref(), power, 400, &mut rng).unwrap();
            assert_eq!(places.len(), 400);
            for place in &places {
                assert_eq!(place.len(), AROUND);
                let apart = |a: usize, b: usize| (0..2).map(|i| (of[a][i] - of[b][i]).powi(2)).sum::<f32>();
                // Any two of a place are near each other.
                assert!(place.iter().all(|&a| place.iter().all(|&b| apart(a, b) < 1.0)), "{place:?}");
            }
            places.iter().filter(|place| place.iter().all(|state| state % 100 == 0)).count()
        });
        // A state there is chosen many times as often as another: without regard to how rare it is, 4 of 400 would be.
        assert!(60 < corners[0] && 2 * corners[0] < corners[1], "{corners:?}");
    }

    #[test]
    fn where_nothing_differs_there_is_no_place() {
        let rng = || stream(1, "none");
        for n in [0, 1, 5] {
            assert_eq!(rare_places(Mat::full(3, n, 1.0).as_ref(), 2, 2, &mut rng()), Ok(Vec::new()));
        }
        let two = Mat::from_fn(1, 2, |_, j| j as f32);
        assert_eq!(rare_places(two.as_ref(), 2, 2, &mut rng()), Ok(vec![vec![0, 1]; 2]));
        for far in [1e20, f32::MAX] {
            assert_eq!(
                rare_places(Mat::from_fn(1, 2, |_, j| far * j as f32).as_ref(), 2, 2, &mut rng()),
                Ok(Vec::new())
            );
        }
        assert!(rare_places(Mat::full(1, 2, f32::NAN).as_ref(), 2, 1, &mut rng()).is_err());
    }
}
