//! Sub-pixel edges between snake and background.

use super::outline::OutlinePoint;
use super::plane::{Plane, Region};

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
#[derive(Debug)]
pub struct EdgeFinder<'a> {
    plane: &'a Plane,
    noise: f64,
    two_sided: bool,
    kernel: Vec<f64>,
    profile: Vec<f64>,
}

/// Distance between samples of a profile, px.
const STEP_PX: f64 = 0.5;
/// σ of the Gaussian whose derivative finds the edge, px: about a lens' own blur, the best filter for a step in noise
/// (J. Canny, 1986).
const FILTER_PX: f64 = 1.2;

/// The least slope that counts as an edge, of the contrast between snake and paper, per px: a sharp step of 6 % of it.
const FAINTEST: f64 = 0.02;
/// How far around an edge its surroundings are judged, px.
const NEIGHBOURHOOD_PX: f64 = 5.0;
/// How far an edge is displaced by a neighbour as steep as itself, px (1σ).
const DRAWN_PX: f64 = 1.0;

impl<'a> EdgeFinder<'a> {
    /// A finder for a picture in which the snake is brighter than its background or, if `two_sided`, different from it.
    pub fn new(plane: &'a Plane, two_sided: bool) -> Self {
        Self::within(plane, two_sided, &Region::whole(plane.width as u32, plane.height as u32))
    }

    /// The same for a picture of which only a region is known.
    pub fn within(plane: &'a Plane, two_sided: bool, region: &Region) -> Self {
        Self { noise: plane.noise(region), two_sided, ..Self::noiseless(plane) }
    }

    /// A finder for a picture without noise.
    pub fn noiseless(plane: &'a Plane) -> Self {
        let reach = (3.0 * FILTER_PX / STEP_PX).ceil() as i32;
        let gaussian = |k: i32| (-0.5 * (f64::from(k) * STEP_PX / FILTER_PX).powi(2)).exp();
        let mut kernel: Vec<f64> = (-reach..=reach).map(|k| f64::from(k) * gaussian(k)).collect();
        // Normalised so that a ramp of one level per px answers 1.
        let ramp: f64 = kernel.iter().zip(-reach..=reach).map(|(w, k)| w * f64::from(k) * STEP_PX).sum();
        kernel.iter_mut().for_each(|w| *w /= ramp);
        Self { plane, noise: 0.0, two_sided: false, kernel, profile: Vec::new() }
    }

    /// The most likely edge within `search_px` of a border point: the picture must fall from snake to background there,
    /// steeply enough to stand out of the noise. The search ends where other parts of the snake begin.
    pub fn find(&mut self, point: &OutlinePoint, search_px: f64) -> Option<Edge> {
        let reach = self.kernel.len() / 2;
        let count = ((search_px + NEIGHBOURHOOD_PX) / STEP_PX).ceil() as usize + 1;
        let mut profile = std::mem::take(&mut self.profile);
        self.plane.profile(&point.pixel, point.normal.into_inner(), STEP_PX, count + reach, &mut profile);
        let mut fall: Vec<f64> = profile
            .windows(self.kernel.len())
            .map(|window| -window.iter().zip(&self.kernel).map(|(v, w)| v * w).sum::<f64>())
            .collect();
        self.profile = profile;

        let position = |k: usize| (k as f64 - count as f64) * STEP_PX;
        let outward = search_px.min(point.gap_px);
        let inward = search_px.min(point.depth_px);
        let steepness = |k: usize| if self.two_sided { fall[k].abs() } else { fall[k] };
        let is_peak = |k: usize| steepness(k) >= steepness(k - 1) && steepness(k) > steepness(k + 1);
        let best = (1..fall.len() - 1).filter(|&k| is_peak(k) && (-inward..=outward).contains(&position(k))).max_by(
            |&a, &b| {
                let likelihood = |k: usize| steepness(k) * (-0.5 * (position(k) / search_px).powi(2)).exp();
                likelihood(a).total_cmp(&likelihood(b))
            },
        )?;

        if fall[best] < 0.0 {
            fall.iter_mut().for_each(|f| *f = -*f);
        }

        // A step of height h blurred to σ has slope h / (σ√2π) and, filtered, curvature slope / (σ² + FILTER²).
        let curvature = (2.0 * fall[best] - fall[best - 1] - fall[best + 1]) / (STEP_PX * STEP_PX);
        let slope_noise = self.noise * self.kernel.iter().map(|w| w * w).sum::<f64>().sqrt();
        if fall[best] < FAINTEST.max(5.0 * slope_noise) || curvature <= 0.0 {
            return None;
        }
        let vertex = 0.5 * (fall[best + 1] - fall[best - 1]) / (STEP_PX * STEP_PX * curvature) * STEP_PX;
        // Noise of the slope's derivative over the curvature; the derivative's filter is narrower by one order.
        let noise_px = slope_noise / FILTER_PX / curvature;
        // A highlight along the rim or a printed line along the border rises where a clean edge is flat, and draws the
        // edge towards itself or away.
        let near = (NEIGHBOURHOOD_PX / STEP_PX) as usize;
        let around = fall[best.saturating_sub(near)..=(best + near).min(fall.len() - 1)].iter();
        let rise = around.fold(0.0_f64, |most, f| most.max(-f)) - 2.0 * slope_noise;
        let drawn_px = DRAWN_PX * (rise.max(0.0) / fall[best]).min(1.0);
        let sigma_px = (noise_px.powi(2) + drawn_px.powi(2)).sqrt();
        let blur_px = (fall[best] / curvature - FILTER_PX * FILTER_PX).max(0.0).sqrt();
        Some(Edge { offset_px: position(best) + vertex.clamp(-STEP_PX, STEP_PX), sigma_px, blur_px })
    }
}
