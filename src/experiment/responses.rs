//! `responses`: what slow features look like over the room, and which optimal responses they are (thesis §5.2.2, figures
//! *sfa_compare*, *nomix*, *mix*).
//!
//! Features are judged on test maps: 8 headings at 64 × 32 places, seen by a camera without noise. Equally slow responses
//! may mix, so single features are compared with single responses and with pairs of them, and whole sets of features with
//! sets of responses, by the angles between the subspaces that they span.

use faer::{Mat, MatRef};
use serde::{Deserialize, Serialize};

use super::lab::{Data, FRAMES, Lab, points};
use super::maps::{Grid, HEADINGS, Map, sheet};
use super::pairs::Pairs;
use super::pipeline::LAMBDA;
use super::plot::{Line, chart};
use super::spans::{best_pair, by_place, standardised};
use super::trained::{Training, train};
use super::{Band, Bench, Cell, Experiment, ExperimentError, Results, Sizes, Table};
use crate::report::draw::Axis;
use crate::robot::Pose;
use crate::slow::LinearStream;
use crate::slow::theory::OptimalResponses;

/// The experiment.
pub const EXPERIMENT: Experiment = Experiment {
    name: "responses",
    line: "test maps of slow features, their match with optimal responses, mixtures (figures sfa_compare, nomix, mix)",
    lasts: Sizes { full: "6 min", quick: "3 min", smoke: "seconds" },
    run,
};

/// Actions of the walk and support vectors (the thesis had 8064).
const TRAINING: Sizes<(usize, usize)> = Sizes { full: (FRAMES - 1, 8000), quick: (12_000, 1000), smoke: (600, 60) };
/// Places of the test maps (thesis §5.1.5).
const PLACES: Sizes<Grid> = Sizes {
    full: Grid { width: 64, height: 32 },
    quick: Grid { width: 32, height: 16 },
    smoke: Grid { width: 8, height: 4 },
};
/// Places of the maps that are kept for the pictures, at most.
const SHOWN: Grid = Grid { width: 32, height: 16 };
/// Features that are drawn and described one by one.
const SINGLE: usize = 6;
/// Sizes of the sets that are compared as subspaces.
const SETS: [usize; 6] = [1, 3, 6, 10, 20, 30];
/// Responses that single features are looked for among.
const CANDIDATES: usize = 30;
/// What may decide the order of features, tried on functions of the true pose: pairs of frames at even poses in place of a walk, settings
/// that are not the lab's, and how much more moves weigh.
const CONDITIONS: [(&str, bool, &[&str], f64); 4] = [
    ("the walk that the features saw", false, &[], 1.0),
    ("pairs of frames at poses drawn evenly", true, &[], 1.0),
    ("such pairs, a robot of 0.35 m radius", true, &["robot.radius=0.35"], 1.0),
    ("the same, moves weigh 1.5 times as much", true, &["robot.radius=0.35"], 1.5),
];
/// Responses of theory that functions of the true pose are made of.
const WAVES: Sizes<usize> = Sizes { full: 300, quick: 300, smoke: 40 };
/// Features of which the conditions are told.
const ORDERED: usize = 4;
/// Steps in which values of maps are kept.
const STEP: f64 = 0.01;

#[derive(Serialize)]
struct Settings {
    training: Training,
    places: Grid,
    sets: [usize; 6],
    candidates: usize,
}

#[derive(Serialize)]
struct PoseSettings {
    data: Data,
    pairs: bool,
    heavier_moves: f64,
    waves: usize,
    places: Grid,
    candidates: usize,
}

/// What came of a seed.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Outcome {
    /// Support vectors.
    pub support_vectors: usize,
    /// Weight of the derivatives of moves.
    pub move_weight: f64,
    /// Theory's slowest responses: numbers along x, y and heading, and slowness.
    pub theory: Vec<([usize; 3], f64)>,
    /// The first features.
    pub single: Vec<Single>,
    /// For each of the sets: how well the features' span and the responses' agree.
    pub sets: Vec<Subspaces>,
    /// Maps of the first features, in whole steps of 0.01: heading by heading, row by row.
    pub maps: Vec<Vec<i16>>,
    /// Places of these maps.
    pub grid: Grid,
}

/// One feature among the optimal responses.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Single {
    /// Slowness on the training frames, 1/s².
    pub slowness: f64,
    /// Share of its variance that depends on the place alone.
    pub by_place: f64,
    /// The response that is most like it, and their correlation, without its sign.
    pub best: ([usize; 3], f64),
    /// The two responses that explain most of it, their weights, and the share of the variance that they explain.
    pub pair: ([[usize; 3]; 2], [f64; 2], f64),
    /// Share of its variance within the span of all candidates.
    pub explained: f64,
}

/// Angles between the span of the first features and that of as many responses.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Subspaces {
    /// How many.
    pub size: usize,
    /// Mean of the squared cosines of the principal angles: 1 where the spans are the same.
    pub overlap: f64,
    /// The largest angle, degrees.
    pub largest_deg: f64,
}

fn compute(lab: &Lab, settings: &Settings, bench: &Bench<'_>) -> Result<Outcome, ExperimentError> {
    let trained = train(lab, &settings.training, bench)?;
    let weight = lab.thesis_weight(&trained.walked.steps());
    let theory = lab.optimal_responses(&trained.walked.steps(), weight, settings.candidates)?;
    let poses = settings.places.poses(lab);
    let at = |poses: &[Pose]| -> Result<Mat<f64>, ExperimentError> {
        let phi = trained.model.apply(lab.views(poses, bench)?.as_ref(), bench.scope.par)?;
        Ok(phi.subrows(1, phi.nrows() - 1).to_owned())
    };
    let features = at(&poses)?;
    let responses = theory.evaluate(points(&poses).as_ref())?;
    let names = indices(&theory);
    let single = described(features.as_ref(), &trained.model.slowness, (responses.as_ref(), &names), settings.places)?;
    let (f, r) = (standardised(features.as_ref()), standardised(responses.as_ref()));
    let sets = settings.sets.iter().copied().filter(|&size| size <= f.nrows().min(names.len())).map(|size| {
        let (overlap, largest) = overlapping(f.subrows(0, size), r.subrows(0, size))?;
        Ok(Subspaces { size, overlap, largest_deg: largest.to_degrees() })
    });
    // The pictures need no finer grid than this.
    let grid = if settings.places.places() > SHOWN.places() { SHOWN } else { settings.places };
    let shown = if grid == settings.places { features } else { at(&grid.poses(lab))? };
    let kept = |i: usize| shown.row(i).iter().map(|value| (value / STEP).round() as i16).collect();
    Ok(Outcome {
        support_vectors: trained.model.members.ncols(),
        move_weight: weight,
        theory: names.iter().copied().zip(theory.responses().iter().map(|response| response.slowness)).collect(),
        maps: (0..single.len()).map(kept).collect(),
        single,
        sets: sets.collect::<Result<_, ExperimentError>>()?,
        grid,
    })
}

fn indices(theory: &OptimalResponses) -> Vec<[usize; 3]> {
    theory.responses().iter().map(|response| [response.indices[0], response.indices[1], response.indices[2]]).collect()
}

/// The first functions of some, `k × n` on test maps, and their slowness, among responses, `r × n`, and their names.
fn described(
    functions: MatRef<'_, f64>,
    slowness: &[f64],
    (responses, names): (MatRef<'_, f64>, &[[usize; 3]]),
    places: Grid,
) -> Result<Vec<Single>, ExperimentError> {
    let (f, r) = (standardised(functions), standardised(responses));
    let (correlations, among) = (&f * r.transpose(), &r * r.transpose());
    let single = |i: usize| -> Result<Single, ExperimentError> {
        let row: Vec<f64> = (0..names.len()).map(|j| correlations[(i, j)]).collect();
        let best = (0..row.len()).max_by(|&a, &b| row[a].abs().total_cmp(&row[b].abs())).unwrap_or(0);
        let (pair, weights, share) = best_pair(&row, &among);
        Ok(Single {
            slowness: slowness[i],
            by_place: by_place(f.row(i).iter().copied(), places.places()),
            best: (names[best], row[best].abs()),
            pair: (pair.map(|j| names[j]), weights, share),
            explained: overlapping(f.subrows(i, 1), r.as_ref())?.0,
        })
    };
    (0..f.nrows().min(SINGLE)).map(single).collect()
}

/// The slowest functions of the true pose, of as many waves as theory's slowest: what features would be if images told the pose.
fn of_the_pose(lab: &Lab, settings: &PoseSettings, bench: &Bench<'_>) -> Result<Vec<Single>, ExperimentError> {
    bench.go_on()?;
    let actions = settings.data.actions;
    let (poses, steps, links): (Vec<Pose>, _, Box<dyn Fn(f64) -> _>) = if settings.pairs {
        let pairs = Pairs::draw(lab, actions);
        (pairs.poses.clone(), pairs.steps(), Box::new(move |weight| pairs.links(lab, weight)))
    } else {
        let walked = lab.walk(actions);
        (walked.poses.clone(), walked.steps(), Box::new(move |weight| lab.links(&walked, weight)))
    };
    let weight = lab.thesis_weight(&steps) * settings.heavier_moves;
    let waves = lab.optimal_responses(&steps, weight, settings.waves)?;
    let mut stream = LinearStream::new();
    stream.push(waves.evaluate(points(&poses).as_ref())?.as_ref(), &links(weight))?;
    let slowest = stream.solve(SINGLE, LAMBDA)?;
    let at = waves.evaluate(points(&settings.places.poses(lab)).as_ref())?;
    let among = (at.subrows(0, settings.candidates), &indices(&waves)[..settings.candidates]);
    described(slowest.apply(at.as_ref())?.as_ref(), &slowest.slowness, among, settings.places)
}

fn run(bench: &Bench<'_>) -> Result<Results, ExperimentError> {
    let scope = bench.scope;
    let (actions, vectors) = scope.pick(TRAINING);
    let (vectors, places) = (scope.vectors_or(vectors), scope.pick(PLACES));
    bench.plan(scope.seeds.len() * (1 + CONDITIONS.len()));
    let mut outcomes: Vec<Outcome> = Vec::new();
    let mut by_pose = [(); CONDITIONS.len()].map(|()| Vec::new());
    let first = Lab::new(scope.seeds[0], &[])?;
    for &seed in scope.seeds.iter() {
        let lab = Lab::new(seed, &[])?;
        let training = Training::new(&lab, actions, vectors, CANDIDATES);
        let settings = Settings { training, places, sets: SETS, candidates: CANDIDATES };
        outcomes.push(bench.result(&format!("seed {seed}"), &settings, || compute(&lab, &settings, bench))?);
        for ((what, pairs, sets, heavier_moves), found) in CONDITIONS.into_iter().zip(&mut by_pose) {
            let lab = Lab::new(seed, sets)?;
            let (data, waves) = (Data::new(&lab, actions), scope.pick(WAVES));
            let settings = PoseSettings { data, pairs, heavier_moves, waves, places, candidates: CANDIDATES };
            let label = format!("functions of the true pose, {what}, seed {seed}");
            found.push(bench.result(&label, &settings, || of_the_pose(&lab, &settings, bench))?);
        }
    }
    let Some(one) = outcomes.first() else { return Ok(Results::default()) };
    let seed = scope.seeds[0];
    Ok(Results {
        tables: vec![single(one, seed), subspaces(&outcomes), theory(one, seed), orders(one, &by_pose, seed)],
        notes: vec![
            format!(
                "Test maps: {HEADINGS} headings at {} × {} places, a camera without noise; {} support vectors (thesis: 8064), \
                 {} frames (thesis: 35 128).",
                places.width,
                places.height,
                one.support_vectors,
                actions + 1
            ),
            format!(
                "Derivatives of moves weigh {:.2} times those of turns. This random walk turns more than the thesis's; with this \
                 weight φ(2 0 0) and φ(0 0 1) are equally slow in theory, as they must have been there, since they mixed.",
                one.move_weight
            ),
            "φ(i j l): i half waves along x, j along y, l the number of the function of the heading (1: sine, 2: cosine of one \
             turn, …). The thesis's φ100, φ200 and φ001 are φ(1 0 0), φ(2 0 0) and one of φ(0 0 1), φ(0 0 2)."
                .into(),
        ],
        plots: plots(one, &first, &outcomes)?,
    })
}

fn phi([x, y, heading]: [usize; 3]) -> String {
    format!("φ({x} {y} {heading})")
}

/// A feature explained to this share by one response counts as that response, by two as their mixture.
const LIKE: f64 = 0.8;

fn single(outcome: &Outcome, seed: u64) -> Table {
    let mut table = Table::new(format!("The first features as optimal responses, seed {seed}"));
    for (i, found) in outcome.single.iter().enumerate() {
        let ([one, other], [a, b], share) = found.pair;
        let thesis = match i {
            0 => "φ(1 0 0)",
            1 => "a φ(2 0 0) + b φ(0 0 1)",
            2 => "b φ(2 0 0) − a φ(0 0 1)",
            _ => "like no single one",
        };
        let row = [
            ("feature", Cell::count(i + 1)),
            ("slowness, 1/s²", Cell::Number(found.slowness, 4)),
            ("by place alone", Cell::Number(found.by_place, 2)),
            ("most like", Cell::text(phi(found.best.0))),
            ("correlation", Cell::Number(found.best.1, 3)),
            ("mixture of two", Cell::text(format!("{a:+.2} {} {b:+.2} {}", phi(one), phi(other)))),
            ("explained", Cell::Number(share, 3)),
            ("a² + b²", Cell::Number(a * a + b * b, 2)),
            ("explained by 30", Cell::Number(found.explained, 3)),
            ("thesis: simulator", Cell::text(thesis)),
        ];
        table.push(row, says_of_single(i, found));
    }
    table
}

fn says_of_single(i: usize, found: &Single) -> String {
    let alike = found.best.1.powi(2) >= LIKE;
    let mixed = found.pair.2 >= LIKE;
    match i {
        0 if alike && found.best.0 == [1, 0, 0] => "agrees".into(),
        0 => format!("differs: most like {}", phi(found.best.0)),
        1 | 2 if alike => format!("differs: no mixture, but {}", phi(found.best.0)),
        1 | 2 if mixed => {
            let heading = |index: [usize; 3]| index[0] == 0 && index[1] == 0 && index[2] > 0;
            let [one, other] = found.pair.0;
            let same = [one, other].contains(&[2, 0, 0]) && (heading(one) || heading(other));
            if same {
                "agrees: the same mixture".into()
            } else {
                "agrees that it is a mixture; differs: of others".into()
            }
        }
        1 | 2 => "differs: no mixture of two".into(),
        _ if alike => format!("differs: like {}", phi(found.best.0)),
        _ if mixed => "agrees: like no single one; it is a mixture of two".into(),
        _ => "agrees: like no single one".into(),
    }
}

fn subspaces(outcomes: &[Outcome]) -> Table {
    let mut table =
        Table::new("The span of the first features and that of as many optimal responses (overlap: mean cos²)");
    for size in SETS {
        let of: Vec<&Subspaces> =
            outcomes.iter().flat_map(|outcome| &outcome.sets).filter(|set| set.size == size).collect();
        if !of.is_empty() {
            let row = [
                ("features and responses", Cell::count(size)),
                ("overlap", Cell::band(Band::of(of.iter().map(|set| set.overlap)), 3)),
                ("largest angle, °", Cell::band(Band::of(of.iter().map(|set| set.largest_deg)), 1)),
            ];
            table.push(row, "not in the thesis");
        }
    }
    table
}

fn theory(outcome: &Outcome, seed: u64) -> Table {
    let mut table = Table::new(format!("Theory's order of responses for this walk's speeds, seed {seed}"));
    for (i, (index, slowness)) in outcome.theory.iter().enumerate().take(10) {
        let feature = outcome.single.get(i).map(|found| found.slowness);
        let row = [
            ("number", Cell::count(i + 1)),
            ("response", Cell::text(phi(*index))),
            ("slowness in theory, 1/s²", Cell::Number(*slowness, 4)),
            ("slowness of the feature, 1/s²", Cell::maybe(feature, 4)),
        ];
        table.push(row, "no number in its text");
    }
    table
}

/// Which functions are the slowest, and in which order: features, and functions of the true pose under each condition.
fn orders(outcome: &Outcome, by_pose: &[Vec<Vec<Single>>], seed: u64) -> Table {
    let mut table = Table::new(format!("What decides the order, seed {seed}"));
    let conditions =
        CONDITIONS.iter().zip(by_pose).map(|((what, ..), found)| (format!("of the true pose: {what}"), &found[0]));
    for (what, singles) in std::iter::once(("features of images".to_owned(), &outcome.single)).chain(conditions) {
        let shown = &singles[..singles.len().min(ORDERED)];
        let mut row = vec![("functions".into(), Cell::text(what))];
        row.extend(shown.iter().zip(1..).map(|(found, number)| {
            let ([one, other], [a, b], share) = found.pair;
            let mixture = format!("{a:+.2} {} {b:+.2} {}: {share:.2}", phi(one), phi(other));
            (format!("number {number}"), Cell::text(mixture))
        }));
        let mean = shown.iter().map(|found| found.slowness).sum::<f64>() / shown.len() as f64;
        row.push(("mean slowness of these, 1/s²".into(), Cell::Number(mean, 4)));
        let of_the_thesis = |found: &Single| [[2, 0, 0], [0, 0, 1], [0, 0, 2]].contains(&found.best.0);
        let says =
            match (singles[0].best.0 == [1, 0, 0], singles[1..3].iter().filter(|found| of_the_thesis(found)).count()) {
                (true, 2) => "agrees: after φ(1 0 0) come φ(2 0 0) and φ(0 0 1) or φ(0 0 2)",
                (true, 1) => "agrees with one of its second and third",
                _ => "differs",
            };
        table.push(row, says);
    }
    table
}

fn plots(outcome: &Outcome, lab: &Lab, outcomes: &[Outcome]) -> Result<Vec<(String, String)>, ExperimentError> {
    let grid = (outcome.grid, lab.aspect());
    let places = outcome.grid.places();
    let map = |name: String, values: &[f64], heading: usize| Map {
        name,
        values: values[heading * places..(heading + 1) * places].iter().map(|&value| Some(value)).collect(),
    };
    let features: Vec<Vec<f64>> =
        outcome.maps.iter().map(|map| map.iter().map(|&value| f64::from(value) * STEP).collect()).collect();
    let degrees = |heading: usize| format!("{}°", 360 * heading / HEADINGS);
    // The first features in two opposite directions, as in the thesis.
    let compare: Vec<Vec<Map>> = [0, HEADINGS / 2]
        .map(|heading| {
            let of = |(i, values): (usize, &Vec<f64>)| {
                map(format!("feature {}, {}", i + 1, degrees(heading)), values, heading)
            };
            features.iter().enumerate().map(of).collect()
        })
        .into();
    // The first three in all directions, each above the response, or the mixture of two, that is most like it.
    let poses = outcome.grid.poses(lab);
    let axes = lab.axes()?;
    let response = |index: [usize; 3]| -> Vec<f64> {
        let wave = |pose: &Pose| {
            let state = [pose.position.x, pose.position.y, pose.heading];
            (0..3).map(|d| axes[d].wave(index[d], state[d]) * if index[d] == 0 { 1.0 } else { 2f64.sqrt() }).product()
        };
        poses.iter().map(wave).collect()
    };
    let mut matched: Vec<Vec<Map>> = Vec::new();
    for (i, (found, values)) in outcome.single.iter().zip(&features).enumerate().take(3) {
        let all = |name: &str, values: &[f64]| {
            // The name has room above the first map of a line only.
            let head = |h: usize| if h == 0 { name.to_owned() } else { degrees(h) };
            (0..HEADINGS).map(|h| map(head(h), values, h)).collect::<Vec<_>>()
        };
        matched.push(all(&format!("feature {}, 0°", i + 1), values));
        let ([one, other], [a, b], _) = found.pair;
        let (one_values, other_values) = (response(one), response(other));
        let mixture: Vec<f64> = one_values.iter().zip(&other_values).map(|(x, y)| a * x + b * y).collect();
        matched.push(all(&format!("{a:+.1}{} {b:+.1}{}", phi(one), phi(other)), &mixture));
    }
    let sets = Line::new(
        "overlap",
        0,
        SETS.map(|size| {
            let of = outcomes.iter().flat_map(|outcome| &outcome.sets).filter(|set| set.size == size);
            (size as f64, Band::of(of.map(|set| set.overlap)))
        }),
    );
    let overlap = chart(
        "overlap.svg",
        "Span of the first features and of as many optimal responses",
        (&Axis::new("features and responses"), &Axis::new("mean cos² of the principal angles").within(0.0, 1.0)),
        &[sets],
    )?;
    let mixtures = "The first three features, and below each the mixture of two responses that is most like it";
    Ok(vec![
        sheet("compare.svg", "The first features in two opposite directions", grid, &compare)?,
        sheet("mixtures.svg", mixtures, grid, &matched)?,
        overlap,
    ])
}

/// As [`overlap`](crate::evaluate::overlap), with this module's errors.
pub(super) fn overlapping(a: MatRef<'_, f64>, b: MatRef<'_, f64>) -> Result<(f64, f64), ExperimentError> {
    crate::evaluate::overlap(a, b).map_err(|_| ExperimentError::Spans)
}
