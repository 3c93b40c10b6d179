//! A hierarchy that learns while a stream goes by: the objective of [`gradient`](super::gradient) in small nodes, layer upon layer.
//!
//! A layer cuts its image into overlapping fields, and each field feeds a node of its own; what the nodes say is the image of the next
//! layer (as in [`Network`](crate::slow::Network), which learns from a series in memory). A node is
//!
//! ```text
//!   field ─▶ incremental principal ─▶ monomials up to ─▶ OnlineCoherence: ─▶ leaky mean ─▶ clip at ±4
//!            components, white         degree 2           k features         over τ frames
//! ```
//!
//! One layer learns at a time, for `settle` frames, the lowest first, and stays as it is then; the top one goes on. The objective has many
//! maxima, between which features turn for ever, and a layer that learned meanwhile would run after them.
//!
//! Where this departs from Wyss et al.: their nodes have another nonlinearity, and no white components, of which all monomials vary about as
//! much as each other. And each node counts time in units in which its features change by their deviation: derivatives of slow sources are
//! so small otherwise that all of the objective is correlation. And the learning rate
//! may fall: with a constant one weights tremble about the maximum, and the layers above learn from that noise.
//!
//! # Reference
//! Wyss, König & Verschure, PLoS Biol. 4 (2006); thesis §4.2.3.

use faer::{Mat, MatRef};

use super::gradient::{Coherence, OnlineCoherence, OnlineOptions};
use super::incremental::{Whitening, check_squares};
use super::{CoherenceError, check_features};
use crate::slow::error::SlowError;
use crate::slow::hierarchy::Tiling;
use crate::slow::links::{Link, check_link};
use crate::slow::{Expansion, Shape};

/// White components, and what nodes say, are clipped at this many standard deviations.
const CLIP: f64 = 4.0;
/// Components whose variance is below this share of the largest are rounding or noise.
const SMALLEST_VARIANCE: f64 = 1e-2;
/// Principal components look back this many times as far as the objective's estimates: what is white must not wander while features are found.
const REACH: f64 = 10.0;

/// What a layer shall be.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct OnlineLayer {
    /// Width and height of a field.
    pub field: (usize, usize),
    /// Distance from one field to the next, to the right and down; less than the field: they overlap.
    pub stride: (usize, usize),
    /// Principal components of a field, of which monomials are made.
    pub reduced: usize,
    /// Outputs of a node.
    pub features: usize,
}

/// How all nodes learn and remember.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Learning {
    /// The objective.
    pub objective: Coherence,
    /// Length of a layer's first step along the gradient of one frame, > 0.
    pub learning_rate: f64,
    /// How its rate falls, ≥ 0, as in [`OnlineOptions::decay`]. Where a layer trembles, those above it have to learn from noise.
    pub decay: f64,
    /// Share by which every frame replaces the running estimates of the objective, in (0, 1).
    pub forgetting: f64,
    /// Frames over which a node's output is averaged, τ ≥ 1: 1 is no memory.
    pub memory: f64,
    /// Frames that a layer learns from before it is the turn of the next one; 0 counts as 1.
    pub settle: usize,
}

/// A node: one for each field.
#[derive(Debug, Clone)]
struct OnlineNode {
    places: Vec<usize>,
    reduced: Whitening,
    coherence: OnlineCoherence,
    forgetting: f64,
    /// Features of the frame before.
    before: Option<Vec<f64>>,
    /// Mean square of the derivative of a feature, and of how many derivatives.
    rate: (f64, usize),
    /// Leaky means of the features, `k`; none after a gap.
    said: Option<Vec<f64>>,
}

#[derive(Debug, Clone)]
struct Nodes {
    output: Shape,
    /// Factors of each monomial.
    monomials: Vec<Vec<usize>>,
    /// Row by row.
    nodes: Vec<OnlineNode>,
}

/// A hierarchy of nodes that learn from a stream.
///
/// ```
/// use adagio::slow::coherence::gradient::Coherence;
/// use adagio::slow::coherence::network::{Learning, OnlineLayer, OnlineNetwork};
/// use adagio::slow::{Link, Shape};
///
/// // A wave drifts to and fro over 6 × 1 pixels; two nodes see four of them each, a third one sees these two.
/// let objective = Coherence { decorrelation: 1.0, mean: 0.0 };
/// let learning =
///     Learning { objective, learning_rate: 0.002, decay: 0.0, forgetting: 0.002, memory: 1.0, settle: 500 };
/// let layer = OnlineLayer { field: (4, 1), stride: (2, 1), reduced: 2, features: 2 };
/// let layers = [layer, OnlineLayer { field: (2, 1), stride: (1, 1), ..layer }];
/// let shape = Shape { width: 6, height: 1, channels: 1 };
/// let mut network = OnlineNetwork::new(shape, &layers, learning, &mut adagio::random::stream(1, "doc")).unwrap();
/// for t in 0..2000 {
///     let phase = (t as f64 / 40.0).sin();
///     let frame: Vec<f64> = (0..6).map(|place| (place as f64 + phase).sin()).collect();
///     network.update(&frame, Some(Link { dt: 1.0, weight: 1.0 })).unwrap();
/// }
/// assert_eq!(network.shapes().last(), Some(&Shape { width: 1, height: 1, channels: 2 }));
/// ```
#[derive(Debug, Clone)]
pub struct OnlineNetwork {
    shape: Shape,
    learning: Learning,
    layers: Vec<Nodes>,
    frames: usize,
}

impl OnlineNetwork {
    /// A hierarchy that has seen nothing, over frames of a shape.
    ///
    /// # Errors
    /// Frames of no values, no layer, fields that do not tile their input (with the number of the layer, from 1), and what a node's parts
    /// refuse.
    pub fn new(
        shape: Shape,
        layers: &[OnlineLayer],
        learning: Learning,
        rng: &mut impl rand::Rng,
    ) -> Result<OnlineNetwork, CoherenceError> {
        if shape.values() == 0 {
            return Err(SlowError::Empty("the shape of a frame is").into());
        }
        if layers.is_empty() {
            return Err(SlowError::Empty("the list of layers is").into());
        }
        let Learning { objective, learning_rate, decay, forgetting, memory, .. } = learning;
        CoherenceError::unless(memory >= 1.0 && memory.is_finite(), "the memory", memory, "≥ 1 and finite")?;
        let mut input = shape;
        let mut all = Vec::with_capacity(layers.len());
        for (number, &layer) in layers.iter().enumerate() {
            let place = |cause: SlowError| cause.at(format!("layer {}", number + 1));
            let OnlineLayer { field, stride, reduced, features } = layer;
            let tiling = Tiling { field, stride };
            let output = tiling.output(input, features).map_err(place)?;
            let inputs = field.0 * field.1 * input.channels;
            check_features(reduced, inputs)?;
            let monomials = Expansion::Quadratic.monomials(reduced).map_err(place)?;
            let learning = OnlineOptions { objective, features, learning_rate, decay, forgetting };
            let mut node = |place: usize| {
                Ok(OnlineNode {
                    places: tiling.places(input, place % output.width, place / output.width),
                    reduced: Whitening::new(inputs, reduced, SMALLEST_VARIANCE, REACH / forgetting),
                    coherence: OnlineCoherence::new(monomials.len(), learning, rng)?,
                    forgetting,
                    before: None,
                    rate: (0.0, 0),
                    said: None,
                })
            };
            let nodes = (0..output.width * output.height).map(&mut node).collect::<Result<_, CoherenceError>>()?;
            all.push(Nodes { output, monomials, nodes });
            input = output;
        }
        Ok(OnlineNetwork { shape, learning, layers: all, frames: 0 })
    }

    /// Shape of what each layer says, the lowest first: a pixel per node, a channel per feature.
    pub fn shapes(&self) -> Vec<Shape> {
        self.layers.iter().map(|layer| layer.output).collect()
    }

    /// Number of frames seen.
    pub fn frames(&self) -> usize {
        self.frames
    }

    /// Take one frame in the layout of [`Network`](crate::slow::Network); without a link it follows no other, and memories are empty. What the
    /// top layer says: 0 until it is its turn.
    ///
    /// # Errors
    /// Another number of values; values that are not finite or too large to be squared: nothing is changed then. Weights that run away: the
    /// network is lost.
    pub fn update(&mut self, frame: &[f64], link: Option<Link>) -> Result<Vec<f64>, CoherenceError> {
        CoherenceError::unless_fits("the number of inputs", frame.len(), self.shape.values())?;
        check_squares(self.frames, frame)?;
        check_link(self.frames, link)?;
        self.frames += 1;
        let mut image = frame.to_vec();
        let turn = ((self.frames - 1) / self.learning.settle.max(1)).min(self.layers.len() - 1);
        for (number, layer) in self.layers.iter_mut().enumerate() {
            let mut next = vec![0.0; layer.output.values()];
            if number <= turn {
                let monomials = &layer.monomials;
                let k = layer.output.channels;
                for (node, said) in layer.nodes.iter_mut().zip(next.chunks_exact_mut(k)) {
                    said.copy_from_slice(&node.update(
                        &image,
                        link,
                        monomials,
                        self.learning.memory,
                        number == turn,
                    )?);
                }
            }
            image = next;
        }
        Ok(image)
    }

    /// What each layer says to frames that stand still, the lowest first: `d × n` gives `values × n` for each.
    ///
    /// # Errors
    /// Frames of another shape.
    pub fn apply(&self, x: MatRef<'_, f64>) -> Result<Vec<Mat<f64>>, CoherenceError> {
        CoherenceError::unless_fits("the number of inputs", x.nrows(), self.shape.values())?;
        let mut said: Vec<Mat<f64>> = Vec::with_capacity(self.layers.len());
        for layer in &self.layers {
            let below = said.last().map_or(x, Mat::as_ref);
            let mut y = Mat::zeros(layer.output.values(), x.ncols());
            for t in 0..x.ncols() {
                let image: Vec<f64> = below.col(t).iter().copied().collect();
                let features = layer
                    .nodes
                    .iter()
                    .map(|node| node.features(&expand(&node.white(&at(&image, &node.places)), &layer.monomials)));
                for (row, feature) in features.collect::<Result<Vec<_>, _>>()?.into_iter().flatten().enumerate() {
                    y[(row, t)] = feature.clamp(-CLIP, CLIP);
                }
            }
            said.push(y);
        }
        Ok(said)
    }
}

impl OnlineNode {
    fn update(
        &mut self,
        image: &[f64],
        link: Option<Link>,
        monomials: &[Vec<usize>],
        memory: f64,
        learns: bool,
    ) -> Result<Vec<f64>, CoherenceError> {
        let field = at(image, &self.places);
        if learns {
            self.reduced.update(&field);
        }
        let expanded = expand(&self.white(&field), monomials);
        if learns {
            let link = self.in_own_time(&self.features(&expanded)?, link);
            self.coherence.update(&expanded, link)?;
        }
        let features = self.features(&expanded)?;
        let said = match self.said.take().filter(|_| link.is_some()) {
            Some(before) => {
                before.iter().zip(&features).map(|(before, now)| before + (now - before) / memory).collect()
            }
            None => features,
        };
        let clipped = said.iter().map(|value: &f64| value.clamp(-CLIP, CLIP)).collect();
        self.said = Some(said);
        Ok(clipped)
    }

    /// Time in which a feature changes by its deviation, in the mean: slowness then counts as much against correlation however slow the
    /// features are already.
    fn in_own_time(&mut self, features: &[f64], link: Option<Link>) -> Option<Link> {
        let before = self.before.replace(features.to_vec());
        let (link, before) = link.zip(before)?;
        let squares = features.iter().zip(&before).map(|(now, before)| ((now - before) / link.dt).powi(2));
        let (mean, count) = &mut self.rate;
        *count += 1;
        *mean += (squares.sum::<f64>() / features.len() as f64 - *mean) * self.forgetting.max(1.0 / *count as f64);
        Some(Link { dt: link.dt * mean.sqrt(), ..link }).filter(|link| link.dt > 0.0 && link.dt.is_finite())
    }

    fn white(&self, field: &[f64]) -> Vec<f64> {
        self.reduced.apply(field).into_iter().map(|value| value.clamp(-CLIP, CLIP)).collect()
    }

    fn features(&self, expanded: &[f64]) -> Result<Vec<f64>, CoherenceError> {
        let phi = self.coherence.map().apply(MatRef::from_column_major_slice(expanded, expanded.len(), 1))?;
        Ok(phi.col(0).iter().copied().collect())
    }
}

fn at(image: &[f64], places: &[usize]) -> Vec<f64> {
    places.iter().map(|&place| image[place]).collect()
}

fn expand(values: &[f64], monomials: &[Vec<usize>]) -> Vec<f64> {
    monomials.iter().map(|factors| factors.iter().map(|&i| values[i]).product()).collect()
}
