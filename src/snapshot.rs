//! What an object is made of, by names: so that it can be saved and restored, bit for bit.
//!
//! A type lists its parts once ([`Persist::persist`]); [`Snapshot`] either takes copies of them or gives back what was taken. So
//! what is kept and what is restored cannot differ. Nothing here knows of files.

use std::collections::BTreeMap;

use faer::Mat;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use serde::Serialize;
use serde::de::DeserializeOwned;
use thiserror::Error;

/// An object that can be saved and restored.
pub trait Persist {
    /// Hand each part to `parts`, which copies or replaces it.
    ///
    /// # Errors
    /// A part that is missing, or does not fit the others; the object is not to be used then.
    fn persist(&mut self, snapshot: &mut Snapshot) -> Result<(), SnapshotError>;
}

/// Why an object cannot be saved or restored.
#[derive(Debug, Error, Clone, PartialEq, Eq)]
pub enum SnapshotError {
    /// A part is not there.
    #[error("{0} is missing")]
    Missing(String),
    /// A part is of another kind, or has a value that cannot be.
    #[error("{name}: {cause}")]
    Wrong {
        /// The part.
        name: String,
        /// What is wrong.
        cause: String,
    },
    /// An object that nobody else can restore, such as a function of the user's.
    #[error("{0} cannot be saved")]
    Unable(&'static str),
}

/// Numbers in columns.
#[derive(Debug, Clone, PartialEq)]
pub enum Values {
    /// Double precision.
    F64(Vec<f64>),
    /// Single precision.
    F32(Vec<f32>),
    /// Bytes.
    U8(Vec<u8>),
}

impl Values {
    /// How many there are.
    pub fn len(&self) -> usize {
        match self {
            Values::F64(values) => values.len(),
            Values::F32(values) => values.len(),
            Values::U8(values) => values.len(),
        }
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }
}

/// A matrix, column by column.
#[derive(Debug, Clone, PartialEq)]
pub struct Matrix {
    /// Rows.
    pub rows: usize,
    /// Columns.
    pub columns: usize,
    /// `rows · columns` values.
    pub values: Values,
}

/// A kind of number that matrices are made of.
pub trait Element: Copy + Sized {
    /// As values of a matrix.
    fn values(values: Vec<Self>) -> Values;
    /// From values of a matrix, if they are of this kind.
    fn of(values: &Values) -> Option<&[Self]>;
}

macro_rules! element {
    ($type:ty, $kind:ident) => {
        impl Element for $type {
            fn values(values: Vec<Self>) -> Values {
                Values::$kind(values)
            }

            fn of(values: &Values) -> Option<&[Self]> {
                match values {
                    Values::$kind(values) => Some(values),
                    _ => None,
                }
            }
        }
    };
}

element!(f64, F64);
element!(f32, F32);
element!(u8, U8);

/// The parts of one object, or of several with different names.
#[derive(Debug, Default)]
pub struct Snapshot {
    /// Matrices by name.
    pub matrices: BTreeMap<String, Matrix>,
    /// Everything else by name, as JSON.
    pub texts: BTreeMap<String, String>,
    restoring: bool,
    within: String,
}

impl Snapshot {
    /// To put something away.
    pub fn new() -> Self {
        Snapshot::default()
    }

    /// To restore what was saved as these parts.
    pub fn restoring(matrices: BTreeMap<String, Matrix>, texts: BTreeMap<String, String>) -> Self {
        Snapshot { matrices, texts, restoring: true, within: String::new() }
    }

    /// Whether parts are given back, and not taken.
    pub fn is_restoring(&self) -> bool {
        self.restoring
    }

    /// The parts of an inner object, under a name of its own.
    ///
    /// # Errors
    /// Those of the inner object.
    pub fn inner(&mut self, name: &str, object: &mut (impl Persist + ?Sized)) -> Result<(), SnapshotError> {
        self.scope(name, |snapshot| object.persist(snapshot))
    }

    /// Do something with names that begin with `name`.
    ///
    /// # Errors
    /// Those of `with`.
    pub fn scope<R>(
        &mut self,
        name: &str,
        with: impl FnOnce(&mut Snapshot) -> Result<R, SnapshotError>,
    ) -> Result<R, SnapshotError> {
        let outer = self.within.len();
        self.within.push_str(name);
        self.within.push('.');
        let result = with(self);
        self.within.truncate(outer);
        result
    }

    /// Anything that JSON holds exactly: whole numbers, texts, lists of them. Numbers with a fraction go into
    /// [`Snapshot::number`] or [`Snapshot::numbers`].
    ///
    /// # Errors
    /// The part is missing or of another kind.
    pub fn value<T: Serialize + DeserializeOwned>(&mut self, name: &str, value: &mut T) -> Result<(), SnapshotError> {
        let name = self.name(name);
        if self.restoring {
            let text = self.texts.get(&name).ok_or_else(|| SnapshotError::Missing(name.clone()))?;
            *value = serde_json::from_str(text).map_err(|cause| wrong(&name, cause))?;
        } else {
            let text = serde_json::to_string(value).map_err(|cause| wrong(&name, cause))?;
            let before = self.texts.insert(name.clone(), text);
            return once(&name, before.is_none());
        }
        Ok(())
    }

    /// One number, exactly.
    ///
    /// # Errors
    /// The part is missing or of another kind.
    pub fn number(&mut self, name: &str, number: &mut f64) -> Result<(), SnapshotError> {
        let mut bits = number.to_bits();
        self.value(name, &mut bits)?;
        *number = f64::from_bits(bits);
        Ok(())
    }

    /// A list of numbers, exactly.
    ///
    /// # Errors
    /// The part is missing or of another kind.
    pub fn numbers<E: Element>(&mut self, name: &str, numbers: &mut Vec<E>) -> Result<(), SnapshotError> {
        let name = self.name(name);
        if self.restoring {
            let (_, columns, values) = self.find::<E>(&name)?;
            if columns != 1 {
                return Err(wrong(&name, format!("{columns} columns in place of one")));
            }
            *numbers = values.to_vec();
        } else {
            let matrix = Matrix { rows: numbers.len(), columns: 1, values: E::values(numbers.clone()) };
            return once(&name, self.matrices.insert(name.clone(), matrix).is_none());
        }
        Ok(())
    }

    /// A matrix, exactly. `room`: rows and columns that a restored one has storage for, beyond its own.
    ///
    /// # Errors
    /// The part is missing or of another kind.
    pub fn matrix<E: Element + Default>(
        &mut self,
        name: &str,
        matrix: &mut Mat<E>,
        room: impl FnOnce(usize, usize) -> (usize, usize),
    ) -> Result<(), SnapshotError> {
        let name = self.name(name);
        if !self.restoring {
            let (rows, columns) = (matrix.nrows(), matrix.ncols());
            let mut values = Vec::with_capacity(rows * columns);
            matrix.as_ref().col_iter().for_each(|column| values.extend(column.iter().copied()));
            let matrix = Matrix { rows, columns, values: E::values(values) };
            return once(&name, self.matrices.insert(name.clone(), matrix).is_none());
        }
        let (rows, columns, values) = self.find::<E>(&name)?;
        let (more_rows, more_columns) = room(rows, columns);
        let mut restored = Mat::with_capacity(rows.max(more_rows), columns.max(more_columns));
        restored.resize_with(rows, columns, |i, j| values[j * rows + i]);
        *matrix = restored;
        Ok(())
    }

    /// A generator of random numbers, at its place in the stream.
    ///
    /// # Errors
    /// The part is missing or of another kind.
    pub fn random(&mut self, name: &str, random: &mut ChaCha8Rng) -> Result<(), SnapshotError> {
        let mut state = (random.get_seed(), random.get_stream(), random.get_word_pos().to_string());
        self.value(name, &mut state)?;
        let (seed, stream, place) = state;
        *random = ChaCha8Rng::from_seed(seed);
        random.set_stream(stream);
        random.set_word_pos(place.parse().map_err(|cause| wrong(&self.name(name), cause))?);
        Ok(())
    }

    /// Refuse what does not fit.
    ///
    /// # Errors
    /// Unless it `fits`.
    pub fn check(&self, name: &str, fits: bool, cause: &str) -> Result<(), SnapshotError> {
        if fits { Ok(()) } else { Err(wrong(&self.name(name), cause)) }
    }

    fn name(&self, name: &str) -> String {
        format!("{}{name}", self.within)
    }

    fn find<E: Element>(&self, name: &str) -> Result<(usize, usize, &[E]), SnapshotError> {
        let matrix = self.matrices.get(name).ok_or_else(|| SnapshotError::Missing(name.to_owned()))?;
        let values = E::of(&matrix.values).ok_or_else(|| wrong(name, "another kind of number"))?;
        if matrix.rows.checked_mul(matrix.columns) != Some(values.len()) {
            return Err(wrong(name, format!("{} values for {} × {}", values.len(), matrix.rows, matrix.columns)));
        }
        Ok((matrix.rows, matrix.columns, values))
    }
}

/// Two parts of one name would be given back as one.
fn once(name: &str, first: bool) -> Result<(), SnapshotError> {
    if first { Ok(()) } else { Err(wrong(name, "two parts have this name")) }
}

fn wrong(name: &str, cause: impl std::fmt::Display) -> SnapshotError {
    SnapshotError::Wrong { name: name.to_owned(), cause: cause.to_string() }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::stream;
    use rand::{Rng, RngExt};

    struct Thing {
        matrix: Mat<f64>,
        pixels: Vec<u8>,
        count: u64,
        share: f64,
        random: ChaCha8Rng,
    }

    impl Persist for Thing {
        fn persist(&mut self, snapshot: &mut Snapshot) -> Result<(), SnapshotError> {
            snapshot.matrix("matrix", &mut self.matrix, |rows, columns| (2 * rows, columns))?;
            snapshot.numbers("pixels", &mut self.pixels)?;
            snapshot.value("count", &mut self.count)?;
            snapshot.number("share", &mut self.share)?;
            snapshot.random("random", &mut self.random)
        }
    }

    fn thing(seed: u64) -> Thing {
        let mut random = stream(seed, "thing");
        let matrix = Mat::from_fn(3, 4, |_, _| random.random_range(-1.0..1.0));
        // An odd number of words: the generator stands in the middle of a block.
        let _ = random.next_u32();
        Thing { matrix, pixels: vec![1, 2, 255], count: u64::MAX, share: 0.1 + 0.2, random }
    }

    fn put_away(thing: &mut Thing) -> Snapshot {
        let mut snapshot = Snapshot::new();
        snapshot.inner("thing", thing).unwrap();
        snapshot
    }

    #[test]
    fn what_was_put_away_comes_back_bit_for_bit_and_goes_on_alike() {
        let mut one = thing(1);
        let snapshot = put_away(&mut one);
        let mut other = thing(2);
        let mut restoring = Snapshot::restoring(snapshot.matrices, snapshot.texts);
        restoring.inner("thing", &mut other).unwrap();
        assert_eq!((&one.matrix, &one.pixels, one.count), (&other.matrix, &other.pixels, other.count));
        assert_eq!(one.share.to_bits(), other.share.to_bits());
        for _ in 0..100 {
            assert_eq!(one.random.next_u32(), other.random.next_u32());
        }
    }

    #[test]
    fn parts_that_are_missing_or_wrong_are_named() {
        let restore = |change: &dyn Fn(&mut Snapshot)| {
            let mut snapshot = put_away(&mut thing(1));
            change(&mut snapshot);
            Snapshot::restoring(snapshot.matrices, snapshot.texts)
                .inner("thing", &mut thing(2))
                .unwrap_err()
                .to_string()
        };
        let without = restore(&|snapshot| drop(snapshot.matrices.remove("thing.matrix")));
        assert_eq!(without, "thing.matrix is missing");
        let short = restore(&|snapshot| snapshot.matrices.get_mut("thing.matrix").unwrap().rows = usize::MAX);
        assert!(short.starts_with("thing.matrix: 12 values for"), "{short}");
        let kind =
            restore(&|snapshot| snapshot.matrices.get_mut("thing.pixels").unwrap().values = Values::F32(vec![0.0; 3]));
        assert_eq!(kind, "thing.pixels: another kind of number");
        let text = restore(&|snapshot| drop(snapshot.texts.insert("thing.count".into(), "-1".into())));
        assert!(text.starts_with("thing.count: "), "{text}");
    }
}
