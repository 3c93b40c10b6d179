//! Promise: a run leaves a report that stands alone, shows the run's own numbers, and can be restored from the log.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Output;
use std::sync::OnceLock;

use crate::common::{CHUNK, adagio, browser, copy, package_file, records_of, report, stderr, stdout};
use adagio::log::messages::{Image, Odometry, Point, Pose, PoseWithCovariance};
use adagio::log::{Message, cdr};
use roxmltree::Document;
use serde_json::Value;

/// Drawings of a run of the smoke scenario, which has two tasks.
fn expected() -> Vec<String> {
    let mut names: Vec<String> = [
        "way",
        "success",
        "quality",
        "slowness-over-frames",
        "slowness",
        "preparation",
        "dictionary",
        "members",
        "latency",
        "queues",
        "speed",
        "memory",
    ]
    .map(str::to_owned)
    .into();
    for task in ["1-centre", "2-corner"] {
        names.extend(["room", "values", "greedy", "starts", "trajectories"].map(|what| format!("{what}-{task}")));
    }
    names.extend((1..=12).map(|number| format!("feature-{number:02}")));
    names.sort();
    names
}

/// One run of the smoke scenario for all tests, which leave it as it is.
fn run() -> &'static Path {
    static RUN: OnceLock<(tempfile::TempDir, PathBuf)> = OnceLock::new();
    &RUN.get_or_init(|| {
        let folder = tempfile::tempdir().unwrap();
        let scenario = package_file("scenarios/smoke.toml");
        let output = adagio(folder.path(), &["run", scenario.to_str().unwrap(), "--quiet", "--out", "run"]);
        assert!(output.status.success(), "{}", stderr(&output));
        let run = folder.path().join("run");
        (folder, run)
    })
    .1
}

fn page(folder: &Path) -> String {
    fs::read_to_string(folder.join("report.html")).unwrap()
}

/// The names of the files of a kind in a report's folder of drawings.
fn plots(folder: &Path, kind: &str) -> Vec<String> {
    let files = fs::read_dir(folder.join("report")).unwrap().map(|entry| entry.unwrap().path());
    let of_kind = files.filter(|path| path.extension().is_some_and(|extension| extension == kind));
    let mut names: Vec<String> = of_kind.map(|path| path.file_stem().unwrap().to_str().unwrap().to_owned()).collect();
    names.sort();
    names
}

/// The judgement at the top of a page.
fn verdict(html: &str) -> &str {
    let start = html.find("<div class=\"verdict").unwrap();
    &html[start..start + html[start..].find("</div>").unwrap()]
}

/// Run `adagio report` and return its answer as JSON, whatever its exit code, which is checked.
fn reported(folder: &Path, arguments: &[&str], code: i32) -> (Value, Output) {
    let mut all = vec!["report", "--json"];
    all.extend(arguments);
    let output = adagio(folder, &all);
    assert_eq!(output.status.code(), Some(code), "{}", stderr(&output));
    (serde_json::from_slice(&output.stdout).unwrap(), output)
}

#[test]
fn a_run_leaves_every_drawing_as_svg_and_png() {
    let run = run();
    assert_eq!(plots(run, "svg"), expected());
    assert_eq!(plots(run, "png"), expected());
    for name in expected() {
        let svg = fs::read_to_string(run.join("report").join(format!("{name}.svg"))).unwrap();
        let document = Document::parse(&svg).unwrap_or_else(|error| panic!("{name}: {error}"));
        let size = |side| document.root_element().attribute(side).unwrap().parse::<u32>().unwrap();
        assert!(document.descendants().filter(|node| node.is_element()).count() > 10, "{name} is empty");
        for image in document.descendants().filter(|node| node.has_tag_name("image")) {
            assert!(image.attribute("href").unwrap().starts_with("data:image/png;base64,"), "{name}");
        }
        let png = fs::read(run.join("report").join(format!("{name}.png"))).unwrap();
        let pixels = image::load_from_memory_with_format(&png, image::ImageFormat::Png).unwrap().to_rgb8();
        assert_eq!(pixels.dimensions(), (2 * size("width"), 2 * size("height")), "{name}");
        // The title, in the upper left corner, has letters: the font is there.
        let dark =
            (0..400).flat_map(|x| (0..60).map(move |y| (x, y))).filter(|&(x, y)| pixels[(x, y)].0[0] < 90).count();
        assert!(dark > 100, "{name}: {dark} dark pixels where its title should be");
    }
}

#[test]
fn the_page_stands_alone_and_has_all_drawings() {
    let html = page(run());
    assert!(html.len() < 5_000_000, "{} bytes", html.len());
    for name in expected() {
        assert_eq!(html.matches(&format!("<figure id=\"{name}\">")).count(), 1, "{name}");
    }
    // The only addresses are names of namespaces and data inside of the page.
    assert_eq!(html.matches("http").count(), html.matches("xmlns=\"http://www.w3.org/").count());
    for loads in ["<script", "src=", "url(", "@import", "<iframe"] {
        assert!(!html.contains(loads), "{loads} in the page");
    }
    let inside = html.matches("href=").count();
    let allowed = ["href=\"#", "href=\"data:"].map(|start| html.matches(start).count());
    assert_eq!(inside, allowed.iter().sum::<usize>());
}

#[test]
fn its_numbers_are_those_of_report_json() {
    let (html, json) = (page(run()), report(run()));
    let said = verdict(&html);
    for task in json["tasks"].as_array().unwrap() {
        let number = |key: &str| task[key].as_f64().unwrap();
        let name = task["name"].as_str().unwrap();
        let share = format!("{:.1} % of the starts reach {name}", 100.0 * number("success"));
        assert!(said.contains(&share), "{share}: {said}");
        let arrived = (number("success") * number("starts")).round();
        let low = 100.0 * number("success_wilson_low");
        let counts = format!("{name}: {arrived} of {} random starts", task["starts"]);
        assert!(said.contains(&counts) && said.contains(&format!("at least {low:.1} %")), "{counts}: {said}");
        if number("success") > 0.0 {
            let quality = format!("Quality {:.3}", number("convergence_quality"));
            let steps =
                format!("after {:.2} actions where {:.2} would", number("mean_steps"), number("optimal_mean_steps"));
            assert!(said.contains(&quality) && said.contains(&steps), "{quality}, {steps}: {said}");
        }
        // As many crosses at starts as starts that failed: each is two lines.
        let number = if name == "centre" { 1 } else { 2 };
        let svg = fs::read_to_string(run().join(format!("report/starts-{number}-{name}.svg"))).unwrap();
        let failed = task["starts"].as_f64().unwrap() - arrived;
        assert!(svg.contains(&format!("failed: {failed}")), "{name}: failed: {failed}");
    }
    let frames = json["run"]["frames"].as_u64().unwrap();
    assert_eq!(frames, 2001);
    assert!(said.contains("saw 2 001 frames") && said.contains("drove 400 actions"), "{said}");
    assert!(said.contains("300 of them as support vectors") && said.contains("Nothing was dropped or lost"), "{said}");
    assert!(html.contains(json["digest"].as_str().unwrap()));
    let slowness = json["model"]["slowness"][0].as_f64().unwrap();
    assert!(html.contains(&format!("Slowness {slowness:.3} /s²")));
}

#[test]
fn the_log_alone_gives_the_same_report_in_another_folder() {
    let folder = tempfile::tempdir().unwrap();
    fs::copy(run().join("run_000.mcap"), folder.path().join("moved.mcap")).unwrap();
    let (told, output) = reported(folder.path(), &["moved.mcap"], 0);
    let made = folder.path().join("moved-report");
    assert_eq!(verdict(&page(&made)), verdict(&page(run())));
    assert_eq!(plots(&made, "svg"), expected());
    for name in expected() {
        let svg = |folder: &Path| fs::read(folder.join("report").join(format!("{name}.svg"))).unwrap();
        assert!(svg(&made) == svg(run()), "{name} is another drawing");
    }
    assert_eq!(told["missing"].as_array().unwrap().len(), 0);
    assert_eq!(told["plots"].as_array().unwrap().len(), expected().len());
    // Long work says what it is doing.
    for step in ["reading the log", "looking around", "trying 8 starts", "drawings in"] {
        assert!(stderr(&output).contains(step), "{step}: {}", stderr(&output));
    }
    let quiet = adagio(folder.path(), &["report", "moved.mcap", "--quiet", "--out", "quiet"]);
    assert_eq!(stderr(&quiet), "");
    assert!(stdout(&quiet).contains("% of the starts reach centre"), "{}", stdout(&quiet));
}

#[test]
fn nothing_that_exists_is_overwritten() {
    let folder = tempfile::tempdir().unwrap();
    let run = folder.path().join("run");
    fs::create_dir(&run).unwrap();
    for name in ["run_000.mcap", "checkpoint.safetensors", "report.json"] {
        fs::copy(self::run().join(name), run.join(name)).unwrap();
    }
    let before: BTreeMap<PathBuf, Vec<u8>> = files(&run);
    for place in ["run/report.html", "run/report-2/report.html", "run/report-3/report.html"] {
        let (told, _) = reported(folder.path(), &["run"], 0);
        assert_eq!(told["report"], place);
    }
    let after = files(&run);
    for (path, bytes) in &before {
        assert!(after[path] == *bytes, "{} has changed", path.display());
    }
    fs::create_dir(folder.path().join("mine")).unwrap();
    fs::write(folder.path().join("mine/report.html"), "mine").unwrap();
    let output = adagio(folder.path(), &["report", "run", "--out", "mine"]);
    assert_eq!(output.status.code(), Some(2));
    assert!(stderr(&output).contains("exists already"), "{}", stderr(&output));
    assert_eq!(fs::read_to_string(folder.path().join("mine/report.html")).unwrap(), "mine");
}

fn files(folder: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    let paths = fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path());
    paths.filter(|path| path.is_file()).map(|path| (path.clone(), fs::read(path).unwrap())).collect()
}

#[test]
fn a_run_that_goes_on_replaces_its_own_report_and_no_other_page() {
    let folder = tempfile::tempdir().unwrap();
    for (name, ours) in [("own", true), ("other", false)] {
        let run = folder.path().join(name);
        copy(self::run(), &run);
        // As if it had been killed before its end: the last file is cut, and there is no report.json.
        fs::remove_file(run.join("report.json")).unwrap();
        let log = fs::read(run.join("run_000.mcap")).unwrap();
        let chunks: Vec<_> = records_of(&log).into_iter().filter(|record| record.1 == CHUNK).collect();
        fs::write(run.join("run_000.mcap"), &log[..chunks[chunks.len() / 2].0]).unwrap();
        let mut old = page(&run);
        if !ours {
            old = "<html>mine</html>".to_owned();
        }
        old.push_str("<!-- old -->");
        fs::write(run.join("report.html"), &old).unwrap();
        let output = adagio(folder.path(), &["resume", name]);
        assert!(output.status.success(), "{}", stderr(&output));
        let now = page(&run);
        assert_eq!(now.contains("<!-- old -->"), !ours, "{name}");
        assert_eq!(stderr(&output).contains("is not a report of this program"), !ours, "{}", stderr(&output));
    }
}

#[test]
fn of_a_damaged_log_it_shows_what_can_be_read_and_says_what_is_missing() {
    let folder = tempfile::tempdir().unwrap();
    let log = fs::read(run().join("run_000.mcap")).unwrap();
    let chunks: Vec<_> = records_of(&log).into_iter().filter(|record| record.1 == CHUNK).collect();

    // A chunk with wrong bytes, in the middle; the log is closed.
    let mut broken = log.clone();
    let (start, _, length) = chunks[chunks.len() / 2];
    broken[start + 9 + length / 2] ^= 0x55;
    fs::write(folder.path().join("broken.mcap"), &broken).unwrap();
    let (told, output) = reported(folder.path(), &["broken.mcap"], 3);
    assert!(stderr(&output).contains("could not be read"), "{}", stderr(&output));
    assert!(told["damaged"].as_u64().unwrap() > 0 && told["closed"] == true, "{told}");
    let html = page(&folder.path().join("broken-report"));
    assert!(verdict(&html).contains("records of the log could not be read"), "{}", verdict(&html));
    assert!(html.contains("What was dropped or degraded") && html.contains("damaged records"));
    assert_eq!(plots(&folder.path().join("broken-report"), "svg"), expected());

    // Cut in the middle: no checkpoint may be left, and the report says so.
    fs::write(folder.path().join("cut.mcap"), &log[..chunks[chunks.len() / 5].0 + 100]).unwrap();
    let (told, output) = reported(folder.path(), &["cut.mcap"], 3);
    assert!(stderr(&output).contains("the log was not closed"), "{}", stderr(&output));
    assert_eq!(told["closed"], false);
    let made = folder.path().join("cut-report");
    assert!(page(&made).contains("holds no checkpoint") || page(&made).contains("of the starts reach"));
    assert!(plots(&made, "svg").contains(&"way".to_owned()));

    // Nothing at all.
    fs::write(folder.path().join("none.mcap"), [7u8; 3000]).unwrap();
    let output = adagio(folder.path(), &["report", "none.mcap"]);
    assert_eq!(output.status.code(), Some(1), "{}", stderr(&output));
    assert!(!folder.path().join("none-report").exists());
}

#[test]
fn a_run_from_a_room_that_is_not_simulated_shows_its_features_where_it_was() {
    let folder = tempfile::tempdir().unwrap();
    let run = run().to_str().unwrap();
    let arguments = ["replay", run, "--set", "slow.features=40", "--no-evaluate", "--quiet", "--out", "elsewhere"];
    let output = adagio(folder.path(), &arguments);
    assert!(output.status.success(), "{}", stderr(&output));
    let made = folder.path().join("elsewhere");
    let html = page(&made);
    assert!(verdict(&html).contains("was not tried out"), "{}", verdict(&html));
    let names = plots(&made, "svg");
    for name in ["way", "feature-01", "slowness", "preparation", "dictionary", "members"] {
        assert!(names.contains(&name.to_owned()), "{name} of {names:?}");
    }
    assert!(!names.iter().any(|name| name.starts_with("room-") || name.starts_with("trajectories-")), "{names:?}");
    // The log alone says the same.
    fs::copy(made.join("run_000.mcap"), folder.path().join("alone.mcap")).unwrap();
    let (told, _) = reported(folder.path(), &["alone.mcap"], 0);
    assert_eq!(plots(&folder.path().join("alone-report"), "svg"), names);
    let missing = told["missing"].to_string();
    assert!(missing.contains("is not simulated"), "{missing}");
}

/// A bag of another program: a camera and odometry, under names of their own.
fn write_bag(path: &Path) {
    let mut file = fs::File::create(path).unwrap();
    let mut writer = mcap::WriteOptions::new().profile("ros2").create(&mut file).unwrap();
    let mut channel = |topic: &str, kind: &str, definition: &str| {
        let schema = writer.add_schema(kind, "ros2msg", definition.as_bytes()).unwrap();
        writer.add_channel(schema, topic, "cdr", &BTreeMap::new()).unwrap()
    };
    let camera = channel("/front/<image>", Image::TYPE, &Image::DEFINITION.concat());
    let odometry = channel("/odom", Odometry::TYPE, &Odometry::DEFINITION.concat());
    for i in 0..50u32 {
        let image = Image {
            height: 6,
            width: 8,
            encoding: "rgb8".into(),
            step: 24,
            data: (0..144u32).map(|byte| (byte + 5 * i) as u8).collect(),
            ..Image::default()
        };
        let pose = Pose { position: Point { x: 0.05 * f64::from(i), y: 1.0, z: 0.0 }, ..Pose::planar(0.0, 0.0, 0.3) };
        let moved = Odometry { pose: PoseWithCovariance { pose, ..Default::default() }, ..Default::default() };
        for (channel, body) in [(camera, cdr::encode(&image).unwrap()), (odometry, cdr::encode(&moved).unwrap())] {
            let stamp = 1_000_000_000 + u64::from(i) * 200_000_000;
            let header =
                mcap::records::MessageHeader { channel_id: channel, sequence: i, log_time: stamp, publish_time: stamp };
            writer.write_to_known_channel(&header, &body).unwrap();
        }
    }
    writer.finish().unwrap();
}

#[test]
fn of_another_programs_log_it_shows_what_there_is_and_says_what_is_missing() {
    let folder = tempfile::tempdir().unwrap();
    write_bag(&folder.path().join("bag.mcap"));
    let (told, _) = reported(folder.path(), &["bag.mcap"], 0);
    let made = folder.path().join("bag-report");
    assert_eq!(plots(&made, "svg"), ["camera", "way"]);
    let html = page(&made);
    assert!(verdict(&html).contains("A log of another program"), "{}", verdict(&html));
    assert!(html.contains("/front/&lt;image&gt;") && !html.contains("/front/<image>"));
    assert!(html.contains("All 50 poses of the log"), "the odometry's poses are the way");
    let missing = told["missing"].to_string();
    for what in ["value function", "trials", "success", "slowness", "dictionary", "/adagio/health"] {
        assert!(missing.contains(what), "{what}: {missing}");
    }
    let camera = fs::read_to_string(made.join("report/camera.svg")).unwrap();
    let images = Document::parse(&camera).unwrap().descendants().filter(|node| node.has_tag_name("image")).count();
    assert!((2..=4).contains(&images), "{images} images");
}

/// In headless Chromium: no message, nothing loaded, every drawing is there, nothing is wider than a phone.
#[test]
fn a_browser_opens_the_page_without_errors_on_a_phone_and_a_desk() {
    let page = run().join("report.html");
    let Some(seen) = browser("check_report.mjs", &[page.to_str().unwrap()]) else { return };
    assert_eq!(seen["console"].as_array().unwrap().len(), 0, "{}", seen["console"]);
    assert_eq!(seen["errors"].as_array().unwrap().len(), 0, "{}", seen["errors"]);
    let views = seen["views"].as_array().unwrap();
    assert_eq!(views.len(), 4);
    for request in seen["requests"].as_array().unwrap() {
        assert!(request.as_str().unwrap().ends_with("report.html"), "{request} was loaded");
    }
    for view in views {
        let width = view["width"].as_f64().unwrap();
        assert_eq!(view["overflow"], 0, "at {width} pixels the page is wider than the window");
        assert!(view["letters"].as_f64().unwrap() >= 16.0);
        let figures = view["figures"].as_object().unwrap();
        let mut names: Vec<&String> = figures.keys().collect();
        names.sort();
        assert_eq!(names, expected().iter().collect::<Vec<_>>());
        for (name, figure) in figures {
            let number = |key: &str| figure[key].as_f64().unwrap();
            assert!(
                number("width") > 0.75 * width.min(500.0) && number("height") > 80.0,
                "{name} at {width}: {figure}"
            );
            assert!(number("broken") == 0.0 && number("parts") > 8.0, "{name} at {width}: {figure}");
        }
    }
    assert_ne!(views[0]["paper"], views[1]["paper"], "the page is dark where people want it dark");
}
