//! One run: the actors on their threads, from the first frame to the closed log.

use std::convert::Infallible;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use super::actors::act::{Act, ActLoop, ActState};
use super::actors::evaluate::{self, CurvePoint};
use super::actors::fit::{FitLoop, FitPolicies};
use super::actors::fleet::{Fleet, Gather, exchange};
use super::actors::learn::{Learn, LearnLoop, Seen};
use super::actors::messages::{FitRequest, Item, Percept, SolveRequest, Update};
use super::actors::perceive::{Perceive, PerceiveLoop};
use super::actors::record::{Level, Recorder, write_log};
use super::actors::solve::Solve;
use super::actors::source::SourceLoop;
use super::actors::{health, save};
use super::error::RunError;
use super::runtime::checkpoint::{CHECKPOINT_NAME, checkpoint_bytes};
use super::runtime::clock::{Clock, Timing};
use super::runtime::controls::Controls;
use super::runtime::interleaving::Interleaving;
use super::runtime::marker::{Quiescence, SnapshotSettings};
use super::runtime::queue::queue;
use super::runtime::status::Status;
use super::runtime::threads::{Threads, parallelism};
use super::runtime::timing::{ModelTiming, RecordedEvents};
use crate::evaluate::Evaluator;
use crate::gpu::Choice;
use crate::lock::lock;
use crate::log::{RunLog, RunTotals};
use crate::policy::{Learned, Tally};
use crate::random::fix_parallelism;
use crate::robot::Action;
use crate::scenario::{Mode, Plan, Renderer, Scenario, WhenBehind};
use crate::snapshot::Snapshot;
use crate::source::{Frame, Source};

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
    pub recording: Option<&'a RecordedEvents>,
    /// The run ends after this many actions, if that is before the scenario's end.
    pub most_actions: Option<u64>,
    /// Where the state of the run is saved; nowhere without.
    pub keep: Option<SnapshotSettings>,
    /// The state that the run goes on from, if it does not begin.
    pub state: Option<Snapshot>,
    /// Evaluations before that state.
    pub curve: Vec<CurvePoint>,
    /// Who learns in place of the run itself. The state of such a run is not saved.
    pub fleet: Option<Box<dyn Fleet + 'a>>,
    /// Who renders camera images, where a scenario leaves that open.
    pub rendered_by: Option<&'a (dyn Fn() -> Option<Choice> + Sync)>,
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
            fleet: None,
            rendered_by: None,
            flush_by_stamps: None,
        }
    }
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
    pub not_saved: Option<String>,
    /// Which frames the learner of a fleet did not take, and why; none without one.
    pub not_taken: Option<String>,
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
    plan: &Arc<Plan>,
    source: &mut (dyn Source + Send),
    log: RunLog,
    options: RunOptions<'_>,
) -> Result<Outcome, RunError> {
    run_interleaved(scenario, plan, source, log, options, None)
}

/// As [`run`]; with `interleaving` only one actor runs at a time, see [`Interleaving`].
pub(super) fn run_interleaved(
    scenario: &Arc<Scenario>,
    plan: &Arc<Plan>,
    source: &mut (dyn Source + Send),
    log: RunLog,
    mut options: RunOptions<'_>,
    interleaving: Option<&Arc<Interleaving>>,
) -> Result<Outcome, RunError> {
    fix_parallelism();
    let begin = Instant::now();
    let status = options.status;
    let (capacity, par) = (scenario.agent.queue, parallelism(&scenario.agent));
    let (frames_out, frames_in, gauge) = queue::<Item<Frame>>("frames", capacity, interleaving);
    status.watch(gauge);
    let (seen_out, seen_in, gauge) = queue::<Item<Seen>>("learn", capacity, interleaving);
    status.watch(gauge);
    let (percepts_out, percepts_in, gauge) = queue::<Percept>("percepts", capacity, interleaving);
    status.watch(gauge);
    let (actions_out, actions_in, gauge) = queue::<Item<Action>>("actions", 1, interleaving);
    status.watch(gauge);
    // Requests carry whole matrices: two of them at a time are enough.
    let (solve_out, solve_in, gauge) = queue::<Item<SolveRequest>>("solve", 1, interleaving);
    status.watch(gauge);
    let (fit_out, fit_in, gauge) = queue::<Item<FitRequest>>("fit", 1, interleaving);
    status.watch(gauge);
    let (updates_out, updates_in, gauge) = queue::<Update>("updates", capacity, interleaving);
    status.watch(gauge);
    let (models_out, models_in, gauge) = queue::<(Arc<Learned>, u64)>("evaluate", 2, interleaving);
    status.watch(gauge);
    let (save_out, save_in, gauge) = queue::<Item<Infallible>>("save", 1, interleaving);
    status.watch(gauge);
    let (writes_out, writes_in, gauge) = queue("log", 8 * capacity, interleaving);
    status.watch(gauge);
    let recorder = Recorder::new(writes_out, scenario.clone());
    let timing = Arc::new(ModelTiming::new(&scenario.agent, options.recording));
    let flush = Duration::from_secs_f64(scenario.log.flush_seconds);
    let failed: Mutex<Option<RunError>> = Mutex::new(None);
    let rendered_by = || options.rendered_by.and_then(|of| of());
    let (ended, over, quiescence) = (AtomicBool::new(false), AtomicBool::new(false), Quiescence::default());

    // The actors, new or as they were.
    let mut perceiver = Perceive::new(scenario.clone(), plan.clone(), timing.clone());
    let mut learner = Learn::new(scenario.clone(), perceiver.tasks(), timing.clone());
    let mut acting = ActState::new(Act::new(scenario));
    let (mut solve, mut fit) = (Solve::new(&scenario.slow, par), FitPolicies::new(scenario.clone(), par));
    let goes_on = options.state.is_some();
    if let Some(mut snapshot) = options.state {
        snapshot.inner("acting", &mut acting)?;
        snapshot.scope("source", |snapshot| source.persist(snapshot))?;
        snapshot.inner("perceive", &mut perceiver)?;
        snapshot.inner("learn", &mut learner)?;
        learner.set_tasks(perceiver.tasks());
        snapshot.inner("solve", &mut solve)?;
        snapshot.inner("fit", &mut fit)?;
    }
    if let Some(update) = options.fleet.as_mut().and_then(|fleet| fleet.newest()) {
        match scenario.agent.mode {
            Mode::Lockstep => acting.waiting.push_back((update.asked_at, Some(update))),
            Mode::Realtime => drop(updates_out.put(update)),
        }
    }
    let agent = &scenario.agent;
    // A recording has dropped already what it dropped.
    let drops = agent.when_behind == WhenBehind::Drop && options.recording.is_none();
    let supply = SourceLoop {
        actions: actions_in,
        frames: frames_out,
        drop_from: drops.then(|| frames_in.clone()),
        goes_on,
        quiescence: &quiescence,
        speed: agent.speed.filter(|_| options.recording.is_none()),
        record: recorder.clone(),
        controls: options.controls,
        status,
    };

    let parts = std::thread::scope(|scope| -> Result<_, RunError> {
        let threads = Threads { scope, failed: &failed, ended: &ended, interleaving };
        let by_stamps = options.flush_by_stamps;
        let log_thread = threads.start("log", move || Ok(write_log(&writes_in, log, flush, by_stamps)?))?;
        // Pictures of another renderer are close to these, and not the same.
        if interleaving.is_none()
            && scenario.world.renderer == Renderer::Gpu
            && let Some(by) = rendered_by()
        {
            let level = if by.is_device() { Level::Info } else { Level::Warn };
            let _ = recorder.diagnostic(level, status.now().stamp_ns, format!("images are rendered {by}"));
        }
        threads.start("source", move || {
            supply.run(source);
            Ok(())
        })?;
        let (record, quiescence) = (recorder.clone(), &quiescence);
        let perceiving =
            PerceiveLoop { percepts: percepts_out, seen: seen_out, drops, record: record.clone(), status, quiescence };
        let perceive = threads.start("perceive", move || Ok(perceiving.run(perceiver, &frames_in)))?;
        let (learn, solvers, exchanged) = match options.fleet {
            None => {
                let learning = LearnLoop { solve: solve_out, record, status, quiescence };
                let learn = threads.start("learn", move || learning.run(learner, &seen_in))?;
                let solver = threads.start("solve", move || Ok(solve.run(&solve_in, &fit_out)))?;
                // Who computes changes no number, and a log of interleaved actors says nothing of it.
                let (record, reports_device) = (recorder.clone(), interleaving.is_none());
                let fitting =
                    FitLoop { requests: fit_in, updates: updates_out, save: save_out, record, status, reports_device };
                (learn, Some((solver, threads.start("fit", move || Ok(fitting.run(fit)))?)), None)
            }
            Some(mut fleet) => {
                // Nobody sends there.
                drop((solve_out, fit_out, save_out));
                let (batches, batches_in, gauge) = queue("fleet", 1, interleaving);
                status.watch(gauge);
                let gather = Gather { timing: timing.clone(), batches, record };
                let learn = threads.start("learn", move || Ok(gather.run(&seen_in)))?;
                let stop = options.stop;
                let exchanging = move || Ok(exchange(&mut *fleet, &batches_in, &updates_out, status, stop));
                (learn, None, Some(threads.start("fleet", exchanging)?))
            }
        };
        let (record, keep) = (recorder.clone(), options.keep.as_ref());
        let keeper = threads.start("save", move || save::run(&save_in, keep, scenario, &record))?;
        let (record, evaluator, checkpoint) = (recorder.clone(), options.evaluator, options.checkpoint);
        let curve = options.curve;
        let evaluations = threads.start("evaluate", move || {
            evaluate::run(&models_in, evaluator, checkpoint, scenario, &record, status, curve)
        })?;
        let (record, stop, ended, controls) = (recorder.clone(), options.stop, &ended, options.controls);
        let most_actions = options.most_actions.unwrap_or(u64::MAX).min(scenario.actions as u64);
        let act = threads.start("act", move || {
            let acting_loop = ActLoop {
                scenario,
                timing: &timing,
                most_actions,
                record: &record,
                status,
                quiescence,
                keep,
                stop,
                controls,
                ended,
                percepts: percepts_in,
                updates: updates_in,
                models: models_out,
            };
            acting_loop.run(acting, actions_out)
        })?;
        let mut health = None;
        if let Some(interleaving) = interleaving {
            // The health of the program is measured by the clock, and there is none where actors take turns.
            interleaving.begin();
        } else {
            let (record, over) = (recorder.clone(), &over);
            health = Some(threads.start("health", move || {
                health::run(&record, status, rendered_by, over);
                Ok(())
            })?);
        }
        let parts = (act.join(), perceive.join(), learn.join(), evaluations.join());
        let solvers = solvers.map(|(solver, fitter)| (solver.join(), fitter.join()));
        let exchanged = exchanged.map(|thread| thread.join());
        let not_saved = keeper.join().ok().flatten().flatten();
        over.store(true, Ordering::Relaxed);
        let _ = health.map(|health| health.join());
        let stamp = status.now().stamp_ns;
        let failure = lock(&failed).take();
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
        Ok((parts, (solvers, exchanged), not_saved, log, failure))
    });
    let ((act, perceive, learn, evaluations), (solvers, exchanged), not_saved, log, failure) = parts?;
    if let Some(error) = failure.or_else(|| lock(&failed).take()) {
        return Err(error);
    }
    let paused = options.controls.map_or(Duration::ZERO, Controls::paused_for);
    // Without a failure every actor has returned what it has.
    let lost = |name| RunError::Panic(name, "it returned nothing".into());
    let acted = act.ok().flatten().ok_or_else(|| lost("act"))?;
    let frames = perceive.ok().flatten().ok_or_else(|| lost("perceive"))?;
    let learned = learn.ok().flatten().ok_or_else(|| lost("learn"))?;
    let (mut resolve, mut refit, mut kernel_values_by, mut not_taken) = (Clock::new(), Clock::new(), None, None);
    if let Some((solver, fitter)) = solvers {
        resolve = solver.ok().flatten().ok_or_else(|| lost("solve"))?;
        (refit, kernel_values_by) = fitter.ok().flatten().ok_or_else(|| lost("fit"))?;
    }
    if let Some(thread) = exchanged {
        (not_taken, refit) = thread.ok().flatten().ok_or_else(|| lost("fleet"))?;
    }
    // A robot of a fleet has the dictionary of its model.
    let of_model = acted.learned.as_ref().map_or(0, |learned| learned.model.members.ncols());
    Ok(Outcome {
        learned: acted.learned,
        without_model: acted.without_model,
        actions: acted.actions,
        frames,
        quarantined: learned.quarantined,
        seconds: begin.elapsed().saturating_sub(paused).as_secs_f64(),
        support_vectors: learned.support_vectors.max(of_model),
        nu: learned.nu,
        curve: evaluations.ok().flatten().ok_or_else(|| lost("evaluate"))?,
        timing: Timing {
            act_p50: acted.clock.quantile_ms(0.5),
            act_p99: acted.clock.quantile_ms(0.99),
            frame_p50: learned.clock.quantile_ms(0.5),
            frame_p99: learned.clock.quantile_ms(0.99),
            frame_mean: learned.clock.mean_ms(),
            resolve_p50: resolve.quantile_ms(0.5),
            resolve_max: resolve.max_ms(),
            refit_p50: refit.quantile_ms(0.5),
            refit_max: refit.max_ms(),
        },
        pursuits: acted.pursuits,
        dropped: status.now().dropped,
        kernel_values_by,
        not_saved,
        not_taken,
        log: log.ok().flatten().ok_or_else(|| lost("log"))?,
    })
}
