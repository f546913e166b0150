//! `calibrate rig`: grid and base from a picture of the unbent snake.

use crate::Result;
use crate::camera::Lens;
use crate::cli::console::Console;
use crate::cli::failure::Failure;
use crate::cli::inputs::model_or_paper;
use crate::cli::views::{calibrated, sheet_text};
use crate::measure::RigOptions;
use serde::Serialize;
use std::path::PathBuf;

/// Find the grid and the snake's base in a picture of the unbent snake: writes rig.toml, and rig.jpg beside it
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  snakeloop calibrate rig --camera camera.yaml --grid-pitch 1 --standoff 25 \
                  --straight straight.png -o rig.toml")]
pub struct Args {
    /// The camera file (OpenCV or ROS YAML)
    #[arg(long, value_name = "YAML")]
    camera: PathBuf,
    /// Distance between neighbouring thin lines of the grid, mm
    #[arg(long, value_name = "MM")]
    grid_pitch: f64,
    /// Distance from the snake's axis back to the grid plane, mm
    #[arg(long, value_name = "MM")]
    standoff: f64,
    /// The picture of the unbent snake
    #[arg(long, value_name = "PICTURE")]
    straight: PathBuf,
    /// The model of the robot in the picture (model.toml); by default the paper's
    #[arg(long, value_name = "MODEL")]
    model: Option<PathBuf>,
    /// The file to write
    #[arg(short, long, value_name = "RIG", default_value = "rig.toml")]
    output: PathBuf,
}

#[derive(Serialize)]
struct Summary {
    rig: PathBuf,
    /// From the camera to the base, along the camera's axis, mm.
    distance_mm: f64,
    grid_rms_px: f64,
    edge_rms_px: f64,
    /// Distance of the grid's lines across and along, mm.
    pitch_mm: [f64; 2],
    /// By how much the lines' angle differs from 90°, degrees.
    shear_deg: f64,
    /// Bow of the sheet about its mean plane, mm (rms).
    bow_rms_mm: f64,
}

impl Args {
    pub fn run(&self, console: &Console) -> Result<(), Failure> {
        for (flag, value_mm) in [("--grid-pitch", self.grid_pitch), ("--standoff", self.standoff)] {
            if !(value_mm > 0.0 && value_mm.is_finite()) {
                return Err(Failure::Usage(format!("{flag} {value_mm}: expected a length above 0 mm")));
            }
        }
        let lens = Lens::read(&self.camera)?;
        let model = model_or_paper(console, self.model.as_deref())?;
        let options = RigOptions { grid_pitch_mm: self.grid_pitch, standoff_mm: self.standoff, delta_offset: 0.0 };
        let drawn = self.output.with_file_name("rig.jpg");
        let rig = calibrated(&self.straight, &lens, &model.robot, &options, Some(&drawn))?;
        rig.write(&self.output)?;
        let summary = Summary {
            rig: self.output.clone(),
            distance_mm: rig.camera_from_base.translation.z,
            grid_rms_px: rig.grid_rms_px,
            edge_rms_px: rig.edge_rms_px,
            pitch_mm: [1.0, -1.0].map(|sign| rig.grid_pitch_mm * (1.0 + sign * rig.sheet_shape.anisotropy / 2.0)),
            shear_deg: rig.sheet_shape.shear.to_degrees(),
            bow_rms_mm: rig.sheet_shape.rms_mm(),
        };
        console.result(&summary, || {
            format!(
                "base {:.2} mm from the camera; grid fits to {:.2} px, the snake's edges to {:.2} px (rms)\n{}\n{}",
                summary.distance_mm,
                summary.grid_rms_px,
                summary.edge_rms_px,
                sheet_text(&rig),
                summary.rig.display()
            )
        });
        let rig = summary.rig.display();
        console.next(format_args!("write rig = \"{rig}\" under [[view]] of experiment.toml, in place of `straight`"));
        Ok(())
    }
}
