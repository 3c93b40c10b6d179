//! Reads a run's log while it grows, file after file, into what is shown of it.

use std::collections::{BTreeMap, VecDeque};
use std::io::{self, BufReader};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use super::tail::Tail;
use crate::log::messages::{
    Decision, DictionaryGrowth, FrameTaken, Image, Log, PlaceBelief, PolicyUpdate, Prospect, RobotState,
};
use crate::log::{LogError, LogReader, Record, log_files, topics};
use crate::report::gather::Gathered;

/// Observations whose features are shown: those at the ends of the last actions.
pub const RECENT: usize = 120;

/// Records between looks at the clock.
const BATCH: usize = 200;

/// Lines of the log's diagnostics that are kept.
const SAID: usize = 8;

/// An observation as it was logged.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Seen {
    /// Number of the frame.
    pub frame: u64,
    /// Pixels.
    pub width: usize,
    /// Pixels.
    pub height: usize,
    /// RGB, row by row; empty where it is no such image.
    pub rgb: Vec<u8>,
}

/// The newest of what a log holds.
#[derive(Debug, Default)]
pub struct Newest {
    /// The observation.
    pub observation: Option<Seen>,
    /// The frame.
    pub frame: FrameTaken,
    /// What a robot that takes velocities is doing, and why it may not move.
    pub robot: Option<String>,
    /// The decision.
    pub decision: Option<Decision>,
    /// Where the robot may be.
    pub places: Option<PlaceBelief>,
    /// What is expected of the pursuit.
    pub prospect: Option<Prospect>,
    /// The block of frames that went through the dictionary.
    pub growth: Option<DictionaryGrowth>,
    /// How the policy of each task came about; without its weights.
    pub policies: BTreeMap<String, PolicyUpdate>,
    /// Observations at the ends of the last actions.
    pub recent: VecDeque<Seen>,
    /// The last diagnostics, with their levels.
    pub said: VecDeque<(u8, String)>,
    /// The run says that it has come to its end, and nothing came after that.
    pub ended: bool,
}

/// Follows a run folder or a log file.
pub struct Follower {
    place: PathBuf,
    /// The file that is being read, with its number where it belongs to a run folder.
    reader: Option<(u32, LogReader<BufReader<Tail>>)>,
    /// All that a report shows, too.
    pub gathered: Gathered,
    /// What is the newest.
    pub newest: Newest,
    /// The file can be read no further, and nothing will be added to it.
    finished: bool,
    /// The last file was closed, and all of it was read.
    closed: bool,
    /// Everything that was there when it was last looked at has been read.
    up_to_date: bool,
    /// When something new was last read.
    grew: Instant,
}

impl Follower {
    /// Follow the log of a run folder, or a log file. Nothing is read yet.
    pub fn new(place: &Path) -> Self {
        Follower {
            place: place.to_owned(),
            reader: None,
            gathered: Gathered::empty(0),
            newest: Newest::default(),
            finished: false,
            closed: false,
            up_to_date: false,
            grew: Instant::now(),
        }
    }

    /// Whether the last file was closed, and all of it was read.
    pub fn is_closed(&self) -> bool {
        self.closed
    }

    /// Whether everything that is there has been read.
    pub fn is_up_to_date(&self) -> bool {
        self.up_to_date
    }

    /// Bytes at the end of the log that are no whole record yet.
    pub fn torn(&mut self) -> u64 {
        self.reader.as_mut().map_or(0, |(_, reader)| reader.source().get_ref().torn())
    }

    /// How long nothing new has come.
    pub fn quiet_for(&self) -> Duration {
        self.grew.elapsed()
    }

    /// Read what is new, but no longer than about `limit`. Whether there was something.
    ///
    /// # Errors
    /// A file cannot be opened or read. Damage is part of what was gathered.
    pub fn read_on(&mut self, limit: Duration) -> Result<bool, LogError> {
        let begin = Instant::now();
        let mut news = false;
        self.up_to_date = false;
        while begin.elapsed() < limit {
            if self.reader.is_none() && !self.open_next()? {
                self.up_to_date = true;
                break;
            }
            let mut read = 0;
            while read < BATCH
                && let Some((_, reader)) = &mut self.reader
                && let Some(record) = reader.next()
            {
                read += 1;
                let taken = record.and_then(|record| {
                    self.gathered.read(&record)?;
                    self.newest.read(&record)
                });
                self.gathered.note(taken)?;
            }
            if read > 0 {
                news = true;
                self.closed = false;
            }
            if read < BATCH && !self.at_end()? {
                self.up_to_date = true;
                break;
            }
        }
        if news {
            self.grew = Instant::now();
        }
        Ok(news)
    }

    /// The reader has ended: whether there is something else to read.
    fn at_end(&mut self) -> Result<bool, LogError> {
        let Some((number, reader)) = &mut self.reader else { return Ok(true) };
        if !self.finished && reader.go_on()? {
            return Ok(true);
        }
        if self.place.is_dir() && next_file(&self.place, Some(*number))?.is_some() {
            // Nothing is added to a file that another one follows.
            if reader.source().get_mut().seal() {
                reader.look_again();
                return Ok(true);
            }
            self.closed = false;
            return self.open_next();
        }
        self.closed = reader.source().get_ref().is_closed();
        reader.look_again();
        // An ending that stays is one for good.
        self.finished = reader.ending().is_some();
        Ok(false)
    }

    /// Open the file after the present one, if there is one.
    fn open_next(&mut self) -> Result<bool, LogError> {
        let present = self.reader.as_ref().map(|(number, _)| *number);
        let next = if self.place.is_dir() {
            next_file(&self.place, present)?
        } else if present.is_none() {
            Some((0, self.place.clone()))
        } else {
            None
        };
        let Some((number, path)) = next else { return Ok(false) };
        let log = path.display().to_string();
        let tail = match Tail::open(&path) {
            Ok(tail) => tail,
            // The oldest files of a run may be deleted at any time.
            Err(cause) if cause.kind() == io::ErrorKind::NotFound && present.is_some() => return Ok(false),
            Err(cause) => return Err(LogError::Open { log, cause }),
        };
        let reader = LogReader::new(BufReader::with_capacity(1 << 16, tail), &log).with_summary()?;
        self.reader = Some((number, reader.without_attachments()));
        self.gathered.files += 1;
        self.finished = false;
        Ok(true)
    }
}

/// The first log file of a run folder whose number is above `after`; of a folder without such names, its first log.
fn next_file(run: &Path, after: Option<u32>) -> Result<Option<(u32, PathBuf)>, LogError> {
    let failed = |cause| LogError::Open { log: run.display().to_string(), cause };
    let files = log_files(run).map_err(failed)?;
    Ok(files.into_iter().find(|(number, _)| after.is_none_or(|after| *number > after)))
}

impl Newest {
    fn read(&mut self, record: &Record) -> Result<(), LogError> {
        let Record::Message { topic, schema, sequence, .. } = record else { return Ok(()) };
        // Another program may have another type on a topic of this name.
        let known = topics::ALL.iter().find(|known| known.name == &**topic && known.message == &**schema);
        let Some(known) = known else { return Ok(()) };
        let is = |name: &str| known.name == name;
        if is(topics::FRAME.name()) {
            self.frame = record.decode()?;
            self.ended = false;
        } else if is(topics::OBSERVATION.name()) {
            let image: Image = record.decode()?;
            let seen = Seen {
                frame: u64::from(*sequence),
                width: image.width as usize,
                height: image.height as usize,
                rgb: rgb(image),
            };
            // An action's frames are told before what was made of them.
            if self.frame.boundary && self.frame.frame as u32 == *sequence {
                if self.recent.len() == RECENT {
                    self.recent.pop_front();
                }
                self.recent.push_back(seen.clone());
            }
            self.observation = Some(seen);
        } else if is(topics::ROBOT_STATE.name()) {
            let RobotState { state, causes, .. } = record.decode()?;
            self.robot = Some(if causes.is_empty() { state } else { format!("{state}: {causes}") });
        } else if is(topics::DECISION.name()) {
            self.decision = Some(record.decode()?);
        } else if is(topics::PLACES.name()) {
            self.places = Some(record.decode()?);
        } else if is(topics::PROSPECT.name()) {
            self.prospect = Some(record.decode()?);
        } else if is(topics::DICTIONARY.name()) {
            self.growth = Some(record.decode()?);
        } else if is(topics::POLICY.name()) {
            let policy: PolicyUpdate = record.decode()?;
            self.policies.insert(policy.task.clone(), PolicyUpdate { weights: Vec::new(), ..policy });
        } else if is(topics::END.name()) {
            self.ended = true;
        } else if is(topics::DIAGNOSTICS.name()) {
            let said: Log = record.decode()?;
            if self.said.len() == SAID {
                self.said.pop_front();
            }
            self.said.push_back((said.level, said.msg));
        }
        Ok(())
    }
}

/// The pixels of an image that is RGB, row by row without gaps; nothing of another one.
fn rgb(image: Image) -> Vec<u8> {
    let (width, height) = (image.width as usize, image.height as usize);
    let fits = image.encoding == "rgb8"
        && image.step as usize == 3 * width
        && width.checked_mul(height).and_then(|pixels| pixels.checked_mul(3)) == Some(image.data.len());
    if fits { image.data } else { Vec::new() }
}
