//! Continuous motion cut into actions.
//!
//! A recording of another program does not know our three actions: its robot speeds up, curves, stands, backs off. This is
//! the rule by which its motion becomes *forward*, *left* and *right*:
//!
//! 1. The motion between two frames counts in shares of an action: the way ahead over [`Rule::forward`], the angle over
//!    [`Rule::turn`]. The larger share decides what it is: forward, left or right; or driving back, or standing still, which
//!    is motion below a tenth of an action in [`Rule::seconds`]. The last two belong to no action.
//! 2. What it is changes when another kind of motion has gained [`CHANGE`] of an action on the present one; it has
//!    then been the other kind since it began to gain (the cumulative sum test of Page, 1954). Corrections of the course
//!    that are smaller than that are no turns, and pauses shorter than half of [`Rule::seconds`] no stops.
//! 3. A stretch of one kind is cut into actions: at the frame at which a whole one is done most nearly, and so on. What is
//!    left at its end is an action of its own if it is at least half of one; if it is less, it belongs to the action
//!    before, or, where the stretch was no longer, to none.
//! 4. Where the robot was commanded to drive ahead and stood, the share that was commanded counts as done, so that pushing against
//!    a wall is an action, too. It is *blocked* when that makes up half of it or more.
//!
//! What is held in memory is less than two actions, and never more than [`MOST_HELD`] frames.
//!
//! # Reference
//! E. S. Page, Continuous inspection schemes, Biometrika 41 (1954).

use std::collections::VecDeque;

use crate::robot::{Action, Motion, Pose, wrap};
use crate::scenario::Robot;

/// Motion of another kind becomes the kind of motion when it has gained this share of an action.
pub const CHANGE: f64 = 0.25;

/// A robot that does less than this share of an action in the time of one stands still.
pub const STILL: f64 = 0.1;

/// Standing still has gained enough after half of the time of an action.
const STOP: f64 = STILL / 2.0;

/// What is left of a stretch is an action from this share on; a share that was commanded and not done makes it blocked.
const HALF: f64 = 0.5;

/// A robot that does this many actions in the time of one, and one more, was put there: its pose has jumped.
const FASTEST: f64 = 5.0;

/// Frames in which a robot may fail to finish an action; more belong to none.
pub const MOST_HELD: usize = 20_000;

/// What one action is.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Rule {
    /// Length of *forward*, metres.
    pub forward: f64,
    /// Angle of a turn, radians.
    pub turn: f64,
    /// Usual duration of an action, seconds.
    pub seconds: f64,
}

/// The motion between two frames, in shares of an action.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Step {
    /// Ahead; negative: back.
    pub ahead: f64,
    /// Counter-clockwise; negative: clockwise.
    pub turned: f64,
    /// What was to be driven ahead while the robot stood.
    pub stuck: f64,
    /// Time, in durations of an action.
    pub duration: f64,
}

impl Rule {
    /// What an action of a robot is: its longest one, and the one that turns most.
    pub fn of(robot: &Robot) -> Self {
        let most = |of: fn(Motion) -> f64, otherwise: f64| {
            let most = robot.actions.iter().map(|action| of(robot.actions.motion(action)).abs()).fold(0.0, f64::max);
            if most > 0.0 { most } else { otherwise }
        };
        Rule {
            forward: most(|motion| motion.distance, robot.forward),
            turn: most(|motion| motion.angle, robot.turn_deg.to_radians()),
            seconds: robot.action_seconds,
        }
    }

    /// The motion between two poses that are `seconds` apart, while the robot was commanded to drive `commanded` metres ahead.
    pub fn step(&self, from: &Pose, to: &Pose, seconds: f64, commanded: f64) -> Step {
        let turned = wrap(to.heading - from.heading);
        let between = Pose::new(from.position, from.heading + turned / 2.0);
        let ahead = (to.position - from.position).dot(&between.direction()) / self.forward;
        let (turned, duration, commanded) = (turned / self.turn, seconds / self.seconds, commanded / self.forward);
        let stands = ahead.abs().max(turned.abs()) < STILL * duration;
        let stuck = if stands && commanded > STILL * duration { commanded } else { 0.0 };
        Step { ahead, turned, stuck, duration }
    }

    /// The same where nobody knows where the robot is: of what it did, nothing is a number.
    pub fn unmeasured(&self, seconds: f64) -> Step {
        Step { ahead: f64::NAN, turned: f64::NAN, stuck: 0.0, duration: seconds / self.seconds }
    }

    /// Whether no robot drives from one pose to the other in so many seconds: somebody carried it, or its localisation has
    /// found out that it was wrong.
    pub fn is_jump(&self, from: &Pose, to: &Pose, seconds: f64) -> bool {
        let most = 1.0 + FASTEST * seconds / self.seconds;
        let (way, angle) = ((to.position - from.position).norm(), wrap(to.heading - from.heading).abs());
        way > most * self.forward || angle > most * self.turn
    }
}

/// So many frames that follow each other.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Segment {
    /// How many frames end a step of it.
    pub frames: usize,
    /// What the robot did; `None`: nothing that is an action.
    pub action: Option<Action>,
    /// Whether an obstacle stopped it.
    pub blocked: bool,
}

/// A kind of motion.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Kind {
    Forward,
    Left,
    Right,
    Back,
    Still,
}

impl Kind {
    const ALL: [Kind; 5] = [Kind::Forward, Kind::Left, Kind::Right, Kind::Back, Kind::Still];

    fn action(self) -> Option<Action> {
        match self {
            Kind::Forward => Some(Action::FORWARD),
            Kind::Left => Some(Action::TURN_LEFT),
            Kind::Right => Some(Action::TURN_RIGHT),
            Kind::Back | Kind::Still => None,
        }
    }

    /// How much a step was of this kind.
    fn share(self, step: &Step) -> f64 {
        match self {
            Kind::Forward => step.ahead + step.stuck,
            Kind::Left => step.turned,
            Kind::Right => -step.turned,
            Kind::Back => -step.ahead,
            Kind::Still => STILL * step.duration,
        }
    }

    /// What it has to gain to become the kind of motion.
    fn enough(self) -> f64 {
        if self == Kind::Still { STOP } else { CHANGE }
    }
}

/// What another kind of motion has gained on the present one.
#[derive(Debug, Clone, Copy, Default)]
struct Candidate {
    gained: f64,
    /// The step, of those that are held, with which it began to gain.
    since: usize,
}

/// An action that is done, and may still get the rest of its stretch.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Done {
    kind: Kind,
    frames: usize,
    share: f64,
    stuck: f64,
}

/// Cuts the motion between frames into actions.
#[derive(Debug, Clone)]
pub struct Segmenter {
    kind: Kind,
    /// Steps since the last cut.
    held: VecDeque<Step>,
    /// How much they are of `kind`.
    share: f64,
    rivals: [Candidate; 5],
    /// The action before in the same stretch.
    before: Option<Done>,
    finished: VecDeque<Segment>,
}

impl Default for Segmenter {
    /// Before the first step.
    fn default() -> Self {
        Segmenter {
            kind: Kind::Still,
            held: VecDeque::new(),
            share: 0.0,
            rivals: Default::default(),
            before: None,
            finished: VecDeque::new(),
        }
    }
}

impl Segmenter {
    /// One more step.
    pub fn push(&mut self, step: Step) {
        self.absorb(step);
        let gains =
            Kind::ALL.into_iter().zip(self.rivals).map(|(kind, rival)| (rival.gained / kind.enough(), kind, rival));
        let (gain, kind, rival) =
            gains.max_by(|a, b| a.0.total_cmp(&b.0)).unwrap_or((0.0, self.kind, Candidate::default()));
        if gain >= 1.0 {
            self.end_stretch(rival.since);
            self.kind = kind;
            // Seen as what they are, the steps since then may already be an action.
            for step in std::mem::take(&mut self.held) {
                self.absorb(step);
            }
        } else if self.held.len() > MOST_HELD {
            self.interrupt();
        }
    }

    /// Frames are missing here, or the recording has ended: what comes next has nothing to do with what was.
    pub fn interrupt(&mut self) {
        self.end_stretch(self.held.len());
        self.kind = Kind::Still;
    }

    /// The next segment that is finished. Segments are finished in the order of their frames, and leave none out.
    pub fn finished(&mut self) -> Option<Segment> {
        self.finished.pop_front()
    }

    /// Count a step as one of the present kind, and cut where an action is done.
    fn absorb(&mut self, step: Step) {
        let (at, own) = (self.held.len(), self.kind.share(&step));
        self.held.push_back(step);
        self.share += own;
        for (kind, rival) in Kind::ALL.into_iter().zip(&mut self.rivals) {
            if rival.gained <= 0.0 {
                rival.since = at;
            }
            // The present kind gains nothing on itself.
            rival.gained = (rival.gained + kind.share(&step) - own).max(0.0);
        }
        if self.kind.action().is_none() {
            let rivals = self.rivals.iter().filter(|rival| rival.gained > 0.0);
            let let_go = rivals.map(|rival| rival.since).min().unwrap_or(self.held.len());
            self.drop_front(let_go);
            self.finish(let_go, None, false);
        } else if own > 0.0 && self.share + own / 2.0 >= 1.0 {
            // The next frame would be further beyond a whole action than this one is before it.
            self.cut();
        }
    }

    /// All that is held is an action.
    fn cut(&mut self) {
        let done = self.sum(self.held.len());
        self.finish_before();
        self.before = Some(done);
        self.drop_front(done.frames);
    }

    /// The first steps that are held are the rest of their stretch, which ends behind them.
    fn end_stretch(&mut self, frames: usize) {
        let rest = self.sum(frames);
        self.drop_front(frames);
        if rest.kind.action().is_some() && rest.share >= HALF {
            self.finish_before();
            self.before = Some(rest);
        } else if let Some(before) = &mut self.before {
            before.frames += rest.frames;
            before.share += rest.share;
            before.stuck += rest.stuck;
        } else {
            self.finish(frames, None, false);
        }
        self.finish_before();
        self.share = 0.0;
        self.rivals = Default::default();
    }

    fn sum(&self, frames: usize) -> Done {
        let steps = || self.held.iter().take(frames);
        let (kind, share) = (self.kind, steps().map(|step| self.kind.share(step)).sum());
        Done { kind, frames, share, stuck: steps().map(|step| step.stuck).sum() }
    }

    fn drop_front(&mut self, frames: usize) {
        self.held.drain(..frames);
        self.share = self.held.iter().map(|step| self.kind.share(step)).sum();
        for rival in &mut self.rivals {
            rival.since = rival.since.saturating_sub(frames);
        }
    }

    fn finish_before(&mut self) {
        if let Some(done) = self.before.take() {
            let blocked = done.kind == Kind::Forward && done.stuck >= HALF * done.share;
            self.finish(done.frames, done.kind.action(), blocked);
        }
    }

    fn finish(&mut self, frames: usize, action: Option<Action>, blocked: bool) {
        if frames > 0 {
            self.finished.push_back(Segment { frames, action, blocked });
        }
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::Point2;

    use super::*;

    const RULE: Rule = Rule { forward: 0.3, turn: std::f64::consts::FRAC_PI_4, seconds: 1.0 };
    const FPS: f64 = 10.0;

    /// Drives a path at ten frames a second and cuts it; segments without action come as (frames, None).
    struct Drive {
        pose: Pose,
        cutter: Segmenter,
        segments: Vec<Segment>,
    }

    impl Drive {
        fn new() -> Self {
            Drive { pose: Pose::new(Point2::origin(), 0.4), cutter: Segmenter::default(), segments: Vec::new() }
        }

        /// For some frames, metres and radians a second; `commanded`: metres a second that are commanded.
        fn go(mut self, frames: usize, speed: f64, turn: f64, commanded: f64) -> Self {
            for _ in 0..frames {
                let heading = self.pose.heading + turn / FPS / 2.0;
                let moved = Pose::new(Point2::origin(), heading).direction() * (speed / FPS);
                let next = Pose::new(self.pose.position + moved, self.pose.heading + turn / FPS);
                self.cutter.push(RULE.step(&self.pose, &next, 1.0 / FPS, commanded / FPS));
                self.pose = next;
            }
            self
        }

        fn gap(mut self) -> Self {
            self.cutter.interrupt();
            self
        }

        fn end(mut self) -> Vec<(usize, Option<Action>, bool)> {
            self.cutter.interrupt();
            while let Some(segment) = self.cutter.finished() {
                self.segments.push(segment);
            }
            self.segments.iter().map(|s| (s.frames, s.action, s.blocked)).collect()
        }
    }

    const F: Option<Action> = Some(Action::FORWARD);
    const L: Option<Action> = Some(Action::TURN_LEFT);
    const R: Option<Action> = Some(Action::TURN_RIGHT);

    fn actions(segments: &[(usize, Option<Action>, bool)]) -> Vec<(usize, Option<Action>)> {
        segments.iter().map(|&(frames, action, _)| (frames, action)).collect()
    }

    #[test]
    fn a_square_is_what_was_driven() {
        let quarter = std::f64::consts::FRAC_PI_4;
        let mut drive = Drive::new();
        for _ in 0..4 {
            drive = drive.go(30, 0.3, 0.0, 0.0).go(20, 0.0, quarter, 0.0);
        }
        let expected = [(10, F), (10, F), (10, F), (10, L), (10, L)].repeat(4);
        assert_eq!(actions(&drive.end()), expected);
        // The other way round it goes right.
        let right = Drive::new().go(10, 0.3, 0.0, 0.0).go(10, 0.0, -quarter, 0.0).go(10, 0.3, 0.0, 0.0);
        assert_eq!(actions(&right.end()), [(10, F), (10, R), (10, F)]);
    }

    #[test]
    fn standing_still_is_no_action_and_a_short_pause_is_no_stop() {
        assert_eq!(actions(&Drive::new().go(500, 0.0, 0.0, 0.0).end()), vec![(1, None); 500]);
        // Creeping along is standing still, too; twice as fast is not.
        assert!(Drive::new().go(500, 0.02, 0.0, 0.0).end().iter().all(|segment| segment.1.is_none()));
        assert_eq!(actions(&Drive::new().go(100, 0.06, 0.0, 0.0).end()), [(50, F), (50, F)]);
        let pause = Drive::new().go(10, 0.3, 0.0, 0.0).go(3, 0.0, 0.0, 0.0).go(10, 0.3, 0.0, 0.0);
        assert_eq!(actions(&pause.end()), [(10, F), (13, F)]);
        let stop = actions(&Drive::new().go(10, 0.3, 0.0, 0.0).go(30, 0.0, 0.0, 0.0).go(10, 0.3, 0.0, 0.0).end());
        assert_eq!((stop[0], *stop.last().unwrap()), ((10, F), (10, F)));
        assert!(stop[1..stop.len() - 1].iter().all(|&(_, action)| action.is_none()));
        assert_eq!(stop.iter().map(|segment| segment.0).sum::<usize>(), 50);
    }

    #[test]
    fn on_a_curve_the_larger_share_decides() {
        // 0.3 m/s and 0.5 rad/s: 1 and 0.64 actions a second.
        assert_eq!(actions(&Drive::new().go(30, 0.3, 0.5, 0.0).end()), [(10, F), (10, F), (10, F)]);
        // 0.1 m/s and −0.785 rad/s: 0.33 and 1.
        let turn = -std::f64::consts::FRAC_PI_4;
        assert_eq!(actions(&Drive::new().go(30, 0.1, turn, 0.0).end()), [(10, R), (10, R), (10, R)]);
        // A correction of 9° to the left and back while driving is no turn.
        let correction =
            Drive::new().go(8, 0.3, 0.0, 0.0).go(2, 0.1, turn, 0.0).go(2, 0.1, -turn, 0.0).go(8, 0.3, 0.0, 0.0);
        let correction = correction.end();
        assert!(correction.iter().all(|segment| segment.1 == F), "{correction:?}");
        assert_eq!(correction.iter().map(|segment| segment.0).sum::<usize>(), 20);
    }

    #[test]
    fn the_rest_of_a_stretch_is_an_action_or_goes_to_the_one_before_or_to_none() {
        let turn = std::f64::consts::FRAC_PI_4;
        let of = |frames| actions(&Drive::new().go(frames, 0.3, 0.0, 0.0).go(10, 0.0, turn, 0.0).end());
        assert_eq!(of(14), [(14, F), (10, L)]);
        assert_eq!(of(16), [(10, F), (6, F), (10, L)]);
        assert_eq!(of(6), [(6, F), (10, L)]);
        assert_eq!(of(4), [(4, None), (10, L)]);
    }

    #[test]
    fn driving_back_is_no_action() {
        let turn = std::f64::consts::FRAC_PI_4;
        let back = Drive::new().go(10, 0.3, 0.0, 0.0).go(20, -0.3, 0.0, 0.0).go(10, 0.0, turn, 0.0).end();
        let back = actions(&back);
        assert_eq!((back[0], *back.last().unwrap()), ((10, F), (10, L)));
        assert!(back[1..back.len() - 1].iter().all(|&(_, action)| action.is_none()), "{back:?}");
        assert_eq!(back.iter().map(|segment| segment.0).sum::<usize>(), 40);
    }

    #[test]
    fn nothing_goes_on_over_a_gap() {
        let gap = Drive::new().go(16, 0.3, 0.0, 0.0).gap().go(14, 0.3, 0.0, 0.0);
        assert_eq!(actions(&gap.end()), [(10, F), (6, F), (14, F)]);
        let short = Drive::new().go(4, 0.3, 0.0, 0.0).gap().go(4, 0.3, 0.0, 0.0);
        assert_eq!(actions(&short.end()), [(4, None), (4, None)]);
    }

    #[test]
    fn pushing_against_a_wall_is_a_blocked_action() {
        let push = Drive::new().go(10, 0.3, 0.0, 0.3).go(20, 0.0, 0.0, 0.3).end();
        assert_eq!(push, [(10, F, false), (10, F, true), (10, F, true)]);
        // Without the command the robot just stands.
        let stand = Drive::new().go(10, 0.3, 0.0, 0.0).go(20, 0.0, 0.0, 0.0).end();
        assert!(stand[1..].iter().all(|segment| segment.1.is_none()));
        // Stopped for a third of the way.
        assert_eq!(Drive::new().go(7, 0.3, 0.0, 0.3).go(3, 0.0, 0.0, 0.3).end(), [(10, F, false)]);
        assert_eq!(Drive::new().go(4, 0.3, 0.0, 0.3).go(6, 0.0, 0.0, 0.3).end(), [(10, F, true)]);
        // Turning while the command has just become forward is not being stuck.
        let late = Drive::new().go(10, 0.0, std::f64::consts::FRAC_PI_4, 0.3).end();
        assert_eq!(late, [(10, L, false)]);
    }

    #[test]
    fn a_pose_that_jumps_was_not_driven_to() {
        let at = |x: f64, y: f64, heading: f64| Pose::new(Point2::new(x, y), heading);
        let start = at(1.0, 1.0, 0.0);
        // 0.1 s: at most one and a half actions, 0.45 m or 68°.
        assert!(!RULE.is_jump(&start, &at(1.44, 1.0, 0.0), 0.1));
        assert!(RULE.is_jump(&start, &at(1.46, 1.0, 0.0), 0.1));
        assert!(RULE.is_jump(&start, &at(1.0, 0.5, 0.0), 0.1), "sideways, too");
        assert!(!RULE.is_jump(&start, &at(1.0, 1.0, 67f64.to_radians()), 0.1));
        assert!(RULE.is_jump(&start, &at(1.0, 1.0, -68f64.to_radians()), 0.1));
        assert!(!RULE.is_jump(&start, &at(1.0, 0.5, 0.0), 0.2));
    }

    #[test]
    fn steps_longer_than_an_action_are_one_each_and_memory_is_bounded() {
        let far = Drive::new().go(5, 12.0, 0.0, 0.0).end();
        assert_eq!(actions(&far), [(1, F); 5]);
        let mut cutter = Segmenter::default();
        // To and fro too slowly for a change, too fast for standing still.
        for i in 0..3 * MOST_HELD {
            let ahead = 0.2 * (i as f64 * 1e-3).sin().abs();
            cutter.push(Step { ahead: ahead * 1e-4, turned: 0.0, stuck: 0.0, duration: 1e-5 });
            assert!(cutter.held.len() <= MOST_HELD + 1);
        }
        cutter.interrupt();
        let frames: usize = std::iter::from_fn(|| cutter.finished()).map(|segment| segment.frames).sum();
        assert_eq!(frames, 3 * MOST_HELD);
    }
}
