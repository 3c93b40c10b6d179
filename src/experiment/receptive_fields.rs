//! `receptive-fields`: what quadratic slow features of moving images respond to (thesis §4.2.1; Berkes & Wiskott 2005).
//!
//! A window moves, turns and zooms over photographs. Two of its pictures in a row are one input, and quadratic SFA finds functions of them
//! that vary slowly. Berkes & Wiskott found that they respond as complex cells of the visual cortex do: to bars of one orientation,
//! wherever these lie. The response to a drifting grating has a closed form: of a quadratic form it is a mean, a first and a second harmonic of the
//! grating's phase.

use std::f64::consts::{PI, TAU};

use faer::{Mat, MatRef};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use serde::{Deserialize, Serialize};

use super::data::{Packages, photographs};
use super::maps::{Grid, Map, sheet};
use super::{Band, Bench, Cell, Experiment, ExperimentError, Results, Sizes, Table};
use crate::random::stream;
use crate::slow::{Expansion, Keep, LinearStream, Link, Pca, QuadraticForm};

/// The experiment.
pub const EXPERIMENT: Experiment = Experiment {
    name: "receptive-fields",
    line: "what quadratic slow features of moving images respond to (thesis §4.2.1)",
    lasts: Sizes { full: "5 min", quick: "1 min", smoke: "seconds" },
    run,
};

/// How much is seen and kept.
#[derive(Debug, Clone, Copy, Serialize)]
struct Amounts {
    /// Side of the window, pixels.
    window: usize,
    /// Inputs; those of which principal components are found.
    inputs: usize,
    for_components: usize,
    /// Principal components.
    components: usize,
    /// Features that are looked at.
    units: usize,
}

const AMOUNTS: Sizes<Amounts> = Sizes {
    full: Amounts { window: 16, inputs: 250_000, for_components: 20_000, components: 50, units: 100 },
    quick: Amounts { window: 16, inputs: 40_000, for_components: 10_000, components: 50, units: 100 },
    smoke: Amounts { window: 8, inputs: 1500, for_components: 800, components: 12, units: 16 },
};

/// Standard deviations of what the window does from a frame to the next: pixels along each axis, radians, logarithm of its scale.
const MOVE: f64 = 3.0;
const TURN: f64 = 0.1;
const ZOOM: f64 = 0.03;
/// Share of a speed that is left in the next frame: of ways that change, and of ways that go on as they are.
const KEPT: [(&str, f64); 2] = [("speeds that change", 0.8), ("speeds that last", 1.0)];
/// Limits of the scale, and the most frames of one sequence.
const SCALES: (f64, f64) = (0.8, 1.5);
const SEQUENCE: usize = 100;
/// Inputs that are computed together.
const BLOCK: usize = 500;
/// Gratings: orientations in a half turn, cycles in a window, and phases that they advance from a frame to the next, in eighths of a turn.
const ORIENTATIONS: usize = 18;
const CYCLES: [f64; 7] = [1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 6.0];
const ADVANCES: [i32; 8] = [-3, -2, -1, 0, 1, 2, 3, 4];
/// A response this much smaller than the best counts as inhibited.
const INHIBITED: f64 = 0.2;
/// Units in the gallery, and in one line of it.
const GALLERY: usize = 16;
const LINE: usize = 8;
/// Steps in which stimuli are kept.
const STEP: f64 = 0.01;

#[derive(Serialize)]
struct Settings {
    amounts: Amounts,
    data: String,
    seed: u64,
    /// Speeds, and the share of them that is kept.
    moving: [f64; 4],
}

/// What one feature responds to.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Unit {
    /// Slowness, per frame².
    pub slowness: f64,
    /// Direction in which its best grating changes, degrees from the horizontal in [0, 180).
    pub orientation_deg: f64,
    /// Cycles of it in a window.
    pub cycles: f64,
    /// First and second harmonic over the grating's phase, as shares of the mean response.
    pub harmonics: [f64; 2],
    /// Half width of the response over orientations at half its height, degrees; 90 if it never falls so low.
    pub half_width_deg: f64,
    /// By how much less the best grating does when it drifts the other way, as a share.
    pub direction: f64,
    /// Where the response over orientations is lowest, if it is below that to nothing: degrees from the best orientation.
    pub inhibited_at_deg: Option<f64>,
    /// By how much less bars do in their whole length, and gratings in their whole width, than the best ones that are shorter, as shares.
    pub end: f64,
    /// See `end`.
    pub side: f64,
}

/// What came of a seed.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Outcome {
    /// The features, slowest first.
    pub units: Vec<Unit>,
    /// Share of the variance that the principal components have.
    pub variance: f64,
    /// The best and the worst stimulus of the first units, two pictures each, in steps of 0.01 of the largest value.
    pub stimuli: Vec<[Vec<i16>; 2]>,
}

/// A window on its way over photographs.
struct Window<'a> {
    images: &'a [Mat<f64>],
    side: usize,
    kept: f64,
    rng: ChaCha8Rng,
    image: usize,
    /// Middle, pixels; angle; logarithm of its scale.
    at: [f64; 4],
    speed: [f64; 4],
    left: usize,
}

impl<'a> Window<'a> {
    fn new(images: &'a [Mat<f64>], side: usize, kept: f64, seed: u64) -> Self {
        let rng = stream(seed, "receptive fields");
        Window { images, side, kept, rng, image: 0, at: [0.0; 4], speed: [0.0; 4], left: 0 }
    }

    fn normal(&mut self) -> f64 {
        StandardNormal.sample(&mut self.rng)
    }

    /// Where it would be next. The standard deviation of a speed is the same at all times.
    fn next(&mut self) -> [f64; 4] {
        let sizes = [MOVE, MOVE, TURN, ZOOM];
        for (axis, size) in sizes.into_iter().enumerate() {
            self.speed[axis] = self.kept * self.speed[axis] + (1.0 - self.kept.powi(2)).sqrt() * size * self.normal();
        }
        let mut next = self.at;
        (0..4).for_each(|axis| next[axis] += self.speed[axis]);
        next[3] = next[3].clamp(SCALES.0.ln(), SCALES.1.ln());
        next
    }

    /// Half of its diagonal on the photograph, pixels.
    fn reach(&self, at: [f64; 4]) -> f64 {
        at[3].exp() * self.side as f64 / 2f64.sqrt() + 1.0
    }

    fn fits(&self, at: [f64; 4]) -> bool {
        let (image, reach) = (&self.images[self.image], self.reach(at));
        (0..2).all(|axis| {
            let size = if axis == 0 { image.ncols() } else { image.nrows() };
            at[axis] >= reach && at[axis] <= size as f64 - 1.0 - reach
        })
    }

    /// Begin somewhere else.
    fn begin(&mut self) {
        self.left = SEQUENCE;
        self.image = self.rng.random_range(0..self.images.len());
        self.at = [0.0, 0.0, self.rng.random_range(0.0..TAU), self.rng.random_range(SCALES.0.ln()..SCALES.1.ln())];
        let reach = self.reach(self.at);
        let (width, height) = (self.images[self.image].ncols() as f64, self.images[self.image].nrows() as f64);
        self.at[0] = self.rng.random_range(reach..width - 1.0 - reach);
        self.at[1] = self.rng.random_range(reach..height - 1.0 - reach);
        for (axis, size) in [MOVE, MOVE, TURN, ZOOM].into_iter().enumerate() {
            self.speed[axis] = size * self.normal();
        }
    }

    fn picture(&self, at: [f64; 4], into: &mut [f64]) {
        let (image, side, scale) = (&self.images[self.image], self.side as f64, at[3].exp());
        let (sin, cos) = at[2].sin_cos();
        for (number, value) in into.iter_mut().enumerate() {
            let place = |k: usize| scale * (k as f64 + 0.5 - side / 2.0);
            let (u, v) = (place(number % self.side), place(number / self.side));
            let (x, y) = (at[0] + cos * u - sin * v, at[1] + sin * u + cos * v);
            let (left, top) = (x.floor(), y.floor());
            let (a, b) = (x - left, y - top);
            let pixel = |dx: usize, dy: usize| image[(top as usize + dy, left as usize + dx)];
            *value = (1.0 - b) * ((1.0 - a) * pixel(0, 0) + a * pixel(1, 0))
                + b * ((1.0 - a) * pixel(0, 1) + a * pixel(1, 1));
        }
    }

    /// The next inputs, each of two pictures in a row, and how they follow each other.
    fn inputs(&mut self, count: usize) -> (Mat<f64>, Vec<Option<Link>>) {
        let pixels = self.side * self.side;
        let (mut x, mut links) = (Mat::zeros(2 * pixels, count), Vec::with_capacity(count));
        let mut pair = vec![0.0; 2 * pixels];
        for t in 0..count {
            let mut follows = self.left > 0;
            let next = loop {
                if self.left == 0 {
                    self.begin();
                    follows = false;
                }
                let next = self.next();
                if self.fits(next) {
                    break next;
                }
                self.left = 0;
            };
            let (first, second) = pair.split_at_mut(pixels);
            self.picture(self.at, first);
            self.picture(next, second);
            (0..2 * pixels).for_each(|i| x[(i, t)] = pair[i]);
            links.push(follows.then_some(Link { dt: 1.0, weight: 1.0 }));
            self.at = next;
            self.left -= 1;
        }
        (x, links)
    }
}

/// A grating that drifts from one picture to the next, in a part of the window.
#[derive(Debug, Clone, Copy)]
struct Grating {
    /// Direction in which it changes, radians.
    orientation: f64,
    cycles: f64,
    /// Phase that it advances, radians.
    advance: f64,
    /// Length of its bars and width of all of them, as shares of the window's diagonal.
    part: (f64, f64),
}

/// Parts of the window that gratings are tried in.
const PARTS: [(f64, f64); 4] = [(1.0, 1.0), (0.5, 1.0), (1.0, 0.5), (0.5, 0.5)];

/// All gratings that are tried, and what is seen of them.
fn all_gratings(stage: &Stage<'_>) -> Vec<(Grating, [Mat<f64>; 2])> {
    let mut gratings = Vec::new();
    for k in 0..ORIENTATIONS {
        for cycles in CYCLES.into_iter().filter(|&cycles| 2.0 * cycles < stage.side as f64) {
            for (eighths, part) in ADVANCES.into_iter().flat_map(|eighths| PARTS.map(|part| (eighths, part))) {
                let (orientation, advance) = (PI * k as f64 / ORIENTATIONS as f64, f64::from(eighths) * PI / 4.0);
                let grating = Grating { orientation, cycles, advance, part };
                gratings.push((grating, stage.seen(grating)));
            }
        }
    }
    gratings
}

/// The response to a grating less that to nothing: its mean over phases, and two harmonics.
#[derive(Debug, Clone, Copy)]
struct Response {
    mean: f64,
    harmonics: [f64; 2],
}

/// What gratings do to forms.
struct Stage<'a> {
    /// Orthonormal directions of the components, `2·side² × r`.
    basis: MatRef<'a, f64>,
    side: usize,
    /// Length of a stimulus over the whole window.
    radius: f64,
}

impl Stage<'_> {
    /// The components of the grating at phase 0 and at a quarter of a turn.
    fn seen(&self, grating: Grating) -> [Mat<f64>; 2] {
        let (side, pixels) = (self.side as f64, self.side * self.side);
        let (sin, cos) = grating.orientation.sin_cos();
        let amplitude = self.radius / (pixels as f64).sqrt();
        let diagonal = 2f64.sqrt() * side;
        let value = |i: usize, quarter: f64| {
            let (frame, pixel) = (i / pixels, i % pixels);
            let place = |k: usize| k as f64 + 0.5 - side / 2.0;
            // The y axis points down, as in images.
            let (x, y) = (place(pixel % self.side), -place(pixel / self.side));
            let (across, along) = (cos * x + sin * y, -sin * x + cos * y);
            if 2.0 * along.abs() > grating.part.0 * diagonal || 2.0 * across.abs() > grating.part.1 * diagonal {
                return 0.0;
            }
            let phase = TAU * grating.cycles * across / side + grating.advance * frame as f64 + quarter;
            amplitude * phase.cos()
        };
        [0.0, -PI / 2.0].map(|quarter| self.basis.transpose() * Mat::from_fn(2 * pixels, 1, |i, _| value(i, quarter)))
    }
}

/// Of a form: for phase φ the stimulus is `a cos φ + b sin φ`, and so is the response.
fn response(form: &QuadraticForm, [a, b]: &[Mat<f64>; 2]) -> Response {
    let (ha, hb) = (&form.h * a, &form.h * b);
    let product = |x: &Mat<f64>, y: &Mat<f64>| (x.transpose() * y)[(0, 0)];
    let (aa, ab, bb) = (product(a, &ha) / 2.0, product(a, &hb) / 2.0, product(b, &hb) / 2.0);
    let along = |x: &Mat<f64>| (0..x.nrows()).map(|i| form.f[i] * x[(i, 0)]).sum::<f64>();
    Response { mean: (aa + bb) / 2.0, harmonics: [along(a).hypot(along(b)), ((aa - bb) / 2.0).hypot(ab)] }
}

/// How a form responds to gratings. Of the form and its negative it is the one that has more at its best stimulus, as long as a grating excites it.
fn unit(
    form: &QuadraticForm,
    slowness: f64,
    stage: &Stage<'_>,
    gratings: &[(Grating, [Mat<f64>; 2])],
) -> Result<Unit, ExperimentError> {
    let (negative, nothing) = (form.negative(), vec![0.0; form.f.len()]);
    let most =
        |form: &QuadraticForm| Ok::<_, ExperimentError>(form.at(&form.largest_at(stage.radius)?) - form.at(&nothing));
    let peak = |form: &QuadraticForm| {
        let responses = gratings.iter().map(|(grating, seen)| (response(form, seen), *grating));
        responses.max_by(|a, b| a.0.mean.total_cmp(&b.0.mean)).expect("gratings are tried")
    };
    let (first, second) = if most(form)? >= most(&negative)? { (form, &negative) } else { (&negative, form) };
    let (form, (best, grating)) = match peak(first) {
        (best, grating) if best.mean > 0.0 => (first, (best, grating)),
        _ => (second, peak(second)),
    };
    let mean_of = |grating: Grating| response(form, &stage.seen(grating)).mean;
    // Up to a right angle to both sides: beyond it lie the same bars, drifting the other way.
    let step = 180.0 / ORIENTATIONS as f64;
    let turned = |side: f64| -> Vec<f64> {
        let by = |k: usize| side * PI * k as f64 / ORIENTATIONS as f64;
        let orientations = (0..=ORIENTATIONS / 2).map(|k| grating.orientation + by(k));
        orientations.map(|orientation| mean_of(Grating { orientation, ..grating })).collect()
    };
    let sides = [turned(1.0), turned(-1.0)];
    let to_half = |over: &Vec<f64>| {
        let fallen = (1..over.len()).find(|&k| over[k] < best.mean / 2.0);
        fallen.map_or(90.0, |k| step * (k as f64 - 1.0 + (over[k - 1] - best.mean / 2.0) / (over[k - 1] - over[k])))
    };
    let half_width_deg = sides.iter().map(to_half).sum::<f64>() / 2.0;
    let lowest = sides.iter().flat_map(|over| over.iter().enumerate()).min_by(|a, b| a.1.total_cmp(b.1));
    let falls = |of: &dyn Fn(f64) -> (f64, f64)| {
        let parts = (1..=8).map(|eighths| mean_of(Grating { part: of(f64::from(eighths) / 8.0), ..grating }));
        1.0 - mean_of(Grating { part: of(1.0), ..grating }) / parts.fold(best.mean, f64::max)
    };
    Ok(Unit {
        slowness,
        orientation_deg: grating.orientation.to_degrees().rem_euclid(180.0),
        cycles: grating.cycles,
        harmonics: best.harmonics.map(|harmonic| harmonic / best.mean),
        half_width_deg,
        direction: 1.0 - (mean_of(Grating { advance: -grating.advance, ..grating }) / best.mean).max(0.0),
        inhibited_at_deg: lowest.filter(|(_, response)| **response < 0.0).map(|(k, _)| k as f64 * step),
        end: falls(&|share| (share, grating.part.1)),
        side: falls(&|share| (grating.part.0, share)),
    })
}

fn compute(images: &[Mat<f64>], settings: &Settings, bench: &Bench<'_>) -> Result<Outcome, ExperimentError> {
    let Amounts { window: side, inputs, for_components, components, units } = settings.amounts;
    let (first, _) = Window::new(images, side, settings.moving[3], settings.seed).inputs(for_components);
    let pca = Pca::fit(first.as_ref(), Keep::Components(components), true)?;
    drop(first);
    let scale: Vec<f64> = (0..components).map(|i| pca.projection.col(i).norm_l2()).collect();
    let basis = Mat::from_fn(pca.projection.nrows(), components, |i, j| pca.projection[(i, j)] / scale[j]);
    let mut stream = LinearStream::on(bench.scope.par);
    let (mut window, mut lengths) = (Window::new(images, side, settings.moving[3], settings.seed), 0.0);
    for start in (0..inputs).step_by(BLOCK) {
        bench.go_on()?;
        let (x, links) = window.inputs(BLOCK.min(inputs - start));
        let white = pca.apply(x.as_ref())?;
        let length =
            |column: faer::ColRef<'_, f64>| (0..components).fold(0.0, |sum: f64, i| sum.hypot(column[i] / scale[i]));
        lengths += white.col_iter().map(length).sum::<f64>();
        stream.push(Expansion::Quadratic.apply(white.as_ref())?.as_ref(), &links)?;
    }
    let sfa = stream.solve(units, 0.0)?;
    bench.say("the features are found");
    let stage = Stage { basis: basis.as_ref(), side, radius: lengths / inputs as f64 };
    let gratings = all_gratings(&stage);
    let (mut found, mut stimuli) = (Vec::new(), Vec::new());
    for feature in 0..units {
        bench.go_on()?;
        let form = QuadraticForm::of_feature(&sfa, &pca, feature)?;
        found.push(unit(&form, sfa.slowness[feature], &stage, &gratings)?);
        if feature < GALLERY {
            let picture = |form: &QuadraticForm| -> Result<Vec<i16>, ExperimentError> {
                let best = form.largest_at(stage.radius)?;
                let seen = &basis * Mat::from_fn(components, 1, |i, _| best[i]);
                let largest = seen.norm_max();
                Ok((0..seen.nrows()).map(|i| (seen[(i, 0)] / largest / STEP).round() as i16).collect())
            };
            stimuli.push([picture(&form)?, picture(&form.negative())?]);
        }
    }
    Ok(Outcome { units: found, variance: pca.variances.iter().sum::<f64>() / pca.total_variance, stimuli })
}

fn run(bench: &Bench<'_>) -> Result<Results, ExperimentError> {
    let amounts = bench.scope.pick(AMOUNTS);
    bench.plan(KEPT.len() * bench.scope.seeds.len());
    let (images, data) = photographs(&Packages::of(bench))?;
    let mut found: [Vec<Outcome>; 2] = Default::default();
    for &seed in bench.scope.seeds.iter() {
        for ((name, kept), found) in KEPT.into_iter().zip(&mut found) {
            let settings = Settings { amounts, data: data.clone(), seed, moving: [MOVE, TURN, ZOOM, kept] };
            found
                .push(bench.result(&format!("{name}, seed {seed}"), &settings, || compute(&images, &settings, bench))?);
        }
    }
    Ok(Results {
        tables: vec![properties(&found), first_units(&found[0][0])],
        notes: vec![
            format!(
                "{} inputs of two pictures of {side} × {side} pixels from {} photographs, in sequences of at most {SEQUENCE}; speeds have standard deviations of \
                 {MOVE} pixels along each axis, {TURN} rad and {ZOOM} of the logarithm of the scale, and keep {} of themselves from frame to frame, or all. {} principal \
                 components have {:.1} % of the variance; quadratic SFA of them, the slowest {} features.",
                amounts.inputs,
                images.len(),
                KEPT[0].1,
                amounts.components,
                100.0 * found[0][0].variance,
                amounts.units,
                side = amounts.window
            ),
            format!(
                "Responses are to drifting gratings as long as a mean input, less that to nothing: {ORIENTATIONS} orientations, {CYCLES:?} cycles in the window, eight \
                 speeds, in the whole window or the middle half of its length, width or both. A feature and its negative are one unit, with the sign of the best stimulus. Harmonics: of the response over the grating's \
                 phase, as shares of its mean. Inhibited: below the response to nothing at another orientation; at the ends or sides, a grating that is shorter or \
                 narrower does better by {:.0} % of its response.",
                100.0 * INHIBITED
            ),
            "The thesis reports this work of others without numbers.".into(),
        ],
        plots: vec![gallery(&found[0][0], amounts.window)?],
    })
}

fn properties(found: &[Vec<Outcome>; 2]) -> Table {
    let mut table = Table::new("Units with a property");
    let phase_free = |unit: &Unit| unit.harmonics[0] < 1.0 && unit.harmonics[1] < 1.0;
    let oriented = |unit: &Unit| unit.half_width_deg < 45.0;
    type Has<'a> = &'a dyn Fn(&Unit) -> bool;
    let rows: [(&str, Has<'_>, &str); 9] = [
        ("first harmonic below the mean, as in complex cells", &|unit| unit.harmonics[0] < 1.0, "complex"),
        ("second harmonic below the mean, too: the phase hardly matters", &phase_free, ""),
        ("oriented: half width below 45°", &oriented, "oriented"),
        ("direction: half as much or less the other way", &|unit| unit.direction > 0.5, ""),
        ("inhibited at some orientation", &|unit| unit.inhibited_at_deg.is_some(), ""),
        (
            "inhibited most within 30° of the right angle",
            &|unit| unit.inhibited_at_deg.is_some_and(|at| at >= 60.0),
            "",
        ),
        ("inhibited most elsewhere", &|unit| unit.inhibited_at_deg.is_some_and(|at| at < 60.0), ""),
        ("inhibited at the ends", &|unit| unit.end > INHIBITED, ""),
        ("inhibited at the sides", &|unit| unit.side > INHIBITED, ""),
    ];
    for (name, has, of_thesis) in rows {
        let share = |outcome: &Outcome| {
            outcome.units.iter().filter(|unit| has(unit)).count() as f64 / outcome.units.len() as f64
        };
        let bands = found.each_ref().map(|found| Band::of(found.iter().map(share)));
        let most = bands.iter().all(|band| band.is_some_and(|band| band.mean > 0.5));
        let says = match of_thesis {
            "" => "not in the thesis",
            "complex" if most => "agrees: most are like complex cells",
            "complex" => "differs: most are not like complex cells",
            _ if most => "agrees: most are like Gabor filters",
            _ => "differs: most are not oriented",
        };
        let shares = [0, 1].map(|of| (format!("share, {}", KEPT[of].0), Cell::band(bands[of], 2)));
        table.push([("property".into(), Cell::text(name))].into_iter().chain(shares), says);
    }
    table
}

fn first_units(outcome: &Outcome) -> Table {
    let mut table = Table::new("The slowest units of the first seed, speeds that change");
    for (number, unit) in outcome.units.iter().take(GALLERY).enumerate() {
        let row = [
            ("unit", Cell::count(number + 1)),
            ("slowness, 1/frame²", Cell::Number(unit.slowness, 4)),
            ("orientation, °", Cell::Number(unit.orientation_deg, 0)),
            ("cycles", Cell::Number(unit.cycles, 1)),
            ("first harmonic", Cell::Number(unit.harmonics[0], 2)),
            ("second harmonic", Cell::Number(unit.harmonics[1], 2)),
            ("half width, °", Cell::Number(unit.half_width_deg, 0)),
            ("direction", Cell::Number(unit.direction, 2)),
            ("at the ends", Cell::Number(unit.end, 2)),
            ("at the sides", Cell::Number(unit.side, 2)),
        ];
        table.push(row, "no number in its text");
    }
    table
}

/// Best stimuli, both pictures, and worst ones.
fn gallery(outcome: &Outcome, side: usize) -> Result<(String, String), ExperimentError> {
    let pixels = side * side;
    let mut lines = Vec::new();
    for (start, part) in outcome.stimuli.chunks(LINE).enumerate().map(|(line, part)| (line * LINE, part)) {
        for (name, which, frame) in [("best", 0, 0), ("best, next", 0, 1), ("worst", 1, 0)] {
            let map = |(number, stimulus): (usize, &[Vec<i16>; 2])| {
                let picture = &stimulus[which][frame * pixels..(frame + 1) * pixels];
                // Maps have their first row below.
                let value = |k: usize| f64::from(picture[(side - 1 - k / side) * side + k % side]) * STEP;
                Map {
                    name: format!("{} {name}", start + number + 1),
                    values: (0..pixels).map(|k| Some(value(k))).collect(),
                }
            };
            lines.push(part.iter().enumerate().map(map).collect());
        }
    }
    let grid = (Grid { width: side, height: side }, 1.0);
    sheet("stimuli.svg", "Best and worst stimuli of the slowest units", grid, &lines)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The form of an energy detector for gratings: two Gabor filters a quarter of a turn apart, in pixels as components; widths along the bars and across.
    fn energy(side: usize, orientation: f64, cycles: f64, advance: f64, widths: (f64, f64)) -> QuadraticForm {
        let identity = Mat::identity(2 * side * side, 2 * side * side);
        let stage = Stage { basis: identity.as_ref(), side, radius: 1.0 };
        let mut filters = stage.seen(Grating { orientation, cycles, advance, part: (1.0, 1.0) });
        let (sin, cos) = orientation.sin_cos();
        for filter in &mut filters {
            for i in 0..filter.nrows() {
                let place = |k: usize| k as f64 + 0.5 - side as f64 / 2.0;
                let (x, y) = (place(i % side), -place(i / side % side));
                let (along, across) = ((cos * y - sin * x) / widths.0, (cos * x + sin * y) / widths.1);
                filter[(i, 0)] *= (-(along * along + across * across) / 2.0).exp();
            }
        }
        let [a, b] = filters;
        let h = &a * a.transpose() + &b * b.transpose();
        QuadraticForm::new(h, vec![0.0; 2 * side * side], 0.0).unwrap()
    }

    #[test]
    fn an_energy_detector_is_found_to_be_one() {
        let side = 12;
        let identity = Mat::identity(2 * side * side, 2 * side * side);
        let stage = Stage { basis: identity.as_ref(), side, radius: 5.0 };
        let gratings = all_gratings(&stage);
        let form = energy(side, PI / 3.0, 3.0, PI / 2.0, (2.5, 2.5));
        for form in [&form, &form.negative()] {
            let found = unit(form, 1.0, &stage, &gratings).unwrap();
            assert!((found.orientation_deg - 60.0).abs() < 1e-6 && found.cycles == 3.0, "{found:?}");
            assert!(found.harmonics[0] < 1e-9 && found.harmonics[1] < 0.1, "{found:?}");
            // It moves: the other way the two pictures cancel each other.
            assert!(found.direction > 0.9 && found.half_width_deg < 40.0, "{found:?}");
            assert!(found.end < 0.05 && found.side < 0.05, "{found:?}");
        }
        // With inhibition beyond the ends of its bars, short ones are better, at this orientation: it is narrow, and others evade it.
        let mut gratings = gratings;
        gratings.retain(|(grating, _)| (grating.orientation - PI / 3.0).abs() < 1e-9);
        let longer = energy(side, PI / 3.0, 3.0, PI / 2.0, (8.0, 2.5));
        let h = Mat::from_fn(form.h.nrows(), form.h.ncols(), |i, j| form.h[(i, j)] - 0.4 * longer.h[(i, j)]);
        let found = unit(&QuadraticForm::new(h, form.f.clone(), 0.0).unwrap(), 1.0, &stage, &gratings).unwrap();
        assert!(found.end > INHIBITED && found.side < 0.05, "{found:?}");
        // The closed form is what a walk over the phases gives.
        let grating = Grating { orientation: 1.0, cycles: 2.0, advance: 0.7, part: (0.6, 1.0) };
        let mut mixed = form.clone();
        mixed.f = (0..mixed.f.len()).map(|i| (i as f64).sin() / 9.0).collect();
        let [a, b] = stage.seen(grating);
        let values: Vec<f64> = (0..64)
            .map(|k| {
                let (sin, cos) = (TAU * f64::from(k) / 64.0).sin_cos();
                mixed.at(&(0..a.nrows()).map(|i| cos * a[(i, 0)] + sin * b[(i, 0)]).collect::<Vec<_>>())
            })
            .collect();
        let harmonic = |order: f64| {
            let sums = values.iter().enumerate().fold([0.0; 2], |[re, im], (k, value)| {
                let (sin, cos) = (order * TAU * k as f64 / 64.0).sin_cos();
                [re + cos * value / 32.0, im + sin * value / 32.0]
            });
            sums[0].hypot(sums[1])
        };
        let found = response(&mixed, &[a, b]);
        assert!((found.mean - harmonic(0.0) / 2.0).abs() < 1e-9);
        assert!((found.harmonics[0] - harmonic(1.0)).abs() < 1e-9 && (found.harmonics[1] - harmonic(2.0)).abs() < 1e-9);
    }

    #[test]
    fn windows_see_what_lies_below_them_and_sequences_go_on() {
        // A ramp: pictures are differences of places.
        let images = [Mat::from_fn(90, 120, |y, x| x as f64 + 1000.0 * y as f64)];
        let mut window = Window::new(&images, 4, 0.8, 1);
        let (x, links) = window.inputs(400);
        assert!(links[0].is_none() && links.iter().filter(|link| link.is_none()).count() < 100);
        for (t, link) in links.iter().enumerate().skip(1) {
            let (before, now) = (x.col(t - 1), x.col(t));
            let same = (0..16).all(|i| before[16 + i] == now[i]);
            assert_eq!(same, link.is_some(), "input {t}");
        }
        // The middle of a picture is where the window is, whatever its angle and scale.
        let at = [40.25, 30.5, 0.7, 0.2];
        let mut picture = [0.0; 16];
        window.picture(at, &mut picture);
        let mean = picture.iter().sum::<f64>() / 16.0;
        assert!((mean - (40.25 + 30_500.0)).abs() < 1e-6, "{mean}");
        let again = Window::new(&images, 4, 0.8, 1).inputs(400).0;
        assert!((0..400).all(|t| again[(0, t)] == x[(0, t)]));
    }
}
