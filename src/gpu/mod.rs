//! A graphics processor: found, opened, and told apart from programs that only pretend to be one.
//!
//! Kernel rows are computed here ([`Rows`]); pictures of many views in [`world`](crate::world). Everything is optional: where there is no
//! graphics processor, or where it fails, callers are told why, and go on without.

//!
//! Without the cargo feature `gpu` no device can be opened, and everything that asks for one goes on without.

#[cfg(not(feature = "gpu"))]
mod absent;
#[cfg(feature = "gpu")]
mod device;
#[cfg(feature = "gpu")]
mod rates;
#[cfg(feature = "gpu")]
mod rows;

#[cfg(not(feature = "gpu"))]
pub use absent::{Gpu, Pending, Rows};
#[cfg(feature = "gpu")]
pub use device::Gpu;
#[cfg(all(test, feature = "gpu"))]
pub(crate) use device::tests;
#[cfg(feature = "gpu")]
pub use rates::CopyRates;
#[cfg(feature = "gpu")]
pub use rows::{Pending, Rows};

use serde::Serialize;
use thiserror::Error;

use crate::kernel::Kernel;

/// Why something is not done by a graphics processor.
#[derive(Debug, Error, Clone, PartialEq, Eq)]
pub enum GpuError {
    /// There is none.
    #[error("there is no graphics processor with a driver")]
    None,
    /// The program was built without the feature `gpu`.
    #[error("this program was built without the feature gpu")]
    Feature,
    /// [`SETTING`] is `none`, or nothing that it may be.
    #[error(
        "{SETTING} is {0:?} (none: no graphics processor; hardware, as without it; software: drivers in software too)"
    )]
    Setting(String),
    /// There are only drivers that compute on the processor itself.
    #[error("{0} is no graphics processor: it computes on the processor, and slower than this program does")]
    Software(String),
    /// It could not be opened.
    #[error("{name} cannot be used: {cause}")]
    Open {
        /// Its name.
        name: String,
        /// What the driver says.
        cause: String,
    },
    /// More is needed than it allows.
    #[error("{what}: {needed} are needed, and {name} allows {allowed}")]
    Limit {
        /// What is limited.
        what: &'static str,
        /// How much is needed.
        needed: u64,
        /// How much is allowed.
        allowed: u64,
        /// The device's name.
        name: String,
    },
    /// Its driver does not do something, for example make a buffer when too little memory is left: the rest may still go well.
    #[error("{name} cannot do that: {cause}")]
    Refused {
        /// Its name.
        name: String,
        /// What the driver says.
        cause: String,
    },
    /// It was lost, or its driver reported an error behind everybody's back: nothing that it gives is used any more.
    #[error("{name} has failed: {cause}")]
    Failed {
        /// Its name.
        name: String,
        /// What the driver says.
        cause: String,
    },
}

/// Name of the environment variable that says which adapters this program may use: `none`, `hardware` (as without it), or
/// `software`, drivers in software too, for tests.
pub const SETTING: &str = "ADAGIO_GPU";

/// Who computes something, and why.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Choice {
    /// The graphics processor's name; `None`: the processor itself.
    pub gpu: Option<String>,
    /// Why that one.
    pub why: String,
    /// Why the graphics processor did not do it to the end, if it did not: the processor went on.
    pub failed: Option<String>,
}

impl Choice {
    /// The processor itself.
    pub(crate) fn processor(why: String) -> Self {
        Choice { gpu: None, why, failed: None }
    }

    /// A graphics processor.
    pub(crate) fn device(gpu: &Gpu, why: String) -> Self {
        Choice { gpu: Some(gpu.name().to_owned()), why, failed: None }
    }

    /// Whether a graphics processor does it, and has not failed.
    pub fn is_device(&self) -> bool {
        self.gpu.is_some() && self.failed.is_none()
    }
}

impl std::fmt::Display for Choice {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "by {}: {}", self.gpu.as_deref().unwrap_or("the processor"), self.why)?;
        self.failed.iter().try_for_each(|failed| write!(f, "; {failed}, and the processor went on"))
    }
}

/// Which adapters may be opened.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Adapters {
    /// Graphics processors.
    Hardware,
    /// Drivers in software too, such as Mesa's, if there is no other: for tests of what the shaders give.
    Any,
}

/// What is computed of products.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Of {
    /// The products themselves. Those of whole numbers are exact while all squared norms are below 2²⁴.
    Products,
    /// Values of a radial kernel, in single precision.
    Values(Kernel),
}
