//! Leads the samples since a discovery to the bank of its structures, on threads of low priority, and says what becomes of them.

use super::low_priority::on_one_thread;
use super::shared_state::SharedState;
use crate::discover::{Bank, Followed};
use crate::observation::{EncoderReading, Measurement};
use std::collections::VecDeque;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};

/// Samples that are handed to the bank at once.
///
/// Convention: a bound on computing time. The path that leads to them is solved anew for each call, which takes 0.6 ms for five structures
/// on 60 readings, and 12 ms on a thousand.
const AT_ONCE: usize = 10;

/// Samples that wait at most, while a search is at work or the machine is busy; the oldest are dropped then.
///
/// Convention: a resource limit, a minute of 30 frames/s.
const MOST_WAITING: usize = 1800;

/// A structure that is less probable is not named in the sentence.
///
/// Convention: a display choice.
const LEAST_SAID: f64 = 0.01;

/// The bank of the latest discovery, where it left anything to follow.
pub type SharedBank = Arc<Mutex<Option<Bank>>>;

/// Feeds the bank.
#[derive(Debug)]
pub struct BankWorker {
    shared: Arc<SharedState>,
    bank: SharedBank,
    waiting: VecDeque<(Measurement, EncoderReading)>,
    /// Whether a thread feeds the bank: one at a time, since samples go there in order.
    at_work: Arc<AtomicBool>,
    /// Whether its most probable structure accounts for the samples, when it was last asked.
    accounts: bool,
}

impl BankWorker {
    /// A worker without a bank, until a discovery puts one there.
    pub fn new(shared: Arc<SharedState>) -> Self {
        Self { shared, bank: Arc::default(), waiting: VecDeque::new(), at_work: Arc::default(), accounts: false }
    }

    /// Where a discovery puts its bank.
    pub fn bank(&self) -> SharedBank {
        Arc::clone(&self.bank)
    }

    /// Whether the most probable structure of the latest discovery has effects that account for what was measured since.
    pub fn accounts_for_samples(&self) -> bool {
        self.accounts
    }

    /// Takes a sample. Never waits: while the bank is at work, or there is none yet, samples wait.
    pub fn add(&mut self, measurement: &Measurement, reading: &EncoderReading) {
        if self.waiting.len() == MOST_WAITING {
            self.waiting.pop_front();
        }
        self.waiting.push_back((measurement.clone(), *reading));
        let Ok(bank) = self.bank.try_lock() else { return };
        self.accounts = bank.as_ref().is_some_and(Bank::accounts_for_samples);
        if bank.is_none() || self.waiting.len() < AT_ONCE || self.at_work.load(Ordering::Relaxed) {
            return;
        }
        drop(bank);
        let samples: Vec<_> = self.waiting.drain(..).collect();
        self.at_work.store(true, Ordering::Relaxed);
        let (shared, bank, at_work) = (Arc::clone(&self.shared), self.bank(), Arc::clone(&self.at_work));
        std::thread::spawn(move || {
            on_one_thread(|| follow(&shared, &bank, &samples));
            at_work.store(false, Ordering::Relaxed);
        });
    }

    /// Forgets the bank and what waits for it.
    pub fn forget(&mut self) {
        self.waiting.clear();
        *self.bank.lock().unwrap_or_else(PoisonError::into_inner) = None;
        self.accounts = false;
    }
}

/// Hands samples to the bank, and shows what it says.
fn follow(shared: &SharedState, bank: &SharedBank, samples: &[(Measurement, EncoderReading)]) {
    let mut bank = bank.lock().unwrap_or_else(PoisonError::into_inner);
    let Some(bank) = bank.as_mut() else { return };
    let mut moved = Vec::new();
    for samples in samples.chunks(AT_ONCE) {
        let (measurements, readings): (Vec<_>, Vec<_>) = samples.iter().cloned().unzip();
        moved.extend(bank.add(&measurements, &readings));
    }
    let mut shared = shared.lock();
    moved.iter().for_each(|moved| shared.notice(moved.to_string()));
    if let Some(discovery) = &mut shared.state.discovery {
        discovery.structures = bank.structures();
        discovery.followed = Some(sentence(&discovery.structures, bank.index()));
    }
}

/// How probable the structures are.
pub fn sentence(structures: &[Followed], index: u64) -> String {
    let said = structures.iter().filter(|structure| structure.probability >= LEAST_SAID).map(|structure| {
        let effects = if structure.effects.is_empty() {
            "no further effect".to_owned()
        } else {
            structure.effects.join(" with ")
        };
        format!("{effects} {:.1} %", 100.0 * structure.probability)
    });
    format!("{}, as of frame {index}", said.collect::<Vec<_>>().join(", "))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::live::discovery_worker::DiscoveryWorker;
    use crate::live::publication::{POSES, PublicationGate};
    use crate::live::status::{EncoderStatus, State};
    use crate::robot::{Effect, Model};
    use crate::simulate::{BendingExperiment, Plant, SimulatedEye};
    use std::time::{Duration, Instant};

    #[test]
    fn what_a_discovery_names_is_followed_by_the_samples_after_it() {
        let effects = vec![Effect::parse("load_directed_backlash:play_mm=0.08").unwrap()];
        let plant = Model { effects, eta: 1.221, lambda_mm: 0.1765, samples: Some(0), ..Model::default() };
        let experiment = BendingExperiment { sweep_poses: 30, jitter_deg: 2.0, ..Default::default() };
        let samples = Plant { model: plant, sd_encoder_mm: 0.0015 }.run(&experiment.waypoints().unwrap(), 1);
        let measurements = SimulatedEye::default().observe(&samples, 2);
        let readings: Vec<_> = samples.iter().map(|sample| sample.reading).collect();

        let state = State::at_start("camera 0".into(), EncoderStatus::at_rest("none", 0));
        let gate = PublicationGate::new(0.0015, POSES, None);
        let shared = Arc::new(SharedState::new(state, Model::default(), gate));
        let folder = tempfile::tempdir().unwrap();
        let mut worker = BankWorker::new(Arc::clone(&shared));
        let output = folder.path().to_owned();
        let mut discovery = DiscoveryWorker::new(Arc::clone(&shared), output, 0.0015, worker.bank());
        let wait_until = |is_done: &dyn Fn(&State) -> bool| {
            let began = Instant::now();
            while !is_done(&shared.state()) && began.elapsed() < Duration::from_secs(60) {
                std::thread::sleep(Duration::from_millis(10));
            }
            shared.state().discovery.unwrap()
        };

        discovery.start((Model::default(), measurements[..100].to_vec(), readings[..100].to_vec()));
        let before = wait_until(&|state| state.discovery.as_ref().is_some_and(|discovery| !discovery.running));
        assert!(
            before.verdict == "named" && before.followed.as_ref().unwrap().ends_with("as of frame 99"),
            "{before:?}"
        );
        let is_as_of = |state: &State, index: usize| {
            let followed = state.discovery.as_ref().and_then(|discovery| discovery.followed.as_ref());
            followed.is_some_and(|text| text.ends_with(&format!("as of frame {index}")))
        };
        let mut after = before;
        for k in 100..100 + 2 * AT_ONCE {
            worker.add(&measurements[k], &readings[k]);
            if (k + 1) % AT_ONCE == 0 {
                after = wait_until(&|state| is_as_of(state, k) && !worker.at_work.load(Ordering::Relaxed));
            }
        }
        assert!(is_as_of(&shared.state(), 119), "{after:?}");
        let most_probable = &after.structures[0];
        assert!(most_probable.probability > 0.9, "{after:?}");
        assert_eq!(most_probable.effects, ["load_directed_backlash"]);
        let play = most_probable.parameters["load_directed_backlash.play_mm"];
        assert!((play.value - 0.08).abs() < 4.0 * play.sd, "{play:?}");
        assert!(most_probable.parameters.keys().all(|name| !name.starts_with("rig_error")), "{most_probable:?}");
        worker.add(&measurements[120], &readings[120]);
        assert!(worker.accounts_for_samples());
        worker.forget();
        assert!(worker.bank().lock().unwrap().is_none() && !worker.accounts_for_samples());
    }
}
