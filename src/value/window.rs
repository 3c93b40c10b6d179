//! The rolling window of transitions, kept near-uniform over states and actions.

use std::collections::{BTreeMap, VecDeque};

use super::ValueError;
use super::error::parameter;

/// One action and what came of it. `S` is what stands for a state (an observation, its number, …); `R` is what came of it
/// beside the state after: rewards, or what rewards are told from where tasks may change while the window rolls.
#[derive(Debug, Clone, PartialEq)]
pub struct Transition<S, R> {
    /// The state before.
    pub from: S,
    /// Action number.
    pub action: usize,
    /// The actions that may follow, as bits; as in [`Outcomes::allowed`](super::Outcomes::allowed).
    pub allowed: u32,
    /// What came of it.
    pub result: R,
    /// The state after.
    pub to: S,
    /// Cell of the state before.
    pub cell: usize,
}

/// A transition with its arrival number.
type Arrived<S, R> = (u64, Transition<S, R>);

/// A transition of a window with its arrival number.
pub type InWindow<'a, S, R> = (u64, &'a Transition<S, R>);

/// A bounded window over a stream of transitions.
///
/// An agent that acts greedily sees its own paths over and over. Policy iteration from such data alone can swing for ever
/// between two policies (Koller & Parr 2000), so rare states and actions must neither leave the window nor weigh less.
/// States are told apart by a *cell*, for which the nearest support vector serves. The window evicts the oldest transition
/// of the fullest (cell, action), and [`balance`] weighs what is in it.
#[derive(Debug, Clone)]
pub struct Window<S, R> {
    capacity: usize,
    /// Transitions of each (cell, action) in the order of their arrival, each with its arrival number.
    groups: BTreeMap<(usize, usize), VecDeque<Arrived<S, R>>>,
    len: usize,
    arrivals: u64,
}

impl<S: Clone, R: Clone> Window<S, R> {
    /// An empty window for `capacity` transitions; 0 counts as 1.
    pub fn new(capacity: usize) -> Self {
        Window { capacity: capacity.max(1), groups: BTreeMap::new(), len: 0, arrivals: 0 }
    }

    /// Number of transitions in the window.
    pub fn len(&self) -> usize {
        self.len
    }

    /// Whether the window holds nothing.
    pub fn is_empty(&self) -> bool {
        self.len == 0
    }

    /// Add a transition; if the window is full, the oldest of the fullest (cell, action) leaves and is returned.
    pub fn push(&mut self, transition: Transition<S, R>) -> Option<Transition<S, R>> {
        let group = self.groups.entry((transition.cell, transition.action)).or_default();
        group.push_back((self.arrivals, transition));
        self.arrivals += 1;
        self.len += 1;
        if self.len <= self.capacity {
            return None;
        }
        let fullest = self
            .groups
            .iter()
            .max_by_key(|(_, group)| (group.len(), std::cmp::Reverse(group.front().map(|entry| entry.0))))
            .map(|(key, _)| *key)?;
        let group = self.groups.get_mut(&fullest)?;
        let evicted = group.pop_front().map(|(_, transition)| transition);
        if group.is_empty() {
            self.groups.remove(&fullest);
        }
        self.len -= 1;
        evicted
    }

    /// All transitions with their arrival numbers, in this order, and the number that the next one will get: what
    /// [`Window::restored`] needs to make an equal window.
    pub fn arrivals(&self) -> (Vec<InWindow<'_, S, R>>, u64) {
        let mut entries: Vec<InWindow<'_, S, R>> =
            self.groups.values().flatten().map(|(number, transition)| (*number, transition)).collect();
        entries.sort_by_key(|entry| entry.0);
        (entries, self.arrivals)
    }

    /// A window for `capacity` transitions with these in it. Beyond its capacity the oldest of the fullest leave.
    pub fn restored(capacity: usize, entries: Vec<(u64, Transition<S, R>)>, next: u64) -> Self {
        let mut window = Window::new(capacity);
        for (number, transition) in entries {
            window.arrivals = number;
            window.push(transition);
        }
        window.arrivals = next;
        window
    }

    /// All transitions in the order of their arrival.
    pub fn snapshot(&self) -> Vec<Transition<S, R>> {
        let mut entries: Vec<&Arrived<S, R>> = self.groups.values().flatten().collect();
        entries.sort_by_key(|entry| entry.0);
        entries.into_iter().map(|(_, transition)| transition.clone()).collect()
    }
}

/// Weights ω that make groups count more alike: `ω ∝ (size of the group)^−exponent`, with mean 1.
///
/// `exponent` 0 leaves all transitions alike, 1 gives every (cell, action) the same total weight.
///
/// # Errors
/// An exponent outside [0, 1].
pub fn balance(groups: &[(usize, usize)], exponent: f64) -> Result<Vec<f64>, ValueError> {
    parameter("exponent", exponent, (0.0..=1.0).contains(&exponent), "in [0, 1]")?;
    let mut sizes: BTreeMap<(usize, usize), f64> = BTreeMap::new();
    for &group in groups {
        *sizes.entry(group).or_default() += 1.0;
    }
    let raw: Vec<f64> = groups.iter().map(|group| sizes[group].powf(-exponent)).collect();
    let mean = raw.iter().sum::<f64>() / raw.len().max(1) as f64;
    Ok(raw.into_iter().map(|weight| weight / mean).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn transition(cell: usize, action: usize, id: u32) -> Transition<u32, f64> {
        Transition { from: id, action, allowed: 7, result: 0.0, to: id + 1, cell }
    }

    #[test]
    fn the_fullest_cell_and_action_gives_way_oldest_first() {
        let mut window = Window::new(4);
        for id in 0..3 {
            assert!(window.push(transition(7, 0, id)).is_none());
        }
        assert!(window.push(transition(7, 1, 3)).is_none());
        assert_eq!(window.push(transition(2, 0, 4)).unwrap().from, 0);
        assert_eq!(window.push(transition(2, 1, 5)).unwrap().from, 1);
        // Every group now has one member: the one with the oldest front goes.
        assert_eq!(window.push(transition(3, 0, 6)).unwrap().from, 2);
        let kept: Vec<u32> = window.snapshot().iter().map(|t| t.from).collect();
        assert_eq!(kept, [3, 4, 5, 6]);
        assert_eq!(window.len(), 4);
    }

    #[test]
    fn balanced_weights_have_mean_one_and_equal_totals() {
        let groups = [(0, 0), (0, 0), (0, 0), (1, 2)];
        let weights = balance(&groups, 1.0).unwrap();
        assert!((weights.iter().sum::<f64>() - 4.0).abs() < 1e-12);
        assert!((weights[..3].iter().sum::<f64>() - weights[3]).abs() < 1e-12);
        assert_eq!(balance(&groups, 0.0).unwrap(), vec![1.0; 4]);
        assert!(balance(&groups, f64::NAN).is_err() && balance(&groups, 1e9).is_err());
    }
}
