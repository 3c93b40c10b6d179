//! A recorded run as arrays for Python and images for people.
//!
//! One folder: a `.npz` file for each table, images as PNG if they are wanted, and `about.json`, which says what each array
//! is. Memory does not grow with the length of the run.

mod npz;
mod tables;

pub use npz::{Array, ArrayEntry, Element, pack};

use std::collections::BTreeMap;
use std::fs::{self, File};
use std::io::{self, BufWriter};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use image::codecs::png::PngEncoder;
use image::{ExtendedColorType, ImageEncoder as _};
use serde::Serialize;
use thiserror::Error;

use self::tables::{
    Accepted, Decisions, Evaluations, Features, Frames, Growth, LocalValues, Meanings, Models, Places, Policies,
    Prospects, Slow, SupportVectors, Transitions,
};
use crate::log::messages::{Decision, DictionaryGrowth, Evaluation, ModelUpdate, PlaceBelief, Prospect, Transition};
use crate::log::{LogError, Record, topics};
use crate::policy::{Learned, MOST_PLACES};
use crate::replay::Recording;
use crate::scenario::Scenario;
use crate::source::Recorded;
use crate::vision::Observation;

/// Frames whose features are computed together.
const BLOCK: usize = 256;

/// Where arrays are until they are packed.
const PARTS: &str = "parts";

/// Why a run cannot be exported.
#[derive(Debug, Error)]
pub enum ExportError {
    /// A file cannot be written.
    #[error("cannot write {path}: {cause}")]
    Write {
        /// The file, or the folder it belongs into.
        path: PathBuf,
        /// What the operating system says.
        cause: io::Error,
    },
    /// An image cannot be written.
    #[error("cannot write the image {path}: {cause}")]
    Image {
        /// The file.
        path: PathBuf,
        /// What the encoder says.
        cause: image::ImageError,
    },
    /// The log cannot be read.
    #[error(transparent)]
    Log(#[from] LogError),
}

/// A model whose features are exported.
pub struct Model {
    /// Features and policies.
    pub learned: Learned,
    /// The scenario that they were learned with: its tasks are those that have policies.
    pub scenario: Scenario,
    /// Where it is from.
    pub path: PathBuf,
}

/// What was exported, as `about.json` says it.
#[derive(Debug, Clone, Serialize)]
pub struct About {
    /// The run.
    pub run: String,
    /// Name of its scenario.
    pub scenario: String,
    /// Hash of the complete scenario.
    pub scenario_sha256: String,
    /// The run's actions by their numbers.
    pub actions: Vec<String>,
    /// The run's tasks by their numbers.
    pub tasks: Vec<String>,
    /// Frames.
    pub frames: u64,
    /// Frames that lack a part, and records that could not be read.
    pub damaged: u64,
    /// The model whose features are there.
    pub model: Option<AboutModel>,
    /// By file, the arrays in it.
    pub files: BTreeMap<String, BTreeMap<&'static str, AboutArray>>,
}

/// The model whose features are exported.
#[derive(Debug, Clone, Serialize)]
pub struct AboutModel {
    /// Where it is from.
    pub path: String,
    /// Its number.
    pub epoch: u32,
    /// It knows the frames up to this one.
    pub asked_at_frame: u64,
    /// Width of the kernel `k(x, s) = exp(−(‖x − s‖ / (√2 sigma))^exponent)`, in grey levels.
    pub sigma: f64,
    /// Exponent of the kernel.
    pub exponent: f64,
    /// Its tasks by their numbers.
    pub tasks: Vec<String>,
    /// How Q-values are made of the arrays in `model.npz`, in words.
    pub values: &'static str,
    /// Of local values: transitions that tell a value.
    pub neighbours: Option<usize>,
    /// Of local values: ridge on the slopes of the regression, in mean squared distances of the neighbours.
    pub local_ridge: Option<f64>,
    /// A hash of dictionary, features and policy weights.
    pub digest: String,
}

/// An array.
#[derive(Debug, Clone, Serialize)]
pub struct AboutArray {
    /// Its shape.
    pub shape: Vec<usize>,
    /// NumPy's name of the type of its numbers.
    pub dtype: &'static str,
    /// What it is.
    pub meaning: &'static str,
}

/// An export that is being written.
struct Export<'a> {
    out: &'a Path,
    parts: PathBuf,
    about: About,
}

/// Write a run into a folder, which exists and is empty.
///
/// # Errors
/// See [`ExportError`]. Damage of the log is counted in the result.
pub fn export(
    recording: &Recording,
    run: &Path,
    scenario: &Arc<Scenario>,
    model: Option<&Model>,
    images: bool,
    out: &Path,
) -> Result<About, ExportError> {
    let set = &scenario.robot.actions;
    let about = About {
        run: run.display().to_string(),
        scenario: scenario.name.clone(),
        scenario_sha256: scenario.sha256(),
        actions: set.iter().map(|action| set.name(action).to_owned()).collect(),
        tasks: names(scenario),
        frames: 0,
        damaged: 0,
        model: model.map(about_model),
        files: BTreeMap::new(),
    };
    let mut export = Export { out, parts: out.join(PARTS), about };
    fs::create_dir(&export.parts).map_err(failed(&export.parts))?;
    export.frames(recording, scenario, model, images)?;
    export.messages(recording, scenario)?;
    if let Some(model) = model {
        export.model(model)?;
    }
    fs::remove_dir_all(&export.parts).map_err(failed(&export.parts))?;
    let path = out.join("about.json");
    let text = serde_json::to_string_pretty(&export.about).map_err(io::Error::from).map_err(failed(&path))?;
    fs::write(&path, text + "\n").map_err(failed(&path))?;
    Ok(export.about)
}

fn names(scenario: &Scenario) -> Vec<String> {
    scenario.tasks.iter().map(|task| task.name.clone()).collect()
}

fn about_model(model: &Model) -> AboutModel {
    let learned = &model.learned;
    let options = learned.instances.as_ref().map(|instances| instances.options());
    AboutModel {
        path: model.path.display().to_string(),
        epoch: learned.epoch,
        asked_at_frame: learned.asked_at,
        sigma: learned.sigma(),
        exponent: learned.exponent(),
        tasks: names(&model.scenario),
        values: match (&learned.instances, &learned.places) {
            (None, _) => LINEAR_VALUES,
            (Some(_), None) => LOCAL_VALUES,
            (Some(_), Some(_)) => PLACE_VALUES,
        },
        neighbours: options.map(|options| options.neighbours),
        local_ridge: options.map(|options| options.ridge),
        digest: learned.digest(),
    }
}

const LINEAR_VALUES: &str = "Q(x, a) = weights[task, a] . features(x)";
const LOCAL_VALUES: &str = "coordinates of x: its first features (without the constant one), each over the root of its slowness's share of \
    the mean of these, at least 0.001; of the instances of action a the nearest ones (neighbours), and weights \
    u = max(1 - distance^2 / distance^2 of the next one, 0) over their mean, at least 0.001; with differences D of coordinates and \
    G = D'D / (local_ridge * mean squared distance) + diag(1/u): Q(x, a) = 1'G^-1 worth / 1'G^-1 1";
const PLACE_VALUES: &str = "as local values without places, but instances have coordinates of features by a common factor, and behind them \
    four of the pose on the map: x and y in lengths of a move, 2 cos and 2 sin of the heading; Q(x, a) is their mean over the poses where \
    the robot may be, here as x alone tells it; while it drives, as the way tells it";

fn failed(path: &Path) -> impl Fn(io::Error) -> ExportError {
    move |cause| ExportError::Write { path: path.to_owned(), cause }
}

impl Export<'_> {
    /// A folder for the arrays of one table: two tables may have arrays of the same name.
    fn table(&self, name: &str) -> Result<PathBuf, ExportError> {
        let folder = self.parts.join(name);
        fs::create_dir(&folder).map_err(failed(&folder))?;
        Ok(folder)
    }

    /// Pack the arrays of one or more tables into one file.
    fn pack(&mut self, name: &str, tables: Vec<io::Result<(Vec<ArrayEntry>, Meanings)>>) -> Result<(), ExportError> {
        let name = format!("{name}.npz");
        let path = self.out.join(&name);
        let (mut arrays, mut about) = (Vec::new(), BTreeMap::new());
        for table in tables {
            let (written, meanings) = table.map_err(failed(&path))?;
            for array in &written {
                let meaning = meanings.iter().find(|(name, _)| *name == array.name).map_or("", |found| found.1);
                about.insert(array.name, AboutArray { shape: array.shape.clone(), dtype: array.element, meaning });
            }
            arrays.extend(written);
        }
        pack(&path, &arrays).map_err(failed(&path))?;
        self.about.files.insert(name, about);
        Ok(())
    }

    fn frames(
        &mut self,
        recording: &Recording,
        scenario: &Arc<Scenario>,
        model: Option<&Model>,
        images: bool,
    ) -> Result<(), ExportError> {
        let (vision, sonars) = (&scenario.vision, scenario.robot.sonars);
        let image_folder = self.out.join("images");
        if images {
            fs::create_dir(&image_folder).map_err(failed(&image_folder))?;
        }
        let written = failed(self.out);
        let places = scenario.names().count();
        let mut frames =
            Frames::create(&self.table("frames")?, vision.height, vision.width, sonars, places).map_err(&written)?;
        let mut features = match model {
            Some(Model { learned, .. }) => {
                let (folder, tasks) = (self.table("features")?, learned.weights.len());
                let (features, actions) = (learned.model.features(), learned.actions());
                Some((learned, Features::create(&folder, features, tasks, actions, places).map_err(&written)?))
            }
            None => None,
        };
        let mut source = Recorded::new(scenario.clone(), recording.records());
        let mut block = Vec::new();
        loop {
            let frame = source.take();
            let ended = frame.is_none();
            if let Some(mut frame) = frame {
                let pixels = tables::pixels(&mut frame);
                frames.add(&frame, &pixels, sonars, places).map_err(&written)?;
                if images {
                    write_image(&image_folder.join(format!("{:08}.png", frame.number)), &pixels, scenario)?;
                }
                self.about.frames += 1;
                block.push(Observation { frame: frame.number, pixels });
            }
            if block.len() >= BLOCK || ended && !block.is_empty() {
                if let Some((learned, features)) = &mut features {
                    features.add(learned, &block, places).map_err(&written)?;
                }
                block.clear();
            }
            if ended {
                break;
            }
        }
        self.about.damaged = source.damaged();
        let tables = [frames.finish()].into_iter().chain(features.map(|(_, features)| features.finish()));
        self.pack("frames", tables.collect())
    }

    /// What the log holds beside the frames, in one pass.
    fn messages(&mut self, recording: &Recording, scenario: &Scenario) -> Result<(), ExportError> {
        let (tasks, features, actions) = (scenario.tasks.len(), scenario.slow.features, scenario.robot.actions.len());
        let written = failed(self.out);
        let mut transitions = Transitions::create(&self.table("transitions")?, tasks).map_err(&written)?;
        let mut decisions = Decisions::create(&self.table("decisions")?, actions).map_err(&written)?;
        let mut prospects = Prospects::create(&self.table("prospects")?).map_err(&written)?;
        let mut places = match scenario.value.places {
            true => Some(Places::create(&self.table("places")?, MOST_PLACES).map_err(&written)?),
            false => None,
        };
        let mut models = Models::create(&self.table("models")?, features).map_err(&written)?;
        let mut growth = Growth::create(&self.table("growth")?).map_err(&written)?;
        let mut accepted = Accepted::create(&self.table("accepted")?).map_err(&written)?;
        let mut evaluations = Evaluations::create(&self.table("evaluations")?).map_err(&written)?;
        for record in recording.records() {
            // What is damaged was counted with the frames.
            let Ok(record @ Record::Message { .. }) = record else { continue };
            let Record::Message { topic, .. } = &record else { continue };
            let is = |name: &str| **topic == *name;
            let added = if is(topics::TRANSITION.name()) {
                record.decode::<Transition>().map(|message| transitions.add(&message, tasks))
            } else if is(topics::DECISION.name()) {
                record.decode::<Decision>().map(|message| decisions.add(&message, scenario))
            } else if is(topics::PROSPECT.name()) {
                record.decode::<Prospect>().map(|message| prospects.add(&message, scenario))
            } else if let Some(places) = places.as_mut().filter(|_| is(topics::PLACES.name())) {
                record.decode::<PlaceBelief>().map(|message| places.add(&message, MOST_PLACES))
            } else if is(topics::MODEL.name()) {
                record.decode::<ModelUpdate>().map(|message| models.add(&message, features))
            } else if is(topics::DICTIONARY.name()) {
                let message = record.decode::<DictionaryGrowth>();
                message.map(|message| {
                    growth.add(&message)?;
                    message.accepted.iter().try_for_each(|frame| accepted.add(frame))
                })
            } else if is(topics::EVALUATION.name()) {
                record.decode::<Evaluation>().map(|message| evaluations.add(&message, scenario))
            } else {
                Ok(Ok(()))
            };
            match added {
                Ok(added) => added.map_err(&written)?,
                Err(_) => self.about.damaged += 1,
            }
        }
        self.pack("transitions", vec![transitions.finish()])?;
        self.pack("decisions", vec![decisions.finish()])?;
        self.pack("prospects", vec![prospects.finish()])?;
        if let Some(places) = places {
            self.pack("places", vec![places.finish()])?;
        }
        self.pack("models", vec![models.finish()])?;
        self.pack("growth", vec![growth.finish()])?;
        self.pack("accepted", vec![accepted.finish()])?;
        self.pack("evaluations", vec![evaluations.finish()])
    }

    /// The model itself, so that Python can compute with it.
    fn model(&mut self, model: &Model) -> Result<(), ExportError> {
        let (learned, vision) = (&model.learned, &model.scenario.vision);
        let features = learned.model.slowness.len();
        let written = failed(self.out);
        let (members, slow, policies) = (self.table("model")?, self.table("slow")?, self.table("policies")?);
        let tables = (|| {
            let mut vectors = SupportVectors::create(&members, vision.height, vision.width, features)?;
            vectors.add(learned)?;
            let mut rates = Slow::create(&slow)?;
            let model = &learned.model;
            model.slowness.iter().zip(&model.offset).try_for_each(|(slowness, &offset)| rates.add(slowness, offset))?;
            let values = match &learned.instances {
                None => {
                    let mut weights = Policies::create(&policies, learned.actions(), features + 1)?;
                    learned.weights.iter().try_for_each(|of| weights.add(of))?;
                    weights.finish()?
                }
                Some(instances) => {
                    let (coordinates, tasks) = (instances.points().nrows(), learned.weights.len());
                    let mut local = LocalValues::create(&policies, coordinates, tasks)?;
                    local.add(learned, instances)?;
                    local.finish()?
                }
            };
            Ok(vec![Ok(vectors.finish()?), Ok(rates.finish()?), Ok(values)])
        })();
        self.pack("model", tables.map_err(written)?)
    }
}

fn write_image(path: &Path, pixels: &[u8], scenario: &Scenario) -> Result<(), ExportError> {
    let file = BufWriter::new(File::create_new(path).map_err(failed(path))?);
    let (width, height) = (scenario.vision.width as u32, scenario.vision.height as u32);
    let written = PngEncoder::new(file).write_image(pixels, width, height, ExtendedColorType::Rgb8);
    written.map_err(|cause| ExportError::Image { path: path.to_owned(), cause })
}
