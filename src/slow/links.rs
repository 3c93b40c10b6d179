//! How the frames of a signal follow each other: regular sampling, time stamps, gaps, restarts.

use super::error::SlowError;

/// The most links that are made at once: they take 24 GiB, and the frames themselves much more.
const MOST_LINKS: usize = 1 << 30;

/// How a frame follows the one before it.
///
/// A slow feature is judged by its derivative `ẏ = (y_t − y_{t−1})/Δt`. Each frame carries a [`Link`] to the frame before
/// it, or `None` where it follows no other: at the very start, after a gap, a restart or a teleport. No derivative is
/// taken there, so a jump costs nothing.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Link {
    /// Time since the frame before it, in seconds (or any unit, kept throughout); > 0.
    pub dt: f64,
    /// Weight `g` of this derivative, ≥ 0.
    pub weight: f64,
}

impl Link {
    /// Links of `n` frames sampled without a gap, one every `dt`.
    ///
    /// # Errors
    /// `dt` not positive or not finite, more than 2³⁰ frames.
    ///
    /// ```
    /// # fn main() -> Result<(), adagio::slow::SlowError> {
    /// use adagio::slow::Link;
    /// let links = Link::regular(3, 0.04)?;
    /// assert_eq!(links, [None, Some(Link { dt: 0.04, weight: 1.0 }), Some(Link { dt: 0.04, weight: 1.0 })]);
    /// # Ok(())
    /// # }
    /// ```
    pub fn regular(n: usize, dt: f64) -> Result<Vec<Option<Link>>, SlowError> {
        Link::sequences(&[n], dt)
    }

    /// Links of several sequences one after the other, each sampled every `dt`; none of them follows another.
    ///
    /// # Errors
    /// `dt` not positive or not finite, more than 2³⁰ frames.
    pub fn sequences(lengths: &[usize], dt: f64) -> Result<Vec<Option<Link>>, SlowError> {
        let link = Link { dt, weight: 1.0 };
        check_links(&[Some(link)])?;
        let frames = lengths.iter().fold(0usize, |sum, &n| sum.saturating_add(n));
        if frames > MOST_LINKS {
            return Err(SlowError::TooMany { what: "links", asked: frames, most: MOST_LINKS });
        }
        Ok(lengths.iter().flat_map(|&n| (0..n).map(move |t| (t > 0).then_some(link))).collect())
    }

    /// Links of frames with time stamps; a frame that comes more than `longest_gap` after the one before it follows none.
    ///
    /// # Errors
    /// Time stamps that are not finite or do not ascend, `longest_gap` not positive (infinity is allowed: no gap at all).
    ///
    /// ```
    /// # fn main() -> Result<(), adagio::slow::SlowError> {
    /// use adagio::slow::Link;
    /// let links = Link::at_times(&[0.0, 0.5, 0.75, 9.0], 1.0)?;
    /// let dt: Vec<Option<f64>> = links.iter().map(|link| link.map(|link| link.dt)).collect();
    /// assert_eq!(dt, [None, Some(0.5), Some(0.25), None]);
    /// # Ok(())
    /// # }
    /// ```
    pub fn at_times(times: &[f64], longest_gap: f64) -> Result<Vec<Option<Link>>, SlowError> {
        if longest_gap.is_nan() || longest_gap <= 0.0 {
            return Err(SlowError::Gap(longest_gap));
        }
        let mut links = vec![None; times.len().min(1)];
        if let Some(first) = times.first()
            && !first.is_finite()
        {
            return Err(SlowError::Link { at: 0, dt: *first, weight: 1.0 });
        }
        for (t, pair) in times.windows(2).enumerate() {
            let link = Link { dt: pair[1] - pair[0], weight: 1.0 };
            if !link.is_possible() {
                return Err(SlowError::Link { at: t + 1, dt: link.dt, weight: 1.0 });
            }
            links.push((link.dt <= longest_gap).then_some(link));
        }
        Ok(links)
    }

    /// Whether it gives a finite derivative.
    fn is_possible(&self) -> bool {
        let time = self.dt > 0.0 && self.dt.is_finite() && (1.0 / self.dt).is_finite();
        time && self.weight >= 0.0 && self.weight.is_finite()
    }
}

/// Refuse links with an impossible time or weight.
pub(super) fn check_links(links: &[Option<Link>]) -> Result<(), SlowError> {
    links.iter().enumerate().try_for_each(|(at, &link)| check_link(at, link))
}

/// Refuse the link of one frame, number `at`, if its time or weight is impossible.
pub(super) fn check_link(at: usize, link: Option<Link>) -> Result<(), SlowError> {
    match link {
        Some(link) if !link.is_possible() => Err(SlowError::Link { at, dt: link.dt, weight: link.weight }),
        _ => Ok(()),
    }
}

/// Differences of a series over `lag` frames, as pairs `(later frame, link)`: Δt is the time between the two, the weight
/// the mean of the weights between them. A pair exists only where no gap lies between its frames.
pub(super) fn lagged(links: &[Option<Link>], lag: usize) -> Vec<(usize, Link)> {
    (lag..links.len())
        .filter_map(|t| {
            let mut sum = Link { dt: 0.0, weight: 0.0 };
            for link in &links[t + 1 - lag..=t] {
                let link = (*link)?;
                sum.dt += link.dt;
                sum.weight += link.weight / lag as f64;
            }
            Some((t, sum))
        })
        .collect()
}
