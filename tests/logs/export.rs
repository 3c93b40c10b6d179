//! Promise: an export holds what the log holds, and Python and image programs open it.
//!
//! See `tests/common` for `ADAGIO_PYTHON` and `ADAGIO_REQUIRE_PYTHON`.

use std::collections::BTreeMap;
use std::path::Path;

use crate::common::{adagio, python, report, smoke_run, stderr, stdout};
use adagio::log::messages::{
    Decision, DictionaryGrowth, Evaluation, FrameTaken, Image, ModelUpdate, Odometry, PoseStamped, Transition,
};
use adagio::log::{LogReader, Message, Record, log_files};
use adagio::scenario::hex;
use serde_json::{Value, json};
use sha2::{Digest, Sha256};

/// All messages of a topic of a run.
pub fn messages<M: Message>(run: &Path, topic: &str) -> Vec<M> {
    let mut found = Vec::new();
    for (_, path) in log_files(run).unwrap() {
        for record in LogReader::open(&path).unwrap() {
            let record = record.unwrap();
            if matches!(&record, Record::Message { topic: this, .. } if **this == *topic) {
                found.push(record.decode().unwrap());
            }
        }
    }
    found
}

pub fn export(folder: &Path, arguments: &[&str]) -> Value {
    let output = adagio(folder, &[&["export"], arguments, &["--json"]].concat());
    assert!(output.status.success(), "{}", stderr(&output));
    serde_json::from_slice(&output.stdout).unwrap()
}

fn list<T>(items: &[T], value: impl Fn(&T) -> Value) -> Value {
    Value::Array(items.iter().map(value).collect())
}

#[test]
fn numpy_reads_what_the_log_holds() {
    let folder = tempfile::tempdir().unwrap();
    // Files of half a megabyte: an export goes over all of them.
    let more = ["log.file_mb=0.5", "policy.explore_share=0.25", "policy.pursue_share=1.0", "policy.explore_length=5"];
    let more: Vec<&str> = more.iter().flat_map(|set| ["--set", set]).collect();
    let run = smoke_run(folder.path(), "run", &more);
    assert!(log_files(&run).unwrap().len() > 2);
    let about = export(folder.path(), &["run", "--out", "arrays"]);
    assert_eq!((&about["frames"], &about["damaged"]), (&2001.into(), &0.into()));
    assert_eq!((&about["tasks"], &about["model"]["digest"]), (&json!(["centre", "corner"]), &report(&run)["digest"]));
    let kept: Value =
        serde_json::from_str(&std::fs::read_to_string(folder.path().join("arrays/about.json")).unwrap()).unwrap();
    assert_eq!(kept, about);
    assert!(!folder.path().join("arrays/parts").exists() && !folder.path().join("arrays/images").exists());
    let Some(printed) = python("read_export.py", &[folder.path().join("arrays").to_str().unwrap()]) else { return };
    let seen: Value = serde_json::from_str(&printed).unwrap();

    // Types and shapes are those that about.json names.
    let mut arrays = 0;
    for (file, described) in about["files"].as_object().unwrap() {
        for (name, array) in described.as_object().unwrap() {
            let found = &seen["arrays"][file][name];
            assert_eq!((&found["dtype"], &found["shape"]), (&array["dtype"], &array["shape"]), "{file} {name}");
            assert!(!array["meaning"].as_str().unwrap().is_empty());
            arrays += 1;
        }
    }
    assert_eq!(
        arrays,
        seen["arrays"].as_object().unwrap().values().map(|file| file.as_object().unwrap().len()).sum::<usize>()
    );
    assert_eq!(about["files"]["frames.npz"]["observation"]["shape"], json!([2001, 16, 32, 3]));
    assert_eq!(about["files"]["frames.npz"]["features"]["shape"], json!([2001, 61]));
    assert_eq!(about["files"]["frames.npz"]["q_values"]["shape"], json!([2001, 2, 3]));
    assert_eq!(about["files"]["model.npz"]["observation"]["shape"], json!([300, 16, 32, 3]));

    // Every frame.
    let taken: Vec<FrameTaken> = messages(&run, "/adagio/frame");
    let images: Vec<Image> = messages(&run, "/camera/observation");
    let frames = &seen["frames"];
    assert_eq!(frames["frame"], list(&taken, |frame| frame.frame.into()));
    assert_eq!(frames["stamp_ns"], list(&taken, |frame| frame.header.stamp_ns().into()));
    assert_eq!(
        frames["action"],
        list(&taken, |frame| if frame.action == 255 { json!(-1) } else { frame.action.into() })
    );
    assert_eq!(frames["boundary"], list(&taken, |frame| frame.boundary.into()));
    assert_eq!(frames["blocked"], list(&taken, |frame| frame.blocked.into()));
    assert_eq!(frames["observation_sha256"], list(&images, |image| hex(&Sha256::digest(&image.data)).into()));
    let planar = |pose: &adagio::log::messages::Pose| json!([pose.position.x, pose.position.y, pose.heading()]);
    near(&frames["pose"], &list(&messages::<PoseStamped>(&run, "/pose"), |pose| planar(&pose.pose)));
    near(&frames["odometry"], &list(&messages::<Odometry>(&run, "/odom"), |pose| planar(&pose.pose.pose)));

    // Everything else.
    let transitions: Vec<Transition> = messages(&run, "/adagio/transition");
    assert_eq!(transitions.len(), 400);
    assert_eq!(seen["transitions"]["from_frame"], list(&transitions, |t| t.from_frame.into()));
    assert_eq!(seen["transitions"]["to_frame"], list(&transitions, |t| t.to_frame.into()));
    assert_eq!(seen["transitions"]["action"], list(&transitions, |t| t.action.into()));
    assert_eq!(seen["transitions"]["blocked"], list(&transitions, |t| t.blocked.into()));
    assert_eq!(seen["transitions"]["rewards"], list(&transitions, |t| json!(t.rewards)));
    let decisions: Vec<Decision> = messages(&run, "/adagio/decision");
    assert_eq!(seen["decisions"]["frame"], list(&decisions, |d| d.frame.into()));
    assert_eq!(seen["decisions"]["epoch"], list(&decisions, |d| d.epoch.into()));
    let task = |d: &Decision| {
        about["tasks"].as_array().unwrap().iter().position(|task| *task == d.task).map_or(-1, |at| at as i64)
    };
    assert_eq!(seen["decisions"]["task"], list(&decisions, |d| task(d).into()));
    assert!(decisions.iter().any(|d| !d.task.is_empty()), "no pursuit");
    let values = |d: &Decision| if d.q_values.is_empty() { json!([null, null, null]) } else { json!(d.q_values) };
    near(&seen["decisions"]["q_values"], &list(&decisions, values));
    let models: Vec<ModelUpdate> = messages(&run, "/adagio/model");
    assert!(models.len() >= 4);
    near(&seen["models"]["slowness"], &list(&models, |model| json!(model.slowness)));
    assert_eq!(seen["models"]["asked_at_frame"], list(&models, |model| model.asked_at_frame.into()));
    let growth: Vec<DictionaryGrowth> = messages(&run, "/adagio/dictionary");
    assert_eq!(seen["growth"]["size"], list(&growth, |growth| growth.size.into()));
    let accepted: Vec<u64> = growth.iter().flat_map(|growth| growth.accepted.clone()).collect();
    assert_eq!(seen["accepted"]["frame"], json!(accepted));
    let evaluations: Vec<Evaluation> = messages(&run, "/adagio/evaluation");
    assert!(!evaluations.is_empty());
    near(&seen["evaluations"]["success"], &list(&evaluations, |evaluation| evaluation.success.into()));

    // The model that is there is the one that the features are by: numpy computes the same.
    let off = |name: &str| seen[name].as_f64().unwrap();
    println!(
        "features off by {:e}, values by {:e} of {}",
        off("features_off"),
        off("values_off"),
        off("largest_value")
    );
    // Points are rounded to 32 bits, here from numbers that differ in their last bits.
    assert!(off("features_off") < 1e-9 && off("values_off") < 1e-4 * off("largest_value"));
    // Of 400 actions those that have an inverse are told twice.
    let shape = |name: &str| about["files"]["model.npz"][name]["shape"].clone();
    let told = shape("instances")[0].as_u64().unwrap();
    assert!((500..800).contains(&told) && shape("worth") == json!([told, 2]), "{told}");

    // Linear values, too.
    smoke_run(folder.path(), "linear", &["--set", "value.method=lspi"]);
    let about = export(folder.path(), &["linear", "--out", "of_linear"]);
    assert_eq!(about["files"]["model.npz"]["weights"]["shape"], json!([2, 3, 61]));
    let Some(seen) = crate::common::python("read_export.py", &[folder.path().join("of_linear").to_str().unwrap()])
    else {
        return;
    };
    let seen: Value = serde_json::from_str(&seen).unwrap();
    let off = |name: &str| seen[name].as_f64().unwrap();
    assert!(off("features_off") < 1e-9 && off("values_off") < 1e-9 * off("largest_value"));
}

/// Numbers that were text in between may be one bit off.
fn near(found: &Value, expected: &Value) {
    match (found, expected) {
        (Value::Array(found), Value::Array(expected)) => {
            assert_eq!(found.len(), expected.len());
            found.iter().zip(expected).for_each(|(found, expected)| near(found, expected));
        }
        (Value::Null, Value::Null) => {}
        _ => {
            let (a, b) = (found.as_f64().unwrap(), expected.as_f64().unwrap());
            assert!((a - b).abs() <= 1e-14 * b.abs().max(1.0), "{a} is not {b}");
        }
    }
}

#[test]
fn images_are_what_was_learned_from() {
    let folder = tempfile::tempdir().unwrap();
    let run = smoke_run(folder.path(), "run", &["--actions", "60"]);
    export(folder.path(), &["run/run_000.mcap", "--out", "out", "--images"]);
    let images: Vec<Image> = messages(&run, "/camera/observation");
    assert_eq!(images.len(), 301);
    let files: BTreeMap<String, std::path::PathBuf> = std::fs::read_dir(folder.path().join("out/images"))
        .unwrap()
        .map(|entry| (entry.as_ref().unwrap().file_name().into_string().unwrap(), entry.unwrap().path()))
        .collect();
    assert_eq!(files.len(), 301);
    for (number, expected) in images.iter().enumerate() {
        let read = image::open(&files[&format!("{number:08}.png")]).unwrap().into_rgb8();
        assert_eq!(read.dimensions(), (32, 16));
        assert!(read.into_raw() == expected.data, "image {number}");
    }
}

#[test]
fn features_can_be_those_of_another_model_or_of_none() {
    let folder = tempfile::tempdir().unwrap();
    smoke_run(folder.path(), "run", &[]);
    let other = smoke_run(folder.path(), "other", &["--seed", "7", "--set", "slow.features=20"]);
    for (out, model) in [("a", "other"), ("b", "other/checkpoint.safetensors"), ("c", "other/run_000.mcap")] {
        let about = export(folder.path(), &["run", "--out", out, "--model", model]);
        assert_eq!(about["model"]["digest"], report(&other)["digest"], "{model}");
        assert_eq!(about["files"]["frames.npz"]["features"]["shape"], json!([2001, 21]));
    }
    let frames = |out: &str| std::fs::read(folder.path().join(out).join("frames.npz")).unwrap();
    assert!(frames("a") == frames("b") && frames("b") == frames("c"), "the same model gives the same bytes");
    // A run that is too short for a model has observations all the same.
    let short = smoke_run(folder.path(), "short", &["--actions", "10", "--set", "dictionary.budget=60"]);
    let _ = std::fs::remove_file(short.join("checkpoint.safetensors"));
    let path = short.join("run_000.mcap");
    let bytes = std::fs::read(&path).unwrap();
    std::fs::write(&path, &bytes[..bytes.len() / 2]).unwrap();
    let output = adagio(folder.path(), &["export", "short", "--out", "d"]);
    assert!([Some(0), Some(3)].contains(&output.status.code()), "{}", stderr(&output));
    assert!(stderr(&output).contains("there are no features and values"), "{}", stderr(&output));
    assert!(
        stdout(&output).contains("frames.npz: action [") && !stdout(&output).contains("features"),
        "{}",
        stdout(&output)
    );
    // Observations of another size are refused before anything is written.
    smoke_run(folder.path(), "wide", &["--actions", "60", "--set", "vision.width=64"]);
    let refused = adagio(folder.path(), &["export", "run", "--out", "e", "--model", "wide"]);
    assert_eq!(refused.status.code(), Some(2));
    assert!(stderr(&refused).contains("64 × 16 pixels, those of the run have 32 × 16"), "{}", stderr(&refused));
    assert!(!folder.path().join("e").exists());
}

#[test]
fn nothing_is_overwritten_and_damage_is_said() {
    let folder = tempfile::tempdir().unwrap();
    let run = smoke_run(folder.path(), "run", &["--actions", "120"]);
    std::fs::create_dir(folder.path().join("mine")).unwrap();
    let output = adagio(folder.path(), &["export", "run", "--out", "mine"]);
    assert_eq!(output.status.code(), Some(2));
    assert!(stderr(&output).contains("mine exists already"), "{}", stderr(&output));
    assert_eq!(std::fs::read_dir(folder.path().join("mine")).unwrap().count(), 0);
    let missing = adagio(folder.path(), &["export", "nowhere", "--out", "out"]);
    assert_eq!(missing.status.code(), Some(1));
    assert!(stderr(&missing).contains("cannot open the run nowhere"), "{}", stderr(&missing));
    assert_eq!(adagio(folder.path(), &["export", "run"]).status.code(), Some(2), "--out is needed");
    assert_eq!(adagio(folder.path(), &["export", "run", "--out", "x", "--format", "csv"]).status.code(), Some(2));
    // A chunk in the middle is damaged: the rest is exported, and the exit code says that there is less.
    let path = run.join("run_000.mcap");
    let mut bytes = std::fs::read(&path).unwrap();
    // The last part of the file is the checkpoint, which is not needed here.
    let checkpoint = run.join("checkpoint.safetensors").metadata().unwrap().len() as usize;
    let middle = (bytes.len() - checkpoint) / 2;
    bytes[middle..middle + 16].iter_mut().for_each(|byte| *byte ^= 0x55);
    std::fs::write(&path, bytes).unwrap();
    let output = adagio(folder.path(), &["export", "run", "--out", "damaged"]);
    assert_eq!(output.status.code(), Some(3), "{}", stderr(&output));
    assert!(stderr(&output).contains("could not be used"), "{}", stderr(&output));
    let about: Value =
        serde_json::from_str(&std::fs::read_to_string(folder.path().join("damaged/about.json")).unwrap()).unwrap();
    let frames = about["frames"].as_u64().unwrap();
    assert!((100..601).contains(&frames) && about["damaged"].as_u64().unwrap() > 0, "{frames}");
}
