//! What several actors keep in a snapshot of the run: models, policies, actions, places.

use std::sync::Arc;

use faer::Mat;
use nalgebra::Point2;

use crate::kernel::Kernel;
use crate::parts::{Parts, PartsError};
use crate::policy::{Learned, Recent};
use crate::robot::{Action, MOST_ACTIONS};
use crate::slow::{Link, SlowModel};
use crate::value::{Instances, LocalOptions};

/// What was learned.
pub fn learned(parts: &mut Parts, name: &str, learned: &mut Option<Arc<Learned>>) -> Result<(), PartsError> {
    parts.scope(name, |parts| {
        let of = learned.as_ref();
        let mut numbers = of.map(|of| (of.epoch, of.asked_at, of.frames, of.weights.len()));
        parts.value("there", &mut numbers)?;
        let mut goals: Vec<[u64; 2]> =
            of.map_or(Vec::new(), |of| of.goals.iter().map(|goal| goal.map(f64::to_bits)).collect());
        let Some((epoch, asked_at, frames, tasks)) = numbers else { return Ok(()) };
        parts.value("goals", &mut goals)?;
        let mut model = of.map(|of| of.model.clone());
        slow_model(parts, "model", &mut model)?;
        let mut weights: Vec<Mat<f64>> = of.map_or(Vec::new(), |of| of.weights.clone());
        for task in 0..tasks {
            let mut of_task = weights.get(task).cloned().unwrap_or_else(Mat::new);
            parts.matrix(&format!("weights.{task}"), &mut of_task, |rows, columns| (rows, columns))?;
            if parts.is_restoring() {
                weights.push(of_task);
            }
        }
        let mut instances = of.and_then(|of| of.instances.clone());
        places(parts, &mut instances)?;
        if let Some(model) = model.filter(|_| parts.is_restoring()) {
            let restored = match instances {
                None => Learned::new(epoch, asked_at, frames, model, weights),
                Some(instances) => Learned::local(epoch, asked_at, frames, model, instances, weights),
            };
            *learned = Some(Arc::new(
                restored
                    .map_err(|cause| wrong("learned", cause))?
                    .for_goals(goals.into_iter().map(|goal| goal.map(f64::from_bits)).collect()),
            ));
        }
        Ok(())
    })
}

/// Where actions were tried, of local values.
fn places(parts: &mut Parts, instances: &mut Option<Arc<Instances>>) -> Result<(), PartsError> {
    parts.scope("instances", |parts| {
        let of = instances.as_ref();
        let mut there = of.map(|of| (of.counts().to_vec(), of.options().neighbours, of.options().ridge.to_bits()));
        parts.value("there", &mut there)?;
        let Some((counts, neighbours, ridge)) = there else { return Ok(()) };
        let mut points = of.map_or(Mat::new(), |of| of.points().to_owned());
        parts.matrix("points", &mut points, |rows, columns| (rows, columns))?;
        if parts.is_restoring() {
            let options = LocalOptions { neighbours, ridge: f64::from_bits(ridge) };
            *instances =
                Some(Arc::new(Instances::new(points, counts, options).map_err(|cause| wrong("instances", cause))?));
        }
        Ok(())
    })
}

/// A model over a radial kernel, as a scenario's are.
pub fn slow_model(parts: &mut Parts, name: &str, model: &mut Option<SlowModel<f32>>) -> Result<(), PartsError> {
    parts.scope(name, |parts| {
        let room = |rows: usize, columns: usize| (rows, columns);
        let of = model.as_ref();
        let mut there = of.is_some();
        parts.value("there", &mut there)?;
        if !there {
            return Ok(());
        }
        let mut sigma = of.and_then(|of| of.kernel.sigma()).unwrap_or(f64::NAN);
        let mut exponent = of.and_then(|of| of.kernel.exponent()).unwrap_or(f64::NAN);
        let mut members = of.map_or(Mat::new(), |of| of.members.as_ref().clone());
        let mut projection = of.map_or(Mat::new(), |of| of.projection.clone());
        let mut offset = of.map_or(Vec::new(), |of| of.offset.clone());
        let mut slowness = of.map_or(Vec::new(), |of| of.slowness.clone());
        parts.number("sigma", &mut sigma)?;
        parts.number("exponent", &mut exponent)?;
        parts.matrix("members", &mut members, room)?;
        parts.matrix("projection", &mut projection, room)?;
        parts.numbers("offset", &mut offset)?;
        parts.numbers("slowness", &mut slowness)?;
        if parts.is_restoring() {
            let kernel = Kernel::radial(sigma, exponent).map_err(|cause| wrong("kernel", cause))?;
            let restored = SlowModel::from_parts(kernel, members, projection, offset, slowness);
            *model = Some(restored.map_err(|cause| wrong("model", cause))?);
        }
        Ok(())
    })
}

/// Bits of a link.
pub fn link_bits(link: Link) -> (u64, u64) {
    (link.dt.to_bits(), link.weight.to_bits())
}

/// A link from its bits.
pub fn link_of((dt, weight): (u64, u64)) -> Link {
    Link { dt: f64::from_bits(dt), weight: f64::from_bits(weight) }
}

/// Bits of a place.
pub fn place_bits(place: Point2<f64>) -> [u64; 2] {
    [place.x.to_bits(), place.y.to_bits()]
}

/// A place from its bits.
pub fn place_of(bits: [u64; 2]) -> Point2<f64> {
    bits.map(f64::from_bits).into()
}

/// An action from its number.
pub fn action_of(parts: &Parts, number: usize) -> Result<Action, PartsError> {
    let action = Action::first(MOST_ACTIONS).nth(number);
    parts.check("action", action.is_some(), "no action has this number")?;
    Ok(action.unwrap_or(Action::FORWARD))
}

/// What the robot did last, by the numbers of actions.
pub fn recent_numbers(recent: Recent) -> [Option<usize>; 2] {
    [recent.action, recent.blocked].map(|action| action.map(Action::index))
}

/// What the robot did last, from the numbers of actions.
pub fn recent_of(parts: &Parts, [action, blocked]: [Option<usize>; 2]) -> Result<Recent, PartsError> {
    let of = |number: Option<usize>| number.map(|number| action_of(parts, number)).transpose();
    Ok(Recent { action: of(action)?, blocked: of(blocked)? })
}

pub fn wrong(name: &str, cause: impl std::fmt::Display) -> PartsError {
    PartsError::Wrong { name: name.to_owned(), cause: cause.to_string() }
}
