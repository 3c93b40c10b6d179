//! Pixel noise in bulk: eight generators side by side, and two 16-bit numbers for each value of an image.
//!
//! An image of 320 × 240 pixels takes 230 400 noise values, so noise costs more than painting unless it is made in vector
//! registers. Everything is whole numbers: the same bits on every machine.

use pulp::NullaryFnOnce;
use rand::Rng;
use rand_chacha::ChaCha8Rng;

use crate::snapshot::{Persist, Snapshot, SnapshotError};

/// Generators side by side: one vector register of 256 bits.
const LANES: usize = 8;

/// Values of an image for one step of the generators: two for each of them.
const BLOCK: usize = 2 * LANES;

/// Bits after the point in gains and noise.
const FRACTION: u32 = 16;

/// Bits after the point in a sum of four hexadecimal digits: a number of their own, which fills the gaps between the sums.
const DITHER: u32 = 10;
const PARTS: f64 = (1u32 << DITHER) as f64;

/// Mean and variance of such a sum, in units of its last bit.
const MEAN: f64 = 30.0 * PARTS + 0.5 * (PARTS - 1.0);
const VARIANCE: f64 = 4.0 * (16.0 * 16.0 - 1.0) / 12.0 * PARTS * PARTS + (PARTS * PARTS - 1.0) / 12.0;

/// Gains above this are cut: every pixel but the darkest is white then. Deviations above the other drown every image. They
/// keep sums below 2³¹.
const LARGEST_GAIN: f64 = 64.0;
const LARGEST_DEVIATION: f64 = 4096.0;

/// The scale of noise has as many bits as its product with a sum leaves free, but no more than these after the point.
const SCALE_LIMIT: f64 = (1u32 << 15) as f64;
const MOST_SHIFT: u32 = 24;

/// Eight xoshiro128++ generators.
///
/// # Reference
/// D. Blackman, S. Vigna: *Scrambled linear pseudorandom number generators*, ACM TOMS 47 (2021).
#[derive(Debug, Clone)]
pub struct Noise {
    state: [[u32; LANES]; 4],
}

impl Noise {
    /// Generators with states from a seeded stream.
    pub fn new(seed: &mut ChaCha8Rng) -> Self {
        let mut state = [[0; LANES]; 4];
        state.as_flattened_mut().fill_with(|| seed.next_u32());
        Noise { state }
    }

    /// Multiply values by a gain, add noise of a standard deviation, round and cut to 0..=255.
    ///
    /// The noise is the sum of four uniform whole numbers and one as wide as their step: bell-shaped and without gaps, with no
    /// tails beyond 3.31 standard deviations σ. The variance of a value that is not cut is σ² + 1/12, the second from
    /// rounding, within 0.5 % from σ = ½ on and within 0.25 % from σ = 1 on; its mean is right within 0.0015 σ. Both hold for
    /// each value and gain. Weaker noise cannot hide the steps of rounding.
    pub fn expose(&mut self, values: &mut [u8], gain: f64, deviation: f64) {
        pulp::Arch::new().dispatch(Expose { state: &mut self.state, values, scales: Scales::new(gain, deviation) });
    }
}

impl Persist for Noise {
    fn persist(&mut self, snapshot: &mut Snapshot) -> Result<(), SnapshotError> {
        snapshot.value("state", &mut self.state)
    }
}

/// What values and noise are multiplied by.
#[derive(Clone, Copy)]
struct Scales {
    /// With [`FRACTION`].
    gain: i32,
    /// Of noise: after the product with a sum is shifted to the right, it has [`FRACTION`].
    noise: i32,
    shift: u32,
    /// Half a grey level, for rounding, less the mean of noise.
    offset: i32,
}

impl Scales {
    fn new(gain: f64, deviation: f64) -> Self {
        let one = f64::from(1u32 << FRACTION);
        let scale = deviation.min(LARGEST_DEVIATION) / VARIANCE.sqrt() * one;
        let shifted = |shift: u32| scale * f64::from(1u32 << shift);
        let shift = (0..=MOST_SHIFT).take_while(|&shift| shifted(shift) < SCALE_LIMIT).last().unwrap_or(0);
        let noise = shifted(shift).round();
        Scales {
            gain: (gain.min(LARGEST_GAIN) * one).round() as i32,
            noise: noise as i32,
            shift,
            offset: (0.5 * one - MEAN * noise / f64::from(1u32 << shift)).round() as i32,
        }
    }

    /// A value with noise from a sum, rounded and not yet cut.
    #[inline(always)]
    fn expose(self, value: u8, sum: i32) -> i32 {
        (i32::from(value) * self.gain + (((sum * self.noise) >> self.shift) + self.offset)) >> FRACTION
    }
}

/// The loop over an image, for the widest vectors of the machine.
struct Expose<'a> {
    state: &'a mut [[u32; LANES]; 4],
    values: &'a mut [u8],
    scales: Scales,
}

impl NullaryFnOnce for Expose<'_> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        let Expose { state: kept, values, scales } = self;
        let mut state = *kept;
        let (blocks, rest) = values.as_chunks_mut::<BLOCK>();
        for block in blocks {
            expose_block(block, &sums(&mut state), scales);
        }
        if !rest.is_empty() {
            let mut block = [0; BLOCK];
            block[..rest.len()].copy_from_slice(rest);
            expose_block(&mut block, &sums(&mut state), scales);
            rest.copy_from_slice(&block[..rest.len()]);
        }
        *kept = state;
    }
}

/// The next number of each generator.
#[inline(always)]
fn step([a, b, c, d]: &mut [[u32; LANES]; 4]) -> [u32; LANES] {
    let mut result = [0; LANES];
    for i in 0..LANES {
        result[i] = a[i].wrapping_add(d[i]).rotate_left(7).wrapping_add(a[i]);
        let shifted = b[i] << 9;
        c[i] ^= a[i];
        d[i] ^= b[i];
        b[i] ^= c[i];
        a[i] ^= d[i];
        c[i] ^= shifted;
        d[i] = d[i].rotate_left(11);
    }
    result
}

/// Sums of four hexadecimal digits, with [`DITHER`] bits after the point. The digits are those of the generators' next
/// numbers. The bits are those of a word of the state that these numbers do not depend on.
#[inline(always)]
fn sums(state: &mut [[u32; LANES]; 4]) -> [i32; BLOCK] {
    const BITS: u32 = (1 << DITHER) - 1;
    let dither = state[2];
    let random = step(state);
    let mut sums = [0; BLOCK];
    for i in 0..LANES {
        // Sums of two, then of four digits; each half of a number has four of them.
        let pairs = (random[i] & 0x0f0f_0f0f) + (random[i] >> 4 & 0x0f0f_0f0f);
        let fours = (pairs & 0x00ff_00ff) + (pairs >> 8 & 0x00ff_00ff);
        let both = fours << DITHER | dither[i] & (BITS << 16 | BITS);
        sums[i] = (both & 0xffff) as i32;
        sums[i + LANES] = (both >> 16) as i32;
    }
    sums
}

#[inline(always)]
fn expose_block(block: &mut [u8; BLOCK], sums: &[i32; BLOCK], scales: Scales) {
    for (value, &sum) in block.iter_mut().zip(sums) {
        *value = scales.expose(*value, sum).clamp(0, 255) as u8;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::stream;

    #[test]
    fn each_generator_gives_the_published_numbers() {
        let mut state = [[1; LANES], [2; LANES], [3; LANES], [4; LANES]];
        // Another seed in another lane does not disturb.
        state[0][1] = 77;
        for expected in [641, 1_573_767, 3_222_811_527, 3_517_856_514, 836_907_274, 4_247_214_768, 3_867_114_732] {
            let numbers = step(&mut state);
            assert_eq!((numbers[0], numbers[7]), (expected, expected));
            assert_ne!(numbers[1], expected);
        }
    }

    /// The probability of each sum: four digits, and the bits after the point.
    fn probabilities() -> Vec<f64> {
        let mut digits = vec![1.0];
        for _ in 0..4 {
            let mut more = vec![0.0; digits.len() + 15];
            for (i, p) in digits.iter().enumerate() {
                more[i..i + 16].iter_mut().for_each(|sum| *sum += p / 16.0);
            }
            digits = more;
        }
        digits.iter().flat_map(|p| std::iter::repeat_n(p / PARTS, 1 << DITHER)).collect()
    }

    /// Mean, mean square and mean fourth power of what exposure adds to a value times the gain: over all sums.
    fn moments(probabilities: &[f64], value: u8, gain: f64, deviation: f64) -> [f64; 3] {
        let scales = Scales::new(gain, deviation);
        let (mut moments, exact) = ([0.0; 3], f64::from(value) * gain);
        for (sum, p) in probabilities.iter().enumerate() {
            let error = f64::from(scales.expose(value, sum as i32)) - exact;
            for (moment, power) in moments.iter_mut().zip([error, error.powi(2), error.powi(4)]) {
                *moment += p * power;
            }
        }
        moments
    }

    /// Deviations for which noise once had its steps where the rounding has its own, one at which they are as wide as a
    /// grey level, and the largest of a scenario.
    const AWKWARD: [f64; 7] = [3.0, 4.6, 4.609_77, 4.61, 9.224, 12.0, 64.0];

    #[test]
    fn the_variance_is_that_of_the_noise_and_a_twelfth() {
        let probabilities = probabilities();
        let evenly = (0..160).map(|i| 0.5 * 1.03f64.powi(i));
        for deviation in evenly.chain(AWKWARD) {
            // The exact value is a whole number, and a quarter and a half more.
            for gain in [1.0, 1.0025, 1.005] {
                let [mean, square, _] = moments(&probabilities, 100, gain, deviation);
                let ratio = (square - mean * mean) / (deviation * deviation + 1.0 / 12.0);
                let bound = if deviation < 1.0 { 0.005 } else { 0.0025 };
                assert!((ratio - 1.0).abs() < bound, "σ = {deviation}, gain {gain}: ratio {ratio}");
                assert!(mean.abs() < 0.0015 * deviation, "σ = {deviation}, gain {gain}: mean {mean}");
            }
        }
    }

    #[test]
    fn noise_has_the_mean_and_deviation_asked_for_and_values_are_independent() {
        let n = 1 << 22;
        let probabilities = probabilities();
        let gains = [(1.03125, 2.0), (1.703125, 8.0), (0.90625, 0.5)];
        // Up to 12, at which none of the values is cut.
        for (gain, deviation) in gains.into_iter().chain(AWKWARD[..6].iter().map(|&deviation| (1.0, deviation))) {
            let shown: Vec<u8> = (0..n).map(|i| 60 + (i % 61) as u8).collect();
            let mut values = shown.clone();
            Noise::new(&mut stream(4, "noise")).expose(&mut values, gain, deviation);
            let errors: Vec<f64> =
                values.iter().zip(&shown).map(|(&v, &shown)| f64::from(v) - f64::from(shown) * gain).collect();
            let mean = errors.iter().sum::<f64>() / n as f64;
            let square = errors.iter().map(|d| d * d).sum::<f64>() / n as f64;
            let mut expected = [0.0; 3];
            for value in 60..=120 {
                let exact = moments(&probabilities, value, gain, deviation);
                expected.iter_mut().zip(exact).for_each(|(sum, moment)| *sum += moment / 61.0);
            }
            // Five standard deviations of a mean of n: of the errors, of their squares, and of products of two of them.
            let five = |variance: f64| 5.0 * (variance / n as f64).sqrt();
            let [middle, second, fourth] = expected;
            assert!((mean - middle).abs() < five(second), "σ = {deviation}: mean {mean}, expected {middle}");
            assert!(
                (square - second).abs() < five(fourth - second * second),
                "σ = {deviation}: mean square {square}, expected {second}"
            );
            for lag in [1, 2, 8, 16, 960] {
                let product = errors.windows(lag + 1).map(|w| w[0] * w[lag]).sum::<f64>() / n as f64;
                assert!(product.abs() < five(second * second), "σ = {deviation}, lag {lag}: {product}");
            }
        }
    }

    #[test]
    fn the_largest_gain_and_deviation_do_not_overflow() {
        let scales = Scales::new(f64::MAX, f64::MAX);
        let largest = (61 << DITHER) - 1;
        assert!(scales.expose(255, largest) > 64 * 255 + 12_000 && scales.expose(0, 0) < -12_000);
        assert_eq!(Scales::new(1.0, 0.0).expose(77, largest), 77);
    }

    #[test]
    fn a_rest_shorter_than_a_block_is_exposed_as_well_and_extremes_are_cut() {
        let expose = |values: &mut [u8], gain| Noise::new(&mut stream(1, "noise")).expose(values, gain, 3.0);
        let (mut long, mut short) = ([128; BLOCK], [128; BLOCK - 3]);
        expose(&mut long, 1.0);
        expose(&mut short, 1.0);
        assert_eq!(long[..BLOCK - 3], short);
        let mut white = [250; 40];
        expose(&mut white, 1e9);
        assert_eq!(white, [255; 40]);
        let mut black = [200; 40];
        expose(&mut black, 0.0);
        assert!(black.iter().all(|&value| value <= 10) && black.contains(&0));
    }
}
