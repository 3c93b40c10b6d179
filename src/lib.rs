//! Adagio is an agent that learns to navigate from a camera, while it drives.
//!
//! It explores, learns what its images mean (slow features), learns what its actions are worth and acts on that, in one
//! continuous run that is recorded in one log. It carries on W. Böhmer's thesis *Robot Navigation using Reinforcement Learning
//! and Slow Feature Analysis*, which ran as three offline phases, as a stream. The thesis's values, linear in the features by
//! least-squares policy iteration, are there; by default, features say which states are near each other, and values come from
//! the transitions nearby ([`value::Local`]).
//!
//! # The way of a frame
//!
//! ```text
//!  scenario.toml
//!       │
//!    source ──frame──▶ vision ──observation──▶ dictionary ──Newton coordinates──▶ moments ──▶ slow features ─┐ (model k)
//!       ▲                32 × 16 RGB             ALD, grows       v = L⁻¹k(x)     running     re-solved      │
//!       │                                                                          sums       now and then   │
//!       │                                                                                                    ▼
//!       └──action── policy ◀──────── values ◀──rolling window of transitions (x, a, r, x′)─── features φ(x)
//!
//!  everything that happens ──────────▶ log (MCAP)
//! ```
//!
//! # The folders, in the order of that way
//!
//! | module | what it is |
//! |---|---|
//! | [`scenario`] | what to run: a TOML file as checked values |
//! | [`robot`] | what a robot is: its actions, how they move it, which undo which; poses |
//! | [`source`] | where frames come from |
//! | `ros2` | a robot on a ROS 2 network |
//! | [`world`] | the simulated world: walls, robot, sonar, camera |
//! | [`vision`] | camera image → observation |
//! | [`kernel`] | kernel functions, kernel values for blocks, kernel principal components |
//! | [`dictionary`] | which observations to keep as support vectors: ALD, random, greedy, over features |
//! | [`regression`] | least squares, ridge, kernel ridge, validation |
//! | [`slow`] | moments and slow features: linear, expanded, kernel, hierarchical; theory, other objectives, ICA |
//! | [`value`] | transitions, local values, LSTD, LSQ, LSPI; finite processes with exact answers, small worlds |
//! | [`policy`] | exploration, pursuit, reflexes |
//! | [`agent`] | the actors, and what they run on |
//! | [`log`] | messages, CDR, writer, reader |
//! | [`gpu`] | a graphics processor, where there is one |
//! | [`snapshot`] | objects saved and restored, bit for bit |
//! | [`replay`] | a recorded run once more; two runs side by side |
//! | [`learn`] | one model from many logs |
//! | [`export`] | a recorded run as arrays for Python |
//! | [`evaluate`] | trials, optimum, reference, convergence quality, pose decoding |
//! | [`report`] | what a run came to |
//! | [`experiment`] | the thesis's experiments, its figures beside ours |
//! | [`live`] | a run, watched while it goes on: terminal, local web page |
//! | [`cli`] | one file per command |
//!
//! [`kernel`], [`dictionary`], [`regression`], [`slow`] and [`value`] know nothing of threads, clocks, files, robots or
//! images: they can be used for other signals. They follow the chapters of the thesis, and the first page of each says which
//! tool is for what:
//!
//! | thesis | here |
//! |---|---|
//! | §2.1 regression, validation | [`regression`] |
//! | §2.2.1–2.2.5 kernels, kernel covariance, approximations | [`kernel`] |
//! | §2.2.6 support vectors | [`dictionary`] |
//! | §3.1 Markov processes, representations | [`value::FiniteMdp`], [`value::Tabular`], [`value::Trigonometric`] |
//! | §3.2, §3.3 value estimation, policy iteration | [`value`] |
//! | §4.1.1 objectives | [`slow`], [`slow::coherence`] |
//! | §4.1.2 optimal responses | [`slow::theory`] |
//! | §4.2.3 place cells | [`slow::Network`], [`slow::ica`] |
//! | §4.3 algorithms | [`slow`] |
//! | §6 outlook | [`value::LspiOptions`], [`value::Smoothing`] |
//!
//! Two tutorials stand in `examples/`: `wiskott` (a slow signal hidden in fast ones) and `chain_walk` (policy iteration and
//! how it can fail); and one measurement, `outlook` (whether the ideas of the thesis's outlook help policy iteration).
//!
//! # As a library
//!
//! ```toml
//! [dependencies]
//! adagio = { path = "../adagio", default-features = false }   # the mathematics alone; features add the rest
//! ```
//!
//! Matrices are those of [`faer`], re-exported here so that versions fit. One observation is a column; a slice of samples one
//! after another is a matrix without a copy: `faer::MatRef::from_column_major_slice(&samples, channels, count)`.
//!
//! | feature | adds |
//! |---|---|
//! | `rayon` | threads; results have the same bits without |
//! | `snapshot` | saving and restoring dictionaries, moments, streams |
//! | `agent` | scenarios, simulator, actors, log, replay, export |
//! | `report`, `live`, `gpu`, `cli` | reports and experiments; watching; graphics processors; the program |
//!
//! # Slow features of a stream, without any robot
//!
//! ```
//! use adagio::dictionary::{Ald, Parameters, WhenFull};
//! use adagio::kernel::Kernel;
//! use adagio::slow::{Link, SlowModel, SlowStream, StreamOptions, solve};
//! use faer::{Mat, Par};
//!
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! // A slow phase, seen through two fast-changing channels: x = (sin t + cos²(11 t), cos 11 t).
//! let n = 2000;
//! let t = |i: usize| std::f64::consts::TAU * i as f64 / n as f64;
//! let x = Mat::from_fn(2, n, |row, i| {
//!     let fast = (11.0 * t(i)).cos();
//!     if row == 0 { t(i).sin() + fast * fast } else { fast }
//! });
//!
//! let kernel = Kernel::gaussian(1.5)?;
//! let ald = Ald::new(Parameters { kernel, nu: 1e-5, budget: 200, when_full: WhenFull::Stop, par: Par::Seq })?;
//! let mut stream = SlowStream::new(ald, StreamOptions::default())?;
//! let link = Some(Link { dt: 1.0, weight: 1.0 });
//! for start in (0..n).step_by(100) {
//!     stream.push(x.as_ref().subcols(start, 100), &[link; 100])?;
//! }
//!
//! let features = solve(stream.settled_moments()?, 1, 1e-9, None)?;
//! let phi = SlowModel::new(stream.dictionary(), &features)?.apply(x.as_ref(), Par::Seq)?;
//! // The slowest feature is sin t, which neither channel shows.
//! let product: f64 = (0..n).map(|i| phi[(1, i)] * t(i).sin()).sum::<f64>() / n as f64;
//! let correlation = product.abs() / 0.5f64.sqrt();
//! assert!(correlation > 0.99, "{correlation}");
//! # Ok(())
//! # }
//! ```

pub use faer;

#[cfg(feature = "agent")]
pub mod agent;
#[cfg(feature = "cli")]
pub mod cli;
pub mod dictionary;
#[cfg(feature = "agent")]
pub mod evaluate;
#[cfg(feature = "report")]
pub mod experiment;
#[cfg(feature = "agent")]
pub mod export;
#[cfg(feature = "live")]
pub mod fleet;
#[cfg(feature = "agent")]
pub mod gpu;
pub mod kernel;
#[cfg(feature = "agent")]
pub mod learn;
#[cfg(feature = "live")]
pub mod live;
#[cfg(feature = "agent")]
mod lock;
#[cfg(feature = "agent")]
pub mod log;
#[cfg(feature = "agent")]
pub mod policy;
pub mod random;
pub mod regression;
#[cfg(feature = "agent")]
pub mod replay;
#[cfg(feature = "report")]
pub mod report;
#[cfg(feature = "agent")]
pub mod robot;
#[cfg(feature = "ros2")]
pub mod ros2;
#[cfg(feature = "agent")]
pub mod scenario;
pub mod slow;
#[cfg(feature = "snapshot")]
pub mod snapshot;
#[cfg(feature = "report")]
pub mod soak;
#[cfg(feature = "agent")]
pub mod source;
pub mod value;
#[cfg(feature = "agent")]
pub mod vision;
#[cfg(feature = "agent")]
pub mod world;
