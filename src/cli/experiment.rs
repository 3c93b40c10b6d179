//! `adagio experiment [NAME]`

use std::ops::RangeInclusive;
use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicBool;

use faer::Par;
use serde_json::json;

use super::{Ending, ExperimentArgs, print, print_json};
use crate::experiment::{self, ExperimentError, Scope, Size};

/// Where experiments go unless `--out` says otherwise, each in a folder of its own.
const EXPERIMENTS: &str = "experiments";
/// Name of the folder of finished settings beside the results.
const CACHE: &str = "cache";

/// Do an experiment, or list them.
pub fn experiment(args: &ExperimentArgs, stop: &AtomicBool) -> Result<(), Ending> {
    let Some(name) = &args.name else { return list(args.json) };
    let experiment = experiment::find(name).map_err(Ending::usage)?;
    if args.world.is_some() && name != "worlds" {
        return Err(Ending::usage(format!("--world: the experiment {name} has one world; only worlds has several")));
    }
    let size = match (args.quick, args.smoke) {
        (_, true) => Size::Smoke,
        (true, _) => Size::Quick,
        _ => Size::Full,
    };
    let folder = Path::new(EXPERIMENTS).join(name);
    let scope = Scope {
        size,
        vectors: args.vectors,
        seeds: args.seeds.clone(),
        world: args.world.clone(),
        par: args
            .threads
            .map_or(Par::rayon(0), |threads| if threads == 1 { Par::Seq } else { Par::rayon(threads.into()) }),
        cache: args.cache.clone().unwrap_or_else(|| folder.join(CACHE)),
        out: args.out.clone().unwrap_or_else(|| next(&folder)),
        quiet: args.quiet,
    };
    if !args.quiet {
        eprintln!(
            "{name} takes {} on two cores; finished settings are kept in {}",
            scope.pick(experiment.lasts),
            scope.cache.display()
        );
    }
    match experiment::run(experiment, &scope, stop) {
        Ok((value, _)) if args.json => print_json(&value),
        Ok((_, text)) => print(&format!("{text}\nkept in {}\n", scope.out.display())),
        Err(error @ ExperimentError::Exists(_)) => Err(Ending::usage(error)),
        Err(error) => Err(error.into()),
    }
}

fn list(as_json: bool) -> Result<(), Ending> {
    if as_json {
        let entry = |experiment: &experiment::Experiment| {
            json!({
                "name": experiment.name,
                "shows": experiment.line,
                "lasts": { "full": experiment.lasts.full, "quick": experiment.lasts.quick },
            })
        };
        return print_json(&experiment::ALL.iter().map(entry).collect::<Vec<_>>());
    }
    let width = experiment::ALL.iter().map(|experiment| experiment.name.len()).max().unwrap_or(0);
    let mut text = String::new();
    for experiment in experiment::ALL {
        let lasts = format!("{} on two cores; --quick: {}", experiment.lasts.full, experiment.lasts.quick);
        text += &format!("{:<width$}  {}\n{:<width$}  ({lasts})\n", experiment.name, experiment.line, "");
    }
    print(&text)
}

/// The first folder under an experiment's own that is not there yet: 001, 002, …
fn next(folder: &Path) -> PathBuf {
    let mut number = 1;
    loop {
        let path = folder.join(format!("{number:03}"));
        if !path.exists() {
            return path;
        }
        number += 1;
    }
}

/// A number of support vectors.
pub fn vectors(text: &str) -> Result<usize, String> {
    let number: usize = text.parse().map_err(|error| format!("{text:?} is no number: {error}"))?;
    if (20..=20_000).contains(&number) { Ok(number) } else { Err(format!("{number} is not within 20 to 20 000")) }
}

/// Seeds from `A..B`, both included, or one seed.
pub fn seeds(text: &str) -> Result<RangeInclusive<u64>, String> {
    let number = |text: &str| text.trim().parse::<u64>().map_err(|error| format!("{text:?} is no seed: {error}"));
    let (first, last) = match text.split_once("..") {
        Some((first, last)) => (number(first)?, number(last.strip_prefix('=').unwrap_or(last))?),
        None => (number(text)?, number(text)?),
    };
    if first > last {
        return Err(format!("{first} to {last} are no seeds: the first must not be above the last"));
    }
    if last - first >= MOST_SEEDS {
        return Err(format!("{first} to {last} are more than {MOST_SEEDS} seeds"));
    }
    Ok(first..=last)
}

/// More seeds than this are a slip of the keyboard.
const MOST_SEEDS: u64 = 1000;

#[cfg(test)]
mod tests {
    use super::seeds;

    #[test]
    fn seeds_are_a_range_with_both_ends() {
        assert_eq!(seeds("11..13"), Ok(11..=13));
        assert_eq!(seeds("11..=13"), Ok(11..=13));
        assert_eq!(seeds("7"), Ok(7..=7));
        for wrong in ["", "a", "3..1", "1..5000", "1..", "-1..2"] {
            assert!(seeds(wrong).is_err(), "{wrong}");
        }
    }
}
