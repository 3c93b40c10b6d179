//! From material to a page and its drawings, and these to files.

use std::io;
use std::path::{Path, PathBuf};

use rayon::prelude::*;
use thiserror::Error;

use super::draw::{DrawError, Page, Table, png};
use super::figures::{Figure, Item, Material, sections};
use super::verdict::{Verdict, verdict};
use crate::report::Numbered;

/// Name of the page in a run folder.
pub const REPORT_NAME: &str = "report.html";

/// Name of the folder of its drawings, beside it.
pub const PLOTS_NAME: &str = "report";

/// Why there is no report.
#[derive(Debug, Error)]
pub enum MakeError {
    /// A drawing cannot be made.
    #[error(transparent)]
    Draw(#[from] DrawError),
    /// A file cannot be written.
    #[error("cannot write {path}: {cause}")]
    Write {
        /// The file.
        path: PathBuf,
        /// What the operating system says.
        cause: io::Error,
    },
}

/// A report that is not written yet.
#[derive(Debug, Clone)]
pub struct Made {
    /// The judgement at the top.
    pub verdict: Verdict,
    /// The page.
    pub html: String,
    /// The drawings, in their order.
    pub figures: Vec<Figure>,
    /// What is missing, and why.
    pub missing: Vec<String>,
}

/// Make a report; `title` says what it is about.
///
/// # Errors
/// [`DrawError`].
pub fn make(title: &str, material: &Material<'_>) -> Result<Made, DrawError> {
    let sections = sections(material)?;
    let verdict = verdict(material);
    let mut page = Page::new(title);
    page.verdict(verdict.class, &verdict.headline, &verdict.sentences);
    let mut names: Vec<(&str, &str)> = sections.iter().map(|section| (section.name, section.heading)).collect();
    names.push(("log", "The log"));
    page.contents(&names);
    let (mut figures, mut missing) = (Vec::new(), Vec::new());
    for section in sections {
        page.section(section.name, section.heading);
        for item in section.items {
            match item {
                Item::Text(text) => page.text(&text),
                Item::Missing(text) => {
                    page.note(&text);
                    missing.push(text);
                }
                Item::Figure(figure) => {
                    page.figure(&figure.name, &figure.title, &figure.caption, &figure.svg);
                    figures.push(figure);
                }
                Item::Table(table) => page.table(&table),
                Item::Folded(summary, table) => page.folded_table(&summary, &table),
            }
        }
    }
    log(&mut page, material);
    Ok(Made { verdict, html: page.html(), figures, missing })
}

/// What was run, and what the log holds.
fn log(page: &mut Page, material: &Material<'_>) {
    let gathered = material.gathered;
    page.section("log", "The log");
    let mut about = Vec::new();
    for key in ["scenario_name", "seed", "version", "commit", "scenario_sha256", "replay_of"] {
        if let Some(value) = gathered.metadata.get(key) {
            about.push((key.replace('_', " "), value.clone()));
        }
    }
    if let Ok(learned) = &material.learned {
        about.push(("digest".to_owned(), learned.digest()));
    }
    if !about.is_empty() {
        page.facts(&about);
    }
    let mut table = Table::new(&["topic", "messages", "type"]);
    for (topic, seen) in &gathered.topics {
        table.row([topic.clone(), Numbered(seen.messages).to_string(), seen.kind.clone()]);
    }
    page.folded_table(&format!("{} topics with messages", gathered.topics.len()), &table);
}

/// Write the page and its drawings, the page last; `write` writes a file.
///
/// # Errors
/// [`MakeError`].
pub fn write(
    made: &Made,
    folder: &Path,
    write: &(dyn Fn(&Path, &[u8]) -> io::Result<()> + Sync),
) -> Result<(), MakeError> {
    let plots = folder.join(PLOTS_NAME);
    let put = |path: PathBuf, bytes: &[u8]| write(&path, bytes).map_err(|cause| MakeError::Write { path, cause });
    made.figures.par_iter().try_for_each(|figure| {
        put(plots.join(format!("{}.svg", figure.name)), figure.svg.as_bytes())?;
        put(plots.join(format!("{}.png", figure.name)), &png(&figure.svg)?)
    })?;
    put(folder.join(REPORT_NAME), made.html.as_bytes())
}
