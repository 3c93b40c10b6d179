//! The dictionary against known answers: ALD on the Lorenz series, blocks against frame by frame, Newton coordinates.

use crate::common::{ald, condition, generator, parameters, random_path, relative_difference};
use adagio::dictionary::{Ald, Dictionary, DictionaryError, Selection};
use adagio::kernel::Kernel;
use faer::{Mat, Par, Side};
use proptest::prelude::*;
use rand::RngExt;

/// The dictionary of kafbox's Lorenz series at ν = 1e-4, σ = 32, embedding 6, computed with an exact Cholesky residual.
const LORENZ: [usize; 32] = [
    0, 1, 2, 3, 4, 5, 6, 9, 12, 17, 23, 31, 41, 47, 52, 57, 61, 66, 70, 135, 141, 146, 149, 152, 333, 626, 648, 660,
    663, 665, 667, 4262,
];

fn lorenz() -> Mat<f64> {
    let text = include_str!("../data/lorenz.dat");
    let series: Vec<f64> = text.split_whitespace().map(|value| value.parse().unwrap()).collect();
    // One step ahead: the last value is only ever a target.
    Mat::from_fn(6, series.len() - 1, |lag, t| if t >= lag { series[t - lag] } else { 0.0 })
}

/// The observations that were accepted, and the coordinates of all.
fn taken_in_blocks(x: &Mat<f64>, sigma: f64, nu: f64, budget: usize, blocks: &[usize]) -> (Vec<usize>, Mat<f64>) {
    let mut selection = ald(sigma, nu, budget);
    let mut accepted = Vec::new();
    let (mut start, mut turn) = (0, 0);
    while start < x.ncols() {
        let size = blocks[turn % blocks.len()].min(x.ncols() - start);
        let block = selection.observe(x.as_ref().subcols(start, size)).unwrap();
        accepted.extend(block.accepted.iter().map(|index| start + index));
        start += size;
        turn += 1;
    }
    (accepted, selection.dictionary().coordinates(x.as_ref()).unwrap())
}

fn accepted_in_blocks(x: &Mat<f64>, sigma: f64, nu: f64, budget: usize, blocks: &[usize]) -> Vec<usize> {
    taken_in_blocks(x, sigma, nu, budget, blocks).0
}

#[test]
fn lorenz_series_gives_the_known_dictionary() {
    assert_eq!(accepted_in_blocks(&lorenz(), 32.0, 1e-4, 1000, &[256]), LORENZ);
    assert_eq!(accepted_in_blocks(&lorenz(), 32.0, 1e-4, 1000, &[1]), LORENZ);
}

/// Why the factor is kept and not the inverse: carried by the Woodbury identity, as the thesis prints it (§2.2.6, algorithm
/// 2), K⁻¹ drifts, and other observations are accepted.
#[test]
fn the_inverse_of_the_thesis_drifts_on_the_lorenz_series() {
    let x = lorenz();
    let kernel = |a: usize, b: usize| {
        let squares: f64 = (0..6).map(|i| (x[(i, a)] - x[(i, b)]).powi(2)).sum();
        (-squares / (2.0 * 32.0 * 32.0)).exp()
    };
    let mut members = vec![0];
    let mut inverse = vec![vec![1.0]];
    for t in 1..x.ncols() {
        let row: Vec<f64> = members.iter().map(|&member| kernel(member, t)).collect();
        let solved: Vec<f64> = inverse.iter().map(|line| line.iter().zip(&row).map(|(a, b)| a * b).sum()).collect();
        let residual = 1.0 - row.iter().zip(&solved).map(|(a, b)| a * b).sum::<f64>();
        if residual > 1e-4 {
            for (line, &a) in inverse.iter_mut().zip(&solved) {
                line.iter_mut().zip(&solved).for_each(|(entry, &b)| *entry += a * b / residual);
                line.push(-a / residual);
            }
            let mut last: Vec<f64> = solved.iter().map(|&b| -b / residual).collect();
            last.push(1.0 / residual);
            inverse.push(last);
            members.push(t);
        }
    }
    // Which ones, and whether 31 or 32, depends on the order in which numbers are added up.
    println!("with the inverse: {members:?}");
    assert_eq!(members[..25], LORENZ[..25]);
    assert_ne!(members[25..], LORENZ[25..]);
}

#[test]
fn the_factor_is_the_cholesky_factor_of_the_kernel_matrix() {
    let x = random_path(5, 400, 3);
    let mut selection = ald(0.4, 1e-3, 1000);
    for start in (0..400).step_by(50) {
        selection.observe(x.as_ref().subcols(start, 50)).unwrap();
    }
    let kernel_matrix = selection.dictionary().kernel_rows(selection.dictionary().members()).unwrap();
    let exact = kernel_matrix.llt(Side::Lower).unwrap();
    assert!(selection.dictionary().len() > 20);
    assert!(relative_difference(selection.dictionary().factor(), exact.L()) < 1e-9);
}

#[test]
fn every_observation_is_within_nu_and_nothing_is_accepted_beyond_the_budget() {
    let x = random_path(4, 600, 9);
    let mut selection = ald(0.3, 0.01, 10_000);
    selection.observe(x.as_ref()).unwrap();
    let v = selection.dictionary().coordinates(x.as_ref()).unwrap();
    for j in 0..600 {
        let residual = 1.0 - (0..v.nrows()).map(|i| v[(i, j)] * v[(i, j)]).sum::<f64>();
        assert!(residual <= 0.01 + 1e-9, "frame {j}: residual {residual}");
    }
    let free = selection.dictionary().len();
    assert!(free > 20);
    let short = accepted_in_blocks(&x, 0.3, 0.01, 20, &[7]);
    assert_eq!(short.len(), 20);
    assert_eq!(short, accepted_in_blocks(&x, 0.3, 0.01, 10_000, &[7])[..20]);
}

#[test]
fn the_nearest_support_vector_is_the_one_with_the_largest_kernel_value() {
    let x = random_path(3, 200, 21);
    let mut selection = ald(0.3, 0.05, 1000);
    for start in (0..200).step_by(25) {
        let part = x.as_ref().subcols(start, 25);
        let block = selection.observe(part).unwrap();
        let rows = selection.dictionary().kernel_rows(part).unwrap();
        let before = selection.dictionary().len() - block.accepted.len();
        for j in 0..25 {
            let known = before + block.accepted.iter().filter(|&&index| index <= j).count();
            let best = (0..known).map(|i| rows[(i, j)]).fold(f64::NEG_INFINITY, f64::max);
            assert!((rows[(block.nearest[j], j)] - best).abs() < 1e-12);
            assert!(block.nearest[j] < known);
        }
    }
}

#[test]
fn bad_observations_are_refused_and_change_nothing() {
    let mut selection = ald(0.3, 0.01, 100);
    selection.observe(random_path(3, 10, 1).as_ref()).unwrap();
    let before = selection.dictionary().len();
    let wrong = Mat::<f64>::zeros(4, 2);
    assert_eq!(selection.observe(wrong.as_ref()).unwrap_err(), DictionaryError::Dimension { expected: 3, found: 4 });
    let mut holes = random_path(3, 5, 2);
    holes[(1, 3)] = f64::NAN;
    assert_eq!(selection.observe(holes.as_ref()).unwrap_err(), DictionaryError::NotFinite(3));
    assert_eq!(selection.dictionary().len(), before);
    assert_eq!(Ald::<f64>::new(parameters(0.3, 0.0, 9)).unwrap_err(), DictionaryError::Nu(0.0));
    assert_eq!(Ald::<f64>::new(parameters(0.3, 0.1, 0)).unwrap_err(), DictionaryError::Budget);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(48))]

    /// Whatever the block sizes, the same observations are accepted as one by one, with the same coordinates up to rounding.
    #[test]
    fn blocks_accept_what_frame_by_frame_accepts(
        seed in any::<u64>(),
        d in 1usize..6,
        nu in prop::sample::select(vec![0.1, 0.01, 1e-3]),
        sizes in prop::collection::vec(1usize..60, 1..5),
        budget in prop::sample::select(vec![12, 10_000]),
    ) {
        let x = random_path(d, 250, seed);
        let single = taken_in_blocks(&x, 0.25, nu, budget, &[1]);
        let blocks = taken_in_blocks(&x, 0.25, nu, budget, &sizes);
        prop_assert_eq!(&blocks.0, &single.0);
        // Rounding differs, and a Cholesky factor passes it on by up to the condition of K, the square of that of L.
        let members = Mat::from_fn(d, single.0.len(), |i, j| x[(i, single.0[j])]);
        let mut dictionary = Dictionary::new(Kernel::gaussian(0.25).unwrap(), budget, Par::Seq);
        dictionary.grow(members.as_ref(), |_, _| true).unwrap();
        let tolerance = 1e-9f64.max(f64::EPSILON * condition(&dictionary));
        let difference = relative_difference(blocks.1.as_ref(), single.1.as_ref());
        prop_assert!(difference < tolerance, "{difference} beyond {tolerance}");
    }
}

/// Values far from zero, where kernel values depend on the order of summation: an observation that is there already stands
/// in a part of its own, behind 32 others of its block or 512 support vectors.
#[test]
fn an_observation_that_is_known_is_never_taken_again() {
    let mut generator = generator(5);
    let values = Mat::from_fn(8, 600, |_, _| 1000.0 + generator.random_range(-2.0..2.0));
    let x = |n: usize, again: usize| Mat::from_fn(8, n + 1, |i, t| values[(i, if t < n { t } else { again })]);
    for n in [32, 64, 512, 513] {
        let (mut in_one, mut later) = (ald(1.0, 1e-12, 2000), ald(1.0, 1e-12, 2000));
        let block = in_one.observe(x(n, 3).as_ref()).unwrap();
        assert_eq!(block.accepted.last(), Some(&(n - 1)), "{n}");
        later.observe(x(n, 3).as_ref().subcols(0, n)).unwrap();
        let again = Mat::from_fn(8, 5, |i, t| values[(i, [n - 1, 0, 3, 31, n - 1][t])]);
        assert!(later.observe(again.as_ref()).unwrap().accepted.is_empty(), "{n}");
    }
}
