//! The body's silhouette as a raster, and how far it extends around a place of its border.

use crate::camera::Lens;
use crate::measure::image::plane::Plane;
use ab_glyph_rasterizer::{Rasterizer, point};
use nalgebra::{Point2, Vector2};

/// How far around a border point its surroundings are explored, px.
///
/// Convention: the search for an edge goes no further than this from a border point, and what lies further away does not reach
/// into an edge filter, of which the widest ends 9 px from its centre.
pub(super) const REACH_PX: f64 = 12.0;
/// The distance from a border point at which the raster must have changed sides, px.
///
/// Derived: less than half a pixel, so that the next pixel does not count, and more than the rasteriser's rounding.
const BORDER_STEP_PX: f64 = 0.4;
/// Parts of the snake further outside the picture than this are not drawn, px.
///
/// Convention: bounds the memory of the raster.
const FURTHEST_OUTSIDE_PX: f64 = 2048.0;
/// Empty margin around the silhouette, px.
///
/// Derived: [`REACH_PX`], and two pixels for the interpolation at its end.
const MARGIN_PX: f64 = REACH_PX + 2.0;

/// The body's silhouette over the part of the picture that it covers: the share of every cell that is snake.
#[derive(Debug, Clone)]
pub(super) struct Silhouette {
    coverage: Plane,
    /// The pixel at which the centre of the first cell is.
    first: Vector2<f64>,
    /// Side of a cell, px.
    cell_px: f64,
}

impl Silhouette {
    /// Draws the union of the polygons (px of the picture) in cells of `cell_px`, with a margin of [`MARGIN_PX`].
    pub fn new(lens: &Lens, polygons: &[Vec<Point2<f64>>], cell_px: f64) -> Self {
        let (width, height) = (f64::from(lens.width), f64::from(lens.height));
        let within = |v: f64, size: f64| (-FURTHEST_OUTSIDE_PX..size + FURTHEST_OUTSIDE_PX).contains(&v);
        let fits = |p: &Point2<f64>| within(p.x, width) && within(p.y, height);
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
            raise_to_coverage(&mut coverage, &in_cells, &mut rasterizer);
        }
        Self { coverage, first, cell_px }
    }

    /// Whether the body covers a pixel.
    pub fn covers(&self, pixel: &Point2<f64>) -> bool {
        self.coverage.sample(&Point2::from((pixel.coords - self.first) / self.cell_px)) > 0.5
    }

    /// Whether a pixel lies on the border and this unit normal points out of the silhouette there.
    pub fn has_border_at(&self, pixel: &Point2<f64>, normal: &Vector2<f64>) -> bool {
        let step = normal * BORDER_STEP_PX;
        // Most of what is no border is hidden, with snake on both sides.
        !self.covers(&(pixel + step)) && self.covers(&(pixel - step))
    }

    /// How far, px, one can go from a border pixel in a direction before the silhouette ends (`inside`) or begins; at most
    /// `most_px`.
    pub fn run_length(&self, from: &Point2<f64>, direction: Vector2<f64>, inside: bool, most_px: f64) -> f64 {
        let first_px = BORDER_STEP_PX + self.cell_px;
        // Away from the border the nearest cell is exact enough.
        let first = Point2::from((from.coords + direction * first_px - self.first) / self.cell_px);
        let most = ((most_px - first_px) / self.cell_px).ceil() as usize;
        let cells = self.coverage.nearest_along(first, direction).take(most);
        let passed = cells.take_while(|share| (*share > 0.5) == inside).count();
        (first_px + passed as f64 * self.cell_px).min(most_px)
    }

    /// The silhouette blurred by a Gaussian of this σ, px; for a raster whose cells are pixels.
    pub fn blurred(&self, sigma_px: f64) -> Plane {
        Plane { first: self.first, ..self.coverage.blurred(sigma_px as f32) }
    }

    /// The part of the picture that the raster covers: x0, y0, x1, y1, px.
    pub fn bounds(&self) -> (f64, f64, f64, f64) {
        let Self { coverage, first, cell_px } = self;
        (first.x, first.y, first.x + cell_px * coverage.width as f64, first.y + cell_px * coverage.height as f64)
    }
}

/// Raises every pixel of a plane to the share of it that a polygon (in this plane's pixels, and within it) covers.
fn raise_to_coverage(plane: &mut Plane, polygon: &[Point2<f64>], rasterizer: &mut Rasterizer) {
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
    // The rasterizer hands pixels on row by row. Counting columns saves a division for each.
    let (width, data) = (plane.width, &mut plane.data);
    let (mut first, mut column) = (corner.y * width + corner.x, 0);
    rasterizer.for_each_pixel(|_, share| {
        if let Some(pixel) = data.get_mut(first + column) {
            *pixel = pixel.max(share.min(1.0));
        }
        column += 1;
        if column == size.x {
            (first, column) = (first + width, 0);
        }
    });
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::measure::body::{BodyPoint, OutlinePoint, Piece};
    use crate::measure::fit::EdgeFinder;
    use crate::statistics::moments::mean;
    use approx::assert_relative_eq;
    use nalgebra::{Unit, Vector3};

    fn lens() -> Lens {
        Lens {
            width: 200,
            height: 200,
            focal_px: Vector2::repeat(500.0),
            centre_px: Point2::new(99.5, 99.5),
            distortion: [0.0; 12],
            fisheye: None,
        }
    }

    fn rectangle(left: f64, top: f64, right: f64, bottom: f64) -> Vec<Point2<f64>> {
        [(left, top), (right, top), (right, bottom), (left, bottom)].map(|(x, y)| Point2::new(x, y)).to_vec()
    }

    #[test]
    fn the_raster_of_a_union_covers_each_part_once() {
        let parts = [rectangle(40.0, 50.0, 80.0, 90.0), rectangle(60.0, 50.0, 120.5, 90.0)];
        let silhouette = Silhouette::new(&lens(), &parts, 1.0);
        let area: f32 = silhouette.coverage.data.iter().sum();
        assert_relative_eq!(area, 80.5 * 40.0, epsilon = 0.1);
    }

    #[test]
    fn the_border_is_found_and_the_way_to_the_next_one_measured() {
        for cell_px in [1.0, 2.0] {
            let parts = [rectangle(40.0, 50.0, 80.0, 90.0), rectangle(86.0, 50.0, 120.0, 90.0)];
            let silhouette = Silhouette::new(&lens(), &parts, cell_px);
            let (border, right) = (Point2::new(80.0, 70.0), Vector2::x());
            assert!(silhouette.has_border_at(&border, &right));
            assert!(!silhouette.has_border_at(&border, &-right));
            assert!(!silhouette.has_border_at(&Point2::new(60.0, 70.0), &right));
            let gap_px = silhouette.run_length(&border, right, false, REACH_PX);
            // The first step of 0.4 px, and a cell that is half covered counts as empty.
            assert!((gap_px - 6.0).abs() <= 1.5 * cell_px, "{gap_px}");
            assert_eq!(silhouette.run_length(&border, -right, true, REACH_PX), REACH_PX);
        }
    }

    #[test]
    fn what_is_far_outside_the_picture_is_not_drawn() {
        let silhouette = Silhouette::new(&lens(), &[rectangle(-1e6, 0.0, 10.0, 10.0)], 1.0);
        assert_eq!(silhouette.coverage.data, [0.0]);
    }

    /// The constant that outlines take the raster's own blur for.
    #[test]
    fn the_raster_has_the_blur_that_is_taken_off() {
        let blurs = (0..40).filter_map(|k| {
            // Straight borders in all directions and positions between pixels.
            let angle = 0.157 * f64::from(k);
            let normal = Vector2::new(angle.cos(), angle.sin());
            let along = Vector2::new(-normal.y, normal.x);
            let border = Point2::new(100.0 + 0.037 * f64::from(k), 100.0 - 0.071 * f64::from(k));
            let polygon = [(0.0, -30.0), (0.0, 30.0), (-30.0, 30.0), (-30.0, -30.0)];
            let polygon = polygon.map(|(across, forward)| border + normal * across + along * forward).to_vec();
            let silhouette = Silhouette::new(&lens(), &[polygon], 1.0);
            let plane = Plane { first: silhouette.first, ..silhouette.coverage.clone() };
            let point = OutlinePoint {
                face_px: 0.0,
                body: BodyPoint { s_mm: 0.0, local: Vector3::zeros() },
                piece: Piece::BaseRim,
                lateral: 0.0,
                pixel: border,
                normal: Unit::new_normalize(normal),
                gap_px: REACH_PX,
                depth_px: REACH_PX,
                predicted: None,
            };
            EdgeFinder::noiseless(&plane).find(&point, 3.0).map(|edge| edge.blur_px.powi(2))
        });
        let blurs: Vec<f64> = blurs.collect();
        assert_eq!(blurs.len(), 40);
        let blur_px = mean(blurs).sqrt();
        assert!((blur_px - crate::measure::body::outline::RASTER_BLUR_PX).abs() < 0.04, "{blur_px}");
    }
}
