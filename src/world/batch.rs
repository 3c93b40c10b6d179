//! Who renders many views at once: each processor core one view after the other, or a graphics processor all of them.

use std::sync::{Arc, Mutex, OnceLock};
use std::time::{Duration, Instant};

use super::Camera;
use super::eye::{Viewpoint, on_all_threads};
use super::views::Views;
use crate::gpu::{Choice, Gpu, GpuError};
use crate::lock::lock;
use crate::scenario::Renderer;
use crate::vision::Image;

/// Fewer views than this are not worth a device's while, unless a scenario asks for it.
const FEWEST: usize = 64;

/// Views that are rendered both ways, to see which is faster.
const TRIED: usize = 256;

/// The choice between the two renderers, made once.
pub struct Batch {
    setting: Renderer,
    chosen: OnceLock<Chosen>,
}

struct Chosen {
    by: Mutex<Choice>,
    gpu: Option<Arc<Gpu>>,
    /// By the number of the camera, made when they are needed; none after a failure.
    views: Mutex<Vec<Option<Views>>>,
}

impl std::fmt::Debug for Batch {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "Batch({:?})", self.by())
    }
}

impl Batch {
    pub fn new(setting: Renderer) -> Self {
        Batch { setting, chosen: OnceLock::new() }
    }

    /// Choose a device, whatever the scenario says.
    pub fn on(gpu: Arc<Gpu>) -> Self {
        let batch = Batch::new(Renderer::Gpu);
        batch.chosen.get_or_init(|| Chosen::gpu(gpu, "it was asked for".into()));
        batch
    }

    /// Whether the scenario asks for a device.
    pub fn asks_for_device(&self) -> bool {
        self.setting == Renderer::Gpu
    }

    /// Open the device that a scenario asks for. What was chosen; `None` if nothing is chosen before there are views.
    pub fn prepare(&self) -> Option<Choice> {
        if self.setting == Renderer::Gpu {
            self.chosen.get_or_init(|| match Gpu::shared() {
                Ok(gpu) => Chosen::gpu(gpu, "the scenario asks for it".into()),
                Err(error) => Chosen::cpu(error.to_string()),
            });
        }
        self.by()
    }

    /// What was chosen; `None` as long as nothing was.
    pub fn by(&self) -> Option<Choice> {
        let chosen = self.chosen.get()?;
        Some(lock(&chosen.by).clone())
    }

    /// Whether a device may be the better choice for so many views, as far as that is known.
    pub fn considers(&self, views: usize) -> bool {
        let enough = match self.setting {
            Renderer::Cpu => false,
            Renderer::Auto => views >= FEWEST,
            Renderer::Gpu => true,
        };
        enough && self.by().is_none_or(|by| by.is_device())
    }

    /// Render views by the device, if there is one and it is the better choice; whether it did.
    pub fn render(&self, number: usize, camera: &Arc<Camera>, eyes: &[Viewpoint<'_>], images: &mut [Image]) -> bool {
        if !self.considers(eyes.len()) {
            return false;
        }
        self.prepare();
        let chosen = self.chosen.get_or_init(|| choose(camera, eyes));
        let Some(gpu) = &chosen.gpu else { return false };
        let mut views = lock(&chosen.views);
        if self.by().is_some_and(|by| !by.is_device()) {
            return false;
        }
        let done = render(gpu, &mut views, number, camera, eyes, images);
        if let Err(error) = &done {
            views.clear();
            lock(&chosen.by).failed = Some(error.to_string());
        }
        done.is_ok()
    }
}

/// The faster one for these views.
fn choose(camera: &Arc<Camera>, eyes: &[Viewpoint<'_>]) -> Chosen {
    let gpu = match Gpu::shared_if_likely() {
        Ok(gpu) => gpu,
        Err(error) => return Chosen::cpu(error.to_string()),
    };
    let eyes = &eyes[..eyes.len().min(TRIED)];
    match compare(&gpu, camera, eyes) {
        Ok((by_cpu, by_gpu)) => {
            let rate = |time: Duration| format!("{:.0} views/s", eyes.len() as f64 / time.as_secs_f64());
            let why = format!("{} on {}, {} on the processor", rate(by_gpu), gpu.name(), rate(by_cpu));
            if by_gpu < by_cpu { Chosen::gpu(gpu, why) } else { Chosen::cpu(why) }
        }
        Err(error) => Chosen::cpu(error.to_string()),
    }
}

impl Chosen {
    fn cpu(why: String) -> Self {
        Chosen { by: Mutex::new(Choice::processor(why)), gpu: None, views: Mutex::default() }
    }

    fn gpu(gpu: Arc<Gpu>, why: String) -> Self {
        Chosen { by: Mutex::new(Choice::device(&gpu, why)), gpu: Some(gpu), views: Mutex::default() }
    }
}

fn render(
    gpu: &Arc<Gpu>,
    views: &mut Vec<Option<Views>>,
    number: usize,
    camera: &Arc<Camera>,
    eyes: &[Viewpoint<'_>],
    images: &mut [Image],
) -> Result<(), GpuError> {
    if views.len() <= number {
        views.resize_with(number + 1, || None);
    }
    // The world rarely goes back to earlier looks.
    views.iter_mut().enumerate().filter(|(i, _)| *i != number).for_each(|(_, other)| {
        other.iter_mut().for_each(Views::rest);
    });
    let of_camera = match &mut views[number] {
        Some(views) => views,
        none => none.insert(Views::new(gpu.clone(), camera.clone())?),
    };
    of_camera.render(eyes, images)
}

/// Times that the same views take on the processor and on the device.
fn compare(gpu: &Arc<Gpu>, camera: &Arc<Camera>, eyes: &[Viewpoint<'_>]) -> Result<(Duration, Duration), GpuError> {
    let mut images = vec![Image::default(); eyes.len()];
    let mut views = Views::new(gpu.clone(), camera.clone())?;
    // The first time, memory is taken, and drivers compile.
    let mut by_gpu = Duration::MAX;
    for _ in 0..3 {
        let begin = Instant::now();
        views.render(eyes, &mut images)?;
        by_gpu = by_gpu.min(begin.elapsed());
    }
    let mut by_cpu = Duration::MAX;
    for _ in 0..2 {
        let begin = Instant::now();
        on_all_threads(&mut images, |i, image| camera.render_among(eyes[i].distractors, eyes[i].pose, image));
        by_cpu = by_cpu.min(begin.elapsed());
    }
    Ok((by_cpu, by_gpu))
}
