//! What the newest model makes of the room and of the last observations: looked at anew with each model, coarsely.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::SystemTime;

use crossbeam_channel::{Receiver, TryRecvError, bounded};
use faer::Par;
use rayon::{ThreadPool, ThreadPoolBuilder};
use serde::Serialize;

use super::follow::Seen;
use super::picture::{Picture, finely};
use crate::agent::{CHECKPOINT_NAME, read_checkpoint};
use crate::evaluate::{Fineness, HEADINGS, RoomMaps};
use crate::log::{log_files, newest};
use crate::policy::{Learned, columns};
use crate::report::draw::thinned;
use crate::report::gather::{Gathered, ROOM};
use crate::robot::Pose;
use crate::scenario::Scenario;
use crate::vision::Observation;
use crate::world::World;

/// How finely the room is looked at: some tenths of a second of one core for each model.
const FINENESS: Fineness = Fineness { places: [24, 12], most_products: 1.5e10, most_pixels: 0 };

/// Features that are shown.
pub const FEATURES: usize = 6;

/// Widest picture of the camera that is shown, pixels.
const WIDEST: usize = 160;

/// What a model makes of the room.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct Maps {
    /// Number of the model.
    pub epoch: u32,
    /// Places along x and y.
    pub columns: usize,
    /// Places along x and y.
    pub rows: usize,
    /// Lowest and highest corner of the grid whose cells' centres the places are, metres.
    pub low: [f64; 2],
    /// Highest corner.
    pub high: [f64; 2],
    /// For each task: the value of each place, mean of headings; NaN where the robot cannot be.
    pub values: Vec<Vec<f64>>,
    /// For each task: the heading at which each place is worth most, radians.
    pub headings: Vec<Vec<f64>>,
    /// The first features at each place, mean of headings.
    pub features: Vec<Vec<f64>>,
}

/// The room, and the newest model.
#[derive(Default)]
pub struct RoomView {
    place: PathBuf,
    room: Option<(Arc<Scenario>, Arc<World>)>,
    /// Why there is no room, or why there is no model.
    pub missing: Option<String>,
    simulated: bool,
    learned: Option<Arc<Learned>>,
    /// Of the checkpoint that was read last.
    read: Option<(SystemTime, u64)>,
    /// The log itself was looked through for a checkpoint.
    searched: bool,
    maps: Option<Arc<Maps>>,
    /// The maps of a newer model, that are being made.
    coming: Option<Receiver<Maps>>,
    /// One thread of its own: the others belong to the run.
    pool: Option<ThreadPool>,
    /// The last features, with the epoch and frames that they are of.
    features: (u32, Vec<(u64, Vec<f64>)>),
}

impl RoomView {
    /// A lookout for a run folder or a log file.
    pub fn new(place: &Path) -> Self {
        RoomView {
            place: place.to_owned(),
            // A panic there is told by the channel that it leaves, and must not take the run down.
            pool: ThreadPoolBuilder::new().num_threads(1).panic_handler(|_| {}).build().ok(),
            ..RoomView::default()
        }
    }

    /// The scenario, once it is known.
    pub fn scenario(&self) -> Option<&Arc<Scenario>> {
        self.room.as_ref().map(|room| &room.0)
    }

    /// The world, once it is known.
    pub fn world(&self) -> Option<&World> {
        self.room.as_ref().map(|room| &*room.1)
    }

    /// Number of the newest model that was read; 0 without one.
    pub fn epoch(&self) -> u32 {
        self.learned.as_ref().map_or(0, |learned| learned.epoch)
    }

    /// Learn from the log which room it is.
    pub fn know(&mut self, gathered: &Gathered) {
        let Some(text) = gathered.metadata.get("scenario").filter(|_| self.room.is_none() && self.missing.is_none())
        else {
            return;
        };
        self.simulated = gathered.metadata.get(ROOM.0).map(String::as_str) != Some(ROOM.1);
        let near = if self.place.is_dir() { self.place.join("scenario.toml") } else { self.place.clone() };
        let room = Scenario::parse(text, &near, &[]).map_err(|error| error.to_string()).and_then(|scenario| {
            let world = World::new(&scenario).map_err(|error| error.to_string())?;
            Ok((Arc::new(scenario), Arc::new(world)))
        });
        match room {
            Ok(room) => self.room = Some(room),
            Err(reason) => self.missing = Some(format!("the room is not known: {reason}")),
        }
    }

    /// Read the newest checkpoint, if there is a new one: beside the log, or in a log that is over.
    pub fn learn(&mut self, over: bool) {
        let file = self.place.join(CHECKPOINT_NAME);
        let stamp = file.metadata().ok().and_then(|about| Some((about.modified().ok()?, about.len())));
        let bytes = match stamp {
            Some(stamp) if self.read == Some(stamp) => return,
            Some(stamp) => {
                self.read = Some(stamp);
                std::fs::read(&file).ok()
            }
            None if over && !self.searched => {
                self.searched = true;
                newest_attachment(&self.place)
            }
            None => None,
        };
        let Some(bytes) = bytes else { return };
        match read_checkpoint(&bytes, &file) {
            Ok((learned, own)) if self.scenario().is_none_or(|scenario| scenario.sha256() == own.sha256()) => {
                self.learned = Some(Arc::new(learned));
            }
            Ok(_) => self.missing = Some("the checkpoint was learned with another scenario".to_owned()),
            Err(error) => self.missing = Some(error.to_string()),
        }
    }

    /// What a model makes of the room: the newest one that was looked at, which begins beside when there is a newer one. None
    /// without a model, or where the room is not simulated.
    pub fn maps(&mut self) -> Option<Arc<Maps>> {
        match self.coming.as_ref().map(Receiver::try_recv) {
            Some(Ok(maps)) => self.arrived(maps),
            Some(Err(TryRecvError::Empty)) => {}
            None | Some(Err(TryRecvError::Disconnected)) => self.begin(),
        }
        self.maps.clone()
    }

    /// Wait until the newest model was looked at.
    pub fn wait_for_maps(&mut self) {
        self.begin();
        if let Some(Ok(maps)) = self.coming.as_ref().map(Receiver::recv) {
            self.arrived(maps);
        }
    }

    fn arrived(&mut self, maps: Maps) {
        self.maps = Some(Arc::new(maps));
        self.coming = None;
    }

    /// Begin to look at the newest model, unless that was done or is under way.
    fn begin(&mut self) {
        let (Some((scenario, world)), Some(learned), Some(pool), None) =
            (self.room.as_ref().filter(|_| self.simulated), &self.learned, &self.pool, &self.coming)
        else {
            return;
        };
        if self.maps.as_ref().is_some_and(|maps| maps.epoch == learned.epoch) {
            return;
        }
        let (scenario, world, learned) = (scenario.clone(), world.clone(), learned.clone());
        let (send, coming) = bounded(1);
        pool.spawn(move || {
            let maps = maps_of(&RoomMaps::new(FINENESS, &scenario, &world, &learned), learned.epoch);
            // Whoever wanted it may be gone.
            let _ = send.send(maps);
        });
        self.coming = Some(coming);
    }

    /// The first features of observations, by their frames: of each, the same number.
    pub fn features<'a>(&mut self, recent: impl Iterator<Item = &'a Seen>) -> &[(u64, Vec<f64>)] {
        let Some(learned) = &self.learned else { return &[] };
        let (epoch, known) = &mut self.features;
        if *epoch != learned.epoch {
            (*epoch, *known) = (learned.epoch, Vec::new());
        }
        let size = learned.model.members.nrows();
        let recent: Vec<&Seen> = recent.filter(|seen| seen.rgb.len() == size).collect();
        let oldest = recent.first().map_or(u64::MAX, |seen| seen.frame);
        known.retain(|(frame, _)| *frame >= oldest);
        let newest = known.last().map(|(frame, _)| *frame);
        let fresh: Vec<Observation> = recent
            .into_iter()
            .filter(|seen| newest.is_none_or(|newest| seen.frame > newest))
            .map(|seen| Observation { frame: seen.frame, pixels: seen.rgb.clone() })
            .collect();
        if !fresh.is_empty() {
            let phi = learned.features(columns(fresh.iter()).as_ref(), Par::Seq);
            let shown = FEATURES.min(phi.nrows().saturating_sub(1));
            for (j, seen) in fresh.iter().enumerate() {
                // The first feature is the constant one.
                known.push((seen.frame, (1..=shown).map(|i| finely(phi[(i, j)])).collect()));
            }
        }
        known
    }

    /// What the camera sees at a pose, without the noise of its sensor: the log keeps what vision made of it alone.
    pub fn camera(&self, frame: u64, pose: &Pose) -> Option<Picture> {
        let (_, world) = self.room.as_ref().filter(|_| self.simulated)?;
        let image = world.appearance.render(pose, frame);
        let light = world.appearance.light(frame);
        let (width, height, mut rgb) = thinned((image.width, image.height), &image.rgb, WIDEST);
        rgb.iter_mut().for_each(|value| *value = (f64::from(*value) * light).round().clamp(0.0, 255.0) as u8);
        Some(Picture { width, height, rgb })
    }
}

fn maps_of(room_maps: &RoomMaps, epoch: u32) -> Maps {
    let grid = room_maps.grid;
    let worth: Vec<Vec<(f64, usize)>> = (0..room_maps.values.len()).map(|task| room_maps.worth(task)).collect();
    let turn = std::f64::consts::TAU / HEADINGS as f64;
    let mean = |maps: &[Vec<f64>; HEADINGS]| {
        let places = 0..grid.columns * grid.rows;
        places.map(|place| finely(maps.iter().map(|map| map[place]).sum::<f64>() / HEADINGS as f64)).collect()
    };
    Maps {
        epoch,
        columns: grid.columns,
        rows: grid.rows,
        low: grid.low.map(finely),
        high: grid.high.map(finely),
        values: worth.iter().map(|places| places.iter().map(|place| finely(place.0)).collect()).collect(),
        headings: worth
            .iter()
            .map(|places| places.iter().map(|place| finely(turn * place.1 as f64)).collect())
            .collect(),
        features: room_maps.features.iter().take(FEATURES).map(mean).collect(),
    }
}

/// The newest checkpoint in a log.
fn newest_attachment(place: &Path) -> Option<Vec<u8>> {
    let files = if place.is_dir() {
        log_files(place).ok()?.into_iter().map(|(_, path)| path).collect()
    } else {
        vec![place.to_owned()]
    };
    newest(files, CHECKPOINT_NAME, |_| {}).map(|(bytes, _)| bytes)
}
