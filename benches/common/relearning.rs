//! What the agent does for a new model, by the same calls: solve again, project the window, fit a policy for each task.

use std::sync::Arc;

use adagio::kernel::KeptProducts;
use adagio::policy::{Recent, Reflexes, columns};
use adagio::robot::Action;
use adagio::scenario::Scenario;
use adagio::slow::{Moments, SlowFeatures, SlowModel};
use adagio::value::{Fit, Lspi, LspiOptions, Outcomes, Samples, balance, greedy};
use adagio::vision::{Observation, ZERO};
use faer::{Mat, MatRef, Par};
use rayon::prelude::*;

use super::data::{self, D};
use super::{cores, operations, simulation};

/// Observations that are projected in one product, as in the agent.
const PROJECT_AT_ONCE: usize = 512;

/// A window of transitions of a walk, and the moments of its frames.
pub struct Relearning {
    scenario: Arc<Scenario>,
    dictionary: adagio::dictionary::Dictionary<f32>,
    moments: Moments,
    /// The solution for the first half of the frames.
    previous: SlowFeatures,
    window: Vec<Observation>,
    actions: Vec<usize>,
    /// Actions that the reflexes let follow each transition, as bits.
    allowed: Vec<u32>,
    /// Rewards of each task.
    rewards: [Vec<f64>; 2],
    /// Products that are there from the model before: nine tenths of the window, with all support vectors but a twentieth.
    kept: KeptProducts,
    k: usize,
    par: Par,
}

/// Features of the window, and the nearest support vector of each observation.
pub struct Projected {
    phi: Mat<f64>,
    cells: Vec<usize>,
}

impl Relearning {
    /// `n` transitions over `m` support vectors, `k` features, all cores.
    pub fn new(m: usize, n: usize, k: usize) -> Self {
        let par = Par::rayon(cores());
        let scenario = simulation::scenario("lab.toml", &[]);
        let x = data::frames(D, n + 1);
        let dictionary = operations::dictionary(&x, m, par);
        let half = x.as_ref().subcols(0, m.max(n / 2)).to_owned();
        let previous = operations::resolve(&operations::moments(&dictionary, &half, par), k, None, par);
        let moments = operations::moments(&dictionary, &x, par);
        let observation = |t: usize| Observation {
            frame: t as u64,
            pixels: x.col(t).iter().map(|&value| (value + f32::from(ZERO)) as u8).collect(),
        };
        let poses = data::walk(n + 1);
        let actions: Vec<usize> = (0..n).map(|t| operations::turn(&poses, t)).collect();
        let reflexes = Reflexes::new(&scenario);
        let set = &scenario.robot.actions;
        let after = |&action: &usize| reflexes.allowed(Recent::default().then(Action::DRIVE[action], false, set));
        let reward = |goal: [f64; 2], radius: f64| {
            let inside = |pose: &[f64; 3]| (pose[0] - goal[0]).hypot(pose[1] - goal[1]) < radius;
            poses[1..].iter().map(|pose| if inside(pose) { 1.0 } else { 0.0 }).collect()
        };
        let window: Vec<Observation> = (0..n + 1).map(observation).collect();
        let mut kept = KeptProducts::new(usize::MAX);
        kept.begin(&Arc::new(dictionary.members().subcols(0, m - m / 20).to_owned()));
        window[n / 10..].chunks(PROJECT_AT_ONCE).for_each(|part| drop(products(&mut kept, part, par)));
        Relearning {
            window,
            kept,
            allowed: actions.iter().map(after).collect(),
            rewards: [reward([1.5, 0.9], 0.2), reward([2.4, 0.6], 0.45)],
            scenario,
            dictionary,
            moments,
            previous,
            actions,
            k,
            par,
        }
    }

    /// All of it.
    pub fn whole(&self, kept: KeptProducts) -> Vec<Fit> {
        self.fit(&self.project(&self.solve(), kept))
    }

    /// What the model before has left.
    pub fn kept(&self) -> KeptProducts {
        self.kept.clone()
    }

    /// New features, aligned with those before them.
    pub fn solve(&self) -> SlowModel<f32> {
        let features = operations::resolve(&self.moments, self.k, Some(&self.previous), self.par);
        SlowModel::new(&self.dictionary, &features).expect("features over this dictionary")
    }

    /// The window in features, part by part.
    pub fn project(&self, model: &SlowModel<f32>, mut kept: KeptProducts) -> Projected {
        let mut phi = Mat::zeros(model.features(), self.window.len());
        let mut cells = Vec::with_capacity(self.window.len());
        kept.begin(&model.members);
        for (index, part) in self.window.chunks(PROJECT_AT_ONCE).enumerate() {
            let (of_part, norms) = products(&mut kept, part, self.par);
            let rows = model.kernel.matrix_of_products(of_part.as_ref(), model.norms(), &norms, self.par);
            let rows = rows.expect("products that fit");
            let features = model.apply_to_rows(rows.as_ref(), self.par).expect("rows that fit");
            phi.as_mut().subcols_mut(index * PROJECT_AT_ONCE, part.len()).copy_from(&features);
            cells.extend(rows.col_iter().map(|row| greedy(row.iter().copied())));
        }
        Projected { phi, cells }
    }

    /// A policy for each task, on the same samples.
    pub fn fit(&self, projected: &Projected) -> Vec<Fit> {
        let (settings, n) = (&self.scenario.value, self.actions.len());
        // Transitions of the agent are copied out of the projection, since they may have gaps.
        let copy = |part: MatRef<'_, f64>| part.to_owned();
        let (phi, next) = (copy(projected.phi.subcols(0, n)), copy(projected.phi.subcols(1, n)));
        let groups: Vec<(usize, usize)> = projected.cells.iter().copied().zip(self.actions.iter().copied()).collect();
        let weights = balance(&groups, settings.balance).expect("a valid exponent");
        let samples = Samples { phi: phi.as_ref(), actions: &self.actions, weights: &weights };
        let problem = Lspi::new(samples, Action::DRIVE.len(), self.par).expect("valid samples");
        let options = LspiOptions {
            gamma: settings.gamma,
            ridge: settings.ridge,
            mixing: settings.mixing,
            max_iterations: settings.max_iterations,
            tolerance: settings.tolerance,
            ..LspiOptions::default()
        };
        let fit = |rewards: &Vec<f64>| {
            let outcomes = Outcomes { next: next.as_ref(), rewards, allowed: Some(&self.allowed) };
            problem.fit(&outcomes, &options).expect("valid outcomes")
        };
        self.rewards.par_iter().map(fit).collect()
    }
}

fn products(kept: &mut KeptProducts, part: &[Observation], par: Par) -> (Mat<f32>, Vec<f64>) {
    let numbers: Vec<u64> = part.iter().map(|seen| seen.frame).collect();
    let of = |places: &[usize]| columns(places.iter().map(|&place| &part[place]));
    kept.of(&numbers, of, par).expect("whole numbers that are small enough")
}
