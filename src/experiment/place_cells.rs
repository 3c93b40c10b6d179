//! `place-cells`: from a video to cells that are active in one place, or in one direction (thesis §4.2.3, figure
//! *FranziusPC*; Franzius, Sprekeler & Wiskott 2007).
//!
//! A "rat" runs through the lab's room and sees 320° of it. Where it runs slowly and turns its head quickly, what varies slowly
//! in its pictures is where it is; where it runs quickly and turns slowly, it is where it looks. Kernel SFA finds it, and
//! independent components of the slow features are cells that are active in one part of the room, or in one direction.

use std::f64::consts::TAU;

use faer::{Mat, Par};
use nalgebra::{Point2, Vector2};
use rand_distr::{Distribution, StandardNormal};
use serde::{Deserialize, Serialize};

use super::lab::Lab;
use super::maps::{Grid, HEADINGS, Map, sheet};
use super::plot::{Line, chart};
use super::spans::{mean, variance};
use super::{Band, Bench, Cell, Experiment, ExperimentError, Results, Sizes, Table};
use crate::dictionary::{Ald, Parameters, WhenFull, width_for_size};
use crate::kernel::Kernel;
use crate::policy::columns;
use crate::random::stream;
use crate::report::draw;
use crate::robot::Pose;
use crate::slow::ica::{Contrast, Options as IcaOptions, fast_ica};
use crate::slow::theory::{Axis, OptimalResponses, plane_motion};
use crate::slow::{Link, SlowModel, SlowStream, StreamOptions, solve};
use crate::vision::{Observation, observe};
use crate::world::World;

/// The experiment.
pub const EXPERIMENT: Experiment = Experiment {
    name: "place-cells",
    line: "slow features and ICA of a rat's view, slow motion with fast turns and the reverse (figure FranziusPC)",
    lasts: Sizes { full: "3 min", quick: "1 min", smoke: "seconds" },
    run,
};

/// Three cameras side by side see 320°, like the virtual rat of Franzius et al.
const EYES: [f64; 3] = [1.0, 0.0, -1.0];
const EYE_DEG: f64 = 320.0 / 3.0;
/// The rat keeps this distance from the walls, metres.
const MARGIN: f64 = 0.15;
/// Slow features that are solved for, and that theory lists.
const FEATURES: usize = 40;
/// Independent components at most.
const CELLS: usize = 16;
/// Frames of the video, most support vectors, and frames of which [`SHARE`] become some, which gives the kernel width.
const VIDEO: Sizes<(usize, usize, usize)> =
    Sizes { full: (16_000, 2000, 1000), quick: (8000, 1000, 600), smoke: (500, 100, 100) };
const SHARE: f64 = 0.7;
/// Threshold of the dictionary.
const NU: f64 = 0.01;
/// Places of the maps.
pub(super) const PLACES: Sizes<Grid> = Sizes {
    full: Grid { width: 32, height: 18 },
    quick: Grid { width: 24, height: 14 },
    smoke: Grid { width: 8, height: 5 },
};
/// Maps in one line of a sheet.
const LINE: usize = 8;
/// Steps in which values of maps are kept.
const STEP: f64 = 0.01;

/// How the rat moves.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub(super) struct Motion {
    /// Way in one frame, metres.
    pub stride: f64,
    /// Standard deviation of the head's turn in one frame, radians.
    pub turn: f64,
}

pub(super) const MOTIONS: [(&str, Motion); 2] = [
    ("slow motion, fast turns", Motion { stride: 0.05, turn: 0.5 }),
    ("fast motion, slow turns", Motion { stride: 0.30, turn: 0.05 }),
];

#[derive(Serialize)]
struct Settings {
    scenario: String,
    motion: Motion,
    video: (usize, usize, usize),
    places: Grid,
    features: usize,
    cells: usize,
    nu: f64,
}

/// What came of one way of moving.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Outcome {
    /// Support vectors.
    pub support_vectors: usize,
    /// Slowness of the first features, per frame².
    pub slowness: Vec<f64>,
    /// That of theory's.
    pub theory: Vec<f64>,
    /// How many of theory's slowest depend on the place alone, and on the heading alone.
    pub by_place_alone: usize,
    /// The slow features whose components are taken.
    pub features: Cells,
    /// The components.
    pub cells: Cells,
}

/// Feature maps.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Cells {
    /// Share of the variance that the place explains, mean over maps.
    pub by_place: f64,
    /// Share that the heading explains.
    pub by_heading: f64,
    /// Share of the places where the mean over headings is above half of its peak.
    pub field: f64,
    /// Share of the headings where the mean over places is above half of its peak.
    pub sector: f64,
    /// Means over headings at each place, in steps of 0.01, map by map.
    pub maps: Vec<Vec<i16>>,
    /// Means over places for each heading, map by map.
    pub tuning: Vec<Vec<f64>>,
}

impl Cells {
    /// Summaries of features at the poses of a grid, `k × (headings · places)`.
    pub(super) fn of(features: &Mat<f64>, places: usize) -> Self {
        let k = features.nrows();
        let (mut by_place, mut by_heading, mut field, mut sector) = (0.0, 0.0, 0.0, 0.0);
        let (mut maps, mut tuning) = (Vec::new(), Vec::new());
        for i in 0..k {
            let at = |heading: usize, place: usize| features[(i, heading * places + place)];
            let means: Vec<f64> = (0..places).map(|p| mean((0..HEADINGS).map(|h| at(h, p)))).collect();
            let ways: Vec<f64> = (0..HEADINGS).map(|h| mean((0..places).map(|p| at(h, p)))).collect();
            let all: Vec<f64> = features.row(i).iter().copied().collect();
            let whole = variance(&all).max(f64::MIN_POSITIVE);
            by_place += variance(&means) / whole / k as f64;
            by_heading += variance(&ways) / whole / k as f64;
            field += above_half(&means) / k as f64;
            sector += above_half(&ways) / k as f64;
            maps.push(means.iter().map(|value| (value / STEP).round() as i16).collect());
            tuning.push(ways);
        }
        Cells { by_place, by_heading, field, sector, maps, tuning }
    }

    /// Lines of maps for a sheet.
    pub(super) fn lines(&self, what: &str) -> Vec<Vec<Map>> {
        let map = |&i: &usize| {
            let tuning = &self.tuning[i];
            let best = (0..HEADINGS).max_by(|&a, &b| tuning[a].total_cmp(&tuning[b])).unwrap_or(0);
            Map {
                name: format!("{what} {}, most at {}°", i + 1, 360 * best / HEADINGS),
                values: self.maps[i].iter().map(|&value| Some(f64::from(value) * STEP)).collect(),
            }
        };
        let all: Vec<usize> = (0..self.maps.len()).collect();
        all.chunks(LINE).map(|line| line.iter().map(map).collect()).collect()
    }
}

/// Share of values above half of the largest.
fn above_half(values: &[f64]) -> f64 {
    let peak = values.iter().copied().fold(f64::MIN, f64::max);
    values.iter().filter(|&&value| value > 0.5 * peak).count() as f64 / values.len() as f64
}

/// A smooth run between the walls, and a head that turns at random.
pub(super) fn run_of(world: &World, motion: Motion, frames: usize, seed: u64) -> Vec<Pose> {
    let mut rng = stream(seed, "rat");
    let mut normal = || -> f64 { StandardNormal.sample(&mut rng) };
    let (low, high) = world.plan.walls_box();
    let mut place = Point2::new(0.5 * (low.x + high.x), 0.5 * (low.y + high.y));
    let (mut course, mut heading) = (0.0f64, 0.0);
    let mut step = || {
        course += 0.3 * normal();
        heading += motion.turn * normal();
        let mut next = place + motion.stride * Vector2::new(course.cos(), course.sin());
        let inside = |p: Point2<f64>| p > low && p < high && world.plan.clearance(p) >= MARGIN;
        while !inside(next) {
            course += normal();
            next = place + motion.stride * Vector2::new(course.cos(), course.sin());
        }
        place = next;
        Pose::new(place, heading)
    };
    (0..frames).map(|_| step()).collect()
}

/// What the rat sees, one observation a column.
pub(super) fn views(lab: &Lab, poses: &[Pose], bench: &Bench<'_>) -> Result<Mat<f32>, ExperimentError> {
    let mut seen = Vec::with_capacity(poses.len());
    for (t, pose) in poses.iter().enumerate() {
        if t.is_multiple_of(500) {
            bench.go_on()?;
        }
        let mut wide = Observation { frame: t as u64, pixels: Vec::new() };
        for side in EYES {
            let eye = Pose::new(pose.position, pose.heading + (side * EYE_DEG).to_radians());
            let image = lab.world.appearance.camera(0).render(&eye);
            wide.pixels.extend(observe(&image, &lab.scenario.vision, t as u64).pixels);
        }
        seen.push(wide);
    }
    Ok(columns(seen.iter()))
}

fn compute(lab: &Lab, settings: &Settings, bench: &Bench<'_>) -> Result<Outcome, ExperimentError> {
    let (frames, budget, first) = settings.video;
    let par = bench.scope.par;
    let path = run_of(&lab.world, settings.motion, frames, lab.scenario.seed);
    let video = views(lab, &path, bench)?;
    bench.say(&format!("rendered {frames} frames of {} values", video.nrows()));

    let target = (SHARE * first as f64) as usize;
    let sigma = width_for_size(video.as_ref().subcols(0, first), NU, target, Kernel::gaussian, par)?.sigma;
    let kernel = Kernel::gaussian(sigma)?;
    let ald = Ald::new(Parameters { kernel, nu: NU, budget, when_full: WhenFull::Stop, par })?;
    let mut stream_of = SlowStream::new(ald, StreamOptions::default())?;
    let links = Link::regular(frames, 1.0)?;
    for start in (0..frames).step_by(250) {
        bench.go_on()?;
        let end = (start + 250).min(frames);
        stream_of.push(video.as_ref().subcols(start, end - start), &links[start..end])?;
    }
    let count = FEATURES.min(stream_of.dictionary().len() - 1);
    let solved = solve(stream_of.settled_moments()?, count, 1e-7, None)?;
    let model = SlowModel::new(stream_of.dictionary(), &solved)?;
    bench.say(&format!("{} support vectors, sigma {sigma:.0}", model.members.ncols()));

    let (low, high) = lab.world.plan.walls_box();
    let room = [
        Axis::free(low.x + MARGIN, high.x - MARGIN)?,
        Axis::free(low.y + MARGIN, high.y - MARGIN)?,
        Axis::cyclic(0.0, TAU)?,
    ];
    let Motion { stride, turn } = settings.motion;
    let optimal = OptimalResponses::slowest(&room, &plane_motion(stride * stride, turn * turn), FEATURES)?;
    let places_first = optimal.invariant_to(2)?;
    let headings_first = optimal.invariant_to(0)?.min(optimal.invariant_to(1)?);
    // The features that theory lets depend on one of the two alone.
    let pure = places_first.max(headings_first).min(CELLS).min(count).max(2);

    let slow = model.apply(video.as_ref(), par)?;
    let options = IcaOptions { contrast: Contrast::Cube, ..IcaOptions::default() };
    let components = fast_ica(slow.as_ref().subrows(1, pure), options, &mut stream(lab.scenario.seed, "place cells"))?;
    let seen = views(lab, &settings.places.poses(lab), bench)?;
    let slow = model.apply(seen.as_ref(), Par::Seq)?.subrows(1, pure).to_owned();
    let cells = components.apply(slow.as_ref())?;
    let places = settings.places.places();
    Ok(Outcome {
        support_vectors: model.members.ncols(),
        slowness: solved.slowness.clone(),
        theory: optimal.responses().iter().map(|response| response.slowness).collect(),
        by_place_alone: places_first,
        features: Cells::of(&slow, places),
        cells: Cells::of(&cells, places),
    })
}

/// The lab, with the rat's eyes.
pub(super) fn lab(seed: u64) -> Result<Lab, ExperimentError> {
    Lab::new(seed, &[&format!("camera.field_of_view_deg={EYE_DEG}"), "vision.width=12"])
}

/// What comes of both ways of moving, for all seeds.
pub(super) fn outcomes(bench: &Bench<'_>) -> Result<[Vec<Outcome>; 2], ExperimentError> {
    let scope = bench.scope;
    let (video, places) = (scope.pick(VIDEO), scope.pick(PLACES));
    bench.plan(scope.seeds.len() * MOTIONS.len());
    let mut found: [Vec<Outcome>; 2] = Default::default();
    for &seed in scope.seeds.iter() {
        let lab = lab(seed)?;
        for (number, (name, motion)) in MOTIONS.into_iter().enumerate() {
            let scenario = lab.scenario.sha256();
            let settings = Settings { scenario, motion, video, places, features: FEATURES, cells: CELLS, nu: NU };
            found[number]
                .push(bench.result(&format!("{name}, seed {seed}"), &settings, || compute(&lab, &settings, bench))?);
        }
    }
    Ok(found)
}

fn run(bench: &Bench<'_>) -> Result<Results, ExperimentError> {
    let (video, places) = (bench.scope.pick(VIDEO), bench.scope.pick(PLACES));
    let found = outcomes(bench)?;
    let lab = lab(bench.scope.seeds[0])?;
    Ok(Results {
        tables: vec![table(&found), slowness(&found)],
        notes: vec![
            format!(
                "{} frames of 36 × 16 pixels, 320° around; slow motion: {} m and {} rad a frame, fast motion: {} m and {} rad. \
                 Maps: {HEADINGS} headings at {} × {} places. Components are taken of as many slow features as theory lets depend on \
                 place or heading alone, at most {CELLS}.",
                video.0, MOTIONS[0].1.stride, MOTIONS[0].1.turn, MOTIONS[1].1.stride, MOTIONS[1].1.turn, places.width, places.height
            ),
            "Field: share of the places where the mean over headings is above half of its peak; sector: the same of headings. The \
             thesis reports this work of others without numbers."
                .into(),
        ],
        plots: plots(&found, &lab, places)?,
    })
}

fn table(found: &[Vec<Outcome>; 2]) -> Table {
    let mut table = Table::new("Slow features and their independent components");
    for (number, (outcomes, (name, _))) in found.iter().zip(MOTIONS).enumerate() {
        for (what, of) in [
            ("slow features", (|outcome| &outcome.features) as fn(&Outcome) -> &Cells),
            ("components", |outcome| &outcome.cells),
        ] {
            let band = |value: fn(&Cells) -> f64| Band::of(outcomes.iter().map(|outcome| value(of(outcome))));
            let (place, heading) = (band(|cells| cells.by_place), band(|cells| cells.by_heading));
            let (field, before) = (band(|cells| cells.field), Band::of(outcomes.iter().map(|o| o.features.field)));
            let is = |band: Option<Band>, other: Option<Band>| band.map(|band| band.mean) > other.map(|band| band.mean);
            let says = match (number, what) {
                (0, "slow features") if is(place, heading) => "agrees: they know the place",
                (0, "slow features") => "differs: they know the heading",
                (0, _) if is(before, field) => "agrees: components are active in smaller parts of the room",
                (0, _) => "differs: components are as wide as features",
                (_, _) if is(heading, place) => "agrees: they know the heading",
                (_, _) => "differs: they know the place",
            };
            let row = [
                ("motion", Cell::text(name)),
                ("what", Cell::text(what)),
                ("variance by place", Cell::band(place, 2)),
                ("variance by heading", Cell::band(heading, 2)),
                ("field", Cell::band(field, 2)),
                ("sector", Cell::band(band(|cells| cells.sector), 2)),
            ];
            table.push(row, says);
        }
    }
    table
}

fn slowness(found: &[Vec<Outcome>; 2]) -> Table {
    let mut table = Table::new("Slowness of the first features");
    for (outcomes, (name, _)) in found.iter().zip(MOTIONS) {
        for i in 0..6 {
            let of = |list: fn(&Outcome) -> &Vec<f64>| {
                Band::of(outcomes.iter().filter_map(|outcome| list(outcome).get(i).copied()))
            };
            let row = [
                ("motion", Cell::text(name)),
                ("feature", Cell::count(i + 1)),
                ("slowness, 1/frame²", Cell::band(of(|outcome| &outcome.slowness), 4)),
                ("slowness in theory, 1/frame²", Cell::band(of(|outcome| &outcome.theory), 4)),
            ];
            table.push(row, "no number in its text");
        }
    }
    table
}

fn plots(found: &[Vec<Outcome>; 2], lab: &Lab, grid: Grid) -> Result<Vec<(String, String)>, ExperimentError> {
    let names = ["places.svg", "headings.svg"];
    let sheet_of = |(number, outcome): (usize, &Outcome)| {
        let mut all = outcome.features.lines("feature");
        all.extend(outcome.cells.lines("cell"));
        let title = format!("{}: slow features above, components below; means over headings", MOTIONS[number].0);
        sheet(names[number], &title, (grid, lab.aspect()), &all)
    };
    let firsts = found.iter().enumerate().filter_map(|(number, outcomes)| Some((number, outcomes.first()?)));
    let mut plots: Vec<(String, String)> = firsts.map(sheet_of).collect::<Result<_, ExperimentError>>()?;
    if let Some(outcome) = found[1].first() {
        let line = |(i, tuning): (usize, &Vec<f64>)| {
            // Once round, with the first heading again at the end.
            let around = tuning.iter().chain(tuning.first()).enumerate();
            let points = around.map(|(heading, &value)| (360.0 * heading as f64 / HEADINGS as f64, Band::of([value])));
            Line::new(format!("cell {}", i + 1), i, points)
        };
        let lines: Vec<Line> = outcome.cells.tuning.iter().take(LINE).enumerate().map(line).collect();
        let title = format!("{}: components by heading, means over places", MOTIONS[1].0);
        let (x, y) = (draw::Axis::new("heading, °").within(0.0, 360.0), draw::Axis::new("activity"));
        plots.push(chart("tuning.svg", &title, (&x, &y), &lines)?);
    }
    Ok(plots)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cells_are_told_by_what_explains_them() {
        let places = 4;
        let by_place = |_: usize, place: usize| if place == 2 { 1.0 } else { 0.0 };
        let by_heading = |heading: usize, _: usize| (TAU * heading as f64 / HEADINGS as f64).cos();
        let features = Mat::from_fn(2, HEADINGS * places, |i, j| {
            let (heading, place) = (j / places, j % places);
            if i == 0 { by_place(heading, place) } else { by_heading(heading, place) }
        });
        let cells = Cells::of(&features, places);
        assert!((cells.by_place - 0.5).abs() < 1e-12 && (cells.by_heading - 0.5).abs() < 1e-12);
        assert_eq!(cells.maps[0], [0, 0, 100, 0]);
        // One place of four; three headings of eight are above half of the cosine's peak.
        assert!((above_half(&[0.0, 0.0, 1.0, 0.0]) - 0.25).abs() < 1e-12);
        assert!((above_half(&cells.tuning[1]) - 3.0 / 8.0).abs() < 1e-12);
    }
}
