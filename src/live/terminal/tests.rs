//! What the terminal shows of a view that is made up.

use super::super::maps::Maps;
use super::super::picture::Picture;
use super::super::view::{Curve, Curves, DecisionView, FeaturesView, HealthView, Phase, TaskView, WallView};
use super::*;
use std::sync::Arc;

fn view() -> View {
    let corners = [[0.0, 0.0], [3.0, 1.8]];
    let [[x0, y0], [x1, y1]] = corners;
    View {
        title: "made up, seed 3".to_owned(),
        phase: Phase::Running,
        frame: 12_345,
        actions: 2_469,
        planned: Some(15_000),
        seconds: 2_469.0,
        epoch: 4,
        pose: Some([0.6, 0.5, 0.8]),
        way: vec![[2.0, 1.5], [1.0, 0.5], [0.6, 0.5]],
        corners: Some(corners),
        walls: vec![WallView { points: vec![[x0, y0], [x1, y0], [x1, y1], [x0, y1], [x0, y0]], colour: [200, 10, 10] }],
        tasks: vec![TaskView { name: "centre".to_owned(), goal: Some([1.5, 0.9]), radius: 0.2, movable: true }],
        decision: Some(DecisionView {
            number: 2_469,
            action: "left",
            task: "centre".to_owned(),
            q_values: vec![0.1, 0.3, 0.2],
            reflex: true,
            sure: Some(0.934),
            prospect: Some((17.6, 0.873)),
        }),
        camera: Some(Picture { width: 2, height: 2, rgb: vec![0, 0, 0, 0, 0, 0, 255, 255, 255, 255, 255, 255] }),
        observation: None,
        dictionary: None,
        features: FeaturesView {
            epoch: 4,
            series: vec![Curve {
                name: "feature 1".to_owned(),
                points: (0..8).map(|i| (f64::from(i), f64::from(i))).collect(),
            }],
            slowness: vec![0.079],
        },
        health: Some(HealthView {
            frames_per_second: 612.4,
            queues: vec![("frames".to_owned(), 3)],
            ..HealthView::default()
        }),
        curves: Curves {
            success: vec![Curve { name: "centre".to_owned(), points: vec![(1000.0, 0.25), (2000.0, 0.75)] }],
            ..Curves::default()
        },
        maps: Some(Arc::new(Maps {
            epoch: 4,
            columns: 2,
            rows: 1,
            low: [0.2, 0.2],
            high: [2.8, 1.6],
            values: vec![vec![0.1, 0.9]],
            headings: vec![vec![0.0, std::f64::consts::PI]],
            features: vec![vec![-1.0, 1.0]],
        })),
        ..View::default()
    }
}

fn buffer(view: &View, choice: Choice) -> Buffer {
    let mut terminal = Terminal::new(TestBackend::new(110, 40)).unwrap();
    terminal.draw(|frame| draw(frame.buffer_mut(), view, choice)).unwrap().buffer.clone()
}

#[test]
fn every_pane_shows_what_the_view_says() {
    let shown = plain(&view(), (110, 40));
    for text in [
        "made up, seed 3  running  frame 12 345, action 2 469 of 15 000, 2469 s of driving, model 4",
        "policy 4 of centre",
        "success: centre 75%",
        "features of model 4",
        " 1   0.079 ▁▂▃▄▅▆▇█",
        "to centre: left (reflex), about 18 actions to go, 87 % in time, sure of the place by 93 %",
        "612 frames/s",
        "queues: frames 3",
        "not in the log",
        "q leave",
    ] {
        assert!(shown.contains(text), "{text:?} in\n{shown}");
    }
    // Arrows of the left half turn to the right, those of the right half to the left; the robot looks up to the right.
    let arrows = |arrow: char| shown.lines().filter(|line| line.contains(arrow)).count();
    assert!(arrows('→') > 3 && arrows('←') > 3 && shown.contains('◥'), "{shown}");
    let line = shown.lines().find(|line| line.contains('→') && line.contains('←')).unwrap();
    assert!(line.find('→') < line.find('←'), "{line}");
    // The upper half of the camera's image is black, the lower one white.
    assert!(shown.contains("@@@@"), "{shown}");
}

#[test]
fn values_and_pixels_have_colours() {
    let buffer = buffer(&view(), Choice::default());
    let places: Vec<_> = buffer.content.iter().filter(|cell| cell.symbol() == "→").map(|cell| cell.bg).collect();
    let others: Vec<_> = buffer.content.iter().filter(|cell| cell.symbol() == "←").map(|cell| cell.bg).collect();
    assert!(!places.is_empty() && places.iter().all(|bg| *bg == places[0]));
    assert!(others.iter().all(|bg| *bg == others[0]) && places[0] != others[0], "low and high values differ");
    let pixels: Vec<_> = buffer.content.iter().filter(|cell| cell.symbol() == "▀").collect();
    use ratatui::style::Color;
    let is = |cell: &ratatui::buffer::Cell, value: u8| cell.fg == Color::Rgb(value, value, value);
    assert!(pixels.iter().any(|cell| is(cell, 0)) && pixels.iter().any(|cell| is(cell, 255)));
    assert!(buffer.content.iter().any(|cell| cell.symbol() == "█" && cell.fg == Color::Rgb(200, 10, 10)), "walls");
}

#[test]
fn keys_choose_maps_and_leave() {
    let key = |code| wish(KeyEvent::new(code, KeyModifiers::NONE));
    assert_eq!(key(KeyCode::Char('q')), KeyCommand::Leave);
    assert_eq!(wish(KeyEvent::new(KeyCode::Char('c'), KeyModifiers::CONTROL)), KeyCommand::Leave);
    assert_eq!((key(KeyCode::Tab), key(KeyCode::Char('c'))), (KeyCommand::NextMap, KeyCommand::Nothing));
    let second = text(&buffer(&view(), Choice { map: 1, plain: true }));
    assert!(second.contains("feature 1 of model 4") && !second.contains('→'), "{second}");
    assert_eq!(second, text(&buffer(&view(), Choice { map: 3, plain: true })), "after the last the first comes again");
}

#[test]
fn a_terminal_that_is_too_small_says_so_and_an_empty_view_can_be_drawn() {
    assert!(plain(&view(), (60, 20)).contains("60 × 20"));
    for size in [(1, 1), (3, 2), (72, 22), (300, 100)] {
        plain(&View::default(), size);
        plain(&view(), size);
    }
    let empty = plain(&View::default(), (72, 22));
    assert!(empty.contains("no poses in the log yet") && empty.contains("no model yet"), "{empty}");
}
