//! `discover` on sealed experiments, whose hidden effects it is not told. The confusion table: `tools/sealed`.
//!
//! The table prints, for each hidden effect, how often it was named and what was named instead, and how often its parameters lay in
//! the 95 % interval of the answer.

use rayon::prelude::*;
use snakeloop::discover::{Data, Discovery, Verdict, discover};
use snakeloop::estimate::gap::gap;
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
/// The share of parameters that must lie in the 95 % interval of their answer.
const LEAST_WITHIN: f64 = 0.90;

/// The first form of every name.
fn library() -> Vec<&'static Physics> {
    LIBRARY.into_iter().filter(|physics| physics.form.is_empty()).collect()
}

/// The whole table for as many seeds as SEALED_SEEDS says, of the parts that SEALED_PARTS names (one, none, two, outside); by
/// default a slice of it.
#[test]
fn what_is_hidden_is_named() {
    let seeds: u64 = std::env::var("SEALED_SEEDS").ok().and_then(|text| text.parse().ok()).unwrap_or(0);
    if seeds == 0 {
        return slice();
    }
    let parts = std::env::var("SEALED_PARTS").unwrap_or_else(|_| "one,none,two,outside".into());
    let wanted = |part: &str| parts.split(',').any(|p| p == part);
    if wanted("one") {
        one(seeds);
    }
    if wanted("none") {
        let outcomes: Vec<Outcome> = (0..10 * seeds).into_par_iter().map(|seed| outcome(&[], seed)).collect();
        let right = show("nothing hidden", &outcomes, Verdict::None, &[]);
        require("nothing hidden", right, outcomes.len(), LEAST_NONE);
    }
    if wanted("two") {
        two(seeds);
    }
    if wanted("outside") {
        outside(seeds);
    }
}

/// What `discover` finds is the model that another trajectory obeys: there it finds nothing, and the gap is noise.
#[test]
fn the_model_found_leaves_nothing_to_find_on_another_trajectory() {
    let bad: Vec<String> = library()
        .into_par_iter()
        .filter_map(|physics| {
            let sealed = Sealed::new(&[physics], 300).expect("a sealed experiment");
            let other = sealed.another(301).expect("a sealed experiment");
            let data = |of: &Sealed| Data::new(&of.measurements, &of.readings, 0.0015).expect("enough samples");
            let found = discover(&Model::default(), &data(&sealed));
            let again = discover(&found.model, &data(&other));
            let ratio = on_another(&found.model, &other);
            let fine = again.verdict == Verdict::None && ratio < 1.15;
            let names: Vec<_> = again.named.iter().map(|named| named.physics.name).collect();
            (!fine).then(|| format!("{}: {} {names:?}, {ratio:.3} of the floor", physics.name, again.verdict.word()))
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

/// One seed of every effect, and a few with nothing hidden.
fn slice() {
    let right: Vec<bool> =
        library().into_par_iter().map(|physics| outcome(&[physics], 77).names == [physics.name]).collect();
    assert!(right.iter().filter(|right| !**right).count() <= 1, "{right:?}");
    let none: Vec<bool> = (0..6u64).into_par_iter().map(|seed| outcome(&[], seed).verdict == Verdict::None).collect();
    assert!(none.iter().filter(|none| !**none).count() <= 1, "{none:?}");
}

fn one(seeds: u64) {
    let (mut right, mut all, mut within, mut parameters) = (0, 0, 0, 0);
    for physics in library() {
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

fn two(seeds: u64) {
    let library = library();
    let pairs: Vec<[&'static Physics; 2]> = (0..library.len())
        .flat_map(|b| library[..b].iter().map(move |a| (*a, b)))
        .map(|(a, b)| [a, library[b]])
        .collect();
    let chosen: Vec<_> = (0..8 * seeds).map(|k| pairs[(k as usize * 37 + 11) % pairs.len()]).collect();
    let outcomes: Vec<(String, Outcome)> = chosen
        .into_par_iter()
        .enumerate()
        .map(|(k, pair)| (format!("{} + {}", pair[0].name, pair[1].name), outcome(&pair, 5000 + k as u64)))
        .collect();
    let mut right = 0;
    for (title, outcome) in &outcomes {
        let names: Vec<&'static str> = outcome.names.clone();
        let both = title.split(" + ").all(|name| names.contains(&name)) && names.len() == 2;
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
