//! ALD in the space of features: support vectors that are spread over what the features tell apart.

use faer::{Mat, MatRef};

use super::error::check_nu;
use super::{Ald, Block, Dictionary, DictionaryError, FeatureMap, Parameters, Selection, Thinning};
use crate::kernel::{Kernel, Scalar};

/// How a [`FeatureAld`] judges in the space of features.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FeatureParameters {
    /// Kernel over features. Slow features have unit variance, so a width around 1 is natural.
    pub kernel: Kernel,
    /// Threshold ν on the residual in the space of features, > 0.
    pub nu: f64,
}

/// Selection by approximate linear dependence of *features* of the observations.
///
/// A set that is uniform in the space of images is worse for values than one that is uniform in the space of states
/// (Böhmer et al. 2013, §5.5). States are not known, but slow features are the nearest thing: they vary with the
/// robot's place, not with every change of the image.
///
/// Until features are [adopted](Selection::adopt) it is a plain [`Ald`] over the observations. New features judge from
/// then on; support vectors that were taken before stay.
#[derive(Debug, Clone)]
pub struct FeatureAld<T: Scalar> {
    ald: Ald<T>,
    parameters: FeatureParameters,
    /// The features, and the dictionary over them.
    adopted: Option<(FeatureMap<T>, Dictionary<f64>)>,
}

impl<T: Scalar> FeatureAld<T> {
    /// An empty selection: `observations` holds before features are adopted, and its budget throughout.
    ///
    /// # Errors
    /// Those of [`Ald::new`]; ν not positive or not finite.
    pub fn new(observations: Parameters, features: FeatureParameters) -> Result<Self, DictionaryError> {
        check_nu(features.nu)?;
        Ok(FeatureAld { ald: Ald::new(observations)?, parameters: features, adopted: None })
    }
}

impl<T: Scalar> Selection<T> for FeatureAld<T> {
    fn dictionary(&self) -> &Dictionary<T> {
        self.ald.dictionary()
    }

    fn is_streaming(&self) -> bool {
        true
    }

    fn observe(&mut self, x: MatRef<'_, T>) -> Result<Block, DictionaryError> {
        let Some((map, over_features)) = &mut self.adopted else { return self.ald.observe(x) };
        self.ald.dictionary().check(x)?;
        let features = map.of(x)?;
        let nu = self.parameters.nu;
        let mut grown = over_features.clone();
        let novel = grown.grow(features.as_ref(), |_, residual| residual > nu)?.accepted;
        let block = self.ald.take(x, |index, _| novel.binary_search(&index).is_ok())?;
        if block.accepted.len() < novel.len() {
            // There was no room for all of them. Only support vectors count as known, so that this dictionary stays as small.
            grown = over_features.clone();
            grown.grow(features.as_ref(), |index, _| block.accepted.binary_search(&index).is_ok())?;
        }
        *over_features = grown;
        Ok(block)
    }

    fn budget(&self) -> usize {
        self.ald.budget()
    }

    fn is_full(&self) -> bool {
        self.ald.is_full()
    }

    fn is_over_budget(&self) -> bool {
        self.ald.is_over_budget()
    }

    fn thin(&mut self) -> Result<Option<Thinning>, DictionaryError> {
        let Some((map, over_features)) = &mut self.adopted else { return self.ald.thin() };
        if !self.ald.is_over_budget() {
            return Ok(None);
        }
        // Features come from outside and may fail. Nothing may have left by then: whoever sums over coordinates could not
        // follow.
        let features = map.of(self.ald.dictionary().members())?;
        let FeatureParameters { kernel, nu } = self.parameters;
        let empty = |expected, par| Dictionary::new(kernel, expected, par);
        let (members, par) = (self.ald.dictionary().len(), self.ald.dictionary().par());
        empty(members, par).grow(features.as_ref(), |_, _| false)?;
        let thinning = self.ald.thin()?;
        if let Some(thinning) = &thinning {
            let keep = thinning.keep();
            let of_members = Mat::from_fn(features.nrows(), keep.len(), |i, j| features[(i, keep[j])]);
            *over_features = empty(self.ald.budget(), par);
            over_features.grow(of_members.as_ref(), |_, residual| residual > nu)?;
        }
        Ok(thinning)
    }

    fn nu(&self) -> Option<f64> {
        if self.adopted.is_some() { Some(self.parameters.nu) } else { self.ald.nu() }
    }

    fn adopt(&mut self, features: FeatureMap<T>) -> Result<(), DictionaryError> {
        let FeatureParameters { kernel, nu } = self.parameters;
        let dictionary = self.ald.dictionary();
        let mut over_features = Dictionary::new(kernel, self.ald.budget(), dictionary.par());
        if !dictionary.is_empty() {
            let of_members = features.of(dictionary.members())?;
            over_features.grow(of_members.as_ref(), |_, residual| residual > nu)?;
        }
        self.adopted = Some((features, over_features));
        Ok(())
    }
}
