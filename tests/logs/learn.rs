//! One model from many logs.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::sync::Arc;
use std::time::{Duration, Instant, SystemTime};

use adagio::agent::{CHECKPOINT_NAME, read_checkpoint};
use adagio::learn::{Log, Piece, Setting};
use adagio::policy::columns;
use adagio::scenario::Plan;
use adagio::slow::Link;
use faer::Par;
use serde_json::Value;

use crate::common::{adagio, report, smoke_run, stderr, stdout};

/// Settings of a dictionary that does not fill its budget.
const WIDE: [&str; 4] = ["--set", "dictionary.nu=0.2", "--set", "dictionary.budget=1500"];

/// Runs of one world, by other robots.
fn drives(folder: &Path, count: usize) -> Vec<String> {
    let names: Vec<String> = (1..=count).map(|seed| format!("drive-{seed}")).collect();
    for (seed, name) in (1..).zip(&names) {
        let seed = format!("{seed}");
        smoke_run(folder, name, &["--actions", "150", "--seed", &seed, "--set", "evaluate.starts=1"]);
    }
    names
}

fn learn(folder: &Path, logs: &[&str], arguments: &[&str]) -> Value {
    let output = adagio(folder, &[&["learn", "--json", "--quiet"], arguments, logs].concat());
    assert!(output.status.success(), "{}", stderr(&output));
    serde_json::from_str(&stdout(&output)).unwrap()
}

#[test]
fn the_same_logs_give_the_same_bits_whoever_works_on_them() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let names = drives(folder, 3);
    let [a, b, c] = [&*names[0], &*names[1], &*names[2]];
    let one = learn(folder, &[a, b, c], &[&WIDE[..], &["--out", "one"]].concat());
    assert_eq!(one["learned_from"]["frames"], 3 * 751);
    assert_eq!(one["digest"], report(&folder.join("one"))["digest"]);

    // Where only the report is missing no part is made again, but for one that is.
    let made = || -> BTreeMap<_, SystemTime> {
        let parts = std::fs::read_dir(folder.join("one/parts")).unwrap().map(|entry| entry.unwrap());
        let of_logs = parts.filter(|entry| !entry.file_name().to_string_lossy().starts_with("dictionary"));
        of_logs.map(|entry| (entry.path(), entry.metadata().unwrap().modified().unwrap())).collect()
    };
    let before = made();
    let (missing, damaged) = (before.keys().next().unwrap(), before.keys().next_back().unwrap());
    std::fs::remove_file(folder.join("one/report.json")).unwrap();
    std::fs::remove_file(missing).unwrap();
    let again = learn(folder, &[a, b, c], &[&WIDE[..], &["--out", "one"]].concat());
    assert_eq!(again["digest"], one["digest"]);
    let after = made();
    assert!(before.iter().all(|(path, time)| (after[path] == *time) == (path != missing)), "{before:?} {after:?}");
    // One that is damaged is neither taken nor overwritten.
    std::fs::remove_file(folder.join("one/report.json")).unwrap();
    let whole = std::fs::read(damaged).unwrap();
    std::fs::write(damaged, &whole[..whole.len() - 1]).unwrap();
    let output = adagio(folder, &[&["learn", "--quiet", "--out", "one"], &WIDE[..], &[a, b, c]].concat());
    assert!(
        output.status.code() == Some(1) && stderr(&output).contains("delete it to have it made again"),
        "{}",
        stderr(&output)
    );

    // In another order, under another name, by two processes of which one is killed.
    std::fs::rename(folder.join(c), folder.join("renamed")).unwrap();
    let arguments = ["learn", "--quiet", "--workers", "2", "--no-evaluate", "--out", "two"];
    let mut learning = Command::new(env!("CARGO_BIN_EXE_adagio"))
        .current_dir(folder)
        .args([&arguments[..], &WIDE, &["renamed", b, a]].concat())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let killed = kill_a_worker(&mut learning);
    let output = learning.wait_with_output().unwrap();
    assert!(output.status.success(), "{}", stderr(&output));
    assert!(!killed || stderr(&output).contains("signal: 9 (SIGKILL)"), "{}", stderr(&output));
    assert!(killed, "there was no worker to be killed");
    assert_eq!(report(&folder.join("two"))["digest"], one["digest"]);

    // By hand, part by part, as another engine would.
    let scenario = "one/scenario.toml";
    let by_hand = |arguments: &[&str]| {
        let output = adagio(folder, &[arguments, &["--scenario", scenario]].concat());
        assert!(output.status.success(), "{arguments:?}: {}", stderr(&output));
        stdout(&output)
    };
    let mut dictionary = "one/parts/dictionary-0.safetensors".to_owned();
    for round in 1.. {
        let parts: Vec<String> = [b, "renamed", a].iter().map(|log| format!("{log}.{round}")).collect();
        for (log, part) in [b, "renamed", a].iter().zip(&parts) {
            by_hand(&["members", log, "--dictionary", &dictionary, "--out", part]);
        }
        let next = format!("dictionary.{round}");
        let parts: Vec<&str> = parts.iter().map(String::as_str).collect();
        let said = by_hand(&[&["merge", "--json", "--dictionary", &dictionary, "--out", &next], &parts[..]].concat());
        dictionary = next;
        if serde_json::from_str::<Value>(&said).unwrap()["more"] == false {
            assert_eq!(one["learned_from"]["rounds"], round);
            break;
        }
    }
    for log in [b, "renamed", a] {
        by_hand(&["moments", log, "--dictionary", &dictionary, "--out", &format!("{log}.sums")]);
    }
    let sums = ["renamed.sums", "drive-1.sums", "drive-2.sums"];
    let merge = ["merge", "--no-evaluate", "--quiet", "--dictionary", &dictionary, "--out", "three"];
    by_hand(&[&merge[..], &sums].concat());
    assert_eq!(report(&folder.join("three"))["digest"], one["digest"]);

    // The features are of use: the policies can be tried, and do better than chance.
    let output = adagio(folder, &["evaluate", "three", "--starts", "50", "--json"]);
    let tried: Value = serde_json::from_str(&stdout(&output)).unwrap();
    assert!(tried["tasks"][1]["success"].as_f64().unwrap() > 0.5, "{tried:#}");

    // What does not belong together is refused.
    let refused = |arguments: &[&str], expected: &str| {
        let output = adagio(folder, &[arguments, &["--scenario", scenario]].concat());
        assert!(!output.status.success() && stderr(&output).contains(expected), "{}", stderr(&output));
    };
    let merge =
        |parts: [&'static str; 2]| [&["merge", "--dictionary", &dictionary, "--out", "no"][..], &parts].concat();
    refused(&merge(["drive-1.sums", "drive-1.sums"]), "parts of the same frames");
    refused(&merge(["drive-1.sums", "drive-2.1"]), "drive-2.1");
    refused(&["merge", "--dictionary", "dictionary.1", "--out", "no", "drive-1.1", "drive-2.1"], "is over dictionary");
    refused(&["moments", a, "--out", "no"], "dictionary.sigma");
    assert!(!folder.join("no").exists());
}

#[cfg(unix)]
#[test]
fn hosts_are_reached_by_ssh_whatever_paths_are_called() {
    use std::os::unix::fs::PermissionsExt as _;

    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    // One for each host, so that each is asked while the others work.
    let names = drives(folder, 3);
    let here = learn(folder, &[&names[0], &names[1], &names[2]], &["--no-evaluate", "--out", "here"]);
    std::fs::rename(folder.join(&names[0]), folder.join("Anna's drive")).unwrap();
    // It runs here what it would run there, and says for whom.
    let ssh = "#!/bin/sh\n[ \"$1 $2\" = \"-o BatchMode=yes\" ] || exit 9\n[ \"$3\" = dead ] && exit 255\necho \"$3\" >> asked\nshift 3\nexec sh -c \"$*\"\n";
    std::fs::create_dir(folder.join("bin")).unwrap();
    std::fs::write(folder.join("bin/ssh"), ssh).unwrap();
    std::fs::set_permissions(folder.join("bin/ssh"), std::fs::Permissions::from_mode(0o755)).unwrap();
    std::fs::write(folder.join("hosts"), "# three machines\ndead\nleft\n\nright\n").unwrap();
    let path = format!("{}:{}", folder.join("bin").display(), std::env::var("PATH").unwrap());
    let output = Command::new(env!("CARGO_BIN_EXE_adagio"))
        .current_dir(folder)
        .env("PATH", path)
        .args(["learn", "--hosts", "hosts", "--no-evaluate", "--quiet", "--out", "there"])
        .args(["Anna's drive", &names[1], &names[2]])
        .output()
        .unwrap();
    assert!(output.status.success(), "{}", stderr(&output));
    assert_eq!(report(&folder.join("there"))["digest"], here["digest"]);
    assert!(stderr(&output).contains("dead cannot be reached"), "{}", stderr(&output));
    let asked = std::fs::read_to_string(folder.join("asked")).unwrap();
    assert!(asked.contains("left\n") && asked.contains("right\n"), "{asked}");
    for (hosts, expected) in [("-oProxyCommand=no", "is no host"), ("# nobody", "names no host")] {
        std::fs::write(folder.join("hosts"), hosts).unwrap();
        let output = adagio(folder, &["learn", "--hosts", "hosts", "--out", "no", &names[1]]);
        assert!(output.status.code() == Some(2) && stderr(&output).contains(expected), "{}", stderr(&output));
    }
}

/// Kill a process that a program has started, as soon as there is one; whether there was.
fn kill_a_worker(program: &mut Child) -> bool {
    let (begin, parent) = (Instant::now(), program.id().to_string());
    // The parent is the second word behind the name, which stands in brackets.
    let is_worker = |process: &String| {
        let stat = std::fs::read_to_string(format!("/proc/{process}/stat")).unwrap_or_default();
        stat.rsplit(')').next().and_then(|rest| rest.split_whitespace().nth(1)) == Some(&parent)
    };
    while begin.elapsed() < Duration::from_secs(60) && program.try_wait().unwrap().is_none() {
        let processes =
            std::fs::read_dir("/proc").unwrap().filter_map(|entry| entry.ok()?.file_name().into_string().ok());
        if let Some(worker) = processes.filter(|name| name.starts_with(|c: char| c.is_ascii_digit())).find(is_worker) {
            return Command::new("kill").args(["-9", &worker]).stderr(Stdio::null()).status().unwrap().success();
        }
        std::thread::sleep(Duration::from_millis(2));
    }
    false
}

#[test]
fn a_union_represents_every_frame_and_is_hardly_larger_than_that_of_one_stream() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let names = drives(folder, 3);
    let names: Vec<&str> = names.iter().map(String::as_str).collect();
    let union = learn(folder, &names, &[&WIDE[..], &["--no-evaluate", "--out", "union"]].concat());
    let size = union["dictionary"]["support_vectors"].as_u64().unwrap();
    assert!(union["learned_from"]["settled"] == true && size < 1500 && size > 20, "{union:#}");
    let residual = union["learned_from"]["largest_residual"].as_f64().unwrap();
    assert!(residual <= 0.2 && residual > 0.1, "a frame lacks {residual} of itself");
    // One stream: each log begins with what those before it have taken.
    let mut dictionary = "union/parts/dictionary-0.safetensors".to_owned();
    let mut one_stream = 0;
    for log in &names {
        let (part, next) = (format!("{log}.part"), format!("{log}.dictionary"));
        for arguments in [
            vec!["members", log, "--dictionary", &dictionary, "--out", &part, "--scenario", "union/scenario.toml"],
            vec![
                "merge",
                &part,
                "--dictionary",
                &dictionary,
                "--out",
                &next,
                "--scenario",
                "union/scenario.toml",
                "--json",
            ],
        ] {
            let output = adagio(folder, &arguments);
            assert!(output.status.success(), "{}", stderr(&output));
            let said = serde_json::from_str::<Value>(&stdout(&output)).ok();
            one_stream = said.and_then(|said| said["support_vectors"].as_u64()).unwrap_or(one_stream);
        }
        dictionary = next;
    }
    assert!(size as f64 <= 1.2 * one_stream as f64, "{size} in place of {one_stream}");
}

#[test]
fn features_of_several_logs_are_slower_on_another_one_than_those_of_any_of_them() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let names = drives(folder, 4);
    let [known @ .., held_out] = &names[..] else { unreachable!() };
    let known: Vec<&str> = known.iter().map(String::as_str).collect();
    let slowness = |logs: &[&str], out: &str| -> f64 {
        learn(folder, logs, &[&WIDE[..], &["--no-evaluate", "--out", out]].concat());
        let path = folder.join(out).join(CHECKPOINT_NAME);
        let (learned, scenario) = read_checkpoint(&std::fs::read(&path).unwrap(), &path).unwrap();
        let (plan, scenario) = (Arc::new(Plan::new(&scenario).unwrap()), Arc::new(scenario));
        let log = Log::open(&folder.join(held_out), &scenario).unwrap();
        let frames = Piece::whole(&log).samples(&Setting { scenario, plan, par: Par::Seq }).next(usize::MAX);
        assert_eq!(frames.len(), 751);
        let x = columns(frames.iter().map(|frame| &*frame.observation));
        let y = learned.model.apply(x.as_ref(), Par::Seq).unwrap();
        let of_feature = |i: usize| {
            let y: Vec<f64> = y.row(i).iter().copied().collect();
            let links: Vec<(f64, &Link)> =
                y.windows(2).zip(&frames[1..]).map(|(y, frame)| (y[1] - y[0], frame.link.as_ref().unwrap())).collect();
            let squares: f64 = links.iter().map(|(change, link)| link.weight * (change / link.dt).powi(2)).sum();
            let mean = y.iter().sum::<f64>() / y.len() as f64;
            let variance = y.iter().map(|y| (y - mean).powi(2)).sum::<f64>() / y.len() as f64;
            squares / links.iter().map(|(_, link)| link.weight).sum::<f64>() / variance
        };
        // The first one is constant.
        (1..=20).map(of_feature).sum::<f64>() / 20.0
    };
    let union = slowness(&known, "union");
    for log in &known {
        let single = slowness(&[log], &format!("of-{log}"));
        assert!(union < single, "{union} by all, {single} by {log}");
    }
}

#[test]
fn sums_over_one_log_are_those_of_its_run() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let run = report(&smoke_run(folder, "drive", &["--actions", "150", "--set", "evaluate.starts=1"]));
    let learned = learn(folder, &["drive"], &["--no-evaluate", "--out", "learned"]);
    assert_eq!(learned["dictionary"], run["dictionary"]);
    let slowness = |of: &Value| -> Vec<f64> {
        of["model"]["slowness"].as_array().unwrap().iter().map(|value| value.as_f64().unwrap()).collect()
    };
    let alike = |ours: &Value, theirs: &Value, within: f64| {
        let (ours, theirs) = (slowness(ours), slowness(theirs));
        assert!(ours.len() == theirs.len() && ours.len() > 20);
        for (a, b) in ours.iter().zip(&theirs) {
            assert!((a - b).abs() < within * b, "slowness {a} in place of {b}");
        }
    };
    alike(&learned, &run, 1e-6);

    // Stretches of it, with borders within an action and behind one: nothing is lost between them, and nothing counts twice.
    let known = ["--scenario", "learned/scenario.toml", "--dictionary", "learned/parts/dictionary.safetensors"];
    for (frames, part) in [("0..403", "a"), ("403..404", "b"), ("404..500", "c"), ("500..751", "d"), ("400..500", "e")]
    {
        let output = adagio(folder, &[&["moments", "drive", "--frames", frames, "--out", part], &known[..]].concat());
        assert!(output.status.success(), "{}", stderr(&output));
    }
    let merge = |parts: &[&str], out: &str| {
        adagio(folder, &[&["merge", "--no-evaluate", "--json", "--quiet", "--out", out], &known[..], parts].concat())
    };
    let output = merge(&["c", "a", "d", "b"], "merged");
    assert!(output.status.success(), "{}", stderr(&output));
    let merged: Value = serde_json::from_str(&stdout(&output)).unwrap();
    alike(&merged, &learned, 1e-9);
    for count in ["frames", "transitions", "largest_residual"] {
        assert_eq!(merged["learned_from"][count], learned["learned_from"][count], "{count}");
    }
    for (parts, expected) in [
        (&["c", "a", "d"][..], "frames 403..404 of the log of a are in no part"),
        (&["b", "c", "d"], "frames 0..403 of the log of b are in no part"),
        (&["a", "b"], "frames 404..751 of the log of a are in no part"),
        (&["a", "b", "c", "d", "e"], "a and e are parts of the same frames"),
    ] {
        let output = merge(parts, "none");
        assert_eq!((output.status.code(), stderr(&output).contains(expected)), (Some(2), true), "{}", stderr(&output));
    }
    for (frames, expected) in [("0..752", "has 751 frames"), ("7..7", "A must be below B"), ("7", "A..B")] {
        let output = adagio(folder, &[&["moments", "drive", "--frames", frames, "--out", "none"], &known[..]].concat());
        assert_eq!((output.status.code(), stderr(&output).contains(expected)), (Some(2), true), "{}", stderr(&output));
    }
    assert!(!folder.join("none").exists());
}

#[test]
fn what_is_damaged_is_left_out_and_what_does_not_fit_is_refused_before_anything_begins() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    drives(folder, 2);
    let without = learn(folder, &["drive-1"], &["--no-evaluate", "--out", "without"]);
    let log = folder.join("drive-2/run_000.mcap");
    let mut bytes = std::fs::read(&log).unwrap();
    // Behind the middle there is what was learned, which nobody reads here.
    let place = bytes.len() / 10;
    bytes[place..place + 64].iter_mut().for_each(|byte| *byte ^= 0x5a);
    std::fs::write(&log, &bytes).unwrap();
    std::fs::create_dir(folder.join("empty")).unwrap();
    let output = adagio(folder, &["learn", "drive-2", "drive-1", "empty", "--no-evaluate", "--out", "with", "--quiet"]);
    let said = stderr(&output);
    assert_eq!(output.status.code(), Some(3), "{said}");
    assert!(said.contains("drive-2: it is damaged") && said.contains("empty holds no log file"), "{said}");
    assert!(said.contains("2 of 3 logs were left out"), "{said}");
    let with = report(&folder.join("with"));
    assert_eq!((&with["digest"], with["learned_from"]["left_out"].as_array().unwrap().len()), (&without["digest"], 2));

    // Other cameras and other actions, all of them at once; the same log twice; a folder that is done.
    smoke_run(
        folder,
        "wide",
        &["--actions", "20", "--set", "camera.field_of_view_deg=90", "--set", "evaluate.starts=1"],
    );
    smoke_run(
        folder,
        "short",
        &["--actions", "20", "--set", "robot.frames_per_action=4", "--set", "evaluate.starts=1"],
    );
    let before: BTreeSet<_> = std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()).collect();
    for (arguments, expected) in [
        (
            &["drive-1", "wide", "short"][..],
            vec!["2 of the logs", "wide: its camera is another one", "short: it has 4 frames"],
        ),
        (&["drive-1", "drive-1"], vec!["are the same log"]),
        (&["drive-1", "--set", "dictionary.selection=random"], vec!["must be \"ald\""]),
        (&["drive-1", "--set", "slow.memory_frames=1000"], vec!["slow.memory_frames must be 0"]),
        (&["drive-1", "--workers", "0"], vec!["--workers"]),
        (&["drive-1", "--hosts", "nowhere"], vec!["nowhere"]),
    ] {
        let output = adagio(folder, &[&["learn", "--out", "new"], arguments].concat());
        let said = stderr(&output);
        assert_eq!(output.status.code(), Some(2), "{said}");
        assert!(expected.iter().all(|expected| said.contains(expected)), "{said}");
    }
    let output = adagio(folder, &["learn", "drive-1", "--out", "without"]);
    assert!(output.status.code() == Some(2) && stderr(&output).contains("exists already"), "{}", stderr(&output));
    let after: BTreeSet<_> = std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()).collect();
    assert_eq!(before, after);
}
