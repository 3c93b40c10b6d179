//! Sums over the frames of a log, and of all logs.

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;

use faer::{Mat, MatRef};

use super::{Dictionary, Head, Job, ManyError, PartsOf, Piece, Setting, read_part, unusable, write_part};
use crate::agent::steps::{
    Marked, Observations, PlaceWindow, SavedMark, Transitions, parallelism, put_window, take_window,
};
use crate::dictionary::Selection as _;
use crate::policy::columns;
use crate::scenario::Scenario;
use crate::slow::{Link, Moments};
use crate::snapshot::{Snapshot, SnapshotError};
use crate::value::{Transition, Window};
use crate::vision::Observation;

/// Frames of a product.
const AT_ONCE: usize = 512;

/// What frames of a log, or several logs, have to tell.
pub struct Sums {
    /// Of which log and frames, over which dictionary.
    head: Head,
    /// Sums over the coordinates of frames.
    pub(super) moments: Moments,
    /// Transitions, at most as many as a scenario's window holds.
    pub(super) window: PlaceWindow,
    /// What was marked, up to a log's last frame.
    pub(super) marks: Vec<Marked>,
    /// Frames that were summed over.
    pub frames: u64,
    /// Their numbers are below this, by two: frames of the next log do not follow the last one.
    pub(super) end: u64,
    /// The largest residual of a frame: how much of one the dictionary lacks.
    pub residual: f64,
}

impl Sums {
    /// Write them as a part.
    ///
    /// # Errors
    /// The file system refused.
    pub fn write(mut self, path: &Path, scenario: &Scenario) -> Result<(), ManyError> {
        let mut snapshot = Snapshot::new();
        self.persist(&mut snapshot, scenario).map_err(|cause| unusable(path, &cause))?;
        write_part(path, snapshot, self.frames, scenario)
    }

    /// Read a part.
    ///
    /// # Errors
    /// The file cannot be read, or is something else.
    pub fn read(path: &Path, scenario: &Scenario) -> Result<Self, ManyError> {
        let mut of = read_part(path, scenario)?;
        let mut sums = Sums::none(scenario);
        sums.frames = of.frame;
        sums.persist(&mut of.snapshot, scenario).map_err(|cause| unusable(path, &cause))?;
        Ok(sums)
    }

    fn none(scenario: &Scenario) -> Self {
        let par = parallelism(&scenario.agent);
        Sums {
            head: Head::default(),
            moments: Moments::new(par),
            window: Window::new(scenario.value.window),
            marks: Vec::new(),
            frames: 0,
            end: 0,
            residual: 0.0,
        }
    }

    fn persist(&mut self, snapshot: &mut Snapshot, scenario: &Scenario) -> Result<(), SnapshotError> {
        self.head.persist(snapshot)?;
        snapshot.inner("moments", &mut self.moments)?;
        snapshot.value("end", &mut self.end)?;
        snapshot.number("residual", &mut self.residual)?;
        let values = scenario.vision.values();
        let mut seen = Observations::default();
        if snapshot.is_restoring() {
            seen.persist(snapshot, values)?;
            self.window = take_window(scenario.value.window, &seen, snapshot)?;
            let mut marks: Vec<SavedMark> = Vec::new();
            snapshot.value("marks", &mut marks)?;
            self.marks = marks.into_iter().map(|mark| seen.mark(mark)).collect::<Result<_, _>>()?;
        } else {
            put_window(&self.window, &mut seen, snapshot)?;
            let mut marks: Vec<SavedMark> = self.marks.iter().map(|marked| seen.add_mark(marked)).collect();
            snapshot.value("marks", &mut marks)?;
            seen.persist(snapshot, values)?;
        }
        Ok(())
    }
}

/// Sums that are added in pairs: two of the same number of parts at a time, as they come.
#[derive(Default)]
struct Pairs(Vec<(u32, Moments)>);

impl Pairs {
    fn add(&mut self, mut moments: Moments) -> Result<(), ManyError> {
        let mut level = 0;
        while self.0.last().is_some_and(|last| last.0 == level) {
            if let Some((_, before)) = self.0.pop() {
                moments = sum(before, &moments)?;
                level += 1;
            }
        }
        self.0.push((level, moments));
        Ok(())
    }

    /// All of them; the smaller ones first, which come last.
    fn finish(mut self) -> Result<Option<Moments>, ManyError> {
        let Some((_, mut all)) = self.0.pop() else { return Ok(None) };
        while let Some((_, before)) = self.0.pop() {
            all = sum(before, &all)?;
        }
        Ok(Some(all))
    }
}

fn sum(mut a: Moments, b: &Moments) -> Result<Moments, ManyError> {
    a.append(b)?;
    Ok(a)
}

/// Sums over frames of a log, in the coordinates of a dictionary. What leads into them from the frame before is theirs.
///
/// # Errors
/// A log of which not all of these frames can be used.
pub fn sums(setting: &Setting, piece: &Piece<'_>, dictionary: &Dictionary) -> Result<Sums, ManyError> {
    let scenario = &setting.scenario;
    let mut all = Sums::none(scenario);
    let (mut known, mut samples) = (dictionary.selection.dictionary().clone(), piece.samples(setting));
    let mut judge =
        |x: MatRef<'_, f32>| known.grow(x, |_, _| false).map_err(|cause| ManyError::NoModel(cause.to_string()));
    let mut transitions = Transitions::new(scenario.value.window);
    let mut before: Option<Mat<f64>> = None;
    if let Some(last) = &samples.last {
        let action = samples.boundary.as_ref();
        let seen: Vec<&Observation> = action.map(|sample| &*sample.observation).into_iter().chain([&**last]).collect();
        let judged = judge(columns(seen.into_iter()).as_ref())?;
        before = Some(judged.coordinates.subcols(judged.coordinates.ncols() - 1, 1).to_owned());
        if let Some(sample) = action {
            transitions.add(sample, Some(judged.nearest[0]));
        }
    }
    all.moments.widen(dictionary.members().ncols())?;
    loop {
        let block = samples.next(AT_ONCE);
        let Some(newest) = block.last() else { break };
        all.end = newest.observation.frame + 2;
        let judged = judge(columns(block.iter().map(|sample| sample.observation.as_ref())).as_ref())?;
        let links: Vec<Option<Link>> = block.iter().map(|sample| sample.link).collect();
        let v = judged.coordinates.as_ref();
        all.moments.add_series(v, &links, before.as_ref().map(|of| of.as_ref()))?;
        before = Some(v.subcols(v.ncols() - 1, 1).to_owned());
        for (sample, &cell) in block.iter().zip(&judged.nearest) {
            transitions.add(sample, Some(cell));
        }
        all.residual = judged.residuals.iter().fold(all.residual, |most, &residual| most.max(residual));
    }
    all.frames = samples.check(piece)?;
    all.window = transitions.window;
    all.head = Head::of(&Job::Moments, piece, dictionary.digest());
    if all.head.is_last() {
        all.marks = samples.tasks().marks.clone();
    }
    Ok(all)
}

/// The sums of all logs: in the order of the logs' digests and of their frames, in pairs, those of a log first. At most as many are held at a
/// time as their number has binary digits, twice.
///
/// # Errors
/// Parts over another dictionary, of frames twice or not of all; files that cannot be read.
pub fn merge(setting: &Setting, dictionary: &Dictionary, parts: PartsOf<'_>) -> Result<Sums, ManyError> {
    let scenario = &setting.scenario;
    let (mut all, mut pairs, mut of_log) = (Sums::none(scenario), Pairs::default(), Pairs::default());
    for (head, path) in super::in_order(parts, scenario, (&Job::Moments, dictionary))? {
        let part = Sums::read(path, scenario)?;
        of_log.add(part.moments)?;
        let mut seen: BTreeMap<u64, Arc<Observation>> = BTreeMap::new();
        let mut behind = |of: &Arc<Observation>| {
            let frame = all.end + of.frame;
            let moved = || Arc::new(Observation { frame, pixels: of.pixels.clone() });
            seen.entry(of.frame).or_insert_with(moved).clone()
        };
        for transition in part.window.snapshot() {
            let (from, to) = (behind(&transition.from), behind(&transition.to));
            all.window.push(Transition { from, to, ..transition });
        }
        all.marks
            .extend(part.marks.iter().map(|mark| Marked { observation: behind(&mark.observation), ..mark.clone() }));
        all.frames += part.frames;
        all.residual = all.residual.max(part.residual);
        if head.is_last() {
            all.end += part.end;
            if let Some(moments) = std::mem::take(&mut of_log).finish()? {
                pairs.add(moments)?;
            }
        }
    }
    all.moments = pairs.finish()?.unwrap_or(all.moments);
    Ok(all)
}

#[cfg(test)]
mod tests {
    use faer::Par;

    use super::*;

    #[test]
    fn pairs_hold_as_many_sums_as_their_number_has_digits_and_add_up() {
        for count in 0..=33u32 {
            let mut pairs = Pairs::default();
            for k in 0..count {
                let mut moments = Moments::new(Par::Seq);
                moments.widen(1).unwrap();
                moments.add(Mat::from_fn(1, 1, |_, _| f64::from(k)).as_ref(), Mat::zeros(1, 0).as_ref(), 0.0).unwrap();
                pairs.add(moments).unwrap();
                assert_eq!(pairs.0.len(), (k + 1).count_ones() as usize);
            }
            let all = pairs.finish().unwrap().map(|all| (all.frames(), all.mean()[(0, 0)]));
            assert_eq!(
                all,
                (count > 0).then(|| (f64::from(count), f64::from(count.saturating_sub(1)) / 2.0)),
                "{count}"
            );
        }
    }
}
