//! The snake as solid shapes, and where a ray meets them.
//!
//! Disks and holder are capped cylinders, met in closed form. A tube is a circular arc with a round section; its signed
//! distance is known in closed form, straight or bent, and a ray is followed along it by Newton steps.

use crate::geometry::{Configuration, Pose};
use crate::robot::{BendProfile, Curve, Robot};
use nalgebra::{Point3, Translation3, Unit, Vector3};

/// A half-line in {b}.
#[derive(Debug, Clone, Copy)]
pub struct Ray {
    /// Where it starts.
    pub origin: Point3<f64>,
    /// Where it goes, of unit length.
    pub direction: Vector3<f64>,
}

/// Where a ray first meets a shape.
#[derive(Debug, Clone, Copy)]
pub struct Hit {
    /// How far along the ray, mm.
    pub distance: f64,
    /// The surface's outward normal, of unit length.
    pub normal: Vector3<f64>,
}

/// One part of the snake, in {b}.
#[derive(Debug, Clone)]
pub enum Shape {
    /// A disk or the holder.
    Cylinder(Cylinder),
    /// A piece of a tube.
    Tube(TubePiece),
}

/// A cylinder with flat ends.
#[derive(Debug, Clone)]
pub struct Cylinder {
    /// The middle of its far end.
    pub top: Point3<f64>,
    /// From its near end to its far end.
    pub axis: Unit<Vector3<f64>>,
    /// Its length, mm.
    pub length: f64,
    /// Its radius, mm.
    pub radius: f64,
}

/// The part of a tube that lies in a sphere around a piece of its axis.
#[derive(Debug, Clone)]
pub struct TubePiece {
    tube: Tube,
    /// Where the tube's first section is in {b}.
    start: Pose,
    /// The sphere; together those of a tube's pieces hold all of it.
    centre: Point3<f64>,
    sphere_radius: f64,
}

/// A tube of round section along a circular arc that starts at s = 0 along z, in the frame of its first section.
#[derive(Debug, Clone, Copy)]
struct Tube {
    /// Curvature κ = θ/L of the snake's own axis, 1/mm.
    curvature: f64,
    /// The direction that the arc bends towards, in the x–y plane.
    bend: Vector3<f64>,
    /// z × bend.
    side: Vector3<f64>,
    /// Offset Δ of this tube's axis along the bend, mm.
    bend_offset: f64,
    /// Offset of this tube's axis across the bend plane, mm.
    side_offset: f64,
    /// Outer radius, mm.
    radius: f64,
    /// The tube ends here, mm along the snake's axis.
    end: f64,
}

/// All parts of a snake bent like this.
pub fn body(robot: &Robot, profile: &BendProfile) -> Vec<Shape> {
    let curve = Curve::new(robot, profile);
    let cylinders = cylinders(robot, profile, &curve).map(Shape::Cylinder);
    cylinders.chain(tubes(robot, profile, &curve).into_iter().map(Shape::Tube)).collect()
}

/// Holder, spacer disks, end disk and tool.
fn cylinders(robot: &Robot, profile: &BendProfile, curve: &Curve) -> impl Iterator<Item = Cylinder> {
    let psi = Configuration::from_bend_vector(profile.tip);
    // In closed form where there is one.
    let frame_at = |s_mm: f64| if profile.is_arc() { robot.frame_at(psi, s_mm) } else { curve.frame_at(s_mm) };
    let disk_radius = robot.body.disk_diameter_mm / 2.0;
    // In short pieces, so that the renderer has few rays to try against each.
    let count = (robot.line.holder_length_mm / (4.0 * disk_radius)).ceil().clamp(1.0, 1000.0);
    let length = robot.line.holder_length_mm / count;
    let holder = (0..count as usize).map(move |k| Cylinder {
        top: Point3::new(0.0, 0.0, -length * k as f64),
        axis: Vector3::z_axis(),
        length,
        radius: disk_radius,
    });
    let disk = |middle: Pose| {
        let top = middle * Translation3::new(0.0, 0.0, robot.body.disk_thickness_mm / 2.0);
        Cylinder {
            top: top * Point3::origin(),
            axis: Unit::new_unchecked(top * Vector3::z()),
            length: robot.body.disk_thickness_mm,
            radius: disk_radius,
        }
    };
    // A spacer disk stands square on the axis at its middle; the end disk does so at its far face, where the axis ends.
    let spacers: Vec<_> = robot.spacer_middles_mm().into_iter().map(|middle| disk(frame_at(middle))).collect();
    let tip = frame_at(robot.length_mm);
    let end_disk = disk(tip * Translation3::new(0.0, 0.0, -robot.body.disk_thickness_mm / 2.0));
    let tool = robot.body.tool.map(|tool| Cylinder {
        top: tip * Point3::new(0.0, 0.0, tool.length_mm),
        axis: Unit::new_unchecked(tip * Vector3::z()),
        length: tool.length_mm,
        radius: tool.diameter_mm / 2.0,
    });
    holder.chain(spacers).chain([end_disk]).chain(tool)
}

/// Primary and secondary backbones, arc by arc, in pieces.
fn tubes(robot: &Robot, profile: &BendProfile, curve: &Curve) -> Vec<TubePiece> {
    // The tubes end within the end disk, so that no end shows.
    let end = robot.length_mm - robot.body.disk_thickness_mm / 2.0;
    let arcs: Vec<_> =
        if profile.is_arc() { vec![(Pose::identity(), profile.tip, robot.length_mm)] } else { curve.arcs().collect() };
    let last = arcs.len() - 1;
    let pieces = arcs.into_iter().enumerate().flat_map(|(k, (start, bend, length_mm))| {
        let length_to_end = if k == last { length_mm - (robot.length_mm - end) } else { length_mm };
        let arc = Configuration::from_bend_vector(bend);
        let (sin, cos) = arc.delta.sin_cos();
        let circle = robot.backbone_directions().map(|direction| {
            let offset = direction * robot.backbone_circle_radius_mm;
            let (along, aside) = (offset.x * cos + offset.y * sin, offset.y * cos - offset.x * sin);
            (along, aside, robot.secondary.outer_diameter_mm)
        });
        let centre = [(0.0, 0.0, robot.primary.outer_diameter_mm)];
        let tube = move |(bend_offset, side_offset, diameter): (f64, f64, f64)| Tube {
            curvature: arc.theta / length_mm,
            bend: Vector3::new(cos, sin, 0.0),
            side: Vector3::new(-sin, cos, 0.0),
            bend_offset,
            side_offset,
            radius: diameter / 2.0,
            end: length_to_end,
        };
        centre.into_iter().chain(circle.to_vec()).flat_map(move |tube_of| tube(tube_of).pieces(start))
    });
    pieces.collect()
}

/// How far an arc of this curvature has come sideways and up after a length s.
fn arc(curvature: f64, s: f64) -> (f64, f64) {
    let half = curvature * s / 2.0;
    let sinc = if half.abs() < 1e-8 { 1.0 } else { half.sin() / half };
    (s * sinc * half.sin(), s * sinc * half.cos())
}

impl Shape {
    /// Where a ray first meets the shape from outside.
    pub fn meet(&self, ray: &Ray) -> Option<Hit> {
        match self {
            Self::Cylinder(cylinder) => cylinder.meet(ray),
            Self::Tube(piece) => piece.meet(ray),
        }
    }

    /// Spheres (middle, radius) whose convex hull holds the shape.
    pub fn bounds(&self) -> Vec<(Point3<f64>, f64)> {
        match self {
            Self::Cylinder(c) => vec![(c.top, c.radius), (c.top - c.length * c.axis.into_inner(), c.radius)],
            Self::Tube(piece) => vec![(piece.start * piece.centre, piece.sphere_radius)],
        }
    }
}

impl Cylinder {
    fn meet(&self, ray: &Ray) -> Option<Hit> {
        let from_top = ray.origin - self.top;
        // Along the axis and across it.
        let (height, climb) = (from_top.dot(&self.axis), ray.direction.dot(&self.axis));
        let across = from_top - height * self.axis.into_inner();
        let drift = ray.direction - climb * self.axis.into_inner();

        let end = if climb < 0.0 { 0.0 } else { -self.length };
        let to_end = (end - height) / climb;
        if to_end > 0.0 && (across + to_end * drift).norm_squared() <= self.radius * self.radius {
            return Some(Hit { distance: to_end, normal: -climb.signum() * self.axis.into_inner() });
        }
        let (a, b) = (drift.norm_squared(), across.dot(&drift));
        let discriminant = b * b - a * (across.norm_squared() - self.radius * self.radius);
        if discriminant <= 0.0 {
            return None;
        }
        let distance = (-b - discriminant.sqrt()) / a;
        let at = height + distance * climb;
        (distance > 0.0 && (-self.length..=0.0).contains(&at))
            .then(|| Hit { distance, normal: (across + distance * drift) / self.radius })
    }
}

impl Tube {
    /// Pieces of about two diameters' length: within one the axis hardly bends.
    fn pieces(self, start: Pose) -> impl Iterator<Item = TubePiece> {
        let count = (self.end / (6.0 * self.radius)).ceil().clamp(1.0, 1000.0);
        // The tube's own axis is longer than the snake's on the outside of the bend.
        let half_length = self.end / count / 2.0 * (1.0 + (self.curvature * self.bend_offset).abs());
        (0..count as usize).map(move |k| TubePiece {
            tube: self,
            start,
            centre: self.axis_at((k as f64 + 0.5) * self.end / count),
            sphere_radius: half_length.hypot(self.radius) + self.radius,
        })
    }

    /// The tube's axis at the snake's arc length s.
    fn axis_at(&self, s: f64) -> Point3<f64> {
        let (along, up) = arc(self.curvature, s);
        let (sin, cos) = (self.curvature * s).sin_cos();
        Point3::origin()
            + (along + self.bend_offset * cos) * self.bend
            + self.side_offset * self.side
            + (up - self.bend_offset * sin) * Vector3::z()
    }

    /// Distance from the surface (negative inside) and its gradient.
    ///
    /// With a along the bend, c along z_b and κ the curvature, a circle of curvature κ through the origin has the
    /// distance (κ (a² + c²) − 2 a) / (1 + w), w = √((1 − κ a)² + κ² c²): the usual √(…) − 1/κ without the cancellation
    /// that would make a straight tube singular.
    fn distance(&self, point: &Point3<f64>) -> (f64, Vector3<f64>) {
        let (a, c) = (point.coords.dot(&self.bend), point.z);
        let across = point.coords.dot(&self.side) - self.side_offset;
        let kappa = self.curvature;
        let inward = 1.0 - kappa * a;
        let w = (inward * inward + kappa * kappa * c * c).sqrt();
        let outward = (kappa * (a * a + c * c) - 2.0 * a) / (1.0 + w) + self.bend_offset;
        let from_axis = (outward * outward + across * across).sqrt();
        let outward_slope = -inward / w * self.bend + kappa * c / w * Vector3::z();
        let gradient = (outward * outward_slope + across * self.side) / from_axis;
        (from_axis - self.radius, gradient)
    }

    /// The arc length of the cross-section that a point lies in, mm.
    fn arc_length(&self, point: &Point3<f64>) -> f64 {
        let kappa = self.curvature;
        let angle = (kappa * point.z).atan2(1.0 - kappa * point.coords.dot(&self.bend));
        if kappa < 1e-9 { point.z } else { angle / kappa }
    }
}

impl TubePiece {
    fn meet(&self, ray: &Ray) -> Option<Hit> {
        if self.start == Pose::identity() {
            return self.meet_here(ray);
        }
        let (origin, direction) = (self.start.inverse() * ray.origin, self.start.inverse() * ray.direction);
        let hit = self.meet_here(&Ray { origin, direction })?;
        Some(Hit { normal: self.start * hit.normal, ..hit })
    }

    /// The same in the frame of the tube's first section.
    fn meet_here(&self, ray: &Ray) -> Option<Hit> {
        let from_centre = ray.origin - self.centre;
        let middle = -from_centre.dot(&ray.direction);
        let half_chord2 = self.sphere_radius.powi(2) - from_centre.norm_squared() + middle * middle;
        if half_chord2 <= 0.0 {
            return None;
        }
        let leave = middle + half_chord2.sqrt();
        let mut distance = middle - half_chord2.sqrt();
        // The distance from a straight tube is convex along a ray, and Newton's method does not step over its first
        // root; a piece is straight enough for that.
        for _ in 0..40 {
            let point = ray.origin + distance * ray.direction;
            let (gap, gradient) = self.tube.distance(&point);
            if gap.abs() < 1e-7 {
                let s = self.tube.arc_length(&point);
                let on_tube = distance > 0.0 && (-self.tube.radius..=self.tube.end).contains(&s);
                return on_tube.then_some(Hit { distance, normal: gradient });
            }
            let approach = -gradient.dot(&ray.direction);
            if approach <= 0.0 || gap.is_nan() {
                return None;
            }
            distance += gap / approach;
            if distance > leave {
                return None;
            }
        }
        None
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use approx::assert_abs_diff_eq;
    use nalgebra::Vector2;
    use proptest::prelude::*;

    fn nearest(shapes: &[Shape], ray: &Ray) -> Option<Hit> {
        shapes.iter().filter_map(|s| s.meet(ray)).min_by(|a, b| a.distance.total_cmp(&b.distance))
    }

    #[test]
    fn a_straight_snake_has_its_drawing_s_measures() {
        let shapes = body(&Robot::default(), &BendProfile::arc(Vector2::zeros()));
        let from_camera = |x: f64, z: f64| {
            let ray = Ray { origin: Point3::new(x, -100.0, z), direction: Vector3::y() };
            nearest(&shapes, &ray).map(|hit| -100.0 + hit.distance)
        };
        // Holder and end disk: a circle of radius 2.1.
        for z in [-50.0, -0.001, 25.999, 25.401, 26.0 / 7.0 - 0.299, 26.0 / 7.0 + 0.299] {
            assert_abs_diff_eq!(from_camera(0.0, z).unwrap(), -2.1, epsilon = 1e-9);
            assert_abs_diff_eq!(from_camera(1.2, z).unwrap(), -(2.1f64.powi(2) - 1.44).sqrt(), epsilon = 1e-9);
            assert!(from_camera(2.101, z).is_none() && from_camera(-2.101, z).is_none());
        }
        assert!(from_camera(0.0, 26.001).is_none());
        // Between the disks: backbone 1 at x = 1.5, backbone 2 at azimuth −120°, that is before the others.
        for z in [1.0, 13.0, 24.0] {
            assert_abs_diff_eq!(from_camera(1.5, z).unwrap(), -0.33, epsilon = 1e-6);
            assert_abs_diff_eq!(from_camera(-0.75, z).unwrap(), -1.5 * 0.75f64.sqrt() - 0.33, epsilon = 1e-6);
            assert_abs_diff_eq!(from_camera(0.2, z).unwrap(), -(0.33f64.powi(2) - 0.04).sqrt(), epsilon = 1e-6);
            assert!(from_camera(1.5 + 0.3301, z).is_none() && from_camera(1.5 - 0.3301, z).is_none());
        }
    }

    #[test]
    fn a_bent_snake_s_end_disk_is_where_eq_2_puts_it() {
        // A quarter circle towards +y: tip at L/θ (0, 1, 1), its end face looking along y.
        let shapes = body(&Robot::default(), &BendProfile::arc(Configuration::from_degrees(90.0, 90.0).bend_vector()));
        let rho = 26.0 / (std::f64::consts::PI / 2.0);
        let ray = Ray { origin: Point3::new(0.5, 200.0, rho + 1.0), direction: -Vector3::y() };
        let hit = nearest(&shapes, &ray).unwrap();
        assert_abs_diff_eq!(200.0 - hit.distance, rho, epsilon = 1e-9);
        assert_abs_diff_eq!(hit.normal, Vector3::y(), epsilon = 1e-9);
    }

    proptest! {
        /// Whatever a ray meets is on a surface, looks at the ray, and nothing of the body was passed before it.
        #[test]
        fn a_ray_meets_the_nearest_surface(
            theta_deg in 0.0..120.0, delta_deg in -180.0..180.0, azimuth in -3.2..3.2, height in -1.0..1.0f64,
            aim in proptest::array::uniform3(0.0..1.0f64), which in 0usize..4,
        ) {
            let robot = Robot::default();
            let psi = Configuration::from_degrees(theta_deg, delta_deg);
            let shapes = body(&robot, &BendProfile::arc(psi.bend_vector()));
            // Aimed at a point on or near one of the tubes.
            let tubes: Vec<Tube> =
                shapes.iter().filter_map(|s| if let Shape::Tube(p) = s { Some(p.tube) } else { None }).collect();
            let tube = tubes[which * tubes.len() / 4];
            let target = tube.axis_at(26.0 * aim[0]) + Vector3::new(aim[1] - 0.5, aim[2] - 0.5, 0.0);
            let flat = f64::sqrt(1.0 - height * height);
            let direction: Vector3<f64> = Vector3::new(flat * f64::cos(azimuth), flat * f64::sin(azimuth), height);
            let ray = Ray { origin: target - 200.0 * direction, direction };
            let hit = nearest(&shapes, &ray);

            let end = hit.map_or(260.0, |hit| hit.distance);
            if let Some(hit) = hit {
                prop_assert!((hit.normal.norm() - 1.0).abs() < 1e-6);
                prop_assert!(hit.normal.dot(&direction) < 1e-6);
            }
            for step in 0..4000 {
                let t = 160.0 + 0.02 * f64::from(step);
                if t > end - 1e-3 { break }
                let point = ray.origin + t * direction;
                for tube in &tubes {
                    let inside = tube.distance(&point).0 < -1e-3 && (0.0..=tube.end).contains(&tube.arc_length(&point));
                    prop_assert!(!inside, "passed a tube at {t}, hit at {end}");
                }
            }
        }

        #[test]
        fn a_tube_s_distance_is_that_from_its_axis(
            theta_deg in 0.0..120.0, delta_deg in -180.0..180.0, s in 0.0..25.0, offset in proptest::array::uniform2(-1.0..1.0f64),
        ) {
            let robot = Robot::default();
            let psi = Configuration::from_degrees(theta_deg, delta_deg);
            let frame = robot.frame_at(psi, s);
            for shape in body(&robot, &BendProfile::arc(psi.bend_vector())) {
                let Shape::Tube(piece) = shape else { continue };
                // A point in the cross-section at s, offset from the tube's axis.
                let axis = piece.tube.axis_at(s);
                let point = axis + frame * Vector3::new(offset[0], offset[1], 0.0);
                let (gap, found) = (piece.tube.distance(&point).0, piece.tube.arc_length(&point));
                prop_assert!((gap + piece.tube.radius - offset[0].hypot(offset[1])).abs() < 1e-9);
                prop_assert!((found - s).abs() < 1e-6);
            }
        }
    }
}
