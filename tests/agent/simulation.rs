//! The simulated world: actions, walls, rewards, the camera, and the optimal number of steps.

use std::sync::Arc;

use crate::common::package_file;
use adagio::agent::{RunOptions, Status, run};
use adagio::evaluate::OptimalSteps;
use adagio::log::{Folder, LogOptions, LogReader, Record, Rotation, RunLog, topics};
use adagio::random::stream;
use adagio::robot::{Action, Pose};
use adagio::scenario::Scenario;
use adagio::source::{Frame, Source};
use adagio::vision::Image;
use adagio::vision::observe;
use adagio::world::Simulated;
use adagio::world::{Eye, Robot, Sensor, World};
use nalgebra::Point2;

fn lab(sets: &[&str]) -> (Arc<Scenario>, Arc<World>) {
    let sets: Vec<String> = sets.iter().map(|&set| set.to_owned()).collect();
    let scenario = Arc::new(Scenario::load(&package_file("scenarios/lab.toml"), &sets).unwrap());
    let world = Arc::new(World::new(&scenario).unwrap());
    (scenario, world)
}

fn frames(source: &mut dyn Source, actions: &[Action]) -> Vec<Frame> {
    let mut frames = vec![source.first().unwrap()];
    for &action in actions {
        source.execute(action, &mut |frame| {
            frames.push(frame);
            true
        });
    }
    frames
}

#[test]
fn the_same_seed_gives_the_same_frames_and_another_seed_others() {
    let actions = [Action::FORWARD, Action::TURN_LEFT, Action::FORWARD, Action::TURN_RIGHT];
    let run = |seed: &str| {
        let (scenario, world) = lab(&[seed]);
        frames(&mut Simulated::new(scenario, world), &actions)
    };
    let (one, again, other) = (run("seed=1"), run("seed=1"), run("seed=2"));
    assert_eq!(one.len(), 21);
    for (a, b) in one.iter().zip(&again) {
        assert_eq!((&a.view, a.truth, &a.sonar, a.stamp_ns), (&b.view, b.truth, &b.sonar, b.stamp_ns));
    }
    assert_ne!(one[20].truth, other[20].truth);
    assert!(one.windows(2).all(|pair| pair[1].number == pair[0].number + 1));
    let boundaries: Vec<u64> = one.iter().filter(|f| f.boundary.is_some()).map(|f| f.number).collect();
    assert_eq!(boundaries, [0, 5, 10, 15, 20]);
}

#[test]
fn actions_have_their_length_and_angle_on_average_and_scatter() {
    let (scenario, world) = lab(&[]);
    let start = Pose::new(Point2::new(1.5, 0.9), 0.0);
    let mut robot = Robot::new(&scenario.robot, start, stream(7, "test"));
    let n = 2000.0;
    let (mut length, mut angle, mut square) = (0.0, 0.0, 0.0);
    for _ in 0..2000 {
        for (action, sum) in [(Action::FORWARD, &mut length), (Action::TURN_LEFT, &mut angle)] {
            robot.pose = start;
            let motion = robot.draw(action);
            for _ in 0..scenario.robot.frames_per_action {
                assert!(!robot.drive(motion, &world.arena));
            }
            let moved = (robot.pose.position - start.position).norm();
            *sum += if action == Action::FORWARD { moved } else { robot.pose.heading.to_degrees() };
            if action == Action::FORWARD {
                square += (moved - 0.3).powi(2);
            }
        }
    }
    assert!((length / n - 0.30).abs() < 0.002, "mean length {}", length / n);
    assert!((angle / n - 45.0).abs() < 0.3, "mean angle {}", angle / n);
    let deviation = (square / n).sqrt();
    assert!((deviation - 0.015).abs() < 0.002, "5 % of 0.30 m: {deviation}");
}

#[test]
fn walls_stop_the_robot_at_its_radius() {
    let (scenario, world) = lab(&["robot.start_heading_deg=90"]);
    let frames = frames(&mut Simulated::new(scenario, world), &[Action::FORWARD; 4]);
    let last = frames.last().unwrap();
    assert!(last.boundary.as_ref().unwrap().blocked);
    // 1.8 m less the radius of 0.25 m, and the skin of a millimetre.
    assert!((last.truth.unwrap().position.y - 1.549).abs() < 2e-3, "{}", last.truth.unwrap().position);
    assert!((last.sonar[0] - 0.25).abs() < 0.06, "sonar ahead: {}", last.sonar[0]);
    assert!(!frames[5].boundary.as_ref().unwrap().blocked);
}

#[test]
fn rewards_are_those_of_the_goal_and_near_walls() {
    // The thesis's, −1 within 0.5 m, for the first task; the default for the second.
    let (scenario, world) = lab(&["task.0.wall_reward=-1", "task.0.wall_distance=0.5"]);
    let reward = |task: usize, x: f64, y: f64| world.plan.reward(&scenario.tasks[task], Point2::new(x, y));
    assert_eq!(reward(0, 1.5, 0.9), 1.0);
    assert_eq!(reward(0, 1.69, 0.9), 1.0);
    assert_eq!(reward(0, 1.71, 0.9), 0.0);
    assert_eq!(reward(0, 1.5, 0.49), -1.0);
    assert_eq!(reward(0, 1.5, 0.51), 0.0);
    // Inside the goal, near a wall: the goal counts.
    assert_eq!(reward(1, 2.4, 0.3), 1.0);
    assert_eq!(reward(1, 0.29, 0.9), -0.3);
    assert_eq!(reward(1, 0.31, 0.9), 0.0);
    // Those near walls are in units of those of the goal.
    let (scenario, world) = lab(&["task.0.reward=20", "task.0.wall_reward=-0.25"]);
    let reward = |x: f64, y: f64| world.plan.reward(&scenario.tasks[0], Point2::new(x, y));
    assert_eq!((reward(1.5, 0.9), reward(0.29, 0.9), reward(0.31, 0.9)), (20.0, -5.0, 0.0));
}

#[test]
fn the_camera_sees_floor_below_walls_below_surroundings_in_perspective() {
    let (_, world) = lab(&[
        "world.floor.pattern=plain",
        "world.floor.hue=120",
        "world.surroundings.pattern=plain",
        "world.surroundings.hue=240",
        "world.wall.1.pattern=plain",
        "world.wall.1.hue=0",
    ]);
    // 1.5 m in front of the wall at x = 3, lens 0.5 m above the floor.
    let image = world.appearance.camera(0).render(&Pose::new(Point2::new(1.5, 0.9), 0.0));
    let focal = 160.0 / 33f64.to_radians().tan();
    let column = image.width / 2;
    let colour = |row: usize| {
        let at = 3 * (row * image.width + column);
        let pixel = &image.rgb[at..at + 3];
        (0..3).max_by_key(|&channel| pixel[channel]).unwrap()
    };
    // Rows where the wall's upper edge (0.4 m above the lens) and its foot (0.5 m below) are seen.
    let top = 120.0 - focal * 0.4 / 1.5;
    let foot = 120.0 + focal * 0.5 / 1.5;
    for (row, expected) in
        [(top as usize - 2, 2), (top as usize + 2, 0), (foot as usize - 2, 0), (foot as usize + 2, 1)]
    {
        assert_eq!(colour(row), expected, "row {row}");
    }
}

#[test]
fn exposure_and_noise_change_pixels_and_vision_undoes_most_of_it() {
    let (scenario, world) = lab(&[]);
    let clean = world.appearance.camera(0).render(&Pose::new(Point2::new(1.0, 0.7), 1.0));
    let target = observe(&clean, &scenario.vision, 0);
    for seed in 0..20 {
        let mut exposed = clean.clone();
        Sensor::new(&scenario, 0.2, stream(seed, "test")).expose(&mut exposed, 1.0);
        assert_ne!(exposed, clean);
        let seen = observe(&exposed, &scenario.vision, 0);
        let worst = seen.pixels.iter().zip(&target.pixels).map(|(&a, &b)| a.abs_diff(b)).max().unwrap();
        assert!(worst <= 4, "seed {seed}: {worst} grey levels");
    }
}

#[test]
fn a_lens_hardly_above_the_floor_sees_floor_below_the_horizon() {
    // The middle row of an odd number looks straight ahead, where rounding puts the foot of a wall as well.
    for height in [97, 241] {
        let (_, world) = lab(&[&format!("camera.height={height}"), "camera.mount_height=1e-17"]);
        for pose in poses(20) {
            let image = world.appearance.camera(0).render(&pose);
            assert_eq!(image.rgb.len(), 3 * 320 * height);
        }
    }
}

/// Poses all over the room.
#[test]
fn distractors_hide_what_is_behind_them_and_are_hidden_by_walls() {
    let world = |text: &str| {
        let lab = std::fs::read_to_string(package_file("scenarios/lab.toml")).unwrap();
        let sets = ["camera.detail=full".to_owned()];
        World::new(&Scenario::parse(&(lab + text), std::path::Path::new("test.toml"), &sets).unwrap()).unwrap()
    };
    let red = "\n[[world.distractor]]\nhue = 0.0\nblink_seconds = 4.0\n";
    let (bare, near) = (world(""), world(&(red.to_owned() + "path = [[2.0, 0.9], [2.0, 1.9]]\nradius = 0.2\n")));
    let pose = Pose::new(Point2::new(0.5, 0.9), 0.0);
    let differs = |image: &Image, column: usize, row: usize| {
        let at = 3 * (320 * row + column);
        image.rgb[at..at + 3] != bare.appearance.render(&pose, 0).rgb[at..at + 3]
    };
    let seen = near.appearance.render(&pose, 0);
    // 1.5 m ahead its side is seen at asin(0.2 / 1.5) to both sides.
    let focal = 160.0 / 33f64.to_radians().tan();
    let half = focal * (0.2f64 / 1.5).asin().tan();
    let edge = (160.0 - half) as usize;
    assert!(!differs(&seen, edge - 2, 130) && differs(&seen, edge + 2, 130) && differs(&seen, 318 - edge, 130));
    // It stands on the floor, 1.3 m away where it is nearest, and the lens is 0.5 m above it.
    let foot = 120.0 + focal * 0.5 / 1.3;
    assert!(differs(&seen, 160, foot as usize - 2) && !differs(&seen, 160, foot as usize + 2));
    // After four seconds it is dark and 2 m farther on its way back and forth of 2 m: where it was.
    let dark = near.appearance.render(&pose, 20);
    let at = 3 * (320 * 130 + 160);
    assert!(seen.rgb[at] > 200 && dark.rgb[at] < 60, "{} {}", seen.rgb[at], dark.rgb[at]);
    // A trial that is four seconds ahead sees the same.
    let mut later = Image::default();
    near.appearance.render_into(&Eye::from((pose, 20)), 0, &mut later);
    assert_eq!(later.rgb, dark.rgb);
    // Behind the wall 2.5 m ahead, 0.9 m high: from 0.5 m above the floor its top is seen at 1.7 m alone.
    let behind = world(&(red.to_owned() + "path = [[4.0, 0.9], [4.0, 1.9]]\nradius = 0.2\n"));
    let seen = behind.appearance.render(&pose, 0);
    let (wall, top) = (120.0 - focal * 0.4 / 2.5, 120.0 - focal * 1.2 / 3.3);
    assert!(!differs(&seen, 160, wall as usize + 2) && differs(&seen, 160, wall as usize - 2));
    assert!(differs(&seen, 160, top as usize + 2) && !differs(&seen, 160, top as usize - 2));
}

#[test]
fn other_papers_change_the_patterns_of_walls_and_floor_and_nothing_else() {
    let (_, plain) = lab(&[]);
    let (_, same) = lab(&["world.texture_seed=0"]);
    let (first, papered) = lab(&["world.texture_seed=1"]);
    let (_, other) = lab(&["world.texture_seed=2"]);
    let pose = Pose::new(Point2::new(1.0, 0.9), 0.3);
    let [plain, same, papered, other] = [plain, same, papered, other].map(|world| world.appearance.render(&pose, 0));
    assert_eq!(plain.rgb, same.rgb);
    // Where the far surroundings are seen nothing changes; nearly all else does.
    let top = 3 * 320 * 20;
    assert_eq!(plain.rgb[..top], papered.rgb[..top]);
    for [a, b] in [[&plain, &papered], [&papered, &other]] {
        let differing = a.rgb.chunks(3).zip(b.rgb.chunks(3)).filter(|(a, b)| a != b).count();
        assert!(differing > a.rgb.len() / 3 / 2, "{differing}");
    }
    // The whole scenario, read again, is the same.
    let again = Scenario::parse(&first.text, std::path::Path::new("again.toml"), &[]).unwrap();
    assert_eq!(again.world, first.world);
}

fn poses(count: u32) -> Vec<Pose> {
    let pose = |i| {
        let share = |step: f64| (f64::from(i) * step).fract();
        let position = Point2::new(0.3 + 2.4 * share(0.618), 0.3 + 1.2 * share(0.414));
        Pose::new(position, std::f64::consts::TAU * share(0.732))
    };
    (0..count).map(pose).collect()
}

/// An image whose pixels are those so many columns to the right and rows below in another; what lies outside is the edge.
fn shifted(image: &Image, (right, below): (isize, isize)) -> Image {
    let mut moved = image.clone();
    let at = |i: usize, by: isize, n: usize| i.saturating_add_signed(by).min(n - 1);
    for (i, pixel) in moved.rgb.chunks_exact_mut(3).enumerate() {
        let column = at(i % image.width, right, image.width);
        let start = 3 * (at(i / image.width, below, image.height) * image.width + column);
        pixel.copy_from_slice(&image.rgb[start..start + 3]);
    }
    moved
}

const NEIGHBOURS: [(isize, isize); 4] = [(1, 0), (-1, 0), (0, 1), (0, -1)];

#[test]
fn samples_for_vision_are_the_pixels_of_a_small_camera_with_the_same_view() {
    let (scenario, world) = lab(&["camera.detail=vision"]);
    assert_eq!(scenario.camera.rendered(&scenario.vision), (128, 64));
    let (_, small) = lab(&["camera.detail=full", "camera.width=128", "camera.height=96", "vision.cut_rows=32"]);
    let (mut pixels, mut same, mut same_moved) = (0, 0, [0; 4]);
    let equal = |a: &[u8], b: &[u8]| a.chunks_exact(3).zip(b.chunks_exact(3)).filter(|(a, b)| a == b).count();
    for pose in poses(400) {
        let image = world.appearance.camera(0).render(&pose);
        assert_eq!((image.width, image.height, image.cropped), (128, 64, true));
        let known = small.appearance.camera(0).render(&pose);
        let known = &known.rgb[3 * 128 * 32..];
        pixels += known.len() / 3;
        same += equal(known, &image.rgb);
        for (count, by) in same_moved.iter_mut().zip(NEIGHBOURS) {
            *count += equal(known, &shifted(&image, by).rgb);
        }
    }
    // Rays of both differ in their last bits, so that some meet a surface on the other side of an edge.
    let share = |count: usize| count as f64 / pixels as f64;
    assert!(share(same) >= 0.999, "{} are equal", share(same));
    for (&count, by) in same_moved.iter().zip(NEIGHBOURS) {
        assert!(share(count) < 0.999, "moved by {by:?}, {} are equal", share(count));
    }
}

#[test]
fn what_vision_makes_of_samples_is_nearest_to_the_full_image_where_it_is() {
    let (scenario, world) = lab(&["camera.detail=full"]);
    let (_, sampled) = lab(&["camera.detail=vision"]);
    let seen = |image: &Image| observe(image, &scenario.vision, 0).pixels;
    let (mut in_place, mut moved) = (0, [0; 4]);
    for pose in poses(100) {
        let full = seen(&world.appearance.camera(0).render(&pose));
        let samples = sampled.appearance.camera(0).render(&pose);
        let error = |image: &Image| -> u64 {
            full.iter().zip(seen(image)).map(|(&a, b)| u64::from(a.abs_diff(b)).pow(2)).sum()
        };
        in_place += error(&samples);
        for (sum, by) in moved.iter_mut().zip(NEIGHBOURS) {
            *sum += error(&shifted(&samples, by));
        }
    }
    assert!(moved.iter().all(|&moved| in_place < moved), "{in_place} in place, {moved:?} moved by one sample");
}

/// Observations of a standing robot, whose brightness is not corrected; no pixel is cut at black or white.
fn watch(detail: &str, keys: &[&str], frames: usize) -> Vec<Vec<f64>> {
    let detail = format!("camera.detail={detail}");
    let (scenario, world) = lab(&[&["vision.brightness=0", &detail], keys].concat());
    let clean = world.appearance.camera(0).render(&Pose::new(Point2::new(1.0, 0.7), 1.0));
    let mut sensor = Sensor::new(&scenario, 0.2, stream(5, "test"));
    // Noise goes no further down than this, and must not reach white.
    let deepest = 3.31 * scenario.camera.pixel_noise;
    assert!(clean.rgb.iter().all(|&value| f64::from(value) >= deepest), "a pixel may be cut at black");
    let mut image = clean.clone();
    let look = |_| {
        image.rgb.copy_from_slice(&clean.rgb);
        sensor.expose(&mut image, 1.0);
        assert!(image.rgb.iter().all(|&value| value < 255), "a pixel may be cut at white");
        observe(&image, &scenario.vision, 0).pixels.into_iter().map(f64::from).collect()
    };
    (0..frames).map(look).collect()
}

#[test]
fn what_vision_needs_has_the_noise_of_the_full_image() {
    // Strong noise, so that rounding of observations does not hide it, at a gain of exactly 1.
    let frames = 1000;
    // Pixels of σ = 12 and their rounding, in areas of 100, and rounding of their mean. Noise for vision is made such that
    // areas of 16 have the same variance.
    let expected = (144.0 + 1.0 / 12.0) / 100.0 + 1.0 / 12.0;
    for detail in ["full", "vision"] {
        let seen = watch(detail, &["camera.pixel_noise=12", "camera.exposure_drift=0"], frames);
        let values = seen[0].len();
        let variance_of = |i: usize| {
            let mean = seen.iter().map(|x| x[i]).sum::<f64>() / frames as f64;
            seen.iter().map(|x| (x[i] - mean).powi(2)).sum::<f64>() / (frames - 1) as f64
        };
        let variance = (0..values).map(variance_of).sum::<f64>() / values as f64;
        // Sums of so many pixels are normal: each variance is known within √(2 / (frames − 1)) of it, one standard deviation.
        let sampling = 5.0 * (2.0 / ((frames - 1) * values) as f64).sqrt();
        // Noise keeps its promise within 0.25 %. Means of 16 values are rounded from steps of 1/16, of 100 from finer ones:
        // the variance of that rounding is (1 − 1/16²)/12.
        let known = 0.0025 + 1.0 / (12.0 * 256.0) / expected;
        assert!((variance / expected - 1.0).abs() < sampling + known, "{detail}: {variance}, expected {expected}");
    }
}

#[test]
fn what_vision_needs_has_the_exposure_of_the_full_image() {
    // Exposure is drawn from the same numbers: gains agree frame by frame. Without noise, only rounding is between them.
    let sums = |detail| -> Vec<f64> {
        watch(detail, &["camera.pixel_noise=0"], 300).iter().map(|values| values.iter().sum()).collect()
    };
    let (full, vision) = (sums("full"), sums("vision"));
    // Rounding of the 1536 values of an observation, each with a variance of 1/12; and of the pixels, of which there are
    // 100 or 16 for each value, by which their errors are divided.
    let variance = |pixels: f64| 1536.0 / 12.0 * (1.0 + 1.0 / pixels);
    for (a, b) in full.iter().zip(&vision) {
        let (a, b) = (a / full[0], b / vision[0]);
        // Errors of both sums of each ratio.
        let error = |first: f64, ratio: f64, pixels: f64| variance(pixels) * (1.0 + ratio * ratio) / (first * first);
        let five = 5.0 * (error(full[0], a, 100.0) + error(vision[0], b, 16.0)).sqrt();
        assert!((a - b).abs() < five, "{a} and {b} differ by more than {five}");
    }
}

#[test]
fn the_optimal_number_of_steps_is_that_of_simple_cases() {
    let (scenario, world) = lab(&[]);
    let search = OptimalSteps::new(&world.arena, &scenario.robot, &scenario.tasks[0], &[], 50);
    let steps = |x: f64, y: f64, degrees: f64| search.from(Pose::new(Point2::new(x, y), f64::to_radians(degrees)));
    assert_eq!(steps(1.5, 0.9, 0.0), Some(0));
    // 0.7 m ahead: the goal begins 0.2 m before its centre.
    assert_eq!(steps(0.8, 0.9, 0.0), Some(2));
    assert_eq!(steps(0.8, 0.9, 90.0), Some(4));
    assert_eq!(steps(0.8, 0.9, 180.0), Some(6));
    let far = Pose::new(Point2::new(0.3, 0.3), 0.0);
    let one = OptimalSteps::new(&world.arena, &scenario.robot, &scenario.tasks[0], &[], 1);
    assert_eq!(one.from(far), None);
    // Straight ahead, and no action to spare.
    assert_eq!(one.from(Pose::new(Point2::new(1.01, 0.9), 0.0)), Some(1));
}

/// A robot of which nobody measures where it is.
struct Unlocated(Simulated);

impl Source for Unlocated {
    fn first(&mut self) -> Option<Frame> {
        self.0.first().map(|frame| Frame { truth: None, ..frame })
    }

    fn execute(&mut self, action: Action, give: &mut dyn FnMut(Frame) -> bool) -> bool {
        self.0.execute(action, &mut |frame| give(Frame { truth: None, ..frame }))
    }
}

#[test]
fn a_robot_whose_true_pose_nobody_knows_learns_features_and_finds_no_goal_given_by_coordinates() {
    let text = std::fs::read_to_string(package_file("scenarios/smoke.toml")).unwrap();
    let scenario =
        Arc::new(Scenario::parse(&text, std::path::Path::new("smoke.toml"), &["actions=200".into()]).unwrap());
    let world = Arc::new(World::new(&scenario).unwrap());
    let folder = tempfile::tempdir().unwrap();
    let storage = Folder::new(folder.path());
    let log = RunLog::create(storage, &LogOptions::default(), Rotation::NEVER, &Default::default()).unwrap();
    let (stop, status) = (std::sync::atomic::AtomicBool::new(false), Status::default());
    let mut robot = Unlocated(Simulated::new(scenario.clone(), world.clone()));
    let outcome = run(&scenario, &world.plan, &mut robot, log, RunOptions::new(&stop, &status)).unwrap();
    assert_eq!((outcome.actions, outcome.frames), (200, 1001));
    assert!(outcome.learned.is_some_and(|learned| !learned.model.slowness.is_empty()));
    assert!(outcome.pursuits.iter().all(|tally| tally.reached == 0));
    let file = std::fs::File::open(folder.path().join("run_000.mcap")).unwrap();
    let (mut poses, mut rewards) = (0, Vec::new());
    for record in LogReader::new(file, "run_000.mcap") {
        let record = record.unwrap();
        let Record::Message { topic, .. } = &record else { continue };
        poses += usize::from(**topic == *topics::POSE.name());
        if **topic == *topics::TRANSITION.name() {
            rewards.extend(record.decode::<adagio::log::messages::Transition>().unwrap().rewards);
        }
    }
    assert_eq!((poses, rewards.len()), (0, 200 * scenario.tasks.len()));
    assert!(rewards.iter().all(|&reward| reward == 0.0));
}
