//! Promise: another program's log that is not as it should be gives one clear error, or frames that are left out and
//! counted; never a panic, never memory for sizes that are only claimed.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::BufWriter;
use std::path::{Path, PathBuf};
use std::process::Output;
use std::sync::Arc;

use crate::common::{adagio, package_file, report, stderr, stdout};
use crate::export::messages;
use adagio::log::messages::foreign::{CompressedImage, Int32};
use adagio::log::messages::{self as msg, Header, Image, LaserScan, Odometry, PoseWithCovariance, Twist, Vector3};
use adagio::log::{Message, cdr};
use adagio::robot::Action;
use adagio::scenario::Scenario;
use adagio::source::imported::{LogContents, frames_per_action};
use adagio::source::{Imported, Source, View};
use image::codecs::jpeg::JpegEncoder;
use image::{ExtendedColorType, ImageEncoder as _};
use rand::RngExt;
use serde_json::Value;

const START_NS: u64 = 1_700_000_000_000_000_000;
const INTERVAL_NS: u64 = 100_000_000;
const SIZE: (u32, u32) = (64, 48);

/// A bag, message by message.
struct Bag {
    writer: mcap::Writer<BufWriter<File>>,
    channels: BTreeMap<String, u16>,
}

impl Bag {
    fn new(path: &Path) -> Self {
        Bag::with(path, mcap::WriteOptions::new())
    }

    fn with(path: &Path, options: mcap::WriteOptions) -> Self {
        let options = options.profile("ros2").chunk_size(Some(64 << 10)).compression_threads(0);
        let writer = options.create(BufWriter::new(File::create(path).unwrap())).unwrap();
        Bag { writer, channels: BTreeMap::new() }
    }

    fn write<M: Message>(&mut self, topic: &str, at_ns: u64, message: &M) {
        self.write_as(topic, M::TYPE, "cdr", at_ns, &cdr::encode(message).unwrap());
    }

    fn write_as(&mut self, topic: &str, kind: &str, encoding: &str, at_ns: u64, data: &[u8]) {
        let channel_id = *self.channels.entry(topic.to_owned()).or_insert_with(|| {
            let schema = self.writer.add_schema(kind, "ros2msg", b"").unwrap();
            self.writer.add_channel(schema, topic, encoding, &BTreeMap::new()).unwrap()
        });
        let header = mcap::records::MessageHeader { channel_id, sequence: 0, log_time: at_ns, publish_time: at_ns };
        self.writer.write_to_known_channel(&header, data).unwrap();
    }

    fn end(mut self) {
        self.writer.finish().unwrap();
    }
}

/// The robot drives a square: pose and command of each frame, ten frames a second, one action a second.
fn square(frame: u64) -> (f64, f64, f64, f64) {
    let (mut x, mut y, mut heading) = (0.8f64, 0.6f64, 0.0f64);
    let mut command = 0.0;
    for i in 1..=frame {
        // Four actions a side: two ahead, two turns.
        command = if (i - 1) / 10 % 4 < 2 { 0.3 } else { 0.0 };
        x += 0.1 * command * heading.cos();
        y += 0.1 * command * heading.sin();
        heading += if command == 0.0 { std::f64::consts::FRAC_PI_4 / 10.0 } else { 0.0 };
    }
    (x, y, heading, command)
}

fn stamp(frame: u64) -> u64 {
    START_NS + frame * INTERVAL_NS
}

fn odometry(frame: u64) -> Odometry {
    let (x, y, heading, _) = square(frame);
    Odometry {
        header: Header::new(stamp(frame), "odom"),
        pose: PoseWithCovariance { pose: msg::Pose::planar(x, y, heading), ..Default::default() },
        ..Default::default()
    }
}

/// What is seen changes with the pose, so that there is something to learn.
fn pixels(frame: u64) -> Vec<u8> {
    let (x, y, heading, _) = square(frame);
    let (width, height) = SIZE;
    let value = |column: u32, row: u32, channel: u32| {
        let angle = heading + f64::from(column) / f64::from(width);
        let wave = (3.0 * angle + f64::from(channel)).sin() + (2.0 * x + 3.0 * y + 0.1 * f64::from(row)).cos();
        (128.0 + 50.0 * wave) as u8
    };
    (0..height).flat_map(|y| (0..3 * width).map(move |i| value(i / 3, y, i % 3))).collect()
}

fn image(frame: u64) -> Image {
    let (width, height) = SIZE;
    let header = Header::new(stamp(frame), "camera");
    Image { header, height, width, encoding: "rgb8".into(), is_bigendian: 0, step: 3 * width, data: pixels(frame) }
}

fn compressed(frame: u64) -> CompressedImage {
    let mut data = Vec::new();
    let (width, height) = SIZE;
    let encoder = JpegEncoder::new_with_quality(&mut data, 90);
    encoder.write_image(&pixels(frame), width, height, ExtendedColorType::Rgb8).unwrap();
    CompressedImage { header: Header::new(stamp(frame), "camera"), format: "jpeg".into(), data }
}

fn command(frame: u64) -> Twist {
    let (.., speed) = square(frame + 1);
    Twist { linear: Vector3 { x: speed, ..Default::default() }, ..Default::default() }
}

/// A bag of so many frames; `picture` writes the image of each.
fn bag(folder: &Path, frames: u64, mut picture: impl FnMut(&mut Bag, u64)) -> PathBuf {
    let path = folder.join("bag.mcap");
    let mut bag = Bag::new(&path);
    for frame in 0..frames {
        picture(&mut bag, frame);
        bag.write("/odom", stamp(frame), &odometry(frame));
        bag.write("/cmd_vel", stamp(frame), &command(frame));
    }
    bag.end();
    path
}

fn replay(folder: &Path, more: &[&str]) -> Output {
    let smoke = package_file("scenarios/smoke.toml");
    let arguments =
        ["replay", "bag.mcap", "--scenario", smoke.to_str().unwrap(), "--out", "run", "--no-evaluate", "--no-report"];
    // Short bags still give a model.
    let small = ["--quiet", "--set", "dictionary.sigma_frames=50", "--set", "slow.features=10"];
    adagio(folder, &[&arguments[..], &small, more].concat())
}

/// It was learned from: what came of the bag.
fn imported(folder: &Path, more: &[&str]) -> Value {
    let output = replay(folder, more);
    assert!(output.status.success(), "{}{}", stdout(&output), stderr(&output));
    let report = report(&folder.join("run"));
    assert!(report["model"]["epoch"].as_u64().unwrap() >= 1, "{}", report["model"]);
    report["imported"].clone()
}

/// It was refused, in this way, and nothing was begun.
fn refused(folder: &Path, more: &[&str], code: i32, parts: &[&str]) {
    let output = replay(folder, more);
    let text = stderr(&output);
    assert_eq!(output.status.code(), Some(code), "{text}");
    assert!(!text.contains("panicked"), "{text}");
    for part in parts {
        assert!(text.contains(part), "{part:?} is not in: {text}");
    }
    assert!(!folder.join("run").exists());
}

#[test]
fn a_square_is_cut_into_its_actions() {
    let folder = tempfile::tempdir().unwrap();
    bag(folder.path(), 641, |bag, frame| bag.write("/image", stamp(frame), &image(frame)));
    let found = imported(folder.path(), &[]);
    assert_eq!(found["actions"], serde_json::json!([32, 32, 0]));
    assert_eq!((&found["images"], &found["frames"], &found["blocked"]), (&641.into(), &641.into(), &0.into()));
    let text = std::fs::read_to_string(folder.path().join("run/scenario.toml")).unwrap();
    assert!(text.contains("\nframes_per_action = 10 "), "{text}");
    // Every second image of it.
    std::fs::remove_dir_all(folder.path().join("run")).unwrap();
    let found = imported(folder.path(), &["--set", "topics.every=2"]);
    assert_eq!((&found["images"], &found["actions"]), (&321.into(), &serde_json::json!([32, 32, 0])));
}

#[test]
fn gaps_and_stops_interrupt_what_is_learned_and_are_counted() {
    let folder = tempfile::tempdir().unwrap();
    // One image is missing here and there, which is no gap; 30 are missing once; and the robot stands for 5 seconds.
    let stopped = |frame: u64| if frame < 400 { frame } else { frame.saturating_sub(50).max(400) };
    let path = folder.path().join("bag.mcap");
    let mut bag = Bag::new(&path);
    for frame in 0..691 {
        let moved = stopped(frame);
        if frame % 97 != 50 && !(200..230).contains(&frame) {
            bag.write("/image", stamp(frame), &Image { header: Header::new(stamp(frame), ""), ..image(moved) });
        }
        bag.write("/odom", stamp(frame), &Odometry { header: Header::new(stamp(frame), ""), ..odometry(moved) });
    }
    bag.end();
    let found = imported(folder.path(), &[]);
    assert_eq!((&found["images"], &found["gaps"]), (&654.into(), &1.into()));
    // 64 actions were driven, 3 of them unseen; the stop is 50 images long, and begins and ends to the frame.
    let actions: u64 = found["actions"].as_array().unwrap().iter().map(|count| count.as_u64().unwrap()).sum();
    assert_eq!(actions, 61, "{found}");
    let left_out = found["without_action"].as_u64().unwrap();
    assert!((48..=50).contains(&left_out), "{found}");
    assert_eq!(found["frames"].as_u64().unwrap() + left_out, 654);
    // The run's own log has no hole: what was left out never was a frame of it.
    let checked = adagio(folder.path(), &["check", "run"]);
    assert!(checked.status.success(), "{}", stdout(&checked));
}

#[test]
fn a_pose_that_jumps_is_no_action() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("bag.mcap");
    let mut bag = Bag::new(&path);
    for frame in 0..641 {
        bag.write("/image", stamp(frame), &image(frame));
        // Its localisation is 4 m off from the 15th action on.
        let mut odometry = odometry(frame);
        odometry.pose.pose.position.y += if frame > 150 { 4.0 } else { 0.0 };
        bag.write("/odom", stamp(frame), &odometry);
    }
    bag.end();
    let found = imported(folder.path(), &[]);
    assert_eq!((&found["jumps"], &found["gaps"]), (&1.into(), &0.into()));
    assert_eq!(found["actions"], serde_json::json!([32, 32, 0]), "nine tenths of an action are one, too");
}

/// What the run's log says of odometry: stamps, and poses.
fn counted(run: &Path) -> Vec<(u64, [f64; 3])> {
    let of = |odometry: Odometry| {
        let pose = odometry.pose.pose;
        (odometry.header.stamp.stamp_ns(), [pose.position.x, pose.position.y, pose.heading()])
    };
    messages::<Odometry>(run, "/odom").into_iter().map(of).collect()
}

#[test]
fn odometry_is_the_topic_that_is_not_the_pose_and_its_jumps_are_breaks() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("bag.mcap");
    let mut bag = Bag::new(&path);
    // The wheels count from where the robot was switched on, and somebody switches them off and on at the 30th action.
    let wheels = |frame: u64| {
        let (x, y, heading, _) = square(frame);
        [y + 7.0 + if frame > 300 { 5.0 } else { 0.0 }, -x, heading - std::f64::consts::FRAC_PI_2]
    };
    for frame in 0..641 {
        bag.write("/image", stamp(frame), &image(frame));
        let [x, y, heading] = wheels(frame);
        let pose = PoseWithCovariance { pose: msg::Pose::planar(x, y, heading), ..Default::default() };
        // Between the images.
        let at = stamp(frame) - INTERVAL_NS / 2;
        let counted = Odometry { header: Header::new(at, "odom"), pose, ..Default::default() };
        bag.write("/wheels", at, &counted);
        bag.write("/mocap", stamp(frame), &odometry(frame));
    }
    bag.end();
    let mocap = ["--set", "topics.pose=/mocap"];
    refused(folder.path(), &[], 2, &["2 topics could be topics.pose"]);
    let found = imported(folder.path(), &mocap);
    // The image between the two counts lies between the two places: it has nothing to do with either.
    assert_eq!((&found["jumps"], &found["gaps"], &found["without_pose"]), (&2.into(), &0.into(), &0.into()));
    let said = counted(&folder.path().join("run"));
    assert!(said.len() > 600, "{}", said.len());
    // The image between the two wheels, and the last one, after which nothing was counted.
    let between = |frame: u64| [300, 640].contains(&frame);
    for (at, pose) in said {
        let frame = (at - START_NS) / INTERVAL_NS;
        assert!(frame != 640, "{pose:?}");
        let (a, b) = (wheels(frame), wheels(frame + 1));
        for i in 0..if between(frame) { 0 } else { 3 } {
            assert!(
                adagio::robot::wrap(pose[i] - 0.5 * (a[i] + b[i])).abs() < 1e-6,
                "frame {frame}: {pose:?}, {a:?}, {b:?}"
            );
        }
    }
    std::fs::remove_dir_all(folder.path().join("run")).unwrap();
    let found = imported(folder.path(), &[&mocap[..], &["--set", "topics.odometry=none"]].concat());
    assert_eq!((&found["jumps"], &found["frames"]), (&0.into(), &641.into()));
    assert!(counted(&folder.path().join("run")).is_empty());
}

#[test]
fn the_files_of_a_split_bag_follow_each_other_by_their_numbers() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::create_dir(folder.path().join("split")).unwrap();
    for (number, frames) in [(0, 0..200), (2, 200..400), (10, 400..641)] {
        let mut bag = Bag::new(&folder.path().join(format!("split/split_{number}.mcap")));
        for frame in frames {
            bag.write("/odom", stamp(frame), &odometry(frame));
            bag.write("/image", stamp(frame), &image(frame));
        }
        bag.end();
    }
    std::fs::write(folder.path().join("split/metadata.yaml"), "rosbag2_bagfile_information:").unwrap();
    std::fs::rename(folder.path().join("split"), folder.path().join("bag.mcap")).unwrap();
    let found = imported(folder.path(), &[]);
    assert_eq!((&found["frames"], &found["out_of_order"], &found["gaps"]), (&641.into(), &0.into(), &0.into()));
}

#[test]
fn our_own_logs_are_replayed_without_a_scenario() {
    let folder = tempfile::tempdir().unwrap();
    let run = crate::common::smoke_run(folder.path(), "other", &["--actions", "30"]);
    std::fs::rename(run.join("run_000.mcap"), folder.path().join("bag.mcap")).unwrap();
    refused(folder.path(), &[], 2, &["bag.mcap is a log of our own", "without --scenario"]);
}

/// No bytes make it panic: checksums are left out, so that the messages themselves are damaged.
#[test]
fn mutated_bags_are_read_to_their_end() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("bag.mcap");
    let mut bag = Bag::with(&path, mcap::WriteOptions::new().compression(None).calculate_chunk_crcs(false));
    for frame in 0..60 {
        let file = compressed(frame);
        bag.write("/image", stamp(frame), &file);
        bag.write("/odom", stamp(frame), &odometry(frame));
        bag.write("/cmd_vel", stamp(frame), &command(frame));
        let scan = LaserScan { angle_increment: 0.1, range_max: 5.0, ranges: vec![1.0; 63], ..Default::default() };
        bag.write("/scan", stamp(frame), &scan);
    }
    bag.end();
    let whole = std::fs::read(&path).unwrap();
    let sets = ["dictionary.sigma_frames=50".to_owned()];
    let scenario = Arc::new(Scenario::load(&package_file("scenarios/smoke.toml"), &sets).unwrap());
    let mut rng = crate::common::generator(5);
    let (mut read, mut refused, mut frames) = (0, 0, 0);
    for _ in 0..400 {
        let mut bytes = whole.clone();
        for _ in 0..rng.random_range(1..40) {
            let at = rng.random_range(0..bytes.len());
            bytes[at] = rng.random_range(0..=255);
        }
        std::fs::write(&path, &bytes).unwrap();
        let begun = LogContents::of(&path, scenario.topics.stamps).and_then(|survey| {
            let roles = survey.roles(&scenario)?;
            let _ = frames_per_action(&survey, &roles, &scenario);
            Imported::open(scenario.clone(), &survey, &roles)
        });
        let Ok(mut source) = begun else {
            refused += 1;
            continue;
        };
        read += 1;
        let mut next = source.first();
        let mut more = true;
        while let Some(frame) = next.take() {
            assert!(matches!(&frame.view, View::Observation(pixels) if pixels.len() == 3 * 32 * 16));
            frames += 1;
            while more {
                more = source.execute(Action::FORWARD, &mut |_| {
                    frames += 1;
                    true
                });
            }
        }
        let report = source.report();
        assert_eq!(
            report.frames + report.without_action + report.unusable_images + report.out_of_order + report.without_pose,
            report.images
        );
    }
    println!("{read} read with {frames} frames, {refused} refused");
    assert!(read > 200 && frames > 40 * read, "{read} read with {frames} frames");
}

#[test]
fn topics_that_are_missing_or_of_another_type_are_named_with_those_that_are_there() {
    let folder = tempfile::tempdir().unwrap();
    bag(folder.path(), 50, |_, _| {});
    let there = "/odom: 50 × nav_msgs/msg/Odometry";
    refused(folder.path(), &[], 2, &["no topic can be topics.camera", "sensor_msgs/msg/CompressedImage", there]);
    refused(folder.path(), &["--set", "topics.camera=/eye"], 2, &["topics.camera = \"/eye\" has no messages", there]);
    refused(folder.path(), &["--set", "topics.camera=/odom"], 2, &["holds nav_msgs/msg/Odometry as cdr", there]);
    refused(folder.path(), &["--set", "topics.camera=none"], 2, &["topics.camera = \"none\""]);
    bag(folder.path(), 50, |bag, frame| {
        bag.write("/image", stamp(frame), &image(frame));
        bag.write("/map_pose", stamp(frame), &msg::PoseStamped::default());
    });
    refused(folder.path(), &[], 2, &["2 topics could be topics.pose", "--set topics.pose=/map_pose"]);
    // Images that are not CDR are none that we read.
    bag(folder.path(), 50, |bag, frame| bag.write_as("/image", Image::TYPE, "protobuf", stamp(frame), b"\x08\x01"));
    refused(folder.path(), &[], 2, &["/image: 50 × sensor_msgs/msg/Image as protobuf"]);
    refused(folder.path(), &["--set", "topic.camera=/image"], 2, &["topic.camera"]);
}

#[test]
fn images_that_cannot_be_used_are_one_error_if_all_are_so_and_counted_else() {
    let folder = tempfile::tempdir().unwrap();
    type Spoil = fn(&mut Image);
    let spoilt: [(Spoil, &str); 6] = [
        (|image| image.encoding = "16UC1".into(), "its encoding is \"16UC1\""),
        (|image| image.data.truncate(9000), "9000 bytes of data: 48 lines of 192 bytes need 9216"),
        (|image| image.step = 64, "step = 64 bytes: 64 pixels of rgb8 need 192"),
        (|image| (image.width, image.height) = (u32::MAX, u32::MAX), "4294967295 × 4294967295 pixels"),
        (|image| (image.width, image.step) = (1 << 20, 3 << 20), "1048576 × 48 pixels"),
        (|image| (image.width, image.height) = (16, 8), "of its 16 × 8 pixels 3 lines are cut away"),
    ];
    for (spoil, reason) in spoilt {
        bag(folder.path(), 40, |bag, frame| {
            let mut image = image(frame);
            spoil(&mut image);
            bag.write("/image", stamp(frame), &image);
        });
        refused(folder.path(), &[], 1, &["none of 40 images could be used", reason]);
        bag(folder.path(), 641, |bag, frame| {
            let mut image = image(frame);
            if frame % 100 == 7 {
                spoil(&mut image);
            }
            bag.write("/image", stamp(frame), &image);
        });
        let found = imported(folder.path(), &[]);
        assert_eq!((&found["unusable_images"], &found["frames"]), (&7.into(), &634.into()), "{found}");
        assert!(found["first_unusable"].as_str().unwrap().contains(reason), "{found}");
        assert_eq!(found["actions"], serde_json::json!([32, 32, 0]));
        std::fs::remove_dir_all(folder.path().join("run")).unwrap();
    }
}

#[test]
fn corrupt_image_files_are_counted() {
    let folder = tempfile::tempdir().unwrap();
    let spoil = |frame: u64, data: &mut Vec<u8>| match frame % 100 {
        7 => data.clear(),
        17 => data.truncate(data.len() / 3),
        27 => *data = b"this is no image at all".to_vec(),
        37 => {
            let at = data.windows(2).position(|bytes| bytes == [0xff, 0xc0]).unwrap();
            data[at + 5..at + 9].copy_from_slice(&[0xff; 4]);
        }
        _ => {}
    };
    bag(folder.path(), 641, |bag, frame| {
        let mut image = compressed(frame);
        spoil(frame, &mut image.data);
        bag.write("/image", stamp(frame), &image);
    });
    let found = imported(folder.path(), &[]);
    // A JPEG that ends early may still be shown: the decoder's word counts, and it is the same every time.
    let unusable = found["unusable_images"].as_u64().unwrap();
    assert!((21..=28).contains(&unusable), "{found}");
    assert_eq!(found["frames"].as_u64().unwrap() + unusable, 641, "{found}");
}

#[test]
fn clocks_that_differ_and_a_robot_that_stands_are_said_to() {
    let folder = tempfile::tempdir().unwrap();
    let other_clock = |frame: u64| Header::new(5_000_000_000 + frame * INTERVAL_NS, "");
    bag(folder.path(), 641, |bag, frame| {
        bag.write("/image", stamp(frame), &Image { header: other_clock(frame), ..image(frame) });
    });
    let parts = ["none lies between two poses", "/image from 5.000 to 69.000 s", "do their clocks differ"];
    refused(folder.path(), &[], 1, &parts);
    let found = imported(folder.path(), &["--set", "topics.stamps=log"]);
    assert_eq!(found["actions"], serde_json::json!([32, 32, 0]));
    std::fs::remove_dir_all(folder.path().join("run")).unwrap();

    bag(folder.path(), 100, |bag, frame| {
        bag.write("/still", stamp(frame), &Odometry { header: Header::new(stamp(frame), ""), ..odometry(3) });
        bag.write("/image", stamp(frame), &image(3).with_stamp(stamp(frame)));
    });
    let still = ["--set", "topics.pose=/still", "--set", "topics.command=none"];
    refused(folder.path(), &still, 1, &["the robot stands still", "robot.forward = 0.3 m", "action_seconds = 1 s"]);
    // Images every minute are no film.
    bag(folder.path(), 20, |bag, frame| {
        bag.write("/image", stamp(600 * frame), &image(frame).with_stamp(stamp(600 * frame)));
    });
    refused(folder.path(), &[], 2, &["images come every 60.0000 s", "1 to 100"]);
    // A word for no action, all the time.
    bag(folder.path(), 100, |bag, frame| {
        bag.write("/image", stamp(frame), &image(frame));
        bag.write("/action", stamp(frame), &Int32 { data: -1 });
    });
    refused(folder.path(), &["--set", "topics.action=/action"], 1, &["no action of \"/action\" lies among them"]);
}

trait WithStamp {
    fn with_stamp(self, stamp_ns: u64) -> Self;
}

impl WithStamp for Image {
    fn with_stamp(mut self, stamp_ns: u64) -> Self {
        self.header = Header::new(stamp_ns, "camera");
        self
    }
}

#[test]
fn what_is_no_log_or_a_damaged_one_is_said_to_be() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("bag.mcap"), "this is no log").unwrap();
    refused(folder.path(), &[], 2, &["no topic can be topics.camera", "no messages"]);
    std::fs::remove_file(folder.path().join("bag.mcap")).unwrap();
    refused(folder.path(), &[], 1, &["cannot open the log bag.mcap"]);
    // A bag that was cut off, with a damaged chunk in the middle: what is left is learned from.
    let path = bag(folder.path(), 1300, |bag, frame| bag.write("/image", stamp(frame), &image(frame)));
    let mut bytes = std::fs::read(&path).unwrap();
    let middle = bytes.len() / 3;
    bytes[middle..middle + 8].iter_mut().for_each(|byte| *byte ^= 0x55);
    bytes.truncate(bytes.len() / 4 * 3);
    std::fs::write(&path, &bytes).unwrap();
    let found = imported(folder.path(), &[]);
    let (images, damaged) = (found["images"].as_u64().unwrap(), found["damaged"].as_u64().unwrap());
    assert!((700..1200).contains(&images) && damaged >= 1, "{found}");
    // Messages that are shorter than they should be, on every topic.
    bag(folder.path(), 641, |bag, frame| {
        let mut image = cdr::encode(&image(frame)).unwrap();
        let mut scan = cdr::encode(&LaserScan { ranges: vec![1.0; 36], ..Default::default() }).unwrap();
        if frame % 50 == 20 {
            image.truncate(100);
            scan.truncate(30);
        }
        bag.write_as("/image", Image::TYPE, "cdr", stamp(frame), &image);
        bag.write_as("/scan", LaserScan::TYPE, "cdr", stamp(frame), &scan);
    });
    std::fs::remove_dir_all(folder.path().join("run")).unwrap();
    let found = imported(folder.path(), &[]);
    assert_eq!((&found["unusable_images"], &found["damaged"]), (&13.into(), &13.into()), "{found}");
}
