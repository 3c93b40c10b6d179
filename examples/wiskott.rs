//! A slow signal hidden in fast ones, found and drawn: the tutorial of slow feature analysis.
//!
//! Wiskott & Sejnowski (2002) mix a slow sine into two fast channels, x₁ = sin t + cos² 11t and x₂ = cos 11t. No weighted
//! sum of the two is slow, but x₁ − x₂² is: a polynomial of degree 2. So we expand the channels into all monomials up to
//! degree 2, and let linear SFA find the slowest weighted sums of those.
//!
//! `cargo run --release --example wiskott [PICTURE.svg]`

use std::error::Error;
use std::f64::consts::TAU;
use std::path::PathBuf;

use adagio::slow::{Expansion, LinearSfa, Link, Pipeline, Step};
use faer::Mat;
use plotters::prelude::*;

/// Slowness of the five features as published figures of this signal (2000 samples, both ends of [0, 2π] included).
const KNOWN: [f64; 5] = [1.0005, 120.93, 229.41, 357.47, 483.57];

fn main() -> Result<(), Box<dyn Error>> {
    // The signal, one frame a column, and how its frames follow each other.
    let n = 2000;
    let dt = TAU / (n - 1) as f64;
    let x = Mat::from_fn(2, n, |channel, i| {
        let fast = (11.0 * i as f64 * dt).cos();
        if channel == 0 { (i as f64 * dt).sin() + fast * fast } else { fast }
    });
    let links = Link::regular(n, dt)?;

    // Without an expansion: the slowest weighted sum is still fast.
    let linear = LinearSfa::fit(x.as_ref(), &links, 2, 0.0)?;
    println!("slowness of linear SFA: {:.2}, {:.2}", linear.slowness[0], linear.slowness[1]);

    // With it: monomials up to degree 2, then linear SFA.
    let steps = [Step::Expand(Expansion::Quadratic), Step::Sfa { features: 5, lambda: 0.0 }];
    let pipeline = Pipeline::fit(&steps, x.as_ref(), &links)?;
    let y = pipeline.apply(x.as_ref())?;
    println!("feature  slowness found  known");
    for (j, (found, known)) in pipeline.slowness().iter().zip(KNOWN).enumerate() {
        println!("{:>7}  {found:>14.4}  {known:>8.4}", j + 1);
    }

    // The slowest feature is the sine itself (its mean is 0).
    let sine = |i: usize| (i as f64 * dt).sin();
    let dot = |a: &dyn Fn(usize) -> f64, b: &dyn Fn(usize) -> f64| (0..n).map(|i| a(i) * b(i)).sum::<f64>();
    let slowest = |i: usize| y[(0, i)];
    let correlation = dot(&slowest, &sine) / (dot(&slowest, &slowest) * dot(&sine, &sine)).sqrt();
    println!("1 − |correlation| of the slowest feature with sin t: {:.1e}", 1.0 - correlation.abs());

    let path = std::env::args_os().nth(1).map_or_else(|| std::env::temp_dir().join("wiskott.svg"), PathBuf::from);
    draw(&path, &x, &y)?;
    println!("{}", path.display());
    Ok(())
}

/// Inputs in the upper row, the two slowest features in the lower.
fn draw(path: &std::path::Path, x: &Mat<f64>, y: &Mat<f64>) -> Result<(), Box<dyn Error>> {
    let (blue, orange) = (RGBColor(46, 105, 155), RGBColor(214, 126, 44));
    let panels: [(&str, &Mat<f64>, usize, RGBColor); 4] = [
        ("input x1 = sin t + cos² 11t", x, 0, blue),
        ("input x2 = cos 11t", x, 1, blue),
        ("slowest feature: sin t", y, 0, orange),
        ("second feature", y, 1, orange),
    ];
    let root = SVGBackend::new(path, (1200, 480)).into_drawing_area();
    root.fill(&WHITE)?;
    for (area, (title, values, row, colour)) in root.split_evenly((2, 2)).iter().zip(panels) {
        let mut chart = ChartBuilder::on(area)
            .margin(12)
            .caption(title, ("sans-serif", 18))
            .build_cartesian_2d(0..values.ncols(), -2.2..2.2)?;
        let line = (0..values.ncols()).map(|t| (t, values[(row, t)]));
        chart.draw_series(LineSeries::new([(0, 0.0), (values.ncols(), 0.0)], BLACK.mix(0.2)))?;
        chart.draw_series(LineSeries::new(line, colour.stroke_width(2)))?;
    }
    root.present()?;
    Ok(())
}
