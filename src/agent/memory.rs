//! What a run will hold in memory, and what the machine has.

use super::actors::fit::RARE;
use super::actors::kernel_rows::MOST_KEPT;
use super::actors::learn::stream_options;
use crate::dictionary::WhenFull;
use crate::robot::Action;
use crate::scenario::{Method as Values, Scenario, SelectionRule};
use crate::slow::{Method, SlowStream, solve_bytes};

/// Bytes of everything that grows with the settings of a run, at its full size.
///
/// With `m` support vectors (the budget), `d` values of an observation, `r` retained frames, `k` features and `N`
/// transitions in the window:
///
/// | part | bytes |
/// |---|---|
/// | stream: dictionary, moments, retained frames | `24m² + 4md + r(8m + 4d)` and what [`SlowStream::bytes`] adds |
/// | thinning, where support vectors leave at the budget | `48m²` |
/// | state: a copy of the stream, of the window and of models, while the state of the run is saved | that of the stream, `2Nd`, `3m(5d + 8k)` |
/// | requests: copies of dictionary and moments, with the solver, in its queue, and one that is made | `3(24m² + 4md)` |
/// | solver | [`solve_bytes`]: about `16m² + 48mk` |
/// | products of the window's observations with support vectors, kept for the next model | `4mN`, at most 1 GB |
/// | models: in use, in trials, on their way (`w` of them wait for their frame) | `(6 + w) m(5d + 8k + 24·tasks)` |
/// | linear values: the window, its features, policy iteration of `t` tasks side by side | `N(2d + (48 + 8t)(k + 1)) + (24 + 384t)(k + 1)²` |
/// | local values: the window, its features, and of `n` neighbours and `p` coordinates the points and who is near | `N(2d + 8(k + 1)) + T(24p + 48n + 72 + 16·tasks)`, and `(6 + w) T(4p + 8·tasks)` for models |
/// | places: maps of the window while it is made, six tries side by side, and of models; turns that were not made (`a` of them) | `N(40p + 800 + 200a)`, `(6 + w) N(4p + 150)` |
/// | what is shown: the map of the window, and `M` marks of the scenario | `N(12p + 16n + 160 + 16(6 + w))`, `M(d + (6 + w)(4p + 16))` |
/// | images in the queue | `3 · width · height` each |
///
/// `T`: transitions of local values. Where places are told, `N`, as many for each turn, and once more where a move has an inverse; else `2N`
/// where an action has an inverse, which undoes others. Where something is to be avoided, each task counts twice for local values;
/// exploration to rarely visited places counts as eight tasks more. Marks that somebody makes while the run goes on are not counted.
///
/// Beside it stand the program and what the allocator keeps. Where the solver's iteration cannot find the features, its
/// dense reference takes `48m²` or, where the coordinates are redundant, `104m²` in its place; this is not counted.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Memory {
    /// Name and bytes of each part.
    pub parts: Vec<(&'static str, u64)>,
}

impl Memory {
    /// What a scenario will need.
    pub fn of(s: &Scenario) -> Self {
        Memory::with_budget(s, s.dictionary.budget)
    }

    /// What a scenario will need with another budget of support vectors, and no more features than that.
    pub fn with_budget(s: &Scenario, budget: usize) -> Self {
        // Where members can leave, a block may exceed the budget before they do.
        let exceeds = s.dictionary.selection != SelectionRule::Ald || s.dictionary.when_full != WhenFull::Stop;
        let m = budget + if exceeds { s.dictionary.block_frames } else { 0 };
        let d = s.vision.values();
        let mut stream = stream_options(s);
        stream.retained = stream.retained.min(s.actions.saturating_mul(s.robot.frames_per_action));
        let features = s.slow.features.min(budget);
        let of_stream = SlowStream::<f32>::bytes(&stream, m, d, s.dictionary.block_frames);
        let of_solver = solve_bytes(m, features, Method::Automatic);
        let tasks = s.tasks.len() as u64;
        let side_by_side = if s.agent.threads > 1 { tasks } else { 1 };
        let waiting = s.agent.queue.min(s.agent.latency_frames / s.agent.resolve_frames) as u64;
        let image = 3 * s.camera.width as u64 * s.camera.height as u64;
        let [m, d, k, n] = [m, d, features + 1, s.value.window.min(s.actions)].map(|size| size as u64);
        let [p, neighbours] = [s.value.metric_features.min(features), s.value.neighbours].map(|size| size as u64);
        // Values are also fitted as if nothing was to be avoided.
        let fits = if s.avoids.is_empty() { tasks } else { 2 * tasks };
        let fits = fits + if s.policy.directed_share > 0.0 { RARE as u64 } else { 0 };
        let undoes = |action: &Action| s.robot.actions.inverse(*action).is_some();
        let (moves, turns): (Vec<Action>, Vec<Action>) =
            s.robot.actions.iter().partition(|&action| s.robot.actions.advances(action));
        // With places, each state tells of all turns, done, undone or neither.
        let (turns, undone_moves) = (turns.len() as u64, moves.iter().any(undoes));
        let undone = u64::from(s.robot.actions.iter().any(|action| undoes(&action)));
        let tried = n * (1 + if s.value.places { turns + u64::from(undone_moves) } else { undone });
        let of_shows = s.shows.iter().map(|show| (show.headings * s.robot.frames_per_action) as u64);
        let shown = match s.shows_any() {
            true => {
                let of_map = n * (12 * p + 16 * neighbours + 160 + 16 * (6 + waiting));
                of_map + of_shows.sum::<u64>() * (d + (6 + waiting) * (4 * p + 16))
            }
            false => 0,
        };
        let values = match s.value.method {
            Values::Lspi => n * (2 * d + (48 + 8 * side_by_side) * k) + (24 + 384 * side_by_side) * k * k,
            Values::Local => {
                let of_models = (6 + waiting) * tried * (4 * p + 8 * fits);
                n * (2 * d + 8 * k) + tried * (24 * p + 48 * neighbours + 72 + 16 * fits) + of_models
            }
        };
        let places = match s.value.method {
            Values::Local if s.value.places => {
                // The map that is made, the best one so far, and those of the models: points, poses and cells; turns that were not made.
                n * (40 * p + 800 + 200 * turns) + (6 + waiting) * n * (4 * p + 150)
            }
            _ => 0,
        };
        let parts = [
            ("stream", of_stream),
            ("thinning", if exceeds { 48 * m * m } else { 0 }),
            ("state", of_stream + 2 * n * d + 3 * m * (5 * d + 8 * k)),
            ("requests", 3 * (24 * m * m + 4 * m * d)),
            ("solver", of_solver),
            ("models", (6 + waiting) * m * (5 * d + 8 * k + 24 * tasks)),
            ("products", 4 * (m * n).min(MOST_KEPT as u64)),
            ("values", values),
            ("places", places),
            ("what is shown", shown),
            ("images", s.agent.queue as u64 * image),
        ];
        Memory { parts: parts.into_iter().filter(|part| part.1 > 0).collect() }
    }

    /// All parts together.
    pub fn total(&self) -> u64 {
        self.parts.iter().fold(0, |sum, part| sum.saturating_add(part.1))
    }

    /// The largest part.
    pub fn largest(&self) -> (&'static str, u64) {
        self.parts.iter().copied().max_by_key(|part| part.1).unwrap_or(("nothing", 0))
    }
}

/// The memory that there is for this process, bytes: that of the machine, or of the control group that it runs in (the limits
/// of groups around that one are not looked at); `None` where the system does not say.
pub fn machine_memory() -> Option<u64> {
    let machine = std::fs::read_to_string("/proc/meminfo").ok()?;
    let line = machine.lines().find_map(|line| line.strip_prefix("MemTotal:"))?;
    let bytes = 1024 * line.split_whitespace().next()?.parse::<u64>().ok()?;
    Some(group_limits().fold(bytes, u64::min))
}

/// Limits of the control groups that this process runs in; files of both versions of control groups.
fn group_limits() -> impl Iterator<Item = u64> {
    let own = std::fs::read_to_string("/proc/self/cgroup").unwrap_or_default();
    let own = own.lines().find_map(|line| line.strip_prefix("0::")).unwrap_or("/").to_owned();
    let files = [
        format!("/sys/fs/cgroup{own}/memory.max"),
        "/sys/fs/cgroup/memory.max".to_owned(),
        "/sys/fs/cgroup/memory/memory.limit_in_bytes".to_owned(),
    ];
    // They read "max" where there is no limit.
    files.into_iter().filter_map(|file| std::fs::read_to_string(file).ok()?.trim().parse().ok())
}
