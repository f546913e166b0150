//! What the eye made of one frame, stage by stage, for a person who wants to know why.

use crate::camera::{Frame, Samples};
use crate::geometry::Configuration;
use crate::measure::body::Outline;
use crate::measure::eye::{Eye, FrameMeasurement};
use crate::measure::fit::{EdgeFinder, FINE_SEARCH_PX, PartVisibility, robust_weights};
use crate::measure::image::plane::Region;
use crate::measure::target::grid::project_paper;
use nalgebra::Point2;

/// Every stage of measuring one frame.
#[derive(Debug, Clone)]
pub struct Explanation {
    /// The result.
    pub measurement: FrameMeasurement,
    /// How much each pixel looks like the snake, as a grey picture: 64 is paper and 191 is snake.
    pub snakeness: Frame,
    /// The printed lines, or the borders of the squares, where the rig says they are, px.
    pub grid: Vec<Vec<Point2<f64>>>,
    /// The bends that the coarse search found worth a look, best first.
    pub candidates: Vec<Configuration>,
    /// The bends that were fitted to the end, best first; the verdict is on the first, whatever it is.
    pub fits: Vec<Configuration>,
    /// The places of the best fit's outline at which an edge was looked for.
    pub places: Vec<Place>,
    /// The share of each disk's outline, by its number from the base, that has its edge, 0 to 1.
    pub disks: Vec<(u8, f64)>,
}

/// A place of the outline and the edge that was found there.
#[derive(Debug, Clone, Copy)]
pub struct Place {
    /// Where the model puts the border, px.
    pub expected: Point2<f64>,
    /// Where the edge is, px, how far outside the border in units of its σ, and its robust weight, 0 to 1; `None` where no
    /// edge stands out.
    pub seen: Option<(Point2<f64>, f64, f64)>,
}

impl Eye {
    /// Measures one frame and tells every stage of it.
    pub fn explain(&self, frame: &Frame) -> Explanation {
        let stages = self.measure_in_stages(frame);
        let plane = self.plane(frame, &Region::whole(frame.width, frame.height));
        let fits: Vec<Configuration> =
            stages.fits.iter().map(|fit| Configuration::from_bend_vector(fit.bend)).collect();
        let outline = fits.first().map(|&psi| Outline::new(&self.projection(), psi));
        let finder = EdgeFinder::new(&plane, self.rig.appearance.two_sided);
        let disks = outline.as_ref().map(|outline| PartVisibility::new(outline, &finder).disk_shares().collect());
        let places = outline.as_ref().map(|outline| places(outline, &finder));
        Explanation {
            disks: disks.unwrap_or_default(),
            snakeness: Frame {
                width: frame.width,
                height: frame.height,
                channels: 1,
                samples: Samples::Bits8(plane.data.iter().map(|v| (64.0 + 127.0 * v) as u8).collect()),
            },
            grid: self.grid_lines(),
            candidates: stages.candidates.iter().map(|&bend| Configuration::from_bend_vector(bend)).collect(),
            fits,
            places: places.unwrap_or_default(),
            measurement: stages.measurement,
        }
    }

    /// The lines of both directions that cross the picture.
    fn grid_lines(&self) -> Vec<Vec<Point2<f64>>> {
        /// Enough for any picture in which single lines can be told apart.
        const REACH: i32 = 150;
        let pixel = |axis: usize, line: i32, along: i32| {
            let mut paper = Point2::origin();
            paper[axis] = f64::from(line) * self.rig.grid_pitch_mm;
            paper[1 - axis] = f64::from(along) * self.rig.grid_pitch_mm;
            project_paper(&self.lens, &self.rig.camera_from_grid, &paper)
        };
        let line = |axis: usize, line: i32| -> Vec<Point2<f64>> {
            (-REACH..=REACH).map(|along| pixel(axis, line, along)).filter(|p| self.lens.contains(p, -50.0)).collect()
        };
        let lines = [0, 1].into_iter().flat_map(|axis| (-REACH..=REACH).map(move |k| line(axis, k)));
        lines.filter(|line| line.len() > 1).collect()
    }
}

fn places(outline: &Outline, finder: &EdgeFinder) -> Vec<Place> {
    let edges: Vec<_> = outline.points.iter().map(|point| (point, finder.find(point, FINE_SEARCH_PX))).collect();
    let misfits: Vec<f64> = edges.iter().filter_map(|(_, edge)| edge.map(|e| e.offset_px / e.sigma_px)).collect();
    let mut told = misfits.iter().zip(robust_weights(&misfits, false));
    let place = |(point, edge): &(&crate::measure::body::OutlinePoint, Option<crate::measure::fit::Edge>)| Place {
        expected: point.pixel,
        seen: edge.and_then(|edge| {
            let (misfit, root) = told.next()?;
            Some((point.pixel + point.normal.into_inner() * edge.offset_px, *misfit, root * root))
        }),
    };
    edges.iter().map(place).collect()
}
