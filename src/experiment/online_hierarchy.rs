//! `online-hierarchy`: five layers of nodes that learn while the rat runs (thesis §4.2.3, figure *Wyss06*; Wyss, König &
//! Verschure 2006), beside slow features of the whole picture.
//!
//! The rat and what it sees are those of [`place_cells`]. Each frame is seen once: one layer learns from it, and it is forgotten.

use faer::Mat;
use serde::{Deserialize, Serialize};

use super::lab::Lab;
use super::maps::{Grid, HEADINGS, Map, sheet};
use super::pipeline::slowness_of;
use super::place_cells::{self, Cells, MOTIONS, Motion, Outcome, PLACES, run_of, views};
use super::{Band, Bench, Cell, Experiment, ExperimentError, Results, Sizes, Table};
use crate::random::stream;
use crate::slow::coherence::gradient::Coherence;
use crate::slow::coherence::network::{Learning, OnlineLayer, OnlineNetwork};
use crate::slow::{Link, Shape};

/// The experiment.
pub const EXPERIMENT: Experiment = Experiment {
    name: "online-hierarchy",
    line: "five layers that learn frame by frame while the rat runs (figure Wyss06), beside place-cells",
    lasts: Sizes { full: "12 min", quick: "2 min", smoke: "seconds" },
    run,
};

/// What the rat sees.
const SHAPE: Shape = Shape { width: 36, height: 16, channels: 3 };
/// Frames that it runs, frames that a layer learns from, frames of another run on which slowness is measured.
const RUN: Sizes<(usize, usize, usize)> =
    Sizes { full: (600_000, 100_000, 5000), quick: (60_000, 10_000, 2000), smoke: (400, 60, 60) };
/// Frames that are rendered at once.
const AT_ONCE: usize = 500;
/// Fields, and how much nodes make of them.
const LAYERS: [OnlineLayer; 5] = [
    OnlineLayer { field: (6, 4), stride: (3, 2), reduced: 8, features: 6 },
    OnlineLayer { field: (3, 3), stride: (2, 2), reduced: 10, features: 8 },
    OnlineLayer { field: (3, 2), stride: (1, 1), reduced: 12, features: 8 },
    OnlineLayer { field: (2, 2), stride: (1, 1), reduced: 12, features: 8 },
    OnlineLayer { field: (2, 1), stride: (1, 1), reduced: 12, features: 8 },
];
/// Estimates reach back 2000 frames.
const LEARNING: Learning = Learning {
    objective: Coherence { decorrelation: 0.3, mean: 0.0 },
    learning_rate: 0.0002,
    decay: 0.0001,
    forgetting: 0.0005,
    memory: 2.0,
    settle: 0,
};
/// Decays of the learning rate that are compared; the first is that of [`LEARNING`].
const DECAYS: [(f64, &str); 2] = [(LEARNING.decay, "a rate that falls"), (0.0, "a constant rate")];
/// Units of each layer that are drawn.
const EXAMPLES: usize = 2;

#[derive(Serialize)]
struct Settings {
    scenario: String,
    motion: Motion,
    run: (usize, usize, usize),
    places: Grid,
    decay: f64,
    /// Layers and how they learn, as text: they are constants.
    learns: String,
}

/// What one layer has learned.
#[derive(Debug, Clone, Serialize, Deserialize)]
struct Learned {
    /// Nodes.
    nodes: usize,
    /// Mean slowness of its units at unit variance, per frame².
    slowness: f64,
    /// All of its units, maps of some.
    cells: Cells,
}

fn compute(lab: &Lab, settings: &Settings, bench: &Bench<'_>) -> Result<Vec<Learned>, ExperimentError> {
    let (frames, settle, held_out) = settings.run;
    let seed = lab.scenario.seed;
    let learning = Learning { settle, decay: settings.decay, ..LEARNING };
    let mut network = OnlineNetwork::new(SHAPE, &LAYERS, learning, &mut stream(seed, "online hierarchy"))?;
    let link = Some(Link { dt: 1.0, weight: 1.0 });
    let path = run_of(&lab.world, settings.motion, frames, seed);
    for (number, part) in path.chunks(AT_ONCE).enumerate() {
        let seen = views(lab, part, bench)?;
        for t in 0..seen.ncols() {
            let frame: Vec<f64> = seen.col(t).iter().map(|&value| f64::from(value)).collect();
            network.update(&frame, link.filter(|_| network.frames() > 0))?;
        }
        if (number + 1).is_multiple_of(100) {
            bench.say(&format!("{} of {frames} frames", network.frames()));
        }
    }
    let wide = |seen: &Mat<f32>| Mat::from_fn(seen.nrows(), seen.ncols(), |i, t| f64::from(seen[(i, t)]));
    // Another run, which nothing was learned from.
    let other = run_of(&lab.world, settings.motion, held_out, seed + 1);
    let other = network.apply(wide(&views(lab, &other, bench)?).as_ref())?;
    let links = Link::regular(held_out, 1.0)?;
    let maps = network.apply(wide(&views(lab, &settings.places.poses(lab), bench)?).as_ref())?;
    let of = |((shape, other), maps): ((Shape, &Mat<f64>), &Mat<f64>)| {
        let mut cells = Cells::of(maps, settings.places.places());
        // Of the node in the middle.
        let middle = shape.width * (shape.height / 2) + shape.width / 2;
        let kept = middle * shape.channels..(middle + 1) * shape.channels;
        cells.maps = cells.maps[kept.clone()].to_vec();
        cells.tuning = cells.tuning[kept].to_vec();
        Learned { nodes: shape.width * shape.height, slowness: slowness(other, &links), cells }
    };
    Ok(network.shapes().into_iter().zip(&other).zip(&maps).map(of).collect())
}

/// Mean slowness of the rows that vary, each at unit variance.
fn slowness(features: &Mat<f64>, links: &[Option<Link>]) -> f64 {
    let found = slowness_of(features.as_ref(), links).into_iter().filter(|slowness| slowness.is_finite());
    let found: Vec<f64> = found.collect();
    found.iter().sum::<f64>() / found.len().max(1) as f64
}

fn run(bench: &Bench<'_>) -> Result<Results, ExperimentError> {
    let scope = bench.scope;
    let (run, places) = (scope.pick(RUN), scope.pick(PLACES));
    bench.plan(scope.seeds.len() * MOTIONS.len() * DECAYS.len());
    let mut found: [[Vec<Vec<Learned>>; MOTIONS.len()]; DECAYS.len()] = Default::default();
    for &seed in scope.seeds.iter() {
        let lab = place_cells::lab(seed)?;
        for (number, (name, motion)) in MOTIONS.into_iter().enumerate() {
            for (found, (decay, rate)) in found.iter_mut().zip(DECAYS) {
                let learns = format!("{LAYERS:?} {LEARNING:?}");
                let settings = Settings { scenario: lab.scenario.sha256(), motion, run, places, decay, learns };
                let label = format!("{name}, {rate}, seed {seed}");
                found[number].push(bench.result(&label, &settings, || compute(&lab, &settings, bench))?);
            }
        }
    }
    let batch = place_cells::outcomes(bench)?;
    Ok(Results {
        tables: vec![table(&found[0], &batch), constant(&found[1])],
        notes: vec![
            format!(
                "{} frames, each seen once; the rat and its view are those of place-cells. Layers learn one after the other, {} frames each, the last one from the rest; \
                 step t along the gradient has the length {}/(1 + {}·t). Nodes of the first layer have {} outputs, those above {}; slowness is that of another run of {} frames, without memory. Maps: {HEADINGS} \
                 headings at {} × {} places.",
                run.0,
                run.1,
                LEARNING.learning_rate,
                LEARNING.decay,
                LAYERS[0].features,
                LAYERS[1].features,
                run.2,
                places.width,
                places.height
            ),
            "Field: share of the places where the mean over headings is above half of its peak; sector: the same of headings. The thesis shows two \
             examples of each layer, without numbers: those of the last one do not depend on the heading and look like big place cells, after \
             6 million frames."
                .into(),
        ],
        plots: plots(&found[0][0], &place_cells::lab(scope.seeds[0])?, places)?,
    })
}

fn table(found: &[Vec<Vec<Learned>>; MOTIONS.len()], batch: &[Vec<Outcome>; 2]) -> Table {
    let mut table = Table::new("What layers know, and slow features of the whole picture");
    for (number, (name, _)) in MOTIONS.into_iter().enumerate() {
        let mut push = |what: String, nodes: Cell, slowness: Cell, of: Vec<&Cells>, says: &str| {
            let band = |value: fn(&Cells) -> f64| Cell::band(Band::of(of.iter().map(|cells| value(cells))), 2);
            let row = [
                ("motion", Cell::text(name)),
                ("what", Cell::text(what)),
                ("nodes", nodes),
                ("slowness, 1/frame²", slowness),
                ("variance by place", band(|cells| cells.by_place)),
                ("variance by heading", band(|cells| cells.by_heading)),
                ("field", band(|cells| cells.field)),
                ("sector", band(|cells| cells.sector)),
            ];
            table.push(row, says);
        };
        for layer in 0..LAYERS.len() {
            let of: Vec<&Learned> = found[number].iter().map(|layers| &layers[layer]).collect();
            let mean = |value: fn(&Cells) -> f64| of.iter().map(|learned| value(&learned.cells)).sum::<f64>();
            let explains = |value: fn(&Cells) -> f64| 2.0 * mean(value) > of.len() as f64;
            let says = match (layer + 1 == LAYERS.len(), explains(|c| c.by_place), explains(|c| c.by_heading)) {
                (false, ..) => "no number in its text",
                (true, true, _) if number == 0 => "agrees: the place explains most of it",
                (true, _, _) if number == 0 => "differs: the place does not explain most of it",
                (true, _, true) => "not in it: the heading explains most of it",
                (true, ..) => "not in it: the heading does not explain most of it",
            };
            let nodes = of.first().map_or(Cell::text(""), |learned| Cell::count(learned.nodes));
            let slowness = Cell::band(Band::of(of.iter().map(|learned| learned.slowness)), 4);
            push(format!("layer {}", layer + 1), nodes, slowness, of.iter().map(|l| &l.cells).collect(), says);
        }
        let cells = |of: fn(&Outcome) -> &Cells| batch[number].iter().map(of).collect::<Vec<_>>();
        let kept = |outcome: &Outcome| outcome.features.maps.len();
        let slow = |outcome: &Outcome| outcome.slowness.iter().take(kept(outcome)).sum::<f64>() / kept(outcome) as f64;
        let slow = Cell::band(Band::of(batch[number].iter().map(slow)), 4);
        let (features, components) = (cells(|outcome| &outcome.features), cells(|outcome| &outcome.cells));
        push("kernel slow features".into(), Cell::text(""), slow, features, "see place-cells");
        push("their components".into(), Cell::text(""), Cell::text(""), components, "see place-cells");
    }
    table
}

/// Layers whose steps along the gradient do not get shorter.
fn constant(found: &[Vec<Vec<Learned>>; MOTIONS.len()]) -> Table {
    let mut table = Table::new("The layers, where the learning rate does not fall");
    for ((name, _), seeds) in MOTIONS.into_iter().zip(found) {
        for layer in 0..LAYERS.len() {
            let band = |of: fn(&Learned) -> f64, digits| {
                Cell::band(Band::of(seeds.iter().map(|layers| of(&layers[layer]))), digits)
            };
            let row = [
                ("motion", Cell::text(name)),
                ("layer", Cell::count(layer + 1)),
                ("slowness, 1/frame²", band(|learned| learned.slowness, 4)),
                ("variance by place", band(|learned| learned.cells.by_place, 2)),
                ("variance by heading", band(|learned| learned.cells.by_heading, 2)),
            ];
            table.push(row, "not in the thesis");
        }
    }
    table
}

/// Units of all layers over the room, where the rat moves slowly.
fn plots(found: &[Vec<Learned>], lab: &Lab, grid: Grid) -> Result<Vec<(String, String)>, ExperimentError> {
    let Some(layers) = found.first() else { return Ok(Vec::new()) };
    let examples = layers.iter().enumerate().map(|(layer, learned)| {
        let all = learned.cells.lines(&format!("layer {}, unit", layer + 1)).into_iter().flatten();
        all.take(if layer + 1 == LAYERS.len() { usize::MAX } else { EXAMPLES }).collect::<Vec<Map>>()
    });
    let title = format!("{}: what layers know of the place; means over headings", MOTIONS[0].0);
    Ok(vec![sheet("places.svg", &title, (grid, lab.aspect()), &examples.collect::<Vec<_>>())?])
}
