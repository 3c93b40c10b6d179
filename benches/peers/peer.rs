//! Our side of `compare.py`: one JSON request per line on standard input, one JSON answer per line on standard output.
//!
//! `{"do": NAME, …}` is answered by `{"seconds": …, …}`, the time of the named work alone. What both sides work on lies in
//! the folder that is the only argument, as `.npy` files; those that this side writes are named with each request.

#[path = "../common/mod.rs"]
mod common;
mod npy;

use std::error::Error;
use std::io::{BufRead, Write};
use std::path::PathBuf;
use std::time::Instant;

use common::data::{BLOCK, D, frames};
use common::machine::Rates;
use common::operations;

use adagio::dictionary::Dictionary;
use adagio::slow::{Link, Method, Moments, SlowFeatures, SlowStream, SolveOptions, solve_with};
use adagio::value::{Instances, Local, LocalOptions};
use faer::linalg::triangular_solve::solve_lower_triangular_in_place;
use faer::{Mat, Par};
use serde_json::{Value, json};

type Answer = Result<Value, Box<dyn Error>>;

fn main() -> Result<(), Box<dyn Error>> {
    adagio::random::fix_parallelism();
    let Some(folder) = std::env::args().nth(1) else {
        return Err("this is our side of benches/peers/compare.py, which starts it with a folder".into());
    };
    let mut peer = Peer {
        folder: folder.into(),
        x: Mat::new(),
        stream: None,
        dictionary: None,
        rows: Mat::new(),
        moments: None,
        points: Mat::new(),
        ends: Mat::new(),
    };
    for line in std::io::stdin().lock().lines() {
        let answer = peer.answer(&serde_json::from_str(&line?)?)?;
        let mut out = std::io::stdout().lock();
        writeln!(out, "{answer}")?;
        out.flush()?;
    }
    Ok(())
}

/// What earlier requests have set up.
struct Peer {
    folder: PathBuf,
    x: Mat<f32>,
    stream: Option<SlowStream<f32>>,
    dictionary: Option<Dictionary<f32>>,
    rows: Mat<f64>,
    moments: Option<Moments>,
    points: Mat<f32>,
    ends: Mat<f32>,
}

impl Peer {
    fn answer(&mut self, request: &Value) -> Answer {
        let number = |key: &str| request[key].as_u64().map(|value| value as usize).ok_or(format!("{key} is missing"));
        let par = Par::rayon(common::cores());
        match request["do"].as_str() {
            Some("rates") => rates(par),
            Some("frames") => self.frames(number("n")?),
            Some("kernel_rows") => self.kernel_rows(number("m")?, number("n")?, par),
            Some("stream") => self.stream(number("m")?, par),
            Some("push") => self.push(number("m")?, number("n")?),
            Some("dictionary") => self.dictionary(number("m")?, par),
            Some("coordinates") => self.coordinates(number("n")?),
            Some("moments") => self.moments(number("m")?, number("n")?, par),
            Some("solve") => self.solve(number("k")?, par),
            Some("rows") => self.rows(number("m")?, number("n")?, par),
            Some("sfa") => self.sfa(number("k")?, request["lambda"].as_f64().unwrap_or(0.0), par),
            Some("window") => self.window(number("n")?, number("p")?),
            Some("neighbours") => self.neighbours(),
            Some("nearest") => self.nearest(number("n")?),
            other => Err(format!("unknown request {other:?}").into()),
        }
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.join(name)
    }

    /// Make `n` frames and write them to `frames.npy`, one a row.
    fn frames(&mut self, n: usize) -> Answer {
        self.x = frames(D, n);
        npy::write(&self.path("frames.npy"), "<f4", &self.x, |value: f32| value.to_le_bytes())?;
        Ok(json!({"sigma": common::data::width(&self.x), "lambda": operations::LAMBDA, "block": BLOCK}))
    }

    /// Kernel rows of the `n` frames behind the first `m`, which are the support vectors.
    fn kernel_rows(&self, m: usize, n: usize, par: Par) -> Answer {
        let kernel = operations::kernel(&self.x);
        let (s, block) = (self.x.as_ref().subcols(0, m), self.x.as_ref().subcols(m, n));
        let norms = adagio::kernel::squared_norms(s);
        let (rows, seconds) = timed(|| kernel.matrix(s, &norms, block, &adagio::kernel::squared_norms(block), par));
        Ok(json!({"seconds": seconds, "first": rows?[(0, 0)]}))
    }

    /// A stream whose first `m` frames are its support vectors, and which takes no more.
    fn stream(&mut self, m: usize, par: Par) -> Answer {
        let (stream, seconds) = timed(|| operations::full_stream(&self.x, m, 4 * BLOCK, par));
        self.stream = Some(stream);
        Ok(json!({"seconds": seconds}))
    }

    /// Growth and moments of the `n` frames behind the first `m`.
    fn push(&mut self, m: usize, n: usize) -> Answer {
        let stream = self.stream.as_mut().ok_or("push before stream")?;
        let ((), seconds) = timed(|| operations::push(stream, &self.x, m..m + n));
        Ok(json!({"seconds": seconds}))
    }

    fn dictionary(&mut self, m: usize, par: Par) -> Answer {
        self.stream = None;
        let (dictionary, seconds) = timed(|| operations::dictionary(&self.x, m, par));
        self.dictionary = Some(dictionary);
        Ok(json!({"seconds": seconds}))
    }

    /// Newton coordinates of `n` frames behind the support vectors, to `coordinates.npy`, one frame a row.
    fn coordinates(&self, n: usize) -> Answer {
        let dictionary = self.dictionary.as_ref().ok_or("coordinates before dictionary")?;
        let x = self.x.as_ref().subcols(dictionary.len(), n);
        let (v, seconds) = timed(|| dictionary.coordinates(x));
        npy::write(&self.path("coordinates.npy"), "<f8", &v?, |value: f64| value.to_le_bytes())?;
        Ok(json!({"seconds": seconds}))
    }

    /// Moments of the first `n` frames over the first `m`; their means to `covariance.npy` and `rate.npy`.
    fn moments(&mut self, m: usize, n: usize, par: Par) -> Answer {
        self.dictionary(m, par)?;
        let dictionary = self.dictionary.take().ok_or("no dictionary")?;
        let x = self.x.as_ref().subcols(0, n).to_owned();
        let moments = operations::moments(&dictionary, &x, par);
        for (name, matrix) in [("covariance.npy", moments.covariance()), ("rate.npy", moments.rate())] {
            npy::write(&self.path(name), "<f8", &matrix, |value: f64| value.to_le_bytes())?;
        }
        self.moments = Some(moments);
        Ok(json!({}))
    }

    fn solve(&self, k: usize, par: Par) -> Answer {
        let moments = self.moments.as_ref().ok_or("solve before moments")?;
        let (features, seconds) = timed(|| operations::resolve(moments, k, None, par));
        Ok(json!({"seconds": seconds, "objectives": objectives(&features)}))
    }

    /// Kernel rows of the first `n` frames over the first `m`, to `rows.npy`, one frame a row.
    fn rows(&mut self, m: usize, n: usize, par: Par) -> Answer {
        self.dictionary(m, par)?;
        let dictionary = self.dictionary.as_ref().ok_or("no dictionary")?;
        self.rows = dictionary.kernel_rows(self.x.as_ref().subcols(0, n))?;
        npy::write(&self.path("rows.npy"), "<f8", &self.rows, |value: f64| value.to_le_bytes())?;
        Ok(json!({}))
    }

    /// SFA on these kernel rows, with a time step of 1.
    fn sfa(&self, k: usize, lambda: f64, par: Par) -> Answer {
        let dictionary = self.dictionary.as_ref().ok_or("sfa before rows")?;
        let (features, seconds) = timed(|| -> Result<_, Box<dyn Error>> {
            let mut v = self.rows.clone();
            solve_lower_triangular_in_place(dictionary.factor(), v.as_mut(), par);
            let mut moments = Moments::new(par);
            moments.widen(v.nrows())?;
            moments.add_series(v.as_ref(), &Link::regular(v.ncols(), 1.0)?, None)?;
            let options = SolveOptions { method: Method::Automatic, par };
            Ok(solve_with(&moments, k, lambda, None, &options)?)
        });
        Ok(json!({"seconds": seconds, "slowness": features?.slowness}))
    }

    /// Where `n` transitions of a walk begin and end, in `p` coordinates, to `points.npy` and `ends.npy`, one a row.
    fn window(&mut self, n: usize, p: usize) -> Answer {
        let walk = operations::Transitions::of_walk(n, p);
        [self.points, self.ends] = [&walk.phi, &walk.next].map(|phi| Mat::from_fn(p, n, |i, t| phi[(i + 1, t)] as f32));
        for (name, points) in [("points.npy", &self.points), ("ends.npy", &self.ends)] {
            npy::write(&self.path(name), "<f4", points, |value: f32| value.to_le_bytes())?;
        }
        Ok(json!({"neighbours": LocalOptions::default().neighbours}))
    }

    fn instances(&self, neighbours: usize) -> Result<Instances, Box<dyn Error>> {
        let options = LocalOptions { neighbours, ..LocalOptions::default() };
        Ok(Instances::new(self.points.clone(), vec![self.points.ncols()], options)?)
    }

    /// The neighbours of all ends, and how much each counts.
    fn neighbours(&self) -> Answer {
        let (found, seconds) = timed(|| -> Result<(), Box<dyn Error>> {
            let instances = self.instances(LocalOptions::default().neighbours)?;
            std::hint::black_box(Local::new(&instances, self.ends.as_ref())?);
            Ok(())
        });
        found?;
        Ok(json!({"seconds": seconds}))
    }

    /// The point that is nearest to each of the first `n` ends.
    fn nearest(&self, n: usize) -> Answer {
        let numbers: Vec<f64> = (0..self.points.ncols()).map(|t| t as f64).collect();
        let nearest = self.instances(1)?.action_values(&[&numbers], self.ends.as_ref().subcols(0, n))?.swap_remove(0);
        Ok(json!({"nearest": (0..n).map(|t| nearest[(0, t)] as usize).collect::<Vec<usize>>()}))
    }
}

/// What is minimised, `wᵀ(Ḋ + λI)w = Δ + λ‖w‖²`, ascending.
fn objectives(features: &SlowFeatures) -> Vec<f64> {
    let norm = |j: usize| features.weights.col(j).squared_norm_l2();
    let mut values: Vec<f64> =
        features.slowness.iter().enumerate().map(|(j, slowness)| slowness + features.lambda * norm(j)).collect();
    values.sort_by(f64::total_cmp);
    values
}

/// Rates of our matrix product, operations per second.
fn rates(par: Par) -> Answer {
    let Rates { single, double } = Rates::now(par);
    Ok(json!({"single": single, "double": double}))
}

fn timed<R>(work: impl FnOnce() -> R) -> (R, f64) {
    let begin = Instant::now();
    let result = work();
    (result, begin.elapsed().as_secs_f64())
}
