//! Tables and plots of `pose-lspi`, and what the thesis says of them.

use super::super::plot::{Line, chart};
use super::super::quality::Quality;
use super::super::{Band, Cell, ExperimentError, Table};
use super::{CONDITIONS, Fitted, Found, Kind, REGIME, VARIANTS, Variants};
use crate::report::draw::Axis;

/// What was found, for showing it.
pub struct Findings {
    /// By kind of transitions, training set and number of features.
    pub found: Found,
    /// Transitions of the training sets.
    pub sets: [usize; 2],
    /// Discount.
    pub gamma: f64,
}

/// What steps more are counted against: qualities.
const REFERENCE: fn(&Quality) -> f64 = |quality| quality.to_reference;
const OPTIMUM: fn(&Quality) -> f64 = |quality| quality.quality;

fn band(fitted: &[Fitted], of: impl Fn(&Quality) -> Option<f64>) -> Option<Band> {
    Band::of(fitted.iter().filter_map(|fitted| of(&fitted.quality)))
}

/// Standard deviation of the quality over first policies, within each seed.
fn deviation([drawn, uniform, _]: &Variants) -> Option<f64> {
    let seeds = drawn.chunks(drawn.len().checked_div(uniform.len())?.max(1));
    let variance = |seed: &[Fitted]| Some(band(seed, |quality| Some(quality.quality))?.deviation.powi(2));
    Some(Band::of(seeds.filter_map(variance))?.mean.sqrt())
}

fn converged(fitted: &[Fitted]) -> f64 {
    fitted.iter().filter(|fitted| fitted.converged).count() as f64 / fitted.len().max(1) as f64
}

impl Findings {
    /// Steps more than the reference policy or the optimum, as the thesis plots them: from the mean of that quality.
    fn more(&self, fitted: &[Fitted], than: fn(&Quality) -> f64) -> Option<f64> {
        let mean = band(fitted, |quality| Some(than(quality)))?.mean;
        (mean > 0.0).then(|| mean.ln() / self.gamma.ln())
    }

    /// The longest range of feature numbers in which a variant needs less than a step more.
    fn regime(&self, (kind, set, variant): (Kind, usize, usize), than: fn(&Quality) -> f64) -> Option<(usize, usize)> {
        let mut longest: Option<(usize, usize, usize)> = None;
        let mut here: Option<(usize, usize, usize)> = None;
        for (&(_, _, d), variants) in self.found.iter().filter(|((k, s, _), _)| (*k, *s) == (kind, set)) {
            here = match (self.more(&variants[variant], than), here) {
                (Some(more), before) if more < 1.0 => {
                    Some(before.map_or((d, d, 1), |(first, _, count)| (first, d, count + 1)))
                }
                _ => None,
            };
            if here.map(|range| range.2) > longest.map(|range| range.2) {
                longest = here;
            }
        }
        longest.map(|(first, last, _)| (first, last))
    }

    /// The smallest number of features at which the quality depends on the first policy.
    fn unstable_from(&self, kind: Kind, set: usize) -> Option<usize> {
        let of_set = self.found.iter().filter(|((k, s, _), _)| (*k, *s) == (kind, set));
        let unstable = |variants: &Variants| deviation(variants).is_some_and(|deviation| deviation > UNSTABLE);
        of_set.filter(|(_, variants)| unstable(variants)).map(|((_, _, d), _)| *d).next()
    }

    /// Where policies work, and from where on they depend on the first policy.
    pub fn regimes(&self) -> Table {
        let title = "Numbers of features with less than one step more than the reference policy; from where on the quality depends on the first policy";
        let mut table = Table::new(title);
        for (kind, set) in Kind::ALL.into_iter().flat_map(|kind| [(kind, 0), (kind, 1)]) {
            let drawn = self.regime((kind, set, 0), REFERENCE);
            for (variant, name) in VARIANTS.iter().enumerate() {
                let found = self.regime((kind, set, variant), REFERENCE);
                let unstable = self.unstable_from(kind, set);
                let number = |number: Option<usize>| number.map_or(Cell::Empty, Cell::count);
                let of_drawn = |of: Option<usize>| number(of.filter(|_| variant == 0));
                let row = [
                    ("kind", Cell::text(kind.name())),
                    ("transitions", Cell::count(self.sets[set])),
                    ("first policy", Cell::text(*name)),
                    ("from features", number(found.map(|range| range.0))),
                    ("to features", number(found.map(|range| range.1))),
                    ("thesis: from", of_drawn(Some(REGIME[set].0))),
                    ("thesis: to", of_drawn(Some(REGIME[set].1))),
                    ("unstable from", of_drawn(unstable)),
                    ("thesis: unstable beyond", of_drawn(Some(REGIME[set].1))),
                ];
                let mut says = says_of_regime(variant, found, drawn, REGIME[set]);
                if variant == 0 {
                    says += if unstable.is_some() {
                        "; agrees: unstable with many features"
                    } else {
                        "; differs: never unstable"
                    };
                }
                table.push(row, says);
            }
        }
        table
    }

    /// All numbers of one kind of transitions.
    pub fn table(&self, kind: Kind) -> Table {
        let mut table = Table::new(format!("Policies by number of features, transitions {}", kind.name()));
        for (&(_, set, d), variants) in self.found.iter().filter(|((k, _, _), _)| *k == kind) {
            let over_first_policies = deviation(variants);
            for (variant, name) in VARIANTS.iter().enumerate() {
                let fitted = &variants[variant];
                let more = self.more(fitted, REFERENCE);
                let inside = variant == 0 && (REGIME[set].0..=REGIME[set].1).contains(&d);
                let row = [
                    ("transitions", Cell::count(self.sets[set])),
                    ("features", Cell::count(d)),
                    ("first policy", Cell::text(*name)),
                    ("settled", Cell::Number(converged(fitted), 2)),
                    ("success", Cell::band(band(fitted, |quality| Some(quality.success)), 3)),
                    ("quality", Cell::band(band(fitted, |quality| Some(quality.quality)), 3)),
                    ("deviation", Cell::maybe(over_first_policies.filter(|_| variant == 0), 3)),
                    ("more than the reference", Cell::maybe(more, 2)),
                    ("thesis: more than the reference", if inside { Cell::text("< 1") } else { Cell::Empty }),
                ];
                let unstable = over_first_policies.is_some_and(|deviation| deviation > UNSTABLE);
                table.push(row, says(variant, d, REGIME[set], more, unstable));
            }
        }
        table
    }

    /// Quality and steps by number of features.
    pub fn plots(&self) -> Result<Vec<(String, String)>, ExperimentError> {
        let lines = |kind: Kind, of: &dyn Fn(&Quality) -> Option<f64>| {
            let mut lines = Vec::new();
            for (set, n) in self.sets.iter().enumerate() {
                for (variant, name) in VARIANTS.iter().enumerate() {
                    let of_set = self.found.iter().filter(|((k, s, _), _)| (*k, *s) == (kind, set));
                    let points = of_set.map(|(&(_, _, d), variants)| (d as f64, band(&variants[variant], of)));
                    let line = Line::new(format!("{name}, n = {n}"), variant, points);
                    lines.push(if set == 1 { line.dashed() } else { line });
                }
            }
            lines
        };
        let x = Axis::log("features d");
        let mut plots = Vec::new();
        for kind in Kind::ALL {
            let name = if kind == Kind::Thesis { "thesis" } else { "blocked" };
            plots.push(chart(
                &format!("quality-{name}.svg"),
                &format!("Convergence quality, transitions {}", kind.name()),
                (&x, &Axis::new("quality C against the optimum").within(0.0, 1.0)),
                &lines(kind, &|quality| Some(quality.quality)),
            )?);
            plots.push(chart(
                &format!("steps-{name}.svg"),
                &format!("Steps more than the reference policy, transitions {}", kind.name()),
                (&x, &Axis::new("log_γ C against the reference").within(-1.5, 8.0)),
                &lines(kind, &|quality| quality.more_than_reference),
            )?);
        }
        Ok(plots)
    }
}

/// Steps more than the optimum with the thesis's working numbers of features, under each condition and from both first policies; and
/// with which numbers it is less than one.
///
/// The optimum, not the reference policy: where that takes eighty steps along a wall, one start counts as thousands.
pub fn conditions(first: &Findings, others: &[Findings], regime: &[usize]) -> Table {
    let title = format!(
        "What decides whether {} to {} features work: steps more than the optimum, transitions {}",
        REGIME[0].0,
        REGIME[0].1,
        Kind::Thesis.name()
    );
    let mut table = Table::new(title);
    for (found, (what, _, _, whole)) in std::iter::once(first).chain(others).zip(CONDITIONS) {
        let steps_of = |variant: usize| -> Vec<Option<f64>> {
            let of = |d: &usize| found.more(&found.found.get(&(Kind::Thesis, 0, *d))?[variant], OPTIMUM);
            regime.iter().map(of).collect()
        };
        let drawn = steps_of(0);
        for variant in [0, 1] {
            let steps = steps_of(variant);
            let fitted = regime.iter().filter_map(|d| found.found.get(&(Kind::Thesis, 0, *d)));
            let success = Band::of(fitted.flat_map(|of| &of[variant]).map(|fitted| fitted.quality.success));
            let works = match found.regime((Kind::Thesis, 0, variant), OPTIMUM) {
                _ if !whole => Cell::Empty,
                Some((from, to)) => Cell::text(format!("{from} to {to}")),
                None => Cell::text("none"),
            };
            let mut row = vec![
                ("condition".into(), Cell::text(what)),
                ("first policy".into(), Cell::text(VARIANTS[variant])),
                ("success, mean of these".into(), Cell::maybe(success.map(|band| band.mean), 3)),
            ];
            row.extend(regime.iter().zip(&steps).map(|(d, more)| (format!("{d} features"), Cell::maybe(*more, 2))));
            row.push(("works from, to".into(), works));
            let below = steps.iter().flatten().filter(|&&more| more < 1.0).count();
            let is_better = |(more, drawn): &(&Option<f64>, &Option<f64>)| {
                more.zip(**drawn).is_some_and(|(more, drawn)| more + 0.5 < drawn)
            };
            let better = steps.iter().zip(&drawn).filter(is_better).count();
            let verdict = match (variant, below) {
                (0, 0) => "differs: nowhere less than a step more".to_owned(),
                (0, all) if all == steps.len() => "agrees: less than a step more".to_owned(),
                (0, some) => format!("agrees with {some} of {}", steps.len()),
                _ => format!("half a step better than from drawn actions, or more, with {better} of {}", steps.len()),
            };
            table.push(row, verdict);
        }
    }
    table
}

/// A standard deviation of the quality over first policies above which it depends on them.
const UNSTABLE: f64 = 0.05;

fn says_of_regime(
    variant: usize,
    found: Option<(usize, usize)>,
    drawn: Option<(usize, usize)>,
    (first, last): (usize, usize),
) -> String {
    match (variant, found, drawn) {
        (0, None, _) => "differs: there is none".into(),
        (0, Some((from, to)), _) => {
            let begin = if from <= first { "agrees at its beginning" } else { "differs: it begins later" };
            let end = if to > last { "differs: it ends later" } else { "agrees at its end" };
            format!("{begin}; {end}")
        }
        (1, Some(found), Some(drawn)) => {
            let times = found.1 as f64 / drawn.1 as f64;
            let verdict = if times >= 1.5 { "agrees" } else { "differs" };
            format!("{verdict}: {times:.1} times as far as from drawn actions (thesis: about twice)")
        }
        (1, _, _) => "differs: there is none to compare (thesis: about twice that of drawn actions)".into(),
        _ => "not in the thesis".into(),
    }
}

fn says(variant: usize, d: usize, (first, last): (usize, usize), more: Option<f64>, unstable: bool) -> String {
    if variant != 0 {
        return if variant == 1 { "no number in its text" } else { "not in the thesis" }.into();
    }
    let below = more.is_some_and(|more| more < 1.0);
    match (d < first, d <= last, below, unstable) {
        (true, _, _, _) => "no number in its text",
        (_, true, true, _) => "agrees: less than one step more",
        (_, true, false, _) => "differs: a step or more",
        (_, false, _, true) => "agrees: depends on the first policy",
        (_, false, true, false) => "differs: it still works, whatever the first policy",
        (_, false, false, false) => "agrees that it is worse; differs: not for the first policy's sake",
    }
    .into()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn fitted(to_reference: f64) -> Vec<Fitted> {
        let quality =
            Quality { success: 1.0, steps: None, extra: None, quality: 0.9, to_reference, more_than_reference: None };
        vec![Fitted { iterations: 3, converged: true, quality }]
    }

    #[test]
    fn the_deviation_is_that_over_first_policies_and_not_over_seeds() {
        let of = |qualities: &[f64]| -> Vec<Fitted> {
            let quality = |&quality: &f64| Quality { quality, ..fitted(0.5)[0].quality };
            qualities.iter().map(|q| Fitted { quality: quality(q), ..fitted(0.5)[0].clone() }).collect()
        };
        let over = |drawn: &[f64]| deviation(&[of(drawn), of(&[0.2, 0.8]), Vec::new()]).unwrap();
        assert!(over(&[0.2, 0.2, 0.8, 0.8]) < 1e-12);
        assert!((over(&[0.2, 0.8, 0.2, 0.8]) - 0.18f64.sqrt()).abs() < 1e-12);
    }

    #[test]
    fn the_regime_is_the_longest_range_below_one_step() {
        let at = |good: bool| [fitted(if good { 0.95 } else { 0.5 }), Vec::new(), Vec::new()];
        let good = [(10, false), (20, true), (30, true), (40, false), (50, true)];
        let found = good.into_iter().map(|(d, good)| ((Kind::Blocked, 0, d), at(good))).collect();
        let shown = Findings { found, sets: [100, 50], gamma: 0.9 };
        let regime = |kind, set| shown.regime((kind, set, 0), REFERENCE);
        assert_eq!(regime(Kind::Blocked, 0), Some((20, 30)));
        assert_eq!((regime(Kind::Blocked, 1), regime(Kind::Thesis, 0)), (None, None));
        assert!((shown.more(&fitted(0.81), REFERENCE).unwrap() - 2.0).abs() < 1e-9);
    }
}
