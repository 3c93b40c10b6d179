//! Support vectors for all logs: candidates of each, and the union.

use std::path::Path;

use faer::{Mat, MatRef};
use sha2::{Digest, Sha256};

use super::{Head, Job, Log, ManyError, PartsOf, Piece, Setting, read_part, unusable, write_part};
use crate::dictionary::{Ald, DictionaryError, Parameters, Selection, wider_for_share, width_for_share};
use crate::kernel::Kernel;
use crate::policy::columns;
use crate::scenario::{Scenario, SelectionRule, hex};
use crate::snapshot::{Snapshot, SnapshotError};

/// Support vectors, and the rule that they were chosen by.
#[derive(Debug, Clone)]
pub struct Dictionary {
    pub(super) selection: Ald<f32>,
    /// Width of the kernel.
    pub sigma: f64,
}

impl Dictionary {
    /// The rule of a scenario, with this width of the kernel, before it has taken anything.
    fn new(setting: &Setting, sigma: f64) -> Result<Self, ManyError> {
        let settings = &setting.scenario.dictionary;
        let kernel = Kernel::radial(sigma, settings.exponent).map_err(|cause| no_dictionary(cause.into()))?;
        let (nu, budget, when_full) = (settings.nu, settings.budget, settings.when_full);
        let parameters = Parameters { kernel, nu, budget, when_full, par: setting.par };
        Ok(Dictionary { selection: Ald::new(parameters).map_err(no_dictionary)?, sigma })
    }

    /// Support vectors, `d × m`.
    pub fn members(&self) -> MatRef<'_, f32> {
        self.selection.dictionary().members()
    }

    /// Threshold of acceptance: above the scenario's, where the budget was used up.
    pub fn nu(&self) -> f64 {
        self.selection.nu().unwrap_or(f64::NAN)
    }

    /// Whether it takes nothing more, whatever it lacks.
    pub fn is_full(&self) -> bool {
        self.selection.is_full()
    }

    /// A hash of everything that it is made of.
    pub fn digest(&self) -> String {
        let mut hash = Sha256::new();
        hash.update([self.sigma, self.nu()].map(f64::to_le_bytes).as_flattened());
        self.members().col_iter().for_each(|member| member.iter().for_each(|value| hash.update(value.to_le_bytes())));
        hex(&hash.finalize())
    }

    /// Write it.
    ///
    /// # Errors
    /// The file system refused.
    pub fn write(&self, path: &Path, scenario: &Scenario) -> Result<(), ManyError> {
        let (mut snapshot, mut sigma) = (Snapshot::new(), self.sigma);
        snapshot.number("sigma", &mut sigma).map_err(|cause| unusable(path, &cause))?;
        self.selection.clone().persist(&mut snapshot).map_err(|cause| unusable(path, &cause))?;
        write_part(path, snapshot, 0, scenario)
    }

    /// Read one that was made for a scenario.
    ///
    /// # Errors
    /// The file cannot be read, or is of another scenario.
    pub fn read(path: &Path, setting: &Setting) -> Result<Self, ManyError> {
        let (mut of, mut sigma) = (read_part(path, &setting.scenario)?, 0.0);
        of.snapshot.number("sigma", &mut sigma).map_err(|cause| unusable(path, &cause))?;
        let mut dictionary = Dictionary::new(setting, sigma)?;
        dictionary.selection.persist(&mut of.snapshot).map_err(|cause| unusable(path, &cause))?;
        Ok(dictionary)
    }

    /// Take what these observations, `d × n`, have that it lacks, block by block.
    fn take(&mut self, x: MatRef<'_, f32>, block: usize) -> Result<(), ManyError> {
        for start in (0..x.ncols()).step_by(block) {
            self.selection.observe(x.subcols(start, block.min(x.ncols() - start))).map_err(no_dictionary)?;
            self.selection.thin().map_err(no_dictionary)?;
        }
        Ok(())
    }
}

fn no_dictionary(cause: DictionaryError) -> ManyError {
    ManyError::NoModel(format!("there are no support vectors: {cause}"))
}

/// The rule before there are any support vectors: with the scenario's width of the kernel, or the one for frames that are spread over all
/// logs; of a single log its first ones, as in a run.
///
/// # Errors
/// A scenario that selects at random, or whose frames fade; no width and no log to find it from; frames that are all alike.
pub fn first_dictionary(setting: &Setting, logs: &[Log]) -> Result<Dictionary, ManyError> {
    let settings = &setting.scenario.dictionary;
    if settings.selection != SelectionRule::Ald {
        return Err(ManyError::Together(
            "dictionary.selection must be \"ald\" here: of many logs, random selections are no random selection".into(),
        ));
    }
    if setting.scenario.slow.memory_frames.is_some() {
        return Err(ManyError::Together(
            "slow.memory_frames must be 0 here: frames of many logs have no common time by which they could fade"
                .into(),
        ));
    }
    let sigma = match settings.sigma {
        Some(sigma) => sigma,
        None if logs.is_empty() => {
            return Err(ManyError::Together(
                "the width of the kernel is not known: give --dictionary, or dictionary.sigma in the scenario".into(),
            ));
        }
        None => {
            let (count, every) = (settings.sigma_frames, logs.len().div_ceil(settings.sigma_frames));
            let asked: Vec<&Log> = logs.iter().step_by(every).collect();
            let of_each = count.div_ceil(asked.len());
            let mut seen = Vec::new();
            for (number, log) in asked.iter().enumerate() {
                let apart = if asked.len() == 1 { 1 } else { (log.frames as usize / of_each).max(1) };
                let mut samples = Piece::whole(log).samples(setting);
                // At another time in each: where drives begin at one place, their first frames are alike.
                samples.next(apart * number / asked.len());
                let next = || samples.next(apart).into_iter().next();
                seen.extend(std::iter::from_fn(next).take(of_each).map(|sample| sample.observation));
            }
            let kernel = |sigma| Kernel::radial(sigma, settings.exponent);
            let x = columns(seen.iter().map(AsRef::as_ref));
            let sigma = width_for_share(x.as_ref(), settings.nu, settings.sigma_share, kernel, setting.par)
                .map_err(no_dictionary)?;
            match settings.looks_again().zip(logs.first()).filter(|_| logs.len() == 1) {
                Some(((frames, share), log)) if log.frames as usize >= frames => {
                    let first = Piece::whole(log).samples(setting).next(frames);
                    let x = columns(first.iter().map(|sample| sample.observation.as_ref()));
                    let wider = wider_for_share(x.as_ref(), settings.nu, share, sigma, kernel, setting.par);
                    wider.map_err(no_dictionary)?.unwrap_or(sigma)
                }
                _ => sigma,
            }
        }
    };
    Dictionary::new(setting, sigma)
}

/// What frames of a log have that a dictionary lacks.
#[derive(Debug)]
pub struct Candidates {
    head: Head,
    members: Mat<f32>,
    frames: u64,
}

impl Candidates {
    /// Write them as a part.
    ///
    /// # Errors
    /// The file system refused.
    pub fn write(mut self, path: &Path, scenario: &Scenario) -> Result<(), ManyError> {
        let mut snapshot = Snapshot::new();
        self.persist(&mut snapshot).map_err(|cause| unusable(path, &cause))?;
        write_part(path, snapshot, self.frames, scenario)
    }

    /// Read a part.
    ///
    /// # Errors
    /// The file cannot be read, or is something else.
    pub fn read(path: &Path, scenario: &Scenario) -> Result<Self, ManyError> {
        let mut of = read_part(path, scenario)?;
        let mut candidates = Candidates { head: Head::default(), members: Mat::new(), frames: of.frame };
        candidates.persist(&mut of.snapshot).map_err(|cause| unusable(path, &cause))?;
        Ok(candidates)
    }

    fn persist(&mut self, snapshot: &mut Snapshot) -> Result<(), SnapshotError> {
        self.head.persist(snapshot)?;
        snapshot.matrix("members", &mut self.members, |rows, columns| (rows, columns))
    }
}

/// The frames of a log that become support vectors beside those of a dictionary, in their order, by its rule.
///
/// # Errors
/// A log of which not all of these frames can be used.
pub fn candidates(setting: &Setting, piece: &Piece<'_>, dictionary: &Dictionary) -> Result<Candidates, ManyError> {
    let (mut beside, mut samples, block) =
        (dictionary.clone(), piece.samples(setting), setting.scenario.dictionary.block_frames);
    let known = beside.selection.dictionary().serials().last().map_or(0, |last| last + 1);
    loop {
        let seen = samples.next(block);
        if seen.is_empty() {
            break;
        }
        // A full one takes nothing; but frames that cannot be read are to be noticed.
        if !beside.is_full() {
            beside.take(columns(seen.iter().map(|sample| sample.observation.as_ref())).as_ref(), block)?;
        }
    }
    let frames = samples.check(piece)?;
    let of = beside.selection.dictionary();
    let new: Vec<usize> = (0..of.len()).filter(|&place| of.serials()[place] >= known).collect();
    let members = Mat::from_fn(of.members().nrows(), new.len(), |i, j| of.members()[(i, new[j])]);
    Ok(Candidates { head: Head::of(&Job::Members, piece, dictionary.digest()), members, frames })
}

/// A dictionary and what logs have that it lacks, thinned by the same rule, in the order of the logs' digests and of their frames; and
/// whether that is more. One part is held at a time.
///
/// # Errors
/// Candidates beside another dictionary, of frames twice or not of all; files that cannot be read.
pub fn union(setting: &Setting, dictionary: &Dictionary, parts: PartsOf<'_>) -> Result<(Dictionary, bool), ManyError> {
    let mut all = dictionary.clone();
    for (_, path) in super::in_order(parts, &setting.scenario, (&Job::Members, dictionary))? {
        if all.is_full() {
            break;
        }
        let candidates = Candidates::read(path, &setting.scenario)?;
        all.take(candidates.members.as_ref(), setting.scenario.dictionary.block_frames)?;
    }
    let more = all.digest() != dictionary.digest();
    Ok((all, more))
}
