//! `calibrate camera`: the lens from pictures of a chessboard, and what it is worth.

use crate::Result;
use crate::camera::calibrate::{BoardView, Halves};
use crate::camera::{Board, CameraCalibration, CameraFormat, calibrate_camera};
use crate::cli::console::Console;
use crate::cli::failure::Failure;
use crate::record::write_atomically;
use serde::Serialize;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Calibrate the lens from pictures of a chessboard
///
/// Writes a camera file for OpenCV or ROS, and prints the parameters with standard deviations, each picture's residuals, how much
/// of the picture the boards reach and whether two halves of the pictures agree.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:\n  snakeloop calibrate camera boards/*.jpg --corners 9x6 --square 25 -o camera.yaml")]
pub struct Args {
    /// Pictures of the whole board, at least three, tilted differently and together filling the picture
    #[arg(required = true)]
    pictures: Vec<PathBuf>,
    /// Inner corners of the board: along a row, along a column
    #[arg(long, value_name = "COLUMNSxROWS", value_parser = corners)]
    corners: (usize, usize),
    /// Side of a square, mm; the lens does not depend on it
    #[arg(long, value_name = "MM", default_value_t = 1.0)]
    square: f64,
    /// Write the camera file there, as OpenCV's FileStorage: XML if the name ends in .xml, else YAML
    #[arg(short, long, value_name = "CAMERA")]
    output: Option<PathBuf>,
    /// Write it as ROS camera_info YAML instead
    #[arg(long, requires = "output")]
    ros: bool,
}

/// `9x6`.
pub fn corners(text: &str) -> std::result::Result<(usize, usize), String> {
    let numbers = text.split_once(['x', '×']).and_then(|(a, b)| Some((a.parse().ok()?, b.parse().ok()?)));
    numbers.ok_or_else(|| "expected inner corners like 9x6".to_owned())
}

#[derive(Serialize)]
struct Calibrated {
    image_width: u32,
    image_height: u32,
    rms_px: f64,
    parameters: Vec<Parameter>,
    coverage: f64,
    /// What the sigmas mean for an angle measured on the snake.
    sigma_deg: f64,
    halves: Option<Compared>,
    pictures: Vec<BoardView>,
    skipped: Vec<Skipped>,
}

#[derive(Serialize)]
struct Parameter {
    name: &'static str,
    value: f64,
    sd: f64,
}

#[derive(Serialize)]
struct Compared {
    #[serde(flatten)]
    halves: Halves,
    disagree: bool,
}

#[derive(Serialize)]
struct Skipped {
    path: PathBuf,
    why: String,
}

impl Args {
    pub fn run(&self, console: &Console) -> Result<(), Failure> {
        let board = Board::new(self.corners.0, self.corners.1, self.square)?;
        let file = self.output.as_ref().map(|path| self.format(path).map(|format| (path, format))).transpose()?;
        let calibration = calibrate_camera(&self.pictures, &board)?;
        if let Some((path, format)) = file {
            write_atomically(path, calibration.lens.to_file(format).as_bytes())?;
        }
        let calibrated = Calibrated::from(calibration);
        console.warn(calibrated.warnings());
        console.result(&calibrated, || calibrated.text());
        if let Some(path) = &self.output {
            console.next(format_args!(
                "name {} as `camera` of the view in experiment.toml, and leave the focus as it is",
                path.display()
            ));
        }
        Ok(())
    }

    fn format(&self, output: &Path) -> Result<CameraFormat, Failure> {
        let is_xml = output.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("xml"));
        match (self.ros, is_xml) {
            (false, false) => Ok(CameraFormat::OpenCvYaml),
            (false, true) => Ok(CameraFormat::OpenCvXml),
            (true, false) => Ok(CameraFormat::Ros),
            (true, true) => Err(Failure::Usage(format!("--ros writes YAML, but {} ends in .xml", output.display()))),
        }
    }
}

impl From<CameraCalibration> for Calibrated {
    fn from(calibration: CameraCalibration) -> Self {
        let parameters = calibration.parameters().map(|(name, value, sd)| Parameter { name, value, sd }).into();
        let halves = calibration.halves.map(|halves| Compared { halves, disagree: halves.disagree() });
        Self {
            image_width: calibration.lens.width,
            image_height: calibration.lens.height,
            rms_px: calibration.rms_px,
            parameters,
            coverage: calibration.coverage,
            sigma_deg: calibration.sigma_deg,
            halves,
            pictures: calibration.views,
            skipped: calibration.skipped.into_iter().map(|(path, why)| Skipped { path, why }).collect(),
        }
    }
}

impl Calibrated {
    fn warnings(&self) -> Vec<String> {
        let skipped = self.skipped.iter().map(|s| format!("{}: not used: {}", s.path.display(), s.why));
        let outliers = self.pictures.iter().filter(|p| p.outlier).map(|p| {
            format!(
                "{}: rms {:.2} px is an outlier; look at the picture, and leave it out if it is bad",
                p.path.display(),
                p.rms_px
            )
        });
        let parallel = self.pictures.iter().all(|p| p.tilt_deg < 10.0);
        let tilt = parallel.then(|| "no board is tilted by more than 10°: the focal length is uncertain".to_owned());
        let bare = (self.coverage < 0.5).then(|| {
            format!("the boards reach {:.0} % of the picture: nothing is known of its borders", 100.0 * self.coverage)
        });
        let halves = self.halves.as_ref().filter(|halves| halves.disagree).map(|halves| {
            format!(
                "two halves of the pictures differ by {:.3}° at the snake, {:.3}° would be expected: is the board flat, \
                 and was the lens left alone?",
                halves.halves.rms_deg, halves.halves.expected_deg
            )
        });
        let cameras = several_cameras(self.pictures.iter().map(|picture| picture.path.as_path()));
        skipped.chain(cameras).chain(outliers).chain(tilt).chain(bare).chain(halves).collect()
    }

    fn text(&self) -> String {
        let mut text = format!(
            "{} pictures of {}×{} px, rms {:.4} px, corners in {:.0} % of the picture\n\n",
            self.pictures.len(),
            self.image_width,
            self.image_height,
            self.rms_px,
            100.0 * self.coverage
        );
        for Parameter { name, value, sd } in &self.parameters {
            text += &format!("{name:6} {value:11.5} ± {sd:.5}\n");
        }
        text += &format!("\nan angle on the snake: ± {:.4}°\n", self.sigma_deg);
        if let Some(Compared { halves, .. }) = &self.halves {
            text += &format!("two halves differ by {:.4}°, expected {:.4}°\n", halves.rms_deg, halves.expected_deg);
        }
        text += "\nrms px  worst px  tilt   picture\n";
        for picture in &self.pictures {
            let BoardView { path, rms_px, worst_px, tilt_deg, outlier } = picture;
            let mark = if *outlier { "  is an outlier" } else { "" };
            text += &format!("{rms_px:6.3}  {worst_px:8.3}  {tilt_deg:4.1}°  {}{mark}\n", path.display());
        }
        text
    }
}

/// What to say of pictures whose names fall into several series (left01.jpg, right01.jpg): they may be of several cameras.
fn several_cameras<'a>(pictures: impl Iterator<Item = &'a Path>) -> Option<String> {
    let series = |path: &Path| {
        let stem = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        path.with_file_name(stem.trim_end_matches(|c: char| c.is_ascii_digit())).display().to_string()
    };
    let mut counts = BTreeMap::<String, usize>::new();
    pictures.for_each(|path| *counts.entry(series(path)).or_default() += 1);
    // Pictures without a number in their names are a series each.
    counts.retain(|_, count| *count > 1);
    let named: Vec<String> = counts.iter().map(|(name, count)| format!("{count} of {name}*")).collect();
    (named.len() > 1).then(|| {
        format!(
            "the pictures are of {} series ({}); one lens is fitted to all of them; if they are of different cameras, calibrate each camera separately",
            named.len(),
            named.join(", ")
        )
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn series_of_names_may_be_cameras() {
        let told = |names: &[&str]| several_cameras(names.iter().map(Path::new));
        assert_eq!(told(&["a/left01.jpg", "a/left02.jpg", "a/left11.jpg"]), None);
        assert_eq!(told(&["board.jpg", "tilted.jpg", "corner.jpg"]), None);
        let text = told(&["a/left01.jpg", "a/left02.jpg", "a/right01.jpg", "a/right02.jpg"]).unwrap();
        assert!(text.contains("2 of a/left*, 2 of a/right*"), "{text}");
        assert!(told(&["a/1.jpg", "a/2.jpg", "b/1.jpg", "b/2.jpg"]).is_some());
    }

    #[test]
    fn corners_are_two_numbers() {
        assert_eq!(corners("9x6"), Ok((9, 6)));
        assert_eq!(corners("11×8"), Ok((11, 8)));
        for wrong in ["", "9", "9x", "x6", "9x6x2", "-9x6"] {
            assert!(corners(wrong).is_err(), "{wrong}");
        }
    }
}
