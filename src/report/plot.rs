//! Plots as SVG text.
//!
//! Text and lines of the axes are drawn in [`INK`] and [`GRID`], so that a page's style sheet can give them its own
//! colours, for dark mode say.

use crate::statistics::order::median;
use plotters::coord::Shift;
use plotters::prelude::*;

/// Colour of text and axes. Convention: a display choice.
pub const INK: &str = "#1B1F24";
/// Colour of the grid lines. Convention: a display choice.
pub const GRID: &str = "#D0D4DA";

/// Width and height. Convention: a display choice.
const SIZE_PX: (u32, u32) = (560, 300);
/// Share of the y range that is left free above the points for each line of the legend. Convention: a display choice.
const LEGEND_ROOM: f64 = 0.115;
/// Colours of the series, as many as a robot can have backbones. Convention: a display choice.
const PALETTE: [RGBColor; 8] = [
    RGBColor(47, 120, 200),
    RGBColor(214, 98, 30),
    RGBColor(46, 148, 88),
    RGBColor(150, 90, 190),
    RGBColor(190, 60, 90),
    RGBColor(110, 120, 40),
    RGBColor(30, 150, 160),
    RGBColor(130, 100, 80),
];

/// How a series is drawn.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Style {
    /// A dot for each point and a bar from −sd to +sd.
    Dots,
    /// A line through the points and a band from −sd to +sd.
    Band,
}

/// A value with its standard deviation at a place on the x axis.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Point {
    /// Place on the x axis.
    pub x: f64,
    /// The value.
    pub y: f64,
    /// Its standard deviation; 0 draws neither bar nor band.
    pub sd: f64,
}

/// Points of one kind.
#[derive(Debug, Clone, PartialEq)]
pub struct Series {
    /// Its name in the legend.
    pub name: String,
    /// How it is drawn.
    pub style: Style,
    /// The points in order of x.
    pub points: Vec<Point>,
}

/// One plot of up to four series.
#[derive(Debug, Clone, PartialEq)]
pub struct Plot {
    /// What runs along the x axis, with its unit.
    pub x_label: String,
    /// What runs along the y axis, with its unit.
    pub y_label: String,
    /// The series, each in its own colour.
    pub series: Vec<Series>,
    /// Values that the y axis shows at least, so that plots beside each other compare.
    pub y_shown: Vec<f64>,
}

impl Plot {
    /// Whether there is a finite point to draw.
    pub fn has_points(&self) -> bool {
        self.series.iter().flat_map(|series| &series.points).any(|p| p.x.is_finite() && p.y.is_finite())
    }

    /// The plot as an SVG element, or `None` where there is no finite point to draw.
    pub fn svg(&self) -> Option<String> {
        let (x_range, y_range) = self.ranges()?;
        let mut text = String::new();
        {
            let area = SVGBackend::with_string(&mut text, SIZE_PX).into_drawing_area();
            self.draw(&area, x_range, y_range).ok()?;
            area.present().ok()?;
        }
        Some(text)
    }

    /// Ranges of x and y that show every value, and the sds of the later half: the first estimates may know so little
    /// that their bands would flatten everything else.
    fn ranges(&self) -> Option<([f64; 2], [f64; 2])> {
        let all = || self.series.iter().flat_map(|s| s.points.iter().filter(|p| p.x.is_finite() && p.y.is_finite()));
        let mut xs: Vec<f64> = all().map(|p| p.x).collect();
        if xs.is_empty() {
            return None;
        }
        let middle = median(&mut xs);
        let settled = all().filter(|p| p.x >= middle && p.sd.is_finite()).flat_map(|p| [p.y - p.sd, p.y + p.sd]);
        let shown = self.y_shown.iter().copied().filter(|y| y.is_finite());
        let mut y_range = widened(all().map(|p| p.y).chain(settled).chain(shown));
        if self.series.len() > 1 {
            y_range[1] += LEGEND_ROOM * self.series.len() as f64 * (y_range[1] - y_range[0]);
        }
        Some((widened(xs.into_iter()), y_range))
    }

    fn draw(
        &self,
        area: &DrawingArea<SVGBackend, Shift>,
        [left, right]: [f64; 2],
        [bottom, top]: [f64; 2],
    ) -> Result<(), Box<dyn std::error::Error>> {
        let ink = RGBColor(0x1b, 0x1f, 0x24);
        let grid = RGBColor(0xd0, 0xd4, 0xda);
        let text = |size: i32| ("sans-serif", size).into_font().color(&ink);
        let mut chart = ChartBuilder::on(area)
            .margin(8)
            .margin_right(16)
            .x_label_area_size(40)
            .y_label_area_size(62)
            .build_cartesian_2d(left..right, bottom..top)?;
        chart
            .configure_mesh()
            .light_line_style(TRANSPARENT)
            .bold_line_style(grid)
            .axis_style(ink)
            .label_style(text(14))
            .axis_desc_style(text(15))
            .x_labels(7)
            .y_labels(6)
            .x_desc(&self.x_label)
            .y_desc(&self.y_label)
            .draw()?;
        let inside = |y: f64| y.clamp(bottom, top);
        for (series, colour) in self.series.iter().zip(PALETTE) {
            let points: Vec<Point> =
                series.points.iter().filter(|p| p.x.is_finite() && p.y.is_finite()).copied().collect();
            let ends = |p: &Point| [(p.x, inside(p.y - p.sd)), (p.x, inside(p.y + p.sd))];
            let handle = match series.style {
                Style::Dots => {
                    let barred = points.iter().filter(|p| p.sd > 0.0);
                    chart.draw_series(barred.map(|p| PathElement::new(ends(p), colour.mix(0.55))))?;
                    chart.draw_series(points.iter().map(|p| Circle::new((p.x, p.y), 3, colour.filled())))?
                }
                Style::Band => {
                    let lower = points.iter().map(|p| ends(p)[0]);
                    let band: Vec<_> = lower.chain(points.iter().rev().map(|p| ends(p)[1])).collect();
                    chart.draw_series(std::iter::once(Polygon::new(band, colour.mix(0.22))))?;
                    chart.draw_series(LineSeries::new(points.iter().map(|p| (p.x, p.y)), colour.stroke_width(2)))?
                }
            };
            if self.series.len() > 1 {
                handle.label(&series.name).legend(move |(x, y)| Circle::new((x + 8, y), 4, colour.filled()));
            }
        }
        if self.series.len() > 1 {
            chart
                .configure_series_labels()
                .position(SeriesLabelPosition::UpperRight)
                .label_font(text(14))
                .legend_area_size(18)
                .draw()?;
        }
        Ok(())
    }
}

/// The least range that holds all values, with a margin on both sides. Convention: the margin is a display choice, and keeps the range
/// of equal values above rounding.
fn widened(values: impl Iterator<Item = f64>) -> [f64; 2] {
    let (least, most) = values.fold((f64::INFINITY, f64::NEG_INFINITY), |(least, most), v| (least.min(v), most.max(v)));
    let margin = (0.06 * (most - least)).max(1e-6 * most.abs()).max(1e-9);
    [least - margin, most + margin]
}

#[cfg(test)]
mod tests {
    use super::*;

    fn plot(style: Style, points: Vec<Point>) -> Plot {
        let series = |name: &str| Series { name: name.to_owned(), style, points: points.clone() };
        Plot {
            x_label: "time (s)".into(),
            y_label: "θ (°)".into(),
            series: vec![series("used"), series("<rejected>")],
            y_shown: vec![],
        }
    }

    #[test]
    fn every_point_has_its_dot_and_labels_are_escaped() {
        let points = (0..20).map(|i| Point { x: f64::from(i), y: f64::from(i * i), sd: 5.0 }).collect();
        let svg = plot(Style::Dots, points).svg().unwrap();
        assert_eq!(svg.matches("<circle").count(), 2 * 20 + 2, "dots and legend");
        assert!(svg.contains("θ (°)") && svg.contains("&lt;rejected&gt;") && svg.contains(INK) && svg.contains(GRID));
    }

    #[test]
    fn one_wide_early_band_does_not_flatten_the_rest() {
        let points = (0..20).map(|i| Point { x: f64::from(i), y: 1.2, sd: if i == 0 { 1e6 } else { 0.01 } }).collect();
        let (_, [bottom, top]) = plot(Style::Band, points).ranges().unwrap();
        assert!(top - bottom < 0.05, "{bottom} to {top}");
    }

    #[test]
    fn nothing_to_draw_is_no_plot_and_odd_numbers_do_no_harm() {
        assert_eq!(plot(Style::Band, vec![]).svg(), None);
        let odd = |y, sd| Point { x: 1.0, y, sd };
        assert_eq!(plot(Style::Dots, vec![odd(f64::NAN, 1.0)]).svg(), None);
        for style in [Style::Dots, Style::Band] {
            assert!(plot(style, vec![odd(0.0, f64::INFINITY)]).svg().is_some());
            assert!(plot(style, vec![odd(1e300, 0.0), odd(-1e300, 0.0)]).svg().is_some());
        }
    }
}
