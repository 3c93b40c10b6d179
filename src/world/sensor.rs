//! The errors of a real camera: exposure that drifts slowly, and pixel noise.

use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

use super::noise::Noise;
use crate::scenario::{Detail, Scenario};
use crate::snapshot::{Persist, Snapshot, SnapshotError};
use crate::vision::Image;

/// The camera's sensor.
#[derive(Debug, Clone)]
pub struct Sensor {
    random: ChaCha8Rng,
    noise: Noise,
    /// Logarithm of the gain, an Ornstein–Uhlenbeck process.
    exposure: f64,
    pixel_noise: f64,
    /// Share that remains of the exposure's deviation after one frame, and standard deviation of what is added.
    keep: f64,
    stir: f64,
}

impl Sensor {
    /// A sensor whose exposure is somewhere in its range; `frame_seconds`: time between frames.
    pub fn new(scenario: &Scenario, frame_seconds: f64, mut random: ChaCha8Rng) -> Self {
        let camera = &scenario.camera;
        let keep = (-frame_seconds / camera.exposure_seconds).exp();
        let normal: f64 = StandardNormal.sample(&mut random);
        Sensor {
            exposure: camera.exposure_drift * normal,
            pixel_noise: pixel_noise(scenario),
            keep,
            stir: camera.exposure_drift * (1.0 - keep * keep).sqrt(),
            noise: Noise::new(&mut random),
            random,
        }
    }

    /// Expose one frame: change an image as the sensor would, in a `light` that is so many times the one it was rendered in.
    pub fn expose(&mut self, image: &mut Image, light: f64) {
        let normal: f64 = StandardNormal.sample(&mut self.random);
        self.exposure = self.keep * self.exposure + self.stir * normal;
        self.noise.expose(&mut image.rgb, light * self.exposure.exp(), self.pixel_noise);
    }
}

impl Persist for Sensor {
    fn persist(&mut self, snapshot: &mut Snapshot) -> Result<(), SnapshotError> {
        snapshot.random("random", &mut self.random)?;
        snapshot.inner("noise", &mut self.noise)?;
        snapshot.number("exposure", &mut self.exposure)
    }
}

/// Standard deviation of the noise of a rendered pixel, grey levels.
///
/// Where one observation value is the mean of `s` samples instead of `n` pixels, noise is made weaker, such that the mean has
/// the same variance, rounding to whole grey levels (variance 1/12) included: `(σ′² + 1/12)/s = (σ² + 1/12)/n`.
fn pixel_noise(scenario: &Scenario) -> f64 {
    const ROUNDING: f64 = 1.0 / 12.0;
    let (camera, vision) = (&scenario.camera, &scenario.vision);
    match camera.detail {
        Detail::Full => camera.pixel_noise,
        Detail::Vision => {
            let pixels = (camera.width * (camera.height - vision.cut_rows)) as f64;
            let (width, height) = camera.rendered(vision);
            let samples = (width * height) as f64;
            let variance = (camera.pixel_noise.powi(2) + ROUNDING) * samples / pixels - ROUNDING;
            variance.max(0.0).sqrt()
        }
    }
}
