//! What is left to who knows everything but which of several rooms that look alike it is in.

use std::sync::Mutex;

use nalgebra::Vector2;

use super::ExperimentError;
use super::field::Field;
use super::quality::Quality;
use crate::evaluate::{OptimalSteps, Situation};
use crate::robot::Pose;
use crate::scenario::in_goal;
use crate::vision::observe;
use crate::world::{FrameMotion, drive};

/// Two observations differ when their pixels do by this much, root mean square, grey levels: half the noise of a camera's pixel.
const DIFFERS: f64 = 1.0;
/// How near walls may be, as a share of the robot's radius: what stands in a wall is no place.
const FITS: f64 = 0.9;

impl Field<'_> {
    /// As [`replanned`](Field::replanned), but for one thing: in rooms of one size a robot does not know which of them it is in, until
    /// what it would see in the others differs from what it sees. It takes what is best on average over all rooms that are left.
    ///
    /// A measure for what learns a map by itself and averages values by its belief: this one knows the floor plan, all images without
    /// noise, and each move exactly. Doorways are rooms, too. In worlds without rooms of one size it is `replanned`.
    pub fn told_apart(&self) -> Result<Vec<Quality>, ExperimentError> {
        let (lab, starts) = (self.lab, self.trials.reference.first().map_or(0, Vec::len));
        let (scenario, arena) = (&lab.scenario, &lab.world.arena);
        let (robot, gamma, camera) = (&scenario.robot, scenario.value.gamma, lab.world.appearance.camera(0));
        let look = |pose: &Pose| observe(&camera.render(pose), &scenario.vision, 0);
        let shifts = shifts(lab.scenario.world.rooms.iter().map(|room| (room.low, room.high)));
        self.qualities(|number| {
            let task = lab.task(number);
            let search = OptimalSteps::new(arena, robot, task, &[], scenario.evaluate.max_steps);
            // How far the rooms where each robot may be are from where it is.
            let left = Mutex::new(vec![shifts.clone(); starts]);
            let is_place = |at: &Pose| {
                let inside = scenario.world.rooms.iter().any(|room| room.contains(at.position));
                // Nobody is in the goal without knowing it.
                inside && arena.clearance(at.position) > FITS * robot.radius && !in_goal(task, at.position)
            };
            let choose = |situation: &Situation<'_>| {
                let pose = *situation.pose;
                let moved = |by: Vector2<f64>| Pose { position: pose.position + by, ..pose };
                let mut may_be = std::mem::take(&mut left.lock().expect("no trial panics")[situation.trial]);
                may_be.retain(|&by| is_place(&moved(by)));
                if !may_be.is_empty() {
                    let seen = look(&pose);
                    may_be.retain(|&by| difference(seen.values().zip(look(&moved(by)).values())) < DIFFERS);
                }
                let worth = |action| {
                    let motion = robot.actions.motion(action);
                    let motion = FrameMotion { length: motion.distance, angle: motion.angle };
                    let of = |from: Pose| {
                        let steps = search.from(drive(from, motion, arena.walls(), robot.radius).0);
                        steps.map_or(0.0, |steps| gamma.powi(steps as i32))
                    };
                    of(pose) + may_be.iter().map(|&by| of(moved(by))).sum::<f64>()
                };
                let worths: Vec<f64> = robot.actions.iter().map(worth).collect();
                left.lock().expect("no trial panics")[situation.trial] = may_be;
                // The first of several, as with one place alone.
                let best = robot.actions.iter().zip(worths).reduce(|best, of| if of.1 > best.1 { of } else { best });
                best.expect("a robot has actions").0
            };
            Ok(self.trials.evaluator.trips(number, false, &choose))
        })
    }
}

/// From one room to another of the same size.
fn shifts(rooms: impl Iterator<Item = ([f64; 2], [f64; 2])> + Clone) -> Vec<Vector2<f64>> {
    let millimetres = |metres: f64| (1000.0 * metres).round() as i64;
    let size = |(low, high): ([f64; 2], [f64; 2])| [0, 1].map(|axis| millimetres(high[axis] - low[axis]));
    let mut shifts = Vec::new();
    for a in rooms.clone() {
        let others = rooms.clone().filter(|&b| a != b && size(a) == size(b));
        shifts.extend(others.map(|b| [0, 1].map(|axis| millimetres(b.0[axis] - a.0[axis]))));
    }
    shifts.sort_unstable();
    shifts.dedup();
    shifts.into_iter().map(|[x, y]| Vector2::new(x as f64, y as f64) / 1000.0).collect()
}

/// Root mean square.
fn difference(pairs: impl Iterator<Item = (f32, f32)>) -> f64 {
    let (sum, count) = pairs.fold((0.0, 0u32), |(sum, count), (a, b)| (sum + f64::from((a - b) * (a - b)), count + 1));
    (sum / f64::from(count.max(1))).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rooms_of_one_size_lie_apart_and_others_do_not_count() {
        let rooms = [([0.0, 0.0], [2.0, 1.0]), ([3.0, 0.5], [5.0, 1.5]), ([0.0, 4.0], [1.0, 6.0])];
        assert_eq!(shifts(rooms.into_iter()), [Vector2::new(-3.0, -0.5), Vector2::new(3.0, 0.5)]);
    }
}
