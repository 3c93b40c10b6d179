//! `adagio report RUN`, and the report that a run leaves at its end.

use std::fs::{self, OpenOptions};
use std::io::{ErrorKind, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Instant;

use serde::Serialize;

use super::steps::Steps;
use super::{Ending, ReportArgs, folder, print, print_json};
use crate::evaluate::RoomMaps;
use crate::evaluate::{Evaluator, Fineness, PoseDecode, TaskResult, Trip, decode_pose};
use crate::log::log_files;
use crate::policy::Learned;
use crate::report::draw::Picture;
use crate::report::figures::Material;
use crate::report::foreign::{self, Foreign};
use crate::report::gather::{Gathered, ROOM};
use crate::report::{Made, Numbered, PLOTS_NAME, REPORT_NAME, Room, make, write};
use crate::scenario::Scenario;
use crate::world::World;

/// Why there are no trials where nobody asked for them.
pub const NOT_TRIED: &str = "the room that was seen is not the simulated one, or there is no model";

/// What is known of a run beside its log.
pub struct RunContext<'a> {
    pub scenario: &'a Scenario,
    pub world: &'a World,
    /// Whether its frames are from the scenario's simulated world.
    pub simulated: bool,
    /// The newest features and policies, or why there are none.
    pub learned: Result<&'a Learned, String>,
    /// Results of each task with the ways of the trials, or why there are none.
    pub trials: Result<Vec<(TaskResult, Vec<Trip>)>, String>,
    pub pose: Option<PoseDecode>,
}

/// Write the report of a run that has ended into its folder; a report of an earlier part of the run is replaced.
pub fn at_end(run: &Path, known: &RunContext<'_>, quiet: bool) -> Result<(), String> {
    let begin = Instant::now();
    let page = run.join(REPORT_NAME);
    if page.exists() && !is_ours(&page) {
        return Err(format!("{} is not a report of this program, and stays as it is", page.display()));
    }
    let steps = Steps::new(quiet);
    let files = log_files(run).map_err(|e| e.to_string())?.into_iter().map(|(_, path)| path).collect();
    let gathered = read(files, &steps)?;
    let made = known.make(&gathered, run, Vec::new(), &steps)?;
    fs::create_dir_all(run.join(PLOTS_NAME)).map_err(|e| e.to_string())?;
    let put = |path: &Path, bytes: &[u8]| {
        // Aside, then renamed; it can be restored, so nobody waits until it is on the disk.
        let aside = path.with_added_extension("part");
        fs::write(&aside, bytes)?;
        fs::rename(&aside, path)
    };
    write(&made, run, &put).map_err(|e| e.to_string())?;
    let seconds = begin.elapsed().as_secs_f64();
    steps.end(&format!("{REPORT_NAME} and {} drawings in {seconds:.1} s", made.figures.len()));
    Ok(())
}

/// Whether a page was made by this program.
fn is_ours(page: &Path) -> bool {
    const HEAD: usize = 1000;
    let text = fs::read(page).unwrap_or_default();
    String::from_utf8_lossy(&text[..text.len().min(HEAD)]).contains("<meta name=\"generator\" content=\"adagio ")
}

fn read(files: Vec<PathBuf>, steps: &Steps) -> Result<Gathered, String> {
    steps.begin("report: reading the log");
    let tell = |messages: u64| steps.at(&format!("report: reading the log, {} records", Numbered(messages)));
    Gathered::of(files, &tell).map_err(|e| e.to_string())
}

impl RunContext<'_> {
    fn make(
        &self,
        gathered: &Gathered,
        run: &Path,
        losses: Vec<(String, String)>,
        steps: &Steps,
    ) -> Result<Made, String> {
        // Goals may have moved since the first frame.
        let mut scenario = self.scenario.clone();
        if let Ok(learned) = self.learned {
            let places = scenario.tasks.iter_mut().map(|task| &mut task.goal);
            let places = places.chain(scenario.avoids.iter_mut().map(|avoid| &mut avoid.at));
            places.zip(&learned.goals).for_each(|(place, known)| *place = *known);
        }
        let room_maps = self.learned.as_ref().ok().filter(|_| self.simulated).map(|learned| {
            steps.begin("report: looking around in the simulated room");
            RoomMaps::new(Fineness::FULL, &scenario, self.world, learned)
        });
        steps.begin("report: drawing");
        let material = Material {
            gathered,
            room: Some(Room { scenario: &scenario, world: self.world }),
            simulated: self.simulated,
            learned: self.learned.clone(),
            room_maps: room_maps.as_ref(),
            trials: self.trials.as_ref().map(Vec::as_slice).map_err(Clone::clone),
            pose_decode: self.pose,
            pictures: &[],
            losses: &losses,
        };
        let name = run.canonicalize().ok();
        let name = name.as_deref().and_then(Path::file_name).map(|name| name.to_string_lossy().into_owned());
        let title = format!(
            "Adagio: {}, seed {} ({})",
            scenario.name,
            scenario.seed,
            name.unwrap_or_else(|| run.display().to_string())
        );
        make(&title, &material).map_err(|e| e.to_string())
    }
}

/// What `--json` prints.
#[derive(Serialize)]
struct RunSummary {
    report: String,
    plots: Vec<String>,
    verdict: &'static str,
    headline: String,
    sentences: Vec<String>,
    missing: Vec<String>,
    damaged: u64,
    closed: bool,
}

/// Make a report of a run or log.
pub fn report(args: &ReportArgs) -> Result<(), Ending> {
    let (made, gathered, out) = made(args)?;
    let page = out.join(REPORT_NAME).display().to_string();
    let plot = |name: &str| out.join(PLOTS_NAME).join(format!("{name}.svg")).display().to_string();
    let Made { verdict, figures, missing, .. } = made;
    if args.json {
        print_json(&RunSummary {
            report: page,
            plots: figures.iter().map(|figure| plot(&figure.name)).collect(),
            verdict: verdict.class,
            headline: verdict.headline,
            sentences: verdict.sentences,
            missing,
            damaged: gathered.damaged,
            closed: gathered.closed,
        })?;
    } else {
        let missing: Vec<String> = missing.iter().map(|missing| format!("missing: {missing}\n")).collect();
        let drawings = out.join(PLOTS_NAME);
        let kept = format!("kept in {page}, its {} drawings in {}\n", figures.len(), drawings.display());
        print(&format!("{}\n{}\n{}{kept}", verdict.headline, verdict.sentences.join("\n"), missing.concat()))?;
    }
    let complete = gathered.damaged == 0 && gathered.missing() == 0 && (gathered.closed || !gathered.is_own());
    if complete {
        return Ok(());
    }
    let mut lost = Vec::new();
    if gathered.damaged > 0 {
        lost.push(format!("{} records could not be read", Numbered(gathered.damaged)));
    }
    if gathered.missing() > 0 {
        lost.push(format!("{} observations are missing", Numbered(gathered.missing())));
    }
    if !gathered.closed {
        lost.push("the log was not closed".to_owned());
    }
    Err(Ending::DataLoss(format!("{}: {}; the report shows what there is", args.run.display(), lost.join(", "))))
}

fn made(args: &ReportArgs) -> Result<(Made, Gathered, PathBuf), Ending> {
    let steps = Steps::new(args.quiet);
    let begin = Instant::now();
    let files = folder::logs(&args.run)?;
    let mut gathered = read(files.clone(), &steps).map_err(Ending::Failed)?;
    if gathered.topics.is_empty() && gathered.metadata.is_empty() {
        return Err(folder::no_records(&args.run));
    }
    let made = if gathered.is_own() {
        of_run(args, &files, &gathered, &steps)
    } else {
        of_other(args, files, &mut gathered, &steps)
    }?;
    let out = place(args)?;
    let put = |path: &Path, bytes: &[u8]| OpenOptions::new().write(true).create_new(true).open(path)?.write_all(bytes);
    write(&made, &out, &put)?;
    let seconds = begin.elapsed().as_secs_f64();
    steps.end(&format!("{REPORT_NAME} and {} drawings in {seconds:.1} s", made.figures.len()));
    Ok((made, gathered, out))
}

/// The report of a run of this program, from its log and checkpoint alone.
fn of_run(args: &ReportArgs, files: &[PathBuf], gathered: &Gathered, steps: &Steps) -> Result<Made, Ending> {
    let mut learned = match folder::learned(&args.run) {
        Ok(learned) => Ok(learned),
        Err(Ending::Failed(reason)) => Err(reason),
        Err(ending) => return Err(ending),
    };
    // A log whose first record is damaged does not say which scenario it was; its checkpoint does, and so does the folder.
    let logged = gathered.metadata.get("scenario").cloned();
    let text = logged.or_else(|| fs::read_to_string(args.run.join("scenario.toml")).ok());
    let near = files.first().unwrap_or(&args.run);
    let parsed = match (text, &learned) {
        (Some(text), _) => Scenario::parse(&text, near, &[]).map_err(|e| e.to_string()),
        (None, Ok((_, scenario))) => Ok(scenario.clone()),
        (None, Err(_)) => Err("neither the log nor a checkpoint says which scenario was run".to_owned()),
    };
    if let (Ok(scenario), Ok((_, own))) = (&parsed, &learned)
        && own.sha256() != scenario.sha256()
    {
        learned = Err("the checkpoint beside the log was learned with another scenario".to_owned());
    }
    let mut losses = Vec::new();
    if let (Err(reason), true) = (&learned, gathered.epoch > 0) {
        losses.push(("what was learned cannot be read".to_owned(), reason.clone()));
    }
    let learned = learned.map(|(learned, _)| learned);
    let world = parsed.and_then(|scenario| {
        let world = folder::world(&args.run, &scenario).map_err(|e| e.to_string())?;
        Ok((Arc::new(scenario), Arc::new(world)))
    });
    let (scenario, world) = match world {
        Ok(known) => known,
        Err(reason) => {
            losses.push(("the room and its tasks are not known".to_owned(), reason));
            let learned = learned.as_ref().map_err(Clone::clone);
            let why = "its room and tasks are not known";
            return without_room(args, gathered, learned, why, (&[], &losses), steps);
        }
    };
    let simulated = gathered.metadata.get(ROOM.0).map(String::as_str) != Some(ROOM.1);
    let (mut trials, mut pose) = (Err(NOT_TRIED.to_owned()), None);
    if let (Ok(learned), true) = (&learned, simulated) {
        let starts = scenario.evaluate.starts;
        steps.begin(&format!("report: trying {starts} starts per task, with and without reflexes"));
        let evaluator = Evaluator::new(scenario.clone(), world.clone(), starts, scenario.seed);
        trials = Ok(evaluator.evaluate_and_show(learned, true));
        steps.begin("report: reading the pose off the features");
        pose = decode_pose(&scenario, &world, learned, scenario.seed).ok();
    }
    let learned = learned.as_ref().map_err(Clone::clone);
    let known = RunContext { scenario: &scenario, world: &world, simulated, learned, trials, pose };
    known.make(gathered, &args.run, losses, steps).map_err(Ending::Failed)
}

/// The report of a log that another program wrote.
fn of_other(args: &ReportArgs, files: Vec<PathBuf>, gathered: &mut Gathered, steps: &Steps) -> Result<Made, Ending> {
    steps.begin("report: another program's log: looking for camera and pose");
    let found = foreign::look(files, gathered)?;
    let Foreign { camera, pose, pictures, unreadable, reason } = found;
    let topic = |topic: Option<String>, without: &str| topic.unwrap_or_else(|| without.to_owned());
    let mut losses = vec![
        ("camera images are from the topic".to_owned(), topic(camera, "none: no topic holds Image or CompressedImage")),
        ("poses are from the topic".to_owned(), topic(pose, "none: no topic holds Odometry, poses or transforms")),
    ];
    if unreadable > 0 {
        let reason = reason.unwrap_or_default();
        losses.push((
            format!("images or poses that could not be read; the first: {reason}"),
            Numbered(unreadable).to_string(),
        ));
    }
    let reason = "another program wrote the log, and nothing was learned in it";
    without_room(args, gathered, Err(reason.to_owned()), reason, (&pictures, &losses), steps)
}

/// The report of a log without a room, and why there is none.
fn without_room(
    args: &ReportArgs,
    gathered: &Gathered,
    learned: Result<&Learned, String>,
    why: &str,
    (pictures, losses): (&[Picture], &[(String, String)]),
    steps: &Steps,
) -> Result<Made, Ending> {
    steps.begin("report: drawing");
    let material = Material {
        gathered,
        room: None,
        simulated: false,
        learned,
        room_maps: None,
        trials: Err(why.to_owned()),
        pose_decode: None,
        pictures,
        losses,
    };
    Ok(make(&format!("Adagio: {}", args.run.display()), &material)?)
}

/// The folder of the report, with an empty folder for its drawings; nothing that exists is touched.
fn place(args: &ReportArgs) -> Result<PathBuf, Ending> {
    let make = |path: &Path| fs::create_dir(path).and_then(|()| fs::create_dir(path.join(PLOTS_NAME)));
    if let Some(out) = &args.out {
        return folder::named(out, make);
    }
    if args.run.is_dir() {
        if !args.run.join(REPORT_NAME).exists() && fs::create_dir(args.run.join(PLOTS_NAME)).is_ok() {
            return Ok(args.run.clone());
        }
        // The run's own is the first one.
        let taken = |path: &Path| {
            if path == args.run.join("report") { Err(ErrorKind::AlreadyExists.into()) } else { make(path) }
        };
        return folder::numbered(&args.run.join("report"), taken);
    }
    let stem = args.run.file_stem().unwrap_or_default().to_string_lossy().into_owned();
    folder::numbered(&args.run.with_file_name(format!("{stem}-report")), make)
}
