//! `discover` on machines that lie wholly in no library: tendons in sheaths with strong hysteresis, on a snake that stiffens, rests bent,
//! bears weight and has slack, with a share of its gap that follows nothing here. They are simulated by code of this file alone, which has
//! other equations than the library's effects, and judged on directions and amplitudes that were not fitted.
//!
//! ```sh
//! MACHINES_SEEDS=5 cargo test --release --no-default-features --features cli --test library machines -- --ignored --nocapture
//! ```

use crate::real::missed_deg;
use nalgebra::{DMatrix, DVector, Rotation2, Vector2};
use rand::rngs::StdRng;
use rand::{RngExt, SeedableRng};
use rand_distr::StandardNormal;
use rayon::prelude::*;
use snakeloop::discover::{Data, Discovery, discover, propose_law};
use snakeloop::geometry::Configuration;
use snakeloop::observation::{EncoderReading, Measured, Measurement, Status};
use snakeloop::robot::parameters::{ActuationLine, Tube};
use snakeloop::robot::{Body, Friction, Model, PerBackbone, Robot};
use std::f64::consts::{PI, TAU};

/// Steps of the simulation between two rows.
const STEPS: usize = 12;

/// The circle of the tendons.
const RADIUS_MM: f64 = 4.5;

/// How a tendon holds in its sheath. Widths and travels in mm.
#[derive(Debug, Clone)]
enum Sheath {
    /// Play that grows with the pull.
    Loaded { half: f64, by_pull: f64 },
    /// Bouc–Wen with an exponent and β other than γ.
    BoucWen { half: f64, travel: f64, exponent: f64, beta: f64 },
    /// Dahl's friction with an exponent.
    Dahl { half: f64, travel: f64, exponent: f64 },
    /// Plays of widths from a thirtieth of the travel to its half, spread in their logarithm.
    Broad { half: f64 },
    /// Play that is wider where the tendon is let out than where it is pulled.
    Asymmetric { pulled: f64, let_out: f64 },
}

/// Where a tendon stands in its sheath.
#[derive(Debug, Clone, Default)]
struct State {
    last: f64,
    at: f64,
    plays: Vec<f64>,
}

impl Sheath {
    /// What comes out at the far end once the near end is at q, mm.
    fn out(&self, state: &mut State, q: f64) -> f64 {
        let moved = q - state.last;
        state.last = q;
        match *self {
            Self::Loaded { half, by_pull } => {
                let half = half + by_pull * (-q).max(0.0);
                state.at = state.at.clamp(q - half, q + half);
                state.at
            }
            Self::BoucWen { half, travel, exponent, beta } => {
                let z = state.at;
                let held = beta * (moved * z).signum() + (1.0 - beta);
                state.at += moved / travel * (1.0 - held * z.abs().powf(exponent));
                q - half * state.at
            }
            Self::Dahl { half, travel, exponent } => {
                let left = 1.0 - state.at * moved.signum();
                state.at += moved / travel * left.max(0.0).powf(exponent);
                q - half * state.at
            }
            Self::Broad { half } => {
                let widths = (0..10).map(|j| 0.15 * 1.35f64.powi(j));
                state.plays.resize(10, 0.0);
                let stands = state.plays.iter_mut().zip(widths).map(|(at, half)| {
                    *at = at.clamp(q - half, q + half);
                    (q - *at) / half
                });
                q - half * stands.sum::<f64>() / 10.0
            }
            Self::Asymmetric { pulled, let_out } => {
                // Pulling is going down; each way has an envelope with a slope of its own.
                let (down, up) = (q + pulled * (1.0 + 0.1 * q.abs()), q - let_out);
                state.at = state.at.clamp(up.min(down), up.max(down));
                state.at
            }
        }
    }
}

/// A robot with three tendons.
#[derive(Debug, Clone)]
struct Machine {
    sheaths: [Sheath; 3],
    /// How far the lines give way, as a share of the bend, and how much more by its square.
    compliance: f64,
    cubic: f64,
    rest: Vector2<f64>,
    weight: Vector2<f64>,
    slack: [f64; 3],
    /// Waves of the bend and of the row that stand in no library: direction, wave vector, per row, phase.
    waves: Vec<(Vector2<f64>, Vector2<f64>, f64, f64)>,
    /// Their size, rad.
    unknown: f64,
}

const KINDS: [&str; 6] = ["loaded play", "bouc-wen", "dahl", "broad plays", "asymmetric", "several"];

fn vector(random: &mut StdRng, length: f64) -> Vector2<f64> {
    Rotation2::new(random.random_range(-PI..PI)) * Vector2::new(length, 0.0)
}

impl Machine {
    fn drawn(kind: usize, random: &mut StdRng) -> Self {
        let half = random.random_range(0.25..0.8);
        let own = |random: &mut StdRng| half * random.random_range(0.8..1.25);
        let mut sheath = || match kind {
            0 | 5 => Sheath::Loaded { half: 0.3 * own(random), by_pull: random.random_range(0.05..0.15) },
            1 => Sheath::BoucWen { half: own(random), travel: 0.5, exponent: 1.5, beta: 0.65 },
            2 => Sheath::Dahl { half: own(random), travel: 0.7, exponent: 0.8 },
            3 => Sheath::Broad { half: 1.4 * own(random) },
            _ => Sheath::Asymmetric { pulled: own(random), let_out: 0.5 * own(random) },
        };
        let sheaths = [sheath(), sheath(), sheath()];
        let has_cubic = [0, 2, 3, 5].contains(&kind);
        let has_load = [1, 4, 5].contains(&kind);
        let slack = if [2, 5].contains(&kind) { random.random_range(0.1..0.4) } else { 0.0 };
        let slacks = [slack, 0.2 * slack, 0.0];
        let wave = |random: &mut StdRng| {
            (vector(random, 1.0), vector(random, 3.0), random.random_range(0.02..0.2), random.random_range(0.0..TAU))
        };
        Self {
            sheaths,
            compliance: random.random_range(0.1..0.5),
            cubic: if has_cubic { random.random_range(0.1..0.6) } else { 0.0 },
            rest: {
                let size = random.random_range(0.0..0.12);
                vector(random, size)
            },
            weight: {
                let size = if has_load { random.random_range(0.05..0.3) } else { 0.0 };
                vector(random, size)
            },
            slack: slacks,
            waves: (0..4).map(|_| wave(random)).collect(),
            unknown: 0.0,
        }
    }

    /// The bends along commanded bends, of which each is reached in steps.
    fn bends(&self, commands: &[Vector2<f64>]) -> Vec<Vector2<f64>> {
        let mut states: [State; 3] = Default::default();
        let mut bend = self.rest;
        let mut from = Vector2::zeros();
        let mut bends = Vec::new();
        for (row, to) in commands.iter().enumerate() {
            for step in 1..=STEPS {
                let command = from + (to - from) * (step as f64 / STEPS as f64);
                let out: Vec<f64> = (0..3)
                    .map(|i| {
                        let q = tendon(command, i);
                        let q = q.max(0.0) - (-q - self.slack[i]).max(0.0);
                        self.sheaths[i].out(&mut states[i], q)
                    })
                    .collect();
                bend = self.at_rest_with(bend_of(&out), bend);
            }
            from = *to;
            let unknown: Vector2<f64> = self
                .waves
                .iter()
                .map(|(along, wave, per_row, phase)| along * (wave.dot(&bend) + per_row * row as f64 + phase).sin())
                .sum();
            bends.push(bend + unknown * self.unknown);
        }
        bends
    }

    /// Where the snake rests under what comes out of the sheaths.
    fn at_rest_with(&self, out: Vector2<f64>, mut bend: Vector2<f64>) -> Vector2<f64> {
        for _ in 0..40 {
            let strain = bend - self.rest;
            let give = self.compliance * (1.0 + self.cubic * strain.norm_squared());
            let load = self.weight * (0.5 * bend.norm()).cos();
            let next = (out + self.rest * (1.0 + give) + load) / (1.0 + give);
            bend = 0.5 * (bend + next);
        }
        bend
    }
}

fn azimuth(i: usize) -> f64 {
    -TAU / 3.0 * i as f64
}

fn tendon(bend: Vector2<f64>, i: usize) -> f64 {
    -RADIUS_MM * (bend.x * azimuth(i).cos() + bend.y * azimuth(i).sin())
}

fn bend_of(tendons: &[f64]) -> Vector2<f64> {
    let along = |i: usize| Vector2::new(azimuth(i).cos(), azimuth(i).sin());
    tendons.iter().enumerate().map(|(i, q)| along(i) * (-q * 2.0 / (3.0 * RADIUS_MM))).sum()
}

/// Out and back in some directions, then perhaps a circle.
fn ride(directions: &[f64], amplitude: f64, rows: usize, circle: bool) -> Vec<Vector2<f64>> {
    let at = |direction: f64, size: f64| Vector2::new(direction.cos(), direction.sin()) * size;
    let mut commands = Vec::new();
    for direction in directions {
        commands.extend((0..rows).map(|k| at(*direction, amplitude * k as f64 / (rows - 1) as f64)));
        commands.extend((0..rows - 1).rev().map(|k| at(*direction, amplitude * k as f64 / (rows - 1) as f64)));
    }
    if circle {
        commands.extend((0..2 * rows).map(|k| at(TAU * k as f64 / (2 * rows - 1) as f64, 0.7 * amplitude)));
    }
    commands
}

/// What was commanded and measured along a ride.
struct Log {
    commands: Vec<Vector2<f64>>,
    bends: Vec<Vector2<f64>>,
    measurements: Vec<Measurement>,
    readings: Vec<EncoderReading>,
}

impl Log {
    fn new(machine: &Machine, commands: Vec<Vector2<f64>>, random: &mut StdRng) -> Self {
        let sigma = 0.1f64.to_radians();
        let mut noise = |size: f64| size * random.sample::<f64, _>(StandardNormal);
        let bends: Vec<Vector2<f64>> =
            machine.bends(&commands).into_iter().map(|bend| bend + Vector2::new(noise(sigma), noise(sigma))).collect();
        let mut read = |command: &Vector2<f64>| PerBackbone::from_fn(3, |i| tendon(*command, i) + noise(0.004));
        let readings = commands.iter().enumerate();
        let readings =
            readings.map(|(k, command)| EncoderReading::new(k as u64, 0.5 * k as f64, read(command))).collect();
        let measurements = bends.iter().enumerate().map(|(k, bend)| {
            let configuration = Configuration::from_bend_vector(*bend);
            let sigma_delta = (sigma / bend.norm().max(0.02)).min(1.8);
            Measurement {
                index: k as u64,
                time_s: Some(0.5 * k as f64),
                status: Status::Ok,
                measured: Some(Measured::independent(configuration, sigma, sigma_delta, 0.0)),
                quality: None,
                view: None,
            }
        });
        let measurements = measurements.collect();
        Self { commands, bends, measurements, readings }
    }

    /// Plays of all tendons, of this half width, in units of the bend.
    fn play(&self, half: f64) -> Vec<Vector2<f64>> {
        let mut stands = [0.0f64; 3];
        let at = |command: &Vector2<f64>| {
            for (i, at) in stands.iter_mut().enumerate() {
                let q = tendon(*command, i);
                *at = at.clamp(q - half, q + half);
            }
            bend_of(&stands)
        };
        self.commands.iter().map(at).collect()
    }

    /// Rows of a linear model of both components of the bend: a gain and a turn, and what else is asked for.
    fn design(&self, has_rest: bool, half: Option<f64>, has_cubic: bool) -> DMatrix<f64> {
        let play = half.map(|half| self.play(half));
        let columns = |k: usize| {
            let u = self.commands[k];
            let mut columns = vec![u, Vector2::new(-u.y, u.x)];
            if has_rest {
                columns.extend([Vector2::x(), Vector2::y()]);
            }
            columns.extend(play.iter().map(|play| play[k]));
            if has_cubic {
                columns.push(u * u.norm_squared());
            }
            columns
        };
        let count = columns(0).len();
        let rows: Vec<Vec<Vector2<f64>>> = (0..self.commands.len()).map(columns).collect();
        DMatrix::from_fn(2 * rows.len(), count, |row, c| rows[row / 2][c][row % 2])
    }

    fn target(&self) -> DVector<f64> {
        DVector::from_iterator(2 * self.bends.len(), self.bends.iter().flat_map(|bend| [bend.x, bend.y]))
    }
}

/// What a linear fit to one log misses of another, degrees, and of its own.
fn plain(train: &Log, val: &Log, (has_rest, half, has_cubic): (bool, Option<f64>, bool)) -> [f64; 2] {
    let [design, other] = [train, val].map(|log| log.design(has_rest, half, has_cubic));
    let fit = design.clone().svd(true, true).solve(&train.target(), 1e-9).expect("a solution");
    let rms = |design: &DMatrix<f64>, log: &Log| {
        ((log.target() - design * &fit).norm_squared() / log.bends.len() as f64).sqrt().to_degrees()
    };
    [rms(&design, train), rms(&other, val)]
}

/// What plain fits miss of `val`: one gain, with a rest bend, with a play, with play and cubic; widths by what is missed of `train`.
fn ladder(train: &Log, val: &Log) -> [f64; 4] {
    let best = |has_cubic: bool| {
        let widths = (0..24).map(|k| 0.02 * 1.23f64.powi(k));
        let fits = widths.map(|half| plain(train, val, (true, Some(half), has_cubic)));
        fits.min_by(|a, b| a[0].total_cmp(&b[0])).expect("widths")[1]
    };
    [plain(train, val, (false, None, false))[1], plain(train, val, (true, None, false))[1], best(false), best(true)]
}

/// The robot as its makers would describe it: geometry, and a stretch that stands in for all that gives way.
fn given() -> Model {
    let tube = |outer_diameter_mm, inner_diameter_mm, youngs_modulus_gpa| Tube {
        outer_diameter_mm,
        inner_diameter_mm,
        youngs_modulus_gpa,
    };
    let robot = Robot {
        length_mm: 60.0,
        backbone_circle_radius_mm: RADIUS_MM,
        backbones: 3,
        primary: tube(1.0, 0.02, 60.0),
        secondary: tube(0.3, 0.02, 30.0),
        line: ActuationLine {
            holder_length_mm: 200.0,
            cone_bend_radius_mm: 1.0,
            cone_bend_angle_deg: 1.0,
            cone_straight_mm: 0.0,
        },
        body: Body {
            disk_diameter_mm: 11.0,
            disk_thickness_mm: 1.0,
            spacer_disk_count: 6,
            disk_positions_mm: None,
            tool: None,
        },
    };
    let friction = Friction { mu: 0.1, static_force_n: 0.0, ..Friction::default() };
    Model { robot, friction, ..Model::default() }
}

/// A machine of a kind with its two logs.
fn machine(kind: usize, seed: u64) -> [Log; 2] {
    let mut random = StdRng::seed_from_u64(100 * seed + kind as u64);
    let mut machine = Machine::drawn(kind, &mut random);
    let amplitude = random.random_range(0.9..1.5);
    let rows = random.random_range(12..22);
    let first = random.random_range(0.0..TAU);
    let directions = |count: usize, offset: f64| -> Vec<f64> {
        (0..count).map(|k| first + offset + TAU * k as f64 / count as f64).collect()
    };
    let (count, circle) = if seed.is_multiple_of(2) { (3, true) } else { (4, seed % 4 == 1) };
    let train = ride(&directions(count, 0.0), amplitude, rows, circle);
    let mut val = ride(&directions(count, PI / count as f64), amplitude * 0.8, rows - 3, false);
    val.extend(ride(&directions(count, 0.3)[..2], amplitude * 0.5, rows / 2, false));
    // Five hundredths of the gap of one gain follow nothing that is known.
    let exact = Log::new(&machine, train.clone(), &mut random);
    machine.unknown = 0.05 * plain(&exact, &exact, (false, None, false))[0].to_radians() / 2f64.sqrt();
    [train, val].map(|commands| Log::new(&machine, commands, &mut random))
}

struct Outcome {
    ladder: [f64; 4],
    found: Discovery,
    missed: f64,
    by_law: f64,
}

impl Outcome {
    fn new(kind: usize, seed: u64) -> Self {
        let [train, val] = machine(kind, seed);
        let data = Data::new(&train.measurements, &train.readings, 0.0015).expect("enough samples");
        let found = discover(&given(), &data);
        let law = propose_law(&found, &data);
        let on_val = |model: &Model| missed_deg(model, &(val.measurements.clone(), val.readings.clone()));
        let missed = on_val(&found.model);
        let by_law = law.model.as_ref().map_or(missed, on_val);
        Self { ladder: ladder(&train, &val), found, missed, by_law }
    }

    /// The share of what can be gained.
    fn share(&self, missed: f64) -> f64 {
        let best = self.ladder.iter().copied().fold(f64::INFINITY, f64::min);
        (self.ladder[0] - missed) / (self.ladder[0] - best)
    }

    fn show(&self, title: &str) {
        let [gain, rest, play, cubic] = self.ladder;
        let names: Vec<String> =
            self.found.named.iter().map(|named| format!("{} {:.2}", named.physics.name, named.removes)).collect();
        println!(
            "{title:12} {:11} gain {gain:5.2} rest {rest:5.2} play {play:5.2} cubic {cubic:5.2} | {:5.2} share {:.2} law {:.2} {names:?}",
            self.found.verdict.word(),
            self.missed,
            self.share(self.missed),
            self.share(self.by_law),
        );
    }
}

/// The mean share that is asked of the survey, and the least of a single machine in the suite.
const LEAST_MEAN: f64 = 0.8;
const LEAST_SHARE: f64 = 0.6;

/// A machine with play that grows with the load and one with several effects: before the discrepancy was learned anew, both were
/// `unexplained`.
#[test]
fn two_machines_gain_as_plain_fits_do() {
    let shares: Vec<f64> =
        [0, 5].into_par_iter().map(|kind| Outcome::new(kind, 0)).map(|o| o.share(o.missed)).collect();
    assert!(shares.iter().all(|share| *share > LEAST_SHARE), "{shares:?}");
}

/// Of each kind the share of what can be gained by plain fits, from one gain to the best of them, on what was not fitted.
/// MACHINES_FIRST is the first seed; seeds 0 and 1 were developed on.
#[test]
#[ignore = "a survey of minutes"]
fn machines_that_lie_in_no_library_gain_as_plain_fits_do() {
    let number = |name: &str, usual: u64| std::env::var(name).ok().and_then(|text| text.parse().ok()).unwrap_or(usual);
    let (first, seeds) = (number("MACHINES_FIRST", 40), number("MACHINES_SEEDS", 4));
    let mut all = Vec::new();
    for (kind, title) in KINDS.iter().enumerate() {
        let outcomes: Vec<Outcome> =
            (first..first + seeds).into_par_iter().map(|seed| Outcome::new(kind, seed)).collect();
        outcomes.iter().for_each(|outcome| outcome.show(title));
        all.extend(outcomes.iter().map(|outcome| outcome.share(outcome.missed)));
    }
    let mean = all.iter().sum::<f64>() / all.len() as f64;
    println!("mean {mean:.2}, least {:.2}", all.iter().copied().fold(f64::INFINITY, f64::min));
    assert!(mean >= LEAST_MEAN, "{mean}");
}
