use super::super::alternatives::mirrored;
use super::super::coarse::{CoarseSearch, Shrink};
use super::super::decision::Decision;
use super::super::evidence::Evidence;
use super::super::linearised::REWEIGHTING_TOLERANCE;
use super::*;
use crate::geometry::Configuration;
use crate::measure::fixture::Scene;
use crate::measure::image::plane::Plane;
use crate::observation::Status;
use nalgebra::{Point2, Vector3};
use rand::{SeedableRng, rngs::StdRng};
use rand_distr::{Distribution, Normal};

const COARSE: FitSchedule = FitSchedule { converged_rad: 1e-4, ..FitSchedule::FROM_NEAR };
const FINE: FitSchedule = FitSchedule { converged_rad: 1e-5, ..FitSchedule::FINE };

fn state(bend: Vector2<f64>) -> State {
    State { profile: BendProfile::arc(bend), bias: EdgeBias::default() }
}

/// The whole picture of a bent snake, 1 on it and 0 beside it, with a blur of 1 px.
fn picture(scene: &Scene, bend: Vector2<f64>) -> Plane {
    let outline = Outline::new(&scene.view(), Configuration::from_bend_vector(bend));
    let part = outline.blurred_silhouette(1.0);
    let (width, height) = (scene.lens.width as usize, scene.lens.height as usize);
    let value = |k: usize| part.sample(&Point2::new((k % width) as f64, (k / width) as f64));
    Plane::new(width, height, (0..width * height).map(value).collect())
}

fn fitted(scene: &Scene, plane: &Plane, start: Vector2<f64>) -> BendFit {
    let (view, finder) = (scene.view(), EdgeFinder::new(plane, false));
    let start = Start { state: state(start), blur: None, origin: start };
    let coarse = fit_bend(&view, &finder, start, FramePrior::FIXTURE, &COARSE).unwrap();
    fit_bend(&view, &finder, coarse.start(), FramePrior::FIXTURE, &FINE).unwrap()
}

#[test]
fn outliers_on_a_third_of_the_edges_leave_the_fit_alone() {
    let scene = Scene::new(Vector3::new(0.05, -0.1, 0.0));
    let view = scene.view();
    let truth = state(Vector2::new(0.6, 0.4));
    let outline = Outline::spaced(&view, truth.profile, 4.0);
    let mut random = StdRng::seed_from_u64(3);
    let noise = Normal::new(0.0, 0.2).unwrap();
    // All edges of the middle disks lie far outside, as a hand's or a cable's border would.
    let is_outlier = |piece: Piece| piece.disk().is_some_and(|disk| (3..=4).contains(&disk));
    let displacement = |piece: Piece| noise.sample(&mut random) + if is_outlier(piece) { 5.0 } else { 0.0 };
    let displacements: Vec<f64> = outline.points.iter().map(|p| p.piece).map(displacement).collect();
    let edges = Correspondences::displaced(&outline, &displacements, 0.2);
    let start = state(truth.profile.tip + Vector2::new(0.02, -0.02));
    let error = |phases: &[RobustPhase]| {
        let fitted = phases.iter().fold(start, |state, &phase| {
            gauss_newton(&edges, &view, state, &FramePrior::FIXTURE, phase, REWEIGHTING_TOLERANCE).unwrap().0
        });
        (fitted.profile.tip - truth.profile.tip).norm()
    };
    let monotone = error(&[RobustPhase::Monotone]);
    let both = error(&[RobustPhase::Monotone, RobustPhase::Redescending]);
    assert!(both < 1e-3 && both < monotone, "{both} rad, with the monotone phase alone {monotone} rad");
}

#[test]
fn a_bend_is_found_in_a_picture_of_its_silhouette_from_some_degrees_away() {
    for turn in [Vector3::new(0.05, -0.1, 0.0), Vector3::new(-0.3, 0.2, 0.1)] {
        let scene = Scene::new(turn);
        let bend = Vector2::new(0.6, 0.35);
        let fit = fitted(&scene, &picture(&scene, bend), bend + Vector2::new(0.05, -0.05));
        let error = (fit.bend() - bend).norm();
        assert!(error < 1e-3, "{error} rad");
        assert!(fit.inlier_fraction() > 0.9 && fit.rms_px < 0.1, "{} {}", fit.inlier_fraction(), fit.rms_px);
        assert!((fit.blur.px - 1.0).abs() < 0.25, "{:?}", fit.blur);
        assert!(fit.explains_all(), "{}", fit.cost);
    }
}

#[test]
fn a_hidden_end_leaves_the_bend_but_is_not_visible() {
    let scene = Scene::new(Vector3::new(0.05, -0.1, 0.0));
    let bend = Vector2::new(0.6, 0.35);
    let mut plane = picture(&scene, bend);
    // The background covers the last two disks.
    let robot = &scene.robot;
    let covered = [robot.length_mm, robot.length_mm - robot.disk_pitch_mm()].map(|s_mm| {
        let point = crate::measure::body::BodyPoint { s_mm, local: Vector3::zeros() };
        scene.view().pixel(&scene.view().curve(BendProfile::arc(bend)), &point)
    });
    for (k, value) in plane.data.iter_mut().enumerate() {
        let pixel = Point2::new((k % plane.width) as f64, (k / plane.width) as f64);
        if covered.iter().any(|middle| (pixel - middle).norm() < 32.0) {
            *value = 0.0;
        }
    }
    let fit = fitted(&scene, &plane, bend + Vector2::new(0.02, -0.02));
    assert!((fit.bend() - bend).norm() < 5e-3, "{}", (fit.bend() - bend).norm());
    let visibility = fit.visibility();
    assert!(!visibility.is_end_visible() && !fit.explains_all());
    assert!(visibility.visible_disk_share() > 0.6, "{}", visibility.visible_disk_share());
}

#[test]
fn the_coarse_search_hands_on_the_bend_or_its_mirrored_solution() {
    let scene = Scene::new(Vector3::new(0.05, -0.1, 0.0));
    let search = CoarseSearch::new(&scene.lens, scene.camera_from_base, &scene.robot);
    // Bent towards the side and away from the camera; how far away a nearly straight one leans is not visible at low resolution.
    for bend in [Vector2::new(0.6, 0.35), Vector2::new(-0.2, 1.1)] {
        let candidates = search.candidates(&Shrink::ToAQuarter.plane(&picture(&scene, bend)), false, 3);
        let mirrored = mirrored(bend, &scene.view());
        let nearest = candidates.iter().map(|c| (c - bend).norm().min((c - mirrored).norm()));
        let nearest = nearest.fold(f64::INFINITY, f64::min);
        // The lattice leaves 2.3°, and the next point of it may have a little more contrast.
        assert!(nearest < 0.1, "{bend}: {candidates:?}");
    }
}

/// A mode this far from a fit, rad, that was reached from another start, and whose edges say so much more for it.
fn mode(fit: &BendFit, apart_rad: f64, says: f64) -> BendFit {
    let tip = fit.bend() + Vector2::new(apart_rad, 0.0);
    let evidence = Evidence::amounting_to(fit.evidence.total() + says);
    BendFit { origin: tip, profile: BendProfile { tip, ..fit.profile }, evidence, ..fit.clone() }
}

#[test]
fn another_snake_with_more_than_a_twentieth_of_the_mass_leaves_the_picture_undecided() {
    let scene = Scene::new(Vector3::new(0.05, -0.1, 0.0));
    let bend = Vector2::new(0.6, 0.35);
    let fit = fitted(&scene, &picture(&scene, bend), bend);
    let decided = |others: &[(f64, f64)], diameter_px: f64| {
        let modes = others.iter().chain(&[(0.0, 0.0)]).map(|&(apart_rad, says)| mode(&fit, apart_rad, says));
        Decision::between(modes.collect(), diameter_px).unwrap()
    };
    assert_eq!(decided(&[(0.3, -2.9)], 52.0).doubt, Some(Status::Ambiguous));
    assert_eq!(decided(&[(0.3, -3.1)], 52.0).doubt, None);
    // Two others have twice the mass of one, and one of them that was met twice has not.
    assert_eq!(decided(&[(0.3, -3.1), (-0.3, -3.1)], 52.0).doubt, Some(Status::Ambiguous));
    assert_eq!(decided(&[(0.3, -3.1), (0.301, -3.1)], 52.0).doubt, None);
    // In a coarse picture rims open alike further apart.
    assert_eq!(decided(&[(0.3, -2.9)], 12.0).doubt, None);
    // What one start leads to is one snake, of one shape or another.
    let shaped = BendFit { origin: mode(&fit, 0.0, 0.0).origin, ..mode(&fit, 0.3, -2.9) };
    let of_another_shape = Decision::between(vec![shaped, mode(&fit, 0.0, 0.0)], 52.0).unwrap();
    assert_eq!(of_another_shape.doubt, Some(Status::UnknownShape));
    let heaviest = decided(&[(0.3, 4.0)], 52.0);
    assert!(heaviest.doubt.is_none() && (heaviest.fit.bend().x - fit.bend().x - 0.3).abs() < 1e-12);
}

/// Against the moments of two values with probabilities: the mean p a, the variance p (1 − p) a².
#[test]
fn of_a_snake_seen_edge_on_the_answer_is_the_mixture_of_its_modes() {
    let scene = Scene::new(Vector3::new(0.05, -0.1, 0.0));
    let bend = Vector2::new(0.6, 0.35);
    let fit = fitted(&scene, &picture(&scene, bend), bend);
    for (says, share) in [(0.0, 0.5), (-(3.0_f64.ln()), 0.25)] {
        let modes = vec![mode(&fit, 0.04, says), mode(&fit, 0.0, 0.0)];
        let joined = Decision::between(modes, 52.0).unwrap().fit;
        let added = joined.covariance - fit.covariance;
        assert!((joined.bend() - fit.bend() - Vector2::new(share * 0.04, 0.0)).norm() < 1e-12, "{}", joined.bend());
        assert!((added[(0, 0)] - share * (1.0 - share) * 0.04 * 0.04).abs() < 1e-12 && added[(1, 1)].abs() < 1e-12);
    }
    // A shape that no snake is likely to have counts against a mode whose edges say as much for it.
    let mut shaped = mode(&fit, 0.04, 0.0);
    shaped.profile.modes[0] = Vector2::new(0.0, 0.1);
    let joined = Decision::between(vec![shaped, mode(&fit, 0.0, 0.0)], 52.0).unwrap().fit;
    assert!((joined.bend() - fit.bend()).norm() < 0.004, "{}", joined.bend() - fit.bend());
}

/// Modes of one snake that hold three and two fifths of the mass.
#[test]
fn a_shape_is_unlikely_unless_a_likely_one_holds_more_than_a_twentieth_of_the_mass() {
    let scene = Scene::new(Vector3::new(0.05, -0.1, 0.0));
    let bend = Vector2::new(0.6, 0.35);
    let fit = fitted(&scene, &picture(&scene, bend), bend);
    let any = BendFit { of_any_shape: true, ..mode(&fit, 0.04, 1.5_f64.ln()) };
    let beside = |contradiction: f64, excess: f64, says: f64| {
        let near_an_arc = BendFit { contradiction, excess, ..mode(&fit, 0.0, says) };
        Decision::between(vec![BendFit { excess, ..any.clone() }, near_an_arc], 52.0).unwrap()
    };
    let contradicted = beside(1.1, 1.0, 0.0);
    assert!(contradicted.is_of_unlikely_shape && !contradicted.fit.of_any_shape);
    assert!(!beside(0.9, 1.0, 0.0).is_of_unlikely_shape);
    assert!(beside(0.9, 1.0, -4.0).is_of_unlikely_shape);
    // Edges that scatter more than they may contradict less.
    assert!(!beside(1.1, 1.2, 0.0).is_of_unlikely_shape && beside(1.3, 1.2, 0.0).is_of_unlikely_shape);
}
