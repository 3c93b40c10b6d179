//! Faults that no single key shows: values that contradict each other.

use nalgebra::Point2;

use super::change::ChangeKind;
use super::keys::Reader;
use super::plan::{Plan, PlanFault, clearance};
use super::sections::{Body, Detail, Mode, Scenario, WhenBehind};
use crate::robot::Motion;

/// What stands before the name in a mark that takes others back.
pub(crate) const FORGET: &str = "forget ";

/// Report what does not fit together.
pub(super) fn check(s: &Scenario, reader: &mut Reader<'_>) {
    counts(s, reader);
    modes(s, reader);
    changes(s, reader);
    tasks(s, reader);
    shows(s, reader);
    contradictions(s, reader);
    bodies(s, reader);
    rooms(s, reader);
    if s.world.walls.is_empty() {
        if reader.sound(&["world"]) && s.robot.body != Body::Program {
            reader.fault_at(
                "world.wall",
                "is missing: a world needs at least one [[world.wall]] or [[world.room]]".into(),
            );
        }
        return;
    }
    if !reader.sound(&["world.wall", "world.room"]) {
        return;
    }
    match Plan::new(s) {
        Ok(plan) if reader.sound(&["robot.start", "robot.radius"]) => {
            joined(s, &plan, reader);
            outside(s, &plan, reader);
            goals(s, &plan, reader);
        }
        Ok(_) => {}
        Err(fault) => {
            if reader.sound(&["robot.start", "robot.radius"]) {
                place(s, &fault, reader);
            }
            goals_alone(s, reader);
        }
    }
}

/// What only the disc that is where its actions lead can do, and what only a robot with a mass can.
fn bodies(s: &Scenario, reader: &mut Reader<'_>) {
    if s.body.is_none() {
        for number in 0..s.world.movables.len() {
            let text = "is for a robot with a mass: robot.body = \"dynamic\"".to_owned();
            reader.fault_at(&format!("world.movable.{number}"), text);
        }
    }
    if s.robot.body == Body::Program {
        let still = |motion: Motion| motion.distance == 0.0 && motion.angle == 0.0;
        let unknown = s.robot.actions.iter().find(|&action| still(s.robot.actions.motion(action)));
        if let Some(action) = unknown.filter(|_| s.shows_any()) {
            let text =
                "= 0 and turn_deg = 0: goals that are shown need actions of which it is known how they move the robot";
            reader.fault_at(&format!("action.{}.forward", action.index()), text.to_owned());
        }
    } else if s.motion.is_none() {
        return;
    }
    if let Some(name) = s.motion.as_ref().and_then(|motion| motion.safety.battery_task.as_ref())
        && !s.tasks.iter().any(|task| task.name == *name)
    {
        let names: Vec<&str> = s.tasks.iter().map(|task| task.name.as_str()).collect();
        let text = format!("= {name:?} is no task: there are {}", names.join(", "));
        reader.fault_at("safety.battery_task", text);
    }
    for (section, count) in [("change", s.changes.len()), ("show", s.shows.len())] {
        for number in 0..count {
            let text =
                "needs robot.body = \"kinematic\": it is timed by actions that take the same time each".to_owned();
            reader.fault_at(&format!("{section}.{number}"), text);
        }
    }
}

fn counts(s: &Scenario, reader: &mut Reader<'_>) {
    let visible = s.camera.height.saturating_sub(s.vision.cut_rows);
    if visible < s.vision.height && reader.sound(&["vision", "camera.height"]) {
        let text = format!(
            "= {} leaves {visible} of {} lines, less than the {} lines of an observation: it must be in [0, {}]",
            s.vision.cut_rows,
            s.camera.height,
            s.vision.height,
            s.camera.height.saturating_sub(s.vision.height)
        );
        reader.fault_at("vision.cut_rows", text);
    }
    if s.vision.width > s.camera.width && reader.sound(&["vision.width", "camera.width"]) {
        let text = format!("= {} is more than camera.width: it must be in [1, {}]", s.vision.width, s.camera.width);
        reader.fault_at("vision.width", text);
    }
    let keys = ["vision", "camera.detail", "camera.width", "camera.height"];
    if s.camera.detail == Detail::Vision && reader.sound(&keys) {
        let (width, height) = s.camera.rendered(&s.vision);
        if width > s.camera.width || height > visible {
            let text = format!(
                "= \"vision\" renders {width} × {height} samples for observations of {} × {} pixels, more than the {} × \
                 {visible} pixels that vision sees of the full image: it must be \"full\" here",
                s.vision.width, s.vision.height, s.camera.width
            );
            reader.fault_at("camera.detail", text);
        }
    }
    let (k, budget) = (s.slow.features, s.dictionary.budget);
    if k > budget && reader.sound(&["slow.features", "dictionary.budget"]) {
        let text = format!("= {k} is more than dictionary.budget: it must be in [1, {budget}]");
        reader.fault_at("slow.features", text);
    }
    let frames = ["dictionary.retained_frames", "dictionary.block_frames"];
    if s.dictionary.retained_frames < s.dictionary.block_frames && reader.sound(&frames) {
        let text = format!(
            "= {} is less than dictionary.block_frames: it must be at least {}",
            s.dictionary.retained_frames, s.dictionary.block_frames
        );
        reader.fault_at("dictionary.retained_frames", text);
    }
    let frames = ["agent.latency_frames", "agent.resolve_frames"];
    if s.agent.latency_frames >= s.agent.resolve_frames && reader.sound(&frames) {
        let text = format!(
            "= {} is not less than agent.resolve_frames: it must be in [0, {}], so that a model takes effect before the \
             next one is asked for",
            s.agent.latency_frames,
            s.agent.resolve_frames - 1
        );
        reader.fault_at("agent.latency_frames", text);
    }
}

fn changes(s: &Scenario, reader: &mut Reader<'_>) {
    let walls = s.world.walls.len();
    for (index, change) in s.changes.iter().enumerate() {
        let key = format!("change.{index}.wall");
        if let ChangeKind::Texture { wall, .. } = change.what
            && wall >= walls
            && walls > 0
            && reader.sound(&[&key, "world.wall"])
        {
            reader.fault_at(&key, format!("= {wall} is not there: it must be in [0, {}]", walls - 1));
        }
        let (key, tasks) = (format!("change.{index}.task"), s.tasks.len());
        if let ChangeKind::Goal { task, .. } = change.what
            && s.tasks.get(task).is_some_and(|task| !task.needs_pose())
            && reader.sound(&[&key, "task"])
        {
            let text = format!("= {task} is no goal by coordinates: [[show]] moves one that is shown, nothing a pad");
            reader.fault_at(&key, text);
        }
        if let ChangeKind::Goal { task, .. } = change.what
            && task >= tasks
            && tasks > 0
            && reader.sound(&[&key, "task"])
        {
            reader.fault_at(&key, format!("= {task} is not there: it must be in [0, {}]", tasks - 1));
        }
    }
}

/// Keys that go together only in one way.
fn modes(s: &Scenario, reader: &mut Reader<'_>) {
    let (agent, log) = (&s.agent, &s.log);
    if agent.mode == Mode::Lockstep
        && agent.when_behind == WhenBehind::Drop
        && reader.sound(&["agent.mode", "agent.when_behind"])
    {
        let text = "= \"drop\" needs agent.mode = \"realtime\": what is dropped depends on time, and lockstep does not";
        reader.fault_at("agent.when_behind", text.into());
    }
    if let Some(budget) = log.budget_mb
        && budget < 2.0 * log.file_mb
        && reader.sound(&["log.budget_mb", "log.file_mb"])
    {
        let text = format!(
            "= {budget} is less than two files of log.file_mb = {}: it must be at least {}, since the file that is being \
             written is never deleted",
            log.file_mb,
            2.0 * log.file_mb
        );
        reader.fault_at("log.budget_mb", text);
    }
}

fn tasks(s: &Scenario, reader: &mut Reader<'_>) {
    if s.tasks.is_empty() && reader.sound(&["task"]) {
        reader.fault_at("task", "is missing: at least one [[task]] with a goal is needed".into());
    }
    for (index, name) in s.names().enumerate() {
        // The text of a mark that takes others back begins so.
        if name.is_empty() || s.names().take(index).any(|other| other == name) || name.starts_with(FORGET) {
            let text =
                format!("= {name:?} is not allowed: names must be unique, not empty, and not begin with {FORGET:?}");
            reader.fault_at(&format!("task.{index}.name"), text);
        }
        let avoid = index.checked_sub(s.tasks.len()).map(|place| &s.avoids[place]);
        let needs_pose = avoid.map_or_else(|| s.tasks[index].needs_pose(), |avoid| !avoid.is_shown());
        if !s.robot.pose_known && needs_pose && reader.sound(&["task", "robot.pose"]) {
            let key = format!("task.{index}.{}", if avoid.is_some() { "avoid" } else { "goal" });
            let text = "is a place by coordinates, and with robot.pose = \"none\" nobody knows when the robot is there: it must be \"shown\"";
            reader.fault_at(&key, text.into());
        }
    }
}

/// What is shown is the place of a task that waits for it, one after the other, and before the run ends.
fn shows(s: &Scenario, reader: &mut Reader<'_>) {
    let shown: Vec<&str> = s.names().enumerate().filter(|&(number, _)| s.is_shown(number)).map(|of| of.1).collect();
    for (index, show) in s.shows.iter().enumerate() {
        let (task, action) = (format!("show.{index}.task"), format!("show.{index}.action"));
        if !shown.contains(&show.task.as_str()) && reader.sound(&[&task, "task"]) {
            let text = format!("= {:?} is no task whose goal or avoid is \"shown\": there are {shown:?}", show.task);
            reader.fault_at(&task, text);
        }
        if *show.actions().end() >= s.actions && reader.sound(&[&action, "actions"]) {
            let most = s.actions.saturating_sub(show.headings + 1);
            let text =
                format!("= {} is too late: with {} headings it must be in [0, {most}]", show.action, show.headings);
            reader.fault_at(&action, text);
        }
        let before = s.shows[..index].iter().map(|other| other.actions());
        if let Some(other) = before.into_iter().find(|other| show.action <= *other.end())
            && reader.sound(&[&action])
        {
            let text = format!("= {} is not after the show before it: it must be above {}", show.action, other.end());
            reader.fault_at(&action, text);
        }
    }
}

/// Names of rooms are what messages and tables call them.
fn rooms(s: &Scenario, reader: &mut Reader<'_>) {
    for (index, room) in s.world.rooms.iter().enumerate() {
        if room.name.is_empty() || s.world.rooms[..index].iter().any(|other| other.name == room.name) {
            let text = format!("= {:?} is not allowed: names must be unique and not empty", room.name);
            reader.fault_at(&format!("world.room.{index}.name"), text);
        }
    }
}

/// A room that the robot cannot get into is a slip: it does not touch the others, or its door is too narrow.
fn joined(s: &Scenario, plan: &Plan, reader: &mut Reader<'_>) {
    for (index, room) in s.world.rooms.iter().enumerate() {
        if !plan.reachable_cells().any(|cell| room.contains(cell)) {
            let text = format!(
                "= [{:?}, {:?}] ({:?}) is out of reach from robot.start: it must touch or overlap a room that is not, on a                  length of more than {} m, twice robot.radius",
                room.low,
                room.high,
                room.name,
                2.0 * s.robot.radius
            );
            reader.fault_at(&format!("world.room.{index}.corners"), text);
        }
    }
}

/// Pyramids are painted behind all walls, so that is where they must be.
fn outside(s: &Scenario, plan: &Plan, reader: &mut Reader<'_>) {
    let (low, high) = plan.walls_box();
    for (index, pyramid) in s.world.pyramids.iter().enumerate() {
        let centre = Point2::from(pyramid.centre);
        let distance = (centre - centre.sup(&low).inf(&high)).norm();
        if distance < pyramid.reach() {
            let text = format!(
                "= {:?} is {distance:.1} m from the box around all walls, [{:.1}, {:.1}] × [{:.1}, {:.1}]: a pyramid with a \
                 side of {} m must be at least {:.1} m away",
                pyramid.centre,
                low.x,
                high.x,
                low.y,
                high.y,
                pyramid.side,
                pyramid.reach()
            );
            reader.fault_at(&format!("world.pyramid.{index}.centre"), text);
        }
    }
}

fn place(s: &Scenario, fault: &PlanFault, reader: &mut Reader<'_>) {
    match fault {
        PlanFault::StartBlocked(clearance) => {
            let text = format!(
                "= {:?} is {clearance:.3} m from a wall, less than robot.radius = {} m: it must be at least that far; a \
                 robot wider than its room has no such place",
                s.robot.start, s.robot.radius
            );
            reader.fault_at("robot.start", text);
        }
        PlanFault::Open => {
            let text = format!(
                "= {:?} is not enclosed by walls: there must be no gap through which a robot of radius {} m could leave",
                s.robot.start, s.robot.radius
            );
            reader.fault_at("robot.start", text);
        }
        PlanFault::TooLarge(width, depth) => {
            let text = format!("span {width:.0} m × {depth:.0} m: at most 10 000 m² are allowed");
            reader.fault_at("world.wall", text);
        }
    }
}

/// A goal area of the scenario, with the keys of its centre and its radius.
struct Area {
    keys: [String; 2],
    centre: [f64; 2],
    radius: f64,
}

/// The goal areas of all tasks, and those that they get later, and the areas to be avoided, with the number of each.
fn areas(s: &Scenario) -> Vec<(usize, Area)> {
    let at = |key: String, task: usize, centre: [f64; 2]| {
        let avoid = task.checked_sub(s.tasks.len()).and_then(|place| s.avoids.get(place));
        let radius = s.tasks.get(task).map(|task| task.radius).or(avoid.map(|avoid| avoid.radius))?;
        Some((task, Area { keys: [key, format!("task.{task}.radius")], centre, radius }))
    };
    let first = s.tasks.iter().enumerate().map(|(index, task)| at(format!("task.{index}.goal"), index, task.goal?));
    let later = s.changes.iter().enumerate().map(|(index, change)| match change.what {
        ChangeKind::Goal { task, goal } => at(format!("change.{index}.goal"), task, goal),
        _ => None,
    });
    let shown = s.shows.iter().enumerate().map(|(index, show)| {
        let task = s.names().position(|name| name == show.task)?;
        at(format!("show.{index}.at"), task, show.at)
    });
    let avoided = s.avoids.iter().enumerate().map(|(place, avoid)| {
        let task = s.tasks.len() + place;
        at(format!("task.{task}.avoid"), task, avoid.at?)
    });
    first.chain(avoided).chain(later).chain(shown).flatten().collect()
}

/// Where a goal lies in what is to be avoided, no value serves both.
fn contradictions(s: &Scenario, reader: &mut Reader<'_>) {
    let areas: Vec<(usize, Area)> = areas(s);
    for (task, goal) in areas.iter().filter(|(number, _)| *number < s.tasks.len()) {
        for (avoid, area) in areas.iter().filter(|(number, _)| *number >= s.tasks.len()) {
            let distance = (Point2::from(goal.centre) - Point2::from(area.centre)).norm();
            if distance < area.radius && reader.sound(&[&goal.keys[0], &area.keys[0], &area.keys[1]]) {
                let text = format!(
                    "= {:?} is the goal of {:?}, {distance:.2} m from {:?} at {:?}, which is to be avoided: it must be at least \
                     {} m away",
                    goal.centre,
                    s.tasks[*task].name,
                    s.avoids[avoid - s.tasks.len()].name,
                    area.centre,
                    area.radius
                );
                reader.fault_at(&goal.keys[0], text);
            }
        }
    }
}

fn goals(s: &Scenario, plan: &Plan, reader: &mut Reader<'_>) {
    for (_, Area { keys: [goal, size], centre, radius }) in areas(s) {
        if !reader.sound(&[&goal, &size]) {
            continue;
        }
        let place = Point2::from(centre);
        if !plan.reaches_circle(place, radius) {
            let (low, high) = plan.reachable_box();
            let text = format!(
                "= {centre:?} with radius {radius} m is in a wall or out of reach: the robot's centre can be in [{:.2}, \
                 {:.2}] × [{:.2}, {:.2}] at most",
                low.x, high.x, low.y, high.y
            );
            reader.fault_at(&goal, text);
        } else if !plan.leaves_circle(place, radius) {
            let text = format!("= {radius} m covers every place that the robot can reach: no start is left outside");
            reader.fault_at(&size, text);
        }
    }
}

/// Goals in walls can be told without knowing what the robot reaches.
fn goals_alone(s: &Scenario, reader: &mut Reader<'_>) {
    for (_, Area { keys: [goal, size], centre, radius }) in areas(s) {
        let clearance = clearance(&s.world.walls, Point2::from(centre));
        if clearance + radius < s.robot.radius && reader.sound(&[&goal, &size, "robot.radius"]) {
            let text = format!(
                "= {centre:?} with radius {radius} m is in a wall: every place in it is closer to a wall than \
                 robot.radius = {} m",
                s.robot.radius
            );
            reader.fault_at(&goal, text);
        }
    }
}
