//! Sub-pixel edges between snake and background.

use crate::measure::body::OutlinePoint;
use crate::measure::image::plane::{Plane, Region};

/// An edge found near a predicted border point.
#[derive(Debug, Clone, Copy)]
pub struct Edge {
    /// Distance from the prediction along its outward normal, px.
    pub offset_px: f64,
    /// Standard deviation of `offset_px`, px: the picture's noise, and what the edge's surroundings may do to it.
    pub sigma_px: f64,
    /// Width of the edge, px: σ of the blur that a sharp step would need to look like it.
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
    /// σ of the Gaussian whose derivative that is, px.
    filter_px: f64,
    /// The picture's noise.
    noise: f64,
    /// What it leaves of noise in the filtered slope.
    slope_noise: f64,
    /// How far around an edge its surroundings are judged, px.
    neighbourhood_px: f64,
}

/// Distance between samples of a profile, px.
const STEP_PX: f64 = 0.5;
/// σ of the Gaussian whose derivative finds the edge, px: about a lens' own blur, the best filter for a step in noise
/// (J. Canny, 1986).
const FILTER_PX: f64 = 1.2;
/// The finest filter, px: two samples of a profile fall within its σ on either side.
const FINEST_PX: f64 = 0.8;
/// The widest filter, px: wider ones would reach from one rim of a disk to the next.
const WIDEST_PX: f64 = 3.0;
/// σ that a filter reaches to either side.
const REACH: f64 = 3.0;
/// Steps that the widest one does.
const MOST_REACH: usize = (REACH * WIDEST_PX / STEP_PX) as usize;

/// The least slope that counts as an edge, of the contrast between snake and paper, per px: a sharp step of 6 % of it.
const FAINTEST: f64 = 0.02;
/// An edge stands out of the noise if it is so many times as steep as noise makes the slope.
const NOISES: f64 = 5.0;
/// The slope of a sharp step of half the contrast, per px.
const HALF_STEP: f64 = 0.15;
/// How far around an edge its surroundings are judged, px.
const NEIGHBOURHOOD_PX: f64 = 5.0;
/// How far an edge is displaced by a neighbour as steep as itself, px (1σ).
const DRAWN_PX: f64 = 1.0;
/// The furthest that edges are searched for, px.
const FURTHEST_PX: f64 = 14.0;
/// Slopes along a profile at most, to either side of its middle.
const MOST: usize = ((FURTHEST_PX + NEIGHBOURHOOD_PX) / STEP_PX) as usize + 1;

/// σ of the filter for edges this soft, px.
pub(crate) fn filter_px(blur_px: f64) -> f64 {
    blur_px.clamp(FILTER_PX, WIDEST_PX)
}

impl<'a> EdgeFinder<'a> {
    /// A finder for a picture in which the snake is brighter than its background or, if `two_sided`, different from it.
    pub fn new(plane: &'a Plane, two_sided: bool) -> Self {
        Self::within(plane, two_sided, &Region::whole(plane.width as u32, plane.height as u32))
    }

    /// The same for a picture of which only a region is known.
    pub fn within(plane: &'a Plane, two_sided: bool, region: &Region) -> Self {
        let finder = Self {
            two_sided,
            neighbourhood_px: NEIGHBOURHOOD_PX,
            noise: plane.noise(region),
            ..Self::noiseless(plane)
        };
        finder.with_filter(FILTER_PX)
    }

    /// The same for edges this soft, px: a filter much narrower than the blur finds more noise than edge, and takes the edge for
    /// as sharp as noise is.
    pub fn coarse_for_blur(&self, blur_px: f64) -> Self {
        self.with_filter(filter_px(blur_px))
    }

    /// The same for edges that are known to be near, too. Shading beside an edge, a slope of the brightness, draws it in
    /// proportion to blur² + filter²: where noise is weak, a filter as fine as a sharp edge is.
    pub fn fine_for_blur(&self, blur_px: f64) -> Self {
        let fine = (blur_px < FILTER_PX).then(|| self.with_filter(blur_px.max(FINEST_PX)));
        let noise_is_weak = |fine: &Self| NOISES * fine.slope_noise < HALF_STEP;
        fine.filter(noise_is_weak).unwrap_or_else(|| self.coarse_for_blur(blur_px))
    }

    /// The same finder for a picture of the model: see [`noiseless`](Self::noiseless).
    pub fn for_model<'b>(&self, plane: &'b Plane) -> EdgeFinder<'b> {
        EdgeFinder::noiseless(plane).with_filter(self.filter_px)
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

    /// The most likely edge within `search_px` (at most 14) of a border point: the picture must fall from snake to
    /// background there, steeply enough to stand out of the noise. The search ends where other parts of the snake begin.
    pub fn find(&self, point: &OutlinePoint, search_px: f64) -> Option<Edge> {
        let search_px = search_px.min(FURTHEST_PX);
        let outward = search_px.min(point.gap_px);
        let inward = search_px.min(point.depth_px);
        let steps = |px: f64| ((px + self.neighbourhood_px) / STEP_PX).ceil() as usize;
        let (inside, outside) = (steps(inward).min(MOST), steps(outward).min(MOST));
        let mut slopes = [0.0; 2 * MOST + 1];
        let fall = &mut slopes[..inside + outside + 1];
        self.falls(point, inside, fall);

        let position = |k: usize| (k as f64 - inside as f64) * STEP_PX;
        let steepness = |k: usize| if self.two_sided { fall[k].abs() } else { fall[k] };
        let is_peak = |k: &usize| steepness(*k) >= steepness(k - 1) && steepness(*k) > steepness(k + 1);
        let likelihood = |k: usize| f64::from(steepness(k)) * (-0.5 * (position(k) / search_px).powi(2)).exp();
        let searched = (1..fall.len() - 1).filter(|&k| (-inward..=outward).contains(&position(k)));
        let (best, _) = searched
            .filter(is_peak)
            .map(|k| (k, likelihood(k)))
            .fold(None, |best: Option<(usize, f64)>, peak| best.filter(|best| best.1 > peak.1).or(Some(peak)))?;
        if fall[best] < 0.0 {
            fall.iter_mut().for_each(|f| *f = -*f);
        }

        // A step of height h blurred to σ has slope h / (σ√2π) and, filtered, curvature slope / (σ² + FILTER²).
        let [before, peak, after] = [best - 1, best, best + 1].map(|k| f64::from(fall[k]));
        let curvature = (2.0 * peak - before - after) / (STEP_PX * STEP_PX);
        if peak < FAINTEST.max(NOISES * self.slope_noise) || curvature <= 0.0 {
            return None;
        }
        let vertex = 0.5 * (after - before) / (STEP_PX * curvature);
        // Noise of the slope's derivative over the curvature; the derivative's filter is narrower by one order.
        let noise_px = self.slope_noise / self.filter_px / curvature;
        // A highlight along the rim or a printed line along the border rises where a clean edge is flat, and draws the
        // edge towards itself or away.
        let near = (self.neighbourhood_px / STEP_PX) as usize;
        let around = fall[best.saturating_sub(near)..=(best + near).min(fall.len() - 1)].iter();
        let rise = f64::from(around.fold(0.0_f32, |most, f| most.max(-f))) - 2.0 * self.slope_noise;
        let drawn_px = DRAWN_PX * (rise.max(0.0) / peak).min(1.0);
        let sigma_px = (noise_px.powi(2) + drawn_px.powi(2)).sqrt();
        let blur_px = (peak / curvature - self.filter_px.powi(2)).max(0.0).sqrt();
        Some(Edge { offset_px: position(best) + vertex.clamp(-STEP_PX, STEP_PX), sigma_px, blur_px })
    }

    /// The picture's filtered slope along a border point's normal, falling outwards counted positive; the first is `inside`
    /// steps on the snake.
    fn falls(&self, point: &OutlinePoint, inside: usize, fall: &mut [f32]) {
        let reach = self.reach;
        let mut samples = [0.0; 2 * (MOST + MOST_REACH) + 1];
        let profile = &mut samples[..fall.len() + 2 * reach];
        let step = point.normal.into_inner() * STEP_PX;
        self.plane.profile(&(point.pixel - step * (inside + reach) as f64), step, profile);
        for (k, weight) in self.kernel[..reach].iter().enumerate() {
            let (towards, away) = (&profile[reach - 1 - k..], &profile[reach + 1 + k..]);
            for ((fall, inner), outer) in fall.iter_mut().zip(towards).zip(away) {
                *fall += weight * (inner - outer);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::measure::body::{BodyPoint, Piece};
    use crate::measure::image::plane::median;
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
            pixel: Point2::new(BORDER_PX, row as f64),
            normal: Unit::new_unchecked(Vector2::x()),
            gap_px: 12.0,
            depth_px: 12.0,
            predicted: None,
        }
    }

    /// The median softness of the edges that a finder sees, and the scatter of their places, px.
    fn seen(finder: &EdgeFinder) -> (f64, f64) {
        let edges: Vec<Edge> = (20..HEIGHT - 20).step_by(10).filter_map(|y| finder.find(&point(y), 6.0)).collect();
        assert!(edges.len() > 30, "{} edges", edges.len());
        let blur_px = median(&mut edges.iter().map(|e| e.blur_px as f32).collect::<Vec<_>>());
        let scatter_px = (edges.iter().map(|e| e.offset_px.powi(2)).sum::<f64>() / edges.len() as f64).sqrt();
        (f64::from(blur_px), scatter_px)
    }

    #[test]
    fn a_clean_edge_is_as_soft_as_it_was_made() {
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
    fn a_soft_edge_in_noise_takes_a_wide_filter() {
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
}
