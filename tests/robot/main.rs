//! A robot on a ROS 2 network, played by rclpy: the other side is ROS's own.
//!
//! `ADAGIO_ROS_PYTHON` names a Python with the packages `ros-rclpy`, `ros-rmw-fastrtps-cpp` and their messages; without it nothing is
//! tested here, and with `ADAGIO_REQUIRE_ROS=1` that is a failure. Each test has a DDS domain of its own, on loopback.

#[path = "../common/mod.rs"]
mod common;

use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::sync::mpsc::{Receiver, channel};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use adagio::log::{LogReader, Record, messages};
use ros2_client::action::ActionClientQosPolicies;
use ros2_client::action_msgs::GoalStatusEnum;
use ros2_client::qos::{Durability, History};
use ros2_client::{ActionTypeName, Context, ContextOptions, Name, NodeName, NodeOptions, QosProfile, ServiceMapping};

use common::{adagio, package_file, report, stderr, stdout};
use serde_json::Value;

/// One robot at a time: they live in real time, and a velocity that comes late is a fault.
static ALONE: Mutex<()> = Mutex::new(());

fn alone() -> MutexGuard<'static, ()> {
    ALONE.lock().unwrap_or_else(PoisonError::into_inner)
}

/// A DDS domain for a test of this process; another process has others, most likely.
fn domain(test: u16) -> u16 {
    (std::process::id() % 11) as u16 * 9 + test
}

/// A Python with rclpy; none where there is none for this machine.
fn python() -> Option<PathBuf> {
    let python = std::env::var_os("ADAGIO_ROS_PYTHON").map(PathBuf::from);
    if python.is_none() {
        let required = std::env::var("ADAGIO_REQUIRE_ROS").is_ok_and(|value| value == "1");
        assert!(!required, "ADAGIO_ROS_PYTHON names no Python with rclpy, and ADAGIO_REQUIRE_ROS is set");
        println!("skipped: ADAGIO_ROS_PYTHON names no Python with rclpy");
    }
    python
}

/// A robot that rclpy plays; it ends with the test.
struct Peer(Option<Child>);

impl Peer {
    fn start(python: &Path, domain: u16, arguments: &[&str]) -> Self {
        Peer::program(python, "faulty.py", domain, arguments)
    }

    fn program(python: &Path, name: &str, domain: u16, arguments: &[&str]) -> Self {
        let child = Command::new(python)
            .arg(package_file("tests/robot").join(name))
            .args(arguments)
            .current_dir(env!("CARGO_TARGET_TMPDIR")) // ViZDoom leaves a folder there
            .env("ROS_DOMAIN_ID", domain.to_string())
            .env("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .process_group(0) // its own children, as ViZDoom's game, end with it
            .spawn()
            .unwrap();
        Peer(Some(child))
    }

    /// What it says at its end; it is not waited for longer than so many seconds.
    fn end(mut self, seconds: u64) -> Output {
        ended(self.0.take().unwrap(), seconds)
    }
}

impl Drop for Peer {
    fn drop(&mut self) {
        if let Some(mut child) = self.0.take() {
            let group = format!("-{}", child.id());
            let _ = Command::new("kill").args(["-KILL", "--", &group]).stderr(Stdio::null()).status();
            let _ = child.wait();
        }
    }
}

/// What a program says at its end; after so many seconds it is killed.
fn ended(mut child: Child, seconds: u64) -> Output {
    let begun = Instant::now();
    while child.try_wait().unwrap().is_none() {
        if begun.elapsed() > Duration::from_secs(seconds) {
            let _ = child.kill();
            let output = child.wait_with_output().unwrap();
            panic!("it does not end within {seconds} s: {}{}", stdout(&output), stderr(&output));
        }
        std::thread::sleep(Duration::from_millis(20));
    }
    child.wait_with_output().unwrap()
}

fn arguments<'a>(command: &[&'a str], domain: &'a str, sets: &[&'a str]) -> Vec<&'a str> {
    let mut all = command.to_vec();
    for &set in [domain].iter().chain(sets) {
        all.extend(["--set", set]);
    }
    all
}

/// Begins a run of the scenario in a folder, on a domain.
fn begin(folder: &Path, domain: u16, sets: &[&str]) -> Child {
    let scenario = package_file("scenarios/ros2.toml").display().to_string();
    let domain = format!("ros2.domain={domain}");
    let command = ["run", scenario.as_str(), "--quiet", "--no-report", "--out", "run"];
    Command::new(env!("CARGO_BIN_EXE_adagio"))
        .current_dir(folder)
        .args(arguments(&command, &domain, sets))
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap()
}

/// A run of the scenario in a folder, on a domain.
fn run(folder: &Path, domain: u16, sets: &[&str]) -> Output {
    ended(begin(folder, domain, sets), 600)
}

/// Faults at moments of the peer's choice, in an order that follows from the seed: the peer sees every velocity, and judges.
fn plays_faults(domain: u16, seed: &str, kinds: &str, count: &str, sets: &[&str]) {
    let (Some(python), _alone) = (python(), alone()) else { return };
    let folder = tempfile::tempdir().unwrap();
    let peer = Peer::start(&python, domain, &["--seed", seed, "--kinds", kinds, "--faults", count, "--patience", "60"]);
    let child = begin(folder.path(), domain, sets);
    let said = peer.end(300);
    let verdicts: Vec<Value> = stdout(&said)
        .lines()
        .filter_map(|line| serde_json::from_str(line).ok())
        .filter(|v: &Value| !v["kind"].is_null())
        .collect();
    // The robot is gone: the run waits for it, and ends when it is told to.
    let _ = Command::new("kill").args(["-INT", &child.id().to_string()]).status().unwrap();
    let output = ended(child, 60);
    assert!(output.status.success(), "{}", stderr(&output));
    println!("{}", stdout(&said));
    assert_eq!(verdicts.len(), count.parse::<usize>().unwrap(), "{}{}", stdout(&said), stderr(&said));
    for verdict in &verdicts {
        assert_eq!((&verdict["ok"], &verdict["violations"]), (&Value::Bool(true), &Value::from(0)), "{verdict}");
    }
    assert!(said.status.success(), "{}{}", stdout(&said), stderr(&said));
    // What was learned from is in the log as it was: it is learned again, bit for bit.
    assert!(report(&folder.path().join("run"))["run"]["actions"].as_u64().unwrap() > 5);
    let verified = adagio(folder.path(), &["replay", "run", "--verify", "--quiet", "--no-report"]);
    assert!(verified.status.success(), "{}{}", stdout(&verified), stderr(&verified));
}

#[test]
fn sensors_that_stop_freeze_are_late_or_lie_stop_the_robot_and_it_goes_on() {
    let kinds = "camera_stop,camera_freeze,camera_late,camera_size,odom_stop,nan,stamp_jump,pause,camera_slightly_late,out_of_order,twice";
    plays_faults(domain(0), "1", kinds, "11", &[]);
}

#[test]
fn emergency_stops_and_scans_stop_the_robot_and_it_goes_on() {
    let sets = ["ros2.emergency_stop=/emergency_stop", "ros2.scan=/scan"];
    plays_faults(domain(1), "2", "estop,scan_stop", "4", &sets);
}

#[test]
fn a_driver_that_is_stopped_or_killed_leaves_a_robot_that_stands_and_goes_on() {
    let (Some(python), _alone) = (python(), alone()) else { return };
    let folder = tempfile::tempdir().unwrap();
    let path = |path: PathBuf| path.display().to_string();
    let (scenario, out) = (path(package_file("scenarios/ros2.toml")), path(folder.path().join("run")));
    let domain_set = format!("ros2.domain={}", domain(8));
    let faults = ["--seed", "3", "--kinds", "agent_stop,agent_kill", "--faults", "4", "--patience", "60"];
    let driver = [
        "--driver",
        env!("CARGO_BIN_EXE_adagio"),
        "run",
        &scenario,
        "--out",
        &out,
        "--quiet",
        "--no-report",
        "--set",
        &domain_set,
    ];
    let said = Peer::start(&python, domain(8), &[&faults[..], &driver[..]].concat()).end(300);
    assert!(said.status.success(), "{}{}", stdout(&said), stderr(&said));
    assert_eq!(stdout(&said).matches("\"ok\": true").count(), 4, "{}", stdout(&said));
    let verified = adagio(folder.path(), &["replay", "run", "--verify", "--quiet", "--no-report"]);
    assert!(verified.status.success(), "{}{}", stdout(&verified), stderr(&verified));
}

#[test]
fn velocities_have_the_type_that_is_listened_to() {
    let (Some(python), _alone) = (python(), alone()) else { return };
    let folder = tempfile::tempdir().unwrap();
    let stamped = ["--stamped", "--kinds", "twice", "--faults", "50", "--patience", "60"];
    let peer = Peer::start(&python, domain(2), &stamped);
    let ran = run(folder.path(), domain(2), &["actions=12"]);
    assert!(ran.status.success(), "{}", stderr(&ran));
    assert_eq!(report(&folder.path().join("run"))["run"]["actions"], 12);
    drop(peer);
}

#[test]
fn people_with_ros_tools_hear_of_the_run_stop_it_drive_and_send_it() {
    let (Some(python), _alone) = (python(), alone()) else { return };
    let folder = tempfile::tempdir().unwrap();
    let _peer = Peer::start(&python, domain(4), &["--kinds", "twice", "--faults", "500", "--patience", "60"]);
    let person = Peer::program(&python, "person.py", domain(4), &["--task", "centre"]);
    let ran = run(folder.path(), domain(4), &["ros2.teleop=/cmd_vel_teleop", "ros2.wait_seconds=30"]);
    assert!(ran.status.success(), "{}", stderr(&ran));
    let said = person.end(60);
    assert!(said.status.success(), "{}{}", stdout(&said), stderr(&said));
    let heard: Value = serde_json::from_str(&stdout(&said)).unwrap();
    assert!(heard["paused_way"].as_f64().unwrap() < 0.01, "{heard}");
    assert_eq!(heard["observation"], serde_json::json!([32, 16, 1536]));
    assert_eq!(heard["markers"], serde_json::json!(["goals", "robot", "way"]));
    assert_eq!(heard["parts"], serde_json::json!(["losses", "program", "robot", "run"]));
    assert!(heard["refusal"].as_str().unwrap().contains("centre, corner"), "{heard}");
    // It was asked for in the log; and what a person drove was learned from, as actions.
    let (mut sent, mut moved, mut states, mut ends) = (Vec::new(), 0, Vec::new(), Vec::new());
    for record in LogReader::open(&folder.path().join("run/run_000.mcap")).unwrap() {
        let record = record.unwrap();
        let Record::Message { topic, .. } = &record else { continue };
        match &**topic {
            "/adagio/goto" => sent.push(record.decode::<messages::Text>().unwrap().data),
            "/adagio/goal" => moved += 1,
            "/robot/state" => {
                let state = record.decode::<messages::RobotState>().unwrap();
                states.push((state.header.stamp_ns(), state.state == "driven by a person"));
            }
            "/adagio/transition" => ends.push(record.decode::<messages::Transition>().unwrap().header.stamp_ns()),
            _ => {}
        }
    }
    assert_eq!((sent, moved), (vec!["centre".to_owned()], 1));
    // The two are written by different actors: their order is that of their stamps.
    let is_by_hand =
        |end: &&u64| states.iter().rev().find(|(from, _)| from < *end).is_some_and(|(_, by_hand)| *by_hand);
    let by_hand = ends.iter().filter(is_by_hand).count();
    assert!(by_hand >= 4, "{by_hand} actions by hand: 3.6 rad were driven at least");
    let verified = adagio(folder.path(), &["replay", "run", "--verify", "--quiet", "--no-report"]);
    assert!(verified.status.success(), "{}{}", stdout(&verified), stderr(&verified));
}

#[test]
fn what_is_wrong_is_said_in_one_line_that_names_what_is_there() {
    let (Some(python), _alone) = (python(), alone()) else { return };
    let folder = tempfile::tempdir().unwrap();
    let _peer = Peer::start(&python, domain(3), &["--kinds", "twice", "--faults", "1", "--patience", "120"]);
    let refused = |sets: &[&str], parts: &[&str]| {
        let output = run(folder.path(), domain(3), &[&["ros2.wait_seconds=4"], sets].concat());
        let said = stderr(&output);
        assert_eq!(output.status.code(), Some(2), "{sets:?}: {said}");
        for part in parts {
            assert!(said.contains(part), "{sets:?}: {part:?} is not in {said}");
        }
        assert!(!folder.path().join("run").exists(), "nothing is left behind");
    };
    // The first one may wait until the robot is there.
    let there = "/camera/image_raw (sensor_msgs/msg/Image)";
    refused(
        &["ros2.wait_seconds=20", "ros2.camera=/front"],
        &["ros2.camera = \"/front\"", "nobody publishes it", there],
    );
    refused(&["ros2.odometry=/scan"], &["ros2.odometry = \"/scan\" is published as sensor_msgs/msg/LaserScan"]);
    refused(
        &["ros2.command=/wheels"],
        &["ros2.command = \"/wheels\": nobody listens to it", "/cmd_vel (geometry_msgs/msg/Twist)"],
    );
    refused(&["vision.width=100", "vision.height=10"], &["ros2.camera = \"/camera/image_raw\"", "64"]);
    let scenario = package_file("scenarios/ros2.toml").display().to_string();
    let command = ["doctor", "ros2", scenario.as_str(), "--json", "--picture", "first.png"];
    let output = adagio(folder.path(), &arguments(&command, &format!("ros2.domain={}", domain(3)), &[]));
    let doctor: Value = serde_json::from_str(&stdout(&output)).unwrap();
    assert!(output.status.success(), "{}", stderr(&output));
    let camera = &doctor["heard"]["/camera/image_raw"];
    assert!((25.0..35.0).contains(&camera["hz"].as_f64().unwrap()), "{camera}");
    let picture = image::open(folder.path().join("first.png")).unwrap();
    assert_eq!((picture.width(), picture.height()), (64, 48));
}

/// `nav2_msgs/action/NavigateToPose` as its clients have it.
mod nav2 {
    use adagio::log::messages::{PoseStamped, Time};
    use ros2_client::Message;
    use serde::{Deserialize, Serialize};

    #[derive(Debug, Clone, Serialize, Deserialize)]
    pub struct Goal {
        pub pose: PoseStamped,
        pub behavior_tree: String,
    }
    impl Message for Goal {}

    #[derive(Debug, Clone, Serialize, Deserialize)]
    pub struct Outcome {
        pub error_code: u16,
        pub error_msg: String,
    }
    impl Message for Outcome {}

    #[derive(Debug, Clone, Serialize, Deserialize)]
    pub struct Feedback {
        pub current_pose: PoseStamped,
        pub navigation_time: Time,
        pub estimated_time_remaining: Time,
        pub number_of_recoveries: i16,
        pub distance_remaining: f32,
    }
    impl Message for Feedback {}
}

/// A client that sends the robot to places, one after the other: how each ended, and how often it heard how that went. On a
/// thread of its own, which nobody waits for if it hangs.
fn navigate(domain: u16, places: &'static [[f64; 2]]) -> Receiver<(GoalStatusEnum, String, usize)> {
    let (told, heard) = channel();
    std::thread::spawn(move || {
        let context = Context::with_options(ContextOptions::new().domain_id(domain)).unwrap();
        let mut node = context.new_node(NodeName::new("/", "client").unwrap(), NodeOptions::new()).unwrap();
        let qos = QosProfile::publisher_default();
        let qos = qos.durability(Durability::Volatile).history(History::KeepLast { depth: 10 });
        let policies = ActionClientQosPolicies {
            goal_service: qos.clone(),
            result_service: qos.clone(),
            cancel_service: qos.clone(),
            feedback_subscription: qos.clone(),
            status_subscription: qos,
        };
        let (name, kind) =
            (Name::parse("/navigate_to_pose").unwrap(), ActionTypeName::new("nav2_msgs", "NavigateToPose"));
        let client = node.create_action_client::<nav2::Goal, nav2::Outcome, nav2::Feedback>(
            ServiceMapping::Enhanced,
            &name,
            &kind,
            policies,
        );
        let client = client.unwrap();
        for &[x, y] in places {
            let mut pose = messages::PoseStamped { header: messages::Header::new(0, "map"), ..Default::default() };
            (pose.pose.position.x, pose.pose.position.y, pose.pose.orientation.w) = (x, y, 1.0);
            // What is asked before the run is there is lost: it is asked again.
            let id = loop {
                let goal = nav2::Goal { pose: pose.clone(), behavior_tree: String::new() };
                let (request, id) = client.send_goal(goal).unwrap();
                let (begun, mut answer) = (Instant::now(), None);
                while answer.is_none() && begun.elapsed() < Duration::from_secs(2) {
                    answer = client.receive_goal_response(request).unwrap();
                    std::thread::sleep(Duration::from_millis(20));
                }
                if answer.is_some_and(|answer| answer.accepted) {
                    break id;
                }
            };
            let (request, mut feedback) = (client.request_result(id).unwrap(), 0);
            let (status, outcome) = loop {
                feedback += usize::from(client.receive_feedback(id).unwrap().is_some());
                if let Some(ended) = client.receive_result(request).unwrap() {
                    break ended;
                }
                std::thread::sleep(Duration::from_millis(50));
            };
            told.send((status, outcome.error_msg, feedback)).unwrap();
        }
    });
    heard
}

/// There is no package of this action for rclpy without ROS: the client is of the same crate as the server.
#[test]
fn a_client_of_nav2_sends_it_somewhere_and_hears_how_that_goes() {
    let (Some(python), _alone) = (python(), alone()) else { return };
    let folder = tempfile::tempdir().unwrap();
    let _peer = Peer::start(&python, domain(5), &["--kinds", "twice", "--faults", "500", "--patience", "200"]);
    let path = folder.path().to_owned();
    // It begins in the first place, and is to say so before there is a model. The second one lies ahead, where it explores: models of a
    // few dozen frames know next to nothing.
    let sets = [
        "task.0.radius=1.2",
        "dictionary.sigma_frames=40",
        "agent.resolve_frames=40",
        "agent.latency_frames=5",
        "policy.pursue_timeout=15",
        "policy.explore_length=15",
    ];
    let ran = std::thread::spawn(move || run(&path, domain(5), &sets));
    let heard = navigate(domain(5), &[[99.0, 1.0], [2.4, 1.5], [3.6, 1.5]]);
    let next = || heard.recv_timeout(Duration::from_secs(400)).expect("a result");
    let (status, reason, _) = next();
    assert_eq!(status, GoalStatusEnum::Aborted);
    assert!(reason.contains("cannot be at (99, 1)"), "{reason}");
    // It waits where it was sent, and goes on where it is sent again.
    for _ in 0..2 {
        let (status, reason, feedback) = next();
        assert_eq!(status, GoalStatusEnum::Succeeded, "{reason}");
        println!("it is there, after {feedback} words of how it goes");
    }
    let called = Peer::program(&python, "call.py", domain(5), &["/adagio/stop"]).end(30);
    assert!(called.status.success(), "{}{}", stdout(&called), stderr(&called));
    let output = ran.join().unwrap();
    assert!(output.status.success(), "{}", stderr(&output));
}

/// A run in a world that others made, which a program of rclpy drives a robot through: its report.
fn drives_through(domain: u16, program: &str, arguments: &[&str], sets: &[&str]) -> Option<Value> {
    let (python, _alone) = (python()?, alone());
    let folder = tempfile::tempdir().unwrap();
    let _peer = Peer::program(&python, program, domain, arguments);
    let ran = run(folder.path(), domain, &[&["ros2.use_sim_time=true", "ros2.wait_seconds=60"], sets].concat());
    assert!(ran.status.success(), "{}", stderr(&ran));
    let verified = adagio(folder.path(), &["replay", "run", "--verify", "--quiet", "--no-report"]);
    assert!(verified.status.success(), "{}{}", stdout(&verified), stderr(&verified));
    Some(report(&folder.path().join("run")))
}

/// Fewer actions than in docs/robot.md: by then it knows its way, and not the shortest one.
#[test]
fn a_room_of_miniworld_is_learned_while_it_is_driven() {
    let sets = [
        "actions=1400",
        "policy.explore_share=0.7",
        "policy.explore_length=10",
        "policy.pursue_share=1.0",
        "agent.resolve_frames=1000",
        "agent.latency_frames=500",
    ];
    let Some(report) = drives_through(domain(6), "bridge.py", &["--speed", "16", "--seed", "1"], &sets) else { return };
    let (mut ended, mut reached) = (0, 0);
    for pursuits in report["pursuits"].as_array().unwrap() {
        ended += pursuits["ended"].as_u64().unwrap();
        reached += pursuits["reached"].as_u64().unwrap();
    }
    println!("{reached} of {ended} pursuits arrive");
    assert!(ended >= 10 && 4 * reached >= 3 * ended, "{reached} of {ended} pursuits arrive");
}

#[test]
fn a_labyrinth_of_vizdoom_is_driven_through() {
    let Some(report) = drives_through(domain(7), "doom.py", &["--speed", "8"], &["actions=60"]) else { return };
    assert_eq!(report["run"]["actions"], 60);
}
