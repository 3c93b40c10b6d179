//! `digits`: handwritten digits by slow features of pairs of the same digit (thesis §4.2.2; Berkes 2005).
//!
//! Berkes reached an error of 1.5 % on MNIST with cubic SFA of 35 principal components and a Gaussian classifier. The same is done
//! here on the same split, and on a small set beside it, with monomials of lower degree, kernel SFA, and classifiers without SFA.

use faer::{Mat, MatRef};
use serde::{Deserialize, Serialize};

use super::data::{Labelled, Packages, mnist, small_digits};
use super::pipeline::Widths;
use super::plot::{Line, chart};
use super::{Band, Bench, Cell, Experiment, ExperimentError, Once, Results, Sizes, Table};
use crate::evaluate::wilson_low;
use crate::report::draw::Axis;
use crate::slow::classes::{Gaussians, Spread, class_moments};
use crate::slow::{Expansion, Keep, Pca, SlowError, SolveOptions, solve_with};

/// The experiment.
pub const EXPERIMENT: Experiment = Experiment {
    name: "digits",
    line: "handwritten digits by slow features of pairs of the same digit (thesis §4.2.2)",
    lasts: Sizes { full: "10 min", quick: "half a minute", smoke: "seconds" },
    run,
};

/// Digits, less one.
const FEATURES: usize = 9;
/// Images whose features are computed together.
const BLOCK: usize = 512;
/// Regulariser, as a share of the mean square of the derivatives.
const LAMBDA: f64 = 1e-6;
/// What is added to the variances of features, which have variance 1 on all images.
const FLOOR: f64 = 1e-4;
/// Images of which the kernel width is found, and the share of them that become support vectors.
const WIDTH: (usize, f64) = (3000, 0.5);

/// What becomes of an image before it is classified.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "snake_case")]
enum Method {
    /// Its principal components, borders that are planes.
    Discriminant,
    /// Its principal components.
    Components,
    /// Slow features of these and their products up to a degree.
    Sfa(usize),
    /// Slow features over so many support vectors.
    Kernel(usize),
}

impl Method {
    fn name(self) -> String {
        match self {
            Method::Discriminant => "linear discriminant analysis".into(),
            Method::Components => "Gaussian classifier, no SFA".into(),
            Method::Sfa(1) => "linear SFA".into(),
            Method::Sfa(2) => "quadratic SFA".into(),
            Method::Sfa(_) => "cubic SFA".into(),
            Method::Kernel(_) => "kernel SFA".into(),
        }
    }
}

/// A set, what is done with it, and principal components of an image.
#[derive(Debug, Clone, Copy)]
struct Row {
    set: Set,
    method: Method,
    components: usize,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
enum Set {
    /// scikit-learn's: of every ten images in turn one is for the test, ten times.
    Small {
        /// Of these ten times.
        times: usize,
    },
    /// MNIST, with its own split.
    Mnist,
}

impl Set {
    fn name(self) -> &'static str {
        if self == Set::Mnist { "MNIST, 28 × 28" } else { "scikit-learn's, 8 × 8" }
    }
}

#[derive(Serialize)]
struct Settings {
    set: Set,
    method: Method,
    components: usize,
    data: Vec<String>,
    lambda: f64,
    floor: f64,
}

/// What came of a row.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Outcome {
    /// Monomials, or support vectors; 0 without SFA.
    pub coordinates: usize,
    /// Images to learn from that were taken for another digit, and how many there were; all splits together.
    pub training: (usize, usize),
    /// The same of the test.
    pub test: (usize, usize),
}

/// Images to learn from, and those for the test.
type Split = [Labelled; 2];

/// A map from images to features, and the number of its coordinates.
type Features<'a> = (Box<dyn Fn(MatRef<'_, f64>) -> Result<Mat<f64>, ExperimentError> + 'a>, usize);

/// Slow features of coordinates of images.
fn slow_features<'a>(
    train: &Labelled,
    coordinates: impl Fn(MatRef<'_, f64>) -> Result<Mat<f64>, SlowError> + 'a,
    bench: &Bench<'_>,
) -> Result<Features<'a>, ExperimentError> {
    let par = bench.scope.par;
    let of = |part: std::ops::Range<usize>| coordinates(train.images.subcols(part.start, part.len()));
    let moments = class_moments(&train.classes, of, par)?;
    bench.go_on()?;
    let rate = moments.rate();
    let lambda = LAMBDA * rate.diagonal().column_vector().sum() / moments.size() as f64;
    drop(rate);
    let features = FEATURES.min(moments.size());
    let solved = solve_with(&moments, features, lambda, None, &SolveOptions { par, ..SolveOptions::default() })?;
    let size = moments.size();
    let offset = solved.weights.transpose() * &solved.mean;
    let map = move |images: MatRef<'_, f64>| {
        let y = solved.weights.transpose() * coordinates(images)?;
        Ok(Mat::from_fn(y.nrows(), y.ncols(), |i, t| y[(i, t)] - offset[(i, 0)]))
    };
    Ok((Box::new(map), size))
}

fn features<'a>(row: Row, train: &'a Labelled, bench: &'a Bench<'_>) -> Result<Features<'a>, ExperimentError> {
    if let Method::Kernel(vectors) = row.method {
        let single = |x: MatRef<'_, f64>| Mat::from_fn(x.nrows(), x.ncols(), |i, t| x[(i, t)] as f32);
        let (few, share) = WIDTH;
        let few = few.min(train.images.ncols());
        // All of the vectors are sought where the images are few.
        let whole = 4 * vectors > train.images.ncols();
        let looked = if whole { train.images.ncols() } else { few };
        let target = if whole { vectors } else { (share * few as f64) as usize };
        let images = single(train.images.as_ref().subcols(0, looked));
        let mut dictionary = Widths::default().select(images.as_ref(), target, bench)?;
        for start in (looked..train.images.ncols()).step_by(BLOCK) {
            bench.go_on()?;
            let left = vectors.saturating_sub(dictionary.len());
            if left == 0 {
                break;
            }
            let part = single(train.images.as_ref().subcols(start, BLOCK.min(train.images.ncols() - start)));
            let mut taken = 0;
            dictionary.grow(part.as_ref(), |_, residual| {
                let take = residual > super::pipeline::NU && taken < left;
                taken += usize::from(take);
                take
            })?;
        }
        let coordinates = move |x: MatRef<'_, f64>| Ok(dictionary.coordinates(single(x).as_ref())?);
        return slow_features(train, coordinates, bench);
    }
    let pca = Pca::fit(train.images.as_ref(), Keep::Components(row.components), true)?;
    bench.go_on()?;
    let degree = match row.method {
        Method::Sfa(degree) => degree,
        _ => return Ok((Box::new(move |x| Ok(pca.apply(x)?)), 0)),
    };
    let coordinates = move |x: MatRef<'_, f64>| {
        let components = pca.apply(x)?;
        match degree {
            1 => Ok(components),
            2 => Expansion::Quadratic.apply(components.as_ref()),
            _ => Expansion::Cubic.apply(components.as_ref()),
        }
    };
    slow_features(train, coordinates, bench)
}

fn compute(row: Row, splits: &[Split], bench: &Bench<'_>) -> Result<Outcome, ExperimentError> {
    let mut outcome = Outcome { coordinates: 0, training: (0, 0), test: (0, 0) };
    for [train, test] in splits {
        bench.go_on()?;
        let (features, coordinates) = features(row, train, bench)?;
        outcome.coordinates = outcome.coordinates.max(coordinates);
        let all = |of: &Labelled| -> Result<Mat<f64>, ExperimentError> {
            let mut y = Mat::new();
            for start in (0..of.images.ncols()).step_by(BLOCK) {
                bench.go_on()?;
                let part = features(of.images.subcols(start, BLOCK.min(of.images.ncols() - start)))?;
                y.resize_with(part.nrows(), start + part.ncols(), |i, t| part[(i, t - start)]);
            }
            Ok(y)
        };
        let spread = if row.method == Method::Discriminant { Spread::Shared } else { Spread::Own };
        let (y, of_test) = (all(train)?, all(test)?);
        let gaussians = Gaussians::fit(y.as_ref(), &train.classes, spread, FLOOR)?;
        for (y, of, sum) in [(y, train, &mut outcome.training), (of_test, test, &mut outcome.test)] {
            let found = gaussians.classify(y.as_ref())?;
            sum.0 += found.iter().zip(&of.classes).filter(|(found, class)| found != class).count();
            sum.1 += of.classes.len();
        }
    }
    Ok(outcome)
}

/// The splits of scikit-learn's digits: each image is in one test.
fn splits(all: &Labelled, times: usize) -> Vec<Split> {
    let split = |turn: usize| {
        let part = |is_test: bool| {
            let members: Vec<usize> = (0..all.classes.len()).filter(|t| (t % 10 == turn) == is_test).collect();
            Labelled {
                images: Mat::from_fn(all.images.nrows(), members.len(), |i, j| all.images[(i, members[j])]),
                classes: members.iter().map(|&t| all.classes[t]).collect(),
                sha256: all.sha256.clone(),
            }
        };
        [part(false), part(true)]
    };
    (0..times).map(split).collect()
}

fn rows(bench: &Bench<'_>) -> Vec<Row> {
    let row = |set: Set, method: Method, components: usize| Row { set, method, components };
    let small = Set::Small { times: bench.scope.pick(Sizes { full: 10, quick: 10, smoke: 1 }) };
    let plain = [Method::Discriminant, Method::Components];
    let mut rows: Vec<Row> = plain.map(|method| row(small, method, 30)).into();
    let degrees: Sizes<[&[usize]; 3]> = Sizes {
        full: [&[5, 10, 15, 20, 30, 40], &[5, 10, 15, 20, 30, 40], &[5, 10, 15, 20]],
        quick: [&[5, 10, 15, 20, 30, 40], &[5, 10, 15, 20, 30, 40], &[5, 10, 15, 20]],
        smoke: [&[5, 10], &[5], &[5]],
    };
    for (degree, components) in (1..).zip(bench.scope.pick(degrees)) {
        rows.extend(components.iter().map(|&components| row(small, Method::Sfa(degree), components)));
    }
    let vectors = bench.scope.vectors_or(bench.scope.pick(Sizes { full: 800, quick: 800, smoke: 100 }));
    rows.push(row(small, Method::Kernel(vectors), 0));
    let large = bench.scope.pick(Sizes { full: &[(1, 100), (2, 35), (2, 100), (3, 35)][..], quick: &[], smoke: &[] });
    if !large.is_empty() {
        rows.extend(plain.map(|method| row(Set::Mnist, method, 100)));
        rows.extend(large.iter().map(|&(degree, components)| row(Set::Mnist, Method::Sfa(degree), components)));
        rows.push(row(Set::Mnist, Method::Kernel(bench.scope.vectors_or(4000)), 0));
    }
    rows
}

fn run(bench: &Bench<'_>) -> Result<Results, ExperimentError> {
    let rows = rows(bench);
    bench.plan(rows.len());
    let packages = Packages::of(bench);
    let small = small_digits(&packages)?;
    let large: Once<Split> = Once::default();
    let mut found = Vec::new();
    for row in rows {
        let Row { set, method, components } = row;
        let of_mnist = match set {
            Set::Mnist => Some(large.get(|| mnist(&packages))?),
            Set::Small { .. } => None,
        };
        let data =
            of_mnist.map_or(vec![small.sha256.clone()], |split| split.iter().map(|s| s.sha256.clone()).collect());
        let settings = Settings { set, method, components, data, lambda: LAMBDA, floor: FLOOR };
        let label = match method {
            Method::Kernel(vectors) => format!("{}: {}, {vectors} support vectors", set.name(), method.name()),
            _ => format!("{}: {}, {components} components", set.name(), method.name()),
        };
        let compute = || match (set, of_mnist) {
            (Set::Small { times }, _) => compute(row, &splits(&small, times), bench),
            (Set::Mnist, split) => compute(row, split.map_or(&[], std::slice::from_ref), bench),
        };
        found.push((row, bench.result(&label, &settings, compute)?));
    }
    Ok(Results {
        tables: vec![table(&found)],
        notes: vec![
            format!(
                "Nine slow features over all pairs of images of the same digit, and a Gaussian distribution over them for each digit. \
                 λ is {LAMBDA:e} of the derivatives' mean square; {FLOOR:e} is added to the variances of the features. Components: principal \
                 components of the images to learn from, scaled to variance 1."
            ),
            "scikit-learn's 1797 digits: image i is in the test of split i mod 10, and errors are counted over all splits; writers are in \
             both parts. MNIST: 60 000 images to learn from and 10 000 for the test, as in the thesis. At most: the upper end of the \
             95 % Wilson interval. No seed plays a part."
                .into(),
        ],
        plots: vec![plot(&found)?],
    })
}

fn percent((wrong, all): (usize, usize)) -> f64 {
    100.0 * wrong as f64 / all.max(1) as f64
}

/// What the thesis says of MNIST, error in %.
fn in_the_thesis(row: Row) -> Option<f64> {
    match (row.set, row.method) {
        (Set::Mnist, Method::Sfa(3)) => Some(1.5),
        (Set::Mnist, Method::Discriminant) => Some(12.0),
        _ => None,
    }
}

fn table(found: &[(Row, Outcome)]) -> Table {
    let mut table = Table::new("Digits that are taken for others");
    for (row, outcome) in found {
        let (wrong, all) = outcome.test;
        let at_most = 100.0 * (1.0 - wilson_low(all - wrong, all));
        let thesis = in_the_thesis(*row);
        let says = match thesis {
            None => "not in the thesis".into(),
            Some(thesis) if percent(outcome.test) <= thesis => "agrees: no more errors".into(),
            Some(thesis) if at_most - percent(outcome.test) >= percent(outcome.test) - thesis => {
                "agrees: within the interval".into()
            }
            Some(thesis) => format!("differs: {:.2} times its errors", percent(outcome.test) / thesis),
        };
        let counted = |count: usize| if count == 0 { Cell::Empty } else { Cell::count(count) };
        let cells = [
            ("set", Cell::text(row.set.name())),
            ("method", Cell::text(row.method.name())),
            ("components", counted(row.components)),
            ("coordinates", counted(outcome.coordinates)),
            ("training error, %", Cell::Number(percent(outcome.training), 2)),
            ("test error, %", Cell::Number(percent(outcome.test), 2)),
            ("at most, %", Cell::Number(at_most, 2)),
            ("thesis: %", Cell::maybe(thesis, 2)),
        ];
        table.push(cells, says);
    }
    table
}

/// Errors on the small set over the number of components.
fn plot(found: &[(Row, Outcome)]) -> Result<(String, String), ExperimentError> {
    let mut lines = Vec::new();
    for degree in 1..=3 {
        let of: Vec<_> =
            found.iter().filter(|(row, _)| row.set != Set::Mnist && row.method == Method::Sfa(degree)).collect();
        let line = |name: String, errors: fn(&Outcome) -> (usize, usize)| {
            let points = of.iter().map(|(row, outcome)| (row.components as f64, Band::of([percent(errors(outcome))])));
            Line::new(name, degree - 1, points)
        };
        let name = Method::Sfa(degree).name();
        lines.push(line(format!("{name}, test"), |outcome| outcome.test));
        lines.push(line(format!("{name}, training"), |outcome| outcome.training).dashed());
    }
    let axes = (&Axis::new("principal components"), &Axis::new("errors, %"));
    Ok(chart("errors.svg", "Errors on scikit-learn's digits", axes, &lines)?)
}
