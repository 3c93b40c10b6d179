//! Promise: bags that other programs recorded are learned from.
//!
//! The robot of the simulated lab drives; what it saw and did is packed into a bag by PyPI rosbags, as another robot's
//! recorder would have it, and replayed. See `tests/common` for `ADAGIO_PYTHON` and `ADAGIO_REQUIRE_PYTHON`.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::{Arc, OnceLock};

use crate::common::{adagio, generator, package_file, python, report, satisfies_other_tools, stderr, stdout};
use adagio::log::messages::{FrameTaken, Image};
use adagio::log::{LogReader, Record};
use adagio::robot::{Action, Pose};
use adagio::scenario::Scenario;
use adagio::source::{Frame, Source};
use adagio::world::Simulated;
use adagio::world::World;
use image::codecs::{jpeg::JpegEncoder, png::PngEncoder};
use image::{ExtendedColorType, ImageEncoder as _};
use rand::RngExt;
use serde_json::{Value, json};

const ACTIONS: usize = 400;

/// Images of another size than the scenario's camera.
const CAMERA: [&str; 3] = ["camera.width=64", "camera.height=48", "vision.cut_rows=16"];

fn smoke() -> String {
    package_file("scenarios/smoke.toml").to_str().unwrap().to_owned()
}

/// What the robot did, by the stamp of the frame: its action, and whether it was blocked if that ended there.
type Truth = BTreeMap<u64, (Action, Option<bool>)>;

/// A drive, written down for `write_bag.py`.
struct Drive {
    folder: tempfile::TempDir,
    truth: Truth,
}

/// Drives once for all tests.
fn drive() -> &'static Drive {
    static DRIVE: OnceLock<Drive> = OnceLock::new();
    DRIVE.get_or_init(|| {
        let sets: Vec<String> = CAMERA.iter().map(|&set| set.to_owned()).collect();
        let scenario = Arc::new(Scenario::load(Path::new(&smoke()), &sets).unwrap());
        let world = Arc::new(World::new(&scenario).unwrap());
        let mut robot = Simulated::new(scenario.clone(), world);
        let mut frames = vec![robot.first().unwrap()];
        let mut rng = generator(11);
        let mut chosen = Vec::new();
        for _ in 0..ACTIONS {
            let draw = rng.random_range(0.0..1.0);
            let action = Action::DRIVE[if draw < 0.5 {
                0
            } else if draw < 0.75 {
                1
            } else {
                2
            }];
            chosen.push(action);
            robot.execute(action, &mut |frame| {
                frames.push(frame);
                true
            });
        }
        let folder = tempfile::tempdir().unwrap();
        write_down(folder.path(), &scenario, &frames, &chosen);
        let truth = frames.iter().filter_map(|frame| {
            let ended = frame.boundary.as_ref().map(|boundary| boundary.blocked);
            Some((frame.stamp_ns, (frame.action?, ended)))
        });
        Drive { truth: truth.collect(), folder }
    })
}

fn write_down(folder: &Path, scenario: &Scenario, frames: &[Frame], chosen: &[Action]) {
    let (mut rgb, mut jpeg, mut png) = (Vec::new(), Vec::new(), Vec::new());
    let per_action = scenario.robot.frames_per_action;
    let put = |name: &str, file: &mut Vec<u8>, bytes: &[u8]| {
        let offset = file.len();
        file.extend_from_slice(bytes);
        json!([name, offset, bytes.len()])
    };
    let rows: Vec<Value> = frames
        .iter()
        .enumerate()
        .map(|(i, frame)| {
            let image = frame.view.image().unwrap();
            let (width, height) = (image.width as u32, image.height as u32);
            let (mut as_jpeg, mut as_png) = (Vec::new(), Vec::new());
            let encoder = JpegEncoder::new_with_quality(&mut as_jpeg, 90);
            encoder.write_image(&image.rgb, width, height, ExtendedColorType::Rgb8).unwrap();
            PngEncoder::new(&mut as_png).write_image(&image.rgb, width, height, ExtendedColorType::Rgb8).unwrap();
            let next = chosen.get(i / per_action);
            let turn = scenario.robot.turn_deg.to_radians() / scenario.robot.action_seconds;
            let command = next.map(|&action| match action {
                Action::FORWARD => [scenario.robot.forward / scenario.robot.action_seconds, 0.0],
                Action::TURN_LEFT => [0.0, turn],
                Action::TURN_RIGHT => [0.0, -turn],
                _ => unreachable!("three actions"),
            });
            json!({
                "stamp_ns": frame.stamp_ns,
                "width": width,
                "height": height,
                "rgb": put("rgb", &mut rgb, &image.rgb),
                "jpeg": put("jpeg", &mut jpeg, &as_jpeg),
                "png": put("png", &mut png, &as_png),
                "pose": [frame.truth.unwrap().position.x, frame.truth.unwrap().position.y, frame.truth.unwrap().heading],
                "odometry": odometry(frame, frames.get(i + 1)),
                "scan": ring(&frame.sonar),
                "command": command,
                "marks": marks(frame),
                "docked": is_docked(frame),
                "next_action": next.filter(|_| i % per_action == 0).map(|action| action.index()),
            })
        })
        .collect();
    std::fs::write(folder.join("frames.json"), serde_json::to_vec(&rows).unwrap()).unwrap();
    for (name, bytes) in [("rgb", rgb), ("jpeg", jpeg), ("png", png)] {
        std::fs::write(folder.join(name), bytes).unwrap();
    }
}

/// What somebody says who holds a button while the robot passes the middle, and once a name that nobody knows.
fn marks(frame: &Frame) -> Vec<&'static str> {
    let near = (frame.truth.unwrap().position - nalgebra::Point2::new(1.5, 0.9)).norm() < 0.2;
    let unknown = frame.number == 7;
    near.then_some("centre").into_iter().chain(unknown.then_some("center")).collect()
}

fn is_docked(frame: &Frame) -> bool {
    (frame.truth.unwrap().position - nalgebra::Point2::new(2.4, 0.6)).norm() < 0.3
}

/// Three poses up to the next frame, none of them at a frame; the first and last frame have some beyond them.
fn odometry(frame: &Frame, next: Option<&Frame>) -> Vec<Value> {
    let a = frame.odometry.unwrap();
    let b = next.map_or(a, |next| next.odometry.unwrap());
    let at = |share: f64| {
        let stamp = frame.stamp_ns as i64 + (share * 2e8) as i64;
        let share = share.max(0.0);
        let turned = adagio::robot::wrap(b.heading - a.heading);
        let pose = Pose::new(a.position + (b.position - a.position) * share, a.heading + share * turned);
        json!([stamp, pose.position.x, pose.position.y, pose.heading])
    };
    let before = (frame.number == 0).then(|| at(-0.1));
    before.into_iter().chain([at(1.0 / 6.0), at(0.5), at(5.0 / 6.0)]).collect()
}

/// Our ring begins straight ahead, the scan of the bag straight behind.
fn ring(sonar: &[f32]) -> Vec<f32> {
    let half = sonar.len() / 2;
    (0..sonar.len()).map(|i| sonar[(i + half) % sonar.len()]).collect()
}

/// A bag with some of the topics; `None` without Python.
fn bag(folder: &Path, topics: &str) -> Option<PathBuf> {
    let bag = folder.join("bag");
    let only = format!("--only={topics}");
    python("write_bag.py", &[drive().folder.path().to_str().unwrap(), bag.to_str().unwrap(), &only])?;
    Some(bag)
}

/// How well what a run was told of its frames agrees with what was executed.
#[derive(Debug)]
struct Agreement {
    /// Of all frames of the drive: those that are there with the action that was executed.
    frames: f64,
    /// Of all actions that were executed: those that end at their frame, as that action.
    ends: f64,
    /// Those that end there, or a frame before or after.
    about: f64,
    /// Of those that end at their frame: those that are known as blocked or not, rightly.
    blocked: f64,
}

fn agreement(run: &Path) -> Agreement {
    let truth = &drive().truth;
    let mut found: BTreeMap<u64, FrameTaken> = BTreeMap::new();
    for record in LogReader::open(&run.join("run_000.mcap")).unwrap() {
        let record = record.unwrap();
        if let Record::Message { topic, log_time_ns, .. } = &record
            && &**topic == "/adagio/frame"
        {
            found.insert(*log_time_ns, record.decode().unwrap());
        }
    }
    let (mut frames, mut ends, mut about, mut right) = (0, 0, 0, 0);
    let stamps: Vec<u64> = truth.keys().copied().collect();
    for (i, (stamp, (action, ended))) in truth.iter().enumerate() {
        let is = |stamp: &u64| found.get(stamp).filter(|taken| usize::from(taken.action) == action.index());
        frames += usize::from(is(stamp).is_some());
        let Some(blocked) = ended else { continue };
        about += usize::from(
            stamps[i.saturating_sub(1)..(i + 2).min(stamps.len())]
                .iter()
                .any(|stamp| is(stamp).is_some_and(|taken| taken.boundary)),
        );
        if let Some(taken) = is(stamp).filter(|taken| taken.boundary) {
            ends += 1;
            right += usize::from(taken.blocked == *blocked);
        }
    }
    let share = |count: usize, all: usize| count as f64 / all.max(1) as f64;
    Agreement {
        frames: share(frames, truth.len()),
        ends: share(ends, ACTIONS),
        about: share(about, ACTIONS),
        blocked: share(right, ends),
    }
}

/// The observations of a run, by their stamps.
fn observations(run: &Path) -> BTreeMap<u64, Vec<u8>> {
    let mut found = BTreeMap::new();
    for record in LogReader::open(&run.join("run_000.mcap")).unwrap() {
        let record = record.unwrap();
        if let Record::Message { topic, log_time_ns, .. } = &record
            && &**topic == "/camera/observation"
        {
            found.insert(*log_time_ns, record.decode::<Image>().unwrap().data);
        }
    }
    found
}

fn replay(folder: &Path, bag: &Path, out: &str, more: &[&str]) -> PathBuf {
    let scenario = smoke();
    let (bag, scenario) = (bag.to_str().unwrap(), scenario.as_str());
    let arguments = [&["replay", bag, "--scenario", scenario, "--out", out, "--quiet", "--no-report"], more].concat();
    let output = adagio(folder, &arguments);
    assert!(output.status.success(), "{}", stderr(&output));
    println!("{}", stdout(&output));
    folder.join(out)
}

#[test]
fn a_bag_of_raw_images_odometry_and_commands_is_learned_from() {
    let folder = tempfile::tempdir().unwrap();
    let Some(bag) = bag(folder.path(), "/camera/image_raw,/odom,/cmd_vel,/scan") else { return };
    let run = replay(folder.path(), &bag, "run", &[]);
    let agreement = agreement(&run);
    println!("cut from the motion: {agreement:?}");
    assert!(agreement.frames > 0.97 && agreement.ends > 0.8 && agreement.about > 0.95, "{agreement:?}");
    assert!(agreement.blocked > 0.95, "{agreement:?}");
    let report = report(&run);
    assert_eq!(report["imported"]["images"], 2001);
    assert_eq!(report["imported"]["frames"], 2001);
    assert_eq!(report["run"]["frames"], 2001);
    let pursuits = report["pursuits"].as_array().unwrap();
    assert!(pursuits.iter().all(|of| of["ended"] == 0), "{pursuits:?}");
    // The model knows the room that the scenario's walls describe: where the robot is can be read off its features.
    assert!(report["model"]["epoch"].as_u64().unwrap() >= 3, "{}", report["model"]);
    let off = report["pose_decode"]["kernel"]["position_rmse_m"].as_f64().unwrap();
    println!("position within {off:.3} m");
    // Whoever guesses the middle of the room is 0.81 m off.
    assert!(off < 0.6, "{off} m");
    // The run is one like any other: its log is whole, and it is repeated bit for bit.
    let checked = adagio(folder.path(), &["check", "run"]);
    assert!(checked.status.success(), "{}", stdout(&checked));
    let verified = adagio(folder.path(), &["replay", "run", "--verify", "--json", "--quiet"]);
    assert!(verified.status.success(), "{}{}", stdout(&verified), stderr(&verified));
    let verified: Value = serde_json::from_slice(&verified.stdout).unwrap();
    assert_eq!(verified["digest"], report["digest"]);
    satisfies_other_tools(&[run.join("run_000.mcap")]);
    // There is no robot to go on with.
    let resumed = adagio(folder.path(), &["resume", "run"]);
    assert_eq!(resumed.status.code(), Some(1));
    assert!(stderr(&resumed).contains("is a replay of"), "{}", stderr(&resumed));
    // Other commands take the bag for what it is.
    let info = adagio(folder.path(), &["info", "bag"]);
    assert!(info.status.success(), "{}", stderr(&info));
    assert!(stdout(&info).contains("another program") && stdout(&info).contains("/cmd_vel"), "{}", stdout(&info));
    let checked = adagio(folder.path(), &["check", "bag"]);
    assert!(checked.status.success() && stdout(&checked).contains("complete"), "{}", stdout(&checked));
    let foreign = adagio(folder.path(), &["replay", "bag"]);
    assert_eq!(foreign.status.code(), Some(1));
    assert!(stderr(&foreign).contains("--scenario FILE"), "{}", stderr(&foreign));
}

#[test]
fn every_kind_of_camera_pose_command_and_action_is_read() {
    let folder = tempfile::tempdir().unwrap();
    let Some(bag) = bag(
        folder.path(),
        "/camera/image_raw,/camera/mono,/camera/image_raw/compressed,/camera/lossless,\
        /odom,/tf,/mocap,/cmd_vel,/cmd_vel_stamped,/action,/action_name",
    ) else {
        return;
    };
    // What is what cannot be told by type alone.
    let output = adagio(folder.path(), &["replay", "bag", "--scenario", &smoke(), "--out", "none"]);
    assert_eq!(output.status.code(), Some(2));
    let text = stderr(&output);
    assert!(
        text.contains("4 topics could be topics.camera") && text.contains("--set topics.camera=/camera/"),
        "{text}"
    );
    assert!(text.contains("/cmd_vel_stamped: 2000 × geometry_msgs/msg/TwistStamped"), "{text}");
    assert!(!folder.path().join("none").exists());

    let learned = |out: &str, topics: [&str; 4]| {
        let sets: Vec<String> = ["camera", "pose", "command", "action"]
            .iter()
            .zip(topics)
            .map(|(key, topic)| format!("topics.{key}={topic}"))
            .collect();
        let mut more: Vec<&str> = sets.iter().flat_map(|set| ["--set", set]).collect();
        more.push("--no-evaluate");
        let run = replay(folder.path(), &bag, out, &more);
        let report = report(&run);
        assert_eq!(report["tasks"], json!([]));
        assert!(report["model"]["epoch"].as_u64().unwrap() >= 3, "{}", report["model"]);
        let agreement = agreement(&run);
        println!("{topics:?}: {agreement:?}");
        (observations(&run), agreement)
    };
    let (raw, by_pose) = learned("raw", ["/camera/image_raw", "/mocap", "/cmd_vel", "none"]);
    let (lossless, by_tf) = learned("lossless", ["/camera/lossless", "/tf", "/cmd_vel_stamped", "none"]);
    let (lossy, by_number) = learned("jpeg", ["/camera/image_raw/compressed", "/odom", "none", "/action"]);
    let (mono, by_name) = learned("mono", ["/camera/mono", "/odom", "none", "/action_name"]);

    // A PNG holds what was seen, a JPEG almost.
    assert_eq!((raw.len(), lossless.len()), (2001, 2001));
    assert!(raw == lossless, "observations of PNG files differ from those of the raw images");
    let off =
        |a: &[u8], b: &[u8]| a.iter().zip(b).map(|(a, b)| f64::from(a.abs_diff(*b))).sum::<f64>() / a.len() as f64;
    for (stamp, observation) in &lossy {
        assert!(off(observation, &raw[stamp]) < 4.0, "{}", off(observation, &raw[stamp]));
    }
    for (stamp, grey) in &mono {
        let expected: Vec<u8> = raw[stamp]
            .chunks(3)
            .flat_map(|p| [p.iter().map(|&v| u32::from(v)).sum::<u32>() as f64 / 3.0; 3])
            .map(|v| v.round() as u8)
            .collect();
        assert!(grey.chunks(3).all(|pixel| pixel[0] == pixel[1] && pixel[1] == pixel[2]));
        assert!(off(grey, &expected) < 2.0, "{}", off(grey, &expected));
    }
    for cut in [by_pose, by_tf] {
        assert!(cut.frames > 0.97 && cut.ends > 0.8 && cut.about > 0.95 && cut.blocked > 0.95, "{cut:?}");
    }
    // Actions that were told are those that were executed, all of them.
    for told in [by_number, by_name] {
        assert_eq!((told.frames, told.ends), (1.0, 1.0), "{told:?}");
        assert!(told.blocked > 0.9, "{told:?}");
    }

    // Where actions are the scenario's own, names and lengths are, too: here turns come first, and a move is said to be so long that
    // none reaches half of it.
    let actions = "[[action]]\nname = \"Left\"\nturn_deg = 45\n[[action]]\nname = \"right\"\nturn_deg = -45\n\
                   [[action]]\nname = \"forward\"\nforward = ";
    let program = |length: f64, out: &str, more: &[&str]| {
        let scenario = folder.path().join(format!("{out}.toml"));
        let robot = "name = \"own\"\n[robot]\nbody = \"program\"\npose = \"known\"\n";
        let task = "[[task]]\nname = \"centre\"\ngoal = [1.5, 0.9]\n";
        std::fs::write(&scenario, format!("{robot}{task}{actions}{length:?}\n")).unwrap();
        let fixed = [
            "replay",
            "bag",
            "--scenario",
            scenario.to_str().unwrap(),
            "--out",
            out,
            "--quiet",
            "--no-evaluate",
            "--no-report",
        ];
        let topics =
            ["--set", "topics.camera=/camera/mono", "--set", "topics.pose=/odom", "--set", "topics.command=none"];
        adagio(folder.path(), &[&fixed[..], &topics, more].concat())
    };
    let drive = report(&folder.path().join("mono"))["imported"].clone();
    for (length, out) in [(0.3, "own"), (1.0, "longer")] {
        let output = program(length, out, &["--set", "topics.action=/action_name"]);
        assert!(output.status.success(), "{}", stderr(&output));
        let own = report(&folder.path().join(out))["imported"].clone();
        assert_eq!(own["action_names"], json!(["Left", "right", "forward"]));
        let [forward, left, right] = [0, 1, 2].map(|number| drive["actions"][number].clone());
        assert_eq!(own["actions"], json!([left, right, forward]));
        assert_eq!(own["blocked"], if out == "own" { &drive["blocked"] } else { &drive["actions"][0] }.clone());
        assert_eq!(own["jumps"], 0);
        assert!(
            stdout(&output).contains(&format!("{left} × Left, {right} × right, {forward} × forward; ")),
            "{}",
            stdout(&output)
        );
    }
    let output = program(0.3, "none", &[]);
    assert_eq!(output.status.code(), Some(2));
    assert!(stderr(&output).contains("topics.action is not given: with [[action]]"), "{}", stderr(&output));
}

/// No pose at all: actions as they were recorded, a place that somebody marked, and a reward that the robot's own software published.
#[test]
fn a_bag_without_poses_has_marks_and_rewards() {
    let folder = tempfile::tempdir().unwrap();
    let Some(bag) = bag(folder.path(), "/camera/image_raw,/action,/adagio/mark,/docked,/charge") else { return };
    let (world, _) = std::fs::read_to_string(smoke())
        .unwrap()
        .split_once("[[task]]")
        .map(|(a, b)| (a.to_owned(), b.to_owned()))
        .unwrap();
    let scenario = format!(
        "{world}[[task]]\nname = \"centre\"\ngoal = \"shown\"\n[[task]]\nname = \"dock\"\nreward = \"topic\"\ntopic = \"/docked\"\n\
         [[task]]\nname = \"charger\"\nreward = \"topic\"\ntopic = \"/charge\"\n"
    );
    let file = folder.path().join("bag.toml");
    std::fs::write(&file, scenario).unwrap();
    let replay = |sets: &[&str], out: &str| {
        let fixed = ["replay", bag.to_str().unwrap(), "--scenario", file.to_str().unwrap(), "--out", out, "--quiet"];
        let sets: Vec<&str> = sets.iter().flat_map(|set| ["--set", set]).collect();
        adagio(folder.path(), &[&fixed[..], &["--set", "topics.action=/action"], &sets[..]].concat())
    };
    // A pose is missing: it says so, and what can be done.
    let output = replay(&[], "none");
    assert_eq!(output.status.code(), Some(2), "{}", stderr(&output));
    assert!(stderr(&output).contains("no topic can be topics.pose"), "{}", stderr(&output));
    let output = replay(&["robot.pose=none", "task.1.topic=/dock"], "none");
    assert!(stderr(&output).contains("task.1.topic = \"/dock\" has no messages"), "{}", stderr(&output));

    let output = replay(&["robot.pose=none"], "run");
    assert!(output.status.success(), "{}", stderr(&output));
    let run = folder.path().join("run");
    let told = agreement(&run);
    assert!(told.frames > 0.97 && told.ends > 0.95, "{told:?}");
    let (mut marks, mut poses, mut rewards) = (0, 0, BTreeMap::<String, Vec<f64>>::new());
    for record in LogReader::open(&run.join("run_000.mcap")).unwrap() {
        let record = record.unwrap();
        let Record::Message { topic, .. } = &record else { continue };
        match &**topic {
            "/pose" => poses += 1,
            "/adagio/mark" => {
                assert_eq!(record.decode::<adagio::log::messages::Text>().unwrap().data, "centre");
                marks += 1;
            }
            "/adagio/reward" => {
                let given: adagio::log::messages::RewardGiven = record.decode().unwrap();
                rewards.entry(given.task).or_default().push(given.reward);
            }
            _ => {}
        }
    }
    assert_eq!(poses, 0);
    assert!(marks > 20, "{marks} marks");
    let (dock, charger) = (&rewards["dock"], &rewards["charger"]);
    assert_eq!(dock.len(), charger.len());
    assert!(dock.contains(&1.0) && dock.contains(&0.0));
    assert!(dock.iter().zip(charger).all(|(dock, charge)| *charge == if *dock == 1.0 { 0.5 } else { -0.25 }));
    let report = report(&run);
    assert_eq!((&report["imported"]["unknown_marks"], &report["imported"]["without_pose"]), (&json!(1), &json!(0)));
    let unknown = report["imported"]["first_unknown_mark"].as_str().unwrap();
    assert!(unknown.contains("\"center\" marks nothing") && unknown.contains("(centre)"), "{unknown}");
    let page = std::fs::read_to_string(run.join("report.html")).unwrap();
    assert!(page.contains("What was shown of centre"));
    let verified = adagio(folder.path(), &["replay", "run", "--verify", "--quiet"]);
    assert!(verified.status.success(), "{}{}", stdout(&verified), stderr(&verified));
}
