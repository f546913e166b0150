use super::*;
use crate::geometry::Configuration;
use crate::observation::{Measured, Quality, Status};
use crate::record::write_atomically;
use approx::assert_abs_diff_eq;
use nalgebra::Matrix2;
use proptest::prelude::*;

/// The columns that the design fixes.
const FIXED: [&str; 7] = ["index", "time_s", "theta_deg", "delta_deg", "sigma_theta_deg", "sigma_delta_deg", "status"];

fn read_text(text: &str) -> Result<Checked<Measurement>> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("measurements.csv");
    write_atomically(&path, text.as_bytes()).unwrap();
    read_measurements(&path)
}

#[test]
fn a_frame_that_was_not_measured_has_its_row_with_empty_angles() {
    let unmeasured = Measurement {
        index: 7,
        time_s: Some(1.5),
        status: Status::NoSnake,
        measured: None,
        quality: None,
        view: Some("side".into()),
    };
    let text = measurements_csv(std::slice::from_ref(&unmeasured));
    assert_eq!(
        text,
        "index,time_s,theta_deg,delta_deg,sigma_theta_deg,sigma_delta_deg,status,\
         bend_x_deg,bend_y_deg,var_xx,var_xy,var_yy,rho_theta_delta,edges,inlier_fraction,rms_px,base_moved_px,grid_moved_px,view,\
         tip_theta_deg,sigma_tip_theta_deg,shape_along_deg,sigma_shape_along_deg,shape_across_deg,\
         sigma_shape_across_deg,shape_chi2,bend_x_by_rig1_deg,bend_y_by_rig1_deg,bend_x_by_rig2_deg,\
         bend_y_by_rig2_deg,bend_x_by_rig3_deg,bend_y_by_rig3_deg,bend_x_by_rig4_deg,bend_y_by_rig4_deg,\
         bend_x_by_rig5_deg,bend_y_by_rig5_deg,bend_x_by_rig6_deg,bend_y_by_rig6_deg\n\
         7,1.5000,,,,,no_snake,,,,,,,,,,,,side,,,,,,,,,,,,,,,,,,,\n"
    );
    assert_eq!(read_text(&text).unwrap().rows, [unmeasured]);
}

#[test]
fn the_fixed_columns_suffice() {
    let text = "index,time_s,theta_deg,delta_deg,sigma_theta_deg,sigma_delta_deg,status\n0,,30,200,0.1,0.2,ok\n";
    let row = read_text(text).unwrap().rows.remove(0);
    let measured = row.measured.unwrap();
    assert_eq!((row.time_s, row.status, measured.correlation), (None, Status::Ok, 0.0));
    assert_abs_diff_eq!(measured.configuration.delta_deg(), -160.0, epsilon = 1e-9);
}

#[test]
fn measurements_without_sigmas_are_read() {
    for text in ["index,time_s,theta_deg,delta_deg,status\n0,,30,20,ok\n", &(FIXED.join(",") + "\n0,,30,20,,,ok\n")] {
        let measured = read_text(text).unwrap().rows.remove(0).measured.unwrap();
        assert!(measured.sigma_theta.is_nan() && measured.sigma_delta.is_nan());
    }
}

#[test]
fn rows_that_cannot_be_right_are_skipped() {
    let header = FIXED.join(",");
    let good = "9,,1,2,0.1,0.2,ok";
    for (row, fault) in [
        ("0,,,,,,ok", "the angles are empty"),
        ("0,,-1,0,0.1,0.1,ok", "theta_deg is -1"),
        ("0,,1,1000,0.1,0.1,ok", "delta_deg is 1000"),
        ("0,,1,1,0,0.1,ok", "sigma_theta_deg is 0, expected more than 0"),
        ("0,,1,1,0.1,0.1,", "status is empty"),
    ] {
        let checked = read_text(&format!("{header}\n{row}\n{good}\n")).unwrap();
        assert_eq!(checked.rows.len(), 1, "{row}");
        assert!(checked.warnings[0].message.contains(fault), "{row}: {}", checked.warnings[0]);
    }
}

#[test]
fn the_fits_own_covariance_stands_beside_the_angles_and_counts_as_long_as_they_are_its_own() {
    let turned = |along: f64, across: f64| {
        let turn = nalgebra::Rotation2::new(20f64.to_radians());
        turn * Matrix2::new(along.powi(2), 0.0, 0.0, across.powi(2)) * turn.inverse()
    };
    let psi = Configuration::from_degrees(30.0, 20.0);
    let [along, across] = [0.03f64, 0.05].map(f64::to_radians);
    let polar = Measured::independent(psi, along, across / psi.theta, 0.0);
    let fitted = Measured { fitted_covariance: Some(turned(along, across)), ..polar };
    let row = |measured| Measurement {
        index: 0,
        time_s: None,
        status: Status::Ok,
        measured: Some(measured),
        quality: None,
        view: None,
    };
    let text = measurements_csv(&[row(fitted)]);
    assert!(text.contains(",ok,28.190779,10.260604,1.087") && text.lines().count() == 2, "{text}");
    let back = read_text(&text).unwrap().rows.remove(0).measured.unwrap();
    assert_abs_diff_eq!(back.bend_covariance(psi), turned(along, across), epsilon = 1e-15);
    // Sigmas that somebody doubled, and an angle that somebody changed: these count, and not what stands beside them.
    let doubled = Measured { sigma_theta: 2.0 * along, sigma_delta: 2.0 * polar.sigma_delta, ..fitted };
    for text in [measurements_csv(&[row(doubled)]), text.replace("0,,30.000000,", "0,,31.000000,")] {
        let changed = read_text(&text).unwrap().rows.remove(0).measured.unwrap();
        assert_eq!(changed.fitted_covariance, None, "{text}");
    }
    // One sigma alone, along which the covariance is small beside what it is across.
    let long = |times: f64| {
        let polar = Measured::independent(psi, times * along, 10.0 * along / psi.theta, 0.0);
        row(Measured { fitted_covariance: Some(turned(along, 10.0 * along)), ..polar })
    };
    let counts = |times| {
        read_text(&measurements_csv(&[long(times)])).unwrap().rows.remove(0).measured.unwrap().fitted_covariance
    };
    assert!(counts(1.0).is_some() && counts(3.0).is_none());
    // Near straight, where δ may be anything; where the error across is larger than the bend; far from straight.
    let covariance = Matrix2::new(9.979e-3, -7.710e-3, -7.710e-3, 2.203e-1) * 1f64.to_radians().powi(2);
    for theta_deg in [0.05, 5.0, 60.0] {
        let psi = Configuration::from_degrees(theta_deg, -20.7);
        let own = Measured::of_bend(psi.bend_vector(), &covariance);
        let back = |measured| {
            read_text(&measurements_csv(&[row(measured)])).unwrap().rows.remove(0).measured.unwrap().fitted_covariance
        };
        assert!(back(own).is_some(), "{theta_deg}");
        assert!(back(Measured { sigma_theta: 1.1 * own.sigma_theta, ..own }).is_none(), "{theta_deg}");
    }
    let garbled = text.replace(",1.087", ",-1.087");
    let message = read_text(&garbled).unwrap_err().to_string();
    assert!(message.contains("no covariance") || message.contains("no usable row"), "{message}");
}

#[test]
fn two_views_of_one_frame_are_not_duplicates() {
    let text = format!("{},view\n0,,1,2,0.1,0.2,ok,side\n0,,1,3,0.1,0.2,ok,top\n", FIXED.join(","));
    let checked = read_text(&text).unwrap();
    assert_eq!((checked.rows.len(), checked.warnings.len()), (2, 0));
}

fn any_measurement() -> impl Strategy<Value = Measurement> {
    let status = prop_oneof![Just("ok"), Just("occluded"), Just("grid_lost")];
    let angles = (0.0..180.0, -180.0..180.0, 0.001..5.0, 0.001..200.0, -0.99..0.99);
    let quality = proptest::option::of((0usize..100_000, 0.0..1.0, 0.0..50.0));
    (proptest::option::of(0.0..1e4), status, angles, any::<bool>(), quality).prop_map(
        |(time_s, status, (theta, delta, sigma_theta, sigma_delta, correlation), seen, quality)| Measurement {
            index: 0,
            time_s,
            status: status.parse().unwrap(),
            measured: (seen || status == "ok").then(|| {
                Measured::independent(
                    Configuration::from_degrees(theta, delta),
                    f64::to_radians(sigma_theta),
                    f64::to_radians(sigma_delta),
                    correlation,
                )
            }),
            quality: quality.map(|(edges, inlier_fraction, rms_px)| Quality {
                edges,
                inlier_fraction,
                rms_px,
                base_moved_px: Some(inlier_fraction),
                grid_moved_px: None,
                shape: None,
                profile: None,
            }),
            view: seen.then(|| "side".to_owned()),
        },
    )
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]
    #[test]
    fn what_was_written_is_read(mut rows in proptest::collection::vec(any_measurement(), 1..20)) {
        for (index, row) in rows.iter_mut().enumerate() {
            row.index = index as u64;
        }
        let checked = read_text(&measurements_csv(&rows)).unwrap();
        prop_assert!(checked.warnings.is_empty(), "{:?}", checked.warnings);
        prop_assert_eq!(checked.rows.len(), rows.len());
        prop_assert_eq!(measurements_csv(&checked.rows), measurements_csv(&rows));
        for (read, written) in checked.rows.iter().zip(&rows) {
            prop_assert_eq!((read.index, &read.status, &read.view), (written.index, &written.status, &written.view));
            prop_assert_eq!(read.measured.is_some(), written.measured.is_some());
            if let (Some(a), Some(b)) = (read.measured, written.measured) {
                let turn = (a.configuration.delta_deg() - b.configuration.delta_deg()).rem_euclid(360.0);
                prop_assert!((a.configuration.theta_deg() - b.configuration.theta_deg()).abs() < 1e-6);
                prop_assert!(turn.min(360.0 - turn) < 1e-6);
                prop_assert!((a.sigma_theta - b.sigma_theta).abs() < 1e-6);
                prop_assert!((a.correlation - b.correlation).abs() < 1e-4);
            }
            prop_assert_eq!(read.quality.map(|q| q.edges), written.quality.map(|q| q.edges));
        }
    }
}
