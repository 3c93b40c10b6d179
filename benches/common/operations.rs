//! The calls to the library that are measured, each in one place, and what has to be set up for them.

use std::collections::BTreeMap;
use std::sync::Arc;

use adagio::dictionary::{Ald, Dictionary, Parameters, WhenFull};
use adagio::kernel::Kernel;
use adagio::slow::{
    Link, Method, Moments, SlowFeatures, SlowModel, SlowStream, SolveOptions, StreamOptions, solve_with,
};
use adagio::value::{Fit, Instances, Local, LocalOptions, LocalOutcomes, Lspi, LspiOptions, Outcomes, Samples};
use faer::{Mat, MatRef, Par};
use rand_distr::{Distribution, StandardNormal};

use super::data::{BLOCK, blocks, width};

/// Regulariser λ, in the units of the slowness.
pub const LAMBDA: f64 = 1e-7;

/// Frames per second of the robot.
const RATE: f64 = 5.0;

/// The largest `m` at which the dense solver is measured: above, one solution takes minutes.
pub const DENSE_MOST: usize = 2000;

/// Links of `n` frames that go on without a gap.
pub fn links(n: usize) -> Vec<Option<Link>> {
    vec![Some(Link { dt: 1.0 / RATE, weight: 1.0 }); n]
}

/// A Gaussian kernel for these frames.
pub fn kernel(x: &Mat<f32>) -> Kernel {
    Kernel::gaussian(width(x)).expect("a width of frames that differ")
}

/// A dictionary of the first `m` frames.
pub fn dictionary(x: &Mat<f32>, m: usize, par: Par) -> Dictionary<f32> {
    let mut dictionary = Dictionary::new(kernel(x), m, par);
    for block in blocks(x, 0..m, BLOCK) {
        dictionary.grow(block, |_, _| true).expect("finite frames");
    }
    assert_eq!(dictionary.len(), m, "frames that are combinations of others cannot become support vectors");
    dictionary
}

/// A stream that takes each of its first `m` frames as a support vector, and then no more.
pub fn empty_stream(x: &Mat<f32>, m: usize, retained: usize, par: Par) -> SlowStream<f32> {
    let parameters = Parameters { kernel: kernel(x), nu: 1e-9, budget: m, when_full: WhenFull::Stop, par };
    let selection = Ald::new(parameters).expect("valid parameters");
    SlowStream::new(selection, StreamOptions { retained, ..StreamOptions::default() }).expect("valid options")
}

/// Frames that go into the moments of these streams as one product.
pub fn chunk() -> usize {
    StreamOptions::default().chunk
}

/// Such a stream with its first `m` frames, and one chunk more: whichever `m` is, all work that is left over from growing is
/// done, and each further chunk of frames costs the same. The frames are those behind the first `m`, of which there have to
/// be so many.
pub fn full_stream(x: &Mat<f32>, m: usize, retained: usize, par: Par) -> SlowStream<f32> {
    let mut stream = empty_stream(x, m, retained, par);
    push(&mut stream, x, 0..m);
    finish_growing(&mut stream, x, m);
    stream
}

/// Settle, and take one chunk of the frames behind the first `m`.
pub fn finish_growing(stream: &mut SlowStream<f32>, x: &Mat<f32>, m: usize) {
    stream.settle().expect("frames that were accepted");
    push(stream, x, m..m + chunk());
}

/// Growth and moments of some of the frames.
pub fn push(stream: &mut SlowStream<f32>, x: &Mat<f32>, range: std::ops::Range<usize>) {
    for block in blocks(x, range, BLOCK) {
        push_block(stream, block);
    }
}

/// Growth and moments of one block.
pub fn push_block(stream: &mut SlowStream<f32>, block: MatRef<'_, f32>) {
    stream.push(block, &links(block.ncols())).expect("finite frames");
}

/// Moments over the coordinates of all frames in a dictionary.
pub fn moments(dictionary: &Dictionary<f32>, x: &Mat<f32>, par: Par) -> Moments {
    let mut moments = Moments::new(par);
    moments.widen(dictionary.len()).expect("not too many coordinates");
    let mut before: Option<Mat<f64>> = None;
    for block in blocks(x, 0..x.ncols(), BLOCK) {
        let v = dictionary.coordinates(block).expect("finite frames");
        let mut links = links(v.ncols());
        if before.is_none() {
            links[0] = None;
        }
        add_series(&mut moments, v.as_ref(), &links, before.as_ref().map(|last| last.as_ref()));
        before = Some(v.as_ref().subcols(v.ncols() - 1, 1).to_owned());
    }
    moments
}

/// Moments of one block of coordinates.
pub fn add_series(moments: &mut Moments, v: MatRef<'_, f64>, links: &[Option<Link>], before: Option<MatRef<'_, f64>>) {
    moments.add_series(v, links, before).expect("blocks that fit");
}

/// Slow features by the solver of the running agent, whose `agent.threads` are `par`.
pub fn resolve(moments: &Moments, k: usize, previous: Option<&SlowFeatures>, par: Par) -> SlowFeatures {
    let options = SolveOptions { method: Method::Automatic, par };
    solve_with(moments, k, LAMBDA, previous, &options).expect("moments of enough frames")
}

/// Slow features by the dense reference solver.
pub fn resolve_dense(moments: &Moments, k: usize, par: Par) -> SlowFeatures {
    let options = SolveOptions { method: Method::Dense, par };
    solve_with(moments, k, LAMBDA, None, &options).expect("moments of enough frames")
}

/// A model of `k` random features over the first `m` frames: it costs what a solved one costs.
pub fn random_model(x: &Mat<f32>, m: usize, k: usize) -> SlowModel<f32> {
    let members = x.as_ref().subcols(0, m).to_owned();
    SlowModel::from_parts(kernel(x), members, random(m, k), vec![0.0; k], vec![1.0; k]).expect("parts that fit")
}

/// Features of observations.
pub fn features(model: &SlowModel<f32>, x: MatRef<'_, f32>, par: Par) -> Mat<f64> {
    model.apply(x, par).expect("observations of the right length")
}

/// A matrix of independent normal numbers.
pub fn random(rows: usize, columns: usize) -> Mat<f64> {
    let mut rng = adagio::random::stream(1, "bench matrix");
    Mat::from_fn(rows, columns, |_, _| StandardNormal.sample(&mut rng))
}

/// Transitions in features, as policy iteration wants them.
pub struct Transitions {
    pub phi: Mat<f64>,
    pub next: Mat<f64>,
    pub actions: Vec<usize>,
    pub rewards: Vec<f64>,
    pub weights: Vec<f64>,
}

/// Number of actions.
pub const ACTIONS: usize = 3;

/// The action between two poses of a walk: the sign of the turn, or straight on, tells it.
pub fn turn(poses: &[[f64; 3]], t: usize) -> usize {
    match poses[t + 1][2] - poses[t][2] {
        turn if turn > 0.05 => 1,
        turn if turn < -0.05 => 2,
        _ => 0,
    }
}

impl Transitions {
    /// `n` transitions of a walk, with `k` waves of the pose and the constant as features.
    pub fn of_walk(n: usize, k: usize) -> Self {
        let poses = super::data::walk(n + 1);
        let waves = random(4, k);
        let feature = |i: usize, [x, y, heading]: [f64; 3]| match i.checked_sub(1) {
            None => 1.0,
            Some(i) => {
                let turns = (i % 4) as f64;
                (2.0 * (waves[(0, i)] * x + waves[(1, i)] * y) + turns * heading + 3.0 * waves[(2, i)]).cos()
            }
        };
        let in_goal = |[x, y, _]: [f64; 3]| (x - 1.5).hypot(y - 0.9) < 0.2;
        Transitions {
            phi: Mat::from_fn(k + 1, n, |i, t| feature(i, poses[t])),
            next: Mat::from_fn(k + 1, n, |i, t| feature(i, poses[t + 1])),
            actions: (0..n).map(|t| turn(&poses, t)).collect(),
            rewards: (0..n).map(|t| if in_goal(poses[t + 1]) { 1.0 } else { 0.0 }).collect(),
            weights: vec![1.0; n],
        }
    }

    /// Policy iteration for one task, with the first products of its samples.
    pub fn refit(&self, par: Par) -> Fit {
        let samples = Samples { phi: self.phi.as_ref(), actions: &self.actions, weights: &self.weights };
        let problem = Lspi::new(samples, ACTIONS, par).expect("valid samples");
        let outcomes = Outcomes { next: self.next.as_ref(), rewards: &self.rewards, allowed: None };
        let options = LspiOptions {
            gamma: 0.9,
            ridge: 0.1,
            mixing: 0.3,
            max_iterations: 40,
            tolerance: 1e-3,
            ..LspiOptions::default()
        };
        problem.fit(&outcomes, &options).expect("valid outcomes")
    }
}

/// How local values are told, as in the scenarios' defaults.
const LOCAL: LocalOptions = LocalOptions { neighbours: 16, ridge: 0.1 };

impl Transitions {
    /// Local values for so many tasks, neighbours included; the features without the constant one are coordinates.
    pub fn refit_locally(&self, tasks: usize) -> Vec<Fit> {
        let mut order: Vec<usize> = (0..self.actions.len()).collect();
        order.sort_by_key(|&t| self.actions[t]);
        let counts = (0..ACTIONS).map(|a| self.actions.iter().filter(|&&action| action == a).count()).collect();
        let points = |phi: &Mat<f64>| Mat::from_fn(phi.nrows() - 1, order.len(), |i, j| phi[(i + 1, order[j])] as f32);
        let instances = Instances::new(points(&self.phi), counts, LOCAL).expect("valid instances");
        let local = Local::new(&instances, points(&self.next).as_ref()).expect("valid ends");
        let rewards: Vec<f64> = order.iter().map(|&t| self.rewards[t]).collect();
        let (allowed, ended) = (vec![7; rewards.len()], vec![false; rewards.len()]);
        let outcomes = LocalOutcomes { rewards: &rewards, allowed: &allowed, ended: &ended, bounded: &ended };
        local.fit_all(&vec![outcomes; tasks], 0.9).expect("valid outcomes")
    }
}

/// What was learned with local values: over `m` support vectors and `k` features, of which `p` are coordinates, for one task and
/// `n` transitions of each action.
pub fn learned_locally(x: &Mat<f32>, m: usize, k: usize, p: usize, n: usize) -> adagio::policy::Learned {
    let points = random(p, ACTIONS * n);
    let points = Mat::from_fn(p, ACTIONS * n, |i, j| points[(i, j)] as f32);
    let instances = Instances::new(points, vec![n; ACTIONS], LOCAL).expect("valid instances");
    let worth = vec![random(ACTIONS * n, 1)];
    adagio::policy::Learned::local(1, 0, 0, random_model(x, m, k), Arc::new(instances), worth, None)
        .expect("instances that fit the model")
}

/// What was learned, over `m` support vectors and `k` features, for one task.
pub fn learned(x: &Mat<f32>, m: usize, k: usize) -> adagio::policy::Learned {
    adagio::policy::Learned::new(1, 0, 0, random_model(x, m, k), vec![random(k + 1, ACTIONS)])
        .expect("weights that fit the model")
}

/// A run of a scenario without evaluation, its log in a folder of its own. Gives the number of frames.
pub fn run(scenario: &Arc<adagio::scenario::Scenario>) -> u64 {
    use adagio::agent::{RunOptions, Status};
    use std::sync::atomic::AtomicBool;

    let folder = tempfile::tempdir().expect("a temporary folder");
    let options = adagio::log::LogOptions::default();
    let storage = adagio::log::Folder::new(folder.path());
    let log = adagio::log::RunLog::create(storage, &options, adagio::log::Rotation::NEVER, &BTreeMap::new())
        .expect("a log in a new folder");
    let world = Arc::new(adagio::world::World::new(scenario).expect("a scenario without image files"));
    let mut source = adagio::world::Simulated::new(scenario.clone(), world.clone());
    let (stop, status) = (AtomicBool::new(false), Status::default());
    adagio::agent::run(scenario, &world.plan, &mut source, log, RunOptions::new(&stop, &status)).expect("a run").frames
}
