//! Sub-pixel edges between snake and background: the extrema of the picture's slope along the normals of the model's outline.
//!
//! A profile along the normal is filtered with the first derivative of a Gaussian; the edge is where the slope is largest, placed by
//! a parabola through three samples.
//!
//! Source: J. Canny, "A Computational Approach to Edge Detection", IEEE PAMI 8, 1986, for the filter.

use crate::measure::body::OutlinePoint;
use crate::measure::image::plane::{LANES, Plane, Region};
use std::f64::consts::PI;

/// An edge found near a predicted border point.
#[derive(Debug, Clone, Copy)]
pub struct Edge {
    /// Distance from the prediction along its outward normal, px.
    pub offset_px: f64,
    /// Standard deviation of `offset_px`, px: the picture's noise, and what the edge's surroundings may do to it.
    pub sigma_px: f64,
    /// Blur of the edge, px: the σ of the Gaussian that makes a sharp step look like it.
    pub blur_px: f64,
}

/// Finds edges in one picture.
#[derive(Debug, Clone)]
pub struct EdgeFinder<'a> {
    plane: &'a Plane,
    two_sided: bool,
    /// The filter's weights for the samples 1, 2, … `reach` steps away; those on the other side have the opposite sign.
    kernel: [f32; MOST_REACH],
    reach: usize,
    /// σ of the Gaussian whose derivative the filter is, px.
    filter_px: f64,
    /// The picture's noise, σ of a pixel.
    noise: f64,
    /// The noise of the filtered slope, σ per px.
    slope_noise: f64,
    /// How far around an edge its surroundings are examined, px.
    neighbourhood_px: f64,
}

/// Distance between samples of a profile, px.
///
/// Derived: the picture has nothing finer than two pixels a period, so that two samples a pixel lose nothing.
const STEP_PX: f64 = 0.5;
/// σ of the usual filter, px.
///
/// Source: Canny 1986: the best filter for a step in noise is as wide as the step's blur; 1.2 px is about a lens' own.
const FILTER_PX: f64 = 1.2;
/// No picture is sharper than this, σ in px, and no filter finer.
///
/// Derived: a pixel is a box of one pixel, with a σ of 0.29 px, and interpolation between pixels adds 0.41 px.
pub(super) const SHARPEST_PX: f64 = 0.5;
/// σ of the widest filter, px: a wider one would reach from one rim of a disk to the other.
///
/// Fitted: on 62 blurred renders, of which 50 were then measured, none falsely, and 43 with the usual filter.
const WIDEST_PX: f64 = 3.0;
/// How far a filter reaches to either side, in units of its σ.
///
/// Convention: beyond, the derivative of a Gaussian is below 6 % of its largest value.
const REACH: f64 = 3.0;
/// The number of steps that the widest filter reaches.
///
/// Derived: from the three above.
const MOST_REACH: usize = (REACH * WIDEST_PX / STEP_PX) as usize;
/// The least slope that counts as an edge, of the contrast between snake and background per px.
///
/// Convention: a sharp step of 6 % of the contrast has this slope after the usual filter. Of 273 frames of photo-realistic sets none is lost or won
/// without it.
const LEAST_SLOPE: f64 = 0.02;
/// The least slope in units of the slope's noise.
///
/// Derived: noise exceeds 5σ once in 3.5 million samples; the profiles of a frame have some ten thousands.
const LEAST_SLOPE_SIGMAS: f64 = 5.0;
/// A filter is wide enough if a step of this share of the contrast between snake and background stands out of the noise.
///
/// Convention: half; the discriminant of a border that is dim on the snake or dark beside it falls by less than the contrast.
const SEEN_STEP: f64 = 0.5;
/// From one filter that noise leaves too fine to the next.
///
/// Convention: a width that is a tenth off makes no difference that counts.
const WIDER: f64 = 1.1;
/// How far around an edge its surroundings are examined, px.
///
/// Fitted: by hand on renders; judged as part of the whole noise model by `tests/eye/uncertainty`.
const NEIGHBOURHOOD_PX: f64 = 5.0;
/// How far an opposite edge as steep as the edge itself displaces it, px (1σ); less steep ones in proportion.
///
/// Fitted: by hand on renders; judged as part of the whole noise model by `tests/eye/uncertainty`.
const NEIGHBOUR_PULL_PX: f64 = 1.0;
/// The furthest that edges are searched for, px.
///
/// Convention: bounds the arrays; it is the widest search distance of all schedules.
const FURTHEST_PX: f64 = 14.0;
/// How far around a border point print that cannot be looked through hides its edge, px.
///
/// Derived: the usual filter (σ = 1.2 px) ends at 3.6 px.
const HIDING_PX: i32 = 4;
/// The most slopes along a profile to either side of its middle.
///
/// Derived: from the furthest search and the neighbourhood of an edge at its end.
const MOST_SLOPES: usize = ((FURTHEST_PX + NEIGHBOURHOOD_PX) / STEP_PX) as usize + 1;

/// σ of the filter for edges of this blur, px: as wide as the blur, within what is useful.
pub(super) fn filter_px(blur_px: f64) -> f64 {
    blur_px.clamp(FILTER_PX, WIDEST_PX)
}

impl<'a> EdgeFinder<'a> {
    /// A finder for a picture in which the snake is brighter than its background or, if `two_sided`, different from it.
    pub fn new(plane: &'a Plane, two_sided: bool) -> Self {
        let whole = Region::whole(plane.width as u32, plane.height as u32);
        Self::with_noise(plane, two_sided, plane.noise(&whole))
    }

    /// The same for a picture whose noise, σ of a pixel, is known.
    pub fn with_noise(plane: &'a Plane, two_sided: bool, noise: f64) -> Self {
        let finder = Self { two_sided, neighbourhood_px: NEIGHBOURHOOD_PX, noise, ..Self::noiseless(plane) };
        finder.with_filter(FILTER_PX)
    }

    /// The same for a snake that is different from its background, be it brighter or darker.
    pub fn either_way(&self) -> Self {
        Self { two_sided: true, ..self.clone() }
    }

    /// The same with the filter for the coarse stages: as wide as the blur. A filter much narrower than the blur finds more noise than
    /// edge, and takes the edge for as sharp as noise is.
    pub fn coarse_for_blur(&self, blur_px: f64) -> Self {
        self.with_filter(filter_px(blur_px))
    }

    /// The same with the filter for the fine stage, in which edges are known to be near: as wide as the blur, which places an edge in noise best, or as
    /// much wider as it takes for an edge to stand out of the noise. A gradient of the brightness beside an edge displaces it in proportion to
    /// blur² + filter².
    pub fn fine_for_blur(&self, blur_px: f64) -> Self {
        let coarse = self.coarse_for_blur(blur_px);
        let finest = Some(blur_px.clamp(SHARPEST_PX, WIDEST_PX));
        let widths = std::iter::successors(finest, |width| Some(width * WIDER));
        let mut finer = widths.take_while(|width| *width < coarse.filter_px).map(|width| self.with_filter(width));
        finer.find(|finer| finer.shows_step(blur_px)).unwrap_or(coarse)
    }

    /// Whether a step of the least height that must be seen, with this blur, stands out of the noise.
    fn shows_step(&self, blur_px: f64) -> bool {
        let slope = SEEN_STEP / ((2.0 * PI).sqrt() * self.spread_px(blur_px));
        slope > LEAST_SLOPE_SIGMAS * self.slope_noise
    }

    /// The blur of an edge after the filter, σ in px, whose own blur is this.
    pub(super) fn spread_px(&self, blur_px: f64) -> f64 {
        blur_px.hypot(self.filter_px)
    }

    /// A finder with the same filter for a picture of the model, see [`noiseless`](Self::noiseless).
    pub fn for_model<'b>(&self, plane: &'b Plane) -> EdgeFinder<'b> {
        EdgeFinder::noiseless(plane).with_filter(self.filter_px)
    }

    /// A finder for a picture of the model, without noise and with nothing around its edges that is not its own.
    pub fn noiseless(plane: &'a Plane) -> Self {
        let bare = Self {
            plane,
            two_sided: false,
            kernel: [0.0; MOST_REACH],
            reach: 0,
            filter_px: 0.0,
            noise: 0.0,
            slope_noise: 0.0,
            neighbourhood_px: STEP_PX,
        };
        bare.with_filter(FILTER_PX)
    }

    fn with_filter(&self, filter_px: f64) -> Self {
        let reach = ((REACH * filter_px / STEP_PX).ceil() as usize).min(MOST_REACH);
        let away = |k: usize| (k + 1) as f64 * STEP_PX;
        let weight = |k: usize| if k < reach { away(k) * (-0.5 * (away(k) / filter_px).powi(2)).exp() } else { 0.0 };
        // Normalised so that a ramp of one level per px answers 1.
        let ramp: f64 = (0..reach).map(|k| 2.0 * weight(k) * away(k)).sum();
        let kernel = std::array::from_fn(|k| (weight(k) / ramp) as f32);
        let norm2: f64 = kernel.iter().map(|w| 2.0 * f64::from(*w).powi(2)).sum();
        Self { kernel, reach, filter_px, slope_noise: self.noise * norm2.sqrt(), ..*self }
    }

    /// How far the filter reaches to either side, px.
    fn reach_px(&self) -> f64 {
        REACH * self.filter_px
    }

    /// Whether only one edge lies within the filter at an outline point.
    pub(super) fn is_clear(&self, point: &OutlinePoint) -> bool {
        point.gap_px.min(point.depth_px) >= self.reach_px()
    }

    /// Whether print that cannot be looked through is within the filter's reach of a border point.
    pub fn is_hidden(&self, point: &OutlinePoint) -> bool {
        let at = |k: i32| point.pixel + point.normal.into_inner() * f64::from(k);
        !self.plane.hidden.is_empty() && (-HIDING_PX..=HIDING_PX).any(|k| self.plane.is_hidden(&at(k)))
    }

    /// The most likely edge within `search_px` (at most 14) of a border point: the picture must fall from snake to background there,
    /// steeply enough to stand out of the noise. The search ends where other parts of the snake begin.
    pub fn find(&self, point: &OutlinePoint, search_px: f64) -> Option<Edge> {
        if self.is_hidden(point) {
            return None;
        }
        let search_px = search_px.min(FURTHEST_PX);
        let outward = search_px.min(point.gap_px);
        let inward = search_px.min(point.depth_px);
        let examined = (self.examined_steps(point.depth_px), self.examined_steps(point.gap_px));
        let steps = |px: f64, examined: usize| (whole_steps(px) + examined.max(1)).min(MOST_SLOPES);
        let (inside, outside) = (steps(inward, examined.0), steps(outward, examined.1));
        let count = inside + outside + 1;
        let mut slopes = [[0.0; LANES]; (2 * MOST_SLOPES + 1).div_ceil(LANES)];
        let slopes = &mut slopes[..count.div_ceil(LANES)];
        self.slopes(point, inside, count, slopes);
        let slopes = &mut slopes.as_flattened_mut()[..count];

        let position = |k: usize| (k as f64 - inside as f64) * STEP_PX;
        let (first, last) = (inside - whole_steps(inward), inside + whole_steps(outward));
        let mut best: Option<(usize, f64)> = None;
        for (k, around) in (first..).zip(slopes[first - 1..last + 2].windows(3)) {
            let steepness = |slope: f32| if self.two_sided { slope.abs() } else { slope };
            let (before, here, after) = (steepness(around[0]), steepness(around[1]), steepness(around[2]));
            // Where the picture rises there is no edge of the snake.
            if here > 0.0 && here >= before && here > after {
                // The prediction's own error is Gaussian, its σ the search distance.
                let likelihood = f64::from(here) * (-0.5 * (position(k) / search_px).powi(2)).exp();
                best = best.filter(|(_, most)| *most > likelihood).or(Some((k, likelihood)));
            }
        }
        let (best, _) = best?;
        if slopes[best] < 0.0 {
            slopes.iter_mut().for_each(|slope| *slope = -*slope);
        }
        let edge = self.edge_at(slopes, best, examined)?;
        Some(Edge { offset_px: position(best) + edge.offset_px, ..edge })
    }

    /// How many steps beyond an edge its surroundings are examined, if the next edge of the snake is so far away: up to where the filter reaches that.
    fn examined_steps(&self, next_px: f64) -> usize {
        whole_steps((next_px - self.reach_px()).clamp(0.0, self.neighbourhood_px))
    }

    /// The edge at a peak of the slopes, its offset counted from the peak's sample; so many steps inwards and outwards of it are examined. `None` if it does not
    /// stand out of the noise.
    fn edge_at(&self, slopes: &[f32], peak: usize, (inward, outward): (usize, usize)) -> Option<Edge> {
        // A step of height h with blur σ has slope h/(σ√2π) and, filtered, curvature slope/(σ² + filter²).
        let [before, slope, after] = [peak - 1, peak, peak + 1].map(|k| f64::from(slopes[k]));
        let curvature = (2.0 * slope - before - after) / (STEP_PX * STEP_PX);
        if slope < LEAST_SLOPE.max(LEAST_SLOPE_SIGMAS * self.slope_noise) || curvature <= 0.0 {
            return None;
        }
        let vertex = 0.5 * (after - before) / (STEP_PX * curvature);
        // The noise of the slope's derivative over the curvature; differentiating a Gaussian filter multiplies noise by 1/σ.
        let noise_px = self.slope_noise / self.filter_px / curvature;
        // Where a clean edge is flat, a highlight along the rim or a printed line beside the border rises and displaces the edge. The next edge of the
        // snake itself is none of these.
        let around = &slopes[peak.saturating_sub(inward)..=(peak + outward).min(slopes.len() - 1)];
        let rise = f64::from(-least(around).min(0.0)) - 2.0 * self.slope_noise;
        let pull_px = NEIGHBOUR_PULL_PX * (rise.max(0.0) / slope).min(1.0);
        Some(Edge {
            offset_px: vertex.clamp(-STEP_PX, STEP_PX),
            sigma_px: (noise_px.powi(2) + pull_px.powi(2)).sqrt(),
            blur_px: (slope / curvature - self.filter_px.powi(2)).max(0.0).sqrt(),
        })
    }

    /// The picture's filtered slopes along a border point's normal, a fall outwards counted positive; the first is `inside` steps on
    /// the snake. `count` of them are needed.
    fn slopes(&self, point: &OutlinePoint, inside: usize, count: usize, slopes: &mut [[f32; LANES]]) {
        let reach = self.reach;
        let mut samples = [[0.0; LANES]; (2 * (MOST_SLOPES + MOST_REACH) + 1).div_ceil(LANES) + 1];
        let needed = (count + 2 * reach).div_ceil(LANES);
        let step = point.normal.into_inner() * STEP_PX;
        self.plane.profile(&(point.pixel - step * (inside + reach) as f64), step, &mut samples[..needed]);
        for (group, slopes) in slopes.iter_mut().enumerate() {
            let around = &samples.as_flattened()[group * LANES..][..LANES + 2 * reach];
            let inner = around[..reach + LANES - 1].windows(LANES).rev();
            let outer = around[reach + 1..].windows(LANES);
            let mut sums = [0.0; LANES];
            for ((weight, inner), outer) in self.kernel[..reach].iter().zip(inner).zip(outer) {
                for (sum, (inner, outer)) in sums.iter_mut().zip(inner.iter().zip(outer)) {
                    *sum += weight * (inner - outer);
                }
            }
            *slopes = sums;
        }
    }
}

/// How many steps of a profile a distance has room for.
fn whole_steps(px: f64) -> usize {
    (px / STEP_PX) as usize
}

/// The least of some values, which are no NaN, in lanes side by side.
fn least(values: &[f32]) -> f32 {
    let (groups, rest) = values.as_chunks::<LANES>();
    let lesser = |a: f32, b: f32| if b < a { b } else { a };
    let mut lanes = [f32::INFINITY; LANES];
    for group in groups {
        lanes.iter_mut().zip(group).for_each(|(least, value)| *least = lesser(*least, *value));
    }
    lanes.iter().chain(rest).copied().fold(f32::INFINITY, lesser)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::measure::body::{BodyPoint, Piece};
    use crate::statistics::moments::rms;
    use crate::statistics::order::median;
    use nalgebra::{Point2, Unit, Vector2, Vector3};
    use rand::{SeedableRng, rngs::StdRng};
    use rand_distr::{Distribution, Normal};

    const WIDTH: usize = 80;
    const HEIGHT: usize = 400;
    const BORDER_PX: f64 = 40.3;

    /// The left half of a picture is snake, seen through a blur (px) and noise.
    fn picture(blur_px: f64, noise: f64) -> Plane {
        // A Gaussian's integral, by the sum of its middles over steps of 0.01 σ.
        let share = |x: f64| {
            let z = (x - BORDER_PX) / blur_px;
            let density = |k: i32| (-0.5 * (f64::from(k) * 0.01).powi(2)).exp();
            (-500..500).filter(|&k| f64::from(k) * 0.01 > z).map(density).sum::<f64>() * 0.01
                / (2.0 * std::f64::consts::PI).sqrt()
        };
        let clean: Vec<f64> = (0..WIDTH).map(|x| share(x as f64)).collect();
        let mut random = StdRng::seed_from_u64(11);
        let noise = Normal::new(0.0, noise).unwrap();
        let data = (0..WIDTH * HEIGHT).map(|k| (clean[k % WIDTH] + noise.sample(&mut random)) as f32).collect();
        Plane::new(WIDTH, HEIGHT, data)
    }

    fn point(row: usize) -> OutlinePoint {
        OutlinePoint {
            body: BodyPoint { s_mm: 0.0, local: Vector3::zeros() },
            piece: Piece::BaseRim,
            lateral: 0.0,
            face_px: 0.0,
            pixel: Point2::new(BORDER_PX, row as f64),
            normal: Unit::new_unchecked(Vector2::x()),
            gap_px: 12.0,
            depth_px: 12.0,
            predicted: None,
        }
    }

    /// The median blur of the edges that a finder sees, and their root mean square distance from the border, px.
    fn seen(finder: &EdgeFinder) -> (f64, f64) {
        let edges: Vec<Edge> = (20..HEIGHT - 20).step_by(10).filter_map(|y| finder.find(&point(y), 6.0)).collect();
        assert!(edges.len() > 30, "{} edges", edges.len());
        let blur_px = median(&mut edges.iter().map(|e| e.blur_px as f32).collect::<Vec<_>>());
        let scatter_px = rms(edges.iter().map(|edge| edge.offset_px));
        (f64::from(blur_px), scatter_px)
    }

    #[test]
    fn a_clean_edge_has_the_blur_it_was_made_with() {
        for blur_px in [0.9, 1.5, 3.0, 5.0] {
            let plane = picture(blur_px, 0.0);
            let finder = EdgeFinder::new(&plane, false);
            for finder in [finder.clone(), finder.coarse_for_blur(blur_px), finder.fine_for_blur(blur_px)] {
                let (seen_px, scatter_px) = seen(&finder);
                // Interpolation between pixels is a blur of its own, of variance 1/6.
                let expected_px = (blur_px.powi(2) + 1.0 / 6.0).sqrt();
                assert!((seen_px - expected_px).abs() < 0.08, "σ {blur_px} px is seen as {seen_px}");
                assert!(scatter_px < 0.05, "{scatter_px}");
            }
        }
    }

    #[test]
    fn the_sigma_of_an_edge_is_the_scatter_that_noise_gives_it_but_for_interpolation() {
        for (blur_px, noise) in [(0.9, 0.01), (1.5, 0.02), (2.5, 0.02)] {
            let plane = picture(blur_px, noise);
            let finder = EdgeFinder::new(&plane, false).coarse_for_blur(blur_px);
            // Profiles along rows, at all positions between them, and so far apart that their noise is independent.
            let at = |row: usize| OutlinePoint {
                pixel: Point2::new(BORDER_PX, row as f64 + 0.01 * (row % 100) as f64),
                ..point(row)
            };
            let edges: Vec<Edge> = (5..HEIGHT - 5).step_by(3).filter_map(|row| finder.find(&at(row), 6.0)).collect();
            assert_eq!(edges.len(), 130);
            let scatter_px = rms(edges.iter().map(|edge| edge.offset_px));
            let sigma_px = rms(edges.iter().map(|edge| edge.sigma_px));
            // Samples two a pixel share pixels, which doubles the variance of the slope. Interpolation between rows leaves 2/3 of a
            // pixel's variance on the average. σ counts neither: the ratio is √(4/3) = 1.15, certain to 6 %.
            let ratio = scatter_px / sigma_px;
            assert!((0.98..1.35).contains(&ratio), "{blur_px}: {scatter_px} for {sigma_px} px");
        }
    }

    #[test]
    fn a_blurred_edge_in_noise_takes_a_wide_filter() {
        const BLUR_PX: f64 = 5.0;
        let plane = picture(BLUR_PX, 0.03);
        let narrow = EdgeFinder::new(&plane, false);
        let (narrow_px, narrow_scatter_px) = seen(&narrow);
        let (wide_px, wide_scatter_px) = seen(&narrow.coarse_for_blur(BLUR_PX));
        assert!(narrow_px < 0.6 * BLUR_PX, "σ {BLUR_PX} px is seen as {narrow_px}");
        assert!((wide_px / BLUR_PX - 1.0).abs() < 0.15, "σ {BLUR_PX} px is seen as {wide_px}");
        assert!(
            wide_scatter_px < 0.7 * narrow_scatter_px,
            "{wide_scatter_px} px, {narrow_scatter_px} with a narrow one"
        );
    }

    #[test]
    fn the_fine_filter_is_as_wide_as_the_blur_and_wider_in_noise() {
        let width_px = |blur_px: f64, noise: f64| {
            let plane = Plane::new(1, 1, vec![0.0]);
            EdgeFinder::with_noise(&plane, false, noise).fine_for_blur(blur_px).filter_px
        };
        for blur_px in [0.6, 0.9, 2.0] {
            assert_eq!(width_px(blur_px, 0.01), blur_px);
        }
        let of_noise = [0.01, 0.09, 0.12, 0.5].map(|noise| width_px(0.6, noise));
        assert!(of_noise.is_sorted() && of_noise[1] > 0.6 && of_noise[2] > of_noise[1], "{of_noise:?}");
        assert_eq!(of_noise[3], FILTER_PX, "no filter is wider than that of the coarse stages");
    }

    /// The snake is a bar 5 px wide: where the model knows its other side, that is no disturbance of this one.
    #[test]
    fn the_snakes_own_next_edge_leaves_an_edge_as_certain_as_it_is() {
        let bar = picture(0.7, 0.0);
        let data = (0..HEIGHT).flat_map(|row| (0..WIDTH).map(move |column| (row, column)));
        let other_side = |row: usize, column: usize| bar.get(column as i64 + 5, row as i64);
        let data = data.map(|(row, column)| bar.get(column as i64, row as i64) - other_side(row, column)).collect();
        let plane = Plane::new(WIDTH, HEIGHT, data);
        let finder = EdgeFinder::with_noise(&plane, false, 0.005).fine_for_blur(0.8);
        let sigma_px = |depth_px: f64| finder.find(&OutlinePoint { depth_px, ..point(200) }, 3.0).unwrap().sigma_px;
        assert!(sigma_px(5.0) < 0.05, "{}", sigma_px(5.0));
        assert!(sigma_px(12.0) > 0.5, "a line beside it: {}", sigma_px(12.0));
    }
}
