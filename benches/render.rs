//! The simulated camera, and the observation that is made of its image.

mod common;

use common::simulation;

use adagio::vision::observe;
use adagio::world::World;
use divan::Bencher;
use divan::counter::ItemsCount;

fn main() {
    common::main();
}

/// Size of the camera's image; lines that are cut away scale with it.
const CAMERAS: [&str; 4] = ["64x48", "128x96", "320x240", "640x480"];

/// The image alone.
#[divan::bench(args = CAMERAS, max_time = 2)]
fn render(bencher: Bencher, camera: &str) {
    let (scenario, world) = lab(camera);
    let poses = simulation::poses(&scenario);
    let mut next = poses.iter().cycle();
    bencher
        .counter(ItemsCount::new(1u32))
        .bench_local(|| world.camera.render(next.next().expect("a cycle has no end")));
}

/// The image, and the observation of it.
#[divan::bench(args = CAMERAS, max_time = 2)]
fn render_and_observe(bencher: Bencher, camera: &str) {
    let (scenario, world) = lab(camera);
    let poses = simulation::poses(&scenario);
    let mut next = poses.iter().cycle();
    bencher.counter(ItemsCount::new(1u32)).bench_local(|| {
        let image = world.camera.render(next.next().expect("a cycle has no end"));
        observe(&image, &scenario.vision, 0)
    });
}

/// The observation alone.
#[divan::bench(args = CAMERAS, max_time = 2)]
fn vision(bencher: Bencher, camera: &str) {
    let (scenario, world) = lab(camera);
    let image = world.camera.render(&simulation::start(&scenario));
    bencher.counter(ItemsCount::new(1u32)).bench_local(|| observe(&image, &scenario.vision, 0));
}

fn lab(camera: &str) -> (std::sync::Arc<adagio::scenario::Scenario>, World) {
    let (width, height) = camera.split_once('x').expect("WIDTHxHEIGHT");
    let cut = height.parse::<usize>().expect("a number of lines") / 3;
    let sets = [format!("camera.width={width}"), format!("camera.height={height}"), format!("vision.cut_rows={cut}")];
    let scenario = simulation::scenario("lab.toml", &sets.each_ref().map(String::as_str));
    let world = World::new(&scenario).expect("a scenario without image files");
    (scenario, world)
}
