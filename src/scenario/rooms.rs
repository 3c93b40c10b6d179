//! `[[world.wall]]`, and `[[world.room]]`: rectangles whose union is free floor, with walls around it.
//!
//! Where rooms touch or overlap there is no wall between them. So a corridor is a room of its own, a door is a small one, and
//! two rooms that stand apart have a wall between them that is as thick as the gap.

use std::path::Path;

use nalgebra::Point2;

use super::keys::{Section, above};
use super::texture::{Defaults, Texture};

/// Sides of a room in the order of their walls: counter-clockwise, from the side of the smallest y.
pub const SIDES: [&str; 4] = ["south", "east", "north", "west"];

/// No room is smaller than this, metres.
const SMALLEST: f64 = 0.05;

/// `[[world.room]]`: a rectangle of floor.
#[derive(Debug, Clone, PartialEq)]
pub struct Room {
    /// Name, unique.
    pub name: String,
    /// Corner of the smallest coordinates, metres.
    pub low: [f64; 2],
    /// Corner of the largest coordinates, metres.
    pub high: [f64; 2],
    /// Height of its walls, metres.
    pub height: f64,
    /// Texture of each side, in the order of [`SIDES`].
    pub sides: [Texture; 4],
}

/// `[[world.wall]]`: a polyline that stands upright.
#[derive(Debug, Clone, PartialEq)]
pub struct Wall {
    /// Corners, metres.
    pub points: Vec<[f64; 2]>,
    /// Whether the last corner is joined to the first.
    pub closed: bool,
    /// Parts without a wall, from and to, metres along it, in order and apart from each other.
    pub gaps: Vec<[f64; 2]>,
    /// Height, metres.
    pub height: f64,
    /// Texture.
    pub texture: Texture,
}

impl Room {
    pub(super) fn read(s: &mut Section<'_, '_>, base: &Path, index: usize) -> Self {
        let name = s.text("name", &format!("room {}", index + 1), "unique name");
        let corners = s.points("corners", "two opposite corners of the floor");
        // Nothing is said of corners that could not be read at all.
        let (low, high) = match corners[..] {
            [] | [_] => ([0.0; 2], [1.0; 2]),
            [a, b] => ([0, 1].map(|axis| f64::min(a[axis], b[axis])), [0, 1].map(|axis| f64::max(a[axis], b[axis]))),
            [a, b, ..] => {
                let text = format!("has {} points: it must be two opposite corners, [[x, y], [x, y]]", corners.len());
                s.fault_here("corners", text);
                (a, b)
            }
        };
        let [width, depth] = [0, 1].map(|axis| high[axis] - low[axis]);
        if corners.len() == 2 && (width < SMALLEST || depth < SMALLEST) {
            let text = format!(
                "= {corners:?} is {width} m × {depth} m large: both sides of a room must be at least {SMALLEST} m long"
            );
            s.fault_here("corners", text);
        }
        let height = s.number("height", 0.9, "m", above(0.0, 100.0), "height of its walls");
        // Rooms differ as walls do.
        let paper = Texture::read(s, base, Defaults::wall(index));
        let sides = std::array::from_fn(|side| {
            let doc = format!("its {} wall, where that has another texture", SIDES[side]);
            s.inner(SIDES[side], &doc, |s| Texture::read(s, base, Defaults::side(&paper, side)))
        });
        Room { name, low, high, height, sides }
    }

    /// Whether a point is on its floor, walls included.
    pub fn contains(&self, point: Point2<f64>) -> bool {
        (0..2).all(|axis| (self.low[axis]..=self.high[axis]).contains(&point[axis]))
    }
}

/// The walls around the union of some rooms: four for each room, in the order of [`SIDES`], each with a gap where another
/// room joins in.
pub fn walls_of(rooms: &[Room]) -> Vec<Wall> {
    let walls = rooms.iter().enumerate().flat_map(|(index, room)| {
        let [[x0, y0], [x1, y1]] = [room.low, room.high];
        let corners = [[x0, y0], [x1, y0], [x1, y1], [x0, y1]];
        (0..4).map(move |side| Wall {
            points: vec![corners[side], corners[(side + 1) % 4]],
            closed: false,
            gaps: gaps(rooms, index, side),
            height: room.height,
            texture: room.sides[side].clone(),
        })
    });
    walls.collect()
}

/// Parts of a room's side without a wall, from and to, metres along the side, in order and apart from each other.
fn gaps(rooms: &[Room], index: usize, side: usize) -> Vec<[f64; 2]> {
    let room = &rooms[index];
    // South and north run along x, east and west along y; east and north lie where coordinates are largest.
    let (along, across) = (side % 2, 1 - side % 2);
    let upper = side == 1 || side == 2;
    let at = if upper { room.high[across] } else { room.low[across] };
    let mut open: Vec<[f64; 2]> = Vec::new();
    for (number, other) in rooms.iter().enumerate().filter(|&(number, _)| number != index) {
        let (low, high) = (other.low[across], other.high[across]);
        // The floor goes on right behind this side; or the other room has the same wall, and it stands only once.
        let behind = if upper { low <= at && at < high } else { low < at && at <= high };
        let same = number < index && at == if upper { high } else { low };
        let (from, to) = (other.low[along].max(room.low[along]), other.high[along].min(room.high[along]));
        if (behind || same) && from < to {
            // Along the wall as its points run: sides in the north and west run backwards.
            let start = if side < 2 { from - room.low[along] } else { room.high[along] - to };
            open.push([start, start + (to - from)]);
        }
    }
    open.sort_by(|a, b| a[0].total_cmp(&b[0]));
    let mut joined: Vec<[f64; 2]> = Vec::new();
    for gap in open {
        match joined.last_mut() {
            Some(last) if gap[0] <= last[1] => last[1] = last[1].max(gap[1]),
            _ => joined.push(gap),
        }
    }
    joined
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scenario::{Pattern, plan_segments};

    fn room(name: &str, low: [f64; 2], high: [f64; 2]) -> Room {
        let plain = Texture {
            image: None,
            pattern: Pattern::Plain,
            scale: 1.0,
            hue: 0.0,
            hue_spread: 0.0,
            contrast: 0.0,
            seed: 0,
        };
        Room { name: name.into(), low, high, height: 1.0, sides: std::array::from_fn(|_| plain.clone()) }
    }

    #[test]
    fn a_corridor_opens_both_of_its_ends_and_no_more() {
        let rooms = [
            room("left", [0.0, 0.0], [4.0, 4.0]),
            room("right", [6.0, 0.0], [10.0, 4.0]),
            room("corridor", [4.0, 1.5], [6.0, 2.5]),
        ];
        let gaps: Vec<Vec<[f64; 2]>> = walls_of(&rooms).into_iter().map(|wall| wall.gaps).collect();
        let open = |room: usize, side: usize| gaps[4 * room + side].clone();
        assert_eq!(open(0, 1), [[1.5, 2.5]]);
        // The west wall runs from north to south.
        assert_eq!(open(1, 3), [[1.5, 2.5]]);
        assert_eq!((open(2, 1), open(2, 3)), (vec![[0.0, 1.0]], vec![[0.0, 1.0]]));
        assert_eq!(gaps.iter().filter(|gaps| !gaps.is_empty()).count(), 4);
        let length = |wall: &Wall| plan_segments(wall).iter().map(|(a, b)| (b - a).norm()).sum::<f64>();
        let total: f64 = walls_of(&rooms).iter().map(length).sum();
        // Two squares less the doors, and the corridor's long sides.
        assert!((total - (2.0 * 16.0 - 2.0 + 4.0)).abs() < 1e-12, "{total}");
    }

    #[test]
    fn rooms_that_overlap_have_one_outline() {
        // An L of two arms that share a corner: its outline is that of the box around it.
        let rooms = [room("arm", [0.0, 0.0], [5.0, 2.0]), room("other", [0.0, 0.0], [2.0, 5.0])];
        let walls = walls_of(&rooms);
        let length: f64 = walls.iter().flat_map(plan_segments).map(|(a, b)| (b - a).norm()).sum();
        assert!((length - 20.0).abs() < 1e-12, "{length}");
    }
}
