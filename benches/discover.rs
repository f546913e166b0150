//! What `discover` costs as samples grow: `cargo bench --no-default-features --bench discover`.
//!
//! The counter's items are n log₂ n: a rate that does not fall from line to line is a cost that grows no faster than that.

use divan::Bencher;
use divan::counter::ItemsCount;
use snakeloop::discover::{Data, discover};
use snakeloop::robot::{Model, effects::physics};
use snakeloop::simulate::Sealed;

fn main() {
    divan::main();
}

#[divan::bench(args = [320, 1_000, 3_200, 10_000, 32_000, 100_000], sample_count = 1, sample_size = 1)]
fn discover_an_effect_in_samples(bencher: Bencher, n: usize) {
    let hidden = physics("load_directed_backlash").unwrap();
    // Nine tenths of the poses on the way up and down four sweeps, the others in the round.
    let sealed = Sealed::of_poses(&[hidden], 5, n * 9 / 80, n / 10).unwrap();
    let data = Data::new(&sealed.measurements, &sealed.readings, 0.0015).unwrap();
    let n = data.len() as f64;
    bencher.counter(ItemsCount::new((n * n.log2()) as usize)).bench_local(|| discover(&Model::default(), &data));
}
