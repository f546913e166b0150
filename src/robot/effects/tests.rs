//! Each effect against its equation, written out anew.

use super::*;
use crate::geometry::{Configuration, wrap_angle};
use crate::robot::history::{Before, Hysteresis};
use crate::robot::model::fixtures::with_example;
use crate::robot::{Mechanics, Model, Motion, PerBackbone};
use nalgebra::{DMatrix, DVector, Vector2, Vector6};
use std::f64::consts::TAU;

/// A pose at which no q_i and no τ_i is near zero.
fn pose() -> Configuration {
    Configuration::from_degrees(55.0, 47.0)
}

/// A model with η and λ and one effect, as on a command line.
fn with(effect: &str) -> Model {
    let effect = Effect::parse(effect).unwrap();
    Model { effects: vec![effect], ..with_example(LIBRARY[0], 3, 1.0) }
}

/// What an effect adds to q̃ at the pose, mm, how the snake got there being given.
fn added(model: &Model, motion: &Motion) -> PerBackbone {
    let bend = pose().bend_vector();
    let plain = model.plain();
    Mechanics::new(model).command(bend, Some(motion)) - Mechanics::new(&plain).command(bend, Some(motion))
}

/// A motion with all that effects ask for: from another pose, in 0.1 s.
fn moving() -> Motion {
    let before = Before {
        q_mm: with("thermal_drift:rate_mm_per_s=0").robot.joint_displacements(pose())
            - PerBackbone::from([0.04, -0.01, -0.03]),
        crept_load_n: Some(PerBackbone::from([3.0, -2.0, 1.0])),
        ..Before::at_rest(3)
    };
    let direction = PerBackbone::from([1.0, -1.0, -1.0]);
    Motion { direction, before, step_s: 0.1, elapsed_s: 7.0, ahead_mm: PerBackbone::repeat(3, 0.0) }
}

#[test]
fn summands_of_epsilon_are_what_their_equations_say() {
    let (model, motion) = (with("thermal_drift:rate_mm_per_s=0"), moving());
    let tau = model.robot.actuation_forces(pose().bend_vector(), None);
    let kappa = model.line_compliance_mm_per_n();
    let each = |f: &dyn Fn(f64) -> f64| tau.map(f);
    let alike = |value: f64| PerBackbone::repeat(3, value);
    let before = PerBackbone::from([3.0, -2.0, 1.0]);
    let crept = before + (tau - before) * (1.0 - (-0.1f64 / 3.0).exp());
    let cases = [
        ("load_directed_backlash:play_mm=0.08", each(&|tau| 0.08 * (tau / 0.3).tanh())),
        ("load_directed_backlash:play_mm=0.08,width_n=0.5", each(&|tau| 0.08 * (tau / 0.5).tanh())),
        ("motion_directed_backlash:half_gap_mm=0.06", PerBackbone::from([0.06, -0.06, -0.06])),
        ("disc_friction:coefficient=0.1", tau.map(f64::abs).component_mul(&motion.direction) * (0.1 * kappa)),
        ("thermal_drift:rate_mm_per_s=0.002", alike(0.014)),
        ("creep:share=0.1,time_constant_s=3", crept * (0.1 * kappa)),
        ("viscous_drag:drag_n_s_per_mm=2", PerBackbone::from([0.4, -0.1, -0.3]) * (2.0 * kappa)),
        ("primary_compression:compliance_mm_per_n=0.003", alike(0.003 * tau.map(f64::abs).sum())),
    ];
    for (effect, expected) in cases {
        let off = added(&with(effect), &motion) - expected;
        assert!(off.amax() < 1e-12 && expected.amax() > 0.01, "{effect}: {off:?} of {expected:?}");
    }
}

#[test]
fn friction_in_the_cone_turns_round_with_the_motion() {
    // Eq. 16's cone with the force behind it: (ητ + f_s) e^{2μφ} where a backbone is pushed on, (ητ − f_s) e^{−2μφ} where it gives way.
    let model = with("cone_friction_reversal:share=1");
    let tau = model.robot.actuation_forces(pose().bend_vector(), None);
    let (friction, line) = (model.friction, model.line());
    let capstan = friction.capstan_factor(model.robot.line.cone_bend_angle());
    for sign in [1.0, -1.0] {
        let direction = tau.map(|tau| sign * tau.signum());
        let expected = tau.zip_map(&direction, |tau, direction| {
            let force = line.eta * tau;
            let behind = (force + direction * friction.static_force_n) * capstan.powf(sign);
            line.cone_compliance_mm_per_n * (behind - (force + friction.static_force_n) * capstan)
        });
        let off = added(&model, &Motion { direction, ..moving() }) - expected;
        // The sign of τ is smooth over 0.3 N; τ is some newtons here.
        assert!(off.amax() < 1e-6 && expected.amax() > 1e-3, "{off:?} of {expected:?}");
    }
}

#[test]
fn encoders_err_by_what_they_read() {
    let travel = with("actuator_scale:scale_1=0,scale_2=0,scale_3=0").command(pose());
    let scaled = with("actuator_scale:scale_1=0.03,scale_2=-0.02,scale_3=0.01").command(pose());
    let expected = travel.component_div(&PerBackbone::from([0.97, 1.02, 0.99]));
    assert!((scaled - expected).amax() < 1e-12);
    let offset = with("actuator_offset:offset_1_mm=0.05,offset_2_mm=-0.02").command(pose()) - travel;
    assert!((offset - PerBackbone::from([0.05, -0.02, -0.03])).amax() < 1e-12);
    let read = with("screw_periodic:amplitude_mm=0.04,pitch_mm=1,phase_deg=30").command(pose());
    let error = read.map(|q| 0.04 * (TAU * q + 30f64.to_radians()).sin());
    assert!((read - error - travel).amax() < 1e-12 && error.amax() > 0.01);
}

#[test]
fn the_snake_obeys_virtual_work_with_its_constants_changed() {
    let (bend, plain) = (pose().bend_vector(), with("thermal_drift:rate_mm_per_s=0"));
    let robot = &plain.robot;
    let forces = |effect: &str| Mechanics::new(&with(effect)).forces_n(bend);
    let paper = robot.actuation_forces(bend, None);
    let softened = forces("superelastic_softening:softening_per_rad2=0.1");
    assert!((softened - paper * (1.0 - 0.1 * bend.norm_squared())).amax() < 1e-12);
    let loaded = forces("tip_load:fx_n=0.3,fy_n=-0.4,fz_n=0.2,mx_n_mm=2,my_n_mm=0,mz_n_mm=1");
    let wrench = Vector6::new(0.3, -0.4, 0.2, 2.0, 0.0, 1.0);
    assert!((loaded - robot.actuation_forces(bend, Some(&wrench))).amax() < 1e-12);
    // q_i = −(r + Δr_i) θ cos(δ − a_i − Δa_i), and a robot built that way in the first place is the same.
    let psi = pose();
    let q = |radius: f64, azimuth: f64| -radius * psi.theta * (psi.delta - azimuth).cos();
    let azimuths = robot.backbone_azimuths();
    let turned = with("backbone_azimuth:azimuth_error_1_deg=2,azimuth_error_2_deg=-3,azimuth_error_3_deg=1");
    let errors = PerBackbone::from([2f64, -3.0, 1.0]).map(f64::to_radians);
    let expected = azimuths.zip_map(&errors, |azimuth, error| q(1.5, azimuth + error));
    assert!((Mechanics::new(&turned).statics.q_mm(bend) - expected).amax() < 1e-12);
    let wider = with("backbone_radius:radius_error_mm=0.1");
    let mut built = plain.plain();
    built.robot.backbone_circle_radius_mm = 1.6;
    assert!((wider.command(psi) - built.command(psi)).amax() < 1e-12);
}

#[test]
fn the_eye_errs_as_its_equations_say() {
    let measured = |effect: &str| {
        let model = with(effect);
        let mechanics = Mechanics::new(&model);
        let apparent = mechanics.apparent_bend(pose().bend_vector());
        assert!((mechanics.true_bend(apparent) - pose().bend_vector()).norm() < 1e-10, "{effect}");
        Configuration::from_bend_vector(apparent)
    };
    let psi = pose();
    let turned = measured("plane_misalignment:angle_deg=3");
    assert!((turned.theta - psi.theta).abs() < 1e-12);
    assert!((wrap_angle(turned.delta - psi.delta) - 3f64.to_radians()).abs() < 1e-12);
    let bent = measured("bend_offset:angle_deg=-1");
    assert!((bent.theta - psi.theta + 1f64.to_radians()).abs() < 1e-12 && (bent.delta - psi.delta).abs() < 1e-12);
    let shaped = measured("non_circular_shape:shape_per_rad=0.05");
    assert!((shaped.theta - psi.theta - 0.05 * psi.theta.powi(2)).abs() < 1e-12);
}

/// Where the hystereses stand along a path.
fn plays(mechanics: &Mechanics, times_s: &[f64], bends: &[Vector2<f64>]) -> Vec<Hysteresis> {
    let stands =
        |(bend, motion): (&Vector2<f64>, &Motion)| mechanics.instant(*bend, motion, |at| at.arrival.hysteresis);
    bends.iter().zip(&mechanics.motions(times_s, bends)).map(stands).collect()
}

#[test]
fn what_follows_the_path_follows_its_equation_of_motion() {
    // Held at a pose: the creep's load is τ (1 − e^{−t/T}), and the other forms have their closed forms, too.
    let bend = pose().bend_vector();
    let times: Vec<f64> = (0..40).map(|k| 0.3 * f64::from(k)).collect();
    let held = vec![bend; times.len()];
    let crept = |model: &Model| {
        let mechanics = Mechanics::new(model);
        let motion = *mechanics.motions(&times, &held).last().unwrap();
        assert!((motion.elapsed_s - 11.7).abs() < 1e-12);
        mechanics.instant(bend, &motion, |at| at.arrival.crept_load_n)
    };
    let tau = with("thermal_drift:rate_mm_per_s=0").robot.actuation_forces(bend, None);
    let creep = with("creep:share=0.1,time_constant_s=4");
    let expected = tau * (1.0 - (-11.7f64 / 4.0).exp());
    assert!((crept(&creep) - expected).amax() < 1e-9);
    let settled = form("creep", "settled before", &[("share", 0.1), ("time_constant_s", 4.0)]);
    assert!((crept(&settled) - tau).amax() < 1e-9);
    // Along an even sweep of b: the drag's speed is Q ḃ, from the second reading on.
    let sweep: Vec<_> = times.iter().map(|t| bend * (0.1 * t)).collect();
    let drag = with("viscous_drag:drag_n_s_per_mm=2");
    let speed = drag.robot.displacement_by_bend() * (bend * 0.1);
    let mechanics = Mechanics::new(&drag);
    for (k, motion) in mechanics.motions(&times, &sweep).iter().enumerate() {
        let is = mechanics.instant(sweep[k], motion, |at| at.arrival.speed_mm_per_s);
        assert!((is - speed * if k == 0 { 0.0 } else { 1.0 }).amax() < 1e-9, "{k}");
    }
    // A play of half width a: taken up after a travel of 2a, and held there.
    let play = form("motion_directed_backlash", "crossed by travel", &[("half_gap_mm", 0.06)]);
    let up_and_down: Vec<_> = (0..40).map(|k| bend * (0.5 - (0.05 * f64::from(k) - 1.0).abs() * 0.4)).collect();
    let plays = plays(&Mechanics::new(&play), &times, &up_and_down);
    let q = play.robot.displacement_by_bend() * bend;
    let sign = q.map(f64::signum);
    assert!((plays[20].play_mm[0] - sign * 0.06).amax() < 1e-12);
    assert!((plays[39].play_mm[0] + sign * 0.06).amax() < 1e-12);
    let back = plays[21].play_mm[0] - (sign * 0.06 - q * 0.02);
    assert!(back.amax() < 1e-12, "one sample after the reversal it has followed q");
}

fn form(name: &str, form: &str, parameters: &[(&str, f64)]) -> Model {
    let parameters: Vec<_> = parameters.iter().map(|(name, value)| ((*name).to_owned(), *value)).collect();
    let effect = Effect::new(name, Some(form), &parameters, 3).unwrap();
    Model { effects: vec![effect], ..with_example(LIBRARY[0], 3, 1.0) }
}

#[test]
fn an_effect_of_size_zero_is_the_plain_model() {
    for physics in LIBRARY {
        for backbones in [3u8, 5] {
            let model = with_example(physics, backbones, 0.0);
            let (plain, motion) = (model.plain(), Motion { elapsed_s: 9.0, ..Motion::none(usize::from(backbones)) });
            let (mechanics, plain) = (Mechanics::new(&model), Mechanics::new(&plain));
            let bend = pose().bend_vector();
            for motion in [None, Some(&motion)] {
                let off = mechanics.command(bend, motion) - plain.command(bend, motion);
                assert!(off.amax() < 1e-12, "{} {}: {off:?}", physics.name, physics.form);
            }
            assert!((mechanics.apparent_bend(bend) - bend).norm() < 1e-12, "{}", physics.name);
        }
    }
}

/// q̃ along poses, by one effect, less the plain model's, in a row.
fn response(physics: &'static Physics, values: Vec<f64>, poses: &[Vector2<f64>]) -> DVector<f64> {
    let plain = Model { effects: Vec::new(), ..with_example(LIBRARY[0], 3, 1.0) };
    let model = Model { effects: vec![Effect::of(physics, values)], ..plain.clone() };
    let (mechanics, plain) = (Mechanics::new(&model), Mechanics::new(&plain));
    let added = poses.iter().map(|&bend| mechanics.command(bend, None) - plain.command(bend, None));
    DVector::from_vec(added.flat_map(|q| q.to_vec()).collect())
}

#[test]
fn what_is_said_to_be_confounded_is_and_elsewhere_is_not() {
    let in_planes = |planes: &[f64]| -> Vec<_> {
        let poses = planes.iter().flat_map(|&delta| (1..16).map(move |k| (5.0 * f64::from(k), delta)));
        poses.map(|(theta, delta)| Configuration::from_degrees(theta, delta).bend_vector()).collect()
    };
    let (one, all) = (in_planes(&[20.0]), in_planes(&[20.0, 110.0, -160.0, -70.0]));
    /// The share of a response that η, λ and the columns of another effect leave.
    fn left(physics: &'static Physics, other: Option<&'static Physics>, poses: &[Vector2<f64>]) -> f64 {
        let model = with_example(LIBRARY[0], 3, 1.0);
        let h: Vec<_> = poses.iter().map(|&bend| model.epsilon_by_parameters(bend)).collect();
        let column = |axis: usize| DVector::from_vec(h.iter().flat_map(|h| h.column(axis).to_vec()).collect());
        let mut columns = vec![column(0), column(1)];
        let count = other.map_or(0, |other| other.parameters_on(3).len());
        for k in 0..count {
            let mut values = vec![0.0; count];
            values[k] = other.unwrap().parameters_on(3)[k].typical * 1e-3;
            columns.push(response(other.unwrap(), values, poses));
        }
        let basis = DMatrix::from_columns(&columns).qr().q();
        let values = physics.example(3).iter().map(|value| value * 1e-3).collect();
        let own = response(physics, values, poses);
        (&own - &basis * (basis.transpose() * &own)).norm() / own.norm()
    }
    for effect in LIBRARY {
        for confounded in effect.confounded_with {
            let other = physics(confounded.with);
            assert!(other.is_some() || ["eta", "lambda_mm"].contains(&confounded.with), "{}", confounded.with);
            assert!(other.is_none_or(|other| other.confounded_with.iter().any(|back| back.with == effect.name)));
            let poses = if confounded.on == Poses::OnePlane { &one } else { &all };
            // The scales are more than a compression can imitate; it is the compression that the scales can.
            let hides = left(effect, other, poses).min(other.map_or(1.0, |other| left(other, Some(effect), poses)));
            assert!(hides < 0.2, "{} and {}: {hides}", effect.name, confounded.with);
            if let Some(other) = other {
                let apart = left(effect, Some(other), &all).min(left(other, Some(effect), &all));
                assert!(apart > 3.0 * hides, "{} and {} in all planes: {apart}", effect.name, other.name);
            }
        }
    }
}

#[test]
fn names_are_unique_and_every_start_lies_in_its_range() {
    for (k, physics) in LIBRARY.iter().enumerate() {
        assert!(LIBRARY[..k].iter().all(|other| other != physics), "{} {}", physics.name, physics.form);
        assert_eq!(forms(physics.name).next().unwrap().form, "");
        assert!(!physics.equation.is_empty() && !physics.reading.is_empty());
        for backbones in BACKBONES {
            let specs = physics.parameters_on(backbones);
            let example = physics.example(backbones);
            assert_eq!(Effect::of(physics, example.clone()).parameters(), specs, "{}", physics.name);
            let mut starts: Vec<_> = physics.given_starts(backbones).collect();
            if physics.form.is_empty() && physics.history.is_none() {
                starts.push(example);
            }
            for (value, spec) in starts.iter().flat_map(|start| start.iter().zip(specs)) {
                assert!((spec.range.0..=spec.range.1).contains(value), "{} {}", physics.name, spec.name);
            }
            for spec in specs {
                if let Role::Shape { example, drawn } = spec.role {
                    let range = spec.range.0..=spec.range.1;
                    assert!([example, drawn.0, drawn.1].iter().all(|value| range.contains(value)), "{}", spec.name);
                }
            }
        }
    }
}

#[test]
fn what_is_written_wrongly_is_an_error_that_says_what_to_write() {
    let good = Effect::parse("load_directed_backlash:play_mm=0.08").unwrap();
    assert_eq!(good.values, [0.08]);
    for (text, message) in [
        ("gremlins:size=1", "it knows load_directed_backlash, motion"),
        ("creep:share=0.1", "time_constant_s is missing"),
        ("creep:shares=0.1,time_constant_s=2", "no parameter \"shares\""),
        ("load_directed_backlash:play_mm=20", "expected -1 to 1 (mm)"),
        ("load_directed_backlash:play_mm=nan", "expected -1 to 1"),
        ("load_directed_backlash", "expected name:parameter=value"),
        ("creep:share=0.1,share=0.2,time_constant_s=2", "expected each parameter once"),
    ] {
        let error = Effect::parse(text).unwrap_err();
        assert!(error.to_string().contains(message), "{error}");
    }
}

#[test]
fn a_bend_at_rest_moves_kinematics_and_energy_with_it() {
    let model = with("rest_bend:x_deg=5,y_deg=-3");
    let rest = Vector2::new(5f64, -3.0).map(f64::to_radians);
    let bend = pose().bend_vector();
    let plain = model.plain();
    let [bent, straight] = [&model, &plain].map(Mechanics::new);
    assert!((bent.command(rest + bend, None) - straight.command(bend, None)).amax() < 1e-12);
    assert!((bent.forces_n(rest)).amax() < 1e-12, "no force holds a snake at rest");
}

#[test]
fn a_weight_along_the_snake_is_many_small_forces() {
    let (bend, plain) = (pose().bend_vector(), with("thermal_drift:rate_mm_per_s=0"));
    let robot = &plain.robot;
    let model = with("dead_weight:wx_n=0.4,wy_n=-0.2,wz_n=0.3");
    let mechanics = Mechanics::new(&model);
    let by_load = Mechanics::new(&plain).statics.generalised_force(bend) - mechanics.statics.generalised_force(bend);
    // The middle rule with a thousand pieces.
    let wrench = Vector6::new(0.4, -0.2, 0.3, 0.0, 0.0, 0.0) / 1000.0;
    let sum: Vector2<f64> = (0..1000)
        .map(|k| robot.section_jacobian_bend(bend, (f64::from(k) + 0.5) / 1000.0 * robot.length_mm).tr_mul(&wrench))
        .sum();
    assert!((by_load - sum).norm() < 1e-5 * sum.norm(), "{by_load} {sum}");
}

#[test]
fn threefold_and_cubic_stiffness_are_gradients_of_their_energies() {
    let (bend, plain) = (pose().bend_vector(), with("thermal_drift:rate_mm_per_s=0"));
    let force = |model: &Model, bend| Mechanics::new(model).statics.generalised_force(bend);
    let threefold = with("threefold_stiffness:a_per_rad=0.2,b_per_rad=-0.1");
    // K is the stiffness of four tubes of length L.
    let stiffness = 4.0 * 54_000.0 * std::f64::consts::PI / 64.0 * (0.66f64.powi(4) - 0.5f64.powi(4)) / 26.0;
    let energy = |b: Vector2<f64>| {
        let (x, y) = (b.x, b.y);
        stiffness / 3.0 * (0.2 * (x.powi(3) - 3.0 * x * y * y) - 0.1 * (3.0 * x * x * y - y.powi(3)))
    };
    let h = 1e-5;
    for axis in 0..2 {
        let step = Vector2::ith(axis, h);
        let slope = (energy(bend + step) - energy(bend - step)) / (2.0 * h);
        let added = (force(&threefold, bend) - force(&plain, bend))[axis];
        assert!((slope - added).abs() < 1e-6 * stiffness, "{slope} {added}");
        let numeric = (force(&threefold, bend + step) - force(&threefold, bend - step)) / (2.0 * h);
        let column = Mechanics::new(&threefold).statics.generalised_force_by_bend(bend).column(axis).into_owned();
        assert!((numeric - column).norm() < 1e-5 * stiffness);
    }
    let cubic = force(&with("cubic_stiffness:stiffening_per_rad2=0.2"), bend);
    assert!((cubic - force(&plain, bend) * (1.0 + 0.2 * bend.norm_squared())).norm() < 1e-12);
}

#[test]
fn lines_that_only_pull_have_slack_and_dead_bands() {
    let plain = with("thermal_drift:rate_mm_per_s=0");
    let q = Mechanics::new(&plain).statics.q_mm(pose().bend_vector());
    // Clear of zero by ten widths, a pull is all slack and a push none.
    assert!(q.iter().all(|q| q.abs() > 0.2), "{q:?}");
    let slack = added(&with("tendon_slack:slack_1_mm=0.1,slack_2_mm=0.2,slack_3_mm=0.3"), &moving());
    let dead = added(&with("dead_band:dead_band_1_mm=0.1,dead_band_2_mm=0.2,dead_band_3_mm=0.3"), &moving());
    let sizes = PerBackbone::from([0.1, 0.2, 0.3]);
    let pulled = q.map(|q| if q < 0.0 { -1.0 } else { 0.0 });
    assert!((slack - sizes.component_mul(&pulled)).amax() < 1e-3, "{slack:?}");
    assert!((dead - sizes.component_mul(&q.map(f64::signum))).amax() < 1e-3, "{dead:?}");
}

#[test]
fn a_shorter_backbone_bends_further_for_the_same_travel() {
    let model = with("backbone_shortening:shortening_per_mm=0.02");
    let read = model.command(pose());
    let pulls: f64 = read.iter().map(|q| (-q).max(0.0)).sum();
    let travel = model.plain().command(pose());
    assert!((read * (1.0 + 0.02 * pulls) - travel).amax() < 1e-12 && pulls > 0.5, "{read:?} {travel:?}");
}

#[test]
fn a_play_at_the_bend_follows_within_its_disk_and_a_sheath_holds_a_share_of_the_load() {
    // Up by 30° along x, then across by 10°: 2° of play at r = 1.5 mm are 0.0524 mm.
    let half_gap = 1.5 * 2f64.to_radians();
    let model = with(&format!("play_at_bend:half_gap_mm={half_gap}"));
    let up = (0..=30).map(|k| Vector2::new(f64::from(k), 0.0));
    let across = (1..=10).map(|k| Vector2::new(30.0, f64::from(k)));
    let bends: Vec<_> = up.chain(across).map(|b| b.map(f64::to_radians)).collect();
    let times: Vec<f64> = (0..bends.len()).map(|k| k as f64).collect();
    let of_bend = plays(&Mechanics::new(&model), &times, &bends);
    let play = |k: usize| of_bend[k].bend_play[0].map(f64::to_degrees);
    assert!((play(1) - Vector2::new(1.0, 0.0)).norm() < 1e-9 && (play(30) - Vector2::new(2.0, 0.0)).norm() < 1e-9);
    assert!((play(40).norm() - 2.0).abs() < 1e-9 && play(40).y > 1.95, "{}", play(40));
    let sheath = with("capstan_play:half_gap_mm_per_n=0.02");
    let mechanics = Mechanics::new(&sheath);
    let of_backbones = plays(&mechanics, &times, &bends);
    let tau = mechanics.forces_n(bends[30]);
    let sign = mechanics.statics.q_mm(bends[30]).map(f64::signum);
    assert!((of_backbones[30].play_mm[1] - tau.map(f64::abs).component_mul(&sign) * 0.02).amax() < 1e-9);
}

#[test]
fn friction_that_is_spread_turns_round_along_a_parabola_or_an_exponential() {
    // Out by 40° and back by up to 20° in one plane, at r = 1.5 mm: travels of up to 1.05 mm and 0.52 mm.
    let (a, travel) = (0.08, 0.3);
    let degrees = (0..=40).chain((20..40).rev()).map(f64::from);
    let bends: Vec<_> = degrees.map(|degrees| Vector2::new(degrees.to_radians(), 0.0)).collect();
    let times: Vec<f64> = (0..bends.len()).map(|k| k as f64).collect();
    let eps = |effect: &str, form: &str, k: usize| {
        let travel_name = if effect == "bouc_wen" { "travel_mm" } else { "widest_mm" };
        let parameters = [("half_gap_mm".to_owned(), a), (travel_name.to_owned(), travel)];
        let effects = vec![Effect::new(effect, Some(form), &parameters, 3).unwrap()];
        let model = Model { effects, ..with_example(LIBRARY[0], 3, 1.0) };
        let motions = Mechanics::new(&model).motions(&times, &bends);
        let command = |model: &Model| Mechanics::new(model).command(bends[k], Some(&motions[k]));
        command(&model) - command(&model.plain())
    };
    // Backbone 1 lies in the plane and shortens; the two others travel half as far, at the bend by half as much.
    for k in [3, 40, 45, 52, 60] {
        let (out, back) =
            (1.5 * f64::from(k.min(40) as u32).to_radians(), 1.5 * f64::from(k.max(40) as u32 - 40).to_radians());
        let parabola = |x: f64| if x < 1.0 { x * (2.0 - x) } else { 1.0 };
        let (up, turned) = (parabola(out / travel), 2.0 * parabola(0.5 * back / travel));
        let prandtl = eps("distributed_friction", "", k);
        assert!((prandtl[0] + a * (up - turned)).abs() < a / 30.0, "{k}: {prandtl:?}");
        let (up, e) = (1.0 - (-out / travel).exp(), (-back / travel).exp());
        let bouc_wen = eps("bouc_wen", "", k);
        let z = if back > 0.0 { up * e - (1.0 - e) } else { up };
        assert!((bouc_wen[0] + a * z).abs() < 1e-12, "{k}: {bouc_wen:?}");
        for own in [prandtl, bouc_wen] {
            assert!((own[1] + 0.5 * own[0]).abs() < 1e-12 && (own[2] + 0.5 * own[0]).abs() < 1e-12);
        }
        for effect in ["distributed_friction", "bouc_wen"] {
            let (each, whole) = (eps(effect, "per backbone", k), eps(effect, "", k));
            // Each by itself: the first travels as the bend does, and the two others alike.
            let (first, others) = (each[0] - whole[0], each[1] - each[2]);
            assert!(first.abs() < 1e-12 && others.abs() < 1e-12 && each[1] != 0.0, "{effect} {k}: {each:?}");
        }
    }
}

#[test]
fn plays_and_frictions_are_told_from_what_hangs_on_speed_or_time() {
    let mut names: Vec<&str> = LIBRARY.iter().filter(|physics| physics.is_hysteresis()).map(|p| p.name).collect();
    names.dedup();
    let expected = [
        "motion_directed_backlash",
        "play_at_bend",
        "capstan_play",
        "distributed_friction",
        "bouc_wen",
        "disc_friction",
        "cone_friction_reversal",
    ];
    assert_eq!(names, expected);
}
