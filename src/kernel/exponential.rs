//! The exponential function, in a form that compilers turn into vector instructions.

/// Below this the result is smaller than the smallest normal number (exp(−708.4)), and counts as 0.
const SMALLEST: f64 = -708.0;
/// 1.5 · 2⁵²: a sum with it is rounded to a whole number, which then stands in the lowest bits.
const ROUND: f64 = 6_755_399_441_055_744.0;
/// ln 2 in two parts: products of the first with whole numbers below 2¹¹ are exact.
const LN_2_HIGH: f64 = f64::from_bits(0x3fe6_2e42_fee0_0000);
const LN_2_LOW: f64 = 1.908_214_929_270_587_7e-10;
/// The exponent of 1 in the format of `f64`.
const BIAS: u64 = 1023;

/// `1/k!` for k = 13 down to 2. On |r| ≤ ln 2/2 what the series leaves out is below 2⁻⁵⁷ of the result.
const SERIES: [f64; 12] = [
    1.0 / 6_227_020_800.0,
    1.0 / 479_001_600.0,
    1.0 / 39_916_800.0,
    1.0 / 3_628_800.0,
    1.0 / 362_880.0,
    1.0 / 40_320.0,
    1.0 / 5_040.0,
    1.0 / 720.0,
    1.0 / 120.0,
    1.0 / 24.0,
    1.0 / 6.0,
    1.0 / 2.0,
];

/// `exp(x)` for `x ≤ 0`, within one unit in the last place; 0 where it is below the smallest normal number. 1 for 0
/// exactly, 0 for −∞, NaN for NaN.
///
/// `exp(x) = 2ⁿ exp(r)` with `n` the whole number next to `x/ln 2`. There is no branch, no table and no conversion to an
/// integer type in it, so a loop over it runs on vectors; and only sums and products in a fixed order, so its bits are the
/// same on vectors of any length.
#[inline(always)]
pub(super) fn exp_of_negative(x: f64) -> f64 {
    let shifted = x * std::f64::consts::LOG2_E + ROUND;
    let n = shifted - ROUND;
    let r = (x - n * LN_2_HIGH) - n * LN_2_LOW;
    let mut series = SERIES[0];
    for coefficient in &SERIES[1..] {
        series = series * r + coefficient;
    }
    let power = f64::from_bits(shifted.to_bits().wrapping_add(BIAS) << 52);
    let value = (1.0 + (r + r * r * series)) * power;
    // A comparison with NaN is false.
    if x < SMALLEST { 0.0 } else { value }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_is_the_exponential_to_one_unit_in_the_last_place() {
        let mut worst = 0.0f64;
        let mut check = |x: f64| {
            let (found, exact) = (exp_of_negative(x), x.exp());
            let unit = f64::from_bits(exact.to_bits() + 1) - exact;
            worst = worst.max((found - exact).abs() / unit);
        };
        (0..2_000_000).for_each(|i| check(-708.0 * f64::from(i) / 2e6));
        (0..2_000_000).for_each(|i| check(-2.0 * f64::from(i) / 2e6));
        (0..1000).for_each(|i| check(-(0.5f64.powi(i))));
        // The standard library's own value is within half a unit, or a little more.
        assert!(worst <= 1.0, "{worst} units");
    }

    #[test]
    fn the_ends_of_its_range_are_exact() {
        assert_eq!(exp_of_negative(0.0), 1.0);
        assert_eq!(exp_of_negative(-0.0), 1.0);
        assert_eq!(exp_of_negative(f64::NEG_INFINITY), 0.0);
        assert_eq!(exp_of_negative(-1e300), 0.0);
        assert_eq!(exp_of_negative(-709.0), 0.0);
        assert!(exp_of_negative(-708.0).is_normal());
        assert!(exp_of_negative(f64::NAN).is_nan());
    }

    /// Its argument only ever loses: a kernel value never exceeds 1, nor grows with the distance.
    #[test]
    fn it_is_monotonic() {
        let values: Vec<f64> = (0..1_000_000).map(|i| exp_of_negative(-40.0 * f64::from(i) / 1e6)).collect();
        assert!(values.windows(2).all(|pair| pair[1] <= pair[0]));
        assert!((1..1100).map(|i| -(0.5f64.powi(i))).all(|x| exp_of_negative(x) <= 1.0));
    }
}
