//! What `live` publishes: the measured bend, η and λ, the verdict, the overlay, and commands on request.
//!
//! The thread reads copies of the shared state, as the HTTP server does, and asks the same whether anything may be commanded by. It waits
//! for no reader.

use super::super::annotated_video::AnnotatedVideo;
use super::super::clock::unix_time_s;
use super::super::publication::Withheld;
use super::super::shared_state::SharedState;
use super::super::status::{Row, State};
use super::node::{Delivery, Node, Reader, Writer};
use crate::bag::Stamped;
use crate::bag::messages::{CompressedImage, Diagnostic, DiagnosticLevel, Numbers, StampedVector};
use crate::error::Result;
use crate::geometry::Configuration;
use crate::robot::{MAX_THETA, TableRow};
use crate::verdict::{Level, Verdict};
use nalgebra::Vector2;
use rustdds::{DataWriterStatus, StatusEvented};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};
use tokio::sync::watch;

/// Time between two looks at what is new. Convention: shorter than a frame lasts at 60 frames/s.
const POLL: Duration = Duration::from_millis(4);
/// Time between two diagnostics. Convention: as ROS 2's `diagnostic_updater`.
const DIAGNOSE_EVERY: Duration = Duration::from_secs(1);
/// Rows published at a time. Convention: a resource limit.
const MAX_ROWS: usize = 100;
/// Requests that may wait. Convention: as ROS 2's default.
const REQUESTS: i32 = 10;
/// Time that the end waits until the last messages are acknowledged. Convention: a timeout.
const LINGER: Duration = Duration::from_millis(200);

/// The topics. Convention: this program's names, and ROS 2's for diagnostics and for a picture that is compressed.
const BEND: &str = "/snakeloop/bend";
const ESTIMATE: &str = "/snakeloop/estimate";
const OVERLAY: &str = "/snakeloop/overlay/compressed";
const COMMAND: &str = "/snakeloop/command";
const ANSWER: &str = "/snakeloop/command/answer";
const DIAGNOSTICS: &str = "/diagnostics";

/// The frame of reference of bend vectors: the snake's base, {b} in the paper.
const FRAME: &str = "snakeloop_base";

/// What the numbers of the estimate are.
const ESTIMATE_LABEL: &str = "eta,lambda_mm,sd_eta,sd_lambda_mm";

/// The thread that publishes.
#[derive(Debug)]
pub struct Sink {
    stop: Arc<AtomicBool>,
    thread: JoinHandle<()>,
}

impl Sink {
    /// Starts to publish a loop's results.
    ///
    /// # Errors
    /// Topics that cannot be made.
    pub fn start(node: &Node, shared: Arc<SharedState>, video: Arc<AnnotatedVideo>) -> Result<Self> {
        let mut topics = Topics {
            bend: node.writer(BEND, StampedVector::KIND, Delivery::Reliable)?,
            estimate: node.writer(ESTIMATE, Numbers::KIND, Delivery::Reliable)?,
            diagnostics: node.writer(DIAGNOSTICS, Diagnostic::KIND, Delivery::Reliable)?,
            overlay: node.writer(OVERLAY, CompressedImage::DEFINITION.kind, Delivery::BestEffort)?,
            requests: node.reader(COMMAND, StampedVector::KIND, REQUESTS)?,
            answers: node.writer(ANSWER, Numbers::KIND, Delivery::Reliable)?,
            shared,
            video,
            last: None,
            watched: None,
        };
        let stop = Arc::new(AtomicBool::new(false));
        let asked = Arc::clone(&stop);
        let thread = std::thread::spawn(move || topics.run(&asked));
        Ok(Self { stop, thread })
    }

    /// Publishes what the loop ended with, and ends.
    pub fn finish(self) {
        self.stop.store(true, Ordering::Relaxed);
        let _ = self.thread.join();
    }
}

/// The topics, and what was published on them.
struct Topics {
    bend: Writer,
    estimate: Writer,
    diagnostics: Writer,
    overlay: Writer,
    requests: Reader,
    answers: Writer,
    shared: Arc<SharedState>,
    video: Arc<AnnotatedVideo>,
    /// The last row's index.
    last: Option<u64>,
    /// The pictures, while somebody listens.
    watched: Option<watch::Receiver<Arc<Vec<u8>>>>,
}

impl Topics {
    fn run(&mut self, stop: &AtomicBool) {
        let mut diagnosed: Option<Instant> = None;
        loop {
            let is_last = stop.load(Ordering::Relaxed);
            if self.publish_rows() || is_last {
                self.publish_estimate();
            }
            self.answer();
            self.show();
            if is_last || diagnosed.is_none_or(|at| at.elapsed() >= DIAGNOSE_EVERY) {
                diagnosed = Some(Instant::now());
                self.diagnose();
            }
            if is_last {
                let _ = self.estimate.wait_for_acknowledgments(LINGER);
                let _ = self.diagnostics.wait_for_acknowledgments(LINGER);
                return;
            }
            std::thread::sleep(POLL);
        }
    }

    /// The bends that are new; says whether there are rows that are.
    fn publish_rows(&mut self) -> bool {
        let rows = self.shared.rows_after(self.last, MAX_ROWS);
        self.last = rows.last().map(|row| row.index).or(self.last);
        for bend in rows.iter().filter_map(bend_of) {
            send(&self.bend, bend.encoded(FRAME));
        }
        !rows.is_empty()
    }

    /// η and λ of the model to command by, if there is one.
    fn publish_estimate(&self) {
        let Ok((commanding, _)) = self.shared.to_command_by() else { return };
        let Some(estimate) = commanding.model.estimate() else { return };
        let values = [estimate.eta, estimate.lambda_mm, estimate.sd_eta(), estimate.sd_lambda_mm()];
        send(&self.estimate, Numbers { label: ESTIMATE_LABEL, values: &values }.encoded());
    }

    /// Answers requests; one that may not be answered has no answer, and diagnostics say why.
    fn answer(&self) {
        self.requests.drain_read_notifications();
        // What is no request is passed over.
        while let Some(asked) = self.requests.try_take_one().transpose() {
            let Ok(message) = asked else { continue };
            let Ok(request) = StampedVector::decoded(StampedVector::KIND, &message.into_value()) else { continue };
            if let Some((label, values)) = self.command(&request) {
                send(&self.answers, Numbers { label: &label, values: &values }.encoded());
            }
        }
    }

    /// What to command for a bend: the names of the numbers, and the numbers.
    fn command(&self, request: &StampedVector) -> Option<(String, Vec<f64>)> {
        let [x, y, _] = request.vector;
        let configuration = Configuration::from_bend_vector(Vector2::new(x, y));
        // NaN is outside too. As the table: a bend of exactly the largest may have lost its last digit.
        if !(0.0..=MAX_THETA + 1e-9).contains(&configuration.theta) {
            return None;
        }
        let (commanding, _) = self.shared.to_command_by().ok()?;
        let row = TableRow::new(&commanding.model, configuration);
        let level = diagnostic_level(commanding.verdict.level);
        let numbers = [x, y].into_iter().chain(row.command_mm.iter().copied()).chain(row.sd_command_mm.iter().copied());
        let rest = [f64::from(level as u8), f64::from(u8::from(row.extrapolated)), commanding.age_s];
        let values: Vec<f64> = numbers.chain(rest).collect();
        let of_each = |name: &str| (1..=row.command_mm.len()).map(|i| format!("{name}{i}_mm,")).collect::<String>();
        let label = format!(
            "bend_x_rad,bend_y_rad,{}{}level,extrapolated,age_s",
            of_each("q_command"),
            of_each("sd_q_command")
        );
        // No number that is none reaches a controller.
        values.iter().all(|value| value.is_finite()).then_some((label, values))
    }

    /// The overlay, drawn while somebody listens.
    fn show(&mut self) {
        while let Some(status) = self.overlay.try_recv_status() {
            if let DataWriterStatus::PublicationMatched { current, .. } = status {
                let is_watched = current.count() > 0;
                if is_watched != self.watched.is_some() {
                    self.watched = is_watched.then(|| self.video.watch());
                }
            }
        }
        let Some(pictures) = self.watched.as_mut().filter(|pictures| pictures.has_changed().unwrap_or(false)) else {
            return;
        };
        let jpeg = Arc::clone(&pictures.borrow_and_update());
        if !jpeg.is_empty() {
            let picture = CompressedImage { format: "jpeg".into(), data: &jpeg };
            send(&self.overlay, picture.encoded((unix_time_s() * 1e9) as u64, FRAME));
        }
    }

    /// The verdict, and what frames and encoders do.
    fn diagnose(&self) {
        let verdict = self.shared.lock().gate.verdict().map(|(verdict, _)| verdict.clone());
        let (_, decided) = self.shared.model_to_command_by();
        let (level, message, values) = diagnosis(verdict.as_ref(), &decided, &self.shared.state());
        let name = "snakeloop: verdict";
        let diagnostic = Diagnostic { stamp_s: unix_time_s(), level, name, message: &message, values: &values };
        send(&self.diagnostics, diagnostic.encoded());
    }
}

/// Publishes a message; where readers are so slow that there is no room for it, it is lost.
fn send(writer: &Writer, message: Vec<u8>) {
    let _ = writer.write(message, None);
}

/// The bend that a row measured, with its larger σ, rad.
fn bend_of(row: &Row) -> Option<StampedVector> {
    let bend = Configuration::from_degrees(row.theta_deg?, row.delta_deg?).bend_vector();
    let sigma = row.sigma_bend_deg?.to_radians();
    Some(StampedVector { stamp_s: row.time_s, vector: [bend.x, bend.y, sigma] })
}

fn diagnostic_level(level: Level) -> DiagnosticLevel {
    match level {
        Level::Good => DiagnosticLevel::Ok,
        Level::Look => DiagnosticLevel::Warn,
        Level::DoNotUse => DiagnosticLevel::Error,
    }
}

/// What is told of a verdict, and of whether the model may be commanded by.
fn diagnosis(
    verdict: Option<&Verdict>,
    decided: &std::result::Result<(), Withheld>,
    state: &State,
) -> (DiagnosticLevel, String, Vec<(String, String)>) {
    let (level, message) = match (verdict, decided) {
        (None, _) => (DiagnosticLevel::Stale, "no verdict was passed yet".to_owned()),
        (Some(_), Err(withheld)) => (diagnostic_level(withheld.level), withheld.text.clone()),
        (Some(verdict), Ok(())) => {
            let worst = verdict.reasons.first().map(|reason| reason.text.clone());
            (diagnostic_level(verdict.level), worst.unwrap_or_else(|| verdict.level.to_string()))
        }
    };
    let mut values =
        vec![("verdict".to_owned(), verdict.map_or("none yet".into(), |verdict| verdict.level.to_string()))];
    for reason in verdict.into_iter().flat_map(|verdict| &verdict.reasons) {
        let code = serde_json::to_value(reason.code).ok().and_then(|code| Some(code.as_str()?.to_owned()));
        values.push((code.unwrap_or_default(), format!("{}; {}", reason.text, reason.remedy)));
    }
    let source = serde_json::to_value(state.source.state).ok().and_then(|state| Some(state.as_str()?.to_owned()));
    values.extend([
        ("frames".to_owned(), state.source.frames.to_string()),
        ("frames_dropped".to_owned(), state.source.dropped.to_string()),
        ("measured".to_owned(), state.measured.to_string()),
        ("source".to_owned(), source.unwrap_or_default()),
        ("encoders".to_owned(), state.encoders.state.to_owned()),
    ]);
    values.extend(state.notices.last().map(|notice| ("notice".to_owned(), notice.clone())));
    (level, message, values)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::verdict::{Code, Reason};

    #[test]
    fn diagnostics_follow_the_verdict_and_the_gate() {
        let state = State::default();
        let level = |verdict: Option<&Verdict>, decided: &std::result::Result<(), Withheld>| {
            let (level, message, _) = diagnosis(verdict, decided, &state);
            (level, message)
        };
        let withheld = |level, text: &str| Err(Withheld { level, code: Code::Stale, text: text.into() });
        let good = Verdict::default();
        let look = Verdict::of(vec![Reason::new(Code::WorkspaceNotCovered, Level::Look, "few bends", "bend it")]);
        let unjudged = withheld(Level::DoNotUse, "no verdict was passed yet");
        assert_eq!(level(None, &unjudged).0, DiagnosticLevel::Stale);
        assert_eq!(level(Some(&good), &Ok(())), (DiagnosticLevel::Ok, "good".into()));
        assert_eq!(level(Some(&look), &Ok(())), (DiagnosticLevel::Warn, "few bends".into()));
        assert_eq!(level(Some(&good), &withheld(Level::DoNotUse, "stuck")), (DiagnosticLevel::Error, "stuck".into()));
        let (_, _, values) = diagnosis(Some(&look), &Ok(()), &state);
        assert!(values.contains(&("workspace_not_covered".into(), "few bends; bend it".into())), "{values:?}");
    }

    #[test]
    fn a_bend_is_a_vector_with_its_larger_sigma() {
        let row = Row {
            time_s: 5.0,
            theta_deg: Some(90.0),
            delta_deg: Some(90.0),
            sigma_bend_deg: Some(1.0),
            ..Row::default()
        };
        let StampedVector { stamp_s, vector: [x, y, sigma] } = bend_of(&row).unwrap();
        assert_eq!(stamp_s, 5.0);
        let right = std::f64::consts::FRAC_PI_2;
        assert!(x.abs() < 1e-12 && (y - right).abs() < 1e-12 && (sigma - right / 90.0).abs() < 1e-12);
        assert_eq!(bend_of(&Row::default()), None);
    }
}
