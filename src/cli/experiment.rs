//! `adagio experiment [NAME]`

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicBool;

use faer::Par;
use serde_json::json;

use super::{Ending, ExperimentArgs, print, print_json};
use crate::experiment::{self, Experiment, ExperimentError, Scope, Size, worlds};

/// Where experiments go unless `--out` says otherwise, each in a folder of its own.
const EXPERIMENTS: &str = "experiments";
/// Name of the folder of finished settings beside the results.
const CACHE: &str = "cache";

/// Name that stands for all of them.
const ALL: &str = "all";

/// Do an experiment, or all, or list them.
pub fn experiment(args: &ExperimentArgs, stop: &AtomicBool) -> Result<(), Ending> {
    let Some(name) = &args.name else { return list(args.json) };
    if name == ALL {
        return all(args, stop);
    }
    let (experiment, scope, out) = order(name, args)?;
    if !args.quiet {
        eprintln!(
            "{name} takes {} on two cores; finished settings are kept in {}",
            scope.pick(experiment.lasts),
            scope.cache.display()
        );
    }
    match experiment::run(experiment, &scope, &out, stop) {
        Ok((value, _)) if args.json => print_json(&value),
        Ok((_, text)) => print(&format!("{text}\nkept in {}\n", out.display())),
        Err(error @ (ExperimentError::Exists(_) | ExperimentError::Data { .. })) => Err(Ending::usage(error)),
        Err(error) => Err(error.into()),
    }
}

/// Do all experiments, and put their tables on one page. Those whose data are not there are left out.
fn all(args: &ExperimentArgs, stop: &AtomicBool) -> Result<(), Ending> {
    if args.world.is_some() {
        return Err(Ending::usage("--world: all experiments have all of their worlds"));
    }
    let out = args.out.clone().unwrap_or_else(|| next(&Path::new(EXPERIMENTS).join(ALL)));
    if out.exists() {
        return Err(Ending::usage(ExperimentError::Exists(out)));
    }
    // It is whole or not there: what is stopped goes on from the settings that are kept.
    let part = experiment::part_of(&out);
    let orders = experiment::ALL.iter().map(|experiment| {
        let data = if takes_data(experiment.name) { args.data.clone() } else { Vec::new() };
        let cache = args.cache.as_ref().map(|folder| folder.join(experiment.name));
        order(experiment.name, &ExperimentArgs { data, cache, out: Some(part.join(experiment.name)), ..args.clone() })
    });
    let mut orders: Vec<_> = orders.collect::<Result<_, _>>()?;
    if !args.quiet {
        let seeds = args.seeds.len();
        eprintln!("on two cores{}:", if seeds > 1 { format!(", for each of {seeds} seeds") } else { String::new() });
        orders.iter().for_each(|(of, scope, _)| eprintln!("  {}: {}", of.name, scope.pick(of.lasts)));
        eprintln!("after Ctrl-C the same command goes on from what is kept");
    }
    // Data that are not there are told at the beginning, and not after hours.
    orders.sort_by_key(|(experiment, ..)| !takes_data(experiment.name));
    let mut left_out = Vec::new();
    let mut values = BTreeMap::new();
    for (number, (experiment, scope, out)) in orders.iter().enumerate() {
        if !args.quiet {
            eprintln!("{} ({} of {})", experiment.name, number + 1, orders.len());
        }
        match experiment::run(experiment, scope, out, stop) {
            Ok((value, _)) => drop(values.insert(experiment.name, value)),
            Err(error @ ExperimentError::Data { .. }) => {
                eprintln!("{} is left out: {error}", experiment.name);
                left_out.push(experiment.name);
            }
            Err(error) => {
                let _ = std::fs::remove_dir_all(&part);
                return Err(error.into());
            }
        }
    }
    let done: Vec<&str> = experiment::ALL.iter().map(|of| of.name).filter(|name| values.contains_key(name)).collect();
    let page = experiment::page(&part, &done)?;
    std::fs::rename(&part, &out).map_err(|cause| format!("cannot create the folder {}: {cause}", out.display()))?;
    if args.json {
        print_json(&done.iter().map(|name| &values[name]).collect::<Vec<_>>())?;
    } else {
        print(&format!("{page}\nkept in {}\n", out.display()))?;
    }
    if left_out.is_empty() { Ok(()) } else { Err(Ending::usage(format!("left out: {}", left_out.join(", ")))) }
}

/// Whether an experiment reads data of others.
fn takes_data(name: &str) -> bool {
    ["digits", "receptive-fields"].contains(&name)
}

/// What is to be done, and the folder for the results.
///
/// # Errors
/// There is no such experiment, or it does not have what is asked for.
pub fn order(name: &str, args: &ExperimentArgs) -> Result<(&'static Experiment, Scope, PathBuf), Ending> {
    let experiment = experiment::find(name).map_err(Ending::usage)?;
    if let Some(world) = &args.world {
        if name != "worlds" {
            return Err(Ending::usage(format!(
                "--world: the experiment {name} has one world; only worlds has several"
            )));
        }
        if !worlds::names().any(|known| known == world) {
            let known: Vec<&str> = worlds::names().collect();
            return Err(Ending::usage(format!("there is no world {world:?}; there are {}", known.join(", "))));
        }
    }
    if !args.data.is_empty() && !takes_data(name) {
        return Err(Ending::usage(format!(
            "--data: the experiment {name} takes no data of others; digits and receptive-fields do"
        )));
    }
    let size = match (args.quick, args.smoke) {
        (true, true) => return Err(Ending::usage("quick and smoke are two sizes: one of them")),
        (true, false) => Size::Quick,
        (false, true) => Size::Smoke,
        (false, false) => Size::Full,
    };
    let folder = Path::new(EXPERIMENTS).join(name);
    let scope = Scope {
        size,
        vectors: args.vectors.map(within).transpose().map_err(Ending::usage)?,
        seeds: args.seeds.clone(),
        world: args.world.clone(),
        data: args.data.clone(),
        par: args
            .threads
            .map_or(Par::rayon(0), |threads| if threads == 1 { Par::Seq } else { Par::rayon(threads.into()) }),
        cache: args.cache.clone().unwrap_or_else(|| folder.join(CACHE)),
        quiet: args.quiet,
    };
    Ok((experiment, scope, args.out.clone().unwrap_or_else(|| next(&folder))))
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
    let path = |number: u64| folder.join(format!("{number:03}"));
    (1..).map(path).find(|path| !path.exists()).expect("there are fewer folders than numbers")
}

/// A number of support vectors.
pub fn vectors(text: &str) -> Result<usize, String> {
    within(text.parse().map_err(|error| format!("{text:?} is no number: {error}"))?)
}

fn within(vectors: usize) -> Result<usize, String> {
    if (20..=20_000).contains(&vectors) {
        Ok(vectors)
    } else {
        Err(format!("{vectors} support vectors are not within 20 to 20 000"))
    }
}
