//! `nav2_msgs/action/NavigateToPose`: existing clients send the robot somewhere, and hear how that goes.

use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use crossbeam_channel::Sender;
use ros2_client::action::{AsyncActionServer, GoalEndStatus, NewGoalHandle};
use ros2_client::{ActionTypeName, Message};
use serde::{Deserialize, Serialize};
use tokio::time::timeout;

use super::graph::{Graph, LinkError};
use super::listen::Ear;
use super::request::{Errand, Progress, Request};
use crate::log::messages::{Header, Pose, PoseStamped, Time};

/// Time between two looks, and two tellings.
const LOOK: Duration = Duration::from_millis(100);
const TELL: Duration = Duration::from_secs(1);

/// How long a client may take to ask for the result.
const PATIENCE: Duration = Duration::from_secs(5);

/// Where to.
#[derive(Debug, Clone, Default, Serialize, Deserialize)]
struct Goal {
    pose: PoseStamped,
    behavior_tree: String,
}

impl Message for Goal {}

/// How it ended.
#[derive(Debug, Clone, Default, Serialize, Deserialize)]
struct Outcome {
    error_code: u16,
    error_msg: String,
}

impl Message for Outcome {}

/// How it goes.
#[derive(Debug, Clone, Default, Serialize, Deserialize)]
struct Feedback {
    current_pose: PoseStamped,
    navigation_time: Time,
    estimated_time_remaining: Time,
    number_of_recoveries: i16,
    distance_remaining: f32,
}

impl Message for Feedback {}

type Server = AsyncActionServer<Goal, Outcome, Feedback>;

/// Serve the action under a name.
pub fn navigate(graph: &mut Graph, topic: &str, asked: Sender<Request>, errand: Errand) -> Result<Ear, LinkError> {
    let kind = ActionTypeName::new("nav2_msgs", "NavigateToPose");
    let server: Server = AsyncActionServer::new(graph.serve(topic, &kind)?);
    Ok(Box::new(move |over| {
        Box::pin(async move {
            let mut next = None;
            while !over.load(Ordering::Relaxed) {
                let new = match next.take() {
                    Some(new) => Some(new),
                    None => timeout(LOOK, server.receive_new_goal()).await.ok().and_then(Result::ok),
                };
                if let Some(new) = new {
                    next = go(&server, new, &asked, &errand, &over).await;
                }
            }
        })
    }))
}

/// One goal, until it is reached, given up or replaced by another one: that.
async fn go(
    server: &Server,
    new: NewGoalHandle<Goal>,
    asked: &Sender<Request>,
    errand: &Errand,
    over: &AtomicBool,
) -> Option<NewGoalHandle<Goal>> {
    let goal = server.get_new_goal(new.clone())?;
    let accepted = server.accept_goal(new).await.ok()?;
    let executing = server.start_executing_goal(accepted).await.ok()?;
    let position = &goal.pose.pose.position;
    errand.set(Progress::Waiting);
    // Nobody drives where the run has ended.
    let _ = asked.send(Request::GoalPose([position.x, position.y]));
    let (begun, mut told, mut next) = (Instant::now(), Instant::now(), None);
    let (status, outcome) = loop {
        let failed = |reason: &str| (GoalEndStatus::Aborted, Outcome { error_code: 1, error_msg: reason.to_owned() });
        if over.load(Ordering::Relaxed) {
            break failed("the run is over");
        }
        if let Ok(Ok(newer)) = timeout(LOOK, server.receive_new_goal()).await {
            next = Some(newer);
            break failed("another goal has replaced it");
        }
        if let Ok(Ok(cancel)) = timeout(LOOK, server.receive_cancel_request()).await {
            let id = executing.goal_id();
            let answered = server.respond_to_cancel_requests(&cancel, std::iter::once(id)).await.is_ok();
            if cancel.contains_goal(&id) && answered {
                let _ = asked.send(Request::Goto(String::new()));
                break (GoalEndStatus::Canceled, Outcome::default());
            }
        }
        match errand.now() {
            Progress::Arrived => break (GoalEndStatus::Succeeded, Outcome::default()),
            Progress::Refused(reason) => break failed(&reason),
            Progress::Going(Some([x, y, heading])) if told.elapsed() >= TELL => {
                told = Instant::now();
                let current_pose = PoseStamped { header: Header::new(0, "map"), pose: Pose::planar(x, y, heading) };
                let distance_remaining = (position.x - x).hypot(position.y - y) as f32;
                let navigation_time = Time::new(begun.elapsed().as_nanos() as u64);
                let feedback = Feedback { current_pose, navigation_time, distance_remaining, ..Feedback::default() };
                // A client that has gone hears nothing.
                let _ = server.publish_feedback(executing.clone(), feedback).await;
            }
            _ => {}
        }
    };
    let _ = timeout(PATIENCE, server.send_result_response(executing, status, outcome)).await;
    next
}
