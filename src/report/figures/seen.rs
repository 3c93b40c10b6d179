//! What the camera saw, before and after preparation.

use super::{Figure, Item, Material, Section, file_name};
use crate::report::Numbered;
use crate::report::draw::{DrawError, Picture, gallery};
use crate::report::gather::{Marked, Sample};
use crate::vision::Image;

/// Frames that are shown.
const SHOWN: usize = 4;

pub fn section(material: &Material<'_>) -> Result<Section, DrawError> {
    let mut items = Vec::new();
    if !material.pictures.is_empty() {
        let title = "Camera images";
        let svg = gallery(title, 2, material.pictures)?;
        items.push(Item::Figure(Figure::new("camera", title, "As another program recorded them.", svg)));
    }
    for (number, (task, marked)) in material.gathered.marked.iter().enumerate() {
        let picture = |marked: &Marked| {
            let Marked { frame, width, height, rgb } = marked.clone();
            Picture { label: format!("frame {}", Numbered(frame)), width: width as usize, height: height as usize, rgb }
        };
        let pictures: Vec<Picture> =
            marked.iter().filter(|of| of.rgb.len() == 3 * (of.width * of.height) as usize).map(picture).collect();
        let title = format!("What was shown of {task}");
        let caption = "Observations that somebody marked while the robot was there; an even selection of all.";
        let svg = gallery(&title, 4, &pictures)?;
        items.push(Item::Figure(Figure::new(file_name("marked", number, task), &title, caption, svg)));
    }
    let samples: Vec<&Sample> = match material.room {
        Some(room) => {
            let size = room.scenario.vision.values();
            material.gathered.samples.iter().filter(|sample| sample.pixels.len() == size).collect()
        }
        None => Vec::new(),
    };
    let width = material.room.map_or(1, |room| room.scenario.vision.width);
    // Of each part of the run the frame that shows most.
    let parts = samples.chunks(samples.len().div_ceil(SHOWN).max(1));
    let chosen: Vec<&Sample> =
        parts.filter_map(|part| part.iter().copied().max_by_key(|sample| edges(&sample.pixels, width))).collect();
    match (material.room, chosen.is_empty()) {
        (Some(room), false) => {
            let vision = &room.scenario.vision;
            let after = |sample: &&Sample| Picture {
                label: format!("frame {}, as learned from", Numbered(sample.frame)),
                width: vision.width,
                height: vision.height,
                rgb: sample.pixels.clone(),
            };
            let before = |sample: &&Sample| {
                let Image { width, height, rgb, .. } = room.world.appearance.render(&sample.pose, sample.frame);
                Picture { label: format!("frame {}, camera", Numbered(sample.frame)), width, height, rgb }
            };
            let mut pictures = Vec::new();
            for pair in chosen.chunks(2) {
                if material.simulated {
                    pictures.extend(pair.iter().map(before));
                }
                pictures.extend(pair.iter().map(after));
            }
            let title = "Camera frames before and after preparation";
            let size = format!("{} × {} pixels", vision.width, vision.height);
            let caption = if material.simulated {
                format!(
                    "After: the observations of {size} in the log. Before: rendered again from the poses in the log, without the \
                     camera's noise, since the log keeps no camera images. Of each quarter of the run the frame with the most \
                     edges."
                )
            } else {
                format!("After preparation, {size}. The log keeps no camera images from before.")
            };
            items.push(Item::Figure(Figure::new("preparation", title, caption, gallery(title, 2, &pictures)?)));
        }
        (_, true) if items.is_empty() => items.push(Item::Missing(
            "There are no camera frames to show: the log holds no observations with poses.".to_owned(),
        )),
        _ => {}
    }
    Ok(Section { name: "seen", heading: "What it sees", items })
}

/// How much there is to see in an image: how much the pixels of its lines differ from their neighbours.
fn edges(rgb: &[u8], width: usize) -> u64 {
    let lines = rgb.chunks_exact(3 * width.max(1));
    let steps = lines.flat_map(|line| line.iter().zip(&line[3..]).map(|(a, b)| u64::from(a.abs_diff(*b))));
    // Noise is everywhere; what counts are edges.
    steps.map(|step| step * step).sum()
}
