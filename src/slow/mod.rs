//! Slow features: functions of an observation that vary as slowly as possible while observations stream by.
//!
//! What a sensor says changes quickly; what it is about often changes slowly. A camera's pixels change with every turn of
//! the head, the room does not. Slow feature analysis (SFA) looks for functions `φ_i` of the observation `x` that
//!
//! - minimise the *slowness* `Δ_i = ⟨φ̇_i²⟩`, the mean square of their derivative in time,
//! - have mean 0 and variance 1, else a constant would be the slowest of all,
//! - and are uncorrelated, else all would be the same one.
//!
//! They come slowest first. Their signs are not determined, nor what of a span of equally slow features is which.
//!
//! # From a signal to features
//! Frames follow each other by [`Link`]s, which give the time between them, or say that there is a gap. All methods below make
//! a vector of coordinates `v` out of each frame (the channels themselves, monomials, kernel values) and end at one
//! eigenvalue problem over sums of these:
//!
//! `min wᵀ(Ḋ + λI)w` subject to `wᵀCw = 1`, features `φ(x) = Wᵀ(v(x) − v̄)`.
//!
//! [`Moments`] hold the sums, [`solve()`](solve()) makes [`SlowFeatures`] of them.
//!
//! | symbol | size | meaning |
//! |---|---|---|
//! | `v`, `v̄` | m | coordinates of a frame, their mean |
//! | `C` | m × m | covariance of `v`, divided by n |
//! | `v̇` | m | `(v_t − v_{t−1})/Δt`, where frame t has a link |
//! | `Ḋ` | m × m | weighted mean of `v̇v̇ᵀ` over all links, not centred |
//! | `λ` | | regulariser, ≥ 0: punishes large weights, needed where there are many coordinates for the frames |
//! | `W` | m × k | weights, one feature a column |
//! | `Δ` | k | slowness `wᵀḊw`, in 1/s² when times are in seconds |
//!
//! # Which tool for what
//!
//! | you have | use |
//! |---|---|
//! | a signal in memory | [`LinearSfa`] |
//! | a signal that comes in blocks | [`LinearStream`] |
//! | a signal whose slow source is a polynomial of it | [`Pipeline`] of [`Expansion`] and [`LinearSfa`] |
//! | a signal whose slow source is any smooth function of it | [`KernelSfa`], for up to some thousand frames |
//! | the same, as a stream without end | [`SlowStream`], [`solve()`](solve()), [`SlowModel`] |
//! | images, or too many channels for one expansion | [`Network`], a hierarchy of small pipelines |
//! | the same as a stream that is not kept | [`coherence::network`]: layers that learn frame by frame |
//! | a signal whose true state is known | [`theory`]: what its slow features must look like |
//! | quadratic features, and the question what they respond to | [`QuadraticForm`] |
//! | samples of classes, without any time | [`classes`] |
//! | another objective of the same kind, or no room for matrices | [`coherence`] |
//! | slow features that shall say *where*, not *how far along* | [`ica`]: independent components, place cells |
//!
//! # Example
//! A slow sine is hidden in two fast channels, `x₁ = sin t + cos² 11t`, `x₂ = cos 11t`. It is `x₁ − x₂²`:
//! ```
//! use adagio::slow::{Expansion, Link, Pipeline, Stage, Step};
//! use faer::Mat;
//!
//! # fn main() -> Result<(), adagio::slow::SlowError> {
//! let time = |i: usize| i as f64 * std::f64::consts::TAU / 1999.0;
//! let x = Mat::from_fn(2, 2000, |row, i| {
//!     let fast = (11.0 * time(i)).cos();
//!     if row == 0 { time(i).sin() + fast * fast } else { fast }
//! });
//! // The monomials are x₁, x₂, x₁², x₁x₂, x₂².
//! let steps = [Step::Expand(Expansion::Quadratic), Step::Sfa { features: 1, lambda: 0.0 }];
//! let pipeline = Pipeline::fit(&steps, x.as_ref(), &Link::regular(2000, time(1))?)?;
//! let Stage::Sfa(sfa) = &pipeline.stages()[1] else { unreachable!() };
//! assert!((sfa.weights[(4, 0)] / sfa.weights[(0, 0)] + 1.0).abs() < 1e-9);
//! // √2 sin t has the slowness 1 (but for the n/(n − 1) of n samples with n − 1 differences).
//! assert!((sfa.slowness[0] - 1.0).abs() < 1e-3);
//! # Ok(())
//! # }
//! ```
//!
//! # Numerics
//! Sums and decompositions are in `f64`. [`solve()`] looks for few features of many coordinates by block Lanczos iteration and
//! for others by a dense decomposition ([`Method`]). Products and triangular solves have the same bits for any number of
//! threads; QR, LU, SVD and the smallest products follow faer's global setting, and differ in their last bits with it: who
//! compares bits calls [`crate::random::fix_parallelism`] first.
//!
//! # Reference
//! Thesis chapter 4; Wiskott & Sejnowski, Neural Computation 14 (2002). Errata of the thesis stand where they matter:
//! [`KernelSfa`] (§4.3.3), [`LinearSfa`] (§4.3.1), [`theory`] (§4.1.2), [`coherence::bray`] (§4.1.1).

pub mod classes;
pub mod coherence;
mod dense;
mod error;
mod expansion;
mod hierarchy;
pub mod ica;
mod kernel;
mod lanczos;
mod linear;
mod linear_stream;
mod links;
mod model;
mod moments;
mod quadratic;
pub mod region;
mod retained;
mod reveal;
mod solve;
mod stream;
mod symmetric;
pub mod theory;

pub use error::SlowError;
pub use expansion::{Expansion, Keep, MOST_MONOMIALS, Pca, Pipeline, Stage, Step};
pub use hierarchy::{Layer, Network, Node, Shape, TrainedLayer};
pub use kernel::KernelSfa;
pub use linear::LinearSfa;
pub use linear_stream::LinearStream;
pub use links::Link;
pub use model::SlowModel;
pub use moments::{MOST_COORDINATES, Moments};
pub use quadratic::QuadraticForm;
pub use solve::{Method, SlowFeatures, SolveOptions, Solver, TOLERANCE, solve, solve_bytes, solve_with};
pub use stream::{MOST_CHUNK, Options as StreamOptions, Screened, SlowStream};
