//! A way through a room by local values: from random steps to a policy that arrives.
//!
//! `cargo run --release --example local_values`
//!
//! The room is a square of 4 m with a thick wall that leaves a passage at its upper end. A robot makes steps of 0.4 m in four
//! directions, each a little too long or too short; a step into a wall ends where it began. The goal is in the lower right corner.

use adagio::faer::MatRef;
use adagio::random::{fix_parallelism, stream};
use adagio::value::{LocalBatch, LocalOptions, LocalValues, ValueError};
use rand::RngExt;

type Place = [f64; 2];

const SIZE: f64 = 4.0;
const GOAL: Place = [3.6, 0.4];
const MOVES: [(char, Place); 4] = [('>', [0.4, 0.0]), ('^', [0.0, 0.4]), ('<', [-0.4, 0.0]), ('v', [0.0, -0.4])];

fn is_free([x, y]: Place) -> bool {
    let in_room = (0.0..SIZE).contains(&x) && (0.0..SIZE).contains(&y);
    in_room && !((1.6..2.4).contains(&x) && y < 3.0)
}

fn at_goal([x, y]: Place) -> bool {
    (x - GOAL[0]).hypot(y - GOAL[1]) < 0.4
}

/// Where an action leads; `slip` is the error of the step's length, as a share.
fn step([x, y]: Place, action: usize, slip: f64) -> Place {
    let (_, [dx, dy]) = MOVES[action];
    let to = [x + (1.0 + slip) * dx, y + (1.0 + slip) * dy];
    if is_free(to) { to } else { [x, y] }
}

fn main() -> Result<(), ValueError> {
    fix_parallelism();
    // 1. Single random steps from random places. A step costs 0.01, the goal pays 1 and ends the episode.
    let mut rng = stream(1, "steps");
    let mut batch = LocalBatch::new(2, MOVES.len())?;
    while batch.len() < 6000 {
        let from = [rng.random_range(0.0..SIZE), rng.random_range(0.0..SIZE)];
        if !is_free(from) {
            continue;
        }
        let action = rng.random_range(0..MOVES.len());
        let to = step(from, action, rng.random_range(-0.2..0.2));
        if at_goal(to) {
            batch.push(&from, action, 1.0, None)?;
        } else {
            batch.push(&from, action, -0.01, Some(&to))?;
        }
    }

    // 2. What each of them is worth, and so each action at any place.
    let values = batch.fit(&LocalOptions::default(), 0.95)?;
    println!("{} transitions; values settled after {} sweeps", batch.len(), values.fit().iterations);
    println!(
        "followed through the transitions, the greedy policy arrives after {:.1} % of them",
        100.0 * values.arrival()
    );

    // 3. The greedy policy on a map, and on its way from every free place of it.
    let (mut starts, mut arrived) = (0, 0);
    for row in (0..16).rev() {
        let mut line = String::new();
        for column in 0..16 {
            let place = [0.25 * f64::from(column) + 0.125, 0.25 * f64::from(row) + 0.125];
            line.push(match place {
                place if at_goal(place) => 'G',
                place if is_free(place) => {
                    starts += 1;
                    arrived += usize::from(arrives(&values, place)?);
                    MOVES[values.best(&place)?].0
                }
                _ => '#',
            });
        }
        println!("   {line}");
    }
    println!("it arrives from {arrived} of {starts} places");
    assert!(values.fit().converged && arrived == starts);
    Ok(())
}

/// Whether the greedy policy arrives within 60 steps. At the corner of the wall neighbours disagree about what is free: an action that
/// was blocked is not tried a second time at the same place.
fn arrives(values: &LocalValues, mut place: Place) -> Result<bool, ValueError> {
    let mut blocked = [false; MOVES.len()];
    for _ in 0..60 {
        if at_goal(place) {
            return Ok(true);
        }
        let worth = values.action_values(MatRef::from_column_major_slice(&place, 2, 1))?;
        let free = (0..MOVES.len()).filter(|&a| !blocked[a]);
        let Some(action) = free.max_by(|&a, &b| worth[(a, 0)].total_cmp(&worth[(b, 0)])) else { break };
        let to = step(place, action, 0.0);
        blocked = if to == place { blocked } else { [false; MOVES.len()] };
        blocked[action] = to == place;
        place = to;
    }
    Ok(at_goal(place))
}
