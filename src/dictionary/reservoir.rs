//! Random selection: a uniform sample of everything seen so far, kept by a reservoir.

use faer::{MatRef, Par};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use super::error::check_budget;
use super::{Block, Dictionary, DictionaryError, Selection, Thinning};
use crate::kernel::{Kernel, Scalar};
use crate::random::stream;
#[cfg(feature = "snapshot")]
use crate::snapshot::{Snapshot, SnapshotError};

/// A uniformly random sample of all observations so far: the support vectors of the Nyström method, as a stream.
///
/// Observation number `t` is taken with probability `budget/t`, in exchange for a random member. An observation that is an
/// exact combination of the support vectors, such as a frame seen twice, is not taken: it would add nothing and leave
/// the factor singular.
///
/// # Reference
/// Vitter 1985, algorithm R; Williams & Seeger 2001; thesis §2.2.5.
#[derive(Debug, Clone)]
pub struct Reservoir<T: Scalar> {
    dictionary: Dictionary<T>,
    budget: usize,
    random: ChaCha8Rng,
    seen: u64,
    /// Serial number of the member at each of the places of the reservoir.
    places: Vec<usize>,
    /// Serial numbers of members that have to leave.
    leaving: Vec<usize>,
}

impl<T: Scalar> Reservoir<T> {
    /// An empty reservoir for `budget` support vectors. The same seed takes the same observations.
    ///
    /// # Errors
    /// Budget 0.
    pub fn new(kernel: Kernel, budget: usize, seed: u64, par: Par) -> Result<Self, DictionaryError> {
        Ok(Reservoir {
            dictionary: Dictionary::new(kernel, check_budget(budget)?, par),
            budget,
            random: stream(seed, "dictionary: reservoir"),
            seen: 0,
            places: Vec::new(),
            leaving: Vec::new(),
        })
    }
}

impl<T: Scalar> Selection<T> for Reservoir<T> {
    fn dictionary(&self) -> &Dictionary<T> {
        &self.dictionary
    }

    fn is_streaming(&self) -> bool {
        true
    }

    fn observe(&mut self, x: MatRef<'_, T>) -> Result<Block, DictionaryError> {
        // What was begun before stays untouched if the block is refused.
        let (mut random, mut seen) = (self.random.clone(), self.seen);
        let (mut places, mut leaving) = (self.places.clone(), self.leaving.clone());
        let mut next = self.dictionary.next_serial();
        let budget = self.budget;
        let mut before = 0;
        let block = self.dictionary.grow(x, |index, _| {
            seen += (index - before) as u64;
            before = index;
            if places.len() < budget {
                places.push(next);
            } else {
                // `seen` have gone before, so this is number seen + 1: it takes one of the places with budget/(seen + 1).
                let drawn = usize::try_from(random.random_range(0..=seen)).unwrap_or(usize::MAX);
                let Some(place) = places.get_mut(drawn) else { return false };
                leaving.push(std::mem::replace(place, next));
            }
            next += 1;
            true
        })?;
        seen += (x.ncols() - before) as u64;
        (self.random, self.seen, self.places, self.leaving) = (random, seen, places, leaving);
        Ok(block)
    }

    fn budget(&self) -> usize {
        self.budget
    }

    fn is_full(&self) -> bool {
        self.dictionary.len() >= self.budget
    }

    fn is_over_budget(&self) -> bool {
        !self.leaving.is_empty()
    }

    fn thin(&mut self) -> Result<Option<Thinning>, DictionaryError> {
        if self.leaving.is_empty() {
            return Ok(None);
        }
        let leaving = std::mem::take(&mut self.leaving);
        let serials = self.dictionary.serials();
        let keep: Vec<usize> = (0..serials.len()).filter(|&place| !leaving.contains(&serials[place])).collect();
        self.dictionary.keep(&keep).map(Some)
    }

    fn nu(&self) -> Option<f64> {
        None
    }

    #[cfg(feature = "snapshot")]
    fn persist(&mut self, snapshot: &mut Snapshot) -> Result<(), SnapshotError> {
        snapshot.inner("dictionary", &mut self.dictionary)?;
        snapshot.random("random", &mut self.random)?;
        snapshot.value("seen", &mut self.seen)?;
        snapshot.value("places", &mut self.places)?;
        snapshot.value("leaving", &mut self.leaving)
    }
}
