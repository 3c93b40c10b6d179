//! What the machine itself can do: the measure that shares refer to.

use std::time::Instant;

use faer::linalg::matmul::matmul;
use faer::traits::ComplexField;
use faer::{Accum, Mat, Par};

/// Rates of faer's matrix product on this machine, operations per second.
#[derive(Debug, Clone, Copy)]
pub struct Rates {
    pub single: f64,
    pub double: f64,
}

/// Edge of the matrices whose product is timed: large enough for the full rate, small enough to be timed often.
const EDGE: usize = 1500;

impl Rates {
    /// The rates at this moment: the best of two products in each precision, so that a start-up does not count.
    pub fn now(par: Par) -> Self {
        Rates { single: rate(1.0f32, par), double: rate(1.0f64, par) }
    }

    /// The seconds that so many operations take at these rates.
    pub fn seconds(&self, useful: Useful) -> f64 {
        useful.single / self.single + useful.double / self.double
    }
}

/// Operations (a multiplication or an addition is one) that count, by the precision they run in.
#[derive(Debug, Clone, Copy, Default)]
pub struct Useful {
    pub single: f64,
    pub double: f64,
}

impl Useful {
    /// Growth and moments of `n` frames of `d` values over `m` support vectors: kernel rows `2dmn` in `f32`; the triangular
    /// solve `m²n` and two symmetric updates of `m²n` each in `f64`. This is the dense form: what is known beforehand about
    /// frames that are support vectors themselves is not made use of.
    pub fn growth_and_moments(d: usize, m: usize, n: usize) -> Self {
        let (d, m, n) = (d as f64, m as f64, n as f64);
        Useful { single: 2.0 * d * m * n, double: 3.0 * m * m * n }
    }
}

fn rate<T: ComplexField + Copy>(one: T, par: Par) -> f64 {
    let a = Mat::from_fn(EDGE, EDGE, |_, _| one);
    let mut c = Mat::from_fn(EDGE, EDGE, |_, _| one);
    let operations = 2.0 * (EDGE as f64).powi(3);
    let once = |c: &mut Mat<T>| {
        let begin = Instant::now();
        matmul(c.as_mut(), Accum::Replace, a.as_ref(), a.as_ref(), one, par);
        operations / begin.elapsed().as_secs_f64()
    };
    once(&mut c).max(once(&mut c))
}

/// One line on the machine, printed at the head of every bench.
pub fn header() {
    let cpu = std::fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
    let model = cpu.lines().find_map(|line| line.strip_prefix("model name")).unwrap_or(": unknown");
    let avx512 = if cpu.contains("avx512f") { "AVX-512" } else { "no AVX-512" };
    let cores = std::thread::available_parallelism().map_or(0, usize::from);
    let (one, two) = (Rates::now(Par::Seq), Rates::now(Par::rayon(2)));
    let giga = |rate: f64| rate * 1e-9;
    println!(
        "machine{model}, {cores} cores, {avx512}; matrix product in GF/s, 1 and 2 threads: f32 {:.0} and {:.0}, f64 {:.0} and {:.0}",
        giga(one.single),
        giga(two.single),
        giga(one.double),
        giga(two.double)
    );
}

/// Median, smallest and largest of some figures.
#[derive(Debug, Clone, Copy)]
pub struct Spread {
    pub median: f64,
    pub least: f64,
    pub most: f64,
}

impl Spread {
    /// The spread of at least one figure.
    pub fn of(figures: &[f64]) -> Self {
        let mut sorted = figures.to_vec();
        sorted.sort_by(f64::total_cmp);
        Spread { median: sorted[sorted.len() / 2], least: sorted[0], most: sorted[sorted.len() - 1] }
    }
}
