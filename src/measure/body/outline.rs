//! The outline of the snake as a camera sees it: which points of disks and tubes lie on the border between snake and
//! background, where they project to and which way the border faces.
//!
//! The body is a holder, disks and tubes. Each is bounded in the picture by rims (sharp edges of disks) and by
//! generators (places where the surface turns away from the camera). Both share a property that makes fitting exact to
//! first order: moving along the surface slides the point *along* the border, so only the motion of the material point
//! moves the border across itself. A border point is therefore kept as a material point, [`BodyPoint`].

use crate::camera::Lens;
use crate::geometry::{Configuration, Pose};
use crate::measure::image::plane::{Plane, Region};
use crate::robot::Robot;
use ab_glyph_rasterizer::{Rasterizer, point};
use nalgebra::{Matrix3, Point2, Point3, Unit, Vector2, Vector3};
use std::f64::consts::TAU;

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
/// Errors along one piece are correlated (they share its shading and its sharpness), so pieces, those of one tube's side
/// together, are also the units in which a fit's covariance counts its evidence.
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

impl Piece {
    /// Whether it is a sharp edge, not a surface that turns away.
    pub(crate) fn is_rim(self) -> bool {
        matches!(self, Self::BaseRim | Self::Rim(..))
    }

    /// The piece that stands for all that err alike: light falls on a tube's side in the same way from disk to disk.
    pub(crate) fn cluster(self) -> Self {
        match self {
            Self::Tube(tube, side, _) => Self::Tube(tube, side, 0),
            piece => piece,
        }
    }
}

/// A point on the border between snake and background.
#[derive(Debug, Clone, Copy)]
pub struct OutlinePoint {
    /// The material point that is on the border now.
    pub body: BodyPoint,
    /// Its piece of the body.
    pub piece: Piece,
    /// On a rim: how far to the side, 0 in the middle to 1 at the ends where the rim turns away. 0 elsewhere.
    pub lateral: f64,
    /// Where it is seen, px.
    pub pixel: Point2<f64>,
    /// Unit normal of the border in the picture, pointing out of the snake.
    pub normal: Unit<Vector2<f64>>,
    /// Free background beyond the border along the normal, px (up to [`Outline::REACH_PX`]).
    pub gap_px: f64,
    /// Snake behind the border against the normal, px (up to [`Outline::REACH_PX`]).
    pub depth_px: f64,
    /// What a soft picture makes of the border, `None` if nothing is left of it.
    pub predicted: Option<PredictedEdge>,
}

/// What a soft picture makes of a border point.
#[derive(Debug, Clone, Copy)]
pub struct PredictedEdge {
    /// How far outside the border its edge is seen, px.
    pub offset_px: f64,
    /// How soft it looks, in units of the picture's own softness.
    pub blur_ratio: f64,
}

impl PredictedEdge {
    /// A straight border with nothing near it.
    const NOT: Self = Self { offset_px: 0.0, blur_ratio: 1.0 };
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

/// The body's silhouette over the part of the picture that it covers: the share of every cell that is snake.
#[derive(Debug, Clone)]
struct Mask {
    coverage: Plane,
    /// The place in the picture, px, where the middle of the mask's first cell is.
    first: Vector2<f64>,
    /// Side of a cell, px.
    cell_px: f64,
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

    /// The part of the picture that is the body or near it.
    pub(crate) fn image_region(&self, psi: Configuration, reach_px: f64) -> Region {
        const STEP_MM: f64 = 0.5;
        let (robot, lens) = (self.robot, self.lens);
        let steps = ((robot.length_mm + HOLDER_MM) / STEP_MM).ceil() as usize;
        let middle = |k: usize| {
            let s_mm = robot.length_mm - k as f64 * STEP_MM;
            self.pixel(psi, &BodyPoint { s_mm, local: Vector3::zeros() })
        };
        Region::along((0..=steps).map(middle), 0.5 * self.diameter_px() + reach_px, (lens.width, lens.height))
    }

    /// The snake's diameter in the picture, px.
    pub(crate) fn diameter_px(&self) -> f64 {
        let depth_mm = self.camera_from_base.translation.vector.z.max(1.0);
        self.robot.body.disk_diameter_mm * self.lens.focal_px.max() / depth_mm
    }

    /// Distance between the places of the outline that decide which bend it is, px: some thirty around a disk.
    pub(crate) fn coarse_spacing_px(&self) -> f64 {
        const CLOSEST_PX: f64 = 6.0;
        (0.1 * self.diameter_px()).max(CLOSEST_PX)
    }
}

/// A point of a surface that may be on the border, before the rest of the body is taken into account.
struct Candidate {
    body: BodyPoint,
    piece: Piece,
    /// See [`OutlinePoint::lateral`].
    lateral: f64,
    /// Where it is seen, px.
    pixel: Point2<f64>,
    /// Unit surface normal that is square to the line of sight or to a rim, as it is seen: points out of the snake.
    outward: Vector2<f64>,
    /// Direction of the border as it is seen.
    along: Vector2<f64>,
}

/// A section of the snake as the camera sees it.
struct Section<'a> {
    lens: &'a Lens,
    s_mm: f64,
    /// The pose of the section's frame to the camera.
    rotation: Matrix3<f64>,
    place_mm: Vector3<f64>,
}

impl<'a> Section<'a> {
    fn new(view: &Projection<'a>, psi: Configuration, s_mm: f64) -> Self {
        let camera_from_section = view.camera_from_base * view.robot.frame_at(psi, s_mm);
        let rotation = camera_from_section.rotation.to_rotation_matrix().into_inner();
        Self { lens: view.lens, s_mm, rotation, place_mm: camera_from_section.translation.vector }
    }

    /// The camera's centre of projection, mm.
    fn eye(&self) -> Point3<f64> {
        Point3::from(-self.rotation.tr_mul(&self.place_mm))
    }

    fn in_camera(&self, local: Vector3<f64>) -> Point3<f64> {
        Point3::from(self.rotation * local + self.place_mm)
    }

    fn pixel(&self, local: Vector3<f64>) -> Point2<f64> {
        self.lens.project(&self.in_camera(local))
    }

    /// Where a place is seen, and a direction there.
    fn seen(&self, local: Vector3<f64>, direction: Vector3<f64>) -> (Point2<f64>, Vector2<f64>) {
        let (pixel, slopes) = self.lens.project_with_jacobian(&self.in_camera(local));
        (pixel, slopes * (self.rotation * direction))
    }

    /// A candidate, from vectors in the section's frame.
    fn candidate(
        &self,
        local: Vector3<f64>,
        piece: Piece,
        lateral: f64,
        outward: Vector3<f64>,
        along: Vector3<f64>,
    ) -> Candidate {
        let (pixel, slopes) = self.lens.project_with_jacobian(&self.in_camera(local));
        let seen = slopes * self.rotation;
        Candidate {
            body: BodyPoint { s_mm: self.s_mm, local },
            piece,
            lateral,
            pixel,
            outward: seen * outward,
            along: seen * along,
        }
    }
}

impl Outline {
    /// Distance between neighbouring border points, px.
    pub const SPACING_PX: f64 = 2.0;
    /// From this distance of border points on, what hides what is looked at in cells of two by two pixels.
    const SPARSE_PX: f64 = 4.0;
    /// How far gap and depth are looked for, px.
    pub const REACH_PX: f64 = 12.0;

    /// Projects the body and keeps what lies on the border of its silhouette and within the picture.
    pub fn new(view: &Projection, psi: Configuration) -> Self {
        Self::spaced(view, psi, Self::SPACING_PX)
    }

    /// The same with border points about `spacing_px` apart.
    pub(crate) fn spaced(view: &Projection, psi: Configuration, spacing_px: f64) -> Self {
        /// About the length, px, of all that may be on the border.
        const CANDIDATES_PX: f64 = 10_000.0;
        let distance_mm = view.camera_from_base.translation.vector.norm().max(1.0);
        let mm_per_px = distance_mm / view.lens.focal_px.x;
        let mut candidates = Vec::with_capacity((CANDIDATES_PX / spacing_px) as usize);
        let mut polygons = Vec::new();
        cylinders(view, psi, spacing_px * mm_per_px, &mut candidates, &mut polygons);
        tubes(view, psi, spacing_px, mm_per_px, &mut candidates, &mut polygons);

        let mask = Mask::new(view.lens, &polygons, if spacing_px < Self::SPARSE_PX { 1.0 } else { 2.0 });
        let points = candidates.iter().filter_map(|c| border_point(&mask, view.lens, c)).collect();
        let outside = candidates.iter().filter(|c| c.body.s_mm > 0.0 && !view.lens.contains(&c.pixel, 1.0));
        Self { points, out_of_frame: outside.count() as f64 / candidates.len().max(1) as f64, mask }
    }

    /// Carries the border points to a bend that differs little, under which they are still on the border to first order.
    /// The silhouette stays as it was.
    pub(crate) fn carry(&mut self, view: &Projection, psi: Configuration) {
        let mut section = Section::new(view, psi, 0.0);
        self.points.retain_mut(|point| {
            let BodyPoint { s_mm, local } = point.body;
            // Points come section by section.
            if section.s_mm != s_mm {
                section = Section::new(view, psi, s_mm);
            }
            let along = if point.piece.is_rim() { Vector3::new(-local.y, local.x, 0.0) } else { Vector3::z() };
            let (pixel, along) = section.seen(local, along);
            let Some(normal) = normal_of(along, *point.normal) else { return false };
            (point.pixel, point.normal) = (pixel, normal);
            view.lens.contains(&pixel, 1.0)
        });
    }

    /// Whether the body covers a pixel.
    pub fn covers(&self, pixel: &Point2<f64>) -> bool {
        self.mask.covers(pixel)
    }

    /// How an ideal camera would see the silhouette, 1 on the snake and 0 elsewhere, with edges as soft as a blur of
    /// σ = `blur_px` makes them. For border points closer than 4 px, whose silhouette is kept by the pixel.
    pub(crate) fn blurred_silhouette(&self, blur_px: f64) -> Plane {
        /// What pixels and the interpolation between them do to a step, px.
        const PIXELS_PX: f64 = 0.54;
        let sigma = (blur_px.powi(2) - PIXELS_PX.powi(2)).max(0.01).sqrt();
        Plane { first: self.mask.first, ..self.mask.coverage.blurred(sigma as f32) }
    }

    /// The part of the picture the body may cover: x0, y0, x1, y1, px.
    pub fn bounds(&self) -> (f64, f64, f64, f64) {
        let Mask { coverage, first, cell_px } = &self.mask;
        (first.x, first.y, first.x + cell_px * coverage.width as f64, first.y + cell_px * coverage.height as f64)
    }
}

/// The unit normal of a border in this direction on the side of what points out of the snake.
fn normal_of(along: Vector2<f64>, outward: Vector2<f64>) -> Option<Unit<Vector2<f64>>> {
    let normal = Unit::try_new(Vector2::new(-along.y, along.x), 1e-9)?;
    Some(if normal.dot(&outward) < 0.0 { -normal } else { normal })
}

fn border_point(mask: &Mask, lens: &Lens, candidate: &Candidate) -> Option<OutlinePoint> {
    let Candidate { body, piece, lateral, pixel, outward, along } = *candidate;
    if !lens.contains(&pixel, 1.0) {
        return None;
    }
    let normal = normal_of(along, outward)?;
    if !mask.has_border_at(&pixel, &normal) {
        return None;
    }
    let depth_px = mask.run_length(&pixel, -normal.into_inner(), true);
    let gap_px = mask.run_length(&pixel, normal.into_inner(), false);
    Some(OutlinePoint { body, piece, lateral, pixel, normal, gap_px, depth_px, predicted: Some(PredictedEdge::NOT) })
}

/// Rims and side walls of the disks and the holder.
fn cylinders(
    view: &Projection,
    psi: Configuration,
    spacing_mm: f64,
    candidates: &mut Vec<Candidate>,
    polygons: &mut Vec<Vec<Point2<f64>>>,
) {
    let body = &view.robot.body;
    // (piece number, section it is square to, near and far face from there): the holder is number 0, disks count from 1.
    let half = body.disk_thickness_mm / 2.0;
    let spacers =
        view.robot.spacer_middles_mm().into_iter().zip(1..).map(|(middle, number)| (number, middle, -half, half));
    let end = (body.spacer_disk_count + 1, view.robot.length_mm, -body.disk_thickness_mm, 0.0);
    for (number, s_mm, near_mm, far_mm) in std::iter::once((0, 0.0, -HOLDER_MM, 0.0)).chain(spacers).chain([end]) {
        let section = Section::new(view, psi, s_mm);
        let radius_mm = body.disk_diameter_mm / 2.0;
        polygons.push(Cylinder { number, section, radius_mm, near_mm, far_mm, spacing_mm }.outline(candidates));
    }
}

/// A disk or the holder as the camera sees it.
struct Cylinder<'a> {
    /// 0 for the holder; disks count from 1.
    number: u8,
    section: Section<'a>,
    radius_mm: f64,
    /// Its faces along the section's tangent, mm.
    near_mm: f64,
    far_mm: f64,
    /// Between candidates, mm.
    spacing_mm: f64,
}

impl Cylinder<'_> {
    /// Its outline in the picture, px.
    ///
    /// A rim is on it where just one of the two surfaces that meet in it is seen: in front, where the wall is, the rim of a
    /// face that is not, and at the back the rim of one that is. Sides, where the wall turns away, join them.
    fn outline(&self, candidates: &mut Vec<Candidate>) -> Vec<Point2<f64>> {
        let eye = self.section.eye();
        let (near_seen, far_seen) = (eye.z < self.near_mm, eye.z > self.far_mm);
        let Some((towards, half)) = grazing(eye.coords.xy(), self.radius_mm) else {
            return self.rim(far_seen, 0.0, [0.0, TAU], candidates);
        };
        let (before, after) = (towards - half, towards + half);
        let mut outline = self.rim(near_seen, towards, [before, after], candidates);
        let mut back = if near_seen || far_seen {
            self.rim(far_seen, towards, [after, before + TAU], candidates)
        } else {
            self.rim(true, towards, [after, before], candidates)
        };
        let before = self.side(-1, before, candidates);
        let after = self.side(1, after, candidates);
        let [front_face, back_face] = if near_seen { [1, 0] } else { [0, 1] };
        outline.insert(0, before[front_face]);
        outline.extend([after[front_face], after[back_face]]);
        outline.append(&mut back);
        outline.push(before[back_face]);
        outline
    }

    /// The rim of the near or far face from one angle about the axis to another.
    fn rim(&self, far: bool, towards: f64, [from, to]: [f64; 2], candidates: &mut Vec<Candidate>) -> Vec<Point2<f64>> {
        const FEWEST: f64 = 8.0;
        let steps = ((to - from).abs() * self.radius_mm / self.spacing_mm).ceil().max(FEWEST);
        let z = if far { self.far_mm } else { self.near_mm };
        // Any mix of the two surfaces' normals points out of the border.
        let slope = if far { 1.0 } else { -1.0 };
        let (towards_sin, towards_cos) = towards.sin_cos();
        let point = |step: usize| {
            let angle = from + (to - from) * (step as f64 + 0.5) / steps;
            let (sin, cos) = angle.sin_cos();
            let local = Vector3::new(self.radius_mm * cos, self.radius_mm * sin, z);
            let piece = match (self.number, far) {
                // The holder goes on beyond what is modelled of it.
                (0, false) => return self.section.pixel(local),
                (0, true) => Piece::BaseRim,
                (number, far) => Piece::Rim(number, far),
            };
            let (outward, along) = (Vector3::new(cos, sin, slope), Vector3::new(-sin, cos, 0.0));
            let lateral = (sin * towards_cos - cos * towards_sin).abs();
            let candidate = self.section.candidate(local, piece, lateral, outward, along);
            let pixel = candidate.pixel;
            candidates.push(candidate);
            pixel
        };
        (0..steps as usize).map(point).collect()
    }

    /// The side at an angle about the axis; gives its near and far ends.
    fn side(&self, side: i8, angle: f64, candidates: &mut Vec<Candidate>) -> [Point2<f64>; 2] {
        let radial = Vector2::new(angle.cos(), angle.sin());
        let at = |z: f64| (self.radius_mm * radial).push(z);
        let height_mm = self.far_mm - self.near_mm;
        let count = (height_mm / self.spacing_mm).floor().max(1.0);
        let piece = if self.number == 0 { Piece::HolderSide(side) } else { Piece::DiskSide(self.number, side) };
        candidates.extend((0..count as usize).map(|step| {
            let z = self.near_mm + height_mm * (step as f64 + 0.5) / count;
            self.section.candidate(at(z), piece, 0.0, radial.push(0.0), Vector3::z())
        }));
        [self.near_mm, self.far_mm].map(|z| self.section.pixel(at(z)))
    }
}

/// The two sides of each tube.
fn tubes(
    view: &Projection,
    psi: Configuration,
    spacing_px: f64,
    mm_per_px: f64,
    candidates: &mut Vec<Candidate>,
    polygons: &mut Vec<Vec<Point2<f64>>>,
) {
    let robot = view.robot;
    let steps = (robot.length_mm / (spacing_px * mm_per_px)).ceil().max(8.0) as usize;
    let mut axes = vec![(Vector2::zeros(), robot.primary.outer_diameter_mm / 2.0)];
    for azimuth in &robot.backbone_azimuths() {
        let offset = robot.backbone_circle_radius_mm * Vector2::new(azimuth.cos(), azimuth.sin());
        axes.push((offset, robot.secondary.outer_diameter_mm / 2.0));
    }
    let mut sides = vec![[Vec::with_capacity(steps), Vec::with_capacity(steps)]; axes.len()];
    for step in 0..steps {
        let section = Section::new(view, psi, robot.length_mm * (step as f64 + 0.5) / steps as f64);
        let eye = section.eye().coords.xy();
        for (number, &(offset, radius)) in axes.iter().enumerate() {
            for (side, radial) in tangent_directions(eye - offset, radius) {
                let local = (offset + radius * radial).push(0.0);
                let piece = Piece::Tube(number as u8, side, (section.s_mm / robot.disk_pitch_mm()) as u8);
                let candidate = section.candidate(local, piece, 0.0, radial.push(0.0), Vector3::z());
                sides[number][usize::from(side > 0)].push(candidate.pixel);
                candidates.push(candidate);
            }
        }
    }
    // In lengths that overlap: a bent tube's bounds are mostly empty.
    const LENGTH_PX: f64 = 40.0;
    const OVERLAP: usize = 2;
    let length = (LENGTH_PX / spacing_px).ceil() as usize;
    for [left, right] in sides {
        for start in (0..steps).step_by(length) {
            let part = start..(start + length + OVERLAP).min(left.len()).min(right.len());
            if let (Some(left), Some(right)) = (left.get(part.clone()), right.get(part)) {
                polygons.push(left.iter().chain(right.iter().rev()).copied().collect());
            }
        }
    }
}

/// The angles at which an observer at `eye` (same plane, centre at the origin) grazes a circle of this radius,
/// n · (eye − radius n) = 0: so far to either side of the angle towards the observer. None from inside the circle.
fn grazing(eye: Vector2<f64>, radius: f64) -> Option<(f64, f64)> {
    let distance = eye.norm();
    (distance > radius).then(|| (eye.y.atan2(eye.x), (radius / distance).acos()))
}

/// The two radial directions there, to the right and to the left of the one towards the observer. Tubes ask for thousands of them,
/// which are found without the angles.
fn tangent_directions(eye: Vector2<f64>, radius: f64) -> impl Iterator<Item = (i8, Vector2<f64>)> {
    let distance = eye.norm();
    let directions = (distance > radius).then(|| {
        let towards = eye / distance;
        // Cosine and sine of the angle to either side.
        let (cos, sin) = (radius / distance, (1.0 - (radius / distance).powi(2)).sqrt());
        let left = Vector2::new(-towards.y, towards.x);
        [(-1, cos * towards - sin * left), (1, cos * towards + sin * left)]
    });
    directions.into_iter().flatten()
}

impl Mask {
    /// The first step from a border pixel, px: what ends sooner is not the border.
    const FIRST_STEP_PX: f64 = 0.4;

    /// Draws the union of the polygons (px of the picture), on what they cover and [`Outline::REACH_PX`] around it.
    fn new(lens: &Lens, polygons: &[Vec<Point2<f64>>], cell_px: f64) -> Self {
        /// The snake may leave the picture by this much, px, before it cannot be drawn.
        const FURTHEST_PX: f64 = 2048.0;
        const MARGIN_PX: f64 = Outline::REACH_PX + 2.0;
        let (width, height) = (f64::from(lens.width), f64::from(lens.height));
        let fits = |p: &Point2<f64>| {
            (-FURTHEST_PX..width + FURTHEST_PX).contains(&p.x) && (-FURTHEST_PX..height + FURTHEST_PX).contains(&p.y)
        };
        let drawable = || polygons.iter().filter(|polygon| polygon.len() >= 3 && polygon.iter().all(fits));
        let Some((least, most)) = drawable().flatten().fold(None, |bounds: Option<(Point2<f64>, Point2<f64>)>, p| {
            bounds.map_or(Some((*p, *p)), |(least, most)| Some((least.inf(p), most.sup(p))))
        }) else {
            return Self { coverage: Plane::new(1, 1, vec![0.0]), first: Vector2::zeros(), cell_px };
        };
        let first = (least.coords - Vector2::repeat(MARGIN_PX)).map(f64::floor);
        let size = (most.coords - first + Vector2::repeat(MARGIN_PX)).map(|v| (v / cell_px).ceil() as usize + 1);
        let mut coverage = Plane::new(size.x, size.y, vec![0.0; size.x * size.y]);
        let mut rasterizer = Rasterizer::new(0, 0);
        let mut in_cells = Vec::new();
        for polygon in drawable() {
            in_cells.clear();
            in_cells.extend(polygon.iter().map(|p| Point2::from((p.coords - first) / cell_px)));
            coverage.cover(&in_cells, &mut rasterizer);
        }
        Self { coverage, first, cell_px }
    }

    fn covers(&self, pixel: &Point2<f64>) -> bool {
        self.coverage.sample(&Point2::from((pixel.coords - self.first) / self.cell_px)) > 0.5
    }

    /// Whether a pixel is on the mask's border, which faces this way.
    fn has_border_at(&self, pixel: &Point2<f64>, normal: &Vector2<f64>) -> bool {
        let step = normal * Self::FIRST_STEP_PX;
        self.covers(&(pixel - step)) && !self.covers(&(pixel + step))
    }

    /// How far, px, one can go from a border pixel before the mask is no longer `inside`.
    fn run_length(&self, from: &Point2<f64>, direction: Vector2<f64>, inside: bool) -> f64 {
        // A cell is exact enough further on: where it is, in cells from the mask's corner.
        let mut distance = Self::FIRST_STEP_PX + self.cell_px;
        let mut cell = (from.coords + direction * distance - self.first) / self.cell_px + Vector2::repeat(0.5);
        while distance < Outline::REACH_PX && (self.coverage.get(cell.x as i64, cell.y as i64) > 0.5) == inside {
            distance += self.cell_px;
            cell += direction;
        }
        distance.min(Outline::REACH_PX)
    }
}

impl Plane {
    /// Raises every pixel to the share of it that a polygon (in this plane's pixels, and within it) covers.
    fn cover(&mut self, polygon: &[Point2<f64>], rasterizer: &mut Rasterizer) {
        let (least, most) = polygon.iter().fold((polygon[0], polygon[0]), |(a, b), p| (a.inf(p), b.sup(p)));
        // Pixel centres are at integers; the rasterizer has pixel corners there.
        let corner = least.map(|v| (v + 0.5).floor() as usize);
        let from = corner.map(|v| v as f64 - 0.5);
        let size = (most - from).map(|v| v.ceil() as usize + 1);
        rasterizer.reset(size.x, size.y);
        let place = |p: &Point2<f64>| point((p.x - from.x) as f32, (p.y - from.y) as f32);
        for (a, b) in polygon.iter().zip(polygon.iter().cycle().skip(1)) {
            rasterizer.draw_line(place(a), place(b));
        }
        // Pixels come row by row; to work out the row from a pixel's number would be a division each.
        let (width, data) = (self.width, &mut self.data);
        let (mut first, mut column) = (corner.y * width + corner.x, 0);
        rasterizer.for_each_pixel(|_, share| {
            if share > 0.0
                && let Some(pixel) = data.get_mut(first + column)
            {
                *pixel = pixel.max(share.min(1.0));
            }
            column += 1;
            if column == size.x {
                (first, column) = (first + width, 0);
            }
        });
    }
}
