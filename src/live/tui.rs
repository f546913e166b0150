//! The terminal view: the dashboard's figures without a browser.

use super::commands::{Answer, Command, Commands};
use super::shared_state::SharedState;
use super::status::{FrameTimingState, GapState, SourceState, State};
use crate::error::{Error, Result};
use crate::estimate::EtaLambda;
use ratatui::Frame;
use ratatui::crossterm::event::{self, Event, KeyCode, KeyEventKind, KeyModifiers};
use ratatui::layout::{Constraint, Layout};
use ratatui::style::{Color, Style, Stylize};
use ratatui::text::{Line, Span};
use ratatui::widgets::{Block, Paragraph, Sparkline, Wrap};
use std::time::Duration;
use tokio::sync::oneshot::{self, error::TryRecvError};

/// Time between two drawings. Convention: a display choice.
const EVERY: Duration = Duration::from_millis(200);
/// Latest values of θ that are drawn. Convention: a display choice.
const HISTORY: usize = 300;
/// The largest θ drawn, in the units of the drawing. Convention: finer than a terminal shows.
const FULL_HEIGHT: u64 = 1000;

/// Shows the state until the user leaves (q) or `is_over`.
///
/// # Errors
/// No terminal to draw on.
pub fn show(shared: &SharedState, commands: &Commands, is_over: impl Fn() -> bool) -> Result<()> {
    let failed =
        |e: std::io::Error| Error::Unavailable { what: "--tui needs a terminal".into(), message: e.to_string() };
    let mut terminal = ratatui::try_init().map_err(failed)?;
    let mut answer =
        "p pause/continue   s save the table   r reset   t take the straight reference   q quit".to_owned();
    let mut asked: Option<oneshot::Receiver<Answer>> = None;
    let result = loop {
        // Some commands take long, and whoever wants to leave meanwhile may.
        match asked.as_mut().map(oneshot::Receiver::try_recv) {
            None | Some(Err(TryRecvError::Empty)) => {}
            Some(Ok(Ok(said) | Err(said))) => (asked, answer) = (None, said),
            Some(Err(TryRecvError::Closed)) => (asked, answer) = (None, "the run is over".to_owned()),
        }
        let state = shared.state();
        let theta: Vec<f64> = shared.latest_rows(HISTORY).iter().filter_map(|row| row.theta_deg).collect();
        if let Err(e) = terminal.draw(|frame| draw(frame, &state, &theta, &answer)) {
            break Err(failed(e));
        }
        if is_over() {
            break Ok(());
        }
        match key() {
            Err(e) => break Err(failed(e)),
            Ok(Some('q')) => break Ok(()),
            Ok(Some(key)) => {
                let command = match key {
                    'p' => Command::Pause(!state.paused),
                    's' => Command::Save,
                    'r' => Command::Reset,
                    't' => Command::Reference,
                    _ => continue,
                };
                (asked, answer) = (Some(commands.send(command)), "…".to_owned());
            }
            Ok(None) => {}
        }
    };
    ratatui::restore();
    result
}

/// The key that was pressed within a moment; Ctrl-C is q.
fn key() -> std::io::Result<Option<char>> {
    if !event::poll(EVERY)? {
        return Ok(None);
    }
    let Event::Key(key) = event::read()? else { return Ok(None) };
    if key.kind != KeyEventKind::Press {
        return Ok(None);
    }
    Ok(match key.code {
        KeyCode::Char('c') if key.modifiers.contains(KeyModifiers::CONTROL) => Some('q'),
        KeyCode::Char(letter) => Some(letter),
        _ => None,
    })
}

fn draw(frame: &mut Frame, state: &State, theta_deg: &[f64], answer: &str) {
    let [top, middle, line, foot] =
        Layout::vertical([Constraint::Length(5), Constraint::Length(9), Constraint::Min(4), Constraint::Length(4)])
            .areas(frame.area());
    let [measured, learned] = Layout::horizontal([Constraint::Percentage(50); 2]).areas(middle);
    let boxed = |title: &'static str, lines: Vec<Line<'static>>| {
        Paragraph::new(lines).wrap(Wrap { trim: true }).block(Block::bordered().title(title))
    };
    frame.render_widget(boxed(" source and encoders ", sources(state)), top);
    frame.render_widget(boxed(" measured ", measurements(state)), measured);
    frame.render_widget(boxed(" learned ", estimates(state)), learned);
    let largest = theta_deg.iter().copied().fold(1.0, f64::max);
    // The latest, as many as there are columns.
    let columns = usize::from(line.width.saturating_sub(2));
    let shown = &theta_deg[theta_deg.len().saturating_sub(columns)..];
    let heights: Vec<u64> = shown.iter().map(|theta| (FULL_HEIGHT as f64 * theta / largest) as u64).collect();
    let title = format!(" θ, up to {largest:.0}° ");
    frame.render_widget(
        Sparkline::default().block(Block::bordered().title(title)).data(&heights).max(FULL_HEIGHT),
        line,
    );
    let notice = state.notices.last().cloned().unwrap_or_default();
    frame.render_widget(boxed(" ", vec![Line::from(notice), Line::from(answer.to_owned()).dim()]), foot);
}

fn sources(state: &State) -> Vec<Line<'static>> {
    let source = &state.source;
    let (word, colour) = match source.state {
        _ if state.paused => ("paused", Color::Yellow),
        SourceState::Running if state.timing.state == FrameTimingState::Behind => ("behind", Color::Yellow),
        SourceState::Running if state.timing.state == FrameTimingState::Late => ("late", Color::Red),
        SourceState::Running => ("running", Color::Green),
        SourceState::Waiting => ("waiting", Color::Yellow),
        SourceState::Lost => ("lost", Color::Red),
        SourceState::Ended => ("ended", Color::Yellow),
    };
    let encoders = &state.encoders;
    vec![
        Line::from(vec![
            Span::from(state.source_name.clone()),
            Span::from("  "),
            Span::styled(word, Style::new().fg(colour).bold()),
            Span::from(
                source
                    .trouble
                    .as_ref()
                    .or(state.timing.sentence.as_ref())
                    .map(|why| format!("  {why}"))
                    .unwrap_or_default(),
            ),
        ]),
        Line::from(format!(
            "{:.1} frames/s, {} frames, {} dropped; latency p50 {:.1} ms, p99 {:.1} ms",
            source.rate_fps, source.frames, source.dropped, state.latency.p50_ms, state.latency.p99_ms
        )),
        Line::from(format!(
            "encoders {}, {} readings, {} bad lines, clock {:?}, offset {:.3} s",
            encoders.state, encoders.readings, encoders.bad_lines, encoders.clock, encoders.offset_s
        )),
    ]
}

fn measurements(state: &State) -> Vec<Line<'static>> {
    let counts = format!("{} measured of {}, {} rejected", state.measured, state.measurements, state.rejected);
    let Some(row) = &state.latest else { return vec![Line::from("nothing measured yet"), Line::from(counts)] };
    let angle = |name: &str, value: Option<f64>, sigma: Option<f64>, expected: Option<f64>| {
        let value = value.zip(sigma).map_or("–".to_owned(), |(value, sigma)| format!("{value:8.2}° ± {sigma:.2}°"));
        let expected = expected.map(|expected| format!("   expected {expected:.2}°")).unwrap_or_default();
        Line::from(format!("{name} {value}{expected}"))
    };
    vec![
        Line::from(format!("frame {} at {:.3} s: {} {}", row.index, row.time_s, row.status, row.reason)),
        angle("θ", row.theta_deg, row.sigma_theta_deg, row.expected_theta_deg).bold(),
        angle("δ", row.delta_deg, row.sigma_delta_deg, row.expected_delta_deg).bold(),
        Line::from(match row.residual_mm {
            Some(residuals) => {
                let micrometres: Vec<_> = residuals.iter().map(|mm| format!("{:+.1}", 1e3 * mm)).collect();
                format!("residuals {} µm", micrometres.join(" "))
            }
            None => "residuals –".to_owned(),
        }),
        Line::from(counts),
    ]
}

fn estimates(state: &State) -> Vec<Line<'static>> {
    let mut lines = match state.estimate.map(|estimate| estimate.parameters) {
        Some(EtaLambda { eta, sd_eta, lambda_mm, sd_lambda_mm }) => vec![
            Line::from(format!("η {eta:.4} ± {sd_eta:.4}")).bold(),
            Line::from(format!("λ {lambda_mm:.4} ± {sd_lambda_mm:.4} mm")).bold(),
        ],
        None => vec![Line::from("η and λ are not known yet")],
    };
    lines.extend(state.stem.map(|stem| Line::from(format!("Φ {:.1} ± {:.1}°", stem.phi_deg, stem.sd_phi_deg)).bold()));
    let gap = &state.gap;
    let (word, colour) = match gap.state {
        GapState::Unknown => ("not known yet", Color::Reset),
        GapState::Noise => ("noise", Color::Green),
        GapState::Above => ("above noise", Color::Red),
    };
    lines.push(Line::from(vec![
        Span::from("gap: "),
        Span::styled(word, Style::new().fg(colour).bold()),
        Span::from(format!(" (bending {:.1}, common {:.1}; 1 is noise)", gap.bending, gap.common)),
    ]));
    if let Some(discovery) = &state.discovery {
        lines.extend(discovery.followed.clone().map(Line::from));
        lines.push(Line::from(discovery.sentence.clone()));
    }
    lines
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::live::status::{DiscoveryStatus, EncoderStatus, EstimateStatus, StemStatus};
    use ratatui::Terminal;
    use ratatui::backend::TestBackend;

    #[test]
    fn the_figures_are_on_the_screen_however_small_it_is() {
        let mut state = State::at_start("camera 0".into(), EncoderStatus::at_rest("none", 0));
        let screen = |state: &State, width, height| {
            let mut terminal = Terminal::new(TestBackend::new(width, height)).unwrap();
            terminal.draw(|frame| draw(frame, state, &[1.0, 30.0, 20.0], "p pause")).unwrap();
            terminal.backend().to_string()
        };
        assert!(screen(&state, 80, 24).contains("nothing measured yet"));
        state.estimate = Some(EstimateStatus {
            parameters: EtaLambda { eta: 1.2211, sd_eta: 0.001, lambda_mm: 0.1767, sd_lambda_mm: 0.0005 },
            samples: 36,
        });
        state.gap.state = GapState::Above;
        state.stem = Some(StemStatus { phi_deg: 131.26, sd_phi_deg: 2.4 });
        let followed = Some("play_at_bend 97 %, as of frame 812".into());
        state.discovery = Some(DiscoveryStatus { followed, ..DiscoveryStatus::default() });
        let text = screen(&state, 100, 24);
        for expected in [
            "camera 0",
            "waiting",
            "η 1.2211 ± 0.0010",
            "λ 0.1767",
            "Φ 131.3 ± 2.4°",
            "above noise",
            "play_at_bend 97 %, as of frame 812",
            "θ, up to 30°",
            "p pause",
        ] {
            assert!(text.contains(expected), "{expected}: {text}");
        }
        state.source.state = SourceState::Running;
        state.timing.state = FrameTimingState::Behind;
        state.timing.sentence = Some("frames are 143 ms old".into());
        state.stem = Some(StemStatus { phi_deg: 131.26, sd_phi_deg: 2.4 });
        let text = screen(&state, 100, 24);
        assert!(text.contains("behind  frames are 143 ms old"), "{text}");
        screen(&state, 12, 4);
    }
}
