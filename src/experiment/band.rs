//! Means over seeds, with the range in which most of them are.

use std::borrow::Borrow;

use serde::{Deserialize, Serialize};

/// What bands are, in words for tables and plots.
pub const BAND: &str = "10th to 90th percentile";

/// Mean and spread of a number over seeds or trials.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Band {
    /// Mean.
    pub mean: f64,
    /// Standard deviation (divided by n − 1); 0 of one number.
    pub deviation: f64,
    /// 10th percentile, linear between the numbers.
    pub low: f64,
    /// 90th percentile.
    pub high: f64,
    /// How many numbers.
    pub count: usize,
}

impl Band {
    /// Of some numbers; `None` if there are none.
    pub fn of<V: Borrow<f64>>(values: impl IntoIterator<Item = V>) -> Option<Self> {
        let values: Vec<f64> = values.into_iter().map(|value| *value.borrow()).collect();
        let count = values.len();
        if count == 0 {
            return None;
        }
        let mean = values.iter().sum::<f64>() / count as f64;
        let squares: f64 = values.iter().map(|value| (value - mean).powi(2)).sum();
        let deviation = if count > 1 { (squares / (count - 1) as f64).sqrt() } else { 0.0 };
        let mut sorted = values;
        sorted.sort_by(f64::total_cmp);
        let at = |share: f64| {
            let place = share * (count - 1) as f64;
            let below = place.floor() as usize;
            let above = (below + 1).min(count - 1);
            sorted[below] + (place - below as f64) * (sorted[above] - sorted[below])
        };
        Some(Band { mean, deviation, low: at(0.1), high: at(0.9), count })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn percentiles_are_linear_between_the_numbers() {
        let band = Band::of([4.0, 0.0, 2.0, 1.0, 3.0]).unwrap();
        assert_eq!((band.mean, band.count), (2.0, 5));
        assert!((band.low - 0.4).abs() < 1e-12 && (band.high - 3.6).abs() < 1e-12);
        assert!((band.deviation - 2.5f64.sqrt()).abs() < 1e-12);
        assert_eq!(Band::of([7.0]).unwrap(), Band { mean: 7.0, deviation: 0.0, low: 7.0, high: 7.0, count: 1 });
        assert_eq!(Band::of([0.0; 0]), None);
    }
}
