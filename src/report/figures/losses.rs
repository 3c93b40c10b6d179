//! What was dropped, left out, damaged or degraded.

use super::{Item, Material, Section};
use crate::report::Numbered;
use crate::report::draw::Table;

pub fn section(material: &Material<'_>) -> Section {
    let gathered = material.gathered;
    let mut table = Table::new(&["what", "how much"]);
    let mut add = |count: u64, what: &str| {
        if count > 0 {
            table.row([what.to_owned(), Numbered(count).to_string()]);
        }
    };
    add(gathered.dropped, "frames that the source dropped, because learning was behind");
    add(gathered.quarantined, "frames left out of learning, because their values are not finite");
    add(gathered.missing(), "observations that are missing between two others in the log");
    add(gathered.damaged, "records of the log that could not be read");
    add(gathered.first_frame.unwrap_or(0), "first frames that the log does not hold any more");
    add(gathered.warnings, "warnings and errors that the run logged");
    if let Some(frame) = gathered.full_since {
        table.row([
            "the dictionary is full: nothing more is taken".to_owned(),
            format!("since frame {}", Numbered(frame)),
        ]);
    }
    if !gathered.closed {
        table.row([
            "the log was not closed: the run was killed, or still goes on".to_owned(),
            "its last file".to_owned(),
        ]);
    }
    for (what, much) in material.losses {
        table.row([what.clone(), much.clone()]);
    }
    let mut items = Vec::new();
    if table.rows.is_empty() {
        items.push(Item::Text("Nothing was dropped, left out, damaged or degraded.".to_owned()));
    } else {
        items.push(Item::Table(table));
    }
    if !gathered.said.is_empty() {
        let mut said = Table::new(&["what the run said", "minute"]);
        for (seconds, text) in &gathered.said {
            said.row([text.clone(), format!("{:.1}", seconds / 60.0)]);
        }
        items.push(Item::Folded(first(gathered.warnings, gathered.said.len(), "warnings and errors"), said));
    }
    if !gathered.damage.is_empty() {
        let mut damage = Table::new(&["what is damaged"]);
        for text in &gathered.damage {
            damage.row([text.clone()]);
        }
        items.push(Item::Folded(first(gathered.damaged, gathered.damage.len(), "damaged records"), damage));
    }
    Section { name: "losses", heading: "What was dropped or degraded", items }
}

fn first(all: u64, shown: usize, what: &str) -> String {
    if all > shown as u64 { format!("The first {shown} of {} {what}", Numbered(all)) } else { format!("{all} {what}") }
}
