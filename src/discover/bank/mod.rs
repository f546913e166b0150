//! How probable each structure is and what its numbers are, sample by sample, after a discovery has said so of the samples until then.
//!
//! Each structure that the discovery leaves open has an extended Kalman filter over η, λ and the parameters of its effects, and so has the
//! model without further effects. A filter's innovations are whitened residuals of samples that it has not seen; their density is the
//! evidence of its structure. Both are forgotten, by one factor: the covariance of the numbers grows before each sample by the random
//! walk that a discount factor stands for, and what is forgotten of a probability goes back to what the discovery said, since two
//! structures that predict alike would else become as probable as each other.
//!
//! Source: West and Harrison 1997, Bayesian Forecasting and Dynamic Models, 2nd ed., 6.3 (discount factor) and 12 (classes of models);
//! Kulhavý and Zarrop 1993, On a general concept of forgetting, Int. J. Control 58:905 (forgetting towards what was known before).

mod member;

use super::data::Data;
use super::discovery::Discovery;
use super::noise::Noise;
use super::posterior::Candidate;
use super::residuals::Problem;
use super::structure::mean_square_quantile;
use super::verdict::Verdict;
use crate::observation::{EncoderReading, Measurement};
pub use member::{Followed, Moved, Number};
use member::{LEAST_PROBABILITY, MEMORY, Member, Score};

/// The structures that a discovery left open, and how they do since.
#[derive(Debug, Clone)]
pub struct Bank {
    members: Vec<Member>,
    noise: Noise,
    /// The latest samples, with the readings that led to them.
    recent: Data,
    /// Index of the latest reading.
    index: u64,
    /// Mean square of the leading member's whitened innovations, over the memory.
    mean_square: f64,
    /// How many samples say as much as one would that hangs together with no other: 1 where noise is all that is left, more where a discrepancy
    /// is, which is alike from one sample to the next.
    design_effect: f64,
}

impl Bank {
    /// Begins with what a discovery left open of its samples. Of a partial answer that is its model, beside the discrepancy that it leaves.
    /// `None` where nothing is left to follow, as of `unexplained`.
    pub fn new(found: &Discovery, data: &Data) -> Option<Self> {
        if found.verdict != Verdict::Partly {
            return Self::of(&found.structures, &found.noise, data);
        }
        let effects = found.named.iter().map(|named| named.physics.name).collect();
        let mut bank =
            Self::of(&[Candidate { effects, probability: 1.0, model: found.model.clone() }], &found.noise, data)?;
        let time_s = data.times_s.last().copied()?;
        let factors = bank.leading().design_effects(&found.model.covariance());
        bank.members.iter_mut().for_each(|member| member.inflate(&factors, time_s));
        bank.design_effect = factors.mean();
        Some(bank)
    }

    /// Of these structures and this noise, with which samples do not hang together.
    fn of(structures: &[Candidate], noise: &Noise, data: &Data) -> Option<Self> {
        let leading = structures.first()?;
        let problem = Problem::new(data, noise, &leading.model);
        let time_s = data.times_s.last().copied()?;
        let mut members: Vec<Member> =
            structures.iter().map(|candidate| Member::new(&problem, candidate, time_s)).collect();
        if structures.iter().all(|candidate| !candidate.effects.is_empty()) {
            let mut plain = leading.model.clone();
            plain.effects.truncate(plain.effects.len() - leading.effects.len());
            let model = problem.fit(&plain, None, None).model;
            let ruled_out = Candidate { effects: Vec::new(), probability: LEAST_PROBABILITY, model };
            members.push(Member::new(&problem, &ruled_out, time_s));
        }
        let (noise, index) = (Noise { unknown_start: 0, ..*noise }, data.indices.last().copied()?);
        Some(Self { members, noise, recent: data.clone(), index, mean_square: 1.0, design_effect: 1.0 })
    }

    /// Takes the samples that came since, and says which numbers of the most probable structure have moved.
    pub fn add(&mut self, measurements: &[Measurement], readings: &[EncoderReading]) -> Vec<Moved> {
        let recent = self.recent.since(self.index, measurements, readings);
        self.index = readings.iter().map(|reading| reading.index).fold(self.index, u64::max);
        let Some(time_s) = recent.times_s.last().copied() else {
            self.recent = recent;
            return Vec::new();
        };
        let problem = Problem::new(&recent, &self.noise, &self.leading().model);
        let by_member: Vec<Vec<Score>> = self.members.iter_mut().map(|member| member.update(&problem)).collect();
        for k in 0..recent.len() {
            let scores: Vec<Score> = by_member.iter().map(|scores| scores[k]).collect();
            let of_leading = scores[self.leading_place()].mean_square;
            self.mean_square += (of_leading - self.mean_square) / MEMORY;
            self.weigh(&scores);
        }
        self.recent = recent;
        let leading = self.leading_place();
        self.members[leading].moved(time_s)
    }

    /// Index of the latest reading that it knows.
    pub fn index(&self) -> u64 {
        self.index
    }

    /// Whether the most probable structure has effects, and leaves nothing but noise of the samples of its memory.
    pub fn accounts_for_samples(&self) -> bool {
        // A mean with weights that fall exponentially is as good as one of twice the memory.
        let freedom = 2.0 * MEMORY * self.leading().model.robot.backbone_count() as f64 / self.design_effect;
        !self.leading().effects.is_empty() && self.mean_square < mean_square_quantile(freedom)
    }

    /// The structures as they stand, the most probable first.
    pub fn structures(&self) -> Vec<Followed> {
        let mut structures: Vec<Followed> = self.members.iter().map(Member::followed).collect();
        structures.sort_by(|a, b| b.probability.total_cmp(&a.probability));
        structures
    }

    fn leading_place(&self) -> usize {
        let by_probability =
            |a: &usize, b: &usize| self.members[*a].ln_probability.total_cmp(&self.members[*b].ln_probability);
        (0..self.members.len()).max_by(by_probability).unwrap_or(0)
    }

    fn leading(&self) -> &Member {
        &self.members[self.leading_place()]
    }

    /// Bayes' rule with the evidence of one sample, after forgetting.
    fn weigh(&mut self, scores: &[Score]) {
        let kept = 1.0 - 1.0 / MEMORY;
        let after = |(member, score): (&Member, &Score)| {
            kept * member.ln_probability + (1.0 - kept) * member.ln_given + score.ln_density / self.design_effect
        };
        let after: Vec<f64> = self.members.iter().zip(scores).map(after).collect();
        let best = after.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        if !best.is_finite() {
            return;
        }
        let odds: Vec<f64> = after.iter().map(|after| (after - best).exp().max(LEAST_PROBABILITY)).collect();
        let sum: f64 = odds.iter().sum();
        self.members.iter_mut().zip(odds).for_each(|(member, odds)| member.ln_probability = (odds / sum).ln());
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::discover::discover;
    use crate::discover::fixture::{SD_ENCODER_MM, truth};
    use crate::observation::Waypoint;
    use crate::robot::{Effect, Model};
    use crate::simulate::{BendingExperiment, Plant, SimulatedEye};
    use std::collections::BTreeMap;

    /// Samples of the discovery.
    const BATCH: usize = 92;

    /// So many samples of the robot with effects that depend on the number of the sample.
    fn log(effects: impl Fn(usize) -> Vec<String>, poses: usize, seed: u64) -> (Vec<Measurement>, Vec<EncoderReading>) {
        let experiment = |seed| BendingExperiment { seed, jitter_deg: 2.0, sweep_poses: 20, ..Default::default() };
        let one = experiment(0).waypoints().unwrap();
        let lasts_s = one.last().unwrap().time_s + 0.35;
        let trajectory: Vec<Waypoint> = (0..poses.div_ceil(one.len()))
            .flat_map(|round| {
                let later = move |w: Waypoint| Waypoint { time_s: w.time_s + round as f64 * lasts_s, ..w };
                experiment(seed * 1000 + round as u64).waypoints().unwrap().into_iter().map(later)
            })
            .take(poses)
            .collect();
        let mut runs = BTreeMap::new();
        let samples: Vec<_> = (0..poses)
            .map(|k| {
                let effects = effects(k);
                let run = runs.entry(effects.clone()).or_insert_with(|| {
                    let effects = effects.iter().map(|text| Effect::parse(text).unwrap()).collect();
                    let plant = Plant { model: Model { effects, ..truth() }, sd_encoder_mm: SD_ENCODER_MM };
                    plant.run(&trajectory, seed)
                });
                run[k]
            })
            .collect();
        let measurements = SimulatedEye::default().observe(&samples, seed + 5000);
        (measurements, samples.iter().map(|sample| sample.reading).collect())
    }

    /// A discovery on the first samples that leaves open these structures, alike.
    fn bank(structures: &[&[&str]], (measurements, readings): &(Vec<Measurement>, Vec<EncoderReading>)) -> Bank {
        let data = Data::new(&measurements[..BATCH], &readings[..BATCH], SD_ENCODER_MM).unwrap();
        let noise = Noise::stated(&data);
        let problem = Problem::new(&data, &noise, &truth());
        let candidate = |effects: &&[&str]| {
            let effects: Vec<Effect> = effects.iter().map(|text| Effect::parse(text).unwrap()).collect();
            let names = effects.iter().map(|effect| effect.physics.name).collect();
            let model = problem.fit(&Model { effects, ..truth() }, None, None).model;
            Candidate { effects: names, probability: 1.0 / structures.len() as f64, model }
        };
        let candidates: Vec<Candidate> = structures.iter().map(candidate).collect();
        Bank::of(&candidates, &noise, &data).unwrap()
    }

    /// What a bank says as it takes the samples after the discovery, so many at a time.
    fn add(
        bank: &mut Bank,
        (measurements, readings): &(Vec<Measurement>, Vec<EncoderReading>),
        at_once: usize,
    ) -> Vec<Moved> {
        let chunks = measurements[BATCH..].chunks(at_once).zip(readings[BATCH..].chunks(at_once));
        chunks.flat_map(|(measurements, readings)| bank.add(measurements, readings)).collect()
    }

    fn probability(bank: &Bank, effect: &str) -> f64 {
        bank.structures().iter().find(|s| s.effects == [effect]).unwrap().probability
    }

    const PLAY: &str = "motion_directed_backlash:half_gap_mm=0.005";
    const FRICTION: &str = "disc_friction:coefficient=0.05";

    #[test]
    fn of_two_structures_left_open_the_true_one_becomes_probable_within_a_hundred_samples() {
        for seed in 0..5 {
            for (hidden, name, other) in [
                (PLAY, "motion_directed_backlash", "disc_friction"),
                (FRICTION, "disc_friction", "motion_directed_backlash"),
            ] {
                let log = log(|_| vec![hidden.to_owned()], BATCH + 100, seed);
                let mut bank = bank(&[&[PLAY], &[FRICTION]], &log);
                assert_eq!(probability(&bank, name), 0.5);
                add(&mut bank, &log, 20);
                let now = [probability(&bank, name), probability(&bank, other)];
                assert!(now[0] > 0.95 && now[1] < 0.05, "{name} {seed}: {now:?}");
                assert_eq!(bank.index(), BATCH as u64 + 99);
            }
        }
    }

    #[test]
    fn a_structure_that_was_all_but_ruled_out_comes_back() {
        let log = log(|_| vec![PLAY.to_owned()], BATCH + 40, 1);
        let mut bank = bank(&[&[PLAY], &[FRICTION]], &log);
        for (member, probability) in bank.members.iter_mut().zip([LEAST_PROBABILITY, 1.0]) {
            (member.ln_probability, member.ln_given) = (probability.ln(), probability.ln());
        }
        add(&mut bank, &log, 20);
        assert!(probability(&bank, "motion_directed_backlash") > 0.95, "{:?}", bank.structures());
    }

    #[test]
    fn two_structures_that_predict_alike_stay_as_probable_as_the_discovery_said() {
        let log = log(|_| vec![PLAY.to_owned()], BATCH + 400, 1);
        let mut bank = bank(&[&[PLAY], &[PLAY]], &log);
        for (member, probability) in bank.members.iter_mut().zip([0.9f64, 0.1]) {
            (member.ln_probability, member.ln_given) = (probability.ln(), probability.ln());
        }
        add(&mut bank, &log, 50);
        let probabilities: Vec<f64> = bank.structures().iter().map(|structure| structure.probability).collect();
        assert!((probabilities[0] - 0.9).abs() < 0.02, "{probabilities:?}");
    }

    #[test]
    fn innovations_of_the_true_structure_are_noise_and_a_steady_number_is_not_told() {
        let (mut told, mut squares, mut components) = (Vec::new(), 0.0, 0.0);
        for seed in 0..20 {
            let log = log(|_| vec!["play_at_bend:half_gap_mm=0.08".to_owned()], BATCH + 300, seed);
            let mut bank = bank(&[&["play_at_bend:half_gap_mm=0.06"]], &log);
            for k in (BATCH..log.0.len()).step_by(25) {
                let (measurements, readings) = (&log.0[k..k + 25], &log.1[k..k + 25]);
                let recent = bank.recent.since(bank.index, measurements, readings);
                let problem = Problem::new(&recent, &bank.noise, &bank.leading().model);
                for score in bank.leading().clone().update(&problem) {
                    squares += 3.0 * score.mean_square;
                    components += 3.0;
                }
                told.extend(bank.add(measurements, readings));
            }
            assert!(bank.accounts_for_samples(), "{seed}: {}", bank.mean_square);
        }
        // χ²/n scatters by √(2/n).
        let mean_square: f64 = squares / components;
        assert!((mean_square - 1.0).abs() < 4.0 * (2.0 / components).sqrt(), "{mean_square}");
        assert!(told.len() <= 1, "{told:?}");
    }

    #[test]
    fn a_number_that_wanders_is_told_and_followed() {
        for seed in 0..5 {
            // By 0.01 mm in 400 samples.
            let half_gap_mm = |k: usize| 0.08 + 0.0005 * (k.saturating_sub(BATCH) / 20) as f64;
            let grows = |k: usize| vec![format!("play_at_bend:half_gap_mm={:.4}", half_gap_mm(k))];
            let log = log(grows, BATCH + 400, seed);
            let mut bank = bank(&[&["play_at_bend:half_gap_mm=0.06"]], &log);
            let told = add(&mut bank, &log, 25);
            let is = bank.structures()[0].parameters["play_at_bend.half_gap_mm"];
            let truth = half_gap_mm(log.0.len() - 1);
            assert!(
                told.iter().all(|moved| moved.name == "play_at_bend.half_gap_mm" && moved.to.unit == "mm"),
                "{told:?}"
            );
            assert!((1..=3).contains(&told.len()), "{told:?}");
            // What grows steadily is followed at a distance of a memory of it, 0.005 mm.
            assert!((0.0..0.006).contains(&(truth - is.value)), "{is:?}");
        }
    }

    /// A play, and a pull of one actuator on the next that no library has.
    #[test]
    fn a_partial_answer_is_followed_beside_what_it_leaves() {
        let batch = 300;
        for seed in 0..3 {
            let mut log = log(|_| vec!["play_at_bend:half_gap_mm=0.15".to_owned()], batch + 300, seed);
            log.1.iter_mut().for_each(|reading| reading.q_mm[0] += 0.02 * reading.q_mm[1].abs().powi(3));
            let data = Data::new(&log.0[..batch], &log.1[..batch], SD_ENCODER_MM).unwrap();
            let found = discover(&truth(), &data);
            assert_eq!(found.verdict, Verdict::Partly);
            let mut bank = Bank::new(&found, &data).unwrap();
            // As uncertain as the discovery says, which knows that what is left hangs together.
            let lambda_mm = bank.structures()[0].parameters["lambda_mm"];
            let sd_mm = found.model.estimate().unwrap().sd_lambda_mm();
            assert!(
                bank.design_effect > 2.0 && (0.99..1.01).contains(&(lambda_mm.sd / sd_mm)),
                "{lambda_mm:?} {sd_mm}"
            );
            let later = log.0[batch..].chunks(20).zip(log.1[batch..].chunks(20));
            let told: Vec<Moved> = later.flat_map(|(measured, readings)| bank.add(measured, readings)).collect();
            assert!(told.is_empty(), "{told:?}");
            assert!(bank.accounts_for_samples() && bank.structures()[0].probability > 0.99, "{:?}", bank.structures());
        }
    }

    #[test]
    fn the_remembered_readings_tell_the_path_as_all_do() {
        let play = "play_at_bend:half_gap_mm=0.08";
        let log = log(|_| vec![play.to_owned()], BATCH + 300, 1);
        let model = Model { effects: vec![Effect::parse(play).unwrap()], ..truth() };
        let residuals = |data: &Data| Problem::new(data, &Noise::stated(data), &model).predict(&model, None).residuals;
        let of_all = residuals(&Data::new(&log.0, &log.1, SD_ENCODER_MM).unwrap());
        let mut recent = Data::new(&log.0[..BATCH], &log.1[..BATCH], SD_ENCODER_MM).unwrap();
        for k in (BATCH..log.0.len()).step_by(25) {
            // Frames that show nothing leave the readings that lead on.
            recent = recent.since(k as u64 - 1, &[], &log.1[k..k + 5]);
            assert!(recent.is_empty());
            recent = recent.since(k as u64 + 4, &log.0[k + 5..k + 25], &log.1[k + 5..k + 25]);
            assert!(recent.len() == 20 && recent.log.q_mm.len() < 80, "{}", recent.log.q_mm.len());
            for (residual, index) in residuals(&recent).iter().zip(&recent.indices) {
                assert!((*residual - of_all[*index as usize]).amax() < 1e-3, "{index}");
            }
        }
        let again = recent.since(0, &log.0[BATCH..], &log.1[BATCH..]);
        assert!(again.is_empty(), "readings of times that have passed lead nowhere");
    }

    #[test]
    fn a_number_that_has_moved_is_said_in_its_unit() {
        let number = |value, sd, unit| Number { value, sd, unit };
        let (from, to) = (number(0.08, 0.0012, "mm"), number(0.0951, 0.0011, "mm"));
        let moved = Moved { name: "play_at_bend.half_gap_mm".into(), from, to, seconds: 240.4 };
        let text =
            "play_at_bend.half_gap_mm has moved within 240 s: it was 0.0800 ± 0.0012 mm, and is 0.0951 ± 0.0011 mm";
        assert_eq!(moved.to_string(), text);
    }
}
