//! A trajectory: `index,time_s,theta_deg,delta_deg`, the poses to lead the snake to, and when. Further columns are for whoever
//! leads it: `qc1_mm,qc2_mm,qc3_mm`, one for each backbone, are the q̃ that a model would command. What neighbouring sections do
//! meanwhile may stand in the columns that encoders.csv has for it (`n1_q1_mm` …).

use super::columns::{azimuth, backbone_columns, backbone_decimals, csv_text, decimals};
use super::encoders::{neighbours_fit, neighbours_of};
use super::table::{self, Checked, Indexed};
use crate::error::{Error, Result};
use crate::geometry::Configuration;
use crate::observation::Waypoint;
use crate::robot::{MAX_THETA, PerBackbone};
use std::path::Path;

const COLUMNS: [&str; 4] = ["index", "time_s", "theta_deg", "delta_deg"];

#[derive(PartialEq)]
struct Row {
    index: u64,
    waypoint: Waypoint,
}

impl Indexed for Row {
    fn index(&self) -> u64 {
        self.index
    }
}

/// Reads a trajectory, in order of the index.
///
/// # Errors
/// A file that cannot be read, lacks a column or has no usable row; times that do not rise. A bad row, or a pose outside the
/// workspace, is a warning.
pub fn read_trajectory(path: &Path) -> Result<Checked<Waypoint>> {
    let Checked { rows, warnings } = table::read_where(path, &COLUMNS, neighbours_fit, |row| {
        let (theta_deg, most_deg) = (row.number("theta_deg")?, MAX_THETA.to_degrees());
        if !(0.0..=most_deg).contains(&theta_deg) {
            return Err(format!("theta_deg is {theta_deg}, expected 0 to {most_deg:.0}"));
        }
        let configuration = Configuration::from_degrees(theta_deg, row.number("delta_deg")?);
        let (time_s, neighbours) = (row.number("time_s")?, neighbours_of(row)?);
        Ok(Row { index: row.index("index")?, waypoint: Waypoint { time_s, configuration, neighbours } })
    })?;
    if let Some(pair) = rows.windows(2).find(|pair| pair[1].waypoint.time_s <= pair[0].waypoint.time_s) {
        let message = format!(
            "time_s of pose {} is {}, not after that of the pose before it ({}); times must rise",
            pair[1].index, pair[1].waypoint.time_s, pair[0].waypoint.time_s
        );
        return Err(Error::content(path, message));
    }
    Ok(Checked { rows: rows.into_iter().map(|row| row.waypoint).collect(), warnings })
}

/// A trajectory as text, with the q̃ to command at each pose, mm: time to 0.1 ms, angles to 1e-6 degrees, q̃ to 0.1 µm.
pub fn trajectory_csv(waypoints: &[Waypoint], commands_mm: &[PerBackbone]) -> String {
    let backbones = commands_mm.first().map_or(0, |q| q.len());
    let header: Vec<_> =
        COLUMNS.map(str::to_owned).into_iter().chain(backbone_columns("qc", "mm", backbones)).collect();
    csv_text([header].into_iter().chain(waypoints.iter().zip(commands_mm).enumerate().map(
        |(index, (waypoint, command))| {
            let psi = waypoint.configuration;
            let pose = [decimals(waypoint.time_s, 4), decimals(psi.theta_deg(), 6), azimuth(psi.delta_deg())];
            [index.to_string()].into_iter().chain(pose).chain(backbone_decimals(command, 4)).collect()
        },
    )))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &str) -> Result<Checked<Waypoint>> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("next.csv");
        std::fs::write(&path, text).unwrap();
        read_trajectory(&path)
    }

    #[test]
    fn what_was_written_is_read() {
        let waypoints: Vec<Waypoint> =
            (0..5).map(|k| Waypoint::new(0.35 * f64::from(k), Configuration::from_degrees(10.0, 40.0))).collect();
        let back = read(&trajectory_csv(&waypoints, &[PerBackbone::repeat(4, 0.0); 5])).unwrap();
        assert!(back.warnings.is_empty());
        for (a, b) in back.rows.iter().zip(&waypoints) {
            assert!((a.time_s - b.time_s).abs() < 1e-9 && (a.configuration.theta - b.configuration.theta).abs() < 1e-8);
        }
    }

    #[test]
    fn a_pose_outside_the_workspace_is_passed_over_and_a_clock_that_stands_still_refused() {
        let head = "index,time_s,theta_deg,delta_deg\n";
        let checked = read(&format!("{head}0,0,10,0\n1,1,150,0\n2,2,20,0\n")).unwrap();
        assert_eq!((checked.rows.len(), checked.warnings.len()), (2, 1));
        let error = read(&format!("{head}0,0,10,0\n1,0,15,0\n")).unwrap_err().to_string();
        assert!(error.contains("pose 1") && error.contains("times must rise"), "{error}");
    }
}
