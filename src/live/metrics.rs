//! The figures in the text form that Prometheus reads.

use super::board::Content;
use super::pace::PaceState;
use super::source::SourceState;
use std::fmt::Write;

/// Upper ends of the latency buckets, s.
const LATENCY_ENDS_S: [f64; 9] = [0.005, 0.01, 0.015, 0.02, 0.03, 0.05, 0.1, 0.25, 1.0];

/// All figures.
pub fn text(content: &Content) -> String {
    let state = &content.state;
    let mut text = String::new();
    let mut metric = |name: &str, kind: &str, help: &str, values: &[(&str, f64)]| {
        // Writing to a String cannot fail.
        let _ = writeln!(text, "# HELP snakeloop_{name} {help}\n# TYPE snakeloop_{name} {kind}");
        for (labels, value) in values {
            let _ = writeln!(text, "snakeloop_{name}{labels} {value}");
        }
    };
    let flag = |yes: bool| f64::from(u8::from(yes));
    let running = flag(state.source.state == SourceState::Running);
    metric("source_up", "gauge", "Whether frames come.", &[("", running)]);
    metric("frames_total", "counter", "Frames that came.", &[("", state.source.frames as f64)]);
    metric(
        "frames_dropped_total",
        "counter",
        "Frames that gave way to newer ones before they were measured.",
        &[("", state.source.dropped as f64)],
    );
    metric("reconnects_total", "counter", "How often the source came back.", &[("", state.source.reconnects as f64)]);
    metric("frame_rate_hertz", "gauge", "Frames per second.", &[("", state.source.rate_fps)]);
    let pace = &state.pace;
    let age_s = pace.age_ms / 1000.0;
    metric("frame_age_seconds", "gauge", "How old frames are when they are measured.", &[("", age_s)]);
    let kept_up = [("{state=\"behind\"}", PaceState::Behind), ("{state=\"late\"}", PaceState::Late)];
    let kept_up = kept_up.map(|(labels, of)| (labels, flag(pace.state == of)));
    metric("pace", "gauge", "Whether frames are measured too late, or come too late.", &kept_up);
    metric(
        "frames_late_total",
        "counter",
        "Frames that came late and were not learned from.",
        &[("", pace.late as f64)],
    );
    let by_status: Vec<(String, f64)> = content
        .by_status
        .iter()
        .map(|(status, count)| {
            let safe: String = status.chars().filter(|c| c.is_ascii_alphanumeric() || *c == '_').collect();
            (format!("{{status=\"{safe}\"}}"), *count as f64)
        })
        .collect();
    let by_status: Vec<(&str, f64)> = by_status.iter().map(|(labels, count)| (labels.as_str(), *count)).collect();
    metric("measurements_total", "counter", "Measurements by their status.", &by_status);
    metric("rejected_total", "counter", "Measurements that the gate rejected.", &[("", state.rejected as f64)]);
    metric(
        "encoders_up",
        "gauge",
        "Whether encoder readings are there.",
        &[("", flag(matches!(state.encoders.state, "running" | "log")))],
    );
    metric("encoder_readings_total", "counter", "Encoder readings.", &[("", state.encoders.readings as f64)]);
    metric(
        "encoder_bad_lines_total",
        "counter",
        "Lines that were no reading.",
        &[("", state.encoders.bad_lines as f64)],
    );
    metric(
        "encoder_offset_seconds",
        "gauge",
        "What is added to the encoders' times.",
        &[("", state.encoders.offset_s)],
    );
    if let Some(estimate) = &state.estimate {
        metric("eta", "gauge", "Estimate of eta.", &[("", estimate.eta)]);
        metric("eta_sd", "gauge", "Its standard deviation.", &[("", estimate.sd_eta)]);
        metric("lambda_millimetres", "gauge", "Estimate of lambda.", &[("", estimate.lambda_mm)]);
        metric("lambda_sd_millimetres", "gauge", "Its standard deviation.", &[("", estimate.sd_lambda_mm)]);
    }
    if let Some(stem) = &state.stem {
        metric("stem_degrees", "gauge", "Total bending angle of the stem.", &[("", stem.phi_deg)]);
        metric("stem_sd_degrees", "gauge", "Its standard deviation.", &[("", stem.sd_phi_deg)]);
    }
    let parts = [("{part=\"bending\"}", state.gap.bending), ("{part=\"common\"}", state.gap.common)];
    metric("gap_mean_square", "gauge", "Mean square of the whitened innovations; 1 is noise.", &parts);
    metric("paused", "gauge", "Whether measuring is paused.", &[("", flag(state.paused))]);
    if let Some(bytes) = resident_bytes() {
        metric("resident_memory_bytes", "gauge", "Memory of the process.", &[("", bytes)]);
    }
    let latencies = &content.latencies;
    text += "# HELP snakeloop_latency_seconds From a frame's arrival to the estimate.\n\
             # TYPE snakeloop_latency_seconds histogram\n";
    for end in LATENCY_ENDS_S {
        let _ = writeln!(text, "snakeloop_latency_seconds_bucket{{le=\"{end}\"}} {}", latencies.at_most(end));
    }
    let _ = writeln!(text, "snakeloop_latency_seconds_bucket{{le=\"+Inf\"}} {}", latencies.total());
    let _ = writeln!(text, "snakeloop_latency_seconds_sum {}", latencies.sum_s());
    let _ = writeln!(text, "snakeloop_latency_seconds_count {}", latencies.total());
    text
}

/// Resident memory of this process, where the system tells it the way Linux does.
fn resident_bytes() -> Option<f64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find_map(|line| line.strip_prefix("VmRSS:"))?;
    let kilobytes: f64 = line.trim().strip_suffix("kB")?.trim().parse().ok()?;
    Some(1024.0 * kilobytes)
}
