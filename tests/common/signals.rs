//! Signals, dictionaries and moments of them.

use faer::{Mat, MatRef, Par};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use adagio::dictionary::{Ald, Dictionary, Parameters, WhenFull};
use adagio::kernel::Kernel;
use adagio::slow::{Link, Moments};

pub fn generator(seed: u64) -> ChaCha8Rng {
    ChaCha8Rng::seed_from_u64(seed)
}

/// A smooth random path of `n` points in `[0, 1]^d`, one a column: what a camera stream looks like to a dictionary.
pub fn random_path(d: usize, n: usize, seed: u64) -> Mat<f64> {
    let mut rng = generator(seed);
    let mut point = vec![0.5f64; d];
    let mut path = Mat::zeros(d, n);
    for j in 0..n {
        for (i, value) in point.iter_mut().enumerate() {
            *value = (*value + rng.random_range(-0.08..0.08)).clamp(0.0, 1.0);
            path[(i, j)] = *value;
        }
    }
    path
}

/// A random rotation: the factor Q of a matrix of uniform numbers.
pub fn rotation(d: usize, seed: u64) -> Mat<f64> {
    let mut rng = generator(seed);
    Mat::from_fn(d, d, |_, _| rng.random_range(-1.0..1.0)).qr().compute_Q()
}

pub fn parameters(sigma: f64, nu: f64, budget: usize) -> Parameters {
    Parameters { kernel: Kernel::gaussian(sigma).unwrap(), nu, budget, when_full: WhenFull::Stop, par: Par::Seq }
}

pub fn ald(sigma: f64, nu: f64, budget: usize) -> Ald<f64> {
    Ald::new(parameters(sigma, nu, budget)).unwrap()
}

/// Moments of a whole series at once, by their definition.
pub fn batch_moments(v: MatRef<'_, f64>, links: &[Option<Link>]) -> Moments {
    let mut moments = Moments::new(Par::Seq);
    moments.widen(v.nrows()).unwrap();
    let linked: Vec<(usize, Link)> = links.iter().enumerate().filter_map(|(t, l)| l.map(|l| (t, l))).collect();
    let rates = Mat::from_fn(v.nrows(), linked.len(), |i, j| {
        let (t, link) = linked[j];
        link.weight.sqrt() * (v[(i, t)] - v[(i, t - 1)]) / link.dt
    });
    moments.add(v, rates.as_ref(), linked.iter().map(|(_, l)| l.weight).sum()).unwrap();
    moments
}

/// Links of random length and weight, with a gap now and then.
pub fn random_links(n: usize, seed: u64) -> Vec<Option<Link>> {
    let mut rng = generator(seed);
    (0..n)
        .map(|t| {
            let linked = t > 0 && rng.random_range(0.0..1.0) < 0.9;
            let link = Link { dt: rng.random_range(0.1..1.0), weight: rng.random_range(0.2..5.0) };
            linked.then_some(link)
        })
        .collect()
}

/// Mean, covariance and rate agree to a relative tolerance.
pub fn assert_same_moments(a: &Moments, b: &Moments, tolerance: f64) {
    assert_eq!(a.size(), b.size());
    assert!((a.frames() - b.frames()).abs() < 1e-9 && (a.links() - b.links()).abs() < 1e-9);
    for (a, b) in [(a.mean(), b.mean()), (a.covariance(), b.covariance()), (a.rate(), b.rate())] {
        let difference = relative_difference(a.as_ref(), b.as_ref());
        assert!(difference < tolerance, "moments differ by {difference}");
    }
}

/// Correlation of two series.
pub fn correlation(a: &[f64], b: &[f64]) -> f64 {
    let mean = |x: &[f64]| x.iter().sum::<f64>() / x.len() as f64;
    let (ma, mb) = (mean(a), mean(b));
    let dot =
        |x: &[f64], mx: f64, y: &[f64], my: f64| -> f64 { x.iter().zip(y).map(|(x, y)| (x - mx) * (y - my)).sum() };
    dot(a, ma, b, mb) / (dot(a, ma, a, ma) * dot(b, mb, b, mb)).sqrt()
}

/// Largest difference of two matrices, as a share of the largest entry of the second.
pub fn relative_difference(a: MatRef<'_, f64>, b: MatRef<'_, f64>) -> f64 {
    assert_eq!((a.nrows(), a.ncols()), (b.nrows(), b.ncols()));
    (a - b).norm_max() / b.norm_max()
}

/// Condition of a dictionary's kernel matrix, the square of that of its factor: rounding passes through solves with it.
pub fn condition(dictionary: &Dictionary<f64>) -> f64 {
    let singular = dictionary.factor().svd().unwrap();
    (singular.S()[0] / singular.S()[dictionary.len() - 1]).powi(2)
}
