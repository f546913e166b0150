//! Why a rig could not be calibrated.

use crate::error::Error;
use std::fmt;

/// A part of the snake that a picture must show.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SnakePart {
    /// The holder below the base disk.
    Holder,
    /// The disk next to the base.
    FirstDisk,
    /// The disk at the tip.
    EndDisk,
    /// What is mounted on the end disk.
    Tool,
}

impl fmt::Display for SnakePart {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        f.write_str(match self {
            Self::Holder => "the holder",
            Self::FirstDisk => "the first disk",
            Self::EndDisk => "the end disk",
            Self::Tool => "the tool on the end disk",
        })
    }
}

impl From<RigError> for Error {
    /// Of a picture that is no file.
    fn from(error: RigError) -> Self {
        Self::Rig { path: None, source: error.into() }
    }
}

/// Why a rig could not be calibrated from a picture of the straight snake, with the values that tell.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum RigError {
    /// The picture is not of the camera file's size.
    #[error(
        "the picture is {}×{} px but the camera file says {}×{}; use the camera file of this camera and resolution",
        picture_px[0], picture_px[1], lens_px[0], lens_px[1]
    )]
    WrongSize {
        /// Width and height of the picture, px.
        picture_px: [u32; 2],
        /// Those that the camera file states, px.
        lens_px: [u32; 2],
    },
    /// Nowhere are there lines in two directions, equally far apart.
    #[error(
        "no printed grid was found: nowhere in the picture are there lines in two directions, equally far apart. Is the grid target in the picture, \
         in focus, and are its lines at least 5 px apart?"
    )]
    NoSheet,
    /// A sheet was seen, but its lines are not regular enough to be measured.
    #[error(
        "a grid with lines {:.1} px apart across and {:.1} px along was found, but too little of it is regular enough to be measured; is the sheet \
         creased, or hidden for the most part?",
        pitch_px[0], pitch_px[1]
    )]
    SheetNotMeasured {
        /// The lines' distances, px, across and along.
        pitch_px: [f64; 2],
    },
    /// Nothing before the sheet has the form of a snake.
    #[error(
        "no snake stands out before the grid: where one is likeliest, its form explains {:.0} % of what is seen, and a snake's explains more than half. \
         There {source}",
        100.0 * explained
    )]
    NoForm {
        /// The share of what is seen at the likeliest place that the snake's form explains.
        explained: f64,
        /// Why it is none.
        source: Box<RigError>,
    },
    /// The sheet leaves its own direction open.
    #[error(
        "the sheet tells its direction no better than to {sigma_deg:.1}° (1σ, at most {most_deg:.1}°): it bows by {bow_mm:.2} mm and is wavy by \
         {waves_mm:.2} mm (rms), or too little of it is seen. Lay it flat, and show more of it"
    )]
    SheetNotFlat {
        /// How far the sheet's smooth bow takes it from its mean plane, mm (rms).
        bow_mm: f64,
        /// How far waves and creases do, mm (rms).
        waves_mm: f64,
        /// Standard deviation of its direction about the worst axis, degrees.
        sigma_deg: f64,
        /// The most that it may be, degrees.
        most_deg: f64,
    },
    /// No snake stands before the sheet.
    #[error(
        "no snake was found before the grid: with its lines {:.1} px apart across and {:.1} px along the snake would be {width_px:.0} px wide, and nothing of \
         its form stands before the sheet. Is the straight snake in the picture, and are grid_pitch_mm and standoff_mm right?",
        pitch_px[0], pitch_px[1]
    )]
    NoSnake {
        /// The lines' distances, px, across and along.
        pitch_px: [f64; 2],
        /// How wide the snake would be, px.
        width_px: f64,
    },
    /// The snake, a standoff before the grid target, would be behind the camera.
    #[error(
        "the standoff puts the snake behind the camera: the grid target is {target_mm:.0} mm away and standoff_mm = {standoff_mm}; \
         check standoff_mm and grid_pitch_mm"
    )]
    BehindCamera {
        /// Depth of the grid target where the holder is seen, mm.
        target_mm: f64,
        /// The standoff that was stated, mm.
        standoff_mm: f64,
    },
    /// No mix of colours tells the snake from the grid target.
    #[error("the snake does not stand out from the grid target")]
    NoContrast,
    /// Too few places of the straight snake's outline show an edge.
    #[error("{}", few_edges(*edges, *places))]
    TooFewEdges {
        /// Places with an edge.
        edges: usize,
        /// Places that were looked at.
        places: usize,
    },
    /// The fit of the base did not converge, or its edges leave its place open.
    #[error("the snake's edges do not determine where its base is")]
    Undetermined,
    /// Too little of the outline agrees with the model.
    #[error(
        "only {:.0} % of the straight snake's outline agrees with the model (edges lie {bias_px:.2} px outside it); {IS_ALL_AS_STATED}",
        100.0 * agreeing
    )]
    ModelDisagrees {
        /// The share of the outline's places whose edges agree with the model.
        agreeing: f64,
        /// The share that must agree.
        least_agreeing: f64,
        /// How far outside the model the edges lie, px, where that is most.
        bias_px: f64,
        /// The most that it may be, px.
        most_bias_px: f64,
        /// Scatter of the agreeing edges about the model, px.
        rms_px: f64,
    },
    /// The edges lie about the model as edges of anything else would.
    #[error(
        "edges lie {rms_px:.2} px (rms) about the straight snake's outline, where at most {most_rms_px:.2} px could be its own; is the \
         snake unbent, in focus and of the robot's dimensions, and are grid_pitch_mm and standoff_mm right?"
    )]
    EdgesScattered {
        /// Scatter of the agreeing edges about the model, px.
        rms_px: f64,
        /// The most that it may be, px.
        most_rms_px: f64,
    },
    /// The snake is bent.
    #[error(
        "the snake is not straight in this picture but bent by {theta_deg:.0}° (± {sigma_deg:.1}°); take a picture of it unbent"
    )]
    Bent {
        /// The bend θ that was measured, degrees.
        theta_deg: f64,
        /// Its standard deviation, degrees.
        sigma_deg: f64,
    },
    /// A part of the snake is not where the model says.
    #[error(
        "{0} is not where the model says; is the snake unbent, and all of it in the picture, and are grid_pitch_mm and standoff_mm right?"
    )]
    PartNotVisible(SnakePart),
    /// Snake and grid do not tell the camera's direction.
    #[error(
        "snake and grid tell the camera's direction no better than to {sigma_deg:.1}° (1σ, at most {most_deg:.1}°); is \
         grid_pitch_mm that of its finest lines, and enough of the grid in the picture?"
    )]
    UncertainDirection {
        /// Standard deviation of the camera's direction about the worst axis, degrees.
        sigma_deg: f64,
        /// The most that it may be, degrees.
        most_deg: f64,
    },
    /// The snake's size contradicts the scale that was stated.
    #[error(
        "the scale contradicts the snake's size: with grid_pitch_mm = {grid_pitch_mm} and standoff_mm = {standoff_mm} it would be {apparent_diameter_mm:.2} mm \
         thick and {apparent_length_mm:.1} mm long, but the robot is {diameter_mm} mm and {length_mm} mm; a pitch of \
         {agreeing_pitch_mm:.2} mm or a standoff of {agreeing_standoff_mm:.0} mm would agree. Measure the grid target and correct \
         the wrong figure. The camera file may be wrong as well, or the snake bent"
    )]
    ScaleContradiction {
        /// The pitch that was stated, mm.
        grid_pitch_mm: f64,
        /// The standoff that was stated, mm.
        standoff_mm: f64,
        /// The snake's diameter by that scale, mm.
        apparent_diameter_mm: f64,
        /// The snake's length by that scale, mm.
        apparent_length_mm: f64,
        /// The robot's diameter, mm.
        diameter_mm: f64,
        /// The robot's length, mm.
        length_mm: f64,
        /// The pitch that would agree with the snake's size, mm.
        agreeing_pitch_mm: f64,
        /// The standoff that would agree with the snake's size, mm.
        agreeing_standoff_mm: f64,
    },
    /// The lines are not as far apart as was stated.
    #[error(
        "the scale contradicts the snake's size: grid_pitch_mm = {stated_mm}, but beside a snake {diameter_mm} mm thick the grid \
         target's lines are {found_mm:.2} mm apart. Measure the grid target, and correct grid_pitch_mm"
    )]
    PitchContradiction {
        /// The pitch that was stated, mm.
        stated_mm: f64,
        /// The pitch that is seen, mm.
        found_mm: f64,
        /// The robot's diameter, mm.
        diameter_mm: f64,
    },
}

/// Where a try to calibrate a rig ended, the first step first.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum CalibrationStep {
    /// Before anything was looked for.
    Input,
    /// Finding the sheet.
    Sheet,
    /// Finding the snake before it.
    Search,
    /// Fitting the snake.
    Snake,
    /// All was found, but not where scale and standoff say.
    Scale,
}

/// What to look at where the outline is not found as the model has it.
const IS_ALL_AS_STATED: &str = "is the snake unbent, in focus, unlike the grid target in colour and of the robot's dimensions, and are grid_pitch_mm \
                                and standoff_mm right?";

fn few_edges(edges: usize, places: usize) -> String {
    if places == 0 {
        return "by the grid target and the standoff the straight snake would lie outside the picture; check standoff_mm and grid_pitch_mm"
            .to_owned();
    }
    format!("only {edges} of {places} places on the straight snake's outline show an edge; {IS_ALL_AS_STATED}")
}

impl RigError {
    /// The step at which this ends a calibration.
    pub fn step(&self) -> CalibrationStep {
        match self {
            Self::WrongSize { .. } => CalibrationStep::Input,
            Self::NoSheet => CalibrationStep::Sheet,
            Self::BehindCamera { .. } | Self::NoSnake { .. } | Self::SheetNotMeasured { .. } => CalibrationStep::Search,
            Self::NoForm { source, .. } => source.step(),
            Self::NoContrast
            | Self::TooFewEdges { .. }
            | Self::Undetermined
            | Self::ModelDisagrees { .. }
            | Self::EdgesScattered { .. }
            | Self::Bent { .. }
            | Self::PartNotVisible(_)
            | Self::SheetNotFlat { .. }
            | Self::UncertainDirection { .. } => CalibrationStep::Snake,
            Self::ScaleContradiction { .. } | Self::PitchContradiction { .. } => CalibrationStep::Scale,
        }
    }

    /// Of several tries the one that came furthest tells most; the first of two that came as far.
    #[must_use]
    pub(super) fn or_further(self, former: Option<Self>) -> Self {
        match former {
            Some(former) if former.step() >= self.step() => former,
            _ => self,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_of_those_that_came_furthest_is_told() {
        let few = |edges| RigError::TooFewEdges { edges, places: 100 };
        let none = RigError::NoSnake { pitch_px: [20.0, 20.0], width_px: 60.0 };
        let tries = [RigError::NoSheet, few(1), none, few(2)];
        let told = tries.into_iter().fold(None, |former, error| Some(error.or_further(former)));
        assert_eq!(told, Some(few(1)));
    }

    #[test]
    fn messages_name_the_values_and_what_to_do() {
        let error = RigError::ScaleContradiction {
            grid_pitch_mm: 1.0,
            standoff_mm: 25.0,
            apparent_diameter_mm: 8.4,
            apparent_length_mm: 56.0,
            diameter_mm: 4.2,
            length_mm: 28.0,
            agreeing_pitch_mm: 0.5,
            agreeing_standoff_mm: 12.5,
        };
        let message = error.to_string();
        for part in
            ["grid_pitch_mm = 1", "standoff_mm = 25", "8.40 mm thick", "4.2 mm", "0.50 mm", "Measure the grid target"]
        {
            assert!(message.contains(part), "{part}: {message}");
        }
        let error = RigError::WrongSize { picture_px: [640, 480], lens_px: [1280, 720] };
        assert!(error.to_string().contains("640×480") && error.to_string().contains("1280×720"));
    }
}
