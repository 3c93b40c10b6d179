//! `two-rooms-responses`: what slow features look like in two rooms (thesis §5.2.4, figure *egyptfeats*), and what the optimal
//! responses of that floor plan are, which the thesis did not know.
//!
//! Features are looked at as maps over the floor, mean of 8 headings, by a camera without noise. A feature is *of a room* by the
//! share of its mean square that lies there.

use faer::Mat;
use serde::{Deserialize, Serialize};

use super::floor::{APART, Floor, LIKE, OF_ROOM, STEP, Single};
use super::{Pairs, TRANSITIONS, Training, VECTORS, optimal_responses, rooms, train};
use crate::experiment::lab::{Lab, points};
use crate::experiment::maps::{Grid, HEADINGS, Map, sheet};
use crate::experiment::pipeline::slowness_of;
use crate::experiment::responses::overlapping;
use crate::experiment::spans::standardised;
use crate::experiment::{Band, Bench, Cell, Experiment, ExperimentError, Results, Sizes, Table};

/// The experiment.
pub const EXPERIMENT: Experiment = Experiment {
    name: "two-rooms-responses",
    line: "slow features in two rooms, and the optimal responses of that floor plan (figure egyptfeats)",
    lasts: Sizes { full: "a quarter of an hour", quick: "5 min", smoke: "seconds" },
    run,
};

/// Pairs of frames, and support vectors.
const TRAINING: Sizes<(usize, usize)> = Sizes { full: (TRANSITIONS, VECTORS), quick: (15_000, 1500), smoke: (300, 60) };
/// Places of the maps.
const PLACES: Sizes<Grid> = Sizes {
    full: Grid { width: 64, height: 32 },
    quick: Grid { width: 56, height: 20 },
    smoke: Grid { width: 28, height: 10 },
};
/// Features that are drawn and described one by one: those of the thesis's figure.
const SINGLE: usize = 6;
/// Sizes of the sets that are compared as subspaces.
const SETS: [usize; 6] = [1, 3, 6, 10, 20, 30];
/// Responses that features are compared with.
const CANDIDATES: usize = 30;

/// What may decide how far features are from the optimum: support vectors, pairs, and the camera's noise and drift. What the numbers of
/// pairs and of vectors are divided by, and settings that are not the scenario's.
const CONDITIONS: [(&str, usize, usize, &[&str]); 5] = [
    ("as everywhere here", 1, 1, &[]),
    ("half as many vectors", 1, 2, &[]),
    ("a fifth of the vectors", 1, 5, &[]),
    ("a fifth of the pairs, and of the vectors", 5, 5, &[]),
    ("without noise and drift", 1, 1, &["camera.pixel_noise=0", "camera.exposure_drift=0"]),
];

#[derive(Serialize)]
struct Settings {
    training: Training,
    places: Grid,
    sets: [usize; 6],
    candidates: usize,
}

/// What came of a seed.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Outcome {
    /// Support vectors.
    pub support_vectors: usize,
    /// The first features.
    pub features: Vec<Single>,
    /// The slowest optimal responses that depend on the place alone.
    pub theory: Vec<Single>,
    /// For each of the sets: how well the features' span and the responses' agree: mean of the squared cosines of the principal
    /// angles.
    pub overlaps: Vec<(usize, f64)>,
    /// Slowness of the slowest optimal responses at the true poses of the pairs, 1/s², ascending.
    pub optimal: Vec<f64>,
}

fn compute(lab: &Lab, settings: &Settings, bench: &Bench<'_>) -> Result<Outcome, ExperimentError> {
    let pairs = Pairs::draw(lab, settings.training.data.actions);
    let (_, model) = train(lab, &pairs, &settings.training, bench)?;
    let theory = optimal_responses(lab, &pairs, settings.candidates)?;
    let mut optimal = slowness_of(
        theory.evaluate(points(&pairs.poses).as_ref()).as_ref(),
        &pairs.links(lab, lab.scenario.slow.move_weight),
    );
    optimal.sort_by(f64::total_cmp);
    let floor = Floor::new(lab, settings.places);
    let poses = floor.poses();
    let phi = model.apply(lab.views(&poses, bench)?.as_ref(), bench.scope.par)?;
    let features = phi.subrows(1, phi.nrows() - 1).to_owned();
    let responses = theory.evaluate(points(&poses).as_ref());
    let (f, r) = (standardised(features.as_ref()), standardised(responses.as_ref()));
    let values = |of: &Mat<f64>, i: usize| of.row(i).iter().copied().collect::<Vec<f64>>();
    let correlations = &f * r.transpose();
    let single = |i: usize| -> Result<Single, ExperimentError> {
        let likeness = |j: usize| correlations[(i, j)].abs();
        let best = (0..r.nrows()).max_by(|&a, &b| likeness(a).total_cmp(&likeness(b))).unwrap_or(0);
        Ok(Single {
            best: (best + 1, likeness(best)),
            explained: overlapping(f.subrows(i, 1), r.as_ref())?.0,
            ..floor.look(lab, &values(&features, i), model.slowness[i])
        })
    };
    let of_place = theory.responses().iter().enumerate().filter(|(_, response)| response.heading == 0).take(SINGLE);
    let theory = of_place.map(|(j, response)| Single {
        best: (j + 1, 1.0),
        explained: 1.0,
        ..floor.look(lab, &values(&responses, j), response.slowness)
    });
    let sizes = settings.sets.iter().copied().filter(|&size| size <= f.nrows().min(r.nrows()));
    let overlaps = sizes.map(|size| Ok((size, overlapping(f.subrows(0, size), r.subrows(0, size))?.0)));
    Ok(Outcome {
        support_vectors: model.members.ncols(),
        features: (0..f.nrows().min(SINGLE)).map(single).collect::<Result<_, _>>()?,
        theory: theory.collect(),
        overlaps: overlaps.collect::<Result<_, ExperimentError>>()?,
        optimal,
    })
}

fn run(bench: &Bench<'_>) -> Result<Results, ExperimentError> {
    let scope = bench.scope;
    let (pairs, vectors) = scope.pick(TRAINING);
    let (vectors, places) = (scope.vectors_or(vectors), scope.pick(PLACES));
    bench.plan(scope.seeds.len() * CONDITIONS.len());
    let mut found: [Vec<Outcome>; CONDITIONS.len()] = Default::default();
    for &seed in scope.seeds.iter() {
        for ((what, fewer, smaller, sets), outcomes) in CONDITIONS.into_iter().zip(&mut found) {
            let lab = Lab::two_rooms(seed, sets)?;
            let training = Training::new(&lab, pairs / fewer, vectors / smaller, CANDIDATES);
            let settings = Settings { training, places, sets: SETS, candidates: CANDIDATES };
            let label = format!("{what}, seed {seed}");
            outcomes.push(bench.result(&label, &settings, || compute(&lab, &settings, bench))?);
        }
    }
    let outcomes = &found[0];
    let Some(one) = outcomes.first() else { return Ok(Results::default()) };
    let seed = scope.seeds[0];
    let lab = Lab::two_rooms(seed, &[])?;
    Ok(Results {
        tables: vec![
            claims(outcomes),
            features(&lab, one, seed),
            theory(&lab, one),
            overlaps(outcomes),
            conditions(&found, pairs),
        ],
        notes: vec![
            format!(
                "Maps: {} × {} places, mean of {HEADINGS} headings, a camera without noise; {} support vectors (thesis: {VECTORS}), \
                 {pairs} pairs of frames at random poses (thesis: {TRANSITIONS}); derivatives of moves weigh {} times those of turns.",
                places.width, places.height, one.support_vectors, lab.scenario.slow.move_weight
            ),
            format!(
                "Share: of the map's mean square; from {OF_ROOM} on a map is of one room. Wave: φ(i j) has i half waves along x and j along \
                 y over that room alone. A map tells the rooms apart if its means in them have different signs and are {APART} of \
                 its root mean square or more."
            ),
            format!(
                "Optimal responses of this floor plan: eigenfunctions of its Laplacian with reflecting walls, by finite differences \
                 on cells of {} m, times functions of the heading.",
                super::CELL
            ),
        ],
        plots: plots(&lab, one, places)?,
    })
}

/// What the thesis says of its first six filters, counted.
fn claims(outcomes: &[Outcome]) -> Table {
    let mut table = Table::new("What the thesis says of its first six filters, and how many of ours are so");
    type Holds = fn(&Single) -> bool;
    let rows: [(&str, usize, Holds); 4] = [
        ("positive in one room, negative in the other (filter 1)", 1, Single::tells_rooms_apart),
        ("like φ(1 0) in one room, near zero in the other (filters 2, 6)", 2, |single| single.is_wave([1, 0])),
        ("like φ(0 1) in one room, near zero in the other (filters 3, 5)", 2, |single| single.is_wave([0, 1])),
        ("in both rooms (filters 1, 4)", 2, |single| !single.is_of_one_room()),
    ];
    for (claim, theirs, holds) in rows {
        let count = |of: fn(&Outcome) -> &Vec<Single>| {
            let counts =
                outcomes.iter().map(|outcome| of(outcome).iter().filter(|single| holds(single)).count() as f64);
            Band::of(counts)
        };
        let ours = count(|outcome| &outcome.features);
        let mean = ours.map_or(0.0, |band| band.mean);
        let says = if (mean - theirs as f64).abs() < 0.5 {
            "agrees".to_owned()
        } else {
            format!("differs: {}", if mean < theirs as f64 { "fewer" } else { "more" })
        };
        let row = [
            ("thesis: claim", Cell::text(claim)),
            ("thesis: of six", Cell::count(theirs)),
            ("features here", Cell::band(ours, 0)),
            ("optimal responses here", Cell::band(count(|outcome| &outcome.theory), 0)),
        ];
        table.push(row, says);
    }
    table
}

/// Columns that say where a function lives.
fn lives(lab: &Lab, single: &Single) -> [(String, Cell); 7] {
    let (room, [x, y], correlation) = single.wave;
    let rooms = rooms(lab);
    let mean = |room: usize| (format!("mean, {}", rooms[room].name), Cell::Number(single.means[room], 2));
    let share = |room: usize| (format!("share, {}", rooms[room].name), Cell::Number(single.shares[room], 2));
    let wave = Cell::text(format!("{}: φ({x} {y})", rooms[room].name));
    let correlation = ("correlation there".into(), Cell::Number(correlation, 2));
    [mean(0), mean(1), share(0), share(1), share(2), ("wave in its room".into(), wave), correlation]
}

fn features(lab: &Lab, outcome: &Outcome, seed: u64) -> Table {
    let mut table = Table::new(format!("The first features, seed {seed}"));
    for (i, single) in outcome.features.iter().enumerate() {
        let (thesis, agrees) = match i {
            0 => ("tells the rooms apart", single.tells_rooms_apart()),
            1 | 5 => ("φ(1 0) in one room", single.is_wave([1, 0])),
            2 | 4 => ("φ(0 1) in one room", single.is_wave([0, 1])),
            _ => ("in the centre of both rooms", !single.is_of_one_room() && !single.tells_rooms_apart()),
        };
        let mut row = vec![
            ("feature".into(), Cell::count(i + 1)),
            ("slowness, 1/s²".into(), Cell::Number(single.slowness, 4)),
            ("by place alone".into(), Cell::Number(single.by_place, 2)),
        ];
        row.extend(lives(lab, single));
        row.extend([
            ("most like response".into(), Cell::count(single.best.0)),
            ("correlation".into(), Cell::Number(single.best.1, 2)),
            ("explained by 30".into(), Cell::Number(single.explained, 2)),
            ("thesis: its filter".into(), Cell::text(thesis)),
        ]);
        let says = match (agrees, single.tells_rooms_apart(), single.is_of_one_room()) {
            (true, ..) => "agrees".to_owned(),
            (_, true, _) => "differs: tells the rooms apart".to_owned(),
            (_, _, true) => format!("differs: of one room, {}", wave(lab, single)),
            _ => "differs: in both rooms".to_owned(),
        };
        table.push(row, says);
    }
    table
}

fn wave(lab: &Lab, single: &Single) -> String {
    let (room, [x, y], correlation) = single.wave;
    let name = &rooms(lab)[room].name;
    if correlation >= LIKE { format!("φ({x} {y}) of the {name}") } else { format!("no wave of the {name}") }
}

fn theory(lab: &Lab, outcome: &Outcome) -> Table {
    let mut table = Table::new("The slowest optimal responses of the floor plan that depend on the place alone");
    for single in &outcome.theory {
        let slowness = ("slowness, 1/s²".into(), Cell::Number(single.slowness, 4));
        let row = [("number".into(), Cell::count(single.best.0)), slowness];
        table.push(row.into_iter().chain(lives(lab, single)), "not known to the thesis");
    }
    table
}

fn overlaps(outcomes: &[Outcome]) -> Table {
    let mut table =
        Table::new("The span of the first features and that of as many optimal responses (overlap: mean cos²)");
    for size in SETS {
        let of = outcomes.iter().flat_map(|outcome| &outcome.overlaps).filter(|(found, _)| *found == size);
        let values: Vec<f64> = of.map(|(_, overlap)| *overlap).collect();
        if !values.is_empty() {
            let overlap = ("overlap", Cell::band(Band::of(&values), 3));
            table.push([("features and responses", Cell::count(size)), overlap], "not in the thesis");
        }
    }
    table
}

/// How far features are from the optimum under each condition.
fn conditions(found: &[Vec<Outcome>], pairs: usize) -> Table {
    let mut table = Table::new(format!("What the slowness of the first {SINGLE} features depends on"));
    let band = |outcomes: &[Outcome], of: &dyn Fn(&Outcome) -> f64, digits| {
        Cell::band(Band::of(outcomes.iter().map(of)), digits)
    };
    let mean = |values: &mut dyn ExactSizeIterator<Item = f64>| {
        let n = values.len() as f64;
        values.sum::<f64>() / n
    };
    for (outcomes, (what, fewer, ..)) in found.iter().zip(CONDITIONS) {
        let of = |value: fn(&Single) -> f64| move |outcome: &Outcome| mean(&mut outcome.features.iter().map(value));
        let row = [
            ("condition", Cell::text(what)),
            ("pairs", Cell::count(pairs / fewer)),
            ("support vectors", band(outcomes, &|outcome| outcome.support_vectors as f64, 0)),
            ("first, 1/s²", band(outcomes, &|outcome| outcome.features[0].slowness, 4)),
            ("mean, 1/s²", band(outcomes, &of(|single| single.slowness), 4)),
            ("by place alone", band(outcomes, &of(|single| single.by_place), 2)),
            ("explained by 30", band(outcomes, &of(|single| single.explained), 2)),
        ];
        table.push(row, "not in the thesis");
    }
    let optimal = &found[0];
    let of_mean = |outcome: &Outcome| mean(&mut outcome.optimal.iter().take(SINGLE).copied());
    let row = [
        ("condition", Cell::text("optimal responses at the true poses")),
        ("pairs", Cell::count(pairs)),
        ("support vectors", Cell::text("")),
        ("first, 1/s²", band(optimal, &|outcome| outcome.optimal[0], 4)),
        ("mean, 1/s²", band(optimal, &of_mean, 4)),
        ("by place alone", Cell::text("")),
        ("explained by 30", Cell::text("")),
    ];
    table.push(row, "not in the thesis");
    table
}

fn plots(lab: &Lab, outcome: &Outcome, grid: Grid) -> Result<Vec<(String, String)>, ExperimentError> {
    let floor = Floor::new(lab, grid);
    let map = |name: String, single: &Single| {
        let mut values = vec![None; floor.grid.places()];
        for (&place, &value) in floor.inside.iter().zip(&single.map) {
            values[place] = Some(f64::from(value) * STEP);
        }
        Map { name, values }
    };
    // Two lines of three for each, so that the long rooms are large enough to be read.
    let lines = |title: &str, of: &[Single]| -> Vec<Vec<Map>> {
        let maps = of.iter().enumerate().map(|(i, single)| map(format!("{title} {}", i + 1), single));
        let mut maps: Vec<Map> = maps.collect();
        let rest = maps.split_off(maps.len().min(SINGLE / 2));
        [maps, rest].into_iter().filter(|line| !line.is_empty()).collect()
    };
    let mut all = lines("feature", &outcome.features);
    all.extend(lines("optimal of the place,", &outcome.theory));
    let title = "Mean response of headings: features, and optimal responses";
    Ok(vec![sheet("maps.svg", title, (grid, lab.aspect()), &all)?])
}
