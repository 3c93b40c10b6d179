//! Pixel noise in bulk: eight generators side by side, one 16-bit number for each value of an image.
//!
//! An image of 320 × 240 pixels takes 230 400 noise values, so noise costs more than painting unless it is made in vector
//! registers. Everything is whole numbers: the same bits on every machine.

use pulp::NullaryFnOnce;
use rand::Rng;
use rand_chacha::ChaCha8Rng;

/// Generators side by side: one vector register of 256 bits.
const LANES: usize = 8;

/// Values of an image for one step of the generators: two for each of them.
const BLOCK: usize = 2 * LANES;

/// Bits after the point in gains and noise.
const FRACTION: u32 = 16;

/// Variance of the sum of four numbers in 0..16, whose mean is 30.
const VARIANCE: f64 = 4.0 * (16.0 * 16.0 - 1.0) / 12.0;
const MEAN: i32 = 30;

/// Gains above this are cut: every pixel but the darkest is white then. It keeps sums below 2³¹.
const LARGEST_GAIN: f64 = 64.0;

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
    /// The noise is the sum of four uniform numbers: bell-shaped, without tails beyond 3.25 standard deviations.
    pub fn expose(&mut self, values: &mut [u8], gain: f64, deviation: f64) {
        let one = f64::from(1u32 << FRACTION);
        let gain = (gain.min(LARGEST_GAIN) * one).round() as i32;
        let scale = (deviation / VARIANCE.sqrt() * one).round() as i32;
        let offset = (1 << (FRACTION - 1)) - MEAN * scale;
        pulp::Arch::new().dispatch(Expose { state: &mut self.state, values, gain, scale, offset });
    }
}

/// The loop over an image, for the widest vectors of the machine.
struct Expose<'a> {
    state: &'a mut [[u32; LANES]; 4],
    values: &'a mut [u8],
    gain: i32,
    scale: i32,
    offset: i32,
}

impl NullaryFnOnce for Expose<'_> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        let Expose { state: kept, values, gain, scale, offset } = self;
        let mut state = *kept;
        let (blocks, rest) = values.as_chunks_mut::<BLOCK>();
        for block in blocks {
            expose_block(block, &step(&mut state), gain, scale, offset);
        }
        if !rest.is_empty() {
            let mut block = [0; BLOCK];
            block[..rest.len()].copy_from_slice(rest);
            expose_block(&mut block, &step(&mut state), gain, scale, offset);
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

#[inline(always)]
fn expose_block(block: &mut [u8; BLOCK], random: &[u32; LANES], gain: i32, scale: i32, offset: i32) {
    let mut sums = [0; BLOCK];
    for i in 0..LANES {
        // Sums of two, then of four hexadecimal digits; each half of a number has four of them.
        let pairs = (random[i] & 0x0f0f_0f0f) + (random[i] >> 4 & 0x0f0f_0f0f);
        let fours = (pairs & 0x00ff_00ff) + (pairs >> 8 & 0x00ff_00ff);
        sums[i] = (fours & 0xffff) as i32;
        sums[i + LANES] = (fours >> 16) as i32;
    }
    for i in 0..BLOCK {
        let value = (i32::from(block[i]) * gain + sums[i] * scale + offset) >> FRACTION;
        block[i] = value.clamp(0, 255) as u8;
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

    #[test]
    fn noise_has_the_mean_and_deviation_asked_for_and_values_are_independent() {
        let n = 1 << 22;
        for (gain, deviation) in [(1.0, 2.0), (1.03125, 2.0), (1.703125, 8.0), (0.90625, 0.5)] {
            let shown: Vec<u8> = (0..n).map(|i| 60 + (i % 61) as u8).collect();
            let mut values = shown.clone();
            Noise::new(&mut stream(4, "noise")).expose(&mut values, gain, deviation);
            let deviations: Vec<f64> =
                values.iter().zip(&shown).map(|(&v, &shown)| f64::from(v) - f64::from(shown) * gain).collect();
            let mean = deviations.iter().sum::<f64>() / n as f64;
            let variance = deviations.iter().map(|d| d * d).sum::<f64>() / n as f64;
            // Rounding adds a twelfth, or up to a ninth if the gain is a whole number: noise has steps of 0.11 σ, and rounding
            // errors then depend on it. Sampling errors at four standard deviations are 0.002 σ and 0.0028 σ².
            let expected = deviation * deviation + 1.0 / 12.0;
            assert!(mean.abs() < 0.002 * expected.sqrt(), "mean {mean}");
            assert!(
                (variance / expected - 1.0).abs() < if gain == 1.0 { 0.012 } else { 0.006 },
                "variance {variance}, expected {expected}"
            );
            for lag in [1, 2, 8, 16, 960] {
                let product = deviations.windows(lag + 1).map(|w| w[0] * w[lag]).sum::<f64>() / n as f64;
                assert!(product.abs() < 0.002 * expected, "lag {lag}: {product}");
            }
        }
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
