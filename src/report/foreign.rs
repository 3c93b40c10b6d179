//! What a report can show of a log that another program wrote: its camera's images and its robot's way.

use std::path::PathBuf;

use super::draw::{Picture, thinned};
use super::gather::{Downsample, Gathered};
use crate::log::messages::{self as msg, Message as _, foreign};
use crate::log::{FilesReader, LogError, Record, cdr};
use crate::source::imported::{compressed, pose_of, raw};
use crate::vision::Image;

/// Images that are shown at most.
const SHOWN: usize = 4;
/// Widest image that a page holds, pixels.
const WIDEST: usize = 640;

const CAMERA: [&str; 2] = [msg::Image::TYPE, foreign::CompressedImage::TYPE];
/// Poses that are one come before transforms, which hold many.
const POSE: [&[&str]; 2] = [
    &[msg::Odometry::TYPE, msg::PoseStamped::TYPE, foreign::PoseWithCovarianceStamped::TYPE],
    &[foreign::TfMessage::TYPE],
];

/// What was found.
#[derive(Debug, Default)]
pub struct Foreign {
    /// The topic of the images.
    pub camera: Option<String>,
    /// The topic of the poses.
    pub pose: Option<String>,
    /// Images, evenly over the log.
    pub pictures: Vec<Picture>,
    /// Messages on both topics that could not be read, and why the first one could not.
    pub unreadable: u64,
    /// Why.
    pub reason: Option<String>,
}

/// Read images and poses of a log whose topics are known; the poses go to `gathered`.
///
/// Of several topics the one with the most messages is taken.
///
/// # Errors
/// A file cannot be opened or read.
pub fn look(files: Vec<PathBuf>, gathered: &mut Gathered) -> Result<Foreign, LogError> {
    let most = |kinds: &[&str]| {
        let fits = gathered.topics.iter().filter(|(_, seen)| kinds.contains(&seen.kind.as_str()));
        fits.max_by_key(|(_, seen)| seen.messages).map(|(name, _)| name.clone())
    };
    let mut found =
        Foreign { camera: most(&CAMERA), pose: POSE.iter().find_map(|kinds| most(kinds)), ..Foreign::default() };
    let mut images: Downsample<(u64, Image)> = Downsample::first_of(SHOWN);
    for record in FilesReader::new(files) {
        let (topic, schema, log_time_ns, data) = match record {
            Ok(Record::Message { topic, schema, log_time_ns, data, .. }) => (topic, schema, log_time_ns, data),
            Err(error @ (LogError::Open { .. } | LogError::Read { .. })) => return Err(error),
            // What is damaged was counted before.
            Ok(_) | Err(_) => continue,
        };
        let is = |role: &Option<String>| role.as_deref() == Some(&*topic);
        let read = if is(&found.camera) {
            images.offer(|| Ok((log_time_ns, image(&schema, &data)?)))
        } else if is(&found.pose) {
            match pose_of(&schema, &data) {
                Ok(Some((_, pose))) if pose.position.coords.norm().is_finite() && pose.heading.is_finite() => {
                    gathered.passed(pose);
                    Ok(())
                }
                Ok(_) => Ok(()),
                Err(error) => Err(error.to_string()),
            }
        } else {
            Ok(())
        };
        if let Err(reason) = read {
            found.unreadable += 1;
            found.reason.get_or_insert(reason);
        }
    }
    // Of a large image every second, third, … pixel is left out.
    let picture = |(stamp_ns, image): &(u64, Image)| {
        let (width, height, rgb) = thinned((image.width, image.height), &image.rgb, WIDEST);
        Picture { label: format!("after {:.1} s", gathered.seconds_at(*stamp_ns)), width, height, rgb }
    };
    found.pictures = images.iter().map(picture).collect();
    Ok(found)
}

fn image(schema: &str, data: &[u8]) -> Result<Image, String> {
    let text = |error: &dyn std::fmt::Display| error.to_string();
    if schema == msg::Image::TYPE {
        raw(&cdr::decode(data).map_err(|e| text(&e))?).map_err(|e| text(&e))
    } else {
        compressed(&cdr::decode(data).map_err(|e| text(&e))?).map_err(|e| text(&e))
    }
}
