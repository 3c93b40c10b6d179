//! Live progress of a run on stderr: a bar on a terminal, plain lines elsewhere.

use std::io::IsTerminal;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};

use crate::agent::{Status, StatusValues};
use crate::report::Numbered;

/// Time between plain lines.
const LINE_INTERVAL: Duration = Duration::from_secs(5);

/// Time between updates of the bar, and between looks at whether the run is over.
const LOOK_INTERVAL: Duration = Duration::from_millis(100);

/// Show progress until `over` is set.
pub fn show(status: &Status, actions: u64, over: &AtomicBool) {
    let terminal = std::io::stderr().is_terminal();
    let bar = ProgressBar::with_draw_target(Some(actions), ProgressDrawTarget::stderr());
    if let Ok(style) = ProgressStyle::with_template("{wide_bar} {pos}/{len} actions, {eta} left\n{msg}") {
        bar.set_style(style);
    }
    let begin = Instant::now();
    let mut last_line = begin;
    while !over.load(Ordering::Relaxed) {
        std::thread::sleep(LOOK_INTERVAL);
        let now = status.now();
        let rate = now.frames as f64 / begin.elapsed().as_secs_f64();
        if terminal {
            bar.set_position(now.actions as u64);
            bar.set_message(line(&now, rate));
        } else if last_line.elapsed() >= LINE_INTERVAL {
            last_line = Instant::now();
            let done = now.actions as f64 / actions as f64;
            let left = begin.elapsed().as_secs_f64() * (1.0 - done) / done.max(1e-9);
            let total = Numbered(actions);
            let left = if now.actions as u64 >= actions {
                "waiting for the last model".to_owned()
            } else {
                format!("{left:.0} s left")
            };
            eprintln!("{} of {total} actions, {left}: {}", Numbered(now.actions as u64), line(&now, rate));
        }
    }
    bar.finish_and_clear();
}

fn line(now: &StatusValues, rate: f64) -> String {
    let mut parts = vec![
        format!("{} frames ({rate:.0}/s)", Numbered(now.frames)),
        format!("{} support vectors", Numbered(now.support_vectors as u64)),
        format!("model {}", now.epoch),
    ];
    if let Some(slowness) = now.slowness_mean {
        parts.push(format!("slowness {slowness:.2}"));
    }
    if let Some(success) = now.success {
        parts.push(format!("success {:.0}%", 100.0 * success));
    }
    if now.pursuits.ended > 0 {
        parts.push(format!("pursuits {}/{}", now.pursuits.reached, now.pursuits.ended));
    }
    let busy: Vec<String> = now
        .queues
        .iter()
        .filter(|queue| queue.1 > 0)
        .map(|(name, depth, most)| format!("{name} {depth}/{most}"))
        .collect();
    if !busy.is_empty() {
        parts.push(format!("queues {}", busy.join(" ")));
    }
    if now.without_model.is_some() {
        parts.push("the newest model could not be made".into());
    }
    parts.join(", ")
}
