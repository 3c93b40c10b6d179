//! The parts of a report: each is a section with its drawings, or a sentence that says what is missing and why.

mod features;
mod health;
mod learning;
mod losses;
mod policy;
mod prospects;
mod seen;
mod trials;

use super::draw::{DrawError, Mark, PATH, Picture, Table};
use super::gather::{CELL, Gathered};
use super::room::Room;
use crate::evaluate::RoomMaps;
use crate::evaluate::{PoseDecode, TaskResult, Trip};
use crate::policy::Learned;

/// A drawing.
#[derive(Debug, Clone)]
pub struct Figure {
    /// Name of its files, and of its place on the page.
    pub name: String,
    /// What it shows.
    pub title: String,
    /// How to read it.
    pub caption: String,
    /// The drawing.
    pub svg: String,
}

impl Figure {
    fn new(name: impl Into<String>, title: &str, caption: impl Into<String>, svg: String) -> Self {
        Figure { name: name.into(), title: title.to_owned(), caption: caption.into(), svg }
    }
}

/// A part of a section.
#[derive(Debug, Clone)]
pub enum Item {
    /// A paragraph.
    Text(String),
    /// Something is missing, and why.
    Missing(String),
    /// A drawing.
    Figure(Figure),
    /// A table.
    Table(Table),
    /// A long table, and its summary.
    Folded(String, Table),
}

/// A part of the report.
#[derive(Debug, Clone)]
pub struct Section {
    /// Its name in addresses.
    pub name: &'static str,
    /// Its heading.
    pub heading: &'static str,
    /// What is in it.
    pub items: Vec<Item>,
}

/// Everything that a report is made of.
pub struct Material<'a> {
    /// What the log holds.
    pub gathered: &'a Gathered,
    /// The room, if it is known.
    pub room: Option<Room<'a>>,
    /// Whether the room is simulated, such that what was learned can be tried out and looked at in it.
    pub simulated: bool,
    /// The newest features and policies, or why there are none.
    pub learned: Result<&'a Learned, String>,
    /// What was learned, looked at from everywhere in the simulated room.
    pub room_maps: Option<&'a RoomMaps>,
    /// Results of each task with the ways of the trials, or why there are none.
    pub trials: Result<&'a [(TaskResult, Vec<Trip>)], String>,
    /// What the features know of the pose.
    pub pose_decode: Option<PoseDecode>,
    /// Images of another program's camera.
    pub pictures: &'a [Picture],
    /// More that was lost or degraded: what, and how much or why.
    pub losses: &'a [(String, String)],
}

/// Poses that are shown as the last part of a way, actions.
const LAST_ACTIONS: usize = 300;

impl Material<'_> {
    /// Corners of what rooms show: the walls', or what was driven through; none if there are no poses either.
    fn corners(&self) -> Option<([f64; 2], [f64; 2])> {
        if let Some(room) = self.room.as_ref().filter(|room| room.has_walls()) {
            return Some(room.corners());
        }
        let cells = self.gathered.visits.keys();
        let ends = cells.fold([i32::MAX, i32::MAX, i32::MIN, i32::MIN], |e, &(x, y)| {
            [e[0].min(x), e[1].min(y), e[2].max(x), e[3].max(y)]
        });
        (ends[0] <= ends[2]).then(|| {
            let [x, y, right, top] = ends.map(|end| f64::from(end) * CELL);
            let margin = 0.05 * (right - x).max(top - y).max(0.5);
            ([x - margin, y - margin], [right + CELL + margin, top + CELL + margin])
        })
    }

    fn walls(&self, width: u32) -> Vec<Mark> {
        self.room.as_ref().map_or(Vec::new(), |room| room.walls(width))
    }

    /// The last part of the way, and the robot at its end.
    fn last_way(&self) -> Vec<Mark> {
        let frames = self.room.as_ref().map_or(1, |room| room.scenario.robot.frames_per_action);
        let last = &self.gathered.last;
        let poses: Vec<_> = last.iter().skip(last.len().saturating_sub(LAST_ACTIONS * frames + 1)).collect();
        let Some(end) = poses.last() else { return Vec::new() };
        let points = poses.iter().map(|pose| pose.position.into()).collect();
        vec![Mark::Line(points, PATH.into(), 1), Mark::Arrow(end.position.into(), end.heading, 26.0, PATH)]
    }

    fn task_names(&self) -> Vec<String> {
        let tasks = self.room.iter().flat_map(|room| &room.scenario.tasks);
        tasks.map(|task| task.name.clone()).collect()
    }
}

/// All sections in their order.
///
/// # Errors
/// [`DrawError`].
pub fn sections(material: &Material<'_>) -> Result<Vec<Section>, DrawError> {
    Ok(vec![
        policy::section(material)?,
        trials::section(material)?,
        prospects::section(material)?,
        learning::section(material)?,
        features::section(material)?,
        seen::section(material)?,
        learning::dictionary(material)?,
        health::section(material)?,
        losses::section(material),
    ])
}

/// A name that can be part of a file's name: the number keeps it unique.
fn file_name(what: &str, number: usize, name: &str) -> String {
    let plain: String = name.chars().map(|c| if c.is_ascii_alphanumeric() { c } else { '_' }).take(40).collect();
    format!("{what}-{}-{plain}", number + 1)
}
