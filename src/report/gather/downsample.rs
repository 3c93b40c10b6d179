//! A series of any length in bounded memory.

/// Keeps at most a number of entries: when there are more, neighbours are merged, again and again.
#[derive(Debug, Clone)]
pub struct Downsample<T> {
    most: usize,
    /// Entries that were merged into each of `items`.
    stride: usize,
    items: Vec<T>,
    /// The entry that is being merged, and of how many.
    open: Option<(usize, T)>,
    merge: fn(&mut T, T),
    /// Entries that were offered.
    offered: u64,
}

impl<T> Default for Downsample<T> {
    fn default() -> Self {
        Downsample::last_of(0)
    }
}

impl<T> Downsample<T> {
    /// An empty series of at most `most` entries, an even number; `merge` puts an entry into the one before.
    pub fn new(most: usize, merge: fn(&mut T, T)) -> Self {
        Downsample { most: most.max(2) / 2 * 2, stride: 1, items: Vec::new(), open: None, merge, offered: 0 }
    }

    /// An empty series that keeps the first of each group of neighbours.
    pub fn first_of(most: usize) -> Self {
        Downsample::new(most, |_, _| {})
    }

    /// An empty series that keeps the last of each group of neighbours.
    pub fn last_of(most: usize) -> Self {
        Downsample::new(most, |a, b| *a = b)
    }

    /// One more entry.
    pub fn push(&mut self, item: T) {
        match &mut self.open {
            Some((_, open)) => (self.merge)(open, item),
            None => self.open = Some((0, item)),
        }
        self.counted();
    }

    /// One more entry of a series that keeps the first of each group: it is only made if it is kept.
    ///
    /// # Errors
    /// Those of `make`; then nothing is added.
    pub fn offer<E>(&mut self, make: impl FnOnce() -> Result<T, E>) -> Result<(), E> {
        if self.open.is_none() {
            self.open = Some((0, make()?));
        }
        self.counted();
        Ok(())
    }

    fn counted(&mut self) {
        self.offered += 1;
        if let Some((count, _)) = &mut self.open {
            *count += 1;
            if *count >= self.stride {
                self.items.extend(self.open.take().map(|(_, item)| item));
            }
        }
        if self.items.len() >= self.most {
            let mut pairs = std::mem::take(&mut self.items).into_iter();
            while let Some(mut first) = pairs.next() {
                if let Some(second) = pairs.next() {
                    (self.merge)(&mut first, second);
                }
                self.items.push(first);
            }
            self.stride *= 2;
        }
    }

    /// Entries that were offered.
    pub fn offered(&self) -> u64 {
        self.offered
    }

    /// What is left of the series, in its order.
    pub fn iter(&self) -> impl Iterator<Item = &T> {
        self.items.iter().chain(self.open.iter().map(|(_, item)| item))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn memory_is_bounded_and_nothing_high_is_lost() {
        let mut series = Downsample::new(100, |a: &mut u64, b| *a = (*a).max(b));
        for i in 0..123_457u64 {
            series.push(if i == 70_001 { 1_000_000 } else { i });
            assert!(series.iter().count() <= 101);
        }
        assert_eq!(series.offered(), 123_457);
        assert_eq!(series.iter().max(), Some(&1_000_000));
        assert!(series.iter().count() > 40);
        assert_eq!(series.iter().last(), Some(&123_456));
    }

    #[test]
    fn the_first_of_each_group_is_kept_at_even_distances() {
        let mut series = Downsample::first_of(8);
        let mut made = 0;
        for i in 0..1000u64 {
            let make = || -> Result<u64, ()> {
                made += 1;
                Ok(i)
            };
            series.offer(make).unwrap();
        }
        let kept: Vec<u64> = series.iter().copied().collect();
        let steps: Vec<u64> = kept.windows(2).map(|pair| pair[1] - pair[0]).collect();
        assert!(kept[0] == 0 && steps.iter().all(|&step| step == steps[0]), "{kept:?}");
        assert!(made < 60, "{made} entries were made");
    }
}
