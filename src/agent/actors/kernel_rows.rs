//! Kernel values of many observations, by the processor or by a graphics processor: the same to the last bit.
//!
//! A device computes the products of observations with support vectors, and only where they are exact: whole numbers whose squared
//! norms are below [`EXACT`]. Everything after them is computed here, in double precision, as it is without a device. The processor keeps
//! products from one model to the next, up to a bound: of a window most observations and support vectors are those of before.

use std::sync::Arc;
use std::time::{Duration, Instant};

use faer::{Mat, MatRef, Par};

use crate::gpu::{Choice, Gpu, GpuError, Of, Pending, Rows};
use crate::kernel::{EXACT, KeptProducts, squared_norms};
use crate::policy::columns;
use crate::scenario::Compute;
use crate::slow::{SlowError, SlowModel};
use crate::vision::Observation;

/// Products that are kept, at most: 1 GB.
pub const MOST_KEPT: usize = 250_000_000;

/// Who computes kernel values, chosen when the first ones are asked for.
pub struct KernelRows {
    setting: Compute,
    device: Option<Rows>,
    choice: Option<Choice>,
    /// Support vectors when the processor was found to be faster: a device may be once there are many more.
    slower_at: Option<usize>,
    /// Whether the device was left out because products would not have been exact.
    inexact: bool,
    kept: KeptProducts,
}

/// A part that a device is at.
struct PendingPart {
    x: Mat<f32>,
    norms: Vec<f64>,
    pending: Pending,
}

impl KernelRows {
    /// As a scenario has it.
    pub fn new(setting: Compute) -> Self {
        KernelRows {
            setting,
            device: None,
            choice: None,
            slower_at: None,
            inexact: false,
            kept: KeptProducts::new(MOST_KEPT),
        }
    }

    /// Who computes them, and why; `None` as long as there were none, or if nothing but the processor was asked for.
    pub fn choice(&self) -> Option<Choice> {
        let mut choice = self.choice.clone()?;
        if self.inexact {
            choice
                .why
                .push_str("; the processor for observations whose products single precision does not hold exactly");
        }
        Some(choice)
    }

    /// Hand the kernel values of parts of observations to `take`, in their order: `m × n` for a part of `n`. The numbers of their frames tell
    /// observations apart.
    ///
    /// # Errors
    /// Observations of another length than the support vectors, and what `take` refuses.
    pub fn each<'a>(
        &mut self,
        model: &SlowModel<f32>,
        parts: impl Iterator<Item = &'a [&'a Observation]>,
        par: Par,
        mut take: impl FnMut(Mat<f64>) -> Result<(), SlowError>,
    ) -> Result<(), SlowError> {
        let mut begun: Option<PendingPart> = None;
        let mut holds = false;
        self.kept.begin(&model.members);
        for part in parts {
            let grown = self.slower_at.is_some_and(|m| model.members.ncols() >= 2 * m);
            if self.setting != Compute::Cpu && (self.choice.is_none() || grown) {
                self.choose(model, columns(part.iter().copied()).as_ref(), par)?;
            }
            if !holds && let Some(device) = &mut self.device {
                holds = true;
                let held = device.hold(&model.members, model.norms());
                self.note(held);
            }
            // The next part is begun before the last one is finished.
            let next = self.begin(model, part);
            if let Some(last) = begun.take() {
                take(self.finish(model, last, par)?)?;
            }
            match next {
                Some(next) => begun = Some(next),
                None => take(self.by_processor(model, part, par)?)?,
            }
        }
        match begun {
            Some(last) => take(self.finish(model, last, par)?),
            None => Ok(()),
        }
    }

    fn by_processor(&mut self, model: &SlowModel<f32>, part: &[&Observation], par: Par) -> Result<Mat<f64>, SlowError> {
        let numbers: Vec<u64> = part.iter().map(|seen| seen.frame).collect();
        let of = |places: &[usize]| columns(places.iter().map(|&place| part[place]));
        match self.kept.of(&numbers, of, par) {
            Some((products, norms)) => {
                Ok(model.kernel.matrix_of_products(products.as_ref(), model.norms(), &norms, par)?)
            }
            None => model.kernel_rows(columns(part.iter().copied()).as_ref(), par),
        }
    }

    /// Have the device begin with a part; `None` if it is not to.
    fn begin(&mut self, model: &SlowModel<f32>, part: &[&Observation]) -> Option<PendingPart> {
        let device = self.device.as_mut()?;
        let x = columns(part.iter().copied());
        let norms = squared_norms(x.as_ref());
        let exact = model.norms().iter().chain(&norms).all(|&norm| norm < EXACT);
        self.inexact |= !exact;
        if !exact || x.nrows() != model.members.nrows() {
            return None;
        }
        match device.begin(x.as_ref(), &norms, Of::Products) {
            Ok(pending) => Some(PendingPart { x, norms, pending }),
            Err(error) => {
                self.note(Err(error));
                None
            }
        }
    }

    fn finish(&mut self, model: &SlowModel<f32>, begun: PendingPart, par: Par) -> Result<Mat<f64>, SlowError> {
        let PendingPart { x, norms, pending } = begun;
        if let Some(device) = &self.device {
            let values =
                |products: MatRef<'_, f32>| model.kernel.matrix_of_products(products, model.norms(), &norms, par);
            match device.finish_with(pending, values) {
                Ok(values) => return Ok(values?),
                Err(error) => self.note(Err(error)),
            }
        }
        model.kernel_rows(x.as_ref(), par)
    }

    /// Do without the device after an error.
    fn note(&mut self, result: Result<(), GpuError>) {
        if let Err(error) = result {
            self.device = None;
            self.choice.iter_mut().for_each(|choice| choice.failed = Some(error.to_string()));
        }
    }

    fn choose(&mut self, model: &SlowModel<f32>, x: MatRef<'_, f32>, par: Par) -> Result<(), SlowError> {
        self.slower_at = None;
        let found = if self.setting == Compute::Gpu { Gpu::shared() } else { Gpu::shared_if_likely() };
        let gpu = match found {
            Ok(gpu) => gpu,
            Err(error) => {
                self.choice = Some(Choice::processor(error.to_string()));
                return Ok(());
            }
        };
        let begin = Instant::now();
        model.kernel_rows(x, par)?;
        let by_processor = begin.elapsed();
        let name = gpu.name().to_owned();
        let (device, by_device) = match time(&gpu, model, x, par) {
            Ok(tried) => tried,
            Err(error) => {
                self.choice = Some(Choice::processor(error.to_string()));
                return Ok(());
            }
        };
        let ms = |time: Duration| format!("{:.1} ms", 1e3 * time.as_secs_f64());
        let (m, n) = (model.members.ncols(), x.ncols());
        let times =
            format!("{n} × {m} kernel values in {} on {name}, in {} on the processor", ms(by_device), ms(by_processor));
        let (takes, why) = match self.setting {
            Compute::Gpu => (true, format!("the scenario asks for it ({times})")),
            _ => (by_device < by_processor, times),
        };
        self.slower_at = (!takes).then_some(m);
        self.choice = Some(if takes { Choice::device(&gpu, why) } else { Choice::processor(why) });
        self.device = takes.then_some(device);
        Ok(())
    }
}

/// A device with a model's support vectors, and the time that it takes for some observations.
type Tried = Result<(Rows, Duration), GpuError>;

/// Try a device: the shorter time of two, since memory is taken the first time.
fn time(gpu: &Arc<Gpu>, model: &SlowModel<f32>, x: MatRef<'_, f32>, par: Par) -> Tried {
    let mut device = Rows::new(gpu.clone(), x.nrows())?;
    device.hold(&model.members, model.norms())?;
    let norms = squared_norms(x);
    let mut took = Duration::MAX;
    for _ in 0..2 {
        let begin = Instant::now();
        let pending = device.begin(x, &norms, Of::Products)?;
        // Shapes fit: they were made so.
        let _ = device
            .finish_with(pending, |products| model.kernel.matrix_of_products(products, model.norms(), &norms, par))?;
        took = took.min(begin.elapsed());
    }
    Ok((device, took))
}

#[cfg(all(test, feature = "gpu"))]
mod tests {
    use super::*;
    use crate::gpu::tests::device;
    use crate::kernel::Kernel;

    fn on(gpu: &Arc<Gpu>, d: usize) -> KernelRows {
        let device = Some(Rows::new(gpu.clone(), d).unwrap());
        let choice = Some(Choice::device(gpu, "a test".into()));
        KernelRows { device, choice, ..KernelRows::new(Compute::Gpu) }
    }

    fn model(d: usize) -> SlowModel<f32> {
        let members = Mat::from_fn(d, 5, |i, j| ((7 * i + 3 * j) % 11) as f32);
        let projection = Mat::from_fn(5, 1, |i, _| i as f64);
        SlowModel::from_parts(Kernel::gaussian(20.0).unwrap(), members, projection, vec![0.0], vec![1.0]).unwrap()
    }

    fn part(d: usize, number: usize, level: usize) -> Vec<Observation> {
        let pixel = |j: usize| move |i: usize| (level + (5 * i + 2 * j + number) % 13) as u8;
        (0..3).map(|j| Observation { frame: (3 * number + j) as u64, pixels: (0..d).map(pixel(j)).collect() }).collect()
    }

    #[test]
    fn a_device_that_fails_between_two_parts_changes_no_value() {
        let Some((_turn, gpu)) = device() else { return };
        let (d, model) = (40, model(40));
        let mut rows = on(&gpu, d);
        let mut found = Vec::new();
        let keep = |part: Mat<f64>| {
            found.push(part);
            if found.len() == 2 {
                gpu.lose();
            }
            Ok(())
        };
        let parts: Vec<Vec<Observation>> = (0..6).map(|number| part(d, number, 128)).collect();
        let seen: Vec<Vec<&Observation>> = parts.iter().map(|part| part.iter().collect()).collect();
        rows.each(&model, seen.iter().map(Vec::as_slice), Par::Seq, keep).unwrap();
        assert_eq!(found.len(), 6);
        for (number, (found, part)) in found.iter().zip(&parts).enumerate() {
            assert_eq!(found, &model.kernel_rows(columns(part.iter()).as_ref(), Par::Seq).unwrap(), "part {number}");
        }
        let choice = rows.choice().unwrap();
        assert!(choice.gpu.is_some() && !choice.is_device() && rows.device.is_none(), "{choice:?}");
    }

    #[test]
    fn what_a_device_cannot_count_exactly_stays_here_and_is_told() {
        let Some((_turn, gpu)) = device() else { return };
        // 2000 · 115² is beyond 2²⁴.
        let (d, dark, model) = (2000, part(2000, 0, 0), model(2000));
        let mut rows = on(&gpu, d);
        let check = |found: Mat<f64>| {
            assert_eq!(found, model.kernel_rows(columns(dark.iter()).as_ref(), Par::Seq).unwrap());
            Ok(())
        };
        assert!(!rows.choice().unwrap().why.contains("exactly"));
        let seen: Vec<&Observation> = dark.iter().collect();
        rows.each(&model, std::iter::once(seen.as_slice()), Par::Seq, check).unwrap();
        assert!(rows.choice().unwrap().why.contains("exactly"), "{:?}", rows.choice());
    }
}
