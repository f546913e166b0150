//! Plots as SVG text.
//!
//! Text and lines of the axes are drawn in [`INK`] and [`GRID`], so that a page's style sheet can give them its own
//! colours, for dark mode say.

use super::axis::{Axis, smallest_step, tick_text, ticks};
use super::decimation::keeps;
use crate::statistics::order::median;
use maud::html;
use plotters::coord::Shift;
use plotters::prelude::*;
use plotters::style::TextStyle;

/// Colour of text and axes. Convention: a display choice.
pub const INK: &str = "#1B1F24";
/// Colour of the grid lines. Convention: a display choice.
pub const GRID: &str = "#D0D4DA";

/// Width and height, px: what a plot has on a page with three side by side, and nearly on a phone, so that text keeps its size.
///
/// Convention: a display choice.
const SIZE_PX: (u32, u32) = (360, 250);
/// Units in which the drawing is made, for each px: plotters places everything on whole units, and lines would wobble on whole px.
///
/// Convention: a tenth of a px is not seen.
const UNITS_PER_PX: i32 = 10;
/// Share of the y range that is left free above the points for each line of the legend. Convention: a display choice.
const LEGEND_ROOM: f64 = 0.115;
/// Colours of backbones, as many as a robot can have: the same on every page. Convention: a display choice.
const BACKBONES: [RGBColor; 8] = [
    RGBColor(214, 98, 30),
    RGBColor(46, 148, 88),
    RGBColor(150, 90, 190),
    RGBColor(190, 60, 90),
    RGBColor(110, 120, 40),
    RGBColor(30, 150, 160),
    RGBColor(130, 100, 80),
    RGBColor(90, 110, 200),
];
/// Colours of all other series, in order. Convention: a display choice.
const OTHERS: [RGBColor; 4] =
    [RGBColor(47, 120, 200), RGBColor(200, 140, 20), RGBColor(20, 130, 120), RGBColor(170, 70, 140)];
/// Series that mean the same on several plots, with the place of their colour in [`OTHERS`]: what is missed before, and what is left after.
///
/// Convention: a display choice.
const MEANT: [(&str, usize); 7] = [
    ("before compensation", 3),
    ("without it", 3),
    ("none", 3),
    ("after compensation", 2),
    ("with it", 2),
    ("estimated", 2),
    ("estimated, play known", 0),
];
/// Colour of what stands beside the thing itself for comparison. Convention: a display choice.
const FAINT: RGBColor = RGBColor(140, 146, 156);
/// Names of such series.
const FAINT_NAMES: [&str; 3] = ["rejected", "naive", "noise alone"];
/// Points of a series that answer a hover at most. Convention: more are closer than a finger, and make pages heavy.
const MOST_TIPS: usize = 400;
/// A band this many times as wide as the values and the later bands reach is not shown whole. Convention: a display choice.
const WIDE: f64 = 4.0;

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
    /// Values that the y axis shows at least, so that plots beside each other compare. Where 0 is one of them, it has a line of its own.
    pub y_shown: Vec<f64>,
}

impl Plot {
    /// Whether there is a finite point to draw.
    pub fn has_points(&self) -> bool {
        self.series.iter().flat_map(|series| &series.points).any(|p| p.x.is_finite() && p.y.is_finite())
    }

    /// The plot as an SVG element, or `None` where there is no finite point to draw.
    pub fn svg(&self) -> Option<String> {
        self.drawn(&|y| format!("{y}"), &ticks)
    }

    /// The plot with a logarithmic y axis; values that are not positive are left out.
    pub fn log_svg(&self) -> Option<String> {
        let log = |series: &Series| Series {
            points: series.points.iter().map(|p| Point { y: p.y.log10(), sd: 0.0, ..*p }).collect(),
            ..series.clone()
        };
        let y_shown = self.y_shown.iter().map(|y| y.log10()).collect();
        let plot = Self { series: self.series.iter().map(log).collect(), y_shown, ..self.clone() };
        let decades = |[bottom, top]: [f64; 2], _: &str| -> Vec<f64> {
            (bottom.ceil() as i32..=top.floor() as i32).map(f64::from).collect()
        };
        plot.drawn(&|y| format!("{}", significant(10f64.powf(y), 3)), &decades)
    }

    /// Draws with labels of y as `label` writes them, at the ticks that `y_ticks` gives for a range and the axis' name.
    fn drawn(&self, label: &dyn Fn(f64) -> String, y_ticks: &dyn Fn([f64; 2], &str) -> Vec<f64>) -> Option<String> {
        let (x_range, y_range) = self.ranges()?;
        let y_ticks = y_ticks(y_range, &self.y_label);
        let mut text = String::new();
        let tips = {
            let size = (SIZE_PX.0 * UNITS_PER_PX as u32, SIZE_PX.1 * UNITS_PER_PX as u32);
            let area = SVGBackend::with_string(&mut text, size).into_drawing_area();
            let tips = self.draw(&area, x_range, y_range, y_ticks, label).ok()?;
            area.present().ok()?;
            tips
        };
        // Where the picture stands alone it has the size that it is meant for.
        let (wide, high) = SIZE_PX;
        let large = format!("width=\"{}\" height=\"{}\"", 10 * wide, 10 * high);
        Some(
            text.replacen(&large, &format!("width=\"{wide}\" height=\"{high}\""), 1)
                .replace("</svg>", &format!("{tips}</svg>")),
        )
    }

    /// Ranges of x and y that show every value, and its band, but for bands so wide that they would flatten everything else, as the
    /// first estimates may have.
    fn ranges(&self) -> Option<([f64; 2], [f64; 2])> {
        let all = || self.series.iter().flat_map(|s| s.points.iter().filter(|p| p.x.is_finite() && p.y.is_finite()));
        let mut xs: Vec<f64> = all().map(|p| p.x).collect();
        if xs.is_empty() {
            return None;
        }
        let middle = median(&mut xs);
        let ends = |p: &Point| [p.y - p.sd, p.y + p.sd];
        let settled = all().filter(|p| p.x >= middle && p.sd.is_finite()).flat_map(ends);
        let shown = self.y_shown.iter().copied().filter(|y| y.is_finite());
        let [bottom, top] = widened(all().map(|p| p.y).chain(settled).chain(shown.clone()));
        let is_shown = |p: &&Point| 2.0 * p.sd <= WIDE * (top - bottom);
        let mut y_range = widened([bottom, top].into_iter().chain(all().filter(is_shown).flat_map(ends)));
        if self.legend_lines() > 0 {
            y_range[1] += LEGEND_ROOM * self.legend_lines() as f64 * (y_range[1] - y_range[0]);
        }
        Some((widened(xs.into_iter()), y_range))
    }

    /// How many series the legend names.
    fn legend_lines(&self) -> usize {
        if self.series.len() > 1 { self.series.iter().filter(|series| !series.name.is_empty()).count() } else { 0 }
    }

    /// Draws, and gives the elements that answer a hover.
    fn draw(
        &self,
        area: &DrawingArea<SVGBackend, Shift>,
        [left, right]: [f64; 2],
        [bottom, top]: [f64; 2],
        y_ticks: Vec<f64>,
        y_text: &dyn Fn(f64) -> String,
    ) -> Result<String, Box<dyn std::error::Error>> {
        let steps = (smallest_step(&ticks([left, right], &self.x_label)), smallest_step(&y_ticks));
        let longest = y_ticks.iter().map(|y| tick_text(*y, steps.1, y_text).chars().count()).max().unwrap_or(0);
        let mut chart = ChartBuilder::on(area)
            .margin(px(6))
            .margin_right(px(14))
            .x_label_area_size(px(42))
            // Ticks are about 8 px a letter wide, and the axis' name stands beside them.
            .y_label_area_size(px(28 + 8 * longest as i32))
            .build_cartesian_2d(
                Axis { range: left..right, ticks: ticks([left, right], &self.x_label) },
                Axis { range: bottom..top, ticks: y_ticks },
            )?;
        self.draw_axes(&mut chart, steps, y_text)?;
        if self.y_shown.contains(&0.0) {
            let zero = [(left, 0.0), (right, 0.0)];
            chart.draw_series(LineSeries::new(zero, INK_RGB.stroke_width(UNITS_PER_PX as u32)))?;
        }
        let mut tips = String::new();
        for (place, series) in self.series.iter().enumerate() {
            let points: Vec<Point> =
                series.points.iter().filter(|p| p.x.is_finite() && p.y.is_finite()).copied().collect();
            for (_, p) in points.iter().enumerate().filter(|(k, _)| keeps(*k, MOST_TIPS, points.len())) {
                tips += &self.tip(chart.backend_coord(&(p.x, p.y)), series, p, y_text);
            }
            let has_label = self.legend_lines() > 0 && !series.name.is_empty();
            draw_series(&mut chart, series, colour_of(&series.name, place), &points, has_label)?;
        }
        if self.legend_lines() > 0 {
            let labels = &mut chart.configure_series_labels();
            labels
                .position(SeriesLabelPosition::UpperRight)
                .label_font(text(13))
                .legend_area_size(px(18))
                .margin(px(4))
                .draw()?;
        }
        Ok(tips)
    }

    /// Draws axes, ticks and grid lines; `steps` are the distances between ticks of x and of y.
    fn draw_axes(
        &self,
        chart: &mut Chart,
        (x_step, y_step): (f64, f64),
        y_text: &dyn Fn(f64) -> String,
    ) -> Result<(), Box<dyn std::error::Error>> {
        let thin = UNITS_PER_PX as u32;
        chart
            .configure_mesh()
            .light_line_style(TRANSPARENT)
            .bold_line_style(RGBColor(0xd0, 0xd4, 0xda).stroke_width(thin))
            .axis_style(INK_RGB.stroke_width(thin))
            .set_all_tick_mark_size(px(4))
            .label_style(text(14))
            .axis_desc_style(text(14))
            .x_labels(20)
            .y_labels(20)
            .x_label_formatter(&|x| tick_text(*x, x_step, &|x| format!("{x}")))
            .y_label_formatter(&|y| tick_text(*y, y_step, y_text))
            .x_desc(&self.x_label)
            .y_desc(&self.y_label)
            .draw()?;
        Ok(())
    }

    /// An unseen dot that says on hover what stands there.
    fn tip(&self, (x, y): (i32, i32), series: &Series, point: &Point, y_text: &dyn Fn(f64) -> String) -> String {
        let number = |value: f64| format!("{}", significant(value, 5)).replace('-', "−");
        let sd = if point.sd > 0.0 { format!(" ± {}", significant(point.sd, 2)) } else { String::new() };
        let name = if series.name.is_empty() { String::new() } else { format!("{}: ", series.name) };
        let value = if y_text(1.0) == "1" { number(point.y) } else { y_text(point.y) };
        let text = format!("{name}{} {value}{sd}; {} {}", self.y_label, self.x_label, number(point.x));
        let text = html! { (text) }.into_string();
        format!("<circle class=\"tip\" cx=\"{x}\" cy=\"{y}\" r=\"60\" fill=\"none\" data-tip=\"{text}\"/>\n")
    }
}

/// A plot while it is drawn.
type Chart<'a, 'b> = ChartContext<'a, SVGBackend<'b>, Cartesian2d<Axis, Axis>>;

/// [`INK`] as plotters has it.
const INK_RGB: RGBColor = RGBColor(0x1b, 0x1f, 0x24);

/// A length of the drawing in its own units.
fn px(px: i32) -> i32 {
    px * UNITS_PER_PX
}

/// The style of text of this size, px.
fn text(size: i32) -> TextStyle<'static> {
    ("sans-serif", px(size)).into_font().color(&INK_RGB)
}

/// Draws one series in its colour, with its line of the legend where it is to have one. Bars and bands end at the border.
fn draw_series(
    chart: &mut Chart,
    series: &Series,
    colour: RGBColor,
    points: &[Point],
    has_label: bool,
) -> Result<(), Box<dyn std::error::Error>> {
    let y_range = chart.y_range();
    let inside = |y: f64| y.clamp(y_range.start, y_range.end);
    let ends = |p: &Point| [(p.x, inside(p.y - p.sd)), (p.x, inside(p.y + p.sd))];
    let thin = UNITS_PER_PX as u32;
    let handle = match series.style {
        Style::Dots => {
            let barred = points.iter().filter(|p| p.sd > 0.0);
            chart.draw_series(barred.map(|p| PathElement::new(ends(p), colour.mix(0.55).stroke_width(thin))))?;
            chart.draw_series(points.iter().map(|p| Circle::new((p.x, p.y), px(3), colour.filled())))?
        }
        Style::Band => {
            let lower = points.iter().map(|p| ends(p)[0]);
            let band: Vec<_> = lower.chain(points.iter().rev().map(|p| ends(p)[1])).collect();
            chart.draw_series(std::iter::once(Polygon::new(band, colour.mix(0.22))))?;
            chart.draw_series(LineSeries::new(points.iter().map(|p| (p.x, p.y)), colour.stroke_width(2 * thin)))?
        }
    };
    if has_label {
        handle.label(&series.name).legend(move |(x, y)| Circle::new((x + px(8), y), px(4), colour.filled()));
    }
    Ok(())
}

/// The colour of a series: a backbone's own, grey for what is there for comparison, that of its meaning, else by its place.
fn colour_of(name: &str, place: usize) -> RGBColor {
    let backbone = name.strip_prefix("backbone ").and_then(|rest| rest.split(' ').next()?.parse::<usize>().ok());
    match backbone {
        Some(number) => BACKBONES[number.saturating_sub(1) % BACKBONES.len()],
        None if FAINT_NAMES.iter().any(|faint| name.starts_with(faint)) => FAINT,
        None => {
            let meant = MEANT.iter().find(|(meant, _)| *meant == name).map(|(_, place)| *place);
            OTHERS[meant.unwrap_or(place) % OTHERS.len()]
        }
    }
}

/// A number rounded to so many significant digits.
fn significant(value: f64, digits: i32) -> f64 {
    if value == 0.0 || !value.is_finite() {
        return value;
    }
    let digits = (digits - 1) as usize;
    format!("{value:.digits$e}").parse().unwrap_or(value)
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
        assert_eq!(svg.matches("<circle").count(), 2 * 20 + 2 + 2 * 20, "dots, legend, and what answers a hover");
        assert!(svg.contains("θ (°)") && svg.contains("&lt;rejected&gt;") && svg.contains(INK) && svg.contains(GRID));
    }

    #[test]
    fn one_wide_early_band_does_not_flatten_the_rest() {
        let points = (0..20).map(|i| Point { x: f64::from(i), y: 1.2, sd: if i == 0 { 1e6 } else { 0.01 } }).collect();
        let (_, [bottom, top]) = plot(Style::Band, points).ranges().unwrap();
        assert!(top - bottom < 0.05, "{bottom} to {top}");
    }

    #[test]
    fn a_logarithmic_axis_is_told_in_its_own_unit() {
        let points =
            [5.0, 0.5, 0.01, 0.0].iter().enumerate().map(|(k, &y)| Point { x: k as f64, y, sd: 0.0 }).collect();
        let svg = plot(Style::Dots, points).log_svg().unwrap();
        for tick in ["0.01", "0.1", "1"] {
            assert!(svg.contains(&format!(">\n{tick}\n<")), "{tick}: {svg}");
        }
    }

    #[test]
    fn a_backbone_has_one_colour_wherever_it_stands() {
        assert_eq!(colour_of("backbone 2", 0), colour_of("backbone 2 (command)", 5));
        assert_eq!(colour_of("rejected", 1), colour_of("naive", 0));
        // Before and after mean the same on the pages of `run` and of `discover`.
        assert_eq!(colour_of("before compensation", 1), colour_of("without it", 0));
        assert_eq!(colour_of("after compensation", 2), colour_of("with it", 1));
        assert_ne!(colour_of("backbone 1", 0), colour_of("used", 0));
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
