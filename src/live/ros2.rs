//! A run on a ROS 2 network: what it does, for ROS's own tools to show, and what they ask of it.

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use super::SetWhenDropped;
use super::ask::goal_move;
use super::serve::ServedRun;
use super::view::{Phase, View, Watcher};
use crate::log::messages::{Point, Pose, Vector3};
use crate::policy::Goto;
use crate::ros2::{Colour, DiagnosticStatus, KeyValue, Marker, Progress, Request, Voice};
use crate::source::parse_goto;

/// Time between two tellings.
const TELL: Duration = Duration::from_secs(1);

/// Longest time that the log is read at a time.
const READ: Duration = Duration::from_millis(100);

/// Time between looks at what is asked.
const LOOK: Duration = Duration::from_millis(50);

/// Side of a cell of the maps of values, metres.
const CELL: f64 = 0.1;

/// Most cells of a map along x and y.
const MOST_CELLS: f64 = 400.0;

/// Tell the network about a run while some work is done: the run.
pub fn beside<R>(voice: Voice, stage: &ServedRun<'_>, work: impl FnOnce() -> R) -> R {
    let over = AtomicBool::new(false);
    std::thread::scope(|scope| {
        scope.spawn(|| {
            let mut teller =
                Teller { voice, stage, arrivals: stage.controls.arrivals(), said: Vec::new(), values: BTreeMap::new() };
            teller.go_on(&over);
        });
        // Also if the run panics: this scope ends with that thread.
        let _over = SetWhenDropped(&over);
        work()
    })
}

struct Teller<'a> {
    voice: Voice,
    stage: &'a ServedRun<'a>,
    /// How often the robot had been where somebody sent it when it was last sent.
    arrivals: u64,
    /// Diagnostics that were told last.
    said: Vec<String>,
    /// For each task, what was found in each cell: the highest value of an action.
    values: BTreeMap<String, BTreeMap<[i64; 2], f64>>,
}

impl Teller<'_> {
    fn go_on(&mut self, over: &AtomicBool) {
        let mut watcher = Watcher::new(self.stage.run);
        while !over.load(Ordering::Relaxed) {
            if let Err(error) = watcher.read_on(READ) {
                eprintln!("warning: the ROS 2 network hears no more of the run: {error}");
                break;
            }
            self.voice.follow();
            self.tell(&watcher.view(Some(self.stage.controls)));
            let told = Instant::now();
            while told.elapsed() < TELL && !over.load(Ordering::Relaxed) {
                while let Some(request) = self.voice.request() {
                    self.heed(request);
                }
                if matches!(self.voice.progress(), Progress::Going(_)) && self.stage.controls.arrivals() > self.arrivals
                {
                    self.voice.tell_progress(Progress::Arrived);
                }
                std::thread::sleep(LOOK);
            }
        }
        for (topic, count) in self.voice.lost() {
            eprintln!("warning: {count} messages of {topic} were not taken in time, or of no use");
        }
    }

    fn heed(&mut self, request: Request) {
        let (controls, scenario) = (self.stage.controls, self.stage.scenario);
        let moved = |task: usize, at: [f64; 2]| {
            let wanted = goal_move(scenario, &self.stage.world.plan, task, at)?;
            controls.move_goal(wanted).map_err(|error| error.to_string())
        };
        let done = match request {
            Request::Pause(paused) => {
                controls.pause(paused);
                Ok(())
            }
            Request::GoOn => {
                controls.pause(false);
                controls.release();
                Ok(())
            }
            Request::Stop => {
                self.stage.stop.store(true, Ordering::Relaxed);
                Ok(())
            }
            Request::Goto(text) => parse_goto(&text, scenario).map(|goto| controls.send(goto)),
            Request::MoveGoal(task, at) => moved(task, at),
            Request::GoalPose(at) => {
                self.arrivals = controls.arrivals();
                let task = scenario.tasks.iter().position(|task| task.needs_pose());
                let task = task.ok_or_else(|| "no task has a goal by coordinates".to_owned());
                let done = task.and_then(|task| moved(task, at).map(|()| controls.send(Goto::Task(task))));
                self.voice.tell_progress(done.clone().map_or_else(Progress::Refused, |()| Progress::Going(None)));
                done
            }
        };
        if let Err(reason) = done {
            self.voice.say(true, &reason);
        }
    }

    fn tell(&mut self, view: &View) {
        if let Some(seen) = &view.observation {
            self.voice.observation(seen.width, seen.height, &seen.rgb);
        }
        self.voice.losses();
        self.voice.diagnostics(parts(view));
        self.voice.markers(markers(view));
        let said = view.health.as_ref().map_or(&[][..], |health| &health.said);
        let told = self.said.last().and_then(|last| said.iter().rposition(|text| text == last)).map_or(0, |at| at + 1);
        said[told..].iter().for_each(|text| self.voice.say(false, text));
        self.said = said.to_vec();
        if let (Progress::Going(_), pose) = (self.voice.progress(), view.pose) {
            self.voice.tell_progress(Progress::Going(pose));
        }
        self.tell_values(view);
    }

    fn tell_values(&mut self, view: &View) {
        let (Some([x, y, _]), Some(decision)) = (view.pose, &view.decision) else { return };
        let worth = decision.q_values.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        if !worth.is_finite() {
            return;
        }
        let cells = self.values.entry(decision.task.clone()).or_default();
        cells.insert([x, y].map(|metres| (metres / CELL).floor() as i64), worth);
        let corner = |of: fn(i64, i64) -> i64, axis: usize| cells.keys().map(|cell| cell[axis]).reduce(of).unwrap_or(0);
        let (low, high) = ([0, 1].map(|axis| corner(i64::min, axis)), [0, 1].map(|axis| corner(i64::max, axis)));
        let [width, height] = [0, 1].map(|axis| high[axis] - low[axis] + 1);
        if (width.max(height)) as f64 > MOST_CELLS {
            return;
        }
        let least = cells.values().copied().fold(f64::INFINITY, f64::min);
        let most = cells.values().copied().fold(f64::NEG_INFINITY, f64::max);
        let share = |worth: &f64| (100.0 * (worth - least) / (most - least).max(f64::MIN_POSITIVE)).round() as i8;
        let places = (0..height).flat_map(|row| (0..width).map(move |column| [low[0] + column, low[1] + row]));
        let data = places.map(|cell| cells.get(&cell).map_or(-1, share)).collect();
        self.voice.values(&decision.task, low.map(|of| of as f64 * CELL), CELL, width as usize, data);
    }
}

/// How the robot, the learning and the program are doing.
fn parts(view: &View) -> Vec<DiagnosticStatus> {
    let part = |name: &str, level: u8, message: String, values: Vec<KeyValue>| DiagnosticStatus {
        level,
        name: name.to_owned(),
        message,
        hardware_id: String::new(),
        values,
    };
    let robot = view.robot.clone().unwrap_or_default();
    let stopped = robot.starts_with("stopped") || robot.starts_with("held");
    let level = if stopped { DiagnosticStatus::WARN } else { DiagnosticStatus::OK };
    let doing = match &view.decision {
        Some(decision) if !decision.task.is_empty() => format!("drives to {}", decision.task),
        _ => "explores".to_owned(),
    };
    let run = match view.phase {
        Phase::Paused => "paused".to_owned(),
        Phase::Silent => "silent".to_owned(),
        _ => doing,
    };
    let mut all = vec![
        part("robot", level, robot, Vec::new()),
        part(
            "run",
            DiagnosticStatus::OK,
            run,
            vec![
                KeyValue::new("actions", view.actions),
                KeyValue::new("frames", view.frame),
                KeyValue::new("model", view.epoch),
                KeyValue::new("support vectors", view.dictionary.as_ref().map_or(0, |dictionary| dictionary.size)),
            ],
        ),
    ];
    if let Some(health) = &view.health {
        let level = if health.dropped > 0 { DiagnosticStatus::WARN } else { DiagnosticStatus::OK };
        let message = health.said.last().cloned().unwrap_or_default();
        let values = vec![
            KeyValue::new("frame to action, 99th percentile, ms", health.act_p99_ms),
            KeyValue::new("memory, MB", health.memory_mb),
            KeyValue::new("frames dropped", health.dropped),
            KeyValue::new("warnings", health.warnings),
        ];
        all.push(part("program", level, message, values));
    }
    all
}

/// Goals with their names, the last part of the way, and where the robot heads.
fn markers(view: &View) -> Vec<Marker> {
    const GOAL: Colour = Colour { r: 0.1, g: 0.6, b: 0.3, a: 0.5 };
    const WAY: Colour = Colour { r: 0.3, g: 0.4, b: 0.9, a: 1.0 };
    const ROBOT: Colour = Colour { r: 0.9, g: 0.4, b: 0.1, a: 1.0 };
    let mut all = Vec::new();
    let size = |x, y, z| Vector3 { x, y, z };
    for task in &view.tasks {
        let Some([x, y]) = task.goal else { continue };
        let pose = Pose::planar(x, y, 0.0);
        let (ns, across) = ("goals".to_owned(), 2.0 * task.radius);
        all.push(Marker {
            ns: ns.clone(),
            kind: Marker::CYLINDER,
            pose: pose.clone(),
            scale: size(across, across, 0.02),
            color: GOAL,
            ..Marker::default()
        });
        let (scale, text) = (size(0.0, 0.0, 0.2), task.name.clone());
        all.push(Marker { ns, kind: Marker::TEXT, pose, scale, color: GOAL, text, ..Marker::default() });
    }
    if view.way.len() > 1 {
        all.push(Marker {
            ns: "way".to_owned(),
            kind: Marker::LINE_STRIP,
            pose: Pose::planar(0.0, 0.0, 0.0),
            scale: size(0.02, 0.0, 0.0),
            color: WAY,
            points: view.way.iter().map(|&[x, y]| Point { x, y, z: 0.0 }).collect(),
            ..Marker::default()
        });
    }
    if let Some([x, y, heading]) = view.pose {
        all.push(Marker {
            ns: "robot".to_owned(),
            kind: Marker::ARROW,
            pose: Pose::planar(x, y, heading),
            scale: size(0.3, 0.05, 0.05),
            color: ROBOT,
            ..Marker::default()
        });
    }
    all
}
