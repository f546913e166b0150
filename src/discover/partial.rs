//! A partial answer: effects that help, where what is left is more than noise.
//!
//! A real machine never lies wholly in a library. The [search](super::search) is then made beside a discrepancy.

use super::fit::Fit;
use super::noise::Noise;
use super::predictive_density::Beside;
use super::residuals::Problem;
use super::search::{Named, search};
use super::start::unknown_start;
use super::structure::mean_square_quantile;
use crate::discover::data::Data;
use crate::robot::Model;
use crate::statistics::moments::{mean, rms};
use nalgebra::Vector2;

/// Effects are only looked for where the model as given misses this share of the bends (rms). Where it is nearer, what the library
/// lacks is imitated by effects that are not there: on sealed experiments 9000 and 9001 with a slip or a pull, in four of six.
///
/// Convention: 0.06 is 1° of 16°.
const LEAST_GAP: f64 = 0.06;

/// A partial answer.
#[derive(Debug, Clone)]
pub struct Partial<'a> {
    /// The samples, whitened by noise and discrepancy.
    pub problem: Problem<'a>,
    /// The model as given, with η and λ at their best.
    pub before: Fit,
    /// The model with the effects.
    pub after: Fit,
    /// The effects, in the order of the model's.
    pub named: Vec<Named>,
}

impl<'a> Partial<'a> {
    /// Of the samples under their noise; `before` is the fit of the model as given.
    pub fn new(problem: &Problem<'a>, before: &Fit) -> Self {
        let (mut problem, mut before) = (problem.clone(), before.clone());
        let unknown_start = unknown_start(&problem, &before);
        // The weights follow from the discrepancy, and the discrepancy from the fit.
        for _ in 0..2 {
            let noise = Noise { unknown_start, ..problem.noise }.with_discrepancy(&problem, &before);
            problem = Problem::new(problem.data, &noise, &before.model);
            before = problem.fit(&before.model, None, None);
        }
        let nothing = Self { problem, after: before.clone(), before, named: Vec::new() };
        if nothing.is_near_or_still() {
            return nothing;
        }
        let found = search(&nothing.problem, &nothing.before, Beside::Discrepancy);
        let before = found.problem.fit(&nothing.before.model, Some(&nothing.before.path), None);
        Self { problem: found.problem, before, after: found.fit, named: found.named }
    }

    /// Whether there is no gap to speak of, or a picture that stands still, which tells nothing of a snake that should have moved.
    fn is_near_or_still(&self) -> bool {
        let known = self.problem.data.measured.iter().skip(self.problem.noise.unknown_start);
        let bends: Vec<Vector2<f64>> = known.map(|m| m.configuration.bend_vector()).collect();
        let gap = (bend_squares(&self.problem, &self.before) / bends.len() as f64).sqrt();
        let middle = bends.iter().sum::<Vector2<f64>>() / bends.len().max(1) as f64;
        let still = 2.0 * self.problem.bend_noise_rad2() * mean_square_quantile(2.0 * bends.len() as f64);
        gap < LEAST_GAP * rms(bends.iter().map(|bend| bend.norm()))
            || mean(bends.iter().map(|bend| (bend - middle).norm_squared())) <= still
    }

    /// The same answer fitted to all samples, of which its own were a part.
    pub fn of<'b>(&self, data: &'b Data) -> Partial<'b> {
        let stride = data.len().div_ceil(self.problem.data.len());
        let noise = Noise { unknown_start: self.problem.noise.unknown_start * stride, ..self.problem.noise };
        let problem = Problem::new(data, &noise, &self.before.model);
        let [before, after] = [&self.before, &self.after].map(|fit| problem.fit(&fit.model, None, None));
        Partial { problem, before, after, named: self.named.clone() }
    }

    /// The model of one of its fits, with a covariance that contains the discrepancy as it hangs together within sweeps.
    pub fn model(&self, fit: &Fit) -> Model {
        let left = self.problem.noise.with_discrepancy(&self.problem, fit);
        let problem = Problem::new(self.problem.data, &left, &fit.model);
        problem.with_clustered_covariance(&problem.fit(&fit.model, Some(&fit.path), None))
    }
}

/// What a fit leaves of the bend, rad².
fn bend_squares(problem: &Problem, fit: &Fit) -> f64 {
    let known = problem.noise.unknown_start..problem.data.len();
    known.map(|k| problem.bend_gap(&fit.residuals, k).norm_squared()).sum()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::discover::fixture::{experiment, truth};
    use crate::geometry::Configuration;

    #[test]
    fn a_picture_stands_still_where_it_shows_no_more_than_noise_move_however_far_off_the_model_is() {
        let is_still = |seen: fn(Vector2<f64>) -> Vector2<f64>| {
            let mut data = experiment(1);
            for measured in &mut data.measured {
                measured.configuration = Configuration::from_bend_vector(seen(measured.configuration.bend_vector()));
            }
            let problem = Problem::new(&data, &Noise::stated(&data), &truth());
            let before = problem.evaluated(&truth(), None);
            Partial { problem, after: before.clone(), before, named: Vec::new() }.is_near_or_still()
        };
        assert!(is_still(|_| Vector2::new(0.5, 0.3)));
        // A tenth of the bends, about another rest: a constant would be nearer to them than the model.
        assert!(!is_still(|bend| bend * 0.1 + Vector2::new(0.5, 0.3)));
    }
}
