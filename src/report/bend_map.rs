//! A map of the bends as seen from the tip: x = θ cos δ, y = θ sin δ, with a value at each as colour.

use super::plot::{GRID, INK};
use crate::geometry::Configuration;
use std::fmt::Write;

const SIZE_PX: f64 = 420.0;
const NEGATIVE: &str = "#2F78C8";
const POSITIVE: &str = "#D6621E";

/// The map as an SVG element; the largest 2 % of the values share the strongest colour. None without a finite value.
pub fn bend_map(values: &[(Configuration, f64)], unit: &str) -> Option<String> {
    let mut sizes: Vec<f64> = values.iter().map(|(_, value)| value.abs()).filter(|value| value.is_finite()).collect();
    sizes.sort_by(f64::total_cmp);
    let strongest = *sizes.get((0.98 * sizes.len() as f64) as usize)?;
    let largest_deg = values.iter().map(|(psi, _)| psi.theta_deg()).fold(0.0, f64::max);
    let rim_deg = 30.0 * (largest_deg / 30.0).ceil().max(1.0);
    let middle = SIZE_PX / 2.0;
    let scale = (middle - 34.0) / rim_deg;

    let mut svg = format!("<svg viewBox=\"0 0 {SIZE_PX} {height}\" role=\"img\">\n", height = SIZE_PX + 26.0);
    let text = |x: f64, y: f64, anchor: &str, text: &str| {
        format!(
            "<text x=\"{x:.1}\" y=\"{y:.1}\" text-anchor=\"{anchor}\" font-size=\"13\" font-family=\"sans-serif\" fill=\"{INK}\">{text}</text>\n"
        )
    };
    let mut labels = String::new();
    for k in 1..=(rim_deg / 30.0) as usize {
        let theta = 30.0 * k as f64;
        let radius = scale * theta;
        let _ = writeln!(
            svg,
            "<circle cx=\"{middle}\" cy=\"{middle}\" r=\"{radius:.1}\" fill=\"none\" stroke=\"{GRID}\"/>"
        );
        let diagonal = radius * std::f64::consts::FRAC_1_SQRT_2;
        labels += &text(middle + diagonal + 2.0, middle + diagonal + 10.0, "start", &format!("θ {theta:.0}°"));
    }
    let rim = scale * rim_deg + 14.0;
    for (delta, anchor) in [(0, "start"), (90, "middle"), (180, "end"), (-90, "middle")] {
        let (sin, cos) = f64::from(delta).to_radians().sin_cos();
        let (x, y) = (middle + (rim - 6.0) * cos, middle - rim * sin + 4.0);
        let _ = writeln!(
            svg,
            "<line x1=\"{middle}\" y1=\"{middle}\" x2=\"{:.1}\" y2=\"{:.1}\" stroke=\"{GRID}\"/>",
            middle + scale * rim_deg * cos,
            middle - scale * rim_deg * sin
        );
        let label = if delta == 0 { "δ 0°".to_owned() } else { format!("{delta}°") };
        // Beside the picture's edge there is no room for a label: above the line then.
        let (x, y) = if delta % 180 == 0 { (x.clamp(34.0, SIZE_PX - 34.0), y - 8.0) } else { (x, y) };
        svg += &text(x, y, anchor, &label);
    }
    for (psi, value) in values.iter().filter(|(psi, value)| value.is_finite() && psi.theta.is_finite()) {
        let bend = psi.bend_vector().map(f64::to_degrees) * scale;
        let strength = if strongest > 0.0 { (value.abs() / strongest).min(1.0) } else { 0.0 };
        let colour = if *value < 0.0 { NEGATIVE } else { POSITIVE };
        let _ = writeln!(
            svg,
            "<circle cx=\"{:.1}\" cy=\"{:.1}\" r=\"{:.1}\" fill=\"{colour}\" fill-opacity=\"{:.2}\"/>",
            middle + bend.x,
            middle - bend.y,
            1.5 + 4.0 * strength,
            0.35 + 0.5 * strength
        );
    }
    svg += &labels;
    let legend = SIZE_PX + 14.0;
    for (x, colour, sign) in [(0.28, NEGATIVE, "−"), (0.58, POSITIVE, "+")] {
        let _ = writeln!(
            svg,
            "<circle cx=\"{:.1}\" cy=\"{:.1}\" r=\"5.5\" fill=\"{colour}\" fill-opacity=\"0.85\"/>",
            x * SIZE_PX,
            legend - 4.0
        );
        svg += &text(x * SIZE_PX + 10.0, legend, "start", &format!("{sign}{strongest:.3} {unit}"));
    }
    Some(svg + "</svg>\n")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_value_has_its_dot_and_odd_ones_do_no_harm() {
        let psi = Configuration::from_degrees(40.0, 90.0);
        let svg = bend_map(&[(psi, 0.1), (psi, -0.1), (psi, f64::NAN)], "mm").unwrap();
        assert_eq!(svg.matches("fill-opacity").count(), 2 + 2, "dots and legend");
        assert!(svg.contains("θ 60°") && !svg.contains("NaN"));
        assert_eq!(bend_map(&[], "mm"), None);
        assert!(bend_map(&[(Configuration::new(0.0, 0.0), 0.0)], "mm").is_some());
    }
}
