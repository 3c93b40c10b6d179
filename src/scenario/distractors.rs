//! `[[world.distractor]]`: things that move or blink whatever the robot does.

use super::keys::{Section, above, within};

/// `[[world.distractor]]`: an upright cylinder that is seen and not felt: a person who walks and gives way, a lamp that blinks.
#[derive(Debug, Clone, PartialEq)]
pub struct Distractor {
    /// It goes back and forth along these corners, metres.
    pub path: Vec<[f64; 2]>,
    /// Metres per second; 0: it stands at the first corner.
    pub speed: f64,
    /// Metres.
    pub radius: f64,
    /// Where it begins above the floor, metres.
    pub bottom: f64,
    /// Where it ends above the floor, metres.
    pub top: f64,
    /// Colour, degrees.
    pub hue: f64,
    /// It is bright and dark in turn, each for this long, seconds; `None`: always bright.
    pub blink_seconds: Option<f64>,
}

impl Distractor {
    pub(super) fn read(s: &mut Section<'_, '_>, index: usize) -> Self {
        let metres = within(0.0, 1000.0);
        let distractor = Distractor {
            path: s.points("path", "it moves back and forth along these corners"),
            speed: s.number("speed", 0.5, "m/s", within(0.0, 100.0), "0: it stands at the first corner"),
            radius: s.number("radius", 0.2, "m", above(0.0, 100.0), "an upright cylinder"),
            bottom: s.number("bottom", 0.0, "m", metres, "where it begins above the floor"),
            top: s.number("top", 1.7, "m", metres, "where it ends"),
            hue: s.number("hue", (index as f64 * 137.0) % 360.0, "degrees", within(0.0, 360.0), "colour"),
            blink_seconds: s.number_or_auto(
                "blink_seconds",
                "s",
                within(0.01, 1e6),
                "bright and dark in turn, each for this long; auto: always bright",
            ),
        };
        if distractor.bottom >= distractor.top {
            let text = format!("= {} is not allowed: it must be below top = {}", distractor.bottom, distractor.top);
            s.fault_here("bottom", text);
        }
        distractor
    }
}
