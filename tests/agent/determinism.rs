//! The same scenario and seed give the same result, whatever happens beside the run; another seed gives another.

use crate::common::{report, smoke_run};

fn digest(folder: &std::path::Path, name: &str, arguments: &[&str]) -> String {
    let run = smoke_run(folder, name, arguments);
    report(&run)["digest"].as_str().unwrap().to_owned()
}

#[test]
fn the_same_seed_gives_the_same_digest_and_another_seed_another() {
    let folder = tempfile::tempdir().unwrap();
    let first = digest(folder.path(), "first", &[]);
    assert_eq!(digest(folder.path(), "second", &[]), first);
    assert_ne!(digest(folder.path(), "other", &["--seed", "2"]), first);
}

#[test]
fn evaluation_logging_and_queues_do_not_touch_the_run() {
    let folder = tempfile::tempdir().unwrap();
    let plain = digest(folder.path(), "plain", &[]);
    let no_trials = ["--set", "evaluate.every=0", "--set", "evaluate.starts=3"];
    assert_eq!(digest(folder.path(), "no_trials", &no_trials), plain);
    let tight = ["--set", "agent.queue=1", "--set", "log.compression=none", "--set", "log.chunk_bytes=1024"];
    assert_eq!(digest(folder.path(), "tight", &tight), plain);
}

#[test]
fn one_core_gives_the_digest_of_all() {
    let folder = tempfile::tempdir().unwrap();
    // A dictionary large enough that a decomposition on two threads would have other bits than on one.
    let large = ["--set", "dictionary.budget=600", "--set", "dictionary.nu=0.001"];
    let all = digest(folder.path(), "all", &large);
    // One thread for everything that is computed side by side, on the first core that this process may use.
    let status = std::fs::read_to_string("/proc/self/status").unwrap();
    let allowed = status.lines().find_map(|line| line.strip_prefix("Cpus_allowed_list:")).unwrap().trim();
    let core = allowed.split(['-', ',']).next().unwrap();
    let scenario = crate::common::package_file("scenarios/smoke.toml");
    let output = std::process::Command::new("taskset")
        .args(["-c", core, env!("CARGO_BIN_EXE_adagio")])
        .args(["run", scenario.to_str().unwrap(), "--quiet", "--no-report", "--out", "one"])
        .args(large)
        .current_dir(folder.path())
        .env("RAYON_NUM_THREADS", "1")
        .output();
    match output {
        Ok(output) => {
            assert!(output.status.success(), "{}", crate::common::stderr(&output));
            assert_eq!(report(&folder.path().join("one"))["digest"], all.as_str());
        }
        Err(missing) => panic!("taskset (util-linux) is needed: {missing}"),
    }
}

#[test]
fn threads_for_matrix_products_do_not_change_the_digest() {
    let folder = tempfile::tempdir().unwrap();
    // Products large enough to be shared among threads, and so many coordinates that the solver iterates.
    let large = "dictionary.budget=900 dictionary.nu=0.0001 slow.features=20".split(' ').flat_map(|set| ["--set", set]);
    let large: Vec<&str> = large.collect();
    let of = |threads: usize| {
        let (name, set) = (format!("threads_{threads}"), format!("agent.threads={threads}"));
        let digest = digest(folder.path(), &name, &[&large[..], &["--set", &set]].concat());
        let size = report(&folder.path().join(name))["dictionary"]["support_vectors"].as_u64().unwrap();
        assert!(size >= 576, "{size} support vectors");
        digest
    };
    let one = of(1);
    assert_eq!(of(2), one);
    assert_eq!(of(4), one);
}

#[test]
fn logs_of_the_same_run_hold_the_same_observations_and_decisions() {
    let folder = tempfile::tempdir().unwrap();
    let read = |name: &str| {
        let run = smoke_run(folder.path(), name, &["--actions", "150"]);
        let kept =
            ["/camera/observation", "/adagio/decision", "/adagio/transition", "/adagio/model", "/pose", "/sonar"];
        let mut messages: Vec<(String, u64, Vec<u8>)> = adagio::log::LogReader::open(&run.join("run_000.mcap"))
            .unwrap()
            .filter_map(|record| match record.unwrap() {
                adagio::log::Record::Message { topic, log_time_ns, data, .. } if kept.contains(&&*topic) => {
                    Some((topic.to_string(), log_time_ns, data))
                }
                _ => None,
            })
            .collect();
        // Threads may write in another order; what each topic holds, and when, is the same.
        messages.sort();
        messages
    };
    let (first, second) = (read("a"), read("b"));
    assert!(first.len() > 2500);
    assert!(first == second);
}

#[test]
fn realtime_runs_end_with_a_model() {
    let folder = tempfile::tempdir().unwrap();
    let run = smoke_run(folder.path(), "realtime", &["--set", "agent.mode=realtime"]);
    let report = report(&run);
    assert_eq!(report["run"]["frames"], 2001);
    assert!(report["model"]["epoch"].as_u64().unwrap() >= 4);
}
