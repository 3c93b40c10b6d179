//! How functions on test maps are compared: means and variances, correlations and mixtures of two.

use faer::{Mat, MatRef};

use super::maps::HEADINGS;

/// Mean of some values.
pub fn mean(values: impl ExactSizeIterator<Item = f64>) -> f64 {
    let n = values.len() as f64;
    values.sum::<f64>() / n
}

/// Mean square of their distances from their mean.
pub fn variance(values: &[f64]) -> f64 {
    let centre = mean(values.iter().copied());
    mean(values.iter().map(|value| (value - centre).powi(2)))
}

/// Rows with mean 0 and length 1.
pub fn standardised(rows: MatRef<'_, f64>) -> Mat<f64> {
    let n = rows.ncols();
    let mut out = rows.to_owned();
    for i in 0..rows.nrows() {
        let mean = rows.row(i).iter().sum::<f64>() / n as f64;
        let length = rows.row(i).iter().map(|value| (value - mean).powi(2)).sum::<f64>().sqrt().max(f64::MIN_POSITIVE);
        (0..n).for_each(|j| out[(i, j)] = (rows[(i, j)] - mean) / length);
    }
    out
}

/// The two responses whose combination explains most of a feature, from correlations: which, their weights, and the share.
pub fn best_pair(correlations: &[f64], among: &Mat<f64>) -> ([usize; 2], [f64; 2], f64) {
    let mut best = ([0, 0], [correlations[0], 0.0], correlations[0].powi(2));
    for a in 0..correlations.len() {
        for b in 0..a {
            let (x, y, c) = (correlations[a], correlations[b], among[(a, b)]);
            let rest = 1.0 - c * c;
            if rest > 1e-9 {
                let weights = [(x - c * y) / rest, (y - c * x) / rest];
                let share = weights[0] * x + weights[1] * y;
                if share > best.2 {
                    best = ([a, b], weights, share);
                }
            }
        }
    }
    best
}

/// Share of the variance of a map's values that the means over all headings have.
pub fn by_place(values: impl Iterator<Item = f64>, places: usize) -> f64 {
    let values: Vec<f64> = values.collect();
    let of_headings = |place: usize| mean((0..HEADINGS).map(|h| values[h * places + place]));
    let means: Vec<f64> = (0..places).map(of_headings).collect();
    variance(&means) / variance(&values)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_best_pair_is_found_with_its_weights() {
        // A feature that is 0.6 of the first response and 0.8 of the third, which share nothing.
        let among = Mat::<f64>::identity(3, 3);
        let (pair, weights, share) = best_pair(&[0.6, 0.05, 0.8], &among);
        assert_eq!((pair, weights), ([2, 0], [0.8, 0.6]));
        assert!((share - 1.0).abs() < 1e-12);
    }

    #[test]
    fn variance_by_place_is_that_of_the_means_over_headings() {
        let places = 3;
        let value = |heading: usize, place: usize| place as f64 + if heading.is_multiple_of(2) { 1.0 } else { -1.0 };
        let map = (0..HEADINGS).flat_map(|h| (0..places).map(move |p| value(h, p)));
        let expected = (2.0 / 3.0) / (2.0 / 3.0 + 1.0);
        assert!((by_place(map, places) - expected).abs() < 1e-12);
    }
}
