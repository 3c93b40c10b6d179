//! `slowness`: how slow features get with the number of support vectors (thesis §5.2.1, figures *SvC* and *slowness*).
//!
//! The thesis's training set is a video of 35 128 frames at about one a second. Kernel SFA with ALD (ν = 0.1, the width varied)
//! is compared with linear SFA on the pixels and with the optimal responses of theory at the true poses, for images of
//! 32 × 16 and 64 × 32 pixels, on their own frames, and the smaller ones on another walk, too.

use std::collections::BTreeMap;

use faer::{Mat, MatRef};
use serde::{Deserialize, Serialize};

use super::lab::{Data, FRAMES, Lab, Walked, points};
use super::pipeline::{LAMBDA, NU, Widths, slow_features, slowness_of};
use super::plot::{Line, chart};
use super::{Band, Bench, Cell, Experiment, ExperimentError, Once, Results, Sizes, Table};
use crate::report::draw::Axis;
use crate::robot::Pose;
use crate::slow::LinearStream;

/// The experiment.
pub const EXPERIMENT: Experiment = Experiment {
    name: "slowness",
    line: "slowness by number of support vectors, linear SFA, two image sizes (figures SvC and slowness)",
    lasts: Sizes { full: "three quarters of an hour", quick: "3 min", smoke: "seconds" },
    run,
};

/// Frames of the video.
const WALK: Sizes<usize> = Sizes { full: FRAMES, quick: 8000, smoke: 400 };
/// Numbers of support vectors that are aimed at.
const VECTORS: Sizes<&[usize]> =
    Sizes { full: &[100, 200, 400, 700, 1000, 2000, 4000, 8000], quick: &[100, 200, 400, 700, 1000], smoke: &[30, 60] };
/// Conditions are compared up to this number, and a third of the frames.
const MOST_COMPARED: usize = 1000;
/// Features that are solved for.
const FEATURES: Sizes<usize> = Sizes { full: 100, quick: 60, smoke: 12 };
/// Sizes of the images.
const IMAGES: [(usize, usize); 2] = [(32, 16), (64, 32)];
/// Numbers of features over which the mean is taken: the thesis plots it every 10 features.
const MEANS: [usize; 4] = [1, 10, 30, 60];
/// What may decide where kernel SFA overtakes linear SFA: the camera's noise and drift, patterns, and the number of frames. Settings that
/// are not the lab's, and what the number of frames is divided by.
const CONDITIONS: [(&str, &[&str], usize); 6] = [
    ("as everywhere here", &[], 1),
    ("without noise and drift", &["camera.pixel_noise=0", "camera.exposure_drift=0"], 1),
    ("noise of 16 grey levels", &["camera.pixel_noise=16"], 1),
    ("other patterns", &["world.texture_seed=1"], 1),
    ("a quarter of the frames", &[], 4),
    ("an eighth of the frames", &[], 8),
];
/// The other walk's seed is larger by this.
const ELSEWHERE: u64 = 1000;
/// Frames that are handled together.
const AT_ONCE: usize = 1024;
/// The number of support vectors at which kernel SFA is as slow as linear SFA in the thesis (§5.2.1).
const LIKE_LINEAR: usize = 700;

/// What slowness is measured of.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "snake_case")]
enum Method {
    /// Kernel SFA with about so many support vectors.
    Kernel(usize),
    Linear,
    /// Theory's responses at the true poses.
    Optimal,
}

#[derive(Serialize)]
struct Settings {
    data: Data,
    image: (usize, usize),
    method: Method,
    features: usize,
    weighted_as_in_the_thesis: bool,
    nu: f64,
    lambda: f64,
    /// Seed of another walk on which features are measured, too.
    #[serde(skip_serializing_if = "Option::is_none")]
    elsewhere: Option<u64>,
}

/// What came of a setting.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Outcome {
    /// Support vectors, if any.
    pub support_vectors: Option<usize>,
    /// Kernel width, grey levels.
    pub sigma: Option<f64>,
    /// Slowness of each feature on the training frames, 1/s², ascending.
    pub slowness: Vec<f64>,
    /// Slowness of the same features on the frames of another walk, where that is looked at.
    #[serde(default)]
    pub elsewhere: Option<Vec<f64>>,
}

impl Outcome {
    fn vectors(&self) -> Option<f64> {
        self.support_vectors.map(|vectors| vectors as f64)
    }

    /// Mean slowness of the first features.
    fn mean(&self, of: usize) -> Option<f64> {
        mean(&self.slowness, of)
    }
}

/// Mean of the first numbers.
fn mean(slowness: &[f64], of: usize) -> Option<f64> {
    (slowness.len() >= of).then(|| slowness[..of].iter().sum::<f64>() / of as f64)
}

/// A video and what was found about its kernel widths.
struct Video<'a> {
    lab: &'a Lab,
    walked: &'a Walked,
    frames: Once<Mat<f32>>,
    widths: std::cell::RefCell<Widths>,
    /// Another walk in the same room, weighted as this one.
    elsewhere: Option<(Lab, Walked)>,
}

impl Video<'_> {
    /// Slowness of features on the other walk, if there is one, by parts of its video.
    fn elsewhere(
        &self,
        weight: f64,
        bench: &Bench<'_>,
        features: impl Fn(MatRef<'_, f32>) -> Result<Mat<f64>, ExperimentError>,
    ) -> Result<Option<Vec<f64>>, ExperimentError> {
        let Some((lab, walked)) = &self.elsewhere else { return Ok(None) };
        let frames = lab.video(&walked.poses, bench)?;
        let mut signals: Option<Mat<f64>> = None;
        for start in (0..frames.ncols()).step_by(AT_ONCE) {
            bench.go_on()?;
            let count = AT_ONCE.min(frames.ncols() - start);
            let part = features(frames.as_ref().subcols(start, count))?;
            let signals = signals.get_or_insert_with(|| Mat::zeros(part.nrows(), frames.ncols()));
            signals.as_mut().subcols_mut(start, count).copy_from(&part);
        }
        Ok(signals.map(|signals| slowness_of(signals.as_ref(), &lab.links(walked, weight))))
    }

    fn outcome(&self, settings: &Settings, bench: &Bench<'_>) -> Result<Outcome, ExperimentError> {
        let weight = self.lab.thesis_weight(&self.walked.steps());
        let links = self.lab.links(self.walked, weight);
        if settings.method == Method::Optimal {
            let theory = self.lab.optimal_responses(&self.walked.steps(), weight, settings.features)?;
            let on = |poses: &[Pose], links: &[_]| -> Result<Vec<f64>, ExperimentError> {
                let mut slowness = slowness_of(theory.evaluate(points(poses).as_ref())?.as_ref(), links);
                slowness.sort_by(f64::total_cmp);
                Ok(slowness)
            };
            let slowness = on(&self.walked.poses, &links)?;
            let other = self.elsewhere.as_ref();
            let elsewhere = other.map(|(lab, walked)| on(&walked.poses, &lab.links(walked, weight))).transpose()?;
            return Ok(Outcome { support_vectors: None, sigma: None, slowness, elsewhere });
        }
        let frames = self.frames.get(|| self.lab.video(&self.walked.poses, bench))?.as_ref();
        let Method::Kernel(target) = settings.method else {
            let mut stream = LinearStream::new();
            let wide = |x: MatRef<'_, f32>| Mat::from_fn(x.nrows(), x.ncols(), |i, j| f64::from(x[(i, j)]));
            for start in (0..frames.ncols()).step_by(AT_ONCE) {
                bench.go_on()?;
                let count = AT_ONCE.min(frames.ncols() - start);
                stream.push(wide(frames.subcols(start, count)).as_ref(), &links[start..start + count])?;
            }
            let sfa = stream.solve(settings.features, settings.lambda)?;
            let elsewhere = self.elsewhere(weight, bench, |x| Ok(sfa.apply(wide(x).as_ref())?))?;
            return Ok(Outcome { support_vectors: None, sigma: None, slowness: sfa.slowness, elsewhere });
        };
        let dictionary = self.widths.borrow_mut().select(frames, target, bench)?;
        let (features, model) = slow_features(&dictionary, frames, &links, settings.features, bench)?;
        let elsewhere = self.elsewhere(weight, bench, |x| {
            let phi = model.apply(x, bench.scope.par)?;
            // Without the constant one.
            Ok(phi.subrows(1, phi.nrows() - 1).to_owned())
        })?;
        Ok(Outcome {
            support_vectors: Some(dictionary.len()),
            sigma: model.kernel.sigma(),
            slowness: features.slowness,
            elsewhere,
        })
    }
}

/// By image and method, one outcome for each seed.
type Found = BTreeMap<((usize, usize), Method), Vec<Outcome>>;

fn run(bench: &Bench<'_>) -> Result<Results, ExperimentError> {
    let scope = bench.scope;
    let (frames, features) = (scope.pick(WALK), scope.pick(FEATURES));
    let vectors = scope.vectors_up_to(scope.pick(VECTORS));
    // Condition, image and methods; the first condition has both images.
    let mut parts = vec![(0, IMAGES[0], vec![Method::Optimal, Method::Linear]), (0, IMAGES[1], Vec::new())];
    parts.extend((1..CONDITIONS.len()).map(|condition| (condition, IMAGES[0], vec![Method::Linear])));
    for (condition, _, methods) in &mut parts {
        let most = if *condition == 0 { usize::MAX } else { MOST_COMPARED.min(frames / CONDITIONS[*condition].2 / 3) };
        methods.extend(vectors.iter().filter(|&&target| target <= most).map(|&target| Method::Kernel(target)));
    }
    bench.plan(scope.seeds.len() * parts.iter().map(|part| part.2.len()).sum::<usize>());
    let mut found = [(); CONDITIONS.len()].map(|()| Found::new());
    for &seed in scope.seeds.iter() {
        for (condition, image, methods) in &parts {
            let (what, sets, fewer) = CONDITIONS[*condition];
            let actions = frames / fewer - 1;
            let size = [format!("vision.width={}", image.0), format!("vision.height={}", image.1)];
            let sets: Vec<&str> = size.iter().map(String::as_str).chain(sets.iter().copied()).collect();
            let lab = Lab::new(seed, &sets)?;
            let walked = lab.walk(actions);
            let elsewhere = (*condition == 0 && *image == IMAGES[0]).then_some(seed + ELSEWHERE);
            let other = elsewhere.map(|seed| Lab::new(seed, &sets)).transpose()?.map(|lab| {
                let walked = lab.walk(actions);
                (lab, walked)
            });
            let (frames, widths) = (Once::default(), Default::default());
            let video = Video { lab: &lab, walked: &walked, frames, widths, elsewhere: other };
            for &method in methods {
                let data = Data::new(&lab, actions);
                let (image, weighted_as_in_the_thesis) = (*image, true);
                let (nu, lambda) = (NU, LAMBDA);
                let settings =
                    Settings { data, image, method, features, weighted_as_in_the_thesis, nu, lambda, elsewhere };
                let label = format!("{}, {} × {}, {what}, seed {seed}", name(method), image.0, image.1);
                let outcome = bench.result(&label, &settings, || video.outcome(&settings, bench))?;
                found[*condition].entry((image, method)).or_default().push(outcome);
            }
        }
    }
    let [shown, others @ ..] = found.map(|found| Findings { found });
    Ok(Results {
        tables: vec![shown.table(), shown.claims(), shown.elsewhere(), conditions(&shown, &others)],
        notes: vec![
            format!(
                "{frames} frames, one for each action of a random walk; slowness in 1/s² on these frames, mean over the first \
                 features; moves weigh so much more than turns that φ200 and φ001 are equally slow, as they were in the thesis. \
                 ALD with ν = {NU}; the kernel width was chosen for the number of support vectors."
            ),
            "Optimal responses: theory's functions of the true pose, measured on the same walk as the features. They are optimal for a walk that \
             visits all poses alike and whose speed does not depend on the pose; on this walk others can be slower. Linear SFA \
             has 32 × 16 pixels only, as in the thesis."
                .into(),
            "Of these curves the thesis prints no values.".into(),
        ],
        plots: shown.plots()?,
    })
}

fn name(method: Method) -> String {
    match method {
        Method::Kernel(target) => format!("kernel SFA, about {target} vectors"),
        Method::Linear => "linear SFA".into(),
        Method::Optimal => "optimal responses".into(),
    }
}

struct Findings {
    found: Found,
}

impl Findings {
    fn band(&self, image: (usize, usize), method: Method, of: impl Fn(&Outcome) -> Option<f64>) -> Option<Band> {
        let outcomes = self.found.get(&(image, method))?;
        Band::of(outcomes.iter().filter_map(of))
    }

    fn mean(&self, image: (usize, usize), method: Method, of: usize) -> Option<f64> {
        Some(self.band(image, method, |outcome| outcome.mean(of))?.mean)
    }

    /// Features over whose mean the claims are judged: the most that every method has of [`MEANS`].
    fn judged(&self) -> usize {
        let fewest = self.found.values().flatten().map(|outcome| outcome.slowness.len()).min().unwrap_or(1);
        MEANS.into_iter().filter(|&of| of <= fewest.min(30)).max().unwrap_or(1)
    }

    /// The same features on another walk: how much of their slowness is that of the frames that they were learned from.
    fn elsewhere(&self) -> Table {
        let of = self.judged();
        let mut table = Table::new(format!("The first {of} features on their own frames and on those of another walk"));
        let on = |method, of: &dyn Fn(&Outcome) -> Option<f64>| self.band(IMAGES[0], method, of);
        let other = |outcome: &Outcome| mean(outcome.elsewhere.as_ref()?, of);
        let optimum = on(Method::Optimal, &other).map(|band| band.mean);
        for &(_, method) in self.found.keys().filter(|(image, _)| *image == IMAGES[0]) {
            let found = on(method, &other);
            let row = [
                ("method", Cell::text(name(method))),
                ("support vectors", Cell::band(on(method, &Outcome::vectors), 0)),
                ("own frames, 1/s²", Cell::band(on(method, &|outcome| outcome.mean(of)), 4)),
                ("another walk, 1/s²", Cell::band(found, 4)),
                ("over its optimal responses", Cell::maybe(found.zip(optimum).map(|(band, of)| band.mean / of), 2)),
            ];
            table.push(row, "not in the thesis");
        }
        table
    }

    fn table(&self) -> Table {
        let mut table = Table::new("Slowness, 1/s²");
        for &(image, method) in self.found.keys() {
            let text = match method {
                Method::Kernel(_) => "kernel SFA",
                Method::Linear => "linear SFA",
                Method::Optimal => "optimal responses",
            };
            let mut row = vec![
                ("image".into(), Cell::text(format!("{} × {}", image.0, image.1))),
                ("method".into(), Cell::text(text)),
                ("support vectors".into(), Cell::band(self.band(image, method, Outcome::vectors), 0)),
                ("sigma".into(), Cell::band(self.band(image, method, |outcome| outcome.sigma), 0)),
            ];
            row.extend(MEANS.map(|of| {
                let name = if of == 1 { "first".to_owned() } else { format!("mean of {of}") };
                (name, Cell::band(self.band(image, method, |outcome| outcome.mean(of)), 4))
            }));
            table.push(row, self.says(image, method));
        }
        table
    }

    /// What the thesis says of a row.
    fn says(&self, image: (usize, usize), method: Method) -> String {
        let of = self.judged();
        let optimum = self.mean(IMAGES[0], Method::Optimal, of);
        let here = self.mean(image, method, of);
        let (Some(optimum), Some(here)) = (optimum, here) else { return "no number in its text".into() };
        match method {
            Method::Optimal => "the bound of its figure".into(),
            _ if here < optimum => {
                format!("differs: {:.0} % below the optimal responses", 100.0 * (1.0 - here / optimum))
            }
            _ => format!("agrees: above the optimum ({:.2} times)", here / optimum),
        }
    }

    /// Kernel SFA's support vectors and mean slowness at one image size, by their number.
    fn bands(&self, image: (usize, usize), of: usize) -> impl Iterator<Item = (f64, Option<Band>)> {
        let of_image = self.found.keys().filter(move |(i, method)| *i == image && matches!(method, Method::Kernel(_)));
        of_image.filter_map(move |&(image, method)| {
            let vectors = self.band(image, method, Outcome::vectors)?.mean;
            Some((vectors, self.band(image, method, |outcome| outcome.mean(of))))
        })
    }

    /// The means of these.
    fn curve(&self, image: (usize, usize), of: usize) -> Vec<(f64, f64)> {
        self.bands(image, of).filter_map(|(vectors, band)| Some((vectors, band?.mean))).collect()
    }

    /// The thesis's sentences about its figures, and what becomes of them here.
    fn claims(&self) -> Table {
        let of = self.judged();
        let mut table =
            Table::new(format!("What the thesis says of its figures, by the mean of the first {of} features"));
        let row = |claim: &str, thesis, here| {
            [("thesis: claim", Cell::text(claim)), ("thesis: value", thesis), ("here", here)]
        };
        let small = self.curve(IMAGES[0], of);
        let linear = self.mean(IMAGES[0], Method::Linear, of);
        let crossing = linear.and_then(|linear| crossing(&small, linear));
        let verdict = match crossing {
            Some(vectors) if (vectors / LIKE_LINEAR as f64).ln().abs() < 2f64.ln() => "agrees within a factor of 2",
            Some(_) => "differs by more than a factor of 2",
            None if linear.is_some_and(|linear| small.iter().all(|point| point.1 < linear)) => {
                "differs: below linear SFA from the fewest on"
            }
            None => "differs: not reached",
        };
        let claim = "as slow as linear SFA with so many support vectors";
        table.push(row(claim, Cell::count(LIKE_LINEAR), Cell::maybe(crossing, 0)), verdict);
        let falls = small.windows(2).filter(|pair| pair[1].1 < pair[0].1).count();
        let steps = small.len().saturating_sub(1);
        let here = Cell::text(format!("{falls} of {steps} steps"));
        table.push(
            row("slowness falls with each larger set", Cell::text("always"), here),
            if falls == steps { "agrees" } else { "differs" },
        );
        let optimum = self.mean(IMAGES[0], Method::Optimal, of);
        let left = small.last().zip(optimum).map(|(last, optimum)| last.1 / optimum);
        table.push(
            row(
                "slowness of the largest set, over that of the optimal responses",
                Cell::text("towards 1"),
                Cell::maybe(left, 2),
            ),
            match left {
                Some(left) if left < 0.98 => "differs: below the optimal responses of this walk",
                Some(left) if left < 1.25 => "agrees: within a quarter",
                Some(_) => "agrees in the direction; not within a quarter",
                None => "cannot be told",
            },
        );
        let large = self.curve(IMAGES[1], of);
        let worse =
            large.iter().filter_map(|&(vectors, slowness)| Some(slowness > at(&small, vectors)?)).collect::<Vec<_>>();
        let count = worse.iter().filter(|worse| **worse).count();
        let here = Cell::text(format!("{count} of {}", worse.len()));
        table.push(
            row("64 × 32 pixels are faster (worse) at equal numbers", Cell::text("always"), here),
            match (count, worse.len()) {
                (_, 0) => "cannot be told",
                (count, all) if count == all => "agrees",
                (0, _) => "differs: they are slower (better)",
                _ => "differs in part",
            },
        );
        table
    }

    fn plots(&self) -> Result<Vec<(String, String)>, ExperimentError> {
        let mut curves = Vec::new();
        let mut all = Vec::new();
        let curve = self.curve(IMAGES[0], 1);
        let ends = (curve.first().map_or(100.0, |point| point.0), curve.last().map_or(8000.0, |point| point.0));
        // Colours of both images, of linear SFA and of the optimum.
        for (of, colours) in [(10, [0, 3, 1, 6]), (30, [2, 4, 5, 7])] {
            for (colour, image) in colours.into_iter().zip(IMAGES) {
                let name = format!("{of} features, {} × {}", image.0, image.1);
                let line = Line::new(name, colour, self.bands(image, of));
                curves.extend((!line.points.is_empty()).then_some(line));
            }
            let levels = [(Method::Linear, "linear SFA", colours[2]), (Method::Optimal, "optimal", colours[3])];
            for (method, what, colour) in levels {
                let level = self.mean(IMAGES[0], method, of);
                curves.extend(level.map(|level| Line::level(format!("{of} features, {what}"), colour, ends, level)));
            }
        }
        for (number, (&(image, method), outcomes)) in
            self.found.iter().filter(|((image, _), _)| *image == IMAGES[0]).enumerate()
        {
            let most = outcomes.iter().map(|outcome| outcome.slowness.len()).min().unwrap_or(0);
            let points =
                (0..most).map(|i| (i as f64 + 1.0, Band::of(outcomes.iter().map(|outcome| outcome.slowness[i]))));
            let vectors = self.band(image, method, Outcome::vectors);
            let name = vectors.map_or(name(method), |vectors| format!("{:.0} vectors", vectors.mean));
            let line = Line::new(name, number, points);
            all.push(if matches!(method, Method::Kernel(_)) { line } else { line.dashed() });
        }
        let vectors = Axis::log("support vectors");
        let slowness = Axis::log("slowness Δ, 1/s²");
        let features = (&Axis::new("feature"), &slowness);
        Ok(vec![
            chart("vectors.svg", "Mean slowness by number of support vectors", (&vectors, &slowness), &curves)?,
            chart("features.svg", "Slowness of each feature, 32 × 16 pixels", features, &all)?,
        ])
    }
}

/// Where kernel SFA overtakes linear SFA under each condition.
fn conditions(first: &Findings, others: &[Findings]) -> Table {
    let of = first.judged();
    let mut table = Table::new(format!(
        "Support vectors with which kernel SFA is as slow as linear SFA, by the mean of the first {of} features"
    ));
    for (found, (what, ..)) in std::iter::once(first).chain(others).zip(CONDITIONS) {
        let mut curve = found.curve(IMAGES[0], of);
        curve.retain(|point| point.0 < 1.1 * MOST_COMPARED as f64);
        let linear = found.mean(IMAGES[0], Method::Linear, of);
        let crossing = linear.and_then(|linear| crossing(&curve, linear));
        let slowness = |point: Option<&(f64, f64)>| Cell::maybe(point.map(|point| point.1), 4);
        let verdict = crossing
            .map_or("none of these".into(), |vectors| format!("{:.2} of the thesis's", vectors / LIKE_LINEAR as f64));
        let row = [
            ("condition", Cell::text(what)),
            ("linear SFA, 1/s²", Cell::maybe(linear, 4)),
            ("kernel SFA with the fewest, 1/s²", slowness(curve.first())),
            ("with the most, 1/s²", slowness(curve.last())),
            ("vectors for linear SFA's", Cell::maybe(crossing, 0)),
        ];
        table.push(row, verdict);
    }
    table
}

/// The number of support vectors at which a falling curve comes down to a level, between the points on both sides, on
/// logarithmic scales.
fn crossing(curve: &[(f64, f64)], level: f64) -> Option<f64> {
    let pair = curve.windows(2).find(|pair| pair[0].1 >= level && pair[1].1 < level)?;
    let share = (pair[0].1 / level).ln() / (pair[0].1 / pair[1].1).ln();
    Some((pair[0].0.ln() + share * (pair[1].0 / pair[0].0).ln()).exp())
}

/// A curve's value at a number of support vectors, on logarithmic scales; none outside of it.
fn at(curve: &[(f64, f64)], vectors: f64) -> Option<f64> {
    let pair = curve.windows(2).find(|pair| pair[0].0 <= vectors && vectors <= pair[1].0)?;
    let share = (vectors / pair[0].0).ln() / (pair[1].0 / pair[0].0).ln();
    Some((pair[0].1.ln() + share * (pair[1].1 / pair[0].1).ln()).exp())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn curves_are_read_between_their_points() {
        let curve = [(100.0, 4.0), (400.0, 1.0)];
        assert!((crossing(&curve, 2.0).unwrap() - 200.0).abs() < 1e-9);
        assert!((at(&curve, 200.0).unwrap() - 2.0).abs() < 1e-9);
        assert_eq!((crossing(&curve, 0.5), at(&curve, 500.0)), (None, None));
    }
}
