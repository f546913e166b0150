//! Things that come one at a time, of which a bounded number is kept, spread evenly over all: every 2ᵏ-th.

/// At most so many things, at even distances among all that came; once there were more, at least half as many.
#[derive(Debug, Clone)]
pub struct Spread<T> {
    most: usize,
    every: usize,
    seen: usize,
    /// Those that are kept, oldest first.
    pub kept: Vec<T>,
}

impl<T> Spread<T> {
    /// Keeps no more than `most`.
    pub fn new(most: usize) -> Self {
        Self { most, every: 1, seen: 0, kept: Vec::new() }
    }

    /// Takes the next thing, or passes over it.
    pub fn add(&mut self, thing: T) {
        if self.seen.is_multiple_of(self.every) {
            self.kept.push(thing);
        }
        self.seen += 1;
        if self.kept.len() > self.most {
            let mut place = 0;
            self.kept.retain(|_| {
                place += 1;
                place % 2 == 1
            });
            self.every *= 2;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_spread_keeps_a_bounded_number_at_even_distances() {
        for count in [0, 5, 10, 11, 1000, 12_345] {
            let mut spread = Spread::new(10);
            (0..count).for_each(|k| spread.add(k));
            assert!(spread.kept.len() <= 10 && spread.kept.len() >= count.min(5), "{count}");
            let steps: Vec<usize> = spread.kept.windows(2).map(|pair| pair[1] - pair[0]).collect();
            assert!(steps.iter().all(|step| *step == spread.every), "{count}: {steps:?}");
        }
    }
}
