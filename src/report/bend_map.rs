//! A map of the bends as seen from the tip: x = θ cos δ, y = θ sin δ, with a value at each as colour.

use super::plot::{GRID, INK};
use crate::geometry::Configuration;
use crate::quantity::decimal;
use crate::statistics::order::quantile;
use maud::{Markup, html};
use std::f64::consts::FRAC_1_SQRT_2;

/// Width of the map and height without its legend, px. Convention: a display choice.
const SIZE_PX: f64 = 420.0;
/// Its middle, px.
///
/// Convention: a display choice.
const MIDDLE_PX: f64 = SIZE_PX / 2.0;
/// Room around it for labels, px. Convention: a display choice.
const MARGIN_PX: f64 = 34.0;
/// Height of the legend, px. Convention: a display choice.
const LEGEND_PX: f64 = 26.0;
/// Bends between two circles, degrees. Convention: a display choice.
const CIRCLE_DEG: f64 = 30.0;
/// Share of the values that are told apart by their size; larger ones look alike. Convention: a display choice.
const TOLD_APART: f64 = 0.98;
// Other colours than those of backbones and series. Convention: display choices.
const NEGATIVE: &str = "#0F8C8C";
/// Convention: a display choice.
const POSITIVE: &str = "#BE3264";

/// The value from which on all have the strongest colour: the largest 2 % share it.
pub fn strongest(values: impl Iterator<Item = f64>) -> f64 {
    let mut sizes: Vec<f64> = values.filter(|value| value.is_finite()).map(f64::abs).collect();
    if sizes.is_empty() { 0.0 } else { quantile(&mut sizes, TOLD_APART) }
}

/// The map as an SVG element; what is as large as `strongest` has the strongest colour. `None` without a finite value.
pub fn bend_map(values: &[(Configuration, f64)], unit: &str, strongest: f64) -> Option<Markup> {
    let finite = || values.iter().filter(|(psi, value)| value.is_finite() && psi.theta.is_finite());
    finite().next()?;
    let largest_deg = finite().map(|(psi, _)| psi.theta_deg()).fold(0.0, f64::max);
    let circles = (largest_deg / CIRCLE_DEG).ceil().max(1.0);
    let px_per_deg = (MIDDLE_PX - MARGIN_PX) / (CIRCLE_DEG * circles);
    Some(html! {
        svg viewBox={ "0 0 " (SIZE_PX) " " (SIZE_PX + LEGEND_PX) } role="img" {
            (axes(CIRCLE_DEG * circles, px_per_deg))
            @for (psi, value) in finite() { (dot(psi, *value, strongest, px_per_deg, unit)) }
            @for circle in 1..=circles as usize { (circle_label(CIRCLE_DEG * circle as f64, px_per_deg)) }
            (legend(strongest, unit, [-1.0, 1.0].map(|sign| finite().map(|(_, value)| sign * value).fold(0.0, f64::max))))
        }
    })
}

/// Circles of equal θ, and lines of equal δ with their labels.
fn axes(rim_deg: f64, px_per_deg: f64) -> Markup {
    let circles = (rim_deg / CIRCLE_DEG).round() as usize;
    html! {
        @for circle in 1..=circles {
            circle cx=(MIDDLE_PX) cy=(MIDDLE_PX) r=(px(px_per_deg * CIRCLE_DEG * circle as f64)) fill="none" stroke=(GRID) {}
        }
        @for (delta, anchor) in [(0, "start"), (90, "middle"), (180, "end"), (-90, "middle")] {
            (ray(delta, anchor, px_per_deg * rim_deg))
        }
    }
}

/// The line from the middle towards an azimuth δ, degrees, with its label.
fn ray(delta: i32, anchor: &str, length_px: f64) -> Markup {
    let (sin, cos) = f64::from(delta).to_radians().sin_cos();
    let label_px = length_px + 14.0;
    let (x, y) = (MIDDLE_PX + label_px * cos, MIDDLE_PX - label_px * sin + 4.0);
    // Beside the map there is no room for a label; it stands above the line then.
    let beside = delta % 180 == 0;
    let (x, y) = if beside { (x.clamp(MARGIN_PX, SIZE_PX - MARGIN_PX), y - 8.0) } else { (x, y) };
    let label = if delta == 0 { "δ 0°".to_owned() } else { format!("{delta}°").replace('-', "−") };
    html! {
        line x1=(MIDDLE_PX) y1=(MIDDLE_PX) x2=(px(MIDDLE_PX + length_px * cos)) y2=(px(MIDDLE_PX - length_px * sin))
            stroke=(GRID) {}
        (text(x, y, anchor, &label))
    }
}

fn circle_label(theta_deg: f64, px_per_deg: f64) -> Markup {
    let diagonal_px = px_per_deg * theta_deg * FRAC_1_SQRT_2;
    text(MIDDLE_PX + diagonal_px + 2.0, MIDDLE_PX + diagonal_px + 10.0, "start", &format!("θ {theta_deg:.0}°"))
}

/// The dot of one value.
fn dot(psi: &Configuration, value: f64, strongest: f64, px_per_deg: f64, unit: &str) -> Markup {
    let angles = [psi.theta_deg(), psi.delta_deg()].map(|angle_deg| decimal(angle_deg, 1));
    let says = format!("θ {}°, δ {}°: {}", angles[0], angles[1], with_unit(value, 4, unit));
    let bend_px = psi.bend_vector().map(f64::to_degrees) * px_per_deg;
    let strength = if strongest > 0.0 { (value.abs() / strongest).min(1.0) } else { 0.0 };
    html! {
        circle cx=(px(MIDDLE_PX + bend_px.x)) cy=(px(MIDDLE_PX - bend_px.y)) r=(px(1.5 + 4.0 * strength))
            data-tip=(says) fill=(if value < 0.0 { NEGATIVE } else { POSITIVE }) fill-opacity=(format!("{:.2}", 0.35 + 0.5 * strength)) {}
    }
}

/// What the strongest colours mean, where these are the largest values of either sign; those of the signs that there are.
fn legend(strongest: f64, unit: &str, largest: [f64; 2]) -> Markup {
    let y = SIZE_PX + 14.0;
    html! {
        @let has_both = largest.iter().all(|largest| *largest > 0.0);
        // Side by side, or one alone in the middle.
        @let shares = if has_both { [0.06, 0.54] } else { [0.33; 2] };
        @let both = [(shares[0], NEGATIVE, "−"), (shares[1], POSITIVE, if has_both { "+" } else { "" })];
        @for ((share, colour, sign), largest) in both.into_iter().zip(largest).filter(|(_, largest)| *largest > 0.0) {
            circle cx=(px(share * SIZE_PX)) cy=(px(y - 4.0)) r="5.5" fill=(colour) fill-opacity="0.85" {}
            (text(share * SIZE_PX + 10.0, y, "start", &format!("{sign}{}{}", with_unit(strongest, 3, unit), if largest > strongest { " and beyond" } else { "" })))
        }
    }
}

fn text(x: f64, y: f64, anchor: &str, text: &str) -> Markup {
    html! {
        text.halo x=(px(x)) y=(px(y)) text-anchor=(anchor) font-size="13" font-family="sans-serif" fill=(INK) { (text) }
    }
}

/// A value with its unit; degrees stand without a space.
fn with_unit(value: f64, places: usize, unit: &str) -> String {
    format!("{}{}{unit}", decimal(value, places), if unit == "°" { "" } else { " " })
}

/// A length in px as it is written.
fn px(length: f64) -> String {
    format!("{length:.1}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_value_has_its_dot_and_odd_ones_do_no_harm() {
        let psi = Configuration::from_degrees(40.0, 90.0);
        let svg = bend_map(&[(psi, 0.1), (psi, -0.1), (psi, f64::NAN)], "<mm>", 0.1).unwrap().into_string();
        assert_eq!(svg.matches("fill-opacity").count(), 2 + 2, "dots and legend");
        assert!(
            svg.contains("θ 60°")
                && svg.contains("0.100 &lt;mm&gt;")
                && !svg.contains("NaN")
                && !svg.contains("beyond")
        );
        let svg = bend_map(&[(psi, 0.1), (psi, 0.05)], "mm", 0.08).unwrap().into_string();
        assert!(svg.contains(">0.080 mm and beyond<") && !svg.contains(">−0.080"), "{svg}");
        assert!(bend_map(&[], "mm", 1.0).is_none());
        assert!(bend_map(&[(Configuration::new(0.0, 0.0), 0.0)], "mm", 0.0).is_some());
        assert_eq!(strongest([-2.0, f64::NAN, -2.0].into_iter()), 2.0);
        assert_eq!(strongest(std::iter::empty()), 0.0);
    }
}
