//! Numbers at the edge of what can be written, angles at the seam of the circle, and pictures of next to nothing.

use nalgebra::{Point2, Vector2};
use proptest::prelude::*;
use snakeloop::camera::{Frame, Lens, Samples};
use snakeloop::estimate::{Estimator, Options};
use snakeloop::geometry::{Configuration, wrap_angle, wrap_degrees};
use snakeloop::measure::{Eye, Rig, RigOptions, calibrate_rig};
use snakeloop::observation::{EncoderReading, Measured, Measurement, Status};
use snakeloop::record::{Checked, read_encoders, read_friction, read_measurements, read_trajectory, read_truth};
use snakeloop::robot::{MAX_THETA, Model, PerBackbone, Robot};
use std::f64::consts::PI;
use std::path::Path;

/// Numbers that break what was not made for them.
fn extreme() -> impl Strategy<Value = f64> {
    prop_oneof![
        prop::sample::select(vec![
            0.0,
            -0.0,
            5e-324,
            f64::MIN_POSITIVE,
            f64::EPSILON,
            1e-9,
            PI,
            -PI,
            180.0,
            -180.0,
            360.0,
            1e154,
            1e300,
            f64::MAX,
            f64::MIN,
            f64::INFINITY,
            f64::NEG_INFINITY,
            f64::NAN,
        ]),
        any::<f64>(),
        -200.0..200.0f64,
    ]
}

/// What a spreadsheet, a script or a slip leaves in a field.
fn field() -> impl Strategy<Value = String> {
    prop_oneof![
        extreme().prop_map(|value| format!("{value}")),
        extreme().prop_map(|value| format!("{value:e}")),
        prop::sample::select(vec![
            "",
            "nan",
            "NaN",
            "-nan",
            "inf",
            "+Infinity",
            "1e999",
            "-1e999",
            "0x10",
            "1_000",
            "1,5"
        ])
        .prop_map(str::to_owned),
    ]
}

/// Reads a table of one good row and one with these fields, and gives the second's numbers if it was accepted.
fn second_row<T>(
    header: &str,
    good: &str,
    fields: &[String],
    read: impl Fn(&Path) -> snakeloop::Result<Checked<T>>,
    numbers: impl Fn(&T) -> Vec<f64>,
) -> std::result::Result<(), TestCaseError> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("table.csv");
    let quoted: Vec<_> = fields.iter().map(|field| format!("\"{field}\"")).collect();
    std::fs::write(&path, format!("{header}\n{good}\n1,{}\n", quoted.join(","))).unwrap();
    let unreadable = |field: &String| field != "ok" && !field.is_empty() && !field.parse().is_ok_and(f64::is_finite);
    match read(&path) {
        Ok(Checked { rows, warnings }) => {
            for row in &rows {
                prop_assert!(numbers(row).iter().all(|value| value.is_finite()), "{fields:?}");
            }
            if fields.iter().any(unreadable) {
                prop_assert_eq!(rows.len(), 1);
                prop_assert!(warnings[0].to_string().contains("table.csv:3: "), "{}", &warnings[0]);
            }
        }
        // Times that do not rise make a trajectory none.
        Err(why) => prop_assert!(why.to_string().contains("table.csv"), "{why}"),
    }
    Ok(())
}

/// So many cases; without a file for those that failed, which has no good place beside an integration test.
fn cases(cases: u32) -> ProptestConfig {
    ProptestConfig { cases, failure_persistence: None, ..ProptestConfig::default() }
}

proptest! {
    #![proptest_config(cases(64))]
    #[test]
    fn no_table_lets_through_what_is_not_finite(fields in prop::collection::vec(field(), 5)) {
        let angles = |psi: Configuration| vec![psi.theta, psi.delta];
        second_row("index,time_s,q1_mm,q2_mm,q3_mm", "0,0,0,0,0", &fields[..4], |path| read_encoders(path, 3), |row| {
            [&[row.time_s], &row.q_mm[..]].concat()
        })?;
        second_row("index,theta_deg,delta_deg", "0,1,1", &fields[..2], read_truth, |row| angles(row.configuration))?;
        second_row("index,time_s,theta_deg,delta_deg", "0,-1e308,1,1", &fields[..3], read_trajectory, |row| {
            [angles(row.configuration), vec![row.time_s]].concat()
        })?;
        second_row("index,tau_g,tau_limit_g,tau_tilde_g,tau_tilde_limit_g", "0,1,1,1,1", &fields[..4], read_friction, |row| {
            vec![row.tau_g, row.tau_limit_g, row.tau_tilde_g, row.tau_tilde_limit_g]
        })?;
        let measured = [&fields[..], &["ok".to_owned()]].concat();
        let header = "index,time_s,theta_deg,delta_deg,sigma_theta_deg,sigma_delta_deg,status";
        let numbers = |row: &Measurement| {
            let angles = row.measured.map(|m| angles(m.configuration)).unwrap_or_default();
            [angles, row.time_s.into_iter().collect()].concat()
        };
        second_row(header, "0,0,1,1,1,1,ok", &measured, read_measurements, numbers)?;
    }
}

proptest! {
    #![proptest_config(cases(256))]
    #[test]
    fn angles_stay_on_the_circle(angle in extreme(), theta in extreme()) {
        for (wrapped, half) in [(wrap_angle(angle), PI), (wrap_degrees(angle), 180.0)] {
            prop_assert_eq!(wrapped.is_nan(), !angle.is_finite());
            prop_assert!(wrapped.is_nan() || (wrapped > -half && wrapped <= half), "{angle} → {wrapped}");
        }
        let psi = Configuration::new(theta, angle);
        prop_assert!(psi.theta.is_nan() || psi.theta >= 0.0);
        prop_assert!(psi.delta.is_nan() || (psi.delta > -PI && psi.delta <= PI));
        let back = Configuration::from_bend_vector(psi.bend_vector());
        prop_assert!(back.delta.is_nan() || (back.delta > -PI && back.delta <= PI));
    }

    #[test]
    fn both_sides_of_the_seam_are_one_azimuth(theta_deg in 0.0..110.0f64, turns in -3i32..=3, off in -1e-9..1e-9f64) {
        let model = Model::default();
        let at = |delta_deg: f64| model.command(Configuration::from_degrees(theta_deg, delta_deg));
        let whole = 360.0 * f64::from(turns);
        prop_assert!((at(180.0 + off + whole) - at(-180.0)).amax() < 1e-9);
        let found = model.forward(&at(180.0 + off)).unwrap().configuration;
        prop_assert!((found.theta_deg() - theta_deg).abs() < 1e-6);
        prop_assert!(found.delta > -PI && found.delta <= PI);
        prop_assert!(theta_deg < 0.1 || (found.delta.abs() - PI).abs() < 1e-6);
    }

    #[test]
    fn straight_has_no_azimuth(delta_deg in -180.0..180.0f64) {
        let model = Model::default();
        let at = |delta_deg: f64| model.command(Configuration::from_degrees(0.0, delta_deg));
        prop_assert_eq!(at(delta_deg), at(0.0));
        prop_assert!(model.forward(&at(delta_deg)).unwrap().configuration.theta < 1e-9);
    }

    #[test]
    fn both_ways_through_the_model_answer_anything(q in prop::array::uniform3(extreme()), theta in extreme(), delta in extreme()) {
        let model = Model::default();
        if let Ok(response) = model.forward(&PerBackbone::from(q)) {
            let psi = response.configuration;
            prop_assert!(psi.theta <= MAX_THETA && psi.delta.is_finite(), "{psi:?} of {q:?}");
            prop_assert!(response.common_mm.is_finite());
        }
        let psi = Configuration::new(theta, delta);
        model.command(psi);
        model.command_sds(psi);
        let _ = model.updated_jacobian(psi);
        let _ = model.response_covariance(psi);
        model.robot.frame_at(psi, delta);
    }

    #[test]
    fn no_measurement_makes_the_estimate_anything_but_numbers(
        rows in prop::collection::vec((prop::array::uniform8(extreme()), any::<bool>()), 1..30), gated in any::<bool>()
    ) {
        let gate = if gated { 4.5 } else { f64::INFINITY };
        let mut estimator = Estimator::new(&Model::default(), Options { gate, forgetting: 0.99, ..Options::default() }).unwrap();
        for (k, (numbers, good)) in rows.iter().enumerate() {
            let [theta, delta, sigma_theta, sigma_delta, correlation, q1, q2, q3] = *numbers;
            let psi = Configuration::from_degrees(20.0 + k as f64, 30.0);
            let (measured, q_mm) = if *good {
                let measured = Measured::independent(psi, 0.002, 0.004, 0.0);
                (measured, Model::default().command(psi))
            } else {
                let configuration = Configuration { theta, delta };
                (Measured::independent(configuration, sigma_theta, sigma_delta, correlation), PerBackbone::from([q1, q2, q3]))
            };
            let index = k as u64;
            let (status, measured) = (Status::Ok, Some(measured));
            let measurement = Measurement { index, time_s: None, status, measured, quality: None, view: None };
            let step = estimator.update(&measurement, Some(&EncoderReading::new(index, 0.0, q_mm)));
            if let Some(estimate) = step.estimate {
                prop_assert!(estimate.eta.is_finite() && estimate.lambda_mm.is_finite(), "{estimate:?}");
                prop_assert!(estimate.covariance.iter().all(|value| value.is_finite()), "{estimate:?}");
            }
        }
    }
}

/// The view of a camera of any size, with the rig of a good one.
fn lens(width: u32, height: u32) -> Lens {
    Lens {
        width,
        height,
        focal_px: Vector2::new(2100.0, 2100.0),
        centre_px: Point2::new(f64::from(width) / 2.0, f64::from(height) / 2.0),
        distortion: [0.0; 12],
        fisheye: None,
    }
}

fn good_rig() -> Rig {
    Rig::read(&Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/fuzz/corpus/settings/rig.toml")).unwrap()
}

#[test]
fn pictures_of_next_to_nothing_are_measured_as_such() {
    for (width, height) in [(0, 0), (1, 1), (1, 40), (40, 1), (2, 3), (7, 7), (16, 9), (64, 48)] {
        let eye = Eye::new(lens(width, height), good_rig(), Robot::default());
        for channels in [1, 3] {
            let count = width as usize * height as usize * channels;
            let chequered = |k: usize| if k.is_multiple_of(2) { 0 } else { u16::MAX };
            for level in [|_| 0, |_| u16::MAX, chequered, |k: usize| (k * 2_654_435_761 % 65_536) as u16] {
                let frame =
                    Frame { width, height, channels, samples: Samples::Bits16((0..count).map(level).collect()) };
                let seen = [eye.measure(&frame), eye.track(&frame, Vector2::new(0.5, 0.5))];
                assert!(seen.iter().all(|measurement| measurement.measured.is_none()), "{width}×{height}: {seen:?}");
                let options = RigOptions { grid_pitch_mm: 1.0, standoff_mm: 25.0, delta_offset: 0.0 };
                calibrate_rig(&frame, &lens(width, height), &Robot::default(), &options).unwrap_err();
            }
        }
    }
}
