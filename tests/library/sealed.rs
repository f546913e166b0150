//! `discover` on sealed experiments, whose hidden effects it is not told. The confusion table: `tools/sealed`.
//!
//! The table prints, for each hidden effect, how often it was named and what was named instead, and how often its parameters lay in
//! the 95 % interval of the answer.

use rand::rngs::StdRng;
use rand::{RngExt, SeedableRng};
use rand_distr::StandardNormal;
use rayon::prelude::*;
use snakeloop::discover::{Candidate, Data, Discovery, Named, Verdict, discover};
use snakeloop::estimate::gap::gap;
use snakeloop::geometry::Configuration;
use snakeloop::robot::{LIBRARY, Model, PerBackbone, Physics};
use snakeloop::simulate::Sealed;
use std::collections::BTreeMap;
use std::time::Instant;

/// What came of one experiment.
struct Outcome {
    names: Vec<&'static str>,
    verdict: Verdict,
    not_ruled_out: Vec<&'static str>,
    within: usize,
    parameters: usize,
    ratio: f64,
    seconds: f64,
}

/// The shares of experiments that must be right: with one effect hidden, two, none, and with one that the library does not have.
const LEAST_ONE: f64 = 0.95;
const LEAST_TWO: f64 = 0.90;
const LEAST_NONE: f64 = 0.97;
const LEAST_OUTSIDE: f64 = 0.90;
/// The same with nothing hidden, where the noise is not what is stated.
const LEAST_OF_NOISE: f64 = 0.95;
/// The share of parameters that must lie in the 95 % interval of their answer.
const LEAST_WITHIN: f64 = 0.90;

/// One physics with two signs: hidden together they are the difference of their sizes, which may be nothing.
const OPPOSITES: [&str; 2] = ["superelastic_softening", "cubic_stiffness"];

/// The first form of every name.
fn library() -> Vec<&'static Physics> {
    LIBRARY.into_iter().filter(|physics| physics.form.is_empty()).collect()
}

/// The whole table for as many seeds as SEALED_SEEDS says, of the parts that SEALED_PARTS names (one, none, noisy, two, outside, long), and of
/// one hidden effect those that SEALED_EFFECTS names (all by default); without SEALED_SEEDS a few of the second.
#[test]
fn what_is_hidden_is_named() {
    let seeds: u64 = std::env::var("SEALED_SEEDS").ok().and_then(|text| text.parse().ok()).unwrap_or(0);
    if seeds == 0 {
        return slice();
    }
    let parts = std::env::var("SEALED_PARTS").unwrap_or_else(|_| "one,none,noisy,two,outside".into());
    let wanted = |part: &str| parts.split(',').any(|p| p == part);
    if wanted("one") {
        one(seeds);
    }
    if wanted("none") {
        let outcomes: Vec<Outcome> = (0..10 * seeds).into_par_iter().map(|seed| outcome(&[], seed)).collect();
        let right = show("nothing hidden", &outcomes, Verdict::None, &[]);
        require("nothing hidden", right, outcomes.len(), LEAST_NONE);
    }
    if wanted("noisy") {
        noisy(seeds);
    }
    if wanted("two") {
        two(seeds);
    }
    if wanted("outside") {
        outside(seeds);
    }
    if wanted("long") {
        long(seeds);
    }
}

/// Twenty thousand samples, of which a part is searched first.
fn long(seeds: u64) {
    for name in ["play_at_bend", "bouc_wen", "thermal_drift", "tip_load"] {
        let physics = library().into_iter().find(|physics| physics.name == name).expect("an effect of the library");
        let of_seed = |seed| discovered(&Sealed::of_poses(&[physics], 6000 + seed, 2125, 3000).expect("an experiment"));
        let outcomes: Vec<Outcome> = (0..seeds).map(of_seed).collect();
        let right = show(physics.name, &outcomes, Verdict::Named, &[physics.name]);
        require("one hidden in a long log", right, outcomes.len(), LEAST_ONE);
    }
}

/// What came of one experiment of the survey of probabilities and sigmas.
struct Judged {
    /// Of each effect that is named: its probability, and whether it is there.
    effects: Vec<(f64, bool)>,
    /// Of each combination that is left open: its probability, and whether it is what is hidden.
    combinations: Vec<(f64, bool)>,
    /// Of what was answered.
    chosen: f64,
    /// Mean square of the commands' errors over their sigmas, and the share within 1.96 of them.
    commands: (f64, f64),
}

impl Judged {
    /// Nothing, one or two effects hidden, by the seed; half of the usual number of samples.
    fn new(seed: usize, first: u64) -> Self {
        let library = library();
        let pair = [library[seed * 7 % library.len()], library[(seed * 11 + 5) % library.len()]];
        let hidden = if pair[0] == pair[1] { &pair[..1] } else { &pair[..seed % 3] };
        let sealed = Sealed::of_poses(hidden, first + seed as u64, 17, 24).expect("a sealed experiment");
        let data = Data::new(&sealed.measurements, &sealed.readings, 0.0015).expect("enough samples");
        let found = discover(&Model::default(), &data);
        let is_hidden =
            |names: &[&str]| names.len() == hidden.len() && hidden.iter().all(|physics| names.contains(&physics.name));
        let is_there = |name: &str| hidden.iter().any(|physics| physics.name == name);
        let answered: Vec<&str> = found.named.iter().map(|named| named.physics.name).collect();
        let is_answered = |candidate: &&Candidate| {
            candidate.effects.len() == answered.len() && answered.iter().all(|name| candidate.effects.contains(name))
        };
        let of_effect = |named: &Named| (named.probability(), is_there(named.physics.name));
        let of_structure = |candidate: &Candidate| (candidate.probability, is_hidden(&candidate.effects));
        Self {
            effects: if found.verdict.has_effects() { found.named.iter().map(of_effect).collect() } else { Vec::new() },
            combinations: found.structures.iter().map(of_structure).collect(),
            chosen: found.structures.iter().find(is_answered).map_or(0.0, |candidate| candidate.probability),
            commands: command_errors(&found.model, &sealed.truth),
        }
    }
}

/// Mean square of the errors of commands over their sigmas, at bends all round, and the share within 1.96 of them.
fn command_errors(model: &Model, truth: &Model) -> (f64, f64) {
    let bends = [10.0, 30.0, 50.0, 65.0]
        .into_iter()
        .flat_map(|theta_deg| (0..6).map(move |k| Configuration::from_degrees(theta_deg, 60.0 * f64::from(k) - 170.0)));
    let errors: Vec<f64> = bends
        .flat_map(|psi| {
            let errors = (model.command(psi) - truth.command(psi)).component_div(&model.command_sds(psi));
            errors.iter().copied().collect::<Vec<_>>()
        })
        .collect();
    let share = |of: fn(&f64) -> f64| errors.iter().map(of).sum::<f64>() / errors.len() as f64;
    (share(|z| z * z), share(|z| f64::from(u8::from(z.abs() <= 1.96))))
}

/// Of effects and of combinations that are given a probability, as many are there, and commands err as their sigmas say: nothing, one or
/// two effects hidden by turns. Of 70 to 90 %, 70 to 90 % must be there, within two standard errors. SEALED_FIRST is the first seed.
///
/// ```sh
/// SEALED_SEEDS=60 cargo test --release --no-default-features --features cli --test library calibrated -- --ignored --nocapture
/// ```
#[test]
#[ignore = "a survey of several minutes"]
fn probabilities_and_sigmas_are_calibrated() {
    let number = |name: &str, usual: u64| std::env::var(name).ok().and_then(|text| text.parse().ok()).unwrap_or(usual);
    let (seeds, first) = (number("SEALED_SEEDS", 20) as usize, number("SEALED_FIRST", 3000));
    let all: Vec<Judged> = (0..seeds).into_par_iter().map(|seed| Judged::new(seed, first)).collect();
    for (is_open, what) in [(false, "one structure (99 % or more)"), (true, "several")] {
        let own: Vec<(f64, f64)> = all
            .iter()
            .filter(|judged| !judged.combinations.is_empty() && (judged.chosen < 0.99) == is_open)
            .map(|judged| judged.commands)
            .collect();
        let mean = |of: fn(&(f64, f64)) -> f64| own.iter().map(of).sum::<f64>() / own.len() as f64;
        println!("{what}: {} answers, mean square {:.2}, within 95 %: {:.3}", own.len(), mean(|c| c.0), mean(|c| c.1));
    }
    let effects: Vec<(f64, bool)> = all.iter().flat_map(|judged| judged.effects.clone()).collect();
    let combinations: Vec<(f64, bool)> = all.iter().flat_map(|judged| judged.combinations.clone()).collect();
    require_calibrated("effects", &effects);
    require_calibrated("combinations", &combinations);
}

/// Prints how many are there by classes of the probability.
fn require_calibrated(what: &str, all: &[(f64, bool)]) {
    let of = |least: f64, most: f64| {
        let own = all.iter().filter(|(p, _)| (least..most).contains(p));
        (own.clone().filter(|(_, is_there)| *is_there).count() as f64, own.count() as f64)
    };
    for (least, most) in [(0.0, 0.1), (0.1, 0.3), (0.3, 0.5), (0.5, 0.7), (0.7, 0.9), (0.9, 0.97), (0.97, 1.01)] {
        let (there, count) = of(least, most);
        println!("{what} {least:.2} to {most:.2}: {there} of {count} are there");
    }
    let (there, count) = of(0.7, 0.9);
    let slack = 2.0 * (0.8 * 0.2 * count).sqrt();
    assert!(there >= 0.7 * count - slack && there <= 0.9 * count + slack, "{what}: {there} of {count}");
}

/// One seed of every effect: it is named, and what was found is the model that another trajectory obeys: there nothing is left to find, and
/// the gap is noise.
#[test]
fn each_effect_is_named_and_its_model_leaves_nothing_to_find_on_another_trajectory() {
    let bad: Vec<String> = library()
        .into_par_iter()
        .filter_map(|physics| {
            let sealed = Sealed::new(&[physics], 300).expect("a sealed experiment");
            let other = sealed.another(301).expect("a sealed experiment");
            let data = |of: &Sealed| Data::new(&of.measurements, &of.readings, 0.0015).expect("enough samples");
            let names = |of: &Discovery| -> Vec<_> { of.named.iter().map(|named| named.physics.name).collect() };
            let found = discover(&Model::default(), &data(&sealed));
            let again = discover(&found.model, &data(&other));
            let ratio = on_another(&found.model, &other);
            let fine = names(&found) == [physics.name] && again.verdict == Verdict::None && ratio < 1.15;
            let then = (again.verdict.word(), names(&again));
            (!fine).then(|| format!("{}: {:?}, then {then:?}, {ratio:.3} of the floor", physics.name, names(&found)))
        })
        .collect();
    // A tenth may be missed, as of single effects: plays that grow with the load look like others on one trajectory.
    assert!(10 * bad.len() <= library().len(), "{bad:#?}");
}

/// The rms of ε that a model leaves on another trajectory, as a multiple of what noise alone leaves there.
fn on_another(model: &Model, other: &Sealed) -> f64 {
    let gap = gap(model, &other.measurements, &other.readings);
    gap.rms_eps_mm / gap.noise_floor_mm
}

/// A few with nothing hidden, every second with encoders noisier than they are said to be.
fn slice() {
    let is_none = |seed: u64| {
        let added_mm = if seed.is_multiple_of(2) { 0.0 } else { 0.005 };
        discovered(&with_wrong_sigmas(seed, added_mm, 1.0)).verdict == Verdict::None
    };
    let none: Vec<bool> = (0..6u64).into_par_iter().map(is_none).collect();
    assert!(none.iter().filter(|none| !**none).count() <= 1, "{none:?}");
    let wrong: Vec<u64> = (0..20).into_par_iter().filter(|&seed| of_ten_samples(seed) != Verdict::None).collect();
    assert!(wrong.len() <= 1, "{wrong:?}");
}

/// The verdict on ten samples of an experiment with nothing hidden.
fn of_ten_samples(seed: u64) -> Verdict {
    let mut sealed = Sealed::new(&[], 60_000 + seed).expect("a sealed experiment");
    let stride = sealed.measurements.len() / 10;
    sealed.measurements = sealed.measurements.into_iter().step_by(stride).take(10).collect();
    sealed.readings = sealed.readings.into_iter().step_by(stride).take(10).collect();
    let data = Data::new(&sealed.measurements, &sealed.readings, 0.0015).expect("enough samples");
    discover(&Model::default(), &data).verdict
}

fn one(seeds: u64) {
    let (mut right, mut all, mut within, mut parameters) = (0, 0, 0, 0);
    let names = std::env::var("SEALED_EFFECTS").unwrap_or_default();
    let wanted = |physics: &&Physics| names.is_empty() || names.split(',').any(|name| name == physics.name);
    for physics in library().into_iter().filter(wanted) {
        let outcomes: Vec<Outcome> = (0..seeds).into_par_iter().map(|seed| outcome(&[physics], 1000 + seed)).collect();
        right += show(physics.name, &outcomes, Verdict::Named, &[physics.name]);
        all += outcomes.len();
        within += outcomes.iter().map(|o| o.within).sum::<usize>();
        parameters += outcomes.iter().map(|o| o.parameters).sum::<usize>();
    }
    println!("one hidden: right {right} of {all}; parameters within 95 %: {within} of {parameters}\n");
    require("one hidden", right, all, LEAST_ONE);
    require("parameters within 95 %", within, parameters, LEAST_WITHIN);
}

/// An experiment with nothing hidden whose encoders have more noise than is stated (mm, σ), and whose eye states σ too small by a factor.
fn with_wrong_sigmas(seed: u64, added_mm: f64, factor: f64) -> Sealed {
    let mut sealed = Sealed::new(&[], 7000 + seed).expect("a sealed experiment");
    let mut random = StdRng::seed_from_u64(seed);
    for q in sealed.readings.iter_mut().flat_map(|reading| reading.q_mm.iter_mut()) {
        *q += added_mm * random.sample::<f64, _>(StandardNormal);
    }
    for measured in sealed.measurements.iter_mut().filter_map(|measurement| measurement.measured.as_mut()) {
        measured.sigma_theta /= factor;
        measured.sigma_delta /= factor;
    }
    sealed
}

/// Nothing hidden, encoders noisier than they are said to be, and an eye whose sigmas are wrong by a factor.
fn noisy(seeds: u64) {
    let mut right = 0;
    let cases = [(0.003, 1.0), (0.005, 1.0), (0.010, 1.0), (0.020, 1.0), (0.0, 0.5), (0.0, 3.0)];
    for (added_mm, factor) in cases {
        let outcomes: Vec<Outcome> =
            (0..seeds).into_par_iter().map(|seed| discovered(&with_wrong_sigmas(seed, added_mm, factor))).collect();
        let title = format!("encoders +{added_mm} mm, eye × {factor}");
        right += show(&title, &outcomes, Verdict::None, &[]);
    }
    require("nothing hidden under wrong sigmas", right, cases.len() * seeds as usize, LEAST_OF_NOISE);
}

fn two(seeds: u64) {
    let library = library();
    let pairs: Vec<[&'static Physics; 2]> = (0..library.len())
        .flat_map(|b| library[..b].iter().map(move |a| (*a, b)))
        .map(|(a, b)| [a, library[b]])
        .filter(|[a, b]| [a.name, b.name] != OPPOSITES)
        .collect();
    let chosen: Vec<_> = (0..8 * seeds).map(|k| pairs[(k as usize * 37 + 11) % pairs.len()]).collect();
    let outcomes: Vec<(String, Outcome)> = chosen
        .into_par_iter()
        .enumerate()
        .map(|(k, pair)| (format!("{} + {}", pair[0].name, pair[1].name), outcome(&pair, 5000 + k as u64)))
        .collect();
    let mut right = 0;
    for (title, outcome) in &outcomes {
        let names = &outcome.names;
        // One that the data do not tell from what was named must be said to be so.
        let is_told = |name: &str| names.contains(&name) || outcome.not_ruled_out.contains(&name);
        let both = names.len() == 2
            && title.split(" + ").all(is_told)
            && names.iter().any(|name| title.split(" + ").any(|hidden| hidden == *name));
        right += usize::from(both && outcome.verdict == Verdict::Named);
        if !both || outcome.verdict != Verdict::Named {
            println!("  {title}: {} {names:?} not ruled out {:?}", outcome.verdict.word(), outcome.not_ruled_out);
        }
    }
    println!("two hidden: both {right} of {}\n", outcomes.len());
    require("two hidden", right, outcomes.len(), LEAST_TWO);
}

/// Effects that no library has: each a change of the readings.
fn outside(seeds: u64) {
    type Change = fn(usize, f64, &mut PerBackbone, f64);
    let changes: [(&str, Change); 5] = [
        ("a slip of all actuators halfway", |k, _, q, size| {
            if k > 150 {
                *q = q.add_scalar(size)
            }
        }),
        ("a slip of one actuator halfway", |k, _, q, size| {
            if k > 150 {
                q[0] += size
            }
        }),
        ("a thermal swing", |_, t, q, size| *q = q.add_scalar(size * (t / 9.0).sin())),
        ("a pull of one actuator on the next", |_, _, q, size| q[0] += 0.5 * size * q[1].abs().powi(3)),
        ("a hum of one actuator", |_, t, q, size| q[1] += size * (t * 2.1).sin()),
    ];
    let mut right = 0;
    for (title, change) in changes {
        let outcomes: Vec<Outcome> = (0..seeds)
            .into_par_iter()
            .map(|seed| {
                let mut sealed = Sealed::new(&[], 9000 + seed).expect("a sealed experiment");
                for (k, reading) in sealed.readings.iter_mut().enumerate() {
                    change(k, reading.time_s, &mut reading.q_mm, 0.04 + 0.004 * (seed % 20) as f64);
                }
                discovered(&sealed)
            })
            .collect();
        right += show(title, &outcomes, Verdict::Unexplained, &[]);
    }
    require("outside the library", right, changes.len() * seeds as usize, LEAST_OUTSIDE);
}

/// That a share of experiments is not below what is asked, by more than two standard errors.
fn require(what: &str, right: usize, all: usize, least: f64) {
    let standard_error = (least * (1.0 - least) / all as f64).sqrt();
    let share = right as f64 / all as f64;
    assert!(share >= least - 2.0 * standard_error, "{what}: {right} of {all}, and {least} is asked");
}

fn outcome(hidden: &[&'static Physics], seed: u64) -> Outcome {
    discovered(&Sealed::new(hidden, seed).expect("a sealed experiment"))
}

fn discovered(sealed: &Sealed) -> Outcome {
    let began = Instant::now();
    let data = Data::new(&sealed.measurements, &sealed.readings, 0.0015).expect("enough samples");
    let found: Discovery = discover(&Model::default(), &data);
    let seconds = began.elapsed().as_secs_f64();
    let (mut within, mut parameters) = (0, 0);
    for (k, effect) in found.model.effects.iter().enumerate() {
        let Some(truth) = sealed.truth.effects.iter().find(|truth| truth.physics == effect.physics) else { continue };
        for ((value, sd), truth) in effect.values.iter().zip(&found.model.effect_sds(k)).zip(&truth.values) {
            parameters += 1;
            within += usize::from((value - truth).abs() <= 1.96 * sd);
        }
    }
    Outcome {
        names: if found.verdict.has_effects() { found.named.iter().map(|n| n.physics.name).collect() } else { vec![] },
        verdict: found.verdict,
        not_ruled_out: found.named.iter().flat_map(|named| named.indistinguishable_from.clone()).collect(),
        within,
        parameters,
        ratio: on_another(&found.model, &sealed.another(77_777).expect("a sealed experiment")),
        seconds,
    }
}

/// Prints a line of the table; how many were right.
fn show(title: &str, outcomes: &[Outcome], verdict: Verdict, names: &[&'static str]) -> usize {
    let right = outcomes.iter().filter(|o| o.verdict == verdict && o.names == names).count();
    let mut others: BTreeMap<String, usize> = BTreeMap::new();
    for outcome in outcomes.iter().filter(|o| !(o.verdict == verdict && o.names == names)) {
        *others.entry(format!("{} {}", outcome.verdict.word(), outcome.names.join(" + "))).or_default() += 1;
    }
    let (within, parameters) =
        outcomes.iter().fold((0, 0), |(a, b), outcome| (a + outcome.within, b + outcome.parameters));
    let open = outcomes.iter().filter(|o| !o.not_ruled_out.is_empty()).count();
    let mean = |of: fn(&Outcome) -> f64| outcomes.iter().map(of).sum::<f64>() / outcomes.len() as f64;
    println!(
        "{title:28} right {right:3} of {:3}  in 95 %: {within:3} of {parameters:3}  alternatives open in {open:3}  another trajectory {:.3} of the floor  {:.2} s  {}",
        outcomes.len(),
        mean(|o| o.ratio),
        mean(|o| o.seconds),
        others.iter().map(|(what, count)| format!("{count}× {what}")).collect::<Vec<_>>().join(", ")
    );
    right
}
