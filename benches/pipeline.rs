//! Whole runs, from the first frame to the closed log, all actors on their threads, without evaluation.

mod common;

use common::{operations, simulation};

use divan::Bencher;
use divan::counter::ItemsCount;

fn main() {
    common::main();
}

/// The scenario of the smoke tests: 400 actions, up to 300 support vectors.
#[divan::bench(sample_size = 1, sample_count = 3, max_time = 20)]
fn smoke(bencher: Bencher) {
    whole(bencher, "smoke.toml", &[]);
}

/// The lab, against the number of actions.
#[divan::bench(args = [400, 1500], sample_size = 1, sample_count = 3, max_time = 20)]
fn lab_of_actions(bencher: Bencher, actions: usize) {
    let actions = format!("actions={actions}");
    whole(bencher, "lab.toml", &[&actions]);
}

fn whole(bencher: Bencher, name: &str, sets: &[&str]) {
    let scenario = simulation::scenario(name, sets);
    let frames = scenario.actions * scenario.robot.frames_per_action + 1;
    bencher.counter(ItemsCount::new(frames)).bench_local(|| operations::run(&scenario));
}
