//! The plots of a run's report: what the model says of bends, forces and commands, beside what was measured.

use super::plot::{Plot, Point, Series, Style};
use super::run_history::RunHistory;
use crate::geometry::Configuration;
use crate::observation::{EncoderReading, Measured};
use crate::robot::{Model, PerBackbone, TableRow};

/// Largest θ of the curves of q̃, degrees. Convention: the default table's.
const LARGEST_DEG: f64 = 90.0;
/// Step of these curves, degrees. Convention: a display choice.
const STEP_DEG: f64 = 3.0;

/// Direction δ of these curves, degrees. Convention: one in which no two of three backbones need the same.
const DIRECTION_DEG: f64 = 15.0;

/// A plot with its title and caption.
pub struct Titled {
    /// The heading.
    pub title: &'static str,
    /// What stands below.
    pub caption: String,
    /// The plot.
    pub plot: Plot,
}

/// The measured angles of rows that have a reading, with it.
pub struct Sampled<'a> {
    /// The model that was learned.
    model: &'a Model,
    samples: Vec<(Measured, PerBackbone)>,
}

impl<'a> Sampled<'a> {
    /// The rows that are plotted, with their readings; these are in order of their index.
    pub fn of(model: &'a Model, history: &RunHistory, readings: &[EncoderReading]) -> Self {
        let sample = |index: u64, measured: Option<Measured>| {
            let at = readings.binary_search_by_key(&index, |reading| reading.index).ok()?;
            Some((measured?, readings[at].q_mm))
        };
        Self { model, samples: history.plotted.iter().filter_map(|(m, _)| sample(m.index, m.measured)).collect() }
    }

    /// The bend that a model expects of each command, beside the bend that was measured.
    fn expected(&self, model: &Model) -> Vec<(Configuration, Configuration)> {
        let expected = |(measured, q_mm): &(Measured, PerBackbone)| {
            Some((model.forward(q_mm).ok()?.configuration, measured.configuration))
        };
        self.samples.iter().filter_map(expected).collect()
    }

    /// What the learned table misses: reached less desired bend over the desired one, with the noise of the measurements.
    pub fn missed_after(&self) -> Titled {
        Titled {
            title: "Reached − desired bend, after learning",
            caption: "The same for the learned model alone, with bars of ±1σ of the measurement. At zero the snake goes where it is sent."
                .into(),
            plot: self.missed_plot(vec![self.missed_by("after compensation", self.model)]),
        }
    }

    /// The same for the naive table, beside the learned one.
    pub fn missed_before(&self) -> Titled {
        let naive = self.model.without_estimate();
        let both = [self.missed_by("before compensation", &naive), self.missed_by("after compensation", self.model)];
        Titled {
            title: "Reached − desired bend, before and after",
            caption: "Measured bend less the bend that a model expects of the same command: by the naive model (η = 1, λ = 0, nothing learned) and by \
                      the learned one."
                .into(),
            plot: self.missed_plot(both.into()),
        }
    }

    /// Reached less desired θ of every sample, with the measurement's σ, by the bend that a model expects.
    fn missed_by(&self, name: &str, model: &Model) -> Series {
        let point = |(measured, q_mm): &(Measured, PerBackbone)| {
            let desired_deg = model.forward(q_mm).ok()?.configuration.theta_deg();
            let y = measured.configuration.theta_deg() - desired_deg;
            Some(Point { x: desired_deg, y, sd: measured.sigma_theta.to_degrees() })
        };
        let mut points: Vec<Point> = self.samples.iter().filter_map(point).collect();
        points.sort_by(|a, b| a.x.total_cmp(&b.x));
        Series { name: name.into(), style: Style::Dots, points }
    }

    fn missed_plot(&self, series: Vec<Series>) -> Plot {
        let (x_label, y_label) = ("desired θ (°)".into(), "reached − desired θ (°)".into());
        Plot { x_label, y_label, series, y_shown: vec![0.0] }
    }

    /// ε over τ: what the line takes up, and the law that was found.
    pub fn epsilon_over_tau(&self) -> Titled {
        let (robot, backbones) = (&self.model.robot, self.model.robot.backbone_count());
        // τ, ε as it was measured, and ε by the law, of every sample.
        let of_sample = |(measured, q_mm): &(Measured, PerBackbone)| {
            let psi = measured.configuration;
            let tau_n = robot.actuation_forces(psi.bend_vector(), None);
            (tau_n, *q_mm - robot.joint_displacements(psi), self.model.epsilon(psi))
        };
        let samples: Vec<_> = self.samples.iter().map(of_sample).collect();
        let point =
            |tau_n: &PerBackbone, epsilon_mm: &PerBackbone, i: usize| Point { x: tau_n[i], y: epsilon_mm[i], sd: 0.0 };
        let measured = (0..backbones).map(|i| Series {
            name: format!("backbone {}", i + 1),
            style: Style::Dots,
            points: samples.iter().map(|(tau_n, measured_mm, _)| point(tau_n, measured_mm, i)).collect(),
        });
        let of_law = samples.iter().flat_map(|(tau_n, _, law_mm)| (0..backbones).map(move |i| point(tau_n, law_mm, i)));
        let mut law: Vec<Point> = of_law.collect();
        law.sort_by(|a, b| a.x.total_cmp(&b.x));
        let law = Series { name: "Eq. 18 as learned".into(), style: Style::Band, points: law };
        Titled {
            title: "Compensation ε over force τ",
            caption: "ε = q̃ − q is the part of a command that the actuation line takes up; τ is the force that the bent snake needs of a backbone by the \
                      model. The slope is η times the line's compliance; the height at τ = 0 is λ and the part of the friction f_s."
                .into(),
            plot: Plot {
                x_label: "τ (N)".into(),
                y_label: "ε (mm)".into(),
                series: std::iter::once(law).chain(measured).collect(),
                y_shown: vec![],
            },
        }
    }

    /// Each measured bend, with how far the model misses it, degrees.
    pub fn misses_deg(&self) -> Vec<(Configuration, f64)> {
        let miss = |(expected, measured): (Configuration, Configuration)| {
            (measured, (measured.bend_vector() - expected.bend_vector()).norm().to_degrees())
        };
        self.expected(self.model).into_iter().map(miss).collect()
    }
}

/// q̃ over θ in one direction.
pub fn command_over_theta(model: &Model) -> Titled {
    let rows: Vec<TableRow> = (0..=(LARGEST_DEG / STEP_DEG) as usize)
        .map(|k| TableRow::new(model, Configuration::from_degrees(k as f64 * STEP_DEG, DIRECTION_DEG)))
        .collect();
    let series = (0..model.robot.backbone_count()).map(|i| Series {
        name: format!("backbone {}", i + 1),
        style: Style::Band,
        points: rows
            .iter()
            .map(|row| Point { x: row.configuration.theta_deg(), y: row.command_mm[i], sd: row.sd_command_mm[i] })
            .collect(),
    });
    Titled {
        title: "Command q̃ over θ",
        caption: format!(
            "What to command each backbone for a bend towards δ = {DIRECTION_DEG}°, with its band of ±1σ."
        ),
        plot: Plot { x_label: "θ (°)".into(), y_label: "q̃ (mm)".into(), series: series.collect(), y_shown: vec![] },
    }
}

/// The largest correction of a backbone at each pose of a coarse grid, mm.
pub fn corrections_mm(model: &Model) -> Vec<(Configuration, f64)> {
    let poses = (1..=9).flat_map(|t| (0..24).map(move |d| (10.0 * f64::from(t), 15.0 * f64::from(d) - 165.0)));
    let poses = poses.map(|(theta_deg, delta_deg)| Configuration::from_degrees(theta_deg, delta_deg));
    poses.map(|psi| (psi, model.epsilon(psi).amax())).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::estimate::{EstimateRow, Verdict};
    use crate::observation::{Measurement, Status};
    use crate::robot::Estimate;
    use nalgebra::Matrix2;

    #[test]
    fn a_perfect_model_reaches_what_is_desired_and_lies_on_its_law() {
        let estimate = Estimate { eta: 1.2, lambda_mm: 0.17, covariance: Matrix2::identity() * 1e-6, samples: 9 };
        let model = Model::default().with_estimate(estimate);
        let (mut measurements, mut rows, mut readings) = (Vec::new(), Vec::new(), Vec::new());
        for index in 0..4u64 {
            let configuration = Configuration::from_degrees(20.0 * index as f64 + 5.0, 30.0);
            let measured = Measured::independent(configuration, 1e-3, 1e-3, 0.0);
            let (time_s, view) = (Some(index as f64), None);
            measurements.push(Measurement {
                index,
                time_s,
                status: Status::Ok,
                measured: Some(measured),
                quality: None,
                view,
            });
            rows.push(EstimateRow {
                index,
                time_s,
                estimate: None,
                verdict: Verdict::Used,
                reason: String::new(),
                residual_mm: None,
                view: None,
            });
            readings.push(EncoderReading::new(index, index as f64, model.command(configuration)));
        }
        let history = RunHistory::of(&measurements, &rows);
        let sampled = Sampled::of(&model, &history, &readings);
        let [before, after] = &sampled.missed_before().plot.series[..] else { panic!("two series") };
        assert!(after.points.iter().all(|p| p.y.abs() < 1e-6));
        assert!(before.points.last().is_some_and(|p| p.y < -3.0), "the naive table falls short");
        assert_eq!(&sampled.missed_after().plot.series[..], std::slice::from_ref(after));
        let plot = sampled.epsilon_over_tau().plot;
        let law = &plot.series[0].points;
        for p in plot.series[1..].iter().flat_map(|series| &series.points) {
            assert!(law.iter().any(|l| (l.x - p.x).abs() < 1e-9 && (l.y - p.y).abs() < 1e-9), "{p:?}");
        }
        assert!(sampled.misses_deg().iter().all(|(_, miss)| *miss < 1e-5));
    }
}
