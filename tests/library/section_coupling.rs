//! `section_coupling`: a neighbouring section's readings, found, named and obeyed.

use rayon::prelude::*;
use snakeloop::discover::{Data, Discovery, Verdict, discover};
use snakeloop::estimate::estimate;
use snakeloop::estimate::gap::gap;
use snakeloop::robot::{COUPLINGS, LIBRARY, Model, Neighbours, Physics};
use snakeloop::simulate::Sealed;

const SD_ENCODER_MM: f64 = 0.0015;

fn found(sealed: &Sealed) -> Discovery {
    discover(
        &Model::default(),
        &Data::new(&sealed.measurements, &sealed.readings, SD_ENCODER_MM).expect("enough samples"),
    )
}

/// An experiment with these effects hidden whose log has neighbours that move.
fn beside_neighbours(hidden: &[&'static Physics], seed: u64) -> Sealed {
    let mut sealed = Sealed::new(hidden, seed).expect("a sealed experiment");
    let coupled = Sealed::new(&[COUPLINGS[0]], seed).expect("a sealed experiment");
    for (reading, beside) in sealed.readings.iter_mut().zip(&coupled.readings) {
        reading.neighbours = beside.neighbours;
    }
    sealed
}

/// What is wrong with what was found of a hidden coupling; none where it is named, and its model predicts another ride to the noise.
fn fault(physics: &'static Physics, seed: u64) -> Option<String> {
    let sealed = Sealed::new(&[physics], seed).expect("a sealed experiment");
    let other = sealed.another(seed + 77_000).expect("a sealed experiment");
    let found = found(&sealed);
    let names: Vec<_> = found.named.iter().map(|named| (named.physics.name, named.physics.form)).collect();
    let gap = gap(&found.model, &other.measurements, &other.readings);
    let ratio = gap.rms_eps_mm / gap.noise_floor_mm;
    let is_right = found.verdict == Verdict::Named
        && matches!(names[..], [("section_coupling", form)] if form == physics.form)
        && ratio < 1.15;
    (!is_right)
        .then(|| format!("{seed} {:?}: {} {names:?}, {ratio:.3} of the floor", physics.form, found.verdict.word()))
}

#[test]
fn a_coupling_is_named_and_obeyed_on_another_ride() {
    let faults: Vec<String> =
        [COUPLINGS[0], COUPLINGS[2]].into_par_iter().filter_map(|form| fault(form, 400)).collect();
    assert!(faults.is_empty(), "{faults:#?}");
    let sealed = beside_neighbours(&[], 401);
    assert_eq!(found(&sealed).verdict, Verdict::None, "nothing is hidden beside neighbours that move");
}

/// Every form hidden in turn; nothing hidden, and another effect, beside neighbours that move.
///
/// ```sh
/// SEALED_SEEDS=20 cargo test --release --no-default-features --features cli --test library couplings -- --ignored --nocapture
/// ```
#[test]
#[ignore = "a survey of several minutes"]
fn couplings_are_named_and_nothing_else_is() {
    let seeds: u64 = std::env::var("SEALED_SEEDS").ok().and_then(|text| text.parse().ok()).unwrap_or(20);
    for physics in COUPLINGS {
        let faults: Vec<String> = (0..seeds).into_par_iter().filter_map(|seed| fault(physics, 1000 + seed)).collect();
        println!("{:?}: right {} of {seeds} {faults:#?}", physics.form, seeds - faults.len() as u64);
        assert!(20 * faults.len() as u64 <= 2 * seeds, "{faults:#?}");
    }
    let none = |seed: u64| found(&beside_neighbours(&[], 2000 + seed)).verdict == Verdict::None;
    let right = (0..seeds).into_par_iter().filter(|&seed| none(seed)).count() as u64;
    println!("nothing hidden beside neighbours: right {right} of {seeds}");
    assert!(10 * right >= 9 * seeds);
    let firsts: Vec<_> = LIBRARY.into_iter().filter(|physics| physics.form.is_empty()).collect();
    let other = |seed: u64| {
        let hidden = firsts[seed as usize % firsts.len()];
        let found = found(&beside_neighbours(&[hidden], 3000 + seed));
        let names: Vec<_> = found.named.iter().map(|named| named.physics.name).collect();
        let is_right = found.verdict == Verdict::Named && names == [hidden.name];
        (!is_right).then(|| format!("{}: {} {names:?}", hidden.name, found.verdict.word()))
    };
    let faults: Vec<String> = (0..seeds).into_par_iter().filter_map(other).collect();
    println!("another effect beside neighbours: right {} of {seeds} {faults:#?}", seeds - faults.len() as u64);
    assert!(faults.iter().all(|fault| !fault.contains("section_coupling")), "{faults:#?}");
}

#[test]
fn an_estimate_beside_neighbours_is_that_of_the_section_alone() {
    let sealed = Sealed::new(&[COUPLINGS[0]], 402).expect("a sealed experiment");
    let coupled = sealed.truth.without_estimate();
    let options = snakeloop::estimate::Options::default();
    let (_, beside) = estimate(&coupled, options, &sealed.measurements, &sealed.readings).unwrap();
    // The same readings, what the neighbour adds taken off by hand.
    let mut alone = sealed.readings.clone();
    for reading in &mut alone {
        reading.q_mm = reading.q_mm - coupled.by_neighbours_mm(&reading.neighbours);
        reading.neighbours = Neighbours::default();
    }
    let (_, of_alone) = estimate(&coupled.plain(), options, &sealed.measurements, &alone).unwrap();
    let (x, alone_x) = (beside.parameters(), of_alone.parameters());
    assert!((x - alone_x).norm() < 1e-6, "{x} {alone_x}");
    // Without the coupling η and λ would be told wrongly, or less surely.
    let gap = |model: &Model| gap(model, &sealed.measurements, &sealed.readings).rms_eps_mm;
    assert!(gap(&beside) < 0.5 * gap(&Model { effects: Vec::new(), ..beside.clone() }));
}
