use std::f64::consts::FRAC_PI_4;

use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use faer::Mat;

use super::lattice::Lattice;
use super::*;
use crate::random::stream;
use crate::value::{MapStep, ValueError};

/// Rooms of 5 × 5 moves in a row, a door in the middle of each wall between them. What is seen tells the place in a room and the
/// heading up to a quarter of a turn: all rooms look alike, but that one of them is red.
struct Rooms {
    count: usize,
    red: usize,
    rng: ChaCha8Rng,
    at: Pose,
}

const NOISE: MotionNoise = MotionNoise { length: 0.06, heading: 0.0, turning: 0.0, slides: 0.0 };
const ROOM: f64 = 5.0;
const TURNS: [MapStep; 2] =
    [MapStep { turn: FRAC_PI_4, distance: Some(0.0) }, MapStep { turn: -FRAC_PI_4, distance: Some(0.0) }];
const MOVE: MapStep = MapStep { turn: 0.0, distance: Some(1.0) };
const STOPPED: MapStep = MapStep { turn: 0.0, distance: None };

impl Rooms {
    fn new(count: usize, red: usize, seed: u64) -> Self {
        let mut rooms = Rooms { count, red, rng: stream(seed, "rooms"), at: Pose { x: 0.0, y: 0.0, heading: 0.0 } };
        rooms.begin();
        rooms
    }

    fn begin(&mut self) {
        let heading = FRAC_PI_4 * f64::from(self.rng.random_range(0..8u32));
        let x = self.rng.random_range(0.3..self.count as f64 * ROOM - 0.3);
        self.at = Pose { x, y: self.rng.random_range(0.3..ROOM - 0.3), heading };
    }

    fn step(&mut self) -> MapStep {
        let draw = self.rng.random_range(0.0..1.0);
        self.drive_by(if draw < 0.4 { TURNS[usize::from(draw < 0.2)] } else { MOVE })
    }

    fn drive_by(&mut self, step: MapStep) -> MapStep {
        if step != MOVE {
            self.at.heading += step.turn;
            return step;
        }
        let (sin, cos) = self.at.heading.sin_cos();
        let driven = 1.0 + 0.1 * self.rng.random_range(-1.0..1.0);
        let to = Pose { x: self.at.x + driven * cos, y: self.at.y + driven * sin, ..self.at };
        let room = |x: f64| (x / ROOM).floor();
        let inside = (0.2..ROOM - 0.2).contains(&to.y) && (0.2..self.count as f64 * ROOM - 0.2).contains(&to.x);
        let door = (to.y - ROOM / 2.0).abs() < 1.0;
        if !inside || room(to.x) != room(self.at.x) && !door {
            return STOPPED;
        }
        self.at = to;
        MOVE
    }

    fn see(&mut self) -> [f32; 6] {
        let Pose { x, y, heading } = self.at;
        let red = if (x / ROOM) as usize == self.red { 3.0 } else { 0.0 };
        let seen = [
            x.rem_euclid(ROOM),
            y,
            (2.0 * heading).cos() * 2.0,
            (2.0 * heading).sin() * 2.0,
            red,
            red * heading.cos() / 3.0,
        ];
        seen.map(|value| (value + 0.2 * self.rng.random_range(-1.0..1.0)) as f32)
    }

    /// States on a way, steps between them and true poses.
    fn drive(&mut self, length: usize) -> (Mat<f32>, Vec<Option<MapStep>>, Vec<Pose>) {
        let (mut seen, mut steps, mut poses) = (vec![self.see()], Vec::new(), vec![self.at]);
        for _ in 1..length {
            steps.push(Some(self.step()));
            seen.push(self.see());
            poses.push(self.at);
        }
        (Mat::from_fn(6, length, |i, j| seen[j][i]), steps, poses)
    }
}

/// Whether all seeds are tried.
fn long() -> bool {
    std::env::var("ADAGIO_LONG").is_ok_and(|value| value == "1")
}

fn same(a: Pose, b: Pose, moves: f64) -> bool {
    (a.x - b.x).hypot(a.y - b.y) < moves && turned(a.heading, b.heading) < 0.8
}

/// A map of a way through three rooms, with the true poses of its states.
fn learned(rooms: &mut Rooms) -> (PlaceMap, Vec<Pose>) {
    let (points, steps, truth) = rooms.drive(4000);
    (PlaceMap::new(points, &steps, &vec![None; truth.len()], NOISE).unwrap().unwrap(), truth)
}

/// Where a pose of the map truly is: where the state was that is next to it.
fn truly(map: &PlaceMap, truth: &[Pose], pose: Pose) -> Pose {
    let placed = map.poses().iter().enumerate().filter_map(|(state, of)| Some((state, (*of)?)));
    let apart = |of: Pose| (of.x - pose.x).hypot(of.y - pose.y) + turned(of.heading, pose.heading);
    let nearest = placed.min_by(|a, b| apart(a.1).total_cmp(&apart(b.1))).unwrap();
    truth[nearest.0]
}

#[test]
fn places_that_look_alike_are_told_by_the_way_to_them() {
    // Rooms that are quite alike may be taken for one: at most in a third of these seeds. No setting was chosen by them.
    let seeds = if long() { 11..=16 } else { 11..=13 };
    let shares = seeds.map(|seed| {
        let mut rooms = Rooms::new(3, 1, seed);
        let (map, truth) = learned(&mut rooms);
        let poses = map.poses();
        let placed = poses.iter().flatten().count();
        assert!(placed * 10 > truth.len() * 9, "seed {seed}: {placed} of {} have a place", truth.len());
        // The states next to one, much earlier or later: by their places, and by their looks.
        let (mut by_place, mut by_look) = ([0u32; 2], [0u32; 2]);
        for a in (0..truth.len()).step_by(7).filter(|&a| poses[a].is_some()) {
            let others = (0..truth.len()).filter(|&b| a.abs_diff(b) > 200 && poses[b].is_some());
            let near = |b: usize| poses[a].zip(poses[b]).is_some_and(|(a, b)| same(a, b, 0.5));
            let point = |state: usize| map.points().col(state).iter();
            let look = |b: usize| point(a).zip(point(b)).map(|(a, b)| (a - b).powi(2)).sum::<f32>();
            let mut alike: Vec<usize> = others.clone().collect();
            // Squares are not negative, and so their bits are in their order.
            alike.sort_by_cached_key(|&b| look(b).to_bits());
            alike.truncate(8);
            for (told, states) in [(&mut by_place, others.filter(|&b| near(b)).collect()), (&mut by_look, alike)] {
                told[0] += states.iter().filter(|&&b| same(truth[a], truth[b], 1.5)).count() as u32;
                told[1] += states.len() as u32;
            }
        }
        [by_place, by_look].map(|[right, all]| f64::from(right) / f64::from(all))
    });
    let shares: Vec<[f64; 2]> = shares.collect();
    let good = shares.iter().filter(|[by_place, _]| *by_place > 0.9).count();
    assert!(
        3 * good >= 2 * shares.len() && shares.iter().all(|[_, by_look]| *by_look < 0.7),
        "by place and by look: {shares:.2?}"
    );
}

#[test]
fn a_robot_finds_out_where_it_is_and_again_when_it_is_carried_away() {
    let (mut knows, mut trials) = ([0; 2], [0; 2]);
    let seeds: u32 = if long() { 4 } else { 2 };
    for seed in 1..=u64::from(seeds) {
        let mut rooms = Rooms::new(3, 1, seed);
        let (map, truth) = learned(&mut rooms);
        for _ in 0..20 {
            rooms.begin();
            let mut belief = Belief::default();
            map.follow(&mut belief, None, &rooms.see(), &[]).unwrap();
            for carried in 0..2 {
                let mut red = false;
                for _ in 0..80 {
                    let step = rooms.step();
                    map.follow(&mut belief, Some(step), &rooms.see(), &[]).unwrap();
                    red |= (rooms.at.x / ROOM) as usize == rooms.red;
                }
                // Where it has not come into the red room, it cannot know.
                if red {
                    trials[carried] += 1;
                    let pose = belief.modes(1, 1.0)[0].0;
                    knows[carried] += u32::from(same(truly(&map, &truth, pose), rooms.at, 1.5));
                }
                // Nobody tells it.
                rooms.begin();
            }
        }
    }
    // Now and then it takes one of the two rooms that look alike for the other. With four seeds and no doubt 55 of 58 would know it
    // at first, and 41 of 53 when they were carried away; with it 43 and 42.
    let share = |knows: u32, trials: u32| f64::from(knows) / f64::from(trials);
    let each = (0..2).all(|carried| trials[carried] > 10 * seeds && share(knows[carried], trials[carried]) > 0.6);
    assert!(each && share(knows.iter().sum(), trials.iter().sum()) > 0.7, "{knows:?} of {trials:?}");
}

#[test]
fn a_map_goes_on_and_is_the_same_by_its_points() {
    let mut rooms = Rooms::new(3, 1, 12);
    let (points, steps, truth) = rooms.drive(4000);
    let first = 2500;
    let begin = points.as_ref().subcols(0, first).to_owned();
    let map = PlaceMap::new(begin, &steps[..first - 1], &vec![None; first], NOISE).unwrap().unwrap();
    let before: Vec<Option<Pose>> = map.poses().iter().copied().chain(vec![None; 4000 - first]).collect();
    let later = PlaceMap::new(points.clone(), &steps, &before, NOISE).unwrap().unwrap();
    let begin = points.as_ref().subcols(0, 3000).to_owned();
    let on = PlaceMap::go_on(begin, &steps[..2999], &before[..3000], NOISE).unwrap().unwrap();
    // Where no other map is looked for, places stay where they were.
    let stays = |state: usize| map.poses()[state].zip(on.poses()[state]).is_some_and(|(a, b)| same(a, b, 1.0));
    let (kept, new) = ((0..first).filter(|&state| stays(state)).count(), on.poses()[first..].iter().flatten().count());
    assert!(kept * 10 > first * 8 && new > 400, "{kept} of {first} stay, {new} of 500 are placed");
    let placed = later.poses().iter().flatten().count();
    // 3 567 have one. Why the others have none was not examined.
    assert!(placed > 3400, "{placed}");
    // States behind it lie next to those before that are there in truth.
    let near = |a: Pose, b: Pose| same(a, b, 1.0);
    let pairs = (first + 200..4000).step_by(7).flat_map(|a| (0..first).step_by(3).map(move |b| (a, b)));
    let alike = pairs.filter(|&(a, b)| later.poses()[a].zip(later.poses()[b]).is_some_and(|(a, b)| near(a, b)));
    let right: Vec<bool> = alike.map(|(a, b)| same(truth[a], truth[b], 1.5)).collect();
    let count = right.iter().filter(|&&right| right).count();
    assert!(right.len() > 1000 && count * 10 > right.len() * 9, "{count} of {}", right.len());

    let metric = PlaceMetric::from_bits(later.metric().to_bits());
    let known: Vec<usize> = (0..4000).filter(|&state| later.poses()[state].is_some()).collect();
    let column = |state: usize| later.points().col(state).iter().copied().collect::<Vec<f32>>();
    let of = |&state: &usize| metric.point(&column(state), later.poses()[state].unwrap());
    let of: Vec<Vec<f32>> = known.iter().map(of).collect();
    let of = Mat::from_fn(of[0].len(), of.len(), |i, j| of[j][i]);
    let again = PlaceMap::of_points(of.as_ref(), metric).unwrap();
    let mut beliefs = [Belief::default(), Belief::default()];
    for step in 0..60 {
        let (step, seen) = ((step > 0).then(|| rooms.step()), rooms.see());
        later.follow(&mut beliefs[0], step, &seen, &[]).unwrap();
        again.follow(&mut beliefs[1], step, &seen, &[]).unwrap();
        beliefs[1] = Belief::from_parts(beliefs[1].to_parts()).unwrap();
    }
    let [a, b] = beliefs.map(|belief| belief.modes(1, 1.0)[0].0);
    assert!(same(a, b, 0.3), "{a:?} and {b:?}");
    let none = PlaceMetric { unit: 0.0, ..metric };
    assert!(PlaceMap::of_points(of.as_ref(), none).is_err());
    assert!(PlaceMap::of_points(of.as_ref().subrows(0, 4), metric).is_err());
    assert!(Belief::from_parts((vec![[0, 0, f64::NAN.to_bits(), 0]], 0, 0)).is_err());
}

/// Places of states that were met on several ways, and where they truly are.
fn ways(ways: &mut [(Rooms, f64, usize)]) -> (Vec<Option<Pose>>, Vec<Pose>) {
    let (mut seen, mut all, mut truth): (Vec<Mat<f32>>, Vec<Option<MapStep>>, Vec<Pose>) = Default::default();
    for (rooms, x, length) in ways {
        let (points, steps, poses) = rooms.drive(*length);
        if !seen.is_empty() {
            all.push(None);
        }
        seen.push(points);
        all.extend(steps);
        truth.extend(poses.into_iter().map(|pose| Pose { x: pose.x + *x, ..pose }));
    }
    let columns: Vec<Vec<f32>> =
        seen.iter().flat_map(|of| of.col_iter().map(|column| column.iter().copied().collect())).collect();
    let points = Mat::from_fn(6, columns.len(), |i, j| columns[j][i]);
    let map = PlaceMap::new(points, &all, &vec![None; truth.len()], NOISE).unwrap().unwrap();
    (map.poses().to_vec(), truth)
}

#[test]
fn ways_of_several_robots_join_where_they_meet_and_until_then_have_no_places() {
    let placed = |poses: &[Option<Pose>]| poses.iter().flatten().count();
    // The one in the red room comes to no place where the other one was.
    let alone = || [(Rooms::new(1, 1, 21), 0.0, 1000), (Rooms::new(1, 0, 22), ROOM, 1000)];
    let (poses, _) = ways(&mut alone());
    assert!(placed(&poses[..1000]) > 900, "{} of the first", placed(&poses[..1000]));
    assert!(placed(&poses[1000..]) < 100, "{} of the second", placed(&poses[1000..]));
    // A third one drives through both rooms.
    let third = (Rooms::new(2, 1, 23), 0.0, 2000);
    let (poses, truth) = ways(&mut alone().into_iter().chain([third]).collect::<Vec<_>>());
    assert!(placed(&poses[1000..2000]) > 800, "{} of the second", placed(&poses[1000..2000]));
    let pairs = (0..2000).step_by(3).flat_map(|a| (2000..4000).step_by(7).map(move |b| (a, b)));
    let near = pairs.filter(|&(a, b)| poses[a].zip(poses[b]).is_some_and(|(a, b)| same(a, b, 0.5)));
    let right: Vec<bool> = near.map(|(a, b)| same(truth[a], truth[b], 1.5)).collect();
    let count = right.iter().filter(|&&right| right).count();
    assert!(right.len() > 300 && count * 10 > right.len() * 9, "{count} of {}", right.len());
}

#[test]
fn an_angle_goes_around_as_its_remainder_bit_for_bit() {
    let ends = [-2.0 * TAU, -TAU, -0.0, 0.0, TAU, 2.0 * TAU, -1e-300, f64::NAN];
    let beside = ends.into_iter().flat_map(|end: f64| [end, end.next_up(), end.next_down()]);
    for angle in (-20_000..20_000).map(|i| 1e-3 * f64::from(i)).chain(beside) {
        assert_eq!(around(angle).to_bits(), angle.rem_euclid(TAU).to_bits(), "{angle}");
    }
}

#[test]
fn a_map_tells_what_is_seen_behind_a_turn() {
    let mut rooms = Rooms::new(1, 0, 3);
    let (points, _, truth) = rooms.drive(3000);
    let metric = PlaceMetric { noise: NOISE, unit: 1.0, width: 0.5 };
    let of = |j: usize| metric.point(&points.col(j).iter().copied().collect::<Vec<f32>>(), truth[j]);
    let of: Vec<Vec<f32>> = (0..truth.len()).map(of).collect();
    // Each state twice, as two actions may have been tried there.
    let of = Mat::from_fn(10, 2 * of.len(), |i, j| of[j / 2][i]);
    let map = PlaceMap::of_points(of.as_ref(), metric).unwrap();
    assert_eq!(map.poses().len(), truth.len());
    let mut told = 0;
    for state in 0..truth.len() {
        let Some((pose, like)) = map.behind_turn(state, FRAC_PI_4) else { continue };
        let expected = Pose { heading: truth[state].heading + FRAC_PI_4, ..truth[state] };
        assert!(same(pose, expected, 1e-3) && same(pose, truth[like], 0.7), "{state}: {pose:?}");
        told += 1;
    }
    assert!(told * 10 > 9 * truth.len(), "{told} of {}", truth.len());
    // By an angle that no action of this robot turns, nothing was ever seen.
    assert!(map.behind_turn(0, FRAC_PI_4 / 2.0).is_none());
}

#[test]
fn that_no_goal_is_there_tells_rooms_apart_that_look_alike() {
    let (mut wrong, mut trials) = ([0.0; 2], 0);
    for seed in 1..=3 {
        // A map that is right: what goals tell is asked here, not how a map is found.
        let mut rooms = Rooms::new(3, 1, seed);
        let (points, _, truth) = rooms.drive(20_000);
        let metric = PlaceMetric { noise: NOISE, unit: 1.0, width: 0.5 };
        let of = |j: usize| metric.point(&points.col(j).iter().copied().collect::<Vec<f32>>(), truth[j]);
        let of: Vec<Vec<f32>> = (0..truth.len()).map(of).collect();
        let map = PlaceMap::of_points(Mat::from_fn(10, of.len(), |i, j| of[j][i]).as_ref(), metric).unwrap();
        // In the midst of the first room; the last one looks the same.
        let in_goal = |at: Pose| (at.x - ROOM / 2.0).hypot(at.y - ROOM / 2.0) < 1.0;
        let goal = GoalPlaces::new(truth.iter().map(|&at| (at, in_goal(at))));
        assert_eq!(GoalPlaces::from_matrix(&goal.to_matrix()), Ok(goal.clone()));
        let map = map.with_goals(vec![GoalPlaces::default(), goal]);
        for _ in 0..20 {
            rooms.begin();
            rooms.at = Pose { x: 2.5 * ROOM, y: ROOM / 2.0 - 1.0, heading: 2.0 * FRAC_PI_4 };
            let mut beliefs = [Belief::default(), Belief::default()];
            for number in 0..10 {
                // Into the midst of the last room, and once about there.
                let step = [None, Some(MOVE)].get(number).copied().unwrap_or(Some(TURNS[0]));
                rooms.at.y += if number == 1 { 1.0 } else { 0.0 };
                rooms.at.heading += if number > 1 { TURNS[0].turn } else { 0.0 };
                let seen = rooms.see();
                map.follow(&mut beliefs[0], step, &seen, &[]).unwrap();
                map.follow(&mut beliefs[1], step, &seen, &[None, Some(false)]).unwrap();
            }
            trials += 1;
            for (wrong, belief) in wrong.iter_mut().zip(&beliefs) {
                let places = belief.modes(20, 1.0);
                *wrong += places.iter().filter(|of| in_goal(of.0)).map(|of| of.1).sum::<f64>();
            }
        }
    }
    let [without, with] = wrong.map(|wrong| wrong / f64::from(trials));
    assert!(
        without > 0.3 && with < 0.3 * without,
        "believed to be in the goal: {without:.2}, and told not to be: {with:.2}"
    );
    let odd = |rows: usize, share: f64| GoalPlaces::from_matrix(&Mat::from_fn(rows, 2, |_, _| share));
    assert!(odd(2, 0.0).is_err() && odd(3, 1.0).is_err() && odd(3, 0.5).is_err() && odd(3, 0.0).is_ok());
}

#[test]
fn what_does_not_fit_is_refused() {
    let points = || Mat::from_fn(1, 4, |_, j| j as f32);
    let new = |steps: &[Option<MapStep>], before: &[Option<Pose>], noise| {
        PlaceMap::new(points(), steps, before, noise).map(|map| map.is_some())
    };
    let steps = [Some(MOVE), None, Some(TURNS[0])];
    assert_eq!(new(&steps, &[None; 4], NOISE), Ok(true));
    assert_eq!(new(&[None; 3], &[None; 4], NOISE), Ok(false));
    assert_eq!(new(&[Some(TURNS[0]); 3], &[None; 4], NOISE), Ok(false));
    assert!(new(&steps[1..], &[None; 4], NOISE).is_err() && new(&steps, &[None; 3], NOISE).is_err());
    assert!(new(&steps, &[None; 4], MotionNoise { length: -0.1, ..NOISE }).is_err());
    assert!(new(&steps, &[None; 4], MotionNoise { heading: f64::NAN, ..NOISE }).is_err());
    assert!(new(&steps, &[None; 4], MotionNoise { slides: 1.1, ..NOISE }).is_err());
    let odd = MapStep { turn: f64::NAN, distance: None };
    assert!(new(&[Some(odd); 3], &[None; 4], NOISE).is_err());
    let points = Mat::from_fn(1, 4, |_, j| if j == 2 { f32::NAN } else { 0.0 });
    let found = PlaceMap::new(points, &steps, &[None; 4], NOISE);
    assert!(matches!(found, Err(ValueError::Input { place: 2, .. })));
    let away = Pose { x: f64::INFINITY, y: 0.0, heading: 0.0 };
    assert!(new(&steps, &[Some(away), None, None, None], NOISE).is_err());
    // What never changes says nothing; where it mostly stays, what changes does.
    let alike = |until: usize| Mat::from_fn(1, 4, |_, j| f32::from(j >= until));
    assert!(PlaceMap::new(alike(9), &[Some(MOVE); 3], &[None; 4], NOISE).unwrap().is_none());
    let map = PlaceMap::new(alike(3), &[Some(MOVE); 3], &[None; 4], NOISE).unwrap().unwrap();
    let mut belief = Belief::default();
    assert!(
        map.follow(&mut belief, None, &[0.0, 0.0], &[]).is_err()
            && map.follow(&mut belief, None, &[f32::NAN], &[]).is_err()
    );
    assert!(
        map.follow(&mut belief, Some(odd), &[0.0], &[]).is_err() && map.follow(&mut belief, None, &[0.0], &[]).is_ok()
    );
    // Images like none that was seen, however far.
    for far in [1e3, 1e30, f32::MAX] {
        assert!(map.follow(&mut belief, Some(MOVE), &[far], &[]).is_ok());
        assert!(belief.modes(3, 1.0).iter().all(|of| of.1 > 0.0 && of.1 < 1.001), "{far}: {belief:?}");
    }
}

/// Rooms, and the steps of a way through them by its true poses.
fn driven(count: usize, length: usize, seed: u64) -> (Rooms, Vec<PlaceStep>) {
    let mut rooms = Rooms::new(count, 0, seed);
    let (_, steps, truth) = rooms.drive(length);
    let step = |(from, step): (usize, Option<MapStep>)| {
        let step = step.unwrap();
        let turn = TURNS.iter().position(|turn| *turn == step);
        PlaceStep {
            action: turn.map_or(0, |turn| turn + 1),
            from: truth[from],
            to: truth[from + 1],
            blocked: step == STOPPED,
        }
    };
    let steps = steps.into_iter().enumerate().map(step).collect();
    (rooms, steps)
}

const MOTIONS: [MapStep; 3] = [MOVE, TURNS[0], TURNS[1]];

#[test]
fn values_of_places_lead_through_doors() {
    let in_goal = |at: Pose| (at.x - 1.0).hypot(at.y - 1.0) < 1.0;
    for seed in 21..=23 {
        // About ten states for each square of a move and each of eight headings. With three, 93 of 100 robots arrive, as who is stopped
        // where the values know a way tries it again and again; so do a few here.
        let (mut rooms, steps) = driven(3, 6000, seed);
        let planner = Planner::new(&MOTIONS, &steps, NOISE, 1.0).unwrap();
        let there = |step: &PlaceStep| in_goal(step.to);
        let rewards: Vec<f64> = steps.iter().map(|step| f64::from(u8::from(there(step)))).collect();
        let (nothing, ended) = (vec![0.0; steps.len()], steps.iter().map(there).collect::<Vec<bool>>());
        let outcomes = PlaceOutcomes { rewards: &rewards, avoided: &nothing, ended: &ended };
        let fit = planner.fit(&outcomes, 0.95).unwrap();
        assert!(fit.converged && fit.untried.is_empty(), "seed {seed}: {} sweeps", fit.iterations);
        let (mut arrived, mut longer) = (0, 0.0);
        for _ in 0..100 {
            rooms.begin();
            while in_goal(rooms.at) {
                rooms.begin();
            }
            let value = |at: Pose| planner.values_at(&fit, at).unwrap();
            let expected = value(rooms.at).into_iter().fold(0.0, f64::max).ln() / 0.95f64.ln();
            let (mut driven, mut stopped) = (0, false);
            while !in_goal(rooms.at) && driven < 80 {
                // As with reflexes: what was stopped is not tried again at once.
                let known = value(rooms.at);
                let may = |action: usize| if stopped && action == 0 { f64::NEG_INFINITY } else { known[action] };
                stopped = rooms.drive_by(MOTIONS[crate::value::greedy((0..3).map(may))]) == STOPPED;
                driven += 1;
            }
            arrived += u32::from(in_goal(rooms.at));
            longer += f64::from(driven) - expected;
        }
        // A way takes about as many actions as its value says.
        assert!(arrived >= 97 && (longer / 100.0).abs() < 4.0, "seed {seed}: {arrived} arrive, {:.1}", longer / 100.0);
    }
}

#[test]
fn what_is_to_be_avoided_is_gone_around_and_an_action_never_tried_is_not_taken() {
    let (_, steps) = driven(1, 4000, 31);
    let planner = Planner::new(&MOTIONS, &steps, NOISE, 1.0).unwrap();
    let near = |step: &PlaceStep, x: f64| f64::from(u8::from((step.to.x - x).hypot(step.to.y - 2.5) < 0.8));
    let rewards: Vec<f64> = steps.iter().map(|step| near(step, 4.3)).collect();
    let avoided: Vec<f64> = steps.iter().map(|step| -5.0 * near(step, 2.5)).collect();
    let nothing = vec![0.0; steps.len()];
    let ended = vec![false; steps.len()];
    // Before what is to be avoided, the goal straight behind it; and beside it.
    let [before, beside] = [2.5, 4.3].map(|y| Pose { x: 1.0, y, heading: 0.0 });
    let best = |avoided: &[f64], at: Pose| {
        let outcomes = PlaceOutcomes { rewards: &rewards, avoided, ended: &ended };
        crate::value::greedy(planner.values_at(&planner.fit(&outcomes, 0.9).unwrap(), at).unwrap())
    };
    assert_eq!((best(&nothing, before), best(&avoided, beside)), (0, 0));
    assert_ne!(best(&avoided, before), 0);

    let turns: Vec<PlaceStep> = steps.iter().filter(|step| step.action != 2).copied().collect();
    let planner = Planner::new(&MOTIONS, &turns, NOISE, 1.0).unwrap();
    let count = turns.len();
    let outcomes = PlaceOutcomes { rewards: &rewards[..count], avoided: &nothing[..count], ended: &ended[..count] };
    let fit = planner.fit(&outcomes, 0.9).unwrap();
    assert!(fit.untried == [2] && fit.weights.col(2).iter().all(|value| *value == f64::NEG_INFINITY));
    let refused = |rewards: &[f64], gamma: f64| planner.fit(&PlaceOutcomes { rewards, ..outcomes }, gamma).is_err();
    assert!(
        refused(&rewards[1..count], 0.9) && refused(&rewards[..count], 1.0) && refused(&vec![f64::NAN; count], 0.9)
    );
    assert!(
        Planner::new(&MOTIONS, &[], NOISE, 1.0).is_err() && Planner::new(&MOTIONS[..2], &steps, NOISE, 1.0).is_err()
    );
    let odd = [PlaceStep { to: Pose { x: f64::NAN, ..before }, ..steps[0] }];
    assert!(Planner::new(&MOTIONS, &odd, NOISE, 1.0).is_err() && Planner::new(&MOTIONS, &steps, NOISE, 0.0).is_err());
}

#[test]
fn a_lattice_interpolates_between_poses_near_states() {
    // States on all of a floor of six by four moves.
    let states = (0..13).flat_map(|x| (0..9).map(move |y| (f64::from(x) * 0.5, f64::from(y) * 0.5)));
    let states = states.map(|(x, y)| Pose { x, y, heading: 0.0 });
    let lattice = Lattice::new(states.clone());
    let of = |pose: Pose| [2.0 * pose.x - 3.0 * pose.y, pose.heading];
    let values: Vec<[f64; 2]> = (0..lattice.len()).map(|number| of(lattice.pose(number))).collect();
    let values = Mat::from_fn(lattice.len(), 2, |i, j| values[i][j]);
    let mean = |pose: Pose| lattice.mean(values.as_ref(), pose);
    let [a, b] = [(1.3, 2.2, 0.4), (3.75, 0.6, 5.1)].map(|(x, y, heading)| Pose { x, y, heading });
    for pose in [a, b] {
        let found = mean(pose).unwrap();
        assert!(found.iter().zip(of(pose)).all(|(found, expected)| (found - expected).abs() < 1e-9), "{found:?}");
        assert!((lattice.known(pose) - 1.0).abs() < 1e-12);
    }
    let nowhere = Pose { x: 20.0, y: 20.0, heading: 0.0 };
    // Where nobody was, nothing is known, and no way leads there.
    assert!(mean(nowhere).is_none() && lattice.is_way(a, nowhere) == 0.0);
    assert_eq!(Lattice::new(std::iter::empty()).len(), 0);
    // Where one state was, and elsewhere fifteen at each point, it is taken for misplaced.
    let crowd = states.flat_map(|state| [state; 15]).chain([Pose { x: 40.0, y: -9.1, heading: 1.0 }]);
    assert_eq!(Lattice::new(crowd).len(), lattice.len());
}

#[test]
fn a_bent_map_is_straightened_and_a_straight_one_stays() {
    // Up and down a corridor of 60 moves, whose map is an arc of one radian.
    let (mut truth, mut steps) = (vec![Pose::default()], Vec::new());
    let drive = |step: MapStep, truth: &mut Vec<Pose>, steps: &mut Vec<Option<MapStep>>| {
        let behind = NOISE.expected(step, 1.0).0;
        truth.push(truth.last().unwrap().then(&behind));
        steps.push(Some(step));
    };
    for _ in 0..6 {
        (0..60).for_each(|_| drive(MOVE, &mut truth, &mut steps));
        (0..4).for_each(|_| drive(TURNS[0], &mut truth, &mut steps));
    }
    let seen: Vec<[f32; 3]> =
        truth.iter().map(|at| [at.x, 5.0 * at.heading.cos(), 5.0 * at.heading.sin()].map(|x| x as f32)).collect();
    let points = Mat::from_fn(3, seen.len(), |i, j| seen[j][i]);
    let bent = |at: &Pose| {
        let angle = at.x / 60.0;
        Pose { x: 60.0 * angle.sin(), y: 60.0 * (1.0 - angle.cos()), heading: at.heading + angle }
    };
    let metric = PlaceMetric { noise: NOISE, unit: 1.0, width: 2.0 };
    let off = |map: &PlaceMap| {
        let apart = truth.iter().zip(map.poses()).map(|(a, b)| (a.x - b.unwrap().x).hypot(a.y - b.unwrap().y));
        apart.fold(0.0, f64::max)
    };
    let relaxed = |of: &dyn Fn(&Pose) -> Pose| {
        let mut map = PlaceMap::begin(points.clone(), truth.iter().map(|at| Some(of(at))).collect(), metric);
        let before = off(&map);
        map.relax(std::slice::from_ref(&(0..truth.len())), &steps);
        (before, off(&map))
    };
    let (before, after) = relaxed(&bent);
    assert!(before > 20.0 && after < 0.1 * before, "the bent map was off by {before:.2} moves, and is by {after:.2}");
    // What stands on the map twice, as a loop was not closed, is laid on itself where it is known how far the robot went.
    let metric = PlaceMetric { noise: MotionNoise::measured(0.02), ..metric };
    let beside = Pose { x: 1.0, y: -5.0, heading: 0.1 };
    let double = truth.iter().enumerate().map(|(t, at)| Some(if t < 130 { *at } else { beside.then(at) }));
    let mut map = PlaceMap::begin(points.clone(), double.collect(), metric);
    let before = off(&map);
    map.relax(std::slice::from_ref(&(0..truth.len())), &steps);
    assert!(before > 5.0 && off(&map) < 0.5, "the double map was off by {before:.2} moves, and is by {:.2}", off(&map));

    let (before, after) = relaxed(&|at: &Pose| *at);
    // At both ends of the corridor, states that look alike lie on one side only.
    assert!(before == 0.0 && after < 0.25, "the straight map is off by {after:.2} moves");
}
