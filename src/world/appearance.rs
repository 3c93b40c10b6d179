//! How the world looks at a moment, where that changes during the run.

use std::sync::Arc;

use rayon::prelude::*;

use super::Camera;
use super::batch::Batch;
use super::distractors::{Distractor, Present};
use super::eye::{Eye, Viewpoint};
use crate::gpu::{Choice, Gpu};
use crate::robot::Pose;
use crate::scenario::{ChangeKind, Scenario};
use crate::vision::Image;

/// Pixels that a device is asked for at once, at most: 50 MB of pictures.
const MOST_PIXELS: usize = 1 << 24;

/// The looks of a scenario's world from its first frame to its last.
#[derive(Debug)]
pub struct Appearance {
    /// Walls as they look from a frame on, in order; the first from frame 0.
    cameras: Vec<(u64, Arc<Camera>)>,
    /// First frame, last frame, brightness at the end of it, in order.
    light: Vec<(u64, u64, f64)>,
    /// First and last frame of which the camera gives the picture before.
    frozen: Vec<(u64, u64)>,
    /// First and last frame that are lost.
    lost: Vec<(u64, u64)>,
    distractors: Vec<Distractor>,
    frame_seconds: f64,
    batch: Batch,
}

impl Appearance {
    /// The looks of a checked scenario.
    ///
    /// # Errors
    /// A texture file that cannot be read any more.
    pub fn new(scenario: &Scenario) -> Result<Self, ::image::ImageError> {
        let mut appearance = Appearance {
            cameras: vec![(0, Arc::new(Camera::new(scenario)?))],
            light: Vec::new(),
            frozen: Vec::new(),
            lost: Vec::new(),
            distractors: scenario.world.distractors.iter().map(Distractor::new).collect(),
            frame_seconds: scenario.robot.frame_seconds(),
            batch: Batch::new(scenario.world.renderer),
        };
        let mut changes: Vec<_> = scenario.changes.iter().collect();
        changes.sort_by_key(|change| change.action);
        let per_action = scenario.robot.frames_per_action as u64;
        let mut present = scenario.clone();
        for change in changes {
            let first = change.first_frame(&scenario.robot);
            match &change.what {
                ChangeKind::Light { factor, over } => {
                    appearance.light.push((first, first + *over as u64 * per_action, *factor))
                }
                ChangeKind::Texture { wall, texture } => {
                    present.world.walls[*wall].texture = texture.clone();
                    appearance.cameras.push((first, Arc::new(Camera::new(&present)?)));
                }
                // Nothing that one sees.
                ChangeKind::Goal { .. } => {}
                ChangeKind::Freeze { frames } => appearance.frozen.push((first, first + *frames as u64 - 1)),
                ChangeKind::Lose { frames } => appearance.lost.push((first, first + *frames as u64 - 1)),
            }
        }
        Ok(appearance)
    }

    /// The same, with all pictures by a device, whatever the scenario says.
    pub fn on(self, gpu: Arc<Gpu>) -> Self {
        Appearance { batch: Batch::on(gpu), ..self }
    }

    /// The walls as they look at a frame.
    pub fn camera(&self, frame: u64) -> &Camera {
        &self.cameras[self.camera_number(frame)].1
    }

    fn camera_number(&self, frame: u64) -> usize {
        // The first one is from frame 0.
        self.cameras.partition_point(|(first, _)| *first <= frame) - 1
    }

    /// What the camera sees from a pose at a frame, without sensor errors.
    pub fn render(&self, pose: &Pose, frame: u64) -> Image {
        let mut image = Image::default();
        self.render_into(&Eye::from((*pose, 0)), frame, &mut image);
        image
    }

    /// The same from an eye, in place of what an image held.
    pub fn render_into(&self, eye: &Eye, frame: u64, image: &mut Image) {
        let by_device = self.batch.asks_for_device()
            && self.render_by_device(frame, std::slice::from_ref(eye), std::slice::from_mut(image));
        if !by_device {
            self.camera(frame).render_among(&self.present(frame, eye), &eye.pose, image);
        }
    }

    /// Do something with what the camera sees at a frame from the place of each item. The views
    /// are rendered by a device, if there is one that is the better choice for so many; the rest is done on all threads.
    pub fn see_all<T: Send, R: Send, E: Into<Eye>>(
        &self,
        frame: u64,
        items: &mut [T],
        place: impl Fn(&T) -> E + Sync,
        work: impl Fn(&mut T, &mut Image) -> R + Sync,
    ) -> Vec<R> {
        let look = |item: &mut T, image: &mut Image| {
            self.render_into(&place(item).into(), frame, image);
            work(item, image)
        };
        if !self.batch.considers(items.len()) {
            return items.par_iter_mut().map_init(Image::default, |image, item| look(item, image)).collect();
        }
        let (mut results, mut images) = (Vec::with_capacity(items.len()), Vec::new());
        let camera = self.camera(frame);
        for part in items.chunks_mut((MOST_PIXELS / camera.pixels()).max(1)) {
            let eyes: Vec<Eye> = part.iter().map(|item| place(item).into()).collect();
            images.resize_with(part.len(), Image::default);
            let done = self.render_by_device(frame, &eyes, &mut images);
            let pairs = part.par_iter_mut().zip(&mut images);
            results.par_extend(pairs.map(|(item, image)| if done { work(item, image) } else { look(item, image) }));
        }
        results
    }

    /// Have a device render what is seen from many poses at a frame, if it is the better choice for so many: whether it did.
    ///
    /// # Panics
    /// If there are not as many images as eyes.
    pub fn render_by_device(&self, frame: u64, eyes: &[Eye], images: &mut [Image]) -> bool {
        if !self.batch.considers(eyes.len()) {
            return false;
        }
        let distractors: Vec<Vec<Present>> = eyes.iter().map(|eye| self.present(frame, eye)).collect();
        let seen = |(eye, distractors)| -> Viewpoint<'_> {
            let (eye, distractors): (&Eye, &Vec<Present>) = (eye, distractors);
            Viewpoint { pose: &eye.pose, distractors }
        };
        let views: Vec<Viewpoint<'_>> = eyes.iter().zip(&distractors).map(seen).collect();
        let number = self.camera_number(frame);
        self.batch.render(number, &self.cameras[number].1, &views, images)
    }

    /// Open the device that the scenario asks for, if it does: a warning where there is none.
    pub fn prepare(&self) -> Option<String> {
        self.batch.prepare();
        self.missing_device()
    }

    /// A warning where a device has failed, or a scenario asks for one and the processor renders.
    pub fn missing_device(&self) -> Option<String> {
        let by = self.batch.by()?;
        match by.failed {
            Some(failed) => Some(format!("images: {failed}; the processor went on")),
            None if self.batch.asks_for_device() && by.gpu.is_none() => {
                Some(format!("world.renderer is \"gpu\", and the processor renders: {}", by.why))
            }
            None => None,
        }
    }

    /// Who renders many views at once; `None` as long as there were none.
    pub fn rendered_by(&self) -> Option<Choice> {
        self.batch.by()
    }

    fn present(&self, frame: u64, eye: &Eye) -> Vec<Present> {
        let seconds = frame.saturating_add(eye.later) as f64 * self.frame_seconds;
        let distractors = self.distractors.iter().map(|distractor| distractor.at(seconds));
        distractors.chain(eye.things.iter().copied()).collect()
    }

    /// Brightness at a frame, as a share of that at frame 0.
    pub fn light(&self, frame: u64) -> f64 {
        let mut now = 1.0;
        for &(first, last, factor) in self.light.iter().take_while(|change| change.0 <= frame) {
            let done = if frame >= last { 1.0 } else { (frame - first) as f64 / (last - first) as f64 };
            now += (factor - now) * done;
        }
        now
    }

    /// Whether the camera gives the picture before once more.
    pub fn is_frozen(&self, frame: u64) -> bool {
        self.frozen.iter().any(|&(first, last)| (first..=last).contains(&frame))
    }

    /// Whether the frame is lost, unless it is the last one of its action.
    pub fn is_lost(&self, frame: u64) -> bool {
        self.lost.iter().any(|&(first, last)| (first..=last).contains(&frame))
    }
}
