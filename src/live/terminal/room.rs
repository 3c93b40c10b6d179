//! The room from above in a terminal: values as colours, arrows of the policy, walls, goals, the way and the robot.

use ratatui::buffer::Buffer;
use ratatui::layout::Rect;
use ratatui::style::{Color, Modifier, Style};

use crate::live::maps::Maps;
use crate::live::view::View;
use crate::report::draw::{Colours, GOAL, PATH, ends};

/// A letter for each of eight headings, from the x-axis on, counter-clockwise.
const ARROWS: [char; 8] = ['→', '↗', '↑', '↖', '←', '↙', '↓', '↘'];
const ROBOT: [char; 8] = ['▶', '◥', '▲', '◤', '◀', '◣', '▼', '◢'];

/// Points of the way that are shown: more would hide the arrows.
const WAY: usize = 250;

/// Cells from arrow to arrow.
const APART: (u16, u16) = (4, 2);

/// What a map shows.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Shown {
    /// The value and the arrows of a task.
    Task(usize),
    /// A feature.
    Feature(usize),
    /// The room alone.
    Room,
}

impl Shown {
    /// The map that a number chooses, of all that there are.
    pub fn of(view: &View, number: usize) -> Self {
        let Some(maps) = &view.maps else { return Shown::Room };
        let (tasks, features) = (maps.values.len(), maps.features.len());
        match (tasks + features).checked_sub(1).map(|last| number % (last + 1)) {
            Some(map) if map < tasks => Shown::Task(map),
            Some(map) => Shown::Feature(map - tasks),
            None => Shown::Room,
        }
    }

    /// What it is called.
    pub fn title(self, view: &View) -> String {
        let epoch = view.maps.as_ref().map_or(0, |maps| maps.epoch);
        match self {
            Shown::Task(task) => {
                let name = view.tasks.get(task).map_or("?", |task| &task.name);
                format!(" policy {epoch} of {name}: value, where it turns to ")
            }
            Shown::Feature(feature) => format!(" feature {} of model {epoch}, mean of headings ", feature + 1),
            Shown::Room => " the room ".to_owned(),
        }
    }
}

/// Where places of a room are on the screen.
struct Place {
    area: Rect,
    low: [f64; 2],
    high: [f64; 2],
    /// Columns for each metre; there are half as many lines.
    scale: f64,
}

impl Place {
    fn new(area: Rect, [low, high]: [[f64; 2]; 2]) -> Self {
        let (dx, dy) = ((high[0] - low[0]).max(1e-6), (high[1] - low[1]).max(1e-6));
        // The outer cells are the walls'.
        let (wide, tall) = (f64::from(area.width.saturating_sub(1)), 2.0 * f64::from(area.height.saturating_sub(1)));
        Place { area, low, high, scale: (wide / dx).min(tall / dy) }
    }

    /// The cell of a place, if it is on the screen.
    fn cell(&self, [x, y]: [f64; 2]) -> Option<(u16, u16)> {
        let column = ((x - self.low[0]) * self.scale).round();
        let line = ((self.high[1] - y) * self.scale / 2.0).round();
        let inside =
            column >= 0.0 && line >= 0.0 && column < f64::from(self.area.width) && line < f64::from(self.area.height);
        inside.then(|| (self.area.x + column as u16, self.area.y + line as u16))
    }

    /// The place of a cell.
    fn place(&self, column: u16, line: u16) -> [f64; 2] {
        let (column, line) = (f64::from(column - self.area.x), f64::from(line - self.area.y));
        [self.low[0] + column / self.scale, self.high[1] - 2.0 * line / self.scale]
    }
}

/// Draw the room.
pub fn room(buffer: &mut Buffer, area: Rect, view: &View, shown: Shown, plain: bool) {
    let Some(corners) = view.corners.filter(|_| area.width > 4 && area.height > 2) else {
        let text = "no poses in the log yet";
        buffer.set_stringn(area.x, area.y, text, usize::from(area.width), Style::default());
        return;
    };
    let place = Place::new(area, corners);
    if let Some(maps) = &view.maps {
        values(buffer, &place, maps, shown, plain);
    }
    let rgb = |colour: plotters::style::RGBColor| Color::Rgb(colour.0, colour.1, colour.2);
    for (number, task) in view.tasks.iter().enumerate() {
        let steps = 48;
        let ring = (0..steps).map(|i| std::f64::consts::TAU * f64::from(i) / f64::from(steps));
        let mark = if shown == Shown::Task(number) { 'o' } else { '.' };
        let Some(goal) = task.goal else { continue };
        for angle in ring {
            let at = [goal[0] + task.radius * angle.cos(), goal[1] + task.radius * angle.sin()];
            set(buffer, place.cell(at), mark, rgb(GOAL));
        }
        let number = char::from_digit(number as u32 + 1, 36).unwrap_or('*');
        set(buffer, place.cell(goal), number, rgb(GOAL));
    }
    for wall in &view.walls {
        let [r, g, b] = wall.colour;
        for pair in wall.points.windows(2) {
            line(&place, pair[0], pair[1], |cell| {
                set(buffer, Some(cell), if plain { '#' } else { '█' }, Color::Rgb(r, g, b));
            });
        }
    }
    for &point in &view.way[view.way.len().saturating_sub(WAY)..] {
        set(buffer, place.cell(point), '·', rgb(PATH));
    }
    if let Some([x, y, heading]) = view.pose
        && let Some(cell) = place.cell([x, y])
    {
        let style = Style::default().fg(Color::Black).bg(rgb(PATH)).add_modifier(Modifier::BOLD);
        buffer[cell].set_char(ROBOT[eighth(heading)]).set_style(style);
    }
}

/// Colours of all places, and arrows at some.
fn values(buffer: &mut Buffer, place: &Place, maps: &Maps, shown: Shown, plain: bool) {
    let (values, headings) = match shown {
        Shown::Task(task) => (maps.values.get(task), maps.headings.get(task)),
        Shown::Feature(feature) => (maps.features.get(feature), None),
        Shown::Room => (None, None),
    };
    let Some(values) = values else { return };
    let (low, high) = ends(values);
    let colours = match shown {
        Shown::Feature(_) => Colours::Diverging(low.abs().max(high.abs())),
        _ => Colours::Sequential(low, high),
    };
    for line in 0..place.area.height {
        for column in 0..place.area.width {
            let cell = (place.area.x + column, place.area.y + line);
            let Some(index) = index(maps, place.place(cell.0, cell.1)) else { continue };
            let Some(colour) = values.get(index).and_then(|&value| colours.of(value)) else { continue };
            if !plain {
                buffer[cell].set_bg(Color::Rgb(colour.0, colour.1, colour.2));
            }
            if let Some(heading) = headings.and_then(|headings| headings.get(index))
                && column % APART.0 == APART.0 / 2
                && line % APART.1 == APART.1 / 2
            {
                buffer[cell].set_char(ARROWS[eighth(*heading)]).set_fg(Color::Rgb(40, 44, 52));
            }
        }
    }
}

/// The number of the grid's place whose cell a place lies in.
fn index(maps: &Maps, [x, y]: [f64; 2]) -> Option<usize> {
    let part = |value: f64, low: f64, high: f64, count: usize| {
        let part = ((value - low) / (high - low) * count as f64).floor();
        (part >= 0.0 && part < count as f64).then_some(part as usize)
    };
    let column = part(x, maps.low[0], maps.high[0], maps.columns)?;
    Some(part(y, maps.low[1], maps.high[1], maps.rows)? * maps.columns + column)
}

fn eighth(heading: f64) -> usize {
    (heading / std::f64::consts::FRAC_PI_4).round().rem_euclid(8.0) as usize % 8
}

fn set(buffer: &mut Buffer, cell: Option<(u16, u16)>, letter: char, colour: Color) {
    if let Some(cell) = cell {
        buffer[cell].set_char(letter).set_fg(colour);
    }
}

/// All cells from one place to another.
fn line(place: &Place, from: [f64; 2], to: [f64; 2], mut each: impl FnMut((u16, u16))) {
    let length = (to[0] - from[0]).hypot(to[1] - from[1]);
    let steps = (2.0 * length * place.scale).ceil().clamp(1.0, 4000.0) as u32;
    for step in 0..=steps {
        let share = f64::from(step) / f64::from(steps);
        let at = [0, 1].map(|axis| from[axis] + (to[axis] - from[axis]) * share);
        place.cell(at).into_iter().for_each(&mut each);
    }
}
