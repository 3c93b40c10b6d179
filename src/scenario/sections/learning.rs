//! `[dictionary]`, `[slow]`, `[value]`: what is learned.

use crate::dictionary::WhenFull;
use crate::scenario::keys::{Section, above, within};

/// `[dictionary]`
#[derive(Debug, Clone, PartialEq)]
pub struct Dictionary {
    /// How support vectors are chosen.
    pub selection: SelectionRule,
    /// Exponent of the radial kernel.
    pub exponent: f64,
    /// Kernel width in grey levels; `None`: the one at which `sigma_share` of the first frames become support vectors,
    /// but at least half of their median distance.
    pub sigma: Option<f64>,
    /// With an automatic width: the share of the first frames that become support vectors.
    pub sigma_share: f64,
    /// With an automatic width: measured over this many first frames, see [`looks_again`](Dictionary::looks_again).
    pub sigma_frames: usize,
    /// Acceptance threshold ν.
    pub nu: f64,
    /// Largest number of support vectors.
    pub budget: usize,
    /// What happens when there are that many.
    pub when_full: WhenFull,
    /// Frames that are handled together.
    pub block_frames: usize,
    /// Frames whose coordinates are kept for filling in new ones.
    pub retained_frames: usize,
}

/// An automatic width is looked at again when there are so many times as many frames, and three quarters of the share are to become support
/// vectors then.
const LOOK_AGAIN: usize = 4;
const SHARE_THEN: f64 = 0.75;
/// It is not, where that would be more frames.
const MOST_FIRST: usize = 5000;

impl Dictionary {
    /// The number of frames after which an automatic width is looked at again, and the share of them that is to become support vectors;
    /// `None`: it is not.
    pub fn looks_again(&self) -> Option<(usize, f64)> {
        let frames = LOOK_AGAIN * self.sigma_frames;
        (self.sigma.is_none() && frames <= MOST_FIRST).then_some((frames, SHARE_THEN * self.sigma_share))
    }
}

/// How support vectors are chosen.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SelectionRule {
    /// Approximate linear dependence.
    Ald,
    /// A random sample of all frames so far.
    Random,
}

/// `[slow]`
#[derive(Debug, Clone, PartialEq)]
pub struct Slow {
    /// Number of slow features.
    pub features: usize,
    /// Regulariser λ.
    pub lambda: f64,
    /// Weight of derivatives while moving; turning has weight 1.
    pub move_weight: f64,
    /// Time constant with which frames fade; `None`: never.
    pub memory_frames: Option<f64>,
}

/// A world of so many rooms is a building: two and a door.
const SEVERAL_ROOMS: usize = 3;

/// Transitions in the window, unless the scenario says how many.
const WINDOW: usize = 20_000;

/// The same at most, where a map of places is made of them.
const MOST_OF_MAP: usize = 100_000;

/// `[value]`
#[derive(Debug, Clone, PartialEq)]
pub struct Value {
    /// How values are found.
    pub method: Method,
    /// Discount per action.
    pub gamma: f64,
    /// Transitions in the window.
    pub window: usize,
    /// Local values: neighbouring transitions for the value of an action.
    pub neighbours: usize,
    /// Local values: slowest features that define the distance of states.
    pub metric_features: usize,
    /// Local values: whether states are told by where the robot is as well, by the way that it came.
    pub places: bool,
    /// Places: whether odometry tells what actions did, where there is any, and not what they were told to do.
    pub odometry: bool,
    /// Local values: ridge on the slopes of the regression, in mean squared distances of the neighbours.
    pub local_ridge: f64,
    /// LSPI: ridge on the diagonal of the summed system.
    pub ridge: f64,
    /// LSPI: share of the greedy policy in each step of policy iteration.
    pub mixing: f64,
    /// LSPI: largest number of policy evaluations.
    pub max_iterations: usize,
    /// LSPI: relative change of weights that counts as converged.
    pub tolerance: f64,
    /// LSPI: 0: transitions weigh alike; 1: every (cell, action) weighs alike.
    pub balance: f64,
}

/// How values are found.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Method {
    /// From the transitions nearby, by local regression: [`Local`](crate::value::Local).
    Local,
    /// Linear in all features, by least-squares policy iteration: [`Lspi`](crate::value::Lspi).
    Lspi,
}

impl Dictionary {
    pub(super) fn read(s: &mut Section<'_, '_>) -> Self {
        let selection = s.choice(
            "selection",
            &[("ald", SelectionRule::Ald), ("random", SelectionRule::Random)],
            "how support vectors are chosen: what the others do not span up to nu, or a random sample of all frames",
        );
        let exponent = s.choice("kernel", &[("gaussian", 2.0), ("laplacian", 1.0)], "radial kernel");
        Dictionary {
            selection,
            exponent,
            sigma: s.number_or_auto(
                "sigma",
                "grey levels",
                above(0.0, 1e9),
                "kernel width, as a distance of observations",
            ),
            sigma_share: s.number(
                "sigma_share",
                0.65,
                "",
                above(0.0, 1.0),
                "sigma = \"auto\": the width (at least half the median distance) at which this share of the first frames become support vectors",
            ),
            sigma_frames: s.count("sigma_frames", 1000, "frames", 2..=5000, "sigma = \"auto\": first frames"),
            nu: s.number("nu", 0.01, "", above(0.0, 0.999), "a frame is accepted when its residual is above"),
            budget: s.count("budget", 2000, "", 10..=20_000, "largest number of support vectors"),
            when_full: s.choice(
                "when_full",
                &[("stop", WhenFull::Stop), ("raise_nu", WhenFull::RaiseNu), ("replace", WhenFull::Replace)],
                "selection = \"ald\", at the budget: stop growing, raise nu and thin out, or let the least independent go"),
            block_frames: s.count("block_frames", 128, "frames", 1..=4096, "frames that are handled together"),
            retained_frames: s.count(
                "retained_frames",
                20_000,
                "frames",
                1..=10_000_000,
                "newest frames for which new coordinates are filled in"),
        }
    }
}

impl Slow {
    pub(super) fn read(s: &mut Section<'_, '_>) -> Self {
        let features = s.count("features", 200, "", 1..=5000, "number of slow features");
        let lambda = s.number("lambda", 1e-7, "1/s²", above(0.0, 1e6), "regulariser");
        let move_weight = s.number(
            "move_weight",
            5.0,
            "",
            above(0.0, 1e6),
            "weight of derivatives while moving; turning has weight 1",
        );
        let memory = s.number(
            "memory_frames",
            0.0,
            "frames",
            within(0.0, 1e12),
            "frames fade with this time constant; 0: never",
        );
        Slow { features, lambda, move_weight, memory_frames: (memory > 0.0).then_some(memory) }
    }
}

impl Value {
    /// `rooms`: how many there are in the world; `actions`: those of the run.
    pub(super) fn read(s: &mut Section<'_, '_>, rooms: usize, actions: usize) -> Self {
        let method = s.choice(
            "method",
            &[("local", Method::Local), ("lspi", Method::Lspi)],
            "values by regression on transitions nearby, or linear in all features",
        );
        let gamma = s.number("gamma", 0.9, "per action", within(0.0, 0.9999), "discount");
        let places = s.flag(
            "places",
            rooms >= SEVERAL_ROOMS,
            "local: states are told apart by where the robot is, too, by the way that it came; true where world.room is given three times or more",
        );
        // A map has only what the window holds: who forgets half of a building can no longer go there.
        let window = if places { actions.clamp(WINDOW, MOST_OF_MAP) } else { WINDOW };
        Value {
            method,
            gamma,
            window: s.count(
                "window",
                window,
                "transitions",
                10..=10_000_000,
                "rolling window; with places as many as actions, from 20 000 to 100 000, by default",
            ),
            neighbours: s.count(
                "neighbours",
                16,
                "transitions",
                1..=1000,
                "local: neighbours for the value of an action",
            ),
            metric_features: s.count(
                "metric_features",
                40,
                "",
                1..=5000,
                "local: slowest features that define the distance of states",
            ),
            places,
            odometry: s.flag(
                "odometry",
                true,
                "places: what actions did is told by odometry, where there is any; false: by what they were told to do",
            ),
            local_ridge: s.number(
                "local_ridge",
                0.3,
                "mean squared distances",
                above(0.0, 1e9),
                "local: on the slopes of the regression",
            ),
            ridge: s.number("ridge", 0.1, "", within(0.0, 1e9), "lspi: on the diagonal of the summed system"),
            mixing: s.number("mixing", 0.3, "", above(0.0, 1.0), "lspi: share of the greedy policy in each iteration"),
            max_iterations: s.count("max_iterations", 40, "", 1..=10_000, "lspi: largest number of policy evaluations"),
            tolerance: s.number("tolerance", 1e-3, "", above(0.0, 1.0), "lspi: change of weights that counts as none"),
            balance: s.number(
                "balance",
                0.5,
                "",
                within(0.0, 1.0),
                "lspi: 0: transitions weigh alike, 1: every (cell, action) weighs alike",
            ),
        }
    }
}
