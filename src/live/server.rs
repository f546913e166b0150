//! The dashboard and the machine interface, over HTTP.
//!
//! One thread of low priority serves all connections. An answer is made, from the latest state, when its reader can take it; a
//! connection that neither reads nor writes for a while is closed.

use super::access_control::{AccessControl, guard};
use super::annotated_video::AnnotatedVideo;
use super::commands::{Command, Commands};
use super::low_priority::lower_priority;
use super::metrics;
use super::shared_state::{Commanding, SharedState};
use super::status::Row;
use crate::error::{Error, Result};
use crate::geometry::Configuration;
use crate::record::model_json;
use crate::robot::{MAX_THETA, TableRow};
use axum::body::Body;
use axum::extract::rejection::QueryRejection;
use axum::extract::{DefaultBodyLimit, FromRef, Path, Query, Request, State};
use axum::http::StatusCode;
use axum::http::header::{CACHE_CONTROL, CONNECTION, CONTENT_TYPE, RETRY_AFTER};
use axum::response::sse::{Event, KeepAlive, Sse};
use axum::response::{IntoResponse, Response};
use axum::routing::{get, post};
use axum::{Json, Router, middleware};
use futures_util::stream::{Stream, unfold};
use hyper::server::conn::http1;
use hyper_util::rt::{TokioIo, TokioTimer};
use hyper_util::service::TowerToHyperService;
use serde::Deserialize;
use serde_json::json;
use std::collections::VecDeque;
use std::convert::Infallible;
use std::net::SocketAddr;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::{OwnedSemaphorePermit, Semaphore};
use tokio::task::AbortHandle;
use tokio_io_timeout::TimeoutStream;

/// Connections at a time; further ones are refused. Convention: a resource limit.
const MAX_CONNECTIONS: usize = 128;
/// Of them, streams of events or pictures, which last as long as their reader likes; further ones are refused. Convention: a resource
/// limit that leaves room for answers.
const MAX_STREAMS: usize = 64;
/// What a connection beyond the limit is told.
///
/// Source: RFC 9110, sections 10.2.3 and 15.6.4.
const NO_ROOM: &[u8] =
    b"HTTP/1.1 503 Service Unavailable\r\nConnection: close\r\nRetry-After: 10\r\nContent-Length: 0\r\n\r\n";
/// A connection that has not sent its request's head by then is closed.
///
/// Convention: a timeout; so long can connections that send nothing keep others out.
const HEADER_TIMEOUT: Duration = Duration::from_secs(2);
/// Time that a connection takes to make room for another.
///
/// Convention: a timeout.
const MAKE_ROOM: Duration = Duration::from_millis(20);
/// So is one that does not take what it asked for. Convention.
///
/// Convention: a timeout.
const WRITE_TIMEOUT: Duration = Duration::from_secs(15);
/// Longest head of a request, bytes. Convention: a resource limit.
const MAX_HEAD: usize = 16 << 10;
/// Longest body of a request, bytes. Convention: a resource limit; no request needs one.
const MAX_BODY: usize = 4096;
/// Time before another connection is accepted after that failed, as where handles run out. Convention.
///
/// Convention: a timeout.
const ACCEPT_RETRY: Duration = Duration::from_millis(100);
/// Time between two events of `GET /api/events`. Convention: a display choice.
const EVENT_EVERY: Duration = Duration::from_millis(200);
/// Rows in one answer. Convention: a resource limit.
const MAX_ROWS: usize = 2000;
/// Rows in one event. Convention: a resource limit.
const MAX_EVENT_ROWS: usize = 500;

/// What answers are made from.
#[derive(Clone)]
pub struct AppState {
    /// The state of the loop.
    pub shared: Arc<SharedState>,
    /// The video.
    pub video: Arc<AnnotatedVideo>,
    /// Where commands go.
    pub commands: Commands,
}

/// What answers are made from, and the room for those that last.
#[derive(Clone)]
struct Served {
    app: AppState,
    streams: Arc<Semaphore>,
}

impl FromRef<Served> for AppState {
    fn from_ref(served: &Served) -> Self {
        served.app.clone()
    }
}

impl Served {
    /// Room for one more stream, for as long as it is kept; a refusal where there is none.
    fn stream(&self) -> std::result::Result<OwnedSemaphorePermit, Refusal> {
        let full = || format!("{MAX_STREAMS} pages are open already; close one");
        Arc::clone(&self.streams).try_acquire_owned().map_err(|_| Refusal(StatusCode::SERVICE_UNAVAILABLE, full()))
    }
}

/// A server that has its address and does not answer yet.
#[derive(Debug)]
pub struct Server {
    access: AccessControl,
    listener: std::net::TcpListener,
    runtime: tokio::runtime::Runtime,
    address: SocketAddr,
}

impl Server {
    /// Takes the address, before anything else is begun.
    ///
    /// # Errors
    /// An address that cannot be listened at.
    pub fn bind(access: AccessControl) -> Result<Self> {
        let wrong = |e: std::io::Error| Error::Unavailable {
            what: format!("--serve {}", access.address()),
            message: e.to_string(),
        };
        let listener = std::net::TcpListener::bind(access.address()).map_err(wrong)?;
        listener.set_nonblocking(true).map_err(wrong)?;
        let address = listener.local_addr().map_err(wrong)?;
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().map_err(wrong)?;
        Ok(Self { access, listener, runtime, address })
    }

    /// Starts to serve, and gives the address: the one asked for, with the port that it got where 0 was asked for.
    pub fn start(self, app: AppState) -> SocketAddr {
        let Self { access, listener, runtime, address } = self;
        let router = router(Arc::new(access), app);
        std::thread::spawn(move || {
            lower_priority();
            runtime.block_on(async {
                if let Ok(listener) = TcpListener::from_std(listener) {
                    accept(listener, router).await;
                }
            });
        });
        address
    }
}

/// Serves whoever connects. Where there is no more room, the connection that has asked for nothing for the longest time makes some: connections
/// that only keep others out lose theirs first.
async fn accept(listener: TcpListener, router: Router) {
    let mut waiting = VecDeque::<Waiting>::new();
    let permits = Arc::new(Semaphore::new(MAX_CONNECTIONS));
    loop {
        let Ok((stream, _)) = listener.accept().await else {
            tokio::time::sleep(ACCEPT_RETRY).await;
            continue;
        };
        waiting.retain(Waiting::is_waiting);
        if permits.available_permits() == 0
            && let Some(longest) = waiting.pop_front()
        {
            longest.task.abort();
        }
        let permit = tokio::time::timeout(MAKE_ROOM, Arc::clone(&permits).acquire_owned()).await;
        let Ok(Ok(permit)) = permit else {
            // Not waited for: what the system does not take at once is not sent.
            let _ = stream.try_write(NO_ROOM);
            continue;
        };
        let has_asked = Arc::new(AtomicBool::new(false));
        let asks = Arc::clone(&has_asked);
        let router = router.clone().layer(middleware::map_request(move |request: Request| {
            asks.store(true, Ordering::Relaxed);
            async { request }
        }));
        let task = tokio::spawn(async move {
            serve(stream, router).await;
            drop(permit);
        });
        waiting.push_back(Waiting { task: task.abort_handle(), has_asked });
    }
}

/// A connection, and whether it has asked for something yet.
struct Waiting {
    task: AbortHandle,
    has_asked: Arc<AtomicBool>,
}

impl Waiting {
    /// Whether it is open and has not asked for anything.
    fn is_waiting(&self) -> bool {
        !self.task.is_finished() && !self.has_asked.load(Ordering::Relaxed)
    }
}

async fn serve(stream: TcpStream, router: Router) {
    let mut stream = TimeoutStream::new(stream);
    stream.set_write_timeout(Some(WRITE_TIMEOUT));
    let mut http = http1::Builder::new();
    http.timer(TokioTimer::new()).header_read_timeout(HEADER_TIMEOUT).max_buf_size(MAX_HEAD);
    let service = TowerToHyperService::new(router);
    // A connection that breaks off concerns nobody.
    let _ = http.serve_connection(TokioIo::new(Box::pin(stream)), service).await;
}

fn router(access: Arc<AccessControl>, app: AppState) -> Router {
    let text = |kind: &'static str, text: &'static str| {
        get(async move || ([(CONTENT_TYPE, kind), (CACHE_CONTROL, "no-cache")], text))
    };
    Router::new()
        .route("/", text("text/html; charset=utf-8", include_str!("page/index.html")))
        .route("/page.css", text("text/css; charset=utf-8", include_str!("page/page.css")))
        .route("/page.js", text("text/javascript; charset=utf-8", include_str!("page/page.js")))
        .route("/plots.js", text("text/javascript; charset=utf-8", include_str!("page/plots.js")))
        .route("/video.mjpg", get(video))
        .route("/api/state", get(state))
        .route("/api/measurements", get(measurements))
        .route("/api/model", get(model))
        .route("/api/table", get(table))
        .route("/api/events", get(events))
        .route("/api/command/{name}", post(command))
        .route("/metrics", get(metrics))
        .layer(DefaultBodyLimit::max(MAX_BODY))
        .layer(middleware::from_fn_with_state(access, guard))
        .with_state(Served { app, streams: Arc::new(Semaphore::new(MAX_STREAMS)) })
}

/// An answer that is refused, and why.
struct Refusal(StatusCode, String);

impl IntoResponse for Refusal {
    /// The connection is closed, so that who was refused for want of room takes none.
    fn into_response(self) -> Response {
        let Self(status, message) = self;
        ([(CONNECTION, "close"), (RETRY_AFTER, "10")], failure(status, message)).into_response()
    }
}

/// A failure as JSON: `{"error": "…"}`.
fn failure(status: StatusCode, message: impl ToString) -> Response {
    (status, Json(json!({ "error": message.to_string() }))).into_response()
}

async fn state(State(app): State<AppState>) -> impl IntoResponse {
    Json(app.shared.state())
}

#[derive(Deserialize)]
struct Since {
    /// Below 0, all rows that are kept.
    since: Option<i64>,
    limit: Option<usize>,
}

async fn measurements(
    State(app): State<AppState>,
    query: std::result::Result<Query<Since>, QueryRejection>,
) -> Response {
    let Since { since, limit } = match query {
        Ok(Query(asked)) => asked,
        Err(wrong) => return failure(StatusCode::BAD_REQUEST, wrong),
    };
    let limit = limit.unwrap_or(MAX_ROWS).min(MAX_ROWS);
    let rows = match since {
        Some(since) => app.shared.rows_after(u64::try_from(since).ok(), limit),
        None => app.shared.latest_rows(limit),
    };
    let next = rows.last().and_then(|row| i64::try_from(row.index).ok()).or(since);
    Json(json!({ "measurements": rows, "since": next })).into_response()
}

async fn model(State(app): State<AppState>) -> Response {
    let (commanding, stale) = match to_command_by(&app) {
        Ok(found) => found,
        Err(refused) => return refused.into_response(),
    };
    match model_json(&commanding.model) {
        Ok(mut json) => {
            json["stale"] = stale.into();
            json["verdict"] = json!(commanding.verdict);
            json["age_s"] = commanding.age_s.into();
            Json(json).into_response()
        }
        Err(error) => failure(StatusCode::INTERNAL_SERVER_ERROR, error),
    }
}

/// The model to command by, and why it is stale, if it is; a refusal where there is none.
fn to_command_by(app: &AppState) -> std::result::Result<(Commanding, Option<String>), Refusal> {
    app.shared.to_command_by().map_err(|why| Refusal(StatusCode::CONFLICT, why))
}

/// What `/api/table` is asked for. A name that it does not know, such as another unit, is refused: who gave it counts on it.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Pose {
    /// Degrees.
    theta: f64,
    /// Degrees.
    delta: f64,
}

async fn table(State(app): State<AppState>, query: std::result::Result<Query<Pose>, QueryRejection>) -> Response {
    let Pose { theta, delta } = match query {
        Ok(Query(asked)) => asked,
        Err(wrong) => {
            let expected = "expected theta=…&delta=… in degrees, with a decimal point, and nothing else";
            return failure(StatusCode::BAD_REQUEST, format!("{}: {expected}", wrong.body_text()));
        }
    };
    let most = MAX_THETA.to_degrees();
    // As the table: degrees that become radians and back are not the same to the last digit.
    if !(0.0..=most + 1e-9).contains(&theta) || !(-360.0..=360.0).contains(&delta) {
        let message = format!("theta {theta}, delta {delta}: expected 0 to {most:.0} and −360 to 360 degrees");
        return failure(StatusCode::BAD_REQUEST, message);
    }
    let (Commanding { model, verdict, age_s }, stale) = match to_command_by(&app) {
        Ok(found) => found,
        Err(refused) => return refused.into_response(),
    };
    let learned = model
        .learned
        .map(|range| json!({ "theta_max_deg": range.theta_max().to_degrees(), "delta_deg": range.directions_deg() }));
    let row = TableRow::new(&model, Configuration::from_degrees(theta, delta));
    Json(json!({
        "theta_deg": row.configuration.theta_deg(),
        "delta_deg": row.configuration.delta_deg(),
        "q_desired_mm": row.q_mm,
        "q_command_mm": row.command_mm,
        "sd_q_command_mm": row.sd_command_mm,
        // The names of earlier versions.
        "q_mm": row.q_mm,
        "qc_mm": row.command_mm,
        "sd_qc_mm": row.sd_command_mm,
        "estimated": model.estimate().is_some(),
        "stale": stale,
        "verdict": verdict,
        "age_s": age_s,
        "learned": learned,
        "extrapolated": u8::from(row.extrapolated),
        "holds_if": model.conditions_of_single_poses(),
    }))
    .into_response()
}

async fn command(State(app): State<AppState>, Path(name): Path<String>) -> Response {
    let command = match name.as_str() {
        "pause" => Command::Pause(true),
        "continue" => Command::Pause(false),
        "reference" => Command::Reference,
        "reset" => Command::Reset,
        "save" => Command::Save,
        _ => return failure(StatusCode::NOT_FOUND, format!("no command {name}")),
    };
    match app.commands.send(command).await {
        Ok(Ok(done)) => Json(json!({ "done": done })).into_response(),
        Ok(Err(refused)) => failure(StatusCode::CONFLICT, refused),
        Err(_) => failure(StatusCode::CONFLICT, "the run is over"),
    }
}

/// Server-sent events: `state` and `rows`, a few times a second; a slow reader gets more rows at a time.
async fn events(
    State(served): State<Served>,
) -> std::result::Result<Sse<impl Stream<Item = std::result::Result<Event, Infallible>>>, Refusal> {
    enum Turn {
        Rows,
        State,
    }
    let room = served.stream()?;
    let begin = (served.app.shared, None::<u64>, Turn::Rows, room);
    let stream = unfold(begin, |(shared, mut since, turn, room)| async move {
        let (event, next) = match turn {
            Turn::Rows => {
                let rows: Vec<Row> = match since {
                    Some(_) => shared.rows_after(since, MAX_EVENT_ROWS),
                    None => shared.latest_rows(MAX_EVENT_ROWS),
                };
                since = rows.last().map(|row| row.index).or(since);
                (Event::default().event("rows").json_data(rows), Turn::State)
            }
            Turn::State => {
                tokio::time::sleep(EVENT_EVERY).await;
                (Event::default().event("state").json_data(shared.state()), Turn::Rows)
            }
        };
        // Numbers and text always serialise.
        Some((Ok(event.unwrap_or_default()), (shared, since, next, room)))
    });
    Ok(Sse::new(stream).keep_alive(KeepAlive::default()))
}

/// The annotated video: JPEG after JPEG. Chromium shows a picture once the head of the part behind it has come, so each is sent with the
/// boundary and head that follow, and the first with those before it too. The head cannot tell a length: the next picture is not drawn yet.
async fn video(State(served): State<Served>) -> Response {
    const BOUNDARY: &str = "picture";
    const NEXT: &str = "--picture\r\nContent-Type: image/jpeg\r\n\r\n";
    let room = match served.stream() {
        Ok(room) => room,
        Err(refused) => return refused.into_response(),
    };
    let stream = unfold((served.app.video.watch(), true, room), |(mut pictures, is_first, room)| async move {
        let picture = loop {
            pictures.changed().await.ok()?;
            let picture = Arc::clone(&pictures.borrow_and_update());
            if !picture.is_empty() {
                break picture;
            }
        };
        let before = if is_first { NEXT } else { "" };
        let part = [before.as_bytes(), &picture, b"\r\n", NEXT.as_bytes()].concat();
        Some((Ok::<_, Infallible>(part), (pictures, false, room)))
    });
    let kind = format!("multipart/x-mixed-replace; boundary={BOUNDARY}");
    ([(CONTENT_TYPE, kind), (CACHE_CONTROL, "no-store".to_owned())], Body::from_stream(stream)).into_response()
}

async fn metrics(State(app): State<AppState>) -> impl IntoResponse {
    let text = metrics::text(&app.shared.lock());
    ([(CONTENT_TYPE, "text/plain; version=0.0.4; charset=utf-8")], text)
}
