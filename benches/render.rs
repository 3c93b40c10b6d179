//! The simulated camera, its sensor, and the observation that is made of its image, into memory that is used again.

mod common;

use std::sync::Arc;

use common::simulation;

use adagio::random;
use adagio::robot::Pose;
use adagio::scenario::Scenario;
use adagio::vision::Image;
use adagio::vision::{Observer, observe};
use adagio::world::{Sensor, World};
use divan::Bencher;
use divan::counter::ItemsCount;

fn main() {
    common::main();
}

/// `camera.detail` and size of the camera's image; lines that are cut away scale with it. With `vision` as many pixels are
/// rendered whatever the camera's size.
const CAMERAS: [(&str, &str); 5] =
    [("full", "64x48"), ("full", "128x96"), ("full", "320x240"), ("full", "640x480"), ("vision", "320x240")];

/// The image alone.
#[divan::bench(args = CAMERAS, max_time = 2)]
fn render(bencher: Bencher, camera: (&str, &str)) {
    let (lab, mut image) = (Lab::new(camera), Image::default());
    let mut poses = lab.poses.iter().cycle();
    bencher.counter(ItemsCount::new(1u32)).bench_local(|| lab.render(&mut poses, &mut image));
}

/// The image with the sensor's errors.
#[divan::bench(args = CAMERAS, max_time = 2)]
fn render_and_expose(bencher: Bencher, camera: (&str, &str)) {
    let (lab, mut image) = (Lab::new(camera), Image::default());
    let (mut poses, mut sensor) = (lab.poses.iter().cycle(), lab.sensor());
    bencher.counter(ItemsCount::new(1u32)).bench_local(|| {
        lab.render(&mut poses, &mut image);
        sensor.expose(&mut image, 1.0);
    });
}

/// The image without the sensor's errors, and the observation of it.
#[divan::bench(args = CAMERAS, max_time = 2)]
fn render_and_observe(bencher: Bencher, camera: (&str, &str)) {
    let (lab, mut image) = (Lab::new(camera), Image::default());
    let mut poses = lab.poses.iter().cycle();
    let (mut observer, mut pixels) = (Observer::default(), Vec::new());
    bencher.counter(ItemsCount::new(1u32)).bench_local(|| {
        lab.render(&mut poses, &mut image);
        observer.observe(&image, &lab.scenario.vision, &mut pixels);
    });
}

/// All of it: image, sensor and observation.
#[divan::bench(args = CAMERAS, max_time = 2)]
fn render_expose_and_observe(bencher: Bencher, camera: (&str, &str)) {
    let (lab, mut image) = (Lab::new(camera), Image::default());
    let (mut poses, mut sensor) = (lab.poses.iter().cycle(), lab.sensor());
    let (mut observer, mut pixels) = (Observer::default(), Vec::new());
    bencher.counter(ItemsCount::new(1u32)).bench_local(|| {
        lab.render(&mut poses, &mut image);
        sensor.expose(&mut image, 1.0);
        observer.observe(&image, &lab.scenario.vision, &mut pixels);
    });
}

/// The same in a new image and a new observation each time, as in a run, which hands both on.
#[divan::bench(args = CAMERAS, max_time = 2)]
fn all_in_new_memory(bencher: Bencher, camera: (&str, &str)) {
    let lab = Lab::new(camera);
    let (mut poses, mut sensor) = (lab.poses.iter().cycle(), lab.sensor());
    bencher.counter(ItemsCount::new(1u32)).bench_local(|| {
        let mut image = Image::default();
        lab.render(&mut poses, &mut image);
        sensor.expose(&mut image, 1.0);
        observe(&image, &lab.scenario.vision, 0)
    });
}

/// The observation alone.
#[divan::bench(args = CAMERAS, max_time = 2)]
fn vision(bencher: Bencher, camera: (&str, &str)) {
    let (lab, mut image) = (Lab::new(camera), Image::default());
    lab.render(&mut lab.poses.iter(), &mut image);
    let (mut observer, mut pixels) = (Observer::default(), Vec::new());
    let counted = bencher.counter(ItemsCount::new(1u32));
    counted.bench_local(|| observer.observe(&image, &lab.scenario.vision, &mut pixels));
}

/// The lab with a camera, and poses all over it.
struct Lab {
    scenario: Arc<Scenario>,
    world: World,
    poses: Vec<Pose>,
}

impl Lab {
    fn new((detail, size): (&str, &str)) -> Self {
        let (width, height) = size.split_once('x').expect("WIDTHxHEIGHT");
        let cut = height.parse::<usize>().expect("a number of lines") / 3;
        let sets = [
            format!("camera.detail=\"{detail}\""),
            format!("camera.width={width}"),
            format!("camera.height={height}"),
            format!("vision.cut_rows={cut}"),
        ];
        let scenario = simulation::scenario("lab.toml", &sets.each_ref().map(String::as_str));
        let world = World::new(&scenario).expect("a scenario without image files");
        Lab { poses: simulation::poses(&scenario), world, scenario }
    }

    fn sensor(&self) -> Sensor {
        let random = random::stream(self.scenario.seed, "camera");
        Sensor::new(&self.scenario, self.scenario.robot.frame_seconds(), random)
    }

    fn render<'a>(&self, poses: &mut impl Iterator<Item = &'a Pose>, image: &mut Image) {
        self.world.appearance.camera(0).render_into(poses.next().expect("a pose"), image);
    }
}
