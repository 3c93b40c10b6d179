//! What a stranger wants to know first: did it learn, how well, and where does it fail?

use super::Numbered;
use super::figures::Material;
use crate::evaluate::{TaskResult, Trip};
use crate::robot::Pose;

/// A judgement in words.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Verdict {
    /// `good`, `fair`, `bad`, or nothing where there is nothing to judge.
    pub class: &'static str,
    /// The answer in one sentence.
    pub headline: String,
    /// What it rests on.
    pub sentences: Vec<String>,
}

/// From this share of arrivals on, a task counts as learned, and as learned in part.
const LEARNED: f64 = 0.95;
const IN_PART: f64 = 0.5;

/// The judgement of a run or log.
pub fn verdict(material: &Material<'_>) -> Verdict {
    let gathered = material.gathered;
    let mut verdict = match (&material.trials, &material.learned) {
        (Ok(trials), Ok(_)) if !trials.is_empty() => tried(material, trials),
        (_, Ok(learned)) => {
            let reason = material.trials.as_ref().err().cloned().unwrap_or("there are no tasks".to_owned());
            Verdict {
                class: "",
                headline: "It learned features and policies, but how good they are was not tried out.".to_owned(),
                sentences: vec![
                    format!("Not tried out: {reason}."),
                    format!("Model {} has {} slow features.", learned.epoch, learned.model.slowness.len()),
                ],
            }
        }
        (_, Err(reason)) if gathered.is_own() => Verdict {
            class: "bad",
            headline: "No, it did not learn: there is no model.".to_owned(),
            sentences: vec![format!("Why: {reason}.")],
        },
        (_, Err(_)) => Verdict {
            class: "",
            headline: "A log of another program: nothing was learned in it yet.".to_owned(),
            sentences: vec![
                "Learn from it with `adagio replay LOG --scenario FILE`, and report on that run.".to_owned(),
            ],
        },
    };
    verdict.sentences.push(basis(material));
    if material.gathered.is_own() {
        verdict.sentences.push(lost(material));
    }
    verdict
}

fn tried(material: &Material<'_>, trials: &[(TaskResult, Vec<Trip>)]) -> Verdict {
    let lowest = trials.iter().map(|(result, _)| result.success).fold(f64::INFINITY, f64::min);
    let (class, answer) = match lowest {
        LEARNED.. => ("good", "Yes, it learned"),
        IN_PART.. => ("fair", "It learned in part"),
        _ => ("bad", "No, it did not learn all of its tasks"),
    };
    let shares: Vec<String> = trials
        .iter()
        .map(|(result, _)| format!("{:.1} % of the starts reach {}", 100.0 * result.success, result.name))
        .collect();
    let mut sentences: Vec<String> = trials.iter().map(|(result, _)| how_well(result)).collect();
    sentences.push(failures(material, trials));
    if let Some(pose) = &material.pose_decode {
        sentences.push(format!(
            "Its features tell where it is within {:.2} m and where it looks within {:.1}° (root mean square, read off by a \
             kernel).",
            pose.kernel.position_rmse_m, pose.kernel.heading_rmse_deg
        ));
    }
    Verdict { class, headline: format!("{answer}: {}.", shares.join(", ")), sentences }
}

fn how_well(result: &TaskResult) -> String {
    let arrived = (result.success * result.starts as f64).round() as u64;
    let mut text = format!(
        "{}: {} of {} random starts that it had never seen arrive (with 95 % confidence at least {:.1} %)",
        result.name,
        Numbered(arrived),
        Numbered(result.starts as u64),
        100.0 * result.success_wilson_low
    );
    if let (Some(steps), Some(extra)) = (result.mean_steps, result.extra_steps) {
        text += &format!(
            ", after {steps:.2} actions where {:.2} would be the fewest: {extra:.2} too many. Quality {:.3} (1: optimal)",
            result.optimal_mean_steps, result.convergence_quality
        );
    }
    text += &format!(". The hand-made policy that knows the pose: {:.1} %", 100.0 * result.reference_success);
    if let Some(alone) = &result.without_reflexes {
        text += &format!("; without its reflexes: {:.1} %", 100.0 * alone.success);
    }
    text + "."
}

fn failures(material: &Material<'_>, trials: &[(TaskResult, Vec<Trip>)]) -> String {
    let place = |pose: &Pose| {
        let (at, heading) = (pose.position, pose.heading.to_degrees());
        format!("x {:.2} m, y {:.2} m, heading {heading:.0}°", at.x, at.y)
    };
    let failed = |(result, ways): &(TaskResult, Vec<Trip>)| {
        let starts: Vec<Pose> = ways.iter().filter(|way| !way.arrived).map(|way| way.poses[0]).collect();
        let first = starts.first()?;
        Some(match starts.len() {
            1 => format!("It fails from one start of {}: {}.", result.name, place(first)),
            n => format!(
                "It fails from {n} starts of {}{}, such as {}.",
                result.name,
                region(material, &starts).map_or(String::new(), |region| format!(", {region}")),
                place(first)
            ),
        })
    };
    let told: Vec<String> = trials.iter().filter_map(failed).collect();
    if !told.is_empty() {
        return told.join(" ");
    }
    let all = trials.iter().flat_map(|(result, ways)| ways.iter().map(move |way| (result, way)));
    match all.max_by_key(|(_, way)| way.extra()) {
        Some((result, way)) if way.extra() > Some(0) => format!(
            "No start failed. The longest detour: to {} from {}, {} actions where {} would do.",
            result.name,
            place(&way.poses[0]),
            way.steps(),
            way.optimal.unwrap_or(0)
        ),
        _ => "No start failed.".to_owned(),
    }
}

/// In which ninth of the room most of some starts are, if that is so.
fn region(material: &Material<'_>, starts: &[Pose]) -> Option<String> {
    let (low, high) = material.room.as_ref()?.world.plan.reachable_box();
    let third = |value: f64, low: f64, high: f64| ((3.0 * (value - low) / (high - low)) as usize).min(2);
    let mut counts = [[0usize; 3]; 3];
    for start in starts {
        counts[third(start.position.y, low.y, high.y)][third(start.position.x, low.x, high.x)] += 1;
    }
    let (mut most, mut at) = (0, (0, 0));
    for (j, row) in counts.iter().enumerate() {
        for (i, &count) in row.iter().enumerate() {
            if count > most {
                (most, at) = (count, (j, i));
            }
        }
    }
    let rows = ["bottom", "middle", "top"];
    let columns = ["left", "centre", "right"];
    (2 * most > starts.len()).then(|| format!("{most} of them in the {} {} of the room", rows[at.0], columns[at.1]))
}

/// What it learned from.
fn basis(material: &Material<'_>) -> String {
    let gathered = material.gathered;
    let minutes = gathered.seconds() / 60.0;
    if !gathered.is_own() {
        return format!("The log is {minutes:.1} minutes long, in {} files.", gathered.files);
    }
    let mut text = format!(
        "It drove {} actions in {minutes:.0} minutes by the log's clock and saw {} frames",
        Numbered(gathered.actions),
        Numbered(gathered.frames)
    );
    if let Some((_, size)) = gathered.growth.iter().last() {
        text += &format!("; it remembers {} of them as support vectors", Numbered(u64::from(*size)));
    }
    text + "."
}

/// Whether something was lost, in one sentence; the section at the end has the rest.
fn lost(material: &Material<'_>) -> String {
    let gathered = material.gathered;
    let counts = [
        (gathered.dropped, "frames were dropped"),
        (gathered.quarantined, "frames were left out, not finite"),
        (gathered.damaged, "records of the log could not be read"),
        (gathered.missing(), "observations are missing in the log"),
    ];
    let lost = counts.into_iter().filter(|(count, _)| *count > 0);
    let mut parts: Vec<String> = lost.map(|(count, what)| format!("{} {what}", Numbered(count))).collect();
    parts.extend((!gathered.closed).then(|| "the log was not closed".to_owned()));
    if parts.is_empty() {
        return "Nothing was dropped or lost.".to_owned();
    }
    format!("Lost: {}.", parts.join(", "))
}
