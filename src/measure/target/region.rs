//! A convex part of a picture: what shows the sheet, or what the body hides of it.

use nalgebra::Point2;

/// A part of a picture: inside of a convex polygon.
#[derive(Debug, Clone, PartialEq)]
pub struct PictureRegion(pub Vec<Point2<f64>>);

impl PictureRegion {
    /// The convex hull of some pixels.
    pub fn around(pixels: impl IntoIterator<Item = Point2<f64>>) -> Self {
        let rounded: Vec<_> =
            pixels.into_iter().map(|p| imageproc::point::Point::new(p.x.round() as i32, p.y.round() as i32)).collect();
        let hull = if rounded.is_empty() { Vec::new() } else { imageproc::geometry::convex_hull(rounded.as_slice()) };
        Self(hull.into_iter().map(|corner| Point2::new(f64::from(corner.x), f64::from(corner.y))).collect())
    }

    /// The middle of the rectangle around it, px.
    pub fn middle(&self) -> Point2<f64> {
        let Some(first) = self.0.first() else { return Point2::origin() };
        let (low, high) = self.0.iter().fold((*first, *first), |(low, high), p| (low.inf(p), high.sup(p)));
        nalgebra::center(&low, &high)
    }

    /// Whether a pixel lies in it.
    pub fn contains(&self, pixel: &Point2<f64>) -> bool {
        let corners = self.0.iter().zip(self.0.iter().cycle().skip(1));
        let sides = corners.map(|(from, to)| (to - from).perp(&(pixel - from)));
        let (mut left, mut right) = (false, false);
        sides.for_each(|side| (left, right) = (left || side > 0.0, right || side < 0.0));
        !(left && right)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_convex_region_has_its_own_pixels_and_no_others() {
        let region = PictureRegion::around(
            [(0.0, 0.0), (10.0, 0.0), (10.0, 6.0), (0.0, 6.0), (5.0, 3.0)].map(|(x, y)| Point2::new(x, y)),
        );
        assert_eq!(region.middle(), Point2::new(5.0, 3.0));
        assert!(region.contains(&Point2::new(1.0, 5.0)) && !region.contains(&Point2::new(11.0, 3.0)));
    }
}
