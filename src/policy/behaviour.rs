//! What the robot is up to: periods of exploration and of pursuit, mixed by the scenario's schedule.

use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};

use crate::scenario::{Scenario, Then};
use crate::snapshot::{Persist, Snapshot, SnapshotError};

/// What the robot does.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum Behaviour {
    /// Random walk, now and then after a way to a rarely visited place.
    Explore,
    /// The greedy policy of a task, by its number.
    Pursue(usize),
}

/// Where somebody sends the robot.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum Goto {
    /// To the goal of a task, by its number.
    Task(usize),
    /// Wherever the schedule has it go.
    Schedule,
}

/// How pursuits of one task ended so far.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct Tally {
    /// Pursuits that reached the goal.
    pub reached: usize,
    /// Pursuits that ended, reached or not.
    pub ended: usize,
}

/// A pursuit that is over.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct PursuitEnd {
    /// Number of the task.
    pub task: usize,
    /// Whether it reached the goal; if not, it was given up.
    pub arrived: bool,
    /// Actions that it took.
    pub actions: usize,
    /// Whether somebody had sent the robot there, and it has arrived.
    pub sent: bool,
}

/// When to explore and when to pursue a goal.
///
/// The share of pursuits is 0 during the first `policy.explore_share` of the run and then rises linearly to `pursue_share` at the end of the run.
#[derive(Debug, Clone)]
pub struct BehaviourSchedule {
    scenario_actions: usize,
    explore_actions: usize,
    pursue_share: f64,
    explore_length: usize,
    pursue_timeout: usize,
    then: Vec<Then>,
    rng: ChaCha8Rng,
    leg: Behaviour,
    left: usize,
    last_task: usize,
    /// The task to whose goal somebody has sent the robot, until it is there.
    sent: Option<usize>,
    tallies: Vec<Tally>,
}

impl BehaviourSchedule {
    /// The schedule of a scenario; `rng` draws what comes next.
    pub fn new(scenario: &Scenario, rng: ChaCha8Rng) -> Self {
        let policy = &scenario.policy;
        BehaviourSchedule {
            scenario_actions: scenario.actions,
            explore_actions: (policy.explore_share * scenario.actions as f64).round() as usize,
            pursue_share: policy.pursue_share,
            explore_length: policy.explore_length,
            pursue_timeout: policy.pursue_timeout,
            then: scenario.tasks.iter().map(|task| task.then).collect(),
            rng,
            leg: Behaviour::Explore,
            left: 0,
            last_task: scenario.tasks.len() - 1,
            sent: None,
            tallies: vec![Tally::default(); scenario.tasks.len()],
        }
    }

    /// Somebody sends the robot somewhere: from the next action on, for as long as it takes. It explores until there is a policy for
    /// that, and for a while after each pursuit that was given up: a policy that knows a part of the room alone may never leave that
    /// part. Another pursuit that is under way is given up, and counts for nothing. It may be said again and again.
    pub fn send(&mut self, goto: Goto) {
        let sent = match goto {
            Goto::Task(task) => Some(task),
            Goto::Schedule => None,
        };
        if sent.is_some() && sent == self.sent {
            return;
        }
        self.sent = sent;
        if self.sent.is_none_or(|task| self.leg != Behaviour::Pursue(task)) {
            (self.leg, self.left) = (Behaviour::Explore, 0);
        }
    }

    /// The behaviour for action number `action` (from 0), and the pursuit that is over before it. `in_goal`: whether the robot is
    /// in a task's goal now; `able`: whether there is a policy for it.
    pub fn next(
        &mut self,
        action: usize,
        in_goal: &dyn Fn(usize) -> bool,
        able: &dyn Fn(usize) -> bool,
    ) -> (Behaviour, Option<PursuitEnd>) {
        let mut ended = None;
        if let Some(task) = self.sent.filter(|&task| self.leg != Behaviour::Pursue(task) && in_goal(task)) {
            // It is there already, which takes no policy.
            (self.sent, self.left) = (None, 0);
            ended = Some(PursuitEnd { task, arrived: true, actions: 0, sent: true });
        }
        if let Behaviour::Pursue(task) = self.leg {
            let arrived = in_goal(task);
            if arrived || self.left == 0 {
                self.tallies[task].ended += 1;
                self.tallies[task].reached += usize::from(arrived);
                let sent = arrived && self.sent.take_if(|sent| *sent == task).is_some();
                ended = Some(PursuitEnd { task, arrived, actions: self.pursue_timeout - self.left, sent });
                if self.sent == Some(task) {
                    (self.leg, self.left) = (Behaviour::Explore, self.explore_length);
                } else {
                    let then = if arrived { self.then[task] } else { Then::Schedule };
                    self.begin(then, action, in_goal, able);
                }
            }
        } else if self.left == 0 {
            self.begin(Then::Schedule, action, in_goal, able);
        }
        self.left -= 1;
        (self.leg, ended)
    }

    /// Actions of the pursuit under way before the one that was asked for last, and those that are left with it.
    pub fn pursued(&self) -> (usize, usize) {
        (self.pursue_timeout.saturating_sub(self.left + 1), self.left + 1)
    }

    /// What the scenario says about the time after a task's goal was reached.
    pub fn then(&self, task: usize) -> Then {
        self.then[task]
    }

    /// How pursuits ended so far, by task.
    pub fn tallies(&self) -> &[Tally] {
        &self.tallies
    }

    fn begin(&mut self, then: Then, action: usize, in_goal: &dyn Fn(usize) -> bool, able: &dyn Fn(usize) -> bool) {
        if let Some(task) = self.sent {
            let pursuit = (Behaviour::Pursue(task), self.pursue_timeout);
            (self.leg, self.left) = if able(task) { pursuit } else { (Behaviour::Explore, 1) };
            return;
        }
        let drawn = self.rng.random_range(0.0..1.0) < self.share(action);
        let pursue = then == Then::NextTask || then == Then::Schedule && drawn;
        // A pursuit of a goal in which the robot stands would be over at once: the next task's turn.
        let tasks = self.tallies.len();
        let mut others = (1..=tasks).map(|step| (self.last_task + step) % tasks);
        (self.leg, self.left) = match others.find(|&task| pursue && able(task) && !in_goal(task)) {
            Some(task) => {
                self.last_task = task;
                (Behaviour::Pursue(task), self.pursue_timeout)
            }
            _ => (Behaviour::Explore, self.explore_length),
        };
    }

    fn share(&self, action: usize) -> f64 {
        let rest = self.scenario_actions.saturating_sub(self.explore_actions).max(1);
        let done = action.saturating_sub(self.explore_actions) as f64 / rest as f64;
        if action < self.explore_actions { 0.0 } else { self.pursue_share * done.min(1.0) }
    }
}

impl Persist for BehaviourSchedule {
    fn persist(&mut self, snapshot: &mut Snapshot) -> Result<(), SnapshotError> {
        let tasks = self.tallies.len();
        snapshot.random("random", &mut self.rng)?;
        snapshot.value("leg", &mut self.leg)?;
        snapshot.value("left", &mut self.left)?;
        snapshot.value("last_task", &mut self.last_task)?;
        snapshot.value("sent", &mut self.sent)?;
        snapshot.value("tallies", &mut self.tallies)?;
        let known = match self.leg {
            Behaviour::Pursue(task) => task < tasks,
            Behaviour::Explore => true,
        };
        snapshot.check("tallies", known && self.last_task < tasks && self.tallies.len() == tasks, "other tasks")
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::stream;

    #[test]
    fn a_robot_that_is_sent_somewhere_goes_there_however_long_it_takes() {
        let text = include_str!("../../scenarios/lab.toml");
        let scenario = Scenario::parse(text, "lab.toml".as_ref(), &[]).unwrap();
        let mut schedule = BehaviourSchedule::new(&scenario, stream(1, "legs"));
        let (never, always) = (|_: usize| false, |_: usize| true);
        // Without a policy for it, it explores, and may come there so; then it goes there, and explores again when a pursuit has taken too
        // long.
        schedule.send(Goto::Task(1));
        let (leg, ended) = schedule.next(0, &|task| task == 1, &never);
        assert_eq!((leg, schedule.sent), (Behaviour::Explore, None));
        assert_eq!(ended, Some(PursuitEnd { task: 1, arrived: true, actions: 0, sent: true }));
        schedule.send(Goto::Task(1));
        assert_eq!(schedule.next(0, &never, &never).0, Behaviour::Explore);
        let (pursues, explores) = (scenario.policy.pursue_timeout, scenario.policy.explore_length);
        let mut ends = Vec::new();
        for action in 1..200 {
            schedule.send(Goto::Task(1));
            let (leg, ended) = schedule.next(action, &never, &always);
            let pursued = (action - 1) % (pursues + explores) < pursues;
            assert_eq!(leg == Behaviour::Pursue(1), pursued, "action {action}: {leg:?}");
            ends.extend(ended);
        }
        assert_eq!(ends.len(), 2);
        assert!(ends.iter().all(|end| !end.arrived && !end.sent));
        let (leg, ended) = schedule.next(200, &|task| task == 1, &always);
        assert_eq!((leg, schedule.sent), (Behaviour::Explore, None));
        assert!(ended.is_some_and(|end| end.arrived && end.sent && end.task == 1));
        // It is there already; and a pursuit of another goal is given up for it.
        schedule.send(Goto::Task(1));
        let (_, ended) = schedule.next(201, &|task| task == 1, &always);
        assert_eq!(ended, Some(PursuitEnd { task: 1, arrived: true, actions: 0, sent: true }));
        schedule.send(Goto::Task(0));
        assert_eq!(schedule.next(202, &never, &always).0, Behaviour::Pursue(0));
        schedule.send(Goto::Task(1));
        assert_eq!(schedule.next(203, &never, &always), (Behaviour::Pursue(1), None));
        schedule.send(Goto::Schedule);
        assert_eq!(schedule.next(204, &never, &always).0, Behaviour::Explore);
    }
}
