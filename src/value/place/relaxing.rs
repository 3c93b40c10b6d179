//! Straightening a map: what is known of its shape, brought into line with how the robot has driven.
//!
//! A map that grew behind the robot keeps the turns that were wrong while it grew: corridors are bent, and rooms on both sides of a wall
//! overlap. Where a robot has come back to, it is right on the small scale. So the way is cut into pieces that stay as they are; steps
//! tell how each lies from the one before, and a state that looks like others around it says that its piece lies where these are. The
//! poses of the pieces that contradict all of that least are the new map. At first states are asked that are far around: that closes
//! loops which are open by some moves, and lays on each other what stands on the map twice. Then nearer ones tell more exactly.
//!
//! # Reference
//! Lu & Milios 1997 (consistent pose estimation); Agarwal et al. 2013 (closures that are wrong count little).

use std::ops::Range;

use super::goals::SIDE;
use super::graph::{Factor, PoseGraph};
use super::states::{BESIDE, Cells, PlaceMap, beside, cell};
use super::{PlaceMetric, Pose, turned};
use crate::kernel::products::map_all;
use crate::value::MapStep;

/// States of a piece.
const PIECE: usize = 10;
/// How near states are that may have been in one place, moves: rounds, one after another. Rooms that look alike are farther away.
const NEAR: [f64; 5] = [8.0, 6.0, 4.0, 3.0, 2.0];
/// Where it is not known how long steps are but for more than this share, the last round is all: states that are far away would count more
/// than steps.
const EXACT: f64 = 0.05;
/// How far they may be turned to each other, radians.
const TURNED: f64 = 0.4;
/// They look alike by at least this, and those that look most alike are asked, so many for each piece.
const ALIKE: f64 = 0.3;
const MOST: usize = 4;
/// Standard deviations of what these tell, moves and radians; where they lie apart, as along a corridor, it is more.
const CLOSURE: (f64, f64) = (1.0, 0.2);
/// From so many standard deviations on, what is known counts less and less: some states were taken for others, and a way on which the robot
/// got lost goes on elsewhere.
const CAUCHY: f64 = 3.0;
/// Standard deviations of where a piece lies behind the one before, however exact its steps are: moves and radians.
const LEAST: f64 = 0.03;
const LEAST_TURN: f64 = 0.01;
/// Steps of the optimisation at most, and the step that ends it, moves or radians.
const STEPS: usize = 20;
const TOLERANCE: f64 = 1e-3;

/// States that follow each other and keep their places to each other.
struct Piece {
    /// Number of the way.
    way: usize,
    states: Range<usize>,
    /// The first one that has a place, and this.
    first: usize,
    pose: Pose,
}

impl PlaceMap {
    /// Straighten it by `steps`, which are known between the states of each of the `ways`.
    pub(super) fn relax(&mut self, ways: &[Range<usize>], steps: &[Option<MapStep>]) {
        let rounds = if self.metric.noise.length <= EXACT { &NEAR[..] } else { &NEAR[NEAR.len() - 1..] };
        rounds.iter().for_each(|&near| self.relax_by(ways, steps, near));
    }

    /// A round of it.
    fn relax_by(&mut self, ways: &[Range<usize>], steps: &[Option<MapStep>], near: f64) {
        let pieces = self.pieces(ways);
        let mut of_state = vec![None; self.poses.len()];
        for (number, piece) in pieces.iter().enumerate() {
            of_state[piece.states.clone()].fill(Some(number));
        }
        let driven = pieces.iter().zip(&pieces[1.min(pieces.len())..]).enumerate();
        let driven = driven.filter(|(_, (from, to))| from.way == to.way);
        let driven = driven.map(|(number, (from, to))| self.driven(number, from.first..to.first, steps));
        let closures = map_all(pieces.len(), |to| {
            let like = self.like(pieces[to].first, near).into_iter();
            let like = like.filter_map(|state| Some((of_state[state]?, self.poses[state]?)));
            let like: Vec<(usize, Pose)> = like.collect();
            let aside = CLOSURE.0.hypot(spread(&like));
            let closure = |(from, pose): (usize, Pose)| Factor {
                from,
                to,
                measured: pose.seen_from(&pieces[from].pose),
                sigmas: [aside, aside, CLOSURE.1],
                cauchy: Some(CAUCHY),
            };
            like.into_iter().filter(|of| of.0 != to).map(closure).collect::<Vec<_>>()
        });
        let factors: Vec<Factor> = driven.chain(closures.into_iter().flatten()).collect();
        // What nothing ties to the others says nothing of the map's shape, and would leave the equations without a solution.
        let mut number = vec![None; pieces.len()];
        factors.iter().for_each(|factor| [factor.from, factor.to].into_iter().for_each(|of| number[of] = Some(0)));
        let tied: Vec<&Piece> = pieces.iter().zip(&number).filter(|of| of.1.is_some()).map(|of| of.0).collect();
        number.iter_mut().flatten().zip(0..).for_each(|(number, place)| *number = place);
        let of = |piece: usize| number[piece].expect("a piece with a factor has a number");
        let factors = factors.iter().map(|factor| Factor { from: of(factor.from), to: of(factor.to), ..*factor });
        let graph = PoseGraph::new(tied.iter().map(|piece| piece.pose).collect(), factors.collect());
        // A map that cannot be straightened, as its numbers are out of all bounds, stays as it is.
        let Ok(graph) = graph.and_then(|mut graph| graph.optimise(STEPS, TOLERANCE).map(|_| graph)) else { return };
        for (piece, &pose) in tied.iter().zip(graph.poses()) {
            self.poses[piece.states.clone()]
                .iter_mut()
                .flatten()
                .for_each(|of| *of = pose.then(&of.seen_from(&piece.pose)));
        }
        self.cells = Cells::of(&self.poses);
    }

    /// Pieces of the ways in which states have places.
    fn pieces(&self, ways: &[Range<usize>]) -> Vec<Piece> {
        let of_way = |(way, states): (usize, &Range<usize>)| {
            let end = states.end;
            states.clone().step_by(PIECE).map(move |start| (way, start..(start + PIECE).min(end))).collect::<Vec<_>>()
        };
        let pieces = ways.iter().enumerate().flat_map(of_way);
        let placed = pieces.filter_map(|(way, states)| {
            let (first, pose) = states.clone().find_map(|state| Some((state, self.poses[state]?)))?;
            Some(Piece { way, states, first, pose })
        });
        placed.collect()
    }

    /// How steps say that the next piece lies: what the robot was told to do, and how inexactly it does it.
    fn driven(&self, number: usize, way: Range<usize>, steps: &[Option<MapStep>]) -> Factor {
        let PlaceMetric { noise, unit, .. } = self.metric;
        let (mut to, mut aside, mut turned) = (Pose::default(), LEAST * LEAST, 0.0);
        for step in steps[way].iter().flatten() {
            let (behind, off) = noise.expected(*step, unit);
            to = to.then(&behind);
            turned += noise.turned(*step).powi(2);
            aside += off * off + turned * (behind.x * behind.x + behind.y * behind.y);
        }
        let sigmas = [aside.sqrt(), aside.sqrt(), turned.max(LEAST_TURN * LEAST_TURN).sqrt()];
        Factor { from: number, to: number + 1, measured: to, sigmas, cauchy: Some(CAUCHY) }
    }

    /// States of other times that are so near a state on the map and look most like it.
    fn like(&self, state: usize, near: f64) -> Vec<usize> {
        let Some(pose) = self.poses[state] else { return Vec::new() };
        let seen: Vec<f32> = self.points.col(state).iter().copied().collect();
        let ([x, y], heading) = cell(pose);
        let reach = (near / SIDE).ceil() as i32;
        let squares = (-reach..=reach)
            .flat_map(|dx| (-reach..=reach).map(move |dy| [x.saturating_add(dx), y.saturating_add(dy)]));
        let over = |square| self.cells.over(square).into_iter().flat_map(|over| beside(heading).map(|at| &over[at]));
        let earlier = squares.flat_map(over).flatten().filter(|&&other| (other as usize) + BESIDE < state);
        let around = earlier.filter(|&&other| {
            let at = self.poses[other as usize].unwrap_or_default();
            (at.x - pose.x).hypot(at.y - pose.y) < near && turned(at.heading, pose.heading) < TURNED
        });
        let likeness = around.map(|&other| (self.likeness(other, &seen), other as usize));
        let mut alike: Vec<(f64, usize)> = likeness.filter(|of| of.0 > ALIKE).collect();
        alike.sort_unstable_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
        alike.into_iter().take(MOST).map(|of| of.1).collect()
    }
}

/// How far places lie from their middle, standard deviation in moves.
fn spread(of: &[(usize, Pose)]) -> f64 {
    let count = of.len().max(1) as f64;
    let (x, y) = of.iter().fold((0.0, 0.0), |(x, y), (_, pose)| (x + pose.x / count, y + pose.y / count));
    let squared: f64 = of.iter().map(|(_, pose)| (pose.x - x).powi(2) + (pose.y - y).powi(2)).sum();
    (squared / count).sqrt()
}
