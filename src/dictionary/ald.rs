//! Approximate linear dependence (ALD): take what the support vectors do not span up to `√ν`.

use faer::linalg::triangular_inverse::invert_lower_triangular;
use faer::{Mat, MatRef, Par};

use super::error::{check_budget, check_nu};
use super::{Block, Dictionary, DictionaryError, Selection, Thinning};
use crate::kernel::{Kernel, Scalar};
#[cfg(feature = "snapshot")]
use crate::snapshot::{Snapshot, SnapshotError};

/// What an [`Ald`] does when its budget is used up.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum WhenFull {
    /// Stop growing.
    Stop,
    /// Raise ν until ALD over the support vectors, in their order, keeps at most ¾ of the budget; then go on with that ν.
    /// If it would keep none (the support vectors have nothing in common, σ is too small), ν stays below that, and the
    /// first ¾ of the budget stay.
    RaiseNu,
    /// Go on accepting, and let the least independent support vectors leave.
    ///
    /// The independence of a member is its own residual over all others, `1/(K⁻¹)ᵢᵢ`. Within a block all newcomers are
    /// taken first; with blocks of one observation this is plain replacement.
    Replace,
}

/// The checked parameters of an [`Ald`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Parameters {
    /// The kernel.
    pub kernel: Kernel,
    /// Acceptance threshold ν on the residual `ε(x)`: > 0; only values below `k(x, x)`, which is 1 for radial kernels,
    /// select anything.
    pub nu: f64,
    /// The largest number of support vectors.
    pub budget: usize,
    /// What happens at the budget.
    pub when_full: WhenFull,
    /// Threads for the matrix products (their bits do not depend on it).
    pub par: Par,
}

/// Selection by approximate linear dependence.
///
/// An observation becomes a support vector when `ε(x) > ν`. (The thesis prints the inequality of its algorithm 2 the wrong
/// way round, and its text says it right.) The number of support vectors stays bounded for every ν, but there is no
/// telling beforehand what it will be; so there is a budget, and three ways to live with it.
///
/// # Reference
/// Engel, Mannor & Meir 2004; thesis §2.2.6, eq. `ald_condition2`. Replacing the least independent member: the score of
/// Csató & Opper 2002 without targets.
#[derive(Debug, Clone)]
pub struct Ald<T: Scalar> {
    dictionary: Dictionary<T>,
    nu: f64,
    budget: usize,
    when_full: WhenFull,
}

/// Each step of [`WhenFull::RaiseNu`] raises ν by this factor.
const RAISE: f64 = std::f64::consts::SQRT_2;

/// Members that are judged together when a dictionary is thinned.
const BLOCK: usize = 256;

impl<T: Scalar> Ald<T> {
    /// An empty selection.
    ///
    /// # Errors
    /// ν not positive or not finite, budget 0.
    pub fn new(parameters: Parameters) -> Result<Self, DictionaryError> {
        let Parameters { kernel, nu, budget, when_full, par } = parameters;
        Ok(Ald {
            dictionary: Dictionary::new(kernel, check_budget(budget)?, par),
            nu: check_nu(nu)?,
            budget,
            when_full,
        })
    }

    /// The support vectors, when no more are to come.
    pub fn into_dictionary(self) -> Dictionary<T> {
        self.dictionary
    }

    /// Take the observations that `wanted(i, ε)` names, while the budget allows it or other members can make room.
    pub(super) fn take(
        &mut self,
        x: MatRef<'_, T>,
        wanted: impl Fn(usize, f64) -> bool,
    ) -> Result<Block, DictionaryError> {
        let stops = self.when_full == WhenFull::Stop;
        let mut room = self.budget.saturating_sub(self.dictionary.len());
        self.dictionary.grow(x, |index, residual| {
            let accepted = wanted(index, residual) && (room > 0 || !stops);
            room = room.saturating_sub(usize::from(accepted));
            accepted
        })
    }

    /// The members that ALD with threshold `nu` keeps, when it meets them in their order.
    fn survivors(&self, nu: f64) -> Result<Vec<usize>, DictionaryError> {
        let members = self.dictionary.members();
        let mut thinner = Dictionary::new(self.dictionary.kernel(), self.budget, self.dictionary.par());
        let mut kept = Vec::new();
        for start in (0..members.ncols()).step_by(BLOCK) {
            let part = members.subcols(start, BLOCK.min(members.ncols() - start));
            let block = thinner.grow(part, |_, residual| residual > nu)?;
            kept.extend(block.accepted.iter().map(|index| start + index));
        }
        Ok(kept)
    }

    fn raise_nu(&mut self) -> Result<Vec<usize>, DictionaryError> {
        let room = (self.budget - self.budget.div_ceil(4)).max(1);
        // Below the smallest residual at acceptance nobody leaves.
        let factor = self.dictionary.factor();
        let lowest = (0..factor.nrows()).map(|i| factor[(i, i)] * factor[(i, i)]).fold(f64::INFINITY, f64::min);
        self.nu = self.nu.max(lowest / RAISE);
        loop {
            let raised = self.nu * RAISE;
            let kept = self.survivors(raised)?;
            if kept.is_empty() {
                // Members this independent of each other differ in nothing that ν could go by, and above k(x, x) it would
                // never accept anything again: ν stays, and the first members do.
                return Ok((0..room).collect());
            }
            self.nu = raised;
            if kept.len() <= room {
                return Ok(kept);
            }
        }
    }

    /// The members that are left when the least independent one leaves, again and again, down to the budget.
    fn most_independent(&self) -> Vec<usize> {
        let m = self.dictionary.len();
        let mut inverse = Mat::<f64>::zeros(m, m);
        invert_lower_triangular(inverse.as_mut(), self.dictionary.factor(), self.dictionary.par());
        // K⁻¹ = L⁻ᵀL⁻¹.
        let mut precision = inverse.transpose() * &inverse;
        let mut here: Vec<usize> = (0..m).collect();
        while here.len() > self.budget {
            let of = |&(_, &place): &(usize, &usize)| precision[(place, place)];
            let Some((turn, &worst)) = here.iter().enumerate().max_by(|a, b| of(a).total_cmp(&of(b))) else { break };
            // The inverse without row and column `worst`: a rank-one step.
            let column = precision.col(worst).to_owned();
            let pivot = column[worst];
            for &j in &here {
                let share = column[j] / pivot;
                for &i in &here {
                    precision[(i, j)] -= column[i] * share;
                }
            }
            here.remove(turn);
        }
        here
    }
}

impl<T: Scalar> Selection<T> for Ald<T> {
    fn dictionary(&self) -> &Dictionary<T> {
        &self.dictionary
    }

    fn is_streaming(&self) -> bool {
        true
    }

    fn observe(&mut self, x: MatRef<'_, T>) -> Result<Block, DictionaryError> {
        let nu = self.nu;
        self.take(x, |_, residual| residual > nu)
    }

    fn budget(&self) -> usize {
        self.budget
    }

    fn is_full(&self) -> bool {
        self.when_full != WhenFull::RaiseNu && self.dictionary.len() >= self.budget
    }

    fn is_over_budget(&self) -> bool {
        self.dictionary.len() > self.budget
    }

    fn thin(&mut self) -> Result<Option<Thinning>, DictionaryError> {
        if !self.is_over_budget() {
            return Ok(None);
        }
        let keep = match self.when_full {
            WhenFull::RaiseNu => self.raise_nu()?,
            WhenFull::Replace | WhenFull::Stop => self.most_independent(),
        };
        self.dictionary.keep(&keep).map(Some)
    }

    fn nu(&self) -> Option<f64> {
        Some(self.nu)
    }

    #[cfg(feature = "snapshot")]
    fn persist(&mut self, snapshot: &mut Snapshot) -> Result<(), SnapshotError> {
        snapshot.inner("dictionary", &mut self.dictionary)?;
        snapshot.number("nu", &mut self.nu)?;
        snapshot.check("nu", check_nu(self.nu).is_ok(), "not a threshold")
    }
}
