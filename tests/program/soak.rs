//! Promise: a soak test watches a run from its first hour to its last, and its exit code is its verdict.

use crate::common::{adagio, package_file, stderr, stdout};
use serde_json::Value;

#[test]
fn a_soak_test_samples_the_whole_run_judges_it_and_draws_it() {
    let folder = tempfile::tempdir().unwrap();
    let smoke = std::fs::read_to_string(package_file("scenarios/smoke.toml")).unwrap();
    let change = "\n[[change]]\naction = 500\nkind = \"light\"\nfactor = 0.8\n";
    std::fs::write(folder.path().join("dimmed.toml"), smoke + change).unwrap();
    let arguments = ["soak", "dimmed.toml", "--hours", "0.25", "--seed", "5", "--out", "run", "--json", "--quiet"];
    let output = adagio(folder.path(), &arguments);
    let soak: Value = serde_json::from_str(&stdout(&output)).unwrap_or_else(|_| panic!("{}", stderr(&output)));
    let passed = soak["passed"].as_bool().unwrap();
    assert_eq!(output.status.code(), Some(i32::from(!passed)), "{}", stderr(&output));
    let rules = soak["rules"].as_array().unwrap();
    assert!(rules.len() >= 5 && passed == rules.iter().all(|rule| rule["holds"] == true), "{rules:?}");
    for rule in rules.iter().filter(|rule| rule["holds"] == false) {
        assert!(stderr(&output).contains(rule["rule"].as_str().unwrap()), "{}", stderr(&output));
    }
    // 0.25 h are 900 actions of a second each.
    assert_eq!((soak["hours"].as_f64(), &soak["changes"][0][0]), (Some(0.25), &Value::from(500.0 / 3600.0)));
    let samples = soak["samples"].as_array().unwrap();
    let frames: Vec<u64> = samples.iter().map(|sample| sample["frames"].as_u64().unwrap()).collect();
    assert!(samples.len() > 20 && frames.is_sorted() && frames.last() == Some(&4501), "{frames:?}");
    let last = &samples[samples.len() - 1];
    let bytes = std::fs::metadata(folder.path().join("run/run_000.mcap")).unwrap().len();
    assert_eq!(last["log_bytes"].as_u64(), Some(bytes));
    assert!(last["rss_bytes"].as_u64().unwrap() > 10_000_000 && last["open_files"].as_u64().unwrap() > 2);
    let curve = soak["curve"].as_array().unwrap();
    assert!(curve.len() >= 8);
    let drift = curve[1][1]["feature_drift_deg"].as_f64().unwrap();
    assert!(curve[0][1]["feature_drift_deg"].is_null() && drift > 0.0 && drift < 90.0, "{drift}");
    let page = std::fs::read_to_string(folder.path().join("run/soak.html")).unwrap();
    for figure in ["success", "slowness", "drift", "memory", "files", "log", "latency", "queues", "speed", "dictionary"]
    {
        assert!(page.contains(&format!("<figure id=\"{figure}\"><svg ")), "{figure}");
    }
    assert!(page.contains("light × 0.8") && !page.contains("<script"));
}

#[test]
fn hours_that_cannot_be_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let scenario = package_file("scenarios/smoke.toml");
    for hours in ["0", "-1", "nan", "1e9"] {
        let output = adagio(folder.path(), &["soak", scenario.to_str().unwrap(), &format!("--hours={hours}")]);
        assert_eq!(output.status.code(), Some(2), "{hours}");
        assert!(stderr(&output).contains("it must be in (0, 87600]"), "{hours}: {}", stderr(&output));
    }
    assert!(std::fs::read_dir(folder.path()).unwrap().next().is_none());
}
