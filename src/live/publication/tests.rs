use super::*;
use crate::estimate::{Options, StemOptions};
use crate::geometry::Configuration;
use crate::live::online_estimator::OnlineEstimator;
use crate::observation::Waypoint;
use crate::robot::Effect;
use crate::simulate::{Plant, SimulatedEye};
use crate::verdict::Reason;
use nalgebra::Vector2;
use std::f64::consts::TAU;

/// A gate after a verdict that finds nothing.
fn judged_good() -> PublicationGate {
    let mut gate = PublicationGate::new(0.0015, POSES, None);
    gate.take_verdict(Verdict::default());
    gate.confirm(&Status::Ok, true);
    gate
}

/// A snake that goes round and round before camera and encoders, and what is learned from it.
struct Bench {
    estimator: OnlineEstimator,
    gate: PublicationGate,
    plant: Plant,
    seed: u64,
    time_s: f64,
    /// What is added to all readings, mm.
    homed_mm: f64,
    /// What is added to those of the first backbone besides, mm.
    slipped_mm: f64,
}

impl Bench {
    /// The least time in which a frame comes, s.
    const STEP_S: f64 = 0.05;
    /// Frames from one verdict to the next.
    const VERDICTS: usize = 40;

    fn new(effects: Vec<Effect>) -> Self {
        let model = Model { effects, eta: 1.221, lambda_mm: 0.1765, samples: Some(0), ..Model::default() };
        let options = Options { forgetting: 0.9995, ..Options::default() };
        Self {
            estimator: OnlineEstimator::new(Model::default(), options, None).unwrap(),
            gate: judged_good(),
            plant: Plant { model, sd_encoder_mm: 0.0015 },
            seed: 1,
            time_s: 0.0,
            homed_mm: 0.0,
            slipped_mm: 0.0,
        }
    }

    /// The same robot, of which η and λ are known and the stem is followed.
    fn with_stem() -> Self {
        let bench = Self::new(vec![]);
        let options = Options::default();
        let estimator = OnlineEstimator::new(bench.plant.model.clone(), options, Some(StemOptions::default())).unwrap();
        let mut gate = PublicationGate::new(0.0015, STEM_POSES, None);
        gate.take_verdict(Verdict::default());
        Self { estimator, gate, ..bench }
    }

    /// Goes on for so long, s; a round takes eight. Every frame's decision is looked at with the model it was made on.
    fn go(
        &mut self,
        seconds: f64,
        frozen: bool,
        mut look: impl FnMut(&Model, Result<(), Withheld>, &mut PublicationGate),
    ) {
        let frames = (seconds / Self::STEP_S) as usize;
        let waypoints: Vec<Waypoint> = (0..frames)
            .map(|k| {
                let time_s = self.time_s + k as f64 * Self::STEP_S;
                let turn = time_s / 8.0 * TAU;
                let bend = Vector2::new(0.6 + 0.45 * turn.cos(), 0.5 * (1.1 * turn).sin());
                Waypoint::new(time_s, Configuration::from_bend_vector(bend))
            })
            .collect();
        let samples = self.plant.run(&waypoints, self.seed);
        let measurements = SimulatedEye::default().observe(&samples, self.seed + 1);
        for (k, (sample, measurement)) in samples.iter().zip(&measurements).enumerate() {
            let q_mm = if frozen { samples[0].reading.q_mm } else { sample.reading.q_mm };
            let mut q_mm = q_mm.add_scalar(self.homed_mm);
            q_mm[0] += self.slipped_mm;
            let reading = crate::observation::EncoderReading { q_mm, ..sample.reading };
            if k % Self::VERDICTS == Self::VERDICTS - 1 {
                self.gate.take_verdict(Verdict::default());
            }
            let update = self.estimator.update(measurement, Some(&reading));
            self.gate.confirm(&measurement.status, update.sample.is_some());
            self.gate.add(&update);
            let model = self.estimator.model();
            if model.estimate().is_some() {
                let decided = self.gate.judge(&model);
                look(&model, decided, &mut self.gate);
            }
        }
        (self.time_s, self.seed) = (self.time_s + seconds, self.seed + 2);
    }

    /// The largest error of a model's table up to 60°, mm.
    fn error_mm(&self, model: &Model) -> f64 {
        let poses = (0..36).map(|k| Configuration::from_degrees(20.0 * f64::from(k % 4), 10.0 * f64::from(k)));
        poses.map(|psi| (model.command(psi) - self.plant.model.command(psi)).amax()).fold(0.0, f64::max)
    }
}

#[test]
fn frozen_encoders_never_replace_a_good_table_and_it_is_taken_up_again_afterwards() {
    for seed in [1, 100, 200, 300, 400] {
        let mut bench = Bench { seed, ..Bench::new(vec![]) };
        let keep = |model: &Model, decided: Result<(), Withheld>, gate: &mut PublicationGate| {
            if decided.is_ok() {
                gate.publish(model.clone());
            }
        };
        bench.go(20.0, false, keep);
        let good = bench.gate.published().unwrap().0.clone();
        assert!(bench.error_mm(&good) < 0.03, "{}", bench.error_mm(&good));
        let (mut codes, mut worst) = (std::collections::BTreeSet::new(), 0f64);
        let plant = Bench::new(vec![]);
        bench.go(20.0, true, |model, decided, gate| match decided {
            Ok(()) => {
                worst = worst.max(plant.error_mm(model));
                gate.publish(model.clone());
            }
            Err(why) => drop(codes.insert(why.code)),
        });
        assert!(worst < 0.03 && codes.contains(&Code::EncoderStuck), "{worst} mm, {codes:?}");
        let mut last = Ok(());
        bench.go(20.0, false, |model, decided, gate| {
            last = decided.clone();
            keep(model, decided, gate);
        });
        assert_eq!(last, Ok(()), "seed {seed}");
        assert!(bench.error_mm(bench.gate.published().unwrap().0) < 0.03);
    }
}

#[test]
fn encoders_that_freeze_early_do_not_replace_what_little_is_known() {
    for (seed, seconds) in (0..10).flat_map(|seed| [0.5, 1.0, 2.0, 4.0].map(|seconds| (10 * seed, seconds))) {
        let mut bench = Bench { seed, ..Bench::new(vec![]) };
        let plant = Bench::new(vec![]);
        let (mut before, mut worst) = (f64::NAN, 0f64);
        bench.go(seconds, false, |model, decided, gate| {
            if decided.is_ok() {
                before = plant.error_mm(model);
                gate.publish(model.clone());
            }
        });
        bench.go(5.0, true, |model, decided, gate| {
            if decided.is_ok() {
                worst = worst.max(plant.error_mm(model));
                gate.publish(model.clone());
            }
        });
        assert!(
            before < 0.01 && worst < 0.01,
            "{seconds} s, seed {seed}: {before} mm, {worst} mm once they were frozen"
        );
    }
}

#[test]
fn nothing_is_published_while_the_gap_is_above_noise() {
    let mut bench = Bench::new(vec![Effect::parse("load_directed_backlash:play_mm=0.15").unwrap()]);
    let mut last = Ok(());
    bench.go(60.0, false, |_, decided, _| last = decided);
    let why = last.unwrap_err();
    assert_eq!(why.code, Code::GapAboveNoise);
    let status = bench.gate.status(&Err(why));
    assert_eq!((status.state, status.code), (PublicationState::Withheld, Some(Code::GapAboveNoise)));
}

#[test]
fn a_model_that_misses_the_last_poses_is_withheld() {
    let mut bench = Bench::new(vec![]);
    bench.go(20.0, false, |_, _, _| ());
    let with = |eta, lambda_mm| Model { eta, lambda_mm, samples: Some(9), ..Model::default() };
    let judged = |gate: &PublicationGate, model: &Model| gate.judge(model).map_err(|why| why.code);
    assert_eq!(judged(&bench.gate, &with(1.221, 0.1765)), Ok(()));
    assert_eq!(judged(&bench.gate, &with(-3.0, 0.1765)), Err(Code::ParameterOutOfRange));
    assert_eq!(judged(&bench.gate, &with(f64::NAN, 0.1765)), Err(Code::ParameterOutOfRange));
    let level = |model: &Model| bench.gate.judge(model).map_err(|why| why.level);
    assert_eq!(level(&with(0.4, 0.1765)), Err(Level::DoNotUse), "worse than none");
    assert_eq!(level(&with(1.1, 0.1765)), Err(Level::Look), "better than none");
    // Another robot stands before the camera: the one published is wrong now.
    bench.plant.model = with(1.5, 0.25);
    bench.go(30.0, false, |_, _, _| ());
    assert_eq!(judged(&bench.gate, &with(1.5, 0.25)), Ok(()));
}

#[test]
fn nothing_is_published_before_the_first_verdict_and_nothing_under_a_red_one() {
    let mut bench = Bench::new(vec![]);
    bench.go(20.0, false, |_, _, _| ());
    let model = Model { eta: 1.221, lambda_mm: 0.1765, samples: Some(9), ..Model::default() };
    let mut gate = PublicationGate { verdict: None, ..bench.gate };
    let level_and_code = |gate: &PublicationGate| gate.judge(&model).map_err(|why| (why.level, why.code));
    assert_eq!(level_and_code(&gate), Err((Level::DoNotUse, Code::WorkspaceNotCovered)));
    let reason = |code, level| Verdict::of(vec![Reason::new(code, level, "seen", "do")]);
    for code in [Code::Clock, Code::Wiring, Code::GapAboveNoise] {
        gate.take_verdict(reason(code, Level::DoNotUse));
        assert_eq!(level_and_code(&gate), Err((Level::DoNotUse, code)));
    }
    gate.take_verdict(reason(Code::WorkspaceNotCovered, Level::Look));
    assert_eq!(level_and_code(&gate), Ok(()));
    // What was published under an amber verdict is not the last good one until a good verdict comes.
    gate.publish(model.clone());
    assert!(gate.published().is_some() && gate.last_good().is_none());
    gate.take_verdict(Verdict::default());
    assert!(gate.last_good().is_some());
    // Before the monitor of the gap speaks, a model that leaves more than noise is not published.
    let off = Model { eta: 1.0, ..model.clone() };
    gate.gap = GapState::Unknown;
    assert_eq!(gate.judge(&off).map_err(|why| (why.level, why.code)), Err((Level::Look, Code::GapAboveNoise)));
    gate.poses.truncate(LEAST_POSES - 1);
    assert_eq!(level_and_code(&gate), Err((Level::Look, Code::WorkspaceNotCovered)));
    gate.begin_anew();
    assert!(gate.judge(&model).is_err() && gate.verdict().is_none());
}

#[test]
fn encoders_that_are_homed_anew_are_noticed_within_three_frames_and_judged_before_they_are_commanded_by() {
    for homed_mm in [1.0, -1.0, 0.3] {
        let mut bench = Bench { homed_mm: 0.0, ..Bench::new(vec![]) };
        let keep = |model: &Model, decided: Result<(), Withheld>, gate: &mut PublicationGate| {
            if decided.is_ok() {
                gate.publish(model.clone());
            }
        };
        bench.go(20.0, false, keep);
        bench.homed_mm = homed_mm;
        let (mut former, mut refused, mut frames) = (0, 0, 0);
        bench.go(2.0, false, |model, decided, gate| {
            frames += 1;
            former += usize::from(decided.is_ok() && (model.parameters().y - 0.1765).abs() < 0.1);
            refused += usize::from(matches!(&decided, Err(why) if why.level == Level::DoNotUse));
            assert!(
                decided.is_ok() || gate.last_good().is_none() || frames < 12,
                "the former one is not the last good one"
            );
        });
        assert!(
            former < REJECTED && refused > 20,
            "{homed_mm} mm: {former} answers as before, {refused} of {frames} refused"
        );
        bench.go(4.0, false, keep);
        let (model, _) = bench.gate.last_good().unwrap();
        assert!((model.parameters().y - 0.1765 - homed_mm).abs() < 0.02, "{homed_mm} mm: λ {}", model.parameters().y);
    }
}

#[test]
fn what_no_angle_of_a_stem_explains_is_not_published() {
    for seed in [1, 100, 200] {
        let mut bench = Bench { seed, ..Bench::with_stem() };
        let mut published = 0;
        bench.go(20.0, false, |_, decided, _| published += usize::from(decided.is_ok()));
        assert!(published > 350, "seed {seed}: {published} of 400");
        // A stem that is bent slowly, by 0.5° in each of its frames, is followed.
        for _ in 0..20 {
            let line = &mut bench.plant.model.robot.line;
            *line = line.bent_through(line.total_angle() + 1f64.to_radians());
            bench.go(0.1, false, |_, _, _| {});
        }
        bench.go(10.0, false, |_, _, _| {});
        let mut last = Ok(());
        bench.go(1.0, false, |_, decided, _| last = decided);
        assert_eq!(last, Ok(()), "seed {seed}");
        bench.slipped_mm = 0.2;
        // Two seconds are half a dozen poses.
        bench.go(2.0, false, |_, _, _| {});
        let mut published = 0;
        bench.go(10.0, false, |_, decided, _| published += usize::from(decided.is_ok()));
        assert_eq!(published, 0, "seed {seed}");
    }
}
