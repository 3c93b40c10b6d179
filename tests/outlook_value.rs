//! Do the ideas of the thesis's outlook help? Measurements over many seeds, printed as tables; they are long and ignored by
//! default:
//!
//! `cargo test --release --test outlook_value -- --ignored --nocapture`
//!
//! A figure is the mean over seeds of `Σ_s V^π(s) / Σ_s V*(s)`: the exact value of what the learned policy does, as a share
//! of the optimum.

use adagio::random::stream;
use adagio::value::worlds::rooms::{Rooms, TWO_ROOMS};
use adagio::value::worlds::{bases, chain_walk};
use adagio::value::{Batch, FiniteMdp, Fit, LspiOptions, Policy, Smoothing, Start, exact, greedy};
use faer::Mat;
use rand::{Rng, RngExt};
use rand_distr::{Distribution, Normal};

/// A process with features, and how noisily they are seen.
struct World {
    name: String,
    process: FiniteMdp,
    basis: Mat<f64>,
    samples: usize,
    noise: f64,
}

/// Cosines over the map, `count` in each direction.
fn cosines(rooms: &Rooms, count: usize) -> Mat<f64> {
    let (width, height) = rooms.size();
    let wave = |j: usize, place: usize, size: usize| {
        (j as f64 * std::f64::consts::PI * (place as f64 + 0.5) / size as f64).cos()
    };
    Mat::from_fn(count * count, rooms.states(), |k, s| {
        let (x, y) = rooms.places()[s];
        wave(k / count, x, width) * wave(k % count, y, height)
    })
}

fn seen(world: &World, state: usize, rng: &mut impl Rng) -> Vec<f64> {
    // 0 ≤ noise is finite in all worlds here.
    let normal = Normal::new(0.0, world.noise).unwrap();
    // The constant feature is not seen but known.
    let noise = |i: usize, rng: &mut _| if i == 0 { 0.0 } else { normal.sample(rng) };
    (0..world.basis.nrows()).map(|i| world.basis[(i, state)] + noise(i, rng)).collect()
}

fn sample(world: &World, seed: u64) -> Batch {
    let mut rng = stream(seed, "samples");
    let mut batch = Batch::new(world.basis.nrows(), world.process.actions()).unwrap();
    for step in world.process.uniform_steps(world.samples, &mut rng) {
        let phi = seen(world, step.from, &mut rng);
        let next = (!world.process.is_terminal(step.to)).then(|| seen(world, step.to, &mut rng));
        batch.push(&phi, step.action, step.reward, next.as_deref(), 1.0).unwrap();
    }
    batch
}

/// What a policy that acts on noisy features is worth.
fn quality(world: &World, fit: &Fit, best: &[f64], seed: u64) -> f64 {
    let mut rng = stream(seed, "views");
    let views = if world.noise > 0.0 { 40 } else { 1 };
    let (actions, states) = (world.process.actions(), world.process.states());
    let mut shares = Mat::<f64>::zeros(actions, states);
    for s in 0..states {
        for _ in 0..views {
            let phi = seen(world, s, &mut rng);
            let value = |a: usize| phi.iter().enumerate().map(|(i, p)| p * fit.weights[(i, a)]).sum::<f64>();
            shares[(greedy((0..actions).map(value)), s)] += 1.0 / f64::from(views);
        }
    }
    let values = exact::values(&world.process, &Policy::new(shares.as_ref()).unwrap()).unwrap();
    values.iter().sum::<f64>() / best.iter().sum::<f64>()
}

fn worlds() -> Vec<World> {
    let rooms = Rooms::parse(TWO_ROOMS).unwrap();
    let mut worlds = Vec::new();
    for (count, samples, noise) in [(4, 500, 0.0), (6, 500, 0.0), (4, 500, 0.2)] {
        worlds.push(World {
            name: format!("rooms, {} features, {samples} samples, noise {noise}", count * count),
            process: rooms.process(0.95, 0.1).unwrap(),
            basis: cosines(&rooms, count),
            samples,
            noise,
        });
    }
    for (centres, samples, noise) in [(10, 500, 0.0), (10, 2000, 0.1)] {
        worlds.push(World {
            name: format!("chain of 50, {} features, {samples} samples, noise {noise}", centres + 1),
            process: chain_walk::fifty().unwrap(),
            basis: bases::bumps(50, centres).unwrap(),
            samples,
            noise,
        });
    }
    worlds
}

#[test]
#[ignore = "a measurement of some minutes"]
fn options_of_policy_iteration() {
    let base = LspiOptions { ridge: 1e-3, tolerance: 1e-4, max_iterations: 60, ..LspiOptions::default() };
    let mixed = LspiOptions { mixing: 0.3, ..base };
    let variants = [
        ("uniform start", base),
        ("drawn start", LspiOptions { start: Start::Drawn(1), ..base }),
        ("mixing 0.3", mixed),
        ("soft", LspiOptions { soft: true, ..base }),
        ("soft, mixing 0.3", LspiOptions { soft: true, ..mixed }),
        ("norm 1", LspiOptions { closeness: Some(1.0), ..base }),
        ("norm 1, mixing 0.3", LspiOptions { closeness: Some(1.0), ..mixed }),
        ("soft, norm 1, mixing 0.3", LspiOptions { soft: true, closeness: Some(1.0), ..mixed }),
    ];
    let seeds = 20;
    for world in worlds() {
        println!("{}", world.name);
        let best = exact::policy_iteration(&world.process).unwrap().values;
        for (name, options) in variants {
            let options = LspiOptions { gamma: world.process.gamma(), ..options };
            let mut results = Vec::new();
            let (mut converged, mut iterations) = (0, 0);
            for seed in 0..seeds {
                let fit = sample(&world, seed).fit(&options).unwrap();
                converged += usize::from(fit.converged);
                iterations += fit.iterations;
                results.push(quality(&world, &fit, &best, seed));
            }
            let mean = results.iter().sum::<f64>() / results.len() as f64;
            let error = (results.iter().map(|r| (r - mean).powi(2)).sum::<f64>()).sqrt() / results.len() as f64;
            println!(
                "  {name:26} value {mean:.3} ± {error:.3}, converged {converged:2} of {seeds}, {:.1} iterations",
                iterations as f64 / seeds as f64
            );
        }
    }
}

/// Noisy features, smoothed along the way, in training and in control.
#[test]
#[ignore = "a measurement of some minutes"]
fn smoothing_of_noisy_features() {
    let rooms = Rooms::parse(TWO_ROOMS).unwrap();
    let gamma = 0.95;
    let (steps, seeds, trials, longest) = (4000, 10, 200, 200);
    for noise in [0.0, 0.2, 0.5] {
        let process = rooms.process(gamma, 0.1).unwrap();
        let world = World { name: String::new(), process, basis: cosines(&rooms, 5), samples: 0, noise };
        let starts: Vec<usize> = (0..world.process.states()).filter(|&s| !world.process.is_terminal(s)).collect();
        for eta in [0.0, 0.1, 0.2, 0.4] {
            let mut results = Vec::new();
            for seed in 0..seeds {
                let mut rng = stream(seed, "walk");
                let mut smoothing = Smoothing::new(eta).unwrap();
                let mut batch = Batch::new(world.basis.nrows(), 4).unwrap();
                let mut state = starts[rng.random_range(0..starts.len())];
                let mut x = smoothing.push(&seen(&world, state, &mut rng)).unwrap().to_vec();
                let mut since = 0;
                while batch.len() < steps {
                    let action = rng.random_range(0..4);
                    let step = world.process.step(state, action, &mut rng).unwrap().unwrap();
                    since += 1;
                    let over = world.process.is_terminal(step.to);
                    let next = smoothing.push(&seen(&world, step.to, &mut rng)).unwrap().to_vec();
                    batch.push(&x, action, step.reward, (!over).then_some(next.as_slice()), 1.0).unwrap();
                    (state, x) = (step.to, next);
                    if over || since == 40 {
                        smoothing.gap();
                        since = 0;
                        state = starts[rng.random_range(0..starts.len())];
                        x = smoothing.push(&seen(&world, state, &mut rng)).unwrap().to_vec();
                    }
                }
                let options =
                    LspiOptions { gamma, ridge: 1e-3, mixing: 0.3, tolerance: 1e-4, ..LspiOptions::default() };
                let fit = batch.fit(&options).unwrap();
                let mut sum = 0.0;
                for _ in 0..trials {
                    smoothing.gap();
                    let mut state = starts[rng.random_range(0..starts.len())];
                    let mut discount = 1.0;
                    for _ in 0..longest {
                        let x = smoothing.push(&seen(&world, state, &mut rng)).unwrap().to_vec();
                        let value = |a: usize| x.iter().enumerate().map(|(i, p)| p * fit.weights[(i, a)]).sum::<f64>();
                        let step = world.process.step(state, greedy((0..4).map(value)), &mut rng).unwrap().unwrap();
                        sum += discount * step.reward;
                        discount *= gamma;
                        state = step.to;
                        if world.process.is_terminal(state) {
                            break;
                        }
                    }
                }
                results.push(sum / f64::from(trials));
            }
            let mean = results.iter().sum::<f64>() / results.len() as f64;
            let error = (results.iter().map(|r| (r - mean).powi(2)).sum::<f64>()).sqrt() / results.len() as f64;
            println!("noise {noise}, eta {eta:4}: return {mean:.3} ± {error:.3}");
        }
    }
}
