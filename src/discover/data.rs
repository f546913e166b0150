//! The samples that the search works on: each an encoder reading and the measurement of the frame of the same index. The readings
//! between them, whose frames gave no angles, are kept as well: they drive whatever has a memory.

use super::{clock, sweeps};
use crate::error::{DataError, Result};
use crate::estimate::with_sigmas;
use crate::observation::{EncoderReading, Measured, Measurement, Status};
use crate::robot::{COUPLINGS, DRIVE, LIBRARY, MAX_THETA, Model, NEIGHBOURS, Neighbours, PerBackbone, Physics};
use std::borrow::Cow;
use std::collections::{BTreeMap, BTreeSet, HashMap};

/// The fewest samples that are searched.
///
/// Convention: thirty residuals beside η and λ. The criteria for an effect grow with what noise alone can do on so few, so that few samples name
/// less.
pub const LEAST_SAMPLES: usize = 10;

/// Encoders that all move by less than this are refused, mm.
///
/// Derived: 0.02 mm is less than 1° of bend (r · 1° = 0.026 mm).
const LEAST_TRAVEL_MM: f64 = 0.02;

/// Readings that follow each other are told apart where a backbone moved by this between them, mm.
///
/// Derived: five standard deviations of the difference of two readings of 0.0015 mm. A picture of the same pose again repeats the errors of the
/// one before.
const LEAST_STEP_MM: f64 = 0.01;

/// The travel whose readings tell what memory the snake has of its path, mm.
///
/// Derived: about four times 2.4 mm, which a backbone travels as θ goes from 0 to 90°: there and back twice, so that the last reversals of
/// each are among them.
const REMEMBERED_MM: f64 = 10.0;

/// A backbone has turned between two samples where a reading lies beyond both by more than this many standard deviations.
///
/// Convention: what lies nearer may be noise.
const TURNED_SDS: f64 = 3.0;

/// Where no bend is larger than this, degrees, a remark says that loads can hardly be seen.
///
/// Convention: decides about a remark only.
const SMALL_BENDS_DEG: f64 = 12.0;

/// Bends whose spread across their main plane is below this share of the spread within it are called coplanar.
///
/// Convention: 0.1 is 6°; decides about a remark and a question of `--next`.
const COPLANAR_SHARE: f64 = 0.1;

/// The usable samples of an experiment, in the order of the measurements.
#[derive(Debug, Clone)]
pub struct Data {
    /// Index of each sample.
    pub indices: Vec<u64>,
    /// Time, s.
    pub times_s: Vec<f64>,
    /// q̃, mm.
    pub q_mm: Vec<PerBackbone>,
    /// The measured θ and δ with their covariance.
    pub measured: Vec<Measured>,
    /// The sweep that each sample belongs to, counted from 0.
    pub sweeps: Vec<usize>,
    /// All readings, also those without a measurement.
    pub log: Log,
    /// Standard deviation of an encoder reading, mm.
    pub sd_encoder_mm: f64,
    /// The effects that are looked for: those of the library, and a user's own.
    pub library: Vec<&'static Physics>,
    /// Whether all bends lie in one plane.
    pub one_plane: bool,
    /// Whether actuators were driven to positions that the model as given commands: of what an effect does, the part that bends nothing is then taken up
    /// in forces, and the readings do not show it.
    pub is_driven: bool,
    /// What was passed over or cannot be decided, in sentences.
    pub remarks: Vec<String>,
}

/// Every usable encoder reading up to the last sample, in the order of the indices.
#[derive(Debug, Clone)]
pub struct Log {
    /// Time of each reading, s.
    pub times_s: Vec<f64>,
    /// q̃ of each reading, mm.
    pub q_mm: Vec<PerBackbone>,
    /// What neighbouring sections' encoders read with each; empty where no reading tells.
    pub neighbours: Vec<Neighbours>,
    /// The reading of each sample.
    pub samples: Vec<usize>,
}

impl Log {
    /// The readings up to the last sample, on a clock that rises, and what is to be said of that clock.
    fn new(readings: &BTreeMap<u64, &EncoderReading>, pairs: &[Pair]) -> (Self, Option<String>) {
        let last = pairs.last().map_or(0, |(reading, _)| reading.index);
        let log: Vec<&EncoderReading> = readings.range(..=last).map(|(_, reading)| *reading).collect();
        let (times_s, remark) = clock::checked(&log.iter().map(|reading| reading.time_s).collect::<Vec<_>>());
        let places: HashMap<u64, usize> = log.iter().enumerate().map(|(k, reading)| (reading.index, k)).collect();
        let samples = pairs.iter().filter_map(|(reading, _)| places.get(&reading.index).copied()).collect();
        let any = log.iter().any(|reading| reading.neighbours.count() > 0);
        let neighbours = log.iter().filter(|_| any).map(|reading| reading.neighbours).collect();
        (Self { times_s, q_mm: log.iter().map(|reading| reading.q_mm).collect(), neighbours, samples }, remark)
    }

    /// q̃ of each reading, mm, less what neighbouring sections add by a model.
    pub fn own_q_mm(&self, model: &Model) -> Cow<'_, [PerBackbone]> {
        if self.neighbours.is_empty() || model.neighbours() == 0 {
            return Cow::Borrowed(&self.q_mm);
        }
        let own = |(q_mm, neighbours): (&PerBackbone, &Neighbours)| *q_mm - model.by_neighbours_mm(neighbours);
        Cow::Owned(self.q_mm.iter().zip(&self.neighbours).map(own).collect())
    }

    /// The couplings with neighbouring sections that can be looked for: with those that move.
    fn couplings(&self) -> impl Iterator<Item = &'static Physics> {
        let bends: Vec<_> = self.neighbours.iter().map(Neighbours::bends_mm).collect();
        let moves: [bool; NEIGHBOURS] =
            std::array::from_fn(|k| bends.iter().any(|bend| (bend[k] - bends[0][k]).norm() > LEAST_TRAVEL_MM));
        let can_be = move |physics: &&Physics| {
            physics.follows_neighbour.iter().zip(moves).all(|(follows, moves)| moves || !follows)
        };
        COUPLINGS.into_iter().filter(can_be)
    }
}

/// An encoder reading and what the frame of the same index shows.
type Pair<'a> = (&'a EncoderReading, Measured);

impl Data {
    /// Pairs measurements and readings of the same index.
    ///
    /// # Errors
    /// [`DataError`] for fewer than [`LEAST_SAMPLES`] samples, or encoders that do not move.
    pub fn new(measurements: &[Measurement], readings: &[EncoderReading], sd_encoder_mm: f64) -> Result<Self> {
        let (measurements, without_sigmas) = with_sigmas(measurements, readings);
        let readings = usable(readings);
        let pairs = paired(&measurements, &readings);
        require_motion(&pairs)?;
        let (log, about_times) = Log::new(&readings, &pairs);
        let thetas: Vec<f64> = pairs.iter().map(|(_, measured)| measured.configuration.theta).collect();
        let one_plane = are_coplanar(&pairs);
        let mut remarks: Vec<String> = without_sigmas.into_iter().collect();
        remarks.extend(passed_over(pairs.len(), measurements.len()));
        remarks.extend(about_times);
        remarks.extend(one_plane.then(|| {
            "all bends lie in one plane: effects that differ from one azimuth to another cannot be told apart".into()
        }));
        remarks.extend(about_motion(&pairs, &thetas));
        let library = LIBRARY.into_iter().chain(DRIVE).chain(log.couplings()).collect();
        Ok(Self {
            indices: pairs.iter().map(|(reading, _)| reading.index).collect(),
            times_s: log.samples.iter().map(|&at| log.times_s[at]).collect(),
            q_mm: pairs.iter().map(|(reading, _)| reading.q_mm).collect(),
            measured: pairs.iter().map(|(_, measured)| *measured).collect(),
            sweeps: sweeps::cut(&thetas),
            log,
            sd_encoder_mm,
            library,
            one_plane,
            is_driven: false,
            remarks,
        })
    }

    /// The number of samples.
    pub fn len(&self) -> usize {
        self.times_s.len()
    }

    /// Whether there are none; never, after [`new`](Self::new), but perhaps [since](Self::since).
    pub fn is_empty(&self) -> bool {
        self.times_s.is_empty()
    }

    /// The number of the robot's backbones.
    pub fn backbones(&self) -> usize {
        self.q_mm.first().map_or(0, |q| q.len())
    }

    /// The number of residuals: for each sample two of the bend, and n − 2 of the part of q̃ that no bend changes.
    pub fn residual_count(&self) -> usize {
        self.backbones() * self.len()
    }

    /// The number of sweeps.
    pub fn sweep_count(&self) -> usize {
        self.sweeps.last().map_or(1, |last| last + 1)
    }

    /// Evenly thinned to at most so many samples. Of the readings between them those stay at which a backbone turns: its least and its
    /// largest, if they lie beyond the samples before and after.
    pub fn thinned(&self, most: usize) -> Cow<'_, Self> {
        let stride = self.len().div_ceil(most);
        if stride <= 1 {
            return Cow::Borrowed(self);
        }
        let kept: Vec<usize> = (0..self.len()).step_by(stride).collect();
        let mut places: BTreeSet<usize> = [0].into_iter().chain(kept.iter().map(|&k| self.log.samples[k])).collect();
        let mut first = 0;
        for last in kept.iter().map(|&k| self.log.samples[k]) {
            for i in 0..self.backbones() {
                let q = |at: usize| self.log.q_mm[at][i];
                let by_travel = |a: &usize, b: &usize| q(*a).total_cmp(&q(*b));
                let least = TURNED_SDS * self.sd_encoder_mm;
                let turned = |at: &usize| [first, last].iter().all(|&end| (q(*at) - q(end)).abs() > least);
                places.extend((first..=last).min_by(by_travel).filter(turned));
                places.extend((first..=last).max_by(by_travel).filter(turned));
            }
            first = last;
        }
        let places: Vec<usize> = places.into_iter().collect();
        let log = Log {
            times_s: places.iter().map(|&at| self.log.times_s[at]).collect(),
            q_mm: places.iter().map(|&at| self.log.q_mm[at]).collect(),
            neighbours: places.iter().filter_map(|&at| self.log.neighbours.get(at).copied()).collect(),
            samples: kept.iter().map(|&k| places.partition_point(|&at| at < self.log.samples[k])).collect(),
        };
        let measured: Vec<Measured> = kept.iter().map(|&k| self.measured[k]).collect();
        let thetas: Vec<f64> = measured.iter().map(|measured| measured.configuration.theta).collect();
        Cow::Owned(Self {
            indices: kept.iter().map(|&k| self.indices[k]).collect(),
            times_s: kept.iter().map(|&k| self.times_s[k]).collect(),
            q_mm: kept.iter().map(|&k| self.q_mm[k]).collect(),
            measured,
            sweeps: sweeps::cut(&thetas),
            log,
            ..self.clone()
        })
    }

    /// The samples that came after an index, with the readings that led to them: the first of all, from which drifts count, and those of
    /// the last 10 mm of travel. Readings at which nothing moved since the one before are passed over; it may be that no sample is left.
    pub fn since(&self, index: u64, measurements: &[Measurement], readings: &[EncoderReading]) -> Self {
        let Log { mut times_s, mut q_mm, mut neighbours, .. } = self.log.clone();
        let mut kept = Vec::new();
        let readings = usable(readings);
        for reading in readings.values().filter(|reading| reading.index > index) {
            let moved_mm = q_mm.last().map_or(f64::INFINITY, |last| (reading.q_mm - *last).amax());
            if moved_mm < LEAST_STEP_MM || times_s.last().is_some_and(|last| reading.time_s <= *last) {
                continue;
            }
            kept.push((reading.index, times_s.len()));
            times_s.push(reading.time_s);
            q_mm.push(reading.q_mm);
            neighbours.extend((!self.log.neighbours.is_empty()).then_some(reading.neighbours));
        }
        let places: HashMap<u64, usize> = kept.into_iter().collect();
        let pairs = paired(measurements, &readings);
        let pairs: Vec<(usize, &Pair)> =
            pairs.iter().filter_map(|pair| Some((*places.get(&pair.0.index)?, pair))).collect();
        let first_new = pairs.first().map_or(times_s.len(), |pair| pair.0);
        let mut travel_mm = 0.0;
        let is_remembered = |at: &usize| {
            travel_mm += q_mm.get(at + 1).map_or(0.0, |next| (*next - q_mm[*at]).amax());
            travel_mm < REMEMBERED_MM
        };
        let remembered = (1..first_new).rev().take_while(is_remembered).count();
        let forgotten = 1..first_new - remembered;
        times_s.drain(forgotten.clone());
        q_mm.drain(forgotten.clone());
        if !neighbours.is_empty() {
            neighbours.drain(forgotten.clone());
        }
        let samples = pairs.iter().map(|(at, _)| at - forgotten.len()).collect();
        Self {
            indices: pairs.iter().map(|(_, (reading, _))| reading.index).collect(),
            times_s: pairs.iter().map(|(_, (reading, _))| reading.time_s).collect(),
            q_mm: pairs.iter().map(|(_, (reading, _))| reading.q_mm).collect(),
            measured: pairs.iter().map(|(_, (_, measured))| *measured).collect(),
            sweeps: vec![0; pairs.len()],
            log: Log { times_s, q_mm, neighbours, samples },
            ..self.clone()
        }
    }

    /// The block of each sweep, of as many blocks of about equal length as there are folds: sweeps that follow each other, so that a
    /// block is a part of the experiment as unlike the rest as a new one would be.
    pub fn blocks(&self) -> Vec<usize> {
        let mut middles = vec![(usize::MAX, 0); self.sweep_count()];
        for (k, &sweep) in self.sweeps.iter().enumerate() {
            middles[sweep] = (middles[sweep].0.min(k), k);
        }
        middles.into_iter().map(|(first, last)| (first + last) * sweeps::FOLDS / (2 * self.len())).collect()
    }

    /// The cross-validation fold of sample k: whole sweeps, dealt to the folds in turn.
    pub fn fold(&self, k: usize) -> usize {
        self.sweeps[k] % sweeps::FOLDS
    }
}

/// The readings all of whose numbers are finite, by index.
fn usable(readings: &[EncoderReading]) -> BTreeMap<u64, &EncoderReading> {
    let is_finite = |reading: &&EncoderReading| {
        let mut all = reading.q_mm.iter().chain(reading.neighbours.q_mm.iter().flatten());
        reading.time_s.is_finite() && all.all(|q| q.is_finite())
    };
    readings.iter().filter(is_finite).map(|reading| (reading.index, reading)).collect()
}

/// Every measurement that is `ok`, and all of whose numbers are usable, with the reading of its index; in the order of the indices.
fn paired<'a>(measurements: &[Measurement], readings: &BTreeMap<u64, &'a EncoderReading>) -> Vec<Pair<'a>> {
    let mut pairs: Vec<Pair> = measurements
        .iter()
        .filter(|measurement| measurement.status == Status::Ok)
        .filter_map(|measurement| Some((*readings.get(&measurement.index)?, measurement.measured?)))
        .filter(|(_, measured)| is_usable(measured))
        .collect();
    pairs.sort_by_key(|(reading, _)| reading.index);
    pairs
}

fn is_usable(measured: &Measured) -> bool {
    let Measured { configuration, sigma_theta, sigma_delta, correlation, .. } = *measured;
    [configuration.delta, sigma_theta, sigma_delta].iter().all(|value| value.is_finite())
        && (0.0..=MAX_THETA).contains(&configuration.theta)
        && sigma_theta > 0.0
        && sigma_delta > 0.0
        && correlation.abs() < 1.0
}

fn require_motion(pairs: &[Pair]) -> Result<()> {
    if pairs.len() < LEAST_SAMPLES {
        return Err(DataError::TooFewSamples { found: pairs.len(), needed: LEAST_SAMPLES }.into());
    }
    if (0..pairs[0].0.q_mm.len()).all(|i| travel_mm(pairs, i) < LEAST_TRAVEL_MM) {
        return Err(DataError::Still { least_mm: LEAST_TRAVEL_MM }.into());
    }
    Ok(())
}

/// The range of q̃ of backbone i, mm.
fn travel_mm(pairs: &[Pair], i: usize) -> f64 {
    let values = || pairs.iter().map(|(reading, _)| reading.q_mm[i]);
    values().fold(f64::NEG_INFINITY, f64::max) - values().fold(f64::INFINITY, f64::min)
}

fn passed_over(used: usize, all: usize) -> Option<String> {
    (used < all).then(|| {
        format!(
            "{used} of {all} measurements are used; the others have a status, no angles, or no reading of their index (their readings \
             still tell how the snake moved)"
        )
    })
}

/// Encoders that stand still, and bends too small to show loads.
fn about_motion(pairs: &[Pair], thetas: &[f64]) -> Vec<String> {
    let stuck = (0..pairs[0].0.q_mm.len()).filter(|&i| travel_mm(pairs, i) == 0.0).map(|i| {
        format!("q{}_mm is the same in every reading: its encoder is stuck, or no bend moved its backbone", i + 1)
    });
    let largest_deg = thetas.iter().copied().fold(0.0, f64::max).to_degrees();
    let small = (largest_deg < SMALL_BENDS_DEG).then(|| {
        format!(
            "no bend is above {largest_deg:.1}°: what grows with the bend or the load can hardly be seen; bend further"
        )
    });
    stuck.chain(small).collect()
}

/// Whether all bends lie near one plane through the straight snake.
fn are_coplanar(pairs: &[Pair]) -> bool {
    let scatter: nalgebra::Matrix2<f64> =
        pairs.iter().map(|(_, m)| m.configuration.bend_vector()).map(|bend| bend * bend.transpose()).sum();
    let spread = scatter.symmetric_eigenvalues();
    spread.min() < COPLANAR_SHARE.powi(2) * spread.max()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::discover::sweeps::FOLDS;
    use crate::geometry::Configuration;
    use crate::robot::Model;
    use crate::simulate::{BendingExperiment, Plant, SimulatedEye};

    #[test]
    fn every_fold_holds_whole_sweeps_and_a_third_of_its_share_at_least() {
        let trajectory = BendingExperiment { sweep_poses: 20, ..Default::default() }.waypoints().unwrap();
        let samples = Plant { model: Model::default(), sd_encoder_mm: 0.0015 }.run(&trajectory, 1);
        let readings: Vec<_> = samples.iter().map(|s| s.reading).collect();
        let data = Data::new(&SimulatedEye::default().observe(&samples, 2), &readings, 0.0015).unwrap();
        for fold in 0..FOLDS {
            let size = (0..data.len()).filter(|&k| data.fold(k) == fold).count();
            assert!(size >= data.len() / (3 * FOLDS), "fold {fold}: {size} of {}", data.len());
        }
        assert!(data.remarks.is_empty(), "{:?}", data.remarks);
    }

    /// A reading and a measurement of each index, at (θ, δ) in degrees.
    fn experiment(poses: impl Iterator<Item = (f64, f64)>) -> (Vec<Measurement>, Vec<EncoderReading>) {
        let row = |(index, (theta_deg, delta_deg)): (usize, (f64, f64))| {
            let configuration = Configuration::from_degrees(theta_deg, delta_deg);
            let (index, time_s) = (index as u64, index as f64);
            let measured = Measured::independent(configuration, 0.002, 0.01, 0.0);
            let measurement = Measurement {
                index,
                time_s: Some(time_s),
                status: Status::Ok,
                measured: Some(measured),
                quality: None,
                view: None,
            };
            (measurement, EncoderReading::new(index, time_s, Model::default().command(configuration)))
        };
        poses.enumerate().map(row).unzip()
    }

    #[test]
    fn measurements_with_a_status_or_without_a_reading_are_passed_over() {
        let (mut measurements, mut readings) = experiment((0..60).map(|k| (f64::from(k), 7.0 * f64::from(k))));
        measurements[3].status = Status::NoSnake;
        readings.remove(10);
        readings[20].q_mm[1] = f64::NAN;
        let data = Data::new(&measurements, &readings, 0.0015).unwrap();
        assert_eq!(data.len(), 57);
        assert!([3, 10, 21].iter().all(|index| !data.indices.contains(index)), "{:?}", data.indices);
        assert!(data.remarks[0].starts_with("57 of 60 measurements are used"), "{:?}", data.remarks);
    }

    #[test]
    fn bends_in_one_plane_and_small_ones_are_remarked() {
        let (measurements, readings) = experiment((0..60).map(|k| (f64::from(k), 30.0)));
        assert!(Data::new(&measurements, &readings, 0.0015).unwrap().one_plane);
        let (measurements, readings) = experiment((0..60).map(|k| (0.15 * f64::from(k), 7.0 * f64::from(k))));
        let data = Data::new(&measurements, &readings, 0.0015).unwrap();
        assert!(!data.one_plane && data.remarks.iter().any(|remark| remark.contains("no bend is above 8.8°")));
    }

    #[test]
    fn thinned_data_keep_their_turns() {
        let theta = |k: usize| if (k / 47).is_multiple_of(2) { k % 47 } else { 47 - k % 47 } as f64 + 10.0;
        let (measurements, readings) = experiment((0..470).map(|k| (theta(k), 30.0)));
        let data = Data::new(&measurements, &readings, 0.0015).unwrap();
        let few = data.thinned(50);
        assert_eq!((few.len(), few.indices[1]), (47, 10));
        let ends = |log: &Log| log.q_mm.iter().map(|q| q[0]).fold((0.0f64, 0.0f64), |(a, b), q| (a.min(q), b.max(q)));
        assert_eq!(ends(&few.log), ends(&data.log));
        let turns = |log: &Log| log.q_mm.windows(3).filter(|q| (q[1][0] - q[0][0]) * (q[2][0] - q[1][0]) < 0.0).count();
        assert_eq!(turns(&few.log), turns(&data.log));
        assert!(few.log.samples.iter().zip(&few.q_mm).all(|(&at, q)| few.log.q_mm[at] == *q));
        assert!(few.log.q_mm.len() < data.log.q_mm.len() / 2);
        assert_eq!(data.thinned(470).len(), 470);
    }

    #[test]
    fn too_little_is_refused() {
        let (measurements, readings) = experiment((0..30).map(|_| (40.0, 10.0)));
        let refused =
            |measurements: &[Measurement]| Data::new(measurements, &readings, 0.0015).unwrap_err().to_string();
        assert!(refused(&[]).contains("0 usable samples, and 10"));
        assert!(refused(&measurements).contains("the encoders hardly move (less than 0.02 mm)"));
    }
}
