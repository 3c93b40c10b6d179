//! Many views at once, rendered by a graphics processor.
//!
//! The pictures are those of [`Camera::render`](super::Camera::render), but for pixels whose ray passes so close to an edge, or to
//! the border between two texels, that single precision decides otherwise. Rays are followed one by one in a compute shader, not
//! drawn as triangles: worlds have few surfaces, and cards that are made for computing have few units that draw. Views are rendered
//! in parts, with memory for two in turn, so that one is rendered while the other is read.

mod scene;

use std::sync::Arc;
use std::sync::mpsc;

use bytemuck::cast_slice;
use wgpu::{
    BindGroup, Buffer, BufferUsages, CommandEncoderDescriptor, ComputePassDescriptor, ComputePipeline, DownlevelFlags,
    PollType, SubmissionIndex,
};

use self::scene::{Scene, Words};
use super::Camera;
use super::eye::{Viewpoint, on_all_threads};
use crate::gpu::{Gpu, GpuError};
use crate::vision::Image;

/// Pixels rendered at once, at most: 50 MB of colours, for each of two parts here and on the device.
const MOST_PIXELS: u64 = 1 << 24;

/// Parts into which many views are cut: the more, the less there is to read at the end while nothing is rendered.
const PARTS: usize = 4;

/// Fewer views are not worth being rendered in parts.
const FEWEST_AT_ONCE: usize = 32;

/// Threads of a group, each of which finds the colours of [`FOUR`] pixels, see `views.wgsl`.
const THREADS: usize = 128;
const FOUR: usize = 4;

/// The renderer of a camera's views.
pub struct Views {
    gpu: Arc<Gpu>,
    camera: Arc<Camera>,
    scene: Scene,
    pipeline: ComputePipeline,
    words: Buffer,
    texels: Buffer,
    room: Option<Room>,
}

/// Room for some views.
struct Room {
    capacity: usize,
    /// Views of a part: no more than there is room for.
    at_once: usize,
    distractors: usize,
    pair: [Part; 2],
}

/// Room for the views of a part.
struct Part {
    words: Buffer,
    results: Buffer,
    group: BindGroup,
    /// What was rendered, to be read.
    out: Buffer,
}

/// Views that are being rendered.
struct Pending {
    part: usize,
    first: usize,
    count: usize,
    submission: SubmissionIndex,
    mapped: mpsc::Receiver<Result<(), wgpu::BufferAsyncError>>,
}

impl Views {
    /// The renderer of a camera's views on a device.
    ///
    /// # Errors
    /// A world that the device has no room for, and what the driver refuses.
    pub fn new(gpu: Arc<Gpu>, camera: Arc<Camera>) -> Result<Self, GpuError> {
        let (device, scene) = (gpu.device(), Scene::new(&camera));
        let limits = device.limits();
        gpu.need("compute shaders", DownlevelFlags::COMPUTE_SHADERS)?;
        gpu.allow("buffers of a shader", 4, limits.max_storage_buffers_per_shader_stage.into())?;
        gpu.allow("threads of a group", THREADS as u64, limits.max_compute_invocations_per_workgroup.into())?;
        let texels: &[u8] = cast_slice(&scene.texels);
        gpu.allow("bytes of textures", texels.len() as u64, gpu.largest_buffer())?;
        let make = || {
            let module = device.create_shader_module(wgpu::include_wgsl!("views.wgsl"));
            let pipeline = device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
                label: Some("views"),
                layout: None,
                module: &module,
                entry_point: Some("draw"),
                compilation_options: Default::default(),
                cache: None,
            });
            let words = filled(&gpu, "scene", BufferUsages::STORAGE, cast_slice(&scene.words));
            Ok((pipeline, words, filled(&gpu, "texels", BufferUsages::STORAGE, texels)))
        };
        let (pipeline, words, texels) = gpu.within(make)?;
        Ok(Views { gpu, camera, scene, pipeline, words, texels, room: None })
    }

    /// Render views, each in place of what its image held.
    ///
    /// # Errors
    /// A device that has failed, or has no room for one view. What the images hold then is not to be used.
    ///
    /// # Panics
    /// If there are not as many images as views, or not as many distractors in each view.
    pub fn render(&mut self, eyes: &[Viewpoint<'_>], images: &mut [Image]) -> Result<(), GpuError> {
        assert_eq!(eyes.len(), images.len(), "an image for each view");
        let Some(first) = eyes.first() else { return Ok(()) };
        let distractors = first.distractors.len();
        assert!(eyes.iter().all(|eye| eye.distractors.len() == distractors), "as many distractors in each view");
        let gpu = self.gpu.clone();
        // Nothing is begun without it.
        let room = gpu.within(|| self.room_for(eyes.len(), distractors))?;
        gpu.within(|| self.render_parts(&room, eyes, images))?;
        self.room = Some(room);
        Ok(())
    }

    fn render_parts(&self, room: &Room, eyes: &[Viewpoint<'_>], images: &mut [Image]) -> Result<(), GpuError> {
        let mut pending: Option<Pending> = None;
        for (number, part) in eyes.chunks(room.at_once).enumerate() {
            let next = self.draw(room, number, part);
            if let Some(drawn) = pending.replace(next) {
                self.read(room, drawn, images)?;
            }
        }
        pending.map_or(Ok(()), |drawn| self.read(room, drawn, images))
    }

    /// Give back the memory for views, until there is something to render again.
    pub fn rest(&mut self) {
        self.room = None;
    }

    /// Fours of pixels of a view; each is three words of results.
    fn fours(&self) -> usize {
        self.camera.pixels().div_ceil(FOUR)
    }

    /// Bytes of results of a view.
    fn view_bytes(&self) -> usize {
        3 * FOUR * self.fours()
    }

    /// Room for so many views, or as many as can be rendered at once.
    fn room_for(&mut self, views: usize, distractors: usize) -> Result<Room, GpuError> {
        let limits = self.gpu.device().limits();
        let (of_view, of_words) = (self.view_bytes() as u64, 16 * Scene::view_words(distractors) as u64);
        let groups = self.fours().div_ceil(THREADS) as u64;
        self.gpu.allow("bytes of a view", of_view, self.gpu.largest_buffer())?;
        self.gpu.allow("groups of threads", groups, limits.max_compute_workgroups_per_dimension.into())?;
        let of_buffers = self.gpu.largest_buffer() / of_view.max(of_words);
        let most = (3 * MOST_PIXELS / of_view).min(of_buffers).min(limits.max_compute_workgroups_per_dimension.into());
        let capacity = views.div_ceil(PARTS).next_power_of_two().max(FEWEST_AT_ONCE).min(most.max(1) as usize);
        match self.room.take() {
            Some(there) if there.capacity >= capacity && there.distractors == distractors => {
                Ok(Room { at_once: capacity, ..there })
            }
            smaller => {
                drop(smaller);
                Ok(self.make_room(capacity, distractors))
            }
        }
    }

    fn make_room(&self, capacity: usize, distractors: usize) -> Room {
        let device = self.gpu.device();
        let common = filled(&self.gpu, "common", BufferUsages::UNIFORM, cast_slice(&self.common(distractors)));
        let room = |label, size, usage| {
            device.create_buffer(&wgpu::BufferDescriptor { label: Some(label), size, usage, mapped_at_creation: false })
        };
        let part = |_| {
            let of_words = 16 * (capacity * Scene::view_words(distractors)) as u64;
            let of_results = (capacity * self.view_bytes()) as u64;
            let words = room("eyes", of_words, BufferUsages::STORAGE | BufferUsages::COPY_DST);
            let results = room("views", of_results, BufferUsages::STORAGE | BufferUsages::COPY_SRC);
            let bound = [&common, &self.words, &self.texels, &words, &results];
            let entry = |binding: usize| wgpu::BindGroupEntry {
                binding: binding as u32,
                resource: bound[binding].as_entire_binding(),
            };
            let group = device.create_bind_group(&wgpu::BindGroupDescriptor {
                label: Some("views"),
                layout: &self.pipeline.get_bind_group_layout(0),
                entries: &[0, 1, 2, 3, 4].map(entry),
            });
            let out = room("drawn", of_results, BufferUsages::MAP_READ | BufferUsages::COPY_DST);
            Part { words, results, group, out }
        };
        Room { capacity, at_once: capacity, distractors, pair: [0, 1].map(part) }
    }

    /// The uniform `Common` of the shader.
    fn common(&self, distractors: usize) -> Vec<u32> {
        let (camera, scene) = (&self.camera, &self.scene);
        let [panels, pyramids] = scene.counts;
        let mut words = vec![camera.columns.len() as u32, camera.height as u32, self.fours() as u32];
        words.extend([panels, pyramids, distractors as u32, camera.horizon as u32]);
        words.extend(scene.begins);
        words.push(Scene::view_words(distractors) as u32);
        let numbers = [
            camera.slope,
            camera.fall,
            camera.settings.mount_height,
            camera.surroundings.periods(0),
            camera.surroundings.periods(1),
            camera.floor.periods(0),
            camera.floor.periods(1),
        ];
        words.extend(numbers.map(|number| (number as f32).to_bits()));
        // Uniforms are rows of four words.
        words.resize(words.len().next_multiple_of(4), 0);
        words
    }

    /// Have some views rendered.
    fn draw(&self, room: &Room, number: usize, eyes: &[Viewpoint<'_>]) -> Pending {
        let (device, queue) = (self.gpu.device(), self.gpu.queue());
        let part = &room.pair[number % 2];
        let mut words = Words::with_capacity(eyes.len() * Scene::view_words(room.distractors));
        eyes.iter().for_each(|eye| self.scene.view(&self.camera, eye.pose, eye.distractors, &mut words));
        queue.write_buffer(&part.words, 0, cast_slice(&words));
        let mut encoder = device.create_command_encoder(&CommandEncoderDescriptor::default());
        {
            let mut pass = encoder.begin_compute_pass(&ComputePassDescriptor::default());
            pass.set_pipeline(&self.pipeline);
            pass.set_bind_group(0, &part.group, &[]);
            pass.dispatch_workgroups(self.fours().div_ceil(THREADS) as u32, eyes.len() as u32, 1);
        }
        let bytes = (eyes.len() * self.view_bytes()) as u64;
        encoder.copy_buffer_to_buffer(&part.results, 0, &part.out, 0, bytes);
        let submission = queue.submit([encoder.finish()]);
        let (tell, mapped) = mpsc::channel();
        // Nobody listens where an earlier part has failed.
        part.out.slice(..bytes).map_async(wgpu::MapMode::Read, move |result| drop(tell.send(result)));
        Pending { part: number % 2, first: number * room.at_once, count: eyes.len(), submission, mapped }
    }

    /// Wait for views, and take them apart.
    fn read(&self, room: &Room, drawn: Pending, images: &mut [Image]) -> Result<(), GpuError> {
        let Pending { part, first, count, submission, mapped } = drawn;
        let until = PollType::Wait { submission_index: Some(submission), timeout: None };
        self.gpu.wait(until)?;
        mapped.recv().map_err(|cause| self.gpu.refused(cause))?.map_err(|cause| self.gpu.refused(cause))?;
        let (width, height) = (self.camera.columns.len(), self.camera.height);
        let (cropped, of_view, of_image) = (self.camera.crops(), self.view_bytes(), 3 * self.camera.pixels());
        let out = &room.pair[part].out;
        {
            let bytes = out.slice(..(count * of_view) as u64);
            let bytes = bytes.get_mapped_range().map_err(|cause| self.gpu.refused(cause))?;
            let bytes: &[u8] = &bytes;
            on_all_threads(&mut images[first..first + count], |view, image| {
                (image.width, image.height, image.cropped) = (width, height, cropped);
                image.rgb.clear();
                image.rgb.extend_from_slice(&bytes[view * of_view..][..of_image]);
            });
        }
        out.unmap();
        Ok(())
    }
}

/// A buffer with contents. (What wgpu has for this panics where there is no memory for it.)
fn filled(gpu: &Gpu, label: &str, usage: BufferUsages, contents: &[u8]) -> Buffer {
    let (size, usage) = (contents.len() as u64, usage | BufferUsages::COPY_DST);
    let description = wgpu::BufferDescriptor { label: Some(label), size, usage, mapped_at_creation: false };
    let buffer = gpu.device().create_buffer(&description);
    gpu.queue().write_buffer(&buffer, 0, contents);
    buffer
}
