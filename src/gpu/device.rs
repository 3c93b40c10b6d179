//! An open graphics processor.

use std::sync::{Arc, Mutex, OnceLock};

use wgpu::{
    Adapter, Backends, Device, DeviceDescriptor, DeviceType, DownlevelFlags, ErrorFilter, Instance, InstanceDescriptor,
    PollError, PollType, Queue,
};

use super::{Adapters, GpuError, SETTING};
use crate::lock::lock;

/// An open graphics processor.
#[derive(Debug)]
pub struct Gpu {
    device: Device,
    queue: Queue,
    name: String,
    software: bool,
    abilities: DownlevelFlags,
    /// The first thing that went wrong.
    failure: Arc<Mutex<Option<String>>>,
}

impl Gpu {
    /// Open the best adapter: one of its own memory before one that shares the processor's.
    ///
    /// # Errors
    /// None that is allowed and can be opened.
    pub fn open(adapters: Adapters) -> Result<Arc<Self>, GpuError> {
        let instance = Instance::new(InstanceDescriptor::new_without_display_handle());
        let mut found = pollster::block_on(instance.enumerate_adapters(Backends::all()));
        found.sort_by_key(|adapter| rank(adapter.get_info().device_type));
        let mut refused = GpuError::None;
        for adapter in found {
            let info = adapter.get_info();
            let software = info.device_type == DeviceType::Cpu;
            let name = format!("{} ({})", info.name, info.backend);
            if software && adapters == Adapters::Hardware {
                if refused == GpuError::None {
                    refused = GpuError::Software(name);
                }
                continue;
            }
            match Self::of(&adapter, name, software) {
                Ok(gpu) => return Ok(gpu),
                Err(error) => refused = error,
            }
        }
        Err(refused)
    }

    fn of(adapter: &Adapter, name: String, software: bool) -> Result<Arc<Self>, GpuError> {
        let description = DeviceDescriptor { required_limits: adapter.limits(), ..DeviceDescriptor::default() };
        let (device, queue) = pollster::block_on(adapter.request_device(&description))
            .map_err(|cause| GpuError::Open { name: name.clone(), cause: cause.to_string() })?;
        let failure = Arc::new(Mutex::new(None));
        let note = |failure: &Arc<Mutex<Option<String>>>, cause: String| {
            lock(failure).get_or_insert(cause);
        };
        let at_error = failure.clone();
        // Without this an error of the driver would end the program.
        device.on_uncaptured_error(Arc::new(move |error: wgpu::Error| note(&at_error, one_line(&error.to_string()))));
        let at_loss = failure.clone();
        device.set_device_lost_callback(move |_, cause| {
            note(&at_loss, format!("the device is lost: {}", one_line(&cause)))
        });
        let abilities = adapter.get_downlevel_capabilities().flags;
        Ok(Arc::new(Gpu { device, queue, name, software, abilities, failure }))
    }

    /// The graphics processor of this machine, opened when it is first asked for; see [`SETTING`] for what counts as one.
    ///
    /// # Errors
    /// There is none.
    pub fn shared() -> Result<Arc<Self>, GpuError> {
        static SHARED: OnceLock<Result<Arc<Gpu>, GpuError>> = OnceLock::new();
        // Drivers are other people's programs, of all kinds.
        let open = || std::panic::catch_unwind(|| Gpu::open(adapters()?));
        let panicked = |_| Err(GpuError::Open { name: "the graphics driver".into(), cause: "it panicked".into() });
        SHARED.get_or_init(|| open().unwrap_or_else(panicked)).clone()
    }

    /// As [`Gpu::shared`], without asking the drivers where the machine shows no device: they take memory, and may print.
    ///
    /// # Errors
    /// There is none.
    pub fn shared_if_likely() -> Result<Arc<Self>, GpuError> {
        if adapters()? == Adapters::Any || shows_device() { Gpu::shared() } else { Err(GpuError::None) }
    }

    /// The device's name, and through what it is driven (Vulkan, OpenGL, Metal, Direct3D 12).
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Whether it is a program on the processor: good for tests alone.
    pub fn is_software(&self) -> bool {
        self.software
    }

    /// Bytes of the largest buffer that a program on it can use.
    pub fn largest_buffer(&self) -> u64 {
        let limits = self.device.limits();
        limits.max_storage_buffer_binding_size.min(limits.max_buffer_size)
    }

    pub(crate) fn device(&self) -> &Device {
        &self.device
    }

    pub(crate) fn queue(&self) -> &Queue {
        &self.queue
    }

    /// Refuse what was computed if anything went wrong so far.
    ///
    /// # Errors
    /// What went wrong first.
    pub fn check(&self) -> Result<(), GpuError> {
        match lock(&self.failure).clone() {
            Some(cause) => Err(self.failed(cause)),
            None => Ok(()),
        }
    }

    pub(crate) fn failed(&self, cause: impl std::fmt::Display) -> GpuError {
        GpuError::Failed { name: self.name.clone(), cause: cause.to_string() }
    }

    pub(crate) fn refused(&self, cause: impl std::fmt::Display) -> GpuError {
        GpuError::Refused { name: self.name.clone(), cause: one_line(&cause.to_string()) }
    }

    /// Do something with the device. An error of the driver in it, such as too little memory, is the error of that alone, where it
    /// would otherwise end all use of the device.
    pub(crate) fn within<T>(&self, work: impl FnOnce() -> Result<T, GpuError>) -> Result<T, GpuError> {
        self.check()?;
        let filters = [ErrorFilter::Validation, ErrorFilter::OutOfMemory, ErrorFilter::Internal];
        let scopes = filters.map(|filter| self.device.push_error_scope(filter));
        let done = work();
        let errors = scopes.into_iter().rev().filter_map(|scope| pollster::block_on(scope.pop()));
        let first = errors.fold(None, |first: Option<wgpu::Error>, error| first.or(Some(error)));
        self.check()?;
        first.map_or(done, |error| Err(self.refused(error)))
    }

    /// Wait for the device.
    pub(crate) fn wait(&self, until: PollType) -> Result<(), GpuError> {
        // Where a device is lost while one waits for it, wgpu 30 panics.
        let poll = std::panic::AssertUnwindSafe(|| self.device.poll(until));
        let cause = match std::panic::catch_unwind(poll) {
            Ok(Ok(_)) => return self.check(),
            // The driver had refused what is waited for; the device is well.
            Ok(Err(cause @ PollError::WrongSubmissionIndex(..))) => return Err(self.refused(cause)),
            Ok(Err(cause)) => cause.to_string(),
            Err(_) => "the device was lost while it was waited for".to_owned(),
        };
        self.note(cause);
        self.check()
    }

    /// Keep what went wrong, if it is the first thing.
    fn note(&self, cause: String) {
        lock(&self.failure).get_or_insert(cause);
    }

    /// Refuse a device that lacks an ability.
    pub(crate) fn need(&self, what: &'static str, ability: DownlevelFlags) -> Result<(), GpuError> {
        self.allow(what, 1, u64::from(self.abilities.contains(ability)))
    }

    /// Refuse to need more than the device allows.
    pub(crate) fn allow(&self, what: &'static str, needed: u64, allowed: u64) -> Result<(), GpuError> {
        if needed > allowed {
            return Err(GpuError::Limit { what, needed, allowed, name: self.name.clone() });
        }
        Ok(())
    }

    /// Take the device away, as a driver does that crashes: for tests of what happens then.
    pub fn lose(&self) {
        self.device.destroy();
        self.note("the device was taken away".into());
    }
}

/// What [`SETTING`] allows.
fn adapters() -> Result<Adapters, GpuError> {
    match std::env::var_os(SETTING) {
        None => Ok(Adapters::Hardware),
        Some(value) if value == "hardware" => Ok(Adapters::Hardware),
        Some(value) if value == "software" => Ok(Adapters::Any),
        Some(other) => Err(GpuError::Setting(other.to_string_lossy().into_owned())),
    }
}

/// Whether the machine shows a device that drivers could drive. Only Linux can be asked that easily.
fn shows_device() -> bool {
    const LINKS: [&str; 6] =
        ["/dev/dri", "/dev/nvidia0", "/dev/nvidiactl", "/dev/dxg", "/dev/nvhost-gpu", "/dev/mali0"];
    !cfg!(target_os = "linux") || LINKS.iter().any(|path| std::path::Path::new(path).exists())
}

/// The order in which adapters are tried.
fn rank(kind: DeviceType) -> usize {
    match kind {
        DeviceType::DiscreteGpu => 0,
        DeviceType::IntegratedGpu => 1,
        DeviceType::VirtualGpu => 2,
        DeviceType::Other => 3,
        DeviceType::Cpu => 4,
    }
}

/// Messages of drivers have many lines.
fn one_line(text: &str) -> String {
    text.split_whitespace().collect::<Vec<_>>().join(" ")
}

#[cfg(test)]
pub(crate) mod tests {
    use std::sync::MutexGuard;

    use super::*;

    /// A device, in software if need be (see `tests/common`).
    pub(crate) fn device() -> Option<(MutexGuard<'static, ()>, Arc<Gpu>)> {
        static TURN: Mutex<()> = Mutex::new(());
        let turn = lock(&TURN);
        match Gpu::open(Adapters::Any) {
            Ok(gpu) => Some((turn, gpu)),
            Err(error) => {
                let required = std::env::var("ADAGIO_REQUIRE_GPU").is_ok_and(|value| value == "1");
                assert!(!required, "ADAGIO_REQUIRE_GPU is set: {error}");
                eprintln!("nothing is checked: {error}");
                None
            }
        }
    }

    #[test]
    fn what_a_driver_refuses_is_an_error_of_that_alone() {
        let Some((_turn, gpu)) = device() else { return };
        let usage = wgpu::BufferUsages::COPY_SRC | wgpu::BufferUsages::COPY_DST;
        let buffer = |size| {
            let description = wgpu::BufferDescriptor { label: None, size, usage, mapped_at_creation: false };
            gpu.device().create_buffer(&description)
        };
        let room = |size| gpu.within(|| Ok(buffer(size).size()));
        // Something that needs what was refused is waited for.
        let copy = |size| {
            gpu.within(|| {
                let mut encoder = gpu.device().create_command_encoder(&Default::default());
                encoder.copy_buffer_to_buffer(&buffer(size), 0, &buffer(64), 0, 64);
                let submission_index = Some(gpu.queue().submit([encoder.finish()]));
                gpu.wait(PollType::Wait { submission_index, timeout: None })
            })
        };
        let error = room(1 << 60).unwrap_err().to_string();
        assert!(error.starts_with(gpu.name()) && error.contains("cannot do that"), "{error}");
        assert_eq!(gpu.check(), Ok(()));
        assert!(matches!(copy(1 << 60), Err(GpuError::Refused { .. })));
        assert_eq!(gpu.check(), Ok(()));
        assert_eq!((room(64), copy(64)), (Ok(64), Ok(())));
        // Outside of it an error ends all use.
        buffer(1 << 60);
        assert!(gpu.check().is_err() && room(64).is_err());
    }
}
