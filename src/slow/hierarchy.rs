//! Hierarchical slow feature analysis: small pipelines on overlapping receptive fields, layer upon layer.

use faer::{Mat, MatRef};

use super::error::SlowError;
use super::expansion::{Expansion, Pipeline, Step};
use super::links::Link;

/// The shape of an image: width, height and values per pixel.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Shape {
    /// Columns of pixels.
    pub width: usize,
    /// Rows of pixels.
    pub height: usize,
    /// Values per pixel.
    pub channels: usize,
}

impl Shape {
    /// Number of values of an image; at the largest number there is, if it is beyond that.
    pub fn values(&self) -> usize {
        self.width.saturating_mul(self.height).saturating_mul(self.channels)
    }
}

/// Overlapping fields of an image, one for each node of a layer: width and height of a field, and the distance from one to the next.
#[derive(Debug, Clone, Copy)]
pub(super) struct Tiling {
    pub field: (usize, usize),
    pub stride: (usize, usize),
}

impl Tiling {
    /// The image that nodes make of one of shape `input`, with `channels` outputs per node.
    pub fn output(self, input: Shape, channels: usize) -> Result<Shape, SlowError> {
        let count = |axis, size: usize, field: usize, stride: usize| {
            let fits = field > 0 && stride > 0 && field <= size && (size - field).is_multiple_of(stride);
            if fits { Ok((size - field) / stride + 1) } else { Err(SlowError::Tiling { axis, size, field, stride }) }
        };
        Ok(Shape {
            width: count("width", input.width, self.field.0, self.stride.0)?,
            height: count("height", input.height, self.field.1, self.stride.1)?,
            channels,
        })
    }

    /// Places of the values of the field at column `i`, row `j` of the layer, in an image of shape `input`.
    pub fn places(self, input: Shape, i: usize, j: usize) -> Vec<usize> {
        let (left, top) = (i * self.stride.0, j * self.stride.1);
        let rows = top..top + self.field.1;
        rows.flat_map(|y| {
            let start = (y * input.width + left) * input.channels;
            start..start + self.field.0 * input.channels
        })
        .collect()
    }
}

/// What a layer shall be.
#[derive(Debug, Clone, PartialEq)]
pub struct Layer {
    /// Width and height of a field.
    pub field: (usize, usize),
    /// Distance from one field to the next, to the right and down; less than the field: they overlap.
    pub stride: (usize, usize),
    /// What each node does.
    pub steps: Vec<Step>,
    /// Whether one node serves all fields.
    pub shared: bool,
}

impl Layer {
    /// A layer whose nodes are those of Franzius 2007: linear SFA to `reduced` values, monomials up to degree 2, SFA to
    /// `features` outputs, clipped at ±4.
    pub fn quadratic(
        field: (usize, usize),
        stride: (usize, usize),
        reduced: usize,
        features: usize,
        shared: bool,
    ) -> Layer {
        let steps = vec![
            Step::Sfa { features: reduced, lambda: 0.0 },
            Step::Expand(Expansion::Quadratic),
            Step::Sfa { features, lambda: 0.0 },
            Step::Clip(4.0),
        ];
        Layer { field, stride, steps, shared }
    }

    fn tiling(&self) -> Tiling {
        Tiling { field: self.field, stride: self.stride }
    }
}

/// A node of a trained layer.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Node<'a> {
    /// Its column in the layer.
    pub column: usize,
    /// Its row in the layer.
    pub row: usize,
    /// What it does.
    pub pipeline: &'a Pipeline,
}

/// A layer that was trained.
#[derive(Debug, Clone, PartialEq)]
pub struct TrainedLayer {
    layer: Layer,
    input: Shape,
    output: Shape,
    /// One per node, row by row, or one for all.
    pipelines: Vec<Pipeline>,
}

impl TrainedLayer {
    /// Train the nodes of a layer on frames of shape `input`.
    fn train(
        layer: &Layer,
        input: Shape,
        x: MatRef<'_, f64>,
        links: &[Option<Link>],
    ) -> Result<TrainedLayer, SlowError> {
        let grid = layer.tiling().output(input, 0)?;
        let nodes = (0..grid.height).flat_map(|j| (0..grid.width).map(move |i| (i, j)));
        let pipelines = if layer.shared {
            let (n, size) = (x.ncols(), layer.field.0 * layer.field.1 * input.channels);
            let mut fields = Mat::zeros(size, n * grid.width * grid.height);
            let mut all_links = Vec::with_capacity(fields.ncols());
            for (place, (i, j)) in nodes.enumerate() {
                fields.as_mut().subcols_mut(place * n, n).copy_from(rows_of(x, &layer.tiling().places(input, i, j)));
                // What a place shows first does not follow what the place before it showed last.
                all_links.extend(links.iter().enumerate().map(|(t, link)| link.filter(|_| t > 0)));
            }
            let fitted = Pipeline::fit(&layer.steps, fields.as_ref(), &all_links);
            vec![fitted.map_err(|cause| cause.at("the shared node"))?]
        } else {
            let fit = |(i, j): (usize, usize)| {
                Pipeline::fit(&layer.steps, rows_of(x, &layer.tiling().places(input, i, j)).as_ref(), links)
                    .map_err(|cause| cause.at(format!("node ({i}, {j})")))
            };
            nodes.map(fit).collect::<Result<_, _>>()?
        };
        let output = Shape { channels: pipelines[0].outputs(), ..grid };
        Ok(TrainedLayer { layer: layer.clone(), input, output, pipelines })
    }

    /// Shape of the images that it takes.
    pub fn input(&self) -> Shape {
        self.input
    }

    /// Shape of the images that it gives: a pixel per node, a channel per output.
    pub fn output(&self) -> Shape {
        self.output
    }

    /// The nodes, row by row.
    pub fn nodes(&self) -> impl Iterator<Item = Node<'_>> {
        let width = self.output.width;
        (0..width * self.output.height).map(move |place| Node {
            column: place % width,
            row: place / width,
            pipeline: &self.pipelines[place.min(self.pipelines.len() - 1)],
        })
    }

    fn apply(&self, x: MatRef<'_, f64>) -> Result<Mat<f64>, SlowError> {
        let channels = self.output.channels;
        let mut y = Mat::zeros(self.output.values(), x.ncols());
        for (place, node) in self.nodes().enumerate() {
            let field = rows_of(x, &self.layer.tiling().places(self.input, node.column, node.row));
            let said = node.pipeline.apply(field.as_ref())?;
            y.as_mut().subrows_mut(place * channels, channels).copy_from(said);
        }
        Ok(y)
    }
}

/// Some rows of a matrix.
fn rows_of(x: MatRef<'_, f64>, rows: &[usize]) -> Mat<f64> {
    Mat::from_fn(rows.len(), x.ncols(), |i, t| x[(rows[i], t)])
}

/// A trained hierarchy.
///
/// An image has too many values for one expansion. A layer cuts it into fields, each field feeds a node of its own (or the
/// same node everywhere), and what the nodes say is the image of the next layer, with the node's outputs as channels:
///
/// ```text
///   frame 10 × 6, 3 channels          layer 1: field 4 × 4, stride 3 × 2       layer 2: field 3 × 2
///   ┌───────────────────┐
///   │┌─────┐            │             node(0,0) node(1,0) node(2,0)            ┌──────────┐
///   ││field│··· + 3 ··▶ │   ──▶       node(0,1) node(1,1) node(2,1)    ──▶     │ one node │ ──▶ outputs
///   │└─────┘            │             = an image 3 × 2 with                    └──────────┘
///   │   ⋮ + 2           │               as many channels as outputs
///   └───────────────────┘
///      inside of a node:  field ─▶ linear SFA ─▶ monomials ─▶ SFA ─▶ clip at ±4
/// ```
///
/// Layout: a frame is a column; the value of channel `c` at column `i`, row `j` of the image stands at
/// `(j·width + i)·channels + c`. Fields, and the nodes of a layer, are laid out in the same way.
///
/// Layers are trained one after the other, each on the outputs of those below it. With shared weights one node is trained on
/// the fields of all places, one place after the other, and used at each of them. What is at the same place in all frames
/// then is not known to it, and its outputs have variance 1 over all places together, not at each.
///
/// ```
/// use adagio::slow::{Layer, Link, Network, Shape};
/// use faer::Mat;
///
/// # fn main() -> Result<(), adagio::slow::SlowError> {
/// // A grating drifts slowly over 6 × 2 pixels.
/// let shape = Shape { width: 6, height: 2, channels: 1 };
/// let x = Mat::from_fn(12, 500, |place, t| (0.9 * (place % 6) as f64 + 0.1 * t as f64).sin() * (1 + place / 6) as f64);
/// let layers = [Layer::quadratic((4, 2), (2, 2), 2, 3, true), Layer::quadratic((2, 1), (1, 1), 2, 2, false)];
/// let network = Network::train(shape, &layers, x.as_ref(), &Link::regular(500, 1.0)?)?;
/// assert_eq!(network.layers()[0].output(), Shape { width: 2, height: 1, channels: 3 });
/// assert_eq!(network.apply(x.as_ref())?.nrows(), 2);
/// # Ok(())
/// # }
/// ```
///
/// # Reference
/// Thesis §4.2.3 (`sec:sfa_place_cells`); Franzius, Sprekeler & Wiskott 2007.
#[derive(Debug, Clone, PartialEq)]
pub struct Network {
    shape: Shape,
    layers: Vec<TrainedLayer>,
}

impl Network {
    /// Train a hierarchy, layer by layer.
    ///
    /// # Shapes
    /// `x: (width · height · channels) × n`, in the layout of [`Network`]; `links: n`.
    ///
    /// # Errors
    /// Frames of another shape or of no values, no layer, fields that do not tile their input, and what a node refuses; with the numbers of
    /// layer and step (from 1) and the column and row of the node (from 0).
    pub fn train(
        shape: Shape,
        layers: &[Layer],
        x: MatRef<'_, f64>,
        links: &[Option<Link>],
    ) -> Result<Network, SlowError> {
        SlowError::unless_fits("a frame's number of values", x.nrows(), shape.values())?;
        SlowError::unless_fits("the list of links", links.len(), x.ncols())?;
        if shape.values() == 0 {
            return Err(SlowError::Empty("the shape of a frame is"));
        }
        if layers.is_empty() {
            return Err(SlowError::Empty("the list of layers is"));
        }
        let mut trained: Vec<TrainedLayer> = Vec::with_capacity(layers.len());
        let (mut input, mut y) = (shape, x.to_owned());
        for (number, layer) in layers.iter().enumerate() {
            let (next, said) = TrainedLayer::train(layer, input, y.as_ref(), links)
                .and_then(|next| next.apply(y.as_ref()).map(|said| (next, said)))
                .map_err(|cause| cause.at(format!("layer {}", number + 1)))?;
            input = next.output;
            y = said;
            trained.push(next);
        }
        Ok(Network { shape, layers: trained })
    }

    /// Shape of the frames that it takes.
    pub fn shape(&self) -> Shape {
        self.shape
    }

    /// The layers, from the frame upwards.
    pub fn layers(&self) -> &[TrainedLayer] {
        &self.layers
    }

    /// What the top layer says to frames: one column each.
    ///
    /// # Errors
    /// Frames of another shape than in training.
    pub fn apply(&self, x: MatRef<'_, f64>) -> Result<Mat<f64>, SlowError> {
        SlowError::unless_fits("a frame's number of values", x.nrows(), self.shape.values())?;
        let mut y = x.to_owned();
        for layer in &self.layers {
            y = layer.apply(y.as_ref())?;
        }
        Ok(y)
    }
}
