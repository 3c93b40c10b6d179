//! Views by a graphics processor: the same pictures as the processor's, and what happens when there is none or it fails.
//!
//! See `tests/common` for the device that draws.

use std::collections::HashSet;
use std::path::{Path, PathBuf};

use adagio::robot::Pose;
use adagio::scenario::{Change, ChangeKind, Scenario};
use adagio::vision::Image;
use adagio::vision::observe;
use adagio::world::{Appearance, Eye, World};
use nalgebra::{Point2, Vector2};
use rand::RngExt;
use serde_json::Value;

use crate::common::{adagio_on, device, generator, long, package_file, stderr};

/// All scenarios of the package.
fn scenarios() -> Vec<PathBuf> {
    let folders = [package_file("scenarios"), package_file("scenarios/soak")];
    let files = folders.iter().flat_map(|folder| std::fs::read_dir(folder).unwrap());
    let mut files: Vec<PathBuf> = files.map(|file| file.unwrap().path()).filter(|path| path.is_file()).collect();
    files.sort();
    files
}

fn random_poses(world: &World, count: usize, seed: u64) -> Vec<Eye> {
    let mut rng = generator(seed);
    let cells: Vec<Point2<f64>> = world.plan.reachable_cells().collect();
    let mut draw = || {
        let offset = Vector2::new(rng.random_range(-0.02..0.02), rng.random_range(-0.02..0.02));
        let heading = rng.random_range(-std::f64::consts::PI..std::f64::consts::PI);
        let pose = Pose::new(cells[rng.random_range(0..cells.len())] + offset, heading);
        Eye::from((pose, rng.random_range(0..100_000)))
    };
    (0..count).map(|_| draw()).collect()
}

/// How two renderers' pictures differ.
#[derive(Debug, Default)]
struct Difference {
    /// Share of all observed values that differ by more than one grey level.
    share: f64,
    /// Root mean square of a view's differences, grey levels: the largest.
    worst_view: f64,
    /// The largest difference of a value.
    largest: u8,
}

fn compare(scenario: &Scenario, ours: &[Image], theirs: &[Image]) -> Difference {
    let mut found = Difference::default();
    let (mut count, mut differ) = (0usize, 0usize);
    for (a, b) in ours.iter().zip(theirs) {
        assert_eq!((a.width, a.height, a.cropped), (b.width, b.height, b.cropped));
        let [a, b] = [a, b].map(|image| observe(image, &scenario.vision, 0).pixels);
        let apart: Vec<u8> = a.iter().zip(&b).map(|(a, b)| a.abs_diff(*b)).collect();
        count += apart.len();
        differ += apart.iter().filter(|&&apart| apart > 1).count();
        found.largest = found.largest.max(*apart.iter().max().unwrap());
        let squared = apart.iter().map(|&apart| f64::from(apart).powi(2)).sum::<f64>() / apart.len() as f64;
        found.worst_view = found.worst_view.max(squared.sqrt());
    }
    found.share = differ as f64 / count as f64;
    found
}

#[test]
fn a_device_draws_what_the_processor_draws_in_every_scenario() {
    let Some((_turn, gpu)) = device() else { return };
    println!("{}", gpu.name());
    // Drivers in software are slow. Pixels that differ come in few views, in which a wall is seen edge-on, so that their share among
    // a hundred views is less certain than among a thousand.
    let (views, share) = if long() { (1000, 2e-4) } else { (100, 1e-3) };
    let (mut drawn, mut shares) = (HashSet::new(), Vec::new());
    for path in scenarios() {
        let scenario = Scenario::load(&path, &[]).unwrap();
        // Many scenarios look alike.
        if !drawn.insert(format!("{:?}", (&scenario.world, &scenario.camera, &scenario.vision, &scenario.changes))) {
            continue;
        }
        let world = World::new(&scenario).unwrap();
        let drawn_by = Appearance::new(&scenario).unwrap().on(gpu.clone());
        let poses = random_poses(&world, views, 7);
        // The world as it looks at first, and after each change of its papers.
        let papered = |change: &&Change| matches!(change.what, ChangeKind::Texture { .. });
        let changes = scenario.changes.iter().filter(papered).map(|change| change.first_frame(&scenario.robot));
        for frame in std::iter::once(0).chain(changes) {
            let mut ours = vec![Image::default(); poses.len()];
            let mut theirs = ours.clone();
            for (image, eye) in ours.iter_mut().zip(&poses) {
                world.appearance.render_into(eye, frame, image);
            }
            assert!(drawn_by.render_by_device(frame, &poses, &mut theirs), "{:?}", drawn_by.rendered_by());
            let found = compare(&scenario, &ours, &theirs);
            println!("{} frame {frame}: {found:?}", path.display());
            // Some times what a driver in software comes to: others may round otherwise. Rendering for vision alone makes a
            // difference of 2 grey levels in every view.
            assert!(found.share <= share && found.worst_view <= 3.0, "{} frame {frame}: {found:?}", path.display());
            shares.push(found.share);
        }
    }
    let mean = shares.iter().sum::<f64>() / shares.len() as f64;
    assert!(mean <= 2e-4, "{shares:?}");
}

/// Full pictures, as a robot's camera would send them, and one view at a time.
#[test]
fn a_device_draws_full_pictures_and_single_views() {
    let Some((_turn, gpu)) = device() else { return };
    // As it is, and of a size that leaves threads with pixels beyond the end of their view.
    let odd = ["camera.detail=full", "camera.width=63", "camera.height=47", "vision.cut_rows=11"];
    for sets in [&odd[..1], &odd] {
        let sets: Vec<String> = sets.iter().map(|&set| set.to_owned()).collect();
        let scenario = Scenario::load(&package_file("scenarios/two_rooms.toml"), &sets).unwrap();
        let world = World::new(&scenario).unwrap();
        let drawn_by = Appearance::new(&scenario).unwrap().on(gpu.clone());
        let poses = random_poses(&world, 40, 8);
        let mut ours = vec![Image::default(); poses.len()];
        let (mut theirs, mut single) = (ours.clone(), ours.clone());
        for (i, eye) in poses.iter().enumerate() {
            world.appearance.render_into(eye, 0, &mut ours[i]);
            drawn_by.render_into(eye, 0, &mut single[i]);
        }
        assert!(drawn_by.render_by_device(0, &poses, &mut theirs));
        assert_eq!((theirs[0].width, theirs[0].height), (scenario.camera.width, scenario.camera.height));
        // What a device draws does not depend on what else it draws.
        assert_eq!(single, theirs);
        let found = compare(&scenario, &ours, &theirs);
        assert!(found.share <= 2e-4 && found.worst_view <= 3.0, "{sets:?}: {found:?}");
    }
}

#[test]
fn a_device_that_is_lost_is_told_once_and_the_processor_goes_on() {
    let Some((_turn, gpu)) = device() else { return };
    let scenario = Scenario::load(&package_file("scenarios/smoke.toml"), &[]).unwrap();
    let world = World::new(&scenario).unwrap();
    let appearance = Appearance::new(&scenario).unwrap().on(gpu.clone());
    let poses = random_poses(&world, 100, 9);
    let mut images = vec![Image::default(); poses.len()];
    assert!(appearance.render_by_device(0, &poses, &mut images));
    assert_eq!(appearance.rendered_by().unwrap().gpu.as_deref(), Some(gpu.name()));
    assert_eq!(appearance.missing_device(), None);
    gpu.lose();
    for _ in 0..2 {
        assert!(!appearance.render_by_device(0, &poses, &mut images));
        let by = appearance.rendered_by().unwrap();
        // It did a part of the work, and that stays known.
        assert_eq!(by.gpu.as_deref(), Some(gpu.name()));
        assert!(!by.is_device() && by.failed.as_ref().unwrap().contains("has failed"), "{by:?}");
        assert!(by.to_string().ends_with("and the processor went on"), "{by}");
    }
    assert!(appearance.missing_device().unwrap().contains("has failed"));
    // Single views, too.
    let eye = &poses[0];
    let (mut ours, mut theirs) = (Image::default(), Image::default());
    appearance.render_into(eye, 0, &mut ours);
    world.appearance.render_into(eye, 0, &mut theirs);
    assert_eq!(ours, theirs);
}

/// A run and its trials, with what is drawn by whom.
fn drive(folder: &Path, arguments: &[&str], gpu: &str) -> (Value, String) {
    let output = adagio_on(gpu, folder, arguments);
    assert!(output.status.success(), "{}", stderr(&output));
    (serde_json::from_slice(&output.stdout).unwrap(), stderr(&output))
}

#[test]
fn a_policy_learned_on_one_renderer_works_on_the_other() {
    if device().is_none() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let lab = package_file("scenarios/lab.toml");
    let learn = |name: &str, renderer: &str| {
        let set = format!("world.renderer={renderer}");
        let run = ["run", lab.to_str().unwrap(), "--seed", "21", "--actions", "1000", "--set", &set, "--out", name];
        let few = ["--set", "robot.frames_per_action=2", "--set", "evaluate.every=0", "--set", "evaluate.starts=100"];
        drive(folder.path(), &[&run[..], &few, &["--no-report", "--json", "--quiet"]].concat(), "software").0
    };
    let success = |tasks: &Value| {
        let tasks = tasks["tasks"].as_array().unwrap();
        tasks.iter().map(|task| task["success"].as_f64().unwrap()).sum::<f64>() / tasks.len() as f64
    };
    let (by_cpu, by_gpu) = (learn("cpu", "cpu"), learn("gpu", "gpu"));
    assert!(by_cpu["computed_by"]["pictures"].is_null());
    assert!(by_gpu["computed_by"]["pictures"]["gpu"].is_string(), "{}", by_gpu["computed_by"]);
    // How close the two came is told.
    let compared = adagio_on("none", folder.path(), &["compare", "cpu", "gpu", "--json"]);
    let compared: Value = serde_json::from_slice(&compared.stdout).unwrap();
    println!("{}", compared["observations"]);
    assert!(compared["computed_by"][0]["pictures"].is_null());
    assert_eq!(compared["computed_by"][1], by_gpu["computed_by"]);
    assert!(compared["observations"]["frames"].as_u64().unwrap() > 100, "{}", compared["observations"]);
    assert!(compared["observations"]["share"].as_f64().unwrap() <= 2e-4, "{}", compared["observations"]);
    let said = adagio_on("none", folder.path(), &["compare", "cpu", "gpu"]);
    assert!(String::from_utf8_lossy(&said.stdout).contains("can only be close"), "{said:?}");
    // The same policy in the other renderer's pictures: the scenario of the run asks for a device that is there, or is not.
    let evaluate = |run: &str, gpu| drive(folder.path(), &["evaluate", run, "--starts", "100", "--json"], gpu);
    let (elsewhere, warning) = evaluate("gpu", "none");
    assert!(warning.contains("world.renderer is \"gpu\", and the processor renders"), "{warning}");
    let here = success(&by_gpu);
    assert!(here >= 0.9 && success(&elsewhere) >= here - 0.02, "{here} and {elsewhere}");
    let text = std::fs::read_to_string(folder.path().join("cpu/scenario.toml")).unwrap();
    std::fs::write(folder.path().join("cpu/scenario.toml"), text.replace("\"cpu\"", "\"gpu\"")).unwrap();
    let (elsewhere, _) = evaluate("cpu", "software");
    let here = success(&by_cpu);
    assert!(here >= 0.9 && success(&elsewhere) >= here - 0.02, "{here} and {elsewhere}");
}
