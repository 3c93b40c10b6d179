//! Greedy selection by the largest residual: matching pursuit maximisation of the affine hull (MP-MAH).

use faer::{Mat, MatRef, Par};

use super::error::{check_budget, check_nu};
use super::newton::{ROUNDING, finite_norms};
use super::{Block, Dictionary, DictionaryError, Selection};
use crate::kernel::{Kernel, Scalar, squared_norms};

/// Selection of the largest residual, again and again, until none is above ν or the budget is used up.
///
/// Each step takes the observation that is farthest from the span of the support vectors so far. This is a Cholesky
/// factorisation with complete pivoting of the kernel matrix, of which only the chosen rows are computed.
///
/// It is not streaming: it chooses within one block only, so all observations have to be in it. A later block goes on
/// from the support vectors that there are. For `n` observations and `m` support vectors it needs `n·m` values of memory
/// and `O(n m²)` time.
///
/// # Reference
/// Böhmer, Grünewälder, Nickisch & Obermayer, *Generating feature spaces for linear algorithms with regularized sparse
/// kernel slow feature analysis*, Machine Learning 2012, §4 (MP-MAH). As in the thesis, the "affine hull" is the span: the
/// coefficients need not sum to one.
#[derive(Debug, Clone)]
pub struct GreedyResidual<T: Scalar> {
    dictionary: Dictionary<T>,
    nu: f64,
    budget: usize,
}

impl<T: Scalar> GreedyResidual<T> {
    /// An empty selection.
    ///
    /// # Errors
    /// ν not positive or not finite, budget 0.
    pub fn new(kernel: Kernel, nu: f64, budget: usize, par: Par) -> Result<Self, DictionaryError> {
        Ok(GreedyResidual {
            dictionary: Dictionary::new(kernel, check_budget(budget)?, par),
            nu: check_nu(nu)?,
            budget,
        })
    }

    /// The observations to take, in the order in which they are taken, and the residuals at the end; for those that are
    /// taken, the residual at which they were.
    fn choose(&self, x: MatRef<'_, T>) -> Result<(Vec<usize>, Vec<f64>), DictionaryError> {
        let norms = finite_norms(x)?;
        let n = x.ncols();
        let known = self.dictionary.coordinates(x)?;
        let mut rows: Vec<Vec<f64>> = (0..known.nrows()).map(|i| (0..n).map(|t| known[(i, t)]).collect()).collect();
        let kernel = self.dictionary.kernel();
        let whole: Vec<f64> = norms.iter().map(|&norm| kernel.diagonal(norm)).collect();
        let mut left: Vec<f64> =
            (0..n).map(|t| whole[t] - rows.iter().map(|row| row[t] * row[t]).sum::<f64>()).collect();
        if let Some(bad) = left.iter().position(|residual| !residual.is_finite()) {
            return Err(DictionaryError::NotFinite(bad));
        }
        let mut residuals: Vec<Option<f64>> = vec![None; n];
        let mut chosen = Vec::new();
        while self.dictionary.len() + chosen.len() < self.budget {
            // What is left of combinations of the support vectors is rounding.
            let candidates = (0..n).filter(|&t| residuals[t].is_none() && left[t] > ROUNDING * whole[t]);
            let Some(best) = candidates.reduce(|a, b| if left[b] > left[a] { b } else { a }) else { break };
            if left[best] <= self.nu {
                break;
            }
            residuals[best] = Some(left[best]);
            chosen.push(best);
            let column = x.subcols(best, 1);
            let values = kernel.matrix(column, &squared_norms(column), x, &norms, self.dictionary.par())?;
            let mut row: Vec<f64> = (0..n).map(|t| values[(0, t)]).collect();
            for earlier in &rows {
                let share = earlier[best];
                row.iter_mut().zip(earlier).for_each(|(entry, &other)| *entry -= share * other);
            }
            let root = left[best].sqrt();
            for (entry, rest) in row.iter_mut().zip(&mut left) {
                *entry /= root;
                *rest -= *entry * *entry;
            }
            rows.push(row);
        }
        let residuals = residuals.into_iter().zip(left).map(|(taken, rest)| taken.unwrap_or(rest.max(0.0))).collect();
        Ok((chosen, residuals))
    }
}

impl<T: Scalar> Selection<T> for GreedyResidual<T> {
    fn dictionary(&self) -> &Dictionary<T> {
        &self.dictionary
    }

    fn is_streaming(&self) -> bool {
        false
    }

    fn observe(&mut self, x: MatRef<'_, T>) -> Result<Block, DictionaryError> {
        let (chosen, residuals) = self.choose(x)?;
        let taken = Mat::from_fn(x.nrows(), chosen.len(), |i, j| x[(i, chosen[j])]);
        let grown = self.dictionary.grow(taken.as_ref(), |_, _| true)?;
        let rows = self.dictionary.kernel_rows(x)?;
        let serials = self.dictionary.serials();
        let nearest = (0..x.ncols())
            .map(|t| (0..serials.len()).reduce(|a, b| if rows[(b, t)] > rows[(a, t)] { b } else { a }))
            .map(|place| place.map_or(0, |place| serials[place]))
            .collect();
        Ok(Block {
            coordinates: self.dictionary.coordinates(x)?,
            residuals,
            accepted: grown.accepted.iter().map(|&index| chosen[index]).collect(),
            nearest,
        })
    }

    fn budget(&self) -> usize {
        self.budget
    }

    fn is_full(&self) -> bool {
        self.dictionary.len() >= self.budget
    }

    fn nu(&self) -> Option<f64> {
        Some(self.nu)
    }
}
