//! `render`: the frames of a simulated experiment.

use super::console::Console;
use super::inputs::rows;
use crate::Result;
use crate::cli::failure::Failure;
use crate::record::{read_model, read_truth};
use crate::simulate::{FrameFormat, Scene, out_of_picture, write_experiment};
use serde::Serialize;
use std::path::PathBuf;

/// Render the frames of known poses: makes OUT an experiment that `run` and `measure` can take
///
/// Writes frames/, straight.png (the unbent snake), camera.yaml, scene.toml, experiment.toml and the truth into OUT. An
/// encoders.csv that `simulate` wrote there becomes the experiment's.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  snakeloop simulate -o made && snakeloop render --poses made/truth.csv -o made && \
                  snakeloop run made -o out")]
pub struct Args {
    /// The poses (truth.csv)
    #[arg(long, value_name = "CSV")]
    poses: PathBuf,
    /// The model whose robot is drawn (model.toml); without it the scene's, or the paper's
    #[arg(long, value_name = "MODEL")]
    model: Option<PathBuf>,
    /// Camera, grid target, light and faults of the picture (scene.toml); by default a clean picture
    #[arg(long, value_name = "SCENE")]
    scene: Option<PathBuf>,
    /// The folder to write to; created if it is missing
    #[arg(short, long, value_name = "OUT")]
    output: PathBuf,
    /// Write JPEG files of this quality, 1 to 100, instead of PNG
    #[arg(long, value_name = "QUALITY")]
    jpeg: Option<u8>,
    /// Seed of the sensor's noise: the same seed gives the same files
    #[arg(long, value_name = "NUMBER", default_value_t = 1)]
    seed: u64,
}

#[derive(Serialize)]
struct Summary {
    frames: usize,
    output: PathBuf,
}

impl Args {
    pub fn run(&self, console: &Console) -> Result<(), Failure> {
        let format = match self.jpeg {
            None => FrameFormat::Png,
            Some(quality @ 1..=100) => FrameFormat::Jpeg(quality),
            Some(quality) => return Err(Failure::Usage(format!("--jpeg {quality}: expected 1 to 100"))),
        };
        let mut scene = self.scene.as_deref().map_or_else(|| Ok(Scene::default()), Scene::read)?;
        if let Some(path) = &self.model {
            scene.robot = read_model(path)?.robot;
        }
        let poses = rows(console, read_truth(&self.poses)?);
        let bar = console.progress(Some(poses.len()), "rendering");
        write_experiment(&self.output, &scene, &poses, format, self.seed, &|| bar.inc(1))?;
        bar.finish_and_clear();
        let out = out_of_picture(&scene, &poses);
        console.warn(out.first().map(|first| {
            format!(
                "the snake leaves the picture in {} of {} frames, frame {first} first: move the camera in scene.toml",
                out.len(),
                poses.len()
            )
        }));
        let summary = Summary { frames: poses.len(), output: self.output.clone() };
        console.result(&summary, || format!("{} frames\n{}", summary.frames, summary.output.display()));
        console.next(format_args!("snakeloop measure {} -o measured", summary.output.display()));
        Ok(())
    }
}
