//! Varied rigs and disturbed frames: what the eye says may be coarse, or that it cannot say, but never wrong with a
//! good conscience. A false angle is one with status `ok` whose error is more than 1° and more than five of its sigmas.
//!
//! ```sh
//! cargo test --release --no-default-features --test eye robustness -- --ignored --nocapture
//! ```
//!
//! measures some 1,200 frames, prints what became of each kind, and leaves every false one in `target/tmp/robustness` with its
//! picture and the scene that `snakeloop render` draws the straight picture from.

mod conditions;
mod disturbances;
mod expected;

use crate::rigs::{self, Random};
use crate::scenes::{self, frame_of};
use conditions::Condition;
use disturbances::{Disturbance, disturbed};
use nalgebra::Point3;
use rayon::prelude::*;
use snakeloop::geometry::{Configuration, wrap_degrees};
use snakeloop::measure::{Eye, FrameMeasurement};
use snakeloop::observation::Status;
use snakeloop::simulate::scene::{Scene, Stain};
use std::collections::BTreeMap;
use std::path::PathBuf;

/// What became of one frame.
struct Outcome {
    disturbance: Disturbance,
    status: Status,
    /// Where the truth is known: errors of θ and δ, degrees.
    errors_deg: Option<[f64; 2]>,
    is_false: bool,
    told: String,
}

/// The eye of a rig, or why there is none.
fn eye(scene: &Scene, seed: u64) -> Result<Eye, String> {
    Ok(scenes::eye_with(scene, scenes::rig(scene, seed).map_err(|why| format!("rig {seed}: {why}"))?))
}

/// Measures every kind of disturbed frame, some of them more than once, before one rig.
fn outcomes(seed: u64, frames: usize) -> Result<Vec<Outcome>, String> {
    let scene = rigs::varied(&mut Random::new(seed));
    let eye = eye(&scene, seed)?;
    let start = seed as usize * frames;
    let disturbance = |k: usize| Disturbance::ALL[(start + k) % Disturbance::ALL.len()];
    Ok((0..frames).map(|k| outcome(&scene, &eye, [seed, k as u64], disturbance(k))).collect())
}

/// Measures one frame of a rig's seed, whose numbers are its own, so that it can be drawn again without the others.
fn outcome(scene: &Scene, eye: &Eye, [seed, k]: [u64; 2], disturbance: Disturbance) -> Outcome {
    let mut random = Random::new(1000 * seed + k);
    let psi = Configuration::from_degrees(random.between(0.0, 95.0), random.between(-180.0, 180.0));
    // Every second frame of a rig, and of a disturbance every second time, shows a snake that is no arc.
    let is_arc = (seed + k).is_multiple_of(2);
    let modes_deg = if is_arc { [[0.0; 2]; 3] } else { rigs::shape(psi.theta_deg(), &mut random) };
    let bent = Scene { modes_deg, ..scene.clone() };
    let (picture, truth) = disturbed(&bent, psi, disturbance, &mut random);
    let outcome = judged(&eye.measure(&frame_of(picture.clone())), truth, disturbance, psi);
    if outcome.is_false {
        let folder = PathBuf::from(env!("CARGO_TARGET_TMPDIR")).join("robustness");
        std::fs::create_dir_all(&folder).unwrap();
        picture.save(folder.join(format!("{seed}-{k}.png"))).unwrap();
        std::fs::write(folder.join(format!("{seed}.toml")), scene.to_toml().unwrap()).unwrap();
    }
    Outcome { told: format!("{seed}-{k} modes {modes_deg:.1?}° {}", outcome.told), ..outcome }
}

fn judged(
    measurement: &FrameMeasurement,
    truth: Option<Configuration>,
    disturbance: Disturbance,
    psi: Configuration,
) -> Outcome {
    let mut told =
        format!("{disturbance:?} θ {:.2}° δ {:.2}°: {}", psi.theta_deg(), psi.delta_deg(), measurement.status);
    let mut errors_deg = None;
    let mut is_false = false;
    if let Some(measured) = &measurement.measured {
        is_false = truth.is_none();
        let seen = measured.configuration;
        told += &format!(" θ {:.2}° δ {:.2}° {:?}", seen.theta_deg(), seen.delta_deg(), measurement.quality);
        if let Some(truth) = truth {
            let errors = [seen.theta_deg() - truth.theta_deg(), wrap_degrees(seen.delta_deg() - truth.delta_deg())];
            let sigmas = [measured.sigma_theta, measured.sigma_delta].map(f64::to_degrees);
            is_false = (0..2).any(|k| errors[k].abs() > 1.0 && errors[k].abs() > 5.0 * sigmas[k]);
            told += &format!(" errors {errors:.2?}° sigmas {sigmas:.2?}°");
            errors_deg = Some(errors);
        }
    }
    Outcome { disturbance, status: measurement.status.clone(), errors_deg, is_false, told }
}

/// The rig's straight picture gives its camera's direction.
fn assert_calibrated(seed: u64) {
    let scene = rigs::varied(&mut Random::new(seed));
    let eye = eye(&scene, seed).unwrap();
    let turn = eye.rig().camera_from_base.rotation.angle_to(&scene.view.camera_from_base().rotation);
    assert!(turn.to_degrees() < 0.3, "rig {seed} is turned by {:.2}°", turn.to_degrees());
}

/// Before these rigs' checkerboards the squares stood out more than the snake did: lighter and darker than it, and wider than
/// its holder or narrower.
#[test]
fn squares_do_not_hide_the_snake() {
    [1058, 6001, 7002].into_iter().for_each(assert_calibrated);
}

/// A blot as dark as the snake, on the sheet behind its first disk, leaves no edge there. Where the snake begins its other parts tell.
#[test]
fn a_blot_behind_the_first_disk_does_not_hide_where_the_snake_begins() {
    let mut scene = scenes::laboratory();
    scene.surface.colour = [45.0; 3];
    let eye = scene.view.camera_from_base().inverse() * Point3::origin();
    let disk = Point3::new(0.0, 0.0, scene.robot.disk_pitch_mm());
    let behind = eye + (disk - eye) * (scene.paper.standoff_mm - eye.y) / (disk.y - eye.y);
    scene.paper.stains.push(Stain { centre_mm: [behind.x, behind.z], radius_mm: 3.2, colour: scene.surface.colour });
    let rig = scenes::rig(&scene, 1).unwrap();
    let off = rig.camera_from_base.inverse() * scene.view.camera_from_base();
    assert!(off.rotation.angle().to_degrees() < 0.3 && off.translation.vector.xz().norm() < 0.1, "{off}");
}

/// Of these rigs a shadow stands out more than the snake does, or the holder's upper part tells its direction better than the lower.
#[test]
fn a_snake_that_stands_out_little_is_found_where_the_border_cuts_its_holder() {
    [1041, 1052].into_iter().for_each(assert_calibrated);
}

/// The pictures of these snakes, which are no arcs or are seen by one frame alone, are explained by several shapes that differ most in how
/// the last disk is turned: what was found first was 1.7° to 8.8° off, by 5 of its σ and more.
#[test]
fn one_of_several_shapes_that_look_alike_is_no_angle() {
    use Disturbance::{None, Stains, Wires};
    let frames =
        [(6101, 6, None), (6101, 16, None), (6115, 15, None), (9434, 11, Stains), (9461, 8, Wires), (9549, 11, Stains)];
    frames.into_iter().for_each(assert_not_false);
}

/// Squares of 80 to 90 px before a long lens: the light shifts the few waves of such a sheet, which then seemed to lean by 0.8° and 0.9°, and the camera
/// to have moved in every second frame. The squares' borders tell.
#[test]
fn large_squares_tell_how_the_sheet_leans_by_their_borders() {
    for seed in [16016, 16062] {
        let scene = rigs::varied(&mut Random::new(seed));
        let eye = eye(&scene, seed).unwrap();
        let turn = eye.rig().camera_from_base.rotation.angle_to(&scene.view.camera_from_base().rotation);
        assert!(turn.to_degrees() < 0.1, "rig {seed} is turned by {:.2}°", turn.to_degrees());
        for k in 0..4 {
            let Outcome { status, is_false, told, .. } = outcome(&scene, &eye, [seed, k], Disturbance::None);
            assert!(status != Status::CameraMoved && !is_false, "{told}");
        }
    }
}

/// Snakes that are no arcs, of which an eighth of the edges does not agree with any shape. A fit with any shape and one near an arc that the edges contradict are
/// the same snake seen edge-on here, so that neither holds all of the mass: they were measured, 3° and 9° off, as if the shape were in no doubt.
#[test]
fn an_unlikely_shape_stays_unlikely_whichever_mode_has_it() {
    use Disturbance::{Blur, Jpeg};
    [(12025, 16, Jpeg), (12042, 15, Blur)].into_iter().for_each(assert_not_false);
}

/// A quarter to a third of the outline does not show in these pictures, and what shows of it does not contradict an arc, which three of the
/// four snakes are not: they were measured as arcs, 1.2° to 4.6° off, by 6 to 14 σ.
#[test]
fn what_shape_a_hidden_part_has_is_not_taken_for_granted() {
    use Disturbance::{Combined, TooDark, TwoSnakes};
    let frames = [(10208, 18, Combined), (10221, 4, TwoSnakes), (10235, 18, Combined), (10359, 14, TooDark)];
    frames.into_iter().for_each(assert_not_false);
}

/// A frame of a rig's seed is not measured falsely.
fn assert_not_false((seed, k, disturbance): (u64, u64, Disturbance)) {
    let scene = rigs::varied(&mut Random::new(seed));
    let eye = eye(&scene, seed).unwrap();
    let outcome = outcome(&scene, &eye, [seed, k], disturbance);
    assert!(!outcome.is_false, "{}", outcome.told);
}

/// What a survey counts.
struct Survey {
    frames: usize,
    /// Frames with the status `ok`.
    measured: usize,
    /// Frames that nothing spoilt, and how many of them have the status `ok`.
    unspoilt: usize,
    unspoilt_measured: usize,
    /// The false angles, in words.
    false_ones: Vec<String>,
}

impl Survey {
    fn assert_none_is_false(&self) {
        assert!(self.false_ones.is_empty(), "{} false:\n{}", self.false_ones.len(), self.false_ones.join("\n"));
    }
}

/// Measures frames before many rigs, prints what became of each kind, and counts.
fn survey(seeds: std::ops::Range<u64>, frames: usize) -> Survey {
    let of_rigs: Vec<_> = seeds.into_par_iter().map(|seed| outcomes(seed, frames)).collect();
    let refused: Vec<&String> = of_rigs.iter().filter_map(|of_rig| of_rig.as_ref().err()).collect();
    println!("{} rigs, {} refused", of_rigs.len(), refused.len());
    refused.iter().for_each(|why| println!("  {why}"));

    let outcomes: Vec<&Outcome> = of_rigs.iter().flatten().flatten().collect();
    println!("{:14} {:>6} {:>4} {:>6}  rms θ, δ (θ > 15°), statuses", "", "frames", "ok", "false");
    for disturbance in Disturbance::ALL {
        let of_kind: Vec<_> = outcomes.iter().filter(|o| o.disturbance == disturbance).collect();
        let mut statuses: BTreeMap<String, usize> = BTreeMap::new();
        of_kind.iter().for_each(|o| *statuses.entry(o.status.to_string()).or_default() += 1);
        let fine: Vec<[f64; 2]> = of_kind.iter().filter(|o| !o.is_false).filter_map(|o| o.errors_deg).collect();
        let rms = |k: usize| (fine.iter().map(|e| e[k] * e[k]).sum::<f64>() / fine.len().max(1) as f64).sqrt();
        println!(
            "{:14} {:6} {:4} {:6}  {:.3}° {:.3}° {statuses:?}",
            format!("{disturbance:?}"),
            of_kind.len(),
            of_kind.iter().filter(|o| o.status == Status::Ok).count(),
            of_kind.iter().filter(|o| o.is_false).count(),
            rms(0),
            rms(1)
        );
    }
    let unspoilt: Vec<_> = outcomes.iter().filter(|o| o.disturbance == Disturbance::None).collect();
    Survey {
        frames: outcomes.len(),
        measured: outcomes.iter().filter(|o| o.status == Status::Ok).count(),
        unspoilt: unspoilt.len(),
        unspoilt_measured: unspoilt.iter().filter(|o| o.status == Status::Ok).count(),
        false_ones: outcomes.iter().filter(|o| o.is_false).map(|o| o.told.clone()).collect(),
    }
}

#[test]
#[ignore = "takes minutes: cargo test --release --test eye thousand_frames -- --ignored; the next test is a slice of it"]
fn no_angle_of_a_thousand_frames_is_false() {
    let survey = survey(1000..1064, 19);
    assert!(survey.frames >= 1000, "{} frames", survey.frames);
    survey.assert_none_is_false();
}

/// The test above in small. To refuse every frame would be no way to pass: those that nothing spoilt are measured, and so are two
/// fifths of all, among which every third shows no snake, half of one, or nothing but white or black.
#[test]
fn no_angle_of_a_slice_of_them_is_false() {
    let survey = survey(2001..2005, 19);
    survey.assert_none_is_false();
    assert_eq!((survey.frames, survey.unspoilt_measured), (4 * 19, survey.unspoilt));
    assert!(5 * survey.measured >= 2 * survey.frames, "{} of {} measured", survey.measured, survey.frames);
}

/// About one and a half times the errors of the table in the book's "How well it measures"; a mean square above 4 would be σ that
/// are half of what they should be.
#[test]
#[ignore = "takes minutes: cargo test --release --test eye bad_days -- --ignored"]
fn bad_days_cost_precision_and_not_truth() {
    println!("{:8} {:>7} {:>8}  rms θ, δ      χ² θ, δ    the rest", "", "frames", "measured");
    for condition in Condition::ALL {
        let survey = conditions::survey(condition, 3000..3003, 8);
        let conditions::Survey { frames, errors, told } = &survey;
        let ([theta, delta], [chi2_theta, chi2_delta]) = (survey.rms_deg(), survey.chi2());
        println!(
            "{:8} {frames:7} {:8}  {theta:.3}° {delta:.3}°  {chi2_theta:.2} {chi2_delta:.2}  {told:?}",
            format!("{condition:?}"),
            errors.len(),
        );
        assert!(theta <= 0.15 && delta <= 0.5, "{condition:?}: θ {theta:.3}°, δ {delta:.3}°");
        assert!(chi2_theta.max(chi2_delta) <= 4.0, "{condition:?}: χ² {chi2_theta:.1}, {chi2_delta:.1}");
        assert!(errors.len() + 2 >= *frames, "{condition:?}: {} of {frames} measured", errors.len());
    }
}
