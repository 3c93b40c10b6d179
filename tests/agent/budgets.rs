//! Kernel width and budget: what a scenario says about the dictionary is what a run does.

use crate::common::{report, smoke_run};

fn support_vectors(run: &std::path::Path) -> u64 {
    report(run)["dictionary"]["support_vectors"].as_u64().unwrap()
}

/// `sigma = "auto"`: the width is searched at which the given share of the first frames become support vectors.
#[test]
fn an_automatic_width_gives_the_share_that_was_asked_for() {
    let folder = tempfile::tempdir().unwrap();
    let mut widths = Vec::new();
    for share in ["0.3", "0.6"] {
        // 40 actions are 201 frames; the width is measured on all of them but one.
        let sets = ["--actions", "40", "--set", &format!("dictionary.sigma_share={share}")];
        let run = smoke_run(folder.path(), share, &sets);
        let expected = 200.0 * share.parse::<f64>().unwrap();
        assert!((support_vectors(&run) as f64 - expected).abs() <= 4.0, "{} for {expected}", support_vectors(&run));
        widths.push(report(&run)["dictionary"]["sigma"].as_f64().unwrap());
    }
    // All frames: the search would end at the noise of the camera, so it is stopped at half the median distance.
    let run = smoke_run(folder.path(), "all", &["--actions", "40", "--set", "dictionary.sigma_share=1.0"]);
    let narrowest = report(&run)["dictionary"]["sigma"].as_f64().unwrap();
    assert!(narrowest < widths[1] && narrowest > 0.1 * widths[1], "{narrowest} after {widths:?}");
    assert!(widths[1] < widths[0], "more support vectors need a narrower kernel: {widths:?}");
}

/// Whatever happens at the budget, it holds, a model is learned, and the run can be repeated.
#[test]
fn at_the_budget_the_dictionary_does_what_the_scenario_says() {
    let folder = tempfile::tempdir().unwrap();
    let cases = [
        ("stop", "dictionary.when_full=stop"),
        ("raised", "dictionary.when_full=raise_nu"),
        ("replaced", "dictionary.when_full=replace"),
        ("random", "dictionary.selection=random"),
    ];
    let mut digests = Vec::new();
    for (name, key) in cases {
        let sets = ["--set", "dictionary.budget=90", "--set", "slow.features=30", "--set", key];
        let run = smoke_run(folder.path(), name, &sets);
        let written = report(&run);
        let (size, nu) = (support_vectors(&run), written["dictionary"]["nu"].as_f64());
        match name {
            "stop" | "replaced" => assert_eq!((size, nu), (90, Some(0.01))),
            "raised" => assert!(size <= 90 && nu.unwrap() > 0.01, "{size} at {nu:?}"),
            _ => assert_eq!((size, nu), (90, None)),
        }
        assert!(written["model"]["features"].as_u64().unwrap() == 30);
        let again = report(&smoke_run(folder.path(), &format!("{name} again"), &sets));
        assert_eq!(written["digest"], again["digest"], "{name}");
        digests.push(written["digest"].clone());
    }
    digests.dedup();
    assert_eq!(digests.len(), cases.len(), "each way learns something else");
}
