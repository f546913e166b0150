//! The outline of the snake as a camera sees it: which points of disks and tubes lie on the border between snake and
//! background, where they project to and which way the border faces.
//!
//! The body is a holder, disks and four tubes. Each is bounded in the picture by rims (sharp edges of disks) and by
//! generators (places where the surface turns away from the camera). Both share a property that makes fitting exact to
//! first order: moving along the surface slides the point *along* the border, so only the motion of the material point
//! moves the border across itself. A border point is therefore kept as a material point, [`BodyPoint`].

use crate::camera::Lens;
use crate::geometry::{Configuration, Pose};
use crate::robot::Robot;
use image::{GrayImage, Luma};
use imageproc::drawing::draw_polygon_mut;
use imageproc::point::Point;
use nalgebra::{Point2, Point3, Unit, Vector2, Vector3};

/// A point fixed to the snake's body: `local` (mm) in the frame of the section at arc length `s_mm`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BodyPoint {
    /// Arc length of the section, mm; negative on the holder.
    pub s_mm: f64,
    /// Position in the section's frame (z along the tangent), mm.
    pub local: Vector3<f64>,
}

impl BodyPoint {
    /// Where the point is in the base frame, mm.
    pub fn in_base(&self, robot: &Robot, psi: Configuration) -> Point3<f64> {
        robot.frame_at(psi, self.s_mm) * Point3::from(self.local)
    }
}

/// Which piece of the body a border point belongs to.
///
/// Errors along one piece are correlated (they share its shading and its sharpness), so pieces are also the units in
/// which a fit's covariance counts its evidence.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum Piece {
    /// A side of the holder below the base disk: −1 or +1.
    HolderSide(i8),
    /// The base disk's upper rim.
    BaseRim,
    /// A rim of disk k (1 is next to the base): near (false) or far (true) face.
    Rim(u8, bool),
    /// A side wall of disk k: −1 or +1.
    DiskSide(u8, i8),
    /// A side of tube i (0 is the primary) between disks k and k + 1.
    Tube(u8, i8, u8),
}

/// A point on the border between snake and background.
#[derive(Debug, Clone, Copy)]
pub struct OutlinePoint {
    /// The material point that is on the border now.
    pub body: BodyPoint,
    /// Its piece of the body.
    pub piece: Piece,
    /// Where it is seen, px.
    pub pixel: Point2<f64>,
    /// Unit normal of the border in the picture, pointing out of the snake.
    pub normal: Unit<Vector2<f64>>,
    /// Free background beyond the border along the normal, px (up to [`Outline::REACH_PX`]).
    pub gap_px: f64,
    /// Snake behind the border against the normal, px (up to [`Outline::REACH_PX`]).
    pub depth_px: f64,
}

/// The snake's outline for one configuration and one view.
#[derive(Debug, Clone)]
pub struct Outline {
    /// Border points, about [`Outline::SPACING_PX`] apart.
    pub points: Vec<OutlinePoint>,
    /// How many of the body's surface points that could be on the border lie outside the picture.
    pub out_of_frame: f64,
    mask: Mask,
}

/// The body's silhouette over the part of the picture that it covers.
#[derive(Debug, Clone)]
struct Mask {
    /// 255 on the snake, 0 elsewhere.
    picture: GrayImage,
    /// The mask's pixels are this many times finer than the picture's.
    scale: f64,
    /// The mask's first pixel, in its own pixels from the picture's.
    origin: Point2<i32>,
}

/// What is needed to project the body: where the camera is and what it looks at.
#[derive(Debug, Clone)]
pub struct Projection<'a> {
    /// Intrinsics.
    pub lens: &'a Lens,
    /// The view's camera pose.
    pub camera_from_base: Pose,
    /// The robot.
    pub robot: &'a Robot,
}

/// Length of holder that is modelled below the base disk, mm.
const HOLDER_MM: f64 = 12.0;

impl<'a> Projection<'a> {
    /// The pixel of a body point.
    pub fn pixel(&self, psi: Configuration, point: &BodyPoint) -> Point2<f64> {
        self.lens.project(&(self.camera_from_base * point.in_base(self.robot, psi)))
    }

    /// The camera's centre of projection in the base frame, mm.
    fn eye(&self) -> Point3<f64> {
        self.camera_from_base.inverse() * Point3::origin()
    }
}

/// A point of a surface that may be on the border, before the rest of the body is taken into account.
struct Candidate {
    body: BodyPoint,
    piece: Piece,
    /// Unit surface normal that is square to the line of sight or to a rim, in the base frame: points out of the snake.
    outward: Vector3<f64>,
    /// Direction of the border in space, base frame.
    along: Vector3<f64>,
}

impl Outline {
    /// Distance between neighbouring border points, px.
    pub const SPACING_PX: f64 = 2.0;
    /// How far gap and depth are looked for, px.
    pub const REACH_PX: f64 = 12.0;

    /// Projects the body and keeps what lies on the border of its silhouette and within the picture.
    ///
    /// `detail` is how many times finer than the picture the silhouette is drawn: 1 for a search, 4 for a fit, where of
    /// two nearly coinciding borders the outer one must be told from the inner.
    pub fn new(view: &Projection, psi: Configuration, detail: u32) -> Self {
        let mut candidates = Vec::new();
        let mut polygons = Vec::new();
        cylinders(view, psi, &mut candidates, &mut polygons);
        tubes(view, psi, &mut candidates, &mut polygons);

        let mask = Mask::new(view.lens, &polygons, f64::from(detail));
        let points = candidates.iter().filter_map(|c| border_point(&mask, view, psi, c)).collect();
        let outside =
            candidates.iter().filter(|c| c.body.s_mm > 0.0 && !view.lens.contains(&view.pixel(psi, &c.body), 1.0));
        Self { points, out_of_frame: outside.count() as f64 / candidates.len().max(1) as f64, mask }
    }

    /// Whether the body covers a pixel.
    pub fn covers(&self, pixel: &Point2<f64>) -> bool {
        self.mask.covers(pixel)
    }

    /// The part of the picture the body may cover: x0, y0, x1, y1, px.
    pub fn bounds(&self) -> (f64, f64, f64, f64) {
        let start = self.mask.origin.cast::<f64>() / self.mask.scale;
        let (width, height) = self.mask.picture.dimensions();
        (start.x, start.y, start.x + f64::from(width) / self.mask.scale, start.y + f64::from(height) / self.mask.scale)
    }
}

fn border_point(mask: &Mask, view: &Projection, psi: Configuration, candidate: &Candidate) -> Option<OutlinePoint> {
    let base = candidate.body.in_base(view.robot, psi);
    let project = |p: Point3<f64>| view.lens.project(&(view.camera_from_base * p));
    let pixel = project(base);
    if !view.lens.contains(&pixel, 1.0) {
        return None;
    }
    const STEP_MM: f64 = 1e-3;
    let along = project(base + candidate.along * STEP_MM) - pixel;
    let out = project(base + candidate.outward * STEP_MM) - pixel;
    let mut normal = Unit::try_new(Vector2::new(-along.y, along.x), 1e-12)?;
    if normal.dot(&out) < 0.0 {
        normal = -normal;
    }
    let gap_px = mask.run_length(&pixel, normal.into_inner(), false);
    let depth_px = mask.run_length(&pixel, -normal.into_inner(), true);
    // Where two parts' borders nearly coincide, only the outer one is seen.
    let on_border_px = 3.0 / mask.scale;
    (gap_px > on_border_px && depth_px > on_border_px).then_some(OutlinePoint {
        body: candidate.body,
        piece: candidate.piece,
        pixel,
        normal,
        gap_px,
        depth_px,
    })
}

/// Rims and side walls of the disks and the holder.
fn cylinders(
    view: &Projection,
    psi: Configuration,
    candidates: &mut Vec<Candidate>,
    polygons: &mut Vec<Vec<Point2<f64>>>,
) {
    let body = &view.robot.body;
    let radius = body.disk_diameter_mm / 2.0;
    let eye = view.eye();
    let spacing_mm = spacing_mm(view);

    // (piece number, section it is square to, near and far face from there): the holder is number 0, disks count from 1.
    let half = body.disk_thickness_mm / 2.0;
    let spacers =
        view.robot.spacer_middles_mm().into_iter().zip(1..).map(|(middle, number)| (number, middle, -half, half));
    let end = (body.spacer_disk_count + 1, view.robot.length_mm, -body.disk_thickness_mm, 0.0);
    for (number, s_mm, near_mm, far_mm) in std::iter::once((0, 0.0, -HOLDER_MM, 0.0)).chain(spacers).chain([end]) {
        let frame = view.robot.frame_at(psi, s_mm);
        let local_eye = frame.inverse() * eye;

        let mut rims = Vec::new();
        let steps = (std::f64::consts::TAU * radius / spacing_mm).ceil().max(16.0) as usize;
        for far in [false, true] {
            let z = if far { far_mm } else { near_mm };
            let face_seen = if far { local_eye.z > z } else { local_eye.z < z };
            for step in 0..steps {
                let phi = std::f64::consts::TAU * step as f64 / steps as f64;
                let radial = Vector3::new(phi.cos(), phi.sin(), 0.0);
                let local = Vector3::new(radius * radial.x, radius * radial.y, z);
                rims.push(view.lens.project(&(view.camera_from_base * (frame * Point3::from(local)))));
                let wall_seen = radial.dot(&(local_eye.coords - local)) > 0.0;
                // A rim is on the cylinder's border where just one of the two surfaces that meet in it is seen.
                if face_seen == wall_seen || (number == 0 && !far) {
                    continue;
                }
                candidates.push(Candidate {
                    body: BodyPoint { s_mm, local },
                    piece: if number == 0 { Piece::BaseRim } else { Piece::Rim(number, far) },
                    // Any mix of the two surfaces' normals points out of the border.
                    outward: frame * (radial + Vector3::z() * if far { 1.0 } else { -1.0 }),
                    along: frame * Vector3::new(-radial.y, radial.x, 0.0),
                });
            }
        }
        polygons.push(convex_hull(rims));

        for (side, radial) in tangent_directions(Vector2::new(local_eye.x, local_eye.y), radius) {
            let count = ((far_mm - near_mm) / spacing_mm).floor().max(1.0) as usize;
            for step in 0..count {
                let z = near_mm + (far_mm - near_mm) * (step as f64 + 0.5) / count as f64;
                candidates.push(Candidate {
                    body: BodyPoint { s_mm, local: Vector3::new(radius * radial.x, radius * radial.y, z) },
                    piece: if number == 0 { Piece::HolderSide(side) } else { Piece::DiskSide(number, side) },
                    outward: frame * Vector3::new(radial.x, radial.y, 0.0),
                    along: frame * Vector3::z(),
                });
            }
        }
    }
}

/// The two sides of each of the four tubes.
fn tubes(view: &Projection, psi: Configuration, candidates: &mut Vec<Candidate>, polygons: &mut Vec<Vec<Point2<f64>>>) {
    let robot = view.robot;
    let eye = view.eye();
    let steps = (robot.length_mm / spacing_mm(view)).ceil().max(8.0) as usize;
    let axes = std::iter::once((Vector2::zeros(), robot.primary.outer_diameter_mm / 2.0)).chain(
        robot
            .backbone_azimuths()
            .iter()
            .map(|azimuth| {
                let offset = robot.backbone_circle_radius_mm * Vector2::new(azimuth.cos(), azimuth.sin());
                (offset, robot.secondary.outer_diameter_mm / 2.0)
            })
            .collect::<Vec<_>>(),
    );
    for (number, (offset, radius)) in axes.enumerate() {
        let mut sides = [Vec::new(), Vec::new()];
        for step in 0..steps {
            let s_mm = robot.length_mm * (step as f64 + 0.5) / steps as f64;
            let frame = robot.frame_at(psi, s_mm);
            let local_eye = frame.inverse() * eye;
            for (side, radial) in tangent_directions(Vector2::new(local_eye.x, local_eye.y) - offset, radius) {
                let local = Vector3::new(offset.x + radius * radial.x, offset.y + radius * radial.y, 0.0);
                sides[usize::from(side > 0)]
                    .push(view.lens.project(&(view.camera_from_base * (frame * Point3::from(local)))));
                candidates.push(Candidate {
                    body: BodyPoint { s_mm, local },
                    piece: Piece::Tube(number as u8, side, (s_mm / robot.disk_pitch_mm()) as u8),
                    outward: frame * Vector3::new(radial.x, radial.y, 0.0),
                    along: frame * Vector3::z(),
                });
            }
        }
        let [left, right] = sides;
        polygons.push(left.into_iter().chain(right.into_iter().rev()).collect());
    }
}

/// The spacing of border points on the body, mm, that gives [`Outline::SPACING_PX`] in the picture.
fn spacing_mm(view: &Projection) -> f64 {
    let distance = view.camera_from_base.translation.vector.norm().max(1.0);
    Outline::SPACING_PX * distance / view.lens.focal_px.x
}

/// The two radial directions on a circle of this radius at which an observer at `eye` (same plane, centre at the origin)
/// grazes it: n · (eye − radius n) = 0. None from inside the circle.
fn tangent_directions(eye: Vector2<f64>, radius: f64) -> impl Iterator<Item = (i8, Vector2<f64>)> {
    let distance = eye.norm();
    let solutions = (distance > radius).then(|| {
        let towards = eye.y.atan2(eye.x);
        let half = (radius / distance).acos();
        [(-1, towards - half), (1, towards + half)]
    });
    solutions.into_iter().flatten().map(|(side, angle)| (side, Vector2::new(angle.cos(), angle.sin())))
}

/// The convex hull of projected points; none if one of them has no projection.
fn convex_hull(points: Vec<Point2<f64>>) -> Vec<Point2<f64>> {
    const SCALE: f64 = 16.0;
    if points.iter().any(|p| !p.x.is_finite() || !p.y.is_finite() || p.coords.amax() > 1e6) {
        return Vec::new();
    }
    let scaled: Vec<Point<i32>> =
        points.iter().map(|p| Point::new((p.x * SCALE).round() as i32, (p.y * SCALE).round() as i32)).collect();
    imageproc::geometry::convex_hull(scaled)
        .into_iter()
        .map(|p: Point<i32>| Point2::new(f64::from(p.x) / SCALE, f64::from(p.y) / SCALE))
        .collect()
}

impl Mask {
    /// Draws the union of the polygons (px of the picture), on what they cover and [`Outline::REACH_PX`] around it.
    fn new(lens: &Lens, polygons: &[Vec<Point2<f64>>], scale: f64) -> Self {
        let fine = |px: f64| (px * scale).round() as i32;
        let reach = fine(Outline::REACH_PX + 2.0);
        let clamp = |px: f64, size: u32| fine(px).clamp(-reach, fine(f64::from(size)) + reach);
        let (mut x0, mut y0, mut x1, mut y1) = (i32::MAX, i32::MAX, i32::MIN, i32::MIN);
        for p in polygons.iter().flatten().filter(|p| p.x.is_finite() && p.y.is_finite()) {
            let (x, y) = (clamp(p.x, lens.width), clamp(p.y, lens.height));
            (x0, y0, x1, y1) = (x0.min(x), y0.min(y), x1.max(x), y1.max(y));
        }
        if x0 > x1 {
            return Self { picture: GrayImage::new(1, 1), scale, origin: Point2::origin() };
        }
        let origin = Point2::new(x0 - reach, y0 - reach);
        let mut picture = GrayImage::new((x1 - x0 + 2 * reach + 1) as u32, (y1 - y0 + 2 * reach + 1) as u32);
        for polygon in polygons {
            const FURTHEST_PX: f64 = 1e5;
            let mut vertices: Vec<Point<i32>> = polygon
                .iter()
                .filter(|p| p.x.is_finite() && p.y.is_finite() && p.coords.amax() < FURTHEST_PX)
                .map(|p| Point::new(fine(p.x) - origin.x, fine(p.y) - origin.y))
                .collect();
            vertices.dedup();
            if vertices.first() == vertices.last() {
                vertices.pop();
            }
            if vertices.len() >= 3 {
                draw_polygon_mut(&mut picture, &vertices, Luma([255]));
            }
        }
        Self { picture, scale, origin }
    }

    fn covers(&self, pixel: &Point2<f64>) -> bool {
        let x = (pixel.x * self.scale).round() as i32 - self.origin.x;
        let y = (pixel.y * self.scale).round() as i32 - self.origin.y;
        let inside = x >= 0 && y >= 0;
        inside && self.picture.get_pixel_checked(x as u32, y as u32).is_some_and(|p| p.0[0] > 0)
    }

    /// How far, px, one can go from a border pixel before the mask is no longer `inside`.
    fn run_length(&self, from: &Point2<f64>, direction: Vector2<f64>, inside: bool) -> f64 {
        let mut distance = 1.5 / self.scale;
        while distance < Outline::REACH_PX && self.covers(&(from + direction * distance)) == inside {
            distance += 2.0 / self.scale;
        }
        distance.min(Outline::REACH_PX)
    }
}
