//! Promise: robots that learn together act on what all have seen, get the same models each time, and go on without their learner.

use std::fs;
use std::io::{BufRead, BufReader, Read, Write};
use std::net::{TcpListener, TcpStream};
use std::path::Path;
use std::process::{Child, Command, ExitStatus, Stdio};
use std::sync::mpsc::{Receiver, channel};
use std::time::{Duration, Instant};

use serde_json::Value;

use crate::common::{adagio, package_file, report, stderr, stdout};

const LIMIT: Duration = Duration::from_secs(120);
const TOKEN: &str = "0123456789abcdef";
const NONE: [&str; 4] = ["--set", "evaluate.every=0", "--set", "evaluate.starts=20"];

/// A process that is killed when the test is over, and the lines that it writes to stderr.
struct Started {
    child: Child,
    lines: Receiver<String>,
    said: Vec<String>,
}

impl Started {
    fn new(folder: &Path, arguments: &[&str]) -> Self {
        let mut child = Command::new(env!("CARGO_BIN_EXE_adagio"))
            .current_dir(folder)
            .args(arguments)
            .env("ADAGIO_FLEET_TOKEN", TOKEN)
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        let (sender, lines) = channel();
        let stderr = BufReader::new(child.stderr.take().unwrap());
        std::thread::spawn(move || stderr.lines().map_while(Result::ok).try_for_each(|line| sender.send(line)));
        Started { child, lines, said: Vec::new() }
    }

    /// A learner of the smoke scenario at this port, and its address.
    fn learner(folder: &Path, name: &str, (port, robots): (u16, &str), arguments: &[&str]) -> (Self, String) {
        let (scenario, listen) = (package_file("scenarios/smoke.toml"), format!("127.0.0.1:{port}"));
        let mut all = vec!["fleet", scenario.to_str().unwrap(), "--out", name, "--listen", &listen, "--robots", robots];
        all.extend(["--no-evaluate"]);
        all.extend(arguments);
        let mut learner = Started::new(folder, &all);
        let address = learner.wait_for("robots: adagio run SCENARIO --fleet ").rsplit_once(' ').unwrap().1.to_owned();
        (learner, address)
    }

    fn robot(folder: &Path, seed: u64, address: &str, arguments: &[&str]) -> Self {
        let (scenario, out, seed) = (package_file("scenarios/smoke.toml"), format!("robot-{seed}"), format!("{seed}"));
        let mut all = vec!["run", scenario.to_str().unwrap(), "--no-report", "--seed", &seed, "--out", &out];
        all.extend(["--fleet", address]);
        all.extend(NONE);
        all.extend(arguments);
        Started::new(folder, &all)
    }

    /// The next line that holds a text.
    fn wait_for(&mut self, text: &str) -> String {
        let begin = Instant::now();
        while begin.elapsed() < LIMIT {
            let Ok(line) = self.lines.recv_timeout(LIMIT) else { break };
            self.said.push(line.clone());
            if line.contains(text) {
                return line;
            }
        }
        panic!("no {text:?} in {:#?}", self.said);
    }

    /// How it ended, and what it has said.
    fn end(mut self) -> (ExitStatus, String) {
        let begin = Instant::now();
        loop {
            self.said.extend(self.lines.try_iter());
            if let Some(status) = self.child.try_wait().unwrap() {
                self.said.extend(self.lines.iter());
                return (status, self.said.join("\n"));
            }
            assert!(begin.elapsed() < LIMIT, "it does not end: {:#?}", self.said);
            std::thread::sleep(Duration::from_millis(20));
        }
    }
}

impl Drop for Started {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

fn free_port() -> u16 {
    TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port()
}

/// Two robots and their learner, to the end: the digest that all of them have.
fn together(folder: &Path) -> Value {
    let (learner, address) = Started::learner(folder, "learner", (0, "2"), &[]);
    let robots = [1, 2].map(|seed| Started::robot(folder, seed, &address, &["--actions", "400"]));
    for ended in robots.map(Started::end).into_iter().chain([learner.end()]) {
        assert!(ended.0.success(), "{}", ended.1);
    }
    let said = report(&folder.join("learner"));
    assert_eq!(said["learned_from"]["frames"], 2 * 2001);
    assert_eq!(said["learned_from"]["robots"][1]["frames"], 2001);
    for robot in ["robot-1", "robot-2"] {
        let of_robot = report(&folder.join(robot));
        assert_eq!(of_robot["digest"], said["digest"]);
        assert_eq!(of_robot["dictionary"]["support_vectors"], said["dictionary"]["support_vectors"]);
    }
    said["digest"].clone()
}

#[test]
fn robots_that_learn_together_get_the_same_models_each_time() {
    let folders = [tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap()];
    let [one, two] = folders.each_ref().map(|folder| together(folder.path()));
    assert_eq!(one, two);
    let folder = folders[0].path();
    // What one has seen alone is less.
    let alone = adagio(folder, &["replay", "robot-1", "--out", "alone", "--no-report", "--quiet", "--no-evaluate"]);
    assert!(alone.status.success(), "{}", stderr(&alone));
    assert_ne!(report(&folder.join("alone"))["digest"], one);
    for (arguments, text) in [
        (&["replay", "robot-1", "--verify"][..], "were made of what other robots saw"),
        (&["resume", "robot-1"], "begin a new run with --fleet"),
    ] {
        let output = adagio(folder, arguments);
        assert!(output.status.code() == Some(1) && stderr(&output).contains(text), "{}", stderr(&output));
    }
    let tried = adagio(folder, &["evaluate", "learner", "--starts", "20"]);
    assert!(tried.status.success() && stdout(&tried).contains("centre"), "{}", stderr(&tried));
}

#[test]
fn robots_go_on_without_their_learner_and_hand_over_later_what_it_has_missed() {
    let folder = tempfile::tempdir().unwrap();
    let (folder, port) = (folder.path(), free_port());
    // States are kept after each model, and robots keep what is not in them.
    let kept = ["--set", "agent.snapshot_minutes=0.001"];
    let (mut learner, address) = Started::learner(folder, "learner", (port, "2"), &kept);
    let robots = [1, 2].map(|seed| Started::robot(folder, seed, &address, &["--actions", "3000"]));
    learner.wait_for("model 3 of");
    drop(learner);
    // Alone they are fast: they must not be over before the other learner is there.
    let (learner, _) = Started::learner(folder, "learner", (port, "2"), &kept);
    for ended in robots.map(Started::end).into_iter().chain([learner.end()]) {
        assert!(ended.0.success(), "{}", ended.1);
        assert!(!ended.1.contains("were not handed over"), "{}", ended.1);
    }
    let said = report(&folder.join("learner"));
    assert_eq!(said["learned_from"]["frames"], 2 * 15_001, "every frame, and each of them once");
    assert_eq!(report(&folder.join("robot-1"))["digest"], said["digest"]);
}

#[test]
fn a_robot_whose_learner_never_comes_back_drives_to_its_end_and_keeps_its_log() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let (mut learner, address) = Started::learner(folder, "learner", (0, "1"), &[]);
    let robot = Started::robot(folder, 1, &address, &["--actions", "2000"]);
    learner.wait_for("model 2 of");
    drop(learner);
    let (status, said) = robot.end();
    assert!(status.success(), "{said}");
    assert!(said.contains("were not handed over") && said.contains("adagio learn"), "{said}");
    let of_robot = report(&folder.join("robot-1"));
    assert_eq!(of_robot["run"]["actions"], 2000, "{of_robot}");
    let learned = adagio(folder, &["learn", "robot-1", "--out", "later", "--no-evaluate", "--quiet", "--json"]);
    assert!(learned.status.success(), "{}", stderr(&learned));
    let learned: Value = serde_json::from_str(&stdout(&learned)).unwrap();
    assert_eq!(learned["learned_from"]["frames"], 10_001);
}

/// Status and body of a request.
fn ask(address: &str, method: &str, path: &str, heads: &str, body: &[u8]) -> (u16, String) {
    let mut stream = TcpStream::connect(address).unwrap();
    stream.set_read_timeout(Some(LIMIT)).unwrap();
    let length = body.len();
    let head = format!(
        "{method} {path} HTTP/1.1\r\nHost: localhost\r\n{heads}Content-Length: {length}\r\nConnection: close\r\n\r\n"
    );
    stream.write_all(&[head.as_bytes(), body].concat()).unwrap();
    let mut answer = String::new();
    stream.read_to_string(&mut answer).unwrap();
    let (head, body) = answer.split_once("\r\n\r\n").unwrap();
    (head.split(' ').nth(1).unwrap().parse().unwrap(), body.to_owned())
}

#[test]
fn strangers_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let (learner, address) = Started::learner(folder, "learner", (0, "1"), &[]);
    let known = format!("Authorization: Bearer {TOKEN}\r\n");
    let wrong = "Authorization: Bearer fedcba9876543210\r\n";
    let paths = [("GET", "/"), ("GET", "/welcome"), ("GET", "/model?name=a&run=1"), ("PUT", "/robot?name=a&run=1")];
    for (method, path) in paths {
        assert_eq!(ask(&address, method, path, "", b"").0, 401, "{path}");
        assert_eq!(ask(&address, method, path, wrong, b"").0, 403, "{path}");
    }
    assert_eq!(ask(&address, "GET", "/model?name=a&run=1", &known, b"").0, 404, "nobody of this name has joined");
    assert_eq!(ask(&address, "PUT", "/robot?name=a&run=1", &known, b"").0, 200);
    assert_eq!(ask(&address, "PUT", "/robot?name=a&run=2", &known, b"").0, 409, "there is one of this name");
    assert_eq!(ask(&address, "PUT", "/batch?name=a&run=1", &known, b"no batch").0, 400);
    assert_eq!(ask(&address, "PUT", "/robot", &known, b"").0, 400);
    assert_eq!(ask(&address, "PUT", "/nothing?name=a&run=1", &known, b"").0, 404);
    let (_, status) = ask(&address, "GET", "/", &known, b"");
    assert_eq!(serde_json::from_str::<Value>(&status).unwrap()["robots"][0]["name"], "a");

    let scenario = fs::read_to_string(package_file("scenarios/smoke.toml")).unwrap();
    let path = folder.join("smoke.toml");
    fs::write(&path, scenario).unwrap();
    let run = |token: &str, address: &str, arguments: &[&str]| {
        let all = ["run", "smoke.toml", "--out", "robot", "--fleet", address, "--fleet-token", token];
        let output = adagio(folder, &[&all, arguments].concat());
        assert!(!folder.join("robot").exists(), "{}", stderr(&output));
        (output.status.code(), stderr(&output))
    };
    let (code, said) = run("fedcba9876543210", &address, &[]);
    assert!(code == Some(1) && said.contains("the token is not that"), "{said}");
    let other = ["--set", "slow.features=30", "--set", "robot.turn_deg=30", "--set", "task.1.radius=0.4"];
    let (code, said) = run(TOKEN, &address, &other);
    assert_eq!(code, Some(2), "{said}");
    for text in
        ["slow.features is 30, the learner's 60", "robot.turn_deg is 30.0, the learner's 45.0", "task.1.radius is 0.4"]
    {
        assert!(said.contains(text), "{text}: {said}");
    }
    drop(learner);
    let (code, said) = run(TOKEN, &address, &[]);
    assert!(code == Some(1) && said.contains("there is no learner at"), "{said}");
}
