//! The stages of the measurement of one frame, for a person who wants to know why it came out as it did.

use crate::camera::{Frame, Samples};
use crate::geometry::Configuration;
use crate::measure::body::{BodyPoint, Outline, OutlinePoint, Projection};
use crate::measure::eye::Eye;
use crate::measure::fit::{Edge, EdgeFinder, FINE_SEARCH_PX, PartVisibility, RobustPhase};
use crate::measure::image::plane::Region;
use crate::measure::measurement::FrameMeasurement;
use crate::robot::BendProfile;
use nalgebra::{Point2, Vector2, Vector3};

/// Grey of the target and of the snake in the picture of the discriminant, 0 to 255.
///
/// Convention: leaves a quarter of the range on either side.
const TARGET_GREY: f32 = 64.0;
/// Convention: a display choice.
const SNAKE_GREY: f32 = 191.0;
/// How many grid lines are drawn to either side of the target's origin.
///
/// Convention: enough for any picture in which single lines can be told apart.
const GRID_LINES: i32 = 150;
/// The step along the snake by which its direction in the picture is told, mm.
///
/// Convention: numerical; a snake turns by a fraction of a degree over it.
const LENGTH_STEP_MM: f64 = 0.05;
/// How far outside the picture lines are drawn, px.
///
/// Convention: so that they end outside it.
const OVERHANG_PX: f64 = 50.0;

/// Every stage of measuring one frame.
#[derive(Debug, Clone)]
pub struct Explanation {
    /// The result.
    pub measurement: FrameMeasurement,
    /// The discriminant between snake and target of each pixel, as a grey picture: 64 is target and 191 is snake.
    pub discriminant: Frame,
    /// The printed lines, or the borders of the squares, where the rig says they are, px.
    pub grid: Vec<Vec<Point2<f64>>>,
    /// The candidates of the coarse search, best first.
    pub candidates: Vec<Configuration>,
    /// The local minima of the fit, best first; the verdict is on the first.
    pub fits: Vec<BendProfile>,
    /// The points of the best fit's outline at which an edge was searched.
    pub points: Vec<SearchedPoint>,
    /// The share of each disk's outline, by its number from the base, that is visible, 0 to 1.
    pub disks: Vec<(u8, f64)>,
}

/// A point of the outline and the edge that was found near it.
#[derive(Debug, Clone, Copy)]
pub struct SearchedPoint {
    /// Where the model puts the border, px.
    pub expected: Point2<f64>,
    /// Where along the snake it lies, mm from the base; negative on the holder.
    pub s_mm: f64,
    /// The component of the border's outward normal to the left of the snake as it is seen, looking from its base to its tip: 1 on its left
    /// side, −1 on its right one, 0 on the upper and lower borders of disks.
    pub leftward: f64,
    /// The edge; `None` where none stands out.
    pub edge: Option<WeightedEdge>,
}

/// An edge and what it counts in a robust fit.
#[derive(Debug, Clone, Copy)]
pub struct WeightedEdge {
    /// Where it is, px.
    pub pixel: Point2<f64>,
    /// How far outside the model's border that is, px.
    pub offset_px: f64,
    /// Its robust weight, 0 to 1.
    pub weight: f64,
}

impl Eye {
    /// Measures one frame and describes every stage.
    pub fn explain(&self, frame: &Frame) -> Explanation {
        let exposed = self.exposed(frame);
        let stages = self.measure_in_stages(&exposed, None);
        let plane = self.plane(&exposed, &Region::whole(frame.width, frame.height));
        let fits: Vec<BendProfile> = stages.fits.iter().map(|fit| fit.profile).collect();
        let view = self.projection();
        let outline = fits.first().map(|&profile| Outline::new(&view, profile));
        let finder = EdgeFinder::new(&plane, self.rig.appearance.two_sided);
        let disks = outline.as_ref().map(|outline| PartVisibility::new(outline, &finder).disk_shares().collect());
        let points = fits.first().zip(outline.as_ref());
        let points = points.map(|(&profile, outline)| searched_points(outline, &finder, &view, profile));
        Explanation {
            disks: disks.unwrap_or_default(),
            discriminant: Frame {
                width: frame.width,
                height: frame.height,
                channels: 1,
                samples: Samples::Bits8(
                    plane.data.iter().map(|v| (TARGET_GREY + (SNAKE_GREY - TARGET_GREY) * v) as u8).collect(),
                ),
            },
            grid: self.grid_lines(),
            candidates: stages.candidates.iter().map(|&bend| Configuration::from_bend_vector(bend)).collect(),
            fits,
            points: points.unwrap_or_default(),
            measurement: stages.measurement,
        }
    }

    /// The lines of both directions that cross the picture.
    fn grid_lines(&self) -> Vec<Vec<Point2<f64>>> {
        let sheet = self.rig.sheet();
        let pixel = |axis: usize, line: i32, along: i32| {
            let mut target = Point2::origin();
            target[axis] = f64::from(line) * self.rig.grid_pitch_mm;
            target[1 - axis] = f64::from(along) * self.rig.grid_pitch_mm;
            sheet.project(&self.lens, &target)
        };
        let line = |axis: usize, line: i32| -> Vec<Point2<f64>> {
            (-GRID_LINES..=GRID_LINES)
                .map(|along| pixel(axis, line, along))
                .filter(|p| self.lens.contains(p, -OVERHANG_PX))
                .collect()
        };
        let lines = [0, 1].into_iter().flat_map(|axis| (-GRID_LINES..=GRID_LINES).map(move |k| line(axis, k)));
        lines.filter(|line| line.len() > 1).collect()
    }
}

/// Searches an edge near every point of an outline, and weighs the edges as the fit's redescending phase does.
fn searched_points(
    outline: &Outline,
    finder: &EdgeFinder,
    view: &Projection,
    profile: BendProfile,
) -> Vec<SearchedPoint> {
    let curve = view.curve(profile);
    let central = |s_mm: f64| view.pixel(&curve, &BodyPoint { s_mm, local: Vector3::zeros() });
    // The picture's y points down, so that left of (x, y) is (y, −x).
    let leftward = |point: &OutlinePoint| {
        let along = central(point.body.s_mm + LENGTH_STEP_MM) - central(point.body.s_mm - LENGTH_STEP_MM);
        along.try_normalize(0.0).map_or(0.0, |along| Vector2::new(along.y, -along.x).dot(&point.normal))
    };
    let edges: Vec<_> = outline.points.iter().map(|point| (point, finder.find(point, FINE_SEARCH_PX))).collect();
    let residuals: Vec<f64> = edges.iter().filter_map(|(_, edge)| edge.map(|e| e.offset_px / e.sigma_px)).collect();
    let mut roots = RobustPhase::Redescending.roots(&residuals).into_iter();
    let searched = |(point, edge): (&OutlinePoint, Option<Edge>)| SearchedPoint {
        expected: point.pixel,
        s_mm: point.body.s_mm,
        leftward: leftward(point),
        edge: edge.zip(edge.and_then(|_| roots.next())).map(|(edge, root)| WeightedEdge {
            pixel: point.pixel + point.normal.into_inner() * edge.offset_px,
            offset_px: edge.offset_px,
            weight: root * root,
        }),
    };
    edges.into_iter().map(searched).collect()
}
