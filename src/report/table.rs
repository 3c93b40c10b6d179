//! The report as a table that a person can read.

use std::fmt::Write as _;

use super::Report;
use crate::evaluate::{PoseDecode, TaskResult};
use crate::source::ImportReport;

/// A whole number in groups of three digits.
pub struct Numbered(pub u64);

impl std::fmt::Display for Numbered {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let digits = self.0.to_string();
        let mut text = String::new();
        for (i, digit) in digits.chars().enumerate() {
            if i > 0 && (digits.len() - i).is_multiple_of(3) {
                text.push(' ');
            }
            text.push(digit);
        }
        f.pad(&text)
    }
}

/// The whole report.
pub fn table(report: &Report) -> String {
    let mut text = String::new();
    let run = &report.run;
    let _ = writeln!(
        text,
        "{}, seed {}: {} actions, {} frames in {:.0} s ({:.0} frames/s)",
        report.scenario.name,
        report.scenario.seed,
        Numbered(run.actions),
        Numbered(run.frames),
        run.seconds,
        run.frames_per_second
    );
    if let Some(imported) = &report.imported {
        text.push_str(&imported_lines(imported));
    }
    match (&report.dictionary, &report.model) {
        (Some(dictionary), Some(model)) => {
            let _ = writeln!(
                text,
                "{} support vectors (sigma {:.0}, {}), model {}: {} features, slowness {:.3} to {:.1} /s²",
                Numbered(dictionary.support_vectors as u64),
                dictionary.sigma,
                dictionary.nu.map_or("at random".to_owned(), |nu| format!("nu {}", three_digits(nu))),
                model.epoch,
                model.features,
                model.slowness.first().copied().unwrap_or(f64::NAN),
                model.slowness.last().copied().unwrap_or(f64::NAN),
            );
        }
        _ => text.push_str("no model was made\n"),
    }
    let computed = [("pictures", &report.computed_by.pictures), ("kernel values", &report.computed_by.kernel_values)];
    for (what, by) in computed {
        if let Some(by) = by.as_ref().filter(|by| by.gpu.is_some()) {
            let _ = writeln!(text, "{what} {by}");
        }
    }
    if let Some(reason) = &run.without_model {
        let _ = writeln!(text, "the newest model could not be made: {reason}");
    }
    for pursuit in &report.pursuits {
        if pursuit.ended > 0 {
            let _ = writeln!(
                text,
                "while driving, {} of {} pursuits reached {}",
                pursuit.reached, pursuit.ended, pursuit.task
            );
        }
    }
    if !report.tasks.is_empty() {
        text.push('\n');
        text.push_str(&tasks_table(&report.tasks, report.pose_decode.as_ref()));
    }
    let timing = &report.timing_ms;
    let _ = writeln!(
        text,
        "\nact {:.2} ms (p99 {:.2}), {:.2} ms a frame, re-solve {:.0} ms (max {:.0}), refit {:.0} ms (max {:.0})",
        timing.act_p50,
        timing.act_p99,
        timing.frame_mean,
        timing.resolve_p50,
        timing.resolve_max,
        timing.refit_p50,
        timing.refit_max
    );
    let _ = writeln!(
        text,
        "log {:.1} MB in {} messages, {:.1} % of the time; {}{}peak memory {}",
        report.log.bytes as f64 / 1e6,
        Numbered(report.log.messages),
        100.0 * report.log.busy_seconds / run.seconds,
        counted(run.dropped_frames, "frames dropped; "),
        counted(run.quarantined_frames, "frames left out, not finite; "),
        report.memory.peak_rss_bytes.map_or("unknown".to_owned(), |bytes| format!("{:.0} MB", bytes as f64 / 1e6)),
    );
    if let Some(digest) = &report.digest {
        let _ = writeln!(text, "digest {digest}");
    }
    text
}

/// What came of another program's log: what was found, and what was left out.
fn imported_lines(imported: &ImportReport) -> String {
    let counts = imported.actions.iter().zip(&imported.action_names);
    let actions: Vec<String> = counts.map(|(&count, name)| format!("{} × {name}", Numbered(count))).collect();
    let mut text = format!(
        "of {} images {} frames; cut into {}; {} blocked\n",
        Numbered(imported.images),
        Numbered(imported.frames),
        actions.join(", "),
        Numbered(imported.blocked),
    );
    for (count, what) in [
        (imported.without_action, "images left out: the robot did nothing then that is an action"),
        (imported.gaps, "breaks between images"),
        (imported.jumps, "jumps of the pose"),
        (imported.without_pose, "images left out: no pose before and after them"),
        (imported.out_of_order, "images left out: not later than the one before"),
        (imported.unusable_images, "images left out: they could not be read"),
        (imported.unknown_marks, "marks of what is not shown"),
        (imported.damaged, "other messages or records could not be read"),
    ] {
        if count > 0 {
            let _ = writeln!(text, "  {} {what}", Numbered(count));
        }
    }
    if let Some(reason) = &imported.first_unusable {
        let _ = writeln!(text, "  the first image that could not be read: {reason}");
    }
    if let Some(reason) = &imported.first_unknown_mark {
        let _ = writeln!(text, "  the first mark of what is not shown: {reason}");
    }
    text
}

/// Results of the tasks, and the decoding of the pose.
pub fn tasks_table(tasks: &[TaskResult], pose: Option<&PoseDecode>) -> String {
    let mut text = String::from(
        "task        starts  success  (at least)  steps  expected  optimal  extra  quality  reference  dithers/1000  | alone: success  quality\n",
    );
    let number = |value: Option<f64>, digits: usize| value.map_or("-".to_owned(), |value| format!("{value:.digits$}"));
    for task in tasks {
        let alone = task.without_reflexes.as_ref();
        let _ = writeln!(
            text,
            "{:<11} {:>6}  {:>6.1}%  {:>9.1}%  {:>5}  {:>8}  {:>7.2}  {:>5}  {:>7.3}  {:>8.1}%  {:>12.1}  | {:>13}%  {:>7}",
            task.name,
            task.starts,
            100.0 * task.success,
            100.0 * task.success_wilson_low,
            number(task.mean_steps, 2),
            number(task.expected_steps, 2),
            task.optimal_mean_steps,
            number(task.extra_steps, 2),
            task.convergence_quality,
            100.0 * task.reference_success,
            task.dithers_per_1000,
            number(alone.map(|alone| 100.0 * alone.success), 1),
            number(alone.map(|alone| alone.convergence_quality), 3),
        );
    }
    for (task, arrival) in tasks.iter().filter_map(|task| Some((task, task.arrival.as_ref()?))) {
        let name = &task.name;
        let _ = match (arrival.distance_p50_m, arrival.distance_p99_m) {
            (Some(half), Some(nearly)) => writeln!(
                text,
                "{name} was shown: {} of {} trials end where the agent says so, {:.1} % of them elsewhere; {half:.2} m from the \
                 shown place in the median, {nearly:.2} m for 99 of 100",
                arrival.declared,
                task.starts,
                100.0 * arrival.false_rate,
            ),
            _ if task.starts == 0 => writeln!(text, "{name} was not shown yet, or nobody knows where: no trials"),
            _ => writeln!(text, "{name} was shown, and the agent never says that it is there"),
        };
    }
    for (task, avoided) in tasks.iter().filter_map(|task| Some((task, task.avoided.as_ref()?))) {
        let without = avoided
            .entries_without
            .map_or(String::new(), |without| format!(", {without} if nothing was to be avoided"));
        let _ = writeln!(
            text,
            "on the way to {}: {} actions led into what is to be avoided{without}; {} times the steps of the shortest way around",
            task.name,
            avoided.entries,
            number(avoided.detour, 2),
        );
    }
    if let Some(pose) = pose {
        let _ = writeln!(
            text,
            "pose read off the features: linear within {:.3} m and {:.1}°, by a kernel within {:.3} m and {:.1}° (root mean square)",
            pose.linear.position_rmse_m,
            pose.linear.heading_rmse_deg,
            pose.kernel.position_rmse_m,
            pose.kernel.heading_rmse_deg
        );
    }
    text
}

/// A positive number to three significant digits.
fn three_digits(value: f64) -> f64 {
    let scale = 10f64.powi(2 - value.log10().floor() as i32);
    (value * scale).round() / scale
}

/// A count with what it counts; nothing where there is none.
fn counted(count: u64, what: &str) -> String {
    if count > 0 { format!("{count} {what}") } else { String::new() }
}
