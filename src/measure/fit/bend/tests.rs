use super::super::alternatives::{Alternative, mirrored};
use super::super::coarse::CoarseSearch;
use super::super::linearised::REWEIGHTING_TOLERANCE;
use super::*;
use crate::geometry::Configuration;
use crate::measure::fixture::Scene;
use crate::measure::image::plane::Plane;
use nalgebra::{Point2, Vector3};
use rand::{SeedableRng, rngs::StdRng};
use rand_distr::{Distribution, Normal};

const COARSE: FitSchedule = FitSchedule {
    searches_px: &[14.0, 6.0, 3.0],
    rounds: 20,
    is_fine: false,
    converged_rad: 1e-4,
    rival_cost: f64::INFINITY,
};
const FINE: FitSchedule =
    FitSchedule { searches_px: &[3.0], rounds: 9, is_fine: true, converged_rad: 1e-5, rival_cost: f64::INFINITY };

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
    let start = Start { state: state(start), blur_px: None, origin: start };
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
        assert!((fit.blur_px - 1.0).abs() < 0.25, "{}", fit.blur_px);
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
        let candidates = search.candidates(&picture(&scene, bend), false, 3);
        let mirrored = mirrored(bend, &scene.view());
        let nearest = candidates.iter().map(|c| (c - bend).norm().min((c - mirrored).norm()));
        let nearest = nearest.fold(f64::INFINITY, f64::min);
        // The lattice leaves 2.3°, and the next point of it may have a little more contrast.
        assert!(nearest < 0.1, "{bend}: {candidates:?}");
    }
}

#[test]
fn alternatives_are_told_apart_by_distance_cost_and_scatter() {
    let scene = Scene::new(Vector3::new(0.05, -0.1, 0.0));
    let bend = Vector2::new(0.6, 0.35);
    let best = BendFit { cost: 0.1, rms_px: 0.2, ..fitted(&scene, &picture(&scene, bend), bend) };
    let moved = |apart: f64| BendProfile { tip: best.bend() + Vector2::new(apart, 0.0), ..best.profile };
    let compare = |apart: f64, cost: f64, rms_px: f64| {
        let other = BendFit { profile: moved(apart), cost, rms_px, ..best.clone() };
        Alternative::of(&other, &best, 52.0)
    };
    assert_eq!(compare(0.05, 0.5, 0.9), Alternative::EdgeOn);
    assert_eq!(compare(0.3, 0.14, 0.25), Alternative::AsGood);
    assert_eq!(compare(0.3, 0.16, 0.25), Alternative::Worse);
    assert_eq!(compare(0.3, 0.14, 0.27), Alternative::Worse);
    // In a coarse picture rims open alike further apart.
    let other = BendFit { profile: moved(0.3), ..best.clone() };
    assert_eq!(Alternative::of(&other, &best, 12.0), Alternative::EdgeOn);
    // Two equally likely values ±a/2 about their mean have the variance a²/4.
    let other = BendFit { profile: moved(0.04), cost: 0.12, ..best.clone() };
    let joined = best.clone().or_edge_on(other.clone());
    assert_eq!(joined.profile, best.profile);
    // A fit that was free to take any shape, and took one, has a little less cost whatever the snake is.
    let mut free = BendFit { cost: 0.09, contradicts_shape: true, ..other };
    free.profile.modes[0] = Vector2::new(0.0, 0.04);
    assert_eq!(best.clone().or_edge_on(free.clone()).profile, best.profile);
    assert_eq!(best.clone().or_edge_on(BendFit { cost: 0.06, ..free.clone() }).profile, free.profile);
    let added = joined.covariance - best.covariance;
    assert!((added[(0, 0)] - 4e-4).abs() < 1e-12 && added[(1, 1)].abs() < 1e-12);
}
