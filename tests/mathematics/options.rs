//! Each option of each option type at its extremes, one at a time: an error, or results that are finite. No panic, no allocation that
//! grows with a number alone, no loop without end.

use crate::common::{parameters, random_links, random_path};
use adagio::dictionary::{Ald, FeatureAld, FeatureParameters, Parameters, Selection, WhenFull};
use adagio::kernel::Kernel;
use adagio::random::stream;
use adagio::regression::{Bias, Folds, KernelGrid, select_kernel_ridge};
use adagio::slow::coherence::bray::{self, MovingMean, TermVariance, largest_ratio};
use adagio::slow::coherence::gradient::{AscentOptions, Coherence, OnlineCoherence, OnlineOptions, ascend};
use adagio::slow::coherence::incremental::{self, IncrementalSlow};
use adagio::slow::ica::{self, Decorrelation, fast_ica};
use adagio::slow::{Link, Method, SlowStream, SolveOptions, StreamOptions, solve, solve_with};
use adagio::value::worlds::chain_walk;
use adagio::value::{
    LocalBatch, LocalOptions, LspiOptions, Sarsa, SarsaOptions, Smoothing, StreamQ, StreamQOptions, Window,
};
use faer::{Mat, Par};

const NUMBERS: [f64; 15] = [
    f64::NAN,
    f64::INFINITY,
    f64::NEG_INFINITY,
    -1.0,
    -0.0,
    0.0,
    5e-324,
    1e-300,
    0.5,
    1.0 - f64::EPSILON / 2.0,
    1.0,
    1.0 + f64::EPSILON,
    1e10,
    1e300,
    f64::MAX,
];
const COUNTS: [usize; 7] = [0, 1, 2, 1000, usize::MAX / 2, usize::MAX - 1, usize::MAX];

/// Every setting of the list is tried, and every result must be finite; how many were refused.
fn refused<O: std::fmt::Debug, E: std::fmt::Display>(
    settings: impl IntoIterator<Item = O>,
    of: impl Fn(&O) -> Result<Mat<f64>, E>,
) -> usize {
    let mut refused = 0;
    for setting in settings {
        match of(&setting) {
            Ok(found) => assert!(found.is_all_finite(), "{setting:?}: {found:?}"),
            Err(error) => {
                assert!(error.to_string().len() > 10, "{setting:?}");
                refused += 1;
            }
        }
    }
    refused
}

/// How many of [`NUMBERS`] are outside a range.
fn outside(range: impl std::ops::RangeBounds<f64>) -> usize {
    NUMBERS.iter().filter(|number| !range.contains(number)).count()
}

fn path() -> (Mat<f64>, Vec<Option<Link>>) {
    (random_path(3, 200, 1), random_links(200, 1))
}

fn column(values: impl IntoIterator<Item = f64>) -> Mat<f64> {
    let values: Vec<f64> = values.into_iter().collect();
    Mat::from_fn(values.len(), 1, |i, _| values[i])
}

/// Five states in a row, two actions, of which one is worth most at the end.
fn row(gamma: f64, options: LocalOptions, reward: f64) -> Result<Mat<f64>, adagio::value::ValueError> {
    let mut batch = LocalBatch::new(1, 2)?;
    for t in 0..50 {
        let (at, action) = (f64::from(t % 5), t as usize / 5 % 2);
        let to = (at + if action == 0 { 1.0 } else { -1.0 }).clamp(0.0, 4.0);
        batch.push(&[at], action, if to == 4.0 { reward } else { -reward / 7.0 }, Some(&[to]))?;
    }
    let values = batch.fit(&options, gamma)?;
    assert!((0.0..=1.0).contains(&values.arrival()));
    values.action_values(Mat::from_fn(1, 9, |_, j| j as f64 / 2.0).as_ref())
}

#[test]
fn of_local_values() {
    let usual = LocalOptions::default();
    assert_eq!(refused(COUNTS, |&neighbours| row(0.9, LocalOptions { neighbours, ..usual }, 1.0)), 1);
    // NaN, ±∞, −1, ±0 and what cannot be inverted.
    let of_ridge = refused(NUMBERS, |&ridge| row(0.9, LocalOptions { ridge, ..usual }, 1.0));
    assert!((6..=8).contains(&of_ridge), "{of_ridge}");
    assert_eq!(refused(NUMBERS, |&gamma| row(gamma, usual, 1.0)), outside(0.0..1.0));
    // Values beyond what a regression can take are refused: those of −1e300 too, ten times as large with γ = 0.9.
    assert_eq!(refused(NUMBERS, |&reward| row(0.9, usual, reward)), outside(-1e299..=1e299));
}

#[test]
fn of_policy_iteration() {
    let world = chain_walk::process(4, 0.9, 0.9, &[3]).unwrap();
    let basis = Mat::<f64>::identity(4, 4);
    let batch = world.expected(basis.as_ref(), |_, _| 1.0).unwrap();
    let usual = LspiOptions { gamma: 0.9, ..LspiOptions::default() };
    let fit = |options: &LspiOptions| batch.fit(options).map(|fit| fit.weights);
    assert_eq!(refused(NUMBERS.map(|gamma| LspiOptions { gamma, ..usual }), fit), outside(0.0..1.0));
    assert_eq!(refused(NUMBERS.map(|ridge| LspiOptions { ridge, ..usual }), fit), outside(0.0..=f64::MAX));
    assert_eq!(refused(NUMBERS.map(|mixing| LspiOptions { mixing, ..usual }), fit), outside(5e-324..=1.0));
    assert_eq!(refused(NUMBERS.map(|tolerance| LspiOptions { tolerance, ..usual }), fit), outside(0.0..=f64::MAX));
    assert_eq!(
        refused(NUMBERS.map(|kappa| LspiOptions { closeness: Some(kappa), ..usual }), fit),
        outside(5e-324..=f64::MAX)
    );
    assert_eq!(refused(COUNTS.map(|max_iterations| LspiOptions { max_iterations, ..usual }), fit), 1);
    assert_eq!(refused(NUMBERS.map(|ridge| LspiOptions { ridge, soft: true, ..usual }), fit), outside(0.0..=f64::MAX));
}

#[test]
fn of_other_values() {
    let usual = SarsaOptions { gamma: 0.9, step: 0.5, epsilon: 0.1 };
    let sarsa = |options: &SarsaOptions| {
        let mut sarsa = Sarsa::new(1, 2, *options)?;
        (0..20).try_for_each(|t| sarsa.learn(&[1.0], t % 2, 1.0, Some((&[0.5], 0))).map(drop))?;
        Ok::<_, adagio::value::ValueError>(sarsa.weights().to_owned())
    };
    assert_eq!(refused(NUMBERS.map(|gamma| SarsaOptions { gamma, ..usual }), sarsa), outside(0.0..=1.0));
    assert!(refused(NUMBERS.map(|step| SarsaOptions { step, ..usual }), sarsa) >= 6);
    assert_eq!(refused(NUMBERS.map(|epsilon| SarsaOptions { epsilon, ..usual }), sarsa), outside(0.0..=1.0));
    let usual = StreamQOptions::default();
    let stream_q = |options: &StreamQOptions| {
        let mut values = StreamQ::new(1, 2, *options)?;
        (0..20).try_for_each(|t| values.learn(&[1.0], t % 2, 1.0, Some(&[0.5])).map(drop))?;
        Ok::<_, adagio::value::ValueError>(values.weights().to_owned())
    };
    assert_eq!(refused(NUMBERS.map(|gamma| StreamQOptions { gamma, ..usual }), stream_q), outside(0.0..=1.0));
    assert_eq!(refused(NUMBERS.map(|lambda| StreamQOptions { lambda, ..usual }), stream_q), outside(0.0..=1.0));
    assert!(refused(NUMBERS.map(|step| StreamQOptions { step, ..usual }), stream_q) >= 6);
    assert!(refused(NUMBERS.map(|kappa| StreamQOptions { kappa, ..usual }), stream_q) >= 10);
    let smooth = |&eta: &f64| Smoothing::new(eta)?.push(&[1.0, 2.0]).map(|phi| column(phi.iter().copied()));
    assert!(refused(NUMBERS, smooth) >= 6);
    // A window takes room for what comes, not for what may.
    for capacity in COUNTS {
        assert_eq!(Window::<f64, f64>::new(capacity).len(), 0);
    }
}

#[test]
fn of_slow_features() {
    let (x, links) = path();
    let stream = |options: &StreamOptions| {
        let ald = Ald::new(parameters(1.0, 0.1, 20)).unwrap();
        let mut stream = SlowStream::new(ald, *options)?;
        for block in 0..4 {
            stream.push(x.subcols(50 * block, 50), &links[50 * block..50 * (block + 1)])?;
        }
        solve(stream.settled_moments()?, 2, 1e-6, None).map(|found| found.weights)
    };
    let usual = StreamOptions::default();
    refused(COUNTS.map(|retained| StreamOptions { retained, ..usual }), stream);
    assert!(refused(COUNTS.map(|chunk| StreamOptions { chunk, ..usual }), stream) >= 4);
    refused(COUNTS.map(|settle_at| StreamOptions { settle_at, ..usual }), stream);
    assert!(refused(NUMBERS.map(|memory| StreamOptions { memory_frames: Some(memory), ..usual }), stream) >= 5);

    let mut moments = adagio::slow::Moments::new(Par::Seq);
    moments.widen(3).unwrap();
    moments.add_series(x.as_ref(), &links, None).unwrap();
    let solved = |tolerance: &f64| {
        let options = SolveOptions { method: Method::Lanczos { tolerance: *tolerance }, ..SolveOptions::default() };
        solve_with(&moments, 2, 1e-6, None, &options).map(|found| found.weights)
    };
    refused(NUMBERS, solved);
    assert!(refused(NUMBERS, |&lambda| solve(&moments, 2, lambda, None).map(|found| found.weights)) >= 4);
    assert!(refused(COUNTS, |&k| solve(&moments, k, 1e-6, None).map(|found| found.weights)) >= 5);
}

#[test]
fn of_components_and_coherence() {
    let (x, links) = path();
    let ica = |options: &ica::Options| {
        fast_ica(x.as_ref(), *options, &mut stream(1, "ica")).map(|components| components.unmixing)
    };
    let usual = ica::Options::default();
    for decorrelation in [Decorrelation::Symmetric, Decorrelation::Deflation] {
        let usual = ica::Options { decorrelation, ..usual };
        assert!(refused(NUMBERS.map(|tolerance| ica::Options { tolerance, ..usual }), ica) >= 9);
        assert!(refused(COUNTS.map(|most_iterations| ica::Options { most_iterations, ..usual }), ica) >= 1);
        assert!(refused(COUNTS.map(|components| ica::Options { components: Some(components), ..usual }), ica) >= 4);
    }

    let ratio =
        |options: &bray::Options| largest_ratio(x.as_ref(), &links, *options, 2).map(|features| features.map.weights);
    let usual = bray::Options {
        long: MovingMean::Box { half_width: 20 },
        short: MovingMean::Box { half_width: 1 },
        variance: TermVariance::AroundMean,
        lambda: 0.0,
    };
    assert!(
        refused(COUNTS.map(|half_width| bray::Options { long: MovingMean::Box { half_width }, ..usual }), ratio) >= 2
    );
    assert!(
        refused(COUNTS.map(|half_width| bray::Options { short: MovingMean::Box { half_width }, ..usual }), ratio) >= 4
    );
    let exponential = |half_life| MovingMean::Exponential { half_life };
    assert!(refused(NUMBERS.map(|life| bray::Options { long: exponential(life), ..usual }), ratio) >= 6);
    assert!(refused(NUMBERS.map(|lambda| bray::Options { lambda, ..usual }), ratio) >= 4);

    let usual = AscentOptions {
        objective: Coherence { decorrelation: 1.0, mean: 0.0 },
        features: 2,
        tolerance: 1e-3,
        most_steps: 200,
    };
    let climb = |options: &AscentOptions| {
        ascend(x.as_ref(), &links, *options, &mut stream(1, "start")).map(|ascent| ascent.map.weights)
    };
    assert!(refused(NUMBERS.map(|tolerance| AscentOptions { tolerance, ..usual }), climb) >= 6);
    assert!(refused(COUNTS.map(|features| AscentOptions { features, ..usual }), climb) >= 5);
    refused(COUNTS.map(|most_steps| AscentOptions { most_steps, ..usual }), climb);

    let usual =
        OnlineOptions { objective: usual.objective, features: 2, learning_rate: 1e-3, decay: 0.0, forgetting: 0.01 };
    let online = |options: &OnlineOptions| {
        let mut online = OnlineCoherence::new(3, *options, &mut stream(1, "start"))?;
        (0..200).try_for_each(|t| online.update(x.col(t).try_as_col_major().unwrap().as_slice(), links[t]))?;
        Ok::<_, adagio::slow::coherence::CoherenceError>(online.map().weights.clone())
    };
    assert!(refused(NUMBERS.map(|learning_rate| OnlineOptions { learning_rate, ..usual }), online) >= 6);
    assert!(refused(NUMBERS.map(|decay| OnlineOptions { decay, ..usual }), online) >= 4);
    assert!(refused(NUMBERS.map(|forgetting| OnlineOptions { forgetting, ..usual }), online) >= 9);

    let usual = incremental::Options::new(2, 3);
    let follow = |options: &incremental::Options| {
        let mut stream = IncrementalSlow::new(3, *options, &mut stream(1, "start"))?;
        (0..200).try_for_each(|t| stream.update(x.col(t).try_as_col_major().unwrap().as_slice(), links[t]))?;
        stream.features(x.col(0).try_as_col_major().unwrap().as_slice()).map(column)
    };
    assert!(refused(COUNTS.map(|features| incremental::Options { features, ..usual }), follow) >= 5);
    assert!(refused(COUNTS.map(|whitened| incremental::Options { whitened, ..usual }), follow) >= 5);
    refused(COUNTS.map(|ramp| incremental::Options { ramp, ..usual }), follow);
    assert!(refused(NUMBERS.map(|start| incremental::Options { start, ..usual }), follow) >= 9);
    assert!(refused(NUMBERS.map(|peak| incremental::Options { peak, ..usual }), follow) >= 9);
    assert!(refused(NUMBERS.map(|least| incremental::Options { smallest_variance: least, ..usual }), follow) >= 7);
}

#[test]
fn of_dictionaries_and_kernels() {
    let (x, _) = path();
    let usual = parameters(1.0, 0.1, 20);
    let taken = |parameters: &Parameters| {
        let mut ald = Ald::new(*parameters)?;
        ald.observe(x.as_ref())?;
        ald.into_dictionary().coordinates(x.as_ref())
    };
    for when_full in [WhenFull::Stop, WhenFull::RaiseNu, WhenFull::Replace] {
        let usual = Parameters { when_full, ..usual };
        assert!(refused(NUMBERS.map(|nu| Parameters { nu, ..usual }), taken) >= 6);
        assert!(refused(COUNTS.map(|budget| Parameters { budget, ..usual }), taken) >= 1);
    }
    let kernel = |kernel: Result<Kernel, adagio::kernel::KernelError>| match kernel {
        Ok(kernel) => taken(&Parameters { kernel, ..usual }).map_err(|error| error.to_string()),
        Err(error) => Err(error.to_string()),
    };
    assert!(refused(NUMBERS, |&sigma| kernel(Kernel::gaussian(sigma))) >= 6);
    assert!(refused(NUMBERS, |&exponent| kernel(Kernel::radial(1.0, exponent))) >= 6);
    assert!(refused(NUMBERS, |&offset| kernel(Kernel::polynomial(2, offset))) >= 4);
    assert!(refused([0, 1, 2, 1000, u32::MAX], |&degree| kernel(Kernel::polynomial(degree, 1.0))) >= 1);
    let feature = |parameters: &FeatureParameters| {
        let mut ald = FeatureAld::new(usual, *parameters)?;
        ald.observe(x.as_ref())?;
        ald.dictionary().coordinates(x.as_ref())
    };
    let over = FeatureParameters { kernel: usual.kernel, nu: 0.1 };
    assert!(refused(NUMBERS.map(|nu| FeatureParameters { nu, ..over }), feature) >= 6);
}

#[test]
fn of_regressions() {
    let (x, _) = path();
    let t = Mat::from_fn(1, 200, |_, j| x[(0, j)].sin());
    let folds = Folds::contiguous(200, 4).unwrap();
    let usual = || KernelGrid {
        kernels: vec![Kernel::gaussian(1.0).unwrap()],
        support_vectors: vec![10],
        lambdas: vec![1e-3],
        nu: 0.1,
        bias: Bias::default(),
        seed: 1,
    };
    let select = |grid: &KernelGrid| {
        let found = select_kernel_ridge(x.as_ref(), t.as_ref(), grid, &folds, Par::Seq)?;
        Ok::<_, adagio::regression::RegressionError>(column([found.best().score.test]))
    };
    assert!(refused(NUMBERS.map(|nu| KernelGrid { nu, ..usual() }), select) >= 6);
    assert!(refused(NUMBERS.map(|lambda| KernelGrid { lambdas: vec![lambda], ..usual() }), select) >= 4);
    assert!(refused(COUNTS.map(|most| KernelGrid { support_vectors: vec![most], ..usual() }), select) >= 1);
    for folds in COUNTS {
        assert_eq!(Folds::contiguous(200, folds).is_ok(), (2..=200).contains(&folds));
        assert_eq!(Folds::shuffled(200, folds, 1).is_ok(), (2..=200).contains(&folds));
    }
}
