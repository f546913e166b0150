//! The dashboard and the machine interface, over HTTP.
//!
//! One thread of low priority serves all connections. An answer is made, from the latest state, when its reader can take it; a
//! connection that neither reads nor writes for a while is closed.

use super::access_control::{AccessControl, guard};
use super::annotated_video::AnnotatedVideo;
use super::commands::{Command, Commands};
use super::low_priority::lower_priority;
use super::metrics;
use super::shared_state::SharedState;
use super::status::Row;
use crate::error::{Error, Result};
use crate::geometry::Configuration;
use crate::record::model_json;
use crate::robot::{MAX_THETA, TableRow};
use axum::body::Body;
use axum::extract::{DefaultBodyLimit, Path, Query, State};
use axum::http::StatusCode;
use axum::http::header::{CACHE_CONTROL, CONTENT_TYPE};
use axum::response::sse::{Event, KeepAlive, Sse};
use axum::response::{IntoResponse, Response};
use axum::routing::{get, post};
use axum::{Json, Router, middleware};
use futures_util::stream::{Stream, unfold};
use hyper::server::conn::http1;
use hyper_util::rt::{TokioIo, TokioTimer};
use hyper_util::service::TowerToHyperService;
use serde::Deserialize;
use serde_json::{Value, json};
use std::convert::Infallible;
use std::net::SocketAddr;
use std::sync::{Arc, LazyLock};
use std::time::Duration;
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::Semaphore;
use tokio_io_timeout::TimeoutStream;

/// Connections at a time; further ones wait. Convention: a resource limit.
const MAX_CONNECTIONS: usize = 128;
/// A connection that has not sent its request's head by then is closed. Convention.
///
/// Convention: a timeout.
const HEADER_TIMEOUT: Duration = Duration::from_secs(10);
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

/// Starts to serve, and gives the address: the one asked for, with the port that it got where 0 was asked for.
///
/// # Errors
/// An address that cannot be listened at.
pub fn start(access: AccessControl, app: AppState) -> Result<SocketAddr> {
    let wrong = |e: std::io::Error| Error::Unavailable {
        what: format!("--serve {}", access.address()),
        message: e.to_string(),
    };
    let listener = std::net::TcpListener::bind(access.address()).map_err(wrong)?;
    listener.set_nonblocking(true).map_err(wrong)?;
    let address = listener.local_addr().map_err(wrong)?;
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().map_err(wrong)?;
    let router = router(Arc::new(access), app);
    std::thread::spawn(move || {
        lower_priority();
        runtime.block_on(async {
            if let Ok(listener) = TcpListener::from_std(listener) {
                accept(listener, router).await;
            }
        });
    });
    Ok(address)
}

async fn accept(listener: TcpListener, router: Router) {
    let permits = Arc::new(Semaphore::new(MAX_CONNECTIONS));
    loop {
        let Ok(permit) = Arc::clone(&permits).acquire_owned().await else { return };
        let Ok((stream, _)) = listener.accept().await else {
            tokio::time::sleep(ACCEPT_RETRY).await;
            continue;
        };
        let router = router.clone();
        tokio::spawn(async move {
            serve(stream, router).await;
            drop(permit);
        });
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
        .route("/plotly.js", get(plotly))
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
        .with_state(app)
}

/// plotly.js, out of the script elements that its crate gives.
static PLOTLY: LazyLock<String> = LazyLock::new(|| {
    let scripts = plotly::Plot::offline_js_sources();
    let script = scripts.split_once('>').map_or("", |(_, after)| after);
    script.split_once("</script>").map_or(script, |(script, _)| script).to_owned()
});

/// Time for which browsers keep plotly.js: a day. Convention.
const PLOTLY_CACHE: &str = "max-age=86400";

async fn plotly() -> impl IntoResponse {
    ([(CONTENT_TYPE, "text/javascript; charset=utf-8"), (CACHE_CONTROL, PLOTLY_CACHE)], PLOTLY.as_str())
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
    since: Option<u64>,
    limit: Option<usize>,
}

async fn measurements(State(app): State<AppState>, Query(Since { since, limit }): Query<Since>) -> Json<Value> {
    let rows = app.shared.rows_after(since, limit.unwrap_or(MAX_ROWS).min(MAX_ROWS));
    let next = rows.last().map(|row| row.index).or(since);
    Json(json!({ "measurements": rows, "since": next }))
}

async fn model(State(app): State<AppState>) -> Response {
    let model = app.shared.lock().model.clone();
    match model_json(&model) {
        Ok(json) => Json(json).into_response(),
        Err(error) => failure(StatusCode::INTERNAL_SERVER_ERROR, error),
    }
}

#[derive(Deserialize)]
struct Pose {
    theta: f64,
    delta: f64,
}

async fn table(State(app): State<AppState>, Query(Pose { theta, delta }): Query<Pose>) -> Response {
    let most = MAX_THETA.to_degrees();
    if !(0.0..=most).contains(&theta) || !(-360.0..=360.0).contains(&delta) {
        let message = format!("theta {theta}, delta {delta}: expected 0 to {most:.0} and −360 to 360 degrees");
        return failure(StatusCode::BAD_REQUEST, message);
    }
    let model = app.shared.lock().model.clone();
    let row = TableRow::new(&model, Configuration::from_degrees(theta, delta));
    Json(json!({
        "theta_deg": row.configuration.theta_deg(),
        "delta_deg": row.configuration.delta_deg(),
        "q_mm": row.q_mm,
        "qc_mm": row.command_mm,
        "sd_qc_mm": row.sd_command_mm,
        "estimated": model.estimate.is_some(),
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
async fn events(State(app): State<AppState>) -> Sse<impl Stream<Item = std::result::Result<Event, Infallible>>> {
    enum Turn {
        Rows,
        State,
    }
    let stream = unfold((app.shared, None::<u64>, Turn::Rows), |(shared, mut since, turn)| async move {
        let (event, next) = match turn {
            Turn::Rows => {
                let rows: Vec<Row> = shared.rows_after(since, MAX_EVENT_ROWS);
                since = rows.last().map(|row| row.index).or(since);
                (Event::default().event("rows").json_data(rows), Turn::State)
            }
            Turn::State => {
                tokio::time::sleep(EVENT_EVERY).await;
                (Event::default().event("state").json_data(shared.state()), Turn::Rows)
            }
        };
        // Numbers and text always serialise.
        Some((Ok(event.unwrap_or_default()), (shared, since, next)))
    });
    Sse::new(stream).keep_alive(KeepAlive::default())
}

/// The annotated video: JPEG after JPEG.
async fn video(State(app): State<AppState>) -> Response {
    const BOUNDARY: &str = "picture";
    let stream = unfold(app.video.watch(), |mut pictures| async move {
        let picture = loop {
            pictures.changed().await.ok()?;
            let picture = Arc::clone(&pictures.borrow_and_update());
            if !picture.is_empty() {
                break picture;
            }
        };
        let head = format!("--{BOUNDARY}\r\nContent-Type: image/jpeg\r\nContent-Length: {}\r\n\r\n", picture.len());
        let part = [head.as_bytes(), &picture, b"\r\n"].concat();
        Some((Ok::<_, Infallible>(part), pictures))
    });
    let kind = format!("multipart/x-mixed-replace; boundary={BOUNDARY}");
    ([(CONTENT_TYPE, kind), (CACHE_CONTROL, "no-store".to_owned())], Body::from_stream(stream)).into_response()
}

async fn metrics(State(app): State<AppState>) -> impl IntoResponse {
    let text = metrics::text(&app.shared.lock());
    ([(CONTENT_TYPE, "text/plain; version=0.0.4; charset=utf-8")], text)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_plot_library_is_taken_out_of_its_crate_whole() {
        let head: String = PLOTLY.chars().take(400).collect();
        assert!(head.contains("plotly.js v"), "{head}");
        assert!(PLOTLY.len() > 3_000_000 && !PLOTLY.contains("<script"));
        assert!(PLOTLY.trim_end().ends_with([';', '}', ')']), "cut short");
    }
}
