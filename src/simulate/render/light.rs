//! Linear light: its sRGB encoding and its blur.

use crate::simulate::scene::Colour;
use nalgebra::Vector3;
use rayon::prelude::*;

/// Linear light: red, green, blue; white paper under full light is 1.
pub(super) type Radiance = Vector3<f64>;

/// Gaussian blur of a picture, row by row and then column by column; the border continues as it is.
pub(super) fn blurred(picture: Vec<Radiance>, width: usize, height: usize, sigma: f64) -> Vec<Radiance> {
    if sigma <= 0.0 || picture.is_empty() {
        return picture;
    }
    let reach = (4.0 * sigma).ceil() as usize;
    let weights: Vec<f64> =
        (0..=2 * reach).map(|k| (-0.5 * ((k as f64 - reach as f64) / sigma).powi(2)).exp()).collect();
    let total: f64 = weights.iter().sum();
    let weights: Vec<f64> = weights.iter().map(|w| w / total).collect();
    let clamped = |place: usize, k: usize, count: usize| (place + k).saturating_sub(reach).min(count - 1);

    let mut along_rows = vec![Radiance::zeros(); picture.len()];
    along_rows.par_chunks_mut(width).zip(picture.par_chunks(width)).for_each(|(to, from)| {
        for (column, to) in to.iter_mut().enumerate() {
            *to = weights.iter().enumerate().map(|(k, w)| *w * from[clamped(column, k, width)]).sum();
        }
    });
    let mut along_columns = vec![Radiance::zeros(); picture.len()];
    along_columns.par_chunks_mut(width).enumerate().for_each(|(row, to)| {
        for (k, weight) in weights.iter().enumerate() {
            let from = &along_rows[clamped(row, k, height) * width..][..width];
            for (to, from) in to.iter_mut().zip(from) {
                *to += *weight * from;
            }
        }
    });
    along_columns
}

/// Linear light of an sRGB colour (IEC 61966-2-1).
pub(super) fn decoded(colour: &Colour) -> Radiance {
    Radiance::from(*colour).map(|level| {
        let value = level / 255.0;
        if value <= 0.04045 { value / 12.92 } else { ((value + 0.055) / 1.055).powf(2.4) }
    })
}

/// The sRGB level, 0 to 255, of linear light.
pub(super) fn encoded(light: f64) -> f64 {
    let light = light.clamp(0.0, 1.0);
    255.0 * if light <= 0.003_130_8 { 12.92 * light } else { 1.055 * light.powf(1.0 / 2.4) - 0.055 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use approx::assert_abs_diff_eq;

    #[test]
    fn blur_spreads_light_and_keeps_it() {
        let mut picture = vec![Radiance::zeros(); 61 * 41];
        picture[20 * 61 + 30] = Radiance::repeat(1.0);
        let sigma = 2.5;
        let spread = blurred(picture, 61, 41, sigma);
        let moment = |power: i32| -> f64 {
            spread.iter().enumerate().map(|(k, v)| v.y * ((k % 61) as f64 - 30.0).powi(power)).sum()
        };
        assert_abs_diff_eq!(moment(0), 1.0, epsilon = 1e-9);
        assert_abs_diff_eq!(moment(1), 0.0, epsilon = 1e-9);
        assert_abs_diff_eq!(moment(2), sigma * sigma, epsilon = 0.01);
        let grey = blurred(vec![Radiance::repeat(0.4); 61 * 41], 61, 41, sigma);
        assert!(grey.iter().all(|v| (v.x - 0.4).abs() < 1e-12));
    }

    #[test]
    fn srgb_goes_both_ways() {
        for level in [0.0, 5.0, 10.0, 11.0, 100.0, 255.0] {
            assert_abs_diff_eq!(encoded(decoded(&[level; 3]).x), level, epsilon = 1e-4);
        }
        assert_abs_diff_eq!(decoded(&[188.0; 3]).x, 0.5, epsilon = 0.005);
    }
}
