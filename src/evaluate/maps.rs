//! What was learned, looked at from every place of an even grid and eight headings: the thesis's test maps.

use std::f64::consts::TAU;

use faer::Par;
use rayon::prelude::*;

use crate::policy::{Learned, columns};
use crate::robot::Pose;
use crate::scenario::{Detail, Scenario};
use crate::vision::{Image, Observation, observe};
use crate::world::{Appearance, World};

/// Headings, counter-clockwise from the x-axis.
pub const HEADINGS: usize = 8;

/// Features whose maps are kept.
pub const FEATURES: usize = 12;

/// Places that are looked at together: with all headings as many images as one matrix product has columns.
const BLOCK: usize = 32;

/// How fine maps are.
#[derive(Debug, Clone, Copy)]
pub struct Fineness {
    /// Places along the longer and the shorter side of the room.
    pub places: [usize; 2],
    /// More products than this, and the grid is made coarser.
    pub most_products: f64,
    /// Camera images of more pixels are rendered as coarsely as vision allows.
    pub most_pixels: usize,
}

impl Fineness {
    /// That of the thesis, as far as two cores compute it in some ten seconds.
    ///
    /// # Reference
    /// Thesis §5.2: "8 test maps (in 45° steps) with 64 × 32 equidistant coordinates".
    pub const FULL: Fineness = Fineness { places: [64, 32], most_products: 2e12, most_pixels: 640 * 480 };
}

/// Points on an even grid in a box, row by row from the lowest y, each from the lowest x.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Grid {
    /// Points along x.
    pub columns: usize,
    /// Points along y.
    pub rows: usize,
    /// Lowest corner of the box; the points are the centres of its cells.
    pub low: [f64; 2],
    /// Highest corner.
    pub high: [f64; 2],
}

impl Grid {
    /// Distance of neighbours along x and y.
    pub fn step(&self) -> [f64; 2] {
        [(self.high[0] - self.low[0]) / self.columns as f64, (self.high[1] - self.low[1]) / self.rows as f64]
    }

    /// All points in their order.
    pub fn points(self) -> impl Iterator<Item = [f64; 2]> {
        let step = self.step();
        let at = move |i: usize, j: usize| {
            [self.low[0] + (i as f64 + 0.5) * step[0], self.low[1] + (j as f64 + 0.5) * step[1]]
        };
        (0..self.rows).flat_map(move |j| (0..self.columns).map(move |i| at(i, j)))
    }
}

/// Numbers of a map, one for each place; NaN where the robot cannot be.
pub type Map = Vec<f64>;

/// What was learned, at all places and headings.
#[derive(Debug, Clone)]
pub struct RoomMaps {
    /// The places.
    pub grid: Grid,
    /// Of the first features, without the constant one, a map for each heading.
    pub features: Vec<[Map; HEADINGS]>,
    /// Of each task, the value of the best action, a map for each heading.
    pub values: Vec<[Map; HEADINGS]>,
    /// Of each task, the number of the best action, a map for each heading.
    pub best: Vec<[Map; HEADINGS]>,
    /// Of each task whose goal was shown, the share of headings at which the agent says that it is there.
    pub there: Vec<Option<Map>>,
    /// Whether images were rendered for vision alone.
    pub coarse: bool,
}

/// The angle of a heading, radians.
pub fn angle(heading: usize) -> f64 {
    TAU * heading as f64 / HEADINGS as f64
}

/// What one place shows at one heading: features, then for each task the value and number of the best action.
struct View {
    features: Vec<f64>,
    tasks: Vec<(f64, usize)>,
    /// For each task, whether the agent says that this is the goal.
    there: Vec<bool>,
}

impl RoomMaps {
    /// Look around at every place of a grid that the robot can reach, through a camera without noise.
    pub fn new(fineness: Fineness, scenario: &Scenario, world: &World, learned: &Learned) -> Self {
        let grid = grid(fineness, world, learned);
        let pixels = scenario.camera.width * scenario.camera.height;
        let coarse = scenario.camera.detail == Detail::Full && pixels > fineness.most_pixels;
        let own = coarse.then(|| {
            let mut scenario = scenario.clone();
            scenario.camera.detail = Detail::Vision;
            Appearance::new(&scenario).ok()
        });
        let own = own.flatten();
        let (seen_by, frame) = (own.as_ref().unwrap_or(&world.appearance), learned.asked_at + 1);
        let places: Vec<[f64; 2]> = grid.points().collect();
        let inside: Vec<usize> = (0..places.len()).filter(|&i| world.plan.is_reachable(places[i].into())).collect();
        let shown = FEATURES.min(learned.model.slowness.len());
        let look = |block: &[usize]| -> Vec<View> {
            let pose = |i: usize, h: usize| Pose::new(places[i].into(), angle(h));
            let mut poses: Vec<Pose> = block.iter().flat_map(|&i| (0..HEADINGS).map(move |h| pose(i, h))).collect();
            let observe = |_: &mut Pose, image: &mut Image| observe(image, &scenario.vision, 0);
            looks_of(learned, &seen_by.see_all(frame, &mut poses, |&pose| (pose, 0), observe), shown)
        };
        let looked: Vec<Vec<View>> = inside.par_chunks(BLOCK).map(look).collect();
        let empty = || std::array::from_fn(|_| vec![f64::NAN; places.len()]);
        let tasks = learned.weights.len();
        let mut nowhere = vec![f64::NAN; places.len()];
        inside.iter().for_each(|&place| nowhere[place] = 0.0);
        let mut room_maps = RoomMaps {
            grid,
            features: (0..shown).map(|_| empty()).collect(),
            values: (0..tasks).map(|_| empty()).collect(),
            best: (0..tasks).map(|_| empty()).collect(),
            there: learned.regions.iter().map(|region| region.as_ref().map(|_| nowhere.clone())).collect(),
            coarse: own.is_some(),
        };
        for (number, look) in looked.iter().flatten().enumerate() {
            let (place, heading) = (inside[number / HEADINGS], number % HEADINGS);
            for (maps, &value) in room_maps.features.iter_mut().zip(&look.features) {
                maps[heading][place] = value;
            }
            for (task, &(value, action)) in look.tasks.iter().enumerate() {
                room_maps.values[task][heading][place] = value;
                room_maps.best[task][heading][place] = action as f64;
            }
            for (there, &inside) in room_maps.there.iter_mut().zip(&look.there) {
                if let Some(there) = there {
                    there[place] += f64::from(u8::from(inside)) / HEADINGS as f64;
                }
            }
        }
        room_maps
    }

    /// Value of a task at each place, mean over all headings, and the heading of the highest value.
    pub fn worth(&self, task: usize) -> Vec<(f64, usize)> {
        let maps = &self.values[task];
        (0..maps[0].len())
            .map(|place| {
                let best = (0..HEADINGS).max_by(|&a, &b| maps[a][place].total_cmp(&maps[b][place])).unwrap_or(0);
                (maps.iter().map(|map| map[place]).sum::<f64>() / HEADINGS as f64, best)
            })
            .collect()
    }
}

/// The places of the maps, the longer side along the room's.
fn grid(fineness: Fineness, world: &World, learned: &Learned) -> Grid {
    let (low, high) = world.plan.reachable_box();
    let size = high - low;
    let [longer, shorter] = fineness.places;
    let (mut columns, mut rows) = if size.x >= size.y { (longer, shorter) } else { (shorter, longer) };
    let members = learned.model.members.as_ref().as_ref();
    let products = |places: usize| (places * HEADINGS) as f64 * members.nrows() as f64 * members.ncols() as f64;
    while products(columns * rows) > fineness.most_products && columns.min(rows) > 8 {
        (columns, rows) = (columns / 2, rows / 2);
    }
    Grid { columns, rows, low: low.into(), high: high.into() }
}

/// Features of observations, and what the policies make of them.
fn looks_of(learned: &Learned, seen: &[Observation], shown: usize) -> Vec<View> {
    let phi = learned.features(columns(seen.iter()).as_ref(), Par::Seq);
    let values = learned.q_values_of(phi.as_ref());
    let best = |values: &faer::Mat<f64>, j: usize| {
        let q = (0..values.nrows()).map(|a| values[(a, j)]).enumerate();
        q.fold((f64::NEG_INFINITY, 0), |best, (a, q)| if q > best.0 { (q, a) } else { best })
    };
    let there: Vec<Vec<bool>> =
        (0..learned.regions.len()).map(|place| learned.are_there(phi.as_ref(), place)).collect();
    (0..seen.len())
        .map(|j| View {
            // The first feature is the constant one.
            features: (0..shown).map(|i| phi[(i + 1, j)]).collect(),
            tasks: values.iter().map(|values| best(values, j)).collect(),
            there: there.iter().map(|there| there[j]).collect(),
        })
        .collect()
}

/// Features of recorded observations, `shown` for each, where there is no world to look at.
pub fn features_of(learned: &Learned, seen: &[Observation], shown: usize) -> Vec<Vec<f64>> {
    let blocks = seen.par_chunks(BLOCK * HEADINGS);
    blocks.flat_map_iter(|block| looks_of(learned, block, shown)).map(|look| look.features).collect()
}
