//! Kernel rows: products of observations with support vectors that stay on the device, and kernel values of them.

use std::fmt::Write as _;
use std::sync::{Arc, mpsc};
use std::time::Instant;

use bytemuck::cast_slice;
use faer::{Mat, MatRef};
use rayon::prelude::*;
use wgpu::{
    BindGroup, Buffer, BufferUsages, CommandEncoder, CommandEncoderDescriptor, ComputePassDescriptor, ComputePipeline,
    DownlevelFlags, PipelineCompilationOptions, PollType, SubmissionIndex,
};

use super::{Gpu, GpuError, Of};
use crate::kernel::Form;

/// A group of so many threads computes the products of so many vectors with so many observations, a step of so many values of them
/// after another. Vectors are padded to a multiple of two steps with zeros.
const THREADS: usize = 128;
const VECTORS: usize = 128;
const OBSERVATIONS: usize = 64;
const STEP: usize = 8;
/// Threads of a group lie in so many columns, of vectors, and rows, of observations.
const COLUMNS: usize = 16;
const ROWS: usize = 8;

/// The shader, with its sums written out.
fn source() -> String {
    let (mut sums, mut products, mut stores) = (String::new(), String::new(), String::new());
    // Four vectors `p`, one observation, the `r`-th of four `q`.
    let (of_vectors, of_observations) = (VECTORS / COLUMNS / 4, OBSERVATIONS / ROWS / 4);
    let all = || {
        let of_one = move |p| (0..of_observations).flat_map(move |q| (0..4).map(move |r| (p, q, r)));
        (0..of_vectors).flat_map(of_one)
    };
    for (p, q, r) in all() {
        let _ = writeln!(sums, "    var sum{p}_{q}{r} = vec4f(0.0);");
        let four = format!("first_vector / 4u + {}u + x", COLUMNS * p);
        let j = format!("first_observation + {}u + 4u * y", 4 * ROWS * q + r);
        let _ = writeln!(stores, "    store(sum{p}_{q}{r}, {four}, {j});");
    }
    for k in 0..STEP {
        for p in 0..of_vectors {
            let _ = writeln!(products, "        let s{k}_{p} = of_vectors[TURN][{k}][{}u + x];", COLUMNS * p);
        }
        for q in 0..of_observations {
            let _ = writeln!(products, "        let x{k}_{q} = of_observations[TURN][{k}][{}u + y];", ROWS * q);
        }
        for (p, q, r) in all() {
            let (sum, x) = (format!("sum{p}_{q}{r}"), format!("x{k}_{q}.{}", ["x", "y", "z", "w"][r]));
            let _ = writeln!(products, "        {sum} = fma(s{k}_{p}, vec4f({x}), {sum});");
        }
    }
    let body = include_str!("rows.wgsl");
    let body = body.replace("//SUMS//", &sums).replace("//PRODUCTS//", &products).replace("//STORES//", &stores);
    let parts: Vec<&str> = body.split("//TURNS//").collect();
    let [before, turn, after] = parts[..] else { unreachable!("what is written out twice stands between two marks") };
    let body = [before, &turn.replace("TURN", "0u"), &turn.replace("TURN", "1u"), after].concat();
    let sizes = [("THREADS", THREADS), ("VECTORS", VECTORS), ("OBSERVATIONS", OBSERVATIONS), ("STEP", STEP)];
    let sizes: String = sizes.iter().map(|(name, size)| format!("const {name}: u32 = {size}u;\n")).collect();
    sizes + &body
}

/// Support vectors on a device. After an error of a driver it is of no more use.
#[derive(Debug)]
pub struct Rows {
    gpu: Arc<Gpu>,
    pipeline: ComputePipeline,
    /// Values of a vector, with padding.
    padded: usize,
    /// The vectors as they are on the device, to see what is new.
    held: Arc<Mat<f32>>,
    /// Vectors for which there is room.
    room: usize,
    vectors: Buffer,
    norms: Buffer,
    blocks: [Option<Block>; 2],
    turn: usize,
}

/// Room for a block of observations and what comes of it.
#[derive(Debug)]
struct Block {
    /// Observations, and from one's results to the next one's.
    count: usize,
    stride: usize,
    sizes: Buffer,
    observations: Buffer,
    norms: Buffer,
    results: Buffer,
    out: Buffer,
    group: BindGroup,
}

/// A block that is being computed.
#[derive(Debug)]
pub struct Pending {
    block: usize,
    vectors: usize,
    observations: usize,
    submission: SubmissionIndex,
    mapped: mpsc::Receiver<Result<(), wgpu::BufferAsyncError>>,
}

impl Rows {
    /// No vectors yet; they will have `d` values.
    ///
    /// # Errors
    /// A device that has failed.
    pub fn new(gpu: Arc<Gpu>, d: usize) -> Result<Self, GpuError> {
        let device = gpu.device();
        gpu.allow("buffers of a shader", 5, device.limits().max_storage_buffers_per_shader_stage.into())?;
        let threads = device.limits().max_compute_invocations_per_workgroup;
        gpu.allow("threads of a group", THREADS as u64, threads.into())?;
        gpu.need("compute shaders", DownlevelFlags::COMPUTE_SHADERS)?;
        let memory = (2 * 4 * STEP * (VECTORS + OBSERVATIONS)) as u64;
        gpu.allow("bytes of a group's memory", memory, device.limits().max_compute_workgroup_storage_size.into())?;
        let make = || {
            let module = device.create_shader_module(wgpu::ShaderModuleDescriptor {
                label: Some("rows"),
                source: wgpu::ShaderSource::Wgsl(source().into()),
            });
            let pipeline = device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
                label: Some("rows"),
                layout: None,
                module: &module,
                entry_point: Some("products"),
                // Nothing is read there that was not written before.
                compilation_options: PipelineCompilationOptions {
                    zero_initialize_workgroup_memory: false,
                    ..Default::default()
                },
                cache: None,
            });
            let empty = || room(&gpu, 16, BufferUsages::STORAGE);
            Ok((pipeline, empty(), empty()))
        };
        let (pipeline, vectors, norms) = gpu.within(make)?;
        let (padded, blocks) = (d.next_multiple_of(2 * STEP), [None, None]);
        Ok(Rows { gpu, pipeline, padded, held: Arc::new(Mat::new()), room: 0, vectors, norms, blocks, turn: 0 })
    }

    /// Have these vectors on the device, `d × m`, with their squared norms. Only those that are new are sent, behind the ones that
    /// are the same.
    ///
    /// # Errors
    /// More vectors than the device has room for, and a device that has failed.
    ///
    /// # Panics
    /// If vectors have more than `d` values, or there is not a norm for each.
    pub fn hold(&mut self, members: &Arc<Mat<f32>>, norms: &[f64]) -> Result<(), GpuError> {
        assert!(
            members.nrows() <= self.padded && norms.len() == members.ncols(),
            "vectors of d values, each with a norm"
        );
        if Arc::ptr_eq(&self.held, members) {
            return self.gpu.check();
        }
        let gpu = self.gpu.clone();
        gpu.within(|| self.send(members, norms))
    }

    fn send(&mut self, members: &Arc<Mat<f32>>, norms: &[f64]) -> Result<(), GpuError> {
        let same = |&j: &usize| j < self.held.ncols() && self.held.col_as_slice(j) == members.col_as_slice(j);
        let mut kept = (0..members.ncols()).take_while(same).count() / VECTORS * VECTORS;
        if members.ncols() > self.room {
            // It doubles, so that growth does not send everything again each time.
            let wanted = members.ncols().max(2 * self.room).next_multiple_of(VECTORS);
            let most = self.gpu.largest_buffer();
            let bytes = |vectors: usize| (4 * vectors * self.padded) as u64;
            let wanted = if bytes(wanted) <= most { wanted } else { members.ncols().next_multiple_of(VECTORS) };
            self.gpu.allow("bytes of support vectors", bytes(wanted), most)?;
            let usage = BufferUsages::STORAGE | BufferUsages::COPY_DST | BufferUsages::COPY_SRC;
            let (vectors, of_norms) =
                (room(&self.gpu, bytes(wanted), usage), room(&self.gpu, 4 * wanted as u64, usage));
            if kept > 0 {
                let mut encoder = self.gpu.device().create_command_encoder(&CommandEncoderDescriptor::default());
                encoder.copy_buffer_to_buffer(&self.vectors, 0, &vectors, 0, bytes(kept));
                encoder.copy_buffer_to_buffer(&self.norms, 0, &of_norms, 0, 4 * kept as u64);
                self.gpu.queue().submit([encoder.finish()]);
            }
            (self.vectors, self.norms, self.room) = (vectors, of_norms, wanted);
            // They stand for the vectors, too.
            self.blocks = [None, None];
        }
        let queue = self.gpu.queue();
        let new = members.as_ref().subcols(kept, members.ncols() - kept);
        let of_norms: Vec<f32> = norms[kept..].iter().map(|&norm| norm as f32).collect();
        queue.write_buffer(&self.norms, 4 * kept as u64, cast_slice(&of_norms));
        for part in 0..new.ncols().div_ceil(SENT_AT_ONCE) {
            let first = part * SENT_AT_ONCE;
            let columns = new.subcols(first, SENT_AT_ONCE.min(new.ncols() - first));
            let at = (4 * kept * self.padded) as u64;
            queue.write_buffer(&self.vectors, at, cast_slice(&self.cut(columns, VECTORS)));
            // What waits to be sent takes memory until something is submitted.
            queue.submit(std::iter::empty());
            kept += columns.ncols();
        }
        self.held = members.clone();
        Ok(())
    }

    /// Have a block of observations computed, `d × n` with their squared norms, while something else is done. Two blocks may be
    /// under way.
    ///
    /// # Errors
    /// A block that the device has no room for, and a device that has failed.
    ///
    /// # Panics
    /// If there are no vectors, observations have more than `d` values, there is not a norm for each, or the kernel is not radial.
    pub fn begin(&mut self, x: MatRef<'_, f32>, norms: &[f64], of: Of) -> Result<Pending, GpuError> {
        assert!(x.nrows() <= self.padded && norms.len() == x.ncols(), "observations of d values, each with a norm");
        assert!(self.held.ncols() > 0, "vectors to multiply with");
        let gpu = self.gpu.clone();
        gpu.within(|| self.submit(x, norms, of))
    }

    fn submit(&mut self, x: MatRef<'_, f32>, norms: &[f64], of: Of) -> Result<Pending, GpuError> {
        let (vectors, observations) = (self.held.ncols(), x.ncols());
        self.turn = 1 - self.turn;
        let fits = |block: &Block| block.count >= observations && block.stride >= vectors;
        if !self.blocks[self.turn].as_ref().is_some_and(fits) {
            self.blocks[self.turn] = Some(self.block(observations)?);
        }
        let Some(block) = &self.blocks[self.turn] else { unreachable!("it was just made") };
        let (kernel, scale, half) = match of {
            Of::Products => (0, 1.0, 1.0),
            Of::Values(kernel) => match kernel.into() {
                Form::Radial { sigma, exponent } => (1, 2.0 * sigma * sigma, 0.5 * exponent),
                other => panic!("a radial kernel, not {other:?}"),
            },
        };
        let float = |number: f64| (number as f32).to_bits();
        let sizes = [block.stride / 4, self.padded].map(|size| size as u32);
        let sizes = [&sizes[..], &[kernel, float(scale), float(half), 0, 0, 0]].concat();
        let of_norms: Vec<f32> = norms.iter().map(|&norm| norm as f32).collect();
        let (device, queue) = (self.gpu.device(), self.gpu.queue());
        queue.write_buffer(&block.sizes, 0, cast_slice(&sizes));
        queue.write_buffer(&block.norms, 0, cast_slice(&of_norms));
        queue.write_buffer(&block.observations, 0, cast_slice(&self.cut(x, OBSERVATIONS)));
        let mut encoder = device.create_command_encoder(&CommandEncoderDescriptor::default());
        self.dispatch(&mut encoder, block, observations);
        let bytes = (4 * block.stride * observations) as u64;
        encoder.copy_buffer_to_buffer(&block.results, 0, &block.out, 0, bytes);
        let submission = queue.submit([encoder.finish()]);
        let (tell, mapped) = mpsc::channel();
        // Nobody listens where an earlier part has failed.
        block.out.slice(..bytes).map_async(wgpu::MapMode::Read, move |result| drop(tell.send(result)));
        Ok(Pending { block: self.turn, vectors, observations, submission, mapped })
    }

    fn dispatch(&self, encoder: &mut CommandEncoder, block: &Block, observations: usize) {
        let groups = |count: usize, of_one: usize| count.div_ceil(of_one) as u32;
        let mut pass = encoder.begin_compute_pass(&ComputePassDescriptor::default());
        pass.set_pipeline(&self.pipeline);
        pass.set_bind_group(0, &block.group, &[]);
        // Those that run side by side have the same vectors: observations are the fewer ones.
        pass.dispatch_workgroups(groups(observations, OBSERVATIONS), groups(self.held.ncols(), VECTORS), 1);
    }

    /// Seconds that the device takes for a block without sending and reading: of so many times, one after another, the best of five
    /// tries, since devices that have rested run slowly.
    ///
    /// # Errors
    /// Those of [`Rows::begin`].
    ///
    /// # Panics
    /// Those of [`Rows::begin`].
    pub fn seconds_without_transfers(
        &mut self,
        x: MatRef<'_, f32>,
        norms: &[f64],
        of: Of,
        times: usize,
    ) -> Result<f64, GpuError> {
        let pending = self.begin(x, norms, of)?;
        self.finish(pending)?;
        let Some(block) = &self.blocks[self.turn] else { unreachable!("it was just begun") };
        let mut best = f64::INFINITY;
        for _ in 0..if self.gpu.is_software() { 1 } else { 5 } {
            let begin = Instant::now();
            let mut encoder = self.gpu.device().create_command_encoder(&CommandEncoderDescriptor::default());
            (0..times).for_each(|_| self.dispatch(&mut encoder, block, x.ncols()));
            self.gpu.queue().submit([encoder.finish()]);
            self.gpu.wait(PollType::wait_indefinitely())?;
            best = best.min(begin.elapsed().as_secs_f64() / times as f64);
        }
        Ok(best)
    }

    /// What came of a block: `m × n`.
    ///
    /// # Errors
    /// A device that has failed, or refused something.
    pub fn finish(&self, pending: Pending) -> Result<Mat<f32>, GpuError> {
        self.finish_with(pending, |results| results.to_owned())
    }

    /// Do something with what came of a block, `m × n`, where it is.
    ///
    /// # Errors
    /// Those of [`Rows::finish`].
    pub fn finish_with<R>(&self, pending: Pending, work: impl FnOnce(MatRef<'_, f32>) -> R) -> Result<R, GpuError> {
        let Pending { block, vectors, observations, submission, mapped } = pending;
        let refused = |cause: &dyn std::fmt::Display| self.gpu.refused(cause);
        let until = PollType::Wait { submission_index: Some(submission), timeout: None };
        self.gpu.wait(until)?;
        mapped.recv().map_err(|cause| refused(&cause))?.map_err(|cause| refused(&cause))?;
        let Some(block) = &self.blocks[block] else { return Err(refused(&"a block is gone")) };
        let done = {
            let bytes = block.out.slice(..(4 * block.stride * observations) as u64);
            let bytes = bytes.get_mapped_range().map_err(|cause| refused(&cause))?;
            let numbers: &[f32] = cast_slice(&bytes);
            work(MatRef::from_column_major_slice_with_stride(numbers, vectors, observations, block.stride))
        };
        block.out.unmap();
        Ok(done)
    }

    fn block(&self, observations: usize) -> Result<Block, GpuError> {
        let gpu = &self.gpu;
        let count = observations.next_multiple_of(OBSERVATIONS);
        let stride = self.held.ncols().next_multiple_of(VECTORS);
        let [of_x, of_results] = [self.padded, stride].map(|each| (4 * count * each) as u64);
        gpu.allow("bytes of a block", of_x.max(of_results), gpu.largest_buffer())?;
        let (storage, to, from) = (BufferUsages::STORAGE, BufferUsages::COPY_DST, BufferUsages::COPY_SRC);
        let sizes = room(gpu, 32, BufferUsages::UNIFORM | to);
        let observations = room(gpu, of_x, storage | to);
        let norms = room(gpu, 4 * count as u64, storage | to);
        let results = room(gpu, of_results, storage | from);
        let out = room(gpu, of_results, BufferUsages::MAP_READ | to);
        let bound = [&sizes, &self.vectors, &observations, &self.norms, &norms, &results];
        let entry = |binding: usize| wgpu::BindGroupEntry {
            binding: binding as u32,
            resource: bound[binding].as_entire_binding(),
        };
        let group = gpu.device().create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some("rows"),
            layout: &self.pipeline.get_bind_group_layout(0),
            entries: &[0, 1, 2, 3, 4, 5].map(entry),
        });
        Ok(Block { count, stride, sizes, observations, norms, results, out, group })
    }

    /// Columns as the shader reads them: of so many at once the first value of each, the second of each, and so on; zeros where there is
    /// none.
    fn cut(&self, x: MatRef<'_, f32>, at_once: usize) -> Vec<f32> {
        let mut values = vec![0.0; self.padded * x.ncols().next_multiple_of(at_once)];
        let parts = values.par_chunks_exact_mut(at_once * self.padded).enumerate();
        parts.for_each(|(part, to)| {
            let columns = part * at_once..x.ncols().min((part + 1) * at_once);
            // As many values at a time as a small cache holds of all columns.
            for first in (0..x.nrows()).step_by(NEAR) {
                for (place, j) in columns.clone().enumerate() {
                    for i in first..x.nrows().min(first + NEAR) {
                        to[i * at_once + place] = x[(i, j)];
                    }
                }
            }
        });
        values
    }
}

/// Vectors that are sent at once: their copies take memory.
const SENT_AT_ONCE: usize = 1024;
const NEAR: usize = 32;

fn room(gpu: &Gpu, size: u64, usage: BufferUsages) -> Buffer {
    gpu.device().create_buffer(&wgpu::BufferDescriptor { label: Some("rows"), size, usage, mapped_at_creation: false })
}
