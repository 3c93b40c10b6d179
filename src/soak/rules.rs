//! When a long run is a good one: nothing grows without end, nothing is lost, and what was learned stays.

use serde::Serialize;

use super::Sample;
use crate::agent::CurvePoint;

/// Share of the run after which memory, files and rates should have settled.
const WARM_UP: f64 = 0.25;
/// Memory may grow by this factor after that.
const MEMORY: f64 = 1.5;
/// The log may grow this much faster at the end than after the warm-up.
const LOG_RATE: f64 = 1.2;
/// Success may stay this much below what it was before.
const SUCCESS: f64 = 0.05;

/// A rule, and whether it holds.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct CheckedRule {
    /// What should be so.
    pub rule: String,
    /// Whether it is.
    pub holds: bool,
    /// The figures.
    pub measured: String,
}

impl CheckedRule {
    fn new(rule: String, holds: bool, measured: String) -> Self {
        CheckedRule { rule, holds, measured }
    }
}

/// Judge a run by its samples, by its evaluations with the hour of each, by what is wrong with its log, by the number of frames
/// that the scenario itself lost, and by the hours at which it changed something.
pub fn check_rules(
    samples: &[Sample],
    curve: &[(f64, CurvePoint)],
    damage: &[String],
    lost_on_purpose: u64,
    changes: &[f64],
) -> Vec<CheckedRule> {
    let hours = samples.last().map_or(0.0, |sample| sample.hours);
    let warm = samples.iter().position(|sample| sample.hours >= WARM_UP * hours).unwrap_or(0);
    let settled = &samples[warm.min(samples.len())..];
    let mut rules = Vec::new();
    rules.extend(memory(settled));
    rules.extend(open_files(settled));
    rules.extend(log_rate(settled));
    rules.push(nothing_lost(samples, damage, lost_on_purpose));
    rules.push(models(curve, hours));
    rules.extend(success(curve, hours, changes));
    rules
}

/// Memory rises and falls with every model that is made, so the highest of many samples is compared with that of many.
fn memory(settled: &[Sample]) -> Option<CheckedRule> {
    let (second, later) = settled.split_at(settled.len() / 3);
    let most = |samples: &[Sample]| samples.iter().filter_map(|sample| sample.rss_bytes).max();
    let (second, later) = (most(second)? as f64, most(later)? as f64);
    let rule = format!("memory stays within {MEMORY} times its highest in the second quarter");
    let measured = format!("{:.0} MB then, {:.0} MB later: {:.2} times", second / 1e6, later / 1e6, later / second);
    Some(CheckedRule::new(rule, later <= MEMORY * second, measured))
}

fn open_files(settled: &[Sample]) -> Option<CheckedRule> {
    let (early, late) = settled.split_at(settled.len() / 2);
    let most = |samples: &[Sample]| samples.iter().filter_map(|sample| sample.open_files).max();
    let (early, late) = (most(early)?, most(late)?);
    // A file that is being closed while the next one is open, a checkpoint that is being written.
    let holds = late <= early + 3;
    Some(CheckedRule::new("open files do not add up".into(), holds, format!("at most {early} early, {late} late")))
}

fn log_rate(settled: &[Sample]) -> Option<CheckedRule> {
    // Without the last sample: what was learned is attached at the end.
    let settled = &settled[..settled.len().saturating_sub(1)];
    let (early, late) = settled.split_at(settled.len() / 2);
    let rate = |samples: &[Sample]| {
        let (first, last) = (samples.first()?, samples.last()?);
        let hours = last.hours - first.hours;
        (hours > 0.0 && last.log_bytes >= first.log_bytes)
            .then(|| (last.log_bytes - first.log_bytes) as f64 / 1e6 / hours)
    };
    let (early, late) = (rate(early)?, rate(late)?);
    let measured = format!("{early:.1} MB an hour early, {late:.1} MB late");
    Some(CheckedRule::new("the log does not grow faster and faster".into(), late <= LOG_RATE * early, measured))
}

fn nothing_lost(samples: &[Sample], damage: &[String], lost_on_purpose: u64) -> CheckedRule {
    let dropped = samples.last().map_or(0, |sample| sample.dropped);
    let mut measured = match lost_on_purpose {
        0 => format!("{dropped} frames dropped"),
        of => format!("{dropped} frames dropped, {of} of them as the scenario wants"),
    };
    if damage.is_empty() {
        measured += ", the log is whole";
    } else {
        measured += &format!(", {}", damage.join(", "));
    }
    CheckedRule::new("nothing is lost".into(), dropped == lost_on_purpose && damage.is_empty(), measured)
}

fn models(curve: &[(f64, CurvePoint)], hours: f64) -> CheckedRule {
    let late = curve.iter().filter(|(hour, _)| *hour >= 0.75 * hours).count();
    let measured = format!("{} evaluated models, {late} of them in the last quarter", curve.len());
    CheckedRule::new("models are made to the end".into(), late > 0, measured)
}

/// Success of the last models against that of models before: before the first change if there is any, else the second quarter.
fn success(curve: &[(f64, CurvePoint)], hours: f64, changes: &[f64]) -> Option<CheckedRule> {
    let mean = |from: f64, to: f64| {
        let inside = curve.iter().filter(|(hour, _)| (from..to).contains(hour)).map(|(_, point)| point.success);
        let (sum, count) = inside.fold((0.0, 0), |(sum, count), success| (sum + success, count + 1));
        (count > 0).then(|| sum / f64::from(count))
    };
    let change = changes.iter().copied().fold(f64::INFINITY, f64::min);
    let (before, name) = if change < hours {
        (mean(0.5 * change, change)?, "before the first change")
    } else {
        (mean(0.25 * hours, 0.5 * hours)?, "in the second quarter")
    };
    let after = mean(0.75 * hours, f64::INFINITY)?;
    let mut measured = format!("{:.1} % {name}, {:.1} % in the last quarter", 100.0 * before, 100.0 * after);
    if change < hours {
        let behind = curve.iter().filter(|(hour, _)| *hour >= change).map(|(_, point)| point.success);
        measured += &format!(", {:.1} % at worst in between", 100.0 * behind.fold(1.0, f64::min));
    }
    let rule = format!("success does not fall by more than {} %, or comes back", 100.0 * SUCCESS);
    Some(CheckedRule::new(rule, after >= before - SUCCESS, measured))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn samples(change: impl Fn(usize, &mut Sample)) -> Vec<Sample> {
        let sample = |i: usize| {
            let mut sample = Sample {
                hours: 0.1 * i as f64,
                seconds: i as f64,
                frames: 100 * i as u64,
                frames_per_second: 100.0,
                rss_bytes: Some(1_000_000_000),
                open_files: Some(12),
                log_bytes: 1_000_000 * i as u64,
                queues: Vec::new(),
                act_p99_ms: 0.1,
                frame_p99_ms: 1.0,
                support_vectors: 100,
                epoch: 1,
                dropped: 0,
            };
            change(i, &mut sample);
            sample
        };
        (0..=100).map(sample).collect()
    }

    fn curve(success: impl Fn(f64) -> f64) -> Vec<(f64, CurvePoint)> {
        let point = |i: u32| {
            let hour = 0.5 * f64::from(i);
            let point = CurvePoint {
                frames: 0,
                actions: 0,
                support_vectors: 0,
                success: success(hour),
                convergence_quality: 0.9,
                slowness_mean: 1.0,
                feature_drift_deg: None,
            };
            (hour, point)
        };
        (0..=20).map(point).collect()
    }

    fn failing(rules: &[CheckedRule]) -> Vec<&str> {
        rules.iter().filter(|rule| !rule.holds).map(|rule| rule.rule.as_str()).collect()
    }

    #[test]
    fn a_steady_run_passes_and_each_fault_fails_its_own_rule() {
        let steady = samples(|_, _| {});
        let good = curve(|_| 0.98);
        assert_eq!(failing(&check_rules(&steady, &good, &[], 0, &[])), Vec::<&str>::new());
        let cases = [
            (samples(|i, s| s.rss_bytes = Some(1_000_000_000 + 20_000_000 * i as u64)), good.clone(), "memory"),
            (samples(|i, s| s.open_files = Some(12 + i / 4)), good.clone(), "open files"),
            (samples(|i, s| s.log_bytes = 1000 * (i as u64).pow(2)), good.clone(), "the log does not"),
            (samples(|i, s| s.dropped = i as u64 / 50), good.clone(), "nothing is lost"),
            (steady.clone(), good[..10].to_vec(), "models are made"),
            (steady.clone(), curve(|hour| if hour > 7.0 { 0.8 } else { 0.98 }), "success"),
        ];
        for (samples, curve, rule) in cases {
            let rules = check_rules(&samples, &curve, &[], 0, &[]);
            let failed = failing(&rules);
            assert!(failed.len() == 1 && failed[0].starts_with(rule), "{rule}: {failed:?}");
        }
        let damage = ["run_001.mcap is not whole".to_owned()];
        assert_eq!(failing(&check_rules(&steady, &good, &damage, 0, &[])), ["nothing is lost"]);
    }

    #[test]
    fn a_dip_after_a_change_is_allowed_if_success_comes_back() {
        let steady = samples(|_, _| {});
        let dip = |back: f64| curve(move |hour| if (5.0..back).contains(&hour) { 0.4 } else { 0.98 });
        let rules = check_rules(&steady, &dip(6.0), &[], 0, &[5.0]);
        assert!(failing(&rules).is_empty(), "{rules:?}");
        assert!(rules.iter().any(|rule| rule.measured.contains("40.0 % at worst")), "{rules:?}");
        assert_eq!(failing(&check_rules(&steady, &dip(11.0), &[], 0, &[5.0])).len(), 1);
        // Frames that the scenario loses are not lost by the agent.
        let lossy = samples(|i, s| s.dropped = if i > 50 { 40 } else { 0 });
        assert!(failing(&check_rules(&lossy, &dip(6.0), &[], 40, &[5.0])).is_empty());
    }
}
