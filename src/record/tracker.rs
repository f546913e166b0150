//! The poses of a tracker: `index,time_s,x_mm,y_mm,z_mm`, and where there are any
//!
//! | columns | meaning |
//! | --- | --- |
//! | `qw,qx,qy,qz` | the sensor's orientation: a quaternion of length 1 that turns its axes into the tracker's |
//! | `sigma_mm` | standard deviation of each coordinate |
//! | `base_x_mm,base_y_mm,base_z_mm,base_qw,base_qx,base_qy,base_qz` | the pose of a second sensor on the base, which may move; the tip's is then taken from it |
//!
//! A row whose position is empty, NaN, or one number three times is a pose that the tracker lost: programs write 0, −9999 or −3.7e28 where there is
//! none, and no place has three coordinates that are alike to the last digit.

use super::table::{self, Checked, Fault, Indexed, Row, RowResult, Warning};
use crate::bag::Topic;
use crate::bag::messages::StampedPose;
use crate::error::Result;
use crate::geometry::Pose;
use crate::observation::TrackerPose;
use nalgebra::{Point3, Quaternion, Translation3, UnitQuaternion};
use std::path::Path;

const REQUIRED: [&str; 5] = ["index", "time_s", "x_mm", "y_mm", "z_mm"];

/// How far a quaternion's length may be from 1.
///
/// Convention: two decimals in a file leave 1 %; more is another thing than an orientation.
const LENGTH_TOLERANCE: f64 = 0.02;

impl Indexed for TrackerPose {
    fn index(&self) -> u64 {
        self.index
    }
}

/// Reads a tracker's poses, in order of their index, each index once.
///
/// # Errors
/// A file that cannot be read, lacks a column or has no usable row. A bad row, such as one with a quaternion that is not of length 1, is a
/// warning.
pub fn read_tracker_poses(path: &Path) -> Result<Checked<TrackerPose>> {
    let in_mm = |header: &[String]| {
        let is_there = |name: &str| header.iter().any(|known| known == name);
        match is_there("x_m") || is_there("x") {
            true if !is_there("x_mm") => Err("positions are expected in x_mm,y_mm,z_mm, in mm".to_owned()),
            _ => Ok(()),
        }
    };
    table::read_where(path, &REQUIRED, in_mm, |row| {
        let position = position(row, ["x_mm", "y_mm", "z_mm"])?;
        // What stands beside no position is no orientation either.
        let orientation = match position {
            Some(_) => orientation(row, ["qw", "qx", "qy", "qz"])?,
            None => None,
        };
        let base = position_of_base(row)?;
        let sigma_mm = row.optional_number("sigma_mm")?;
        if let Some(sigma_mm) = sigma_mm.filter(|sigma_mm| *sigma_mm <= 0.0) {
            return Err(format!("sigma_mm is {sigma_mm}, expected more than 0"));
        }
        Ok(TrackerPose {
            index: row.index("index")?,
            time_s: row.time()?,
            position_mm: position.map(|position| base.inverse_transform_point(&position)),
            orientation: orientation.map(|orientation| base.rotation.inverse() * orientation),
            sigma_mm,
        })
    })
}

/// A tracker's poses from a topic of `PoseStamped` or `TransformStamped`, in mm; a pose's index is its position, from 0. A pose with a NaN counts as
/// lost by the tracker. A message that cannot be read, or whose orientation is no rotation, is left out.
///
/// # Errors
/// A recording that cannot be read, has no such topic, or no pose in it.
pub fn tracker_poses_of(topic: &Topic) -> Result<Checked<TrackerPose>> {
    topic.first::<StampedPose>()?;
    let (mut rows, mut warnings) = (Vec::new(), Vec::new());
    let damage = |message: String| {
        let path = topic.bag.path().to_owned();
        Warning { path, line: None, message, fault: Fault::Damage }
    };
    for (index, message) in (0..).zip(topic.messages()?) {
        let pose = match message {
            Ok(message) => message
                .decoded::<StampedPose>()
                .map_err(|why| topic.in_words(&why))
                .and_then(|pose| pose_of(index, &pose)),
            Err(why) => Err(topic.in_words(&why)),
        };
        match pose {
            Ok(pose) => rows.push(pose),
            Err(why) => warnings.push(damage(format!("pose {index}: {why}; passed over"))),
        }
    }
    Ok(Checked { rows, warnings })
}

/// A message as a pose.
fn pose_of(index: u64, pose: &StampedPose) -> RowResult<TrackerPose> {
    /// Convention: ROS has lengths in m.
    const MM_PER_M: f64 = 1000.0;
    let position_mm = Point3::from(pose.position_m * MM_PER_M);
    let is_there = position_mm.iter().chain(pose.orientation.coords.iter()).all(|value| value.is_finite());
    let position_mm = Some(position_mm).filter(|place| is_there && !is_lost(place));
    let orientation = position_mm.map(|_| unit_quaternion(pose.orientation)).transpose()?;
    Ok(TrackerPose { index, time_s: pose.stamp_s, position_mm, orientation, sigma_mm: None })
}

/// Whether a position is what programs write for a missing one: one number three times.
fn is_lost(position: &Point3<f64>) -> bool {
    position.x == position.y && position.y == position.z
}

/// The pose of the sensor on the base; where it is at rest where the file has none.
fn position_of_base(row: &Row) -> RowResult<Pose> {
    // The origin may lie on the base, so that three zeros are a place here.
    let position = numbers(row, ["base_x_mm", "base_y_mm", "base_z_mm"])?.map(Point3::from);
    let orientation = orientation(row, ["base_qw", "base_qx", "base_qy", "base_qz"])?;
    match (position, orientation) {
        (None, None) => Ok(Pose::identity()),
        (Some(position), Some(orientation)) => Ok(Pose::from_parts(Translation3::from(position), orientation)),
        _ => Err("the base's pose needs base_x_mm,base_y_mm,base_z_mm and base_qw,base_qx,base_qy,base_qz".to_owned()),
    }
}

/// A position; `None` where the tracker lost it.
fn position(row: &Row, columns: [&str; 3]) -> RowResult<Option<Point3<f64>>> {
    Ok(numbers(row, columns)?.map(Point3::from).filter(|position| !is_lost(position)))
}

/// An orientation; `None` where there is none.
fn orientation(row: &Row, columns: [&str; 4]) -> RowResult<Option<UnitQuaternion<f64>>> {
    let Some([w, i, j, k]) = numbers(row, columns)? else { return Ok(None) };
    let orientation = unit_quaternion(Quaternion::new(w, i, j, k));
    orientation.map(Some).map_err(|why| format!("{}: {why}", columns.join(",")))
}

fn unit_quaternion(quaternion: Quaternion<f64>) -> RowResult<UnitQuaternion<f64>> {
    let length = quaternion.norm();
    if (length - 1.0).abs() > LENGTH_TOLERANCE {
        return Err(format!("length {length:.3}, expected a quaternion of length 1"));
    }
    Ok(UnitQuaternion::new_normalize(quaternion))
}

/// Numbers of several columns; `None` where one of them is empty or NaN.
fn numbers<const N: usize>(row: &Row, columns: [&str; N]) -> RowResult<Option<[f64; N]>> {
    let mut numbers = [0.0; N];
    for (number, column) in numbers.iter_mut().zip(columns) {
        if row.text(column).eq_ignore_ascii_case("nan") {
            return Ok(None);
        }
        let Some(found) = row.optional_number(column)? else { return Ok(None) };
        *number = found;
    }
    Ok(Some(numbers))
}

#[cfg(test)]
mod tests {
    use super::*;
    use approx::assert_relative_eq;

    fn read(text: &str) -> Result<Checked<TrackerPose>> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("tip.csv");
        std::fs::write(&path, text).unwrap();
        read_tracker_poses(&path)
    }

    #[test]
    fn gaps_are_poses_that_were_lost_and_bad_rows_are_told() {
        let checked = read(
            "index,time_s,x_mm,y_mm,z_mm,qw,qx,qy,qz\n\
             0,0.0,1,2,3,1,0,0,0\n1,0.1,NaN,nan,,,,,\n2,0.2,1,2,3,2,0,0,0\n3,0.3,1,two,3,1,0,0,0\n4,0.4,1,2,3,0.7,0.7,0,0\n",
        )
        .unwrap();
        let indices: Vec<u64> = checked.rows.iter().map(|pose| pose.index).collect();
        assert_eq!(indices, [0, 1, 4]);
        assert_eq!((checked.rows[1].position_mm, checked.rows[1].orientation), (None, None));
        assert_relative_eq!(checked.rows[2].orientation.unwrap().norm(), 1.0, epsilon = 1e-12);
        let warnings: Vec<String> = checked.warnings.iter().map(ToString::to_string).collect();
        assert!(warnings[0].contains("tip.csv:4: qw,qx,qy,qz: length 2.000"), "{warnings:?}");
        assert!(warnings[1].contains("tip.csv:5: y_mm is \"two\""), "{warnings:?}");
        let metres = read("index,time_s,x_m,y_m,z_m\n0,0,0.1,0,0\n").unwrap_err().to_string();
        assert!(metres.contains("tip.csv:1: positions are expected in x_mm"), "{metres}");
    }

    #[test]
    fn a_base_that_moves_is_taken_off() {
        // The base is turned by 90° about z and moved; the tip is 10 mm ahead of it along its own x.
        let checked = read(
            "index,time_s,x_mm,y_mm,z_mm,qw,qx,qy,qz,base_x_mm,base_y_mm,base_z_mm,base_qw,base_qx,base_qy,base_qz\n\
             0,0,5,17,1,1,0,0,0,5,7,1,0.70710678,0,0,0.70710678\n1,1,5,17,1,1,0,0,0,5,7,1,,,,\n",
        )
        .unwrap();
        assert_relative_eq!(checked.rows[0].position_mm.unwrap(), Point3::new(10.0, 0.0, 0.0), epsilon = 1e-6);
        assert_relative_eq!(checked.rows[0].orientation.unwrap().angle(), std::f64::consts::FRAC_PI_2, epsilon = 1e-6);
        assert!(checked.warnings[0].to_string().contains("the base's pose needs"), "{:?}", checked.warnings);
    }
}
