//! Promise: a run can be watched while it goes on, paused and stopped, by those who may; and it does not notice.

use std::collections::BTreeMap;
use std::fs::{self, OpenOptions};
use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::OnceLock;
use std::time::{Duration, Instant};

use crate::common::{CHUNK, adagio, browser, package_file, records_of, report, smoke_run, stderr, stdout};
use adagio::live::Follower;
use adagio::report::gather::Gathered;
use serde_json::{Value, json};

const LIMIT: Duration = Duration::from_secs(90);

/// A run with a page, which is killed when the test is over.
struct Served {
    child: Child,
    address: String,
    url: String,
    folder: PathBuf,
}

impl Served {
    /// Run the smoke scenario in `folder/name`; `arguments` come behind it.
    fn start(folder: &Path, name: &str, arguments: &[&str]) -> Self {
        Served::start_with(&package_file("scenarios/smoke.toml"), folder, name, arguments)
    }

    fn start_with(scenario: &Path, folder: &Path, name: &str, arguments: &[&str]) -> Self {
        let mut child = Command::new(env!("CARGO_BIN_EXE_adagio"))
            .current_dir(folder)
            .args(["run", scenario.to_str().unwrap(), "--quiet", "--no-report", "--out", name])
            .args(arguments)
            .env_remove("ADAGIO_TOKEN")
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        let mut lines = BufReader::new(child.stderr.take().unwrap()).lines();
        let line = lines.next().unwrap().unwrap();
        let url = line.strip_prefix("the run can be watched at ").unwrap_or_else(|| panic!("{line}")).to_owned();
        // What else it says must not fill the pipe.
        std::thread::spawn(move || lines.for_each(drop));
        let address = url.strip_prefix("http://").unwrap().split('/').next().unwrap().to_owned();
        Served { child, address, url, folder: folder.join(name) }
    }

    fn send(&self, request: &str) -> TcpStream {
        let port = self.address.rsplit_once(':').unwrap().1;
        let mut stream = TcpStream::connect(format!("127.0.0.1:{port}")).unwrap();
        stream.set_read_timeout(Some(LIMIT)).unwrap();
        stream.write_all(request.as_bytes()).unwrap();
        stream
    }

    /// Status and body of a request with these head lines.
    fn ask(&self, method: &str, path: &str, heads: &[&str], body: &str) -> (u16, Value) {
        let heads: String = heads.iter().map(|head| format!("{head}\r\n")).collect();
        let length = body.len();
        let request =
            format!("{method} {path} HTTP/1.1\r\n{heads}Content-Length: {length}\r\nConnection: close\r\n\r\n{body}");
        let mut answer = String::new();
        self.send(&request).read_to_string(&mut answer).unwrap();
        let (head, body) = answer.split_once("\r\n\r\n").unwrap_or_else(|| panic!("{answer:?}"));
        let status = head.split(' ').nth(1).unwrap().parse().unwrap();
        (status, serde_json::from_str(body).unwrap_or(Value::Null))
    }

    fn get(&self, path: &str) -> Value {
        let (status, body) = self.ask("GET", path, &["Host: localhost"], "");
        assert_eq!(status, 200, "{path}: {body}");
        body
    }

    fn post(&self, path: &str, body: &Value) -> (u16, Value) {
        self.ask("POST", path, &["Host: localhost", "Content-Type: application/json"], &body.to_string())
    }

    /// Wait until what `/now` says is as wanted.
    fn wait_for(&self, what: &str, wanted: impl Fn(&Value) -> bool) -> Value {
        let begin = Instant::now();
        loop {
            // At first there is nothing to show.
            let (status, now) = self.ask("GET", "/now", &["Host: localhost"], "");
            if status == 200 && wanted(&now) {
                return now;
            }
            assert!(begin.elapsed() < LIMIT, "no {what} within {LIMIT:?}: {now}");
            std::thread::sleep(Duration::from_millis(50));
        }
    }

    /// Its exit code.
    fn end(mut self) -> Option<i32> {
        let begin = Instant::now();
        while begin.elapsed() < LIMIT {
            if let Some(status) = self.child.try_wait().unwrap() {
                return status.code();
            }
            std::thread::sleep(Duration::from_millis(20));
        }
        panic!("the run does not end within {LIMIT:?}");
    }
}

impl Drop for Served {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// One smoke run that nobody watched, with its report.
fn unwatched() -> &'static Path {
    static RUN: OnceLock<(tempfile::TempDir, PathBuf)> = OnceLock::new();
    &RUN.get_or_init(|| {
        let folder = tempfile::tempdir().unwrap();
        let run = smoke_run(folder.path(), "run", &[]);
        (folder, run)
    })
    .1
}

fn frames(now: &Value) -> u64 {
    now["frame"].as_u64().unwrap()
}

#[test]
fn pauses_and_clients_that_never_read_change_nothing_of_a_run() {
    let folder = tempfile::tempdir().unwrap();
    let begin = Instant::now();
    // Sixty times as fast as the robot would be: it takes some seconds, and pauses are in the middle.
    let run = Served::start(folder.path(), "run", &["--serve", "--set", "agent.speed=60"]);
    // They ask and ask, and never read; others never finish their question.
    let deaf: Vec<TcpStream> = (0..12)
        .map(|i| run.send(&"GET /now HTTP/1.1\r\nHost: localhost\r\n\r\n".repeat(if i < 6 { 200 } else { 1 })))
        .chain((0..6).map(|_| run.send("GET /now HTTP/1.1\r\nHost: loc")))
        .collect();
    for pause in 0..2 {
        run.wait_for("frames", |now| now["phase"] == "running" && frames(now) > 300 * pause);
        assert_eq!(run.post("/pause", &json!({})).0, 200);
        run.wait_for("pause", |now| now["phase"] == "paused");
        // What was under way is flushed within a second.
        std::thread::sleep(Duration::from_millis(1800));
        let held = frames(&run.get("/now"));
        std::thread::sleep(Duration::from_millis(700));
        assert_eq!(frames(&run.get("/now")), held, "the run stands still");
        assert_eq!(run.post("/resume", &json!({})).0, 200);
        run.wait_for("frames after a pause", |now| frames(now) > held);
    }
    let place = run.folder.clone();
    assert_eq!(run.end(), Some(0));
    let taken = begin.elapsed();
    drop(deaf);
    let (watched, alone) = (report(&place), report(unwatched()));
    assert_eq!(watched["digest"], alone["digest"]);
    for key in ["actions", "frames", "dropped_frames", "quarantined_frames"] {
        assert_eq!(watched["run"][key], alone["run"][key], "{key}");
    }
    assert_eq!(watched["curve"], alone["curve"]);
    // Two pauses of two and a half seconds at least, which are no part of the run.
    let seconds = Duration::from_secs_f64(watched["run"]["seconds"].as_f64().unwrap());
    assert!(taken >= seconds + Duration::from_secs(5), "{taken:?} by the wall clock, {seconds:?} by the run's");
    let mut follower = Follower::new(&place);
    while follower.read_on(LIMIT).unwrap() {}
    let told = follower.newest.said.iter().filter(|(_, text)| text.contains("after a pause of")).count();
    assert_eq!(told, 2, "the log tells of pauses: {:?}", follower.newest.said);
    let output = adagio(folder.path(), &["replay", "run", "--verify"]);
    assert!(output.status.success(), "a run with pauses is repeated bit for bit: {}", stderr(&output));
}

#[test]
fn requests_are_checked_and_say_what_is_wrong() {
    let folder = tempfile::tempdir().unwrap();
    let run = Served::start(folder.path(), "run", &["--serve", "--actions", "50000", "--set", "agent.speed=60"]);
    let loopback = ["Host: localhost", "Content-Type: application/json"];
    assert_eq!(run.ask("GET", "/now", &["Host: evil.example"], "").0, 403, "another name");
    assert_eq!(run.ask("POST", "/stop", &["Host: localhost"], "{}").0, 415, "a form of another site");
    let foreign = [&loopback[..], &["Origin: http://evil.example"]].concat();
    assert_eq!(run.ask("POST", "/stop", &foreign, "{}").0, 403, "a page of another site");
    assert_eq!(run.ask("GET", "/stop", &loopback, "").0, 405);
    assert_eq!(run.ask("GET", "/run_000.mcap", &loopback, "").0, 404);
    for (body, told) in [
        (json!({"task": "nowhere", "x": 1.0, "y": 0.9}), "there are centre, corner"),
        (json!({"task": "centre", "x": 2.9, "y": 0.9}), "the robot cannot be at (2.9, 0.9) m"),
        (json!({"task": "centre", "x": 1.0}), "missing field `y`"),
        (json!({"task": "centre", "x": 1.0, "y": 0.9, "z": 1.0}), "unknown field `z`"),
        (json!({"task": "centre", "x": null, "y": 0.9}), "expected f64"),
        (json!(["centre"]), "no place for a goal"),
    ] {
        let (status, answer) = run.post("/goal", &body);
        assert!(status == 400 && answer["error"].as_str().unwrap().contains(told), "{body}: {status} {answer}");
    }
    let (status, answer) = run.post("/goto", &json!({"task": "nowhere"}));
    assert!(status == 400 && answer["error"].as_str().unwrap().contains("there are centre, corner"), "{answer}");
    assert_eq!(run.post("/goto", &json!({"task": "corner"})).0, 200);
    assert_eq!(run.post("/goto", &json!({"task": ""})).0, 200, "wherever the schedule has it go");
    let long = run.post("/goal", &json!({"task": "x".repeat(2000), "x": 1.0, "y": 1.0}));
    assert_eq!(long.0, 413, "{}", long.1);
    run.post("/pause", &json!({}));
    run.wait_for("pause", |now| now["phase"] == "paused");
    // A goal that may be moved there waits for the run, or is taken.
    assert_eq!(run.post("/goal", &json!({"task": "corner", "x": 0.8, "y": 1.0})).0, 200);
    // Whoever stops a run that is paused ends it, too; its log is whole.
    assert_eq!(run.post("/stop", &json!({})).0, 200);
    let place = run.folder.clone();
    assert_eq!(run.end(), Some(0));
    let output = adagio(folder.path(), &["check", place.to_str().unwrap()]);
    assert!(output.status.success(), "{}{}", stdout(&output), stderr(&output));
    assert!(report(&place)["run"]["actions"].as_u64().unwrap() < 50_000);
}

#[test]
fn a_goal_that_is_moved_by_hand_is_moved_again_by_a_replay() {
    let folder = tempfile::tempdir().unwrap();
    let run = Served::start(folder.path(), "run", &["--serve", "--actions", "600", "--set", "agent.speed=100"]);
    run.wait_for("model", |now| now["epoch"].as_u64() > Some(0));
    run.post("/pause", &json!({}));
    run.wait_for("pause", |now| now["phase"] == "paused");
    assert_eq!(run.post("/goal", &json!({"task": "centre", "x": 2.0, "y": 0.8})).0, 200);
    let waits = json!([{"task": 0, "x": 2.0, "y": 0.8}]);
    run.wait_for("move that waits", |now| now["moves"] == waits && now["tasks"][0]["goal"] == json!([1.5, 0.9]));
    run.post("/resume", &json!({}));
    run.wait_for("goal at its place", |now| now["moves"] == json!([]) && now["tasks"][0]["goal"] == json!([2.0, 0.8]));
    let place = run.folder.clone();
    assert_eq!(run.end(), Some(0));
    let place = place.to_str().unwrap();
    let verified = adagio(folder.path(), &["replay", place, "--verify", "--quiet"]);
    assert!(verified.status.success(), "{}{}", stdout(&verified), stderr(&verified));
    // What was learned knows for which goals: it is tried out with them, as in the run's own report.
    let own = report(Path::new(place))["tasks"].clone();
    let output = adagio(folder.path(), &["evaluate", place, "--starts", "8", "--seed", "1", "--json"]);
    let again: Value = serde_json::from_str(&stdout(&output)).unwrap();
    assert_eq!(again["tasks"], own);
}

/// A button that is held marks each frame, one that turns the robot those of one turn on the spot; a replay has the same marks.
#[test]
fn places_are_marked_by_hand() {
    let folder = tempfile::tempdir().unwrap();
    let smoke = std::fs::read_to_string(package_file("scenarios/smoke.toml")).unwrap();
    let (world, _) = smoke.split_once("[[task]]").unwrap();
    let tasks = "[[task]]\nname = \"home\"\ngoal = \"shown\"\n[[task]]\nname = \"stairs\"\navoid = \"shown\"\n";
    let scenario = folder.path().join("home.toml");
    std::fs::write(&scenario, format!("{world}{tasks}")).unwrap();
    let arguments = ["--serve", "--actions", "1500", "--set", "agent.speed=100"];
    let run = Served::start_with(&scenario, folder.path(), "run", &arguments);
    run.wait_for("model", |now| now["epoch"].as_u64() > Some(0));
    for (body, told) in [
        (json!({"task": "hime", "how": "turn"}), "the name of a task that is shown (home, stairs)"),
        (json!({"task": "home", "how": "twice"}), "unknown variant `twice`"),
        (json!({"task": "forget home", "how": "hold"}), "\"how\" says it"),
    ] {
        let (status, answer) = run.post("/mark", &body);
        assert!(status == 400 && answer["error"].as_str().unwrap().contains(told), "{body}: {status} {answer}");
    }
    let marks = |place: usize| move |now: &Value| now["shown"][place]["marks"].as_u64().unwrap();
    assert_eq!(run.post("/mark", &json!({"task": "home", "how": "turn"})).0, 200);
    run.wait_for("one turn", |now| marks(0)(now) >= 40 && now["marking"] == json!(null));
    assert_eq!(run.post("/mark", &json!({"task": "stairs", "how": "hold"})).0, 200);
    run.wait_for("marks while it is held", |now| marks(1)(now) > 5);
    assert_eq!(run.post("/mark", &json!({"task": "stairs", "how": "release"})).0, 200);
    // Nobody says any more that it is held.
    assert_eq!(run.post("/mark", &json!({"task": "home", "how": "hold"})).0, 200);
    run.wait_for("end of marks", |now| now["marking"] == json!(null) && marks(0)(now) > 40);
    assert_eq!(run.post("/mark", &json!({"task": "stairs", "how": "forget"})).0, 200);
    run.wait_for("nothing to avoid", |now| marks(1)(now) == 0);
    let place = run.folder.clone();
    run.post("/stop", &json!({}));
    assert_eq!(run.end(), Some(0));
    let (mut turned, mut marked, mut action) = (Vec::new(), 0, 0);
    for record in adagio::log::LogReader::open(&place.join("run_000.mcap")).unwrap().map(Result::unwrap) {
        let adagio::log::Record::Message { topic, .. } = &record else { continue };
        match &**topic {
            "/adagio/frame" => action = record.decode::<adagio::log::messages::FrameTaken>().unwrap().action,
            "/adagio/mark" if marked < 40 => {
                marked += 1;
                turned.push(action);
            }
            _ => {}
        }
    }
    // Eight turns to the left of five frames each.
    assert_eq!(turned, vec![adagio::log::messages::Decision::TURN_LEFT; 40]);
    let verified = adagio(folder.path(), &["replay", "run", "--verify", "--quiet"]);
    assert!(verified.status.success(), "{}{}", stdout(&verified), stderr(&verified));
}

#[test]
fn a_page_for_other_machines_needs_its_token() {
    let folder = tempfile::tempdir().unwrap();
    let arguments = ["--serve", "0.0.0.0:0", "--actions", "50000", "--set", "agent.speed=60"];
    let run = Served::start(folder.path(), "run", &arguments);
    let token = run.url.split_once("/?token=").expect("a token in the address").1.to_owned();
    assert!(token.len() == 32 && token.bytes().all(|byte| byte.is_ascii_hexdigit()), "{token}");
    let host = "Host: robot.lan";
    for path in ["/", "/now", "/curves", "/maps", "/anything"] {
        assert_eq!(run.ask("GET", path, &[host], "").0, 401, "{path}");
        assert_eq!(run.ask("GET", &format!("{path}?token={}", "0".repeat(32)), &[host], "").0, 403, "{path}");
    }
    let kind = "Content-Type: application/json";
    assert_eq!(run.ask("POST", "/stop", &[host, kind], "{}").0, 401);
    assert_eq!(run.ask("POST", "/stop", &[host, kind, "Authorization: Bearer 0"], "{}").0, 403);
    let bearer = format!("Authorization: Bearer {token}");
    assert_eq!(run.ask("GET", &format!("/?token={token}"), &[host], "").0, 200);
    while run.ask("GET", "/now", &[host, &bearer], "").0 == 204 {
        std::thread::sleep(Duration::from_millis(20));
    }
    assert_eq!(run.ask("GET", "/now", &[host, &bearer], "").0, 200);
    assert_eq!(run.ask("POST", "/stop", &[host, kind, &bearer], "{}").0, 200);
    assert_eq!(run.end(), Some(0));

    let scenario = package_file("scenarios/smoke.toml");
    let scenario = scenario.to_str().unwrap();
    for (arguments, told) in [
        (vec!["--serve", "0.0.0.0:0", "--token", "weak"], "a token has 16 to 128 letters"),
        (vec!["--serve", "somewhere:80"], "it is no address"),
    ] {
        let output = adagio(folder.path(), &[&["run", scenario, "--out", "none"], &arguments[..]].concat());
        assert_eq!(output.status.code(), Some(2), "{}", stderr(&output));
        assert!(stderr(&output).contains(told), "{}", stderr(&output));
    }
    assert!(!folder.path().join("none").exists(), "nothing is left behind");
}

/// In headless Chromium, on a run that goes on until the page's button stops it.
#[test]
fn a_browser_shows_a_run_and_its_buttons_work() {
    let folder = tempfile::tempdir().unwrap();
    let arguments =
        ["--serve", "--actions", "200000", "--set", "agent.speed=60", "--set", "policy.explore_share=0.0005"];
    let run = Served::start(folder.path(), "run", &arguments);
    let Some(seen) = browser("check_live.mjs", &[&run.url]) else { return };
    for what in ["console", "errors"] {
        assert_eq!(seen[what].as_array().unwrap().len(), 0, "{}", seen[what]);
    }
    for request in seen["requests"].as_array().unwrap() {
        assert!(request.as_str().unwrap().starts_with(&run.url), "{request} was loaded");
    }
    assert!(seen["moves"]["later"].as_u64() > seen["moves"]["first"].as_u64(), "{}", seen["moves"]);
    let views = seen["views"].as_object().unwrap();
    for (name, view) in views {
        assert_eq!(view["overflow"], 0, "{name}: the page is wider than the window");
        assert!(view["smallest"].as_f64().unwrap() >= 44.0, "{name}: buttons are too small for a finger");
        for drawing in
            ["map", "ramp", "success", "quality", "slowness", "growth", "features", "speed", "latency", "memory"]
        {
            let colours = view["colours"][drawing].as_u64().unwrap();
            let few = if drawing == "map" { 200 } else { 8 };
            assert!(colours > few, "{name}: {drawing} has {colours} colours");
        }
        assert_eq!(view["images"], json!({"camera": [160, 120], "observation": [32, 16]}), "{name}");
    }
    assert_ne!(views["phone"]["paper"], views["phone_dark"]["paper"], "dark where people want it dark");
    let pause = &seen["pause"];
    assert_eq!(pause["held"], pause["still"], "the pause holds");
    assert!(pause["later"].as_u64() > pause["held"].as_u64(), "it goes on: {pause}");
    let moved = &seen["goal"]["message"].as_str().unwrap();
    assert!(moved.contains("centre") && moved.contains("shall be at"), "{moved}");
    let asked: Vec<f64> = ["x", "y"].iter().map(|axis| seen["goal"]["place"][axis].as_f64().unwrap()).collect();
    let told: Vec<f64> = moved.split(['(', ',', ')']).filter_map(|part| part.trim().parse().ok()).collect();
    assert!(asked.iter().zip(&told).all(|(a, b)| (a - b).abs() < 0.02), "{asked:?} {told:?}");
    assert!(seen["end"].as_str().unwrap().contains("is over"), "{}", seen["end"]);
    assert_eq!(run.end(), Some(0), "stopped by its button");
}

/// What a follower has of a log, as far as it can be compared.
fn summary(gathered: &Gathered) -> BTreeMap<&'static str, u64> {
    BTreeMap::from([
        ("frames", gathered.frames),
        ("last frame", gathered.last_frame),
        ("poses", gathered.poses),
        ("models", gathered.models.offered()),
        ("growth", gathered.growth.offered()),
        ("health", gathered.health.offered()),
        ("damaged", gathered.damaged),
        ("messages", gathered.topics.values().map(|topic| topic.messages).sum()),
    ])
}

fn whole() -> (Vec<u8>, BTreeMap<&'static str, u64>) {
    let log = unwatched().join("run_000.mcap");
    let gathered = Gathered::of(vec![log.clone()], &|_| {}).unwrap();
    (fs::read(log).unwrap(), summary(&gathered))
}

#[test]
fn a_log_is_followed_while_it_grows_byte_by_byte() {
    let (bytes, all) = whole();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("run_000.mcap");
    let mut file = OpenOptions::new().create(true).append(true).open(&path).unwrap();
    let mut follower = Follower::new(folder.path());
    let (mut at, mut seen, mut step) = (0, 0, 1);
    while at < bytes.len() {
        // Cuts fall anywhere: within heads, within chunks, between records.
        let end = (at + step).min(bytes.len());
        file.write_all(&bytes[at..end]).unwrap();
        (at, step) = (end, (step * 5 / 3 + 1) % 30_011 + 1);
        while follower.read_on(LIMIT).unwrap() {}
        assert!(follower.is_up_to_date() && follower.gathered.frames >= seen);
        assert_eq!(follower.gathered.damaged, 0, "half a record is no damage: {:?}", follower.gathered.damage);
        assert_eq!(follower.is_closed(), at == bytes.len());
        seen = follower.gathered.frames;
    }
    assert_eq!(summary(&follower.gathered), all);
    assert!(follower.newest.ended && follower.newest.decision.is_some() && follower.newest.policies.len() == 2);
    assert!(follower.newest.observation.as_ref().is_some_and(|seen| seen.rgb.len() == 3 * 32 * 16));
}

#[test]
fn files_that_follow_are_followed_and_damage_is_stepped_over() {
    let (bytes, all) = whole();
    let chunks: Vec<_> = records_of(&bytes).into_iter().filter(|record| record.1 == CHUNK).collect();
    let folder = tempfile::tempdir().unwrap();
    let path = |number: u32| folder.path().join(format!("run_{number:03}.mcap"));
    // The first file stops in the middle of a chunk: it may be being written.
    let cut = chunks[chunks.len() / 2].0;
    fs::write(path(0), &bytes[..cut + 100]).unwrap();
    let mut follower = Follower::new(folder.path());
    while follower.read_on(LIMIT).unwrap() {}
    let half = summary(&follower.gathered);
    assert!(half["frames"] > 0 && half["frames"] < all["frames"] && half["damaged"] == 0, "{half:?}");
    assert_eq!((follower.torn(), follower.is_closed()), (100, false));
    // Another file follows: it is not any more, and what is torn is damage.
    let mut broken = bytes.clone();
    let (at, _, length) = chunks[chunks.len() / 3];
    broken[at + 9 + length / 2] ^= 0xff;
    fs::write(path(1), &broken).unwrap();
    while follower.read_on(LIMIT).unwrap() {}
    let both = summary(&follower.gathered);
    assert!(follower.is_closed() && follower.torn() == 0);
    assert_eq!(both["damaged"], 2, "the torn chunk and the broken one: {:?}", follower.gathered.damage);
    assert!(both["frames"] > half["frames"] && both["last frame"] == all["last frame"], "{both:?}");
    // A length that is too large hides the rest of a file from nobody.
    let alone = folder.path().join("alone.mcap");
    let mut wild = bytes.clone();
    wild[at + 8] = 0x7f;
    fs::write(&alone, &wild).unwrap();
    let mut follower = Follower::new(&alone);
    while follower.read_on(LIMIT).unwrap() {}
    assert!(follower.gathered.damaged > 0 && follower.gathered.last_frame == all["last frame"]);
}

#[test]
fn watch_prints_one_picture_and_says_why_it_cannot() {
    let run = unwatched().to_str().unwrap();
    let folder = tempfile::tempdir().unwrap();
    let output = adagio(folder.path(), &["watch", run, "--once"]);
    assert!(output.status.success(), "{}", stderr(&output));
    let shown = stdout(&output);
    for text in [
        "smoke, seed 1  over  frame 2 000, action 400 of 400",
        "of centre: value, where it turns to",
        "features of model",
        "300 of 300 support vectors, full",
        "frames/s",
    ] {
        assert!(shown.contains(text), "{text:?} in\n{shown}");
    }
    assert!(shown.matches(['→', '↗', '↑', '↖', '←', '↙', '↓', '↘']).count() > 10, "arrows of the policy:\n{shown}");
    // The log alone is as good: its checkpoint is in it.
    let log = unwatched().join("run_000.mcap");
    let output = adagio(folder.path(), &["watch", log.to_str().unwrap(), "--once"]);
    assert_eq!(stdout(&output), shown, "{}", stderr(&output));

    let output = adagio(folder.path(), &["watch", run]);
    assert_eq!(output.status.code(), Some(2), "{}", stderr(&output));
    assert!(stderr(&output).contains("--once"), "{}", stderr(&output));
    let output = adagio(folder.path(), &["watch", "nothing", "--once"]);
    assert_eq!(output.status.code(), Some(1), "{}", stderr(&output));
    fs::write(folder.path().join("empty.mcap"), "").unwrap();
    let output = adagio(folder.path(), &["watch", "empty.mcap", "--once"]);
    assert!(output.status.success() && stdout(&output).contains("no poses in the log yet"), "{}", stderr(&output));
}
