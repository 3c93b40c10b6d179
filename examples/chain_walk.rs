//! A walk through least-squares policy iteration, on chains whose answers are known.
//!
//! `cargo run --release --example chain_walk`
//!
//! States stand in a row; the actions go left or right and fail once in ten times; some states pay 1 a step
//! (Lagoudakis & Parr 2003, §9.1). First, policies are learned from random steps with different features, and compared
//! with the exact one. Then the chain of Koller & Parr shows why the steps should be spread evenly over states and actions.

use adagio::random::stream;
use adagio::value::worlds::{bases, chain_walk, koller_parr};
use adagio::value::{FiniteMdp, LspiOptions, Policy, ValueError, exact};
use faer::Mat;

fn main() -> Result<(), ValueError> {
    adagio::random::fix_parallelism();
    let twenty = chain_walk::twenty()?;
    learn("20 states, reward at both ends", &twenty, 5_000, &bases::powers(20, 4)?, "polynomial of degree 4")?;
    learn("20 states, reward at both ends", &twenty, 5_000, &bases::powers(20, 1)?, "straight line")?;
    let fifty = chain_walk::fifty()?;
    learn(
        "50 states, reward in the 10th and the 41st",
        &fifty,
        10_000,
        &bases::powers(50, 4)?,
        "polynomial of degree 4",
    )?;
    learn("50 states, reward in the 10th and the 41st", &fifty, 10_000, &bases::bumps(50, 10)?, "ten bumps")?;
    swing()
}

/// Learn a policy from random steps and print it beside the exact one.
fn learn(world: &str, process: &FiniteMdp, steps: usize, basis: &Mat<f64>, features: &str) -> Result<(), ValueError> {
    // 1. Random steps: uniform over states and actions.
    let steps = process.uniform_steps(steps, &mut stream(1, "steps"));
    // 2. The same in features, and policy iteration over them.
    let fit = process.in_features(&steps, basis.as_ref())?.fit(&LspiOptions::plain())?;
    let q = fit.action_values(basis.as_ref())?;
    let policy = fit.policy(basis.as_ref())?;
    // 3. What the learned policy is really worth, beside the best one.
    let optimum = exact::policy_iteration(process)?;
    let value: f64 = exact::values(process, &policy)?.iter().sum();
    let best: f64 = optimum.values.iter().sum();
    let end = match (fit.converged, fit.cycle) {
        (true, _) => "settled".to_owned(),
        (_, Some(length)) => format!("ran in a circle of {length}"),
        _ => "gave up".to_owned(),
    };

    println!("== {world}; {features} for each action; {} steps", steps.len());
    println!("   {end} after {} evaluations; worth {:.1} % of the optimum", fit.iterations, 100.0 * value / best);
    println!("   learned {}", chain_walk::letters(&policy.chosen()));
    println!("   exact   {}", chain_walk::letters(&optimum.policy.chosen()));
    plot(&q, &optimum.q);
    Ok(())
}

/// Learned (`L`, `R`) and exact (`·`) action values over the states, ten lines high.
fn plot(learned: &Mat<f64>, exact: &Mat<f64>) {
    const LINES: usize = 10;
    let all = || (0..learned.ncols()).flat_map(|s| (0..2).flat_map(move |a| [learned[(a, s)], exact[(a, s)]]));
    let (low, high) = (all().fold(f64::INFINITY, f64::min), all().fold(f64::NEG_INFINITY, f64::max));
    let line = |value: f64| ((high - value) / (high - low) * (LINES - 1) as f64).round() as usize;
    let mut canvas = vec![vec![' '; learned.ncols()]; LINES];
    for s in 0..learned.ncols() {
        for a in 0..2 {
            canvas[line(exact[(a, s)])][s] = '·';
        }
        canvas[line(learned[(1, s)])][s] = 'R';
        canvas[line(learned[(0, s)])][s] = 'L';
    }
    for (number, row) in canvas.iter().enumerate() {
        let value = high - (high - low) * number as f64 / (LINES - 1) as f64;
        println!("   {value:6.2} |{}", row.iter().collect::<String>());
    }
    println!();
}

/// Weights from the policy's own visits against uniform ones, on the chain of Koller & Parr.
fn swing() -> Result<(), ValueError> {
    println!("== Koller & Parr: 4 states, reward in the inner two; 1, s, s²");
    let start = Policy::deterministic(&[chain_walk::RIGHT; 4], 2)?;
    let history = koller_parr::on_policy_iteration(&start, 6)?;
    let names: Vec<String> = history.iter().map(|policy| chain_walk::letters(&policy.chosen())).collect();
    println!("   weights from its own visits: {} …", names.join(" → "));
    let basis = koller_parr::basis();
    let fit = koller_parr::process()?.expected(basis.as_ref(), |_, _| 1.0)?.fit(&LspiOptions::plain())?;
    let found = chain_walk::letters(&fit.policy(basis.as_ref())?.chosen());
    println!("   uniform weights: {found} after {} evaluations", fit.iterations);
    Ok(())
}
