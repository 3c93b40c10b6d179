//! Two halves of a piece of work on two threads.

use faer::Par;

/// Run two parts of a piece of work, side by side if there are threads for it; each part is told how many it has.
///
/// Where the work is cut must not depend on `par`: then its result does not either, to the last bit.
pub(crate) fn join(par: Par, first: impl FnOnce(Par) + Send, second: impl FnOnce(Par) + Send) {
    match par {
        Par::Rayon(threads) if threads.get() > 1 => {
            let half = threads.get() / 2;
            rayon::join(|| first(Par::rayon(threads.get() - half)), || second(Par::rayon(half)));
        }
        _ => {
            first(Par::Seq);
            second(Par::Seq);
        }
    }
}

/// Where to cut `size` into two parts so that the first is a multiple of `unit`, and about half.
pub(crate) fn whole_halves(size: usize, unit: usize) -> usize {
    size.div_ceil(2 * unit) * unit
}
