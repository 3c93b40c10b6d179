//! Functions of the pose as maps over the floor of the two rooms: in which room they live, and what they are there.

use faer::Mat;
use nalgebra::Point2;
use serde::{Deserialize, Serialize};

use super::{room_of, rooms};
use crate::experiment::lab::Lab;
use crate::experiment::maps::{Grid, HEADINGS, angle};
use crate::experiment::spans::{by_place, mean, standardised};
use crate::robot::Pose;

/// Steps in which values of maps are kept.
pub const STEP: f64 = 0.01;
/// A map is of one room if this share of its mean square lies there, and like a wave from this correlation on.
pub const OF_ROOM: f64 = 0.8;
pub const LIKE: f64 = 0.8;
/// A map tells rooms apart if its mean in each is at least this, of the standard deviation, with different signs.
pub const APART: f64 = 0.5;

/// A function of the pose, and where it lives.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Single {
    /// Slowness, 1/s²; of features on the training frames.
    pub slowness: f64,
    /// Share of its variance that depends on the place alone.
    pub by_place: f64,
    /// Means in the two rooms, in standard deviations of the map.
    pub means: [f64; 2],
    /// Shares of the map's mean square in the two rooms and in the corridor.
    pub shares: [f64; 3],
    /// The room of the larger share, the wave over that room that is most like the map there (half waves along x and y), and
    /// their correlation without its sign.
    pub wave: (usize, [usize; 2], f64),
    /// The optimal response that is most like it (from 1), and their correlation without its sign.
    pub best: (usize, f64),
    /// Share of its variance within the span of all candidates.
    pub explained: f64,
    /// The map, mean of headings, in whole steps of 0.01, at the places that the robot can reach.
    pub map: Vec<i16>,
}

impl Single {
    /// Whether most of it lies in one of the rooms.
    pub fn is_of_one_room(&self) -> bool {
        self.shares[..2].iter().any(|&share| share >= OF_ROOM)
    }

    /// Whether it is positive in one room and negative in the other.
    pub fn tells_rooms_apart(&self) -> bool {
        self.means[0] * self.means[1] < 0.0 && self.means.iter().all(|mean| mean.abs() >= APART)
    }

    /// Whether it lives in one room, and is a wave there.
    pub fn is_wave(&self, wave: [usize; 2]) -> bool {
        self.is_of_one_room() && self.wave.1 == wave && self.wave.2 >= LIKE
    }
}

/// Places of a grid that the robot can reach.
pub struct Floor {
    /// The grid.
    pub grid: Grid,
    /// Their numbers in the grid.
    pub inside: Vec<usize>,
    places: Vec<Point2<f64>>,
    rooms: Vec<Option<usize>>,
}

impl Floor {
    /// Those of a grid.
    pub fn new(lab: &Lab, grid: Grid) -> Self {
        // The first places of all poses are those of the first heading.
        let all: Vec<Point2<f64>> = grid.poses(lab)[..grid.places()].iter().map(|pose| pose.position).collect();
        let inside: Vec<usize> = (0..all.len()).filter(|&i| lab.world.plan.is_reachable(all[i])).collect();
        let places: Vec<Point2<f64>> = inside.iter().map(|&i| all[i]).collect();
        let rooms = places.iter().map(|&place| room_of(lab, place)).collect();
        Floor { grid, inside, places, rooms }
    }

    /// All poses: for each heading all places.
    pub fn poses(&self) -> Vec<Pose> {
        (0..HEADINGS).flat_map(|h| self.places.iter().map(move |&place| Pose::new(place, angle(h)))).collect()
    }

    /// Where a function lives, from its values at all poses, which have mean 0 over the floor as far as training went.
    pub fn look(&self, lab: &Lab, values: &[f64], slowness: f64) -> Single {
        let n = self.places.len();
        let map: Vec<f64> = (0..n).map(|p| mean((0..HEADINGS).map(|h| values[h * n + p]))).collect();
        let square = |values: &mut dyn Iterator<Item = f64>| values.map(|value| value * value).sum::<f64>();
        let all = square(&mut map.iter().copied()).max(f64::MIN_POSITIVE);
        let deviation = (all / n as f64).sqrt();
        let of = |room: usize| (0..n).filter(move |&p| self.rooms[p] == Some(room)).map(|p| map[p]);
        let shares = std::array::from_fn(|room| square(&mut of(room)) / all);
        let means = std::array::from_fn(|room| {
            let values: Vec<f64> = of(room).collect();
            values.iter().sum::<f64>() / values.len().max(1) as f64 / deviation
        });
        let room = usize::from(shares[1] > shares[0]);
        Single {
            slowness,
            by_place: by_place(values.iter().copied(), n),
            means,
            shares,
            wave: self.wave(lab, &map, room),
            best: (0, 0.0),
            explained: 0.0,
            map: map.iter().map(|value| (value / STEP).round() as i16).collect(),
        }
    }

    /// The wave over a room that is most like a map there.
    fn wave(&self, lab: &Lab, map: &[f64], room: usize) -> (usize, [usize; 2], f64) {
        const MOST: usize = 3;
        let inside: Vec<usize> = (0..map.len()).filter(|&p| self.rooms[p] == Some(room)).collect();
        let (radius, walls) = (lab.scenario.robot.radius, rooms(lab)[room]);
        let along = |place: Point2<f64>, axis: usize, waves: usize| {
            let (low, high) = (walls.low[axis] + radius, walls.high[axis] - radius);
            (std::f64::consts::PI * waves as f64 * (place[axis] - low) / (high - low)).cos()
        };
        let mut best = (room, [0, 0], 0.0);
        for (x, y) in (0..=MOST).flat_map(|x| (0..=MOST).map(move |y| (x, y))).skip(1) {
            let rows = Mat::from_fn(2, inside.len(), |i, j| {
                let place = self.places[inside[j]];
                if i == 0 { map[inside[j]] } else { along(place, 0, x) * along(place, 1, y) }
            });
            let rows = standardised(rows.as_ref());
            let correlation = (0..inside.len()).map(|j| rows[(0, j)] * rows[(1, j)]).sum::<f64>().abs();
            if correlation > best.2 {
                best = (room, [x, y], correlation);
            }
        }
        best
    }
}
