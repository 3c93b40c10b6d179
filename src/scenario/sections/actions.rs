//! `[[action]]`: what a robot that another program drives can do.

use super::robot::{Body, Robot};
use crate::robot::{ActionSet, ActionSpec, MOST_ACTIONS, Motion};
use crate::scenario::keys::{Reader, Section, within};

/// An action, with the name of the one that undoes it.
struct Entry {
    name: String,
    motion: Motion,
    inverse: String,
}

impl Entry {
    fn read(s: &mut Section<'_, '_>, index: usize) -> Self {
        let way = within(-1000.0, 1000.0);
        let turn = within(-360.0, 360.0);
        Entry {
            name: s.text("name", &format!("action {index}"), "unique name"),
            motion: Motion {
                distance: s.number("forward", 0.0, "m", way, "how far it drives straight ahead; 0: not, or not known"),
                angle: s
                    .number("turn_deg", 0.0, "degrees", turn, "by how much it turns, counter-clockwise")
                    .to_radians(),
            },
            inverse: s.text("inverse", "", "name of the action that undoes it; empty: none does"),
        }
    }
}

/// The actions of a robot: those that are listed, or forward, and a turn to either side.
pub(super) fn read(reader: &mut Reader<'_>, robot: &Robot) -> ActionSet {
    let drive = ActionSet::differential_drive(robot.forward, robot.turn_deg.to_radians());
    if robot.body != Body::Program {
        reader.refuse_section("action", "is for robot.body = \"program\"");
        return drive;
    }
    let entries = reader.sections("action", "what it can do, in the order of the numbers", Entry::read);
    if entries.len() > MOST_ACTIONS {
        let text = format!("is one of {}: there must be at most {MOST_ACTIONS}", entries.len());
        reader.fault_at(&format!("action.{MOST_ACTIONS}.name"), text);
        return drive;
    }
    let mut specs = Vec::new();
    for (index, Entry { name, motion, inverse }) in entries.iter().enumerate() {
        if name.is_empty() || entries[..index].iter().any(|other| other.name == *name) {
            let text = format!("= {name:?} is not allowed: names must be unique and not empty");
            reader.fault_at(&format!("action.{index}.name"), text);
        }
        let undone_by = entries.iter().position(|other| other.name == *inverse);
        if undone_by.is_none() && !inverse.is_empty() {
            let names: Vec<&str> = entries.iter().map(|entry| entry.name.as_str()).collect();
            let text = format!("= {inverse:?} is no action: there are {}", names.join(", "));
            reader.fault_at(&format!("action.{index}.inverse"), text);
        }
        specs.push(ActionSpec { name: name.as_str().into(), motion: *motion, inverse: undone_by });
    }
    if specs.is_empty() { drive } else { ActionSet::new(specs) }
}
