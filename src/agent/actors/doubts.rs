//! What a person should know of what values are learned from: whether they can be right.

use faer::Mat;

use super::messages::TaskTransition;
use crate::robot::ActionSet;
use crate::scenario::{Scenario, Task};

/// A goal that was met less often is hardly known.
const RARELY: usize = 10;
/// Share of the moves that change nothing in the picture from which on pictures do not tell places.
const UNCHANGED: f64 = 0.05;
/// Share of the transitions that may be worth less than nothing.
const BELOW: f64 = 0.5;

/// Doubts about a window. `worths`: of local values, what its transitions are worth by task, `N × 1`; of others none.
pub fn doubts<'a>(
    scenario: &Scenario,
    window: &[TaskTransition],
    worths: impl Iterator<Item = &'a Mat<f64>>,
) -> Vec<String> {
    let tasks = || scenario.tasks.iter().enumerate();
    let rare = tasks().filter(|(number, task)| !task.is_shown() && is_rare(window, *number));
    let rare = rare.map(|(_, task)| {
        let larger = if task.goal.is_some() { ", or make its radius larger" } else { "" };
        format!(
            "the goal of {:?} was met less than {RARELY} times in the window, and what leads there is hardly known: explore longer \
             (policy.explore_share){larger}",
            task.name
        )
    });
    let below = tasks().zip(worths).filter(|(_, worth)| is_below(worth));
    let below = below.filter(|((number, _), _)| !is_rare(window, *number)).map(|((_, task), _)| unworthy(task));
    let unchanged = is_unchanged(&scenario.robot.actions, window).then(|| {
        format!(
            "{:.0} % of the moves or more change nothing in the picture: it does not tell places there (walls of one colour close by), \
             or something stops the robot and nobody says so",
            100.0 * UNCHANGED
        )
    });
    rare.chain(below).chain(unchanged).collect()
}

fn unworthy(task: &Task) -> String {
    format!(
        "most actions are worth less than nothing for {:?}: from there the window knows no way to its goal, or what is to be avoided costs \
         more than the goal gives; explore longer (policy.explore_share), or give what is to be avoided a reward nearer to 0",
        task.name
    )
}

fn is_rare(window: &[TaskTransition], task: usize) -> bool {
    window.iter().filter(|t| t.result.in_goal[task]).count() < RARELY
}

fn is_below(worth: &Mat<f64>) -> bool {
    let below = worth.col_iter().flat_map(|column| column.iter()).filter(|worth| **worth < 0.0).count();
    below as f64 > BELOW * worth.nrows() as f64
}

fn is_unchanged(actions: &ActionSet, window: &[TaskTransition]) -> bool {
    let moves = window
        .iter()
        .filter(|t| !t.result.blocked && actions.get(t.action).is_some_and(|action| actions.advances(action)));
    let (count, alike) =
        moves.fold((0, 0), |(count, alike), t| (count + 1, alike + usize::from(t.from.pixels == t.to.pixels)));
    alike > 0 && alike as f64 >= UNCHANGED * f64::from(count)
}

#[cfg(test)]
mod tests {
    use std::path::Path;
    use std::sync::Arc;

    use super::super::messages::TaskOutcomes;
    use super::*;
    use crate::vision::Observation;

    /// Two hundred actions: some end in the goal, some moves change nothing.
    fn window(goals: usize, unchanged: usize, blocked: bool) -> Vec<TaskTransition> {
        let seen = |frame: u64, pixel: u8| Arc::new(Observation { frame, pixels: vec![pixel] });
        let transition = |j: usize| {
            let in_goal = vec![j < goals];
            let result = TaskOutcomes { rewards: vec![0.0], in_goal, avoided: 0.0, blocked, step: None };
            let to = if j < 2 * unchanged { 1 } else { 2 };
            let (from, to) = (seen(j as u64, 1), seen(j as u64 + 1, to));
            // A move, then a turn.
            TaskTransition { from, action: j % 2, allowed: 7, result, to, cell: 0 }
        };
        (0..200).map(transition).collect()
    }

    #[test]
    fn what_is_hardly_known_is_said() {
        let text = "[[world.wall]]\npoints = [[0.0, 0.0], [3.0, 0.0], [3.0, 3.0], [0.0, 3.0]]\nclosed = true\n[[task]]\nname = \"there\"\n\
                    goal = [1.0, 1.0]\n[robot]\nstart = [2.0, 2.0]\n";
        let scenario = Scenario::parse(text, Path::new("doubts.toml"), &[]).unwrap();
        let worth = |below: usize| [Mat::from_fn(200, 1, |j, _| if j < below { -1.0 } else { 1.0 })];
        let said = |window: &[TaskTransition], worths: &[Mat<f64>]| {
            let said = doubts(&scenario, window, worths.iter());
            ["met less than 10 times", "worth less than nothing", "change nothing in the picture"]
                .map(|text| said.iter().filter(|doubt| doubt.contains(text)).count())
        };
        assert_eq!(said(&window(10, 4, false), &worth(100)), [0, 0, 0]);
        assert_eq!(said(&window(9, 4, false), &worth(100)), [1, 0, 0]);
        assert_eq!(said(&window(10, 4, false), &worth(101)), [0, 1, 0]);
        // Before the goal was met values are nothing else.
        assert_eq!(said(&window(0, 4, false), &worth(200)), [1, 0, 0]);
        assert_eq!(said(&window(10, 5, false), &[]), [0, 0, 1]);
        assert_eq!(said(&window(10, 100, true), &[]), [0, 0, 0]);
    }
}
