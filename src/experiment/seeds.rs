//! The seeds of an experiment.

use std::fmt;
use std::ops::Deref;
use std::str::FromStr;

use serde::Serialize;

use super::ExperimentError;

/// Seeds: one at least, each once, ascending.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Seeds(Vec<u64>);

impl Seeds {
    /// More seeds than this are a slip of the keyboard.
    pub const MOST: usize = 1000;

    /// Seeds in any order; one that is there twice counts once.
    ///
    /// # Errors
    /// There are none, or more than [`Seeds::MOST`].
    pub fn new(seeds: impl IntoIterator<Item = u64>) -> Result<Self, ExperimentError> {
        let mut seeds: Vec<u64> = seeds.into_iter().collect();
        seeds.sort_unstable();
        seeds.dedup();
        match seeds.len() {
            0 => Err(ExperimentError::Seeds("there is no seed: an experiment needs one at least".into())),
            1..=Self::MOST => Ok(Seeds(seeds)),
            number => Err(ExperimentError::Seeds(format!("{number} seeds are more than {}", Self::MOST))),
        }
    }

    /// First and last of each span without a gap.
    fn spans(&self) -> impl Iterator<Item = (u64, u64)> {
        self.0.chunk_by(|a, b| a + 1 == *b).map(|span| (span[0], span[span.len() - 1]))
    }
}

/// There is a first one.
impl Deref for Seeds {
    type Target = [u64];

    fn deref(&self) -> &[u64] {
        &self.0
    }
}

/// `11 to 13, 20`.
impl fmt::Display for Seeds {
    fn fmt(&self, to: &mut fmt::Formatter<'_>) -> fmt::Result {
        let span =
            |(first, last): (u64, u64)| if first < last { format!("{first} to {last}") } else { first.to_string() };
        to.write_str(&self.spans().map(span).collect::<Vec<_>>().join(", "))
    }
}

/// From `11..13,20`: spans with both ends, and single seeds.
impl FromStr for Seeds {
    type Err = ExperimentError;

    fn from_str(text: &str) -> Result<Self, ExperimentError> {
        let number = |text: &str| {
            let wrong = |error| ExperimentError::Seeds(format!("{text:?} is no seed: {error}"));
            text.trim().parse::<u64>().map_err(wrong)
        };
        let mut seeds = Vec::new();
        for span in text.split(',') {
            let (first, last) = match span.split_once("..") {
                Some((first, last)) => (number(first)?, number(last.strip_prefix('=').unwrap_or(last))?),
                None => (number(span)?, number(span)?),
            };
            if first > last {
                let wrong = format!("{first} to {last} are no seeds: the first must not be above the last");
                return Err(ExperimentError::Seeds(wrong));
            }
            if last - first >= Self::MOST as u64 {
                return Err(ExperimentError::Seeds(format!("{first} to {last} are more than {} seeds", Self::MOST)));
            }
            seeds.extend(first..=last);
        }
        Seeds::new(seeds)
    }
}

#[cfg(test)]
mod tests {
    use super::Seeds;

    #[test]
    fn seeds_are_spans_with_both_ends_and_single_ones() {
        let of = |text: &str| text.parse::<Seeds>().unwrap().to_vec();
        assert_eq!(of("11..13"), [11, 12, 13]);
        assert_eq!(of("11..=13"), [11, 12, 13]);
        assert_eq!(of("7"), [7]);
        assert_eq!(of("20, 11..13,12"), [11, 12, 13, 20]);
        for wrong in ["", "a", "3..1", "1..5000", "1..", "-1..2", "1,,2", "1..600,1001..1600"] {
            assert!(wrong.parse::<Seeds>().is_err(), "{wrong}");
        }
        assert!(Seeds::new([]).is_err());
    }

    #[test]
    fn they_are_told_as_spans() {
        assert_eq!(Seeds::new([20, 13, 12, 11, u64::MAX]).unwrap().to_string(), format!("11 to 13, 20, {}", u64::MAX));
    }
}
