//! The thesis's experiments: each runs end to end, keeps finished settings, overwrites nothing, and shows what it kept.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};
use std::time::{Duration, Instant};

use crate::common::{adagio, python, stderr, stdout};
use serde_json::Value;

/// The smallest version of an experiment in a folder of its own.
fn smoke(folder: &Path, name: &str, more: &[&str]) -> Output {
    adagio(folder, &[&["experiment", name, "--smoke"], more].concat())
}

fn json(path: &Path) -> Value {
    serde_json::from_str(&std::fs::read_to_string(path).unwrap()).unwrap()
}

fn files(folder: &Path) -> BTreeSet<PathBuf> {
    std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()).collect()
}

/// All numbers of a JSON value.
fn numbers(value: &Value, found: &mut Vec<f64>) {
    match value {
        Value::Number(number) => found.push(number.as_f64().unwrap()),
        Value::Array(values) => values.iter().for_each(|value| numbers(value, found)),
        Value::Object(values) => values.values().for_each(|value| numbers(value, found)),
        _ => {}
    }
}

fn names() -> Vec<String> {
    let folder = tempfile::tempdir().unwrap();
    let listed = adagio(folder.path(), &["experiment", "--json"]);
    let listed: Value = serde_json::from_slice(&listed.stdout).unwrap();
    listed.as_array().unwrap().iter().map(|entry| entry["name"].as_str().unwrap().to_owned()).collect()
}

#[test]
fn experiments_are_listed_and_an_unknown_one_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let list = adagio(folder.path(), &["experiment"]);
    assert!(list.status.success());
    for name in names() {
        assert!(stdout(&list).lines().any(|line| line.starts_with(&format!("{name} "))), "{name}");
    }
    let unknown = adagio(folder.path(), &["experiment", "pose-lpsi"]);
    assert_eq!(unknown.status.code(), Some(2));
    assert!(stderr(&unknown).contains("slowness, ") && stderr(&unknown).contains("did you mean pose-lspi?"));
    for wrong in [["--seeds", "5..3"], ["--vectors", "7"], ["--threads", "0"]] {
        assert_eq!(adagio(folder.path(), &[&["experiment", "slowness"], &wrong[..]].concat()).status.code(), Some(2));
    }
    let missing = adagio(folder.path(), &["experiment", "digits", "--smoke", "--data", "."]);
    assert_eq!(missing.status.code(), Some(2));
    assert!(
        stderr(&missing).contains("sklearn/datasets/data/digits.csv.gz") && stderr(&missing).contains("pip install")
    );
    let needless = adagio(folder.path(), &["experiment", "values", "--data", "."]);
    assert_eq!(needless.status.code(), Some(2));
    let cache = folder.path().join("experiments/digits/cache");
    assert!(files(&cache).is_empty() && files(folder.path()).len() == 1, "nothing is left behind but an empty cache");
}

#[test]
fn every_experiment_leaves_tables_and_plots_of_what_it_kept() {
    let folder = tempfile::tempdir().unwrap();
    // Some read what a package of others ships.
    let packages = python("data_folder.py", &[]);
    let packages: Vec<&str> = packages.iter().flat_map(|folder| ["--data", folder.trim()]).collect();
    let (reading, others): (Vec<String>, Vec<String>) =
        names().into_iter().partition(|name| ["digits", "receptive-fields"].contains(&name.as_str()));
    let done = if packages.is_empty() { others } else { names() };
    for name in &done {
        let data = if reading.contains(name) { &packages[..] } else { &[] };
        let results = format!("{name}-results");
        let output = smoke(folder.path(), name, &[&["--out", &results, "--json"], data].concat());
        assert!(output.status.success(), "{name}: {}", stderr(&output));
        let out = folder.path().join(format!("{name}-results"));
        let result = json(&out.join("result.json"));
        let printed: Value = serde_json::from_slice(&output.stdout).expect("stdout is one JSON value");
        assert_eq!(printed, result);
        assert_eq!(result["size"], "smoke");

        // Every row says how it stands to the thesis, and columns with its figures are told by their names.
        let tables = result["tables"].as_array().unwrap();
        assert!(!tables.is_empty());
        let text = std::fs::read_to_string(out.join("table.txt")).unwrap();
        for (index, table) in tables.iter().enumerate() {
            assert!(text.contains(table["title"].as_str().unwrap()));
            let rows = table["rows"].as_array().unwrap();
            assert!(!rows.is_empty(), "{name}: {}", table["title"]);
            assert!(rows.iter().all(|row| !row["against the thesis"].as_str().unwrap().is_empty()));
            let csv = std::fs::read_to_string(out.join(format!("table-{}.csv", index + 1))).unwrap();
            assert!(csv.lines().count() > rows.len());
        }
        let plots = result["plots"].as_array().unwrap();
        assert!(!plots.is_empty(), "{name}");
        for plot in plots {
            let svg = std::fs::read_to_string(out.join(plot.as_str().unwrap())).unwrap();
            let document = roxmltree::Document::parse(&svg).unwrap_or_else(|error| panic!("{name}: {plot}: {error}"));
            assert!(document.descendants().filter(|node| node.is_element()).count() > 10, "{name}: {plot}");
        }

        // The settings that it names are in the cache, and what was kept once is not computed again.
        let cache = folder.path().join("experiments").join(name).join("cache");
        let kept: BTreeSet<PathBuf> =
            result["cache"].as_array().unwrap().iter().map(|file| cache.join(file.as_str().unwrap())).collect();
        assert_eq!(kept, files(&cache), "{name}");
        let again = smoke(folder.path(), name, &[&["--json"], data].concat());
        assert!(again.status.success(), "{name}: {}", stderr(&again));
        assert_eq!(stderr(&again).matches("(kept").count(), kept.len(), "{name}: {}", stderr(&again));
        assert_eq!(
            json(&folder.path().join(format!("experiments/{name}/001/result.json")))["tables"],
            result["tables"]
        );
        assert_eq!(kept, files(&cache), "{name}");
    }

    // All together, from what is kept: one page with the tables of all, and their plots.
    let all = smoke(folder.path(), "all", &packages);
    assert_eq!(all.status.code(), Some(if packages.is_empty() { 2 } else { 0 }), "{}", stderr(&all));
    assert_eq!(stderr(&all).matches(" is left out: ").count(), names().len() - done.len(), "{}", stderr(&all));
    let out = folder.path().join("experiments/all/001");
    let page = std::fs::read_to_string(out.join("experiments.md")).unwrap();
    assert!(done.iter().all(|name| page.contains(&format!("\n## {name}\n"))), "{page}");
    let plots: Vec<&str> = page.lines().filter_map(|line| line.split_once(".svg](")?.1.strip_suffix(')')).collect();
    assert!(plots.len() >= done.len() && plots.iter().all(|plot| out.join(plot).is_file()), "{plots:?}");
    let again = smoke(folder.path(), "all", &["--world", "lab"]);
    assert_eq!(again.status.code(), Some(2), "{}", stderr(&again));
}

#[test]
fn numbers_of_the_table_are_those_of_the_cache() {
    let folder = tempfile::tempdir().unwrap();
    let output = smoke(folder.path(), "pose-lspi", &["--json", "--quiet"]);
    assert!(output.status.success(), "{}", stderr(&output));
    let result: Value = serde_json::from_slice(&output.stdout).unwrap();
    let cache = folder.path().join("experiments/pose-lspi/cache");
    let rows_of = |table: usize| result["tables"][table]["rows"].as_array().unwrap();
    let is_shown = |path: &&PathBuf| path.to_string_lossy().contains("as-everywhere-here");
    let kept = files(&cache);
    let (shown, others): (Vec<&PathBuf>, Vec<&PathBuf>) = kept.iter().partition(is_shown);
    assert_eq!(rows_of(1).len() + rows_of(2).len(), 3 * shown.len());
    let mean_of = |outcome: &Value, key: &str| {
        let drawn = outcome["result"]["drawn"].as_array().unwrap();
        drawn.iter().map(|fitted| fitted["quality"][key].as_f64().unwrap()).sum::<f64>() / drawn.len() as f64
    };
    // Other conditions have one number of features of this size, and a row each for drawn first policies.
    let drawn = rows_of(3).iter().filter(|row| row["first policy"] == "drawn actions");
    let successes: Vec<f64> = drawn.map(|row| row["success, mean of these"].as_f64().unwrap()).collect();
    assert_eq!(successes.len(), 1 + others.len());
    for path in others {
        let found = mean_of(&json(path), "success");
        assert!(successes[1..].iter().any(|success| (success - found).abs() < 1e-12), "{}", path.display());
    }
    for outcome in shown.into_iter().map(|path| json(path)) {
        let settings = &outcome["settings"];
        let rows = rows_of(if settings["kind"] == "thesis" { 1 } else { 2 });
        let row = |policy: &str| {
            let of = |row: &&Value| {
                row["features"].as_f64() == settings["features"].as_f64()
                    && row["transitions"].as_f64() == settings["transitions"].as_f64()
                    && row["first policy"].as_str().unwrap().starts_with(policy)
            };
            rows.iter().find(of).unwrap()
        };
        let mean = mean_of(&outcome, "quality");
        assert!((row("drawn")["quality"]["mean"].as_f64().unwrap() - mean).abs() < 1e-12);
        for (policy, key) in [("all", "uniform"), ("ours", "ours")] {
            assert_eq!(row(policy)["quality"]["mean"], outcome["result"][key]["quality"]["quality"]);
            assert_eq!(row(policy)["success"]["mean"], outcome["result"][key]["quality"]["success"]);
        }
    }
}

#[test]
fn settings_are_taken_from_the_cache_only_if_they_are_the_same_and_whole() {
    let folder = tempfile::tempdir().unwrap();
    let first = smoke(folder.path(), "pose-lspi", &[]);
    assert!(first.status.success(), "{}", stderr(&first));
    let cache = folder.path().join("experiments/pose-lspi/cache");
    let before = files(&cache);

    // Another seed is another setting.
    let other = smoke(folder.path(), "pose-lspi", &["--seeds", "12"]);
    assert!(other.status.success() && !stderr(&other).contains("(kept"), "{}", stderr(&other));
    let both = files(&cache);
    assert!(both.len() == 2 * before.len() && both.is_superset(&before));
    // Both together: all is there, and the tables have bands.
    let bands = smoke(folder.path(), "pose-lspi", &["--seeds", "11..12", "--json"]);
    assert_eq!(stderr(&bands).matches("(kept").count(), both.len());
    let bands: Value = serde_json::from_slice(&bands.stdout).unwrap();
    assert!(bands["notes"].to_string().contains("10th to 90th percentile"));
    assert_eq!(bands["tables"][1]["rows"][1]["quality"]["count"], 2);

    // A number that was changed, and a file that was cut off: both are computed again, and it is said.
    let mut both = both.iter();
    let (changed, cut) = (both.next().unwrap(), both.next().unwrap());
    let (was_changed, was_cut) = (std::fs::read_to_string(changed).unwrap(), std::fs::read_to_string(cut).unwrap());
    std::fs::write(changed, was_changed.replacen("\"success\": ", "\"success\": 1", 1)).unwrap();
    std::fs::write(cut, &was_cut[..was_cut.len() - 20]).unwrap();
    let again = smoke(folder.path(), "pose-lspi", &["--seeds", "11..12", "--json"]);
    assert!(again.status.success());
    assert_eq!(stderr(&again).matches("was damaged").count(), 2, "{}", stderr(&again));
    let result = |text: &str| serde_json::from_str::<Value>(text).unwrap()["result"].clone();
    for (path, was) in [(changed, &was_changed), (cut, &was_cut)] {
        assert_eq!(json(path)["result"], result(was));
        let mut aside = path.clone().into_os_string();
        aside.push(".damaged");
        assert!(Path::new(&aside).is_file(), "the damaged file is put aside");
    }
    let tables: Value = serde_json::from_slice::<Value>(&again.stdout).unwrap()["tables"].clone();
    assert_eq!(tables, bands["tables"]);
    let mut all = Vec::new();
    numbers(&tables, &mut all);
    assert!(all.len() > 50 && all.iter().all(|number| number.is_finite()));
}

#[test]
fn an_experiment_that_is_stopped_keeps_what_is_done_and_goes_on() {
    let folder = tempfile::tempdir().unwrap();
    let cache = folder.path().join("experiments/pose-lspi/cache");
    let interrupted = |files_before: usize| {
        let child = Command::new(env!("CARGO_BIN_EXE_adagio"))
            .current_dir(folder.path())
            .args(["experiment", "pose-lspi", "--quick"])
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        let begin = Instant::now();
        while !cache.is_dir() || files(&cache).len() <= files_before {
            assert!(begin.elapsed() < Duration::from_secs(300), "no setting was finished");
            std::thread::sleep(Duration::from_millis(20));
        }
        assert!(Command::new("kill").args(["-INT", &child.id().to_string()]).status().unwrap().success());
        child.wait_with_output().unwrap()
    };
    let first = interrupted(0);
    assert_eq!(first.status.code(), Some(1), "{}", stderr(&first));
    assert!(stderr(&first).contains("stopped; ") && stderr(&first).contains("finished settings are kept"));
    assert!(first.stdout.is_empty());
    let kept = files(&cache);
    assert!(kept.iter().all(|path| path.extension().unwrap() == "json"), "{kept:?}");
    // No folder of results that are not there.
    assert_eq!(files(&folder.path().join("experiments/pose-lspi")), BTreeSet::from([cache.clone()]));
    let second = interrupted(kept.len());
    assert_eq!(second.status.code(), Some(1), "{}", stderr(&second));
    assert_eq!(stderr(&second).matches("(kept").count(), kept.len(), "{}", stderr(&second));
    assert!(files(&cache).is_superset(&kept));
}

#[test]
fn nothing_is_overwritten() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::create_dir(folder.path().join("mine")).unwrap();
    std::fs::write(folder.path().join("mine/notes.txt"), "important").unwrap();
    let refused = smoke(folder.path(), "pose-lspi", &["--out", "mine"]);
    assert_eq!(refused.status.code(), Some(2));
    assert!(stderr(&refused).contains("mine exists already"), "{}", stderr(&refused));
    assert_eq!(files(&folder.path().join("mine")).len(), 1);
    // Without a name each goes to a new folder.
    for number in ["001", "002"] {
        assert!(smoke(folder.path(), "pose-lspi", &["--quiet"]).status.success());
        assert!(folder.path().join("experiments/pose-lspi").join(number).join("result.json").is_file());
    }
}
