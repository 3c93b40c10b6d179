//! The actions of a robot, as a value: how many there are, how each moves it, which undoes which.

use std::ops::Deref;
use std::sync::Arc;

/// The most actions that a robot can have: what may follow a transition is kept as bits.
pub const MOST_ACTIONS: usize = 32;

/// An action of a robot, by its number in the robot's [`ActionSet`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct Action(u8);

impl Action {
    /// Drive straight ahead, in [`ActionSet::differential_drive`].
    pub const FORWARD: Action = Action(0);
    /// Turn counter-clockwise on the spot, in [`ActionSet::differential_drive`].
    pub const TURN_LEFT: Action = Action(1);
    /// Turn clockwise on the spot, in [`ActionSet::differential_drive`].
    pub const TURN_RIGHT: Action = Action(2);

    /// All of [`ActionSet::differential_drive`].
    pub const DRIVE: [Action; 3] = [Action::FORWARD, Action::TURN_LEFT, Action::TURN_RIGHT];

    /// The first `count` actions, whatever robot they are of; at most [`MOST_ACTIONS`].
    pub fn first(count: usize) -> impl Iterator<Item = Action> + Clone {
        (0..count.min(MOST_ACTIONS) as u8).map(Action)
    }

    /// The action's number, from 0.
    pub fn index(self) -> usize {
        usize::from(self.0)
    }
}

/// How an action moves a robot that nothing stops: it turns, then drives straight ahead.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Motion {
    /// Metres straight ahead.
    pub distance: f64,
    /// Radians counter-clockwise.
    pub angle: f64,
}

/// One action of a robot.
#[derive(Debug, Clone, PartialEq)]
pub struct ActionSpec {
    /// Its name, as logs and reports have it.
    pub name: Arc<str>,
    /// How it moves the robot.
    pub motion: Motion,
    /// The number of the action that undoes it, if there is one.
    pub inverse: Option<usize>,
}

/// The actions that a robot can do.
#[derive(Debug, Clone, PartialEq)]
pub struct ActionSet(Arc<[ActionSpec]>);

impl ActionSet {
    /// Actions by their numbers.
    ///
    /// # Panics
    /// Without actions, with more than [`MOST_ACTIONS`], or where the inverse of one has no such number.
    pub fn new(actions: Vec<ActionSpec>) -> Self {
        let count = actions.len();
        assert!((1..=MOST_ACTIONS).contains(&count), "{count} actions; a robot has 1 to {MOST_ACTIONS}");
        for action in &actions {
            let known = action.inverse.is_none_or(|inverse| inverse < count);
            assert!(known, "the inverse of {} is number {:?} of {count}", action.name, action.inverse);
        }
        ActionSet(actions.into())
    }

    /// Forward by a distance in metres, and turns to both sides by an angle in radians, which undo each other.
    pub fn differential_drive(distance: f64, angle: f64) -> Self {
        let turn = |name, angle, inverse: Action| ActionSpec {
            name: Arc::from(name),
            motion: Motion { distance: 0.0, angle },
            inverse: Some(inverse.index()),
        };
        let forward = ActionSpec { name: "forward".into(), motion: Motion { distance, angle: 0.0 }, inverse: None };
        ActionSet::new(vec![
            forward,
            turn("turn left", angle, Action::TURN_RIGHT),
            turn("turn right", -angle, Action::TURN_LEFT),
        ])
    }

    /// How many actions there are.
    #[allow(clippy::len_without_is_empty)] // there is at least one
    pub fn len(&self) -> usize {
        self.0.len()
    }

    /// All actions in the order of their numbers.
    pub fn iter(&self) -> impl Iterator<Item = Action> + Clone + use<> {
        Action::first(self.0.len())
    }

    /// The action of a number, if there is one.
    pub fn get(&self, number: usize) -> Option<Action> {
        (number < self.0.len()).then_some(Action(number as u8))
    }

    /// An action's name.
    pub fn name(&self, action: Action) -> &str {
        &self.0[action.index()].name
    }

    /// How an action moves the robot.
    pub fn motion(&self, action: Action) -> Motion {
        self.0[action.index()].motion
    }

    /// Whether an action moves the robot from its place.
    pub fn advances(&self, action: Action) -> bool {
        self.motion(action).distance != 0.0
    }

    /// The action that undoes an action.
    pub fn inverse(&self, action: Action) -> Option<Action> {
        self.0[action.index()].inverse.and_then(|number| self.get(number))
    }
}

/// A number for each action, such as Q-values; takes no memory of its own.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ActionValues {
    values: [f64; MOST_ACTIONS],
    count: usize,
}

impl ActionValues {
    /// From the first [`MOST_ACTIONS`] of some values.
    pub fn new(values: impl IntoIterator<Item = f64>) -> Self {
        let mut of = ActionValues { values: [0.0; MOST_ACTIONS], count: 0 };
        for (place, value) in of.values.iter_mut().zip(values) {
            *place = value;
            of.count += 1;
        }
        of
    }
}

impl Deref for ActionValues {
    type Target = [f64];

    fn deref(&self) -> &[f64] {
        &self.values[..self.count]
    }
}

impl std::ops::DerefMut for ActionValues {
    fn deref_mut(&mut self) -> &mut [f64] {
        &mut self.values[..self.count]
    }
}
