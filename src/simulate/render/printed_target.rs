//! The colours of the grid target.

use super::light::{Radiance, decoded};
use crate::simulate::scene::{Paper, Pattern};
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

    fn printed_at(&self, point: &Point2<f64>) -> Radiance {
        let from_origin = point - Point2::from(self.paper.origin_mm);
        let (sin, cos) = self.turn;
        let (x, z) = (cos * from_origin.x + sin * from_origin.y, cos * from_origin.y - sin * from_origin.x);
        match &self.paper.pattern {
            Pattern::Blank => self.bare,
            Pattern::GraphPaper { lines } => {
                // Truncation by a cast is several times as fast as rounding, and this is the renderer's innermost loop.
                let off_line = |value: f64, pitch: f64| {
                    let lines = (value / pitch).abs();
                    let beyond = lines - lines as i64 as f64;
                    pitch * beyond.min(1.0 - beyond)
                };
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
