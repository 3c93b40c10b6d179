//! What a device can do at best, for comparison with what is reached on it.

use std::sync::mpsc;
use std::time::Instant;

use wgpu::{
    BindGroupDescriptor, BindGroupEntry, BufferDescriptor, BufferUsages, CommandEncoderDescriptor,
    ComputePassDescriptor, ComputePipelineDescriptor, MapMode, PollType, ShaderModuleDescriptor, ShaderSource,
};

use super::{Gpu, GpuError};

/// Bytes per second.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CopyRates {
    /// From one place of the device's memory to another; each byte is read and written, and counts twice.
    pub within: f64,
    /// From the device to the processor's memory, read there.
    pub to_memory: f64,
}

/// Bytes that are copied.
const BYTES: u64 = 1 << 26;
/// Copies in one submission.
const COPIES: u64 = 16;
/// The best of so many.
const TRIES: usize = 5;

/// Threads that sum and multiply, and how many rounds each of them does.
const THREADS: u32 = 1 << 18;
const ROUNDS: u32 = 1 << 15;
/// A round is eight sums and as many products, of four numbers.
const OPERATIONS: u32 = 64;
/// So many rounds are written out: counting them takes time on one device, long programs do on another. The faster one counts.
const WRITTEN_OUT: [u32; 2] = [1, 16];

impl Gpu {
    /// Operations per second in single precision at most, a multiplication or an addition being one.
    ///
    /// # Errors
    /// A device that has failed.
    pub fn single_precision_rate(&self) -> Result<f64, GpuError> {
        let rates = WRITTEN_OUT.map(|written_out| self.chains(written_out));
        rates.into_iter().try_fold(0.0, |best: f64, rate| Ok(best.max(rate?)))
    }

    /// Operations per second with so many rounds written out.
    fn chains(&self, written_out: u32) -> Result<f64, GpuError> {
        let (device, queue) = (self.device(), self.queue());
        // A driver in software takes its time.
        let rounds = if self.is_software() { ROUNDS >> 8 } else { ROUNDS };
        let chain = |name| format!("        {name} = fma({name}, factor, more);\n");
        let chains = ["a", "b", "c", "d", "e", "f", "g", "h"].map(chain).concat().repeat(written_out as usize);
        let source = include_str!("fma.wgsl").replace("//CHAINS//", &chains);
        let source = format!("const STEPS: u32 = {}u;\n{source}", rounds / written_out);
        let module = device.create_shader_module(ShaderModuleDescriptor {
            label: Some("fma"),
            source: ShaderSource::Wgsl(source.into()),
        });
        let pipeline = device.create_compute_pipeline(&ComputePipelineDescriptor {
            label: Some("fma"),
            layout: None,
            module: &module,
            entry_point: Some("chains"),
            compilation_options: Default::default(),
            cache: None,
        });
        let (size, usage) = (u64::from(16 * THREADS), BufferUsages::STORAGE);
        let results =
            device.create_buffer(&BufferDescriptor { label: Some("fma"), size, usage, mapped_at_creation: false });
        let group = device.create_bind_group(&BindGroupDescriptor {
            label: Some("fma"),
            layout: &pipeline.get_bind_group_layout(0),
            entries: &[BindGroupEntry { binding: 0, resource: results.as_entire_binding() }],
        });
        let mut best = f64::INFINITY;
        for _ in 0..TRIES {
            let begin = Instant::now();
            let mut encoder = device.create_command_encoder(&CommandEncoderDescriptor::default());
            {
                let mut pass = encoder.begin_compute_pass(&ComputePassDescriptor::default());
                pass.set_pipeline(&pipeline);
                pass.set_bind_group(0, &group, &[]);
                pass.dispatch_workgroups(THREADS / 256, 1, 1);
            }
            queue.submit([encoder.finish()]);
            self.wait(PollType::wait_indefinitely())?;
            best = best.min(begin.elapsed().as_secs_f64());
        }
        self.check()?;
        Ok(f64::from(THREADS) * f64::from(rounds) * f64::from(OPERATIONS) / best)
    }

    /// How fast the device copies.
    ///
    /// # Errors
    /// A device that has failed.
    pub fn copy_rates(&self) -> Result<CopyRates, GpuError> {
        let (device, queue) = (self.device(), self.queue());
        let room = |usage| {
            device.create_buffer(&BufferDescriptor {
                label: Some("copies"),
                size: BYTES,
                usage,
                mapped_at_creation: false,
            })
        };
        let (copy_from, copy_to) = (BufferUsages::COPY_SRC, BufferUsages::COPY_DST);
        let (a, b, out) =
            (room(copy_from | copy_to), room(copy_from | copy_to), room(copy_to | BufferUsages::MAP_READ));
        let wait = || self.wait(PollType::wait_indefinitely());
        let (mut within, mut to_memory) = (f64::INFINITY, f64::INFINITY);
        let mut sum = 0u64;
        for _ in 0..TRIES {
            let begin = Instant::now();
            let mut encoder = device.create_command_encoder(&CommandEncoderDescriptor::default());
            (0..COPIES / 2).for_each(|_| {
                encoder.copy_buffer_to_buffer(&a, 0, &b, 0, BYTES);
                encoder.copy_buffer_to_buffer(&b, 0, &a, 0, BYTES);
            });
            queue.submit([encoder.finish()]);
            wait()?;
            within = within.min(begin.elapsed().as_secs_f64() / COPIES as f64);
            let begin = Instant::now();
            let mut encoder = device.create_command_encoder(&CommandEncoderDescriptor::default());
            encoder.copy_buffer_to_buffer(&a, 0, &out, 0, BYTES);
            queue.submit([encoder.finish()]);
            let (tell, mapped) = mpsc::channel();
            // Nobody listens after a failure.
            out.slice(..).map_async(MapMode::Read, move |result| drop(tell.send(result)));
            wait()?;
            mapped.recv().map_err(|cause| self.failed(cause))?.map_err(|cause| self.failed(cause))?;
            {
                let bytes = out.slice(..).get_mapped_range().map_err(|cause| self.failed(cause))?;
                sum += bytes.iter().map(|&byte| u64::from(byte)).sum::<u64>();
            }
            out.unmap();
            to_memory = to_memory.min(begin.elapsed().as_secs_f64());
        }
        // Buffers begin as zeros; reading them is not to be left out.
        if sum != 0 {
            return Err(self.failed("a copy of zeros has other values"));
        }
        self.check()?;
        Ok(CopyRates { within: 2.0 * BYTES as f64 / within, to_memory: BYTES as f64 / to_memory })
    }
}
