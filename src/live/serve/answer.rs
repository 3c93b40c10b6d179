//! What each request is answered.

use std::convert::Infallible;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Duration;

use http_body_util::{BodyExt, Full, Limited};
use hyper::body::{Bytes, Incoming};
use hyper::header::{
    ALLOW, CACHE_CONTROL, CONTENT_SECURITY_POLICY, CONTENT_TYPE, HeaderValue, REFERRER_POLICY, X_CONTENT_TYPE_OPTIONS,
};
use hyper::{Method, Request, Response, StatusCode};
use serde::Deserialize;

use super::{Shared, bytes};
use crate::agent::Marking;
use crate::live::ask::goal_move;
use crate::source::{MarkKind, parse_goto, parse_mark};

/// Most bytes of a request's body, and longest time for it.
const MOST_BODY: usize = 1 << 10;
const BODY_TIME: Duration = Duration::from_secs(5);

const JSON: &str = "application/json";

/// Why a request is refused.
type Refused = (StatusCode, String);

/// What is answered where there is nothing to say.
const DONE: Bytes = Bytes::from_static(b"{}");

/// Answer a request. It never fails; the error is what hyper wants to hear.
pub async fn answer(request: Request<Incoming>, shared: Arc<Shared>) -> Result<Response<Full<Bytes>>, Infallible> {
    let (parts, body) = request.into_parts();
    let path = parts.uri.path();
    if let Err((status, text)) = shared.guard.admit(&parts.method, &parts.uri, &parts.headers) {
        return Ok(refused(status, text));
    }
    let gets = ["/", "/now", "/curves", "/maps"].contains(&path);
    let posts = ["/pause", "/resume", "/stop", "/goal", "/goto", "/mark", "/release"].contains(&path);
    let allowed = if gets { Method::GET } else { Method::POST };
    if !gets && !posts {
        return Ok(refused(StatusCode::NOT_FOUND, "there is no such page"));
    }
    if parts.method != allowed {
        let mut response = refused(StatusCode::METHOD_NOT_ALLOWED, "this is not how it is asked for");
        if let Ok(allowed) = HeaderValue::from_str(allowed.as_str()) {
            response.headers_mut().insert(ALLOW, allowed);
        }
        return Ok(response);
    }
    shared.ask();
    let answer = match path {
        "/" => {
            let page = Bytes::from_static(shared.page.html.as_bytes());
            let mut response = response(StatusCode::OK, "text/html; charset=utf-8", page);
            if let Ok(policy) = HeaderValue::from_str(&shared.page.policy) {
                response.headers_mut().insert(CONTENT_SECURITY_POLICY, policy);
            }
            return Ok(response);
        }
        "/now" => {
            let published = shared.published();
            let known =
                parts.uri.query().and_then(|query| query.split('&').find_map(|pair| pair.strip_prefix("since=")));
            if known.and_then(|known| known.parse().ok()) == Some(published.version) {
                return Ok(response(StatusCode::NO_CONTENT, JSON, Bytes::new()));
            }
            Ok(published.now.clone())
        }
        "/curves" => Ok(shared.published().curves.clone()),
        "/maps" => Ok(shared.published().maps.clone()),
        "/goal" => read(body).await.and_then(|body| move_goal(&shared, &body)).map(|()| DONE),
        "/goto" => read(body).await.and_then(|body| goto(&shared, &body)).map(|()| DONE),
        "/mark" => read(body).await.and_then(|body| mark(&shared, &body)).map(|()| DONE),
        _ => {
            match path {
                "/pause" => shared.controls.pause(true),
                "/resume" => shared.controls.pause(false),
                "/release" => shared.controls.release(),
                _ => shared.stop.store(true, Ordering::Relaxed),
            }
            Ok(DONE)
        }
    };
    Ok(match answer {
        Ok(json) if json.is_empty() => response(StatusCode::NO_CONTENT, JSON, json),
        Ok(json) => response(StatusCode::OK, JSON, json),
        Err((status, text)) => refused(status, &text),
    })
}

/// The body of a request, if it is not too long and comes soon enough.
async fn read(body: Incoming) -> Result<Bytes, Refused> {
    let body = tokio::time::timeout(BODY_TIME, Limited::new(body, MOST_BODY).collect()).await;
    let body = body.map_err(|_| (StatusCode::REQUEST_TIMEOUT, "the request took too long".to_owned()))?;
    let too_long = |_| (StatusCode::PAYLOAD_TOO_LARGE, format!("a request has at most {MOST_BODY} bytes"));
    Ok(body.map_err(too_long)?.to_bytes())
}

fn wrong(text: String) -> Refused {
    (StatusCode::BAD_REQUEST, text)
}

/// What a body asks for; otherwise the text says what it is not.
fn wanted<'a, T: Deserialize<'a>>(body: &'a [u8], not: &str) -> Result<T, Refused> {
    serde_json::from_slice(body).map_err(|error| wrong(format!("{not}: {error}")))
}

/// Where a goal shall be.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct PageRequest {
    /// Name of the task.
    task: String,
    x: f64,
    y: f64,
}

fn move_goal(shared: &Shared, body: &[u8]) -> Result<(), Refused> {
    let not = "this is no place for a goal, {\"task\": NAME, \"x\": M, \"y\": M}";
    let wanted: PageRequest = wanted(body, not)?;
    let Some(task) = shared.scenario.tasks.iter().position(|task| task.name == wanted.task) else {
        let names: Vec<&str> = shared.scenario.tasks.iter().map(|task| task.name.as_str()).collect();
        return Err(wrong(format!("there is no task {:?}: there are {}", wanted.task, names.join(", "))));
    };
    let wanted = goal_move(&shared.scenario, &shared.plan, task, [wanted.x, wanted.y]).map_err(wrong)?;
    let busy = |error: crate::agent::TooMany| (StatusCode::SERVICE_UNAVAILABLE, error.to_string());
    shared.controls.move_goal(wanted).map_err(busy)
}

/// Where the robot shall go.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct GotoRequest {
    /// Name of the task; nothing for wherever the schedule has it go.
    task: String,
}

fn goto(shared: &Shared, body: &[u8]) -> Result<(), Refused> {
    let wanted: GotoRequest = wanted(body, "this is nowhere to go to, {\"task\": NAME}")?;
    shared.controls.send(parse_goto(&wanted.task, &shared.scenario).map_err(wrong)?);
    Ok(())
}

/// What is to be marked.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct MarkRequest {
    /// Name of a task that is shown.
    task: String,
    how: How,
}

#[derive(Debug, Deserialize)]
#[serde(rename_all = "lowercase")]
enum How {
    Hold,
    Release,
    Turn,
    Forget,
}

fn mark(shared: &Shared, body: &[u8]) -> Result<(), Refused> {
    let not = "this is no mark, {\"task\": NAME, \"how\": \"hold\" | \"release\" | \"turn\" | \"forget\"}";
    let wanted: MarkRequest = wanted(body, not)?;
    let mark = parse_mark(&wanted.task, &shared.scenario).map_err(wrong)?;
    if mark.kind == MarkKind::Forget {
        return Err(wrong("to forget is not part of the name: \"how\" says it".to_owned()));
    }
    let circle = (360.0 / shared.scenario.robot.turn_deg).round().max(1.0) as usize;
    let how = match wanted.how {
        How::Hold => Marking::Hold,
        How::Release => Marking::Release,
        How::Turn => Marking::Turn(circle),
        How::Forget => Marking::Forget,
    };
    shared.controls.mark(mark.task, how);
    Ok(())
}

pub fn refused(status: StatusCode, text: &str) -> Response<Full<Bytes>> {
    response(status, JSON, bytes(&serde_json::json!({ "error": text })))
}

pub fn response(status: StatusCode, kind: &'static str, body: Bytes) -> Response<Full<Bytes>> {
    let mut response = Response::new(Full::new(body));
    *response.status_mut() = status;
    let headers = response.headers_mut();
    headers.insert(CONTENT_TYPE, HeaderValue::from_static(kind));
    headers.insert(CACHE_CONTROL, HeaderValue::from_static("no-store"));
    headers.insert(X_CONTENT_TYPE_OPTIONS, HeaderValue::from_static("nosniff"));
    // The first address holds the token.
    headers.insert(REFERRER_POLICY, HeaderValue::from_static("no-referrer"));
    response
}
