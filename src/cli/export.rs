//! `adagio export RUN --out DIR`

use std::path::Path;
use std::sync::Arc;

use super::{Ending, ExportArgs, folder, print, print_json};
use crate::export::{About, Model, export as write};
use crate::replay::Recording;
use crate::report::Numbered;
use crate::scenario::Scenario;

/// Write a recorded run as arrays for Python, and its images as PNG.
pub fn export(args: &ExportArgs) -> Result<(), Ending> {
    let about = written(args)?;
    if args.json { print_json(&about) } else { print(&summary(args, &about)) }?;
    if about.damaged == 0 {
        return Ok(());
    }
    let damaged = Numbered(about.damaged);
    Err(Ending::DataLoss(format!("{damaged} frames or records of {} could not be used", args.run.display())))
}

fn written(args: &ExportArgs) -> Result<About, Ending> {
    let (recording, scenario) = recorded(&args.run)?;
    let model = match &args.model {
        Some(path) => Some(model_of(path)?),
        None => match model_of(&args.run) {
            Ok(model) => Some(model),
            Err(Ending::Failed(reason)) => {
                eprintln!("warning: there are no features and values: {reason}");
                None
            }
            Err(ending) => return Err(ending),
        },
    };
    if let Some(model) = &model {
        fits(model, &scenario)?;
    }
    let out = folder::create(Some(&args.out), &scenario)?;
    let about = write(&recording, &args.run, &scenario, model.as_ref(), args.images, &out);
    about.map_err(|error| format!("{error}\nwhat is in {} is not complete", out.display()).into())
}

/// A recorded run, and its scenario.
///
/// # Errors
/// A folder that is no run.
pub fn recorded(run: &Path) -> Result<(Recording, Arc<Scenario>), Ending> {
    let recording = Recording::open(run)?;
    let scenario = Arc::new(recording.scenario(&[]).map_err(Ending::usage)?);
    Ok((recording, scenario))
}

/// What a run learned, or what a checkpoint holds.
///
/// # Errors
/// There is no model.
pub fn model_of(path: &Path) -> Result<Model, Ending> {
    let is_checkpoint = path.is_file() && path.extension().is_some_and(|extension| extension == "safetensors");
    let (learned, scenario) = if is_checkpoint { folder::checkpoint(path)? } else { folder::learned(path)? };
    Ok(Model { learned, scenario, path: path.to_owned() })
}

/// Observations of another size, and other actions, are not what a model knows.
fn fits(model: &Model, scenario: &Scenario) -> Result<(), Ending> {
    let (of_model, of_run) = (&model.scenario.vision, &scenario.vision);
    let (known, found) = (model.learned.actions(), scenario.robot.actions.len());
    if known != found {
        let path = model.path.display();
        return Err(Ending::Usage(format!("the model of {path} knows {known} actions, the run has {found}")));
    }
    if (of_model.width, of_model.height) == (of_run.width, of_run.height) {
        return Ok(());
    }
    Err(Ending::Usage(format!(
        "the model of {} knows observations of {} × {} pixels, those of the run have {} × {}",
        model.path.display(),
        of_model.width,
        of_model.height,
        of_run.width,
        of_run.height
    )))
}

fn summary(args: &ExportArgs, about: &About) -> String {
    let mut text = format!("{} frames of {}\n", Numbered(about.frames), about.run);
    if let Some(model) = &about.model {
        text += &format!("features and values by model {} of {}\n", model.epoch, model.path);
    }
    for (file, arrays) in &about.files {
        let arrays: Vec<String> = arrays.iter().map(|(name, array)| format!("{name} {:?}", array.shape)).collect();
        text += &format!("  {file}: {}\n", arrays.join(", "));
    }
    text + &format!("kept in {}; about.json says what each array is\n", args.out.display())
}
