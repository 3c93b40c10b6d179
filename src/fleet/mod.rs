//! Several robots that drive at the same time, and one learner for all of them.
//!
//! ```text
//!  robot: frames ──batches──▶ learner: dictionary, sums, window of all ──model──▶ every robot
//!  (`adagio run --fleet`)     (`adagio fleet`)
//! ```
//!
//! Robots ask over HTTP, and the learner answers at once: what comes late is noticed by whoever asked. A batch is sent again until the
//! learner has saved it, and learned from once: it is known by its robot and its frames. So both sides may vanish and come back. A robot
//! that finds no learner goes on with the model it has.
//!
//! In lockstep a model is made when every robot that is there has handed over a batch, from these batches in the order of the robots' names:
//! the same robots give the same models. In real time it is made of whatever has come when the solver is free.
//!
//! No derivative is taken across the border of a batch. Goals stand where the learner's scenario has them, or where robots have marked them.

mod client;
mod learner;
mod server;

use std::collections::{BTreeMap, BTreeSet};

use serde::{Deserialize, Serialize};
use thiserror::Error;

pub use client::{Connection, FleetError};
pub use learner::{Learner, Robot};
pub use server::{Server, Told};

use crate::scenario::Scenario;

/// How long a robot is waited for that does not let the learner hear of it, and the other way round.
pub const LOST: std::time::Duration = std::time::Duration::from_secs(10);

/// What a robot has to know of a learner before it joins it.
#[derive(Debug, Serialize, Deserialize)]
struct Welcome {
    version: String,
    /// The learner's complete scenario.
    scenario: String,
}

/// How far the learner is with a robot.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
struct Standing {
    /// The first frame that it has not got.
    next: u64,
    /// The first frame that would be lost if the learner ended now.
    saved: u64,
}

/// The head of an answer that says [`Standing`], as JSON.
const STANDING: &str = "x-adagio-standing";

/// A robot cannot join a learner.
#[derive(Debug, Error)]
#[error("this robot and the fleet's learner do not have the same settings:\n{}", .0.join("\n"))]
pub struct Unlike(Vec<String>);

/// Keys that robots of a fleet and their learner have in common; sections, or keys of sections.
const IN_COMMON: [&str; 21] = [
    "camera",
    "vision",
    "action",
    "dictionary",
    "slow",
    "value",
    "task",
    "avoid",
    "robot.forward",
    "robot.turn_deg",
    "robot.action_seconds",
    "robot.frames_per_action",
    "robot.pose",
    "robot.radius",
    "policy.no_repeat_blocked",
    "policy.no_undo_turn",
    "policy.no_spin",
    "agent.mode",
    "agent.resolve_frames",
    "agent.latency_frames",
    "agent.memory_gb",
];

/// Whether a robot can learn with others.
///
/// # Errors
/// All keys that differ, with both values.
pub fn in_common(robot: &Scenario, learner: &Scenario) -> Result<(), Unlike> {
    let table = |scenario: &Scenario| scenario.text.parse::<toml::Table>().unwrap_or_default();
    let (ours, theirs) = (table(robot), table(learner));
    let (mut a, mut b) = (BTreeMap::new(), BTreeMap::new());
    let of = |table: &toml::Table, key: &str| {
        let (section, rest) = key.split_once('.').map_or((key, None), |(section, rest)| (section, Some(rest)));
        let value = table.get(section)?;
        rest.map_or(Some(value.clone()), |rest| value.get(rest).cloned())
    };
    for key in IN_COMMON {
        leaves(key, of(&ours, key), &mut a);
        leaves(key, of(&theirs, key), &mut b);
    }
    let names: BTreeSet<&String> = a.keys().chain(b.keys()).collect();
    let unlike = names.into_iter().filter_map(|name| {
        let [ours, theirs] = [&a, &b].map(|of| of.get(name).map_or("nothing", String::as_str));
        (ours != theirs).then(|| format!("  {name} is {ours}, the learner's {theirs}"))
    });
    let unlike: Vec<String> = unlike.collect();
    if unlike.is_empty() { Ok(()) } else { Err(Unlike(unlike)) }
}

/// All values below a key, by their names.
fn leaves(name: &str, value: Option<toml::Value>, found: &mut BTreeMap<String, String>) {
    match value {
        None => {}
        Some(toml::Value::Table(table)) => {
            table.into_iter().for_each(|(key, value)| leaves(&format!("{name}.{key}"), Some(value), found));
        }
        Some(toml::Value::Array(array)) if array.iter().all(toml::Value::is_table) => {
            let numbered = array.into_iter().enumerate();
            numbered.for_each(|(number, value)| leaves(&format!("{name}.{number}"), Some(value), found));
        }
        Some(value) => drop(found.insert(name.to_owned(), value.to_string())),
    }
}
