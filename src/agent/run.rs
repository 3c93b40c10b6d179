//! One run: the actors on their threads, from the first frame to the closed log.

use std::convert::Infallible;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use serde::Serialize;
use thiserror::Error;

use super::act::Act;
use super::checkpoint::{CHECKPOINT_NAME, CheckpointError, checkpoint_bytes};
use super::clock::{Clock, Timing};
use super::controls::Controls;
use super::crew::{Crew, parallelism};
use super::decide::{Deciding, Keep};
use super::fit::FitPolicies;
use super::keep::{Acting, Quiet};
use super::loops::{self, Perceiving, Supply};
use super::messages::{FitRequest, Item, Percept, SolveRequest, Update};
use super::perceive::{Perceive, PerceiveError};
use super::queue::queue;
use super::record::{Level, Recorder, write_log};
use super::schedule::{Course, Schedule};
use super::solve::Solve;
use super::status::Status;
use super::turns::Turns;
use crate::evaluate::Evaluator;
use crate::gpu::Choice;
use crate::log::{LogError, RunLog, RunTotals};
use crate::parts::{Parts, PartsError};
use crate::policy::{Learned, Tally};
use crate::random::fix_parallelism;
use crate::scenario::{Renderer, Scenario, WhenBehind};
use crate::source::{Frame, Source};
use crate::world::{Action, World};

/// Why a run ended early.
#[derive(Debug, Error)]
pub enum RunError {
    /// Learning refused.
    #[error(transparent)]
    Perceive(#[from] PerceiveError),
    /// The log could not be written.
    #[error(transparent)]
    Log(#[from] LogError),
    /// The checkpoint could not be made.
    #[error(transparent)]
    Checkpoint(#[from] CheckpointError),
    /// The state that the run was to go on from cannot be used.
    #[error("the state of the run cannot be used: {0}")]
    State(#[from] PartsError),
    /// A thread could not be started.
    #[error("cannot start a thread: {0}")]
    Thread(std::io::Error),
    /// An actor panicked: a defect of this program.
    #[error("the actor {0} panicked: {1}; this is a defect, please report it")]
    Panic(&'static str, String),
}

/// What a run is given beside its scenario.
pub struct RunOptions<'a> {
    /// Set from outside to end the run cleanly.
    pub stop: &'a AtomicBool,
    /// What the run is doing, to be watched from another thread.
    pub status: &'a Status,
    /// What a person who watches asks of it; nobody without.
    pub controls: Option<&'a Controls>,
    /// Where what was learned is kept from the first model on; nowhere without.
    pub checkpoint: Option<&'a Path>,
    /// Trials for evaluations during the run; none without.
    pub evaluator: Option<&'a Evaluator>,
    /// What happened in a recording that is repeated.
    pub recording: Option<&'a Course>,
    /// The run ends after this many actions, if that is before the scenario's end.
    pub most_actions: Option<u64>,
    /// Where the state of the run is put away; nowhere without.
    pub keep: Option<Keep>,
    /// The state that the run goes on from, if it does not begin.
    pub state: Option<Parts>,
    /// Evaluations before that state.
    pub curve: Vec<CurvePoint>,
    /// Times real time at which the log's timed flushes follow the stamps of its messages; `None`: they follow the clock.
    pub flush_by_stamps: Option<f64>,
}

impl<'a> RunOptions<'a> {
    /// A new run of which nothing is kept but its log.
    pub fn new(stop: &'a AtomicBool, status: &'a Status) -> Self {
        RunOptions {
            stop,
            status,
            controls: None,
            checkpoint: None,
            evaluator: None,
            recording: None,
            most_actions: None,
            keep: None,
            state: None,
            curve: Vec::new(),
            flush_by_stamps: None,
        }
    }
}

/// One evaluation during a run.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct CurvePoint {
    /// Frames seen.
    pub frames: u64,
    /// Actions executed.
    pub actions: u64,
    /// Support vectors.
    pub support_vectors: usize,
    /// Success, mean over tasks.
    pub success: f64,
    /// Convergence quality, mean over tasks.
    pub convergence_quality: f64,
    /// Slowness of the features, mean, 1/s².
    pub slowness_mean: f64,
    /// Root mean square angle between the spans of the slowest features (20 at most) of this model and the one evaluated
    /// before, degrees; `None` for the first.
    pub feature_drift_deg: Option<f64>,
}

/// What a run came to.
pub struct Outcome {
    /// The newest features and policies; none if the run was too short for any.
    pub learned: Option<Arc<Learned>>,
    /// Why there is no model, or why the last one could not be made.
    pub without_model: Option<String>,
    /// Actions executed.
    pub actions: u64,
    /// Frames seen.
    pub frames: u64,
    /// Frames left out of learning, because their values are not finite.
    pub quarantined: u64,
    /// Wall-clock time, seconds.
    pub seconds: f64,
    /// Size of the dictionary at the end.
    pub support_vectors: usize,
    /// Threshold of acceptance at the end, if the selection has one.
    pub nu: Option<f64>,
    /// Evaluations during the run.
    pub curve: Vec<CurvePoint>,
    /// Durations.
    pub timing: Timing,
    /// How pursuits during the run ended, by task.
    pub pursuits: Vec<Tally>,
    /// Frames that the source dropped.
    pub dropped: u64,
    /// Who computed the kernel values of the window, as far as there was a choice.
    pub kernel_values_by: Option<Choice>,
    /// Why the last state of the run could not be kept, if it could not: the run then goes on from its log.
    pub not_kept: Option<String>,
    /// The log.
    pub log: RunTotals,
}

/// Run a scenario from its first frame to the closed log.
///
/// The first error of any actor ends the run: queues close one after the other, the log is finished, and the error is
/// returned. Setting `options.stop` ends it the same way without an error.
///
/// # Errors
/// See [`RunError`].
pub fn run(
    scenario: &Arc<Scenario>,
    world: &Arc<World>,
    source: &mut (dyn Source + Send),
    log: RunLog,
    options: RunOptions<'_>,
) -> Result<Outcome, RunError> {
    run_in_turns(scenario, world, source, log, options, None)
}

/// As [`run`]; with `turns` only one actor runs at a time, see [`Turns`].
pub(super) fn run_in_turns(
    scenario: &Arc<Scenario>,
    world: &Arc<World>,
    source: &mut (dyn Source + Send),
    log: RunLog,
    options: RunOptions<'_>,
    turns: Option<&Arc<Turns>>,
) -> Result<Outcome, RunError> {
    fix_parallelism();
    let begin = Instant::now();
    let status = options.status;
    let (capacity, par) = (scenario.agent.queue, parallelism(&scenario.agent));
    let (frames_out, frames_in, gauge) = queue::<Item<Frame>>("frames", capacity, turns);
    status.watch(gauge);
    let (percepts_out, percepts_in, gauge) = queue::<Percept>("percepts", capacity, turns);
    status.watch(gauge);
    let (actions_out, actions_in, gauge) = queue::<Item<Action>>("actions", 1, turns);
    status.watch(gauge);
    // Requests carry whole matrices: two of them at a time are enough.
    let (solve_out, solve_in, gauge) = queue::<Item<SolveRequest>>("solve", 1, turns);
    status.watch(gauge);
    let (fit_out, fit_in, gauge) = queue::<Item<FitRequest>>("fit", 1, turns);
    status.watch(gauge);
    let (updates_out, updates_in, gauge) = queue::<Update>("updates", capacity, turns);
    status.watch(gauge);
    let (assess_out, assess_in, gauge) = queue::<(Arc<Learned>, u64)>("assess", 2, turns);
    status.watch(gauge);
    let (keep_out, keep_in, gauge) = queue::<Item<Infallible>>("keep", 1, turns);
    status.watch(gauge);
    let (writes_out, writes_in, gauge) = queue("log", 8 * capacity, turns);
    status.watch(gauge);
    let recorder = Recorder::new(writes_out, scenario.clone());
    let no_device = world.looks.prepare();
    let schedule = Arc::new(Schedule::new(&scenario.agent, options.recording));
    let flush = Duration::from_secs_f64(scenario.log.flush_seconds);
    let failed: Mutex<Option<RunError>> = Mutex::new(None);
    let (ended, over, quiet) = (AtomicBool::new(false), AtomicBool::new(false), Quiet::default());

    // The actors, new or as they were.
    let mut perceiver = Perceive::new(scenario.clone(), world.clone(), schedule.clone());
    let mut acting = Acting::new(Act::new(scenario));
    let (mut solve, mut fit) = (Solve::new(&scenario.slow, par), FitPolicies::new(scenario.clone(), par));
    let goes_on = options.state.is_some();
    if let Some(mut parts) = options.state {
        parts.inner("acting", &mut acting)?;
        parts.scope("source", |parts| source.persist(parts))?;
        parts.inner("perceive", &mut perceiver)?;
        parts.inner("solve", &mut solve)?;
        parts.inner("fit", &mut fit)?;
    }
    let agent = &scenario.agent;
    let supply = Supply {
        actions: actions_in,
        frames: frames_out,
        // A recording has dropped already what it dropped.
        drop_from: (agent.when_behind == WhenBehind::Drop && options.recording.is_none()).then(|| frames_in.clone()),
        goes_on,
        quiet: &quiet,
        speed: agent.speed.filter(|_| options.recording.is_none()),
        controls: options.controls,
        status,
    };

    let parts = std::thread::scope(|scope| -> Result<_, RunError> {
        let crew = Crew { scope, failed: &failed, ended: &ended, turns };
        let by_stamps = options.flush_by_stamps;
        let log_thread = crew.start("log", move || Ok(write_log(&writes_in, log, flush, by_stamps)?))?;
        // Pictures of another renderer are close to these, and not the same.
        if turns.is_none()
            && scenario.world.renderer == Renderer::Gpu
            && let Some(by) = world.looks.rendered_by()
        {
            let level = if no_device.is_some() { Level::Warn } else { Level::Info };
            let _ = recorder.diagnostic(level, status.snapshot().stamp_ns, format!("pictures are made {by}"));
        }
        crew.start("source", move || {
            supply.run(source);
            Ok(())
        })?;
        let (record, quiet) = (recorder.clone(), &quiet);
        let perceiving = Perceiving { percepts: percepts_out, solve: solve_out, record, status, quiet };
        let perceive = crew.start("perceive", move || perceiving.run(perceiver, &frames_in))?;
        let solver = crew.start("solve", move || {
            let mut clock = Clock::new();
            while let Ok(item) = solve_in.take() {
                let done = match item {
                    Item::Work(request) => Item::Work(clock.time(|| solve.step(request))),
                    Item::Save(mark) => match mark.with("solve", &mut solve) {
                        Some(mark) => Item::Save(mark),
                        None => continue,
                    },
                };
                if fit_out.put(done).is_err() {
                    break;
                }
            }
            Ok(clock)
        })?;
        let record = recorder.clone();
        let fitter = crew.start("fit", move || {
            let mut clock = Clock::new();
            // Who computes changes no number, and a log of actors that take turns says nothing of it.
            let mut told = turns.is_some();
            while let Ok(item) = fit_in.take() {
                let sent = match item {
                    Item::Work(request) => {
                        let update = clock.time(|| fit.step(request));
                        if let Some(failed) = fit.kernel_values_by().and_then(|by| by.failed).filter(|_| !told) {
                            told = true;
                            let text = format!("kernel values: {failed}; the processor goes on");
                            let _ = record.diagnostic(Level::Warn, status.snapshot().stamp_ns, text);
                        }
                        updates_out.put(update)
                    }
                    Item::Save(mark) => match mark.with("fit", &mut fit) {
                        Some(mark) => keep_out.put(Item::Save(mark)),
                        None => continue,
                    },
                };
                if sent.is_err() {
                    break;
                }
            }
            Ok((clock, fit.kernel_values_by()))
        })?;
        let (record, keep) = (recorder.clone(), options.keep.as_ref());
        let keeper = crew.start("keep", move || loops::keep(&keep_in, keep, scenario, &record))?;
        let (record, evaluator, checkpoint) = (recorder.clone(), options.evaluator, options.checkpoint);
        let curve = options.curve;
        let assess = crew.start("assess", move || {
            loops::assess(&assess_in, evaluator, checkpoint, scenario, &record, status, curve)
        })?;
        let (record, stop, ended, controls) = (recorder.clone(), options.stop, &ended, options.controls);
        let most_actions = options.most_actions.unwrap_or(u64::MAX).min(scenario.actions as u64);
        let act = crew.start("act", move || {
            let deciding = Deciding {
                scenario,
                schedule: &schedule,
                most_actions,
                record: &record,
                status,
                quiet,
                keep,
                stop,
                controls,
                ended,
                percepts: percepts_in,
                updates: updates_in,
                assess: assess_out,
            };
            deciding.run(acting, actions_out)
        })?;
        let mut health = None;
        if let Some(turns) = turns {
            // The health of the program is told by the clock, and there is none where actors take turns.
            turns.begin();
        } else {
            let (record, over) = (recorder.clone(), &over);
            health = Some(crew.start("health", move || {
                loops::watch_health(&record, status, &world.looks, over);
                Ok(())
            })?);
        }
        let parts = (act.join(), perceive.join(), solver.join(), fitter.join(), assess.join());
        let not_kept = keeper.join().ok().flatten().flatten();
        over.store(true, Ordering::Relaxed);
        let _ = health.map(|health| health.join());
        let stamp = status.snapshot().stamp_ns;
        let failure = failed.lock().unwrap_or_else(PoisonError::into_inner).take();
        match (&failure, parts.0.as_ref()) {
            (Some(error), _) => {
                let _ = recorder.diagnostic(Level::Error, stamp, format!("the run ended early: {error}"));
            }
            (None, Ok(Some(acted))) => {
                if let Some(learned) = &acted.learned {
                    let bytes = checkpoint_bytes(learned, scenario)?;
                    let _ = recorder.attach(CHECKPOINT_NAME, bytes, stamp);
                }
                let _ = recorder.diagnostic(Level::Info, stamp, "the run has ended".into());
            }
            _ => {}
        }
        drop(recorder);
        let log = log_thread.join();
        Ok((parts, not_kept, log, failure))
    });
    let ((act, perceive, solver, fitter, assess), not_kept, log, failure) = parts?;
    if let Some(error) = failure.or_else(|| failed.lock().unwrap_or_else(PoisonError::into_inner).take()) {
        return Err(error);
    }
    let paused = options.controls.map_or(Duration::ZERO, Controls::paused_for);
    // Without a failure every actor has returned what it has.
    let lost = |name| RunError::Panic(name, "it returned nothing".into());
    let acted = act.ok().flatten().ok_or_else(|| lost("act"))?;
    let perceived = perceive.ok().flatten().ok_or_else(|| lost("perceive"))?;
    let resolve = solver.ok().flatten().ok_or_else(|| lost("solve"))?;
    let (refit, kernel_values_by) = fitter.ok().flatten().ok_or_else(|| lost("fit"))?;
    Ok(Outcome {
        learned: acted.learned,
        without_model: acted.without_model,
        actions: acted.actions,
        frames: perceived.frames,
        quarantined: perceived.quarantined,
        seconds: begin.elapsed().saturating_sub(paused).as_secs_f64(),
        support_vectors: perceived.support_vectors,
        nu: perceived.nu,
        curve: assess.ok().flatten().ok_or_else(|| lost("assess"))?,
        timing: Timing {
            act_p50: acted.clock.quantile_ms(0.5),
            act_p99: acted.clock.quantile_ms(0.99),
            frame_p50: perceived.clock.quantile_ms(0.5),
            frame_p99: perceived.clock.quantile_ms(0.99),
            resolve_p50: resolve.quantile_ms(0.5),
            resolve_max: resolve.max_ms(),
            refit_p50: refit.quantile_ms(0.5),
            refit_max: refit.max_ms(),
        },
        pursuits: acted.pursuits,
        dropped: status.snapshot().dropped,
        kernel_values_by,
        not_kept,
        log: log.ok().flatten().ok_or_else(|| lost("log"))?,
    })
}
