//! Do three ideas of the thesis's outlook help policy iteration? Two tables, measured over many seeds.
//!
//! `cargo run --release --example outlook` (about a minute and a half)
//!
//! The world is two rooms with a door between them, in which one move in ten slips to the side. Policies are learned from random
//! steps, in cosines over the map. The first table compares options of policy iteration: mixing policies, soft actions,
//! the policy-dependent norm. The second one smooths noisy features along the way.

use std::error::Error;
use std::f64::consts::PI;

use adagio::random::{fix_parallelism, stream};
use adagio::value::worlds::rooms::{Rooms, TWO_ROOMS};
use adagio::value::{Batch, FiniteMdp, LspiOptions, Smoothing, Start, ValueError, exact, greedy};
use faer::Mat;
use rand::{Rng, RngExt};
use rand_distr::{Distribution, StandardNormal};

const GAMMA: f64 = 0.95;
/// Probability that a move goes to one of its sides.
const SLIP: f64 = 0.1;

fn main() -> Result<(), Box<dyn Error>> {
    fix_parallelism();
    let rooms = Rooms::parse(TWO_ROOMS)?;
    options_of_policy_iteration(&rooms)?;
    smoothing_of_noisy_features(&rooms)?;
    Ok(())
}

/// Products of the first `count` cosines in each direction of the map, `count² × S`.
fn cosines(rooms: &Rooms, count: usize) -> Mat<f64> {
    let (width, height) = rooms.size();
    let wave = |j: usize, place: usize, size: usize| (j as f64 * PI * (place as f64 + 0.5) / size as f64).cos();
    Mat::from_fn(count * count, rooms.states(), |k, s| {
        let (x, y) = rooms.places()[s];
        wave(k / count, x, width) * wave(k % count, y, height)
    })
}

/// Mean over seeds and its standard error.
fn mean_and_error(results: &[f64]) -> (f64, f64) {
    let n = results.len() as f64;
    let mean = results.iter().sum::<f64>() / n;
    let variance = results.iter().map(|r| (r - mean).powi(2)).sum::<f64>() / (n - 1.0);
    (mean, (variance / n).sqrt())
}

/// How many runs converge, and what their policies are worth: `Σ V^π / Σ V*` over all states, exactly.
fn options_of_policy_iteration(rooms: &Rooms) -> Result<(), ValueError> {
    const STEPS: usize = 500;
    const SEEDS: u64 = 20;
    let plain = LspiOptions { gamma: GAMMA, ridge: 1e-3, tolerance: 1e-4, max_iterations: 60, ..LspiOptions::plain() };
    let mixed = LspiOptions { mixing: 0.3, ..plain };
    let variants = [
        ("plain, from all actions alike", plain),
        ("plain, from drawn actions", LspiOptions { start: Start::Drawn(1), ..plain }),
        ("β = 0.3", mixed),
        ("soft actions", LspiOptions { soft: true, ..plain }),
        ("soft actions, β = 0.3", LspiOptions { soft: true, ..mixed }),
        ("norm κ = 1", LspiOptions { closeness: Some(1.0), ..plain }),
        ("norm κ = 1, β = 0.3", LspiOptions { closeness: Some(1.0), ..mixed }),
    ];
    let process = rooms.process(GAMMA, SLIP)?;
    let best: f64 = exact::policy_iteration(&process)?.values.iter().sum();
    println!(
        "Options of policy iteration: {STEPS} random steps, {SEEDS} seeds; runs that converged, share of the optimum\n"
    );
    println!("| | 16 features | 36 features |\n|---|---|---|");
    for (name, options) in variants {
        let mut cells = Vec::new();
        for basis in [cosines(rooms, 4), cosines(rooms, 6)] {
            let (mut converged, mut shares) = (0, Vec::new());
            for seed in 0..SEEDS {
                let steps = process.uniform_steps(STEPS, &mut stream(seed, "samples"));
                let fit = process.in_features(&steps, basis.as_ref())?.fit(&options)?;
                let values = exact::values(&process, &fit.policy(basis.as_ref())?)?;
                converged += usize::from(fit.converged);
                shares.push(values.iter().sum::<f64>() / best);
            }
            let (mean, error) = mean_and_error(&shares);
            cells.push(format!("{converged} of {SEEDS}, {mean:.2} ± {error:.2}"));
        }
        println!("| {name} | {} | {} |", cells[0], cells[1]);
    }
    Ok(())
}

/// Noisy features, smoothed in training and in control: the mean discounted return.
fn smoothing_of_noisy_features(rooms: &Rooms) -> Result<(), ValueError> {
    const SEEDS: u64 = 10;
    const ETAS: [f64; 4] = [0.0, 0.1, 0.2, 0.4];
    let process = rooms.process(GAMMA, SLIP)?;
    let basis = cosines(rooms, 5);
    println!("\nSmoothing of noisy features: mean return over {SEEDS} seeds\n");
    println!("| noise | η = 0 | 0.1 | 0.2 | 0.4 |\n|---|---|---|---|---|");
    for noise in [0.0, 0.2, 0.5] {
        let world = Noisy { process: &process, basis: &basis, noise };
        let mut row = format!("| {noise} ");
        for eta in ETAS {
            let returns: Result<Vec<f64>, ValueError> = (0..SEEDS).map(|seed| world.mean_return(eta, seed)).collect();
            let (mean, error) = mean_and_error(&returns?);
            row += &format!("| {mean:.2} ± {error:.2} ");
        }
        println!("{row}|");
    }
    Ok(())
}

/// A process seen through features with independent Gaussian noise.
struct Noisy<'a> {
    process: &'a FiniteMdp,
    basis: &'a Mat<f64>,
    noise: f64,
}

impl Noisy<'_> {
    /// The features of a state, as seen once. The constant one is not seen but known.
    fn seen(&self, state: usize, rng: &mut impl Rng) -> Vec<f64> {
        let noise = |i: usize, rng: &mut _| {
            let normal: f64 = StandardNormal.sample(rng);
            if i == 0 { 0.0 } else { self.noise * normal }
        };
        (0..self.basis.nrows()).map(|i| self.basis[(i, state)] + noise(i, rng)).collect()
    }

    fn start(&self, rng: &mut impl Rng) -> usize {
        loop {
            let state = rng.random_range(0..self.process.states());
            if !self.process.is_terminal(state) {
                return state;
            }
        }
    }

    /// Learn from a random walk with smoothed features, then act on smoothed features.
    fn mean_return(&self, eta: f64, seed: u64) -> Result<f64, ValueError> {
        const STEPS: usize = 4000;
        const EPISODE: usize = 40;
        const TRIALS: usize = 200;
        const LONGEST: usize = 200;
        let rng = &mut stream(seed, "walk");
        let mut smoothing = Smoothing::new(eta)?;
        let mut batch = Batch::new(self.basis.nrows(), self.process.actions())?;
        while batch.len() < STEPS {
            smoothing.gap();
            let mut state = self.start(rng);
            let mut x = smoothing.push(&self.seen(state, rng))?.to_vec();
            for _ in 0..EPISODE {
                let action = rng.random_range(0..self.process.actions());
                let Some(step) = self.process.step(state, action, rng)? else { break };
                let next = smoothing.push(&self.seen(step.to, rng))?.to_vec();
                let after = (!self.process.is_terminal(step.to)).then_some(next.as_slice());
                batch.push(&x, action, step.reward, after, 1.0)?;
                (state, x) = (step.to, next);
            }
        }
        let options = LspiOptions { gamma: GAMMA, ridge: 1e-3, mixing: 0.3, tolerance: 1e-4, ..LspiOptions::plain() };
        let weights = batch.fit(&options)?.weights;
        let mut sum = 0.0;
        for _ in 0..TRIALS {
            smoothing.gap();
            let (mut state, mut discount) = (self.start(rng), 1.0);
            for _ in 0..LONGEST {
                let x = smoothing.push(&self.seen(state, rng))?;
                let value = |a: usize| x.iter().enumerate().map(|(i, x)| x * weights[(i, a)]).sum::<f64>();
                let action = greedy((0..self.process.actions()).map(value));
                let Some(step) = self.process.step(state, action, rng)? else { break };
                sum += discount * step.reward;
                discount *= GAMMA;
                state = step.to;
            }
        }
        Ok(sum / TRIALS as f64)
    }
}
