//! From camera image to action, through all support vectors: the time that the robot waits for.
//!
//! After the medians come the percentiles that a deadline is about.

mod common;

use std::time::Instant;

use common::data::{D, frames};
use common::operations::ACTIONS;
use common::{Size, allowed, max_m, operations, simulation, standard};

use adagio::policy::{FloorMap, GoalRegion, Learned, Recent, Reflexes};
use adagio::robot::Action;
use adagio::scenario::Vision;
use adagio::vision::Image;
use adagio::vision::observe;
use adagio::world::World;
use divan::Bencher;
use faer::Mat;

fn main() {
    common::main();
    if common::wants_figures() {
        percentiles();
    }
}

/// Features of the policy.
const K: usize = 128;
/// Those that say what is near, of local values; and transitions.
const COORDINATES: usize = 40;
const TRANSITIONS: usize = 20_000;

/// Against the number of support vectors.
#[divan::bench(args = standard().into_iter().map(|size| size.k(K)), max_time = 2)]
fn decide_of_m(bencher: Bencher, size: Size) {
    decide(bencher, size);
}

/// Against the number of features.
#[divan::bench(args = allowed([32, 128, 500].map(|k| Size::of(2000).k(k))), max_time = 2)]
fn decide_of_k(bencher: Bencher, size: Size) {
    decide(bencher, size);
}

/// With local values, against the number of transitions.
#[divan::bench(args = allowed([5000, 20_000, 60_000].map(|n| Size::of(2000).k(K).n(n))), max_time = 2)]
fn decide_locally_of_n(bencher: Bencher, size: Size) {
    decide(bencher, size);
}

/// With local values and a goal that was shown, against the number of marks, all of which are near.
#[divan::bench(args = [40, 1000, 4000], max_time = 2)]
fn decide_of_marks(bencher: Bencher, marks: usize) {
    let robot = Robot::new(Size::of(2000).k(K).n(TRANSITIONS)).with_marks(marks);
    let mut images = robot.images.iter().cycle();
    bencher.bench_local(|| robot.decide(images.next().expect("a cycle has no end")));
}

fn decide(bencher: Bencher, size: Size) {
    let robot = Robot::new(size);
    let mut images = robot.images.iter().cycle();
    bencher.bench_local(|| robot.decide(images.next().expect("a cycle has no end")));
}

/// What stands between camera and wheels.
struct Robot {
    /// Images from poses all over the room.
    images: Vec<Image>,
    vision: Vision,
    learned: Learned,
    reflexes: Reflexes,
}

impl Robot {
    fn new(size: Size) -> Self {
        let scenario = simulation::scenario("lab.toml", &[]);
        let world = World::new(&scenario).expect("a scenario without image files");
        Robot {
            images: simulation::poses(&scenario).iter().map(|pose| world.appearance.camera(0).render(pose)).collect(),
            vision: scenario.vision.clone(),
            learned: match size.n {
                None => operations::learned(&frames(D, size.m), size.m, size.k.unwrap_or(K)),
                Some(n) => operations::learned_locally(
                    &frames(D, size.m),
                    size.m,
                    size.k.unwrap_or(K),
                    COORDINATES,
                    n / ACTIONS,
                ),
            },
            reflexes: Reflexes::new(&scenario),
        }
    }

    /// With so many marks; every place on the map is so near them that all are looked at.
    fn with_marks(mut self, marks: usize) -> Self {
        let instances = self.learned.instances.clone().expect("local values");
        let places = Mat::from_fn(2, instances.len(), |axis, j| ((j * (7 + axis)) % 100) as f64 / 100.0);
        let map = FloorMap::new(instances.clone(), places.as_ref()).expect("a place for each state");
        let points = instances.points();
        let marks = Mat::from_fn(points.nrows(), marks, |i, k| points[(i, (k * 31) % points.ncols())]);
        let region = GoalRegion::new(&map, marks, 100.0, [points, points]).expect("marks of the map's dimension");
        self.learned = self.learned.with_regions(Some(map), vec![Some(region)]).expect("a map of these values");
        self
    }

    fn decide(&self, image: &Image) -> Action {
        let observation = observe(image, &self.vision, 0);
        let state = self.learned.state(&observation);
        std::hint::black_box(state.is_there(0));
        self.reflexes.best(&state.q_values(0), Recent::default()).0
    }
}

/// Decisions that percentiles are taken of: in a row, and after other work.
const IN_A_ROW: usize = 3000;
const AFTER_WORK: usize = 1000;

/// Memory that other work goes through between two decisions, bytes.
const OTHER_WORK: usize = 64 << 20;

/// Bytes of a cache line.
const LINE: usize = 64;

fn percentiles() {
    let quick = max_m() < 8000;
    let (in_a_row, after_work) = if quick { (300, 100) } else { (IN_A_ROW, AFTER_WORK) };
    println!(
        "\nimage to action, {} images in turn, ms; in cache: {in_a_row} decisions in a row; after other work: {after_work} \
         decisions,\nbefore each of which {} MiB of other memory are written, untimed",
        simulation::poses(&simulation::scenario("lab.toml", &[])).len(),
        OTHER_WORK >> 20
    );
    println!("{:>20} {:>18} {:>8} {:>8} {:>8}", "", "", "p50", "p99", "largest");
    let mut other = vec![0u8; OTHER_WORK];
    let local = standard().into_iter().map(|size| size.n(TRANSITIONS));
    let sizes = standard().into_iter().chain(local).map(|size| (size, None));
    let marked = [40, 1000, 4000].map(|marks| (Size::of(2000.min(max_m())).n(TRANSITIONS), Some(marks)));
    for (size, marks) in sizes.chain(marked) {
        let mut robot = Robot::new(size.k(K));
        if let Some(marks) = marks {
            println!("with {marks} marks:");
            robot = robot.with_marks(marks);
        }
        let mut images = robot.images.iter().cycle();
        let mut timed = || {
            let image = images.next().expect("a cycle has no end");
            let begin = Instant::now();
            std::hint::black_box(robot.decide(image));
            1e3 * begin.elapsed().as_secs_f64()
        };
        let in_cache = (0..in_a_row).map(|_| timed()).collect();
        print_percentiles(size, "in cache", in_cache);
        let after = (0..after_work).map(|_| {
            other.iter_mut().step_by(LINE).for_each(|byte| *byte = byte.wrapping_add(1));
            std::hint::black_box(&mut other);
            timed()
        });
        let after = after.collect();
        print_percentiles(size, "after other work", after);
    }
}

fn print_percentiles(size: Size, when: &str, mut milliseconds: Vec<f64>) {
    milliseconds.sort_by(f64::total_cmp);
    let at = |share: f64| milliseconds[(share * (milliseconds.len() - 1) as f64) as usize];
    println!("{:>20} {when:>18} {:8.3} {:8.3} {:8.3}", size.k(K), at(0.5), at(0.99), at(1.0));
}
