//! Rooms on a grid, drawn as text: `#` is a wall, `.` floor, `D` a door (floor with a name), `G` a goal.
//!
//! Four actions move to the neighbouring place; a move into a wall or out of the map stays. With the probability `slip` a
//! move goes to one of its two sides instead. Entering a goal pays 1 and ends the episode.

use crate::value::error::parameter;
use crate::value::{FiniteMdp, Successor, ValueError};

/// To the line above.
pub const UP: usize = 0;
/// To the next column.
pub const RIGHT: usize = 1;
/// To the line below.
pub const DOWN: usize = 2;
/// To the column before.
pub const LEFT: usize = 3;

/// Two rooms with a door between them, the goal in a corner: for tests and measurements.
pub const TWO_ROOMS: &str = "\
    .......#.......\n\
    .......#.......\n\
    .......#.......\n\
    .......D.......\n\
    .......#.......\n\
    .......#.......\n\
    .......#......G\n";

/// A map whose places are the states, numbered line by line.
#[derive(Debug, Clone, PartialEq)]
pub struct Rooms {
    width: usize,
    height: usize,
    /// Number of the state at column `x`, line `y`: `y·width + x`; `None` for walls.
    numbers: Vec<Option<usize>>,
    /// (column, line) of each state.
    places: Vec<(usize, usize)>,
    /// Whether each state is a goal.
    goals: Vec<bool>,
}

impl Rooms {
    /// A map from its drawing; blank lines at the end do not count.
    ///
    /// ```
    /// use adagio::value::exact::policy_iteration;
    /// use adagio::value::worlds::rooms::{RIGHT, Rooms};
    ///
    /// let rooms = Rooms::parse("..G\n.#.")?;
    /// let optimum = policy_iteration(&rooms.process(0.9, 0.0)?)?;
    /// let corner = rooms.state_at(0, 0).unwrap();
    /// assert_eq!(optimum.policy.chosen()[corner], RIGHT);
    /// assert!((optimum.values[corner] - 0.9).abs() < 1e-12); // one step before the one that pays
    /// # Ok::<(), adagio::value::ValueError>(())
    /// ```
    ///
    /// # Errors
    /// Lines of different lengths, an unknown letter, no goal, nothing but walls and goals.
    pub fn parse(drawing: &str) -> Result<Self, ValueError> {
        let lines: Vec<Vec<char>> = drawing.trim_end().lines().map(|line| line.chars().collect()).collect();
        let width = lines.first().map_or(0, Vec::len);
        let mut rooms =
            Rooms { width, height: lines.len(), numbers: Vec::new(), places: Vec::new(), goals: Vec::new() };
        for (y, line) in lines.iter().enumerate() {
            let fault = |fault: String| ValueError::Map { line: y + 1, fault };
            if line.len() != width {
                return Err(fault(format!("it has {} letters, but the first line has {width}", line.len())));
            }
            for (x, &letter) in line.iter().enumerate() {
                match letter {
                    '#' => rooms.numbers.push(None),
                    '.' | 'D' | 'G' => {
                        rooms.numbers.push(Some(rooms.places.len()));
                        rooms.places.push((x, y));
                        rooms.goals.push(letter == 'G');
                    }
                    _ => return Err(fault(format!("{letter:?} is none of '#', '.', 'D' and 'G'"))),
                }
            }
        }
        for (wanted, name) in [(true, "goal G"), (false, "floor")] {
            if !rooms.goals.contains(&wanted) {
                return Err(ValueError::Map { line: lines.len(), fault: format!("the map ends without any {name}") });
            }
        }
        Ok(rooms)
    }

    /// Number of states, goals included.
    pub fn states(&self) -> usize {
        self.places.len()
    }

    /// (columns, lines) of the map.
    pub fn size(&self) -> (usize, usize) {
        (self.width, self.height)
    }

    /// (column, line) of each state.
    pub fn places(&self) -> &[(usize, usize)] {
        &self.places
    }

    /// The state at a place; `None` for walls and outside.
    pub fn state_at(&self, column: usize, line: usize) -> Option<usize> {
        if column >= self.width || line >= self.height { None } else { self.numbers[line * self.width + column] }
    }

    /// Where a move leads that does not slip; `state` itself at walls, and for numbers out of range.
    pub fn neighbour(&self, state: usize, action: usize) -> usize {
        let Some(&(x, y)) = self.places.get(state) else { return state };
        let (column, line) = match action {
            UP => (Some(x), y.checked_sub(1)),
            RIGHT => (Some(x + 1), Some(y)),
            DOWN => (Some(x), Some(y + 1)),
            LEFT => (x.checked_sub(1), Some(y)),
            _ => (None, None),
        };
        column.zip(line).and_then(|(column, line)| self.state_at(column, line)).unwrap_or(state)
    }

    /// The decision process of these rooms.
    ///
    /// # Errors
    /// γ or `slip` outside [0, 1].
    pub fn process(&self, gamma: f64, slip: f64) -> Result<FiniteMdp, ValueError> {
        parameter("slip", slip, (0.0..=1.0).contains(&slip), "in [0, 1]")?;
        FiniteMdp::new(self.states(), 4, gamma, |s, a| {
            if self.goals[s] {
                return Vec::new();
            }
            let to = |action: usize, probability: f64| {
                let state = self.neighbour(s, action);
                Successor { state, probability, reward: f64::from(u8::from(self.goals[state])) }
            };
            let moves = [to(a, 1.0 - slip), to((a + 1) % 4, slip / 2.0), to((a + 3) % 4, slip / 2.0)];
            moves.into_iter().filter(|to| to.probability > 0.0).collect()
        })
    }
}
