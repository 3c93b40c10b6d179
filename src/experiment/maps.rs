//! Features over the room: test maps as the thesis prints them, and trajectories, as SVG.

use std::fmt::Write as _;

use image::ExtendedColorType;
use nalgebra::Point2;
use serde::{Deserialize, Serialize};

use super::ExperimentError;
use super::lab::Lab;
// Those of a test map (thesis §5.1.5).
pub use crate::evaluate::{HEADINGS, angle};
use crate::report::draw::{DrawError, data_url, escape, png_bytes};
use crate::robot::Pose;
use crate::scenario::{Task, plan_segments};

/// Places of a test map: a grid over everything that the robot can reach, each place with all headings.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Grid {
    /// Places along x.
    pub width: usize,
    /// Places along y.
    pub height: usize,
}

impl Grid {
    /// All poses: for each heading all places, row by row from the lowest y.
    pub fn poses(self, lab: &Lab) -> Vec<Pose> {
        let (low, high) = lab.world.plan.reachable_box();
        let at = |i: usize, n: usize, axis: usize| low[axis] + (high[axis] - low[axis]) * (i as f64 + 0.5) / n as f64;
        let mut poses = Vec::with_capacity(self.places() * HEADINGS);
        for heading in 0..HEADINGS {
            for row in 0..self.height {
                for column in 0..self.width {
                    let place = Point2::new(at(column, self.width, 0), at(row, self.height, 1));
                    poses.push(Pose::new(place, angle(heading)));
                }
            }
        }
        poses
    }

    /// Places of one heading.
    pub fn places(self) -> usize {
        self.width * self.height
    }
}

/// One picture of a sheet: a name, and values at the places of a grid; `None`: nothing there.
pub struct Map {
    /// What stands above it.
    pub name: String,
    /// Values, row by row from the lowest y.
    pub values: Vec<Option<f64>>,
}

/// Pixels of a place's longer side, at most; of the space around a map; and of the line above it.
const MAP_WIDTH: f64 = 170.0;
const GAP: f64 = 14.0;
const HEAD: f64 = 16.0;

/// Maps in lines, blue below zero, red above; all maps of a line have one scale. The name of its file, and an SVG text.
///
/// `aspect`: height of the room by its width. Each map is a grid of `grid`.
pub fn sheet(
    file: &str,
    title: &str,
    (grid, aspect): (Grid, f64),
    lines: &[Vec<Map>],
) -> Result<(String, String), ExperimentError> {
    let columns = lines.iter().map(Vec::len).max().unwrap_or(0);
    let (wide, high) = (MAP_WIDTH, MAP_WIDTH * aspect);
    let width = columns as f64 * (wide + GAP) + GAP;
    let height = 34.0 + lines.len() as f64 * (high + HEAD + GAP);
    let mut svg = head(width, height, title);
    for (row, line) in lines.iter().enumerate() {
        let values = line.iter().flat_map(|map| &map.values).flatten();
        let largest = values.fold(0.0f64, |largest, value| largest.max(value.abs()));
        for (column, map) in line.iter().enumerate() {
            let (left, top) = (GAP + column as f64 * (wide + GAP), 34.0 + row as f64 * (high + HEAD + GAP));
            let _ = write!(
                svg,
                "<text x=\"{left:.1}\" y=\"{:.1}\" font-size=\"12\">{}</text>",
                top + 11.0,
                escape(&map.name)
            );
            // One pixel for each place, whatever the size of the picture.
            let _ = writeln!(
                svg,
                "<image x=\"{left:.1}\" y=\"{:.1}\" width=\"{wide:.1}\" height=\"{high:.1}\" preserveAspectRatio=\"none\" \
                 style=\"image-rendering: pixelated\" href=\"{}\"/>",
                top + HEAD,
                data_url(&png(map, grid, largest)?)
            );
        }
    }
    Ok((file.to_owned(), svg + "</svg>\n"))
}

/// A map as a PNG image, a pixel for each place; the y axis points up.
fn png(map: &Map, grid: Grid, largest: f64) -> Result<Vec<u8>, DrawError> {
    let mut pixels = Vec::with_capacity(4 * grid.places());
    for row in (0..grid.height).rev() {
        for value in &map.values[row * grid.width..(row + 1) * grid.width] {
            let [r, g, b] = colour(value.unwrap_or(0.0) / largest.max(f64::MIN_POSITIVE));
            pixels.extend([r, g, b, if value.is_some() { 255 } else { 0 }]);
        }
    }
    png_bytes((grid.width, grid.height), &pixels, ExtendedColorType::Rgba8)
}

/// From blue (−1) over white (0) to red (1).
fn colour(share: f64) -> [u8; 3] {
    let share = share.clamp(-1.0, 1.0);
    let ends = if share < 0.0 { [38.0, 92.0, 168.0] } else { [190.0, 40.0, 46.0] };
    ends.map(|end| (255.0 + (end - 255.0) * share.abs()).round() as u8)
}

fn head(width: f64, height: f64, title: &str) -> String {
    format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{width:.0}\" height=\"{height:.0}\" viewBox=\"0 0 {width:.0} \
         {height:.0}\" font-family=\"sans-serif\" fill=\"#282c34\">\n<rect width=\"100%\" height=\"100%\" fill=\"white\"/>\n\
         <text x=\"14\" y=\"22\" font-size=\"16\">{}</text>\n",
        escape(title)
    )
}

/// A way through the room, for [`room`].
pub struct Way {
    /// Its poses.
    pub poses: Vec<Pose>,
    /// Steps, if it arrived.
    pub steps: Option<usize>,
}

/// Trajectories in a room seen from above, one room beside the other: triangles mark starts, numbers the steps of ways that
/// arrived; ways that did not are grey.
pub fn rooms(title: &str, lab: &Lab, rooms: &[(&Task, String, Vec<Way>)]) -> String {
    let (low, high) = lab.world.plan.walls_box();
    let scale = 560.0 / (high.x - low.x);
    let (wide, tall) = (560.0, (high.y - low.y) * scale);
    let mut svg = head(rooms.len() as f64 * (wide + 2.0 * GAP), tall + 34.0 + HEAD + 2.0 * GAP, title);
    for (number, (task, name, ways)) in rooms.iter().enumerate() {
        let (left, top) = (GAP + number as f64 * (wide + 2.0 * GAP), 34.0 + HEAD + GAP);
        let place = |point: Point2<f64>| (left + (point.x - low.x) * scale, top + (high.y - point.y) * scale);
        let _ = writeln!(svg, "<text x=\"{left:.1}\" y=\"{:.1}\" font-size=\"13\">{}</text>", top - 8.0, escape(name));
        let goal = task.goal.map(|goal| place(goal.into()));
        if let Some((x, y)) = goal {
            let _ = writeln!(
                svg,
                "<circle cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"{:.1}\" fill=\"#e9b0a8\"/>",
                task.radius * scale
            );
        }
        for (a, b) in lab.scenario.world.walls.iter().flat_map(plan_segments) {
            let ((ax, ay), (bx, by)) = (place(a), place(b));
            let _ = writeln!(
                svg,
                "<line x1=\"{ax:.1}\" y1=\"{ay:.1}\" x2=\"{bx:.1}\" y2=\"{by:.1}\" stroke=\"#282c34\" stroke-width=\"2\"/>"
            );
        }
        for way in ways {
            draw_way(&mut svg, way, place);
        }
    }
    svg + "</svg>\n"
}

fn draw_way(svg: &mut String, way: &Way, place: impl Fn(Point2<f64>) -> (f64, f64)) {
    let point = |(x, y): (f64, f64)| format!("{x:.1},{y:.1}");
    let points: Vec<String> = way.poses.iter().map(|pose| point(place(pose.position))).collect();
    let stroke = if way.steps.is_some() { "#0072b2" } else { "#8a8a8a" };
    let _ = writeln!(
        svg,
        "<polyline points=\"{}\" fill=\"none\" stroke=\"{stroke}\" stroke-width=\"1.5\"/>",
        points.join(" ")
    );
    let Some(start) = way.poses.first() else { return };
    let (x, y) = place(start.position);
    let tip = |angle: f64, length: f64| {
        let heading = start.heading + angle;
        point((x + length * heading.cos(), y - length * heading.sin()))
    };
    let triangle = [tip(0.0, 9.0), tip(2.5, 7.0), tip(-2.5, 7.0)].join(" ");
    let _ = writeln!(svg, "<polygon points=\"{triangle}\" fill=\"{stroke}\"/>");
    if let Some(steps) = way.steps {
        let (dx, dy) = (-14.0 * start.heading.cos() - 4.0, 14.0 * start.heading.sin() + 4.0);
        let _ = writeln!(svg, "<text x=\"{:.1}\" y=\"{:.1}\" font-size=\"12\">{steps}</text>", x + dx, y + dy);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use base64::Engine as _;
    use base64::engine::general_purpose::STANDARD;

    #[test]
    fn a_sheet_has_a_pixel_for_each_value_in_its_colour() {
        let map = Map { name: "φ < 1".into(), values: vec![Some(-2.0), Some(1.0), None, Some(0.0)] };
        let (_, svg) = sheet("a.svg", "Title", (Grid { width: 2, height: 2 }, 0.6), &[vec![map]]).unwrap();
        let document = roxmltree::Document::parse(&svg).unwrap();
        let image = document.descendants().find(|node| node.has_tag_name("image")).unwrap();
        let encoded = image.attribute("href").unwrap().strip_prefix("data:image/png;base64,").unwrap();
        let pixels = image::load_from_memory(&STANDARD.decode(encoded).unwrap()).unwrap().to_rgba8();
        // The upper row is that of the larger y.
        assert_eq!(pixels.get_pixel(0, 1).0, [38, 92, 168, 255]);
        assert_eq!(pixels.get_pixel(1, 1).0, [223, 148, 151, 255]);
        assert_eq!((pixels.get_pixel(0, 0).0[3], pixels.get_pixel(1, 0).0), (0, [255; 4]));
    }
}
