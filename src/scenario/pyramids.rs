//! `[[world.pyramid]]`: pyramids outside, above the walls.

use super::keys::{Section, above, within};

/// Farther away than this nothing is placed, metres.
const FARTHEST: f64 = 10_000.0;

/// `[[world.pyramid]]`: a square pyramid that stands on the ground.
#[derive(Debug, Clone, PartialEq)]
pub struct Pyramid {
    /// Centre of its base, metres.
    pub centre: [f64; 2],
    /// Side of its base, metres.
    pub side: f64,
    /// Height of its top, metres.
    pub height: f64,
    /// Turn of its base against the axes, degrees counter-clockwise.
    pub turn_deg: f64,
    /// Colour, degrees.
    pub hue: f64,
}

impl Pyramid {
    pub(super) fn read(s: &mut Section<'_, '_>, index: usize) -> Self {
        let size = above(0.0, FARTHEST);
        // By default they stand around the place where most rooms are, none like another.
        let angle = index as f64 * 2.4;
        let centre = [angle.cos(), angle.sin()].map(|way| (60.0 * way).round());
        let pyramid = Pyramid {
            centre: s.point("centre", centre, "centre of its base, outside the walls"),
            side: s.number("side", 20.0 + 5.0 * (index % 4) as f64, "m", size, "side of its base"),
            height: s.number("height", 14.0 + 3.0 * (index % 3) as f64, "m", size, "height of its top"),
            turn_deg: s.number("turn_deg", 0.0, "degrees", within(-360.0, 360.0), "turn of its base"),
            hue: s.number("hue", 42.0, "degrees", within(0.0, 360.0), "colour"),
        };
        if pyramid.centre.iter().any(|place| place.abs() > FARTHEST) {
            let text = format!("= {:?} is not allowed: both must be in [-{FARTHEST}, {FARTHEST}]", pyramid.centre);
            s.fault_here("centre", text);
        }
        pyramid
    }

    /// Radius of the circle around its base, metres.
    pub fn reach(&self) -> f64 {
        self.side * std::f64::consts::FRAC_1_SQRT_2
    }
}
