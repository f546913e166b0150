use super::*;
use crate::geometry::{Configuration, Pose};
use crate::robot::PerBackbone;
use nalgebra::{Point3, Translation3, UnitQuaternion, Vector2, Vector3};
use rand::SeedableRng;
use rand::rngs::StdRng;
use rand_distr::{Distribution, StandardNormal};

/// A tracker that sees a tip whose base is somewhere, with a sensor somewhere on it.
struct Lab {
    base: Pose,
    poses: Vec<TrackerPose>,
    readings: Vec<EncoderReading>,
    truth: Vec<Configuration>,
}

/// Two sweeps and a round, of 17 poses each, the first one straight; noise in mm and rad.
fn lab(seed: u64, sigma_mm: f64, sigma_rad: Option<f64>) -> Lab {
    let mut random = StdRng::seed_from_u64(seed);
    let mut draw = || -> f64 { StandardNormal.sample(&mut random) };
    let robot = Robot::default();
    // The straight pose is bent by half a degree, as it is called straight.
    let bent = Configuration::from_bend_vector(Vector2::new(draw(), draw()) * 0.5f64.to_radians());
    let angles = |k: usize| match k {
        0 => (bent.theta_deg(), bent.delta_deg()),
        1..17 => (5.0 * k as f64, 10.0),
        17..34 => (5.0 * (k - 16) as f64, 130.0),
        _ => (45.0, 360.0 * (k - 34) as f64 / 17.0 - 170.0),
    };
    let truth: Vec<Configuration> = (0..51).map(angles).map(|(t, d)| Configuration::from_degrees(t, d)).collect();
    let turn = UnitQuaternion::from_scaled_axis(Vector3::new(draw(), draw(), draw()));
    let base = Pose::from_parts(Translation3::new(100.0 * draw(), 100.0 * draw(), 300.0), turn);
    let mount = UnitQuaternion::from_scaled_axis(Vector3::new(draw(), draw(), draw()));
    let across_mm = if sigma_rad.is_some() { 2.0 } else { 0.5 };
    let sensor = Point3::new(across_mm * draw(), across_mm * draw(), 2.0 * draw());
    let mut see = |k: usize, psi: &Configuration| {
        let tip = base * robot.frame_at(*psi, robot.length_mm);
        let noise = Vector3::new(draw(), draw(), draw()) * sigma_mm;
        let turned = sigma_rad.map(|sigma| {
            UnitQuaternion::from_scaled_axis(Vector3::new(draw(), draw(), draw()) * sigma) * tip.rotation * mount
        });
        let position_mm = Some(tip * sensor + noise);
        TrackerPose { index: k as u64, time_s: k as f64, position_mm, orientation: turned, sigma_mm: None }
    };
    let poses = truth.iter().enumerate().map(|(k, psi)| see(k, psi)).collect();
    let reading = |(k, psi): (usize, &Configuration)| {
        // A line that takes up a third more, and a common part.
        let q_mm = (robot.joint_displacements(*psi) * 1.33).add_scalar(0.17);
        EncoderReading::new(k as u64, k as f64, q_mm)
    };
    let readings = truth.iter().enumerate().map(reading).collect();
    Lab { base, poses, readings, truth }
}

impl Lab {
    /// The same of a snake that loses this share of its length per rad of its bend.
    fn shortened(mut self, share: f64) -> Self {
        let robot = Robot::default();
        for (pose, psi) in self.poses.iter_mut().zip(&self.truth) {
            let lost = robot.frame_at(*psi, robot.length_mm).translation.vector * (share * psi.theta);
            pose.position_mm = pose.position_mm.map(|position| position - self.base.rotation * lost);
        }
        self
    }

    /// By what factor all bends are too large, less 1, and the σ that the errors which the poses share say of it.
    fn gain(&self, tracked: &TrackedPoses) -> (f64, f64) {
        let (mut product, mut square, mut shared) = (0.0, 0.0, SMatrix::<f64, 1, 6>::zeros());
        for ((_, _, found), truth) in tracked.measurements.iter().zip(&self.truth) {
            let (Some(bend), truth) = (found.bend, truth.bend_vector()) else { continue };
            product += bend.vector.dot(&truth);
            square += truth.norm_squared();
            shared += truth.transpose() * bend.by_rig;
        }
        (product / square - 1.0, shared.norm() / square)
    }

    fn measured(&self) -> Result<TrackedPoses, TrackerError> {
        let options = TrackerOptions { straight: 0, delta_offset: None, base_mm: None };
        measure_poses(&self.poses, &self.readings, &Robot::default(), &options)
    }
}

/// The mean of χ²/2 of the bends' errors over all poses of many laboratories, and the rms error of the bend vector, degrees.
fn scatter(sigma_mm: f64, sigma_rad: Option<f64>) -> (f64, f64) {
    let (mut chi_square, mut square, mut count) = (0.0, 0.0, 0.0);
    for seed in 0..20 {
        let lab = lab(seed, sigma_mm, sigma_rad);
        let tracked = lab.measured().unwrap_or_else(|why| panic!("laboratory {seed}: {why}"));
        for ((_, _, found), truth) in tracked.measurements.iter().zip(&lab.truth) {
            let bend = found.bend.unwrap_or_else(|| panic!("laboratory {seed}: {:?}", found.status));
            let off = bend.vector - truth.bend_vector();
            chi_square += off.dot(&(bend.covariance.try_inverse().unwrap() * off)) / 2.0;
            square += off.norm_squared();
            count += 1.0;
        }
    }
    (chi_square / count, (square / count).sqrt().to_degrees())
}

// 51 poses share a registration and its error, two numbers that matter: a laboratory's mean scatters by 1, that of twenty by 0.22.
const HONEST: std::ops::Range<f64> = 0.45..1.6;

#[test]
fn positions_alone_tell_the_bend_as_well_as_their_sigmas_say() {
    let (chi_square, rms_deg) = scatter(0.1, None);
    assert!(HONEST.contains(&chi_square), "χ²/2 {chi_square}, rms {rms_deg}°");
    assert!(rms_deg < 6.0, "{rms_deg}°");
}

#[test]
fn orientations_make_it_better_and_the_sigmas_know() {
    let (chi_square, rms_deg) = scatter(0.1, Some(0.3f64.to_radians()));
    assert!(HONEST.contains(&chi_square), "χ²/2 {chi_square}, rms {rms_deg}°");
    // The straight pose's half degree is most of it, in two directions.
    assert!(rms_deg < 1.2, "{rms_deg}°");
}

#[test]
fn a_snake_that_shortens_is_measured_nearly_as_well_as_the_shared_errors_say() {
    // About half of what tendons that only pull do at most. A sensor beyond what the prior expects moves the base far, where the surface is
    // no longer as it was linearised: σ is too small by a factor of 1.5 (mean square 2.3), which the book says.
    let (mut chi_square, mut square) = (0.0, 0.0);
    for seed in 0..20 {
        let lab = lab(seed, 0.1, None).shortened(0.03);
        let tracked = lab.measured().unwrap_or_else(|why| panic!("laboratory {seed}: {why}"));
        let (off, sigma) = lab.gain(&tracked);
        chi_square += (off / sigma).powi(2) / 20.0;
        square += off.powi(2) / 20.0;
    }
    assert!((0.5..3.0).contains(&chi_square), "{chi_square}");
    assert!(square.sqrt() < 0.08, "{}", square.sqrt());
}

#[test]
fn a_stated_base_settles_the_bends_and_lets_the_sensor_be_on_a_tool() {
    let robot = Robot::default();
    let (mut open, mut settled) = (0.0, 0.0);
    for seed in 0..5 {
        let mut lab = lab(seed, 0.1, None).shortened(0.03);
        let base_mm = Some(Point3::from(lab.base.translation.vector));
        let options = TrackerOptions { straight: 0, delta_offset: None, base_mm };
        open += lab.gain(&lab.measured().unwrap()).1;
        let tracked = measure_poses(&lab.poses, &lab.readings, &robot, &options).unwrap();
        let (off, sigma) = lab.gain(&tracked);
        assert!(off.abs() < 3.5 * sigma, "laboratory {seed}: {off} ± {sigma}");
        settled += sigma;
        // 30 mm beyond the tip, along its axis.
        for (pose, psi) in lab.poses.iter_mut().zip(&lab.truth) {
            let ahead = (lab.base * robot.frame_at(*psi, robot.length_mm)).rotation * Vector3::new(0.0, 0.0, 30.0);
            pose.position_mm = pose.position_mm.map(|position| position + ahead);
        }
        let tracked = measure_poses(&lab.poses, &lab.readings, &robot, &options).unwrap();
        let (off, sigma) = lab.gain(&tracked);
        assert!(off.abs() < 3.5 * sigma && sigma < 0.03, "laboratory {seed}, on a tool: {off} ± {sigma}");
    }
    assert!(settled < 0.8 * open, "{settled} of {open}");
    let lab = lab(1, 0.1, None);
    let base_mm = Some(Point3::from(lab.base.translation.vector / 1000.0));
    let options = TrackerOptions { straight: 0, delta_offset: None, base_mm };
    let why = measure_poses(&lab.poses, &lab.readings, &robot, &options).unwrap_err().to_string();
    assert!(why.contains("base_mm is") && why.contains("check that it is in mm"), "{why}");
}

#[test]
fn gaps_and_jumps_cost_their_own_poses_only() {
    let mut lab = lab(3, 0.1, Some(0.005));
    lab.poses[7].position_mm = None;
    for k in [12, 30, 44] {
        let tip = lab.poses[k].position_mm.as_mut().unwrap();
        *tip += Vector3::new(7.0, -7.0, 7.0);
    }
    let tracked = lab.measured().unwrap();
    let status = |k: usize| tracked.measurements[k].2.status.to_string();
    assert_eq!(status(7), "tracker_lost");
    let jumps = (0..51).filter(|&k| status(k) == "tracker_jump").count();
    let ok = (0..51).filter(|&k| status(k) == "ok").count();
    assert_eq!((jumps, ok), (3, 47));
    assert!(tracked.remarks.iter().any(|remark| remark.contains("tracker_lost")), "{:?}", tracked.remarks);
    for k in [5, 20, 40] {
        let found = tracked.measurements[k].2.measured.unwrap().configuration;
        assert!((found.theta_deg() - lab.truth[k].theta_deg()).abs() < 2.5);
    }
}

#[test]
fn a_stated_azimuth_needs_no_encoders() {
    let mut lab = lab(5, 0.02, None);
    let by_encoders = lab.measured().unwrap();
    lab.readings.clear();
    assert_eq!(lab.measured(), Err(TrackerError::NoAzimuth));
    let options = TrackerOptions { straight: 0, delta_offset: Some(0.0), base_mm: None };
    let stated = measure_poses(&lab.poses, &[], &Robot::default(), &options).unwrap();
    let turn = |k: usize| {
        let [one, other] =
            [&by_encoders, &stated].map(|tracked| tracked.measurements[k].2.measured.unwrap().configuration);
        assert!((one.theta - other.theta).abs() < 1e-12);
        crate::geometry::wrap_angle(one.delta - other.delta)
    };
    assert!((turn(10) - turn(40)).abs() < 1e-9, "one turn for all");
}

#[test]
fn what_is_wrong_with_a_file_is_said() {
    let message = |change: &dyn Fn(&mut Lab)| {
        let mut lab = lab(9, 0.05, Some(0.005));
        change(&mut lab);
        lab.measured().map(|tracked| tracked.remarks).expect_err("a message").to_string()
    };
    let each = |change: fn(&mut TrackerPose)| move |lab: &mut Lab| lab.poses.iter_mut().for_each(change);
    let scaled = |factor: f64| {
        move |lab: &mut Lab| {
            for pose in &mut lab.poses {
                pose.position_mm = pose.position_mm.map(|position| position * factor);
            }
        }
    };
    assert!(message(&scaled(1e-3)).contains("look as if in metres"));
    assert!(message(&scaled(10.0)).contains("check the unit"));
    assert!(message(&scaled(1e-9)).contains("lead it along sweeps"));
    assert!(message(&|lab| lab.poses.truncate(10)).contains("10 poses"));
    assert!(message(&|lab| lab.poses[0].position_mm = None).contains("straight = 0"));
    let flipped = each(|pose| pose.position_mm = pose.position_mm.map(|p| Point3::new(p.x, -p.y, p.z)));
    assert!(message(&flipped).contains("the y axis"), "{}", message(&flipped));
    let shuffled = each(|pose| {
        pose.orientation =
            pose.orientation.map(|q| UnitQuaternion::new_normalize(nalgebra::Quaternion::new(q.i, q.j, q.k, q.w)))
    });
    assert!(message(&shuffled).contains("the order of quaternions"), "{}", message(&shuffled));
    let swapped = |lab: &mut Lab| {
        for reading in &mut lab.readings {
            reading.q_mm = PerBackbone::from([reading.q_mm[0], reading.q_mm[2], reading.q_mm[1]]);
        }
    };
    assert!(message(&swapped).contains("goes round the other way"));
    let still = |lab: &mut Lab| lab.readings.iter_mut().for_each(|reading| reading.q_mm = PerBackbone::repeat(3, 1.0));
    assert!(message(&still).contains("nothing tells which way"));
}
