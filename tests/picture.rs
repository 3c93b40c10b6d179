//! `overview.svg` of a run is one whole file that shows the run's own numbers.

mod common;

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use common::{report, smoke_run};
use roxmltree::Document;

#[test]
fn a_run_leaves_a_picture_that_stands_alone_and_shows_its_numbers() {
    let folder = tempfile::tempdir().unwrap();
    let run = smoke_run(folder.path(), "run", &[]);
    let (svg, report) = (std::fs::read_to_string(run.join("overview.svg")).unwrap(), report(&run));
    let document = Document::parse(&svg).unwrap();
    let named = |name: &'static str| document.descendants().filter(move |node| node.has_tag_name(name));
    // Nothing is loaded: the only addresses are the names of namespaces.
    assert_eq!(svg.matches("http://").count(), svg.matches("xmlns=\"http://www.w3.org/").count());
    assert!(!svg.contains("https://"));

    let texts: Vec<&str> = document.descendants().filter_map(|node| node.text()).map(str::trim).collect();
    let success = |task: usize| 100.0 * report["tasks"][task]["success"].as_f64().unwrap();
    let title = format!(
        "smoke, seed 1: 400 actions, 2 001 frames, 300 support vectors; success: centre {:.1} %, corner {:.1} %",
        success(0),
        success(1)
    );
    assert!(texts.contains(&title.as_str()), "{title} is not in {texts:?}");

    let goals = named("circle").filter(|node| node.attribute("opacity") == Some("0.45"));
    assert_eq!(goals.count(), 2, "one filled goal for each task");
    let sizes: Vec<(u32, u32)> = named("image")
        .map(|node| {
            let data = node.attribute("href").unwrap().strip_prefix("data:image/png;base64,").unwrap();
            let png = STANDARD.decode(data).unwrap();
            let image = image::load_from_memory_with_format(&png, image::ImageFormat::Png).unwrap();
            (image.width(), image.height())
        })
        .collect();
    assert_eq!(sizes, [(320, 240), (320, 160)], "camera image, and observation ten times enlarged");
}
