//! The colours of the grid target.

use super::light::{Radiance, decoded};
use crate::simulate::scene::{Paper, Pattern, Stain};
use nalgebra::Point2;

/// The grid target with its colours in linear light.
pub(super) struct PrintedTarget<'a> {
    paper: &'a Paper,
    bare: Radiance,
    inks: Vec<Radiance>,
    stains: Vec<Radiance>,
    turn: (f64, f64),
}

impl<'a> PrintedTarget<'a> {
    pub fn new(paper: &'a Paper) -> Self {
        let inks = match &paper.pattern {
            Pattern::Blank => Vec::new(),
            Pattern::GraphPaper { lines } => lines.iter().map(|lines| decoded(&lines.colour)).collect(),
            Pattern::Checkerboard { colour, .. } => vec![decoded(colour)],
        };
        let stains = paper.stains.iter().map(|stain| decoded(&stain.colour)).collect();
        Self { paper, bare: decoded(&paper.colour), inks, stains, turn: paper.turn_deg.to_radians().sin_cos() }
    }

    /// The colour at (x_b, z_b).
    pub fn colour_at(&self, point: &Point2<f64>) -> Radiance {
        let mut colour = self.printed_at(point);
        for (stain, tint) in self.paper.stains.iter().zip(&self.stains) {
            let radius = (point - Point2::from(stain.centre_mm)).norm() / stain.radius_mm;
            let strength = ((1.0 - radius) / 0.2).clamp(0.0, 1.0);
            colour.component_mul_assign(&Radiance::repeat(1.0).lerp(tint, strength));
        }
        colour
    }

    /// The colour of all that lies within `reach_mm` of (x_b, z_b), where it has one: bare paper, or a square.
    pub fn even_colour_at(&self, point: &Point2<f64>, reach_mm: f64) -> Option<Radiance> {
        let is_near = |stain: &Stain| (point - Point2::from(stain.centre_mm)).norm() <= stain.radius_mm + reach_mm;
        if self.paper.stains.iter().any(is_near) {
            return None;
        }
        let (x, z) = self.on_paper(point);
        let is_off =
            |pitch_mm: f64, width_mm: f64| off_line(x, pitch_mm).min(off_line(z, pitch_mm)) > width_mm / 2.0 + reach_mm;
        let is_even = match &self.paper.pattern {
            Pattern::Blank => true,
            Pattern::GraphPaper { lines } => lines.iter().all(|lines| is_off(lines.pitch_mm, lines.width_mm)),
            Pattern::Checkerboard { square_mm, .. } => is_off(*square_mm, 0.0),
        };
        is_even.then(|| self.printed_at(point))
    }

    /// Coordinates along the pattern's own directions, mm from its origin.
    fn on_paper(&self, point: &Point2<f64>) -> (f64, f64) {
        let from_origin = point - Point2::from(self.paper.origin_mm);
        let (sin, cos) = self.turn;
        (cos * from_origin.x + sin * from_origin.y, cos * from_origin.y - sin * from_origin.x)
    }

    fn printed_at(&self, point: &Point2<f64>) -> Radiance {
        let (x, z) = self.on_paper(point);
        match &self.paper.pattern {
            Pattern::Blank => self.bare,
            Pattern::GraphPaper { lines } => {
                let ink = lines.iter().zip(&self.inks).rev().find(|(lines, _)| {
                    off_line(x, lines.pitch_mm).min(off_line(z, lines.pitch_mm)) <= lines.width_mm / 2.0
                });
                ink.map_or(self.bare, |(_, ink)| *ink)
            }
            Pattern::Checkerboard { square_mm, .. } => {
                let odd = ((x / square_mm).floor() + (z / square_mm).floor()).rem_euclid(2.0) >= 1.0;
                if odd { self.inks[0] } else { self.bare }
            }
        }
    }
}

/// How far a coordinate is from the nearest of the lines that are a pitch apart.
fn off_line(value: f64, pitch: f64) -> f64 {
    // Truncation by a cast is several times as fast as rounding, and this is the renderer's innermost loop.
    let lines = (value / pitch).abs();
    let beyond = lines - lines as i64 as f64;
    pitch * beyond.min(1.0 - beyond)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::simulate::scene::{Lines, Scene};

    #[test]
    fn what_is_told_to_have_one_colour_has_it_everywhere() {
        let lines = |pitch_mm, width_mm| Lines { pitch_mm, width_mm, colour: [0.0; 3] };
        let patterns = [
            Pattern::Blank,
            Pattern::GraphPaper { lines: vec![lines(1.0, 0.12), lines(5.0, 0.3)] },
            Pattern::Checkerboard { square_mm: 2.0, colour: [20.0; 3] },
        ];
        for pattern in patterns {
            let stains = vec![Stain { centre_mm: [3.0, 4.0], radius_mm: 1.5, colour: [60.0; 3] }];
            let paper = Paper { pattern, stains, turn_deg: 7.0, origin_mm: [0.3, -0.2], ..Scene::default().paper };
            let target = PrintedTarget::new(&paper);
            let mut even = 0;
            for k in 0..3000 {
                // Fermat's spiral fills a disk evenly.
                let (radius, angle) = (0.2 * f64::from(k).sqrt(), 2.399_963 * f64::from(k));
                let point = Point2::new(radius * angle.cos(), radius * angle.sin());
                let reach_mm = 0.02 + 0.15 * f64::from(k % 7) / 7.0;
                let Some(colour) = target.even_colour_at(&point, reach_mm) else { continue };
                even += 1;
                for j in 0..16 {
                    let (sin, cos) = (f64::from(j) * 0.39).sin_cos();
                    let beside = Point2::new(point.x + reach_mm * cos, point.y + reach_mm * sin);
                    assert_eq!(target.colour_at(&beside), colour, "{point} {reach_mm}");
                }
            }
            assert!((1000..3000).contains(&even), "{even}");
        }
    }
}
