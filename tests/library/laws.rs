//! Laws proposed for effects that the library does not have, smooth and hysteretic: what they leave of sweeps left out, and of another ride.
//!
//! ```sh
//! LAWS_SEEDS=4 cargo test --release --no-default-features --features cli --test library laws -- --ignored --nocapture
//! ```

use rayon::prelude::*;
use snakeloop::discover::{Data, discover, propose_law};
use snakeloop::estimate::gap::gap;
use snakeloop::robot::{Model, PerBackbone};
use snakeloop::simulate::Sealed;

/// What is added to a reading q̃ (mm) of a size (mm), and where plays stand that it has.
type Change = fn(&mut PerBackbone, f64, &mut PerBackbone);

const KINDS: [(&str, Change); 6] = [
    ("smooth: one actuator pulls on the next", |q, size, _| q[0] += 0.5 * size * q[1].abs().powi(3)),
    ("smooth: a stretch that saturates", |q, size, _| *q = q.map(|q| q + 1.5 * size * (q / 0.4).tanh())),
    ("smooth: the same along a hyperbola", |q, size, _| *q = q.map(|q| q + 1.5 * size * q / (0.4 + q.abs()))),
    ("smooth: lines that stretch when pulled only", |q, size, _| *q = q.map(|q| q + size * (q + 0.3).max(0.0).powi(2))),
    ("hysteretic: play of one backbone alone", |q, size, stood| q[1] += lag(&mut stood[1], q[1], 2.0 * size)),
    ("hysteretic: play that grows with the bend", |q, size, stood| {
        for i in 0..q.len() {
            q[i] += 12.0 * size * q[i].abs() * lag(&mut stood[i], q[i], 0.1);
        }
    }),
];

/// How far a play of this half width lags behind q, mm; `stood` is where it stands.
fn lag(stood: &mut f64, q: f64, half: f64) -> f64 {
    *stood = stood.clamp(q - half, q + half);
    q - *stood
}

fn hidden(mut sealed: Sealed, change: Change, size: f64) -> Sealed {
    let mut stood = PerBackbone::repeat(3, 0.0);
    sealed.readings.iter_mut().for_each(|reading| change(&mut reading.q_mm, size, &mut stood));
    sealed
}

/// What a gap is beyond noise, mm.
fn beyond(gap_mm: f64, floor_mm: f64) -> f64 {
    (gap_mm.powi(2) - floor_mm.powi(2)).max(0.0).sqrt()
}

/// What share of a gap is left; nothing of one that is not above noise.
fn share(after: f64, before: f64) -> f64 {
    if before > 0.0 { after / before } else { 0.0 }
}

/// Of each kind, what share of the gap beyond noise a law leaves: on blocks of sweeps that it was chosen and fitted without, and on another
/// ride. Four of five kinds must be left with 30 % of it or less on the median of the sweeps left out. LAWS_FIRST is the first seed.
#[test]
#[ignore = "a survey of a minute"]
fn a_law_takes_away_most_of_what_no_effect_of_the_library_does() {
    let number = |name: &str, usual: u64| std::env::var(name).ok().and_then(|text| text.parse().ok()).unwrap_or(usual);
    let (first, seeds) = (number("LAWS_FIRST", 40), number("LAWS_SEEDS", 4));
    let mut good = 0;
    for (title, change) in KINDS {
        let shares: Vec<[f64; 2]> = (first..first + seeds)
            .into_par_iter()
            .map(|seed| {
                let size = 0.04 + 0.004 * (seed % 20) as f64;
                let sealed = Sealed::new(&[], 9000 + seed).expect("a sealed experiment");
                let other = hidden(sealed.another(88_000 + seed).expect("another ride"), change, size);
                let sealed = hidden(sealed, change, size);
                let data = Data::new(&sealed.measurements, &sealed.readings, 0.0015).expect("enough samples");
                let found = discover(&Model::default(), &data);
                let law = propose_law(&found, &data);
                let floor = found.noise_floor_mm;
                let on_other = |model: &Model| {
                    let gap = gap(model, &other.measurements, &other.readings);
                    beyond(gap.rms_eps_mm, gap.noise_floor_mm)
                };
                let with = law.model.as_ref().unwrap_or(&found.model);
                [
                    share(beyond(law.after_mm, floor), beyond(law.before_mm, floor)),
                    share(on_other(with), on_other(&found.model)),
                ]
            })
            .collect();
        let median = |side: usize| {
            let mut values: Vec<f64> = shares.iter().map(|sides| sides[side]).collect();
            values.sort_by(f64::total_cmp);
            values[values.len() / 2]
        };
        println!(
            "{title:46} left: {:.2} of sweeps left out, {:.2} of another ride  {shares:.2?}",
            median(0),
            median(1)
        );
        good += usize::from(median(0) <= 0.3);
    }
    assert!(5 * good >= 4 * KINDS.len(), "{good} of {} kinds", KINDS.len());
}
