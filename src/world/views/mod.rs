//! Many views at once, rendered by a graphics processor.
//!
//! The pictures are those of [`Camera::render`](super::Camera::render), but for pixels whose ray passes so close to an edge, or to
//! the border between two texels, that single precision decides otherwise. Views are tiles of one large picture, drawn in one
//! pass. There are two such pictures in turn, so that one is drawn while the other is read.

mod scene;

use std::sync::Arc;
use std::sync::mpsc;

use bytemuck::cast_slice;
use wgpu::util::{BufferInitDescriptor, DeviceExt};
use wgpu::{
    BindGroup, BindGroupLayout, Buffer, BufferUsages, Color, CommandEncoderDescriptor, DownlevelFlags, Extent3d,
    LoadOp, Operations, PollType, RenderPipeline, StoreOp, SubmissionIndex, Texture, TextureFormat, TextureUsages,
    TextureView,
};

use self::scene::{Scene, Words};
use super::distractors::Present;
use super::{Camera, Image, Pose};
use crate::gpu::{Gpu, GpuError};

/// Pixels drawn at once, at most: 134 MB of colours, for each of two pictures here and on the device, and as much of depths.
const MOST_PIXELS: usize = 1 << 25;

/// Fewer views are not worth being drawn in two parts.
const FEWEST_AT_ONCE: usize = 32;

/// Rows of a picture that is copied begin at multiples of this, bytes.
const ROW_BYTES: usize = wgpu::COPY_BYTES_PER_ROW_ALIGNMENT as usize;

const COLOUR: TextureFormat = TextureFormat::Rgba8Unorm;
const DEPTH: TextureFormat = TextureFormat::Depth32Float;

/// What is seen from where.
pub struct Eye<'a> {
    /// Of the robot.
    pub pose: &'a Pose,
    /// Distractors as they are then: as many for each view.
    pub distractors: &'a [Present],
}

/// The renderer of a camera's views.
pub struct Views {
    gpu: Arc<Gpu>,
    camera: Arc<Camera>,
    scene: Scene,
    pipeline: RenderPipeline,
    layout: BindGroupLayout,
    words: Buffer,
    texels: Buffer,
    pictures: Option<Pictures>,
}

/// Room for some views.
struct Pictures {
    capacity: usize,
    distractors: usize,
    /// Tiles side by side.
    across: usize,
    /// Pixels of a row of the picture.
    width: usize,
    depth: TextureView,
    pair: [Picture; 2],
}

struct Picture {
    colours: Texture,
    view: TextureView,
    words: Buffer,
    group: BindGroup,
    /// What was drawn, to be read.
    drawn: Buffer,
}

/// Views that are being drawn.
struct Pending {
    picture: usize,
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
        let texels: &[u8] = cast_slice(&scene.texels);
        gpu.allow("bytes of textures", texels.len() as u64, gpu.largest_buffer())?;
        gpu.need("buffers of corners", DownlevelFlags::VERTEX_STORAGE)?;
        gpu.allow("buffers of a shader", 3, limits.max_storage_buffers_per_shader_stage.into())?;
        let size = camera.columns.len().max(camera.height) as u64;
        gpu.allow("pixels of a view's side", size, limits.max_texture_dimension_2d.into())?;
        let buffer = |label, contents: &[u8]| {
            let usage = BufferUsages::STORAGE;
            device.create_buffer_init(&BufferInitDescriptor { label: Some(label), contents, usage })
        };
        let (words, texels) = (buffer("scene", cast_slice(&scene.words)), buffer("texels", texels));
        let module = device.create_shader_module(wgpu::include_wgsl!("views.wgsl"));
        let pipeline = device.create_render_pipeline(&wgpu::RenderPipelineDescriptor {
            label: Some("views"),
            layout: None,
            vertex: wgpu::VertexState {
                module: &module,
                entry_point: Some("place_corner"),
                compilation_options: Default::default(),
                buffers: &[],
            },
            primitive: wgpu::PrimitiveState { topology: wgpu::PrimitiveTopology::TriangleStrip, ..Default::default() },
            depth_stencil: Some(wgpu::DepthStencilState {
                format: DEPTH,
                depth_write_enabled: Some(true),
                // Of two things at the same depth the first one stays, as in the other renderer.
                depth_compare: Some(wgpu::CompareFunction::Greater),
                stencil: Default::default(),
                bias: Default::default(),
            }),
            multisample: Default::default(),
            fragment: Some(wgpu::FragmentState {
                module: &module,
                entry_point: Some("paint"),
                compilation_options: Default::default(),
                targets: &[Some(COLOUR.into())],
            }),
            multiview_mask: None,
            cache: None,
        });
        let layout = pipeline.get_bind_group_layout(0);
        gpu.check()?;
        Ok(Views { gpu, camera, scene, pipeline, layout, words, texels, pictures: None })
    }

    /// Render views, each in place of what its image held.
    ///
    /// # Errors
    /// A device that has failed, or has no room for one view. What the images hold then is not to be used.
    ///
    /// # Panics
    /// If there are not as many images as views, or not as many distractors in each view.
    pub fn render(&mut self, eyes: &[Eye<'_>], images: &mut [Image]) -> Result<(), GpuError> {
        assert_eq!(eyes.len(), images.len(), "an image for each view");
        self.gpu.check()?;
        let Some(first) = eyes.first() else { return Ok(()) };
        let distractors = first.distractors.len();
        assert!(eyes.iter().all(|eye| eye.distractors.len() == distractors), "as many distractors in each view");
        let pictures = self.room_for(eyes.len(), distractors)?;
        let mut pending: Option<Pending> = None;
        for (number, part) in eyes.chunks(pictures.capacity).enumerate() {
            let next = self.draw(&pictures, number, part);
            if let Some(drawn) = pending.replace(next) {
                self.read(&pictures, drawn, images)?;
            }
        }
        if let Some(drawn) = pending {
            self.read(&pictures, drawn, images)?;
        }
        self.pictures = Some(pictures);
        self.gpu.check()
    }

    /// Give back the memory of the pictures, until there is something to render again.
    pub fn rest(&mut self) {
        self.pictures = None;
    }

    /// Pictures with room for so many views, or as many as can be drawn at once.
    fn room_for(&mut self, views: usize, distractors: usize) -> Result<Pictures, GpuError> {
        let (width, height) = (self.camera.columns.len(), self.camera.height);
        let limits = self.gpu.device().limits();
        let side = limits.max_texture_dimension_2d as usize;
        let stride = 16 * Scene::view_words(distractors) as u64;
        let of_words = self.gpu.largest_buffer() / stride;
        let of_bytes = limits.max_buffer_size / 4;
        let pixels = (MOST_PIXELS as u64).min(of_bytes) as usize;
        let most = (pixels / (width * height)).min((side / width) * (side / height)).min(of_words as usize).max(1);
        // Two parts at least, so that one is read while the other is drawn.
        let capacity = views.div_ceil(2).next_power_of_two().max(FEWEST_AT_ONCE).min(most);
        match self.pictures.take() {
            Some(there) if there.capacity >= capacity && there.distractors == distractors => Ok(there),
            smaller => {
                drop(smaller);
                self.make_room(capacity, distractors, side)
            }
        }
    }

    fn make_room(&self, capacity: usize, distractors: usize, side: usize) -> Result<Pictures, GpuError> {
        let device = self.gpu.device();
        let (tile_width, tile_height) = (self.camera.columns.len(), self.camera.height);
        // As square as it gets: no more than a side of either direction.
        let across = (capacity as f64).sqrt().ceil() as usize;
        let across = across.max(capacity.div_ceil(side / tile_height)).min(side / tile_width);
        let width = (across * tile_width).next_multiple_of(ROW_BYTES / 4);
        let height = capacity.div_ceil(across) * tile_height;
        self.gpu.allow("pixels of a row of views", width as u64, side as u64)?;
        let common = self.common(distractors, across, [width, height]);
        let common = device.create_buffer_init(&BufferInitDescriptor {
            label: Some("common"),
            contents: cast_slice(&common),
            usage: BufferUsages::UNIFORM,
        });
        let texture = |label, format, usage| {
            device.create_texture(&wgpu::TextureDescriptor {
                label: Some(label),
                size: extent(width, height),
                mip_level_count: 1,
                sample_count: 1,
                dimension: wgpu::TextureDimension::D2,
                format,
                usage,
                view_formats: &[],
            })
        };
        let room = |label, size, usage| {
            device.create_buffer(&wgpu::BufferDescriptor { label: Some(label), size, usage, mapped_at_creation: false })
        };
        let picture = |_| {
            let colours = texture("views", COLOUR, TextureUsages::RENDER_ATTACHMENT | TextureUsages::COPY_SRC);
            let size = 16 * (capacity * Scene::view_words(distractors)) as u64;
            let words = room("eyes", size, BufferUsages::STORAGE | BufferUsages::COPY_DST);
            let bound = [&common, &self.words, &self.texels, &words];
            let entry = |binding: usize| wgpu::BindGroupEntry {
                binding: binding as u32,
                resource: bound[binding].as_entire_binding(),
            };
            let group = device.create_bind_group(&wgpu::BindGroupDescriptor {
                label: Some("views"),
                layout: &self.layout,
                entries: &[0, 1, 2, 3].map(entry),
            });
            let drawn = room("drawn", 4 * (width * height) as u64, BufferUsages::MAP_READ | BufferUsages::COPY_DST);
            Picture { view: colours.create_view(&Default::default()), colours, words, group, drawn }
        };
        let depth = texture("depth", DEPTH, TextureUsages::RENDER_ATTACHMENT).create_view(&Default::default());
        let pair = [0, 1].map(picture);
        self.gpu.check()?;
        Ok(Pictures { capacity, distractors, across, width, depth, pair })
    }

    /// The uniform `Common` of the shader.
    fn common(&self, distractors: usize, across: usize, whole: [usize; 2]) -> Vec<u32> {
        let (camera, scene) = (&self.camera, &self.scene);
        let float = |number: f64| (number as f32).to_bits();
        let [panels, pyramids] = scene.counts;
        let objects = 1 + panels + pyramids + distractors as u32;
        let columns = &camera.columns;
        // Columns are evenly spaced, and symmetric about the axis.
        let per_aside = 0.5 * (columns.len() as f64 - 1.0) / columns[columns.len() - 1].aside;
        let mut words = vec![columns.len() as u32, camera.height as u32, across as u32, objects, panels, pyramids];
        words.extend([distractors as u32, camera.horizon as u32]);
        words.extend(scene.begins);
        words.push(Scene::view_words(distractors) as u32);
        words.extend(whole.map(|pixels| float(pixels as f64)));
        let upwards = camera.surroundings.periods(1);
        let around = camera.surroundings.periods(0);
        let numbers = [
            0.5 * columns.len() as f64,
            per_aside,
            camera.slope,
            camera.fall,
            camera.settings.mount_height,
            around,
            upwards,
            camera.floor.periods(0),
            camera.floor.periods(1),
        ];
        words.extend(numbers.map(float));
        // The whole of it is a multiple of its largest part, of two words.
        words.push(0);
        words
    }

    /// Have some views drawn.
    fn draw(&self, pictures: &Pictures, number: usize, eyes: &[Eye<'_>]) -> Pending {
        let (device, queue) = (self.gpu.device(), self.gpu.queue());
        let picture = &pictures.pair[number % 2];
        let mut words = Words::with_capacity(eyes.len() * Scene::view_words(pictures.distractors));
        eyes.iter().for_each(|eye| self.scene.view(&self.camera, eye.pose, eye.distractors, &mut words));
        queue.write_buffer(&picture.words, 0, cast_slice(&words));
        let mut encoder = device.create_command_encoder(&CommandEncoderDescriptor::default());
        {
            let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
                label: Some("views"),
                color_attachments: &[Some(wgpu::RenderPassColorAttachment {
                    view: &picture.view,
                    depth_slice: None,
                    resolve_target: None,
                    ops: Operations { load: LoadOp::Clear(Color::BLACK), store: StoreOp::Store },
                })],
                depth_stencil_attachment: Some(wgpu::RenderPassDepthStencilAttachment {
                    view: &pictures.depth,
                    depth_ops: Some(Operations { load: LoadOp::Clear(0.0), store: StoreOp::Discard }),
                    stencil_ops: None,
                }),
                ..Default::default()
            });
            let [panels, pyramids] = self.scene.counts;
            let objects = 1 + panels + pyramids + pictures.distractors as u32;
            pass.set_pipeline(&self.pipeline);
            pass.set_bind_group(0, &picture.group, &[]);
            pass.draw(0..4, 0..objects * eyes.len() as u32);
        }
        let rows = eyes.len().div_ceil(pictures.across) * self.camera.height;
        let row_bytes = 4 * pictures.width;
        let layout =
            wgpu::TexelCopyBufferLayout { offset: 0, bytes_per_row: Some(row_bytes as u32), rows_per_image: None };
        encoder.copy_texture_to_buffer(
            picture.colours.as_image_copy(),
            wgpu::TexelCopyBufferInfo { buffer: &picture.drawn, layout },
            extent(pictures.width, rows),
        );
        let submission = queue.submit([encoder.finish()]);
        let (tell, mapped) = mpsc::channel();
        picture.drawn.slice(..(rows * row_bytes) as u64).map_async(wgpu::MapMode::Read, move |result| {
            // Nobody listens where an earlier part has failed.
            let _ = tell.send(result);
        });
        Pending { picture: number % 2, first: number * pictures.capacity, count: eyes.len(), submission, mapped }
    }

    /// Wait for views, and take them apart.
    fn read(&self, pictures: &Pictures, drawn: Pending, images: &mut [Image]) -> Result<(), GpuError> {
        let Pending { picture, first, count, submission, mapped } = drawn;
        let until = PollType::Wait { submission_index: Some(submission), timeout: None };
        self.gpu.wait(until)?;
        mapped.recv().map_err(|cause| self.gpu.failed(cause))?.map_err(|cause| self.gpu.failed(cause))?;
        let (width, height) = (self.camera.columns.len(), self.camera.height);
        let cropped = self.camera.crops();
        let buffer = &pictures.pair[picture].drawn;
        let rows = count.div_ceil(pictures.across) * height;
        let slice = buffer.slice(..(4 * rows * pictures.width) as u64);
        {
            let bytes = slice.get_mapped_range().map_err(|cause| self.gpu.failed(cause))?;
            let bytes: &[u8] = &bytes;
            on_all_threads(&mut images[first..first + count], |tile, image| {
                let (x, y) = (tile % pictures.across * width, tile / pictures.across * height);
                (image.width, image.height, image.cropped) = (width, height, cropped);
                image.rgb.resize(3 * width * height, 0);
                for (row, line) in image.rgb.chunks_exact_mut(3 * width).enumerate() {
                    let start = 4 * ((y + row) * pictures.width + x);
                    let (pixels, _) = line.as_chunks_mut::<3>();
                    let (seen, _) = bytes[start..start + 4 * width].as_chunks::<4>();
                    pixels.iter_mut().zip(seen).for_each(|(pixel, &[red, green, blue, _])| *pixel = [red, green, blue]);
                }
            });
        }
        buffer.unmap();
        Ok(())
    }
}

/// Do something with each item, on as many threads as there are cores, each of them with a part of its own.
///
/// Not by rayon: whoever waits there takes up other work, which may wait for the same device.
pub(super) fn on_all_threads<T: Send>(items: &mut [T], work: impl Fn(usize, &mut T) + Sync) {
    let all = |first: usize, part: &mut [T]| part.iter_mut().enumerate().for_each(|(i, item)| work(first + i, item));
    let threads = std::thread::available_parallelism().map_or(1, usize::from);
    let size = items.len().div_ceil(threads).max(FEWEST_FOR_A_THREAD);
    if items.len() <= size {
        return all(0, items);
    }
    std::thread::scope(|scope| {
        let parts = items.chunks_mut(size).enumerate();
        parts.for_each(|(number, part)| drop(scope.spawn(move || all(number * size, part))));
    });
}

/// A thread takes as long to start as this many small views take to be copied.
const FEWEST_FOR_A_THREAD: usize = 32;

fn extent(width: usize, height: usize) -> Extent3d {
    Extent3d { width: width as u32, height: height as u32, depth_or_array_layers: 1 }
}
