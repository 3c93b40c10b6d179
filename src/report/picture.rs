//! `overview.svg`: what came out of a run, at one glance.

use std::io::Cursor;
use std::path::PathBuf;

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use image::{ExtendedColorType, ImageEncoder as _, codecs::png::PngEncoder};
use plotters::coord::Shift;
use plotters::prelude::*;
use thiserror::Error;

use super::room::{self, GOAL, HATCH, PATH, Shown, Survey};
use super::{Numbered, Report};
use crate::log::LogError;
use crate::policy::Learned;
use crate::scenario::Scenario;
use crate::vision::observe;
use crate::world::{Pose, World};

/// Name of the picture in a run folder.
pub const OVERVIEW_NAME: &str = "overview.svg";

/// Width and height, pixels.
const SIZE: (u32, u32) = (1200, 900);

/// Tasks whose rooms fit side by side.
const MOST_TASKS: usize = 2;

/// Actions of the path that is shown; many more would cover the room.
const PATH_ACTIONS: usize = 300;

/// Sizes of letters, pixels.
const LARGE: u32 = 18;
const MEDIUM: u32 = 14;
pub const SMALL: u32 = 12;

pub const INK: RGBColor = RGBColor(40, 44, 52);
const GRID: RGBColor = RGBColor(228, 228, 228);
const BLUE: RGBColor = RGBColor(46, 105, 155);
const ORANGE: RGBColor = RGBColor(214, 126, 44);

/// What plotters reports.
pub type DrawError = DrawingAreaErrorKind<std::io::Error>;

type Area<'a> = DrawingArea<SVGBackend<'a>, Shift>;

/// Why a run cannot be drawn.
#[derive(Debug, Error)]
pub enum PictureError {
    /// The robot's path is not to be had.
    #[error("cannot read the robot's path: {0}")]
    Path(#[from] LogError),
    /// A part of the picture cannot be drawn.
    #[error("cannot draw {part}: {cause}")]
    Draw {
        /// The part.
        part: &'static str,
        /// What the drawing library says.
        cause: DrawError,
    },
    /// An image cannot be put into the picture.
    #[error("cannot encode {what} of {width} × {height} pixels: {cause}")]
    Encode {
        /// The image.
        what: &'static str,
        /// Pixels.
        width: usize,
        /// Pixels.
        height: usize,
        /// What the encoder says.
        cause: image::ImageError,
    },
}

/// Draw what came out of a run as one SVG file, which refers to nothing outside of itself.
///
/// Without a model there are no values and arrows, without poses in the log no path and no camera images; the rest is drawn.
///
/// # Errors
/// The log cannot be read, or a part cannot be drawn; see [`PictureError`].
pub fn overview(
    scenario: &Scenario,
    world: &World,
    learned: Option<&Learned>,
    report: &Report,
    logs: Vec<PathBuf>,
) -> Result<String, PictureError> {
    let path = room::last_poses(logs, PATH_ACTIONS * scenario.robot.frames_per_action + 1)?;
    let tasks = scenario.tasks.len().min(MOST_TASKS);
    let survey = learned.map(|learned| Survey::new(scenario, world, learned, tasks));
    let shown = Shown { scenario, world, path: &path, survey: survey.as_ref() };
    let mut svg = String::new();
    {
        let root = SVGBackend::with_string(&mut svg, SIZE).into_drawing_area();
        let part = |part: &'static str| move |cause: DrawError| PictureError::Draw { part, cause };
        root.fill(&WHITE).map_err(part("the background"))?;
        title(&root, report, &path, scenario).map_err(part("the title"))?;
        let width = SIZE.0 / tasks.max(1) as u32;
        for task in 0..tasks {
            let area = root.clone().shrink((task as u32 * width + 12, 84), (width - 24, 376));
            let drawn = heading(&area, &task_line(scenario, report, task))
                .and_then(|()| shown.draw(&area.shrink((0, 24), (width - 24, 352)), task));
            drawn.map_err(part("a room"))?;
        }
        learning(&root.clone().shrink((12, 472), (400, 214)), report).map_err(part("the learning curves"))?;
        growth(&root.clone().shrink((12, 686), (400, 208)), report).map_err(part("the support vectors"))?;
        slowness(&root.clone().shrink((430, 472), (400, 422)), report).map_err(part("the slowness"))?;
        let seen = root.clone().shrink((SEEN_LEFT, 472), (SEEN_WIDTH, 422));
        seen_headings(&seen, scenario, !path.is_empty()).map_err(part("the camera's headings"))?;
        root.present().map_err(part("the end"))?;
    }
    if let Some(pose) = path.last() {
        // The library writes no images into SVG: they go before the closing tag that it has just written.
        let end = svg.rfind("</svg>").unwrap_or(svg.len());
        svg.insert_str(end, &images(scenario, world, pose)?);
    }
    Ok(svg)
}

/// Letters of a size.
pub fn text(size: u32) -> TextStyle<'static> {
    ("sans-serif", size).into_font().color(&INK)
}

fn bold(size: u32) -> TextStyle<'static> {
    ("sans-serif", size).into_font().style(FontStyle::Bold).color(&INK)
}

fn heading(area: &Area<'_>, line: &str) -> Result<(), DrawError> {
    area.draw(&Text::new(line.to_owned(), (0, 0), bold(MEDIUM)))
}

fn title(root: &Area<'_>, report: &Report, path: &[Pose], scenario: &Scenario) -> Result<(), DrawError> {
    let run = &report.run;
    let mut line = format!(
        "{}, seed {}: {} actions, {} frames, ",
        report.scenario.name,
        report.scenario.seed,
        Numbered(run.actions),
        Numbered(run.frames)
    );
    match &report.dictionary {
        Some(dictionary) => line += &format!("{} support vectors", Numbered(dictionary.support_vectors as u64)),
        None => line += "no model",
    }
    for (i, task) in report.tasks.iter().enumerate() {
        let before = if i == 0 { "; success: " } else { ", " };
        line += &format!("{before}{} {:.1} %", task.name, 100.0 * task.success);
    }
    root.draw(&Text::new(line, (12, 12), bold(LARGE)))?;
    let actions = path.len().saturating_sub(1) / scenario.robot.frames_per_action;
    let mut x = 12;
    let mut entry = |line: String| {
        // Letters of the viewer's font have about this width.
        let (from, width) = (x, (6.3 * line.chars().count() as f64) as i32);
        x += 26 + width + 22;
        root.draw(&Text::new(line, (from + 26, 48), text(SMALL))).map(|()| from)
    };
    let goal = entry("goal area".to_owned())?;
    let near = entry("near a wall, punished".to_owned())?;
    let trail = entry(format!("robot's path, last {actions} actions"))?;
    let values = entry("value of the best action, mean of 8 headings".to_owned())?;
    let arrow = entry("heading of the highest value".to_owned())?;
    root.draw(&Rectangle::new([(goal, 48), (goal + 18, 60)], GOAL.mix(0.45).filled()))?;
    for i in 0..3 {
        root.draw(&PathElement::new([(near + 6 * i - 4, 60), (near + 6 * i + 8, 48)], HATCH.mix(0.5)))?;
    }
    root.draw(&PathElement::new([(trail, 54), (trail + 20, 54)], PATH.stroke_width(2)))?;
    for i in 0..6 {
        let left = values + 3 * i;
        let fill = room::colour((f64::from(i) + 0.5) / 6.0).filled();
        root.draw(&Rectangle::new([(left, 48), (left + 3, 60)], fill))?;
    }
    root.draw(&PathElement::new([(arrow, 54), (arrow + 13, 54)], INK))?;
    root.draw(&Polygon::new([(arrow + 20, 54), (arrow + 11, 50), (arrow + 11, 58)], INK.filled()))
}

fn task_line(scenario: &Scenario, report: &Report, task: usize) -> String {
    let name = &scenario.tasks[task].name;
    match report.tasks.get(task) {
        Some(result) => format!(
            "{name}: {:.1} % of {} starts arrive, {}quality {:.3}",
            100.0 * result.success,
            result.starts,
            result.extra_steps.map_or(String::new(), |extra| format!("{extra:.2} extra steps, ")),
            result.convergence_quality
        ),
        None => format!("{name}: not evaluated"),
    }
}

fn whole(value: &f64) -> String {
    Numbered(value.round().max(0.0) as u64).to_string()
}

/// Name, colour and points of a line.
type Curve = (&'static str, RGBColor, Vec<(f64, f64)>);

/// A chart over the run's actions, with its grid and labels, for lines with points.
fn over_actions(
    area: &Area<'_>,
    (line, unit): (&str, &str),
    actions: u64,
    top: f64,
    format: &dyn Fn(&f64) -> String,
    curves: &[Curve],
) -> Result<(), DrawError> {
    heading(area, line)?;
    let (width, height) = area.dim_in_pixel();
    let mut chart = ChartBuilder::on(&area.clone().shrink((0, 26), (width, height - 26)))
        .margin_right(16)
        .x_label_area_size(42)
        .y_label_area_size(58)
        .build_cartesian_2d(0.0..actions.max(1) as f64, 0.0..top)?;
    chart
        .configure_mesh()
        .light_line_style(TRANSPARENT)
        .bold_line_style(GRID)
        .axis_style(INK.mix(0.4))
        .label_style(text(SMALL))
        .x_labels(6)
        .y_labels(5)
        .x_label_formatter(&whole)
        .y_label_formatter(&format)
        .x_desc("actions")
        .y_desc(unit)
        .draw()?;
    for (name, colour, points) in curves {
        let colour = *colour;
        chart
            .draw_series(LineSeries::new(points.iter().copied(), colour.stroke_width(2)))?
            .label(*name)
            .legend(move |(x, y)| PathElement::new([(x, y), (x + 18, y)], colour.stroke_width(2)));
        chart.draw_series(points.iter().map(|&point| Circle::new(point, 3, colour.filled())))?;
    }
    if curves.len() > 1 {
        chart
            .configure_series_labels()
            .position(SeriesLabelPosition::LowerRight)
            .background_style(WHITE.mix(0.85))
            .label_font(text(SMALL))
            .draw()?;
    }
    Ok(())
}

fn learning(area: &Area<'_>, report: &Report) -> Result<(), DrawError> {
    if report.curve.is_empty() {
        return heading(area, "No model was evaluated during the run");
    }
    let points = |value: fn(&crate::agent::CurvePoint) -> f64| {
        report.curve.iter().map(|point| (point.actions as f64, value(point))).collect::<Vec<_>>()
    };
    let curves = [
        ("success", BLUE, points(|point| point.success)),
        ("convergence quality", ORANGE, points(|point| point.convergence_quality)),
    ];
    let highest = curves.iter().flat_map(|curve| &curve.2).map(|point| point.1).fold(1.0, f64::max);
    let line = ("Learning, mean over tasks", "share (1: optimal)");
    over_actions(area, line, report.run.actions, 1.05 * highest, &|value| format!("{value:.1}"), &curves)
}

fn growth(area: &Area<'_>, report: &Report) -> Result<(), DrawError> {
    if report.curve.is_empty() {
        return Ok(());
    }
    let points: Vec<_> =
        report.curve.iter().map(|point| (point.actions as f64, point.support_vectors as f64)).collect();
    let highest = points.iter().map(|point| point.1).fold(1.0, f64::max);
    let curves = [("support vectors", BLUE, points)];
    over_actions(area, ("Dictionary", "support vectors"), report.run.actions, 1.1 * highest, &whole, &curves)
}

fn slowness(area: &Area<'_>, report: &Report) -> Result<(), DrawError> {
    // A logarithmic axis has no zero.
    let slowness = report.model.iter().flat_map(|model| &model.slowness).copied().enumerate();
    let points: Vec<_> = slowness.filter(|(_, value)| *value > 0.0).map(|(i, value)| ((i + 1) as f64, value)).collect();
    let Some(&(last, _)) = points.last() else {
        return heading(area, "There are no slow features");
    };
    heading(area, &format!("Slowness of all {} features", points.len()))?;
    let range = |(low, high): (f64, f64), &(_, value): &(f64, f64)| (low.min(value), high.max(value));
    let (low, high) = points.iter().fold((f64::INFINITY, 0.0), range);
    let (width, height) = area.dim_in_pixel();
    let mut chart = ChartBuilder::on(&area.clone().shrink((0, 26), (width, height - 26)))
        .margin_right(16)
        .x_label_area_size(42)
        .y_label_area_size(58)
        .build_cartesian_2d(0.0..last.max(2.0), (0.8 * low..1.25 * high).log_scale())?;
    chart
        .configure_mesh()
        .light_line_style(GRID.mix(0.5))
        .bold_line_style(GRID)
        .axis_style(INK.mix(0.4))
        .label_style(text(SMALL))
        .x_labels(6)
        .y_labels(8)
        .x_label_formatter(&whole)
        .y_label_formatter(&|value| format!("{value}"))
        .x_desc("feature, from the slowest")
        .y_desc("slowness, 1/s² (lower is slower)")
        .draw()?;
    chart.draw_series(LineSeries::new(points.iter().copied(), BLUE.stroke_width(2)))?;
    chart.draw_series(points.iter().map(|&point| Circle::new(point, 1, BLUE.filled())))?;
    Ok(())
}

/// Where the camera's images are, pixels.
const SEEN_LEFT: u32 = 872;
const SEEN_WIDTH: u32 = 316;
const FRAME_TOP: u32 = 498;
const FRAME_HEIGHT: u32 = 196;
const OBSERVATION_TOP: u32 = 728;
const OBSERVATION_HEIGHT: u32 = 162;

fn seen_headings(area: &Area<'_>, scenario: &Scenario, known: bool) -> Result<(), DrawError> {
    if !known {
        return heading(area, "No pose was recorded");
    }
    let ((width, height), vision) = (scenario.camera.rendered(&scenario.vision), &scenario.vision);
    heading(area, &format!("Camera at the last pose, {width} × {height} pixels"))?;
    let line = format!("What is learned from, {} × {} pixels", vision.width, vision.height);
    area.draw(&Text::new(line, (0, (OBSERVATION_TOP - 498) as i32), bold(MEDIUM)))
}

/// The camera image from a pose, and the observation that is made of it, as SVG elements.
fn images(scenario: &Scenario, world: &World, pose: &Pose) -> Result<String, PictureError> {
    let frame = world.looks.camera(u64::MAX).render(pose);
    let observation = observe(&frame, &scenario.vision, 0);
    let vision = &scenario.vision;
    let first = element("the camera image", (frame.width, frame.height), &frame.rgb, FRAME_TOP, FRAME_HEIGHT)?;
    // Enlarged here: many viewers smooth small images whatever the file asks for.
    let times = (frame.width / vision.width).max(1);
    let size = (times * vision.width, times * vision.height);
    let pixels = enlarged(&observation.pixels, vision.width, times);
    let second = element("the observation", size, &pixels, OBSERVATION_TOP, OBSERVATION_HEIGHT)?;
    Ok(first + &second)
}

/// An RGB image with every pixel repeated `times` × `times`.
fn enlarged(rgb: &[u8], width: usize, times: usize) -> Vec<u8> {
    let wide = |row: &[u8]| -> Vec<u8> { row.chunks_exact(3).flat_map(|pixel| pixel.repeat(times)).collect() };
    rgb.chunks_exact(3 * width).flat_map(|row| wide(row).repeat(times)).collect()
}

/// An image as large as fits.
fn element(
    what: &'static str,
    (width, height): (usize, usize),
    rgb: &[u8],
    top: u32,
    tallest: u32,
) -> Result<String, PictureError> {
    let mut png = Cursor::new(Vec::new());
    PngEncoder::new(&mut png)
        .write_image(rgb, width as u32, height as u32, ExtendedColorType::Rgb8)
        .map_err(|cause| PictureError::Encode { what, width, height, cause })?;
    let data = STANDARD.encode(png.into_inner());
    Ok(format!(
        "<image x=\"{SEEN_LEFT}\" y=\"{top}\" width=\"{SEEN_WIDTH}\" height=\"{tallest}\" \
         preserveAspectRatio=\"xMinYMin meet\" \
         href=\"data:image/png;base64,{data}\"/>\n"
    ))
}
