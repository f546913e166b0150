//! `render`: the frames of a simulated experiment.

use super::console::Console;
use super::inputs::rows;
use crate::geometry::Configuration;
use crate::record::{read_truth, write_atomically};
use crate::simulate::scene::Pattern;
use crate::simulate::{Scene, render};
use crate::{Error, Result};
use image::codecs::png::{CompressionType, FilterType, PngEncoder};
use image::{ExtendedColorType, ImageEncoder, RgbImage};
use serde::Serialize;
use std::path::{Path, PathBuf};

/// Render the frames of known poses: makes OUT an experiment that `run` and `measure` can take
///
/// Writes OUT/frames/, OUT/straight.png (the unbent snake), OUT/camera.yaml, OUT/scene.toml and OUT/experiment.toml,
/// which names OUT/encoders.csv where `simulate` wrote one.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  snakeloop simulate -o made && snakeloop render --poses made/truth.csv -o made && \
                  snakeloop run made -o out")]
pub struct Args {
    /// The poses (truth.csv)
    #[arg(long, value_name = "CSV")]
    poses: PathBuf,
    /// Camera, paper, light and faults of the picture (scene.toml); without it a clean picture
    #[arg(long, value_name = "SCENE")]
    scene: Option<PathBuf>,
    /// The folder to write to; created where it is missing
    #[arg(short, long, value_name = "OUT")]
    output: PathBuf,
    /// Seed of the sensor's noise
    #[arg(long, value_name = "NUMBER", default_value_t = 1)]
    seed: u64,
}

#[derive(Serialize)]
struct Summary {
    frames: usize,
    output: PathBuf,
}

impl Args {
    pub fn run(&self, console: &Console) -> Result<()> {
        let scene = self.scene.as_deref().map_or_else(|| Ok(Scene::default()), Scene::read)?;
        let poses = rows(console, read_truth(&self.poses)?);
        self.write("scene.toml", scene.to_toml()?.as_bytes())?;
        self.write("camera.yaml", scene.lens.to_opencv_yaml().as_bytes())?;
        self.write("experiment.toml", self.experiment(&scene)?.as_bytes())?;

        let bar = console.progress(poses.len() + 1, "rendering");
        let straight = render(&scene, Configuration::new(0.0, 0.0), self.seed);
        self.write("straight.png", &png(&straight)?)?;
        bar.inc(1);
        for pose in &poses {
            let seed = self.seed.wrapping_add(pose.index).wrapping_add(1);
            let frame = render(&scene, pose.configuration, seed);
            self.write(&format!("frames/{:05}.png", pose.index), &png(&frame)?)?;
            bar.inc(1);
        }
        bar.finish_and_clear();
        let summary = Summary { frames: poses.len(), output: self.output.clone() };
        console.result(&summary, || format!("{} frames\n{}", summary.frames, summary.output.display()));
        Ok(())
    }

    fn write(&self, name: &str, bytes: &[u8]) -> Result<()> {
        write_atomically(&self.output.join(name), bytes)
    }

    /// The experiment.toml that fits the scene.
    fn experiment(&self, scene: &Scene) -> Result<String> {
        let grid_pitch_mm = match &scene.paper.pattern {
            Pattern::GraphPaper { lines } => lines.iter().map(|lines| lines.pitch_mm).reduce(f64::min),
            Pattern::Checkerboard { square_mm, .. } => Some(*square_mm),
            Pattern::Blank => None,
        };
        let Some(grid_pitch_mm) = grid_pitch_mm else {
            let path = self.scene.as_deref().unwrap_or(Path::new("scene"));
            return Err(Error::content(path, "paper without a grid: no rig could be calibrated; give it a pattern"));
        };
        let has_encoders = self.output.join("encoders.csv").is_file();
        let encoders = if has_encoders { "encoders = \"encoders.csv\"\n\n" } else { "" };
        Ok(format!(
            "{encoders}[[view]]\nname = \"side\"\ncamera = \"camera.yaml\"\nframes = \"frames/*.png\"\n\
             straight = \"straight.png\"\ngrid_pitch_mm = {grid_pitch_mm}\nstandoff_mm = {}\n",
            scene.paper.standoff_mm
        ))
    }
}

fn png(picture: &RgbImage) -> Result<Vec<u8>> {
    let mut bytes = Vec::new();
    PngEncoder::new_with_quality(&mut bytes, CompressionType::Fast, FilterType::Adaptive)
        .write_image(picture.as_raw(), picture.width(), picture.height(), ExtendedColorType::Rgb8)
        .map_err(|e| Error::Domain(format!("cannot encode a picture of {:?} px: {e}", picture.dimensions())))?;
    Ok(bytes)
}
