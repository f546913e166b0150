//! Correspondences between a model's outline and a picture's edges, and their distances for any other state of the model.

use super::blur::{Blur, Filters};
use super::edges::Edge;
use super::glancing::SeenFace;
use super::noise_model::{Conditions, MODES, edge_floor_px, noise_model, systematic_modes};
use super::state::EdgeBias;
use crate::measure::body::{BodyPoint, Outline, Piece, Projection};
use crate::robot::BendProfile;
use nalgebra::{DVector, Point2, Point3, Vector2};

/// The largest blur that an edge may be given, σ in px: where a picture is flat, the estimate has no bound.
///
/// Convention: a guard, twice the blur from which on a frame is called blurred.
const LARGEST_BLUR_PX: f64 = 10.0;

/// A border point of the model and the edge that was found near it.
#[derive(Debug, Clone, Copy)]
pub(super) struct Correspondence {
    pub body: BodyPoint,
    pub piece: Piece,
    /// See [`OutlinePoint::lateral`](crate::measure::body::OutlinePoint::lateral).
    pub lateral: f64,
    /// Where the edge is, corrected by what blur does to the model's own edge, px.
    pub seen: Point2<f64>,
    /// Outward normal of the border.
    pub normal: Vector2<f64>,
    /// Standard deviation of the edge along the normal, px: of the picture's noise, ...
    pub noise_px: f64,
    /// ... and in all, with what displaces the edge alike in every picture that shows it there.
    pub sigma_px: f64,
    /// The flat face behind it, if there is one.
    pub face: Option<SeenFace>,
}

/// The correspondences of one picture with one outline.
#[derive(Debug, Clone)]
pub(crate) struct Correspondences {
    pub(super) all: Vec<Correspondence>,
    /// The sections (arc lengths, mm) that the points lie on, and the index of each point's section: many points share one, and
    /// computing a section's frame costs the most.
    pub(super) sections_mm: Vec<f64>,
    pub(super) section_of: Vec<usize>,
    /// The outline points that were searched, by their pieces, and the edge found near each.
    searched: Vec<(Piece, Option<Edge>)>,
    /// The blur of the edges.
    pub blur: Blur,
}

impl Correspondences {
    /// Searches an edge within `search_px` of each outline point whose piece is wanted and which is clear of other parts.
    pub fn find(outline: &Outline, filters: &Filters, search_px: f64, is_wanted: impl Fn(Piece) -> bool) -> Self {
        let mut found = Self {
            all: Vec::with_capacity(outline.points.len()),
            sections_mm: Vec::new(),
            section_of: Vec::with_capacity(outline.points.len()),
            searched: Vec::with_capacity(outline.points.len()),
            blur: Blur::uniform(0.0),
        };
        let mut blurs = Vec::with_capacity(outline.points.len());
        let mut points = Vec::with_capacity(outline.points.len());
        for point in outline.points.iter().filter(|p| is_wanted(p.piece)) {
            let finder = filters.at(point.piece);
            if !finder.is_clear(point) || finder.is_hidden(point) {
                continue;
            }
            let edge = finder.find(point, search_px);
            found.searched.push((point.piece, edge));
            let (Some(edge), Some(predicted)) = (edge, point.predicted) else { continue };
            // Points are ordered by section.
            if found.sections_mm.last() != Some(&point.body.s_mm) {
                found.sections_mm.push(point.body.s_mm);
            }
            found.section_of.push(found.sections_mm.len() - 1);
            found.all.push(Correspondence {
                body: point.body,
                piece: point.piece,
                lateral: point.lateral,
                seen: point.pixel + point.normal.into_inner() * (edge.offset_px - predicted.offset_px),
                normal: point.normal.into_inner(),
                noise_px: edge.sigma_px,
                sigma_px: edge.sigma_px,
                face: None,
            });
            points.push(point);
            blurs.push((point.piece, (edge.blur_px / predicted.blur_ratio).min(LARGEST_BLUR_PX) as f32));
        }
        found.blur = Blur::of(&blurs);
        let uneven = noise_model().uneven_glare;
        for (correspondence, point) in found.all.iter_mut().zip(points) {
            let blur_px = found.blur.at(point.piece);
            correspondence.sigma_px = correspondence.sigma_px.hypot(edge_floor_px(point.piece, blur_px));
            correspondence.face = SeenFace::behind(point, filters.at(point.piece).spread_px(blur_px));
            if let Some(face) = correspondence.face {
                correspondence.sigma_px = correspondence.sigma_px.hypot(face.pull_px() * uneven);
            }
        }
        found
    }

    /// Edges of known errors: at every clear point of an outline that bends, displaced outwards by one of `displacements_px`, which
    /// are in the order of the outline's points. Each has the standard deviation `sigma_px`.
    #[cfg(test)]
    pub fn displaced(outline: &Outline, displacements_px: &[f64], sigma_px: f64) -> Self {
        /// The edges' blur after the filter. Convention: that of sharp pictures; for tests.
        const SPREAD_PX: f64 = 1.5;
        /// As far as the filter reaches. Convention: that of sharp pictures; for tests.
        const CLEAR_PX: f64 = 4.0;
        let mut edges =
            Self { all: vec![], sections_mm: vec![], section_of: vec![], searched: vec![], blur: Blur::uniform(1.0) };
        let points = outline.points.iter().zip(displacements_px);
        for (point, displacement_px) in
            points.filter(|(point, _)| point.gap_px.min(point.depth_px) >= CLEAR_PX && point.piece.bends())
        {
            if edges.sections_mm.last() != Some(&point.body.s_mm) {
                edges.sections_mm.push(point.body.s_mm);
            }
            edges.section_of.push(edges.sections_mm.len() - 1);
            edges.searched.push((point.piece, Some(Edge { offset_px: *displacement_px, sigma_px, blur_px: 1.0 })));
            let normal = point.normal.into_inner();
            let seen = point.pixel + normal * *displacement_px;
            let crate::measure::body::OutlinePoint { body, piece, lateral, .. } = *point;
            let face = SeenFace::behind(point, SPREAD_PX);
            let noise_px = sigma_px;
            edges.all.push(Correspondence { body, piece, lateral, seen, normal, noise_px, sigma_px, face });
        }
        edges
    }

    pub fn len(&self) -> usize {
        self.all.len()
    }

    /// The outline points that were searched, by their pieces, and the edge found near each.
    pub fn searched(&self) -> &[(Piece, Option<Edge>)] {
        &self.searched
    }

    /// The signed distance of each edge outwards from where the model expects it, which is the border plus the bias, in units of σ.
    pub fn residuals(&self, view: &Projection, profile: impl Into<BendProfile>, bias: EdgeBias) -> Vec<f64> {
        let curve = view.curve(profile);
        // Matrices turn many points in less time than quaternions.
        let frame = |&s_mm: &f64| {
            let pose = view.camera_from_base * curve.frame_at(s_mm);
            (pose.rotation.to_rotation_matrix(), pose.translation.vector)
        };
        let frames: Vec<_> = self.sections_mm.iter().map(frame).collect();
        let points = self.all.iter().zip(&self.section_of);
        points
            .map(|(m, &section)| {
                let (turned, origin) = &frames[section];
                let expected = view.lens.project(&Point3::from(turned * m.body.local + origin));
                (m.normal.dot(&(m.seen - expected)) - bias.at(m.piece, m.face).0) / m.sigma_px
            })
            .collect()
    }

    /// Residuals in units of σ as distances in px.
    pub fn in_px(&self, residuals: &[f64]) -> Vec<f64> {
        residuals.iter().zip(&self.all).map(|(r, m)| r * m.sigma_px).collect()
    }

    /// The roots of the shares of the edges' information that each of so many frames adds to a straight picture, see [`share_of_news`]. Edges of what bends
    /// are elsewhere in each frame, and new.
    pub fn roots_of_news(&self, frames: usize) -> impl Iterator<Item = f64> {
        self.all.iter().map(move |m| {
            let of_noise = (m.noise_px / m.sigma_px).powi(2);
            if m.piece.bends() { 1.0 } else { share_of_news(of_noise, frames as f64).sqrt() }
        })
    }

    /// The piece of the body that each edge belongs to.
    pub fn pieces(&self) -> impl Iterator<Item = Piece> {
        self.all.iter().map(|m| m.piece)
    }

    /// The cluster of correlated edges that each edge belongs to.
    pub fn clusters(&self) -> impl Iterator<Item = Piece> {
        self.pieces().map(Piece::cluster)
    }

    /// The displacements of the edges in each systematic mode of the noise model, in units of σ and times the roots of the edges'
    /// weights.
    pub fn systematic_modes(&self, view: &Projection, roots: &[f64], scatter_px: f64) -> Vec<DVector<f64>> {
        let growth = |piece: Piece| Conditions { blur_px: self.blur.at(piece), scatter_px }.growth();
        let of_edge = |m: &Correspondence| {
            let along = 2.0 * m.body.s_mm / view.robot.length_mm - 1.0;
            systematic_modes(m.piece, m.lateral, along, &m.normal)
        };
        let edges: Vec<[f64; MODES]> = self.all.iter().map(of_edge).collect();
        let weight = |(m, root): (&Correspondence, &f64)| root * growth(m.piece) / m.sigma_px;
        let weights: Vec<f64> = self.all.iter().zip(roots).map(weight).collect();
        let mode = |k: usize| DVector::from_fn(self.len(), |edge, _| weights[edge] * edges[edge][k]);
        (0..MODES).map(mode).collect()
    }
}

/// The share of its information that an edge at rest adds in each of `frames` frames to the picture before them, if this share of its variance is the
/// pictures' noise and the rest displaces it alike in all of them.
///
/// Derived: with a variance of 1, a of it noise, one picture tells 1 of the edge, and N + 1 pictures tell 1/(1 − a + a/(N + 1)). The difference is N times
/// a/(1 + N (1 − a)).
fn share_of_news(of_noise: f64, frames: f64) -> f64 {
    of_noise / (1.0 + frames * (1.0 - of_noise))
}

#[cfg(test)]
mod tests {
    use super::*;
    use approx::assert_relative_eq;
    use nalgebra::DMatrix;

    #[test]
    fn what_frames_add_to_the_straight_picture_is_what_all_pictures_tell_together() {
        for (of_noise, frames) in [(1.0, 5), (0.7, 8), (0.1, 20), (0.3, 1)] {
            let pictures = frames + 1;
            let covariance = DMatrix::from_fn(pictures, pictures, |r, c| 1.0 - of_noise * f64::from(u8::from(r != c)));
            let all = DVector::from_element(pictures, 1.0);
            let information = all.dot(&covariance.cholesky().unwrap().solve(&all));
            let share = share_of_news(of_noise, frames as f64);
            assert_relative_eq!(1.0 + frames as f64 * share, information, max_relative = 1e-12);
        }
    }
}
