//! The kernel width at which ALD keeps a given number of support vectors.

use faer::{MatRef, Par};

use super::error::check_nu;
use super::{Dictionary, DictionaryError};
use crate::kernel::{Kernel, KernelError, Scalar, median_distance};

/// A kernel width and what it came to.
#[derive(Debug, Clone, PartialEq)]
pub struct WidthForSize {
    /// The width, in the units of the observations.
    pub sigma: f64,
    /// Support vectors that ALD keeps at it.
    pub size: usize,
    /// All widths that were tried, with their sizes, in the order of trying.
    pub tried: Vec<(f64, usize)>,
}

/// The bracket grows by this factor.
const STEP: f64 = 1.5;
/// The bracket grows at most this often to each side: to widths of 3000 median distances, and the 3000th part of one.
const STEPS: usize = 20;
/// The search ends when the ends of the bracket differ by less than this share.
const RESOLUTION: f64 = 1e-4;
/// Observations that are judged together.
const BLOCK: usize = 128;
/// A width for a share is at least this share of the median distance: where half of a signal stands still, the search for a
/// size would else go down to its noise.
const NARROWEST: f64 = 0.5;
/// A width is far too narrow where one that is so many times as wide is wanted. In worlds whose first frames are like the rest, 0.8 to 1.2
/// times is wanted; where the first room is duller than the others, 1.2 to 3 times.
const TOO_NARROW: f64 = 1.5;

/// The width σ at which ALD with threshold `nu` keeps `target` of the observations `x`, as nearly as any width does.
///
/// There is no way to tell the number from ν and σ. The thesis (§2.2.6) kept ν, varied σ by hand and repeated the selection
/// until the number suited. This is that search: a bracket around the median distance, then bisection on a logarithmic
/// scale.
///
/// `kernel` makes the kernel of a width, such as [`Kernel::gaussian`]. The narrower the kernel, the more is kept.
///
/// # Shapes
/// `x: d × n`.
///
/// # Errors
/// ν not positive; observations that are all equal, fewer than two, or not finite; a target of 0, or larger than the number
/// that even the narrowest kernel keeps.
///
/// # Example
/// ```
/// use adagio::dictionary::width_for_size;
/// use adagio::kernel::Kernel;
/// use faer::{Mat, Par};
///
/// # fn main() -> Result<(), adagio::dictionary::DictionaryError> {
/// let line = Mat::from_fn(1, 200, |_, t| t as f64 / 199.0);
/// let found = width_for_size(line.as_ref(), 0.1, 10, Kernel::gaussian, Par::Seq)?;
/// assert_eq!(found.size, 10);
/// # Ok(())
/// # }
/// ```
///
/// # Reference
/// Thesis §2.2.6, last paragraph.
pub fn width_for_size<T: Scalar>(
    x: MatRef<'_, T>,
    nu: f64,
    target: usize,
    kernel: impl Fn(f64) -> Result<Kernel, KernelError>,
    par: Par,
) -> Result<WidthForSize, DictionaryError> {
    check_nu(nu)?;
    let median = median_distance(x)?;
    let mut tried = Vec::new();
    let mut size_at = |sigma: f64| -> Result<usize, DictionaryError> {
        let size = size_with(x, nu, kernel(sigma)?, x.ncols(), par)?;
        tried.push((sigma, size));
        Ok(size)
    };
    let refuse = |largest| DictionaryError::Target { target, observations: x.ncols(), largest };

    let (mut narrow, mut wide) = (median, median);
    let mut largest = size_at(median)?;
    if largest < target {
        for _ in 0..STEPS {
            wide = narrow;
            narrow /= STEP;
            let size = size_at(narrow)?;
            largest = largest.max(size);
            if size >= target {
                break;
            }
        }
    } else {
        for _ in 0..STEPS {
            narrow = wide;
            wide *= STEP;
            if size_at(wide)? <= target {
                break;
            }
        }
    }
    if target == 0 || target > largest {
        return Err(refuse(largest));
    }
    while wide / narrow > 1.0 + RESOLUTION {
        let middle = (narrow * wide).sqrt();
        match size_at(middle)?.cmp(&target) {
            std::cmp::Ordering::Greater => narrow = middle,
            std::cmp::Ordering::Less => wide = middle,
            std::cmp::Ordering::Equal => break,
        }
    }
    let best = tried.iter().copied().min_by_key(|&(_, size)| size.abs_diff(target));
    let (sigma, size) = best.ok_or_else(|| refuse(largest))?;
    Ok(WidthForSize { sigma, size, tried })
}

/// What ALD keeps of the observations; counted no further than beyond `most`.
fn size_with<T: Scalar>(
    x: MatRef<'_, T>,
    nu: f64,
    kernel: Kernel,
    most: usize,
    par: Par,
) -> Result<usize, DictionaryError> {
    let mut dictionary = Dictionary::new(kernel, x.ncols(), par);
    for start in (0..x.ncols()).step_by(BLOCK) {
        dictionary.grow(x.subcols(start, BLOCK.min(x.ncols() - start)), |_, residual| residual > nu)?;
        if dictionary.len() > most {
            break;
        }
    }
    Ok(dictionary.len())
}

/// The width of [`width_for_share`] for the observations `x`, if `sigma`, which some of them gave, is far too narrow for all of them: by
/// a factor of 1.5 or more. That takes one selection where it is not.
///
/// # Shapes
/// `x: d × n`.
///
/// # Errors
/// As [`width_for_share`].
///
/// # Example
/// ```
/// use adagio::dictionary::wider_for_share;
/// use adagio::kernel::Kernel;
/// use faer::{Mat, Par};
///
/// # fn main() -> Result<(), adagio::dictionary::DictionaryError> {
/// // What was seen first lies close together, and tells nothing of the rest.
/// let line = Mat::from_fn(1, 200, |_, t| if t < 50 { t as f64 / 5000.0 } else { (t - 49) as f64 });
/// let wider = wider_for_share(line.as_ref(), 0.1, 0.5, 0.005, Kernel::gaussian, Par::Seq)?;
/// assert!(wider.is_some_and(|sigma| sigma > 0.1));
/// assert_eq!(wider_for_share(line.as_ref(), 0.1, 0.5, 50.0, Kernel::gaussian, Par::Seq)?, None);
/// # Ok(())
/// # }
/// ```
pub fn wider_for_share<T: Scalar>(
    x: MatRef<'_, T>,
    nu: f64,
    share: f64,
    sigma: f64,
    kernel: impl Fn(f64) -> Result<Kernel, KernelError>,
    par: Par,
) -> Result<Option<f64>, DictionaryError> {
    check_nu(nu)?;
    let (least, most) = (TOO_NARROW * sigma, (share * x.ncols() as f64) as usize);
    if size_with(x, nu, kernel(least)?, most, par)? <= most {
        return Ok(None);
    }
    let wider = width_for_share(x, nu, share, kernel, par)?;
    Ok(Some(wider).filter(|&wider| wider >= least))
}

/// The width at which ALD with threshold `nu` keeps a `share` of the observations `x`: at least half their median distance.
///
/// A start where nothing else is known; it needs no more than some hundred observations.
///
/// # Shapes
/// `x: d × n`.
///
/// # Errors
/// ν not positive; observations that are all equal, fewer than two, or not finite.
///
/// # Example
/// ```
/// use adagio::dictionary::width_for_share;
/// use adagio::kernel::Kernel;
/// use faer::{Mat, Par};
///
/// # fn main() -> Result<(), adagio::dictionary::DictionaryError> {
/// // Few points span a line up to √ν: half the median distance of its points is wide enough.
/// let line = Mat::from_fn(1, 201, |_, t| t as f64 / 200.0);
/// let sigma = width_for_share(line.as_ref(), 0.01, 0.65, Kernel::gaussian, Par::Seq)?;
/// assert!((sigma - 0.5 * (1.0 - 0.5f64.sqrt())).abs() < 0.01);
/// # Ok(())
/// # }
/// ```
pub fn width_for_share<T: Scalar>(
    x: MatRef<'_, T>,
    nu: f64,
    share: f64,
    kernel: impl Fn(f64) -> Result<Kernel, KernelError>,
    par: Par,
) -> Result<f64, DictionaryError> {
    let median = median_distance(x)?;
    let target = ((share * x.ncols() as f64).round() as usize).max(1);
    let sigma = match width_for_size(x, nu, target, kernel, par) {
        Ok(found) => found.sigma,
        // So many observations do not differ at all.
        Err(DictionaryError::Target { .. }) => 0.0,
        Err(other) => return Err(other),
    };
    Ok(sigma.max(NARROWEST * median))
}
