//! The types of a graphics processor in a program without the feature `gpu`: there are no values of them.

use std::convert::Infallible;
use std::sync::Arc;

use faer::{Mat, MatRef};

use super::{Adapters, GpuError, Of};

/// An open graphics processor: none.
#[derive(Debug)]
pub struct Gpu(Infallible);

impl Gpu {
    /// Open the best adapter.
    ///
    /// # Errors
    /// Always [`GpuError::Feature`].
    pub fn open(_: Adapters) -> Result<Arc<Self>, GpuError> {
        Err(GpuError::Feature)
    }

    /// The graphics processor of this machine.
    ///
    /// # Errors
    /// Always [`GpuError::Feature`].
    pub fn shared() -> Result<Arc<Self>, GpuError> {
        Err(GpuError::Feature)
    }

    /// As [`Gpu::shared`].
    ///
    /// # Errors
    /// Always [`GpuError::Feature`].
    pub fn shared_if_likely() -> Result<Arc<Self>, GpuError> {
        Err(GpuError::Feature)
    }

    /// The device's name.
    pub fn name(&self) -> &str {
        match self.0 {}
    }

    /// Take the device away.
    pub fn lose(&self) {
        match self.0 {}
    }
}

/// Support vectors on a device: none.
#[derive(Debug)]
pub struct Rows(Infallible);

/// A block that a device is at: none.
pub struct Pending(Infallible);

impl Rows {
    /// Kernel rows on a device.
    ///
    /// # Errors
    /// None: there is no device to call this with.
    pub fn new(gpu: Arc<Gpu>, _: usize) -> Result<Self, GpuError> {
        match gpu.0 {}
    }

    /// Keep support vectors on the device.
    ///
    /// # Errors
    /// None: there is no device to call this with.
    pub fn hold(&mut self, _: &Arc<Mat<f32>>, _: &[f64]) -> Result<(), GpuError> {
        match self.0 {}
    }

    /// Begin with a block.
    ///
    /// # Errors
    /// None: there is no device to call this with.
    pub fn begin(&mut self, _: MatRef<'_, f32>, _: &[f64], _: Of) -> Result<Pending, GpuError> {
        match self.0 {}
    }

    /// Finish a block.
    ///
    /// # Errors
    /// None: there is no device to call this with.
    pub fn finish_with<R>(&self, pending: Pending, _: impl FnOnce(MatRef<'_, f32>) -> R) -> Result<R, GpuError> {
        match pending.0 {}
    }
}
