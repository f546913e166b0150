//! The state as Prometheus reads it: its text exposition format 0.0.4.

use super::latency::Histogram;
use super::shared_state::LiveState;
use super::status::{EncoderStatus, FrameTimingState, FrameTimingStatus, GapStatus, SourceState, SourceStatus, State};
use crate::estimate::EtaLambda;
use std::fmt::Write;

/// Upper ends of the latency buckets, s. Convention: a display choice.
const LATENCY_ENDS_S: [f64; 9] = [0.005, 0.01, 0.015, 0.02, 0.03, 0.05, 0.1, 0.25, 1.0];

/// All metrics.
pub fn text(shared: &LiveState) -> String {
    let state = &shared.state;
    let mut metrics = Exposition::default();
    metrics.source(&state.source);
    metrics.timing(&state.timing);
    metrics.measurements(shared);
    metrics.encoders(&state.encoders);
    metrics.estimates(state);
    metrics.gap(&state.gap);
    metrics.gauge("paused", "Whether measuring is paused.", flag(state.paused));
    if let Some(bytes) = resident_bytes() {
        metrics.gauge("resident_memory_bytes", "Memory of the process.", bytes);
    }
    metrics.latency(&shared.latencies);
    metrics.text
}

/// The text as it is written.
#[derive(Debug, Default)]
struct Exposition {
    text: String,
}

impl Exposition {
    fn head(&mut self, name: &str, kind: &str, help: &str) {
        self.text += &format!("# HELP snakeloop_{name} {help}\n# TYPE snakeloop_{name} {kind}\n");
    }

    fn value(&mut self, name: &str, value: f64) {
        // Writing to a String cannot fail.
        let _ = writeln!(self.text, "snakeloop_{name} {value}");
    }

    fn gauge(&mut self, name: &str, help: &str, value: f64) {
        self.head(name, "gauge", help);
        self.value(name, value);
    }

    fn counter(&mut self, name: &str, help: &str, value: u64) {
        self.head(name, "counter", help);
        self.value(name, value as f64);
    }

    /// A metric with a value for each of several labels.
    fn labelled<'a>(
        &mut self,
        (name, kind, help): (&str, &str, &str),
        label: &str,
        values: impl IntoIterator<Item = (&'a str, f64)>,
    ) {
        self.head(name, kind, help);
        for (of, value) in values {
            let of: String = of.chars().filter(|c| c.is_ascii_alphanumeric() || *c == '_').collect();
            self.value(&format!("{name}{{{label}=\"{of}\"}}"), value);
        }
    }

    fn source(&mut self, source: &SourceStatus) {
        self.gauge("source_up", "Whether frames come.", flag(source.state == SourceState::Running));
        self.counter("frames_total", "Frames that came.", source.frames);
        let help = "Frames that gave way to newer ones before they were measured.";
        self.counter("frames_dropped_total", help, source.dropped);
        self.counter("reconnects_total", "How often the source came back.", source.reconnects);
        self.gauge("frame_rate_hertz", "Frames per second.", source.rate_fps);
    }

    fn timing(&mut self, timing: &FrameTimingStatus) {
        self.gauge("frame_age_seconds", "How old frames are when they are measured.", timing.age_ms / 1000.0);
        let states = [("behind", FrameTimingState::Behind), ("late", FrameTimingState::Late)];
        let states = states.map(|(name, state)| (name, flag(timing.state == state)));
        self.labelled(("pace", "gauge", "Whether frames are measured too late, or come too late."), "state", states);
        self.counter("frames_late_total", "Frames that came late and were not learned from.", timing.late);
    }

    fn measurements(&mut self, shared: &LiveState) {
        let by_status = shared.by_status.iter().map(|(status, count)| (status.as_str(), *count as f64));
        self.labelled(("measurements_total", "counter", "Measurements by their status."), "status", by_status);
        self.counter("rejected_total", "Measurements that the gate rejected.", shared.state.rejected);
    }

    fn encoders(&mut self, encoders: &EncoderStatus) {
        let are_there = matches!(encoders.state, "running" | "log");
        self.gauge("encoders_up", "Whether encoder readings are there.", flag(are_there));
        self.counter("encoder_readings_total", "Encoder readings.", encoders.readings);
        self.counter("encoder_bad_lines_total", "Lines that were no reading.", encoders.bad_lines);
        self.gauge("encoder_offset_seconds", "What is added to the encoders' times.", encoders.offset_s);
    }

    fn estimates(&mut self, state: &State) {
        if let Some(EtaLambda { eta, sd_eta, lambda_mm, sd_lambda_mm }) =
            state.estimate.map(|estimate| estimate.parameters)
        {
            self.gauge("eta", "Estimate of eta.", eta);
            self.gauge("eta_sd", "Its standard deviation.", sd_eta);
            self.gauge("lambda_millimetres", "Estimate of lambda.", lambda_mm);
            self.gauge("lambda_sd_millimetres", "Its standard deviation.", sd_lambda_mm);
        }
        if let Some(stem) = &state.stem {
            self.gauge("stem_degrees", "Total bending angle of the stem.", stem.phi_deg);
            self.gauge("stem_sd_degrees", "Its standard deviation.", stem.sd_phi_deg);
        }
    }

    fn gap(&mut self, gap: &GapStatus) {
        let help = "Mean square of the whitened innovations; 1 is noise.";
        let parts = [("bending", gap.bending), ("common", gap.common)];
        self.labelled(("gap_mean_square", "gauge", help), "part", parts);
    }

    fn latency(&mut self, latencies: &Histogram) {
        self.head("latency_seconds", "histogram", "From a frame's arrival to the estimate.");
        for end in LATENCY_ENDS_S {
            self.value(&format!("latency_seconds_bucket{{le=\"{end}\"}}"), latencies.at_most(end) as f64);
        }
        self.value("latency_seconds_bucket{le=\"+Inf\"}", latencies.total() as f64);
        self.value("latency_seconds_sum", latencies.sum_s());
        self.value("latency_seconds_count", latencies.total() as f64);
    }
}

fn flag(yes: bool) -> f64 {
    f64::from(u8::from(yes))
}

/// Resident memory of this process, where the system tells it the way Linux does.
fn resident_bytes() -> Option<f64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find_map(|line| line.strip_prefix("VmRSS:"))?;
    let kilobytes: f64 = line.trim().strip_suffix("kB")?.trim().parse().ok()?;
    Some(1024.0 * kilobytes)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::live::publication::{POSES, PublicationGate};
    use crate::live::shared_state::SharedState;
    use crate::live::status::EstimateStatus;
    use crate::robot::Model;

    #[test]
    fn every_metric_has_its_help_its_type_and_its_value() {
        let mut state = State::at_start("camera 0".into(), EncoderStatus::at_rest("log", 24));
        state.estimate = Some(EstimateStatus {
            parameters: EtaLambda { eta: 1.25, sd_eta: 0.5, lambda_mm: 0.125, sd_lambda_mm: 0.25 },
            samples: 9,
        });
        state.timing.state = FrameTimingState::Late;
        let shared = SharedState::new(state, Model::default(), PublicationGate::new(0.0015, POSES, None));
        shared.lock().by_status.insert("odd \"status\"\n".into(), 3);
        shared.lock().latencies.add(0.012);
        let text = text(&shared.lock());
        let known: Vec<&str> = text.lines().filter_map(|line| line.strip_prefix("# TYPE snakeloop_")).collect();
        for line in text.lines().filter(|line| !line.starts_with('#')) {
            let (name, value) = line.strip_prefix("snakeloop_").unwrap().rsplit_once(' ').unwrap();
            assert!(value.parse::<f64>().is_ok(), "{line}");
            let family = name.split('{').next().unwrap();
            let family = ["_bucket", "_sum", "_count"].iter().fold(family, |name, end| name.trim_end_matches(end));
            assert!(known.iter().any(|known| known.split(' ').next() == Some(family)), "{line}");
        }
        for expected in [
            "snakeloop_pace{state=\"late\"} 1\n",
            "snakeloop_measurements_total{status=\"oddstatus\"} 3\n",
            "snakeloop_eta 1.25\n",
            "snakeloop_encoder_readings_total 24\n",
            "snakeloop_latency_seconds_bucket{le=\"0.01\"} 0\n",
            "snakeloop_latency_seconds_bucket{le=\"+Inf\"} 1\n",
            "# TYPE snakeloop_latency_seconds histogram\n",
        ] {
            assert!(text.contains(expected), "{expected}");
        }
    }
}
