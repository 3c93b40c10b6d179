//! The thesis's full size: from 35 128 frames to 500 slow features over about 7 700 support vectors.
//!
//! Frames are those of the lab's robot on its random walk, rendered before the clock starts. Arguments, each with a value:
//! `--frames`, `--sigma`, `--nu`, `--budget`, `--features`, `--threads`; and `--find-sigma M`, which looks for the width at
//! which ALD keeps `M` of these frames, from `--sigma` on, and measures nothing.

mod common;

use std::time::Instant;

use common::data::BLOCK;
use common::machine::{Rates, Useful};
use common::operations;
use common::simulation::{Frames, Walker};
use common::{argument, max_m};

use adagio::agent::peak_resident_bytes;
use adagio::dictionary::{Ald, Dictionary, Parameters, WhenFull};
use adagio::kernel::Kernel;
use adagio::slow::{SlowModel, SlowStream, StreamOptions};
use faer::Par;

/// Frames of the thesis's largest run (§5.1.5).
const FRAMES: usize = 35_128;

/// Its threshold.
const NU: f64 = 0.1;

/// The width at which ALD keeps 7688 of these frames, as `--find-sigma 7700` found (8203 at 1050, 7576 at 1083.8).
const SIGMA: f64 = 1076.8;

/// Above what ALD keeps, so that nothing is cut.
const BUDGET: usize = 8000;

/// Slow features.
const FEATURES: usize = 500;

fn main() {
    adagio::random::fix_parallelism();
    common::machine::header();
    let quick = max_m() < BUDGET;
    let n = argument("--frames").unwrap_or(if quick { 2000 } else { FRAMES });
    let threads = argument("--threads").unwrap_or(2);
    let par = if threads == 1 { Par::Seq } else { Par::rayon(threads) };
    let nu = argument("--nu").unwrap_or(NU);

    let begin = Instant::now();
    let frames = Walker::new().frames(n);
    println!("{n} frames of {} values rendered in {:.1} s", frames.x.nrows(), begin.elapsed().as_secs_f64());
    if let Some(target) = argument("--find-sigma") {
        find_sigma(&frames, nu, target, argument("--sigma").unwrap_or(SIGMA), par);
        return;
    }
    let sigma = argument("--sigma").unwrap_or(SIGMA);
    let budget = argument("--budget").unwrap_or(BUDGET);
    let features = argument("--features").unwrap_or(if quick { 50 } else { FEATURES });
    measure(&frames, &Setting { sigma, nu, budget, features, par });
}

struct Setting {
    sigma: f64,
    nu: f64,
    budget: usize,
    features: usize,
    par: Par,
}

fn measure(frames: &Frames, setting: &Setting) {
    let &Setting { sigma, nu, budget, features, par } = setting;
    let (d, n) = (frames.x.nrows(), frames.x.ncols());
    let before = Rates::now(par);

    let begin = Instant::now();
    let kernel = Kernel::gaussian(sigma).expect("a positive width");
    let parameters = Parameters { kernel, nu, budget, when_full: WhenFull::Stop, par };
    let options = StreamOptions { retained: n, ..StreamOptions::default() };
    let mut stream = SlowStream::new(Ald::new(parameters).expect("valid parameters"), options).expect("valid options");
    for start in (0..n).step_by(BLOCK) {
        let size = BLOCK.min(n - start);
        let links = &frames.links[start..start + size];
        stream.push(frames.x.as_ref().subcols(start, size), links).expect("finite frames");
    }
    stream.settle().expect("frames that were accepted");
    let grown = begin.elapsed().as_secs_f64();
    let memory_of_stream = peak_resident_bytes();

    let begin = Instant::now();
    let moments = stream.settled_moments().expect("settled before");
    let solved = operations::resolve(moments, features, None, par);
    let model = SlowModel::new(stream.dictionary(), &solved).expect("features over this dictionary");
    let solving = begin.elapsed().as_secs_f64();

    let m = stream.dictionary().len();
    let after = Rates::now(par);
    let useful = Useful::growth_and_moments(d, m, n);
    let share = 0.5 * (before.seconds(useful) + after.seconds(useful)) / grown;
    let gigabytes = |bytes: Option<u64>| bytes.map_or(f64::NAN, |bytes| bytes as f64 / f64::from(1 << 30));
    println!("n = {n}, d = {d}, nu = {nu}, sigma = {sigma}: m = {m}");
    println!(
        "growth and moments {grown:.1} s ({:.0} frames/s, {:.0} % of the matrix-product rate)",
        n as f64 / grown,
        100.0 * share
    );
    println!("{} slow features {solving:.1} s", model.features() - 1);
    println!("from frames to slow features {:.1} s", grown + solving);
    println!(
        "peak resident memory {:.2} GiB, of it {:.2} before the solver; the frames take {:.2}",
        gigabytes(peak_resident_bytes()),
        gigabytes(memory_of_stream),
        gigabytes(Some(4 * (n * d) as u64))
    );
}

/// Tries of the search.
const TRIES: usize = 12;

/// Print widths and how many frames ALD keeps at them, until that is within 1 % of `target`.
///
/// On a logarithmic scale the number falls nearly along a line: each try stands where the line through the two before it
/// meets the target.
fn find_sigma(frames: &Frames, nu: f64, target: usize, start: f64, par: Par) {
    let size_at = |sigma: f64| {
        let most = target + target / 2;
        let mut dictionary = Dictionary::new(Kernel::gaussian(sigma).expect("a positive width"), most, par);
        for start in (0..frames.x.ncols()).step_by(BLOCK) {
            // Far too narrow a kernel would keep everything, and take an hour to say so.
            if dictionary.len() < most {
                let size = BLOCK.min(frames.x.ncols() - start);
                let block = frames.x.as_ref().subcols(start, size);
                dictionary.grow(block, |_, residual| residual > nu).expect("finite frames");
            }
        }
        println!("sigma = {sigma:.1}: {} support vectors", dictionary.len());
        dictionary.len() as f64
    };
    let goal = (target as f64).ln();
    let mut before = (start.ln(), size_at(start).ln());
    let mut next = before.0 + (before.1 - goal) / 2.0;
    for _ in 0..TRIES {
        let now = (next, size_at(next.exp()).ln());
        if (now.1 - goal).abs() < 0.01 {
            return;
        }
        let slope = (now.1 - before.1) / (now.0 - before.0);
        // The number falls with the width; where it does not, rounding or a full dictionary stands in the way.
        let step = (goal - now.1) / slope.clamp(-10.0, -0.5);
        before = now;
        next = now.0 + step.clamp(-0.5, 0.5);
    }
    println!("no width within {TRIES} tries");
}
