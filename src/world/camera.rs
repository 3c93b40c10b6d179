//! What the robot's camera sees: a deterministic software renderer.
//!
//! Perspective without roll or pitch. Each image column is one ray on the floor plan; along it the walls are known in the
//! order of their distance, and the column is painted from near to far, each pixel once: floor, walls, surroundings.
//! Coordinates on surfaces are whole numbers, with the period of the pattern as 2³², so that patterns repeat by overflow and
//! all arithmetic is the same on every machine.
//!
//! What depends on the settings alone is computed once. Columns are painted in tiles that stay in the cache, whose rows are
//! then copied into the image.

use nalgebra::{Point2, Vector2};

use super::distractors::Present;
use super::pyramids::Pyramid;
use super::texture::{Span, TextureMap, fixed};
use crate::robot::Pose;
use crate::scenario::{self, Detail, Scenario, plan_pieces};
use crate::vision::Image;

/// Columns of a tile.
const TILE: usize = 16;

/// Rays that miss the end of a wall by less than this (metres) hit it, so that no ray slips through a corner.
const SLACK: f64 = 1e-9;

/// Bits after the point in distances on the floor: 15 µm.
const FLOOR_FRACTION: u32 = 16;

pub(super) struct Panel {
    pub(super) from: Point2<f64>,
    pub(super) along: Vector2<f64>,
    pub(super) length: f64,
    /// Distance along the wall at which the panel begins.
    pub(super) offset: f64,
    pub(super) wall: usize,
}

/// A panel as seen from a pose. For the ray `ahead + aside · right`, its depth is `gap / across` and the place on the
/// panel is `place / across`, where both are linear in `aside`; signs are such that `gap` is positive.
struct View<'a> {
    panel: &'a Panel,
    gap: f64,
    across: [f64; 2],
    place: [f64; 2],
}

/// Where the ray of an image column crosses a wall.
struct Hit {
    /// Distance along the camera's axis, metres.
    depth: f64,
    wall: usize,
    /// Metres along the wall.
    along: f64,
}

/// What the ray of an image column has from the settings alone.
pub(super) struct Column {
    /// Metres to the right per metre of depth.
    pub(super) aside: f64,
    /// Angle to the right of the camera's axis, degrees.
    pub(super) bearing: f64,
    /// Degrees of elevation near the horizon for each unit of slope.
    pub(super) degrees: f64,
}

/// The renderer of a scenario's world.
pub struct Camera {
    pub(super) settings: scenario::Camera,
    pub(super) columns: Vec<Column>,
    pub(super) height: usize,
    /// Rise of the top row's rays per metre of depth, and by how much each row below rises less.
    pub(super) slope: f64,
    pub(super) fall: f64,
    /// The first row that looks down.
    pub(super) horizon: usize,
    /// Depth at which each row from the horizon on meets the floor, metres, with [`FLOOR_FRACTION`].
    floor_depths: Vec<u64>,
    pub(super) panels: Vec<Panel>,
    pub(super) walls: Vec<(f64, TextureMap)>,
    pub(super) pyramids: Vec<Pyramid>,
    pub(super) floor: TextureMap,
    pub(super) surroundings: TextureMap,
}

impl std::fmt::Debug for Camera {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "Camera({} × {}, {} panels)", self.columns.len(), self.height, self.panels.len())
    }
}

impl Camera {
    /// The renderer for a scenario.
    ///
    /// # Errors
    /// A texture file that cannot be read.
    pub fn new(scenario: &Scenario) -> Result<Self, image::ImageError> {
        let mut panels = Vec::new();
        let mut walls = Vec::new();
        for (index, wall) in scenario.world.walls.iter().enumerate() {
            let mut whole = 0.0;
            for (a, b, offset) in plan_pieces(wall) {
                let length = (b - a).norm();
                whole = offset + length;
                if length > 0.0 {
                    panels.push(Panel { from: a, along: (b - a) / length, length, offset, wall: index });
                }
            }
            walls.push((wall.height, TextureMap::new(&wall.texture, Span::Wall(whole))?));
        }
        let (settings, vision) = (&scenario.camera, &scenario.vision);
        let (full_width, full_height) = (settings.width as f64, settings.height as f64);
        // The rendered image covers all columns of the full one, and its rows from `top` on.
        let (width, height) = settings.rendered(vision);
        let top = if settings.detail == Detail::Full { 0.0 } else { vision.cut_rows as f64 };
        let focal = 0.5 * full_width / (0.5 * settings.field_of_view_deg.to_radians()).tan();
        let columns = (0..width)
            .map(|column| {
                let aside = ((column as f64 + 0.5) * full_width / width as f64 - 0.5 * full_width) / focal;
                let degrees = (1.0 / (1.0 + aside * aside).sqrt()).to_degrees();
                Column { aside, bearing: aside.atan().to_degrees(), degrees }
            })
            .collect();
        let fall = (full_height - top) / height as f64 / focal;
        let slope = (0.5 * full_height - top) / focal - 0.5 * fall;
        let down = |row: &usize| slope - *row as f64 * fall < 0.0;
        let horizon = (0..height).find(down).unwrap_or(height);
        let floor_depth = |row| settings.mount_height / (row as f64 * fall - slope);
        let floor_depths = (horizon..height).map(|row| scaled(floor_depth(row), FLOOR_FRACTION) as u64).collect();
        Ok(Camera {
            settings: settings.clone(),
            columns,
            height,
            slope,
            fall,
            horizon,
            floor_depths,
            panels,
            walls,
            pyramids: scenario.world.pyramids.iter().map(Pyramid::new).collect(),
            floor: TextureMap::new(&scenario.world.floor, Span::Endless)?,
            surroundings: TextureMap::new(&scenario.world.surroundings, Span::Around(360.0))?,
        })
    }

    /// Whether its images lack the upper lines that vision cuts away.
    pub(super) fn crops(&self) -> bool {
        self.settings.detail == Detail::Vision
    }

    /// Pixels of an image.
    pub(super) fn pixels(&self) -> usize {
        self.columns.len() * self.height
    }

    /// Mean RGB colour of each wall's surface, in the order of the scenario.
    pub fn wall_colours(&self) -> Vec<[u8; 3]> {
        self.walls.iter().map(|(_, texture)| texture.mean()).collect()
    }

    /// The image from a pose, without sensor errors.
    pub fn render(&self, pose: &Pose) -> Image {
        let mut image = Image::default();
        self.render_into(pose, &mut image);
        image
    }

    /// The image from a pose, without sensor errors, in place of what an image held. Its memory is used again.
    pub fn render_into(&self, pose: &Pose, image: &mut Image) {
        self.render_among(&[], pose, image);
    }

    /// The same with distractors.
    pub fn render_among(&self, distractors: &[Present], pose: &Pose, image: &mut Image) {
        let (width, height) = (self.columns.len(), self.height);
        image.width = width;
        image.height = height;
        image.cropped = self.crops();
        image.rgb.resize(3 * width * height, 0);
        let views = self.views(pose);
        let mut hits = Vec::new();
        let mut tile = vec![[0u32; TILE]; height];
        for (number, columns) in self.columns.chunks(TILE).enumerate() {
            for (lane, column) in columns.iter().enumerate() {
                find_hits(&views, column.aside, &mut hits);
                let mut strip = Strip { tile: &mut tile, lane };
                self.paint(pose, column, &hits, &mut strip);
                self.paint_distractors(distractors, pose, column, &hits, &mut strip);
            }
            let start = 3 * TILE * number;
            for (line, row) in image.rgb.chunks_exact_mut(3 * width).zip(&tile) {
                let (pixels, _) = line[start..start + 3 * columns.len()].as_chunks_mut::<3>();
                for (pixel, texel) in pixels.iter_mut().zip(row) {
                    let [red, green, blue, _] = texel.to_le_bytes();
                    *pixel = [red, green, blue];
                }
            }
        }
    }

    /// The panels as seen from a pose, without those that are seen edge-on.
    fn views(&self, pose: &Pose) -> Vec<View<'_>> {
        let ahead = pose.direction();
        let right = Vector2::new(ahead.y, -ahead.x);
        let views = self.panels.iter().map(|panel| {
            let to = panel.from - pose.position;
            let gap = to.perp(&panel.along);
            let sign = gap.signum();
            let across = [ahead, right].map(|axis| sign * axis.perp(&panel.along));
            let place = [ahead, right].map(|axis| sign * to.perp(&axis));
            View { panel, gap: gap.abs(), across, place }
        });
        views.filter(|view| view.gap > 1e-9).collect()
    }

    /// Rows above a height at a depth: those whose rays pass over it.
    fn rows_above(&self, height: f64, depth: f64) -> usize {
        let rows = (self.slope - (height - self.settings.mount_height) / depth) / self.fall;
        // Rows 0, 1, … below `rows`: the cast cuts off the fraction, and negative values to zero.
        let whole = rows as usize;
        (whole + usize::from(rows > whole as f64)).min(self.height)
    }

    /// Paint one image column, from near to far, which is upwards: each pixel once.
    fn paint(&self, pose: &Pose, column: &Column, hits: &[Hit], strip: &mut Strip<'_>) {
        // Rows below this one are painted.
        let mut end = self.height;
        for hit in hits {
            let (height, texture) = &self.walls[hit.wall];
            // With a lens hardly above the floor, rounding can put a wall's foot onto the horizon: the floor begins below.
            let base = self.rows_above(0.0, hit.depth).max(self.horizon);
            if base < end {
                self.paint_floor(pose, column, base, end, strip);
                end = base;
            }
            let top = self.rows_above(*height, hit.depth);
            if top < end {
                let periods = texture.periods(1);
                let mount = self.settings.mount_height;
                let first = fixed((mount + self.slope * hit.depth) * periods);
                let step = fixed(self.fall * hit.depth * periods);
                strip.paint(top, end, texture.column(texture.phase(0, hit.along)), first, step);
                end = top;
            }
        }
        let above_walls = end;
        if self.horizon < end {
            self.paint_floor(pose, column, self.horizon, end, strip);
            end = self.horizon;
        }
        // The surroundings are a cylinder far away, its height measured in degrees as they are near the horizon.
        let periods = self.surroundings.periods(1) * column.degrees;
        let around = self.surroundings.phase(0, pose.heading.to_degrees() - column.bearing);
        let (first, step) = (fixed(self.slope * periods), fixed(self.fall * periods));
        strip.paint(0, end, self.surroundings.column(around), first, step);
        self.paint_pyramids(pose, column, above_walls, strip);
    }

    /// Paint pyramids over ground and surroundings. A scenario's checks keep them outside the walls, so that walls are nearer.
    fn paint_pyramids(&self, pose: &Pose, column: &Column, end: usize, strip: &mut Strip<'_>) {
        let ahead = pose.direction();
        let ray = ahead + Vector2::new(ahead.y, -ahead.x) * column.aside;
        let seen = self.pyramids.iter().filter_map(|pyramid| pyramid.cross(pose.position, ray)).collect::<Vec<_>>();
        if seen.is_empty() {
            return;
        }
        for (row, texels) in strip.tile[..end].iter_mut().enumerate() {
            let slope = self.slope - row as f64 * self.fall;
            let entries = seen.iter().filter_map(|crossing| crossing.entry(self.settings.mount_height, slope));
            if let Some((_, texel)) = entries.min_by(|a, b| a.0.total_cmp(&b.0)) {
                texels[strip.lane % TILE] = texel;
            }
        }
    }

    /// Paint distractors over what lies behind them, the farthest first.
    fn paint_distractors(
        &self,
        distractors: &[Present],
        pose: &Pose,
        column: &Column,
        hits: &[Hit],
        strip: &mut Strip<'_>,
    ) {
        if distractors.is_empty() {
            return;
        }
        let ahead = pose.direction();
        let ray = ahead + Vector2::new(ahead.y, -ahead.x) * column.aside;
        let mut seen: Vec<(f64, &Present)> =
            distractors.iter().filter_map(|present| Some((present.depth(pose.position, ray)?, present))).collect();
        seen.sort_by(|a, b| b.0.total_cmp(&a.0));
        for (depth, present) in seen {
            // Nearer walls hide the rows from their tops down.
            let nearer = hits.iter().take_while(|hit| hit.depth < depth);
            let hidden =
                nearer.map(|hit| self.rows_above(self.walls[hit.wall].0, hit.depth)).min().unwrap_or(self.height);
            let end = self.rows_above(present.bottom, depth).min(hidden);
            let begin = self.rows_above(present.top, depth).min(end);
            for row in &mut strip.tile[begin..end] {
                row[strip.lane % TILE] = present.colour;
            }
        }
    }

    fn paint_floor(&self, pose: &Pose, column: &Column, begin: usize, end: usize, strip: &mut Strip<'_>) {
        let floor = &self.floor;
        let ahead = pose.direction();
        let ray = ahead + Vector2::new(ahead.y, -ahead.x) * column.aside;
        let (x, y) = (floor.phase(0, pose.position.x), floor.phase(1, pose.position.y));
        let (dx, dy) = (scaled(ray.x * floor.periods(0), 32) as u64, scaled(ray.y * floor.periods(1), 32) as u64);
        let depths = &self.floor_depths[begin - self.horizon..end - self.horizon];
        // Products overflow at whole periods.
        let at =
            |start: u32, rate: u64, depth: u64| start.wrapping_add((rate.wrapping_mul(depth) >> FLOOR_FRACTION) as u32);
        for (row, &depth) in strip.tile[begin..end].iter_mut().zip(depths) {
            row[strip.lane % TILE] = floor.at(at(x, dx, depth), at(y, dy, depth));
        }
    }
}

/// All panels that a ray crosses, nearest first.
fn find_hits(views: &[View<'_>], aside: f64, hits: &mut Vec<Hit>) {
    hits.clear();
    for View { panel, gap, across, place } in views {
        let across = across[0] + across[1] * aside;
        let place = place[0] + place[1] * aside;
        if across > 1e-12 && place >= -SLACK * across && place <= (panel.length + SLACK) * across {
            hits.push(Hit { depth: gap / across, wall: panel.wall, along: panel.offset + place / across });
        }
    }
    if hits.len() > 1 {
        hits.sort_by(|a, b| a.depth.total_cmp(&b.depth));
    }
}

/// A number with some bits after the point; what is too large is cut.
fn scaled(value: f64, bits: u32) -> i64 {
    (value * (1u64 << bits) as f64) as i64
}

/// One column of a tile.
struct Strip<'a> {
    tile: &'a mut [[u32; TILE]],
    lane: usize,
}

impl Strip<'_> {
    /// Paint rows with a column of texels; `first`: the coordinate on the surface at row 0, `step` less in each row below.
    fn paint(&mut self, begin: usize, end: usize, texels: &[u32], first: u32, step: u32) {
        let mut phase = first.wrapping_sub(step.wrapping_mul(begin as u32));
        let count = texels.len() as u64;
        for row in &mut self.tile[begin..end] {
            row[self.lane % TILE] = texels[((u64::from(phase) * count) >> 32) as usize];
            phase = phase.wrapping_sub(step);
        }
    }
}
