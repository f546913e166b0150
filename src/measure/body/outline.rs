//! The outline of the snake as a camera sees it: which points of disks and tubes lie on the border between snake and
//! background, where they project to and which way the border faces.
//!
//! The body is a holder, disks and tubes. Each is bounded in the picture by rims (sharp edges of disks) and by limbs (lines
//! along which a curved surface turns away from the camera). Both share a property that makes fitting exact to first order:
//! when a border point moves along its surface it moves *along* the border in the picture, so that only the motion of the
//! material point displaces the border across itself. A border point is therefore kept as a material point, [`BodyPoint`].
//! (R. Cipolla, P. Giblin, *Visual Motion of Curves and Surfaces*, Cambridge 2000, ch. 2, on apparent contours.)

use super::parts::{BodyPoint, Piece};
use super::projection::Projection;
use super::section::{Section, SurfacePoint};
use super::silhouette::{REACH_PX, Silhouette};
use super::surfaces::Surfaces;
use crate::camera::Lens;
use crate::measure::image::plane::Plane;
use crate::robot::BendProfile;
use nalgebra::{Point2, Unit, Vector2, Vector3};

/// From this distance of outline points on, the silhouette that decides what hides what is drawn in cells of two by two pixels, px.
///
/// Convention: only the coarse stages of a fit use outlines as sparse as this, and drawing is most of their time.
const SPARSE_PX: f64 = 4.0;
/// Outline points lie in the picture with at least this margin, px.
///
/// Derived: bilinear interpolation needs the next pixel.
const PICTURE_MARGIN_PX: f64 = 1.0;
/// The blur, σ in px, that an edge of the unblurred raster has: the share of a pixel that is covered (a box of one pixel, variance
/// 1/12) and the bilinear interpolation between pixels (1/6 on the average over positions), and the sampling of the edge filter.
///
/// Fitted: to what the edge finder reports on straight borders drawn by the rasteriser; the first two make 0.50 px.
pub(super) const RASTER_BLUR_PX: f64 = 0.54;
/// The least variance by which the raster is blurred, px².
///
/// Convention: a guard against a kernel of no width.
const LEAST_BLUR_VARIANCE_PX2: f64 = 0.01;
/// A point on the border between snake and background.
#[derive(Debug, Clone, Copy)]
pub struct OutlinePoint {
    /// The material point that is on the border now.
    pub body: BodyPoint,
    /// Its piece of the body.
    pub piece: Piece,
    /// On a rim: how far to the side, 0 in the middle to 1 at the ends where the rim turns away. 0 elsewhere.
    pub lateral: f64,
    /// On a rim whose flat face is seen: how far the face reaches behind the border, px. 0 elsewhere.
    pub face_px: f64,
    /// Where it is seen, px.
    pub pixel: Point2<f64>,
    /// Unit normal of the border in the picture, pointing out of the snake.
    pub normal: Unit<Vector2<f64>>,
    /// Free background beyond the border along the normal, px (up to [`Outline::REACH_PX`]).
    pub gap_px: f64,
    /// Snake behind the border against the normal, px (up to [`Outline::REACH_PX`]).
    pub depth_px: f64,
    /// The edge that a blurred picture of the silhouette shows here; `None` if the blur leaves none.
    pub predicted: Option<PredictedEdge>,
}

/// The edge that a blurred picture of the silhouette shows at a border point.
#[derive(Debug, Clone, Copy)]
pub struct PredictedEdge {
    /// How far outside the border it lies, px: blur rounds corners and shifts curved borders.
    pub offset_px: f64,
    /// Its apparent blur divided by the picture's: less than 1 on parts that are hardly wider than the blur.
    pub blur_ratio: f64,
}

impl PredictedEdge {
    /// That of a straight border with nothing near it.
    const STRAIGHT: Self = Self { offset_px: 0.0, blur_ratio: 1.0 };
}

/// The snake's outline for one bend and one view.
#[derive(Debug, Clone)]
pub struct Outline {
    /// Border points, about [`Outline::SPACING_PX`] apart.
    pub points: Vec<OutlinePoint>,
    /// The share of the body's surface points that could be on the border but lie outside the picture.
    pub out_of_frame: f64,
    silhouette: Silhouette,
}

impl Outline {
    /// Distance between neighbouring border points, px.
    ///
    /// Convention: about as far as the blur of a sharp picture reaches, so that closer points would show the same pixels again.
    pub const SPACING_PX: f64 = 2.0;
    /// The largest gap and depth that are told apart, px.
    ///
    /// Convention: how far the raster is explored around a border point.
    pub const REACH_PX: f64 = REACH_PX;

    /// Projects the body and keeps what lies on the border of its silhouette and within the picture.
    pub fn new(view: &Projection, profile: impl Into<BendProfile>) -> Self {
        Self::spaced(view, profile, Self::SPACING_PX)
    }

    /// The same with border points about `spacing_px` apart.
    pub(crate) fn spaced(view: &Projection, profile: impl Into<BendProfile>, spacing_px: f64) -> Self {
        let (candidates, silhouette) = drawn(view, profile, spacing_px);
        let mut points = Vec::with_capacity(candidates.len());
        points.extend(candidates.iter().filter_map(|point| border_point(&silhouette, view.lens, point)));
        let outside =
            candidates.iter().filter(|p| p.body.s_mm > 0.0 && !view.lens.contains(&p.pixel, PICTURE_MARGIN_PX));
        Self { points, out_of_frame: outside.count() as f64 / candidates.len().max(1) as f64, silhouette }
    }

    /// Of the snake's border points alone, about `spacing_px` apart, where they are seen (px) and which way the border faces, if as much background
    /// is beside them: what a search over thousands of bends asks, in less time.
    pub(crate) fn free_points(
        view: &Projection,
        profile: impl Into<BendProfile>,
        spacing_px: f64,
        least_gap_px: f64,
    ) -> impl Iterator<Item = (Point2<f64>, Unit<Vector2<f64>>)> {
        let (candidates, silhouette) = drawn(view, profile, spacing_px);
        candidates.into_iter().filter(|point| point.body.s_mm > 0.0).filter_map(move |point| {
            let normal = border_normal(&silhouette, view.lens, &point)?;
            let gap_px = silhouette.run_length(&point.pixel, normal.into_inner(), false, least_gap_px);
            (gap_px >= least_gap_px).then_some((point.pixel, normal))
        })
    }

    /// Projects the same material points at a bend that differs little, at which they are still on the border to first order. The
    /// silhouette, gaps and depths stay as they were.
    pub(crate) fn reproject(&mut self, view: &Projection, profile: impl Into<BendProfile>) {
        let curve = view.curve(profile);
        let mut section = Section::new(view, &curve, 0.0);
        self.points.retain_mut(|point| {
            let BodyPoint { s_mm, local } = point.body;
            // Points are ordered by section.
            if section.s_mm != s_mm {
                section = Section::new(view, &curve, s_mm);
            }
            let along = if point.piece.is_rim() { Vector3::new(-local.y, local.x, 0.0) } else { Vector3::z() };
            let (pixel, along) = section.pixel_and_direction(local, along);
            let Some(normal) = normal_of(along, *point.normal) else { return false };
            (point.pixel, point.normal) = (pixel, normal);
            view.lens.contains(&pixel, PICTURE_MARGIN_PX)
        });
    }

    /// Whether the body covers a pixel.
    pub fn covers(&self, pixel: &Point2<f64>) -> bool {
        self.silhouette.covers(pixel)
    }

    /// How an ideal camera would see the silhouette, 1 on the snake and 0 elsewhere, with edges blurred by a Gaussian of
    /// σ = `blur_px`. For outlines with points closer than 4 px, whose silhouette is drawn by the pixel.
    pub(crate) fn blurred_silhouette(&self, blur_px: f64) -> Plane {
        let variance = (blur_px.powi(2) - RASTER_BLUR_PX.powi(2)).max(LEAST_BLUR_VARIANCE_PX2);
        self.silhouette.blurred(variance.sqrt())
    }

    /// The part of the picture the body may cover: x0, y0, x1, y1, px.
    pub fn bounds(&self) -> (f64, f64, f64, f64) {
        self.silhouette.bounds()
    }
}

/// The unit normal of a border of this direction, on the side to which `outward` points; `None` where the border is seen end-on.
fn normal_of(along: Vector2<f64>, outward: Vector2<f64>) -> Option<Unit<Vector2<f64>>> {
    let normal = Unit::try_new(Vector2::new(-along.y, along.x), 1e-9)?;
    Some(if normal.dot(&outward) < 0.0 { -normal } else { normal })
}

/// The points of the body's surface that may lie on the border, about `spacing_px` apart, and its silhouette.
fn drawn(view: &Projection, profile: impl Into<BendProfile>, spacing_px: f64) -> (Vec<SurfacePoint>, Silhouette) {
    let distance_mm = view.camera_from_base.translation.vector.norm().max(1.0);
    let mm_per_px = distance_mm / view.lens.focal_px.x;
    let Surfaces { points, polygons } = Surfaces::new(view, &view.curve(profile), spacing_px, mm_per_px);
    let cell_px = if spacing_px < SPARSE_PX { 1.0 } else { 2.0 };
    (points, Silhouette::new(view.lens, &polygons, cell_px))
}

/// Which way the border faces at a surface point; `None` if that is hidden, inside the silhouette or outside the picture.
fn border_normal(silhouette: &Silhouette, lens: &Lens, point: &SurfacePoint) -> Option<Unit<Vector2<f64>>> {
    if !lens.contains(&point.pixel, PICTURE_MARGIN_PX) {
        return None;
    }
    let normal = normal_of(point.along, point.outward)?;
    silhouette.has_border_at(&point.pixel, &normal).then_some(normal)
}

/// The border point at a surface point, if it is one.
fn border_point(silhouette: &Silhouette, lens: &Lens, point: &SurfacePoint) -> Option<OutlinePoint> {
    let normal = border_normal(silhouette, lens, point)?;
    let SurfacePoint { body, piece, lateral, face_px, pixel, .. } = *point;
    let depth_px = silhouette.run_length(&pixel, -normal.into_inner(), true, REACH_PX);
    let gap_px = silhouette.run_length(&pixel, normal.into_inner(), false, REACH_PX);
    let predicted = Some(PredictedEdge::STRAIGHT);
    Some(OutlinePoint { body, piece, lateral, face_px, pixel, normal, gap_px, depth_px, predicted })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::measure::fixture::Scene;
    use approx::assert_relative_eq;
    use nalgebra::Point3;

    use crate::geometry::Configuration;

    const STRAIGHT: Configuration = Configuration { theta: 0.0, delta: 0.0 };

    #[test]
    fn sides_of_a_straight_snake_seen_from_the_side_lie_where_tangents_from_the_camera_touch_it() {
        let scene = Scene::new(Vector3::zeros());
        let outline = Outline::new(&scene.view(), STRAIGHT);
        // A tangent to a circle of radius R from the distance D has the slope R/√(D² − R²).
        let (radius, distance) = (scene.robot.body.disk_diameter_mm / 2.0, 120.0_f64);
        let half_width_px = 1500.0 * radius / (distance.powi(2) - radius.powi(2)).sqrt();
        let sides = outline.points.iter().filter(|p| matches!(p.piece, Piece::HolderSide(_) | Piece::DiskSide(..)));
        let mut count = 0;
        for point in sides {
            count += 1;
            let right = point.normal.x.signum();
            assert_relative_eq!(point.pixel.x, 399.5 + right * half_width_px, epsilon = 1e-9);
            assert_relative_eq!(point.normal.x.abs(), 1.0, epsilon = 1e-12);
        }
        assert!(count > 100, "{count}");
        // The end disk's far rim as seen from below is its edge nearest to the camera: 26 mm above the base.
        let top = outline.points.iter().map(|p| p.pixel.y).fold(f64::INFINITY, f64::min);
        assert_relative_eq!(top, 299.5 + 1500.0 * (12.0 - 26.0) / (distance - radius), epsilon = 1.0);
    }

    #[test]
    fn the_line_of_sight_of_every_point_of_a_limb_is_tangent_to_its_surface() {
        for turn in [Vector3::zeros(), Vector3::new(0.1, -0.2, 0.3), Vector3::new(-0.4, 0.3, 0.0)] {
            let scene = Scene::new(turn);
            let view = scene.view();
            let psi = Configuration::new(0.9, 0.7);
            let camera = scene.camera_from_base.inverse() * Point3::origin();
            let outline = Outline::new(&view, psi);
            let tube_radius = scene.robot.primary.outer_diameter_mm / 2.0;
            let disk_radius = scene.robot.body.disk_diameter_mm / 2.0;
            let (mut tubes, mut disks) = (0, 0);
            for point in &outline.points {
                let sight = scene.camera_from_base.inverse() * scene.lens.ray(&point.pixel);
                // The least distance from the line of sight to the axis near this section: points of the axis by 1 µm for the bent
                // axis of the primary tube, the section's own axis for a disk.
                let section = scene.robot.frame_at(psi, point.body.s_mm);
                let along = |s: f64| match point.piece {
                    Piece::Tube(..) => scene.robot.frame_at(psi, point.body.s_mm + s).translation.vector,
                    _ => (section * Point3::new(0.0, 0.0, point.body.local.z + s)).coords,
                };
                let distance = |s: f64| (along(s) - camera.coords).cross(&sight).norm() / sight.norm();
                let least = (-500..=500).map(|k| distance(f64::from(k) * 1e-3)).fold(f64::INFINITY, f64::min);
                match point.piece {
                    Piece::Tube(0, ..) => {
                        tubes += 1;
                        assert_relative_eq!(least, tube_radius, epsilon = 1e-5);
                    }
                    Piece::DiskSide(..) => {
                        disks += 1;
                        assert_relative_eq!(least, disk_radius, epsilon = 1e-5);
                    }
                    _ => {}
                }
            }
            assert!(tubes > 20 && disks > 20, "{turn}: {tubes} {disks}");
        }
    }

    #[test]
    fn an_arc_seen_square_to_its_plane_has_its_tip_where_the_circle_ends() {
        // Bent by 90° to the right: the tip's centre is at (ρ, 0, ρ) with ρ = L/θ.
        let scene = Scene::new(Vector3::zeros());
        let psi = Configuration::from_degrees(90.0, 0.0);
        let radius = scene.robot.length_mm / psi.theta;
        let curve = scene.view().curve(psi);
        let tip = scene.view().pixel(&curve, &BodyPoint { s_mm: scene.robot.length_mm, local: Vector3::zeros() });
        assert_relative_eq!(tip.x, 399.5 + 1500.0 * radius / 120.0, epsilon = 1e-4);
        assert_relative_eq!(tip.y, 299.5 + 1500.0 * (12.0 - radius) / 120.0, epsilon = 1e-4);
        let outline = Outline::new(&scene.view(), psi);
        assert!(outline.covers(&tip));
        // The tip's tangent points to the right: beyond its face is no snake.
        assert!(!outline.covers(&(tip + Vector2::new(0.6 * 12.5, 0.0))));
    }

    #[test]
    fn border_points_separate_snake_from_background_and_reprojecting_moves_them_along() {
        let scene = Scene::new(Vector3::new(0.05, 0.1, 0.0));
        let view = scene.view();
        let bend = Vector2::new(0.5, -0.3);
        let mut outline = Outline::spaced(&view, Configuration::from_bend_vector(bend), 6.0);
        let nearby = Configuration::from_bend_vector(bend + Vector2::new(4e-3, -3e-3));
        let drawn = Outline::new(&view, nearby);
        outline.reproject(&view, nearby);
        let agreeing = |point: &&OutlinePoint| {
            let step = point.normal.into_inner();
            drawn.covers(&(point.pixel - step)) && !drawn.covers(&(point.pixel + step))
        };
        let share = outline.points.iter().filter(agreeing).count() as f64 / outline.points.len() as f64;
        // Rims and limbs that begin or end to be hidden at the new bend are no border any more.
        assert!(share > 0.9, "{share}");
    }

    #[test]
    fn free_points_are_those_of_the_outline_that_have_room_beside_them() {
        let scene = Scene::new(Vector3::new(0.1, -0.2, 0.3));
        let view = scene.view();
        for psi in [STRAIGHT, Configuration::from_degrees(60.0, 30.0), Configuration::from_degrees(100.0, -110.0)] {
            let outline = Outline::spaced(&view, psi, 3.0);
            let expected = outline.points.iter().filter(|point| point.body.s_mm > 0.0 && point.gap_px >= 2.5);
            let expected: Vec<_> = expected.map(|point| (point.pixel, point.normal)).collect();
            assert!(expected.len() > 100);
            assert_eq!(Outline::free_points(&view, psi, 3.0, 2.5).collect::<Vec<_>>(), expected);
        }
    }

    #[test]
    fn a_snake_outside_the_picture_has_no_points() {
        let mut scene = Scene::new(Vector3::zeros());
        scene.camera_from_base.translation.vector.x = 500.0;
        let outline = Outline::new(&scene.view(), STRAIGHT);
        assert!(outline.points.is_empty());
        assert!(outline.out_of_frame > 0.5, "{}", outline.out_of_frame);
    }
}
