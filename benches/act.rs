//! From camera image to action, through all support vectors: the time that the robot waits for.
//!
//! After the medians come the percentiles that a deadline is about.

mod common;

use std::time::Instant;

use common::data::{D, frames};
use common::{Size, allowed, operations, simulation, standard};

use adagio::policy::{Learned, Recent, Reflexes};
use adagio::scenario::Vision;
use adagio::vision::observe;
use adagio::world::{Action, Image, World};
use divan::Bencher;

fn main() {
    common::main();
    if !std::env::args().any(|argument| argument == "--list" || argument == "--test") {
        percentiles();
    }
}

/// Features of the policy.
const K: usize = 128;

/// Against the number of support vectors.
#[divan::bench(args = standard().into_iter().map(|size| size.k(K)), max_time = 2)]
fn decide_of_m(bencher: Bencher, size: Size) {
    let robot = Robot::new(size);
    bencher.bench_local(|| robot.decide());
}

/// Against the number of features.
#[divan::bench(args = allowed([32, 128, 500].map(|k| Size::of(2000).k(k))), max_time = 2)]
fn decide_of_k(bencher: Bencher, size: Size) {
    let robot = Robot::new(size);
    bencher.bench_local(|| robot.decide());
}

/// What stands between camera and wheels.
struct Robot {
    image: Image,
    vision: Vision,
    learned: Learned,
    reflexes: Reflexes,
}

impl Robot {
    fn new(size: Size) -> Self {
        let scenario = simulation::scenario("lab.toml", &[]);
        let world = World::new(&scenario).expect("a scenario without image files");
        Robot {
            image: world.camera.render(&simulation::start(&scenario)),
            vision: scenario.vision.clone(),
            learned: operations::learned(&frames(D, size.m), size.m, size.k.unwrap_or(K)),
            reflexes: Reflexes::new(&scenario.policy),
        }
    }

    fn decide(&self) -> Action {
        let observation = observe(&self.image, &self.vision, 0);
        self.reflexes.best(self.learned.q_values(&observation, 0), Recent::default()).0
    }
}

/// Decisions that percentiles are taken of.
const DECISIONS: usize = 3000;

fn percentiles() {
    println!("\nimage to action, {DECISIONS} decisions in a row, ms");
    println!("{:>24} {:>8} {:>8} {:>8}", "", "p50", "p99", "largest");
    for size in standard() {
        let robot = Robot::new(size.k(K));
        let mut milliseconds: Vec<f64> = (0..DECISIONS)
            .map(|_| {
                let begin = Instant::now();
                std::hint::black_box(robot.decide());
                1e3 * begin.elapsed().as_secs_f64()
            })
            .collect();
        milliseconds.sort_by(f64::total_cmp);
        let at = |share: f64| milliseconds[(share * (DECISIONS - 1) as f64) as usize];
        println!("{:>24} {:8.3} {:8.3} {:8.3}", size.k(K), at(0.5), at(0.99), at(1.0));
    }
}
