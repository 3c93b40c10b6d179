//! Finished settings of an experiment, one small JSON file each, so that an experiment that was stopped goes on.
//!
//! A file is named by a hash of its settings. Its first line holds a hash of the rest: a file that is cut off or changed is
//! told from a whole one, put aside, and computed again.

use std::path::{Path, PathBuf};
use std::time::{Instant, SystemTime, UNIX_EPOCH};

use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

use super::ExperimentError;
use crate::report::Program;
use crate::scenario::hex;

/// Part of every hash: to be raised when the code gives other results for the same settings, so that what was kept before is
/// not taken any more.
const REVISION: u32 = 2;

/// Digits of the settings' hash in a file's name.
const DIGITS: usize = 16;

/// A folder of finished settings.
#[derive(Debug)]
pub struct Cache {
    folder: PathBuf,
}

/// What is kept of one setting.
#[derive(Debug, Serialize, Deserialize)]
pub struct Cached<S, R> {
    /// The experiment.
    pub experiment: String,
    /// What was computed.
    pub settings: S,
    /// What came out.
    pub result: R,
    /// How long that took.
    pub seconds: f64,
    /// The commit of the program that computed it, where that is known.
    pub commit: Option<String>,
}

/// How a result was come by.
#[derive(Debug, Clone, PartialEq)]
pub struct Found<R> {
    /// The result.
    pub result: R,
    /// Its file.
    pub path: PathBuf,
    /// Whether it was there already.
    pub kept: bool,
    /// Whether another build of the program computed it.
    pub other_build: bool,
    /// A damaged file that was in its place, and where it is now.
    pub damaged: Option<(String, PathBuf)>,
}

impl Cache {
    /// The cache in a folder, which is made if need be.
    ///
    /// # Errors
    /// The folder cannot be made.
    pub fn open(folder: &Path) -> Result<Self, ExperimentError> {
        std::fs::create_dir_all(folder).map_err(ExperimentError::file("create the folder", folder))?;
        Ok(Cache { folder: folder.to_owned() })
    }

    /// The result of some settings: from the cache, or computed and kept.
    ///
    /// Both ways give the same bits, since what was computed is read back from its JSON text too. A result must have no
    /// numbers that JSON does not know: NaN and infinities.
    ///
    /// # Errors
    /// Those of `compute`; a file that cannot be read or written.
    pub fn get<S: Serialize, R: Serialize + DeserializeOwned>(
        &self,
        experiment: &str,
        label: &str,
        settings: &S,
        compute: impl FnOnce() -> Result<R, ExperimentError>,
    ) -> Result<Found<R>, ExperimentError> {
        let key = hex(&Sha256::digest(serde_json::to_string(&(experiment, REVISION, settings))?.as_bytes()));
        let plain: String = label.chars().map(|c| if c.is_ascii_alphanumeric() { c } else { '-' }).collect();
        let path = self.folder.join(format!("{plain}-{}.json", &key[..DIGITS]));
        let mut damaged = None;
        match std::fs::read_to_string(&path) {
            Ok(text) => match whole::<R>(&text) {
                Ok((result, commit)) => {
                    let other_build = commit.as_deref() != Program::this().commit;
                    return Ok(Found { result, path, kept: true, other_build, damaged: None });
                }
                Err(reason) => damaged = Some((reason, put_aside(&path)?)),
            },
            Err(cause) if cause.kind() == std::io::ErrorKind::NotFound => {}
            // Bytes that are no text are damage, too.
            Err(cause) if cause.kind() == std::io::ErrorKind::InvalidData => {
                damaged = Some((cause.to_string(), put_aside(&path)?));
            }
            Err(cause) => return Err(ExperimentError::file("read", &path)(cause)),
        }
        let begin = Instant::now();
        let kept = Cached {
            experiment: experiment.to_owned(),
            settings,
            result: compute()?,
            seconds: begin.elapsed().as_secs_f64(),
            commit: Program::this().commit.map(str::to_owned),
        };
        let body = serde_json::to_string_pretty(&kept)?;
        // The opening brace goes before the line of the hash, so that the whole file is JSON.
        let body = body.strip_prefix('{').unwrap_or(&body);
        let text = format!("{{ \"sha256\": \"{}\",{body}\n", digest(body));
        let (result, _) = whole::<R>(&text).map_err(|reason| {
            let cause = std::io::Error::new(std::io::ErrorKind::InvalidData, reason);
            ExperimentError::file("read back", &path)(cause)
        })?;
        write_whole(&path, &text)?;
        Ok(Found { result, path, kept: false, other_build: false, damaged })
    }
}

fn digest(body: &str) -> String {
    hex(&Sha256::digest(body.trim_end().as_bytes()))
}

/// The result and the commit in a file, or what is wrong with it.
fn whole<R: DeserializeOwned>(text: &str) -> Result<(R, Option<String>), String> {
    #[derive(Deserialize)]
    struct Head {
        sha256: String,
    }
    let (head, body) = text.split_once(',').ok_or("it has no first line")?;
    let head: Head = serde_json::from_str(&format!("{head}}}")).map_err(|error| format!("its first line: {error}"))?;
    if head.sha256 != digest(body) {
        return Err("its contents do not have the hash that its first line says".into());
    }
    let kept: Cached<serde::de::IgnoredAny, R> = serde_json::from_str(text).map_err(|error| error.to_string())?;
    Ok((kept.result, kept.commit))
}

/// Rename a damaged file, so that nothing is overwritten.
fn put_aside(path: &Path) -> Result<PathBuf, ExperimentError> {
    for number in 1.. {
        let aside =
            path.with_added_extension(if number == 1 { "damaged".to_owned() } else { format!("damaged-{number}") });
        if !aside.exists() {
            std::fs::rename(path, &aside).map_err(ExperimentError::file("rename", path))?;
            return Ok(aside);
        }
    }
    unreachable!("the numbers do not end")
}

/// Write a file such that it is whole or not there, whoever else writes it.
fn write_whole(path: &Path, text: &str) -> Result<(), ExperimentError> {
    // On machines that share the folder, processes may have the same number.
    let now = SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |since| since.as_nanos());
    let part = path.with_added_extension(format!("{}-{now}.part", std::process::id()));
    std::fs::write(&part, text).map_err(ExperimentError::file("write", &part))?;
    std::fs::rename(&part, path).map_err(ExperimentError::file("write", path))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn get(cache: &Cache, settings: &(u32, f64), computed: f64) -> Found<Vec<f64>> {
        cache.get("test", "a label", settings, || Ok(vec![computed, 0.1 + 0.2])).unwrap()
    }

    #[test]
    fn a_setting_is_computed_once_and_another_one_anew() {
        let folder = tempfile::tempdir().unwrap();
        let cache = Cache::open(folder.path()).unwrap();
        let first = get(&cache, &(1, 0.5), 1.0 / 3.0);
        assert!(!first.kept && (first.result[0] - 1.0 / 3.0).abs() < 1e-15);
        let again = get(&cache, &(1, 0.5), 7.0);
        assert!(again.kept && again.result == first.result && again.path == first.path);
        let other = get(&cache, &(1, 0.5000001), 7.0);
        assert!(!other.kept && other.result[0] == 7.0 && other.path != first.path);
    }

    #[test]
    fn a_file_that_was_cut_or_changed_is_put_aside_and_computed_again() {
        let folder = tempfile::tempdir().unwrap();
        let cache = Cache::open(folder.path()).unwrap();
        let path = get(&cache, &(1, 0.5), 1.25).path;
        let text = std::fs::read_to_string(&path).unwrap();
        for broken in [&text[..text.len() / 2], &text.replace("1.25", "1.35"), "", "{}", "\u{0}"] {
            std::fs::write(&path, broken).unwrap();
            let found = get(&cache, &(1, 0.5), 1.25);
            let (reason, aside) = found.damaged.expect("the damage is told");
            assert!(!reason.is_empty() && !found.kept && found.result[0] == 1.25);
            assert_eq!(std::fs::read_to_string(aside).unwrap(), broken);
            assert_eq!(get(&cache, &(1, 0.5), 0.0).result[0], 1.25);
        }
    }
}
