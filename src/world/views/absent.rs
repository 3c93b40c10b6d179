//! The renderer of a program without the feature `gpu`: there are no values of it.

use std::convert::Infallible;
use std::sync::Arc;

use super::Camera;
use super::eye::Viewpoint;
use crate::gpu::{Gpu, GpuError};
use crate::vision::Image;

/// The renderer of a camera's views: none.
pub struct Views(Infallible);

impl Views {
    pub fn new(_: Arc<Gpu>, _: Arc<Camera>) -> Result<Self, GpuError> {
        Err(GpuError::Feature)
    }

    pub fn render(&mut self, _: &[Viewpoint<'_>], _: &mut [Image]) -> Result<(), GpuError> {
        match self.0 {}
    }

    pub fn rest(&mut self) {
        match self.0 {}
    }
}
